"""Moves of the ensemble: independent proposals from Gaussians with heavy tails, beside emcee's own."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import emcee
import numpy as np
from scipy import special, stats

from .target import AbstractTarget


TAIL = 5.0  # degrees of freedom of the proposal
WIDER = (1.1, 2.5)  # than the Gaussian it is made from, of its two parts
PARTS = (0.85, 0.15)  # of these two: the wide one keeps the tails within reach
OTHERS = (0.7, 0.3)  # of differential evolution and stretch moves among those that are not independent
TRIES = 100


class Proposal:
    """Two multivariate t about one mean within the limits, from which all walkers draw new places.

    Args:
        mean: shape (free,).
        covariance: of the Gaussian that it resembles, shape (free, free).
        low, high: limits, shape (free,).
    """

    def __init__(self, mean: np.ndarray, covariance: np.ndarray, low: np.ndarray, high: np.ndarray):
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
        return _draw_inside(self.draw_anywhere, count, rng, self.low, self.high)

    def draw_anywhere(self, count: int, rng) -> np.ndarray:
        """Points that the limits do not keep in, shape (count, free)."""
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


class Mixture:
    """Several proposals with the portion that each draws, as a posterior that is bent or has several hills needs them.

    Args:
        parts: at least one, all within the same limits.
        portions: of the draws, shape (parts,), with sum 1.
    """

    def __init__(self, parts: Sequence[Proposal], portions: np.ndarray):
        self.parts, self.portions = tuple(parts), np.asarray(portions, dtype=float)

    @classmethod
    def load(cls, state: Mapping[str, np.ndarray], low: np.ndarray, high: np.ndarray) -> "Mixture":
        """What `state` gave."""
        some = state["portion"] > 0.0
        return cls([Proposal(m, c, low, high) for m, c in zip(state["mean"][some], state["covariance"][some],
                                                              strict=True)], state["portion"][some])

    def state(self, most: int) -> dict[str, np.ndarray]:
        """Portions, means and covariances of so many parts, those that are not there with portion zero."""
        rest = most - len(self.parts)
        mean, covariance = (np.stack([getattr(one, name) for one in self.parts]) for name in ("mean", "covariance"))
        return {"portion": np.pad(self.portions, (0, rest)), "mean": np.pad(mean, ((0, rest), (0, 0))),
                "covariance": np.pad(covariance, ((0, rest), (0, 0), (0, 0)))}

    def log_density(self, x: np.ndarray) -> np.ndarray:
        """Up to a constant, shape (points, free) to (points,)."""
        return np.logaddexp.reduce([np.log(portion) + one.log_density(x) - np.sum(np.log(np.diag(one.factor)))
                                    for one, portion in zip(self.parts, self.portions, strict=True)], axis=0)

    def draw(self, count: int, rng) -> np.ndarray:
        """Points within the limits, shape (count, free); as good as a few tries make it."""
        return _draw_inside(self._draw, count, rng, self.parts[0].low, self.parts[0].high)

    def _draw(self, count: int, rng) -> np.ndarray:
        which = np.searchsorted(np.cumsum(self.portions)[:-1], rng.random_sample(count), side="right")
        found = self.parts[0].draw_anywhere(count, rng)
        for k, one in enumerate(self.parts[1:], start=1):
            mine = which == k
            found[mine] = one.draw_anywhere(int(mine.sum()), rng)
        return found

    def __call__(self, coordinates: np.ndarray, rng) -> tuple[np.ndarray, np.ndarray]:
        """New places and the logarithm of the ratio of the proposal's densities there and here."""
        new = self.draw(len(coordinates), rng)
        return new, self.log_density(coordinates) - self.log_density(new)


def _draw_inside(draw: Callable[[int, Any], np.ndarray], count: int, rng, low: np.ndarray, high: np.ndarray):
    found = draw(count, rng)
    for _ in range(TRIES):
        outside = np.any((found < low) | (found > high), axis=1)
        if not outside.any():
            break
        found[outside] = draw(int(outside.sum()), rng)
    return found


def start_proposal(target: AbstractTarget) -> Proposal:
    """The proposal by the fit's covariance."""
    return Proposal(target.centre, target.covariance, target.low, target.high)


def mix_moves(proposal: Mixture, share: float) -> list[tuple[emcee.moves.Move, float]]:
    """The moves with the share of steps that each makes.

    Args:
        proposal: of the independent moves.
        share: of these among all.
    """
    rest = 1.0 - share
    # No snooker move: emcee 3.1.6 weighs it with half the exponent that it needs, which narrows posteriors.
    return [(emcee.moves.MHMove(proposal), share), (emcee.moves.DEMove(), OTHERS[0] * rest),
            (emcee.moves.StretchMove(), OTHERS[1] * rest)]
