"""Gauge pressures that were taken for absolute ones in all records.

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


def add_atmosphere(campaign: Campaign) -> Campaign | None:
    """The campaign with an atmosphere added to all its pressures, conditions and channels; None where it has none, or
    the file gave gauge pressures, to which the ambient pressure was added.

    Absolute pressures to which it was added by mistake are not looked for: as far as forces go, that is the effect of
    the ambient pressure, which the catalogue holds.
    """
    columns = {**campaign.conditions, **campaign.channels}
    named = [name for name in columns if name.endswith("pressure")]
    if not named or any(columns[name].gauge for name in named):
        return None
    records, samples = campaign.records.copy(), campaign.samples
    for name in named:
        if name in campaign.conditions:
            records[name] += AMBIENT
        elif samples is not None:
            samples = samples.assign(**{name: samples[name] + AMBIENT})
    return dc.replace(campaign, records=records, samples=samples)


def find_gauge_pressures(campaign: Campaign, path: Path, begin: Callable[[Campaign], tuple[SelectionProblem, Fitted]],
                         settings: SelectionSettings) -> tuple[str, ...] | None:
    """Ids of the effects that are missing if the pressures of a campaign [Pa] are gauge pressures; None where that is
    no better explanation than what was found of it as it is written down.

    As written the reference model leaves a misfit. With the atmosphere added it leaves none by itself, and predicts
    left-out conditions better than all effects that were found do; or, where what was found leaves a misfit or is not
    physical, it leaves none with one effect that predicts far better. Of kinds of test in which the gas bears no load
    a pressure says too little.
    """
    other, last = add_atmosphere(campaign), path.steps[-1].fitted
    asked = path.steps[0].lack.rejected and path.selection.holds_out and path.selection.family.has_contact
    if other is None or not asked:
        return None
    try:
        selection, reference = begin(other)
    except ComputationError:
        return None
    if not selection.test_lack_of_fit(reference)[0].rejected:
        return () if reference.merit < last.merit else None
    if path.is_explained():
        return None
    again = select_effects(selection, reference)
    found = again.steps[-1].fitted
    better = again.is_explained() and found.merit < last.merit - settings.decisive
    return found.effects if better and len(found.effects) == 1 else None
