"""One impact on the bench: from first touch to separation, and what the channels read at given times."""

import functools
from collections.abc import Mapping
from typing import Any, final

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
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


def measure_error(error: Array) -> Array:
    """Half the root of the sum of squares: a state without error changes no step, as an effect at its null must not."""
    return 0.5 * optx.two_norm(error)


def simulate_impact(
    law: ContactLaw | AbstractReference, conditions: Mapping[str, Array], times: Array, *, span: Array | None = None,
    adjoint: dfx.AbstractAdjoint | None = None, rtol: float = RTOL, atol: float = ATOL, max_steps: int = MAX_STEPS,
    from_motion: bool = False,
) -> Impact:
    r"""Simulate one impact: $m_{eff}\,dw/dt = -F_n + F_{drive}$, $\delta(0) = 0$, $w(0) = v_1$, until $\delta = 0$.

    Batch records with `jax.vmap`. Differentiable in forward and reverse mode; the instant of separation follows the
    implicit-function theorem.

    Args:
        law: the contact law, or a reference model such as `Ball()` alone.
        conditions: `approach_speed` [m/s], `initial_pressure` [Pa, absolute] and whatever the law reads, scalars.
        times: wanted times since first touch, ascending, shape (times,) [s]; may start before 0.
        span: how long to integrate at most [s] (default: to the last wanted time).
        adjoint: diffrax adjoint; default `DirectAdjoint` (both modes), `ForwardMode` is faster for Jacobians.
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
    motion = follow(law, conditions, jnp.where(last > 0, last, 1.0), adjoint, rtol, atol, max_steps)
    return read_motion(law, conditions, times, motion, from_motion)[0]


@eqx.filter_jit
def bound_depression(law: ContactLaw, conditions: Mapping[str, Array]) -> tuple[Array, Array]:
    r"""Depression that an impact does not exceed [m], without solving it, and the outer diameter $D$ [m].

    $\int_0^\delta F_k\,d\delta' = m_{eff} v_1^2/2$ of a ball without damping and of an arm that does not push; infinite
    where the work up to the whole diameter is less than the kinetic energy. The law's reference model has a diameter.
    """
    diameter, _ = law.start(conditions)
    depths = diameter * jnp.linspace(0.0, 1.0, 1025)
    states = jnp.zeros((len(law.stateful()),))
    zero = jnp.zeros(())
    force = jax.vmap(lambda depth: law.contact(conditions, diameter, zero, depth, zero, states).elastic_force)(depths)
    work = jnp.concatenate([zero[None], jnp.cumsum(0.5 * (force[1:] + force[:-1]) * jnp.diff(depths))])
    energy = 0.5 * law.reference.inertia() * conditions["approach_speed"] ** 2
    return jnp.interp(energy, work, depths, right=jnp.inf), diameter


def follow(law: ContactLaw, conditions: Mapping[str, Array], last: Array, adjoint: dfx.AbstractAdjoint | None = None,
           rtol: float | Array = RTOL, atol: float | Array = ATOL, max_steps: int = MAX_STEPS) -> Motion:
    """Integrate one impact to separation, or to the time `last` [s]; arguments as of `simulate`."""
    adjoint = dfx.DirectAdjoint() if adjoint is None else adjoint
    speed = conditions["approach_speed"]
    diameter, damping = law.start(conditions)
    mass = law.reference.inertia()
    first = law.contact(conditions, diameter, jnp.zeros(()), jnp.zeros(()), speed, jnp.zeros((len(law.stateful()),)))
    sizes = [jnp.asarray(effect.size(first)) for effect in law.stateful()]
    v = stop(speed)
    scale = jnp.stack([v * last, v, *[stop(s) for s in sizes]])
    start = jnp.concatenate([jnp.stack([jnp.zeros(()), speed]), law.begin_states()]) / scale

    def field(t, y, args):
        return _rates(t * last, y * scale, args) * (last / scale)

    def gap(t, y, args, **kwargs):
        return y[0]

    def node(t, y, args):
        return y * scale, _rates(t * last, y * scale, args)

    constants = (diameter, damping, mass, conditions, law)
    solution: Any = dfx.diffeqsolve(
        dfx.ODETerm(field), dfx.Tsit5(), t0=jnp.zeros(()), t1=jnp.ones(()), dt0=jnp.asarray(2e-3),
        y0=start, args=constants,
        saveat=dfx.SaveAt(subs=[dfx.SubSaveAt(t0=True, steps=True, fn=node), dfx.SubSaveAt(t1=True)]),
        stepsize_controller=dfx.PIDController(rtol=rtol, atol=atol, norm=measure_error), max_steps=max_steps,
        adjoint=adjoint, event=dfx.Event(gap, optx.Newton(1e-12, 1e-12), direction=False), throw=False,
    )
    (node_state, node_rate), final = solution.ys
    separated = solution.result == dfx.RESULTS.event_occurred
    failed = ~(separated | (solution.result == dfx.RESULTS.successful))
    path = _Path(solution.ts[0] * last, node_state, node_rate)
    k = jnp.maximum(jnp.sum(jnp.isfinite(path.time)) - 2, 0)
    failed = failed | (k + _SUBSTEPS >= path.time.shape[0])
    path, end, final = _separate(lambda t, y: _rates(t, y, constants), path, k,
                                 solution.ts[1][0] * last, final[0] * scale, separated)
    return Motion(path, end, final, separated, failed, solution.stats["num_steps"], diameter, damping)


@jax.jit
def _rates(time, state, constants):
    """Rates of all states, SI. Compiled on its own: the integrator asks for it in many places, and traces it once."""
    diameter, damping, mass, conditions, law = constants
    contact = law.contact(conditions, diameter, time, state[0], state[1], state[2:])
    forces = law.forces(contact, damping, state[2:])
    acceleration = (forces.drive - forces.normal) / mass
    return jnp.concatenate([jnp.stack([state[1], acceleration]), law.rates(contact, state[2:])])


def _separate(field, path: _Path, k: Array, end: Array, final: Array, separated: Array
              ) -> tuple[_Path, Array, Array]:
    """Path, time and state at the end, where the ball separates followed anew from the last node in contact.

    The integrator's last step reaches beyond separation, where the law breaks off: its interpolant loses two to four
    digits there. A few steps of the classical Runge-Kutta method from node `k` to separation see the law, and its
    slopes, in contact only (depressions are kept above `floor`), and become nodes of their own: the force may break off
    shortly before separation. A Newton step then takes the depression to zero, and carries the instant's derivative.
    """
    floor = stop(1e-6 * path.state[k, 0])
    end = jnp.where(separated, stop(end), end)
    step = (end - path.time[k]) / _SUBSTEPS

    def stage(carry, coefficients):
        time, base, total, slope = carry
        reach, weight, done = coefficients
        y = base + reach * step * slope
        y = y.at[0].add(jnp.where(y[0] > floor, 0.0, floor - stop(y[0])))
        slope = field(time + reach * step, y)
        total = total + weight * step * slope
        return (time + done * step, base + done * total, (1.0 - done) * total, slope), (y, slope)

    start = (path.time[k], path.state[k], jnp.zeros_like(final), jnp.zeros_like(final))
    (_, after, _, rate), (states, rates) = jax.lax.scan(stage, start, _STAGES)
    correction = jnp.where(separated, -safe_divide(after[0], after[1]), 0.0)
    end, final = end + correction, jnp.where(separated, after + correction * rate, final)
    new = k + 1 + jnp.arange(_SUBSTEPS)
    times = path.time[k] + step * (1.0 + jnp.arange(_SUBSTEPS))
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
