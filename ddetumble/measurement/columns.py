"""Which column of a laboratory's file holds which quantity: as told, by its heading, or by its unit."""

import difflib
import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from .._errors import InputError, error_place
from .checks import GAUGE, Rows, check_values
from .kinds import KINDS, RecordKind
from .layout import RawFile, split_heading
from .quantities import join_words
from .recordings import Recording
from .units import (
    Uncertainty,
    Unit,
    check_unit,
    is_gauge,
    list_usual,
    parse_uncertainty,
    parse_unit,
    si_unit,
    strip_gauge,
)


FRICTION_TEST = "if it is a friction test, give --family " + next(kind.name for kind in KINDS.values() if kind.path)
WEIGHED = "--known 'effective_mass=1.2 kg' converts"
_COMMON = {
    "record": "record recordid test testid testno testnr testnumber run runid runno runnumber shot trial versuch "
    "versuchnr versuchsnr versuchsnummer lauf laufnr laufnummer messung messungnr messnummer",
    "time": "t time zeit temps tempo elapsedtime timestamp",
    "temperature": "temperature temp temperatur",
    "depression": "depression depth indentation compressiondepth eindrücktiefe eindringtiefe",
    "pressure": "p pressure druck gaspressure ballpressure fillpressure fillingpressure innendruck balldruck "
    "gaugepressure überdruck fülldruck",
}
_GAUGE = ("gaugepressure", "überdruck")  # of these, those above the pressure around
_NUMBERS = ("no", "nr", "num", "number", "nummer", "n°", "№", "#")  # of samples in raw data, and so no test there
_COUNTERS = "repeats? repetition replicate replica wiederholung wdh essai".replace(" ", "|")


def _find_word(heading: str) -> str:
    """A heading without case, spaces and signs."""
    return re.sub(r"[\W_]+", "", heading).casefold()


def names_gauge(heading: str) -> bool:
    """Whether a heading (without its unit) says that a pressure is one above that around it."""
    return _find_word(heading) in _GAUGE


def names_number(heading: str) -> bool:
    """Whether a heading of a table with one row a test is that of the tests' numbers, and says no more."""
    return (_find_word(heading) or heading.strip()) in _NUMBERS


def guess_role(heading: str, kind: RecordKind) -> str | None:
    """The quantity that a heading (without its unit) names in raw data of a kind, or None."""
    word = _find_word(heading)
    return next((role for role, words in {**_COMMON, **kind.words}.items()
                 if word in words.split() or word == role.replace("_", "")), None)


def guess_condition(heading: str, kind: RecordKind) -> str | None:
    """The same in a table of conditions, where a pressure is that of the test's begin."""
    role = guess_role(heading, kind)
    return (kind.pressure or None) if role == "pressure" else role


def guess_value(heading: str, kind: RecordKind) -> str | None:
    """The single value of a test, or the number of tests that it is the mean of, that a heading names, or None."""
    word = _find_word(heading)
    return next((name for name, words in {**kind.value_words, "repeats": "repeats"}.items()
                 if word in words.split() or word == name.replace("_", "")), None)


def list_headings(name: str, kind: RecordKind) -> list[str]:
    """Headings, without spaces, signs and units, by which `guess_condition` knows a quantity, but for its own name."""
    words = {**_COMMON, **kind.words}
    own = words.get(name, "").split() + (words["pressure"].split() if name == kind.pressure else [])
    return [word for word in own if word != name.replace("_", "")]


def is_counter(heading: str) -> bool:
    """Whether a heading names a number that only tells repeats of one condition apart."""
    word = _find_word(heading)
    return re.fullmatch(f"({_COUNTERS})(no|nr|number|id)?", word) is not None


def name_condition(text: str) -> str:
    """A column's name for a heading: lower case, words joined by underscores."""
    return re.sub(r"\W+", "_", text).strip("_").lower() or "condition"


def expand_role(name: str, kind: RecordKind) -> str:
    """The quantity that an option's short name means: `force`, `pressure` (as a condition: `p0`) and `speed`."""
    short = {"force": kind.main, "load": "normal_load", "speed": kind.speed, "p0": kind.pressure}
    return short.get(name) or name


def expand_roles(name: str, kind: RecordKind) -> tuple[str, ...]:
    """The quantities that an option's short name means, as of `expand_role`; `angular_velocity` is that of all axes."""
    return kind.rates if kind.rates and name == "angular_velocity" else (expand_role(name, kind),)


def read_pairs(option: str, given) -> dict[str, str]:
    """Entries NAME=VALUE of an option, given as a mapping, one text or several."""
    if isinstance(given, dict):
        return {str(key): str(value) for key, value in given.items()}
    pairs = {}
    for entry in [given] if isinstance(given, str) else given or ():
        name, _, value = map(str.strip, str(entry).partition("="))
        if not name or not value:
            raise InputError(f"--{option} takes NAME=VALUE, not {entry!r}")
        if name in pairs:
            raise InputError(f"--{option} gives {name!r} twice")
        pairs[name] = value
    return pairs


def read_stated(kind: RecordKind, options: Mapping[str, Any], units: Mapping[str, str]
                ) -> tuple[dict[str, Uncertainty], ...]:
    """Uncertainties that options state, of each by quantity; `units` are those of what the campaign has."""
    found = []
    for option, texts in options.items():
        given = read_pairs(option, texts)
        pairs = {expand_role(name, kind): text for name, text in given.items()}
        if len(pairs) < len(given):
            meant = [expand_role(name, kind) for name in given]
            named = [name for name, one in zip(given, meant, strict=True) if meant.count(one) > 1]
            raise InputError(f"{join_words(named)} are one quantity: give it once", option=f"--{option}")
        if "pressure" in pairs and "pressure" not in units and kind.pressure:  # no channel is meant
            pairs = {kind.pressure: pairs.pop("pressure")} | pairs
        if "angular_velocity" in pairs and kind.rates:  # of all three axes
            pairs = dict.fromkeys(kind.rates, pairs.pop("angular_velocity")) | pairs
        left = [name for name in pairs if name not in units]
        if left:
            raise InputError(f"--{option} names {', '.join(left)}, which the campaign does not have; it has "
                             f"{', '.join(units)}")
        with error_place(option=f"--{option}"):
            found.append({name: parse_uncertainty(text, check_unit(units[name], name), name)
                          for name, text in pairs.items()})
    return tuple(found)


@dataclass
class Plan:
    """The options of an import, the conditions found so far, and the running account of decisions."""

    kind: RecordKind
    choices: dict[str, str]  # quantity to the column that was named for it
    keep: dict[str, str]  # further columns to the names that they get
    drop: tuple[str, ...]  # columns that are left out, whatever their headings say
    units: dict[str, str]  # by quantity or column, from --unit
    mass: float | None  # effective mass [kg] that makes a force of an acceleration
    rate: float | None = None  # samples a second, of files without a time
    ambient: float | None = None  # pressure [Pa] that makes gauge pressures absolute; None where they are already
    table: RawFile | None = None  # of the conditions, for columns that no raw file has
    taken: set[str] = field(default_factory=set)  # columns of options that a raw file has
    used: set[str] = field(default_factory=set)  # names of --unit that a column was found for
    si: dict[str, str] = field(default_factory=dict)  # unit of every quantity found so far
    headings: dict[str, str] = field(default_factory=dict)  # quantity to the heading it was read from
    conditions: dict[str, dict[str, float]] = field(default_factory=dict)  # by name and record key, SI
    sources: dict[str, str] = field(default_factory=dict)  # where each condition comes from
    stated: dict[str, str] = field(default_factory=dict)  # unit that the files state for a quantity; "" where several
    # Single values beside the channels of files that nothing says the meaning of, to their units.
    singles: dict[str, str | None] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)  # every decision, in sentences

    def note_unit(self, name: str, text: str) -> None:
        """Keep the unit in which a file states a quantity, for questions about it."""
        self.stated[name] = text if self.stated.get(name, text) == text else ""

    def find_text(self, role: str, column: str, stated: str | None) -> str | None:
        """Unit of a quantity's column as --unit says it, or else its heading, which has `stated`."""
        meant = {name: expand_roles(split_heading(name)[0], self.kind) for name in self.units}
        given = {quantity: name for name in sorted(meant, key=lambda name: len(meant[name]), reverse=True)
                 for quantity in meant[name]} | {name: name for name in meant if name == column}
        name = given.get(column) or given.get(role)
        if name is None and not stated and self.kind.pressure and role in ("pressure", self.kind.pressure):
            name = given.get("pressure") or given.get(self.kind.pressure)  # a pressure may be that of the test's begin
        self.used |= {name} if name else set()
        return self.units[name] if name else stated

    def find_quantity(self, name: str) -> str:
        """The quantity that an option means by its name, a short one, or the heading that it was read from."""
        quantity = expand_role(name, self.kind)
        return quantity if quantity in self.headings else next(
            (role for role, heading in self.headings.items() if name in (heading, split_heading(heading)[0])), quantity)

    def find_in_table(self, role: str, text: str) -> str | None:
        """The column of the table of conditions that an option names, or None; a series of samples is none there."""
        series = {"time", *self.kind.series, *self.kind.channels} - {"pressure"}
        apart = text in self.taken and role != "record"  # a raw file has it, so that is meant
        return None if self.table is None or role in series or apart else seek_column(self.table, text)

    def add(self, name: str, values: dict[str, float], unit: str, source: str,
            places: Mapping[str, Mapping] | None = None) -> None:
        """Add a condition, `values` by record key; `places` gives file, column and row of each, if there are some."""
        if name in self.conditions:
            raise InputError(f"{name} is given twice, by {self.sources[name]} and by {source}; keep one")
        if name == self.kind.pressure and self.ambient is not None:
            values = {key: value + self.ambient for key, value in values.items()}
        self.conditions[name], self.si[name], self.sources[name] = values, unit, source
        gauge = GAUGE if self.ambient is None else ""  # it is told already
        if name == self.kind.pressure and any(values.values()):  # else there is no gas in any test
            empty = next((key for key, value in values.items() if value == 0), None)
            if empty is not None:
                remedy = "" if self.ambient is not None else (
                    ", or give --gauge and --ambient if pressures count from the ambient pressure")
                raise InputError(f"{name} of record {empty!r}: an absolute pressure of 0 is a vacuum, and other tests "
                                 f"have gas; correct the number{remedy}", **(places or {}).get(empty, {}))
        for key, value in values.items():
            place = (places or {}).get(key, {})
            try:
                check_values(name, np.array([value]), Rows("", np.array([1])), "records", None, gauge=gauge)
            except InputError as error:
                by = "" if place else f" (given by {source})"
                raise InputError(f"{name} of record {key!r}: {error.problem}{by}", **place) from None


def make_plan(kind: RecordKind, force, time, slip, record_column, units, keep, drop, mass: float | None) -> Plan:
    """The options about columns."""
    choices, extra = {}, {}
    entries = keep.items() if isinstance(keep, dict) else [
        entry.rpartition("=")[::2] for entry in ([keep] if isinstance(keep, str) else keep or ())]
    for name, column in entries:
        if name:
            role, column = expand_role(name.strip(), kind), str(column).strip()
            if role in choices:
                raise InputError(f"{role} is given two columns, {choices[role]!r} and {column!r}; choose one",
                                 option="--keep")
            choices[role] = column
        else:
            extra[column] = name_condition(split_heading(column)[0])
    told = {kind.main: force, "time": time, "slip": slip, "record": record_column}
    choices |= {role: column for role, column in told.items() if column is not None}
    dropped = (drop,) if isinstance(drop, str) else tuple(map(str, drop or ()))
    return Plan(kind, choices, extra, dropped, read_pairs("unit", units), mass)


def choose_columns(raw: RawFile, plan: Plan) -> dict[str, str]:
    """Quantity to column: as told, by heading, and force, time or slip by their unit if nothing else has it.

    Where more than one may be meant, the option that settles it is named.
    """
    kind = plan.kind
    choices = {role: _choose_column(raw, column, role, plan) for role, column in plan.choices.items()}
    roles = {role: column for role, column in choices.items() if column is not None}
    sought = [_choose_column(raw, column, "", plan) for column in plan.drop]
    dropped = {column for column in sought if column is not None}
    for role, column in roles.items():
        if column in dropped:
            raise InputError(f"the column {column!r} is to be left out, and to be the {role}: keep one", file=raw.file)
    guesses, longest = {}, max(map(len, raw.columns.values()), default=0)
    for column, cells in raw.columns.items():
        role = guess_role(column, kind)
        if len(cells) == 1 < longest and role in (*kind.independents, kind.main, *kind.rates):
            continue  # a single value beside channels is a setting
        named = role in plan.choices and role != "record"  # a column of the table of conditions
        if role and role not in roles and not named and column not in roles.values() and column not in dropped:
            guesses.setdefault(role, []).append(column)
    options = {"time": "--time COLUMN", kind.path: "--slip COLUMN", kind.main: "--force COLUMN",
               "record": "--record-column COLUMN"}  # fmt: skip
    for role, found in guesses.items():
        if len(found) > 1:
            option = options.get(role, f"--keep {role}=COLUMN")
            problem = f"several columns may be the {role}: {', '.join(found)}; choose one with {option}"
            raise InputError(problem, file=raw.file)
        roles[role] = found[0]
    if not set(kind.independents) & set(roles):
        option = "--slip COLUMN, or --time COLUMN for a time series" if kind.path else "--time COLUMN"
        independent = kind.path or kind.independents[0]
        roles[independent] = _choose_by_unit(raw, independent, {*roles.values(), *dropped}, option, plan)
    if kind.main and kind.main not in roles:
        roles[kind.main] = _choose_by_unit(raw, kind.main, {*roles.values(), *dropped}, "--force COLUMN", plan)
    if kind.path and kind.path not in roles:
        problem = f"there is a time but no slip: the file has {', '.join(raw.columns)}; give --slip COLUMN, or export "
        raise InputError(problem + "how far the rubber has slid", file=raw.file)
    if kind.rates and not any(name in plan.choices or name in roles for name in kind.rates):
        roles |= _choose_axes(raw, {*roles.values(), *dropped}, plan)
    if kind.rates and not any(name in roles for name in kind.rates):
        problem = "no column is an angular velocity; name the columns with --keep angular_velocity_x=COLUMN and so on"
        raise InputError(problem, file=raw.file)
    for heading, name in plan.keep.items():
        column = _choose_column(raw, heading, "", plan)
        if column is not None and column not in roles.values():
            roles[name] = column
    plan.headings.update(roles)
    return roles


def seek_column(raw: RawFile, text: str) -> str | None:
    """The column that an option names, by its heading with or without the unit, or by its number; None without one."""
    text = str(text).strip()
    name, unit = split_heading(text)
    names = (text, f"column {text}", name if unit is not None and unit == raw.units.get(name) else text)
    return next((column for column in names if column in raw.columns), None)


def _choose_column(raw: RawFile, text: str, role: str, plan: Plan) -> str | None:
    """The column of a raw file that an option names for a quantity; None where the table of conditions has it."""
    column = seek_column(raw, text)
    if column is not None:
        plan.taken.add(text)
    elif plan.find_in_table(role, text) is None:
        beside = "" if plan.table is None else f", and the table of conditions has {list_columns(plan.table)}"
        known = [*raw.columns, *(plan.table.columns if plan.table is not None else ())]
        near = difflib.get_close_matches(str(text).strip(), known, n=1)
        asked = f"did you mean {near[0]!r}? The" if near else "the"
        raise InputError(f"there is no column {str(text).strip()!r}; {asked} file has {list_columns(raw)}{beside}",
                         file=raw.file)
    return column


def list_columns(raw: RawFile) -> str:
    """The headings of a table, in words."""
    return ", ".join(name + (f" [{raw.units[name]}]" if raw.units[name] else "") for name in raw.columns)


def _measures(unit: str | None, like: str) -> bool:
    """Whether a unit is of the dimension of another."""
    try:
        return unit is not None and parse_unit(unit).dimension == parse_unit(like).dimension
    except InputError:
        return False


def _choose_by_unit(raw: RawFile, role: str, taken: Collection[str], option: str, plan: Plan) -> str:
    """The only column whose unit measures the quantity, of those that are not taken; an acceleration where a mass makes
    a force of it."""
    fits = {si: [column for column in raw.columns if column not in taken and _measures(raw.units[column], si)]
            for si in (si_unit(role), "m/s^2")}
    found, accelerations = fits.values()
    weighed = role == "normal_force" and plan.mass is not None
    found = found or (accelerations if weighed else [])
    if len(found) == 1:
        return found[0]
    hint = ""
    if any(name.casefold() == "file" for name in raw.columns):
        hint = f"; if it is the table of conditions, give --conditions {raw.file}"
    elif role == "normal_force" and not weighed and accelerations:
        hint = f"; {WEIGHED} an acceleration to a force"
    elif role in ("time", "normal_force") and any(
            kind.path and guess_role(column, kind) == kind.path for kind in KINDS.values() for column in raw.columns):
        hint = f", or, {FRICTION_TEST}"
    elif role == plan.kind.main:
        turning = (kind.name for kind in KINDS.values()
                   if any(guess_role(column, kind) in kind.rates for column in raw.columns))
        hint = next((f"; if this is a gyroscope's record, give --family {name}" for name in turning), "")
    if role == "time" and any(guess_value(split_heading(column)[0], plan.kind) for column in raw.columns):
        hint += "; if it is a table with one row a test and single values, give --values"
    problem = f"it is unclear which column is the {role}"
    if role == "time" and not found:
        clock = "no channel has a clock (in TDMS its wf_increment), and " if isinstance(raw, Recording) else ""
        problem, option = f"{clock}no column is the time", f"{option}, or --rate '10 kHz' where samples are even"
    raise InputError(f"{problem}: the file has {', '.join(raw.columns)}; give {option}{hint}", file=raw.file)


def _choose_axes(raw: RawFile, taken: Collection[str], plan: Plan) -> dict[str, str]:
    """Columns of the rates about x, y and z where no heading says an axis: those of the only matrix of three columns
    that is called angular velocity, or has a unit of such; none elsewhere.
    """
    rates, matrices = plan.kind.rates, {}
    for column in raw.columns:
        numbered = re.fullmatch(r"(.*\S) (\d+)", column)
        if numbered and column not in taken:
            matrices.setdefault(numbered[1], []).append(column)
    found = [columns for name, columns in matrices.items()
             if columns == [f"{name} {j}" for j in range(1, len(rates) + 1)]
             and (guess_role(f"{split_heading(name)[0]}x", plan.kind) == rates[0]
                  or all(_measures(raw.units[one], "rad/s") for one in columns))]
    if len(found) != 1:
        return {}
    plan.notes.append(f"{Path(raw.file).name}: no heading says an axis, so {join_words(found[0])} were taken as the "
                      f"angular velocity about x, y and z; --keep {rates[0]}=COLUMN and so on choose others.")
    return dict(zip(rates, found[0], strict=True))


def ask_unit(column: str, quantity: str, name: str = "") -> str:
    """The question after the unit of a column: those in which its quantity is written, and where to say which it is.

    `name` is that of the quantity in `--unit` (default: its own).
    """
    usual, name = list_usual(quantity), name or quantity
    near = usual[0] if usual else "mm"
    asked = f"is it {join_words(usual, 'or')}? Write" if usual else "write"
    number = "" if usual else ", '[1]' for a pure number"
    return (f"{asked} it into the heading like '{column} [{near}]'{number}, or give --unit {name}={near} "
            f'(in import.toml: units = {{ {name} = "{near}" }})')


def require_units(raw: RawFile, roles: Mapping[str, str], plan: Plan) -> None:
    """Refuse a file of which columns state no unit, by heading or --unit: all of them are named, the first one's
    question in full.
    """
    left = [(role, column) for role, column in roles.items()
            if role not in ("record", "sequence") and plan.find_text(role, column, raw.units[column]) is None]
    if not left:
        return
    (role, column), *others = left
    more = [f"{column} ({_shorten(role, plan)} in {join_words(list_usual(role) or ('mm',), 'or')})"
            for role, column in others]
    also = f", nor is that of {join_words(more, 'or')}" if more else ""
    raise InputError(f"the unit is not stated{also}: {ask_unit(column, role, _shorten(role, plan))}", file=raw.file,
                     column=column)


def _shorten(role: str, plan: Plan) -> str:
    """The name of a quantity in --unit."""
    return "force" if role == plan.kind.main else "angular_velocity" if role in plan.kind.rates else role


def find_unit(raw: RawFile, role: str, column: str, plan: Plan) -> Unit:
    """Unit of a column, from --unit or its heading; refused where it states none, or does not measure the quantity."""
    require_units(raw, {role: column}, plan)
    stated, name = raw.units[column], _shorten(role, plan)
    text = plan.find_text(role, column, stated) or "1"
    if role == "normal_force" and _measures(text, "m/s^2"):
        if plan.mass is None:
            raise InputError(f"the column holds an acceleration; {WEIGHED} it to a force", file=raw.file, column=column)
        plan.notes.append(f"The normal_force is {plan.mass:g} kg times the acceleration {column!r}.")
        return Unit(text, parse_unit(text).scale * plan.mass, 0.0, parse_unit("N").dimension, "N")
    unit = read_unit(text, role, raw.file, column, plan, f" (or set the unit with --unit {name}=…)")
    if stated is not None and _measures(stated, text):
        other = parse_unit(stated)
        ratio = unit.scale / other.scale
        if (ratio, unit.offset) != (1.0, other.offset):
            times = f"{max(ratio, 1 / ratio):.4g} times {'less' if ratio > 1 else 'more'}"
            plan.notes.append(f"The unit --unit {name}={text} was used although the heading says {stated}, {times}; "
                              "leave the option out if the heading is right.")
    return unit


def read_unit(text: str, role: str, file: str, column: str, plan: Plan, more: str = "") -> Unit:
    """A unit as stated in a file's column, refused where it does not measure a quantity; `more` ends the message.

    That of a gauge pressure is the plain one where the ambient pressure is added, and is refused elsewhere.
    """
    if plan.kind.pressure and role in ("pressure", plan.kind.pressure):
        if plan.ambient is not None:
            text = strip_gauge(text) or text
        elif is_gauge(text) or names_gauge(column):
            said = text if is_gauge(text) else column
            raise InputError(f"{said!r} is a gauge pressure; give --gauge and --ambient '101.3 kPa'", file=file,
                             column=column)
    try:
        return check_unit(text, role)
    except InputError as error:
        raise InputError(error.problem + more, file=file, column=column) from None
