r"""One oblique impact on the bench: the ball strikes while it slides, slips, and may grip.

The plate's friction does not change the normal motion, so the tangential one is integrated over the finished contact,
by an implicit Runge-Kutta method of third order (three stages, L-stable; Alexander 1977) in equal steps. Each stage is
one equation for the slider's speed (`contact.gripping`), whatever the compliance: a rigid patch is no special case, and
none is so stiff that steps would have to shrink.
"""

import functools
from collections.abc import Mapping

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from .._numerics import stop
from ..contact.effect import Scalar
from ..contact.gripping import Patch, StrikeLaw, height_of, lever, share_friction, solve_slider
from .impact import ATOL, MAX_STEPS, RTOL, Course, follow, read_motion


INTERVALS = 160  # steps of the tangential motion over the contact
GAMMA = 0.43586652150845899942  # root of x**3 - 3 x**2 + 3 x/2 - 1/6
_MIDDLE = 0.5 * (1.0 + GAMMA)  # where the second stage is; the third is at the end of the step
_FIRST, _SECOND = -0.25 * (6.0 * GAMMA**2 - 16.0 * GAMMA + 1.0), 0.25 * (6.0 * GAMMA**2 - 20.0 * GAMMA + 5.0)
_NEXT = (_MIDDLE - GAMMA, _SECOND, GAMMA)  # weight of each stage's rate in what the next one starts from
SWEEPS = 2  # of a stage: the friction limit depends a little on the motion that it helps to find
NODES = 97  # at which the normal motion is read, over the contact


class Strike(eqx.Module):
    """Channels of one oblique impact at the wanted times, and where its energy went.

    Attributes:
        normal_force: what the gauge reads, shape (times,) [N].
        tangential_force: on the plate, in the direction of motion, shape (times,) [N].
        slip: of the patch over the plate since first touch, with its sign, shape (times,) [m].
        depression: shape (times,) [m].
        depression_rate: shape (times,) [m/s]; 0 outside contact.
        pressure: absolute, shape (times,) [Pa].
        separation: time of separation [s]; the last wanted time where the ball still touches then.
        rebound_speed: of the ball away from the plate at separation [m/s].
        tangential_speed: of the ball's centre along the plate at separation [m/s].
        rolling_speed: r omega at separation [m/s].
        arm_work: done by the arm during contact [J].
        normal_loss, friction_loss, rolling_loss: what contact, slider and rolling took [J].
        stored: in the spring of the patch at separation [J].
        separated: whether separation was reached.
        failed: whether the integration failed (too many steps, or not finite).
        steps: integration steps taken along the normal.
    """

    normal_force: Float[Array, " times"]
    tangential_force: Float[Array, " times"]
    slip: Float[Array, " times"]
    depression: Float[Array, " times"]
    depression_rate: Float[Array, " times"]
    pressure: Float[Array, " times"]
    separation: Scalar
    rebound_speed: Scalar
    tangential_speed: Scalar
    rolling_speed: Scalar
    arm_work: Scalar
    normal_loss: Scalar
    friction_loss: Scalar
    rolling_loss: Scalar
    stored: Scalar
    separated: Bool[Array, ""]
    failed: Bool[Array, ""]
    steps: Array


class Grip(eqx.Module):
    """The tangential motion at the ends of its steps, each shape (steps + 1,).

    Attributes:
        force: of friction, against the motion [N].
        speed: of the ball's centre [m/s].
        rolling: r omega [m/s].
        deflection: of the patch's spring [m].
        slip: of the slider, with its sign [m].
        path: slid, whichever way [m].
        work: done against friction by the slider [J].
        braked: work done by the offset normal force against rolling [J].
    """

    force: Array
    speed: Array
    rolling: Array
    deflection: Array
    slip: Array
    path: Array
    work: Array
    braked: Array


class _State(eqx.Module):
    speed: Array
    rolling: Array
    deflection: Array
    slip: Array
    path: Array
    work: Array
    braked: Array

    def plus(self, step: Array | float, rate: "_State") -> "_State":
        return jax.tree.map(lambda x, r: x + step * r, self, rate)


def _weights(places: np.ndarray, nodes: int) -> np.ndarray:
    """Cubic interpolation from `nodes` equal places in 0..1 as a matrix, shape (places, nodes)."""
    x = np.clip(places, 0.0, 1.0) * (nodes - 1)
    first = np.clip(np.floor(x).astype(int) - 1, 0, nodes - 4)
    u, matrix = x - first, np.zeros((len(places), nodes))
    for k in range(4):
        others = [j for j in range(4) if j != k]
        matrix[np.arange(len(places)), first + k] = np.prod([(u - j) / (k - j) for j in others], axis=0)
    return matrix


@functools.cache
def _place_stages(intervals: int) -> np.ndarray:
    """Interpolation from the nodes of a course to the stages of every step, shape (3 * intervals, nodes)."""
    stages = (np.arange(intervals)[:, None] + np.array([GAMMA, _MIDDLE, 1.0])) / intervals
    return _weights(stages.ravel(), NODES)


_COURSE = np.arange(NODES) / (NODES - 1.0)


def grip(law: StrikeLaw, conditions: Mapping[str, Array], diameter: Array, course: Course,
         intervals: int = INTERVALS) -> Grip:
    """The tangential motion over a finished contact.

    Args:
        law: of the oblique contact.
        conditions: `tangential_speed` [m/s] at first touch and whatever the law reads, scalars.
        diameter: of the undeformed ball [m].
        course: of the contact, at equal steps from first touch to separation, shape (nodes,) with `NODES` of them.
        intervals: steps over the contact.
    """
    reference = law.reference
    mass, rolling_mass, creep = reference.tangential_mass, reference.rolling_mass, reference.creep_speed
    mobility = 1.0 / mass + 1.0 / rolling_mass
    step = course.time[-1] / intervals
    to_stages = _place_stages(intervals)
    wanted = jax.tree.map(lambda x: to_stages @ x, course)
    positive = jnp.maximum(wanted.normal_force, 0.0)  # adhesion pulls: no friction then
    depression = jnp.maximum(wanted.depression, 0.0)
    patches = Patch(wanted.time, depression, wanted.contact_radius, height_of(diameter, depression), wanted.pressure,
                    positive, conditions)
    reach = GAMMA * step

    def stage(patch: Patch, base: _State, guess: Array) -> tuple[_State, Array, Array]:
        """Rates at the end of an implicit step of `reach` from `base`, force and relative speed there."""
        compliance = law.compliance(patch)
        most = lever(law.offset(patch), patch.height) * patch.normal_force
        relative, path, work, rolling = guess, base.path, base.work, base.rolling
        speed = force = brake = along = jnp.zeros(())
        for _ in range(SWEEPS):
            brake = most * share_friction(rolling, creep)
            free = base.speed - base.rolling + reach * brake / rolling_mass  # relative speed without friction
            limit = law.limit(patch, relative, path, work)
            speed = solve_slider((compliance + reach**2 * mobility) * limit, reach, base.deflection + reach * free,
                                 creep)
            force = limit * share_friction(speed, creep)
            relative = free - reach * mobility * force
            path, work = base.path + reach * jnp.abs(speed), base.work + reach * force * speed
            rolling = base.rolling + reach * (force - brake) / rolling_mass
            along = base.speed - reach * force / mass
        rate = _State(-force / mass, (force - brake) / rolling_mass, along - rolling - speed, speed, jnp.abs(speed),
                      force * speed, brake * rolling)
        return rate, force, relative

    def advance(carry, here):
        base, held, guess = carry
        patch, weight, second = here
        rate, force, relative = stage(patch, base, guess)
        origin = jax.tree.map(lambda kept, own: jnp.where(second, kept, own), held, base)
        after = base.plus(reach, rate)
        return (origin.plus(step * weight, rate), base.plus(step * _FIRST, rate), relative), (after, force)

    zero = jnp.zeros(())
    speed = conditions["tangential_speed"]
    start = _State(speed, zero, zero, zero, zero, zero, zero)
    spread = {k: jnp.broadcast_to(v, (3 * intervals,)) for k, v in conditions.items()}
    patches = eqx.tree_at(lambda p: p.conditions, patches, spread)
    # All stages by one program: `held` is the third stage's start without the second's rate.
    weights, seconds = np.tile(_NEXT, intervals), np.tile([False, True, False], intervals)
    _, (states, force) = jax.lax.scan(advance, (start, start, speed), (patches, weights, seconds))
    states, force = jax.tree.map(lambda x: x[2::3], (states, force))
    at_touch = jax.tree.map(lambda x: x[0], course)
    touch = Patch(zero, zero, at_touch.contact_radius, height_of(diameter, zero), at_touch.pressure,
                  jnp.maximum(at_touch.normal_force, 0.0), conditions)
    rigid = law.compliance(touch) <= 0
    begin = jnp.where(rigid, law.limit(touch, speed, zero, zero) * share_friction(speed, creep), 0.0)

    def join(first, rest):
        return jnp.concatenate([jnp.reshape(first, (1,)), rest])

    path = jax.tree.map(join, start, states)
    return Grip(join(begin, force), path.speed, path.rolling, path.deflection, path.slip, path.path, path.work,
                path.braked)


def strike(law: StrikeLaw, conditions: Mapping[str, Array], times: Array, *, span: Array | None = None,
           adjoint: dfx.AbstractAdjoint | None = None, rtol: float | Array = RTOL, atol: float | Array = ATOL,
           max_steps: int = MAX_STEPS, from_motion: bool = False) -> Strike:
    """Simulate one oblique impact until separation.

    Batch records with `jax.vmap`. Differentiable in both modes, through slip and grip.

    Args:
        law: of the oblique contact: `Striker(ball, friction).extend(effects)`.
        conditions: `approach_speed`, `tangential_speed` [m/s], `initial_pressure` [Pa, absolute] and whatever the law
            reads, scalars.
        times: wanted times since first touch, ascending, shape (times,) [s]; may start before 0.
        span, adjoint, rtol, atol, max_steps, from_motion: as of `simulate`, for the normal motion.

    Returns:
        A `Strike`; look at `failed` under `vmap`.
    """
    normal = law.normal
    last = stop(jnp.max(times) if span is None else span)
    motion = follow(normal, conditions, jnp.where(last > 0, last, 1.0), adjoint, rtol, atol, max_steps)
    impact, course = read_motion(normal, conditions, times, motion, from_motion, _COURSE)
    assert course is not None
    moved = grip(law, conditions, motion.diameter, course)
    force, slip = _read_at(times, motion.end, moved.force), _read_at(times, motion.end, moved.slip)
    touch = (times > 0.0) & ((times < motion.end) | (~motion.separated & (times <= motion.end)))
    weights = _simpson(NODES) * motion.end
    bad = ~jnp.isfinite(jnp.sum(moved.force) + jnp.sum(moved.slip))
    return Strike(
        impact.normal_force, jnp.where(touch, force, 0.0), jnp.where(times > 0.0, slip, 0.0), impact.depression,
        impact.depression_rate, impact.pressure, impact.separation, impact.rebound_speed, moved.speed[-1],
        moved.rolling[-1], jnp.sum(weights * course.drive * course.rate),
        jnp.sum(weights * course.normal_force * course.rate), moved.work[-1], moved.braked[-1],
        0.5 * moved.force[-1] * moved.deflection[-1], impact.separated, impact.failed | bad, impact.steps)


def _read_at(times: Array, end: Array, values: Array) -> Array:
    """Cubic interpolation between the steps, shape (times,); the last value after the end."""
    x = jnp.clip(times / end, 0.0, 1.0) * INTERVALS
    first = jnp.clip(jnp.floor(stop(x)).astype(int) - 1, 0, INTERVALS - 3)
    u = x - first
    y0, y1, y2, y3 = (values[first + k] for k in range(4))
    return (-(u - 1) * (u - 2) * (u - 3) / 6 * y0 + u * (u - 2) * (u - 3) / 2 * y1
            - u * (u - 1) * (u - 3) / 2 * y2 + u * (u - 1) * (u - 2) / 6 * y3)


def _simpson(count: int) -> np.ndarray:
    """Weights of Simpson's rule on equal steps over 0..1, an odd number of places."""
    weights = np.where(np.arange(count) % 2 == 1, 4.0, 2.0)
    weights[[0, -1]] = 1.0
    return weights / (3.0 * (count - 1))
