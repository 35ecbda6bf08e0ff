"""Where the residuals sit: a map over record and time, and the error of every condition against the noise."""

import itertools
import math
from collections.abc import Mapping, Sequence

import numpy as np

from ..measurement.quantities import clean, describe_conditions, describe_quantity, shorten_names, vary
from ..selection.result import Trace
from ..selection.series import list_channels
from ..selection.text import choose_view
from .binning import (
    group_values,
    list_levels,
    measure_error,
    pick_channel,
    sort_traces,
    standardise,
)
from .style import GREY, INK, NARROW, WIDTH, dress, name_ticks, new_figure, styled, wrap_text
from .views import share_span


_COLUMNS = 48  # of the map
_ROWS = 16  # of the grid of errors at most


@styled
def draw_residual_map(models: Mapping[str, Sequence[Trace]], narrow: bool = False):
    """Mean residual over the noise, one row a record in the order of its conditions, along the record.

    Args:
        models: one or two models by name, the reference model first; all channels are drawn, one below the other.
        narrow: draw for a telephone, the models below each other too, and rows by the record's name alone.

    Returns:
        A matplotlib figure.
    """
    first = next(iter(models.values()))
    view, channels = choose_view(first), list_channels(first)
    edges = np.linspace(*view.reach, min(_COLUMNS, max(np.size(trace.time) for trace in first)) + 1)
    count = max(len(pick_channel(first, channel)) for channel in channels)
    height = min(max(0.165 * count, 1.6), 6.0)
    down = len(channels) * len(models) if narrow else len(channels)
    across = 1 if narrow else len(models)
    figure = new_figure(0.75 + (height + 0.45) * down, NARROW if narrow else WIDTH)
    panels = figure.subplots(down, across, squeeze=False, sharex=True).reshape(len(channels), len(models))
    for row, channel in enumerate(channels):
        order = sort_traces(pick_channel(first, channel))
        labels = _label_rows(order, height, not narrow)
        maps = []
        for traces in models.values():
            own = {trace.record: trace for trace in pick_channel(traces, channel)}
            maps.append(np.array([_average(own.get(trace.record), edges) for trace in order]))
        finite = np.abs(np.concatenate([one[np.isfinite(one)] for one in maps]))
        limit = max(2.0, float(np.quantile(finite, 0.99)) if finite.size else 2.0)
        for column, (name, values) in enumerate(zip(models, maps, strict=True)):
            axes = dress(panels[row, column], grid="")
            image = axes.imshow(
                values, aspect="auto", cmap="RdBu_r", vmin=-limit, vmax=limit, interpolation="nearest",
                extent=(edges[0], edges[-1], len(order) - 0.5, -0.5),
            )  # fmt: skip
            axes.set_facecolor("#e3e3e3")
            for edge in (0, 1):
                axes.axvline(edge, color=INK, lw=0.7, ls=(0, (3, 3)))
            for line in _find_breaks(order):
                axes.axhline(line, color="white", lw=1.2)
            shown = describe_quantity(channel).name
            title = clean(name, 80) if len(channels) == 1 else f"{shown}: {clean(name, 80)}"
            axes.set_title(wrap_text(title, (NARROW - 1.2 if narrow else WIDTH - 2.8) / across))
            axes.tick_params(axis="y", length=0)
            axes.set_yticks(range(len(order)), labels if column == 0 or narrow else [""] * len(order), fontsize=7.5)
            axes.set_xticks([0, 0.25, 0.5, 0.75, 1], [view.ends[0], "¼", "½", "¾", view.ends[1]])
            last = row == len(channels) - 1 and (column == len(models) - 1 or not narrow)
            if view.reach == (0.0, 1.0) and last:  # the names of the ends would stick out
                for tick, side in ((0, "left"), (-1, "right")):
                    axes.get_xticklabels()[tick].set_horizontalalignment(side)
            if last:
                axes.set_xlabel(view.share)
            for side in axes.spines.values():
                side.set_visible(False)
        _label_bar(figure.colorbar(image, ax=list(panels[row]), shrink=0.9, aspect=24 * (len(models) if narrow else 1),
                                   pad=0.015, extend="both"), "mean residual / noise")
    return figure


@styled
def draw_record_errors(models: Mapping[str, Sequence[Trace]], narrow: bool = False):
    """Root mean square of the residual over the noise at each condition; 1 is as good as it can be.

    Args:
        models: one or two models by name, the reference model first; all channels are drawn, one below the other.
        narrow: draw for a telephone, the models below each other too.

    Returns:
        A matplotlib figure.
    """
    first = next(iter(models.values()))
    channels = list_channels(first)
    grids = [[_grid_errors(pick_channel(traces, channel)) for traces in models.values()] for channel in channels]
    down = len(channels) * len(models) if narrow else len(channels)
    across = 1 if narrow else len(models)
    lines, panel = len(grids[0][0][2]), (NARROW - 1.5 if narrow else WIDTH - 2.0) / across
    figure = new_figure(0.75 + down * (0.65 + 0.36 * max(lines, 2)), NARROW if narrow else WIDTH)
    panels = figure.subplots(down, across, squeeze=False).reshape(len(channels), len(models))
    for row, channel in enumerate(channels):
        top = max(2.0, *(float(np.max(values, initial=0.0, where=np.isfinite(values))) for values, *_ in grids[row]))
        for column, name in enumerate(models):
            values, along, up, label_x, label_y = grids[row][column]
            axes = dress(panels[row, column], grid="")
            image = axes.imshow(values, aspect="auto", origin="lower", cmap="YlOrBr", vmin=0.8, vmax=top)
            for i, j in np.ndindex(*values.shape):
                if math.isfinite(values[i, j]) and panel / values.shape[1] > 0.26:  # room for three digits
                    dark = values[i, j] > 0.8 + 0.6 * (top - 0.8)
                    axes.text(j, i, f"{values[i, j]:.2f}" if values[i, j] < 10 else f"{values[i, j]:.0f}", ha="center",
                              va="center", fontsize=9 if panel / values.shape[1] > 0.4 else 7,
                              color="white" if dark else INK)
            name_ticks(axes, along, panel)
            axes.set_yticks(range(len(up)), up if column == 0 or narrow else [""] * len(up))
            axes.tick_params(length=0)
            shown = describe_quantity(channel).name
            title = clean(name, 80) if len(channels) == 1 else f"{shown}: {clean(name, 80)}"
            axes.set_title(wrap_text(title, panel))
            if row == len(channels) - 1 and (column == len(models) - 1 or not narrow):
                axes.set_xlabel(label_x)
            if column == 0 or narrow:
                axes.set_ylabel(label_y)
            for side in axes.spines.values():
                side.set_visible(False)
            axes.set_xticks(np.arange(len(along) + 1) - 0.5, minor=True)
            axes.set_yticks(np.arange(len(up) + 1) - 0.5, minor=True)
            axes.grid(which="minor", color="white", lw=2)
            axes.tick_params(which="minor", length=0)
        _label_bar(figure.colorbar(image, ax=list(panels[row]), aspect=14 * (len(models) if narrow else 1), pad=0.015),
                   "rms residual / noise")
    return figure


def _label_bar(bar, label: str):
    """Give a colour bar its label and the house's ticks."""
    bar.outline.set_visible(False)
    bar.set_label(label, fontsize=9)
    bar.ax.tick_params(labelsize=8.5, labelcolor=INK, color=GREY)


def _average(trace: Trace | None, edges: np.ndarray) -> np.ndarray:
    """Mean standardised residual of one record in bins of the share of the record, nan where there is none."""
    size = edges.size - 1
    if trace is None:
        return np.full(size, np.nan)
    residual, share = standardise(trace), share_span(trace)
    index = np.searchsorted(edges, share, side="right") - 1
    index = np.where(share == 1, np.minimum(index, size - 1), index)
    good = np.isfinite(residual) & (index >= 0) & (index < size)
    count = np.bincount(index[good], minlength=size)
    total = np.bincount(index[good], residual[good], minlength=size)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _label_rows(traces: Sequence[Trace], height: float, full: bool = True) -> list[str]:
    """What each row is: record and, in `full`, conditions; every other one is left out where they would overlap."""
    names = vary(trace.conditions for trace in traces)[:3] if full else ()
    every = max(1, math.ceil(len(traces) * 0.135 / height))
    short = shorten_names((trace.record for trace in traces), 18)
    labels = [f"{describe_conditions(trace.conditions, names)}   {short[trace.record]}".strip() for trace in traces]
    return [label if i % every == 0 else "" for i, label in enumerate(labels)]


def _find_breaks(traces: Sequence[Trace]) -> list[float]:
    """Rows between which the first condition changes."""
    names = vary(trace.conditions for trace in traces)
    if not names:
        return []
    groups = group_values([trace.conditions.get(names[0], math.nan) for trace in traces])
    return [i - 0.5 for i in range(1, len(groups)) if groups[i] != groups[i - 1]]


def _grid_errors(traces: Sequence[Trace]):
    """Errors on the grid of a first condition and the next ones, with tick labels and axis labels; repeats are pooled.

    Conditions that would make too many rows are pooled too.
    """
    names = vary(trace.conditions for trace in traces)[: choose_view(traces).conditions]
    levels = {name: list_levels(traces, name) for name in names}
    varying = [name for name in names if len(levels[name]) > 1]
    names = varying if len(varying) > 1 else list(names[:2])
    if len(names) < 2:
        order = sort_traces(traces)
        values = np.array([[measure_error(trace) for trace in order]])
        short = shorten_names((trace.record for trace in order), 14)
        return values, [short[trace.record] for trace in order], [""], "record", ""
    if math.prod(len(levels[name]) for name in names[1:]) > _ROWS:
        names = names[:2]
    errors = np.array([measure_error(trace) for trace in traces])
    columns = [group_values([trace.conditions.get(name, math.nan) for trace in traces]) for name in names]
    across, up = levels[names[0]], sorted(itertools.product(*(levels[name] for name in names[1:])))
    values = np.full((len(up), len(across)), np.nan)
    for i, j in np.ndindex(*values.shape):
        here = np.all(np.array(columns).T == (across[j], *up[i]), axis=1)
        if here.any():
            values[i, j] = np.sqrt(np.mean(errors[here] ** 2))
    first, *rest = (describe_quantity(name, levels[name]) for name in names)
    rows = [" · ".join(one.format(value) for one, value in zip(rest, row, strict=True)) for row in up]
    return values, [first.format(value) for value in across], rows, first.label, " ·\n".join(one.label for one in rest)
