"""The look that all figures share: colours that colour-blind readers tell apart, quiet axes, one type."""

import functools
import io
import warnings
from contextlib import contextmanager


INK = "#1b2733"
GREY = "#66727f"
PALE = "#c9d1d9"
FAINT = "#eef1f4"
BEFORE = "#d55e00"
AFTER = "#0072b2"
KIN = "#7fc0ea"
OTHER = "#a3aeb9"
FLOOR = "#8a97a5"
PLACE = "#fbedbd"
SHADES = ("#0072b2", "#009e73", "#cc79a7", "#d55e00", "#56b4e9", "#e69f00", "#7a5195", "#66727f")  # of equals
WIDTH = 10.0  # of every figure [inch]; a report shows it about 1000 pixels wide
_FONTS = ("Source Sans 3", "Helvetica Neue", "Arial", "Liberation Sans", "DejaVu Sans")


@functools.lru_cache(maxsize=1)
def _fonts() -> list[str]:
    """The wanted families that this machine has; DejaVu Sans comes with matplotlib and fills in missing glyphs."""
    from matplotlib import font_manager

    here = {font.name for font in font_manager.fontManager.ttflist}
    return [name for name in _FONTS if name in here] or ["DejaVu Sans"]


def _settings() -> dict:
    """Matplotlib settings of the house; text is never parsed as mathematics, as some of it comes from data files."""
    return {
        "font.family": "sans-serif", "font.sans-serif": _fonts(), "font.size": 9.5, "text.color": INK,
        "text.parse_math": False, "axes.unicode_minus": True, "axes.formatter.use_mathtext": False,
        "axes.formatter.useoffset": False,
        "axes.edgecolor": GREY, "axes.labelcolor": INK, "axes.labelsize": 9.5, "axes.linewidth": 0.7,
        "axes.titlesize": 9.5, "axes.titlelocation": "left", "axes.titlecolor": INK, "axes.titlepad": 5.0,
        "axes.spines.top": False, "axes.spines.right": False, "axes.grid": False, "axes.axisbelow": True,
        "grid.color": FAINT, "grid.linewidth": 0.8,
        "xtick.color": GREY, "ytick.color": GREY, "xtick.labelcolor": INK, "ytick.labelcolor": INK,
        "xtick.labelsize": 8.5, "ytick.labelsize": 8.5, "xtick.major.size": 3, "ytick.major.size": 3,
        "xtick.major.width": 0.7, "ytick.major.width": 0.7,
        "legend.frameon": False, "legend.fontsize": 9.5, "legend.handlelength": 1.6, "legend.borderaxespad": 0.2,
        "figure.facecolor": "white", "savefig.facecolor": "white", "lines.solid_capstyle": "round",
        "hatch.linewidth": 0.6,
    }  # fmt: skip


@contextmanager
def apply_style():
    """Draw or save in the house style; the user's own matplotlib settings are as before afterwards."""
    import matplotlib

    with matplotlib.rc_context(_settings()), warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph .* missing from font")
        yield


def styled(function):
    """Let a function that makes a figure do so in the house style."""

    @functools.wraps(function)
    def draw(*arguments, **options):
        with apply_style():
            return function(*arguments, **options)

    return draw


def new_figure(height: float, width: float = WIDTH, gap: float = 0.05):
    """An empty figure of that size [inch] that lays itself out, with a gap [inch] above and below its axes."""
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    return Figure(figsize=(width, height), layout=ConstrainedLayoutEngine(h_pad=gap, w_pad=0.05))


def dress(axes, grid: str = "y"):
    """Give axes the house's ticks and a faint grid along `grid` (`x`, `y`, `both` or nothing); returns the axes."""
    axes.tick_params(labelsize=8.5, labelcolor=INK, color=GREY, length=3, width=0.7)
    if grid:
        axes.grid(True, axis=grid, color=FAINT, linewidth=0.8)
    return axes


def colour_models(count: int) -> list[str]:
    """Colours of one model, or of the models before and after."""
    return [AFTER] if count == 1 else [BEFORE, AFTER][:count]


def head_figure(figure, handles, labels, columns: int = 6):
    """Put one legend above all axes, at the left."""
    legend = figure.legend(handles, labels, loc="outside upper left", ncols=columns, columnspacing=1.8)
    for text in legend.get_texts():
        text.set_parse_math(False)
    return legend


def render_png(figure, dpi: int = 160) -> bytes:
    """A figure as the bytes of a PNG file, the same bytes for the same figure."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    buffer, before = io.BytesIO(), figure.dpi
    canvas = FigureCanvasAgg(figure)
    with apply_style():
        figure.dpi = dpi
        canvas.print_png(buffer, metadata={"Software": None})  # `savefig` lays the figure out, and draws it, twice
        figure.dpi = before
    return buffer.getvalue()
