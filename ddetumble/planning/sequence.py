"""Several impacts with free motion between them: one after the other, and then all of them and all waits together."""

import dataclasses as dc
import math
from collections.abc import Callable, Mapping
from typing import Literal

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from scipy.stats import qmc

from .._display import Progress, nest_progress, stay_silent
from .._errors import ComputationError
from ..contact.effect import AbstractDriveEffect
from ..contact.gripping import Patch, StrikeLaw, find_height
from ..dynamics.impact import follow
from ..families.impact import read_values
from ..inference.programs import keep_program
from .constraints import MISSED, judge, with_slopes
from .multistart import find_bounds
from .prices import Price, Relaxation, find_relaxations, price_limits
from .problem import StrikeProblem, list_faces, measure_goal, measure_share, reach_speed, read_design, strike_debris
from .single import ALLOWED, STARTS, TURN, StrikePlan, Tally, certify, descend, make_plan, plan_strike, remember


# Of the fastest approach, at which the largest impulse is looked for; the next one of the grid bounds it.
SPEEDS = np.geomspace(0.02, 1.0, 24)
PRESSURES = np.linspace(0.0, 1.0, 5)  # over their range, for that: few, as the impulse changes slowly with the pressure
# Of the depression and of the speed, at which friction is looked at: over a decade and a half, as it may peak between.
RUBBED = np.array([0.03, 0.1, 0.3, 1.0])
# That the disc slides, from none to farther than in any contact, at which friction is looked at [m].
PATHS = np.array([0.0, 1e-3, 1e-2, 0.1])
PLACES = 4096  # of a face, among which the largest lever arm is looked for; a power of 2 for the Sobol sample
STATE = 7  # attitude and rates, which one impact hands on to the next
TOTALS = ("impulse", "time", "share")  # what `follow_impacts` returns before the constraints
IMPULSE, DURATION, SHARE = range(3)
STEPS = 80  # of a descent of all impacts together, at most: more than single impacts take, as there are more variables
SLACK = 1e-3  # of the wanted share, by which it may be missed: the optimiser's tolerance, not the user's
# Of the window, within which further sequences are planned where they can be: long waits are what costs time, and an
# impact that is the best by itself may wait until the body turns no face to the arm any more, for a second one.
WINDOWS = (0.3, 0.1)
# Searches within one turn of the body, where the window has many: each turn has optima of its own, and narrow ones are
# lost among so many. Of a drawn box four seeds in ten found the best, and in the whole window none did.
WITHIN_TURN = 3

# Share of the momentum at the start, that a page still shows: changes together that gain less are not told as a gain.
SHOWN = 1e-4

# Impacts that are changed together, or searched for again, at most where they miss the share: more take minutes.
TOGETHER = 12
# Searches from other seeds where the share is missed. Of a sequence more, as the first impacts decide what the last
# ones find: of one drawn scenario one seed in four ended 4 % of the momentum ahead. Single impacts agreed to 2e-6.
FURTHER, FURTHER_ALONE = 3, 2

Aim = Literal["impacts", "impulse", "time"]
Revise = Callable[..., StrikePlan]  # from the problem of one impact, its plan, and the `progress` that is told


@dc.dataclass(frozen=True)
class Joint:
    """What came of optimising all impacts of a sequence jointly, which were planned one after the other."""

    aim: str  # what was brought down: `impacts` (their number), `share` (of the momentum left), `impulse` or `time`
    taken: bool  # whether the sequence is the one that was optimised jointly; where not, that misses what is wanted
    impacts: int  # their number
    share: float  # of the angular momentum left [-]
    impulse: float  # sizes of all contact impulses added up [N s]
    duration: float  # from time 0 to the last separation [s]
    alone: tuple[int, float, float, float]  # the same four of the one that was planned one after the other
    prices: tuple[Price, ...] = ()  # where it was taken: what looser limits of all impacts would gain


@dc.dataclass(frozen=True)
class Sequence:
    """Planned impacts, in order."""

    impacts: tuple[StrikePlan, ...]  # each planned from the motion that the one before left
    instants: tuple[float, ...]  # of first touch, since time 0 [s]
    shares: tuple[float, ...]  # of the angular momentum left after each [-]
    impulse: float  # of all contact forces, their sizes added up [N s]
    reached: bool  # whether the wanted share was reached
    bound: int  # fewest impacts that could do it, whatever the plan; 0 where none can be given
    floor: float  # share that frictionless impacts cannot go below; 0 on surfaces without an axis of revolution
    # The best further impact where it was not worth its while or not allowed, and the sequence ended.
    refused: StrikePlan | None = None
    # What optimising all impacts jointly made of it, or what one impact less would leave; None where that was not done,
    # or made it no better.
    joint: Joint | None = None
    relaxations: tuple[Relaxation, ...] = ()  # limits each of which, looser, allows a (further) impact

    @property
    def left(self) -> float:
        """Share of the angular momentum left at the end [-]."""
        return self.shares[-1] if self.shares else 1.0

    @property
    def duration(self) -> float:
        """From time 0 to the last separation [s]."""
        return self.instants[-1] + float(self.impacts[-1].collision.separation) if self.impacts else 0.0

    @property
    def outcome(self) -> tuple[int, float, float, float]:
        """Number of impacts, share left [-], impulse [N s] and duration [s]."""
        return len(self.impacts), self.left, self.impulse, self.duration


def add_up(problem: StrikeProblem, plans: list[StrikePlan], share: float) -> Sequence:
    """The sequence of planned impacts, its bounds left out."""
    instants, time = [], 0.0
    for plan in plans:
        instants.append(time + float(plan.design.instant))
        time = instants[-1] + float(plan.collision.separation)
    shares = [measure_share(problem, plan.collision.angular_velocity) for plan in plans]
    impulse = sum(float(jnp.linalg.norm(plan.collision.impulse)) for plan in plans)
    return Sequence(tuple(plans), tuple(instants), tuple(shares), impulse, bool(plans) and shares[-1] <= share, 0, 0.0)


def find_floor(problem: StrikeProblem) -> float:
    """Share of the momentum about an axis of revolution of the surface, or a sphere's centre, which a normal force
    cannot take [-]; 0 where free motion moves momentum into that axis and out of it.
    """
    pivots = np.asarray(problem.debris.surface.find_pivots())
    along = len(pivots) == 1 and abs(float(pivots[0, 2])) > 1.0 - 1e-12
    if len(pivots) < 3 and not (problem.symmetric and along):
        return 0.0
    momentum = np.asarray(problem.debris.inertia) @ np.asarray(problem.angular_velocity)
    return float(np.linalg.norm(pivots @ momentum) / np.linalg.norm(momentum))


@keep_program(0.0)
def _press(law: StrikeLaw, given: Mapping[str, Array], deepest: Array, most: Array, speeds: Array, pressures: Array
           ) -> Array:
    """Impulse, peak force, peak depression, largest friction over a load that is at `most` so large, on a body that
    does not give way.
    """
    normal, reference = law.normal, law.reference

    def one(speed, pressure):
        conditions = {**given, "approach_speed": speed, "initial_pressure": pressure}
        values, _ = read_values(normal, conditions, follow(normal, conditions, jnp.asarray(0.5)))

        def rub(depression, slip, path):
            contact = normal.press(conditions, reference.ball.diameter(), depression)
            load = jnp.clip(contact.elastic_force, 1e-6, most)
            patch = Patch(jnp.zeros(()), depression, contact.contact_radius,
                          find_height(reference.ball.diameter(), jnp.zeros(())), contact.pressure, load,
                          conditions | {"tangential_speed": slip})
            return law.limit(patch, slip, path, jnp.zeros(())) / load

        friction = jax.vmap(jax.vmap(jax.vmap(rub, (0, None, None)), (None, 0, None)), (None, None, 0))(
            deepest * RUBBED, speed * RUBBED, jnp.asarray(PATHS))
        return jnp.stack([reference.ball.inertia() * (speed + values["rebound_speed"]), values["peak_normal_force"],
                          values["peak_depression"], jnp.max(friction)])

    return jax.vmap(jax.vmap(one, (0, None)), (None, 0))(speeds, pressures)


def bound_impacts(problem: StrikeProblem, share: float) -> int:
    r"""Fewest impacts that can leave a share of the momentum: no impact takes more than $J (\ell + \mu R)$.

    $J$ is the largest impulse that arm and limits allow on a body that does not give way (at five pressures), $\ell$
    the largest lever arm of a normal force, $\mu$ the largest friction over load (over pressures, depressions and
    speeds), $R$ the body's reach. The body never turns faster than its momentum at the start about its least axis:
    bodies that impacts spin up on the way are left out. 0 where none can be given: the arm drives the ball, so that an
    impact has no largest impulse, or no impact has a moment at all.
    """
    if any(isinstance(effect, AbstractDriveEffect) for effect in problem.law.effects):
        return 0
    limits, surface = problem.limits, problem.debris.surface
    inertia = np.asarray(problem.debris.inertia)
    size = float(np.linalg.norm(inertia @ np.asarray(problem.angular_velocity)))
    fastest = float(reach_speed(problem))
    low, high = np.asarray(limits.pressure)
    found = np.asarray(_press(problem.law, problem.conditions, limits.depression, limits.force,
                              jnp.asarray(fastest * SPEEDS), jnp.asarray(low + PRESSURES * (high - low))))
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


def find_lever(problem: StrikeProblem) -> float:
    """Largest lever arm of a normal force on the surface, over many of its places and its corners [m]."""
    surface = problem.debris.surface
    places = jnp.asarray(2.0 * qmc.Sobol(2, rng=np.random.default_rng(0)).random(PLACES) - 1.0)
    corners = jnp.asarray([(a, b) for a in (-1.0, 0.0, 1.0) for b in (-1.0, 0.0, 1.0)])
    # Just inside, where the normal is still the face's own: there the largest arm of a flat face or a cylinder is.
    places = jnp.concatenate([places, (1.0 - 1e-9) * corners])

    def lever(face, place):
        point = surface.place(face, place)
        return jnp.linalg.norm(jnp.cross(point, surface.find_foot(point).normal))

    faces = jnp.asarray(list_faces(problem))
    return float(jnp.max(jax.vmap(lambda face: jax.vmap(lambda place: lever(face, place))(places))(faces)))


def plan_sequence(problem: StrikeProblem, share: float, most: int, *, starts: int = STARTS, seed: int = 0,
                  part: float = 1.0, revise: Revise | None = None, progress: Progress | None = None) -> Sequence:
    """Plan impacts one after the other, each the best from what the one before left, its wait chosen too (within
    `limits.window`, and no shorter than `limits.shortest_wait()`), until a share of the angular momentum or less is
    left, or there are the most that may be.

    With a `part` below one every impact waits no longer than that part of the window where that is worth its while.
    `revise` changes each plan, for what is uncertain; the motion goes on as the best estimate has it. `starts` and
    `seed` are as of `plan_strike`.

    Raises:
        ComputationError: where not even a first impact could be planned.
    """
    tell, now, left = progress or stay_silent, problem, 1.0
    impacts: list[StrikePlan] = []
    refused = None
    while left > share and len(impacts) < most:
        title = f"planning impact {len(impacts) + 1}: {100 * left:.2f} % of the angular momentum left"
        tell(title, math.nan)
        inner = nest_progress(tell, title, math.nan, math.nan)
        near = [one.place for one in impacts[-1:]]
        plan = None if part == 1.0 else _hurry(now, part, starts, seed + len(impacts), near, inner)
        try:
            plan = plan or plan_strike(now, starts=starts, seed=seed + len(impacts), near=near, progress=inner)
        except ComputationError:
            if not impacts:
                raise
            break
        if plan.nearly or plan.missed:
            tell("searching from other starts", math.nan)
            plan = next((again for turn in range(1, 1 + FURTHER) if (again := _hurry(
                now, min(find_turn(now), 1.0), starts, seed + len(impacts) + TURN * turn, near, inner))), plan)
        if revise is not None and plan.allowed:
            plan = revise(now, plan, progress=inner)
        if not plan.worth:
            refused = plan
            break
        impacts.append(plan)
        left = measure_share(problem, plan.collision.angular_velocity)
        now = now.begin_after(plan.collision.attitude, plan.collision.angular_velocity)
    relaxations = ()
    if refused is not None and not impacts and not refused.missed:
        tell("looking for the limit that stands in the way", math.nan)
        relaxations = find_relaxations(problem, refused, seed=seed, progress=tell)
    return dc.replace(add_up(problem, impacts, share), bound=bound_impacts(problem, share), floor=find_floor(problem),
                      refused=refused, relaxations=relaxations)


def find_turn(problem: StrikeProblem) -> float:
    """Part of the window in which the body turns once at the rate it has [-]; infinite where it does not turn."""
    low, high = np.asarray(problem.limits.window)
    turned = float(np.linalg.norm(problem.angular_velocity)) * float(high - low)
    return 2.0 * math.pi / turned if turned > 0.0 else math.inf


def _hurry(problem: StrikeProblem, part: float, starts: int, seed: int, near: list[tuple[int, np.ndarray]],
           progress: Progress) -> StrikePlan | None:
    """The best impact within the first part of the window, in the variables of the whole one; None where there is none
    that is worth its while. The other arguments are those of `plan_strike`."""
    low, high = np.asarray(problem.limits.window)
    hasty = eqx.tree_at(lambda p: p.limits.window, problem, jnp.asarray([low, low + part * (high - low)]))
    try:
        plan = plan_strike(hasty, starts=starts, seed=seed, near=near, progress=progress)
    except ComputationError:
        return None
    return dc.replace(plan, x=np.append(plan.x[:-1], part * (plan.x[-1] + 1.0) - 1.0)) if plan.worth else None


@keep_program(0.0)
def _strike(problem: StrikeProblem, start: Array, state: Array, face: Array, x: Array,
            adjoint: dfx.AbstractAdjoint | None = None) -> Array:
    """Attitude and rates after one impact from those before it, and the impact's row, shape (7 + 3 + constraints,)."""
    now = problem.begin_at(state[:4], state[4:])
    design = read_design(now, face, x)
    collision = strike_debris(now, design, adjoint)
    left = jnp.sum((problem.debris.inertia @ collision.angular_velocity) ** 2) / start
    row = jnp.concatenate([jnp.stack([jnp.linalg.norm(collision.impulse), design.instant + collision.separation, left]),
                           jnp.stack(judge(now, design, collision))])
    # A ball that does not approach strikes nothing, which its approach says; anything else has to end.
    ended = ~collision.failed & (collision.separated | (collision.approach_speed <= MISSED * now.limits.approach))
    return jnp.concatenate([collision.attitude, collision.angular_velocity, jnp.where(ended, row, jnp.nan)])


@keep_program((0.0, 0.0))
def _strike_slopes(problem: StrikeProblem, start: Array, state: Array, face: Array, x: Array) -> tuple[Array, Array]:
    """One impact, and its derivatives by the state before and by its variables, the second shape (values, 7 + 7)."""
    return with_slopes(lambda z: _strike(problem, start, z[:STATE], face, z[STATE:], dfx.ForwardMode()),
                       jnp.concatenate([state, x]))


def _begin(problem: StrikeProblem) -> tuple[Array, Array]:
    """Square of the momentum, and state, at the start."""
    return (jnp.sum((problem.debris.inertia @ problem.angular_velocity) ** 2),
            jnp.concatenate([problem.attitude, problem.angular_velocity]))


def total(rows: np.ndarray) -> np.ndarray:
    """Impacts added up: sum of the impulses [N s], duration [s], square of the share of |L| left, and all constraints,
    shape (3 + impacts * constraints, ...), of rows of shape (impacts, 3 + constraints, ...).
    """
    return np.concatenate([rows[:, :SHARE].sum(axis=0), rows[-1, SHARE: SHARE + 1],
                           rows[:, SHARE + 1:].reshape(-1, *rows.shape[2:])])


def follow_impacts(problem: StrikeProblem, faces: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Every impact of a sequence, each from the motion that the one before left, of faces, shape (impacts,), and
    variables, shape (impacts, 7): a row each of impulse [N s], time from the last separation to its own [s], square of
    the share of |L| left after it, and its constraints, shape (impacts, 3 + constraints); NaN from the first on that
    could not be integrated to its end.
    """
    start, state = _begin(problem)
    now, rows = problem, []
    for face, own in zip(jnp.asarray(faces), jnp.asarray(x), strict=True):
        found = _strike(now, start, state, face, own)
        state = found[:STATE]
        now = now.begin_after(state[:4], state[4:])
        rows.append(np.asarray(found[STATE:]))
        if np.isnan(rows[-1]).any():
            break
    return np.stack(rows + [np.full_like(rows[-1], np.nan)] * (len(x) - len(rows)))


def follow_slopes(problem: StrikeProblem, faces: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The `total` of all impacts, with derivatives by all variables of all of them, shape (values, impacts, 7): by the
    chain rule over the state between two impacts, so that one compiled program differentiates any number of them.
    """
    start, state = _begin(problem)
    before = np.zeros((STATE, *x.shape))  # of the state, by all variables
    now, rows, slopes = problem, [], []
    for k, (face, own) in enumerate(zip(jnp.asarray(faces), jnp.asarray(x), strict=True)):
        value, slope = _strike_slopes(now, start, state, face, own)
        state, slope = value[:STATE], np.asarray(slope)
        now = now.begin_after(state[:4], state[4:])
        every = np.tensordot(slope[:, :STATE], before, axes=1)
        every[:, k] += slope[:, STATE:]
        before = every[:STATE]
        rows.append(np.asarray(value[STATE:]))
        slopes.append(every[STATE:])
    return total(np.stack(rows)), total(np.stack(slopes))


def refine_sequence(problem: StrikeProblem, sequence: Sequence, share: float, aim: str = "impulse", steps: int = STEPS,
                    progress: Progress | None = None) -> Sequence:
    """Change all impacts of a sequence, planned one after the other, together for the least `impulse`, `time` or
    `share` of the momentum left, no more than a share of |L| being left.

    Where so many steps at most of sequential quadratic programming end outside what is allowed, the best that was
    passed and is allowed is taken. `joint` says what came of it, `taken` whether that keeps all limits and, unless the
    `share` is what is to be small, the share; where it is not taken, the sequence is the one given.
    """
    faces, first = np.array([plan.place[0] for plan in sequence.impacts]), np.stack([p.x for p in sequence.impacts])
    later = problem.begin_after(problem.attitude, problem.angular_velocity)
    bounds = np.concatenate([find_bounds(later if k else problem, int(face)) for k, face in enumerate(faces)])
    place = TOTALS.index(aim)
    unit = {"impulse": max(sequence.impulse, 1e-300), "time": max(sequence.duration, 1e-300),
            "share": max(sequence.shares[-1], 1e-6) ** 2}[aim]
    # Where the momentum left is what is wanted small, it is no constraint as well.
    shared = [] if aim == "share" else ["share left"]
    passed: list[tuple[np.ndarray, np.ndarray]] = []
    tell = progress or stay_silent

    def compute(z):
        tell(f"sequence {len(passed) + 1} of impacts tried", math.nan)
        value, slopes = follow_slopes(problem, faces, z.reshape(first.shape))
        if not np.isfinite(value).all():  # far worse than where it began, and not allowed
            worst = 10.0 * passed[0][1][:3] if passed else np.full(3, 1e6)
            value = np.concatenate([worst, np.full(value.size - 3, -1.0)])
        passed.append((z.copy(), value))
        return value, np.nan_to_num(slopes).reshape(-1, z.size)

    def pose(found, one: float):
        held = (one - found[SHARE: SHARE + 1] / max(share, 1e-6) ** 2)[: len(shared)]
        return np.concatenate([found[place: place + 1] / unit, held, found[3:]])

    def is_allowed(value):
        enough = aim == "share" or np.sqrt(max(value[SHARE], 0.0)) <= share * (1 + SLACK)
        return bool(value[3:].min() >= -ALLOWED and enough)

    look = remember(compute)
    best = descend(lambda z: pose(look(z)[0], 1.0), lambda z: pose(look(z)[1], 0.0), first.ravel(), bounds, steps, 1e-6)
    if not is_allowed(look(best)[0]):
        others = [(value[place], k, z) for k, (z, value) in enumerate(passed) if is_allowed(value)]
        best = min(others)[2] if others else best
    value, slopes = look(best)
    impulse, duration, square = map(float, value[:3])
    joint = Joint(aim, False, len(faces), float(np.sqrt(max(square, 0.0))), impulse, duration, sequence.outcome)
    if not is_allowed(value):
        return dc.replace(sequence, reached=False, joint=joint)

    certificates = certify(
        lambda z: float(total(follow_impacts(problem, faces, z.reshape(first.shape)))[place]) / unit,
        pose(value, 1.0), pose(slopes, 0.0), bounds, best, shared)
    now, plans, tally = problem, [], Tally(0, len(passed))
    for face, x, certificate in zip(faces, best.reshape(first.shape), certificates, strict=True):
        plans.append(make_plan(now, int(face), x, certificate, tally))
        if not plans[-1].allowed:  # nothing begins where an impact failed
            return dc.replace(sequence, reached=False, joint=joint)
        now = now.begin_after(plans[-1].collision.attitude, plans[-1].collision.angular_velocity)
    found = add_up(problem, plans, share * (1 + SLACK))
    taken = found.reached or aim == "share"
    if taken:
        # A change of the square of the share is one of the share twice as large as that, times what is left.
        counted = unit / (2.0 * found.left) if aim == "share" and found.left > 0.0 else unit
        prices = price_limits(problem.limits, found.impacts, aim, counted)
        joint = Joint(aim, True, *found.outcome, sequence.outcome, prices)
    return dc.replace(found, reached=found.reached and taken, bound=sequence.bound, floor=sequence.floor,
                      refused=sequence.refused, joint=joint)


def plan_together(problem: StrikeProblem, share: float, most: int, *, aim: Aim = "impacts", starts: int = STARTS,
                  seed: int = 0, revise: Revise | None = None, progress: Progress | None = None) -> Sequence:
    """Plan impacts one after the other, and change them all together, unless each is revised for itself; arguments as
    of `plan_sequence`.

    The aim `impacts` tries to do with one impact less, again and again; `impulse` brings the sum of all impulses down;
    `time` the instant of the last separation, from sequences with long and with short waits. Where the share is not
    reached in `most` impacts, that many are changed together for the least momentum left, where that is the goal,
    whether or not that reaches it, and the search is repeated with short waits and from other starts, for the least of
    the goal. Where nothing better is found, the sequence is that of `plan_sequence`.
    """
    tell, momentum = progress or stay_silent, problem.goal.is_momentum()

    def remain(sequence: Sequence) -> float:
        """Share left of what is wanted small."""
        return measure_goal(problem, sequence.impacts[-1].collision.angular_velocity) if sequence.impacts else 1.0

    def change(sequence: Sequence, wanted: str, told: str, alone: Sequence) -> Sequence:
        """All impacts together; `joint` says what was aimed at, beside what those planned one after the other do."""
        title = f"planning {len(sequence.impacts)} impacts together"
        tell(title, math.nan)
        again = refine_sequence(problem, sequence, share, wanted,
                                progress=nest_progress(tell, title, math.nan, math.nan))
        assert again.joint is not None
        return dc.replace(again, joint=dc.replace(again.joint, aim=told, alone=alone.outcome))

    def improve(alone: Sequence) -> Sequence:
        """Changed together within the whole window, where that gains anything."""
        again = change(alone, "share", "share", alone)
        assert again.joint is not None
        gain = alone.left - again.left
        return again if again.joint.taken and gain > min(SLACK * alone.left, SHOWN) else alone

    def search(seed: int) -> Sequence:
        """One after the other; those that miss the share with all that there may be are changed together."""
        alone = plan_sequence(problem, share, most, starts=starts, seed=seed, revise=revise, progress=progress)
        if alone.reached or revise is not None or not momentum or not max(most, 2) <= len(alone.impacts) <= TOGETHER:
            return alone
        return improve(alone)

    def hurry(seed: int, part: float) -> Sequence:
        """With short waits, then changed together within the whole window."""
        alone = plan_sequence(problem, share, most, starts=starts, seed=seed, part=part, progress=progress)
        return improve(alone) if momentum and 0 < len(alone.impacts) <= TOGETHER else alone

    def repeat(look: Callable[..., Sequence], *given) -> list[Sequence]:
        """Another search; none where no start of it can be integrated, as there is a sequence already."""
        try:
            return [look(*given)]
        except ComputationError:
            return []

    best = search(seed)
    if revise is None and not best.reached and 0 < len(best.impacts) <= TOGETHER:
        if most > 1:
            tell("searching with shorter waits", math.nan)
            parts = [*WINDOWS, *([once] * WITHIN_TURN if (once := find_turn(problem)) < min(WINDOWS) else [])]
            hurried = [again for turn, part in enumerate(parts, FURTHER + 1)
                       for again in repeat(hurry, seed + TURN * turn, part)]
            best = min([best, *hurried], key=lambda one: (len(one.impacts), 0.0) if one.reached else
                       (math.inf, remain(one)))
        for turn in range(1, 1 + (FURTHER if most > 1 else FURTHER_ALONE)):
            if best.reached:
                break
            tell("searching from other starts", math.nan)
            for again in repeat(search, seed + TURN * turn):
                best = again if again.reached or remain(again) < remain(best) else best
    if revise is not None or not best.reached:
        return best

    found = best
    if aim == "impacts":
        while len(best.impacts) > max(best.bound, 1):
            # Without the last, the momentum that it took is brought down by the others, as long as that works.
            again = change(dc.replace(best, impacts=best.impacts[:-1], instants=best.instants[:-1],
                                      shares=best.shares[:-1]), "share", aim, found)
            if not again.reached:
                assert again.joint is not None
                alone = best is found and found.joint is None
                return dc.replace(found, joint=dc.replace(again.joint, taken=False)) if alone else best
            best = again
        return best

    begun = [found]
    for part in WINDOWS if aim == "time" else ():
        tell(f"trying short waits, {100 * part:.0f} % of the window", math.nan)
        other = plan_sequence(problem, share, most, starts=starts, seed=seed, part=part, progress=progress)
        begun += [other] if other.reached else []
    for one in begun:
        again = change(one, aim, aim, found)
        better = again.impulse < best.impulse if aim == "impulse" else again.duration < best.duration
        best = again if again.reached and better else best
    return best
