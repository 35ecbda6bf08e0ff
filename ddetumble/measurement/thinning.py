"""Fewer samples of a campaign that has more than a search through all models could read in reasonable time."""

import dataclasses as dc

import numpy as np

from .campaign import Campaign


def thin_campaign(campaign: Campaign, most: int) -> tuple[Campaign, str]:
    """Every so many-th sample of the longer records, so that all together have at most `most`.

    What is kept are readings as they were taken: their noise is as stated, and no feature is smoothed away. Estimates
    are less exact than all samples would make them, by up to the root of the share kept.

    Args:
        campaign: with samples.
        most: samples of all records together.

    Returns:
        The campaign, and a sentence that says so; the campaign itself and no sentence where it has no more.
    """
    if campaign.samples is None or len(campaign.samples) <= most:
        return campaign, ""
    groups = campaign.samples.groupby("record", sort=False)
    step = -(-groups["record"].transform("size").to_numpy() // max(most // groups.ngroups, 1))
    kept = campaign.samples.loc[groups.cumcount().to_numpy() % step == 0].reset_index(drop=True)
    return dc.replace(campaign, samples=kept), (
        f"Of {len(campaign.samples):,} samples {len(kept):,} were taken, one in {int(np.max(step))} of the longest "
        f"record: more than {most:,} would take too long here. `fit` takes all of them.")
