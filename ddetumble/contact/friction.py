r"""Friction of rubber as the paper has it: adhesion and hysteresis (Eq. 8), slip (Eqs. 9 and 10), their sum (Eq. 11).

Formulas are pure functions of plain arguments. The slip term is printed for slip in millimetres and load in newtons;
everything else is SI.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._numerics import safe_power


# Eq. 10 in ascending powers of the load; its exp^{-4} stands for 1e-4.
POLYNOMIALS = {
    "a": (0.74769, -0.01684, 0.0),
    "b": (-0.13056, -0.01728, 5.35714e-4),
    "c": (-1.04239, 0.00583, -4.07238e-4),
    "d": (0.010619, 0.01829, -7.75e-4),
    "e": (2.69364, -0.05815, 0.00712e-4),
}
SLIP_UNIT = 1e-3  # the polynomials take slip in mm
# Load from which the curve of Eqs. 9 and 10 grows without limit, 30.65 N: there b + |d| = b - d = 0, as d is negative.
DIVERGES_ABOVE = float(np.roots(np.subtract(POLYNOMIALS["b"], POLYNOMIALS["d"])[::-1]).max())
ADVISED_UP_TO = 30.0  # N: a round load below that one, where a load cell's error does not lead beyond it
CHANGES_SIGN_AT = -POLYNOMIALS["a"][0] / POLYNOMIALS["a"][1]  # load at which a(F_n) changes sign, 44.40 N


class SlipCoefficients(NamedTuple):
    """Coefficients of Eq. 9: a [-], b [1/mm], c [-], d [1/mm], e [-]."""

    a: Array
    b: Array
    c: Array
    d: Array
    e: Array


def composite_modulus(elastic_modulus: Array, poisson_ratio: Array) -> Array:
    r"""Modulus of rubber on something rigid, $E^* = E/(1 - \nu^2)$ [Pa]."""
    return elastic_modulus / (1.0 - poisson_ratio**2)


def rubber_coefficient(adhesion_constant: Array, loss_factor: Array, strength_ratio: Array, contour_pressure: Array,
                       modulus: Array) -> Array:
    r"""Friction coefficient of Eq. 8 [-]; the contour pressure $p_c$ is that of the gas [Pa].

    $\mu = \tan\delta_L\,[\frac{\pi}{4} K \sigma_0/p_r + \frac{\pi}{10} (3 p_c/E^*)^{2/3}]$ [-].
    """
    hysteresis = safe_power(3.0 * contour_pressure / modulus, jnp.asarray(2.0 / 3.0))
    return loss_factor * (jnp.pi / 4.0 * adhesion_constant * strength_ratio + jnp.pi / 10.0 * hysteresis)


def slip_coefficients(load: Array, printed: bool = False) -> SlipCoefficients:
    r"""Coefficients of Eq. 9 at a load [N] by the polynomials of Eq. 10, where exp$^{-4}$ stands for $10^{-4}$.

    $e = 1$ unless `printed`: the polynomial makes friction without any slip $a(1 - e)F_n$, negative below 29 N
    (row 5 of `ddetumble paper`).
    """
    a, b, c, d, e = (p + load * (q + load * r) for p, q, r in POLYNOMIALS.values())
    return SlipCoefficients(a, b, c, d, e if printed else jnp.ones_like(a))


def slip_coefficient(slip: Array, coefficients: SlipCoefficients) -> Array:
    r"""Slip term of Eq. 9 at a slip $s$ since the stroke began, not negative [m].

    $\mu_{slip}(s) = a + a e^{bs}[c \sinh(ds) - e \cosh(ds)]$ [-].
    """
    a, b, c, d, e = coefficients
    s = slip / SLIP_UNIT
    # sinh and cosh with the decaying exponential in them: no overflow where the product is moderate.
    up, down = jnp.exp((b + d) * s), jnp.exp((b - d) * s)
    return a + 0.5 * a * (c * (up - down) - e * (up + down))


def describe_range(load: float) -> str:
    """What is wrong with the slip term at a load [N], as a phrase; empty where nothing is."""
    if load > CHANGES_SIGN_AT:
        return f"a(F_n) of Eq. 10 is negative above {CHANGES_SIGN_AT:.1f} N, and the curve diverges with slip"
    if load > DIVERGES_ABOVE:
        return f"the curve of Eqs. 9 and 10 diverges with slip above {DIVERGES_ABOVE:.1f} N"
    return ""
