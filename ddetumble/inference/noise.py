"""Noise of a channel: how large, how correlated along a trace, and the filter that whitens it."""

import dataclasses as dc
from collections.abc import Mapping
from typing import Annotated, Any

import numpy as np
import pydantic
from scipy import sparse

from . import distributions as stats


TAPS = 8
BATCH = 16_384  # samples whose predictors are computed at once
# As `model.json` may have them.
Positive = Annotated[float, pydantic.Field(gt=0, allow_inf_nan=False)]
Finite = Annotated[float, pydantic.Field(allow_inf_nan=False)]


@dc.dataclass(frozen=True)
class Noise:
    """White noise plus first-order autoregressive (Ornstein-Uhlenbeck) noise, whose size may vary.

    Attributes:
        sd, stated_sd: standard deviation of one sample, SI (root mean square over them where it varies), and what the
            campaign states, or None.
        correlation, interval: of the autoregressive part over one sampling interval [-], and that [s].
        white_share: share of the variance that is white [-].
        log_level_sd: standard error of the logarithm of the noise power where the contact's own frequencies are.
        text: how it was found.
        floor, share, rate_share: standard deviation without a reading, SI, as a share of the reading, and of its change
            from one sample to the next, which add in squares; `floor` None where the size does not vary with these.
        slow_sd, slow_time: of a baseline that wanders beside (Ornstein-Uhlenbeck): its standard deviation, SI, and its
            correlation time in the independent variable, SI; none where the first is 0.
        hum: frequency [Hz] and rms [SI] of every sine beside it, whose amplitude and phase every record has its own of.
        sizes: standard deviation of every sample over `sd`, by record, shape (samples,); empty where all are alike.
        degrees: of freedom, where the size is the scatter of values of which a record has one; 0 where it is stated, or
            measured along series.
    """

    sd: Positive
    correlation: Annotated[float, pydantic.Field(ge=0, lt=1)]
    white_share: Annotated[float, pydantic.Field(ge=0, le=1)]
    interval: Positive
    stated_sd: Finite | None
    log_level_sd: Finite
    text: str
    floor: Finite | None = None
    share: Finite = 0.0
    rate_share: Finite = 0.0
    slow_sd: Finite = 0.0
    slow_time: Positive = 1.0
    hum: tuple[tuple[Positive, Positive], ...] = ()
    sizes: Mapping[str, Any] = dc.field(default_factory=dict, repr=False, compare=False)
    degrees: Annotated[int, pydantic.Field(ge=0)] = 0

    def deviations(self, reading: np.ndarray) -> np.ndarray:
        """Standard deviation of the noise of neighbouring readings, shape (..., samples), SI, all parts together."""
        beside = self.slow_sd**2 + sum(sd**2 for _, sd in self.hum)
        if self.floor is None:
            return np.full(np.shape(reading), np.sqrt(self.sd**2 + beside))
        rate = np.gradient(reading, axis=-1) if np.shape(reading)[-1] > 1 else np.zeros(np.shape(reading))
        return np.sqrt(self.floor**2 + (self.share * reading) ** 2 + (self.rate_share * rate) ** 2 + beside)

    @property
    def is_white(self) -> bool:
        """Whether no sample says anything about another."""
        return self.correlation <= 0 and self.slow_sd <= 0

    def with_slow_parts(self, other: "Noise") -> "Noise":
        """The same with the baseline and the hum of another."""
        return dc.replace(self, slow_sd=other.slow_sd, slow_time=other.slow_time).with_hum(other.hum)

    def with_hum(self, hum: tuple[tuple[float, float], ...]) -> "Noise":
        """The same with further sines, of frequencies [Hz] and rms [SI]."""
        text = " and ".join(f"{sd:.2g} (SI, rms) at {frequency:.4g} Hz" for frequency, sd in hum)
        return dc.replace(self, hum=(*self.hum, *hum), text=self.text + (f"; beside it hum of {text}" if hum else ""))

    def without_sizes(self) -> "Noise":
        """The same without the sizes of the samples that it was measured on."""
        return dc.replace(self, sizes={})

    def covariance(self, lag: np.ndarray) -> np.ndarray:
        """Autocovariance at time lags `lag` [s], any shape."""
        lag = np.abs(lag)
        coloured = max(self.correlation, 0.0) ** (lag / self.interval)
        fast = (1 - self.white_share) * coloured + self.white_share * (lag < 1e-9 * self.interval)
        return self.sd**2 * fast + self.slow_sd**2 * np.exp(-lag / self.slow_time)


def widen_by_student(degrees: float) -> float:
    """How many times as large a standard deviation known from so many degrees of freedom has to be taken for the 95 %
    interval of a normal distribution to be Student's."""
    return float(stats.t.ppf(0.975, degrees) / stats.norm.ppf(0.975))


def whitening(noise: Noise, time: np.ndarray, valid: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Best linear prediction of each sample from the `TAPS` before it; missing samples are not `valid`.

    Returns weights, shape (samples,): 1/sd of what cannot be predicted (0 for missing samples); and taps, shape
    (samples, TAPS): the whitened value is weight * (x_t - sum_k taps[t, k] x_{t-1-k}).
    """
    n, variance = len(time), float(noise.covariance(np.zeros(1))[0])
    weights, taps = np.where(valid, 1.0 / np.sqrt(variance), 0.0), np.zeros((n, TAPS))
    if noise.is_white or n < 2:
        return weights, taps
    steps, place = np.diff(time), np.arange(n)[:, None] - np.arange(1, TAPS + 1)
    seen = (place >= 0) & valid[np.maximum(place, 0)] & valid[:, None]
    rows = np.flatnonzero(seen.any(axis=1))
    first = which = np.arange(len(rows))
    if np.allclose(steps, steps[0], rtol=1e-3):  # what came before looks alike nearly everywhere
        _, first, which = np.unique(seen[rows] @ 2 ** np.arange(TAPS), return_index=True, return_inverse=True)
    found, scale = np.zeros((len(first), TAPS)), np.zeros(len(first))
    for k in range(0, len(first), BATCH):
        t = rows[first[k: k + BATCH]]
        there = seen[t]
        times = time[np.maximum(place[t], 0)]
        among = noise.covariance(times[:, :, None] - times[:, None, :]) + 1e-12 * variance * np.eye(TAPS)
        among = np.where(there[:, :, None] & there[:, None, :], among, variance * np.eye(TAPS))
        to = np.where(there, noise.covariance(times - time[t, None]), 0.0)
        found[k: k + BATCH] = np.linalg.solve(among, to[..., None])[..., 0]
        left = variance - np.sum(found[k: k + BATCH] * to, axis=1)
        scale[k: k + BATCH] = 1.0 / np.sqrt(np.maximum(left, 1e-6 * variance))
    taps[rows], weights[rows] = found[which], scale[which]
    return weights, taps


def scale_whitening(weights: np.ndarray, taps: np.ndarray, sizes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The filter of the same noise with samples of other sizes, shape (samples,): that of $x_t/s_t$."""
    before = np.arange(len(sizes))[:, None] - np.arange(1, TAPS + 1)
    return weights / sizes, taps * sizes[:, None] / sizes[np.maximum(before, 0)]


def whitening_matrix(weights: np.ndarray, taps: np.ndarray) -> sparse.csr_matrix:
    """A whitening filter as a banded matrix, shape (samples, samples), for columns over the samples."""
    lags = range(1, min(TAPS, len(weights) - 1) + 1) if taps.any() else ()
    offsets: Any = [0, *(-k for k in lags)]
    return sparse.csr_matrix(sparse.diags([weights, *(-(weights * taps[:, k - 1])[k:] for k in lags)], offsets))
