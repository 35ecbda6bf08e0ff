"""Effects that change no more than what the digits of a gauge do to the mean of its readings, which is no physics."""

from collections.abc import Sequence

import numpy as np

from ..measurement.digits import bound_rounding, measure_digit
from .forward_selection import FittedStep
from .problem import SelectionProblem
from .result import Rounding


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
        digit = measure_digit(own[seen] for own, seen in zip(values, used, strict=True))
        if change > selection.settings.rounding * bound_rounding(digit, selection.noise[channel].sd):
            return None
        digits[channel] = digit
    return Rounding(steps[-1].fitted.effects, digits) if digits else None
