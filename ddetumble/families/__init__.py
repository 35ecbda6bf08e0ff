"""Kinds of tests, one file each: what differs between them is asked of a `Family`, never of its name.

Attributes:
    FAMILIES: those of the toolkit by their names.
    DEFAULT_FAMILY: name of the one that is meant where nothing says which.
    IMPACT: normal impacts of a ball on a plate.
    SLIP: rubber that slides on a plate.
    OBLIQUE: impacts of a ball that moves along the plate.
    TUMBLE: bodies that turn freely.
"""

from pathlib import Path

from .._errors import InputError
from ..effects.free import Ground
from ..measurement import kinds
from ..measurement.campaign import Campaign
from ..measurement.kinds import RecordKind
from ..measurement.package import read_campaign
from ..reference_models import BuiltinModel
from .family import Family, Observation, PlannedTests, Span, View
from .impact import IMPACT
from .oblique import OBLIQUE
from .slip import SLIP
from .tumble import TUMBLE
from .values import sample_values


FAMILIES: dict[str, Family] = {family.name: family for family in (IMPACT, SLIP, OBLIQUE, TUMBLE)}
DEFAULT_FAMILY = IMPACT.name  # where nothing says which


def list_families() -> tuple[Family, ...]:
    """All families: the toolkit's, and those of the user's own that were given so far."""
    return (*FAMILIES.values(), *(own for own in kinds.list_own() if isinstance(own, Family)))


def name_family(campaign: Campaign) -> str:
    """Family of a campaign's records: impacts that measure a tangential force at a tangential speed are `oblique`."""
    oblique = "tangential_speed" in campaign.records and "tangential_force" in campaign.channels
    return OBLIQUE.name if campaign.family == OBLIQUE.kind.name and oblique else campaign.family


def find_family(name: str, verb: str = "this") -> Family:
    """The family of that name.

    Raises:
        InputError: `verb` cannot read such records yet.
    """
    known = {family.name: family for family in list_families()}
    if name not in known:
        raise InputError(f"the campaign is of the family {name!r}; so far {verb} supports {' and '.join(known)}")
    return known[name]


def open_campaign(campaign: Campaign | str | Path) -> Campaign:
    """A campaign as the verbs take it: read from its folder where it is not in hand, and values, of which a test gives
    one each, as records of a single sample.

    Raises:
        InputError: It cannot be read, or values state no uncertainty and are too few to show their scatter.
    """
    measured = campaign if isinstance(campaign, Campaign) else read_campaign(campaign)
    if measured.samples is not None or measured.peaks is None:
        return measured
    return sample_values(measured, find_family(name_family(measured)))


__all__ = ["DEFAULT_FAMILY", "FAMILIES", "IMPACT", "OBLIQUE", "SLIP", "TUMBLE", "BuiltinModel", "Family", "Ground",
           "Observation", "PlannedTests", "RecordKind", "Span", "View", "find_family", "list_families", "name_family",
           "open_campaign"]
