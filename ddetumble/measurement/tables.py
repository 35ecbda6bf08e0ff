"""Strict reader of CSV tables: a table is read as written or refused with the place and the remedy.

Common readers turn a decimal comma, a unit row, "OVR" or a short row into text or missing values without a word; this
one converts whole columns at once and, only where that fails, looks for the cell that is to blame.
"""

import csv
import io
import math
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .._errors import InputError
from .._settings import refuse_memory


CELLS = 20  # bytes of memory a byte of a table takes while it is read, as text and as numbers (measured: 19)
_DIGITS = frozenset("0123456789+-.eE")


@dataclass(frozen=True)
class Table:
    """A table as text.

    Args:
        file: The file's name as the user would write it.
        columns: Column name to its cells, in the order of the file.
        lines: Line number of each data row, counted from 1 (the header is line 1), shape (rows,).
    """

    file: str
    columns: dict[str, list[str]]
    lines: np.ndarray

    def __len__(self) -> int:
        return len(self.lines)


def read_bytes(path) -> bytes:
    """Read a whole file.

    Raises:
        InputError: It is not there, is a folder or a device, cannot be opened, or is too large for the memory.
    """
    path = Path(path)
    try:
        if path.is_dir():
            raise InputError("is a folder; a file is needed here", file=path)
        if path.exists() and not path.is_file():
            raise InputError("is not a plain file", file=path)
        refuse_memory(CELLS * path.stat().st_size, f"reading {path}")
        return path.read_bytes()
    except FileNotFoundError:
        raise InputError("there is no such file; check the path", file=path) from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise error if isinstance(error, InputError) else InputError(f"cannot be read: {reason}", file=path) from None


def decode(data: bytes, file: str, encoding: str = "utf-8") -> str:
    """Bytes as text, without a byte-order mark.

    Raises:
        InputError: NUL bytes, or bytes that are not in that encoding; the line is named.
    """
    if b"\0" in data and encoding != "utf-16":
        line = data.count(b"\n", 0, data.index(b"\0")) + 1
        raise InputError("holds a NUL byte: the file is damaged, or is not text", file=file, row=line)
    try:
        return data.decode("utf-8-sig" if encoding == "utf-8" else encoding)
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        problem = f"byte 0x{data[error.start]:02x} is not valid {encoding.upper()}; save the file as UTF-8"
        raise InputError(problem, file=file, row=line) from None


def parse_table(text: str, file: str, *, delimiter: str = ",", quote: str = '"') -> Table:
    """Text of a CSV file with one header line to columns of text.

    Args:
        text: The file's text.
        file: Its name, for messages.
        delimiter: One character between cells.
        quote: The character around quoted cells.

    Raises:
        InputError: Empty file, header only, empty or duplicate headings, a row with too few or too many cells, an
            empty line before the end, or broken quotes.
    """
    if not text.strip():
        raise InputError("the file is empty; it needs a header line and data rows", file=file)
    rows, lines = [], []
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=delimiter, quotechar=quote, strict=True)
    try:
        start = 1
        for row in reader:
            rows.append(row)
            lines.append(start)
            start = reader.line_num + 1
    except csv.Error as error:
        raise InputError(f"broken quoting or an endless cell ({error}); mend the line", file=file, row=start) from None
    while not rows[-1]:
        rows.pop()
        lines.pop()
    header = [cell.strip() for cell in rows[0]]
    _check_header(header, rows[1:], file, lines[0], delimiter)
    width = len(header)
    if any(len(row) != width for row in rows):
        _blame_row(rows, lines, header, file, delimiter)
    columns = {name: list(cells) for name, cells in zip(header, zip(*rows[1:], strict=True), strict=True)}
    return Table(file, columns, np.array(lines[1:]))


def read_table(path, *, delimiter: str = ",", quote: str = '"') -> Table:
    """Read a UTF-8 CSV file; see `parse_table` for what is refused."""
    return parse_table(decode(read_bytes(path), str(path)), str(path), delimiter=delimiter, quote=quote)


def convert_column(
    table: Table, column: str, *, decimal: str = ".", missing=("",), allow_missing: bool = False
) -> np.ndarray:
    """Numbers of a column, shape (rows,), in the unit of the file.

    Args:
        table: The table.
        column: Name of the column.
        decimal: Decimal separator, "." or ",".
        missing: Cells that stand for a missing value.
        allow_missing: Missing values become NaN; otherwise they are refused.

    Raises:
        InputError: The column is not there, or a cell is not a plain finite number; file, column and line are named.
    """
    cells = pick_column(table, column)
    try:
        if decimal == "." and set("".join(cells)) <= _DIGITS:
            values = np.array(list(map(float, cells)))
            if np.isfinite(values).all():
                return values
    except ValueError:
        pass
    values = np.empty(len(cells))
    for i, cell in enumerate(cells):
        cell = cell.strip()
        if cell in missing or not cell:
            if not allow_missing:
                problem = "the cell is empty; every row needs a number here"
                problem = problem if not cell else f"{cell!r} stands for a missing value, and every row needs a number"
                raise InputError(problem, file=table.file, column=column, row=table.lines[i])
            values[i] = math.nan
        else:
            values[i] = _convert_cell(cell, decimal, table.file, column, table.lines[i])
    return values


def pick_column(table: Table, column: str) -> list[str]:
    """Cells of a column as text.

    Raises:
        InputError: The table has no such column.
    """
    if column not in table.columns:
        raise InputError(f"there is no column {column!r}; the file has {', '.join(table.columns)}", file=table.file)
    return table.columns[column]


def _convert_cell(cell: str, decimal: str, file: str, column: str, line: int) -> float:
    plain = cell if decimal == "." else cell.replace(".", "|").replace(decimal, ".")
    if set(plain) <= _DIGITS:
        try:
            value = float(plain)
        except ValueError:
            pass
        else:
            if math.isfinite(value):
                return value
            raise InputError(f"{cell!r} is too large a number", file=file, column=column, row=line)
    raise InputError(_explain_cell(cell, decimal), file=file, column=column, row=line)


def _explain_cell(cell: str, decimal: str) -> str:
    """Why a cell is no number, and what to do."""
    if re.fullmatch(r"[-+]?(nan|n/?a|null|none|inf(inity)?|#n/a|#value!|#div/0!|-+)", cell, re.IGNORECASE):
        return f"{cell!r} is not a number; leave the cell empty where a sample is missing, or drop the row"
    if re.fullmatch(r"[-+]?\d*,\d+([eE][-+]?\d+)?", cell) and decimal == ".":
        return f"{cell!r} has a comma; write a decimal point, and no thousands separators"
    if decimal == "," and re.fullmatch(r"[-+]?\d*\.\d+([eE][-+]?\d+)?", cell):
        return f"{cell!r} has a point where decimals are written with commas; write all numbers alike"
    if re.fullmatch(r"[-+]?\d{1,3}([,.'’\s_]\d{3})+([.,]\d*)?", cell):
        return f"{cell!r} has thousands separators; write the number without them"
    if re.fullmatch(r"[−–]\s*[\d.,]+([eE].*)?", cell):
        return f"{cell!r} begins with a typographic minus; write a plain hyphen-minus"
    if re.fullmatch(r"[-+]?[\d.,]+([eE][-+]?\d+)?\s*[^\W\d].*", cell):
        return f"{cell!r} has a unit or text after the number; put the unit into the descriptor or header"
    return f"{cell!r} is not a number; correct the cell or drop the row"


def _check_header(header: list[str], rows: list, file: str, line: int, delimiter: str) -> None:
    if not header:
        raise InputError("the first line is empty; it must hold the column names", file=file, row=line)
    for i, name in enumerate(header):
        if not name:
            raise InputError(f"column {i + 1} has no name in the header; name it or remove it", file=file, row=line)
        if header.count(name) > 1:
            problem = f"the heading {name!r} is there {header.count(name)} times; give each column its own name"
            raise InputError(problem, file=file, row=line)
    if len(header) == 1:
        for other in ";\t|,":
            if other != delimiter and other in header[0]:
                shown = "a tab" if other == "\t" else repr(other)
                problem = f'cells seem to be separated by {shown}, not {delimiter!r}; state it as "dialect": '
                raise InputError(problem + '{"delimiter": …} of the resource', file=file, row=line)
    if not rows:
        raise InputError("there are no data rows below the header", file=file, row=line)


def _blame_row(rows, lines, header, file, delimiter) -> None:
    for row, line in zip(rows, lines, strict=True):
        if not row:
            raise InputError("the line is empty; remove it", file=file, row=line)
        if len(row) != len(header):
            problem = f"the row has {_count(len(row), 'cell')} and the header {len(header)}"
            if len(row) > len(header) and delimiter == ",":
                problem += "; if numbers are written with commas, write decimal points and no thousands separators"
            elif len(row) < len(header):
                problem += "; complete the row (was the file cut off?)"
            raise InputError(problem, file=file, row=line)


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"
