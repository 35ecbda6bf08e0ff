"""Gauges at their limit whose noise comes after it: readings that stay at one level in several records, where a model
fitted to all other samples goes beyond.

A limit before the last amplifier, or in the gauge itself, leaves no equal readings behind (`measurement.faults` looks
for these): the noise hides it. What is left is a level that records of several conditions share, flat to the noise over
a stretch in which the model rises well above it and falls again. A peak that physics softens is neither flat nor, at
another condition, as high.
"""

import dataclasses as dc
from collections.abc import Collection

import numpy as np
from scipy import ndimage

from .._errors import ComputationError
from ..inference import distributions as stats
from ..inference.problem import Solution, replace_arrays
from ..measurement.faults import Fault
from ..measurement.quantities import join_words
from .problem import Fitted, SelectionProblem


WINDOW = 9  # samples of the running median, which shows a level below a third of the noise


@dc.dataclass(frozen=True)
class Saturation:
    """A channel that stays at a level where the model exceeds it."""

    channel: str
    level: float  # SI
    samples: dict[str, np.ndarray]  # which samples are at the level or beside it, by record, shape (samples,)
    excess: float  # of the model over the level, the largest, SI


def find_saturation(selection: SelectionProblem, fitted: Fitted, known: Collection[str] = ()) -> Saturation | None:
    """The channel at its limit in records of at least two conditions; None where there is none.

    The misfit has to go with the samples at the level. Channels that are `known` to be clipped are not looked at, nor
    values or motions that run on by themselves.
    """
    records = selection.records
    if records.are_values or selection.family.free_running:
        return None
    for c, channel in enumerate(records.channels):
        at = None if channel in known else _find_level(selection, c)
        if at is None:
            continue
        level, flat, near = at
        weights = np.asarray(records.stack.weights).copy()
        for r, mask in near.items():
            weights[r, c, : len(mask)][mask] = 0.0
        solution = fitted.solution
        try:
            rest = replace_arrays(selection.problem, weights=weights).solve(solution.names, solution.u, solution.z,
                                                                            tolerance=1e-2)
        except ComputationError:
            continue
        free = selection.samples - len(solution.names)
        before, after = solution.chi2 - free, rest.chi2 - free + sum(int(mask.sum()) for mask in near.values())
        if rest.failed or after > (1.0 - selection.settings.outliers.removed) * before:
            continue  # wear bends the largest forces as well, and all others with them
        sure = [r for r in flat if _exceeds(selection, rest, c, r, flat[r], level)]
        if len({int(selection.groups[r]) for r in sure}) >= selection.settings.outliers.conditions:
            most = max(float(rest.channels[r, c][: len(flat[r])][flat[r]].max()) for r in sure) - level
            return Saturation(channel, level, {records.keys[r]: mask for r, mask in near.items()}, most)
    return None


def _find_level(selection: SelectionProblem, c: int
                ) -> tuple[float, dict[int, np.ndarray], dict[int, np.ndarray]] | None:
    """The level that the largest readings of a channel share, and by record the samples flat at it and those beside it
    too; None where no two conditions share one, or readings lie beyond."""
    records, limits = selection.records, selection.settings.outliers
    readings, used, smooth, sizes = [], [], [], []
    for r, length in enumerate(map(int, records.lengths)):
        readings.append(np.asarray(records.stack.values)[r, c, :length])
        used.append(records.used[r, c, :length])
        smooth.append(ndimage.median_filter(np.where(used[r], readings[r], -np.inf), WINDOW, mode="nearest"))
        sizes.append(_size(selection, c, r, length))
    top = max(range(records.count), key=lambda r: smooth[r].max())
    # The largest running median of many lies above the level, by less than the noise.
    level = float(smooth[top].max() - sizes[top][int(np.argmax(smooth[top]))])
    for _ in range(3):
        at = [x > level - sd for x, sd in zip(smooth, sizes, strict=True)]
        there = np.concatenate([x[m & u] for x, m, u in zip(readings, at, used, strict=True)])
        if not len(there):
            return None
        level = float(np.median(there))
    flat, near, total, degrees = {}, {}, 0.0, 0
    for r, mask in enumerate(at):
        if np.any((readings[r] > level + limits.wide * sizes[r])[used[r]]):
            return None
        inner = ndimage.binary_erosion(mask & used[r], iterations=WINDOW // 4)
        if inner.sum() <= WINDOW // 2:
            continue
        place = np.linspace(-1.0, 1.0, int(inner.sum()))
        basis = np.linalg.qr(np.stack([np.ones_like(place), place, place**2], axis=1))[0]
        total += float(np.sum((basis.T @ ((readings[r] - level) / sizes[r])[inner]) ** 2))
        degrees += basis.shape[1]
        flat[r] = inner
        beside = smooth[r] > level - selection.settings.screening.near * sizes[r]
        near[r] = ndimage.binary_propagation(mask, mask=beside)
    if len({int(selection.groups[r]) for r in flat}) < limits.conditions or stats.chi2.sf(total, degrees) < limits.fits:
        return None
    return level, flat, near


def _size(selection: SelectionProblem, c: int, r: int, length: int) -> np.ndarray:
    """Standard deviation of the noise of every sample of a record, shape (samples,), SI."""
    noise = selection.noise[selection.records.channels[c]]
    return noise.sd * np.asarray(noise.sizes.get(selection.records.keys[r], np.ones(length)), dtype=float)[:length]


def _exceeds(selection: SelectionProblem, rest: Solution, c: int, r: int, flat: np.ndarray, level: float) -> bool:
    """Whether a model of the other samples lies well above the level where a record is flat at it, and no constant."""
    excess = ((rest.channels[r, c][: len(flat)] - level) / _size(selection, c, r, len(flat)))[flat]
    limits = selection.settings
    return bool(excess.max() > limits.outliers.wide and np.ptp(excess) > limits.screening.near and excess.min() > 0.0)


def tell_saturation(selection: SelectionProblem, found: Saturation, keep: bool) -> Fault:
    """A gauge at its limit in words; `keep` whether every sample is to be kept."""
    unit, keys = selection.campaign.channels[found.channel].unit, tuple(found.samples)
    named = f"records {join_words(keys)}" if len(keys) <= 4 else f"{len(keys)} records ({keys[0]} among them)"
    number = sum(int(mask.sum()) for mask in found.samples.values())
    seen = (f"{found.channel} stays at {found.level:.4g} {unit} in {named}, flat to the noise, where the model of all "
            f"other samples goes up to {found.excess:.2g} {unit} beyond: the gauge or its amplifier is at its limit.")
    done = "Nothing is done about it, as asked." if keep else f"{number} samples at this level are left out."
    return Fault("clipped", keys, found.channel, seen, done, "Choose a wider range of the gauge or the amplifier.")
