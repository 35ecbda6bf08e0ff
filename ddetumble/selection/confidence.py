"""Confidence in a verdict: how often such verdicts were right in the sealed exam, on simulated campaigns."""

import dataclasses as dc
import functools
import json
from collections.abc import Iterable, Mapping
from importlib import resources
from typing import Any

from ..inference import distributions as stats


RECORD = "track_record.json"  # counts by family, verdict and allowance; made by `python -m docs.track_record`
FEWEST = 10  # verdicts of a family that say something
PRIOR = 4.0  # verdicts by which the other families' rate counts beside a family's own: it is much the same for all


@dc.dataclass(frozen=True)
class Confidence:
    """How often a verdict of this kind was right.

    Attributes:
        right, judged: of so many simulated campaigns of the family that were judged so, how many rightly.
        probability: of being right, the family's own rate drawn to that of the others; low, high: 95 % interval.
        allowed: whether such verdicts had to allow for noise or settings that were not as stated.
    """

    right: int
    judged: int
    probability: float
    low: float
    high: float
    allowed: bool


def list_allowances(noise: Mapping[str, Mapping[str, Any]], **found: Any) -> tuple[str, ...]:
    """What was taken otherwise than stated: parts of the `noise` as in `result.json`, and what else was `found`."""
    parts = {"varies": "size of the noise", "slow_sd": "baseline", "hum": "hum"}
    return (*(text for key, text in parts.items() if any(one.get(key) for one in noise.values())),
            *(name for name, value in found.items() if value))


def find_confidence(family: str, verdict: str, allowed: bool, table: Iterable[Mapping[str, Any]] | None = None
                    ) -> Confidence | None:
    r"""Confidence in a verdict; None where too few of its kind have been examined, or it leaves the question open.

    The posterior of the rate under a beta prior of `PRIOR` verdicts at the other families' rate $p_0$,
    $\mathrm{Beta}(r + \nu p_0, n - r + \nu (1 - p_0))$. It holds for campaigns like those of the exam.

    Args:
        family: kind of test.
        verdict: as `result.json` has it.
        allowed: whether noise or settings were taken otherwise than stated (`list_allowances`).
        table: counts to take; those that are shipped where not given.
    """
    if verdict == "undecided":
        return None
    alike = [one for one in (read_track_record() if table is None else table)
             if one["verdict"] == verdict and one["allowed"] == allowed]
    right, judged = (sum(one[key] for one in alike if one["family"] == family) for key in ("right", "judged"))
    if judged < FEWEST:
        return None
    others = [one for one in alike if one["family"] != family]
    elsewhere = (sum(one["right"] for one in others) + 0.5) / (sum(one["judged"] for one in others) + 1.0)
    rate: Any = stats.beta(right + PRIOR * elsewhere, judged - right + PRIOR * (1.0 - elsewhere))
    low, high = map(float, rate.ppf([0.025, 0.975]))
    return Confidence(right, judged, float(rate.mean()), low, high, allowed)


@functools.cache
def read_track_record() -> tuple[dict[str, Any], ...]:
    """Counts that are shipped: `family`, `verdict`, `allowed`, `right` and `judged` of every kind of verdict."""
    text = (resources.files("ddetumble.selection") / RECORD).read_text(encoding="utf-8")
    return tuple(json.loads(text)["verdicts"])
