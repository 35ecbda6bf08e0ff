"""A self-contained page: sentence first, then sections of text, figures and tables; everything is escaped."""

import base64
import dataclasses as dc
import gc
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import ContextVar
from importlib import resources
from pathlib import Path
from typing import Any

import jinja2
import markupsafe

from .._display import Progress, stay_silent
from ..figures.style import reduce_colours, render_image, write_png
from ..inference.files import write_whole
from ..measurement.quantities import clean, typeset


BUDGET = 2_700_000  # characters of all figures in a page: a page of 2 MB still goes by mail
WIDE = 104  # pixels an inch of a figure, which makes its type 13 pixels high
HEADLINE, LONGEST, SHORTEST = 110, 230, 24  # characters: one short sentence, what still reads as one, a clause
BRIEF, PHRASE = 12, 28  # characters that a column's cells keep on one line, and from which on they are sentences
_NUMBER = re.compile(r"^[-+−<>]?\s*[\d.,]+(e[-+−]?\d+)?( ?[±–-] ?[\d.]+(e[-+−]?\d+)?)?( ?%)?( \(step \d+\))?$|^–?$")


# What pages call as they are drawn. Figures are drawn in many functions, few of which anybody follows.
follower: ContextVar[Progress] = ContextVar("follower", default=stay_silent)


@dc.dataclass(frozen=True)
class Picture:
    """A figure of a page."""

    name: str  # of the PNG file, without its ending
    caption: str  # what it shows, one or two sentences
    figure: Any  # of matplotlib
    alt: str = ""  # what a reader who cannot see it should hear; the caption where it is empty
    narrow: Any = None  # the same for a telephone; without it, the figure is shrunk there, and enlarged by a tap


def draw_picture(name: str, caption: str, draw: Callable[..., Any], *arguments, alt: str = "") -> Picture:
    """A picture by a function of `ddetumble.figures`, drawn for a wide page and, `narrow`, for a telephone."""
    follower.get()(f"drawing the page: figure {name}", math.nan)
    return Picture(name, caption, draw(*arguments), alt, draw(*arguments, narrow=True))


@dc.dataclass(frozen=True)
class Table:
    """A table of a page: cells are shown as they are, numbers to the right; rows in `marked` stand out."""

    header: Sequence[str]
    rows: Sequence[Sequence[Any]]
    caption: str = ""
    marked: frozenset[int] = frozenset()


@dc.dataclass(frozen=True)
class Section:
    """A part of a page, under a heading."""

    title: str
    paragraphs: Sequence[str] = ()  # text, commands between backticks; a `markupsafe.Markup` is a block of its own
    figures: Sequence[Any] = ()  # `Picture`s, or tuples (name, caption, figure[, alt])
    tables: Sequence[Any] = ()  # `Table`s, pandas data frames, or lists of rows of which the first is the header
    points: Sequence[str] = ()  # a list of short sentences after the paragraphs


@contextmanager
def pause_collection():
    """Let no garbage be collected meanwhile: figures refer to themselves in thousands of places, and none is dropped
    before its page is written.
    """
    collecting = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collecting:
            gc.enable()


@pause_collection()
def write_page(
    title: str,
    sentence: str,
    sections: Iterable[Section],
    folder,
    name: str = "report.html",
    *,
    verdict: str = "",
    badge: str = "",
    status: Sequence[str] = (),
    facts: Sequence[tuple[str, str, str]] = (),
) -> Path:
    """Write a page that needs nothing but itself, and its figures as PNG files in `figures/` beside it.

    Args:
        title: of the page, shown by the browser.
        sentence: the first thing on the page, in plain words: its beginning as the headline, the rest below.
        sections: what follows.
        folder: where to write; made where it is not there.
        name: of the page's file.
        verdict: decides the colour (a verdict of `discover`, or nothing).
        badge: a word or two in that colour.
        status: a line of short facts below the sentence.
        facts: boxes of (what, value, remark) below that.

    Returns:
        Path of the page. Every file is written whole or not at all, the page last.

    Raises:
        InputError: The folder cannot be written.
    """
    folder = Path(folder)
    sections = [dc.replace(section, figures=[one if isinstance(one, Picture) else Picture(*one)
                                             for one in section.figures]) for section in sections]
    pictures = [picture for section in sections for picture in section.figures]
    for picture in pictures:
        if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_.-]*", picture.name):
            raise ValueError(f"{picture.name!r} is no name for a file: use letters, digits, dots, hyphens")
    tell = follower.get()

    def render(picture: Picture, narrow: bool) -> Any:
        tell(f"drawing the page: image {picture.name}{' for telephones' * narrow}", math.nan)
        return render_image(picture.narrow, 190) if narrow else render_image(picture.figure)

    # One image is packed while the next is drawn: Pillow lets other threads run.
    with ThreadPoolExecutor(1) as pool:
        files = [pool.submit(_pack, render(one, False)) for one in pictures]
        small = [None if one.narrow is None else pool.submit(_encode, render(one, True)) for one in pictures]
    packed, narrow = [one.result() for one in files], [one.result() if one else "" for one in small]
    shown = [one for _, one in packed]
    # The largest are drawn again with fewer pixels while the page would be too large.
    for dpi in (115, 85, 60):
        for i in sorted(range(len(shown)), key=lambda i: -len(shown[i])):
            if sum(map(len, (*shown, *narrow))) > BUDGET:
                shown[i] = _encode(render_image(pictures[i].figure, dpi))
    images = {picture: pair for picture, *pair in zip(pictures, shown, narrow, strict=True)}
    headline, rest = split_sentence(sentence)
    html = read_template("page.html").render(
        title=clean(title, 120), headline=headline, rest=rest, sections=sections, images=images, verdict=verdict,
        badge=badge, status=list(filter(None, status)), facts=facts, style=read_text("page.css"))
    for picture, (image, _) in zip(pictures, packed, strict=True):
        write_bytes(folder / "figures" / f"{picture.name}.png", image)
    write_bytes(folder / name, html.encode("utf-8", "replace"))
    return folder / name


def read_template(name: str) -> jinja2.Template:
    """The template in a file beside this one, which escapes what it is given."""
    environment = jinja2.Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True,
                                     undefined=jinja2.StrictUndefined)
    environment.filters |= {
        "prose": format_prose, "table": _read_table, "width": lambda figure: round(WIDE * figure.get_size_inches()[0]),
        "sentence": lambda text: format_prose(text if isinstance(text, markupsafe.Markup) else begin_sentence(text)),
    }  # fmt: skip
    return environment.from_string(read_text(name))


def read_text(name: str) -> str:
    """Text of a file beside this one."""
    return resources.files("ddetumble.reports").joinpath(name).read_text(encoding="utf-8")


def flatten(settings: Mapping, prefix: str = "") -> list[tuple[str, str]]:
    """Nested settings as rows of name and value."""
    rows = []
    for key, value in settings.items():
        name = f"{prefix}{clean(str(key).replace('_', ' '), 60)}"
        if isinstance(value, Mapping):
            rows += flatten(value, f"{name}, ")
        elif isinstance(value, (list, tuple)):
            rows.append((name, ", ".join(clean(item, 80) for item in value) or "none"))
        else:
            rows.append((name, f"{value:.4g}" if isinstance(value, float) else clean(value, 200)))
    return rows


def split_sentence(text: str) -> tuple[str, str]:
    """The headline, which is the first sentence, and the rest; a long first sentence parts at a colon or a semicolon.

    Stops within brackets, in numbers and in names part nothing, nor does what would leave but a word or two.
    """
    depth, ends, breaks = 0, [], []
    for i, (character, after) in enumerate(zip(text, text[1:], strict=False)):
        depth = max(0, depth + (character in "([") - (character in ")]"))
        if depth == 0 and after == " " and i >= SHORTEST:
            if character in ".?!" and text[i + 2 : i + 3].isupper():
                ends.append(i + 1)
            elif character in ":;":
                breaks.append(i + 1)
    place = next(iter(ends), len(text))
    if place > HEADLINE:
        place = next((one for one in breaks if one <= min(place, LONGEST)), place)
    head, rest = text[:place], text[place:].strip()
    return head[:-1] + "." if head[-1:] in (":", ";") else head, begin_sentence(rest)


def begin_sentence(text: str) -> str:
    """Text with a capital at its beginning, unless it begins with a symbol or the name of a parameter or a file."""
    return text[:1].upper() + text[1:] if re.match(r"[a-z]+(-[a-z]+)*[ ,;:]+(?!=)", text) else text


# A capital with an index of one letter, such as `F_n`. Lower case, as in `k_e`, is left: these are names of parameters.
_SYMBOL = re.compile(r"(?<![\w.\-])([A-Z])_([A-Za-z])(?![\w-]|\.\w)")


def format_prose(text) -> Any:
    """Text as HTML: escaped, numbers, units and symbols as in print, what stands between backticks as code.

    HTML stays as it is.
    """
    if isinstance(text, markupsafe.Markup):
        return text
    parts = str(text).split("`")
    if len(parts) % 2 == 0:  # a backtick without another is but a character
        parts = [str(text)]
    return markupsafe.Markup("").join(
        markupsafe.Markup("<code>{}</code>").format(part) if i % 2 else
        markupsafe.Markup(_SYMBOL.sub(r"\1<sub>\2</sub>", str(markupsafe.escape(typeset(part)))))
        for i, part in enumerate(parts))


def write_bytes(path: Path, content: bytes):
    """Write a file, whole or not at all.

    Raises:
        InputError: It cannot be written.
    """
    write_whole(path, lambda draft: draft.write_bytes(content))


def _pack(image) -> tuple[bytes, str]:
    """An image as a file, and as it stands in a page."""
    return write_png(image), _encode(image)


def _encode(image) -> str:
    return base64.b64encode(write_png(reduce_colours(image))).decode("ascii")


def _read_table(table) -> dict:
    """A table as the template wants it: every cell a text, numbers to the right."""
    if not isinstance(table, Table):
        frame = hasattr(table, "itertuples")
        header, *rows = [table.columns, *table.itertuples(index=False, name=None)] if frame else table
        table = Table(header, rows)
    columns, width = [], len(table.header)
    for cells in zip(*([*row, *[""] * (width - len(row))] for row in table.rows), strict=True):
        # As many decimals as all numbers of a column have, if these are one or two; else four digits.
        numbers = [cell for cell in cells if isinstance(cell, float) and math.isfinite(cell)]
        places = next((n for n in (1, 2) if numbers and all(round(x, n) == x for x in numbers)), 0)
        columns.append([f"{cell:.{places}f}" if places and isinstance(cell, float) and math.isfinite(cell) else
                        _show(cell) for cell in cells])
    return {
        "header": list(map(str, table.header)), "caption": table.caption,
        "kinds": list(map(_judge_column, columns)) or ["brief"] * width,
        "rows": [{"cells": row, "marked": i in table.marked} for i, row in enumerate(zip(*columns, strict=True))],
    }  # fmt: skip


def _judge_column(cells: Sequence[str]) -> str:
    """Numbers stand `right`; words are `brief`, `phrase`s, or `prose`, and `wild` where one would not fit."""
    if all(map(_NUMBER.match, cells)):
        return "right"
    longest = max(map(len, cells))
    kind = "brief" if longest <= BRIEF else "phrase" if longest <= PHRASE else "prose"
    return f"{kind} wild" if max(len(word) for cell in cells for word in cell.split()) > PHRASE else kind


def _show(cell) -> str:
    """A cell as text: numbers to four digits, nothing for what is missing."""
    if cell is None or cell != cell:
        return "–"
    return f"{cell:.4g}" if isinstance(cell, float) else clean(cell, 400)
