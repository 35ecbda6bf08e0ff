r"""How much wider intervals are than the noise, taken as it was measured, makes them.

The covariance of a fit takes the noise as known. Where its power at the contact's own frequencies had to be measured,
it is known with an error: with the standard error $s$ of its logarithm, that of a power measured with $\nu$ degrees of
freedom, $s^2 = \psi'(\nu/2) \approx 2/\nu + 2/\nu^2$, and an estimate over its standard deviation is Student's
$t_\nu$. What several channels tell of a parameter adds up as Satterthwaite has it (Biometrics Bulletin 2, 1946):
$s^2 = \sum_c w_c^2 s_c^2$ with the share $w_c$ of the estimate's variance that comes of the noise of channel $c$. Where
noise is not what it was taken for at all, the scatter of records says how far estimates stray.
"""

import dataclasses as dc
from collections.abc import Mapping

import numpy as np

from ..measurement.quantities import format_number
from . import distributions as stats
from .goodness import doubt_level
from .noise import Noise
from .problem import Problem, Solution
from .record_scatter import FAINT, SCATTER, ScatterSettings, tell_scatter, widen_by_scatter


@dc.dataclass(frozen=True)
class Widening:
    """By how much intervals are wider than the noise, taken as it was measured, makes them, and why."""

    factors: Mapping[str, float]  # of standard deviations, by free parameter; empty where none grows materially
    doubt: float  # standard error of the logarithm of the noise's power, of the channel where it is known least
    scattered: bool  # whether they are those of the scatter of records
    estimated: bool  # whether the scatter of settings was estimated from the same records

    def tell(self) -> str:
        """What was done to the intervals, as a sentence; empty where nothing was."""
        if self.scattered:
            return tell_scatter(self.factors, self.estimated)
        if not self.factors:
            return ""
        return (f"How loud the noise is at the signal's own frequencies was measured, to {100 * self.doubt:.0f} % of "
                f"its power: intervals are up to {format_number(max(self.factors.values()), 3)} times as wide as if it "
                "were known.")


def widen_intervals(problem: Problem, solution: Solution, noise: Mapping[str, Noise], estimated: bool = False,
                    settings: ScatterSettings = SCATTER) -> Widening:
    """By how much the standard deviations of the free parameters grow for what is not known of the noise.

    They are those of the scatter of records where `widen_by_scatter` gives any, and at least those of the error of the
    noise's level.
    """
    scattered = widen_by_scatter(problem, solution, noise, estimated, settings)
    factors = {name: max(factor, scattered.get(name, 1.0))
               for name, factor in widen_by_level(problem, solution, noise).items()}
    if not scattered and max(factors.values(), default=1.0) < settings.material:
        factors = {}
    return Widening(factors, doubt_level(noise), bool(scattered), estimated)


def widen_by_level(problem: Problem, solution: Solution, noise: Mapping[str, Noise]) -> dict[str, float]:
    """Factor of the standard deviation of each free parameter for the error of the noise's level; 1 where it has none.

    Values, of which every record has one, have Student's t in their noise already.
    """
    levels = np.array([noise[channel].log_level_sd for channel in problem.records.channels])
    if not solution.names or problem.records.are_values or solution.failed or not levels.any():
        return dict.fromkeys(solution.names, 1.0)
    variance = np.sum((share_variance(solution, len(levels)) * levels[:, None]) ** 2, axis=0)
    return {name: widen_by_doubt(float(v)) for name, v in zip(solution.names, variance, strict=True)}


def widen_by_doubt(variance: float) -> float:
    """How many times as wide an interval is as with known noise, from the variance of the logarithm of its power."""
    if variance <= 0.0:
        return 1.0
    degrees = (1.0 + np.sqrt(1.0 + 2.0 * variance)) / variance
    return float(stats.t.ppf(0.975, degrees) / stats.norm.ppf(0.975))


def share_variance(solution: Solution, channels: int) -> np.ndarray:
    """Share of the variance of every free parameter that comes of the noise of each channel, shape (channels, free).

    What is left to one comes of priors, of the parameters and of the records' own settings.
    """
    columns, _ = solution.projected()
    squares = np.maximum(np.sum(columns**2, axis=(0, 1)) + solution.prior_weight**2, FAINT)
    columns, prior = columns / np.sqrt(squares), solution.prior_weight**2 / squares
    values, vectors = np.linalg.eigh(np.einsum("grk,grl->kl", columns, columns) + np.diag(prior))
    covariance = (vectors / np.maximum(values, FAINT)) @ vectors.T
    records, data, _ = solution.shared.shape
    parts = columns[:, :data].reshape(records, channels, data // channels, -1)
    information = np.einsum("gcrk,gcrl->ckl", parts, parts)
    return np.einsum("ik,ckl,li->ci", covariance, information, covariance) / np.diag(covariance)
