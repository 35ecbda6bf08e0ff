"""What a family of tests is: everything that differs between kinds of records, gathered on one object.

A kind of test is one `Family`, written in one file and listed in `FAMILIES`; no other file asks for its name. One of
the user's own is listed nowhere: it is given as the object or as `FILE.py:NAME`, which its campaigns hold.
"""

import dataclasses as dc
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Array

from .._errors import InputError
from ..contact.effect import AbstractEffect, AbstractModel, family_of
from ..effects.free import Ground
from ..measurement.campaign import Campaign
from ..measurement.kinds import RecordKind
from ..measurement.quantities import join_words
from ..reference_models import BuiltinModel


SPLINES = 20  # over a contact or a stroke: what a missing force leaves is smooth between them
BLIND = 3.0  # deviations of the time origin within which a sample may lie on either side of first touch


class Observation(NamedTuple):
    """One record as the model has it.

    Attributes:
        channels: shape (channels, samples), SI.
        state, state_rate: what a misfit is located in, shape (samples,).
        end: of the contact or record, in the independent variable.
        failed: whether it could not be computed.
    """

    channels: Array
    state: Array
    state_rate: Array
    end: Array
    failed: Array


class Path(NamedTuple):
    """How a record with strokes moved, by sample, each shape (samples,)."""

    distance: np.ndarray  # since its stroke began, SI
    direction: np.ndarray  # 1 or -1
    number: np.ndarray  # of the stroke, from 0 on


class Starts(NamedTuple):
    """What free-running records start from."""

    guesses: dict[str, np.ndarray]  # by name, each shape (records,), SI
    deviations: np.ndarray  # so wide that they are no prior, shape (records, starts)
    inputs: dict[str, np.ndarray]  # of `Family.lay_inputs` for these records


class Ratio(NamedTuple):
    """A coefficient that is drawn beside a fit: what a channel is, measured by a condition of its record."""

    name: str  # in words
    channel: str
    load: str  # the condition


class Span(NamedTuple):
    """A stretch of a record, after `low` up to `high`, over which a missing force is smooth: `splines` of them do."""

    low: float
    high: float
    splines: int


@dc.dataclass(frozen=True)
class View:
    """How records are drawn and spoken of.

    Attributes:
        force: channel whose residual is the missing force; empty where none is.
        along: quantity along a record, the independent variable.
        state: quantity that a misfit is located in, `Trace.state`.
        rate: its rate or direction, `Trace.state_rate`; empty where it says nothing.
        phases: names of the two halves that are drawn apart; empty where there is but one.
        variables: against which residuals are drawn before the conditions; `time` is the share of the record.
        share: label of the share of the record.
        ends: names of its beginning and end.
        reach: shares between which the map of residuals is drawn.
        bins: in which residuals over the state are averaged.
        conditions: how many of the conditions make up a cell of the grid of errors.
        strongest: whether lines are drawn by the condition that the misfit depends on most, not by the first one.
        series: what `sequence` counts.
        apart: words for how phases are told apart, empty without phases.
        free: parameters of the reference model, as a sentence names them.
        longest: last value along the records, which decides on the unit of their time.
    """

    force: str = ""
    along: str = "time"
    state: str = "time"
    rate: str = ""
    phases: tuple[str, ...] = ()
    variables: tuple[str, ...] = ("time",)
    share: str = "share of the record"
    ends: tuple[str, str] = ("start", "end")
    reach: tuple[float, float] = (0.0, 1.0)
    bins: int = 20
    conditions: int = 2
    strongest: bool = True
    series: str = "record of the series"
    apart: str = ""
    free: str = ""
    longest: float = 0.0

    @property
    def wide(self) -> bool:
        """Whether the bins over the state need the room of two panels."""
        return self.bins > 20


@dc.dataclass(frozen=True)
class PlannedTests:
    """What tests of a family that nobody has made yet are like, where nothing else is said.

    Attributes:
        chosen: conditions that the next test may choose.
        added: further channels that it could measure, with their noise.
        noise: of the channels that are measured in any case.
        uncertainties: with which conditions are set, and of the time origin.
        interval: between samples.
        length: of a record; None where it lasts as long as its contact.
    """

    chosen: tuple[str, ...]
    added: Mapping[str, str]
    noise: Mapping[str, str]
    uncertainties: Mapping[str, str]
    interval: str
    length: str | None


@dc.dataclass(frozen=True, kw_only=True)
class Family:
    """A family of records.

    What a family is like is asked by three properties: its records hold one contact (`has_contact`), or strokes that
    may turn round (`has_strokes`), or run on by themselves from where they start (`free_running`).

    Attributes:
        name: of the family; `oblique` for impacts with a tangential speed and force.
        kind: of its records, as campaigns hold them; that of several families may be one.
        independent: what the model's records are a function of: `time` [s] or `slip` [m].
        channels: that the models predict, the main one first.
        needs: conditions without which nothing can be computed.
        defaults: values of conditions that a campaign does not have, SI.
        sizes: to which the number of samples is padded, so that compiled programs are shared.
        models: reference models by name, the usual one first.
        accepts: families of the effects that may act on its records.
        catalogue, directions: effects.
        state, rate: names of what a misfit is located in, and of its rate; `phases` of a positive and a negative rate.
        observe: computes one record from a law, its conditions, sample times, its row of the stack, and channels.
        lay_spans: stretches of a record over which a missing force is smooth, from the times of its samples, shape
            (samples,), its values, shape (channels, samples), the numbers of their strokes, shape (samples,), and the
            end of the contact.
        view: how records are drawn and spoken of; `view_reversed` where strokes go both ways.
        plan: what tests are like that nobody has made yet.
        ground: what a missing force may depend on; None where it cannot be drawn yet.
        remedies: what else to measure, in words, beside the channels that its plan says could be added.
        model_hint: how to make a model of the family of one of another, in words that end a sentence.
        pace: condition that is the change of the independent variable in a second, where that is no time.
        follow: path of a record, from its campaign, its key and its table of samples over time; None where the records
            have no strokes.
        check: refuses a campaign whose records contradict the models.
        guess_starts: coordinates from which fits begin, the likeliest first, from a campaign, a `ParameterSpace`, the
            given coordinates and the names of the free parameters.
        begin: what the records of a campaign start from, given the tables of their samples; None where each starts
            from its conditions.
        lay_inputs: further arrays that `observe` reads from its row of the stack (`inputs`), one row a record, from the
            times and conditions of records that are to be computed.
        rows: to which the number of records is padded.
        starts: what a record starts from: nuisances without a prior, free in every record; `further_starts` those that
            are there only where the channels that show them are.
        slots: to which the number of free parameters is padded.
        values: channels of which a test gives one number, such as its rebound speed. A campaign may hold these alone.
        jumping: channels that may jump at first touch, as friction does, or the force of a dashpot.
        place_values: where in a record its values stand, in its independent variable, from a table of them.
        ratio: coefficient that its records are spoken of in, such as that of friction; None where there is none.
    """

    name: str
    kind: RecordKind
    independent: str
    channels: tuple[str, ...]
    needs: tuple[str, ...]
    sizes: tuple[int, ...]
    models: Mapping[str, BuiltinModel]
    accepts: tuple[str, ...]
    catalogue: tuple[type[AbstractEffect], ...]
    directions: tuple[type[AbstractEffect], ...]
    state: str
    rate: str
    phases: tuple[str, str]
    observe: Callable[[Any, Mapping[str, Array], Array, Any, tuple[str, ...]], Observation]
    lay_spans: Callable[[np.ndarray, np.ndarray, np.ndarray, float], list[Span]]
    view: View
    plan: PlannedTests
    remedies: str
    ground: Ground | None = None
    view_reversed: View | None = None
    model_hint: str = ""
    pace: str = ""
    defaults: Mapping[str, float] = dc.field(default_factory=dict)
    follow: Callable[[Campaign, str, Any], Path] | None = None
    check: Callable[[Campaign], None] = lambda campaign: None
    guess_starts: Callable[[Campaign, Any, np.ndarray, Sequence[str]], list[np.ndarray]] = (
        lambda campaign, space, start, free: [start.copy()])
    begin: Callable[[Campaign, Sequence[Any]], Starts] | None = None
    lay_inputs: Callable[[Sequence[np.ndarray], Mapping[str, np.ndarray]], dict[str, np.ndarray]] = (
        lambda times, conditions: {})
    rows: tuple[int, ...] = (24, 48, 96, 192, 384, 768)
    starts: tuple[str, ...] = ()
    further_starts: tuple[str, ...] = ()
    slots: tuple[int, ...] = (5, 8, 12, 16, 24, 32, 48, 64, 96)
    values: tuple[str, ...] = ()
    jumping: tuple[str, ...] = ()
    place_values: Callable[[Any], float] = lambda table: 0.0
    ratio: Ratio | None = None

    @property
    def effects(self) -> tuple[type[AbstractEffect], ...]:
        """Those of the catalogue that act on its records alone."""
        return tuple(effect for effect in self.catalogue if family_of(effect) == self.name)

    @property
    def main(self) -> tuple[str, ...]:
        """Channels without which nothing can be fitted: the first, or as many as a record has starts."""
        return self.channels[: max(len(self.starts), 1)]

    @property
    def free_running(self) -> bool:
        """Whether a record runs on from where it starts, so that a wrong model falls out of step with it."""
        return bool(self.starts)

    @property
    def has_contact(self) -> bool:
        """Whether a record holds one contact, from first touch at t = 0 to separation: before and after nothing acts.
        """
        return self.kind.has_contact

    @property
    def has_strokes(self) -> bool:
        """Whether a record is one or several strokes, between which the force jumps and within which work adds up."""
        return self.follow is not None

    @property
    def folds(self) -> str:
        """What cross-validation leaves out as a whole: `records`, or all those of the same `conditions`."""
        return "records" if self.free_running else "conditions"

    def tell_sides(self, channel: str, time: np.ndarray, deviation: float) -> np.ndarray:
        """Whether it is known on which side of a jump each sample lies, shape (samples,).

        A channel that may jump at first touch says nothing within `BLIND` deviations [s] of the time origin: no
        derivative tells a fit that such a sample belongs to the other side, and it would change the jump instead.
        """
        if channel not in self.jumping:
            return np.ones(time.shape, dtype=bool)
        return (np.abs(time) > BLIND * deviation) | (deviation <= 0)

    def suggest(self, channels: Collection[str]) -> str:
        """What else to measure, in words, for a campaign that has these channels: no channel that is there already."""
        lacking = [name.replace("_", " ") for name in self.plan.added
                   if not any(there == name or there.startswith(f"{name}_") for there in channels)]
        return self.remedies + (f", or add the {join_words(lacking)} channel{'s' * (len(lacking) > 1)}" if lacking
                                else "")

    def require_model(self, reference: AbstractModel, campaign: str) -> None:
        """Refuse a reference model of another family than that of the named campaign.

        Raises:
            InputError: It is of another one.
        """
        if type(reference).family != self.name:
            raise InputError(f"the model is of the family {type(reference).family!r}, but campaign {campaign!r} of "
                             f"{self.name!r}; use a model of the latter family{self.model_hint}")
