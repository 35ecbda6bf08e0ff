"""Peak force of simulated impacts: one compiled program for a reference model with every effect, at its null or not."""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._numerics import stop
from ..contact.effect import AbstractEffect
from ..contact.law import AbstractReference, ContactLaw
from ..dynamics.impact import Impact, simulate_impact
from ..inference.parameters import ParameterSpace


WINDOW = 0.27  # s, the paper's impact time: where the arm pushes on, the peak is sought up to here
SAMPLES = 128
CHUNK = 64  # impacts a call of the compiled program
DIRECTIONS = 4  # parameters that one model may free


def refine_peak(times: Array, values: Array) -> Array:
    """Maximum of a sampled curve: vertex of the parabola through the largest sample and its two neighbours.

    Args:
        times: ascending, any spacing, shape (times,) [s].
        values: shape (times,).

    Returns:
        The maximum, scalar; the largest sample itself where that is not an inner maximum. Differentiable with the
        samples that are used held fixed.
    """
    k = jnp.clip(jnp.argmax(stop(values)), 1, values.shape[0] - 2)
    t0, t1, t2 = times[k - 1], times[k], times[k + 1]
    f0, f1, f2 = values[k - 1], values[k], values[k + 1]
    left, right = (f1 - f0) / (t1 - t0), (f2 - f1) / (t2 - t1)
    bend = (right - left) / (t2 - t0)
    slope = left + bend * (t1 - t0)
    inner = (bend < 0) & (f1 >= f0) & (f1 >= f2)
    # Next to a jump (separation, a dashpot's onset) the parabola would overshoot: its step stays within half a sample.
    step = jnp.clip(jnp.where(inner, -slope / (2.0 * jnp.where(inner, bend, -1.0)), 0.0),
                    0.5 * (t0 - t1), 0.5 * (t2 - t1))
    return jnp.where(inner, f1 + slope * step + bend * step**2, jnp.maximum(f1, jnp.maximum(f0, f2)))


def peak_force(law: ContactLaw, conditions: Mapping[str, Array], window: Array) -> tuple[Array, tuple[Array, ...]]:
    """Largest force that the gauge reads in one impact [N], nan where the integration failed; beside it the time of
    separation [s] (the window where the ball still touches then), the ratio of rebound to approach speed [-] and the
    largest depression [m].

    Args:
        law: contact law.
        conditions: of the record, scalars, SI.
        window: time after first touch in which the peak is sought [s].
    """
    times = window * (jnp.arange(1, SAMPLES + 1) / SAMPLES) ** 2
    impact = simulate_impact(law, conditions, times, adjoint=dfx.ForwardMode(), rtol=1e-6, atol=1e-8, max_steps=160)
    peak = jnp.where(impact.failed, jnp.nan, refine_peak(times, impact.normal_force))
    return peak, (impact.separation, impact.rebound_speed / conditions["approach_speed"], jnp.max(impact.depression))


@eqx.filter_jit
def simulate_impacts(law: ContactLaw, conditions: Mapping[str, Any], times: Any) -> Impact:
    """Impacts at conditions of shape (records,), SI, each at the same times [s]: an `Impact` with a leading axis."""
    conditions = {name: jnp.asarray(value, dtype=float) for name, value in conditions.items()}
    return jax.vmap(lambda one: simulate_impact(law, one, jnp.asarray(times, dtype=float)))(conditions)


class PeakProgram:
    """Peaks of impacts, and their derivatives, for any values of the parameters of a reference model and its effects.

    Programs with equal parameter spaces share one compilation, whatever the number of records and models.

    Args:
        reference: template of the reference model.
        effects: classes of the effects that may be switched on.
        window: time in which the peak is sought [s].
    """

    def __init__(self, reference: AbstractReference, effects: Sequence[type[AbstractEffect]], window: float = WINDOW):
        self.space = ParameterSpace(reference, effects)
        self.window = float(window)
        self.start = self.space.coordinates()
        self.scale = self.space.scales()
        self.low, self.high = self.space.bounds()
        for k, slot in enumerate(self.space.slots):
            if slot.parameter.sign > 0:
                self.low[k] = max(self.low[k], slot.parameter.default)
            if slot.parameter.sign < 0:
                self.high[k] = min(self.high[k], slot.parameter.default)

    def place(self, values: Mapping[str, float]) -> np.ndarray:
        """Coordinates of all parameters with some values put in by name, shape (parameters,)."""
        return self.space.coordinates(values)

    def evaluate(self, x: np.ndarray, free: np.ndarray, conditions: Mapping[str, np.ndarray]) \
            -> tuple[np.ndarray, np.ndarray]:
        """Peaks and their derivatives by the free coordinates, for a batch of models on the same records.

        Args:
            x: coordinates, shape (batch, parameters).
            free: numbers of the free coordinates, shape (batch, DIRECTIONS); -1 for none.
            conditions: of the records, arrays of shape (records,), SI.

        Returns:
            Peaks, shape (batch, records) [N], and derivatives, shape (batch, records, DIRECTIONS) [N].
        """
        batch, records = len(x), len(next(iter(conditions.values())))
        owner, record = np.divmod(np.arange(batch * records), records)
        peaks, slopes = np.empty(batch * records), np.empty((batch * records, DIRECTIONS))
        for first in range(0, batch * records, CHUNK):
            take = np.minimum(np.arange(first, first + CHUNK), batch * records - 1)
            row = {name: np.asarray(value, dtype=float)[record[take]] for name, value in conditions.items()}
            some, slope, _ = _evaluate(_Key(self.space), x[owner[take]], free[owner[take]], row, self.window)
            kept = slice(first, min(first + CHUNK, batch * records))
            peaks[kept] = np.asarray(some)[: kept.stop - first]
            slopes[kept] = np.asarray(slope)[: kept.stop - first]
        return peaks.reshape(batch, records), slopes.reshape(batch, records, DIRECTIONS)

    def evaluate_contact(self, x: np.ndarray, conditions: Mapping[str, np.ndarray]) \
            -> tuple[np.ndarray, ...]:
        """Peaks [N], contact times [s], ratios of rebound to approach speed and largest depressions [m] of one model.

        Args:
            x: coordinates, shape (parameters,).
            conditions: of the records, arrays of shape (records,), SI.

        Returns:
            Four arrays of shape (records,).
        """
        records, parts = len(next(iter(conditions.values()))), []
        for first in range(0, records, CHUNK):
            take = np.minimum(np.arange(first, first + CHUNK), records - 1)
            row = {name: np.asarray(value, dtype=float)[take] for name, value in conditions.items()}
            peaks, _, others = _evaluate(_Key(self.space), np.tile(x, (CHUNK, 1)),
                                         np.full((CHUNK, DIRECTIONS), -1), row, self.window)
            parts.append(np.array([peaks, *others])[:, : records - first])
        return tuple(np.concatenate(parts, axis=1))


class _Key:
    """A parameter space as a static argument: equal ones (with the same structure) share a compilation."""

    def __init__(self, space: ParameterSpace):
        self.space = space

    def __hash__(self) -> int:
        return hash(self.space.key)

    def __eq__(self, other) -> bool:
        return isinstance(other, _Key) and self.space.key == other.space.key


@partial(jax.jit, static_argnums=0)
def _evaluate(key: _Key, x: Array, free: Array, conditions: Mapping[str, Array], window: Array):
    """Peaks, shape (impacts,), derivatives, shape (impacts, DIRECTIONS), and what `peak_force` gives beside."""
    basis = (free[:, :, None] == jnp.arange(x.shape[1])).astype(x.dtype)

    def one(x, directions, record):
        def peak(x):
            return peak_force(key.space.build(x), record, window)

        return jax.vmap(lambda d: jax.jvp(peak, (x,), (d,), has_aux=True), out_axes=(None, 0, None))(directions)

    return jax.vmap(one)(x, basis, conditions)
