"""Units: what a unit's text means, and which unit a quantity has in SI.

`pint` reads the text, behind a fixed alias table: taken alone it reads `Pas` as pascals, `pa` as picoyears, and, by
version, `Nm` as a textile number-metre. Every unit is checked against the dimension that the column's name asks for.
"""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from .._errors import InputError


ALIASES = {
    "": "1", "-": "1", "1": "1", "none": "1", "dimensionless": "1",
    "Nm": "N*m", "kNm": "kN*m", "mNm": "mN*m", "Nmm": "N*mm", "Ncm": "N*cm", "Ns": "N*s", "Nms": "N*m*s",
    "Pas": "Pa*s", "mPas": "mPa*s", "Ns/m": "N*s/m", "kgm2": "kg*m**2", "Newton": "N", "Newtons": "N", "newtons": "N",
    "gf": "force_gram", "kp": "kgf", "lb": "pound", "lbs": "pound", "Pascal": "Pa", "pascals": "Pa", "Bar": "bar",
    "bara": "bar", "psia": "psi", "Meter": "m", "Metre": "m", "Seconds": "s", "Second": "s", "Volt": "V", "Volts": "V",
    "mps": "m/s", "kph": "km/h", "usec": "us", "dps": "deg/s", "℃": "degC", "°C": "degC", "℉": "degF", "°F": "degF",
}  # fmt: skip
ROUNDING = 1e-12  # s, below which a time is nought but for rounding
_PRESSURES = {one.casefold(): one for one in ("bar", "mbar", "psi", "Pa", "hPa", "kPa", "MPa")}
_GAUGE = re.compile(rf"({'|'.join(_PRESSURES)})[\s_]*\(?(?:g|ü|ue|rel)\.?\)?")  # barg, psi (g), bar(ü), kPa rel.
_PLAIN = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻·⋅×µ", "0123456789-***μ")
# Units that most campaigns and scenarios are written in, by their spelling: scale and SI unit. Without these, every
# command would spend half a second on starting pint.
_DIMENSIONS = {
    "1": {}, "rad": {}, "m": {"[length]": 1}, "s": {"[time]": 1}, "kg": {"[mass]": 1}, "K": {"[temperature]": 1},
    "m/s": {"[length]": 1, "[time]": -1}, "rad/s": {"[time]": -1},
    "kg*m/s**2": {"[mass]": 1, "[length]": 1, "[time]": -2}, "kg/m/s**2": {"[mass]": 1, "[length]": -1, "[time]": -2},
}
_COMMON = {
    "1": (1.0, "1"), "m": (1.0, "m"), "mm": (0.001, "m"), "s": (1.0, "s"), "ms": (0.001, "s"), "kg": (1.0, "kg"),
    "K": (1.0, "K"), "m/s": (1.0, "m/s"), "mm/s": (0.001, "m/s"), "rad": (1.0, "rad"), "rad/s": (1.0, "rad/s"),
    "deg": (math.pi / 180, "rad"), "deg/s": (math.pi / 180, "rad/s"), "N": (1.0, "kg*m/s**2"), "kN": (1e3, "kg*m/s**2"),
    "Pa": (1.0, "kg/m/s**2"), "kPa": (1e3, "kg/m/s**2"), "MPa": (1e6, "kg/m/s**2"), "bar": (1e5, "kg/m/s**2"),
}  # fmt: skip
_HINTS = {"mpa": "MPa", "kpa": "kPa", "pa": "Pa", "kn": "kN", "n": "N", "mn": "mN (or MN)", "hz": "Hz"}

# Kinds of quantities and their SI units.
_KINDS = {"pressure": "Pa", "speed": "m/s", "force": "N", "length": "m", "time": "s", "angular velocity": "rad/s",
          "mass": "kg", "temperature": "K", "impulse": "N*s", "pure number": "1"}
# Those in which test benches write them, the likeliest first.
_USUAL = {"pressure": "MPa kPa bar psi", "speed": "m/s mm/s", "force": "N kN kgf", "length": "mm m", "time": "s ms us",
          "angular velocity": "rad/s deg/s rpm", "mass": "kg g", "temperature": "degC K", "impulse": "N*s",
          "pure number": "1 %"}
_ROLES = {
    "pressure": "initial_pressure internal_pressure pressure ambient_pressure tensile_strength real_contact_pressure "
    "contour_pressure composite_modulus elastic_modulus",
    "speed": "approach_speed rebound_speed slip_speed tangential_speed creep_speed",
    "force": "normal_load normal_force tangential_force peak_normal_force peak_friction_force friction_force",
    "length": "depression peak_depression slip outer_diameter inner_diameter wall_thickness pad_thickness "
    "contact_radius",
    "time": "time contact_time",
    "impulse": "impulse",
    "angular velocity": "orbit_rate " + " ".join(f"angular_velocity_{a}{n}" for a in "xyz" for n in ("", "0")),
    "mass": "effective_mass tangential_mass rolling_mass",
    "temperature": "temperature",
    "pure number": "sequence repeats restitution inertia_ratio adhesion_constant loss_factor slip_scale poisson_ratio "
    "friction_coefficient attitude " + " ".join(f"attitude_{a}" for a in "wxyz0123"),
}
ROLES = {name: kind for kind, names in _ROLES.items() for name in names.split()}
NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"


@dataclass(frozen=True)
class Uncertainty:
    """One standard deviation of a measured number.

    Args:
        absolute: In the column's SI unit, or None.
        relative: As a share of the value (0.005 for 0.5 %), or None.
    """

    absolute: float | None = None
    relative: float | None = None

    def sd(self, values) -> np.ndarray:
        """Standard deviation at `values` (any shape, SI), in the same shape and unit."""
        values = np.asarray(values, dtype=float)
        constant = np.full(values.shape, self.absolute or 0.0)
        return constant if self.relative is None else np.hypot(constant, self.relative * np.abs(values))


@dataclass(frozen=True)
class Unit:
    """A unit as read: SI value = value · scale + offset."""

    text: str  # as the user wrote it
    scale: float
    offset: float  # nought except for temperatures in °C or °F
    dimension: Mapping  # powers of the base dimensions, empty for a pure number
    si: str  # the SI unit

    def convert(self, values):
        """Values in this unit to SI, same shape; exact decimal steps (mm to m) are divided, so 0.25 ms is 0.00025 s."""
        inverse = round(1 / self.scale) if self.scale < 1 else 0
        exact = inverse and abs(self.scale * inverse - 1) < 1e-14
        with np.errstate(over="ignore", invalid="ignore"):  # who takes the values refuses what is no number
            return (values / inverse if exact else values * self.scale) + self.offset


def role_of(name: str) -> str | None:
    """The kind of quantity that a column or parameter of this name holds, or None where the name does not say."""
    return ROLES.get(name.removeprefix("printed_"))


def si_unit(quantity: str) -> str:
    """SI unit of a quantity of fixed role, e.g. "Pa" for `initial_pressure`; "1" for a name without one."""
    return _KINDS[role_of(quantity) or "pure number"]


def list_usual(quantity: str) -> tuple[str, ...]:
    """Units in which test benches write a quantity, the likeliest first; none where its name does not say its kind."""
    return tuple(_USUAL.get(role_of(quantity) or "", "").split())


def strip_gauge(text: str) -> str | None:
    """The plain unit of one of a pressure above that around it, such as bar(g) or `bar, gauge`; None of any other."""
    said = re.fullmatch(r"(.*?)[\s,;(]*\bgauge\)?", text.strip(), re.IGNORECASE)
    short = _GAUGE.fullmatch(text.strip().casefold())
    return said[1] if said and said[1] else short and _PRESSURES[short[1]]


def is_gauge(text: str) -> bool:
    """Whether a unit is one of a pressure above that around it, such as bar(g)."""
    return strip_gauge(text) is not None


@lru_cache(maxsize=512)
def parse_unit(text: str) -> Unit:
    """Read a unit; what is none is refused, and one whose zero or scale is not plain (decibels)."""
    text = text.strip()
    if is_gauge(text):
        raise InputError(f"unit {text!r} is a gauge pressure; write the absolute one in {strip_gauge(text)}")
    spelling = _spell(text)
    if spelling is None:
        raise InputError(f"unit {text!r} cannot be read; write it like N, MPa, m/s, N*s/m or kg*m^2")
    if spelling in _COMMON:
        scale, si = _COMMON[spelling]
        return Unit(text or "1", scale, 0.0, _DIMENSIONS[si], si)
    registry = _registry()
    try:
        unit = registry.parse_units(spelling)
        zero, one, two = (registry.Quantity(x, unit).to_base_units() for x in (0.0, 1.0, 2.0))
        low, middle, high = float(zero.magnitude), float(one.magnitude), float(two.magnitude)
        dimension, shown = one.dimensionality, f"{one.units:~C}"
    except Exception as error:  # pint raises many kinds, some of them bare AssertionErrors
        hint = _HINTS.get(text.casefold())
        hint = f"did you mean {hint}?" if hint else "write it like N, MPa, m/s or mm"
        raise InputError(f"unit {text!r} is unknown; {hint}") from error
    if not all(map(math.isfinite, (low, middle, high))) or middle == low:
        raise InputError(f"unit {text!r} has no finite size in SI units")
    if abs((high - middle) - (middle - low)) > 1e-9 * abs(high - middle):
        raise InputError(f"unit {text!r} is logarithmic; write the values in a linear unit")
    scale = middle if low == 0 else round(middle - low, 12)
    return Unit(text or "1", scale, low, dimension, shown or "1")


def check_unit(text: str, quantity: str) -> Unit:
    """Read a unit; one of another dimension than the quantity of that name (a column or a parameter) is refused."""
    unit, kind = parse_unit(text), role_of(quantity)
    if kind is None:
        return unit
    wanted = parse_unit(_KINDS[kind])
    if unit.dimension != wanted.dimension:
        hint = ""
        spelt = {"C": "degC", "F": "degF", "kg": "kgf", "g": "gf"}.get(unit.text) or _HINTS.get(unit.text.casefold())
        measured = next((k for k, si in _KINDS.items() if parse_unit(si).dimension == unit.dimension), "pure number")
        if spelt and parse_unit(spelt.split()[0]).dimension == wanted.dimension:
            hint = f"; did you mean {spelt}?"
        elif measured != "pure number":
            hint = f"; {unit.text} is a unit of {measured}: correct it, or choose the column with the {kind}"
        raise InputError(f"unit {unit.text!r} does not measure {quantity}, which is a {kind} ({wanted.text}){hint}")
    if kind == "angular velocity" and re.search("Hz|hertz", unit.text):
        raise InputError(f"unit {unit.text!r} leaves open whether {quantity} counts turns; write rad/s, deg/s or rpm")
    return replace(unit, si=wanted.text)


def refuse_bare(text: str | float, quantity: str, unit: str = "") -> None:
    """Refuse a value without a unit where its quantity, or a parameter of that `unit`, is no pure number."""
    kind = role_of(quantity) or next((name for name, si in _KINDS.items() if si == (unit or "1")), None)
    if kind != "pure number":
        usual = _USUAL[kind].split() if kind else [unit]
        meant = [f"'{str(text).strip()} {one}'" for one in usual]  # nobody can know which
        asked = f"is it {', '.join(meant[:-1])} or {meant[-1]}?" if meant[1:] else f"write it like {meant[0]}"
        raise InputError(f"{quantity} needs a unit: {asked}")


def parse_quantity(text: str | float, quantity: str, unit: str = "") -> float:
    """Read a value with its unit ("60 mm"), or a bare number where the quantity has no dimension, as finite SI.

    `unit` is that of a parameter whose name does not say what it measures; the value is returned in it. One that
    depends on another parameter (`N/m^q`) has to be written just so.
    """
    number, rest = _split_number(text, quantity)
    if not rest:
        refuse_bare(text, quantity, unit)
    if role_of(quantity) is not None or not unit:
        value = float(check_unit(rest, quantity).convert(number))
    elif rest == unit:
        value = number
    elif "^q" in unit:
        raise InputError(f"{quantity} is in {unit}, which depends on the exponent q; write it like '{number:g} {unit}'")
    else:
        own = parse_unit(unit)
        value = (convert_text(str(text), unit) - own.offset) / own.scale
    if not math.isfinite(value):
        raise InputError(f"{quantity} is not a finite number: {text!r}")
    return value


def find_unit_text(text: str | float) -> str:
    """The unit of a value as it is written ("60 mm")."""
    return _split_number(text, "this")[1]


def parse_deviation(text: str, quantity: str, unit: str = "") -> float:
    """Read a standard deviation as `parse_quantity` reads a value: on a scale whose zero is not that of SI it is a
    difference of two values, so 2 degC are 2 K.
    """
    value, (_, rest) = parse_quantity(text, quantity, unit), _split_number(text, quantity)
    zero = parse_quantity(f"0 {rest}", quantity, unit)
    return value if zero == 0 else float(f"{value - zero:.12g}")


def convert_text(text: str, unit: str) -> float:
    """Read a value with its unit ("30 deg/s") as a finite number of an SI unit, such as "rad/s"."""
    number, rest = _split_number(text, "this")
    wanted, own = parse_unit(unit), parse_unit(rest or "1")
    if own.dimension != wanted.dimension:
        without = "" if rest else ": a number between quotation marks needs a unit"
        raise InputError(f"{text!r} is no quantity in {unit}{without}")
    if unit == "rad/s" and re.search("Hz|hertz", rest):
        raise InputError(f"{text!r} leaves open whether it counts turns; write rad/s, deg/s or rpm")
    value = float(own.convert(number))
    if not math.isfinite(value):
        raise InputError(f"{text!r} is not a finite number")
    return value


def parse_uncertainty(text: str | float, unit: Unit, quantity: str) -> Uncertainty:
    """Read one standard deviation: absolute ("0.25 N") or relative ("0.5 %"), for a column with that unit.

    Refused are numbers that are not positive, and relative ones on a temperature scale with an offset.
    """
    number, rest = _split_number(text, f"the uncertainty of {quantity}")
    if not (number > 0 and math.isfinite(number)):
        raise InputError(f"the uncertainty of {quantity} is one standard deviation and must be positive, not {text!r}")
    if rest in ("%", "percent"):
        if unit.offset:
            raise InputError(f"the uncertainty of {quantity} cannot be relative in {unit.text}: write it like '0.5 K'")
        return Uncertainty(None, number / 100)
    if not rest and unit.dimension:
        *meant, last = [f"'{text} {one}'" for one in (*(list_usual(quantity) or (unit.text,)), "%")]
        raise InputError(f"the uncertainty of {quantity} needs a unit: is it {', '.join(meant)} or {last}?")
    own = check_unit(rest, quantity)
    if own.dimension != unit.dimension:
        raise InputError(f"the uncertainty of {quantity} is in {own.text!r}, but its values are in {unit.text!r}")
    return Uncertainty(float(replace(own, offset=0.0).convert(number)))


def _split_number(text, quantity: str) -> tuple[float, str]:
    match = re.fullmatch(rf"\s*({NUMBER})(.*)", str(text), re.DOTALL | re.ASCII)
    if match is None:
        raise InputError(f"{quantity} is not a number with a unit: {text!r}")
    if match[2].startswith(","):
        raise InputError(f"{quantity} has a decimal comma: {text!r}; write a decimal point")
    return float(match[1]), match[2].strip()


def _spell(text: str) -> str | None:
    """Text that pint reads as meant, or None: aliases, superscripts, `m.s-1`; no numbers, calls or long powers."""
    if text in ALIASES:
        return ALIASES[text]
    text = text.translate(_PLAIN).replace("^", "**")
    text = re.sub(r"(?<=\w)\.(?=[^\W\d])", "*", text)
    text = re.sub(r"(?<=[A-Za-zμ])(-?\d)(?![\w*])", r"**\1", text)
    word = r"[^\W\d_][\w]{0,30}|[%°Ω]"
    factor = rf"(?:\(*\s*(?:1|°?{word})(?:\s*\*\*\s*\(?-?\d(?:\.\d{{1,3}})?\)?)?\s*\)*)"
    if len(text) > 60 or not re.fullmatch(rf"{factor}(?:(?:\s*[*/]\s*|\s+){factor})*", text):
        return None
    return re.sub(rf"°?{word}", lambda found: ALIASES.get(found[0], found[0]), text)


@lru_cache(maxsize=1)
def _registry():
    import pint

    return pint.UnitRegistry(autoconvert_offset_to_baseunit=True)


def choose_time_unit(longest: float) -> tuple[str, float]:
    """Unit in which times up to `longest` [s] are shown, and its number in a second.

    Contacts last milliseconds, a body is followed for seconds to hours: four digits of seconds can still be read.
    """
    return ("ms", 1e3) if longest <= 2.0 else ("s", 1.0) if longest < 1e4 else ("h", 1 / 3600)


def format_time(time: float, longest: float | None = None) -> str:
    """A time [s] in the unit of those up to `longest` [s], such as `3600 s`, 0 where that is a millionth of these at
    most; a duration by itself in its own unit.
    """
    unit, factor = choose_time_unit(abs(time) if longest is None else longest)
    return f"{time * factor if abs(time) > max(ROUNDING, 1e-6 * (longest or 0.0)) else 0.0:.4g} {unit}"
