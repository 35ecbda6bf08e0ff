"""Sections of the page from their templates in `_sentences`."""

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from .._sentences import tell
from .._settings import find_data


def write_section(template: str, figures: Mapping[str, Any], tables: Sequence[Any] = (), **facts):
    """A section of a page: a title, and blocks of text, points, captions and tables.

    Args:
        template: `file.macro`.
        figures: matplotlib figures by name; the template holds their captions.
        tables: data frames that come after the template's own tables.
        **facts: what the template tells.
    """
    from ..reports.page import Picture, Section

    title, *blocks = tell(template, **facts)
    texts: dict[str, list[Any]] = {kind: [] for kind in ("paragraphs", "* ", "! ", "| ")}
    for block in blocks:
        texts[block[:2] if block[:2] in texts else "paragraphs"].append(block)
    captions = (block[2:].split(": ", 1) for block in texts["! "])
    pictures = [Picture(name, caption, figures[name]) for name, caption in captions]
    rows = [[re.split(r" \| ", line.strip()[2:-2]) for line in block.splitlines()] for block in texts["| "]]
    return Section(title, texts["paragraphs"], pictures, [*rows, *tables], [block[2:] for block in texts["* "]])


def read_errors(name: str) -> np.ndarray:
    """Errors that the paper prints in `table-3` or `table-4`, shape (11,) [%]."""
    import pandas as pd

    return pd.read_csv(find_data() / "paper" / name / "errors.csv")["printed_error"].to_numpy(float)
