"""The look that all figures share: quiet axes, one type, keys of legends, words that fit."""

import functools
import io
import math
import textwrap
import warnings
from collections.abc import Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import matplotlib
import numpy as np
from matplotlib import font_manager
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from .palette import AFTER, BEFORE, FAINT, FLOOR, GREY, INK, MORE


if TYPE_CHECKING:
    from PIL.Image import Image as Pixels


WIDTH = 10.0  # of every figure [inch]; a report shows it about 1000 pixels wide
NARROW = 4.2  # of a figure for a telephone [inch]: about 440 pixels in a report
TICKS = 8.5  # size of the numbers along axes [point]: a size below the text's, and still legible
STEPS = (1, 2, 2.5, 5, 10)  # between numbers along axes, times a power of ten
_EM = 0.64  # mean width of a character over the size of its type, of DejaVu Sans, the widest of the fonts
_FONTS = ("Source Sans 3", "Helvetica Neue", "Arial", "Liberation Sans", "DejaVu Sans")


@functools.lru_cache(maxsize=1)
def _read_settings() -> dict:
    """Matplotlib settings of the house; text is never parsed as mathematics, as some of it comes from data files."""
    here = {font.name for font in font_manager.fontManager.ttflist}
    return {
        # DejaVu Sans comes with matplotlib and fills in missing glyphs; only families by name are asked for these.
        "font.family": [name for name in _FONTS if name in here] or ["DejaVu Sans"], "font.size": 9.5,
        "text.color": INK,
        "text.parse_math": False, "axes.unicode_minus": True, "axes.formatter.use_mathtext": False,
        "axes.formatter.useoffset": False,
        "axes.edgecolor": GREY, "axes.labelcolor": INK, "axes.labelsize": 9.5, "axes.linewidth": 0.7,
        "axes.titlesize": 9.5, "axes.titlelocation": "left", "axes.titlecolor": INK, "axes.titlepad": 5.0,
        "axes.spines.top": False, "axes.spines.right": False, "axes.grid": False, "axes.axisbelow": True,
        "grid.color": FAINT, "grid.linewidth": 0.8,
        "xtick.color": GREY, "ytick.color": GREY, "xtick.labelcolor": INK, "ytick.labelcolor": INK,
        "xtick.labelsize": TICKS, "ytick.labelsize": TICKS, "xtick.major.size": 3, "ytick.major.size": 3,
        "xtick.major.width": 0.7, "ytick.major.width": 0.7,
        "legend.frameon": False, "legend.fontsize": 9.5, "legend.handlelength": 1.6, "legend.borderaxespad": 0.2,
        "figure.facecolor": "white", "savefig.facecolor": "white", "lines.solid_capstyle": "round",
        "hatch.linewidth": 0.6,
    }  # fmt: skip


@contextmanager
def apply_style():
    """Draw or save in the house style; the user's own matplotlib settings are as before afterwards."""
    with matplotlib.rc_context(_read_settings()), warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph .* missing from font")
        yield


styled = apply_style()  # the same as a decorator of functions that make a figure


def new_figure(height: float, width: float = WIDTH, gap: float = 0.05) -> Any:
    """An empty figure of that size [inch] that lays itself out, with a gap [inch] above and below its axes."""
    # Room at the right for half of a last number, which may only appear after the layout is made.
    rect = (0.0, 0.0, 1.0 - 0.1 / width, 1.0)
    return Figure(figsize=(width, height), layout=ConstrainedLayoutEngine(h_pad=gap, w_pad=0.05, rect=rect))


def new_axes(height: float, width: float = WIDTH, grid: str = "y", columns: int = 1, **settings) -> tuple[Any, ...]:
    """A new figure of that size [inch] and its axes, one or a row of them, dressed alike."""
    figure = new_figure(height, width)
    panels = figure.subplots(1, columns, squeeze=False)[0]
    return figure, *(dress(axes, grid, **settings) for axes in panels)


def point_at(axes, text: str, place: tuple[float, float], shift: tuple[float, float], dot: float = 0.0, **options):
    """Write beside a place of the axes, shifted by so many points, and put a dot of that size there, if any."""
    if dot:
        axes.plot([place[0]], [place[1]], "o", color=options["color"], ms=dot)
    axes.annotate(text, place, shift, textcoords="offset points", **options)


def dress(axes, grid: str = "y", **settings):
    """Give axes a faint grid along `grid` (`x`, `y`, `both` or nothing); returns the axes.

    Further settings are those of `axes.set`.
    """
    if grid:
        axes.grid(True, axis=grid)
    axes.set(**settings)
    return axes


def dress_rows(axes, labels: Sequence[str], room: float = 0.4, **look):
    """Dress axes of horizontal rows, the first one on top, each with a label of that look; returns the axes."""
    dress(axes, "x")
    axes.set_yticks(range(len(labels)), labels, **look)
    axes.set_ylim(len(labels) - room, room - 1.0)
    axes.tick_params(axis="y", length=0)
    axes.spines["left"].set_visible(False)
    return axes


def strip(axes):
    """Take the frame from axes that hold an image, and the marks beside their labels."""
    axes.spines[:].set_visible(False)
    axes.tick_params(length=0)


def colour_models(count: int) -> list[str]:
    """Colours of one model, of the models before and after, or of several, the one before first."""
    return [AFTER] if count == 1 else [[BEFORE, AFTER, *MORE][k % (2 + len(MORE))] for k in range(count)]


def count_characters(width: float, size: float = 9.5) -> int:
    """How many characters of that size [point] have room in that width [inch]."""
    return int(72 * width / (_EM * size))


def wrap_text(text: str, width: float, size: float = 9.5) -> str:
    """Text in lines of at most `width` [inch] in type of that size [point]."""
    return textwrap.fill(text, max(8, count_characters(width, size)), break_on_hyphens=False)


def key_line(colour: str, width: float = 1.6, **look) -> Any:
    """A line for a legend."""
    return Line2D([], [], color=colour, lw=width, **look)


def key_dot(colour: str, size: float = 5, marker: str = "o", **look) -> Any:
    """A marker for a legend."""
    return Line2D([], [], ls="none", color=colour, ms=size, marker=marker, **look)


def key_band(colour: str | None = FLOOR, alpha: float | None = 0.35, **look) -> Any:
    """A patch for a legend."""
    return Patch(**{"facecolor": colour, "alpha": alpha, "lw": 0} | look)


def head_figure(figure, handles, labels, columns: int = 6):
    """Put one legend above all axes, at the left, in as many columns as the figure has room for."""
    room = figure.get_size_inches()[0] - 0.15
    labels = [wrap_text(label, room - 0.5) for label in labels]
    renderer = FigureCanvasAgg(figure).get_renderer()
    number = max(1, min(columns, len(labels)))
    while True:
        legend = figure.legend(handles, labels, loc="outside upper left", ncols=number, columnspacing=1.8)
        for text in legend.get_texts():
            text.set_parse_math(False)
        if number == 1 or legend.get_window_extent(renderer).width <= room * figure.dpi:
            return legend
        legend.remove()
        number -= 1


def name_ticks(axes, labels: Sequence[str], width: float, size: float = 8.5):
    """Put a word under each of the places 0, 1, ... along axes of that width [inch].

    The words stand upright where they would touch, and some are left out where even these would.
    """
    each = 72 * width / max(len(labels), 1)
    upright = max(map(len, labels), default=0) * _EM * size > 0.95 * each
    every = max(1, math.ceil(1.25 * size / each)) if upright else 1
    axes.set_xticks(range(0, len(labels), every), labels[::every], rotation=90 if upright else 0, fontsize=size)


class SpacedLocator(MaxNLocator):
    """Places of as many numbers along an x axis, at most so many, as have room beside each other where it is drawn: of
    a narrow range far from zero they are long, and fewer; where not even two have room, one stands alone.
    """

    def __init__(self, most: int = 6, **options):
        super().__init__(most, steps=STEPS, **options)
        self.most = most

    def tick_values(self, vmin: float, vmax: float) -> np.ndarray:
        """As of any locator of matplotlib."""
        axis: Any = self.axis
        room = count_characters(axis.axes.bbox.width / axis.axes.figure.dpi, axis.majorTicks[0].label1.get_fontsize())
        places = np.zeros(0)
        for count in range(self.most, 0, -1):
            self.set_params(nbins=count)
            places = np.asarray(super().tick_values(vmin, vmax))
            inside = places[(places >= min(vmin, vmax)) & (places <= max(vmin, vmax))]
            each = max(map(len, axis.get_major_formatter().format_ticks(inside)), default=0) + 1.5
            # From the middle of the first to that of the last.
            if len(inside) < 2 or (len(inside) - 1) * each <= room * np.ptp(inside) / abs(vmax - vmin):
                return places
        return places[len(places) // 2: len(places) // 2 + 1]


def render_image(figure, dpi: int = 160) -> "Pixels":
    """A figure as pixels."""
    from PIL import Image

    before, canvas = figure.dpi, FigureCanvasAgg(figure)
    with apply_style():
        figure.dpi = dpi
        canvas.draw()  # `savefig` lays the figure out, and draws it, twice
        image = Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")
        figure.dpi = before
    return image


def write_png(image: "Pixels") -> bytes:
    """An image as the bytes of a PNG file, the same bytes for the same image."""
    buffer = io.BytesIO()
    image.save(buffer, "PNG")
    return buffer.getvalue()


def render_png(figure, dpi: int = 160, few_colours: bool = False) -> bytes:
    """A figure as the bytes of a PNG file, the same bytes for the same figure; in 256 colours about half as many."""
    image = render_image(figure, dpi)
    return write_png(reduce_colours(image) if few_colours else image)


def reduce_colours(image: "Pixels") -> "Pixels":
    """The same image with 256 colours, whose file is half as large and cannot be told from it in a figure.

    Pillow's maximum coverage takes half of the time of its median cut, with a smaller largest error; its octree is
    faster still, and makes white grey.
    """
    from PIL import Image

    return image.quantize(256, method=Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
