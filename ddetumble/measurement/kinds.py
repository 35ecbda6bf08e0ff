"""Kinds of records as campaigns hold them: their columns, what a laboratory calls these, and what an import asks for.

This is the part of a family of tests (`ddetumble.inference.families`) that needs no model. Impacts straight on and
oblique ones are of one kind: the columns tell them apart.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field


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
        unknown: Parameters of the reference model that are left to the fit.
        described: Parameters that describe the bodies, and the sentence for where none of them is stated.
        options: Option and heading, as examples, that give a condition which is needed.
        has_contact: Whether a record holds one contact, whose onset an import finds; before it the noise is measured.
        path: Channel that says how far a body has slid, along which the main channel counts positive; "" where none is.
        rates: Channels of the rates about the body's axes, of which a record keeps all to its start; none elsewhere.
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
    described: tuple[tuple[str, ...], str] = ((), "")
    options: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    has_contact: bool = False
    path: str = ""
    rates: tuple[str, ...] = ()


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
    pressure="initial_pressure",
    speed="approach_speed",
    described=(
        ("outer_diameter",),
        "The ball's outer diameter is not stated; --known 'outer_diameter=60 mm' states it.",
    ),
    options={
        "initial_pressure": ("--pressure '1.0 MPa'", "p [MPa]"),
        "approach_speed": ("--speed '0.4 m/s'", "v [m/s]"),
    },
    has_contact=True,
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
    pressure="internal_pressure",
    speed="slip_speed",
    load="normal_load",
    averaged=("normal_load", "pressure"),
    described=(
        _RUBBER,
        f"The rubber is not described ({', '.join(_RUBBER)}): the paper's is taken; --known states another.",
    ),
    options={
        "internal_pressure": ("--pressure '1.0 MPa'", "p [MPa]"),
        "slip_speed": ("--speed '20 mm/s'", "v [mm/s]"),
        "normal_load": ("--load '20 N'", "Load [N]"),
    },
    path="slip",
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
    words={
        f"angular_velocity_{axis}": f"angularvelocity{axis} omega{axis} w{axis} ω{axis} gyro{axis} gyroscope{axis} "
        f"rate{axis}"
        for axis in "xyz"
    },
    unknown=("inertia_ratio",),
    rates=_RATES,
)
KINDS: dict[str, RecordKind] = {kind.name: kind for kind in (IMPACT, SLIP, TUMBLE)}
# Names that are no kind of records, and how such records are given.
ELSEWHERE = {
    "oblique": "oblique impacts are of the family impact, with a tangential speed among the conditions and "
    "--keep tangential_force=COLUMN",
}
