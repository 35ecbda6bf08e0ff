"""Predicted records: the mean, and the bands of two standard deviations of the mean and of a new measurement."""

import math
from collections.abc import Mapping, Sequence

from ..measurement.quantities import describe_conditions, describe_quantity, shorten_names, vary
from ..measurement.units import si_unit
from .style import AFTER, BEFORE, FLOOR, KIN, WIDTH, dress, head_figure, new_figure, styled, wrap_text


MOST = 12  # records drawn
COLUMNS = 4
LINES = (AFTER, BEFORE, "#009e73")  # channels of one unit in one panel


@styled
def draw_prediction(table, settings: Mapping[str, Mapping[str, float]]):
    """Predictions over time or slip, one column a record, channels of one unit together.

    Args:
        table: what `predict` returned.
        settings: conditions of every record, for the panels' titles.

    Returns:
        A matplotlib figure. Of more than four records only the main channels are drawn, and twelve records at most.
    """
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    abscissa = "slip" if "slip" in table.columns[:2] else "time"
    channels = [name.removesuffix("_sd_new") for name in table.columns if name.endswith("_sd_new")]
    keys = list(dict.fromkeys(table["record"]))[:MOST]
    groups = _group_channels(channels)
    groups = groups if len(keys) <= COLUMNS else groups[:1]
    columns = min(COLUMNS, len(keys))
    rows = math.ceil(len(keys) / columns) * len(groups)
    wide = columns > 1 or len(groups[0]) > 1  # one panel is narrower, if its legend has room
    width, short = WIDTH if wide else 7.0, shorten_names(keys, 22)
    figure = new_figure(0.6 + 2.9 * rows, width, gap=0.045)
    grid = figure.add_gridspec(rows, columns)
    names = vary(settings.values())[:3]
    along = describe_quantity(abscissa, table[abscissa])
    first: dict[int, tuple] = {}  # panels of one row share their scales
    for i, key in enumerate(keys):
        own = table[table["record"] == key].sort_values(abscissa)
        for g, group in enumerate(groups):
            row, column = (g, i) if len(groups) > 1 else divmod(i, columns)
            inner = grid[row, column].subgridspec(2, 1, height_ratios=(2.8, 1), hspace=0.08)
            same = first.get(row, (None, None))
            upper = dress(figure.add_subplot(inner[0], sharey=same[0]))
            lower = dress(figure.add_subplot(inner[1], sharex=upper, sharey=same[1]))
            first.setdefault(row, (upper, lower))
            for channel, colour in zip(group, LINES, strict=False):
                _draw_channel(upper, lower, own, abscissa, channel, along.scale, colour)
            upper.tick_params(labelbottom=False, labelleft=column == 0)
            lower.tick_params(labelleft=column == 0)
            if g == 0:
                said = describe_conditions(settings[key], names)
                lines = [short[str(key)], wrap_text(said, (width - 0.8) / columns - 0.2)]
                upper.set_title("\n".join(line for line in lines if line))
            if row == rows - 1 or i + columns >= len(keys):
                lower.set_xlabel(along.label)
            if column == 0:
                upper.set_ylabel(_name_group(table, group))
                lower.set_ylabel("± 2 sd")
    shown = groups[0] if len(groups) == 1 else max(groups, key=len)
    lines = [Line2D([], [], color=colour, lw=1.6) for _, colour in zip(shown, LINES, strict=False)]
    words = ["mean"] if len(shown) == 1 else [describe_quantity(c).name for c in shown]
    head_figure(figure, [*lines, Patch(color=KIN, alpha=0.8), Patch(color=FLOOR, alpha=0.25)],
                [*words, "± 2 sd of the mean", "± 2 sd of a new measurement"])
    return figure


def _group_channels(channels: Sequence[str]) -> list[list[str]]:
    """Channels of one unit together, three at most, in their order."""
    groups: dict[str, list[str]] = {}
    for channel in channels:
        groups.setdefault(si_unit(channel), []).append(channel)
    return [group[k: k + len(LINES)] for group in groups.values() for k in range(0, len(group), len(LINES))]


def _draw_channel(upper, lower, own, abscissa: str, channel: str, scale: float, colour: str) -> None:
    """The mean with its bands, and below the bands alone, which are often thinner than the line."""
    shown = describe_quantity(channel, own[channel])
    x, mean = scale * own[abscissa].to_numpy(), shown.scale * own[channel].to_numpy()
    for ending, fill, alpha in (("_sd_new", FLOOR, 0.25), ("_sd", KIN, 0.8)):
        sd = 2.0 * shown.scale * own[channel + ending].to_numpy()
        upper.fill_between(x, mean - sd, mean + sd, color=fill, alpha=alpha, lw=0)
        lower.fill_between(x, -sd, sd, color=fill, alpha=alpha, lw=0)
    upper.plot(x, mean, "-" if len(x) > 1 else "o", color=colour, lw=1.4)


def _name_group(table, group: Sequence[str]) -> str:
    shown = [describe_quantity(channel, table[channel]) for channel in group]
    if len(shown) == 1:
        return shown[0].label
    word = group[0].rsplit("_", 1)[0].replace("_", " ") if group[0].startswith(("angular", "attitude")) else "force"
    return f"{word} [{shown[0].unit}]" if shown[0].unit else word
