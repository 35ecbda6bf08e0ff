"""Fitted series put in order for a figure: spans, phases and strokes; residuals by condition and in bins."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..families import View, find_family
from ..measurement.quantities import vary
from ..selection.result import Trace


MOST, SHOWN = 120, 40  # turning points of a curve that fill its panel with colour, and those drawn in their stead
MISSED = 1.3  # rms of the residual over the noise, above which a record is worth showing
FEWEST = 5  # samples of a bin: the mean of fewer is their noise
GAP = 0.04  # of a setting's value, between two nominal ones: more than a rig's scatter, less than a step of a plan


class Bins(NamedTuple):
    """Means of standardised residuals in bins."""

    centre: np.ndarray  # mean of the variable, in its SI unit
    mean: np.ndarray  # residual over noise
    error: np.ndarray  # standard error of the mean, from the scatter between records
    floor: np.ndarray  # standard error that noise alone gives the mean


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
    edges = [0, *map(int, turns), np.size(trace.time)]
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


def pick_channel(traces: Sequence[Trace], channel: str) -> list[Trace]:
    """The traces of one channel."""
    return [trace for trace in traces if trace.channel == channel]


def standardise(trace: Trace) -> np.ndarray:
    """Measured minus model over the noise of each sample, nan where a sample is missing."""
    scale = (trace.sd if trace.sd > 0 else np.nan) * (1.0 if trace.sizes is None else np.asarray(trace.sizes))
    return (np.asarray(trace.measured, float) - np.asarray(trace.model, float)) / scale


def measure_error(trace: Trace) -> float:
    """Root mean square of the residual over the noise, nan where nothing was measured."""
    residual = standardise(trace)
    residual = residual[np.isfinite(residual)]
    return float(np.sqrt(np.mean(residual**2))) if residual.size else math.nan


def are_values(traces: Sequence[Trace]) -> bool:
    """Whether every record is one number, not a curve."""
    return bool(traces) and all(trace.is_value for trace in traces)


def group_values(values) -> np.ndarray:
    """The nominal value behind each measured setting: the mean of a group of neighbouring values.

    Groups part at a gap of more than `GAP` of the value, or of half of that where it is a good part of the range.
    """
    values = np.asarray(values, dtype=float)
    groups = np.full(values.size, np.nan)
    order = np.argsort(values, kind="stable")
    order = order[np.isfinite(values[order])]
    if order.size:
        ordered = values[order]
        gaps, least = np.diff(ordered), GAP * np.maximum(np.abs(ordered[:-1]), 1e-12)
        parts = (gaps > least) | ((gaps > 0.5 * least) & (gaps > 0.15 * np.ptp(ordered)))
        for group in np.split(order, np.flatnonzero(parts) + 1):
            groups[group] = values[group].mean()
    return groups


def group_condition(traces: Sequence[Trace], name: str) -> np.ndarray:
    """The nominal value of a condition of every trace, nan where it has none."""
    return group_values([trace.conditions.get(name, math.nan) for trace in traces])


def list_levels(traces: Sequence[Trace], name: str) -> list[float]:
    """Distinct nominal values of a condition."""
    groups = group_condition(traces, name)
    return np.unique(groups[np.isfinite(groups)]).tolist()


def list_varying(traces: Sequence[Trace]) -> list[str]:
    """Conditions that have more than one nominal value."""
    return [name for name in vary(trace.conditions for trace in traces) if len(list_levels(traces, name)) > 1]


def sort_traces(traces: Sequence[Trace]) -> list[Trace]:
    """Traces by condition: those of the family first, then further ones; repeats by record."""
    keys = [group_condition(traces, name).tolist() for name in vary(trace.conditions for trace in traces)]
    order = sorted(range(len(traces)), key=lambda i: (*(key[i] for key in keys), str(traces[i].record)))
    return [traces[i] for i in order]


def choose_records(traces: Sequence[Trace], count: int) -> list[Trace]:
    """Up to `count` traces spread over the conditions, as far from each other as can be, sorted.

    The record that its model misses most is among them, if it is missed by more than `MISSED` deviations (rms).
    """
    traces = sort_traces(traces)
    if len(traces) <= count:
        return traces
    columns = []
    for name in vary(trace.conditions for trace in traces):
        levels, groups = list_levels(traces, name), group_condition(traces, name)
        ranks = np.searchsorted(levels, groups) / max(len(levels) - 1, 1)
        columns.append(np.where(np.isfinite(groups), ranks, 0.5))
    place = np.array(columns).T if columns else np.linspace(0, 1, len(traces))[:, None]
    misses = [float(np.sqrt(np.mean(np.nan_to_num(standardise(trace)) ** 2))) for trace in traces]
    worst = int(np.argmax(misses))
    chosen = [worst if misses[worst] > MISSED else int(np.argmin(place.sum(axis=1)))]
    while len(chosen) < count:
        distance = np.min(np.linalg.norm(place[:, None] - place[None, chosen], axis=2), axis=1)
        distance[chosen] = -1
        if len(chosen) >= 4 and distance.max() <= 0:
            break  # what is left are repeats
        chosen.append(int(np.argmax(distance)))
    return [traces[i] for i in sorted(chosen)]


def average_bins(x: np.ndarray, values: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Means of the finite values in bins of `x`, nan where a bin holds none."""
    good = np.isfinite(values)
    count = np.histogram(x[good], edges)[0]
    total = np.histogram(x[good], edges, weights=values[good])[0]
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def bin_residuals(traces, values, edges, noise=None, keep=None) -> Bins:
    """Means of the standardised residuals in bins of a variable that hold `FEWEST` samples.

    Args:
        traces: of one channel.
        values: the variable, one array a trace, in its SI unit.
        edges: of the bins.
        noise: `correlation` and `white_share` of the channel.
        keep: which samples count, one array a trace.
    """
    record = np.repeat(np.arange(len(traces)), [np.size(trace.time) for trace in traces])
    variable, residual = (np.concatenate([*own, []]) for own in (values, map(standardise, traces)))
    good = np.isfinite(residual) & np.isfinite(variable)
    if keep is not None:
        good &= np.concatenate([*keep, []]).astype(bool)
    cells = (np.arange(max(len(traces), 1) + 1) - 0.5, np.asarray(edges, float))
    count, total, where = (np.histogram2d(record[good], variable[good], cells, weights=weights)[0]
                           for weights in (None, residual[good], variable[good]))
    full = count.sum(axis=0) >= FEWEST
    count, total, where = count[:, full], total[:, full], where[:, full]
    number, records = count.sum(axis=0), (count > 0).sum(axis=0)
    mean = total.sum(axis=0) / number
    # Correlation along a trace inflates the variance of a mean of neighbouring samples.
    correlation = np.clip(float((noise or {}).get("correlation") or 0.0), 0.0, 0.99)
    white = np.clip(float((noise or {}).get("white_share") or 0.0), 0.0, 1.0)
    inflation = white + (1 - white) * np.minimum((1 + correlation) / (1 - correlation), np.maximum(count, 1))
    floor = np.sqrt((count * inflation).sum(axis=0)) / number
    spread = np.sqrt(((total - count * mean) ** 2).sum(axis=0)) / number
    spread *= np.sqrt(records / np.maximum(records - 1, 1))
    return Bins(where.sum(axis=0) / number, mean, np.where(records >= 3, spread, floor), floor)
