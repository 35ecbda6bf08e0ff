"""What a laboratory's column names mean: the toolkit's quantity behind `Fz`, `Kraft`, `t` or `P0`."""

import re

from .._errors import InputError


MAIN = {"impact": "normal_force", "slip": "tangential_force", "tumble": None}
PRESSURE = {"impact": "initial_pressure", "slip": "internal_pressure", "tumble": None}
SPEED = {"impact": "approach_speed", "slip": "slip_speed", "tumble": None}
LOAD = {"slip": "normal_load"}
CONDITIONS = {
    "impact": ("initial_pressure", "approach_speed", "tangential_speed", "sequence", "temperature"),
    "slip": ("normal_load", "internal_pressure", "slip_speed", "temperature"),
    "tumble": ("temperature",),
}
_COMMON = {
    "record": "record recordid test testid testno testnr testnumber run runid runno shot trial versuch versuchsnr",
    "time": "t time zeit temps tempo elapsedtime timestamp",
    "temperature": "temperature temp temperatur",
    "depression": "depression depth indentation compressiondepth eindrücktiefe eindringtiefe",
    "pressure": "p pressure druck gaspressure innendruck",
}
_COUNTERS = {"repeat", "repeats", "repetition", "replicate", "replica", "wiederholung", "wdh", "essai"}
_WORDS = {
    "impact": {
        "normal_force": "f fz fn force kraft normalforce normalkraft forcez loadcell",
        "tangential_force": "ft tangentialforce frictionforce friction reibkraft reibungskraft tangentialkraft",
        "initial_pressure": "p0 initialpressure fillpressure fülldruck anfangsdruck",
        "approach_speed": "v v0 v1 speed velocity approachspeed impactspeed impactvelocity approachvelocity "
        "geschwindigkeit aufprallgeschwindigkeit",
        "tangential_speed": "vt tangentialspeed tangentialvelocity",
        "sequence": "sequence impactno impactnumber hitno",
        "slip": "slip",
    },
    "slip": {
        "tangential_force": "f ft fx fr force kraft tangentialforce frictionforce friction reibkraft reibungskraft "
        "tangentialkraft",
        "normal_load": "load normalload fn normalforce fz normalkraft last auflast",
        "internal_pressure": "p0 internalpressure",
        "slip_speed": "v u vs speed velocity slipspeed slipvelocity slidingspeed slidingvelocity geschwindigkeit "
        "gleitgeschwindigkeit",
        "slip": "s slip slipdistance slidingdistance displacement gleitweg weg",
    },
    "tumble": {
        f"angular_velocity_{axis}": f"angularvelocity{axis} omega{axis} w{axis} ω{axis} gyro{axis} gyroscope{axis} "
        f"rate{axis}"
        for axis in "xyz"
    },
}


def guess_role(heading: str, family: str) -> str | None:
    """The quantity that a heading (without its unit) names in a family's raw data, or None."""
    word = re.sub(r"[\W_]+", "", heading).casefold()
    for role, words in (_COMMON | _WORDS[family]).items():
        if word in words.split() or word == role.replace("_", ""):
            return role
    return None


def is_counter(heading: str) -> bool:
    """Whether a heading names a number that only tells repeats of one condition apart."""
    word = re.sub(r"[\W_]+", "", heading).casefold()
    return re.sub(r"(no|nr|number|id)$", "", word) in _COUNTERS


def expand_role(name: str, family: str) -> str:
    """The quantity that an option's short name means: `force`, `pressure` (as a condition: `p0`) and `speed`."""
    short = {"force": MAIN[family], "load": "normal_load", "speed": SPEED[family], "p0": PRESSURE[family]}
    return short.get(name) or name


def read_pairs(option: str, given) -> dict[str, str]:
    """Entries NAME=VALUE of an option, given as a mapping, one text or several.

    Raises:
        InputError: An entry without "=", or a name given twice.
    """
    if given is None:
        return {}
    if isinstance(given, dict):
        return {str(key): str(value) for key, value in given.items()}
    pairs = {}
    for entry in [given] if isinstance(given, str) else given:
        name, sign, value = str(entry).partition("=")
        if not sign or not name.strip() or not value.strip():
            raise InputError(f"--{option} is given as NAME=VALUE, not {entry!r}")
        if name.strip() in pairs:
            raise InputError(f"--{option} gives {name.strip()!r} twice")
        pairs[name.strip()] = value.strip()
    return pairs
