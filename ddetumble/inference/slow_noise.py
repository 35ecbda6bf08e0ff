"""Slow noise: a baseline that wanders, from the residuals of a model that is believed."""

import dataclasses as dc
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from scipy import linalg, optimize
from scipy.sparse.linalg import spsolve_triangular

from .noise import Noise, whitening_matrix
from .problem import Solution
from .stack import Records


TIMES = (0.1, 0.3, 1.0, 10.0)  # correlation times over the length of a record: from noise to an offset
MOST = 240  # samples of a record that are looked at: what is slow does not need more
RANGE = (0.05, 50.0)  # size over that of the noise: less does not matter, more no gauge shows


def add_slow_noise(records: Records, solution: Solution, noise: Mapping[str, Noise], worth: float) -> dict[str, Noise]:
    r"""The noise of every channel with a slow part, where one is beyond doubt; none of it may be missing physics.

    The restricted likelihood of $y_r = S_r \theta + J_r z_r + b_r + e_r$: residuals of a linearised fit with free
    parameters $\theta$, settings $z_r \sim N(0, I)$, the noise as it is known, and an Ornstein-Uhlenbeck baseline
    $b_r$, whose size and correlation time are fitted; `worth` is the logarithm of the likelihood that it has to bring.
    """
    found = dict(noise)
    for c, channel in enumerate(records.channels):
        parts = _gather_rows(records, solution, noise[channel], c)
        if not parts:
            continue
        none = _lose(-np.inf, 1.0, parts)
        length = float(np.median([time[-1] - time[0] for time, *_ in parts]))
        low, high = (np.log(noise[channel].sd * x) for x in RANGE)
        best, size, slowest = none, 0.0, 1.0
        for share in TIMES:
            one: Any = optimize.minimize_scalar(_lose, args=(share * length, parts), bounds=(low, high),
                                                method="bounded", options={"xatol": 0.05})
            if one.fun < best:
                best, size, slowest = float(one.fun), float(np.exp(one.x)), share * length
        if none - best > 2.0 * worth:
            found[channel] = dc.replace(
                noise[channel], slow_sd=size, slow_time=slowest,
                text=f"{noise[channel].text}; beside it a baseline that wanders by {size:.2g} (SI)")
    return found


def _gather_rows(records: Records, solution: Solution, noise: Noise, c: int) -> list[tuple[np.ndarray, ...]]:
    """Times, covariance of the noise with that of the settings, and free columns with the residuals, by record."""
    stack, found = records.stack, []
    time, weights, taps, values = (np.asarray(x) for x in (stack.time, stack.weights, stack.taps, stack.values))
    size = time.shape[1]
    for r, n in enumerate(records.lengths):
        valid = np.flatnonzero(weights[r, c, :n] > 0)
        if len(valid) < 8:
            continue
        filter_ = whitening_matrix(weights[r, c, :n], taps[r, c, :n])[valid][:, valid].tocsr()
        rows = slice(c * size, c * size + n)
        columns = np.concatenate([solution.own[r, rows], solution.shared[r, rows]], axis=1)[valid]
        columns = spsolve_triangular(filter_, columns, lower=True)
        few = slice(None, None, -(-len(valid) // MOST))
        kept, columns = valid[few], columns[few]
        own = columns[:, : solution.own.shape[2]]
        residual = (solution.channels[r, c] - values[r, c])[kept] - own @ solution.z[r]
        t, key = time[r, kept], records.keys[r]
        sizes = noise.sizes[key][kept] if key in noise.sizes else np.ones(len(kept))
        covariance = noise.covariance(t[:, None] - t) * sizes[:, None] * sizes + own @ own.T
        found.append((t, covariance, np.concatenate([columns[:, own.shape[1]:], residual[:, None]], axis=1)))
    return found


def _lose(logarithm: float, slow: float, parts: list[tuple[np.ndarray, ...]]) -> float:
    """Loss of a baseline of this size (its logarithm) and correlation time."""
    square = float(np.exp(logarithm)) ** 2
    return lose_restricted((covariance + square * np.exp(-np.abs(time[:, None] - time) / slow), columns)
                           for time, covariance, columns in parts)


def lose_restricted(parts: Iterable[tuple[np.ndarray, np.ndarray]], known: np.ndarray | float = 0.0) -> float:
    """Minus twice the logarithm of a restricted likelihood: of linear parameters that are free, and integrated out.

    `parts` are the covariance of every record's rows, shape (rows, rows), and in these rows the columns of the
    parameters, with the residuals last. `known` is what other rows, which are white, and priors add to their products.
    """
    cross, determinant = known, 0.0
    for covariance, columns in parts:
        factor = linalg.cholesky(covariance, lower=True)
        white = linalg.solve_triangular(factor, columns, lower=True)
        cross = cross + white.T @ white
        determinant += 2.0 * float(np.sum(np.log(np.diag(factor))))
    cross = np.asarray(cross)
    square, side, left = cross[:-1, :-1], cross[:-1, -1], float(cross[-1, -1])
    scale = np.sqrt(np.maximum(np.diag(square), 1e-300))
    if len(scale):
        values, vectors = np.linalg.eigh(square / np.outer(scale, scale))
        told = values > 1e-10 * values[-1]
        left -= float(np.sum((vectors.T @ (side / scale))[told] ** 2 / values[told]))
        determinant += float(np.sum(np.log(values[told])) + 2.0 * np.sum(np.log(scale)))
    return left + determinant
