"""A whole sequence as one problem: all impacts and waits change together, with the gradient through all of them."""

import dataclasses as dc

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from scipy.optimize import minimize

from .sequence import Sequence
from .strike_plan import ALLOWED, find_bounds
from .strike_problem import Problem, judge, read_design, strike_debris, with_slopes


@dc.dataclass(frozen=True)
class Chain:
    """Variables of all impacts that were changed together.

    Attributes:
        x: shape (impacts, 7), over -1 to 1.
        impulse: of all contact forces, their sizes added up [N s].
        before: the same of the sequence that it was made from [N s].
        share: of the angular momentum left [-].
        allowed: whether every impact's constraints and the share hold.
    """

    x: np.ndarray
    impulse: float
    before: float
    share: float
    allowed: bool


def _follow(problem: Problem, faces: Array, x: Array, adjoint: dfx.AbstractAdjoint | None) -> Array:
    start = problem.debris.inertia @ problem.angular_velocity

    def strike(state, one):
        face, variables = one
        now = eqx.tree_at(lambda p: (p.attitude, p.angular_velocity), problem, state)
        design = read_design(now, face, variables)
        collision = strike_debris(now, design, adjoint)
        row = jnp.concatenate([jnp.linalg.norm(collision.impulse)[None], judge(now, design, collision)])
        return (collision.attitude, collision.angular_velocity), row

    (_, rates), rows = jax.lax.scan(strike, (problem.attitude, problem.angular_velocity), (faces, x))
    left = jnp.sum((problem.debris.inertia @ rates) ** 2) / jnp.sum(start**2)
    return jnp.concatenate([jnp.sum(rows[:, 0])[None], left[None], jnp.ravel(rows[:, 1:])])


@eqx.filter_jit
def follow_chain(problem: Problem, faces: Array, x: Array) -> Array:
    """Sum of the impulses [N s], square of the share of |L| left, and all constraints of all impacts.

    Args:
        problem: of the first impact.
        faces: shape (impacts,).
        x: shape (impacts, 7).

    Returns:
        Shape (2 + impacts * constraints,).
    """
    return _follow(problem, faces, x, None)


@eqx.filter_jit
def follow_slopes(problem: Problem, faces: Array, x: Array) -> tuple[Array, Array]:
    """The same with derivatives by all variables of all impacts, the second shape (values, impacts, 7)."""
    return with_slopes(lambda x: _follow(problem, faces, x, dfx.ForwardMode()), x)


def refine_sequence(problem: Problem, sequence: Sequence, share: float, steps: int = 40) -> Chain:
    """Change all impacts of a sequence together for the least impulse that leaves no more than a share of the momentum.

    Args:
        problem: of the first impact.
        sequence: planned one impact after the other.
        share: of the angular momentum [-].
        steps: of sequential quadratic programming at most.
    """
    names = problem.debris.surface.face_names()
    faces = np.array([names.index(plan.face) for plan in sequence.impacts])
    first = np.stack([plan.x for plan in sequence.impacts])
    bounds = np.concatenate([find_bounds(names, int(face)) for face in faces])
    shape = first.shape
    seen: dict[bytes, tuple[np.ndarray, np.ndarray]] = {}

    def look(z):
        key = z.tobytes()
        if key not in seen:
            seen.clear()
            value, slopes = follow_slopes(problem, jnp.asarray(faces), jnp.asarray(z.reshape(shape)))
            rows = np.nan_to_num(np.asarray(slopes)).reshape(-1, z.size)
            seen[key] = np.nan_to_num(np.asarray(value), nan=-1.0), rows
        return seen[key]

    before, limit = sequence.impulse, max(share, 1e-6) ** 2

    def constraints(z):
        value = look(z)[0]
        return np.concatenate([[1.0 - value[1] / limit], value[2:]])

    def constraint_slopes(z):
        slopes = look(z)[1]
        return np.concatenate([-slopes[1:2] / limit, slopes[2:]])

    found = minimize(
        lambda z: look(z)[0][0] / before, first.ravel(), jac=lambda z: look(z)[1][0] / before, method="SLSQP",
        bounds=bounds, constraints={"type": "ineq", "fun": constraints, "jac": constraint_slopes},
        options={"maxiter": steps, "ftol": 1e-6})
    best = np.clip(found.x, *bounds.T)
    value = np.asarray(follow_chain(problem, jnp.asarray(faces), jnp.asarray(best.reshape(shape))))
    left = float(np.sqrt(value[1]))
    return Chain(best.reshape(shape), float(value[0]), before, left,
                 bool(value[2:].min() >= -ALLOWED and left <= share * (1 + 1e-3)))
