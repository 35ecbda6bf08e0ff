"""Gas in the ball: pressure as its volume changes (Eq. 3)."""

import jax.numpy as jnp
from jaxtyping import Array


def gas_pressure(initial_pressure: Array, volume_ratio: Array, exponent: Array, gas_fraction: Array) -> Array:
    r"""Absolute pressure of the enclosed gas, $P' = P_0\, m\, (V_0/V')^n$ [Pa]; Eq. 3 is isothermal, $n = m = 1$.

    $P_0$ absolute [Pa], volume ratio $V_0/V'$ > 0 [-], polytropic exponent $n$ [-], share $m$ of the gas left [-].
    """
    return initial_pressure * gas_fraction * jnp.exp(exponent * jnp.log(volume_ratio))
