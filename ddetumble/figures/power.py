"""Power: how often an effect of a given strength is seen, and named."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from .style import AFTER, BEFORE, FLOOR, GREY, NARROW, WIDTH, dress, head_figure, new_figure, styled, wrap_text


CURVES = (("seen", "something is missing", BEFORE, "o"), ("named", "the effect, or a set that holds it", AFTER, "s"))


@styled
def draw_power(bins: Sequence[Mapping[str, Any]], level: float = 0.01, narrow: bool = False):
    """Share of cases in which an effect is seen, and named, against its strength, with 95 % limits.

    Args:
        bins: of `ddetumble.exam.scoring.measure_power`: `low`, `high`, and shares `seen` and `named`.
        level: of the test for a lack of fit, drawn in.
        narrow: draw for a telephone.

    Returns:
        A matplotlib figure.
    """
    from matplotlib.lines import Line2D
    from matplotlib.ticker import FixedLocator, NullLocator, PercentFormatter

    figure = new_figure(3.6, NARROW if narrow else WIDTH)
    axes = dress(figure.add_subplot(), grid="both")
    axes.set_xscale("log")
    edges = sorted({b["low"] for b in bins} | {b["high"] for b in bins})
    axes.axhline(level, color=FLOOR, lw=1.0, ls=(0, (4, 3)))
    axes.axvline(2.0, color=FLOOR, lw=1.0, ls=(0, (1, 2)))
    for shift, (key, _, colour, marker) in zip((0.985, 1.015), CURVES, strict=True):
        held = [b for b in bins if b[key].total]
        if not held:
            continue
        x = shift * np.array([np.sqrt(b["low"] * b["high"]) for b in held])
        y = np.array([b[key].share for b in held])
        below, above = ([b[key].low for b in held], [b[key].high for b in held])
        axes.errorbar(x, y, [np.maximum(y - below, 0), np.maximum(above - y, 0)], color=colour, marker=marker, ms=5,
                      lw=1.4, elinewidth=1.0, capsize=2)
    for b in bins:
        if b["seen"].total:
            axes.annotate(f"{b['seen'].total}", (np.sqrt(b["low"] * b["high"]), 1.0), xytext=(0, 6),
                          textcoords="offset points", ha="center", color=GREY, fontsize=8)
    axes.set_xlim(edges[0] * 0.95, edges[-1] * 1.05)
    axes.xaxis.set_major_locator(FixedLocator(edges))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.set_xticklabels([f"{edge:g}" for edge in edges])
    axes.set_ylim(-0.03, 1.12)
    axes.set_yticks(np.linspace(0.0, 1.0, 6))
    axes.yaxis.set_major_formatter(PercentFormatter(1.0, symbol=" %"))
    label = "strength: rms over noise that the refitted reference model leaves"
    axes.set_xlabel(wrap_text(label, 3.2) if narrow else label)
    axes.set_ylabel("share of single effects")
    handles = [Line2D([], [], color=colour, marker=marker, ms=5, lw=1.4) for _, _, colour, marker in CURVES]
    head_figure(figure, handles, [label for _, label, _, _ in CURVES])
    return figure
