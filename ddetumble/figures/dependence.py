"""What the misfit depends on: binned residuals against state and condition, and the force that is missing."""

import itertools
import math
from collections.abc import Mapping, Sequence

import matplotlib
import numpy as np

from ..families import View
from ..measurement.quantities import Quantity, clean, describe_quantity, format_number, format_share
from ..selection.result import Place, Trace
from ..selection.text import choose_view
from .style import (
    FLOOR,
    GREY,
    NARROW,
    PLACE,
    WIDTH,
    colour_models,
    dress,
    head_figure,
    key_band,
    key_line,
    new_figure,
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
    pick_channel,
    standardise,
)


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
    first = next(iter(traces.values()))
    figure, rows = _lay_out(view, first, narrow)
    marked = False
    for row in rows:
        low, high = -0.5, 0.5
        for variable, axes in row.items():
            edges, shown = _choose_edges(first, variable, view)
            for bins, error in _draw_means(axes, traces, variable, edges, shown, noise, view):
                low, high = min(low, np.min(bins - error)), max(high, np.max(bins + error))
            places = [place for place in where if place.channel == channel]
            marked |= _mark_places(axes, places, variable, shown, view.wide or narrow)
            _label_variable(axes, variable, shown, view, 1.5 if narrow else 3.0)
        for i, axes in enumerate(row.values()):
            axes.set_ylim(low - 0.08 * (high - low), high + 0.08 * (high - low))
            axes.set_ylabel("" if i else "mean residual / noise")
    look = {"width": 1.1, "marker": "o", "ms": 4}
    entries = [(clean(name, 60), key_line(colour, **look))
               for name, colour in zip(traces, colour_models(len(traces)), strict=True)]
    if view.phases:
        entries.append((f"open: {view.phases[1]}", key_line(GREY, ls=":", mfc="white", **look)))
    entries.append(("from noise alone, 95 %", key_band()))
    if marked:
        entries.append(("where the misfit sits", key_band(PLACE, None)))
    head_figure(figure, [handle for _, handle in entries], [label for label, _ in entries])
    return figure


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
    which = f"{describe_quantity(channel).name}:\n" if len(forces) > 1 else ""
    name = (_find_strongest(own, varying, edges, view) if strongest else varying[0]) if varying else ""
    shown = describe_quantity(channel, own[0].measured, own[0].unit)
    condition = describe_quantity(name, [trace.conditions.get(name, math.nan) for trace in own])
    levels = list_levels(own, name) if name else [math.nan]
    state = describe_quantity(view.state, edges)
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
            lowest, highest = min(lowest, float(np.min(mean - error))), max(highest, float(np.max(mean + error)))
            if axes is panels[0, 0] and name:
                labels.append(f"{'' if labels else condition.name} {condition.format(level)} {condition.unit}".strip())
                handles.append(line)
        title = f"{clean(label, 80)}: {phase}" if phase else clean(label, 80)
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


def _lay_out(view: View, traces: Sequence[Trace], narrow: bool):
    """An empty figure, and its axes by variable, one row after the other; axes of a row share what is up."""
    conditions = list_varying(traces)
    if all("sequence" in trace.conditions for trace in traces) and len(traces) > 3:
        conditions.append("sequence")
    variables = [*view.variables, *conditions[: view.conditions + 1]]
    wide = int(view.wide)
    total = len(variables) + wide
    columns = 2 if narrow else 3 if not wide else total if total <= 6 else math.ceil(total / 2)
    count = math.ceil(total / columns)
    figure = new_figure((0.9 if narrow else 0.5) + 2.5 * count, NARROW if narrow else WIDTH)
    grid = figure.add_gridspec(count, columns)
    rows: list[dict] = [{} for _ in range(count)]
    for k, variable in enumerate(variables):
        row, column = divmod(k + wide * (k > 0), columns)
        left = next(iter(rows[row].values()), None)
        place = grid[row, column : column + 1 + wide * (k == 0)]
        axes = rows[row][variable] = dress(figure.add_subplot(place, sharey=left))
        axes.tick_params(labelleft=left is None)
    return figure, rows


def _draw_means(axes, traces: Mapping[str, Sequence[Trace]], variable: str, edges, shown: Quantity, noise, view: View
                ) -> list[tuple[np.ndarray, np.ndarray]]:
    """Draw the mean residuals of every model in bins of a variable; returns them with their errors."""
    axes.axhline(0, color=FLOOR, lw=0.7)
    drawn, apart = [], view.phases if variable not in (view.rate, "time") and view.phases else ("",)
    for i, (own, colour) in enumerate(zip(traces.values(), colour_models(len(traces)), strict=True)):
        values = [find_values(trace, variable, view) for trace in own]
        for phase in apart:
            bins = bin_residuals(own, values, edges, noise, [find_phase(trace, phase) for trace in own])
            if not bins.centre.size:
                continue
            x, open_ = shown.scale * bins.centre, phase != apart[0]
            if i == len(traces) - 1 and not open_:  # the band that noise alone fills
                axes.fill_between(x, -2 * bins.floor, 2 * bins.floor, color=FLOOR, alpha=0.3, lw=0, zorder=1)
            axes.errorbar(x, bins.mean, 2 * bins.error, color=colour, lw=1.1, elinewidth=0.9, capsize=0,
                          ls=":" if open_ else "-", marker="o", ms=4, mfc="white" if open_ else colour, zorder=3 + i)
            drawn.append((bins.mean, bins.error))
    return drawn


def _mark_places(axes, places: Sequence[Place], variable: str, shown: Quantity, inside: bool) -> bool:
    """Shade where the misfit sits, if a place is a range of this variable; whether there was one.

    The words stay within the panel's width, which is a narrow one's where it is `inside` a row of many.
    """
    names = {variable, "rate"} if variable == "depression_rate" else {variable}
    places = [place for place in places if place.variable in names and variable not in ("time", "direction")]
    told: list[tuple[float, float]] = []
    for place in places:
        start, end = (shown.scale * edge for edge in place.range)
        axes.axvspan(start, end, color=PLACE, lw=0, zorder=0)
        if any(start < high and low < end for low, high in told):
            continue  # two lines of words in one place cannot be read
        told.append((start, end))
        (low, high), middle = axes.get_xlim(), 0.5 * (start + end)
        share = (middle - low) / (high - low)
        place_, side = (low, "left") if share < 0.4 else (high, "right") if share > 0.6 else (middle, "center")
        text = f"{format_share(place.share)} of the misfit"
        if place.removes is not None and place.share > 0.995:  # a range that is all there is says nothing
            text = f"{format_share(place.removes)} of the misfit removed by a simple force"
        if place.period is not None and math.isfinite(place.period):
            text += f", every {format_number(shown.scale * place.period)} {shown.unit}".rstrip()
        text = wrap_text(text, 1.7 if inside and variable != "slip" else 3.0, 8)
        axes.annotate(text, (place_, 1), xycoords=("data", "axes fraction"), ha=side, va="bottom", fontsize=8,
                      color=GREY)
    return bool(places)


def _label_variable(axes, variable: str, shown: Quantity, view: View, width: float):
    """Say what lies along the axes, which are `width` [inch] wide, and where it stands for a phase, which."""
    axes.set_xlabel(wrap_text(view.share if variable == "time" else shown.label, width))
    if variable == "sequence":
        axes.xaxis.get_major_locator().set_params(integer=True)
    if variable == "direction":
        axes.set_xlim(-1.6, 1.6)
        axes.set_xticks([-1, 1], view.phases[::-1])
    elif variable == view.rate and view.phases:
        axes.axvline(0, color=FLOOR, lw=0.7, ls=(0, (3, 3)))
        for text, x in zip(view.phases[::-1], (0.02, 0.98), strict=True):
            axes.text(x, 0.02, text, transform=axes.transAxes, ha="left" if x < 0.5 else "right", color=GREY,
                      fontsize=8)


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


def _choose_edges(traces: Sequence[Trace], variable: str, view: View):
    """Edges of the bins, and how the variable is shown: even bins over a state, one bin a level of a condition."""
    if variable == "time":
        return np.linspace(0, 1, 21), Quantity("time", "", 1.0)
    values = np.concatenate([find_values(trace, variable, view) for trace in traces])
    values = values[np.isfinite(values)]
    shown = Quantity(view.series, "", 1.0) if variable == "sequence" else describe_quantity(variable, values)
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
