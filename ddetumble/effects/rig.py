"""Effects of the rig: the arm that pushes, and restitution that changes with the conditions."""

from typing import ClassVar, final

import jax.numpy as jnp

from .._numerics import safe_power
from ..contact.effect import AbstractDriveEffect, AbstractRestitutionEffect, Contact, Scalar, parameter


REFERENCE_SPEED = 0.4  # m/s
REFERENCE_PRESSURE = 1e6  # Pa


@final
class ArmServo(AbstractDriveEffect):
    r"""The arm keeps following its command: $m_{eff} dw/dt$ gains $k_s (v_1 t - \delta)$."""

    k_s: Scalar = parameter("N/m", 0.0, typical=200.0, sign=1, starts=(200.0,), text="stiffness of the arm's servo",
                            limits=(0.0, 1e6),
                            limits_reason="it follows its command; the stiffest arms reach some 1e6 N/m")
    id: ClassVar[str] = "arm-servo"
    law: ClassVar[str] = "m_eff dw/dt gains k_s (v1 t - delta)"
    reference: ClassVar[str] = "position-controlled arm; physics.md section 3, row 9"

    def force(self, contact: Contact) -> Scalar:
        """k_s (v1 t - delta) [N]."""
        return self.k_s * (contact.approach_speed * contact.time - contact.depression)


@final
class SpeedDependentRestitution(AbstractRestitutionEffect):
    r"""$e = e_0 (v_1 / 0.4\,\mathrm{m/s})^{-p}$."""

    p: Scalar = parameter("", 0.0, typical=0.1, bounds=(-2.0, 2.0), starts=(0.1,), text="power of the approach speed",
                          limits=(-0.5, 0.5),
                          limits_reason="plastic impact has 1/4 (Johnson 1985); adhesion at low speed makes it "
                                        "negative")
    id: ClassVar[str] = "speed-dependent-restitution"
    law: ClassVar[str] = "e = e0 (v1 / 0.4 m/s)^(-p)"
    reference: ClassVar[str] = "restitution of rubber falls with speed (Goldsmith, Impact, 1960)"
    requires: ClassVar[tuple[str, ...]] = ("damping",)

    def factor(self, contact: Contact) -> Scalar:
        """(v1 / 0.4 m/s)^(-p)."""
        return jnp.exp(-self.p * jnp.log(contact.approach_speed / REFERENCE_SPEED))


@final
class PressureDependentRestitution(AbstractRestitutionEffect):
    r"""$e = e_0 (P_0 / 1\,\mathrm{MPa})^{-p}$."""

    p: Scalar = parameter("", 0.0, typical=0.1, bounds=(-2.0, 2.0), starts=(0.1,), text="power of the pressure",
                          limits=(-1.0, 1.0),
                          limits_reason="at 1 restitution falls as 1/pressure, 2.5 times from 1 to 2.5 MPa")
    id: ClassVar[str] = "pressure-dependent-restitution"
    law: ClassVar[str] = "e = e0 (P0 / 1 MPa)^(-p)"
    reference: ClassVar[str] = "the share of the wall in the losses changes with inflation"
    requires: ClassVar[tuple[str, ...]] = ("damping", "gas")

    def factor(self, contact: Contact) -> Scalar:
        """(P0 / 1 MPa)^(-p); 1 where there is no pressure."""
        some = contact.initial_pressure > 0
        return jnp.where(some, safe_power(contact.initial_pressure / REFERENCE_PRESSURE, -self.p), 1.0)
