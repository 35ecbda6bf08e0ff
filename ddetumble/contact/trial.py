"""A trial impact in fixed steps: quick to compile, for checks of the law that need no accuracy."""

from collections.abc import Mapping

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .law import ContactLaw, Forces
from .signal import Signal


STEPS = 192  # of a trial impact, even


class Trial(eqx.Module):
    """One impact in fixed steps.

    Attributes:
        time: shape (nodes,) [s].
        depression, rate: of the ball, shape (nodes,) [m], [m/s].
        states: of the law's effects, shape (nodes, states).
        true_force: on the plate, shape (nodes,) [N].
        normal_force: what the gauge reads, shape (nodes,) [N].
        pressure: of the gas, shape (nodes,) [Pa].
        touching: whether the ball still touches at the end.
    """

    time: Float[Array, " nodes"]
    depression: Float[Array, " nodes"]
    rate: Float[Array, " nodes"]
    states: Float[Array, "nodes states"]
    true_force: Float[Array, " nodes"]
    normal_force: Float[Array, " nodes"]
    pressure: Float[Array, " nodes"]
    touching: Array


def try_impact(law: ContactLaw, conditions: Mapping[str, Array], span: Array) -> Trial:
    r"""Follow one impact by Heun's method in `STEPS` equal steps.

    Args:
        law: the contact law.
        conditions: of one record, scalars, SI.
        span: duration of the trial [s].
    """
    diameter, damping = law.start(conditions)
    step = span / STEPS

    def field(time, y):
        contact = law.contact(conditions, diameter, time, y[0], y[1], y[2:])
        forces = law.forces(contact, damping, y[2:])
        push = jnp.stack([y[1], (forces.drive - forces.normal) / law.reference.inertia()])
        return jnp.concatenate([push, law.rates(contact, y[2:])]), forces

    def advance(carry, time):
        y, touching = carry
        first, forces = field(time, y)
        second, _ = field(time + step, y + step * first)
        after = y + 0.5 * step * (first + second)
        left = touching & (after[0] > 0.0)
        seen = (y, jnp.where(touching, forces.normal, 0.0), forces.pressure)
        return (jnp.where(left, after, y.at[:2].set(0.0)), left), seen

    speed = conditions["approach_speed"]
    start = jnp.stack([jnp.zeros(()), speed, *[jnp.asarray(effect.initial()) for effect in law.stateful()]])
    time = step * jnp.arange(STEPS + 1)
    (_, touching), (path, force, pressure) = jax.lax.scan(advance, (start, jnp.asarray(True)), time)
    reading = read_gauge(law, force, step)
    return Trial(time, path[:, 0], path[:, 1], path[:, 2:], force, reading, pressure, touching)


def read_gauge(law: ContactLaw, force: Array, step: Array) -> Array:
    """What the gauge makes of a force [N] at the nodes, shape (nodes,) and odd: a parabola for every two steps [s]."""
    if not law.has_sensor():
        return force
    pairs = (len(force) - 1) // 2
    signal = Signal(jnp.full((pairs,), 2.0) * step, force[:-1:2], force[1::2], force[2::2])
    reading = law.reading(signal)
    inner = jnp.stack([reading.middle, reading.end], axis=1).reshape(-1)
    return jnp.concatenate([reading.start[:1], inner])


def evaluate_path(law: ContactLaw, conditions: Mapping[str, Array], trial: Trial) -> Forces:
    """Forces and pressure at the nodes of a trial, operation by operation, without compiling the law.

    Args:
        law: the contact law; the trial's states are those of its effects.
        conditions: of the record, scalars, SI.
        trial: where and how the ball moved.

    Returns:
        `Forces`, each entry shape (nodes,).
    """
    diameter, damping = law.start(conditions)

    def at(time, depression, rate, states):
        contact = law.contact(conditions, diameter, time, depression, rate, states)
        return law.forces(contact, damping, states)

    return jax.vmap(at)(trial.time, trial.depression, trial.rate, trial.states)
