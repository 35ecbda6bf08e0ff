"""The catalogue as it stood at the first step: what each effect explains, and what this campaign can see of it."""

import dataclasses as dc

import numpy as np
from scipy import stats

from .adequacy import Score
from .holdout import compare_losses
from .records import Candidate
from .search import Grown, Tried, fit_with_shapes, merit
from .steps import public_estimates
from .workbench import Fitted, Workbench


SEEN = 4.5  # an amplitude of so many standard errors would be found
ALIKE = 0.97


def could_have_shown(workbench: Workbench, scores: list[Score]) -> bool:
    """Whether any effect whose own signature is three times the noise would have been found."""
    samples = float((np.asarray(workbench.records.stack.weights) > 0).sum())
    catalogued = {e.id for e in workbench.catalogue}
    return any(9.0 * samples * s.visible > SEEN**2 for s in scores if s.effect in catalogued)


def describe_candidates(workbench: Workbench, grown: list[Grown], tried: Tried) -> list[Candidate]:
    """All effects of the catalogue, best first, each alone beside the reference model and fitted to the end."""
    finished = _Finished(workbench, grown, tried)
    scores = grown[0].scores
    first = grown[1] if len(grown) > 1 else None
    chosen = first.fitted.effects[0] if first is not None and first.tried is tried else None
    alternatives = {e for e, _, _ in first.alternatives} if first is not None and chosen is not None else set()
    # The effects of the final model lead, in the order in which they were found.
    final = list(grown[-1].fitted.effects) if len(grown) > 1 else []
    place = {e: k for k, e in enumerate(tried.order)}
    rejected = grown[0].lack.rejected
    order = sorted(tried.order, key=lambda e: (final.index(e) if e in final else len(final), *(
        (finished.fits[e].thinned, merit(finished.fits[e]), finished.fits[e].solution.chi2) if rejected else ()),
        place[e]))
    return [_describe(workbench, finished, tried, scores, e, chosen, alternatives, rejected) for e in order]


class _Finished:
    """Every effect alone beside the reference model, fitted to the end.

    Where records are long, those that never came near the best are fitted to thinned ones; `before` is the reference
    model on the same samples.
    """

    def __init__(self, workbench: Workbench, grown: list[Grown], tried: Tried):
        self.reference = before = grown[0].fitted
        self.fits: dict[str, Fitted] = {}
        self.best: Fitted | None = None
        if not grown[0].lack.rejected:
            # Nothing is missing, and nothing hangs on what is left to gain.
            self.fits, self.before = dict(tried.screened), tried.before
            return
        steps = {g.fitted.effects: g.fitted for g in grown}
        again = None
        if workbench.thin is not None:
            again = workbench.fit((), [{}], before.solution.u, before.solution.z, thinned=True)
        self.before = before if again is None else again

        def one(effect):
            if (effect,) in steps:
                return effect, steps[effect,]
            full = effect in tried.refined
            rough = tried.refined[effect] if full else tried.screened[effect]
            start = before if full else self.before
            if rough.solution is tried.before.solution or set(rough.solution.names) == set(before.solution.names):
                return effect, dc.replace(start, effects=(effect,))
            found = fit_with_shapes(workbench, rough, effect, thinned=not full)
            if found is None or found.solution.chi2 > start.solution.chi2:
                found = dc.replace(start, effects=(effect,))
            return effect, found

        self.fits = dict(workbench.map(one, tried.order))

    def before_of(self, fitted: Fitted) -> Fitted:
        """The reference model on the samples of a fit."""
        return self.before if fitted.thinned == self.before.thinned else self.reference

    def best_beside(self, workbench: Workbench, fitted: Fitted) -> Fitted:
        """The effect that predicts best, on the samples of a fit."""
        best = min(self.fits.values(), key=lambda f: (f.thinned, merit(f)))
        if fitted.thinned == best.thinned:
            return best
        if self.best is None:
            self.best = workbench.fit(best.effects, [{}], best.solution.u, best.solution.z, thinned=True)
        return self.best or fitted


def _describe(workbench: Workbench, finished: _Finished, tried: Tried, scores: list[Score], effect: str,
              chosen: str | None, alternatives: set[str], rejected: bool) -> Candidate:
    fitted = finished.fits[effect]
    before = finished.before_of(fitted)
    absent = fitted.solution is before.solution
    rows = float((np.abs(before.solution.residual) > 0).sum()) - len(before.solution.names)
    excess = max(before.solution.chi2 - rows, 1.0)
    drop = max(before.solution.chi2 - fitted.solution.chi2, 0.0)
    own = [s for s in scores if s.effect == effect]
    extra = max(len(fitted.solution.names) - len(before.solution.names), 1)
    scale = float((np.asarray(workbench.records.stack.weights) > 0).sum()) / max(
        float((before.solution.residual != 0).sum()), 1.0) if before.thinned else 1.0
    widen = 1.0 + 2.0 * max(n.log_level_sd for n in workbench.noise.values())
    single = float(stats.chi2.sf(drop * max(scale, 1.0) / widen, extra))
    p_value = float(-np.expm1(len(tried.order) * np.log1p(-min(single, 1 - 1e-16))))
    difference, error = compare_losses(fitted.loss, finished.best_beside(workbench, fitted).loss, workbench.groups)
    cosines = _cosines(own, scores, effect)
    if effect == chosen:
        alike = tuple(e for e in tried.order if e in alternatives)
    elif effect in alternatives:
        alike = tuple(e for e in tried.order if (e in alternatives or e == chosen) and e != effect)
    else:
        alike = tuple(e for e, c in cosines.items() if c > ALIKE)
    detectable = _detectable(workbench, own)
    return Candidate(
        effect=effect, p_value=p_value,
        explains=float(np.clip(drop / excess, 0.0, 1.0)) if rejected else 0.0,  # without a misfit there is no share
        visible=float(max((s.visible for s in own), default=0.0)),
        heldout_nrmse=workbench.measure_left_out(before if absent else fitted),
        smallest_detectable=detectable,
        indistinguishable_from=alike,
        estimates={} if absent else public_estimates(workbench, fitted.solution, [effect]),
        heldout_difference=difference, standard_error=error, cosines=cosines,
        text="its best amplitude has the wrong sign, or does nothing" if absent else "",
        units={name: workbench.space.slots[workbench.space.index[name]].parameter.unit for name in detectable})


def _detectable(workbench: Workbench, own: list[Score]) -> dict[str, float]:
    """Smallest amplitude that would have been found, as a deviation from its null, by public name."""
    found: dict[str, float] = {}
    for s in own:
        if s.information <= 0:
            continue
        p = workbench.space.slots[workbench.space.index[s.name]].parameter
        size = SEEN / np.sqrt(s.information)
        value = float(1.0 / size if p.coordinate == "inverse" else size)
        keep = max if p.coordinate == "inverse" else min
        found[s.name] = keep(found.get(s.name, value), value)
    return found


def _cosines(own: list[Score], scores: list[Score], effect: str) -> dict[str, float]:
    """|cos| of projected signatures with every other effect, the largest over shapes, where above 0.5."""
    found: dict[str, float] = {}
    for s in own:
        for t in scores:
            if t.effect != effect and not t.effect.startswith("probe-"):
                c = abs(float(np.sum(s.column * t.column)))
                if c > max(0.5, found.get(t.effect, 0.0)):
                    found[t.effect] = min(c, 1.0)
    return dict(sorted(found.items(), key=lambda item: -item[1]))
