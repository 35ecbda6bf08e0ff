r"""One impact as a problem of optimisation: what can be chosen, what is allowed, what is wanted.

Seven variables: two coordinates of the point on a face, the velocity of the arm relative to the surface there, against
the normal and along two tangents, the pressure in the ball, and the instant within a window. Velocities are in units of
the approach speed that force and depression allow (`allow_speed`), all others over -1 to 1. Wanted is a weighted sum of
the fractions of angular momentum and of rotational energy that are left and of the nutation angle over 90°.
Whether an impact keeps the limits is told by `planning.constraints`.
"""

from collections.abc import Callable, Mapping
from typing import Any, final

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._numerics import safe_divide, scalar
from .._rotation import normalise, rotate
from ..contact.gripping import StrikeLaw, Striker
from ..dynamics.angles import measure_nutation
from ..dynamics.collision import Collision, simulate_collision
from ..dynamics.free_motion import coast_symmetric, propagate_torque_free
from ..dynamics.rigid import measure_energy
from ..dynamics.surfaces import Debris


VARIABLES = ("first coordinate", "second coordinate", "approach speed", "first tangential speed",
             "second tangential speed", "pressure", "instant")
SPEED, SLIPS = 2, slice(3, 5)  # places of the velocity among them
RTOL, ATOL, MAX_STEPS = 1e-8, 1e-10, 384  # of an impact, for gradients that agree with differences to 1e-4
TINY = 1e-7  # fraction of the momentum below which its size is rounded off, so that a norm at zero has a gradient


@final
class Limits(eqx.Module):
    """Limits set by the arm, the ball and the place of the chaser.

    Attributes:
        speed: of the arm [m/s].
        approach: least speed along the normal at first touch [m/s].
        force: peak normal force [N].
        depression: of the ball [m].
        edge: least distance of the contact disc from an edge [m].
        pressure: lowest and highest, absolute, shape (2,) [Pa].
        window: earliest and latest instant, shape (2,) [s]; of a further impact see `wait_again`.
        chaser: direction from the debris to the chaser, inertial, unit, shape (3,) [-].
        cone: largest angle between that and the outward normal at first touch [rad].
        clearance: how long before and after the contact the ball must keep clear of the rest of the body [s].
        faces: which faces may be struck, shape (faces,) of booleans; all where this is None.
        target, radius: centre of the area that may be struck, body components from the centre of mass, shape (3,), and
            the largest distance of the point of first touch from it [m]; infinite where all of a face may.
        fastest, slide: largest speeds along the normal and across it at first touch [m/s]; infinite where only the
            others hold, finite where a plan stays within what was measured.
    """

    speed: Array = eqx.field(converter=scalar, default=2.0)
    approach: Array = eqx.field(converter=scalar, default=0.05)
    force: Array = eqx.field(converter=scalar, default=500.0)
    depression: Array = eqx.field(converter=scalar, default=0.02)
    edge: Array = eqx.field(converter=scalar, default=0.02)
    pressure: Array = eqx.field(converter=scalar, default_factory=lambda: np.array([1.0e6, 2.5e6]))
    window: Array = eqx.field(converter=scalar, default_factory=lambda: np.array([0.0, 60.0]))
    chaser: Array = eqx.field(converter=scalar, default_factory=lambda: np.array([1.0, 0.0, 0.0]))
    cone: Array = eqx.field(converter=scalar, default=np.pi)
    clearance: Array = eqx.field(converter=scalar, default=0.5)
    faces: Array | None = None
    target: Array = eqx.field(converter=scalar, default_factory=lambda: np.zeros(3))
    radius: Array = eqx.field(converter=scalar, default=np.inf)
    fastest: Array = eqx.field(converter=scalar, default=np.inf)
    slide: Array = eqx.field(converter=scalar, default=np.inf)

    def shortest_wait(self) -> float:
        """Shortest time between two impacts [s], in which the ball keeps clear after one and before the next."""
        return 2.0 * float(self.clearance)

    def wait_again(self) -> "Limits":
        """The same for an impact after another, whose window begins no sooner than the shortest wait."""
        early, late = (float(one) for one in self.window)
        return eqx.tree_at(lambda one: one.window, self, scalar(np.array([max(early, self.shortest_wait()), late])))


@final
class Goal(eqx.Module):
    """Weights of the quantities to be minimised.

    Attributes:
        momentum: of |L| after over before [-].
        energy: of the rotational energy after over before [-].
        nutation: of the nutation angle after over 90° [-].
        own: in place of these, a function of JAX of the angular velocity after an impact, body components, shape (3,)
            [rad/s], and of the tensor of inertia, shape (3, 3) [kg m²]; it returns a positive scalar to be made small.
    """

    momentum: Array = eqx.field(converter=scalar, default=1.0)
    energy: Array = eqx.field(converter=scalar, default=0.0)
    nutation: Array = eqx.field(converter=scalar, default=0.0)
    own: Callable[[Array, Array], Array] | None = eqx.field(static=True, default=None)

    def weigh(self) -> list[tuple[float, str]]:
        """The quantities that count, each with its weight; none where the goal is one's own."""
        found = ((float(self.momentum), "momentum left"), (float(self.energy), "rotational energy left"),
                 (float(self.nutation), "nutation over 90°"))
        return [one for one in found if one[0]] if self.own is None else []

    def name(self) -> str:
        """What is wanted small, in words after \"of\"."""
        if self.own is not None:
            return f"the goal {self.own.__name__}"
        own = [what for _, what in self.weigh()]
        words = {"momentum left": "the angular momentum", "rotational energy left": "the rotational energy",
                 "nutation over 90°": "the nutation angle"}
        return words[own[0]] if len(own) == 1 else f"the goal ({self.describe()})"

    def describe(self) -> str:
        """The weighted sum in words."""
        return " + ".join(f"{weight:g} × {what}" for weight, what in self.weigh()) or (
            f"{self.own.__name__} of the motion after the impact" if self.own is not None else "")

    def is_momentum(self) -> bool:
        """Whether the momentum alone is wanted small."""
        return [what for _, what in self.weigh()] == ["momentum left"]


@final
class StrikeProblem(eqx.Module):
    """The problem of one strike; symmetry and unit are derived from the rest if they are not given.

    Attributes:
        law: of the oblique contact.
        debris: what is struck.
        attitude, angular_velocity: of the debris at time 0, shapes (4,), (3,) [-], [rad/s].
        limits: what is allowed.
        goal: what is wanted.
        conditions: what else the law reads, by name, SI.
        symmetric: whether body z is an axis of revolution, whose free motion is trigonometric.
        unit: of the velocities among the variables [m/s]; the same under another law and later in a sequence.
    """

    law: StrikeLaw
    debris: Debris
    attitude: Array
    angular_velocity: Array
    limits: Limits
    goal: Goal
    conditions: Mapping[str, Array]
    symmetric: bool = eqx.field(static=True)
    unit: Array

    def __init__(self, law: StrikeLaw | Striker, debris: Debris, attitude, angular_velocity, limits: Limits,
                 goal: Goal | None = None, conditions: Mapping[str, Array] | None = None,
                 symmetric: bool | None = None, unit: Array | None = None):
        self.law = law if isinstance(law, StrikeLaw) else law.extend(())
        self.debris, self.limits, self.goal = debris, limits, Goal() if goal is None else goal
        self.attitude, self.angular_velocity = scalar(attitude), scalar(angular_velocity)
        self.conditions = {} if conditions is None else conditions
        self.symmetric = is_symmetric(debris) if symmetric is None else symmetric
        self.unit = scalar(1.0) if unit is None else scalar(unit)
        if unit is None:
            self.unit = allow_speed(self)

    def begin_at(self, attitude: Array, angular_velocity: Array) -> "StrikeProblem":
        """The same with another motion at time 0."""
        return eqx.tree_at(lambda p: (p.attitude, p.angular_velocity), self, (attitude, angular_velocity))

    def begin_after(self, attitude: Array, angular_velocity: Array) -> "StrikeProblem":
        """The problem of a further impact, from the motion that the one before left: the wait is one between two."""
        return eqx.tree_at(lambda p: p.limits, self.begin_at(attitude, angular_velocity), self.limits.wait_again())


class Design(eqx.Module):
    """One impact in physical quantities."""

    face: Array  # number of the face
    point: Array  # on the surface, body components from the centre of mass, shape (3,) [m]
    velocity: Array  # of the arm in the frame in which the debris' centre of mass rests, inertial, shape (3,) [m/s]
    pressure: Array  # in the ball [Pa]
    instant: Array  # of first touch [s]
    attitude: Array  # of the debris then, shape (4,) [-]
    angular_velocity: Array  # of the debris then, shape (3,) [rad/s]
    normal: Array  # outward, inertial, shape (3,) [-]


def list_faces(problem: StrikeProblem) -> np.ndarray:
    """Numbers of the faces that may be struck."""
    count = len(problem.debris.surface.face_names())
    return np.arange(count) if problem.limits.faces is None else np.flatnonzero(np.asarray(problem.limits.faces))


def is_symmetric(debris: Debris) -> bool:
    """Whether body z is an axis of revolution of the inertia tensor, to rounding."""
    inertia = np.asarray(debris.inertia)
    even = np.diag([inertia[0, 0], inertia[0, 0], inertia[2, 2]])
    return bool(np.abs(inertia - even).max() < 1e-12 * inertia[2, 2])


def span_plane(normal: Array) -> tuple[Array, Array]:
    """Two unit vectors across a unit vector, smooth but where its z passes -0 (Duff et al. 2017, JCGT 6(1) 1)."""
    x, y, z = normal
    sign = jnp.where(z < 0, -1.0, 1.0)
    a = -1.0 / (sign + z)
    b = x * y * a
    return (jnp.stack([1.0 + sign * x**2 * a, sign * b, -sign * x]), jnp.stack([b, sign + y**2 * a, -y]))


def drift(problem: StrikeProblem, time: Array) -> tuple[Array, Array]:
    """Attitude and rates after free motion for a time [s], in closed form."""
    times = time[None]
    if problem.symmetric:
        inertia = problem.debris.inertia
        attitude, rates = coast_symmetric(inertia[0, 0], inertia[2, 2], normalise(problem.attitude),
                                          problem.angular_velocity, times)
    else:
        motion = propagate_torque_free(problem.debris.inertia, problem.attitude, problem.angular_velocity, times)
        attitude, rates = motion.attitude, motion.angular_velocity
    return attitude[0], rates[0]


def reach_speed(problem: StrikeProblem) -> Array:
    """Speed that arm and surface cannot meet faster than [m/s]: the arm's, and the surface's at the fastest that the
    body can turn with its momentum.
    """
    inertia = problem.debris.inertia
    momentum = jnp.linalg.norm(inertia @ problem.angular_velocity)
    return problem.limits.speed + momentum / jnp.linalg.eigvalsh(inertia)[0] * problem.debris.surface.reach()


@eqx.filter_jit
def allow_speed(problem: StrikeProblem) -> Array:
    r"""Approach speed at which a ball without damping comes to the limit of force or depression, $\sqrt{2 W/m}$ [m/s].

    $W$ is the work of the elastic force up to there, at the pressure that allows most; $m$ the reduced mass of an
    impact through the centre of mass. At most `reach_speed`, at least the least approach speed where that is less.
    """
    limits, normal, ball = problem.limits, problem.law.normal, problem.law.reference.ball
    # Evenly spaced in the logarithm, as a small force may allow a small part of the depression only.
    depths = limits.depression * jnp.geomspace(1e-3, 1.0, 64)

    def measure_work(pressure):
        given = {**problem.conditions, "initial_pressure": pressure, "approach_speed": limits.approach}
        force = jax.vmap(lambda depth: normal.press(given, ball.diameter(), depth).elastic_force)(depths)
        force = jnp.maximum(force, 0.0)
        work = jnp.cumsum(0.5 * (force[1:] + force[:-1]) * jnp.diff(depths))
        return jnp.interp(limits.force, force[1:], work)

    work = jnp.max(jax.vmap(measure_work)(limits.pressure))
    fastest = reach_speed(problem)
    allowed = jnp.sqrt(2.0 * work * (1.0 / ball.inertia() + 1.0 / problem.debris.mass))
    return jnp.clip(allowed, jnp.minimum(limits.approach, fastest), fastest)


def read_design(problem: StrikeProblem, face: Array, x: Array) -> Design:
    """Physical quantities of seven variables."""
    limits = problem.limits
    low, high = limits.pressure
    early, late = limits.window
    instant = early + 0.5 * (1.0 + x[6]) * (late - early)
    attitude, rates = drift(problem, instant)
    point = problem.debris.surface.place(face, x[:2])
    normal = problem.debris.surface.find_foot(point).normal
    first, second = span_plane(normal)
    body = jnp.cross(rates, point) + problem.unit * (-x[2] * normal + x[3] * first + x[4] * second)
    return Design(face, point, rotate(attitude, body), low + 0.5 * (1.0 + x[5]) * (high - low), instant, attitude,
                  rates, rotate(attitude, normal))


def strike_debris(problem: StrikeProblem, design: Design, adjoint: dfx.AbstractAdjoint | None = None) -> Collision:
    """The impact of a design, integrated."""
    conditions = {**problem.conditions, "initial_pressure": design.pressure}
    return simulate_collision(problem.law, problem.debris, design.attitude, design.angular_velocity, design.point,
                              design.velocity, conditions, adjoint=adjoint, rtol=RTOL, atol=ATOL, max_steps=MAX_STEPS)


def measure_share(problem: StrikeProblem, rates: Any) -> float:
    """|L| at these rates, body components, over |L| of the problem [-]."""
    inertia = np.asarray(problem.debris.inertia)
    after, before = (inertia @ np.asarray(one) for one in (rates, problem.angular_velocity))
    return float(np.linalg.norm(after) / np.linalg.norm(before))


def measure_goal(problem: StrikeProblem, rates: Any) -> float:
    """What is wanted small at these rates, body components, over what it is at those of the problem [-]."""
    if problem.goal.is_momentum():
        return measure_share(problem, rates)
    after, before = (float(_score(problem, jnp.asarray(one))) for one in (rates, problem.angular_velocity))
    return after / before if before > 0.0 else 1.0


def score(problem: StrikeProblem, rates: Array) -> Array:
    """What is wanted small, of the rates after an impact in body components."""
    goal, inertia = problem.goal, problem.debris.inertia
    if goal.own is not None:
        return goal.own(rates, inertia)
    before, after = problem.angular_velocity @ inertia, rates @ inertia
    size = jnp.sum(before**2)
    momentum = jnp.sqrt(safe_divide(jnp.sum(after**2), size) + TINY**2)
    energy = safe_divide(measure_energy(inertia, rates), measure_energy(inertia, problem.angular_velocity))
    nutation = measure_nutation(inertia, rates)
    nutation = jnp.minimum(nutation, jnp.pi - nutation) / (0.5 * jnp.pi)
    return goal.momentum * momentum + goal.energy * energy + goal.nutation * nutation


_score = eqx.filter_jit(score)
