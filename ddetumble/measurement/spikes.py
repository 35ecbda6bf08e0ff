"""Spikes: single readings off a smooth curve on which all readings around them lie; a jump, a kink and a peak are none.
"""

import dataclasses as dc
from collections.abc import Hashable, Mapping
from itertools import combinations

import numpy as np
from scipy import special


@dc.dataclass(frozen=True)
class ScreeningSettings:
    """When samples count as faulty, before any model is fitted.

    Attributes:
        chance: expected number, by chance, of runs of equal readings that are called clipped or held: one campaign in
            ten thousand loses good samples.
        near: standard deviations below a limit within which a reading may have been cut by it.
        spike: standard deviations off its neighbours from which a reading is a spike: of a million Gaussian readings
            none is.
        smooth: standard deviations of the other samples from a cubic, up to which they lie on it.
        common: samples around a spike within which one of another record is at the same time.
        recurs: expected number of spikes of others there, by chance, below which a common spike is the experiment's.
        many: share of the readings of a record beyond which spikes are no accidents.
        uneven: share by which intervals of sampling may differ.
        often: share of the intervals that may differ by more.
        copied: share of readings that differ from the one before, which a record needs to be held against others: one
            that stands still is equal to any.
        last: readings at the end of a record whose mean tells whether it ends in contact.
        pressed: share of the peak above which that mean is a contact's: drift or lag of a gauge makes less.
        ended: standard deviations of that mean above nought.
    """

    chance: float = 1e-4
    near: float = 3.0
    spike: float = 7.0
    smooth: float = 1.8
    common: float = 3.0
    recurs: float = 0.01
    many: float = 0.05
    uneven: float = 0.02
    often: float = 0.02
    copied: float = 0.9
    last: int = 5
    pressed: float = 0.05
    ended: float = 6.0


SCREENING = ScreeningSettings()
WINDOW = 9  # samples in which a spike is looked for
_LEFT_OUT = tuple(np.array(list(combinations(range(WINDOW), n)), dtype=int) for n in range(3))


def find_spikes(time: np.ndarray, x: np.ndarray, sd: float, settings: ScreeningSettings = SCREENING) -> np.ndarray:
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
        settings: thresholds.
    """
    found = np.zeros(len(x), dtype=bool)
    there = np.flatnonzero(np.isfinite(x))
    if len(there) < WINDOW:
        return found
    t, y = time[there], x[there]
    off = np.pad(np.abs(leave_cubic(t, y)) > 0.5 * settings.spike * sd, 2)
    near = np.convolve(off, np.ones(5), mode="same") > 0
    outside = _stand_outside(t, y, sd, settings)
    for k in np.flatnonzero(near[1:-1]) + 1:
        first = int(np.clip(k - WINDOW // 2, 0, len(y) - WINDOW))
        part = slice(first, first + WINDOW)
        spikes = _leave_window(t[part], y[part], sd, settings)
        found[there[k]] = outside[k] if spikes is None else k - first in spikes
    return found & (found.mean() <= settings.many)  # more are no accidents


def leave_common_spikes(time: dict[str, np.ndarray], spikes: dict[str, np.ndarray],
                        groups: Mapping[str, Hashable], settings: ScreeningSettings) -> dict[str, np.ndarray]:
    """Spikes without those that come at one time in more records than chance would have it: these are the experiment's.

    All arguments are by record: times, which samples are spikes, and conditions; repeats have the same.
    """
    found, count = {key: own.copy() for key, own in spikes.items()}, sum(map(len, time.values()))
    total = sum(int(own.sum()) for own in spikes.values())
    for key, own in spikes.items():
        for k in np.flatnonzero(own):
            near = settings.common * float(np.median(np.diff(time[key])))
            others = {other: np.abs(t - time[key][k]) <= near for other, t in time.items() if other != key}
            repeats = {other: window for other, window in others.items() if groups[other] == groups[key]}
            for windows in (others, repeats):
                hits = sum(int(spikes[other][window].any()) for other, window in windows.items())
                samples = sum(int(window.sum()) for window in windows.values())
                rate = max(total - hits - 1, 0.5) / count
                if hits and total * special.bdtrc(hits - 1, samples, rate) < settings.recurs:
                    found[key][k] = False
    return found


def _leave_window(time: np.ndarray, y: np.ndarray, sd: float, settings: ScreeningSettings) -> tuple[int, ...] | None:
    """Places within a window that are off a cubic on which all others lie; None where there is no such cubic."""
    t, limit = 2.0 * (time - time[0]) / (time[-1] - time[0]) - 1.0, settings.smooth**2 * sd**2
    basis = np.stack([np.ones_like(t), t, t * t, t**3], axis=1)
    for k in range(2, len(t) - 1):  # a step, and a kink where three samples on either side show it
        edge = 0.5 * (t[k - 1] + t[k])
        broken = [t > edge, np.maximum(t - edge, 0.0)] if 3 <= k <= len(t) - 3 else [t > edge]
        moving = np.concatenate([basis, np.stack(broken, axis=1)], axis=1)
        rest = y - moving @ np.linalg.lstsq(moving, y)[0]
        if rest @ rest <= (len(y) - moving.shape[1]) * limit:
            return ()
    for out in _LEFT_OUT:
        kept = np.ones((len(out), len(y)))
        np.put_along_axis(kept, out, 0.0, axis=1)
        inverse = np.linalg.inv(np.einsum("ck,ki,kj->cij", kept, basis, basis))
        rest = y - np.einsum("ki,cij,cj->ck", basis, inverse, (kept * y) @ basis)
        misfit = np.sum(kept * rest**2, axis=1) / (len(y) - 4.0 - out.shape[1])
        fine = np.flatnonzero(misfit <= limit)
        if not len(fine):
            continue
        # Where several would do, what all of them leave out.
        sure = set(range(1, len(y) - 1)).intersection(*out[fine].tolist())
        best = int(fine[np.argmin(misfit[fine])])
        wide = sd * np.sqrt(1.0 + np.einsum("ki,ij,kj->k", basis, inverse[best], basis))
        return tuple(k for k in sure if abs(rest[best][k]) > settings.spike * wide[k])
    return None


def _stand_outside(time: np.ndarray, y: np.ndarray, sd: float, settings: ScreeningSettings) -> np.ndarray:
    """Readings off the cubic, the range and the lines of two neighbours on each side, shape (samples,); see above."""
    off, middle, limit = np.abs(leave_cubic(time, y)), y[2:-2], settings.spike * sd
    around = np.stack([y[:-4], y[1:-3], y[3:-1], y[4:]])
    lines = np.abs([middle - 2.0 * y[1:-3] + y[:-4], middle - 2.0 * y[3:-1] + y[4:]])
    outside = np.min([np.maximum(middle - around.max(axis=0), around.min(axis=0) - middle), *lines], axis=0)
    bad = (off > limit) & (outside > limit)
    # What stands off beside a larger one stands off because of it.
    beside = np.pad(np.where(bad, off, 0.0), 2)
    return np.pad(bad & (beside[2:-2] >= np.max([beside[k:k + len(bad)] for k in (0, 1, 3, 4)], axis=0)), 2)


def leave_cubic(time: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Each sample but two at either end less the cubic through its four neighbours, in deviations of one sample."""
    at, y = (np.stack([z[k:len(z) - 4 + k] for k in (0, 1, 3, 4)]) for z in (time, x))
    t = time[2:-2]
    weights = np.stack([np.prod([(t - at[j]) / (at[i] - at[j]) for j in range(4) if j != i], axis=0) for i in range(4)])
    return (x[2:-2] - np.sum(weights * y, axis=0)) / np.sqrt(1.0 + np.sum(weights**2, axis=0))
