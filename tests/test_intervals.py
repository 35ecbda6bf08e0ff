"""Intervals of highest density of a normal distribution between limits, beside sums over its density."""

import numpy as np
import pytest
from scipy import stats

from ddetumble.inference.bounded import truncate_normal


CASES = [(1.0, 0.5, -np.inf, np.inf), (0.3, 1.0, 0.0, np.inf), (0.3, 1.0, -np.inf, 0.5), (2.0, 1.0, 0.0, 2.5),
         (-1.5, 0.7, 0.0, 4.0), (0.0, 2.0, -1.0, 1.0), (5.0, 1.0, 0.0, 3.0), (0.0, 1.0, -3.0, 0.5)]  # fmt: skip


@pytest.mark.parametrize(("mean", "sd", "low", "high"), CASES)
@pytest.mark.parametrize("level", [0.68, 0.95])
def test_beside_sums(mean, sd, low, high, level):
    """Standard deviation and probability inside by sums; no value outside is likelier than one inside."""
    x = np.linspace(max(low, mean - 12 * sd), min(high, mean + 12 * sd), 400_001)
    density = np.exp(-0.5 * ((x - mean) / sd) ** 2)
    density /= density.sum()
    spread, first, last = truncate_normal(mean, sd, low, high, level)
    centre = (x * density).sum()
    assert spread == pytest.approx(np.sqrt((density * (x - centre) ** 2).sum()), rel=1e-4)
    inside = (x >= first) & (x <= last)
    assert density[inside].sum() == pytest.approx(level, abs=1e-4)
    assert density[~inside].max() <= density[inside].min() * (1 + 1e-3)
    assert low <= first < last <= high


@pytest.mark.parametrize("level", [0.5, 0.95])
def test_deep_in_a_tail_it_is_an_exponential(level):
    """Beyond 30 deviations, beside the exact tail from the asymptotic series' first term."""
    for mean, low, high, end in ((-35.0, 0.0, np.inf, 0.0), (41.0, -np.inf, 1.0, 1.0)):
        sd, first, last = truncate_normal(mean, 1.0, low, high, level)
        distance = abs(end - mean)
        assert sd == pytest.approx(1.0 / distance, rel=1e-6)
        edge = last if end == low else first
        assert (first if end == low else last) == end and low <= first < last <= high
        left = stats.norm.logsf(distance + abs(edge - end)) - stats.norm.logsf(distance)
        assert np.exp(left) == pytest.approx(1 - level, rel=0.02)
    assert truncate_normal(-35.0, 1.0, 0.0, np.inf)[2] == pytest.approx(
        truncate_normal(-70.0, 2.0, 0.0, np.inf)[2] / 2.0)


def test_in_little_room_it_is_level():
    sd, first, last = truncate_normal(3.0, 1e4, 1.0, 5.0, 0.9)
    assert (sd, first, last) == pytest.approx((4.0 / np.sqrt(12.0), 1.2, 4.8))
