r"""Torque-free motion in closed form: it costs the same for one second and for a year.

Angular velocity by Jacobi's elliptic functions, attitude by one elliptic integral of the third kind (Jacobi 1849;
van Zon and Schofield, J. Comput. Phys. 225 (2007) 145). Written here with the addition theorem in the initial values,
so that nothing divides by a difference of moments, by the rate along an axis or by the nutation: values and first
derivatives stay regular for equal moments, for spin about any principal axis and at rest.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._rotation import conjugate, from_matrix, from_rotation_vector, multiply, normalise
from .elliptic import SMALLEST, first_kind, integrate_pulses, jacobi, quarter_period
from .rigid import Tumble, read_start


# Relative difference below which two moments count as equal in derivatives by the inertia tensor: differences are lost
# in rounding there.
EQUAL = 1e-8
# Square of the elliptic argument below which its Taylor series is used: larger, the series errs; smaller, the general
# formula loses digits.
SHORT = 1e-3
# Complement below which the integral is summed over pulses, not over harmonics, which converge slowly there.
NARROW = 1e-2
_HARMONICS, _SAMPLES = 30, 64  # and samples of a period: for the series above that complement; more only cost time
_NODES, _WEIGHTS = (0.5 * (x + shift) for x, shift in zip(np.polynomial.legendre.leggauss(6), (1.0, 0.0), strict=True))
_ORDER = np.arange(1, _HARMONICS + 1)
_PHASES = 2.0 * np.pi * np.outer(_ORDER, np.arange(_SAMPLES)) / _SAMPLES
_HALF = np.sqrt(0.5)
# Turns of the principal frame that make axis 3 the one that the momentum circles, on its own side.
_CHOICES = np.array([np.diag([1.0, 1, 1]), np.diag([1.0, -1, -1]), [[0.0, 0, 1], [0, -1, 0], [1, 0, 0]],
                     [[0.0, 0, -1], [0, 1, 0], [1, 0, 0]]])
_EIGHTHS = np.array([[[1, 0, 0], [0, _HALF, -_HALF], [0, _HALF, _HALF]],
                     [[_HALF, 0, _HALF], [0, 1, 0], [-_HALF, 0, _HALF]],
                     [[_HALF, -_HALF, 0], [_HALF, _HALF, 0], [0, 0, 1]]])
_FIRST, _SECOND = np.array([1, 2, 0]), np.array([2, 0, 1])  # the axes that each of these turns mixes


def propagate_torque_free(inertia: Any, attitude: Any, angular_velocity: Any, times: Any) -> Tumble:
    r"""Propagate torque-free motion, $I\dot\omega + \omega \times I\omega = 0$, in closed form for any inertia tensor.

    With principal moments $A_1, A_2, A_3$ in order and $s, c, d$ Jacobi's functions of $p t$,
    $p^2 = (L^2 - 2 E A_1)(A_3 - A_2)/(A_1 A_2 A_3)$:

    $\omega_1(t) = (\omega_1 c + \dot\omega_1 s d/p)/n$, $\omega_2(t) = (\omega_2 c d + \dot\omega_2 s/p)/n$,
    $\omega_3(t) = (\omega_3 d + \dot\omega_3 s c/p)/n$,
    $n = c^2 + (A_1 - A_3)(A_2 - A_3) \omega_3^2 s^2/(A_1 A_2 p^2)$,

    where $\omega_i$ and Euler's $\dot\omega_i$ are those at the start. The attitude is the least turn of $L$ to axis 3
    followed by a turn about $L$ at the rate $(2E + |L| \omega_3)/(|L| + L_3)$.

    Batch with `jax.vmap`. First derivatives by all arguments are right in both modes, also for bodies of revolution
    and spheres. Digits: the phase carries the rounding of $p$, so that the error grows as $10^{-16} |\omega| t$.
    Moments that differ by $\epsilon$ relative, $10^{-8} < \epsilon \ll 1$, cost $10^{-16}/\epsilon$ in derivatives by
    those elements of the tensor that turn its axes. On the separatrix itself (spin about the middle axis and what
    tends to it) the motion stays with the limit; its derivatives by the rate grow like $\cosh pt$ and are followed up
    to $pt = 100$, and within $1 - m < 10^{-100}$ the separatrix is taken. Second derivatives are not promised.

    Args:
        inertia: about the centre of mass, body components, shape (3, 3), or three principal moments [kg m²].
        attitude: at time 0, quaternion, scalar first, body to inertial, shape (4,) [-].
        angular_velocity: at time 0, body components, shape (3,) [rad/s].
        times: ascending, may be negative, shape (times,) [s].

    Returns:
        A `Tumble`.

    Raises:
        InputError: as `read_start` says.
    """
    start = read_start(inertia, attitude, angular_velocity, times)
    quaternions, rates = _coast(*start)
    bad = ~jnp.isfinite(jnp.sum(quaternions) + jnp.sum(rates))
    return Tumble(start[3], quaternions, rates, bad, jnp.zeros((), dtype=int))


def coast_symmetric(transverse: Array, axial: Array, attitude: Array, angular_velocity: Array,
                    times: Array) -> tuple[Array, Array]:
    r"""Attitude (times, 4) and angular velocity (times, 3) [rad/s] of a body of revolution about z without torque.

    $q(t) = \exp(L t / 2 I_t) \, q \, \exp(\hat z (1 - I_a/I_t) \omega_z t / 2)$ with $L$ in the inertial frame: the
    body precesses about $L$ at $|L|/I_t$ while it turns about its axis (Goldstein, section 5.6). Moments $I_t$, $I_a$
    [kg m²]; attitude (4,) and angular velocity, body components, (3,) at time 0.
    """
    moments = jnp.stack([transverse, transverse, axial])
    spin = (1.0 - axial / transverse) * angular_velocity[2] * times
    axis = jnp.array([0.0, 0.0, 1.0])
    drift = from_rotation_vector(times[:, None] * (moments * angular_velocity / transverse))
    quaternions = multiply(multiply(attitude, drift), from_rotation_vector(spin[:, None] * axis))
    cosine, sine = jnp.cos(spin), jnp.sin(spin)
    x, y, z = angular_velocity
    rates = jnp.stack([x * cosine + y * sine, y * cosine - x * sine, jnp.full_like(times, z)], axis=-1)
    return quaternions, rates


@jax.custom_jvp
def _flow(inertia: Array, attitude: Array, rate: Array, times: Array) -> tuple[Array, Array]:
    """Attitude and angular velocity at the times."""
    moments, frame = _diagonalise(inertia)
    return _flow_principal(moments, frame, attitude, rate, times)


@_flow.defjvp
def _differentiate_flow(primals: Any, tangents: Any) -> Any:
    """Derivatives that also hold where principal moments are equal and principal axes are not defined.

    An element of the tensor between two axes of equal moments turns no axis: seen in a frame turned by 45 degrees about
    the third axis it raises one of the two moments and lowers the other. Such a frame is as good, so the same formulas
    are differentiated there.
    """
    inertia, attitude, rate, times = primals
    change, *others = tangents
    moments, frame = _diagonalise(inertia)
    seen = frame.T @ change @ frame
    gap = moments[None, :] - moments[:, None]
    equal = jnp.abs(gap) < EQUAL * moments[2]
    turning = frame @ jnp.where(equal, 0.0, seen / jnp.where(equal, 1.0, gap))
    mixed = jnp.where(equal[_FIRST, _SECOND], seen[_FIRST, _SECOND], 0.0)
    shift = mixed[:, None] * (np.eye(3)[_FIRST] - np.eye(3)[_SECOND])
    frames = jnp.concatenate([frame[None], frame @ _EIGHTHS])
    dmoments = jnp.concatenate([jnp.diag(seen)[None], shift])
    dframes = jnp.concatenate([turning[None], jnp.zeros((3, 3, 3))])
    first = np.eye(4)[0]

    def push(frame, dmoments, dframe, share):
        return jax.jvp(_flow_principal, (moments, frame, attitude, rate, times),
                       (dmoments, dframe, *(share * other for other in others)))

    value, slopes = jax.vmap(push)(frames, dmoments, dframes, first)
    return (value[0][0], value[1][0]), (jnp.sum(slopes[0], axis=0), jnp.sum(slopes[1], axis=0))


_coast = jax.jit(_flow)


def _diagonalise(inertia: Array) -> tuple[Array, Array]:
    """Principal moments in ascending order and the right-handed frame of their axes, as columns."""
    moments, frame = jnp.linalg.eigh(inertia)
    return moments, frame * jnp.where(jnp.linalg.det(frame) < 0, -1.0, 1.0)


def _flow_principal(moments: Array, frame: Array, attitude: Array, rate: Array, times: Array) -> tuple[Array, Array]:
    """Attitude and angular velocity at the times, from principal moments in order and the frame of their axes."""
    along = rate @ frame
    seen = along * moments
    _, _, split = _measure_orbit(moments, along)
    swap = split < 0
    side = jnp.where(swap, seen[0], seen[2]) < 0
    choice = jnp.asarray(_CHOICES)[2 * swap.astype(int) + side.astype(int)]
    moments = jnp.where(swap, moments[::-1], moments)
    frame, start = frame @ choice, along @ choice
    still = jnp.sum(rate**2) <= 0
    momentum = moments * jnp.where(still, 1.0, start)
    size = jnp.sqrt(jnp.sum(momentum**2))

    rates, integral = _follow(moments, start, size, times)
    transverse = moments[0] * (moments[0] - moments[2]) * start[0] ** 2
    transverse = transverse + moments[1] * (moments[1] - moments[2]) * start[1] ** 2
    twist = size * times / moments[2] - transverse / moments[2] * integral
    tilt = _tilt(momentum / size)
    tilts = _tilt(moments * jnp.where(still, 1.0, rates) / size)
    zero = jnp.zeros_like(twist)
    about = jnp.stack([jnp.cos(0.5 * twist), zero, zero, jnp.sin(0.5 * twist)], axis=-1)
    turned = from_matrix(frame)
    begin = multiply(multiply(attitude, turned), conjugate(tilt))
    moved = multiply(multiply(begin, multiply(about, tilts)), conjugate(turned))
    resting = multiply(attitude, from_rotation_vector(times[:, None] * rate))
    quaternions = normalise(jnp.where(still, resting, moved))
    return quaternions, jnp.where(still, jnp.broadcast_to(rate, rates.shape), rates @ frame.T)


def _measure_orbit(moments: Array, rate: Array) -> tuple[Array, Array, Array]:
    """p^2, m p^2 and their difference [1/s²]; the difference is below zero where axis 1 is the one that L circles."""
    a1, a2, a3 = moments
    x, y, z = rate**2
    d12, d23, d13 = a1 - a2, a2 - a3, a1 - a3
    product = a1 * a2 * a3
    square = (a2 * d12 * y + a3 * d13 * z) * d23 / product
    lesser = (a1 * d13 * x + a2 * d23 * y) * d12 / product
    return square, lesser, d13 * (d23 * z / (a1 * a2) - d12 * x / (a2 * a3))


def _follow(moments: Array, start: Array, size: Array, times: Array) -> tuple[Array, Array]:
    """Rates along the principal axes, shape (times, 3), and the integral of 1/(L + L_3) over time, shape (times,)."""
    square, lesser, split = _measure_orbit(moments, start)
    split = jnp.maximum(split, 0.0)
    floor = 1e-60 * jnp.sum(start**2) + 1e-200
    tiny = square <= floor
    frequency = jnp.sqrt(jnp.where(tiny, 1.0, square))
    complement = jnp.where(tiny, 1.0, jnp.maximum(split / jnp.where(tiny, 1.0, square), SMALLEST))
    single = ~tiny & (split <= SMALLEST * square)
    short = square * times**2 < SHORT
    middle = single & (start[0] == 0) & (start[2] == 0)

    def at(argument):
        argument = jnp.where(single, jnp.clip(argument, -100.0, 100.0), argument)
        s, c, d = jacobi(argument, complement)
        return _place(moments, start, s / frequency, c, d)

    far = at(frequency * jnp.where(short, 1.0 / frequency, times))
    nodes = jnp.where(short, times, 0.0)[:, None] * _NODES
    near = _place(moments, start, *_expand(jnp.where(short, times, 0.0), square, lesser))
    passed = _place(moments, start, *_expand(nodes, square, lesser))
    near_integral = jnp.where(short, times, 0.0) * jnp.sum(_WEIGHTS / (size + moments[2] * passed[..., 2]), axis=-1)

    def harmonics():
        m1 = jnp.where(complement > NARROW, complement, 0.5)
        period = 2.0 * quarter_period(m1)
        s, c, d = jacobi(period * np.arange(_SAMPLES) / _SAMPLES, m1)
        density = 1.0 / (size + moments[2] * _place(moments, start, s / frequency, c, d)[:, 2])
        cosines, sines = (2.0 / _SAMPLES * (wave @ density) for wave in (np.cos(_PHASES), np.sin(_PHASES)))
        angle = 2.0 * jnp.pi / period * frequency * times[:, None] * _ORDER
        terms = cosines * jnp.sin(angle) + 2.0 * sines * jnp.sin(0.5 * angle) ** 2
        return jnp.mean(density) * times + 0.5 * period / (jnp.pi * frequency) * jnp.sum(terms / _ORDER, axis=-1)

    def pulses():
        narrow = (complement <= NARROW) & ~tiny & ~middle
        m1 = jnp.where(narrow, jnp.where(single, 0.0, complement), 0.5 * NARROW)
        a1, a2, a3 = jnp.where(narrow, moments, jnp.array([3.0, 2.0, 1.0]))
        x, y, z = jnp.where(narrow, start, jnp.array([0.1, 1.0, 1.0]))
        d12, d23, d13 = a1 - a2, a2 - a3, a1 - a3
        momentum = a1**2 * x**2 + a2**2 * y**2 + a3**2 * z**2
        share = jnp.sqrt((a3 * (a2 * d12 * y**2 + a3 * d13 * z**2) / d13) / momentum)
        share = jnp.minimum(share, 1.0 - 1e-15)
        sine = -jnp.sign(d23) * jnp.sqrt(a2 * jnp.abs(d23)) * y
        cosine = jnp.sqrt(a1 * jnp.abs(d13)) * x
        phase = first_kind(sine, cosine, jnp.maximum(m1, SMALLEST))
        whole = integrate_pulses(jnp.append(frequency * times, 0.0) + phase, m1, share)
        return (whole[:-1] - whole[-1]) / (frequency * size)

    def linear():  # spin about the middle axis itself, where only the first-order departure from it matters
        argument = jnp.clip(frequency * times, -100.0, 100.0)
        turn = (moments[0] - moments[1]) / moments[2] * start[0] * start[1]
        path = start[2] * jnp.sinh(argument) / frequency + turn * (jnp.cosh(argument) - 1.0) / frequency**2
        return (times - moments[2] / size * path) / size

    # All, not lax.cond: within this derivative rule under vmap, JAX 0.12 cannot transpose it.
    far_integral = jnp.where(middle, linear(), jnp.where(complement > NARROW, harmonics(), pulses()))
    return jnp.where(short[:, None], near, far), jnp.where(short, near_integral, far_integral)


def _place(moments: Array, start: Array, sine: Array, c: Array, d: Array) -> Array:
    """Rates along the principal axes from sn/p, cn, dn, shape (..., 3)."""
    a1, a2, a3 = moments
    x, y, z = start
    turn1, turn2, turn3 = (a2 - a3) / a1 * y * z, (a3 - a1) / a2 * z * x, (a1 - a2) / a3 * x * y
    below = c**2 + (a1 - a3) * (a2 - a3) / (a1 * a2) * z**2 * sine**2
    return jnp.stack([x * c + turn1 * sine * d, y * c * d + turn2 * sine, z * d + turn3 * sine * c],
                     axis=-1) / below[..., None]


def _expand(time: Array, a: Array, b: Array) -> tuple[Array, Array, Array]:
    """sn/p, cn, dn by Taylor's series in the time, a = p^2 and b = m p^2, both times the square of the time small."""
    t2 = time**2
    c2, c4 = a + b, a * a + 14 * a * b + b * b
    c6 = (a + b) * (a * a + 134 * a * b + b * b)
    c8 = a**4 + 1228 * a**3 * b + 5478 * a * a * b * b + 1228 * a * b**3 + b**4
    sine = time * (1 - t2 / 6 * (c2 - t2 / 20 * (c4 - t2 / 42 * (c6 - t2 / 72 * c8))))
    return sine, jnp.sqrt(1 - a * sine**2), jnp.sqrt(1 - b * sine**2)


def _tilt(direction: Array) -> Array:
    """Least turn of a unit vector to axis 3, shape (..., 3) to (..., 4); singular at minus axis 3 only."""
    x, y, z = direction[..., 0], direction[..., 1], direction[..., 2]
    return normalise(jnp.stack([1.0 + z, y, -x, jnp.zeros_like(x)], axis=-1))
