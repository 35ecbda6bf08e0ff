r"""Nutation, precession and spin about the angular momentum: the Euler angles of the paper's Section 5.

The paper's momentum frame $O X_L Y_L Z_L$ has $Y_L$ along the angular momentum. The paper prints neither its other axes
nor the order of the angles; here $X_L$ lies along $Y_L \times Z$, across the base frame's $Z$, and the angles are
precession $\psi$ about $Y_L$, nutation $\theta$ about the line of nodes, spin $\varphi$ about body z, the debris' axis.
Nutation, and the rates of precession and spin, do not depend on that choice.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._numerics import safe_divide, safe_sqrt
from .._rotation import conjugate, from_matrix, multiply
from .rigid import measure_momentum, to_tensor


_CYCLE = np.array([0.5, 0.5, 0.5, 0.5])  # takes Y_L to z, Z_L to x, X_L to y


def measure_nutation(inertia: Array, angular_velocity: Array) -> Array:
    r"""Nutation $\theta = \angle(\hat z, I\omega)$ between the debris' axis and the angular momentum, (...) [rad].

    Inertia (3, 3) or three principal moments [kg m²]; angular velocity, body components, (..., 3) [rad/s]. 0 at rest;
    its derivative is taken as 0 where the momentum lies along the axis.
    """
    momentum = angular_velocity @ to_tensor(inertia)
    across = safe_sqrt(momentum[..., 0] ** 2 + momentum[..., 1] ** 2)
    still = (across == 0) & (momentum[..., 2] == 0)
    return jnp.where(still, 0.0, jnp.arctan2(across, jnp.where(still, 1.0, momentum[..., 2])))


def measure_precession(inertia: Array, angular_velocity: Array) -> Array:
    r"""Precession rate of the debris' axis about the angular momentum without torque, shape (...) [rad/s].

    $\dot\psi = |L| (\omega_x L_x + \omega_y L_y)/(L_x^2 + L_y^2)$, body components; $|L|/I_t$ for a body of revolution,
    which is also taken where the momentum lies along the axis ($1/I_t$ as the mean of $1/I_x$ and $1/I_y$ there).
    Arguments as of `measure_nutation`.
    """
    tensor = to_tensor(inertia)
    momentum = angular_velocity @ tensor
    size = safe_sqrt(jnp.sum(momentum**2, axis=-1))
    across = momentum[..., :2]
    square = jnp.sum(across**2, axis=-1)
    inverse = jnp.linalg.inv(tensor)
    share = safe_divide(jnp.sum(angular_velocity[..., :2] * across, axis=-1), square)
    return size * jnp.where(square > 0, share, 0.5 * (inverse[0, 0] + inverse[1, 1]))


def measure_spin(inertia: Array, angular_velocity: Array) -> Array:
    r"""Spin rate about the debris' axis without torque, $\dot\varphi = \omega_z - \dot\psi \cos\theta$ [rad/s].

    Arguments as of `measure_nutation`.
    """
    cosine = jnp.cos(measure_nutation(inertia, angular_velocity))
    return angular_velocity[..., 2] - measure_precession(inertia, angular_velocity) * cosine


def make_momentum_frame(angular_momentum: Array) -> Array:
    r"""Attitude of the frame $O X_L Y_L Z_L$ in the base frame, unit quaternion (4,), of a momentum (3,), not zero.

    $Y_L$ lies along the momentum, $X_L$ along $Y_L \times Z$, or along $X$ where the momentum lies along $Z$.
    """
    y = angular_momentum / jnp.sqrt(jnp.sum(angular_momentum**2))
    along = y[0] ** 2 + y[1] ** 2 == 0
    flat = jnp.stack([y[1], -y[0], jnp.zeros_like(y[0])])
    flat = jnp.where(along, jnp.array([1.0, 0.0, 0.0]), flat)
    x = flat / jnp.sqrt(jnp.sum(flat**2))
    return from_matrix(jnp.stack([x, y, jnp.cross(x, y)], axis=-1))


def to_euler_angles(attitude: Array, angular_momentum: Array) -> Array:
    r"""Precession, nutation, spin $(\psi, \theta, \varphi)$, (..., 3) [rad], of attitudes about a momentum (3,).

    $\psi$ and $\varphi$ lie in $-\pi$ to $\pi$; where nutation is 0 or $\pi$ only their sum or difference is defined,
    and $\varphi$ is 0 there. The momentum is given in the base frame.
    """
    base = multiply(jnp.asarray(_CYCLE), conjugate(make_momentum_frame(angular_momentum)))
    w, x, y, z = jnp.moveaxis(multiply(base, attitude), -1, 0)
    # Classic z-x-z: q = (cos cos(sum), sin cos(difference), sin sin(difference), cos sin(sum)) of half angles.
    sine, cosine = x**2 + y**2, w**2 + z**2
    flat = sine < 1e-30
    upside = cosine < 1e-30
    total = jnp.arctan2(jnp.where(upside, 0.0, z), jnp.where(upside, 1.0, w))
    difference = jnp.arctan2(jnp.where(flat, 0.0, y), jnp.where(flat, 1.0, x))
    difference = jnp.where(flat, total, difference)
    total = jnp.where(upside, difference, total)
    nutation = 2.0 * jnp.arctan2(safe_sqrt(sine), safe_sqrt(cosine))
    return jnp.stack([_wrap(total + difference), nutation, _wrap(total - difference)], axis=-1)


def from_euler_angles(angles: Array, angular_momentum: Array) -> Array:
    """Attitudes (..., 4) of given precession, nutation and spin (..., 3) [rad], the inverse of `to_euler_angles`."""
    precession, nutation, spin = jnp.moveaxis(0.5 * angles, -1, 0)
    total, difference = precession + spin, precession - spin
    own = jnp.stack([jnp.cos(nutation) * jnp.cos(total), jnp.sin(nutation) * jnp.cos(difference),
                     jnp.sin(nutation) * jnp.sin(difference), jnp.cos(nutation) * jnp.sin(total)], axis=-1)
    return multiply(multiply(make_momentum_frame(angular_momentum), conjugate(jnp.asarray(_CYCLE))), own)


def measure_motion(inertia: Array, attitude: Array, angular_velocity: Array) -> Array:
    """Euler angles along a motion, (times, 3) [rad], about its own angular momentum at the start.

    Inertia as of `measure_nutation`, attitude (times, 4), angular velocity, body components, (times, 3) [rad/s].
    """
    return to_euler_angles(attitude, measure_momentum(inertia, attitude[0], angular_velocity[0]))


def _wrap(angle: Array) -> Array:
    """Into -pi to pi."""
    return angle - 2.0 * jnp.pi * jnp.round(angle / (2.0 * jnp.pi))
