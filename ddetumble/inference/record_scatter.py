r"""How far estimates scatter from record to record, whatever the noise along a record is.

The covariance of a fit is right where the noise is as it was taken. Noise that is slower than its spectrum above the
contact's frequencies tells, or whose size changes in a way that nobody modelled, moves the estimates further. Records
are independent of one another all the same, so that what each of them adds to the gradient tells how far the estimate
scatters: with projected columns $X_r$ (each record's nuisances eliminated), residuals $e_r$ and
$H = (\sum_r X_r^T X_r)^{-1}$ the cluster-robust covariance is $H\,\sum_r g_r g_r^T\,H$, where
$g_r = (1 - X_r^T X_r H)^{-1/2} X_r^T e_r$ allows for what the fit took of each record (CR2 of Bell and McCaffrey,
Survey Methodology 28, 2002).
"""

import dataclasses as dc
from collections.abc import Mapping

import numpy as np

from ..families import find_family
from ..measurement.quantities import format_number
from . import distributions as stats
from .goodness import doubt_level
from .noise import Noise
from .problem import Problem, Solution
from .smooth import measure_smooth, smooth_bases


@dc.dataclass(frozen=True)
class ScatterSettings:
    """When intervals are those of the scatter of records."""

    # Chance, of noise as it was taken, that the smooth part of the residuals is as loud: beyond it the noise is not as
    # taken. Ordinary campaigns keep the covariance of their noise, which is better known than that of a few records.
    level: float = 0.01
    fewest: int = 8  # records: with fewer their scatter is known worse than to a quarter
    # Leverage of a record on a combination of parameters, beyond which what the fit took of it is not made up for: the
    # record alone determines it.
    leverage: float = 0.95
    # Factor by which the error of the noise's level widens an interval, below which it is left as it is: two per cent
    # of a standard deviation are within what fits agree to.
    material: float = 1.02


SCATTER = ScatterSettings()
FAINT = 1e-12  # of squared lengths: what is below tells nothing of a combination of parameters


def measure_scatter(solution: Solution, student: float = 1.0, settings: ScatterSettings = SCATTER) -> np.ndarray:
    """Variance of every free parameter by the scatter of records, over that by the fit, shape (free,).

    What records tell is `student` times as uncertain as they scatter; priors are taken as they are.
    """
    columns, side = solution.projected()
    squares = np.maximum(np.sum(columns**2, axis=(0, 1)) + solution.prior_weight**2, FAINT)
    columns, prior = columns / np.sqrt(squares), solution.prior_weight**2 / squares
    information = np.einsum("grk,grl->gkl", columns, columns)
    gradients = np.einsum("grk,gr->gk", columns, side)
    values, vectors = np.linalg.eigh(information.sum(axis=0))
    root = vectors / np.sqrt(np.maximum(values, FAINT))  # of the inverse for the records alone: root root^T
    # Where priors pull, the gradients do not add up to nought: those at the optimum of the records alone do.
    gradients = gradients - information @ (root @ (root.T @ gradients.sum(axis=0)))
    leverage, turns = np.linalg.eigh(root.T @ information @ root)
    shrunk = np.einsum("gkl,gk->gl", turns, gradients @ root)
    made_up = np.einsum("gkl,gl->gk", turns, shrunk / np.sqrt(1.0 - np.minimum(leverage, settings.leverage)))
    meat = np.linalg.pinv(root.T) @ (made_up.T @ made_up) @ np.linalg.pinv(root)
    values, vectors = np.linalg.eigh(information.sum(axis=0) + np.diag(prior))
    covariance = (vectors / np.maximum(values, FAINT)) @ vectors.T
    return np.diag(covariance @ (student**2 * meat + np.diag(prior)) @ covariance) / np.diag(covariance)


def widen_by_scatter(problem: Problem, solution: Solution, noise: Mapping[str, Noise], estimated: bool = False,
                     settings: ScatterSettings = SCATTER) -> dict[str, float]:
    """Factors by which standard deviations of the free parameters grow, where noise is not as it was taken; else none.

    They are those of the scatter of records, with Student's t for the few that there are, and never below 1. They are
    always given where the scatter of settings was `estimated` from the same records. None are given where the noise is
    taken as stated, and where records are too few. Where a force is missing from the model they say how far its best
    parameters stray, not how far these lie from those of the model that has it.
    """
    records = problem.records
    free, count = len(solution.names), records.count
    if (not free or records.are_values or find_family(records.family).free_running or solution.failed
            or count < max(settings.fewest, free + 2) or not doubt_level(noise)):
        return {}
    if not estimated:
        total, degrees = measure_smooth(problem, solution, smooth_bases(problem, solution.end))
        if degrees < 1 or stats.chi2.sf(total, degrees) >= settings.level:
            return {}
    student = float(stats.t.ppf(0.975, count - free) / stats.norm.ppf(0.975))
    factors = np.sqrt(np.maximum(measure_scatter(solution, student, settings), 1.0))
    return {name: float(factor) for name, factor in zip(solution.names, factors, strict=True)}


def tell_scatter(widened: Mapping[str, float], estimated: bool = False) -> str:
    """What was done to the intervals, as a sentence."""
    most = max(widened.values())
    told = f"up to {format_number(most, 2)} times as wide" if most > 1.0 else "which is no wider here"
    why = ("How far the settings scatter was estimated from these records" if estimated else
           "The residuals hold more that is slow over a contact than the noise along the records tells")
    return f"{why}: the intervals are those of the scatter from record to record, {told}."
