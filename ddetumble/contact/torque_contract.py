"""The contract of an effect on tumbling records, proved by trial (see `contract`)."""

import dataclasses as dc
from collections.abc import Mapping, Sequence

import jax
import jax.numpy as jnp
from jaxtyping import Array

from .bench import prove, set_up
from .clauses import EffectReport
from .effect import AbstractEffect, AbstractModel
from .tangential_contract import CourseProof
from .torque import RigidBody, Spin, TumbleLaw


TIMES = 25
_CONDITIONS = {"x": (0.05, 0.02, -0.07), "y": (0.03, -0.06, 0.04), "z": (0.08, 0.05, -0.09),
               "sequence": (1.0, 4.0, 9.0)}  # fmt: skip


def check_tumble_effect(effect_class: type[AbstractEffect], name: str, reference: AbstractModel | None,
                        conditions: Mapping[str, Sequence[float]] | None) -> EffectReport:
    """The clauses of `contract.check_effect` for an effect on tumbling records.

    Conditions have to hold the rates at t = 0 as `x`, `y` and `z` [rad/s]; the orbit rate of the trials is 1e-3 rad/s
    where the body has none.
    """
    def make():
        model = RigidBody() if reference is None else reference
        if isinstance(model, RigidBody) and not float(model.orbit_rate):
            model = dc.replace(model, orbit_rate=jnp.asarray(1e-3))
        return CourseProof(set_up(effect_class, _Known(model), _CONDITIONS, conditions), turn_over)

    return prove(name, make)


class _Known:
    """A body in an orbit whose rate is known."""

    def __init__(self, body: AbstractModel):
        self.body, self.provides = body, (*body.provides, "orbit_rate")

    def extend(self, effects: tuple[AbstractEffect, ...]) -> TumbleLaw:
        """The body with effects."""
        return self.body.extend(effects)


def turn_over(law: TumbleLaw, conditions: Mapping[str, Array]) -> Array:
    """Readings and accelerations along a prescribed motion: quick to compile, for checks that need no accuracy.

    Args:
        law: body and effects.
        conditions: rates at t = 0 as `x`, `y`, `z` [rad/s], and whatever the law reads.

    Returns:
        Rates as the gyroscopes read them [rad/s], and angular accelerations times 100 s, shape (2 * times, 3).
    """
    start, moments = jnp.stack([conditions[axis] for axis in "xyz"]), law.moments()
    times = jnp.linspace(0.0, 500.0, TIMES)

    def push(time):
        turn = 0.03 * time
        across = jnp.stack([jnp.cos(turn) * start[0] - jnp.sin(turn) * start[1],
                            jnp.sin(turn) * start[0] + jnp.cos(turn) * start[1], start[2]])
        attitude = jnp.stack([jnp.cos(turn), 0.0 * turn, jnp.sin(turn), 0.0 * turn])
        up = jnp.stack([jnp.cos(turn), jnp.sin(turn) * 0.6, jnp.sin(turn) * 0.8])
        seen = Spin(time, across, attitude, up, moments, law.reference.orbit_rate, conditions, jnp.zeros(3))
        inner = 0.9 * law.start(start)
        # An inner body is seen after it has been pushed: only through it does the body feel the inner inertia.
        inner = inner + 100.0 * law.accelerate(seen, inner)[1]
        return across, 100.0 * law.accelerate(seen, inner)[0]

    rates, changes = jax.vmap(push)(times)
    return jnp.concatenate([law.read(rates, times), changes])
