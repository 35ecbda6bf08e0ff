"""Residuals put in order for a figure: standardised, grouped by condition, averaged in bins with their errors."""

import dataclasses as dc
import math
from collections.abc import Mapping, Sequence

import numpy as np

from ..measurement.quantities import vary
from ..selection.result import Trace


MISSED = 1.3  # rms of the residual over the noise, above which a record is worth showing


@dc.dataclass(frozen=True)
class Bins:
    """Means of standardised residuals in bins.

    Attributes:
        centre: of the bins, in the variable's SI unit (mean of the variable).
        mean: mean residual over noise.
        error: standard error of the mean, from the scatter between records.
        floor: standard error that noise alone gives the mean.
    """

    centre: np.ndarray
    mean: np.ndarray
    error: np.ndarray
    floor: np.ndarray


def pick_channel(traces: Sequence[Trace], channel: str) -> list[Trace]:
    """The traces of one channel."""
    return [trace for trace in traces if trace.channel == channel]


def standardise(trace: Trace) -> np.ndarray:
    """Measured minus model over the noise, nan where a sample is missing."""
    scale = trace.sd if trace.sd > 0 else np.nan
    return (np.asarray(trace.measured, float) - np.asarray(trace.model, float)) / scale


def is_peaks(traces: Sequence[Trace]) -> bool:
    """Whether every record is one number, not a trace."""
    return bool(traces) and all(np.size(trace.time) <= 1 for trace in traces)


def sort_traces(traces: Sequence[Trace]) -> list[Trace]:
    """Traces by condition: those of the family first, then further ones; repeats by record."""
    names = vary(trace.conditions for trace in traces)
    keys = {name: group_values([trace.conditions.get(name, math.nan) for trace in traces]) for name in names}
    order = sorted(range(len(traces)), key=lambda i: (*(keys[name][i] for name in names), str(traces[i].record)))
    return [traces[i] for i in order]


def group_values(values, tolerance: float = 0.04) -> list[float]:
    """The nominal value behind each measured setting: the mean of a group of neighbouring values.

    Groups part at a gap of more than `tolerance` of the value, or of half of that where it is a good part of the range.
    """
    values = np.asarray(values, dtype=float)
    groups = np.full(values.size, np.nan)
    order = np.argsort(values, kind="stable")
    order = order[np.isfinite(values[order])]
    start, span = 0, np.ptp(values[order]) if order.size else 0.0
    for i in range(1, order.size + 1):
        last = values[order[i - 1]]
        gap = values[order[i]] - last if i < order.size else np.inf
        least = tolerance * max(abs(last), 1e-12)
        if gap > least or (gap > 0.5 * least and gap > 0.15 * span):
            groups[order[start:i]] = values[order[start:i]].mean()
            start = i
    return [float(value) for value in groups]


def choose_records(traces: Sequence[Trace], count: int) -> list[Trace]:
    """Up to `count` traces spread over the conditions, as far from each other as can be, sorted.

    The record that its model misses most is among them, if it is missed by more than `MISSED` deviations (rms).
    """
    traces = sort_traces(traces)
    if len(traces) <= count:
        return traces
    columns = []
    for name in vary(trace.conditions for trace in traces):
        groups = group_values([trace.conditions.get(name, math.nan) for trace in traces])
        levels = sorted({value for value in groups if math.isfinite(value)})
        ranks = {value: i / max(len(levels) - 1, 1) for i, value in enumerate(levels)}
        columns.append([ranks.get(value, 0.5) for value in groups])
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


def list_levels(traces: Sequence[Trace], name: str) -> list[float]:
    """Distinct nominal values of a condition."""
    groups = group_values([trace.conditions.get(name, math.nan) for trace in traces])
    return sorted({value for value in groups if math.isfinite(value)})


def inflate_noise(count, noise: Mapping | None):
    """Factor by which correlation along a trace inflates the variance of a mean of `count` neighbouring samples."""
    noise = noise or {}
    correlation = min(max(float(noise.get("correlation") or 0.0), 0.0), 0.99)
    white = min(max(float(noise.get("white_share") or 0.0), 0.0), 1.0)
    slow = np.minimum((1 + correlation) / (1 - correlation), np.maximum(count, 1))
    return white + (1 - white) * slow


def bin_residuals(traces, values, edges, noise=None, keep=None) -> Bins:
    """Means of the standardised residuals in bins of a variable.

    Args:
        traces: of one channel.
        values: the variable, one array a trace, in its SI unit.
        edges: of the bins.
        noise: `correlation` and `white_share` of the channel.
        keep: which samples count, one array a trace.

    Returns:
        Bins that hold at least five samples.
    """
    edges = np.asarray(edges, float)
    size = edges.size - 1
    count, total, where = (np.zeros((len(traces), size)) for _ in range(3))
    for i, (trace, variable) in enumerate(zip(traces, values, strict=True)):
        residual = standardise(trace)
        good = np.isfinite(residual) & np.isfinite(variable)
        if keep is not None:
            good &= keep[i]
        index = np.clip(np.searchsorted(edges, variable[good], side="right") - 1, -1, size)
        index[variable[good] == edges[-1]] = size - 1
        inside = (index >= 0) & (index < size)
        index = index[inside]
        count[i] = np.bincount(index, minlength=size)
        total[i] = np.bincount(index, residual[good][inside], minlength=size)
        where[i] = np.bincount(index, variable[good][inside], minlength=size)
    number = count.sum(axis=0)
    full = number >= 5
    number, count, total, where = number[full], count[:, full], total[:, full], where[:, full]
    mean = total.sum(axis=0) / number
    floor = np.sqrt((count * inflate_noise(count, noise)).sum(axis=0)) / number
    spread = np.sqrt(((total - count * mean) ** 2).sum(axis=0)) / number
    records = (count > 0).sum(axis=0)
    spread *= np.sqrt(records / np.maximum(records - 1, 1))
    error = np.where(records >= 3, spread, floor)
    return Bins(where.sum(axis=0) / number, mean, error, floor)


def measure_error(trace: Trace) -> float:
    """Root mean square of the residual over the noise, nan where nothing was measured."""
    residual = standardise(trace)
    residual = residual[np.isfinite(residual)]
    return float(np.sqrt(np.mean(residual**2))) if residual.size else math.nan
