"""The loop: compare, say where it fails, add the effect that helps, until nothing is missing or nothing helps."""

import dataclasses as dc
import time
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path as FilePath
from typing import Any

import numpy as np

from .._display import Progress
from .._errors import ComputationError, InputError
from .._sentences import join_sentences, say
from ..contact.effect import AbstractEffect, list_choices, parts_of
from ..families import find_family, name_family
from ..inference.archive import Model, resolve_model
from ..inference.models import ResolvedModel
from ..measurement.campaign import Campaign
from ..measurement.package import read_campaign
from ..measurement.plausibility import check_plausibility
from .cleaning import Cleaned, begin_cleaning, clean_records
from .describe import describe_candidates, describe_noise, describe_step, list_loose, make_fit
from .discovery import Discovery
from .forward_selection import (
    CandidateFits,
    FittedStep,
    Path,
    extend_path,
    is_explained,
    keep_physical,
    select_effects,
)
from .localise import fit_directions, locate
from .missing.missing_force import describe_missing, summarise_missing
from .problem import Fitted, SelectionProblem, fit_reference, pose_selection
from .result import MissingForce, Place
from .sentences import (
    describe_beyond,
    describe_imitation,
    explain,
    mention_doubts,
    mention_faults,
    mention_references,
)
from .series import noise_nrmse
from .settings import DEFAULT, SelectionSettings


def discover(campaign: Campaign | str | FilePath, model: Model = "paper", *,
             effects: Sequence[type[AbstractEffect]] = (), settings: SelectionSettings = DEFAULT,
             keep_all: bool = False, progress: Progress | None = None) -> Discovery:
    """Find out which physical effect a campaign shows and the model lacks.

    Args:
        campaign: a campaign with samples, or its folder.
        model: reference model, by name or in hand; one that has effects already is grown further.
        effects: effects of your own, tried beside the catalogue.
        settings: thresholds that decide; the result keeps them.
        keep_all: leave out no record and no sample: faults of the data are reported, and nothing is done about them.
        progress: called with a sentence and the share done.

    Returns:
        A `Discovery`: verdict, effects, parameters, where the misfit sits, what could not be told apart; its `best`
        model, its `rivals` and its `fits` step by step are what `fit` returns.

    Raises:
        InputError: the campaign cannot be used (wrong family, peaks only, nothing to fit).
        ComputationError: the reference model could not be integrated.
    """
    began = time.perf_counter()
    report = progress or (lambda text, share: None)
    if not isinstance(campaign, Campaign):
        campaign = read_campaign(campaign)
    catalogue = find_family(name_family(campaign), "discover").catalogue
    resolved = resolve_model(model, name_family(campaign))
    # One of the catalogue is tried anyway.
    effects = tuple(e for e in dict.fromkeys(effects) if e not in catalogue)
    state, path = _select_from_clean(resolved, campaign, effects, settings, keep_all, report)
    name, rivals = resolved.name, ()
    # A wrong unit that would explain what is odd about the campaign is asked about before any physics is named.
    questions = [str(one) for one in check_plausibility(state.campaign) if one.mistakes]
    if needs_rivals(path) and not questions:
        report("trying the other reference models", 0.88)
        rivals = try_references(resolved, state, effects, path.steps[0].fitted, settings)
        better = choose_reference(path, rivals)
        if better is None:
            path = extend_path(path, settings.most_effects, report)
        else:
            path, name = better.path, better.name
    selection = path.selection
    steps, beyond = keep_physical(path)
    doubts = (*questions, *([describe_beyond(path.steps[len(steps)].fitted.effects, beyond)] if beyond else ()))
    verdict, where, steps, beside = _decide(selection, steps, path.visible)
    if not selection.holds_out:
        verdict, steps = _decide_within(verdict, steps)
    if questions and steps[0].lack.rejected:
        verdict, steps = "undecided", steps[:1]
    missing = None
    if verdict in ("improved", "unexplained"):
        missing = _draw(selection, steps, path.tried, beside, report)
    report("writing it down", 0.97)
    discovery = _assemble(selection, name, steps, path.tried, verdict, where, missing, began)
    discovery = dc.replace(discovery, notes=(*state.notes, *discovery.notes))
    if not beyond and verdict in ("improved", "unexplained"):
        doubts += describe_imitation(discovery.candidates, settings.largest_part)
    discovery = mention_doubts(discovery, doubts, units=bool(questions))
    if rivals:
        discovery = mention_references(discovery, resolved.name, [r.to_dict() for r in rivals])
    return mention_faults(discovery, state.faults)


def _select_from_clean(resolved: ResolvedModel, campaign: Campaign, effects: Sequence[type[AbstractEffect]],
                       settings: SelectionSettings, keep_all: bool, report: Progress) -> tuple[Cleaned, Path]:
    """Forward selection on the campaign without its faults; what is found to be one begins it again."""
    state = begin_cleaning(campaign, keep_all, settings)

    def begin(campaign):
        return fit_reference(pose_selection(campaign, resolved.reference, effects, resolved.effects, state.zeros,
                                            settings))

    def search_again(campaign):
        report("looking behind a record", 0.87)
        path = select_effects(*begin(campaign))
        last = path.steps[-1]
        return (path.selection, last.fitted) if last.lack.smooth_p_value > settings.level_each else None

    for turn in range(settings.rounds):
        final = turn == settings.rounds - 1
        report("fitting the reference model", 0.02)
        selection, reference = begin(state.campaign)
        state, changed = clean_records(state, selection, reference, False)
        if changed and not final:
            continue
        path = select_effects(selection, reference, report)
        if not path.steps[0].lack.rejected or final:
            break
        report("looking for records at fault", 0.86)
        last = path.steps[-1]
        state, changed = clean_records(state, path.selection, last.fitted, True,
                                       search_again if last.lack.rejected else None)
        if not changed:
            break
    return state, path


def _draw(selection: SelectionProblem, steps: Sequence[FittedStep], tried: CandidateFits, beside: Fitted,
          report: Progress) -> MissingForce | str:
    """The missing force itself, or why there is none: no verdict depends on it."""
    if not selection.holds_out:
        return ("The missing force was not drawn: it is known by what it removes on conditions that are left out, and "
                "there are too few to leave one out.")
    best = tried.order[0]
    again = selection.repeat(tried.refined[best]) if best in tried.refined else tried.screened[best]
    try:
        return describe_missing(selection, steps[0].fitted, beside, (best, again.score),
                                lambda text, share: report(text, 0.86 + 0.1 * share))
    except (ComputationError, InputError) as error:
        return f"The missing force could not be drawn: {error}."


def _decide(selection: SelectionProblem, steps: Sequence[FittedStep], visible: bool
            ) -> tuple[str, list[Place], Sequence[FittedStep], Fitted]:
    """Verdict, where the misfit sits, the steps that stand, and the model beside which a force is missing."""
    limits, reference, final = selection.settings, steps[0], steps[-1]
    if not reference.lack.rejected:
        return ("nothing-missing" if visible else "undecided"), [], steps, reference.fitted
    if len(steps) == 1:
        directions = fit_directions(selection, reference.fitted, reference.scores)
        return "unexplained", locate(selection, reference.fitted, directions), steps, reference.fitted
    plain = not final.lack.rejected and len(final.fitted.effects) == 1
    if plain and reference.lack.smooth_p_value < limits.certain:
        return "explained", locate(selection, reference.fitted, {}), steps, final.fitted
    directions = fit_directions(selection, reference.fitted, reference.scores)
    best = min(directions.values(), key=lambda fitted: fitted.merit, default=None)
    if best is not None and best.merit < final.fitted.merit - limits.significant:
        # One force that no catalogue lists does better than the effects together: they only imitate it.
        where = locate(selection, reference.fitted, directions)
        gain, possible = (reference.fitted.merit - one.merit for one in (final.fitted, best))
        if gain < limits.imitation * possible:
            return "unexplained", where, steps[:1], reference.fitted
        return "improved", where, steps, reference.fitted
    if not final.lack.rejected:
        return "explained", locate(selection, reference.fitted, {}), steps, final.fitted
    where = locate(selection, final.fitted, fit_directions(selection, final.fitted, final.scores))
    return "improved", where, steps, final.fitted


def _decide_within(verdict: str, steps: Sequence[FittedStep]) -> tuple[str, Sequence[FittedStep]]:
    """Verdict where no condition can be left out: one effect that no other comes near, or nothing is decided.

    A fit prefers some effect always. Without a condition to confirm it, only an effect that removes all of the misfit
    by itself, and beats every other by 50 noise variances within the records, is named.
    """
    alone = verdict == "explained" and len(steps[-1].fitted.effects) == 1 and not steps[-1].alternatives
    if verdict in ("explained", "improved") and not alone:
        return "undecided", steps[:1]
    return verdict, steps


def _list_rivals(steps: Sequence[FittedStep]) -> list[Fitted]:
    """Fits that the last step could not tell from the best one."""
    last = steps[-1]
    return [] if last.tried is None else [last.tried.refined[e] for e, _, _ in last.alternatives]


def _assemble(selection: SelectionProblem, model: str, steps: Sequence[FittedStep], tried: CandidateFits, verdict: str,
              where: Sequence[Place], missing: MissingForce | str | None, began: float) -> Discovery:
    """Everything as plain records."""
    described = [describe_step(selection, s, steps[k - 1] if k else None) for k, s in enumerate(steps)]
    campaign = selection.campaign
    found = Discovery(
        campaign=campaign.name, title=campaign.title, family=campaign.family, sha256=campaign.sha256, model=model,
        verdict=verdict, effects=steps[-1].fitted.effects if len(steps) > 1 else (), steps=tuple(described),
        candidates=tuple(describe_candidates(selection, steps, tried)), where=tuple(where),
        noise_nrmse=noise_nrmse(described[0].traces), noise=describe_noise(selection), sentence="", notes=(),
        settings=selection.settings, counts={
            "records": selection.records.count, "samples": int(selection.records.lengths.sum()),
            "conditions": selection.conditions, "seconds": round(time.perf_counter() - began, 2)},
        missing=missing if isinstance(missing, MissingForce) else None,
        made=(tuple(partial(make_fit, selection, s.fitted, model, verdict) for s in steps),
              tuple(partial(make_fit, selection, one, model, verdict) for one in _list_rivals(steps))),
    )
    sentence, notes = explain(found, selection.left_out, selection.family)
    if isinstance(missing, MissingForce):
        sentence = join_sentences(sentence, summarise_missing(missing))
    elif missing:
        notes = (*notes, missing)
    exact = list_exact(campaign) if steps[0].lack.rejected else []
    if exact:
        notes = (*notes, say("verdict.exact_settings", names=exact))
    loose = list_loose(selection, steps[-1].fitted.solution)
    if loose:
        notes = (*notes, say("verdict.undetermined", names=list(loose)))
    return dc.replace(found, sentence=sentence, notes=(*selection.warnings, *notes))


def list_exact(campaign: Campaign) -> list[str]:
    """Names of settings that differ from record to record and state no uncertainty; what has no unit is no setting."""
    return [name for name, column in campaign.conditions.items()
            if column.uncertainty is None and column.unit not in ("", "1") and len(set(campaign.records[name])) > 1]


@dc.dataclass(frozen=True)
class Rival:
    """Another reference model: its name, what it is, and what forward selection found beside it."""

    name: str
    text: str
    path: Path

    def to_dict(self) -> dict[str, Any]:
        """How far it came, as `result.json` has it."""
        last = self.path.steps[-1]
        return {"model": self.name, "text": self.text, "effects": list(last.fitted.effects),
                "parameters": len(last.fitted.solution.names), "rejected": last.lack.rejected,
                "p_value": last.lack.p_value, "chi2": last.fitted.solution.chi2}


def needs_rivals(path: Path) -> bool:
    """Whether other reference models are worth a try: as many effects as may stand without explain nothing, or one
    beyond what physics allows."""
    if is_explained(path):
        return False
    many = len(path.steps[-1].fitted.effects) >= path.selection.settings.effects_before_rivals
    return many or bool(keep_physical(path)[1])


def try_references(resolved: ResolvedModel, state: Cleaned, effects: Sequence[type[AbstractEffect]], asked: Fitted,
                   settings: SelectionSettings) -> tuple[Rival, ...]:
    """Forward selection beside every other built-in reference model of the family that fits about as well by itself.

    Args:
        resolved: the reference model that was asked for; `asked` its fit.
        state: the campaign without its faults.
        effects: of the user.
        settings: thresholds.
    """
    fitted, own = [], asked.solution
    for name, built in find_family(name_family(state.campaign)).models.items():
        reference = built.make()
        if not built.rival or _identify(reference) == _identify(resolved.reference) or _identify(reference) in [
                _identify(selection.reference) for *_, selection, _ in fitted]:
            continue
        try:
            selection, alone = fit_reference(pose_selection(state.campaign, reference, effects, (), state.zeros,
                                                            settings))
        except (ComputationError, InputError):
            continue
        rows = float((np.asarray(selection.records.stack.weights) > 0).sum())
        other = alone.solution
        same = abs(other.chi2 - own.chi2) <= settings.same_reference * own.chi2 and len(other.names) == len(own.names)
        if not same and other.chi2 - rows <= settings.farthest_reference * max(own.chi2 - rows, 1.0):
            fitted.append((name, built.text, selection, alone))
    fitted.sort(key=lambda one: one[3].merit)
    rivals = []
    for name, text, selection, alone in fitted[:settings.rival_references]:
        try:
            rivals.append(Rival(name, text, select_effects(selection, alone)))
        except ComputationError:
            continue
    return tuple(rivals)


def _identify(reference: Any) -> tuple:
    """What makes two reference models one."""
    choices: Mapping[str, Any] = list_choices(reference)
    return tuple(type(part) for part in parts_of(reference)), tuple(choices.items())


def choose_reference(path: Path, rivals: Sequence[Rival]) -> Rival | None:
    """The rival that leaves no misfit with the fewest parameters, where the first model leaves one; else None.

    Where no condition can be left out, nothing confirms the effects beside another reference model: only one that needs
    none of them counts.
    """
    good = [r for r in rivals if is_explained(r.path) and (r.path.selection.holds_out or len(r.path.steps) == 1)]
    if is_explained(path) or not good:
        return None
    last = {r.name: r.path.steps[-1].fitted for r in good}
    return min(good, key=lambda r: (len(last[r.name].solution.names), last[r.name].merit))
