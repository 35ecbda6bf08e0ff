"""What any physics has to beat: the source's printed column times one factor, and a low polynomial in pressure."""

from collections.abc import Mapping

import numpy as np

from .fits import choose_degree, fit_linear, polynomial, predict_nested
from .rows import Noise, PeakRow, judge_lack


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
        value = {"estimate": factor, "sd": factor * spread, "q025": factor * (1 - 1.96 * spread),
                 "q975": factor * (1 + 1.96 * spread), "unit": ""}
        rows.append(make_row("printed theory × one factor", "printed", (), 1, fitted, held, peaks, pressures, noise,
                             {"factor": value}))
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
