"""Draws from a posterior: marginals and pairs, the way of the chains, and the ranks of their ensembles."""

import math
import textwrap
from collections.abc import Callable
from typing import Any

import numpy as np

from ..measurement.quantities import clean
from ..posterior.result import Posterior
from ..posterior.target import AbstractTarget
from .style import AFTER, BEFORE, FLOOR, GREY, KIN, PALE, SHADES, WIDTH, dress, head_figure, new_figure, styled


_MASSES = (0.6827, 0.9545)  # inside the contours
_MOST = 10  # parameters of a figure
_DRAWN = 20000  # draws at most


@styled
def draw_corner(posterior: Posterior):
    """Marginals and pairs of the draws with contours of 1 and 2 sigma, the fit's Gaussian drawn over them.

    Args:
        posterior: at most its first ten parameters are drawn.

    Returns:
        A matplotlib figure.
    """
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    names = posterior.target.names[:_MOST]
    count = len(names)
    x = posterior.x.reshape(-1, posterior.x.shape[-1])
    values = posterior.target.publish(x if len(x) <= _DRAWN else posterior.draw(_DRAWN))
    curves = [_push_marginal(posterior.target, k) for k in range(count)]
    spans = [_span(values[:, k], curves[k]) for k in range(count)]
    size = WIDTH * (0.55 if count == 1 else 0.8 if count == 2 else 1.0)
    figure = new_figure(0.45 + 0.92 * size if count > 1 else 0.62 * size, size, gap=0.03)
    panels = figure.subplots(count, count, squeeze=False)
    font = 9.5 if count <= 4 else 8.5 if count <= 6 else 7.0
    wide = 24 if count <= 4 else 18 if count <= 6 else 14
    for row in range(count):
        for column in range(count):
            axes = panels[row, column]
            if column > row:
                axes.set_axis_off()
                continue
            dress(axes, grid="")
            axes.set_xlim(*spans[column])
            if row == column:
                _draw_marginal(axes, values[:, row], curves[row], spans[row])
            else:
                _draw_pair(axes, values[:, [column, row]])
                for ellipse in _push_ellipses(posterior.target, column, row):
                    axes.plot(*ellipse.T, color=BEFORE, lw=1.2, ls=(0, (4, 2)))
                axes.set_ylim(*spans[row])
            _number(axes, count, row, column)
            if row == count - 1:
                axes.set_xlabel(_label(posterior, column, wide), fontsize=font)
            if column == 0 and row > 0:
                axes.set_ylabel(_label(posterior, row, wide), fontsize=font)
    handles: list[Any] = [Patch(facecolor=KIN, edgecolor=AFTER), Line2D([], [], color=BEFORE, lw=1.4, ls=(0, (4, 2)))]
    words = ["draws; contours hold 68 and 95 %" if count > 1 else "draws", "the fit's Gaussian"]
    head_figure(figure, handles, words)
    return figure


@styled
def draw_traces(posterior: Posterior, count: int = 600):
    """The way of every parameter through the steps: mean of each ensemble's walkers, and the range of 90 % of them.

    Args:
        posterior: its draws; at most its first ten parameters are drawn.
        count: of steps at most.

    Returns:
        A matplotlib figure.
    """
    from matplotlib.lines import Line2D

    names = posterior.target.names[:_MOST]
    ensembles, steps, walkers, _ = posterior.x.shape
    every = max(1, steps // count)
    values = posterior.target.publish(posterior.x[:, ::every])
    along = np.arange(0, steps, every)
    figure = new_figure(0.75 + 1.0 * len(names), WIDTH, gap=0.03)
    panels = figure.subplots(len(names), 1, squeeze=False, sharex=True).ravel()
    shades = SHADES[:ensembles]
    for k, axes in enumerate(panels):
        dress(axes)
        for e in range(len(shades)):
            own = values[e, :, :, k]
            if walkers > 1:
                low, high = np.quantile(own, [0.05, 0.95], axis=1)
                axes.fill_between(along, low, high, color=shades[e], alpha=0.10, lw=0)
            axes.plot(along, own.mean(axis=1), color=shades[e], lw=0.9)
        axes.set_ylabel(_label(posterior, k), rotation=0, ha="right", va="center", labelpad=8)
        _few(axes.yaxis, 3)
    panels[-1].set_xlabel("step after the burn-in")
    panels[-1].set_xlim(0, max(steps - 1, 1))
    word = "ensemble" if walkers > 1 else "chain"
    what = f"{word} {{}}: mean of its walkers, 90 % of them shaded" if walkers > 1 else "chain {}"
    labels = [what.format(1), *(f"{word} {e + 1}" for e in range(1, len(shades)))]
    head_figure(figure, [Line2D([], [], color=shade, lw=1.6) for shade in shades], labels)
    return figure


@styled
def draw_ranks(posterior: Posterior, bins: int = 20):
    """Ranks of each ensemble's draws among all: even where the ensembles agree; the band holds 99 % of even bins.

    Args:
        posterior: its draws; at most its first ten parameters are drawn.
        bins: of ranks.

    Returns:
        A matplotlib figure.
    """
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch
    from scipy import stats

    names = posterior.target.names[:_MOST]
    ensembles = posterior.x.shape[0]
    columns = min(len(names), 2 if len(names) < 5 else 3)
    rows = -(-len(names) // columns)
    figure = new_figure(0.9 + 1.35 * rows, WIDTH, gap=0.04)
    panels = figure.subplots(rows, columns, squeeze=False, sharex=True).ravel()
    shades = SHADES[:ensembles]
    for k, axes in enumerate(panels):
        if k >= len(names):
            axes.set_axis_off()
            continue
        dress(axes, grid="")
        flat = posterior.x[..., k].reshape(ensembles, -1)
        ranks = stats.rankdata(flat, axis=None).reshape(flat.shape) / flat.size
        independent = max(float(posterior.convergence.sizes[k]) / ensembles, 1.0)
        width = stats.norm.ppf(0.995) * math.sqrt((bins - 1) / independent)
        axes.axhspan(1 - width, 1 + width, color=FLOOR, alpha=0.18, lw=0)
        axes.axhline(1, color=GREY, lw=0.8)
        edges = np.linspace(0, 1, bins + 1)
        for e, shade in enumerate(shades):
            share = np.histogram(ranks[e], bins=edges)[0] * bins / flat.shape[1]
            axes.stairs(share, edges, color=shade, lw=1.3, baseline=None)
        reach = max(1.3 * width, 0.1)
        low, high = axes.get_ylim()
        axes.set_ylim(max(min(low, 1 - reach), 0), max(high, 1 + reach))
        axes.set_xlim(0, 1)
        axes.set_title(_label(posterior, k).replace("\n", " "))
        if k % columns == 0:
            axes.set_ylabel("share / even")
        if k >= len(names) - columns:
            axes.set_xlabel("rank among all draws")
            axes.tick_params(labelbottom=True)
        _few(axes.yaxis, 4)
    word = "ensemble" if posterior.x.shape[2] > 1 else "chain"
    handles: list[Any] = [Line2D([], [], color=shade, lw=1.6) for shade in shades]
    handles.append(Patch(facecolor=FLOOR, alpha=0.35))
    head_figure(figure, handles, [*(f"{word} {e + 1}" for e in range(len(shades))), "99 % of even draws"])
    return figure


def _push_marginal(target: AbstractTarget, k: int) -> np.ndarray:
    """The fit's Gaussian of one parameter in its public unit: values and their density, shape (points, 2)."""
    push, centre, covariance = _fit_gaussian(target)
    sd = math.sqrt(covariance[k, k])
    x = np.repeat(centre[None], 401, axis=0)
    steps = np.linspace(-4, 4, len(x))
    x[:, k] += sd * steps
    value = push(x)[:, k]
    slope = np.abs(np.gradient(value, x[:, k]))
    density = np.exp(-0.5 * steps**2) / (sd * math.sqrt(2 * math.pi)) / np.maximum(slope, 1e-300)
    good = np.isfinite(value) & np.isfinite(density)
    if push == target.publish:
        good &= (x[:, k] >= target.low[k]) & (x[:, k] <= target.high[k])
    return np.stack([value[good], density[good]], axis=1)


def _push_ellipses(target: AbstractTarget, i: int, j: int) -> list[np.ndarray]:
    """Where the fit's Gaussian of two parameters holds 68 and 95 %, in public units, each shape (points, 2)."""
    push, centre, covariance = _fit_gaussian(target)
    own = covariance[np.ix_([i, j], [i, j])]
    scale = np.sqrt(np.diag(own))
    factor = scale[:, None] * np.linalg.cholesky(own / np.outer(scale, scale) + 1e-12 * np.eye(2))
    angle = np.linspace(0, 2 * np.pi, 121)
    found = []
    for mass in _MASSES:
        x = np.repeat(centre[None], len(angle), axis=0)
        x[:, [i, j]] += math.sqrt(-2 * math.log1p(-mass)) * (factor @ np.stack([np.cos(angle), np.sin(angle)])).T
        if push == target.publish:
            x = np.clip(x, target.low, target.high)
        found.append(push(x)[:, [i, j]])
    return found


def _fit_gaussian(target: AbstractTarget) -> tuple[Callable[[np.ndarray], np.ndarray], np.ndarray, np.ndarray]:
    """The fit's Gaussian and the function that publishes its draws: where every coordinate gives one public value, in
    coordinates; where several do, in public units by the slope, as the fit's own errors are."""
    slope = target.slope()
    parts = np.abs(slope) * np.sqrt(np.diag(target.covariance))  # of every public value's deviation
    if np.all(parts.sum(axis=1) - np.diag(parts) <= 1e-6 * np.diag(parts)):
        return target.publish, target.centre, target.covariance
    return np.asarray, target.publish(target.centre), slope @ target.covariance @ slope.T


def _span(values: np.ndarray, curve: np.ndarray) -> tuple[float, float]:
    """From where to where a parameter is drawn: the draws, and the Gaussian unless it is much wider."""
    low, high = (float(q) for q in np.quantile(values, [0.001, 0.999]))
    room = high - low
    seen = curve[curve[:, 1] > 0.02 * curve[:, 1].max(), 0] if len(curve) else np.array([low, high])
    low, high = min(low, max(float(seen.min()), low - room)), max(high, min(float(seen.max()), high + room))
    pad = 0.05 * (high - low) or 1e-9 * max(abs(low), 1.0)
    return low - pad, high + pad


def _draw_marginal(axes, values: np.ndarray, curve: np.ndarray, span: tuple[float, float]) -> None:
    edges = np.linspace(*span, 33)
    density = np.histogram(values, bins=edges, density=True)[0]
    axes.stairs(density, edges, fill=True, color=KIN, alpha=0.6)
    axes.stairs(density, edges, color=AFTER, lw=1.0)
    axes.plot(*curve.T, color=BEFORE, lw=1.4, ls=(0, (4, 2)))
    for q in np.quantile(values, [0.025, 0.975]):
        axes.axvline(q, color=GREY, lw=0.7, ls=(0, (2, 2)))
    axes.set_ylim(0, 1.15 * max([density.max(), *curve[:, 1]]))
    axes.set_yticks([])
    axes.spines["left"].set_visible(False)


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
    for axis in (0, 1):
        density = np.apply_along_axis(_smooth, axis, density, 1.8)
    levels = _find_levels(density)
    if levels is None:
        return
    grid = np.stack(np.meshgrid(*(0.5 * (e[1:] + e[:-1]) for e in edges), indexing="ij"))
    x, y = mean[:, None, None] + np.einsum("ij,jkl->ikl", factor, grid)
    axes.contourf(x, y, density, levels=[*levels, np.inf], colors=[KIN, AFTER], alpha=0.35)
    axes.contour(x, y, density, levels=levels, colors=AFTER, linewidths=0.9)


def _find_levels(density: np.ndarray) -> list[float] | None:
    """Densities above which 95 and 68 % lie; None where they cannot be told apart."""
    ordered = np.sort(density.ravel())[::-1]
    total = np.cumsum(ordered)
    if not total[-1] > 0:
        return None
    levels = [float(ordered[np.searchsorted(total, mass * total[-1])]) for mass in reversed(_MASSES)]
    return levels if levels[1] > levels[0] > 0 else None


def _smooth(values: np.ndarray, width: float) -> np.ndarray:
    reach = np.arange(-6, 7)
    kernel = np.exp(-0.5 * (reach / width) ** 2)
    padded = np.pad(values, 6, mode="symmetric")
    return np.convolve(padded, kernel / kernel.sum(), mode="valid")


def _number(axes, count: int, row: int, column: int) -> None:
    """Few ticks, and numbers at the outer panels only."""
    ticks = 4 if count <= 3 else 3 if count <= 6 else 2
    _few(axes.xaxis, ticks)
    if row != column:
        _few(axes.yaxis, ticks)
    small = 8.5 if count <= 4 else 7.5 if count <= 6 else 6.5
    axes.tick_params(labelsize=small, labelbottom=row == count - 1, labelleft=column == 0 and row > 0)
    if row == count - 1:
        axes.tick_params(axis="x", labelrotation=0 if count <= 3 else 40)
    axes.spines["bottom"].set_color(PALE if row < count - 1 else GREY)


def _few(axis, count: int) -> None:
    from matplotlib.ticker import MaxNLocator

    axis.set_major_locator(MaxNLocator(count, steps=[1, 2, 2.5, 5, 10], prune="both" if count < 4 else None))


def _label(posterior: Posterior, k: int, width: int = 24) -> str:
    """A parameter's name with its unit, the effect in lines of its own."""
    name, unit = posterior.target.names[k], posterior.target.units[k]
    effect, _, own = clean(name, 50).rpartition(".")
    own = (own if effect else own.replace("_", " ")) + (f" [{clean(unit, 14)}]" if unit not in ("", "1") else "")
    return "\n".join([*textwrap.wrap(effect, width), *textwrap.wrap(own, width)])
