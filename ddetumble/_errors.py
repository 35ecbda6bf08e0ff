"""The two ways in which a command can fail: the input was bad, or the computation did not succeed."""

import contextlib


def _plain(text: str) -> str:
    """Make text printable on one line, whatever bytes a damaged file put into it."""
    text = "".join(c if c.isprintable() else f"\\x{ord(c):02x}" for c in " ".join(str(text).split()))
    return text if len(text) <= 600 else text[:597] + "..."


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

    def __str__(self) -> str:
        place = [place for place in (self.file, self.sheet) if place]
        if self.row is not None:
            place.append(f"line {self.row}")
        if self.column is not None:
            place.append(f"column {self.column}")
        if self.key is not None:
            place.append(f"key {self.key}")
        if self.option is not None:
            place.append(self.option)
        return _plain(f"{', '.join(place)}: {self.problem}" if place else self.problem)

    def __reduce__(self):
        return _rebuild, (type(self), self.problem, self.file, self.column, self.row, self.key, self.option,
                          self.sheet)


class ComputationError(RuntimeError):
    """The input was fine and the computation failed all the same; `str()` explains (exit code 1)."""


def _rebuild(kind, problem, file, column, row, key, option, sheet):
    """Build an `InputError` again on the far side of a process boundary."""
    return kind(problem, file=file, column=column, row=row, key=key, option=option, sheet=sheet)


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
        known = {name: getattr(error, name) for name in ("file", "column", "row", "key", "option", "sheet")}
        place |= {name: value for name, value in known.items() if value is not None}
        raise InputError(prefix + error.problem, **place) from None
