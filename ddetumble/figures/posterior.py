"""Draws from a posterior: marginals, pairs, chains and their ranks; replicated records; conditions left out."""

import math
import textwrap
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from matplotlib.ticker import MaxNLocator
from scipy import ndimage, stats

from ..families import DEFAULT_FAMILY, find_family
from ..measurement.quantities import clean, describe_conditions, describe_quantity, shorten_names, vary
from ..posterior.loo import Scores
from ..posterior.predictive_check import LEVEL, STATISTICS, Checks, Replicates
from ..posterior.result import Posterior
from ..posterior.target import AbstractTarget
from .palette import AFTER, BEFORE, FLOOR, GREY, INK, KIN, PALE, SHADES
from .style import (
    STEPS,
    WIDTH,
    SpacedLocator,
    dress,
    dress_rows,
    head_figure,
    key_band,
    key_dot,
    key_line,
    name_ticks,
    new_figure,
    styled,
    wrap_text,
)


_MASSES = (0.6827, 0.9545)  # inside the contours: one and two standard deviations of a Gaussian
_MOST = 10  # parameters of a figure: more have no room for their labels
_DRAWN = 20000  # draws at most: more change no contour visibly
_DASHED = (0, (4, 2))  # lines of the fit's Gaussian
_MARKS = {"chi_square": ("o", AFTER), "largest": ("^", BEFORE), "lag": ("s", SHADES[6])}  # of a predictive check
_LEAST = 1e-7  # p-values below are drawn there, so that the axis ends


@styled
def draw_corner(posterior: Posterior):
    """Marginals and pairs of the draws with contours of 1 and 2 sigma, the fit's Gaussian drawn over them.

    At most the first ten parameters are drawn, here and in the other figures of draws.
    """
    count = len(posterior.target.names[:_MOST])
    x = posterior.x.reshape(-1, posterior.x.shape[-1])
    values = posterior.target.publish(x if len(x) <= _DRAWN else posterior.draw(_DRAWN))
    curves = [_push_marginal(posterior.target, k) for k in range(count)]
    spans = [_span(values[:, k], curves[k]) for k in range(count)]
    size = WIDTH * (0.55 if count == 1 else 0.8 if count == 2 else 1.0)
    figure = new_figure(0.45 + 0.92 * size if count > 1 else 0.62 * size, size, gap=0.03)
    panels = figure.subplots(count, count, squeeze=False)
    # The more panels, the smaller their type, and the fewer ticks and characters a line.
    font, wide, small = (9.5, 24, 8.5) if count <= 4 else (8.5, 18, 7.5) if count <= 6 else (7.0, 14, 6.5)
    ticks = 4 if count <= 3 else 3 if count <= 6 else 2
    for (row, column), axes in np.ndenumerate(panels):
        if column > row:
            axes.set_axis_off()
            continue
        dress(axes, "", xlim=spans[column])
        if count <= 3:  # the numbers lie
            axes.xaxis.set_major_locator(SpacedLocator(ticks, prune="both" if ticks < 4 else None))
        else:
            _set_ticks(axes.xaxis, ticks)
        lowest = row == count - 1
        if row == column:
            edges = np.linspace(spans[row][0], spans[row][1], 33)
            density = np.histogram(values[:, row], bins=edges, density=True)[0]
            axes.stairs(density, edges, fill=True, color=KIN, alpha=0.6)
            axes.stairs(density, edges, color=AFTER, lw=1.0)
            axes.plot(*curves[row].T, color=BEFORE, lw=1.4, ls=_DASHED)
            for q in np.quantile(values[:, row], [0.025, 0.975]):
                axes.axvline(q, color=GREY, lw=0.7, ls=(0, (2, 2)))
            axes.set(ylim=(0, 1.15 * max([density.max(), *curves[row][:, 1]])), yticks=[])
            axes.spines["left"].set_visible(False)
        else:
            _draw_pair(axes, values[:, [column, row]])
            for ellipse in _push_ellipses(posterior.target, column, row):
                axes.plot(*ellipse.T, color=BEFORE, lw=1.2, ls=_DASHED)
            axes.set_ylim(*spans[row])
            _set_ticks(axes.yaxis, ticks)
        axes.tick_params(labelsize=small, labelbottom=lowest, labelleft=column == 0 < row)
        axes.spines["bottom"].set_color(GREY if lowest else PALE)
        if lowest:
            axes.tick_params(axis="x", labelrotation=0 if count <= 3 else 40)
            axes.set_xlabel(_label(posterior, column, wide), fontsize=font)
        if column == 0 < row:
            axes.set_ylabel(_label(posterior, row, wide), fontsize=font)
    head_figure(figure, [key_band(KIN, None, edgecolor=AFTER, lw=None), key_line(BEFORE, 1.4, ls=_DASHED)],
                ["draws; contours contain 68 and 95 %" if count > 1 else "draws", "Gaussian of the fit"])
    return figure


@styled
def draw_traces(posterior: Posterior, count: int = 600):
    """The way of every parameter through the steps: mean of each ensemble's walkers, and the range of 90 % of them.

    At most `count` steps are drawn.

    Raises:
        TypeError: It is no posterior.
    """
    if not isinstance(posterior, Posterior):
        raise TypeError(f"draw_traces draws the chains of what dd.sample returned, not a {type(posterior).__name__}; "
                        "the traces of a comparison are drawn by dd.figures.draw_fit({name: comparison.traces})")
    ensembles, steps, walkers, _ = posterior.x.shape
    every = max(1, steps // count)
    values = posterior.target.publish(posterior.x[:, ::every])
    along = np.arange(0, steps, every)
    names = posterior.target.names[:_MOST]
    figure = new_figure(0.75 + 1.0 * len(names), gap=0.03)
    panels = figure.subplots(len(names), 1, squeeze=False, sharex=True).ravel()
    shades = SHADES[:ensembles]
    for k, axes in enumerate(panels):
        dress(axes)
        for own, shade in zip(values[..., k], shades, strict=False):
            if walkers > 1:
                axes.fill_between(along, *np.quantile(own, [0.05, 0.95], axis=1), color=shade, alpha=0.10, lw=0)
            axes.plot(along, own.mean(axis=1), color=shade, lw=0.9)
        axes.set_ylabel(_label(posterior, k), rotation=0, ha="right", va="center", labelpad=8)
        _set_ticks(axes.yaxis, 3)
    panels[-1].set(xlabel="step after the burn-in", xlim=(0, max(steps - 1, 1)))
    word = "ensemble" if walkers > 1 else "chain"
    labels = [f"{word} {e + 1}" for e in range(len(shades))]
    labels[0] += ": mean of its walkers, central 90 % shaded" if walkers > 1 else ""
    head_figure(figure, list(map(key_line, shades)), labels)
    return figure


@styled
def draw_ranks(posterior: Posterior, bins: int = 20):
    """Ranks of each ensemble's draws among all: even where the ensembles agree; the band holds 99 % of even bins."""
    ensembles, _, walkers, _ = posterior.x.shape
    names = posterior.target.names[:_MOST]
    columns = min(len(names), 2 if len(names) < 5 else 3)
    rows = -(-len(names) // columns)
    figure = new_figure(0.9 + 1.35 * rows, gap=0.04)
    panels = figure.subplots(rows, columns, squeeze=False, sharex=True).ravel()
    shades, edges = SHADES[:ensembles], np.linspace(0, 1, bins + 1)
    for axes in panels[len(names) :]:
        axes.set_axis_off()
    for k, axes in enumerate(panels[: len(names)]):
        dress(axes, "", xlim=(0, 1), title=_label(posterior, k).replace("\n", " "))
        flat = posterior.x[..., k].reshape(ensembles, -1)
        ranks = stats.rankdata(flat, axis=None).reshape(flat.shape) / flat.size
        independent = max(float(posterior.convergence.sizes[k]) / ensembles, 1.0)
        width = stats.norm.ppf(0.995) * math.sqrt((bins - 1) / independent)
        axes.axhspan(1 - width, 1 + width, color=FLOOR, alpha=0.18, lw=0)
        axes.axhline(1, color=GREY, lw=0.8)
        for own, shade in zip(ranks, shades, strict=False):
            axes.stairs(np.histogram(own, edges)[0] * bins / own.size, edges, color=shade, lw=1.3, baseline=None)
        reach = max(1.3 * width, 0.1)
        low, high = axes.get_ylim()
        axes.set_ylim(max(min(low, 1 - reach), 0), max(high, 1 + reach))
        if k % columns == 0:
            axes.set_ylabel("share / even")
        if k >= len(names) - columns:
            axes.set_xlabel("rank among all draws")
            axes.tick_params(labelbottom=True)
        _set_ticks(axes.yaxis, 4)
    word = "ensemble" if walkers > 1 else "chain"
    head_figure(figure, [*map(key_line, shades), key_band(lw=None)],
                [*(f"{word} {e + 1}" for e in range(len(shades))), "99 % band of uniform ranks"])
    return figure


@styled
def draw_predictive(checks: Checks, family: str = DEFAULT_FAMILY, count: int = 4):
    """p-values of every record, and for a few of them what was measured beside what the model would make.

    Args:
        checks: of the posterior.
        family: of the records.
        count: of records whose replicates are drawn.
    """
    records, own = checks.records, checks.replicates
    height = 1.75 * (len(own.channels) if own.are_values else -(-min(count, len(records)) // 2))
    figure = new_figure(2.7 + height)
    above, below = figure.subfigures(2, 1, height_ratios=(2.3, height + 0.4))
    axes = dress(above.add_subplot(), yscale="log", ylim=(_LEAST / 3, 1.6), xlim=(-0.7, len(records) - 0.3),
                 ylabel="p-value of a replicate")
    marks = {name: _MARKS[name] for name in records[0].p_values}
    for name, (mark, colour) in marks.items():
        axes.scatter(np.arange(len(records)), [max(one.p_values[name], _LEAST) for one in records], s=20, marker=mark,
                     color=colour, alpha=0.85, lw=0, zorder=3)
    axes.axhspan(_LEAST / 3, LEVEL / (2 * len(marks) * len(records)), color=FLOOR, alpha=0.18, lw=0)
    axes.set_yticks([1, 1e-2, 1e-4, 1e-6, _LEAST], ["1", "0.01", "1e−4", "1e−6", "≤ 1e−7"])
    axes.minorticks_off()
    short = shorten_names((one.record for one in records), 14)
    name_ticks(axes, [short[str(one.record)] for one in records], WIDTH - 1.2, 8)
    # Measured minus the mean of the replicates, over their range: for the strangest records, and some that are not.
    order = np.argsort([min(one.p_values.values()) for one in records])
    wanted = [*order[: -(-count // 2)], *order[-(count // 2):]] if len(order) > count else order
    chosen = sorted(int(g) for g in wanted)
    names = vary(one.conditions for one in records)
    short = shorten_names((one.record for one in records), 20)
    shown = describe_quantity(own.channels[0], unit="")
    told = [*(STATISTICS[name] for name in marks), "stands out individually", "measured", "90 % of replicates"]
    if own.are_values:
        handles = _draw_values(below, own, [short[str(one.record)] for one in records], (0.05, 0.95), less=True)
        head_figure(figure, [*(key_dot(colour, 5, mark) for mark, colour in marks.values()), key_band(lw=None),
                             *handles], told)
        return figure
    for axes, g, x, measured, values in _lay_out(below, own, family, chosen,
                                                 f"measured − model\n[{shown.unit or '–'}]"):
        middle = values.mean(axis=0)
        band = np.quantile(values - middle, [0.05, 0.95], axis=0) * shown.scale
        if len(x) >= 15:  # quantiles of a few replicates are rough
            band = ndimage.uniform_filter1d(band, 5, mode="nearest")
        axes.fill_between(x, *band, color=KIN, alpha=0.5, lw=0)
        axes.plot(x, (measured - middle) * shown.scale, color=INK, lw=0.7)
        axes.axhline(0, color=PALE, lw=0.8, zorder=1)
        record = records[g]
        title = f"{short[str(record.record)]}   {describe_conditions(record.conditions, names)}"
        axes.set_title(wrap_text(title, WIDTH / 2 - 0.8, 9), fontsize=9)
    head_figure(figure, [*(key_dot(colour, 5, mark) for mark, colour in marks.values()), key_band(lw=None),
                         key_line(INK, 1.0), key_band(KIN, 0.5, lw=None)], told)
    return figure


@styled
def draw_prior_predictive(replicates: Replicates, family: str = DEFAULT_FAMILY, count: int = 4):
    """Records that the priors alone expect, as bands that hold 50 and 95 % of them, and what was measured.

    Args:
        replicates: drawn from the priors.
        family: of the records.
        count: of records that are drawn, spread over the campaign.
    """
    words = ["measured", "50 % of the records that the priors expect", "95 %"]
    if replicates.are_values:
        figure = new_figure(0.6 + 1.75 * len(replicates.channels))
        places = [str(k + 1) for k in range(len(replicates.time))]
        head_figure(figure, _draw_values(figure, replicates, places, (0.25, 0.75), (0.025, 0.975)), words)
        figure.axes[-1].set_xlabel("record, in the order of the campaign")
        return figure
    chosen = np.unique(np.linspace(0, len(replicates.time) - 1, min(count, len(replicates.time))).astype(int))
    figure = new_figure(0.6 + 1.75 * -(-len(chosen) // 2))
    shown = describe_quantity(replicates.channels[0], unit="")
    for axes, _, x, measured, values in _lay_out(figure, replicates, family, chosen.tolist(), shown.label):
        low, below, above, high = np.quantile(values * shown.scale, [0.025, 0.25, 0.75, 0.975], axis=0)
        axes.fill_between(x, low, high, color=KIN, alpha=0.35, lw=0)
        axes.fill_between(x, below, above, color=KIN, alpha=0.7, lw=0)
        axes.plot(x, measured * shown.scale, color=INK, lw=1.0)
    head_figure(figure, [key_line(INK, 1.0), key_band(KIN, 0.7, lw=None), key_band(KIN, 0.35, lw=None)], words)
    return figure


@styled
def draw_left_out(scores: Sequence[Scores], names: Sequence[str] = ()):
    """Logarithm of the predictive density of the records of every condition, left out; of one or more models.

    Args:
        scores: of the models, the best first, from which others are drawn as differences.
        names: of the models.
    """
    first = scores[0]
    varying = vary(one.conditions for one in first.scores)
    labels = [describe_conditions(one.conditions, varying) or clean(", ".join(one.records), 20) for one in first.scores]
    figure = new_figure(1.2 + 0.235 * len(labels))
    axes = dress_rows(figure.add_subplot(), labels, fontsize=8.5 if len(labels) <= 24 else 7)
    drawn, label = [(one.values, one, shade) for one, shade in zip(scores, SHADES, strict=False)], ""
    if len(scores) > 1:
        axes.axvline(0, color=SHADES[0], lw=1.4)
        drawn = [(values - first.values, one, shade) for values, one, shade in drawn[1:]]
        label = ", minus that of the first model"
    for values, one, shade in drawn:
        axes.scatter(values, range(len(labels)), s=34, edgecolor=shade, zorder=3,
                     facecolor=[shade if score.trusted else "white" for score in one.scores])
    axes.set_xlabel(f"logarithm of the predictive density{label}")
    handles = [key_dot(shade, 6) for _, shade in zip(scores, SHADES, strict=False)]
    words = [clean(name, 40) for name in names][: len(handles)] or ["left-out condition"]
    if any(not score.trusted for one in scores for score in one.scores):
        handles.append(key_dot(GREY, 6, mfc="white"))
        words.append("unreliable importance weights")
    head_figure(figure, handles, words)
    return figure


def _lay_out(place, own: Replicates, family: str, chosen: Sequence[int], label: str) -> Iterator[tuple[Any, ...]]:
    """Panels of some records, two a row: axes, number of the record, places in the unit of their axis, what was
    measured there, and the replicates of it."""
    panels = place.subplots(-(-len(chosen) // 2), 2 if len(chosen) > 1 else 1, squeeze=False).ravel()
    for axes in panels[len(chosen):]:
        axes.set_axis_off()
    for k, (axes, g) in enumerate(zip(panels, chosen, strict=False)):
        good = np.isfinite(own.measured[g, 0])
        along = describe_quantity(find_family(family).independent, own.time[g])
        dress(axes).margins(x=0)
        if k % 2 == 0:
            axes.set_ylabel(label, fontsize=8.5)
        if k >= len(chosen) - 2:
            axes.set_xlabel(along.label)
        yield axes, g, own.time[g][good] * along.scale, own.measured[g, 0, good], own.values[:, g, 0][:, good]


def _draw_values(place, own: Replicates, names: Sequence[str], *ranges: tuple[float, float], less: bool = False
                 ) -> list[Any]:
    """One value a record and what replicates of it spread over, a panel a channel; returns the keys of both.

    Args:
        place: figure or part of one.
        own: replicates of single values.
        names: of the records, below the axis.
        ranges: quantiles between which bars are drawn, the narrowest first.
        less: whether the mean of the replicates is taken off.
    """
    strengths = np.linspace(0.7, 0.35, len(ranges)) if len(ranges) > 1 else (0.5,)
    panels = place.subplots(len(own.channels), 1, squeeze=False).ravel()
    for c, (axes, channel) in enumerate(zip(panels, own.channels, strict=True)):
        place_of = np.isfinite(own.measured[:, c]).argmax(axis=1)[:, None]  # a record may lack one of the values
        measured = np.take_along_axis(own.measured[:, c], place_of, axis=1)[:, 0]
        values = np.take_along_axis(own.values[:, :, c], place_of[None], axis=2)[..., 0]
        shown, middle = describe_quantity(channel, unit=""), values.mean(axis=0) * less
        dress(axes).set_xlim(-0.7, len(names) - 0.3)
        axes.use_sticky_edges = False  # else the lowest bar would stand on the axis, and seem to go on below
        for (low, high), strength in reversed(list(zip(ranges, strengths, strict=True))):
            ends = (np.quantile(values, [low, high], axis=0) - middle) * shown.scale
            axes.bar(np.arange(len(names)), ends[1] - ends[0], 0.6, ends[0], color=KIN, alpha=strength, lw=0)
        axes.plot((measured - middle) * shown.scale, "o", color=INK, ms=4, zorder=3)
        if less:
            axes.axhline(0, color=PALE, lw=0.8, zorder=1)
        axes.set_ylabel(f"{shown.name}\n{'measured − model ' if less else ''}[{shown.unit or '–'}]", fontsize=8.5)
        name_ticks(axes, names, WIDTH - 1.2, 8)
    return [key_dot(INK, 4), *(key_band(KIN, strength, lw=None) for strength in strengths)]


def _push_marginal(target: AbstractTarget, k: int) -> np.ndarray:
    """The fit's Gaussian of one parameter in its public unit: values and their density, shape (points, 2)."""
    sd = math.sqrt(target.covariance[k, k])
    x = np.repeat(target.centre[None], 401, axis=0)
    steps = np.linspace(-4, 4, len(x))
    x[:, k] += sd * steps
    value = target.publish(x)[:, k]
    slope = np.abs(np.gradient(value, x[:, k]))
    density = np.exp(-0.5 * steps**2) / (sd * math.sqrt(2 * math.pi)) / np.maximum(slope, 1e-300)
    good = np.isfinite(value) & np.isfinite(density)
    good &= (x[:, k] >= target.low[k]) & (x[:, k] <= target.high[k])
    return np.stack([value[good], density[good]], axis=1)


def _push_ellipses(target: AbstractTarget, i: int, j: int) -> list[np.ndarray]:
    """Where the fit's Gaussian of two parameters holds 68 and 95 %, in public units, each shape (points, 2)."""
    own = target.covariance[np.ix_([i, j], [i, j])]
    scale = np.sqrt(np.diag(own))
    factor = scale[:, None] * np.linalg.cholesky(own / np.outer(scale, scale) + 1e-12 * np.eye(2))
    angle = np.linspace(0, 2 * np.pi, 121)
    found = []
    for mass in _MASSES:
        x = np.repeat(target.centre[None], len(angle), axis=0)
        x[:, [i, j]] += math.sqrt(-2 * math.log1p(-mass)) * (factor @ np.stack([np.cos(angle), np.sin(angle)])).T
        found.append(target.publish(np.clip(x, target.low, target.high))[:, [i, j]])
    return found


def _span(values: np.ndarray, curve: np.ndarray) -> tuple[float, float]:
    """From where to where a parameter is drawn: the draws, and the Gaussian unless it is much wider."""
    low, high = (float(q) for q in np.quantile(values, [0.001, 0.999]))
    room = high - low
    seen = curve[curve[:, 1] > 0.02 * curve[:, 1].max(), 0] if len(curve) else np.array([low, high])
    low, high = min(low, max(float(seen.min()), low - room)), max(high, min(float(seen.max()), high + room))
    pad = 0.05 * (high - low) or 1e-9 * max(abs(low), 1.0)
    return low - pad, high + pad


def _draw_pair(axes, values: np.ndarray) -> None:
    """Contours of the density of two parameters, shape (draws, 2).

    It is smoothed along the principal axes: along the parameters, a thin ridge would be drawn too wide.
    """
    mean, scale = values.mean(axis=0), np.maximum(values.std(axis=0), 1e-300)
    factor = scale[:, None] * np.linalg.cholesky(np.corrcoef(values.T) + 1e-9 * np.eye(2))
    round_ = np.linalg.solve(factor, (values - mean).T)
    reach = np.maximum(np.quantile(np.abs(round_), 0.999, axis=1), 3.2) + 0.4
    edges = [np.linspace(-r, r, 41) for r in reach]
    density = np.histogram2d(*round_, bins=edges)[0]
    density = ndimage.gaussian_filter(density, 1.8, mode="reflect", radius=6)
    # Densities above which 95 and 68 % lie; where they cannot be told apart, nothing is drawn.
    ordered = np.sort(density.ravel())[::-1]
    levels = ordered[np.searchsorted(np.cumsum(ordered), np.array(_MASSES[::-1]) * ordered.sum())]
    if not levels[1] > levels[0] > 0:
        return
    grid = np.stack(np.meshgrid(*(0.5 * (e[1:] + e[:-1]) for e in edges), indexing="ij"))
    x, y = mean[:, None, None] + np.einsum("ij,jkl->ikl", factor, grid)
    axes.contourf(x, y, density, levels=[*levels, np.inf], colors=[KIN, AFTER], alpha=0.35)
    axes.contour(x, y, density, levels=levels, colors=AFTER, linewidths=0.9)


def _set_ticks(axis, count: int) -> None:
    axis.set_major_locator(MaxNLocator(count, steps=STEPS, prune="both" if count < 4 else None))


def _label(posterior: Posterior, k: int, width: int = 24) -> str:
    """A parameter's name with its unit, the effect in lines of its own."""
    name, unit = posterior.target.names[k], posterior.target.units[k]
    effect, _, own = clean(name, 50).rpartition(".")
    own = (own if effect else own.replace("_", " ")) + (f" [{clean(unit, 14)}]" if unit not in ("", "1") else "")
    return "\n".join([*textwrap.wrap(effect, width), *textwrap.wrap(own, width)])
