"""Tumbling records in another unit of angle or time, found by kinematics before any fit.

Euler's equations hold in rad/s only: with rates k times as large, the changes of the transverse rates are k times as
large and their products k² times, so that 1 - r, the difference of the moments, comes out k times too small.
"""

import numpy as np

from ..inference.families import RATES
from ..inference.starts import fill_gaps, integrate_couple
from ..measurement.campaign import Campaign
from ..measurement.faults import Fault
from .settings import DEFAULT, OutlierSettings


RATIOS = {"57.3 (degrees and radians)": 57.29578, "9.549 (turns a minute and rad/s)": 9.5492966,
          "60 (minutes and seconds)": 60.0, "1000": 1e3}
FEWEST = 3  # other records
SHORTEST = 16  # samples


def find_rate_units(campaign: Campaign, settings: OutlierSettings = DEFAULT.outliers) -> tuple[Fault, ...]:
    """Records whose rates are plainly in another unit than those of all others."""
    if campaign.family != "tumble" or campaign.samples is None or any(r not in campaign.channels for r in RATES):
        return ()
    slopes = {}
    for key, part in campaign.samples.groupby("record", sort=False):
        time, rates = part["time"].to_numpy(dtype=float), part[list(RATES)].to_numpy(dtype=float)
        if len(time) < SHORTEST or not np.isfinite(rates).any(axis=0).all():
            continue
        change, cause = integrate_couple(time, fill_gaps(time, rates))
        below = float(np.sum(cause**2))
        slope = float(np.sum(change * cause)) / below if below > 0 else 0.0
        if np.sum((change - slope * cause) ** 2) < settings.kinematic_noise * np.sum(change**2):
            slopes[str(key)] = slope
    return tuple(fault for key in slopes for fault in _compare(key, slopes, settings))


def _compare(key: str, slopes: dict[str, float], settings: OutlierSettings) -> list[Fault]:
    """Hold the difference of the moments that a record shows against that of the others."""
    others = np.array([slope for other, slope in slopes.items() if other != key])
    if len(others) < FEWEST or not np.all(others):
        return []
    middle = float(np.median(others))
    if np.median(np.abs(others / middle - 1.0)) > settings.kinematic_spread:
        return []
    for label, ratio in RATIOS.items():
        for factor in (ratio, 1.0 / ratio):
            if abs(slopes[key] * factor / middle - 1.0) < settings.kinematic_slack:
                seen = (f"The rates of record {key} obey Euler's equations with the moments that all others show only "
                        f"once they are {'divided' if factor > 1 else 'multiplied'} by {label}: a mistaken unit.")
                return [Fault("unit", (key,), RATES[0], seen, "It is left out.", "Correct the unit of that record.",
                              left_out=True)]
    return []
