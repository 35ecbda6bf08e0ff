"""A cart on soft pads: a plain spring as reference, and what the catalogue lacks of damping and of bottoming out."""

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array

from ddetumble._numerics import safe_power
from ddetumble.contact.effect import AbstractElasticEffect, AbstractStiffnessEffect, Scalar, parameter
from ddetumble.contact.law import AbstractReference


REFERENCE = 0.04  # m, the thickness at which `stiffness_force` holds


class PadSpring(AbstractReference):
    r"""A spring without any loss.

    $F = F_{50} (\delta/50\,\mathrm{mm})^n (h/40\,\mathrm{mm})^\beta$ with the thickness h of the pad.
    """

    effective_mass: Scalar = parameter("kg", 0.55, kind="reference", typical=0.3, coordinate="log",
                                       bounds=(0.0, jnp.inf), text="mass of the cart")
    stiffness_force: Scalar = parameter("N", 4.0, kind="reference", typical=2.0, coordinate="log",
                                        bounds=(0.0, jnp.inf), text="force at 50 mm on the pad of 40 mm")
    exponent: Scalar = parameter("", 1.2, kind="reference", typical=0.5, coordinate="log", bounds=(0.5, 6.0),
                                 text="power of the depression")
    thickness_exponent: Scalar = parameter("", 0.0, kind="reference", typical=0.3, text="power of the thickness")
    provides: ClassVar[tuple[str, ...]] = ()

    def elastic(self, contact) -> Scalar:
        """Force of the spring [N]."""
        ratio = contact.conditions["pad_thickness"] / REFERENCE
        return (self.stiffness_force * safe_power(contact.depression / 0.05, self.exponent)
                * safe_power(ratio, self.thickness_exponent))

    def inertia(self) -> Scalar:
        """Mass of the cart [kg]."""
        return self.effective_mass

    def rebound(self) -> Scalar:
        """No loss: 1."""
        return jnp.ones(())

    def damping(self, restitution: Array, approach_speed: Array) -> Scalar:
        """None."""
        return jnp.zeros(())


class FoamDamping(AbstractStiffnessEffect):
    """The whole elastic force times 1 + c w: Hunt and Crossley's damping, c the same at all speeds."""

    c: float = parameter("s/m", 0.0, typical=0.1, sign=1, starts=(0.1,), text="damping over elastic force and rate")
    id: ClassVar[str] = "foam-damping"
    law: ClassVar[str] = "F_k times 1 + c w"
    reference: ClassVar[str] = "Hunt and Crossley 1975, J. Appl. Mech. 42, 440"

    def factor(self, contact):
        """1 + c w [-]."""
        return 1.0 + self.c * contact.depression_rate


class PadBottom(AbstractElasticEffect):
    """Beyond a depression that grows with the pad's thickness the cart sits on what is behind it."""

    k: float = parameter("N/m", 0.0, typical=200.0, sign=1, starts=(300.0, 1500.0), text="stiffness behind the pad")
    depth: float = parameter("m", 0.06, kind="shape", typical=0.01, coordinate="log",
                             starts=(0.03, 0.04, 0.05, 0.06, 0.07), text="onset with no pad at all")
    share: float = parameter("", 0.5, kind="shape", typical=0.3, starts=(0.5,), text="onset gained over thickness")
    requires: ClassVar[tuple[str, ...]] = ("pad_thickness",)
    id: ClassVar[str] = "pad-bottom"
    law: ClassVar[str] = "F_k gains k (delta - depth - share h)+"
    reference: ClassVar[str] = "Hooke, for what is behind the pad"

    def force(self, contact):
        """K (delta - depth - share h) beyond it [N]."""
        onset = self.depth + self.share * contact.conditions["pad_thickness"]
        return self.k * jnp.maximum(contact.depression - onset, 0.0)


EFFECTS = (FoamDamping, PadBottom)
