"""Strict reader of CSV tables: a table is read as written or refused with the place and the remedy.

Common readers turn a decimal comma, a unit row, "OVR" or a short row into text or missing values without a word; this
one converts whole columns at once and, only where that fails, looks for the cell that is to blame.
"""

import csv
import io
import math
import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from .._errors import InputError
from .._settings import refuse_memory


CELLS = 20  # bytes of memory a byte of a table takes while it is read, as text and as numbers (measured: 19)
_DIGITS = frozenset("0123456789+-.eE")
# Cells that are no numbers, and what to do about them; at first those with the other decimal sign.
_NO_VALUE = r"[-+]?(nan|n/?a|null|none|inf(inity)?|#n/a|#[a-z/0]+[!?]|-+)"
NEEDED = "every row needs a number here: write it, or drop the row"
_OTHER_SIGN = {
    ".": (r"[-+]?\d*,\d+([eE][-+]?\d+)?", "contains a comma; write a decimal point, and no thousands separators"),
    ",": (r"[-+]?\d*\.\d+([eE][-+]?\d+)?",
          "contains a point where decimals are written with commas; write all numbers alike"),
}
_WITH_COMMA, _WITH_POINT = (re.compile(_OTHER_SIGN[sign][0]) for sign in ".,")
THOUSANDS = re.compile(r"[-+]?[1-9]\d{0,2}(,\d{3})+")  # what may be such, and a decimal comma as well
_MISTAKES = (
    (r"[-+]?\d{1,3}([,.'’\s_]\d{3})+([.,]\d*)?", "has thousands separators; write the number without them"),
    (r"[−–]\s*[\d.,]+([eE].*)?", "begins with a typographic minus; write a plain hyphen-minus"),
    (r"[-+]?[\d.,]+([eE][-+]?\d+)?\s*[^\W\d].*",
     "has a unit or text after the number; put the unit into the descriptor or header"),
    ("=.*", "is a formula without a stored value; open the file in a spreadsheet program and save it"),
    (_NO_VALUE, "is not a number; leave the cell empty where a sample is missing, or drop the row"),
    (".*", "is not a number; correct the cell or drop the row"),
)


@dataclass(frozen=True)
class Table:
    """A table: of a text file as text, of others also as numbers."""

    file: str  # its name as the user would write it
    columns: Mapping[str, list[str] | np.ndarray]  # column name to its cells, in the order of the file
    lines: np.ndarray  # line number of each data row, counted from 1 (the header is line 1), shape (rows,)

    def __len__(self) -> int:
        return len(self.lines)


def find_file(path) -> Path:
    """A path to a plain file that exists; folders, devices and paths to nothing are refused."""
    path = Path(path)
    try:
        if not path.exists():
            raise InputError("this file does not exist; check the path", file=path)
        if not path.is_file():
            what = "this is a folder; a file is needed here" if path.is_dir() else "this is not a plain file"
            raise InputError(what, file=path)
        with path.open("rb"):
            return path
    except InputError:
        raise
    except (OSError, ValueError) as error:
        raise InputError(f"this file cannot be read: {getattr(error, 'strerror', None) or error}", file=path) from None


def read_bytes(path) -> bytes:
    """Read a whole file; refused are folders, devices, and what cannot be opened or is too large for the memory."""
    path = find_file(path)
    refuse_memory(CELLS * path.stat().st_size, f"reading {path}")
    return path.read_bytes()


def decode(data: bytes, file: str, encoding: str = "utf-8") -> str:
    """Bytes as text, without a byte-order mark; NUL and bytes that are not in that encoding are refused by line."""
    if b"\0" in data and encoding != "utf-16":
        line = data.count(b"\n", 0, data.index(b"\0")) + 1
        raise InputError("the line contains a NUL byte: the file is damaged, or is not text", file=file, row=line)
    try:
        return data.decode("utf-8-sig" if encoding == "utf-8" else encoding)
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        problem = f"byte 0x{data[error.start]:02x} is not valid {encoding.upper()}; save the file as UTF-8"
        raise InputError(problem, file=file, row=line) from None


def read_toml(path: Path) -> dict:
    """Content of a TOML file; what is none is refused."""
    inside = sorted(one.name for one in Path(path).glob("*.toml"))
    if inside:
        raise InputError(f"this is a folder; name a file in it, such as {', '.join(inside[:3])}", file=path)
    try:
        return tomllib.loads(decode(read_bytes(path), str(path)))
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise InputError(f"this is not a TOML file: {error}", file=path) from None


def split_rows(text: str, file: str, delimiter: str, quote: str = '"', strict: bool = True
               ) -> list[tuple[int, list[str]]]:
    """Line number, counted from 1, and cells of each row of a CSV file; broken quotes are refused where `strict`."""
    rows, start = [], 1
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=delimiter, quotechar=quote, strict=strict)
    try:
        for cells in reader:
            rows.append((start, cells))
            start = reader.line_num + 1
    except csv.Error as error:
        raise InputError(f"a quotation mark is not closed, or a cell is too long ({error}); correct the line",
                         file=file, row=start) from None
    return rows


def parse_table(text: str, file: str, delimiter: str = ",", quote: str = '"') -> Table:
    """Text of a CSV file with one header line to columns of text.

    Raises:
        InputError: Empty file, header only, empty or duplicate headings, a row with too few or too many cells, an
            empty line before the end, or broken quotes.
    """
    if not text.strip():
        raise InputError("the file is empty; it needs a header line and data rows", file=file)
    rows = split_rows(text, file, delimiter, quote)
    while not rows[-1][1]:
        rows.pop()
    (above, header), rows = rows[0], rows[1:]
    header = [cell.strip() for cell in header]
    _check_header(header, file, above, delimiter)
    if not rows:
        raise InputError("there are no data rows below the header", file=file, row=above)
    for line, cells in rows:
        if not cells:
            raise InputError("the line is empty; remove it", file=file, row=line)
        if len(cells) != len(header):
            hint = ""
            if len(cells) < len(header):
                hint = "; complete the row (was the file cut off?)"
            elif delimiter == ",":
                hint = "; if numbers are written with commas, write decimal points and no thousands separators"
            problem = f"the row has {len(cells)} cell{'s' * (len(cells) > 1)} but the header has {len(header)}{hint}"
            raise InputError(problem, file=file, row=line)
    lines, data = zip(*rows, strict=True)
    return Table(file, dict(zip(header, map(list, zip(*data, strict=True)), strict=True)), np.array(lines))


def _check_header(header: list[str], file: str, line: int, delimiter: str) -> None:
    if not header:
        raise InputError("the first line is empty; it must contain the column names", file=file, row=line)
    for i, name in enumerate(header):
        if not name:
            raise InputError(f"column {i + 1} has no name in the header; name it or remove it", file=file, row=line)
        if header.count(name) > 1:
            problem = f"the heading {name!r} occurs {header.count(name)} times; give each column its own name"
            raise InputError(problem, file=file, row=line)
    other = next((sign for sign in ";\t|," if sign != delimiter and sign in header[0]), None)
    if other and len(header) == 1:
        shown = "a tab" if other == "\t" else repr(other)
        problem = f'cells seem to be separated by {shown}, not {delimiter!r}; state it as "dialect": '
        raise InputError(problem + '{"delimiter": …} of the resource', file=file, row=line)


def read_table(path) -> Table:
    """Read a UTF-8 CSV file with commas, or with semicolons or tabs where the header line has those and no comma; see
    `parse_table` for what is refused.

    Beside semicolons and tabs, decimal commas become points, unless they may be thousands separators.
    """
    file, text = str(path), decode(read_bytes(path), str(path))
    header = text.partition("\n")[0]
    delimiter = "," if "," in header else next((sign for sign in ";\t" if sign in header), ",")
    table = parse_table(text, file, delimiter)
    cells = [cell.strip() for column in table.columns.values() for cell in column]
    commas = [cell for cell in cells if _WITH_COMMA.fullmatch(cell)]
    doubtful = all(THOUSANDS.fullmatch(cell) for cell in commas) or any(_WITH_POINT.fullmatch(c) for c in cells)
    if delimiter == "," or doubtful:
        return table
    return replace(table, columns={name: [cell.replace(",", ".") if _WITH_COMMA.fullmatch(cell.strip()) else cell
                                          for cell in column] for name, column in table.columns.items()})


def convert_column(table: Table, column: str, *, decimal: str = ".", missing=("",), allow_missing: bool = False,
                   needed: str = NEEDED) -> np.ndarray:
    """Numbers of a column, shape (rows,), in the unit of the file; `decimal` is "." or ",".

    Empty cells and those in `missing` become NaN if `allow_missing`; if not, `needed` says what to do about a cell
    without a value.

    Raises:
        InputError: The column is not there, or a cell is not a plain finite number; file, column and line are named.
    """
    cells = pick_column(table, column)
    if isinstance(cells, np.ndarray):
        bad = ~np.isfinite(cells) if not allow_missing else np.isinf(cells)
        if bad.any():
            i = int(np.argmax(bad))
            remedy = "; every sample needs a number here" if np.isnan(cells[i]) else "; drop the sample"
            raise InputError(f"{cells[i]:g} is not a number{remedy}", file=table.file, column=column,
                             row=table.lines[i])
        return cells
    try:
        if decimal == "." and set("".join(cells)) <= _DIGITS:
            values = np.array(list(map(float, cells)))
            if np.isfinite(values).all():
                return values
    except ValueError:
        pass
    values = np.full(len(cells), math.nan)
    for i, cell in enumerate(map(str.strip, cells)):
        problem = None
        if not cell or cell in missing:
            stands = f"{cell!r} stands for a missing value" if cell else "the cell is empty"
            problem = None if allow_missing else f"{stands}; {needed}"
        elif not allow_missing and re.fullmatch(_NO_VALUE, cell, re.IGNORECASE):
            problem = f"{cell!r} is not a number; {needed}"
        else:
            problem, values[i] = _convert_cell(cell, decimal)
        if problem:
            raise InputError(problem, file=table.file, column=column, row=table.lines[i])
    return values


def read_texts(table: Table, column: str) -> list[str]:
    """Cells of a column as text, whole numbers without a point: names of tests."""
    cells = pick_column(table, column)
    return cells if isinstance(cells, list) else [f"{x:.15g}" for x in convert_column(table, column)]


def _convert_cell(cell: str, decimal: str) -> tuple[str | None, float]:
    """What is wrong with a cell, and its number."""
    plain = cell if decimal == "." else cell.replace(".", "|").replace(decimal, ".")
    if set(plain) <= _DIGITS:
        try:
            value = float(plain)
            return (None if math.isfinite(value) else f"{cell!r} is too large a number"), value
        except ValueError:
            pass
    mistakes = (_OTHER_SIGN[decimal], *_MISTAKES)
    words = next(words for pattern, words in mistakes if re.fullmatch(pattern, cell, re.IGNORECASE | re.DOTALL))
    return f"{cell!r} {words}", math.nan


def pick_column(table: Table, column: str) -> list[str] | np.ndarray:
    """Cells of a column; one that the table does not have is refused."""
    if column not in table.columns:
        raise InputError(f"there is no column {column!r}; the file has {', '.join(table.columns)}", file=table.file)
    return table.columns[column]
