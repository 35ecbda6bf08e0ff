"""How sure a planned impact is, and a sequence: what is left under every drawn law, and whether rival effects matter.

Every impact of a sequence is struck as planned: at its place on the body, with its velocity relative to that, its
pressure, and its wait after the impact before. So the arm follows the body as it sees it, and nothing is planned again;
what an impact leaves otherwise than planned, the next ones meet.
"""

import dataclasses as dc
import shlex
from collections.abc import Mapping, Sequence
from typing import Literal

import equinox as eqx
import numpy as np

from .._errors import ComputationError
from .._sentences import say
from ..contact.gripping import StrikeLaw
from ..posterior.stacking import name_rival
from .constraints import CONSTRAINTS, MISSED, Constraints
from .draws import Laws, split_batch
from .problem import Goal, StrikeProblem
from .sequence import SHARE, SLACK, follow_impacts
from .sequence import Sequence as Impacts
from .single import ALLOWED, LOST, StrikePlan, Tally, compute_impact, refine


REFERENCE = name_rival(())
# Share of the momentum at the start, below which no difference between models counts: no one measures it.
RESOLUTION = 1e-3
# Scaled constraint by which a limit may be passed before it counts: 1 %, more than the optimiser's tolerance.
BEYOND = 1e-2
# Unit of a scaled constraint; of all others per cent.
UNITS = {CONSTRAINTS.edge: (100.0, "mm"), CONSTRAINTS.next_edge: (100.0, "mm"), CONSTRAINTS.clear: (10.0, "mm")}


@dc.dataclass(frozen=True)
class Spread:
    """A quantity over the draws, in its unit; `tail` is the mean of its largest share."""

    mean: float
    sd: float
    q05: float
    q50: float
    q95: float
    tail: float


@dc.dataclass(frozen=True)
class Regret:
    """What it costs at most to have planned with another model than the true one, on the same face: in what is wanted
    small, in its unit, and by how much which limit is passed, scaled; '' where none is.
    """

    loss: float = 0.0
    beyond: float = 0.0
    limit: str = ""


@dc.dataclass(frozen=True, eq=False)
class Outlook:
    """What a plan does under the draws of one model, or of all."""

    weight: float  # of the model
    share_left: Spread  # of the angular momentum [-]
    peak_normal_force: Spread  # [N]
    peak_depression: Spread  # [m]
    violated: dict[str, float]  # probability that a constraint does not hold, by name
    draws: np.ndarray  # share left, one a draw, shape (draws,) [-]
    best_estimate: float  # share left under it [-]
    regret: Regret  # of a plan for another model where this one is true; of all models together the largest


@dc.dataclass(frozen=True, eq=False)
class Assessment:
    """How sure a plan is."""

    tail: float  # share of the draws that counts as the bad tail
    whole: Outlook  # over all models, by their weights
    models: Mapping[str, Outlook]  # by name
    difference: float  # largest difference of two models' means of the momentum left [-]
    within: float  # its standard deviation within a model, on average [-]
    matters: bool  # whether it matters for this plan which model is true
    sentences: tuple[str, ...]  # on the spread, and on that
    note: str  # where draws and weights come from


@dc.dataclass(frozen=True, eq=False)
class Prospect:
    """What a sequence does under the draws of all models."""

    share_left: tuple[Spread, ...]  # of the angular momentum, after each impact
    best_estimate: np.ndarray  # the same under it, shape (impacts,) [-]
    reached: float  # probability that no more than the wanted share is left at the end
    # Probability that a constraint of an impact does not hold, by the impact's number and its name; only those that are
    # not nought.
    violated: dict[str, float]
    # Probability that the sequence cannot be struck to its end, as an impact misses or cannot be integrated.
    lost: float
    sentence: str  # all of that in words


def find_tail(values: np.ndarray, weights: np.ndarray, tail: float) -> float:
    """Mean of the largest values that together have a share of the weight; exact, `values` shape (draws,)."""
    order = np.argsort(-values)
    taken = np.clip(tail - (np.cumsum(weights[order]) - weights[order]), 0.0, weights[order])
    return float(taken @ values[order] / taken.sum())


def summarise_draws(values: np.ndarray, weights: np.ndarray, tail: float) -> Spread:
    """Weighted mean, deviation, quantiles and tail mean; quantiles between the middles of the draws' weights."""
    shares = weights / weights.sum()
    mean = float(shares @ values)
    order = np.argsort(values)
    places = np.cumsum(shares[order]) - 0.5 * shares[order]
    low, middle, high = (float(q) for q in np.interp([0.05, 0.5, 0.95], places, values[order]))
    return Spread(mean, float(np.sqrt(shares @ (values - mean) ** 2)), low, middle, high,
                  find_tail(values, shares, tail))


def pose_draws(problem: StrikeProblem, laws: StrikeLaw) -> list[StrikeProblem]:
    """The problem with every law of a batch."""
    return [eqx.tree_at(lambda p: p.law, problem, law) for law in split_batch(laws)]


def evaluate_draws(problems: Sequence[StrikeProblem], face: int, x: np.ndarray) -> np.ndarray:
    """What is wanted small and all constraints under every law, shape (draws, 1 + constraints)."""
    return np.stack([compute_impact(one, face, x) for one in problems])


def _look(problem: StrikeProblem, values: np.ndarray, weights: np.ndarray, tail: float, weight: float, nominal: float,
          regret: Regret) -> Outlook:
    """Values: momentum left and all constraints, shape (draws, 1 + constraints)."""
    scaled, limits = Constraints(*values[:, 1:].T), problem.limits
    return Outlook(
        weight, summarise_draws(values[:, 0], weights, tail),
        summarise_draws(float(limits.force) * (1.0 - scaled.force), weights, tail),
        summarise_draws(float(limits.depression) * (1.0 - scaled.depression), weights, tail),
        {name: float(weights @ (column < -ALLOWED) / weights.sum())
         for name, column in zip(CONSTRAINTS, scaled, strict=True)}, values[:, 0], nominal, regret)


def find_regrets(problem: StrikeProblem, plan: StrikePlan, laws: Laws) -> list[Regret]:
    """What a plan for another model costs where a model is true, one regret a model: the plan is changed for the best
    estimate of every model, and each of these plans is tried on all models.
    """
    (face, x), owns = plan.place, pose_draws(problem, laws.best)
    # One row a plan, one column a model: shape (models, models, 1 + constraints).
    tried = np.stack([evaluate_draws(owns, face, refine(own, face, x, Tally())[0]) for own in owns])
    tried = np.where(tried[..., :1] < LOST, tried, np.nan)
    found = []
    for k in range(len(owns)):
        loss = max(float(np.nan_to_num(tried[:, k, 0] - tried[k, k, 0]).max()), 0.0)
        worst = -np.nan_to_num(tried[:, k, 1:]).min(axis=0)
        limit = int(np.argmax(worst))
        passed = worst[limit] > ALLOWED
        found.append(Regret(loss, float(worst[limit]), CONSTRAINTS[limit]) if passed else Regret(loss))
    return found


def assess_plan(problem: StrikeProblem, plan: StrikePlan, laws: Laws, *, tail: float = 0.1,
                aim: Literal["best", "mean", "tail"] = "best") -> Assessment:
    """What a plan leaves under every drawn law, model by model, and whether it matters which model is true.

    It matters where two models' means differ, a plan for the wrong model costs, or such a plan passes a limit, by more
    than the parameters' own uncertainty (and by more than `RESOLUTION` or `BEYOND`). `tail` is the share of the draws
    that counts as the bad tail, `aim` what the plan was made for.

    Raises:
        ComputationError: the impact could be integrated under no draw of a model.
    """
    face, x = plan.place
    plain = eqx.tree_at(lambda p: p.goal, problem, Goal())  # what is wanted small is then the momentum left
    values = evaluate_draws(pose_draws(plain, laws.draws), face, x)
    best = evaluate_draws(pose_draws(plain, laws.best), face, x)
    weights, owners, note = laws.shares(), laws.owners(), laws.note
    lost = values[:, 0] >= LOST
    if lost.any():
        values, weights, owners = values[~lost], weights[~lost], owners[~lost]
        note += f" For {int(lost.sum())} of {len(lost)} draws the impact could not be integrated; they are left out."
    if len(np.unique(owners)) < len(laws.names):
        raise ComputationError("the planned impact could not be integrated for any draw of a model; its parameters are "
                               "too uncertain")
    regrets = find_regrets(problem, plan, laws) if len(laws.names) > 1 else [Regret()]
    models = {name: _look(problem, values[owners == k], weights[owners == k], tail, laws.weights[k],
                          float(best[k, 0]), regrets[k]) for k, name in enumerate(laws.names)}
    main = int(np.argmax(laws.weights))
    passed = max(regrets, key=lambda one: one.beyond)
    worst = Regret(max(one.loss for one in regrets), passed.beyond, passed.limit)
    whole = _look(problem, values, weights, tail, 1.0, float(best[main, 0]), worst)
    means = [one.share_left.mean for one in models.values()]
    # Standard deviations within a model, of the momentum left and of every constraint.
    inside = [np.average((own - own.mean(axis=0)) ** 2, axis=0)
              for own in (values[owners == k] for k in range(len(models)))]
    spreads = np.sqrt(np.average(inside, axis=0, weights=laws.weights))
    within, difference = float(spreads[0]), max(means) - min(means)
    slack = max(BEYOND, float(spreads[1 + CONSTRAINTS.index(worst.limit)]) if worst.limit else 0.0)
    costs = worst.loss > max(within, RESOLUTION) or worst.beyond > slack
    matters = costs or difference > max(within, RESOLUTION)
    sentences = [str(say("plan.spread", whole=whole, tail=tail, aim=aim, drawn=laws.drawn, held=laws.held))]
    if len(models) > 1:
        names = ["nothing" if name == REFERENCE else name.replace("+", " with ") for name in models]
        factor, unit = UNITS.get(worst.limit, (100.0, "%"))
        excess = f"{factor * worst.beyond:.1f} {unit}" if worst.beyond > BEYOND else ""
        sentences.append(str(say("plan.rivals", names=names, difference=difference, within=within, loss=worst.loss,
                                 limit=worst.limit, excess=excess, matters=matters, costs=costs,
                                 folder=laws.folder and shlex.quote(laws.folder))))
    return Assessment(tail, whole, models, difference, within, matters, tuple(sentences), note)


def assess_sequence(problem: StrikeProblem, sequence: Impacts, laws: Laws, share: float, *, tail: float = 0.1
                    ) -> Prospect | None:
    """Strike a planned sequence under every drawn law; arguments as of `assess_plan`. None where no draw could be
    followed to the end.
    """
    faces, x = np.array([plan.place[0] for plan in sequence.impacts]), np.stack([plan.x for plan in sequence.impacts])
    best = follow_impacts(eqx.tree_at(lambda p: p.law, problem, laws.main), faces, x)
    rows = np.stack([follow_impacts(one, faces, x) for one in pose_draws(problem, laws.draws)])
    weights = laws.shares()
    kept = Constraints(*np.moveaxis(rows[:, :, SHARE + 1:], -1, 0))
    whole = np.isfinite(rows).all(axis=(1, 2)) & ~(kept.approach <= MISSED - 1.0).any(axis=1)
    if not whole.any():
        return None
    lost = float(weights[~whole].sum())
    rows, weights = rows[whole], weights[whole] / weights[whole].sum()
    left = np.sqrt(np.maximum(rows[:, :, SHARE], 0.0))
    after = tuple(summarise_draws(column, weights, tail) for column in left.T)
    broken = np.einsum("d,dkc->kc", weights, rows[:, :, SHARE + 1:] < -ALLOWED)
    violated = {f"{k + 1}: {CONSTRAINTS[c]}": float(broken[k, c]) for k, c in zip(*np.nonzero(broken), strict=True)}
    reached = float(weights @ (left[:, -1] <= share * (1.0 + SLACK))) * (1.0 - lost)
    sentence = say("plan.sequence", count=len(after), end=after[-1], reached=reached, violated=violated, lost=lost,
                   share=share, tail=tail, momentum=problem.goal.is_momentum(), drawn=laws.drawn, held=laws.held)
    return Prospect(after, np.sqrt(np.maximum(best[:, SHARE], 0.0)), reached, violated, lost, str(sentence))
