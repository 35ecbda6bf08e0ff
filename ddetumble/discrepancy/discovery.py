"""The loop: compare, say where it fails, add the effect that helps, until nothing is missing or nothing helps."""

import dataclasses as dc
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from .._errors import ComputationError, InputError
from ..contact.effect import AbstractEffect
from ..inference.archive import resolve_model
from ..inference.families import find_family, name_family
from ..measurement.campaign import Campaign
from ..measurement.package import read_campaign
from ..measurement.plausibility import check_plausibility
from .candidates import could_have_shown, describe_candidates
from .cleaning import begin_cleaning, clean_records
from .limits import describe_beyond, describe_imitation
from .missing import describe_missing, summarise_missing
from .places import fit_probes, locate
from .records import Discovery, MissingForce, Place
from .references import (
    Search,
    choose_reference,
    keep_physical,
    mention_references,
    stacks_up,
    try_references,
)
from .search import Grown, Tried, free_shapes, grow, predicts_better, prune, try_effects
from .settings import DEFAULT, SelectionSettings
from .steps import describe_noise, describe_step, list_loose, noise_over_signal
from .wording import explain, mention_doubts, mention_faults
from .workbench import Fitted, Workbench


Progress = Callable[[str, float], None]


def discover(campaign: Campaign | str | Path, model: str = "paper", *, effects: Sequence[type[AbstractEffect]] = (),
             settings: SelectionSettings = DEFAULT, keep_all: bool = False, progress: Progress | None = None
             ) -> Discovery:
    """Find out which physical effect a campaign shows and the model lacks.

    Args:
        campaign: a campaign with samples, or its folder.
        model: reference model, see `ddetumble.inference.models`; one that has effects already is grown further.
        effects: effects of your own, tried beside the catalogue.
        settings: thresholds that decide; the result keeps them.
        keep_all: leave out no record and no sample: faults of the data are reported, and nothing is done about them.
        progress: called with a sentence and the share done.

    Returns:
        A `Discovery`: verdict, effects, parameters, where the misfit sits, what could not be told apart.

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
    state = begin_cleaning(campaign, keep_all, settings.most_samples)

    def begin(campaign):
        return Workbench(campaign, resolved.reference, effects, resolved.effects, state.zeros, settings)

    def search_again(campaign):
        report("looking behind a record", 0.87)
        bench = begin(campaign)
        last = _search(bench, bench.begin(), lambda text, share: None).grown[-1]
        return (bench, last.fitted) if last.lack.smooth_p_value > settings.level_each else None

    for turn in range(settings.rounds):
        report("fitting the reference model", 0.02)
        workbench = begin(state.campaign)
        reference = workbench.begin()
        state, changed = clean_records(state, workbench, reference, False)
        if changed and turn < settings.rounds - 1:
            continue
        found = _search(workbench, reference, report)
        grown = found.grown
        if grown[0].lack.rejected and turn < settings.rounds - 1:
            report("looking for records at fault", 0.86)
            state, changed = clean_records(state, workbench, grown[-1].fitted, True,
                                           search_again if grown[-1].lack.rejected else None)
            if changed:
                continue
        break
    name, rivals = resolved.name, ()
    # A wrong unit that would explain what is odd about the campaign is asked about before any physics is named.
    questions = [str(one) for one in check_plausibility(state.campaign) if one.mistakes]
    if stacks_up(found) and not questions:
        report("trying the other reference models", 0.88)
        rivals = try_references(resolved, state.campaign, effects, state.zeros, found.grown[0].fitted, settings,
                                lambda bench, alone: _search(bench, alone, lambda text, share: None))
        better = choose_reference(found, rivals)
        found, name = (_grow_on(found, settings.most_effects, report), name) if better is None else (better.search, better.name)
    workbench, tried = found.workbench, found.tried
    grown, beyond = keep_physical(found)
    doubts = (*questions, *([describe_beyond(found.grown[len(grown)].fitted.effects, beyond)] if beyond else ()))
    verdict, where, grown, beside = _decide(workbench, grown, found.visible)
    if not workbench.holds_out:
        verdict, grown = _decide_within(verdict, grown)
    if questions and grown[0].lack.rejected:
        verdict, grown = "undecided", grown[:1]
    missing = None
    if verdict in ("improved", "unexplained"):
        missing = _draw(workbench, grown, tried, beside, report)
    report("writing it down", 0.97)
    discovery = _assemble(workbench, name, grown, tried, verdict, where, missing, began)
    discovery = dc.replace(discovery, notes=(*state.notes, *discovery.notes))
    if not beyond and verdict in ("improved", "unexplained"):
        doubts += describe_imitation(discovery.candidates, settings.largest_part)
    discovery = mention_doubts(discovery, doubts, units=bool(questions))
    if rivals:
        discovery = mention_references(discovery, resolved.name, rivals)
    return mention_faults(discovery, state.faults)


def _search(workbench: Workbench, reference: Fitted, report: Progress) -> Search:
    """The steps of the loop up to two effects, every first addition, and whether the campaign could have shown one."""
    report("looking for what is missing", 0.15)
    lack, scores = workbench.judge(reference)
    grown = [Grown(reference, lack, scores)]
    tried = try_effects(workbench, reference, scores, [e.id for e in workbench.catalogue],
                        lambda text, share: report(text, 0.2 + 0.4 * share))
    return _grow_on(Search(workbench, grown, tried, could_have_shown(workbench, scores)),
                    workbench.settings.effects_before_rivals, report)


def _grow_on(search: Search, most: int, report: Progress) -> Search:
    """The same with up to `most` additions."""
    workbench, grown = search.workbench, list(search.grown)
    first = search.tried if len(grown) == 1 else None
    while grown[-1].lack.rejected and len(grown) <= most:
        report("growing the model", min(0.6 + 0.1 * len(grown), 0.85))
        more = grow(workbench, grown[-1], first=first)
        first = None
        if more is None:
            break
        if more.lack.rejected:
            more = free_shapes(workbench, more)
        if len(more.fitted.effects) > 1:
            more = prune(workbench, more)
        more = dc.replace(more, fitted=workbench.finish(more.fitted))
        if more.fitted.effects == grown[-1].fitted.effects:
            # The addition only helped a fit along that had stopped short.
            gain = grown[-1].fitted.score - more.fitted.score
            grown[-1] = dc.replace(grown[-1], fitted=more.fitted, lack=more.lack, scores=more.scores)
            if gain < workbench.settings.significant:
                break
            continue
        if not predicts_better(workbench, grown[-1].fitted, more.fitted):
            break
        grown.append(more)
        if workbench.measure_again(more.fitted):
            grown = [_again(workbench, g) for g in grown]
            if not predicts_better(workbench, grown[-2].fitted, grown[-1].fitted):
                grown.pop()
                break
    return dc.replace(search, grown=grown)


def _draw(workbench: Workbench, grown: list[Grown], tried: Tried, beside: Fitted, report: Progress
          ) -> MissingForce | str:
    """The missing force itself, or why there is none: no verdict depends on it."""
    if not workbench.holds_out:
        return ("The missing force was not drawn: it is known by what it removes on conditions that are left out, and "
                "there are too few to leave one out.")
    best = tried.order[0]
    again = workbench.repeat(tried.refined[best]) if best in tried.refined else tried.screened[best]
    try:
        return describe_missing(workbench, grown[0].fitted, beside, (best, again.score),
                                lambda text, share: report(text, 0.86 + 0.1 * share))
    except (ComputationError, InputError) as error:
        return f"The missing force could not be drawn: {error}."


def _again(workbench: Workbench, grown: Grown) -> Grown:
    """A step fitted and judged again under another noise."""
    fitted = workbench.repeat(grown.fitted)
    lack, scores = workbench.judge(fitted)
    return dc.replace(grown, fitted=fitted, lack=lack, scores=scores)


def _decide(workbench: Workbench, grown: list[Grown], visible: bool) -> tuple[str, list[Place], list[Grown], Fitted]:
    """Verdict, where the misfit sits, the steps that stand, and the model beside which a force is missing."""
    reference, final = grown[0], grown[-1]
    if not reference.lack.rejected:
        return ("nothing-missing" if visible else "undecided"), [], grown, reference.fitted
    if len(grown) == 1:
        probes = fit_probes(workbench, reference.fitted, reference.scores)
        return "unexplained", locate(workbench, reference.fitted, probes), grown, reference.fitted
    plain = not final.lack.rejected and len(final.fitted.effects) == 1
    if plain and reference.lack.smooth_p_value < workbench.settings.certain:
        return "explained", locate(workbench, reference.fitted, {}), grown, final.fitted
    probes = fit_probes(workbench, reference.fitted, reference.scores)
    best = min(probes.values(), key=lambda f: f.merit, default=None)
    if best is not None and best.merit < final.fitted.merit - workbench.settings.significant:
        # One force that no catalogue lists does better than the effects together: they only imitate it.
        where = locate(workbench, reference.fitted, probes)
        gain, possible = (reference.fitted.merit - one.merit for one in (final.fitted, best))
        if gain < workbench.settings.imitation * possible:
            return "unexplained", where, grown[:1], reference.fitted
        return "improved", where, grown, reference.fitted
    if not final.lack.rejected:
        return "explained", locate(workbench, reference.fitted, {}), grown, final.fitted
    where = locate(workbench, final.fitted, fit_probes(workbench, final.fitted, final.scores))
    return "improved", where, grown, final.fitted


def _decide_within(verdict: str, grown: list[Grown]) -> tuple[str, list[Grown]]:
    """Verdict where no condition can be left out: one effect that no other comes near, or nothing is decided.

    A fit prefers some effect always. Without a condition to confirm it, only an effect that removes all of the misfit
    by itself, and beats every other by 50 noise variances within the records, is named.
    """
    alone = verdict == "explained" and len(grown[-1].fitted.effects) == 1 and not grown[-1].alternatives
    if verdict in ("explained", "improved") and not alone:
        return "undecided", grown[:1]
    return verdict, grown


def _list_rivals(grown: list[Grown]) -> list[Fitted]:
    """Fits that the last step could not tell from the best one."""
    last = grown[-1]
    return [] if last.tried is None else [last.tried.refined[e] for e, _, _ in last.alternatives]


def _assemble(workbench: Workbench, model: str, grown: list[Grown], tried, verdict: str, where: list[Place],
              missing: MissingForce | str | None, began: float) -> Discovery:
    """Everything as plain records."""
    steps = [describe_step(workbench, g, before=grown[k - 1] if k else None) for k, g in enumerate(grown)]
    effects = grown[-1].fitted.effects if len(grown) > 1 else ()
    candidates = describe_candidates(workbench, grown, tried)
    found = Discovery(
        campaign=workbench.campaign.name, title=workbench.campaign.title, family=workbench.campaign.family,
        sha256=workbench.campaign.sha256, model=model, verdict=verdict, effects=effects, steps=tuple(steps),
        candidates=tuple(candidates), where=tuple(where), noise_nrmse=noise_over_signal(steps[0].traces),
        noise=describe_noise(workbench), sentence="", notes=(), settings={
            "level": workbench.settings.level, "selection": dc.asdict(workbench.settings), "records": workbench.records.count, "samples": int(workbench.records.lengths.sum()),
            "conditions": workbench.conditions, "seconds": round(time.perf_counter() - began, 2)},
        missing=missing if isinstance(missing, MissingForce) else None,
        selection=workbench.settings, model_state={"workbench": workbench, "solution": grown[-1].fitted.solution, "rivals": _list_rivals(grown)},
    )
    sentence, notes = explain(found, workbench.left_out, workbench.family)
    if isinstance(missing, MissingForce):
        sentence += f" {summarise_missing(missing)}"
    elif missing:
        notes = (*notes, missing)
    loose = list_loose(workbench, grown[-1].fitted.solution)
    if loose:
        notes = (*notes, f"These records do not fix {' and '.join(loose)}: other values fit as well, and the intervals "
                         "say so. Hold one of them at a known value, or measure at conditions that tell them apart.")
    return dc.replace(found, sentence=sentence, notes=(*workbench.warnings, *notes))
