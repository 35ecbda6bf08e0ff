"""How records are looked at, by the view of their family: what lies along them, and what a misfit is located in."""

import math

import numpy as np

from ..families import View, find_family
from ..selection.result import Trace


MOST, SHOWN = 120, 40  # turning points of a curve that fill its panel with colour, and those drawn in their stead


def find_span(trace: Trace) -> tuple[float, float]:
    """First and last value of the independent variable that counts: of the contact, elsewhere of the whole record."""
    time = np.asarray(trace.time, float)
    touching = np.flatnonzero(np.nan_to_num(trace.state) > 0)
    if not find_family(trace.family).has_contact or touching.size < 2:
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
    if not find_family(trace.family).has_strokes:
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
