"""Progressive horizon: records that run on from where they start are fitted over ever longer stretches.

A wrong inertia ratio turns the model out of step with the measurement, by many turns at the end of a long record, and
the sum of squares has a minimum at every turn. Over the first radian there is but one; what is learnt there keeps the
next horizon, three times as far, in step.

Values, one a record, have a ladder of their own: what they feel most first, then one parameter more at a time.
"""

import dataclasses as dc
from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np

from .problem import Problem, Solution
from .stack import Stack


FIRST = 2.5  # rad, of the first horizon: less than half a turn, so that no start is out of step there
GROWTH = 3.0  # from horizon to horizon: larger, the model may be out of step at the next; smaller, there are more fits
FEWEST = 8  # samples in it: more than a record has free starts
MOST = 1024  # samples a record, of those up to a horizon: a fit on the way need not be the best
LOST = 100.0  # chi-square a sample beyond which a model is out of step, or poor enough to become so: ten deviations


def is_lost(problem: Problem, solution: Solution) -> bool:
    """Whether a fit leaves so much that it may be out of step with its records."""
    return problem.space.family.free_running and (
        bool(solution.failed) or solution.chi2 > LOST * float(problem.records.used.sum()))


def _cut(stack: Stack, horizon: np.ndarray) -> Stack:
    """Records up to a horizon, shape (records,) [s], and of those not more than `MOST` samples, evenly spread."""
    time, weights = np.asarray(stack.time), np.asarray(stack.weights)
    near = (time <= horizon[:, None]) & np.any(weights > 0, axis=1)
    values, taps, mesh = stack.values, stack.taps, np.asarray(stack.inputs["mesh"])
    if time.shape[1] > MOST:
        # Neighbours are left out, so that nothing is predicted from them: what is left counts as white.
        places = [np.flatnonzero(row) if row.any() else np.zeros(1, dtype=int) for row in near]
        places = [at[np.unique(np.linspace(0, len(at) - 1, min(len(at), MOST)).astype(int))] for at in places]
        near = np.arange(MOST)[None, :] < np.array([len(at) for at in places])[:, None]
        chosen = np.stack([np.pad(at, (0, MOST - len(at)), mode="edge") for at in places])
        rows = np.arange(len(time))[:, None]
        time, weights = time[rows, chosen], np.moveaxis(weights[rows, :, chosen], 2, 1)
        values = np.moveaxis(np.asarray(stack.values)[rows, :, chosen], 2, 1)
        taps = np.zeros((*values.shape, stack.taps.shape[-1]))
    return dc.replace(stack, time=jnp.asarray(np.minimum(time, horizon[:, None])), values=jnp.asarray(values),
                      weights=jnp.asarray(weights * near[:, None, :]), taps=jnp.asarray(taps),
                      inputs=stack.inputs | {"mesh": jnp.asarray(mesh * (horizon / mesh[:, -1])[:, None])})


def solve_progressively(problem: Problem, free: Sequence[str], start: np.ndarray, z: np.ndarray | None = None,
                        **options) -> Solution:
    """Fit as `Problem.solve` does, free-running records over a growing horizon first, and values where that does not
    converge parameter after parameter; options are of the last fit.
    """
    if problem.records.are_values:
        found = problem.solve(free, start, z, **options)
        return found if found.converged else _solve_one_by_one(problem, free, start, z, found, **options)
    if not problem.space.family.free_running:
        return problem.solve(free, start, z, **options)
    whole, lengths = problem.records.stack, problem.records.lengths
    times = np.asarray(whole.time)
    speeds = np.sqrt(sum(np.asarray(whole.values)[:, k] ** 2 for k in range(3))).max(axis=1)
    end = times.max(axis=1)
    horizon = np.maximum(FIRST / np.maximum(speeds, 1e-300), times[:, min(FEWEST, lengths.min() - 1)])
    u, share = np.array(start, dtype=float), z
    while np.any(horizon < end):
        part = Problem(problem.space, dc.replace(problem.records, stack=_cut(whole, np.minimum(horizon, end))),
                       problem.priors)
        found = part.solve(free, u, share, tolerance=1e-2)
        if not found.failed and np.isfinite(found.chi2):
            u, share = found.u, found.z
        horizon = GROWTH * horizon
    return problem.solve(free, u, share, **options)


def _solve_one_by_one(problem: Problem, free: Sequence[str], start: np.ndarray, z: np.ndarray | None, plain: Solution,
                      **options) -> Solution:
    """Fit what the values feel most, with the rest where it starts, then one parameter more with each fit; the `plain`
    fit where that leaves less.

    Far from the values a parameter that they hardly feel runs to where nothing depends on it, and holds the others.
    """
    felt = np.linalg.norm(problem.solve(free, start, z, moving=False).flattened()[0], axis=0)
    order = [free[int(k)] for k in np.argsort(-felt)]
    u, share = np.array(start, dtype=float), z
    for count in range(1, len(order)):
        part = problem.solve(order[:count], u, share, tolerance=1e-2)
        if not part.failed and np.isfinite(part.chi2):
            u, share = part.u, part.z
    found = problem.solve(free, u, share, **options)
    return plain if found.failed or not found.chi2 < plain.chi2 else found
