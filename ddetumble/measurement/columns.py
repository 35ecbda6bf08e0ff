"""Which column of a laboratory's file holds which quantity: as told, by its heading, or by its unit."""

from collections.abc import Iterable
from dataclasses import dataclass

from .._errors import InputError
from .conditions import name_condition, read_unit
from .headings import expand_role, guess_role, read_pairs
from .kinds import KINDS, RecordKind
from .layout import RawFile, split_heading
from .units import Unit, check_unit, parse_unit, si_unit


ACCELERATION = "m/s^2"
FRICTION_TEST = "if it is a friction test, give --family " + next(kind.name for kind in KINDS.values() if kind.path)


@dataclass
class Plan:
    """The options of an import and the running account of decisions.

    Args:
        kind: Of the records.
        choices: Quantity to the column that was named for it.
        units: Unit by quantity or column, from --unit.
        keep: Further columns to the names that they get.
        si: SI unit of every quantity found so far.
        headings: Quantity to the heading it was read from, for messages.
        notes: Every decision, in sentences.
        mass: Effective mass [kg] that makes a force of an acceleration, or None.
    """

    kind: RecordKind
    choices: dict[str, str]
    units: dict[str, str]
    keep: dict[str, str]
    si: dict[str, str]
    headings: dict[str, str]
    notes: list[str]
    mass: float | None = None


def make_plan(kind: RecordKind, force, time, slip, record_column, units, keep, mass: float | None = None) -> Plan:
    """The options about columns, checked against the kind of records.

    Raises:
        InputError: An option that such records have no use for.
    """
    choices, extra = {}, {}
    keep = [keep] if isinstance(keep, str) else keep or []
    entries = keep.items() if isinstance(keep, dict) else [(None, column) for column in keep]
    for name, column in entries:
        if name is None:
            name, sign, rest = str(column).rpartition("=")
            name, column = (name.strip(), rest.strip()) if sign else (None, column)
        if name is not None:
            choices[expand_role(name, kind)] = column
        else:
            extra[column] = name_condition(split_heading(column)[0])
    if force is not None:
        if not kind.main:
            raise InputError(f"--force does not apply to the family {kind.name}")
        choices[kind.main] = force
    if slip is not None and not kind.path:
        raise InputError(f"--slip does not apply to the family {kind.name}; {FRICTION_TEST}")
    for role, column in (("time", time), ("slip", slip), ("record", record_column)):
        if column is not None:
            choices[role] = column
    return Plan(kind, choices, read_pairs("unit", units), extra, {}, {}, [], mass)


def choose_columns(raw: RawFile, plan: Plan) -> dict[str, str]:
    """Quantity to column: as told, by heading, and force, time or slip by their unit if nothing else has it.

    Raises:
        InputError: A column that is not there, or more than one that may be meant; the option is named.
    """
    columns, kind = raw.columns, plan.kind
    roles = {role: find_column(raw, column) for role, column in plan.choices.items()}
    guesses = {}
    for column in columns:
        role = guess_role(column, kind)
        if role and role not in roles and column not in roles.values():
            guesses.setdefault(role, []).append(column)
    options = {"time": "--time COLUMN", kind.path: "--slip COLUMN", kind.main: "--force COLUMN",
               "record": "--record-column COLUMN"}  # fmt: skip
    for role, found in guesses.items():
        if len(found) > 1:
            option = options.get(role, f"--keep {role}=COLUMN")
            problem = f"{role} can be any of {', '.join(found)}; say which with {option}"
            raise InputError(problem, file=raw.file)
        roles[role] = found[0]
    if not set(kind.independents) & set(roles):
        option = "--slip COLUMN, or --time COLUMN for a time series" if kind.path else "--time COLUMN"
        independent = kind.path or kind.independents[0]
        roles[independent] = _choose_by_unit(raw, independent, roles, option)
    if kind.main and kind.main not in roles:
        roles[kind.main] = _choose_by_unit(raw, kind.main, roles, "--force COLUMN", plan.mass is not None)
    if kind.path and kind.path not in roles:
        problem = f"there is a time and no slip: the file has {', '.join(columns)}; give --slip COLUMN, or export how "
        raise InputError(problem + "far the rubber has slid", file=raw.file)
    if kind.rates and not any(name in roles for name in kind.rates):
        problem = "no column is an angular velocity; choose with --keep angular_velocity_x=COLUMN and so on"
        raise InputError(problem, file=raw.file)
    for heading, name in plan.keep.items():
        column = find_column(raw, heading)
        if column not in roles.values():
            roles[name] = column
    plan.headings.update(roles)
    return roles


def find_column(raw: RawFile, text: str) -> str:
    """The column that an option names: by its heading with or without the unit, or by its number.

    Raises:
        InputError: The file has no such column.
    """
    columns, text = raw.columns, str(text).strip()
    if text in columns:
        return text
    if f"column {text}" in columns:
        return f"column {text}"
    name, unit = split_heading(text)
    if name in columns and unit is not None and unit == raw.units.get(name):
        return name
    raise InputError(f"there is no column {text!r}; the file has {_list_columns(raw)}", file=raw.file)


def _list_columns(raw: RawFile) -> str:
    """Headings of a file with their units."""
    return ", ".join(name + (f" [{raw.units[name]}]" if raw.units.get(name) else "") for name in raw.columns)


def _choose_by_unit(raw: RawFile, role: str, roles: dict[str, str], option: str, accelerations: bool = False) -> str:
    """The only column left whose unit measures the quantity; an acceleration where a mass makes a force of it."""
    dimensions = [check_unit(si_unit(role), role).dimension]
    if accelerations and role == "normal_force":
        dimensions.append(parse_unit(ACCELERATION).dimension)
    fits = []
    for dimension in dimensions:
        for column, unit in raw.units.items() if not fits else ():
            try:
                if unit and column not in roles.values() and check_unit(unit, "").dimension == dimension:
                    fits.append(column)
            except InputError:
                continue
    if len(fits) != 1:
        problem = f"cannot tell which column is the {role}: the file has {', '.join(raw.columns)}; give {option}"
        if any(name.casefold() == "file" for name in raw.columns):
            problem += f"; if it is the table of conditions, give --conditions {raw.file}"
        elif (role == "normal_force" and not accelerations
              and any(map(_is_acceleration, filter(None, raw.units.values())))):
            problem += "; --known 'effective_mass=1.2 kg' makes a force of an acceleration"
        elif role in ("time", "normal_force") and _has_path(raw.columns):
            problem += f", or, {FRICTION_TEST}"
        raise InputError(problem, file=raw.file)
    return fits[0]


def _has_path(columns: Iterable[str]) -> bool:
    """Whether a heading names a path, as records of some kind have it."""
    return any(kind.path and guess_role(column, kind) == kind.path for kind in KINDS.values() for column in columns)


def find_unit(raw: RawFile, role: str, column: str, plan: Plan) -> Unit:
    """Unit of a column, from --unit or its heading.

    Raises:
        InputError: None is stated, or one that does not measure the quantity.
    """
    given = {expand_role(split_heading(name)[0], plan.kind): unit for name, unit in plan.units.items()}
    text = plan.units.get(column) or given.get(role) or given.get(column) or raw.units.get(column)
    if text is None and role == "sequence":
        text = "1"
    name = "force" if role == plan.kind.main else role
    if text is None:
        problem = f"the unit is not stated; give it with --unit {name}={si_unit(role)} or what it is"
        raise InputError(problem, file=raw.file, column=column)
    if role == "normal_force" and _is_acceleration(text):
        if plan.mass is None:
            problem = "the column holds an acceleration; --known 'effective_mass=1.2 kg' makes a force of it"
            raise InputError(problem, file=raw.file, column=column)
        plan.notes.append(f"normal_force is {plan.mass:g} kg times the acceleration {column!r}.")
        unit = parse_unit(text)
        return Unit(text, unit.scale * plan.mass, 0.0, check_unit("N", role).dimension, "N")
    _note_contradiction(text, raw.units.get(column), role, name, plan)
    return read_unit(text, role, raw.file, column, name, f" (--unit {name}=… sets another)")


def _is_acceleration(text: str) -> bool:
    try:
        return parse_unit(text).dimension == parse_unit(ACCELERATION).dimension
    except InputError:
        return False


def _note_contradiction(text: str, heading: str | None, role: str, name: str, plan: Plan) -> None:
    """Tell of a unit given with --unit for a column whose heading states another of the same kind."""
    try:
        given, stated = check_unit(text, role), None if heading is None else check_unit(heading, role)
    except InputError:
        return
    if stated is not None and (given.scale, given.offset) != (stated.scale, stated.offset):
        ratio = given.scale / stated.scale
        times = f"{max(ratio, 1 / ratio):.4g} times {'less' if ratio > 1 else 'more'}"
        plan.notes.append(f"Units: --unit {name}={text} was taken although the heading says {heading}, {times}; leave "
                          "the option out if the heading is right.")
