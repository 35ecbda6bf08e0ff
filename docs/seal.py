"""The seal of a pneumatic cylinder: force = pressure x area, and what the catalogue lacks of its friction.

Of one stroke the rod's force is direction * law.force(slide): what turns with the motion is friction, and the thrust,
which does not, carries the direction itself. `normal_load` is gauge pressure x nominal area of the bore. The constant
part of the seal's friction (Coulomb) is in the catalogue already: `adhesive-offset`, friction without load.
"""

from typing import ClassVar

import jax.numpy as jnp

from ddetumble.contact.sliding import AbstractFriction, AbstractFrictionForce
from ddetumble.effects import parameter


class PressureThrust(AbstractFriction):
    """The gas pushes on the piston: pressure x area, and no friction at all."""

    area_factor: float = parameter("", 1.0, kind="reference", typical=0.01, text="effective over nominal area")
    provides: ClassVar[tuple[str, ...]] = ()

    def rubber(self, slide):
        """No friction [-]."""
        return jnp.zeros_like(slide.slip)

    def slipping(self, slide):
        """Thrust over nominal thrust [-]; the same way whichever way the seal slides."""
        return slide.direction * self.area_factor


class SealLoad(AbstractFrictionForce):
    """The gas presses the ring against the bore: f gains mu p A."""

    mu: float = parameter("", 0.0, typical=0.01, sign=1, starts=(0.01,), text="friction over thrust")
    id: ClassVar[str] = "seal-load"
    law: ClassVar[str] = "f gains mu p A"
    reference: ClassVar[str] = "Schallamach 1952, Proc. Phys. Soc. B 65, 657, for friction in proportion to load"

    def force(self, slide):
        """Mu p A [N]."""
        return self.mu * slide.normal_load


class SealLag(AbstractFrictionForce):
    """After a turn the ring first deforms and slides late: f loses (a + b p A) exp(-s/s_0)."""

    a: float = parameter("N", 0.0, typical=1.0, sign=1, starts=(4.0,), text="friction missing at the turn")
    b: float = parameter("", 0.0, typical=0.01, starts=(0.01,), text="the same over thrust")
    s_0: float = parameter("m", 4e-4, kind="shape", typical=2e-4, coordinate="log", starts=(2e-4, 6e-4),
                           bounds=(1e-5, 0.1), text="slip over which friction builds up")
    id: ClassVar[str] = "seal-lag"
    law: ClassVar[str] = "f loses (a + b p A) exp(-s/s_0), s since the turn"
    reference: ClassVar[str] = "Dahl 1968, Aerospace Corp. TOR-0158(3107-18)-1"

    def force(self, slide):
        """-(a + b p A) exp(-s/s_0) [N]."""
        return -(self.a + self.b * slide.normal_load) * jnp.exp(-slide.slip / self.s_0)


class ThrustOffset(AbstractFrictionForce):
    """A force that neither pressure nor motion turns: weight of the rod, zero of a gauge."""

    F_0: float = parameter("N", 0.0, typical=1.0, starts=(1.0,), text="force at no pressure and no friction")
    id: ClassVar[str] = "thrust-offset"
    law: ClassVar[str] = "the force gains F_0, whichever way the seal slides"
    reference: ClassVar[str] = "Newton, for the weight; zero error of force or pressure gauge"

    def force(self, slide):
        """F_0 against or with the motion [N]."""
        return slide.direction * self.F_0


EFFECTS = (SealLoad, SealLag, ThrustOffset)
