"""Effects on oblique impacts: how the contact patch of a rubber ball grips, where the normal force acts, the gauge."""

from typing import ClassVar, final

import jax.numpy as jnp

from ..contact.effect import AbstractEffect, Scalar, parameter
from ..contact.gripping import AbstractAxesEffect, AbstractComplianceEffect, AbstractReactionEffect, Patch


@final
class TangentialCompliance(AbstractComplianceEffect):
    r"""The patch grips on a tangential spring, $f = \xi/C$, until $\mu F_n$: friction can reverse within an impact."""

    compliance: Scalar = parameter("m/N", 0.0, typical=5e-5, sign=1, starts=(4e-6, 2e-5, 1e-4), bounds=(0.0, 1.0),
                                   singular=True, text="tangential compliance of the patch", limits=(0.0, 1e-2),
                                   limits_reason="about 1.4 times that along the normal (Mindlin): 1e-4 m/N at 1e4 N/m")
    id: ClassVar[str] = "tangential-compliance"
    law: ClassVar[str] = "the patch grips on a tangential spring until mu F_n, so friction can reverse"
    reference: ClassVar[str] = "Maw, Barber & Fawcett 1976, Wear 38, 101; Cross 2002, Am. J. Phys. 70, 1093"
    requires: ClassVar[tuple[str, ...]] = ("tangential",)

    def compliance_at(self, patch: Patch) -> Scalar:
        """C [m/N]."""
        return self.compliance * jnp.ones_like(patch.normal_force)


@final
class OffCentreReaction(AbstractReactionEffect):
    """The normal force acts ahead of the patch's centre by a share of b, against the rolling direction."""

    share: Scalar = parameter("", 0.0, typical=0.1, sign=1, starts=(0.1,), bounds=(-1.0, 1.0),
                              text="distance from the centre, in contact radii",
                              limits=(0.0, 1.0), limits_reason="the normal force acts within the patch")
    id: ClassVar[str] = "off-centre-reaction"
    law: ClassVar[str] = "the normal force acts ahead of the patch's centre by a share of b, the contact radius"
    reference: ClassVar[str] = "Cross 2014, Am. J. Phys. 82, 1020"
    requires: ClassVar[tuple[str, ...]] = ("tangential", "geometry")

    def offset_at(self, patch: Patch) -> Scalar:
        """share * b [m]."""
        return self.share * patch.contact_radius


@final
class SensorCrosstalk(AbstractAxesEffect):
    r"""Each axis of the gauge reads a share of the other: $F_t + c_{tn} F_n$ and $F_n + c_{nt} F_t$."""

    c_tn: Scalar = parameter("", 0.0, typical=0.01, bounds=(-1.0, 1.0), starts=(0.01,),
                             text="share of the normal force in the tangential reading", limits=(-0.2, 0.2),
                             limits_reason="gauges of several axes have up to 0.05; one turned by 10 degrees has 0.18")
    # Hardly any campaign shows it: a tenth of friction in the normal force, mass and pressures imitate.
    c_nt: Scalar = parameter("", 0.0, typical=0.02, bounds=(-1.0, 1.0), starts=(0.01,), free=False,
                             text="share of the tangential force in the normal reading", limits=(-0.2, 0.2),
                             limits_reason="gauges of several axes have up to 0.05; one turned by 10 degrees has 0.18")
    id: ClassVar[str] = "sensor-crosstalk"
    law: ClassVar[str] = "measured F_t + c_tn F_n and F_n + c_nt F_t"
    reference: ClassVar[str] = "ISO 21612:2021, crosstalk of multi-axis load cells"
    requires: ClassVar[tuple[str, ...]] = ("tangential",)

    def read_axes(self, normal_force: Scalar, tangential_force: Scalar) -> tuple[Scalar, Scalar]:
        """F_n + c_nt F_t and F_t + c_tn F_n [N]."""
        return normal_force + self.c_nt * tangential_force, tangential_force + self.c_tn * normal_force


OBLIQUE: tuple[type[AbstractEffect], ...] = (TangentialCompliance, OffCentreReaction, SensorCrosstalk)
