"""Single forces and models of them side by side: noise, tests between models, and what any physics has to beat."""

import abc
import dataclasses as dc
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
from scipy import stats

from ..inference.files import make_plain
from ..measurement.quantities import format_number, format_value


LEVEL = 0.05  # of the tests; few numbers could show nothing at a stricter one
WORDS = {"initial_pressure": "pressure", "normal_load": "load"}


@dc.dataclass(frozen=True)
class Forces:
    """Measured forces without a curve, and how large their errors are before any physical model is asked.

    Attributes:
        conditions: arrays of shape (records,), SI.
        along: name of the condition over which polynomials run.
        peaks: measured, shape (records,) [N].
        share: standard deviation over measured value, shape (records,) [-].
        degrees: degrees of freedom of that; inf where the campaign states it.
        text: where it comes from, one sentence.
    """

    conditions: Mapping[str, np.ndarray]
    along: str
    peaks: np.ndarray
    share: np.ndarray
    degrees: float
    text: str

    def __len__(self) -> int:
        return len(self.peaks)

    @property
    def x(self) -> np.ndarray:
        """The condition over which polynomials run, shape (records,)."""
        return self.conditions[self.along]

    @property
    def weights(self) -> np.ndarray:
        """One over the stated standard deviation, or over the value where none is stated, shape (records,) [1/N]."""
        return 1.0 / (self.share * self.peaks if np.isinf(self.degrees) else self.peaks)


@dc.dataclass(frozen=True)
class PeakRow:
    """One model of forces; errors are relative to the measured value.

    Attributes:
        forces: that it describes.
        label: what the model is, for people.
        kind: `printed`, `polynomial`, `constant`, `reference`, `reading`, `effect`, `pair`, `choice` or `correction`.
        effects: ids of the effects in it.
        free: how many numbers were fitted.
        fitted: fitted forces, shape (records,) [N].
        held: each record's force by a fit without it, shape (records,) [N].
        estimates: by public name: `estimate`, `sd`, `q025`, `q975`, `unit`.
        physical: whether every estimate is within its physical range.
        remark: one phrase, where something has to be said.
    """

    forces: Forces
    label: str
    kind: str
    effects: tuple[str, ...]
    free: int
    fitted: np.ndarray
    held: np.ndarray
    estimates: Mapping[str, Mapping] = dc.field(default_factory=dict)
    physical: bool = True
    remark: str = ""

    @property
    def error(self) -> np.ndarray:
        """Relative errors of the fit, shape (records,) [-]."""
        return self.fitted / self.forces.peaks - 1.0

    @property
    def out(self) -> np.ndarray:
        """Relative errors held out, shape (records,) [-]."""
        return self.held / self.forces.peaks - 1.0

    @property
    def nrmse(self) -> float:
        """Rms error of the fit [-]."""
        return _rms(self.error)

    @property
    def heldout(self) -> float:
        """Rms error held out [-]."""
        return _rms(self.out)

    @property
    def heldout_gas(self) -> float:
        """Rms error held out over the records with P0 > 0 only [-]."""
        gas = self.forces.x > 0
        return _rms(self.out[gas]) if gas.any() else float("nan")

    @property
    def worst(self) -> float:
        """Largest error held out [-]."""
        return float(np.max(np.abs(self.out)))

    @property
    def worst_fit(self) -> float:
        """Largest error of the fit [-]."""
        return float(np.max(np.abs(self.error)))

    @property
    def cost(self) -> float:
        """Chi-square of the fit against the noise."""
        return float(np.sum((self.error / self.forces.share) ** 2))

    @property
    def chi2_reduced(self) -> float:
        """Chi-square per degree of freedom; nan where none is left."""
        left = len(self.forces) - self.free
        return self.cost / left if left >= 1 else float("nan")

    @property
    def p_value(self) -> float:
        """Of the lack of fit; nan where the forces leave nothing to test with."""
        left, degrees = len(self.forces) - self.free, self.forces.degrees
        if left >= 1 and np.isinf(degrees):
            return float(stats.chi2.sf(self.cost, left))
        # With as many numbers as the curve that stands in for the noise (or as conditions) adequacy cannot be tested.
        extra = left - degrees
        if degrees < 1 or extra < 1:
            return float("nan")
        return float(stats.f.sf(max(self.cost - degrees, 0.0) / extra, extra, degrees))


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


@dc.dataclass(frozen=True)
class PairedDifference:
    """How two models differ on held-out records.

    Attributes:
        first, second: their labels.
        difference: mean of |error of first| - |error of second| over the records [-], > 0 where the second is better.
        standard_error: of that mean, records taken as independent [-].
        p_value: that the second is no better, by flipping signs.
    """

    first: str
    second: str
    difference: float
    standard_error: float
    p_value: float

    @property
    def decided(self) -> bool:
        """Whether the second is better at 5 %."""
        return self.difference > 0 and self.p_value < LEVEL

    @property
    def told(self) -> bool:
        """Whether the two differ by more than two standard errors."""
        return abs(self.difference) > 2 * self.standard_error


def compare_rows(first: PeakRow, second: PeakRow) -> PairedDifference:
    """Paired difference of two models' held-out errors; failures count as 1000 %.

    The p-value is the place of the mean among those with the signs of the records flipped, in all ways up to 12
    records, else in 4096.
    """
    a, b = (np.nan_to_num(np.abs(row.out), nan=10.0, posinf=10.0) for row in (first, second))
    # Ties within a millionth are ties: differences of two numerical solutions are no evidence.
    gap = np.where(np.abs(a - b) < 1e-6, 0.0, a - b)
    if len(gap) <= 12:
        flips = 1 - 2 * ((np.arange(2 ** len(gap))[:, None] >> np.arange(len(gap))) & 1)
    else:
        flips = np.random.default_rng(0).choice([-1, 1], size=(4096, len(gap)))
        flips[0] = 1
    return PairedDifference(first.label, second.label, float(gap.mean()), float(gap.std(ddof=1) / np.sqrt(len(gap))),
                            float(np.mean(flips @ gap >= gap.sum() - 1e-12)))


def judge_gain(before: PeakRow, after: PeakRow, tried: int) -> float:
    """P-value that a larger model fits better by chance: F against the noise, with Sidak's allowance for `tried`."""
    degrees = before.forces.degrees
    if degrees < 1:
        return float("nan")
    extra = max(after.free - before.free, 1)
    gain = max(before.cost - after.cost, 0.0)
    p = float(stats.f.sf(gain / extra, extra, 1e6 if np.isinf(degrees) else degrees))
    return float(-np.expm1(max(tried, 1) * np.log1p(-p))) if p < 1.0 else 1.0


def pick_helping(before: PeakRow, after: Sequence[PeakRow], level: float) -> list[PeakRow]:
    """Physical models whose addition is seen, fits better beyond the noise (given how many were tried) and holds out
    better; the best first."""
    found = []
    for row in after:
        added = [value for name, value in row.estimates.items() if name not in before.estimates]
        seen = any(abs(value["estimate"]) > 2.0 * value["sd"] for value in added)
        if (row.physical and seen and judge_gain(before, row, len(after)) < level
                and compare_rows(before, row).decided):
            found.append(row)
    return sorted(found, key=lambda row: row.heldout)


def measure_visible(others: np.ndarray, signature: np.ndarray) -> tuple[float, float]:
    """Share of a signature, shape (records,), that survives refits of others, shape (records, others); what is left."""
    basis, _ = np.linalg.qr(others)
    size, left = np.linalg.norm(signature), np.linalg.norm(signature - basis @ (basis.T @ signature))
    return (float(left / size), float(left)) if size > 0 else (0.0, 0.0)


def has_power(visible: float, base: PeakRow, level: float) -> bool:
    """Whether an effect of three times the noise is noticed more often than not.

    Args:
        visible: share of its signature that survives the reference parameters [-].
        base: the reference model.
        level: of the test.
    """
    records, degrees = len(base.forces), base.forces.degrees
    left = records - base.free
    if left < 1 or degrees < 1:
        return False
    strength = 9.0 * records * visible**2
    if np.isinf(degrees):
        return bool(stats.ncx2.sf(stats.chi2.isf(level, left), left, strength) >= 0.5)
    extra = max(left - degrees, 1)
    return bool(stats.ncf.sf(stats.f.isf(level, extra, degrees), extra, degrees, strength) >= 0.5)


def tabulate(rows: Sequence[PeakRow], reference: PeakRow, title: str):
    """The side-by-side table as a pandas data frame, errors in per cent of the measured value.

    Args:
        rows: models.
        reference: the row against which held-out errors are paired; title: of that column.
    """
    import pandas as pd

    def show(value: float) -> float | str:
        return round(100 * value, 2) if np.isfinite(value) and value < 100 else "fails"

    lines = []
    for row in rows:
        pair, told = compare_rows(row, reference), describe_estimates(row.estimates)
        lines.append({
            "model": row.label, "fitted": row.free, "fit: rms [%]": show(row.nrmse),
            "left out: rms [%]": show(row.heldout), "left out: worst [%]": show(row.worst),
            "left out, rows with gas [%]": show(row.heldout_gas),
            title: "–" if row is reference else f"{100 * pair.difference:+.2f} ± {100 * pair.standard_error:.2f}",
            "estimates and remarks": "; ".join(part for part in (told, row.remark) if part),
        })  # fmt: skip
    table = pd.DataFrame(lines)
    gas = any(row.heldout_gas != row.heldout for row in rows)
    return table if gas else table.drop(columns="left out, rows with gas [%]")


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


def gather_forces(conditions: Mapping[str, np.ndarray], along: str, peaks: np.ndarray, sd: np.ndarray | None) -> Forces:
    """Forces with the size of their errors: as stated, from repeats, or from the scatter about a low polynomial.

    Args:
        conditions: of the records, arrays of shape (records,), SI.
        along: name of the condition in which the polynomial is.
        peaks: measured [N].
        sd: stated standard deviation [N], or None.
    """
    conditions = {name: np.asarray(value, float) for name, value in conditions.items()}
    peaks = np.asarray(peaks, float)
    if sd is not None:
        return Forces(conditions, along, peaks, np.asarray(sd, float) / peaks, float("inf"),
                      "The campaign states the uncertainty of its peaks.")
    _, group = np.unique(np.column_stack(list(conditions.values())), axis=0, return_inverse=True)
    group = group.ravel()
    repeats = len(peaks) - group.max() - 1
    if repeats >= 3:
        means = np.array([peaks[group == g].mean() for g in group])
        share, left = float(np.sqrt(np.sum((peaks / means - 1.0) ** 2) / repeats)), repeats
        text = f"The scatter of repeats at equal conditions gives an error of {100 * share:.1f} % of the value."
    else:
        degree = choose_degree(conditions[along], peaks, 1.0 / peaks)
        left = len(peaks) - degree - 1
        fitted, _ = fit_linear(polynomial(conditions[along], degree), peaks, 1.0 / peaks)
        share = float(np.sqrt(np.sum((fitted / peaks - 1.0) ** 2) / left)) if left >= 1 else float("nan")
        text = "There are too few peaks to estimate their errors." if left < 1 else (
            f"No uncertainty is stated: the scatter about a polynomial of degree {degree} in {WORDS[along]}, "
            f"{100 * share:.1f} % of the value with {left} degrees of freedom, takes its place.")
    return Forces(conditions, along, peaks, np.full(len(peaks), share), float(max(left, 0)), text)


def judge_rivals(forces: Forces, printed: np.ndarray | None) -> list[PeakRow]:
    """Rows of the printed column times one factor (where there is one) and of polynomials; last the one to beat.

    The last row's degree is chosen by leave-one-out, and chosen anew inside every fold for its held-out error.
    """
    x, peaks, weights, rows = forces.x, forces.peaks, forces.weights, []
    if printed is not None:
        printed = np.asarray(printed, float)
        fitted, held = fit_linear(printed[:, None], peaks, weights)
        factor = float(fitted[0] / printed[0])
        spread = float(np.sqrt(np.sum((fitted / peaks - 1) ** 2) / max(len(peaks) - 1, 1) / len(peaks)))
        rows.append(PeakRow(forces, "printed theory × one factor", "printed", (), 1, fitted, held,
                            {"factor": make_interval(factor, factor * spread)}))
    for degree in range(1, min(3, len(np.unique(x)) - 2) + 1):
        name = {1: "straight line", 2: "parabola", 3: "cubic"}[degree]
        rows.append(PeakRow(forces, f"{name} in {WORDS[forces.along]}", "polynomial", (), degree + 1,
                            *fit_linear(polynomial(x, degree), peaks, weights)))
    degree = choose_degree(x, peaks, weights)
    fitted, _ = fit_linear(polynomial(x, degree), peaks, weights)
    held = predict_nested(x, peaks, weights)
    return [*rows, PeakRow(forces, f"low polynomial (degree {degree})", "polynomial", (), degree + 1, fitted, held,
                           remark="degree by leave-one-out, chosen anew in every fold")]


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


@dc.dataclass(frozen=True, kw_only=True)
class AbstractJudgement(abc.ABC):
    """What forces without a curve say.

    Attributes:
        campaign, model: names.
        verdict: `nothing-missing`, `explained`, `improved`, `unexplained` or `undecided`.
        forces: as judged, with the size of their errors.
        rows: every model tried, side by side.
        steps: rows of the reference model and, where effects help, of the models with them.
        reference: row of the reference model; `polynomial`: of the low polynomial.
        pairs: paired held-out differences.
        left_out: ids of effects that these forces cannot see, with the reason.
        level: of the tests.
        sentence: plain words; `notes`: further sentences.
    """

    family: ClassVar[str]
    campaign: str
    model: str
    verdict: str
    forces: Forces
    rows: tuple[PeakRow, ...]
    steps: tuple[PeakRow, ...]
    reference: PeakRow
    polynomial: PeakRow
    pairs: tuple[PairedDifference, ...]
    left_out: Mapping[str, str]
    level: float
    sentence: str = ""
    notes: tuple[str, ...] = ()

    @property
    def effects(self) -> tuple[str, ...]:
        """Ids of the effects in the final model."""
        return self.steps[-1].effects

    @property
    def peaks(self) -> np.ndarray:
        """Measured forces, shape (records,) [N]."""
        return self.forces.peaks

    @property
    def printed(self) -> list[PeakRow]:
        """Rows of the source's own column."""
        return [row for row in self.rows if row.kind == "printed"]

    @abc.abstractmethod
    def table(self) -> Any:
        """All rows side by side, a pandas data frame."""

    def to_dict(self) -> dict[str, Any]:
        """The fields of `result.json`."""
        final, had, steps = self.steps[-1], (), []
        for row in self.steps:
            steps.append({"added": " + ".join(e for e in row.effects if e not in had) or None, "nrmse": row.nrmse,
                          "chi2_reduced": row.chi2_reduced, "heldout_nrmse": row.heldout})
            had = row.effects
        return make_plain({
            "campaign": self.campaign, "family": self.family, "model": self.model, "verdict": self.verdict,
            "effects": self.effects, "steps": steps, "noise_nrmse": np.sqrt(np.mean(self.forces.share**2)),
            "parameters": final.estimates,
            "lack_of_fit": {"statistic": final.chi2_reduced, "p_value": final.p_value, "level": self.level,
                            "text": self.forces.text},
            "rows": [{"model": r.label, "kind": r.kind, "free": r.free, "nrmse": r.nrmse, "heldout_nrmse": r.heldout,
                      "heldout_worst": r.worst, "physical": r.physical, "remark": r.remark} for r in self.rows],
            "paired_differences": self.pairs, "cannot_be_seen": self.left_out, "notes": self.notes,
            "sentence": self.sentence,
        })  # fmt: skip
