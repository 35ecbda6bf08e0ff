"""Hunt-Crossley damping and the restitution that it really gives (Eqs. 5 and 6)."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array


_SERIES = 12  # terms: below the argument that follows, the rest is under rounding
_SMALL = 0.04  # argument below which the series is used: the closed form loses digits there to a difference


def damped_work(x: Array) -> Array:
    r"""$(x - \ln(1 + x))/x^2$, by its series near zero: half at 0, and less where damping takes a part of it.

    With $\kappa = c_n v_1$ the work of the spring alone while the rate falls from $v_1$ to $s v_1$ is
    $m v_1^2 (\phi(\kappa) - s^2 \phi(\kappa s))$, for any spring law.
    """
    small = jnp.abs(x) < _SMALL
    inside = jnp.where(small, x, 0.0)
    series = jnp.zeros_like(inside)
    for k in range(_SERIES, -1, -1):
        series = series * (-inside) + 1.0 / (k + 2)
    safe = jnp.where(small, 1.0, x)
    return jnp.where(small, series, (safe - jnp.log1p(safe)) / safe**2)


def restitution_balance(kappa: Array, restitution: Array) -> Array:
    r"""Zero where a dimensionless damping $\kappa = c_n v_1$ realises the restitution $e$.

    The closed form $\kappa - \ln(1+\kappa) = -\kappa e - \ln(1 - \kappa e)$ divided by $\kappa^2$, so that it stays
    regular at $\kappa = 0$ (where $e = 1$).
    """
    return damped_work(kappa) - restitution**2 * damped_work(-kappa * restitution)


def _bisect(function: Callable[[Array], Array], high: Array, steps: int) -> Array:
    """Where a function, positive at 0, falls through zero."""
    def halve(_, bracket):
        low, high = bracket
        middle = 0.5 * (low + high)
        right = function(middle) > 0
        return jnp.where(right, middle, low), jnp.where(right, high, middle)

    low, high = jax.lax.fori_loop(0, steps, halve, (jnp.zeros_like(high), high))
    return 0.5 * (low + high)


@jax.custom_jvp
def damping_number(restitution: Array) -> Array:
    r"""Dimensionless damping $\kappa = c_n v_1$ that gives exactly the restitution $e$, for any spring; 0 at $e \ge 1$.

    Solves the closed form of `restitution_balance` by bisection on $\kappa e \in (0, 1)$; its derivative follows from
    the implicit-function theorem.
    """
    e = jnp.clip(restitution, 1e-3, 1.0)

    product = _bisect(lambda x: restitution_balance(x / e, e), jnp.ones_like(e) * (1.0 - 1e-16), 56)
    return jnp.where(e >= 1.0, 0.0, product / e)


@damping_number.defjvp
def _damping_number_jvp(primals, tangents):
    (e,), (e_dot,) = primals, tangents
    kappa = damping_number(e)
    inside = jnp.clip(e, 1e-3, 1.0)
    by_kappa = jax.jvp(lambda k: restitution_balance(k, inside), (kappa,), (jnp.ones_like(kappa),))[1]
    by_e = jax.jvp(lambda x: restitution_balance(kappa, x), (inside,), (jnp.ones_like(inside),))[1]
    slope = jnp.where((e > 1.0) | (e < 1e-3), 0.0, -by_e / by_kappa)
    return kappa, slope * e_dot


def exact_damping(restitution: Array, approach_speed: Array) -> Array:
    r"""$c_n$ [s/m] that realises exactly the restitution $e$ at the speed $v_1$ (see `damping_number`)."""
    return damping_number(restitution) / approach_speed


def printed_damping(restitution: Array, approach_speed: Array) -> Array:
    r"""$c_n = 3(1 - e^2)/(4 v_1)$ [s/m], Eq. 6 (Lankarani-Nikravesh); asked for $e = 0.8$ it delivers 0.847."""
    return 3.0 * (1.0 - restitution**2) / (4.0 * approach_speed)


def delivered_restitution(kappa: Array) -> Array:
    r"""Restitution that $\kappa = c_n v_1 \ge 0$ really delivers, in (0, 1]: the closed form solved by bisection."""
    kappa = jnp.asarray(kappa, dtype=float)
    top = jnp.where(kappa > 1.0, 1.0 / jnp.where(kappa > 1.0, kappa, 1.0), 1.0)
    return _bisect(lambda e: restitution_balance(kappa, e), top, 60)
