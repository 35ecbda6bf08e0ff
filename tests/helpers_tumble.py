"""What the tests of tumbling records share: laws from the names of effects, and their motion."""

import jax
import jax.numpy as jnp
import numpy as np

from ddetumble.contact.effect import parameters_of
from ddetumble.contact.torque import RigidBody
from ddetumble.dynamics.spinning import START, count_steps, spin
from ddetumble.effects import TUMBLE


RATES = [0.05, 0.04, 0.11]
RUN = jax.jit(spin)


def make_law(ratio, effects, orbit_rate=0.00106):
    """The law of a body with effects by id, all others of the catalogue at their null."""
    found = []
    for effect in TUMBLE:
        values, own = {}, effects.get(effect.id, {})
        for p in parameters_of(effect):
            name, _, part = p.name.partition(".")
            if name in own:
                values[p.field] = own[name][int(part)] if part else own[name]
        found.append(effect(**values))
    return RigidBody(inertia_ratio=jnp.asarray(ratio), orbit_rate=jnp.asarray(orbit_rate)).extend(tuple(found))


def move(law, times, rates=RATES):
    """The motion from given rates at t = 0."""
    times = np.asarray(times, dtype=float)
    steps = count_steps(times[-1], float(np.linalg.norm(rates)), float(np.median(np.diff(times))))
    start = {name: jnp.asarray(float(w)) for name, w in zip(START, rates, strict=True)}
    return RUN(law, start, jnp.asarray(times), jnp.linspace(0.0, times[-1], steps + 1))
