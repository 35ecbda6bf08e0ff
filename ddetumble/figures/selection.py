"""A discovery's loop: the error falling step by step, the catalogue ranked, and parameters with their intervals."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.ticker import LogLocator

from ..inference.findings import Fitted
from ..measurement import quantities as q
from ..selection.compare import Comparison, Comparisons
from ..selection.discovery import Discovery
from ..selection.result import Candidate, Estimate, Step
from ..selection.series import relies_on_settings
from ..selection.settings import DEFAULT
from .palette import AFTER, BEFORE, FAINT, FLOOR, GREY, INK, KIN, OTHER, PALE
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


CHANCE = 0.05  # p-value from which what an effect removes may be chance: the usual 5 %
FEWEST = 4  # bars that there is room for at least, so that one alone is not as high as the figure
# Looks of bars of the ranking, in the order of their legend.
KINDS = {
    "added": {"facecolor": AFTER, "edgecolor": "none"},
    "indistinguishable from it": {"facecolor": KIN, "edgecolor": "white", "hatch": "///"},
    "not added": {"facecolor": OTHER, "edgecolor": "none"},
    "undetectable by this campaign": {"facecolor": FAINT, "edgecolor": PALE},
}
ADDED, ALIKE, IDLE, UNSEEN = KINDS


@styled
def draw_error_by_step(steps: Comparisons | Discovery | Sequence[Step | Comparison], names: Sequence[str] = (),
                       floor: float = math.nan, narrow: bool = False):
    """One row a model of the loop: its error, fitted and cross-validated, with the noise floor drawn in; where settings
    that were moved did a model's work, the error of its predictions from settings as written down, too.

    Args:
        steps: what `discover`, or `compare` of several models, returned; or steps or comparisons, in the order in which
            they were tried.
        names: of the models; those of the result, or the effects of each, where not given.
        floor: rms of the noise over that of the signal; the smallest that the result has, or none, where not given.
    """
    if isinstance(steps, Discovery):
        names, floor = names or q.name_steps(steps), steps.noise_nrmse if math.isnan(floor) else floor
        steps = steps.steps
    elif isinstance(steps, Comparisons):
        names = names or steps.names
        floor = min(one.noise_nrmse for one in steps) if math.isnan(floor) else floor
        steps = steps.models
    names = names or [" + ".join(step.effects) or "reference" for step in steps]
    figure = new_figure(1.5 + 1.1 * len(steps), NARROW) if narrow else new_figure(1.15 + 0.62 * len(steps), WIDTH)
    labels = [""] * len(steps) if narrow else [wrap_text(name, 3.0, 10) for name in names]
    axes = dress_rows(figure.add_subplot(), labels, 0.45, fontsize=10)
    moved = relies_on_settings(steps)
    errors = [100 * error for step in steps for error in (
        step.nrmse, step.heldout_nrmse, *((step.prediction_nrmse,) if moved else ())) if math.isfinite(error)]
    noise = 100 * floor if math.isfinite(floor) else 0.0
    top = max([*errors, noise, 1e-6])
    room = 0.06 if narrow else 0.6  # for words at the right, as a share of the axes
    if noise > 0 and top > 15 * noise:
        left, right, beside = noise / 3, top * (3 * top / noise) ** room, top * (3 * top / noise) ** 0.05
        axes.set_xscale("log")
        axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.xaxis.set_major_formatter("{x:g}")
        axes.minorticks_off()
    else:
        left, right, beside = 0.0, (1 + room * 5 / 6) * top, 1.05 * top
    axes.set(xlim=(left, right), xlabel="RMS residual in per cent of the RMS of the signal")
    if noise > 0:
        axes.axvspan(left, noise, color=FLOOR, alpha=0.18, lw=0)
        axes.axvline(noise, color=FLOOR, lw=1.2)
    for row, (name, step) in enumerate(zip(names, steps, strict=True)):
        colour = BEFORE if row == 0 and len(steps) > 1 else AFTER
        fitted, held = 100 * step.nrmse, 100 * step.heldout_nrmse
        falls = 100 * (step.prediction_nrmse if moved else step.nrmse)
        previous = 100 * (steps[row - 1].prediction_nrmse if moved else steps[row - 1].nrmse) if row else math.nan
        if math.isfinite(previous) and math.isfinite(falls):
            axes.plot([previous, previous], [row - 1, row], color=PALE, lw=1.2, ls=(0, (2, 2)), zorder=1)
            axes.annotate("", (falls, row), (previous, row), zorder=2,
                          arrowprops={"arrowstyle": "-|>", "color": FLOOR, "lw": 1.3, "shrinkA": 0, "shrinkB": 7})
        axes.scatter(fitted, row, s=70, color=colour, zorder=4)
        axes.scatter(held, row, s=140, facecolor="none", edgecolor=colour, lw=1.6, zorder=3)
        if moved:
            axes.scatter(100 * step.prediction_nrmse, row, s=70, marker="D", facecolor="white", edgecolor=colour,
                         lw=1.6, zorder=5)
        told = q.format_error(step.nrmse)
        if math.isfinite(held):
            told += f", {'cross-validated' if narrow else 'cross-val.'} {q.format_error(step.heldout_nrmse)}"
        if moved:
            told += f", {'' if narrow else 'settings '}as written {q.format_error(step.prediction_nrmse)}"
        if narrow:
            above, below, size = wrap_text(name, NARROW - 0.4, 10), f"{told}\n{_describe_fit(step)}", 10
            look = {"xy": (0, row), "xycoords": ("axes fraction", "data"), "zorder": 5,
                    "bbox": {"facecolor": "white", "alpha": 0.75, "lw": 0, "pad": 1.0}}
        else:
            above, below, size, look = told, _describe_fit(step), 9.5, {"xy": (beside, row)}
        gap = (4, 11) if narrow else (0, 2)
        axes.annotate(above, xytext=gap, textcoords="offset points", va="bottom", color=INK, fontsize=size, **look)
        axes.annotate(below, xytext=(gap[0], -gap[1]), textcoords="offset points", va="top", color=GREY, fontsize=8.5,
                      **look)
    axes.set_xticks([tick for tick in axes.get_xticks() if left <= tick <= 1.05 * top])
    handles, labels = [key_dot(GREY, 8), key_dot(GREY, 11, mfc="none", mew=1.5)], ["fitted", "cross-validated"]
    if moved:
        handles.append(key_dot(GREY, 8, "D", mfc="white", mew=1.5))
        labels.append("predicted, settings as written")
    if noise > 0:
        handles.append(key_band(edgecolor=FLOOR, lw=None))
        labels.append(f"noise floor {q.format_error(floor)}")
    head_figure(figure, handles, labels)
    return figure


def _describe_fit(step: Step | Comparison) -> str:
    """Chi-square of a step and what its lack of fit says."""
    verdict = "misfit left" if step.lack_of_fit.rejected else "no misfit left"
    state = "" if step.converged else ", not converged"
    return f"χ²/dof {q.format_number(step.chi2_reduced)}, {verdict} ({q.say_p(step.lack_of_fit.p_value)}){state}"


@styled
def draw_ranking(candidates: Sequence[Candidate], chosen: Sequence[str] = (), confused: Sequence[str] | None = None,
                 invisible: float = DEFAULT.invisible, narrow: bool = False):
    """One bar an effect: the share of the misfit above noise that it removes; a diamond for what can be seen of it.

    Args:
        candidates: as they stood at the first step, best first.
        chosen: effects that were added, in their order.
        confused: effects that this campaign cannot tell from the first chosen one; its own list where not given.
        invisible: visible share of a signature below which an effect cannot be seen, of the settings of the discovery.
    """
    if confused is None:
        confused = [name for one in candidates if one.effect in chosen[:1] for name in one.indistinguishable_from]
    figure = new_figure((2.0 if narrow else 1.0) + 0.27 * max(len(candidates), 1), NARROW if narrow else WIDTH)
    axes = dress_rows(figure.add_subplot(), [q.shorten(one.effect, 22 if narrow else 36) for one in candidates])
    used = []
    for row, (candidate, name) in enumerate(zip(candidates, axes.get_yticklabels(), strict=True)):
        # What removes a misfit beyond chance is seen, however little of its signature at the null survives.
        unseen = (math.isfinite(candidate.visible) and candidate.visible < invisible and candidate.p_value > CHANCE)
        kind = ADDED if candidate.effect in chosen else ALIKE if candidate.effect in confused else (
            UNSEEN if unseen else IDLE)
        used.append(kind)
        share = 100 * min(max(candidate.explains, 0.0), 1.0) if math.isfinite(candidate.explains) else 0.0
        axes.barh(row, share, height=0.66, lw=0.8, **KINDS[kind])
        if math.isfinite(candidate.visible):
            axes.plot(100 * candidate.visible, row, marker="D", ms=5.5, mfc="white", mec=GREY if unseen else INK,
                      mew=1.2, zorder=4, clip_on=False)
        text = "undetectable" if unseen else q.say_p(candidate.p_value)
        axes.text(110 if narrow else 103, row, text, va="center", fontsize=8.5,
                  color=GREY if unseen or candidate.p_value > CHANCE else INK)
        name.set(color=GREY if kind == UNSEEN else INK, fontweight="bold" if kind == ADDED else "normal")
    label = "share of the misfit above noise that it explains (bars) [%]"
    axes.set(xlim=(-4 if narrow else -1.5, 175 if narrow else 118),  # a diamond at 0 stays clear of the names
             xticks=range(0, 101, 50 if narrow else 20), xlabel=wrap_text(label, 2.3) if narrow else label)
    axes.spines["bottom"].set_bounds(0, 100)
    axes.axvline(0, color=GREY, lw=0.7, zorder=1)
    kinds = [kind for kind in KINDS if kind in used]
    head_figure(figure, [*(key_band(None, None, **{"lw": None} | KINDS[kind]) for kind in kinds),
                         key_dot(INK, 5.5, "D", mfc="white", mew=1.2)],
                [*kinds, "visible share of its own signature [%]"])
    return figure


@styled
def draw_parameters(steps: Mapping[str, Any], count: int = 8, narrow: bool = False):
    """A line a parameter with its 95 % interval, each on its own scale, and the strongest correlations beside them.

    Args:
        steps: one or two fits or steps by name, the reference model first; the last one's parameters are listed.
        count: how many correlations at most.
    """
    final = list(steps.values())[-1]
    pairs = final.correlations
    if isinstance(pairs, np.ndarray):  # of a fit: the matrix
        names = list(final.parameters)
        pairs = [(a, b, float(pairs[i, i + 1 + j])) for i, a in enumerate(names) for j, b in enumerate(names[i + 1:])]
    correlations = sorted(pairs, key=lambda item: -abs(item[2]))[:count]
    heights = (0.75 + (0.85 if narrow else 0.62) * len(final.parameters), 0.9 + 0.36 * max(len(correlations), FEWEST))
    figure = new_figure(sum(heights[: 1 + bool(correlations)]) if narrow else max(heights), NARROW if narrow else WIDTH)
    left = figure
    if correlations:
        left, right = (figure.subfigures(2, 1, height_ratios=heights) if narrow else
                       figure.subfigures(1, 2, width_ratios=(1.55, 1)))
        _draw_correlations(right.add_subplot(), correlations)
    panels = left.subplots(max(len(final.parameters), 1), 1, squeeze=False).ravel()
    shades = [AFTER] if len(steps) == 1 else [BEFORE, AFTER]
    handles = {}
    for axes, (name, own) in zip(panels, final.parameters.items(), strict=False):
        dress_rows(axes, [""] * len(steps)).set_yticks([])
        # A power of ten by which a parameter is divided where its numbers would be too long for an axis.
        edges = [abs(edge) for step in steps.values() if name in step.parameters
                 for edge in _interval(step.parameters[name])]
        largest = max((edge for edge in edges if math.isfinite(edge)), default=0.0)
        power = math.floor(math.log10(largest)) if largest > 0 else 0
        drawn, scale = [], 1.0 if -4 <= power < 5 else 10.0**power
        for row, ((label, step), shade) in enumerate(zip(steps.items(), shades, strict=True)):
            estimate = step.parameters.get(name)
            if estimate is None or not math.isfinite(estimate.estimate):
                continue
            low, high = (edge / scale for edge in _interval(estimate))
            axes.plot([low, high], [row, row], color=shade, lw=3.2, solid_capstyle="butt", alpha=0.55)
            handles[q.clean(label, 40)] = axes.plot(estimate.estimate / scale, row, "o", color=shade, ms=6)[0]
            drawn += [low, high, estimate.estimate / scale]
        if drawn:
            pad = 0.12 * (max(drawn) - min(drawn)) or 1.0
            axes.set_xlim(min(drawn) - pad, max(drawn) + pad)
            axes.xaxis.set_major_locator(SpacedLocator())
        if scale != 1.0:
            axes.set_xlabel(q.typeset(f"× {scale:.0e}"), loc="right", fontsize=8.5, labelpad=0)
        if narrow:
            axes.set_title(_wrap(name, 40), fontsize=8.5)
            axes.set_title(_describe(own), loc="right", fontsize=8.5)
        else:
            axes.set_ylabel(_wrap(name), rotation=0, ha="right", va="center", fontsize=9.5, labelpad=10)
            axes.text(1.02, 0.5, _describe(own), transform=axes.transAxes, va="center", fontsize=9)
    if handles:
        head_figure(figure, list(handles.values()), [f"{name}, 95 % interval" for name in handles])
    return figure


def _draw_correlations(axes, correlations: Sequence[tuple[str, str, float]]):
    dress_rows(axes, [f"{_wrap(a, 26)}\n{_wrap(b, 26)}" for a, b, _ in correlations], fontsize=8)
    for row, (_, _, value) in enumerate(correlations):
        shade = INK if abs(value) > 0.95 else GREY if abs(value) > 0.8 else OTHER
        axes.barh(row, value, height=0.55, color=shade)
        axes.text(value + math.copysign(0.06, value), row, f"{value:+.2f}".replace("-", "−"), va="center",
                  ha="left" if value >= 0 else "right", fontsize=8.5)
    axes.axvline(0, color=GREY, lw=0.7)
    axes.set(xlim=(-1.8, 1.8), xticks=[-1, 0, 1], ylim=(max(len(correlations), FEWEST) - 0.4, -0.6),
             title="strongest correlations")
    axes.spines["bottom"].set_bounds(-1, 1)


def _interval(estimate: Estimate | Fitted) -> tuple[float, float]:
    """The 95 % interval; from the standard deviation where the quantiles are missing."""
    if not estimate.determined:
        return estimate.estimate, estimate.estimate
    low, high = estimate.q025, estimate.q975
    if math.isfinite(low) and math.isfinite(high):
        return low, high
    spread = 1.96 * estimate.sd if math.isfinite(estimate.sd) else 0.0
    return estimate.estimate - spread, estimate.estimate + spread


def _describe(estimate: Estimate | Fitted) -> str:
    """Value and standard deviation to the digits that count, with the unit."""
    if not estimate.determined:
        return "not determined"
    unit = "" if estimate.unit in ("", "1") else f" {q.clean(estimate.unit, 14)}"
    spread = f" ± {q.format_value(estimate.sd, estimate.sd)}" if math.isfinite(estimate.sd) else ""
    return q.typeset(f"{q.format_value(estimate.estimate, estimate.sd)}{spread}{unit}")


def _wrap(name: str, width: int = 22) -> str:
    """A parameter's name, cut after the effect where it is long."""
    name = q.clean(name, 60)
    if "." not in name:
        return name.replace("_", " ")
    if len(name) <= width:
        return name
    effect, _, parameter = name.partition(".")
    return f"{effect}\n{parameter}" if width < 25 else f"{effect}.{parameter}"
