"""Where the paper's normal force does not add up: each point with its numbers computed from the printed equations."""

import dataclasses as dc
from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np

from ..contact.damping import damping_number, delivered_restitution
from ..contact.effect import Contact
from ..contact.geometry import membrane_area_radius, racetrack_volume, sphere_volume
from ..contact.law import Ball, ContactLaw


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
            f"The text says that the pressure rises, but a section of constant perimeter encloses more as it is "
            f"squeezed "
            f"(V′/V₀ = 1 + {slope:.2f} δ/D to first order): at δ/D = 0.1 the pressure is {tenth['perimeter']:.2f} "
            f"of P₀. The "
            f"rise, {tenth['quarter']:.2f}, needs b = δ/4 in the volume too; a constant area of the membrane gives "
            f"{tenth['area']:.2f}.", {"volume_slope": slope, **{f"ratio_{k}": v for k, v in tenth.items()}}),
        Contradiction(
            4, "the damping of Eq. 6", "asked for e = 0.8 and 0.5",
            f"delivers {given[0.8]:.3f} and {given[0.5]:.3f}", "the exact coefficient, solved from the closed form",
            f"Eq. 6 approximates the damping that a restitution needs: asked for 0.8 it delivers {given[0.8]:.3f}, "
            f"asked for "
            f"0.5 it delivers {given[0.5]:.3f}, whatever the spring, mass or pressure.",
            {f"delivered_{k}": v for k, v in given.items()}),
        Contradiction(
            7, "the errors of Table 3", f"largest error {STATED_ERROR} %, the eighth {table['printed_error'][7]:.1f} %",
            f"{by_measured.max():.1f} % of the measured value; the eighth {by_theory[7]:.1f} %",
            "errors relative to the measured value",
            f"Table 3's errors are relative to the theoretical value; relative to the measured one the largest is "
            f"{by_measured.max():.1f} % and not {STATED_ERROR} %, and the eighth, printed as "
            f"{table['printed_error'][7]:.1f} %, is {by_theory[7]:.1f} % even so. The theory lies above the "
            f"measurement in all "
            f"{len(error)} rows, by {by_measured.mean():.1f} % on average.",
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
            f"Figure 8 "
            f"lasts {ours[0]:.3f} to {ours[1]:.3f} s ({min(quarter[0], times['area'][0]):.2f} to "
            f"{max(quarter[1], times['area'][1]):.2f} s under the readings with b = δ/4): the arm must have gone on "
            f"pushing.",
            {"stated": STATED_TIME, "shortest": ours[0], "longest": ours[1],
             "quarter_shortest": min(quarter[0], times["area"][0]),
             "quarter_longest": max(quarter[1], times["area"][1])}),
        Contradiction(
            12, "the sign of Eq. 5", f"F_c = −cₙ F_k δ̇: {1 - kappa:.2f} F_k at first touch (e = 0.7)",
            f"Hunt and Crossley: {1 + kappa:.2f} F_k", "F_n = F_k (1 + cₙ w), w > 0 while loading",
            f"Taken at face value Eq. 5 lowers the force while the ball is loaded ({1 - kappa:.2f} of F_k at first "
            f"touch for "
            f"e = 0.7, where Hunt and Crossley's has {1 + kappa:.2f}) and feeds energy in: the ball would leave with "
            f"{backwards:.2f} times the speed it came with.", {"kappa": kappa, "rebound_ratio": backwards}),
    ]  # fmt: skip
