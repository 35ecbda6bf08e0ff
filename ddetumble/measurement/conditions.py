"""Conditions of a laboratory's tests from where they are written: a table, file names, or the command line."""

import re
from pathlib import Path

import numpy as np

from .._errors import InputError
from .checks import IMPORT_REMEDY, check_values
from .headings import guess_role, is_counter
from .kinds import RecordKind
from .layout import read_layout
from .tables import Table, convert_column
from .units import ROLES, Unit, check_unit, parse_quantity, si_unit


class Conditions:
    """Conditions as they come in, each from one source only; all values SI.

    Args:
        kind: Of the records.
    """

    def __init__(self, kind: RecordKind):
        self.kind = kind
        self.values: dict[str, dict[str, float]] = {}
        self.units: dict[str, str] = {}
        self.sources: dict[str, str] = {}
        self.places: dict[str, dict[str, tuple[str | None, str | None, int | None]]] = {}
        self.headings: list[str] = []

    def add(self, name: str, values: dict[str, float], unit: str, source: str, places=None) -> None:
        """Add a condition: `values` by record key; `places` gives file, column and line of each, where there are some.

        Raises:
            InputError: Another source gives it as well.
        """
        if name in self.values:
            raise InputError(f"{name} is given twice, by {self.sources[name]} and by {source}; keep one")
        self.values[name], self.units[name], self.sources[name] = values, unit, source
        self.places[name] = places or {}

    def check(self, gauge: bool = False) -> None:
        """Refuse values that the conditions cannot have; `gauge` where the ambient pressure is in them already.

        Raises:
            InputError: One of them; its place in the laboratory's own files is named.
        """
        for name, values in self.values.items():
            for key, value in values.items():
                try:
                    check_values(name, np.array([value]), Table("", {}, np.array([1])), "records", None,
                                 "" if gauge else IMPORT_REMEDY)
                except InputError as error:
                    file, column, row = self.places[name].get(key, (None, None, None))
                    problem = f"{name} of record {key!r}: {error.problem}"
                    problem += "" if file else f" (given by {self.sources[name]})"
                    raise InputError(problem, file=file, column=column, row=row) from None


def read_options(conditions: Conditions, keys: list[str], pressure, speed, load=None) -> list[str]:
    """Add what --pressure, --speed and --load say for all records; returns what was decided."""
    notes = []
    kind = conditions.kind
    names = (("pressure", pressure, kind.pressure), ("speed", speed, kind.speed), ("load", load, kind.load))
    for option, given, name in names:
        if given is None:
            continue
        if not name:
            raise InputError(f"--{option} does not apply to the family {kind.name}")
        value = _option(option, given, name)
        conditions.add(name, dict.fromkeys(keys, value), check_unit(si_unit(name), name).si, f"--{option}")
        notes.append(f"{name} is {value:g} {si_unit(name)} for all records, as given with --{option}.")
    return notes


def read_conditions(conditions: Conditions, path, records: dict[str, str], extra, units) -> list[str]:
    """Add the columns of a table of conditions with one row a file or record.

    Args:
        conditions: Where to add them.
        path: The table: a column `file` or `record`, then one column a condition, with units in the headings.
        records: Record key to name of its raw file.
        extra: Names of further columns that are wanted beside conditions (`onset`).
        units: Units by column name, from --unit.

    Raises:
        InputError: No such columns, a record without a row or with two, a column without a unit.
    """
    raw = read_layout(path)
    table = raw
    links = {name.casefold(): name for name in table.columns if name.casefold() in ("file", "record")}
    for name in table.columns:
        if not links and guess_role(name, conditions.kind) == "record":
            links["record"] = name
    if not links:
        raise InputError("the table needs a column file or record that says which test a row is for", file=path)
    rows = _match(table, links, records)
    conditions.headings = [column for column in table.columns if column not in links.values()]
    notes = [f"Conditions were read from {Path(path).name}.", *raw.notes]
    unused = sorted(set(range(len(table))) - set(rows.values()))
    if unused:
        notes.append(f"{Path(path).name}: {len(unused)} rows belong to no test that was imported.")
    for column in table.columns:
        if column in links.values():
            continue
        if is_counter(column):
            notes.append(f"The column {column} only counts repeats: it is no condition and was left out.")
            continue
        role = guess_role(column, conditions.kind)
        role = (conditions.kind.pressure or None) if role == "pressure" else role
        name = role if role is not None and role in conditions.kind.conditions else name_condition(column)
        unit = units.get(column) or units.get(name) or raw.units[column] or ("1" if name == "sequence" else None)
        if unit is None:
            near = si_unit(role) if role is not None else "mm"
            problem = f"the column has no unit; write it into the heading like '{column} [{near}]', or give --unit "
            raise InputError(problem + f"{name}={near}", file=table.file, column=column)
        quantity = "time" if name in extra else name
        checked = read_unit(unit, quantity, table.file, column)
        values = checked.convert(convert_column(table, column, decimal=raw.decimal))
        found = {key: float(values[row]) for key, row in rows.items()}
        places = {key: (table.file, column, int(table.lines[row])) for key, row in rows.items()}
        conditions.add(name, found, checked.si, f"{Path(path).name}", places)
    return notes


def read_names(conditions: Conditions, pattern: str, records: dict[str, str], units) -> list[str]:
    """Add conditions that stand in the file names.

    Args:
        conditions: Where to add them.
        pattern: The name without its ending, like `{initial_pressure}MPa_{approach_speed}ms`; a unit may stand in the
            braces (`{initial_pressure:MPa}`), and `{}` or `{_}` matches anything.
        records: Record key to name of its raw file.
        units: Units by condition, from --unit.

    Raises:
        InputError: A broken pattern, a name that does not match it, or a number without a unit.
    """
    parts = re.split(r"\{([^{}]*)\}", pattern)
    if len(parts) < 3 or any("{" in part or "}" in part for part in parts[::2]):
        raise InputError(f"--name-pattern {pattern!r} needs braces around names, like '{{initial_pressure}}MPa'")
    expression, fields = re.escape(parts[0]), []
    for field, after in zip(parts[1::2], parts[2::2], strict=True):
        name, _, unit = field.partition(":")
        if name in ("", "_"):
            expression += ".*?" + re.escape(after)
            continue
        unit = units.get(name) or unit or _unit_after(after, name)
        if name in (known for known, _ in fields):
            raise InputError(f"--name-pattern {pattern!r} has {name} twice")
        if unit is None:
            problem = f"--name-pattern does not say the unit of {name}: write {{{name}:MPa}} or the like"
            raise InputError(problem)
        fields.append((name, read_unit(unit, name, "--name-pattern", name)))
        expression += r"([-+]?\d+(?:[.,]\d+)?(?:[eE][-+]?\d+)?)" + re.escape(after)
    values = {name: {} for name, _ in fields}
    for key, file in records.items():
        match = re.fullmatch(expression, Path(file).stem)
        if match is None:
            raise InputError(f"the file name does not match --name-pattern {pattern!r}", file=file)
        for (name, unit), text in zip(fields, match.groups(), strict=True):
            values[name][key] = float(unit.convert(float(text.replace(",", "."))))
    for name, unit in fields:
        places = {key: (file, None, None) for key, file in records.items()}
        conditions.add(name, values[name], unit.si, "--name-pattern", places)
    shown = ", ".join(f"{name} in {unit.text}" for name, unit in fields)
    return [f"From the file names: {shown}."]


def _match(table, links, records) -> dict[str, int]:
    """Row of the table for each record."""
    rows = {}
    for i in range(len(table)):
        for key, file in records.items():
            names = {"file": (file, Path(file).name, Path(file).stem), "record": (key,)}
            if all(table.columns[column][i] in names[link] for link, column in links.items()):
                if key in rows:
                    problem = f"record {key!r} has a row already on line {table.lines[rows[key]]}; keep one"
                    raise InputError(problem, file=table.file, row=table.lines[i])
                rows[key] = i
    for key, file in records.items():
        if key not in rows:
            what = f"record {key!r}" + ("" if Path(file).stem == key else f" of {Path(file).name}")
            raise InputError(f"no row is for {what}; add one (columns {', '.join(links.values())})", file=table.file)
    return rows


def _unit_after(text: str, name: str) -> str | None:
    """The unit that the pattern's text begins with: `MPa_` is MPa, and `ms` after a speed is m/s."""
    begin = re.match(r"[^\W\d_]*(?:-[^\W\d_]+)?", text)
    letters = begin[0] if begin else ""
    if ROLES.get(name) == "speed":
        letters = {"ms": "m/s", "mps": "m/s", "mms": "mm/s", "cms": "cm/s"}.get(letters.split("-")[0], letters)
    for end in range(len(letters), 0, -1):
        try:
            return check_unit(letters[:end], name).text
        except InputError:
            continue
    return None


def read_unit(text: str, role: str, file: str, column: str, name: str = "", more: str = "") -> Unit:
    """A stated unit.

    Args:
        text: the unit as stated.
        role: the quantity that it has to measure.
        file, column: where it stands.
        name: of the quantity in `--unit` (default: the role's own).
        more: what a message ends with.

    Raises:
        InputError: It does not measure that quantity; of a gauge pressure the message says which options settle it.
    """
    try:
        return check_unit(text, role)
    except InputError as error:
        problem = error.problem
        if "gauge" in problem:
            problem = f"{text!r} is a gauge pressure; give --unit {name or role}=bar --gauge and --ambient '101.3 kPa'"
        raise InputError(problem + more, file=file, column=column) from None


def _option(option: str, given, name: str) -> float:
    try:
        return parse_quantity(given, name)
    except InputError as error:
        raise InputError(f"--{option}: {error.problem}") from None


def name_condition(text: str) -> str:
    """A column's name for a heading: lower case, words joined by underscores."""
    return re.sub(r"\W+", "_", text).strip("_").lower() or "condition"
