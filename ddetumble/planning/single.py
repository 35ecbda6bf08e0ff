"""One impact planned by gradient: closed forms say where to start, a quadratic programme finishes, a certificate says
how well.
"""

import dataclasses as dc
import math
from collections.abc import Callable, Mapping, Sequence
from typing import TypeVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from scipy.optimize import minimize, nnls

from .._display import Progress, stay_silent
from .._errors import ComputationError
from ..dynamics.collision import Collision
from .constraints import CONSTRAINTS, evaluate, evaluate_slopes, judge
from .multistart import Place, estimate_score, find_bounds, find_starts, pick_apart
from .problem import VARIABLES, Design, StrikeProblem, read_design, score, strike_debris


# Scaled constraint, or distance of a variable from its bound, that counts as none: what the quadratic programme leaves.
BINDING = 1e-4
ALLOWED = 1e-5  # by which a scaled constraint may be missed: its tolerance
LOST = 10.0  # score of what cannot be computed: far above that of any strike
GAINED = 1e-5  # of the score, below which a descent that is begun again where it ended is at its end
# Share of the score before, within which two designs are as good, as the search itself leaves that open: the earlier
# one is struck, as what is not known of the motion grows with time.
EVEN = 5e-4
ROUNDS = 4  # descents from one start at most: narrow valleys took three
BEST = 2  # ends of descents that are begun again
STEPS = 40  # of the quadratic programme at most: it ends by itself well before, or has no optimum near
STARTS = 6  # of three, one seed in six ended 0.15 % behind another; of six, none of twelve did
# Of the score, below which another impact is not worth its while: as little as the wanted share by default.
LEAST_GAIN = 0.01
NEARLY = 0.8  # of that, from which another search may find it: seeds differ by a tenth where optima are many and narrow
FOUND = 0.9  # of the largest gain that closed forms see, which they must see at a plan; they err by a few per cent
# Further searches, their starts over those of the first, and what their seeds differ by (a prime: no two coincide).
WIDER, MORE, TURN = 2, 4, 1009
# Share of the gradient left over, from which a plan is not called an optimum: 2 %, above what differences of it err by.
ROUGH = 0.02
STEP = 1e-4  # of the differences that a gradient is checked by: between rounding (smaller) and curvature (larger)

T = TypeVar("T")


@dc.dataclass
class Tally:
    """How often the impact was integrated: for values, and for values with derivatives."""

    values: int = 0
    slopes: int = 0


@dc.dataclass(frozen=True)
class Certificate:
    """How well a plan is founded."""

    stationarity: float  # what is left of the gradient after the binding constraints' share, over the gradient [-]
    # Largest difference of the gradient from central differences, over the gradient [-]; 1 where there is none.
    gradient_error: float
    binding: dict[str, float]  # names of the constraints and bounds that hold the plan, with their multipliers [-]


@dc.dataclass(frozen=True)
class StrikePlan:
    """One planned impact.

    Attributes:
        face: name of the face.
        x: the seven variables over -1 to 1.
        score: what was wanted small.
        untouched: the same without an impact.
        estimate: the least that closed forms see allowed; never a plan's result.
        values: of all constraints, by name, scaled.
        design, collision: the impact in physical quantities, and what it does.
        allowed: whether every constraint holds.
        certificate: see there.
        tally: integrations that it took, certificate left out.
        scores: of all starts, where they ended and whether that was allowed.
        others: faces and variables where other starts ended allowed, apart from the plan and from each other.
    """

    face: str
    x: np.ndarray
    score: float
    untouched: float
    estimate: float
    values: dict[str, float]
    design: Design
    collision: Collision
    allowed: bool
    certificate: Certificate
    tally: Tally
    scores: tuple[tuple[str, float, bool], ...]
    others: tuple[Place, ...] = ()

    @property
    def place(self) -> Place:
        """Number of the face, and the variables."""
        return int(self.design.face), self.x

    @property
    def broken(self) -> list[str]:
        """Names of the constraints that it violates, the farthest first."""
        return [name for name, value in sorted(self.values.items(), key=lambda item: item[1]) if value < -ALLOWED]

    @property
    def worth(self) -> bool:
        """Whether it is allowed, and brings down what is wanted small by `LEAST_GAIN` or more."""
        return self.allowed and self.untouched - self.score >= LEAST_GAIN * self.untouched

    @property
    def nearly(self) -> bool:
        """Whether it is not worth its while, by so little that another search may find one that is."""
        return not self.worth and self.allowed and self.untouched - self.score >= NEARLY * LEAST_GAIN * self.untouched

    @property
    def missed(self) -> bool:
        """Whether closed forms see an allowed impact that is worth its while, and the search found none."""
        return not self.worth and self.untouched - self.estimate >= LEAST_GAIN * self.untouched


def remember(function: Callable[[np.ndarray], T]) -> Callable[[np.ndarray], T]:
    """The function with its last point kept: SciPy asks for what is wanted and for the constraints in turn."""
    last: dict[bytes, T] = {}

    def ask(x: np.ndarray) -> T:
        if x.tobytes() not in last:
            found = function(x)
            last.clear()
            last[x.tobytes()] = found
        return last[x.tobytes()]

    return ask


def descend(values: Callable[[np.ndarray], np.ndarray], slopes: Callable[[np.ndarray], np.ndarray], x: np.ndarray,
            bounds: np.ndarray, steps: int, ftol: float = 1e-7) -> np.ndarray:
    """Where sequential quadratic programming (SLSQP) ends, shape (variables,); within bounds of shape (variables, 2),
    after so many steps at most, or where what is to be small changes by less than `ftol`.

    `values` gives what is to be small, then all that must not be negative, shape (1 + constraints,); `slopes` their
    derivatives, shape (1 + constraints, variables).
    """
    found = minimize(  # SLSQP reads a gradient as if it were contiguous, whether it is or not
        lambda z: values(z)[0], x, jac=lambda z: np.ascontiguousarray(slopes(z)[0]), method="SLSQP", bounds=bounds,
        options={"maxiter": steps, "ftol": ftol},
        constraints={"type": "ineq", "fun": lambda z: values(z)[1:], "jac": lambda z: slopes(z)[1:]})
    return np.clip(found.x, *bounds.T)


def compute_impact(problem: StrikeProblem, face: int, x: np.ndarray, error: Mapping[str, Array] | None = None
                   ) -> np.ndarray:
    """Score and constraints of a design, shape (1 + constraints,); `LOST` and not allowed where there are none."""
    found = np.asarray(evaluate(problem, jnp.asarray(face), jnp.asarray(x), error=error))
    return found if np.isfinite(found).all() else np.array([LOST] + [-1.0] * (found.size - 1))


def compute_slopes(problem: StrikeProblem, face: int, x: np.ndarray, error: Mapping[str, Array] | None = None
                   ) -> tuple[np.ndarray, np.ndarray]:
    """The same with derivatives by the variables, the second shape (1 + constraints, 7), zero where they are none."""
    found, slopes = (np.asarray(one) for one in evaluate_slopes(problem, jnp.asarray(face), jnp.asarray(x), error))
    found = found if np.isfinite(found).all() else np.array([LOST] + [-1.0] * (found.size - 1))
    return found, np.nan_to_num(slopes)


def ask_scipy(problem: StrikeProblem, face: int, tally: Tally) -> tuple[Callable, Callable]:
    """Values and slopes of one face as `descend` takes them, each design integrated once for either, and counted."""
    def values(x):
        tally.values += 1
        return compute_impact(problem, face, x)

    def slopes(x):
        tally.slopes += 1
        return compute_slopes(problem, face, x)[1]

    return remember(values), remember(slopes)


def refine(problem: StrikeProblem, face: int, x: np.ndarray, tally: Tally, rounds: int = ROUNDS
           ) -> tuple[np.ndarray, np.ndarray]:
    """Variables and values of the best allowed design that a descent from a start passed, or where it ended.

    Where it gained something, or no design was allowed, it is begun again from there, without what it had learnt of
    curvature, so many times at most.
    """
    values, slopes = ask_scipy(problem, face, tally)
    bounds, passed = find_bounds(problem, face), []

    def ask(z):
        found = values(z)
        if found[1:].min() >= -ALLOWED and (not passed or found[0] < passed[-1][1][0]):
            passed.append((z.copy(), found))
        return found

    best, worth = np.clip(x, *bounds.T), math.inf
    for _ in range(rounds):
        end = descend(ask, slopes, best, bounds, STEPS)
        best = passed[-1][0] if passed else end
        if passed and worth - passed[-1][1][0] < GAINED:
            break
        worth = passed[-1][1][0] if passed else worth
    return best, passed[-1][1] if passed else values(best)


def plan_strike(problem: StrikeProblem, *, starts: int = STARTS, seed: int = 0, near: Sequence[Place] = (),
                progress: Progress | None = None) -> StrikePlan:
    """Plan one impact.

    Where nothing worth its while is found, or closed forms see a much better design than the one that is, it is
    searched for again from other and more starts, `WIDER` times at most. Of designs as good the earliest is taken.

    Args:
        problem: what is given, allowed and wanted.
        starts: how many of the designs that closed forms find promising are refined on the integrated impact.
        seed: of their places.
        near: faces and variables that they look at as well, such as those of the impact before.
        progress: called with a sentence at every descent, and nan.

    Raises:
        ComputationError: where no start leads to an impact that can be integrated.
    """
    names, tally = problem.debris.surface.face_names(), Tally()
    untouched = float(score(problem, problem.angular_velocity))
    ends, estimate, tell = [], untouched, progress or stay_silent

    def finish(face: int, x: np.ndarray, rounds: int, told: str) -> (
            tuple[bool, float, int, np.ndarray, np.ndarray] | None):
        """Where a descent ends: whether that is allowed, score, design and all values; None where nothing strikes."""
        tell(f"{told} ({tally.values + tally.slopes} contacts integrated)", math.nan)
        x, values = refine(problem, face, x, tally, rounds)
        worth = float(values[0])
        return (bool(values[1:].min() >= -ALLOWED), worth, face, x, values) if worth < LOST else None

    def order(end) -> tuple[bool, float]:
        return not end[0], end[1]

    for turn in range(1 + WIDER):
        count = starts if turn == 0 else MORE * starts
        more = f"search {turn + 1}, " * (turn > 0)
        tell(f"{more}choosing starts by closed forms", math.nan)
        places, least = find_starts(problem, count, seed=seed + TURN * turn, near=near)
        estimate = min(estimate, least)
        ends += [end for k, (face, x) in enumerate(places, 1)
                 if (end := finish(face, x, 1, f"{more}descent {k} of {len(places)}"))]
        ends.sort(key=order)
        best = ends[:BEST]
        ends[:BEST] = [finish(end[2], end[3], ROUNDS, f"{more}descent again from the best, {k} of {len(best)}") or end
                       for k, end in enumerate(best, 1)]
        ends.sort(key=order)
        if not ends or not ends[0][0] or untouched - ends[0][1] < LEAST_GAIN * untouched:
            continue
        # Closed forms against closed forms: what they promise everywhere alike, no search can find.
        if untouched - estimate_score(problem, *ends[0][2:4]) >= FOUND * (untouched - estimate):
            break
    if not ends:
        raise ComputationError("no impact could be planned: the contact could not be integrated to separation from "
                               "any start")
    even = [end for end in ends if end[0] == ends[0][0] and end[1] - ends[0][1] <= EVEN * untouched]
    first = min(even, key=lambda end: float(read_design(problem, jnp.asarray(end[2]), jnp.asarray(end[3])).instant))
    if all(first is not end for end in ends[:BEST]):
        again = finish(first[2], first[3], ROUNDS, "descent again from the earliest of those that are as good")
        first, late = again or first, first
        ends = [first if end is late else end for end in ends]
    ends = [first, *(end for end in ends if end is not first)]
    _, _, face, x, values = first
    value, slopes = (np.asarray(one) for one in evaluate_slopes(problem, jnp.asarray(face), jnp.asarray(x)))
    [certificate] = certify(lambda z: float(evaluate(problem, jnp.asarray(face), jnp.asarray(z))[0]), value, slopes,
                            find_bounds(problem, face), x)
    plan = make_plan(problem, face, x, certificate, tally, values, estimate=estimate,
                     scores=tuple((names[end[2]], end[1], end[0]) for end in ends))
    others = pick_apart([(end[2], end[3]) for end in ends if end[0]], len(ends))
    return dc.replace(plan, others=tuple(others[1:]))


def make_plan(problem: StrikeProblem, face: int, x: np.ndarray, certificate: Certificate, tally: Tally,
              values: np.ndarray | None = None, slack: float = ALLOWED, *, estimate: float | None = None,
              scores: tuple[tuple[str, float, bool], ...] = ()) -> StrikePlan:
    """The plan of variables, and of score and constraints, shape (1 + constraints,), where these are not those of the
    impact itself. Where closed forms say nothing of it, the estimate is that nothing is gained.
    """
    design = read_design(problem, jnp.asarray(face), jnp.asarray(x))
    collision = strike_debris(problem, design)
    if values is None:
        values = np.array([score(problem, collision.angular_velocity), *judge(problem, design, collision)])
    worth, kept = float(values[0]), dict(zip(CONSTRAINTS, map(float, values[1:]), strict=True))
    allowed = bool(min(kept.values()) >= -slack and collision.separated and not collision.failed)
    name, untouched = problem.debris.surface.face_names()[face], float(score(problem, problem.angular_velocity))
    return StrikePlan(
        name, x, worth, untouched, untouched if estimate is None else estimate, kept, design, collision, allowed,
        certificate, tally, scores or ((name, worth, allowed),))


def certify(wanted: Callable[[np.ndarray], float], value: np.ndarray, slopes: np.ndarray, bounds: np.ndarray,
            x: np.ndarray, shared: Sequence[str] = ()) -> list[Certificate]:
    """First-order optimality of one impact or several by the least squares of the multipliers, the gradient against
    differences, and for every impact the multipliers of what holds it.

    Args:
        wanted: what is to be small, of the variables; NaN where it cannot be computed, which is left out.
        value, slopes: of that and of all constraints, the `shared` ones by name first, then those of every impact; as
            `descend` takes them.
        bounds: of the variables, shape (variables, 2).
        x: the variables, those of one impact after those of the other.
        shared: names of constraints that are not of one impact alone.
    """
    gradient, unit, impacts = slopes[0], np.eye(len(x)), range(len(x) // len(VARIABLES))
    # Named by the impact, None where it is of all.
    names = [*((None, name) for name in shared), *((k, name) for k in impacts for name in CONSTRAINTS)]
    rows = {name: row for name, constraint, row in zip(names, value[1:], slopes[1:], strict=True)
            if constraint < BINDING}
    for (k, name), own, row, (low, high) in zip(
            [(k, name) for k in impacts for name in VARIABLES], x, unit, bounds, strict=True):
        rows |= {(k, f"lowest {name}"): row} if abs(own - low) < BINDING else {}
        rows |= {(k, f"highest {name}"): -row} if abs(own - high) < BINDING else {}
    size = float(np.linalg.norm(gradient))
    multipliers, left = nnls(np.stack(list(rows.values()), axis=1), gradient) if rows else (np.zeros(0), size)
    apart = np.abs(gradient - [(wanted(x + move) - wanted(x - move)) / (2.0 * STEP) for move in STEP * unit])
    known = np.isfinite(apart)
    error = (np.max(apart, initial=0.0, where=known) / size if size > 0 else 0.0) if known.any() else 1.0
    return [Certificate(float(left) / size if size > 0 else 0.0, float(error), {
        name: float(m) for (k, name), m in zip(rows, multipliers, strict=True) if k in (number, None)})
        for number in impacts]
