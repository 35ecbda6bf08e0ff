"""Effects of the touching surfaces."""

from typing import ClassVar, final

import jax.numpy as jnp

from ..contact.effect import AbstractSurfaceForce, Contact, Scalar, parameter


UNLOADING_SPEED = 5e-3  # width of the change from loading to unloading [m/s]


@final
class Adhesion(AbstractSurfaceForce):
    r"""The disc sticks while it unloads: $F_n$ loses $\tau_a \pi b^2 \cdot \frac12 (1 - \tanh(w/5\,\mathrm{mm/s}))$."""

    tau_a: Scalar = parameter("Pa", 0.0, typical=2e4, sign=1, starts=(2e4,), text="adhesive stress",
                              limits=(0.0, 1e6), limits_reason="tack of rubber is some 0.1 to 1 MPa")
    id: ClassVar[str] = "adhesion"
    law: ClassVar[str] = "F_n loses tau_a pi b^2 (1 - tanh(w / 5 mm/s))/2: tension is possible"
    reference: ClassVar[str] = "adhesion hysteresis of rubber: work is needed to separate, none is gained in touching"
    requires: ClassVar[tuple[str, ...]] = ("geometry",)

    def force(self, contact: Contact) -> Scalar:
        """-tau_a pi b^2 (1 - tanh(w / 5 mm/s))/2 [N]."""
        unloading = 0.5 * (1.0 - jnp.tanh(contact.depression_rate / UNLOADING_SPEED))
        return -self.tau_a * contact.contact_area * unloading
