"""The report of a campaign that holds peaks only, and the figures of a judgement on peaks."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from ..figures.palette import AFTER, BEFORE, FLOOR, GREY, INK, KIN, OTHER
from ..figures.style import NARROW, WIDTH, dress, head_figure, new_figure, point_at, styled, wrap_text
from .forces import AbstractJudgement, PairedDifference, PeakRow
from .friction import FrictionJudgement
from .judgement import PeakJudgement
from .section import write_section


@styled
def draw_growth(judged: PeakJudgement, growth: tuple[float, float]):
    """Peaks against pressure on logarithmic scales, with growth as P0^(1/3), as P0 and with the fitted exponent."""
    exponent, error = growth
    figure = new_figure(3.6)
    left, right = figure.subplots(1, 2)
    x, y = judged.forces.x / 1e6, judged.peaks
    middle = np.exp(np.mean(np.log(x))), np.exp(np.mean(np.log(y)))
    fine = np.geomspace(0.9 * x.min(), 1.1 * x.max(), 50)
    for power, label, colour, line in ((1 / 3, "P0 to the power 1/3: a mass on F ~ P0 δ²", AFTER, "--"),
                                       (1.0, "P0 to the power 1: a press at fixed stroke", GREY, ":"),
                                       (exponent, f"P0 to the power {exponent:.2f} ± {error:.2f} (fit)", BEFORE, "-")):
        left.plot(fine, middle[1] * (fine / middle[0]) ** power, line, color=colour, lw=1.5, label=label)
    left.plot(x, y, "o", color=INK, ms=6, label="measured", zorder=4)
    left.set(xscale="log", yscale="log")
    for axis in (left.xaxis, left.yaxis):
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter("")
    left.set(xticks=[1.0, 1.5, 2.0, 2.5], yticks=[40, 50, 60, 70, 80], ylim=(40, 85), xlabel="pressure [MPa]",
             ylabel="peak normal force [N]")
    left.legend(loc="upper left")
    for row, colour, mark in ((judged.reference, AFTER, "s"), (judged.polynomial, OTHER, "D")):
        right.plot(x, 100 * row.error, f"-{mark}", color=colour, lw=1.2, label=row.label)
    right.axhspan(-3.5, 3.5, color=FLOOR, alpha=0.15, lw=0)
    right.axhline(0, color=FLOOR, lw=0.8)
    dress(left, "")
    dress(right).set(ylim=(-6, 6), xlabel="pressure [MPa]", ylabel="deviation from the measured peak [%]")
    right.legend(loc="upper right")
    point_at(right, "± 3.5 %", (x.min(), -3.5), (0, 3), color=GREY, fontsize=8.5)
    return figure


@styled
def draw_ladder(judged: AbstractJudgement, most: int = 26, narrow: bool = False):
    """Left-out errors of all models, best first, with the polynomial's as the line to reach."""
    rows = sorted((row for row in judged.rows if np.isfinite(row.heldout)), key=lambda row: row.heldout)
    rows = [row for k, row in enumerate(rows) if k < most or row is judged.reference][::-1]
    line = 100 * judged.polynomial.heldout
    figure = new_figure(0.9 + (0.56 if narrow else 0.24) * len(rows), NARROW if narrow else WIDTH)
    axes = dress(figure.subplots(), "x")
    colours = {"printed": GREY, "polynomial": OTHER, "reference": AFTER, "reading": KIN, "choice": INK,
               "constant": INK}
    for i, row in enumerate(rows):
        colour = colours.get(row.kind, BEFORE)
        axes.barh(i - 0.25 * narrow, 100 * min(row.heldout, 1.0), height=0.3 if narrow else 0.7, edgecolor=colour,
                  color=colour if row.physical else "white", hatch="" if row.physical else "////")
        note = f"{100 * row.heldout:.1f} %, {row.free} fitted" + ("" if row.physical else ", " + row.remark)
        if narrow:  # words above each bar
            axes.annotate(wrap_text(f"{row.label}: {note}", NARROW - 0.4, 8), (0, i - 0.06), fontsize=8, va="bottom",
                          xycoords=("axes fraction", "data"), bbox={"facecolor": "white", "lw": 0, "pad": 0.5})
            continue
        point_at(axes, note, (max(100 * min(row.heldout, 1.0), line), i), (4, 0), fontsize=8.5, va="center")
    axes.axvline(line, color=INK, lw=0.9, ls="--")
    axes.set_ylim(-0.6, len(rows) - 0.4)
    axes.set_yticks(range(len(rows)), [""] * len(rows) if narrow else [row.label for row in rows], fontsize=8.5)
    axes.set(xscale="log", xlim=(0.8, 300), xticks=[1, 2, 5, 10, 20, 50, 100])
    axes.xaxis.set_major_formatter("{x:g}")
    axes.minorticks_off()
    label = "RMS error on left-out values [%]; dashed: the low polynomial"
    axes.set_xlabel(wrap_text(label, NARROW - 0.4) if narrow else label)
    return figure


@styled
def draw_differences(pairs: Sequence[PairedDifference], title: str):
    """Paired differences of left-out errors with two standard errors: what crosses zero cannot be told apart."""
    figure = new_figure(0.8 + 0.26 * len(pairs))
    axes = dress(figure.subplots(), "x")
    for i, pair in enumerate(pairs[::-1]):
        axes.errorbar(100 * pair.difference, i, xerr=200 * pair.standard_error, fmt="o", capsize=3,
                      color=BEFORE if pair.told else GREY)
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
def draw_corrections(printed: np.ndarray, ratios: Mapping[str, np.ndarray], rows: Sequence[PeakRow], factor: float):
    """What single changes, with their rows and fitted ratios by label, and one factor do to the printed theory [N]."""
    figure = new_figure(3.4)
    axes, forces = dress(figure.subplots()), rows[0].forces
    axes.plot(forces.x / 1e6, forces.peaks / printed, "o", color=INK, ms=6, label="measured / printed theory", zorder=4)
    axes.axhline(factor, color=GREY, lw=1.2, ls=":", label=f"one factor, {factor:.3f}")
    for row, colour, line in zip(rows, (OTHER, BEFORE, AFTER, KIN, INK), ("-", "-", "--", "-.", ":"), strict=True):
        axes.plot(forces.x / 1e6, ratios[row.label], line, color=colour, lw=1.8,
                  label=f"{row.label}: left out {100 * row.heldout:.2f} %")
    axes.set(ylim=(0.905, 1.015), xlabel="pressure [MPa]", ylabel="ratio to the printed theory")
    axes.legend(loc="upper right", ncols=2, fontsize=8.5)
    return figure


def write_peaks(judged: AbstractJudgement, folder, name: str = "report.html") -> Path:
    """Write a judgement on peaks as one self-contained page, and its figures as PNG files in `figures/` beside it.

    Args:
        judged: what `judge_campaign` returned.
        folder: where to write; made where it is not there.
        name: of the page's file.

    Returns:
        Path of the page.

    Raises:
        InputError: The folder cannot be written.
    """
    from ..reports.page import write_page
    from ..selection.text import say_verdict

    figures, narrow = ({"peaks-models": draw_values(judged, small), "peaks-ladder": draw_ladder(judged, narrow=small)}
                       for small in (False, True))
    slip, verdict = isinstance(judged, FrictionJudgement), say_verdict(judged.verdict)
    sections = [write_section("peaks.models", figures, [judged.table()], narrow, j=judged, slip=slip),
                write_section("peaks.limits", {}, j=judged, slip=slip)]
    forces = "friction forces" if slip else "peak forces"
    return write_page(f"{verdict}: {judged.campaign}", judged.sentence, sections, folder, name,
                      verdict=judged.verdict, badge=verdict,
                      status=[f"campaign {judged.campaign}", f"{len(judged.peaks)} {forces}",
                              f"reference model {judged.model}"])


@styled
def draw_values(judged: AbstractJudgement, narrow: bool = False,
                shown: Sequence[tuple[PeakRow, str, str]] = (), over_load: bool = False):
    """Measured values over pressure, or over load, beside the models; below, errors with each value left out.

    Args:
        judged: what `judge_campaign` returned.
        narrow: draw for a telephone.
        shown: models with colour and style; without any, the reference model, its rivals and the final model.
        over_load: show forces as shares of the load.
    """
    slip = isinstance(judged, FrictionJudgement)
    x = judged.forces.x if slip else judged.forces.x / 1e6
    order = np.argsort(x, kind="stable")
    x, y = x[order], judged.peaks[order]
    unit = x if over_load else 1.0
    figure = new_figure(5.6, NARROW if narrow else WIDTH)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(1.7, 1))
    for row, colour, style in shown or _choose_rows(judged):
        note = "" if row.physical else " (not physical)"
        upper.plot(x, row.fitted[order] / unit, style, color=colour, lw=1.3, ms=4, label=row.label + note)
        lower.plot(x, 100 * row.out[order], style, color=colour, lw=1.0, ms=4)
    upper.plot(x, y / unit, "o", color=INK, ms=6, label="measured", zorder=4)
    share = 200 * judged.forces.share[order]
    lower.fill_between(x, -share, share, color=FLOOR, alpha=0.18, lw=0)
    lower.axhline(0, color=FLOOR, lw=0.8)
    # An error beyond a quarter would flatten all others; such a model is in the figure below.
    lower.set_ylim(*np.clip(lower.get_ylim(), -25.0, 25.0))
    if over_load:
        upper.set_ylim(0.6 * np.min(y / unit), 1.3 * np.max(y / unit))
    if not slip and x[0] == 0 and judged.reference.fitted.min() == 0:
        upper.annotate("no gas, no force:\nthis model gives 0 N here", (0, 0), (0.22, 5), textcoords="data",
                       va="bottom", color=AFTER, arrowprops=dict(arrowstyle="-|>", color=AFTER))
        point_at(lower, "↓ −100 %", (0, lower.get_ylim()[0]), (4, 4), color=AFTER, fontsize=8.5)
    dress(upper).set_ylabel("friction over load" if over_load else "friction force [N]" if slip else
                            "peak normal force [N]")
    dress(lower, "").set(ylabel="left out, deviation [%]", xlabel="normal load [N]" if slip else "pressure [MPa]")
    head_figure(figure, *upper.get_legend_handles_labels())
    return figure


def _choose_rows(judged: AbstractJudgement) -> list[tuple[PeakRow, str, str]]:
    """Models that are drawn, each once, with colour and style."""
    shown = [(judged.reference, AFTER, "-s"), (judged.polynomial, OTHER, "-D")]
    if isinstance(judged, FrictionJudgement):
        shown.append((judged.constant, BEFORE, "--v"))
    shown += [(row, GREY, style) for row, style in zip(judged.printed, ("--^", ":^"), strict=False)]
    shown += [(row, BEFORE, "-v") for row in judged.steps[-1:] if row.effects]
    labels = [row.label for row, *_ in shown]
    return [one for k, one in enumerate(shown) if one[0].label not in labels[:k]]
