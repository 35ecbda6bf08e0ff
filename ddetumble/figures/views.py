"""How the records of a family are looked at: what lies along them, what a misfit is located in, and the words for it.

Everything in figures and reports that differs between impacts, slip records and tumbling records is here.
"""

import dataclasses as dc
import math
from collections.abc import Sequence

import numpy as np

from ..discrepancy.records import Trace


MOST, SHOWN = 120, 40  # turning points of a curve that fill its panel with colour, and those drawn in their stead


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

    force: str
    along: str
    state: str
    rate: str
    phases: tuple[str, ...]
    variables: tuple[str, ...]
    share: str
    ends: tuple[str, str]
    reach: tuple[float, float]
    bins: int
    conditions: int
    strongest: bool
    series: str
    apart: str
    free: str
    longest: float = 0.0

    @property
    def wide(self) -> bool:
        """Whether the bins over the state need the room of two panels."""
        return self.bins > 20


_IMPACT = View(
    "normal_force", "time", "depression", "depression_rate", ("loading", "unloading"),
    ("depression", "depression_rate", "time"), "share of the contact time", ("touch", "separation"), (-0.06, 1.12), 15,
    2, False, "impact of the series", "loading and unloading", "mass, restitution",
)  # fmt: skip
_SLIP = View(
    "tangential_force", "slip", "slip", "", (), ("slip",), "share of the record", ("start", "end"), (0.0, 1.0), 30, 3,
    True, "test of the series", "", "adhesion constant, loss factor, slip term",
)  # fmt: skip
_STROKES = dc.replace(
    _SLIP, along="time", rate="direction", phases=("forward", "backward"), variables=("slip", "direction", "time"),
    apart="strokes forward and backward",
)  # fmt: skip
_TUMBLE = View(
    "", "time", "time", "angular_speed", (), ("time", "angular_speed"), "share of the record", ("start", "end"),
    (0.0, 1.0), 20, 2, True, "record of the series", "", "inertia ratio",
)  # fmt: skip


def choose_view(traces: Sequence[Trace] = (), family: str = "impact") -> View:
    """The view of some traces; of the family alone where there are none."""
    view = _choose(traces, family)
    ends = [float(np.nanmax(trace.time)) for trace in traces if np.size(trace.time)]
    return dc.replace(view, longest=max(ends)) if ends and view.along == "time" else view


def _choose(traces: Sequence[Trace], family: str) -> View:
    family = traces[0].family if traces else family
    if family != "slip":
        return _TUMBLE if family == "tumble" else _IMPACT
    if any(np.any(np.asarray(trace.state_rate) < 0) for trace in traces):
        return _STROKES
    return dc.replace(_SLIP, along="time") if traces and traces[0].independent == "time" else _SLIP


def find_span(trace: Trace) -> tuple[float, float]:
    """First and last value of the independent variable that counts: of the contact, elsewhere of the whole record."""
    time = np.asarray(trace.time, float)
    touching = np.flatnonzero(np.nan_to_num(trace.state) > 0)
    if trace.family in ("slip", "tumble") or touching.size < 2:
        return float(time[0]), float(time[-1])
    return float(time[max(touching[0] - 1, 0)]), float(time[min(touching[-1] + 1, time.size - 1)])


def find_stretch(trace: Trace) -> tuple[float, float]:
    """First and last value between which a record is drawn: its span, or the end of it where it turns very often."""
    start, end = find_span(trace)
    model = np.asarray(trace.model, float)
    if not np.isfinite(model).all() or np.ptp(model) < 3.0 * trace.sd:
        return start, end
    turns = np.flatnonzero(np.diff(np.sign(np.diff(model))) != 0) + 1
    return (float(trace.time[turns[-SHOWN]]), end) if turns.size > MOST else (start, end)


def share_span(trace: Trace) -> np.ndarray:
    """The independent variable as a share of that: 0 at first touch or the start, 1 at separation or the end."""
    start, end = find_span(trace)
    return (np.asarray(trace.time, float) - start) / max(end - start, 1e-12)


def find_phase(trace: Trace, phase: str = "") -> np.ndarray:
    """Which samples count: those of the span, or of them only those of a phase."""
    start, end = find_span(trace)
    inside = (trace.time >= start) & (trace.time <= end)
    if phase == "loading":
        return inside & (trace.state_rate > 0)
    if phase == "unloading":
        return inside & (trace.state_rate <= 0) & (trace.state > 0)
    if phase in ("forward", "backward"):
        return inside & ((trace.state_rate < 0) == (phase == "backward"))
    return inside


def find_strokes(trace: Trace) -> list[slice]:
    """The parts of a trace between which the force may jump: strokes; an impact is one part."""
    if trace.family != "slip":
        return [slice(None)]
    turns = np.flatnonzero((np.diff(np.sign(trace.state_rate)) != 0) | (np.diff(trace.state) < 0)) + 1
    edges = [0, *(int(turn) for turn in turns), np.size(trace.time)]
    return [slice(a, b) for a, b in zip(edges[:-1], edges[1:], strict=True)]


def find_values(trace: Trace, variable: str, view: View) -> np.ndarray:
    """A variable at every sample of a trace, SI; `time` as a share of the record, a direction as 1 or -1."""
    if variable == "time":
        return share_span(trace)
    if variable == view.state:
        return np.asarray(trace.state, float)
    if variable == "direction":
        return np.where(np.asarray(trace.state_rate) < 0, -1.0, 1.0)
    if variable == view.rate:
        return np.asarray(trace.state_rate, float)
    return np.full(np.size(trace.time), trace.conditions.get(variable, math.nan))
