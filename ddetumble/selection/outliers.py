"""A campaign without its faults: records that all others disagree with are left out, a baseline that moves is fitted.

Physics is a smooth trend over the conditions, or shows at an extreme of them, and in repeats alike. A record is at
fault where the others, fitted without it, leave it far more misfit than any of themselves has, although there are
records on all sides of it, or a repeat. At an extreme of the conditions it stays, with a warning, unless what is wrong
with it is plain: a known ratio of units makes it fit, or one gain does down to the noise and the records beside it show
nothing of it.
"""

import dataclasses as dc
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from .._errors import InputError
from ..inference.problem import Solution, mask_records, settle
from ..measurement.campaign import Campaign, thin_campaign
from ..measurement.faults import Fault, find_blind, screen_samples
from ..measurement.quantities import join_words
from .cross_validation import leave_out
from .data_errors import Diagnosis, diagnose, find_moving_zeros, find_rate_units, tell_zero
from .exchanges import find_exchange, tell_exchange
from .lack_of_fit import score_directions
from .leave_record_out import Aside, measure_record, set_aside
from .problem import Fitted, SelectionProblem
from .saturation import find_saturation, tell_saturation
from .settings import DEFAULT, SelectionSettings


WHOLE = 100.0  # weight of the sum of the shares in a mean, against a setting: the sum is one


@dc.dataclass(frozen=True)
class Suspect:
    """A record that disagrees with all others."""

    key: str
    sure: bool  # whether it is at fault beyond doubt
    diagnosis: Diagnosis  # what would make it fit
    aside: Aside  # the fit of the others
    enclosed: bool  # whether there are records on all sides of it, or a repeat
    effects: tuple[str, ...] = ()  # beside which the others were fitted


def find_suspects(selection: SelectionProblem, fitted: Fitted) -> list[Suspect]:
    """Records at fault under a model, worst first; at most one in four, and one that is in doubt at the end."""
    count, limits = selection.records.count, selection.settings.outliers
    found, out = [], set()
    while len(found) < max(1, count // limits.one_in) and count - len(out) >= limits.fewest:
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
    misfit = {r: measure_record(selection, solution, r) for r in kept}
    order = sorted(kept, key=lambda r: misfit[r].degrees - misfit[r].total)
    if misfit[order[0]].p_value * len(kept) > limits.p_value:
        return None
    if len(kept) > limits.every:
        # What bends the fit most may be fitted best itself, and its fault shows in the others.
        loss = leave_out(solution, np.arange(selection.records.count))
        order = list(dict.fromkeys((*order[:limits.candidates], max(kept, key=lambda r: loss[r]))))
    # Without the culprit the others agree best.
    aside, *others = sorted((set_aside(selection, solution, r, out) for r in order), key=lambda one: one.rest.excess)
    if len(kept) <= limits.fewest and any(a.rest.excess < limits.far * max(aside.rest.excess, 1.0) for a in others):
        return None  # nobody can say which of them is wrong
    usual = max(max(m.excess for m in aside.others.values()), 1.0)
    # Noise that is measured beside a poor model is large, and hides in the sum what a single record shows.
    least = min((m.p_value for m in aside.others.values()), default=1.0)
    own, fine = aside.own, aside.rest.p_value > limits.adequate and least * len(kept) > limits.p_value
    if (own.p_value * len(kept) > limits.p_value or own.excess < limits.clear - 1.0
            or not (fine or own.excess > limits.factor * usual)
            or (len(kept) <= limits.fewest and own.excess < limits.farther * usual)):
        return None
    diagnosis = diagnose(selection, aside)
    # A ball that softens reads more in the first test than in its repeats, not less; friction may grow as rubber wears.
    enclosed = is_enclosed(selection, aside, softens=diagnosis.gain >= 1.0 or not selection.family.has_contact)
    alone = selection.family.free_running or diagnosis.kind == "gain"
    sure = enclosed or diagnosis.kind == "unit" or (alone and own.excess > limits.far * usual)
    if not sure and not fine:
        return None
    return Suspect(selection.records.keys[aside.record], sure, diagnosis, aside, enclosed, tuple(fitted.effects))


def is_enclosed(selection: SelectionProblem, aside: Aside, softens: bool = True) -> bool:
    """Whether a record lies among the others: a repeat of it, or records on both sides in all that physics may feel,
    with the settings that the fit gives it, or as they are stated.

    `softens`: whether the ball may have softened from the first test on, so that no later one repeats it.
    """
    r, kept = aside.record, list(aside.others)
    records, names = selection.campaign.records, [str(c) for c in selection.campaign.records.columns]
    if "sequence" in names:
        order = records["sequence"].to_numpy(dtype=float)
        if softens and order[r] <= order[kept].min():
            return False  # what softens does so most from the first test to the second
        names.remove("sequence")
    if names and any(selection.groups[k] == selection.groups[r] for k in kept):
        return True
    settings = [records[name].to_numpy(dtype=float) for name in names if not selection.family.free_running]
    slack = selection.settings.outliers.same
    if _lies_among(selection, aside, settings, aside.solution):
        return True
    # What makes a wrong record fit may move it beyond the others: then its settings as they are stated count, where
    # those of others make them up. At a corner of what was set nothing says that it had to be as the others are.
    if not settings or not _is_made_up(np.stack(settings, axis=1), r, kept, slack):
        return False
    stated = aside.solution.z.copy()
    stated[:, len(selection.records.starts):] = 0.0
    solution = selection.problem.solve(aside.solution.names, aside.solution.u, stated, moving=False)
    return not solution.failed and _lies_among(selection, aside, settings, solution)


def _lies_among(selection: SelectionProblem, aside: Aside, settings: Sequence[np.ndarray], solution: Solution) -> bool:
    """Whether each setting and whatever the model computes for the record lies within those of the others."""
    r, kept, slack = aside.record, list(aside.others), selection.settings.outliers.same
    if selection.family.free_running:
        across = np.sqrt(np.mean(np.sum(solution.channels[:, :2] ** 2, axis=1), axis=-1))
        features = [np.abs(solution.state_rate).max(axis=1), across]
    else:
        series = (solution.state, solution.state_rate, *np.moveaxis(solution.channels, 1, 0))
        features = [*settings, *(np.abs(x).max(axis=1) for x in series), np.asarray(solution.end)]
    return not any(x[r] > x[kept].max() + slack * abs(x[r]) or x[r] < x[kept].min() - slack * abs(x[r])
                   for x in features)


def _is_made_up(settings: np.ndarray, record: int, others: Sequence[int], slack: float) -> bool:
    """Whether a record's settings, shape (records, settings), are a mean of those of others, some counting more."""
    from scipy.optimize import nnls  # which few searches need: its import takes a fifth of a second

    size = np.maximum(np.abs(settings[record]), 1e-300)
    columns = np.vstack([(settings[list(others)] / size).T, np.full(len(others), WHOLE)])
    wanted = np.append(settings[record] / size, WHOLE)
    weights, _ = nnls(columns, wanted)
    return bool(np.all(np.abs(columns @ weights - wanted) <= np.append(np.full(len(size), slack), slack * WHOLE)))


def tell_fault(suspect: Suspect, keep: bool) -> Fault:
    """A suspect in words; `keep` whether every record is to be kept."""
    aside, found = suspect.aside, suspect.diagnosis
    most = max(m.excess for m in aside.others.values()) + 1.0
    size, usual = (_say(np.sqrt(max(x, 0.0))) for x in (aside.own.excess + 1.0, most))
    beside = f", with {join_words(suspect.effects)} added," if suspect.effects else ""
    seen = (f"Record {suspect.key} disagrees with all others: a fit without it{beside} leaves {size} times the noise "
            f"in this record, but no more than {usual} times in any other. {found.text}").rstrip()
    kind, remedy, out = found.kind, found.remedy, False
    if not suspect.sure:
        kind, remedy = "doubtful", "Repeat it."
        done = ("It is kept: no record lies beyond it and none repeats it, so a fault cannot be distinguished from an "
                "effect that shows only there.")
    elif keep:
        done = "It is kept, as asked."
    elif found.samples is not None:
        done = "They are left out, and the record is kept."
    else:
        out, done = True, "It is left out."
        if not suspect.enclosed and kind == "gain":
            done = ("It is left out, although no record lies beyond it: an effect of that size would show in the "
                    "neighbouring records. If a repeat reads the same, the gauge is not the cause.")
    return Fault(kind, (suspect.key,), found.channel, seen, done, remedy, left_out=out)


def _say(size: float) -> str:
    """A size to two digits."""
    return f"{size:.2g}" if size < 100 else f"{float(f'{size:.2g}'):.0f}"


Search = Callable[[Campaign], tuple[SelectionProblem, Fitted] | None]


def find_culprit(selection: SelectionProblem, fitted: Fitted, search: Search) -> Suspect | None:
    """The record without which `search` finds a model that leaves nothing smooth, and that disagrees with all others
    under that model; None where none carries much of the misfit."""
    limits, count = selection.settings.outliers, selection.records.count
    if count < limits.fewest:
        return None
    found = {r: measure_record(selection, fitted.solution, r) for r in range(count)}
    excess = sum(m.total - m.degrees for m in found.values())
    likely = sorted(found, key=lambda r: found[r].degrees - found[r].total)[:limits.candidates]
    aside = min((set_aside(selection, fitted.solution, r) for r in likely), key=lambda one: one.rest.excess)
    left = aside.rest.total - aside.rest.degrees
    removed = min(limits.removed, limits.carried / count)
    if aside.own.p_value * count > limits.p_value or left > (1.0 - removed) * excess:
        return None
    key = selection.records.keys[aside.record]
    answer = search(selection.campaign.select([k for k in selection.campaign.record_keys if k != key]))
    if answer is None:
        return None
    bench, better = answer
    u = selection.guess.copy()
    for name in better.solution.names:
        u[selection.space.index[name]] = better.solution.u[bench.space.index[name]]
    if any(noise.slow_sd for noise in bench.noise.values()):
        noise = {c: one.with_slow_parts(bench.noise[c]) for c, one in selection.noise.items()}
        selection = dc.replace(selection.restack(noise), noise=noise)
    there = settle(selection.problem, better.solution.names, u, fitted.solution.z)
    suspects = find_suspects(selection, dc.replace(fitted, effects=better.effects, solution=there))
    return next((s for s in suspects if s.key == key), None)


@dc.dataclass(frozen=True)
class Cleaned:
    """A campaign as it is fitted: faulty samples missing, faulty records left out."""

    campaign: Campaign
    faults: tuple[Fault, ...] = ()  # found so far
    # By channel whose zero and drift are fitted in every record their standard deviations over records, SI.
    zeros: Mapping[str, tuple[float, float]] = dc.field(default_factory=dict)
    keep_all: bool = False  # whether nothing is to be left out: faults are only reported
    notes: tuple[str, ...] = ()  # on samples that were not taken because there are so many


def begin_cleaning(campaign: Campaign, keep_all: bool = False, settings: SelectionSettings = DEFAULT) -> Cleaned:
    """Look at the samples themselves, before any model; an InputError where no record is left."""
    cleaned, faults = screen_samples(campaign, settings.screening)
    lost = (*find_rate_units(campaign, settings.outliers), *find_blind(cleaned))
    faults = (*faults, *lost)
    if keep_all:
        faults = tuple(dc.replace(f, done="Nothing is done about it, as asked.", left_out=False) for f in faults)
    else:
        out = {key for fault in lost for key in fault.records}
        kept = [key for key in cleaned.record_keys if key not in out]
        if not kept:
            raise InputError(f"no record of campaign {campaign.name!r} can be used: {' '.join(map(str, lost))}")
        campaign = cleaned.select(kept)
    campaign, note = thin_campaign(campaign, settings.most_samples)
    return Cleaned(campaign, faults, keep_all=keep_all, notes=(note,) if note else ())


def clean_records(state: Cleaned, selection: SelectionProblem, fitted: Fitted, final: bool = False,
                  search: Search | None = None) -> tuple[Cleaned, bool]:
    """Look for records at fault under a model; says whether the campaign has changed, so that all is fitted again.

    Args:
        state: so far; `fitted` a model of its campaign.
        final: whether it is what the search ended with, rather than the reference model.
        search: a model that leaves nothing smooth of another campaign, if any, where none was found of this one.
    """
    limit = find_saturation(selection, fitted, {f.channel for f in state.faults if f.kind == "clipped"})
    if limit is not None:  # what is cut off bends everything else
        state = dc.replace(state, faults=(*state.faults, tell_saturation(selection, limit, state.keep_all)))
        if not state.keep_all:
            off = {(key, limit.channel): mask for key, mask in limit.samples.items()}
            return dc.replace(state, campaign=_drop_samples(state.campaign, off)), True
    pair = find_exchange(selection, fitted)
    suspects = [] if pair else find_suspects(selection, fitted)
    sure = [s for s in suspects if s.sure]
    culprit = find_culprit(selection, fitted, search) if search is not None and not (sure or pair) else None
    if culprit is not None and culprit.sure:
        sure = [culprit]
    zero = None if sure or pair else find_moving_zeros(selection, fitted.solution, final)
    doubtful = [culprit] if culprit is not None and not (sure or zero) else []
    for suspect in suspects if not zero else []:
        if suspect.key in {one.key for one in doubtful}:
            continue
        if not suspect.sure:  # it is in doubt only where nothing that the catalogue holds shows in the others either
            problem, at = mask_records(selection.problem, {suspect.aside.record}), suspect.aside.solution
            solution = problem.solve(at.names, at.u, at.z, tolerance=1e-2)
            scores = score_directions(problem, solution, selection.list_directions((), float(solution.state.max())))
            doubtful += [suspect] if selection.calibrate(scores) >= selection.settings.level_each else []
    new = [tell_fault(s, state.keep_all) for s in (*sure, *doubtful)]
    new += [tell_zero(selection, zero, state.keep_all)] if zero else []
    new += [tell_exchange(pair, state.keep_all)] if pair else []
    known = {_identify(f) for f in state.faults}
    faults = (*state.faults, *(f for f in new if _identify(f) not in known))
    if state.keep_all or not (sure or pair or zero):
        return dc.replace(state, faults=faults), False
    gone = {s.key for s in sure if s.diagnosis.samples is None} | set(pair or ())
    kept = [key for key in state.campaign.record_keys if key not in gone]
    off = {(s.key, channel): mask for s in sure if s.diagnosis.samples is not None
           for channel, mask in zip(selection.records.channels, s.diagnosis.samples, strict=True)}
    campaign = _drop_samples(state.campaign, off).select(kept)
    # What was in doubt only beside the culprits is looked at again without them.
    faults = tuple(f for f in faults if f.kind != "doubtful")
    moving = {**state.zeros, zero.channel: zero.spread} if zero else state.zeros
    return dc.replace(state, campaign=campaign, faults=faults, zeros=moving), True


def _identify(fault: Fault) -> tuple:
    """What makes two findings one: what a record is said to have may change from one model to the next."""
    return fault.kind in ("doubtful", "spike") and fault.kind, fault.records, fault.channel


def _drop_samples(campaign: Campaign, off: Mapping[tuple[str, str], np.ndarray]) -> Campaign:
    """The campaign without some samples of records and channels, by key and name, each shape (samples,)."""
    assert campaign.samples is not None
    samples = campaign.samples.copy()
    for (key, channel), gone in off.items():
        values = samples[channel].to_numpy(dtype=float).copy()
        values[np.flatnonzero(samples["record"].to_numpy() == key)[gone]] = np.nan
        samples[channel] = values
    return dc.replace(campaign, samples=samples)
