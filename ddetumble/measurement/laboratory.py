"""Import of a laboratory's raw files: a checked campaign, and in sentences everything that was decided on the way."""

import difflib
import re
from collections.abc import Collection
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from .._errors import InputError, error_place
from .._user_files import split_name
from . import alignment
from .alignment import RawTest
from .campaign import Campaign, Column
from .checks import check_keys, check_record, check_values, read_known, refuse_large
from .columns import (
    FRICTION_TEST,
    Plan,
    choose_columns,
    expand_role,
    find_unit,
    guess_role,
    make_plan,
    read_pairs,
    read_stated,
    require_units,
)
from .conditions import (
    add_constants,
    note_exact,
    open_conditions,
    read_conditions,
    read_names,
    refuse_unused,
    require_needs,
)
from .faults import find_truncated
from .kinds import DEFAULT_KIND, RecordKind, find_kind, take_kind
from .layout import RawFile, split_heading
from .plausibility import check_plausibility, say_copies
from .quantities import join_words
from .recordings import add_clock, is_bag, is_notes, is_raw, list_folder, probe_files, read_files, split_sheet
from .tables import convert_column, read_texts, read_toml
from .units import (
    ROLES,
    Uncertainty,
    parse_quantity,
    si_unit,
)
from .value_tables import import_values, refuse_options


RAW, SWITCHES = "raw", {"gauge", "values"}
CLOCKS = ("time", "elapsed time", "time stamp", "t")  # names of a clock that is added: one that no column has
SEVERAL = {"known", "keep", "drop", "units", "uncertainty", "common_uncertainty", "cut", "reverse", "zero", "describe"}


def import_tests(
    paths, *, family=DEFAULT_KIND, title=None, known=None,
    conditions=None, name_pattern=None, pressure=None, speed=None, load=None, gauge=None, ambient=None,
    force=None, time=None, rate=None, slip=None, record_column=None, keep=None, drop=None, units=None, decimal=None,
    delimiter=None, sheet=None, onset=None, symmetry_axis=None, uncertainty=None, common_uncertainty=None,
    crop=None, cut=None, reverse=None, zero=None, describe=None, values=False,
) -> Campaign:
    """Turn the raw files of a test bench into a campaign; what they do not show is asked for, never guessed.

    Args:
        paths: Files, or folders with files; one test each, or several with a record column. Text, spreadsheets, .mat,
            HDF5, TDMS, Parquet, MDF, MCAP, rosbag2 and universal files, by their endings. Or one `.toml` file that says
            everything: these arguments by name, with the files as `raw`.
        family: "impact", "slip" or "tumble", or `FILE.py:NAME` or a `Family` for a kind of tests of your own.
        title: Title of the campaign.
        known: Parameters of the reference model: {"outer_diameter": "60 mm"} or "outer_diameter=60 mm"; value "null"
            or None where the fit has to find them. Of an impact whose acceleration was measured, the effective mass.
        conditions: Table with one row a file or record and one column a condition, units in the headings; of a
            spreadsheet with several sheets as `FILE.xlsx:SHEET`.
        name_pattern: Conditions in the file names, like "{initial_pressure}MPa_{approach_speed}ms".
        pressure, speed, load: Of all tests, with unit: initial pressure and approach speed of impacts; internal
            pressure, sliding speed and normal load of the family slip.
        gauge: True if the pressures count from the ambient pressure; where nothing is said they are taken as absolute,
            and the notes say so.
        ambient: Ambient pressure, with unit; made part of `known`.
        force, time, slip: Names of the columns with the force (slip: the friction), the time, and the slip of the
            family slip.
        record_column: Name of the column, in the files or in the table of conditions, with the test that a row belongs
            to.
        rate: Samples a second, with unit ("10 kHz"), of files that hold no time.
        keep: Further columns: "COLUMN", or "quantity=COLUMN" to choose the column of a quantity; of the files, or where
            these have none such, of the table of conditions.
        drop: Columns, sought in the same way, that are left out although their headings would be understood.
        units: Units by quantity or column: {"force": "N"} or "force=N"; one that no column takes is refused.
        decimal, delimiter: "." or ","; "," ";" "|" "tab" or "space".
        sheet: Sheet of a spreadsheet or group of another file where there are several; with "*" or another pattern each
            is a test of its own.
        onset: Time of contact on the raw time axis, with unit, or the name of a column that holds it; None to find it.
        symmetry_axis: "x", "y" or "z": the body's axis of symmetry in the columns of the family tumble; made z.
        uncertainty: One standard deviation by quantity: {"normal_force": "0.25 N"} or "normal_force=0.25 N";
            where none is given, that of a channel is measured before contact.
        common_uncertainty: The same of the error that all records share: {"pressure": "2 %"} of a gauge whose
            calibration is in doubt.
        crop: Window of the raw time that is kept: "0 ms to 80 ms".
        cut: Cuts long recordings into one record a contact: {"level": "5 N", "before": "20 ms", "after": "80 ms"}, the
            level of the force above its median that begins a contact, and what is kept before and after that.
        reverse: Channels whose sign is reversed.
        zero: Window of the raw time over which a channel's mean is subtracted: {"force": "0 ms to 20 ms"}.
        describe: What to write down about a channel, such as its filter or where its gauge is: {"force": "TEXT"}.
        values: True if the file is a table with one row a test, which holds its conditions and single values, such as
            its rebound speed, instead of samples.

    Returns:
        The campaign, not yet written; `notes` holds every decision as a sentence.

    Raises:
        InputError: Anything malformed or undecidable; the option to give is named.
    """
    single = list(paths) if isinstance(paths, list | tuple) else [paths]
    if len(single) == 1 and str(single[0]).endswith(".toml"):
        usual = import_tests.__kwdefaults__ or {}
        given = [name for name, value in locals().items() if name in usual and value != usual[name]]
        if given:
            raise InputError(f"the file says everything; leave out {', '.join(given)}, or write it into the file",
                             file=single[0])
        return import_tests(**read_import_file(single[0], usual))
    with error_place(option="--family"):
        kind = find_kind(take_kind(family))
    options = {"pressure": (pressure, kind.pressure), "speed": (speed, kind.speed), "load": (load, kind.load)}
    useful = {"force": (force, kind.main), "slip": (slip, kind.path), "onset": (onset, kind.has_contact),
              "symmetry-axis": (symmetry_axis, kind.rates)}
    for option, (given, applies) in (options | useful).items():
        if given is not None and not applies:
            hint = f"; {FRICTION_TEST}" if option in ("slip", "load") else ""
            hint = ", whose tests have no contact" if option == "onset" else hint
            raise InputError(f"--{option} does not apply to the family {kind.name}{hint}")
    parameters = _read_known(known, ambient, kind)
    own = [name for name in parameters if _is_own(name, kind)]
    plan = make_plan(kind, force, time, slip, record_column, units, keep, drop, parameters.get("effective_mass"))
    plan.notes += [f"No model of the toolkit has a parameter {name}: it is kept, in SI, for a model of your own."
                   for name in own]
    if rate is not None:
        with error_place(option="--rate"):
            plan.rate = parse_quantity(rate, "the sampling rate", "Hz")
            if not plan.rate > 0:
                raise InputError("the sampling rate must be positive")
            stated = [name for name in plan.units if guess_role(split_heading(name)[0], kind) == "time"]
            if "time" in plan.choices or stated:
                raise InputError("files that take a sampling rate hold no time; leave out --rate, or "
                                 + (f"--unit {stated[0]}" if stated else "--time"))
    if kind.pressure and gauge:
        plan.ambient = parameters.get("ambient_pressure")
        if plan.ambient is None:
            raise InputError("gauge pressures need the ambient pressure of the day; give --ambient '101.3 kPa'")
        plan.notes.append(f"The ambient pressure of {plan.ambient:g} Pa was added to the gauge pressures.")
    elif kind.pressure:
        asked = "; if they are gauge pressures, give --gauge and --ambient" if gauge is None else ", as --absolute says"
        plan.notes.append(f"The pressures were taken as absolute{asked}.")
    stated = {"uncertainty": uncertainty, "common-uncertainty": common_uncertainty}
    if values:
        refuse_options(conditions=conditions, name_pattern=name_pattern, force=force, time=time, rate=rate, slip=slip,
                       onset=onset, symmetry_axis=symmetry_axis, crop=crop, cut=cut, reverse=reverse, zero=zero,
                       describe=describe)
        campaign = import_values(paths, plan, options, stated, sheet)
        return replace(campaign, known=parameters, title=title or f"Imported {kind.name} tests")
    tests, (table, part) = [], (None, None) if conditions is None else split_sheet(conditions)
    if table is not None:
        _require_table(table)
    listed = _list_files(paths, None if part else table, plan.notes)
    probe_files(listed)
    plan.table = None if conditions is None else open_conditions(conditions)
    for file in listed:
        settings = part if table is not None and Path(file).resolve() == table.resolve() else None
        for raw in read_files(file, sheet=sheet, leave_out=settings, delimiter=delimiter, decimal=decimal,
                              single=rate is not None, alone=len(listed) == 1):
            with error_place(sheet=raw.sheet):
                tests += _read_tests(raw, plan)
    if not tests:
        raise InputError("the file holds nothing beside the conditions; name the files with the measurements",
                         file=table)
    alignment.reverse_signs(tests, reverse, plan)
    alignment.subtract_zeros(tests, zero, plan)
    alignment.crop_records(tests, crop, plan)
    tests = alignment.cut_records(tests, cut, plan)
    files: dict[str, str] = {}
    for test in tests:
        if test.key in files:
            problem = f"the record {test.key!r} occurs twice; rename the file or the record in its column"
            raise InputError(problem, file=test.file)
        files[test.key] = test.file
    means = _collect_constants(tests, plan)
    if plan.table is not None:
        read_conditions(plan, plan.table, files)
    if name_pattern is not None:
        read_names(plan, name_pattern, files)
    refuse_unused(plan)
    add_constants(plan, options, files)
    for name, found in means.items():
        if name not in plan.conditions:
            plan.add(name, found, si_unit(name), "its column over the tests")
            plan.notes.append(f"{name} is the mean of its column over each test.")
        else:
            plan.notes.append(f"{name} is taken from {plan.sources[name]}; its column over the tests was left out.")
    noise, common = {}, {}
    if kind.has_contact:
        noise, common = alignment.align_tests(tests, plan, onset)
    if kind.path:
        alignment.turn_friction(tests, plan.notes)
    if kind.rates:
        alignment.turn_axes(tests, symmetry_axis, plan.notes)
        alignment.start_clocks(tests, plan.notes)
    for test in tests:
        if "pressure" in test.values and plan.ambient is not None:
            test.values["pressure"] = test.values["pressure"] + plan.ambient
    require_needs(plan, len(tests), conditions)
    descriptive, undescribed = kind.described
    if descriptive and not set(descriptive) & set(parameters):
        plan.notes.append(undescribed)
    if "tangential_speed" in kind.conditions and "tangential_speed" in plan.conditions:
        if not any("tangential_force" in test.values for test in tests):
            plan.notes.append("The tests have a tangential speed, but no column was read as the tangential force, so "
                              "the friction is not used; give the column with --keep tangential_force=COLUMN.")
        elif "rolling_mass" not in parameters:
            plan.notes.append("rolling_mass is not stated (two thirds of the mass of a thin hollow ball, 1e6 kg where "
                              "the ball cannot turn), so 0.5 kg is assumed; --known 'rolling_mass=0.4 kg' states it.")
    texts = {expand_role(name, kind): text for name, text in read_pairs("describe", describe).items()}
    campaign = replace(_assemble(tests, plan, stated, noise, common, texts), known=parameters,
                       title=title or f"Imported {kind.name} tests")
    doubts = (*map(str, (*find_truncated(campaign), *check_plausibility(campaign))), *say_copies(campaign))
    return replace(campaign, notes=(*_condense(plan.notes, [Path(file).name for file in files.values()]), *doubts))


def read_import_file(path, names: Collection[str]) -> dict[str, Any]:
    """The arguments of an import, of those `names`, as a file says them; paths in it count from its folder on.

    It has the key `raw` with a file or a list of them (`*` stands for any text), and the options.
    """
    path = Path(path)
    given = read_toml(path)
    for key, value in given.items():
        near = difflib.get_close_matches(key, [RAW, *names], n=1)
        if key != RAW and key not in names:
            raise InputError(f"there is no such key; {f'did you mean {near[0]}?' if near else 'it may be '}"
                             + ("" if near else ", ".join([RAW, *sorted(names)])), file=path, key=key)
        given[key] = _read_value(value, key, path)
    patterns = given.pop(RAW, None)
    if not patterns:
        raise InputError('the file names no raw files; add them, such as raw = ["run*.tdms"]', file=path, key=RAW)
    files: list[Path] = []
    for pattern in [patterns] if isinstance(patterns, str) else patterns:
        found = [Path(pattern)] if Path(pattern).is_absolute() else sorted(filter(is_raw, path.parent.glob(pattern)))
        if not found:
            raise InputError(f"there is no file {pattern!r} beside this one", file=path, key=RAW)
        files += found
    if "conditions" in given:
        table, sheet = split_sheet(path.parent / given["conditions"])
        given["conditions"] = f"{table}:{sheet}" if sheet else table
    if split_name(given.get("family", "")) is not None:
        given["family"] = take_kind(given["family"], path.parent)
    return {"paths": files} | given


def _read_value(value: Any, key: str, path: Path) -> Any:
    """A value as the option takes it: a text, texts by name or in a row, or whether something is so."""
    several = value if isinstance(value, list) else [*value.values()] if isinstance(value, dict) else None
    plain = all(isinstance(one, str | int | float) and not isinstance(one, bool) for one in several or [value])
    if key in SWITCHES and isinstance(value, bool):
        return value
    if key in SWITCHES or not plain or several is not None and not (
            key in SEVERAL or key == RAW and isinstance(value, list)):
        wanted = "true or false" if key in SWITCHES else "a text" + ", or a list or table of texts" * (key in SEVERAL)
        raise InputError(f"the value must be {wanted}", file=path, key=key)
    if isinstance(value, dict):
        return {name: str(one) for name, one in value.items()}
    return [*map(str, value)] if isinstance(value, list) else str(value)


def _condense(notes: list[str], files: list[str]) -> list[str]:
    """The notes with those alike about several files told once."""
    told: dict[str, list[str]] = {}
    for note in notes:
        name, _, rest = note.partition(": ")
        told.setdefault(rest if name in files else note, []).extend([name] * (name in files))
    return [f"{names[0]}{f' and {len(names) - 1} more' * (len(names) > 1)}: {rest}" if names else rest
            for rest, names in told.items()]


def _list_files(paths, table: Path | None, notes: list[str]) -> list[str]:
    """Files as given, and those in folders, but for the table of conditions and for texts without numbers, which are
    noted.
    """
    files, table = [], None if table is None else table.resolve()
    for path in map(Path, [paths] if isinstance(paths, str | Path) else paths):
        inside = path.is_dir() and not is_bag(path)
        found = [p for p in (list_folder(path) if inside else [path]) if p.resolve() != table]
        if inside:
            texts = [p for p in found if is_notes(p)]
            notes += [f"{p.name} holds no rows of numbers and was left out." for p in texts]
            found = [p for p in found if p not in texts]
            if not found:
                raise InputError("the folder holds no measurements beside the table of conditions" if table is not None
                                 else "the folder holds no file with measurements", file=path)
        files += map(str, found)
    if not files:
        if table is not None and paths:
            raise InputError("this is the table of conditions, and no other file is named; if it is one sheet of "
                             f"several, write {table.name}:SHEET", option="--conditions")
        raise InputError("name at least one raw file to import")
    return files


def _require_table(table: Path) -> None:
    """Refuse a table of conditions that is not there, before its absence shows elsewhere."""
    if not table.exists():
        folder = table.parent if table.parent.is_dir() else Path()
        near = difflib.get_close_matches(table.name, sorted(path.name for path in folder.iterdir()), n=1)
        raise InputError(f"there is no such file; {f'did you mean {near[0]}?' if near else 'check the path'}",
                         file=table, option="--conditions")


def _add_clock(raw: RawFile, plan: Plan, rate: float) -> RawFile:
    """A file with times by the sampling rate that was given; refused is one that holds times, but for a column of such
    that is left out: the clock has another name then.
    """
    dropped = {split_heading(name)[0] for name in plan.drop}
    there = [name for name in raw.columns
             if name not in dropped and (guess_role(name, plan.kind) == "time" or name == getattr(raw, "clock", ""))]
    if there:
        raise InputError(f"the file holds times ({there[0]}); leave out --rate", file=raw.file, option="--rate")
    raw = add_clock(raw, rate, next((name for name in CLOCKS if name not in raw.columns), "clock"))
    plan.notes.append(f"{Path(raw.file).name}: the time counts from the first sample, by the sampling rate of "
                      f"{rate:g} Hz.")
    return raw


def _read_tests(raw: RawFile, plan: Plan) -> list[RawTest]:
    """The tests in one file, their columns chosen and converted to SI."""
    if plan.rate is not None:
        raw = _add_clock(raw, plan, plan.rate)
    roles, kind, values = choose_columns(raw, plan), plan.kind, {}
    left = ", ".join(column for column in raw.columns if column not in roles.values())
    most = max(map(len, raw.columns.values()), default=0)
    plan.singles |= {column: raw.units.get(column) for column, cells in raw.columns.items()
                     if len(cells) == 1 < most and column not in roles.values()}
    raw = raw.join(roles.values())
    plan.notes += raw.notes
    require_units(raw, roles, plan)
    independent = next(name for name in kind.independents if name in roles)
    for role, column in roles.items():
        if role == "record":
            continue
        unit = find_unit(raw, role, column, plan)
        cells = convert_column(raw, column, decimal=raw.decimal, allow_missing=role not in (independent, "sequence"))
        refuse_large(cells, raw, column)
        values[role] = unit.convert(cells)
        plan.note_unit(role, unit.text)
        if plan.si.setdefault(role, unit.si) != unit.si:
            raise InputError("the unit is of a different kind from that in earlier files", file=raw.file, column=column)
    used = ", ".join(f"{role} from {column!r}" for role, column in roles.items())
    lacking = ", ".join(role for role in kind.series if role not in roles)
    left += f" (--keep NAME=COLUMN takes one in, as {lacking})" if left and lacking else ""
    plan.notes.append(f"{Path(raw.file).name}: {used}; {f'left out: {left}' if left else 'no column left out'}.")
    groups = {raw.key: np.arange(len(raw))}
    if "record" in roles:
        cells = read_texts(raw, roles["record"])
        check_keys(cells, raw, roles["record"])
        groups = pd.Series(cells).groupby(cells, sort=False).indices
    tests = [RawTest(str(key), raw.file, raw.lines[rows], {name: v[rows] for name, v in values.items()})
             for key, rows in groups.items()]
    for test in tests:
        check_record(test.key, {name: x for name, x in test.values.items() if name in (independent, *kind.channels)},
                     independent, test, ", or tell the tests in the file apart with --record-column")
    return tests


def _collect_constants(tests: list[RawTest], plan: Plan) -> dict[str, dict[str, float]]:
    """Move columns that do not change within a test from the samples to the conditions.

    Returns:
        Means of loads and pressures that were measured along slip tests, for where nothing else gives them.
    """
    kind, means = plan.kind, {}
    for name in list(dict.fromkeys(name for test in tests for name in test.values)):
        condition = kind.pressure or name if name == "pressure" else name
        if name == "time" or name in kind.series and name != "pressure":
            continue
        absent = next((test for test in tests if name not in test.values), None)
        if absent is not None:
            problem = f"{name} is missing here and present in other files; leave it out or add it"
            raise InputError(problem, file=absent.file)
        varying = next((test for test in tests if np.isnan(test.values[name]).all()
                        or np.nanmin(test.values[name]) != np.nanmax(test.values[name])), None)
        if varying is None:
            found = {test.key: float(np.nanmin(test.values.pop(name))) for test in tests}
            places = {test.key: {"file": test.file, "column": plan.headings.get(name)} for test in tests}
            plan.add(condition, found, plan.si[name], f"the raw column {name}", places)
            plan.note_unit(condition, plan.stated.get(name, ""))
            plan.notes.append(f"{condition} was read from a column that does not change within a test.")
        elif name in kind.averaged:
            means[condition] = alignment.take_means(tests, name, plan.headings)
        elif name in kind.conditions:
            if name in plan.choices:
                problem = f"{name} is a condition and changes within record {varying.key!r}; choose another column"
                raise InputError(problem, file=varying.file)
            for test in tests:
                test.values.pop(name)
            plan.notes.append(f"The column for {name} changes within a test, so it is no condition and was left out.")
    return means


def _read_known(known, ambient, kind: RecordKind) -> dict[str, float | None]:
    parameters: dict[str, float | None] = dict.fromkeys(kind.unknown)
    pairs = known if isinstance(known, dict) else read_pairs("known", known)
    for name, value in pairs.items():
        _check_name(str(name), kind, parameters)
        with error_place(option=f"--known {name}"):
            parameters[name] = None if value in (None, "null", "") else read_known(
                name, value, kind.parameters.get(name, ""))
    if ambient is not None:
        with error_place(option="--ambient"):
            parameters["ambient_pressure"] = parse_quantity(ambient, "ambient_pressure")
    return parameters


def _check_name(name: str, kind: RecordKind, parameters: Collection[str]) -> None:
    """Refuse the name of a known number that no reference model of the kind has and that is nearly, or in part, that of
    one: a slip, most likely. Any other may be of a model of one's own. Those of effects, which have a point, are
    checked with the model.
    """
    names = list(dict.fromkeys([*parameters, *kind.parameters]))
    if name in names or "." in name or not kind.parameters and name in ROLES:
        return
    if kind.parameters and name in kind.conditions:
        raise InputError(f"{name} is a condition of the tests, no parameter; give it in the table of --conditions",
                         option="--known")
    near = difflib.get_close_matches(name, names if kind.parameters else [*ROLES, *names], n=3, cutoff=0.8)
    if kind.parameters and not near:
        words = set(re.findall(r"[^\W_]+", name.casefold()))
        near = [one for one in names if words <= set(one.split("_"))]
    if near:
        raise InputError(f"there is no parameter {name!r}; did you mean {join_words(near, 'or')}?", option="--known")


def _is_own(name: str, kind: RecordKind) -> bool:
    """Whether a known number can be of a model of the user's own alone; unknown where a kind does not list its own."""
    return bool(kind.parameters) and "." not in name and name not in (*kind.unknown, *kind.parameters)


def _assemble(tests: list[RawTest], plan: Plan, options: dict, noise: dict[str, float],
              common: dict[str, float], described: dict[str, str]) -> Campaign:
    """Put records, samples and uncertainties together: the stated ones of `options`, and those that were measured."""
    kind = plan.kind
    independent = next(name for name in kind.independents if name in tests[0].values)
    present = dict.fromkeys(name for test in tests for name in test.values if name != independent)
    channels, order = ([*(name for name in usual if name in there), *(name for name in there if name not in usual)]
                       for usual, there in ((kind.series, present), (kind.conditions, plan.conditions)))
    units = {name: plan.si[name] for name in (independent, *channels, *order)}
    own, shared = read_stated(kind, options, units)
    unknown = next((name for name in described if name not in units), None)
    if unknown is not None:
        raise InputError(f"there is no {unknown}; the campaign has {', '.join(units)}", option="--describe")
    shared = {name: Uncertainty(float(f"{sd:.4g}")) for name, sd in common.items()} | shared
    for name in (independent, *channels):
        stated = own.get(name)
        if stated is not None and name == independent and common and (stated.absolute or 0.0) < noise.get(name, 0.0):
            # The contact was looked for in the traces: what the trigger is good for says nothing of that.
            own[name] = Uncertainty(float(f"{noise[name]:.4g}"))
            plan.notes.append(f"The contact was looked for in the traces and found to {noise[name] * 1e3:.2g} ms, so "
                              f"that the {name} is no surer than that ({(stated.absolute or 0.0) * 1e3:.2g} ms is "
                              "stated). Where the trigger marks first touch, give its instant: --onset '0 ms'.")
        if name in own:
            continue
        if noise.get(name, 0.0) > 0:
            own[name] = Uncertainty(float(f"{noise[name]:.4g}"))
            if name in channels:
                plan.notes.append(f"The uncertainty of {name} is {noise[name]:.4g} {units[name]}, measured before "
                                  "contact.")
            elif not common:  # no onset was found
                plan.notes.append(f"The uncertainty of the {name} is that of the sampling, {noise[name] * 1e3:.3g} ms; "
                                  f"--uncertainty {name}='0.1 ms' states another.")
        elif name in channels and (not kind.path or name == kind.main):
            short = "angular_velocity" if name.startswith("angular_velocity_") else name
            example = f"--uncertainty {short}='{'0.005' if units[name] == 'rad/s' else '0.25'} {units[name]}'"
            how = "cannot be measured before contact" if kind.has_contact else "is not known"
            raise InputError(f"the uncertainty of {name} {how}; give {example}")
    note_exact(plan, own)
    for test in tests:
        for name in channels:
            if name in test.values:
                check_values(name, test.values[name], test, "samples", own.get(name), plan.headings.get(name, name))
    samples = pd.concat([pd.DataFrame({"record": test.key} | test.values) for test in tests], ignore_index=True)
    columns = {name: Column(name, unit, own.get(name), description=described.get(name, ""), common=shared.get(name),
                            stated=plan.stated.get(name, ""),
                            gauge=plan.ambient is not None and name in ("pressure", kind.pressure))
               for name, unit in units.items()}
    keys = pd.Index([test.key for test in tests], name="record", dtype=object)
    return Campaign(
        name="", title="", family=kind.name, path=None, known={},
        records=pd.DataFrame({name: [plan.conditions[name][key] for key in keys] for name in order}, index=keys),
        conditions={name: columns[name] for name in order},
        independent=columns[independent],
        channels={name: columns[name] for name in channels},
        samples=samples.reindex(columns=["record", independent, *channels]),
        sources=tuple({"title": Path(file).name} for file in dict.fromkeys(test.file for test in tests)),
    )
