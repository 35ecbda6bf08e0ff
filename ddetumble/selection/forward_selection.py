"""Forward selection: which effect is missing.

Test the lack of fit of a model; where it is significant, screen every candidate, fit those that come near the best,
cross-validate, choose, exchange earlier choices while that predicts better, take back what has become needless; repeat.
"""

import dataclasses as dc
import time
from collections.abc import Sequence

import numpy as np

from .._display import Progress, nest_progress, stay_silent, tell_left
from .._numerics import map_threads
from ..contact.effect import Parameter
from ..inference import distributions as stats
from ..inference.assembly import default_starts
from ..inference.goodness import doubt_level
from ..inference.noise_estimation import changed, has_more_hum, measure_noise
from ..inference.problem import Solution
from ..inference.variance_components import find_slow_noise
from .cross_validation import compare_losses
from .effort import count_round, may_search
from .lack_of_fit import Score
from .localise import find_line
from .problem import Fitted, SelectionProblem
from .result import LackOfFit
from .settings import DEFAULT, SelectionSettings


SIGNATURE = 3.0  # times the noise, of an effect that a campaign should have shown
AT_BOUND = 0.01  # typical changes of a coordinate by which a fit that ended at a bound may be off it
SETTLING = 3  # searches with another scatter of the settings: the second hardly ever changes it


@dc.dataclass(frozen=True)
class CandidateFits:
    """Every single addition to a model, by effect id."""

    screened: dict[str, Fitted]  # fitted loosely (and to thinned records where these are long)
    refined: dict[str, Fitted]  # the finalists among them, fitted to all samples
    before: Fitted  # the model without the addition, on the samples of `screened`
    order: tuple[str, ...]  # best cross-validated prediction first; what needs unphysical values behind what helps


@dc.dataclass(frozen=True)
class FittedStep:
    """A model on the way with its judgement."""

    fitted: Fitted
    lack: LackOfFit
    scores: list[Score]  # of what is outside it
    tried: CandidateFits | None = None  # among which the last effect was chosen (None for the reference model)
    # Those that it could not be told from: (effect, cross-validated difference, standard error).
    alternatives: tuple[tuple[str, float, float], ...] = ()

    def refit(self, selection: SelectionProblem, fitted: Fitted) -> "FittedStep":
        """The same step with another fit, judged again."""
        lack, scores = selection.test_lack_of_fit(fitted)
        return dc.replace(self, fitted=fitted, lack=lack, scores=scores)


@dc.dataclass(frozen=True)
class Path:
    """What forward selection found beside one reference model."""

    selection: SelectionProblem  # as the last step left it: its noise, and the shapes that are free
    steps: tuple[FittedStep, ...]  # the reference model first
    tried: CandidateFits  # every first addition
    visible: bool  # whether the campaign could have shown an effect
    ambiguous: bool = False  # whether the baselines that it allows for may as well be what a force does

    def keep_physical(self) -> tuple[tuple[FittedStep, ...], "tuple[Unphysical, ...]"]:
        """The steps up to the last one that lies within physical limits, and what lay beyond them in the next."""
        steps, beyond = self.steps, ()
        while len(steps) > 1 and (now := list_unphysical(self.selection, steps[-1].fitted.solution)):
            beyond, steps = now, steps[:-1]
        return steps, beyond

    def is_explained(self) -> bool:
        """Whether no misfit is left within physical limits."""
        return not self.keep_physical()[0][-1].lack.rejected


def select_effects(selection: SelectionProblem, reference: Fitted, report: Progress = stay_silent,
                   most: int | None = None) -> Path:
    """Forward selection beside a fitted reference model with up to `most` additions: by default as many as stand before
    other reference models are worth a try."""
    report("looking for what is missing", 0.15)
    lack, scores = selection.test_lack_of_fit(reference)
    tried = try_effects(selection, reference, scores, lambda text, share: report(text, 0.2 + 0.4 * share))
    start = Path(selection, (FittedStep(reference, lack, scores),), tried, could_have_shown(selection, scores))
    return extend_path(start, selection.settings.effects_before_rivals if most is None else most, report)


def extend_path(path: Path, most: int, report: Progress = stay_silent) -> Path:
    """The same with up to `most` additions."""
    selection, steps = path.selection, list(path.steps)
    if selection.records.are_values:
        most = min(most, selection.settings.effects_of_values)
    tried = path.tried if len(steps) == 1 else None
    while steps[-1].lack.rejected and len(steps) <= most:
        share = min(0.6 + 0.1 * len(steps), 0.85)
        current = steps[-1]
        if tried is None and not may_search(f"a search beside {' + '.join(current.fitted.effects)}"):
            break

        def tell(text, _, share=share):
            report(text, share)

        tell(f"growing the model: {' + '.join(current.fitted.effects) or 'no effect'} so far", 0.0)
        if tried is None:
            if {e.id for e in selection.catalogue} <= set(current.fitted.effects):
                break
            tried = try_effects(selection, current.fitted, current.scores, tell)
        wider, more = add_effect(selection, current, tried, tell)
        if more is None:
            break
        if more.fitted.effects == current.fitted.effects:
            # The addition only helped a fit along that had stopped short.
            steps[-1] = dc.replace(current, fitted=more.fitted, lack=more.lack, scores=more.scores)
            selection, tried = wider, None
            if current.fitted.score - more.fitted.score < selection.settings.significant:
                break
            continue
        if not predicts_better(selection, current.fitted, more.fitted):
            tried = skip_worse(selection, current.fitted, tried)
            if tried is None:
                break
            continue
        selection, tried = wider, None
        steps.append(more)
        # What a poor model leaves may be too sharp for the splines that are taken out of its residuals first: where the
        # better one leaves another noise, every step is fitted and judged again under it.
        settings = selection.settings.noise
        for _ in range(settings.looks):
            noise = measure_noise(selection.campaign, selection.records, steps[-1].fitted.solution, settings,
                                  selection.noise)
            if not changed(selection.noise, noise, settings):
                break
            again = has_more_hum(selection.noise, noise)
            selection = dc.replace(selection.restack(noise), noise=noise)
            for k, step in enumerate(steps):
                fitted = selection.repeat(step.fitted)
                selection = selection.span(fitted.solution)
                steps[k] = step.refit(selection, fitted)
            if not again:
                break
        if selection is not wider:
            # Under that noise fewer effects may be enough; else the last one has to predict better, too.
            enough = next((k for k, step in enumerate(steps[:-1]) if not step.lack.rejected), None)
            if enough is not None:
                steps = steps[: enough + 1]
            elif not predicts_better(selection, steps[-2].fitted, steps[-1].fitted):
                steps.pop()
                break
    return dc.replace(path, selection=selection, steps=tuple(steps))


def add_effect(selection: SelectionProblem, current: FittedStep, tried: CandidateFits,
               report: Progress = stay_silent) -> tuple[SelectionProblem, FittedStep | None]:
    """Add the effect of `tried` that helps most; None where none helps. With two or more effects, exchanges are tried
    too; shapes are freed, and what has become needless is taken back."""
    base, chosen = current.fitted, tried.refined[tried.order[0]]
    if not helps(selection, base, chosen):
        return selection, None
    selection = free_chosen(selection, chosen)
    if len(chosen.effects) > 1:
        selection, chosen, tried, base = exchange_effects(selection, chosen, tried, base, report)
    lack, scores = selection.test_lack_of_fit(chosen)
    step = FittedStep(chosen, lack, scores, tried, find_alternatives(selection, tried, base))
    if step.lack.rejected:
        for effect in step.fitted.effects:
            wider = free_held(selection, step.fitted, effect)
            if wider is not None and helps(selection, step.fitted, wider):
                selection = free_chosen(selection, wider)
                step = step.refit(selection, wider)
    if len(step.fitted.effects) > 1:
        selection, step = prune(selection, step)
    fitted = selection.repeat(step.fitted, 1e-5)
    gain = step.fitted.solution.chi2 - fitted.solution.chi2
    if fitted.solution.failed or gain < -1e-3:  # it broke down, beyond what the integrator's tolerance allows
        return selection, step
    # A fit that has stopped short leaves a misfit of its own, in residuals and settings.
    judged = gain < selection.settings.same_fit
    return selection, dc.replace(step, fitted=fitted) if judged else step.refit(selection, fitted)


def could_have_shown(selection: SelectionProblem, scores: Sequence[Score]) -> bool:
    """Whether any effect whose own signature is three times the noise would have been found."""
    if selection.records.are_values:
        return any(has_power(selection, score) for score in scores)
    catalogued, least = {e.id for e in selection.catalogue}, selection.settings.shown**2 / SIGNATURE**2
    return any(selection.samples * s.visible > least for s in scores if s.effect in catalogued)


def has_power(selection: SelectionProblem, score: Score) -> bool:
    """Whether values with a signature of three times their noise would have been judged to lack an effect more often
    than not, at the level of one statistic: their noise may be known from few degrees of freedom.

    The test is that of `judge_values`; what refitting leaves of the signature makes it non-central.
    """
    limits, known = selection.settings, sum(n.degrees for n in selection.noise.values())
    count = int(selection.samples) + len(selection.priors)
    left = count - len(selection.base)
    strength = SIGNATURE**2 * selection.samples * score.visible
    rest, degrees = (left - known, known) if known else (left, 2.0 / doubt_level(selection.noise) ** 2)
    if rest < 1:
        return False
    return bool(stats.ncf.sf(stats.f.isf(limits.level_each, rest, degrees), rest, degrees, strength) >= 0.5)


def has_physical_sign(selection: SelectionProblem, fitted: Fitted, effect: str) -> bool:
    """Whether a fitted amplitude lies on the side of its null that physics allows."""
    space = selection.space
    return not any(p.sign and p.sign * (fitted.solution.u[space.index[name]] - p.default) < 0
                   for name in selection.list_amplitudes(effect) for p in [space.parameter(name)])


def is_beyond(selection: SelectionProblem, current: Fitted, grown: Fitted) -> bool:
    """Whether an addition needs values beyond what physics allows."""
    return grown.solution is not current.solution and bool(list_unphysical(selection, grown.solution))


def list_starts(selection: SelectionProblem, effect: str, scores: Sequence[Score], frequency: float | None = None
                ) -> list[dict[str, float]]:
    """Interior starts of an effect; the amplitude's side follows its score where physics leaves it open.

    An effect with a `line` starts from the `frequency` of the residuals' strongest line, where there is one.
    """
    starts = default_starts(selection.find_effect(effect))
    for name in selection.list_amplitudes(effect):
        p, own = selection.space.parameter(name), [s.z for s in scores if s.name == name]
        if own and not p.sign:
            side = np.sign(max(own, key=abs)) or 1.0
            starts = [{**start, name: _take_side(p, start[name], side)} for start in starts]
    line = selection.find_effect(effect).line
    if line is not None and frequency is not None:
        place = selection.space.parameter(line).transform.to_unconstrained(frequency)
        starts = [{**start, line: place} for start in starts]
        starts = [start for k, start in enumerate(starts) if start not in starts[:k]]
    return starts


def _take_side(parameter: Parameter, value: float, side: float) -> float:
    """A coordinate of an amplitude as far from its null, on the side whose sign is given."""
    return parameter.default + side * abs(value - parameter.default)


def start_anew(selection: SelectionProblem, fitted: Fitted) -> dict[str, float]:
    """Interior starts of the effects that a fit has, the amplitudes on the side on which they are."""
    space, found = selection.space, {}
    for effect in fitted.effects:
        found |= default_starts(selection.find_effect(effect))[0]
        for name in selection.list_amplitudes(effect):
            p = space.parameter(name)
            if not p.sign and name in found:
                side = np.sign(fitted.solution.u[space.index[name]] - p.default) or 1.0
                found[name] = _take_side(p, found[name], side)
    return found


def try_effects(selection: SelectionProblem, current: Fitted, scores: Sequence[Score],
                report: Progress = stay_silent) -> CandidateFits:
    """Refit `current` with each effect of the catalogue added, from interior starts; a wrong sign counts as absent.

    All are fitted loosely, long records thinned; those that come near the best are fitted to all samples to the end.
    """
    count_round()
    effects = [effect.id for effect in selection.catalogue if effect.id not in current.effects]
    before, space = current, selection.space
    if selection.thin is not None:
        before = selection.extend(current, current.effects, screening=True) or current
    screened: dict[str, Fitted] = {}
    far: list[Fitted] = []
    done: list[str] = []
    beside, began = f" beside {' + '.join(current.effects)}" if current.effects else "", time.monotonic()

    def begin(job):
        effect, start = job
        fitted = selection.fit((*current.effects, effect), [start], before.solution.u, before.solution.z,
                               screening=True)
        done.append(effect)
        told, left = min(len(done), count), tell_left(time.monotonic() - began, len(done), count)
        report(f"refitting with every effect{beside}: {effect}, {told} of {count}{left}", told / count)
        return fitted

    def go_on(fitted):
        return selection.extend(fitted, fitted.effects, thinned=True)

    def fit_all(jobs, work=begin):
        for fitted in filter(None, map_threads(work, jobs)):
            effect = fitted.effects[-1]
            if not fitted.solution.converged and fitted.solution.chi2 > before.solution.chi2:
                far.append(fitted)
            if (has_physical_sign(selection, fitted, effect)
                    and (effect not in screened or fitted.solution.chi2 < screened[effect].solution.chi2)):
                screened[effect] = fitted

    periodic = any(selection.find_effect(e).line is not None for e in effects)
    frequency = find_line(selection, current) if periodic else None
    def is_above(effect, more=0.0):
        return effect not in screened or screened[effect].solution.chi2 > before.solution.chi2 + more

    jobs = [(e, s) for e in effects for s in list_starts(selection, e, scores, frequency)]
    if not current.solution.converged:
        # An effect that still runs along a valley may make up for what is missing: it starts anew, too.
        anew = start_anew(selection, current)
        jobs += [(e, {**anew, **s}) for e, s in jobs] if anew else []
    count = len(jobs)
    fit_all(jobs)
    # A second start, one Gauss-Newton step from the null, where the first led astray.
    linear = {s.effect: s for s in sorted(scores, key=lambda s: abs(s.z))}
    jobs = []
    for s in (linear[e] for e in effects if e in linear and is_above(e, selection.settings.astray)):
        if space.parameter(s.name).sign * s.step >= 0:
            origin = s.shapes.get(s.name, float(selection.start[space.index[s.name]]))
            jobs.append((s.effect, {**s.shapes, s.name: origin + s.step}))
    fit_all(jobs)
    # What has not come below the model without the effect in a few steps may be on its way from far off.
    fit_all([fitted for fitted in far if is_above(fitted.effects[-1])], go_on)
    for effect in filter(is_above, effects):
        screened[effect] = dc.replace(before, effects=(*current.effects, effect))
    order = sorted(effects, key=lambda e: (screened[e].merit, screened[e].solution.chi2))
    report(f"fitting the best effects{beside} to the end", 1.0)
    refined = refine(selection, current, screened, before, order)
    beyond = {e: is_beyond(selection, current, refined[e]) for e in refined}
    # Where nothing helps within its limits, what fits beyond them may stand in for two effects that are both missing.
    if not any(helps(selection, current, refined[e]) for e in refined if not beyond[e]):
        beyond = dict.fromkeys(refined, False)
    first = sorted(refined, key=lambda e: (beyond[e], refined[e].merit, refined[e].solution.chi2))
    return CandidateFits(screened, refined, before, (*first, *(e for e in order if e not in refined)))


def refine(selection: SelectionProblem, current: Fitted, screened: dict[str, Fitted], before: Fitted,
           order: Sequence[str]) -> dict[str, Fitted]:
    """Fit the finalists to the end: those that come near the best of the screening, or might have with more steps.

    Those that fit as well as the best, or far better, are finalists, too, although they predict left-out conditions
    worse: where a fit stopped short, its cross-validated loss is that of a linearisation about a place which is no
    optimum, and of few conditions it is little evidence; where it did not, the two judgements contradict each other,
    which is to be said (`find_alternatives`).
    """
    limits, best = selection.settings, screened[order[0]]
    near = {e: limits.decisive if screened[e].solution.converged else
            max(limits.unfinished * (before.score - best.score), limits.decisive) for e in order}
    moved = [e for e in order if screened[e].solution is not before.solution]  # the others do nothing
    finalists = [e for e in moved if screened[e].score - best.score <= near[e]][:limits.finalists] or [order[0]]
    fits = best.solution.chi2 - limits.decisive
    better = [e for e in moved if e not in finalists and (
        fits_better(screened[e], best, before, limits)
        or (not screened[e].solution.converged and screened[e].solution.chi2 < fits))]
    alike = [e for e in moved if e not in (*finalists, *better) and fits_as_well(screened[e], best, limits)]
    for some in (better, alike):
        finalists += sorted(some, key=lambda e: screened[e].solution.chi2)[: limits.further_finalists]
    # What a shape that the screening held would still gain is not known before it is free.
    finalists += [e for e in moved if e not in finalists and selection.list_held(e)]

    def one(effect):
        rough = None if screened[effect].solution is before.solution else screened[effect]
        return effect, fit_with_shapes(selection, rough, current, effect)

    return dict(map_threads(one, finalists))


def fit_with_shapes(selection: SelectionProblem, rough: Fitted | None, before: Fitted, effect: str,
                    thinned: bool = False) -> Fitted:
    """Fit a model to the end, and with the held shapes of `effect` free where that predicts better.

    Where there is none, or it does not come below the model `before` without the effect, that counts as absent.
    """
    found = rough and selection.extend(rough, rough.effects, thinned=thinned)
    found = found and (free_held(selection, found, effect, thinned) or found)
    if found is None or found.solution.chi2 > before.solution.chi2:
        return dc.replace(before, effects=(*before.effects, effect))
    return found


def free_held(selection: SelectionProblem, fitted: Fitted, effect: str, thinned: bool = False) -> Fitted | None:
    """A model with the parameters of an effect free that are held at their default (the power of a wall's stiffness);
    None where there are none, or that does not predict better.

    Of several, one after another, the best first: what the records cannot tell (a phase of the motion) stays held.
    """
    held, best = selection.list_held(effect), fitted
    while True:
        freed = [name for name in held if name in best.solution.names]
        tried = [selection.extend(best, best.effects, extra=(*freed, name), thinned=thinned)
                 for name in held if name not in freed]
        wider = min((one for one in tried if one is not None), key=lambda one: one.merit, default=None)
        if wider is None or wider.merit >= best.merit - selection.settings.significant:
            return None if best is fitted else best
        best = wider


def fits_as_well(one: Fitted, best: Fitted, settings: SelectionSettings = DEFAULT) -> bool:
    """Whether `one` removes as much of a misfit as `best`, but for chance, its further parameters counted."""
    costs = [f.solution.chi2 + settings.significant * len(f.solution.names) for f in (best, one)]
    return costs[1] - costs[0] < settings.significant


def fits_better(one: Fitted, best: Fitted, before: Fitted, settings: SelectionSettings = DEFAULT) -> bool:
    """Whether `one` removes far more of the misfit than `best`, its further parameters counted."""
    costs = [f.solution.chi2 + settings.significant * len(f.solution.names) for f in (before, best, one)]
    return costs[1] - costs[2] > max(settings.decisive, settings.better_fit * (costs[0] - costs[1]))


def find_alternatives(selection: SelectionProblem, tried: CandidateFits, current: Fitted
                      ) -> tuple[tuple[str, float, float], ...]:
    """Every other effect that the best does not beat in cross-validation, with the paired difference.

    One that fits far better than the best and predicts worse is not beaten either: of a model that is not all, left-out
    conditions alone may favour an effect for what else is missing. Nor is one that fits as well and predicts worse by
    no more than chance, however much that is: the others may not fix a parameter that a single condition does.
    """
    close, best = [], tried.refined[tried.order[0]]
    for effect in tried.order[1:]:
        other = tried.refined.get(effect)
        if other is None or other.solution is current.solution or is_beyond(selection, current, other):
            continue
        if not is_refuted(selection, other, best, current):
            close.append((effect, *compare_losses(other.loss, best.loss, selection.groups)))
    return tuple(close)


def is_refuted(selection: SelectionProblem, other: Fitted, best: Fitted, before: Fitted) -> bool:
    """Whether left-out conditions speak against another model than the best, beside that `before` the effect in which
    they differ; see `find_alternatives`.
    """
    limits, unit = selection.settings, selection.disperse(best)
    difference, error = compare_losses(other.loss, best.loss, selection.groups)
    beaten = (limits.is_significant if fits_as_well(other, best, limits) else limits.is_beaten)(
        difference / unit, error / unit)
    return beaten and not fits_better(other, best, before, limits)


def helps(selection: SelectionProblem, current: Fitted, grown: Fitted) -> bool:
    """Whether an addition predicts left-out conditions better, beyond chance."""
    if grown.solution is current.solution:
        return False
    limits, groups = selection.settings, selection.groups
    gain, error = compare_losses(current.loss, grown.loss, groups)
    ahead, doubt = compare_losses(current.forecast, grown.forecast, groups)
    if selection.family.free_running and ahead < -limits.standard_errors * doubt:
        return False
    by_group = np.array([(current.loss - grown.loss)[groups == g].sum() for g in np.unique(groups)])
    most = float(np.mean(by_group > 0)) >= limits.majority
    if gain <= limits.significant:
        return False
    unit = selection.disperse(grown)  # of differences, in noise variances
    return gain > limits.significant * unit and (gain > limits.standard_errors * error or most
                                                 or gain > limits.decisive * unit)


def is_outdone(selection: SelectionProblem, fitted: Fitted, other: Fitted) -> bool:
    """Whether another model predicts left-out conditions better, beyond chance, its further parameters counted."""
    _, error = compare_losses(fitted.loss, other.loss, selection.groups)
    return selection.settings.is_beaten(fitted.merit - other.merit, error)


def predicts_better(selection: SelectionProblem, current: Fitted, grown: Fitted) -> bool:
    """Whether an addition does not raise the cross-validated error; true where nothing can be left out.

    It may rise by next to nothing (`settings.same_error`) where the loss in noise variances falls beyond chance: of two
    channels the one with more noise for its signal weighs more in the error, and the other may tell all there is.
    """
    if not selection.holds_out:
        return True
    before, after = (selection.predict(one, adjust=True) for one in (current, grown))
    if after.nrmse <= before.nrmse:
        return True
    if not after.nrmse <= (1.0 + selection.settings.same_error) * before.nrmse:
        return False
    gain, error = compare_losses(before.loss, after.loss, selection.groups)
    unit = selection.disperse(grown)
    return selection.settings.is_significant(gain / unit, error / unit)


def pass_over(selection: SelectionProblem, current: Fitted, tried: CandidateFits) -> CandidateFits | None:
    """The same without the best candidate, which predicts left-out conditions worse although its linearised loss is the
    smallest; None where no other does anything."""
    rest = [e for e in tried.order[1:] if tried.screened[e].solution is not tried.before.solution]
    if not rest:
        return None
    refined = {effect: tried.refined[effect] for effect in rest if effect in tried.refined}
    refined = refined or refine(selection, current, tried.screened, tried.before, rest)
    first = sorted(refined, key=lambda effect: (is_beyond(selection, current, refined[effect]), refined[effect].merit))
    return dc.replace(tried, refined=refined, order=(*first, *(effect for effect in rest if effect not in refined)))


def skip_worse(selection: SelectionProblem, current: Fitted, tried: CandidateFits) -> CandidateFits | None:
    """The same without the best candidate, which predicts left-out conditions worse even when exchanged, and without
    those after it that do so by themselves: they are not worth the rounds of an exchange each. None where no other is
    left."""
    rest = pass_over(selection, current, tried)
    while rest is not None:
        best = rest.refined[rest.order[0]]
        if not helps(selection, current, best) or predicts_better(selection, current, best):
            return rest
        rest = pass_over(selection, current, rest)
    return None


def allow_scatter(path: Path, report: Progress = stay_silent) -> Path:
    """The same search with settings that scatter more than stated, where that explains the records.

    It does where the scatter is beyond doubt beside all effects that were found (which may only imitate it), leaves no
    misfit, and moves the settings at random: physics that moves them does so alike at like conditions.
    """
    if not path.steps[0].lack.rejected:
        return path
    found = path
    for _ in range(SETTLING):
        # Beside the effects found so far: without them the scatter would stand for these as well.
        last, selection = found.steps[-1].fitted, found.selection
        spread = selection.estimate_spread(last)
        ratios = [spread.get(n, 1.0) / selection.spread.get(n, 1.0) for n in {*spread, *selection.spread}]
        if not ratios or max(abs(np.log(ratios))) < np.log(selection.settings.spread.least):
            break
        report("allowing for settings that scatter more than stated", 0.87)
        selection = path.selection.loosen(spread)
        if not (_would_do(selection, last)
                and may_search("a search with settings that scatter more than stated")):
            break
        reference = selection.repeat(path.steps[0].fitted)
        found = select_effects(selection.span(reference.solution), reference,
                               nest_progress(report, "with settings that scatter more than stated", 0.87, 0.87))
    last = found.steps[-1]
    if not found.selection.spread or last.lack.rejected or not found.selection.is_scatter(last.fitted):
        return path
    return found


def _would_do(selection: SelectionProblem, fitted: Fitted) -> bool:
    """Whether a model leaves no misfit under another noise or scatter of the settings (that scatter fitted, too): else
    no search under these is worth its time."""
    again = selection.repeat(fitted, 1e-2)
    selection = selection.span(again.solution)
    if not selection.test_lack_of_fit(again)[0].rejected:
        return True
    spread = selection.estimate_spread(again)
    if not spread or spread == selection.spread:
        return False
    selection = selection.loosen(spread)
    again = selection.repeat(again, 1e-2)
    return not selection.span(again.solution).test_lack_of_fit(again)[0].rejected


def allow_wander(path: Path, report: Progress = stay_silent) -> Path:
    """The same search with baselines that wander, where these explain what misfit is left.

    They do where they are beyond doubt beside all effects that were found, leave no misfit, and nothing of what they
    stand for repeats over the records, as physics would. Records that run on from where they start share no phase that
    could repeat: there the baselines must not be smooth, as what a force adds to a motion is.
    """
    last, selection, running = path.steps[-1], path.selection, path.selection.family.free_running
    if not last.lack.rejected or not (running or selection.measure_repeats(last.fitted.solution) is not None):
        return path
    limits, wander = selection.settings, selection.settings.wander
    slow = find_slow_noise(selection.records, last.fitted.solution, selection.noise, wander)
    if slow.noise == selection.noise or (running and slow.roughness < -wander.smooth):
        return path
    report("allowing for baselines that wander", 0.875)
    wider = dc.replace(selection.restack(slow.noise), noise=slow.noise)
    if not (_would_do(wider, last.fitted) and may_search("a search with baselines that wander")):
        return path
    reference = wider.repeat(path.steps[0].fitted)
    found = allow_scatter(select_effects(wider.span(reference.solution), reference, nest_progress(
        report, "with baselines that wander", 0.875, 0.875)), report)
    last = found.steps[-1]
    if last.lack.rejected:
        return path
    if running:
        return dc.replace(found, ambiguous=slow.roughness < wander.worth)
    at = last.fitted.solution
    plain = selection.loosen(found.selection.spread).problem.solve(at.names, at.u, at.z, moving=False)
    chance = selection.measure_repeats(plain)
    level = limits.repeats if slow.roughness < wander.worth else limits.repeats_rough
    return found if chance is not None and chance > level else path


def free_chosen(selection: SelectionProblem, chosen: Fitted) -> SelectionProblem:
    """From here on the shapes that a chosen model has free are free in every fit that has the effect."""
    held = [name for effect in chosen.effects for name in selection.list_held(effect)]
    return selection.free([name for name in held if name in chosen.solution.names])


def exchange_effects(selection: SelectionProblem, chosen: Fitted, tried: CandidateFits, base: Fitted,
                     report: Progress = stay_silent) -> tuple[SelectionProblem, Fitted, CandidateFits, Fitted]:
    """Exchange each earlier effect for any other while that predicts left-out conditions better.

    The first of a pair is chosen while the second is still missing, and may be a third effect that mimics both.
    """
    for _ in range(2):
        before = chosen
        for place in range(len(chosen.effects) - 1):
            if not may_search(f"exchanges of {chosen.effects[place]} for another effect"):
                break
            start = _drop(selection, chosen, chosen.effects[place])
            if start is None:
                continue
            _, scores = selection.test_lack_of_fit(start)
            again = try_effects(selection, start, scores, report)
            best = again.refined[again.order[0]]
            fewer = len(best.solution.names) < len(chosen.solution.names)
            least = selection.settings.tie if fewer else selection.settings.significant
            within = (is_beyond(selection, base, chosen), is_beyond(selection, start, best))
            if (within == (True, False) and helps(selection, start, best)) or (
                    within != (False, True) and best.merit < chosen.merit - least):
                chosen, tried, base = best, again, start
                selection = free_chosen(selection, chosen)
        if chosen is before:
            break
    return selection, chosen, tried, base


def _drop(selection: SelectionProblem, fitted: Fitted, effect: str) -> Fitted | None:
    """The model fitted without an effect, from where it was."""
    u, own = fitted.solution.u.copy(), [slot.owner == effect for slot in selection.space.slots]
    u[own] = selection.start[own]
    return selection.extend(fitted, tuple(e for e in fitted.effects if e != effect), u)


def prune(selection: SelectionProblem, step: FittedStep) -> tuple[SelectionProblem, FittedStep]:
    """Take back what a later addition has made needless: freed shapes first, then effects."""
    fitted = step.fitted
    for name in [n for n in selection.freed if n.split(".")[0] in fitted.effects]:
        start, held = fitted.solution.u.copy(), selection.hold(name)
        start[selection.space.index[name]] = selection.start[selection.space.index[name]]
        simpler = held.extend(fitted, fitted.effects, start)
        if simpler is not None and simpler.merit < fitted.merit:
            selection, fitted = held, simpler
    for effect in fitted.effects[:-1]:
        simpler = _drop(selection, fitted, effect)
        if simpler is not None and simpler.merit < fitted.merit:
            fitted = simpler
    if len(fitted.effects) > 1:
        # The last one helps beyond the fit without it, which may have stopped short: from here it may go on.
        rest = _drop(selection, fitted, fitted.effects[-1])
        if rest is not None and rest.score < fitted.score + selection.settings.significant:
            fitted = rest
    return (selection, step) if fitted is step.fitted else (selection, step.refit(selection, fitted))


@dc.dataclass(frozen=True)
class Unphysical:
    """An estimate whose 95 % interval lies wholly beyond what physics allows."""

    name: str  # of the parameter, `effect-id.symbol`
    estimate: float
    low: float  # of the interval
    high: float
    unit: str
    limits: tuple[float, float]  # what physics allows, in the same unit, and why
    reason: str

    def __str__(self) -> str:
        low, high = self.limits
        allowed = (f"{low:.4g} at least" if high == float("inf") else f"{high:.4g} at most" if low == -float("inf")
                   else f"{low:.4g} to {high:.4g}")
        value = f"{self.estimate:.3g} {self.unit}".rstrip()
        return f"{self.name} = {value}, where physics allows {allowed} ({self.reason})"


def list_unphysical(selection: SelectionProblem, solution: Solution) -> tuple[Unphysical, ...]:
    """Free parameters of a fit whose 95 % interval lies wholly beyond their physical limits, or that ended beyond them
    where the fit could go no further."""
    sd = np.sqrt(np.maximum(np.diag(solution.covariance()), 0.0))
    (least, most), found = selection.problem.limits, []
    for name, width in zip(solution.names, sd, strict=True):
        p, value = selection.space.parameter(name), selection.space.public(name, solution.u, float(width))
        k = selection.space.index[name]
        slack = AT_BOUND * selection.problem.scales[k]
        stuck = not least[k] + slack < solution.u[k] < most[k] - slack
        if p.excludes(value["q025"], value["q975"]) or (stuck and p.excludes(value["estimate"], value["estimate"])):
            found.append(Unphysical(name, value["estimate"], value["q025"], value["q975"], value["unit"], p.limits,
                                    p.limits_reason))
    return tuple(found)
