r"""How well a posterior predicts conditions that it has not seen: expected log predictive density, one condition out.

For the records $y_g$ of condition g and all others $y_{-g}$,

$$ \ln p(y_g | y_{-g}) = \ln \int p(y_g | \theta)\, p(\theta | y_{-g})\, d\theta , $$

every record's nuisances integrated out in each factor. The integral is a mean over draws $\theta_s$ of a density q with
weights $p(\theta_s | y_{-g}) / q(\theta_s)$, smoothed by a Pareto tail (PSIS; Vehtari et al. 2024). First q is what the
draws came from, the posterior or a heavy-tailed Gaussian about the fit; where the shape k of the tail says that these
weights cannot be trusted, the model is fitted again without the condition and q is a mixture of two multivariate t,
about the fits with and without it.
"""

import dataclasses as dc
from collections.abc import Mapping
from typing import Any

import numpy as np

from .._display import Progress, stay_silent
from .._errors import ComputationError
from .proposal import Mixture, Part, describe_draws, seed_random
from .target import AbstractTarget


TRUSTED = 0.7  # shape of the Pareto tail up to which weights can be trusted (Vehtari, Gelman & Gabry 2017)
REFITTED = 256  # draws about fits with and without the condition: for a logarithm of the density to about a tenth
COSTLY = 4  # times fewer draws where each costs as much as the points of a sampled integral
WAYS = {"draws": "importance weights", "refit": "refit without it"}


@dc.dataclass(frozen=True)
class Score:
    """One condition left out."""

    conditions: Mapping[str, float]  # mean settings, SI
    records: tuple[str, ...]  # keys
    elpd: float  # logarithm of the predictive density of its records, from all others
    pareto_k: float  # shape of the tail of the weights
    way: str  # `draws`, reweighted, or `refit`, without the condition
    trusted: bool  # whether the weights that were used can be trusted


@dc.dataclass(frozen=True, eq=False)
class Scores:
    """All conditions, each left out once."""

    scores: tuple[Score, ...]
    elpd: float  # their sum
    standard_error: float  # of the sum, from the scatter between conditions
    text: str  # how they were computed

    @property
    def values(self) -> np.ndarray:
        """Of every condition, shape (conditions,)."""
        return np.array([one.elpd for one in self.scores])


def add_up(values: np.ndarray) -> tuple[float, float]:
    """Sum over conditions and its standard error from their scatter; infinite for a single one."""
    n = len(values)
    return float(np.sum(values)), float(np.sqrt(n) * np.std(values, ddof=1)) if n > 1 else np.inf


def smooth_weights(log_weights: np.ndarray, independent: float = 1.0) -> tuple[np.ndarray, float]:
    """Pareto-smoothed importance weights: logarithms of the normalised weights and the shape k of their tail, from
    logarithms, shape (draws,), -inf where the density is none, and the share of draws that count as independent.
    """
    from arviz_stats.base.array import array_stats

    alive = np.isfinite(log_weights)
    result = np.full(len(log_weights), -np.inf)
    if alive.sum() < 5:  # the fewest with which a tail has a shape
        return result, np.inf
    values = log_weights[alive]
    if np.ptp(values) < 1e-9:
        result[alive] = -np.log(len(values))
        return result, 0.0
    with np.errstate(all="ignore"):
        # It takes logarithms of what is left out, and weighs by their inverse.
        share: Any = float(np.clip(independent, 0.01, 1.0))
        smooth, k = (np.asarray(one, dtype=float) for one in array_stats.psislw(values.max() - values, r_eff=share))
    result[alive] = smooth - np.logaddexp.reduce(smooth)
    return result, float(k) if np.isfinite(k) else np.inf


def limit_shape(draws: int) -> float:
    """Shape of the tail that so many draws can bear: 0.7 for many, less for few (Vehtari et al. 2024)."""
    return min(TRUSTED, 1.0 - 1.0 / np.log10(max(draws, 20)))


def score_conditions(target: AbstractTarget, x: np.ndarray, likelihoods: np.ndarray, base: np.ndarray | None = None, *,
                     independent: float = 1.0, seed: int = 0, report: Progress = stay_silent) -> Scores:
    """Leave every condition out once, by draws, shape (draws, free), and likelihoods of parts, shape (draws, parts).

    `base` is the logarithm of the posterior over the density that the draws come from, shape (draws,), None for draws
    from the posterior; `independent` the share of them that count as independent; `seed` is of draws about refits.
    """
    base = np.zeros(len(x)) if base is None else base
    numbers = np.unique(target.groups)
    whole = describe_draws(x, smooth_weights(base, independent)[0], target.covariance)
    found = []
    for k, g in enumerate(numbers):
        report("leaving conditions out", k / len(numbers))
        out = target.groups == g
        own = likelihoods[:, out].sum(axis=1)
        (elpd, shape, trusted), way = _average(base - own, own, independent), "draws"
        if not trusted and len(numbers) > 1:
            again = _refit(target, out, whole, seed_random(seed, 3, int(g)))
            if again is not None and (again[2] or not again[1] > shape):
                (elpd, shape, trusted), way = again, "refit"
        keys = tuple(part for part, gone in zip(target.parts, out, strict=True) if gone)
        found.append(Score(target.conditions[k], keys, elpd, shape, way, trusted))
    refits, doubtful = sum(one.way == "refit" for one in found), sum(not one.trusted for one in found)
    text = (f"{len(found)} conditions were each left out once: {len(found) - refits} by Pareto-smoothed importance "
            f"sampling, {refits} by a refit where these weights were unreliable")
    if doubtful:
        text += f"; {doubtful} of them remain unreliable, as one condition determines what the others do not"
    return Scores(tuple(found), *add_up(np.array([one.elpd for one in found])), text)


def _average(log_weights: np.ndarray, own: np.ndarray, independent: float) -> tuple[float, float, bool]:
    """Predictive density with weights, the shape of their tail, and whether that can be trusted."""
    smooth, k = smooth_weights(np.where(np.isfinite(own), log_weights, -np.inf), independent)
    alive = np.isfinite(smooth)
    if not alive.any():
        return -np.inf, np.inf, False
    return (float(np.logaddexp.reduce(smooth[alive] + own[alive])), k,
            bool(k <= limit_shape(int(alive.sum() * independent))))


def _refit(target: AbstractTarget, out: np.ndarray, whole: Part, random: np.random.RandomState
           ) -> tuple[float, float, bool] | None:
    """The same from draws about a fit without some parts, and about that of all; None where the fit says nothing.

    The predictive density is the ratio of two integrals, with and without the parts: each is covered by a half of the
    draws, whose density is the mixture of the two.
    """
    try:
        found = target.fit_without(out)
    except ComputationError:
        return None
    if found is None:
        return None
    halves, best = [found, whole], None
    for _ in range(2):
        proposal = Mixture(halves, target.low, target.high)
        x = proposal.spread(REFITTED // COSTLY if target.costly else REFITTED, random)
        if not len(x):
            return best
        likelihoods = target.likelihoods(x)
        own, rest = likelihoods[:, out].sum(axis=1), likelihoods[:, ~out].sum(axis=1)
        weights = target.prior(x) + rest - proposal.log_density(x)
        weights, both = (np.where(np.isfinite(w), w, -np.inf) for w in (weights, weights + own))
        smooth, k = smooth_weights(weights)
        posterior, k_both = smooth_weights(both)
        alive = np.isfinite(smooth) & np.isfinite(own)
        if not alive.any():
            return best
        worst = max(k, k_both)
        if best is None or worst < best[1]:
            best = (float(np.logaddexp.reduce(smooth[alive] + own[alive])), worst, bool(worst <= limit_shape(len(x))))
        if best[2]:
            break
        halves = [describe_draws(x, w, one[1]) for w, one in zip((smooth, posterior), halves, strict=True)]
    return best
