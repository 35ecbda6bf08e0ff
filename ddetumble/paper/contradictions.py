"""Where the paper does not add up: each point with its numbers from the printed equations, and its figure."""

import dataclasses as dc
from collections.abc import Mapping, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .._numerics import scalar
from .._sentences import tell
from ..contact.damping import damping_number, delivered_restitution
from ..contact.friction import (
    CHANGES_SIGN_AT,
    DIVERGES_ABOVE,
    POLYNOMIALS,
    composite_modulus,
    rubber_coefficient,
    slip_coefficient,
    slip_coefficients,
)
from ..contact.geometry import membrane_area_radius, racetrack_volume, sphere_volume
from ..contact.law import Ball, ContactLaw
from ..contact.shell import inflation_pressure, limit_pressure, shell_stiffness
from ..contact.sliding import RubberFriction
from ..dynamics.curves import normal_force
from ..dynamics.impact import Impact, simulate_impact
from ..figures.palette import AFTER, BEFORE, FLOOR, GREY, INK, KIN, PALE, PLACE
from ..figures.style import dress, new_axes, new_figure, point_at, styled


DIAMETER = 0.060  # m, Table 2
INNER = 0.040  # m, Table 2: nothing in the paper uses it
MODULUS, POISSON = 7.8e6, 0.47  # Pa and -, Table 2
SPEED = 0.4  # m/s, section 4
STATED_TIME = 0.27  # s, section 4
AVOIDED = (1.5, 1.9)  # MPa, section 4: where friction was "obviously nonlinear"
STATED_ERROR = 6.7  # %, abstract
# MPa, first and last pressure that Table 3's eleven rows are tried at
RANGES = ((0.0, 2.5), (0.1, 2.5), (0.0, 2.6), (0.1, 2.6), (0.2, 2.7), (0.5, 2.5), (1.0, 2.0), (1.0, 3.0), (0.0, 2.0))
READINGS = {  # of Eqs. 2 to 4 and 7: choices of the ball, legend, colour and line
    "ours": ({}, "Eqs. 2 to 4, core once, b = πδ/4", AFTER, "-"),
    "printed": (dict(doubled_core=True), "Eqs. 2 to 4 as printed, b = πδ/4", KIN, "--"),
    "quarter": (dict(contact_radius_coefficient=0.25, doubled_core=True), "b = δ/4 throughout", BEFORE, "--"),
    "area": (dict(contact_radius_coefficient=0.25, volume_coefficient=float(np.pi / 4), doubled_core=True),
             "Eq. 7: b = δ/4 in the area alone", BEFORE, "-"),
}  # fmt: skip


@dc.dataclass(frozen=True)
class Contradiction:
    """One point at which the paper contradicts itself.

    Attributes:
        row: of the toolkit's list.
        title: what it concerns.
        printed: what the paper says.
        found: what its own equations or numbers give.
        used: what the toolkit does.
        sentence: the point in plain words, with the numbers.
        values: every number by name, SI unless the name says otherwise.
    """

    row: int
    title: str
    printed: str
    found: str
    used: str
    sentence: str
    values: Mapping[str, float]


def make_point(row: int, values: Mapping[str, float], **facts) -> Contradiction:
    """The point of a row, with its words from `paper.point_ROW` about its values and further facts."""
    title, printed, found, used, sentence = tell(f"paper.point_{row}", v=values, **facts)
    return Contradiction(row, title, printed, found, used, sentence, values)


def _read_force(name: str, depression: float | np.ndarray) -> np.ndarray:
    """F_k at 1 MPa [N] under one of the `READINGS`, or under Eq. 1 (`earlier`)."""
    ball = Ball(truncated=True) if name == "earlier" else Ball(**READINGS[name][0])
    return np.asarray(normal_force(ball, depression, initial_pressure=1e6))


def pressure_ratio(share: np.ndarray, law: str) -> np.ndarray:
    """P'/P0 at depression/diameter: constant `perimeter`, b = depression/4 (`quarter`), constant membrane `area`."""
    depth = np.asarray(share, dtype=float) * DIAMETER
    radius = {"perimeter": np.pi / 4 * depth, "quarter": depth / 4,
              "area": np.asarray(membrane_area_radius(jnp.asarray(depth), jnp.asarray(DIAMETER)))}[law]
    volume = racetrack_volume(jnp.asarray(radius), jnp.asarray(0.5 * (DIAMETER - depth)))
    return np.asarray(sphere_volume(jnp.asarray(DIAMETER)) / volume)


def printed_restitution(asked: float) -> float:
    """Restitution that Eq. 6 delivers when asked for `asked` [-]."""
    return float(delivered_restitution(jnp.asarray(0.75 * (1.0 - asked**2))))


def reversed_restitution(kappa: float) -> float:
    """Rebound over approach speed [-] with the sign of Eq. 5 at face value, at that damping number."""
    from scipy.optimize import brentq

    # Run backwards it is an impact at R v1 with the same c_n that rebounds with v1.
    root: Any = brentq(lambda r: float(delivered_restitution(jnp.asarray(kappa * r))) * r - 1.0, 1.0, 50.0)
    return float(root)


def list_contradictions(table: Mapping[str, np.ndarray], figure: Mapping[str, np.ndarray],
                        times: Mapping[str, np.ndarray]) -> list[Contradiction]:
    """All points that concern Eqs. 1 to 7, Figures 8 and 9 and Table 3.

    Args:
        table: Table 3: `measured`, `printed` [N] and `printed_error` [%], each shape (11,).
        figure: Figure 8: `pressure` [Pa] and `peak` [N], each shape (4,).
        times: computed contact times [s] of impacts whose mass fits the four peaks, by reading, shape (4,).
    """
    force = {name: float(_read_force(name, 5e-3)) for name in ("area", "quarter", "printed", "ours")}
    step = 1e-6  # of depression over diameter: small enough for the first order, large enough for its digits
    slope = float((1.0 / pressure_ratio(np.array([step]), "perimeter")[0] - 1.0) / step)
    tenth = {f"ratio_{law}": float(pressure_ratio(np.array([0.1]), law)[0]) for law in ("perimeter", "quarter", "area")}
    error = 100 * (table["printed"] - table["measured"])
    by_theory, by_measured = error / table["printed"], error / table["measured"]
    # Table 3 is interpolated linearly at Figure 8's pressures, its last value kept beyond its ends.
    rows, pressures = len(table["measured"]), figure["pressure"] / 1e6
    spans = []
    for low, high in RANGES:
        placed = np.interp(pressures, np.linspace(low, high, rows), table["measured"])
        spans.append((f"{low:g} to {high:g}", float(100 * np.max(np.abs(placed / figure["peak"] - 1.0)))))
    kappa = float(damping_number(jnp.asarray(0.7)))
    pushed = (*times["quarter"], *times["area"])
    return [
        make_point(1, force),
        make_point(2, {"share_percent": 100 * (1 - force["printed"] / force["ours"])}, force=force),
        make_point(3, {"volume_slope": slope, **tenth}),
        make_point(4, {f"delivered_{asked}": printed_restitution(asked) for asked in (0.8, 0.5)}),
        make_point(7, {"largest_percent": float(by_measured.max()), "eighth_percent": float(by_theory[7]),
                       "mean_percent": float(by_measured.mean()), "largest_by_theory_percent": float(by_theory.max())},
                   stated=STATED_ERROR, eighth=table["printed_error"][7], rows=rows),
        make_point(8, {span.replace(" to ", "-"): miss for span, miss in spans},
                   closest=sorted(spans, key=lambda one: one[1]), rows=rows),
        make_point(9, {"stated": STATED_TIME, "shortest": float(min(times["ours"])),
                       "longest": float(max(times["ours"])), "quarter_shortest": float(min(pushed)),
                       "quarter_longest": float(max(pushed))}),
        make_point(12, {"kappa": kappa, "rebound_ratio": reversed_restitution(kappa)}),
    ]  # fmt: skip


def fit_parabola(values: np.ndarray) -> tuple[np.ndarray, float]:
    """Parabola in the row number (from 0) whose largest error over a column is the smallest: its coefficients, constant
    first, and that error."""
    from scipy.optimize import linprog

    row = np.arange(len(values))
    powers, one = row[:, None] ** np.arange(3), np.ones((len(row), 1))
    found = linprog([0.0, 0.0, 0.0, 1.0], np.block([[powers, -one], [-powers, -one]]),
                    np.concatenate([values, -values]), bounds=[(None, None)] * 3 + [(0.0, None)])
    return found.x[:3], float(found.x[3])


def list_wall_points(table: Mapping[str, np.ndarray], mass: float, peaks: np.ndarray, shell: Sequence[float]
                     ) -> list[Contradiction]:
    """Rows 14 to 16: the earlier law, Table 3's theory, and the wall that nothing uses.

    Args:
        table: Table 3 as in `list_contradictions`, and `pressure` [Pa].
        mass: effective mass that fits Table 3 under Eq. 1 [kg]; `peaks`: what it gives there, shape (11,) [N].
        shell: largest errors of Figure 8 and of Table 3 under `InflatedShell` with one fitted mass [%].
    """
    earlier, printed, ours = (float(_read_force(name, 5e-3)) for name in ("earlier", "printed", "ours"))
    (constant, slope, bend), missed = fit_parabola(table["printed"])
    gas = table["pressure"] > 0
    outer, thickness = 0.5 * DIAMETER, 0.5 * (DIAMETER - INNER)
    limit, stretch = limit_pressure(INNER / DIAMETER, MODULUS / 3.0)
    wall = [float(shell_stiffness(jnp.asarray(thickness), jnp.asarray(radius), jnp.asarray(MODULUS),
                                  jnp.asarray(POISSON))) * 5e-3 for radius in (outer, outer - thickness)]
    return [
        make_point(14, {"earlier": earlier, "printed": printed, "ours": ours, "ratio": earlier / printed, "mass": mass,
                        "worst_percent": 100 * float(np.max(np.abs(peaks / table["measured"] - 1.0)[gas]))}),
        make_point(15, {"constant": constant, "slope": slope, "bend": bend, "largest": missed},
                   rows=len(table["printed"]), first=table["printed"][0]),
        make_point(16, {
            "outside": 1e6 * float(sphere_volume(jnp.asarray(DIAMETER))),
            "cavity": 1e6 * float(sphere_volume(jnp.asarray(INNER))), "wall_low": min(wall), "wall_high": max(wall),
            "thin_low": thickness / outer, "thin_high": thickness / (outer - thickness),
            "gas": ours, "limit": limit / 1e6, "stretch": stretch,
            "shell_figure": shell[0], "shell_table": shell[1]}, thickness=1e3 * thickness),
    ]  # fmt: skip


SLIPS = tuple(1e-3 * s for s in (0.0, *np.geomspace(1e-3, 5.0, 75)))  # m, slips at which Eq. 11 is tried
UNCORRECTED = 22.6  # %, section 4: error of Eq. 8, whose column is not printed
CORRECTED = 6.9  # %, section 4: error of Eq. 11
LOOK = 1e-3  # m, slip at which the slip term is quoted: 1 mm, the unit of Eq. 10


def slip_term(slip: np.ndarray | float, load: np.ndarray | float, printed: bool) -> np.ndarray:
    """Slip term of Eqs. 9 and 10 [-] at a slip [m] and a load [N], which broadcast; `printed` takes e from Eq. 10."""
    return np.asarray(slip_coefficient(jnp.asarray(slip), slip_coefficients(jnp.asarray(load, float), printed)))


def find_rest() -> float:
    """Load at which friction without slip, a(1 - e)F_n with the printed e, stops being negative [N] (29.1)."""
    p, q, r = POLYNOMIALS["e"]
    roots = np.roots([r, q, p - 1.0])
    return float(min(root.real for root in roots if abs(root.imag) < 1e-12 and root.real > 0))


def hysteresis_share(pressures: np.ndarray) -> np.ndarray:
    """(pi/10) (3 p_c/E*)^(2/3) of Eq. 8 [-] at gas pressures [Pa], with Table 2's rubber: E = 7.8 MPa, nu = 0.47."""
    rubber, zero = RubberFriction(), jnp.zeros(())
    modulus = composite_modulus(rubber.elastic_modulus, rubber.poisson_ratio)
    return np.asarray(rubber_coefficient(zero, zero + 1.0, zero, jnp.asarray(pressures, float), modulus))


def scan_slip(loads: np.ndarray, pressures: np.ndarray, column: np.ndarray, printed: bool) -> np.ndarray:
    r"""Error of Eq. 11 against a column of forces by the slip that all rows share, K and tan(delta) fitted.

    At every slip the two weights of Eq. 8, $K\tan\delta_L$ and $\tan\delta_L$, are fitted to relative errors under
    the condition that neither is negative.

    Args:
        loads, pressures, column: of the rows, shape (rows,) [N, Pa, N].
        printed: take e from Eq. 10 too.

    Returns:
        Rms of the relative error at each slip of `SLIPS`, shape (slips,) [-].
    """
    from scipy.optimize import nnls

    weights = np.column_stack([loads, loads * hysteresis_share(pressures)]) / column[:, None]
    left = [nnls(weights, 1.0 - slip_term(np.array(s), loads, printed) * loads / column)[1] for s in SLIPS]
    return np.array(left) / np.sqrt(len(loads))


def list_friction_points(table: Mapping[str, np.ndarray]) -> list[Contradiction]:
    """Rows 5, 6 and 13: friction without slip, the range of Eq. 10, two printed errors.

    Args:
        table: `load`, `pressure`, `measured`, `printed` and `printed_error` of Tables 3 and 4, shape (11,)
            [N, Pa, N, N, %].
    """
    loads, printed, stated = table["load"], table["printed"], table["printed_error"]
    rest, most = find_rest(), float(loads.max())
    a, b, c, d, _ = slip_coefficients(jnp.linspace(0.0, rest, 59))
    slopes = a * (c * d - b)  # of the slip term at no slip with e = 1 [1/mm]
    term = slip_term(LOOK, loads, False)
    errors = scan_slip(loads, table["pressure"], printed, False)
    best = int(np.argmin(errors))
    gap = 100 * np.abs(table["measured"] - printed) / table["measured"]
    others = float(np.max(np.delete(np.abs(gap - stated), [3, 10])))
    return [
        make_point(5, {"rest_load": rest, "no_load": float(slip_term(0.0, 0.0, True)),
                       "largest_load": float(slip_term(0.0, most, True)), "sign_load": CHANGES_SIGN_AT,
                       "slope_low": float(slopes.min()), "slope_high": float(slopes.max())}, most=most),
        make_point(6, {"diverges_load": DIVERGES_ABOVE, "sign_load": CHANGES_SIGN_AT,
                       "least_load": float(loads.min()), "largest_load": most,
                       "diverging": int(np.sum(loads > DIVERGES_ABOVE)),
                       "negative": int(np.sum(loads > CHANGES_SIGN_AT)),
                       "term_high": float(term.max()), "term_low": float(term.min()), "best_slip": float(SLIPS[best]),
                       "best_error": float(errors[best]), "tenth_error": float(np.interp(1e-4, SLIPS, errors)),
                       "best_error_printed": float(scan_slip(loads, table["pressure"], printed, True).min())},
                   rows=len(loads)),
        make_point(13, {"fourth_percent": float(gap[3]), "eleventh_percent": float(gap[10]),
                        "largest_percent": float(gap.max()), "others_points": others}, stated=stated),
    ]  # fmt: skip


def err_scaled(loads: np.ndarray, pressures: np.ndarray, peaks: np.ndarray, adhesion: float) -> float:
    r"""Largest relative error of Eq. 8 times one fitted scale, $\tan\delta_L$, at a given $K\sigma_0/p_r$ [-].

    Args:
        loads, pressures, peaks: of the rows, shape (rows,) [N, Pa, N].
        adhesion: $K\sigma_0/p_r$ [-]; inf for adhesion alone, a constant coefficient.
    """
    shape = np.ones_like(loads) if np.isinf(adhesion) else np.pi / 4.0 * adhesion + hysteresis_share(pressures)
    ratio = loads * shape / peaks
    return float(np.max(np.abs(ratio * np.sum(ratio) / np.sum(ratio**2) - 1.0)))


@styled
def draw_readings():
    """Elastic force against depression at 1 MPa under the four readings of Eqs. 2 to 7."""
    figure, left, right = new_axes(3.6, grid="both", columns=2)
    depth = np.linspace(0.0, 8e-3, 33)
    for name, (_, label, colour, line) in READINGS.items():
        force, value = _read_force(name, depth), float(_read_force(name, 5e-3))
        for axes in (left, right):
            axes.plot(1e3 * depth, force, line, color=colour, lw=1.8, label=f"{label}: {value:.1f} N")
            axes.plot([5], [value], "o", color=colour, ms=5)
    for axes in (left, right):
        axes.axvline(5, color=FLOOR, lw=0.8, ls=":")
        axes.set(xlabel="depression [mm]", xlim=(0, 8))
    left.set(ylim=(0, None), ylabel="elastic force at 1 MPa [N]")
    right.set(ylim=(0, 15), title="the same, enlarged")
    left.legend(loc="upper left", title="at 5 mm", alignment="left", fontsize=8.5)
    return figure


@styled
def draw_core():
    """Force with Eq. 2 as printed over the force with the core counted once, against depression."""
    figure, axes = new_axes(3.0, 7.0)
    depth = np.linspace(1e-4, 12e-3, 33)
    deviation = 100 * (_read_force("printed", depth) / _read_force("ours", depth) - 1)
    axes.plot(1e3 * depth, deviation, color=BEFORE, lw=1.8)
    axes.axhline(0, color=FLOOR, lw=0.8)
    at = float(np.interp(5e-3, depth, deviation))
    point_at(axes, f"−{abs(at):.1f} %", (5, at), (8, 4), 6, color=BEFORE)
    axes.set(xlabel="depression [mm]", ylabel="force with the core twice,\ndeviation [%]")
    return figure


@styled
def draw_pressure():
    """P'/P0 against depression over diameter under three laws of the contact radius."""
    figure, axes = new_axes(3.4, 7.5)
    share = np.linspace(0.0, 0.2, 41)
    for law, label, colour, line in (
            ("quarter", "b = δ/4 (perimeter shrinks)", BEFORE, "-"), ("area", "constant membrane area", GREY, "--"),
            ("perimeter", "constant perimeter, b = πδ/4 (the paper's assumption)", AFTER, "-")):
        axes.plot(share, pressure_ratio(share, law), line, color=colour, lw=1.8, label=label)
        at = float(pressure_ratio(np.array([0.1]), law)[0])
        point_at(axes, f"{at:.2f}", (0.1, at), (0, 7), 6, color=colour, ha="center")
    axes.axhline(1, color=FLOOR, lw=0.8)
    axes.set(xlabel="depression / diameter", ylabel="P′ / P0", ylim=(0.85, 1.55))
    axes.legend(loc="upper left")
    return figure


@styled
def draw_restitution():
    """Restitution that Eq. 6 delivers against the one asked for."""
    figure, axes = new_axes(3.6, 6.0, grid="both")
    asked = np.linspace(0.02, 1.0, 50)
    axes.plot(asked, asked, color=AFTER, lw=1.8, label="exact coefficient")
    axes.plot(asked, [printed_restitution(e) for e in asked], color=BEFORE, lw=1.8, label="Eq. 6")
    for e in (0.5, 0.8):
        given = printed_restitution(e)
        point_at(axes, f"{e} → {given:.3f}", (e, given), (-6, 7), 6, ha="right", color=BEFORE)
    axes.set(xlabel="restitution wanted", ylabel="restitution obtained", xlim=(0, 1), ylim=(0, 1.02))
    axes.legend(loc="lower right")
    return figure


@styled
def draw_errors(measured: np.ndarray, printed: np.ndarray, printed_error: np.ndarray):
    """Table 3's errors as printed, recomputed, and relative to the measured value; arrays of shape (11,) [N, N, %]."""
    figure, axes = new_axes(3.2)
    row = np.arange(1, len(measured) + 1)
    gap = 100 * (printed - measured)
    axes.bar(row - 0.27, printed_error, 0.25, color=KIN, label="as printed")
    axes.bar(row, gap / printed, 0.25, color=GREY, label="relative to the theory, recomputed")
    axes.bar(row + 0.27, gap / measured, 0.25, color=BEFORE, label="relative to the measurement")
    axes.axhline(STATED_ERROR, color=INK, lw=0.8, ls=":")
    point_at(axes, f"stated limit, {STATED_ERROR} %", (0.5, STATED_ERROR), (0, 3), color=INK, fontsize=8.5)
    top = (gap / measured).max()
    point_at(axes, f"{top:.1f} %", (row[-1] + 0.27, top), (0, 3), ha="center", color=BEFORE)
    point_at(axes, f"{printed_error[7]:.1f} printed,\n{gap[7] / printed[7]:.1f} recomputed", (8, printed_error[7]),
             (0, 9), ha="center", fontsize=8.5)
    axes.set(xticks=row, xlim=(0.4, len(row) + 0.7), ylim=(0, 9.6), xlabel="row of Table 3", ylabel="error [%]")
    axes.legend(loc="upper left", ncols=3)
    return figure


@styled
def draw_earlier():
    """Elastic force at 1 MPa of Eq. 1 and of Eqs. 2 to 4 against depression."""
    figure, axes = new_axes(3.2, 7.0, grid="both")
    depth = np.linspace(1e-4, 8e-3, 33)
    for name, label, colour in (("earlier", "Eq. 1, the earlier law", BEFORE),
                                ("printed", "Eqs. 2 to 4 as printed", AFTER)):
        force = _read_force(name, depth)
        at = float(np.interp(5e-3, depth, force))
        axes.plot(1e3 * depth, force, color=colour, lw=1.8, label=f"{label}: {at:.0f} N at 5 mm")
        axes.plot([5], [at], "o", color=colour)
    axes.set(xlabel="depression [mm]", ylabel="elastic force at 1 MPa [N]", yscale="log", xlim=(0, 8), ylim=(0.1, None))
    axes.yaxis.set_major_formatter("{x:g}")
    axes.legend(loc="lower right")
    return figure


@styled
def draw_parabola(printed: np.ndarray, model: np.ndarray):
    """Table 3's theory with the parabola in the row number, and what our fitted model gives; shape (11,) each [N]."""
    figure, left, right = new_axes(3.2, columns=2)
    (constant, slope, bend), _ = fit_parabola(printed)
    row, fine = np.arange(len(printed)), np.linspace(0.0, len(printed) - 1.0, 81)
    curve = constant + slope * row + bend * row**2
    left.plot(fine + 1, constant + slope * fine + bend * fine**2, color=BEFORE, lw=1.5,
              label=f"{constant:.3f} + {slope:.4f} i + {bend:.4f} i²")
    left.plot(row + 1, printed, "o", color=INK, ms=4.5, label="theory column, as printed")
    left.plot(row + 1, model, "s-", color=AFTER, ms=4, lw=1.2, label="Eqs. 2 to 6, one mass fitted")
    left.set(xlabel="row of Table 3 (i + 1)", ylabel="peak normal force [N]", ylim=(0, None))
    left.legend(loc="lower right")
    right.axhspan(-0.05, 0.05, color=PLACE, lw=0)
    right.plot(row + 1, printed - curve, "o", color=INK, ms=4.5)
    right.set(xlabel="row of Table 3", ylabel="column less parabola [N]", ylim=(-0.12, 0.12),
              title="band: rounding to 0.1 N")
    return figure


@styled
def draw_inflation():
    """Pressure that a neo-Hookean sphere of Table 2 holds against its inner stretch, and the paper's pressures."""
    figure, axes = new_axes(3.2, 7.0, grid="both")
    stretch = np.linspace(1.0, 3.0, 81)
    pressure = np.asarray(inflation_pressure(jnp.asarray(stretch), jnp.asarray(INNER / DIAMETER),
                                             jnp.asarray(MODULUS / 3.0))) / 1e6
    limit, at = limit_pressure(INNER / DIAMETER, MODULUS / 3.0)
    axes.axhspan(*AVOIDED, color=PLACE, lw=0, label="pressures that the paper avoids")
    axes.axhline(2.5, color=FLOOR, lw=0.8, ls=":")
    point_at(axes, "largest pressure of the tests", (1.0, 2.5), (4, -11))
    axes.plot(stretch, pressure, color=AFTER, lw=1.8, label="sphere of 40/60 mm, E = 7.8 MPa")
    point_at(axes, f"{limit / 1e6:.2f} MPa", (at, limit / 1e6), (0, -14), 6, color=AFTER, ha="center")
    axes.set(xlabel="inner radius over that at rest", ylabel="pressure [MPa]", xlim=(1, 3), ylim=(0, 2.7))
    axes.legend(loc="lower right")
    return figure


@styled
def draw_ranges(misses: Mapping[str, float], measured: np.ndarray, pressures: np.ndarray, peaks: np.ndarray):
    """Table 3 [N] at candidate ranges of pressure, Figure 8's peaks [MPa, N], and by how much each misses them [%]."""
    figure = new_figure(3.6)
    left, right = figure.subplots(1, 2, width_ratios=(1.25, 1))
    dress(left, "both")
    dress(right, "x")
    for span, colour, line in ((RANGES[0], AFTER, "-o"), (RANGES[4], KIN, "--o"), (RANGES[5], GREY, "-.o")):
        grid = np.linspace(*span, len(measured))
        left.plot(grid, measured, line, color=colour, ms=3.5, lw=1.3, label=f"{span[0]:g} to {span[1]:g} MPa")
    left.plot(pressures, peaks, "D", color=BEFORE, ms=7, label="Figure 8", zorder=4)
    left.set(xlabel="pressure [MPa]", ylabel="peak normal force [N]")
    left.legend(loc="upper left", title="Table 3 placed at", alignment="left")
    names, values = zip(*sorted(misses.items(), key=lambda item: -item[1]), strict=True)
    right.barh([name.replace("-", " to ") for name in names], values,
               color=[AFTER if value == min(values) else PALE for value in values])
    for i, value in enumerate(values):
        point_at(right, f"{value:.1f} %", (value, i), (4, 0), va="center", fontsize=8.5)
    right.set(xlim=(0, 1.2 * max(values)), xlabel="largest deviation from Figure 8 [%]", ylabel="range [MPa]")
    return figure


@eqx.filter_jit
def _simulate_impacts(law: ContactLaw, conditions: Mapping[str, Any], times: np.ndarray) -> Impact:
    """Impacts at conditions of shape (records,), SI, each at the same times [s]: an `Impact` with a leading axis."""
    return jax.vmap(lambda one: simulate_impact(law, one, jnp.asarray(times)))(conditions)


@styled
def draw_duration(pressures: np.ndarray, peaks: np.ndarray, mass: float):
    """Free impacts of the effective mass [kg] that fits Figure 8's peaks [Pa, N] beside the stated impact time."""
    figure, axes = new_axes(3.2)
    axes.axvspan(0, 1e3 * STATED_TIME, color=PLACE, lw=0)
    point_at(axes, f"stated impact time, {1e3 * STATED_TIME:.0f} ms", (1e3 * STATED_TIME, 60), (-6, 0), ha="right")
    times = np.linspace(0.0, 0.3, 900)
    conditions = {"initial_pressure": pressures, "approach_speed": np.full(len(peaks), SPEED)}
    impacts = _simulate_impacts(ContactLaw(Ball(effective_mass=scalar(mass))), conditions, times)
    shades = ("#9ecae1", "#6baed6", "#3182bd", "#08519c")
    for force, pressure, peak, colour in zip(np.asarray(impacts.normal_force), pressures, peaks, shades, strict=True):
        axes.plot(1e3 * times, force, color=colour, lw=1.8, label=f"{pressure / 1e6:g} MPa, {peak:.1f} N measured")
    axes.set(xlim=(-5, 300), ylim=(0, 80), xlabel="time after first touch [ms]", ylabel="normal force [N]")
    axes.legend(loc="center", title=f"free impact of {mass:.2f} kg at 0.4 m/s", alignment="left")
    return figure


@styled
def draw_sign(mass: float):
    """Force over time and over depression with both signs of Eq. 5, of an effective mass [kg]."""
    figure, left, right = new_axes(3.4, columns=2)
    times = np.linspace(0.0, 0.05, 400)
    conditions = {"initial_pressure": np.array([1e6]), "approach_speed": np.array([SPEED])}
    for name, sign, colour in (("as printed", -1.0, BEFORE), ("Hunt and Crossley", 1.0, AFTER)):
        law = ContactLaw(Ball(effective_mass=scalar(mass), damping_sign=sign))
        impact = _simulate_impacts(law, conditions, times)
        force, depth = np.asarray(impact.normal_force)[0], 1e3 * np.asarray(impact.depression)[0]
        alive = depth > 0
        left.plot(1e3 * times, force, color=colour, lw=1.8, label=name)
        right.plot(depth[alive], force[alive], color=colour, lw=1.8)
        k = int(np.flatnonzero(alive)[np.sum(alive) // 5])
        right.annotate("", (depth[k + 2], force[k + 2]), (depth[k], force[k]),
                       arrowprops=dict(arrowstyle="-|>", color=colour, lw=1.8))
    left.set(xlabel="time after first touch [ms]", ylim=(0, None), ylabel="normal force at 1 MPa [N]")
    right.set(xlabel="depression [mm]", ylim=(0, None), title="arrows: loading")
    left.legend(loc="upper right", title="sign of Eq. 5")
    return figure
