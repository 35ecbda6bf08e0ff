"""The records of a campaign as measured, before any model."""

import numpy as np

from ..measurement.campaign import Campaign
from ..measurement.quantities import describe_quantity
from .palette import BEFORE, INK
from .style import dress, new_figure, styled


MOST = 40  # records that are drawn: more hide one another


@styled
def draw_records(campaign: Campaign):
    """Every channel of the first records over the independent variable; a line marks nought, where contact begins."""
    samples, along = campaign.samples, campaign.independent
    if samples is None or along is None:
        raise ValueError("the campaign has no samples")
    x, keys = describe_quantity(along.name, samples[along.name].to_numpy(), along.unit), campaign.record_keys
    figure = new_figure(0.6 + 2.0 * len(campaign.channels))
    panels = figure.subplots(len(campaign.channels), 1, sharex=True, squeeze=False)[:, 0]
    for axes, (name, column) in zip(panels, campaign.channels.items(), strict=True):
        y = describe_quantity(name, samples[name].to_numpy(), column.unit)
        for key in keys[:MOST]:
            trace = campaign.trace(key)
            there = np.isfinite(trace[name].to_numpy())
            axes.plot(x.scale * trace[along.name][there], y.scale * trace[name][there], lw=0.8, alpha=0.7, color=BEFORE)
        axes.axvline(0.0, color=INK, lw=0.6)
        dress(axes, ylabel=y.label)
    panels[-1].set_xlabel(x.label)
    count = f"{MOST} of " * (len(keys) > MOST) + f"{len(keys)} records"
    panels[0].set_title(keys[0] if len(keys) == 1 else count)
    return figure
