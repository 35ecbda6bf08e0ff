"""Least squares with bounds: parameters that want to leave theirs are held there, and let go where they turn back."""

import dataclasses as dc
from collections.abc import Mapping, Sequence

import numpy as np

from . import distributions as stats
from .problem import AbstractProblem, Problem, Solution


ROUNDS = 40  # of holding and releasing parameters at their limits: each settles one or more, and few are needed
FINAL = 1e-3  # fits at a looser tolerance only scout, and are not tried again
PATIENCE = 3  # further fits from where one ended short: one that does not end in them is not determined
# Of its scale: so near to a limit of the model, a parameter counts as stopped by it; smaller misses those whose last
# step fell short.
NEAR = 2e-3
LITTLE = 0.1  # of the signal's sum of squares: a model that removes less does not meet it, whatever its misfit
LOUD = 4.0  # noise variances a sample: where less is left, a model that removes nothing is one of a silent record


@dc.dataclass(frozen=True)
class Bounded:
    """A fit with some parameters held at their bounds."""

    solution: Solution  # of the parameters that move
    names: tuple[str, ...]  # of all free parameters, moving or held
    held: Mapping[str, int]  # -1 or +1 for a parameter held at its lower or upper bound
    bounds: Mapping[str, tuple[float, float]]  # of coordinates, by name, where there are any

    def room(self, problem: AbstractProblem, name: str) -> tuple[float, float]:
        """Coordinates between which a parameter may lie: within its bounds and the limits of the model."""
        k, (low, high) = problem.space.index[name], self.bounds.get(name, (-np.inf, np.inf))
        return max(float(low), float(problem.limits[0][k])), min(float(high), float(problem.limits[1][k]))


def solve_bounded(problem: AbstractProblem, names: Sequence[str], start: np.ndarray, z: np.ndarray | None,
                  bounds: Mapping[str, tuple[float, float]], tolerance: float = 1e-7) -> Bounded:
    """Fit with bounds (of coordinates, by name, within the limits of the model) by an active set.

    The other arguments are those of `Problem.solve`.
    """
    index, (low, high) = problem.space.index, problem.limits
    ends = {name: bounds.get(name, (-np.inf, np.inf)) for name in names}
    held: dict[str, int] = {}
    u = start.copy()
    for name, (a, b) in bounds.items():
        inside = 1e-3 * min(problem.scales[index[name]], b - a)
        u[index[name]] = np.clip(u[index[name]], a + inside, b - inside)
    solution = _settle(problem, names, u, z, tolerance)
    for _ in range(ROUNDS):
        if solution.failed:
            break
        changed = False
        u = solution.u.copy()
        for name, (a, b) in ends.items():
            k, near = index[name], NEAR * problem.scales[index[name]]
            if name not in held and solution.u[k] <= max(a, low[k] + near):
                held[name], changed = -1, True
            elif name not in held and solution.u[k] >= min(b, high[k] - near):
                held[name], changed = 1, True
            margin = 1e-6 * problem.scales[k]
            if name in held:
                u[k] = max(a, low[k] + margin) if held[name] < 0 else min(b, high[k] - margin)
        if held and not changed:
            # The gradient says which way each wants to go; the one that gains most is let go, as that turns others.
            full = problem.solve([*solution.names, *held], u, solution.z, moving=False)
            columns, right = full.flattened()
            away = -(columns.T @ right)[len(solution.names):] * np.array(list(held.values()))
            if away.min() < 0.0:
                del held[list(held)[int(np.argmin(away))]]
                changed = True
        if not changed:
            break
        solution = _settle(problem, [n for n in names if n not in held], u, solution.z, tolerance)
    return Bounded(solution, tuple(names), held, dict(bounds))


def _settle(problem: AbstractProblem, names: Sequence[str], u: np.ndarray, z: np.ndarray | None, tolerance: float
            ) -> Solution:
    """Go on from where the optimiser ran out of steps, as long as that helps."""
    solution = problem.solve(names, u, z, tolerance=tolerance)
    for _ in range(PATIENCE if tolerance < FINAL else 0):
        if solution.converged or solution.failed:
            break
        again = problem.solve(names, solution.u, solution.z, tolerance=tolerance)
        settled = abs(solution.chi2 - again.chi2) < 1e-3 + 1e-6 * again.chi2
        solution = dc.replace(again, steps=solution.steps + again.steps, converged=again.converged or settled)
    return solution


def list_limits(problem: Problem, solution: Solution) -> dict[str, int]:
    """Free parameters that stand at a limit of the model: -1 at the lower, +1 at the upper one."""
    found = {}
    for name in solution.names:
        k = problem.space.index[name]
        for side, edges in zip((-1, 1), problem.limits, strict=True):
            if abs(solution.u[k] - edges[k]) <= NEAR * problem.scales[k]:
                found[name] = side
    return found


def explain_share(problem: Problem, solution: Solution) -> float:
    """Share of the measured sum of squares, in noise variances, that a model removes from the main channels."""
    left, whole, _ = _sum_squares(problem, solution)
    return 1.0 - left / max(whole, 1e-300)


def meets_data(problem: Problem, solution: Solution) -> bool:
    """Whether a model has any of the signal: False where its pulse lies beside the measured one, or is gone."""
    left, _, samples = _sum_squares(problem, solution)
    return left < LOUD * samples or explain_share(problem, solution) > LITTLE


def _sum_squares(problem: Problem, solution: Solution) -> tuple[float, float, int]:
    """What a model leaves of the main channels and what was measured, in noise variances, correlation left aside, as
    sums of squares; and of how many samples."""
    stack, count, main = problem.records.stack, problem.records.count, len(problem.space.family.main)
    weights, values = np.asarray(stack.weights)[:count, :main], np.asarray(stack.values)[:count, :main]
    left = np.sum((weights * (solution.channels[:, :main] - values)) ** 2)
    return float(left), float(np.sum((weights * values) ** 2)), int((weights > 0).sum())


def truncate_normal(mean: float, sd: float, low: float, high: float, level: float = 0.95) -> tuple[float, float, float]:
    """Standard deviation and interval of highest density of a normal distribution cut off at `low` and `high`.

    `mean` and `sd` are those before it is cut off. Where the density is highest at a limit the interval begins there,
    so that a true value at the limit is not always outside it, as it would be of an interval with equal tails.
    """
    if not np.isfinite(sd):
        return sd, low, high
    a, b = (low - mean) / sd, (high - mean) / sd
    if min(-a, b) > 9:  # what is cut off is lost in rounding
        half = float(stats.norm.ppf(0.5 + 0.5 * level)) * sd
        return float(sd), float(mean - half), float(mean + half)
    if max(a, -b) > 30:  # all of it is in the tail: an exponential at the nearer end
        rate = max(a, -b) / sd
        width = -np.log1p(-level) / rate
        return (1.0 / rate, low, low + width) if a > -b else (1.0 / rate, high - width, high)
    if b - a < 1e-3:  # so little room that it is level
        room = high - low
        return room / 12**0.5, low + 0.5 * (1 - level) * room, high - 0.5 * (1 - level) * room
    cut = stats.truncnorm(a, b, loc=mean, scale=sd)
    inside = stats.norm.cdf(b) - stats.norm.cdf(a)
    half = float(stats.norm.ppf(0.5 + 0.5 * level * inside)) * sd
    if mean - half < low:
        first, last = low, float(cut.ppf(level))
    elif mean + half > high:
        first, last = float(cut.ppf(1.0 - level)), high
    else:
        first, last = mean - half, mean + half
    return float(cut.std()), float(first), float(last)
