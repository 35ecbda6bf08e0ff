"""Noise of a channel: how large, how correlated along a trace, and the filter that whitens it.

The size comes from what the campaign states, the correlation from frequencies above those of any contact, never from
the low-frequency residuals of a model under suspicion. Above the contact's frequencies white noise, autoregressive
noise and their sum often look alike; below, where a missing force would act, they differ. So none is chosen before the
level there is known: it is averaged over all, and its error holds their differences.
"""

import dataclasses as dc
from collections.abc import Callable
from typing import Annotated

import numpy as np
import pydantic
from scipy import sparse


TAPS = 8
PAIRS = 6  # samples apart, at most
BATCH = 16_384  # samples whose predictors are computed at once
MOST = 2000  # frequencies kept apart
WORTH = 4.0  # in the logarithm of the likelihood, that a further parameter of the noise has to bring
BELOW = np.array([0.05, 0.15, 0.35, 0.6, 0.9])  # of the lowest frequency used: where the contact's own are
DRIFT = 3.0  # correlation times over the period of the lowest frequency used: what is slower is no noise
SLOW = np.array([0.02])  # the same in cycles a sample, where differences of samples are all that is looked at
SHORTEST = 0.3  # correlation time [samples]
NODES = (48, 24)  # in correlation time and in the share that is white
ROUNDS = 8
FAR = 12.0  # below the best in the logarithm of the likelihood: no longer looked at
STATED = 0.01  # relative standard deviation of a size that a campaign states
# As `model.json` may have them.
Positive = Annotated[float, pydantic.Field(gt=0, allow_inf_nan=False)]
Finite = Annotated[float, pydantic.Field(allow_inf_nan=False)]
Shapes = Callable[[np.ndarray, np.ndarray], np.ndarray]


@dc.dataclass(frozen=True)
class Noise:
    """White noise plus first-order autoregressive (Ornstein-Uhlenbeck) noise.

    Attributes:
        sd: standard deviation of one sample, SI.
        correlation: of the autoregressive part over one `interval` [-].
        white_share: share of the variance that is white [-].
        interval: sampling interval at which `correlation` holds [s].
        stated_sd: what the campaign states, or None.
        log_level_sd: standard error of the logarithm of the noise power where the contact's own frequencies are.
        text: how it was found.
    """

    sd: Positive
    correlation: Annotated[float, pydantic.Field(ge=0, lt=1)]
    white_share: Annotated[float, pydantic.Field(ge=0, le=1)]
    interval: Positive
    stated_sd: Finite | None
    log_level_sd: Finite
    text: str

    def covariance(self, lag: np.ndarray) -> np.ndarray:
        """Autocovariance at time lags `lag` [s], any shape."""
        lag = np.abs(lag)
        coloured = np.where(lag == 0, 1.0, np.exp(np.log(max(self.correlation, 1e-12)) * lag / self.interval))
        if self.correlation <= 0:
            coloured = (lag == 0).astype(float)
        return self.sd**2 * ((1 - self.white_share) * coloured + self.white_share * (lag < 1e-9 * self.interval))


def _spectrum(frequency: np.ndarray, interval: float, correlation: float | np.ndarray,
              white: float | np.ndarray) -> np.ndarray:
    """Power per sample at unit variance."""
    phase = np.cos(2 * np.pi * frequency * interval)
    coloured = (1 - correlation**2) / (1 - 2 * correlation * phase + correlation**2)
    return (1 - white) * coloured + white


def estimate_noise(traces: list[np.ndarray], interval: float, lowest: float, stated_sd: float | None,
                   quiet_sd: tuple[float, int, int] | None = None) -> Noise:
    """Whittle likelihood of the residuals' spectrum above the frequencies of the contact.

    Args:
        traces: residuals of each record (no gaps), SI.
        interval: sampling interval [s].
        lowest: lowest frequency that is used [Hz].
        stated_sd: standard deviation that the campaign states, or None.
        quiet_sd: standard deviation of samples without contact about the mean of each stretch, how many they are, and
            how long a stretch is; it replaces what is stated where the two disagree beyond doubt, unless noise of the
            stated size would stray as little over so short a while.
    """
    expected, doubtful = stated_sd, False
    if quiet_sd is not None and stated_sd is not None and quiet_sd[1] >= 30:
        doubtful = abs(np.log(quiet_sd[0] / stated_sd)) > max(0.15, 10.0 / np.sqrt(2.0 * quiet_sd[1]))
    power, frequency = [], []
    for trace in traces:
        n = len(trace)
        if n < 24:
            continue
        window = np.hanning(n + 2)[1:-1]
        window = window / np.sqrt(np.mean(window**2))
        x = np.fft.rfft((trace - np.mean(trace)) * window)
        f = np.fft.rfftfreq(n, interval)
        keep = (f >= lowest) & (f < 0.49 / interval)
        power.append(np.abs(x[keep]) ** 2 / n)
        frequency.append(f[keep])
    count = sum(len(p) for p in power)
    if count < 24:
        sd = expected if expected is not None else float(np.std(np.concatenate(traces)))
        return Noise(sd, 0.0, 0.0, interval, stated_sd, 0.2,
                     "too few samples to measure its correlation: taken as white")
    power, frequency = np.concatenate(power), np.concatenate(frequency)
    # A Hann window makes neighbouring ordinates correlated: about half of them are independent.
    weight = 0.5

    def weigh(sd, rho, white):
        s = sd**2 * _spectrum(frequency, interval, rho, white)
        return weight * np.sum(np.log(s) + power / s)

    frequencies, counts, means = _gather(frequency, power)

    def choose(expected):
        return weigh_kinds(
            lambda rho, white: _spectrum(frequencies, interval, rho[:, None], white[:, None]),
            lambda rho, white: np.log(_spectrum(lowest * BELOW, interval, rho[:, None], white[:, None])).mean(axis=1),
            weight * counts, means, expected, DRIFT / (lowest * interval), interval, stated_sd)

    found = choose(expected)
    if not doubtful or quiet_sd is None:
        return found
    quiet, count, length = quiet_sd

    def judge(noise):
        spread = noise.sd**2 * _stray(noise.correlation, noise.white_share, length)
        free = 0.5 * count * (1.0 - noise.correlation) / (1.0 + noise.correlation)
        return (weigh(noise.sd, noise.correlation, noise.white_share)
                + 0.5 * free * (np.log(spread / quiet**2) + quiet**2 / spread - 1.0)
                + WORTH * ((noise.correlation > 0) + (noise.white_share > 0)))

    # A slow drift beside white noise of another size would say the same: the simpler account is believed.
    other = choose(quiet)
    return other if judge(other) < judge(found) else found


def _stray(correlation: float, white: float, length: int) -> float:
    """Expected variance of so many neighbours about their own mean, at unit variance."""
    lag = np.arange(1, length)
    return 1.0 - 2.0 * (1.0 - white) * float(np.sum((length - lag) * correlation**lag)) / (length * (length - 1.0))


def estimate_from_pairs(traces: list[tuple[np.ndarray, np.ndarray]], interval: float, stated_sd: float | None) -> Noise:
    """The same where samples are missing or unevenly taken: likelihood of the differences of near samples.

    Differences over a few intervals hardly feel what is slow, such as a missing force.

    Args:
        traces: times [s] and residuals [SI] of each record's samples.
        interval: for which the correlation is given [s].
        stated_sd: standard deviation that the campaign states, or None.
    """
    lags, squares = [], []
    for time, x in traces:
        for k in range(1, PAIRS + 1):
            lag = time[k:] - time[:-k]
            near = lag < 2.0 * PAIRS * interval
            lags.append(lag[near])
            squares.append((x[k:] - x[:-k])[near] ** 2)
    lag, square = np.concatenate(lags), np.concatenate(squares)
    if len(lag) < 24 * PAIRS:
        sd = stated_sd if stated_sd is not None else float(np.sqrt(np.mean(square) / 2.0))
        return Noise(sd, 0.0, 0.0, interval, stated_sd, 0.2,
                     "too few samples to measure its correlation: taken as white")
    weight = 0.5 / PAIRS  # every sample is in so many pairs

    lags, counts, squares = _gather(lag / interval, square)
    found = weigh_kinds(
        lambda rho, white: 2.0 * (1.0 - (1.0 - white[:, None]) * rho[:, None] ** lags),
        lambda rho, white: np.log(_spectrum(SLOW / interval, interval, rho[:, None], white[:, None])).mean(axis=1),
        weight * counts, squares, stated_sd, DRIFT / SLOW[0], interval, stated_sd)
    return dc.replace(found, text=found.text + "; from pairs of samples, as some are missing or unevenly taken")


def _gather(x: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean `values` of every `x` that occurs, with neighbours taken together where there are many; how many each is."""
    unique, place = np.unique(np.round(x / max(x.max(), 1e-300), 6), return_inverse=True)
    place = place * min(MOST, len(unique)) // len(unique)
    counts = np.bincount(place)
    return np.bincount(place, x) / counts, counts, np.bincount(place, values) / counts


@dc.dataclass(frozen=True)
class _Nodes:
    """Noises of one kind, each standing for a part of the prior `volume` together with what the samples say."""

    correlation: np.ndarray
    white_share: np.ndarray
    loss: np.ndarray
    log_sd: np.ndarray
    log_sd_error: np.ndarray
    volume: float

    @property
    def log_evidence(self) -> float:
        low = self.loss.min()
        return float(np.log(self.volume * np.sum(np.exp(low - self.loss))) - low)


def weigh_kinds(shape: Shapes, log_level: Shapes, counts: np.ndarray, means: np.ndarray,
                expected: float | None, longest: float, interval: float, stated_sd: float | None) -> Noise:
    r"""Average over white noise, AR(1) noise and their sum, each as likely as the others beforehand.

    The logarithm of the likelihood is $-\sum_k n_k(\log s_k + p_k/s_k)$ with $s_k = \sigma^2 S_k(\rho, w)$. The
    size $\sigma$ is profiled; correlation times are as likely in every decade, shares in every tenth.

    Args:
        shape: $S$ of correlations and shares, shape (nodes,) each, at unit variance: shape (nodes, terms).
        log_level: logarithm of the power at unit variance where it has to be known: shape (nodes,).
        counts: weights $n_k$, shape (terms,).
        means: observed $p_k$, shape (terms,).
        expected: standard deviation that is stated, or None.
        longest: correlation time [samples] beyond which noise would be a drift.
        interval, stated_sd: as in `Noise`.
    """
    def weigh(correlation, white_share, volume):
        return _Nodes(correlation, white_share, *_profile(shape(correlation, white_share), counts, means, expected),
                      volume)

    kinds = [weigh(np.zeros(1), np.zeros(1), 1.0), *(_search(weigh, longest, mixed) for mixed in (False, True))]
    evidence = np.array([kind.log_evidence for kind in kinds])
    chance = np.exp(evidence - np.logaddexp.reduce(evidence))
    within = [np.exp(kind.loss.min() - kind.loss) for kind in kinds]
    weight = np.concatenate([c * w / w.sum() for c, w in zip(chance, within, strict=True)])
    level = np.concatenate([2.0 * k.log_sd + log_level(k.correlation, k.white_share) for k in kinds])
    mean = float(np.sum(weight * level))
    error = np.concatenate([2.0 * k.log_sd_error for k in kinds])
    variance = float(np.sum(weight * (error**2 + (level - mean) ** 2)))
    # It stands for all: near their mean level, of a likely kind, and likely within it.
    unlikely = np.concatenate([k.loss - k.loss.min() - np.log(c) for c, k in zip(np.maximum(chance, 1e-300), kinds,
                                                                                 strict=True)])
    best = int(np.argmin((level - mean) ** 2 / variance + 2.0 * unlikely))
    sd, rho, white = (np.concatenate([getattr(k, name) for k in kinds])[best]
                      for name in ("log_sd", "correlation", "white_share"))
    sd, rho, white = float(np.exp(sd)), float(rho), float(white)
    text = (f"correlated along the trace ({rho:.2f}), {100 * white:.0f} % of its power white" if white else
            f"correlated along the trace ({rho:.2f} from sample to sample)") if rho > 0 else "white"
    if stated_sd is not None and abs(np.log(sd / stated_sd)) > 0.1:
        text += f"; its size {sd:.3g} is not the stated {stated_sd:.3g}"
    return Noise(sd, rho, white, interval, stated_sd, float(np.sqrt(variance + (level[best] - mean) ** 2)), text)


def _search(weigh, longest: float, mixed: bool) -> _Nodes:
    """Nodes over the part of the prior that the samples leave, found by looking ever closer."""
    box = np.array([[np.log(SHORTEST), np.log(longest)], [0.0, 1.0]])
    whole = box[0, 1] - box[0, 0]
    for left in reversed(range(ROUNDS)):
        size = (box[:, 1] - box[:, 0]) / NODES
        axes = [low + step * (np.arange(count) + 0.5)
                for low, step, count in zip(box[:, 0], size, NODES, strict=True)]
        time, share = np.meshgrid(axes[0], axes[1] if mixed else np.zeros(1), indexing="ij")
        volume = size[0] / whole * (size[1] if mixed else 1.0)
        found = weigh(np.exp(-np.exp(-time.ravel())), share.ravel(), volume)
        near = (found.loss < found.loss.min() + FAR).reshape(time.shape)
        inside = [np.flatnonzero(near.any(axis=1)), np.flatnonzero(near.any(axis=0))][: 1 + mixed]
        if left == 0 or all(i[-1] - i[0] > 0.5 * n for i, n in zip(inside, NODES, strict=False)):
            return found
        for k, i in enumerate(inside):
            low, high = box[k]
            box[k] = max(low, axes[k][i[0]] - 2.0 * size[k]), min(high, axes[k][i[-1]] + 2.0 * size[k])
    raise AssertionError


def _profile(shape: np.ndarray, counts: np.ndarray, means: np.ndarray,
             expected: float | None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Loss at the best size of every node, the logarithm of that size and its error, shape (nodes,) each."""
    total = counts.sum()
    loss = np.log(shape) @ counts
    ratio = (1.0 / shape) @ (counts * means)
    log_sd = 0.5 * np.log(ratio / total)
    if expected is not None:  # it weighs 1 / STATED^2; the loss is convex in it: Newton's method from above
        log_sd = np.full_like(log_sd, np.log(expected))
        for _ in range(50):
            part = ratio * np.exp(-2.0 * log_sd)
            slope = 2.0 * (total - part) + (log_sd - np.log(expected)) / STATED**2
            step = slope / (4.0 * part + 1.0 / STATED**2)
            log_sd = log_sd - np.clip(step, -0.5, 0.5)
            if np.max(np.abs(step)) < 1e-10:
                break
        loss = loss + 0.5 * ((log_sd - np.log(expected)) / STATED) ** 2
    part = ratio * np.exp(-2.0 * log_sd)
    loss = loss + 2.0 * total * log_sd + part
    return loss, log_sd, 1.0 / np.sqrt(4.0 * part + (STATED**-2 if expected is not None else 0.0))


def whitening(noise: Noise, time: np.ndarray, valid: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Best linear prediction of each sample from the `TAPS` before it.

    Args:
        noise: the noise.
        time: of the samples, shape (samples,) [s].
        valid: False for missing samples, shape (samples,).

    Returns:
        Weights, shape (samples,): 1/sd of what cannot be predicted (0 for missing samples); and taps, shape
        (samples, TAPS): the whitened value is weight * (x_t - sum_k taps[t, k] x_{t-1-k}).
    """
    n = len(time)
    weights, taps = np.where(valid, 1.0 / noise.sd, 0.0), np.zeros((n, TAPS))
    if noise.correlation <= 0 or n < 2:
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
        among = noise.covariance(times[:, :, None] - times[:, None, :]) + 1e-12 * noise.sd**2 * np.eye(TAPS)
        among = np.where(there[:, :, None] & there[:, None, :], among, noise.sd**2 * np.eye(TAPS))
        to = np.where(there, noise.covariance(times - time[t, None]), 0.0)
        found[k: k + BATCH] = np.linalg.solve(among, to[..., None])[..., 0]
        left = noise.sd**2 - np.sum(found[k: k + BATCH] * to, axis=1)
        scale[k: k + BATCH] = 1.0 / np.sqrt(np.maximum(left, 1e-6 * noise.sd**2))
    taps[rows], weights[rows] = found[which], scale[which]
    return weights, taps


def whitening_matrix(weights: np.ndarray, taps: np.ndarray) -> sparse.csr_matrix:
    """A whitening filter as a banded matrix, shape (samples, samples)."""
    found = sparse.diags(weights)
    for k in range(1, min(TAPS, len(weights) - 1) + 1) if taps.any() else ():
        found = found - sparse.diags((weights * taps[:, k - 1])[k:], -k)
    return sparse.csr_matrix(found)


def whiten(weights: np.ndarray, taps: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Apply a whitening filter along axis 0 of `x`, shape (samples, ...)."""
    y = x.copy()
    for k in range(TAPS):
        y[k + 1:] -= taps[k + 1:, k].reshape(-1, *[1] * (x.ndim - 1)) * x[: -k - 1]
    return y * weights.reshape(-1, *[1] * (x.ndim - 1))
