"""Parameters with their intervals, and which of them the data cannot tell apart."""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Protocol

from ..inference.findings import Fitted
from ..measurement.quantities import clean, format_value, typeset
from ..selection.result import Estimate
from .style import AFTER, BEFORE, FAINT, GREY, INK, NARROW, OTHER, WIDTH, dress, head_figure, new_figure, styled


_Estimate = Estimate | Fitted


class _Fitted(Protocol):
    """A step, a fit: parameters, and pairs of names with their correlation."""

    @property
    def parameters(self) -> Mapping[str, _Estimate]: ...
    @property
    def correlations(self) -> Sequence[tuple[str, str, float]]: ...


FEWEST = 4  # bars that there is room for at least, so that one alone is not as high as the figure


@styled
def draw_parameters(steps: Mapping[str, _Fitted], count: int = 8, narrow: bool = False):
    """A line a parameter with its 95 % interval, each on its own scale, and the strongest correlations beside them.

    Args:
        steps: one or two models by name, the reference model first; the last one's parameters are listed.
        count: how many correlations at most.
        narrow: draw for a telephone.

    Returns:
        A matplotlib figure.
    """
    final = list(steps.values())[-1]
    names = list(final.parameters)
    correlations = sorted(final.correlations, key=lambda item: -abs(item[2]))[:count]
    heights = (0.75 + (0.85 if narrow else 0.62) * len(names), 0.9 + 0.36 * max(len(correlations), FEWEST))
    figure = new_figure(sum(heights[: 1 + bool(correlations)]) if narrow else max(heights), NARROW if narrow else WIDTH)
    left, right = figure, None
    if correlations and narrow:
        left, right = figure.subfigures(2, 1, squeeze=False, height_ratios=heights).ravel()
    elif correlations:
        left, right = figure.subfigures(1, 2, squeeze=False, width_ratios=(1.55, 1)).ravel()
    panels = left.subplots(max(len(names), 1), 1, squeeze=False).ravel()
    shades = [AFTER] if len(steps) == 1 else [BEFORE, AFTER]
    handles = {}
    for axes, name in zip(panels, names, strict=False):
        dress(axes, grid="x")
        drawn, scale = [], _find_scale(steps.values(), name)
        for row, ((label, step), shade) in enumerate(zip(steps.items(), shades, strict=True)):
            estimate = step.parameters.get(name)
            if estimate is None or not math.isfinite(estimate.estimate):
                continue
            low, high = (edge / scale for edge in _interval(estimate))
            axes.plot([low, high], [row, row], color=shade, lw=3.2, solid_capstyle="butt", alpha=0.55)
            handles[clean(label, 40)] = axes.plot(estimate.estimate / scale, row, "o", color=shade, ms=6)[0]
            drawn += [low, high, estimate.estimate / scale]
        axes.set_ylim(len(steps) - 0.4, -0.6)
        axes.set_yticks([])
        axes.spines["left"].set_visible(False)
        pad = 0.12 * (max(drawn) - min(drawn)) if drawn and max(drawn) > min(drawn) else 1.0
        if drawn:
            axes.set_xlim(min(drawn) - pad, max(drawn) + pad)
        if scale != 1.0:
            axes.set_xlabel(typeset(f"× {scale:.0e}"), loc="right", fontsize=8.5, labelpad=0)
        if narrow:
            axes.set_title(_wrap(name, 40), fontsize=8.5)
            axes.set_title(_describe(final.parameters[name]), loc="right", fontsize=8.5)
        else:
            axes.set_ylabel(_wrap(name), rotation=0, ha="right", va="center", fontsize=9.5, labelpad=10)
            axes.text(1.02, 0.5, _describe(final.parameters[name]), transform=axes.transAxes, va="center", fontsize=9)
    if right is not None:
        axes = dress(right.add_subplot(), grid="x")
        for row, (_, _, value) in enumerate(correlations):
            shade = INK if abs(value) > 0.95 else GREY if abs(value) > 0.8 else OTHER
            axes.barh(row, value, height=0.55, color=shade)
            # On the other side of zero, where no name is.
            axes.text(-math.copysign(0.05, value), row, f"{value:+.2f}".replace("-", "−"), va="center",
                      ha="right" if value >= 0 else "left", fontsize=8.5)
        axes.axvline(0, color=GREY, lw=0.7)
        axes.set_xlim(-1.28, 1.28)
        axes.set_xticks([-1, 0, 1])
        axes.set_ylim(max(len(correlations), FEWEST) - 0.4, -0.6)
        axes.set_yticks(range(len(correlations)), [f"{_wrap(a, 26)}\n{_wrap(b, 26)}" for a, b, _ in correlations],
                        fontsize=8)
        axes.tick_params(axis="y", length=0)
        axes.spines["left"].set_visible(False)
        axes.set_title("strongest correlations")
        axes.set_facecolor("white")
        axes.grid(True, axis="x", color=FAINT)
    if handles:
        head_figure(figure, list(handles.values()), [f"{name}, 95 % interval" for name in handles])
    return figure


def _find_scale(steps: Iterable[_Fitted], name: str) -> float:
    """A power of ten by which a parameter is divided where its numbers would be too long for an axis."""
    edges = [abs(edge) for step in steps if name in step.parameters for edge in _interval(step.parameters[name])]
    largest = max((edge for edge in edges if math.isfinite(edge)), default=0.0)
    power = math.floor(math.log10(largest)) if largest > 0 else 0
    return 1.0 if -4 <= power < 5 else 10.0**power


def _interval(estimate: _Estimate) -> tuple[float, float]:
    """The 95 % interval; from the standard deviation where the quantiles are missing."""
    low, high = estimate.q025, estimate.q975
    if not (math.isfinite(low) and math.isfinite(high)):
        spread = 1.96 * estimate.sd if math.isfinite(estimate.sd) else 0.0
        return estimate.estimate - spread, estimate.estimate + spread
    return low, high


def _describe(estimate: _Estimate) -> str:
    """Value and standard deviation to the digits that count, with the unit."""
    unit = "" if estimate.unit in ("", "1") else f" {clean(estimate.unit, 14)}"
    value = format_value(estimate.estimate, estimate.sd)
    spread = f" ± {format_value(estimate.sd, estimate.sd)}" if math.isfinite(estimate.sd) else ""
    return typeset(f"{value}{spread}{unit}")


def _wrap(name: str, width: int = 22) -> str:
    """A parameter's name, cut after the effect where it is long."""
    name = clean(name, 60)
    if len(name) <= width or "." not in name:
        return name.replace("_", " ") if "." not in name else name
    effect, _, parameter = name.partition(".")
    return f"{effect}\n{parameter}" if width < 25 else f"{effect}.{parameter}"
