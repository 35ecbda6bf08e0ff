"""Other reference models of the family as rivals, before three effects are stacked on one."""

import dataclasses as dc
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from .._errors import ComputationError, InputError
from ..contact.effect import AbstractEffect, list_choices, parts_of
from ..inference.builtin import BUILTIN
from ..inference.families import name_family
from ..inference.models import ResolvedModel
from ..measurement.campaign import Campaign
from .limits import Unphysical, list_unphysical
from .records import Discovery
from .search import Grown, Tried
from .settings import SelectionSettings
from .workbench import Fitted, Workbench


@dc.dataclass(frozen=True)
class Search:
    """What a search through the catalogue found beside one reference model.

    Attributes:
        workbench: of the campaign and the reference model.
        grown: its steps, the reference model first.
        tried: every first addition.
        visible: whether the campaign could have shown an effect.
    """

    workbench: Workbench
    grown: list[Grown]
    tried: Tried
    visible: bool


@dc.dataclass(frozen=True)
class Rival:
    """Another reference model: its name, what it is, and what the search found beside it."""

    name: str
    text: str
    search: Search


def keep_physical(search: Search) -> tuple[list[Grown], tuple[Unphysical, ...]]:
    """The steps up to the last one that lies within physical limits, and what lay beyond them in the next."""
    grown, beyond = list(search.grown), ()
    while len(grown) > 1:
        now = list_unphysical(search.workbench, grown[-1].fitted.solution)
        if not now:
            break
        beyond = now
        grown.pop()
    return grown, beyond


def is_explained(search: Search) -> bool:
    """Whether no misfit is left within physical limits."""
    return not keep_physical(search)[0][-1].lack.rejected


def stacks_up(search: Search) -> bool:
    """Whether as many effects as may stand without a look at other reference models explain nothing, or one beyond
    what physics allows."""
    return not is_explained(search) and (len(search.grown[-1].fitted.effects) >= search.workbench.settings.effects_before_rivals
                                         or bool(keep_physical(search)[1]))


def try_references(resolved: ResolvedModel, campaign: Campaign, effects: Sequence[type[AbstractEffect]],
                   zeros: Mapping[str, tuple[float, float]], asked: Fitted,
                   settings: SelectionSettings, begin: Callable[[Workbench, Fitted], Search]) -> tuple[Rival, ...]:
    """Search beside every other built-in reference model of the family that fits about as well by itself.

    Args:
        resolved: the reference model that was asked for; `asked` its fit.
        campaign, effects, zeros: as the search beside that had them.
        settings: thresholds.
        begin: searches beside a fitted reference model.
    """
    fitted, own = [], asked.solution
    for name, built in BUILTIN.get(name_family(campaign), {}).items():
        reference = built.make()
        if not built.rival or _identify(reference) == _identify(resolved.reference) or _identify(reference) in [
                _identify(bench.reference) for *_, bench, _ in fitted]:
            continue
        try:
            bench = Workbench(campaign, reference, effects, (), zeros, settings)
            alone = bench.begin()
        except (ComputationError, InputError):
            continue
        rows = float((np.asarray(bench.records.stack.weights) > 0).sum())
        other = alone.solution
        if (abs(other.chi2 - own.chi2) > settings.same_reference * own.chi2 or len(other.names) != len(own.names)) and (
                other.chi2 - rows <= settings.farthest_reference * max(own.chi2 - rows, 1.0)):
            fitted.append((name, built.text, bench, alone))
    fitted.sort(key=lambda one: one[3].merit)
    rivals = []
    for name, text, bench, alone in fitted[:settings.rival_references]:
        try:
            rivals.append(Rival(name, text, begin(bench, alone)))
        except ComputationError:
            continue
    return tuple(rivals)


def _identify(reference: Any) -> tuple:
    """What makes two reference models one."""
    return tuple(type(part) for part in parts_of(reference)), tuple(list_choices(reference).items())


def choose_reference(found: Search, rivals: Sequence[Rival]) -> Rival | None:
    """The rival that leaves no misfit with the fewest parameters, where the first model leaves one; else None."""
    good = [r for r in rivals if is_explained(r.search)]
    if is_explained(found) or not good:
        return None
    return min(good, key=lambda r: (len(r.search.grown[-1].fitted.solution.names), r.search.grown[-1].fitted.merit))


def mention_references(found: Discovery, asked: str, rivals: Sequence[Rival]) -> Discovery:
    """The same with the reference models that were tried: in the sentence which one the data want."""
    rows = []
    for rival in rivals:
        last = rival.search.grown[-1]
        rows.append({"model": rival.name, "text": rival.text, "effects": list(last.fitted.effects),
                     "parameters": len(last.fitted.solution.names), "rejected": last.lack.rejected,
                     "p_value": last.lack.p_value, "chi2": last.fitted.solution.chi2})
    names = ", ".join(rival.name for rival in rivals)
    if found.model == asked:
        return dc.replace(found, references=tuple(rows), notes=(
            *found.notes, f"Other reference models were tried too, and none does better with two effects: {names}."))
    text = next(rival.text for rival in rivals if rival.name == found.model)
    beside = f" with {' and '.join(found.effects)}" if found.effects else " alone"
    sentence = (f"The data want another reference model: {found.model!r} ({text.rstrip('.')}){beside} fits, where "
                f"{asked!r} with two effects still fails. {found.sentence}")
    return dc.replace(found, sentence=sentence, references=tuple(rows))
