"""What was done on the bench and what was read: campaigns in SI units, from data packages and raw files."""

from .campaign import Campaign, Column
from .laboratory import import_tests
from .onset import Onsets, find_onsets
from .package import read_campaign, write_campaign
from .plausibility import Implausibility, check_plausibility
from .recordings import list_channels
from .units import Uncertainty


__all__ = [
    "Campaign",
    "Column",
    "Implausibility",
    "Onsets",
    "Uncertainty",
    "check_plausibility",
    "find_onsets",
    "import_tests",
    "list_channels",
    "read_campaign",
    "write_campaign",
]
