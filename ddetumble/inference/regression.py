r"""Least squares of any curve: values with standard errors as certified ones are computed, to rounding where possible.

Levenberg-Marquardt of optimistix goes down from the start twice, once with damping in the parameters' own units and
once in units of their start, as each fails where the other does not; the smaller sum of squares counts. Gauss-Newton
steps on columns of unit norm then go on until rounding stops them.
"""

import dataclasses as dc
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array

from .._errors import ComputationError, InputError
from .files import make_plain


DAMPINGS = ("own units", "units of the start")
TOLERANCE = 1e-10  # of Levenberg-Marquardt, relative
MOST_STEPS = 3000  # of the same: curved valleys are long
MOST_POLISH = 100  # Gauss-Newton steps after it
PATIENCE = 3  # such steps without gain before they end
SETTLED = 1e-6  # of the scatter: a last step that changes the curve less has arrived
ROUNDING = 1e-13  # of the readings' size: likewise
EPS = float(np.finfo(float).eps)
FAINT = 1e5 * EPS  # scatter of this share of the readings is told to be near rounding
LOST = 1e-6  # component of a direction that changes nothing, above which a parameter is not determined


@dc.dataclass(frozen=True)
class Regression:
    """A curve fitted by least squares.

    Attributes:
        names: of the parameters.
        values: at the smallest sum of squares, shape (parameters,).
        errors: standard deviations of the values from the Jacobian there, infinite for what the readings do not
            determine, shape (parameters,).
        covariance: of the values, shape (parameters, parameters); nan between what is not determined and all else.
        sum_of_squares: of the residuals, over `sd` where that is given (chi-square).
        residual_sd: root of the sum of squares over the degrees of freedom; nan where there are none.
        degrees: of freedom, readings less parameters.
        steps: of Levenberg-Marquardt from the start with the damping that did better, and of polishing after it.
        damping: which one that was.
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

    def text(self) -> str:
        """A table for people, and how it ended."""
        rows = [f"  {name:12} {value:15.8g} +- {error:.3g}"
                for name, value, error in zip(self.names, self.values, self.errors, strict=True)]
        head = f"sum of squares {self.sum_of_squares:.8g} with {self.degrees} degrees of freedom"
        return "\n".join([head, *rows, self.message])

    def to_dict(self) -> dict[str, Any]:
        """As plain data for JSON; what is infinite or missing is null."""
        return make_plain(self)


def fit_curve(model: Callable[[Array, Array], Array], x, y, start: Mapping[str, float] | Sequence[float], sd=None
              ) -> Regression:
    r"""Minimise $\sum_i [(f(p, x_i) - y_i)/\sigma_i]^2$ over the parameters p, and say how well they are known.

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
    x, y, sd, begin, names = _check(x, y, sd, start)
    weights = 1.0 / (np.ones_like(y) if sd is None else sd)
    size = float(np.sqrt(np.mean((weights * y) ** 2))) or 1.0
    scaled = jnp.asarray(weights / size)  # so that the fit does not depend on the unit of the readings
    data = (jnp.asarray(x), jnp.asarray(y), scaled)
    struct = jax.eval_shape(model, jnp.asarray(begin), data[0])
    if getattr(struct, "shape", None) != y.shape:
        raise InputError(f"the model must return one number a reading, shape {y.shape}; it returns "
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
    return _conclude(place, names, size, sd is None, int(steps[best]) + polished, DAMPINGS[best])


class _Place(NamedTuple):
    """Parameters, residual, singular values of columns of unit norm, their axes, norms, next step and its size."""

    values: np.ndarray
    residual: np.ndarray
    singular: np.ndarray
    axes: np.ndarray
    norms: np.ndarray
    step: np.ndarray
    gain: float


@eqx.filter_jit
def _descend(model, start: Array, units: Array, x: Array, y: Array, weights: Array):
    """Levenberg-Marquardt with each of several units: parameters, sums of squares, steps."""
    def one(unit):
        found = optx.least_squares(
            lambda q, _: weights * (model(unit * q, x) - y), optx.LevenbergMarquardt(rtol=TOLERANCE, atol=1e-14),
            start / unit, max_steps=MOST_STEPS, throw=False)  # fmt: skip
        values = unit * found.value
        return values, jnp.sum((weights * (model(values, x) - y)) ** 2), found.stats["num_steps"]

    return jax.vmap(one)(units)


@eqx.filter_jit
def _linearise(model, values: Array, x: Array, y: Array, weights: Array):
    """Residual and its derivatives."""
    def rows(p):
        return weights * (model(p, x) - y)

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


def _conclude(place: _Place, names: tuple[str, ...], size: float, scale: bool, steps: int, damping: str) -> Regression:
    """Standard errors, and in words how the fit ended; sums of squares in units of `size` so far."""
    count, degrees = len(names), len(place.residual) - len(names)
    squares = float(place.residual @ place.residual)
    spread = math.sqrt(squares / degrees) if degrees else math.nan
    root = place.axes.T / np.where(place.singular > 0, place.singular, np.inf) / place.norms[:, None]
    covariance = root @ root.T * (spread**2 if scale else 1.0 / size**2)
    lost = np.any(np.abs(place.axes[place.singular == 0]) > LOST, axis=0)
    covariance[lost, :] = covariance[:, lost] = np.nan
    covariance[lost, lost] = np.inf
    settled = place.gain <= SETTLED * (spread if scale else 1.0 / size) + ROUNDING * math.sqrt(count)
    message = "Converged" if settled else f"Not converged after {steps} steps"
    message += f": one more step would change the curve by {place.gain * size:.2g} in all"
    if lost.any():
        message += f"; the readings do not determine {', '.join(n for n, out in zip(names, lost, strict=True) if out)}"
    elif scale and spread < FAINT:
        message += (f"; the scatter is {spread / EPS:.0f} times the rounding of the readings, and the standard errors "
                    f"that rest on it are good to about {max(0, round(math.log10(max(spread / EPS, 1.0))))} digits")
    return Regression(names, place.values, np.sqrt(np.diag(covariance)), covariance, squares * size**2, spread * size,
                      degrees, steps, damping, bool(settled and not lost.any()), message + ".")


def _check(x, y, sd, start):
    """Arguments as arrays of numbers that fit together, and the parameters' names."""
    names = tuple(map(str, start)) if isinstance(start, Mapping) else ()
    parts = {"x": x, "y": y, "start": list(start.values()) if isinstance(start, Mapping) else start}
    if sd is not None:
        parts["sd"] = sd
    for name, part in parts.items():
        try:
            parts[name] = np.asarray(part, dtype=float)
        except (TypeError, ValueError):
            raise InputError(f"{name} must be numbers") from None
    x, y, begin = parts["x"], parts["y"], parts["start"]
    if x.ndim not in (1, 2) or y.ndim != 1 or begin.ndim != 1 or not begin.size:
        raise InputError("y and start are lists of numbers, x is one too or several of y's length; they have the "
                         f"shapes {y.shape}, {begin.shape} and {x.shape}")
    names = names or tuple(f"p{k + 1}" for k in range(len(begin)))
    if x.shape[-1] != len(y):
        order = "; several predictors stand one a row" if x.ndim == 2 else ""
        raise InputError(f"x and y must be of one length; they are {x.shape[-1]} and {len(y)} long{order}")
    if sd is not None:
        if parts["sd"].shape not in ((), y.shape):
            raise InputError(f"sd must be one number or as many as y, which are {len(y)}; its shape is "
                             f"{parts['sd'].shape}")
        parts["sd"] = np.broadcast_to(parts["sd"], y.shape)
    for name, part in parts.items():
        good = np.isfinite(part)
        if not good.all():
            k = int(np.argmin(good)) % part.shape[-1]
            which = f"of {names[k]} " if name == "start" else f"number {k + 1} "
            raise InputError(f"{name} {which}is not a number")
    if sd is not None and np.any(parts["sd"] <= 0):
        k = int(np.argmax(parts["sd"] <= 0))
        raise InputError(f"sd must be positive; number {k + 1} is {parts['sd'][k]:g}")
    least = len(begin) + (1 if sd is None else 0)
    if len(y) < least:
        raise InputError(f"too few readings: {len(y)}, and {len(begin)} parameters need {least} at least"
                         + ("; standard errors from the scatter take one more" if sd is None else ""))
    return x, y, parts.get("sd"), begin, names
