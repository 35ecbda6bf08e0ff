"""Table 4, Figures 11, 12 and 14 and the band of pressures to avoid: friction judged by the toolkit's verbs."""

import dataclasses as dc
import itertools
import math
from collections.abc import Mapping
from typing import Any, cast

import jax.numpy as jnp
import numpy as np

from .._sentences import say
from ..contact.friction import CHANGES_SIGN_AT, DIVERGES_ABOVE, slip_coefficients
from ..contact.sliding import RubberFriction
from ..figures.palette import AFTER, BEFORE, FLOOR, GREY, INK, KIN, PLACE
from ..figures.style import dress, new_axes, new_figure, point_at, styled
from ..inference.estimation import fit
from .contradictions import CORRECTED, RANGES, UNCORRECTED, err_scaled, find_rest, hysteresis_share, slip_term
from .rivals import Judged, Row, compare_rows, draw_differences, draw_ladder, draw_models, fit_columns, judge_table
from .section import read_errors, write_section


BAND = (1.5e6, 1.9e6)  # Pa, section 4: "obviously nonlinear", to be avoided
CONSTANT = "model coulomb"  # label of the row of a constant coefficient
SCALED, RELEASED = "Eq. 8 times one scale, K as the toolkit has it", "Eq. 8, weights of either sign"


def judge_friction() -> Judged:
    """Table 4 as `discover` and `compare` judge it, and Eq. 8 with weights that physics does not allow beside it."""
    judged = judge_table("table-4", "normal_load", ("paper", "coulomb"))
    loads, share, rubber = judged.x, hysteresis_share(read_pressures(judged)), RubberFriction()
    ratio = float(rubber.adhesion_constant * rubber.tensile_strength / rubber.real_contact_pressure)
    tangent, error = release_tangent(judged)
    readings = (
        fit_columns(SCALED, "reading", (loads * (np.pi / 4 * ratio + share))[:, None], judged.values),
        fit_columns(RELEASED, "reading", np.column_stack([loads, loads * share]), judged.values,
                    f"tan δ = {tangent:.3f} ± {error:.3f}, which has to be above 0"))
    return dc.replace(judged, rows=(*judged.rows, *readings))


def release_tangent(judged: Judged) -> tuple[float, float]:
    """tan(delta) of Eq. 8 with both its weights free to be negative, and its standard error [-]."""
    ratio = judged.values / judged.x
    slope, covariance = np.polyfit(hysteresis_share(read_pressures(judged)), ratio, 1, w=1.0 / ratio, cov=True)
    return float(slope[0]), float(np.sqrt(covariance[0, 0]))


def find_ratio(judged: Judged) -> tuple[float, float]:
    """Mean of friction over load and its standard deviation between records [-]."""
    ratio = judged.values / judged.x
    return float(np.mean(ratio)), float(np.std(ratio, ddof=1))


def find_band(pressures: np.ndarray) -> np.ndarray:
    """Numbers of the rows whose pressure [Pa] lies in the band, ends included, shape (inside,)."""
    return np.flatnonzero((pressures >= BAND[0] - 1.0) & (pressures <= BAND[1] + 1.0))


def compare_band(row: Row, inside: np.ndarray) -> dict[str, Any]:
    """Exact permutation test: are the left-out errors of a model larger in the band than elsewhere?

    Args:
        row: the model.
        inside: numbers of the rows in the band; neighbours.

    Returns:
        `label` of the model; mean left-out error `inside` the band and `outside`, over the RMS of the values [-];
        `p_value`, the share of all ways to call as many rows the band that have a mean at least as large; `p_adjacent`,
        the same among runs of neighbouring rows, which is all that a band of pressures can be.
    """
    error, count = row.out, len(inside)
    mean = float(error[inside].mean())
    every = [error[list(some)].mean() for some in itertools.combinations(range(len(error)), count)]
    runs = [error[k: k + count].mean() for k in range(len(error) - count + 1)]
    return {"label": row.label, "inside": mean, "outside": float(np.delete(error, inside).mean()),
            "p_value": float(np.mean(np.array(every) >= mean - 1e-12)),
            "p_adjacent": float(np.mean(np.array(runs) >= mean - 1e-12))}


INSIDE = ((10.0, "#9ecae1"), (20.0, "#4292c6"), (29.0, "#08519c"))  # N, loads within Eq. 10's range
BEYOND = ((40.0, "#fdae6b"), (50.0, "#f16913"), (60.0, "#d94801"), (70.0, "#7f2704"))  # loads of Table 3


@styled
def draw_rest(loads: np.ndarray):
    """Slip coefficient without any slip, a(1 - e), over load with the printed e and with e = 1; `loads` of Table 3."""
    figure, axes = new_axes(3.2, 7.5)
    load = np.linspace(0.0, 75.0, 301)
    _shade_loads(axes, loads)
    axes.plot(load, slip_term(np.zeros_like(load), load, True), color=BEFORE, lw=1.8, label="e(Fₙ) as printed")
    axes.axhline(0, color=AFTER, lw=1.8, label="e = 1")
    for at, shift in ((find_rest(), -4), (CHANGES_SIGN_AT, 4)):
        point_at(axes, f"{at:.1f} N", (at, 0), (shift, 6), 5, ha="right" if shift < 0 else "left", color=BEFORE)
    still = float(slip_term(0.0, 0.0, True))
    point_at(axes, f"{still:.2f}".replace("-", "−"), (0, still), (6, -2), color=BEFORE)
    axes.set(xlim=(0, 75), ylim=(-1.4, 0.45), xlabel="normal load [N]", ylabel="friction over load\nwithout slip")
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
            value = slip_term(1e-3 * slip, load, printed)
            axes.plot(slip, np.where(np.abs(value) < 4, value, np.nan), "-" if load < DIVERGES_ABOVE else "--",
                      color=colour, lw=1.6, label=f"{load:.0f} N")
        axes.axhline(0, color=FLOOR, lw=0.8)
        dress(axes).set(ylim=(-1.5, 1.0), xlim=(0, 8), title=title, xlabel="slip [mm]")
    upper[0].set_ylabel("slip term of Eqs. 9 and 10")
    handles, labels = upper[0].get_legend_handles_labels()
    legend = figure.legend(handles, labels, loc="outside upper left", ncols=7, columnspacing=1.6,
                           title="normal load; dashed: beyond the range of Eq. 10", alignment="left")
    legend.get_title().set_fontsize(9.5)
    load = np.linspace(0.0, 75.0, 301)
    a, b, _, d, _ = map(np.asarray, slip_coefficients(jnp.asarray(load)))
    for axes, value, text, at in ((lower[0], b + abs(d), "b + |d| [1/mm]: above 0 the curve diverges",
                                   DIVERGES_ABOVE), (lower[1], a, "a: below 0 friction pushes", CHANGES_SIGN_AT)):
        _shade_loads(axes, loads)
        good = load <= at
        axes.plot(load[good], value[good], color=AFTER, lw=1.8)
        axes.plot(load[~good], value[~good], color=BEFORE, lw=1.8, ls="--")
        axes.axhline(0, color=FLOOR, lw=0.8)
        point_at(axes, f"{at:.2f} N" if at < 40 else f"{at:.1f} N", (at, 0), (0, 8) if at < 40 else (5, 5), 5,
                 ha="right" if at < 40 else "left", color=BEFORE)
        dress(axes).set(title=text, xlim=(0, 75), xlabel="normal load [N]")
    lower[0].set_ylim(-0.6, 4.6)
    return figure


def _shade_loads(axes, loads: np.ndarray):
    axes.axvspan(loads.min(), loads.max(), color=PLACE, lw=0)
    axes.annotate("loads of Table 3", (loads.mean(), 1.0), (0, -12), xycoords=("data", "axes fraction"),
                  textcoords="offset points", ha="center", color=GREY, fontsize=8.5)


@styled
def draw_friction_errors(measured: np.ndarray, printed: np.ndarray, printed_error: np.ndarray):
    """Table 4's errors as printed and from its own numbers; arrays of shape (11,) [N, N, %]."""
    figure, axes = new_axes(3.0)
    row = np.arange(1, len(measured) + 1)
    gap = 100 * np.abs(measured - printed) / measured
    axes.bar(row - 0.2, printed_error, 0.36, color=KIN, label="as printed")
    axes.bar(row + 0.2, gap, 0.36, color=GREY, label="from the table's own numbers")
    for k in (3, 10):
        axes.bar(row[k] + 0.2, gap[k], 0.36, color=BEFORE)
        top = max(gap[k], printed_error[k])
        point_at(axes, f"{printed_error[k]:.1f} printed,\n{gap[k]:.1f} recomputed", (row[k], top), (0, 5), ha="center",
                 color=BEFORE, fontsize=8.5)
    axes.axhline(CORRECTED, color=INK, lw=0.8, ls=":")
    point_at(axes, f"stated limit, {CORRECTED} %", (0.5, CORRECTED), (0, 3), fontsize=8.5)
    axes.set(xticks=row, xlim=(0.4, len(row) + 0.8), ylim=(0, 8.8), xlabel="row of Table 4", ylabel="error [%]")
    axes.legend(loc="upper right", ncols=2)
    return figure


@styled
def draw_comparison(judged: Judged, printed: np.ndarray):
    """Figure 14 from the printed numbers: measured and corrected friction, with a constant coefficient beside them."""
    figure = new_figure(4.4)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(1.6, 1))
    x, y = read_pressures(judged) / 1e6, judged.values
    for values, colour, style, label in (
            (printed, BEFORE, "-^", "corrected value, Eq. 11, as printed"),
            (judged.find(CONSTANT).fitted, AFTER, "-s", "one number: constant coefficient times the measured load")):
        upper.plot(x, values, style, color=colour, lw=1.4, ms=4, label=label)
        lower.plot(x, 100 * (values / y - 1), style, color=colour, lw=1.2, ms=4)
    upper.plot(x, y, "o", color=INK, ms=6, label="measured", zorder=4)
    upper.annotate("the uncorrected theory (Eq. 8, stated error 22.6 %)\nis drawn in the paper, but no number is "
                   "printed", (0.985, 0.04), xycoords="axes fraction", ha="right", color=GREY, fontsize=8.5)
    lower.axhline(0, color=FLOOR, lw=0.8)
    dress(upper).set_ylabel("friction force [N]")
    dress(lower).set(ylim=(-9, 9), ylabel="deviation [%]", xlabel="pressure [MPa], assumed")
    upper.legend(loc="upper left")
    return figure


@styled
def draw_band(judged: Judged, inside: np.ndarray):
    """Figure 12 from the printed numbers: friction over pressure, where it bends, and errors in the band."""
    figure, left, middle, right = new_axes(3.6, columns=3, xlabel="pressure [MPa], assumed", xlim=(-0.12, 2.62))
    x, y = read_pressures(judged) / 1e6, judged.values
    for axes in (left, middle, right):
        axes.axvspan(BAND[0] / 1e6, BAND[1] / 1e6, color=PLACE, lw=0)
    left.plot(x, y, "-o", color=INK, ms=5, lw=1.2)
    left.set_ylabel("friction force, measured [N]")
    point_at(left, "band to avoid,\nsays the paper", (BAND[0] / 1e6, y.max()), (-5, -8), ha="right", color=GREY,
             fontsize=8.5)
    middle.bar(x[1:-1], np.diff(y, 2), 0.16, color=[BEFORE if k in inside else GREY for k in range(1, len(y) - 1)])
    middle.axhline(0, color=FLOOR, lw=0.8)
    middle.set_ylabel("bend: second difference [N]")
    for row, colour, style in ((judged.find(CONSTANT), AFTER, "-s"), (judged.polynomial, GREY, "-D")):
        right.plot(x, 100 * row.out, style, color=colour, lw=1.2, ms=4, label=row.label)
    right.set(ylim=(0, 9), ylabel="left out, |error| over RMS [%]")
    right.legend(loc="upper right", fontsize=8.5)
    return figure


@styled
def draw_stroke(load: float, friction: float):
    """Figure 11's pressure, 2.05 MPa: the printed equations over slip at its load, beside Table 4's friction [N]."""
    figure, axes = new_axes(3.3, 8.5)
    slip = np.linspace(0.0, 0.8, 300)
    axes.plot(slip, np.full_like(slip, friction), color=INK, lw=1.4, ls=":",
              label=f"Table 4, interpolated: {friction:.1f} N")
    for printed, colour, label in ((True, BEFORE, "Eqs. 9 and 10 with the printed e"),
                                   (False, AFTER, "Eqs. 9 and 10 with e = 1")):
        force = load * slip_term(1e-3 * slip, load, printed)
        axes.plot(slip, np.where(force > -120, force, np.nan), color=colour, lw=1.8, label=label)
    axes.axhline(0, color=FLOOR, lw=0.8)
    axes.set(ylim=(-100, 75), xlim=(0, 0.8), xlabel="slip [mm]",
             ylabel=f"slip part of the friction\nforce at {load:.1f} N [N]")
    axes.legend(loc="upper right")
    return figure


@styled
def draw_coefficient(judged: Judged):
    """Friction over load against pressure with Eq. 8 at several tan(delta), and how each of them fits."""
    figure = new_figure(3.6)
    left, right = figure.subplots(1, 2, width_ratios=(1.35, 1))
    x, ratio = read_pressures(judged), judged.values / judged.x
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
    dress(left).set(ylim=(0.13, 0.27), xlabel="pressure [MPa], assumed", ylabel="friction over load (assumed pairs)")
    left.legend(loc="lower right", title="Eq. 8, K fitted, tan δ", alignment="left", ncols=2)
    tangents = np.linspace(-0.15, 0.4, 111)
    worst = [100 * np.sqrt(np.mean((fit(t, x) / ratio - 1.0) ** 2)) for t in tangents]
    right.axvspan(tangents[0], 0, color=PLACE, lw=0)
    right.annotate("negative:\nnot physical", (-0.145, 11.6), color=GREY, fontsize=8.5, va="top")
    right.plot(tangents, worst, color=INK, lw=1.6)
    right.plot([0], [np.interp(0, tangents, worst)], "o", color=AFTER)
    dress(right).set(xlim=(-0.15, 0.4), ylim=(0, 12), xlabel="tan δ, held", ylabel="RMS error with K fitted [%]")
    return figure


@styled
def draw_scales(judged: Judged, at: float):
    """Largest error of Eq. 8 times one fitted scale over K sigma_0/p_r; at `at` the stated error would come out."""
    figure, axes = new_axes(3.0, 7.5, grid="both")
    adhesion = np.geomspace(0.02, 50.0, 120)
    worst = [100 * err_scaled(judged.x, read_pressures(judged), judged.values, one) for one in adhesion]
    axes.semilogx(adhesion, worst, color=AFTER, lw=1.8)
    axes.axhline(UNCORRECTED, color=BEFORE, lw=1.0, ls="--")
    point_at(axes, f"stated error of Eq. 8, {UNCORRECTED:g} %", (50, UNCORRECTED), (-4, 4), ha="right", color=BEFORE)
    axes.plot([at], [UNCORRECTED], "o", color=BEFORE)
    axes.axhline(CORRECTED, color=GREY, lw=1.0, ls=":")
    point_at(axes, f"stated error of the corrected law, {CORRECTED} %", (0.02, CORRECTED), (4, 4), color=GREY)
    axes.xaxis.set_major_formatter("{x:g}")
    axes.set(ylim=(0, 105), xlim=(0.02, 50), xlabel="K σ₀/pᵣ of Eq. 8, not printed",
             ylabel="largest error with\none scale fitted [%]")
    return figure


SHOWN = 2.05e6  # Pa, the pressure of Figure 11


def read_friction(judged: Judged) -> dict[str, np.ndarray]:
    """Table 4 with the loads and pressures assumed for it: `load`, `pressure`, `measured`, `printed`, `printed_error`.

    Arrays of shape (11,) [N, Pa, N, N, %]; the loads are Table 3's measured forces at the same index.
    """
    assert judged.printed is not None
    return {"load": judged.x, "pressure": read_pressures(judged), "measured": judged.values,
            "printed": judged.printed, "printed_error": read_errors("table-4")}


def read_pressures(judged: Judged) -> np.ndarray:
    """Gas pressures that are assumed for Table 4, shape (11,) [Pa]."""
    return judged.campaign.records["internal_pressure"].to_numpy(dtype=float)


def find_scale(judged: Judged) -> float:
    """K sigma_0/p_r [-] at which Eq. 8 times one scale has the error at worst that the paper states for it."""
    from scipy.optimize import brentq

    def gap(logarithm):
        return 100 * err_scaled(judged.x, read_pressures(judged), judged.values, np.exp(logarithm)) - UNCORRECTED

    return math.exp(cast(float, brentq(gap, math.log(0.02), math.log(50.0))))


def _examine_band(judged: Judged, inside: np.ndarray) -> dict[str, Any]:
    """What the band of 1.5 to 1.9 MPa shows, as `paper.json` has it."""
    plain, curve = (compare_band(row, inside) for row in (judged.find(CONSTANT), judged.polynomial))
    bends = np.diff(judged.values, 2)
    largest = np.sort(np.argsort(-np.abs(bends))[:2])
    shown = [f"{bend:+.2f}".replace("-", "−") for bend in bends]
    sentence = say("paper.band", low=BAND[0] / 1e6, high=BAND[1] / 1e6, rows=len(inside),
                   others=len(judged.values) - len(inside), plain=plain, curve=curve,
                   places=[f"{read_pressures(judged)[k + 1] / 1e6:g}" for k in largest],
                   largest=[shown[k] for k in largest], inside=[shown[k - 1] for k in inside])
    return {"sentence": sentence, "rows": [int(k) + 1 for k in inside], "second_differences": bends.tolist(),
            "constant": plain, "polynomial": curve}


def write_friction(judged: Judged, table: Mapping[str, np.ndarray], misses: Mapping[str, float]):
    """The sections, and what `paper.json` says of them.

    Args:
        judged: from `judge_friction`.
        table: from `read_friction`.
        misses: of each assumed range of pressures against Figure 8, by name [%] (row 8).
    """
    at, inside = find_scale(judged), find_band(table["pressure"])
    load, friction = (float(np.interp(SHOWN, table["pressure"], table[name])) for name in ("load", "measured"))
    band, column, plain = _examine_band(judged, inside), judged.rows[0], judged.find(CONSTANT)
    # Ranges of pressures that miss Figure 8 by less than 7 %, with the rows that would lie in the band.
    placed = [find_band(1e6 * np.linspace(low, high, len(judged.values))) for low, high in RANGES
              if misses[f"{low:g}-{high:g}"] < 7.0]
    gaps = [compare_rows(row, plain) for row in judged.rows if row is not plain]
    far = next(gap for gap in gaps if gap.first == SCALED)
    against = draw_differences(
        [gap for gap in gaps if gap is not far],
        "mean |error| of the first minus that of the constant [percentage points]; > 0: the constant is better")
    mean, spread = find_ratio(judged)
    figures = {
        "table-4-models": draw_models(judged, [judged.reference.label, CONSTANT, judged.polynomial.label, RELEASED]),
        "table-4-ladder": draw_ladder(judged),
        "table-4-differences": against, "table-4-pressure": draw_coefficient(judged),
        "table-4-scale": draw_scales(judged, at), "figure-14": draw_comparison(judged, table["printed"]),
        "figure-12": draw_band(judged, inside), "figure-11": draw_stroke(load, friction),
    }  # fmt: skip
    worst = {row.label: float(np.max(np.abs(row.fitted / judged.values - 1.0))) for row in (column, plain)}
    scaled = float(np.max(np.abs(judged.find(SCALED).fitted / judged.values - 1.0)))
    told = fit(judged.campaign).cannot_tell_apart  # of K and tan(delta)
    sections = [
        write_section("paper.table_4", figures, [judged.tabulate(plain), judged.tabulate_effects()],
                      sentence=judged.found.sentence, gaps=gaps, plain=plain,
                      notes=[*told, *judged.found.notes], mean=mean, spread=spread, uncorrected=UNCORRECTED,
                      corrected=CORRECTED, at=at, scaled=scaled, constant=worst[CONSTANT], printed=worst[column.label],
                      scaled_name=SCALED, far=far, tangent=release_tangent(judged),
                      outside=int(np.sum(judged.x > DIVERGES_ABOVE)), diverges=DIVERGES_ABOVE),
        write_section("paper.figures_11_to_14", figures, band=band["sentence"],
                      same=sum(np.array_equal(inside, some) for some in placed), ranges=len(placed), rows=band["rows"],
                      shown=SHOWN / 1e6, load=load, friction=friction),
    ]
    return sections, {"band": band, "scale_of_stated_error": at, "figure_11": {"load": load, "friction": friction},
                      "friction_over_load": {"mean": mean, "deviation": spread}}
