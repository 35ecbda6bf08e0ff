"""The loop: compare, say where it fails, add the effect that helps, until nothing is missing or nothing helps."""

import contextlib
import dataclasses as dc
import math
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path as FilePath
from typing import Any, NamedTuple

import numpy as np

from .._display import Progress, nest_progress, stay_silent
from .._errors import ComputationError, InputError
from .._sentences import say
from .._settings import forget_programs
from ..contact.effect import AbstractEffect, identify_model, require_effect
from ..families import find_family, name_family, open_campaign
from ..inference.archive import Model, resolve_model
from ..inference.interval_width import widen_intervals
from ..inference.models import ResolvedModel
from ..inference.noise import Noise
from ..inference.systematics import measure_systematics, tell_systematics
from ..measurement.campaign import Campaign, count_conditions
from ..measurement.plausibility import check_plausibility
from ..measurement.quantities import describe_quantity
from ..measurement.units import Uncertainty
from .bias import SettingBias, find_bias, join_alike, matches_effects, stand_in
from .describe import describe_candidates, describe_noise, describe_spread, describe_step, list_loose, make_fit
from .discovery import Discovery
from .effort import Effort, limit_effort, may_search
from .explanations import list_added, list_explanations, settle_rivals
from .forward_selection import (
    FittedStep,
    Path,
    Unphysical,
    allow_scatter,
    allow_wander,
    extend_path,
    is_outdone,
    select_effects,
)
from .localise import fit_directions, locate
from .missing.missing_force import describe_missing
from .outliers import Cleaned, begin_cleaning, clean_records
from .problem import Fitted, SelectionProblem, Zeros, fit_reference, pose_selection
from .restatements import find_restatement
from .result import OPEN, MissingForce, Place, Rounding
from .rounding import find_rounding
from .series import make_traces, measure_ratio, nrmse
from .settings import DEFAULT, SelectionSettings
from .verdict_facts import doubt_ambient, list_doubts, list_notes, name_reason, tell_discovery


def discover(campaign: Campaign | str | FilePath, model: Model = "paper", *,
             effects: Sequence[type[AbstractEffect]] = (), settings: SelectionSettings = DEFAULT,
             keep_all: bool = False, progress: Progress | None = None) -> Discovery:
    """Find out which physical effect a campaign shows and the model lacks.

    Args:
        campaign: measured, or its folder.
        model: reference model, by name or in hand; one that has effects already is grown further.
        effects: effects of your own, tried beside the catalogue.
        settings: thresholds that decide; the result keeps them.
        keep_all: leave out no record and no sample: faults of the data are reported, and nothing is done about them.
        progress: called with a sentence and the share done.

    Returns:
        A `Discovery`: verdict, effects, parameters, where the misfit sits, what could not be told apart; its `best`
        model, its `rivals` and its `fits` step by step are what `fit` returns.

    Raises:
        InputError: the campaign cannot be used (wrong family, nothing to fit).
        ComputationError: the reference model could not be integrated.
    """
    began = time.perf_counter()
    report = progress or stay_silent
    for effect in effects:
        require_effect(effect, instances=False)
    campaign = open_campaign(campaign)
    kind = find_family(name_family(campaign), "discover")
    asked = resolve_model(model, name_family(campaign))
    forget_programs()
    # One of the catalogue is tried anyway.
    effects = tuple(e for e in dict.fromkeys(effects) if e not in kind.catalogue)

    def begin(campaign: Campaign, zeros: Zeros, reference=asked.reference, given=asked.effects):
        return fit_reference(pose_selection(campaign, reference, effects, given, zeros, settings))

    with limit_effort(settings.effort) as effort:
        search = _search(asked, begin, begin_cleaning(campaign, keep_all, settings), settings, report)
        end = _doubt_record(_conclude(search.path, bool(search.questions), report), search.state,
                            any(noise.slow_sd for noise in search.path.selection.noise.values()))
    end = _leave_open(end, effort)
    reached = _reach_others(search, end, begin, settings, report)
    return _write_down(search, end, reached, effort, began, report)


# Fits the reference model to a campaign with such moving zeros: the problem, and the fit.
Begin = Callable[..., tuple[SelectionProblem, Fitted]]


@dc.dataclass(frozen=True)
class Search:
    """What forward selection came to, beside which reference model, and what it was asked and told."""

    asked: ResolvedModel
    state: Cleaned
    path: Path
    name: str  # of the reference model beside which the path was found
    others: Mapping[str, Path]  # beside other reference models, by their names
    questions: tuple[str, ...]  # about settings or units that may be stated wrongly, before any physics is named
    shared: SettingBias | None  # the error of a setting that all records share, where it is allowed for
    instead: Path | None  # the search without that error, where what it finds in its place does as well


def _search(asked: ResolvedModel, begin: Begin, state: Cleaned, settings: SelectionSettings, report: Progress
            ) -> Search:
    """Forward selection on what is clean, with all that may stand in the place of physics; then, where that explains
    nothing, beside other reference models."""
    state, path = _select_from_clean(begin, state, settings, report)
    name, others = asked.name, {}
    path, shared, instead = _allow_bias(allow_scatter(path, report), begin, state, report)
    path = allow_wander(path, report)
    # A wrong unit that would explain what is odd about the campaign is asked about before any physics is named.
    questions = tuple(str(one) for one in check_plausibility(state.campaign) if one.mistakes)
    if not questions:
        report("asking whether what holds for all records is stated rightly", 0.877)
        restated = find_restatement(state.campaign, path, lambda campaign: begin(campaign, state.zeros),
                                    shared is not None, settings, report)
        if restated is not None:
            one, beside = restated
            questions = (say(f"verdict.{one.macro}", **one.facts, effects=list(beside), model=repr(asked.name)),)
    # As many effects as may stand without other reference models explain nothing, or one beyond what physics allows.
    open_ended = len(path.steps[-1].fitted.effects) >= settings.effects_before_rivals or path.keep_physical()[1]
    if open_ended and not path.is_explained() and not questions:
        report("trying the other reference models", 0.88)
        fits = _fit_references(asked, begin, state, path.steps[0].fitted, settings, report)
        others = _search_beside(fits, settings, report)
        other = _choose_reference(path, others)
        if other is None:
            path = extend_path(path, settings.most_effects, report)
        else:
            name, path = other, others[other]
    return Search(asked, state, path, name, others, questions, shared, instead)


def _choose_reference(path: Path, others: Mapping[str, Path]) -> str | None:
    """Name of another reference model that explains the campaign in place of the one whose search is `path`.

    Where no condition can be left out, nothing confirms the effects beside another reference model: only one that needs
    none of them counts. Of several the one with the fewest parameters. Where effects beyond physics leave no misfit, as
    a wrong range does, another model with more parameters than theirs only imitates them.
    """
    last = path.steps[-1]
    fewest = np.inf if last.lack.rejected else len(last.fitted.solution.names)
    good = {name: other.steps[-1].fitted for name, other in others.items()
            if other.is_explained() and (other.selection.holds_out or len(other.steps) == 1)
            and len(other.steps[-1].fitted.solution.names) <= fewest}
    return min(good, key=lambda name: (len(good[name].solution.names), good[name].merit), default=None)


# How far another reference model came, by its name: its problem, and its last step.
Reached = Mapping[str, tuple[SelectionProblem, FittedStep]]


def _reach_others(search: Search, end: "Conclusion", begin: Begin, settings: SelectionSettings, report: Progress
                  ) -> Reached:
    """Other reference models as they were searched beside; else, of a misfit that is far from explained, each fitted by
    itself."""
    selection, steps = search.path.selection, end.steps
    if end.verdict in OPEN and not search.others and selection.reduce_chi2(steps[-1].fitted.solution) > settings.far:
        report("fitting the other reference models by themselves", 0.96)
        fits = _fit_references(search.asked, begin, search.state, search.path.steps[0].fitted, settings, report)
        return {name: (one, FittedStep(alone, *one.test_lack_of_fit(alone))) for name, one, alone in fits}
    return {name: (other.selection, other.steps[-1]) for name, other in search.others.items()}


def _write_down(search: Search, end: "Conclusion", reached: Reached, effort: Effort, began: float, report: Progress
                ) -> Discovery:
    """The result: every step described, what could not be told apart, and all of it in sentences."""
    report("writing it down", 0.97)
    path, state, name, questions, shared = search.path, search.state, search.name, search.questions, search.shared
    selection, settings, verdict = path.selection, path.selection.settings, end.verdict
    steps, rivals = settle_rivals(selection, end.steps)
    described = []
    for k, one in enumerate(steps):
        report(f"writing it down: model {k + 1} of {len(steps)}", 0.97)
        described.append(describe_step(selection, one, steps[k - 1] if k else None))
    report("writing it down: the ranking", 0.97)
    candidates = describe_candidates(selection, end.dropped or steps, path.tried)
    last, campaign, rejected = steps[-1], selection.campaign, steps[0].lack.rejected
    doubts = list_doubts(verdict, candidates, questions, end.unphysical, settings) if rejected else ()
    made = (tuple(partial(make_fit, selection, step.fitted, name, verdict) for step in steps),
            tuple(partial(make_fit, selection, rival, name, verdict) for rival in rivals))
    unsure = (questions or end.irregular or end.unrepeated or end.stopped or end.rounding is not None
              or any(fault.kind == "doubtful" for fault in state.faults))
    sufficient = [] if unsure else [c.effect for c in candidates if c.explains > settings.largest_part]
    dropped, unproven = list_added(end.dropped) if end.dropped else (), (path, end.dropped or steps, end.biases)
    if search.instead is not None and shared is not None and verdict == "explained" and name == search.asked.name:
        dropped = tuple(one for one in list_added(search.instead.steps) if one[0] in shared.effects)
        unproven = search.instead, search.instead.steps, [
            dc.replace(one, effects=shared.effects) for one in (shared, *shared.alike)]
    explanations, makers = list_explanations(*unproven, sufficient, name, verdict)
    models = find_family(name_family(campaign)).models
    found = Discovery(
        campaign=campaign.name, title=campaign.title, family=campaign.family, sha256=campaign.sha256, model=name,
        verdict=verdict, effects=last.fitted.effects, steps=tuple(described), candidates=tuple(candidates),
        where=tuple(end.where), noise_nrmse=nrmse(described[0].traces, noise=True), noise=describe_noise(selection),
        sentence="", settings=settings, counts={
            "records": selection.records.count, "samples": int(selection.records.lengths.sum()),
            "conditions": count_conditions(campaign.records), "rounds": effort.done,
            "seconds": round(time.perf_counter() - began, 2)},
        faults=state.faults, doubts=doubts, references=tuple(
            _describe_reference(n, models[n].text, *one, selection.noise) for n, one in reached.items()),
        spread=describe_spread(selection), irregular=end.irregular, unrepeated=end.unrepeated,
        unsearched=effort.left_out if end.stopped else (), biases=tuple(end.biases), shared_error=shared,
        rounding=end.rounding, dropped=dropped, explanations=explanations,
        missing=end.missing if isinstance(end.missing, MissingForce) and not end.irregular else None,
        made=(*made, makers))
    found = dc.replace(found, reason=name_reason(found, bool(questions)))
    return _put_into_words(found, search, end, effort, last.fitted)


def _put_into_words(found: Discovery, search: Search, end: "Conclusion", effort: Effort, last: Fitted) -> Discovery:
    """The same with its sentence, and with notes on data, settings and intervals."""
    state, selection, asked = search.state, search.path.selection, search.asked.name
    campaign, family, left_out, at = selection.campaign, selection.family, selection.left_out, last.solution
    rejected = found.steps[0].lack_of_fit.rejected
    notes = list_notes(found, family, left_out, asked, end.missing if isinstance(end.missing, str) else "",
                       list_exact(campaign) if rejected else [], list_loose(selection, at))
    if effort.left_out and not end.stopped:
        notes.append(say("verdict.unsearched", rounds=effort.done, searches=list(effort.left_out)))
    scatter = selection.settings.scatter
    if told := widen_intervals(selection.problem, at, selection.noise, bool(selection.spread), scatter).tell():
        notes.append(told)
    columns = {**campaign.conditions, **campaign.channels}.values()
    ambient = doubt_ambient(found, campaign.known.get("ambient_pressure"), any(one.gauge for one in columns),
                            selection.settings.standard_errors)
    notes += [ambient] if ambient is not None else []
    if found.verdict not in OPEN and search.shared is None:
        hidden = tell_systematics(measure_systematics(selection.problem, at, at.covariance(), campaign))
        notes += [hidden] if hidden else []
    return dc.replace(found, sentence=tell_discovery(found, family, left_out, bool(search.questions), asked),
                      notes=(*map(str, state.faults), *state.notes, *selection.warnings, *notes))


def _select_from_clean(begin: Begin, state: Cleaned, settings: SelectionSettings, report: Progress
                       ) -> tuple[Cleaned, Path]:
    """Forward selection on the campaign without its faults; what is found to be one begins it again."""
    def search_again(campaign):
        if not may_search("a search without the record that stands out"):
            return None
        report("looking behind a record", 0.87)
        inner = nest_progress(report, "looking behind a record", 0.87, 0.87)
        path = allow_wander(allow_scatter(select_effects(*begin(campaign, state.zeros), inner), inner), inner)
        last = path.steps[-1]
        return (path.selection, last.fitted) if last.lack.smooth_p_value > settings.level_each else None

    for turn in range(settings.rounds):
        final = turn == settings.rounds - 1
        report("fitting the reference model", 0.02)
        selection, reference = begin(state.campaign, state.zeros)
        state, changed = clean_records(state, selection, reference)
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


class Allowed(NamedTuple):
    """A search with an error of one setting that all records share."""

    path: Path  # the search, with the error where there is one
    error: SettingBias | None
    instead: Path | None = None  # the search without the error, where what it finds in its place does as well


def _allow_bias(path: Path, begin: Begin, state: Cleaned, report: Progress) -> Allowed:
    """The same search with an error of one setting that all records share, where that leaves no misfit.

    It is looked for where effects leave a misfit, beside each model on the way, and where effects after the first one
    do no better than it: no physics is named where such an error does as well. It then counts as one that the campaign
    states, so that effects and errors are fitted together.
    """
    selection, last, settings = path.selection, path.steps[-1], path.selection.settings
    if not selection.holds_out:
        return Allowed(path, None)
    if last.lack.rejected:
        seen = next(filter(None, (find_bias(selection, step.fitted) for step in path.steps)), None)
    else:
        later = stand_in(selection, [step.fitted for step in path.steps[1:]]) if len(path.steps) > 2 else ([], [])
        ones = sorted((one for ones in later for one in ones if matches_effects(
            [one], last.fitted.merit, selection.find_effects(one.effects))), key=lambda one: one.merit)
        seen = join_alike(ones[0], ones, settings) if ones else None
    if seen is None or not may_search("a search with an error of one setting that all records share"):
        return Allowed(path, None)
    report("allowing for a setting that is wrong alike in all records", 0.872)
    column = dc.replace(state.campaign.conditions[seen.name], common=Uncertainty(relative=settings.bias))
    campaign = dc.replace(state.campaign, conditions={**state.campaign.conditions, seen.name: column})
    inner = nest_progress(report, f"with the {describe_quantity(seen.name).name} wrong alike", 0.872, 0.872)
    found = allow_scatter(select_effects(*begin(campaign, state.zeros), inner), inner)
    before, last = last, found.steps[-1]
    # An error that effects were dropped for must bring no others in, and leave those beside it.
    kept = {e for e in before.fitted.effects if e not in seen.effects}
    if last.lack.rejected or (not before.lack.rejected and (
            len(found.steps) >= len(path.steps) or not kept <= {*last.fitted.effects})):
        return Allowed(path, None)
    solution, name = last.fitted.solution, f"{seen.name}_shift"
    place = solution.names.index(name)
    error = dc.replace(
        seen, bias=-float(solution.u[found.selection.space.index[name]]), merit=last.fitted.merit,
        sd=float(np.sqrt(max(solution.covariance()[place, place], 0.0))),
        # Effects that left a misfit were not compared with it.
        effects=() if before.lack.rejected else tuple(e for e in before.fitted.effects if e not in last.fitted.effects))
    if not error.is_beyond(settings.standard_errors):
        return Allowed(found, None)  # allowed for, and none that anybody should be told of
    tied = not before.lack.rejected and not settings.is_beaten(-seen.difference, seen.standard_error)
    return Allowed(found, error, path if tied else None)


def _draw_force(path: Path, reference: Fitted, beside: Fitted, report: Progress) -> MissingForce | str:
    """The missing force itself, or why there is none: no verdict depends on it."""
    selection, tried = path.selection, path.tried
    if selection.records.are_values:
        return ("The missing force was not drawn: single values do not show how it changes during a test. Measure the "
                "force over time.")
    if not selection.holds_out:
        return ("The missing force was not drawn: it is known by what it removes on conditions that are left out, and "
                "there are too few to leave one out.")
    best = tried.order[0]
    try:
        return describe_missing(selection, reference, beside, (best, selection.repeat(tried.refined[best]).score),
                                lambda text, share: report(text, 0.86 + 0.1 * share))
    except (ComputationError, InputError) as error:
        return f"The missing force could not be drawn: {error}."


@dc.dataclass(frozen=True)
class Conclusion:
    """What a search comes to: the verdict, the steps that stand, and why others do not."""

    verdict: str
    steps: Sequence[FittedStep]
    where: list[Place]
    missing: MissingForce | str | None  # or why it was not drawn
    unphysical: tuple[Sequence[str], Sequence[Unphysical]] | None  # effects that need values beyond what physics allows
    irregular: bool = False  # whether what is left may be noise or settings that are not as stated
    unrepeated: bool = False  # the same of all of the misfit, as so few records do not show whether it repeats
    stopped: bool = False  # whether rounds were spent before the search came to its end
    rounding: Rounding | None = None
    biases: Sequence[SettingBias] = ()
    dropped: Sequence[FittedStep] = ()  # the search whose effects gave way to what is open, with the first step


def _conclude(path: Path, questions: bool, report: Progress) -> Conclusion:
    """The verdict on a search; effects that stand so far give way, in this order, to values beyond physics, to noise
    that no force removes, to the digits of a gauge, and to an error of one setting that all records share."""
    selection = path.selection
    steps, beyond = path.keep_physical()
    unphysical = (path.steps[len(steps)].fitted.effects, beyond) if beyond else None
    verdict, where, steps, beside = _decide(selection, steps, path.visible, questions)
    missing, irregular = None, False
    if verdict in OPEN:
        missing = _draw_force(path, steps[0].fitted, beside, report)
    if isinstance(missing, MissingForce):
        unrelated, judged = is_unrelated(selection, steps[-1].fitted, missing, where)
        # Noise and settings account for misfits of their own size; of a far larger one nothing is known.
        judged = judged and selection.reduce_chi2(steps[-1].fitted.solution) <= selection.settings.far
        irregular = unrelated and (judged or verdict == "unexplained")
        if irregular and judged:
            verdict, where = "explained" if len(steps) > 1 else "nothing-missing", []
            before, left = (selection.reduce_chi2(steps[k].fitted.solution) for k in (0, -1))
            if len(steps) > 1 and before - left < selection.settings.outweighs * (left - 1.0):
                # Noise of no kind that is modelled, of which more is left than they remove, may look like effects.
                return Conclusion("undecided", steps[:1], [], None, unphysical, irregular, dropped=steps)
        elif irregular:
            verdict = "undecided"
    rounding = find_rounding(selection, steps) if len(steps) > 1 else None
    if rounding is not None:
        return Conclusion("undecided", steps[:1], [], None, unphysical, rounding=rounding, dropped=steps)
    biases: list[SettingBias] = []
    dropped: Sequence[FittedStep] = ()
    if len(steps) > 1 and selection.holds_out:
        biases, partly = stand_in(selection, [step.fitted for step in steps])
        if matches_effects(biases, steps[-1].fitted.merit, selection.find_effects(steps[-1].fitted.effects)):
            # Where the effects leave a misfit and the bias none, nothing speaks for them.
            verdict, steps, dropped = "nothing-missing" if steps[-1].lack.rejected else "undecided", steps[:1], steps
        else:
            biases += partly
    if path.ambiguous and verdict == "nothing-missing":
        verdict, irregular = "undecided", True
    if _is_unrepeated(selection, steps, verdict):
        return Conclusion("undecided", steps[:1], [], None, unphysical, unrepeated=True,
                          dropped=steps if len(steps) > 1 else ())
    return Conclusion(verdict, steps, where, missing, unphysical, irregular, biases=biases, dropped=dropped)


def _is_unrepeated(selection: SelectionProblem, steps: Sequence[FittedStep], verdict: str) -> bool:
    """Whether a misfit may be noise or settings that are not as stated, as so few records do not show if it repeats.

    It may where effects leave some of it and all of it is no larger than such causes make it. Where they leave none, it
    may if the settings alone showed it, whose scatter so few records do not tell either, or if the records do not even
    fix a parameter of the effects, which then adapt to whatever is there.
    """
    if (selection.family.free_running or selection.records.are_values
            or selection.measure_repeats(steps[-1].fitted.solution) is not None):
        return False
    limits, reference, last = selection.settings, steps[0], steps[-1].fitted
    if selection.reduce_chi2(reference.fitted.solution) > limits.far:
        return False
    if verdict in OPEN:
        return True
    return verdict == "explained" and (
        reference.lack.smooth_p_value > limits.level_each
        or any(name.split(".")[0] in last.effects for name in list_loose(selection, last.solution)))


def _doubt_record(end: Conclusion, state: Cleaned, wander: bool) -> Conclusion:
    """The same, undecided where a misfit rests on one record alone that nothing repeats: the others leave nothing.

    So is a reference model that is in order only beside baselines that `wander`, which so large an error makes large:
    they may hide an effect.
    """
    unsure = (*OPEN, "nothing-missing") if wander else OPEN
    if (end.verdict in unsure or end.unrepeated) and any(fault.kind == "doubtful" for fault in state.faults):
        return dc.replace(end, verdict="undecided", steps=end.steps[:1], where=[], missing=None, biases=(),
                          irregular=False, unrepeated=False, dropped=())
    return end


def _leave_open(end: Conclusion, effort: Effort) -> Conclusion:
    """The same, undecided where searches were left out that might have found other effects, or noise and settings in
    their place."""
    if not effort.left_out or end.verdict not in (*OPEN, "explained"):
        return end
    return Conclusion("undecided", end.steps[:1], [], None, None, stopped=True,
                      dropped=end.dropped or (end.steps if len(end.steps) > 1 else ()))


def _decide(selection: SelectionProblem, steps: Sequence[FittedStep], visible: bool, questions: bool
            ) -> tuple[str, list[Place], Sequence[FittedStep], Fitted]:
    """Verdict, where the misfit sits, the steps that stand, and the model beside which a force is missing.

    A fit prefers some effect always. Without a condition to confirm it, only an effect that removes all of the misfit
    by itself, and beats every other by 50 noise variances within the records, is named; with a question about units
    nothing is.
    """
    reference, final = steps[0], steps[-1]
    if not reference.lack.rejected:
        return ("nothing-missing" if visible else "undecided"), [], steps, reference.fitted
    verdict, where, steps, beside = _weigh_steps(selection, steps)
    sole = verdict == "explained" and len(final.fitted.effects) == 1 and not final.alternatives
    unconfirmed = not selection.holds_out and verdict in ("explained", "improved") and not sole
    if unconfirmed or questions:
        return "undecided", where, steps[:1], beside
    return verdict, where, steps, beside


def _weigh_steps(selection: SelectionProblem, steps: Sequence[FittedStep]
                 ) -> tuple[str, list[Place], Sequence[FittedStep], Fitted]:
    """The same of a reference model that is rejected, by lack of fit and cross-validation alone."""
    limits, reference, final = selection.settings, steps[0], steps[-1]
    explained = not final.lack.rejected
    if explained and len(final.fitted.effects) == 1 and reference.lack.smooth_p_value < limits.certain:
        return "explained", locate(selection, reference.fitted, {}), steps, final.fitted
    directions = fit_directions(selection, reference.fitted, reference.scores)
    if len(steps) == 1:
        return "unexplained", locate(selection, reference.fitted, directions), steps, reference.fitted
    best = min(directions.values(), key=lambda fitted: fitted.merit, default=None)
    if best is not None and is_outdone(selection, final.fitted, best):
        # One force that no catalogue lists does better than the effects together: they only imitate it.
        where = locate(selection, reference.fitted, directions)
        gain, possible = (reference.fitted.merit - one.merit for one in (final.fitted, best))
        if gain < limits.imitation * possible:
            return "unexplained", where, steps[:1], reference.fitted
        return "improved", where, steps, reference.fitted
    if explained:
        return "explained", locate(selection, reference.fitted, {}), steps, final.fitted
    where = locate(selection, final.fitted, fit_directions(selection, final.fitted, final.scores))
    return "improved", where, steps, final.fitted


def is_unrelated(selection: SelectionProblem, fitted: Fitted, missing: MissingForce, where: Sequence[Place]
                 ) -> tuple[bool, bool]:
    """Whether a misfit is none of a force's, and whether the records show that it does not repeat over them.

    No force of any variable removes more than a little of it on left-out conditions, and nothing of it repeats. Where
    that cannot be judged it may be noise that is not as stated, such as a gyroscope's wandering bias, unless it has a
    period and a force removes any of it.
    """
    removed, limits, repeats = 0.0, selection.settings, selection.measure_repeats(fitted.solution)
    if missing.ceiling is not None and missing.shapes:
        removed = (missing.model - missing.ceiling[1]) / max(missing.model - missing.floor, 1e-300)
    if repeats is not None:
        return removed <= limits.little and repeats > limits.repeats, True
    return removed <= (0.0 if any(place.period for place in where) else limits.little), False


def list_exact(campaign: Campaign) -> list[str]:
    """Names of settings that differ from record to record and state no uncertainty; what has no unit is no setting."""
    return [name for name, column in campaign.conditions.items()
            if column.uncertainty is None and column.unit not in ("", "1") and len(set(campaign.records[name])) > 1]


def _fit_references(asked: ResolvedModel, begin: Begin, state: Cleaned, own: Fitted, settings: SelectionSettings,
                    report: Progress) -> list[tuple[str, SelectionProblem, Fitted]]:
    """Fits of every other built-in reference model of the family that does not fit far worse by itself than the one
    that was asked for, whose fit is `own`; with their names, the best first."""
    fitted, known = [], [identify_model(asked.reference)]
    for name, built in find_family(name_family(state.campaign)).models.items():
        reference = built.make()
        if not built.is_rival(state.campaign.known) or identify_model(reference) in known:
            continue
        report(f"fitting other reference models: {name}", math.nan)
        try:
            selection, alone = begin(state.campaign, state.zeros, reference, ())
        except (ComputationError, InputError):
            continue
        one, other, rows = own.solution, alone.solution, selection.samples
        same = abs(other.chi2 - one.chi2) <= settings.same_reference * one.chi2 and len(other.names) == len(one.names)
        if not same and other.chi2 - rows <= settings.farthest_reference * max(one.chi2 - rows, 1.0):
            fitted.append((name, selection, alone))
            known.append(identify_model(selection.space.reference))
    return sorted(fitted, key=lambda one: one[2].merit)


def _search_beside(fits: Sequence[tuple[str, SelectionProblem, Fitted]], settings: SelectionSettings,
                   report: Progress) -> dict[str, Path]:
    """Forward selection beside the best of other reference models, by their names."""
    found = {}
    for name, selection, alone in fits[: settings.rival_references]:
        if not may_search(f"a search beside the reference model {name}"):
            break
        with contextlib.suppress(ComputationError):
            found[name] = select_effects(selection, alone, nest_progress(
                report, f"with the reference model {name}", 0.88, 0.88))
    return found


def _describe_reference(name: str, text: str, selection: SelectionProblem, step: FittedStep, noise: Mapping[str, Noise]
                        ) -> dict[str, Any]:
    """How far another reference model came beside the noise that the discovery found, as `result.json` has it."""
    solution = step.fitted.solution
    traces = make_traces(selection.campaign, selection.records, solution, noise)
    return {"model": name, "text": text, "effects": list(step.fitted.effects), "parameters": len(solution.names),
            "rejected": step.lack.rejected, "p_value": step.lack.p_value, "chi2": solution.chi2, "nrmse": nrmse(traces),
            "ratio": measure_ratio(traces)}
