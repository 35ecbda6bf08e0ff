r"""Weights of rival models by stacking: the mixture that predicts left-out conditions best.

Every model is fitted under the same noise, and every condition left out once. With the predictive density
$p_k(y_g | y_{-g})$ of model k for the condition g that it has not seen, the weights maximise
$\sum_g \ln \sum_k w_k\, p_k(y_g | y_{-g})$ over $w_k \ge 0$, $\sum_k w_k = 1$ (Yao et al. 2018). They say how much each
model adds to a prediction, not how probable it is: of two that predict alike, any split is as good.
"""

import dataclasses as dc
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import equinox as eqx
import numpy as np
import pydantic
from scipy import optimize

from .._display import AbstractPrinted, Progress, align_table, stay_silent
from .._errors import ComputationError, InputError
from .._sentences import say
from .._settings import list_shipped
from ..contact.effect import AbstractEffect
from ..families import open_campaign
from ..inference.archive import FittedModel, Model, load
from ..inference.bounded import solve_bounded
from ..inference.estimation import fit
from ..inference.files import check_folder, list_fields, list_versions, make_plain, read_json, write_json
from ..inference.findings import AbstractRivals, Fit, summarise_fit
from ..inference.models import resolve_effect
from ..inference.noise import Noise
from ..inference.problem import Problem
from ..inference.stack import stack_records
from ..measurement.campaign import Campaign
from ..measurement.quantities import join_words
from .loo import COSTLY, Scores, add_up, limit_shape, score_conditions, smooth_weights
from .proposal import Mixture, describe_draws, seed_random, start_mixture
from .target import TOO_UNCERTAIN, CampaignTarget, pose_fit


FILE = "weights.json"
SCHEMA = "ddetumble.weights/2"
# Vehtari's advice on elpd_diff (loo, cross-validation FAQ): below 4 models predict alike whatever the standard error,
# which is itself too small there; above, the difference has to be large beside it.
LEAST = 4.0
ERRORS = 2.0  # standard errors that it has to exceed, too
NEARLY_ALL = 0.95  # weight from which on a mixture is the one model: the rest changes no prediction visibly
FEW = 8  # conditions below which a standard error from their scatter is itself a guess
NOTHING = 1e-4  # weights below are none: they come from the optimiser's tolerance
DRAWS = 480  # about each fit: for a sum of weights to a few per cent
ROUNDS = 3  # in which the draws follow the posterior, at most
GOOD = 0.5  # shape of the tail of the weights at which their variance is finite: no further round
OF_PARAMETERS = {"free", "fixed", "priors", "bounds", "start"}  # arguments of `fit` that name parameters
TOO_FEW = "averaging needs at least two models"
Outcome = Literal["best", "preferred", "favoured", "indistinguishable"]
Rivals = Sequence[str | Sequence[str | type[AbstractEffect]]]


@dc.dataclass(frozen=True, eq=False)
class Rival:
    """One model of a set."""

    name: str  # its effects joined by `+`, or `reference`
    folder: str  # that its fit goes into
    fit: Fit  # all rivals under the same noise
    scores: Scores  # left-out conditions
    weight: float  # by stacking
    trusted_weight: float  # over the conditions alone whose scores can be trusted of every rival; nan without such
    difference: float  # of its elpd from that of the best; negative or 0
    standard_error: float  # of the difference, from its scatter over conditions
    outcome: Outcome  # of the comparison with the best (`compare_rivals`)


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

    @property
    def misfit(self) -> bool:
        """Whether every rival leaves more than the noise explains.

        Elpd then differs by hundreds at single conditions, of which stacking counts no more than who is nearer.
        """
        return all(one.fit.goodness.misfit for one in self.rivals)

    def __str__(self) -> str:
        """The report."""
        rows = [("", "weight", "elpd", "elpd difference", "std. error", "largest k", "refits", "chi2/dof")]
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
            "sentence": self.sentence, "notes": self.notes, "misfit": self.misfit, "left_out": conditions,
            "rivals": [{
                "name": one.name, "folder": one.folder, "effects": one.fit.effects, "weight": one.weight,
                "trusted_weight": one.trusted_weight,
                "elpd": one.scores.elpd, "elpd_standard_error": one.scores.standard_error,
                "difference": one.difference, "standard_error": one.standard_error, "outcome": one.outcome,
                "chi2_reduced": one.fit.chi2_reduced, "text": one.scores.text,
                "left_out": [list_fields(s, "conditions", "records") for s in one.scores.scores],
            } for one in self.rivals],
            "versions": list_versions(),
        })  # fmt: skip

    def save(self, folder) -> Path:
        """Write every rival's fit into a folder below this one, then `weights.json`; returns the folder."""
        folder = check_folder(folder, "weights")
        # Weights of an earlier set must not stand beside the fits of this one.
        (folder / FILE).unlink(missing_ok=True)
        for one in self.rivals:
            place = folder / one.folder
            if place.is_symlink() or (place.exists() and not place.is_dir()):
                raise InputError("this is in the way; remove it, or name another folder", file=place)
            one.fit.save(place)
        write_json(folder / FILE, self.to_dict())
        return folder


def average(source: Campaign | str | Path | AbstractRivals | Sequence[Fit], models: Rivals = (), model: Model = "paper",
            *, campaign: Campaign | str | Path | None = None, progress: Progress | None = None, seed: int = 0,
            **fitting: Any) -> ModelWeights:
    r"""Compute the stacking weights $w_k$ of rival models from their predictive densities of left-out conditions.

    Args:
        source: fits of one campaign (`[found.best, *found.rivals]`); a discovery, or a folder that `discover` wrote,
            whose model and those that it could not tell from that are the rivals; or a campaign or its folder.
        models: the rivals, where the source is a campaign: of each the effects that extend the reference model, as a
            list, or as a text with commas; `none` for the reference model alone.
        model: reference model, as for `fit`.
        campaign: of which a folder of `discover` speaks.
        progress: called with a sentence and the share done.
        seed: of the random numbers.
        **fitting: further arguments of `fit`; what they say of a parameter of an effect is for the rivals that have it.

    Raises:
        InputError: The campaign cannot be fitted, two rivals are the same, there is but one, or an effect is unknown.
        ComputationError: A model cannot be computed.
    """
    report = progress or stay_silent
    notes: list[str] = []
    if isinstance(source, (AbstractRivals, Sequence)) and not isinstance(source, str):
        if models or fitting:
            raise InputError("fits in hand are averaged as they are; leave out the models and further arguments")
        fits = [source.best, *source.rivals] if isinstance(source, AbstractRivals) else list(source)
        return average_fits(fits, report, seed)
    if not isinstance(source, Campaign) and (Path(source) / "result.json").is_file():
        if models:
            raise InputError("the folder says which models are rivals; leave out the effects, or name the campaign "
                             "itself", file=source)
        held, _ = read_discovery(Path(source))
        best, model, rivals = held[0], held[0].model, [tuple(one.space.effects) for one in held]
        if len(held) == 1:
            raise InputError(f"discover found no rival of {', '.join(best.effects) or model}, so there is nothing to "
                             "average; name the rivals yourself: `ddetumble average CAMPAIGN --effect ID --effect ID`",
                             file=source)
        if campaign is None and best.campaign not in list_shipped():
            raise InputError(f"the result does not contain its campaign {best.campaign!r}; name the folder of that "
                             "campaign with --campaign", file=source)
        measured = open_campaign(campaign or best.campaign)
        if measured.sha256 != best.sha256:
            notes.append(f"The campaign is not byte for byte the one that discover analysed ({best.campaign}).")
    else:
        if campaign is not None:
            raise InputError("--campaign applies only to a folder that discover wrote")
        measured = open_campaign(source)
        rivals = [split_effects(one) if isinstance(one, str) else tuple(one) for one in models]
    if len(rivals) < 2:
        raise InputError(f"{TOO_FEW}; name the effects of each, `none` for the reference model alone")
    fits, ids = [], [[(resolve_effect(e) if isinstance(e, str) else e).id for e in effects] for effects in rivals]
    for k, effects in enumerate(rivals):
        name = name_rival(ids[k])
        report(f"fitting {name}", 0.4 * k / len(rivals))
        fits.append(fit(measured, model, effects, **_select_own(fitting, ids, k)))
    return average_fits(fits, lambda text, share: report(text, 0.4 + 0.6 * share), seed, notes)


def _select_own(fitting: Mapping[str, Any], rivals: Sequence[Sequence[str]], k: int) -> dict[str, Any]:
    """Arguments of `fit` for one of the rivals, given by the ids of their effects: what is said of parameters of an
    effect that it lacks, and another has, is for that one."""
    others = {effect for rival in rivals for effect in rival} - {*rivals[k]}
    own = dict(fitting)
    for option in OF_PARAMETERS & own.keys():
        if isinstance(own[option], Mapping):
            own[option] = {n: value for n, value in own[option].items() if n.partition(".")[0] not in others}
        elif own[option] is not None:
            own[option] = [n for n in own[option] if n.partition(".")[0] not in others]
    return own


def split_effects(text: str) -> tuple[str, ...]:
    """Effects of a rival from a text with commas; `none` has none."""
    parts = tuple(part.strip() for part in text.split(","))
    if parts == ("none",):
        return ()
    if not all(parts) or "none" in parts:
        raise InputError(f"{text!r} names no model: give effects separated by commas, or `none` alone", option="effect")
    return parts


def read_discovery(folder: Path) -> tuple[list[FittedModel], str]:
    """The model of a folder that `discover` wrote, those that it could not tell from that, and the verdict.

    Raises:
        InputError: The files are damaged, of something else, or not all there.
    """
    path = folder / "result.json"
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        verdict, expected = str(content["verdict"]), [str(e) for e in content["steps"][-1]["alternatives"]]
    except (OSError, ValueError, KeyError, TypeError, IndexError, RecursionError):
        raise InputError("this is not a result of discover, or is damaged; run discover again", file=path) from None
    best, *rivals = map(load, list_rivals(folder))
    if len(rivals) < len(expected):
        raise InputError(f"the rivals ({', '.join(expected)}) are not in this folder; run discover again", file=folder)
    for one in rivals:
        if one.sha256 != best.sha256 or type(one.space.reference) is not type(best.space.reference):
            raise InputError("the rivals were fitted to a different campaign from the model; run discover again",
                             file=one.folder)
    return [best, *rivals], verdict


def list_rivals(folder: Path) -> list[Path]:
    """The folder of a discovery's model, and those below it of the models that its last step could not tell from it."""
    return [folder, *list_numbered(folder, "rivals")]


def list_numbered(folder: Path, part: str) -> list[Path]:
    """Folders of the models that a part of a folder holds, by their numbers."""
    found = (file.parent for file in folder.glob(f"{part}/*/model.json"))
    return sorted(found, key=lambda place: (len(place.name), place.name))


def average_fits(fits: Sequence[Fit], report: Progress, seed: int = 0, notes: Sequence[str] = ()) -> ModelWeights:
    """As `average`, for models that are fitted already, to one campaign.

    Raises:
        InputError: There are fewer than two, two are the same, or they are of different campaigns.
        ComputationError: A model cannot be computed.
    """
    if len(fits) < 2:
        raise InputError(f"{TOO_FEW}; a discovery without rivals has only one")
    if len({one.sha256 for one in fits}) > 1:
        raise InputError("these are fits to different campaigns; weights compare predictions of the same one")
    names = [name_rival(one.effects) for one in fits]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"{name} occurs twice among the rivals; name every model once", option="effect")
    # One noise for all, measured on what the best of them leaves.
    noise = min(fits, key=lambda one: one.chi2_reduced).noise
    fits, scores = [fit_again(one, noise) for one in fits], []
    for k, one in enumerate(fits):
        def tell(text: str, share: float, k: int = k) -> None:
            report(f"{names[k]}: {text}", (k + share) / len(fits))

        target = pose_fit(one)
        tell("drawing", 0.1)
        x, likelihoods, base = draw_about(target, seed)
        scores.append(score_conditions(target, x, likelihoods, base, seed=seed,
                                       report=lambda text, share, tell=tell: tell(text, 0.4 + 0.6 * share)))
    elpd = np.stack([one.values for one in scores], axis=1)
    weights, totals = stack_weights(elpd), elpd.sum(axis=0)
    kept = np.all([[s.trusted for s in one.scores] for one in scores], axis=0)
    trusted = stack_weights(elpd[kept]) if kept.any() else np.full(len(fits), np.nan)
    compared = compare_rivals(elpd, weights)
    rivals = []
    for k in np.argsort(-totals, kind="stable"):
        folder = "".join(c if c.isalnum() or c in "+-_" else "-" for c in names[k])[:100]
        rivals.append(Rival(names[k], folder, fits[k], scores[k], float(weights[k]), float(trusted[k]), *compared[k]))
    notes = list(notes)
    if len(elpd) < FEW:
        notes.append(f"With only {len(elpd)} conditions the standard errors, and hence the weights, are themselves "
                     "rough.")
    if doubtful := [one.name for one in rivals if not all(s.trusted for s in one.scores.scores)]:
        note = (f"{np.sum(~kept)} of {len(kept)} conditions have unreliable scores under {join_words(doubtful)}, "
                "because they determine what the others do not (see pareto_k in weights.json)")
        told = join_words([f"{one.name} {one.trusted_weight:.2f}" for one in rivals])
        notes.append(f"{note}; without these conditions the weights are {told}." if kept.any() else f"{note}.")
    notes.append("The weights are those of a mixture for prediction, not probabilities of the models; none of the "
                 "rivals need be right.")
    found = ModelWeights(fits[0].campaign, fits[0].sha256, fits[0].model, tuple(rivals), "", tuple(notes))
    return dc.replace(found, sentence=_say(found, len(elpd)))


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
        raise ComputationError(f"{found.model_text} could not be refitted with the common noise")
    return summarise_fit(found.source, found.model, found.effects, problem, again, old.solution.u, noise,
                         found.settings, bool(np.any(np.asarray(same) > 0)))


def draw_about(target: CampaignTarget, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Draws about a fit from a multivariate t, which follows the posterior where need be, shape (draws, free),
    likelihoods of all records at them, shape (draws, records), and logarithms of their importance weights, not
    normalised, shape (draws,).
    """
    random = seed_random(seed, 11)
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
        if k <= min(GOOD, limit_shape(len(x))):
            break
        proposal = Mixture([describe_draws(x, smooth, 2.0 * target.covariance)], target.low, target.high)
    if best is None:
        raise ComputationError(TOO_UNCERTAIN)
    return best[1:]


def stack_weights(elpd: np.ndarray) -> np.ndarray:
    """Weights of models, shape (models,), not negative, with sum 1, of models that predict alike even ones, from the
    logarithm of each one's predictive density of every left-out condition, shape (conditions, models).
    """
    count = elpd.shape[1]
    if not np.all(np.isfinite(elpd.max(axis=1))):
        raise ComputationError("a left-out condition has zero density under every model, so there are no weights")
    relative = np.exp(elpd - elpd.max(axis=1, keepdims=True))

    def loss(w):
        mixed = np.maximum(relative @ w, 1e-300)
        return -np.mean(np.log(mixed)), -np.mean(relative / mixed[:, None], axis=0)

    with np.errstate(all="ignore"):
        found = optimize.minimize(
            loss, np.full(count, 1.0 / count), jac=True, method="SLSQP", bounds=[(0.0, 1.0)] * count,
            constraints={"type": "eq", "fun": lambda w: w.sum() - 1.0}, options={"ftol": 1e-14})
    w = np.where(found.x < NOTHING, 0.0, found.x)
    return w / w.sum()


def compare_rivals(elpd: np.ndarray, weights: np.ndarray) -> list[tuple[float, float, Outcome]]:
    """Paired difference of every model's elpd from that of the best, its standard error, and the outcome.

    The best is `preferred` where it leads by more than `LEAST` and by more than `ERRORS` standard errors; else
    `favoured`, where stacking gives it (nearly) all the weight, and `indistinguishable`, where it does not. Shapes
    (conditions, models) and (models,).
    """
    best = int(np.argmax(elpd.sum(axis=0)))
    found: list[tuple[float, float, Outcome]] = []
    for k in range(elpd.shape[1]):
        difference, error = add_up(elpd[:, k] - elpd[:, best])
        preferred = -difference > max(LEAST, ERRORS * error)
        outcome = "preferred" if preferred else "favoured" if weights[best] >= NEARLY_ALL else "indistinguishable"
        found.append((difference, error, "best" if k == best else outcome))
    return found


def _say(found: ModelWeights, conditions: int) -> str:
    groups = {"preferred": [], "within": [], "near": [], "alike": []}
    for one in found.rivals[1:]:
        nearby = "within" if -one.difference <= ERRORS * one.standard_error else "near"
        groups[{"preferred": "preferred", "favoured": nearby}.get(one.outcome, "alike")].append(one)
    return str(say("posterior.weights", rivals=found.rivals, misfit=found.misfit, conditions=conditions, errors=ERRORS,
                   least=LEAST, **groups))


def name_rival(effects: Sequence[str]) -> str:
    """Name of a model among its rivals."""
    return "+".join(effects) or "reference"


class _Entry(pydantic.BaseModel):
    """One rival of `weights.json`, as far as it is read back."""

    name: str
    folder: str = pydantic.Field(pattern=r"^[\w+-]+$")
    weight: float = pydantic.Field(ge=0, le=1, allow_inf_nan=False)


class _Weights(pydantic.BaseModel):
    """Content of `weights.json`, as far as it is read back."""

    rivals: list[_Entry] = pydantic.Field(min_length=1)

    @pydantic.field_validator("rivals")
    @classmethod
    def _agree(cls, rivals):
        if abs(sum(one.weight for one in rivals) - 1) > 1e-3:  # they are written to more digits
            raise ValueError("the weights do not sum to 1")
        return rivals


def read_weights(folder: Path) -> list[tuple[str, Path, float]]:
    """Name, folder and weight of every rival with a weight, from a folder that `average` wrote.

    Raises:
        InputError: The file is damaged, of another version, or a rival's folder is not there.
    """
    found = read_json(Path(folder) / FILE, SCHEMA, _Weights, "average the models again")
    kept = [(one.name, Path(folder) / one.folder, one.weight) for one in found.rivals if one.weight > 0]
    for name, place, _ in kept:
        if not (place / "model.json").is_file():
            raise InputError(f"the fit of {name} is not there; average the models again", file=place)
    return kept
