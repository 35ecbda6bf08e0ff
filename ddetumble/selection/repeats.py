"""What of a misfit repeats over the records: physics moves the mean residual at a given state, noise does not."""

import numpy as np
from scipy.interpolate import BSpline

from ..families import find_family
from ..inference.goodness import combine_p_values
from ..inference.noise import whitening_matrix
from ..inference.problem import Solution
from ..inference.stack import Records
from ..inference.variance_components import follow_conditions


PARTS = 24  # splines over a contact: a stick-slip of a tenth of a stroke shows, and each still has a few samples
FLIPS = 4000  # draws of signs, so that p-values down to 1e-3 are known to a tenth
FEWEST = 8  # records whose signs tell anything: with fewer the smallest p-value is above one in a hundred
SEED = 20261125


def measure_repeats(records: Records, solution: Solution, groups: np.ndarray, conditions: np.ndarray) -> float | None:
    """p-value of nothing in the residuals repeating over the records, whatever the size and correlation of the noise.

    Residuals of every record are projected on splines over its contact, without what its own settings can imitate; how
    far these then have to move counts by itself (`follow_conditions`). Their mean over the records, and their slopes
    over the logarithms of the conditions, are held against the same with the signs of whole records drawn at random
    (Liu, Annals of Statistics 16, 1988, wild bootstrap by cluster).

    Args:
        records: with the filter that whitens the residuals.
        solution: a fit of all records under it.
        groups: number of the condition of every record, shape (records,).
        conditions: of every record, shape (records, conditions), SI; the place in the series may be one.

    Returns:
        The p-value; None where the records do not share a phase, are single values, or are too few.
    """
    if find_family(records.family).free_running or records.are_values or records.count < FEWEST:
        return None
    stack = records.stack
    time, weights, taps = (np.asarray(x) for x in (stack.time, stack.weights, stack.taps))
    scores, shifts = [], []
    for r, n in enumerate(records.lengths):
        end = float(solution.end[r])
        low = max(float(time[r, 0]), 0.0)
        phase = (time[r, :n] - low) / max(end - low, 1e-300)
        inside = (phase >= 0) & (phase < 1)
        knots = np.concatenate([[0.0] * 3, np.linspace(0.0, 1.0, PARTS - 2), [1.0] * 3])
        columns = np.zeros((n, PARTS))
        if inside.any():
            columns[inside] = BSpline.design_matrix(phase[inside], knots, 3).toarray()
        rows = []
        for c in range(weights.shape[1]):
            block = np.zeros((weights.shape[2], PARTS))
            block[:n] = whitening_matrix(weights[r, c, :n], taps[r, c, :n]) @ columns
            rows.append(block)
        whole = np.zeros((len(rows) * weights.shape[2], len(rows) * PARTS))
        for c, block in enumerate(rows):
            whole[c * weights.shape[2]: (c + 1) * weights.shape[2], c * PARTS: (c + 1) * PARTS] = block
        own, count = solution.own[r], solution.own.shape[2]
        basis = np.linalg.qr(np.concatenate([own, np.eye(count)]))[0]
        side = np.concatenate([solution.residual[r], solution.z[r]])
        side = side - basis @ (basis.T @ side)
        scores.append(whole.T @ side[: len(whole)])
        shifts.append(side[len(whole):])
    logarithms = np.log(np.maximum(np.abs(conditions), 1e-300))
    spread = logarithms.std(axis=0)
    slopes = ((logarithms - logarithms.mean(axis=0)) / np.maximum(spread, 1e-300))[:, spread > 0.01]
    over = np.concatenate([np.ones((len(scores), 1)), slopes], axis=1)
    settled = [k for k, name in enumerate(records.nuisances) if name not in records.starts]
    moved = [shift for shift in np.array(shifts)[:, settled].T if np.ptp(shift) > 0]
    return combine_p_values([_flip_signs(np.array(scores), over),
                             *(follow_conditions(shift, groups, conditions) for shift in moved)])


def _flip_signs(table: np.ndarray, over: np.ndarray) -> float:
    """p-value of nothing common in the columns of a table, by signs of its rows.

    Args:
        table: of every record, shape (records, columns).
        over: weights whose sums are looked at, the largest of them, shape (records, weights).
    """
    size = np.sqrt(np.mean(table**2, axis=0))
    table = table[:, size > 0] / size[size > 0]

    def measure(signs: np.ndarray) -> np.ndarray:
        """Largest statistic over the weights, shape (draws,)."""
        sums = np.einsum("dr,rw,rk->dwk", signs, over, table, optimize=True)
        scale = np.einsum("rw,rk->wk", over**2, table**2)
        return np.max(np.sum(sums**2 / np.maximum(scale, 1e-300), axis=2), axis=1)

    signs = np.random.default_rng(SEED).choice([-1.0, 1.0], size=(FLIPS, len(table)))
    seen = measure(np.ones((1, len(table))))[0]
    return float((np.sum(measure(signs) >= seen * (1.0 - 1e-9)) + 1.0) / (FLIPS + 1.0))
