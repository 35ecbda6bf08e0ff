"""A force over time, as the sensor sees it: piecewise quadratic between nodes, with jumps allowed at nodes."""

from collections.abc import Callable
from typing import final

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array


@final
class Signal(eqx.Module):
    """A signal on consecutive intervals, each a parabola through its value at the start, the middle and the end."""

    duration: Array  # of every interval, shape (intervals,) [s], >= 0
    # values there, shape (intervals,); the end of one interval and the start of the next differ where the
    # signal jumps (first touch, separation)
    start: Array
    middle: Array
    end: Array

    def map(self, function: Callable[[Array], Array]) -> "Signal":
        """The signal with a function applied to every value (gain, offset, clipping)."""
        return Signal(self.duration, function(self.start), function(self.middle), function(self.end))

    def minus(self, other: "Signal") -> "Signal":
        """The difference of two signals on the same intervals."""
        return Signal(self.duration, self.start - other.start, self.middle - other.middle, self.end - other.end)


def _integrals(z: Array) -> tuple[Array, Array, Array, Array]:
    """I_k(z) = z * int_0^1 exp(-z (1 - u)) u**k du for k = 0..3, z >= 0; exp(-z) = 1 - I_0.

    By the series of I_3 and upward recurrence where z is small, by downward recurrence elsewhere.
    """
    small = z < 0.7
    low = jnp.where(small, z, 0.0)
    total = jnp.ones_like(low)
    for j in range(10, -1, -1):
        total = 1.0 - total * low / (j + 5)
    s3 = low * total / 4.0
    s2 = low * (1.0 - s3) / 3.0
    s1 = low * (1.0 - s2) / 2.0
    s0 = low * (1.0 - s1)
    inverse = 1.0 / jnp.where(small, 1.0, z)
    i0 = 1.0 - jnp.exp(-jnp.where(small, 1.0, z))
    i1 = 1.0 - inverse * i0
    i2 = 1.0 - 2.0 * inverse * i1
    i3 = 1.0 - 3.0 * inverse * i2
    first, second, third, fourth = (
        jnp.where(small, a, b) for a, b in zip((s0, s1, s2, s3), (i0, i1, i2, i3), strict=True))
    return first, second, third, fourth


@jax.custom_jvp
def response_weights(z: Array) -> tuple[Array, Array, Array]:
    r"""$I_k(z) = z \int_0^1 e^{-z(1-u)} u^k du$, k = 0, 1, 2: what a first-order filter makes of $1, u, u^2$.

    z, duration over time constant [-], is not negative.
    """
    return _integrals(z)[:3]


@response_weights.defjvp
def _response_weights_jvp(primals, tangents):
    (z,), (z_dot,) = primals, tangents
    i0, i1, i2, i3 = jax.lax.optimization_barrier(_integrals(z))
    # dI_k/dz = (1 - I_{k+1})/(k + 1) - I_k + I_{k+1}
    slopes = jax.lax.optimization_barrier((1.0 - i0, (1.0 - i2) / 2.0 - i1 + i2, (1.0 - i3) / 3.0 - i2 + i3))
    return (i0, i1, i2), tuple(slope * z_dot for slope in slopes)


def _deficits(ratio: Array) -> tuple[tuple[Array, Array, Array], tuple[Array, Array, Array]]:
    """1 - I_k(1/ratio) for k = 0, 1, 2 (first tuple) and their derivatives, regular at 0."""
    fast = ratio < 1.4
    eps = jnp.where(fast, ratio, 0.0)
    alive = eps > 1.5e-3
    decay = jnp.where(alive, jnp.exp(-1.0 / jnp.where(alive, eps, 1.0)), 0.0)
    k1 = eps * (1.0 - decay)
    k2 = 2.0 * eps * (1.0 - k1)
    decay_dot = jnp.where(alive, decay / jnp.where(alive, eps, 1.0) ** 2, 0.0)
    k1_dot = (1.0 - decay) - eps * decay_dot
    k2_dot = 2.0 * (1.0 - k1) - 2.0 * eps * k1_dot
    z = 1.0 / jnp.where(fast, 1.4, ratio)
    i0, i1, i2, i3 = _integrals(z)
    slow = (1.0 - i0, 1.0 - i1, 1.0 - i2)
    slow_dot = (z**2 * (1.0 - i0), z**2 * ((1.0 - i2) / 2.0 - i1 + i2), z**2 * ((1.0 - i3) / 3.0 - i2 + i3))
    d0, d1, d2 = (jnp.where(fast, a, b) for a, b in zip((decay, k1, k2), slow, strict=True))
    e0, e1, e2 = (jnp.where(fast, a, b) for a, b in zip((decay_dot, k1_dot, k2_dot), slow_dot, strict=True))
    return (d0, d1, d2), (e0, e1, e2)


@jax.custom_jvp
def lag_deficits(ratio: Array) -> tuple[Array, Array, Array]:
    r"""$1 - I_k(1/\rho)$, k = 0, 1, 2: by how much a lag falls short of $1, u, u^2$; 0 without one, $\rho = 0$.

    $\rho$, time constant over duration [-], is not negative.
    """
    return _deficits(ratio)[0]


@lag_deficits.defjvp
def _lag_deficits_jvp(primals, tangents):
    (ratio,), (ratio_dot,) = primals, tangents
    values, slopes = jax.lax.optimization_barrier(_deficits(ratio))
    return values, tuple(slope * ratio_dot for slope in slopes)


_SERIES = 13  # terms: 1e-16 at a phase of 1/2
_FADED = 50.0  # exponent of a decay that rounding hides


def _turns(phase: Array, damping: Array) -> tuple[Array, Array]:
    """exp(-zeta p) cos(d p) and exp(-zeta p) sin(d p)/d, d = sqrt(1 - zeta^2); beyond 1 the hyperbolic functions."""
    square = 1.0 - damping**2
    d = jnp.sqrt(jnp.maximum(jnp.abs(square), 1e-10))  # at 1 to 1e-10 of the limit
    under, slow = square > 0.0, damping + d
    rate = jnp.where(under, damping, 1.0 / slow)
    alive = rate * phase < _FADED
    p = jnp.where(alive, phase, 0.0)
    decay = jnp.where(alive, jnp.exp(-rate * p), 0.0)
    fast = jnp.exp(-2.0 * jnp.where(under, 0.0, d) * p)
    angle = jnp.where(under, d * p, 0.0)
    cosine = jnp.where(under, jnp.cos(angle), 0.5 * (1.0 + fast))
    sine = jnp.where(under, jnp.sin(angle), 0.5 * (1.0 - fast)) / d
    return decay * cosine, decay * sine


def _resonance(ratio: Array, damping: Array) -> tuple[Array, ...]:
    """See `resonance_weights`: in closed form, or by series where the phase over an interval is small."""
    least = 2.0 * jnp.maximum(damping, 1.0)  # the series' terms grow with the damping
    fast = ratio < least
    eps = jnp.where(fast, ratio, 1.0)
    some = eps > 1e-6  # below, whatever rings at all is gone, or beyond the damping that a mount has
    phase = jnp.where(some, 1.0 / jnp.where(some, eps, 1.0), jnp.inf)
    c, s = _turns(phase, damping)
    z, square = 2.0 * damping, 4.0 * damping**2 - 1.0
    step = c + damping * s
    one = (step, eps * (z - (z * c + (0.5 * z * z - 1.0) * s)),
           2.0 * eps * (z - eps * (square * (1.0 - step) + z * s)),
           s, eps * (1.0 - step), 2.0 * eps * (1.0 - eps * (z - (z * c + (0.5 * z * z - 1.0) * s))))
    x = 1.0 / jnp.where(fast, least, ratio)
    # Responses from rest to the impulse, 1, p and p^2/2, each the integral of the one before.
    term, before = jnp.ones_like(x * damping), jnp.zeros_like(x * damping)
    parts = [jnp.zeros_like(term) for _ in range(4)]
    factor = jnp.ones_like(x)
    for n in range(_SERIES):
        factor = factor * x / (n + 1)
        more = factor
        for k in range(4):
            parts[k] = parts[k] + term * more
            more = more / (n + k + 2)
        term, before = -z * term - before, term
    g, y0, y1, y2 = parts[0], parts[1] * x, parts[2] * x, 2.0 * parts[3] * x
    other = (1.0 - y0, 1.0 - y1, 1.0 - y2, g, parts[1], 2.0 * parts[2])
    return tuple(jnp.where(fast, a, b) for a, b in zip(one, other, strict=True))


@jax.custom_jvp
def resonance_weights(ratio: Array, damping: Array) -> tuple[Array, ...]:
    r"""What a mass on a damped spring makes of $1, u, u^2$, u = 0..1, from rest: six numbers, each of their shape.

    By how much its deflection falls short of 1 at the end (three), and its rate there in units of the deflection per
    $1/\omega_0$ (three); all are 0 at $\rho = 0$, where it follows at once.

    Args:
        ratio: $\rho = 1/(\omega_0 h)$ over an interval of duration h [-], not negative.
        damping: ratio $\zeta$ [-], positive; beyond 1 it creeps.
    """
    return _resonance(ratio, damping)


@resonance_weights.defjvp
def _resonance_weights_jvp(primals, tangents):
    values, by_ratio = jax.jvp(lambda ratio: _resonance(ratio, primals[1]), primals[:1], (jnp.ones_like(primals[0]),))
    ones = jnp.ones_like(primals[1])
    by_damping = jax.jvp(lambda damping: _resonance(primals[0], damping), primals[1:], (ones,))[1]
    # Slopes are computed once, and not once for every tangent.
    values, by_ratio, by_damping = jax.lax.optimization_barrier((values, by_ratio, by_damping))
    return values, tuple(a * tangents[0] + b * tangents[1] for a, b in zip(by_ratio, by_damping, strict=True))


def _parabola(signal: Signal) -> tuple[Array, Array, Array]:
    """Coefficients of each interval's parabola in u = 0..1."""
    return (signal.start, 4.0 * signal.middle - 3.0 * signal.start - signal.end,
            2.0 * (signal.start + signal.end) - 4.0 * signal.middle)


def _accumulate(decay: Array, push: Array) -> tuple[Array, Array]:
    """Values at the start and end of every interval of y <- decay * y + push, from y = 0."""
    def advance(y, interval):
        after = interval[0] * y + interval[1]
        return after, (y, after)

    return jax.lax.scan(advance, jnp.zeros_like(push[0]), (decay, push))[1]


def low_pass(signal: Signal, rate: Array) -> Signal:
    r"""Response $y$ of $dy/dt = r (x - y)$, $y(0) = 0$, exact for each parabola; regular at $r = 0$, where $y = 0$."""
    z = signal.duration * jnp.where(rate >= 0.0, rate, 0.0)
    c0, c1, c2 = _parabola(signal)
    i0, i1, i2 = response_weights(z)
    start, end = _accumulate(1.0 - i0, c0 * i0 + c1 * i1 + c2 * i2)
    i0, i1, i2 = response_weights(0.5 * z)
    middle = (1.0 - i0) * start + c0 * i0 + 0.5 * c1 * i1 + 0.25 * c2 * i2
    return Signal(signal.duration, start, middle, end)


def lag(signal: Signal, time_constant: Array) -> Signal:
    r"""Response $y$ of $T\,dy/dt = x - y$, exact for each parabola; regular at $T = 0$ [s], where $y = x$."""
    some = signal.duration > 0.0
    constant = jnp.where(time_constant >= 0.0, time_constant, 0.0)
    ratio = constant / jnp.where(some, signal.duration, 1.0)
    c0, c1, c2 = _parabola(signal)
    k0, k1, k2 = lag_deficits(ratio)
    push = signal.end - (c0 * k0 + c1 * k1 + c2 * k2)
    start, end = _accumulate(jnp.where(some, k0, 1.0), jnp.where(some, push, 0.0))
    k0, k1, k2 = lag_deficits(2.0 * ratio)
    middle = jnp.where(some, k0 * start + signal.middle - (c0 * k0 + 0.5 * c1 * k1 + 0.25 * c2 * k2), start)
    # A sensor without lag follows jumps too.
    start = jnp.where(constant > 0.0, start, signal.start)
    return Signal(signal.duration, start, middle, end)


def resonate(signal: Signal, inverse_frequency: Array, damping: Array) -> Signal:
    r"""Response of $\ddot y/\omega_0^2 + 2\zeta\dot y/\omega_0 + y = x$ from rest, exact for each parabola.

    Regular at $1/f_0 = 0$, $\omega_0 = 2\pi f_0$, where $y = x$, jumps followed; for small $1/f_0$ it is
    $x - 2\zeta\dot x/\omega_0$.

    Args:
        signal: x, over intervals that are short against $1/f_0$ wherever what lies within them is to be read.
        inverse_frequency: $1/f_0$ [s]; counts as 0 where negative.
        damping: ratio $\zeta$ [-], positive.
    """
    some = signal.duration > 0.0
    constant = jnp.where(inverse_frequency >= 0.0, inverse_frequency, 0.0) / (2.0 * jnp.pi)
    ratio = constant / jnp.where(some, signal.duration, 1.0)
    c0, c1, c2 = _parabola(signal)
    # The deflection y, and its rate V over omega_0.
    d0, d1, d2, n0, n1, n2 = resonance_weights(ratio, damping)
    push = jnp.where(some, signal.end - (c0 * d0 + c1 * d1 + c2 * d2), 0.0)
    kick = jnp.where(some, c0 * n0 + c1 * n1 + c2 * n2, 0.0)
    keep, swing = jnp.where(some, d0, 1.0), jnp.where(some, n0, 0.0)
    slow = jnp.where(some, d0 - 2.0 * damping * n0, 1.0)

    def advance(state, interval):
        keep, swing, slow, push, kick = interval
        after = keep * state[0] + swing * state[1] + push, slow * state[1] - swing * state[0] + kick
        return after, (*state, after[0])

    rest = jnp.zeros_like(push[0])
    start, rate, end = jax.lax.scan(advance, (rest, rest), (keep, swing, slow, push, kick))[1]
    d0, d1, d2, n0, *_ = resonance_weights(2.0 * ratio, damping)
    middle = d0 * start + n0 * rate + signal.middle - (c0 * d0 + 0.5 * c1 * d1 + 0.25 * c2 * d2)
    middle = jnp.where(some, middle, start)
    # A gauge that does not ring follows jumps too.
    start = jnp.where(constant > 0.0, start, signal.start)
    return Signal(signal.duration, start, middle, end)


def follow_friction(signal: Signal, width: Array) -> Signal:
    r"""State $z$ of Dahl's friction: $dz/dx = (1 - z)/w$ while x rises, $(1 + z)/w$ while it falls; $z = 0$ at first.

    It depends on the way of x and not on its pace (Dahl 1968), and stays within -1..1: exact for each parabola, jumps
    included.

    Args:
        signal: x, which starts from 0 [N].
        width: w, the change of x over which z turns [N], positive.
    """
    c0, c1, c2 = _parabola(signal)
    curved = jnp.abs(c2) > 0.0
    turn = jax.lax.stop_gradient(jnp.where(curved, -0.5 * c1 / jnp.where(curved, c2, 1.0), 0.0))
    halves = jnp.clip(turn, 0.0, 0.5), jnp.clip(turn, 0.5, 1.0)  # where a half of the parabola turns
    first, second = (c0 + u * (c1 + u * c2) for u in halves)
    before = jnp.concatenate([jnp.zeros_like(signal.end[:1]), signal.end[:-1]])
    way = jnp.diff(jnp.stack([before, signal.start, first, signal.middle, second, signal.end]), axis=0)
    keep, push = jnp.exp(-jnp.abs(way) / width), -jnp.sign(way) * jnp.expm1(-jnp.abs(way) / width)
    whole, total = jnp.ones_like(before), jnp.zeros_like(before)
    for one, more in zip(keep, push, strict=True):
        whole, total = one * whole, one * total + more
    state, end = _accumulate(whole, total)
    start = keep[0] * state + push[0]
    middle = keep[2] * (keep[1] * start + push[1]) + push[2]
    return Signal(signal.duration, start, middle, end)
