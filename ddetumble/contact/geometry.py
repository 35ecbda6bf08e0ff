"""Shape of the squeezed ball: contact radius, contact area and enclosed volume (Eqs. 1 and 2)."""

import jax.numpy as jnp
from jaxtyping import Array

from .._numerics import positive_part, safe_sqrt


def contact_radius(depression: Array, coefficient: Array) -> Array:
    r"""Radius of the flat contact disc, $b = \beta_c \delta$ [m], of a depression [m] and a coefficient [-].

    A cross-section of constant perimeter, $\pi D = \pi d + 4 b$ with $d = D - \delta$, gives $\beta_c = \pi/4$; Eq. 7
    as printed needs $\beta_c = 1/4$.
    """
    return coefficient * depression


def membrane_area_radius(depression: Array, diameter: Array) -> Array:
    r"""Contact radius [m] that keeps the membrane's area: $2b^2 + \pi b d + d^2 = D^2$ (catalogue, `membrane-area`).

    Of depression and diameter, $b = (-\pi d + \sqrt{\pi^2 d^2 + 8 (D^2 - d^2)})/4$, written so that nothing cancels.
    """
    d = diameter - depression
    excess = depression * (diameter + d)
    root = jnp.sqrt(jnp.pi**2 * d**2 + 8.0 * excess)
    return 2.0 * excess / (root + jnp.pi * d)


def racetrack_volume(radius: Array, half_height: Array, doubled_core: bool = False) -> Array:
    r"""Volume [m³] of the solid of revolution of a racetrack (Eq. 2), of $b$ and $r = d/2$ [m].

    $V' = 2\pi \int_0^{r} (b + \sqrt{r^2 - y^2})^2 dy = 2\pi (b^2 r + \pi b r^2/2 + 2 r^3/3)$; `doubled_core` adds $\pi
    b^2 d$ as Eq. 2 prints it, although the integral already holds that cylinder.
    """
    b, r = radius, half_height
    volume = 2.0 * jnp.pi * (b**2 * r + jnp.pi * b * r**2 / 2.0 + 2.0 * r**3 / 3.0)
    return volume + (2.0 * jnp.pi * b**2 * r if doubled_core else 0.0)


def sphere_volume(diameter: Array) -> Array:
    r"""$V_0 = \pi D^3/6$ [m³]."""
    return jnp.pi * diameter**3 / 6.0


def truncated_sphere_radius(depression: Array, diameter: Array) -> Array:
    r"""Contact radius [m] of a sphere cut by a plane, $b = \sqrt{\delta (D - \delta)}$ (Matunaga, Eq. 1), or 0."""
    return safe_sqrt(positive_part(depression) * (diameter - depression))
