"""Figures of the paper's friction: the range of Eq. 10, Table 4's errors, Figures 11, 12 and 14 as far as printed."""

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np

from ..contact.friction import CHANGES_SIGN_AT, DIVERGES_ABOVE, slip_coefficients
from ..figures.style import AFTER, BEFORE, FLOOR, GREY, INK, KIN, PLACE, dress, new_figure, styled
from .band import BAND, measure_bends
from .friction import RELEASED, SCALED, FrictionJudgement
from .slipping import CORRECTED, err_scaled, find_rest, growth_rate, hysteresis_share, slip_term


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


@styled
def draw_friction_models(judged: FrictionJudgement):
    """Friction over load with the models side by side, and their errors with each record left out."""
    figure = new_figure(5.0)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(1.5, 1))
    x, y = judged.loads, judged.peaks
    shown = {"printed column as it stands": (GREY, "--^"), "constant coefficient": (AFTER, "-s"),
             judged.polynomial.label: (KIN, "-D"), RELEASED: (BEFORE, "-v"),
             SCALED: (BEFORE, ":x")}
    rows = {row.label: row for row in judged.rows}
    for label, (colour, style) in shown.items():
        if label in rows:
            note = "" if rows[label].physical else " (not physical)"
            upper.plot(x, rows[label].fitted / x, style, color=colour, lw=1.4, ms=4, label=label + note)
            lower.plot(x, 100 * (rows[label].held / y - 1), style, color=colour, lw=1.0, ms=4)
    upper.plot(x, y / x, "o", color=INK, ms=6, label="measured", zorder=4)
    share = 200 * float(np.mean(judged.noise.share))
    lower.axhspan(-share, share, color=FLOOR, alpha=0.18, lw=0)
    lower.axhline(0, color=FLOOR, lw=0.8)
    lower.set_ylim(-12, 12)
    upper.set_ylim(0.13, 0.29)
    dress(upper)
    dress(lower, "")
    upper.set_ylabel("friction over load")
    lower.set_ylabel("left out, deviation [%]")
    lower.set_xlabel("normal load [N]: Table 3 at the same index, assumed")
    upper.legend(loc="upper left", ncols=2, fontsize=8.5)
    return figure
