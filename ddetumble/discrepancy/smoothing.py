"""A measured channel as a smooth curve over one contact, with its derivative and what noise leaves uncertain of both."""

import dataclasses as dc
from collections.abc import Sequence

import numpy as np
from scipy.interpolate import BSpline

from ..inference.noise import Noise


DEGREE = 5
COUNTS = (6, 7, 8, 10, 12, 15, 19, 24, 30, 38, 48, 60, 76, 96)
MOST_DENSE = 2000  # samples up to which the covariance of correlated noise is used as it is


@dc.dataclass(frozen=True)
class Smooth:
    """A regression spline over a contact.

    Attributes:
        knots: with repeated ends [s].
        coefficients: shape (columns,), unit of the channel.
        covariance: of the coefficients, shape (columns, columns).
        residual: of the samples that were used, in their order.
    """

    knots: np.ndarray
    coefficients: np.ndarray
    covariance: np.ndarray
    residual: np.ndarray

    def columns(self, time: np.ndarray, derivative: int = 0) -> np.ndarray:
        """Basis or its derivative at times inside the contact (held at its ends), shape (times, columns)."""
        return _columns(self.knots, np.clip(time, self.knots[0], self.knots[-1]), derivative)

    def at(self, time: np.ndarray, derivative: int = 0) -> np.ndarray:
        """The curve or its derivative, shape (times,)."""
        return self.columns(time, derivative) @ self.coefficients


def _columns(knots: np.ndarray, time: np.ndarray, derivative: int = 0) -> np.ndarray:
    spline = BSpline(knots, np.eye(len(knots) - DEGREE - 1), DEGREE)
    return (spline.derivative(derivative) if derivative else spline)(time)


def smooth_samples(time: np.ndarray, values: np.ndarray, noise: Noise, start: float, end: float) -> Smooth:
    """Fit a spline to the samples of one contact.

    The number of coefficients weighs bias against noise: the least estimated squared error at the known noise (Mallows'
    C_p), and then one size finer, so that what bias is left is small beside the stated deviation.

    Args:
        time, values: samples in contact, at least 8, shape (samples,).
        noise: of the channel.
        start, end: of the contact [s].
    """
    lag = time - time[0]
    coloured = noise.correlation > 0
    dense = noise.covariance(lag[:, None] - lag[None, :]) if coloured and len(time) <= MOST_DENSE else None
    scores, fits = [], []
    for count in [c for c in COUNTS if c <= max(COUNTS[0], len(time) // 2)]:
        knots = np.concatenate([[start] * DEGREE, np.linspace(start, end, count - DEGREE + 1), [end] * DEGREE])
        basis = _columns(knots, np.clip(time, start, end))
        smoother = np.linalg.pinv(basis, rcond=1e-9)
        residual = values - basis @ (smoother @ values)
        if dense is not None:
            covariance = smoother @ dense @ smoother.T
            spent = float(np.sum((basis @ covariance) * basis)) / noise.sd**2
        else:
            inflation = inflate(noise)
            covariance = noise.sd**2 * inflation * smoother @ smoother.T
            spent = count * inflation
        scores.append(float(residual @ residual) / noise.sd**2 + 2.0 * spent)
        fits.append(Smooth(knots, smoother @ values, covariance, residual))
    return fits[min(int(np.argmin(scores)) + 1, len(fits) - 1)]


def inflate(noise: Noise) -> float:
    """Variance of a mean over many samples, in units of that under white noise of the same size."""
    if noise.correlation <= 0:
        return 1.0
    return noise.white_share + (1.0 - noise.white_share) * (1.0 + noise.correlation) / (1.0 - noise.correlation)


def find_separation(time: np.ndarray, depression: np.ndarray) -> float:
    """Time at which a measured depression has come back to zero and stays there; the last time where it never does.

    Args:
        time, depression: samples after first touch, no gaps, shape (samples,) [s], [m].
    """
    soft = np.convolve(np.pad(depression, 2, mode="edge"), np.ones(5) / 5, mode="valid")
    peak = int(np.argmax(soft))
    low = np.flatnonzero(soft[peak:] < 0.4 * soft[peak])
    if soft[peak] <= 0 or not len(low):
        return float(time[-1])
    first = peak + int(low[0])
    fall = max(first - peak, 6)
    first = max(first - fall // 4, peak)
    t, y = time[first: first + 4 * fall], depression[first: first + 4 * fall]
    if len(t) < 5:
        return float(time[-1])

    def misfit(end: float) -> float:
        left = np.maximum(end - t, 0.0) / (t[-1] - t[0])
        columns = np.stack([left, left**2, left**3], axis=1)
        return float(np.sum((y - columns @ np.linalg.lstsq(columns, y, rcond=1e-9)[0]) ** 2))

    step = float(np.median(np.diff(t)))
    for grid in (t[3:], None):
        trial: Sequence[float] = grid if grid is not None else np.linspace(best - step, best + step, 21)
        best = float(trial[int(np.argmin([misfit(end) for end in trial]))])
    return min(best, float(time[-1]))
