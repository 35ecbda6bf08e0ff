"""Spreadsheets: rows of text cells by sheet, for the same search for headings, units and data as in a text file."""

import contextlib
import datetime as dt
import io
import zipfile
from pathlib import Path

from ..._settings import refuse_memory
from ..tables import CELLS


Rows = list[tuple[int, list[str]]]
MOST_EMPTY = 1000  # repeated cells of an OpenDocument row that are taken one by one: more are the rest of the sheet


def read_spreadsheet(path: Path) -> dict[str, Rows]:
    """Line number and cells of the rows with something in them, by sheet, in the order of the file."""
    with zipfile.ZipFile(path) as parts:  # says how large its parts are before they are unpacked
        refuse_memory(CELLS * sum(part.file_size for part in parts.infolist()), f"reading {path}")
    sheets = _read_open_document(path) if path.suffix.lower() == ".ods" else _read_excel(path)
    return {name: _trim(table) for name, table in sheets.items()}


def _trim(table: Rows) -> Rows:
    """Rows and columns with something in them, all rows of one length."""
    filled = sorted({j for _, cells in table for j, cell in enumerate(cells) if cell})
    return [(line, row) for line, cells in table if any(row := [cells[j] if j < len(cells) else "" for j in filled])]


def _write_cell(value, percent: bool = False) -> str:
    """A cell as text: numbers with all their digits, a percentage as it is shown."""
    if value is None:
        return ""
    if percent and isinstance(value, int | float):
        return f"{100 * value:.12g} %"
    if isinstance(value, dt.datetime | dt.date | dt.time | dt.timedelta):
        return f"date {value}"
    return str(value).strip()


def _read_excel(path: Path) -> dict[str, Rows]:
    import openpyxl

    found = {}
    with path.open("rb") as values, path.open("rb") as texts:
        book = openpyxl.load_workbook(values, read_only=True, data_only=True)
        formulas = openpyxl.load_workbook(texts, read_only=True)  # shown where no program has stored what they give
        for sheet in book.worksheets:
            other = formulas[sheet.title]
            sheet.reset_dimensions()
            other.reset_dimensions()
            found[sheet.title] = [
                (line, [_write_cell(cell.value if cell.value is not None else formula.value,
                                    "%" in str(cell.number_format)) for cell, formula in zip(row, shadow, strict=True)])
                for line, (row, shadow) in enumerate(zip(sheet.iter_rows(), other.iter_rows(), strict=True), 1)]
    return found


def _read_open_document(path: Path) -> dict[str, Rows]:
    from odf import opendocument, table, teletype

    with contextlib.redirect_stdout(io.StringIO()) as told:
        book = opendocument.load(str(path))
    if told.getvalue():  # odfpy prints a part that breaks off, and goes on with what stands before
        raise ValueError("a part of it is no XML")
    found = {}
    for sheet in book.getElementsByType(table.Table):
        rows, line = found.setdefault(sheet.getAttribute("name"), []), 1
        for row in sheet.getElementsByType(table.TableRow):
            cells = []
            for cell in row.childNodes:
                text, kind = teletype.extractText(cell), cell.getAttribute("valuetype")
                if kind == "float" and not text.startswith(("#", "Err:")):
                    text = cell.getAttribute("value")
                count = int(cell.getAttribute("numbercolumnsrepeated") or 1)
                cells += [text.strip()] * (count if text else min(count, MOST_EMPTY))
            repeats = int(row.getAttribute("numberrowsrepeated") or 1)
            if any(cells):
                rows += [(line + i, cells) for i in range(repeats)]
            line += repeats
    return found
