r"""One impact on debris in free fall: a ball on an arm against a tumbling rigid body, until they separate.

The frame is inertial; at first touch the debris' centre of mass rests at its origin. The arm is felt at the ball as an
apparent mass, $\Lambda = m_t 1 + (m_n - m_t) n_0 n_0^T$ with the bench's masses along the normal at first touch and
across it. With $c$ the point of contact, $n$ the outward normal there, $F = -F_n n + f$ the force on the debris:

$\dot p = F$, $\dot L = (c - x) \times F$, $\dot q = \frac12 q \otimes \omega$, $\Lambda \dot v = -F - F_{drive} n_0$,
$\quad \delta = D/2 - \mathrm{dist}(x_{ball})$, $\quad w = -n \cdot (v - v_c)$.

Normal force, drive, and the limit of friction are those of the bench (`contact.law`, `contact.gripping`) with all their
effects; the slip $u = (v - v_c) + w n - y$ has two components, $y$ is the ball's rolling, and the patch is the bench's
spring and slider. Where an effect lets the patch give way, its spring has a small damper in parallel, of relaxation
time $\epsilon$, which makes the slider's speed a function of the state:
$C F_{max} u_s/\sqrt{u_s^2 + u_c^2} + \epsilon u_s = \xi + \epsilon u$, $\dot\xi = u - u_s$.

A normal force has no moment about the axis of a body of revolution: spin about it goes by friction alone.
"""

from collections.abc import Callable, Mapping
from typing import Any, final

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float

from .._errors import InputError
from .._numerics import is_known, safe_divide, safe_sqrt, stop
from .._rotation import normalise, rotate, rotate_back, turn
from ..contact.effect import Scalar
from ..contact.gripping import Patch, StrikeLaw, Striker, find_height, share_friction, solve_slider
from .entry import read_conditions, read_law
from .surfaces import Debris


RTOL, ATOL = 1e-9, 1e-11  # finer than for records: the planner's gradients are compared with differences
MAX_STEPS = 2048  # more than a plain impact has, as the tangential motion may stick and slip
SPAN = 1.0  # s, after which a contact that has not ended is given up: long against any strike
# S, of a compliant patch: a thousandth of a contact, so that it follows, and not too stiff to integrate.
RELAXATION = 2e-5
PROBE = 5e-3  # m, depression at which the stiffness is estimated: within a usual strike
LATEST = 1e9  # expected durations, before which any span has passed
NEARER = 6  # Newton steps from where a line would separate: the last ones change nothing
# Of the contact at which its course is read, denser at its ends, where it changes fastest.
SHARES = 0.5 - 0.5 * np.cos(np.pi * np.arange(49) / 48)


@final
class Course(eqx.Module):
    """The contact at shares of its duration, shape (places,) each."""

    time: Float[Array, " places"]  # since first touch [s]
    depression: Float[Array, " places"]  # of the ball [m]
    rate: Float[Array, " places"]  # of the depression [m/s]
    pressure: Float[Array, " places"]  # of the gas, absolute [Pa]
    normal_force: Float[Array, " places"]  # on the debris [N]
    friction: Float[Array, "places 3"]  # on the debris, inertial components [N]
    slip_speed: Float[Array, " places"]  # of the ball over the surface [m/s]
    # from the rim of the contact disc to each edge of the face, shape (places, edges) [m]
    margins: Float[Array, "places edges"]


@final
class Ledger(eqx.Module):
    """Where momentum and energy went, from before to after the impact, inertial components."""

    arm_impulse: Array  # of the arm's drive, shape (3,) [N s]
    # of the arm about the origin: of its drive, of the mount that keeps the ball from turning (or of what turns
    # the ball), and of the guidance that makes the apparent mass differ by direction, shape (3,) [N m s]
    arm_moment: Array
    arm_work: Array  # done by the drive [J]
    normal_loss: Array  # taken by the contact [J]
    friction_loss: Array  # taken by the patch [J]
    rolling_loss: Array  # taken by rolling [J]
    tip_before: Array  # linear momentum of the apparent mass, shape (3,) [N s]
    tip_after: Array
    tip_moment_before: Array  # its angular momentum about the origin, shape (3,) [N m s]
    tip_moment_after: Array
    debris_before: Array  # angular momentum of the debris about the origin, shape (3,) [N m s]
    debris_after: Array
    energy_before: Array  # of both bodies and the ball's rolling [J]
    energy_after: Array


@final
class Collision(eqx.Module):
    """Both bodies after one impact, in the frame in which the debris' centre of mass rested at the origin."""

    attitude: Float[Array, " 4"]  # of the debris at separation, unit quaternion [-]
    angular_velocity: Float[Array, " 3"]  # of the debris at separation, body components [rad/s]
    angular_momentum: Float[Array, " 3"]  # of the debris about its centre of mass, inertial [N m s]
    velocity: Float[Array, " 3"]  # of its centre of mass [m/s]
    displacement: Float[Array, " 3"]  # of its centre of mass [m]
    impulse: Float[Array, " 3"]  # of the contact force on the debris [N s]
    arm_velocity: Float[Array, " 3"]  # of the ball [m/s]
    last_point: Float[Array, " 3"]  # on the surface at separation, body components from the centre of mass [m]
    normal: Float[Array, " 3"]  # outward at first touch, inertial [-]
    approach_speed: Scalar  # along the normal, at first touch [m/s]
    tangential_speed: Scalar  # across it, at first touch [m/s]
    separation: Scalar  # time of separation [s]
    peak_force: Scalar  # [N]
    peak_depression: Scalar  # [m]
    # By which the ball goes in again before it has left, all times together: 0 of a single blow [m].
    second_depression: Scalar
    peak_pressure: Scalar  # of the gas, absolute [Pa]
    # least distance of the contact disc from each edge; below zero it reaches over one, shape (edges,) [m]
    margins: Float[Array, " edges"]
    course: Course  # the contact over its duration
    ledger: Ledger  # momentum and energy
    separated: Bool[Array, ""]  # whether they separated within the span
    failed: Bool[Array, ""]  # whether the integration failed, the ball did not approach, or something is not finite
    steps: Array  # integration steps taken

    @property
    def margin(self) -> Array:
        """Least distance of the contact disc from the nearest edge [m]."""
        return jnp.min(self.margins, axis=-1)


@final
class _State(eqx.Module):
    """What is integrated; momenta as changes since first touch."""

    ball: Array  # displacement of the ball
    ball_momentum: Array
    debris: Array  # displacement of the centre of mass
    debris_momentum: Array
    attitude: Array
    spin: Array  # change of the angular momentum about the centre of mass
    rolling: Array
    patch: Array  # deflection
    path: Array
    work: Array
    arm_impulse: Array
    arm_moment: Array
    arm_work: Array
    normal_loss: Array
    rolling_loss: Array
    friction_loss: Array
    own: Array  # of the effects


@final
class _Setup(eqx.Module):
    """What stays the same during one impact."""

    law: StrikeLaw
    debris: Debris
    inverse: Array  # of the inertia tensor
    momentum: Array  # angular, at first touch
    start: Array  # of the ball
    velocity: Array  # of the ball
    normal: Array
    reach: Array  # of the ball's centre from the surface at first touch
    diameter: Array
    damping: Array
    conditions: Mapping[str, Array]
    arm_conditions: Mapping[str, Array]
    relaxation: Array

    def move_tip(self, momentum: Array) -> Array:
        """Velocity of the apparent mass with a momentum, shape (3,)."""
        along = self.normal * (self.normal @ momentum)
        return along / self.law.reference.ball.inertia() + (momentum - along) / self.law.reference.tangential_mass

    def weigh_tip(self, velocity: Array) -> Array:
        """Momentum of the apparent mass with a velocity, shape (3,)."""
        along = self.normal * (self.normal @ velocity)
        return along * self.law.reference.ball.inertia() + (velocity - along) * self.law.reference.tangential_mass


def reduce_mass(debris: Debris, point: Array, normal: Array, mass: Array) -> Array:
    r"""Mass that an impact feels along the normal, $1/m_{red} = 1/m_{arm} + 1/m + (r \times n)^T I^{-1} (r \times n)$.

    Point of contact and normal (3,), body components [m], [-]; `mass` is the arm's apparent one along the normal [kg].
    """
    lever = jnp.cross(point, normal)
    return 1.0 / (1.0 / mass + 1.0 / debris.mass + lever @ jnp.linalg.solve(debris.inertia, lever))


def _touch(setup: _Setup, time: Array, state: _State) -> tuple[Course, _State]:
    """The contact at one instant, and the rates of all states."""
    law, debris, n0 = setup.law, setup.debris, setup.normal
    reference, normal_law = law.reference, law.normal
    attitude = normalise(state.attitude)
    ball = setup.start + state.ball
    foot = debris.surface.find_foot(rotate_back(attitude, ball - state.debris))
    n = rotate(attitude, foot.normal)
    contact_point = ball - foot.distance * n
    momentum = setup.momentum + state.spin
    omega = setup.inverse @ rotate_back(attitude, momentum)
    velocity = setup.velocity + setup.move_tip(state.ball_momentum)
    body = state.debris_momentum / debris.mass
    lever = contact_point - state.debris
    relative = velocity - body - jnp.cross(rotate(attitude, omega), lever)
    depression, rate = setup.reach - foot.distance, -(n @ relative)
    contact = normal_law.contact(setup.conditions, setup.diameter, time, depression, rate, state.own)
    # After separation there is no force, also of effects that act without depression.
    normal_force = jnp.where(depression > 0, normal_law.forces(contact, setup.damping, state.own).normal, 0.0)
    travel, advance = -(n0 @ state.ball), -(n0 @ velocity)
    followed = normal_law.contact(setup.arm_conditions, setup.diameter, time, travel, advance, state.own)
    drive = normal_law.drive(followed, state.own)

    along = relative + rate * n
    rolling = state.rolling - n * (n @ state.rolling)
    slip = along - rolling
    patch = Patch(time, jnp.maximum(depression, 0.0), contact.contact_radius,
                  find_height(setup.diameter, jnp.maximum(depression, 0.0)), contact.pressure,
                  jnp.maximum(normal_force, 0.0), setup.conditions)
    limit = law.limit(patch, safe_sqrt(slip @ slip), state.path, state.work)
    limit = jnp.where(patch.normal_force > 0, limit, 0.0)
    creep = reference.creep_speed
    slider, change = slip, jnp.zeros(3)
    if law.pick("compliance"):
        push = state.patch - n * (n @ state.patch) + setup.relaxation * slip
        stiff = law.compliance(patch) * limit
        size = safe_sqrt(push @ push)
        still = 1.0 / (stiff / creep + setup.relaxation)
        speed = solve_slider(stiff, setup.relaxation, size, creep)
        slider = push * jnp.where(size > 0, safe_divide(speed, size), still)
        change = slip - slider
    sliding = safe_sqrt(slider @ slider)
    friction = limit * slider / jnp.sqrt(sliding**2 + creep**2)
    brake = law.brake(patch) * rolling / jnp.sqrt(rolling @ rolling + creep**2)
    force = friction - normal_force * n
    arm = -drive * n0
    tip = setup.weigh_tip(velocity)
    moved = _State(
        ball=velocity, ball_momentum=arm - force, debris=body, debris_momentum=force,
        attitude=turn(attitude, omega), spin=jnp.cross(lever, force),
        rolling=(friction - brake) / reference.rolling_mass, patch=change, path=sliding,
        work=limit * share_friction(sliding, creep) * sliding, arm_impulse=arm,
        arm_moment=jnp.cross(ball, arm) + jnp.cross(contact_point - ball, force) + jnp.cross(velocity, tip),
        arm_work=arm @ velocity, normal_loss=normal_force * rate, rolling_loss=brake @ rolling,
        friction_loss=friction @ slip, own=normal_law.rates(contact, state.own))
    return Course(time, depression, rate, contact.pressure, normal_force, friction, safe_sqrt(slip @ slip),
                  foot.margins - contact.contact_radius), moved


@jax.jit
def _rates(setup: _Setup, time: Array, state: _State) -> _State:
    """Rates of all states. Compiled on its own: the integrator asks for it in many places, and traces it once."""
    return _touch(setup, time, state)[1]


def simulate_collision(law: StrikeLaw | Striker, debris: Debris, attitude: Any, angular_velocity: Any, point: Any,
            arm_velocity: Any, conditions: Mapping[str, Any], *, span: float | Array = SPAN,
            relaxation: float | Array = RELAXATION, solver: dfx.AbstractSolver | None = None,
            adjoint: dfx.AbstractAdjoint | None = None, rtol: float | Array = RTOL, atol: float | Array = ATOL,
            max_steps: int = MAX_STEPS) -> Collision:
    """Integrate both bodies from first touch to separation.

    Batch with `jax.vmap`; differentiable in both modes, where nothing slides over an edge or switches faces.

    Args:
        law: of the contact as on the bench: `Striker(ball, friction)`, or one with `.extend(effects)`.
        debris: what is struck.
        attitude: of the debris at first touch, quaternion, scalar first, shape (4,) [-].
        angular_velocity: of the debris at first touch, body components, shape (3,) [rad/s].
        point: of first touch on the surface, body components from the centre of mass, shape (3,) [m].
        arm_velocity: of the ball, in the inertial frame in which the debris' centre of mass rests, shape (3,) [m/s].
        conditions: `initial_pressure` [Pa, absolute] where the ball holds gas, and whatever the law reads, scalars; the
            speeds follow from the motion.
        span: longest contact [s].
        relaxation: of a compliant patch [s]; nothing changes with it where the law has no such effect.
        solver: of diffrax (default `Tsit5`); a light ball that rolls and grips is stiff and takes it more steps.
        adjoint: of diffrax; default `DirectAdjoint` (both modes), `ForwardMode` is faster for few parameters.
        rtol, atol: tolerances, in units of the impact's own speed, duration and momentum.
        max_steps: steps after which the integration counts as failed.

    Returns:
        A `Collision`; look at `failed` and `separated`.

    Raises:
        InputError: The law is none of oblique impacts, a condition is missing, a shape is wrong, or the ball is known
            not to approach.
    """
    law, gas = read_law(law, StrikeLaw, "a Striker(ball, friction), or one with .extend(effects)", "collide")
    given = read_conditions(conditions, gas, "collide")
    vectors = []
    for name, value, size in (("attitude", attitude, 4), ("angular_velocity", angular_velocity, 3),
                              ("point", point, 3), ("arm_velocity", arm_velocity, 3)):
        if np.shape(value) != (size,):
            raise InputError(f"collide: {name} must have the shape ({size},); got {np.shape(value)}")
        vectors.append(jnp.asarray(value, dtype=float))
    solver = dfx.Tsit5() if solver is None else solver
    adjoint = dfx.DirectAdjoint() if adjoint is None else adjoint
    quaternion, rates, place, velocity = vectors
    found = _collide(law, debris, quaternion, rates, place, velocity, given, jnp.asarray(span, dtype=float),
                     jnp.asarray(relaxation, dtype=float), solver, adjoint, (jnp.asarray(rtol), jnp.asarray(atol)),
                     max_steps)
    if is_known(found.approach_speed) and np.ndim(found.approach_speed) == 0 and not float(found.approach_speed) > 0:
        raise InputError(f"collide: the ball does not approach the surface there (its speed along the normal is "
                         f"{float(found.approach_speed):.3g} m/s); it must approach faster than the surface recedes")
    return found


def _measure_error(error: Array) -> Array:
    """Half the root of the sum of squares: a state without error changes no step, as an effect at its null must not."""
    return 0.5 * optx.two_norm(error)


@eqx.filter_jit
def _collide(law, debris, attitude, omega, point, velocity, given, span, relaxation, solver, adjoint, tolerances,
             max_steps) -> Collision:
    """Set up, integrate, read off."""
    attitude = normalise(attitude)
    foot = debris.surface.find_foot(point)
    n0 = rotate(attitude, foot.normal)
    relative = velocity - rotate(attitude, jnp.cross(omega, point))
    speed = -(n0 @ relative)
    across = relative + speed * n0
    sliding = safe_sqrt(across @ across)
    safe = jnp.where(speed > 0, speed, 1.0)
    conditions = given | {"approach_speed": safe, "tangential_speed": sliding}
    diameter, damping = law.normal.start(conditions)
    reach = find_height(diameter, jnp.zeros(()))
    setup = _Setup(law, debris, jnp.linalg.inv(debris.inertia), rotate(attitude, debris.inertia @ omega),
                   rotate(attitude, point + (reach - foot.distance) * foot.normal), velocity, n0, reach, diameter,
                   damping, conditions, conditions | {"approach_speed": -(n0 @ velocity)}, relaxation)
    stateful = law.normal.stateful()
    probe = law.normal.press(conditions, diameter, jnp.asarray(PROBE))
    mass = stop(reduce_mass(debris, point, foot.normal, law.reference.ball.inertia()))
    v = stop(safe)
    curve = jnp.maximum(stop(probe.elastic_force), 1e-3) / PROBE**2
    unit = 4.0 * jnp.cbrt(1.5 * mass * v**2 / curve) / v  # expected duration
    momentum = 2.0 * mass * v
    size, arm = v * unit, stop(debris.surface.reach())
    three, one = jnp.zeros(3), jnp.zeros(())
    first = _State(three, three, three, three, attitude, three, three, three, one, one, three, three, one, one, one,
                   one, law.normal.begin_states())
    sizes = jnp.stack([stop(jnp.asarray(e.size(probe))) for e in stateful]) if stateful else jnp.zeros((0,))
    energy = momentum * v
    scale = _State(size, momentum, size, momentum, jnp.ones(()), momentum * arm, v, size, size, energy, momentum,
                   momentum * arm, energy, energy, energy, energy, jnp.where(sizes > 0, sizes, 1.0))

    # One vector: the integrator's own operations are then few, and quick to compile.
    start, unravel = ravel_pytree(first)
    scales = ravel_pytree(jax.tree.map(lambda x, s: jnp.broadcast_to(s, jnp.shape(x)), first, scale))[0]

    def field(t, y, args):
        setup, scales = args
        return ravel_pytree(_rates(setup, t * unit, unravel(y * scales)))[0] * unit / scales

    def gap(t, y, args):
        setup, scales = args
        state = unravel(y * scales)
        place = rotate_back(normalise(state.attitude), setup.start + state.ball - state.debris)
        depression = (setup.reach - setup.debris.surface.find_foot(place).distance) / size
        # At first touch it is rounding alone, whose sign may change where the first step is tried again.
        return jnp.where(t > 0, depression, 0.0)

    most = span / unit
    # To the end of the step in which ball and surface part, or which ends the span. With a root finder, or with an end
    # that is not known when it is compiled, diffrax would call the host, and no such program outlives its process.
    solution = dfx.diffeqsolve(
        dfx.ODETerm(field), solver, t0=0.0, t1=LATEST, dt0=2e-3, y0=start / scales, args=(setup, scales),
        saveat=dfx.SaveAt(dense=True), max_steps=max_steps, adjoint=adjoint, throw=False,
        stepsize_controller=dfx.PIDController(rtol=tolerances[0], atol=tolerances[1], norm=_measure_error),
        event=dfx.Event((lambda t, y, args, **_: gap(t, y, args), lambda t, y, args, **_: t >= most),
                        direction=(False, None)))
    ended = solution.result == dfx.RESULTS.event_occurred
    end, separated = _find_separation(lambda t, path, args: gap(t, path.evaluate(t), args), solution.interpolation,
                                      (setup, scales), most)
    separated &= ended
    final = unravel(solution.evaluate(end) * scales)

    def read(share):
        return _touch(setup, share * end * unit, unravel(solution.evaluate(share * end) * scales))[0]

    course = jax.vmap(read)(jnp.asarray(SHARES))
    bad = ~ended | (speed <= 0)
    return _conclude(setup, final, course, end * unit, speed, sliding, omega, separated, bad,
                     solution.stats["num_steps"])


def _find_separation(gap: Callable[..., Array], path: Any, args: Any, most: Array) -> tuple[Array, Array]:
    """Time at which the `gap` to the surface closes within the last step of an interpolated solution, and whether it
    does, no later than `most`; else where the step ends. Times are in expected durations, scalars.

    Its derivatives, to the second, are those of two Newton steps from the root.
    """
    frozen, known = jax.lax.stop_gradient((path, args))
    before, last = frozen.ts[frozen.ts_size - 2], frozen.ts[frozen.ts_size - 1]
    first, final = gap(before, frozen, known), gap(last, frozen, known)

    def step(time, path, args):
        value, slope = jax.jvp(lambda t: gap(t, path, args), (time,), (jnp.ones(()),))
        return time - safe_divide(value, slope)

    near = before + safe_divide(first, first - final) * (last - before)
    near = jax.lax.fori_loop(0, NEARER, lambda _, t: jnp.clip(step(t, frozen, known), before, last), near)
    parted = (first > 0.0) & (final <= 0.0) & (near <= stop(most))
    near = stop(jnp.where(parted, near, last))
    return jnp.where(parted, step(step(near, path, args), path, args), jnp.minimum(last, most)), parted


def _find_peak(time: Array, values: Array) -> Array:
    """Largest value, by the parabola through the three places about the largest one."""
    # As sums over a mask: XLA fuses a slice at a traced place with all that `values` is computed from, and for a
    # polytope with an axis of equal moments cannot compile what comes out (jax 0.12.0, CPU).
    places = jnp.clip(jnp.argmax(values), 1, values.size - 2) + jnp.arange(-1, 2)
    mask = places[:, None] == jnp.arange(values.size)
    t, y = (jnp.sum(jnp.where(mask, x, 0.0), axis=1) for x in (time, values))
    left, right = t[1] - t[0], t[2] - t[1]
    rise, fall = safe_divide(y[1] - y[0], left), safe_divide(y[2] - y[1], right)
    bend = safe_divide(fall - rise, left + right)
    slope = safe_divide(rise * right + fall * left, left + right)
    top = jnp.where(bend < 0, y[1] - 0.25 * safe_divide(slope**2, bend), y[1])
    return jnp.maximum(jnp.where(jnp.abs(top - y[1]) <= jnp.abs(y[1] - jnp.minimum(y[0], y[2])), top, y[1]), y[1])


def _conclude(setup: _Setup, final: _State, course: Course, end: Array, speed: Array, sliding: Array, omega: Array,
              separated: Array, bad: Array, steps: Array) -> Collision:
    """Both bodies at separation, and the ledger."""
    debris, reference = setup.debris, setup.law.reference
    attitude = normalise(final.attitude)
    momentum = setup.momentum + final.spin
    after = setup.inverse @ rotate_back(attitude, momentum)
    velocity = setup.velocity + setup.move_tip(final.ball_momentum)
    tip_before = setup.weigh_tip(setup.velocity)
    tip_after = tip_before + final.ball_momentum
    ball = setup.start + final.ball
    body = final.debris_momentum / debris.mass
    before = 0.5 * (tip_before @ setup.velocity + omega @ debris.inertia @ omega)
    left = 0.5 * (tip_after @ velocity + after @ debris.inertia @ after + final.debris_momentum @ body
                  + reference.rolling_mass * final.rolling @ final.rolling)
    ledger = Ledger(
        final.arm_impulse, final.arm_moment, final.arm_work, final.normal_loss, final.friction_loss,
        final.rolling_loss, tip_before, tip_after, jnp.cross(setup.start, tip_before), jnp.cross(ball, tip_after),
        setup.momentum, momentum + jnp.cross(final.debris, final.debris_momentum), before, left)
    place = rotate_back(attitude, ball - final.debris)
    foot = debris.surface.find_foot(place)
    # All ways in and out, less those of one blow that is as deep.
    depression = course.depression
    again = 0.5 * (jnp.sum(jnp.abs(jnp.diff(depression))) + depression[0] + depression[-1]) - jnp.max(depression)
    finite = jnp.isfinite(jnp.sum(momentum) + jnp.sum(velocity) + jnp.sum(course.normal_force) + end)
    return Collision(
        attitude, after, momentum, body, final.debris, final.debris_momentum, velocity,
        place - foot.distance * foot.normal, setup.normal, speed, sliding, end,
        _find_peak(course.time, course.normal_force), _find_peak(course.time, course.depression),
        jnp.maximum(again, 0.0), jnp.max(course.pressure), jnp.min(course.margins, axis=0), course, ledger, separated,
        bad | ~finite, steps)
