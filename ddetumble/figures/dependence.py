"""What the misfit depends on: binned residuals against state and condition, and the force that is missing."""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from ..discrepancy.records import Place, Trace
from .binning import bin_residuals, find_contact, group_values, pick_channel, share_of_contact
from .labels import Quantity, clean, describe_quantity, format_share, vary
from .style import FLOOR, GREY, INK, PLACE, WIDTH, colour_models, dress, head_figure, new_figure, styled


@styled
def draw_dependence(
    models: Mapping[str, Sequence[Trace]],
    channel: str = "normal_force",
    noise: Mapping | None = None,
    where: Sequence[Place] = (),
):
    """Mean residual over the noise against depression, its rate, time, and the conditions.

    Loading and unloading are drawn apart where the variable does not tell them apart. The band is what noise alone
    leaves with a mean in 95 % of cases; error bars are two standard errors from the scatter between records.

    Args:
        models: one or two models by name, the reference model first.
        channel: what to draw.
        noise: `correlation` and `white_share` of the channel's noise.
        where: places of the misfit, marked where they name one of the variables drawn.

    Returns:
        A matplotlib figure.
    """
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch
    from matplotlib.ticker import MaxNLocator

    traces = {name: pick_channel(all_, channel) for name, all_ in models.items()}
    first = next(iter(traces.values()))
    conditions = [name for name in vary(trace.conditions for trace in first) if len(_levels(first, name)) > 1]
    if all("sequence" in trace.conditions for trace in first) and len(first) > 3:
        conditions.append("sequence")
    variables = ["depression", "depression_rate", "time", *conditions[:3]]
    columns = 3
    rows = math.ceil(len(variables) / columns)
    figure = new_figure(0.5 + 2.5 * rows, WIDTH)
    panels = figure.subplots(rows, columns, squeeze=False, sharey="row").ravel()
    marked, reach = False, np.tile([-0.5, 0.5], (rows, 1))
    for k, (axes, variable) in enumerate(zip(panels, variables, strict=False)):
        dress(axes)
        low, high = reach[k // columns]
        axes.axhline(0, color=FLOOR, lw=0.7)
        edges, shown = _choose_edges(first, variable)
        for i, ((_, own), colour) in enumerate(zip(traces.items(), colour_models(len(traces)), strict=True)):
            values = [_find_values(trace, variable) for trace in own]
            for phase in ("loading", "unloading") if variable not in ("depression_rate", "time") else ("",):
                bins = bin_residuals(own, values, edges, noise, [_find_phase(trace, phase) for trace in own])
                if not bins.centre.size:
                    continue
                x = shown.scale * bins.centre
                if i == len(traces) - 1 and phase != "unloading":
                    _draw_band(axes, x, 2 * bins.floor)
                open_ = phase == "unloading"
                axes.errorbar(x, bins.mean, 2 * bins.error, color=colour, lw=1.1, elinewidth=0.9, capsize=0,
                              ls=":" if open_ else "-", marker="o", ms=4, mfc="white" if open_ else colour,
                              zorder=3 + i)
                low = min(low, float(np.min(bins.mean - bins.error)))
                high = max(high, float(np.max(bins.mean + bins.error)))
        reach[k // columns] = low, high
        for place in where:
            if place.channel == channel and _same(place.variable, variable) and variable != "time":
                start, end = (shown.scale * edge for edge in place.range)
                axes.axvspan(start, end, color=PLACE, lw=0, zorder=0)
                axes.annotate(f"{format_share(place.share)} of the misfit", (0.5 * (start + end), 1),
                              xycoords=("data", "axes fraction"), ha="center", va="bottom", fontsize=8, color=GREY)
                marked = True
        axes.set_xlabel("share of the contact time" if variable == "time" else shown.label)
        if variable == "sequence":
            axes.xaxis.set_major_locator(MaxNLocator(5, integer=True))
        if variable == "depression_rate":
            axes.axvline(0, color=FLOOR, lw=0.7, ls=(0, (3, 3)))
            for text, x in (("unloading", 0.02), ("loading", 0.98)):
                axes.text(x, 0.02, text, transform=axes.transAxes, ha="left" if x < 0.5 else "right", color=GREY,
                          fontsize=8)
    for axes in panels[len(variables):]:
        axes.set_visible(False)
    for axes, (low, high) in zip(panels[::columns], reach, strict=True):
        axes.set_ylim(low - 0.08 * (high - low), high + 0.08 * (high - low))
        axes.set_ylabel("mean residual / noise")
    handles = [Line2D([], [], color=colour, marker="o", ms=4, lw=1.1) for colour in colour_models(len(traces))]
    labels = [clean(name, 60) for name in traces]
    handles += [Line2D([], [], color=GREY, marker="o", ms=4, lw=1.1, ls=":", mfc="white")]
    handles += [Patch(facecolor=FLOOR, alpha=0.35, lw=0)]
    labels += ["open: unloading", "from noise alone, 95 %"]
    if marked:
        handles.append(Patch(facecolor=PLACE, lw=0))
        labels.append("where the misfit sits")
    head_figure(figure, handles, labels)
    return figure


@styled
def draw_missing_force(models: Mapping[str, Sequence[Trace]], channel: str = "normal_force"):
    """What a model leaves of the measured force, over the depression, while loading and while unloading.

    Args:
        models: one or two models by name, one row each.
        channel: what to draw.

    Returns:
        A matplotlib figure: one line a level of the first condition, with two standard errors.
    """
    import matplotlib

    first = next(iter(models.values()))
    own = pick_channel(first, channel)
    varying = [name for name in vary(trace.conditions for trace in own) if len(_levels(own, name)) > 1]
    name = varying[0] if varying else ""
    shown = describe_quantity(channel, own[0].measured, own[0].unit)
    condition = describe_quantity(name, [trace.conditions.get(name, math.nan) for trace in own])
    levels = _levels(own, name) if name else [math.nan]
    figure = new_figure(0.5 + 2.6 * len(models), WIDTH)
    panels = figure.subplots(len(models), 2, squeeze=False, sharex=True, sharey=True)
    shades = matplotlib.colormaps["viridis"](np.linspace(0.05, 0.8, len(levels)))
    deepest = max(float(np.nan_to_num(trace.depression).max(initial=0.0)) for trace in own)
    edges = np.linspace(0, max(deepest, 1e-9), 15)
    handles, lowest, highest = [], 0.0, 0.0
    for row, (label, traces) in enumerate(models.items()):
        traces = pick_channel(traces, channel)
        groups = group_values([trace.conditions.get(name, math.nan) for trace in traces]) if name else []
        for column, phase in enumerate(("loading", "unloading")):
            axes = dress(panels[row, column])
            axes.axhline(0, color=FLOOR, lw=0.9)
            for level, shade in zip(levels, shades, strict=True):
                near = 1e-9 * abs(level)
                chosen = [trace for i, trace in enumerate(traces) if not name or abs(groups[i] - level) <= near]
                keep = [_find_phase(trace, phase) for trace in chosen]
                bins = bin_residuals(chosen, [trace.depression for trace in chosen], edges, None, keep)
                if not bins.centre.size:
                    continue
                scale = shown.scale * chosen[0].sd
                line = axes.errorbar(1e3 * bins.centre, scale * bins.mean, 2 * scale * bins.error, color=shade, lw=1.4,
                                     elinewidth=0.9, marker="o", ms=3.5)
                lowest = min(lowest, float(np.min(scale * (bins.mean - bins.error))))
                highest = max(highest, float(np.max(scale * (bins.mean + bins.error))))
                if row == 0 and column == 0 and name:
                    text = f"{condition.name} " if not handles else ""
                    handles.append((line, f"{text}{condition.format(level)} {condition.unit}".strip()))
            axes.set_title(f"{clean(label, 50)}: {phase}")
            if row == len(models) - 1:
                axes.set_xlabel("depression [mm]")
        panels[row, 0].set_ylabel(f"measured − model [{shown.unit}]")
    pad = 0.08 * max(highest - lowest, 1e-9)
    panels[0, 0].set_ylim(lowest - pad, highest + pad)
    panels[0, 0].set_xlim(0, None)
    if handles:
        head_figure(figure, [line for line, _ in handles], [text for _, text in handles], columns=8)
    return figure


def _levels(traces: Sequence[Trace], name: str) -> list[float]:
    """Distinct nominal values of a condition."""
    groups = group_values([trace.conditions.get(name, math.nan) for trace in traces])
    return sorted({value for value in groups if math.isfinite(value)})


def _same(one: str, other: str) -> bool:
    return {one, other} <= {"rate", "depression_rate"} or one == other


def _find_values(trace: Trace, variable: str) -> np.ndarray:
    """The variable at every sample of a trace, SI; time as a share of the contact."""
    if variable == "time":
        return share_of_contact(trace)
    if variable in ("depression", "depression_rate"):
        return np.asarray(getattr(trace, variable), float)
    return np.full(np.size(trace.time), trace.conditions.get(variable, math.nan))


def _find_phase(trace: Trace, phase: str) -> np.ndarray:
    """Which samples count: those in contact, while loading, or while unloading."""
    start, end = find_contact(trace)
    inside = (trace.time >= start) & (trace.time <= end)
    if phase == "loading":
        return inside & (trace.depression_rate > 0)
    if phase == "unloading":
        return inside & (trace.depression_rate <= 0) & (trace.depression > 0)
    return inside


def _choose_edges(traces: Sequence[Trace], variable: str):
    """Edges of the bins, and how the variable is shown: even bins over a state, one bin a level of a condition."""
    if variable == "time":
        return np.linspace(0, 1, 21), Quantity("time", "", 1.0)
    values = np.concatenate([_find_values(trace, variable) for trace in traces])
    values = values[np.isfinite(values)]
    shown = describe_quantity(variable, values)
    if variable in ("depression", "depression_rate"):
        low = 0.0 if variable == "depression" else float(values.min())
        return np.linspace(low, max(float(values.max()), low + 1e-9), 16), shown
    levels = np.array(_levels(traces, variable))
    if len(levels) > 12:
        levels = np.linspace(levels[0], levels[-1], 8)
    middle = 0.5 * (levels[1:] + levels[:-1])
    return np.concatenate([[levels[0] - abs(levels[0]) - 1], middle, [levels[-1] + abs(levels[-1]) + 1]]), shown


def _draw_band(axes, x: np.ndarray, half: np.ndarray):
    """The band that noise alone fills."""
    order = np.argsort(x)
    axes.fill_between(x[order], -half[order], half[order], color=FLOOR, alpha=0.3, lw=0, zorder=1)
    axes.tick_params(labelcolor=INK)
