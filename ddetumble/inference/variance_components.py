"""Variance components: how far settings really scatter, and a baseline that wanders, by restricted likelihood."""

import dataclasses as dc
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from scipy import linalg, optimize
from scipy.sparse.linalg import spsolve_triangular

from ..families import find_family
from . import distributions as stats
from .goodness import combine_p_values
from .noise import Noise, whitening_matrix
from .problem import Solution, shift_clocks
from .stack import Records, is_added


FREE = 3  # degrees of freedom with which a scatter is worth anything
BEFORE = 1e-4  # s before first touch, and the share of a contact after it, from which on nothing presses on the gauge:
AFTER = 0.25  # a filter's or a ringing gauge's answer to the contact is over by then
SMALLER = (0.5, 0.25, 0.125)  # of the size that a baseline seems to have, where that is too large without contact
FEWEST = 8  # readings without contact of a record that tell anything of a baseline
APART = 0.03  # range of a logarithm below which a condition was held
TIMES = (0.1, 0.3, 1.0, 10.0)  # correlation times over the length of a record: from noise to an offset,
# and of smooth ones: from a few samples to a bend, and on to the same offsets, so that an offset is never called rough.
SMOOTH_TIMES = (0.01, 0.02, 0.05, 0.1, 0.2, 0.4, 1.0, 10.0)
EXCLUDED = 3.84  # loss beyond the least, outside a 95 % interval
MOST = 240  # samples of a record that are looked at: what is slow does not need more
RANGE = (0.05, 50.0)  # size over that of the noise: less does not matter, more no gauge shows


@dc.dataclass(frozen=True)
class SpreadSettings:
    """When settings count as scattering more than stated."""

    # Standard deviation of the logarithm of the ratio to what is stated: a factor of three is no surprise.
    prior: float = 1.0
    worth: float = 6.0  # logarithm of the likelihood that a larger scatter has to bring
    least: float = 1.3  # ratio below which nothing hangs on it
    most: float = 12.0  # ratio beyond which the setting would not be known at all
    fewest: int = 6  # records with which a scatter can be estimated
    # Of shifts that follow the conditions, below which they are no scatter: physics acts alike at like conditions,
    # errors do not; a p-value.
    random: float = 0.01


@dc.dataclass(frozen=True)
class WanderSettings:
    """When what is slow in the residuals is a baseline that wanders."""

    worth: float = 6.0  # logarithm of the likelihood that a baseline has to bring, and rough ones over smooth ones
    # Logarithm of the likelihood by which smooth baselines of records that run on from their starts may come before
    # rough ones, as random walks are, up to which they may be noise: of bodies with a force outside the catalogue it
    # was 20 to 2,500, of gyroscopes whose bias walks at random 5 at most.
    smooth: float = 10.0
    level: float = 0.01  # chance, of the noise as measured, of so much that is slow, below which `fit` looks for one
    rounds: int = 3  # of `fit`: the first baseline is found beside parameters that it has bent
    # Logarithm of the likelihood by which readings without contact may speak against a baseline: beside a real one they
    # do so by more in less than 2 of 100 campaigns, as any likelihood ratio does.
    quiet: float = 4.0


WANDER = WanderSettings()


def list_settings(records: Records) -> list[int]:
    """Places among the nuisances of the settings that state an uncertainty."""
    deviations = np.asarray(records.stack.condition_sd)[: records.count]
    return [k for k, name in enumerate(records.nuisances)
            if name not in records.starts and not is_added(name) and (deviations[:, k] > 0).any()]


def estimate_spread(records: Records, solution: Solution, known: Mapping[str, float] | None = None,
                    settings: SpreadSettings = SpreadSettings()) -> dict[str, float]:
    r"""Ratio of the scatter of every setting to what is stated, by name, where it is larger beyond doubt.

    The restricted likelihood of the linearised fit: residuals $\rho_r = S_r \theta + J_r z_r + e$ with unit noise $e$,
    $z_{rk} \sim N(0, f_k^2)$ and free $\theta$; each $\log f_k$ has a normal prior about what is stated. `known` are
    ratios that the fit of all records already allows for.
    """
    places = list_settings(records)
    if not places or records.count < settings.fewest:
        return {}
    before = np.array([dict(known or {}).get(records.nuisances[k], 1.0) for k in places])
    count, own = solution.shared.shape[2], solution.own.shape[2]
    sides, triangles, rest = [], [], np.zeros((count + 1, count + 1))
    for r in range(records.count):
        residual = solution.residual[r] - solution.own[r] @ solution.z[r]
        columns = np.concatenate([solution.shared[r], residual[:, None]], axis=1)
        q, triangle = np.linalg.qr(solution.own[r])
        part = q.T @ columns
        rest += columns.T @ columns - part.T @ part
        sides.append(part)
        triangles.append(triangle)
    rest[:count, :count] += np.diag(solution.prior_weight**2)
    rest[:count, count] += solution.prior_weight * solution.prior_residual
    rest[count, :count] += solution.prior_weight * solution.prior_residual

    def lose(logarithms: np.ndarray) -> float:
        """Minus twice the logarithm of the restricted likelihood and the prior."""
        ratio = np.ones(own)
        ratio[places] = np.exp(logarithms) / before
        wide = [triangle * ratio for triangle in triangles]
        loss = lose_restricted(((np.eye(len(x)) + x @ x.T, part) for x, part in zip(wide, sides, strict=True)), rest)
        return float(loss + np.sum((logarithms / settings.prior) ** 2))

    none, limit = np.zeros(len(places)), float(np.log(settings.most))
    step = np.eye(len(places))
    best: Any = min((optimize.minimize(lose, start, method="Nelder-Mead", bounds=[(0.0, limit)] * len(places), options={
        "initial_simplex": np.concatenate([start[None], start + step]), "xatol": 1e-2, "fatol": 1e-2})
        for start in (none, none + np.log(4.0))), key=lambda found: found.fun)
    found = {}
    for i, k in enumerate(places):
        fixed = best.x.copy()
        fixed[i] = 0.0
        if np.exp(best.x[i]) > settings.least and lose(fixed) - best.fun > 2.0 * settings.worth:
            found[records.nuisances[k]] = float(np.exp(best.x[i]))
    return found


def follow_conditions(shifts: np.ndarray, groups: np.ndarray, conditions: np.ndarray) -> float:
    """p-value of shifts of a setting having nothing to do with the conditions: those of physics are alike in repeats.

    F-tests of the means of records at one condition about zero against their scatter, and of those that share all
    settings but one; t-tests of the mean and of the slope over the logarithm of every condition. The smallest p-value
    counts as often as there are tests, and it is 0 where there are too few records to tell. Shifts and numbers of their
    conditions (`groups`) have shape (records,), `conditions`, which are positive, (records, conditions).
    """
    logarithms = np.log(np.maximum(np.abs(conditions), 1e-300))
    varied = logarithms[:, np.ptp(logarithms, axis=0) > APART] if len(logarithms) else logarithms
    # The place in a series, of which every record has its own, is shared by none.
    levels = [found for found in map(_find_levels, varied.T) if 2 * found.max() < len(shifts)]
    shared = [np.unique(np.stack(levels[:k] + levels[k + 1:]), axis=1, return_inverse=True)[1].ravel()
              for k in range(len(levels))] if len(levels) > 1 else []
    chances = [chance for labels in (groups, *shared) if (chance := _compare_groups(shifts, labels)) is not None]
    if len(shifts) >= FREE + 2:
        tests: list[Any] = [stats.ttest_1samp(shifts, 0.0), *(stats.linregress(x, shifts) for x in varied.T)]
        chances += [one.pvalue for one in tests]
    return combine_p_values([float(chance) for chance in chances if np.isfinite(chance)]) if chances else 0.0


def _find_levels(values: np.ndarray) -> np.ndarray:
    """Number of the level of every value, from below: one ends where a gap follows."""
    order = np.argsort(values)
    found = np.zeros(len(values), dtype=int)
    found[order[1:]] = np.cumsum(np.diff(values[order]) > APART)
    return found


def _compare_groups(shifts: np.ndarray, groups: np.ndarray) -> float | None:
    """p-value of the means of groups being zero within the scatter of their members; None where that is not known."""
    labels, sizes = np.unique(groups, return_counts=True)
    within = len(shifts) - len(labels)
    if within < FREE:
        return None
    means = np.array([shifts[groups == g].mean() for g in labels])
    scatter = sum(float(np.sum((shifts[groups == g] - m) ** 2)) for g, m in zip(labels, means, strict=True))
    return float(stats.f.sf(float(sizes @ means**2) / len(labels) / max(scatter / within, 1e-300), len(labels), within))


@dc.dataclass(frozen=True)
class SlowNoise:
    """Baselines that wander, as the restricted likelihood finds them."""

    noise: dict[str, Noise]  # of every channel, with a slow part where one is beyond doubt
    # Logarithm of the likelihood by which baselines that are rough, as noise is, come before smooth ones, which a force
    # leaves that is missing from a motion: the sum over the channels with a slow part.
    roughness: float


def weigh_quiet(records: Records, solution: Solution, noise: Noise, c: int) -> float:
    """Logarithm of the likelihood by which readings of channel number `c` without contact speak for the baseline of its
    noise: a gauge wanders whether or not a ball presses on it, and what is slow during contact alone is physics.

    Restricted likelihood of the residuals under that noise over that without its baseline; every record has an offset
    of its own, which may have been taken off. Zero where no record has such readings.
    """
    stack, found = records.stack, 0.0
    touch, plain = shift_clocks(records, solution), dc.replace(noise, slow_sd=0.0)
    time, values, weights = np.asarray(stack.time), np.asarray(stack.values), np.asarray(stack.weights)
    for r, n in enumerate(records.lengths):
        end = float(solution.end[r])
        t = time[r, :n]
        free = (t < min(touch[r], 0.0) - BEFORE) | (t > end + AFTER * (end - touch[r]))
        kept = np.flatnonzero(free & (weights[r, c, :n] > 0))
        kept = kept[:: -(-len(kept) // MOST)] if len(kept) else kept
        if len(kept) < FEWEST or not records.complete[r, c]:
            continue
        columns = np.stack([np.ones(len(kept)), solution.channels[r, c, kept] - values[r, c, kept]], axis=1)
        key, lag = records.keys[r], t[kept][:, None] - t[kept]
        sizes = np.outer(*[noise.sizes[key][kept]] * 2) if key in noise.sizes else 1.0
        slow = noise.slow_sd**2 * np.exp(-np.abs(lag) / noise.slow_time)
        fast = plain.covariance(lag) * sizes
        found += 0.5 * (lose_restricted([(fast, columns)]) - lose_restricted([(fast + slow, columns)]))
    return found


def find_slow_noise(records: Records, solution: Solution, noise: Mapping[str, Noise],
                    settings: WanderSettings = WANDER) -> SlowNoise:
    r"""The noise of every channel with a slow part, where one is beyond doubt; none of it may be missing physics.

    The restricted likelihood of $y_r = S_r \theta + J_r z_r + b_r + e_r$: residuals of a linearised fit with free
    parameters $\theta$, settings $z_r \sim N(0, I)$, the noise as it is known, and an Ornstein-Uhlenbeck baseline
    $b_r$, whose size and correlation time are fitted. Of the times that the likelihood does not exclude it is the
    longest: what is slow is what a force is taken for. A baseline against which readings without contact speak is none
    of that size, but of a smaller one where they speak for that.

    The same with a baseline whose covariance is $\exp(-\Delta t^2/2\tau^2)$ tells how rough the baselines are.
    """
    found, roughness = dict(noise), 0.0
    for c, channel in enumerate(records.channels):
        parts = _gather_rows(records, solution, noise[channel], c)
        if not parts:
            continue
        none = _lose(0.0, [(part.columns, np.zeros(len(part.columns)), part.determinant) for part in parts])
        length = float(np.median([part.time[-1] - part.time[0] for part in parts]))
        limits = tuple(np.log(noise[channel].sd * x) for x in RANGE)
        rough = {share: _fit_size(share * length, parts, limits) for share in TIMES}
        best = min(loss for loss, _ in rough.values())
        if none - best <= 2.0 * settings.worth:
            continue
        share = max(share for share, (loss, _) in rough.items() if loss < best + EXCLUDED)
        slow = dc.replace(noise[channel], slow_sd=rough[share][1], slow_time=share * length)
        if find_family(records.family).has_contact and weigh_quiet(records, solution, slow, c) < -settings.quiet:
            smaller = [dc.replace(slow, slow_sd=factor * slow.slow_sd) for factor in SMALLER]
            gain, slow = max(((weigh_quiet(records, solution, one, c), one) for one in smaller), key=lambda x: x[0])
            if gain <= settings.worth:
                continue
        found[channel] = dc.replace(
            slow, text=f"{noise[channel].text}; beside it a baseline that wanders by {slow.slow_sd:.2g} (SI)")
        roughness += 0.5 * (min(_fit_size(share * length, parts, limits, 2.0)[0] for share in SMOOTH_TIMES) - best)
    return SlowNoise(found, roughness)


@dc.dataclass(frozen=True)
class _Rows:
    """What one record tells of a baseline, in rows whose noise and settings together are white."""

    time: np.ndarray  # of the samples that are looked at
    whitening: np.ndarray  # shape (rows, samples): takes samples to these rows
    columns: np.ndarray  # of the free parameters and, last, the residuals, shape (rows, parameters + 1)
    determinant: float  # logarithm of that of the covariance of the rows before


def _fit_size(slow: float, parts: list[_Rows], limits: tuple[float, ...], power: float = 1.0) -> tuple[float, float]:
    """Loss of the best baseline with this correlation time, and its size: rough (power 1), or smooth (2)."""
    turned = [_turn(part, slow, power) for part in parts]
    one: Any = optimize.minimize_scalar(lambda x: _lose(float(np.exp(2.0 * x)), turned), bounds=limits,
                                        method="bounded", options={"xatol": 0.05})
    return float(one.fun), float(np.exp(one.x))


def _turn(part: _Rows, slow: float, power: float = 1.0) -> tuple[np.ndarray, np.ndarray, float]:
    """Columns in the principal axes of a baseline of unit size, its variances there, and the determinant before: the
    size changes nothing else."""
    lag = np.abs(part.time[:, None] - part.time) / slow
    variances, axes = np.linalg.eigh(part.whitening @ np.exp(-(lag**power) / power) @ part.whitening.T)
    return axes.T @ part.columns, np.maximum(variances, 0.0), part.determinant


def _lose(square: float, turned: Iterable[tuple[np.ndarray, np.ndarray, float]]) -> float:
    """Loss of a baseline of this variance."""
    cross, determinant = 0.0, 0.0
    for columns, variances, known in turned:
        cross = cross + (columns.T / (1.0 + square * variances)) @ columns
        determinant += known + float(np.sum(np.log1p(square * variances)))
    return _profile(np.asarray(cross), determinant)


def _gather_rows(records: Records, solution: Solution, noise: Noise, c: int) -> list[_Rows]:
    """Rows of every record that has enough: all of them, or what is orthogonal to where a record starts from, which has
    no prior, whitened by the covariance of the noise with that of the settings."""
    stack, found = records.stack, []
    time, weights, taps, values = (np.asarray(x) for x in (stack.time, stack.weights, stack.taps, stack.values))
    size, free = time.shape[1], np.array([name in records.starts for name in records.nuisances])
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
        covariance = noise.covariance(t[:, None] - t) * sizes[:, None] * sizes + own[:, ~free] @ own[:, ~free].T
        rest = np.concatenate([columns[:, own.shape[1]:], residual[:, None]], axis=1)
        found.append(_whiten_rows(t, covariance, rest, _list_rows_across(own[:, free])))
    return found


def _whiten_rows(time: np.ndarray, covariance: np.ndarray, columns: np.ndarray, across: np.ndarray) -> _Rows:
    """Combinations `across` of samples with this covariance, as white rows."""
    factor = linalg.cholesky(across @ covariance @ across.T, lower=True)
    whitening, columns = (linalg.solve_triangular(factor, across @ x, lower=True) for x in (np.eye(len(time)), columns))
    return _Rows(time, whitening, columns, 2.0 * float(np.sum(np.log(np.diag(factor)))))


def _list_rows_across(columns: np.ndarray) -> np.ndarray:
    """Orthonormal combinations of rows to which columns add nothing, shape (combinations, rows)."""
    size = np.linalg.norm(columns, axis=0)
    told = columns[:, size > 0] / size[size > 0]
    if not told.size:
        return np.eye(len(columns))
    left, values, _ = np.linalg.svd(told)
    return left[:, int(np.sum(values > 1e-9 * values[0])):].T


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
    return _profile(np.asarray(cross), determinant)


def _profile(cross: np.ndarray, determinant: float) -> float:
    """Minus twice the logarithm of the restricted likelihood, from the products of whitened columns of the parameters
    and the residuals, and the logarithm of the determinant of the rows' covariance."""
    square, side, left = cross[:-1, :-1], cross[:-1, -1], float(cross[-1, -1])
    scale = np.sqrt(np.maximum(np.diag(square), 1e-300))
    if len(scale):
        values, vectors = np.linalg.eigh(square / np.outer(scale, scale))
        told = values > 1e-10 * values[-1]
        left -= float(np.sum((vectors.T @ (side / scale))[told] ** 2 / values[told]))
        determinant += float(np.sum(np.log(values[told])) + 2.0 * np.sum(np.log(scale)))
    return left + determinant
