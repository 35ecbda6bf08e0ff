"""Models on one series of forces side by side: rows, noise, tests between them, and what any physics has to beat."""

import abc
import dataclasses as dc
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..measurement.quantities import format_number, format_value


def tidy_all(estimates: Mapping[str, Mapping]) -> dict[str, dict[str, Any]]:
    """Estimates by name as JSON takes them."""
    return {name: {key: tidy(value) for key, value in one.items()} for name, one in estimates.items()}


def sign(value: float, digits: int) -> str:
    """A number with a minus sign where it is negative."""
    return f"{value:.{digits}f}".replace("-", "−")


def tidy(value: Any) -> Any:
    """None in place of a number that JSON does not have; anything else as it is."""
    return value if not isinstance(value, (float, np.floating)) or np.isfinite(value) else None


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


def fit_linear(columns: np.ndarray, peaks: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    r"""Weighted least squares $y = X \beta$, and the leave-one-out prediction of each record.

    Args:
        columns: $X$, shape (records, terms).
        peaks: $y$, shape (records,) [N].
        weights: shape (records,) [1/N].

    Returns:
        Fitted values and held-out predictions, both of shape (records,) [N]. Held out: $y - r/(1 - h)$ with the
        leverage $h$, which is exact for linear least squares.
    """
    basis, _ = np.linalg.qr(columns * weights[:, None])
    leverage = np.sum(basis**2, axis=1)
    fitted = basis @ (basis.T @ (peaks * weights)) / weights
    free = leverage < 1.0 - 1e-9
    held = peaks - np.where(free, (peaks - fitted) / np.where(free, 1.0 - leverage, 1.0), np.nan)
    return fitted, held


def polynomial(pressures: np.ndarray, degree: int) -> np.ndarray:
    """Columns 1, P, ... P**degree with P scaled to -1..1, shape (records, degree + 1)."""
    middle, half = 0.5 * (pressures.max() + pressures.min()), 0.5 * np.ptp(pressures)
    return np.vander((pressures - middle) / (half if half > 0 else 1.0), degree + 1, increasing=True)


def choose_degree(pressures: np.ndarray, peaks: np.ndarray, weights: np.ndarray, most: int = 3) -> int:
    """Degree (0 to `most`) of the polynomial in pressure with the smallest leave-one-out error."""
    degrees = range(max(1, min(most + 1, len(np.unique(pressures)) - 1)))
    errors = []
    for degree in degrees:
        _, held = fit_linear(polynomial(pressures, degree), peaks, weights)
        error = float(np.sum(((held - peaks) * weights) ** 2))
        errors.append(error if np.isfinite(error) else np.inf)
    return int(np.argmin(errors))


def predict_nested(pressures: np.ndarray, peaks: np.ndarray, weights: np.ndarray, most: int = 3) -> np.ndarray:
    """Leave-one-out predictions of a polynomial whose degree is chosen anew inside every fold, shape (records,) [N]."""
    held = np.empty(len(peaks))
    for k in range(len(peaks)):
        rest = np.arange(len(peaks)) != k
        degree = choose_degree(pressures[rest], peaks[rest], weights[rest], most)
        columns = polynomial(pressures, degree)
        beta = np.linalg.lstsq(columns[rest] * weights[rest, None], peaks[rest] * weights[rest], rcond=None)[0]
        held[k] = columns[k] @ beta
    return held


def estimate_noise(conditions: Mapping[str, np.ndarray], peaks: np.ndarray, sd: np.ndarray | None,
                   along: str = "initial_pressure", words: str = "pressure") -> Noise:
    """Size of the error of single peaks: as stated, from repeats, or from the scatter about a low polynomial.

    Args:
        conditions: of the records, arrays of shape (records,), SI.
        peaks: measured [N].
        sd: stated standard deviation [N], or None.
        along: name of the condition in which the polynomial is; words: for people.
    """
    if sd is not None:
        return Noise(np.asarray(sd, float) / peaks, float("inf"), "The campaign states the uncertainty of its peaks.")
    _, group = np.unique(np.column_stack(list(conditions.values())), axis=0, return_inverse=True)
    group = group.ravel()
    repeats = len(peaks) - group.max() - 1
    if repeats >= 3:
        means = np.array([peaks[group == g].mean() for g in group])
        share = np.sqrt(np.sum((peaks / means - 1.0) ** 2) / repeats)
        return Noise(np.full(len(peaks), share), float(repeats),
                     f"From the scatter of repeats at equal conditions, {100 * share:.1f} % of the value.")
    pressures = conditions[along]
    degree = choose_degree(pressures, peaks, 1.0 / peaks)
    left = len(peaks) - degree - 1
    fitted, _ = fit_linear(polynomial(pressures, degree), peaks, 1.0 / peaks)
    if left < 1:
        return Noise(np.full(len(peaks), np.nan), 0.0, "There are too few peaks to tell how large their errors are.")
    share = float(np.sqrt(np.sum((fitted / peaks - 1.0) ** 2) / left))
    return Noise(np.full(len(peaks), share), float(left),
                 f"No uncertainty is stated: the scatter about a polynomial of degree {degree} in {words}, "
                 f"{100 * share:.1f} % of the value with {left} degrees of freedom, stands in for it.")


def judge_rivals(pressures: np.ndarray, peaks: np.ndarray, printed: np.ndarray | None, noise: Noise,
                 words: str = "pressure") -> list[PeakRow]:
    """Rows of the printed column times one factor (where there is one) and of polynomials; last the one to beat.

    The last row's degree is chosen by leave-one-out, and chosen anew inside every fold for its held-out error.
    `words` says what the condition is that stands in `pressures`.
    """
    weights, rows = 1.0 / (noise.share * peaks if np.isinf(noise.degrees) else peaks), []
    if printed is not None:
        fitted, held = fit_linear(np.asarray(printed, float)[:, None], peaks, weights)
        factor = float(fitted[0] / printed[0])
        spread = float(np.sqrt(np.sum((fitted / peaks - 1) ** 2) / max(len(peaks) - 1, 1) / len(peaks)))
        rows.append(make_row("printed theory × one factor", "printed", (), 1, fitted, held, peaks, pressures, noise,
                             {"factor": make_interval(factor, factor * spread)}))
    for degree in range(1, min(3, len(np.unique(pressures)) - 2) + 1):
        fitted, held = fit_linear(polynomial(pressures, degree), peaks, weights)
        name = {1: "straight line", 2: "parabola", 3: "cubic"}[degree]
        rows.append(make_row(f"{name} in {words}", "polynomial", (), degree + 1, fitted, held, peaks, pressures,
                             noise))
    degree = choose_degree(pressures, peaks, weights)
    fitted, _ = fit_linear(polynomial(pressures, degree), peaks, weights)
    held = predict_nested(pressures, peaks, weights)
    rows.append(make_row(f"low polynomial (degree {degree})", "polynomial", (), degree + 1, fitted,
                         held, peaks, pressures, noise, remark="degree by leave-one-out, chosen anew in every fold"))
    return rows


def measure_errors(columns: np.ndarray, residuals: np.ndarray) -> np.ndarray:
    """Standard errors of least squares from its residuals, shape (terms,); nan of a column of zeros.

    Args:
        columns: weighted, shape (records, terms); residuals: weighted, shape (records,).
    """
    size = np.linalg.norm(columns, axis=0)
    unit = columns / np.where(size > 0, size, 1.0)
    variance = np.sum(residuals**2) / max(len(residuals) - columns.shape[1], 1)
    return np.sqrt(variance * np.diag(np.linalg.pinv(unit.T @ unit))) / np.where(size > 0, size, np.nan)


def make_interval(value: float, sd: float, unit: str = "") -> dict[str, Any]:
    """An estimate with its standard error and the 95 % interval of a normal distribution."""
    return {"estimate": float(value), "sd": float(sd), "q025": float(value - 1.96 * sd),
            "q975": float(value + 1.96 * sd), "unit": unit}


def make_row(label: str, kind: str, effects: tuple[str, ...], free: int, fitted: np.ndarray, held: np.ndarray,
             peaks: np.ndarray, pressures: np.ndarray, noise: Noise, estimates: Mapping[str, Mapping] | None = None,
             physical: bool = True, remark: str = "") -> PeakRow:
    """A row from fitted and held-out peaks; see `PeakRow`."""
    error, out = fitted / peaks - 1.0, held / peaks - 1.0
    gas = pressures > 0
    ratio, p_value = judge_lack(float(np.sum((error / noise.share) ** 2)), free, len(peaks), noise)
    return PeakRow(label, kind, effects, free, fitted, held, _rms(error), _rms(out), float(np.max(np.abs(out))),
                   _rms(out[gas]) if gas.any() else float("nan"), ratio, p_value, estimates or {}, physical, remark)


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


@dc.dataclass(frozen=True, kw_only=True)
class AbstractJudgement(abc.ABC):
    """What forces without a curve say; `to_dict()` gives the fields of `result.json` that make sense for them.

    Attributes:
        campaign, family, model: names.
        verdict: `nothing-missing`, `explained`, `improved`, `unexplained` or `undecided`.
        effects: ids in the final model.
        sentence: plain words.
        pressures, peaks: as judged, shape (records,) [Pa, N]; a pressure of 0 where there is none.
        noise: size of the error of single forces.
        rows: every model tried, side by side.
        steps: rows of the reference model and, where effects help, of the models with them.
        reference: row of the reference model; `polynomial`: of the low polynomial.
        pairs: paired held-out differences.
        left_out: ids of effects that these forces cannot see, with the reason.
        level: of the tests.
        notes: further sentences.
    """

    campaign: str
    family: str
    model: str
    verdict: str
    effects: tuple[str, ...]
    sentence: str = ""
    pressures: np.ndarray
    peaks: np.ndarray
    noise: Noise
    rows: tuple[PeakRow, ...]
    steps: tuple[PeakRow, ...]
    reference: PeakRow
    polynomial: PeakRow
    pairs: tuple[PairedDifference, ...]
    left_out: Mapping[str, str]
    level: float
    notes: tuple[str, ...] = ()

    @abc.abstractmethod
    def table(self):
        """All rows side by side, a pandas data frame."""

    @abc.abstractmethod
    def to_dict(self) -> dict[str, Any]:
        """The fields of `result.json`."""

    def list_common(self) -> dict[str, Any]:
        """The fields of `result.json` that every judgement has."""
        final, had, steps = self.steps[-1], (), []
        for row in self.steps:
            steps.append({"added": " + ".join(e for e in row.effects if e not in had) or None, "nrmse": row.nrmse,
                          "chi2_reduced": tidy(row.chi2_reduced), "heldout_nrmse": row.heldout})
            had = row.effects
        return {
            "campaign": self.campaign, "family": self.family, "model": self.model, "verdict": self.verdict,
            "effects": list(self.effects), "steps": steps,
            "noise_nrmse": tidy(float(np.sqrt(np.mean(self.noise.share**2)))),
            "parameters": tidy_all(final.estimates),
            "lack_of_fit": {"statistic": tidy(final.chi2_reduced), "p_value": tidy(final.p_value),
                            "level": self.level, "text": self.noise.text},
            "rows": [{"model": r.label, "kind": r.kind, "free": r.free, "nrmse": tidy(r.nrmse),
                      "heldout_nrmse": tidy(r.heldout), "heldout_worst": tidy(r.worst), "physical": r.physical,
                      "remark": r.remark} for r in self.rows],
            "paired_differences": [dc.asdict(p) for p in self.pairs], "cannot_be_seen": dict(self.left_out),
            "notes": list(self.notes), "sentence": self.sentence,
        }
