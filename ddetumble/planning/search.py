"""Where within the limits a test is worth most."""

import numpy as np
from scipy.optimize import minimize
from scipy.stats import qmc

from .preview import Layout, Test, compute_columns, count_rows
from .refits import part_rivals, value_separation
from .separation import gain_information


STARTS = 8  # that climb together
SCAN = 32  # conditions looked at before the climb
CLIMB = 20  # iterations
ROUNDS, SHRINK = 4, 0.45  # of the search without a gradient


def search_conditions(layout: Layout, test: Test, mask: np.ndarray) -> tuple[np.ndarray, float]:
    """The conditions that are worth most.

    Of rivals: L-BFGS-B on the separation, from the best conditions of a scan. All starts climb together: their sum is
    one objective whose gradient falls apart into theirs, so that one compiled program serves every step. Of one model:
    the gain of information, whose gradient would need second derivatives, by a scan that closes in on its best.

    Args:
        layout, test: of `prepare`.
        mask: 1 for channels that count, shape (channels,).

    Returns:
        Shares of the free limits, shape (free,), and the worth there (0 where nothing could be computed).
    """
    free = len(layout.free)
    alone = test.base.shape[0] == 1

    def evaluate(x):
        if alone:
            worth = value_information(layout, test, x, mask)
            return worth, np.zeros_like(x)
        return value_separation(part_rivals(layout, test, x, mask))

    if free == 0:
        return np.zeros(0), float(evaluate(np.zeros((1, 0)))[0][0])
    scan = qmc.Sobol(free, scramble=False).random(SCAN)
    corners = np.array(np.meshgrid(*[[0.0, 1.0]] * free)).reshape(free, -1).T
    places = np.concatenate([corners, scan])[:SCAN]
    values = evaluate(places)[0]
    if alone:
        return _close_in(evaluate, places, values)
    starts = places[np.argsort(-values, kind="stable")[:STARTS]]

    def loss(flat):
        value, slope = evaluate(flat.reshape(starts.shape))
        return -float(value.sum()), -slope.ravel()

    found = minimize(loss, np.clip(starts, 1e-3, 1.0 - 1e-3).ravel(), jac=True, method="L-BFGS-B",
                     bounds=[(0.0, 1.0)] * starts.size, options={"maxiter": CLIMB})
    ends = np.concatenate([found.x.reshape(starts.shape), starts])
    worth = evaluate(ends)[0]
    best = int(np.argmax(worth))
    return ends[best], float(worth[best])


def _close_in(evaluate, places: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, float]:
    """A scan repeated in ever smaller boxes about its best."""
    pattern, size = qmc.Sobol(places.shape[1], scramble=False).random(2 * STARTS) - 0.5, 1.0
    best = int(np.argmax(values))
    x, worth = places[best], float(values[best])
    for _ in range(ROUNDS):
        size *= SHRINK
        near = np.clip(x + size * pattern, 0.0, 1.0)
        value = evaluate(near)[0]
        if value.max() > worth:
            x, worth = near[int(np.argmax(value))], float(value.max())
    return x, worth


def value_information(layout: Layout, test: Test, x: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Information on the parameters of one model gained by tests [nat], shape (tests,)."""
    at = compute_columns(layout, test, np.zeros(len(x), dtype=int), x)
    rows = count_rows(layout, test, at.end, mask)[..., None]
    gains = [float(gain_information(s, o)) for s, o in zip(at.shared * rows, at.own * rows, strict=True)]
    return np.where(at.failed, 0.0, np.nan_to_num(gains))
