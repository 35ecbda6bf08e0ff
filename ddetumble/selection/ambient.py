"""Pressures that count from another zero in all records: gauge pressures taken for absolute ones, or the reverse.

No record stands out then, and no order of magnitude is odd; but what an atmosphere more or less makes of the force
looks like physics.
"""

import dataclasses as dc
from collections.abc import Callable

from .._errors import ComputationError
from ..measurement.campaign import Campaign
from .data_errors import AMBIENT
from .forward_selection import Path, select_effects
from .problem import Fitted, SelectionProblem
from .settings import SelectionSettings


@dc.dataclass(frozen=True)
class OtherZero:
    """Pressures from another zero, with which a campaign needs less physics than as it is written down."""

    gauge: bool  # whether those written down are gauge pressures; else the atmosphere was added to absolute ones
    effects: tuple[str, ...]  # that are missing beside it


def shift_pressures(campaign: Campaign) -> tuple[Campaign, bool] | None:
    """The campaign with all its pressures, conditions and channels, counted from the other zero, and whether that makes
    gauge pressures of those written down; None where it has none, or one would not stay above nought.
    """
    columns = {**campaign.conditions, **campaign.channels}
    named = [name for name in columns if name.endswith("pressure")]
    if not named:
        return None
    gauge = not any(columns[name].gauge for name in named)
    change, records, samples = AMBIENT if gauge else -AMBIENT, campaign.records.copy(), campaign.samples
    for name in named:
        if name in campaign.conditions:
            records[name] += change
        elif samples is not None:
            samples = samples.assign(**{name: samples[name] + change})
    if any(records[name].min() <= 0.0 for name in named if name in campaign.conditions):
        return None
    return dc.replace(campaign, records=records, samples=samples), gauge


def find_other_zero(campaign: Campaign, path: Path, begin: Callable[[Campaign], tuple[SelectionProblem, Fitted]],
                    settings: SelectionSettings) -> OtherZero | None:
    """The other zero of all pressures, where with it a campaign is explained by less than as it is written down.

    As written the reference model leaves a misfit. From the other zero it leaves none by itself, and predicts left-out
    conditions better than all effects that were found do; or, where what was found leaves a misfit or is not physical,
    it leaves none with effects that predict far better.
    """
    shifted, last = shift_pressures(campaign), path.steps[-1].fitted
    if shifted is None or not path.steps[0].lack.rejected or not path.selection.holds_out:
        return None
    other, gauge = shifted
    try:
        selection, reference = begin(other)
    except ComputationError:
        return None
    if not selection.test_lack_of_fit(reference)[0].rejected:
        return OtherZero(gauge, ()) if reference.merit < last.merit else None
    if path.is_explained():
        return None
    again = select_effects(selection, reference)
    found = again.steps[-1].fitted
    decided = again.is_explained() and found.merit < last.merit - settings.decisive
    return OtherZero(gauge, found.effects) if decided else None
