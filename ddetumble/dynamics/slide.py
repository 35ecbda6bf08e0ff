"""One slip record: friction force along a given path, with the friction work that it takes."""

from collections.abc import Mapping
from typing import final

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from .._numerics import map_samples
from ..contact.effect import Scalar
from ..contact.sliding import FrictionLaw, Slide


SUBSTEPS = 2  # of the Runge-Kutta method between two samples: friction states change over many samples, so that two do


@final
class Friction(eqx.Module):
    """Friction along a path."""

    tangential_force: Float[Array, " samples"]  # against the motion where `direction` is 1 [N]
    work: Float[Array, " samples"]  # done against friction since the record began [J]
    failed: Bool[Array, ""]  # whether any value is not finite


def simulate_sliding(law: FrictionLaw, conditions: Mapping[str, Array], slip: Array, direction: Array | None = None,
          time: Array | None = None) -> Friction:
    r"""Friction force along a path, $f(s, W)$ with $dW/ds = |f|$, $W = 0$ where the record begins.

    Batch records with `jax.vmap`. Differentiable in both modes. The work is integrated from sample to sample by the
    classical Runge-Kutta method with two steps each: halving the spacing divides its error by 16.

    Args:
        law: the friction law.
        conditions: `normal_load` [N] and whatever the law reads (`internal_pressure` [Pa], `slip_speed` [m/s]),
            scalars.
        slip: distance slid since the stroke began, shape (samples,) [m]; it falls, or `direction` turns, where a new
            stroke begins; the sample at a turning point belongs to the stroke that ends there.
        direction: +1 or -1 by sample, the sign of the force (default: +1).
        time: since the record began, shape (samples,) [s] (default: path over slip speed).

    Returns:
        A `Friction`.
    """
    slip = jnp.maximum(slip, 0.0)
    before = jnp.concatenate([jnp.zeros((1,)), slip[:-1]])
    way = jnp.ones_like(slip) if direction is None else direction
    turned = way != jnp.concatenate([way[:1], way[:-1]])
    begins = jnp.where((slip >= before) & ~turned, before, 0.0)
    speed = conditions.get("slip_speed", jnp.zeros(()))
    if time is None:
        path = jnp.cumsum(slip - begins)
        time = jnp.where(speed > 0, path / jnp.where(speed > 0, speed, 1.0), 0.0)

    constants = law, conditions, speed

    def advance(work, ends):
        start, end, *rest = ends
        step = (end - start) / SUBSTEPS
        for k in range(SUBSTEPS):
            at = start + k * step
            k1 = jnp.abs(_force(constants, at, work, *rest))
            k2 = jnp.abs(_force(constants, at + 0.5 * step, work + 0.5 * step * k1, *rest))
            k3 = jnp.abs(_force(constants, at + 0.5 * step, work + 0.5 * step * k2, *rest))
            k4 = jnp.abs(_force(constants, at + step, work + step * k3, *rest))
            work = work + step / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        return work, work

    _, work = jax.lax.scan(advance, jnp.zeros(()), (begins, slip, time, way))
    signed = way * map_samples(lambda x: _force(constants, *x), (slip, work, time, way))
    return Friction(signed, work, ~jnp.all(jnp.isfinite(signed)))


@jax.jit
def _force(constants: tuple, distance: Array, work: Array, instant: Array, sign: Array) -> Scalar:
    """Friction force at one place. Compiled on its own: it is asked for in many places, and traced once."""
    law, conditions, speed = constants
    return law.force(Slide(distance, speed, conditions["normal_load"],
                           conditions.get("internal_pressure", jnp.zeros(())), work, instant, sign, conditions))
