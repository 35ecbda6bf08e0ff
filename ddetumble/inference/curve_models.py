"""What the fits of friction curves move: Eq. 9 at one load, Eq. 10's polynomials over loads, Eq. 8 over pressures."""

import math
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..contact.friction import SlipCoefficients, rubber_coefficient, slip_coefficient
from .profiles import Curve


STEEPEST = 200.0  # exponent at the end of a stroke beyond which a curve is cut: it is no number soon after
FLATTEST, SHARPEST = 1e-2, 1e3  # d times the stroke beyond which it changes no curve
FORBIDDEN = 1e4  # misfit per 1/mm of a rate above its ceiling, where a coefficient is held so
DEGREES = {"a": 1, "b": 2, "c": 2, "d": 2, "e": 2}  # of Eq. 10's polynomials
MODEST = (1e-3, 0.05, 1.0, 0.05, 1e-2)  # uncertainty of a...e that starts of the polynomials add
RUNAWAY = 5.0  # |c| beyond which a curve has d = 0
_UNITS = {"a": "", "b": "1/mm", "c": "", "d": "1/mm", "e": ""}


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


def _unfold_slip(x: Array, which: Array, value: Array, data: SlipData) -> Array:
    """Back from `_fold_slip`. While b is held, d is what is left of the slower rate b + d."""
    a = jnp.where(which == 0, value, x[0])
    limited = jnp.isfinite(data.ceiling)
    slow = jnp.where(limited, jnp.where(limited, data.ceiling, 0.0) - jnp.exp(jnp.clip(x[1], -30.0, 10.0)), x[1])
    d = jnp.exp(jnp.clip(x[3], jnp.log(FLATTEST / data.stroke), jnp.log(SHARPEST / data.stroke)))
    d = jnp.where(which == 3, value, jnp.where(which == 1, jnp.abs(slow - value), d))
    d = jnp.maximum(d, 1e-6 / data.stroke)
    b = jnp.where(which == 1, value, slow - d)
    c = jnp.where(which == 2, value, x[2] * (d + 1.0 / data.stroke) / (d * _off_zero(a)))
    if x.shape[0] == 4:
        return jnp.stack([a, b, c, d])
    return jnp.stack([a, b, c, d, jnp.where(which == 4, value, x[4] / _off_zero(a))])


def _derive_slip(p: Array) -> Array:
    e = p[4] if p.shape[0] > 4 else 1.0
    return jnp.stack([p[1] + p[3], p[1] - p[3], 0.5 * p[0] * (p[2] - e), -0.5 * p[0] * (p[2] + e)])


def _make_slip(names: str) -> Curve:
    typical = {"a": 0.01, "b": 0.01, "c": 0.05, "d": 1.0, "e": 0.05}
    return Curve(tuple(names), tuple(_UNITS[n] for n in names), tuple(n == "d" for n in names),
                 tuple(typical[n] for n in names), _slip_misfit, _unfold_slip, _fold_slip, (0, 3, 2, 3, 4)[:len(names)],
                 _derive_slip, ("b + d [1/mm]", "b - d [1/mm]", "a (c - e)/2", "-a (c + e)/2"))


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


def _unfold_polynomials(x: Array, which: Array, value: Array, data: SlipData) -> Array:
    """Back from `_fold_polynomials`. While d0 is held, d1 is what makes d positive at the reference load."""
    f = data.reference
    x = jnp.where((jnp.arange(x.shape[0]) == which) & (which != 8), value, x)
    there = jnp.exp(jnp.clip(x[8], -30.0, 30.0))
    d1 = jnp.where(which == 8, (there - value - f * f * x[10]) / f, x[9])
    return x.at[8].set(there - f * (d1 + f * x[10])).at[9].set(d1)


def _derive_sums(p: Array) -> Array:
    return p[2:5] + p[8:11]


def _make_polynomials(free_e: bool) -> Curve:
    names = list_monomials(free_e)
    sizes = {"a": 0.01, "b": 0.01, "c": 0.05, "d": 0.01, "e": 0.05}
    rates, others = ("1/mm", "1/(mm N)", "1/(mm N^2)"), ("", "1/N", "1/N^2")
    units = [(rates if n[0] in "bd" else others)[int(n[1])] for n in names]
    pins = [9 if n == "d0" else k for k, n in enumerate(names)]
    return Curve(names, tuple(units), (False,) * len(names), tuple(sizes[n[0]] / 20.0 ** int(n[1]) for n in names),
                 _polynomial_misfit, _unfold_polynomials, _fold_polynomials, tuple(pins), _derive_sums, SUMS)


POLYNOMIAL = {False: _make_polynomials(False), True: _make_polynomials(True)}


def _rubber_misfit(p: Array, data: RubberData) -> Array:
    ratio = p[2] if p.shape[0] > 2 else data.ratio
    return (rubber_coefficient(p[0], p[1], ratio, data.pressure, data.modulus) - data.value) * data.weight


def _unfold_logs(x: Array, which: Array, value: Array, data: RubberData) -> Array:
    return jnp.where(jnp.arange(x.shape[0]) == which, value, jnp.exp(jnp.clip(x, -60.0, 60.0)))


def _fold_logs(p: Array, data: RubberData) -> Array:
    return jnp.log(p)


def _derive_products(p: Array) -> Array:
    return jnp.stack([p[0] * p[1]] + ([p[0] * p[2], p[0] * p[1] * p[2]] if p.shape[0] > 2 else []))


def _make_rubber(names: tuple[str, ...], derived: tuple[str, ...]) -> Curve:
    return Curve(names, ("",) * len(names), (True,) * len(names), (1.0,) * len(names), _rubber_misfit, _unfold_logs,
                 _fold_logs, tuple(range(len(names))), _derive_products, derived)


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
