"""Least squares of a curve with few coefficients: covariance from its Jacobian, intervals from its profile likelihood.

A `Curve` says what is fitted, `settle_curve` fits it by optimistix from many starts at once, `trace_profiles` refits it
with each coefficient held on a grid, and `measure_knowledge` finds what its Jacobian cannot tell apart.
"""

import dataclasses as dc
import math
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array
from scipy import stats

from .._errors import ComputationError
from .identifiability import Knowledge, analyse_columns
from .parameters import ParameterSpace


LEVEL = 0.95  # of all intervals
RISE = float(stats.chi2.ppf(LEVEL, 1))  # of chi-square at their ends
MOST_STEPS = 150  # of Levenberg-Marquardt, in each of two rounds of a fit
FEW_STEPS = 40  # of the same, from one point of a profile to the next
ENOUGH = 25.0  # rise of chi-square at which a profile ends
SETTLED = 0.02  # chi-square that one more Gauss-Newton step would gain: below it a fit has ended
STARTS = 12  # of a fit; fewer are padded, so that one program serves them all
POINTS = 12  # on each side of a profile
FAR = 20.0  # standard deviations after which a profile that has not risen never will
FINER = 2  # grids, each in one step of the one before, on which the end of an interval is sought
MOVING = 0.02  # share of its way that a coefficient goes in the last two points of a line without an end
ROUNDS = 3  # of going on where a fit has not ended, and of starting again from a better place that a profile found


@dc.dataclass(frozen=True)
class Curve:
    r"""What a fit moves, and what it makes of it; a static value, whose functions live at the top of a module.

    Attributes:
        names: of the coefficients.
        units: of each, as text.
        logs: whether each is positive, with its logarithm as coordinate.
        typical: change of each coordinate a hundred times which is more than anybody expects (1 for logarithms).
        predict: `(coefficients, data)` to whitened residuals, shapes (coefficients,) to (rows,).
        unfold: `(x, which, value, data)` to coefficients: internal coordinates, in which the fit is regular, with
            coefficient number `which` held at `value` (-1: none).
        fold: `(coefficients, data)` to internal coordinates.
        pins: internal coordinate that rests while each coefficient is held.
        derive: `coefficients` to combinations of them worth telling.
        derived: names of those.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    logs: tuple[bool, ...]
    typical: tuple[float, ...]
    predict: Callable[[Array, Any], Array]
    unfold: Callable[[Array, Array, Array, Any], Array]
    fold: Callable[[Array, Any], Array]
    pins: tuple[int, ...]
    derive: Callable[[Array], Array]
    derived: tuple[str, ...]

    @property
    def slots(self) -> tuple["_Slot", ...]:
        """As `ParameterSpace.slots`, for `analyse_columns`."""
        return tuple(_Slot(_Declared("log" if log else "linear", typical))
                     for log, typical in zip(self.logs, self.typical, strict=True))

    @property
    def index(self) -> dict[str, int]:
        """Place of each coefficient."""
        return {name: k for k, name in enumerate(self.names)}


class _Declared(NamedTuple):
    coordinate: str
    typical: float


class _Slot(NamedTuple):
    parameter: _Declared


@dc.dataclass(frozen=True)
class Profile:
    """Chi-square with one coefficient held, all others refitted.

    Attributes:
        name: of the coefficient.
        values: at which it was held, ascending, the estimate among them, shape (points,).
        rise: of chi-square over its minimum [-], shape (points,).
        low, high: of the 95 % interval, where the rise is 3.84; infinite (or 0, for what is positive) where it never
            gets there.
        bounded: whether the data bound it below and above.
    """

    name: str
    values: np.ndarray
    rise: np.ndarray
    low: float
    high: float
    bounded: tuple[bool, bool]


@partial(jax.jit, static_argnums=0)
def _settle(curve: Curve, starts: Array, which: Array, values: Array, data: Any):
    """Fits from many starts: internal coordinates, chi-square, decrement, steps."""
    return jax.vmap(lambda x, k, v: _settle_one(curve, x, k, v, data, 2, MOST_STEPS))(starts, which, values)


def _settle_one(curve: Curve, start: Array, which: Array, value: Array, data: Any, rounds: int, most: int):
    """Levenberg-Marquardt in coordinates whose columns have unit norm, in rounds; `which` is held at `value`."""
    start = curve.fold(curve.unfold(start, which, value, data), data)  # back from beyond limits, where slopes vanish
    count = start.shape[0]
    pin = jnp.where(which < 0, -1, jnp.asarray(curve.pins)[which])
    pinned = jnp.arange(count) == pin

    def rows(x):
        return curve.predict(curve.unfold(x, which, value, data), data)

    def go(x, _):
        columns = jax.jacfwd(rows)(x)
        norms = jnp.sqrt(jnp.sum(columns**2, axis=0))
        scales = jnp.where(pinned, 0.0, 1.0 / jnp.maximum(jnp.where(jnp.isfinite(norms), norms, 1.0), 1.0))
        found = optx.least_squares(
            lambda y, args: (rows(args[0] + args[1] * y), jnp.where(pinned, y, 0.0)),
            optx.LevenbergMarquardt(rtol=1e-8, atol=1e-4), jnp.zeros(count), args=(x, scales), max_steps=most,
            throw=False)  # fmt: skip
        return x + scales * found.value, found.stats["num_steps"]

    x, steps = jax.lax.scan(go, start, None, length=rounds)
    residual, columns = rows(x), jnp.where(pinned, 0.0, jax.jacfwd(rows)(x))
    norms = jnp.maximum(jnp.sqrt(jnp.sum(columns**2, axis=0)), 1.0)
    unit = columns / norms
    squares, axes = jnp.linalg.eigh(unit.T @ unit)
    slopes = axes.T @ (unit.T @ residual)
    gain = jnp.sum(jnp.where(squares > 1e-8, slopes**2 / jnp.where(squares > 1e-8, squares, 1.0), 0.0))
    return x, jnp.sum(residual**2), gain, jnp.sum(steps)


@partial(jax.jit, static_argnums=0)
def _trace(curve: Curve, starts: Array, which: Array, values: Array, least: Array, data: Any):
    """Chi-square along lines of held values, each fit from the one before it; shapes (lines, points).

    A line that has risen over `least + ENOUGH` stays where it is: infinite from there on.
    """

    def line(start, k, held):
        def step(carry, value):
            before, at, done = carry
            at = jnp.where(done, at, value)
            x, chi2, _, _ = _settle_one(curve, before, k, at, data, 1, FEW_STEPS)
            return (x, at, done | (chi2 > least + ENOUGH)), (jnp.where(done, jnp.inf, chi2), x)

        return jax.lax.scan(step, (start, held[0], jnp.asarray(False)), held)[1]

    return jax.vmap(line)(starts, which, values)


@partial(jax.jit, static_argnums=0)
def _linearise(curve: Curve, coefficients: Array, data: Any):
    """Residual, its derivatives by the coefficients, and combinations with theirs."""
    rows, columns = curve.predict(coefficients, data), jax.jacfwd(curve.predict)(coefficients, data)
    return rows, columns, curve.derive(coefficients), jax.jacfwd(curve.derive)(coefficients)


class Settled(NamedTuple):
    """A fit: coefficients, internal coordinates, chi-square, what one more step would gain, steps taken."""

    coefficients: np.ndarray
    x: np.ndarray
    chi2: float
    gain: float
    steps: int


def settle_curve(curve: Curve, starts: np.ndarray, data: Any, subject: str) -> Settled:
    """Fit a curve from several starts at once by Levenberg-Marquardt of optimistix; the best one counts.

    Args:
        curve: what is fitted.
        starts: coefficients to start from, shape (starts, coefficients).
        data: for `predict`.
        subject: what it is, for the message.

    Raises:
        ComputationError: No start led to a minimum.
    """
    starts = np.asarray(starts, dtype=float)
    count = max(len(starts), STARTS)
    padded = np.concatenate([starts, np.broadcast_to(starts[-1], (count - len(starts), starts.shape[1]))])
    x = np.asarray(jax.vmap(lambda p: curve.fold(p, data))(jnp.asarray(padded)))
    taken = 0
    for _ in range(ROUNDS):  # along a curved valley one go may not reach the end
        found = _settle(curve, jnp.asarray(x), jnp.full(count, -1), jnp.zeros(count), data)
        x, chi2, gain, steps = (np.asarray(part) for part in found)
        good = np.isfinite(chi2) & np.isfinite(gain) & np.all(np.isfinite(x), axis=1)
        if not good.any():
            raise ComputationError(f"The fit of {subject} failed: from none of {count} starts is its misfit a number; "
                                   "check the values and their standard deviations")
        best = int(np.argmin(np.where(good, chi2, np.inf)))
        taken += int(steps[best])
        ended = gain[best] <= SETTLED * max(1.0, 1e-3 * chi2[best])
        if ended:
            break
        x = np.where(good[:, None], x, x[best])
    if not ended:
        raise ComputationError(f"The fit of {subject} did not end after {taken} steps: chi-square is "
                               f"{chi2[best]:.6g} and one more step would take {gain[best]:.2g} off it")
    unfolded = curve.unfold(jnp.asarray(x[best]), jnp.asarray(-1), jnp.asarray(0.0), data)
    return Settled(np.asarray(unfolded), x[best], float(chi2[best]), float(gain[best]), taken)


class Measured(NamedTuple):
    """What the Jacobian at a fit says.

    Attributes:
        known: in coordinates (logarithms of what is positive).
        columns: whitened derivatives by the coordinates, shape (rows, coefficients).
        sd: of the coefficients, shape (coefficients,).
        singular: values of the columns scaled to unit norm, descending, shape (coefficients,).
        derived: estimate and standard deviation of each combination.
    """

    known: Knowledge
    columns: np.ndarray
    sd: np.ndarray
    singular: np.ndarray
    derived: dict[str, tuple[float, float]]


def measure_knowledge(curve: Curve, coefficients: np.ndarray, data: Any) -> Measured:
    """Covariance, correlations and directions that change nothing, by the singular values of the Jacobian."""
    rows, columns, values, slopes = (np.asarray(p) for p in _linearise(curve, jnp.asarray(coefficients), data))
    factor = np.where(curve.logs, coefficients, 1.0)  # derivative of a coefficient by its coordinate
    columns, slopes = columns * factor, slopes * factor
    if not np.all(np.isfinite(columns)):
        raise ComputationError("the derivatives of the curve at its fit are not all numbers")
    known = analyse_columns(cast(ParameterSpace, curve), curve.names, columns, np.ones(len(curve.names)))
    norms = np.linalg.norm(columns, axis=0)
    unit = columns / np.where(norms > 0, norms, 1.0)
    singular = np.linalg.svd(np.concatenate([unit, np.zeros((len(norms), len(norms)))]), compute_uv=False)
    sd = np.sqrt(np.diag(known.covariance)) * factor
    spread = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", slopes, known.covariance, slopes), 0.0))
    derived = {n: (float(v), float(s)) for n, v, s in zip(curve.derived, values, spread, strict=True)}
    return Measured(known, columns, sd, singular, derived)


def trace_profiles(curve: Curve, fit: Settled, sd: np.ndarray, spans: np.ndarray, data: Any, subject: str
                   ) -> tuple[Settled, tuple[Profile, ...]]:
    """Profile likelihood of every coefficient, outwards from the fit on both sides.

    A profile that finds a better place than the fit sends the fit there, and all begins again.

    Args:
        curve, fit, data, subject: as for `settle_curve`.
        sd: of the coefficients.
        spans: farthest change of each coordinate that is worth trying, shape (coefficients,).

    Returns:
        The fit, and the profiles in the order of the names.
    """
    for _ in range(ROUNDS):
        grids, chi2, xs = _trace_sides(curve, fit, sd, spans, data)
        if not np.any(chi2 < fit.chi2 - 0.01):
            break
        better = np.unravel_index(int(np.nanargmin(chi2)), chi2.shape)
        which, held = jnp.asarray(better[0] // 2), jnp.asarray(grids[better])
        start = curve.unfold(jnp.asarray(xs[better]), which, held, data)
        fit = settle_curve(curve, np.asarray(start)[None], data, subject)
    ends, bounded = _find_ends(curve, fit, grids, chi2, xs, data)
    _widen_ends(curve, fit, grids, chi2, xs, data, ends, bounded)
    made = []
    for k, name in enumerate(curve.names):
        left, right = 2 * k, 2 * k + 1
        values = np.concatenate([grids[left][::-1], [fit.coefficients[k]], grids[right]])
        rise = np.concatenate([chi2[left][::-1], [fit.chi2], chi2[right]]) - fit.chi2
        there = np.isfinite(rise)
        made.append(Profile(name, values[there], np.maximum(rise[there], 0.0), ends[left], ends[right],
                            (bounded[left], bounded[right])))
    return fit, tuple(made)


def _trace_sides(curve: Curve, fit: Settled, sd: np.ndarray, spans: np.ndarray, data: Any):
    """Grids downwards and upwards of every coefficient, chi-square on them, and where the others went."""
    grids = []
    for k, log in enumerate(curve.logs):
        here = fit.coefficients[k]
        step = sd[k] / here if log else sd[k]
        far = min(FAR * step, spans[k])
        offsets = np.geomspace(min(0.25 * step, far / 30), far, POINTS)
        for side in (-1.0, 1.0):
            grids.append(here * np.exp(side * offsets) if log else here + side * offsets)
    grids = np.array(grids)
    which = np.repeat(np.arange(len(curve.names)), 2)
    chi2, xs = _trace(curve, jnp.broadcast_to(fit.x, (len(grids), len(fit.x))), jnp.asarray(which), jnp.asarray(grids),
                      jnp.asarray(fit.chi2), data)
    chi2 = np.asarray(chi2)
    return grids, np.where(np.isfinite(chi2), chi2, np.inf), np.asarray(xs)


def _find_ends(curve: Curve, fit: Settled, grids: np.ndarray, chi2: np.ndarray, xs: np.ndarray, data: Any):
    """Where each side first rises by `RISE`: twice on a finer grid between the two points around it, then on a line."""
    over = chi2 - fit.chi2 > RISE
    bounded = np.asarray(np.any(over, axis=1))
    first = np.where(bounded, np.argmax(over, axis=1), 0)
    lines = np.arange(len(grids))
    which = jnp.asarray(lines // 2)
    before = np.where(first > 0, grids[lines, first - 1], fit.coefficients[lines // 2])
    after = grids[lines, first]
    starts = np.where((first > 0)[:, None], xs[lines, first - 1], fit.x)
    low, high = np.zeros(len(grids)), np.zeros(len(grids))
    for _ in range(FINER):
        fine = before[:, None] + (after - before)[:, None] * np.linspace(0.0, 1.0, POINTS)
        there, places = _trace(curve, jnp.asarray(starts), which, jnp.asarray(fine), jnp.asarray(fit.chi2), data)
        rise = np.where(np.isfinite(there), there, np.inf) - fit.chi2
        above = rise > RISE
        j = np.maximum(np.where(np.any(above, axis=1), np.argmax(above, axis=1), POINTS - 1), 1)
        before, after, starts = fine[lines, j - 1], fine[lines, j], np.asarray(places)[lines, j - 1]
        low, high = (np.sqrt(np.maximum(rise[lines, k], 0.0)) for k in (j - 1, j))
    share = np.clip((math.sqrt(RISE) - low) / np.maximum(high - low, 1e-12), 0.0, 1.0)
    none = [math.inf if k % 2 else (0.0 if curve.logs[k // 2] else -math.inf) for k in lines]
    ends = [float(x) for x in np.where(bounded, before + share * (after - before), none)]
    return ends, [bool(b) for b in bounded]


def _widen_ends(curve: Curve, fit: Settled, grids: np.ndarray, chi2: np.ndarray, xs: np.ndarray, data: Any,
                ends: list[float], bounded: list[bool]) -> None:
    """Let intervals hold what their coefficients were wherever another one was held and chi-square had not risen.

    A line that follows one coefficient may miss a second valley that another line finds; and where another line has no
    end, what still moves away there (by more than `MOVING` of its way) has none either.
    """
    which = jnp.asarray(np.repeat(np.arange(len(grids)) // 2, POINTS))
    back = jax.vmap(lambda x, k, v: curve.unfold(x, k, v, data))
    there = np.asarray(back(jnp.asarray(xs).reshape(-1, xs.shape[-1]), which, jnp.asarray(grids).reshape(-1)))
    there = np.where((chi2 - fit.chi2 <= RISE).reshape(-1, 1), there, fit.coefficients)
    last = np.arange(len(there)) % POINTS == POINTS - 1
    for k, log in enumerate(curve.logs):
        for side, sign in ((0, -1.0), (1, 1.0)):
            j = int(np.argmax(sign * there[:, k]))
            if bounded[2 * k + side] and sign * there[j, k] > sign * ends[2 * k + side]:
                ends[2 * k + side] = float(there[j, k])
                if last[j] and abs(there[j, k] - there[j - 2, k]) > MOVING * abs(there[j, k] - fit.coefficients[k]):
                    bounded[2 * k + side] = False
                    ends[2 * k + side] = math.inf if side else (0.0 if log else -math.inf)


def measure_spread(columns: np.ndarray, rows: np.ndarray, direction: np.ndarray) -> float:
    """Standard deviation along a combination that `rows` leave, over the one that `columns` leave.

    Args:
        columns: whitened derivatives, whose norms are the units of `direction`, shape (rows, coefficients).
        rows: of another design at the same coefficients, shape (rows, coefficients).
        direction: unit vector, shape (coefficients,).
    """
    norms = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)

    def length(part):
        _, s, axes = np.linalg.svd(part / norms, full_matrices=False)
        return float(np.linalg.norm((axes @ direction) / np.maximum(s, 1e-6)))

    return length(rows) / length(columns)
