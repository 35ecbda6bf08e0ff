"""Table 4, Figures 11, 12 and 14 and the band of pressures to avoid, as sections of the page."""

import dataclasses as dc
import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Any, cast

import jax.numpy as jnp
import numpy as np

from ..contact.friction import CHANGES_SIGN_AT, DIVERGES_ABOVE, slip_coefficients
from ..figures.style import AFTER, BEFORE, FLOOR, GREY, INK, KIN, PLACE, dress, new_figure, styled
from .contradictions import (
    CORRECTED,
    RANGES,
    UNCORRECTED,
    err_scaled,
    find_rest,
    growth_rate,
    hysteresis_share,
    slip_term,
)
from .friction import RELEASED, SCALED, FrictionJudgement, describe_best
from .peak_page import draw_differences, draw_ladder, draw_values
from .rows import PeakRow, sign
from .tables import read_errors


BAND = (1.5e6, 1.9e6)  # Pa, section 4: "obviously nonlinear", to be avoided


@dc.dataclass(frozen=True)
class BandTest:
    """One model's left-out errors inside the band against those outside.

    Attributes:
        label: of the model.
        inside, outside: mean of |left-out error| [-].
        p_value: share of all ways to call as many rows the band that have a mean at least as large.
        p_adjacent: the same among runs of neighbouring rows, which is all that a band of pressures can be.
    """

    label: str
    inside: float
    outside: float
    p_value: float
    p_adjacent: float


def find_band(pressures: np.ndarray, band: tuple[float, float] = BAND) -> np.ndarray:
    """Numbers of the rows whose pressure [Pa] lies in the band, ends included, shape (inside,)."""
    return np.flatnonzero((pressures >= band[0] - 1.0) & (pressures <= band[1] + 1.0))


def compare_band(row: PeakRow, peaks: np.ndarray, inside: Sequence[int] | np.ndarray) -> BandTest:
    """Exact permutation test: are the left-out errors of a model larger in the band than elsewhere?

    Args:
        row: the model.
        peaks: measured, shape (rows,) [N].
        inside: numbers of the rows in the band; neighbours.
    """
    error, count = np.abs(row.held / peaks - 1.0), len(inside)
    mean = float(error[list(inside)].mean())
    every = [error[list(some)].mean() for some in itertools.combinations(range(len(error)), count)]
    runs = [error[k: k + count].mean() for k in range(len(error) - count + 1)]
    outside = float(np.delete(error, list(inside)).mean())
    return BandTest(row.label, mean, outside, float(np.mean(np.array(every) >= mean - 1e-12)),
                    float(np.mean(np.array(runs) >= mean - 1e-12)))


def measure_bends(peaks: np.ndarray) -> np.ndarray:
    """Second differences of forces at equal steps, shape (rows - 2,) [N]: 0 where they lie on a line."""
    return np.diff(peaks, 2)


def place_band(rows: int, misses: Mapping[str, float], most: float = 7.0) -> list[tuple[int, ...]]:
    """Rows in the band under every range of pressures that misses Figure 8 by less than `most` per cent.

    Args:
        rows: how many, at equal steps.
        misses: of each range of `RANGES`, by name [%].
        most: the largest miss that is let through [%].
    """
    return [tuple(int(k) for k in find_band(1e6 * np.linspace(low, high, rows))) for low, high in RANGES
            if misses[f"{low:g}-{high:g}"] < most]


INSIDE = ((10.0, "#9ecae1"), (20.0, "#4292c6"), (29.0, "#08519c"))  # N, loads within Eq. 10's range
BEYOND = ((40.0, "#fdae6b"), (50.0, "#f16913"), (60.0, "#d94801"), (70.0, "#7f2704"))  # loads of Table 3


@styled
def draw_rest(loads: np.ndarray):
    """Slip coefficient without any slip, a(1 - e), over load with the printed e and with e = 1; `loads` of Table 3."""
    figure = new_figure(3.2, 7.5)
    axes = dress(figure.subplots())
    load = np.linspace(0.0, 75.0, 301)
    _shade_loads(axes, loads)
    axes.plot(load, slip_term(np.zeros_like(load), load, True), color=BEFORE, lw=1.8, label="e(Fₙ) as printed")
    axes.axhline(0, color=AFTER, lw=1.8, label="e = 1")
    for at, shift in ((find_rest(), -4), (CHANGES_SIGN_AT, 4)):
        axes.plot([at], [0], "o", color=BEFORE, ms=5)
        axes.annotate(f"{at:.1f} N", (at, 0), (shift, 6), textcoords="offset points",
                      ha="right" if shift < 0 else "left", color=BEFORE)
    still = float(slip_term(np.array(0.0), np.array(0.0), True))
    axes.annotate(f"{still:.2f}".replace("-", "−"), (0, still), (6, -2), textcoords="offset points", color=BEFORE)
    axes.set_xlim(0, 75)
    axes.set_ylim(-1.4, 0.45)
    axes.set_xlabel("normal load [N]")
    axes.set_ylabel("friction over load\nwithout slip")
    axes.legend(loc="lower left", bbox_to_anchor=(0.2, 0.02))
    return figure


@styled
def draw_range(loads: np.ndarray):
    """The slip term over slip at several loads, with the printed e and with e = 1, and where Eq. 10 holds."""
    figure = new_figure(6.4)
    upper, lower = figure.subplots(2, 2, height_ratios=(1.25, 1))
    slip = np.linspace(0.0, 8.0, 401)
    for axes, printed, title in ((upper[0], True, "e(Fₙ) as printed"), (upper[1], False, "e = 1")):
        for load, colour in (*INSIDE, *BEYOND):
            value = slip_term(1e-3 * slip, np.array(load), printed)
            axes.plot(slip, np.where(np.abs(value) < 4, value, np.nan), "-" if load < DIVERGES_ABOVE else "--",
                      color=colour, lw=1.6, label=f"{load:.0f} N")
        axes.axhline(0, color=FLOOR, lw=0.8)
        axes.set_ylim(-1.5, 1.0)
        axes.set_xlim(0, 8)
        axes.set_title(title)
        axes.set_xlabel("slip [mm]")
        dress(axes)
    upper[0].set_ylabel("slip term of Eqs. 9 and 10")
    handles, labels = upper[0].get_legend_handles_labels()
    legend = figure.legend(handles, labels, loc="outside upper left", ncols=7, columnspacing=1.6,
                           title="normal load; dashed: beyond the range of Eq. 10", alignment="left")
    legend.get_title().set_fontsize(9.5)
    load = np.linspace(0.0, 75.0, 301)
    a = np.asarray(slip_coefficients(jnp.asarray(load)).a)
    for axes, value, text, at in ((lower[0], growth_rate(load), "b + |d| [1/mm]: above 0 the curve diverges",
                                   DIVERGES_ABOVE), (lower[1], a, "a: below 0 friction pushes", CHANGES_SIGN_AT)):
        _shade_loads(axes, loads)
        good = load <= at
        axes.plot(load[good], value[good], color=AFTER, lw=1.8)
        axes.plot(load[~good], value[~good], color=BEFORE, lw=1.8, ls="--")
        axes.axhline(0, color=FLOOR, lw=0.8)
        axes.plot([at], [0], "o", color=BEFORE, ms=5)
        axes.annotate(f"{at:.2f} N" if at < 40 else f"{at:.1f} N", (at, 0), (0, 8) if at < 40 else (5, 5),
                      textcoords="offset points", ha="right" if at < 40 else "left", color=BEFORE)
        axes.set_title(text)
        axes.set_xlim(0, 75)
        axes.set_xlabel("normal load [N]")
        dress(axes)
    lower[0].set_ylim(-0.6, 4.6)
    return figure


def _shade_loads(axes, loads: np.ndarray):
    axes.axvspan(loads.min(), loads.max(), color=PLACE, lw=0)
    axes.annotate("loads of Table 3", (loads.mean(), 1.0), (0, -12), xycoords=("data", "axes fraction"),
                  textcoords="offset points", ha="center", color=GREY, fontsize=8.5)


@styled
def draw_friction_errors(measured: np.ndarray, printed: np.ndarray, printed_error: np.ndarray):
    """Table 4's errors as printed and from its own numbers; arrays of shape (11,) [N, N, %]."""
    figure = new_figure(3.0)
    axes = dress(figure.subplots())
    row = np.arange(1, len(measured) + 1)
    gap = 100 * np.abs(measured - printed) / measured
    axes.bar(row - 0.2, printed_error, 0.36, color=KIN, label="as printed")
    axes.bar(row + 0.2, gap, 0.36, color=GREY, label="from the table's own numbers")
    for k in (3, 10):
        axes.bar(row[k] + 0.2, gap[k], 0.36, color=BEFORE)
        axes.annotate(f"{printed_error[k]:.1f} printed,\n{gap[k]:.1f} recomputed", (row[k], max(gap[k],
                      printed_error[k])), (0, 5), textcoords="offset points", ha="center", color=BEFORE, fontsize=8.5)
    axes.axhline(CORRECTED, color=INK, lw=0.8, ls=":")
    axes.annotate(f"stated limit, {CORRECTED} %", (0.5, CORRECTED), (0, 3), textcoords="offset points", fontsize=8.5)
    axes.set_xticks(row)
    axes.set_xlim(0.4, len(row) + 0.8)
    axes.set_ylim(0, 8.8)
    axes.set_xlabel("row of Table 4")
    axes.set_ylabel("error [%]")
    axes.legend(loc="upper right", ncols=2)
    return figure


@styled
def draw_comparison(judged: FrictionJudgement, printed: np.ndarray):
    """Figure 14 from the printed numbers: measured and corrected friction, with a constant coefficient beside them."""
    figure = new_figure(4.4)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(1.6, 1))
    x, y = judged.pressures / 1e6, judged.peaks
    for values, colour, style, label in (
            (printed, BEFORE, "-^", "corrected value, Eq. 11, as printed"),
            (judged.constant.fitted, AFTER, "-s", "one number: constant coefficient times the measured load")):
        upper.plot(x, values, style, color=colour, lw=1.4, ms=4, label=label)
        lower.plot(x, 100 * (values / y - 1), style, color=colour, lw=1.2, ms=4)
    upper.plot(x, y, "o", color=INK, ms=6, label="measured", zorder=4)
    upper.annotate("the uncorrected theory (Eq. 8, stated error 22.6 %)\nis drawn in the paper, but no number is "
                   "printed", (0.985, 0.04), xycoords="axes fraction", ha="right", color=GREY, fontsize=8.5)
    lower.axhline(0, color=FLOOR, lw=0.8)
    lower.set_ylim(-9, 9)
    dress(upper)
    dress(lower)
    upper.set_ylabel("friction force [N]")
    lower.set_ylabel("deviation [%]")
    lower.set_xlabel("pressure [MPa], assumed")
    upper.legend(loc="upper left")
    return figure


@styled
def draw_band(judged: FrictionJudgement, inside: Sequence[int]):
    """Figure 12 from the printed numbers: friction over pressure, where it bends, and errors in the band."""
    figure = new_figure(3.6)
    left, middle, right = figure.subplots(1, 3, width_ratios=(1.1, 1, 1.1))
    x, y = judged.pressures / 1e6, judged.peaks
    for axes in (left, middle, right):
        axes.axvspan(BAND[0] / 1e6, BAND[1] / 1e6, color=PLACE, lw=0)
        axes.set_xlabel("pressure [MPa], assumed")
        axes.set_xlim(-0.12, 2.62)
        dress(axes)
    left.plot(x, y, "-o", color=INK, ms=5, lw=1.2)
    left.set_ylabel("friction force, measured [N]")
    left.annotate("band to avoid,\nsays the paper", (BAND[0] / 1e6, y.max()), (-5, -8), textcoords="offset points",
                  ha="right", color=GREY, fontsize=8.5)
    bends = measure_bends(y)
    rows = set(inside)
    middle.bar(x[1:-1], bends, 0.16, color=[BEFORE if k + 1 in rows else GREY for k in range(len(bends))])
    middle.axhline(0, color=FLOOR, lw=0.8)
    middle.set_ylabel("bend: second difference [N]")
    for row, colour, style in ((judged.constant, AFTER, "-s"), (judged.polynomial, GREY, "-D")):
        right.plot(x, 100 * (row.held / y - 1), style, color=colour, lw=1.2, ms=4, label=row.label)
    right.axhline(0, color=FLOOR, lw=0.8)
    right.set_ylim(-12, 9)
    right.set_ylabel("left out, deviation [%]")
    right.legend(loc="lower left", fontsize=8.5)
    return figure


@styled
def draw_stroke(load: float, friction: float):
    """Figure 11's pressure, 2.05 MPa: what the printed equations give over slip at its load, beside Table 4.

    Args:
        load, friction: of Tables 3 and 4, interpolated at that pressure [N].
    """
    figure = new_figure(3.3, 8.5)
    axes = dress(figure.subplots())
    slip = np.linspace(0.0, 0.8, 300)
    level = np.full_like(slip, friction)
    axes.plot(slip, level, color=INK, lw=1.4, ls=":", label=f"Table 4, interpolated: {friction:.1f} N")
    for printed, colour, label in ((True, BEFORE, "Eqs. 9 and 10 with the printed e"),
                                   (False, AFTER, "Eqs. 9 and 10 with e = 1")):
        force = load * slip_term(1e-3 * slip, np.array(load), printed)
        axes.plot(slip, np.where(force > -120, force, np.nan), color=colour, lw=1.8, label=label)
    axes.axhline(0, color=FLOOR, lw=0.8)
    axes.set_ylim(-100, 75)
    axes.set_xlim(0, 0.8)
    axes.set_xlabel("slip [mm]")
    axes.set_ylabel(f"slip part of the friction\nforce at {load:.1f} N [N]")
    axes.legend(loc="upper right")
    return figure


@styled
def draw_coefficient(judged: FrictionJudgement):
    """Friction over load against pressure with Eq. 8 at several tan(delta), and how each of them fits."""
    figure = new_figure(3.6)
    left, right = figure.subplots(1, 2, width_ratios=(1.35, 1))
    x, ratio = judged.pressures, judged.peaks / judged.loads
    fine = x.max() * np.linspace(0.0, 1.0, 80) ** 2

    def fit(tangent, at):
        rest = tangent * hysteresis_share(x)
        weight = 1.0 / ratio
        base = max(float(np.sum(weight * (1.0 - rest * weight)) / np.sum(weight**2)), 0.0)
        return base + tangent * hysteresis_share(at)

    for tangent, colour in ((0.0, AFTER), (0.1, KIN), (0.2, "#fdae6b"), (0.45, BEFORE)):
        left.plot(fine / 1e6, fit(tangent, fine), color=colour, lw=1.6,
                  label=f"{tangent:g}" + (": a constant" if tangent == 0 else ""))
    left.plot(x / 1e6, ratio, "o", color=INK, ms=6, zorder=4)
    left.set_ylim(0.13, 0.27)
    left.set_xlabel("pressure [MPa], assumed")
    left.set_ylabel("friction over load (assumed pairs)")
    left.legend(loc="lower right", title="Eq. 8, K fitted, tan δ", alignment="left", ncols=2)
    tangents = np.linspace(-0.15, 0.4, 111)
    worst = [100 * np.sqrt(np.mean((fit(t, x) / ratio - 1.0) ** 2)) for t in tangents]
    right.axvspan(tangents[0], 0, color=PLACE, lw=0)
    right.annotate("negative:\nnot physical", (-0.145, 11.6), color=GREY, fontsize=8.5, va="top")
    right.plot(tangents, worst, color=INK, lw=1.6)
    right.plot([0], [np.interp(0, tangents, worst)], "o", color=AFTER)
    right.set_xlim(-0.15, 0.4)
    right.set_ylim(0, 12)
    right.set_xlabel("tan δ, kept there")
    right.set_ylabel("rms error with K fitted [%]")
    dress(left)
    dress(right)
    return figure


@styled
def draw_scales(judged: FrictionJudgement, stated: float, at: float):
    """Largest error of Eq. 8 times one fitted scale over the constant that the paper does not print.

    Args:
        judged: of Table 4.
        stated: error that the paper states [%].
        at: K sigma_0/p_r at which it would come out.
    """
    figure = new_figure(3.0, 7.5)
    axes = dress(figure.subplots(), "both")
    adhesion = np.geomspace(0.02, 50.0, 120)
    worst = [100 * err_scaled(judged.loads, judged.pressures, judged.peaks, one) for one in adhesion]
    axes.semilogx(adhesion, worst, color=AFTER, lw=1.8)
    axes.axhline(stated, color=BEFORE, lw=1.0, ls="--")
    axes.annotate(f"stated error of Eq. 8, {stated:g} %", (50, stated), (-4, 4), textcoords="offset points",
                  ha="right", color=BEFORE)
    axes.plot([at], [stated], "o", color=BEFORE)
    axes.axhline(CORRECTED, color=GREY, lw=1.0, ls=":")
    axes.annotate(f"stated error of the corrected law, {CORRECTED} %", (0.02, CORRECTED), (4, 4),
                  textcoords="offset points", color=GREY)
    axes.xaxis.set_major_formatter("{x:g}")
    axes.set_ylim(0, 105)
    axes.set_xlim(0.02, 50)
    axes.set_xlabel("K σ₀/pᵣ of Eq. 8, not printed")
    axes.set_ylabel("largest error with\none scale fitted [%]")
    return figure


def draw_friction_models(judged: FrictionJudgement):
    """Friction over load with the models side by side, and their errors with each record left out."""
    style = {"printed column as it stands": (GREY, "--^"), "constant coefficient": (AFTER, "-s"),
             judged.polynomial.label: (KIN, "-D"), RELEASED: (BEFORE, "-v"), SCALED: (BEFORE, ":x")}
    rows = {row.label: row for row in judged.rows}
    return draw_values(judged, shown=[(rows[label], *look) for label, look in style.items() if label in rows],
                       over_load=True)


SHOWN = 2.05e6  # Pa, Figure 11


def read_friction(judged: FrictionJudgement) -> dict[str, np.ndarray]:
    """Table 4 with the loads and pressures assumed for it: `load`, `pressure`, `measured`, `printed`, `printed_error`.

    Arrays of shape (11,) [N, Pa, N, N, %]; the loads are Table 3's measured forces at the same index.
    """
    printed = next(row for row in judged.rows if row.kind == "printed")
    return {"load": judged.loads, "pressure": judged.pressures, "measured": judged.peaks, "printed": printed.fitted,
            "printed_error": read_errors("table-4")}


def draw_friction_points(table: Mapping[str, np.ndarray]) -> dict[int, tuple[str, Any]]:
    """Figures of rows 5, 6 and 13: by row, the file's name and the figure."""
    return {5: ("row-05-rest", draw_rest(table["load"])),
            6: ("row-06-range", draw_range(table["load"])),
            13: ("row-13-errors", draw_friction_errors(table["measured"], table["printed"],
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
    against = draw_differences(
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
                 draw_friction_models(judged)),
                ("table-4-ladder", "Every law on Table 4, best first. Hatched: an estimate outside its physical range.",
                 draw_ladder(judged)),
                ("table-4-differences", "Paired differences of left-out errors against the constant coefficient, ± two "
                 f"standard errors. Grey: eleven numbers cannot tell the two apart. Off the scale: {SCALED}, "
                 f"{100 * far.difference:.1f} ± {100 * far.standard_error:.1f} points behind.", against),
                ("table-4-pressure", "Friction over load against pressure: Eq. 8 can only rise (left), and fits best "
                 f"with tan δ below 0 (right: {sign(released.estimates['loss_factor']['estimate'], 3)} ± "
                 f"{released.estimates['loss_factor']['sd']:.3f}), where it is not physical.",
                 draw_coefficient(judged)),
                ("table-4-scale", "Largest error of Eq. 8 with one scale fitted to Table 4, over the constant that is "
                 f"not printed. The stated {UNCORRECTED:g} % comes out at {at:.2f}.",
                 draw_scales(judged, UNCORRECTED, at)),
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
                 "the theoretical curve is not printed.", draw_comparison(judged, table["printed"])),
                ("figure-12", "Figure 12 from the numbers of Table 4. The band that the paper tells designers to avoid "
                 "is shaded; middle: second differences of the force, rows in the band "
                 "coloured; right: errors of fits without the row.",
                 draw_band(judged, [row - 1 for row in found["rows"]])),
                ("figure-11", f"All that the printed numbers say on Figure 11: at {SHOWN / 1e6:g} MPa the slip part of "
                 f"Eq. 11 at the interpolated load, {load:.1f} N, falls without limit; Table 4 has {friction:.1f} N.",
                 draw_stroke(load, friction)),
            ]),
    ]  # fmt: skip
    plain, curve = found["tests"]
    numbers = {
        "band": {"sentence": band, "rows": found["rows"], "second_differences": [float(b) for b in found["bends"]],
                 "constant": dc.asdict(plain), "polynomial": dc.asdict(curve)},
        "scale_of_stated_error": at, "figure_11": {"load": load, "friction": friction},
    }
    return sections, numbers
