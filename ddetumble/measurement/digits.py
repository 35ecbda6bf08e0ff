"""The digits of a gauge: the multiples on which its readings lie, and what rounding to them does to noise and mean.

Readings that are rounded to multiples of a digit $q$ carry noise of $q/\\sqrt{12}$ beside what the gauge rounds, and
are off by up to $q/2$ where nothing moves, in the mean over noise of standard deviation $\\sigma$ by up to
$(q/\\pi)\\,e^{-2\\pi^2\\sigma^2/q^2}$ (Widrow and Kollár, Quantization Noise, 2008): next to nothing once the noise
is as large as the digit, a tenth of the digit where it is a quarter of it.
"""

from collections.abc import Iterable

import numpy as np


NEAR, MOST = 0.1, 0.99  # of a digit, within which so many readings lie of its multiples: files round them once more
FEWEST = 16  # readings, below which nothing tells whether they are rounded
FIRST, ENOUGH = 64, 4096  # different readings after which it shows that they are not, and that fix the digit well


def measure_digit(records: Iterable[np.ndarray]) -> float:
    """The digit that the readings of all records share; 0 where they lie on none, or not on that of one range."""
    found = np.array([find_digit(values) for values in records])
    found = found[np.isfinite(found)]
    return float(np.median(found)) if len(found) and np.ptp(found) <= NEAR * np.median(found) else 0.0


def find_digit(values: np.ndarray) -> float:
    """Spacing of the multiples, from any origin, on which readings lie; 0 where they lie on none, NaN where they tell
    nothing.
    """
    values = values[np.isfinite(values)]
    seen = np.unique(values)
    if len(values) < FEWEST or len(seen) < 2:
        return np.nan
    away = seen - seen[len(seen) // 2]
    away = away[np.argsort(np.abs(away))][1:]
    digit, products, squares = float(np.diff(seen).min()), 0.0, 0.0
    for k, one in enumerate(away[:ENOUGH]):  # near to far, as the count is sure only where the digit is known so well
        count = round(one / digit)
        products, squares = products + count * one, squares + count**2
        digit = products / squares if squares else digit
        if k == FIRST and not _lie_on(away[:FIRST], digit):
            return 0.0
    return digit if _lie_on(away, digit) else 0.0


def _lie_on(away: np.ndarray, digit: float) -> bool:
    """Whether distances are multiples of a digit, but for the figures of a file."""
    return bool(np.mean(np.abs(away - digit * np.round(away / digit)) < NEAR * digit) >= MOST)


def bound_rounding(digit: float, deviation: float) -> float:
    """Largest error of the mean by rounding, of readings whose noise, rounding included, has a standard deviation."""
    variance = max(deviation**2 - digit**2 / 12.0, 0.0)  # of what the gauge rounds
    if not digit:
        return 0.0
    return min(digit / np.pi * float(np.exp(-2.0 * np.pi**2 * variance / digit**2)), 0.5 * digit)
