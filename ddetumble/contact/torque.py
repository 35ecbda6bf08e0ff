"""The law of tumbling: a rigid body in free fall, with effects applied to it: torques, inertia, gyroscopes.

Moments and torques are per unit transverse inertia; body z is the symmetry axis, and the moments of the reference body
are (1, 1, `inertia_ratio`). At t = 0 the body frame coincides with an inertial frame whose x axis is the local vertical
and whose z axis is the orbit normal.

A torque that needs a rotation of its own (fuel, a wheel) is an `AbstractInnerTorque`. A torque of one's own:

    class Jet(AbstractTorque):
        push: Scalar = parameter("1/s**2", 0.0, typical=1e-7, text="torque of the leak about body z")
        tau: Scalar = parameter("s", 200.0, kind="shape", typical=100.0, coordinate="log", bounds=(1.0, 1e5))
        id: ClassVar[str] = "jet"
        law: ClassVar[str] = "torque push exp(-t/tau) about body z"
        reference: ClassVar[str] = "a tank that blows off"

        def torque(self, spin: Spin) -> Vector:
            return self.push * jnp.exp(-spin.time / self.tau) * jnp.array([0.0, 0.0, 1.0])

`check_effect(Jet)` proves that it keeps the contract; `ddetumble discover CAMPAIGN --effect FILE.py:Jet` tries it.
"""

import abc
from collections.abc import Mapping
from typing import Any, ClassVar, final

import equinox as eqx
import jax.numpy as jnp
from equinox import AbstractClassVar
from jaxtyping import Array, Float

from .effect import AbstractEffect, AbstractLaw, AbstractModel, Scalar, parameter


Vector = Float[Array, "3"]


@final
class Spin(eqx.Module):
    """The state of the motion that an effect sees (the caller batches by `vmap`).

    Attributes:
        time: since the record's t = 0 [s].
        angular_velocity: of the body, body components, shape (3,) [rad/s].
        attitude: unit quaternion, scalar first, body to inertial, shape (4,) [-].
        vertical: unit vector of the local vertical, body components, shape (3,) [-].
        moments: of the body, over the transverse one, shape (3,) [-].
        orbit_rate: n [rad/s]; 0 where the campaign has none.
        conditions: every condition of the record by name, SI.
        inner: angular velocity of the effect's own inner body, body components, shape (3,) [rad/s]; 0 without one.
    """

    time: Scalar
    angular_velocity: Vector
    attitude: Float[Array, "4"]
    vertical: Vector
    moments: Vector
    orbit_rate: Scalar
    conditions: Mapping[str, Array]
    inner: Vector


class AbstractInertiaEffect(AbstractEffect):
    """Changes the body's moments of inertia."""

    stage: ClassVar[str] = "inertia"
    family: ClassVar[str] = "tumble"

    @abc.abstractmethod
    def moments(self) -> Vector:
        """Increment of the three moments over the transverse one [-]; 0 at the null."""


class AbstractTorque(AbstractEffect):
    """A torque on the body."""

    stage: ClassVar[str] = "torque"
    family: ClassVar[str] = "tumble"

    @abc.abstractmethod
    def torque(self, spin: Spin) -> Vector:
        """Torque over the transverse inertia, body components [1/s²]; 0 at the null."""


class AbstractInnerTorque(AbstractTorque):
    """A torque that comes from a body inside, whose angular velocity is integrated along (`Spin.inner`)."""

    @abc.abstractmethod
    def start(self, angular_velocity: Vector) -> Vector:
        """Angular velocity of the inner body at t = 0, body components [rad/s]."""

    @abc.abstractmethod
    def accelerate(self, spin: Spin) -> Vector:
        """Rate of change of its body components, which turn with the body [rad/s²]."""


class AbstractGyroEffect(AbstractEffect):
    """Changes what the gyroscopes read; effects act in ascending `order`, the attitude is measured without them."""

    stage: ClassVar[str] = "gyroscope"
    family: ClassVar[str] = "tumble"
    order: AbstractClassVar[int]

    @abc.abstractmethod
    def reading(self, angular_velocity: Array, time: Array) -> Array:
        """Reading for rates given over time, shapes (samples, 3), (samples,) to (samples, 3) [rad/s], [s]."""


@final
class RigidBody(AbstractModel):
    r"""Torque-free rotation of a body of revolution, $I\dot\omega + \omega \times I\omega = 0$, $I = (1, 1, r)$."""

    inertia_ratio: Scalar = parameter("", 0.5, kind="reference", typical=0.1, coordinate="log", bounds=(0.0, 2.0),
                                      text="axial over transverse moment of inertia", limits=(0.0, 2.0),
                                      limits_reason="a body of revolution: a thin rod has 0, a flat disc 2")
    orbit_rate: Scalar = parameter("rad/s", 0.0, kind="reference", typical=1e-3, free=False,
                                   text="angular velocity of the orbit", limits=(0.0, 2e-3),
                                   limits_reason="1.24e-3 at the surface of a planet as dense as the Earth")
    family: ClassVar[str] = "tumble"

    def moments(self) -> Vector:
        """Principal moments over the transverse one, (1, 1, r) [-]."""
        one = jnp.ones_like(self.inertia_ratio)
        return jnp.stack([one, one, self.inertia_ratio])

    def extend(self, effects: tuple[AbstractEffect, ...]) -> "TumbleLaw":
        """This body with effects."""
        return TumbleLaw(self, effects)


@final
class TumbleLaw(AbstractLaw):
    """A rigid body and the effects that extend it; moments and torques add, gyroscope effects act one after another.

    Attributes:
        reference: the body.
        effects: any number of effects, at their null or not.
    """

    reference: RigidBody
    effects: tuple[AbstractEffect, ...] = ()

    @property
    def inner(self) -> list[Any]:
        """Effects with a body of their own, in the order of their states."""
        return [effect for effect in self.effects if isinstance(effect, AbstractInnerTorque)]

    def moments(self) -> Vector:
        """Principal moments over the transverse one [-]."""
        moments = self.reference.moments()
        for effect in self.pick("inertia"):
            moments = moments + effect.moments()
        return moments

    def accelerate(self, spin: Spin, inner: Array) -> tuple[Vector, Array]:
        r"""Angular acceleration of the body and of the inner bodies, shapes (3,) and (inner bodies, 3) [rad/s²].

        Euler's equations $\dot\omega = I^{-1}(\tau - \omega \times I\omega)$ at `spin`, in which `inner` is not read;
        `inner` are the angular velocities of the inner bodies, shape (inner bodies, 3) [rad/s].
        """
        omega, moments = spin.angular_velocity, spin.moments
        total = -cross(omega, moments * omega)
        own = []
        for effect in self.pick("torque"):
            seen = spin
            if isinstance(effect, AbstractInnerTorque):
                seen = eqx.tree_at(lambda s: s.inner, spin, inner[len(own)])
                own.append(effect.accelerate(seen))
            total = total + effect.torque(seen)
        return total / moments, jnp.stack(own) if own else jnp.zeros_like(inner)

    def start(self, angular_velocity: Vector) -> Array:
        """Angular velocities of the inner bodies at t = 0, shape (inner bodies, 3) [rad/s]."""
        return jnp.stack([e.start(angular_velocity) for e in self.inner]) if self.inner else jnp.zeros((0, 3))

    def read(self, angular_velocity: Array, time: Array) -> Array:
        """What the gyroscopes read for rates over time, shapes (samples, 3), (samples,) [rad/s], [s]."""
        for effect in sorted(self.pick("gyroscope"), key=lambda e: e.order):
            angular_velocity = effect.reading(angular_velocity, time)
        return angular_velocity


def cross(a: Array, b: Array) -> Array:
    """Cross product along the last axis, shapes (..., 3); one multiplication less than `jnp.cross` to compile."""
    return jnp.stack([a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1], a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2],
                      a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]], axis=-1)
