"""Moves of the ensemble: independent proposals from the fit's Gaussian with heavy tails, beside emcee's own."""

import emcee
import numpy as np
from scipy import special, stats

from .target import AbstractTarget


TAIL = 5.0  # degrees of freedom of the proposal
WIDER = (1.1, 2.5)  # than the Gaussian it is made from, of its two parts
PARTS = (0.85, 0.15)  # of these two: the wide one keeps the tails within reach
OTHERS = (0.7, 0.3)  # of differential evolution and stretch moves among those that are not independent
FEW, MANY = 0.5, 0.9  # share of independent moves; many where the proposal is close to the posterior
CLOSE = 1.0  # standard deviation of the logarithm of posterior over proposal, below which it is
TRIES = 100


class Proposal:
    """Two multivariate t about one mean within the limits, from which all walkers draw new places.

    Args:
        mean: shape (free,).
        covariance: of the Gaussian that it resembles, shape (free, free).
        low, high: limits, shape (free,).
        share: of independent moves among all.
    """

    def __init__(self, mean: np.ndarray, covariance: np.ndarray, low: np.ndarray, high: np.ndarray, share: float = FEW):
        self.share = share
        self.mean, self.covariance, self.low, self.high = mean, covariance, low, high
        scale = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
        correlation = covariance / np.outer(scale, scale) + 1e-10 * np.eye(len(scale))
        self.factor = scale[:, None] * np.linalg.cholesky(correlation)

    def log_density(self, x: np.ndarray) -> np.ndarray:
        """Up to a constant, shape (points, free) to (points,)."""
        y = np.linalg.solve(self.factor, (x - self.mean).T)
        square, free = np.sum(y**2, axis=0), len(self.mean)
        parts = [np.log(share) - free * np.log(wide) - 0.5 * (TAIL + free) * np.log1p(square / (TAIL * wide**2))
                 for share, wide in zip(PARTS, WIDER, strict=True)]
        return np.logaddexp(*parts)

    def draw(self, count: int, rng) -> np.ndarray:
        """Points within the limits, shape (count, free); as good as a few tries make it."""
        found = self._draw(count, rng)
        for _ in range(TRIES):
            outside = np.any((found < self.low) | (found > self.high), axis=1)
            if not outside.any():
                break
            found[outside] = self._draw(int(outside.sum()), rng)
        return found

    def _draw(self, count: int, rng) -> np.ndarray:
        return self.place(rng.standard_normal((count, len(self.mean))), rng.random_sample(count),
                          rng.random_sample(count))

    def spread(self, count: int, seed: int) -> np.ndarray:
        """Points spread more evenly than draws (scrambled Sobol), without those beyond the limits, shape (some, free).

        As those are left out, the density of what remains is `log_density`, up to a constant that all proposals of one
        target share.
        """
        u = stats.qmc.Sobol(len(self.mean) + 2, rng=np.random.default_rng(seed)).random(count)
        u = np.clip(u, 1e-9, 1 - 1e-9)
        x = self.place(stats.norm.ppf(u[:, :-2]), u[:, -2], u[:, -1])
        return x[np.all((x >= self.low) & (x <= self.high), axis=1)]

    def place(self, normal: np.ndarray, tail: np.ndarray, part: np.ndarray) -> np.ndarray:
        """Points of the density from standard normal numbers, shape (points, free), and two uniform ones each."""
        # A gamma variate by its inverse: every call uses as many random numbers, whichever machine.
        stretch = np.sqrt(special.gammaincinv(TAIL / 2, tail) * 2.0 / TAIL)
        wide = np.where(part < PARTS[0], *WIDER)
        return self.mean + (normal @ self.factor.T) * (wide / stretch)[:, None]

    def __call__(self, coordinates: np.ndarray, rng) -> tuple[np.ndarray, np.ndarray]:
        """New places and the logarithm of the ratio of the proposal's densities there and here."""
        new = self.draw(len(coordinates), rng)
        return new, self.log_density(coordinates) - self.log_density(new)


def start_proposal(target: AbstractTarget) -> Proposal:
    """The proposal by the fit's covariance."""
    return Proposal(target.centre, target.covariance, target.low, target.high)


def adapt_proposal(target: AbstractTarget, draws: np.ndarray, log_density: np.ndarray) -> Proposal:
    """The proposal by draws of the first steps; by the fit where they are too few.

    Args:
        target: the density.
        draws: shape (draws, free).
        log_density: of the target there, shape (draws,).
    """
    if len(draws) < 20 * draws.shape[1] or not np.all(draws.std(axis=0) > 0):
        return start_proposal(target)
    found = Proposal(draws.mean(axis=0), np.atleast_2d(np.cov(draws.T)), target.low, target.high)
    if np.std(log_density - found.log_density(draws)) < CLOSE:
        found.share = MANY
    return found


def mix_moves(proposal: Proposal) -> list[tuple[emcee.moves.Move, float]]:
    """The moves with the share of steps that each makes."""
    rest = 1.0 - proposal.share
    # No snooker move: emcee 3.1.6 weighs it with half the exponent that it needs, which narrows posteriors.
    return [(emcee.moves.MHMove(proposal), proposal.share), (emcee.moves.DEMove(), OTHERS[0] * rest),
            (emcee.moves.StretchMove(), OTHERS[1] * rest)]
