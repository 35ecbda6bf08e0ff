r"""Least squares of curves with few coefficients: values, covariance, profile likelihood, and what stays undetermined.

`fit_curve` fits any curve, to rounding where possible. Levenberg-Marquardt of optimistix goes down from the start
twice, once with damping in the parameters' own units and once in units of their start, as each fails where the other
does not; the smaller sum of squares counts. Gauss-Newton steps on columns of unit norm then go on until rounding stops
them.

The friction curves of the paper (a...e of Eq. 9 at one load, Eq. 10's polynomials over loads, K and tan delta_L of
Eq. 8) are fitted from many starts at once, in coordinates in which they are regular. Intervals are those of the profile
likelihood: with coefficient $p_k$ drawn to a value v,

$$ \min_x \chi^2(x) + w^2 (p_k(x) - v)^2 $$

lies on the profile of $p_k$ at the value that it attains, whatever w: no coefficient has to be held exactly. What the
readings cannot tell apart is said in words, with the test that would resolve it:

* $(c, d) \to (-c, -d)$ leaves Eq. 9 as it is; d > 0 is what is reported, over loads at the lowest one.
* $K$ and $\sigma_0/p_r$ enter Eq. 8 as a product only; so do $K$ and $\tan\delta_L$ at a single pressure.
"""

import abc
import dataclasses as dc
import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array
from scipy import stats

from .._display import AbstractPrinted
from .._errors import ComputationError, InputError
from ..contact.friction import SLIP_UNIT, SlipCoefficients, describe_range, rubber_coefficient, slip_coefficient
from ..contact.transform import TRANSFORMS
from .files import make_plain
from .identifiability import VAST, Blend, Knowledge, analyse_jacobian, list_changes, list_words, measure_spread


DAMPINGS = ("own units", "units of the start")
TOLERANCE = 1e-10  # of Levenberg-Marquardt, relative: a last Gauss-Newton polish takes it to rounding
MOST_STEPS = 3000  # of the same: curved valleys are long, and a fit that needs more is not determined
MOST_POLISH = 100  # Gauss-Newton steps after it: near the end each doubles the digits, in a valley it may not
PATIENCE = 3  # such steps without gain before they end: rounding can spoil one or two
SETTLED = 1e-6  # of the scatter: a last step that changes the curve less has arrived, as no reading shows it
ROUNDING = 1e-13  # of the readings' size: likewise
EPS = float(np.finfo(float).eps)  # spacing of doubles at 1
# Scatter of this share of the readings is told to be near rounding: below it fewer than five digits are left of it.
FAINT = 1e5 * EPS
# Component of a direction that changes nothing, above which a parameter is not determined: rounding leaves less.
LOST = 1e-6

RISE = float(stats.chi2.ppf(0.95, 1))  # of chi-square at the ends of a 95 % interval
GO = 300  # steps of Levenberg-Marquardt in one go, after which its units are taken anew: along a valley they change
GOES = 4  # of a fit at most: along a curved valley one may not reach the end
# Chi-square that one more Gauss-Newton step would gain: below it a fit has ended, a seventh of a deviation off at most.
LITTLE = 0.02
# Singular value of unit columns below which no step is taken that way: derivatives are no better than that there.
FLAT = 1e-4
STARTS = 12  # of a fit: of a grid of guesses the best by chi-square; more only end in the same place
POINTS = 12  # on each side of a profile: its ends are found by bisection between two of them
FAR = 20.0  # standard deviations after which a profile that has not risen never will
HIGH = 25.0  # rise of chi-square at which a profile ends: five deviations, well beyond the ends of an interval
STIFF = 10.0  # weight that draws a coefficient to its value, over its deviation, at least: it is held to a tenth of it
BISECTIONS = 8  # in which the end of an interval is found, between two points of a profile: to 1/256 of their distance
# Share of its way that a coefficient goes in the last two points of a line without an end: less, and it stands.
MOVING = 0.02
AGAIN = 3  # times that a fit begins again from a better place that a profile found: bounded, so that it ends
UNKNOWN = 100.0  # relative deviation of a combination beyond which nothing is known of it, its sign included
# Probability of a misfit as large below which the curve is said not to fit: a false alarm in 10,000 fits.
UNLIKELY = 1e-4
ENOUGH = 0.2  # relative deviation at which a coefficient counts as known: good to 20 %
MOST_BLENDS = 2  # told one by one: more are a list that nobody acts on
MOST_MEMBERS = 4  # of a combination, told by name: longer sentences are not read
MOST_STROKES = 1e4  # beyond it, averaging is no advice: nobody makes 10,000 strokes

STEEPEST = 200.0  # exponent at the end of a stroke beyond which a curve is cut: it is no number soon after (exp of 710)
FLATTEST, SHARPEST = 1e-2, 1e3  # d times the stroke beyond which it changes no curve
FORBIDDEN = 1e4  # misfit per 1/mm of a rate above its ceiling, where a coefficient is held so: far above any noise
DEGREES = {"a": 1, "b": 2, "c": 2, "d": 2, "e": 2}  # of Eq. 10's polynomials, as printed
# Uncertainty of a...e that starts of the polynomials add, so that no single curve decides them.
MODEST = (1e-3, 0.05, 1.0, 0.05, 1e-2)
RUNAWAY = 5.0  # |c| beyond which a curve has d = 0: c d alone is then determined
WEAK = 0.1  # share of the second exponential below which it is said to be weak: a tenth
LENGTHS = 64  # samples are padded to a multiple of it: larger wastes time, smaller compiles more programs
SYMMETRY = "(c, d) and (-c, -d) give the same curve; the one with d > 0 is reported"
PRODUCT = ("K and sigma_0/p_r enter Eq. 8 as a product only, at any pressure and load: K is known as far as "
           "sigma_0/p_r is; a tensile test for sigma_0 and the real contact area under a known load for p_r would "
           "distinguish them.")
ONE_PRESSURE = ("There is only one pressure, at which Eq. 8 gives a single number for both K and tan delta_L: "
                "readings at "
                "a second pressure, or the loss factor from a rheometer, would distinguish them.")


@dc.dataclass(frozen=True)
class Regression(AbstractPrinted):
    """A curve fitted by least squares.

    Attributes:
        names, values: of the parameters at the smallest sum of squares, shape (parameters,).
        errors, covariance: of the values from the Jacobian there; infinite for what the readings do not determine, and
            nan between that and all else, shapes (parameters,) and (parameters, parameters).
        sum_of_squares: of the residuals, over `sd` where that is given (chi-square).
        residual_sd: root of the sum of squares over the degrees of freedom; nan where there are none.
        degrees: of freedom, readings less parameters.
        steps, damping: from the start with the damping that did better, polishing included; and which one that was.
        converged: whether one more step would change next to nothing, and all parameters are determined.
        message: how it ended, a sentence.
    """

    names: tuple[str, ...]
    values: np.ndarray
    errors: np.ndarray
    covariance: np.ndarray
    sum_of_squares: float
    residual_sd: float
    degrees: int
    steps: int
    damping: str
    converged: bool
    message: str

    def __str__(self) -> str:
        rows = [f"  {name:12} {value:15.8g} +- {error:.3g}"
                for name, value, error in zip(self.names, self.values, self.errors, strict=True)]
        head = f"sum of squares {self.sum_of_squares:.8g} with {self.degrees} degrees of freedom"
        return "\n".join([head, *rows, self.message])

    def to_dict(self) -> dict[str, Any]:
        """As plain data for JSON; what is infinite or missing is null."""
        return make_plain(self)


def fit_curve(model: Callable[[Array, Array], Array], x, y, start: Mapping[str, float] | Sequence[float], sd=None
              ) -> Regression:
    r"""Minimise $\sum_i [(f(p, x_i) - y_i)/\sigma_i]^2$ over the parameters p, with their standard errors.

    The covariance is $(J^T J)^{-1}$ with the Jacobian J of the whitened curve at the solution. Without `sd` all
    readings weigh the same, and it is multiplied by the residual variance $\sum r^2/(n - p)$.

    Args:
        model: f, of the parameters and `x`, in JAX: shapes (parameters,) and that of `x` to (readings,). It is compiled
            once if it stands at the top of a module, and anew every time if it is made on the spot.
        x: predictors, shape (readings,), or (predictors, readings) if there are several.
        y: readings, shape (readings,).
        start: where to begin; a mapping gives the parameters names, which are p1, p2, ... otherwise. The right orders
            of magnitude help, as they are the units of one of two dampings.
        sd: standard deviation of the readings in their unit, one number or shape (readings,).

    Raises:
        InputError: An argument is no use; one sentence says where.
        ComputationError: Sum of squares or derivatives are no numbers where the fit ended.
    """
    begin = _take_numbers("start", list(start.values()) if isinstance(start, Mapping) else start)
    if begin.ndim != 1 or not begin.size:
        raise InputError(f"start must be a list of numbers; its shape is {begin.shape}")
    names = tuple(map(str, start)) if isinstance(start, Mapping) else tuple(f"p{k + 1}" for k in range(len(begin)))
    if not np.isfinite(begin).all():
        raise InputError(f"the start of {names[int(np.argmin(np.isfinite(begin)))]} is not a number")
    x, y, dev = _check_readings(x, y, 1.0 if sd is None else sd, ("x", "y", "sd"), most_rows=2)
    count, scale = len(names), sd is None
    if len(y) < count + scale:
        raise InputError(f"there are too few readings: {len(y)}, but {count} parameters need at least {count + scale}"
                         + ("; standard errors from the scatter need one more" if scale else ""))
    weights = 1.0 / dev
    size = float(np.sqrt(np.mean((weights * y) ** 2))) or 1.0  # so that the fit does not depend on the readings' unit
    data = (jnp.asarray(x), jnp.asarray(y), jnp.asarray(weights / size))
    struct = jax.eval_shape(model, jnp.asarray(begin), data[0])
    if getattr(struct, "shape", None) != y.shape:
        raise InputError(f"the model must return one number per reading, shape {y.shape}; it returns "
                         f"{getattr(struct, 'shape', type(struct).__name__)}")
    residual = np.asarray(_linearise(model, jnp.asarray(begin), *data)[0])
    if not np.all(np.isfinite(residual)):
        raise InputError("the model at the start is not a number for reading number "
                         f"{int(np.argmin(np.isfinite(residual))) + 1}; start elsewhere")
    units = np.stack([np.ones_like(begin), np.where(begin == 0, 1.0, np.abs(begin))])
    found = _descend(model, jnp.asarray(begin), jnp.asarray(units), *data)
    reached, squares, steps = (np.asarray(part) for part in found)
    best = int(np.argmin(np.where(np.isfinite(squares), squares, np.inf)))
    place, polished = _polish(model, reached[best], data)

    squares, degrees, steps = float(place.residual @ place.residual), len(y) - count, int(steps[best]) + polished
    spread = math.sqrt(squares / degrees) if degrees else math.nan
    root = place.axes.T / np.where(place.singular > 0, place.singular, np.inf) / place.norms[:, None]
    covariance = root @ root.T * (spread**2 if scale else 1.0 / size**2)
    lost = np.any(np.abs(place.axes[place.singular == 0]) > LOST, axis=0)
    covariance[lost, :] = covariance[:, lost] = np.nan
    covariance[lost, lost] = np.inf
    settled = place.gain <= SETTLED * (spread if scale else 1.0 / size) + ROUNDING * math.sqrt(count)
    message = "Converged" if settled else f"Not converged after {steps} steps"
    message += f": one more step would change the curve by {place.gain * size:.2g} in total"
    if lost.any():
        message += f"; the readings do not determine {', '.join(n for n, out in zip(names, lost, strict=True) if out)}"
    elif scale and spread < FAINT:
        message += (f"; the scatter is {spread / EPS:.0f} times the rounding of the readings, and the standard errors "
                    f"based on it are accurate to about {max(0, round(math.log10(max(spread / EPS, 1.0))))} digits")
    return Regression(names, place.values, np.sqrt(np.diag(covariance)), covariance, squares * size**2, spread * size,
                      degrees, steps, DAMPINGS[best], bool(settled and not lost.any()), message + ".")


class _Place(NamedTuple):
    """Parameters, residual, singular values of columns of unit norm, their axes, norms, next step and its size."""

    values: np.ndarray
    residual: np.ndarray
    singular: np.ndarray
    axes: np.ndarray
    norms: np.ndarray
    step: np.ndarray
    gain: float


def _go_down(rows: Callable[[Array], Array], start: Array, unit: Array, relative: float, absolute: float, most: int):
    """Levenberg-Marquardt in given units: place and steps."""
    found = optx.least_squares(lambda q, _: rows(start + unit * q), optx.LevenbergMarquardt(
        rtol=relative, atol=absolute), jnp.zeros_like(start), max_steps=most, throw=False)
    return start + unit * found.value, found.stats["num_steps"]


@eqx.filter_jit
def _descend(model, start: Array, units: Array, x: Array, y: Array, weights: Array):
    """Levenberg-Marquardt with each of several units: parameters, sums of squares, steps."""
    rows = lambda p: weights * (model(p, x) - y)

    def one(unit):
        values, steps = _go_down(rows, start, unit, TOLERANCE, 1e-14, MOST_STEPS)
        return values, jnp.sum(rows(values) ** 2), steps

    return jax.vmap(one)(units)


@eqx.filter_jit
def _linearise(model, values: Array, x: Array, y: Array, weights: Array):
    """Residual and its derivatives."""
    rows = lambda p: weights * (model(p, x) - y)
    return rows(values), jax.jacfwd(rows)(values)


def _look(model, values: np.ndarray, data) -> _Place | None:
    """Residual, Jacobian and Gauss-Newton step at a place; None where they are no numbers."""
    residual, columns = (np.asarray(part) for part in _linearise(model, jnp.asarray(values), *data))
    if not (np.all(np.isfinite(residual)) and np.all(np.isfinite(columns))):
        return None
    norms = np.linalg.norm(columns, axis=0)
    norms = np.where(norms > 0, norms, 1.0)
    left, singular, axes = np.linalg.svd(columns / norms, full_matrices=False)
    kept = singular > singular[0] * len(residual) * EPS
    pull = np.where(kept, left.T @ residual, 0.0)
    step = -(axes.T @ (pull / np.where(kept, singular, 1.0))) / norms
    return _Place(values, residual, np.where(kept, singular, 0.0), axes, norms, step, float(np.linalg.norm(pull)))


def _polish(model, values: np.ndarray, data) -> tuple[_Place, int]:
    """Gauss-Newton steps for as long as the next one keeps shrinking and the sum of squares does not rise."""
    best = here = _look(model, values, data)
    if best is None or here is None:
        raise ComputationError("the fit ended where the model or its derivatives are not numbers, at "
                               f"{', '.join(f'{v:.6g}' for v in values)}; start elsewhere")
    limit = float(best.residual @ best.residual) * (1.0 + 1e-6) + ROUNDING**2 * len(best.residual)
    without, taken, used = 0, 0, 0
    while taken < MOST_POLISH and without < PATIENCE:
        here = _look(model, here.values + here.step, data)
        taken += 1
        if here is None or here.residual @ here.residual > limit:
            break
        without = 0 if here.gain < best.gain else without + 1
        if not without:
            best, used = here, taken
    return best, used


def _take_numbers(name: str, values) -> np.ndarray:
    try:
        return np.asarray(values, dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"{name} must be numbers") from None


def _check_readings(x, y, sd, names: tuple[str, str, str], most_rows: int = 1, least: int = 0) -> list[np.ndarray]:
    """Readings y over x with their deviations, as arrays of one length, in the order in which they came."""
    x, y, sd = map(_take_numbers, names, (x, y, sd))
    if most_rows == 1:  # of friction, where a single reading may be a plain number
        x, y = np.atleast_1d(x, y)
    sd = sd.reshape(()) if sd.size == 1 else sd
    if y.ndim != 1 or not 1 <= x.ndim <= most_rows:
        several = " or several" if most_rows > 1 else ""
        raise InputError(f"{names[1]} must be a list of numbers, and {names[0]} one{several} of its length; the "
                         f"shapes are {y.shape} and {x.shape}")
    if x.shape[-1] != len(y):
        order = "; several predictors take one row each" if x.ndim == 2 else ""
        raise InputError(f"{names[0]} and {names[1]} must have the same length; they are {x.shape[-1]} and {len(y)} "
                         f"long"
                         f"{order}")
    if sd.shape not in ((), y.shape):
        raise InputError(f"{names[2]} must be one number or as many as {names[1]}, which are {len(y)}; its shape is "
                         f"{sd.shape}")
    sd = np.broadcast_to(sd, y.shape)
    for name, part in zip(names, (x, y, sd), strict=True):
        good = np.isfinite(part)
        if not good.all():
            raise InputError(f"{name} number {int(np.argmin(good)) % part.shape[-1] + 1} is not a number")
    if np.any(sd <= 0):
        k = int(np.argmax(sd <= 0))
        raise InputError(f"{names[2]} must be positive; number {k + 1} is {sd[k]:g}")
    if len(y) < least:
        raise InputError(f"there are too few readings: {len(y)}, but the fit needs at least {least}")
    return [x, y, sd]


@dc.dataclass(frozen=True)
class Curve(abc.ABC):
    """A curve with few coefficients; a static value, to which the readings are an argument.

    Attributes:
        names, units: of the coefficients.
        logs: whether each is positive, with its logarithm as coordinate.
        typical: change of each coordinate a hundred times which is more than anybody expects (1 for logarithms).
        derived: names of combinations worth telling.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    logs: tuple[bool, ...]
    typical: tuple[float, ...]
    derived: tuple[str, ...]

    @abc.abstractmethod
    def predict(self, p: Array, data: Any) -> Array:
        """Whitened residuals of coefficients, shapes (coefficients,) to (rows,)."""

    @abc.abstractmethod
    def fold(self, p: Array, data: Any) -> Array:
        """Internal coordinates, in which the fit is regular, of coefficients, shape (coefficients,) both."""

    @abc.abstractmethod
    def unfold(self, x: Array, data: Any) -> Array:
        """Back from `fold`."""

    @abc.abstractmethod
    def derive(self, p: Array) -> Array:
        """The combinations that `derived` names."""

    def to_coordinates(self, values, xp=np):
        """Logarithms of what is positive, shape (..., coefficients)."""
        logs = xp.asarray(self.logs)
        with np.errstate(divide="ignore"):
            return xp.where(logs, xp.log(xp.where(logs, values, 1.0)), values)


class Readings(NamedTuple):
    """Readings of friction, padded: of curves over slip, or at pressures of the gas.

    Attributes:
        at: slip since the stroke began [m], shape (..., samples), or pressure [Pa], shape (readings,).
        value, weight: friction coefficient and one over its deviation, 0 where no sample is, shape of `at` [-].
        load, stroke: shape (...) [N], and where it ends [mm].
        reference: load at which d is positive [N].
        ceiling: b + |d| stays below it, so that curves level off; infinite where they need not [1/mm].
        ratio, modulus: sigma_0/p_r where it is not free [-], and E* [Pa], of pressures.
    """

    at: Array
    value: Array
    weight: Array
    load: Any = 0.0
    stroke: Any = 0.0
    reference: Any = 0.0
    ceiling: Any = math.inf
    ratio: Any = 1.0
    modulus: Any = 1.0


def _follow_slip(coefficients: Sequence[Array], data: Readings) -> Array:
    """Whitened residuals of Eq. 9; growth is cut at `STEEPEST`, and rates above their ceiling are forbidden."""
    a, b, c, d, e = coefficients
    b = jnp.minimum(b, STEEPEST / data.stroke - jnp.abs(d))
    over = jnp.maximum(b + jnp.abs(d) - data.ceiling - 1e-9, 0.0)
    return (slip_coefficient(data.at, SlipCoefficients(a, b, c, d, e)) - data.value) * data.weight + FORBIDDEN * over


class _SlipCurve(Curve):
    r"""Eq. 9 at one load, in $(a, b + d, a c d/(d + 1/L), \ln d, a e)$: regular where a or d vanish, as c, e run away.

    Below a ceiling the logarithm of what is left to it stands for b + d.
    """

    def predict(self, p: Array, data: Readings) -> Array:
        return _follow_slip([*p, 1.0][:5], data)

    def fold(self, p: Array, data: Readings) -> Array:
        slow = p[1] + p[3]
        limited = jnp.isfinite(data.ceiling)
        room = jnp.where(limited, jnp.maximum(data.ceiling - slow, 1e-3 / data.stroke), 1.0)
        strength = p[0] * p[2] * p[3] / (p[3] + 1.0 / data.stroke)
        return jnp.stack([p[0], jnp.where(limited, jnp.log(room), slow), strength, jnp.log(p[3]), *(p[0] * p[4:])])

    def unfold(self, x: Array, data: Readings) -> Array:
        limited = jnp.isfinite(data.ceiling)
        slow = jnp.where(limited, jnp.where(limited, data.ceiling, 0.0) - jnp.exp(jnp.clip(x[1], -30.0, 10.0)), x[1])
        d = jnp.exp(jnp.clip(x[3], jnp.log(FLATTEST / data.stroke), jnp.log(SHARPEST / data.stroke)))
        a = jnp.where(jnp.abs(x[0]) < 1e-12, 1e-12, x[0])  # what is divided by it stays a number
        return jnp.stack([x[0], slow - d, x[2] * (d + 1.0 / data.stroke) / (d * a), d, *(x[4:] / a)])

    def derive(self, p: Array) -> Array:
        e = p[4] if len(self.names) > 4 else 1.0
        return jnp.stack([p[1] + p[3], p[1] - p[3], 0.5 * p[0] * (p[2] - e), -0.5 * p[0] * (p[2] + e)])


class _SlipPolynomials(Curve):
    """Eqs. 9 and 10 over loads, with the logarithm of d at the reference load in the place of d0."""

    def predict(self, p: Array, data: Readings) -> Array:
        coefficients = jnp.moveaxis(self.spread(data.load) @ p, -1, 0)[..., None]
        return _follow_slip([*coefficients, 1.0][:5], data._replace(stroke=data.stroke[:, None])).reshape(-1)

    def fold(self, p: Array, data: Readings) -> Array:
        f = data.reference
        return p.at[8].set(jnp.log(jnp.abs(p[8] + f * (p[9] + f * p[10]))))

    def unfold(self, x: Array, data: Readings) -> Array:
        f = data.reference
        return x.at[8].set(jnp.exp(jnp.clip(x[8], -30.0, 30.0)) - f * (x[9] + f * x[10]))

    def derive(self, p: Array) -> Array:
        return p[2:5] + p[8:11]

    def spread(self, load):
        """Matrix from coefficients to a...d (e) at loads [N], shape (..., 4 or 5, coefficients)."""
        powers = np.array([int(name[1]) for name in self.names])
        own = np.array([[name[0] == kind for name in self.names] for kind in dict.fromkeys(n[0] for n in self.names)])
        return own * load[..., None, None] ** powers


class _RubberCurve(Curve):
    """Eq. 8 over pressures, in logarithms."""

    def predict(self, p: Array, data: Readings) -> Array:
        ratio = p[2] if len(self.names) > 2 else data.ratio
        return (rubber_coefficient(p[0], p[1], ratio, data.at, data.modulus) - data.value) * data.weight

    def fold(self, p: Array, data: Readings) -> Array:
        return jnp.log(p)

    def unfold(self, x: Array, data: Readings) -> Array:
        return jnp.exp(jnp.clip(x, -60.0, 60.0))

    def derive(self, p: Array) -> Array:
        return jnp.stack([p[0] * p[1]] + ([p[0] * p[2], p[0] * p[1] * p[2]] if len(self.names) > 2 else []))


def _make_slip(names: str) -> _SlipCurve:
    units = {"b": "1/mm", "d": "1/mm"}
    typical = {"a": 0.01, "b": 0.01, "c": 0.05, "d": 1.0, "e": 0.05}
    return _SlipCurve(tuple(names), tuple(units.get(n, "") for n in names), tuple(n == "d" for n in names),
                      tuple(typical[n] for n in names), ("b + d [1/mm]", "b - d [1/mm]", "a (c - e)/2", "-a (c + e)/2"))


def _make_polynomials(kinds: str) -> _SlipPolynomials:
    """Coefficients in ascending powers of the load: a0, a1, b0 ... d2 (e0, e1, e2)."""
    names = tuple(f"{kind}{k}" for kind in kinds for k in range(DEGREES[kind] + 1))
    sizes = {"a": 0.01, "b": 0.01, "c": 0.05, "d": 0.01, "e": 0.05}
    rates, others = ("1/mm", "1/(mm N)", "1/(mm N^2)"), ("", "1/N", "1/N^2")
    return _SlipPolynomials(names, tuple((rates if n[0] in "bd" else others)[int(n[1])] for n in names),
                            (False,) * len(names), tuple(sizes[n[0]] / 20.0 ** int(n[1]) for n in names),
                            tuple(f"b{k} + d{k} [{unit}]" for k, unit in enumerate(rates)))


RATIO = "sigma_0/p_r"
SLIP = {False: _make_slip("abcd"), True: _make_slip("abcde")}  # by whether e is free
POLYNOMIAL = {False: _make_polynomials("abcd"), True: _make_polynomials("abcde")}  # likewise
RUBBER = {
    False: _RubberCurve(("K", "tan delta_L"), ("",) * 2, (True,) * 2, (1.0,) * 2, ("K tan delta_L",)),
    True: _RubberCurve(("K", "tan delta_L", RATIO), ("",) * 3, (True,) * 3, (1.0,) * 3,
                       ("K tan delta_L", "K sigma_0/p_r", "K tan delta_L sigma_0/p_r")),
}  # by whether sigma_0/p_r is free


@dc.dataclass(frozen=True)
class Profile:
    """Chi-square as a function of one coefficient, all others refitted.

    Attributes:
        values, rise: of the coefficient, ascending, the estimate among them; of chi-square over its minimum [-].
        low, high: of the 95 % interval, where the rise is 3.84; infinite (or 0, for what is positive) without end.
        bounded: whether the data bound it below and above.
    """

    name: str
    values: np.ndarray
    rise: np.ndarray
    low: float
    high: float
    bounded: tuple[bool, bool]


@dc.dataclass(frozen=True)
class Coefficient:
    """One fitted number; b and d are per millimetre, as Eq. 10 has them.

    Attributes:
        estimate, sd: at the smallest chi-square, and from the Jacobian there; infinite where nothing is known.
        low, high: 95 % interval by profile likelihood; infinite where there is no end, NaN where none can be given.
        bounded: whether the readings bound it on both sides.
    """

    name: str
    unit: str
    estimate: float
    sd: float
    low: float
    high: float
    bounded: bool

    def __str__(self) -> str:
        low = f"{self.low:.5g}" if math.isfinite(self.low) else "no lower end"
        high = f"{self.high:.5g}" if math.isfinite(self.high) else "no upper end"
        reach = f"95 % from {low} to {high}" + ("" if self.bounded else ", not bounded by these readings")
        reach = "no interval" if math.isnan(self.low) else reach
        return f"  {self.name:12} {self.estimate:12.5g} +- {say_sd(self.sd):9} {self.unit:10} {reach}"


@dc.dataclass(frozen=True)
class CurveFit(AbstractPrinted):
    """A fit of one friction curve, or of several by polynomials.

    Attributes:
        subject: what was fitted.
        coefficients, fixed: by name, in order; and what was held.
        derived: estimate and standard deviation of combinations, by name.
        covariance, correlations: in coordinates (of what is positive: the logarithm), (coefficients, coefficients).
        singular_values: of the whitened Jacobian with columns of unit norm, descending; 0 is an exact symmetry.
        chi2, readings, steps: misfit, how many numbers it sums over, and steps that the optimiser took.
        profiles: one a coefficient.
        notes: what cannot be told apart and which test would, sentences.
        curve, data: for those who go on computing.
    """

    subject: str
    coefficients: Mapping[str, Coefficient]
    derived: Mapping[str, tuple[float, float]]
    fixed: Mapping[str, float]
    covariance: np.ndarray
    correlations: np.ndarray
    singular_values: np.ndarray
    chi2: float
    readings: int
    steps: int
    profiles: tuple[Profile, ...]
    notes: tuple[str, ...]
    curve: Curve
    data: Any

    @property
    def values(self) -> np.ndarray:
        """Estimates in order, shape (coefficients,)."""
        return np.array([c.estimate for c in self.coefficients.values()])

    def __str__(self) -> str:
        head = (f"{self.subject}: chi-square {self.chi2:.1f} of {self.readings} readings less "
                f"{len(self.coefficients)} coefficients")
        derived = [f"  {name:26} {value:12.5g} +- {say_sd(sd)}" for name, (value, sd) in self.derived.items()]
        fixed = [f"  {name} = {value:g}, held" for name, value in self.fixed.items()]
        return "\n".join([head, *map(str, self.coefficients.values()), *derived, *fixed,
                          *(f"- {note}" for note in self.notes)])

    def to_dict(self) -> dict[str, Any]:
        """As plain data for JSON; what has no end is null."""
        return {f.name: make_plain(getattr(self, f.name)) for f in dc.fields(self) if f.name not in ("curve", "data")}


def say_sd(value: float) -> str:
    """A standard deviation in words."""
    return f"{value:.2g}" if math.isfinite(value) else "unknown"


def _fits_noise(chi2: float, degrees: int) -> bool:
    """Whether noise alone would often make a chi-square as large, with so many degrees of freedom."""
    return degrees <= 0 or bool(stats.chi2.sf(chi2, degrees) >= UNLIKELY)


class _Settled(NamedTuple):
    """One fit or many: internal coordinates, coefficients, chi-square, what one more step would take off it, steps."""

    x: Any
    coefficients: Any
    chi2: Any
    gain: Any
    steps: Any


@partial(jax.jit, static_argnums=0)
def _refit(curve: Curve, starts: Array, k: int, value: float, weight: float, data: Any) -> _Settled:
    """One go from many starts, shape (lines, coefficients); coordinate k is drawn to `value` with a weight or 0."""
    def one(start):
        def rows(x):
            p = curve.unfold(x, data)
            return jnp.append(curve.predict(p, data), weight * (curve.to_coordinates(p, jnp)[k] - value))

        norms = jnp.linalg.norm(jax.jacfwd(rows)(start), axis=0)
        unit = 1.0 / jnp.maximum(jnp.where(jnp.isfinite(norms), norms, 1.0), 1.0)
        x, steps = _go_down(rows, start, unit, 1e-8, 1e-4, GO)
        residual, columns = rows(x), jax.jacfwd(rows)(x)
        good = jnp.isfinite(residual).all() & jnp.isfinite(columns).all() & jnp.isfinite(x).all()
        residual, columns = jnp.where(good, residual, 0.0), jnp.where(good, columns, 0.0)
        left, singular, _ = jnp.linalg.svd(columns / jnp.maximum(jnp.linalg.norm(columns, axis=0), 1.0),
                                           full_matrices=False)
        pull = jnp.where(singular > FLAT, left.T @ residual, 0.0)
        chi2, gain = (jnp.where(good, jnp.sum(part**2), jnp.inf) for part in (residual[:-1], pull))
        return _Settled(x, curve.unfold(x, data), chi2, gain, steps)

    return jax.vmap(one)(starts)


@partial(jax.jit, static_argnums=0)
def _differentiate(curve: Curve, coefficients: Array, data: Any) -> Array:
    return jax.jacfwd(curve.predict)(coefficients, data)


@dc.dataclass(frozen=True)
class _Fitter:
    """Fits of a curve to readings; `subject` is what they are, for messages."""

    curve: Curve
    data: Any
    subject: str

    def fold(self, coefficients: np.ndarray) -> np.ndarray:
        """Internal coordinates of many, shape (lines, coefficients), back from beyond limits, where slopes vanish."""
        return np.asarray(jax.vmap(lambda p: self.curve.fold(p, self.data))(jnp.asarray(coefficients)))

    def go(self, x: np.ndarray, k: int = 0, value: float = 0.0, weight: float = 0.0) -> _Settled:
        """As `_refit`."""
        return _Settled(*map(np.asarray, _refit(self.curve, x, k, value, weight, self.data)))

    def settle(self, starts: np.ndarray) -> _Settled:
        """The best fit from several starts at once, coefficients of shape (starts, coefficients)."""
        x, taken = self.fold(np.asarray(starts, dtype=float)), 0
        for _ in range(GOES):
            lines = self.go(x)
            best = _Settled(*(part[int(np.argmin(lines.chi2))] for part in lines))
            if not np.isfinite(best.chi2):
                raise ComputationError(f"the fit of {self.subject} failed: chi-square is finite at none of {len(x)} "
                                       f"starts; "
                                       "check the values and their standard deviations")
            taken += int(best.steps)
            if best.gain <= LITTLE * max(1.0, 1e-3 * best.chi2):
                return best._replace(steps=taken)
            x = np.where(np.isfinite(lines.chi2)[:, None], lines.x, best.x)
        raise ComputationError(f"the fit of {self.subject} did not converge in {taken} steps: chi-square is "
                               f"{best.chi2:.6g} and one more step would reduce it by {best.gain:.2g}")

    def measure(self, coefficients: np.ndarray, data: Any = None) -> tuple[Knowledge, np.ndarray]:
        """What the Jacobian at a fit says, in coordinates, and its whitened columns, shape (rows, coefficients)."""
        curve, data = self.curve, self.data if data is None else data
        columns = np.asarray(_differentiate(curve, jnp.asarray(coefficients), data))
        columns = columns * np.where(curve.logs, coefficients, 1.0)
        if not np.all(np.isfinite(columns)):
            raise ComputationError("the derivatives of the fitted curve are not all finite")
        vast = np.where(curve.logs, TRANSFORMS["log"].unknown, VAST * np.array(curve.typical))
        return analyse_jacobian(curve.names, columns, np.ones(len(curve.names)), vast), columns

    def profile(self, fit: _Settled, spans: np.ndarray) -> tuple[_Settled, tuple[Profile, ...]]:
        """Profile likelihood of every coefficient; where a profile finds a better fit, all begins again from there."""
        curve, place = self.curve, self.curve.to_coordinates
        known, columns = self.measure(fit.coefficients)
        reach = np.minimum(FAR * np.sqrt(np.diag(known.covariance)), spans)
        weights = np.maximum(STIFF * FAR / reach, np.linalg.norm(columns, axis=0))
        seen: list[list[_Settled]] = []
        for _ in range(AGAIN):
            lines = [[self._walk(fit, k, sign * far, weight) for sign in (-1.0, 1.0)]
                     for k, (far, weight) in enumerate(zip(reach, weights, strict=True))]
            seen += [line for both in lines for line in both]
            best = min((point for both in lines for line in both for point in line), key=lambda point: point.chi2)
            if best.chi2 >= fit.chi2 - 0.01:
                break
            fit = self.settle(best.coefficients[None])
        here, made = place(fit.coefficients), []
        for k, (name, both) in enumerate(zip(curve.names, lines, strict=True)):
            ends = []
            for sign, line in zip((-1.0, 1.0), both, strict=True):
                end = self._find_end(fit, k, line, sign * reach[k], weights[k])
                # A line that follows one coefficient may miss a second valley that another line finds: an interval
                # holds what its coefficient was on any line where chi-square had not risen.
                passed = [np.array([place(p.coefficients)[k] if p.chi2 - fit.chi2 <= RISE else here[k] for p in other])
                          for other in seen]
                own = max(passed, key=lambda values: float(np.max(sign * values)))
                point = int(np.argmax(sign * own))
                if sign * own[point] > sign * end:
                    # Where that line has no end, what still moves away there has none either.
                    last = point == POINTS - 1
                    moving = last and abs(own[point] - own[point - 2]) > MOVING * abs(own[point] - here[k])
                    end = sign * math.inf if moving else own[point]
                ends.append(float(np.exp(end) if curve.logs[k] else end))
            points = [p for p in (*both[0][::-1], fit, *both[1]) if np.isfinite(p.chi2)]
            low, high = ends
            made.append(Profile(name, np.array([p.coefficients[k] for p in points]),
                                np.array([max(float(p.chi2 - fit.chi2), 0.0) for p in points]), low, high,
                                (low > (0.0 if curve.logs[k] else -math.inf), high < math.inf)))
        return fit, tuple(made)

    def _draw(self, x: np.ndarray, k: int, value: float, weight: float) -> _Settled:
        """The fit with the coordinate of coefficient k drawn to a value, from internal coordinates."""
        return _Settled(*(part[0] for part in self.go(x[None], k, value, weight)))

    def _walk(self, fit: _Settled, k: int, reach: float, weight: float) -> list[_Settled]:
        """Points of the profile of coefficient k on one side, each fit from the one before, until it is `HIGH`."""
        centre, x, points = self.curve.to_coordinates(fit.coefficients)[k], fit.x, []
        for offset in np.geomspace(min(0.25 / FAR, 1 / 30), 1.0, POINTS):
            points.append(self._draw(x, k, centre + offset * reach, weight))
            if not points[-1].chi2 <= fit.chi2 + HIGH:
                break
            x = self.fold(points[-1].coefficients[None])[0]
        return points

    def _find_end(self, fit: _Settled, k: int, line: list[_Settled], reach: float, weight: float) -> float:
        """Coordinate at which a profile first rises by `RISE`, by false position on its root; infinite if never."""
        root = lambda point: math.sqrt(max(float(point.chi2 - fit.chi2), 0.0))
        place = lambda point: float(self.curve.to_coordinates(point.coefficients)[k])
        over = next((i for i, point in enumerate(line) if root(point) > math.sqrt(RISE)), None)
        if over is None:
            return math.copysign(math.inf, reach)
        start = line[over - 1] if over else fit
        x, below, low, above, high = start.x, place(start), root(start), place(line[over]), root(line[over])
        if not math.isfinite(high):
            above, high = below + reach, 10.0 * math.sqrt(RISE)
        for turn in range(BISECTIONS):
            share = min(max((math.sqrt(RISE) - low) / max(high - low, 1e-12), 0.02), 0.98) if turn % 3 < 2 else 0.5
            point = self._draw(x, k, below + share * (above - below), weight)
            if root(point) <= math.sqrt(RISE):
                x, below, low = point.x, place(point), root(point)
            else:
                above, high = place(point), root(point)
        return below + min(max((math.sqrt(RISE) - low) / max(high - low, 1e-12), 0.0), 1.0) * (above - below)

    def fit(self, starts: np.ndarray, *, readings: int, fixed: Mapping[str, float], spans: np.ndarray | None,
            tests: Mapping[str, Any], elsewhere: Mapping[str, str], unit: str,
            notes: Callable[[np.ndarray], list[str]]) -> CurveFit:
        """Fit the curve, trace its profiles, and say what the readings cannot tell apart and which test would.

        Args:
            starts, spans: as for `settle` and `profile`; without `spans` there are no profiles, and so no intervals.
            readings, fixed: how many there are, and what is held, by name.
            tests: readings to add to those there are, by what they are.
            elsewhere: for a coefficient, where else it can be had.
            unit: what could be repeated and averaged: `strokes`.
            notes: sentences about the coefficients, that come first.
        """
        curve, fit, profiles = self.curve, self.settle(starts), ()
        if spans is not None:
            fit, profiles = self.profile(fit, spans)
        known, columns = self.measure(fit.coefficients)
        lost = known.undetermined
        doubtful = [p.name for p in profiles if p.name in lost and all(p.bounded)]
        factor = np.where(curve.logs, fit.coefficients, 1.0)  # derivative of a coefficient by its coordinate
        sds = np.sqrt(np.diag(known.covariance)) * factor
        slopes = np.asarray(jax.jacfwd(curve.derive)(jnp.asarray(fit.coefficients))) * factor
        spread = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", slopes, known.covariance, slopes), 0.0))
        derived = {n: (float(v), float(s) if s < UNKNOWN * abs(v) else math.inf)
                   for n, v, s in zip(curve.derived, curve.derive(fit.coefficients), spread, strict=True)}
        coefficients = {}
        for k, name in enumerate(curve.names):
            low, high, bounded = 0.0 if curve.logs[k] else -math.inf, math.inf, False
            if doubtful:
                low = high = math.nan
            elif profiles:
                low, high, bounded = profiles[k].low, profiles[k].high, all(profiles[k].bounded)
            sd = math.inf if name in lost or doubtful else float(sds[k])
            coefficients[name] = Coefficient(name, curve.units[k], float(fit.coefficients[k]), sd, low, high, bounded)
        told, degrees = [], readings - len(curve.names)
        if not _fits_noise(fit.chi2, degrees):
            told.append(f"The curve does not fit: chi-square is {fit.chi2:.5g} where about {degrees} is expected (p = "
                        f"{stats.chi2.sf(fit.chi2, degrees):.1g}), so no interval here can be relied on.")
        if doubtful:
            told.append(f"The readings do not determine {list_words(doubtful)}: other values, far from this "
                        "estimate, may fit as well. No interval is given for any coefficient.")
        told += notes(fit.coefficients)
        told += [f"These readings contain no information on {name}: it changes them by less than their noise."
                 for name in known.silent]
        told += [self._describe(fit, columns, blend, tests, elsewhere, unit) for blend in known.blends[:MOST_BLENDS]]
        rest = len(known.blends) - MOST_BLENDS
        if rest > 0:
            told.append(f"{rest} further combination{'s are' if rest > 1 else ' is'} poorly determined too: rely on "
                        f"the "
                        "curve rather than on single coefficients.")
        told += [_describe_openness(profile) for profile in profiles if not all(profile.bounded)]
        return CurveFit(self.subject, coefficients, derived, dict(fixed), known.covariance, known.correlations,
                        known.singular, float(fit.chi2), readings, int(fit.steps), profiles, tuple(told), curve,
                        self.data)

    def _describe(self, fit: _Settled, columns: np.ndarray, blend: Blend, tests: Mapping[str, Any],
                  elsewhere: Mapping[str, str], unit: str) -> str:
        """A combination that is hard to tell apart, in a sentence with what would."""
        curve, places = self.curve, [self.curve.names.index(name) for name in blend.names]
        steps, logs = blend.step[places], np.array(curve.logs)[places]
        typical = np.array(curve.typical)[places]
        share = (0.01 if logs[0] else typical[0]) / abs(steps[0]) if blend.singular else 1.0
        share = min([share, *(0.5 / abs(step) for step, log in zip(steps, logs, strict=True) if log and step)])
        changes = []
        for name, k, step in zip(blend.names[:MOST_MEMBERS], places, share * np.sign(steps[0]) * steps, strict=False):
            size = f"{abs(math.expm1(step)) * 100:.2g} %" if curve.logs[k] else f"{abs(step):.2g} {curve.units[k]}"
            changes.append((name, step, size.rstrip()))
        change, others = list_changes(changes), len(blend.names) - MOST_MEMBERS
        members = list_words(blend.names[:MOST_MEMBERS])
        if others > 0:
            members = list_words([*blend.names[:MOST_MEMBERS], f"{others} other{'s' if others > 1 else ''}"])
            change += ", and the others with them,"
        if blend.singular:
            text = f"{members} cannot be distinguished: {change} changes no reading beyond its noise"
        else:
            part = "one standard deviation" if share == 1 else f"{share:.2g} of a standard deviation"
            text = f"{members} are hard to distinguish: {change} changes the readings by only {part}"

        now = measure_spread(columns, columns, blend)
        gains = [(measure_spread(np.concatenate([columns, self.measure(fit.coefficients, data)[1]]), columns, blend)
                  / now, test) for test, data in tests.items()]
        left, test = min(gains)
        # The largest relative deviation of a member along the combination, and what averages it away.
        size = float(np.max(np.abs(steps) / np.where(logs, 1.0, np.maximum(np.abs(fit.coefficients[places]), typical))))
        strokes = (size / ENOUGH) ** 2
        average = f"the average of about {strokes:.2g} such {unit} would determine them to {100 * ENOUGH:g} %"
        if blend.singular and left * size < 0.5:
            remedy = f"{test} would distinguish them"
        elif not blend.singular and size <= ENOUGH:
            remedy = f"these steps are at most {100 * ENOUGH:g} % of each"
        elif not blend.singular and left < 0.5:
            gain = "distinguish them" if left < 0.1 else f"reduce this uncertainty by a factor of {1 / left:.1f}"
            remedy = f"{test} would {gain}" + (f", and {average}" if strokes < MOST_STROKES else "")
        elif not blend.singular and strokes < MOST_STROKES:
            remedy = average
        else:
            known = next((elsewhere[n] for n in blend.names if n in elsewhere), "the value of one of them from "
                         "elsewhere")
            remedy = f"{known} would distinguish them"
        return f"{text}; {remedy}."


def _describe_openness(profile: Profile) -> str:
    """An interval without one or both ends, in a sentence."""
    name, values, largest = profile.name, profile.values, float(np.max(profile.rise))
    if any(profile.bounded):
        bound, end = ("below", "upper") if profile.bounded[0] else ("above", "lower")
        return f"These readings bound {name} only from {bound}: its interval has no {end} end."
    if largest < RISE:
        return (f"These readings do not bound {name} at all: with it held anywhere from {values[0]:.3g} to "
                f"{values[-1]:.3g} and the rest refitted, chi-square rises by at most {largest:.2g}.")
    return (f"These readings do not bound {name} at all: the fit is as good far from its estimate, where the other "
            "coefficients differ too.")


def _find_spacing(slip: np.ndarray) -> float:
    """Usual distance of neighbouring slips, a thousandth of the stroke at least; in the unit of `slip`."""
    return max(float(np.median(np.diff(np.unique(slip)))), 1e-3 * float(slip.max()))


def _guess_slip(slip: np.ndarray, value: np.ndarray, weight: np.ndarray, free_e: bool, ceiling: float) -> np.ndarray:
    """Starts (`STARTS`, 4 or 5) of a curve over slip [mm]: a grid of rates, for which it is linear in a, a c, a e."""
    stroke, spacing = float(slip.max()), _find_spacing(slip)
    falling = -np.geomspace(0.2 / stroke, 3.0 / spacing, 16)
    rates = np.concatenate([falling, np.geomspace(0.3 / stroke, min(3.0 / spacing, 40.0 / stroke), 8)])
    rates = rates[rates < ceiling - 1e-3 / stroke]
    found = []
    for fast in rates:
        for slow in rates[rates > fast]:
            up, down = np.exp(slow * slip), np.exp(fast * slip)
            basis = [1.0 + 0 * up, up, down] if free_e else [1.0 - 0.5 * (up + down), 0.5 * (up - down)]
            columns = np.stack(basis, axis=1) * weight[:, None]
            norms = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
            share = np.linalg.lstsq(columns / norms, value * weight, rcond=1e-10)[0] / norms
            misfit = float(np.sum((columns @ share - value * weight) ** 2))
            a = share[0] if abs(share[0]) > 1e-6 else 1e-6
            last = [(share[1] - share[2]) / a, -(share[1] + share[2]) / a] if free_e else [share[1] / a]
            if np.isfinite(misfit):
                found.append((misfit, [a, 0.5 * (slow + fast), last[0], 0.5 * (slow - fast), *last[1:]]))
    found.sort(key=lambda item: item[0])
    return np.array([start for _, start in found[:STARTS]])


def _guess_polynomials(curve: _SlipPolynomials, fits: list[tuple[float, np.ndarray, np.ndarray]]) -> np.ndarray:
    """Polynomials to start from, shape (`STARTS`, coefficients), out of loads [N], a...d (e) and information at each.

    Each of those has d > 0, while the polynomial of d may change sign between two loads: a start for every such place.
    """
    kept = [fit for fit in fits if abs(fit[1][2]) < RUNAWAY]  # a runaway c has d = 0
    kept = kept if len(kept) >= 3 else fits
    modest = np.diag(np.square(MODEST[:len(kept[0][1])]))  # their own is far too small away from the minimum
    starts = []
    for turn in np.unique(np.linspace(1, len(kept), STARTS).round().astype(int)):
        left, right = 0.0, 0.0
        for k, (load, centre, information) in enumerate(kept):
            sign = np.ones(len(centre))
            sign[2:4] = 1.0 if k < turn else -1.0
            powers = curve.spread(np.array(load)) * sign[:, None]
            floor = 1e-12 * np.diag(np.diag(information) + 1e-12)
            weight = np.linalg.inv(np.linalg.inv(information + floor) + modest)
            left = left + powers.T @ weight @ powers
            right = right + powers.T @ weight @ centre
        scale = np.sqrt(np.diag(left))
        starts.append(np.linalg.lstsq(left / np.outer(scale, scale), right / scale, rcond=1e-9)[0] / scale)
    return np.array(starts + starts[-1:] * (STARTS - len(starts)))


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
        slip, force, sd = _check_readings(slip, force, sd, ("slip", "force", "sd"))
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
    load, curve = _check_positive(load, "the load [N]"), SLIP[bool(free_e)]
    record = SlipRecord.from_force(slip, friction, load, sd) if force else SlipRecord(slip, friction, load, sd)
    data, ((slips, value, weight),) = _stack([record], len(curve.names))
    ceiling = -1.0 / float(data.stroke[0]) if levels else math.inf
    data = _pick(data, 0, ceiling)
    spans = np.array([100 * np.abs(value).max(), 10 / _find_spacing(slips), 1e4, 14.0, 1e4])[:len(curve.names)]
    level = f"It is assumed, not found, that the curve levels off within the stroke (b + d < {ceiling:.2g} 1/mm)."
    fit = _Fitter(curve, data, f"the slip curve at {load:g} N").fit(
        _guess_slip(slips, value, weight, bool(free_e), ceiling), readings=len(slips),
        fixed={} if free_e else {"e": 1.0}, spans=spans if profile else None, unit="strokes",
        tests={"as many samples again in the first fifth of the stroke": data._replace(at=data.at / 5),
               "a stroke twice as long": data._replace(at=data.at * 2)},
        elsewhere=dict.fromkeys("bcde", "curves at other loads, tied to this one by Eq. 10's polynomials,"),
        notes=lambda p: [f"{SYMMETRY}.", *([level] if levels else []), *_describe_shape(p, free_e)])
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
    loads = [float(r.load) for r in records]
    if len(set(loads)) < 3:
        raise InputError("quadratic polynomials in the load need curves at three loads or more; there are "
                         f"{len(set(loads))}")
    single, curve = SLIP[bool(free_e)], POLYNOMIAL[bool(free_e)]
    data, parts = _stack(records, 3)
    fits = []
    for k, (load, part) in enumerate(zip(loads, parts, strict=True)):
        try:  # a curve that levels off; where none of those fits, one that need not
            for ceiling in (-1.0 / float(data.stroke[k]), math.inf):
                alone = _Fitter(single, _pick(data, k, ceiling), f"the slip curve at {load:g} N")
                fit = alone.settle(_guess_slip(*part, bool(free_e), ceiling))
                if _fits_noise(float(fit.chi2), len(part[0]) - len(single.names)):
                    break
        except ComputationError:
            continue  # a start is all that it would have been
        columns = alone.measure(fit.coefficients)[1]
        columns[:, 3] /= fit.coefficients[3]
        fits.append((load, fit.coefficients, columns.T @ columns))
    if len(fits) < 3:
        raise ComputationError("the polynomials have no starting values: fewer than three of the curves could be "
                               "fitted "
                               "alone")
    fit = _Fitter(curve, data, f"Eq. 10's polynomials from {loads[0]:g} to {loads[-1]:g} N").fit(
        _guess_polynomials(curve, fits), readings=sum(len(part[0]) for part in parts),
        fixed={} if free_e else {"e": 1.0}, spans=1e3 * np.array(curve.typical) if profile else None,
        tests={"as many curves at half the loads": data._replace(load=0.5 * data.load),
               "as many samples again in the first fifth of the strokes": data._replace(at=data.at / 5)},
        elsewhere={}, unit="sets of strokes",
        notes=lambda p: [f"{SYMMETRY}, at {loads[0]:g} N.",
                         f"These readings do not test the polynomials below {loads[0]:g} or above {loads[-1]:g} N."])
    beyond: dict[str, list[str]] = {}
    for load in dict.fromkeys(loads):
        beyond.setdefault(describe_range(load), []).append(f"{load:g} N")
    outside = [f"At {', '.join(at)} the load is outside the range of Eq. 10: {trouble}." for trouble, at in
               beyond.items()
               if trouble]
    return dc.replace(fit, notes=(*fit.notes, *outside))


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
    p, mu, dev = _check_readings(pressure, coefficient, sd, ("pressure", "coefficient", "sd"), least=1)
    _refuse_negative(p, "pressure")
    free, pressures = strength_ratio is None, len(np.unique(p))
    modulus = _check_positive(modulus, "modulus")
    ratio = 1.0 if strength_ratio is None else _check_positive(strength_ratio, "strength_ratio")
    curve = RUBBER[free]
    data = Readings(_pad(p), _pad(mu), _pad(1.0 / dev), ratio=jnp.asarray(ratio), modulus=jnp.asarray(modulus))
    loss = max(float(np.median(mu)), 1e-6) / (0.4 * ratio + 0.3 * (3 * float(np.median(p)) / modulus) ** (2 / 3))
    starts = np.array([[k, loss * share, ratio][: len(curve.names)] for k in (0.1, 1.0, 10.0) for share in (0.3, 1.5)])
    return _Fitter(curve, data, f"Eq. 8 at {pressures} pressure{'s' if pressures > 1 else ''}").fit(
        starts, readings=len(p), fixed={} if free else {RATIO: ratio}, unit="readings",
        spans=np.full(len(curve.names), 7.0) if profile else None,
        tests={"as many readings at twice the pressures": data._replace(at=2 * data.at),
               "as many readings at a quarter of the pressures": data._replace(at=data.at / 4)},
        elsewhere={"tan delta_L": "the loss factor from a rheometer",
                   RATIO: "sigma_0 from a tensile test and p_r from the real contact area"},
        notes=lambda p: [PRODUCT, *([ONE_PRESSURE] if pressures == 1 else [])])


def evaluate_polynomials(fit: CurveFit, load: float) -> tuple[np.ndarray, np.ndarray]:
    """a...d (e) at a load [N] by fitted polynomials, and their standard deviations, shapes (4 or 5,)."""
    assert isinstance(fit.curve, _SlipPolynomials)
    powers = fit.curve.spread(np.array(float(load)))
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
                     f"{weak} is {share:.2g} % of the other (c is close to {sign}e), so {strong} is well determined "
                     "but b and d individually are not.")
    if free_e:
        found.append("The friction at zero slip is a (1 - e) plus the part of Eq. 8: one curve cannot distinguish the "
                     "two; "
                     "strokes at several pressures would, as Eq. 8 depends on the pressure but e does not.")
    return found


def _check_positive(value, name: str) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = math.nan
    if not (math.isfinite(number) and number > 0):
        raise InputError(f"{name} must be a positive number; got {value}")
    return number


def _refuse_negative(x: np.ndarray, name: str) -> None:
    if np.any(x < 0):
        raise InputError(f"{name} must not be negative; number {int(np.argmax(x < 0)) + 1} is {x[x < 0][0]:g}")


def _stack(records: Sequence[SlipRecord], least: int
           ) -> tuple[Readings, list[tuple[np.ndarray, np.ndarray, np.ndarray]]]:
    """Records of so many samples at least as padded arrays, and slip [mm], coefficient and weight of each."""
    parts = []
    for record in records:
        slip, value, sd = _check_readings(record.slip, record.coefficient, record.sd, ("slip", "friction", "sd"),
                                          least=least)
        _refuse_negative(slip, "slip")
        if np.ptp(slip) == 0:
            raise InputError(f"all slips at {float(record.load):g} N are {slip[0]:g} m; a curve needs different slips")
        if slip.max() > 1.0:
            raise InputError(f"slip is in metres, and a stroke of {slip.max():g} m is implausible; are these "
                             f"millimetres?")
        parts.append((slip / SLIP_UNIT, value, 1.0 / sd))
    length = max(len(part[0]) for part in parts)
    slip, value, weight = (jnp.stack([_pad(part[k], length) for part in parts]) for k in range(3))
    loads, strokes = jnp.array([float(r.load) for r in records]), jnp.array([part[0].max() for part in parts])
    return Readings(slip * SLIP_UNIT, value, weight, loads, strokes, loads.min(), jnp.asarray(math.inf)), parts


def _pad(x, length: int = 0) -> Array:
    """Zeros behind, up to a multiple of `LENGTHS`."""
    size = -(-max(len(x), length) // LENGTHS) * LENGTHS
    return jnp.asarray(np.concatenate([x, np.zeros(size - len(x))]))


def _pick(data: Readings, k: int, ceiling: float) -> Readings:
    """One curve of several, below a ceiling of its rates [1/mm]."""
    return data._replace(at=data.at[k], value=data.value[k], weight=data.weight[k], load=data.load[k],
                         stroke=data.stroke[k], ceiling=jnp.asarray(ceiling))
