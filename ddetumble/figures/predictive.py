"""Records that a fitted model would make beside those measured, and conditions that it had not seen."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..families import DEFAULT_FAMILY, find_family
from ..measurement.quantities import clean, describe_conditions, describe_quantity, shorten_names, vary
from ..posterior.loo import Scores
from ..posterior.predictive_check import LEVEL, STATISTICS, Checks
from .style import (
    AFTER,
    BEFORE,
    FLOOR,
    GREY,
    INK,
    KIN,
    OTHER,
    PALE,
    WIDTH,
    dress,
    head_figure,
    name_ticks,
    new_figure,
    styled,
    wrap_text,
)


_MARKS = {"chi_square": ("o", AFTER), "largest": ("^", BEFORE), "lag": ("s", "#7a5195")}
_LEAST = 1e-7  # p-values below are drawn there


@styled
def draw_predictive(checks: Checks, family: str = DEFAULT_FAMILY, count: int = 4):
    """p-values of every record, and for a few of them what was measured beside what the model would make.

    Args:
        checks: of the posterior.
        family: of the records.
        count: of records whose replicates are drawn.

    Returns:
        A matplotlib figure.
    """
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    records = checks.records
    height = 1.75 * -(-min(count, len(records)) // 2)
    figure = new_figure(2.7 + height, WIDTH)
    above, below = figure.subfigures(2, 1, squeeze=False, height_ratios=(2.3, height + 0.4)).ravel()
    axes = dress(above.add_subplot())
    place = np.arange(len(records))
    for name, (mark, colour) in _MARKS.items():
        values = [max(one.p_values[name], _LEAST) for one in records]
        axes.scatter(place, values, s=20, marker=mark, color=colour, alpha=0.85, lw=0, zorder=3)
    limit = LEVEL / (2 * len(STATISTICS) * len(records))
    axes.axhspan(_LEAST / 3, limit, color=FLOOR, alpha=0.18, lw=0)
    axes.set_yscale("log")
    axes.set_ylim(_LEAST / 3, 1.6)
    axes.set_yticks([1, 1e-2, 1e-4, 1e-6, _LEAST], ["1", "0.01", "1e−4", "1e−6", "≤ 1e−7"])
    axes.minorticks_off()
    axes.set_xlim(-0.7, len(records) - 0.3)
    short = shorten_names((one.record for one in records), 14)
    name_ticks(axes, [short[str(one.record)] for one in records], WIDTH - 1.2, 8)
    axes.set_ylabel("p-value of a replicate")
    handles: list[Any] = [Line2D([], [], ls="none", marker=mark, ms=5, color=colour)
                          for mark, colour in _MARKS.values()]
    handles += [Patch(facecolor=FLOOR, alpha=0.35), Line2D([], [], color=INK, lw=1.0), Patch(facecolor=KIN, alpha=0.5)]
    labels = [*STATISTICS.values(), "stands out by itself", "measured", "90 % of replicates"]
    _draw_replicates(below, checks, family, count)
    head_figure(figure, handles, labels)
    return figure


def _draw_replicates(figure, checks: Checks, family: str, count: int) -> None:
    """Measured minus the mean of the replicates, over the range of the replicates, for the strangest records."""
    own = checks.replicates
    order = np.argsort([min(one.p_values.values()) for one in checks.records])
    # The strangest ones, and some that are not.
    wanted = [*order[: -(-count // 2)], *order[-(count // 2):]] if len(order) > count else order
    chosen = sorted(int(g) for g in wanted)
    names = vary(one.conditions for one in checks.records)
    short = shorten_names((one.record for one in checks.records), 20)
    panels = figure.subplots(-(-len(chosen) // 2), 2 if len(chosen) > 1 else 1, squeeze=False).ravel()
    channel = own.channels[0]
    for axes in panels[len(chosen):]:
        axes.set_axis_off()
    for k, (axes, g) in enumerate(zip(panels, chosen, strict=False)):
        dress(axes)
        measured, values = own.measured[g, 0], own.values[:, g, 0]
        good = np.isfinite(measured)
        measured, values = measured[good], values[:, good]
        along = describe_quantity(find_family(family).independent, own.time[g])
        x = own.time[g][good] * along.scale
        shown = describe_quantity(channel, unit="")
        middle = values.mean(axis=0)
        band = np.quantile(values - middle, [0.05, 0.95], axis=0) * shown.scale
        axes.fill_between(x, _run_mean(band[0]), _run_mean(band[1]), color=KIN, alpha=0.5, lw=0)
        axes.plot(x, (measured - middle) * shown.scale, color=INK, lw=0.7)
        axes.axhline(0, color=PALE, lw=0.8, zorder=1)
        title = f"{short[str(checks.records[g].record)]}   {describe_conditions(checks.records[g].conditions, names)}"
        axes.set_title(wrap_text(title, WIDTH / 2 - 0.8, 9), fontsize=9)
        axes.margins(x=0)
        if k % 2 == 0:
            axes.set_ylabel(f"measured − model\n[{shown.unit or '–'}]", fontsize=8.5)
        if k >= len(chosen) - 2:
            axes.set_xlabel(along.label)


def _run_mean(values: np.ndarray, width: int = 5) -> np.ndarray:
    """A running mean: quantiles of a few replicates are rough."""
    if len(values) < 3 * width:
        return values
    padded = np.pad(values, width // 2, mode="edge")
    return np.convolve(padded, np.ones(width) / width, mode="valid")


@styled
def draw_left_out(scores: Sequence[Scores], names: Sequence[str] = ()):
    """Mean logarithm of the predictive density of the records of every condition, left out; of one or more models.

    Args:
        scores: of the models, the best first.
        names: of the models.

    Returns:
        A matplotlib figure.
    """
    from matplotlib.lines import Line2D

    first = scores[0]
    varying = vary(one.conditions for one in first.scores)
    labels = [describe_conditions(one.conditions, varying) or clean(", ".join(one.records), 20)
              for one in first.scores]
    shades = [AFTER, BEFORE, "#009e73", "#cc79a7", "#7a5195", OTHER]
    figure = new_figure(0.9 + 0.235 * len(labels), WIDTH)
    axes = dress(figure.add_subplot(), grid="x")
    place = np.arange(len(labels))
    for k, one in enumerate(scores[: len(shades)]):
        value = one.values if len(scores) == 1 else one.values - first.values
        if k == 0 and len(scores) > 1:
            axes.axvline(0, color=shades[0], lw=1.4)
            continue
        shape = np.array([s.trusted for s in one.scores])
        axes.scatter(value[shape], place[shape], s=34, color=shades[k], zorder=3)
        axes.scatter(value[~shape], place[~shape], s=34, facecolor="white", edgecolor=shades[k], zorder=3)
    axes.set_yticks(place, labels, fontsize=8.5 if len(labels) <= 24 else 7)
    axes.set_ylim(len(labels) - 0.4, -0.6)
    axes.tick_params(axis="y", length=0)
    axes.spines["left"].set_visible(False)
    axes.set_xlabel("logarithm of the predictive density" if len(scores) == 1 else
                    "logarithm of the predictive density, minus that of the first model")
    handles: list[Any] = [Line2D([], [], ls="none", marker="o", ms=6, color=shade) for shade in shades[: len(scores)]]
    words = [clean(name, 40) for name in names][: len(handles)] or ["left-out condition"]
    if any(not s.trusted for one in scores for s in one.scores):
        handles.append(Line2D([], [], ls="none", marker="o", ms=6, mfc="white", mec=GREY))
        words.append("weights not to be trusted")
    head_figure(figure, handles, words)
    return figure
