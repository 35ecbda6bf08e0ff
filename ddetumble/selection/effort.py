"""How far a discovery searches: the rounds in which it tries every effect, and what it leaves out once they are spent.

Rounds are counted, not seconds, so that the same campaign gets the same verdict on every machine.
"""

import contextlib
from collections.abc import Iterator
from contextvars import ContextVar


class Effort:
    """Rounds of one discovery that are done, of at most `limit`, and the searches that were left out for want of more.
    """

    def __init__(self, limit: int):
        self.limit, self.done, self._left_out = limit, 0, {}

    @property
    def left_out(self) -> tuple[str, ...]:
        """Every search that was left out, once, each as a noun of a sentence."""
        return tuple(self._left_out)

    def count_round(self) -> None:
        """One more round is done."""
        self.done += 1

    def allows(self, search: str) -> bool:
        """Whether a further search may begin; if not, it counts as left out."""
        if self.done < self.limit:
            return True
        self._left_out[search] = None
        return False


_effort: ContextVar[Effort | None] = ContextVar("effort", default=None)


@contextlib.contextmanager
def limit_effort(rounds: int) -> Iterator[Effort]:
    """Limit the rounds of everything that is searched inside."""
    effort = Effort(rounds)
    token = _effort.set(effort)
    try:
        yield effort
    finally:
        _effort.reset(token)


def count_round() -> None:
    """Count a round of trying every effect, where rounds are limited."""
    effort = _effort.get()
    if effort is not None:
        effort.count_round()


def may_search(what: str) -> bool:
    """Whether rounds are left for a further search, or unlimited; if not, `what` is kept as left out."""
    effort = _effort.get()
    return effort is None or effort.allows(what)
