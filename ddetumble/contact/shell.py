"""The ball's wall: a thick-walled rubber sphere under pressure, its stiffness under a plate, and the model of both."""

from typing import Any, final

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .effect import Contact, Scalar, parameter
from .geometry import contact_radius, racetrack_volume, sphere_volume
from .law import AbstractBall


def inflation_pressure(stretch: Array, ratio: Array, shear_modulus: Array) -> Array:
    r"""Pressure [Pa] that holds a neo-Hookean sphere at an inner stretch $\lambda_a$, inner radius over that at rest.

    $P = \frac{\mu}{2} [4\lambda_b^{-1} + \lambda_b^{-4} - 4\lambda_a^{-1} - \lambda_a^{-4}]$ with the outer stretch
    $\lambda_b^3 = 1 + \rho^3 (\lambda_a^3 - 1)$ of an incompressible wall (Ogden, Non-Linear Elastic Deformations,
    section 5.3.2). A thin wall of thickness t and radius R has $2\mu (t/R)(\lambda^{-1} - \lambda^{-7})$.

    Args:
        stretch: $\lambda_a$, above 0 [-].
        ratio: inner over outer radius at rest, $\rho$ [-].
        shear_modulus: $\mu$ [Pa], E/3 of incompressible rubber.
    """
    outer = jnp.cbrt(1.0 + ratio**3 * (stretch**3 - 1.0))
    return 0.5 * shear_modulus * (4.0 / outer + outer**-4 - 4.0 / stretch - stretch**-4)


def limit_pressure(ratio: float, shear_modulus: float) -> tuple[float, float]:
    r"""Largest pressure [Pa] that a neo-Hookean sphere of inner over outer radius `ratio` holds, and its inner stretch.

    Above it the sphere runs away: $P(\lambda_a)$ of `inflation_pressure` has its maximum there. A thin wall has it at
    $\lambda = 7^{1/6}$; the thicker the wall, the larger the stretch, and the closer the pressure comes to 2.5 times
    the shear modulus.
    """
    from scipy.optimize import minimize_scalar

    def lose(logarithm):
        return -float(inflation_pressure(jnp.exp(logarithm), jnp.asarray(ratio), jnp.asarray(1.0)))

    # One maximum; a wall that fills nearly the whole sphere has it at a stretch of about 2/ratio.
    found: Any = minimize_scalar(lose, bounds=(0.0, float(np.log(10.0 / min(ratio, 1.0)))), method="bounded",
                            options={"xatol": 1e-10})
    return -float(found.fun) * shear_modulus, float(np.exp(found.x))


def shell_stiffness(thickness: Array, radius: Array, elastic_modulus: Array, poisson_ratio: Array) -> Array:
    r"""Force over depression [N/m] of a spherical shell under a load at one point, without pressure.

    $k = 4 E t^2/(R \sqrt{3 (1 - \nu^2)})$ (Reissner, J. Math. Phys. 25, 279, 1946), for depressions below the
    thickness t of a thin shell with mid-radius R [m]; a wall of a third of the radius is stiffer.
    """
    return 4.0 * elastic_modulus * thickness**2 / (radius * jnp.sqrt(3.0 * (1.0 - poisson_ratio**2)))


@final
class InflatedShell(AbstractBall):
    r"""A rubber shell with gas inside: $F_k = P' \pi b^2 + k_s \delta$, $b = \pi\delta/4$, from Table 2 alone.

    The gas fills the cavity, $P' = P_0 V_0/V'$ with the volumes of Eq. 2 for the inner diameter, and the wall stands
    beside it with `shell_stiffness` at its middle radius. That the pressure inflates the ball is left out:
    `limit_pressure` says up to where it could.
    """

    inner_diameter: Scalar = parameter(
        "m", 0.040, kind="reference", typical=0.01, coordinate="log", bounds=(0.0, jnp.inf), free=False,
        text="diameter of its cavity", limits=(1e-4, 10.0), limits_reason="it lies within the ball")
    elastic_modulus: Scalar = parameter(
        "Pa", 7.8e6, kind="reference", typical=5e6, coordinate="log", bounds=(0.0, jnp.inf), free=False,
        text="Young's modulus of the wall", limits=(1e4, 1e10), limits_reason="from a gel to a hard plastic")
    poisson_ratio: Scalar = parameter(
        "", 0.47, kind="reference", typical=0.05, bounds=(0.0, 0.5), free=False, text="Poisson's ratio of the wall",
        limits=(0.0, 0.5), limits_reason="a solid that keeps its volume has one half")

    def shape(self, depression: Array, diameter: Array, increment) -> tuple[Array, Array]:
        """Contact radius, and volume ratio of the cavity."""
        cavity = self.inner_diameter * diameter / self.outer_diameter  # effects may change the size of the whole
        radius = contact_radius(depression, jnp.asarray(jnp.pi / 4))
        radius = radius + increment(radius)
        half_height = jnp.maximum(0.5 * (cavity - depression), 1e-6 * cavity)  # squeezed flat it stays a number
        return radius, sphere_volume(cavity) / racetrack_volume(radius, half_height)

    def elastic(self, contact: Contact) -> Scalar:
        """F_k of gas and wall side by side [N]."""
        thickness = 0.5 * (self.outer_diameter - self.inner_diameter)
        stiffness = shell_stiffness(thickness, 0.5 * (self.outer_diameter - thickness), self.elastic_modulus,
                                    self.poisson_ratio)
        return contact.pressure * contact.contact_area + stiffness * contact.depression
