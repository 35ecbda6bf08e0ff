"""Estimates of several campaigns or specimens beside what they give together: a forest plot."""

import math
from collections.abc import Mapping

from ..measurement.quantities import clean
from .palette import AFTER, INK
from .style import (
    NARROW,
    WIDTH,
    SpacedLocator,
    dress_rows,
    head_figure,
    key_band,
    key_dot,
    new_figure,
    styled,
    wrap_text,
)


COLUMNS = 3  # panels side by side


@styled
def draw_forest(intervals: Mapping[str, Mapping[str, tuple[float, float, float]]], narrow: bool = False):
    """A panel a parameter and a line an estimate, with its 95 % interval.

    Args:
        intervals: estimate and ends by parameter and by who made it, the one of all together last: `intervals` of what
            `fit_jointly` and `fit_population` return. What is not determined has ends that are not finite, and no line.
        narrow: for a telephone.
    """
    columns = 1 if narrow else min(COLUMNS, len(intervals))
    rows = math.ceil(len(intervals) / columns)
    width, most = NARROW if narrow else WIDTH, max(map(len, intervals.values()))
    figure = new_figure(0.5 + rows * (0.75 + 0.27 * most), width)
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes, (name, own) in zip(panels, intervals.items(), strict=False):
        dress_rows(axes, [clean(label, 24) for label in own], room=0.6)
        for row, (value, low, high) in enumerate(own.values()):
            colour = AFTER if row == len(own) - 1 else INK
            if math.isfinite(low) and math.isfinite(high):
                axes.plot([low, high], [row, row], color=colour, lw=2.2, alpha=0.6)
                axes.plot(value, row, "o", color=colour, ms=5)
                if row == len(own) - 1:
                    axes.axvspan(low, high, color=AFTER, alpha=0.12, lw=0)
        axes.xaxis.set_major_locator(SpacedLocator(4))
        axes.set_title(wrap_text(clean(name, 60), width / columns - 0.5))
    for axes in panels[len(intervals):]:
        axes.set_visible(False)
    head_figure(figure, [key_dot(INK), key_dot(AFTER), key_band(AFTER, 0.12)],
                ["one alone", "all together", "its 95 % interval"])
    return figure
