r"""One impact planned for many contact laws at once: for the mean over them, or for the worst of them.

With laws of weights $w_i$, what is wanted small comes out as $s_i$. Planned is for the mean $\sum w_i s_i$ or for the
mean of the worst share $\alpha$, the conditional value at risk (Rockafellar and Uryasev 2000),

$\mathrm{CVaR}_\alpha = \max_q \sum q_i s_i$ over $0 \le q_i \le w_i/\alpha$, $\sum q_i = 1$.

The draws stay the same throughout, so that plans differ by what they do and not by chance.
"""

import math
from collections.abc import Sequence
from typing import Literal

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from scipy.optimize import minimize

from .._display import Progress
from .draws import Laws, split_laws
from .guesses import find_bounds
from .strike_plan import LOST, StrikePlan, Tally, weigh_constraints
from .strike_problem import CONSTRAINTS, StrikeProblem, evaluate, evaluate_slopes, read_design, score, strike_debris


Aim = Literal["mean", "tail"]
WIDTH = 1e-4  # smoothing of the tail of what is wanted [-]
NARROW = 1e-5  # and of the constraints
KEPT = 3e-4  # by which the tail mean of a scaled constraint may be missed
HALVINGS = 60


def find_tail(values: np.ndarray, weights: np.ndarray, tail: float) -> float:
    """Mean of the largest values that together have a share of the weight; exact, `values` shape (draws,)."""
    order = np.argsort(-values)
    taken = np.clip(tail - (np.cumsum(weights[order]) - weights[order]), 0.0, weights[order])
    return float(taken @ values[order] / taken.sum())


def smooth_tail(values: np.ndarray, weights: np.ndarray, tail: float, width: float = WIDTH
                ) -> tuple[np.ndarray, np.ndarray]:
    r"""Mean of the largest values, without its kinks: $\max_q \sum q_i s_i - \frac\delta2 \sum (q_i - w_i)^2 / w_i$.

    With few fixed draws the sorted tail mean has a kink wherever two draws change places, at which quadratic
    programming stalls, and the form of Rockafellar and Uryasev keeps it or adds a variable a draw; the penalty
    (Nesterov 2005) takes it away, the derivative is $q$ itself, and the value stays between the mean and the exact tail
    mean, at most $\frac\delta2 (1/\alpha - 1)$ below this. Draws that agree lose nothing.

    Args:
        values: shape (draws, columns).
        weights: with sum 1, shape (draws,).
        tail: share of the weight, $\alpha$; 1 for the mean.
        width: $\delta$, in units of the values.

    Returns:
        The value, shape (columns,), and the draws' shares in its derivative $q$, shape (draws, columns).
    """
    own = weights[:, None]

    def share(level):
        return np.clip(own * (1.0 + (values - level) / width), 0.0, own / tail)

    low, high = values.min(axis=0), values.max(axis=0)
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        over = share(middle).sum(axis=0) > 1.0
        low, high = np.where(over, middle, low), np.where(over, high, middle)
    found = share(0.5 * (low + high))
    found = found / found.sum(axis=0)
    penalty = np.sum((found - own) ** 2 / own, axis=0)
    return np.sum(found * values, axis=0) - 0.5 * width * penalty, found


def pose_draws(problem: StrikeProblem, laws: Laws) -> list[StrikeProblem]:
    """The problem with every drawn law."""
    return [eqx.tree_at(lambda p: p.law, problem, law) for law in split_laws(laws.draws)]


def evaluate_draws(problems: Sequence[StrikeProblem], face: int, x: np.ndarray) -> np.ndarray:
    """What is wanted small and all constraints under every law, shape (draws, 1 + constraints).

    The laws share the program of a single impact, called once a draw: on two cores 32 draws with derivatives take
    0.24 s so, and 0.58 s in a program of their own under `vmap` (which integrates all as long as the longest, and takes
    another minute to compile).
    """
    number, point = jnp.asarray(face), jnp.asarray(x)
    found = np.stack([np.asarray(evaluate(one, number, point)) for one in problems])
    lost = ~np.isfinite(found).all(axis=1)
    found[lost] = np.where(np.arange(found.shape[1]) == 0, LOST, -1.0)
    return found


def evaluate_draw_slopes(problems: Sequence[StrikeProblem], face: int, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The same with derivatives by the seven variables, shape (draws, 1 + constraints, 7)."""
    number, point = jnp.asarray(face), jnp.asarray(x)
    both = [evaluate_slopes(one, number, point) for one in problems]
    value, slopes = (np.stack([np.asarray(one[k]) for one in both]) for k in (0, 1))
    lost = ~np.isfinite(value).all(axis=1)
    value[lost] = np.where(np.arange(value.shape[1]) == 0, LOST, -1.0)
    return value, np.nan_to_num(slopes)


def judge_draws(values: np.ndarray, weights: np.ndarray, aim: Aim, tail: float) -> tuple[np.ndarray, np.ndarray]:
    """What is planned for and the tail means of all constraints, of values under every law.

    Args:
        values: shape (draws, 1 + constraints).
        weights: of the draws.
        aim: `mean` or `tail`.
        tail: share of the draws that counts as the bad tail, also for a constraint: one whose mean over its worst share
            of the draws is allowed fails in less than that share.

    Returns:
        Shape (1 + constraints,), and the draws' shares in its derivative, shape (draws, 1 + constraints).
    """
    wanted, first = smooth_tail(values[:, :1], weights, tail if aim == "tail" else 1.0)
    kept, others = smooth_tail(-values[:, 1:], weights, tail, NARROW)
    return np.concatenate([wanted, -kept]), np.concatenate([first, others], axis=1)


class RobustSearch:
    """What is planned for, as SciPy asks for it; every draw is integrated once for values and derivatives.

    Args:
        problem: what is given, allowed and wanted.
        laws: to plan for.
        face: that is struck.
        aim, tail: see `judge_draws`.
    """

    def __init__(self, problem: StrikeProblem, laws: Laws, face: int, aim: Aim, tail: float):
        self.problems, self.weights = pose_draws(problem, laws), laws.shares()
        self.face, self.tail = face, tail
        self.aim: Aim = aim
        self.tally = Tally()
        self.at: tuple[bytes, np.ndarray] = (b"", np.zeros(0))
        self.slopes_at: tuple[bytes, np.ndarray, np.ndarray] = (b"", np.zeros(0), np.zeros(0))

    def values(self, x: np.ndarray) -> np.ndarray:
        """Objective and constraints, shape (1 + constraints,)."""
        if self.at[0] != x.tobytes():
            self.tally.values += len(self.problems)
            drawn = evaluate_draws(self.problems, self.face, x)
            self.at = x.tobytes(), judge_draws(drawn, self.weights, self.aim, self.tail)[0]
        return self.at[1]

    def slopes(self, x: np.ndarray) -> np.ndarray:
        """Their derivatives by the seven variables, shape (1 + constraints, 7)."""
        if self.slopes_at[0] != x.tobytes():
            self.tally.slopes += len(self.problems)
            drawn, slopes = evaluate_draw_slopes(self.problems, self.face, x)
            value, shares = judge_draws(drawn, self.weights, self.aim, self.tail)
            self.slopes_at = x.tobytes(), value, np.einsum("dc,dcv->cv", shares, slopes)
        return self.slopes_at[2]


def plan_robust_strike(problem: StrikeProblem, laws: Laws, plan: StrikePlan, *, aim: Aim = "tail", tail: float = 0.1,
                       steps: int = 30, progress: Progress | None = None) -> StrikePlan:
    """Change a plan for the best estimate into one for all draws of the contact law.

    Args:
        problem: what is given, allowed and wanted; its own law is the best estimate.
        laws: that may be true.
        plan: for the best estimate, on whose face the new one stays.
        aim: whether the mean over the draws or that of their worst share is made small.
        tail: that share; every constraint has to hold in the mean of its own worst share of the draws.
        steps: of sequential quadratic programming (SLSQP) at most.
        progress: called with a sentence and nan: how much is done is not known.

    Returns:
        A plan whose `score` is what was made small, whose `values` are the tail means of the constraints and whose
        certificate is that of this problem; `design` and `collision` are those under the best estimate.
    """
    face = problem.debris.surface.face_names().index(plan.face)
    search = RobustSearch(problem, laws, face, aim, tail)
    bounds = find_bounds(problem, face)
    if progress is not None:
        progress(f"planning for the {aim} over {len(search.problems)} draws", math.nan)
    found = minimize(
        lambda z: search.values(z)[0], plan.x, jac=lambda z: search.slopes(z)[0], method="SLSQP", bounds=bounds,
        constraints={"type": "ineq", "fun": lambda z: search.values(z)[1:], "jac": lambda z: search.slopes(z)[1:]},
        options={"maxiter": steps, "ftol": 1e-7})
    ends = [np.clip(found.x, *bounds.T), np.asarray(plan.x)]

    def order(x):
        value = search.values(x)
        short = float(value[1:].min())
        return (short < -KEPT, -short if short < -KEPT else float(value[0]))

    x = min(ends, key=order)
    slopes, value = search.slopes(x), search.values(x)
    design = read_design(problem, jnp.asarray(face), jnp.asarray(x))
    collision = strike_debris(problem, design)

    def wanted(z):
        drawn = evaluate_draws(search.problems, face, z)
        return np.nan if drawn[:, 0].max() >= LOST else float(judge_draws(drawn, search.weights, aim, tail)[0][0])

    proof = weigh_constraints(wanted, value, slopes, bounds, x, float(collision.margin))
    # Closed forms say nothing of draws.
    untouched = float(score(problem, problem.angular_velocity))
    return StrikePlan(plan.face, x, float(value[0]), untouched, untouched,
                      dict(zip(CONSTRAINTS, map(float, value[1:]), strict=True)), design, collision,
                      bool(value[1:].min() >= -KEPT), proof, search.tally,
                      ((plan.face, float(value[0]), bool(value[1:].min() >= -KEPT)),))
