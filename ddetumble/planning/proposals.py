"""What `design` hands to reports and files: plain records, no computation."""

import dataclasses as dc
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from .._display import AbstractPrinted
from ..inference.files import list_versions, make_plain, write_json
from .limits import Extra, Limit


FILE = "design.json"


@dc.dataclass(frozen=True)
class Pair:
    """Two rivals at a proposed test.

    Attributes:
        first, second: their names.
        distance: what one such test leaves between them after either is refitted, the smaller of both ways [standard
            deviations of the noise].
        repeats: of the test until they are told apart; None where no number that can be measured is enough.
    """

    first: str
    second: str
    distance: float
    repeats: int | None


@dc.dataclass(frozen=True)
class Narrowing:
    """How a proposed test narrows one parameter: standard deviation before and after it, in its public unit."""

    name: str
    unit: str
    before: float
    after: float


@dc.dataclass(frozen=True)
class Proposal:
    """One test.

    Attributes:
        conditions: SI, by name.
        extra: channel to add, or None.
        pairs: of rivals, the worst first; empty where there is one model only.
        repeats: after which every pair that can be told apart is; None where no pair can.
        at_limit: conditions that stand at a limit.
        narrowings: of the parameters, where there is one model only, the most narrowed first.
        time: samples of the test [s or m], shape (samples,).
        curves: predicted channels by rival, each shape (channels, samples), SI; `channels` names them.
        noise: standard deviation of one sample by channel, SI.
    """

    conditions: Mapping[str, float]
    extra: Extra | None
    pairs: tuple[Pair, ...]
    repeats: int | None
    at_limit: tuple[str, ...]
    narrowings: tuple[Narrowing, ...]
    time: np.ndarray
    channels: tuple[str, ...]
    curves: Mapping[str, np.ndarray]
    noise: Mapping[str, float]

    @property
    def split(self) -> int:
        """How many pairs it tells apart."""
        return sum(pair.repeats is not None for pair in self.pairs)


@dc.dataclass(frozen=True)
class Design(AbstractPrinted):
    """What to measure next; `to_dict()` is `design.json`.

    Attributes:
        campaign, family, verdict: of the discovery or fit.
        rivals: names of the models that cannot be told apart; one where nothing is confounded.
        limits: within which the test was chosen.
        proposals: the one to take first.
        target: noise variances between two rivals from which they count as told apart.
        sentence: what to do, in plain words.
        notes: further sentences.
    """

    campaign: str
    family: str
    verdict: str
    rivals: tuple[str, ...]
    limits: tuple[Limit, ...]
    proposals: tuple[Proposal, ...]
    target: float
    sentence: str
    notes: tuple[str, ...] = ()

    def __str__(self) -> str:
        """The outcome for a terminal."""
        return "\n".join((self.sentence, *(f"- {note}" for note in self.notes)))

    def to_dict(self) -> dict[str, Any]:
        """Everything but the curves, as JSON can hold it."""
        skip = ("time", "channels", "curves")
        proposals = [{f.name: getattr(p, f.name) for f in dc.fields(p) if f.name not in skip} for p in self.proposals]
        plain = {f.name: getattr(self, f.name) for f in dc.fields(self) if f.name != "proposals"}
        return make_plain({**plain, "proposals": proposals, "versions": list_versions()})

    def save(self, folder: Path | str) -> Path:
        """Write `design.json` into a folder (made if it is not there); returns its path."""
        path = Path(folder) / FILE
        write_json(path, self.to_dict())
        return path
