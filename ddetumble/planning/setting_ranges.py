"""Ranges of the settings of the next bench test, and channels that could be added: defaults, and what options say."""

import dataclasses as dc
import math
import numbers
import re
from collections.abc import Mapping, Sequence

from .._errors import InputError
from ..contact.effect import read_validity
from ..dynamics.spinning import ATTITUDES
from ..families import find_family
from ..inference.archive import FittedModel
from ..measurement.columns import expand_role, read_pairs
from ..measurement.units import NUMBER, check_unit, parse_quantity, parse_uncertainty, parse_unit, si_unit


# By which limits reach beyond a condition that was held still, and beyond one that was not: a rig can do more than it
# did, and what was varied needs less.
NARROW, WIDE = 2.0, 1.25
# Ratio of highest to lowest below which a condition counts as held still: more than scatter, less than a second level.
STILL = 1.2


@dc.dataclass(frozen=True)
class Limit:
    """Range of one condition of the next test, SI; `low` equals `high` where it is held still."""

    name: str
    unit: str
    low: float
    high: float

    @property
    def logarithmic(self) -> bool:
        """Whether the condition is positive, so that it is searched and drawn by ratios."""
        return self.low > 0

    @property
    def free(self) -> bool:
        """Whether there is anything to choose."""
        return self.high > self.low


@dc.dataclass(frozen=True)
class Extra:
    """A channel that could be added: its name, the channels it stands for, standard deviation and unit, SI; `assumed`
    says that the noise is ours, not the user's.
    """

    name: str
    channels: tuple[str, ...]
    sd: float
    unit: str
    assumed: bool


# Text with a unit, or SI: a value, or the lower and the upper one, each of which may be a text with its unit.
Range = str | float | tuple[str | float, str | float]


def set_limits(saved: FittedModel, entries: Mapping[str, Range] | Sequence[str] | None = None) -> tuple[Limit, ...]:
    """Limits of all conditions of the next test: the campaign's own range, extended, and what the options say
    (`NAME=LOW..HIGH UNIT`, or `NAME=VALUE UNIT` for a condition that is held still; by name numbers in SI will do).

    Raises:
        InputError: no such condition, a wrong unit, limits that are none.
    """
    family, known = find_family(saved.family), dict(saved.ranges)
    if family.free_running:
        assert saved.sampling is not None
        fastest = max(x for name, x in saved.sampling.largest.items() if name in family.main)
        known |= dict.fromkeys(family.starts, (-fastest, fastest))
    pairs = entries if isinstance(entries, Mapping) else read_pairs("limit", entries)
    given = {expand_role(k, family.kind): v for k, v in pairs.items()}
    strange = [name for name in given if name not in known]
    if strange:
        raise InputError(f"there is no condition {strange[0]!r}; this campaign has {', '.join(known) or 'none'}",
                         option="limits" if isinstance(entries, Mapping) else "--limit")
    found = []
    for name, (low, high) in known.items():
        if name in given:
            low, high = _read_range(name, given[name], "limits, " if isinstance(entries, Mapping) else "--limit ")
        elif name == "sequence":
            low = high = high + 1.0
        elif name not in family.plan.chosen:
            low = high = math.sqrt(low * high) if low > 0 else 0.5 * (low + high)
        elif name in family.starts:
            pass  # known as it is above
        elif low <= 0:
            low, high = max(low, 0.0), WIDE * high
        else:
            factor = NARROW if high < STILL * low else WIDE
            # Not beyond where the model's equations hold, unless the campaign lies there as a whole.
            first, last = read_validity(saved.space.reference).get(name, (0.0, math.inf))
            wider = max(low / factor, first), min(high * factor, last)
            low, high = wider if wider[0] < wider[1] else (low, high)
        found.append(Limit(name, saved.units.get(name) or si_unit(name), low, high))
    return tuple(found)


def _read_range(name: str, given: Range, source: str) -> tuple[float, float]:
    """`0.2..2 m/s`, or one value with its unit, in SI; numbers are so already. `source` is where it was given."""
    place = f"{source}{name}"
    if isinstance(given, str):
        if re.search(r"\d,\d", given):
            raise InputError(f"{place} needs decimal points, not commas: {given!r}")
        match = re.fullmatch(rf"\s*({NUMBER})(?:\s*\.\.\s*({NUMBER}))?\s*([^\d.].*)?", given, re.ASCII | re.DOTALL)
        # A range as people write it, perhaps with its unit at both ends: `0.1-0.3 m/s`, `0.1 m/s to 0.3 m/s`.
        loose = re.fullmatch(
            rf"\s*((?>{NUMBER}))\s*([A-Za-z/%]+\s*)??(?:--?|–|—|to|:|…|\.\.\.?)\s*({NUMBER})\s*([^\d.].*)?",
            given, re.ASCII | re.DOTALL)
        if loose is not None and (match is None or match[2] is None and not _is_unit(match[3])):
            alike = (loose[2] or "").strip() in ("", loose[4])
            meant = f"{loose[1]}..{loose[3]} {loose[4] or si_unit(name)}".removesuffix(" 1")
            if "--" in given and loose[1].startswith("-"):  # the upper end may be negative, too
                raise InputError(f"{place} takes LOW..HIGH UNIT, with two points between, not {given!r}")
            raise InputError(f"{place} takes LOW..HIGH UNIT" + (
                f"; write it like '{meant}'" if alike else f", with one unit for both ends, not {given!r}"))
        if match is None:
            raise InputError(f"{place} takes LOW..HIGH UNIT, such as '0.2..2 {si_unit(name)}', not {given!r}")
        if not match[3] and si_unit(name) != "1":
            raise InputError(f"{place} needs a unit: write it like '{given.strip()} {si_unit(name)}'")
        unit = check_unit(match[3] or "1", name)
        low, high = (float(unit.convert(float(x))) for x in (match[1], match[2] or match[1]))
    else:
        ends = given if isinstance(given, (tuple, list)) else (given, given)
        if len(ends) != 2 or not all(isinstance(end, (str, numbers.Real)) for end in ends):
            raise InputError(f"{place} takes a value, or the lower and the upper one, not {given!r}")
        low, high = (parse_quantity(end, name) if isinstance(end, str) else float(end) for end in ends)
    if not (math.isfinite(low) and math.isfinite(high)):
        raise InputError(f"{place} is not finite: {given!r}")
    if high < low:
        raise InputError(f"{place} must have the lower value first, not {given!r}")
    signed = name.startswith("angular_velocity")
    if not signed and (low < 0 or (low == 0 and name in ("approach_speed", "normal_load", "slip_speed"))):
        raise InputError(f"{place} must be positive: {given!r}")
    return low, high


def _is_unit(text: str | None) -> bool:
    """Whether what stands behind a number, if anything, can be read as a unit."""
    try:
        parse_unit(text or "1")
    except InputError:
        return False
    return True


def list_extras(saved: FittedModel, entries: Sequence[str] | Mapping[str, str] | None = None) -> tuple[Extra, ...]:
    """Channels that could be added: those of the options (`NAME: NOISE UNIT`), or with none the usual ones.

    Raises:
        InputError: the family has no such channel, the campaign measures it already, its noise makes no sense.
    """
    offered = {} if saved.are_values else find_family(saved.family).plan.added  # beside values there are no series
    measured = {name for name in offered if any(channel.startswith(name) for channel in saved.channels)}
    found = []
    for name, noise in read_channels(offered if entries is None else entries).items():
        if name not in offered:
            there = f"it may be {', '.join(offered)}" if offered else "records of this family have no further channel"
            raise InputError(f"--channel: {name!r} is not a channel that could be added; {there}")
        if name not in measured:
            found.append(Extra(name, ATTITUDES[:4] if name == "attitude" else (name,), read_noise(name, noise),
                               check_unit(si_unit(name), name).si, entries is None))
        elif entries is not None:
            raise InputError(f"--channel: the campaign already measures {name!r}")
    return tuple(found)


def read_channels(entries: Sequence[str] | Mapping[str, str]) -> dict[str, str]:
    """Noise by channel, of entries `NAME: NOISE UNIT`."""
    return read_pairs("channel", entries if isinstance(entries, Mapping)
                      else [entry.replace(":", "=", 1) for entry in entries])


def read_noise(channel: str, text: str) -> float:
    """Standard deviation of a channel's noise, SI."""
    found = parse_uncertainty(text, check_unit(si_unit(channel), channel), channel).absolute
    if found is None:
        raise InputError(f"--channel {channel}: the noise must be absolute, with a unit")
    return found
