"""What the discovery of missing physics hands to reports and files: plain records, no computation."""

import dataclasses as dc
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from .._display import AbstractPrinted
from ..families import DEFAULT_FAMILY
from ..inference.files import make_plain


RESULT = "result.json"  # what `save` writes for programs
RIVALS = "rivals"  # folder of the models that the last step could not tell from the best one


@dc.dataclass(frozen=True)
class Trace:
    """One channel of one record beside a model of it; all arrays have shape (samples,).

    Attributes:
        record: key of the record.
        channel: `normal_force`, `depression` or `pressure`.
        unit: SI unit of the channel.
        conditions: of the record, SI.
        time: independent variable since the record's own origin: time [s], or slip [m].
        measured, model: values, SI; nan where a sample is missing.
        sd: standard deviation of the noise, SI.
        state, state_rate: what a misfit is located in: depression and its rate of the model [m, m/s], 0 outside
            contact; of slip records slip since the stroke began, and its speed with the sign of the direction.
        family: of the campaign.
        independent: `time` or `slip`.
    """

    record: str
    channel: str
    unit: str
    conditions: Mapping[str, float]
    time: np.ndarray
    measured: np.ndarray
    model: np.ndarray
    sd: float
    state: np.ndarray
    state_rate: np.ndarray
    family: str = DEFAULT_FAMILY
    independent: str = "time"


@dc.dataclass(frozen=True)
class Estimate:
    """A parameter with its uncertainty, in its public unit."""

    estimate: float
    sd: float
    q025: float
    q975: float
    unit: str
    text: str = ""


@dc.dataclass(frozen=True)
class SettingShift:
    """How far one setting (a condition, or the time origin) was moved from what was written down.

    Attributes:
        name: of the condition, or `time`.
        stated: standard deviation that the campaign states, SI, the median over records.
        rms, largest: shifts in stated deviations: their root mean square over records, and the largest with its sign.
        record: key of the record with the largest.
        p_value: chance of so large shifts where the settings are as uncertain as stated. A fit pulls settings back to
            what is written down, so that true errors are larger than the shifts, and the p-value is on the safe side.
        shifts: of every record, in stated deviations, shape (records,).
    """

    name: str
    stated: float
    rms: float
    largest: float
    record: str
    p_value: float
    shifts: np.ndarray = dc.field(repr=False, compare=False)


@dc.dataclass(frozen=True)
class LackOfFit:
    """Whether a misfit beyond noise and setting errors is left.

    Attributes:
        statistic: chi-square of the smooth part of the residuals over its degrees of freedom.
        degrees: degrees of freedom.
        p_value: that decides: of the smallest of the three below, counted three times (Bonferroni).
        level: level at which it is judged.
        rejected: whether the model lacks something: `p_value` below `level`.
        smooth_p_value: of the statistic.
        score_p_value: family-wise p-value of the largest score of any effect not in the model.
        settings_p_value: of how far the settings of the records were moved from what was written down.
        text: how it was computed, one sentence.
    """

    statistic: float
    degrees: float
    p_value: float
    level: float
    rejected: bool
    smooth_p_value: float
    score_p_value: float
    settings_p_value: float
    text: str = ""


@dc.dataclass(frozen=True)
class Step:
    """One model of the loop: the reference model, or that with one more effect.

    Attributes:
        added: id of the effect added at this step (None for the reference model).
        effects: all effects in the model.
        chi2_reduced: chi-square of the whitened residuals and nuisances over degrees of freedom.
        nrmse: rms residual over rms signal, fitted.
        heldout_nrmse: the cross-validated error: every condition by the model fitted without it, its own settings
            adjusted within their stated uncertainty.
        prediction_nrmse: the prediction error: the same from its settings as they are written down;
            `prediction_coverage` is the share of samples within the predicted 95 % interval.
        alternatives: confusion set of the added effect: dicts with `effect`, `heldout_difference`, `standard_error`.
        lack_of_fit: whether something is still missing.
        parameters: estimates by public name.
        correlations: strongest correlations, (name, name, value).
        traces: model beside measurement, every record and channel.
        converged: state of the optimiser.
        shifts: how far the settings of the records were moved.
        held_nrmse: `nrmse` of the model refitted with every condition as it is written down; None where the shifts are
            no further than chance moves them.
    """

    added: str | None
    effects: tuple[str, ...]
    chi2_reduced: float
    nrmse: float
    heldout_nrmse: float
    alternatives: tuple[Mapping[str, Any], ...]
    lack_of_fit: LackOfFit
    parameters: Mapping[str, Estimate]
    correlations: tuple[tuple[str, str, float], ...]
    traces: tuple[Trace, ...]
    converged: bool
    shifts: tuple[SettingShift, ...] = ()
    held_nrmse: float | None = None
    prediction_nrmse: float = float("nan")
    prediction_coverage: float = float("nan")


@dc.dataclass(frozen=True)
class Candidate:
    """One effect of the catalogue as it stood at the first step (fields as in `formats.md`).

    `cosines` holds |cos| of its projected signature with those of other effects (only where above 0.5);
    `heldout_difference` and `standard_error` compare it with the best candidate (0 for the best). `smallest_detectable`
    are values of its amplitudes, in `units`, that would have been found with 95 % power; one of which no value within
    its physical limits would be is not among them, and none is where the records do not fix the reference model.
    `beyond` names the estimates that lie wholly beyond their physical limits.
    """

    effect: str
    p_value: float
    explains: float
    visible: float
    heldout_nrmse: float
    smallest_detectable: Mapping[str, float]
    indistinguishable_from: tuple[str, ...]
    estimates: Mapping[str, Estimate]
    heldout_difference: float
    standard_error: float
    cosines: Mapping[str, float]
    text: str = ""
    units: Mapping[str, str] = dc.field(default_factory=dict)
    beyond: tuple[str, ...] = ()
    prediction_nrmse: float = float("nan")
    prediction_coverage: float = float("nan")


@dc.dataclass(frozen=True)
class Place:
    """Where a misfit sits: a range of one variable, with the share of its channel's misfit that lies in it.

    `period` where it repeats; `removes`, where a simple force of this variable was fitted, is the share of the whole
    misfit (chi-square above noise) that it removes.
    """

    channel: str
    variable: str
    range: tuple[float, float]
    phase: str
    share: float
    period: float | None = None
    removes: float | None = None


@dc.dataclass(frozen=True)
class Law:
    """A simple law that would draw a missing force.

    Attributes:
        text: the law in one line.
        variables, ways, phases, forms: of its terms: variable, direction, phase (`` for both), name of the form.
        parameters: estimates by symbol, SI.
        loss, losses: held out, all and by condition, in noise variances.
        chi2: of the fit to all records, in noise variances.
        count: parameters that were fitted.
        converged: state of the optimiser.
        difference, standard_error: of the held-out loss from that of the first law.
    """

    text: str
    variables: tuple[str, ...]
    ways: tuple[str, ...]
    phases: tuple[str, ...]
    forms: tuple[str, ...]
    parameters: Mapping[str, Estimate]
    loss: float
    losses: np.ndarray
    chi2: float
    count: int
    converged: bool
    difference: float
    standard_error: float


@dc.dataclass(frozen=True)
class Shape:
    """A missing force drawn over one variable.

    Attributes:
        variable, way: what it depends on, and the direction: `force`, `share`, `torque`, `drag`, ...
        parts: one name a curve: phases, axes, or `` for one curve.
        x: places, shape (places,), SI.
        values, sd: of the force (a share: at the largest force or load), shape (parts, places), SI.
        visited: share of the samples near each place, shape (places,).
        unit: of the values; `share` says of which force they are a share.
        intervals: of the spline.
        visible: share of its signature that is left when the model's parameters and the settings may imitate it.
        loss: held out, in noise variances; `difference`, `standard_error` from that of the best shape.
        begins: place from which on it is told from zero up to the end, None where there is none.
        centred: whether it is known up to a constant only, and drawn about its mean.
        spectrum: wave numbers [1/unit of x], amplitudes and their standard deviations, shape (3, lines); empty where
            the variable is a condition.
    """

    variable: str
    way: str
    parts: tuple[str, ...]
    x: np.ndarray
    values: np.ndarray
    sd: np.ndarray
    visited: np.ndarray
    unit: str
    intervals: int
    visible: float
    loss: float
    difference: float
    standard_error: float
    begins: float | None
    centred: bool
    spectrum: np.ndarray


@dc.dataclass(frozen=True)
class MissingForce(AbstractPrinted):
    """What a flexible force inside the equation of motion removes of a misfit, and what it looks like.

    Losses are held out, over whole conditions, in noise variances: `floor` is what noise alone leaves of them.

    Attributes:
        effects: of the model beside which the force was drawn.
        reference, model: losses of the reference model and of that model.
        catalogue: effect that does best of the catalogue, and its loss; None where that was not asked for.
        ceiling: loss with the best flexible force, and what that depends on; None where none helps.
        floor: number of samples.
        shapes: one-variable forces, best first; those that the best does not beat are in `alike`.
        laws: simple laws, best first.
        lone: records of the one condition in which nearly all the misfit lies; empty where several show it.
        sentence, notes: in plain words.
    """

    family: str
    effects: tuple[str, ...]
    reference: float
    model: float
    catalogue: tuple[str, float] | None
    ceiling: tuple[tuple[str, ...], float] | None
    floor: float
    shapes: tuple[Shape, ...]
    alike: tuple[str, ...]
    laws: tuple[Law, ...]
    sentence: str = ""
    notes: tuple[str, ...] = ()
    lone: tuple[str, ...] = ()

    def share(self, loss: float) -> float:
        """Share of the reference model's misfit that is removed where this loss is left."""
        return float(np.clip((self.reference - loss) / max(self.reference - self.floor, 1e-300), 0.0, 1.0))

    def __str__(self) -> str:
        """The sentence and its notes, one a line."""
        return "\n".join((self.sentence, *(f"- {note}" for note in self.notes)))

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers, text, lists."""
        found = make_plain(self)
        for law in found["laws"]:
            del law["losses"]
        shares = {"model": self.model} | ({} if self.catalogue is None else {"catalogue": self.catalogue[1]})
        shares |= {} if self.ceiling is None else {"ceiling": self.ceiling[1]}
        return {**found, "shares": {name: self.share(loss) for name, loss in shares.items()}}


def list_shifts(shifts: Sequence[SettingShift]) -> dict[str, dict[str, Any]]:
    """Shifts of the settings by name, as `result.json` has them: SI, and stated deviations."""
    return {s.name: {"stated": s.stated, "rms_shift": s.rms, "largest_shift": s.largest, "record": s.record,
                     "p_value": s.p_value} for s in shifts}
