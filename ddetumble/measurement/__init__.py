"""What was done on the bench and what was read: campaigns in SI units, from data packages and raw files."""

from .campaign import Campaign, Column, Uncertainty
from .laboratory import import_tests
from .onset import Onset, find_onset
from .package import read_campaign
from .storage import write_campaign


__all__ = [
    "Campaign",
    "Column",
    "Onset",
    "Uncertainty",
    "find_onset",
    "import_tests",
    "read_campaign",
    "write_campaign",
]
