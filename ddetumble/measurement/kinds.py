"""Kinds of records as campaigns hold them: their columns, what a laboratory calls these, and what an import asks for.

This is the part of a family of tests (`ddetumble.families`) that needs no model. Impacts straight on and oblique ones
are of one kind: the columns tell them apart. A kind of the user's own is the `Family` object itself, or `FILE.py:NAME`,
wherever the name of a kind is taken; whoever is given one calls `take_kind`.
"""

import difflib
import re
import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from .._errors import InputError, error_place
from .._user_files import place_file, require_trust, run_file, split_name, trust_file


# Stiffness of a ball over that of its gas: m/(P₀ v T³), T the time above half of the peak, is 0.65 for the reference
# model, and 0.52 to 0.79 on two dozen simulated campaigns with any effects of the catalogue. A thick wall can do more.
GAS_STIFFNESS = 0.65


@dataclass(frozen=True)
class Size:
    """A measured size: its value, its SI unit ("1" for a ratio), and the power with which each column enters."""

    value: float
    unit: str
    powers: Mapping[str, int]


Measure = Callable[[pd.DataFrame, Mapping[str, float]], dict[str, Size]]


@dataclass(frozen=True, kw_only=True)
class RecordKind:
    """A kind of records.

    Args:
        name: `family` in datapackage.json.
        channels: Of which a campaign needs at least one.
        series: Channels that an import takes from the samples, in the order in which it writes them.
        main: Channel that --force names, without which there is no import; "" where there is none.
        independents: Columns that samples may be given over, the first one that is there.
        conditions: That an import looks for, in the order in which it writes them.
        needs: Conditions that every campaign has to hold.
        pressure, speed, load: Conditions that --pressure, --speed and --load mean; "" where there are none.
        averaged: Columns of the samples whose mean is a condition, where they change within a test.
        words: What laboratories call the columns, without spaces and signs, by quantity.
        value_words: The same of single values of a test, such as its rebound speed, in a table with one row a test,
            that of a force first; empty where such a table cannot be imported.
        unknown: Parameters of the reference model that are left to the fit.
        parameters: Of the reference models of such tests, which may be known, with their units; empty where the kind
            does not list them.
        described: Parameters that describe the bodies, and the sentence for where none of them is stated.
        options: Option and heading, as examples, that give a condition which is needed.
        has_contact: Whether a record holds one contact, whose onset an import finds; before it the noise is measured.
        path: Channel that says how far a body has slid, along which the main channel counts positive; "" where none is.
        rates: Channels of the rates about the body's axes, of which a record keeps all to its start; none elsewhere.
        measure: Sizes of a record, from the table of its samples and the row of its conditions, by name.
        ranges: Lowest and highest plausible median of these, and of conditions, SI, beside those known to the toolkit.
    """

    name: str
    channels: tuple[str, ...]
    series: tuple[str, ...]
    main: str
    independents: tuple[str, ...]
    conditions: tuple[str, ...]
    needs: tuple[str, ...]
    words: Mapping[str, str]
    unknown: tuple[str, ...]
    pressure: str = ""
    speed: str = ""
    load: str = ""
    averaged: tuple[str, ...] = ()
    parameters: Mapping[str, str] = field(default_factory=dict)
    described: tuple[tuple[str, ...], str] = ((), "")
    options: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    has_contact: bool = False
    path: str = ""
    rates: tuple[str, ...] = ()
    value_words: Mapping[str, str] = field(default_factory=dict)
    measure: Measure = lambda trace, settings: {}
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)


def name_need(name: str, kinds: Iterable[RecordKind]) -> str:
    """What an effect needs, in words: of a known number also the option that states it."""
    unit = next((kind.parameters[name] for kind in kinds if name in kind.parameters), None)
    return name if unit is None else f"{name}, stated by `ddetumble import --known '{name}=NUMBER {unit}'`"


def measure_impact(trace: pd.DataFrame, settings: Mapping[str, float]) -> dict[str, Size]:
    """Duration, moving mass, stiffness over that of the gas, and depression of one impact."""
    if "normal_force" not in trace or "approach_speed" not in settings:
        return {}
    t, f = trace[["time", "normal_force"]].dropna().to_numpy(dtype=float).T
    if len(t) < 8 or not f.max() > 0:
        return {}
    above = t[f > 0.5 * f.max()]
    middle, width = 0.5 * (above[0] + above[-1]), float(above[-1] - above[0])
    contact = np.abs(t - middle) < 1.5 * width  # what lies farther off is drift or a second contact
    speed, pressure = float(settings["approach_speed"]), float(settings.get("initial_pressure", 0.0))
    mass = float(np.trapezoid(f[contact], t[contact])) / (1.7 * speed)  # of a restitution of 0.7
    sizes = {"duration of the impact": Size(2.0 * width, "s", {"time": 1}),
             "moving mass": Size(mass, "kg", {"normal_force": 1, "time": 1, "approach_speed": -1})}
    if pressure > 0 and width > 0:
        ratio = mass / (pressure * speed * width**3) / GAS_STIFFNESS
        sizes["stiffness over that of the gas"] = Size(ratio, "1", {
            "normal_force": 1, "time": -2, "approach_speed": -2, "initial_pressure": -1})
    if "depression" in trace and np.isfinite(trace["depression"].to_numpy(dtype=float)).any():
        depth = float(np.nanmax(trace["depression"].to_numpy(dtype=float)))
        sizes["depression"] = Size(depth, "m", {"depression": 1})
        if width > 0:
            sizes["depression over speed and duration"] = Size(depth / (speed * 2.0 * width), "1", {
                "depression": 1, "approach_speed": -1, "time": -1})
    return sizes


def measure_slip(trace: pd.DataFrame, settings: Mapping[str, float]) -> dict[str, Size]:
    """Friction, stroke, and path against speed of one friction record."""
    if "tangential_force" not in trace or "slip" not in trace:
        return {}
    force, slip = trace["tangential_force"].to_numpy(dtype=float), trace["slip"].to_numpy(dtype=float)
    force = float(np.nanmedian(np.abs(force)))
    sizes = {"tangential_force": Size(force, "N", {"tangential_force": 1}),
             "stroke": Size(float(np.nanmax(slip) - np.nanmin(slip)), "m", {"slip": 1}),
             "friction coefficient": Size(force / float(settings["normal_load"]), "1", {
                 "tangential_force": 1, "normal_load": -1})}
    speed, there = float(settings.get("slip_speed", 0.0)), np.isfinite(slip)
    if "time" in trace and speed > 0 and there.sum() > 1:
        moving = np.abs(np.diff(slip[there]) / np.diff(trace["time"].to_numpy(dtype=float)[there]))
        fastest = np.sort(moving)[len(moving) // 2:]  # the other half may rest or turn round
        sizes["path over speed and time"] = Size(float(np.median(fastest)) / speed, "1", {
            "slip": 1, "time": -1, "slip_speed": -1})
    return sizes


def measure_tumbling(trace: pd.DataFrame, settings: Mapping[str, float]) -> dict[str, Size]:
    """Largest angular rate of one tumbling record, and the angle that it turns between two samples."""
    rates = trace.filter(like="angular_velocity_").to_numpy(dtype=float)
    if not np.isfinite(rates).any():
        return {}
    largest = float(np.sqrt(np.nanmax(np.nansum(rates**2, axis=1))))
    turn = largest * float(np.median(np.diff(trace["time"].to_numpy(dtype=float))))
    return {"angular rate": Size(largest, "rad/s", {"angular_velocity": 1}),
            "turn between samples": Size(turn, "rad", {"angular_velocity": 1, "time": 1})}


IMPACT = RecordKind(
    name="impact",
    channels=("normal_force", "tangential_force", "depression", "pressure", "slip"),
    series=("normal_force", "tangential_force", "depression", "pressure", "slip"),
    main="normal_force",
    independents=("time",),
    conditions=("initial_pressure", "approach_speed", "tangential_speed", "sequence", "temperature"),
    needs=("initial_pressure", "approach_speed"),
    words={
        "normal_force": "f fz fn force kraft normalforce normalkraft forcez loadcell",
        "tangential_force": "ft tangentialforce frictionforce friction reibkraft reibungskraft tangentialkraft",
        "initial_pressure": "p0 initialpressure fillpressure fülldruck anfangsdruck",
        "approach_speed": "v v0 v1 speed velocity approachspeed impactspeed impactvelocity approachvelocity "
        "geschwindigkeit aufprallgeschwindigkeit",
        "tangential_speed": "vt tangentialspeed tangentialvelocity",
        "sequence": "sequence impactno impactnumber hitno",
        "slip": "slip",
    },
    unknown=("effective_mass", "restitution"),
    parameters={
        "outer_diameter": "m", "inner_diameter": "m", "ambient_pressure": "Pa", "elastic_modulus": "Pa",
        "poisson_ratio": "1", "contact_radius_coefficient": "1", "stiffness_force": "N", "exponent": "1",
        "condition_exponent": "1", "tangential_mass": "kg", "rolling_mass": "kg", "friction_coefficient": "1",
        "creep_speed": "m/s", "adhesion_constant": "1", "loss_factor": "1", "tensile_strength": "Pa",
        "real_contact_pressure": "Pa"},
    pressure="initial_pressure",
    speed="approach_speed",
    described=(("outer_diameter",),
               "The ball's outer diameter is not stated and counts as the paper's, 60 mm; state yours, as in "
               "--known 'outer_diameter=62 mm'."),
    options={"initial_pressure": ("--pressure '1.0 MPa'", "p [MPa]"),
             "approach_speed": ("--speed '0.4 m/s'", "v [m/s]")},
    has_contact=True,
    value_words={
        "peak_normal_force": "f fmax force peakforce maxforce maximumforce kraft maximalkraft spitzenkraft",
        "rebound_speed": "v2 vr vout reboundspeed reboundvelocity exitspeed exitvelocity rückprallgeschwindigkeit",
        "contact_time": "tc contacttime contactduration duration kontaktzeit kontaktdauer",
        "impulse": "impulse impuls kraftstoß",
        "peak_depression": "depression maxdepression maximumdepression depth maxdepth indentation eindrücktiefe",
    },
    measure=measure_impact,
)
_RUBBER = ("tensile_strength", "real_contact_pressure", "elastic_modulus", "poisson_ratio")
SLIP = RecordKind(
    name="slip",
    channels=("tangential_force", "normal_force", "pressure", "depression", "slip"),
    series=("tangential_force", "slip", "pressure", "depression"),
    main="tangential_force",
    independents=("time", "slip"),
    conditions=("normal_load", "internal_pressure", "slip_speed", "temperature"),
    needs=("normal_load", "internal_pressure", "slip_speed"),
    words={
        "tangential_force": "f ft fx fr force kraft tangentialforce frictionforce friction reibkraft reibungskraft "
        "tangentialkraft",
        "normal_load": "load normalload fn normalforce fz normalkraft last auflast",
        "internal_pressure": "p0 internalpressure",
        "slip_speed": "v u vs speed velocity slipspeed slipvelocity slidingspeed slidingvelocity geschwindigkeit "
        "gleitgeschwindigkeit",
        "slip": "s slip slipdistance slidingdistance displacement gleitweg weg",
    },
    unknown=("adhesion_constant", "loss_factor", "slip_scale"),
    parameters={
        "tensile_strength": "Pa", "real_contact_pressure": "Pa", "elastic_modulus": "Pa", "poisson_ratio": "1",
        "friction_coefficient": "1", "ambient_pressure": "Pa", **{
            f"{name}_{power}": unit
            for name, powers, unit in (("a", 2, "1"), ("sum", 3, "1/mm"), ("difference", 3, "1/mm"), ("c", 3, "1"),
                                       ("e", 3, "1"))
            for power in range(powers)}},
    pressure="internal_pressure",
    speed="slip_speed",
    load="normal_load",
    averaged=("normal_load", "pressure"),
    described=(
        _RUBBER, f"The rubber is not described ({', '.join(_RUBBER)}), so the paper's is assumed; --known states "
                 f"another."),
    options={"internal_pressure": ("--pressure '1.0 MPa'", "p [MPa]"), "slip_speed": ("--speed '20 mm/s'", "v [mm/s]"),
             "normal_load": ("--load '20 N'", "Load [N]")},
    path="slip",
    value_words={
        "peak_friction_force": "f ft fx force friction frictionforce peakfriction peakforce maxfriction "
        "maximumfriction reibkraft reibungskraft"},
    measure=measure_slip,
)
_RATES = ("angular_velocity_x", "angular_velocity_y", "angular_velocity_z")
TUMBLE = RecordKind(
    name="tumble",
    channels=_RATES,
    series=_RATES,
    main="",
    independents=("time",),
    conditions=("temperature",),
    needs=(),
    words={f"angular_velocity_{axis}": " ".join(word + axis for word in (
        "angularvelocity", "omega", "w", "ω", "gyro", "gyroscope", "gyr", "g", "rate")) for axis in "xyz"},
    unknown=("inertia_ratio",),
    parameters={"orbit_rate": "rad/s"},
    rates=_RATES,
    measure=measure_tumbling,
)
KINDS: dict[str, RecordKind] = {kind.name: kind for kind in (IMPACT, SLIP, TUMBLE)}
ORDERS = {"x": "yzx", "y": "zxy", "z": "xyz"}  # old axes in the places of x, y, z, by the one that becomes z
DEFAULT_KIND = IMPACT.name  # where nothing says which
ELSEWHERE = {  # names that are no kind of records, and how such records are given
    "oblique": "oblique impacts belong to the family impact, with a tangential speed among the conditions and "
    "--keep tangential_force=COLUMN"}


class _Own(NamedTuple):
    """A kind of tests of the user's own, its file ("" where it has none) and its name there."""

    given: Any
    file: str
    variable: str


_TAKEN: dict[str, _Own] = {}


def list_own() -> tuple[Any, ...]:
    """Objects of the user's own that were given so far."""
    return tuple(own.given for own in _TAKEN.values())


def list_kinds() -> dict[str, RecordKind]:
    """All kinds by name: the toolkit's, and those of the user's own that were given so far."""
    return KINDS | {name: own.given.kind for name, own in _TAKEN.items()}


def turn_name(name: str, axis: str) -> str:
    """The column that takes the place of this one where that axis becomes z: itself unless it is of an axis."""
    if not re.fullmatch("(angular_velocity|attitude)_[xyz]|attitude_[123]", name):
        return name
    letters = "123" if name[-1] in "123" else "xyz"  # of a quaternion, whose scalar is 0 or w
    return name[:-1] + letters["xyz".index(ORDERS[axis][letters.index(name[-1])])]


def find_kind(name: str) -> RecordKind:
    """The kind of that name, which `take_kind` returned."""
    return list_kinds()[name]


def take_kind(given: Any, folder: Path | None = None) -> str:
    """Name of the kind that an argument stands for; one of the user's own is known by it from then on.

    Args:
        given: Name of a kind, `FILE.py:NAME`, or a `Family`.
        folder: From which on the path of a file counts; the working directory where not given.

    Raises:
        InputError: There is no such kind, file or name, or the name is that of another kind.
    """
    if not isinstance(given, str):  # named in the module in which its model of a record was written
        module = sys.modules.get(getattr(getattr(given, "observe", None), "__module__", ""))
        file = getattr(module, "__file__", None)
        name = next((name for name, value in vars(module).items() if value is given), "") if module and file else ""
        return _take(_Own(given, str(Path(file).resolve()) if file and name else "", name))
    own = split_name(given)
    if own is None:
        if given not in list_kinds():
            *first, last = list_kinds()
            near = difflib.get_close_matches(given, list_kinds(), n=1)
            more = f"; {ELSEWHERE[given]}" if given in ELSEWHERE else f"; did you mean {near[0]}?" if near else ""
            raise InputError(f"the family must be {', '.join(first)} or {last}, or FILE.py:NAME for one of your own, "
                             f"not {given!r}{more}")
        return given
    file, variable = own
    if folder is not None:
        file = folder / file
        if not file.is_file():
            raise InputError(f"the kind of tests is {given!r}, relative to this folder, but that file does not exist; "
                             "move it along with the folder, or correct the path", file=folder, key="family")
        require_trust(file, folder)
    found = run_file(file).__dict__.get(variable)
    if found is None:
        raise InputError(f"there is no {variable!r} in the file", file=file)
    return _take(_Own(found, str(file.resolve()), variable))


def _take(own: _Own) -> str:
    kind = getattr(own.given, "kind", None)
    with error_place(file=own.file or None):
        if not isinstance(kind, RecordKind) or getattr(own.given, "name", None) != kind.name:
            raise InputError(f"{own.variable or own.given!r} is not a kind of tests: it must be a `Family` whose "
                             "`kind` has the same name")
        before = _TAKEN.get(kind.name)
        if kind.name in KINDS or kind.name in ELSEWHERE or before is not None and before.file != own.file:
            where = f" in {before.file}" if before is not None and before.file else ""
            raise InputError(f"there is a kind of tests {kind.name!r} already{where}; give this one another name")
    _TAKEN[kind.name] = own
    return kind.name


def write_kind(name: str, folder: Path) -> str:
    """A kind as a file in a folder names it: its name, or `FILE.py:NAME` from there on; one in no file is refused."""
    own = _TAKEN.get(name)
    if own is None:
        return name
    if not own.file:
        raise InputError(f"the kind of tests {name!r} is defined in no file that the data could name; give it "
                         "as FILE.py:NAME")
    trust_file(Path(own.file))
    return f"{place_file(Path(own.file), folder)}:{own.variable}"
