"""Several impacts with free motion between them: each planned by gradient, until little enough momentum is left."""

import dataclasses as dc
import math
from collections.abc import Callable, Mapping

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from scipy.stats import qmc

from .._errors import ComputationError
from ..contact.effect import AbstractDriveEffect
from ..contact.gripping import Patch, StrikeLaw, find_height
from ..dynamics.impact import simulate_impact
from .relaxation import Relaxation, find_relaxations
from .strike_plan import LEAST_GAIN, STARTS, StrikePlan, plan_strike
from .strike_problem import Problem, reach_speed


SPEEDS = np.geomspace(0.02, 1.0, 24)  # of the fastest approach, at which the largest impulse is looked for
PRESSURES = np.linspace(0.0, 1.0, 5)
RUBBED = np.array([0.03, 0.1, 0.3, 1.0])  # of the depression and of the speed, at which friction is looked at


@dc.dataclass(frozen=True)
class Joint:
    """What came of optimising all impacts of a sequence jointly, which were planned one after the other.

    Attributes:
        aim: what was brought down: `impacts` (their number), `share` (of the momentum left), `impulse` or `time`.
        taken: whether the sequence is the one that was optimised jointly; where not, that misses what is wanted.
        impacts, share, impulse, duration: of the sequence optimised jointly: number, share of the angular momentum left
            [-], sizes of all contact impulses added up [N s], from time 0 to the last separation [s].
        alone: the same four of the one that was planned one after the other.
    """

    aim: str
    taken: bool
    impacts: int
    share: float
    impulse: float
    duration: float
    alone: tuple[int, float, float, float]


@dc.dataclass(frozen=True)
class Sequence:
    """Planned impacts, in order.

    Attributes:
        impacts: each planned from the motion that the one before left.
        instants: of first touch, since time 0 [s].
        shares: of the angular momentum left after each [-].
        impulse: of all contact forces, their sizes added up [N s].
        reached: whether the wanted share was reached.
        bound: fewest impacts that could do it, whatever the plan; 0 where none can be given.
        floor: share that frictionless impacts cannot go below; 0 on surfaces without an axis of revolution.
        refused: the best further impact where it was not worth its while or not allowed, and the sequence ended.
        joint: what optimising all impacts jointly made of it, or what one impact less would leave; None where that was
            not done, or made it no better.
        relaxations: limits each of which, looser, would allow an impact; looked for where there is none.
    """

    impacts: tuple[StrikePlan, ...]
    instants: tuple[float, ...]
    shares: tuple[float, ...]
    impulse: float
    reached: bool
    bound: int
    floor: float
    refused: StrikePlan | None = None
    joint: Joint | None = None
    relaxations: tuple[Relaxation, ...] = ()

    @property
    def duration(self) -> float:
        """From time 0 to the last separation [s]."""
        return self.instants[-1] + float(self.impacts[-1].collision.separation) if self.impacts else 0.0


def measure_share(problem: Problem, rates: np.ndarray) -> float:
    """|L| at these rates over |L| of the problem [-]."""
    inertia = np.asarray(problem.debris.inertia)
    return float(np.linalg.norm(inertia @ rates) / np.linalg.norm(inertia @ np.asarray(problem.angular_velocity)))


def find_floor(problem: Problem) -> float:
    """Share of the momentum about an axis of revolution of the surface, or a sphere's centre, which a normal force
    cannot take [-]; 0 where free motion moves momentum into that axis and out of it.
    """
    pivots = np.asarray(problem.debris.surface.find_pivots())
    if len(pivots) < 3 and not problem.symmetric:
        return 0.0
    momentum = np.asarray(problem.debris.inertia) @ np.asarray(problem.angular_velocity)
    return float(np.linalg.norm(pivots @ momentum) / np.linalg.norm(momentum))


@eqx.filter_jit
def _press(law: StrikeLaw, given: Mapping[str, Array], deepest: Array, speeds: Array, pressures: Array) -> Array:
    """Impulse, peak force, peak depression, largest friction over load, on a body that does not give way."""
    normal, reference = law.normal, law.reference
    times = jnp.linspace(0.0, 0.5, 2)

    def one(speed, pressure):
        conditions = {**given, "approach_speed": speed, "initial_pressure": pressure}
        end = simulate_impact(normal, conditions, times).separation
        impact = simulate_impact(normal, conditions, end * jnp.linspace(0.0, 1.0, 33), span=jnp.asarray(0.5))

        def rub(depression, slip):
            contact = normal.contact(conditions, reference.ball.diameter(), jnp.zeros(()), depression, jnp.zeros(()),
                                     jnp.zeros((len(normal.stateful()),)))
            load = jnp.maximum(contact.elastic_force, 1e-6)
            patch = Patch(jnp.zeros(()), depression, contact.contact_radius,
                          find_height(reference.ball.diameter(), jnp.zeros(())), contact.pressure, load,
                          conditions | {"tangential_speed": slip})
            return law.limit(patch, slip, jnp.zeros(()), jnp.zeros(())) / load

        friction = jax.vmap(jax.vmap(rub, (0, None)), (None, 0))(
            deepest * RUBBED, speed * RUBBED)
        return jnp.stack([reference.ball.inertia() * (speed + impact.rebound_speed), jnp.max(impact.normal_force),
                          jnp.max(impact.depression), jnp.max(friction)])

    return jax.vmap(jax.vmap(one, (0, None)), (None, 0))(speeds, pressures)


def bound_impacts(problem: Problem, share: float) -> int:
    r"""Fewest impacts that can leave a share of the momentum: no impact takes more than $J (\ell + \mu R)$.

    $J$ is the largest impulse that arm and limits allow on a body that does not give way (at five pressures), $\ell$
    the largest lever arm of a normal force, $\mu$ the largest friction over load (over pressures, depressions and
    speeds), $R$ the body's reach. The body never turns faster than its momentum at the start about its least axis:
    bodies that impacts spin up on the way are left out.

    Returns:
        0 where none can be given: the arm drives the ball, so that an impact has no largest impulse, or no impact has
        a moment at all.
    """
    if any(isinstance(effect, AbstractDriveEffect) for effect in problem.law.effects):
        return 0
    limits, surface = problem.limits, problem.debris.surface
    inertia = np.asarray(problem.debris.inertia)
    size = float(np.linalg.norm(inertia @ np.asarray(problem.angular_velocity)))
    fastest = float(reach_speed(problem))
    low, high = np.asarray(limits.pressure)
    found = np.asarray(_press(problem.law, problem.conditions, limits.depression, jnp.asarray(fastest * SPEEDS),
                              jnp.asarray(low + PRESSURES * (high - low))))
    allowed = (found[..., 1] <= float(limits.force)) & (found[..., 2] <= float(limits.depression))
    # The next speed of the grid, which is not allowed any more, is a bound from above.
    allowed[:, 1:] |= allowed[:, :-1].copy()
    allowed[:, 0] = True
    impulse = float(found[..., 0][allowed].max())
    friction = float(found[..., 3].max())
    lever = find_lever(problem)
    most = impulse * (lever + friction * float(surface.reach()))
    if not most > 1e-9 * size:
        return 0
    return max(1, math.ceil(size * (1.0 - share) / most - 1e-9))


def find_lever(problem: Problem, draws: int = 4096) -> float:
    """Largest lever arm of a normal force on the surface, over many of its places and its corners [m]."""
    surface = problem.debris.surface
    count = len(surface.face_names())
    places = jnp.asarray(2.0 * qmc.Sobol(2, rng=np.random.default_rng(0)).random(draws) - 1.0)
    corners = jnp.asarray([(a, b) for a in (-1.0, 0.0, 1.0) for b in (-1.0, 0.0, 1.0)])
    # Just inside, where the normal is still the face's own: there the largest arm of a flat face or a cylinder is.
    places = jnp.concatenate([places, (1.0 - 1e-9) * corners])

    def lever(face, place):
        point = surface.place(face, place)
        return jnp.linalg.norm(jnp.cross(point, surface.find_foot(point).normal))

    faces = jnp.arange(count)
    return float(jnp.max(jax.vmap(lambda face: jax.vmap(lambda place: lever(face, place))(places))(faces)))


def move_on(problem: Problem, plan: StrikePlan) -> Problem:
    """The problem of the next impact: the motion that this one left, time counted from its separation."""
    return eqx.tree_at(lambda p: (p.attitude, p.angular_velocity), problem,
                       (plan.collision.attitude, plan.collision.angular_velocity))


def plan_sequence(problem: Problem, share: float, most: int, *, starts: int = STARTS, seed: int = 0,
                  revise: Callable[[Problem, StrikePlan], StrikePlan] | None = None,
                  progress: Callable[[str], object] | None = None) -> Sequence:
    """Plan impacts one after the other, each the best from what the one before left, its wait chosen too.

    Args:
        problem: of the first impact; `limits.window` is the shortest and longest wait.
        share: of the angular momentum at which it ends [-].
        most: impacts at most.
        starts, seed: as of `plan_strike`.
        revise: changes each plan, for what is uncertain; the motion goes on as the best estimate has it.
        progress: told one line at a time.

    Raises:
        ComputationError: where not even a first impact could be planned.
    """
    names, now, time, left = problem.debris.surface.face_names(), problem, 0.0, 1.0
    impacts: list[StrikePlan] = []
    instants: list[float] = []
    shares: list[float] = []
    refused = None
    while left > share and len(impacts) < most:
        try:
            near = [(names.index(one.face), one.x) for one in impacts[-1:]]
            plan = plan_strike(now, starts=starts, seed=seed + len(impacts), near=near)
        except ComputationError:
            if not impacts:
                raise
            break
        if revise is not None and plan.allowed:
            plan = revise(now, plan)
        if not plan.worth:
            refused = plan
            break
        impacts.append(plan)
        instants.append(time + float(plan.design.instant))
        time = instants[-1] + float(plan.collision.separation)
        left = measure_share(problem, np.asarray(plan.collision.angular_velocity))
        shares.append(left)
        if progress is not None:
            progress(f"impact {len(impacts)}: {100 * left:.2f} % left")
        now = move_on(now, plan)
    impulse = sum(float(jnp.linalg.norm(plan.collision.impulse)) for plan in impacts)
    relaxations = ()
    if refused is not None and not impacts and not refused.missed:
        if progress is not None:
            progress("looking for the limit that stands in the way")
        relaxations = find_relaxations(problem, list_obstacles(refused), LEAST_GAIN, seed=seed)
    return Sequence(tuple(impacts), tuple(instants), tuple(shares), impulse, left <= share,
                    bound_impacts(problem, share), find_floor(problem), refused, None, relaxations)


def list_obstacles(plan: StrikePlan) -> list[str]:
    """Constraints that stand in the way of a better plan: those that hold it; where it is not allowed, those that it
    misses or just keeps.
    """
    binding = plan.certificate.binding
    return [name for name in plan.values if name in binding and (binding[name] > 0.0 or not plan.allowed)]
