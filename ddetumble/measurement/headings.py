"""What a laboratory's column names mean: the toolkit's quantity behind `Fz`, `Kraft`, `t` or `P0`."""

import re

from .._errors import InputError
from .kinds import RecordKind


_COMMON = {
    "record": "record recordid test testid testno testnr testnumber run runid runno shot trial versuch versuchsnr",
    "time": "t time zeit temps tempo elapsedtime timestamp",
    "temperature": "temperature temp temperatur",
    "depression": "depression depth indentation compressiondepth eindrücktiefe eindringtiefe",
    "pressure": "p pressure druck gaspressure innendruck",
}
_COUNTERS = {"repeat", "repeats", "repetition", "replicate", "replica", "wiederholung", "wdh", "essai"}


def guess_role(heading: str, kind: RecordKind) -> str | None:
    """The quantity that a heading (without its unit) names in raw data of a kind, or None."""
    word = re.sub(r"[\W_]+", "", heading).casefold()
    for role, words in {**_COMMON, **kind.words}.items():
        if word in words.split() or word == role.replace("_", ""):
            return role
    return None


def is_counter(heading: str) -> bool:
    """Whether a heading names a number that only tells repeats of one condition apart."""
    word = re.sub(r"[\W_]+", "", heading).casefold()
    return re.sub(r"(no|nr|number|id)$", "", word) in _COUNTERS


def expand_role(name: str, kind: RecordKind) -> str:
    """The quantity that an option's short name means: `force`, `pressure` (as a condition: `p0`) and `speed`."""
    short = {"force": kind.main, "load": "normal_load", "speed": kind.speed, "p0": kind.pressure}
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
