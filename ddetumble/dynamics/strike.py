r"""One oblique impact on the bench: the ball strikes while it slides, slips, and may grip.

The plate's friction does not change the normal motion, so the tangential one is integrated over the finished contact,
by an implicit Runge-Kutta method of third order (three stages, L-stable; Alexander 1977) in equal steps. Each stage is
one equation for the slider's speed (`contact.gripping`), whatever the compliance: a rigid patch is no special case, and
none is so stiff that steps would have to shrink.
"""

import functools
from collections.abc import Mapping
from typing import final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.integrate import simpson

from .._numerics import stop
from ..contact.effect import Scalar
from ..contact.gripping import Patch, StrikeLaw, Striker, find_height, share_friction, solve_slider
from .entry import read_conditions, read_law, read_times, refuse_values
from .impact import ATOL, MAX_STEPS, RTOL, AbstractImpact, Course, follow, read_motion


INTERVALS = 160  # steps of the tangential motion over the contact: stick and slip change a few times in it
GAMMA = 0.43586652150845899942  # root of x**3 - 3 x**2 + 3 x/2 - 1/6
_MIDDLE = 0.5 * (1.0 + GAMMA)  # where the second stage is; the third is at the end of the step
_FIRST, _SECOND = -0.25 * (6.0 * GAMMA**2 - 16.0 * GAMMA + 1.0), 0.25 * (6.0 * GAMMA**2 - 20.0 * GAMMA + 5.0)
_NEXT = (_MIDDLE - GAMMA, _SECOND, GAMMA)  # weight of each stage's rate in what the next one starts from
NODES = 97  # at which the normal motion is read, over the contact: it is smooth, and read by interpolation


@final
class Strike(AbstractImpact):
    """Channels of one oblique impact at the wanted times, beside those of an impact, and where its energy went."""

    tangential_force: Float[Array, " times"]  # what the gauge reads, in the direction of motion [N]
    slip: Float[Array, " times"]  # of the patch over the plate since first touch, with its sign [m]
    tangential_speed: Scalar  # of the ball's centre along the plate at separation [m/s]
    rolling_speed: Scalar  # r omega at separation [m/s]
    arm_work: Scalar  # done by the arm during contact [J]
    normal_loss: Scalar  # taken by the contact [J]
    friction_loss: Scalar  # taken by the slider [J]
    rolling_loss: Scalar  # taken by rolling [J]
    stored: Scalar  # in the spring of the patch at separation [J]


@final
class Grip(eqx.Module):
    """The tangential motion of one impact."""

    force: Array  # of friction, against the motion, at the ends of the steps, shape (steps + 1,) [N]
    slip: Array  # of the slider, with its sign, at the ends of the steps, shape (steps + 1,) [m]
    speed: Array  # of the ball's centre, at the end [m/s]
    rolling: Array  # r omega, at the end [m/s]
    deflection: Array  # of the patch's spring, at the end [m]
    work: Array  # done against friction by the slider [J]
    braked: Array  # work done by the offset normal force against rolling [J]


@functools.cache
def _place_stages(intervals: int) -> np.ndarray:
    """Cubic interpolation from `NODES` equal places over 0..1 to the stages of every step, (3 * intervals, NODES)."""
    places = ((np.arange(intervals)[:, None] + np.array([GAMMA, _MIDDLE, 1.0])) / intervals).ravel()
    x = np.clip(places, 0.0, 1.0) * (NODES - 1)
    first = np.clip(np.floor(x).astype(int) - 1, 0, NODES - 4)
    u, matrix = x - first, np.zeros((len(places), NODES))
    for k in range(4):
        others = [j for j in range(4) if j != k]
        matrix[np.arange(len(places)), first + k] = np.prod([(u - j) / (k - j) for j in others], axis=0)
    return matrix


_COURSE = np.arange(NODES) / (NODES - 1.0)


def grip(law: StrikeLaw, conditions: Mapping[str, Array], diameter: Array, course: Course,
         intervals: int = INTERVALS) -> Grip:
    """The tangential motion over a finished contact, which `course` gives at `NODES` equal steps from first touch on.

    Conditions hold `tangential_speed` [m/s] at first touch and whatever the law reads; `diameter` is that of the
    undeformed ball [m].
    """
    reference = law.reference
    mass, rolling_mass, creep = reference.tangential_mass, reference.rolling_mass, reference.creep_speed
    mobility = 1.0 / mass + 1.0 / rolling_mass
    step = course.time[-1] / intervals
    to_stages = _place_stages(intervals)
    # Adhesion pulls: no friction then.
    depression, load = (jnp.maximum(to_stages @ x, 0.0) for x in (course.depression, course.normal_force))
    inputs = {"time": to_stages @ course.time, "depression": depression, "normal_force": load,
              "contact_radius": to_stages @ course.contact_radius, "height": find_height(diameter, depression),
              "pressure": to_stages @ course.pressure}
    reach = GAMMA * step

    def stage(patch: Patch, base: tuple, before: tuple) -> tuple[tuple, Array]:
        """Rates at the end of an implicit step of `reach` from `base`, and the force there.

        What friction limit and brake depend on is extrapolated by the rates `before`, those of the stage before.
        """
        along0, rolling0, deflection, _, path0, work0, _ = base
        rolling, path, work = (x + reach * before[k] for x, k in ((rolling0, 1), (path0, 4), (work0, 5)))
        brake = law.brake(patch) * share_friction(rolling, creep)
        limit = law.limit(patch, along0 + reach * before[0] - rolling, path, work)
        free = along0 - rolling0 + reach * brake / rolling_mass  # relative speed without friction
        speed = solve_slider((law.compliance(patch) + reach**2 * mobility) * limit, reach, deflection + reach * free,
                             creep)
        force = limit * share_friction(speed, creep)
        turn = (force - brake) / rolling_mass
        rolling = rolling0 + reach * turn
        slipping = along0 - reach * force / mass - rolling
        return (-force / mass, turn, slipping - speed, speed, jnp.abs(speed), force * speed, brake * rolling), force

    def advance(carry, here):
        base, held, before = carry
        values, weight, second = here
        rate, force = stage(Patch(**values, conditions=conditions), base, before)
        after = tuple(jnp.where(second, h, b) + step * weight * r for h, b, r in zip(held, base, rate, strict=True))
        kept = tuple(b + step * _FIRST * r for b, r in zip(base, rate, strict=True))
        return (after, kept, rate), (force, base[3] + reach * rate[3])

    zero = jnp.zeros(())
    speed = conditions["tangential_speed"]
    start, still = (speed, *(zero,) * 6), (zero, zero, zero, speed, jnp.abs(speed), zero, zero)
    # All stages by one program: `held` is the third stage's start without the second's rate.
    weights, seconds = np.tile(_NEXT, intervals), np.tile([False, True, False], intervals)
    (end, _, _), seen = jax.lax.scan(advance, (start, start, still), (inputs, weights, seconds))
    touch = Patch(zero, zero, course.contact_radius[0], find_height(diameter, zero), course.pressure[0],
                  jnp.maximum(course.normal_force[0], 0.0), conditions)
    rigid = law.compliance(touch) <= 0
    begin = jnp.where(rigid, law.limit(touch, speed, zero, zero) * share_friction(speed, creep), 0.0)
    force, slip = (jnp.concatenate([x[None], y[2::3]]) for x, y in zip((begin, zero), seen, strict=True))
    return Grip(force, slip, end[0], end[1], end[2], end[5], end[6])


def simulate_oblique_impact(law: StrikeLaw | Striker, conditions: Mapping[str, Array], times: Array, *,
                            span: Array | None = None, rtol: float | Array = RTOL, atol: float | Array = ATOL,
                            max_steps: int = MAX_STEPS, from_motion: bool = False) -> Strike:
    """Simulate one oblique impact until separation.

    Batch records with `jax.vmap`. Differentiable in both modes, through slip and grip.

    Args:
        law: of the oblique contact: `Striker(ball, friction)`, with `.extend(effects)`.
        conditions: `approach_speed`, `tangential_speed` [m/s], `initial_pressure` [Pa, absolute] and whatever the law
            reads, scalars.
        times: wanted times since first touch, ascending, shape (times,) [s]; may start before 0.
        span, rtol, atol, max_steps, from_motion: as of `simulate`, for the normal motion.

    Returns:
        A `Strike`; look at `failed` under `vmap`.

    Raises:
        InputError: The law is none of oblique impacts, a condition is missing, or a known value is no use.
    """
    law, gas = read_law(law, StrikeLaw, "a Striker(ball, friction), or one with .extend(effects)", "strike")
    conditions = read_conditions(conditions, ("approach_speed", "tangential_speed", *gas), "strike")
    times = read_times(times, "strike")
    refuse_values({"approach_speed": conditions["approach_speed"]} | {
        name: getattr(law.reference, name) for name in ("tangential_mass", "rolling_mass", "creep_speed")}, "strike")
    normal = law.normal
    last = stop(jnp.max(times) if span is None else span)
    motion = follow(normal, conditions, jnp.where(last > 0, last, 1.0), rtol, atol, max_steps)
    impact, course = read_motion(normal, conditions, times, motion, from_motion, _COURSE)
    assert course is not None
    moved = grip(law, conditions, motion.diameter, course)
    force, slip = _read_at(times, motion.end, moved.force), _read_at(times, motion.end, moved.slip)
    touch = (times > 0.0) & ((times < motion.end) | (~motion.separated & (times <= motion.end)))
    weights = simpson(np.eye(NODES), dx=1.0 / (NODES - 1)) * motion.end
    bad = ~jnp.isfinite(jnp.sum(moved.force) + jnp.sum(moved.slip))
    normal, tangential = law.read_axes(impact.normal_force, jnp.where(touch, force, 0.0))
    return Strike(
        **vars(impact) | {"normal_force": normal, "failed": impact.failed | bad}, tangential_force=tangential,
        slip=jnp.where(times > 0.0, slip, 0.0), tangential_speed=moved.speed, rolling_speed=moved.rolling,
        arm_work=jnp.sum(weights * course.drive * course.rate),
        normal_loss=jnp.sum(weights * course.normal_force * course.rate), friction_loss=moved.work,
        rolling_loss=moved.braked, stored=0.5 * moved.force[-1] * moved.deflection)


def _read_at(times: Array, end: Array, values: Array) -> Array:
    """Cubic interpolation between the steps, shape (times,); the last value after the end."""
    x = jnp.clip(times / end, 0.0, 1.0) * INTERVALS
    first = jnp.clip(jnp.floor(stop(x)).astype(int) - 1, 0, INTERVALS - 3)
    u = x - first
    y0, y1, y2, y3 = (values[first + k] for k in range(4))
    return (-(u - 1) * (u - 2) * (u - 3) / 6 * y0 + u * (u - 2) * (u - 3) / 2 * y1
            - u * (u - 1) * (u - 3) / 2 * y2 + u * (u - 1) * (u - 2) / 6 * y3)
