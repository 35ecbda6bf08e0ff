"""Figures of tests to come: what the rivals say of the next one, and what a planned campaign could see."""

import numpy as np

from ..families import find_family
from ..measurement.quantities import clean, describe_quantity
from ..planning.detectability import Visibility
from ..planning.next_test import Design, describe_test
from .style import AFTER, BEFORE, GREY, INK, KIN, OTHER, WIDTH, dress, head_figure, new_figure, styled, wrap_text


COLOURS = (AFTER, BEFORE, KIN, OTHER, GREY)


@styled
def draw_next_test(found: Design):
    """What every rival predicts of the proposed test, and how they differ, in units of the noise of a sample.

    Args:
        found: of `design`.

    Returns:
        A matplotlib figure: one column a channel (attitudes left out), predictions above, differences below.
    """
    from matplotlib.lines import Line2D

    best = found.proposals[0]
    channels = [c for c, name in enumerate(best.channels) if not name.startswith("attitude_")]
    figure = new_figure(4.6 if len(found.rivals) > 1 else 2.8, WIDTH)
    grid = figure.subplots(2 if len(found.rivals) > 1 else 1, len(channels), squeeze=False, sharex=True)
    across = describe_quantity(find_family(found.family).independent, best.time)
    for column, c in enumerate(channels):
        name = best.channels[c]
        shown = describe_quantity(name, np.stack([curve[c] for curve in best.curves.values()]))
        top = dress(grid[0, column])
        for colour, (rival, curve) in zip(COLOURS, best.curves.items(), strict=False):
            top.plot(best.time * across.scale, curve[c] * shown.scale, color=colour, lw=1.6, label=clean(rival, 40))
        top.set_ylabel(shown.label)
        if find_family(found.family).has_contact:  # what follows the contact says nothing
            forces = [np.abs(curve[0]) for curve in best.curves.values()]
            touched = np.any([force > 1e-6 * force.max() for force in forces], axis=0)
            last = 1.15 * best.time[touched].max(initial=best.time[0])
            top.set_xlim(best.time[0] * across.scale, max(last, 0.1 * best.time[-1]) * across.scale)
        if len(found.rivals) > 1:
            below = dress(grid[1, column])
            first = best.curves[found.rivals[0]][c]
            for colour, rival in zip(COLOURS[1:], found.rivals[1:], strict=False):
                below.plot(best.time * across.scale, (best.curves[rival][c] - first) / best.noise[name], color=colour,
                           lw=1.6)
            below.axhspan(-1, 1, color=GREY, alpha=0.15, lw=0)
            below.set_ylabel(f"less {clean(found.rivals[0], 30)},\nover noise of a sample")
        grid[-1, column].set_xlabel(across.label)
    handles = [Line2D([], [], color=colour, lw=1.6) for colour, _ in zip(COLOURS, found.rivals, strict=False)]
    legend = head_figure(figure, handles, [clean(rival, 40) for rival in found.rivals])
    # The title of an axes would widen its column.
    legend.set_title(clean(f"The next test: {describe_test(best, found.limits)}", 150))
    legend.set_alignment("left")
    return figure


@styled
def draw_map(found: Visibility):
    """Which effects a campaign would show, from which size on, and how alike any two of them look.

    Args:
        found: of `map_effects`.

    Returns:
        A matplotlib figure: a matrix of |cos|, the smallest visible size beside every row.
    """
    from matplotlib.colors import LinearSegmentedColormap

    count = len(found.names)
    figure = new_figure(1.9 + 0.3 * max(count, 3), WIDTH)
    axes = figure.add_subplot()
    axes.imshow(found.cosines, cmap=LinearSegmentedColormap.from_list("house", ["#ffffff", "#b9d9ee", AFTER]), vmin=0.0,
                vmax=1.0, aspect="auto")
    alike = {frozenset(pair) for pair in found.alike}
    for i in range(count):
        for j in range(count):
            value = found.cosines[i, j]
            if i != j and value >= 0.1:
                pair = frozenset((found.names[i], found.names[j])) in alike
                axes.text(j, i, f"{value:.2f}", ha="center", va="center", fontsize=7.5,
                          color="white" if value > 0.6 else INK, fontweight="bold" if pair else "normal")
    sizes = {e.effect: e for e in found.effects}
    labels = []
    for name in found.names:
        e = sizes[name]
        above = "up to" if e.parameter in ("tau_s",) else "from"
        unit = "" if e.unit == "1" else e.unit
        labels.append(f"{clean(name, 34)}   {above} {e.parameter} = {e.size:.3g} {unit}".rstrip())
    axes.set_yticks(range(count), labels)
    axes.set_xticks(range(count), [clean(name, 34) for name in found.names], rotation=40, ha="left",
                    rotation_mode="anchor")
    axes.xaxis.tick_top()
    axes.tick_params(length=0)
    for spine in axes.spines.values():
        spine.set_visible(False)
    unseen = [e.effect for e in found.effects if e.size is None]
    text = "|cos| between what can be seen of two effects; found from the stated size on, with 95 % power."
    text += f" Cannot be seen: {', '.join(unseen)}." if unseen else ""
    axes.set_xlabel(wrap_text(clean(text, 300), WIDTH - 4.2), loc="left", color=INK, multialignment="left")
    return figure
