"""Least squares whose unknowns are a few shared parameters and a few nuisances of every record."""

from typing import Any

import jax
import jax.numpy as jnp
import jax.scipy.linalg as jsl
import lineax as lx
from jaxtyping import Array


def solve_arrow(shared: Array, own: Array, right: Array, shared_rows: Array, shared_right: Array
                ) -> tuple[Array, Array]:
    r"""Minimise $\sum_g \|T_g\theta + Z_g z_g - b_g\|^2 + \|P\theta - c\|^2$ by the Schur complement.

    Args:
        shared: $T$, shape (records, rows, shared).
        own: $Z$, shape (records, rows, own).
        right: $b$, shape (records, rows).
        shared_rows: $P$, shape (rows', shared).
        shared_right: $c$, shape (rows',).

    Returns:
        $\theta$, shape (shared,), and $z$, shape (records, own).
    """
    corner = jnp.einsum("grk,grl->gkl", own, own)
    side = jnp.einsum("grk,grj->gkj", own, shared)
    low = jnp.einsum("grk,gr->gk", own, right)
    factor = jax.vmap(lambda c: jnp.linalg.cholesky(c + 1e-300 * jnp.eye(c.shape[0])))(corner)
    solved = jax.vmap(lambda f, b: jsl.cho_solve((f, True), b))(factor, jnp.concatenate([side, low[..., None]], -1))
    from_side, from_low = solved[..., :-1], solved[..., -1]
    schur = (jnp.einsum("gri,grj->ij", shared, shared) + shared_rows.T @ shared_rows
             - jnp.einsum("gki,gkj->ij", side, from_side))
    gradient = (jnp.einsum("gri,gr->i", shared, right) + shared_rows.T @ shared_right
                - jnp.einsum("gki,gk->i", side, from_low))
    # Scaled to unit diagonal; a vanishing column (a parameter without effect) keeps a finite step.
    scale = 1.0 / jnp.sqrt(jnp.maximum(jnp.diag(schur), 1e-300))
    scaled = schur * scale[:, None] * scale[None, :] + 1e-14 * jnp.eye(schur.shape[0])
    theta = scale * jsl.cho_solve((jnp.linalg.cholesky(scaled), True), scale * gradient)
    return theta, from_low - jnp.einsum("gkj,j->gk", from_side, theta)


class ArrowSolver(lx.AbstractLinearSolver):
    """Solves the damped least-squares systems of Levenberg-Marquardt by their block structure.

    The unknown is `(theta, z)` with shapes (shared,) and (records, own). One probe a shared parameter and one a
    nuisance (for all records at once, since no record feels another's) recover the blocks of the operator, whatever
    it is: its cost grows with the number of records, not with its cube.
    """

    def init(self, operator: lx.AbstractLinearOperator, options: dict[str, Any]) -> Any:
        """Recover the blocks of the operator."""
        theta, z = operator.in_structure()
        count, (records, own) = theta.shape[0], z.shape
        shared_probes = (jnp.eye(count), jnp.zeros((count, records, own)))
        own_probes = (jnp.zeros((own, count)), jnp.broadcast_to(jnp.eye(own)[:, None, :], (own, records, own)))
        probes = jax.tree.map(lambda a, b: jnp.concatenate([a, b]), shared_probes, own_probes)
        answers = jax.vmap(operator.mv)(probes)
        by_record, overall = jax.vmap(_split)(answers)
        return by_record[:count], by_record[count:], overall[:count]

    def compute(self, state: Any, vector: Any, options: dict[str, Any]) -> tuple[Any, Any, dict[str, Any]]:
        """Solve against one right-hand side."""
        shared, own, overall = state
        right, overall_right = _split(vector)
        solution = solve_arrow(jnp.moveaxis(shared, 0, -1), jnp.moveaxis(own, 0, -1), right, overall.T, overall_right)
        return solution, lx.RESULTS.successful, {}

    def transpose(self, state: Any, options: dict[str, Any]) -> Any:
        """Not needed by Levenberg-Marquardt."""
        raise TypeError("`ArrowSolver` does not solve transposed systems: use it for least squares only.")

    def conj(self, state: Any, options: dict[str, Any]) -> Any:
        """Real numbers: unchanged."""
        return state, options

    def assume_full_rank(self) -> bool:
        """Every system is damped, so yes."""
        return True


def _split(answer: Any) -> tuple[Array, Array]:
    """Rows that belong to records, shape (records, rows), and rows of shared parameters, shape (rows,)."""
    (data, prior_own, prior_shared), (damped_shared, damped_own) = answer
    return (jnp.concatenate([data, prior_own, damped_own], axis=1),
            jnp.concatenate([prior_shared, damped_shared]))


def profile_own(shared, own, right):
    """Eliminate each record's nuisances (numpy): residual and shared columns orthogonal to the nuisance columns.

    Args:
        shared: shape (records, rows, shared); own: (records, rows, own); right: (records, rows).

    Returns:
        Projected `shared` and `right`, same shapes.
    """
    import numpy as np

    q, _ = np.linalg.qr(own)
    both = np.concatenate([shared, right[..., None]], axis=-1)
    both = both - q @ (np.swapaxes(q, -1, -2) @ both)
    return both[..., :-1], both[..., -1]


__all__ = ["ArrowSolver", "profile_own", "solve_arrow"]
