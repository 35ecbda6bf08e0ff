"""A campaign without its faults: what is found is left out, or fitted along with it, and said."""

import dataclasses as dc
from collections.abc import Mapping, Sequence

import numpy as np

from .._errors import InputError
from ..measurement.campaign import Campaign, thin_campaign
from ..measurement.faults import Fault, find_blind, screen_samples
from .baseline import find_moving_zeros, tell_zero
from .data_errors import find_rate_units
from .lack_of_fit import score_directions
from .leave_record_out import mask_records
from .outliers import Search, Suspect, find_culprit, find_suspects, tell_fault
from .problem import Fitted, SelectionProblem
from .settings import DEFAULT, SelectionSettings


@dc.dataclass(frozen=True)
class Cleaned:
    """A campaign as it is fitted.

    Attributes:
        campaign: faulty samples missing, faulty records left out.
        faults: what was found so far.
        zeros: by channel whose zero and drift are fitted in every record their standard deviations over records, SI.
        keep_all: whether nothing is to be left out: faults are only reported.
        notes: sentences on samples that were not taken because there are so many.
    """

    campaign: Campaign
    faults: tuple[Fault, ...] = ()
    zeros: Mapping[str, tuple[float, float]] = dc.field(default_factory=dict)
    keep_all: bool = False
    notes: tuple[str, ...] = ()


def begin_cleaning(campaign: Campaign, keep_all: bool = False, settings: SelectionSettings = DEFAULT) -> Cleaned:
    """Look at the samples themselves, before any model.

    Raises:
        InputError: No record is left.
    """
    cleaned, faults = screen_samples(campaign, settings.screening)
    lost = (*find_rate_units(campaign, settings.outliers), *find_blind(cleaned))
    faults = (*faults, *lost)
    if keep_all:
        return _thin(Cleaned(campaign, tuple(dc.replace(f, done="Nothing is done about it, as asked.", left_out=False)
                                             for f in faults), keep_all=True), settings.most_samples)
    out = {key for fault in lost for key in fault.records}
    kept = [key for key in cleaned.record_keys if key not in out]
    if not kept:
        raise InputError(f"no record of campaign {campaign.name!r} can be used: {' '.join(map(str, lost))}")
    return _thin(Cleaned(cleaned.select(kept), faults), settings.most_samples)


def _thin(state: Cleaned, most: int) -> Cleaned:
    """No more samples than can be searched."""
    campaign, note = thin_campaign(state.campaign, most)
    return dc.replace(state, campaign=campaign, notes=(note,)) if note else state


def clean_records(state: Cleaned, selection: SelectionProblem, fitted: Fitted, final: bool,
                  search: Search | None = None) -> tuple[Cleaned, bool]:
    """Look for records at fault under a model.

    Args:
        state: so far.
        selection, fitted: a model fitted to `state.campaign`.
        final: whether it is what the search ended with, rather than the reference model.
        search: a model that leaves nothing smooth of another campaign, if any, where none was found of this one.

    Returns:
        What is known now, and whether the campaign has changed, so that everything has to be fitted again.
    """
    suspects = find_suspects(selection, fitted)
    sure = [s for s in suspects if s.sure]
    if search is not None and not sure:
        culprit = find_culprit(selection, fitted, search)
        sure = [] if culprit is None else [culprit]
    zero = None if sure else find_moving_zeros(selection, fitted.solution, final)
    doubtful = [s for s in suspects if not s.sure and not zero and _stands_alone(selection, s)]
    new = [tell_fault(selection, s, state.keep_all) for s in (*sure, *doubtful)]
    new += [tell_zero(selection, zero, state.keep_all)] if zero else []
    known = {_identify(f) for f in state.faults}
    faults = (*state.faults, *(f for f in new if _identify(f) not in known))
    if state.keep_all or not (sure or zero):
        return dc.replace(state, faults=faults), False
    gone = {s.key for s in sure if s.diagnosis.samples is None}
    kept = [key for key in state.campaign.record_keys if key not in gone]
    campaign = _drop_samples(state.campaign, selection, [s for s in sure if s.key not in gone]).select(kept)
    # What was in doubt only beside the culprits is looked at again without them.
    faults = tuple(f for f in faults if f.kind != "doubtful")
    moving = {**state.zeros, zero.channel: zero.spread} if zero else state.zeros
    return dc.replace(state, campaign=campaign, faults=faults, zeros=moving), True


def _identify(fault: Fault) -> tuple:
    """What makes two findings one: what a record is said to have may change from one model to the next."""
    return fault.kind in ("doubtful", "spike") and fault.kind, fault.records, fault.channel


def _drop_samples(campaign: Campaign, selection: SelectionProblem, suspects: Sequence[Suspect]) -> Campaign:
    """The campaign without the samples that are all that is wrong with a record."""
    assert campaign.samples is not None
    samples = campaign.samples.copy()
    for suspect in suspects:
        assert suspect.diagnosis.samples is not None
        rows = np.flatnonzero(samples["record"].to_numpy() == suspect.key)
        for channel, off in zip(selection.records.channels, suspect.diagnosis.samples, strict=True):
            values = samples[channel].to_numpy(dtype=float).copy()
            values[rows[off]] = np.nan
            samples[channel] = values
    return dc.replace(campaign, samples=samples)


def _stands_alone(selection: SelectionProblem, suspect: Suspect) -> bool:
    """Whether nothing that the catalogue holds shows in the records beside it either."""
    problem = mask_records(selection.problem, {suspect.aside.record})
    solution = problem.solve(suspect.aside.solution.names, suspect.aside.solution.u, suspect.aside.solution.z,
                             tolerance=1e-2)
    depth = float(solution.state.max())
    scores = score_directions(problem, solution, selection.list_directions((), depth=depth))
    return selection.calibrate(scores) >= selection.settings.level_each
