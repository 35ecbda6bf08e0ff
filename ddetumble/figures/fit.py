"""Records as measured, and model against measurement: residuals, peaks, what an effect changes, predicted records."""

import dataclasses as dc
import math
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
import pandas as pd
from matplotlib.ticker import MaxNLocator
from scipy.interpolate import CubicSpline

from .._errors import InputError
from ..measurement.campaign import Campaign
from ..measurement.quantities import Quantity, clean, describe_conditions, describe_quantity, shorten_names, vary
from ..measurement.units import si_unit
from ..selection.coefficient import Coefficients
from ..selection.compare import Comparisons
from ..selection.result import Trace
from ..selection.text import choose_view
from .palette import AFTER, BEFORE, FLOOR, GREY, INK, KIN, MORE, PALE
from .style import (
    NARROW,
    STEPS,
    WIDTH,
    colour_models,
    count_characters,
    dress,
    head_figure,
    key_band,
    key_dot,
    key_line,
    new_figure,
    styled,
    wrap_text,
)
from .traces import (
    average_bins,
    choose_records,
    find_span,
    find_stretch,
    find_strokes,
    group_values,
    pick_channel,
    sort_traces,
    standardise,
)


KEY = 18  # characters of a record's name: what a panel's title has room for
BINS = 40  # of a record, for the mean of what is left: fewer hide its shape, more its mean
MOST, COLUMNS = 12, 4  # predicted records that are drawn, and in a row: more are too small to read
LINES = (AFTER, BEFORE, MORE[0])  # channels of one unit in one panel


@styled
def draw_fit(models: Mapping[str, Sequence[Trace]], channel: str | None = None, count: int = 8, narrow: bool = False):
    """At most `count` records spread over the conditions, each with the models through it and, below, the residual over
    the noise.

    Raises:
        TypeError: The models are not given by name.
    """
    if not isinstance(models, Mapping):
        raise TypeError(f"draw_fit takes the traces of each model by its name, {{name: comparison.traces}}, not a "
                        f"{type(models).__name__}")
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
    # Half height of the residual strips, in units of the noise: nearly all points of the drawn records.
    drawn = [own[trace.record] for own in traces.values() for trace in chosen if trace.record in own]
    values = np.abs(np.concatenate(list(map(standardise, drawn))))
    values = values[np.isfinite(values)]
    limit = float(max(4.0, math.ceil(np.quantile(values, 0.995)))) if values.size else 4.0
    handles, lower = [], None
    for i, trace in enumerate(chosen):
        row, column = divmod(i, columns)
        inner = grid[row, column].subgridspec(2, 1, height_ratios=(2.6, 1), hspace=0.06)
        upper = dress(figure.add_subplot(inner[0]))
        lower = dress(figure.add_subplot(inner[1], sharex=upper, sharey=lower), grid="")
        # One time axis for all: each model has shifted the record's time origin by as much as suits it.
        time = along.scale * np.asarray(last.get(trace.record, trace).time)
        upper.plot(time, shown.scale * trace.measured, ".", color=INK, ms=2.4, mew=0, zorder=2)
        _draw_noise(lower)
        lines = []
        for own, colour in zip(traces.values(), colour_models(len(traces)), strict=True):
            if trace.record not in own:
                continue
            model = own[trace.record]
            style = "--" if len(traces) == 2 and not lines else "-"
            lines += upper.plot(time, shown.scale * model.model, style, color=colour, lw=1.4, zorder=3)
            lower.plot(time, standardise(model), ".", color=colour, ms=1.6, mew=0, alpha=0.45)
            lower.plot(time, _smooth(model), color=colour, lw=1.3)  # what is beyond leaves the strip
        handles = handles or [key_dot(INK, 7, "."), *lines]
        start, end = find_stretch(last.get(trace.record, trace))
        margin = 0.06 * (end - start)
        upper.set_xlim(max(along.scale * (start - margin), time[0]), min(along.scale * (end + 2.5 * margin), time[-1]))
        title = titles[trace.record] or short[trace.record]
        size = 9.5 if len(title) < 24 else 8.5 if len(title) < 28 else 8.0
        title = wrap_text(title, panel, 0.95 * size)
        upper.set_title(title, fontsize=size)
        if titles[trace.record] and beside:
            upper.set_title(short[trace.record], loc="right", color=GREY, fontsize=8)
        elif titles[trace.record]:  # in a line above the conditions
            upper.set_title(short[trace.record] + "\n" * (title.count("\n") + 1), loc="center", color=GREY, fontsize=8,
                            x=0.0, ha="left", linespacing=1.6)
        upper.tick_params(labelbottom=False)
        upper.yaxis.set_major_locator(MaxNLocator(5, steps=STEPS))
        lower.set_ylim(-1.1 * limit, 1.1 * limit)
        lower.yaxis.set_major_locator(MaxNLocator(3, steps=STEPS))
        if column:
            lower.tick_params(labelleft=False)
        else:
            upper.set_ylabel(wrap_text(shown.label, 1.75))
            lower.set_ylabel("residual\n/ noise")
        if row >= rows - 2:  # all panels of a row leave the same room
            lower.set_xlabel(along.label if i + columns >= len(chosen) else " " if len(chosen) % columns else "")
    labels = [clean(name, 60) for name, own in traces.items() if chosen[0].record in own]
    head_figure(figure, [*handles, key_band()], ["measured", *labels, "± 2 × noise"])
    return figure


@styled
def draw_values(models: Mapping[str, Sequence[Trace]], channel: str | None = None, narrow: bool = False):
    """One number a record: measured and modelled against the condition that varies most, residuals below."""
    channel = channel or next(trace.channel for traces in models.values() for trace in traces)
    traces = {name: sort_traces(pick_channel(all_, channel)) for name, all_ in models.items()}
    first = next(iter(traces.values()))
    shown = describe_quantity(channel, [float(trace.measured[0]) for trace in first], first[0].unit)
    along, x = _choose_condition(trace.conditions for trace in first)
    figure = new_figure(4.4, NARROW if narrow else 8.0)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(2.4, 1))
    dress(upper)
    dress(lower, grid="")
    measured = shown.scale * np.array([trace.measured[0] for trace in first])
    noise = shown.scale * np.array([trace.sd for trace in first])
    handles = [upper.errorbar(x, measured, 2 * noise, fmt="o", color=INK, ms=5, lw=1.1, capsize=3, zorder=4)]
    _draw_noise(lower)
    shift = 0.006 * np.ptp(x) if len(traces) > 1 else 0.0
    others = [np.array([trace.conditions.get(name, np.nan) for trace in first], float)
              for name in vary(trace.conditions for trace in first)]
    lines = _find_lines(x, [own for own in others if not _run_along(own, x)])
    for i, (own, colour) in enumerate(zip(traces.values(), colour_models(len(traces)), strict=True)):
        model = shown.scale * np.array([trace.model[0] for trace in own])
        style = "--s" if i == 0 and len(traces) > 1 else "-D"
        handles += [upper.plot(x[k], model[k], style, color=colour, lw=1.4, ms=4.5)[0] for k in lines][:1]
        lower.plot(x + (2 * i - 1) * shift, [standardise(trace)[0] for trace in own], "o", color=colour, ms=5)
    upper.set_ylabel(shown.label)
    lower.set_ylabel("residual / noise")
    lower.set_xlabel(along.label if along else "record")
    head_figure(figure, handles, ["measured, ± 2 × noise", *(clean(label, 60) for label in traces)])
    return figure


@styled
def draw_signatures(models: Comparisons | Mapping[str, Sequence[Trace]], channel: str, count: int = 4,
                    narrow: bool = False):
    """Measured minus the first model, and the change that every other model, which extends it, makes to it, record by
    record; `count` records of different conditions: those with the largest change.

    An effect that is what is missing runs along the dots; one that merely removes a part of them has another shape.

    Args:
        models: what `compare` of several models returned, or its `traces`: the records beside each model, by its name.
        channel: what is drawn.
        count: of records.
    """
    if isinstance(models, Comparisons):
        models = models.traces
    name, *names = models
    first = pick_channel(models[name], channel)
    others = [{trace.record: trace for trace in pick_channel(models[other], channel)} for other in names]
    change = {t.record: max(np.mean(np.nan_to_num((own[t.record].model - t.model) / t.sd) ** 2) for own in others)
              for t in first}
    largest: dict[str, Trace] = {}  # of every condition the record with the largest change
    varying = vary(trace.conditions for trace in first)[:3]
    for trace in sorted(first, key=lambda t: -change[t.record]):
        largest.setdefault(describe_conditions(trace.conditions, varying), trace)
    chosen = list(largest.values())[: 2 if narrow else count]
    columns = 1 if narrow else min(2, len(chosen))
    width = NARROW if narrow else WIDTH
    figure = new_figure(0.8 + 2.2 * -(-len(chosen) // columns), width, gap=0.06)
    grid = figure.add_gridspec(-(-len(chosen) // columns), columns)
    colours, settings = colour_models(len(models))[1:], vary(t.conditions for t in chosen)[:3]
    along = describe_quantity(first[0].independent, np.concatenate([t.time for t in chosen]))
    shown = describe_quantity(channel, np.concatenate([t.measured - t.model for t in chosen]))
    for k, trace in enumerate(chosen):
        axes = dress(figure.add_subplot(grid[k // columns, k % columns]))
        low, high = find_span(trace)
        inside = (trace.time >= low) & (trace.time <= high)
        x, left = along.scale * trace.time, shown.scale * (trace.measured - trace.model)
        axes.axhline(0.0, color=GREY, lw=0.8)
        axes.plot(x[inside], left[inside], ".", ms=2.0, color=PALE, zorder=1, rasterized=True)
        edges = np.linspace(along.scale * low, along.scale * high, BINS + 1)
        mean = average_bins(x[inside], left[inside], edges)
        axes.plot(0.5 * (edges[1:] + edges[:-1]), mean, "o", ms=3.5, color=INK, zorder=3)
        for own, colour in zip(others, colours, strict=True):
            axes.plot(x[inside], shown.scale * (own[trace.record].model - trace.model)[inside], color=colour, lw=1.5,
                      zorder=2)
        said = describe_conditions(trace.conditions, settings)
        axes.set_title("\n".join([clean(trace.record, 24), wrap_text(said, (width - 0.8) / columns - 0.2)]))
        if k + columns >= len(chosen):
            axes.set_xlabel(along.label)
        if k % columns == 0:
            axes.set_ylabel(shown.label)
    labels = [f"measured − {clean(name, 24)}", *(f"{clean(other, 30)} − {clean(name, 24)}" for other in names)]
    head_figure(figure, [key_dot(INK, 4), *map(key_line, colours)], labels, columns=1 if narrow else 3)
    return figure


@styled
def draw_prediction(table, settings: Mapping[str, Mapping[str, float]]):
    """What `predict` returned, over time or slip, one column a record, with two standard deviations of the mean and of
    a new test; `settings` are every record's conditions, for the panels' titles.

    Channels of one unit are drawn together. Of more than four records only the main ones are drawn, and twelve records
    at most.
    """
    channels = [name.removesuffix("_sd_new") for name in table.columns if name.endswith("_sd_new")]
    if not {"slip", "time"} & set(table.columns[:2]):
        return _draw_predicted_values(table, settings, channels)
    abscissa = "slip" if "slip" in table.columns[:2] else "time"
    keys = list(dict.fromkeys(table["record"]))[:MOST]
    units: dict[str, list[str]] = {}
    for channel in channels:
        units.setdefault(si_unit(channel), []).append(channel)
    groups = [own[k : k + len(LINES)] for own in units.values() for k in range(0, len(own), len(LINES))]
    groups = groups if len(keys) <= COLUMNS else groups[:1]
    columns = min(COLUMNS, len(keys))
    rows = math.ceil(len(keys) / columns) * len(groups)
    wide = columns > 1 or len(groups[0]) > 1  # one panel is narrower, if its legend has room
    width, short = WIDTH if wide else 7.0, shorten_names(keys, 22)
    figure = new_figure(0.6 + 2.9 * rows, width, gap=0.045)
    grid = figure.add_gridspec(rows, columns)
    names = vary(settings.values())[:3]
    along = describe_quantity(abscissa, table[abscissa])
    first: dict[int, tuple] = {}  # panels of one row share their scales
    for i, key in enumerate(keys):
        own = table[table["record"] == key].sort_values(abscissa)
        for g, group in enumerate(groups):
            row, column = (g, i) if len(groups) > 1 else divmod(i, columns)
            inner = grid[row, column].subgridspec(2, 1, height_ratios=(2.8, 1), hspace=0.08)
            same = first.get(row, (None, None))
            upper = dress(figure.add_subplot(inner[0], sharey=same[0]))
            lower = dress(figure.add_subplot(inner[1], sharex=upper, sharey=same[1]))
            first.setdefault(row, (upper, lower))
            for channel, colour in zip(group, LINES, strict=False):
                shown = describe_quantity(channel, own[channel])
                x, mean = along.scale * own[abscissa].to_numpy(), shown.scale * own[channel].to_numpy()
                for ending, fill, alpha in (("_sd_new", FLOOR, 0.25), ("_sd", KIN, 0.8)):
                    sd = 2.0 * shown.scale * own[channel + ending].to_numpy()
                    upper.fill_between(x, mean - sd, mean + sd, color=fill, alpha=alpha, lw=0)
                    lower.fill_between(x, -sd, sd, color=fill, alpha=alpha, lw=0)  # often thinner than the line
                upper.plot(x, mean, "-" if len(x) > 1 else "o", color=colour, lw=1.4)
            upper.tick_params(labelbottom=False, labelleft=column == 0)
            lower.tick_params(labelleft=column == 0)
            if g == 0:
                said = describe_conditions(settings[key], names)
                lines = [short[str(key)], wrap_text(said, (width - 0.8) / columns - 0.2)]
                upper.set_title("\n".join(line for line in lines if line))
            if row == rows - 1 or i + columns >= len(keys):
                lower.set_xlabel(along.label)
            if column == 0:
                every = [describe_quantity(channel, table[channel]) for channel in group]
                angular = group[0].startswith(("angular", "attitude"))
                word = group[0].rsplit("_", 1)[0].replace("_", " ") if angular else "force"
                upper.set_ylabel(every[0].label if len(every) == 1 else dc.replace(every[0], name=word).label)
                lower.set_ylabel("± 2 sd")
    most = max(groups, key=len)
    words = ["mean"] if len(most) == 1 else [describe_quantity(c).name for c in most]
    head_figure(figure, [*map(key_line, LINES[: len(most)]), key_band(KIN, 0.8), key_band(alpha=0.25)],
                [*words, "± 2 sd of the mean", "± 2 sd of a new measurement"])
    return figure


def _draw_predicted_values(table, settings: Mapping[str, Mapping[str, float]], channels: Sequence[str]):
    """Predicted values, one point a record, over the condition that varies most."""
    along, x = _choose_condition(settings.values())
    figure = new_figure(0.6 + 2.6 * len(channels), 8.0)
    panels = figure.subplots(len(channels), 1, sharex=True, squeeze=False)[:, 0]
    for axes, channel in zip(panels, channels, strict=True):
        shown = describe_quantity(channel, table[channel])
        mean, sd, new = (shown.scale * table[channel + ending].to_numpy() for ending in ("", "_sd", "_sd_new"))
        handles = [dress(axes).errorbar(x, mean, 2.0 * size, fmt=mark, color=colour, ms=5, lw=width, capsize=cap)
                   for size, mark, colour, width, cap in ((new, "none", FLOOR, 1.2, 4), (sd, "o", AFTER, 2.2, 0))]
        axes.set_ylabel(shown.label)
    panels[-1].set_xlabel(along.label if along else "record")
    head_figure(figure, handles[::-1], ["mean, ± 2 sd", "± 2 sd of a new measurement"])
    return figure


@styled
def draw_coefficients(found: Coefficients, narrow: bool = False):
    """A coefficient over the independent variable, one panel a record: measured, and the model with its band.

    Args:
        found: of the records.
        narrow: whether the panels stand below one another.
    """
    curves = found.curves
    count, columns = len(curves), 1 if narrow else len(curves)
    width, height = (NARROW, 2.5 * count) if narrow else (max(WIDTH * columns / 3, 4.5), 3.0)
    figure = new_figure(0.7 + height, width)
    panels = figure.subplots(2 * count // columns, columns, sharex=True, squeeze=False,
                             height_ratios=[2, 1] * (count // columns))
    pairs = panels.reshape(-1, 2).tolist() if narrow else panels.T.tolist()
    shown = describe_quantity(found.along, np.concatenate([curve.along for curve in curves]))
    names = vary(curve.conditions for curve in curves)
    short = shorten_names((curve.record for curve in curves), KEY)
    for (axes, lower), curve in zip(pairs, curves, strict=True):
        x, there = shown.scale * curve.along, shown.scale * curve.measured_along
        rest = curve.measured - CubicSpline(curve.along, curve.mean)(curve.measured_along)
        for where, values, middle in ((axes, curve.measured, 0.0), (lower, rest, curve.mean)):
            dress(where).plot(there, values, ".", color=BEFORE, ms=2.5, alpha=0.5, lw=0)
            where.fill_between(x, curve.low - middle, curve.high - middle, color=AFTER, alpha=0.3, lw=0)
            where.plot(x, curve.mean - middle, color=AFTER, lw=1.2)
            where.sharey(pairs[0][where is lower])
            where.set_ylabel(("difference" if where is lower else found.name) if narrow or axes is pairs[0][0] else "")
        title = f"{short[curve.record]}   {describe_conditions(curve.conditions, names[:3])}"
        axes.set_title(wrap_text(title, width / columns - 0.6, 9), fontsize=9)
        lower.set_xlabel(shown.label if not narrow or axes is pairs[-1][0] else "")
    keys = [(key_line(AFTER, 1.2), "model"), (key_band(AFTER, 0.3, lw=None), "its 95 % interval")]
    if any(curve.measured.size for curve in curves):
        keys.insert(0, (key_dot(BEFORE, 4), "measured"))
    head_figure(figure, [handle for handle, _ in keys], [word for _, word in keys])
    return figure


def _choose_condition(settings: Iterable[Mapping[str, float]]) -> tuple[Quantity | None, np.ndarray]:
    """The condition that varies most over some records, and its values as they are shown; none, and their numbers,
    where none varies."""
    settings = list(settings)
    values = {name: np.array([own.get(name, np.nan) for own in settings], float) for name in vary(settings)}
    spread = {name: np.ptp(v) / max(np.abs(v).max(), 1e-300) for name, v in values.items() if np.isfinite(v).all()}
    if not spread:
        return None, np.arange(1.0, len(settings) + 1)
    name = max(spread, key=lambda key: spread[key])
    along = describe_quantity(name, values[name])
    return along, along.scale * values[name]


def _draw_noise(axes):
    """Two standard deviations of the noise, below residuals."""
    axes.axhspan(-2, 2, color=FLOOR, alpha=0.18, lw=0)
    axes.axhline(0, color=FLOOR, lw=0.7)


def _find_lines(x: np.ndarray, others: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Which points a line joins, in their order: all of them, or those that are alike in every other condition."""
    if np.all(np.diff(x) > 0):
        return [np.arange(x.size)]
    keys = list(zip(*map(group_values, others), strict=True)) or [()] * x.size
    lines = [np.array([i for i, own in enumerate(keys) if own == key]) for key in dict.fromkeys(keys)]
    return [line[np.argsort(x[line], kind="stable")] for line in lines if line.size]


def _run_along(values: np.ndarray, x: np.ndarray) -> bool:
    """Whether a condition has one value at each place along the axis, so that it parts no lines."""
    return all(np.ptp(values[x == place]) == 0 for place in np.unique(x))


def _smooth(trace: Trace) -> np.ndarray:
    """Running mean of the residual over about a twenty-fifth of the trace, stroke by stroke, without missing samples.

    Where only the end of many turns is drawn, over three samples: a mean over turns would hide what turns with them.
    """
    residual = standardise(trace)
    width = max(3, residual.size // 25) | 1 if find_stretch(trace) == find_span(trace) else 3
    smooth = residual.copy()
    for part in find_strokes(trace):
        if residual[part].size > width:
            smooth[part] = pd.Series(residual[part]).rolling(width, center=True, min_periods=1).mean()
    return smooth


DRAWN = 40  # records that are drawn: more hide one another


@styled
def draw_records(campaign: Campaign):
    """Every channel of the first records over the independent variable; a line marks nought, where contact begins."""
    samples, along = campaign.samples, campaign.independent
    if samples is None or along is None:
        raise InputError(f"campaign {campaign.name} contains only single values, and no records to draw")
    x, keys = describe_quantity(along.name, samples[along.name].to_numpy(), along.unit), campaign.record_keys
    figure = new_figure(0.6 + 2.0 * len(campaign.channels))
    panels = figure.subplots(len(campaign.channels), 1, sharex=True, squeeze=False)[:, 0]
    for axes, (name, column) in zip(panels, campaign.channels.items(), strict=True):
        y = describe_quantity(name, samples[name].to_numpy(), column.unit)
        for key in keys[:DRAWN]:
            trace = campaign.trace(key)
            there = np.isfinite(trace[name].to_numpy())
            axes.plot(x.scale * trace[along.name][there], y.scale * trace[name][there], lw=0.8, alpha=0.7, color=BEFORE)
        axes.axvline(0.0, color=INK, lw=0.6)
        dress(axes, ylabel=wrap_text(y.label, 1.75))
    figure.align_ylabels(panels)
    panels[-1].set_xlabel(x.label)
    count = f"{DRAWN} of " * (len(keys) > DRAWN) + f"{len(keys)} records"
    panels[0].set_title(keys[0] if len(keys) == 1 else count)
    return figure
