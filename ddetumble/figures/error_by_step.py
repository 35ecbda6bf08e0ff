"""The error falling step by step, down to the noise floor."""

import math
from collections.abc import Sequence

from ..measurement.quantities import format_error, format_number, say_p
from ..selection.compare import Comparison
from ..selection.result import Step
from .style import (
    AFTER,
    BEFORE,
    FLOOR,
    GREY,
    INK,
    NARROW,
    PALE,
    WIDTH,
    dress,
    head_figure,
    new_figure,
    styled,
    wrap_text,
)


@styled
def draw_error_by_step(names: Sequence[str], steps: Sequence[Step | Comparison], floor: float, narrow: bool = False):
    """One row a model of the loop: its error, fitted and cross-validated, with the noise floor drawn in.

    Args:
        names: of the models, in the order in which they were tried.
        steps: of a discovery, or comparisons of models with one campaign.
        floor: rms of the noise over that of the signal.
        narrow: draw for a telephone, names and numbers above and below each row.

    Returns:
        A matplotlib figure.
    """
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    figure = new_figure(1.5 + 1.1 * len(steps), NARROW) if narrow else new_figure(1.15 + 0.62 * len(steps), WIDTH)
    axes = dress(figure.add_subplot(), grid="x")
    errors = [100 * error for step in steps for error in (step.nrmse, step.heldout_nrmse) if math.isfinite(error)]
    noise = 100 * floor if math.isfinite(floor) else 0.0
    top = max([*errors, noise, 1e-6])
    logarithmic = noise > 0 and top > 15 * noise
    left = noise / 3 if logarithmic else 0.0
    if logarithmic:
        from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

        axes.set_xscale("log")
        axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.xaxis.set_minor_locator(NullLocator())
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    beside = top * (top / left) ** 0.05 if logarithmic else 1.05 * top
    room = 0.06 if narrow else 0.6  # for words at the right, as a share of the axes
    axes.set_xlim(left, top * (top / left) ** room if logarithmic else (1 + room * 5 / 6) * top)
    if noise > 0:
        axes.axvspan(left, noise, color=FLOOR, alpha=0.18, lw=0)
        axes.axvline(noise, color=FLOOR, lw=1.2)
    for row, step in enumerate(steps):
        colour = BEFORE if row == 0 and len(steps) > 1 else AFTER
        fitted, held = 100 * step.nrmse, 100 * step.heldout_nrmse
        previous = 100 * steps[row - 1].nrmse if row else math.nan
        if math.isfinite(previous) and math.isfinite(fitted):
            axes.plot([previous, previous], [row - 1, row], color=PALE, lw=1.2, ls=(0, (2, 2)), zorder=1)
            axes.annotate("", (fitted, row), (previous, row), zorder=2,
                          arrowprops={"arrowstyle": "-|>", "color": FLOOR, "lw": 1.3, "shrinkA": 0, "shrinkB": 7})
        axes.scatter(fitted, row, s=70, color=colour, zorder=4)
        axes.scatter(held, row, s=140, facecolor="none", edgecolor=colour, lw=1.6, zorder=3)
        if narrow:
            continue
        text = f", cross-val. {format_error(step.heldout_nrmse)}" if math.isfinite(held) else ""
        axes.annotate(format_error(step.nrmse) + text, (beside, row),
                      xytext=(0, 2), textcoords="offset points", va="bottom", color=INK, fontsize=9.5)
        axes.annotate(_describe_fit(step), (beside, row), xytext=(0, -2), textcoords="offset points", va="top",
                      color=GREY, fontsize=8.5)
    if narrow:
        for row, (name, step) in enumerate(zip(names, steps, strict=True)):
            held = f", cross-validated {format_error(step.heldout_nrmse)}" if math.isfinite(step.heldout_nrmse) else ""
            below = f"{format_error(step.nrmse)}{held}\n{_describe_fit(step)}"
            for text, side in ((wrap_text(name, NARROW - 0.4, 10), "bottom"), (below, "top")):
                axes.annotate(text, (0, row), xycoords=("axes fraction", "data"),
                              xytext=(4, 11 if side == "bottom" else -11), textcoords="offset points", va=side,
                              color=INK if side == "bottom" else GREY, fontsize=10 if side == "bottom" else 8.5,
                              zorder=5, bbox={"facecolor": "white", "alpha": 0.75, "lw": 0, "pad": 1.0})
        names = [""] * len(steps)
    else:
        names = [wrap_text(name, 3.0, 10) for name in names]
    axes.set_yticks(range(len(steps)), names)
    axes.set_ylim(len(steps) - 0.45, -0.55)
    axes.tick_params(axis="y", length=0, labelsize=10)
    axes.spines["left"].set_visible(False)
    axes.set_xlabel("rms residual in per cent of the signal's rms")
    axes.set_xticks([tick for tick in axes.get_xticks() if left <= tick <= 1.05 * top])
    handles: list = [
        Line2D([], [], ls="none", marker="o", ms=8, color=GREY),
        Line2D([], [], ls="none", marker="o", ms=11, mfc="none", mec=GREY, mew=1.5),
    ]
    labels = ["fitted", "cross-validated"]
    if noise > 0:
        handles.append(Patch(facecolor=FLOOR, alpha=0.35, edgecolor=FLOOR))
        labels.append(f"noise floor {format_error(floor)}")
    head_figure(figure, handles, labels)
    return figure


def _describe_fit(step: Step | Comparison) -> str:
    """Chi-square of a step and what its lack of fit says."""
    fit = step.lack_of_fit
    verdict = "misfit left" if fit.rejected else "no misfit left"
    state = "" if step.converged else ", not converged"
    return f"χ²/dof {format_number(step.chi2_reduced)}, {verdict} ({say_p(fit.p_value)}){state}"
