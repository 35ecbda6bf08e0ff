"""Estimates beyond what physics allows: a model that needs one fits, and explains nothing."""

import dataclasses as dc
from collections.abc import Sequence

import numpy as np

from ..inference.problem import Solution
from .records import Candidate
from .workbench import Workbench


LARGEST_PART = 0.8  # share of a misfit from which an effect removes most of it


@dc.dataclass(frozen=True)
class Unphysical:
    """An estimate whose 95 % interval lies wholly beyond what physics allows.

    Attributes:
        name: of the parameter, `effect-id.symbol`.
        estimate, low, high: value and interval, in `unit`.
        limits: what physics allows, in the same unit; `reason` why.
    """

    name: str
    estimate: float
    low: float
    high: float
    unit: str
    limits: tuple[float, float]
    reason: str

    def __str__(self) -> str:
        low, high = self.limits
        allowed = (f"{low:.4g} at least" if high == float("inf") else f"{high:.4g} at most" if low == -float("inf")
                   else f"{low:.4g} to {high:.4g}")
        value = f"{self.estimate:.3g} {self.unit}".rstrip()
        return f"{self.name} = {value}, where physics allows {allowed} ({self.reason})"


def list_unphysical(workbench: Workbench, solution: Solution) -> tuple[Unphysical, ...]:
    """Free parameters of a fit whose 95 % interval lies wholly beyond their physical limits."""
    sd = np.sqrt(np.maximum(np.diag(solution.covariance()), 0.0))
    found = []
    for name, width in zip(solution.names, sd, strict=True):
        p = workbench.space.slots[workbench.space.index[name]].parameter
        value = workbench.space.public(name, solution.u, float(width))
        if p.excludes(value["q025"], value["q975"]):
            found.append(Unphysical(name, value["estimate"], value["q025"], value["q975"], value["unit"], p.limits,
                                    p.limits_reason))
    return tuple(found)


def describe_beyond(effects: Sequence[str], unphysical: Sequence[Unphysical]) -> str:
    """Sentence on a model that removes a misfit at values that physics does not allow."""
    names = " and ".join(effects)
    would = "fit better" if len(effects) > 1 else "fits better"
    return f"{names.capitalize()} {would}, and explain{'' if len(effects) > 1 else 's'} nothing: " + "; ".join(
        map(str, unphysical)) + "."


def describe_imitation(candidates: Sequence[Candidate]) -> tuple[str, ...]:
    """Sentence on the effect that removes most of a misfit alone, at values beyond its limits; none where none does."""
    for one in sorted(candidates, key=lambda c: -c.explains):
        if one.beyond and one.explains > LARGEST_PART:
            return (f"{one.effect.capitalize()} alone would remove {100 * one.explains:.0f} % of the misfit, and "
                    f"explains nothing: {one.text}.",)
    return ()
