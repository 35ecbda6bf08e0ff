"""rim-stop: a first guess at what sits beyond 6 mm: a plain spring. From `ddetumble effects --new rim-stop`."""

from typing import ClassVar

import jax.numpy as jnp

from ddetumble.effects import AbstractElasticEffect, parameter


class RimStop(AbstractElasticEffect):
    """F_k gains k (delta - depth) beyond `depth`."""

    k: float = parameter("N/m", 0.0, typical=1e4, sign=1, starts=(1e4,), text="stiffness of the rim")
    depth: float = parameter("m", 5e-3, kind="shape", typical=1e-3, coordinate="log", starts=(4e-3, 6e-3), text="onset")
    id: ClassVar[str] = "rim-stop"
    law: ClassVar[str] = "F_k gains k (delta - depth)"
    reference: ClassVar[str] = "a guess"

    def force(self, contact):
        """k (delta - depth) [N]."""
        return self.k * jnp.maximum(contact.depression - self.depth, 0.0)
