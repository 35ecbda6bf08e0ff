"""The friction half of the paper as sections of the booklet: Table 4, Figures 11, 12 and 14, the band to avoid."""

import dataclasses as dc
import math
from collections.abc import Mapping
from typing import Any, cast

import numpy as np

from . import drawings
from . import friction_figures as figures
from .band import BAND, compare_band, find_band, measure_bends, place_band
from .friction import RELEASED, SCALED, FrictionJudgement, describe_best
from .shipped import find_data
from .slipping import CORRECTED, UNCORRECTED, err_scaled
from .words import sign


SHOWN = 2.05e6  # Pa, Figure 11


def read_friction() -> dict[str, np.ndarray]:
    """Table 4 with the loads and pressures assumed for it: `load`, `pressure`, `measured`, `printed`, `printed_error`.

    Returns:
        Arrays of shape (11,) [N, Pa, N, N, %]. Loads are Table 3's measured forces at the same index.
    """
    import pandas as pd

    folder = find_data("paper/table-4")
    records, peaks, errors = (pd.read_csv(folder / f"{name}.csv") for name in ("records", "peaks", "errors"))
    return {"load": records["normal_load"].to_numpy(float),
            "pressure": 1e6 * records["internal_pressure"].to_numpy(float),
            "measured": peaks["peak_friction_force"].to_numpy(float),
            "printed": peaks["printed_peak_friction_force"].to_numpy(float),
            "printed_error": errors["printed_error"].to_numpy(float)}


def draw_friction_points(table: Mapping[str, np.ndarray]) -> dict[int, tuple[str, Any]]:
    """Figures of rows 5, 6 and 13: by row, the file's name and the figure."""
    return {5: ("row-05-rest", figures.draw_rest(table["load"])),
            6: ("row-06-range", figures.draw_range(table["load"])),
            13: ("row-13-errors", figures.draw_friction_errors(table["measured"], table["printed"],
                                                               table["printed_error"]))}


def find_scale(judged: FrictionJudgement) -> float:
    """K sigma_0/p_r [-] at which Eq. 8 times one scale has the error at worst that the paper states for it."""
    from scipy.optimize import brentq

    def gap(logarithm):
        return 100 * err_scaled(judged.loads, judged.pressures, judged.peaks, np.exp(logarithm)) - UNCORRECTED

    return math.exp(cast(float, brentq(gap, math.log(0.02), math.log(50.0))))


def examine_band(judged: FrictionJudgement, misses: Mapping[str, float]) -> dict[str, Any]:
    """What the band of 1.5 to 1.9 MPa shows, as numbers for `paper.json` and sentences."""
    inside = find_band(judged.pressures)
    tests = [compare_band(row, judged.peaks, inside) for row in (judged.constant, judged.polynomial)]
    bends = measure_bends(judged.peaks)
    largest = np.argsort(-np.abs(bends))[:2] + 1
    placed = place_band(len(judged.peaks), misses)
    return {"rows": [int(k) + 1 for k in inside], "bends": bends, "largest": sorted(int(k) for k in largest),
            "tests": tests, "placed": placed}


def describe_band(judged: FrictionJudgement, found: Mapping[str, Any]) -> str:
    """The one sentence on the band, with its numbers."""
    plain, curve = found["tests"]
    bends, inside = found["bends"], [row - 1 for row in found["rows"]]
    places = [f"{judged.pressures[k] / 1e6:g}" for k in found["largest"]]
    return (f"The band of {BAND[0] / 1e6:g} to {BAND[1] / 1e6:g} MPa does not show in the paper's own numbers: its "
            f"{len(inside)} rows are off a constant coefficient by {100 * plain.inside:.1f} % (left out, mean), the "
            f"other {len(judged.peaks) - len(inside)} by {100 * plain.outside:.1f} % (p = {plain.p_value:.2f} among "
            f"all ways to choose {len(inside)} rows, {plain.p_adjacent:.1f} among neighbours), off the low polynomial "
            f"by {100 * curve.inside:.1f} against {100 * curve.outside:.1f} % (p = {curve.p_value:.2f}); friction "
            f"bends most at {' and '.join(places)} MPa ("
            + " and ".join(f"{bends[k - 1]:+.2f}".replace("-", "−") for k in found["largest"])
            + " N of second difference), not there ("
            + " and ".join(f"{bends[k - 1]:+.2f}".replace("-", "−") for k in inside) + " N).")


def describe_claim(judged: FrictionJudgement, at: float) -> list[str]:
    """What can be said of the uncorrected column, which is not printed."""
    scaled, worst = (next(row for row in judged.rows if row.label == name) for name in (SCALED, "constant coefficient"))

    def most(row):
        return 100 * float(np.max(np.abs(row.fitted / judged.peaks - 1.0)))

    printed = next(row for row in judged.rows if row.kind == "printed")
    return [
        f"The column of the uncorrected theory (Eq. 8, stated error {UNCORRECTED:g} %) is not printed, nor are the "
        f"constants behind it, so that the claim cannot be checked. Eq. 8 with one fitted scale is off by "
        f"{most(scaled):.0f} % at worst with the toolkit's K σ₀/pᵣ = 0.4, by {UNCORRECTED:g} % at {at:.2f} and by "
        f"{most(worst):.1f} % where adhesion is all of it: the size of that error is a matter of constants that the "
        f"paper does not give.",
        f"In that limit Eq. 8 is a constant coefficient. With one fitted number its worst row is {most(worst):.1f} % "
        f"off; the corrected law, with its five polynomials, is {most(printed):.1f} % off at worst as printed (stated: "
        f"less than {CORRECTED:g} %). There was nothing to correct that these eleven numbers could show.",
    ]


def write_friction(judged: FrictionJudgement, table: Mapping[str, np.ndarray], misses: Mapping[str, float]):
    """The sections, and what `paper.json` says of them.

    Args:
        judged: of Table 4.
        table: from `read_friction`.
        misses: of each assumed range of pressures against Figure 8, by name [%] (row 8).
    """
    from ..reports.page import Section

    at, found = find_scale(judged), examine_band(judged, misses)
    load, friction = (float(np.interp(SHOWN, table["pressure"], table[name])) for name in ("load", "measured"))
    released = next((row for row in judged.rows if row.label == RELEASED), judged.reference)
    mean, spread = judged.ratio
    band = describe_band(judged, found)
    same = sum(tuple(row - 1 for row in found["rows"]) == place for place in found["placed"])
    far = next(pair for pair in judged.pairs if pair.first == SCALED)
    against = drawings.draw_differences(
        [pair for pair in judged.pairs if pair is not far],
        "mean |error| of the first minus that of the constant [points]; > 0: the constant is better")
    sections = [
        Section(
            "Table 4: eleven friction forces, laws side by side",
            [f"Verdict: {judged.verdict}. {judged.sentence}", describe_best(judged),
             f"Friction over load, Table 4 over Table 3 at equal index, is {mean:.3f} ± {spread:.3f} (mean and "
             f"standard deviation of eleven). That the rows of the two tables belong together is an assumption, as are "
             f"the pressures (row 8 above).", *describe_claim(judged, at)],
            points=[note for note in judged.notes if note != describe_best(judged)],
            figures=[
                ("table-4-models", "Above: friction over load of fits to all eleven rows; the loads are assumed. "
                 "Below: each force predicted by a fit without it; the band is twice the scatter about the polynomial.",
                 figures.draw_friction_models(judged)),
                ("table-4-ladder", "Every law on Table 4, best first. Hatched: an estimate outside its physical range.",
                 drawings.draw_ladder(judged)),
                ("table-4-differences", "Paired differences of left-out errors against the constant coefficient, ± two "
                 f"standard errors. Grey: eleven numbers cannot tell the two apart. Off the scale: {SCALED}, "
                 f"{100 * far.difference:.1f} ± {100 * far.standard_error:.1f} points behind.", against),
                ("table-4-pressure", "Friction over load against pressure: Eq. 8 can only rise (left), and fits best "
                 f"with tan δ below 0 (right: {sign(released.estimates['loss_factor']['estimate'], 3)} ± "
                 f"{released.estimates['loss_factor']['sd']:.3f}), where it is not physical.",
                 figures.draw_coefficient(judged)),
                ("table-4-scale", "Largest error of Eq. 8 with one scale fitted to Table 4, over the constant that is "
                 f"not printed. The stated {UNCORRECTED:g} % comes out at {at:.2f}.",
                 figures.draw_scales(judged, UNCORRECTED, at)),
            ],
            tables=[judged.table()]),
        Section(
            "Figures 11, 12 and 14, and the band of 1.5 to 1.9 MPa",
            [band,
             f"That stands on the assumed pressures: {same} of the {len(found['placed'])} ranges of row 8 that miss "
             f"Figure 8 by less than 7 % put rows {' and '.join(map(str, found['rows']))} in the band.",
             f"Figure 11 (friction at {SHOWN / 1e6:g} MPa) is printed as a picture of curves alone: no number of it, "
             f"no slip and no load is given, so it cannot be reproduced. Tables 3 and 4 interpolated there have "
             f"{load:.1f} N of load and {friction:.1f} N of friction; Eqs. 9 and 10 at that load diverge within a "
             f"fraction of a millimetre. Figure 12's curve, where it runs between the eleven values of Table 4, and "
             f"Figure 13's fitted slip curve are not printed either, nor is Figure 14's theoretical curve."],
            figures=[
                ("figure-14", "Figure 14 from the numbers of Table 4: measured, corrected, and a constant coefficient; "
                 "the theoretical curve is not printed.", figures.draw_comparison(judged, table["printed"])),
                ("figure-12", "Figure 12 from the numbers of Table 4. The band that the paper tells designers to avoid "
                 "is shaded; middle: second differences of the force, rows in the band "
                 "coloured; right: errors of fits without the row.",
                 figures.draw_band(judged, [row - 1 for row in found["rows"]])),
                ("figure-11", f"All that the printed numbers say on Figure 11: at {SHOWN / 1e6:g} MPa the slip part of "
                 f"Eq. 11 at the interpolated load, {load:.1f} N, falls without limit; Table 4 has {friction:.1f} N.",
                 figures.draw_stroke(load, friction)),
            ]),
    ]  # fmt: skip
    plain, curve = found["tests"]
    numbers = {
        "band": {"sentence": band, "rows": found["rows"], "second_differences": [float(b) for b in found["bends"]],
                 "constant": dc.asdict(plain), "polynomial": dc.asdict(curve)},
        "scale_of_stated_error": at, "figure_11": {"load": load, "friction": friction},
    }
    return sections, numbers
