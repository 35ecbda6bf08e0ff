"""What was found, in plain words."""

import dataclasses as dc
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..families import Family
from ..measurement.faults import Fault
from ..measurement.units import choose_time_unit, format_time
from .discovery import Discovery
from .result import Candidate, Estimate, Place, SettingShift, Step, Trace
from .settings import DEFAULT


PHASES = {"forward": " on strokes forward", "backward": " on strokes backward"}
BRIEF = 60  # characters of estimates that still go into a headline
CHANNEL_WORDS = {"normal_force": "force", "tangential_force": "friction force", "depression": "depression",
                 "pressure": "pressure"}
CHANNEL_WORDS |= {f"angular_velocity_{a}": f"angular velocity about {a}" for a in "xyz"}
CHANNEL_WORDS |= {f"attitude_{a}": f"attitude component {a}" for a in (*"wxyz", *"0123")}
UNITS = {"depression": ("mm", 1e3), "time": ("ms", 1e3), "depression_rate": ("m/s", 1.0),
         "initial_pressure": ("MPa", 1e-6), "approach_speed": ("m/s", 1.0), "sequence": ("", 1.0),
         "slip": ("mm", 1e3), "normal_load": ("N", 1.0), "internal_pressure": ("MPa", 1e-6), "slip_speed": ("m/s", 1.0),
         "angular_speed": ("rad/s", 1.0)} | {f"angular_velocity_{a}": ("rad/s", 1.0) for a in "xyz"}
NAMES = {"depression": "depression", "time": "time since touch", "depression_rate": "depression rate",
         "initial_pressure": "pressure", "approach_speed": "approach speed", "sequence": "order in the series",
         "normal_load": "load", "internal_pressure": "pressure", "slip_speed": "slip speed",
         "angular_speed": "angular speed"} | {f"angular_velocity_{a}": f"angular velocity about {a}" for a in "xyz"}


def name_value(name: str, e: Estimate) -> str:
    """`k_w = 1175 ± 10 N/m`, to the two digits of the standard deviation; without one, to four, and that is said."""
    if not (np.isfinite(e.sd) and e.sd > 0):
        return f"{name} = {e.estimate:.4g} {e.unit}".rstrip() + " (its uncertainty is not known)"
    places = 1 - int(np.floor(np.log10(e.sd)))
    if 1e-3 <= max(abs(e.estimate), e.sd) < 1e7 and places <= 9:
        value, sd = (f"{round(x, places):.{max(places, 0)}f}" for x in (float(e.estimate), float(e.sd)))
    else:
        digits = places + int(np.floor(np.log10(abs(e.estimate)))) if e.estimate else 1
        value, sd = f"{e.estimate:.{min(max(digits, 0), 12)}e}", f"{e.sd:.1e}"
    return f"{name} = {value} ± {sd} {e.unit}".rstrip()


def format_plain(value: float) -> str:
    """A number to three digits, and to more before it takes a power of ten: `1500`, not `1.5e+03`."""
    return f"{value:.0f}" if 999.5 <= abs(value) < 1e6 else f"{value:.3g}"


def find_longest(traces: Sequence[Trace]) -> float:
    """The last time of any record [s], which decides on the unit of all; 0 where nothing lies over time."""
    return max((float(np.nanmax(t.time)) for t in traces if t.independent == "time" and np.size(t.time)), default=0.0)


def describe_place(place: Place, longest: float = 0.0) -> str:
    """One place of a misfit in words; `longest` is the last time of the records [s]."""
    unit, factor = UNITS.get(place.variable, ("", 1.0))
    name = NAMES.get(place.variable, place.variable)
    if place.variable == "time" and place.channel.startswith(("angular_velocity", "attitude")):
        name = "time"
    if place.variable == "time":
        unit, factor = choose_time_unit(max(longest, place.range[1]))
    low, high = (format_plain(v * factor) for v in place.range)
    phase = "" if place.phase in ("", "both") else PHASES.get(place.phase, f" while {place.phase}")
    text = f"{CHANNEL_WORDS.get(place.channel, place.channel)}: {name} {low} to {high} {unit}".rstrip() + phase
    if place.period is not None:
        own = f"{format_plain(place.period * factor)} {unit}".rstrip()
        text += f", repeating every {format_time(place.period) if place.variable == 'time' else own}"
    return text


def _count_conditions(found: Discovery) -> str:
    count = found.counts["conditions"]
    return "one condition" if count == 1 else f"{count} conditions"


def join_words(words: Sequence[str]) -> str:
    """Words with commas and an "and" between them."""
    return words[0] if len(words) == 1 else ", ".join(words[:-1]) + " and " + words[-1]


def _values(step: Step, effects: tuple[str, ...]) -> str:
    return "; ".join(name_value(n.split(".", 1)[1], e) for n, e in step.parameters.items()
                     if n.split(".")[0] in effects)


def _percent(value: float) -> str:
    return f"{100 * value:.2f} %"


def _chance(p: float) -> str:
    return f"p = {p:.1g}" if p >= 1e-6 else "p < 1e-6"


def _level(step: Step, found: Discovery) -> str:
    return say_level(step.nrmse, found.noise_nrmse, step.shifts, step.held_nrmse, found.settings.level_each)


def say_level(error: float, noise: float, shifts: Sequence[SettingShift], held: float | None,
              level: float = DEFAULT.level_each) -> str:
    """`1.05 times the noise`; where settings had to move, also with the settings as they are written down."""
    text, why = f"{error / max(noise, 1e-300):.2f} times the noise", describe_moves(shifts, level)
    if not why:
        return text
    if held is None or not np.isfinite(held):
        return f"{text} ({why})"
    return f"{text} ({held / max(noise, 1e-300):.2f} with the settings as they are written down: {why})"


def describe_moves(shifts: Sequence[SettingShift], level: float = DEFAULT.level_each) -> str:
    """Which setting had to move farthest, as a clause; nothing where none moved beyond chance."""
    moved = [s for s in shifts if s.p_value * len(shifts) < level]
    if not moved:
        return ""
    worst = max(moved, key=lambda s: abs(s.largest))
    name = "time origin" if worst.name == "time" else NAMES.get(worst.name, worst.name.replace("_", " "))
    farthest = abs(worst.largest)
    shown = f"{farthest:.2g}" if farthest < 99.5 else f"{farthest:.0f}"
    return f"its {name} was moved by up to {shown} stated deviations, of record {worst.record}"


def explain(found: Discovery, left_out: tuple[str, ...], family: Family) -> tuple[str, tuple[str, ...]]:
    """The sentence of a verdict, and further notes."""
    first, last = found.steps[0], found.steps[-1]
    model = found.model.replace("\\", "/").rsplit("/", 1)[-1]
    given = list(dict.fromkeys(name.split(".")[0] for name in first.parameters if "." in name))
    model += f" with {join_words(given)}" if given else ""
    absorbs = ", ".join([*(name.replace("_", " ") for name in first.parameters), "and the settings"])
    if family.free_running:
        absorbs = " and ".join([*(name.replace("_", " ") for name in first.parameters), "the initial rates"])
    lack = first.lack_of_fit
    records = f"{found.counts['records']} records" if found.counts["records"] != 1 else "one record"
    every = records if found.counts["records"] == 1 else f"all {records}"
    misfit = f"it leaves {_level(first, found)}, more than chance allows ({_chance(lack.p_value)})"
    some = np.isfinite(first.heldout_nrmse)
    if found.verdict == "nothing-missing":
        sentence = (f"Nothing is missing: the model {model!r} fits {every} to the noise "
                    f"(lack of fit p = {lack.p_value:.2g}, level {lack.level:g}).")
        best = [c for c in found.candidates if c.visible > found.settings.invisible and c.smallest_detectable]
        if best:
            shown = best[:3]
            sentence += " It would have shown " + join_words(
                [f"{n} of {v:.3g} {c.units.get(n, '')}".rstrip()
                 for c in shown for n, v in list(c.smallest_detectable.items())[:1]]) + " or more."
    elif found.verdict == "undecided" and lack.rejected:
        fits = [c for c in found.candidates if c.explains > found.settings.largest_part]
        which = (f"{join_words([c.effect for c in fits])} alone would remove most of that" if fits else
                 "no single effect of the catalogue removes most of that")
        sentence = (f"Undecided: {records} at {_count_conditions(found)} cannot tell what is missing. The model "
                    f"{model!r} fails ({misfit}); {which}, and no condition can be left out to check it. With three "
                    f"conditions or more one can: {family.remedies}.")
    elif found.verdict == "undecided":
        sentence = (f"Undecided: these {records} are too few or too short; no effect of the catalogue at three times "
                    "the noise could have been shown. Measure more records.")
    elif found.verdict == "explained":
        was, them = ("was", "it") if len(found.effects) == 1 else ("were", "them")
        held_out = (f"the error on left-out conditions falls from {_percent(first.heldout_nrmse)} to "
                    f"{_percent(last.heldout_nrmse)} (noise {_percent(found.noise_nrmse)})" if some else
                    f"that is evidence within {records} at {_count_conditions(found)}, which no other condition "
                    "confirms")
        values = _values(last, found.effects)
        told = f" ({values})." if len(values) < BRIEF else f". The estimates: {values}."  # a headline has to be short
        sentence = (f"Missing {was} {join_words(list(found.effects))}{told} Without {them} the model {model!r} fails: "
                    f"{misfit}; with {them} {_level(last, found)} is left, and {held_out}.")
    elif found.verdict == "improved":
        verbs, them = ("helps but is", "it") if len(found.effects) == 1 else ("help but are", "them")
        sentence = (f"{join_words(list(found.effects)).capitalize()} {verbs} not all. The model {model!r} alone "
                    f"leaves {_level(first, found)}, with {them} "
                    f"{_level(last, found)}, and a misfit remains that no effect of the catalogue removes.")
    else:
        on = " on left-out conditions" if some else ""
        sentence = (f"Something is missing that the catalogue does not hold. The model {model!r} fails: {misfit}, "
                    f"and none of the catalogue's {len(found.candidates)} effects explains that{on}.")
    if found.verdict in ("improved", "unexplained") and found.where:
        sentence += f" The misfit sits in the {describe_place(found.where[0], find_longest(first.traces))}."
    if family.free_running:
        sentence = sentence.replace("left-out conditions", "left-out records")
    notes = []
    alike = sorted({a["effect"] for s in found.steps for a in s.alternatives})
    if alike:
        sentence += (f" This campaign cannot tell it apart from {join_words(alike)}: "
                     f"{family.remedies}.")
    elif found.verdict == "explained":
        what = f"predicts left-out {'records' if family.free_running else 'conditions'}" if some else "fits"
        sentence += f" No other effect of the catalogue {what} as well."
    notes += [f"{a['effect']} fits these records better than {s.added}, and predicts left-out ones worse: while the "
              "model is not all, neither is settled." for s in found.steps for a in s.alternatives
              if found.settings.is_beaten(a["heldout_difference"], a["standard_error"])]
    unseen = [c.effect for c in found.candidates if c.visible < found.settings.invisible
              and c.effect not in found.effects]
    if unseen:
        they = "they do" if len(unseen) > 1 else "it does"
        notes.append(f"This campaign can hardly see {join_words(unseen)}: refitting {absorbs} "
                     f"absorbs more than 99.8 % of what {they}.")
    needs = {effect.id: effect.requires for effect in family.catalogue}
    if left_out:
        notes.append("Not tried, because the model or the campaign lacks what they need: " + join_words(
            [f"{e} ({', '.join(needs[e])})" if needs.get(e) else e for e in left_out]) + ".")
    ordered = [e for e in left_out if "sequence" in needs.get(e, ())]
    if ordered and lack.rejected and found.verdict != "explained":
        sentence += (
            f" {join_words(ordered).capitalize()} could not be tried: the campaign does not say in which order the "
                     "tests were made (a condition `sequence`: 1, 2, 3 ...).")
    for channel, noise in found.noise.items():
        notes.append(f"Noise of the {CHANNEL_WORDS.get(channel, channel.replace('_', ' '))}: {noise['text']}.")
    if any(not s.converged for s in found.steps):
        notes.append("The optimiser did not converge at one of the steps: take its numbers with care.")
    return sentence, tuple(notes)


def describe_beyond(effects: Sequence[str], unphysical: Sequence[Any]) -> str:
    """Sentence on a model that removes a misfit at values that physics does not allow."""
    names = " and ".join(effects)
    would = "fit better" if len(effects) > 1 else "fits better"
    return f"{names.capitalize()} {would}, and explain{'' if len(effects) > 1 else 's'} nothing: " + "; ".join(
        map(str, unphysical)) + "."


def describe_imitation(candidates: Sequence[Candidate], largest_part: float) -> tuple[str, ...]:
    """Sentence on the effect that removes most of a misfit alone, at values beyond its limits; none where none does."""
    for one in sorted(candidates, key=lambda c: -c.explains):
        if one.beyond and one.explains > largest_part:
            return (f"{one.effect.capitalize()} alone would remove {100 * one.explains:.0f} % of the misfit, and "
                    f"explains nothing: {one.text}.",)
    return ()


def mention_references(found: Discovery, asked: str, rivals: Sequence[Mapping[str, Any]]) -> Discovery:
    """The same with the reference models that were tried: in the sentence which one the data want."""
    names = ", ".join(rival["model"] for rival in rivals)
    if found.model == asked:
        return dc.replace(found, references=tuple(rivals), notes=(
            *found.notes, f"Other reference models were tried too, and none does better with two effects: {names}."))
    text = next(rival["text"] for rival in rivals if rival["model"] == found.model)
    beside = f" with {' and '.join(found.effects)}" if found.effects else " alone"
    sentence = (f"The data want another reference model: {found.model!r} ({text.rstrip('.')}){beside} fits, where "
                f"{asked!r} with two effects still fails. {found.sentence}")
    return dc.replace(found, sentence=sentence, references=tuple(rivals))


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
    sentence = " ".join([found.sentence, *doubts])
    if units:
        sentence = (f"Undecided, because a unit may be wrong. {doubts[0]} As it stands, the model {found.model!r} "
                    f"leaves {_level(first, found)}.")
    return dc.replace(found, sentence=sentence, doubts=tuple(doubts))


def mention_faults(found: Discovery, faults: Sequence[Fault]) -> Discovery:
    """The same with the faults of its data: in the sentence what bears on the verdict, in the notes all of it."""
    if not faults:
        return found
    sentence, out = found.sentence, sorted({key for f in faults if f.left_out for key in f.records})
    if out:
        sentence += (
            f" Left out as faulty: {'record' if len(out) == 1 else 'records'} {join_words(out)}; see the faults of "
                     "the data.")
    for fault in faults:
        if fault.kind == "doubtful" and found.verdict != "nothing-missing":
            sentence += (f" I cannot tell record {fault.records[0]} from a fault: without it this misfit would not be "
                         "there. Repeat it.")
    return dc.replace(found, sentence=sentence, faults=tuple(faults), notes=(*map(str, faults), *found.notes))
