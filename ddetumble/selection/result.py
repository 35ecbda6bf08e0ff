"""What the discovery of missing physics hands to reports and files: plain records, no computation."""

import dataclasses as dc
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from .._display import AbstractPrinted
from ..families import DEFAULT_FAMILY
from ..inference.files import make_plain
from .settings import DEFAULT, SelectionSettings


# Share of the mean square of shifts that is their mean, from which on records are shifted alike (they then scatter by
# less than a third of it), and records from which on that can be said.
ALIKE, FEWEST_ALIKE = 0.9, 3
RESULT = "result.json"  # what `save` writes for programs
OPEN = ("improved", "unexplained")  # verdicts that leave a misfit
RIVALS = "rivals"  # folder of the models that could not be told from the best one
EXPLANATIONS = "explanations"  # folder of the models between which a verdict leaves open


@dc.dataclass(frozen=True)
class Trace:
    """One channel of one record beside a model of it; SI, all arrays have shape (samples,)."""

    record: str
    channel: str
    unit: str
    conditions: Mapping[str, float]
    time: np.ndarray  # independent variable since the record's own origin: time [s], or slip [m]
    measured: np.ndarray  # nan where a sample is missing
    model: np.ndarray
    sd: float  # of the noise, rms where its size varies
    # What a misfit is located in: depression and its rate of the model [m, m/s], 0 outside contact; of slip records
    # slip since the stroke began, and its speed with the sign of the direction.
    state: np.ndarray
    state_rate: np.ndarray
    family: str = DEFAULT_FAMILY
    independent: str = "time"  # or `slip`
    sizes: np.ndarray | None = None  # of the noise of every sample over `sd`; None where all are alike

    @property
    def is_value(self) -> bool:
        """Whether it is one number of a test, such as a peak, and no curve."""
        return np.size(self.time) <= 1


@dc.dataclass(frozen=True)
class Estimate:
    """A parameter with its uncertainty, in its public unit.

    Where the records do not determine it, its deviation and interval are only wide enough to say so.
    """

    estimate: float
    sd: float
    q025: float
    q975: float
    unit: str
    text: str = ""
    determined: bool = True


@dc.dataclass(frozen=True)
class SettingShift:
    """How far one setting (a condition, or the time origin) was moved from what was written down, in stated deviations.

    A fit pulls settings back to what is written down, so that true errors are larger than the shifts, and the p-value
    is on the safe side.
    """

    name: str  # of the condition, or `time`
    stated: float  # standard deviation that the campaign states, SI, the median over records
    rms: float  # over records
    largest: float  # with its sign
    record: str  # key of the record with the largest
    p_value: float  # chance of so large shifts where the settings are as uncertain as stated
    shifts: np.ndarray = dc.field(repr=False, compare=False)  # of every record, shape (records,)
    # Mean over records as a share of the setting, with its sign; None of the time origin, or where a setting is 0.
    mean_share: float | None = None

    @property
    def is_alike(self) -> bool:
        """Whether all records are shifted alike, as by one gauge that reads wrong."""
        moved = np.asarray(self.shifts, dtype=float)
        return (self.mean_share is not None and moved.size >= FEWEST_ALIKE
                and float(np.mean(moved)) ** 2 >= ALIKE * float(np.mean(moved**2)))


@dc.dataclass(frozen=True)
class Rounding:
    """Effects that change the readings by no more than the digits of the gauge may do to their mean."""

    effects: tuple[str, ...]
    digits: dict[str, float]  # of the channels in which the effects are seen, by name, SI


@dc.dataclass(frozen=True)
class SettingSpread:
    """How much a setting scatters beyond what the campaign states, estimated from the records themselves."""

    name: str  # of the condition, or `time`
    stated: float  # standard deviation that the campaign states, the median over records
    found: float  # the one that the records show, in the same unit
    ratio: float  # of the two
    relative: bool  # whether both are shares of the setting; else SI


@dc.dataclass(frozen=True)
class LackOfFit:
    """Test for lack of fit beyond noise and setting errors."""

    statistic: float  # chi-square of the smooth part of the residuals over its degrees of freedom
    degrees: float  # of freedom
    p_value: float  # that decides: of the smallest of those below, counted as often as there are (Bonferroni)
    level: float  # at which it is judged
    rejected: bool  # whether the model lacks something: `p_value` below `level`
    smooth_p_value: float  # of the statistic
    score_p_value: float  # family-wise, of the largest score of any effect not in the model
    settings_p_value: float  # of how far the settings of the records were moved from what was written down
    text: str = ""  # how it was computed, one sentence
    # Of nothing in the residuals repeating over the records; None where noise and settings are taken as stated, or it
    # cannot be judged.
    repeats_p_value: float | None = None
    # Whether the residuals leave anything for the statistic to test: values whose own scatter is the noise may not.
    tested: bool = True


@dc.dataclass(frozen=True)
class Step:
    """One model of the loop: the reference model, or that with one more effect. Errors are rms over rms signal."""

    added: str | None  # id of the effect added at this step (None for the reference model)
    effects: tuple[str, ...]  # all in the model
    chi2_reduced: float  # of the whitened residuals and nuisances over degrees of freedom
    nrmse: float  # fitted
    heldout_nrmse: float  # cross-validated: every condition without it, its settings adjusted as far as stated
    alternatives: tuple[Mapping[str, Any], ...]  # confusion set: `effect`, `heldout_difference`, `standard_error`
    lack_of_fit: LackOfFit
    parameters: Mapping[str, Estimate]
    correlations: tuple[tuple[str, str, float], ...]  # strongest first: (name, name, value)
    traces: tuple[Trace, ...]  # every record and channel
    converged: bool
    shifts: tuple[SettingShift, ...] = ()
    held_nrmse: float | None = None  # refitted with conditions as written down; None where shifts are within chance
    held_ratio: float | None = None  # the same over the noise, every channel with the same weight
    prediction_nrmse: float = float("nan")  # cross-validated from settings as they are written down
    prediction_coverage: float = float("nan")  # share of samples within the predicted 95 % interval


@dc.dataclass(frozen=True)
class Candidate:
    """One effect of the catalogue as it stood at the first step (fields as in `formats.md`)."""

    effect: str
    p_value: float
    explains: float
    visible: float
    heldout_nrmse: float
    # Values of its amplitudes, in `units`, that would have been found with 95 % power; one of which no value within its
    # physical limits would be is not among them, and none is where the records do not fix the reference model.
    smallest_detectable: Mapping[str, float]
    indistinguishable_from: tuple[str, ...]
    estimates: Mapping[str, Estimate]
    heldout_difference: float  # from the best candidate (0 for the best), and its standard error
    standard_error: float
    cosines: Mapping[str, float]  # |cos| of its projected signature with those of other effects, where above 0.5
    text: str = ""
    units: Mapping[str, str] = dc.field(default_factory=dict)
    beyond: tuple[str, ...] = ()  # estimates that lie wholly beyond their physical limits
    prediction_nrmse: float = float("nan")
    prediction_coverage: float = float("nan")


@dc.dataclass(frozen=True)
class Place:
    """Where a misfit lies: a range of one variable, with the share of its channel's misfit within it."""

    channel: str
    variable: str
    range: tuple[float, float]
    phase: str
    share: float
    period: float | None = None  # where it repeats
    removes: float | None = None  # share of the misfit that a simple force of this variable, where fitted, removes


@dc.dataclass(frozen=True)
class Law:
    """A simple law that would draw a missing force; losses are held out, in noise variances."""

    text: str  # in one line
    variables: tuple[str, ...]  # of its terms; so are direction, phase (`` for both) and name of the form
    ways: tuple[str, ...]
    phases: tuple[str, ...]
    forms: tuple[str, ...]
    parameters: Mapping[str, Estimate]  # by symbol, SI
    loss: float
    losses: np.ndarray  # by condition
    chi2: float  # of the fit to all records
    count: int  # parameters that were fitted
    converged: bool
    difference: float  # of the loss from that of the first law, and its standard error
    standard_error: float


@dc.dataclass(frozen=True)
class Shape:
    """A missing force drawn over one variable; losses are held out, in noise variances."""

    variable: str
    way: str  # the direction: `force`, `share`, `torque`, `drag`, ...
    parts: tuple[str, ...]  # one name a curve: phases, axes, or `` for one curve
    x: np.ndarray  # places, shape (places,), SI
    values: np.ndarray  # of the force (a share: at the largest force or load), shape (parts, places), SI
    sd: np.ndarray
    visited: np.ndarray  # share of the samples near each place, shape (places,)
    unit: str  # of the values; `share` says of which force they are a share
    intervals: int  # of the spline
    visible: float  # share of its signature that is left when the model's parameters and settings may imitate it
    loss: float
    difference: float  # from that of the best shape, and its standard error
    standard_error: float
    begins: float | None  # place from which on it is told from zero up to the end
    centred: bool  # whether it is known up to a constant only, and drawn about its mean
    # Wave numbers [1/unit of x], amplitudes and their deviations, shape (3, lines); empty over a condition.
    spectrum: np.ndarray


@dc.dataclass(frozen=True)
class MissingForce(AbstractPrinted):
    """A non-parametric missing force: the share of the misfit that it explains, its shape, and laws that describe it.

    Losses are held out, over whole conditions, in noise variances.
    """

    family: str
    effects: tuple[str, ...]  # of the model beside which the force was drawn
    reference: float  # loss of the reference model
    model: float  # loss of the model with these effects
    catalogue: tuple[str, float] | None  # effect that does best, and its loss; None where that was not asked for
    ceiling: tuple[tuple[str, ...], float] | None  # what the best force depends on, and its loss; None where none helps
    floor: float  # number of samples: what noise alone leaves
    shapes: tuple[Shape, ...]  # forces of one variable, best first
    alike: tuple[str, ...]  # those that the best does not beat
    laws: tuple[Law, ...]  # best first
    sentence: str = ""
    notes: tuple[str, ...] = ()
    lone: tuple[str, ...] = ()  # records of the one condition in which nearly all the misfit lies
    settings: SelectionSettings = DEFAULT  # with which it was drawn

    def share(self, loss: float) -> float:
        """Share of the reference model's misfit that is removed where this loss is left."""
        return float(np.clip((self.reference - loss) / max(self.reference - self.floor, 1e-300), 0.0, 1.0))

    def __str__(self) -> str:
        """The sentence and its notes, one a line."""
        return "\n".join((self.sentence, *(f"- {note}" for note in self.notes)))

    def to_dict(self, settings: bool = True) -> dict[str, Any]:
        """Plain numbers, text, lists; with the thresholds unless they stand beside it."""
        found = make_plain(self)
        thresholds = found.pop("settings")
        if settings:
            found["settings"] = {"thresholds": thresholds}
        for law in found["laws"]:
            del law["losses"]
        losses = {"model": self.model, "catalogue": self.catalogue and self.catalogue[1],
                  "ceiling": self.ceiling and self.ceiling[1]}
        return {**found, "shares": {name: self.share(loss) for name, loss in losses.items() if loss is not None}}


def list_shifts(shifts: Sequence[SettingShift]) -> dict[str, dict[str, Any]]:
    """Shifts of the settings by name, as `result.json` has them: SI, and stated deviations."""
    return {s.name: {"stated": s.stated, "rms_shift": s.rms, "largest_shift": s.largest, "record": s.record,
                     "p_value": s.p_value, "mean_share": s.mean_share, "alike": s.is_alike} for s in shifts}
