"""How far a fit moved the settings of every record, against what is stated."""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from ..measurement.quantities import clean, describe_quantity, format_number, say_p, shorten
from ..selection.result import SettingShift
from .style import FLOOR, GREY, NARROW, PALE, WIDTH, colour_models, dress, head_figure, new_figure, styled


STATED = 2.0  # stated deviations within which 95 % of true errors lie


@styled
def draw_shifts(models: Mapping[str, Sequence[SettingShift]], narrow: bool = False):
    """One panel a setting: its shift in every record, in stated deviations, with the band that is stated.

    Args:
        models: shifts by the model's name; of two, the simpler first.
        narrow: draw for a telephone.

    Returns:
        A matplotlib figure.
    """
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    names = [shift.name for shift in next(iter(models.values()))]
    figure = new_figure(0.7 + (1.75 if narrow else 1.35) * len(names), NARROW if narrow else WIDTH)
    panels = figure.subplots(len(names), 1, squeeze=False, sharex=True).ravel()
    colours = colour_models(len(models))
    marks = ("o", "D")
    for axes, name in zip(panels, names, strict=True):
        dress(axes)
        axes.axhspan(-STATED, STATED, color=FLOOR, alpha=0.18, lw=0)
        axes.axhline(0, color=GREY, lw=0.7)
        top, remarks = 1.15 * STATED, []
        for (label, shifts), colour, mark in zip(models.items(), colours, marks, strict=False):
            shift = next((s for s in shifts if s.name == name), None)
            if shift is None:
                continue
            axes.plot(np.arange(1, len(shift.shifts) + 1), shift.shifts, mark, color=colour, ms=4.5, lw=0)
            top = max(top, 1.15 * float(np.max(np.abs(shift.shifts), initial=0.0)))
            if math.isfinite(shift.rms):
                whose = f"{shorten(label, 28)}: " if len(models) > 1 else ""
                remarks.append(f"{whose}rms {format_number(shift.rms, 2)}, {say_p(shift.p_value)}")
        axes.set_ylim(-top, top)
        words = "time origin" if name == "time" else describe_quantity(name).name
        axes.set_title("\n".join([words[:1].upper() + words[1:], *(remarks if narrow else ())]),
                       fontsize=8.5 if narrow else 9.5)
        if not narrow:
            axes.set_title("; ".join(remarks), loc="right", color=GREY, fontsize=8.5)
        axes.set_ylabel("shift /\nstated sd")
    panels[-1].set_xlabel("record, in the order of the campaign")
    panels[-1].margins(x=0.02)
    panels[-1].xaxis.get_major_locator().set_params(integer=True)
    handles: list = [Line2D([], [], ls="none", marker=mark, color=colour, ms=5)
                     for _, colour, mark in zip(models, colours, marks, strict=False)]
    handles.append(Patch(facecolor=FLOOR, alpha=0.35, edgecolor=PALE))
    head_figure(figure, handles, [*(clean(label, 80) for label in models), "two stated deviations"])
    return figure
