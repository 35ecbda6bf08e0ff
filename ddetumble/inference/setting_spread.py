"""How far the settings of the records really scatter: a variance of their own, with the stated one as prior."""

import dataclasses as dc
from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy import optimize, stats

from .goodness import combine_p_values
from .problem import Solution
from .slow_noise import lose_restricted
from .stack import Records, is_added


FREE = 3  # degrees of freedom with which a scatter is worth anything
APART = 0.03  # range of a logarithm below which a condition was held


@dc.dataclass(frozen=True)
class SpreadSettings:
    """When settings count as scattering more than stated."""

    # Standard deviation of the logarithm of the ratio to what is stated: a factor of three is no surprise
    prior: float = 1.0
    worth: float = 6.0  # logarithm of the likelihood that a larger scatter has to bring
    least: float = 1.3  # ratio below which nothing hangs on it
    most: float = 12.0  # ratio beyond which the setting would not be known at all
    fewest: int = 6  # records with which a scatter can be estimated
    # Of shifts that follow the conditions, below which they are no scatter: physics acts alike at like conditions,
    # errors do not; a p-value
    random: float = 0.01


SPREAD = SpreadSettings()


def list_settings(records: Records) -> list[int]:
    """Places among the nuisances of the settings that state an uncertainty."""
    deviations = np.asarray(records.stack.condition_sd)[: records.count]
    return [k for k, name in enumerate(records.nuisances)
            if name not in records.starts and not is_added(name)
            and (deviations[:, k] > 0).any()]


def estimate_spread(records: Records, solution: Solution, known: Mapping[str, float] | None = None,
                    settings: SpreadSettings = SPREAD) -> dict[str, float]:
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

    An F-test of the conditions' means about zero against the scatter within conditions, and t-tests of the mean and of
    the slope over the logarithm of every condition; the smallest p-value counts as often as there are tests, and it is
    0 where there are too few records to tell. Shifts and numbers of their conditions (`groups`) have shape (records,),
    `conditions`, which are positive, (records, conditions).
    """
    labels = np.unique(groups)
    within, chances = len(shifts) - len(labels), []
    if within >= FREE:
        means = np.array([shifts[groups == g].mean() for g in labels])
        sizes = np.array([np.sum(groups == g) for g in labels])
        scatter = sum(float(np.sum((shifts[groups == g] - m) ** 2)) for g, m in zip(labels, means, strict=True))
        chances.append(stats.f.sf(float(sizes @ means**2) / len(labels) / max(scatter / within, 1e-300), len(labels),
                                  within))
    if len(shifts) >= FREE + 2:
        logarithms = np.log(np.maximum(np.abs(conditions), 1e-300))
        tests: list[Any] = [stats.ttest_1samp(shifts, 0.0),
                            *(stats.linregress(x, shifts) for x in logarithms.T if np.ptp(x) > APART)]
        chances += [one.pvalue for one in tests]
    return combine_p_values([float(chance) for chance in chances if np.isfinite(chance)]) if chances else 0.0
