"""What the sentences of a verdict are made from: facts of a discovery or comparison, told by `ddetumble._sentences`."""

import dataclasses as dc
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from .._sentences import Sentence, join_sentences, say
from ..contact.effect import MEASURING
from ..effects.impact import AmbientPressure
from ..families import Family
from ..measurement.kinds import name_need
from ..measurement.quantities import describe_quantity
from ..measurement.units import format_time
from .bias import SettingBias
from .discovery import Discovery
from .forward_selection import Unphysical
from .lack_of_fit import FEWEST
from .missing.missing_force import summarise_missing
from .result import OPEN, Candidate, SettingShift, SettingSpread, Step, Trace
from .series import measure_ratio, relies_on_settings
from .settings import DEFAULT, SelectionSettings
from .text import describe_place, tells_nothing


BRIEF = 60  # characters of estimates that still go into a headline; longer ones get a sentence of their own


def find_longest(traces: Sequence[Trace]) -> float:
    """The last time of any record [s], which decides on the unit of all; 0 where nothing lies over time."""
    return max((float(np.nanmax(t.time)) for t in traces if t.independent == "time" and np.size(t.time)), default=0.0)


def describe_level(ratio: float, shifts: Sequence[SettingShift], held: float | None, level: float = DEFAULT.level_each
                   ) -> dict[str, Any]:
    """RMS residual over noise; where settings moved beyond chance, which did farthest, and the ratio as stated."""
    moved = [s for s in shifts if s.p_value * len(shifts) < level]
    if not moved:
        return {"ratio": ratio, "moved": None, "held": None}
    worst = max(moved, key=lambda s: abs(s.largest))
    farthest = abs(worst.largest)
    return {
        "ratio": ratio, "held": held if held is not None and np.isfinite(held) else None,
        "moved": {"setting": "time origin" if worst.name == "time" else describe_quantity(worst.name).name,
                  "deviations": f"{farthest:.2g}" if farthest < 99.5 else f"{farthest:.0f}", "record": worst.record,
                  "alike": worst.mean_share if worst.is_alike else None},
    }


def _describe_bias(one: SettingBias) -> dict[str, Any]:
    """Facts of a setting that may be wrong alike in all records."""
    return {"name": describe_quantity(one.name).name, "high": one.bias > 0, "size": f"{100 * abs(one.bias):.2g} %",
            "error": f"{100 * one.sd:.1g} %", "effects": list(one.effects),
            "alike": [_describe_bias(other) for other in one.alike]}


def _describe_spread(one: SettingSpread) -> dict[str, Any]:
    """Facts of a setting that scatters more than stated."""
    name = "time origin" if one.name == "time" else describe_quantity(one.name).name
    stated, seen = ((f"{100 * x:.2g} %" if one.relative else format_time(x)) for x in (one.stated, one.found))
    return {"name": name, "stated": stated, "found": seen}


def _level(step: Step, found: Discovery) -> dict[str, Any]:
    return describe_level(measure_ratio(step.traces), step.shifts, step.held_ratio, found.settings.level_each)


def list_choices(found: Discovery) -> list[tuple[str, list[str]]]:
    """Every effect of the model, and those that the campaign cannot tell from it and that are not named anyway. One
    that was exchanged for another is none of the model's, whatever the step at which it was added said of it.
    """
    named = set(found.effects)
    others = {str(step.added): {str(one["effect"]) for one in step.alternatives} for step in found.steps[1:]}
    return [(effect, sorted(others.get(effect, set()) - named)) for effect in found.effects]


def _list_allowed(found: Discovery) -> dict[str, Any]:
    """What noise and settings were taken for otherwise than stated; empty if for nothing."""
    noise = found.noise.items()
    uneven: dict[bool, list[str]] = {}
    for channel, one in noise:
        if one.get("varies"):
            uneven.setdefault(bool(one.get("share")), []).append(channel)
    hums: dict[tuple[str, ...], list[str]] = {}
    for channel, one in noise:
        if lines := tuple(sorted(f"{line['frequency']:.3g} Hz" for line in one.get("hum", ()))):
            hums.setdefault(lines, []).append(channel)
    wandering = [channel for channel, one in noise if one.get("slow_sd")]
    if not (uneven or hums or wandering or found.shared_error or found.spread):
        return {}
    return {"uneven": [(channels, grows) for grows, channels in sorted(uneven.items())], "wandering": wandering,
            "every": 1 < len(wandering) == len(found.noise), "hums": [(ch, list(f)) for f, ch in sorted(hums.items())],
            "shared": _describe_bias(found.shared_error) if found.shared_error is not None else None,
            "told": _is_tied(found),
            "loose": [_describe_spread(one) for one in found.spread]}


def find_nearer(found: Discovery) -> Mapping[str, Any] | None:
    """The other reference model, as `references` has it, to begin with where the verdict is open and it comes far
    nearer; None where there is none.
    """
    near = min((r for r in found.references if r["model"] != found.model), key=lambda r: r["nrmse"], default=None)
    return near if (near is not None and found.verdict in OPEN
                    and near["nrmse"] < found.settings.nearer * found.steps[-1].nrmse) else None


def tell_discovery(found: Discovery, family: Family, left_out: Sequence[str], units: bool, asked: str) -> Sentence:
    """The sentence of a verdict.

    Args:
        found, family: the discovery, its sentence and notes still to be told; the kind of its records.
        left_out: ids of effects that lack what they need.
        units: whether a unit is in doubt: then that doubt, the first one, comes instead of the verdict.
        asked: name of the reference model that was asked for.
    """
    first, rejected = found.steps[0], found.steps[0].lack_of_fit.rejected
    folds = family.folds if np.isfinite(first.heldout_nrmse) else ""
    parts: list[str] = []
    if units and found.doubts:
        parts.append(say("verdict.doubtful_unit", doubt=found.doubts[0], model=repr(found.model),
                         before=_level(first, found)))
    else:
        parts.append(_tell_verdict(found, family, folds))
        if _is_tied(found) and found.shared_error is not None:
            parts.append(say("verdict.error_or_effect", error=_describe_bias(found.shared_error),
                             choices=[(added, list(others)) for added, others in found.dropped]))
        sensors = {effect.id for effect in family.catalogue if effect.stage in MEASURING} & {*found.effects}
        if sensors:
            parts.append(say("verdict.gauge", effects=sorted(sensors)))
        for effect in family.catalogue:
            if effect.lookalike and effect.id in found.effects:
                parts.append(say("verdict.lookalike", effect=effect.id, error=effect.lookalike))
        if found.biases and found.effects:
            for effects in dict.fromkeys(one.effects for one in found.biases):
                alike = [_describe_bias(one) for one in found.biases if one.effects == effects]
                parts.append(say("verdict.biased", biases=alike, effects=list(effects)))
        near = find_nearer(found)
        if near is not None:
            parts.append(say("verdict.nearer_reference", model=near["model"], text=near["text"].rstrip("."),
                             effects=near["effects"], ratio=near["ratio"]))
        if allowed := _list_allowed(found):
            parts.append(say("verdict.allowances", **allowed))
        if found.verdict in OPEN and found.where:
            view = dc.replace(family.view, longest=find_longest(first.traces))
            place = describe_place(found.where[0], view)
            if not tells_nothing(place):
                parts.append(say("verdict.where", place=place))
        alike = [one for one in list_choices(found) if one[1]]
        if alike:
            parts.append(say("verdict.alike", choices=alike, remedies=family.suggest(found.noise)))
        elif found.verdict == "explained" and not _is_tied(found):
            parts.append(say("verdict.unique", folds=folds))
        needs = {effect.id: effect.requires for effect in family.catalogue}
        ordered = [e for e in left_out if "sequence" in needs.get(e, ())]
        if ordered and rejected and found.verdict != "explained":
            parts.append(say("verdict.unordered", effects=ordered))
        if found.missing is not None:
            parts.append(summarise_missing(found.missing))
        parts += found.doubts
    if found.model != asked:
        text = next(r["text"] for r in found.references if r["model"] == found.model).rstrip(".")
        parts.insert(0, say("verdict.other_reference", model=repr(found.model), text=text, effects=list(found.effects),
                            asked=repr(asked)))
    out = sorted({key for f in found.faults if f.left_out for key in f.records})
    if out:
        parts.append(say("verdict.left_out", records=out))
    if found.verdict != "nothing-missing" and not _rests_on_record(found):
        parts += [say("verdict.one_record", record=record) for record in _list_doubtful(found)]
    return join_sentences(*parts)


def _is_tied(found: Discovery) -> bool:
    """Whether effects that gave way to the error of a setting would do as well in its place."""
    return found.verdict == "explained" and found.shared_error is not None and bool(found.dropped)


def _list_doubtful(found: Discovery) -> list[str]:
    """Records that may be faulty, or show what shows nowhere else."""
    return [fault.records[0] for fault in found.faults if fault.kind == "doubtful"]


def _rests_on_record(found: Discovery) -> bool:
    """Whether a verdict is undecided because of one record that may be faulty, and for no other reason."""
    wanders = any(one.get("slow_sd") for one in found.noise.values())
    return (found.verdict == "undecided" and (found.steps[0].lack_of_fit.rejected or wanders) and not found.biases
            and found.rounding is None and not found.irregular and not found.unrepeated
            and not found.unsearched and bool(_list_doubtful(found)))


def name_reason(found: Discovery, units: bool) -> str:
    """Why a verdict is undecided, by the evidence that counts first; empty for any other. `units`: whether one is in
    doubt."""
    if found.verdict != "undecided":
        return ""
    reasons = (("unit", units and bool(found.doubts)), ("setting", bool(found.biases)),
               ("record", _rests_on_record(found)), ("rounding", found.rounding is not None),
               ("noise", found.irregular or found.unrepeated), ("effort", bool(found.unsearched)),
               ("conditions", found.steps[0].lack_of_fit.rejected), ("records", True))
    return next(name for name, holds in reasons if holds)


def list_notes(found: Discovery, family: Family, left_out: Sequence[str], asked: str, undrawn: str,
               exact: Sequence[str], loose: Sequence[str]) -> list[str]:
    """What was assumed, and what could not be seen: why no missing force was drawn, `exact` settings that state no
    uncertainty, `loose` parameters that the records do not fix."""
    first, settings = found.steps[0], found.settings
    needs = {effect.id: effect.requires for effect in family.catalogue}
    notes = [say("verdict.fits_better", effect=a["effect"], added=s.added) for s in found.steps for a in s.alternatives
             if settings.is_beaten(a["heldout_difference"], a["standard_error"])]
    unseen = [c.effect for c in found.candidates if c.visible < settings.invisible and c.effect not in found.effects]
    if unseen:
        beside = "the initial rates" if family.free_running else "the settings"
        absorbs = ", ".join([*(name.replace("_", " ") for name in first.parameters), f"and {beside}"])
        notes.append(say("verdict.unidentifiable", effects=unseen, absorbs=absorbs, share=1.0 - settings.invisible))
    if left_out:
        notes.append(say("verdict.not_tried", effects=[
            (e, [name_need(need, [family.kind]) for need in needs.get(e, ())]) for e in left_out]))
    assumed = family.models[found.model].assumes if found.model in family.models else ""
    notes += [say("verdict.noise", channel=channel, text=noise["text"]) for channel, noise in found.noise.items()]
    if any(not s.converged for s in found.steps):
        notes.append(say("verdict.unconverged"))
    if found.confidence is not None:
        notes.append(say("verdict.confidence", right=found.confidence.right, judged=found.confidence.judged,
                         allowed=found.confidence.allowed, kind=family.name))
    others = [r["model"] for r in found.references if r["rejected"]] if found.model == asked else []
    notes = [*notes, *filter(None, [assumed, undrawn])]
    return [*notes, *(say(f"verdict.{name}", **{key: list(names)}) for name, key, names in (
        ("exact_settings", "names", exact), ("undetermined", "names", loose),
        ("no_better_reference", "models", others)) if names)]


def doubt_ambient(found: Discovery, stated: float | None, added: bool, level: float) -> Sentence | None:
    """What is to be said of an ambient pressure that was fitted beside one that the campaign states [Pa], which may
    have been `added` to gauge pressures; None where they agree within so many standard deviations, and it was not.
    """
    one = found.steps[-1].parameters.get(f"{AmbientPressure.id}.p_a")
    if one is None or stated is None:
        return None
    off = abs(one.estimate - stated) / max(one.sd, 1e-300)
    return say("verdict.ambient", fitted=one.estimate, sd=one.sd, stated=stated, added=added,
               off=off if off > level else None) if added or off > level else None


def list_doubts(verdict: str, candidates: Sequence[Candidate], questions: Sequence[str],
                unphysical: tuple[Sequence[str], Sequence[Unphysical]] | None, settings: SelectionSettings
                ) -> tuple[str, ...]:
    """What has to be settled first: `questions` about units, and models that fit at values beyond what physics allows,
    the best one (its effects and estimates) or one effect that would remove most of an open misfit."""
    if unphysical is not None:
        effects, values = unphysical
        return *questions, say("verdict.unphysical", effects=list(effects), values=list(map(str, values)))
    most = max((c for c in candidates if c.beyond), key=lambda c: c.explains, default=None)
    if verdict not in OPEN or most is None or most.explains <= settings.largest_part:
        return tuple(questions)
    return *questions, say("verdict.imitation", effect=most.effect, share=most.explains, values=most.text)


def _tell_verdict(found: Discovery, family: Family, folds: str) -> Sentence:
    """The first sentences: the verdict with its evidence."""
    given = dict.fromkeys(name.split(".")[0] for name in found.steps[0].parameters if "." in name)
    name = found.model.replace("\\", "/").rsplit("/", 1)[-1]
    model = repr(name + (f" with {' and '.join(given)}" if given else ""))
    first, last, counts, settings = found.steps[0], found.steps[-1], found.counts, found.settings
    lack, before, effects = first.lack_of_fit, _level(first, found), list(found.effects)
    p = f"p = {lack.p_value:.1g}" if lack.p_value >= 1e-6 else "p < 1e-6"
    records, conditions = counts["records"], counts["conditions"]
    if found.verdict == "nothing-missing" and found.irregular:
        return say("verdict.irregular", model=model, records=records, before=before, folds=family.folds)
    if found.verdict == "nothing-missing" and found.biases:
        return say("verdict.biased_only", model=model, before=before, p=p, bias=_describe_bias(found.biases[0]))
    if found.verdict == "nothing-missing":
        seen = [c for c in found.candidates if c.visible > settings.invisible and c.smallest_detectable][:3]
        detectable = [(n, v, c.units.get(n, "")) for c in seen for n, v in list(c.smallest_detectable.items())[:1]]
        return say("verdict.nothing_missing", model=model, records=records, p=lack.p_value, level=lack.level,
                   detectable=detectable)
    if found.verdict == "undecided" and found.biases:
        return say("verdict.bias_or_effect", model=model, before=before, p=p,
                   biases=[_describe_bias(one) for one in found.biases],
                   choices=[(added, list(others)) for added, others in found.dropped])
    if _rests_on_record(found):
        record = _list_doubtful(found)[0]
        if not lack.rejected:
            return say("verdict.one_record_or_noise", model=model, record=record)
        return say("verdict.one_record_or_more", model=model, before=before, p=p, record=record)
    if found.verdict == "undecided" and found.rounding is not None:
        return say("verdict.rounding", model=model, before=before, p=p, effects=list(found.rounding.effects),
                   choices=[(added, list(others)) for added, others in found.dropped],
                   channels=list(found.rounding.digits))
    if found.verdict == "undecided" and found.unsearched:
        return say("verdict.stopped", model=model, rounds=counts["rounds"], more=found.more_effort, before=before, p=p,
                   choices=[(added, list(others)) for added, others in found.dropped], searches=list(found.unsearched))
    if found.verdict == "undecided" and found.unrepeated:
        return say("verdict.unrepeated", model=model, records=records, needed=FEWEST, before=before, p=p,
                   choices=[(added, list(others)) for added, others in found.dropped])
    if found.verdict == "undecided" and found.irregular:
        if found.dropped:
            return say("verdict.outweighed", model=model, before=before, p=p, folds=family.folds,
                       choices=[(added, list(others)) for added, others in found.dropped])
        if lack.rejected:
            return say("verdict.unrelated", model=model, records=records, before=before, p=p, folds=family.folds,
                       large=first.chi2_reduced > settings.far and not family.free_running)
        return say("verdict.ambiguous", model=model, before=before)
    if found.verdict == "undecided" and lack.rejected:
        return say("verdict.undecided", model=model, records=records, conditions=conditions, before=before, p=p,
                   sufficient=[c.effect for c in found.candidates if c.explains > settings.largest_part],
                   needed="two records" if family.free_running else "three conditions",
                   remedies=family.suggest(found.noise))
    if found.verdict == "undecided":
        return say("verdict.too_few", records=records)
    if found.verdict == "explained" and found.irregular:
        return join_sentences(
            say("verdict.explained_but", model=model, effects=effects, before=before, after=_level(last, found), p=p),
            say("verdict.irregular_rest", folds=family.folds))
    if found.verdict == "explained":
        values = [(name.split(".", 1)[1], one) for name, one in last.parameters.items()
                  if name.split(".")[0] in effects]
        return say("verdict.explained", model=model, effects=effects, choices=list_choices(found), values=values,
                   brief=len(say("words.values", parameters=values)) < BRIEF, before=before, after=_level(last, found),
                   p=p, errors=(first.heldout_nrmse, last.heldout_nrmse) if folds else None,
                   predicted=((first.prediction_nrmse, last.prediction_nrmse)
                              if folds and relies_on_settings((first,)) else None), noise=found.noise_nrmse,
                   records=records, conditions=conditions, folds=folds)
    if found.verdict == "improved":
        return say("verdict.improved", model=model, choices=list_choices(found), before=before,
                   after=_level(last, found), rejected=last.lack_of_fit.rejected)
    return say("verdict.unexplained", model=model, before=before, p=p, candidates=len(found.candidates), folds=folds)
