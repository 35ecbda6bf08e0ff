"""Cross-validation over conditions: how well a fitted model predicts tests that did not choose it."""

import contextlib
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from .._errors import ComputationError
from ..inference.problem import Problem, Solution, mask_records
from ..inference.stack import Records
from .settings import DEFAULT


NORMAL_95 = 1.959964  # two-sided 95 % quantile of the normal distribution
# Standard deviation of a parameter, in typical changes, beyond which all conditions together tell nothing of it: with
# one left out, rounding would send it far away, to where the model is another.
FARTHEST = 10.0
BEYOND = 1e12  # noise variances that a prediction misses by at most: past any meaning, and still finite


def leave_out(solution: Solution, groups: np.ndarray) -> np.ndarray:
    """Loss of every record under the fit without its condition, shape (records,), in units of the noise variance.

    One Gauss-Newton step from the full fit, by downdating its normal equations; the left-out record's own nuisances
    are profiled under their priors. The fit counts as stationary: what a fit that has not converged would still gain is
    no prediction.
    """
    columns, residual = solution.projected()
    loss = np.zeros(len(residual))
    for out, step, _ in _step_aside(solution, groups, columns, residual):
        moved = residual[out] + columns[out] @ step
        with np.errstate(over="ignore"):  # what this condition alone told is anything without it
            loss[out] = np.fmin(np.sum(moved**2, axis=1), BEYOND)
    return loss


def refit_far_off(problem: Problem, solution: Solution, groups: np.ndarray, loss: np.ndarray,
                  far_off: float = DEFAULT.far_off) -> np.ndarray:
    """The losses of `leave_out`, shape (records,), but those of fits without where they are more than `far_off` noise
    variances a sample.

    Where too few others tell a parameter, one Gauss-Newton step goes anywhere. A condition whose fit cannot be computed
    keeps the linearised loss.
    """
    exact, used = loss.copy(), np.sum(solution.residual != 0, axis=1)
    for group in np.unique(groups) if solution.names else ():
        out = groups == group
        if loss[out].sum() > far_off * used[out].sum():
            with contextlib.suppress(ComputationError):
                u, _ = _fit_others(problem, solution, out, adjust=False)
                there = problem.solve((), u, solution.z, tolerance=1e-2)
                with np.errstate(over="ignore"):
                    found = np.sum(there.residual[out] ** 2, axis=1) + np.sum(there.z[out] ** 2, axis=1)
                exact[out] = np.fmin(found, BEYOND)
    return exact


def forecast(records: Records, solution: Solution, groups: np.ndarray, share: float = DEFAULT.early) -> np.ndarray:
    """The same for records that run on from where they start, which `leave_out` fits to all of a record.

    The first `share` of a left-out record gives what it starts from, and the rest is predicted; its loss counts for the
    whole record.
    """
    early, loss = _find_early(records, solution, share), np.zeros(records.count)
    for out, step, _ in _step_aside(solution, groups, *solution.projected()):
        for r in map(int, np.flatnonzero(out)):
            own, used = solution.own[r], np.any(solution.own[r] != 0, axis=1)
            moved = solution.residual[r] + solution.shared[r] @ step + own @ solution.adjust_own(r, early[r], step)
            rest = moved[~early[r] & used]
            loss[r] = float(np.sum(rest**2)) * max(float(used.sum()), 1.0) / max(rest.size, 1)
    return loss


class LeftOut(NamedTuple):
    """Every record by the model fitted without its condition."""

    channels: np.ndarray  # shape (records, channels, samples), SI, NaN in records that could not be computed
    used: np.ndarray  # which samples count, shape (records, samples)
    loss: np.ndarray  # of every record, in noise variances, the priors of its settings included, shape (records,)
    # Share of the whitened residuals within the 95 % interval of a new measurement, from the linearised model:
    # parameters, settings as far as they are not adjusted, and noise.
    coverage: float


def predict_left_out(problem: Problem, solution: Solution, groups: np.ndarray, share: float = DEFAULT.early,
                     adjust: bool = True, bent: float = DEFAULT.bent) -> LeftOut:
    """Every record by the model fitted without its condition: the parameters by one Gauss-Newton step (as in
    `leave_out`), or by a fit where that leads astray, then the exact model.

    Of records that run on from where they start, the first `share` gives what they start from, and the rest counts.

    Args:
        adjust: whether the left-out record's own settings suit it best within their stated uncertainty, which makes the
            cross-validated error; else they stand as they are written down, which makes the prediction error.
        bent: times the linearised loss, beyond which the exact one shows that a step led astray.
    """
    records, free_running = problem.records, problem.space.family.free_running
    samples, count = np.asarray(records.stack.time).shape[1], records.count
    early = (_find_early(records, solution, share) if free_running
             else np.zeros((count, solution.residual.shape[1]), dtype=bool))
    u = np.broadcast_to(solution.u, (count, len(solution.u))).copy()
    z = solution.z.copy()
    columns = [problem.space.index[name] for name in solution.names]
    inside, counted, linear = 0.0, 0.0, np.zeros(count)
    for out, step, spread in _step_aside(solution, groups, *solution.projected()):
        u[np.ix_(out, columns)] += step * solution.scales
        for r in map(int, np.flatnonzero(out)):
            rows = slice(None) if adjust and not free_running else early[r]
            change = solution.adjust_own(r, rows, step)
            z[r] += change
            own, shared = solution.own[r], solution.shared[r]
            used = ~early[r] & ((solution.residual[r] != 0) | np.any(own != 0, axis=1))
            moved = solution.residual[r] + own @ change + shared @ step
            linear[r] = np.sum(moved**2) + np.sum(z[r] ** 2)
            moved = moved[used]
            known = np.linalg.inv(own[rows].T @ own[rows] + np.eye(own.shape[1]))
            variance = 1.0 + sum(np.einsum("ik,kl,il->i", x[used], matrix, x[used])
                                 for x, matrix in ((own, known), (shared, spread)))
            inside += float(np.sum(moved**2 <= NORMAL_95**2 * variance))
            counted += float(used.sum())
    coverage, seen = inside / counted if counted else float("nan"), ~early[:, :samples]
    try:
        at = problem.solve(solution.names, u, z, moving=False)
        with np.errstate(over="ignore"):  # of a step that leads astray it may be infinite
            exact = np.sum(at.residual**2, axis=1) + np.sum(z**2, axis=1)
        astray = [out for out in (groups == g for g in np.unique(groups))
                  if exact[out].sum() > bent * linear[out].sum()] if solution.names and not free_running else []
        for out in astray:
            with contextlib.suppress(ComputationError):
                u[out], z[out] = _fit_others(problem, solution, out, adjust)
        if astray:
            at = problem.solve(solution.names, u, z, moving=False)
    except ComputationError:
        return LeftOut(np.full((count, len(records.channels), samples), np.nan), seen, np.full(count, np.nan), coverage)
    failed = np.isin(records.keys, at.failed)
    with np.errstate(over="ignore"):
        loss = np.fmin(np.sum(at.residual**2, axis=1) + np.sum(z**2, axis=1), BEYOND)
    return LeftOut(np.where(failed[:, None, None], np.nan, at.channels), seen, np.where(failed, np.nan, loss), coverage)


def _fit_others(problem: Problem, solution: Solution, out: np.ndarray, adjust: bool) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates of the parameters fitted without the records that `out` marks, shape (parameters,), and the nuisances
    of these under them, adjusted or as they are stated, shape (records that are out, nuisances)."""
    rest = mask_records(problem, np.flatnonzero(out)).solve(solution.names, solution.u, solution.z, tolerance=1e-2)
    still = problem.solve((), rest.u, solution.z, tolerance=1e-2).z if adjust else np.zeros_like(solution.z)
    return rest.u, still[out]


def _step_aside(solution: Solution, groups: np.ndarray, columns: np.ndarray, residual: np.ndarray
                ) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """For every condition which records are its own, the step of the parameters that leaves it out, and their
    covariance without it; both in units of their scales."""
    count = columns.shape[2]
    prior = np.diag(solution.prior_weight**2)
    blocks = np.einsum("grk,grl->gkl", columns, columns)
    sides = np.einsum("grk,gr->gk", columns, residual)
    whole = blocks.sum(axis=0) + prior
    untold = np.flatnonzero(np.diag(whole) < FARTHEST**-2)
    for group in np.unique(groups):
        out = groups == group
        left = whole - blocks[out].sum(axis=0)
        right = sides[out].sum(axis=0)
        left[untold], left[:, untold], left[untold, untold], right[untold] = 0.0, 0.0, 1.0, 0.0
        scale = 1.0 / np.sqrt(np.maximum(np.diag(left), 1e-300))
        inverse = np.outer(scale, scale) * np.linalg.pinv(left * np.outer(scale, scale), rcond=1e-12, hermitian=True)
        yield out, (scale * np.linalg.lstsq(left * np.outer(scale, scale), scale * right, rcond=1e-12)[0] if count
                    else np.zeros(0)), inverse


def _find_early(records: Records, solution: Solution, share: float) -> np.ndarray:
    """Which rows of the residual lie in the first `share` of their record, shape (records, rows)."""
    time = np.asarray(records.stack.time)[: records.count]
    first, last = time[:, :1], time.max(axis=1, keepdims=True)
    early = time <= first + share * (last - first)
    return np.tile(early, (1, solution.residual.shape[1] // time.shape[1]))


def compare_losses(loss: np.ndarray, best: np.ndarray, groups: np.ndarray | None = None) -> tuple[float, float]:
    """Paired difference of two models' held-out losses, and its standard error over conditions (noise variances).

    The losses are those of records with their conditions `groups`, or else of the conditions themselves.
    """
    sums = loss - best
    if groups is not None:
        sums = np.array([sums[groups == g].sum() for g in np.unique(groups)])
    n = len(sums)
    if n < 2:
        return float(sums.sum()), float("inf")
    return float(sums.sum()), float(np.sqrt(n / (n - 1) * np.sum((sums - sums.mean()) ** 2)))
