"""Spikes: single readings off a smooth curve on which all readings around them lie.

Nothing here knows physics: a jump, a kink and a peak are none, and what comes at one time in several records is no
accident either.
"""

import itertools
import math
from collections.abc import Hashable, Mapping

import numpy as np
from scipy import special


SPIKE = 7.0  # deviations off the neighbours
WINDOW = 9  # samples in which a spike is looked for
SMOOTH = 1.8  # deviations of its other samples from a cubic
COMMON, RECURS = 3.0, 0.01  # samples around a spike, and expected number of others there beyond which it is no accident
MANY = 0.05  # share of a record's readings beyond which spikes are no accidents
_LEFT_OUT = tuple(np.array(list(itertools.combinations(range(WINDOW), n)), dtype=int).reshape(math.comb(WINDOW, n), n)
                  for n in range(3))


def find_spikes(time: np.ndarray, x: np.ndarray, sd: float) -> np.ndarray:
    """Readings that stand off their neighbours, one or two by themselves, shape (samples,).

    Where a sample is far from the cubic through its neighbours, the nine around it are looked at: they are spikes, the
    fewest of at most two without which the others lie on a cubic within their noise, if they are off it by 7
    deviations, others lie on both sides, and a cubic with a step and a kink does not go through all nine. Where the
    nine are not so simple, a spike is what is outside of its neighbours' range, and off the lines through the two on
    each side (a ramp that ends in a jump goes on along one of them), by as much.

    Args:
        time: of the samples, shape (samples,), in any unit.
        x: readings of one record, shape (samples,), NaN where missing.
        sd: standard deviation of the noise, in the readings' unit.
    """
    found = np.zeros(len(x), dtype=bool)
    there = np.flatnonzero(np.isfinite(x))
    if len(there) < WINDOW:
        return found
    t, y = time[there], x[there]
    off = np.pad(np.abs(leave_cubic(t, y)) > 0.5 * SPIKE * sd, 2)
    near = np.convolve(off, np.ones(5), mode="same") > 0
    outside = _stand_outside(t, y, sd)
    for k in np.flatnonzero(near[1:-1]) + 1:
        first = int(np.clip(k - WINDOW // 2, 0, len(y) - WINDOW))
        part = slice(first, first + WINDOW)
        spikes = _leave_window(t[part], y[part], sd)
        found[there[k]] = outside[k] if spikes is None else k - first in spikes
    # So many are no accidents.
    return found if found.mean() <= MANY else np.zeros(len(x), dtype=bool)


def leave_common_spikes(time: dict[str, np.ndarray], spikes: dict[str, np.ndarray],
                        groups: Mapping[str, Hashable]) -> dict[str, np.ndarray]:
    """Spikes without those that come at one time in more records than chance would have it: these are the experiment's.

    Args:
        time: of every record's samples.
        spikes: which of these are spikes, of the same shapes.
        groups: conditions of every record; repeats have the same.
    """
    found, count = dict(spikes), sum(len(t) for t in time.values())
    total = sum(int(own.sum()) for own in spikes.values())
    for key, own in spikes.items():
        found[key] = kept = own.copy()
        for k in np.flatnonzero(own):
            near = COMMON * float(np.median(np.diff(time[key])))
            others = {other: np.abs(t - time[key][k]) <= near for other, t in time.items() if other != key}
            repeats = {other: window for other, window in others.items() if groups[other] == groups[key]}
            for windows in (others, repeats):
                hits = sum(int(spikes[other][window].any()) for other, window in windows.items())
                samples = sum(int(window.sum()) for window in windows.values())
                rate = max(total - hits - 1, 0.5) / count
                if hits and total * special.bdtrc(hits - 1, samples, rate) < RECURS:
                    kept[k] = False
    return found


def _leave_window(time: np.ndarray, y: np.ndarray, sd: float) -> tuple[int, ...] | None:
    """Places within a window that are off a cubic on which all others lie; None where there is no such cubic.

    Args:
        time, y: of the samples and readings of the window, shape (WINDOW,).
        sd: standard deviation of the noise, in the readings' unit.
    """
    t = 2.0 * (time - time[0]) / (time[-1] - time[0]) - 1.0
    basis = np.stack([np.ones_like(t), t, t * t, t**3], axis=1)
    for k in range(2, len(t) - 1):  # a step, and a kink where three samples on either side show it
        edge = 0.5 * (t[k - 1] + t[k])
        broken = [t > edge, np.maximum(t - edge, 0.0)] if 3 <= k <= len(t) - 3 else [t > edge]
        moving = np.concatenate([basis, np.stack(broken, axis=1)], axis=1)
        rest = y - moving @ np.linalg.lstsq(moving, y)[0]
        if rest @ rest <= (len(y) - moving.shape[1]) * SMOOTH**2 * sd**2:
            return ()
    for out in _LEFT_OUT:
        kept = np.ones((len(out), len(y)))
        np.put_along_axis(kept, out, 0.0, axis=1)
        inverse = np.linalg.inv(np.einsum("ck,ki,kj->cij", kept, basis, basis))
        rest = y - np.einsum("ki,cij,cj->ck", basis, inverse, (kept * y) @ basis)
        misfit = np.sum(kept * rest**2, axis=1) / (len(y) - 4.0 - out.shape[1])
        fine = np.flatnonzero(misfit <= SMOOTH**2 * sd**2)
        if not len(fine):
            continue
        # Where several would do, what all of them leave out.
        sure = set(range(1, len(y) - 1)).intersection(*out[fine].tolist())
        best = int(fine[np.argmin(misfit[fine])])
        wide = sd * np.sqrt(1.0 + np.einsum("ki,ij,kj->k", basis, inverse[best], basis))
        return tuple(k for k in sure if abs(rest[best][k]) > SPIKE * wide[k])
    return None


def _stand_outside(time: np.ndarray, y: np.ndarray, sd: float) -> np.ndarray:
    """Readings off the cubic, the range and the lines of two neighbours on each side, shape (samples,); see above."""
    off, middle = leave_cubic(time, y), y[2:-2]
    around = np.stack([y[:-4], y[1:-3], y[3:-1], y[4:]])
    outside = np.maximum(middle - around.max(axis=0), around.min(axis=0) - middle)
    ahead, behind = middle - 2.0 * y[1:-3] + y[:-4], middle - 2.0 * y[3:-1] + y[4:]
    outside = np.minimum(outside, np.minimum(np.abs(ahead), np.abs(behind)))
    bad = (np.abs(off) > SPIKE * sd) & (outside > SPIKE * sd)
    # What stands off beside a larger one stands off because of it.
    size = np.where(bad, np.abs(off), 0.0)
    beside = np.pad(size, 2)
    bad &= size >= np.max([beside[k:k + len(size)] for k in (0, 1, 3, 4)], axis=0)
    return np.pad(bad, 2)


def leave_cubic(time: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Each sample but two at either end less the cubic through its four neighbours, in deviations of one sample."""
    at = np.stack([time[k:len(time) - 4 + k] for k in (0, 1, 3, 4)])
    y = np.stack([x[k:len(x) - 4 + k] for k in (0, 1, 3, 4)])
    t = time[2:-2]
    weights = np.ones_like(at)
    for i in range(4):
        for j in range(4):
            if i != j:
                weights[i] *= (t - at[j]) / (at[i] - at[j])
    return (x[2:-2] - np.sum(weights * y, axis=0)) / np.sqrt(1.0 + np.sum(weights**2, axis=0))
