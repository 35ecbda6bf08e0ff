"""Records that are at fault, rather than the model: one that all others disagree with.

Physics is a smooth trend over the conditions, or shows at an extreme of them, and in repeats alike. A record is at
fault where the others, fitted without it, leave it far more misfit than any of themselves has, although there are
records on all sides of it, or a repeat. At an extreme of the conditions it stays, with a warning, unless what is wrong
with it is plain: a known ratio of units makes it fit, or one gain does down to the noise and the records beside it show
nothing of it.
"""

import dataclasses as dc
from collections.abc import Callable

import numpy as np

from ..measurement.campaign import Campaign
from ..measurement.faults import Fault
from .cross_validation import leave_out
from .data_errors import Diagnosis, diagnose
from .leave_record_out import Aside, measure_record, set_aside, settle
from .problem import Fitted, SelectionProblem


@dc.dataclass(frozen=True)
class Suspect:
    """A record that disagrees with all others.

    Attributes:
        key: of the record.
        sure: whether it is at fault beyond doubt.
        diagnosis: what would make it fit.
        aside: the fit of the others.
        enclosed: whether there are records on all sides of it, or a repeat.
    """

    key: str
    sure: bool
    diagnosis: Diagnosis
    aside: Aside
    enclosed: bool


def find_suspects(selection: SelectionProblem, fitted: Fitted, most: int | None = None) -> list[Suspect]:
    """Records at fault under a model, worst first; at most one in four, and one that is in doubt at the end."""
    count = selection.records.count
    most = max(1, count // selection.settings.outliers.one_in) if most is None else most
    found, out = [], set()
    while len(found) < most and count - len(out) >= selection.settings.outliers.fewest:
        suspect = _find_worst(selection, fitted, out)
        if suspect is None:
            break
        found.append(suspect)
        if not suspect.sure:
            break
        out.add(suspect.aside.record)
    return found


def _find_worst(selection: SelectionProblem, fitted: Fitted, out: set[int]) -> Suspect | None:
    """The record that the others disagree with most, if any is beyond chance."""
    limits = selection.settings.outliers
    solution = fitted.solution if not out else set_aside(selection, fitted.solution, next(iter(out)), out).solution
    kept = [r for r in range(selection.records.count) if r not in out]
    misfit = {r: measure_record(selection, selection.problem, solution, r) for r in kept}
    order = sorted(kept, key=lambda r: misfit[r].degrees - misfit[r].total)
    if misfit[order[0]].p_value * len(kept) > limits.p_value:
        return None
    if len(kept) > limits.every:
        # What bends the fit most may be fitted best itself, and its fault shows in the others.
        loss = leave_out(solution, np.arange(selection.records.count))
        order = list(dict.fromkeys((*order[:limits.candidates], max(kept, key=lambda r: loss[r]))))
    asides = [set_aside(selection, solution, r, out) for r in order]
    # Without the culprit the others agree best.
    aside, *others = sorted(asides, key=lambda a: a.rest.total / max(a.rest.degrees, 1))
    if len(kept) <= limits.fewest and any(a.rest.excess < limits.far * max(aside.rest.excess, 1.0) for a in others):
        return None  # nobody can say which of them is wrong
    return _judge(selection, aside, len(kept))


def _judge(selection: SelectionProblem, aside: Aside, count: int) -> Suspect | None:
    """Whether a record is at fault."""
    limits = selection.settings.outliers
    others = max(max(m.excess for m in aside.others.values()), 0.0)
    fine = aside.rest.p_value > limits.adequate
    if aside.own.p_value * count > limits.p_value or aside.own.excess < limits.clear - 1.0:
        return None
    enclosed = is_enclosed(selection, aside)
    worse = fine or aside.own.excess > limits.factor * max(others, 1.0)
    if not worse or (count <= limits.fewest and aside.own.excess < limits.farther * max(others, 1.0)):
        return None
    diagnosis = diagnose(selection, aside)
    alone = selection.family.free_running or diagnosis.kind == "gain"
    far = alone and aside.own.excess > limits.far * max(others, 1.0)
    sure = enclosed or far or diagnosis.kind == "unit"
    if not sure and not fine:
        return None
    return Suspect(selection.records.keys[aside.record], sure, diagnosis, aside, enclosed)


def is_enclosed(selection: SelectionProblem, aside: Aside) -> bool:
    """Whether a record lies among the others: a repeat of it, or records on both sides in all that physics may feel."""
    r, kept = aside.record, list(aside.others)
    records, names = selection.campaign.records, [str(c) for c in selection.campaign.records.columns]
    if "sequence" in names:
        order = records["sequence"].to_numpy(dtype=float)
        if order[r] <= order[kept].min():
            return False  # what softens does so most from the first test to the second
        names.remove("sequence")
    if names and any(selection.groups[k] == selection.groups[r] for k in kept):
        return True
    solution, count = aside.solution, selection.records.count
    features = [records[name].to_numpy(dtype=float) for name in names]
    features += [np.abs(solution.state).max(axis=1), np.abs(solution.state_rate).max(axis=1)]
    if selection.family.free_running:
        across = np.sqrt(np.mean(np.sum(solution.channels[:, :2] ** 2, axis=1), axis=-1))
        features = [np.abs(solution.state_rate).max(axis=1), across]
    else:
        features += [np.abs(solution.channels[:, c]).max(axis=1) for c in range(solution.channels.shape[1])]
        features.append(np.asarray(solution.end))
    for x in features:
        x = x[:count]
        slack = selection.settings.outliers.same * abs(x[r])
        if x[r] > x[kept].max() + slack or x[r] < x[kept].min() - slack:
            return False
    return True


def tell_fault(selection: SelectionProblem, suspect: Suspect, keep: bool) -> Fault:
    """A suspect in words.

    Args:
        selection: on which it was found.
        suspect: what was found.
        keep: whether every record is to be kept.
    """
    own, others = suspect.aside.own, suspect.aside.others
    most = max(m.excess for m in others.values()) + 1.0
    size, usual = np.sqrt(max(own.excess + 1.0, 0.0)), np.sqrt(max(most, 0.0))
    seen = (f"Record {suspect.key} disagrees with all others: fitted without it they leave it {_say(size)} times its "
            f"noise, and none of themselves more than {_say(usual)}.")
    text, remedy = suspect.diagnosis.text, suspect.diagnosis.remedy
    kind, channel = suspect.diagnosis.kind, suspect.diagnosis.channel
    if not suspect.sure:
        done = ("It is kept: no record lies beyond it and none repeats it, so that I cannot tell a fault from an "
                "effect that shows only there.")
        return Fault("doubtful", (suspect.key,), channel, f"{seen} {text}".rstrip(), done, "Repeat it.")
    if keep:
        return Fault(kind, (suspect.key,), channel, f"{seen} {text}".rstrip(), "It is kept, as asked.", remedy)
    if suspect.diagnosis.samples is not None:
        return Fault(kind, (suspect.key,), channel, f"{seen} {text}", "They are left out, and the record is kept.",
                     remedy)
    done = "It is left out."
    if not suspect.enclosed and kind == "gain":
        done = ("It is left out, although no record lies beyond it: an effect of that size would show in the records "
                "beside it. Should a repeat read the same, it is none of the gauge's.")
    return Fault(kind, (suspect.key,), channel, f"{seen} {text}".rstrip(), done, remedy, left_out=True)


def _say(size: float) -> str:
    """A size to two digits."""
    return f"{size:.2g}" if size < 100 else f"{float(f'{size:.2g}'):.0f}"


Search = Callable[[Campaign], tuple[SelectionProblem, Fitted] | None]


def find_culprit(selection: SelectionProblem, fitted: Fitted, search: Search) -> Suspect | None:
    """The record without which a model is found that leaves nothing, and that is plainly at fault under that model.

    Args:
        selection, fitted: a model that leaves a misfit.
        search: a model that leaves nothing smooth of a campaign and where it was found, or None.

    Returns:
        The record, judged under that model; None where none carries most of the misfit, or it is not beyond doubt.
    """
    limits = selection.settings.outliers
    keys, count = selection.records.keys, selection.records.count
    if count <= limits.fewest:
        return None
    found = {r: measure_record(selection, selection.problem, fitted.solution, r) for r in range(count)}
    excess = sum(m.total - m.degrees for m in found.values())
    likely = sorted(found, key=lambda r: found[r].degrees - found[r].total)[:limits.candidates]
    asides = [set_aside(selection, fitted.solution, r) for r in likely]
    aside = min(asides, key=lambda a: a.rest.total / max(a.rest.degrees, 1))
    left = aside.rest.total - aside.rest.degrees
    if aside.own.p_value * count > limits.p_value or left > (1.0 - limits.removed) * excess:
        return None
    key = keys[aside.record]
    answer = search(selection.campaign.select([k for k in selection.campaign.record_keys if k != key]))
    if answer is None:
        return None
    bench, better = answer
    u = selection.guess.copy()
    for name in better.solution.names:
        u[selection.space.index[name]] = better.solution.u[bench.space.index[name]]
    there = settle(selection.problem, better.solution.names, u, fitted.solution.z)
    suspects = find_suspects(selection, dc.replace(fitted, effects=better.effects, solution=there))
    return next((s for s in suspects if s.sure and s.key == key), None)
