"""White, autoregressive or both: every kind of noise weighed by what the samples say of it.

Above the contact's frequencies one kind often looks like another; below, where a missing force would act, they differ.
So none is chosen before the level there is known: it is averaged over all, and its error holds their differences.
"""

import dataclasses as dc
from collections.abc import Callable

import numpy as np


SHORTEST = 0.3  # correlation time [samples]
NODES = (48, 24)  # in correlation time and in the share that is white
ROUNDS = 8
FAR = 12.0  # below the best in the logarithm of the likelihood: no longer looked at
STATED = 0.01  # relative standard deviation of a size that a campaign states

Shapes = Callable[[np.ndarray, np.ndarray], np.ndarray]


@dc.dataclass(frozen=True)
class Weighing:
    """One noise that stands for all that were weighed, and how well they fix its level.

    Attributes:
        sd: standard deviation of one sample, SI.
        correlation: from sample to sample [-], 0 for white noise.
        white_share: share of the variance that is white beside the correlated part [-].
        log_level_sd: standard error of the logarithm of the power at the frequencies asked for.
    """

    sd: float
    correlation: float
    white_share: float
    log_level_sd: float


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
                expected: float | None, longest: float) -> Weighing:
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
    return Weighing(float(np.exp(sd)), float(rho), float(white), float(np.sqrt(variance + (level[best] - mean) ** 2)))


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
