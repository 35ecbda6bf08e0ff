r"""Unit quaternions: scalar first, $q = (w, x, y, z)$, turning body components into inertial ones.

All functions work along the last axis and broadcast over the others.
"""

import jax.numpy as jnp
from jaxtyping import Array

from ._numerics import safe_sqrt


def normalise(quaternion: Array) -> Array:
    """The unit quaternion in the same direction, shape (..., 4) [-]."""
    return quaternion / jnp.sqrt(jnp.sum(quaternion**2, axis=-1, keepdims=True))


def conjugate(quaternion: Array) -> Array:
    r"""$q^* = (w, -x, -y, -z)$, the inverse of a unit quaternion, shape (..., 4) [-]."""
    return jnp.concatenate([quaternion[..., :1], -quaternion[..., 1:]], axis=-1)


def multiply(first: Array, second: Array) -> Array:
    r"""Hamilton's product $p \otimes q$: turns by `second`, then by `first`, shapes (..., 4) [-]."""
    p, q = first, second
    a, u = p[..., :1], p[..., 1:]
    b, v = q[..., :1], q[..., 1:]
    return jnp.concatenate([a * b - jnp.sum(u * v, axis=-1, keepdims=True), a * v + b * u + jnp.cross(u, v)], axis=-1)


def rotate(attitude: Array, vector: Array) -> Array:
    r"""Body components to inertial ones, $v' = q \otimes v \otimes q^*$, shapes (..., 4), (..., 3) to (..., 3)."""
    w, u = attitude[..., :1], attitude[..., 1:]
    twice = 2.0 * jnp.cross(u, vector)
    return vector + w * twice + jnp.cross(u, twice)


def rotate_back(attitude: Array, vector: Array) -> Array:
    """Inertial components to body ones, the inverse of `rotate`; same shapes."""
    return rotate(conjugate(attitude), vector)


def from_matrix(matrix: Array) -> Array:
    r"""Unit quaternion (..., 4) of a proper rotation matrix (..., 3, 3), with $w \ge 0$ where it is not tiny.

    The matrix gives all products $4 q_i q_j$; the row of the largest diagonal is the quaternion times a number that is
    at least 1, so that nothing cancels (S. W. Shepperd, J. Guidance and Control 1 (1978) 223).
    """
    def entry(i, j):
        return matrix[..., i, j]

    xx, yy, zz = entry(0, 0), entry(1, 1), entry(2, 2)
    wx, wy, wz = entry(2, 1) - entry(1, 2), entry(0, 2) - entry(2, 0), entry(1, 0) - entry(0, 1)
    xy, xz, yz = entry(0, 1) + entry(1, 0), entry(0, 2) + entry(2, 0), entry(1, 2) + entry(2, 1)
    products = jnp.stack([
        jnp.stack([1 + xx + yy + zz, wx, wy, wz], axis=-1), jnp.stack([wx, 1 + xx - yy - zz, xy, xz], axis=-1),
        jnp.stack([wy, xy, 1 - xx + yy - zz, yz], axis=-1), jnp.stack([wz, xz, yz, 1 - xx - yy + zz], axis=-1),
    ], axis=-2)
    largest = jnp.argmax(jnp.diagonal(products, axis1=-2, axis2=-1), axis=-1)
    row = jnp.take_along_axis(products, largest[..., None, None], axis=-2)[..., 0, :]
    return normalise(jnp.where(row[..., :1] < 0, -row, row))


def from_rotation_vector(vector: Array) -> Array:
    r"""Unit quaternion (..., 4) of a turn by $|v|$ [rad] about $v$ (..., 3); smooth at zero.

    $q = (\cos |v|/2, \; v \sin(|v|/2)/|v|)$.
    """
    square = jnp.sum(vector**2, axis=-1, keepdims=True)
    small = square < 1e-4
    half = 0.5 * jnp.sqrt(jnp.where(small, 1.0, square))
    quarter = 0.25 * jnp.where(small, square, 0.0)  # of the square: (half angle)^2
    cosine = jnp.where(small, 1 - quarter / 2 * (1 - quarter / 12 * (1 - quarter / 30)), jnp.cos(half))
    share = jnp.where(small, 1 - quarter / 6 * (1 - quarter / 20 * (1 - quarter / 42)), jnp.sin(half) / half)
    return jnp.concatenate([cosine, 0.5 * share * vector], axis=-1)


def to_rotation_vector(attitude: Array) -> Array:
    r"""Axis times angle, 0 to pi, of a unit quaternion, shapes (..., 4) to (..., 3) [rad]; smooth at no turn.

    $v = 2 u \arctan(|u|/w)/|u|$ with $w \ge 0$.
    """
    q = jnp.where(attitude[..., :1] < 0, -attitude, attitude)
    w, u = q[..., :1], q[..., 1:]
    square = jnp.sum(u**2, axis=-1, keepdims=True)
    small = square < 1e-8
    size = jnp.sqrt(jnp.where(small, 1.0, square))
    tangent = jnp.where(small, square, 0.0) / jnp.where(small, w, 1.0) ** 2
    near = (1 - tangent / 3 * (1 - 0.6 * tangent)) / jnp.where(small, w, 1.0)
    return 2.0 * u * jnp.where(small, near, jnp.arctan2(size, w) / size)


def turn(attitude: Array, angular_velocity: Array) -> Array:
    r"""Rate of the attitude (..., 4) [1/s], $\dot q = \frac{1}{2} q \otimes (0, \omega)$, body components [rad/s]."""
    w, u = attitude[..., :1], attitude[..., 1:]
    scalar = -jnp.sum(u * angular_velocity, axis=-1, keepdims=True)
    return 0.5 * jnp.concatenate([scalar, w * angular_velocity + jnp.cross(u, angular_velocity)], axis=-1)


def measure_turn(first: Array, second: Array) -> Array:
    """Angle between two attitudes, whatever the signs of the quaternions, shape (...) [rad]."""
    between = multiply(conjugate(first), second)
    u = between[..., 1:]
    return 2.0 * jnp.arctan2(safe_sqrt(jnp.sum(u**2, axis=-1)), jnp.abs(between[..., 0]))
