"""The ranking of the catalogue's effects: what each explains, and what this campaign can see of it."""

import math
from collections.abc import Sequence

from ..measurement.quantities import say_p, shorten
from ..selection.result import Candidate
from ..selection.settings import DEFAULT
from .style import (
    AFTER,
    FAINT,
    GREY,
    INK,
    KIN,
    NARROW,
    OTHER,
    PALE,
    WIDTH,
    dress,
    head_figure,
    new_figure,
    styled,
    wrap_text,
)


CHANCE = 0.05  # p-value from which what an effect removes may be chance


@styled
def draw_ranking(candidates: Sequence[Candidate], chosen: Sequence[str] = (), confused: Sequence[str] | None = None,
                 narrow: bool = False):
    """One bar an effect: the share of the misfit above noise that it removes; a diamond for what can be seen of it.

    Args:
        candidates: as they stood at the first step, best first.
        chosen: effects that were added, in their order.
        confused: effects that this campaign cannot tell from the first chosen one; its own list where not given.
        narrow: draw for a telephone.

    Returns:
        A matplotlib figure.
    """
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    if confused is None:
        own = [candidate for candidate in candidates if candidate.effect in tuple(chosen)[:1]]
        confused = own[0].indistinguishable_from if own else ()
    figure = new_figure((2.0 if narrow else 1.0) + 0.27 * max(len(candidates), 1), NARROW if narrow else WIDTH)
    axes = dress(figure.add_subplot(), grid="x")
    colours = {"chosen": AFTER, "kin": KIN, "other": OTHER, "unseen": FAINT}
    edges = {"unseen": PALE, "kin": "white"}
    used = []
    for row, candidate in enumerate(candidates):
        # What removes a misfit beyond chance is seen, however little of its signature at the null survives.
        unseen = (math.isfinite(candidate.visible) and candidate.visible < DEFAULT.invisible
                  and candidate.p_value > CHANCE)
        kind = "chosen" if candidate.effect in chosen else "kin" if candidate.effect in confused else "other"
        kind = "unseen" if unseen and kind == "other" else kind
        used.append(kind)
        share = 100 * min(max(candidate.explains, 0.0), 1.0) if math.isfinite(candidate.explains) else 0.0
        axes.barh(row, share, height=0.66, color=colours[kind], edgecolor=edges.get(kind, "none"), lw=0.8,
                  hatch="///" if kind == "kin" else None)
        if math.isfinite(candidate.visible):
            axes.plot(100 * candidate.visible, row, marker="D", ms=5.5, mfc="white", mec=GREY if unseen else INK,
                      mew=1.2, zorder=4, clip_on=False)
        text = "cannot be seen" if unseen else say_p(candidate.p_value) if share > 0 else "–"
        axes.text(110 if narrow else 103, row, text, va="center", fontsize=8.5,
                  color=GREY if unseen or candidate.p_value > 0.05 else INK)
    length = 22 if narrow else 36
    axes.set_yticks(range(len(candidates)), [shorten(candidate.effect, length) for candidate in candidates])
    for word, kind in zip(axes.get_yticklabels(), used, strict=True):
        word.set_color(GREY if kind == "unseen" else INK)
        word.set_fontweight("bold" if kind == "chosen" else "normal")
    axes.set_ylim(len(candidates) - 0.4, -0.6)
    axes.set_xlim(-4 if narrow else -1.5, 175 if narrow else 118)  # a diamond at 0 stays clear of the names
    axes.set_xticks(range(0, 101, 50 if narrow else 20))
    axes.spines["bottom"].set_bounds(0, 100)
    axes.spines["left"].set_visible(False)
    axes.axvline(0, color=GREY, lw=0.7, zorder=1)
    axes.tick_params(axis="y", length=0)
    label = "share of the misfit above noise that it removes (bars) [%]"
    axes.set_xlabel(wrap_text(label, 2.3) if narrow else label)
    words = {
        "chosen": "added",
        "kin": "cannot be told from it",
        "other": "not added",
        "unseen": "cannot be seen by this campaign",
    }
    handles: list = [
        Patch(facecolor=colours[kind], edgecolor=edges.get(kind, "none"),
              hatch="///" if kind == "kin" else None)
        for kind in words if kind in used
    ]  # fmt: skip
    labels = [text for kind, text in words.items() if kind in used]
    handles.append(Line2D([], [], ls="none", marker="D", ms=5.5, mfc="white", mec=INK, mew=1.2))
    labels.append("share of its own signature that can be seen [%]")
    head_figure(figure, handles, labels)
    return figure
