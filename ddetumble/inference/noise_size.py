"""Size of the noise sample by sample: with the reading and its rate, from record to record, and along a trace.

What is looked at are second differences of the residuals, which what is smooth (a missing force) hardly moves. Their
size follows

$$s^2 = g_r^2 b_r^2(t) (a^2 + (p y)^2 + (q \\dot y)^2)$$

with the reading $y$ and its change over a sampling interval, a floor $a$, shares $p$ and $q$, a factor $g_r$ of every
record, and one $b_r$ that varies slowly along it. Every part is adopted only where it is beyond chance, given the
scatter of the differences themselves, so that heavy tails and steps of the gauge do not count as a varying size.
"""

import dataclasses as dc
from collections.abc import Sequence

import numpy as np
from scipy import optimize

from . import distributions as stats


LAGS = 3  # over which neighbouring differences are correlated: what a second difference spans
LONGEST = 100_000  # differences that are fitted at once: more than enough for three numbers
CAPPED = 5.0  # times the expected size, beyond which a difference is a kink of the model or a spike, and counts as that


@dc.dataclass(frozen=True)
class SizeSettings:
    """When the size of the noise counts as varying."""

    records: int = 8  # with fewer the size is the stated one: what repeats over them is not told from noise
    fewest: int = 60  # differences that tell something about a size
    # p-value of a size that is the same throughout, below which it is not: a false alarm costs a little certainty.
    p_value: float = 1e-3
    # Ratio of the largest size (of one sample in twenty) to the smallest, below which it does not matter.
    material: float = 1.2
    window: int = 40  # samples of the shortest part of a trace with a size of its own
    windows: int = 12  # such parts of a trace, at most
    # Share of readings equal to the one before, from which on the steps of the gauge are the noise, whose size this
    # cannot tell.
    repeated: float = 0.1
    # Of the correlations of second differences from those of noise, up to which they count as noise: a smooth part of a
    # twentieth of their power moves the sum of both by as much.
    stray: float = 0.12


@dc.dataclass(frozen=True)
class Run:
    """Neighbouring samples of one record without a gap; arrays have shape (samples,), SI."""

    record: int
    samples: np.ndarray  # their places in the record
    residual: np.ndarray  # without what is smooth over a contact
    reading: np.ndarray  # without noise
    # Orthonormal columns, shape (samples, columns), that were taken out of the residual; None of very long records.
    taken: np.ndarray | None = None


@dc.dataclass(frozen=True)
class Sizes:
    """How the size of the noise varies."""

    # floor, share, rate_share: standard deviation without a reading [SI], as a share of the reading, and of its change
    # over one sampling interval; up to a common factor, as only differences are looked at.
    floor: float
    share: float
    rate_share: float
    records: np.ndarray  # factors by record, shape (records,); 1 where all are alike
    along: bool  # whether the size varies along the traces beside
    relative: list[np.ndarray]  # size of every sample, in no unit, a list over records of shape (samples,)


def measure_sizes(runs: Sequence[Run], lengths: Sequence[int], settings: SizeSettings = SizeSettings()) -> Sizes | None:
    """How the size of the noise varies over the samples of a channel; None where it does not, beyond chance.

    `runs` are those of all records, `lengths` how many samples each record has.
    """
    runs = [run for run in runs if len(run.residual) > 4]
    if not runs:
        return None
    record = np.concatenate([np.full(len(run.residual) - 2, run.record) for run in runs])
    place = np.concatenate([run.samples[1:-1] for run in runs])
    differences = np.concatenate([np.abs(_bend(run.residual)) for run in runs])
    squares = np.concatenate([_list_squares(run.reading)[1:-1] for run in runs])
    repeated = np.concatenate([np.diff(run.residual + run.reading) == 0.0 for run in runs]).mean()
    if len(differences) < settings.fewest or not differences.any() or repeated > settings.repeated:
        return None
    parts, size = _fit_parts(differences, squares, settings)
    factors = np.ones(len(lengths))
    whole = differences / size
    found = _shrink([whole[record == r] for r in range(len(lengths))], settings)
    if found is not None:
        factors = found
        whole = whole / factors[record]
    along = _follow(whole, record, place, lengths, settings)
    if parts is None and found is None and along is None:
        return None
    floor, share, rate_share = parts if parts is not None else (float(size[0]), 0.0, 0.0)
    relative = [np.full(n, np.nan) for n in lengths]
    for run in runs:
        own = np.sqrt(floor**2 + _list_squares(run.reading) @ np.square([share, rate_share])) * factors[run.record]
        relative[run.record][run.samples] = own
    for r, one in enumerate(relative):  # samples that no run holds count as the nearest that one does
        seen = np.flatnonzero(np.isfinite(one))
        filled = np.interp(np.arange(len(one)), seen, one[seen]) if len(seen) else np.full(len(one), floor)
        relative[r] = filled * (along[r] if along is not None else 1.0)
    every = np.concatenate(relative)
    low, high = np.quantile(every, [0.05, 0.95])
    if high <= settings.material * low:
        return None
    return Sizes(floor, share, rate_share, factors, along is not None, relative)


def look_random(runs: Sequence[Run], settings: SizeSettings = SizeSettings()) -> bool:
    r"""Whether second differences of the residuals are correlated as those of noise are, white or autoregressive.

    Over one sample and two, white noise gives $r_1 = -2/3$ and $r_2 = 1/6$, a random walk -1/2 and 0, and all between
    them nearly $r_1 + r_2 = -1/2$, whatever its size. What is smooth, as a missing force is, gives $r_1 = r_2 = 1$.
    """
    bent = [_bend(run.residual) for run in runs if len(run.residual) > settings.window]
    bent = [x / max(float(np.sqrt(np.mean(x**2))), 1e-300) for x in bent]
    count = sum(map(len, bent))
    if count < settings.fewest:
        return False
    one, two = (sum(float(x[k:] @ x[:-k]) for x in bent) / count for k in (1, 2))
    return abs(one + two + 0.5) < settings.stray and -2.0 / 3.0 - settings.stray < one < -0.5 + settings.stray


def _bend(x: np.ndarray) -> np.ndarray:
    """Second difference of neighbours: what the mean of the two beside a sample does not predict of it."""
    return x[1:-1] - 0.5 * (x[:-2] + x[2:])


def _list_squares(reading: np.ndarray) -> np.ndarray:
    """Squares of the reading and of its change from sample to sample, shape (samples, 2)."""
    return np.stack([reading**2, np.gradient(reading) ** 2], axis=1)


def _fit_parts(differences: np.ndarray, squares: np.ndarray, settings: SizeSettings
               ) -> tuple[tuple[float, float, float] | None, np.ndarray]:
    r"""Floor and shares by quasi-likelihood, $\sum \log m_t + d_t/m_t$ with $m_t^2 = a^2 + (p y)^2 + (q \dot y)^2$
    the squared mean of a difference $d_t$; None where no share is beyond chance. And the expected size of each."""
    step = -(-len(differences) // LONGEST)
    mean = float(np.mean(differences))
    few, own = differences[::step], squares[::step]
    scale = np.maximum(own.mean(axis=0), 1e-300)
    unit = own / scale
    spread = np.var(np.minimum(few / mean, CAPPED)) * _count_once(few / mean)
    kept: tuple[int, ...] = ()
    # One size has to be the best for the same loss: spikes alone would bring a share otherwise.
    alone, loss = _search(few / mean, unit[:, :0])
    best = None
    needed = 0.5 * spread * stats.chi2.isf(settings.p_value, 1)
    for columns in ((0,), (1,), (0, 1)):
        found, left = _search(few / mean, unit[:, columns])
        if left < loss - needed * max(len(columns) - len(kept), 1):
            best, loss, kept = found, left, columns
    if best is None:
        return None, np.full(len(differences), np.exp(0.5 * float(alone[0])) * mean)
    shares = np.zeros(2)
    shares[list(kept)] = np.exp(0.5 * best[1:]) * mean / np.sqrt(scale[list(kept)])
    floor = float(np.exp(0.5 * best[0]) * mean)
    return (floor, float(shares[0]), float(shares[1])), np.sqrt(floor**2 + squares @ shares**2)


def _search(differences: np.ndarray, squares: np.ndarray) -> tuple[np.ndarray, float]:
    """Logarithms of the squared floor and shares that lose least, and that loss.

    By the simplex method: the threads of a quasi-Newton method's linear algebra cost more than it saves.
    """
    start = np.full(1 + squares.shape[1], -np.log(1.0 + squares.shape[1]))
    simplex = np.concatenate([start[None], start + np.eye(len(start))])
    found = optimize.minimize(_lose, start, (differences, squares), method="Nelder-Mead",
                              bounds=[(-14.0, 4.0)] * len(start),
                              options={"initial_simplex": simplex, "xatol": 1e-3, "fatol": 1e-3})
    return found.x, float(found.fun)


def _lose(logarithms: np.ndarray, differences: np.ndarray, squares: np.ndarray) -> float:
    size = np.sqrt(np.exp(logarithms[0]) + squares @ np.exp(logarithms[1:]))
    ratio = differences / size
    beyond = CAPPED * (1.0 + np.log(np.maximum(ratio, CAPPED) / CAPPED))  # a kink counts by its logarithm
    return float(np.sum(np.log(size) + np.where(ratio > CAPPED, beyond, ratio)))


def _count_once(values: np.ndarray, length: float = np.inf) -> float:
    """How many neighbours count as one: the sum of their autocorrelations, at least 1.

    Where the mean over every `length` of them was taken out, their correlations came out too small by its variance.
    """
    x = np.minimum(values, CAPPED)
    x = x - x.mean()
    power = float(x @ x)
    lags = range(1, min(LAGS, len(x) // 4) + 1)
    if power <= 0:
        return 1.0
    count = 1.0 + 2.0 * sum(float(x[k:] @ x[:-k]) for k in lags) / power
    return max(count / max(1.0 - (2.0 * LAGS + 1.0) / length, 0.5), 1.0)


def _shrink(groups: Sequence[np.ndarray], settings: SizeSettings) -> np.ndarray | None:
    """Size of every group over the typical one, drawn towards it as far as it is uncertain; None where all are alike.

    The logarithms of the sizes scatter with a variance between the groups (DerSimonian and Laird's moments) beside that
    of each estimate. A group's size is that whose square is unbiased for the reciprocal of the variance.
    """
    # A difference is a spike beside its own group: a group that is five times as noisy holds none.
    capped = [np.minimum(g, CAPPED * (np.median(g) or 1.0)) if len(g) else g for g in groups]
    means = np.array([np.mean(g) if len(g) > 2 else np.nan for g in capped])
    known = np.isfinite(means) & (means > 0)
    if known.sum() < 2:
        return None
    # Scatter and correlation of the differences over their group's size are those of all groups together.
    every = np.concatenate([g / m for g, m, k in zip(capped, means, known, strict=True) if k])
    sizes = np.array([len(g) for g, k in zip(groups, known, strict=True) if k])
    error = float(np.var(every)) * _count_once(every, float(np.median(sizes))) / sizes
    logarithms, weights = np.log(means[known]), 1.0 / error
    middle = float(weights @ logarithms / weights.sum())
    statistic, free = float(weights @ (logarithms - middle) ** 2), int(known.sum()) - 1
    if stats.chi2.sf(statistic, free) > settings.p_value:
        return None
    between = max((statistic - free) / (weights.sum() - weights @ weights / weights.sum()), 0.0)
    found = np.ones(len(groups))
    shrunk = between / (between + error)
    found[known] = np.exp(shrunk * (logarithms - middle) + shrunk * error)
    return found


def _follow(whole: np.ndarray, record: np.ndarray, place: np.ndarray, lengths: Sequence[int], settings: SizeSettings
            ) -> list[np.ndarray] | None:
    """Size along every trace, from parts of it; shape (samples,) each, None where it is the same all along."""
    groups, centres = [], []
    for r in range(len(lengths)):
        own = np.flatnonzero(record == r)
        count = min(settings.windows, len(own) // settings.window)
        for part in np.array_split(own, count) if count else ():
            groups.append(whole[part])
            centres.append((r, float(place[part].mean())))
    found = _shrink(groups, settings) if len(groups) > 1 else None
    if found is None:
        return None
    logarithms, curves = np.log(found), []
    for r, n in enumerate(lengths):
        here = [k for k, (owner, _) in enumerate(centres) if owner == r]
        curves.append(np.exp(np.interp(np.arange(n), [centres[k][1] for k in here], logarithms[here])) if here
                      else np.ones(n))
    return curves
