"""What a comparison of models on peaks hands on: one row a model, and the tests between them."""

import dataclasses as dc
from collections.abc import Mapping, Sequence

import numpy as np

from ..measurement.quantities import format_number, format_value


@dc.dataclass(frozen=True)
class PeakRow:
    """One model on one series of peaks; errors are relative to the measured value.

    Attributes:
        label: what the model is, for people.
        kind: `printed`, `polynomial`, `constant`, `reference`, `reading`, `effect` or `pair`.
        effects: ids of the effects in it.
        free: how many numbers were fitted.
        fitted: fitted peaks, shape (records,) [N].
        held: each record's peak by a fit without it, shape (records,) [N].
        nrmse, heldout, worst: rms error of the fit, rms and largest error held out [-].
        heldout_gas: rms error held out over the records with P0 > 0 only [-].
        chi2_reduced: mean square of the residuals over the noise's, per degree of freedom.
        p_value: of the lack of fit.
        estimates: by public name: `estimate`, `sd`, `q025`, `q975`, `unit`.
        physical: whether every estimate is within its physical range.
        remark: one phrase, where something has to be said.
    """

    label: str
    kind: str
    effects: tuple[str, ...]
    free: int
    fitted: np.ndarray
    held: np.ndarray
    nrmse: float
    heldout: float
    worst: float
    heldout_gas: float
    chi2_reduced: float
    p_value: float
    estimates: Mapping[str, Mapping] = dc.field(default_factory=dict)
    physical: bool = True
    remark: str = ""


@dc.dataclass(frozen=True)
class Noise:
    """How large errors of single peaks are, before any physical model is asked.

    Attributes:
        share: standard deviation over measured value, shape (records,) [-].
        degrees: degrees of freedom of the estimate; inf where the campaign states it.
        text: where it comes from, one sentence.
    """

    share: np.ndarray
    degrees: float
    text: str


@dc.dataclass(frozen=True)
class PairedDifference:
    """How two models differ on held-out records.

    Attributes:
        first, second: their labels.
        difference: mean of |error of first| - |error of second| over the records [-], > 0 where the second is better.
        standard_error: of that mean, records taken as independent [-].
        p_value: of the sign-flip test that the second is no better.
    """

    first: str
    second: str
    difference: float
    standard_error: float
    p_value: float

    @property
    def decided(self) -> bool:
        """Whether the second is better at 5 %."""
        return self.difference > 0 and self.p_value < 0.05


def compare_rows(first: PeakRow, second: PeakRow, peaks: np.ndarray) -> PairedDifference:
    """Paired difference of two models' held-out errors, with the p-value of `flip_signs`."""
    gap = _gap(first, second, peaks)
    return PairedDifference(first.label, second.label, float(gap.mean()),
                            float(gap.std(ddof=1) / np.sqrt(len(gap))), flip_signs(gap))


def flip_signs(gap: np.ndarray) -> float:
    """P-value of a mean above zero: its place among the means with the signs of the records flipped.

    All ways of flipping up to 12 records, else 4096 of them.

    Args:
        gap: one difference a record, shape (records,).
    """
    if len(gap) <= 12:
        flips = 1 - 2 * ((np.arange(2 ** len(gap))[:, None] >> np.arange(len(gap))) & 1)
    else:
        flips = np.random.default_rng(0).choice([-1, 1], size=(4096, len(gap)))
        flips[0] = 1
    return float(np.mean(flips @ gap >= gap.sum() - 1e-12))


def _gap(first: PeakRow, second: PeakRow, peaks: np.ndarray) -> np.ndarray:
    """|error of first| - |error of second| by record; failures count as errors of 1000 %."""
    a, b = np.abs(first.held / peaks - 1.0), np.abs(second.held / peaks - 1.0)
    gap = np.where(np.isfinite(a), a, 10.0) - np.where(np.isfinite(b), b, 10.0)
    # Ties within a millionth are ties: differences of two numerical solutions are no evidence.
    return np.where(np.abs(gap) < 1e-6, 0.0, gap)


def judge_lack(cost: float, free: int, records: int, noise: Noise) -> tuple[float, float]:
    """Reduced chi-square of a model against the noise, and its p-value.

    Args:
        cost: sum of squared relative residuals over the noise's share squared.
        free: fitted numbers.
        records: how many peaks.
        noise: where the noise comes from.

    Returns:
        Both; the p-value is nan where the peaks leave nothing to test with.
    """
    from scipy.stats import chi2, f

    left = records - free
    if left < 1:
        return float("nan"), float("nan")
    if np.isinf(noise.degrees):
        return cost / left, float(chi2.sf(cost, left))
    if noise.degrees < 1:
        return cost / left, float("nan")
    extra = left - noise.degrees
    if extra < 1:
        # As many numbers as the curve that stands in for the noise (or as conditions): adequacy cannot be tested.
        return cost / left, float("nan")
    return cost / left, float(f.sf(max(cost - noise.degrees, 0.0) / extra, extra, noise.degrees))


def measure_cost(row: PeakRow, peaks: np.ndarray, noise: Noise) -> float:
    """Chi-square of a model's fit against the noise."""
    return float(np.sum(((row.fitted / peaks - 1.0) / noise.share) ** 2))


def judge_gain(before: PeakRow, after: PeakRow, peaks: np.ndarray, noise: Noise, tried: int) -> float:
    """P-value that a larger model fits better by chance: F against the noise, with Sidak's allowance for `tried`."""
    from scipy.stats import f

    if noise.degrees < 1:
        return float("nan")
    extra = max(after.free - before.free, 1)
    gain = max(measure_cost(before, peaks, noise) - measure_cost(after, peaks, noise), 0.0)
    p = float(f.sf(gain / extra, extra, 1e6 if np.isinf(noise.degrees) else noise.degrees))
    return float(-np.expm1(max(tried, 1) * np.log1p(-p))) if p < 1.0 else 1.0


def tabulate(rows: Sequence[PeakRow], reference: PeakRow, peaks: np.ndarray,
             title: str = "behind the polynomial [%]"):
    """The side-by-side table as a pandas data frame, errors in per cent of the measured value.

    Args:
        rows: models.
        reference: the row against which held-out errors are paired (the polynomial).
        peaks: measured [N].
        title: of that column.
    """
    import pandas as pd

    lines, gas = [], any(row.heldout_gas != row.heldout for row in rows)
    for row in rows:
        pair = compare_rows(row, reference, peaks)
        told = describe_estimates(row.estimates)
        line = {
            "model": row.label,
            "fitted": row.free,
            "fit: rms [%]": _round(100 * row.nrmse),
            "left out: rms [%]": _round(100 * row.heldout),
            "left out: worst [%]": _round(100 * row.worst),
            "left out, rows with gas [%]": _round(100 * row.heldout_gas),
            title: ("–" if row is reference else
                                          f"{100 * pair.difference:+.2f} ± {100 * pair.standard_error:.2f}"),
            "estimates and remarks": "; ".join(part for part in (told, row.remark) if part),
        }
        if not gas:
            del line["left out, rows with gas [%]"]
        lines.append(line)
    return pd.DataFrame(lines)


def describe_estimates(estimates: Mapping[str, Mapping]) -> str:
    """Estimates with their standard errors on one line."""
    parts = []
    for name, value in estimates.items():
        estimate, sd = float(value["estimate"]), float(value["sd"])
        own = name.rpartition(".")[2] if "." in name else name.replace("_", " ")
        unit = f" {value['unit']}" if value["unit"] else ""
        if not np.isfinite(estimate):
            parts.append(f"{own} without limit")
        elif np.isfinite(sd) and sd > 0:
            shown = format_value(estimate, sd) if abs(estimate) > sd else format_number(estimate)
            parts.append(f"{own} = {shown} ± {format_value(sd, sd)}{unit}")
        else:
            parts.append(f"{own} = {format_number(estimate)}{unit}")
    return ", ".join(parts)


def _round(value: float) -> float | str:
    return round(value, 2) if np.isfinite(value) and value < 1e4 else "fails"


def decide_verdict(steps: Sequence[PeakRow], able: bool, level: float) -> str:
    """The verdict, as `formats.md` defines the five of them."""
    first, last = steps[0], steps[-1]
    if not np.isfinite(first.p_value):
        return "undecided"
    if first.p_value >= level:
        return "nothing-missing" if able else "undecided"
    # Flipping the signs of fewer than five records can never say that an effect helps.
    if len(steps) == 1:
        return "unexplained" if len(first.fitted) >= 5 else "undecided"
    return "explained" if last.p_value >= level else "improved"
