"""Whole conditions left out: how well a fitted model predicts tests that did not choose it."""

import numpy as np

from ..inference.problem import Solution


def leave_out(solution: Solution, groups: np.ndarray) -> np.ndarray:
    """Loss of every record under the fit without its condition, shape (records,), in units of the noise variance.

    One Gauss-Newton step from the full fit, by downdating its normal equations; the left-out record's own nuisances
    are profiled under their priors. The fit counts as stationary: what a fit that has not converged would still gain is
    no prediction.
    """
    columns, residual = solution.projected()
    count = columns.shape[2]
    prior = np.diag(solution.prior_weight**2)
    blocks = np.einsum("grk,grl->gkl", columns, columns)
    sides = np.einsum("grk,gr->gk", columns, residual)
    whole = blocks.sum(axis=0) + prior
    loss = np.zeros(len(residual))
    for group in np.unique(groups):
        out = groups == group
        left = whole - blocks[out].sum(axis=0)
        scale = 1.0 / np.sqrt(np.maximum(np.diag(left), 1e-300))
        right = sides[out].sum(axis=0)
        step = scale * np.linalg.lstsq(left * np.outer(scale, scale), scale * right, rcond=1e-12)[0] if count else 0
        moved = residual[out] + (columns[out] @ step if count else 0.0)
        loss[out] = np.sum(moved**2, axis=1)
    return loss


def compare_losses(loss: np.ndarray, best: np.ndarray, groups: np.ndarray) -> tuple[float, float]:
    """Paired difference of two models' held-out losses, and its standard error over conditions (noise variances)."""
    difference = loss - best
    sums = np.array([difference[groups == g].sum() for g in np.unique(groups)])
    n = len(sums)
    if n < 2:
        return float(sums.sum()), float("inf")
    return float(sums.sum()), float(np.sqrt(n / (n - 1) * np.sum((sums - sums.mean()) ** 2)))
