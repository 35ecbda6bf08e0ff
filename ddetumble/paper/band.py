"""Whether the band of pressures that the paper tells designers to avoid shows in its own numbers."""

import dataclasses as dc
import itertools
from collections.abc import Mapping, Sequence

import numpy as np

from .contradictions import RANGES
from .rows import PeakRow


BAND = (1.5e6, 1.9e6)  # Pa, section 4: "obviously nonlinear", to be avoided


@dc.dataclass(frozen=True)
class BandTest:
    """One model's left-out errors inside the band against those outside.

    Attributes:
        label: of the model.
        inside, outside: mean of |left-out error| [-].
        p_value: share of all ways to call as many rows the band that have a mean at least as large.
        p_adjacent: the same among runs of neighbouring rows, which is all that a band of pressures can be.
    """

    label: str
    inside: float
    outside: float
    p_value: float
    p_adjacent: float


def find_band(pressures: np.ndarray, band: tuple[float, float] = BAND) -> np.ndarray:
    """Numbers of the rows whose pressure [Pa] lies in the band, ends included, shape (inside,)."""
    return np.flatnonzero((pressures >= band[0] - 1.0) & (pressures <= band[1] + 1.0))


def compare_band(row: PeakRow, peaks: np.ndarray, inside: Sequence[int] | np.ndarray) -> BandTest:
    """Exact permutation test: are the left-out errors of a model larger in the band than elsewhere?

    Args:
        row: the model.
        peaks: measured, shape (rows,) [N].
        inside: numbers of the rows in the band; neighbours.
    """
    error, count = np.abs(row.held / peaks - 1.0), len(inside)
    mean = float(error[list(inside)].mean())
    every = [error[list(some)].mean() for some in itertools.combinations(range(len(error)), count)]
    runs = [error[k: k + count].mean() for k in range(len(error) - count + 1)]
    outside = float(np.delete(error, list(inside)).mean())
    return BandTest(row.label, mean, outside, float(np.mean(np.array(every) >= mean - 1e-12)),
                    float(np.mean(np.array(runs) >= mean - 1e-12)))


def measure_bends(peaks: np.ndarray) -> np.ndarray:
    """Second differences of forces at equal steps, shape (rows - 2,) [N]: 0 where they lie on a line."""
    return np.diff(peaks, 2)


def place_band(rows: int, misses: Mapping[str, float], most: float = 7.0) -> list[tuple[int, ...]]:
    """Rows in the band under every range of pressures that misses Figure 8 by less than `most` per cent.

    Args:
        rows: how many, at equal steps.
        misses: of each range of `RANGES`, by name [%].
        most: the largest miss that is let through [%].
    """
    return [tuple(int(k) for k in find_band(1e6 * np.linspace(low, high, rows))) for low, high in RANGES
            if misses[f"{low:g}-{high:g}"] < most]
