"""Fits from afar: records that run on from where they start are fitted to a growing horizon.

A wrong inertia ratio turns the model out of step with the measurement, by many turns at the end of a long record, and
the sum of squares has a minimum at every turn. Over the first radian there is but one; what is learnt there keeps the
next horizon, three times as far, in step.
"""

import dataclasses as dc
from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from .problem import Problem, Solution


FIRST = 2.5  # rad, of the first horizon
GROWTH = 3.0
FEWEST = 8  # samples in it
LOST = 100.0  # chi-square a sample beyond which a model is out of step, or poor enough to become so


def is_lost(problem: Problem, solution: Solution) -> bool:
    """Whether a fit leaves so much that it may be out of step with its records."""
    used = float((np.asarray(problem.records.stack.weights)[: problem.records.count] > 0).sum())
    return problem.space.family.free_running and (bool(solution.failed) or solution.chi2 > LOST * used)


def solve_growing(problem: Problem, free: Sequence[str], start: np.ndarray, z: np.ndarray | None = None,
                  **options) -> Solution:
    """Fit as `Problem.solve` does, free-running records over a growing horizon first.

    Args:
        problem, free, start, z: as there; without `z` every record starts from its first samples.
        options: of the last fit, over everything.
    """
    if not problem.space.family.free_running:
        return problem.solve(free, start, z, **options)
    whole = problem.records.stack
    time, end = np.asarray(whole.time), np.asarray(whole.time).max(axis=1)
    speeds = np.sqrt(sum(np.asarray(whole.values)[:, k] ** 2 for k in range(3)))
    least = time[:, min(FEWEST, time.shape[1] - 1)]
    horizon = np.maximum(FIRST / np.maximum(speeds.max(axis=1), 1e-300), least)
    u, share = np.array(start, dtype=float), z
    while np.any(horizon < end):
        near = np.minimum(horizon, end)
        weights = jnp.asarray(np.asarray(whole.weights) * (time <= near[:, None])[:, None, :])
        mesh = jnp.asarray(np.asarray(whole.inputs["mesh"]) * (near / end)[:, None])
        stack = eqx.tree_at(lambda s: (s.weights, s.time, s.inputs["mesh"]), whole,
                            (weights, jnp.asarray(np.minimum(time, near[:, None])), mesh))
        part = Problem(problem.space, dc.replace(problem.records, stack=stack), problem.priors)
        found = part.solve(free, u, share, tolerance=1e-2)
        if not found.failed and np.isfinite(found.chi2):
            u, share = found.u, found.z
        horizon = GROWTH * horizon
    return problem.solve(free, u, share, **options)
