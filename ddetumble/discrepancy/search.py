"""Which effect is missing: refits of every candidate, greedy growth with swaps, confusion sets."""

import dataclasses as dc
from collections.abc import Callable, Sequence

import numpy as np

from .._numerics import map_threads
from ..contact.effect import parameters_of
from ..inference.assembly import default_starts
from .adequacy import Score
from .holdout import compare_losses
from .limits import list_unphysical
from .records import LackOfFit
from .settings import DEFAULT, SelectionSettings
from .workbench import Fitted, Workbench


@dc.dataclass(frozen=True)
class Tried:
    """Every single addition to a model.

    Attributes:
        screened: by effect id, fitted loosely (and to thinned records where these are long).
        refined: the finalists among them, fitted to all samples.
        before: the model without the addition, on the samples of `screened`.
        order: effect ids, best held-out prediction first; behind those that help within their physical limits what
            needs values beyond them.
    """

    screened: dict[str, Fitted]
    refined: dict[str, Fitted]
    before: Fitted
    order: tuple[str, ...]


@dc.dataclass(frozen=True)
class Grown:
    """A model of the loop with its judgement.

    Attributes:
        fitted: the fit; `lack` its lack of fit; `scores` of what is outside it.
        tried: the additions among which the last effect was chosen (None for the reference model).
        alternatives: confusion set: (effect, held-out difference, standard error).
    """

    fitted: Fitted
    lack: LackOfFit
    scores: list[Score]
    tried: Tried | None = None
    alternatives: tuple[tuple[str, float, float], ...] = ()


def amplitude_names(workbench: Workbench, effect: str) -> list[str]:
    """Names of an effect's amplitudes."""
    return [f"{effect}.{p.name}" for p in parameters_of(workbench.whole(effect)) if p.kind != "shape"]


def has_physical_sign(workbench: Workbench, fitted: Fitted, effect: str) -> bool:
    """Whether a fitted amplitude lies on the side of its null that physics allows."""
    for name in amplitude_names(workbench, effect):
        p = workbench.space.slots[workbench.space.index[name]].parameter
        if p.sign and p.sign * (fitted.solution.u[workbench.space.index[name]] - p.default) < 0:
            return False
    return True


def is_beyond(workbench: Workbench, current: Fitted, grown: Fitted) -> bool:
    """Whether an addition needs values beyond what physics allows."""
    return grown.solution is not current.solution and bool(list_unphysical(workbench, grown.solution))


def directed_starts(workbench: Workbench, effect: str, scores: Sequence[Score]) -> list[dict[str, float]]:
    """Interior starts of an effect; the amplitude's side follows its score where physics leaves it open."""
    starts = []
    for start in default_starts(workbench.whole(effect)):
        start = dict(start)
        for name in amplitude_names(workbench, effect):
            p = workbench.space.slots[workbench.space.index[name]].parameter
            own = [s for s in scores if s.name == name]
            if own and not p.sign:
                side = np.sign(max(own, key=lambda s: abs(s.z)).z) or 1.0
                start[name] = p.default + side * abs(start[name] - p.default)
        starts.append(start)
    return starts


def try_effects(workbench: Workbench, current: Fitted, scores: Sequence[Score], effects: Sequence[str],
                report: Callable[[str, float], None] = lambda text, share: None) -> Tried:
    """Refit `current` with each of `effects` added, from interior starts; wrong-signed amplitudes count as absent.

    All are fitted loosely, long records thinned; those that come near the best are fitted to all samples to the end.
    """
    before = current
    if workbench.thin is not None:
        again = workbench.fit(current.effects, [{}], current.solution.u, current.solution.z, screening=True)
        before = current if again is None else again
    done = []

    def one(job):
        effect, start = job
        wider = (*current.effects, effect)
        fitted = workbench.fit(wider, [start], before.solution.u, before.solution.z, screening=True)
        done.append(effect)
        report(f"refitting with {effect}", min(len(done) / count, 1.0))
        return effect, fitted

    screened: dict[str, Fitted] = {}

    def keep(found):
        for effect, fitted in found:
            if fitted is None or not has_physical_sign(workbench, fitted, effect):
                continue
            if (effect not in screened or fitted.solution.chi2 < screened[effect].solution.chi2):
                screened[effect] = fitted

    jobs = [(e, s) for e in effects for s in directed_starts(workbench, e, scores)]
    count = len(jobs)
    keep(map_threads(one, jobs))
    # A second start, one Gauss-Newton step from the null, where the first led astray.
    linear = {s.effect: s for s in sorted(scores, key=lambda s: abs(s.z))}
    jobs = []
    for effect in effects:
        lost = effect not in screened or screened[effect].solution.chi2 > before.solution.chi2 + 1.0
        if effect in linear and lost:
            s = linear[effect]
            p = workbench.space.slots[workbench.space.index[s.name]].parameter
            if not (p.sign and p.sign * s.step < 0):
                origin = s.shapes.get(s.name, float(workbench.start[workbench.space.index[s.name]]))
                jobs.append((effect, {**s.shapes, s.name: origin + s.step}))
    keep(map_threads(one, jobs))
    for effect in effects:
        if effect not in screened or screened[effect].solution.chi2 > before.solution.chi2:
            screened[effect] = dc.replace(before, effects=(*current.effects, effect))
    order = sorted(effects, key=lambda e: (screened[e].merit, screened[e].solution.chi2))
    refined = refine(workbench, current, screened, before, order)
    rest = [e for e in order if e not in refined]
    beyond = {e: is_beyond(workbench, current, refined[e]) for e in refined}
    # Where nothing helps within its limits, what fits beyond them may stand in for two effects that are both missing.
    if not any(helps(workbench, current, refined[e]) for e in refined if not beyond[e]):
        beyond = dict.fromkeys(refined, False)
    first = sorted(refined, key=lambda e: (beyond[e], refined[e].merit, refined[e].solution.chi2))
    return Tried(screened, refined, before, (*first, *rest))


def refine(workbench: Workbench, current: Fitted, screened: dict[str, Fitted], before: Fitted, order: list[str]
           ) -> dict[str, Fitted]:
    """Fit the finalists to the end: those that come near the best of the screening, or might have with more steps.

    Those that fit far better than the best are finalists, too, although they predict left-out conditions worse: where
    a fit stopped short, its held-out loss is that of a linearisation about a place which is no optimum; where it did
    not, the two judgements contradict each other, which is to be said (`find_alternatives`).
    """
    best = screened[order[0]].score
    near = {e: workbench.settings.decisive if screened[e].solution.converged else max(0.25 * (before.score - best), workbench.settings.decisive)
            for e in order}
    moved = [e for e in order if screened[e].solution is not before.solution]  # the others do nothing
    finalists = [e for e in moved if screened[e].score - best <= near[e]][:workbench.settings.finalists] or order[:1]
    fits = screened[order[0]].solution.chi2 - workbench.settings.decisive
    better = [e for e in moved if fits_better(screened[e], screened[order[0]], before, workbench.settings)
              or (not screened[e].solution.converged and screened[e].solution.chi2 < fits)]
    finalists += sorted(set(better) - set(finalists), key=lambda e: screened[e].solution.chi2)[:workbench.settings.further_finalists]
    # What a shape that the screening held would still gain is not known before it is free.
    finalists += [e for e in moved if e not in finalists and list_held(workbench, e)]

    def one(effect):
        if screened[effect].solution is before.solution:
            return effect, dc.replace(current, effects=(*current.effects, effect))
        fitted = fit_with_shapes(workbench, screened[effect], effect)
        if fitted is None or fitted.solution.chi2 > current.solution.chi2:
            fitted = dc.replace(current, effects=(*current.effects, effect))
        return effect, fitted

    return dict(map_threads(one, finalists))


def list_held(workbench: Workbench, effect: str) -> list[str]:
    """Names of an effect's shapes that are held at their default (the power of a wall's stiffness) until they help."""
    names = [f"{effect}.{p.name}" for p in parameters_of(workbench.whole(effect)) if not p.free]
    return [name for name in names if name not in workbench.freed]


def fit_with_shapes(workbench: Workbench, rough: Fitted, effect: str, thinned: bool = False) -> Fitted | None:
    """Fit a model to the end, and with the held shapes of `effect` free where that predicts better."""
    found = workbench.fit(rough.effects, [{}], rough.solution.u, rough.solution.z, thinned=thinned)
    held = list_held(workbench, effect)
    if found is None or not held:
        return found
    wider = workbench.fit(rough.effects, [{}], found.solution.u, found.solution.z, extra=held, thinned=thinned)
    return wider if wider is not None and wider.merit < found.merit - workbench.settings.significant else found


def fits_better(one: Fitted, best: Fitted, before: Fitted, settings: SelectionSettings = DEFAULT) -> bool:
    """Whether `one` removes far more of the misfit than `best`, its further parameters counted."""
    costs = [f.solution.chi2 + settings.significant * len(f.solution.names) for f in (before, best, one)]
    return costs[1] - costs[2] > max(settings.decisive, settings.better_fit * (costs[0] - costs[1]))


def compare_additions(workbench: Workbench, tried: Tried, effect: str) -> tuple[float, float]:
    """Paired held-out difference of an addition from the best one, and its standard error (noise variances)."""
    best = tried.order[0]
    if effect in tried.refined and best in tried.refined:
        return compare_losses(tried.refined[effect].loss, tried.refined[best].loss, workbench.groups)
    return compare_losses(tried.screened[effect].loss, tried.screened[best].loss, workbench.groups)


def find_alternatives(workbench: Workbench, tried: Tried, current: Fitted) -> tuple[tuple[str, float, float], ...]:
    """Every other effect that the best does not beat on held-out conditions, with the paired difference.

    One that fits far better than the best and predicts worse is not beaten either: of a model that is not all, held-out
    conditions alone may favour an effect for what else is missing.
    """
    close = []
    best = tried.refined[tried.order[0]]
    for effect in tried.order[1:]:
        if effect not in tried.refined or tried.refined[effect].solution is current.solution:
            continue
        if is_beyond(workbench, current, tried.refined[effect]):
            continue
        difference, error = compare_additions(workbench, tried, effect)
        if not workbench.settings.is_beaten(difference, error) or fits_better(
                tried.refined[effect], best, current, workbench.settings):
            close.append((effect, difference, error))
    return tuple(close)


def helps(workbench: Workbench, current: Fitted, grown: Fitted) -> bool:
    """Whether an addition predicts held-out conditions better, beyond chance."""
    if grown.solution is current.solution:
        return False
    gain, error = compare_losses(current.loss, grown.loss, workbench.groups)
    ahead, doubt = compare_losses(current.forecast, grown.forecast, workbench.groups)
    if workbench.family.free_running and ahead < -2 * doubt:
        return False
    by_group = np.array([(current.loss - grown.loss)[workbench.groups == g].sum() for g in np.unique(workbench.groups)])
    return gain > workbench.settings.significant and (gain > 2 * error or float(np.mean(by_group > 0)) >= workbench.settings.majority or gain > workbench.settings.decisive)


def predicts_better(workbench: Workbench, current: Fitted, grown: Fitted) -> bool:
    """Whether an addition does not raise the error on what was left out; true where nothing can be left out."""
    return not workbench.holds_out or workbench.measure_left_out(grown) <= workbench.measure_left_out(current)


def grow(workbench: Workbench, current: Grown, report: Callable[[str, float], None] = lambda text, share: None,
         first: Tried | None = None) -> Grown | None:
    """Add the effect that helps most; None where none helps. With two or more effects, swaps are tried too."""
    base = current.fitted
    others = [e.id for e in workbench.catalogue if e.id not in base.effects]
    tried = first if first is not None else try_effects(workbench, base, current.scores, others, report)
    chosen = tried.refined[tried.order[0]]
    if not helps(workbench, base, chosen):
        return None
    keep_free(workbench, chosen)
    if len(chosen.effects) > 1:
        chosen, tried, base = swap_effects(workbench, chosen, tried, base, report)
    lack, scores = workbench.judge(chosen)
    return Grown(chosen, lack, scores, tried, find_alternatives(workbench, tried, base))


def keep_free(workbench: Workbench, chosen: Fitted) -> None:
    """From here on the shapes that a chosen model has free are free in every fit that has the effect."""
    held = [name for effect in chosen.effects for name in list_held(workbench, effect)]
    workbench.freed = (*workbench.freed, *(name for name in held if name in chosen.solution.names))


def swap_effects(workbench: Workbench, chosen: Fitted, tried: Tried, base: Fitted, report
                 ) -> tuple[Fitted, Tried, Fitted]:
    """Exchange each earlier effect for any other while that predicts held-out conditions better.

    The first of a pair is chosen while the second is still missing, and may be a third effect that mimics both.
    """
    for _ in range(2):
        changed = False
        for place in range(len(chosen.effects) - 1):
            kept = tuple(e for k, e in enumerate(chosen.effects) if k != place)
            start = workbench.fit(kept, [{}], _without(workbench, chosen, chosen.effects[place]), chosen.solution.z)
            if start is None:
                continue
            _, scores = workbench.judge(start)
            others = [e.id for e in workbench.catalogue if e.id not in kept]
            again = try_effects(workbench, start, scores, others, report)
            best = again.refined[again.order[0]]
            simpler = len(best.solution.names) < len(chosen.solution.names)
            within = (is_beyond(workbench, base, chosen), is_beyond(workbench, start, best))
            if (within == (True, False) and helps(workbench, start, best)) or (
                    within != (False, True) and best.merit < chosen.merit - (1e-6 if simpler else workbench.settings.significant)):
                chosen, tried, base, changed = best, again, start, True
                keep_free(workbench, chosen)
        if not changed:
            break
    return chosen, tried, base


def free_shapes(workbench: Workbench, grown: Grown) -> Grown:
    """Free shapes that are held at their default (the power of a wall's stiffness) where that predicts better."""
    fitted = grown.fitted
    for effect in fitted.effects:
        held = list_held(workbench, effect)
        if not held:
            continue
        wider = workbench.fit(fitted.effects, [{}], fitted.solution.u, fitted.solution.z, extra=held)
        if wider is not None and wider.merit < fitted.merit - workbench.settings.significant and helps(workbench, fitted, wider):
            workbench.freed = (*workbench.freed, *held)
            lack, scores = workbench.judge(wider)
            grown = dc.replace(grown, fitted=wider, lack=lack, scores=scores)
            fitted = wider
    return grown


def prune(workbench: Workbench, grown: Grown) -> Grown:
    """Take back what a later addition has made needless: freed shapes first, then effects."""
    fitted = grown.fitted
    for name in [n for n in workbench.freed if n.split(".")[0] in fitted.effects]:
        kept = workbench.freed
        workbench.freed = tuple(n for n in kept if n != name)
        start = fitted.solution.u.copy()
        start[workbench.space.index[name]] = workbench.start[workbench.space.index[name]]
        simpler = workbench.fit(fitted.effects, [{}], start, fitted.solution.z)
        if simpler is not None and simpler.merit < fitted.merit:
            fitted = simpler
        else:
            workbench.freed = kept
    for effect in fitted.effects[:-1]:
        rest = tuple(e for e in fitted.effects if e != effect)
        simpler = workbench.fit(rest, [{}], _without(workbench, fitted, effect), fitted.solution.z)
        if simpler is not None and simpler.merit < fitted.merit:
            fitted = simpler
    if len(fitted.effects) > 1:
        # The last one helps beyond the fit without it, which may have stopped short: from here it may go on.
        rest = workbench.fit(fitted.effects[:-1], [{}], _without(workbench, fitted, fitted.effects[-1]),
                             fitted.solution.z)
        if rest is not None and rest.score < fitted.score + workbench.settings.significant:
            fitted = rest
    if fitted is grown.fitted:
        return grown
    lack, scores = workbench.judge(fitted)
    return dc.replace(grown, fitted=fitted, lack=lack, scores=scores)


def _without(workbench: Workbench, fitted: Fitted, effect: str) -> np.ndarray:
    """Coordinates of a fit with one effect put back to its null."""
    u = fitted.solution.u.copy()
    for k, slot in enumerate(workbench.space.slots):
        if slot.owner == effect:
            u[k] = workbench.start[k]
    return u
