"""Figures of a judgement on peaks: models beside measurements, errors with a record left out, what cannot be told."""

from collections.abc import Mapping, Sequence

import numpy as np

from ..figures.style import AFTER, BEFORE, FLOOR, GREY, INK, KIN, OTHER, dress, new_figure, styled
from .friction import FrictionJudgement
from .judgement import PeakJudgement
from .rows import PairedDifference, PeakRow


@styled
def draw_growth(judged: PeakJudgement):
    """Peaks against pressure on logarithmic scales, with growth as P0^(1/3), as P0 and as fitted."""
    figure = new_figure(3.6)
    left, right = figure.subplots(1, 2)
    x, y = judged.pressures / 1e6, judged.peaks
    exponent, error = judged.exponent
    middle = np.exp(np.mean(np.log(x))), np.exp(np.mean(np.log(y)))
    fine = np.geomspace(0.9 * x.min(), 1.1 * x.max(), 50)
    for power, label, colour, line in ((1 / 3, "P0 to the 1/3: a mass on F ~ P0 δ²", AFTER, "--"),
                                       (1.0, "P0 to the 1: a press at fixed stroke", GREY, ":"),
                                       (exponent, f"P0 to the {exponent:.2f} ± {error:.2f}: fitted", BEFORE, "-")):
        left.plot(fine, middle[1] * (fine / middle[0]) ** power, line, color=colour, lw=1.5, label=label)
    left.plot(x, y, "o", color=INK, ms=6, label="measured", zorder=4)
    left.set_xscale("log")
    left.set_yscale("log")
    for axis in (left.xaxis, left.yaxis):
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter("")
    left.set_xticks([1.0, 1.5, 2.0, 2.5])
    left.set_yticks([40, 50, 60, 70, 80])
    left.set_ylim(40, 85)
    left.set_xlabel("pressure [MPa]")
    left.set_ylabel("peak normal force [N]")
    left.legend(loc="upper left")
    for row, colour, mark in ((judged.reference, AFTER, "s"), (judged.polynomial, OTHER, "D")):
        right.plot(x, 100 * (row.fitted / y - 1), f"-{mark}", color=colour, lw=1.2, label=row.label)
    right.axhspan(-3.5, 3.5, color=FLOOR, alpha=0.15, lw=0)
    right.axhline(0, color=FLOOR, lw=0.8)
    right.set_ylim(-6, 6)
    dress(left, "")
    dress(right)
    right.set_xlabel("pressure [MPa]")
    right.set_ylabel("deviation from the measured peak [%]")
    right.legend(loc="upper right")
    right.annotate("± 3.5 %", (x.min(), -3.5), (0, 3), textcoords="offset points", color=GREY, fontsize=8.5)
    return figure


@styled
def draw_models(judged: PeakJudgement):
    """Measured peaks with the models side by side, and their errors with each record left out."""
    figure = new_figure(5.0)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(1.7, 1))
    x, y = judged.pressures / 1e6, judged.peaks
    printed = [row for row in judged.rows if row.kind == "printed"]
    shown = [(judged.reference, AFTER, "-s"), *((row, GREY, "--^") for row in printed)]
    shown += [(judged.polynomial, OTHER, "-D")]
    shown += [(row, BEFORE, "-v") for row in judged.steps[-1:] if row.effects]
    for row, colour, style in shown:
        upper.plot(x, row.fitted, style, color=colour, lw=1.4, ms=4, label=row.label)
        lower.plot(x, 100 * (row.held / y - 1), style, color=colour, lw=1.0, ms=4)
    upper.plot(x, y, "o", color=INK, ms=6, label="measured", zorder=4)
    zero = judged.pressures == 0
    if zero.any():
        upper.annotate("no gas, no force:\nour model gives 0 N here", (0, 0), (0.22, 5), textcoords="data", va="bottom",
                       color=AFTER, arrowprops=dict(arrowstyle="-|>", color=AFTER))
        lower.annotate("−100 %, off the scale", (0, -15), (-4, 4), textcoords="offset points", color=AFTER,
                       fontsize=8.5)
    share = 200 * float(np.mean(judged.noise.share))
    lower.axhspan(-share, share, color=FLOOR, alpha=0.18, lw=0)
    lower.axhline(0, color=FLOOR, lw=0.8)
    lower.set_ylim(-15, 15)
    dress(upper)
    dress(lower, "")
    upper.set_ylabel("peak normal force [N]")
    lower.set_ylabel("left out, deviation [%]")
    lower.set_xlabel("pressure [MPa]")
    upper.legend(loc="lower right")
    return figure


@styled
def draw_ladder(judged: PeakJudgement | FrictionJudgement, most: int = 26):
    """Left-out errors of all models, best first, with the polynomial's as the line to reach."""
    rows = sorted((row for row in judged.rows if np.isfinite(row.heldout)), key=lambda row: row.heldout)
    rows = [row for k, row in enumerate(rows) if k < most or row is judged.reference][::-1]
    line = 100 * judged.polynomial.heldout
    figure = new_figure(0.9 + 0.24 * len(rows))
    axes = dress(figure.subplots(), "x")
    colours = {"printed": GREY, "polynomial": OTHER, "reference": AFTER, "reading": KIN, "choice": INK,
               "constant": INK}
    for i, row in enumerate(rows):
        colour = colours.get(row.kind, BEFORE)
        axes.barh(i, 100 * min(row.heldout, 1.0), color=colour if row.physical else "white", edgecolor=colour,
                  height=0.7, hatch="" if row.physical else "////")
        note = f"{100 * row.heldout:.1f} %, {row.free} fitted" + ("" if row.physical else ", " + row.remark)
        axes.annotate(note, (max(100 * min(row.heldout, 1.0), line), i), (4, 0), fontsize=8.5,
                      textcoords="offset points", va="center")
    axes.axvline(line, color=INK, lw=0.9, ls="--")
    axes.set_ylim(-0.6, len(rows) - 0.4)
    axes.set_yticks(range(len(rows)), [row.label for row in rows], fontsize=8.5)
    axes.set_xscale("log")
    axes.set_xlim(0.8, 300)
    axes.set_xticks([1, 2, 5, 10, 20, 50, 100])
    axes.xaxis.set_major_formatter("{x:g}")
    axes.minorticks_off()
    axes.set_xlabel("rms error of what was left out [%]; dashed: the low polynomial")
    return figure


@styled
def draw_differences(pairs: Sequence[PairedDifference], title: str):
    """Paired differences of left-out errors with two standard errors: what crosses zero cannot be told apart."""
    figure = new_figure(0.8 + 0.26 * len(pairs))
    axes = dress(figure.subplots(), "x")
    for i, pair in enumerate(pairs[::-1]):
        told = abs(pair.difference) > 2 * pair.standard_error
        axes.errorbar(100 * pair.difference, i, xerr=200 * pair.standard_error, fmt="o", capsize=3,
                      color=BEFORE if told else GREY)
    axes.axvline(0, color=INK, lw=0.8)
    axes.set_yticks(range(len(pairs)), [f"{p.first}  against  {p.second}" for p in pairs[::-1]], fontsize=8)
    limit = max(min(max(abs(100 * p.difference) + 200 * p.standard_error for p in pairs) * 1.1, 12.0), 1e-3)
    axes.set_xlim(-limit, limit)
    for i, pair in enumerate(pairs[::-1]):
        if abs(100 * pair.difference) > limit:  # its point cannot be seen
            low = pair.difference < 0
            told = f"{100 * abs(pair.difference):.1f} ± {100 * pair.standard_error:.1f}"
            axes.annotate(f"← −{told}" if low else f"{told} →", (0.0 if low else 1.0, i), (2 if low else -2, 4),
                          xycoords=("axes fraction", "data"), textcoords="offset points", fontsize=8,
                          ha="left" if low else "right", va="bottom")
    axes.set_xlabel(title)
    return figure


@styled
def draw_corrections(pressures: np.ndarray, printed: np.ndarray, peaks: np.ndarray, ratios: Mapping[str, np.ndarray],
                     rows: Sequence[PeakRow], factor: float):
    """What each single change does to the printed theory, against measured over printed.

    Args:
        pressures: shape (records,) [Pa].
        printed, peaks: shape (records,) [N].
        ratios: fitted ratio of each change by label, shape (records,).
        rows: of the changes.
        factor: the one factor that fits best.
    """
    figure = new_figure(3.4)
    axes = dress(figure.subplots())
    axes.plot(pressures / 1e6, peaks / printed, "o", color=INK, ms=6, label="measured / printed theory", zorder=4)
    axes.axhline(factor, color=GREY, lw=1.2, ls=":", label=f"one factor, {factor:.3f}")
    for row, colour, line in zip(rows, (OTHER, BEFORE, AFTER, KIN, INK), ("-", "-", "--", "-.", ":"), strict=True):
        axes.plot(pressures / 1e6, ratios[row.label], line, color=colour, lw=1.8,
                  label=f"{row.label}: left out {100 * row.heldout:.2f} %")
    axes.set_ylim(0.905, 1.015)
    axes.set_xlabel("pressure [MPa]")
    axes.set_ylabel("ratio to the printed theory")
    axes.legend(loc="upper right", ncols=2, fontsize=8.5)
    return figure
