"""Where the residuals sit: a map over record and time, the error of every condition, and the settings' shifts."""

import itertools
import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from ..measurement.quantities import (
    clean,
    describe_conditions,
    describe_quantity,
    format_number,
    say_p,
    shorten,
    shorten_names,
    vary,
)
from ..selection.result import SettingShift, Trace
from ..selection.series import list_channels
from ..selection.text import choose_view
from .style import (
    FLOOR,
    GREY,
    INK,
    NARROW,
    PALE,
    WIDTH,
    colour_models,
    dress,
    head_figure,
    key_band,
    key_dot,
    name_ticks,
    new_figure,
    strip,
    styled,
    wrap_text,
)
from .traces import (
    average_bins,
    group_condition,
    list_levels,
    list_varying,
    measure_error,
    pick_channel,
    share_span,
    sort_traces,
    standardise,
)


_COLUMNS = 48  # of the map
_ROWS = 16  # of the grid of errors at most
STATED = 2.0  # stated deviations within which 95 % of true errors lie


@styled
def draw_residual_map(models: Mapping[str, Sequence[Trace]], narrow: bool = False):
    """Mean residual over the noise, one row a record in the order of its conditions, along the record."""
    first = next(iter(models.values()))
    view, channels = choose_view(first), list_channels(first)
    edges = np.linspace(*view.reach, min(_COLUMNS, max(np.size(trace.time) for trace in first)) + 1)
    height = min(max(0.165 * max(len(pick_channel(first, channel)) for channel in channels), 1.6), 6.0)
    rows = {}
    for channel in channels:
        order = sort_traces(pick_channel(first, channel))
        own = [{trace.record: trace for trace in pick_channel(traces, channel)} for traces in models.values()]
        nothing = np.full(edges.size - 1, np.nan)
        maps = [np.array([average_bins(share_span(traces[one.record]), standardise(traces[one.record]), edges)
                          if one.record in traces else nothing for one in order]) for traces in own]
        finite = np.abs(np.concatenate([one[np.isfinite(one)] for one in maps]))
        limit = max(2.0, float(np.quantile(finite, 0.99)) if finite.size else 2.0)
        rows[channel] = maps, order, _label_rows(order, height, not narrow), limit

    def draw(axes, channel: str, k: int, first: bool, last: bool):
        maps, order, labels, limit = rows[channel]
        extent = (edges[0], edges[-1], len(order) - 0.5, -0.5)
        image = axes.imshow(maps[k], aspect="auto", cmap="RdBu_r", vmin=-limit, vmax=limit, interpolation="nearest",
                            extent=extent)
        axes.set_facecolor("#e3e3e3")
        for edge in (0, 1):
            axes.axvline(edge, color=INK, lw=0.7, ls=(0, (3, 3)))
        for line in _find_breaks(order):
            axes.axhline(line, color="white", lw=1.2)
        axes.tick_params(axis="y", length=0)
        axes.set_yticks(range(len(order)), labels if first else [""] * len(order), fontsize=7.5)
        axes.set_xticks([0, 0.25, 0.5, 0.75, 1], [view.ends[0], "¼", "½", "¾", view.ends[1]])
        if last and view.reach == (0.0, 1.0):  # the names of the ends would stick out
            for tick, side in ((0, "left"), (-1, "right")):
                axes.get_xticklabels()[tick].set_horizontalalignment(side)
        if last:
            axes.set_xlabel(view.share)
        axes.spines[:].set_visible(False)
        return image

    return _draw_panels(models, channels, narrow, height + 0.45, draw, "mean residual / noise", room=(1.2, 2.8),
                        sharex=True, shrink=0.9, aspect=24, extend="both")


@styled
def draw_record_errors(models: Mapping[str, Sequence[Trace]], narrow: bool = False):
    """Root mean square of the residual over the noise at each condition; 1 is as good as it can be."""
    channels = list_channels(next(iter(models.values())))
    grids = {channel: [_grid_errors(pick_channel(traces, channel)) for traces in models.values()]
             for channel in channels}
    panel = NARROW - 1.5 if narrow else (WIDTH - 2.0) / len(models)

    def draw(axes, channel: str, k: int, first: bool, last: bool):
        top = max(2.0, *(float(np.max(one[0], initial=0.0, where=np.isfinite(one[0]))) for one in grids[channel]))
        values, along, up, label_x, label_y = grids[channel][k]
        image = axes.imshow(values, aspect="auto", origin="lower", cmap="YlOrBr", vmin=0.8, vmax=top)
        room = panel / values.shape[1]
        for i, j in np.ndindex(*values.shape):
            if math.isfinite(values[i, j]) and room > 0.26:  # of three digits
                axes.text(j, i, f"{values[i, j]:.2f}" if values[i, j] < 10 else f"{values[i, j]:.0f}", ha="center",
                          va="center", fontsize=9 if room > 0.4 else 7,
                          color="white" if values[i, j] > 0.8 + 0.6 * (top - 0.8) else INK)
        name_ticks(axes, along, panel)
        axes.set_yticks(range(len(up)), up if first else [""] * len(up))
        if last:
            axes.set_xlabel(label_x)
        if first:
            axes.set_ylabel(label_y)
        strip(axes)
        axes.set_xticks(np.arange(len(along) + 1) - 0.5, minor=True)
        axes.set_yticks(np.arange(len(up) + 1) - 0.5, minor=True)
        axes.grid(which="minor", color="white", lw=2)
        axes.tick_params(which="minor", length=0)
        return image

    height = 0.65 + 0.36 * max(len(grids[channels[0]][0][2]), 2)
    return _draw_panels(models, channels, narrow, height, draw, "rms residual / noise", room=(1.5, 2.0), aspect=14)


def _draw_panels(models, channels: Sequence[str], narrow: bool, height: float, draw: Callable, label: str,
                 room: tuple[float, float], sharex: bool = False, aspect: int = 14, **bar):
    """An image a model and channel, by `draw(axes, channel, model, leftmost, lowest)`, with a colour bar a channel.

    `room` is what the axes leave of a narrow and of a wide figure [inch].
    """
    down, across = (len(channels) * len(models), 1) if narrow else (len(channels), len(models))
    width = NARROW if narrow else WIDTH
    figure = new_figure(0.75 + height * down, width)
    panels = figure.subplots(down, across, squeeze=False, sharex=sharex).reshape(len(channels), len(models))
    for channel, row in zip(channels, panels, strict=True):
        image = None
        for k, (name, axes) in enumerate(zip(models, row, strict=True)):
            last = channel == channels[-1] and (k == len(models) - 1 or not narrow)
            image = draw(dress(axes, ""), channel, k, k == 0 or narrow, last)
            title = clean(name, 80)
            title = title if len(channels) == 1 else f"{describe_quantity(channel).name}: {title}"
            axes.set_title(wrap_text(title, (width - room[not narrow]) / across))
        colours = figure.colorbar(image, ax=list(row), pad=0.015, aspect=aspect * (len(models) if narrow else 1), **bar)
        colours.outline.set_visible(False)
        colours.set_label(label, fontsize=9)
        colours.ax.tick_params(labelsize=8.5, labelcolor=INK, color=GREY)
    return figure


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
    return [] if not names else list(np.flatnonzero(np.diff(group_condition(traces, names[0])) != 0) + 0.5)


def _grid_errors(traces: Sequence[Trace]):
    """Errors on the grid of a first condition and the next ones, with tick labels and axis labels; repeats are pooled.

    Conditions that would make too many rows are pooled too.
    """
    most = choose_view(traces).conditions
    names = list(vary(trace.conditions for trace in traces)[:most])
    varying = [name for name in names if name in list_varying(traces)]
    names = varying if len(varying) > 1 else names[:2]
    if len(names) < 2:
        order = sort_traces(traces)
        short = shorten_names((trace.record for trace in order), 14)
        return (np.array([[measure_error(trace) for trace in order]]), [short[trace.record] for trace in order], [""],
                "record", "")
    levels = {name: list_levels(traces, name) for name in names}
    if math.prod(len(levels[name]) for name in names[1:]) > _ROWS:
        names = names[:2]
    errors = np.array([measure_error(trace) for trace in traces])
    settings = np.array([group_condition(traces, name) for name in names]).T
    across, up = levels[names[0]], sorted(itertools.product(*(levels[name] for name in names[1:])))
    values = np.full((len(up), len(across)), np.nan)
    for i, j in np.ndindex(*values.shape):
        here = np.all(settings == (across[j], *up[i]), axis=1)
        if here.any():
            values[i, j] = np.sqrt(np.mean(errors[here] ** 2))
    first, *rest = (describe_quantity(name, levels[name]) for name in names)
    rows = [" · ".join(one.format(value) for one, value in zip(rest, row, strict=True)) for row in up]
    return values, [first.format(value) for value in across], rows, first.label, " ·\n".join(one.label for one in rest)


@styled
def draw_shifts(models: Mapping[str, Sequence[SettingShift]], narrow: bool = False):
    """One panel a setting: its shift in every record, in stated deviations, with the band that is stated.

    Args:
        models: shifts by the model's name; of two, the simpler first.
    """
    names = [shift.name for shift in next(iter(models.values()))]
    figure = new_figure(0.7 + (1.75 if narrow else 1.35) * len(names), NARROW if narrow else WIDTH)
    panels = figure.subplots(len(names), 1, squeeze=False, sharex=True).ravel()
    looks = list(zip(models, colour_models(len(models)), ("o", "D"), strict=False))
    for axes, name in zip(panels, names, strict=True):
        dress(axes)
        axes.axhspan(-STATED, STATED, color=FLOOR, alpha=0.18, lw=0)
        axes.axhline(0, color=GREY, lw=0.7)
        top, remarks = 1.15 * STATED, []
        for label, colour, mark in looks:
            shift = next((one for one in models[label] if one.name == name), None)
            if shift is None:
                continue
            axes.plot(np.arange(1, len(shift.shifts) + 1), shift.shifts, mark, color=colour, ms=4.5, lw=0)
            top = max(top, 1.15 * float(np.max(np.abs(shift.shifts), initial=0.0)))
            if math.isfinite(shift.rms):
                whose = f"{shorten(label, 28)}: " if len(models) > 1 else ""
                remarks.append(f"{whose}rms {format_number(shift.rms, 2)}, {say_p(shift.p_value)}")
        axes.set_ylim(-top, top)
        words = "time origin" if name == "time" else describe_quantity(name).name
        axes.set_title("\n".join([words[:1].upper() + words[1:], *(remarks if narrow else ())]),
                       fontsize=8.5 if narrow else 9.5)
        if not narrow:
            axes.set_title("; ".join(remarks), loc="right", color=GREY, fontsize=8.5)
        axes.set_ylabel("shift /\nstated sd")
    panels[-1].set_xlabel("record, in the order of the campaign")
    panels[-1].margins(x=0.02)
    panels[-1].xaxis.get_major_locator().set_params(integer=True)
    head_figure(figure, [*(key_dot(colour, 5, mark) for _, colour, mark in looks), key_band(edgecolor=PALE, lw=None)],
                [*(clean(label, 80) for label, *_ in looks), "two stated deviations"])
    return figure
