"""What `predict` is asked for: records, their conditions, and the times (slips) at which they are wanted."""

import dataclasses as dc
from pathlib import Path

import numpy as np
import pandas as pd

from .._errors import InputError
from ..inference.archive import SavedModel
from ..measurement.layout import split_heading
from ..measurement.tables import Table, convert_column, read_table
from ..measurement.units import check_unit, parse_unit, si_unit


POSITIVE = ("approach_speed", "normal_load", "slip_speed")
NOT_NEGATIVE = ("initial_pressure", "internal_pressure", "temperature", "slip")


@dc.dataclass(frozen=True)
class Request:
    """Rows of CONDITIONS.csv, SI.

    Attributes:
        keys: record of every row, shape (rows,).
        values: conditions and the independent variable by name, each shape (rows,).
        timed: whether the independent variable is given; else every record has one row, and its times are chosen.
        notes: sentences on what is not read.
    """

    keys: np.ndarray
    values: dict[str, np.ndarray]
    timed: bool
    notes: tuple[str, ...]

    def groups(self) -> list[tuple[str, np.ndarray]]:
        """Every record with its rows, in the order in which they come."""
        found = pd.Series(np.arange(len(self.keys))).groupby(pd.Series(self.keys), sort=False).indices
        return [(str(key), rows) for key, rows in found.items()]

    def settings(self, names: tuple[str, ...]) -> dict[str, np.ndarray]:
        """Conditions by name, one value a record."""
        first = [rows[0] for _, rows in self.groups()]
        return {name: self.values[name][first] for name in names}

    def at(self, name: str, times: list[np.ndarray]) -> "Request":
        """The same records, each at times of its own."""
        rows = np.repeat([rows[0] for _, rows in self.groups()], [len(t) for t in times])
        values = {n: v[rows] for n, v in self.values.items()} | {name: np.concatenate(times)}
        return Request(self.keys[rows], values, True, self.notes)


def read_request(conditions: str | Path | pd.DataFrame, saved: SavedModel, names: tuple[str, ...]) -> Request:
    """Read what is wanted of a fitted model.

    Args:
        conditions: CSV file, or a table like it; a heading may carry a unit (`initial_pressure [MPa]`), SI else.
        saved: the model.
        names: of the conditions that it reads.

    Raises:
        InputError: a column is missing or holds no numbers, a unit of another quantity, conditions that no test can
            have, or that change within a record.
    """
    table = _from_frame(conditions) if isinstance(conditions, pd.DataFrame) else read_table(conditions)
    place, lines = table.file, table.lines
    abscissa = "slip" if saved.family == "slip" else "time"
    headings = _name_columns(table, (*names, "record", abscissa))
    timed = abscissa in headings
    if timed and "record" not in headings:
        raise InputError(f"there is no column 'record'; the file has {', '.join(table.columns)}", file=place)
    if "record" in headings:
        keys = np.array([cell.strip() for cell in table.columns["record"]], dtype=object)
    else:
        keys = np.array([f"r{k + 1:02d}" for k in range(len(table))], dtype=object)
    if (keys == "").any():
        raise InputError("the cell is empty; every row needs the key of its record", file=place, column="record",
                         row=lines[int(np.argmax(keys == ""))])
    asked, values = {name for e in saved.space.effects for name in e.requires}, {}
    for name in (*names, *([abscissa] if timed else [])):
        if name == "sequence" and name not in headings and name not in asked:
            values[name] = np.ones(len(keys))
            continue
        unit = {"time": "s", "slip": "m"}.get(name) or saved.units.get(name) or si_unit(name)
        if name not in headings:
            raise InputError(f"there is no column {name!r} [{unit}], which the model needs; the file has "
                             + ", ".join(table.columns), file=place)
        values[name] = _convert(table, headings[name], name, unit)
        _check_sign(name, values[name], place, headings[name][0], lines)
    if timed and abscissa == "slip":
        _refuse_reversal(keys, values["slip"], place, lines)
    if timed and saved.family == "tumble" and np.any(values["time"] < 0):
        raise InputError("a tumbling record begins at t = 0, with the rates given for it; times cannot be negative",
                         file=place, column="time", row=lines[int(np.argmax(values["time"] < 0))])
    extra = [name for name in headings if name not in (*names, "record", abscissa)]
    _refuse_changes(keys, {name: values[name] for name in names}, timed, place, lines)
    notes = (f"The model does not read {', '.join(extra)}: left out.",) if extra else ()
    return Request(keys, values, timed, notes)


def _from_frame(frame: pd.DataFrame) -> Table:
    """A data frame as a table of text, so that it meets the same checks as a file."""
    if not len(frame):
        raise InputError("the table of conditions has no rows")
    cells = {str(n): ["" if pd.isna(x) else repr(float(x)) if isinstance(x, (float, np.floating)) else str(x)
                      for x in frame[n]] for n in frame.columns}
    return Table("conditions", cells, np.arange(2, len(frame) + 2))


def _name_columns(table: Table, known: tuple[str, ...]) -> dict[str, tuple[str, str | None]]:
    """Heading and unit by name."""
    found: dict[str, tuple[str, str | None]] = {}
    for heading in table.columns:
        name, unit = (heading, None) if heading in known else split_heading(heading)
        if name in found:
            raise InputError(f"there are two columns of {name}: {found[name][0]!r} and {heading!r}; leave one out",
                             file=table.file, column=heading)
        found[name] = heading, unit
    return found


def _convert(table: Table, named: tuple[str, str | None], name: str, wanted: str) -> np.ndarray:
    """Numbers of a column in SI."""
    heading, text = named
    numbers = convert_column(table, heading)
    if text is None:
        return numbers
    try:
        unit = check_unit(text, name)
        if unit.dimension != parse_unit(wanted).dimension:
            raise InputError(f"{text!r} is no unit of {name}, which is in {wanted}")
    except InputError as error:
        raise InputError(error.problem, file=table.file, column=heading) from None
    return np.asarray(unit.convert(numbers), dtype=float)


def _refuse_changes(keys: np.ndarray, values: dict[str, np.ndarray], timed: bool, place: str, lines: np.ndarray
                    ) -> None:
    """The same conditions in all rows of a record; one row a record where no times are given."""
    first: dict[str, int] = {}
    for i, key in enumerate(keys):
        k = first.setdefault(key, i)
        if i != k and not timed:
            raise InputError(f"record {key!r} stands on line {lines[k]} already; without times there is one row a "
                             "record", file=place, column="record", row=lines[i])
        for name, column in values.items():
            if column[i] != column[k]:
                raise InputError(f"record {key!r} has {column[i]:g} here and {column[k]:g} on line {lines[k]}; a "
                                 "record has one value of each condition", file=place, column=name, row=lines[i])


def _refuse_reversal(keys: np.ndarray, slip: np.ndarray, place: str, lines: np.ndarray) -> None:
    """Slip counts from the start of a stroke: within a record it does not fall."""
    last: dict[str, float] = {}
    for i, key in enumerate(keys):
        if slip[i] < last.get(key, 0.0):
            raise InputError(f"slip falls within record {key!r}; it counts from the start of a stroke: give each "
                             "stroke a record of its own, in the order of its slip", file=place, column="slip",
                             row=lines[i])
        last[key] = float(slip[i])


def _check_sign(name: str, values: np.ndarray, place: str, heading: str, lines: np.ndarray) -> None:
    bad = values <= 0 if name in POSITIVE else values < 0 if name in NOT_NEGATIVE else np.zeros(len(values), dtype=bool)
    if bad.any():
        i = int(np.argmax(bad))
        rule = "has to be positive" if name in POSITIVE else "cannot be negative"
        remedy = "; pressures are absolute" if name == "initial_pressure" else ""
        raise InputError(f"{values[i]:g} {rule}{remedy}", file=place, column=heading, row=lines[i])
