"""Steps and candidates as plain records: errors, parameters, correlations, what each effect explains."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from .._numerics import map_threads
from ..inference import distributions as stats
from ..inference.bounded import Bounded
from ..inference.findings import Fit, estimate_parameters, summarise_fit
from ..inference.goodness import doubt_level
from ..inference.identifiability import analyse_fit, analyse_with_refits, limit_knowledge, list_unproven
from ..inference.interval_width import widen_intervals
from ..inference.noise import Noise
from ..inference.problem import Solution
from .cross_validation import compare_losses
from .detectability import LEAST, detectable_length, find_size
from .forward_selection import CandidateFits, FittedStep, fit_with_shapes, list_unphysical
from .lack_of_fit import Score, correct_for_many, hold_settings, is_moved, measure_shifts
from .problem import Fitted, SelectionProblem
from .result import Candidate, Estimate, SettingSpread, Step
from .series import make_traces, measure_ratio, nrmse


WIDEST = 10.0  # standard deviations that are told, in those beyond which nothing is known
FAINT = 0.1  # correlation of two estimates below which it is not listed: it tells nothing
ALIKE = 0.5  # |cosine| of two signatures below which it is not listed: a third of their variance in common, or less


def list_loose(selection: SelectionProblem, solution: Solution) -> tuple[str, ...]:
    """Names of free parameters that the records do not fix."""
    sd = np.sqrt(np.maximum(np.diag(solution.covariance()), 0.0))
    unproven = list_unproven(selection.problem, solution)
    return tuple(name for name, width in zip(solution.names, sd, strict=True)
                 if width > limit_knowledge(selection.space, name) or name in unproven)


def public_estimates(selection: SelectionProblem, solution: Solution, owner: str | None = None) -> dict[str, Estimate]:
    """Estimates of the free parameters (of one owner) in their public units, by the rule of `fit`.

    What the records do not determine has a deviation of `WIDEST` times that beyond which nothing is known.
    """
    space, whole, found = selection.space, Bounded(solution, solution.names, {}, {}), {}
    # Refits only for the model, not for every candidate beside it: an effect's own parameters need none.
    known = analyse_with_refits(selection.problem, solution) if owner is None else analyse_fit(space, solution)
    if owner is None:
        known = known.widen(widen_intervals(selection.problem, solution, selection.noise, bool(selection.spread),
                                            selection.settings.scatter).factors, solution.names)
    for name, one in estimate_parameters(selection.problem, whole, known, selection.guess)[0].items():
        slot = space.slots[space.index[name]]
        if owner not in (None, slot.owner):
            continue
        values = {"estimate": one.estimate, "sd": one.sd, "q025": one.q025, "q975": one.q975, "unit": one.unit}
        if not one.determined:
            values = space.public(name, solution.u, WIDEST * limit_knowledge(space, name))
        found[name] = Estimate(**values, text=slot.parameter.text, determined=one.determined)
    return found


def make_fit(selection: SelectionProblem, fitted: Fitted, model: str, verdict: str) -> Fit:
    """A model of the selection as `fit` returns one."""
    solution = fitted.solution
    return summarise_fit(
        selection.campaign, model, fitted.effects, selection.problem, Bounded(solution, solution.names, {}, {}),
        selection.guess, selection.noise, {"made_by": "discover", "verdict": verdict}, True, selection.warnings,
        scattered=bool(selection.spread), scatter=selection.settings.scatter)


def describe_step(selection: SelectionProblem, grown: FittedStep, before: FittedStep | None) -> Step:
    """The record of one step."""
    fitted, solution = grown.fitted, grown.fitted.solution
    traces = make_traces(selection.campaign, selection.records, solution, selection.noise)
    shifts = measure_shifts(selection.records, solution, selection.spread, selection.campaign)
    added = None
    if before is not None:
        added = next((e for e in fitted.effects if e not in before.fitted.effects), fitted.effects[-1])
    alternatives = tuple({"effect": e, "heldout_difference": d, "standard_error": s} for e, d, s in grown.alternatives)
    covariance, names = solution.covariance(), solution.names
    sd = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    pairs = [(names[i], names[j], float(covariance[i, j] / (sd[i] * sd[j])))
             for i, j in zip(*np.triu_indices(len(names), 1), strict=True)]
    correlations = sorted((p for p in pairs if abs(p[2]) >= FAINT), key=lambda p: -abs(p[2]))
    predicted = selection.predict(fitted)
    moved = is_moved(shifts, selection.settings.level_each)
    held = measure_held(selection, solution, selection.noise) if moved else None
    return Step(
        added=added, effects=fitted.effects,
        chi2_reduced=selection.reduce_chi2(solution), nrmse=nrmse(traces),
        heldout_nrmse=selection.cross_validate(fitted), alternatives=alternatives,
        lack_of_fit=grown.lack, parameters=public_estimates(selection, solution),
        correlations=tuple(correlations), traces=traces, converged=solution.converged, shifts=shifts,
        held_nrmse=held and held.nrmse, held_ratio=held and held.ratio,
        prediction_nrmse=predicted.nrmse, prediction_coverage=predicted.coverage)


class Held(NamedTuple):
    """Errors of a model refitted with every condition as it is written down: rms over rms signal, and over noise."""

    nrmse: float
    ratio: float


def measure_held(selection: SelectionProblem, solution: Solution, noise: Mapping[str, Noise]) -> Held:
    """Refit a model with every condition as it is written down; its errors, beside that noise."""
    held = hold_settings(selection.problem, solution)
    traces = make_traces(selection.campaign, selection.records, held, noise)
    return Held(nrmse(traces), measure_ratio(traces))


def describe_noise(selection: SelectionProblem) -> dict[str, dict[str, Any]]:
    """What is known about the noise of every channel."""
    return {channel: {"stated_sd": n.stated_sd, "sd": n.sd, "correlation": n.correlation,
                      "white_share": n.white_share, "floor": n.floor, "share": n.share, "rate_share": n.rate_share,
                      "varies": bool(n.sizes) and not selection.records.are_values, "slow_sd": n.slow_sd,
                      "slow_time": n.slow_time if n.slow_sd else None,
                      "hum": [{"frequency": frequency, "rms": sd} for frequency, sd in n.hum],
                      "text": n.text} for channel, n in selection.noise.items()}


def describe_spread(selection: SelectionProblem) -> tuple[SettingSpread, ...]:
    """Settings that scatter more than stated, and how much."""
    deviations, found = np.asarray(selection.records.stack.condition_sd)[: selection.records.count], []
    for name, ratio in selection.spread.items():
        relative, typical = name in selection.campaign.records, 1.0
        if relative:
            typical = np.maximum(np.abs(selection.campaign.records[name].to_numpy(dtype=float)), 1e-300)
        size = float(np.median(deviations[:, selection.records.nuisances.index(name)] / typical))
        found.append(SettingSpread(name, size / ratio, size, ratio, relative))
    return tuple(found)


def describe_candidates(selection: SelectionProblem, grown: Sequence[FittedStep], tried: CandidateFits
                        ) -> list[Candidate]:
    """All effects of the catalogue, best first, each alone beside the reference model and fitted to the end.

    Where records are long, those that never came near the best are fitted to thinned ones, and compared on these.
    """
    reference, scores, rejected = grown[0].fitted, grown[0].scores, grown[0].lack.rejected
    before = tried.before
    if not rejected:  # nothing is missing, and nothing hangs on what is left to gain
        fits = {effect: selection.refit_far_off(fitted) for effect, fitted in tried.screened.items()}
    else:
        thinned = None if selection.thin is None else selection.extend(reference, (), thinned=True)
        before = thinned or reference
        fits = dict(map_threads(lambda e: (e, _finish(selection, grown, tried, before, e)), tried.order))
    best = min(fits.values(), key=lambda f: (f.thinned, f.merit))
    rivals: dict[bool, Fitted | None] = {best.thinned: best}
    if any(f.thinned != best.thinned for f in fits.values()):
        rivals[True] = selection.extend(best, best.effects, thinned=True)
    sizes: dict[str, dict[str, float]] = {}
    # What is not known of the model may imitate anything, however far from where it stands.
    if not list_loose(selection, reference.solution):
        sizes = dict(zip(tried.order, map_threads(
            lambda e: _list_detectable(selection, reference, [s for s in scores if s.effect == e], len(scores)),
            tried.order), strict=True))
    confused = set()
    if len(grown) > 1 and grown[1].tried is tried:
        confused = {grown[1].fitted.effects[0], *(e for e, _, _ in grown[1].alternatives)}

    def describe(effect: str) -> Candidate:
        fitted, own = fits[effect], [s for s in scores if s.effect == effect]
        alone = before if fitted.thinned == before.thinned else reference
        absent = fitted.solution is alone.solution
        shown = alone if absent else fitted
        free, used = len(alone.solution.names), float((np.abs(alone.solution.residual) > 0).sum())
        drop = max(alone.solution.chi2 - fitted.solution.chi2, 0.0)
        excess = max(alone.solution.chi2 - (used - free), 1.0)
        scale = max(selection.samples / max(used, 1.0), 1.0) if alone.thinned else 1.0
        widen = 1.0 + 2.0 * doubt_level(selection.noise)
        single = float(stats.chi2.sf(drop * scale / widen, max(len(fitted.solution.names) - free, 1)))
        difference, error = compare_losses(fitted.loss, (rivals[fitted.thinned] or fitted).loss, selection.groups)
        cosines = _list_cosines(own, scores, effect)
        alike = [e for e, c in cosines.items() if c > selection.settings.collinear]
        if effect in confused:
            alike = [e for e in tried.order if e in confused and e != effect]
        beyond = () if absent else list_unphysical(selection, fitted.solution)
        predicted, detectable = selection.predict(shown), sizes.get(effect, {})
        return Candidate(
            effect=effect, p_value=correct_for_many(single, len(tried.order)),
            explains=float(np.clip(drop / excess, 0.0, 1.0)) if rejected else 0.0,  # without a misfit there is no share
            visible=float(max((s.visible for s in own), default=0.0)), heldout_nrmse=selection.cross_validate(shown),
            smallest_detectable=detectable, indistinguishable_from=tuple(alike),
            estimates={} if absent else public_estimates(selection, fitted.solution, effect),
            heldout_difference=difference, standard_error=error, cosines=cosines,
            text="its best amplitude has the wrong sign, or has no effect" if absent else "; ".join(map(str, beyond)),
            units={name: selection.space.unit(name, alone.solution.u) for name in detectable},
            beyond=tuple(one.name for one in beyond), prediction_nrmse=predicted.nrmse,
            prediction_coverage=predicted.coverage)

    # The effects of the final model lead, in the order in which they were found.
    final, place = list(grown[-1].fitted.effects), {e: k for k, e in enumerate(tried.order)}
    return map_threads(describe, sorted(tried.order, key=lambda e: (
        final.index(e) if e in final else len(final),
        *((fits[e].thinned, fits[e].merit, fits[e].solution.chi2) if rejected else ()), place[e])))


def _finish(selection: SelectionProblem, grown: Sequence[FittedStep], tried: CandidateFits, before: Fitted, effect: str
            ) -> Fitted:
    """An effect alone beside the reference model, fitted to the end; `before` is that model on thinned records."""
    known = next((step.fitted for step in grown if step.fitted.effects == (effect,)), None)
    if known is not None:
        return known
    full = effect in tried.refined
    rough, start = (tried.refined[effect], grown[0].fitted) if full else (tried.screened[effect], before)
    absent = rough.solution is tried.before.solution or set(rough.solution.names) == set(start.solution.names)
    return fit_with_shapes(selection, None if absent else rough, start, effect, thinned=not full)


def _list_detectable(selection: SelectionProblem, reference: Fitted, own: list[Score], count: int) -> dict[str, float]:
    """Smallest value of every amplitude of an effect that would have been found, by public name.

    None is given where no value that physics allows would have been. The model is computed at that value: the score
    alone is the slope at the null, which may be that of a place where nothing else holds.
    """
    goal, found, space = detectable_length(count, selection.settings), {}, selection.space
    # Of every amplitude at the shape that shows most.
    best = {s.name: s for s in sorted(own, key=lambda s: s.information) if s.information > 0}
    for name, s in best.items():
        origin = reference.solution.u.copy()
        for shape, value in s.shapes.items():
            origin[space.index[shape]] = value
        one = find_size(selection.problem, reference.solution, origin, name, goal, goal / float(np.sqrt(s.information)))
        p = space.parameter(name)
        # What shows at any size (a patch that grips a sample at no slip, however weakly) has no smallest one.
        if one is not None and np.isfinite(one.size) and abs(one.size - p.default) > 10.0 * LEAST * p.typical:
            found[name] = p.transform.from_unconstrained(one.size)
    return found


def _list_cosines(own: list[Score], scores: list[Score], effect: str) -> dict[str, float]:
    """|cos| of projected signatures with every other effect, the largest over shapes, where above `ALIKE`."""
    found: dict[str, float] = {}
    for s in own:
        for t in scores:
            c = abs(float(s.cosines[t.place]))
            if t.effect != effect and not t.effect.startswith("probe-") and c > max(ALIKE, found.get(t.effect, 0.0)):
                found[t.effect] = min(c, 1.0)
    return dict(sorted(found.items(), key=lambda item: -item[1]))
