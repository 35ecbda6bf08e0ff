"""Kinds of tests, one file each: what differs between them is asked of a `Family`, never of its name."""

from ..._errors import InputError
from ...measurement.campaign import Campaign
from .family import Family, Observation, Span, View
from .impact import IMPACT
from .oblique import OBLIQUE
from .slip import SLIP
from .tumble import TUMBLE


FAMILIES: dict[str, Family] = {family.name: family for family in (IMPACT, SLIP, OBLIQUE, TUMBLE)}


def name_family(campaign: Campaign) -> str:
    """Family of a campaign's records: impacts that measure a tangential force at a tangential speed are `oblique`."""
    oblique = "tangential_speed" in campaign.records and "tangential_force" in campaign.channels
    return OBLIQUE.name if campaign.family == OBLIQUE.kind.name and oblique else campaign.family


def find_family(name: str, verb: str = "this") -> Family:
    """The family of that name.

    Raises:
        InputError: `verb` cannot read such records yet.
    """
    if name not in FAMILIES:
        raise InputError(f"the campaign is of family {name!r}; {verb} reads {' and '.join(FAMILIES)} so far")
    return FAMILIES[name]


__all__ = ["FAMILIES", "Family", "Observation", "Span", "View", "find_family", "name_family"]
