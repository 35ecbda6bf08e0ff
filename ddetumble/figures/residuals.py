"""Where the residuals sit and what they depend on: record, time, state, condition; and how far settings were moved."""

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import matplotlib
import numpy as np
import pandas as pd

from ..families import View
from ..measurement import quantities as q
from ..selection.result import Place, SettingShift, Trace
from ..selection.series import list_channels
from ..selection.text import choose_view
from .palette import FLOOR, GREY, INK, PALE, PLACE
from .style import (
    NARROW,
    WIDTH,
    colour_models,
    dress,
    head_figure,
    key_band,
    key_dot,
    key_line,
    name_ticks,
    new_figure,
    strip,
    styled,
    wrap_text,
)
from .traces import (
    average_bins,
    bin_residuals,
    find_phase,
    find_strokes,
    find_values,
    group_condition,
    list_levels,
    list_varying,
    measure_error,
    pick_channel,
    share_span,
    sort_traces,
    standardise,
)


_COLUMNS = 48  # of the map: more are narrower than a pixel column that one can tell
_ROWS = 16  # of the grid of errors at most: more have no room for their labels
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
        names = q.vary(trace.conditions for trace in order)
        short = q.shorten_names((trace.record for trace in order), 18)
        every = max(1, math.ceil(len(order) * 0.135 / height))  # rows whose labels do not overlap
        told = () if narrow else names[:3]
        labels = ["" if i % every else
                  f"{q.describe_conditions(trace.conditions, told)}   {short[trace.record]}".strip()
                  for i, trace in enumerate(order)]
        rows[channel] = maps, group_condition(order, names[0] if names else ""), labels, limit

    def draw(axes, channel: str, k: int, first: bool, last: bool):
        maps, groups, labels, limit = rows[channel]
        extent = (edges[0], edges[-1], len(labels) - 0.5, -0.5)
        image = axes.imshow(maps[k], aspect="auto", cmap="RdBu_r", vmin=-limit, vmax=limit, interpolation="nearest",
                            extent=extent)
        axes.set_facecolor("#e3e3e3")
        for edge in (0, 1):
            axes.axvline(edge, color=INK, lw=0.7, ls=(0, (3, 3)))
        for row in np.flatnonzero(np.diff(np.nan_to_num(groups))):
            axes.axhline(row + 0.5, color="white", lw=1.2)
        axes.tick_params(axis="y", length=0)
        axes.set_yticks(range(len(labels)), labels if first else [""] * len(labels), fontsize=7.5)
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
        # Edges, as cells about one place alone would have no width.
        image = axes.pcolormesh(*(np.arange(n + 1) - 0.5 for n in (len(along), len(up))), values, cmap="YlOrBr",
                                vmin=0.8, vmax=top, edgecolors="white", lw=2)
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
        image: Any = None
        for k, (name, axes) in enumerate(zip(models, row, strict=True)):
            last = channel == channels[-1] and (k == len(models) - 1 or not narrow)
            image = draw(dress(axes, ""), channel, k, k == 0 or narrow, last)
            title = q.clean(name, 80)
            title = title if len(channels) == 1 else f"{q.describe_quantity(channel).name}: {title}"
            axes.set_title(wrap_text(title, (width - room[not narrow]) / across))
        colours = figure.colorbar(image, ax=list(row), pad=0.015, aspect=aspect * (len(models) if narrow else 1), **bar)
        colours.outline.set_visible(False)
        colours.set_label(label, fontsize=9)
        colours.ax.tick_params(labelsize=8.5, labelcolor=INK, color=GREY)
    return figure


def _grid_errors(traces: Sequence[Trace]):
    """Errors on the grid of a first condition and the next ones, with tick labels and axis labels; repeats are pooled.

    Conditions that would make too many rows are pooled too.
    """
    most = choose_view(traces).conditions
    names = list(q.vary(trace.conditions for trace in traces)[:most])
    varying = [name for name in names if name in list_varying(traces)]
    names = varying if len(varying) > 1 else names[:2]
    if len(names) < 2:
        order = sort_traces(traces)
        short = q.shorten_names((trace.record for trace in order), 14)
        return (np.array([[measure_error(trace) for trace in order]]), [short[trace.record] for trace in order], [""],
                "record", "")
    levels = {name: list_levels(traces, name) for name in names}
    if math.prod(len(levels[name]) for name in names[1:]) > _ROWS:
        names = names[:2]
    across, up = levels[names[0]], list(itertools.product(*(levels[name] for name in names[1:])))
    table = pd.DataFrame({name: group_condition(traces, name) for name in names})
    table["square"] = [measure_error(trace) ** 2 for trace in traces]
    squares = {cell: own.mean() for cell, own in table.groupby(names)["square"]}
    values = np.sqrt([[squares.get((x, *row), np.nan) for x in across] for row in up])
    first, *rest = (q.describe_quantity(name, levels[name]) for name in names)
    rows = [" · ".join(one.format(value) for one, value in zip(rest, row, strict=True)) for row in up]
    return values, [first.format(value) for value in across], rows, first.label, " ·\n".join(one.label for one in rest)


@styled
def draw_dependence(
    models: Mapping[str, Sequence[Trace]],
    channel: str | None = None,
    noise: Mapping | None = None,
    where: Sequence[Place] = (),
    narrow: bool = False,
):
    """Mean residual over the noise against the state of a record, its rate, the share of it, and the conditions.

    Phases are drawn apart where the variable does not tell them apart. The band is what noise alone leaves with a mean
    in 95 % of cases; error bars are two standard errors from the scatter between records.

    Args:
        noise: `correlation` and `white_share` of the channel's noise.
        where: places of the misfit, marked where they name one of the variables drawn.
    """
    view = choose_view(next(iter(models.values())))
    channel = channel or view.force
    traces = {name: pick_channel(all_, channel) for name, all_ in models.items()}
    first, colours = next(iter(traces.values())), colour_models(len(traces))
    places = [place for place in where if place.channel == channel and place.variable not in ("time", "direction")]
    conditions = list_varying(first)
    if all("sequence" in trace.conditions for trace in first) and len(first) > 3:
        conditions.append("sequence")
    variables = [*view.variables, *conditions[: view.conditions + 1]]
    wide = int(view.wide)  # the first variable has the room of two panels
    total = len(variables) + wide
    columns = 2 if narrow else 3 if not wide else total if total <= 6 else math.ceil(total / 2)
    rows = math.ceil(total / columns)
    figure = new_figure((0.9 if narrow else 0.5) + 2.5 * rows, NARROW if narrow else WIDTH)
    grid = figure.add_gridspec(rows, columns)
    lefts, reach = {}, dict.fromkeys(range(rows), (-0.5, 0.5))  # first panel of a row, and what all of it show
    marked = False
    for k, variable in enumerate(variables):
        row, column = divmod(k + wide * (k > 0), columns)
        left = lefts.get(row)
        axes = dress(figure.add_subplot(grid[row, column : column + 1 + wide * (k == 0)], sharey=left))
        axes.tick_params(labelleft=left is None)
        lefts.setdefault(row, axes).set_ylabel("mean residual / noise")
        edges, shown = _choose_edges(first, variable, view)
        axes.axhline(0, color=FLOOR, lw=0.7)
        phases = view.phases if variable not in (view.rate, "time") and view.phases else ("",)
        for i, (own, colour) in enumerate(zip(traces.values(), colours, strict=True)):
            values = [find_values(trace, variable, view) for trace in own]
            for phase in phases:
                bins = bin_residuals(own, values, edges, noise, [find_phase(trace, phase) for trace in own])
                if not bins.centre.size:
                    continue
                x, open_ = shown.scale * bins.centre, phase != phases[0]
                if i == len(traces) - 1 and not open_:  # the band that noise alone fills
                    axes.fill_between(x, -2 * bins.floor, 2 * bins.floor, color=FLOOR, alpha=0.3, lw=0, zorder=1)
                axes.errorbar(x, bins.mean, 2 * bins.error, color=colour, lw=1.1, elinewidth=0.9, capsize=0,
                              ls=":" if open_ else "-", marker="o", ms=4, mfc="white" if open_ else colour,
                              zorder=3 + i)
                low, high = reach[row]
                reach[row] = (min(low, np.min(bins.mean - 2 * bins.error)),
                              max(high, np.max(bins.mean + 2 * bins.error)))
        names = (variable, "rate") if variable == "depression_rate" else (variable,)
        here = [place for place in places if place.variable in names]
        marked |= bool(here)
        _mark_places(axes, here, shown, 1.7 if (wide or narrow) and variable != "slip" else 3.0)
        axes.set_xlabel(wrap_text(view.share if variable == "time" else shown.label, 1.5 if narrow else 3.0))
        if variable == "sequence":
            axes.xaxis.get_major_locator().set_params(integer=True)
        elif variable == "direction":
            axes.set(xlim=(-1.6, 1.6), xticks=[-1, 1], xticklabels=view.phases[::-1])
        elif variable == view.rate and view.phases:
            axes.axvline(0, color=FLOOR, lw=0.7, ls=(0, (3, 3)))
            for text, x, side in zip(view.phases[::-1], (0.02, 0.98), ("left", "right"), strict=True):
                axes.text(x, 0.02, text, transform=axes.transAxes, ha=side, color=GREY, fontsize=8)
    for row, axes in lefts.items():
        low, high = reach[row]
        axes.set_ylim(low - 0.08 * (high - low), high + 0.08 * (high - low))
    look = {"width": 1.1, "marker": "o", "ms": 4}
    entries = [(key_line(colour, **look), q.clean(name, 60)) for name, colour in zip(traces, colours, strict=True)]
    if view.phases:
        entries.append((key_line(GREY, ls=":", mfc="white", **look), f"open: {view.phases[1]}"))
    entries.append((key_band(), "from noise alone, 95 %"))
    if marked:
        entries.append((key_band(PLACE, None), "where the misfit sits"))
    handles, labels = zip(*entries, strict=True)
    head_figure(figure, handles, labels)
    return figure


def _mark_places(axes, places: Sequence[Place], shown: q.Quantity, width: float) -> None:
    """Shade where the misfit sits, with words above in lines of that width [inch]."""
    told: list[tuple[float, float]] = []
    for place in places:
        start, end = (shown.scale * edge for edge in place.range)
        axes.axvspan(start, end, color=PLACE, lw=0, zorder=0)
        if any(start < high and low < end for low, high in told):
            continue  # two lines of words in one place cannot be read
        told.append((start, end))
        (low, high), middle = axes.get_xlim(), 0.5 * (start + end)
        share = (middle - low) / (high - low)
        x, side = (low, "left") if share < 0.4 else (high, "right") if share > 0.6 else (middle, "center")
        text = f"{q.format_share(place.share)} of the misfit"
        if place.removes is not None and place.share > 0.995:  # a range that is all there is says nothing
            text = f"{q.format_share(place.removes)} of the misfit explained by a simple force"
        if place.period is not None and math.isfinite(place.period):
            text += f", every {q.format_number(shown.scale * place.period)} {shown.unit}".rstrip()
        axes.annotate(wrap_text(text, width, 8), (x, 1), xycoords=("data", "axes fraction"), ha=side, va="bottom",
                      fontsize=8, color=GREY)


def _choose_edges(traces: Sequence[Trace], variable: str, view: View):
    """Edges of the bins, and how the variable is shown: even bins over a state, one bin a level of a condition."""
    if variable == "time":
        return np.linspace(0, 1, 21), q.Quantity("time", "", 1.0)
    values = np.concatenate([find_values(trace, variable, view) for trace in traces])
    values = values[np.isfinite(values)]
    shown = q.Quantity(view.series, "", 1.0) if variable == "sequence" else q.describe_quantity(variable, values)
    if variable == "direction":
        return np.array([-1.5, 0.0, 1.5]), shown
    if variable in (view.state, view.rate):
        low = 0.0 if variable == view.state else float(values.min())
        return np.linspace(low, max(float(values.max()), low + 1e-9), _count_bins(traces, view) + 1), shown
    levels = np.array(list_levels(traces, variable))
    if len(levels) > 12:
        levels = np.linspace(levels[0], levels[-1], 8)
    middle = 0.5 * (levels[1:] + levels[:-1])
    return np.concatenate([[levels[0] - abs(levels[0]) - 1], middle, [levels[-1] + abs(levels[-1]) + 1]]), shown


@styled
def draw_missing_force(models: Mapping[str, Sequence[Trace]], channel: str | None = None, narrow: bool = False):
    """What a model leaves of the measured force, over the depression or slip, phases apart.

    One line a level of a condition, with two standard errors; of slip records of the condition that the misfit depends
    on most, of impacts of the first.

    Args:
        models: one or two models by name; one row each, or one panel each where there is but one phase.
    """
    first = next(iter(models.values()))
    view = choose_view(first)
    channel, phases = channel or view.force, view.phases or ("",)
    own = pick_channel(first, channel)
    varying = list_varying(own)
    deepest = max(float(np.nan_to_num(trace.state).max(initial=0.0)) for trace in own)
    edges = np.linspace(0, max(deepest, 1e-9), _count_bins(own, view))
    strongest = view.strongest or channel != view.force
    forces = {trace.channel for trace in first} & {"normal_force", "tangential_force"}
    which = f"{q.describe_quantity(channel).name}:\n" if len(forces) > 1 else ""
    name = (_find_strongest(own, varying, edges, view) if strongest else varying[0]) if varying else ""
    shown = q.describe_quantity(channel, own[0].measured, own[0].unit)
    condition = q.describe_quantity(name, [trace.conditions.get(name, math.nan) for trace in own])
    levels = list_levels(own, name) if name else [math.nan]
    state = q.describe_quantity(view.state, edges)
    lines = len(models) * len(phases) if narrow else len(models) if view.phases else 1
    width = NARROW if narrow else WIDTH
    figure = new_figure(0.5 + 2.6 * lines, width)
    panels = figure.subplots(lines, len(models) * len(phases) // lines, squeeze=False, sharex=True, sharey=True)
    shades = matplotlib.colormaps["viridis"](np.linspace(0.05, 0.8, len(levels)))
    handles, labels, lowest, highest = [], [], 0.0, 0.0
    for axes, ((label, traces), phase) in zip(panels.ravel(), itertools.product(models.items(), phases), strict=True):
        traces = pick_channel(traces, channel)
        groups = group_condition(traces, name)
        dress(axes).axhline(0, color=FLOOR, lw=0.9)
        for level, shade in zip(levels, shades, strict=True):
            chosen = [trace for trace, group in zip(traces, groups, strict=True)
                      if not name or abs(group - level) <= 1e-9 * abs(level)]
            keep = [find_phase(trace, phase) for trace in chosen]
            bins = bin_residuals(chosen, [trace.state for trace in chosen], edges, None, keep)
            if not bins.centre.size:
                continue
            scale = shown.scale * chosen[0].sd
            mean, error = scale * bins.mean, scale * bins.error
            line = axes.errorbar(state.scale * bins.centre, mean, 2 * error, color=shade, lw=1.4, elinewidth=0.9,
                                 marker="o", ms=3.5)
            lowest = min(lowest, float(np.min(mean - 2 * error)))
            highest = max(highest, float(np.max(mean + 2 * error)))
            if axes is panels[0, 0] and name:
                labels.append(f"{'' if labels else condition.name} {condition.format(level)} {condition.unit}".strip())
                handles.append(line)
        title = f"{q.clean(label, 80)}: {phase}" if phase else q.clean(label, 80)
        axes.set_title(wrap_text(title, width / panels.shape[1] - 0.6))
    for axes in panels[-1]:
        axes.set_xlabel(state.label)
    for axes in panels[:, 0]:
        axes.set_ylabel(f"{which}measured − model [{shown.unit}]")
    pad = 0.08 * max(highest - lowest, 1e-9)
    panels[0, 0].set_ylim(lowest - pad, highest + pad)
    panels[0, 0].set_xlim(0, None)
    if handles:
        head_figure(figure, handles, labels, columns=8)
    return figure


def _find_strongest(traces: Sequence[Trace], names: Sequence[str], edges: np.ndarray, view: View) -> str:
    """The condition whose levels leave the least scatter between the misfits of their records over the state."""
    # Turned so that friction which is missing is positive.
    profiles = np.array([
        np.nan_to_num(average_bins(np.clip(trace.state, edges[0], edges[-1]),
                                   np.nan_to_num(standardise(trace) * find_values(trace, "direction", view)), edges))
        for trace in traces])

    def spread(name: str) -> float:
        groups, levels = group_condition(traces, name), list_levels(traces, name)
        parts = [profiles[groups == level] for level in levels]
        within = sum(float(np.sum((part - part.mean(axis=0)) ** 2)) for part in parts)
        return within / max(len(traces) - len(levels), 1)

    return min(names, key=spread)


def _count_bins(traces: Sequence[Trace], view: View) -> int:
    """How many bins over the state: fewer in a wide panel where a stroke has few samples."""
    most = max(np.size(trace.time[part]) for trace in traces for part in find_strokes(trace))
    return max(6, min(view.bins, most // 3)) if view.wide else view.bins


@styled
def draw_noise_sizes(traces: Sequence[Trace], noise: Mapping[str, Mapping[str, Any]], narrow: bool = False):
    """One panel a channel: size of the noise against the reading, as measured, as stated and as the fit takes it.

    What is measured is the root mean square over bins of the reading of half the second differences of the residuals,
    scaled to the deviation of white noise: what is smooth, such as a missing force, hardly shows in it.

    Args:
        traces: of one model.
        noise: by channel, as in `Discovery.noise`.
    """
    channels = list_channels(traces)
    figure = new_figure(0.7 + 2.2 * len(channels), NARROW if narrow else WIDTH)
    for axes, channel in zip(figure.subplots(len(channels), 1, squeeze=False).ravel(), channels, strict=True):
        own, one = pick_channel(traces, channel), noise.get(channel, {})
        there = [np.isfinite(trace.measured - trace.model) for trace in own]  # a channel of its own clock has gaps
        residuals = [(trace.measured - trace.model)[part] for trace, part in zip(own, there, strict=True)]
        bent = np.concatenate([(x[1:-1] - 0.5 * (x[:-2] + x[2:])) / math.sqrt(1.5) for x in residuals])
        reading = np.concatenate([np.abs(trace.model[part][1:-1]) for trace, part in zip(own, there, strict=True)])
        shown = q.describe_quantity(channel, own[0].measured, own[0].unit)
        order = np.argsort(reading, kind="stable")
        parts = [part for part in np.array_split(order, max(min(len(order) // 60, 14), 1)) if len(part)]
        bent, reading = shown.scale * bent, shown.scale * reading
        centres = [float(np.median(reading[part])) for part in parts]
        sizes = [float(np.sqrt(np.mean(bent[part] ** 2))) for part in parts]
        dress(axes).plot(centres, sizes, "o", color=INK, ms=4.5)
        along = np.linspace(0.0, max(float(reading.max(initial=0.0)), 1e-300), 80)
        taken = np.full(len(along), shown.scale * float(one.get("sd") or math.nan))
        if one.get("floor") is not None:
            taken = np.hypot(shown.scale * float(one["floor"]), float(one["share"]) * along)
        axes.plot(along, taken, color=colour_models(2)[1], lw=1.6)
        if one.get("stated_sd"):
            axes.axhline(shown.scale * float(one["stated_sd"]), color=GREY, lw=1.0, ls=(0, (4, 3)))
        axes.set_ylim(0.0, 1.2 * max([*sizes, *taken[np.isfinite(taken)]], default=1.0))
        axes.set_xlabel(f"{shown.name}, without its sign [{shown.unit}]")
        axes.set_ylabel(f"noise (sd) [{shown.unit}]")
    head_figure(figure, [key_dot(INK, 5), key_line(colour_models(2)[1]), key_line(GREY, 1.0, ls=(0, (4, 3)))],
                ["measured, from sample to sample", "taken by the fit", "stated"])
    return figure


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
                whose = f"{q.shorten(label, 28)}: " if len(models) > 1 else ""
                remarks.append(f"{whose}rms {q.format_number(shift.rms, 2)}, {q.say_p(shift.p_value)}")
        axes.set_ylim(-top, top)
        words = "time origin" if name == "time" else q.describe_quantity(name).name
        axes.set_title("\n".join([words[:1].upper() + words[1:], *(remarks if narrow else ())]),
                       fontsize=8.5 if narrow else 9.5)
        if not narrow:
            axes.set_title("; ".join(remarks), loc="right", color=GREY, fontsize=8.5)
        axes.set_ylabel("shift /\nstated sd")
    panels[-1].set_xlabel("record, in the order of the campaign")
    panels[-1].margins(x=0.02)
    panels[-1].xaxis.get_major_locator().set_params(integer=True)
    head_figure(figure, [*(key_dot(colour, 5, mark) for _, colour, mark in looks), key_band(edgecolor=PALE, lw=None)],
                [*(q.clean(label, 80) for label, *_ in looks), "two stated standard deviations"])
    return figure
