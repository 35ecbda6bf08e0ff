r"""One impact planned for many contact laws, and many errors of arm and body, at once: for the mean over them, or for
the worst of them.

With draws of weights $w_i$, what is wanted small comes out as $s_i$. Planned is for the mean $\sum w_i s_i$ or for the
mean of the worst share $\alpha$, the conditional value at risk (Rockafellar and Uryasev 2000),

$\mathrm{CVaR}_\alpha = \max_q \sum q_i s_i$ over $0 \le q_i \le w_i/\alpha$, $\sum q_i = 1$.

The draws stay the same throughout, so that plans differ by what they do and not by chance.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._display import Progress, stay_silent
from .draws import Laws
from .errors import err
from .multistart import PENALTY, Place, find_bounds, find_starts
from .problem import StrikeProblem
from .single import (
    LOST,
    StrikePlan,
    Tally,
    certify,
    compute_impact,
    compute_slopes,
    descend,
    make_plan,
    refine,
    remember,
)
from .uncertainty import pose_draws


Aim = Literal["mean", "tail"]
Errors = Sequence[Mapping[str, Array]]
Values = Callable[[np.ndarray], np.ndarray]
WIDTH = 1e-4  # smoothing of the tail of what is wanted [-]: larger biases the tail, smaller is too sharp for a descent
NARROW = 1e-5  # and of the constraints, finer, as a limit is not to be passed by the smoothing
KEPT = 3e-4  # by which the tail mean of a scaled constraint may be missed: what the smoothing itself leaves
HALVINGS = 60  # of an interval: enough for all digits of a double
# Designs that the draws are tried on, and of these, the best, from which a descent begins: it takes seconds.
LOOKED_AT, BEGUN = 32, 3
STEPS = 30  # of a descent at most: it starts at the plan for the best estimate, which is near


def smooth_tail(values: np.ndarray, weights: np.ndarray, tail: float, width: float = WIDTH
                ) -> tuple[np.ndarray, np.ndarray]:
    r"""Mean of the largest values, without its kinks: $\max_q \sum q_i s_i - \frac\delta2 \sum (q_i - w_i)^2 / w_i$.

    With few fixed draws the sorted tail mean has a kink wherever two draws change places, at which quadratic
    programming stalls; the penalty (Nesterov 2005) takes it away, the derivative is $q$ itself, and the value stays
    between the mean and the exact tail mean, at most $\frac\delta2 (1/\alpha - 1)$ below this. Draws that agree lose
    nothing.

    Of values of shape (draws, columns), weights with sum 1, `tail` $\alpha$, 1 for the mean, and `width` $\delta$, in
    units of the values: the value, shape (columns,), and the draws' shares $q$ in its derivative, shape (draws,
    columns).
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


class RobustProblem:
    """What is planned for, and the constraints, each a mean over the draws or over their worst share; see
    `plan_robust_strike`.

    Every draw is a law of the contact, an error of arm and body, or one of each. They share the program of a single
    impact, called once a draw: on two cores 32 laws with derivatives take 0.24 s so, and 0.58 s in a program of their
    own under `vmap`, which integrates all as long as the longest.
    """

    def __init__(self, problem: StrikeProblem, face: int, laws: Laws | None, errors: Errors, aim: Aim, tail: float,
                 tally: Tally | None = None):
        problems = [problem] * len(errors) if laws is None else pose_draws(problem, laws.draws)
        self.draws = list(zip(problems, errors or [None] * len(problems), strict=True))
        self.weights = np.full(len(problems), 1.0 / len(problems)) if laws is None else laws.shares()
        self.face, self.tally, self.shares = face, tally or Tally(), (tail if aim == "tail" else 1.0, tail)

    def evaluate(self, x: np.ndarray) -> np.ndarray:
        """What is wanted small and all constraints of every draw, shape (draws, 1 + constraints)."""
        return np.stack([compute_impact(one, self.face, x, error) for one, error in self.draws])

    def judge(self, drawn: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Objective and constraints, shape (1 + constraints,), of values under every law, and the draws' shares in
        their derivatives, shape (draws, 1 + constraints).
        """
        wanted, first = smooth_tail(drawn[:, :1], self.weights, self.shares[0])
        kept, others = smooth_tail(-drawn[:, 1:], self.weights, self.shares[1], NARROW)
        return np.concatenate([wanted, -kept]), np.concatenate([first, others], axis=1)

    def values(self, x: np.ndarray) -> np.ndarray:
        """Objective and constraints, shape (1 + constraints,)."""
        self.tally.values += len(self.draws)
        return self.judge(self.evaluate(x))[0]

    def slopes(self, x: np.ndarray) -> np.ndarray:
        """Their derivatives by the seven variables, shape (1 + constraints, 7)."""
        self.tally.slopes += len(self.draws)
        drawn, slopes = map(np.stack, zip(*(compute_slopes(one, self.face, x, error) for one, error in self.draws),
                                          strict=True))
        return np.einsum("dc,dcv->cv", self.judge(drawn)[1], slopes)

    def wanted(self, x: np.ndarray) -> float:
        """The objective alone, not counted; NaN where a draw cannot be integrated."""
        drawn = self.evaluate(x)
        return np.nan if drawn[:, 0].max() >= LOST else float(self.judge(drawn)[0][0])


def plan_robust_strike(problem: StrikeProblem, plan: StrikePlan, laws: Laws | None, *, errors: Errors = (),
                       aim: Aim = "tail", tail: float = 0.1, seed: int = 0, progress: Progress | None = None
                       ) -> StrikePlan:
    """Change a plan for the best estimate, or one of the designs that are allowed beside it, into one for all draws of
    the contact law, of errors of arm and body, or of both.

    Args:
        problem: what is given, allowed and wanted; its own law is the best estimate.
        plan: for the best estimate.
        laws: that may be true; None where the contact is known.
        errors: of `draw_errors`; none, or one for every law.
        aim: whether the mean over the draws or that of their worst share is made small.
        seed: of the places where the search starts beside the plan.
        tail: that share; every constraint has to hold in the mean of its own worst share of the draws.
        progress: called with a sentence at every design that is tried on all draws, and nan.

    Returns:
        A plan whose `score` is what was made small, whose `values` are the tail means of the constraints and whose
        certificate is that of this problem; `design` and `collision` are those under the best estimate.
    """
    tally, posed, tell, stage = Tally(), {}, progress or stay_silent, "designs beside the plan"

    def follow(compute: Values) -> Values:
        """The same, telling that it is called."""
        def run(x: np.ndarray) -> np.ndarray:
            tell(f"{stage}, on all draws ({tally.values + tally.slopes} contacts integrated)", math.nan)
            return compute(x)

        return remember(run)

    def pose(face: int) -> tuple[RobustProblem, Values, Values]:
        """The problem on one face, its values and its slopes."""
        if face not in posed:
            robust = RobustProblem(problem, face, laws, errors, aim, tail, tally)
            posed[face] = robust, follow(robust.values), follow(robust.slopes)
        return posed[face]

    def order(place: Place) -> tuple[bool, float]:
        value = pose(place[0])[1](place[1])
        short = float(value[1:].min())
        return (short < -KEPT, -short if short < -KEPT else float(value[0]))

    def penalise(place: Place) -> float:
        value = pose(place[0])[1](place[1])
        return float(value[0] + PENALTY * np.sum(np.maximum(-value[1:], 0.0)))

    begun = [plan.place]
    if errors:  # from an edge, whatever the ball misses tells a descent nothing
        face, first = plan.place
        tell("stepping back from edges", math.nan)
        begun.append((face, refine(_step_back(problem, plan, errors), face, first, tally)[0]))
    # Where little is left without errors, many designs are alike, and the draws tell which of them is the best.
    others = [*plan.others, *find_starts(problem, LOOKED_AT, seed=seed)[0]]
    begun += sorted(others, key=penalise)[:BEGUN]
    ends = []
    for k, (face, x) in enumerate(begun, 1):
        stage = f"descent {k} of {len(begun)}"
        ends.append((face, descend(*pose(face)[1:], x, find_bounds(problem, face), STEPS)))
    face, x = min([*ends, *begun], key=order)
    robust, values, slopes = pose(face)
    value = values(x)
    [certificate] = certify(robust.wanted, value, slopes(x), find_bounds(problem, face), x)
    return make_plan(problem, face, x, certificate, tally, value, KEPT)


def _step_back(problem: StrikeProblem, plan: StrikePlan, errors: Errors) -> StrikeProblem:
    """The problem with as much more distance from edges, and as much less speed, as a plan's largest errors take."""
    design = jax.tree.map(jnp.asarray, plan.design)
    met = [err(problem, design, one)[1] for one in errors]
    reach = max(float(jnp.linalg.norm(one.point - design.point)) for one in met)
    faster = max(float(jnp.linalg.norm(one.velocity) / jnp.linalg.norm(design.velocity)) for one in met)
    limits = problem.limits
    return eqx.tree_at(lambda p: (p.limits.edge, p.limits.speed), problem,
                       (limits.edge + reach, limits.speed / max(faster, 1.0)))
