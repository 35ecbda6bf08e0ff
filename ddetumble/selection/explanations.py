"""What may explain a misfit where a verdict leaves that open: effects, and errors of a setting that all records share.

Each explanation is a model fitted to all records, so that the next test can be looked for that distinguishes them.
"""

import dataclasses as dc
import itertools
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from .._errors import ComputationError
from ..inference.findings import Fit
from ..inference.parameters import ParameterSpace
from ..inference.stack import list_commons
from ..measurement.units import Uncertainty
from .bias import SettingBias
from .describe import make_fit
from .forward_selection import FittedStep, Path, fit_with_shapes, is_beyond, is_refuted
from .problem import Fitted, SelectionProblem


@dc.dataclass(frozen=True)
class Explanation:
    """One of several models between which a verdict leaves open what is missing."""

    effects: tuple[str, ...]  # ids of those that it adds to the reference model
    setting: str | None = None  # whose error all records share in it; None where there is no such error
    bias: float = 0.0  # share by which that setting reads too high, and its standard deviation
    sd: float = 0.0


Added = tuple[tuple[str, tuple[str, ...]], ...]  # effects as they were added, each with those it was not told from
Makers = tuple[Callable[[], Fit], ...]


def list_added(steps: Sequence[FittedStep]) -> Added:
    """Every effect of the last of some steps, and those that it could not be told from when it was added and that are
    not among the effects.
    """
    named, others = {*steps[-1].fitted.effects}, {}
    for before, step in itertools.pairwise(steps):
        others[_find_added(before, step)] = {effect for effect, _, _ in step.alternatives} - named
    return tuple((effect, tuple(sorted(others.get(effect, ())))) for effect in steps[-1].fitted.effects)


def _find_added(before: FittedStep, step: FittedStep) -> str:
    effects = step.fitted.effects
    return next((e for e in effects if e not in before.fitted.effects), effects[-1])


def settle_rivals(selection: SelectionProblem, steps: Sequence[FittedStep]) -> tuple[list[FittedStep], list[Fitted]]:
    """The steps without what the last model refutes since, and the models that it could not be told from.

    These are it with its last effect exchanged, as fitted then, and with an earlier one exchanged for what it was not
    told from when it was added, fitted beside the effects that came later. Where that predicts left-out conditions
    worse beyond chance, or with values that physics does not allow, it is no longer an alternative of its step.
    """
    last, kept = steps[-1], [*steps]
    found = [last.tried.refined[effect] for effect, _, _ in last.alternatives] if last.tried is not None else []
    for k, (before, step) in enumerate(itertools.pairwise(steps[:-1]), 1):
        added = _find_added(before, step)
        if added not in last.fitted.effects or step.tried is None:  # exchanged since
            continue
        out = set()
        for other in sorted({effect for effect, _, _ in step.alternatives} - {*last.fitted.effects}):
            rival = _exchange(selection, last.fitted, added, other, step.tried.refined.get(other))
            if rival is None:
                continue
            if is_beyond(selection, steps[0].fitted, rival) or is_refuted(selection, rival, last.fitted, before.fitted):
                out.add(other)
            else:
                found.append(rival)
        kept[k] = dc.replace(step, alternatives=tuple(one for one in step.alternatives if one[0] not in out))
    return kept, found


def _exchange(selection: SelectionProblem, fitted: Fitted, added: str, other: str, early: Fitted | None
              ) -> Fitted | None:
    """A model with one effect in place of another, fitted from where both ended; None where that fails."""
    start, owners = fitted.solution.u.copy(), np.array([slot.owner for slot in selection.space.slots])
    start[owners == added] = selection.start[owners == added]  # what is left out does nothing
    if early is not None:
        start[owners == other] = early.solution.u[owners == other]
    effects = tuple(other if effect == added else effect for effect in fitted.effects)
    return selection.extend(fitted, effects, start, tolerance=1e-4)


def list_explanations(path: Path, steps: Sequence[FittedStep], biases: Sequence[SettingBias], sufficient: Sequence[str],
                      model: str, verdict: str) -> tuple[tuple[Explanation, ...], Makers]:
    """Models between which a verdict leaves open, and what makes their fits; none where it leaves nothing open.

    Args:
        path: the search.
        steps: of the search that ended with the effects that may be missing, whether the verdict names them or not.
        biases: errors of one setting that may stand for effects of these steps.
        sufficient: effects each of which explains most of the misfit by itself, where no condition decides.
        model, verdict: of the discovery.
    """
    selection, last = path.selection, steps[-1]
    models: list[tuple[Explanation, Callable[[], Fit]]] = []

    def add(fitted: Fitted) -> None:
        models.append((Explanation(fitted.effects), partial(make_fit, selection, fitted, model, verdict)))

    if biases:
        if verdict != "nothing-missing":
            add(last.fitted)
            if last.tried is not None:
                for effect, _, _ in last.alternatives:
                    add(last.tried.refined[effect])
        for one in biases:
            rest = next((step.fitted for step in reversed(steps) if not {*one.effects} & {*step.fitted.effects}),
                        steps[0].fitted)
            models.append((Explanation(rest.effects, one.name, one.bias, one.sd),
                           partial(fit_bias, selection, rest, one.name, model, verdict)))
    elif verdict == "undecided":
        reference = steps[0].fitted
        for effect in sufficient:
            # Those that never came near the best were fitted to thinned records only.
            fitted = path.tried.refined.get(effect) or fit_with_shapes(
                selection, path.tried.screened[effect], reference, effect)
            if fitted.solution is not reference.solution and not is_beyond(selection, reference, fitted):
                add(fitted)
    return tuple(one for one, _ in models), tuple(make for _, make in models)


def fit_bias(selection: SelectionProblem, fitted: Fitted, name: str, model: str, verdict: str) -> Fit:
    """A model with an error of one setting, a share of it that all records share, as one more parameter.

    Raises:
        ComputationError: It cannot be computed.
    """
    column = dc.replace(selection.campaign.conditions[name], common=Uncertainty(relative=selection.settings.bias))
    campaign = dc.replace(selection.campaign, conditions={**selection.campaign.conditions, name: column})
    old = selection.space
    space = ParameterSpace(old.reference, old.effects, list_commons(campaign))

    def widen(u: np.ndarray) -> np.ndarray:
        found = space.coordinates()
        found[[space.index[slot.name] for slot in old.slots]] = u
        return found

    base = (*selection.base, f"{name}_shift")
    wider = dc.replace(selection, campaign=campaign, space=space, base=base, start=widen(selection.start),
                       guess=widen(selection.guess), orthonormal={}).restack(selection.noise)
    found = wider.fit(fitted.effects, [{}], widen(fitted.solution.u), fitted.solution.z, tolerance=1e-4)
    if found is None:
        raise ComputationError(f"the model with an error of the {name.replace('_', ' ')} cannot be computed")
    return make_fit(wider, found, model, verdict)
