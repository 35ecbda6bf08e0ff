"""A whole sequence as one problem: all impacts and waits change together, with the gradient through all of them."""

import dataclasses as dc
import math
import re
from collections.abc import Callable
from typing import Any

import diffrax as dfx
import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from scipy.optimize import minimize

from .._display import Progress
from .guesses import find_bounds
from .sequence import Joint, Sequence, measure_share, move_on, plan_sequence
from .strike_plan import ALLOWED, STARTS, Certificate, StrikePlan, Tally, weigh_constraints
from .strike_problem import (
    CONSTRAINTS,
    MISSED,
    VARIABLES,
    StrikeProblem,
    judge,
    read_design,
    score,
    strike_debris,
    with_slopes,
)


STATE = 7  # attitude and rates, which one impact hands on to the next
IMPULSE, DURATION, SHARE = 0, 1, 2  # places of what `follow_chain` returns before the constraints
WINDOWS = (0.3, 0.1)  # of the window, to which further sequences are planned that are to be quick


@dc.dataclass(frozen=True)
class Chain:
    """Variables of all impacts that were changed together.

    Attributes:
        x: shape (impacts, 7), over -1 to 1.
        faces: shape (impacts,).
        impulse: of all contact forces, their sizes added up [N s].
        duration: from time 0 to the last separation [s].
        share: of the angular momentum left [-].
        allowed: whether every impact's constraints and the share hold.
        certificate: of all variables together; names carry the number of the impact.
        tally: how often all impacts were integrated one after the other, certificate left out.
    """

    x: np.ndarray
    faces: np.ndarray
    impulse: float
    duration: float
    share: float
    allowed: bool
    certificate: Certificate
    tally: Tally


def _strike(problem: StrikeProblem, start: Array, state: Array, face: Array, x: Array,
            adjoint: dfx.AbstractAdjoint | None) -> Array:
    """Attitude and rates after one impact from those before it, and the impact's row, shape (7 + 3 + constraints,)."""
    now = eqx.tree_at(lambda p: (p.attitude, p.angular_velocity), problem, (state[:4], state[4:]))
    design = read_design(now, face, x)
    collision = strike_debris(now, design, adjoint)
    left = jnp.sum((problem.debris.inertia @ collision.angular_velocity) ** 2) / start
    row = jnp.concatenate([jnp.stack([jnp.linalg.norm(collision.impulse), design.instant + collision.separation, left]),
                           judge(now, design, collision)])
    # A ball that does not approach strikes nothing, which its approach says; anything else has to end.
    ended = ~collision.failed & (collision.separated | (collision.approach_speed <= MISSED * now.limits.approach))
    return jnp.concatenate([collision.attitude, collision.angular_velocity, jnp.where(ended, row, jnp.nan)])


@eqx.filter_jit
def _follow(problem: StrikeProblem, start: Array, state: Array, face: Array, x: Array) -> Array:
    return _strike(problem, start, state, face, x, None)


@eqx.filter_jit
def _follow_slopes(problem: StrikeProblem, start: Array, state: Array, face: Array, x: Array) -> tuple[Array, Array]:
    """One impact, and its derivatives by the state before and by its variables, the second shape (values, 7 + 7)."""
    return with_slopes(lambda z: _strike(problem, start, z[:STATE], face, z[STATE:], dfx.ForwardMode()),
                       jnp.concatenate([state, x]))


def _begin(problem: StrikeProblem) -> tuple[Array, Array]:
    """Square of the momentum, and state, at the start."""
    return (jnp.sum((problem.debris.inertia @ problem.angular_velocity) ** 2),
            jnp.concatenate([problem.attitude, problem.angular_velocity]))


def _add_up(rows: np.ndarray) -> np.ndarray:
    return np.concatenate([rows[:, :SHARE].sum(axis=0), rows[-1, SHARE : SHARE + 1], rows[:, SHARE + 1 :].ravel()])


def follow_impacts(problem: StrikeProblem, faces: Array, x: Array) -> np.ndarray:
    """Every impact of a sequence, each from the motion that the one before left.

    Args:
        problem: of the first impact.
        faces: shape (impacts,).
        x: shape (impacts, 7).

    Returns:
        Shape (impacts, 3 + constraints): impulse [N s], time from the last separation to its own [s], square of the
        share of |L| left after it, its constraints; NaN from the first on that could not be integrated to its end.
    """
    start, state = _begin(problem)
    rows = []
    for face, own in zip(jnp.asarray(faces), jnp.asarray(x), strict=True):
        found = _follow(problem, start, state, face, own)
        state = found[:STATE]
        rows.append(np.asarray(found[STATE:]))
        if np.isnan(rows[-1]).any():
            break
    return np.stack(rows + [np.full_like(rows[-1], np.nan)] * (len(x) - len(rows)))


def follow_chain(problem: StrikeProblem, faces: Array, x: Array) -> np.ndarray:
    """Sum of the impulses [N s], duration [s], square of the share of |L| left, and all constraints of all impacts:
    `follow_impacts` added up, shape (3 + impacts * constraints,).
    """
    return _add_up(follow_impacts(problem, faces, x))


def follow_slopes(problem: StrikeProblem, faces: Array, x: Array) -> tuple[np.ndarray, np.ndarray]:
    """The same with derivatives by all variables of all impacts, the second shape (values, impacts, 7).

    By the chain rule over the state between two impacts: an impact is differentiated by fourteen numbers, however many
    there are, by one compiled program.
    """
    count, width = x.shape
    start, state = _begin(problem)
    before = np.zeros((STATE, count, width))  # of the state, by all variables
    rows, slopes = [], []
    for k, (face, own) in enumerate(zip(jnp.asarray(faces), jnp.asarray(x), strict=True)):
        value, slope = _follow_slopes(problem, start, state, face, own)
        state, slope = value[:STATE], np.asarray(slope)
        total = np.tensordot(slope[:, :STATE], before, axes=1)
        total[:, k] += slope[:, STATE:]
        before = total[:STATE]
        rows.append(np.asarray(value[STATE:]))
        slopes.append(total[STATE:])
    every = np.stack(slopes)
    return _add_up(np.stack(rows)), np.concatenate([
        every[:, :SHARE].sum(axis=0), every[-1, SHARE : SHARE + 1], every[:, SHARE + 1 :].reshape(-1, count, width)])


class _Search:
    """The chain as SciPy asks for it: values and slopes of one point, kept until the next."""

    def __init__(self, problem: StrikeProblem, faces: np.ndarray, shape: tuple[int, ...]):
        self.problem, self.faces, self.shape, self.tally = problem, jnp.asarray(faces), shape, Tally()
        self.at: tuple[bytes, Any] = (b"", None)
        self.passed: list[tuple[np.ndarray, np.ndarray]] = []

    def look(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        if self.at[0] != z.tobytes():
            value, slopes = follow_slopes(self.problem, self.faces, jnp.asarray(z.reshape(self.shape)))
            self.tally.slopes += 1
            rows, found = np.nan_to_num(slopes).reshape(-1, z.size), value
            if not np.isfinite(found).all():  # far worse than where it began, and not allowed
                worst = 10.0 * self.passed[0][1][:3] if self.passed else np.full(3, 1e6)
                found = np.concatenate([worst, np.full(found.size - 3, -1.0)])
            self.at = (z.tobytes(), (found, rows))
            self.passed.append((z.copy(), self.at[1][0]))
        return self.at[1]

    def follow(self, z: np.ndarray) -> np.ndarray:
        self.tally.values += 1
        return follow_chain(self.problem, self.faces, jnp.asarray(z.reshape(self.shape)))


def refine_sequence(problem: StrikeProblem, sequence: Sequence, share: float, aim: str = "impulse",
                    steps: int = 80) -> Chain:
    """Change all impacts of a sequence together for the least of something, no more than a share of |L| being left.

    Args:
        problem: of the first impact.
        sequence: planned one impact after the other.
        share: of the angular momentum [-].
        aim: `impulse`, `time`, or `share` for the least momentum left.
        steps: of sequential quadratic programming at most. Where they end outside what is allowed, the best that was
            passed and is allowed is taken.
    """
    names = problem.debris.surface.face_names()
    faces = np.array([names.index(plan.face) for plan in sequence.impacts])
    first = np.stack([plan.x for plan in sequence.impacts])
    bounds = np.concatenate([find_bounds(problem, int(face)) for face in faces])
    search = _Search(problem, faces, first.shape)
    place = {"impulse": IMPULSE, "time": DURATION, "share": SHARE}[aim]
    limit = max(share, 1e-6) ** 2
    unit = {"impulse": max(sequence.impulse, 1e-300), "time": max(sequence.duration, 1e-300),
            "share": max(sequence.shares[-1], 1e-6) ** 2}[aim]
    # Where the momentum left is what is wanted small, it is no constraint as well.
    held = np.arange(3) == SHARE if aim != "share" else np.zeros(3, bool)

    def constrain(value):
        return np.concatenate([1.0 - value[:3][held] / limit, value[3:]])

    def constrain_slopes(slopes):
        return np.concatenate([-slopes[:3][held] / limit, slopes[3:]])

    found = minimize(
        lambda z: search.look(z)[0][place] / unit, first.ravel(), jac=lambda z: search.look(z)[1][place] / unit,
        method="SLSQP", bounds=bounds, options={"maxiter": steps, "ftol": 1e-6},
        constraints={"type": "ineq", "fun": lambda z: constrain(search.look(z)[0]),
                     "jac": lambda z: constrain_slopes(search.look(z)[1])})
    def is_allowed(value):
        return bool(value[3:].min() >= -ALLOWED and np.sqrt(max(value[SHARE], 0.0)) <= share * (1 + 1e-3))

    best = np.clip(found.x, *bounds.T)
    if not is_allowed(search.look(best)[0]):
        best = min((value[place], k, z) for k, (z, value) in enumerate([(best, np.full(3, np.inf)), *search.passed])
                   if k == 0 or is_allowed(value))[2]
    value, slopes = search.look(best)
    proof = weigh_constraints(
        lambda z: float(search.follow(z)[place]) / unit, np.concatenate([[value[place] / unit], constrain(value)]),
        np.concatenate([slopes[place : place + 1] / unit, constrain_slopes(slopes)]), bounds, best, 0.0,
        constraints=["share left"] * int(held.sum()) + [f"{k + 1}: {name}" for k in range(len(faces))
                                                        for name in CONSTRAINTS],
        variables=[f"{k + 1}: {name}" for k in range(len(faces)) for name in VARIABLES])
    left = float(np.sqrt(max(value[SHARE], 0.0)))
    return Chain(best.reshape(first.shape), faces, float(value[IMPULSE]), float(value[DURATION]), left,
                 is_allowed(value), proof, Tally(0, search.tally.slopes))


def read_chain(problem: StrikeProblem, sequence: Sequence, chain: Chain, share: float) -> Sequence:
    """A chain as a sequence of plans, each with the chain's certificate as far as it is about that impact."""
    names, now, time = problem.debris.surface.face_names(), problem, 0.0
    plans, instants, shares = [], [], []
    for k, (face, x) in enumerate(zip(chain.faces, chain.x, strict=True)):
        design = read_design(now, jnp.asarray(face), jnp.asarray(x))
        collision = strike_debris(now, design)
        values = np.asarray(judge(now, design, collision))
        about = _pick(chain.certificate.binding, k + 1)
        worth = float(score(now, collision.angular_velocity))
        allowed = bool(values.min() >= -ALLOWED and collision.separated and not collision.failed)
        proof = dc.replace(chain.certificate, binding=about, least=float(values.min()), margin=float(collision.margin))
        plans.append(StrikePlan(
            names[int(face)], x, worth, float(score(now, now.angular_velocity)), worth,
            dict(zip(CONSTRAINTS, map(float, values), strict=True)), design, collision, allowed, proof, chain.tally,
            ((names[int(face)], worth, allowed),)))
        instants.append(time + float(design.instant))
        time = instants[-1] + float(collision.separation)
        shares.append(measure_share(problem, np.asarray(collision.angular_velocity)))
        now = move_on(now, plans[-1])
    impulse = sum(float(jnp.linalg.norm(plan.collision.impulse)) for plan in plans)
    reached = all(plan.allowed for plan in plans) and shares[-1] <= share * (1 + 1e-3)
    return dc.replace(sequence, impacts=tuple(plans), instants=tuple(instants), shares=tuple(shares), impulse=impulse,
                      reached=reached)


def _pick(binding: dict[str, float], number: int) -> dict[str, float]:
    """What holds one impact, of what holds the chain: `3: edge`, `lowest 3: instant`, `share left`."""
    mark = re.compile(rf"(?<!\d){number}: ")
    return {mark.sub("", name): size for name, size in binding.items() if mark.search(name) or ": " not in name}


def plan_together(problem: StrikeProblem, share: float, most: int, *, aim: str = "impacts", starts: int = STARTS,
                  seed: int = 0, progress: Progress | None = None) -> Sequence:
    """Plan impacts one after the other, and change them all together.

    Args:
        problem, share, most, starts, seed, progress: as of `plan_sequence`.
        aim: `impacts` tries to do with one impact less, again and again; `impulse` brings the sum of all impulses down;
            `time` the instant of the last separation, from sequences with long and with short waits.

    Returns:
        The best sequence; that of `plan_sequence` where nothing better was found. Where it does not reach the share in
        `most` impacts, that many are changed together for the least momentum left.
    """
    def tell(text: str) -> None:
        if progress is not None:
            progress(text, math.nan)

    found = plan_sequence(problem, share, most, starts=starts, seed=seed, progress=progress)
    if not found.reached:
        return _press_on(problem, found, share, most, tell)
    if aim == "impacts":
        return _shorten(problem, found, share, tell)
    begun = [found]
    if aim == "time":
        low, high = np.asarray(problem.limits.window)
        for part in WINDOWS:
            tell(f"waits of at most {low + part * (high - low):.0f} s")
            hasty = eqx.tree_at(lambda p: p.limits.window, problem, jnp.asarray([low, low + part * (high - low)]))
            other = plan_sequence(hasty, share, most, starts=starts, seed=seed, progress=progress)
            if other.reached:
                begun.append(_widen(other, part))
    best = found
    for one in begun:
        tell(f"all {len(one.impacts)} impacts together")
        chain = refine_sequence(problem, one, share, aim)
        if not chain.allowed:
            continue
        again = read_chain(problem, one, chain, share)
        if again.reached and _worth(again, aim) < _worth(best, aim):
            best = again
    return best if best is found else dc.replace(best, joint=_compare(aim, found, best))


def _compare(aim: str, alone: Sequence, joint: Sequence | Chain) -> Joint:
    """What optimising jointly came to: a sequence that is taken, or a chain that is not."""
    before = (len(alone.impacts), alone.shares[-1], alone.impulse, alone.duration)
    if isinstance(joint, Chain):
        return Joint(aim, False, len(joint.faces), joint.share, joint.impulse, joint.duration, before)
    return Joint(aim, True, len(joint.impacts), joint.shares[-1], joint.impulse, joint.duration, before)


def _worth(sequence: Sequence, aim: str) -> float:
    return sequence.impulse if aim == "impulse" else sequence.duration


def _widen(sequence: Sequence, part: float) -> Sequence:
    """Plans within a part of the window, in the variables of the whole window."""
    def widen(x):
        y = x.copy()
        y[-1] = part * (x[-1] + 1.0) - 1.0
        return y

    return dc.replace(sequence, impacts=tuple(dc.replace(plan, x=widen(plan.x)) for plan in sequence.impacts))


def _press_on(problem: StrikeProblem, sequence: Sequence, share: float, most: int, tell: Callable[[str], object]
              ) -> Sequence:
    """As many impacts as are allowed, which one after the other leave too much, changed together for the least left."""
    if len(sequence.impacts) < max(most, 2) or len(sequence.impacts) < sequence.bound:
        return sequence
    tell(f"{len(sequence.impacts)} impacts together")
    chain = refine_sequence(problem, sequence, share, "share")
    again = read_chain(problem, sequence, chain, share) if chain.allowed else None
    if again is None or not again.reached:
        return dc.replace(sequence, joint=_compare("share", sequence, chain))
    return dc.replace(again, joint=_compare("share", sequence, again))


def _shorten(problem: StrikeProblem, sequence: Sequence, share: float, tell: Callable[[str], object]) -> Sequence:
    """Leave the last impact out and bring the momentum down with the others, as long as that works."""
    alone, tried = sequence, None
    while len(sequence.impacts) > max(sequence.bound, 1):
        fewer = dc.replace(sequence, impacts=sequence.impacts[:-1], instants=sequence.instants[:-1],
                           shares=sequence.shares[:-1])
        tell(f"{len(fewer.impacts)} impacts together")
        chain = refine_sequence(problem, fewer, share, "share")
        again = read_chain(problem, sequence, chain, share) if chain.allowed else None
        if again is None or not again.reached:
            tried = _compare("impacts", alone, chain)
            break
        sequence = again
    return dc.replace(sequence, joint=tried if sequence is alone else _compare("impacts", alone, sequence))
