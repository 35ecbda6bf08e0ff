"""What a campaign may have stated wrongly once and for all: gauge pressures as absolute ones, a radius as a diameter,
another axis as that of symmetry.

No record stands out then, and no order of magnitude is odd; but what an atmosphere too little, or half a diameter,
makes of the force looks like physics, and so do unequal moments of inertia.
"""

import dataclasses as dc
from collections.abc import Callable
from typing import Any

from .._display import Progress, nest_progress, stay_silent
from .._errors import ComputationError
from ..measurement.campaign import Campaign
from ..measurement.kinds import find_kind, turn_name
from .data_errors import AMBIENT
from .effort import may_search
from .forward_selection import Path, select_effects
from .problem import Fitted, SelectionProblem
from .settings import SelectionSettings


@dc.dataclass(frozen=True)
class Restatement:
    """A campaign with one thing stated otherwise: its pressures, all known diameters, or the axis of symmetry."""

    macro: str  # of the question, among the verdict's sentences
    facts: dict[str, Any]  # that the question names
    campaign: Campaign
    as_likely: bool = False  # as what is written down, of which nothing measured is the reason


def list_restatements(campaign: Campaign) -> list[Restatement]:
    """All that are worth a question, the likeliest first."""
    kind = find_kind(campaign.family)
    if kind.rates:
        there = {*campaign.channels, *campaign.conditions}
        if any(turn_name(name, "x") not in there for name in there) or not there & {*kind.rates}:
            return []  # an axis was not measured
        return [Restatement("another_axis", {"axis": axis}, turn_campaign(campaign, axis), True) for axis in "xy"]
    if not kind.has_contact:
        return []  # the gas bears no load, and pressure and size of a ball say too little
    raised = add_atmosphere(campaign)
    found = [] if raised is None else [Restatement("gauge_pressures", {}, raised)]
    known = {name: value for name, value in campaign.known.items() if name.endswith("diameter") and value}
    for factor in (2.0, 0.5) if known else ():
        other = {name: factor * value for name, value in known.items()}
        facts = {"doubled": factor > 1.0, "values": [f"{n}={1e3 * v:.6g} mm" for n, v in other.items()]}
        found.append(Restatement("another_diameter", facts, dc.replace(campaign, known={**campaign.known, **other})))
    return found


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


def turn_campaign(campaign: Campaign, axis: str) -> Campaign:
    """The campaign with its axes exchanged so that this one becomes z, the axis of symmetry."""
    def turn(columns):
        return {name: dc.replace(columns[turn_name(name, axis)], name=name) for name in columns}

    def move(frame):
        return frame.assign(**{name: frame[turn_name(name, axis)] for name in frame})

    return dc.replace(campaign, channels=turn(campaign.channels), conditions=turn(campaign.conditions),
                      records=move(campaign.records),
                      samples=None if campaign.samples is None else move(campaign.samples))


def find_restatement(campaign: Campaign, path: Path, begin: Callable[[Campaign], tuple[SelectionProblem, Fitted]],
                     shared: bool, settings: SelectionSettings, report: Progress = stay_silent
                     ) -> tuple[Restatement, tuple[str, ...]] | None:
    """What was stated wrongly throughout a campaign, if anything, and the ids of the effects that are missing then;
    None where nothing stated otherwise is a better explanation than what was found of it as it is written down.

    As written the reference model leaves a misfit. Stated otherwise it leaves none by itself, and predicts left-out
    conditions better than all effects that were found do. Or it leaves none with one effect: with any that predicts far
    better than what was found, where that leaves a misfit or is not physical; else with one of several that were found,
    or without the error of a setting that records share (`shared`), where it predicts better than all that together.
    One as likely as what is written down is asked about, too, where it needs fewer effects and predicts as well.
    Of several restatements the one that predicts best is told.
    """
    asked = path.steps[0].lack.rejected and path.selection.holds_out
    first, last, explained = path.steps[0].fitted, path.steps[-1].fitted, path.is_explained()
    found: list[tuple[float, Restatement, tuple[str, ...]]] = []
    for restated in list_restatements(campaign) if asked else ():
        try:
            selection, reference = begin(restated.campaign)
        except ComputationError:
            continue
        likely = restated.as_likely
        if likely and reference.merit > first.merit - settings.decisive:
            continue
        # Fewer effects that predict no worse, beyond chance, are the better explanation.
        margin = settings.decisive if not explained else -settings.significant if likely else settings.significant
        if not selection.test_lack_of_fit(reference)[0].rejected:
            if reference.merit < last.merit + (settings.significant if likely and explained else 0.0):
                found.append((reference.merit, restated, ()))
        elif (not explained or len(last.effects) + shared > 1) and may_search(
                "a search with pressures, diameters or axes stated otherwise"):
            listed = tuple(e for e in selection.catalogue if e.id in last.effects) if explained else selection.catalogue
            again = select_effects(dc.replace(selection, catalogue=listed), reference,
                                   nest_progress(report, "stated otherwise", 0.877, 0.877),
                                   most=max(len(last.effects) - 1, 1) if likely else 1)
            grown = again.steps[-1].fitted
            whole = dc.replace(again.selection, catalogue=selection.catalogue)
            complete = again.is_explained() and not whole.test_lack_of_fit(grown)[0].rejected
            if complete and grown.merit < last.merit - margin:
                found.append((grown.merit, restated, grown.effects))
    best = min(found, key=lambda one: one[0], default=None)
    return None if best is None else best[1:]
