"""Strokes of a slip record: where the motion turns round, and how far each stroke has slid."""

import numpy as np


def split_strokes(slip: np.ndarray, threshold: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Distance slid since the stroke began [m], direction (+1 or -1) and number of the stroke, each shape (samples,).

    Of a measured position (samples,) [m]: a turn counts once the motion has come back from its farthest point by more
    than `threshold` [m]; noise does not. Within a stroke the distance never falls: what noise takes back counts as
    rest. The sample at a turning point belongs to the stroke that ends there.
    """
    slip = np.asarray(slip, dtype=float)
    turns = find_turns(slip, threshold)
    distance, direction = np.zeros(len(slip)), np.ones(len(slip))
    number = np.zeros(len(slip), dtype=int)
    for k, (first, last) in enumerate(zip(turns[:-1], turns[1:], strict=True)):
        here = slice(first + 1 if k else 0, last + 1)
        way = 1.0 if slip[last] >= slip[first] else -1.0
        distance[here] = np.maximum.accumulate(np.maximum(way * (slip[here] - slip[first]), 0.0))
        direction[here], number[here] = way, k
    return distance, direction, number


def find_turns(slip: np.ndarray, threshold: float) -> list[int]:
    """Indices of the first sample, of every turning point, and of the last sample."""
    turns, extreme, way = [0], 0, 0.0
    for k in range(1, len(slip)):
        if way == 0.0:
            if abs(slip[k] - slip[0]) > threshold:
                way, extreme = np.sign(slip[k] - slip[0]), k
        elif way * (slip[k] - slip[extreme]) >= 0:
            extreme = k
        elif way * (slip[extreme] - slip[k]) > threshold:
            turns.append(extreme)
            way, extreme = -way, k
    return [*turns, len(slip) - 1]
