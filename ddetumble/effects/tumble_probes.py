"""Probes for tumbling records: what a missing torque depends on (see `probes`)."""

from typing import ClassVar, final

import jax.numpy as jnp
from jaxtyping import Array

from .._rotation import rotate_back
from ..contact.effect import AbstractEffect, Scalar, parameter
from ..contact.torque import AbstractGyroEffect, AbstractTorque, Spin, Vector


SPEED, SPAN = 0.1, 1000.0  # rad/s and s in which the probes' amplitudes count


@final
class DragProbe(AbstractTorque):
    """A drag that grows with the square of the speed."""

    k: Scalar = parameter("", 0.0, typical=1e-5, starts=(1e-5,))
    id: ClassVar[str] = "probe-drag"
    law: ClassVar[str] = "torque -k |omega| omega"
    reference: ClassVar[str] = "probe"
    variable: ClassVar[str] = "angular_speed"

    def torque(self, spin: Spin) -> Vector:
        """-k |omega| omega [1/s²]."""
        omega = spin.angular_velocity
        return -self.k * jnp.sqrt(jnp.sum(omega**2) + 1e-300) * omega


@final
class AxialProbe(AbstractTorque):
    """A drag on the axial rate alone."""

    k: Scalar = parameter("1/s", 0.0, typical=1e-6, starts=(1e-6,))
    id: ClassVar[str] = "probe-axial"
    law: ClassVar[str] = "torque -k omega_z about body z"
    reference: ClassVar[str] = "probe"
    variable: ClassVar[str] = "angular_velocity_z"

    def torque(self, spin: Spin) -> Vector:
        """-k omega_z about body z [1/s²]."""
        return -self.k * spin.angular_velocity * jnp.array([0.0, 0.0, 1.0])


@final
class GrowthProbe(AbstractTorque):
    """A torque in the body frame that grows with time."""

    x: Scalar = parameter("1/s**2", 0.0, typical=1e-7, starts=(3e-8,))
    y: Scalar = parameter("1/s**2", 0.0, typical=1e-7, starts=(3e-8,))
    z: Scalar = parameter("1/s**2", 0.0, typical=1e-7, starts=(3e-8,))
    id: ClassVar[str] = "probe-growth"
    law: ClassVar[str] = "torque (x, y, z) t / 1000 s"
    reference: ClassVar[str] = "probe"
    variable: ClassVar[str] = "time"

    def torque(self, spin: Spin) -> Vector:
        """(x, y, z) t / 1000 s [1/s²]."""
        return jnp.stack([self.x, self.y, self.z]) * spin.time / SPAN


@final
class FadeProbe(AbstractTorque):
    """A drag that changes with time."""

    k: Scalar = parameter("1/s", 0.0, typical=1e-6, starts=(1e-6,))
    id: ClassVar[str] = "probe-fade"
    law: ClassVar[str] = "torque -k omega t / 1000 s"
    reference: ClassVar[str] = "probe"
    variable: ClassVar[str] = "time"

    def torque(self, spin: Spin) -> Vector:
        """-k omega t / 1000 s [1/s²]."""
        return -self.k * spin.angular_velocity * spin.time / SPAN


@final
class InertialProbe(AbstractTorque):
    """A torque that is constant in the inertial frame."""

    x: Scalar = parameter("1/s**2", 0.0, typical=1e-7, starts=(3e-8,))
    y: Scalar = parameter("1/s**2", 0.0, typical=1e-7, starts=(3e-8,))
    z: Scalar = parameter("1/s**2", 0.0, typical=1e-7, starts=(3e-8,))
    id: ClassVar[str] = "probe-inertial"
    law: ClassVar[str] = "torque (x, y, z) in the inertial frame"
    reference: ClassVar[str] = "probe"
    variable: ClassVar[str] = "attitude"

    def torque(self, spin: Spin) -> Vector:
        """The constant, turned into body components [1/s²]."""
        return rotate_back(spin.attitude, jnp.stack([self.x, self.y, self.z]))


@final
class WaveProbe(AbstractTorque):
    """A torque in the body frame that repeats in time."""

    x: Scalar = parameter("1/s**2", 0.0, typical=1e-7, starts=(3e-8,))
    y: Scalar = parameter("1/s**2", 0.0, typical=1e-7, starts=(3e-8,))
    z: Scalar = parameter("1/s**2", 0.0, typical=1e-7, starts=(3e-8,))
    u: Scalar = parameter("1/s**2", 0.0, typical=1e-7, starts=(3e-8,))
    v: Scalar = parameter("1/s**2", 0.0, typical=1e-7, starts=(3e-8,))
    w: Scalar = parameter("1/s**2", 0.0, typical=1e-7, starts=(3e-8,))
    frequency: Scalar = parameter("Hz", 0.01, kind="shape", typical=0.001, coordinate="log", bounds=(1e-6, 1e3))
    id: ClassVar[str] = "probe-wave"
    law: ClassVar[str] = "torque (x, y, z) sin(2 pi f t) + (u, v, w) cos(2 pi f t)"
    reference: ClassVar[str] = "probe"
    variable: ClassVar[str] = "time"
    line: ClassVar[str] = "probe-wave.frequency"

    def torque(self, spin: Spin) -> Vector:
        """(x, y, z) sin(2 pi f t) + (u, v, w) cos(2 pi f t) [1/s²]."""
        phase = 2.0 * jnp.pi * self.frequency * spin.time
        return (jnp.stack([self.x, self.y, self.z]) * jnp.sin(phase)
                + jnp.stack([self.u, self.v, self.w]) * jnp.cos(phase))


@final
class DriftProbe(AbstractGyroEffect):
    """Gyroscopes whose bias drifts."""

    x: Scalar = parameter("rad/s", 0.0, typical=1e-4, starts=(3e-5,))
    y: Scalar = parameter("rad/s", 0.0, typical=1e-4, starts=(3e-5,))
    z: Scalar = parameter("rad/s", 0.0, typical=1e-4, starts=(3e-5,))
    id: ClassVar[str] = "probe-drift"
    law: ClassVar[str] = "measured rates gain (x, y, z) t / 1000 s"
    reference: ClassVar[str] = "probe"
    variable: ClassVar[str] = "time"
    order: ClassVar[int] = 4

    def reading(self, angular_velocity: Array, time: Array) -> Array:
        """Omega + (x, y, z) t / 1000 s [rad/s]."""
        return angular_velocity + jnp.stack([self.x, self.y, self.z]) * time[:, None] / SPAN


@final
class TiltProbe(AbstractGyroEffect):
    """Gyroscopes turned about body x, which axis-misalignment does not hold."""

    angle: Scalar = parameter("rad", 0.0, typical=0.01, starts=(0.003,), bounds=(-1.5, 1.5))
    id: ClassVar[str] = "probe-tilt"
    law: ClassVar[str] = "components in a frame turned by angle about body x"
    reference: ClassVar[str] = "probe"
    variable: ClassVar[str] = "angular_velocity_y"
    order: ClassVar[int] = 0

    def reading(self, angular_velocity: Array, time: Array) -> Array:
        """R_x(angle)^T omega [rad/s]."""
        x, y, z = angular_velocity[..., 0], angular_velocity[..., 1], angular_velocity[..., 2]
        c, s = jnp.cos(self.angle), jnp.sin(self.angle)
        return jnp.stack([x, c * y + s * z, c * z - s * y], axis=-1)


TUMBLE_PROBES: tuple[type[AbstractEffect], ...] = (
    DragProbe, AxialProbe, GrowthProbe, FadeProbe, InertialProbe, WaveProbe, DriftProbe, TiltProbe,
)
