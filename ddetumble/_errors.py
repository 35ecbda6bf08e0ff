"""The two ways in which a command can fail: the input was bad, or the computation did not succeed."""

import contextlib
import difflib
import functools
from collections.abc import Collection


# How the parts of a place are told, in this order.
_WORDS = {"file": "{}", "sheet": "{}", "row": "line {}", "column": "column {}", "key": "key {}", "option": "{}"}


def plain_text(text: str) -> str:
    """Make text printable on one line, whatever bytes a damaged file put into it."""
    text = "".join(c if c.isprintable() else f"\\x{ord(c):02x}" for c in " ".join(str(text).split()))
    return text if len(text) <= 600 else text[:597] + "..."


def offer_names(name: str, known: Collection[str], what: str) -> str:
    """What may stand in place of an unknown name: the nearest known one where one is near, and all of them.

    `what` begins the list: `the keys are`.
    """
    near = [one for one in known if one.endswith(f".{name}")] or difflib.get_close_matches(name, known, n=1)
    return f"{f'did you mean {near[0]}? {what.capitalize()}' if near else what} {', '.join(known)}"


class InputError(ValueError):
    """Bad input, described in one sentence that says where it is and what to do (exit code 2).

    Args:
        problem: What is wrong and what to do about it.
        file: The file it is in, as the user would name it.
        column: The column of a table, or its field in a descriptor.
        row: Line number in the file, counted from 1 (the header is line 1).
        key: The key of a TOML or JSON file, with its tables: `arm.mass`.
        option: The option of a command, or the argument of a function.
        sheet: The sheet or group of the file, with the word: `sheet Data`.

    `str()` of the error is the whole sentence, the place first.
    """

    def __init__(self, problem: str, *, file=None, column: str | None = None, row: int | None = None,
                 key: str | None = None, option: str | None = None, sheet: str | None = None):
        super().__init__(problem)
        self.problem = problem
        self.file = None if file is None else str(file)
        self.column, self.key, self.option, self.sheet = column, key, option, sheet
        self.row = None if row is None else int(row)

    def places(self) -> dict:
        """Where it is, as far as that is known."""
        return {name: value for name in _WORDS if (value := getattr(self, name)) not in (None, "")}

    def __str__(self) -> str:
        place = ", ".join(_WORDS[name].format(value) for name, value in self.places().items())
        return plain_text(f"{place}: {self.problem}" if place else self.problem)

    def __reduce__(self):
        return functools.partial(type(self), **self.places()), (self.problem,)


class ComputationError(RuntimeError):
    """The input was fine and the computation failed all the same; `str()` explains (exit code 1)."""


@contextlib.contextmanager
def error_place(prefix: str = "", **place):
    """Say of an `InputError` raised inside where it is, as far as it does not say so itself.

    Args:
        prefix: What its problem begins with.
        place: `file`, `column`, `row`, `key`, `option` or `sheet`.
    """
    try:
        yield
    except InputError as error:
        raise InputError(prefix + error.problem, **place | error.places()) from None
