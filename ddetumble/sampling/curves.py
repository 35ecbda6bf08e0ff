"""Posteriors of curves: any residual in JAX, and fits of friction curves."""

import dataclasses as dc
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._errors import InputError
from ..inference.curve_results import CurveFit
from ..inference.profiles import Curve
from .checkpoint import digest
from .target import AbstractTarget


@final
@dc.dataclass(frozen=True, eq=False)
class CurveTarget(AbstractTarget):
    """Posterior of the coefficients of a curve with independent Gaussian errors.

    Attributes:
        rows: whitened residual of coordinates and data, in JAX; lives at the top of a module.
        data: whatever `rows` takes.
        weight: logarithm of a further factor of the prior, of coordinates and data; None for one.
        values: public values from coordinates and data; None where each coordinate gives its own.
        labels: number of the part to which every row belongs, shape (rows,); None where the curve is one part.
    """

    rows: Callable[[Array, Any], Array]
    data: Any
    weight: Callable[[Array, Any], Array] | None = None
    values: Callable[[Array, Any], Array] | None = None
    labels: np.ndarray | None = None

    def prior(self, x: np.ndarray) -> np.ndarray:
        """As the base class has it, times the further factor."""
        total = super().prior(x)
        return total if self.weight is None else total + np.asarray(_map(self.weight, jnp.asarray(x), self.data))

    def likelihoods(self, x: np.ndarray) -> np.ndarray:
        """As the base class has it, with densities of whitened readings; parts are those of `labels`."""
        if self.labels is None:
            return np.asarray(_square(self.rows, jnp.asarray(x), self.data, None, 1))
        constant = -0.5 * np.log(2 * np.pi) * np.bincount(self.labels, minlength=len(self.parts))
        return np.asarray(_square(self.rows, jnp.asarray(x), self.data, jnp.asarray(self.labels),
                                  len(self.parts))) + constant

    def publish(self, x: np.ndarray) -> np.ndarray:
        """As the base class has it."""
        if self.values is None:
            return super().publish(x)
        flat = jnp.asarray(x).reshape(-1, np.shape(x)[-1])
        return np.asarray(_map(self.values, flat, self.data)).reshape(np.shape(x))


@eqx.filter_jit
def _square(rows, x: Array, data: Any, labels: Array | None, count: int) -> Array:
    value = jax.vmap(lambda one: -0.5 * rows(one, data) ** 2)(x)
    if labels is None:
        value = value.sum(axis=1, keepdims=True)
    else:
        value = jnp.zeros((x.shape[0], count)).at[:, labels].add(value)
    return jnp.where(jnp.isfinite(value), value, -jnp.inf)


@eqx.filter_jit
def _map(function, x: Array, data: Any) -> Array:
    return jax.vmap(lambda one: function(one, data))(x)


def pose_curve(rows: Callable[[Array, Any], Array], data: Any, names, centre, covariance, *, units=None,
               coordinates=None, bounds: Mapping[str, tuple[float, float]] | None = None,
               priors: Mapping[str, tuple[float, float]] | None = None, identity: Mapping[str, Any] | None = None,
               parts: Sequence[Any] | None = None) -> CurveTarget:
    """The posterior of a curve's coefficients.

    Args:
        rows: whitened residual, `rows(x, data)` with x of shape (free,), in JAX.
        data: an array or a tuple of them.
        names: of the coefficients.
        centre, covariance: of the coordinates by a fit.
        units, coordinates: of each coefficient; nothing and `linear` where not given.
        bounds: of coordinates by name.
        priors: Gaussian (mean, sd) of coordinates by name.
        identity: plain data that tells this target from others.
        parts: label of the part to which each row belongs, shape (rows,): what can be left out together.
    """
    names, count = tuple(names), len(names)
    low, high = np.full(count, -np.inf), np.full(count, np.inf)
    for name, (a, b) in (bounds or {}).items():
        low[names.index(name)], high[names.index(name)] = a, b
    centre, covariance = np.asarray(centre, dtype=float), np.asarray(covariance, dtype=float)
    if not np.all(np.isfinite(covariance)):
        raise InputError("the readings do not determine every coefficient, so that there is no posterior to draw from; "
                         "hold one of them, or give bounds and a finite covariance")
    known = ["curve"] if parts is None else list(dict.fromkeys(parts))
    labels = None if parts is None else np.array([known.index(one) for one in parts])
    return CurveTarget(names, tuple(units or ("",) * count), tuple(coordinates or ("linear",) * count), centre,
                       covariance, low, high, dict(priors or {}), tuple(map(str, known)), dict(identity or {}), (),
                       rows, data, labels=labels)


def pose_curve_fit(found: CurveFit) -> CurveTarget:
    """The posterior of a friction curve's coefficients; flat in these, in the logarithm of what is positive.

    It is sampled in the internal coordinates of the fit, in which valleys are straight, with the volume's change as a
    factor. The prior ends far outside the intervals of the profile likelihood, five of their widths away.

    Raises:
        InputError: The readings do not bound a coefficient, so that there is no posterior.
    """
    curve, data = found.curve, found.data
    loose = [p.name for p in found.profiles if not all(p.bounded)]
    if loose or not found.profiles:
        why = f"the readings do not bound {', '.join(loose)}" if loose else "the fit was made without profiles"
        raise InputError(f"there is no posterior to draw from: {why}; hold what is loose, or add readings")
    with np.errstate(divide="ignore"):
        low, high = (_take_logs(curve, np.array(ends)) for ends in ([p.low for p in found.profiles],
                                                                    [p.high for p in found.profiles]))
    box = np.stack([low - 5.0 * (high - low), high + 5.0 * (high - low)])
    centre = np.asarray(curve.fold(jnp.asarray(found.values), data))
    columns = np.asarray(jax.jacfwd(lambda x: _whiten(curve, x, data))(jnp.asarray(centre)))
    norms = np.linalg.norm(columns, axis=0)
    covariance = np.linalg.pinv((columns / norms).T @ (columns / norms), rcond=1e-12) / np.outer(norms, norms)
    values = np.concatenate([np.ravel(np.asarray(leaf)) for leaf in jax.tree.leaves(data)])
    made = pose_curve(partial(_whiten, curve), data, curve.names, centre, covariance, units=curve.units,
                      identity={"title": found.subject, "fixed": dict(found.fixed), "data": digest(values.tolist())})
    box = jnp.asarray(box)
    return dc.replace(made, weight=partial(_weigh_box, curve, box), values=partial(_unfold, curve), notes=(
        "the prior is flat in each coefficient, in the logarithm of what is positive",))


def _take_logs(curve: Curve, values: np.ndarray) -> np.ndarray:
    logs = np.array(curve.logs)
    return np.where(logs, np.log(np.where(logs, values, 1.0)), values)


def _unfold(curve: Curve, x: Array, data: Any) -> Array:
    return curve.unfold(x, jnp.asarray(-1), jnp.asarray(0.0), data)


def _whiten(curve: Curve, x: Array, data: Any) -> Array:
    return curve.predict(_unfold(curve, x, data), data)


def _weigh_box(curve: Curve, box: Array, x: Array, data: Any) -> Array:
    """Change of volume from internal coordinates to those in which the prior is flat; nothing outside its box."""
    logs = jnp.asarray(curve.logs)

    def flat(x):
        p = _unfold(curve, x, data)
        return jnp.where(logs, jnp.log(jnp.where(logs, p, 1.0)), p)

    inside = jnp.all((flat(x) > box[0]) & (flat(x) < box[1]))
    return jnp.where(inside, jnp.linalg.slogdet(jax.jacfwd(flat)(x))[1], -jnp.inf)
