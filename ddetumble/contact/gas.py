"""Gas in the ball: pressure as its volume changes (Eq. 3)."""

import jax.numpy as jnp
from jaxtyping import Array


def gas_pressure(initial_pressure: Array, volume_ratio: Array, exponent: Array, gas_fraction: Array) -> Array:
    r"""Absolute pressure of the enclosed gas, $P' = P_0\, m\, (V_0/V')^n$.

    Eq. 3 is the isothermal case $n = 1$ with nothing lost, $m = 1$.

    Args:
        initial_pressure: $P_0$ [Pa, absolute].
        volume_ratio: $V_0/V'$ [-], > 0.
        exponent: polytropic exponent $n$ [-].
        gas_fraction: share $m$ of the gas still in the ball [-].

    Returns:
        $P'$ [Pa].
    """
    return initial_pressure * gas_fraction * jnp.exp(exponent * jnp.log(volume_ratio))
