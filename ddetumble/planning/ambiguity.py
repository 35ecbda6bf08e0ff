"""How sure a planned impact is: what it leaves under every drawn law, and whether rival effects matter for it."""

import dataclasses as dc
from collections.abc import Mapping

import equinox as eqx
import numpy as np

from .._errors import ComputationError
from ..posterior.stacking import name_rival
from .draws import Laws, split_laws
from .risk import evaluate_draws, find_tail, pose_draws
from .strike_plan import ALLOWED, LOST, StrikePlan, Tally, refine
from .strike_problem import CONSTRAINTS, Goal, StrikeProblem


REFERENCE = name_rival(())
RESOLUTION = 1e-3  # share of the momentum at the start, below which no difference between models counts
BEYOND = 1e-2  # scaled constraint by which a limit may be passed before it counts
UNITS = {"edge": (100.0, "mm"), "next edge": (100.0, "mm"), "nothing else hit": (10.0, "mm")}  # of all others per cent


@dc.dataclass(frozen=True)
class Spread:
    """A quantity over the draws.

    Attributes:
        mean, sd, q05, q50, q95: in its unit.
        tail: mean of its largest share.
    """

    mean: float
    sd: float
    q05: float
    q50: float
    q95: float
    tail: float


@dc.dataclass(frozen=True)
class Regret:
    """What it costs at most to have planned with another model than the true one, on the same face.

    Attributes:
        loss: of what is wanted small, in its unit; not negative.
        beyond: by how much a limit is passed, scaled.
        limit: which one; '' where none is.
    """

    loss: float = 0.0
    beyond: float = 0.0
    limit: str = ""


@dc.dataclass(frozen=True, eq=False)
class Outlook:
    """What a plan does under the draws of one model, or of all.

    Attributes:
        weight: of the model.
        momentum: share of the angular momentum left [-].
        peak_force: [N].
        peak_depression: [m].
        violated: probability that a constraint does not hold, by name.
        shares: of the momentum left, one a draw, shape (draws,) [-].
        nominal: share left under the best estimate [-].
        regret: of a plan for another model where this one is true; of all models together the largest.
    """

    weight: float
    momentum: Spread
    peak_force: Spread
    peak_depression: Spread
    violated: dict[str, float]
    shares: np.ndarray
    nominal: float
    regret: Regret


@dc.dataclass(frozen=True, eq=False)
class Assessment:
    """How sure a plan is.

    Attributes:
        tail: share of the draws that counts as the bad tail.
        whole: over all models, by their weights.
        models: by name.
        difference: largest difference of two models' means of the momentum left [-].
        within: its standard deviation within a model, on average [-].
        matters: whether it matters for this plan which model is true.
        sentences: on the spread, and on that.
        note: where draws and weights come from.
    """

    tail: float
    whole: Outlook
    models: Mapping[str, Outlook]
    difference: float
    within: float
    matters: bool
    sentences: tuple[str, ...]
    note: str


def summarise_draws(values: np.ndarray, weights: np.ndarray, tail: float) -> Spread:
    """Weighted mean, deviation, quantiles and tail mean; quantiles between the middles of the draws' weights."""
    shares = weights / weights.sum()
    mean = float(shares @ values)
    order = np.argsort(values)
    places = np.cumsum(shares[order]) - 0.5 * shares[order]
    low, middle, high = (float(q) for q in np.interp([0.05, 0.5, 0.95], places, values[order]))
    return Spread(mean, float(np.sqrt(shares @ (values - mean) ** 2)), low, middle, high,
                  find_tail(values, shares, tail))


def _look(problem: StrikeProblem, values: np.ndarray, weights: np.ndarray, tail: float, weight: float, nominal: float,
          regret: Regret) -> Outlook:
    """Values: momentum left and all constraints, shape (draws, 1 + constraints)."""
    shares = weights / weights.sum()
    scaled = dict(zip(CONSTRAINTS, values[:, 1:].T, strict=True))
    return Outlook(
        weight, summarise_draws(values[:, 0], shares, tail),
        summarise_draws(float(problem.limits.force) * (1.0 - scaled["peak force"]), shares, tail),
        summarise_draws(float(problem.limits.depression) * (1.0 - scaled["depression"]), shares, tail),
        {name: float(shares @ (column < -ALLOWED)) for name, column in scaled.items()}, values[:, 0], nominal, regret)


def find_regrets(problem: StrikeProblem, plan: StrikePlan, laws: Laws) -> list[Regret]:
    """What a plan for another model costs where a model is true, one regret a model.

    The plan is changed for the best estimate of every model, and each of these plans is tried on all models.
    """
    face = problem.debris.surface.face_names().index(plan.face)
    owns = [eqx.tree_at(lambda p: p.law, problem, law) for law in split_laws(laws.best)]
    ends = [refine(own, face, plan.x, Tally())[0] for own in owns]
    # One row a plan, one column a model: shape (models, models, 1 + constraints).
    tried = np.stack([evaluate_draws(owns, face, x) for x in ends])
    tried = np.where(tried[..., :1] < LOST, tried, np.nan)
    found = []
    for k in range(len(owns)):
        loss = float(np.nan_to_num(tried[:, k, 0] - tried[k, k, 0]).max())
        worst = -np.nan_to_num(tried[:, k, 1:]).min(axis=0)
        limit = int(np.argmax(worst))
        if worst[limit] > ALLOWED:
            found.append(Regret(max(loss, 0.0), float(worst[limit]), CONSTRAINTS[limit]))
        else:
            found.append(Regret(max(loss, 0.0)))
    return found


def assess_plan(problem: StrikeProblem, plan: StrikePlan, laws: Laws, *, tail: float = 0.1) -> Assessment:
    """What a plan leaves under every drawn law, model by model, and whether it matters which model is true.

    It matters where two models' means differ, a plan for the wrong model costs, or such a plan passes a limit, by more
    than the parameters' own uncertainty (and by more than `RESOLUTION` or `BEYOND`).

    Args:
        problem: what is given, allowed and wanted.
        plan: one impact.
        laws: that may be true.
        tail: share of the draws that counts as the bad tail.

    Raises:
        ComputationError: the impact could be integrated under no draw of a model.
    """
    face = problem.debris.surface.face_names().index(plan.face)
    plain = eqx.tree_at(lambda p: p.goal, problem, Goal())  # what is wanted small is then the momentum left
    values = evaluate_draws(pose_draws(plain, laws), face, plan.x)
    best = evaluate_draws([eqx.tree_at(lambda p: p.law, plain, law) for law in split_laws(laws.best)], face, plan.x)
    weights, owners, note = laws.shares(), laws.owners(), laws.note
    lost = values[:, 0] >= LOST
    if lost.any():
        values, weights, owners = values[~lost], weights[~lost], owners[~lost]
        note += f" Under {int(lost.sum())} of {len(lost)} draws the impact could not be integrated; they are left out."
    if len(np.unique(owners)) < len(laws.names):
        raise ComputationError("under no draw of a model could the planned impact be integrated; its parameters are "
                               "too uncertain")
    regrets = find_regrets(problem, plan, laws) if len(laws.names) > 1 else [Regret()]
    models = {name: _look(problem, values[owners == k], weights[owners == k], tail, laws.weights[k],
                          float(best[k, 0]), regrets[k]) for k, name in enumerate(laws.names)}
    main = int(np.argmax(laws.weights))
    passed = max(regrets, key=lambda one: one.beyond)
    worst = Regret(max(one.loss for one in regrets), passed.beyond, passed.limit)
    whole = _look(problem, values, weights, tail, 1.0, float(best[main, 0]), worst)
    means = [one.momentum.mean for one in models.values()]
    # Standard deviations within a model, of the momentum left and of every constraint.
    inside = [np.average((own - own.mean(axis=0)) ** 2, axis=0)
              for own in (values[owners == k] for k in range(len(models)))]
    spreads = np.sqrt(np.average(inside, axis=0, weights=laws.weights))
    within, difference = float(spreads[0]), max(means) - min(means)
    slack = max(BEYOND, float(spreads[1 + CONSTRAINTS.index(worst.limit)]) if worst.limit else 0.0)
    costs = worst.loss > max(within, RESOLUTION) or worst.beyond > slack
    matters = costs or difference > max(within, RESOLUTION)
    sentences = [_describe_spread(whole, tail)]
    if len(models) > 1:
        sentences.append(_describe_rivals(list(models), difference, within, worst, matters, costs, laws.folder))
    return Assessment(tail, whole, models, difference, within, matters, tuple(sentences), note)


def _describe_spread(whole: Outlook, tail: float) -> str:
    """How much is left, and how often a limit is passed."""
    one = whole.momentum
    passed = [f"{name} ({100 * share:.0f} % of the draws)" for name, share in whole.violated.items() if share > 0]
    limits = f"Not kept in every draw: {', '.join(passed)}." if passed else "Every limit is kept in every draw."
    return (f"Under the uncertainty of the contact the first impact leaves {100 * one.mean:.2f} ± {100 * one.sd:.2f} % "
            f"of the angular momentum (90 % of the draws: {100 * one.q05:.2f} to {100 * one.q95:.2f} %), in the worst "
            f"{100 * tail:.0f} % of the draws {100 * one.tail:.2f} % on average. {limits}")


def _describe_rivals(names: list[str], difference: float, within: float, worst: Regret, matters: bool, costs: bool,
                     folder: str) -> str:
    """Whether it matters which of the models is true."""
    side = "more" if difference > within else "less"
    names = ["nothing" if name == REFERENCE else name.replace("+", " with ") for name in names]
    told = (f"Whether {', '.join(names[:-1])} or {names[-1]} is missing changes the momentum left by "
            f"{100 * difference:.2f} % of the start, {side} than the parameters' own uncertainty ({100 * within:.2f} "
            f"%), and to plan with the wrong one costs at most {100 * worst.loss:.2f} %")
    if worst.beyond > BEYOND:
        factor, unit = UNITS.get(worst.limit, (100.0, "%"))
        told += f" and passes a limit ({worst.limit}) by up to {factor * worst.beyond:.1f} {unit}"
    if not matters:
        return f"{told}: it does not matter for this plan."
    after = f" `ddetumble design {folder}` says which test tells them apart." if folder else ""
    if not costs:
        return f"{told}: it matters for what to expect, though not for how to strike.{after}"
    return f"{told}: it matters for this plan.{after}"
