r"""What priors do to a posterior: how much they say beside the records, whether both agree, and what records the priors
alone expect.

With a Gaussian prior $N(m_0, \Sigma_0)$ of some coordinates, a likelihood that is nearly Gaussian, and mean and
covariance $m, \Sigma$ of their posterior,

* the prior gives the share $\Sigma_{kk}/\Sigma_{0,kk}$ of what is known about coordinate k (of its precision);
* under the prior, $m - m_0 \sim N(0, \Sigma_0 - \Sigma)$, so that $(m - m_0)^T (\Sigma_0 - \Sigma)^{-1} (m - m_0)$ is
  chi-square if priors and records agree (Evans and Moshonov 2006, prior-data conflict);
* posterior draws with weights $p_0(x)^{-3/4}$ are those under priors twice as wide (power scaling, Kallioinen et al.
  2024).
"""

import dataclasses as dc
from collections.abc import Mapping

import numpy as np

from .._sentences import say
from ..inference import distributions as stats
from ..measurement.quantities import format_share
from .loo import limit_shape, smooth_weights
from .predictive_check import Replicates, replicate
from .target import AbstractTarget, CampaignTarget


DRAWS = 200  # from the priors: a 95 % band is known to a fifth of its tails
LEVEL = 0.01  # p-value below which priors and records disagree
MOST = 0.5  # share of what is known about a parameter, from which its prior says more than the records
MOVED = 0.25  # standard deviations, by which a mean moves beyond what draws leave uncertain
WIDER = 2.0  # how many times as wide the priors are taken
LEARNT = 0.02  # share of a prior's variance that the records have to remove, or draws do not show whether both agree
TRIES = 50  # times as many draws from the priors as are wanted, where limits cut most of them off


@dc.dataclass(frozen=True)
class PriorInfluence:
    """What the priors do to one parameter."""

    prior: tuple[float, float, float] | None  # median and 95 % interval, in its public unit; None where it has none
    share: float  # of what is known about it that its prior gives, 0 to 1
    distance: float  # of the posterior's mean from the prior's, in standard deviations under the prior
    moved: float  # of its mean with all priors twice as wide, in standard deviations
    widened: float  # factor of its standard deviation then


@dc.dataclass(frozen=True, eq=False)
class PriorCheck:
    """What the priors do to a posterior."""

    parameters: Mapping[str, PriorInfluence]
    p_value: float  # of priors and records that agree being so far apart; 1 where the records add nothing to the priors
    rejected: bool  # whether they disagree
    pareto_k: float  # of the weights that widen the priors
    trusted: bool  # whether these can be relied on
    flat: tuple[str, ...]  # parameters with neither a prior nor two limits: no records can be drawn without the data
    inside: float | None  # share of the readings in the 95 % band of records drawn from the priors; None without such
    width: float | None  # rms of that band's half-width over that of the readings
    failed: float  # share of the draws from the priors at which the model could not be computed
    replicates: Replicates | None  # records drawn from the priors
    sentence: str


def check_priors(target: AbstractTarget, x: np.ndarray, independent: float = 1.0, seed: int = 0) -> PriorCheck | None:
    """What the Gaussian priors of a target do to its posterior, of which x are draws, shape (draws, free), a share of
    them `independent`; None where no parameter has one. The seed is of the draws from the priors.
    """
    names = [name for name in target.names if name in target.priors]
    if not names:
        return None
    mean, spread = x.mean(axis=0), np.atleast_2d(np.cov(x.T))
    own = [target.names.index(name) for name in names]
    before = np.array([target.priors[name] for name in names])
    distance, p_value = _measure_distance(mean[own] - before[:, 0], before[:, 1], spread[np.ix_(own, own)])
    log_prior = -0.5 * np.sum(((x[:, own] - before[:, 0]) / before[:, 1]) ** 2, axis=1)
    weights, shape = smooth_weights((WIDER**-2 - 1.0) * log_prior, independent)
    weights = np.exp(weights)
    moved = (weights @ x - mean) / np.sqrt(np.diag(spread))
    widened = np.sqrt(weights @ (x - weights @ x) ** 2 / np.diag(spread))
    found = {}
    for k, name in enumerate(target.names):
        prior, share, far = None, 0.0, 0.0
        if name in names:
            i = names.index(name)
            points = np.repeat(mean[None], 3, axis=0)
            points[:, k] = stats.truncnorm.ppf([0.5, 0.025, 0.975], *(
                (limit - before[i, 0]) / before[i, 1] for limit in (target.low[k], target.high[k])), *before[i])
            middle, low, high = map(float, target.publish(points)[:, k])
            prior = middle, low, high
            share, far = float(min(spread[k, k] / before[i, 1] ** 2, 1.0)), float(distance[i])
        found[name] = PriorInfluence(prior, share, far, float(moved[k]), float(widened[k]))
    flat = tuple(name for name, low, high in zip(target.names, target.low, target.high, strict=True)
                 if name not in names and not np.isfinite(high - low))
    inside = width = made = None
    failed = 0.0
    if isinstance(target, CampaignTarget) and not flat:
        made, failed = _replicate_priors(target, np.random.default_rng([seed, 11]))
        inside, width = _measure_band(made)
    checked = PriorCheck(found, p_value, p_value < LEVEL, shape, shape < limit_shape(int(independent * len(x))), flat,
                         inside, width, failed, made, "")
    own = {name: one for name, one in found.items() if one.prior is not None}
    return dc.replace(checked, sentence=str(say(
        "posterior.priors", found=checked, worst=max(own, key=lambda name: abs(own[name].distance)),
        ruled=[f"{name} ({format_share(one.share)})" for name, one in own.items() if one.share > MOST],
        farthest=max(found, key=lambda name: abs(found[name].moved)), least=MOVED)))


def _measure_distance(apart: np.ndarray, deviations: np.ndarray, spread: np.ndarray) -> tuple[np.ndarray, float]:
    """How far posterior means lie from the priors', each in deviations under its prior, and the p-value of all."""
    scaled = spread / np.outer(deviations, deviations)
    left = np.eye(len(apart)) - scaled
    values, vectors = np.linalg.eigh(left)
    told = values > LEARNT
    alone = np.diag(left)
    each = np.where(alone > LEARNT, apart / deviations / np.sqrt(np.maximum(alone, LEARNT)), 0.0)
    if not told.any():
        return each, 1.0
    square = float(np.sum((vectors.T @ (apart / deviations))[told] ** 2 / values[told]))
    return each, float(stats.chi2.sf(square, int(told.sum())))


def draw_priors(target: AbstractTarget, rng: np.random.Generator, count: int = DRAWS) -> np.ndarray:
    """Coordinates drawn from the priors within the limits, even between them where there is none, shape (count, free).

    Hardly any may lie within the limits: then there are fewer.
    """
    size = TRIES * count
    columns = [rng.normal(*target.priors[name], size) if name in target.priors else rng.uniform(low, high, size)
               for name, low, high in zip(target.names, target.low, target.high, strict=True)]
    x = np.stack(columns, axis=1)
    return x[target.holds(x)][:count]


def _replicate_priors(target: CampaignTarget, rng: np.random.Generator) -> tuple[Replicates | None, float]:
    """Records drawn from the priors, settings within their uncertainty, and the share that could not be computed."""
    x, records = draw_priors(target, rng), target.records
    if not len(x):
        return None, 1.0
    known = np.array([name not in records.starts for name in records.nuisances])
    z = rng.standard_normal((len(x), *target.plan.own.shape)) * known
    made, good = replicate(target, x, z, rng)
    return made, 1.0 - float(np.mean(good))


def _measure_band(made: Replicates | None) -> tuple[float | None, float | None]:
    """Share of the readings within the 95 % band of replicates, and its half-width over their rms."""
    if made is None or len(made.values) < 2:
        return None, None
    there = np.isfinite(made.measured)
    low, high = np.quantile(np.where(there, made.values, 0.0), [0.025, 0.975], axis=0)
    reading, low, high = made.measured[there], low[there], high[there]
    channel = np.broadcast_to(np.arange(len(made.channels))[:, None], made.measured.shape[1:])
    channel = np.broadcast_to(channel, made.measured.shape)[there]
    half = 0.5 * (high - low)
    ratios = [np.sqrt(np.mean(half[channel == c] ** 2) / max(np.mean(reading[channel == c] ** 2), 1e-300))
              for c in np.unique(channel)]
    return float(np.mean((reading >= low) & (reading <= high))), float(np.max(ratios))
