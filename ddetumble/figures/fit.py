"""Model against measurement: small multiples of records with their residuals in units of the noise."""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from ..measurement.quantities import clean, describe_conditions, describe_quantity, shorten_names, vary
from ..selection.result import Trace
from ..selection.text import choose_view
from .binning import choose_records, group_values, pick_channel, sort_traces, standardise
from .style import (
    FLOOR,
    GREY,
    INK,
    NARROW,
    WIDTH,
    colour_models,
    count_characters,
    dress,
    head_figure,
    new_figure,
    styled,
    wrap_text,
)
from .views import find_span, find_stretch, find_strokes


KEY = 18  # characters of a record's name


@styled
def draw_fit(models: Mapping[str, Sequence[Trace]], channel: str | None = None, count: int = 8, narrow: bool = False):
    """Records spread over the conditions, each with the models through it and, below, the residual over the noise.

    Args:
        models: one or two models by the name they are to have in the legend, the reference model first.
        channel: what to draw; the family's force where it is not given.
        count: how many records at most.
        narrow: draw for a telephone, one record below the other.

    Returns:
        A matplotlib figure.
    """
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch
    from matplotlib.ticker import MaxNLocator

    view = choose_view(next(iter(models.values())))
    channel = channel or view.force
    traces = {name: {trace.record: trace for trace in pick_channel(all_, channel)} for name, all_ in models.items()}
    first, last = next(iter(traces.values())), list(traces.values())[-1]
    chosen = choose_records(list(first.values()), count)
    names = vary(trace.conditions for trace in first.values())
    shown = describe_quantity(channel, np.concatenate([trace.measured for trace in chosen]), chosen[0].unit)
    along = describe_quantity(view.along, np.concatenate([trace.time for trace in chosen]))
    columns = 1 if narrow else 3 if len(chosen) in (5, 6) else min(4, len(chosen))
    rows = math.ceil(len(chosen) / columns)
    width = NARROW if narrow else WIDTH if columns > 2 else 3.2 * columns + 1
    panel = (width - 0.7) / columns - 0.15  # inch
    titles = {trace.record: describe_conditions(trace.conditions, names[:3]) for trace in chosen}
    short = shorten_names(first, KEY if any(titles.values()) else 26)
    beside = max(len(f"{title}  {short[own]}") for own, title in titles.items()) <= count_characters(panel, 9.0)
    figure = new_figure(0.5 + (2.75 if beside else 2.9) * rows, width, gap=0.045)
    grid = figure.add_gridspec(rows, columns)
    limit = _limit_residuals(traces, chosen)
    handles, labels, lower = [], [], None
    for i, trace in enumerate(chosen):
        row, column = divmod(i, columns)
        inner = grid[row, column].subgridspec(2, 1, height_ratios=(2.6, 1), hspace=0.06)
        upper = dress(figure.add_subplot(inner[0]))
        lower = dress(figure.add_subplot(inner[1], sharex=upper, sharey=lower), grid="")
        # One time axis for all: each model has shifted the record's time origin by as much as suits it.
        time = along.scale * np.asarray(last.get(trace.record, trace).time)
        upper.plot(time, shown.scale * trace.measured, ".", color=INK, ms=2.4, mew=0, zorder=2)
        lower.axhspan(-2, 2, color=FLOOR, alpha=0.18, lw=0)
        lower.axhline(0, color=FLOOR, lw=0.7)
        lines = []
        for (name, own), colour in zip(traces.items(), colour_models(len(traces)), strict=True):
            if trace.record not in own:
                continue
            model = own[trace.record]
            style = "--" if len(traces) == 2 and not lines else "-"
            lines += upper.plot(time, shown.scale * model.model, style, color=colour, lw=1.4, zorder=3)
            residual = standardise(model)
            lower.plot(time, np.clip(residual, -limit, limit), ".", color=colour, ms=1.6, mew=0, alpha=0.45)
            lower.plot(time, np.clip(_smooth(model), -limit, limit), color=colour, lw=1.3)
            labels += [clean(name, 60)] if i == 0 else []
        handles = handles or [Line2D([], [], ls="none", marker=".", ms=7, color=INK), *lines]
        start, end = find_stretch(last.get(trace.record, trace))
        margin = 0.06 * (end - start)
        upper.set_xlim(max(along.scale * (start - margin), time[0]), min(along.scale * (end + 2.5 * margin), time[-1]))
        title = titles[trace.record] or short[trace.record]
        size = 9.5 if len(title) < 24 else 8.5 if len(title) < 28 else 8.0
        title = wrap_text(title, panel, 0.95 * size)
        upper.set_title(title, fontsize=size)
        if titles[trace.record]:  # the record's name beside its conditions, or in a line above them
            key = short[trace.record] if beside else short[trace.record] + "\n" * (title.count("\n") + 1)
            upper.set_title(key, loc="right" if beside else "center", color=GREY, fontsize=8, **({} if beside else
                            {"x": 0.0, "ha": "left", "linespacing": 1.6}))
        upper.tick_params(labelbottom=False)
        upper.yaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 2.5, 5, 10]))
        lower.set_ylim(-1.1 * limit, 1.1 * limit)
        lower.set_yticks([-_tick(limit), 0, _tick(limit)])
        if column:
            lower.tick_params(labelleft=False)
        else:
            upper.set_ylabel(wrap_text(shown.label, 1.75))
            lower.set_ylabel("residual\n/ noise")
        if row >= rows - 2:  # all panels of a row leave the same room
            lower.set_xlabel(along.label if i + columns >= len(chosen) else " " if len(chosen) % columns else "")
    band = Patch(facecolor=FLOOR, alpha=0.35, lw=0)
    head_figure(figure, [*handles, band], ["measured", *labels, "± 2 × noise"])
    return figure


@styled
def draw_peaks(models: Mapping[str, Sequence[Trace]], channel: str | None = None, narrow: bool = False):
    """One number a record: measured and modelled against the condition that varies most, residuals below.

    Args:
        models: one or two models by name, the reference model first.
        channel: what to draw; the first channel where it is not given.
        narrow: draw for a telephone.

    Returns:
        A matplotlib figure.
    """
    everything = [trace for traces in models.values() for trace in traces]
    channel = channel or everything[0].channel
    traces = {name: sort_traces(pick_channel(all_, channel)) for name, all_ in models.items()}
    first = next(iter(traces.values()))
    names = vary(trace.conditions for trace in first)
    shown = describe_quantity(channel, [float(trace.measured[0]) for trace in first], first[0].unit)
    values = {name: np.array([trace.conditions.get(name, np.nan) for trace in first], float) for name in names}
    spread = {name: np.ptp(v) / max(np.abs(v).max(), 1e-300) for name, v in values.items() if np.isfinite(v).all()}
    name = max(spread, key=lambda key: spread[key]) if spread else ""
    along = describe_quantity(name, values[name]) if name else None
    x = along.scale * values[name] if along else np.arange(1.0, len(first) + 1)
    figure = new_figure(4.4, NARROW if narrow else 8.0)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(2.4, 1))
    dress(upper)
    dress(lower, grid="")
    measured = shown.scale * np.array([trace.measured[0] for trace in first])
    noise = shown.scale * np.array([trace.sd for trace in first])
    dots = upper.errorbar(x, measured, 2 * noise, fmt="o", color=INK, ms=5, lw=1.1, capsize=3, zorder=4)
    lower.axhspan(-2, 2, color=FLOOR, alpha=0.18, lw=0)
    lower.axhline(0, color=FLOOR, lw=0.7)
    handles, labels = [dots], ["measured, ± 2 × noise"]
    shift = 0.006 * np.ptp(x) if len(traces) > 1 else 0.0
    lines = _find_lines(x, [values[other] for other in names if other != name])
    for i, ((label, own), colour) in enumerate(zip(traces.items(), colour_models(len(traces)), strict=True)):
        model = shown.scale * np.array([trace.model[0] for trace in own])
        line, marker = ("--", "s") if i == 0 and len(traces) > 1 else ("-", "D")
        drawn = [upper.plot(x[k], model[k], line + marker, color=colour, lw=1.4, ms=4.5)[0] for k in lines]
        handles += drawn[:1]
        labels.append(clean(label, 60))
        lower.plot(x + (2 * i - 1) * shift, [standardise(trace)[0] for trace in own], "o", color=colour, ms=5)
    upper.set_ylabel(shown.label)
    lower.set_ylabel("residual / noise")
    lower.set_xlabel(along.label if along else "record")
    head_figure(figure, handles, labels)
    return figure


def _find_lines(x: np.ndarray, others: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Which points a line joins, in their order: all of them, or those that are alike in every other condition."""
    if np.all(np.diff(x) > 0):
        return [np.arange(x.size)]
    keys = list(zip(*(group_values(other) for other in others), strict=True)) or [()] * x.size
    lines = [np.array([i for i, own in enumerate(keys) if own == key]) for key in dict.fromkeys(keys)]
    return [line[np.argsort(x[line], kind="stable")] for line in lines if line.size]


def _limit_residuals(traces, chosen) -> float:
    """Half height of the residual strips, in units of the noise: nearly all points of the drawn records."""
    kept = {trace.record for trace in chosen}
    values = [np.abs(standardise(trace)) for own in traces.values() for trace in own.values() if trace.record in kept]
    values = np.concatenate(values)
    values = values[np.isfinite(values)]
    return float(max(4.0, math.ceil(np.quantile(values, 0.995)))) if values.size else 4.0


def _tick(limit: float) -> int:
    """A round number near four fifths of the limit."""
    if limit < 10:
        return int(limit - 1)
    step = 10 ** math.floor(math.log10(limit)) / 2
    return int(math.floor(0.9 * limit / step) * step)


def _smooth(trace: Trace) -> np.ndarray:
    """Running mean of the residual over about a twenty-fifth of the trace, stroke by stroke.

    Where only the end of many turns is drawn, over three samples: a mean over turns would hide what turns with them.
    """
    residual = standardise(trace)
    width = max(3, residual.size // 25) | 1 if find_stretch(trace) == find_span(trace) else 3
    return np.concatenate([_average(residual[part], width) for part in find_strokes(trace)])


def _average(residual: np.ndarray, width: int) -> np.ndarray:
    """Running mean without the missing samples."""
    if residual.size <= width:
        return residual
    kernel = np.ones(width)
    good = np.isfinite(residual)
    count = np.convolve(good.astype(float), kernel, mode="same")
    total = np.convolve(np.where(good, residual, 0.0), kernel, mode="same")
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)
