"""One tumbling record: rates and attitude of a body under a law, on a mesh of even steps."""

from collections.abc import Callable, Mapping
from typing import final

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from .._rotation import from_rotation_vector, normalise, rotate_back, turn
from ..contact.torque import Spin, TumbleLaw


# Rad, by which a body turns at most in one step of the mesh: larger, the method of order 8 errs; smaller, it takes more
# steps.
STEP = 0.8
RATES = ("angular_velocity_x", "angular_velocity_y", "angular_velocity_z")
ATTITUDES = ("attitude_w", "attitude_x", "attitude_y", "attitude_z", *(f"attitude_{k}" for k in range(4)))
START = ("angular_velocity_x0", "angular_velocity_y0", "angular_velocity_z0")
START_ATTITUDE = ("attitude_x0", "attitude_y0", "attitude_z0")
_TABLEAU = dfx.Dopri8.tableau
_NODES, _WEIGHTS = np.asarray(_TABLEAU.c), np.asarray(_TABLEAU.b_sol)
_ROWS = np.zeros((_NODES.size, _WEIGHTS.size))  # of stages two to fourteen, by all stages
for _k, _row in enumerate(_TABLEAU.a_lower):
    _ROWS[_k, :_row.size] = _row


@final
class Spinning(eqx.Module):
    """Motion at the wanted times."""

    angular_velocity: Float[Array, "samples 3"]  # what the gyroscopes read, body components [rad/s]
    attitude: Float[Array, "samples 4"]  # unit quaternions, scalar first, body to inertial [-]
    body: Float[Array, "samples 3"]  # true angular velocity, body components [rad/s]
    # that of the inner bodies, body components, shape (samples, inner bodies, 3) [rad/s]
    inner: Float[Array, "samples bodies 3"]
    failed: Bool[Array, ""]  # whether any value is not finite


def count_steps(duration: float, fastest: float, interval: float) -> int:
    """Steps of a mesh on which a record is integrated to far below its noise.

    Of its duration [s], the largest angular speed [rad/s] and the interval between samples [s]: a step is no longer
    than three of these, unless that were more than 256 steps.
    """
    longest = min(STEP / max(fastest, 1e-300), max(3.0 * interval, duration / 256))
    return max(int(np.ceil(duration / longest - 1e-9)), 1)


def spin(law: TumbleLaw, conditions: Mapping[str, Array], time: Array, mesh: Array) -> Spinning:
    r"""Integrate $\dot\omega$ of the law and $\dot q = \frac12 q \otimes \omega$ from t = 0.

    Dormand and Prince's method of order 8 with even steps, and quintic Hermite interpolation between them: with steps
    of 0.8 rad the error stays below 1e-6 of the rates. Batch records with `jax.vmap`. Differentiable in
    both modes.

    Args:
        law: body and effects.
        conditions: true rates at t = 0, body components, `angular_velocity_x0`, `_y0`, `_z0` [rad/s], and whatever the
            law reads, scalars; `attitude_x0`, `_y0`, `_z0`, the rotation vector of the attitude at t = 0, is zero where
            it is not given [rad].
        time: since t = 0, shape (samples,) [s].
        mesh: even times from 0 on, shape (steps + 1,) [s]; see `count_steps`.

    Returns:
        A `Spinning`.
    """
    start = jnp.stack([conditions[name] for name in START])
    offset = jnp.stack([conditions.get(name, jnp.zeros(())) for name in START_ATTITUDE])
    moments, rate = law.moments(), law.reference.orbit_rate
    first = jnp.concatenate([start, from_rotation_vector(offset), jnp.ravel(law.start(start))])

    def field(t: Array, y: Array) -> Array:
        omega, attitude, inner = y[:3], y[3:7], y[7:].reshape(-1, 3)
        orbit = jnp.stack([jnp.cos(rate * t), jnp.sin(rate * t), jnp.zeros_like(t)])
        seen = Spin(t, omega, attitude, rotate_back(attitude, orbit), moments, rate, conditions, jnp.zeros(3))
        change, others = law.accelerate(seen, inner)
        return jnp.concatenate([change, turn(attitude, omega), jnp.ravel(others)])

    step = (mesh[-1] - mesh[0]) / (mesh.shape[0] - 1)
    values, slopes, bends = _integrate(field, first, mesh, step)
    place = jnp.clip(jnp.floor((time - mesh[0]) / step).astype(int), 0, mesh.shape[0] - 2)
    share = ((time - mesh[0]) / step - place)[:, None]
    # Each part by itself, so that the compiler leaves out what nobody reads.
    omega, attitude, inner = (_interpolate(values[:, part], slopes[:, part] * step, bends[:, part] * step**2, place,
                                           share) for part in (slice(0, 3), slice(3, 7), slice(7, None)))
    return Spinning(law.read(omega, time), normalise(attitude), omega, inner.reshape(time.size, -1, 3),
                    ~(jnp.all(jnp.isfinite(values)) & jnp.all(jnp.isfinite(omega))))


def _integrate(field: Callable[[Array, Array], Array], first: Array, mesh: Array, step: Array
               ) -> tuple[Array, Array, Array]:
    """States, their first and second derivatives at the mesh, each shape (steps + 1, states)."""
    def bend(t, y):
        slope = field(t, y)
        return slope, jax.jvp(field, (t, y), (jnp.ones_like(t), slope))[1]

    def advance(y, t):
        def add(stages, stage):
            node, row, here = stage
            slope = field(t + node * step, y + step * (row @ stages))
            return stages.at[here].set(slope), None

        slope, curve = bend(t, y)
        # One stage after the other in a loop: written out, fourteen copies of the law took a minute to compile.
        stages = jnp.zeros((_WEIGHTS.size, y.size)).at[0].set(slope)
        stages, _ = jax.lax.scan(add, stages, (_NODES, _ROWS, np.arange(1, _WEIGHTS.size)))
        return y + step * (_WEIGHTS @ stages), (y, slope, curve)

    last, (values, slopes, bends) = jax.lax.scan(advance, first, mesh[:-1])
    slope, curve = bend(mesh[-1], last)
    return (jnp.concatenate([values, last[None]]), jnp.concatenate([slopes, slope[None]]),
            jnp.concatenate([bends, curve[None]]))


def _interpolate(values: Array, slopes: Array, bends: Array, place: Array, s: Array) -> Array:
    """Quintic Hermite interpolation; slopes and bends in units of the step, shapes (nodes, states)."""
    s2, s3 = s * s, s * s * s
    s4, s5 = s2 * s2, s2 * s3
    rise = 10.0 * s3 - 15.0 * s4 + 6.0 * s5
    return (values[place] * (1.0 - rise) + values[place + 1] * rise
            + slopes[place] * (s - 6.0 * s3 + 8.0 * s4 - 3.0 * s5)
            + slopes[place + 1] * (-4.0 * s3 + 7.0 * s4 - 3.0 * s5)
            + 0.5 * bends[place] * (s2 - 3.0 * s3 + 3.0 * s4 - s5)
            + 0.5 * bends[place + 1] * (s3 - 2.0 * s4 + s5))
