r"""Weights of rival models by stacking: the mixture that predicts left-out conditions best.

Every model is fitted under the same noise, and every condition left out once. With the predictive density
$p_k(y_g | y_{-g})$ of model k for the condition g that it has not seen, the weights maximise
$\sum_g \ln \sum_k w_k\, p_k(y_g | y_{-g})$ over $w_k \ge 0$, $\sum_k w_k = 1$ (Yao et al. 2018). They say how much each
model adds to a prediction, not how probable it is: of two that predict alike, any split is as good.
"""

import dataclasses as dc
import json
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import equinox as eqx
import numpy as np
import pydantic
from scipy import optimize

from .._display import AbstractPrinted, Progress
from .._errors import ComputationError, InputError
from ..contact.effect import AbstractEffect
from ..inference.archive import Model, load
from ..inference.bounded import solve_bounded
from ..inference.estimation import fit
from ..inference.files import check_folder, list_versions, make_plain, read_json, refuse_peaks, write_json
from ..inference.findings import AbstractRivals, Fit, summarise_fit
from ..inference.noise import Noise
from ..inference.problem import Problem
from ..inference.stack import stack_records
from ..measurement.campaign import Campaign
from ..measurement.package import read_campaign
from .loo import COSTLY, Scores, add_up, describe_draws, limit_shape, score_conditions, smooth_weights
from .proposal import Mixture, start_mixture
from .result import align_table
from .target import CampaignTarget, pose_fit


FILE = "weights.json"
SCHEMA = "ddetumble.weights/2"
# Vehtari's advice on elpd_diff (loo, cross-validation FAQ): below 4 models predict alike whatever the standard error,
# which is itself too small there; above, the difference has to be large beside it.
LEAST = 4.0
ERRORS = 2.0  # standard errors that it has to exceed, too
NEARLY_ALL = 0.95  # weight from which on a mixture is the one model
FEW = 8  # conditions below which a standard error from their scatter is itself a guess
NOTHING = 1e-4  # weights below are none
RESULT = "result.json"
DRAWS = 480  # about each fit
ROUNDS = 3  # in which the draws follow the posterior, at most
Outcome = Literal["best", "preferred", "favoured", "indistinguishable"]
Rivals = Sequence[str | Sequence[str | type[AbstractEffect]]]


@dc.dataclass(frozen=True, eq=False)
class Rival:
    """One model of a set.

    Attributes:
        name: its effects joined by `+`, or `reference`; `folder` that its fit goes into.
        fit: its fit, all rivals under the same noise.
        scores: left-out conditions.
        weight: by stacking.
        difference: of its elpd from that of the best; negative or 0.
        standard_error: of the difference, from its scatter over conditions.
        outcome: the comparison with the best, as `judge_difference` names it; `best` of the best itself.
    """

    name: str
    folder: str
    fit: Fit
    scores: Scores
    weight: float
    difference: float
    standard_error: float
    outcome: Outcome


@dc.dataclass(frozen=True, eq=False, repr=False)
class ModelWeights(AbstractPrinted):
    """Rival models with their weights.

    Attributes:
        campaign, sha256: that they were fitted to.
        model: reference model.
        rivals: best left-out score first.
        sentence: what the weights mean, and whether the data tell the models apart.
        notes: further sentences.
    """

    campaign: str
    sha256: str
    model: str
    rivals: tuple[Rival, ...]
    sentence: str
    notes: tuple[str, ...]

    def __repr__(self) -> str:
        return f"<ModelWeights of {', '.join(f'{r.name} {r.weight:.2f}' for r in self.rivals)}>"

    @property
    def weights(self) -> dict[str, float]:
        """By name of the rival."""
        return {one.name: one.weight for one in self.rivals}

    def __str__(self) -> str:
        """The report."""
        rows = [("", "weight", "elpd", "behind the best", "std. error", "largest k", "refits", "chi2/dof")]
        for one in self.rivals:
            scores = one.scores.scores
            rows.append((one.name, f"{one.weight:.3f}", f"{one.scores.elpd:.1f}", f"{abs(one.difference):.1f}",
                         f"{one.standard_error:.1f}", f"{max(s.pareto_k for s in scores):.2f}",
                         f"{sum(s.way == 'refit' for s in scores)} of {len(scores)}", f"{one.fit.chi2_reduced:.4g}"))
        return "\n".join([self.sentence, "", *align_table(rows), "", *(f"- {note}" for note in self.notes)])

    def to_dict(self) -> dict[str, Any]:
        """`weights.json`: plain data."""
        conditions = [{"conditions": one.conditions, "records": one.records} for one in self.rivals[0].scores.scores]
        return make_plain({
            "schema": SCHEMA, "campaign": self.campaign, "sha256": self.sha256, "model": self.model,
            "sentence": self.sentence, "notes": self.notes, "left_out": conditions,
            "rivals": [{
                "name": one.name, "folder": one.folder, "effects": one.fit.effects, "weight": one.weight,
                "elpd": one.scores.elpd, "elpd_standard_error": one.scores.standard_error,
                "difference": one.difference, "standard_error": one.standard_error, "outcome": one.outcome,
                "chi2_reduced": one.fit.chi2_reduced, "text": one.scores.text,
                "left_out": [{"elpd": s.elpd, "pareto_k": s.pareto_k, "way": s.way, "trusted": s.trusted}
                             for s in one.scores.scores],
            } for one in self.rivals],
            "versions": list_versions(),
        })  # fmt: skip

    def save(self, folder) -> Path:
        """Write every rival's fit into a folder below this one, then `weights.json`; returns the folder."""
        folder = check_folder(folder, "weights")
        # Weights of an earlier set must not stand beside the fits of this one.
        (folder / FILE).unlink(missing_ok=True)
        for one in self.rivals:
            target = folder / one.folder
            if target.is_symlink() or (target.exists() and not target.is_dir()):
                raise InputError("is in the way; remove it, or name another folder", file=target)
            if target.is_dir() and not any(target.iterdir()):
                shutil.rmtree(target)
            one.fit.save(target)
        write_json(folder / FILE, self.to_dict())
        return folder


def average(source: Campaign | str | Path | AbstractRivals | Sequence[Fit], models: Rivals = (), model: Model = "paper",
            *, campaign: Campaign | str | Path | None = None, progress: Progress | None = None, seed: int = 0,
            **fitting: Any) -> ModelWeights:
    r"""Stacking weights $w_k$ of rival models: by how well they predict conditions that they have not seen.

    Args:
        source: fits of one campaign (`[found.best, *found.rivals]`); a discovery, or a folder that `discover` wrote,
            whose model and those that its last step could not tell from it are the rivals; or a campaign or its folder.
        models: the rivals, where the source is a campaign: of each the effects that extend the reference model, as a
            list, or as a text with commas;
            `none` for the reference model alone.
        model: reference model, as for `fit`.
        campaign: of which a folder of `discover` speaks.
        progress: called with a sentence and the share done.
        seed: of the random numbers.
        **fitting: further arguments of `fit`.

    Raises:
        InputError: The campaign cannot be fitted, two rivals are the same, there is but one, or an effect is unknown.
        ComputationError: A model cannot be computed.
    """
    report = progress or (lambda text, share: None)
    notes: list[str] = []
    if isinstance(source, (AbstractRivals, Sequence)) and not isinstance(source, str):
        if models or fitting:
            raise InputError("fits in hand are averaged as they are; leave out the models and further arguments")
        fits = [source.best, *source.rivals] if isinstance(source, AbstractRivals) else list(source)
        return average_fits(fits, progress=progress, seed=seed)
    if not isinstance(source, Campaign) and (Path(source) / RESULT).is_file():
        if models:
            raise InputError("the folder says which models are rivals; leave out the effects, or name the campaign "
                             "itself", file=source)
        model, models, notes = read_rivals(Path(source), campaign)
        source = campaign if campaign is not None else source
    measured = source if isinstance(source, Campaign) else read_campaign(source)
    rivals = [_split(one) for one in models]
    if len(rivals) < 2:
        raise InputError("there have to be at least two models to average; name the effects of each, `none` for the "
                         "reference model alone")
    fits: list[Fit] = []
    for k, effects in enumerate(rivals):
        report(f"fitting {name_rival([e if isinstance(e, str) else e.id for e in effects])}", 0.4 * k / len(rivals))
        fits.append(fit(measured, model, effects, **fitting))
    return average_fits(fits, progress=lambda text, share: report(text, 0.4 + 0.6 * share), seed=seed, notes=notes)


def average_fits(fits: Sequence[Fit], *, progress: Progress | None = None, seed: int = 0, notes: Sequence[str] = ()
                 ) -> ModelWeights:
    """As `average`, for models that are fitted already, to one campaign.

    Raises:
        InputError: There are fewer than two, two are the same, or they are of different campaigns.
        ComputationError: A model cannot be computed.
    """
    report, fits = progress or (lambda text, share: None), list(fits)
    if len(fits) < 2:
        raise InputError("there have to be at least two fitted models to average; a discovery without rivals has one")
    if len({one.sha256 for one in fits}) > 1:
        raise InputError("these are fits of different campaigns; weights say how models predict one and the same")
    names = [name_rival(one.effects) for one in fits]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"{name} stands twice among the rivals; name every model once", option="effect")
    # One noise for all, measured on what the best of them leaves.
    best = min(fits, key=lambda one: one.chi2_reduced)
    fits = [fit_again(one, best.noise) for one in fits]
    scores = []
    for k, one in enumerate(fits):
        base, share = k / len(fits), 1.0 / len(fits)
        scores.append(score_fit(one, seed, lambda text, s, b=base, w=share, n=names[k]: report(f"{n}: {text}",
                                                                                              b + w * s)))
    return conclude(fits[0].campaign, fits[0].model, fits, scores, notes)


def _split(one: str | Sequence[str | type[AbstractEffect]]) -> tuple[str | type[AbstractEffect], ...]:
    """Effects of a rival."""
    if not isinstance(one, str):
        return tuple(one)
    parts = [part.strip() for part in one.split(",")]
    if parts == ["none"]:
        return ()
    if not all(parts) or "none" in parts:
        raise InputError(f"{one!r} names no model: give effects with commas between them, or `none` alone",
                         option="effect")
    return tuple(parts)


def fit_again(found: Fit, noise: dict[str, Noise] | Any) -> Fit:
    """The same model fitted under another noise, from where it was.

    Raises:
        ComputationError: The model cannot be integrated there.
    """
    records = stack_records(found.source, noise)
    same = found.problem.records.stack.condition_sd  # still, where nuisances were held
    records = dc.replace(records, stack=eqx.tree_at(lambda s: s.condition_sd, records.stack, same))
    problem = Problem(found.problem.space, records, found.problem.priors)
    old = found.bounded
    again = solve_bounded(problem, list(old.names), old.solution.u, old.solution.z, old.bounds)
    if again.solution.failed:
        raise ComputationError(f"{found.model_text} could not be fitted again under the common noise")
    held = not np.any(np.asarray(same) > 0)
    return summarise_fit(found.source, found.model, found.effects, problem, again, old.solution.u, noise,
                         found.settings, not held)


def score_fit(found: Fit, seed: int = 0, report: Progress = lambda text, share: None) -> Scores:
    """Left-out scores of a fit, from draws about it: a multivariate t that follows the posterior where need be."""
    target = pose_fit(found)
    report("drawing", 0.1)
    x, likelihoods, base = draw_about(target, seed)
    return score_conditions(target, x, likelihoods, base, seed=seed,
                            report=lambda text, share: report(text, 0.4 + 0.6 * share))


def draw_about(target: CampaignTarget, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Draws about a fit, likelihoods of all records at them, and logarithms of their importance weights.

    Shapes (draws, free), (draws, records) and (draws,); the weights are not normalised.
    """
    random = np.random.RandomState(np.random.SeedSequence([seed, 11]).generate_state(8))
    proposal, best = start_mixture(target), None
    for _ in range(ROUNDS):
        x = proposal.draw(DRAWS // COSTLY if target.costly else DRAWS, random)
        likelihoods = target.likelihoods(x)
        base = target.prior(x) + likelihoods.sum(axis=1) - proposal.log_density(x)
        base = np.where(np.isfinite(base), base, -np.inf)
        smooth, k = smooth_weights(base)
        if not np.any(np.isfinite(smooth)):
            break
        if best is None or k < best[0]:
            best = (k, x, likelihoods, base)
        if k <= min(0.5, limit_shape(len(x))):
            break
        proposal = Mixture([describe_draws(x, smooth, 2.0 * target.covariance)], target.low, target.high)
    if best is None:
        raise ComputationError("the model cannot be computed at draws from the fit's Gaussian: the fit is too "
                               "uncertain; add priors or bounds, or fix a parameter")
    return best[1:]


def stack_weights(elpd: np.ndarray) -> np.ndarray:
    """Weights of models.

    Args:
        elpd: logarithm of each model's predictive density of every left-out condition, shape (conditions, models).

    Returns:
        Shape (models,), not negative, with sum 1; of models that predict alike, even ones.
    """
    conditions, count = elpd.shape
    if count == 1:
        return np.ones(1)
    if not np.all(np.isfinite(elpd.max(axis=1))):
        raise ComputationError("a left-out condition has no density under any of the models: there are no weights")
    relative = np.exp(elpd - elpd.max(axis=1, keepdims=True))

    def loss(w):
        mixed = np.maximum(relative @ w, 1e-300)
        return -np.sum(np.log(mixed)) / conditions, -(relative / mixed[:, None]).sum(axis=0) / conditions

    w = np.full(count, 1.0 / count)
    # EM never leaves the simplex nor lowers the sum; the end of its way, which may be long, is left to SLSQP.
    for _ in range(200):
        w = w * np.mean(relative / np.maximum(relative @ w, 1e-300)[:, None], axis=0)
    with np.errstate(all="ignore"):
        found = optimize.minimize(loss, w, jac=True, method="SLSQP", bounds=[(0.0, 1.0)] * count,
                                  constraints={"type": "eq", "fun": lambda v: v.sum() - 1.0,
                                               "jac": lambda v: np.ones(count)}, options={"ftol": 1e-14})
    better = np.clip(found.x, 0.0, 1.0)
    if np.all(np.isfinite(better)) and better.sum() > 0 and loss(better / better.sum())[0] <= loss(w)[0]:
        w = better / better.sum()
    w = np.where(w < NOTHING, 0.0, w)
    return w / w.sum()


def compare_rivals(elpd: np.ndarray, weights: np.ndarray) -> list[tuple[float, float, Outcome]]:
    """Paired difference of every model's elpd from that of the best, its standard error, and the outcome.

    Args:
        elpd: shape (conditions, models).
        weights: of the models, by stacking, shape (models,).
    """
    best = int(np.argmax(elpd.sum(axis=0)))
    found: list[tuple[float, float, Outcome]] = []
    for k in range(elpd.shape[1]):
        difference, error = add_up(elpd[:, k] - elpd[:, best])
        outcome = "best" if k == best else judge_difference(difference, error, float(weights[best]))
        found.append((difference, error, outcome))
    return found


def judge_difference(difference: float, error: float, weight: float) -> Outcome:
    """What left-out conditions say of the best model against another.

    Args:
        difference: elpd of the other less that of the best; negative or 0.
        error: its standard error.
        weight: of the best, by stacking.

    Returns:
        `preferred`, where the best leads by more than `LEAST` and by more than `ERRORS` standard errors; else
        `favoured`, where stacking gives it (nearly) all the weight, and `indistinguishable`, where it does not.
    """
    if -difference > LEAST and -difference > ERRORS * error:
        return "preferred"
    return "favoured" if weight >= NEARLY_ALL else "indistinguishable"


def conclude(campaign: str, model: str, fits: Sequence[Fit], scores: Sequence[Scores], notes: Sequence[str] = ()
             ) -> ModelWeights:
    """Weights and what they mean, from the left-out scores of every rival."""
    elpd = np.stack([one.values for one in scores], axis=1)
    weights, best = stack_weights(elpd), int(np.argmax(elpd.sum(axis=0)))
    order = sorted(range(len(fits)), key=lambda k: (k != best, -float(elpd[:, k].sum())))
    compared = compare_rivals(elpd, weights)
    names = [name_rival(one.effects) for one in fits]
    rivals = tuple(Rival(names[k], _name_folder(names[k]), fits[k], scores[k], float(weights[k]), *compared[k])
                   for k in order)
    conditions = len(elpd)
    notes = list(notes)
    if conditions < FEW:
        notes.append(f"With {conditions} conditions the standard errors, and so the weights, are themselves rough.")
    doubtful = [one.name for one in rivals if not all(s.trusted for s in one.scores.scores)]
    if doubtful:
        notes.append(f"Not every score of {', '.join(doubtful)} can be trusted: single conditions decide what the "
                     "others leave open (see pareto_k in weights.json).")
    notes.append("Weights are those of a mixture for prediction, not probabilities of the models; none of the rivals "
                 "need be right.")
    return ModelWeights(campaign, fits[0].sha256, model, rivals, _say(rivals, conditions), tuple(notes))


def _say(rivals: Sequence[Rival], conditions: int) -> str:
    best, others = rivals[0], rivals[1:]
    if not others:
        return f"{best.name} has no rival, so that its weight is 1 and says nothing."
    shares = ", ".join(f"{one.name} {one.weight:.2f}" for one in sorted(rivals, key=lambda r: -r.weight))
    head = (f"Stacking over {conditions} left-out conditions of {best.fit.campaign} gives the weights {shares} "
            "(elpd: log predictive density of left-out conditions)")
    parts = []
    if found := [one for one in others if one.outcome == "preferred"]:
        parts.append(f"{best.name} is preferred to {_list_behind(found)}")
    if found := [one for one in others if one.outcome == "favoured"]:
        within = [one for one in found if -one.difference <= ERRORS * one.standard_error]
        small = [one for one in found if one not in within]
        if within:
            parts.append(f"the weights favour {best.name} over {_list_behind(within)}, but the difference is within "
                         f"{ERRORS:g} standard errors")
        if small:
            parts.append(f"the weights favour {best.name} over {_list_behind(small)}, but a difference of less than "
                         f"{LEAST:g} does not settle the choice")
    if found := [one for one in others if one.outcome == "indistinguishable"]:
        parts.append(f"{best.name} is not distinguishable from {_list_behind(found)}")
    return f"{head}; {'; '.join(parts)}."


def _list_behind(rivals: Sequence[Rival]) -> str:
    return ", ".join(f"{one.name} (elpd lower by {-one.difference:.1f} ± {one.standard_error:.1f})" for one in rivals)


def name_rival(effects: Sequence[str]) -> str:
    """Name of a model among its rivals."""
    return "+".join(effects) or "reference"


def _name_folder(name: str) -> str:
    return "".join(c if c.isalnum() or c in "+-_" else "-" for c in name)[:100]


def read_rivals(folder: Path, campaign: Campaign | str | Path | None) -> tuple[str, Rivals, list[str]]:
    """Rivals in a folder that `discover` wrote.

    Args:
        folder: with `result.json` and `model.json`.
        campaign: that is going to be fitted.

    Returns:
        Reference model, effects of every rival, notes.

    Raises:
        InputError: The file is damaged or of something else, or no rival is left.
    """
    path = folder / RESULT
    refuse_peaks(folder)
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        name, model, sha = str(content["campaign"]), str(content["model"]), str(content["sha256"])
        effects, step = [str(e) for e in content["effects"]], content["steps"][-1]
        alike = [str(e) for e in step["alternatives"]]
        added = step["added"]
        alike += [str(e) for c in content["candidates"] if c["effect"] == added and effects == [added]
                  for e in c["indistinguishable_from"]]
    except (OSError, ValueError, KeyError, TypeError, IndexError, AttributeError, RecursionError):
        raise InputError("this is no result of discover, or a damaged one; run discover again", file=path) from None
    if campaign is None:
        raise InputError(f"the result does not hold the campaign {name!r}; name its folder (--campaign)", file=path)
    measured = campaign if isinstance(campaign, Campaign) else read_campaign(campaign)
    notes = [] if measured.sha256 == sha else [
        f"The campaign is not the one, byte for byte, that discover looked at ({name})."]
    if not effects:
        raise InputError(f"discover added nothing to {model} here, so that there are no rivals to average; name the "
                         "campaign and the effects", file=path)
    saved = {e.id: e for e in load(folder).space.effects}
    found = [saved.get(e, e) for e in effects]
    rest = [e for e, own in zip(found, effects, strict=True) if own != added]
    others = [e for e in dict.fromkeys(alike) if e not in effects]
    if not others:
        raise InputError(f"discover found no rival of {', '.join(effects)}, so that there is nothing to average; "
                         "name the rivals yourself: `ddetumble average CAMPAIGN --effect ID --effect ID`", file=path)
    return model, [tuple(found), *((*rest, e) for e in others)], notes


class _Entry(pydantic.BaseModel):
    """One rival of `weights.json`, as far as it is read back."""

    name: str
    folder: str = pydantic.Field(pattern=r"^[^/\\]+$")
    weight: float = pydantic.Field(ge=0, le=1, allow_inf_nan=False)
    outcome: Outcome


class _Weights(pydantic.BaseModel):
    """Content of `weights.json`, as far as it is read back."""

    campaign: str
    sentence: str
    rivals: list[_Entry] = pydantic.Field(min_length=1)

    @pydantic.model_validator(mode="after")
    def _agree(self):
        if abs(sum(one.weight for one in self.rivals) - 1) > 1e-3:
            raise ValueError("rivals: the weights do not sum to 1")
        if any(one.folder in (".", "..") for one in self.rivals):
            raise ValueError("rivals: every rival has a folder below this one")
        return self


def read_weights(folder: Path) -> list[tuple[str, Path, float]]:
    """Name, folder and weight of every rival with a weight, from a folder that `average` wrote.

    Raises:
        InputError: The file is damaged, of another version, or a rival's folder is not there.
    """
    path = Path(folder) / FILE
    found = read_json(path, SCHEMA, _Weights, "average the models again")
    kept = [(one.name, path.parent / one.folder, one.weight) for one in found.rivals if one.weight > 0]
    for name, place, _ in kept:
        if not (place / "model.json").is_file():
            raise InputError(f"the fit of {name} is not there; average the models again", file=place)
    return kept
