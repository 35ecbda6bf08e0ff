"""The report of a campaign that holds peaks only: measured values, the models beside them, what cannot be told."""

from pathlib import Path

import numpy as np

from ..figures.style import (
    AFTER,
    BEFORE,
    FLOOR,
    GREY,
    INK,
    NARROW,
    OTHER,
    WIDTH,
    dress,
    head_figure,
    new_figure,
    styled,
)
from .drawings import draw_ladder
from .friction import FrictionJudgement
from .judgement import PeakJudgement
from .rows import PeakRow


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
    from ..reports.page import Picture, Section, write_page
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
            figures=[Picture("peaks-models", f"Measured {forces} beside the models, and errors with each value left "
                             "out.", draw_values(judged), "", draw_values(judged, narrow=True)),
                     ("peaks-ladder", "Every model, best first, by the error of what was left out. Hatched: an "
                      "estimate outside its physical range, so that the model does not count.", draw_ladder(judged))],
            tables=[judged.table()]),
        Section("What this does not show", [f"{lacking} (`ddetumble import`) to have these judged."],
                points=[*judged.notes, *seen]),
    ]
    return write_page(f"{say_verdict(judged.verdict)}: {judged.campaign}", judged.sentence, sections, folder, name,
                      verdict=judged.verdict, badge=say_verdict(judged.verdict),
                      status=[f"campaign {judged.campaign}", f"{count} {forces}", f"reference model {judged.model}"])


@styled
def draw_values(judged: PeakJudgement | FrictionJudgement, narrow: bool = False):
    """Measured values over pressure, or over load, beside the models; below, errors with each value left out.

    Args:
        judged: what `judge_campaign` returned.
        narrow: draw for a telephone.
    """
    slip = isinstance(judged, FrictionJudgement)
    x = judged.loads if slip else judged.pressures / 1e6
    order = np.argsort(x, kind="stable")
    x, y = x[order], judged.peaks[order]
    figure = new_figure(5.6, NARROW if narrow else WIDTH)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(1.7, 1))
    for row, colour, style in _choose_rows(judged):
        note = "" if row.physical else " (not physical)"
        upper.plot(x, row.fitted[order], style, color=colour, lw=1.3, ms=4, label=row.label + note)
        lower.plot(x, 100 * (row.held[order] / y - 1.0), style, color=colour, lw=1.0, ms=4)
    upper.plot(x, y, "o", color=INK, ms=6, label="measured", zorder=4)
    share = 200 * judged.noise.share[order]
    lower.fill_between(x, -share, share, color=FLOOR, alpha=0.18, lw=0)
    lower.axhline(0, color=FLOOR, lw=0.8)
    # An error beyond a quarter would flatten all others; such a model is in the figure below.
    lower.set_ylim(*np.clip(lower.get_ylim(), -25.0, 25.0))
    dress(upper)
    dress(lower, "")
    upper.set_ylabel("friction force [N]" if slip else "peak normal force [N]")
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
