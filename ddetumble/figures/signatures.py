"""Why an effect fits: what each model changes of the first one's prediction, beside what that one leaves."""

from collections.abc import Mapping, Sequence

import numpy as np

from ..measurement.quantities import clean, describe_conditions, describe_quantity, vary
from ..selection.result import Trace
from .binning import pick_channel
from .style import GREY, INK, NARROW, PALE, WIDTH, colour_models, dress, head_figure, new_figure, styled, wrap_text
from .views import find_span


BINS = 40  # of a record, for the mean of what is left
COUNT = 4  # records drawn


@styled
def draw_signatures(models: Mapping[str, Sequence[Trace]], channel: str, count: int = COUNT, narrow: bool = False):
    """Measured minus the first model, and the change that every other model makes to it, record by record.

    An effect that is what is missing runs along the dots; one that merely removes a part of them has another shape.

    Args:
        models: traces by the model's name, the one that the others extend first.
        channel: that is drawn.
        count: records drawn, of different conditions: those with the largest change.
        narrow: draw for a telephone.

    Returns:
        A matplotlib figure.
    """
    from matplotlib.lines import Line2D

    names = list(models)
    first = pick_channel(models[names[0]], channel)
    others = {name: {t.record: t for t in pick_channel(models[name], channel)} for name in names[1:]}
    change = {t.record: max(_size(own[t.record].model - t.model) / t.sd for own in others.values()) for t in first}
    largest: dict[str, Trace] = {}  # of every condition the record with the largest change
    for trace in sorted(first, key=lambda t: -change[t.record]):
        largest.setdefault(describe_conditions(trace.conditions, vary([t.conditions for t in first])[:3]), trace)
    chosen = list(largest.values())[: 2 if narrow else count]
    columns = 1 if narrow else min(2, len(chosen))
    rows = -(-len(chosen) // columns)
    width = NARROW if narrow else WIDTH
    figure = new_figure(0.8 + 2.2 * rows, width, gap=0.06)
    grid = figure.add_gridspec(rows, columns)
    colours, settings = colour_models(len(names))[1:], vary([t.conditions for t in chosen])[:3]
    along = describe_quantity(first[0].independent, np.concatenate([t.time for t in chosen]))
    shown = describe_quantity(channel, np.concatenate([t.measured - t.model for t in chosen]))
    for k, trace in enumerate(chosen):
        axes = dress(figure.add_subplot(grid[k // columns, k % columns]))
        low, high = find_span(trace)
        inside = (trace.time >= low) & (trace.time <= high)
        x, left = along.scale * trace.time, shown.scale * (trace.measured - trace.model)
        seen = inside & np.isfinite(left)
        axes.axhline(0.0, color=GREY, lw=0.8)
        axes.plot(x[seen], left[seen], ".", ms=2.0, color=PALE, zorder=1, rasterized=True)
        edges = np.linspace(along.scale * low, along.scale * high, BINS + 1)
        place = np.clip(np.digitize(x[seen], edges) - 1, 0, BINS - 1)
        number = np.bincount(place, minlength=BINS)
        mean = np.bincount(place, left[seen], minlength=BINS)[number > 0] / number[number > 0]
        axes.plot(0.5 * (edges[1:] + edges[:-1])[number > 0], mean, "o", ms=3.5, color=INK, zorder=3)
        for name, colour in zip(others, colours, strict=False):
            axes.plot(x[inside], shown.scale * (others[name][trace.record].model - trace.model)[inside], color=colour,
                      lw=1.5, zorder=2)
        said = describe_conditions(trace.conditions, settings)
        axes.set_title("\n".join([clean(trace.record, 24), wrap_text(said, (width - 0.8) / columns - 0.2)]))
        if k + columns >= len(chosen):
            axes.set_xlabel(along.label)
        if k % columns == 0:
            axes.set_ylabel(shown.label)
    head_figure(figure, [Line2D([], [], ls="none", marker="o", ms=4, color=INK),
                         *(Line2D([], [], color=colour, lw=1.6) for _, colour in zip(others, colours, strict=False))],
                [f"measured − {clean(names[0], 24)}",
                 *(f"{clean(name, 30)} − {clean(names[0], 24)}" for name in others)],
                columns=1 if narrow else 3)
    return figure


def _size(values: np.ndarray) -> float:
    finite = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(finite**2))) if finite.size else 0.0
