r"""Whether chains are long enough: effective size, autocorrelation time and R-hat of independent ensembles.

Walkers of one ensemble move by each other's places, so that they are no independent chains, and an ensemble can widen
and narrow as a whole. The effective size is therefore that of the mean over the walkers $m_t$ (Goodman and Weare 2010),
$n_m \operatorname{Var}(x) / \operatorname{Var}(m_t)$, where $n_m$ is the effective number of steps of $m_t$ in all
ensembles together, which counts what they differ by too (Gelman et al., Bayesian Data Analysis, 3rd ed., 11.5); for x
and for its distance from the median (which tells of the tails), the smaller one. R-hat (split, rank-normalised; Vehtari
et al. 2021) compares the ensembles, which are independent.
"""

import dataclasses as dc
from typing import Any

import numpy as np


AGREE = 1.01  # R-hat below which ensembles agree (Vehtari et al. 2021)
# Autocorrelation times that the ensembles have to be long, for their estimate to be trusted; together, as what they
# differ by is part of the estimate, and R-hat has to agree. With 50, means of Eq. 10 with long tails were off by 1.2
# times their stated errors in eight chains (emcee's documentation asks for 50 of a single ensemble).
TIMES = 100.0
FEWEST = 8  # steps, in halves of halves of which there is still a variance


@dc.dataclass(frozen=True, eq=False)
class Convergence:
    """How good chains are."""

    steps: int  # of each ensemble
    times: np.ndarray  # steps of one walker worth one draw, shape (free,)
    sizes: np.ndarray  # effective size of each parameter, shape (free,)
    rhats: np.ndarray  # R-hat of each parameter between the ensembles, shape (free,)
    effective: float  # worst of them
    rhat: float
    enough: bool  # whether the wanted size is reached, the ensembles agree, and steps are many autocorrelation times
    lacking: str  # what is not, in words


def measure_sizes(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Effective number of draws, and of steps of the ensembles' means, of every parameter.

    Args:
        x: draws, shape (ensembles, steps, walkers, free).

    Returns:
        Two arrays of shape (free,); 0 where a chain does not move.
    """
    from arviz_stats.base.array import array_stats

    ensembles, steps, walkers, _ = x.shape
    found: list[Any] = []
    for one in (x, np.abs(x - np.median(x, axis=(0, 1, 2)))):
        means = one.mean(axis=2)
        with np.errstate(all="ignore"):
            lengths: Any = array_stats.ess(means, chain_axis=0, draw_axis=1, method="mean")
            lengths = np.minimum(lengths, ensembles * steps)
            sizes = np.minimum(lengths * one.var(axis=(0, 1, 2)) / means.var(axis=(0, 1)), ensembles * steps * walkers)
        found.append(np.where(np.isfinite(sizes), [sizes, lengths], 0.0))
    sizes, lengths = np.min(found, axis=0)
    return sizes, lengths


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
    (sizes, lengths), rhats = measure_sizes(x), compare_ensembles(x)
    lacking = []
    if sizes.min() < wanted:
        lacking.append(f"the effective sample size is {sizes.min():.0f}, but {wanted:.0f} is wanted")
    if rhats.max() >= AGREE:
        lacking.append(f"the ensembles differ (R-hat is {rhats.max():.3f}, but {AGREE} is wanted)")
    if lengths.min() < TIMES:
        lacking.append(f"the ensembles are {lengths.min():.0f} autocorrelation times long together, but {TIMES:.0f} "
                       "are wanted")
    with np.errstate(divide="ignore"):
        times = ensembles * steps * walkers / sizes
    return Convergence(steps, times, sizes, rhats, float(sizes.min()), float(rhats.max()), not lacking,
                       "; ".join(lacking))
