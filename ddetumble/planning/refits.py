r"""Rivals refitted to one another at many tests at once, and how the distance that is left changes with the conditions.

For rival B at a test where A is true, $d^2 = \min_{x,z} \|r_A - r_B(x, z)\|^2 + \|x\|^2 + \|z\|^2$ by
Levenberg-Marquardt. At the minimum the envelope theorem gives the exact gradient from first derivatives alone,
$\partial d^2/\partial c = 2 (r_A - r_B)^T (\partial r_A/\partial c - \partial r_B/\partial c)$.
"""

import dataclasses as dc

import numpy as np

from .preview import Columns, Layout, Test, compute_columns, count_rows
from .separation import balance


SETTLED = 1e-8  # relative fall of the squared distance below which a refit has ended; its gradient errs by the root


@dc.dataclass(frozen=True)
class Distances:
    """Squared distances of all ordered pairs of rivals at some tests.

    Attributes:
        pairs: (true, refitted) by number.
        squares: in noise variances, shape (pairs, tests).
        slopes: by the shares of the free limits, shape (pairs, tests, free).
        at: the rivals as they stand, `models` by `tests` items.
        rows: which rows count, shape (tests, rows).
        failed: tests at which a rival could not be computed, shape (tests,).
    """

    pairs: tuple[tuple[int, int], ...]
    squares: np.ndarray
    slopes: np.ndarray
    at: Columns
    rows: np.ndarray
    failed: np.ndarray


def part_rivals(layout: Layout, test: Test, x: np.ndarray, mask: np.ndarray, steps: int = 4) -> Distances:
    """Squared distance of every ordered pair of rivals, the second refitted to the first.

    Args:
        layout, test: of `prepare`.
        x: shares of the free limits, shape (tests, free).
        mask: 1 for channels that count, shape (channels,).
        steps: of a refit, at most.
    """
    count, rivals = len(x), test.base.shape[0]
    at = compute_columns(layout, test, np.repeat(np.arange(rivals), count), np.tile(x, (rivals, 1)))
    failed = at.failed.reshape(rivals, count).any(axis=0)
    rows = count_rows(layout, test, at.end.reshape(rivals, count).min(axis=0), mask)
    pairs = tuple((i, j) for i in range(rivals) for j in range(rivals) if i != j)
    if not pairs:
        return Distances((), np.zeros((0, count)), np.zeros((0, *x.shape)), at, rows, failed)
    truth = np.concatenate([np.arange(count) + i * count for i, _ in pairs])
    own = np.concatenate([np.arange(count) + j * count for _, j in pairs])
    which = np.repeat([j for _, j in pairs], count)
    place, keep = np.tile(x, (len(pairs), 1)), np.tile(rows, (len(pairs), 1))
    goal, first = at.reading[truth] * keep, _take(at, own)
    final, moves = _refit(layout, test, which, place, keep, goal, first, steps)
    left = goal - final.reading * keep
    squares = np.sum(left**2, axis=1) + np.sum(moves**2, axis=1)
    change = (at.chosen[truth] - final.chosen) * keep[..., None]
    slopes = 2.0 * np.einsum("ir,irc->ic", left, change)
    shape = (len(pairs), count)
    return Distances(pairs, squares.reshape(shape), slopes.reshape(*shape, -1), at, rows, failed)


def _take(at: Columns, items: np.ndarray) -> Columns:
    return Columns(*(field[items] for field in at))


def _refit(layout: Layout, test: Test, which: np.ndarray, place: np.ndarray, keep: np.ndarray, goal: np.ndarray,
           first: Columns, steps: int) -> tuple[Columns, np.ndarray]:
    """Levenberg-Marquardt of all items at once; columns and moves where each has the least distance."""
    slots = first.shared.shape[2]
    moves = np.zeros((len(which), slots + first.own.shape[2]))
    best, damping = first, np.full(len(which), 1e-6)
    cost = np.sum((goal - first.reading * keep) ** 2, axis=1)
    going = np.ones(len(which), dtype=bool)
    for _ in range(steps):
        columns = np.concatenate([best.shared, best.own], axis=2) * keep[..., None]
        pull = np.einsum("irk,ir->ik", columns, goal - best.reading * keep) - moves
        normal = np.einsum("irk,irl->ikl", columns, columns) + np.eye(moves.shape[1])
        scale = np.sqrt(np.einsum("ikk->ik", normal))
        scaled = normal / (scale[:, :, None] * scale[:, None, :]) + damping[:, None, None] * np.eye(moves.shape[1])
        trial = moves + np.linalg.solve(scaled, (pull / scale)[..., None])[..., 0] / scale
        at = compute_columns(layout, test, which, place, trial[:, :slots], trial[:, slots:])
        new = np.sum((goal - at.reading * keep) ** 2, axis=1) + np.sum(trial**2, axis=1)
        better = going & ~at.failed & np.isfinite(new) & (new <= cost)
        settled = better & (cost - new < SETTLED * new + 1e-9)
        best = Columns(*(np.where(better.reshape(-1, *[1] * (a.ndim - 1)), b, a)
                         for a, b in zip(best, at, strict=True)))
        moves, cost = np.where(better[:, None], trial, moves), np.where(better, new, cost)
        damping = np.where(better, 0.1 * damping, np.maximum(30.0 * damping, 1e-3))
        going &= ~settled
        if not going.any():
            break
    return best, moves


def value_separation(found: Distances) -> tuple[np.ndarray, np.ndarray]:
    r"""Mean over unordered pairs of $\ln(1 + \bar d^2)$ and its gradient, shapes (tests,) and (tests, free).

    $\bar d^2$ is the harmonic mean of both ways. A test at which a rival could not be computed is worth nothing.
    """
    number = {pair: k for k, pair in enumerate(found.pairs)}
    worth, slope = np.zeros(found.squares.shape[1]), np.zeros(found.slopes.shape[1:])
    half = [pair for pair in found.pairs if pair[0] < pair[1]]
    for i, j in half:
        a, b = number[i, j], number[j, i]
        mean, by_a, by_b = balance(found.squares[a], found.squares[b])
        worth += np.log1p(mean) / len(half)
        change = by_a[:, None] * found.slopes[a] + by_b[:, None] * found.slopes[b]
        slope += change / (1.0 + mean)[:, None] / len(half)
    return np.where(found.failed, 0.0, worth), np.where(found.failed[:, None], 0.0, slope)
