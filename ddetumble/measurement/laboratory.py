"""Import of a laboratory's raw files: a checked campaign, and in sentences everything that was decided on the way."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from .._errors import InputError
from .alignment import RawTest, align_tests, check_increase
from .campaign import FAMILIES, Campaign, Column, Uncertainty
from .conditions import Conditions, name_condition, read_conditions, read_names, read_options
from .headings import CONDITIONS, MAIN, PRESSURE, SPEED, expand_role, guess_role, read_pairs
from .layout import RawFile, read_layout
from .package import REQUIRED
from .tables import convert_column, pick_column
from .units import Unit, check_unit, parse_quantity, parse_uncertainty, si_unit


_CHANNELS = {
    "impact": ("normal_force", "tangential_force", "depression", "pressure", "slip"),
    "slip": ("tangential_force", "pressure", "depression"),
    "tumble": ("angular_velocity_x", "angular_velocity_y", "angular_velocity_z"),
}
_UNKNOWN = {
    "impact": ("effective_mass", "restitution"),
    "slip": ("adhesion_constant", "loss_factor", "slip_scale"),
    "tumble": ("inertia_ratio",),
}
_ENDINGS = (".csv", ".txt", ".tsv", ".dat", ".asc")


@dataclass
class _Plan:
    """The options and the running account of decisions."""

    family: str
    choices: dict[str, str]
    units: dict[str, str]
    keep: dict[str, str]
    si: dict[str, str]
    notes: list[str]


def import_tests(
    paths,
    *,
    conditions=None,
    pressure=None,
    speed=None,
    force=None,
    time=None,
    units=None,
    decimal=None,
    delimiter=None,
    record_column=None,
    uncertainty=None,
    onset=None,
    name_pattern=None,
    gauge=None,
    ambient=None,
    family="impact",
    title=None,
    keep=None,
    known=None,
) -> Campaign:
    """Turn raw files of a test bench into a campaign; what cannot be told is asked for, never guessed.

    Args:
        paths: Files, or folders with files; one test each, or several with a record column.
        conditions: Table with one row a file or record and one column a condition, units in the headings.
        pressure: Initial (slip: internal) pressure of all tests, with unit.
        speed: Approach (slip: sliding) speed of all tests, with unit.
        force: Name of the column with the force.
        time: Name of the column with the time.
        units: Units by quantity or column: {"force": "N"} or "force=N".
        decimal: "." or ",".
        delimiter: "," ";" "|" "tab" or "space".
        record_column: Name of the column that says which test a row belongs to.
        uncertainty: One standard deviation by quantity: {"normal_force": "0.25 N"} or "normal_force=0.25 N";
            where none is given, that of a channel is measured before contact.
        onset: Time of contact on the raw time axis, with unit, or the name of a column that holds it; None to find it.
        name_pattern: Conditions in the file names, like "{initial_pressure}MPa_{approach_speed}ms".
        gauge: True if the pressures count from the ambient pressure.
        ambient: Ambient pressure, with unit; made part of `known`.
        family: "impact", "slip" or "tumble".
        title: Title of the campaign.
        keep: Further columns: "COLUMN", or "quantity=COLUMN" to choose the column of a quantity.
        known: Parameters of the reference model: {"outer_diameter": "60 mm"} or "outer_diameter=60 mm"; value "null"
            or None where the fit has to find them.

    Returns:
        The campaign, not yet written; `notes` holds every decision as a sentence.

    Raises:
        InputError: Anything malformed or undecidable; the option to give is named.
    """
    if family not in FAMILIES:
        raise InputError(f"--family is impact, slip or tumble, not {family!r}")
    plan = _plan(family, force, time, record_column, units, keep)
    tests = []
    for file in _list_files(paths):
        tests += _read_tests(file, read_layout(file, delimiter=delimiter, decimal=decimal), plan)
    keys = [test.key for test in tests]
    for test in tests:
        if keys.count(test.key) > 1:
            problem = f"the record {test.key!r} is there twice; rename the file or the record in its column"
            raise InputError(problem, file=test.file)
    sources = Conditions(family)
    _collect_constants(tests, sources, plan)
    files = {test.key: test.file for test in tests}
    if conditions is not None:
        plan.notes += read_conditions(sources, conditions, files, ("onset",), plan.units)
    if name_pattern is not None:
        plan.notes += read_names(sources, name_pattern, files, plan.units)
    plan.notes += read_options(sources, keys, pressure, speed)
    parameters = _read_known(known, family)
    given = {expand_role(k, family): v for k, v in read_pairs("uncertainty", uncertainty).items()}
    spreads, clock = {}, None
    if family == "impact":
        spreads, clock = align_tests(tests, sources, onset, plan.notes)
    elif onset is not None:
        raise InputError(f"--onset does not apply to the family {family}: there is no contact to begin with")
    _make_absolute(tests, sources, gauge, ambient, parameters, plan)
    for name in REQUIRED[family]:
        if name not in sources.values:
            option = {PRESSURE[family]: "--pressure '1.0 MPa', ", SPEED[family]: "--speed '0.4 m/s', "}.get(name, "")
            raise InputError(f"{name} is not known; give {option}--conditions FILE.csv or --name-pattern")
    if family == "impact" and "outer_diameter" not in parameters:
        plan.notes.append("The ball's outer diameter is not stated; add it to known if the model is to use it.")
    return _assemble(tests, sources, parameters, given, spreads, clock, title, plan)


def _plan(family, force, time, record_column, units, keep) -> _Plan:
    choices, extra = {}, {}
    keep = [keep] if isinstance(keep, str) else keep or []
    entries = keep.items() if isinstance(keep, dict) else [(None, column) for column in keep]
    for name, column in entries:
        if name is None:
            name, sign, rest = str(column).rpartition("=")
            name, column = (name.strip(), rest.strip()) if sign else (None, column)
        if name is not None:
            choices[expand_role(name, family)] = column
        else:
            extra[column] = name_condition(column)
    main = MAIN[family]
    if force is not None:
        if main is None:
            raise InputError(f"--force does not apply to the family {family}")
        choices[main] = force
    for role, column in (("time", time), ("record", record_column)):
        if column is not None:
            choices[role] = column
    return _Plan(family, choices, read_pairs("unit", units), extra, {}, [])


def _list_files(paths) -> list[str]:
    files = []
    for path in [paths] if isinstance(paths, str | Path) else paths:
        path = Path(path)
        if path.is_dir():
            found = sorted(p for p in path.iterdir() if p.suffix.lower() in _ENDINGS and p.is_file())
            if not found:
                raise InputError(f"the folder holds no raw files ({', '.join(_ENDINGS)})", file=path)
            files += map(str, found)
        else:
            files.append(str(path))
    if not files:
        raise InputError("name at least one raw file to import")
    return files


def _read_tests(file: str, raw: RawFile, plan: _Plan) -> list[RawTest]:
    """The tests in one file, their columns chosen and converted to SI."""
    plan.notes += raw.notes
    table = raw.table
    roles = _choose_columns(raw, plan)
    values = {}
    for role, column in roles.items():
        if role == "record":
            continue
        unit = _column_unit(raw, role, column, plan)
        numbers = convert_column(table, column, decimal=raw.decimal, allow_missing=role not in ("time", "sequence"))
        values[role] = unit.convert(numbers)
        if plan.si.setdefault(role, unit.si) != unit.si:
            raise InputError("the unit is of another kind than in the files before", file=file, column=column)
    used = ", ".join(f"{role} from {column!r}" for role, column in roles.items())
    left = [column for column in table.columns if column not in roles.values()]
    plan.notes.append(f"{Path(file).name}: {used}; {'left out: ' + ', '.join(left) if left else 'no column left out'}.")
    if "record" not in roles:
        return [RawTest(Path(file).stem, file, table.lines, values)]
    cells = pick_column(table, roles["record"])
    tests = []
    for key in dict.fromkeys(cells):
        if not key:
            raise InputError("the cell is empty; every row needs its record", file=file, column=roles["record"],
                             row=table.lines[cells.index(key)])  # fmt: skip
        rows = np.array([cell == key for cell in cells])
        tests.append(RawTest(key, file, table.lines[rows], {name: v[rows] for name, v in values.items()}))
    return tests


def _choose_columns(raw: RawFile, plan: _Plan) -> dict[str, str]:
    """Quantity to column: as told, by heading, and the force and the time by their unit if nothing else has it."""
    columns, family = raw.table.columns, plan.family
    roles = {}
    for role, column in plan.choices.items():
        number = f"column {column}"
        roles[role] = number if column not in columns and number in columns else column
        pick_column(raw.table, roles[role])
    guesses = {}
    for column in columns:
        role = guess_role(column, family)
        if role and role not in roles and column not in roles.values():
            guesses.setdefault(role, []).append(column)
    for role, found in guesses.items():
        if len(found) > 1:
            option = {"time": "--time COLUMN", MAIN[family]: "--force COLUMN", "record": "--record-column COLUMN"}
            option = option.get(role, f"--keep {role}=COLUMN")
            problem = f"{role} can be any of {', '.join(found)}; say which with {option}"
            raise InputError(problem, file=raw.table.file)
        roles[role] = found[0]
    independent = ("time", "slip") if family == "slip" else ("time",)
    if not set(independent) & set(roles):
        roles["time"] = _choose_by_unit(raw, "time", roles, "--time COLUMN")
    main = MAIN[family]
    if main and main not in roles:
        roles[main] = _choose_by_unit(raw, main, roles, "--force COLUMN")
    if family == "tumble" and not any(name in roles for name in _CHANNELS["tumble"]):
        problem = "no column is an angular velocity; choose with --keep angular_velocity_x=COLUMN and so on"
        raise InputError(problem, file=raw.table.file)
    for column, name in plan.keep.items():
        if column in columns and column not in roles.values():
            roles[name] = column
        elif column not in columns:
            pick_column(raw.table, column)
    return roles


def _choose_by_unit(raw: RawFile, role: str, roles, option: str) -> str:
    dimension = check_unit(si_unit(role), role).dimension
    fits = []
    for column, unit in raw.units.items():
        try:
            if unit and column not in roles.values() and check_unit(unit, "").dimension == dimension:
                fits.append(column)
        except InputError:
            continue
    if len(fits) != 1:
        problem = f"cannot tell which column is the {role}: the file has {', '.join(raw.table.columns)}; give {option}"
        raise InputError(problem, file=raw.table.file)
    return fits[0]


def _column_unit(raw: RawFile, role: str, column: str, plan: _Plan) -> Unit:
    short = {expand_role(name, plan.family): unit for name, unit in plan.units.items()}
    text = plan.units.get(column) or short.get(role) or raw.units.get(column)
    if text is None and role == "sequence":
        text = "1"
    name = "force" if role == MAIN[plan.family] else role
    if text is None:
        problem = f"the unit is not stated; give it with --unit {name}={si_unit(role)} or what it is"
        raise InputError(problem, file=raw.table.file, column=column)
    try:
        return check_unit(text, role)
    except InputError as error:
        problem = error.problem
        if "gauge" in problem:
            problem = f"{text!r} is a gauge pressure; give --unit {name}=bar --gauge and --ambient '101.3 kPa'"
        raise InputError(f"{problem} (--unit {name}=… sets another)", file=raw.table.file, column=column) from None


def _collect_constants(tests, sources: Conditions, plan: _Plan) -> None:
    """Move columns that do not change within a test from the samples to the conditions."""
    family = plan.family
    for name in list(dict.fromkeys(name for test in tests for name in test.values)):
        condition = PRESSURE[family] if name == "pressure" else name
        wanted = name in CONDITIONS[family]
        if name in ("time", *(c for c in _CHANNELS[family] if c != "pressure")):
            continue
        absent = next((test for test in tests if name not in test.values), None)
        if absent is not None:
            problem = f"{name} is missing here and present in other files; leave it out or add it"
            raise InputError(problem, file=absent.file)
        varying = next((test for test in tests if not _is_constant(test.values[name])), None)
        if varying is not None and wanted:
            if name in plan.choices:
                problem = f"{name} is a condition and changes within record {varying.key!r}; choose another column"
                raise InputError(problem, file=varying.file)
            for test in tests:
                test.values.pop(name)
            plan.notes.append(f"The column for {name} changes within a test: it is no condition and was left out.")
        if varying is None:
            found = {test.key: float(test.values.pop(name)[0]) for test in tests}
            sources.add(condition, found, plan.si[name], f"the raw column {name}")
            plan.notes.append(f"{condition} was read from a column that does not change within a test.")


def _is_constant(values: np.ndarray) -> bool:
    values = values[~np.isnan(values)]
    return bool(values.size) and bool(np.all(values == values[0]))


def _read_known(known, family) -> dict[str, float | None]:
    parameters = dict.fromkeys(_UNKNOWN[family])
    pairs = known if isinstance(known, dict) else read_pairs("known", known)
    for name, value in pairs.items():
        parameters[name] = None if value in (None, "null", "") else parse_quantity(value, name)
    return parameters


def _make_absolute(tests, sources, gauge, ambient, parameters, plan) -> None:
    """Turn gauge pressures into absolute ones."""
    if ambient is not None:
        parameters["ambient_pressure"] = parse_quantity(ambient, "ambient_pressure")
    name = PRESSURE[plan.family]
    if name is None:
        return
    if not gauge:
        plan.notes.append("Pressures were taken as absolute; if they are gauge pressures, give --gauge and --ambient.")
        return
    if ambient is None:
        raise InputError("gauge pressures need the ambient pressure of the day; give --ambient '101.3 kPa'")
    for key in sources.values.get(name, {}):
        sources.values[name][key] += parameters["ambient_pressure"]
    for test in tests:
        if "pressure" in test.values:
            test.values["pressure"] = test.values["pressure"] + parameters["ambient_pressure"]
    shown = f"{parameters['ambient_pressure']:g} Pa"
    plan.notes.append(f"The ambient pressure of {shown} was added to the gauge pressures.")


def _assemble(tests, sources, parameters, given, spreads, clock, title, plan) -> Campaign:
    """Put records, samples and uncertainties together."""
    family = plan.family
    independent = "time" if "time" in tests[0].values else "slip"
    present = dict.fromkeys(name for test in tests for name in test.values if name != independent)
    names = [name for name in _CHANNELS[family] if name in present]
    names += [name for name in present if name not in names]
    uncertainties = {}
    for name in (independent, *names, *sources.values):
        unit = plan.si.get(name) or sources.units.get(name) or "1"
        if name in given:
            uncertainties[name] = parse_uncertainty(given.pop(name), check_unit(unit, name), name)
        elif name in names:
            spread = spreads.get(name, 0.0)
            if not spread > 0:
                example = f"--uncertainty {name}='0.25 {unit}'"
                how = "cannot be measured before contact" if plan.family == "impact" else "is not known"
                raise InputError(f"the uncertainty of {name} {how}; give {example}")
            uncertainties[name] = Uncertainty(float(f"{spread:.4g}"))
            plan.notes.append(f"The uncertainty of {name} is {spread:.4g} {unit}, measured before contact.")
        elif name == "time" and clock:
            uncertainties[name] = Uncertainty(float(f"{clock:.4g}"))
    exact = [name for name in sources.values if name not in uncertainties and name != "sequence"]
    if exact:
        plan.notes.append(f"No uncertainty is stated for {', '.join(exact)}; --uncertainty {exact[0]}='0.5 %' would.")
    if given:
        raise InputError(f"--uncertainty names {', '.join(given)}, which the campaign does not have")
    frames = []
    for test in tests:
        check_increase(test, independent)
        frame = pd.DataFrame({"record": test.key} | {n: test.values.get(n, np.nan) for n in (independent, *names)},
                             index=range(len(test.lines)))  # fmt: skip
        frames.append(frame)
    keys = pd.Index([test.key for test in tests], name="record", dtype=object)
    order = [name for name in CONDITIONS[family] if name in sources.values]
    order += [name for name in sources.values if name not in order]
    records = pd.DataFrame({n: [sources.values[n][key] for key in keys] for n in order}, index=keys)
    columns = {name: Column(name, plan.si.get(name) or "1", uncertainties.get(name)) for name in (independent, *names)}
    return Campaign(
        name="",
        title=title or f"Imported {family} tests",
        family=family,
        path=None,
        known=parameters,
        records=records,
        conditions={n: Column(n, sources.units[n], uncertainties.get(n)) for n in order},
        independent=columns.pop(independent),
        channels=columns,
        samples=pd.concat(frames, ignore_index=True),
        sources=tuple({"title": Path(file).name} for file in dict.fromkeys(test.file for test in tests)),
        notes=tuple(plan.notes),
    )
