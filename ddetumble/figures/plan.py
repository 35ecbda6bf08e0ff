"""Figures of planned impacts: momentum and nutation over time, and the contact of each impact."""

from collections.abc import Mapping, Sequence

import numpy as np

from ..measurement.quantities import clean, describe_quantity
from .style import AFTER, BEFORE, INK, NARROW, SHADES, WIDTH, dress, head_figure, new_figure, styled


BINS = 40  # at most
FEW = 4  # draws a bin on average, below which a histogram is but a comb


@styled
def draw_motion(time: np.ndarray, momentum: np.ndarray, nutation: np.ndarray, instants: Sequence[float],
                narrow: bool = False):
    """Angular momentum (components and magnitude) and nutation angle over time, impacts marked.

    Args:
        time: shape (times,) [s].
        momentum: inertial components, shape (times, 3) [N m s].
        nutation: shape (times,) [rad].
        instants: of the impacts [s].
        narrow: draw for a telephone.
    """
    along = describe_quantity("time", [float(time[-1])])
    time, instants = along.scale * np.asarray(time), [along.scale * instant for instant in instants]
    figure = new_figure(4.8, NARROW if narrow else WIDTH)
    above, below = (dress(figure.add_subplot(2, 1, row + 1)) for row in range(2))
    for column, (name, line) in enumerate(zip("XYZ", ("-", "--", ":"), strict=True)):
        above.plot(time, momentum[:, column], line, color=AFTER, lw=1.3, label=name)
    above.plot(time, np.linalg.norm(momentum, axis=1), color=BEFORE, lw=2.0, label="magnitude")
    below.plot(time, np.degrees(nutation), color=AFTER, lw=1.6)
    for axes in (above, below):
        axes.set_xlim(float(time[0]), float(time[-1]))
        for instant in instants:
            axes.axvline(instant, color=INK, lw=0.6, ls=":")
    above.tick_params(labelbottom=False)
    above.set_ylabel("angular momentum [N m s]")
    below.set_ylabel("nutation angle [°]")
    below.set_xlabel(along.label)
    below.set_ylim(0, 180)
    below.set_yticks([0, 45, 90, 135, 180])
    head_figure(figure, *above.get_legend_handles_labels())
    return figure


@styled
def draw_contacts(times: Sequence[np.ndarray], normal: Sequence[np.ndarray], friction: Sequence[np.ndarray],
                  labels: Sequence[str], narrow: bool = False):
    """Normal force and friction of a few impacts over their contact; `narrow` for a telephone."""
    figure = new_figure(5.0 if narrow else 2.8, NARROW if narrow else WIDTH)
    for column, (name, forces) in enumerate((("normal force [N]", normal), ("friction [N]", friction))):
        axes = dress(figure.add_subplot(2, 1, column + 1) if narrow else figure.add_subplot(1, 2, column + 1))
        for k, (time, force, label) in enumerate(zip(times, forces, labels, strict=True)):
            axes.plot(1e3 * np.asarray(time), np.asarray(force), color=SHADES[k], lw=1.8, label=label,
                      ls=("-", "--", ":")[k % 3])
        axes.set_ylabel(name)
        axes.set_xlabel("time since first touch [ms]")
        axes.set_ylim(0, None)
    head_figure(figure, *figure.axes[0].get_legend_handles_labels())
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
        narrow: draw for a telephone.
    """
    from matplotlib.ticker import FuncFormatter, MaxNLocator, NullFormatter

    figure = new_figure(3.0, NARROW if narrow else WIDTH)
    axes = dress(figure.add_subplot())
    number = np.arange(len(best) + 1)
    best, low, high, tail = (100 * np.concatenate([[1.0], one]) for one in (best, low, high, tail))
    axes.fill_between(number, low, high, color=SHADES[0], alpha=0.3, lw=0, label="5 to 95 % of the draws")
    axes.plot(number, best, color=INK, lw=1.4, marker="o", ms=3, label="best estimate")
    axes.plot(number, tail, color=INK, lw=1.4, ls="--", label="mean of the bad tail")
    axes.axhline(100 * share, color=INK, lw=0.8, ls=":", label="wanted")
    axes.set_yscale("log")
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, place: f"{value:g}"))
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_xlabel("impacts")
    axes.set_ylabel("angular momentum left [%]")
    head_figure(figure, *axes.get_legend_handles_labels())
    return figure


@styled
def draw_outlook(shares: Mapping[str, np.ndarray], nominal: float, tail: float, narrow: bool = False):
    """How much of the angular momentum is left under the draws of every model.

    Args:
        shares: of the momentum left, one a draw, by model [-].
        nominal: under the best estimate [-].
        tail: mean over the worst share of all draws [-].
        narrow: draw for a telephone.
    """
    figure = new_figure(3.2, NARROW if narrow else WIDTH)
    axes = dress(figure.add_subplot())
    whole = 100 * np.concatenate(list(shares.values()))
    room = max(0.02 * (whole.max() - whole.min()), 1e-3)
    count = min(BINS, max(5, max(map(len, shares.values())) // FEW))
    edges = np.linspace(whole.min() - room, whole.max() + room, count + 1)
    for k, (name, own) in enumerate(shares.items()):
        height, _ = np.histogram(100 * own, edges)
        axes.stairs(100 * height / len(own), edges, fill=True, color=SHADES[k % len(SHADES)], alpha=0.35,
                    label=clean(name, 60))
        axes.stairs(100 * height / len(own), edges, color=SHADES[k % len(SHADES)], lw=1.4)
    axes.axvline(100 * nominal, color=INK, lw=1.4, label="best estimate")
    axes.axvline(100 * tail, color=INK, lw=1.4, ls="--", label="mean of the bad tail")
    axes.set_xlabel("angular momentum left after the first impact [%]")
    axes.set_ylabel("draws of the model [%]")
    axes.set_ylim(0, 1.12 * axes.get_ylim()[1])
    head_figure(figure, *axes.get_legend_handles_labels())
    return figure
