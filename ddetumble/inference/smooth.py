"""The smooth part of whitened residuals: what is slow over a contact, where a missing force would act."""

from collections.abc import Mapping, Sequence

import numpy as np
from scipy import sparse

from . import distributions as stats
from .goodness import doubt_level
from .identifiability import measure_values
from .noise import Noise, whitening_matrix
from .noise_estimation import list_spans, spline_columns
from .problem import Problem, Solution
from .stack import Records


ROWS = 16_384  # of a basis that are looked at at once
FAINT = 1e-9  # length of a column below which it tells nothing,
TOLD = 1e-11  # and squared length, of columns of unit length, below which a combination of them is rounding


def smooth_bases(problem: Problem, end: np.ndarray) -> list[sparse.csr_matrix]:
    """Whitened spline basis of each record over all channels, list of (rows, columns)."""
    records = problem.records
    if records.are_values:  # all of each
        return [whiten_all(records, r, sparse.csr_matrix(np.ones((1, 1)))) for r in range(records.count)]
    time = np.asarray(records.stack.time)
    return [whiten_all(records, r, spline_columns(time[r, :n], list_spans(records, r, float(end[r]))))
            for r, n in enumerate(records.lengths)]


def whiten_all(records: Records, record: int, columns: sparse.csr_matrix) -> sparse.csr_matrix:
    """Columns over the samples of a record, apart in every channel, as rows of its residual: (rows, columns)."""
    n = records.lengths[record]
    weights, taps = np.asarray(records.stack.weights)[record], np.asarray(records.stack.taps)[record]
    blocks = [whitening_matrix(own[:n], filtered[:n]) @ columns for own, filtered in zip(weights, taps, strict=True)]
    for block in blocks:
        block.resize(weights.shape[1], np.shape(columns)[1])
    return sparse.csr_matrix(sparse.block_diag(blocks))


def measure_smooth(problem: Problem, solution: Solution, bases: Sequence[sparse.csr_matrix]) -> tuple[float, float]:
    """Sum of squares of the smooth part of residuals and nuisances, and its degrees of freedom."""
    if problem.records.are_values:  # all of each
        return measure_values(problem, solution)
    total, degrees = 0.0, -float(solution.shared.shape[2])
    own = solution.own.shape[2]
    for r, basis in enumerate(bases):
        dense = np.block([[solution.own[r], solution.shared[r], solution.residual[r, :, None]],
                          [np.eye(own), np.zeros((own, solution.shared.shape[2])), solution.z[r, :, None]]])
        rows = sparse.csr_matrix(basis)
        rows.resize(len(dense), np.shape(basis)[1])
        if problem.space.family.free_running:  # a tall matrix of many splines: its normal equations do
            cross = rows.T @ dense
            square = np.block([[(rows.T @ rows).toarray(), cross], [cross.T, dense.T @ dense]])
            turn = orthonormalise(square[:-1, :-1])
            total += float(np.sum((turn.T @ square[:-1, -1]) ** 2))
            degrees += turn.shape[1] - own
            continue
        # Singular vectors of a tall matrix are those of its triangular factor.
        factor = _triangulate(rows, dense)
        columns, right = factor[:, :-1], factor[:, -1]
        scale = np.linalg.norm(columns, axis=0)
        u, s, _ = np.linalg.svd(columns[:, scale > 1e-9] / scale[scale > 1e-9], full_matrices=False)
        u = u[:, s > 1e-7 * s[0]]
        total += float(np.sum((u.T @ right) ** 2))
        degrees += u.shape[1] - own  # each nuisance was fitted
    return total, degrees


def orthonormalise(square: np.ndarray) -> np.ndarray:
    """Matrix by which columns become orthonormal, shape (columns, rank), from their normal equations."""
    size = np.sqrt(np.maximum(np.diag(square), 0.0))
    kept = np.flatnonzero(size > FAINT)
    if not kept.size:
        return np.zeros((len(square), 0))
    values, vectors = np.linalg.eigh(square[np.ix_(kept, kept)] / np.outer(size[kept], size[kept]))
    told = values > TOLD * values[-1]
    turn = np.zeros((len(square), int(told.sum())))
    turn[kept] = vectors[:, told] / np.sqrt(values[told]) / size[kept, None]
    return turn


def _triangulate(left: sparse.csr_matrix, right: np.ndarray) -> np.ndarray:
    """Triangular factor of two blocks of columns side by side, a part of the rows at a time."""
    count = np.shape(left)[1] + right.shape[1]
    step, factor = max(ROWS, 2 * count), np.zeros((0, count))
    for k in range(0, len(right), step):
        part = np.concatenate([left[k: k + step].toarray(), right[k: k + step]], axis=1)
        factor = np.linalg.qr(np.concatenate([factor, part]), mode="r")
    return factor


def judge_smooth(total: float, degrees: float, noise: Mapping[str, Noise]) -> float:
    """p-value of a chi-square of series, whose noise level is known as far as it is."""
    count = max(degrees, 1.0)
    logarithm = np.log(max(total / count, 1e-300)) + 1.0 / count
    return float(stats.norm.sf(logarithm / np.sqrt(2.0 / count + doubt_level(noise) ** 2)))
