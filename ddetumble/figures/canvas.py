"""Drawing as matplotlib does it, without computing anew what has not changed since.

To lay a figure out and to draw it, matplotlib works out the ticks of an axis some ten times, builds each of them from
nothing, and for every text reads the tables of its font. Nothing of that changes while a figure is drawn but the places
of its axes. This reaches into matplotlib, so that releases with which it has not been compared pixel by pixel draw
plainly.
"""

import copy
import math
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

import matplotlib
import numpy as np
from matplotlib import ft2font
from matplotlib.axis import XTick, YTick
from matplotlib.backends.backend_agg import FigureCanvasAgg, RendererAgg, get_hinting_flag
from matplotlib.font_manager import fontManager, get_font


KNOWN = ((3, 11),)  # releases of matplotlib whose pictures are the same with and without what is remembered
_PARTS = ("tick1line", "tick2line", "gridline", "label1", "label2")  # of a tick


class _Renderer(RendererAgg):
    """A renderer of matplotlib that reads the heights of a font once, and turns all glyphs of a line alike."""

    def __init__(self, width: float, height: float, dpi: float):
        super().__init__(width, height, dpi)
        self._heights: dict[Any, tuple[Any, Any, Any]] = {}

    def _get_font_height_metrics(self, prop) -> tuple[Any, Any, Any]:
        """Ascent, descent and gap of lines [pixel], as `Text` finds them; Nones where the font has no such tables."""
        if prop not in self._heights:
            self._heights[prop.copy()] = self._read_heights(prop)
        return self._heights[prop]

    def _read_heights(self, prop) -> tuple[Any, Any, Any]:
        manager: Any = fontManager
        font: Any = get_font(manager._find_fonts_by_props(prop))
        for name, gap, ascent, descent in (("OS/2", "sTypoLineGap", "sTypoAscender", "sTypoDescender"),
                                           ("hhea", "lineGap", "ascent", "descent")):
            table = font.get_sfnt_table(name)
            if table is not None:
                # In this order, as the last digit may decide between two pixels.
                scale = 1 / font.get_sfnt_table("head")["unitsPerEm"] * prop.get_size_in_points() * self.dpi / 72
                return table[ascent] * scale, -table[descent] * scale, table[gap] * scale
        return None, None, None

    def _draw_text_glyphs_and_boxes(self, gc, x, y, angle, glyphs, boxes):
        base: Any = super()
        if boxes or not gc.get_antialiased():
            base._draw_text_glyphs_and_boxes(gc, x, y, angle, glyphs, boxes)
            return
        cos, sin = math.cos(math.radians(angle)), math.sin(math.radians(angle))
        fonts: Any = ft2font
        flags, mode, draw = get_hinting_flag(), fonts.RenderMode.NORMAL, self._renderer.draw_text_image
        turned, matrix = 0x10000 * np.array([[cos, -sin], [sin, cos]]), {}
        for font, size, glyph, slant, extend, dx, dy in glyphs:  # dy is upwards
            if (slant, extend) not in matrix:
                matrix[slant, extend] = (turned @ [[extend, extend * slant], [0, 1]]).round().astype(int)
            font.set_size(size, self.dpi)
            font._set_transform(matrix[slant, extend], [round(0x40 * (x + dx * cos - dy * sin)),
                                                        round(0x40 * (self.height - y + dx * sin + dy * cos))])
            bitmap = font._render_glyph(glyph, flags, mode)
            pixels = bitmap.buffer
            draw(pixels, bitmap.left, int(self.height) - bitmap.top + pixels.shape[0], 0, gc)


class _Canvas(FigureCanvasAgg):
    """A canvas of matplotlib with that renderer."""

    _lastKey: Any

    def get_renderer(self) -> RendererAgg:
        """The renderer of the figure at its present size."""
        key = (*self.get_width_height(physical=True), self.figure.dpi)
        if self._lastKey != key:
            self._lastKey, self.renderer = key, _Renderer(*key)
        return self.renderer


def draw_figure(figure) -> FigureCanvasAgg:
    """The canvas of a figure that has been laid out and drawn on it."""
    if matplotlib.__version_info__[:2] not in KNOWN:
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
        return canvas
    canvas = _Canvas(figure)
    with _remember_ticks(figure):
        canvas.draw()
    return canvas


@contextmanager
def _remember_ticks(figure) -> Iterator[None]:
    """Work out ticks, and the boxes around their numbers, only where their axes have changed size or range."""
    with ExitStack() as stack:
        for axes in figure.axes:
            for axis in axes._axis_map.values():
                for name, method in _remember(axis).items():
                    setattr(axis, name, method)
                    stack.callback(delattr, axis, name)
        yield


def _remember(axis: Any) -> dict[str, Callable]:
    """What takes the place of some methods of an axis while it is drawn."""
    update, measure, make = axis._update_ticks, axis._get_ticklabel_bboxes, axis.get_major_ticks
    state: Any = None
    ticks: list = []
    boxes: Any = None

    def update_ticks() -> list:
        nonlocal state, ticks, boxes
        now = (*axis.axes.bbox.bounds, *axis.get_view_interval(), axis.get_figure(root=True).dpi)
        if state != now:
            state, ticks, boxes = now, update(), None
        return ticks

    def measure_labels(chosen, renderer):
        nonlocal boxes
        if chosen is not ticks:
            return measure(chosen, renderer)
        if boxes is None:
            boxes = measure(chosen, renderer)
        return boxes

    def make_ticks(count: int | None = None) -> list:
        first = axis.majorTicks[:1]
        if count is not None and first and type(first[0]) in (XTick, YTick):
            axis.majorTicks += [_copy_tick(first[0]) for _ in range(count - len(axis.majorTicks))]
        return make(count)

    return {"_update_ticks": update_ticks, "_get_ticklabel_bboxes": measure_labels, "get_major_ticks": make_ticks}


def _copy_tick(tick: Any) -> Any:
    """A tick that looks like another; where it stands and what it says is set afterwards."""
    new = copy.copy(tick)
    for name in _PARTS:
        part = copy.copy(getattr(tick, name))
        if hasattr(part, "_fontproperties"):
            part._fontproperties = part._fontproperties.copy()
        setattr(new, name, part)
    return new
