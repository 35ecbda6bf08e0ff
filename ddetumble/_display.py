"""How results print (`str` gives the whole text, a notebook the same as prose and aligned tables) and work reports."""

import abc
import html
from collections.abc import Callable, Sequence


# What long work calls: a sentence, and the fraction done (0 to 1), nan where that is not known.
Progress = Callable[[str, float], object]


def stay_silent(text: str, share: float) -> None:
    """The report of work that nobody follows."""


WORTH_TELLING = 10.0  # s: what is left of a shorter work needs no estimate


def nest_progress(report: Progress, title: str, low: float, high: float) -> Progress:
    """The report of a part of the work: its messages behind a title, and its fractions between `low` and `high`."""
    return lambda text, share: report(f"{title}: {text}", low + (high - low) * share)


def tell_left(elapsed: float, done: int, count: int) -> str:
    """`, about 40 s left`, by the pace of what is done of `count` after so many seconds; '' where little is left."""
    left = elapsed / max(done, 1) * (count - done)
    if not left >= WORTH_TELLING:
        return ""
    return f", about {5 * round(left / 5)} s left" if left < 90.0 else f", about {left / 60:.0f} min left"


def tell_passed(elapsed: float) -> str:
    """` (40 s so far)`, of work that takes long; '' of what has just begun."""
    if not elapsed >= WORTH_TELLING:
        return ""
    return f" ({elapsed:.0f} s so far)" if elapsed < 90.0 else f" ({elapsed / 60:.0f} min so far)"


class AbstractPrinted(abc.ABC):
    """A result that is printed by `str`, and by a notebook as HTML."""

    @abc.abstractmethod
    def __str__(self) -> str:
        """The whole result in words and aligned columns, the answer first."""

    def _repr_html_(self) -> str:
        """Its first sentences in bold, notes as a list, the rest as it is aligned; everything is escaped."""
        first, *others = str(self).strip("\n").split("\n\n")
        lines = first.split("\n")
        count = next((k for k, line in enumerate(lines) if line.startswith(("- ", " ", "[["))), len(lines))
        blocks = [f"<p><strong>{html.escape(' '.join(lines[:count]))}</strong></p>"] * bool(count)
        if lines[count:] and all(line.startswith("- ") for line in lines[count:]):
            blocks.append("".join(["<ul>", *(f"<li>{html.escape(line[2:])}</li>" for line in lines[count:]), "</ul>"]))
        else:
            others = ["\n".join(lines[count:])] * bool(lines[count:]) + others
        blocks += [f'<pre style="white-space: pre-wrap">{html.escape(block)}</pre>' for block in others]
        return "\n".join(["<div>", *blocks, "</div>"])


def align_table(rows: Sequence[Sequence[str]]) -> list[str]:
    """Lines of a table: the first column to the left, all others to the right."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return ["  ".join([row[0].ljust(widths[0]), *map(str.rjust, row[1:], widths[1:])]).rstrip() for row in rows]
