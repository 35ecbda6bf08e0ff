r"""Random effects: how far specimens differ beyond their errors, from one estimate and its standard error of each.

$\theta_i \sim N(\mu, \tau^2 + s_i^2)$ with known $s_i$ and weights $w_i = 1/(\tau^2 + s_i^2)$.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy import optimize

from . import distributions as stats
from .variance_components import EXCLUDED, lose_restricted


POINTS = 100  # of the integral over spreads
FEWEST = 4  # specimens with which a spread has an interval worth telling: below, it spans more than a factor of ten


class Homogeneity(NamedTuple):
    """Cochran's test of estimates being equal but for their errors."""

    q: float
    degrees: int
    p_value: float


class RandomEffects(NamedTuple):
    """What estimates of several specimens tell about all such specimens; in the unit of the estimates."""

    mean: float
    mean_sd: float
    mean_interval: tuple[float, float]  # 95 %
    spread: float  # tau, by restricted likelihood
    spread_interval: tuple[float, float]  # 95 %; from 0 to infinity where there are fewer than `FEWEST` specimens
    p_value: float  # of tau = 0, by the restricted likelihood ratio
    homogeneity: Homogeneity  # the same by Cochran's Q
    # shrunken, shrunken_sd: the specimens' best estimates given all others, and their errors, shape (specimens,).
    shrunken: np.ndarray
    shrunken_sd: np.ndarray


def measure_heterogeneity(estimates: ArrayLike, sds: ArrayLike, spread: float = 0.0) -> Homogeneity:
    r"""Cochran's $Q = \sum w_i (\theta_i - \bar\theta)^2$ of estimates of one thing, $\chi^2_{k-1}$ where their errors
    and a `spread` are all by which they differ (Cochran 1954, Biometrics 10, 101).
    """
    theta, weights = np.asarray(estimates, dtype=float), 1.0 / (np.asarray(sds, dtype=float) ** 2 + spread**2)
    q = float(weights @ (theta - weights @ theta / weights.sum()) ** 2)
    return Homogeneity(q, len(theta) - 1, float(stats.chi2.sf(q, len(theta) - 1)))


def estimate_random_effects(estimates: ArrayLike, sds: ArrayLike) -> RandomEffects:
    r"""Mean and spread of specimens from their estimates and standard errors, shape (specimens,), two or more.

    The spread maximises the restricted likelihood. Its interval is that of the Q profile, all $\tau$ under which
    $Q(\tau)$ lies between the 2.5 and 97.5 % quantiles of $\chi^2_{k-1}$ (Viechtbauer 2007, Stat. Med. 26, 37); where
    the estimates differ by less than their errors would have it, so that no $\tau$ does, it ends where the restricted
    likelihood excludes more. The likelihood ratio of $\tau = 0$, at the edge of what $\tau$ may be, is 0 or $\chi^2_1$
    with a chance of one half each (Self & Liang 1987, JASA 82, 605). The interval of the mean is Student's, with the
    factor of Hartung & Knapp (2001, Stat. Med. 20, 3875) where it is above 1. The specimens' estimates are means over
    all $\tau$, which a priori are alike (Gelman 2006, Bayesian Anal. 1, 515): with the best one alone, their errors
    would be too small where it is 0.
    """
    theta, errors = np.asarray(estimates, dtype=float), np.asarray(sds, dtype=float)
    count, ones = len(theta), np.ones(len(theta))

    def lose(spread: float) -> float:
        return lose_restricted([(np.diag(errors**2 + spread**2), np.stack([ones, theta], axis=1))])

    def solve(function, first: float) -> float:
        """Where a function that is positive at `first` and falls to below 0 is 0."""
        last = first + 1e-3 * float(errors.min())
        while function(last) > 0:
            last = first + 2.0 * (last - first)
        found: Any = optimize.brentq(function, first, last, xtol=1e-6 * last)
        return float(found)

    most = 2.0 * float(np.ptp(theta)) + 1e-3 * float(errors.min())  # no stationary point lies beyond
    best: Any = optimize.minimize_scalar(lose, bounds=(0.0, most), method="bounded", options={"xatol": 1e-6 * most})
    ratio = lose(0.0) - float(best.fun)
    spread = float(best.x) if ratio > 1e-6 else 0.0
    ends = [0.0, np.inf]
    if count >= FEWEST:
        for k, quantile in enumerate(stats.chi2.ppf([0.975, 0.025], count - 1)):
            above = lambda tau, edge=quantile: measure_heterogeneity(theta, errors, tau).q - edge
            ends[k] = solve(above, 0.0) if above(0.0) > 0 else 0.0
        if ends[1] == 0.0:
            ends[1] = solve(lambda tau: lose(spread) + EXCLUDED - lose(tau), spread)
    weights = 1.0 / (errors**2 + spread**2)
    mean, factor = float(weights @ theta / weights.sum()), measure_heterogeneity(theta, errors, spread).q / (count - 1)
    sd = float(np.sqrt(max(factor, 1.0) / weights.sum()))
    half = sd * float(stats.t.ppf(0.975, count - 1))
    shrunken, shrunken_sd = _average_shrunken(theta, errors, lose, 2.0 * ends[1] if np.isfinite(ends[1]) else most)
    return RandomEffects(
        mean, sd, (mean - half, mean + half), spread, (ends[0], ends[1]),
        0.5 * float(stats.chi2.sf(ratio, 1)) if spread > 0 else 1.0, measure_heterogeneity(theta, errors), shrunken,
        shrunken_sd)


def _average_shrunken(theta: np.ndarray, errors: np.ndarray, lose: Callable[[float], float], top: float
                      ) -> tuple[np.ndarray, np.ndarray]:
    """Means and standard deviations of the specimens' values over spreads up to `top`, by their likelihood."""
    spreads = np.linspace(0.0, top, POINTS)
    losses = np.array([lose(float(spread)) for spread in spreads])
    chance = np.exp(-0.5 * (losses - losses.min()))[:, None]
    weights = 1.0 / (errors**2 + spreads[:, None] ** 2)
    total = weights.sum(axis=1, keepdims=True)
    mean, kept = (weights @ theta)[:, None] / total, spreads[:, None] ** 2 * weights
    values, variances = mean + kept * (theta - mean), kept * errors**2 + (1.0 - kept) ** 2 / total
    best = (chance * values).sum(axis=0) / chance.sum()
    return best, np.sqrt((chance * (variances + (values - best) ** 2)).sum(axis=0) / chance.sum())
