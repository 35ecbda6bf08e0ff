"""Effects of the gas: how it expands, what surrounds it, where it goes."""

from typing import ClassVar, final

import jax.numpy as jnp

from ..contact.effect import (
    AbstractElasticEffect,
    AbstractGasEffect,
    AbstractStatefulEffect,
    Contact,
    Scalar,
    parameter,
)


@final
class PolytropicGas(AbstractGasEffect):
    r"""Gas that is not isothermal: $P' = P_0 (V_0/V')^n$."""

    n: Scalar = parameter("", 1.0, typical=0.3, sign=1, bounds=(-3.0, 6.0), starts=(1.4,), text="polytropic exponent",
                          limits=(0.9, 1.7),
                          limits_reason="isothermal 1, adiabatic air 1.4, adiabatic monatomic gas 5/3; below 1 it "
                                        "would be heated as it expands")
    id: ClassVar[str] = "polytropic-gas"
    law: ClassVar[str] = "P' = P0 (V0/V')^n"
    reference: ClassVar[str] = "ideal gas; Eq. 3 is n = 1, adiabatic air is n = 1.4"
    requires: ClassVar[tuple[str, ...]] = ("gas",)

    def pressure_factor(self, contact: Contact) -> Scalar:
        """(V0/V')^(n - 1)."""
        return jnp.exp((self.n - 1.0) * jnp.log(contact.volume_ratio))


@final
class AmbientPressure(AbstractElasticEffect):
    r"""The atmosphere pushes back on the contact disc: $F_k = (P' - p_a) \pi b^2$."""

    p_a: Scalar = parameter("Pa", 0.0, typical=1e5, sign=1, starts=(1.0e5,), text="ambient pressure",
                            limits=(0.0, 1.2e5),
                            limits_reason="from vacuum to the highest pressure at sea level, 1.085e5 Pa")
    id: ClassVar[str] = "ambient-pressure"
    law: ClassVar[str] = "F_k = (P' - p_a) pi b^2"
    reference: ClassVar[str] = "force balance on the contact disc; Eq. 4 is p_a = 0 (vacuum)"
    requires: ClassVar[tuple[str, ...]] = ("gas", "geometry")

    def force(self, contact: Contact) -> Scalar:
        """-p_a pi b^2 [N]."""
        return -self.p_a * contact.contact_area


@final
class GasLeak(AbstractGasEffect, AbstractStatefulEffect):
    r"""Gas lost during contact: $dm/dt = -\lambda m$, $P' = P_0\,m\,(V_0/V')^n$."""

    leak_rate: Scalar = parameter("1/s", 0.0, name="lambda", typical=3.0, sign=1, bounds=(-30.0, 500.0),
                                  starts=(4.0,), text="rate at which gas is lost in contact",
                                  limits=(0.0, 150.0),
                                  limits_reason="choked flow of air through a hole of 10 mm empties the paper's ball "
                                                "by 140 a second")
    id: ClassVar[str] = "gas-leak"
    law: ClassVar[str] = "dm/dt = -lambda m in contact, m(0) = 1, P' = P0 m (V0/V')^n"
    reference: ClassVar[str] = "outflow through a leak or a valve; the paper names leakage of its end-effector"
    requires: ClassVar[tuple[str, ...]] = ("gas",)

    def pressure_factor(self, contact: Contact) -> Scalar:
        """The gas fraction m that is left."""
        return contact.state

    def initial(self) -> Scalar:
        """m(0) = 1."""
        return jnp.ones(())

    def rate(self, contact: Contact) -> Scalar:
        """-lambda m [1/s]."""
        return -self.leak_rate * contact.state

    def size(self, contact: Contact) -> Scalar:
        """1."""
        return jnp.ones(())
