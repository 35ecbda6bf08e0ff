"""Effects of the rubber wall: its stiffness, its memory, its stretch, its shape."""

from typing import ClassVar, final

import jax.numpy as jnp

from .._numerics import safe_power
from ..contact.effect import (
    AbstractContactForce,
    AbstractElasticEffect,
    AbstractGeometryEffect,
    AbstractSizeEffect,
    AbstractStatefulEffect,
    AbstractStiffnessEffect,
    Contact,
    Scalar,
    parameter,
)
from ..contact.geometry import membrane_area_radius


WALL_MODULUS = 7.8e6  # Table 2, E of the rubber [Pa]


@final
class WallStiffness(AbstractElasticEffect):
    r"""The wall carries load beside the gas: $F_k$ gains $k_w \delta^q$."""

    k_w: Scalar = parameter("N/m^q", 0.0, typical=1000.0, sign=1, starts=(1000.0,), text="stiffness of the wall",
                            limits=(0.0, float("inf")),
                            limits_reason="it resists; how stiff a wall may be has no bound, and the unit changes "
                                          "with q")
    q: Scalar = parameter("", 1.0, kind="shape", typical=0.5, bounds=(0.5, 4.0), coordinate="log", free=False,
                          text="power of the depression",
                          limits=(0.5, 3.0),
                          limits_reason="a dimple of a thin shell 1/2, bending 1, Hertz 3/2, a stretched membrane 3")
    id: ClassVar[str] = "wall-stiffness"
    law: ClassVar[str] = "F_k gains k_w delta^q"
    reference: ClassVar[str] = "bending and membrane stiffness of an inflated shell in parallel with its gas"

    def force(self, contact: Contact) -> Scalar:
        """k_w delta^q [N]."""
        return self.k_w * safe_power(contact.depression, self.q)


@final
class MembraneArea(AbstractGeometryEffect):
    r"""A membrane that keeps its area, not its perimeter: $b = (1-\alpha) b_{perimeter} + \alpha b_{area}$."""

    alpha: Scalar = parameter("", 0.0, typical=0.3, sign=1, bounds=(-1.5, 2.5), starts=(0.3,),
                              text="0: constant perimeter, 1: constant area",
                              limits=(0.0, 1.25),
                              limits_reason="0 keeps the perimeter, 1 the area; well beyond 1 the membrane would "
                                            "have to shrink")
    id: ClassVar[str] = "membrane-area"
    law: ClassVar[str] = "b = (1 - alpha) b_perimeter + alpha b_area, 2 b_area^2 + pi b_area d + d^2 = D^2"
    reference: ClassVar[str] = "inextensible membrane; physics.md section 3, row 3"
    requires: ClassVar[tuple[str, ...]] = ("geometry",)

    def contact_radius(self, contact: Contact) -> Scalar:
        """alpha (b_area - b_perimeter) [m]."""
        area = membrane_area_radius(contact.depression, contact.outer_diameter)
        return self.alpha * (area - contact.contact_radius)


@final
class InflationGrowth(AbstractSizeEffect):
    r"""Inflation stretches the ball: $D \to D (1 + \beta P_0/E)$."""

    beta: Scalar = parameter("", 0.0, typical=0.3, sign=1, starts=(0.4,), bounds=(-2.0, 5.0),
                             text="growth per P0/E, E = 7.8 MPa",
                             limits=(0.0, 1.6),
                             limits_reason="thin sphere, (1 - nu) r/(2 t): 0.8 for the wall of Table 2, 1.6 for one "
                                           "half as thick")
    id: ClassVar[str] = "inflation-growth"
    law: ClassVar[str] = "D -> D (1 + beta P0/E)"
    reference: ClassVar[str] = "thin-walled pressure vessel; E from Table 2"
    requires: ClassVar[tuple[str, ...]] = ("gas", "geometry")

    def growth(self, contact: Contact) -> Scalar:
        """beta P0/E [-]."""
        return self.beta * contact.initial_pressure / WALL_MODULUS


@final
class ViscoelasticWall(AbstractContactForce, AbstractStatefulEffect):
    r"""A Maxwell branch of the rubber: $F_n$ gains $q$, $dq/dt = k_v w - q/\tau$."""

    k_v: Scalar = parameter("N/m", 0.0, typical=2000.0, sign=1, starts=(1500.0,),
                            text="stiffness of the Maxwell branch",
                            limits=(0.0, 1e6),
                            limits_reason="it resists; at 1e6 N/m one millimetre would take a kilonewton")
    tau: Scalar = parameter("s", 5e-3, kind="shape", typical=3e-3, bounds=(5e-4, 2.0), coordinate="log",
                            starts=(1.5e-3, 6e-3, 2.5e-2), text="relaxation time",
                            limits=(1e-6, 1e4), limits_reason="rubber relaxes over microseconds to hours")
    id: ClassVar[str] = "viscoelastic-wall"
    law: ClassVar[str] = "F_n gains q: dq/dt = k_v w - q/tau in contact"
    reference: ClassVar[str] = "Maxwell element (standard linear solid with the gas spring)"

    def force(self, contact: Contact) -> Scalar:
        """q [N]."""
        return contact.state

    def initial(self) -> Scalar:
        """q(0) = 0."""
        return jnp.zeros(())

    def rate(self, contact: Contact) -> Scalar:
        """k_v w - q/tau [N/s]."""
        return self.k_v * contact.depression_rate - contact.state / self.tau

    def size(self, contact: Contact) -> Scalar:
        """10 N."""
        return 10.0 * jnp.ones(())


@final
class ViscousDashpot(AbstractContactForce):
    r"""A linear dashpot beside the spring: $F_n$ gains $c_v w$."""

    c_v: Scalar = parameter("N s/m", 0.0, typical=5.0, sign=1, starts=(5.0,), text="dashpot constant",
                            limits=(0.0, 1e3),
                            limits_reason="it resists; 1.2 kg on 1e4 N/m, damped by more than 220 N s/m, would not "
                                          "rebound")
    id: ClassVar[str] = "viscous-dashpot"
    law: ClassVar[str] = "F_n gains c_v w in contact"
    reference: ClassVar[str] = "Kelvin-Voigt contact; the force jumps at first touch"

    def force(self, contact: Contact) -> Scalar:
        """c_v w [N]."""
        return self.c_v * contact.depression_rate


@final
class StressSoftening(AbstractStiffnessEffect):
    r"""Rubber softens over a series (Mullins): $F_k$ times $1 - \sigma_m (1 - e^{-(j-1)/j_0})$ at the $j$-th impact."""

    sigma_m: Scalar = parameter("", 0.0, typical=0.1, sign=1, bounds=(-1.0, 0.95), starts=(0.1,),
                                text="share of the stiffness lost in a long series",
                                limits=(0.0, 0.9),
                                limits_reason="filled rubber loses up to some nine tenths of its stiffness (Mullins)")
    j_0: Scalar = parameter("", 3.0, kind="shape", typical=2.0, bounds=(0.1, 300.0), coordinate="log",
                            starts=(1.5, 5.0, 15.0), text="impacts until it has softened by 63 %",
                            limits=(0.3, 100.0),
                            limits_reason="rubber softens in the first few impacts, within some tens at the latest")
    id: ClassVar[str] = "stress-softening"
    law: ClassVar[str] = "F_k times 1 - sigma_m (1 - exp(-(j - 1)/j_0)) at the j-th impact of a series"
    reference: ClassVar[str] = "Mullins effect of filled rubber"
    requires: ClassVar[tuple[str, ...]] = ("sequence",)

    def factor(self, contact: Contact) -> Scalar:
        """1 - sigma_m (1 - exp(-(j - 1)/j_0)) [-]."""
        number = contact.conditions["sequence"] - 1.0
        return 1.0 + self.sigma_m * jnp.expm1(-number / self.j_0)
