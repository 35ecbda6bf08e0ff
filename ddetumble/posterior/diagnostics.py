r"""Whether chains are long enough: autocorrelation time, effective size and R-hat of independent ensembles.

Walkers of one ensemble move by each other's places, so that they are no independent chains, and an ensemble can widen
and narrow as a whole. The effective size is therefore that of the mean over the walkers $m_t$ (Goodman and Weare 2010),
$n \operatorname{Var}(x) / (\tau_m \operatorname{Var}(m_t))$ over n steps, with the autocorrelation time $\tau_m$ of
$m_t$, for x and for its distance from the median (which tells of the tails), the smaller one. R-hat (split,
rank-normalised; Vehtari et al. 2021) compares the ensembles, which are independent.
"""

import dataclasses as dc
from typing import Any

import emcee
import numpy as np


AGREE = 1.01  # R-hat below which ensembles agree (Vehtari et al. 2021)
# Autocorrelation times that a chain has to be long, for their estimate to be trusted (emcee's documentation).
TIMES = 50.0
FEWEST = 8  # steps, in halves of halves of which there is still a variance


@dc.dataclass(frozen=True, eq=False)
class Convergence:
    """How good chains are."""

    steps: int  # of each ensemble
    times: np.ndarray  # steps of one walker worth one draw, longest over the ensembles, shape (free,)
    sizes: np.ndarray  # effective size of each parameter, shape (free,)
    rhats: np.ndarray  # R-hat of each parameter between the ensembles, shape (free,)
    effective: float  # worst of them
    rhat: float
    enough: bool  # whether the wanted size is reached, the ensembles agree, and steps are many autocorrelation times
    lacking: str  # what is not, in words


def measure_times(x: np.ndarray) -> np.ndarray:
    """Steps of a walker that are worth a draw, at least 1: of an ensemble, shape (steps, walkers, free) to (free,)."""
    found = []
    for one in (x, np.abs(x - np.median(x, axis=(0, 1)))):
        means = one.mean(axis=1, keepdims=True)
        with np.errstate(all="ignore"):
            times = np.ravel(emcee.autocorr.integrated_time(means, tol=0, quiet=True))
            worth = np.maximum(times, 1.0) * means.var(axis=(0, 1)) / one.var(axis=(0, 1)) * x.shape[1]
        found.append(np.where(np.isfinite(worth), worth, np.inf))
    return np.maximum(np.max(found, axis=0), 1.0)


def compare_ensembles(x: np.ndarray) -> np.ndarray:
    """R-hat of every parameter, shape (ensembles, steps, walkers, free) to (free,); infinite where it says nothing.

    Every ensemble is split into its halves; ranks of the draws and of their distances from the median both have to
    agree. The halves of a single ensemble are split once more.
    """
    from arviz_stats.base.array import array_stats

    ensembles, steps, _, free = x.shape
    with np.errstate(all="ignore"):
        found: Any = array_stats.rhat(x[:, steps % 2:].reshape(max(ensembles, 2), -1, free), 0, 1)
    return np.where(np.isfinite(found), found, np.inf)


def judge_chains(x: np.ndarray, wanted: float) -> Convergence:
    """Judge chains after their burn-in, shape (ensembles, steps, walkers, free)."""
    ensembles, steps, walkers, free = x.shape
    if steps < FEWEST:
        nothing = np.full(free, np.inf)
        return Convergence(steps, nothing, np.zeros(free), nothing, 0.0, np.inf, False, "there are too few steps")
    each, rhats = np.stack([measure_times(part) for part in x]), compare_ensembles(x)
    sizes = np.sum(steps * walkers / each, axis=0)
    lacking = []
    if sizes.min() < wanted:
        lacking.append(f"the effective sample size is {sizes.min():.0f}, but {wanted:.0f} is wanted")
    if rhats.max() >= AGREE:
        lacking.append(f"the ensembles differ (R-hat is {rhats.max():.3f}, but {AGREE} is wanted)")
    if steps < TIMES * each.max():
        lacking.append(f"{steps} steps are {steps / each.max():.0f} autocorrelation times, but {TIMES:.0f} are wanted")
    return Convergence(steps, each.max(axis=0), sizes, rhats, float(sizes.min()), float(rhats.max()), not lacking,
                       "; ".join(lacking))
