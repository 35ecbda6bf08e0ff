"""The catalogue as it stood at the first step: what each effect explains, and what this campaign can see of it."""

import dataclasses as dc

import numpy as np
from scipy import stats

from .._numerics import map_threads
from ..inference.parameters import to_public
from .adequacy import Score
from .detectability import detectable_length, find_size
from .holdout import compare_losses
from .limits import list_unphysical
from .records import Candidate
from .search import Grown, Tried, fit_with_shapes
from .steps import list_loose, public_estimates
from .workbench import Fitted, Workbench


def could_have_shown(workbench: Workbench, scores: list[Score]) -> bool:
    """Whether any effect whose own signature is three times the noise would have been found."""
    samples = float((np.asarray(workbench.records.stack.weights) > 0).sum())
    catalogued = {e.id for e in workbench.catalogue}
    return any(9.0 * samples * s.visible > workbench.settings.shown**2 for s in scores if s.effect in catalogued)


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
        (finished.fits[e].thinned, finished.fits[e].merit, finished.fits[e].solution.chi2) if rejected else ()),
        place[e]))
    sizes: dict[str, dict[str, float]] = {}
    # What is not known of the model may imitate anything, however far from where it stands.
    if not list_loose(workbench, grown[0].fitted.solution):
        found = map_threads(lambda e: _detectable(workbench, grown[0].fitted, [s for s in scores if s.effect == e],
                                                    len(scores)), order)
        sizes = dict(zip(order, found, strict=True))
    return [_describe(workbench, finished, tried, scores, e, chosen, alternatives, rejected, sizes.get(e, {}))
            for e in order]


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

        self.fits = dict(map_threads(one, tried.order))

    def before_of(self, fitted: Fitted) -> Fitted:
        """The reference model on the samples of a fit."""
        return self.before if fitted.thinned == self.before.thinned else self.reference

    def best_beside(self, workbench: Workbench, fitted: Fitted) -> Fitted:
        """The effect that predicts best, on the samples of a fit."""
        best = min(self.fits.values(), key=lambda f: (f.thinned, f.merit))
        if fitted.thinned == best.thinned:
            return best
        if self.best is None:
            self.best = workbench.fit(best.effects, [{}], best.solution.u, best.solution.z, thinned=True)
        return self.best or fitted


def _describe(workbench: Workbench, finished: _Finished, tried: Tried, scores: list[Score], effect: str,
              chosen: str | None, alternatives: set[str], rejected: bool, detectable: dict[str, float]) -> Candidate:
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
        alike = tuple(e for e, c in cosines.items() if c > workbench.settings.collinear)
    beyond = () if absent else list_unphysical(workbench, fitted.solution)
    return Candidate(
        effect=effect, p_value=p_value,
        explains=float(np.clip(drop / excess, 0.0, 1.0)) if rejected else 0.0,  # without a misfit there is no share
        visible=float(max((s.visible for s in own), default=0.0)),
        heldout_nrmse=workbench.measure_left_out(before if absent else fitted),
        smallest_detectable=detectable,
        indistinguishable_from=alike,
        estimates={} if absent else public_estimates(workbench, fitted.solution, [effect]),
        heldout_difference=difference, standard_error=error, cosines=cosines,
        text="its best amplitude has the wrong sign, or does nothing" if absent else "; ".join(map(str, beyond)),
        beyond=tuple(one.name for one in beyond),
        units={name: workbench.space.unit(name, before.solution.u) for name in detectable})


def _detectable(workbench: Workbench, reference: Fitted, own: list[Score], count: int) -> dict[str, float]:
    """Smallest value of every amplitude of an effect that would have been found, by public name.

    None is given where no value that physics allows would have been. The model is computed at that value: the score
    alone is the slope at the null, which may be that of a place where nothing else holds.
    """
    goal, best, found = detectable_length(count, workbench.settings), {}, {}
    for s in sorted(own, key=lambda s: s.information):
        if s.information > 0:
            best[s.name] = s  # at the shape that shows most
    for name, s in best.items():
        p = workbench.space.slots[workbench.space.index[name]].parameter
        origin = reference.solution.u.copy()
        for shape, value in s.shapes.items():
            origin[workbench.space.index[shape]] = value
        one = find_size(workbench.problem, reference.solution, origin, name, goal,
                        goal / float(np.sqrt(s.information)))
        if one is not None and np.isfinite(one.size):
            found[name] = to_public(p.coordinate, one.size)
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
