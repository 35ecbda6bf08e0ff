"""Trials of the tangential laws on prescribed courses: quick to compile, for checks that need no accuracy."""

from collections.abc import Mapping

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .gripping import Patch, StrikeLaw, find_height, share_friction, solve_slider
from .sliding import FrictionLaw, Slide


STEPS = 48
_SLIP = np.linspace(0.0, 0.012, 49)


def stroke(law: FrictionLaw, conditions: Mapping[str, Array]) -> Array:
    """Force of a forward and a backward stroke [N]; the work is what 5 N would have done, shape (2 * slips,)."""
    def force(slip, direction):
        speed = conditions.get("slip_speed", jnp.zeros(()))
        return law.force(Slide(slip, speed, conditions["normal_load"],
                               conditions.get("internal_pressure", jnp.zeros(())), 5.0 * slip, slip / 0.1, direction,
                               conditions))

    return jnp.concatenate([jax.vmap(force, (0, None))(jnp.asarray(_SLIP), jnp.asarray(way)) for way in (1.0, -1.0)])


def try_patch(law: StrikeLaw, conditions: Mapping[str, Array]) -> Array:
    """Friction of a patch under half a sine of load (60 N, 30 ms), by backward Euler, shape (steps,) [N]."""
    reference = law.reference
    mobility = 1.0 / reference.tangential_mass + 1.0 / reference.rolling_mass
    step = jnp.asarray(0.03 / STEPS)
    diameter = reference.ball.diameter()

    def advance(state, share):
        relative, rolling, spring, path, work = state
        wave = jnp.sin(jnp.pi * share)
        depression = 0.005 * wave
        pressure = conditions.get("initial_pressure", jnp.zeros(()))
        patch = Patch(0.03 * share, depression, jnp.pi / 4 * depression, find_height(diameter, depression), pressure,
                      60.0 * wave, conditions)
        limit = law.limit(patch, relative, path, work)
        brake = law.brake(patch)
        brake = brake * share_friction(rolling, reference.creep_speed) / reference.rolling_mass
        braked = relative + step * brake
        speed = solve_slider((law.compliance(patch) + step**2 * mobility) * limit, step, spring + step * braked,
                             reference.creep_speed)
        force = limit * share_friction(speed, reference.creep_speed)
        after = braked - step * mobility * force
        spring, path = spring + step * (after - speed), path + step * jnp.abs(speed)
        rolling = rolling + step * (force / reference.rolling_mass - brake)
        return (after, rolling, spring, path, work + step * force * speed), force

    zero = jnp.zeros(())
    start = (conditions["tangential_speed"], zero, zero, zero, zero)
    return jax.lax.scan(advance, start, (jnp.arange(STEPS) + 1.0) / STEPS)[1]
