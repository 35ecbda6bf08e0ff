"""What a gauge's digits do to the mean of its readings, which is no physics.

Readings that are rounded to multiples of a digit $q$ are off by up to $q/2$ where nothing moves, and in the mean over
noise of standard deviation $\\sigma$ by up to $(q/\\pi)\\,e^{-2\\pi^2\\sigma^2/q^2}$ (Widrow and Kollár, Quantization
Noise, 2008): next to nothing once the noise is as large as the digit, a tenth of the digit where it is a quarter of it.
"""

from collections.abc import Sequence

import numpy as np

from .forward_selection import FittedStep
from .problem import SelectionProblem
from .result import Rounding


NEAR, MOST = 0.1, 0.99  # of a digit, within which so many readings lie of its multiples: files round them once more
FEWEST = 16  # readings, below which nothing tells whether they are rounded


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
    for one in away:  # from near to far, as the number of digits is sure only where the digit is known well enough
        count = round(one / digit)
        products, squares = products + count * one, squares + count**2
        digit = products / squares if squares else digit
    off = np.abs(away - digit * np.round(away / digit))
    return digit if np.mean(off < NEAR * digit) >= MOST else 0.0


def bound_rounding(digit: float, deviation: float) -> float:
    """Largest error of the mean by rounding, of readings whose noise, rounding included, has a standard deviation."""
    variance = max(deviation**2 - digit**2 / 12.0, 0.0)  # of what the gauge rounds
    if not digit:
        return 0.0
    return min(digit / np.pi * float(np.exp(-2.0 * np.pi**2 * variance / digit**2)), 0.5 * digit)


def find_rounding(selection: SelectionProblem, steps: Sequence[FittedStep]) -> Rounding | None:
    """Effects of the last step, and the digits, where all that they change may be rounding; else None.

    Channels that gain nothing by the effects do not matter.
    """
    stack, first, last = selection.records.stack, steps[0].fitted.solution, steps[-1].fitted.solution
    count, size, digits = selection.records.count, np.asarray(stack.time).shape[1], {}
    for c, channel in enumerate(selection.records.channels):
        rows, used = slice(c * size, (c + 1) * size), selection.records.used[:, c]
        if np.sum(first.residual[:, rows] ** 2 - last.residual[:, rows] ** 2) <= selection.settings.significant:
            continue
        change = float(np.abs(last.channels[:count, c] - first.channels[:count, c])[used].max(initial=0.0))
        values = np.asarray(stack.values)[:count, c]
        found = np.array([find_digit(own[seen]) for own, seen in zip(values, used, strict=True)])
        found = found[np.isfinite(found)]
        digit = float(np.median(found)) if len(found) else 0.0
        if len(found) and np.ptp(found) > NEAR * digit:  # not one gauge with one range: nothing is known of its digits
            digit = 0.0
        if change > selection.settings.rounding * bound_rounding(digit, selection.noise[channel].sd):
            return None
        digits[channel] = digit
    return Rounding(steps[-1].fitted.effects, digits) if digits else None
