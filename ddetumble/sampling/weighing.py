"""Weigh rival models of one campaign: fit each under the same noise, leave conditions out, stack."""

import dataclasses as dc
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import equinox as eqx
import numpy as np
import pydantic

from .._errors import ComputationError, InputError
from ..contact.effect import AbstractEffect
from ..inference.archive import load_model
from ..inference.bounded import solve_bounded
from ..inference.estimation import fit
from ..inference.files import refuse_peaks
from ..inference.findings import Fit, summarise_fit
from ..inference.noise import Noise
from ..inference.problem import Problem
from ..inference.stack import stack_records
from ..measurement.campaign import Campaign
from ..measurement.package import read_campaign
from .moves import Proposal, start_proposal
from .scores import Scores, describe_draws, limit_shape, score_conditions, smooth_weights, spare_draws
from .target import CampaignTarget, pose_fit
from .weights import FILE, SCHEMA, Weighing, conclude, name_rival


RESULT = "result.json"
DRAWS = 480  # about each fit
ROUNDS = 3  # in which the draws follow the posterior, at most
Progress = Callable[[str, float], None]
Rivals = Sequence[str | Sequence[str | type[AbstractEffect]]]


def weigh(source: Campaign | str | Path, models: Rivals = (), model: str = "paper", *,
          campaign: Campaign | str | Path | None = None, progress: Progress | None = None, seed: int = 0,
          **fitting: Any) -> Weighing:
    """Weigh rival models by how well they predict conditions that they have not seen.

    Args:
        source: a campaign or its folder; or a folder that `discover` wrote, whose model and those that its last step
            could not tell from it are the rivals.
        models: the rivals: of each the effects that extend the reference model, as a list, or as a text with commas;
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
    if not isinstance(source, Campaign) and (Path(source) / RESULT).is_file():
        if models:
            raise InputError("the folder says which models are rivals; leave out the effects, or name the campaign "
                             "itself", file=source)
        model, models, notes = read_rivals(Path(source), campaign)
        source = campaign if campaign is not None else source
    measured = source if isinstance(source, Campaign) else read_campaign(source)
    rivals = [_split(one) for one in models]
    if len(rivals) < 2:
        raise InputError("there have to be at least two models to weigh; name the effects of each, `none` for the "
                         "reference model alone")
    fits: list[Fit] = []
    for k, effects in enumerate(rivals):
        report(f"fitting {name_rival([e if isinstance(e, str) else e.id for e in effects])}", 0.4 * k / len(rivals))
        fits.append(fit(measured, model, effects, **fitting))
    names = [name_rival(one.effects) for one in fits]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"{name} stands twice among the rivals; name every model once", option="effect")
    # One noise for all, measured on what the best of them leaves.
    best = min(fits, key=lambda one: one.chi2_reduced)
    fits = [fit_again(one, best.noise) for one in fits]
    scores = []
    for k, one in enumerate(fits):
        base, share = 0.4 + 0.6 * k / len(fits), 0.6 / len(fits)
        scores.append(score_fit(one, seed, lambda text, s, b=base, w=share, n=names[k]: report(f"{n}: {text}",
                                                                                              b + w * s)))
    return conclude(measured.name, model, fits, scores, notes)


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
    proposal, best = start_proposal(target), None
    for _ in range(ROUNDS):
        x = proposal.draw(spare_draws(target, DRAWS), random)
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
        proposal = Proposal(*describe_draws(x, smooth, 2.0 * target.covariance), target.low, target.high)
    if best is None:
        raise ComputationError("the model cannot be computed at draws from the fit's Gaussian: the fit is too "
                               "uncertain; add priors or bounds, or fix a parameter")
    return best[1:]


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
        raise InputError(f"discover added nothing to {model} here, so that there are no rivals to weigh; name the "
                         "campaign and the effects", file=path)
    saved = {e.id: e for e in load_model(folder).space.effects}
    found = [saved.get(e, e) for e in effects]
    rest = [e for e, own in zip(found, effects, strict=True) if own != added]
    others = [e for e in dict.fromkeys(alike) if e not in effects]
    if not others:
        raise InputError(f"discover found no rival of {', '.join(effects)}, so that there is nothing to weigh; "
                         "name the rivals yourself: `ddetumble weigh CAMPAIGN --effect ID --effect ID`", file=path)
    return model, [tuple(found), *((*rest, e) for e in others)], notes


class _Entry(pydantic.BaseModel):
    """One rival of `weights.json`, as far as it is read back."""

    name: str
    folder: str = pydantic.Field(pattern=r"^[^/\\]+$")
    weight: float = pydantic.Field(ge=0, le=1, allow_inf_nan=False)
    told_apart: bool


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
    """Name, folder and weight of every rival with a weight, from a folder that `weigh` wrote.

    Raises:
        InputError: The file is damaged, of another version, or a rival's folder is not there.
    """
    path = Path(folder) / FILE
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"the file cannot be read ({error.strerror or error})", file=path) from None
    except (ValueError, RecursionError):
        raise InputError("this is no JSON file, or only a part of one; weigh the models again", file=path) from None
    schema = content.get("schema") if isinstance(content, dict) else None
    if schema != SCHEMA:
        raise InputError(f"the schema is {schema!r}; this version reads {SCHEMA!r}: weigh the models again", file=path,
                         key="schema")
    try:
        found = _Weights.model_validate(content)
    except pydantic.ValidationError as error:
        first = error.errors()[0]
        reason = first["msg"].removeprefix("Value error, ")
        raise InputError(f"the file is damaged: {reason[:1].lower()}{reason[1:]}; weigh the models again", file=path,
                         key=".".join(str(part) for part in first["loc"]) or None) from None
    kept = [(one.name, path.parent / one.folder, one.weight) for one in found.rivals if one.weight > 0]
    for name, place, _ in kept:
        if not (place / "model.json").is_file():
            raise InputError(f"the fit of {name} is not there; weigh the models again", file=place)
    return kept
