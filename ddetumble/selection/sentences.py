"""What the sentences of a verdict are made from: facts of a discovery or comparison, told by `ddetumble._sentences`."""

import dataclasses as dc
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from .._sentences import Sentence, join_sentences, say
from ..families import Family
from ..measurement.faults import Fault
from ..measurement.quantities import describe_quantity
from .discovery import Discovery
from .result import Candidate, Estimate, SettingShift, Step, Trace
from .settings import DEFAULT
from .text import describe_place


BRIEF = 60  # characters of estimates that still go into a headline


def find_longest(traces: Sequence[Trace]) -> float:
    """The last time of any record [s], which decides on the unit of all; 0 where nothing lies over time."""
    return max((float(np.nanmax(t.time)) for t in traces if t.independent == "time" and np.size(t.time)), default=0.0)


def describe_level(error: float, noise: float, shifts: Sequence[SettingShift], held: float | None,
                   level: float = DEFAULT.level_each) -> dict[str, Any]:
    """RMS residual over noise; where settings moved beyond chance, which did farthest, and the ratio as stated."""
    moved, noise = [s for s in shifts if s.p_value * len(shifts) < level], max(noise, 1e-300)
    if not moved:
        return {"ratio": error / noise, "moved": None, "held": None}
    worst = max(moved, key=lambda s: abs(s.largest))
    farthest = abs(worst.largest)
    return {
        "ratio": error / noise, "held": held / noise if held is not None and np.isfinite(held) else None,
        "moved": {"setting": "time origin" if worst.name == "time" else describe_quantity(worst.name).name,
                  "deviations": f"{farthest:.2g}" if farthest < 99.5 else f"{farthest:.0f}", "record": worst.record},
    }


def list_values(step: Step, effects: Sequence[str]) -> list[tuple[str, Estimate]]:
    """Parameters of effects with their estimates, without the effects' names."""
    return [(name.split(".", 1)[1], one) for name, one in step.parameters.items() if name.split(".")[0] in effects]


def _level(step: Step, found: Discovery) -> dict[str, Any]:
    return describe_level(step.nrmse, found.noise_nrmse, step.shifts, step.held_nrmse, found.settings.level_each)


def _chance(p: float) -> str:
    return f"p = {p:.1g}" if p >= 1e-6 else "p < 1e-6"


def explain(found: Discovery, left_out: tuple[str, ...], family: Family) -> tuple[Sentence, tuple[Sentence, ...]]:
    """The sentence of a verdict, and further notes."""
    first, settings = found.steps[0], found.settings
    some, lack = np.isfinite(first.heldout_nrmse), first.lack_of_fit
    effects, folds = list(found.effects), family.folds if some else ""
    needs = {effect.id: effect.requires for effect in family.catalogue}
    alike = sorted({a["effect"] for s in found.steps for a in s.alternatives})
    parts = [_say_verdict(found, family, _name_model(found), folds)]
    if found.verdict in ("improved", "unexplained") and found.where:
        view = dc.replace(family.view, longest=find_longest(first.traces))
        parts.append(say("verdict.where", place=describe_place(found.where[0], view)))
    if alike:
        parts.append(say("verdict.alike", effects=len(effects), others=alike, remedies=family.remedies))
    elif found.verdict == "explained":
        parts.append(say("verdict.unique", folds=folds))
    ordered = [e for e in left_out if "sequence" in needs.get(e, ())]
    if ordered and lack.rejected and found.verdict != "explained":
        parts.append(say("verdict.unordered", effects=ordered))
    notes = [say("verdict.fits_better", effect=a["effect"], added=s.added) for s in found.steps for a in s.alternatives
             if settings.is_beaten(a["heldout_difference"], a["standard_error"])]
    unseen = [c.effect for c in found.candidates if c.visible < settings.invisible and c.effect not in effects]
    if unseen:
        beside = "the initial rates" if family.free_running else "the settings"
        absorbs = ", ".join([*(name.replace("_", " ") for name in first.parameters), f"and {beside}"])
        notes.append(say("verdict.unidentifiable", effects=unseen, absorbs=absorbs, share=1.0 - settings.invisible))
    if left_out:
        notes.append(say("verdict.not_tried", effects=[(e, needs.get(e, ())) for e in left_out]))
    notes += [say("verdict.noise", channel=channel, text=noise["text"]) for channel, noise in found.noise.items()]
    if any(not s.converged for s in found.steps):
        notes.append(say("verdict.unconverged"))
    return join_sentences(*parts), tuple(notes)


def _name_model(found: Discovery) -> str:
    """The reference model in quotes, without folders, and the effects that it was given with."""
    given = dict.fromkeys(name.split(".")[0] for name in found.steps[0].parameters if "." in name)
    name = found.model.replace("\\", "/").rsplit("/", 1)[-1]
    return repr(name + (f" with {' and '.join(given)}" if given else ""))


def _say_verdict(found: Discovery, family: Family, model: str, folds: str) -> Sentence:
    """The first sentences: the verdict with its evidence."""
    first, last, counts = found.steps[0], found.steps[-1], found.counts
    lack, before, effects = first.lack_of_fit, _level(first, found), list(found.effects)
    p, records, conditions = _chance(lack.p_value), counts["records"], counts["conditions"]
    if found.verdict == "nothing-missing":
        seen = [c for c in found.candidates if c.visible > found.settings.invisible and c.smallest_detectable][:3]
        detectable = [(n, v, c.units.get(n, "")) for c in seen for n, v in list(c.smallest_detectable.items())[:1]]
        return say("verdict.nothing_missing", model=model, records=records, p=lack.p_value, level=lack.level,
                   detectable=detectable)
    if found.verdict == "undecided" and lack.rejected:
        sufficient = [c.effect for c in found.candidates if c.explains > found.settings.largest_part]
        return say("verdict.undecided", model=model, records=records, conditions=conditions, before=before, p=p,
                   sufficient=sufficient, remedies=family.remedies)
    if found.verdict == "undecided":
        return say("verdict.too_few", records=records)
    if found.verdict == "explained":
        values = list_values(last, effects)
        brief = len(say("words.values", parameters=values)) < BRIEF
        errors = (first.heldout_nrmse, last.heldout_nrmse) if folds else None
        return say("verdict.explained", model=model, effects=effects, values=values, brief=brief, before=before,
                   after=_level(last, found), p=p, errors=errors, noise=found.noise_nrmse, records=records,
                   conditions=conditions, folds=folds)
    if found.verdict == "improved":
        return say("verdict.improved", model=model, effects=effects, before=before, after=_level(last, found))
    return say("verdict.unexplained", model=model, before=before, p=p, candidates=len(found.candidates), folds=folds)


def describe_beyond(effects: Sequence[str], unphysical: Sequence[Any]) -> Sentence:
    """Sentence on a model that removes a misfit at values that physics does not allow."""
    return say("verdict.unphysical", effects=list(effects), values=list(map(str, unphysical)))


def describe_imitation(candidates: Sequence[Candidate], largest_part: float) -> tuple[Sentence, ...]:
    """Sentence on the effect that removes most of a misfit alone, at values beyond its limits; none where none does."""
    for one in sorted(candidates, key=lambda c: -c.explains):
        if one.beyond and one.explains > largest_part:
            return (say("verdict.imitation", effect=one.effect, share=one.explains, values=one.text),)
    return ()


def mention_references(found: Discovery, asked: str, rivals: Sequence[Mapping[str, Any]]) -> Discovery:
    """The same with the reference models that were tried: in the sentence which one the data want."""
    if found.model == asked:
        note = say("verdict.no_better_reference", models=[rival["model"] for rival in rivals])
        return dc.replace(found, references=tuple(rivals), notes=(*found.notes, note))
    text = next(rival["text"] for rival in rivals if rival["model"] == found.model).rstrip(".")
    first = say("verdict.other_reference", model=repr(found.model), text=text, effects=list(found.effects),
                asked=repr(asked))
    return dc.replace(found, sentence=join_sentences(first, found.sentence), references=tuple(rivals))


def mention_doubts(found: Discovery, doubts: Sequence[str], units: bool) -> Discovery:
    """The same with what has to be settled first.

    Args:
        found: the discovery.
        doubts: sentences; where units are in doubt, that one is first.
        units: whether they are.
    """
    first = found.steps[0]
    if not doubts or not first.lack_of_fit.rejected:
        return found
    sentence = join_sentences(found.sentence, *doubts)
    if units:
        sentence = say("verdict.doubtful_unit", doubt=str(doubts[0]), model=repr(found.model),
                       before=_level(first, found))
    return dc.replace(found, sentence=sentence, doubts=tuple(doubts))


def mention_faults(found: Discovery, faults: Sequence[Fault]) -> Discovery:
    """The same with the faults of its data: in the sentence what bears on the verdict, in the notes all of it."""
    if not faults:
        return found
    parts, out = [found.sentence], sorted({key for f in faults if f.left_out for key in f.records})
    if out:
        parts.append(say("verdict.left_out", records=out))
    if found.verdict != "nothing-missing":
        parts += [say("verdict.one_record", record=f.records[0]) for f in faults if f.kind == "doubtful"]
    return dc.replace(found, sentence=join_sentences(*parts), faults=tuple(faults),
                      notes=(*map(str, faults), *found.notes))
