"""Where the paper's friction does not add up: Eqs. 9 and 10 at the loads of Table 3, and two errors of Table 4."""

from collections.abc import Mapping

import jax.numpy as jnp
import numpy as np

from ..contact.friction import (
    CHANGES_SIGN_AT,
    DIVERGES_ABOVE,
    POLYNOMIALS,
    composite_modulus,
    slip_coefficient,
    slip_coefficients,
)
from ..contact.sliding import RubberFriction
from .contradictions import Contradiction
from .words import sign


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
