"""Bordered Levenberg-Marquardt, in optimistix: a few shared parameters and a few nuisances of every record.

No record feels another's nuisances: the normal equations are block-diagonal with a border, and the Schur complement
solves them at a cost that grows with the number of records, not with its cube.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.scipy.linalg as jsl
import numpy as np
import optimistix as optx
from jaxtyping import Array, Bool


STALLED = 1e-5  # of the sum of squares, gained by a step: less changes no digit of a result; smaller takes more steps
IDLE = 0.01  # of the expected decrease, gained by a trial: with less it counts as failed, when nothing is left to gain
LONG, STILL = 20, 1e-7  # trials in a row that lower the sum of squares by less than this share: no valley is so flat
FIRST_DAMPING = 1e-3  # relative to the diagonal of the normal equations: nearly Gauss-Newton, as starts are good
FAINT, DEAD = 1.0, 1e-6  # sum of squares by a typical change of a parameter, at least, as damped and as solved for


class NormalEquations(eqx.Module):
    r"""Normal equations of $\sum_g \|T_g\theta + Z_g z_g + r_g\|^2 + \|P\theta + c\|^2$."""

    # corner, side: $Z_g^T Z_g$ and $Z_g^T T_g$, shapes (records, own, own) and (records, own, shared).
    corner: Array
    side: Array
    square: Array  # $\sum_g T_g^T T_g + P^T P$, shape (shared, shared)
    # own, shared: gradients $Z_g^T r_g$ and $\sum_g T_g^T r_g + P^T c$, shapes (records, own) and (shared,).
    own: Array
    shared: Array

    def solve(self, damping: Array) -> tuple[Array, Array]:
        r"""Step $-(H + \lambda D + E)^{-1} g$ for damping $\lambda$: $\theta$ (shared,) and $z$ (records, own).

        $D$ is the diagonal of $H$ (Marquardt 1963), of shared parameters at least `FAINT`; $E$ is `DEAD` on the
        diagonal of shared parameters and 0 elsewhere. Coordinates are in units of their typical change, so that a
        column of norm 1 changes the sum of squares by 1 over one of these.
        """
        unit = jnp.eye(self.corner.shape[1])
        corner = self.corner + damping * self.corner * unit + 1e-300 * unit
        # What hardly acts where it stands would be sent far away, and no step would pass until damping holds all back.
        size = jnp.diag(self.square)
        square = self.square + jnp.diag(damping * jnp.maximum(size, FAINT) + DEAD)
        factor = jnp.linalg.cholesky(corner)
        both = jnp.concatenate([self.side, self.own[..., None]], axis=-1)
        solved = jax.vmap(lambda f, b: jsl.cho_solve((f, True), b))(factor, both)
        from_side, from_own = solved[..., :-1], solved[..., -1]
        schur = square - jnp.einsum("gki,gkj->ij", self.side, from_side)
        gradient = self.shared - jnp.einsum("gki,gk->i", self.side, from_own)
        # Scaled to unit diagonal; a vanishing column (a parameter without effect) keeps a finite step.
        scale = 1.0 / jnp.sqrt(jnp.maximum(jnp.diag(schur), 1e-300))
        scaled = schur * scale[:, None] * scale[None, :] + 1e-14 * jnp.eye(schur.shape[0])
        theta = -scale * jsl.cho_solve((jnp.linalg.cholesky(scaled), True), scale * gradient)
        return theta, -from_own - jnp.einsum("gkj,j->gk", from_side, theta)


def gather_normal_equations(operator: Any, residual: Any) -> NormalEquations:
    """Normal equations of a linear operator on `(theta, z)` and its residual `(data, own prior, shared prior)`.

    One probe a shared parameter and one a nuisance (for all records at once) recover the operator's blocks.
    """
    theta, z = operator.in_structure()
    count, (records, own) = theta.shape[0], z.shape
    shared_probes = (jnp.eye(count), jnp.zeros((count, records, own)))
    own_probes = (jnp.zeros((own, count)), jnp.broadcast_to(jnp.eye(own)[:, None, :], (own, records, own)))
    probes = jax.tree.map(lambda a, b: jnp.concatenate([a, b]), shared_probes, own_probes)
    data, own_prior, shared_prior = jax.vmap(operator.mv)(probes)
    rows, overall = jnp.concatenate([data, own_prior], axis=2), shared_prior[:count]
    right, overall_right = jnp.concatenate(residual[:2], axis=1), residual[2]
    shared, nuisances = rows[:count], rows[count:]
    return NormalEquations(
        jnp.einsum("kgr,lgr->gkl", nuisances, nuisances), jnp.einsum("kgr,jgr->gkj", nuisances, shared),
        jnp.einsum("igr,jgr->ij", shared, shared) + overall @ overall.T,
        jnp.einsum("kgr,gr->gk", nuisances, right), jnp.einsum("igr,gr->i", shared, right) + overall @ overall_right)


class _DescentState(eqx.Module):
    equations: NormalEquations
    expected: Array


class _BorderedDescent(optx.AbstractDescent):
    """The damped step; damping is relative to the diagonal, as Marquardt had it."""

    def init(self, y: Any, f_info_struct: Any) -> _DescentState:
        theta, z = y
        count, (records, own) = theta.shape[0], z.shape
        blank = NormalEquations(jnp.zeros((records, own, own)), jnp.zeros((records, own, count)),
                                jnp.zeros((count, count)), jnp.zeros((records, own)), jnp.zeros((count,)))
        return _DescentState(blank, jnp.asarray(jnp.inf))

    def query(self, y: Any, f_info: Any, state: _DescentState) -> _DescentState:
        """Equations at a new point, and by how much the sum of squares is expected to fall from there."""
        equations = gather_normal_equations(f_info.jac, f_info.residual)
        theta, z = equations.solve(jnp.zeros(()))
        return _DescentState(equations, -jnp.sum(equations.shared * theta) - jnp.sum(equations.own * z))

    def step(self, step_size: Array, state: _DescentState) -> tuple[Any, optx.RESULTS]:
        return state.equations.solve(1.0 / step_size), optx.RESULTS.successful


class _SearchState(eqx.Module):
    damping: Array
    growth: Array
    trials: Array
    idle: Array  # trials in a row that gained hardly anything of what was expected
    # mark, since: sum of squares that has last fallen noticeably (half of it), and the trials made since then.
    mark: Array
    since: Array


class _GainSearch(optx.AbstractSearch):
    """Damping by the gain ratio (Nielsen 1999), growing ever faster while steps are refused.

    Steps that raise the sum of squares by less than a tenth of `tolerance` pass: the integrator is no more exact.
    """

    tolerance: Array

    def init(self, y: Any, f_info_struct: Any) -> _SearchState:
        return _SearchState(jnp.asarray(FIRST_DAMPING), jnp.asarray(10.0), jnp.asarray(0), jnp.asarray(0),
                            jnp.asarray(jnp.inf), jnp.asarray(0))

    def step(self, first_step: Bool[Array, ""], y: Any, y_eval: Any, f_info: Any, f_eval_info: Any,
             state: _SearchState) -> tuple[Array, Bool[Array, ""], optx.RESULTS, _SearchState]:
        """Accept or refuse the trial point, and set the damping of the next."""
        change = f_info.jac.mv(jax.tree.map(jnp.subtract, y_eval, y))
        fall = sum(jnp.sum(c * (c + 2.0 * r)) for c, r in zip(change, f_info.residual, strict=True))
        actual = 2.0 * (f_eval_info.as_min() - f_info.as_min())
        accept = first_step | (actual <= jnp.minimum(0.01 * fall, 0.0) + 0.1 * self.tolerance)
        gain = actual / jnp.where(fall < 0, fall, -1e-300)
        shrink = jnp.clip(1.0 - (2.0 * gain - 1.0) ** 3, 0.03, 2.0)
        damping = jnp.where(first_step, state.damping,
                            jnp.where(accept, state.damping * shrink, state.damping * state.growth))
        growth = jnp.where(accept, 10.0, 5.0 * state.growth)
        damping = jnp.clip(damping, 1e-12, 1e12)
        later = _SearchState(damping, growth, state.trials + 1, state.idle, state.mark, state.since)
        return 1.0 / damping, accept, optx.RESULTS.successful, later


class BorderedLevenbergMarquardt(optx.AbstractGaussNewton):
    """Levenberg-Marquardt that ends where the sum of squares is expected to fall by less than `tolerance`.

    That expected decrease is the squared distance to the minimum in standard errors, so a tolerance of 1e-4 means 1 %
    of a standard error. It also ends where less than a share `STALLED` is expected and three trials in a row
    gain hardly anything of it: where the force breaks off at separation, the sum of squares jumps as separation passes
    a sample. In front of such a jump ever shorter steps still pass, and gain nothing.
    It gives up after `most` trials, as `max_steps` of optimistix would, which is compiled in, and where `LONG` trials
    in a row lowered the sum of squares by less than a share `STILL` altogether: at a limit, or where few numbers meet
    nearly collinear columns, an undamped step promises what no damped one gives. `has_converged` tells these apart.
    `optimistix.least_squares` runs it on functions of `(theta, z)`, shapes (shared,) and (records, own).
    """

    rtol: float
    atol: float
    norm: Callable
    descent: _BorderedDescent
    search: _GainSearch
    verbose: Callable[..., None]
    tolerance: Array
    most: Array

    def __init__(self, tolerance: Array, most: Array):
        self.rtol, self.atol, self.norm = 0.0, 0.0, optx.max_norm
        self.descent, self.search, self.verbose = _BorderedDescent(), _GainSearch(tolerance), _say_nothing
        self.tolerance, self.most = tolerance, most

    def step(self, fn, y, args, options, state, tags):
        """One trial; ends as soon as little is expected from another."""
        before, expected = state.f_info.as_min(), state.descent_state.expected
        y, state, _ = super().step(fn, y, args, options, state, tags)
        after, search = state.f_info.as_min(), state.search_state
        idle = jnp.where(jnp.isinf(expected) | (2.0 * (before - after) > IDLE * expected), 0, search.idle + 1)
        fell = after < (1.0 - STILL) * search.mark
        mark, since = jnp.where(fell, after, search.mark), jnp.where(fell, 0, search.since + 1)
        state = eqx.tree_at(lambda s: (s.search_state.idle, s.search_state.mark, s.search_state.since), state,
                            (idle, mark, since))
        done = self.has_converged(state) | (search.trials >= self.most) | (since >= LONG)
        return y, eqx.tree_at(lambda s: s.terminate, state, done), state.aux

    def has_converged(self, state) -> Bool[Array, ""]:
        """Whether little is expected from another trial."""
        expected = state.descent_state.expected
        stalled = (state.search_state.idle >= 3) & (expected < STALLED * 2.0 * state.f_info.as_min())
        return (expected < self.tolerance) | stalled


def _say_nothing(**more):
    pass


def eliminate_nuisances(shared, own, right):
    """Columns and right-hand side orthogonal to each record's nuisance columns (numpy arrays).

    Shapes of `shared`, `own`, `right`: (records, rows, shared), (records, rows, own), (records, rows); the first and
    last are returned.
    """
    q, _ = np.linalg.qr(own)
    both = np.concatenate([shared, right[..., None]], axis=-1)
    both = both - q @ (np.swapaxes(q, -1, -2) @ both)
    return both[..., :-1], both[..., -1]
