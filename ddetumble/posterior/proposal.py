"""Independent proposals: mixtures of multivariate t, adapted to a posterior by its first draws.

Where one t about the first draws is not close to the posterior, as this is bent or long in one direction, a few rounds
of importance sampling make a mixture that is (population Monte Carlo with the weights of the deterministic mixture:
Cappe et al. 2004, Elvira et al. 2019). Every draw of every round has the weight

$$ w = p(x) / \\sum_r q_r(x), $$

and the parts of the next proposal are clusters of draws that are chosen by these. Walkers move after that only, so
that whatever comes out here changes how fast they go, not where to.
"""

from collections.abc import Callable, Sequence
from typing import final

import numpy as np
from scipy import special

from ..inference import distributions as stats
from .target import AbstractTarget


TAIL = 5.0  # degrees of freedom of the proposal: heavier tails than a Gaussian's, so that no weight runs off
# Than the Gaussian it is made from, of its two t: too wide a proposal is refused, too narrow a one misses tails.
WIDER = (1.1, 2.5)
SHARES = (0.85, 0.15)  # of these two: the wide one keeps the tails within reach
TRIES = 100  # draws in place of those outside the limits: where the share inside is not tiny, one is found
# Share of independent moves; many where the proposal is close to the posterior and they are accepted.
FEW, MANY = 0.5, 0.9
ENOUGH = 0.33  # effective over drawn, of a round, from which on it is
ROUNDS = 8  # in which the proposal is fitted to its own weighted draws: it ends by itself where it does not gain
PARTS = 16  # of a mixture at most: more have too few draws each
EACH = 12  # draws in a part at least, for every coordinate
COLD, HOT = 0.75, 5  # portion of the parts that follow the posterior, and number of those that follow it flattened
FLATTER = 0.4  # to which power: it reaches what the posterior itself hardly visits
SHRINK = 0.5  # of a proposal's width, where hardly any draw counts, as it is too wide: halved until some do
Part = tuple[np.ndarray, np.ndarray]  # mean, shape (free,), and covariance, shape (free, free)


@final
class Mixture:
    """Multivariate t within limits, two of one mean for each part, from which all walkers draw new places.

    Args:
        parts: mean and covariance of the Gaussian that each resembles.
        low, high: limits, shape (free,).
        portions: of the draws, shape (parts,), with sum 1; even where not given.
    """

    def __init__(self, parts: Sequence[Part], low: np.ndarray, high: np.ndarray, portions: np.ndarray | None = None):
        self.parts, self.low, self.high = tuple(parts), low, high
        self.portions = np.full(len(parts), 1.0 / len(parts)) if portions is None else portions
        self.factors = []
        for _, covariance in parts:
            scale = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
            correlation = covariance / np.outer(scale, scale) + 1e-10 * np.eye(len(scale))
            self.factors.append(scale[:, None] * np.linalg.cholesky(correlation))

    def log_density(self, x: np.ndarray) -> np.ndarray:
        """Up to a constant, shape (points, free) to (points,)."""
        free, found = x.shape[1], []
        for (mean, _), factor, portion in zip(self.parts, self.factors, self.portions, strict=True):
            square = np.sum(np.linalg.solve(factor, (x - mean).T) ** 2, axis=0)
            pair = [np.log(share) - free * np.log(wide) - 0.5 * (TAIL + free) * np.log1p(square / (TAIL * wide**2))
                    for share, wide in zip(SHARES, WIDER, strict=True)]
            found.append(np.log(portion) + np.logaddexp(*pair) - np.sum(np.log(np.diag(factor))))
        return np.logaddexp.reduce(found, axis=0)

    def draw(self, count: int, rng: np.random.RandomState) -> np.ndarray:
        """Points within the limits, shape (count, free); as good as a few tries make it."""
        found = self._draw(count, rng)
        for _ in range(TRIES):
            outside = np.any((found < self.low) | (found > self.high), axis=1)
            if not outside.any():
                break
            found[outside] = self._draw(int(outside.sum()), rng)
        return found

    def _draw(self, count: int, rng: np.random.RandomState) -> np.ndarray:
        which = np.searchsorted(np.cumsum(self.portions)[:-1], rng.random_sample(count), side="right")
        found = np.zeros((count, len(self.low)))
        for k in range(len(self.parts)):
            size = int(np.sum(which == k)) if k else count  # the first makes points in the place of all
            some = self._place(k, rng.standard_normal((size, len(self.low))), rng.random_sample(size),
                               rng.random_sample(size))
            found[which == k if k else slice(None)] = some
        return found

    def spread(self, count: int, rng: np.random.RandomState) -> np.ndarray:
        """Points spread more evenly than draws (scrambled Sobol), as many of each part, shape (some, free).

        Those beyond the limits are left out, so that the density of what remains is `log_density` with even portions,
        up to a constant that all proposals of one target share.
        """
        found = []
        for k in range(len(self.parts)):
            sobol = stats.qmc.Sobol(len(self.low) + 2, rng=np.random.default_rng(rng.randint(2**31)))
            u = np.clip(sobol.random(count // len(self.parts)), 1e-9, 1 - 1e-9)
            found.append(self._place(k, stats.norm.ppf(u[:, :-2]), u[:, -2], u[:, -1]))
        x = np.concatenate(found)
        return x[np.all((x >= self.low) & (x <= self.high), axis=1)]

    def _place(self, k: int, normal: np.ndarray, tail: np.ndarray, which: np.ndarray) -> np.ndarray:
        """Points of a part from standard normal numbers, shape (points, free), and two uniform ones each."""
        # A gamma variate by its inverse: every call uses as many random numbers, whichever machine.
        stretch = np.sqrt(special.gammaincinv(TAIL / 2, tail) * 2.0 / TAIL)
        wide = np.where(which < SHARES[0], *WIDER)
        return self.parts[k][0] + (normal @ self.factors[k].T) * (wide / stretch)[:, None]

    def __call__(self, coordinates: np.ndarray, rng) -> tuple[np.ndarray, np.ndarray]:
        """New places and the logarithm of the ratio of the proposal's densities there and here."""
        new = self.draw(len(coordinates), rng)
        return new, self.log_density(coordinates) - self.log_density(new)


def start_mixture(target: AbstractTarget) -> Mixture:
    """The proposal by the fit's covariance."""
    return Mixture([(target.centre, target.covariance)], target.low, target.high)


def seed_random(*numbers: int) -> np.random.RandomState:
    """Random numbers of their own for every purpose."""
    return np.random.RandomState(np.random.SeedSequence(numbers).generate_state(8))


def adapt_mixture(target: AbstractTarget, density: Callable[[np.ndarray], np.ndarray], draws: np.ndarray,
                  random: np.random.RandomState) -> tuple[Mixture, float]:
    """The proposal by draws of the first steps, shape (draws, free), and the share of moves that it is to make; by the
    fit if these are few. The logarithm of the density takes points of shape (points, free) to (points,).

    Draws of the first steps do not tell how good a proposal made from them is, as neither has been in the tails yet:
    that is what a round of importance sampling is for, of as many draws again.
    """
    count, free = draws.shape
    if count < 20 * free or not np.all(draws.std(axis=0) > 0):
        return start_mixture(target), FEW
    now = best = Mixture([describe_draws(draws)], target.low, target.high)
    reached, points, values, used = 0.0, [], [], []
    for _ in range(ROUNDS):
        points.append(now.draw(count, random))
        values.append(density(points[-1]))
        used.append(now)
        share = count_effective(values[-1] - now.log_density(points[-1])) / count
        if share > reached:
            best, reached = now, share
        if reached >= ENOUGH:
            break
        x, p = np.concatenate(points), np.concatenate(values)
        logs = np.where(np.isfinite(p), p, -np.inf) - np.logaddexp.reduce([one.log_density(x) for one in used], axis=0)
        if count_effective(logs) < 2 * free:  # hardly any draw counts: the proposal is too wide
            mean, covariance = now.parts[0]
            now = Mixture([(mean, SHRINK**2 * covariance)], target.low, target.high)
        else:
            flat = logs - (1.0 - FLATTER) * np.where(np.isfinite(p), p, 0.0)
            cold, many = _cluster(_choose(x, logs, count, random), PARTS - HOT, random)
            hot, some = _cluster(_choose(x, flat, count, random), HOT, random)
            now = Mixture(cold + hot, target.low, target.high, np.concatenate([COLD * many, (1.0 - COLD) * some]))
    return best, MANY if reached >= ENOUGH else FEW


def normalise(logs: np.ndarray) -> np.ndarray:
    """Weights with sum 1 from their logarithms, shape (draws,); all zero where no density is."""
    finite = np.isfinite(logs)
    if not finite.any():
        return np.zeros(len(logs))
    w = np.where(finite, np.exp(logs - logs[finite].max()), 0.0)
    return w / w.sum()


def count_effective(logs: np.ndarray) -> float:
    """Effective number of weighted draws, from the logarithms of the weights."""
    square = np.sum(normalise(logs) ** 2)
    return 1.0 / square if square > 0 else 0.0


def describe_draws(x: np.ndarray, logs: np.ndarray | None = None, fallback: np.ndarray | None = None) -> Part:
    """Mean and covariance of draws, with logarithms of their weights; the covariance given where they are too few."""
    if logs is None:
        return x.mean(axis=0), np.atleast_2d(np.cov(x.T))
    w = normalise(logs)
    mean = w @ x if w.any() else x.mean(axis=0)
    if fallback is not None and count_effective(logs) < 4 * x.shape[1]:
        return mean, fallback
    return mean, np.atleast_2d(np.cov(x.T, aweights=w))


def _choose(x: np.ndarray, logs: np.ndarray, count: int, random: np.random.RandomState) -> np.ndarray:
    """Draws by their weights, the largest cut off (Ionides 2008), systematically, shape (count, free)."""
    w = normalise(logs)
    w = np.minimum(w, len(w) ** -0.5)
    places = (np.arange(count) + random.random_sample()) / count
    return x[np.minimum(np.searchsorted(np.cumsum(w) / w.sum(), places), len(x) - 1)]


def _cluster(x: np.ndarray, most: int, random: np.random.RandomState) -> tuple[list[Part], np.ndarray]:
    """A part for every cluster of draws, and the portions of the draws in them."""
    free = x.shape[1]
    number = int(np.clip(len(np.unique(x, axis=0)) // (2 * EACH * free), 1, most))
    label = np.zeros(len(x), dtype=int)
    if number > 1:
        from scipy.cluster.vq import kmeans2  # whose import a command that draws nothing need not wait for

        factor = np.linalg.cholesky(np.atleast_2d(np.cov(x.T)))
        _, label = kmeans2(np.linalg.solve(factor, (x - x.mean(axis=0)).T).T, number, minit="++",
                           rng=np.random.default_rng(random.randint(2**31)))
    groups = [x[label == k] for k in range(number)]
    groups = [own for own in groups if len(np.unique(own, axis=0)) >= EACH * free] or [x]
    portions = np.array([len(own) for own in groups], dtype=float)
    return [describe_draws(own) for own in groups], portions / portions.sum()
