"""Where the paper does not add up: each point with its numbers from the printed equations, and its figure."""

import dataclasses as dc
from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np

from ..contact.damping import damping_number, delivered_restitution
from ..contact.effect import Contact
from ..contact.friction import (
    CHANGES_SIGN_AT,
    DIVERGES_ABOVE,
    POLYNOMIALS,
    composite_modulus,
    slip_coefficient,
    slip_coefficients,
)
from ..contact.geometry import membrane_area_radius, racetrack_volume, sphere_volume
from ..contact.law import Ball, ContactLaw
from ..contact.sliding import RubberFriction
from ..figures.style import AFTER, BEFORE, FLOOR, GREY, INK, KIN, PLACE, dress, new_figure, styled
from .rows import sign


DIAMETER = 0.060  # m, Table 2
SPEED = 0.4  # m/s, section 4
STATED_TIME = 0.27  # s, section 4
STATED_ERROR = 6.7  # %, abstract
RANGES = ((0.0, 2.5), (0.1, 2.5), (0.0, 2.6), (0.1, 2.6), (0.2, 2.7), (0.5, 2.5), (1.0, 2.0), (1.0, 3.0), (0.0, 2.0))
ELSEWHERE = {10: "direction of the momentum (Tables 5 and 6)", 11: "step of the simulation"}


@dc.dataclass(frozen=True)
class Contradiction:
    """One point at which the paper contradicts itself.

    Attributes:
        number: row of the toolkit's list.
        title: what it concerns.
        printed: what the paper says.
        found: what its own equations or numbers give.
        used: what the toolkit does.
        sentence: the point in plain words, with the numbers.
        values: every number by name, SI unless the name says otherwise.
    """

    number: int
    title: str
    printed: str
    found: str
    used: str
    sentence: str
    values: Mapping[str, float]


def reading(name: str) -> Ball:
    """The ball under one reading of Eqs. 2 to 4 and 7.

    Args:
        name: `area` (b = depression/4 in the area alone, as Eq. 7 prints it), `quarter` (throughout), `printed`
            (Eqs. 2 to 4 as printed, b = pi depression/4), `ours` (without the doubled core).
    """
    options = {
        "area": dict(contact_radius_coefficient=0.25, volume_coefficient=float(np.pi / 4), doubled_core=True),
        "quarter": dict(contact_radius_coefficient=0.25, doubled_core=True),
        "printed": dict(doubled_core=True),
        "ours": {},
    }
    return Ball(**options[name])


def elastic_force(ball: Ball, depression: np.ndarray, pressure: float) -> np.ndarray:
    """F_k at given depressions and initial pressure [N] (Eq. 4)."""
    law = ContactLaw(ball)
    conditions = {"initial_pressure": jnp.asarray(pressure), "approach_speed": jnp.asarray(SPEED)}
    zero = jnp.zeros(())

    def one(depth) -> float:
        state: Contact = law.contact(conditions, ball.diameter(), zero, jnp.asarray(depth), zero, jnp.zeros((0,)))
        return float(state.elastic_force)

    return np.array([one(depth) for depth in np.atleast_1d(depression)])


def pressure_ratio(share: np.ndarray, law: str) -> np.ndarray:
    """P'/P0 at depression/diameter: constant `perimeter`, b = depression/4 (`quarter`), constant membrane `area`."""
    share = np.asarray(share, dtype=float)
    depth = share * DIAMETER
    radius = {"perimeter": np.pi / 4 * depth, "quarter": depth / 4,
              "area": np.asarray(membrane_area_radius(jnp.asarray(depth), jnp.asarray(DIAMETER)))}[law]
    volume = racetrack_volume(jnp.asarray(radius), jnp.asarray(0.5 * (DIAMETER - depth)))
    return np.asarray(sphere_volume(jnp.asarray(DIAMETER)) / volume)


def printed_restitution(asked: float) -> float:
    """Restitution that Eq. 6 delivers when asked for `asked` [-]."""
    return float(delivered_restitution(jnp.asarray(0.75 * (1.0 - asked**2))))


def reversed_restitution(restitution: float) -> float:
    """Rebound over approach speed with the sign of Eq. 5 at face value [-]: an impact of `restitution` backwards."""
    from scipy.optimize import brentq

    kappa = float(damping_number(jnp.asarray(restitution)))
    # Run backwards it is an impact at R v1 with the same c_n that rebounds with v1.
    root: Any = brentq(lambda r: float(delivered_restitution(jnp.asarray(kappa * r))) * r - 1.0, 1.0, 50.0)
    return float(root)


def miss_peaks(low: float, high: float, measured: np.ndarray, pressures: np.ndarray, peaks: np.ndarray) -> float:
    """Largest deviation of Table 3 from Figure 8's peaks when its rows stand at equal steps of pressure [-].

    Table 3 is interpolated linearly at Figure 8's pressures, its last value kept beyond its ends.

    Args:
        low, high: assumed first and last pressure of Table 3.
        measured: Table 3, shape (rows,) [N].
        pressures, peaks: Figure 8, shape (4,) [same unit as low and high, N].
    """
    grid = np.linspace(low, high, len(measured))
    return float(np.max(np.abs(np.interp(pressures, grid, measured) / peaks - 1.0)))


def list_contradictions(table: Mapping[str, np.ndarray], figure: Mapping[str, np.ndarray],
                        times: Mapping[str, tuple[float, float]]) -> list[Contradiction]:
    """All points that concern Eqs. 1 to 7, Figures 8 and 9 and Table 3.

    Args:
        table: Table 3: `measured`, `printed` [N] and `printed_error` [%], each shape (11,).
        figure: Figure 8: `pressure` [Pa] and `peak` [N], each shape (4,).
        times: shortest and longest computed contact time [s] of an impact whose mass fits the four peaks, by reading.
    """
    force = {name: float(elastic_force(reading(name), np.array([5e-3]), 1e6)[0])
             for name in ("area", "quarter", "printed", "ours")}
    step = 1e-6
    slope = float((1.0 / pressure_ratio(np.array([step]), "perimeter")[0] - 1.0) / step)
    tenth = {law: float(pressure_ratio(np.array([0.1]), law)[0]) for law in ("perimeter", "quarter", "area")}
    given = {asked: printed_restitution(asked) for asked in (0.8, 0.5)}
    error = 100 * (table["printed"] - table["measured"])
    by_theory, by_measured = error / table["printed"], error / table["measured"]
    miss = {span: 100 * miss_peaks(*span, table["measured"], figure["pressure"] / 1e6, figure["peak"])
            for span in RANGES}
    backwards, kappa = reversed_restitution(0.7), float(damping_number(jnp.asarray(0.7)))
    closest = list(sorted(miss.items(), key=lambda item: item[1]))
    core = 100 * (1 - force["printed"] / force["ours"])
    ours, quarter = times["ours"], times["quarter"]
    return [
        Contradiction(
            1, "Eq. 7 against Eqs. 2 to 4", f"Eq. 7: {force['area']:.1f} N at 1 MPa and 5 mm",
            f"Eqs. 2 to 4 with a constant perimeter: {force['printed']:.1f} N", "b = π/4 times the depression",
            f"Eq. 7 is Eq. 4 with b = δ/4 in the area, but a constant perimeter gives b = πδ/4, ten times the area: at "
            f"1 MPa and 5 mm Eq. 7 gives {force['area']:.1f} N ({force['quarter']:.1f} N with δ/4 throughout), Eqs. "
            f"2 to 4 "
            f"give {force['printed']:.1f} N as printed and {force['ours']:.1f} N without the doubled core.", force),
        Contradiction(
            2, "the core of Eq. 2", f"Eq. 2 adds πb²d: {force['printed']:.1f} N at 1 MPa and 5 mm",
            f"the integral holds that cylinder already: {force['ours']:.1f} N", "the integral alone",
            f"Eq. 2 counts the cylinder under the contact disc twice; without that the force at 1 MPa and 5 mm is "
            f"{force['ours']:.1f} N and not {force['printed']:.1f} N, {core:.1f} % more.", {"share_percent": core}),
        Contradiction(
            3, "whether the pressure rises", f"P′ > P₀ (with b = δ/4: {tenth['quarter']:.2f} P₀ at δ/D = 0.1)",
            f"a constant perimeter: {tenth['perimeter']:.2f} P₀ there", "constant perimeter; `membrane-area` as an "
                                                                        "effect",
            "The text says that the pressure rises, but a section of constant perimeter encloses more as it is "
            f"squeezed (V′/V₀ = 1 + {slope:.2f} δ/D to first order): at δ/D = 0.1 the pressure is "
            f"{tenth['perimeter']:.2f} of P₀. The rise, {tenth['quarter']:.2f}, needs b = δ/4 in the volume too; a "
            "constant area of the membrane gives "
            f"{tenth['area']:.2f}.", {"volume_slope": slope, **{f"ratio_{k}": v for k, v in tenth.items()}}),
        Contradiction(
            4, "the damping of Eq. 6", "asked for e = 0.8 and 0.5",
            f"delivers {given[0.8]:.3f} and {given[0.5]:.3f}", "the exact coefficient, solved from the closed form",
            f"Eq. 6 approximates the damping that a restitution needs: asked for 0.8 it delivers {given[0.8]:.3f}, "
            f"asked for 0.5 it delivers {given[0.5]:.3f}, whatever the spring, mass or pressure.",
            {f"delivered_{k}": v for k, v in given.items()}),
        Contradiction(
            7, "the errors of Table 3", f"largest error {STATED_ERROR} %, the eighth {table['printed_error'][7]:.1f} %",
            f"{by_measured.max():.1f} % of the measured value; the eighth {by_theory[7]:.1f} %",
            "errors relative to the measured value",
            "Table 3's errors are relative to the theoretical value; relative to the measured one the largest is "
            f"{by_measured.max():.1f} % and not {STATED_ERROR} %, and the eighth, printed as "
            f"{table['printed_error'][7]:.1f} %, is {by_theory[7]:.1f} % even so. The theory lies above the "
            f"measurement in all {len(error)} rows, by {by_measured.mean():.1f} % on average.",
            {"largest_percent": float(by_measured.max()), "eighth_percent": float(by_theory[7]),
             "mean_percent": float(by_measured.mean()), "largest_by_theory_percent": float(by_theory.max())}),
        Contradiction(
            8, "the abscissae of Table 3", "not printed",
            "; ".join(f"{a:g} to {b:g} MPa: {value:.1f} %" for (a, b), value in closest[:3]),
            f"{closest[0][0][0]:g} to {closest[0][0][1]:g} MPa, marked as assumed",
            "Eleven equal steps over each candidate range, interpolated at Figure 8's pressures, miss its four "
            "peaks by "
            + ", ".join(f"{value:.1f} % ({a:g} to {b:g} MPa)" for (a, b), value in closest)
            + ": the first fits best, but it stays an assumption.",
            {f"{a:g}-{b:g}": value for (a, b), value in miss.items()}),
        Contradiction(
            9, "the duration of an impact", f"{STATED_TIME} s",
            f"{ours[0]:.3f} to {ours[1]:.3f} s for a free impact", "arm-servo as an effect",
            f"The text states an impact time of {STATED_TIME} s. A free impact whose mass fits the four peaks of "
            f"Figure 8 lasts {ours[0]:.3f} to {ours[1]:.3f} s ({min(quarter[0], times['area'][0]):.2f} to "
            f"{max(quarter[1], times['area'][1]):.2f} s under the readings with b = δ/4): the arm must have gone on "
            "pushing.",
            {"stated": STATED_TIME, "shortest": ours[0], "longest": ours[1],
             "quarter_shortest": min(quarter[0], times["area"][0]),
             "quarter_longest": max(quarter[1], times["area"][1])}),
        Contradiction(
            12, "the sign of Eq. 5", f"F_c = −cₙ F_k δ̇: {1 - kappa:.2f} F_k at first touch (e = 0.7)",
            f"Hunt and Crossley: {1 + kappa:.2f} F_k", "F_n = F_k (1 + cₙ w), w > 0 while loading",
            f"Taken at face value Eq. 5 lowers the force while the ball is loaded ({1 - kappa:.2f} of F_k at first "
            f"touch for e = 0.7, where Hunt and Crossley's has {1 + kappa:.2f}) and feeds energy in: the ball would "
            f"leave with {backwards:.2f} times the speed it came with.", {"kappa": kappa, "rebound_ratio": backwards}),
    ]  # fmt: skip


SLIPS = tuple(1e-3 * s for s in (0.0, *np.geomspace(1e-3, 5.0, 75)))  # m, slips at which Eq. 11 is tried
UNCORRECTED = 22.6  # %, section 4: error of Eq. 8, whose column is not printed
CORRECTED = 6.9  # %, section 4: error of Eq. 11
LOOK = 1e-3  # m, slip at which the slip term is quoted: 1 mm


def slip_term(slip: np.ndarray, load: np.ndarray, printed: bool) -> np.ndarray:
    """Slip term of Eqs. 9 and 10 [-] at a slip [m] and a load [N], which broadcast; `printed` takes e from Eq. 10."""
    return np.asarray(slip_coefficient(jnp.asarray(slip), slip_coefficients(jnp.asarray(load, float), printed)))


def growth_rate(load: np.ndarray) -> np.ndarray:
    """b + |d| of Eq. 10 at a load [N]: the rate at which the curve of Eq. 9 grows with slip [1/mm]."""
    found = slip_coefficients(jnp.asarray(load, float))
    return np.asarray(found.b + jnp.abs(found.d))


def find_rest() -> float:
    """Load at which friction without slip, a(1 - e)F_n with the printed e, stops being negative [N] (29.1)."""
    p, q, r = POLYNOMIALS["e"]
    roots = np.roots([r, q, p - 1.0])
    return float(min(root.real for root in roots if abs(root.imag) < 1e-12 and root.real > 0))


def hysteresis_share(pressures: np.ndarray) -> np.ndarray:
    """(pi/10) (3 p_c/E*)^(2/3) of Eq. 8 [-] at gas pressures [Pa], with Table 2's rubber: E = 7.8 MPa, nu = 0.47."""
    rubber = RubberFriction()
    modulus = float(composite_modulus(rubber.elastic_modulus, rubber.poisson_ratio))
    return np.pi / 10.0 * np.cbrt(3.0 * np.asarray(pressures, float) / modulus) ** 2


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
    loads, printed = table["load"], table["printed"]
    rest, still = find_rest(), {n: float(slip_term(np.array(0.0), np.array(n), True)) for n in (0.0, loads.max())}
    steep = {n: _initial_slope(n) for n in np.linspace(0.0, rest, 59)}
    outside = int(np.sum(loads > DIVERGES_ABOVE))
    negative = int(np.sum(loads > CHANGES_SIGN_AT))
    term = slip_term(np.array(LOOK), loads, False)
    errors = scan_slip(loads, table["pressure"], printed, False)
    best, tenth = int(np.argmin(errors)), float(np.interp(1e-4, SLIPS, errors))
    given = float(np.min(scan_slip(loads, table["pressure"], printed, True)))
    gap = 100 * np.abs(table["measured"] - printed) / table["measured"]
    stated = table["printed_error"]
    return [
        Contradiction(
            5, "friction without slip (Eqs. 9 and 10)",
            f"e at no load is 2.69: friction is {sign(still[0.0], 2)} times the normal force",
            f"negative below {rest:.1f} N and above {CHANGES_SIGN_AT:.1f} N, not 0", "e = 1: the curve starts at 0",
            f"With the printed e friction without any slip is a(1 − e) times the normal force: {sign(still[0.0], 2)} "
            f"times at no load, negative below {rest:.1f} N and again above {CHANGES_SIGN_AT:.1f} N "
            f"({sign(still[loads.max()], 2)} times at {loads.max():.1f} N). With e = 1 the same a, b, c and d give a "
            f"curve that rises from 0 by {min(steep.values()):.3f} to {max(steep.values()):.3f} per mm below "
            f"{rest:.0f} N.",
            {"rest_load": rest, "no_load": still[0.0], "largest_load": still[loads.max()],
             "sign_load": CHANGES_SIGN_AT, "slope_low": min(steep.values()), "slope_high": max(steep.values())}),
        Contradiction(
            6, "the range of Eq. 10", f"used for Table 4, at {loads.min():.0f} to {loads.max():.0f} N",
            f"diverges with slip from {DIVERGES_ABOVE:.2f} N on, a < 0 from {CHANGES_SIGN_AT:.1f} N on",
            "loads above about 30 N are flagged as outside the fit's range",
            f"From {DIVERGES_ABOVE:.2f} N on the curve of Eqs. 9 and 10 grows without limit (b + |d| > 0), and from "
            f"{CHANGES_SIGN_AT:.1f} N on a is negative. The loads of Table 3 are {loads.min():.1f} to "
            f"{loads.max():.1f} N: {outside} of {len(loads)} diverge, {negative} have a negative a, and at 1 mm of "
            f"slip the slip term would be {sign(term.max(), 2)} to {sign(term.min(), 2)}. If all rows share a slip, "
            f"Eq. 11 comes closest to Table 4's corrected column at {1e3 * SLIPS[best]:.3f} mm, so at none "
            f"({100 * errors[best]:.1f} % rms; {100 * tenth:.0f} % at 0.1 mm; {100 * given:.0f} % at best with the "
            f"printed e): Eq. 10 cannot be what made that column.",
            {"diverges_load": DIVERGES_ABOVE, "sign_load": CHANGES_SIGN_AT, "least_load": float(loads.min()),
             "largest_load": float(loads.max()), "diverging": outside, "negative": negative,
             "term_high": float(term.max()), "term_low": float(term.min()), "best_slip": float(SLIPS[best]),
             "best_error": float(errors[best]), "tenth_error": tenth, "best_error_printed": given}),
        Contradiction(
            13, "two errors of Table 4", f"fourth {stated[3]:.1f} %, eleventh {stated[10]:.1f} %",
            f"{gap[3]:.1f} % and {gap[10]:.1f} %", "errors from the table's own numbers",
            f"Table 4 prints errors of {stated[3]:.1f} % for its fourth row and {stated[10]:.1f} % for its eleventh; "
            f"its own numbers give {gap[3]:.1f} % and {gap[10]:.1f} %. The other nine agree within "
            f"{np.max(np.delete(np.abs(gap - stated), [3, 10])):.2f} points.",
            {"fourth_percent": float(gap[3]), "eleventh_percent": float(gap[10]), "largest_percent": float(gap.max()),
             "others_points": float(np.max(np.delete(np.abs(gap - stated), [3, 10])))}),
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


def _initial_slope(load: float) -> float:
    """Slope of the slip term at no slip with e = 1, a (c d - b) [1/mm]."""
    a, b, c, d, _ = slip_coefficients(jnp.asarray(load))
    return float(a * (c * d - b))


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
