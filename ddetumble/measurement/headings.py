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
_COUNTERS = "repeats? repetition replicate replica wiederholung wdh essai".replace(" ", "|")


def guess_role(heading: str, kind: RecordKind) -> str | None:
    """The quantity that a heading (without its unit) names in raw data of a kind, or None."""
    word = re.sub(r"[\W_]+", "", heading).casefold()
    return next((role for role, words in {**_COMMON, **kind.words}.items()
                 if word in words.split() or word == role.replace("_", "")), None)


def is_counter(heading: str) -> bool:
    """Whether a heading names a number that only tells repeats of one condition apart."""
    word = re.sub(r"[\W_]+", "", heading).casefold()
    return re.fullmatch(f"({_COUNTERS})(no|nr|number|id)?", word) is not None


def name_condition(text: str) -> str:
    """A column's name for a heading: lower case, words joined by underscores."""
    return re.sub(r"\W+", "_", text).strip("_").lower() or "condition"


def expand_role(name: str, kind: RecordKind) -> str:
    """The quantity that an option's short name means: `force`, `pressure` (as a condition: `p0`) and `speed`."""
    short = {"force": kind.main, "load": "normal_load", "speed": kind.speed, "p0": kind.pressure}
    return short.get(name) or name


def read_pairs(option: str, given) -> dict[str, str]:
    """Entries NAME=VALUE of an option, given as a mapping, one text or several.

    Raises:
        InputError: An entry without "=", or a name given twice.
    """
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
