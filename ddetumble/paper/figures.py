"""Figures of the contradictions: each takes numbers and returns a matplotlib figure."""

from collections.abc import Mapping

import numpy as np

from ..figures.style import AFTER, BEFORE, FLOOR, GREY, INK, KIN, PLACE, dress, new_figure, styled
from .contradictions import (
    RANGES,
    STATED_ERROR,
    STATED_TIME,
    Contradiction,
    elastic_force,
    pressure_ratio,
    printed_restitution,
    reading,
)


READINGS = {
    "ours": ("Eqs. 2 to 4, core once, b = πδ/4", AFTER, "-"),
    "printed": ("Eqs. 2 to 4 as printed, b = πδ/4", KIN, "--"),
    "quarter": ("b = δ/4 throughout", BEFORE, "--"),
    "area": ("Eq. 7: b = δ/4 in the area alone", BEFORE, "-"),
}  # fmt: skip


@styled
def draw_readings():
    """Elastic force against depression at 1 MPa under the four readings of Eqs. 2 to 7."""
    figure = new_figure(3.6)
    left, right = figure.subplots(1, 2)
    depth = np.linspace(0.0, 8e-3, 33)
    for name, (label, colour, line) in READINGS.items():
        force = elastic_force(reading(name), depth, 1e6)
        value = float(elastic_force(reading(name), np.array([5e-3]), 1e6)[0])
        for axes in (left, right):
            axes.plot(1e3 * depth, force, line, color=colour, lw=1.8, label=f"{label}: {value:.1f} N")
            axes.plot([5], [value], "o", color=colour, ms=5)
    for axes in (left, right):
        dress(axes, "both")
        axes.set_xlabel("depression [mm]")
        axes.axvline(5, color=FLOOR, lw=0.8, ls=":")
        axes.set_xlim(0, 8)
    left.set_ylim(0, None)
    left.set_ylabel("elastic force at 1 MPa [N]")
    right.set_ylim(0, 15)
    right.set_title("the same, enlarged")
    left.legend(loc="upper left", title="at 5 mm", alignment="left", fontsize=8.5)
    return figure


@styled
def draw_core():
    """Force with Eq. 2 as printed over the force with the core counted once, against depression."""
    figure = new_figure(3.0, 7.0)
    axes = dress(figure.subplots())
    depth = np.linspace(1e-4, 12e-3, 33)
    share = elastic_force(reading("printed"), depth, 1e6) / elastic_force(reading("ours"), depth, 1e6)
    axes.plot(1e3 * depth, 100 * (share - 1), color=BEFORE, lw=1.8)
    axes.axhline(0, color=FLOOR, lw=0.8)
    at = float(np.interp(5e-3, depth, 100 * (share - 1)))
    axes.plot([5], [at], "o", color=BEFORE)
    axes.annotate(f"−{abs(at):.1f} %", (5, at), (8, 4), textcoords="offset points", color=BEFORE)
    axes.set_xlabel("depression [mm]")
    axes.set_ylabel("force with the core twice,\ndeviation [%]")
    return figure


@styled
def draw_pressure():
    """P'/P0 against depression over diameter under three laws of the contact radius."""
    figure = new_figure(3.4, 7.5)
    axes = dress(figure.subplots())
    share = np.linspace(0.0, 0.2, 41)
    for law, label, colour, line in (
            ("quarter", "b = δ/4 (perimeter shrinks)", BEFORE, "-"), ("area", "constant membrane area", GREY, "--"),
            ("perimeter", "constant perimeter, b = πδ/4 (the paper's assumption)", AFTER, "-")):
        ratio = pressure_ratio(share, law)
        axes.plot(share, ratio, line, color=colour, lw=1.8, label=label)
        at = float(pressure_ratio(np.array([0.1]), law)[0])
        axes.plot([0.1], [at], "o", color=colour)
        axes.annotate(f"{at:.2f}", (0.1, at), (0, 7), textcoords="offset points", color=colour, ha="center")
    axes.axhline(1, color=FLOOR, lw=0.8)
    axes.set_xlabel("depression / diameter")
    axes.set_ylabel("P′ / P0")
    axes.set_ylim(0.85, 1.55)
    axes.legend(loc="upper left")
    return figure


@styled
def draw_restitution():
    """Restitution that Eq. 6 delivers against the one asked for."""
    figure = new_figure(3.6, 6.0)
    axes = dress(figure.subplots(), "both")
    asked = np.linspace(0.02, 1.0, 50)
    axes.plot(asked, asked, color=AFTER, lw=1.8, label="exact coefficient")
    axes.plot(asked, [printed_restitution(e) for e in asked], color=BEFORE, lw=1.8, label="Eq. 6")
    for e in (0.5, 0.8):
        given = printed_restitution(e)
        axes.plot([e], [given], "o", color=BEFORE)
        axes.annotate(f"{e} → {given:.3f}", (e, given), (-6, 7), textcoords="offset points", ha="right", color=BEFORE)
    axes.set_xlabel("restitution asked for")
    axes.set_ylabel("restitution delivered")
    axes.set_xlim(0, 1)
    axes.set_ylim(0, 1.02)
    axes.legend(loc="lower right")
    return figure


@styled
def draw_errors(measured: np.ndarray, printed: np.ndarray, printed_error: np.ndarray):
    """Table 3's errors as printed, recomputed, and relative to the measured value; arrays of shape (11,) [N, N, %]."""
    figure = new_figure(3.2)
    axes = dress(figure.subplots())
    row = np.arange(1, len(measured) + 1)
    gap = 100 * (printed - measured)
    axes.bar(row - 0.27, printed_error, 0.25, color=KIN, label="as printed")
    axes.bar(row, gap / printed, 0.25, color=GREY, label="relative to the theory, recomputed")
    axes.bar(row + 0.27, gap / measured, 0.25, color=BEFORE, label="relative to the measurement")
    axes.axhline(STATED_ERROR, color=INK, lw=0.8, ls=":")
    axes.annotate(f"stated limit, {STATED_ERROR} %", (0.5, STATED_ERROR), (0, 3), textcoords="offset points", color=INK,
                  fontsize=8.5)
    top = (gap / measured).max()
    axes.annotate(f"{top:.1f} %", (row[-1] + 0.27, top), (0, 3), textcoords="offset points", ha="center", color=BEFORE)
    axes.annotate(f"{printed_error[7]:.1f} printed,\n{gap[7] / printed[7]:.1f} recomputed", (8, printed_error[7]),
                  (0, 9), textcoords="offset points", ha="center", fontsize=8.5)
    axes.set_xticks(row)
    axes.set_xlim(0.4, len(row) + 0.7)
    axes.set_ylim(0, 9.6)
    axes.set_xlabel("row of Table 3")
    axes.set_ylabel("error [%]")
    axes.legend(loc="upper left", ncols=3)
    return figure


@styled
def draw_ranges(point: Contradiction, measured: np.ndarray, pressures: np.ndarray, peaks: np.ndarray):
    """Table 3 at candidate ranges of pressure against Figure 8's peaks, and how far each range misses them.

    Args:
        point: row 8, whose values hold the misses in per cent.
        measured: Table 3 [N].
        pressures, peaks: Figure 8 [MPa, N].
    """
    figure = new_figure(3.6)
    left, right = figure.subplots(1, 2, width_ratios=(1.25, 1))
    dress(left, "both")
    dress(right, "x")
    for span, colour, line in ((RANGES[0], AFTER, "-o"), (RANGES[4], KIN, "--o"), (RANGES[5], GREY, "-.o")):
        grid = np.linspace(*span, len(measured))
        left.plot(grid, measured, line, color=colour, ms=3.5, lw=1.3, label=f"{span[0]:g} to {span[1]:g} MPa")
    left.plot(pressures, peaks, "D", color=BEFORE, ms=7, label="Figure 8", zorder=4)
    left.set_xlabel("pressure [MPa]")
    left.set_ylabel("peak normal force [N]")
    left.legend(loc="upper left", title="Table 3 placed at", alignment="left")
    misses = sorted(point.values.items(), key=lambda item: -item[1])
    names = [name.replace("-", " to ") for name, _ in misses]
    values = [value for _, value in misses]
    right.barh(names, values, color=[AFTER if v == min(values) else "#c9d1d9" for v in values])
    for i, value in enumerate(values):
        right.annotate(f"{value:.1f} %", (value, i), (4, 0), textcoords="offset points", va="center", fontsize=8.5)
    right.set_xlim(0, 1.2 * max(values))
    right.set_xlabel("largest deviation from Figure 8 [%]")
    right.set_ylabel("range [MPa]")
    return figure


@styled
def draw_duration(times: np.ndarray, forces: np.ndarray, pressures: np.ndarray, peaks: np.ndarray, mass: float):
    """Simulated free impacts beside the stated impact time.

    Args:
        times: shape (times,) [s].
        forces: shape (records, times) [N].
        pressures: shape (records,) [MPa].
        peaks: of Figure 8, shape (records,) [N].
        mass: the effective mass that fits them [kg].
    """
    figure = new_figure(3.2)
    axes = dress(figure.subplots())
    axes.axvspan(0, 1e3 * STATED_TIME, color=PLACE, lw=0)
    axes.annotate(f"stated impact time, {1e3 * STATED_TIME:.0f} ms", (1e3 * STATED_TIME, 60), (-6, 0),
                  textcoords="offset points", ha="right")
    shades = ("#9ecae1", "#6baed6", "#3182bd", "#08519c")
    for force, pressure, peak, colour in zip(forces, pressures, peaks, shades, strict=True):
        axes.plot(1e3 * times, force, color=colour, lw=1.8, label=f"{pressure:g} MPa, {peak:.1f} N measured")
    axes.set_xlim(-5, 300)
    axes.set_ylim(0, 80)
    axes.set_xlabel("time after first touch [ms]")
    axes.set_ylabel("normal force [N]")
    axes.legend(loc="center", title=f"free impact of {mass:.2f} kg at 0.4 m/s", alignment="left")
    return figure


@styled
def draw_sign(times: np.ndarray, forces: Mapping[str, np.ndarray], depressions: Mapping[str, np.ndarray]):
    """Force over time and over depression with both signs of Eq. 5; arrays of shape (times,) [s, N, m]."""
    figure = new_figure(3.4)
    left, right = figure.subplots(1, 2)
    for name, colour in (("as printed", BEFORE), ("Hunt and Crossley", AFTER)):
        alive = depressions[name] > 0
        left.plot(1e3 * times, forces[name], color=colour, lw=1.8, label=name)
        right.plot(1e3 * depressions[name][alive], forces[name][alive], color=colour, lw=1.8)
        k = int(np.flatnonzero(alive)[len(np.flatnonzero(alive)) // 5])
        right.annotate("", (1e3 * depressions[name][k + 2], forces[name][k + 2]),
                       (1e3 * depressions[name][k], forces[name][k]),
                       arrowprops=dict(arrowstyle="-|>", color=colour, lw=1.8))
    for axes, what in ((left, "time after first touch [ms]"), (right, "depression [mm]")):
        dress(axes)
        axes.set_xlabel(what)
        axes.set_ylim(0, None)
    left.set_ylabel("normal force at 1 MPa [N]")
    left.legend(loc="upper right", title="sign of Eq. 5")
    right.set_title("arrows: loading")
    return figure
