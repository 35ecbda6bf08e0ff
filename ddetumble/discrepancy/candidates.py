"""The catalogue as it stood at the first step: what each effect explains, and what this campaign can see of it."""

import numpy as np
from scipy import stats

from .adequacy import Score
from .records import Candidate
from .search import Grown, Tried, compare_additions
from .steps import public_estimates, whitened_share
from .workbench import Fitted, Workbench


SEEN = 4.5  # an amplitude of so many standard errors would be found
ALIKE = 0.97


def could_have_shown(workbench: Workbench, scores: list[Score]) -> bool:
    """Whether any effect whose own signature is three times the noise would have been found."""
    samples = float((np.asarray(workbench.records.stack.weights) > 0).sum())
    catalogued = {e.id for e in workbench.catalogue}
    return any(9.0 * samples * s.visible > SEEN**2 for s in scores if s.effect in catalogued)


def describe_candidates(workbench: Workbench, grown: list[Grown], tried: Tried) -> list[Candidate]:
    """All effects of the catalogue, best first."""
    scores = grown[0].scores
    first = grown[1] if len(grown) > 1 else None
    chosen = first.fitted.effects[0] if first is not None and first.tried is tried else None
    alternatives = {e for e, _, _ in first.alternatives} if first is not None and chosen is not None else set()
    order = list(tried.order)
    if len(grown) > 1:
        # After a swap the effects of the final model lead, in the order in which they were found.
        final = [e for e in grown[-1].fitted.effects if e in order]
        order = sorted(order, key=lambda e: (final.index(e) if e in final else len(final)))
    return [_describe(workbench, tried, scores, e, chosen, alternatives, len(order)) for e in order]


def _describe(workbench: Workbench, tried: Tried, scores: list[Score], effect: str, chosen: str | None,
              alternatives: set[str], count: int) -> Candidate:
    before, fitted = tried.before, tried.screened[effect]
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
    p_value = float(-np.expm1(count * np.log1p(-min(single, 1 - 1e-16))))
    difference, error = compare_additions(workbench, tried, effect)
    cosines = _cosines(own, scores, effect)
    if effect == chosen:
        alike = tuple(e for e in tried.order if e in alternatives)
    elif effect in alternatives:
        alike = tuple(e for e in tried.order if (e in alternatives or e == chosen) and e != effect)
    else:
        alike = tuple(e for e, c in cosines.items() if c > ALIKE)
    detectable = _detectable(workbench, own)
    refined = tried.refined.get(effect)
    shown = refined if refined is not None and set(refined.solution.names) >= set(fitted.solution.names) else fitted
    return Candidate(
        effect=effect, p_value=p_value, explains=float(np.clip(drop / excess, 0.0, 1.0)) if excess > 1.0 else 0.0,
        visible=float(max((s.visible for s in own), default=0.0)),
        heldout_nrmse=_heldout(workbench, before, before if absent else fitted),
        smallest_detectable=detectable,
        indistinguishable_from=alike,
        estimates={} if absent else public_estimates(workbench, shown.solution, [effect]),
        heldout_difference=difference, standard_error=error, cosines=cosines,
        text="its best amplitude has the wrong sign, or does nothing" if absent else "",
        units={name: workbench.space.slots[workbench.space.index[name]].parameter.unit for name in detectable})


def _heldout(workbench: Workbench, before: Fitted, fitted: Fitted) -> float:
    """Held-out rms error over rms signal, from the whitened held-out loss."""
    return whitened_share(workbench, before) * float(np.sqrt(fitted.forecast.sum() / max(before.solution.chi2, 1e-300)))


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
                c = abs(float(s.cosines[t.place]))
                if c > max(0.5, found.get(t.effect, 0.0)):
                    found[t.effect] = min(c, 1.0)
    return dict(sorted(found.items(), key=lambda item: -item[1]))
