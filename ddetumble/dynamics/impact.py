"""One impact on the bench: from first touch to separation, and what the channels read at given times."""

import functools
from collections.abc import Mapping
from typing import Any, final

import diffrax as dfx
import equinox as eqx
import equinox.internal as eqxi
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from .._numerics import map_samples, safe_divide, stop
from ..contact.effect import Scalar
from ..contact.law import AbstractReference, ContactLaw
from ..contact.signal import Signal
from .entry import read_conditions, read_law, read_times, refuse_values


CHANNELS = ("normal_force", "depression", "pressure")
RTOL, ATOL = 5e-8, 5e-10  # relative and absolute: errors far below the noise of any gauge; tighter only costs steps
MAX_STEPS = 256  # larger follows stiffer contacts before it gives up, at the price of memory


# Fractions of the contact, denser at its ends, and of the time after it, denser at separation, as sensors change there.
_CONTACT_GRID = 0.5 - 0.5 * np.cos(np.pi * np.arange(65) / 64)
# Method of Tsitouras: what each stage is made of, its time, and the error of a step. The last stage is the step's end.
_TABLEAU = dfx.Tsit5.tableau
_MIXED = np.stack([np.pad(row, (0, 7 - len(row))) for row in _TABLEAU.a_lower])
_REACH, _ERROR = np.asarray(_TABLEAU.c), np.asarray(_TABLEAU.b_error)
_TOGETHER = 8  # steps with derivatives between two looks at whether any are left: more look less, and waste more
_CLOSE, _TURNS = 1e-6, 8  # the end of contact is near enough, in units of the longest time, or looked for often enough
# Steps of the classical Runge-Kutta method and the rate after them: reach, weight, whether a step ends.
_SUBSTEPS = 8  # more are finer and slower
_STAGES = tuple(np.append(np.tile(column, _SUBSTEPS), 0.0) for column in (
    np.array([0, 0.5, 0.5, 1]), np.array([1, 2, 2, 1]) / 6.0, np.array([0, 0, 0, 1.0])))
_FORCE_GRID = np.concatenate([_CONTACT_GRID, 0.5 * (_CONTACT_GRID[1:] + _CONTACT_GRID[:-1])])
_TAIL_GRID = (np.arange(1, 25) / 24) ** 3


class AbstractImpact(eqx.Module):
    """Channels along the normal at the wanted times, of an impact whether straight or oblique."""

    normal_force: Float[Array, " times"]  # what the gauge reads [N]
    depression: Float[Array, " times"]  # [m]
    depression_rate: Float[Array, " times"]  # [m/s]; 0 outside contact
    pressure: Float[Array, " times"]  # absolute [Pa]
    separation: Scalar  # time of separation [s]; the last wanted time where the ball still touches then
    rebound_speed: Scalar  # speed at separation [m/s]
    separated: Bool[Array, ""]  # whether separation was reached
    failed: Bool[Array, ""]  # whether the integration failed (too many steps, or not finite)
    steps: Array  # integration steps taken along the normal


@final
class Impact(AbstractImpact):
    """Channels of one impact at the wanted times."""


@final
class _Path(eqx.Module):
    """Nodes of the solution in contact, with rates, for Hermite interpolation."""

    time: Array
    state: Array
    rate: Array


@final
class _Steps(eqx.Module):
    """The steps that one impact takes, constants of everything that comes after."""

    times: Array  # of the nodes in contact; infinite behind them [s]
    kept: Array  # number of the last of these
    end: Array  # about where the ball separates, or the last wanted time [s]
    separated: Array
    failed: Array
    tried: Array  # steps, with those that were too long


@final
class Motion(eqx.Module):
    """The normal motion of one impact."""

    path: _Path  # nodes of the solution
    end: Array  # time of separation, or of the last wanted time [s]
    final: Array  # state there: depression, its rate, the effects' own
    separated: Array  # as in `Impact`
    failed: Array
    steps: Array
    diameter: Array  # of the record, as `ContactLaw.start` gives them
    damping: Array


@final
class Course(eqx.Module):
    """What else moves in an impact needs to know of the contact, at given times, all of one shape."""

    time: Array  # since first touch [s]
    depression: Array  # of the ball [m]
    rate: Array  # of the depression [m/s]
    pressure: Array  # of the gas, absolute [Pa]
    normal_force: Array  # on the plate [N]
    contact_radius: Array  # b [m]
    drive: Array  # force of the arm towards the plate [N]


def _interpolate(path: _Path, time: Array) -> tuple[Array, Array, Array, Array]:
    """Depression, rate, acceleration and further states at one time: quintic for the depression, cubic for the rest."""
    k = jnp.clip(jnp.searchsorted(path.time, time, side="right") - 1, 0, path.time.shape[0] - 2)
    t0, t1 = path.time[k], path.time[k + 1]
    some = (t1 > t0) & jnp.isfinite(t1)
    h = jnp.where(some, t1 - t0, 1.0)
    u = jnp.where(some, (time - t0) / h, 0.0)

    def ends(column):
        first = column[k]
        return first, jnp.where(some, column[k + 1], first)

    x0, x1 = ends(path.state[:, 0])
    v0, v1 = (h * v for v in ends(path.state[:, 1]))
    a0, a1 = (h * h * a for a in ends(path.rate[:, 1]))
    # Quintic Hermite in powers of u.
    c2 = 0.5 * a0
    p, q, r = x1 - x0 - v0 - c2, v1 - v0 - a0, a1 - a0
    c3, c4, c5 = 10 * p - 4 * q + 0.5 * r, -15 * p + 7 * q - r, 6 * p - 3 * q + 0.5 * r
    depression = x0 + u * (v0 + u * (c2 + u * (c3 + u * (c4 + u * c5))))
    rate = (v0 + u * (2 * c2 + u * (3 * c3 + u * (4 * c4 + u * 5 * c5)))) / h
    acceleration = (2 * c2 + u * (6 * c3 + u * (12 * c4 + u * 20 * c5))) / (h * h)
    states = []
    for column in range(2, path.state.shape[1]):  # each on its own: the compiler drops those that nothing reads
        s0, s1 = ends(path.state[:, column])
        d0, d1 = (h * d for d in ends(path.rate[:, column]))
        jump = s1 - s0
        states.append(s0 + u * (d0 + u * (3 * jump - 2 * d0 - d1 + u * (d0 + d1 - 2 * jump))))
    return depression, rate, acceleration, jnp.stack(states) if states else jnp.zeros((0,))


def simulate_impact(
    law: ContactLaw | AbstractReference, conditions: Mapping[str, Array], times: Array, *, span: Array | None = None,
    rtol: float = RTOL, atol: float = ATOL, max_steps: int = MAX_STEPS, from_motion: bool = False,
) -> Impact:
    r"""Simulate one impact: $m_{eff}\,dw/dt = -F_n + F_{drive}$, $\delta(0) = 0$, $w(0) = v_1$, until $\delta = 0$.

    Batch records with `jax.vmap`. Differentiable in forward and reverse mode; the instant of separation follows the
    implicit-function theorem.

    Args:
        law: the contact law, or a reference model such as `Ball()` alone.
        conditions: `approach_speed` [m/s], `initial_pressure` [Pa, absolute] and whatever the law reads, scalars.
        times: wanted times since first touch, ascending, shape (times,) [s]; may start before 0.
        span: how long to integrate at most [s] (default: to the last wanted time).
        rtol, atol: tolerances of the integrator, in units of approach speed and span.
        max_steps: steps after which the solve counts as failed.
        from_motion: read the force off the interpolated acceleration, $F_n = F_{drive} - m_{eff}\,dw/dt$, not from
            the law at every wanted time: twice as fast, and good to about 1e-4 of the peak where the force breaks off
            shortly before separation, 3e-6 elsewhere.

    Returns:
        An `Impact`; look at `failed` under `vmap`.

    Raises:
        InputError: The law is none of impacts, a condition is missing, or a known value is no use.
    """
    law, gas = read_law(law, ContactLaw, "a ContactLaw(ball, effects), or a reference model such as Ball()", "simulate")
    conditions = read_conditions(conditions, ("approach_speed", *gas), "simulate")
    times = read_times(times, "simulate")
    refuse_values({"approach_speed": conditions["approach_speed"], "effective_mass": law.reference.inertia()},
                  "simulate")
    last = stop(jnp.max(times) if span is None else span)
    motion = follow(law, conditions, jnp.where(last > 0, last, 1.0), rtol, atol, max_steps)
    return read_motion(law, conditions, times, motion, from_motion)[0]


@eqx.filter_jit
def bound_depression(law: ContactLaw, conditions: Mapping[str, Array]) -> tuple[Array, Array]:
    r"""Depression that an impact does not exceed [m], without solving it, and the outer diameter $D$ [m].

    $\int_0^\delta F_k\,d\delta' = m_{eff} v_1^2/2$ of a ball without damping and of an arm that does not push; infinite
    where the work up to the whole diameter is less than the kinetic energy. The law's reference model has a diameter.
    """
    depths, work, energy, diameter = _lay_work(law, conditions)
    return jnp.interp(energy, work, depths, right=jnp.inf), diameter


def compare_energy(law: ContactLaw, conditions: Mapping[str, Array], share: float) -> Array:
    r"""Kinetic energy of an impact over the work that presses the ball together by a `share` of its diameter, without
    solving it: above one it may be pressed farther. Smooth in the conditions, unlike the depression of
    `bound_depression`, whose curve it reads.
    """
    depths, work, energy, diameter = _lay_work(law, conditions)
    return energy / jnp.interp(share * diameter, depths, work)


def _lay_work(law: ContactLaw, conditions: Mapping[str, Array]) -> tuple[Array, Array, Array, Array]:
    """Depressions up to the outer diameter [m], work up to each and kinetic energy [J], and the diameter [m]."""
    diameter, _ = law.start(conditions)
    depths = diameter * jnp.linspace(0.0, 1.0, 1025)
    force = jax.vmap(lambda depth: law.press(conditions, diameter, depth).elastic_force)(depths)
    work = jnp.concatenate([jnp.zeros(1), jnp.cumsum(0.5 * (force[1:] + force[:-1]) * jnp.diff(depths))])
    energy = 0.5 * law.reference.inertia() * conditions["approach_speed"] ** 2
    return depths, work, energy, diameter


def follow(law: ContactLaw, conditions: Mapping[str, Array], last: Array, rtol: float | Array = RTOL,
           atol: float | Array = ATOL, max_steps: int = MAX_STEPS) -> Motion:
    """Integrate one impact to separation, or to the time `last` [s]; arguments as of `simulate_impact`.

    The method of Tsitouras (2011), twice: values alone, which choose the steps, then the same steps with derivatives,
    so that these are the derivatives of what is computed. Either is one small program, where the general machinery of
    events and adjoints is a large one.
    """
    speed = conditions["approach_speed"]
    diameter, damping = law.start(conditions)
    mass = law.reference.inertia()
    first = law.contact(conditions, diameter, jnp.zeros(()), jnp.zeros(()), speed, jnp.zeros((len(law.stateful()),)))
    sizes = [jnp.asarray(effect.size(first)) for effect in law.stateful()]
    scale = stop(jnp.stack([speed * last, speed, *sizes]))
    start = jnp.concatenate([jnp.stack([jnp.zeros(()), speed]), law.begin_states()])
    constants = (diameter, damping, mass, conditions, law)
    known = jax.lax.stop_gradient(constants)
    taken = _choose_steps(lambda t, y: _rates(t, y, known), stop(start), last, scale, rtol, atol, max_steps)
    path = _retrace(lambda t, y: _rates(t, y, constants), start, taken)
    path, end, final = _separate(lambda t, y: _rates(t, y, constants), path, taken)
    return Motion(path, end, final, taken.separated, taken.failed, taken.tried, diameter, damping)


def _advance(field, time: Array, state: Array, slope: Array, step: Array) -> tuple[Array, Array]:
    """State after one step, and the slopes at its stages, shape (7, states), the last of which is that at its end."""
    def stage(carry, coefficients):
        slopes, _ = carry
        number, reach, mixed = coefficients
        reached = state + step * _mix(mixed, slopes)
        slope = field(time + reach * step, reached)
        return (jax.lax.dynamic_update_index_in_dim(slopes, slope, number, 0), reached), None

    slopes = jnp.concatenate([slope[None], jnp.zeros((6, state.shape[0]))])
    (slopes, reached), _ = jax.lax.scan(stage, (slopes, state), (np.arange(1, 7), _REACH, _MIXED))
    return reached, slopes


def _mix(weights: Array | np.ndarray, slopes: Array) -> Array:
    """Weighted sum of slopes; elementwise, as a product of matrices would break the loop into many programs."""
    return jnp.sum(weights[:, None] * slopes, axis=0)


def _choose_steps(field, start: Array, last: Array, scale: Array, rtol, atol, max_steps: int) -> _Steps:
    """Steps that keep the tolerances, until the depression ends or the time does; values alone."""
    def go_on(carry):
        time, _, (_, state), _, _, _, tried = carry
        return (time < last) & ~((time > 0) & (state[0] <= 0)) & (tried < max_steps)

    def step(carry):
        time, size, (before, state), slope, times, taken, tried = carry
        ending = time + size >= last
        size = jnp.where(ending, last - time, size)
        reached, slopes = _advance(field, time, state, slope, size)
        allowed = atol * scale + rtol * jnp.maximum(jnp.abs(state), jnp.abs(reached))
        # Half the root of the sum of squares: a state without error changes no step, as an effect at its null must not.
        error = 0.5 * jnp.sqrt(jnp.sum((size * _mix(_ERROR, slopes) / allowed) ** 2))
        good = error <= 1.0
        # The largest step that would have been good, less a tenth; NaN, which is not good either, asks for the least.
        growth = jnp.clip(0.9 * jnp.where(error > 1e-10, error, 1e-10) ** -0.2, 0.2, jnp.where(good, 10.0, 1.0))
        growth = jnp.where(jnp.isfinite(error), growth, 0.2)
        time = jnp.where(good, jnp.where(ending, last, time + size), time)
        taken = taken + good
        states = jnp.where(good, jnp.stack([state, reached]), jnp.stack([before, state]))
        return (time, size * growth, (states[0], states[1]), jnp.where(good, slopes[-1], slope),
                jax.lax.dynamic_update_index_in_dim(times, time, taken, 0), taken, tried + 1)

    times = jnp.full((max_steps + 1 + _SUBSTEPS,), jnp.inf).at[0].set(0.0)
    carry: Any = (jnp.zeros(()), 2e-3 * last, (start, start), field(jnp.zeros(()), start), times, 0, 0)
    time, _, (before, state), _, times, taken, tried = jax.lax.while_loop(go_on, step, carry)
    separated = (time > 0) & (state[0] <= 0)
    failed = ~(separated | (time >= last)) | ~jnp.all(jnp.isfinite(state))
    # The depression falls to zero within the last step: about where a line does, and closer by Newton steps, of which a
    # ball that barely comes off takes several.
    kept = jnp.maximum(taken - 1, 0)
    begin = times[kept]
    near = begin + safe_divide(before[0], before[0] - state[0]) * (time - begin)

    def closer(carry):
        near, _, turn = carry
        after, *_ = _approach_end(field, begin, before, near)
        moved = jnp.clip(near - safe_divide(after[0], after[1]), begin, time)
        return moved, jnp.abs(moved - near), turn + 1

    end, *_ = jax.lax.while_loop(lambda carry: separated & (carry[1] > _CLOSE * last) & (carry[2] < _TURNS), closer,
                                 (near, last, 0))
    end = jnp.where(separated, end, time)
    return _Steps(jnp.where(jnp.arange(times.shape[0]) <= kept, times, jnp.inf), kept, end, separated, failed, tried)


def _retrace(field, start: Array, taken: _Steps) -> _Path:
    """States and rates at the times of the steps that were chosen; behind the last one it stands still."""
    rows = taken.times.shape[0]
    blocks = -(-rows // _TOGETHER)
    times = jnp.concatenate([taken.times, jnp.full((blocks * _TOGETHER + 1 - rows,), jnp.inf)])
    most = eqxi.unvmap_max(taken.kept)  # of all records at once, so that what is not needed is not computed

    def step(carry, interval):
        state, slope = carry
        time, size = interval
        reached, slopes = _advance(field, time, state, slope, size)
        return (reached, slopes[-1]), (reached, slopes[-1])

    def some(carry, block):
        number, times, sizes = block
        return jax.lax.cond(number * _TOGETHER < most, lambda c: jax.lax.scan(step, c, (times, sizes)),
                            lambda c: (c, jax.tree.map(lambda x: jnp.zeros((_TOGETHER, *x.shape)), c)), carry)

    there = jnp.isfinite(times[1:])
    last = taken.times[taken.kept]
    begin = jnp.where(jnp.isfinite(times[:-1]), times[:-1], last).reshape(blocks, _TOGETHER)
    sizes = jnp.where(there, times[1:] - jnp.where(there, times[:-1], 0.0), 0.0).reshape(blocks, _TOGETHER)
    first = (start, field(jnp.zeros(()), start))
    _, found = jax.lax.scan(some, first, (np.arange(blocks), begin, sizes))
    nodes = [jnp.concatenate([x[None], y.reshape(-1, *x.shape)])[:rows] for x, y in zip(first, found, strict=True)]
    return _Path(taken.times, *nodes)


@jax.jit
def _rates(time, state, constants):
    """Rates of all states, SI. Compiled on its own: the integrator asks for it in many places, and traces it once."""
    diameter, damping, mass, conditions, law = constants
    contact = law.contact(conditions, diameter, time, state[0], state[1], state[2:])
    forces = law.forces(contact, damping, state[2:])
    acceleration = (forces.drive - forces.normal) / mass
    return jnp.concatenate([jnp.stack([state[1], acceleration]), law.rates(contact, state[2:])])


def _approach_end(field, begin: Array, base: Array, end: Array) -> tuple[Array, Array, tuple[Array, Array]]:
    """State at the time `end`, its rate, and both at the stages on the way, from the last node in contact.

    A step beyond separation would see where the law breaks off. A few of the classical Runge-Kutta method see the law,
    and its slopes, in contact only: depressions are kept above `floor`.
    """
    step, floor = (end - begin) / _SUBSTEPS, stop(1e-6 * base[0])

    def stage(carry, coefficients):
        time, base, total, slope = carry
        reach, weight, done = coefficients
        y = base + reach * step * slope
        y = y.at[0].add(jnp.where(y[0] > floor, 0.0, floor - stop(y[0])))
        slope = field(time + reach * step, y)
        total = total + weight * step * slope
        return (time + done * step, base + done * total, (1.0 - done) * total, slope), (y, slope)

    start = (begin, base, jnp.zeros_like(base), jnp.zeros_like(base))
    (_, after, _, rate), seen = jax.lax.scan(stage, start, _STAGES)
    return after, rate, seen


def _separate(field, path: _Path, taken: _Steps) -> tuple[_Path, Array, Array]:
    """Path, time and state at the end, with the way from the last step to it as nodes of their own.

    The force may break off shortly before separation. A Newton step takes the depression to zero, and carries the
    instant's derivative.
    """
    k = taken.kept
    begin, end = path.time[k], taken.end
    after, rate, (states, rates) = _approach_end(field, begin, path.state[k], end)
    correction = jnp.where(taken.separated, -safe_divide(after[0], after[1]), 0.0)
    final = jnp.where(taken.separated, after + correction * rate, after)
    new = k + 1 + jnp.arange(_SUBSTEPS)
    times = begin + (end - begin) * ((1.0 + jnp.arange(_SUBSTEPS)) / _SUBSTEPS)
    end = end + correction
    path = _Path(path.time.at[new].set(times.at[-1].set(end)),
                 path.state.at[new].set(states[4::4].at[-1].set(final)), path.rate.at[new].set(rates[4::4]))
    return path, end, final


def read_motion(law: ContactLaw, conditions: Mapping[str, Array], times: Array, motion: Motion,
                from_motion: bool = False, shares: np.ndarray | None = None) -> tuple[Impact, Course | None]:
    """Channels at the wanted times, and the course of the contact at shares of its duration where these are given."""
    path, end, final, separated = motion.path, motion.end, motion.final, motion.separated
    touch = (times > 0.0) & ((times < end) | (~separated & (times <= end)))
    mass = law.reference.inertia()

    def at(time):
        depression, rate, acceleration, states = _interpolate(path, time)
        contact = law.contact(conditions, motion.diameter, time, depression, rate, states)
        if from_motion:
            normal = law.drive(contact, states) - mass * acceleration
        else:
            normal = law.forces(contact, motion.damping, states).normal
        drive = jnp.zeros(()) if shares is None else law.drive(contact, states)
        return Course(time, depression, rate, contact.pressure, normal, contact.contact_radius, drive)

    count = times.shape[0]
    wanted = [jnp.clip(times, 0.0, end)]
    if law.has_sensor():
        wanted.append(end * _FORCE_GRID)
    if shares is not None:
        wanted.append(end * shares)
    # One call for samples and grids: the law is compiled once.
    everywhere = map_samples(at, jnp.concatenate(wanted))
    course = None if shares is None else jax.tree.map(lambda x: x[-len(shares):], everywhere)
    reading = jnp.where(touch, everywhere.normal_force[:count], 0.0)
    if law.has_sensor():
        reading = reading + _deviation(law, everywhere.normal_force[count:count + len(_FORCE_GRID)], times, end)
    initial = conditions.get("initial_pressure", jnp.zeros(()))
    zero = jnp.zeros(())
    left = law.contact(conditions, motion.diameter, end, zero, zero, final[2:]).pressure
    impact = Impact(
        normal_force=reading, depression=jnp.where(touch, everywhere.depression[:count], 0.0),
        depression_rate=jnp.where(touch, everywhere.rate[:count], 0.0),
        pressure=jnp.where(touch, everywhere.pressure[:count], jnp.where(times <= 0.0, initial, left)),
        separation=end, rebound_speed=-final[1], separated=separated, failed=motion.failed, steps=motion.steps,
    )
    total = impact.separation + impact.rebound_speed + jnp.sum(impact.normal_force) + jnp.sum(impact.pressure)
    return eqx.tree_at(lambda i: i.failed, impact, motion.failed | ~jnp.isfinite(total)), course


def _deviation(law: ContactLaw, values: Array, times: Array, end: Array) -> Array:
    """What the sensor adds to the true force at the wanted times; `values` is the force on `_FORCE_GRID`.

    Computed on a grid of its own, dense at first touch and after separation, where a sensor's transients are; the
    deviation is smooth, so that a parabola an interval is enough.
    """
    tail = jnp.maximum(stop(times[-1]) - end, 1e-3 * end)
    grid = jnp.concatenate([end * _CONTACT_GRID, end + tail * _TAIL_GRID])
    inside = len(_CONTACT_GRID)
    nodes, mids = values[:inside], values[inside:]
    rest = jnp.zeros((len(_TAIL_GRID),))
    signal = Signal(jnp.diff(grid), jnp.concatenate([nodes[:-1], rest]), jnp.concatenate([mids, rest]),
                    jnp.concatenate([nodes[1:], rest]))
    if law.rings():
        fine = jnp.sort(jnp.concatenate([grid, jnp.clip(times, grid[0], grid[-1])]))
        finer = functools.partial(_divide, grid, fine)
        change = law.reading(signal, finer).minus(finer(signal))
        value = change.end[jnp.clip(jnp.searchsorted(fine, times, side="left") - 1, 0)]  # every time is a node
    else:
        value = _read_signal(grid, law.reading(signal).minus(signal), times)[0]
    return jnp.where(times > 0.0, value, 0.0)


def _read_signal(grid: Array, signal: Signal, times: Array) -> tuple[Array, Array]:
    """Values of a signal between the nodes `grid` at the times, from the interval before each; which that is."""
    k = jnp.clip(jnp.searchsorted(grid, times, side="left") - 1, 0, grid.shape[0] - 2)
    start, middle, end = signal.start[k], signal.middle[k], signal.end[k]
    u = safe_divide(times - grid[k], signal.duration[k])
    return start + u * (4.0 * middle - 3.0 * start - end + u * (2.0 * (start + end) - 4.0 * middle)), k


def _divide(grid: Array, fine: Array, signal: Signal) -> Signal:
    """The same signal between the nodes `fine`, which hold all of `grid`: what rings changes within its intervals."""
    middles = 0.5 * (fine[1:] + fine[:-1])
    middle, k = _read_signal(grid, signal, middles)
    first, second, last = signal.start[k], signal.middle[k], signal.end[k]

    def read(time):  # of the parabola that holds the middle: at a jump each interval has its own side
        u = (time - grid[k]) / signal.duration[k]
        return first + u * (4.0 * second - 3.0 * first - last + u * (2.0 * (first + last) - 4.0 * second))

    return Signal(jnp.diff(fine), read(fine[:-1]), middle, read(fine[1:]))
