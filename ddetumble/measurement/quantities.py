"""Words and numbers as a reader wants them: friendly units, names without underscores, digits that mean something."""

import dataclasses as dc
import math
import os
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from decimal import Decimal

import numpy as np

from .units import choose_time_unit


@dc.dataclass(frozen=True)
class Quantity:
    """How a quantity is shown: shown value = SI value times `scale`, in `unit`, its digits by `digits`."""

    name: str
    unit: str
    scale: float
    digits: str = ".3g"

    @property
    def label(self) -> str:
        """For an axis: `depression [mm]`."""
        return f"{self.name} [{self.unit}]" if self.unit else self.name

    def format(self, value: float) -> str:
        """An SI value as the number that is shown, without its unit."""
        return format(value * self.scale, self.digits).removesuffix(".")


_QUANTITIES = {
    "time": ("time", "ms", 1e3), "depression": ("depression", "mm", 1e3),
    "depression_rate": ("rate of depression", "m/s", 1.0), "rate": ("rate of depression", "m/s", 1.0),
    "initial_pressure": ("initial pressure", "MPa", 1e-6), "pressure": ("gas pressure", "MPa", 1e-6),
    "approach_speed": ("approach speed", "m/s", 1.0), "tangential_speed": ("tangential speed", "m/s", 1.0),
    "normal_force": ("normal force", "N", 1.0), "peak_normal_force": ("peak normal force", "N", 1.0),
    "rebound_speed": ("rebound speed", "m/s", 1.0), "contact_time": ("contact time", "ms", 1e3),
    "impulse": ("impulse", "N s", 1.0), "peak_depression": ("peak depression", "mm", 1e3),
    "sequence": ("impact of the series", "", 1.0),
    "slip": ("slip", "mm", 1e3), "direction": ("direction of the stroke", "", 1.0),
    "normal_load": ("load", "N", 1.0), "internal_pressure": ("internal pressure", "MPa", 1e-6),
    "slip_speed": ("slip speed", "m/s", 1.0), "tangential_force": ("friction force", "N", 1.0),
    "peak_friction_force": ("peak friction force", "N", 1.0), "angular_speed": ("angular speed", "rad/s", 1.0),
    **{f"angular_velocity_{a}": (f"angular velocity about {a}", "rad/s", 1.0) for a in "xyz"},
    **{f"attitude_{a}": (f"attitude, component {a}", "", 1.0) for a in (*"wxyz", *"0123")},
}  # fmt: skip
_MAIN = ("initial_pressure", "approach_speed", "tangential_speed", "normal_load", "internal_pressure", "slip_speed")
_DIGITS = {"normal_load": "#.3g", "slip_speed": ".3g"}  # others by their unit
LOST = 100.0  # relative error beyond which a prediction has nothing to do with what was measured
VERDICTS = {"nothing-missing": "nothing missing", "explained": "explained", "improved": "improved, not explained",
            "unexplained": "unexplained", "undecided": "undecided"}


def describe_quantity(name: str, values=None, unit: str = "") -> Quantity:
    """Name, unit and scale in which a channel, condition or variable is shown.

    The SI values to be shown decide on kPa or MPa, and on ms, s or h; `unit` is that of a quantity unknown here.
    """
    if name not in _QUANTITIES:
        return Quantity(clean(name).replace("_", " "), "" if unit == "1" else clean(unit), 1.0)
    words, shown, scale = _QUANTITIES[name]
    if shown in ("MPa", "ms") and values is not None:
        finite = np.abs(np.asarray(values, dtype=float))
        finite = finite[np.isfinite(finite)]
        if shown == "MPa" and finite.size and finite.max() < 2e5:
            return Quantity(words, "kPa", 1e-3)
        if shown == "ms" and finite.size:
            return Quantity(words, *choose_time_unit(finite.max()))
    digits = _DIGITS.get(name, ".2f" if shown in ("MPa", "m/s") else ".3g")
    return Quantity(words, shown, scale, digits)


def clean(text, length: int = 200) -> str:
    """Text from a file on one line, without control characters; cut where it is longer than `length`."""
    text = " ".join("".join(c if c.isprintable() else " " for c in str(text)).split())
    return text if len(text) <= length else text[: length - 1] + "…"


_SMALL_TYPE = str.maketrans("0123456789-+n", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻⁺ⁿ")
_POWER = r"([-−+]?\d+(?:\.\d*)?)e([-+]\d+)(?![\w.]*\w)"
_UNITS = (r"(?:%|°|[kMmµn]?(?:N|Pa|m|s|g|h|Hz)|[Mm]in|rad|points|K|times|kg)(?=$|[\s.,;:)\]/·⋅²³⁻-])")


def typeset(text: str) -> str:
    """Numbers, units and laws as they stand in print: `4e-08` as 4 × 10⁻⁸, `1/s**2` as 1/s², `(x - d)+^n` as (x − d)₊ⁿ,
    true minus signs, and no line that ends between a number and its unit.
    """
    for pattern, printed in (
        (rf"(?<![\w.]){_POWER} ± {_POWER}", _join_powers),
        (rf"(?<![\w.]){_POWER}", lambda found: _raise(found[1], int(found[2]))),
        (r"\*\*(-?\d+)(?![\d.]*\d)", lambda found: found[1].translate(_SMALL_TYPE)),
        (r"(?<=[A-Za-z])\*\*(?=[-\d])", "^"),
        (r"\)\+(?=$|[\^\s;,:)])", ")₊"),
        (r"\^(\d+|n)(?![\w.])", lambda found: found[1].translate(_SMALL_TYPE)),
        (r"(?<=[\w)]) - (?=\w+\))", " − "),
        (r"(?<![\w.)\]−-])-(?=\.?\d)", "−"),
        (r"(?<=\d)%", " %"),
        (rf"(?<=[\d⁰¹²³⁴⁵⁶⁷⁸⁹]) (?={_UNITS}|1/)", "\u00a0"),
        (r"(?<=[\w)]) ([<>±×]|(?<=\bp )=) (?=[-−\d(])", "\u00a0\\1\u00a0"),
    ):
        text = re.sub(pattern, printed, text)
    return text


def _raise(mantissa: str, power: int) -> str:
    if abs(power) < 3 and mantissa[-1:].isdigit():
        return format(Decimal(mantissa.replace("−", "-")).scaleb(power), "f").replace("-", "−")
    return ("" if mantissa == "1" else f"{mantissa} × ") + f"10{str(power).translate(_SMALL_TYPE)}"


def _join_powers(found: re.Match) -> str:
    """A value and its deviation over one power of ten."""
    value, power, sd, own = found[1], int(found[2]), float(found[3]), int(found[4])
    spread = f"{sd * 10.0 ** (own - power):.{len(value.partition('.')[2])}f}"
    return _raise(f"({value} ± {spread})", power) if float(spread) else found[0]


def shorten(text, length: int) -> str:
    """Text from a file on one line; the middle is left out where it is longer than `length`, as ends tell apart."""
    text, end = clean(text, 4000), (length - 1) // 2
    return text if len(text) <= length else f"{text[: length - 1 - end]}…{text[len(text) - end :]}"


def shorten_names(names: Iterable, length: int) -> dict[str, str]:
    """Short names of records that stay distinct, by their full name.

    Of those longer than `length`, whole words that all of them begin or end with are left out first, then the middle;
    names that would then be alike are numbered in their order.
    """
    short = {name: clean(name, 4000) for name in map(str, names)}
    words = {name: re.split(r"(?<=[_\-./ ])", text) for name, text in short.items() if len(text) > length}
    if len(words) > 1:
        least = min(map(len, words.values())) - 1
        head = min(len(os.path.commonprefix(list(words.values()))), least)
        tail = min(len(os.path.commonprefix([own[::-1] for own in words.values()])), least - head)
        short |= {name: "".join(own[head : len(own) - tail]).strip("_-./ ") for name, own in words.items()}
    short = {name: shorten(text, length) for name, text in short.items()}
    count = Counter(short.values())
    for i, (name, text) in enumerate(short.items(), 1):
        if count[text] > 1:
            short[name] = f"{shorten(text, max(length - len(str(i)) - 1, 1))}#{i}"
    return short


def vary(records: Iterable[Mapping[str, float]]) -> tuple[str, ...]:
    """Conditions that differ between records: those of every record of the family first, the number in the series not.

    Pressure and speed of an impact, and load, pressure and speed of a slip record, count also where all are alike.
    """
    records = list(records)
    there = {name for record in records for name in record} - {"sequence"}
    kept = []
    for name in (*(name for name in _MAIN if name in there), *sorted(there - set(_MAIN))):
        values = np.array([record.get(name, np.nan) for record in records], dtype=float)
        values = values[np.isfinite(values)]
        if values.size and (name in _MAIN or np.ptp(values) > 0.02 * np.abs(values).max()):
            kept.append(name)
    return tuple(kept)


def describe_conditions(conditions: Mapping[str, float], names: Iterable[str] = _MAIN) -> str:
    """A record's conditions in a few words, such as `1.11 MPa · 0.14 m/s`; other conditions with their name."""
    words = []
    for name in names:
        value = conditions.get(name, math.nan)
        if not math.isfinite(value):
            continue
        shown = describe_quantity(name, [value])
        number = shown.format(value)
        own = "along" if name == "tangential_speed" else shown.unit  # a second speed needs a word, not a unit
        words.append(f"{number} {own}" if name in _MAIN else f"{shown.name} {number}")
    return " · ".join(words)


def name_steps(discovery) -> list[str]:
    """Names of all models of a discovery, the reference first."""
    return [f"reference: {clean(discovery.model, 24)}", *(
        name_step(discovery.steps, number, discovery.model) for number in range(1, len(discovery.steps)))]


def name_step(steps: Sequence, number: int, model: str) -> str:
    """A model of the loop: what came and went at that step, `+ adhesion, − gas-leak`; 0 is the reference `model`."""
    if not number:
        return clean(model, 34)
    step, before = steps[number], steps[number - 1].effects
    changes = [f"+ {clean(effect, 34)}" for effect in step.effects if effect not in before]
    changes += [f"− {clean(effect, 34)}" for effect in before if effect not in step.effects]
    return ", ".join(changes) or f"+ {clean(step.added, 34)}"


def format_quantity(name: str, value: float, longest: float = 0.0) -> str:
    """An SI value of a quantity with the unit in which it is shown; times in that of records up to `longest` [s]."""
    shown = describe_quantity(name, [value, *((longest,) if name == "time" else ())])
    return f"{format_plain(value * shown.scale)} {shown.unit}".rstrip()


def join_words(words: Iterable[str], last: str = "and") -> str:
    """Words with commas between them, and `last` before the last one; '' of none."""
    *first, end = list(words) or [""]
    return f"{', '.join(first)} {last} {end}" if first else end


def format_plain(value: float) -> str:
    """A number to three digits, and to more before it takes a power of ten: `1500`, not `1.5e+03`."""
    return f"{value:.0f}" if 999.5 <= abs(value) < 1e6 else f"{value:.3g}"


def format_estimate(value: float, sd: float, unit: str = "") -> str:
    """`1175 ± 10 N/m`, to the two digits of the standard deviation; without one, to four, and that is said."""
    if not (math.isfinite(sd) and sd > 0):
        return f"{value:.4g} {unit}".rstrip() + " (its uncertainty is not known)"
    places = 1 - _magnitude(sd)
    shown, spread = format_value(value, sd), format_value(sd, sd)
    if 1e-3 <= max(abs(value), sd) < 1e7 and places <= 9:
        shown, spread = (_format_places(x, places) for x in (float(value), float(sd)))
    return f"{shown} ± {spread} {unit}".rstrip()


def format_number(value, digits: int = 3) -> str:
    """A number to that many digits; a dash where there is none."""
    if value is None or not math.isfinite(value):
        return "–"
    if value == 0:
        return "0"
    if not 1e-3 <= abs(value) < 1e6:
        return f"{value:.{digits - 1}e}"
    return _format_places(value, digits - 1 - _magnitude(value))


def format_value(value: float, sd: float) -> str:
    """A number to the digits that its standard deviation leaves it."""
    if not math.isfinite(value) or not math.isfinite(sd) or sd <= 0:
        return format_number(value, 4)
    if value != 0 and not 1e-4 <= abs(value) < 1e7:
        return f"{value:.{max(1, min(8, _magnitude(value) - _magnitude(sd) + 1))}e}"
    return _format_places(value, 1 - _magnitude(sd))


def format_share(value: float, places: int = 0) -> str:
    """A share in per cent."""
    return "–" if value is None or not math.isfinite(value) else f"{100 * value:.{places}f} %"


def format_small_share(value: float) -> str:
    """A share in per cent, with one more digit below 1 %, where a whole number would hide that it is not zero."""
    return format_share(value, 1 if 0.0005 <= abs(value) < 0.00995 else 0)


def format_error(value: float) -> str:
    """A relative error in per cent, to two or three digits; beyond `LOST` no digit says more."""
    if value is None or not math.isfinite(value):
        return "–"
    return f"> {100 * LOST:.0f} %" if value > LOST else f"{format_number(100 * value, 3)} %"


def format_p(value: float) -> str:
    """A p-value as readers expect it."""
    if value is None or not math.isfinite(value):
        return "–"
    return "< 0.001" if value < 0.001 else f"{value:.3f}" if value < 0.1 else f"{value:.2f}"


def say_p(value: float) -> str:
    """A p-value with its letter: `p = 0.41`, `p < 0.001`, or `no p-value`."""
    text = format_p(value)
    return "no p-value" if text == "–" else f"p {text}" if text.startswith("<") else f"p = {text}"


def _format_places(value: float, places: int) -> str:
    """A number rounded to decimal places, to tens and hundreds where these are negative; at most nine are shown."""
    return f"{round(value, places) + 0.0:.{min(max(places, 0), 9)}f}"  # a zero has no sign


def _magnitude(value: float) -> int:
    return 0 if value == 0 else math.floor(math.log10(abs(value)))
