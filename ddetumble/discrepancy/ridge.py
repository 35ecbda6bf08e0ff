r"""Fits that are linear about a place, as normal equations by condition: ridges, and how well they predict what they
did not see.

Once each record's own nuisances are eliminated, the loss of condition g is
$\theta^T B_g \theta + 2 s_g^T \theta + q_g$. A prior $N(0, \tau^2)$ on the coefficients adds $\theta^T \theta/\tau^2$;
leaving a condition out means solving without its $B_g$ and $s_g$. This is exact for what is linear, and one
Gauss-Newton step for the rest.
"""

import dataclasses as dc

import numpy as np

from ..inference.arrow import profile_own
from ..inference.problem import Solution


@dc.dataclass(frozen=True)
class Normal:
    """Normal equations of every condition.

    Attributes:
        blocks: shape (conditions, columns, columns).
        sides: shape (conditions, columns).
        squares: shape (conditions,).
    """

    blocks: np.ndarray
    sides: np.ndarray
    squares: np.ndarray

    def turn(self, matrix: np.ndarray) -> "Normal":
        """The same in other coordinates, old = matrix new."""
        return Normal(np.einsum("ki,gkl,lj->gij", matrix, self.blocks, matrix, optimize=True), self.sides @ matrix,
                      self.squares)

    def pick(self, columns: np.ndarray) -> "Normal":
        """Some of the columns."""
        return Normal(self.blocks[:, columns][:, :, columns], self.sides[:, columns], self.squares)


def gather_normal(solution: Solution, more: np.ndarray | None, groups: np.ndarray,
                  offset: np.ndarray | None = None) -> Normal:
    """Normal equations of a fit's own columns, then of `more`.

    Args:
        solution: of which residual, columns and nuisances are taken.
        more: further columns, shape (records, rows, columns).
        groups: condition of every record.
        offset: where the columns of the solution are zero: their present values, shape (own columns,); zero for those
            that are not given, as steps from where they are.
    """
    records, _, own = solution.own.shape
    shared = solution.shared if more is None else np.concatenate([solution.shared, more], axis=2)
    residual = solution.residual
    if offset is not None:
        residual = residual - solution.shared @ offset
    prior = np.broadcast_to(np.eye(own), (records, own, own))
    columns, right = profile_own(np.concatenate([shared, np.zeros((records, own, shared.shape[2]))], axis=1),
                                 np.concatenate([solution.own, prior], axis=1),
                                 np.concatenate([residual, solution.z], axis=1))
    both = np.concatenate([columns, right[..., None]], axis=2)
    square = np.einsum("grk,grl->gkl", both, both, optimize=True)
    total = np.zeros((int(groups.max()) + 1, *square.shape[1:]))
    np.add.at(total, groups, square)
    return Normal(total[:, :-1, :-1], total[:, :-1, -1], total[:, -1, -1])


def solve_ridge(normal: Normal, weight: np.ndarray, out: int | None = None) -> np.ndarray:
    """Coefficients at the least loss, without condition `out`; `weight` is 1/deviation of each prior, 0 for none."""
    blocks, sides = normal.blocks.sum(axis=0) + np.diag(weight**2), normal.sides.sum(axis=0)
    if out is not None:
        blocks, sides = blocks - normal.blocks[out], sides - normal.sides[out]
    scale = 1.0 / np.sqrt(np.maximum(np.diag(blocks), 1e-300))
    scaled = blocks * np.outer(scale, scale) + 1e-12 * np.eye(len(scale))
    return -scale * np.linalg.solve(scaled, scale * sides)


def measure_ridge(normal: Normal, weight: np.ndarray) -> float:
    """Least loss of all conditions together, in noise variances, without what the prior adds; `weight` as above."""
    theta = solve_ridge(normal, weight)
    blocks, sides = normal.blocks.sum(axis=0), normal.sides.sum(axis=0)
    return float(normal.squares.sum() + 2.0 * theta @ sides + theta @ blocks @ theta)


def hold_out(normal: Normal, weight: np.ndarray) -> np.ndarray:
    """Loss of every condition under the fit without it, shape (conditions,), in noise variances."""
    losses = np.zeros(len(normal.squares))
    for g in range(len(losses)):
        theta = solve_ridge(normal, weight, g)
        losses[g] = normal.squares[g] + 2.0 * theta @ normal.sides[g] + theta @ normal.blocks[g] @ theta
    return losses


def spread_ridge(normal: Normal, weight: np.ndarray) -> np.ndarray:
    """Posterior covariance of the coefficients, shape (columns, columns)."""
    blocks = normal.blocks.sum(axis=0) + np.diag(weight**2)
    scale = 1.0 / np.sqrt(np.maximum(np.diag(blocks), 1e-300))
    inverse = np.linalg.inv(blocks * np.outer(scale, scale) + 1e-12 * np.eye(len(scale)))
    with np.errstate(over="ignore"):  # a direction of which nothing is known
        return inverse * np.outer(scale, scale)


def list_deviations(normal: Normal, base: int) -> np.ndarray:
    """Deviations of a prior to choose from: from what changes one column by a noise variance to 1e4 times that."""
    norms = np.sqrt(np.diag(normal.blocks.sum(axis=0))[base:])
    typical = float(np.median(norms[norms > 1e-9 * norms.max()])) if norms.size and norms.max() > 0 else 1.0
    return 10.0 ** np.arange(-0.5, 4.01, 0.5) / typical


def choose_ridge(normal: Normal, base: int, deviations: np.ndarray | None = None) -> tuple[float, np.ndarray]:
    """Deviation of the prior that predicts left-out conditions best, and their losses; the first `base` have none."""
    best = (np.inf, 0.0, np.zeros(0))
    for deviation in list_deviations(normal, base) if deviations is None else deviations:
        losses = hold_out(normal, weigh_columns(normal, base, deviation))
        if losses.sum() < best[0]:
            best = (float(losses.sum()), float(deviation), losses)
    return best[1], best[2]


def weigh_columns(normal: Normal, base: int, deviation: float) -> np.ndarray:
    """Weights of the prior: none on the first `base` columns."""
    return np.where(np.arange(len(normal.sides[0])) < base, 0.0, 1.0 / deviation)
