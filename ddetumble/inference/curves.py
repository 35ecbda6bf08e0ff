r"""Fits of friction curves: a...e of Eq. 9 at one load, Eq. 10's polynomials over loads, K and tan delta_L of Eq. 8.

Fitted by Levenberg-Marquardt (optimistix) from many starts, with intervals by profile likelihood. What the readings
cannot tell apart is found from the Jacobian's singular values and said in words, with the test that would resolve it.

* $(c, d) \to (-c, -d)$ leaves Eq. 9 as it is; d > 0 is what is reported, over loads at the lowest one.
* $K$ and $\sigma_0/p_r$ enter Eq. 8 as a product only.
* $K$ and $\tan\delta_L$ are a product too at a single pressure.
"""

import dataclasses as dc
import math
from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np

from .._errors import ComputationError, InputError
from ..contact.friction import SLIP_UNIT, describe_range
from .curve_models import (
    POLYNOMIAL,
    RATIO,
    RUBBER,
    SLIP,
    RubberData,
    SlipData,
    find_spacing,
    guess_polynomials,
    guess_slip,
    list_monomials,
    spread_powers,
)
from .curve_results import CurveFit, describe_confusion, fits_noise, gather_fit
from .profiles import Curve, Settled, measure_knowledge, settle_curve, trace_profiles


SYMMETRY = "(c, d) and (-c, -d) make the same curve: the one with d > 0 is given"
PRODUCT = ("K and sigma_0/p_r enter Eq. 8 as a product only, at any pressure and load: K is known as far as "
           "sigma_0/p_r is; a tensile test for sigma_0 and the real contact area under a known load for p_r would tell "
           "them apart")
ONE_PRESSURE = ("There is one pressure only, at which Eq. 8 is a single number for both K and tan delta_L: readings at "
                "a second pressure, or the loss factor from a rheometer, would tell them apart")
WEAK = 0.1  # share of the second exponential below which it is said to be weak
Readings = tuple[np.ndarray, np.ndarray, np.ndarray]  # slip [mm], coefficient [-], one over its deviation
LENGTHS = 64  # samples are padded to a multiple of it, so that few programs are compiled


@dc.dataclass(frozen=True)
class SlipRecord:
    """Friction over slip at one load.

    Attributes:
        slip: since the stroke began, shape (samples,) [m].
        coefficient: friction force over load, without Eq. 8's part, shape (samples,) [-].
        load: normal load [N].
        sd: standard deviation of the coefficient, one number or shape (samples,) [-].
    """

    slip: np.ndarray
    coefficient: np.ndarray
    load: float
    sd: float | np.ndarray

    @classmethod
    def from_force(cls, slip, force, load: float, sd) -> "SlipRecord":
        """The same from a friction force and its standard deviation, both in newtons."""
        load = _check_positive(load, "the load [N]")
        slip, force, sd = _check_readings(slip, force, sd, ("slip", "force", "sd"), 1)
        return cls(slip, force / load, load, sd / load)


def fit_slip_curve(slip, friction, load: float, sd, *, force: bool = False, free_e: bool = False, levels: bool = True,
                   profile: bool = True) -> CurveFit:
    r"""Fit a...e of Eq. 9 at one load, $\mu(s) = a + a e^{bs}[c \sinh(ds) - e \cosh(ds)]$ with s in mm.

    Args:
        slip: since the stroke began, not negative, shape (samples,) [m].
        friction: coefficient without Eq. 8's part [-], or force [N], shape (samples,).
        load: $F_n$ [N].
        sd: standard deviation of `friction`, one number or shape (samples,), in its unit.
        force: `friction` and `sd` are forces.
        free_e: fit e as well; 1 otherwise, so that friction begins at zero.
        levels: the curve levels off within the stroke, $b + d < -1/L$. Without it a drift of any size stands in for a,
            and loads above 30 N need it off, as Eq. 10's curves grow there.
        profile: trace the profile likelihood; without it no coefficient has an interval.

    Returns:
        The fit, b and d per millimetre.

    Raises:
        InputError: An argument is no use.
        ComputationError: The fit failed; the message says where it stood.
    """
    load = _check_positive(load, "the load [N]")
    curve, subject = SLIP[bool(free_e)], f"the slip curve at {load:g} N"
    record = SlipRecord.from_force(slip, friction, load, sd) if force else SlipRecord(slip, friction, load, sd)
    data, parts = _stack([record], len(curve.names))
    data = _pick(data, 0)
    ceiling = -1.0 / float(data.stroke) if levels else math.inf
    data = data._replace(ceiling=jnp.asarray(ceiling))
    starts = guess_slip(*parts[0], bool(free_e), ceiling)
    fit = settle_curve(curve, starts, data, subject)
    profiles = ()
    if profile:
        first = measure_knowledge(curve, fit.coefficients, data)
        slips, value, _ = parts[0]
        spans = np.array([100 * np.abs(value).max(), 10 / find_spacing(slips), 1e4, 14.0, 1e4])[:len(curve.names)]
        fit, profiles = trace_profiles(curve, fit, first.sd, spans, data, subject)
    measured = measure_knowledge(curve, fit.coefficients, data)
    tests = [("as many samples again in the first fifth of the stroke", data._replace(slip=data.slip / 5)),
             ("a stroke twice as long", data._replace(slip=data.slip * 2))]
    elsewhere = dict.fromkeys("bcde", "curves at other loads, tied to this one by Eq. 10's polynomials,")
    level = [f"That the curve levels off within the stroke, b + d < {ceiling:.2g} 1/mm, is assumed and not found."]
    notes = [SYMMETRY + ".", *(level if levels else []), *_describe_shape(fit.coefficients, free_e),
             *describe_confusion(curve, fit, measured, profiles, tests, elsewhere, "strokes")]
    trouble = describe_range(load)
    notes += [f"{load:g} N is outside the range of Eq. 10: {trouble}."] if trouble else []
    return gather_fit(curve, subject, fit, measured, profiles, {} if free_e else {"e": 1.0}, len(parts[0][0]), notes,
                      data)


def fit_slip_polynomials(records: Sequence[SlipRecord], *, free_e: bool = False, profile: bool = True) -> CurveFit:
    r"""Fit Eq. 10 to curves at several loads: a linear, b, c and d (and e) quadratic in the load [N].

    $a = a_0 + a_1 F_n$, $b = b_0 + b_1 F_n + b_2 F_n^2$ and so on, in the units of Eq. 10 (b and d per mm). The sign of
    (c, d) is the one with d > 0 at the lowest load.

    Args:
        records: at three different loads at least.
        free_e: fit e's polynomial too; 1 otherwise.
        profile: as for `fit_slip_curve`.

    Raises:
        InputError: A record is no use, or there are too few loads.
        ComputationError: The fit failed.
    """
    records = sorted(records, key=lambda r: _check_positive(r.load, "the load [N]"))
    different = len({float(r.load) for r in records})
    if different < 3:
        raise InputError(f"quadratic polynomials in the load need curves at three loads or more; there are {different}")
    single, curve = SLIP[bool(free_e)], POLYNOMIAL[bool(free_e)]
    data, parts = _stack(records, 3)
    loads, fits = [float(r.load) for r in records], []
    for k, part in enumerate(parts):
        try:
            own, fit = _settle_alone(single, _pick(data, k), part, loads[k])
        except ComputationError:
            continue  # a start is all that it would have been
        columns = measure_knowledge(single, fit.coefficients, own).columns
        columns[:, 3] /= fit.coefficients[3]
        fits.append((loads[k], fit.coefficients, columns.T @ columns))
    if len(fits) < 3:
        raise ComputationError("The polynomials have no start: fewer than three of the curves could be fitted alone")
    subject = f"Eq. 10's polynomials from {loads[0]:g} to {loads[-1]:g} N"
    fit, profiles = settle_curve(curve, guess_polynomials(fits), data, subject), ()
    if profile:
        first = measure_knowledge(curve, fit.coefficients, data)
        fit, profiles = trace_profiles(curve, fit, first.sd, 1e3 * np.array(curve.typical), data, subject)
    measured = measure_knowledge(curve, fit.coefficients, data)
    tests = [("as many curves at half the loads", data._replace(load=0.5 * data.load)),
             ("as many samples again in the first fifth of the strokes", data._replace(slip=data.slip / 5))]
    notes = [f"{SYMMETRY}, at {loads[0]:g} N.",
             f"Nothing here tests the polynomials below {loads[0]:g} or above {loads[-1]:g} N.",
             *describe_confusion(curve, fit, measured, profiles, tests, {}, "sets of strokes")]
    beyond: dict[str, list[str]] = {}
    for load in dict.fromkeys(loads):
        beyond.setdefault(describe_range(load), []).append(f"{load:g} N")
    beyond.pop("", None)
    notes += [f"Outside the range of Eq. 10, at {', '.join(at)}: {trouble}." for trouble, at in beyond.items()]
    count = sum(len(part[0]) for part in parts)
    return gather_fit(curve, subject, fit, measured, profiles, {} if free_e else {"e": 1.0}, count, notes, data)


def fit_rubber(pressure, coefficient, sd, *, modulus: float, strength_ratio: float | None = None,
               profile: bool = True) -> CurveFit:
    r"""Fit K and tan delta_L of Eq. 8, $\mu = \tan\delta_L [\frac{\pi}{4} K \sigma_0/p_r + ...(3 p_c/E^*)^{2/3}]$.

    Args:
        pressure: of the gas, $p_c$, shape (readings,) [Pa].
        coefficient: friction coefficient without the slip term, shape (readings,) [-].
        sd: its standard deviation, one number or shape (readings,) [-].
        modulus: $E^*$ of the rubber [Pa].
        strength_ratio: $\sigma_0/p_r$ [-]; left out, it is free, and that only K times it is known shows.
        profile: as for `fit_slip_curve`.

    Raises:
        InputError: An argument is no use.
        ComputationError: The fit failed.
    """
    p, mu, dev = _check_readings(pressure, coefficient, sd, ("pressure", "coefficient", "sd"), 1)
    free, pressures = strength_ratio is None, len(np.unique(p))
    modulus = _check_positive(modulus, "modulus")
    ratio = 1.0 if strength_ratio is None else _check_positive(strength_ratio, "strength_ratio")
    curve, subject = RUBBER[free], f"Eq. 8 at {pressures} pressure{'s' if pressures > 1 else ''}"
    data = RubberData(_pad(p), _pad(mu), _pad(1.0 / dev), jnp.asarray(ratio), jnp.asarray(modulus))
    loss = max(float(np.median(mu)), 1e-6) / (0.4 * ratio + 0.3 * (3 * float(np.median(p)) / modulus) ** (2 / 3))
    starts = np.array([[k, loss * share, ratio][: len(curve.names)] for k in (0.1, 1.0, 10.0) for share in (0.3, 1.5)])
    fit, profiles = settle_curve(curve, starts, data, subject), ()
    if profile:
        first = measure_knowledge(curve, fit.coefficients, data)
        fit, profiles = trace_profiles(curve, fit, first.sd, np.full(len(curve.names), 7.0), data, subject)
    measured = measure_knowledge(curve, fit.coefficients, data)
    tests = [("as many readings at twice the pressures", data._replace(pressure=2 * data.pressure)),
             ("as many readings at a quarter of the pressures", data._replace(pressure=data.pressure / 4))]
    elsewhere = {"tan delta_L": "the loss factor from a rheometer",
                 RATIO: "sigma_0 from a tensile test and p_r from the real contact area"}
    one = [ONE_PRESSURE + "."] if pressures == 1 else []
    notes = [PRODUCT + ".", *one, *describe_confusion(curve, fit, measured, profiles, tests, elsewhere, "readings")]
    return gather_fit(curve, subject, fit, measured, profiles, {} if free else {RATIO: ratio}, len(p), notes, data)


def _settle_alone(curve: Curve, data: SlipData, part: Readings, load: float) -> tuple[SlipData, Settled]:
    """One curve that levels off; where none of those fits, one that need not."""
    subject = f"the slip curve at {load:g} N"
    level = -1.0 / float(data.stroke)
    for ceiling in (level, math.inf):
        own = data._replace(ceiling=jnp.asarray(ceiling))
        fit = settle_curve(curve, guess_slip(*part, len(curve.names) > 4, ceiling), own, subject)
        if fits_noise(fit.chi2, len(part[0]) - len(curve.names)):
            break
    return own, fit


def evaluate_polynomials(fit: CurveFit, load: float) -> tuple[np.ndarray, np.ndarray]:
    """a...d (e) at a load [N] by fitted polynomials, and their standard deviations, shapes (4 or 5,)."""
    powers = spread_powers(load, len(fit.coefficients) == len(list_monomials(True)))
    return powers @ fit.values, np.sqrt(np.maximum(np.diag(powers @ fit.covariance @ powers.T), 0.0))


def _describe_shape(p: np.ndarray, free_e: bool) -> list[str]:
    """How strong the second exponential is, and what e is at zero slip."""
    e = p[4] if free_e else 1.0
    sizes = sorted((abs(p[2] - e), abs(p[2] + e)))
    found = []
    if sizes[0] < WEAK * sizes[1]:
        weak, strong = ("b - d", "b + d") if abs(p[2] + e) < abs(p[2] - e) else ("b + d", "b - d")
        share, sign = 100 * sizes[0] / sizes[1], "-" if weak == "b - d" else ""
        found.append("The curve is a constant and two exponentials, with rates b + d and b - d; the one with "
                     f"{weak} is {share:.2g} % of the other (c is near {sign}e), so that {strong} is known well and b "
                     "and d each badly.")
    if free_e:
        found.append("a (1 - e) is friction at zero slip, where Eq. 8's part adds to it: the two cannot be told apart "
                     "in one curve; strokes at several pressures would, as Eq. 8 depends on them and e does not.")
    return found


def _check_positive(value, name: str) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = math.nan
    if not (math.isfinite(number) and number > 0):
        raise InputError(f"{name} must be a positive number; got {value}")
    return number


def _check_readings(x, y, sd, names: tuple[str, str, str], least: int) -> Readings:
    """As arrays of one length, in the order in which they came."""
    try:
        x, y = (np.atleast_1d(np.asarray(part, dtype=float)) for part in (x, y))
        dev = np.broadcast_to(np.asarray(sd, dtype=float), y.shape)
    except (TypeError, ValueError):
        raise InputError(f"{names[0]}, {names[1]} and {names[2]} must be numbers, as many of one as of another "
                         f"({names[2]} may be a single one)") from None
    if x.ndim != 1 or x.shape != y.shape:
        raise InputError(f"{names[0]} and {names[1]} must be of one length; they are {x.size} and {y.size} long")
    for name, part in zip(names, (x, y, dev), strict=True):
        if not np.all(np.isfinite(part)):
            raise InputError(f"{name} number {int(np.argmin(np.isfinite(part))) + 1} is not a number")
    if np.any(x < 0):
        raise InputError(f"{names[0]} must not be negative; number {int(np.argmax(x < 0)) + 1} is {x[x < 0][0]:g}")
    if np.any(dev <= 0):
        raise InputError(f"{names[2]} must be positive; number {int(np.argmax(dev <= 0)) + 1} is {dev[dev <= 0][0]:g}")
    if len(x) < least:
        raise InputError(f"too few readings: {len(x)}, and the fit needs {least} at least")
    return x, y, dev


def _stack(records: Sequence[SlipRecord], least: int) -> tuple[SlipData, list[Readings]]:
    """Records as padded arrays, and slip [mm], coefficient and weight of each."""
    parts = []
    for record in records:
        slip, value, sd = _check_readings(record.slip, record.coefficient, record.sd, ("slip", "friction", "sd"), least)
        if np.ptp(slip) == 0:
            raise InputError(f"all slips at {float(record.load):g} N are {slip[0]:g} m; a curve needs different ones")
        if slip.max() > 1.0:
            raise InputError(f"slip is in metres, and {slip.max():g} m is no stroke; were these millimetres?")
        parts.append((slip / SLIP_UNIT, value, 1.0 / sd))
    length = max(len(part[0]) for part in parts)
    slip, value, weight = (np.stack([np.asarray(_pad(part[k], length)) for part in parts]) for k in range(3))
    loads = np.array([float(r.load) for r in records])
    strokes = np.array([part[0].max() for part in parts])
    made = (slip * SLIP_UNIT, value, weight, loads, strokes, np.array(1.0), loads.min(), np.array(np.inf))
    return SlipData(*(jnp.asarray(x) for x in made)), parts


def _pad(x, length: int = 0):
    """Zeros behind, up to a multiple of `LENGTHS`."""
    size = -(-max(len(x), length) // LENGTHS) * LENGTHS
    return jnp.asarray(np.concatenate([x, np.zeros(size - len(x))]))


def _pick(data: SlipData, k: int) -> SlipData:
    """One curve of several."""
    return data._replace(slip=data.slip[k], value=data.value[k], weight=data.weight[k], load=data.load[k],
                         stroke=data.stroke[k])
