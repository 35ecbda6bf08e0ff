"""An effect of one's own: beyond some depression the ball sits on its rim, which pushes back too."""

from typing import ClassVar

import jax.numpy as jnp

import ddetumble as dd


class EndStop(dd.effects.AbstractElasticEffect):
    """F_k gains k (delta - depth)^1.5 beyond `depth`."""

    k: float = dd.effects.parameter("N/m^1.5", 0.0, typical=1e5, sign=1, starts=(1e5,), text="stiffness of the rim")
    depth: float = dd.effects.parameter("m", 5e-3, kind="shape", typical=1e-3, coordinate="log", starts=(4e-3, 6e-3))
    id: ClassVar[str] = "end-stop"
    law: ClassVar[str] = "F_k gains k (delta - depth)^1.5"
    reference: ClassVar[str] = "Hertz, for the power"

    def force(self, contact):
        """k (delta - depth)^1.5 [N]."""
        return self.k * jnp.maximum(contact.depression - self.depth, 0.0) ** 1.5
