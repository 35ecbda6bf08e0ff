"""Figures of what is to come: the next test, what a campaign and an exam can see, and planned impacts."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.ticker import MaxNLocator, PercentFormatter

from ..families import find_family
from ..measurement.quantities import clean, describe_quantity
from ..planning.detectability import Visibility
from ..planning.next_test import Design, describe_test
from .palette import AFTER, BEFORE, FLOOR, GREY, INK, KIN, OTHER, SHADES
from .style import NARROW, WIDTH, dress, head_figure, key_line, new_axes, new_figure, strip, styled, wrap_text


COLOURS = (AFTER, BEFORE, KIN, OTHER, GREY)
BINS = 40  # at most: more are narrower than the spread of a posterior needs
FEW = 4  # draws a bin on average, below which a histogram is but a comb
CURVES = (("seen", "lack of fit detected", BEFORE, "o"), ("named", "the effect, or a set that contains it", AFTER, "s"))


@styled
def draw_next_test(found: Design):
    """What every rival predicts of the proposed test, and how they differ, in units of the noise of a sample.

    One column a channel (attitudes left out), predictions above, differences below.
    """
    best, family, several = found.proposals[0], find_family(found.family), len(found.rivals) > 1
    channels = [c for c, name in enumerate(best.channels) if not name.startswith("attitude_")]
    figure = new_figure(4.6 if several else 2.8)
    grid = figure.subplots(2 if several else 1, len(channels), squeeze=False, sharex=True)
    across = describe_quantity(family.independent, best.time)
    time, look = best.time * across.scale, "-" if len(best.time) > 1 else "o"  # a value is a point
    for column, c in enumerate(channels):
        name = best.channels[c]
        shown = describe_quantity(name, np.stack([curve[c] for curve in best.curves.values()]))
        top = dress(grid[0, column], ylabel=shown.label)
        for colour, curve in zip(COLOURS, best.curves.values(), strict=False):
            top.plot(time, curve[c] * shown.scale, look, color=colour, lw=1.6)
        if family.has_contact and len(time) > 1:  # what follows the contact says nothing
            forces = [np.abs(curve[0]) for curve in best.curves.values()]
            touched = np.any([force > 1e-6 * force.max() for force in forces], axis=0)
            last = 1.15 * best.time[touched].max(initial=best.time[0])
            top.set_xlim(time[0], max(last, 0.1 * best.time[-1]) * across.scale)
        if several:
            below = dress(grid[1, column], ylabel=f"less {clean(found.rivals[0], 30)},\nover noise of a sample")
            first = best.curves[found.rivals[0]][c]
            for colour, rival in zip(COLOURS[1:], found.rivals[1:], strict=False):
                below.plot(time, (best.curves[rival][c] - first) / best.noise[name], look, color=colour, lw=1.6)
            below.axhspan(-1, 1, color=GREY, alpha=0.15, lw=0)
        if len(time) > 1:
            grid[-1, column].set_xlabel(across.label)
        else:
            grid[-1, column].set_xticks([])
    legend = head_figure(figure, list(map(key_line, COLOURS[: len(found.rivals)])),
                         [clean(rival, 40) for rival in found.rivals])
    # The title of an axes would widen its column.
    legend.set_title(clean(f"The next test: {describe_test(best, found.limits, ranges=False)}", 150))
    legend.set_alignment("left")
    return figure


@styled
def draw_map(found: Visibility):
    """Which effects a campaign would show, from which size on, and how alike any two of them look.

    A matrix of |cos|, the smallest visible size beside every row.
    """
    count = len(found.names)
    figure = new_figure(1.9 + 0.3 * max(count, 3))
    axes = figure.add_subplot()
    axes.imshow(found.cosines, cmap=LinearSegmentedColormap.from_list("house", ["#ffffff", "#b9d9ee", AFTER]), vmin=0.0,
                vmax=1.0, aspect="auto")
    alike = {frozenset(pair) for pair in found.alike}
    for i, j in np.ndindex(count, count):
        value = found.cosines[i, j]
        if i != j and value >= 0.1:
            pair = frozenset((found.names[i], found.names[j])) in alike
            axes.text(j, i, f"{value:.2f}", ha="center", va="center", fontsize=7.5,
                      color="white" if value > 0.6 else INK, fontweight="bold" if pair else "normal")
    sizes, labels = {e.effect: e for e in found.effects}, []
    for name in found.names:
        e = sizes[name]
        above = "up to" if e.parameter in ("tau_s",) else "from"
        unit = "" if e.unit == "1" else e.unit
        labels.append(f"{clean(name, 34)}   {above} {e.parameter} = {e.size:.3g} {unit}".rstrip())
    axes.set_yticks(range(count), labels)
    axes.set_xticks(range(count), [clean(name, 34) for name in found.names], rotation=40, ha="left",
                    rotation_mode="anchor")
    axes.xaxis.tick_top()
    strip(axes)
    unseen = [e.effect for e in found.effects if e.size is None]
    text = "|cos| between the visible signatures of two effects; each is detected at the stated size with 95 % power."
    text += f" Undetectable: {', '.join(unseen)}." if unseen else ""
    axes.set_xlabel(wrap_text(clean(text, 300), WIDTH - 4.2), loc="left", color=INK, multialignment="left")
    return figure


@styled
def draw_power(bins: Sequence[Mapping[str, Any]], level: float = 0.01, narrow: bool = False):
    """Share of cases in which an effect is seen, and named, against its strength, with 95 % limits.

    Args:
        bins: of `ddetumble.exam.scoring.measure_power`: `low`, `high`, and shares `seen` and `named`.
        level: of the test for a lack of fit, drawn in.
    """
    label = "strength: RMS residual of the refitted reference model over noise"
    figure, axes = new_axes(3.6, NARROW if narrow else WIDTH, "both", xscale="log", ylim=(-0.03, 1.12),
                            yticks=np.linspace(0.0, 1.0, 6), xlabel=wrap_text(label, 3.2) if narrow else label,
                            ylabel="share of single effects")
    axes.axhline(level, color=FLOOR, lw=1.0, ls=(0, (4, 3)))
    axes.axvline(2.0, color=FLOOR, lw=1.0, ls=(0, (1, 2)))
    for shift, (key, _, colour, marker) in zip((0.985, 1.015), CURVES, strict=True):
        held = [b for b in bins if b[key].total]
        if not held:
            continue
        x = shift * np.array([np.sqrt(b["low"] * b["high"]) for b in held])
        low, y, high = np.array([(b[key].low, b[key].share, b[key].high) for b in held]).T
        axes.errorbar(x, y, [np.maximum(y - low, 0), np.maximum(high - y, 0)], color=colour, marker=marker, ms=5,
                      lw=1.4, elinewidth=1.0, capsize=2)
    for b in bins:
        if b["seen"].total:
            axes.annotate(f"{b['seen'].total}", (np.sqrt(b["low"] * b["high"]), 1.0), xytext=(0, 6),
                          textcoords="offset points", ha="center", color=GREY, fontsize=8)
    edges = sorted({b["low"] for b in bins} | {b["high"] for b in bins})
    axes.set_xlim(edges[0] * 0.95, edges[-1] * 1.05)
    axes.set_xticks(edges, [f"{edge:g}" for edge in edges])
    axes.minorticks_off()
    axes.yaxis.set_major_formatter(PercentFormatter(1.0, symbol=" %"))
    head_figure(figure, [key_line(colour, 1.4, marker=marker, ms=5) for _, _, colour, marker in CURVES],
                [label for _, label, _, _ in CURVES])
    return figure


@styled
def draw_motion(time: np.ndarray, momentum: np.ndarray, nutation: np.ndarray, instants: Sequence[float],
                narrow: bool = False):
    """Angular momentum (components and magnitude) and nutation angle over time, impacts marked.

    Args:
        time: shape (times,) [s].
        momentum: inertial components, shape (times, 3) [N m s].
        nutation: shape (times,) [rad]; nan where there is none.
        instants: of the impacts [s].
    """
    along = describe_quantity("time", [float(time[-1])])
    time = along.scale * np.asarray(time)
    figure = new_figure(4.8, NARROW if narrow else WIDTH)
    above, below = figure.subplots(2, 1, sharex=True)
    dress(above, ylabel="angular momentum [N m s]", xlim=(float(time[0]), float(time[-1])))
    dress(below, ylabel="nutation angle [°]", xlabel=along.label, ylim=(0, 180), yticks=[0, 45, 90, 135, 180])
    for column, (name, line) in enumerate(zip("XYZ", ("-", "--", ":"), strict=True)):
        above.plot(time, momentum[:, column], line, color=AFTER, lw=1.3, label=name)
    above.plot(time, np.linalg.norm(momentum, axis=1), color=BEFORE, lw=2.0, label="magnitude")
    below.plot(time, np.degrees(nutation), color=AFTER, lw=1.6)
    for axes in (above, below):
        for instant in instants:
            axes.axvline(along.scale * instant, color=INK, lw=0.6, ls=":")
    head_figure(figure, *above.get_legend_handles_labels())
    return figure


@styled
def draw_contacts(times: Sequence[np.ndarray], normal: Sequence[np.ndarray], friction: Sequence[np.ndarray],
                  labels: Sequence[str], narrow: bool = False):
    """Normal force and friction [N] of a few impacts over the time since first touch [s]; `narrow` for a telephone."""
    figure = new_figure(5.0 if narrow else 2.8, NARROW if narrow else WIDTH)
    panels = figure.subplots(*((2, 1) if narrow else (1, 2)))
    for axes, name, forces in zip(panels, ("normal force [N]", "friction [N]"), (normal, friction), strict=True):
        dress(axes, ylabel=name, xlabel="time since first touch [ms]")
        for k, (time, force, label) in enumerate(zip(times, forces, labels, strict=True)):
            axes.plot(1e3 * np.asarray(time), np.asarray(force), color=SHADES[k], lw=1.8, label=label,
                      ls=("-", "--", ":")[k % 3])
        axes.set_ylim(0, None)
    head_figure(figure, *panels[0].get_legend_handles_labels())
    return figure


@styled
def draw_prospect(best: np.ndarray, low: np.ndarray, high: np.ndarray, tail: np.ndarray, share: float,
                  narrow: bool = False):
    """The angular momentum left after every impact of a sequence, under the draws.

    Args:
        best: under the best estimate, shape (impacts,) [-].
        low, high: 5 and 95 % of the draws.
        tail: mean over the worst share of the draws.
        share: that was wanted.
    """
    figure, axes = new_axes(3.0, NARROW if narrow else WIDTH, xlabel="impacts", ylabel="angular momentum left [%]",
                            yscale="log")
    number = np.arange(len(best) + 1)
    best, low, high, tail = (100 * np.concatenate([[1.0], one]) for one in (best, low, high, tail))
    axes.fill_between(number, low, high, color=SHADES[0], alpha=0.3, lw=0, label="5 to 95 % of the draws")
    axes.plot(number, best, color=INK, lw=1.4, marker="o", ms=3, label="best estimate")
    axes.plot(number, tail, color=INK, lw=1.4, ls="--", label="mean of the worst draws")
    axes.axhline(100 * share, color=INK, lw=0.8, ls=":", label="wanted")
    axes.yaxis.set_major_formatter("{x:g}")
    axes.yaxis.set_minor_formatter("")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    head_figure(figure, *axes.get_legend_handles_labels())
    return figure


@styled
def draw_outlook(shares: Mapping[str, np.ndarray], nominal: float, tail: float, narrow: bool = False):
    """How much of the angular momentum is left under the draws of every model.

    Args:
        shares: of the momentum left, one a draw, by model [-].
        nominal: under the best estimate [-].
        tail: mean over the worst share of all draws [-].
    """
    figure, axes = new_axes(3.2, NARROW if narrow else WIDTH, ylabel="draws of the model [%]",
                            xlabel="angular momentum left after the first impact [%]")
    whole = 100 * np.concatenate(list(shares.values()))
    room = max(0.02 * (whole.max() - whole.min()), 1e-3)
    count = min(BINS, max(5, max(map(len, shares.values())) // FEW))
    edges = np.linspace(whole.min() - room, whole.max() + room, count + 1)
    for k, (name, own) in enumerate(shares.items()):
        height, colour = 100 * np.histogram(100 * own, edges)[0] / len(own), SHADES[k % len(SHADES)]
        axes.stairs(height, edges, fill=True, color=colour, alpha=0.35, label=clean(name, 60))
        axes.stairs(height, edges, color=colour, lw=1.4)
    axes.axvline(100 * nominal, color=INK, lw=1.4, label="best estimate")
    axes.axvline(100 * tail, color=INK, lw=1.4, ls="--", label="mean of the worst draws")
    axes.set_ylim(0, 1.12 * axes.get_ylim()[1])
    head_figure(figure, *axes.get_legend_handles_labels())
    return figure
