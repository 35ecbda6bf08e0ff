"""How far one record is from what all others say: fits without it, and its misfit under them."""

import dataclasses as dc
from collections.abc import Collection

import numpy as np
from scipy.linalg import block_diag

from ..inference import distributions as stats
from ..inference.goodness import doubt_level
from ..inference.problem import Problem, Solution, mask_records, settle
from ..inference.progressive_horizon import is_lost, solve_progressively
from ..inference.smooth import TOLD, judge_smooth, orthonormalise
from .problem import SelectionProblem


@dc.dataclass(frozen=True)
class Misfit:
    """Smooth part of a record's misfit: its sum of squares over `degrees`, and the chance of so much."""

    total: float
    degrees: int
    p_value: float

    @property
    def excess(self) -> float:
        """Mean square above the noise, in units of its variance."""
        return self.total / max(self.degrees, 1) - 1.0


@dc.dataclass(frozen=True)
class Aside:
    """A fit of the others, and the record held against it."""

    record: int  # its place
    solution: Solution  # of the others, with all records' nuisances fitted to it
    stated: Solution  # the same with the record's own nuisances as they are stated
    spread: np.ndarray  # covariance of the free parameters over their scales, as the others leave it
    own: Misfit  # of the record
    others: dict[int, Misfit]  # of the records that were fitted, by place
    rest: Misfit  # of these together


def measure_record(selection: SelectionProblem, solution: Solution, record: int, spread: np.ndarray | None = None,
                   columns: np.ndarray | None = None) -> Misfit:
    """Smooth misfit of one record under a solution, its nuisances at their best.

    Args:
        spread: covariance of the free parameters over their scales: they may move by so much.
        columns: further whitened columns that may move freely, shape (rows, columns).
    """
    own, shared = solution.own[record], solution.shared[record]
    rows, count = own.shape
    parts, priors = [own], [np.eye(count)]
    if columns is not None:
        parts.append(columns)
        priors.append(np.zeros((0, columns.shape[1])))
    if spread is not None and shared.shape[1]:
        values, vectors = np.linalg.eigh(spread)
        parts.append(shared @ (vectors * np.sqrt(np.maximum(values, 0.0))))
        priors.append(np.eye(shared.shape[1]))
    moving = np.concatenate([np.concatenate(parts, axis=1), block_diag(*priors)])
    side = np.zeros(len(moving))
    side[:rows], side[rows: rows + count] = solution.residual[record], solution.z[record]
    q = moving @ orthonormalise(moving.T @ moving)
    side = side - q @ (q.T @ side)
    basis = selection.bases[record]
    if record not in selection.orthonormal:
        selection.orthonormal[record] = orthonormalise((basis.T @ basis).toarray())
    turn = selection.orthonormal[record].T
    smooth = turn @ (basis.T @ side[:rows])
    # What moves takes a part of a few directions of the splines, and leaves the others as they are.
    common, cosines, _ = np.linalg.svd(turn @ (basis.T @ q[:rows]), full_matrices=False)
    along, left = common.T @ smooth, 1.0 - cosines**2
    told = left > TOLD
    total = float(np.sum((smooth - common @ along) ** 2) + np.sum(along[told] ** 2 / left[told]))
    return judge(selection, total, len(smooth) - int(np.sum(~told)))


def judge(selection: SelectionProblem, total: float, degrees: int) -> Misfit:
    """Chance of a sum of squares, the noise level being known as far as it is."""
    louder = 1.0 + 2.0 * doubt_level(selection.noise)
    return Misfit(total, degrees, max(judge_smooth(total, degrees, selection.noise),
                                      float(stats.chi2.sf(total / louder, max(degrees, 1)))))


def set_aside(selection: SelectionProblem, solution: Solution, record: int, out: Collection[int] = ()) -> Aside:
    """Fit all records but one (and those already `out`), and hold it against them.

    What the record itself drove astray goes back to its first guess, too.
    """
    gone, names = {record, *out}, solution.names
    masked = mask_records(selection.problem, gone)
    starts = [(u, solution.z if k == 0 else np.zeros_like(solution.z))
              for k, u in enumerate(selection.list_origins(solution.u))]
    rest = min((masked.solve(names, u, z, tolerance=1e-2) for u, z in starts), key=lambda found: found.chi2)
    if is_lost(masked, rest):
        again = solve_progressively(masked, names, selection.guess, tolerance=1e-2)
        rest = again if again.chi2 < rest.chi2 else rest
    spread = rest.covariance() / np.outer(rest.scales, rest.scales)
    at = settle(selection.problem, names, rest.u, rest.z)
    plain = at.z.copy()
    plain[record, len(selection.records.starts):] = 0.0
    stated = selection.problem.solve(names, rest.u, plain, moving=False)
    others = {r: measure_record(selection, at, r) for r in range(selection.records.count) if r not in gone}
    degrees = sum(m.degrees for m in others.values()) - len(names)
    return Aside(record, dc.replace(at, converged=rest.converged), stated, spread,
                 measure_record(selection, at, record, spread), others,
                 judge(selection, sum(m.total for m in others.values()), degrees))


def whiten_baseline(problem: Problem, record: int, channel: int) -> np.ndarray:
    """An offset of one channel, and a drift from 0 to 1 over the record, as such columns, shape (rows, 2)."""
    t = np.asarray(problem.records.stack.time)[record, : problem.records.lengths[record]]
    return problem.records.whiten(record, channel, np.stack([np.ones(len(t)), (t - t[0]) / (t[-1] - t[0])], axis=1))
