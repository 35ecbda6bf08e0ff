r"""Jacobi's elliptic functions near and far from the separatrix, in JAX, with right derivatives.

The parameter is given by its complement $m_1 = 1 - m$, which keeps its digits where $m$ comes close to 1.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array


ITERATIONS = 11  # of the arithmetic-geometric mean: enough from SMALLEST on
SMALLEST = 1e-100  # complement below which the motion counts as the separatrix itself
_PAIRS = np.arange(1, 7)  # images of the pulse on either side


def descend(complement: Array) -> tuple[Array, Array, Array]:
    r"""Arithmetic-geometric mean of 1 and $\sqrt{m_1}$, and the descending Landen moduli, of $m_1$ in `SMALLEST` to 1.

    The moduli are $k_n = (a_{n-1} - b_{n-1})/(a_{n-1} + b_{n-1})$; the third result is $1 - k_n$, without cancellation,
    both of shape (ITERATIONS,).
    """
    def halve(pair, _):
        a, b = pair
        total = a + b
        return (0.5 * total, jnp.sqrt(a * b)), ((a - b) / total, 2.0 * b / total)

    # Loops, not unrolled: the derivatives of a motion compile four times as fast.
    (mean, _), (moduli, rest) = jax.lax.scan(halve, (jnp.ones_like(complement), jnp.sqrt(complement)), None, ITERATIONS)
    return mean, moduli, rest


def quarter_period(complement: Array) -> Array:
    r"""Complete elliptic integral of the first kind, $K(m) = \pi / (2\,\mathrm{agm}(1, \sqrt{m_1}))$ [-]."""
    return 0.5 * jnp.pi / descend(complement)[0]


def jacobi(argument: Array, complement: Array) -> tuple[Array, Array, Array]:
    r"""sn, cn, dn of $(u | m)$ by descending Landen transformations (Gauss), of $m_1$ in `SMALLEST` to 1, scalar.

    From $(\sin, \cos, 1)$ of $u\,\mathrm{agm}$ back up: with $w = 1 + k s^2$, $s' = (1 + k) s/w$, $c' = c d/w$, $d' =
    (1 - k + k c^2)/w$, in which nothing cancels: cn and dn keep their digits relative to the smallest dn (DLMF
    22.7(i)). Shapes are those of the argument $u$.
    """
    mean, moduli, rest = descend(complement)
    s, c = jnp.sin(mean * argument), jnp.cos(mean * argument)

    def ascend(values, step):
        (s, c, d), (k, k1) = values, step
        w = 1.0 + k * s**2
        return ((1.0 + k) * s / w, c * d / w, (k1 + k * c**2) / w), None

    return jax.lax.scan(ascend, (s, c, jnp.ones_like(s)), (moduli, rest), reverse=True)[0]


def first_kind(sine: Array, cosine: Array, complement: Array) -> Array:
    r"""Incomplete elliptic integral $F(\varphi | m)$ of an amplitude between $-\pi$ and $\pi$ [-].

    By ascending amplitudes, $\tan\psi = (b/a) \tan\varphi$. Sine and cosine of the amplitude count up to a common
    factor above zero; all are scalars.
    """
    def double(carry, _):
        a, b, sine, cosine, angle = carry
        ahead = jnp.arctan2(b * sine, a * cosine)
        angle = angle + ahead + 2.0 * jnp.pi * jnp.round((angle - ahead) / (2.0 * jnp.pi))
        return (0.5 * (a + b), jnp.sqrt(a * b), jnp.sin(angle), jnp.cos(angle), angle), None

    begin = (jnp.ones_like(complement), jnp.sqrt(complement), sine, cosine, jnp.arctan2(sine, cosine))
    mean, *_, angle = jax.lax.scan(double, begin, None, ITERATIONS)[0]
    return angle / (2.0**ITERATIONS * mean)


def integrate_pulses(argument: Array, complement: Array, share: Array) -> Array:
    r"""$\int_0^u \frac{du}{1 + \kappa\,\mathrm{dn}(u | m)}$ near the separatrix, an integral of the third kind.

    Poles of the integrand lie at $\pm i (2K' - z)$, $\mathrm{cd}(z | m_1) = \kappa$. Summed along the imaginary period
    they make one pulse, repeated every $2K$; with $\zeta = \pi z/(2K')$ the integral over one of them is elementary:
    $-2A \arctan(\tan(\zeta/2) \tanh(\pi u/(4K')))$, $A = \kappa/\sqrt{(1 - \kappa^2)(1 - m_1 \kappa^2)}$. This is the
    series of the theta functions in the complementary nome; twelve images are enough for $m_1 \le 0.01$. Below
    `SMALLEST` it is the limit of one single pulse. The share $\kappa$ lies between 0 and 1.
    """
    single = complement <= SMALLEST
    m1 = jnp.maximum(complement, SMALLEST)
    period, other = 2.0 * quarter_period(m1), quarter_period(1.0 - m1)
    below, slight = 1.0 - share**2, 1.0 - m1 * share**2
    height = share / jnp.sqrt(below * slight)
    zeta = 0.5 * jnp.pi / other * first_kind(jnp.sqrt(below), share * jnp.sqrt(1.0 - m1), 1.0 - m1)
    reach = jnp.minimum(0.5 * jnp.pi * _PAIRS * period / other, 300.0)
    images = jnp.sum(2.0 * jnp.sin(zeta) * jnp.cos(zeta) / (jnp.cos(zeta) ** 2 + jnp.sinh(reach) ** 2))
    level = 0.5 * jnp.pi * height / other * (jnp.tan(zeta) + images)
    turns = jnp.where(single, 0.0, jnp.round(argument / period))
    left = argument - period * turns
    tangent, scale = jnp.tan(0.5 * zeta), 0.25 * jnp.pi / other
    places = period * np.concatenate([-_PAIRS[::-1], [0], _PAIRS])
    pulses = jnp.sum(jnp.arctan(tangent * jnp.tanh(scale * (left[..., None] - places))), axis=-1)
    return turns * (level * period - 2.0 * height * zeta) + level * left - 2.0 * height * pulses
