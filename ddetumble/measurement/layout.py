"""The layout of a laboratory's raw file: delimiter, decimal sign, preamble, headings and units, each one reported."""

import csv
import io
import re
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .._errors import InputError
from .tables import Table, decode, read_bytes
from .units import parse_unit, role_of


DELIMITERS = {"\t": "tabs", ";": "semicolons", ",": "commas", "|": "bars", " ": "spaces"}
_NUMBER = re.compile(r"[-+−]?(\d[\d.,]*|[.,]\d+)([eE][-+]?\d+)?|[-+]?nan|[-+]?inf", re.IGNORECASE)
_THOUSANDS = re.compile(r"[-+]?[1-9]\d{0,2}(,\d{3})+")
# Dimensions (mass, length, time, temperature) that a heading's bare suffix may have: length, time, force, pressure, …
_PLAIN = {(0, 1, 0, 0), (0, 0, 1, 0), (1, 1, -2, 0), (1, -1, -2, 0), (0, 1, -1, 0), (0, 0, -1, 0), (0, 0, 0, 1)}
_LETTERS = ("N", "s", "m", "K", "V")


@dataclass(frozen=True)
class RawFile:
    """A raw file taken apart.

    Args:
        table: Cells as text by column name (the heading without its unit).
        units: Unit of each column as its heading or the unit row gives it, or None.
        decimal: "." or ",".
        notes: What was decided, in sentences.
    """

    table: Table
    units: dict[str, str | None]
    decimal: str
    notes: tuple[str, ...]


def read_layout(path, *, delimiter: str | None = None, decimal: str | None = None) -> RawFile:
    """Take a raw file apart.

    Args:
        path: The file: UTF-8, UTF-16 with a byte-order mark, or Windows-1252.
        delimiter: One of "," ";" "|" "tab" "space"; None to find it.
        decimal: "." or ","; None to find it.

    Raises:
        InputError: It cannot be told, or the rows do not agree with one another; the option that settles it is named.
    """
    file = str(path)
    text, notes = _decode(read_bytes(path), file)
    delimiter = {"tab": "\t", "\\t": "\t", "space": " "}.get(delimiter or "", delimiter)
    if delimiter not in (None, *DELIMITERS):
        raise InputError(f"the delimiter {delimiter!r} is not known; give --delimiter as , ; | tab or space", file=file)
    if decimal not in (None, ".", ","):
        raise InputError(f"the decimal sign is '.' or ',', not {decimal!r}; give it with --decimal", file=file)
    delimiter = delimiter or _find_delimiter(text, file)
    rows = _split(text, delimiter, file)
    first, width, numeric = _find_data(rows, file)
    header, units, above = _find_header(rows, first, width, file)
    data = rows[first:]
    for line, cells in data:
        if len(cells) != width:
            hint = "; if numbers have decimal commas, export with semicolons" if delimiter == "," else ""
            raise InputError(f"the row has {len(cells)} cells where others have {width}{hint}", file=file, row=line)
    decimal = decimal or _find_decimal([cells[j] for _, cells in data for j in numeric], file)
    lines = np.array([line for line, _ in data])
    columns = {name: [cells[j] for _, cells in data] for j, name in enumerate(header)}
    empty = [name for name, cells in columns.items() if not any(cells)]
    columns = {name: cells for name, cells in columns.items() if name not in empty}
    sign = "decimal points" if decimal == "." else "decimal commas"
    place = f"headings on line {above}" if above else "no headings"
    place = f"{sign}, {place}, data from line {lines[0]}"
    notes.append(f"{Path(file).name}: {DELIMITERS[delimiter]} between cells, {place}.")
    return RawFile(Table(file, columns, lines), {name: units[name] for name in columns}, decimal, tuple(notes))


def split_heading(text: str) -> tuple[str, str | None]:
    """A heading to name and unit: `Fz [N]`, `t (ms)`, `Time/s`, `Kraft in N`, `Force_N`, `velocity_m_s`.

    What stands in brackets or after the slash is a unit only if it reads as one.
    """
    text = " ".join(text.split()).strip()
    match = re.fullmatch(r"(.+?)\s*[\[(]\s*([^\[\]]*?)\s*[\])]", text)
    if match and (_is_unit(match[2]) or "[" in text):
        return match[1].strip(" _,:"), match[2] or "1"
    match = re.fullmatch(r"(.*\w)(?:\s*/\s*|\s+in\s+|\s*,\s*)(\S+)", text)
    if match and _is_unit(match[2], match[1]):
        return match[1], match[2]
    if role_of(text.lower()) is None and len(text.split("_")[0]) > 2:
        parts = text.split("_")
        for i in range(1, len(parts)):
            unit = "/".join(parts[i:])
            if all(_is_unit(part) for part in parts[i:]) and _is_unit(unit, "_".join(parts[:i])):
                return "_".join(parts[:i]), unit
    return text, None


def _is_unit(text: str, stem: str | None = None) -> bool:
    """Whether text reads as a unit; after a bare stem only one that a test bench would write there."""
    try:
        unit = parse_unit(text)
    except InputError as error:
        return "gauge" in error.problem
    if stem is None:
        return True
    letter = len(text) > 1 or text in _LETTERS or text == "%"
    return letter and (tuple(unit.dimension) in _PLAIN or text in ("%", "1", "V", "mV", "deg", "rad"))


def _decode(data: bytes, file: str) -> tuple[str, list[str]]:
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return decode(data, file, "utf-16"), [f"{Path(file).name}: read as UTF-16."]
    try:
        return decode(data, file), []
    except InputError as error:
        if "NUL" in error.problem:
            raise
        return decode(data, file, "cp1252"), [f"{Path(file).name}: not UTF-8, read as Windows-1252."]


def _split(text: str, delimiter: str, file: str) -> list[tuple[int, list[str]]]:
    """Rows with something in them: line number and stripped cells."""
    if delimiter == " ":
        rows = []
        for i, line in enumerate(text.splitlines()):
            cells = re.sub(r"\s+(?=[\[(])", " ", line.strip())
            rows.append((i + 1, [re.sub("\0", " ", c) for c in re.sub(r" (?=[\[(])", "\0", cells).split()]))
    else:
        rows, start = [], 1
        reader = csv.reader(io.StringIO(text, newline=""), delimiter=delimiter)
        try:
            for cells in reader:
                rows.append((start, [cell.strip() for cell in cells]))
                start = reader.line_num + 1
        except csv.Error as error:
            raise InputError(f"broken quoting or an endless cell ({error}); mend it", file=file, row=start) from None
    return [(line, cells) for line, cells in rows if any(cells)]


def _find_delimiter(text: str, file: str) -> str:
    """The delimiter under which most cells are numbers; the first of tabs, semicolons, commas … where equal."""
    head = "\n".join(text.splitlines()[:500])
    best, share = None, 0.0
    for delimiter in DELIMITERS:
        rows = [cells for _, cells in _split(head, delimiter, file)]
        counts = Counter(len(cells) for cells in rows if any(map(_NUMBER.fullmatch, cells)))
        if not counts:
            continue
        width, number = counts.most_common(1)[0]
        numbers = sum(bool(_NUMBER.fullmatch(cell)) for cells in rows if len(cells) == width for cell in cells)
        if width > 1 and numbers / (number * width) > share + 1e-9:
            best, share = delimiter, numbers / (number * width)
    if best is None:
        raise InputError("no rows with two or more columns of numbers were found; give --delimiter", file=file)
    return best


def _find_data(rows, file: str) -> tuple[int, int, list[int]]:
    """Position of the first data row, number of columns, and which columns hold numbers."""
    counts = Counter(len(cells) for _, cells in rows if len(cells) > 1 and any(map(_NUMBER.fullmatch, cells)))
    if not counts:
        raise InputError("no rows with two or more columns of numbers were found; check --delimiter", file=file)
    width = counts.most_common(1)[0][0]
    marks = [
        [bool(_NUMBER.fullmatch(cell)) for cell in cells] if len(cells) == width else None for _, cells in rows
    ]
    # Samples may be missing, so a column counts as numeric where most of the cells that are not empty are numbers.
    likely = [i for i, mark in enumerate(marks) if mark is not None and any(mark)]
    numbers = np.sum([mark for mark in marks if mark is not None and any(mark)], axis=0)
    filled = np.sum([[bool(cell) for cell in rows[i][1]] for i in likely], axis=0)
    numeric = [j for j in range(width) if numbers[j] > 0.5 * filled[j]]
    if not numeric:
        raise InputError("no column holds numbers throughout; check --delimiter and --decimal", file=file)

    def regular(i):
        return marks[i] is not None and all(marks[i][j] or not rows[i][1][j] for j in numeric) and any(marks[i])

    runs, start = [], None
    for i in range(len(rows) + 1):
        if i < len(rows) and regular(i):
            start = i if start is None else start
        elif start is not None:
            runs.append((i - start, -start))
            start = None
    if not runs:
        raise InputError("no row holds numbers in all numeric columns; check --delimiter and --decimal", file=file)
    first = -max(runs)[1]
    while first > 0 and any(map(_NUMBER.fullmatch, rows[first - 1][1])):
        first -= 1
    stray = [i for i in range(first) if regular(i) and len(numeric) > 1]
    if stray:
        problem = f"text interrupts the numbers (data stand already on line {rows[stray[0]][0]}); remove or split it"
        raise InputError(problem, file=file, row=rows[first - 1][0])
    return first, width, numeric


def _find_header(rows, first: int, width: int, file: str) -> tuple[list[str], dict[str, str | None], int | None]:
    """Names and units of the columns, and the line of the headings."""
    above = rows[:first]
    if above and len(above[-1][1]) != width:
        extra = [cell for cell in above[-1][1][width:] if cell]
        if extra or len(above[-1][1]) < width - 1:
            problem = f"there are {width} columns of data below {len(above[-1][1])} headings"
            hint = "; if numbers have decimal commas, export with semicolons; else give --delimiter"
            raise InputError(problem + hint, file=file, row=above[-1][0])
    line = None
    cells, units = [""] * width, [None] * width
    if above:
        line, cells = above[-1][0], (above[-1][1] + [""])[:width]
        bare = [cell.strip("[]() ") for cell in cells]
        if len(above) > 1 and abs(len(above[-2][1]) - width) <= 1 and _is_unit_row(bare):
            units = [unit or None for unit in bare]
            line, cells = above[-2][0], (above[-2][1] + [""])[:width]
    split = [split_heading(cell) if cell else (f"column {j + 1}", None) for j, cell in enumerate(cells)]
    names = [name for name, _ in split]
    names = [cells[j] if names.count(name) > 1 else name for j, name in enumerate(names)]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"the heading {name!r} is there twice; give each column its own", file=file, row=line)
    found = {}
    for j, name in enumerate(names):
        if units[j] and split[j][1] and units[j] != split[j][1]:
            problem = f"the heading says {split[j][1]!r} and the unit row {units[j]!r}; correct one"
            raise InputError(problem, file=file, column=name, row=line)
        found[name] = units[j] or split[j][1]
    return names, found, line


def _is_unit_row(cells: list[str]) -> bool:
    """Whether a row holds units only, at least one of them of the bench's own quantities."""
    if not all(not cell or cell == "-" or _is_unit(cell) for cell in cells):
        return False
    return any(cell and cell != "-" and _is_unit(cell, "") for cell in cells)


def _find_decimal(cells: list[str], file: str) -> str:
    """The decimal sign; asks where commas could be thousands separators."""
    commas = [cell for cell in cells if "," in cell]
    if not commas:
        return "."
    both = next((cell for cell in commas if "." in cell), None)
    if both:
        raise InputError(f"{both!r} has thousands separators; export the numbers without them", file=file)
    if any("." in cell for cell in cells):
        problem = f"some numbers have points and some commas ({commas[0]!r}); export them alike, or give --decimal"
        raise InputError(problem, file=file)
    if all(_THOUSANDS.fullmatch(cell) for cell in commas):
        problem = f"{commas[0]!r} can be a decimal comma or thousands; say which with --decimal , or --decimal ."
        raise InputError(problem, file=file)
    return ","
