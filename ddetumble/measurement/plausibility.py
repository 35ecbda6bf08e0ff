"""Plausibility of a whole campaign: orders of magnitude, and relations between columns that a wrong unit breaks.

A unit that is wrong throughout leaves no record standing out. What gives it away is a size that no bench has, or a
relation that holds whatever effect is missing: impulse, speed and duration of an impact on an inflated ball tell the
stiffness, and with it the pressure, within a factor of about two.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from .campaign import Campaign, Column
from .kinds import Size, find_kind
from .quantities import describe_quantity
from .units import parse_unit, role_of, si_unit


# Ranges are those of benches and objects that the models are made for, widened to the next round number: lowest and
# highest plausible median, SI.
Ranges = Mapping[str, tuple[float, float]]
RANGES: Ranges = {
    "initial_pressure": (5e4, 5e6), "internal_pressure": (5e4, 5e6),  # half an atmosphere to twice the paper's highest
    "approach_speed": (1e-3, 30.0), "tangential_speed": (0.0, 30.0), "slip_speed": (1e-7, 20.0),
    "normal_load": (1e-2, 2e4), "tangential_force": (1e-3, 2e4),
    "friction coefficient": (2e-3, 30.0),  # over the load as stated; a gas may press on a seal beside it
    "duration of the impact": (5e-5, 1.0), "moving mass": (2e-3, 300.0), "depression": (1e-6, 0.3),
    "stroke": (1e-6, 10.0), "angular rate": (1e-5, 60.0), "turn between samples": (0.0, np.pi),
    "stiffness over that of the gas": (0.2, 5.0), "depression over speed and duration": (0.12, 0.9),
    "path over speed and time": (0.5, 2.0), "temperature": (150.0, 500.0),
}  # fmt: skip
FAR = 3.0  # times beyond its range, from which on the size of a single record is asked about
ENOUGH = 10  # different readings of a record, from which on another does not repeat them by chance
NAMED = 5  # copies that a sentence names
# What that ratio has to be once a mistaken unit is corrected. Its spread (a standard deviation of about 14 %) does not
# tell factors of 6.9 (psi as kPa) and 10 (MPa as bar) from each other for sure: both may agree.
CORRECTED = (0.6, 1.7)
TYPICAL = {"stiffness over that of the gas": 1.0, "path over speed and time": 1.0}  # of ratios, in the right units
# The same of single numbers that a campaign, a specification or the command line states. The pressure around a test
# may be a vacuum, and a stiff arm may count as any mass.
NUMBERS: Ranges = {
    "outer_diameter": (5e-3, 2.0), "inner_diameter": (4e-3, 2.0), "effective_mass": (2e-3, 1e3),
    "ambient_pressure": (0.0, 3e5), "tensile_strength": (1e5, 5e8), "real_contact_pressure": (1e5, 2e9),
    "elastic_modulus": (1e5, 5e8),  # of rubber and other soft polymers
    "orbit_rate": (-2e-3, 2e-3),  # a turn in 52 minutes: faster is no orbit of the Earth; the sign is a sense
}
MISTAKES: dict[str, tuple[tuple[str, str], ...]] = {  # the unit that the values are in, and the one that was stated
    "pressure": (("bar", "MPa"), ("kPa", "MPa"), ("bar", "Pa"), ("MPa", "Pa"), ("kPa", "Pa"), ("psi", "bar"),
                 ("psi", "MPa"), ("MPa", "bar"), ("kPa", "bar"), ("psi", "kPa"), ("psi", "Pa"), ("MPa", "psi"),
                 ("Pa", "bar"), ("Pa", "MPa"), ("Pa", "kPa"), ("bar", "kPa"), ("MPa", "kPa")),
    "speed": (("mm/s", "m/s"), ("m/s", "mm/s"), ("cm/s", "m/s"), ("m/s", "cm/s"), ("mm/s", "cm/s"),
              ("cm/s", "mm/s"), ("km/h", "m/s"), ("mm/min", "mm/s"), ("mm/s", "mm/min")),
    "time": (("ms", "s"), ("s", "ms"), ("us", "s"), ("us", "ms"), ("ms", "us"), ("s", "min"), ("min", "s")),
    "force": (("N", "kN"), ("kN", "N"), ("mN", "N"), ("N", "mN"), ("kgf", "N"), ("N", "kgf"), ("gf", "N")),
    "length": (("mm", "m"), ("m", "mm"), ("um", "mm"), ("mm", "um"), ("um", "m"), ("cm", "m"), ("mm", "cm")),
    "mass": (("g", "kg"), ("kg", "g")),
    "angular velocity": (("deg/s", "rad/s"), ("rad/s", "deg/s"), ("rpm", "rad/s")),
}  # fmt: skip
# Columns whose unit may be wrong, the likeliest first.
_SUSPECTS = ("initial_pressure", "internal_pressure", "approach_speed", "slip_speed", "tangential_speed", "normal_load",
             "normal_force", "tangential_force", "time", "depression", "slip", "angular_velocity")


@dataclass(frozen=True)
class Implausibility:
    """Something about a campaign as a whole that a wrong unit would explain."""

    variable: str  # column, known number or measured size that is out of the ordinary
    value: float  # its median over the records, or that of the one record that is asked about [SI]
    # low, high: what is expected of it [SI].
    low: float
    high: float
    unit: str  # SI unit of these, "1" for a ratio
    # Wrong units each of which alone would explain all that is out of the ordinary: the column, the unit that its
    # values would be in, and the one that was stated. Columns come in the order in which they are likely to be wrong,
    # and each one's units by how well they agree; none where no single one explains all.
    mistakes: tuple[tuple[str, str, str], ...]
    sentence: str  # the question, in words

    def __str__(self) -> str:
        return self.sentence


def check_plausibility(campaign: Campaign) -> tuple[Implausibility, ...]:
    """Find implausible magnitudes in a campaign, and the wrong units that would explain them.

    Every size that the campaign tells is compared with its range, in `RANGES` or of its kind of tests. One column in
    another unit than stated is the explanation where it brings all of them into their ranges; where none does, each is
    named on its own. Every unit that does so is named, or, if there are any, every one that brings the stiffness of the
    gas nearly right. Of a column whose unit the file states, only that unit counts as stated. Where the campaign as a
    whole is ordinary, a size of a single record that is out of all proportion is asked about. Known numbers are judged
    each by itself, first; last, noise that is stated as larger than all that a channel reads.

    Args:
        campaign: As read or imported, SI.

    Returns:
        What should be asked about, none where all is ordinary.
    """
    ranges = {**RANGES, **find_kind(campaign.family).ranges}
    known = check_numbers({name: value for name, value in campaign.known.items() if value is not None})
    # A column in a wrong unit is no longer that of its noise: one question is enough.
    return (*known, *(_check_sizes(campaign, ranges) or _check_noise(campaign)))


def find_copies(campaign: Campaign) -> dict[str, str]:
    """Records whose readings are those of an earlier record, sample by sample, and that record.

    Noise does not repeat itself: a file was read twice, or saved under two names. Records with fewer than `ENOUGH`
    different readings are not judged, as a coarse gauge may repeat these.
    """
    found: dict[str, str] = {}
    if campaign.samples is None:
        return found
    seen: dict[bytes, str] = {}
    names = list(campaign.channels)
    for key, own in campaign.samples.groupby("record", sort=False):
        values = own[names].to_numpy(dtype=float)
        if max(len(np.unique(column[np.isfinite(column)])) for column in values.T) < ENOUGH:
            continue
        first = seen.setdefault(values.tobytes(), str(key))
        if first != str(key):
            found[str(key)] = first
    return found


def say_copies(campaign: Campaign) -> list[str]:
    """A sentence on records that repeat the readings of others; none where there are none."""
    pairs = [f"{key} those of {first}" for key, first in find_copies(campaign).items()]
    if not pairs:
        return []
    told = ", ".join(pairs[:NAMED]) + f" and {len(pairs) - NAMED} more" * (len(pairs) > NAMED)
    return [f"Records repeat the readings of others, sample by sample ({told}): copies count as measurements of their "
            "own and make errors look smaller than they are. Leave them out."]


def check_numbers(values: Mapping[str, float]) -> tuple[Implausibility, ...]:
    """Find implausible single numbers [SI] among those named, and the wrong units that would explain each."""
    found = []
    for name in filter(values.__contains__, NUMBERS):
        size = Size(float(values[name]), si_unit(name), {name: 1})
        if not _is_within(size.value, NUMBERS[name]):
            found.append(_ask(name, size, tuple(_list_mistakes(name, {name: size}, False, NUMBERS, "")), NUMBERS))
    return tuple(found)


def _check_sizes(campaign: Campaign, ranges: Ranges) -> tuple[Implausibility, ...]:
    """What is implausible about the columns of a campaign."""
    rows = _measure_sizes(campaign, ranges)
    sizes = {name: replace(next(iter(own.values())), value=float(np.median([size.value for size in own.values()])))
             for name, own in rows.items()}
    odd = [name for name, size in sizes.items() if not _is_within(size.value, ranges[name])]
    if not odd:
        return _find_single(rows, ranges)
    mistakes, relations = [], [name for name in odd if " over " in name]
    for column in _SUSPECTS:
        if all(column in sizes[name].powers for name in odd):
            stated = _find_stated(campaign, column)
            ambient = campaign.known.get("ambient_pressure") or 0.0
            mistakes += _list_mistakes(column, sizes, len(relations) == len(odd), ranges, stated.stated,
                                       ambient if stated.gauge else 0.0)
    if mistakes:
        return (_ask(odd[0], sizes[odd[0]], tuple(mistakes), ranges),)
    # A relation of several columns is the more doubtful: it is told only where nothing else is.
    plain = [name for name in odd if name not in relations] or odd
    return tuple(_ask(name, sizes[name], (), ranges) for name in plain)


def _check_noise(campaign: Campaign) -> list[Implausibility]:
    """Channels whose readings lie closer together than one standard deviation of the noise that is stated: of
    white noise hardly one set of `ENOUGH` readings in a thousand does.
    """
    found = []
    for name, column in campaign.channels.items():
        sd = column.uncertainty.absolute if column.uncertainty is not None else None
        readings = campaign.samples[name].dropna() if campaign.samples is not None and name in campaign.samples else ()
        span = float(np.ptp(readings)) if len(readings) >= ENOUGH else 0.0
        if sd is not None and 0.0 < span < sd:
            shown = f"{sd:.4g} {column.unit}"
            found.append(Implausibility(
                name, sd, 0.0, span, column.unit, (), f"Noise: {shown} is stated as the uncertainty of the "
                f"{describe_quantity(name).name}, whose readings all lie within {span:.4g} {column.unit}; is that its "
                "unit?"))
    return found


def _is_within(value: float, limits: tuple[float, float]) -> bool:
    return limits[0] <= value <= limits[1]


def _find_stated(campaign: Campaign, column: str) -> Column:
    """What a campaign's file states for a column, or for the first of several components."""
    columns = {**campaign.conditions, **campaign.channels}
    if campaign.independent is not None:
        columns[campaign.independent.name] = campaign.independent
    names = [f"{column}_x", f"{column}_y", f"{column}_z", column]
    return next((one for name, one in columns.items() if name in names), Column(column, ""))


def _list_pairs(column: str, stated: str) -> list[tuple[str, str]]:
    """Units that the values of a column may be in, each with the one that is stated: that of the file, or, where
    nothing tells it, all that are taken for each other.
    """
    pairs = MISTAKES[role_of(column) or "angular velocity"]
    if not stated:
        return list(pairs)
    own = parse_unit(stated)
    if own.dimension != parse_unit(pairs[0][0]).dimension:
        return []
    usual = [actual for actual, other in pairs if parse_unit(other).scale == own.scale]
    if not usual or role_of(column) == "pressure":  # which may be in any unit; the stiffness of the gas tells
        usual += [one for one in dict.fromkeys(one for pair in pairs for one in pair)
                  if parse_unit(one).scale != own.scale and one not in usual]
    return [(actual, stated) for actual in usual]


def _list_mistakes(column: str, sizes: Mapping[str, Size], doubtful: bool, ranges: Ranges, stated: str,
                   ambient: float = 0.0) -> list[tuple[str, str, str]]:
    """Wrong units of one column that would explain all sizes; where only relations are odd, they have to do it well.
    `stated` is the unit that the file states for it, "" where nothing tells, and `ambient` what was added to its values
    to make gauge pressures absolute [Pa].

    Several where the sizes leave it open which, as of kPa, bar and psi: those first that bring ratios of columns
    nearest to their typical values.
    """
    found, good, gas = {}, [], "stiffness over that of the gas"
    for actual, wrong in _list_pairs(column, stated):
        factor = parse_unit(actual).scale / parse_unit(wrong).scale
        if ambient and column in sizes:
            factor = (factor * (sizes[column].value - ambient) + ambient) / sizes[column].value
        corrected = {name: size.value * factor ** size.powers.get(column, 0) for name, size in sizes.items()}
        strictly = gas not in corrected or _is_within(corrected[gas], CORRECTED)
        odd = gas in sizes and not _is_within(sizes[gas].value, ranges[gas])
        if all(_is_within(value, ranges[name]) for name, value in corrected.items()) and (
                strictly or not (doubtful and odd)):
            found[column, actual, wrong] = sum(
                abs(np.log(corrected[name] / typical)) for name, typical in TYPICAL.items() if name in corrected)
            good += [(column, actual, wrong)] * strictly
    return sorted(good or found, key=found.__getitem__)


def _measure_sizes(campaign: Campaign, ranges: Ranges) -> dict[str, dict[str, Size]]:
    """Everything in `ranges` that the columns of a campaign tell, by name and record."""
    sizes: dict[str, dict[str, Size]] = {}
    kind = find_kind(campaign.family)
    for name, column in campaign.conditions.items():
        values = zip(campaign.record_keys, campaign.records[name].to_numpy(dtype=float), strict=True)
        # Without gas, or straight on, there is nothing to compare.
        found = {str(key): Size(float(x), column.unit, {name: 1}) for key, x in values if np.isfinite(x) and x != 0}
        if name in ranges and found:
            sizes[name] = found
    for key in campaign.record_keys if campaign.samples is not None else ():
        for name, size in kind.measure(campaign.trace(key), campaign.records.loc[key].to_dict()).items():
            if np.isfinite(size.value) and size.value > 0:
                sizes.setdefault(name, {})[str(key)] = size
    return sizes


def _find_single(rows: Mapping[str, Mapping[str, Size]], ranges: Ranges) -> tuple[Implausibility, ...]:
    """Sizes of single records that lie far beyond what is expected; of each record the one that lies farthest."""
    worst: dict[str, tuple[float, str]] = {}
    for name, own in rows.items():
        low, high = ranges[name]
        for key, size in own.items():
            beyond = max(low / size.value, size.value / high) if size.value > 0 else 0.0
            if beyond > FAR and len(own) > 1:
                worst[key] = max(worst.get(key, (0.0, "")), (beyond, name))
    return tuple(_ask(name, rows[name][key], (), ranges, key) for key, (_, name) in worst.items())


def _ask(name: str, size: Size, mistakes: tuple[tuple[str, str, str], ...], ranges: Ranges, record: str = ""
         ) -> Implausibility:
    low, high = ranges[name]
    unit = "" if size.unit == "1" else f" {size.unit}"
    of = "" if name in NUMBERS or record else " (median of the records)"
    seen = f"{name} is {size.value:.3g}{unit}{of}, where {low:.3g} to {high:.3g}{unit} is expected"
    guesses: dict[str, dict[str, list[str]]] = {}
    for column, actual, stated in mistakes:
        guesses.setdefault(column, {}).setdefault(stated, []).append(actual)
    listed = [f"{column} " + ", or ".join(f"in {' or '.join(actual)} where {stated} is stated"
                                          for stated, actual in ways.items()) for column, ways in guesses.items()]
    if record:
        question = (f"its settings and its readings do not go together ({seen}); is one of them mistyped?"
                    if " over " in name else f"{seen}; is that a slip?")
        return Implausibility(name, size.value, low, high, size.unit, (), f"Record {record}: {question}")
    remedy = f"are the values of {', or of '.join(listed)}?" if listed else (
        "are the units of all columns and the scales of the gauges right?")
    return Implausibility(name, size.value, low, high, size.unit, mistakes, f"Units: {seen}; {remedy}")
