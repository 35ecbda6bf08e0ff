"""The missing force: how much of the misfit it removes, what it looks like over its variable, and its spectrum."""

import math

import numpy as np

from ..measurement.quantities import clean, describe_quantity, format_number, format_share, typeset
from ..selection.missing.symbolic import sketch_law
from ..selection.result import Law, MissingForce, Shape
from .palette import AFTER, BEFORE, FLOOR, GREY, INK, KIN, MORE, OTHER, PALE, PLACE
from .style import NARROW, WIDTH, dress, head_figure, key_band, new_figure, styled


_COLOURS = (AFTER, BEFORE, MORE[0])
# Share of an even spread of samples below which a place counts as not visited: a sample in fifty of the usual.
_SEEN = 0.02


@styled
def draw_missing_shape(missing: MissingForce, narrow: bool = False):
    """The ceiling as bars, the best shape with its band and the simple laws on it, and its spectrum.

    Args:
        missing: of `draw_missing_force` or `discover`, with at least one shape.
    """
    best = missing.shapes[0]
    spectrum = best.spectrum.shape[1] > 2
    if narrow:
        figure = new_figure(8.4 if spectrum else 6.2, NARROW)
        grid = figure.add_gridspec(2 + spectrum, 1, height_ratios=(1.7, 1.0, 1.0)[: 2 + spectrum])
        places = [grid[k] for k in range(2 + spectrum)]
    else:
        figure = new_figure(5.6)
        grid = figure.add_gridspec(2, 2, width_ratios=(1.75, 1.0))
        places = [grid[:, 0], grid[0, 1], grid[1, 1]] if spectrum else [grid[:, 0], grid[:, 1]]
    handles, labels = _draw_curves(figure.add_subplot(places[0]), best, next(iter(missing.laws), None))
    _draw_bars(figure.add_subplot(places[1]), missing)
    if spectrum:
        _draw_spectrum(figure.add_subplot(places[2]), best)
    head_figure(figure, handles, labels)
    return figure


@styled
def draw_missing_rivals(missing: MissingForce, narrow: bool = False):
    """The missing force over every variable that was fitted to the end, best first, each with its held-out loss."""
    shapes = missing.shapes[:4]
    columns = min(2, len(shapes)) if narrow else len(shapes)
    rows = math.ceil(len(shapes) / columns)
    figure = new_figure(3.0 * rows, NARROW if narrow else WIDTH)
    for k, shape in enumerate(shapes):
        axes = figure.add_subplot(rows, columns, k + 1)
        _draw_curves(axes, shape)
        axes.set_title(f"{clean(shape.way, 24)}: {f'{format_number(shape.difference)} worse' if k else 'best'}")
    return figure


def _draw_curves(axes, shape: Shape, law: Law | None = None):
    """Curves of a shape with their bands, where it was visited, and a simple law; returns handles and labels."""
    shown = describe_quantity(shape.variable, shape.x)
    factor, unit = _scale(shape)
    x, handles, labels = shown.scale * shape.x, [], []
    label = f"missing {clean(shape.way, 24)}"
    dress(axes, xlabel=shown.label, ylabel=f"{label} [{unit}]" if unit else label, xlim=(x[0], x[-1]))
    axes.axhline(0, color=FLOOR, lw=0.8)
    visited = np.flatnonzero(shape.visited >= _SEEN / len(x))
    seen = slice(visited[0], visited[-1] + 1) if visited.size else slice(None)
    for k, (part, f, sd) in enumerate(zip(shape.parts, shape.values, shape.sd, strict=True)):
        colour = _COLOURS[k % len(_COLOURS)]
        low, high = factor * (f - 2 * sd), factor * (f + 2 * sd)
        axes.fill_between(x, low, high, color=colour, alpha=0.2, lw=0)
        line, = axes.plot(x[seen], factor * f[seen], color=colour, lw=1.8)
        handles.append(line)
        labels.append(clean(part, 20) or "non-parametric force, ± 2 sd")
        values = None if law is None else sketch_law(law, shape, k)
        if law is None or values is None:
            continue
        # Elsewhere the law holds beside other values of the model's own parameters, which one picture cannot show.
        near = np.abs(values - f)[seen] <= 3.0 * sd[seen] + 0.05 * np.abs(f[seen]).max()
        if np.mean(near) > 0.9:
            drawn, = axes.plot(x[seen], factor * values[seen], color=INK, lw=1.2, ls="--")
            if k == 0:
                handles.append(drawn)
                labels.append(typeset(clean(law.text, 70)))
    if shape.begins is not None:
        axes.axvspan(shown.scale * shape.begins, x[-1], color=PLACE, lw=0, zorder=0)
        handles.append(key_band(PLACE, None))
        labels.append(f"differs from zero from {shown.format(shape.begins)} {shown.unit}".rstrip())
    top = shape.visited / max(shape.visited.max(), 1e-300)
    axes.fill_between(x, 0, 0.06 * top, step="mid", color=PALE, lw=0, transform=axes.get_xaxis_transform(), zorder=0)
    return handles, labels


def _scale(shape: Shape) -> tuple[float, str]:
    """Factor and unit in which the values of a shape are shown."""
    if shape.unit == "1":
        return 100.0, "%"
    size = float(np.abs(shape.values).max())
    if shape.unit == "N" and size < 0.5:
        return 1e3, "mN"
    if shape.unit not in ("N", "") and 0 < size < 1e-2:
        power = int(np.floor(np.log10(size)))
        return 10.0**-power, f"1e{power} {'/s²' if shape.unit == '1/s**2' else '/s'}"
    return 1.0, "1/s²" if shape.unit == "1/s**2" else shape.unit


def _draw_bars(axes, missing: MissingForce):
    """Share of the reference model's misfit that each removes on what was left out."""
    rows = [] if missing.catalogue is None else [(f"best of the catalogue:\n{clean(missing.catalogue[0], 28)}",
                                                  missing.catalogue[1], KIN)]
    if missing.effects:
        rows.append((f"with {clean(' and '.join(missing.effects), 28)}", missing.model, OTHER))
    if missing.laws and not missing.lone:
        rows.append(("simple law", missing.laws[0].loss, GREY))
    rows.append((f"{clean(missing.shapes[0].way, 20)} over\none variable", missing.shapes[0].loss, AFTER))
    if missing.ceiling is not None:
        rows.append(("ceiling", missing.ceiling[1], INK))
    shares = [missing.share(loss) for _, loss, _ in rows]
    dress(axes, "x", xlim=(0, 118), xticks=[0, 50, 100], xlabel="share of the held-out misfit explained [%]")
    bars = axes.barh(range(len(rows)), [100 * s for s in shares], color=[colour for *_, colour in rows], height=0.6)
    axes.bar_label(bars, list(map(format_share, shares)), padding=3, fontsize=8.5)
    axes.set_yticks(range(len(rows)), [text for text, *_ in rows])
    axes.invert_yaxis()


def _draw_spectrum(axes, shape: Shape):
    """Amplitude over wave number, with two standard deviations of what noise leaves."""
    shown = describe_quantity(shape.variable, shape.x)
    factor, unit = _scale(shape)
    number, amplitude, sd = shape.spectrum
    number = number / shown.scale
    dress(axes, xlabel=f"waves per {shown.unit}" if shown.unit else "wave number", xlim=(0, number[-1]),
          ylabel=f"amplitude [{unit}]" if unit else "amplitude")
    axes.fill_between(number, 0, 2 * factor * sd, color=FLOOR, alpha=0.3, lw=0)
    axes.plot(number, factor * amplitude, color=AFTER, lw=1.4)
    k = int(np.argmax(amplitude))
    if 0 < k < len(number) - 1 and amplitude[k] > 4 * sd[k]:
        axes.annotate(f"every {1 / number[k]:.3g} {shown.unit}".rstrip(), (number[k], factor * amplitude[k]),
                      xytext=(6, -2), textcoords="offset points", fontsize=8.5)
    axes.set_ylim(0, None)
