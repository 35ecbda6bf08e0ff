"""The layout of a laboratory's raw file: delimiter, decimal sign, preamble, headings and units, each one reported."""

import re
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from .._errors import InputError
from .tables import THOUSANDS, Table, decode, read_bytes, split_rows
from .units import parse_unit, role_of


DELIMITERS = {"\t": "tabs", ";": "semicolons", ",": "commas", "|": "bars", " ": "spaces"}
_NUMBER = re.compile(r"[-+−]?(\d[\d.,]*|[.,]\d+)([eE][-+]?\d+)?|[-+]?nan|[-+]?inf", re.IGNORECASE)
_PLAIN = ("m", "s", "N", "Pa", "m/s", "rad/s", "K")  # of the dimensions that a heading's bare suffix may have
_LETTERS = ("N", "s", "m", "K", "V", "%")  # single characters that may be a unit there


@dataclass(frozen=True)
class RawFile(Table):
    """A raw file taken apart: cells by column name (the heading without its unit)."""

    units: dict[str, str | None]  # of each column as its heading or the unit row gives it
    decimal: str  # "." or ","
    notes: tuple[str, ...]  # what was decided, in sentences
    key: str  # what the test is called where no column says it
    sheet: str | None = None  # the sheet or group of the file, with the word, where the file has such

    def join(self, names: Iterable[str]) -> "RawFile":
        """The table of these columns, all of one length."""
        return self


def read_layout(path, *, delimiter: str | None = None, decimal: str | None = None, single: bool = False) -> RawFile:
    """Take a text file apart: UTF-8, UTF-16 with a byte-order mark, or Windows-1252.

    The delimiter (one of "," ";" "|" "tab" "space") and the decimal sign ("." or ",") are found where they are None.
    `single` says that a file of one column is one, too.

    Raises:
        InputError: It cannot be told, or the rows do not agree with one another; the option that settles it is named.
    """
    file, short = str(path), Path(path).name
    data, encoding, notes = read_bytes(path), "utf-8", []
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        encoding, notes = "utf-16", [f"{short} was read as UTF-16."]
    try:
        text = decode(data, file, encoding)
    except InputError as error:
        if "NUL" in error.problem:
            raise
        text, notes = decode(data, file, "windows-1252"), [f"{short} is not UTF-8 and was read as Windows-1252."]
    delimiter = {"tab": "\t", "\\t": "\t", "space": " "}.get(delimiter or "", delimiter)
    if delimiter not in (None, *DELIMITERS):
        raise InputError(f"the delimiter {delimiter!r} is unknown; --delimiter takes , ; | tab or space", file=file)
    if decimal not in (None, ".", ","):
        raise InputError(f"the decimal sign must be '.' or ',', not {decimal!r}; give it with --decimal", file=file)
    if delimiter is None and _is_column(text, decimal):
        if not single:
            raise InputError("the file has one column of numbers where two or more are needed; give --delimiter, or "
                             "--rate '10 kHz' if it is the force over even times", file=file)
        rows = [(line, [cell.strip()]) for line, cell in enumerate(text.splitlines(), 1) if cell.strip()]
        raw = lay_out(rows, file, decimal, least=1)
        return replace(raw, notes=(*notes, f"{short}: one column, {raw.notes[0]}."))
    if delimiter is None:  # the first of those under which most cells are numbers
        head = "\n".join(text.splitlines()[:500])
        shares = {sign: _count_columns(_split(head, sign, file))[1] for sign in DELIMITERS}
        delimiter = max(shares, key=shares.__getitem__)
    hint = "; if numbers have decimal commas, export with semicolons" if delimiter == "," else ""
    raw = lay_out(_split(text, delimiter, file), file, decimal, hint)
    sign = "points" if raw.decimal == "." else "commas"
    notes.append(f"{short}: {DELIMITERS[delimiter]} between cells, decimal {sign}, {raw.notes[0]}.")
    return replace(raw, notes=tuple(notes))


def holds_rows(path) -> bool:
    """Whether a line of a text file is a number, or has two among its cells: measurements hold such, notes do not.

    Between blanks, where every word is a cell, half of them have to be numbers.
    """
    data = read_bytes(path)
    text = data.decode("utf-16" if data[:2] in (b"\xff\xfe", b"\xfe\xff") else "windows-1252", errors="replace")
    for line in filter(None, map(str.strip, text.splitlines())):
        for sign in DELIMITERS:
            cells = line.split() if sign == " " else [cell.strip() for cell in line.split(sign)]
            if sum(map(_is_number, cells)) >= max(min(len(cells), 2), len(cells) / 2 if sign == " " else 0):
                return True
    return False


def lay_out(rows: list[tuple[int, list[str]]], file: str, decimal: str | None, hint: str = "",
            remedy: str = "give --delimiter", least: int = 2) -> RawFile:
    """Find headings, units and data in the rows of a table: line number and cells, each with something in it.

    `hint` is what may help where rows differ in length, `remedy` what to do where no data are found, `least` the fewest
    columns of a table. The one note is where headings and data are.
    """
    first, width, numeric = _find_data(rows, file, remedy, least)
    names, units, above = _find_header(rows[:first], width, file)
    for line, cells in rows[first:]:
        if len(cells) != width:
            raise InputError(f"the row has {len(cells)} cells where others have {width}{hint}", file=file, row=line)
    lines, data = zip(*rows[first:], strict=True)
    decimal = decimal or _find_decimal([cells[j] for cells in data for j in numeric], file)
    columns = {name: list(cells) for name, cells in zip(names, zip(*data, strict=True), strict=True) if any(cells)}
    place = f"headings on line {above}" if above else "no headings"
    return RawFile(file, columns, np.array(lines), dict(zip(names, units, strict=True)), decimal,
                   (f"{place}, data from line {lines[0]}",), Path(file).stem)


def split_heading(text: str) -> tuple[str, str | None]:
    """A heading to name and unit: `Fz [N]`, `t (ms)`, `Time/s`, `Kraft in N`, `Force_N`, `velocity_m_s`, `omega_dps 1`.

    What stands in brackets or after the slash is a unit only if it reads as one.
    """
    text = " ".join(text.split()).strip()
    column = re.fullmatch(r"(.+[\W_].*?)( \d+)", text)
    if column:  # of a matrix
        name, unit = split_heading(column[1])
        return (name + column[2], unit) if unit is not None else (text, None)
    match = re.fullmatch(r"(.+?)\s*[\[(]\s*([^\[\]]*?)\s*[\])]", text)
    if match and (_is_unit(match[2]) or "[" in text):
        return match[1].strip(" _,:/"), match[2] or "1"
    match = re.fullmatch(r"(.*\w)(?:\s*/\s*|\s+in\s+|\s*,\s*)(\S+)", text)
    if match and _is_unit(match[2], bare=True):
        return match[1], match[2]
    parts = text.split("_")
    if role_of(text.lower()) is None and (len(parts[0]) > 2 or parts[0] == "t"):
        for i in range(1, len(parts)):
            unit = "/".join(parts[i:])
            of_time = parts[0] != "t" or _is_unit(unit) and parse_unit(unit).dimension == parse_unit("s").dimension
            if of_time and all(map(_is_unit, parts[i:])) and _is_unit(unit, bare=True):
                return "_".join(parts[:i]), unit
    return text, None


def _is_unit(text: str, bare: bool = False) -> bool:
    """Whether text reads as a unit; without brackets only as one that a test bench would write there."""
    try:
        unit = parse_unit(text)
    except InputError as error:
        return "gauge" in error.problem
    if not bare:
        return True
    plain = text in ("%", "V", "mV", "deg", "rad")
    plain = plain or any(unit.dimension == parse_unit(si).dimension for si in _PLAIN)
    return plain and (len(text) > 1 or text in _LETTERS)


def _split(text: str, delimiter: str, file: str) -> list[tuple[int, list[str]]]:
    """Rows with something in them: line number and stripped cells."""
    if delimiter == " ":  # no cell begins with a bracket: that is the unit of the heading before
        rows = [(i, re.split(r"\s+(?![\s\[(])", line.strip())) for i, line in enumerate(text.splitlines(), 1)]
    else:
        rows = split_rows(text, file, delimiter, strict=False)
    return [(line, [cell.strip() for cell in cells]) for line, cells in rows if any(map(str.strip, cells))]


def _is_number(cell: str) -> bool:
    return _NUMBER.fullmatch(cell) is not None


def _is_column(text: str, decimal: str | None) -> bool:
    """Whether most lines are a number and nothing else; one with a comma only where that is said to be the decimal."""
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    return sum(_is_number(line) and ("," not in line or decimal == ",") for line in lines) > 0.5 * len(lines)


def _count_columns(rows, least: int = 2) -> tuple[int, float]:
    """Usual number of cells in rows that hold numbers, and the share of numbers among these; (0, 0) without any."""
    numeric = [cells for _, cells in rows if len(cells) >= least and any(map(_is_number, cells))]
    if not numeric:
        return 0, 0.0
    width = Counter(map(len, numeric)).most_common(1)[0][0]
    cells = [cell for row in numeric if len(row) == width for cell in row]
    return width, sum(map(_is_number, cells)) / len(cells)


def holds_numbers(rows: list[tuple[int, list[str]]]) -> bool:
    """Whether any cell of a table is a number."""
    return any(_is_number(cell) for _, cells in rows for cell in cells)


def _find_data(rows, file: str, remedy: str, least: int) -> tuple[int, int, list[int]]:
    """Position of the first data row, number of columns, and which columns hold numbers."""
    width, _ = _count_columns(rows, least)
    if not width:
        raise InputError(f"no rows with two or more columns of numbers were found; {remedy}", file=file)
    marks = {i: list(map(_is_number, cells)) for i, (_, cells) in enumerate(rows) if len(cells) == width}
    marks = {i: mark for i, mark in marks.items() if any(mark)}
    # Samples may be missing, so a column counts as numeric where most of the cells that are not empty are numbers.
    filled = np.sum([[bool(cell) for cell in rows[i][1]] for i in marks], axis=0)
    numeric = np.flatnonzero(np.sum(list(marks.values()), axis=0) > 0.5 * filled).tolist()
    regular = [i for i, mark in marks.items() if all(mark[j] or not rows[i][1][j] for j in numeric)]
    if not numeric or not regular:
        raise InputError(f"no columns hold numbers throughout; {remedy} or check --decimal", file=file)
    runs = np.split(regular, np.flatnonzero(np.diff(regular) > 1) + 1)
    first = int(max(runs, key=len)[0])
    while first > 0 and any(map(_is_number, rows[first - 1][1])):
        first -= 1
    if regular[0] < first and (len(numeric) > 1 or width == 1):
        problem = f"text interrupts the numbers (data begin on line {rows[regular[0]][0]}); remove it or split the file"
        raise InputError(problem, file=file, row=rows[first - 1][0])
    return first, width, numeric


def _find_header(above, width: int, file: str) -> tuple[list[str], list[str | None], int | None]:
    """Names and units of the columns from the rows above the data, and the line of the headings."""
    line, cells, units = None, [""] * width, [""] * width
    if above:
        line, heads = above[-1]
        if len(heads) < width - 1 or any(heads[width:]):
            problem = f"there are {width} columns of data below {len(heads)} headings; if numbers have decimal commas, "
            raise InputError(f"{problem}export with semicolons; else give --delimiter", file=file, row=line)
        bare = [cell.strip("[]() ") for cell in (*heads, "")[:width]]
        stated = [cell for cell in bare if cell not in ("", "-")]
        if len(above) > 1 and abs(len(above[-2][1]) - width) <= 1 and all(map(_is_unit, stated)) and any(
                _is_unit(cell, bare=True) for cell in stated):
            units, (line, heads) = bare, above[-2]  # a row of units only, one of them of the bench's own quantities
        cells = [*heads, ""][:width]
    split = [split_heading(cell) if cell else (f"column {j + 1}", None) for j, cell in enumerate(cells)]
    names = [name for name, _ in split]
    names = [cells[j] if names.count(name) > 1 else name for j, name in enumerate(names)]
    for name, unit, (_, own) in zip(names, units, split, strict=True):
        if names.count(name) > 1:
            raise InputError(f"the heading {name!r} occurs twice; give each column its own", file=file, row=line)
        if unit and own and unit != own:
            problem = f"the heading says {own!r} and the unit row {unit!r}; correct one"
            raise InputError(problem, file=file, column=name, row=line)
    return names, [unit or own for unit, (_, own) in zip(units, split, strict=True)], line


def _find_decimal(cells: list[str], file: str) -> str:
    """The decimal sign; asks where commas could be thousands separators."""
    commas = [cell for cell in cells if "," in cell]
    if not commas:
        return "."
    both = next((cell for cell in commas if "." in cell), None)
    if both:
        raise InputError(f"{both!r} has a thousands separator; export the numbers without them", file=file)
    if any("." in cell for cell in cells):
        problem = f"some numbers have points and some commas ({commas[0]!r}); export them alike, or give --decimal"
        raise InputError(problem, file=file)
    if all(THOUSANDS.fullmatch(cell) for cell in commas):
        problem = f"{commas[0]!r} may have a decimal comma or a thousands separator; give --decimal , or --decimal ."
        raise InputError(problem, file=file)
    return ","
