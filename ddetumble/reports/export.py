"""Campaigns and results as tables for spreadsheet programs: one workbook with a sheet a table, or one table as CSV."""

import io
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from .._errors import InputError
from .._settings import refuse_memory
from ..measurement.campaign import Campaign, Column
from ..measurement.checks import unit_of_known
from ..measurement.kinds import find_kind


RESULTS = ("result.json", "fit.json", "posterior.json", "compare.json")  # of a folder, the first one that is there
MOST_ROWS = 2**20 - 1  # of a sheet of .xlsx below its headings, by its standard
CELL = 100  # bytes of memory that a cell of a workbook takes while it is written
Tables = Mapping[str, pd.DataFrame]


def tabulate_campaign(campaign: Campaign) -> Tables:
    """Tables of a campaign by name, in SI with units in the headings: `about`, `records`, and `samples` or `peaks`."""
    along = campaign.independent
    columns = [*campaign.conditions.values(), *([along] if along else []), *campaign.channels.values(),
               *campaign.peak_columns.values()]
    about = [("title", campaign.title, ""), ("family", campaign.family, "")]
    kind = find_kind(campaign.family)
    about += [(f"known {name}", value, unit_of_known(name, kind)) for name, value in campaign.known.items()]
    for column in columns:
        for what, sd in (("uncertainty", column.uncertainty), ("common uncertainty", column.common)):
            if sd is not None:
                about += [(f"{what} of {column.name}", sd.relative, "of the value")] * (sd.relative is not None)
                about += [(f"{what} of {column.name}", sd.absolute, column.unit)] * (sd.absolute is not None)
        about += [(f"description of {column.name}", column.description, "")] * bool(column.description)
    tables = {"about": pd.DataFrame(about, columns=["item", "value", "unit"]),
              "records": _head(campaign.records.rename_axis("record").reset_index(), campaign.conditions)}
    if campaign.samples is not None and along is not None:
        tables["samples"] = _head(campaign.samples, {along.name: along, **campaign.channels})
    if campaign.peaks is not None:
        tables["peaks"] = _head(campaign.peaks.rename_axis("record").reset_index(), campaign.peak_columns)
    return tables


def tabulate_results(folder) -> Tables:
    """Tables of what a command wrote for programs, by name: each list or table of entries, the rest as `summary`.

    Raises:
        InputError: The folder holds no results.
    """
    path = next((file for name in RESULTS if (file := Path(folder) / name).is_file()), None)
    if path is None:
        raise InputError(f"this is neither a campaign nor a folder with results ({', '.join(RESULTS)})", file=folder)
    try:
        tree = json.loads(path.read_text(encoding="utf-8"))
        items = tree.items()
    except (OSError, ValueError, AttributeError, RecursionError) as error:
        raise InputError(f"the results cannot be read ({error}); run the command again", file=path) from None
    tables, summary = {}, []
    for name, value in items:
        rows = [{"name": key} | one for key, one in value.items() if isinstance(one, dict)] if isinstance(
            value, dict) else [one for one in value if isinstance(one, dict)] if isinstance(value, list) else []
        if rows:
            tables[name] = pd.DataFrame([{key: _write_cell(cell) for key, cell in row.items()} for row in rows])
        else:
            summary.append((name, _write_cell(value)))
    return {"summary": pd.DataFrame(summary, columns=["item", "value"]), **tables}


def write_workbook(tables: Tables) -> bytes:
    """Tables as an .xlsx file, a sheet each; texts stay texts, also where they begin like a formula.

    Raises:
        InputError: A table has more rows than a sheet can hold, or the library is missing.
    """
    refuse_memory(CELL * sum(table.size for table in tables.values()), "writing the workbook")
    try:
        import openpyxl
        from openpyxl.cell import WriteOnlyCell
        from openpyxl.cell.cell import ILLEGAL_CHARACTERS_RE
    except ImportError:
        raise InputError(".xlsx files are written by openpyxl, which is not installed; install it with "
                         'pip install "ddetumble[formats]"') from None
    book = openpyxl.Workbook(write_only=True)
    for name, table in tables.items():
        if len(table) > MOST_ROWS:
            raise InputError(f"the table {name} has {len(table)} rows and a sheet of .xlsx holds {MOST_ROWS}; use the "
                             "CSV files of the campaign")
        sheet = book.create_sheet(name[:31])

        def write(value, sheet=sheet):
            """A text as a cell that no program takes for a formula; else the value, None where there is none."""
            if not isinstance(value, str):
                return None if value != value else value
            cell = WriteOnlyCell(sheet, ILLEGAL_CHARACTERS_RE.sub(" ", value))
            cell.data_type = "s"
            return cell

        for row in (table.columns, *table.astype(object).itertuples(index=False, name=None)):
            sheet.append([*map(write, row)])
    stream = io.BytesIO()
    book.save(stream)
    return stream.getvalue()


def _head(table: pd.DataFrame, columns: Mapping[str, Column]) -> pd.DataFrame:
    """The table with units in its headings."""
    units = {name: column.unit for name, column in columns.items() if column.unit not in ("", "1")}
    return table.rename(columns={name: f"{name} [{unit}]" for name, unit in units.items()})


def _write_cell(value: Any) -> Any:
    """A value of a JSON file as one cell."""
    plain = isinstance(value, Iterable) and not isinstance(value, str | dict)
    if plain and all(isinstance(one, str | int | float) for one in value):
        return ", ".join(map(str, value))
    return json.dumps(value) if isinstance(value, list | dict) else value
