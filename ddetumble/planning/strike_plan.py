"""One impact planned by gradient: closed forms say where to start, a quadratic programme finishes, a certificate says
how well.
"""

import dataclasses as dc
import math
from collections.abc import Callable, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
from scipy.optimize import minimize, nnls

from .._display import Progress
from .._errors import ComputationError
from ..dynamics.collision import Collision
from .guesses import DRAWS, estimate_score, find_bounds, find_starts
from .strike_problem import (
    CONSTRAINTS,
    VARIABLES,
    Design,
    StrikeProblem,
    evaluate,
    evaluate_slopes,
    read_design,
    score,
    strike_debris,
)


BINDING = 1e-4  # scaled constraint, or distance of a variable from its bound, that counts as none
ALLOWED = 1e-5  # by which a scaled constraint may be missed
LOST = 10.0  # score of what cannot be computed
STARTS = 6  # of three, one seed in six ended 0.15 % behind another; of six, none of twelve did
LEAST_GAIN = 0.01  # of the score, below which another impact is not worth its while
FOUND = 0.9  # of the largest gain that closed forms see, which they must see at a plan; they err by a few per cent
WIDER, MORE, TURN = 2, 4, 1009  # further searches, their starts over those of the first, and what their seeds differ by


@dc.dataclass
class Tally:
    """How often the impact was integrated: for values, and for values with derivatives."""

    values: int = 0
    slopes: int = 0


@dc.dataclass(frozen=True)
class Certificate:
    """How well a plan is founded.

    Attributes:
        stationarity: what is left of the gradient after the binding constraints' share, over the gradient [-].
        gradient_error: largest difference of the gradient from central differences, over the gradient [-]; 1 where
            no difference could be computed.
        binding: names of the constraints and bounds that hold the plan, with their multipliers [-].
        least: smallest of the scaled constraints [-].
        margin: from the contact disc to the nearest edge [m].
    """

    stationarity: float
    gradient_error: float
    binding: dict[str, float]
    least: float
    margin: float


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

    @property
    def worth(self) -> bool:
        """Whether it is allowed, and brings down what is wanted small by `LEAST_GAIN` or more."""
        return self.allowed and self.untouched - self.score >= LEAST_GAIN * self.untouched

    @property
    def missed(self) -> bool:
        """Whether closed forms see an allowed impact that is worth its while, and the search found none."""
        return not self.worth and self.untouched - self.estimate >= LEAST_GAIN * self.untouched


class DesignSearch:
    """The problem as SciPy asks for it; each design is integrated once for its values and once for its derivatives."""

    def __init__(self, problem: StrikeProblem, face: int, tally: Tally):
        self.problem, self.face, self.tally = problem, jnp.asarray(face), tally
        self.at: tuple[bytes, Any] = (b"", None)
        self.slopes_at: tuple[bytes, Any] = (b"", None)

    def values(self, x: np.ndarray) -> np.ndarray:
        """Score and constraints of a design, shape (1 + constraints,); `LOST` where they cannot be computed."""
        if self.at[0] != x.tobytes():
            found = np.array(evaluate(self.problem, self.face, jnp.asarray(x)))
            self.tally.values += 1
            if not np.isfinite(found).all():
                found = np.full_like(found, -1.0)
                found[0] = LOST
            self.at = (x.tobytes(), found)
        return self.at[1]

    def slopes(self, x: np.ndarray) -> np.ndarray:
        """Their derivatives by the variables, shape (1 + constraints, 7)."""
        if self.slopes_at[0] != x.tobytes():
            value, slopes = evaluate_slopes(self.problem, self.face, jnp.asarray(x))
            self.tally.slopes += 1
            self.slopes_at = (x.tobytes(), np.nan_to_num(np.asarray(slopes)))
        return self.slopes_at[1]


def refine(problem: StrikeProblem, face: int, x: np.ndarray, tally: Tally, steps: int = 40
           ) -> tuple[np.ndarray, np.ndarray]:
    """Variables and values where sequential quadratic programming (SLSQP) ends from a start.

    Where that is outside what is allowed, it is begun again from there, once, without what it had learnt of curvature.
    """
    search = DesignSearch(problem, face, tally)
    bounds = find_bounds(problem, face)
    best = np.clip(x, *bounds.T)
    for _ in range(2):
        found = minimize(
            lambda z: search.values(z)[0], best, jac=lambda z: search.slopes(z)[0], method="SLSQP", bounds=bounds,
            options={"maxiter": steps, "ftol": 1e-7},
            constraints={"type": "ineq", "fun": lambda z: search.values(z)[1:], "jac": lambda z: search.slopes(z)[1:]})
        best = np.clip(found.x, *bounds.T)
        if search.values(best)[1:].min() >= -ALLOWED:
            break
    return best, search.values(best)


def plan_strike(problem: StrikeProblem, *, starts: int = STARTS, draws: int = DRAWS, seed: int = 0,
                near: Sequence[tuple[int, np.ndarray]] = (), progress: Progress | None = None
                ) -> StrikePlan:
    """Plan one impact.

    Where nothing worth its while is found, or closed forms see a much better design than the one that is, it is
    searched for again from other and more starts, `WIDER` times at most.

    Args:
        problem: what is given, allowed and wanted.
        starts: how many of the designs that closed forms find promising are refined on the integrated impact.
        draws: how many designs the closed forms look at in every generation, all at once under `vmap`; a power of 2.
        seed: of their places.
        near: faces and variables that they look at as well, such as those of the impact before.
        progress: called with a sentence and nan: how much is done is not known.

    Raises:
        ComputationError: where no start leads to an impact that can be integrated.
    """
    names, tally = problem.debris.surface.face_names(), Tally()
    untouched = float(score(problem, problem.angular_velocity))
    ends, estimate = [], untouched
    for turn in range(1 + WIDER):
        count = starts if turn == 0 else MORE * starts
        found = find_starts(problem, count, draws, seed + TURN * turn, near)
        estimate = min(estimate, found.score)
        for number, (face, x) in enumerate(found.places, 1):
            if progress is not None:
                progress(f"start {number} of {count}, {names[face]}", math.nan)
            x, values = refine(problem, face, x, tally)
            if values[0] < LOST:
                ends.append((bool(values[1:].min() >= -ALLOWED), float(values[0]), face, x, values))
        ends.sort(key=lambda end: (not end[0], end[1]))
        if not ends or not ends[0][0] or untouched - ends[0][1] < LEAST_GAIN * untouched:
            continue
        # Closed forms against closed forms: what they promise everywhere alike, no search can find.
        _, _, face, x, _ = ends[0]
        if untouched - estimate_score(problem, face, x, draws) >= FOUND * (untouched - estimate):
            break
    if not ends:
        raise ComputationError("no impact could be planned: from no start was the contact integrated to separation")
    allowed, best, face, x, values = ends[0]
    design = read_design(problem, jnp.asarray(face), jnp.asarray(x))
    collision = strike_debris(problem, design)
    return StrikePlan(
        names[face], x, best, untouched, estimate, dict(zip(CONSTRAINTS, map(float, values[1:]), strict=True)), design,
        collision, allowed, certify(problem, face, x, float(collision.margin)), tally,
        tuple((names[end[2]], end[1], end[0]) for end in ends))


def certify(problem: StrikeProblem, face: int, x: np.ndarray, margin: float) -> Certificate:
    """First-order optimality by the least squares of the multipliers, and the gradient against differences."""
    number = jnp.asarray(face)
    value, slopes = (np.asarray(one) for one in evaluate_slopes(problem, number, jnp.asarray(x)))
    bounds = find_bounds(problem, face)

    def wanted(x):
        found = np.asarray(evaluate(problem, number, jnp.asarray(x)))
        return float(found[0]) if np.isfinite(found).all() else np.nan

    return weigh_constraints(wanted, value, slopes, bounds, x, margin)


def weigh_constraints(wanted: Callable[[np.ndarray], float], value: np.ndarray, slopes: np.ndarray, bounds: np.ndarray,
                      x: np.ndarray, margin: float, step: float = 1e-4, *, constraints: Sequence[str] = CONSTRAINTS,
                      variables: Sequence[str] = VARIABLES) -> Certificate:
    """Certificate of a point.

    Args:
        wanted: what is to be small, of the variables; NaN where it cannot be computed, which is left out.
        value: of that and of all constraints, shape (1 + constraints,).
        slopes: by the variables, shape (1 + constraints, variables).
        bounds: of the variables, shape (variables, 2).
        x: the variables.
        margin: from the contact disc to the nearest edge [m].
        step: of the differences.
        constraints, variables: their names.
    """
    gradient = slopes[0]
    names, rows = [], []
    for name, constraint, row in zip(constraints, value[1:], slopes[1:], strict=True):
        if constraint < BINDING:
            names.append(name)
            rows.append(row)
    for k, name in enumerate(variables):
        for end, sign, word in ((bounds[k, 0], 1.0, "lowest"), (bounds[k, 1], -1.0, "highest")):
            if abs(x[k] - end) < BINDING:
                names.append(f"{word} {name}")
                rows.append(sign * np.eye(len(variables))[k])
    size = float(np.linalg.norm(gradient))
    left, multipliers = size, np.zeros(0)
    if rows:
        multipliers, left = nnls(np.stack(rows, axis=1), gradient)
    central = []
    for move in step * np.eye(len(variables)):
        ahead, behind = (wanted(x + sign * move) for sign in (1.0, -1.0))
        central.append((ahead - behind) / (2.0 * step))
    apart = np.abs(gradient - central)
    known = np.isfinite(apart)
    error = (np.max(apart, initial=0.0, where=known) / size if size > 0 else 0.0) if known.any() else 1.0
    return Certificate(float(left) / size if size > 0 else 0.0, float(error),
                       dict(zip(names, map(float, multipliers), strict=True)), float(value[1:].min()), margin)
