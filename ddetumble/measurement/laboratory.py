"""Import of a laboratory's raw files: a checked campaign, and in sentences everything that was decided on the way."""

import difflib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from .._errors import InputError
from .alignment import RawTest, align_tests, check_increase
from .campaign import Campaign, Column
from .checks import FEWEST_SAMPLES, IMPORT_REMEDY, check_finite, check_known, check_values
from .columns import Plan, choose_columns, find_unit, make_plan
from .conditions import Conditions, read_conditions, read_names, read_options
from .faults import find_truncated
from .friction import take_means, turn_friction
from .headings import expand_role, read_pairs
from .kinds import DEFAULT_KIND, RecordKind, find_kind, take_kind
from .layout import RawFile, read_layout
from .plausibility import check_plausibility
from .tables import Table, convert_column, pick_column
from .tumbling import start_clocks, turn_axes
from .units import ROLES, Uncertainty, check_unit, parse_quantity, parse_uncertainty, si_unit


_ENDINGS = (".csv", ".txt", ".tsv", ".dat", ".asc")


def import_tests(
    paths,
    *,
    conditions=None,
    pressure=None,
    speed=None,
    load=None,
    force=None,
    time=None,
    slip=None,
    units=None,
    decimal=None,
    delimiter=None,
    record_column=None,
    uncertainty=None,
    common_uncertainty=None,
    onset=None,
    name_pattern=None,
    gauge=None,
    ambient=None,
    family=DEFAULT_KIND,
    title=None,
    keep=None,
    known=None,
    symmetry_axis=None,
) -> Campaign:
    """Turn raw files of a test bench into a campaign; what cannot be told is asked for, never guessed.

    Args:
        paths: Files, or folders with files; one test each, or several with a record column.
        conditions: Table with one row a file or record and one column a condition, units in the headings.
        pressure: Initial (slip: internal) pressure of all tests, with unit.
        speed: Approach (slip: sliding) speed of all tests, with unit.
        load: Normal load of all tests of the family slip, with unit.
        force: Name of the column with the force (slip: with the friction).
        time: Name of the column with the time.
        slip: Name of the column with the slip, of the family slip.
        units: Units by quantity or column: {"force": "N"} or "force=N".
        decimal: "." or ",".
        delimiter: "," ";" "|" "tab" or "space".
        record_column: Name of the column that says which test a row belongs to.
        uncertainty: One standard deviation by quantity: {"normal_force": "0.25 N"} or "normal_force=0.25 N";
            where none is given, that of a channel is measured before contact.
        common_uncertainty: The same of the error that all records share: {"pressure": "2 %"} of a gauge whose
            calibration is in doubt.
        onset: Time of contact on the raw time axis, with unit, or the name of a column that holds it; None to find it.
        name_pattern: Conditions in the file names, like "{initial_pressure}MPa_{approach_speed}ms".
        gauge: True if the pressures count from the ambient pressure.
        ambient: Ambient pressure, with unit; made part of `known`.
        family: "impact", "slip" or "tumble", or `FILE.py:NAME` or a `Family` for a kind of tests of your own.
        title: Title of the campaign.
        keep: Further columns: "COLUMN", or "quantity=COLUMN" to choose the column of a quantity.
        known: Parameters of the reference model: {"outer_diameter": "60 mm"} or "outer_diameter=60 mm"; value "null"
            or None where the fit has to find them. Of an impact whose acceleration was measured, the effective mass.
        symmetry_axis: "x", "y" or "z": the body's axis of symmetry in the columns of the family tumble; made z.

    Returns:
        The campaign, not yet written; `notes` holds every decision as a sentence.

    Raises:
        InputError: Anything malformed or undecidable; the option to give is named.
    """
    try:
        kind = find_kind(take_kind(family))
    except InputError as error:
        raise error if error.file is not None else InputError(f"--{error.problem}") from None
    family = kind.name
    parameters = _read_known(known, kind)
    plan = make_plan(kind, force, time, slip, record_column, units, keep, parameters.get("effective_mass"))
    tests = []
    for file in _list_files(paths, conditions):
        tests += _read_tests(file, read_layout(file, delimiter=delimiter, decimal=decimal), plan)
    keys = [test.key for test in tests]
    for test in tests:
        if keys.count(test.key) > 1:
            problem = f"the record {test.key!r} is there twice; rename the file or the record in its column"
            raise InputError(problem, file=test.file)
    sources = Conditions(kind)
    means = _collect_constants(tests, sources, plan)
    files = {test.key: test.file for test in tests}
    if conditions is not None:
        plan.notes += read_conditions(sources, conditions, files, ("onset",), plan.units)
    if name_pattern is not None:
        plan.notes += read_names(sources, name_pattern, files, plan.units)
    plan.notes += read_options(sources, keys, pressure, speed, load)
    for name, found in means.items():
        if name not in sources.values:
            sources.add(name, found, si_unit(name), "its column along the tests")
            plan.notes.append(f"{name} is the mean of its column over each test.")
        else:
            plan.notes.append(f"{name} is that of {sources.sources[name]}; its column along the tests was left out.")
    given = {expand_role(k, kind): v for k, v in read_pairs("uncertainty", uncertainty).items()}
    if kind.rates and "angular_velocity" in given:  # of all three axes
        given = dict.fromkeys(kind.rates, given.pop("angular_velocity")) | given
    shared = {expand_role(k, kind): v for k, v in read_pairs("common-uncertainty", common_uncertainty).items()}
    spreads, clock, commons = {}, None, {}
    if kind.has_contact:
        spreads, clock, commons = align_tests(tests, sources, onset, plan.notes)
    elif onset is not None:
        raise InputError(f"--onset does not apply to the family {family}: there is no contact to begin with")
    if kind.path:
        turn_friction(tests, plan.notes)
    if kind.rates:
        turn_axes(tests, symmetry_axis, plan.notes)
        start_clocks(tests, plan.notes)
    elif symmetry_axis is not None:
        raise InputError(f"--symmetry-axis does not apply to the family {family}")
    _make_absolute(tests, sources, gauge, ambient, parameters, plan)
    for name in kind.needs:
        if name not in sources.values:
            _ask_condition(name, sources, conditions)
    sources.check(bool(gauge))
    descriptive, undescribed = kind.described
    if descriptive and not set(descriptive) & set(parameters):
        plan.notes.append(undescribed)
    if "tangential_speed" in kind.conditions and "tangential_speed" in sources.values:
        if not any("tangential_force" in test.values for test in tests):
            plan.notes.append("The tests have a tangential speed and no tangential force was taken, so the friction "
                              "stays unused; --keep tangential_force=COLUMN takes it.")
        elif "rolling_mass" not in parameters:
            plan.notes.append("rolling_mass is not stated (two thirds of the mass of a thin hollow ball, 1e6 kg where "
                              "the ball cannot turn): 0.5 kg is taken; --known 'rolling_mass=0.4 kg' states it.")
    plan.notes[:] = _condense(plan.notes, [Path(file).name for file in files.values()])
    campaign = _assemble(tests, sources, parameters, given, spreads, clock, (shared, commons), title, plan)
    doubts = (*find_truncated(campaign), *check_plausibility(campaign))
    return replace(campaign, notes=(*campaign.notes, *map(str, doubts)))


def _ask_condition(name: str, sources: Conditions, table) -> None:
    """Refuse a campaign without a condition that its family needs; says where it may stand."""
    usual = f"--conditions FILE.csv with a column {name}", name
    option, heading = sources.kind.options.get(name, usual)
    if table is None:
        raise InputError(f"{name} is not known; give {option}, --conditions FILE.csv or --name-pattern")
    problem = f"{name} is not known: none of the columns {', '.join(sources.headings)} holds it; add one, like "
    raise InputError(f"{problem}{heading!r}, or give {option}", file=table)


def _condense(notes: list[str], files: list[str]) -> list[str]:
    """The notes with those alike about several files told once."""
    told: dict[str, list[str]] = {}
    for note in notes:
        name, colon, rest = note.partition(": ")
        told.setdefault(rest if colon and name in files else note, []).append(name)
    short = []
    for rest, names in told.items():
        more = f" and {len(names) - 1} more" if len(names) > 1 else ""
        short.append(f"{names[0]}{more}: {rest}" if names[0] in files else rest)
    return short


def _list_files(paths, conditions=None) -> list[str]:
    """Files as given, and those in folders, but for the table of conditions."""
    files, table = [], None if conditions is None else Path(conditions).resolve()
    for path in [paths] if isinstance(paths, str | Path) else paths:
        path = Path(path)
        found = [path]
        if path.is_dir():
            found = sorted(p for p in path.iterdir() if p.suffix.lower() in _ENDINGS and p.is_file())
            if not [p for p in found if p.resolve() != table]:
                raise InputError(f"the folder holds no raw files ({', '.join(_ENDINGS)})", file=path)
        files += [str(p) for p in found if p.resolve() != table]
    if not files:
        raise InputError("name at least one raw file to import")
    return files


def _read_tests(file: str, raw: RawFile, plan: Plan) -> list[RawTest]:
    """The tests in one file, their columns chosen and converted to SI."""
    plan.notes += raw.notes
    table = raw
    roles = choose_columns(raw, plan)
    values = {}
    for role, column in roles.items():
        if role == "record":
            continue
        unit = find_unit(raw, role, column, plan)
        needed = role in ("time", "sequence") or role == plan.kind.path and "time" not in roles
        numbers = convert_column(table, column, decimal=raw.decimal, allow_missing=not needed)
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
        if not key or not key.isprintable():
            problem = "the cell holds control characters" if key else "the cell is empty; every row needs its record"
            raise InputError(problem, file=file, column=roles["record"], row=table.lines[cells.index(key)])
        rows = np.array([cell == key for cell in cells])
        tests.append(RawTest(key, file, table.lines[rows], {name: v[rows] for name, v in values.items()}))
    return tests


def _collect_constants(tests, sources: Conditions, plan: Plan) -> dict[str, dict[str, float]]:
    """Move columns that do not change within a test from the samples to the conditions.

    Returns:
        Means of loads and pressures that were measured along slip tests, for where nothing else gives them.
    """
    kind, means = plan.kind, {}
    for name in list(dict.fromkeys(name for test in tests for name in test.values)):
        condition = kind.pressure or name if name == "pressure" else name
        wanted = name in kind.conditions
        if name == "time" or name in kind.series and name != "pressure":
            continue
        absent = next((test for test in tests if name not in test.values), None)
        if absent is not None:
            problem = f"{name} is missing here and present in other files; leave it out or add it"
            raise InputError(problem, file=absent.file)
        varying = next((test for test in tests if not _is_constant(test.values[name])), None)
        if varying is not None and name in kind.averaged:
            means[condition] = take_means(tests, name, plan.headings)
        elif varying is not None and wanted:
            if name in plan.choices:
                problem = f"{name} is a condition and changes within record {varying.key!r}; choose another column"
                raise InputError(problem, file=varying.file)
            for test in tests:
                test.values.pop(name)
            plan.notes.append(f"The column for {name} changes within a test: it is no condition and was left out.")
        if varying is None:
            found = {test.key: float(test.values.pop(name)[0]) for test in tests}
            places = {test.key: (test.file, plan.headings.get(name), None) for test in tests}
            sources.add(condition, found, plan.si[name], f"the raw column {name}", places)
            plan.notes.append(f"{condition} was read from a column that does not change within a test.")
    return means


def _is_constant(values: np.ndarray) -> bool:
    values = values[~np.isnan(values)]
    return bool(values.size) and bool(np.all(values == values[0]))


def _read_known(known, kind: RecordKind) -> dict[str, float | None]:
    parameters = dict.fromkeys(kind.unknown)
    pairs = known if isinstance(known, dict) else read_pairs("known", known)
    for name, value in pairs.items():
        near = difflib.get_close_matches(str(name), [*ROLES, *parameters], n=1, cutoff=0.8)
        if name not in (*ROLES, *parameters) and near:
            raise InputError(f"--known: there is no parameter {name!r}; did you mean {near[0]}?")
        try:
            parameters[name] = None if value in (None, "null", "") else parse_quantity(value, name)
            check_known(name, parameters[name])
        except InputError as error:
            raise InputError(f"--known {name}: {error.problem}") from None
    return parameters


def _make_absolute(tests, sources, gauge, ambient, parameters, plan) -> None:
    """Turn gauge pressures into absolute ones."""
    if ambient is not None:
        try:
            parameters["ambient_pressure"] = parse_quantity(ambient, "ambient_pressure")
        except InputError as error:
            raise InputError(f"--ambient: {error.problem}") from None
    name = plan.kind.pressure
    if not name:
        return
    if not gauge:
        asked = "; if they are gauge pressures, give --gauge and --ambient"
        remark = asked if gauge is None else ", as --absolute says"
        plan.notes.append(f"Pressures were taken as absolute{remark}.")
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


def _read_uncertainty(option: str, text, unit: str, name: str) -> Uncertainty:
    try:
        return parse_uncertainty(text, check_unit(unit, name), name)
    except InputError as error:
        raise InputError(f"--{option}: {error.problem}") from None


def _check_samples(test: RawTest, names: list[str], uncertainties, plan: Plan) -> None:
    """Refuse samples that no campaign may hold, by the place in the laboratory's own file."""
    table, filled = Table(test.file, {}, test.lines), np.zeros(len(test.lines), dtype=bool)
    for name in names:
        values = test.values.get(name, np.full(len(test.lines), np.nan))
        filled |= ~np.isnan(values)
        try:
            check_finite(values, table, name)
            check_values(name, values, table, "samples", uncertainties.get(name), IMPORT_REMEDY)
        except InputError as error:
            column = plan.headings.get(name, name)
            raise InputError(error.problem, file=test.file, column=column, row=error.row) from None
    if filled.sum() < FEWEST_SAMPLES:
        problem = f"record {test.key!r} has only {filled.sum()} samples with a value; at least {FEWEST_SAMPLES} are "
        raise InputError(f"{problem}needed", file=test.file)


def _assemble(tests, sources, parameters, given, spreads, clock, shared, title, plan) -> Campaign:
    """Put records, samples and uncertainties together; `shared` are the common ones, as stated and as measured."""
    kind = plan.kind
    independent = next(name for name in kind.independents if name in tests[0].values)
    present = dict.fromkeys(name for test in tests for name in test.values if name != independent)
    names = [name for name in kind.series if name in present]
    names += [name for name in present if name not in names]
    uncertainties, commons, (stated, found) = {}, {}, shared
    for name in (independent, *names, *sources.values):
        unit = plan.si.get(name) or sources.units.get(name) or "1"
        if name in stated:
            commons[name] = _read_uncertainty("common-uncertainty", stated.pop(name), unit, name)
        elif name in found:
            commons[name] = Uncertainty(float(f"{found[name]:.4g}"))
        if name in given:
            uncertainties[name] = _read_uncertainty("uncertainty", given.pop(name), unit, name)
        elif name in names and (not kind.path or name == kind.main):
            spread = spreads.get(name, 0.0)
            if not spread > 0:
                short = "angular_velocity" if name.startswith("angular_velocity_") else name
                example = f"--uncertainty {short}='{'0.005' if unit == 'rad/s' else '0.25'} {unit}'"
                how = "cannot be measured before contact" if kind.has_contact else "is not known"
                raise InputError(f"the uncertainty of {name} {how}; give {example}")
            uncertainties[name] = Uncertainty(float(f"{spread:.4g}"))
            plan.notes.append(f"The uncertainty of {name} is {spread:.4g} {unit}, measured before contact.")
        elif name == "time" and clock:
            uncertainties[name] = Uncertainty(float(f"{clock:.4g}"))
    exact = [name for name in sources.values if name not in uncertainties and name != "sequence"]
    if exact:
        count, their = ("it counts", "its error") if len(exact) == 1 else ("they count", "their errors")
        note = f"No uncertainty is stated for {', '.join(exact)}: {count} as exact, and {their} can look like missing "
        plan.notes.append(f"{note}physics; --uncertainty {exact[0]}='0.5 %' states one.")
    for option, left in (("uncertainty", given), ("common-uncertainty", stated)):
        if left:
            raise InputError(f"--{option} names {', '.join(left)}, which the campaign does not have; it has "
                             f"{', '.join((independent, *names, *sources.values))}")
    frames = []
    for test in tests:
        check_increase(test, independent)
        _check_samples(test, names, uncertainties, plan)
        frame = pd.DataFrame({"record": test.key} | {n: test.values.get(n, np.nan) for n in (independent, *names)},
                             index=range(len(test.lines)))  # fmt: skip
        frames.append(frame)
    keys = pd.Index([test.key for test in tests], name="record", dtype=object)
    order = [name for name in kind.conditions if name in sources.values]
    order += [name for name in sources.values if name not in order]
    records = pd.DataFrame({n: [sources.values[n][key] for key in keys] for n in order}, index=keys)
    columns = {name: Column(name, plan.si.get(name) or "1", uncertainties.get(name), common=commons.get(name))
               for name in (independent, *names)}  # fmt: skip
    return Campaign(
        name="",
        title=title or f"Imported {kind.name} tests",
        family=kind.name,
        path=None,
        known=parameters,
        records=records,
        conditions={n: Column(n, sources.units[n], uncertainties.get(n), common=commons.get(n)) for n in order},
        independent=columns.pop(independent),
        channels=columns,
        samples=pd.concat(frames, ignore_index=True),
        sources=tuple({"title": Path(file).name} for file in dict.fromkeys(test.file for test in tests)),
        notes=tuple(plan.notes),
    )
