"""The ensemble's independent proposals, adapted to the posterior after the burn-in.

Where one t about the first draws is not close to the posterior, as this is bent or long in one direction, a few rounds
of importance sampling make a mixture that is (population Monte Carlo with the weights of the deterministic mixture:
Cappe et al. 2004, Elvira et al. 2019). Every draw of every round has the weight

$$ w = p(x) / \\sum_r q_r(x), $$

and the parts of the next proposal are clusters of draws that are chosen by these. Walkers move after that only, so
that whatever comes out here changes how fast they go, not where to.
"""

from collections.abc import Callable

import numpy as np
from scipy.cluster.vq import kmeans2

from .moves import Mixture, Proposal, start_proposal
from .target import AbstractTarget


FEW, MANY = 0.5, 0.9  # share of independent moves; many where the proposal is close to the posterior
ENOUGH = 0.33  # effective over drawn, of a round, from which on it is
ROUNDS = 8
PARTS = 16  # of a mixture at most
EACH = 12  # draws in a part at least, for every coordinate
COLD, HOT = 0.75, 5  # portion of the parts that follow the posterior, and number of those that follow it flattened
FLATTER = 0.4  # to which power
SHRINK = 0.5  # of a proposal's width



def start_mixture(target: AbstractTarget) -> Mixture:
    """The proposal by the fit's covariance."""
    return Mixture([start_proposal(target)], np.ones(1))


def adapt_mixture(target: AbstractTarget, density: Callable[[np.ndarray], np.ndarray], draws: np.ndarray,
                  seed: np.random.SeedSequence) -> tuple[Mixture, float]:
    """The proposal by draws of the first steps, and the share of moves that it is to make; by the fit if these are few.

    Draws of the first steps do not tell how good a proposal made from them is, as neither has been in the tails yet:
    that is what a round of importance sampling is for.

    Args:
        target: what is sampled.
        density: logarithm of it, from shape (points, free) to (points,).
        draws: shape (draws, free); so many more are made in every round.
        seed: of the random numbers.
    """
    count, free = draws.shape
    if count < 20 * free or not np.all(draws.std(axis=0) > 0):
        return start_mixture(target), FEW
    rng = np.random.RandomState(seed.generate_state(8))
    first = Proposal(draws.mean(axis=0), np.atleast_2d(np.cov(draws.T)), target.low, target.high)
    now = best = Mixture([first], np.ones(1))
    reached, points, values, used = 0.0, [], [], []
    for _ in range(ROUNDS):
        points.append(now.draw(count, rng))
        values.append(density(points[-1]))
        used.append(now)
        share = _count(values[-1] - now.log_density(points[-1])) / count
        if share > reached:
            best, reached = now, share
        if reached >= ENOUGH:
            break
        x, p = np.concatenate(points), np.concatenate(values)
        logs = np.where(np.isfinite(p), p, -np.inf) - np.logaddexp.reduce([one.log_density(x) for one in used], axis=0)
        if _count(logs) < 2 * free:  # hardly any draw counts: the proposal is too wide
            now = Mixture([Proposal(now.parts[0].mean, SHRINK**2 * now.parts[0].covariance, target.low, target.high)],
                          np.ones(1))
        else:
            flat = logs - (1.0 - FLATTER) * np.where(np.isfinite(p), p, 0.0)
            now = _join((COLD, _cluster(_choose(x, logs, count, rng), first, PARTS - HOT, rng)),
                        (1.0 - COLD, _cluster(_choose(x, flat, count, rng), first, HOT, rng)))
    return best, MANY if reached >= ENOUGH else FEW


def _weigh(logs: np.ndarray) -> np.ndarray:
    """Weights with sum 1; zero where the density is."""
    finite = np.isfinite(logs)
    if not finite.any():
        return np.zeros(len(logs))
    w = np.where(finite, np.exp(logs - logs[finite].max()), 0.0)
    return w / w.sum()


def _count(logs: np.ndarray) -> float:
    """Effective number of weighted draws."""
    square = np.sum(_weigh(logs) ** 2)
    return 1.0 / square if square > 0 else 0.0


def _choose(x: np.ndarray, logs: np.ndarray, count: int, rng) -> np.ndarray:
    """Draws by their weights, the largest cut off (Ionides 2008), systematically, shape (count, free)."""
    w = _weigh(logs)
    w = np.minimum(w, len(w) ** -0.5)
    places = (np.arange(count) + rng.random_sample()) / count
    return x[np.minimum(np.searchsorted(np.cumsum(w) / w.sum(), places), len(x) - 1)]


def _cluster(x: np.ndarray, like: Proposal, most: int, rng) -> Mixture:
    """A mixture with a part for every cluster of draws."""
    free = x.shape[1]
    number = int(np.clip(len(np.unique(x, axis=0)) // (2 * EACH * free), 1, most))
    label = np.zeros(len(x), dtype=int)
    if number > 1:
        factor = np.linalg.cholesky(np.atleast_2d(np.cov(x.T)))
        _, label = kmeans2(np.linalg.solve(factor, (x - x.mean(axis=0)).T).T, number, minit="++",
                           rng=np.random.default_rng(rng.randint(2**31)))
    groups = [x[label == k] for k in range(number)]
    groups = [own for own in groups if len(np.unique(own, axis=0)) >= EACH * free] or [x]
    parts = [Proposal(own.mean(axis=0), np.atleast_2d(np.cov(own.T)), like.low, like.high) for own in groups]
    portions = np.array([len(own) for own in groups], dtype=float)
    return Mixture(parts, portions / portions.sum())


def _join(*pairs: tuple[float, Mixture]) -> Mixture:
    """One mixture of several, each with its portion."""
    return Mixture([part for _, one in pairs for part in one.parts],
                   np.concatenate([portion * one.portions for portion, one in pairs]))
