"""Goodness of fit: whether a fit leaves more than noise does, or moves the settings further than their uncertainty."""

import dataclasses as dc
from collections.abc import Mapping, Sequence

import numpy as np

from ..measurement.quantities import join_words
from . import distributions as stats
from .noise import Noise, widen_by_student


LEVEL = 0.01  # chance of saying so of a model that is complete
# Chi-square per degree of freedom above which no error of the noise explains it: where the noise is measured from the
# residuals and correlated, its variance is known to a tenth or two.
FAR = 1.5
# Degrees of freedom beyond those of the noise's own estimate, below which values leave nothing to test with: of a
# parameter that they and its prior determine half and half.
LEAST = 0.5


@dc.dataclass(frozen=True)
class GoodnessOfFit:
    """What a fit leaves beyond noise and stated settings."""

    # chi2_reduced, p_value: chi-square per degree of freedom, and the chance that noise as taken leaves so much.
    chi2_reduced: float
    p_value: float
    # setting, record, shift: what was moved furthest, and how far in its stated deviations; '' where none may move.
    setting: str
    record: str
    shift: float
    shift_p_value: float  # chance that settings as uncertain as stated are moved so far
    disputed: tuple[str, ...] = ()  # parameters whose priors the records disagree with

    @property
    def misfit(self) -> bool:
        """Whether more is left than the noise explains."""
        return self.chi2_reduced > FAR and self.p_value < LEVEL

    @property
    def moved(self) -> bool:
        """Whether settings were moved further than their stated uncertainty explains."""
        return self.shift_p_value < LEVEL

    def __str__(self) -> str:
        """The conclusion in a sentence or two; '' where there is none to draw."""
        left = f"chi-square per degree of freedom is {self.chi2_reduced:.3g}"
        far = f"the {self.setting.replace('_', ' ')} of record {self.record} by {abs(self.shift):.2g} stated deviations"
        told = {
            (False, False): "",
            (True, False): f"The model does not describe the data within their noise: {left}.",
            (False, True): "The model describes the data only with settings shifted further than their stated "
                           f"uncertainty allows: {far}.",
            (True, True): "The model does not describe the data within their noise and the stated uncertainty of the "
                          f"settings: {left}, and the fit shifted {far}.",
        }[self.misfit, self.moved]
        parts = []
        if self.disputed:
            it, its = ("it", "its prior") if len(self.disputed) == 1 else ("them", "their priors")
            parts.append(f"Records and prior disagree on {join_words(self.disputed)}: by themselves the records put "
                         f"{it} far from {its}.")
        if told:
            parts.append(f"{told} The uncertainties of the parameters do not say how far off they are for what the "
                         "model lacks; `ddetumble discover` looks for it.")
        return " ".join(parts)


def judge_goodness(chi2: float, degrees: float, shifts: Mapping[str, Mapping[str, float]], chance: float | None = None
                   ) -> GoodnessOfFit:
    """The goodness of fit of a chi-square, by the shifts of settings in their deviations, by setting and record.

    `chance` is the p-value of the chi-square where its noise was measured too, from few values.
    """
    size = {(name, record): abs(value) for name, own in shifts.items() for record, value in own.items()}
    name, record = max(size, key=lambda one: size[one], default=("", ""))
    p_value = combine_p_values([weigh_shifts(np.array(list(own.values()))) for own in shifts.values() if own])
    if chance is None:
        chance = float(stats.chi2.sf(chi2, degrees)) if degrees > 0 else 1.0
    largest = shifts[name][record] if name else 0.0
    return GoodnessOfFit(chi2 / max(degrees, 1), chance, name, record, largest, p_value)


def weigh_shifts(shifts: np.ndarray) -> float:
    """p-value of the shifts of one setting, in stated deviations: of their sum of squares and of the largest."""
    together = float(stats.chi2.sf(np.sum(shifts**2), len(shifts)))
    alone = len(shifts) * 2.0 * float(stats.norm.sf(np.max(np.abs(shifts))))
    return combine_p_values((together, alone))


def combine_p_values(values: Sequence[float]) -> float:
    """The p-value of the smallest of several (Bonferroni)."""
    return min(len(values) * min(values), 1.0) if values else 1.0


def doubt_level(noise: Mapping[str, Noise]) -> float:
    """Standard error of the logarithm of the noise's power, of the channel where it is known least."""
    return max(n.log_level_sd for n in noise.values())


def judge_values(total: float, degrees: float, noise: Mapping[str, Noise]) -> float:
    r"""p-value of a chi-square of values, of which every record has one.

    Where the noise was estimated from the same values, with $\nu$ degrees of freedom, their scatter is a part of what
    the model leaves: $F = (\chi^2 - \nu)/(d - \nu)$ with $d - \nu$ and $\nu$ degrees of freedom tests the rest. 1 where
    the values leave nothing to test with.

    Args:
        total, degrees: $\chi^2$ of the values under their noise, and its degrees of freedom d.
        noise: by channel.
    """
    estimated, rest = [n for n in noise.values() if n.degrees], count_rest(degrees, noise)
    if rest < LEAST:
        return 1.0
    if not estimated:
        return float(stats.f.sf(total / degrees, degrees, 2.0 / doubt_level(noise) ** 2))
    known = sum(n.degrees for n in estimated)
    # Under the noise itself, not that which is taken larger for how little tells of it.
    total *= min(widen_by_student(n.degrees) for n in estimated) ** 2
    return float(stats.f.sf(max(total - known, 0.0) / rest, rest, known))


def count_rest(degrees: float, noise: Mapping[str, Noise]) -> float:
    """Degrees of freedom of a chi-square of values, without those that their noise was estimated from [-]."""
    return degrees - sum(n.degrees or 0 for n in noise.values())
