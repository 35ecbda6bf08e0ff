r"""Fits of friction curves: a...e of Eq. 9 at one load, Eq. 10's polynomials over loads, K and tan delta_L of Eq. 8.

What the readings cannot tell apart is found from the Jacobian's singular values and said in words, with the test that
would resolve it.

* $(c, d) \to (-c, -d)$ leaves Eq. 9 as it is; d > 0 is what is reported, over loads at the lowest one.
* $K$ and $\sigma_0/p_r$ enter Eq. 8 as a product only.
* $K$ and $\tan\delta_L$ are a product too at a single pressure.
"""

import dataclasses as dc
import math
from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._errors import ComputationError, InputError
from ..contact.friction import SLIP_UNIT, SlipCoefficients, describe_range, rubber_coefficient, slip_coefficient
from .curve_fit import Curve, CurveFit, Settled, fit_model, fits_noise, measure_knowledge, settle_curve


STEEPEST = 200.0  # exponent at the end of a stroke beyond which a curve is cut: it is no number soon after
FLATTEST, SHARPEST = 1e-2, 1e3  # d times the stroke beyond which it changes no curve
FORBIDDEN = 1e4  # misfit per 1/mm of a rate above its ceiling, where a coefficient is held so
DEGREES = {"a": 1, "b": 2, "c": 2, "d": 2, "e": 2}  # of Eq. 10's polynomials
MODEST = (1e-3, 0.05, 1.0, 0.05, 1e-2)  # uncertainty of a...e that starts of the polynomials add
RUNAWAY = 5.0  # |c| beyond which a curve has d = 0
_UNITS = {"a": "", "b": "1/mm", "c": "", "d": "1/mm", "e": ""}
SYMMETRY = "(c, d) and (-c, -d) make the same curve: the one with d > 0 is given"
PRODUCT = ("K and sigma_0/p_r enter Eq. 8 as a product only, at any pressure and load: K is known as far as "
           "sigma_0/p_r is; a tensile test for sigma_0 and the real contact area under a known load for p_r would tell "
           "them apart")
ONE_PRESSURE = ("There is one pressure only, at which Eq. 8 is a single number for both K and tan delta_L: readings at "
                "a second pressure, or the loss factor from a rheometer, would tell them apart")
WEAK = 0.1  # share of the second exponential below which it is said to be weak
Readings = tuple[np.ndarray, np.ndarray, np.ndarray]  # slip [mm], coefficient [-], one over its deviation
LENGTHS = 64  # samples are padded to a multiple of it, so that few programs are compiled


class SlipData(NamedTuple):
    """Curves over slip, padded.

    Attributes:
        slip: since the stroke began, shape (..., samples) [m].
        value, weight: friction coefficient and one over its deviation, 0 where no sample is, shape (..., samples) [-].
        load: shape (...) [N].
        stroke: its end, shape (...) [mm].
        e: its value where it is not free [-].
        reference: load at which d is positive [N].
        ceiling: b + |d| stays below it, so that curves level off; infinite where they need not [1/mm].
    """

    slip: Array
    value: Array
    weight: Array
    load: Array
    stroke: Array
    e: Array
    reference: Array
    ceiling: Array


class RubberData(NamedTuple):
    """Readings at pressures [Pa]: coefficient [-], one over its deviation, shape (readings,); sigma_0/p_r; E* [Pa]."""

    pressure: Array
    value: Array
    weight: Array
    ratio: Array
    modulus: Array


def _misfit(coefficients: SlipCoefficients, data: SlipData) -> Array:
    """Whitened residuals of one curve; growth is cut at `STEEPEST`."""
    a, b, c, d, e = coefficients
    b = jnp.minimum(b, STEEPEST / data.stroke - jnp.abs(d))
    over = jnp.maximum(b + jnp.abs(d) - data.ceiling - 1e-9, 0.0)
    misfit = (slip_coefficient(data.slip, SlipCoefficients(a, b, c, d, e)) - data.value) * data.weight
    return misfit + FORBIDDEN * over


def _off_zero(x: Array, least: float = 1e-12) -> Array:
    return jnp.where(jnp.abs(x) < least, least, x)


def _slip_misfit(p: Array, data: SlipData) -> Array:
    return _misfit(SlipCoefficients(p[0], p[1], p[2], p[3], p[4] if p.shape[0] > 4 else data.e), data)


def _fold_slip(p: Array, data: SlipData) -> Array:
    r"""To $(a, b + d, a c d/(d + 1/L), \ln d, a e)$: regular where a or d vanish, while c and e go to infinity.

    Below a ceiling the logarithm of what is left to it stands for b + d.
    """
    slow = p[1] + p[3]
    limited = jnp.isfinite(data.ceiling)
    room = jnp.where(limited, jnp.maximum(data.ceiling - slow, 1e-3 / data.stroke), 1.0)
    strength = p[0] * p[2] * p[3] / (p[3] + 1.0 / data.stroke)
    parts = [p[0], jnp.where(limited, jnp.log(room), slow), strength, jnp.log(p[3])]
    return jnp.stack([*parts, p[0] * p[4]] if p.shape[0] > 4 else parts)


def _unfold_slip(x: Array, data: SlipData) -> Array:
    """Back from `_fold_slip`."""
    a, limited = x[0], jnp.isfinite(data.ceiling)
    slow = jnp.where(limited, jnp.where(limited, data.ceiling, 0.0) - jnp.exp(jnp.clip(x[1], -30.0, 10.0)), x[1])
    d = jnp.exp(jnp.clip(x[3], jnp.log(FLATTEST / data.stroke), jnp.log(SHARPEST / data.stroke)))
    c = x[2] * (d + 1.0 / data.stroke) / (d * _off_zero(a))
    return jnp.stack([a, slow - d, c, d, *(x[4:] / _off_zero(a))])


def _derive_slip(p: Array) -> Array:
    e = p[4] if p.shape[0] > 4 else 1.0
    return jnp.stack([p[1] + p[3], p[1] - p[3], 0.5 * p[0] * (p[2] - e), -0.5 * p[0] * (p[2] + e)])


def _make_slip(names: str) -> Curve:
    typical = {"a": 0.01, "b": 0.01, "c": 0.05, "d": 1.0, "e": 0.05}
    return Curve(tuple(names), tuple(_UNITS[n] for n in names), tuple(n == "d" for n in names),
                 tuple(typical[n] for n in names), _slip_misfit, _unfold_slip, _fold_slip, _derive_slip,
                 ("b + d [1/mm]", "b - d [1/mm]", "a (c - e)/2", "-a (c + e)/2"))


SLIP = {False: _make_slip("abcd"), True: _make_slip("abcde")}  # by whether e is free


SUMS = ("b0 + d0 [1/mm]", "b1 + d1 [1/(mm N)]", "b2 + d2 [1/(mm N^2)]")


def list_monomials(free_e: bool) -> tuple[str, ...]:
    """Names of the polynomials' coefficients in ascending powers of the load: a0, a1, b0 ... d2 (e0, e1, e2)."""
    return tuple(f"{n}{k}" for n, degree in DEGREES.items() if n != "e" or free_e for k in range(degree + 1))


def spread_powers(load, free_e: bool):
    """Matrix from the polynomials' coefficients to a...d (e) at a load [N], shape (4 or 5, coefficients)."""
    names = list_monomials(free_e)
    kinds = "abcde" if free_e else "abcd"
    return np.array([[float(load) ** int(n[1]) if n[0] == kind else 0.0 for n in names] for kind in kinds])


def _polynomial_misfit(p: Array, data: SlipData) -> Array:
    f = data.load
    a, b, c = p[0] + p[1] * f, p[2] + f * (p[3] + f * p[4]), p[5] + f * (p[6] + f * p[7])
    d = p[8] + f * (p[9] + f * p[10])
    e = p[11] + f * (p[12] + f * p[13]) if p.shape[0] > 11 else jnp.broadcast_to(data.e, f.shape)
    a, b, c, d, e = (part[:, None] for part in (a, b, c, d, e))
    return _misfit(SlipCoefficients(a, b, c, d, e), data._replace(stroke=data.stroke[:, None])).reshape(-1)


def _fold_polynomials(p: Array, data: SlipData) -> Array:
    """As they are, but for the logarithm of d at the reference load in the place of d0."""
    f = data.reference
    return p.at[8].set(jnp.log(jnp.abs(p[8] + f * (p[9] + f * p[10]))))


def _unfold_polynomials(x: Array, data: SlipData) -> Array:
    """Back from `_fold_polynomials`."""
    f = data.reference
    return x.at[8].set(jnp.exp(jnp.clip(x[8], -30.0, 30.0)) - f * (x[9] + f * x[10]))


def _derive_sums(p: Array) -> Array:
    return p[2:5] + p[8:11]


def _make_polynomials(free_e: bool) -> Curve:
    names = list_monomials(free_e)
    sizes = {"a": 0.01, "b": 0.01, "c": 0.05, "d": 0.01, "e": 0.05}
    rates, others = ("1/mm", "1/(mm N)", "1/(mm N^2)"), ("", "1/N", "1/N^2")
    units = [(rates if n[0] in "bd" else others)[int(n[1])] for n in names]
    return Curve(names, tuple(units), (False,) * len(names), tuple(sizes[n[0]] / 20.0 ** int(n[1]) for n in names),
                 _polynomial_misfit, _unfold_polynomials, _fold_polynomials, _derive_sums, SUMS)


POLYNOMIAL = {False: _make_polynomials(False), True: _make_polynomials(True)}


def _rubber_misfit(p: Array, data: RubberData) -> Array:
    ratio = p[2] if p.shape[0] > 2 else data.ratio
    return (rubber_coefficient(p[0], p[1], ratio, data.pressure, data.modulus) - data.value) * data.weight


def _unfold_logs(x: Array, data: RubberData) -> Array:
    return jnp.exp(jnp.clip(x, -60.0, 60.0))


def _fold_logs(p: Array, data: RubberData) -> Array:
    return jnp.log(p)


def _derive_products(p: Array) -> Array:
    return jnp.stack([p[0] * p[1]] + ([p[0] * p[2], p[0] * p[1] * p[2]] if p.shape[0] > 2 else []))


def _make_rubber(names: tuple[str, ...], derived: tuple[str, ...]) -> Curve:
    return Curve(names, ("",) * len(names), (True,) * len(names), (1.0,) * len(names), _rubber_misfit, _unfold_logs,
                 _fold_logs, _derive_products, derived)


RATIO = "sigma_0/p_r"
RUBBER = {
    False: _make_rubber(("K", "tan delta_L"), ("K tan delta_L",)),
    True: _make_rubber(("K", "tan delta_L", RATIO),
                       ("K tan delta_L", "K sigma_0/p_r", "K tan delta_L sigma_0/p_r")),
}  # by whether sigma_0/p_r is free


def find_spacing(slip: np.ndarray) -> float:
    """Usual distance of neighbouring slips, a thousandth of the stroke at least; in the unit of `slip`."""
    distances = np.asarray(np.diff(np.unique(slip)), dtype=float)
    return max(float(np.median(distances)), 1e-3 * float(slip.max()))


def guess_slip(slip: np.ndarray, value: np.ndarray, weight: np.ndarray, free_e: bool, ceiling: float = math.inf,
               count: int = 12) -> np.ndarray:
    """Coefficients to start from, shape (count, 4 or 5).

    For given rates b + d > b - d the curve is linear in a, a c and a e: a grid of rates, the rest by linear algebra.

    Args:
        slip: [mm], shape (samples,).
        value, weight: coefficient [-] and one over its deviation, shape (samples,).
        free_e: whether e is free; it is 1 otherwise.
        ceiling: of the rates [1/mm].
        count: of starts, the best of the grid.
    """
    stroke = float(slip.max())
    spacing = find_spacing(slip)
    growth = min(3.0 / spacing, 40.0 / stroke)
    falling = -np.geomspace(0.2 / stroke, 3.0 / spacing, 16)
    rates = np.concatenate([falling, np.geomspace(0.3 / stroke, growth, 8)])
    rates = rates[rates < ceiling - 1e-3 / stroke]
    found = []
    for fast in rates:
        for slow in rates[rates > fast]:
            up, down = np.exp(slow * slip), np.exp(fast * slip)
            basis = [1.0 + 0 * up, up, down] if free_e else [1.0 - 0.5 * (up + down), 0.5 * (up - down)]
            columns = np.stack(basis, axis=1) * weight[:, None]
            norms = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
            share = np.linalg.lstsq(columns / norms, value * weight, rcond=1e-10)[0] / norms
            misfit = float(np.sum((np.stack(basis, axis=1) @ share * weight - value * weight) ** 2))
            a = share[0] if abs(share[0]) > 1e-6 else 1e-6
            last = [(share[1] - share[2]) / a, -(share[1] + share[2]) / a] if free_e else [share[1] / a]
            start = [a, 0.5 * (slow + fast), last[0], 0.5 * (slow - fast), *last[1:]]
            if np.isfinite(misfit):
                found.append((misfit, start))
    found.sort(key=lambda item: item[0])
    return np.array([start for _, start in found[:count]])


def guess_polynomials(fits: list[tuple[float, np.ndarray, np.ndarray]], count: int = 12) -> np.ndarray:
    """Polynomials to start from, shape (count, coefficients), out of fits at single loads.

    Each of those has d > 0, while the polynomial of d may change sign between two loads (Eq. 10's does at 24.2 N): a
    start for every place where it might. The fits weigh by their uncertainty, with `MODEST` added to it, as their own
    is far too small away from the minimum; those whose c ran away have d = 0 and are left out.

    Args:
        fits: load [N], a...d (e), and their information matrix, in ascending order of the loads.
        count: of starts at most.
    """
    free_e = len(fits[0][1]) > 4
    kept = [fit for fit in fits if abs(fit[1][2]) < RUNAWAY]
    kept = kept if len(kept) >= 3 else fits
    modest = np.diag(np.square(MODEST[:len(kept[0][1])]))
    starts = []
    for turn in np.unique(np.linspace(1, len(kept), count).round().astype(int)):
        left, right = 0.0, 0.0
        for k, (load, centre, information) in enumerate(kept):
            sign = np.ones(len(centre))
            sign[2:4] = 1.0 if k < turn else -1.0
            powers = spread_powers(load, free_e) * sign[:, None]
            floor = 1e-12 * np.diag(np.diag(information) + 1e-12)
            weight = np.linalg.inv(np.linalg.inv(information + floor) + modest)
            left = left + powers.T @ weight @ powers
            right = right + powers.T @ weight @ centre
        scale = np.sqrt(np.diag(left))
        starts.append(np.linalg.lstsq(left / np.outer(scale, scale), right / scale, rcond=1e-9)[0] / scale)
    return np.array(starts + starts[-1:] * (count - len(starts)))


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
    slips, value, _ = parts[0]
    spans = np.array([100 * np.abs(value).max(), 10 / find_spacing(slips), 1e4, 14.0, 1e4])[:len(curve.names)]
    level = [f"That the curve levels off within the stroke, b + d < {ceiling:.2g} 1/mm, is assumed and not found."]
    notes = [SYMMETRY + ".", *(level if levels else [])]
    fit = fit_model(
        curve, guess_slip(*parts[0], bool(free_e), ceiling), data, subject, readings=len(slips),
        fixed={} if free_e else {"e": 1.0}, spans=spans if profile else None, unit="strokes",
        tests=[("as many samples again in the first fifth of the stroke", data._replace(slip=data.slip / 5)),
               ("a stroke twice as long", data._replace(slip=data.slip * 2))],
        elsewhere=dict.fromkeys("bcde", "curves at other loads, tied to this one by Eq. 10's polynomials,"),
        notes=lambda p: [*notes, *_describe_shape(p, free_e)])
    trouble = describe_range(load)
    outside = (f"{load:g} N is outside the range of Eq. 10: {trouble}.",) if trouble else ()
    return dc.replace(fit, notes=(*fit.notes, *outside))


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
    fit = fit_model(
        curve, guess_polynomials(fits), data, f"Eq. 10's polynomials from {loads[0]:g} to {loads[-1]:g} N",
        readings=sum(len(part[0]) for part in parts), fixed={} if free_e else {"e": 1.0},
        spans=1e3 * np.array(curve.typical) if profile else None, elsewhere={}, unit="sets of strokes",
        tests=[("as many curves at half the loads", data._replace(load=0.5 * data.load)),
               ("as many samples again in the first fifth of the strokes", data._replace(slip=data.slip / 5))],
        notes=lambda p: [f"{SYMMETRY}, at {loads[0]:g} N.",
                         f"Nothing here tests the polynomials below {loads[0]:g} or above {loads[-1]:g} N."])
    beyond: dict[str, list[str]] = {}
    for load in dict.fromkeys(loads):
        beyond.setdefault(describe_range(load), []).append(f"{load:g} N")
    beyond.pop("", None)
    return dc.replace(fit, notes=(*fit.notes, *(f"Outside the range of Eq. 10, at {', '.join(at)}: {trouble}."
                                                for trouble, at in beyond.items())))


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
    return fit_model(
        curve, starts, data, subject, readings=len(p), fixed={} if free else {RATIO: ratio}, unit="readings",
        spans=np.full(len(curve.names), 7.0) if profile else None,
        tests=[("as many readings at twice the pressures", data._replace(pressure=2 * data.pressure)),
               ("as many readings at a quarter of the pressures", data._replace(pressure=data.pressure / 4))],
        elsewhere={"tan delta_L": "the loss factor from a rheometer",
                   RATIO: "sigma_0 from a tensile test and p_r from the real contact area"},
        notes=lambda p: [PRODUCT + ".", *([ONE_PRESSURE + "."] if pressures == 1 else [])])


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
