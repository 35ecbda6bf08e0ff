"""Steps and candidates as plain records: errors, parameters, correlations, what each effect explains."""

import dataclasses as dc
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy import stats

from .._numerics import map_threads
from ..inference.bounded import Bounded
from ..inference.findings import Fit, estimate_parameters, summarise_fit
from ..inference.identifiability import analyse_fit, limit_knowledge
from ..inference.problem import Solution
from .cross_validation import compare_losses
from .detectability import detectable_length, find_size
from .forward_selection import CandidateFits, FittedStep, fit_with_shapes, list_unphysical
from .lack_of_fit import Score, hold_settings, is_moved, measure_shifts
from .problem import Fitted, SelectionProblem
from .result import Candidate, Estimate, Step
from .series import make_traces, measure_error, nrmse


WIDEST = 10.0  # standard deviations that are told, in those beyond which nothing is known


def list_loose(selection: SelectionProblem, solution: Solution) -> tuple[str, ...]:
    """Names of free parameters that the records do not fix."""
    sd = np.sqrt(np.maximum(np.diag(solution.covariance()), 0.0))
    return tuple(name for name, width in zip(solution.names, sd, strict=True)
                 if width > limit_knowledge(selection.space, name))


def public_estimates(selection: SelectionProblem, solution: Solution, owners: Sequence[str | None] | None = None
                     ) -> dict[str, Estimate]:
    """Estimates of the free parameters in their public units, by the rule of `fit` (`estimate_parameters`).

    What the records do not determine has a deviation of `WIDEST` times that beyond which nothing is known.
    """
    space = selection.space
    known = analyse_fit(space, solution)
    whole = Bounded(solution, solution.names, {}, {})
    found = {}
    for name, one in estimate_parameters(selection.problem, whole, known, selection.guess)[0].items():
        slot = space.slots[space.index[name]]
        if owners is not None and slot.owner not in owners:
            continue
        if one.determined:
            found[name] = Estimate(one.estimate, one.sd, one.q025, one.q975, one.unit, slot.parameter.text)
        else:
            values = space.public(name, solution.u, WIDEST * limit_knowledge(space, name))
            found[name] = Estimate(**values, text=slot.parameter.text)
    return found


def make_fit(selection: SelectionProblem, fitted: Fitted, model: str, verdict: str = "") -> Fit:
    """A model of the selection as `fit` returns one."""
    solution = fitted.solution
    return summarise_fit(
        selection.campaign, model, fitted.effects, selection.problem, Bounded(solution, solution.names, {}, {}),
        selection.guess, selection.noise, {"made_by": "discover", "verdict": verdict}, True, selection.warnings)


def strongest_correlations(solution: Solution, least: float = 0.1) -> tuple[tuple[str, str, float], ...]:
    """Correlations of the free parameters by size."""
    covariance = solution.covariance()
    sd = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    pairs = [(a, b, float(covariance[i, j] / (sd[i] * sd[j])))
             for i, a in enumerate(solution.names) for j, b in enumerate(solution.names) if i < j]
    return tuple(sorted((p for p in pairs if abs(p[2]) >= least), key=lambda p: -abs(p[2])))


def describe_step(selection: SelectionProblem, grown: FittedStep, before: FittedStep | None) -> Step:
    """The record of one step."""
    fitted, solution = grown.fitted, grown.fitted.solution
    traces = make_traces(selection.campaign, selection.records, solution, selection.noise)
    rows = float((np.asarray(selection.records.stack.weights) > 0).sum())
    shifts = measure_shifts(selection.records, solution)
    held = None
    if is_moved(shifts, selection.settings.level_each):
        there = hold_settings(selection.problem, solution)
        held = measure_error(selection.records, there.channels)
    added = None
    if before is not None:
        added = next((e for e in fitted.effects if e not in before.fitted.effects), fitted.effects[-1])
    alternatives = tuple({"effect": e, "heldout_difference": d, "standard_error": s}
                         for e, d, s in grown.alternatives)
    predicted = selection.predict(fitted)
    return Step(
        added=added, effects=fitted.effects, chi2_reduced=solution.chi2 / max(rows - len(solution.names), 1.0),
        nrmse=nrmse(traces), heldout_nrmse=selection.cross_validate(fitted), alternatives=alternatives,
        lack_of_fit=grown.lack, parameters=public_estimates(selection, solution),
        correlations=strongest_correlations(solution), traces=traces, converged=solution.converged,
        shifts=shifts, held_nrmse=held, prediction_nrmse=predicted.nrmse, prediction_coverage=predicted.coverage)


def describe_noise(selection: SelectionProblem) -> dict[str, dict[str, Any]]:
    """What is known about the noise of every channel."""
    return {channel: {"stated_sd": n.stated_sd, "sd": n.sd, "correlation": n.correlation,
                      "white_share": n.white_share, "text": n.text} for channel, n in selection.noise.items()}


def describe_candidates(selection: SelectionProblem, grown: Sequence[FittedStep], tried: CandidateFits
                        ) -> list[Candidate]:
    """All effects of the catalogue, best first, each alone beside the reference model and fitted to the end."""
    finished = _Finished(selection, grown, tried)
    scores = grown[0].scores
    first = grown[1] if len(grown) > 1 else None
    chosen = first.fitted.effects[0] if first is not None and first.tried is tried else None
    alternatives = {e for e, _, _ in first.alternatives} if first is not None and chosen is not None else set()
    # The effects of the final model lead, in the order in which they were found.
    final = list(grown[-1].fitted.effects) if len(grown) > 1 else []
    place = {e: k for k, e in enumerate(tried.order)}
    rejected = grown[0].lack.rejected
    order = sorted(tried.order, key=lambda e: (final.index(e) if e in final else len(final), *(
        (finished.fits[e].thinned, finished.fits[e].merit, finished.fits[e].solution.chi2) if rejected else ()),
        place[e]))
    sizes: dict[str, dict[str, float]] = {}
    # What is not known of the model may imitate anything, however far from where it stands.
    if not list_loose(selection, grown[0].fitted.solution):
        found = map_threads(lambda e: _detectable(selection, grown[0].fitted, [s for s in scores if s.effect == e],
                                                    len(scores)), order)
        sizes = dict(zip(order, found, strict=True))
    return [_describe(selection, finished, tried, scores, e, chosen, alternatives, rejected, sizes.get(e, {}))
            for e in order]


class _Finished:
    """Every effect alone beside the reference model, fitted to the end.

    Where records are long, those that never came near the best are fitted to thinned ones; `before` is the reference
    model on the same samples.
    """

    def __init__(self, selection: SelectionProblem, grown: Sequence[FittedStep], tried: CandidateFits):
        self.reference = before = grown[0].fitted
        self.fits: dict[str, Fitted] = {}
        self.best: Fitted | None = None
        if not grown[0].lack.rejected:
            # Nothing is missing, and nothing hangs on what is left to gain.
            self.fits, self.before = dict(tried.screened), tried.before
            return
        steps = {g.fitted.effects: g.fitted for g in grown}
        again = None
        if selection.thin is not None:
            again = selection.fit((), [{}], before.solution.u, before.solution.z, thinned=True)
        self.before = before if again is None else again

        def one(effect):
            if (effect,) in steps:
                return effect, steps[effect,]
            full = effect in tried.refined
            rough = tried.refined[effect] if full else tried.screened[effect]
            start = before if full else self.before
            if rough.solution is tried.before.solution or set(rough.solution.names) == set(before.solution.names):
                return effect, dc.replace(start, effects=(effect,))
            found = fit_with_shapes(selection, rough, effect, thinned=not full)
            if found is None or found.solution.chi2 > start.solution.chi2:
                found = dc.replace(start, effects=(effect,))
            return effect, found

        self.fits = dict(map_threads(one, tried.order))

    def before_of(self, fitted: Fitted) -> Fitted:
        """The reference model on the samples of a fit."""
        return self.before if fitted.thinned == self.before.thinned else self.reference

    def best_beside(self, selection: SelectionProblem, fitted: Fitted) -> Fitted:
        """The effect that predicts best, on the samples of a fit."""
        best = min(self.fits.values(), key=lambda f: (f.thinned, f.merit))
        if fitted.thinned == best.thinned:
            return best
        if self.best is None:
            self.best = selection.fit(best.effects, [{}], best.solution.u, best.solution.z, thinned=True)
        return self.best or fitted


def _describe(selection: SelectionProblem, finished: _Finished, tried: CandidateFits, scores: list[Score], effect: str,
              chosen: str | None, alternatives: set[str], rejected: bool, detectable: dict[str, float]) -> Candidate:
    fitted = finished.fits[effect]
    before = finished.before_of(fitted)
    absent = fitted.solution is before.solution
    rows = float((np.abs(before.solution.residual) > 0).sum()) - len(before.solution.names)
    excess = max(before.solution.chi2 - rows, 1.0)
    drop = max(before.solution.chi2 - fitted.solution.chi2, 0.0)
    own = [s for s in scores if s.effect == effect]
    extra = max(len(fitted.solution.names) - len(before.solution.names), 1)
    scale = float((np.asarray(selection.records.stack.weights) > 0).sum()) / max(
        float((before.solution.residual != 0).sum()), 1.0) if before.thinned else 1.0
    widen = 1.0 + 2.0 * max(n.log_level_sd for n in selection.noise.values())
    single = float(stats.chi2.sf(drop * max(scale, 1.0) / widen, extra))
    p_value = float(-np.expm1(len(tried.order) * np.log1p(-min(single, 1 - 1e-16))))
    difference, error = compare_losses(fitted.loss, finished.best_beside(selection, fitted).loss, selection.groups)
    cosines = _cosines(own, scores, effect)
    if effect == chosen:
        alike = tuple(e for e in tried.order if e in alternatives)
    elif effect in alternatives:
        alike = tuple(e for e in tried.order if (e in alternatives or e == chosen) and e != effect)
    else:
        alike = tuple(e for e, c in cosines.items() if c > selection.settings.collinear)
    beyond = () if absent else list_unphysical(selection, fitted.solution)
    predicted = selection.predict(before if absent else fitted)
    return Candidate(
        effect=effect, p_value=p_value,
        explains=float(np.clip(drop / excess, 0.0, 1.0)) if rejected else 0.0,  # without a misfit there is no share
        visible=float(max((s.visible for s in own), default=0.0)),
        heldout_nrmse=selection.cross_validate(before if absent else fitted),
        smallest_detectable=detectable,
        indistinguishable_from=alike,
        estimates={} if absent else public_estimates(selection, fitted.solution, [effect]),
        heldout_difference=difference, standard_error=error, cosines=cosines,
        text="its best amplitude has the wrong sign, or does nothing" if absent else "; ".join(map(str, beyond)),
        beyond=tuple(one.name for one in beyond),
        prediction_nrmse=predicted.nrmse, prediction_coverage=predicted.coverage,
        units={name: selection.space.unit(name, before.solution.u) for name in detectable})


def _detectable(selection: SelectionProblem, reference: Fitted, own: list[Score], count: int) -> dict[str, float]:
    """Smallest value of every amplitude of an effect that would have been found, by public name.

    None is given where no value that physics allows would have been. The model is computed at that value: the score
    alone is the slope at the null, which may be that of a place where nothing else holds.
    """
    goal, best, found = detectable_length(count, selection.settings), {}, {}
    for s in sorted(own, key=lambda s: s.information):
        if s.information > 0:
            best[s.name] = s  # at the shape that shows most
    for name, s in best.items():
        p = selection.space.slots[selection.space.index[name]].parameter
        origin = reference.solution.u.copy()
        for shape, value in s.shapes.items():
            origin[selection.space.index[shape]] = value
        one = find_size(selection.problem, reference.solution, origin, name, goal,
                        goal / float(np.sqrt(s.information)))
        if one is not None and np.isfinite(one.size):
            found[name] = p.transform.from_unconstrained(one.size)
    return found


def _cosines(own: list[Score], scores: list[Score], effect: str) -> dict[str, float]:
    """|cos| of projected signatures with every other effect, the largest over shapes, where above 0.5."""
    found: dict[str, float] = {}
    for s in own:
        for t in scores:
            if t.effect != effect and not t.effect.startswith("probe-"):
                c = abs(float(s.cosines[t.place]))
                if c > max(0.5, found.get(t.effect, 0.0)):
                    found[t.effect] = min(c, 1.0)
    return dict(sorted(found.items(), key=lambda item: -item[1]))
