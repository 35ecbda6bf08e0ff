"""The report of a campaign that holds peaks only, and the figures of a judgement on peaks."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from ..figures.style import (
    AFTER,
    BEFORE,
    FLOOR,
    GREY,
    INK,
    KIN,
    NARROW,
    OTHER,
    WIDTH,
    dress,
    head_figure,
    new_figure,
    styled,
    wrap_text,
)
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
def draw_ladder(judged: PeakJudgement | FrictionJudgement, most: int = 26, narrow: bool = False):
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
        axes.annotate(note, (max(100 * min(row.heldout, 1.0), line), i), (4, 0), fontsize=8.5,
                      textcoords="offset points", va="center")
    axes.axvline(line, color=INK, lw=0.9, ls="--")
    axes.set_ylim(-0.6, len(rows) - 0.4)
    axes.set_yticks(range(len(rows)), [""] * len(rows) if narrow else [row.label for row in rows], fontsize=8.5)
    axes.set_xscale("log")
    axes.set_xlim(0.8, 300)
    axes.set_xticks([1, 2, 5, 10, 20, 50, 100])
    axes.xaxis.set_major_formatter("{x:g}")
    axes.minorticks_off()
    label = "rms error of what was left out [%]; dashed: the low polynomial"
    axes.set_xlabel(wrap_text(label, NARROW - 0.4) if narrow else label)
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


def write_peaks(judged: PeakJudgement | FrictionJudgement, folder, name: str = "report.html") -> Path:
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
    from ..reports.page import Section, draw_picture, write_page
    from ..selection.text import say_verdict

    if isinstance(judged, FrictionJudgement):
        forces, lacking = "friction forces", (
            "Single forces have no curve over slip: presliding, heating and whatever else changes along a stroke leave "
            "no trace in them. Measure force over slip")
    else:
        forces, lacking = "peak forces", (
            "Peaks have no curve over time: contact times, damping and whatever else shapes the pulse leave no trace "
            "in them. Measure force over time")
    count = len(judged.peaks)
    seen = [f"{effect} cannot be seen: {reason}." for effect, reason in judged.left_out.items()
            if not any(effect in note.lower() for note in judged.notes)]
    sections = [
        Section(f"{count} {forces} and the models", [
            "Above: the measured values and fits to all of them. Below: each value predicted by a fit without it; the "
            "band is twice the size of a single value's error.", f"Errors of single values: {judged.noise.text}"],
            figures=[draw_picture("peaks-models", f"Measured {forces} beside the models, and errors with each value "
                                  "left out.", draw_values, judged),
                     draw_picture("peaks-ladder", "Every model, best first, by the error of what was left out. "
                                  "Hatched: an estimate outside its physical range, so that the model does not count.",
                                  draw_ladder, judged)],
            tables=[judged.table()]),
        Section("What this does not show", [f"{lacking} (`ddetumble import`) to have these judged."],
                points=[*judged.notes, *seen]),
    ]
    return write_page(f"{say_verdict(judged.verdict)}: {judged.campaign}", judged.sentence, sections, folder, name,
                      verdict=judged.verdict, badge=say_verdict(judged.verdict),
                      status=[f"campaign {judged.campaign}", f"{count} {forces}", f"reference model {judged.model}"])


@styled
def draw_values(judged: PeakJudgement | FrictionJudgement, narrow: bool = False,
                shown: Sequence[tuple[PeakRow, str, str]] = (), over_load: bool = False):
    """Measured values over pressure, or over load, beside the models; below, errors with each value left out.

    Args:
        judged: what `judge_campaign` returned.
        narrow: draw for a telephone.
        shown: models with colour and style; without any, the reference model, its rivals and the final model.
        over_load: show forces as shares of the load.
    """
    slip = isinstance(judged, FrictionJudgement)
    x = judged.loads if slip else judged.pressures / 1e6
    order = np.argsort(x, kind="stable")
    x, y = x[order], judged.peaks[order]
    unit = x if over_load else 1.0
    figure = new_figure(5.6, NARROW if narrow else WIDTH)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(1.7, 1))
    for row, colour, style in shown or _choose_rows(judged):
        note = "" if row.physical else " (not physical)"
        upper.plot(x, row.fitted[order] / unit, style, color=colour, lw=1.3, ms=4, label=row.label + note)
        lower.plot(x, 100 * (row.held[order] / y - 1.0), style, color=colour, lw=1.0, ms=4)
    upper.plot(x, y / unit, "o", color=INK, ms=6, label="measured", zorder=4)
    share = 200 * judged.noise.share[order]
    lower.fill_between(x, -share, share, color=FLOOR, alpha=0.18, lw=0)
    lower.axhline(0, color=FLOOR, lw=0.8)
    # An error beyond a quarter would flatten all others; such a model is in the figure below.
    lower.set_ylim(*np.clip(lower.get_ylim(), -25.0, 25.0))
    if over_load:
        upper.set_ylim(0.6 * np.min(y / unit), 1.3 * np.max(y / unit))
    if not slip and judged.pressures.min() == 0 and judged.reference.fitted.min() == 0:
        upper.annotate("no gas, no force:\nthis model gives 0 N here", (0, 0), (0.22, 5), textcoords="data",
                       va="bottom", color=AFTER, arrowprops=dict(arrowstyle="-|>", color=AFTER))
        lower.annotate("↓ −100 %", (0, lower.get_ylim()[0]), (4, 4), textcoords="offset points",
                       color=AFTER, fontsize=8.5)
    dress(upper)
    dress(lower, "")
    force = "friction" if slip else "peak normal force"
    upper.set_ylabel(f"{force} over load" if over_load else f"{force} force [N]" if slip else f"{force} [N]")
    lower.set_ylabel("left out, deviation [%]")
    lower.set_xlabel("normal load [N]" if slip else "pressure [MPa]")
    head_figure(figure, *upper.get_legend_handles_labels())
    return figure


def _choose_rows(judged: PeakJudgement | FrictionJudgement) -> list[tuple[PeakRow, str, str]]:
    """Models that are drawn, each once, with colour and style."""
    shown = [(judged.reference, AFTER, "-s"), (judged.polynomial, OTHER, "-D")]
    if isinstance(judged, FrictionJudgement):
        shown.append((judged.constant, BEFORE, "--v"))
    printed = [row for row in judged.rows if row.kind == "printed"]
    shown += [(row, GREY, style) for row, style in zip(printed, ("--^", ":^"), strict=False)]
    shown += [(row, BEFORE, "-v") for row in judged.steps[-1:] if row.effects]
    labels = [row.label for row, *_ in shown]
    return [one for k, one in enumerate(shown) if one[0].label not in labels[:k]]
