"""A measured channel as a smooth curve over one contact, with its derivative and the uncertainty of both."""

import dataclasses as dc

import numpy as np
from scipy.interpolate import BSpline

from ..inference.noise import Noise, whitening, whitening_matrix


DEGREE = 5  # of the splines: the second derivative, which is needed, is still cubic
MOST_COLUMNS = 64  # splines of a record: a contact has fewer features, and the penalty smooths what is left
# Derivative whose square is penalised: curves with a smooth second derivative, the acceleration, are free.
ROUGHNESS = 4


@dc.dataclass(frozen=True)
class Smooth:
    """A smoothing spline over a contact."""

    knots: np.ndarray  # with repeated ends [s]
    coefficients: np.ndarray  # shape (columns,), unit of the channel
    covariance: np.ndarray  # of the coefficients, shape (columns, columns)
    residual: np.ndarray  # of the samples that were used, in their order
    spent: float  # degrees of freedom that the curve takes

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
    """Fit a smoothing spline to the samples of one contact, at least 8, from its start to its end [s].

    How smooth it is follows from the known noise: every smoothness counts by the marginal likelihood of the samples.
    The covariance is the posterior one: it holds the noise that is left and the bias that the smoothing brings.
    """
    count = int(np.clip(len(time) // 2, DEGREE + 1, MOST_COLUMNS))
    knots = np.concatenate([[start] * DEGREE, np.linspace(start, end, count - DEGREE + 1), [end] * DEGREE])
    basis = _columns(knots, np.clip(time, start, end))
    whitener = whitening_matrix(*whitening(noise, time, np.ones(len(time), dtype=bool)))
    seen, target = whitener @ basis, whitener @ values
    middles = np.linspace(start, end, 8 * count + 1)
    rough = _columns(knots, 0.5 * (middles[1:] + middles[:-1]), ROUGHNESS)
    _, sizes, vectors = np.linalg.svd(rough, full_matrices=True)
    # Coordinates in which roughness is the identity on all but the polynomials.
    rank = count - ROUGHNESS
    scale = np.concatenate([sizes[:rank] / sizes[0], np.ones(ROUGHNESS)])
    turn = (vectors / scale[:, None]).T
    design = seen @ turn
    flat, bent = design[:, rank:], design[:, :rank]
    q, r = np.linalg.qr(flat)
    bent_only, target_only = bent - q @ (q.T @ bent), target - q @ (q.T @ target)
    left, strength, right = np.linalg.svd(bent_only, full_matrices=False)
    along = left.T @ target_only

    def evidence(logarithm: float) -> float:
        spread = 1.0 + strength**2 * np.exp(logarithm)
        return float(np.sum(np.log(spread)) - np.sum(along**2 * (1.0 - 1.0 / spread)))

    top = np.log(max(float(strength[0]) ** 2, 1e-300))
    grid = np.arange(-10.0, 50.0, 0.5) - top
    losses = np.array([evidence(x) for x in grid])
    shares = np.exp(-0.5 * (losses - losses.min()))
    keep = shares > 1e-4
    shares = shares[keep] / shares[keep].sum()
    # One row a smoothness: what each says of the curve, weighted by how likely it is.
    precision = strength**2 + np.exp(-grid[keep])[:, None]
    means = strength * along / precision
    middle = shares @ means
    spread = (means - middle).T * shares @ (means - middle) + np.diag(shares @ (1.0 / precision))
    inner = np.zeros((count, count))
    inner[:rank, :rank] = right.T @ spread @ right
    carry = -np.linalg.solve(r, q.T @ bent)  # what the polynomials do as the rest moves
    inner[rank:, :rank] = carry @ inner[:rank, :rank]
    inner[:rank, rank:] = inner[rank:, :rank].T
    inverse = np.linalg.inv(r)
    inner[rank:, rank:] = inverse @ inverse.T + carry @ inner[:rank, rank:]
    parts = np.concatenate([right.T @ middle, np.zeros(ROUGHNESS)])
    parts[rank:] = np.linalg.solve(r, q.T @ target) + carry @ parts[:rank]
    coefficients = turn @ parts
    spent = float(shares @ np.sum(strength**2 / precision, axis=1)) + ROUGHNESS
    return Smooth(knots, coefficients, turn @ inner @ turn.T, values - basis @ coefficients, spent)


def inflate(noise: Noise) -> float:
    """Variance of a mean over many samples, in units of that under white noise of the same size."""
    if noise.correlation <= 0:
        return 1.0
    return noise.white_share + (1.0 - noise.white_share) * (1.0 + noise.correlation) / (1.0 - noise.correlation)


def find_separation(time: np.ndarray, depression: np.ndarray) -> float:
    """Time at which a measured depression has come back to zero and stays there, from samples after first touch; the
    last time where it never does."""
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
    rough = float(t[3:][int(np.argmin([misfit(end) for end in t[3:]]))])
    fine = np.linspace(rough - step, rough + step, 21)
    best = float(fine[int(np.argmin([misfit(end) for end in fine]))])
    return min(best, float(time[-1]))
