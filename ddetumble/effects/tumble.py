"""Effects on tumbling records: what a torque-free rigid body with perfect gyroscopes leaves out."""

from typing import Any, ClassVar, final

import jax.numpy as jnp
from jaxtyping import Array

from .._numerics import safe_sqrt
from .._rotation import from_rotation_vector, rotate_back
from ..contact.effect import AbstractEffect, Scalar, parameter
from ..contact.torque import (
    AbstractGyroEffect,
    AbstractInertiaEffect,
    AbstractInnerTorque,
    AbstractTorque,
    Spin,
    Vector,
    cross,
)


def _declare_axial(most: float, reason: str) -> Any:
    """Coefficient about the symmetry axis over the transverse one, held at 1 until it is freed."""
    return parameter("", 1.0, name="axial", kind="shape", typical=0.5, coordinate="log", bounds=(1e-3, 30.0),
                     free=False, starts=(0.5,), text="coefficient about the symmetry axis over the transverse one",
                     limits=(0.0, most), limits_reason=reason)


def _brake(rates: Vector, axial: Scalar) -> Vector:
    """Rates (3,) [rad/s] as a body of revolution is braked about its axes: the axial one counts `axial` times."""
    return jnp.stack([rates[0], rates[1], axial * rates[2]])


@final
class EddyCurrent(AbstractTorque):
    r"""Eddy currents in the Earth's field brake the rotation: torque $-k_e (\omega_x, \omega_y, a\,\omega_z)$.

    In a field that meets the body from all sides in turn, the mean torque of $(M(\omega \times B)) \times B$ is
    $-\tfrac13 B^2 (\mathrm{tr} M - M)\,\omega$; the magnetic tensor of a body of revolution, $(M_t, M_t, M_z)$, then
    gives $a$ = `axial` = $2 M_t / (M_t + M_z)$, 1 for a sphere.
    """

    k_e: Scalar = parameter("1/s", 0.0, typical=1e-4, sign=1, starts=(1e-6,), text="braking rate", limits=(0.0, 0.1),
                            limits_reason="orbiting bodies brake over hours to years; what brakes within 10 s is no "
                                          "eddy current")
    axial: Scalar = _declare_axial(2.0, "2 M_t/(M_t + M_z) of the magnetic tensor: 0 for a flat disc, 2 where M_z is "
                                        "nothing beside M_t")
    id: ClassVar[str] = "eddy-current"
    law: ClassVar[str] = "torque -k_e (omega_x, omega_y, axial omega_z)"
    reference: ClassVar[str] = "Smith 1962, NASA TN D-1284; Praly et al. 2012, Acta Astronautica 76, 145"

    def torque(self, spin: Spin) -> Vector:
        """-k_e (omega_x, omega_y, axial omega_z) [1/s²]."""
        return -self.k_e * _brake(spin.angular_velocity, self.axial)


@final
class QuadraticDrag(AbstractTorque):
    r"""Air drags on a body that turns fast: torque $-k |\omega| (\omega_x, \omega_y, a\,\omega_z)$, $a$ = `axial`.

    A flat body of area $A$ that reaches $r$ far from its axis has $k \approx \rho C_D A r^3 / 8 I$, $I$ its transverse
    moment of inertia, $\rho$ the density of the air and $C_D \approx 1.2$. The rate of pure spin falls as
    $1/(1 + k \omega_0 t)$ about a transverse axis.
    """

    k: Scalar = parameter("", 0.0, typical=1e-3, sign=1, starts=(1e-5,), limits=(0.0, 10.0),
                          text="drag torque over transverse inertia, over the square of the rate",
                          limits_reason="about the mass of the air that the body sweeps over its own: 0.03 for a "
                                        "racket, 1 for a sheet of paper")
    axial: Scalar = _declare_axial(10.0, "0 for a smooth body of revolution, whose own spin meets the friction of its "
                                         "skin alone; a wheel of vanes has a few")
    id: ClassVar[str] = "quadratic-drag"
    law: ClassVar[str] = "torque -k |omega| (omega_x, omega_y, axial omega_z)"
    reference: ClassVar[str] = "Hoerner 1965, Fluid-Dynamic Drag, chapter III"

    def torque(self, spin: Spin) -> Vector:
        """-k |omega| (omega_x, omega_y, axial omega_z) [1/s²]."""
        rates = spin.angular_velocity
        return -self.k * safe_sqrt(jnp.sum(rates**2)) * _brake(rates, self.axial)


def _declare_torque(k: int) -> Any:
    return parameter("1/s**2", 0.0, name=f"torque.{k}", typical=1e-5, starts=(3e-8,), text=f"body {'xyz'[k]} component",
                     limits=(-1.0, 1.0), limits_reason="a stuck thruster, 20 N at 2 m on 100 kg m2, gives 0.4")


@final
class ConstantTorque(AbstractTorque):
    """A constant torque in the body frame (a leak, a stuck thruster)."""

    torque_0: Scalar = _declare_torque(0)
    torque_1: Scalar = _declare_torque(1)
    torque_2: Scalar = _declare_torque(2)
    id: ClassVar[str] = "constant-torque"
    law: ClassVar[str] = "constant torque in the body frame"
    reference: ClassVar[str] = "Longuski 1980, AIAA paper 80-1642"

    def torque(self, spin: Spin) -> Vector:
        """The constant [1/s²]."""
        return jnp.stack([self.torque_0, self.torque_1, self.torque_2])


@final
class InertiaAsymmetry(AbstractInertiaEffect):
    r"""No body of revolution: transverse moments $1 \pm \epsilon$."""

    epsilon: Scalar = parameter("", 0.0, typical=0.01, starts=(0.003,), bounds=(-0.5, 0.5), text="asymmetry",
                                limits=(-1.0, 1.0), limits_reason="at 1 one transverse moment vanishes")
    id: ClassVar[str] = "inertia-asymmetry"
    law: ClassVar[str] = "transverse moments 1 + epsilon, 1 - epsilon"
    reference: ClassVar[str] = "Landau & Lifshitz, Mechanics, section 37"

    def moments(self) -> Vector:
        """(epsilon, -epsilon, 0) [-]."""
        return jnp.stack([self.epsilon, -self.epsilon, jnp.zeros_like(self.epsilon)])


_EIGHTH = "beyond an eighth of a turn the axes are exchanged, not misaligned"


def _declare_tilt(axis: str) -> Any:
    return parameter("rad", 0.0, name=f"angle_{axis}", typical=0.01, starts=(0.003,), bounds=(-1.5, 1.5), free=False,
                     text=f"component about body {axis}", limits=(-0.8, 0.8), limits_reason=_EIGHTH)


@final
class AxisMisalignment(AbstractGyroEffect):
    r"""Gyroscopes in a frame turned by the rotation vector $a$ = (`angle_x`, `angle`, `angle_z`): $R(a)^T \omega$.

    All three turns are one about the axis $a$ (none comes first); `angle` alone turns about body y. Without torque a
    body of revolution shows where its axis lies among the gyroscopes, which two components say; the third is a phase of
    the motion, unless the attitude is measured or an inertia asymmetry marks the transverse axes. So `angle_x` and
    `angle_z` are held at 0, and each is freed only where that predicts better.
    """

    angle: Scalar = parameter("rad", 0.0, typical=0.01, starts=(0.003,), bounds=(-1.5, 1.5), text="angle about body y",
                              limits=(-0.8, 0.8), limits_reason=_EIGHTH)
    angle_x: Scalar = _declare_tilt("x")
    angle_z: Scalar = _declare_tilt("z")
    id: ClassVar[str] = "axis-misalignment"
    law: ClassVar[str] = "components in a frame turned by the vector a = (angle_x, angle, angle_z): R(a)^T omega"
    reference: ClassVar[str] = "IEEE Std 1431-2004, misalignment of a gyroscope"
    order: ClassVar[int] = 1

    def reading(self, angular_velocity: Array, time: Array) -> Array:
        """R(angle_x, angle, angle_z)^T omega [rad/s]."""
        turn = from_rotation_vector(jnp.stack([self.angle_x, self.angle, self.angle_z]))
        # One matrix for all samples: a quaternion for each took most of the time of long records.
        return angular_velocity @ rotate_back(turn, jnp.eye(3))


@final
class InternalDamper(AbstractInnerTorque):
    r"""A sphere in a viscous fluid inside (fuel slosh): torque $-c(\omega - \omega_d)$.

    Inside, $I_d (\dot\omega_d + \omega \times \omega_d) = c(\omega - \omega_d)$ in body components, with $\omega_d$
    starting at the body's rate; the body's moments exclude the sphere.
    """

    c: Scalar = parameter("1/s", 0.0, typical=1e-3, sign=1, starts=(1e-5,), text="coupling", limits=(0.0, 10.0),
                          limits_reason="the coupling brakes; a fluid that couples within 0.1 s moves with the body")
    # Bounded by what physics allows: records shorter than I_d/c tell only c, and a fit would run off towards a sphere
    # at rest, which is an eddy current.
    I_d: Scalar = parameter("", 0.03, kind="shape", typical=0.02, coordinate="log", bounds=(1e-4, 2.0),
                            starts=(0.01, 0.05, 0.25), text="moment of the sphere over the transverse one",
                            limits=(1e-4, 2.0), limits_reason="propellant or a ball: at most about twice the body")
    id: ClassVar[str] = "internal-damper"
    law: ClassVar[str] = "torque -c (omega - omega_d), I_d (domega_d/dt + omega x omega_d) = c (omega - omega_d)"
    reference: ClassVar[str] = "Kane & Levinson 1980, J. Guidance and Control 3, 37"

    def torque(self, spin: Spin) -> Vector:
        """-c (omega - omega_d) [1/s²]."""
        return -self.c * (spin.angular_velocity - spin.inner)

    def start(self, angular_velocity: Vector) -> Vector:
        """The body's rate [rad/s]."""
        return angular_velocity

    def accelerate(self, spin: Spin) -> Vector:
        """c (omega - omega_d) / I_d - omega x omega_d [rad/s²]."""
        pull = self.c / self.I_d * (spin.angular_velocity - spin.inner)
        return pull - cross(spin.angular_velocity, spin.inner)


@final
class GravityGradient(AbstractTorque):
    r"""Gravity gradient: `scale` times $3 n^2\, \hat o \times I \hat o$, $\hat o$ the local vertical."""

    scale: Scalar = parameter("", 0.0, typical=1.0, sign=1, starts=(0.5,), text="scale; 1 is the full torque",
                              limits=(0.0, 60.0),
                              limits_reason="1 on a circular orbit, (1 - e)^-3 at perigee: 57 on a Molniya orbit")
    id: ClassVar[str] = "gravity-gradient"
    law: ClassVar[str] = "torque scale 3 n^2 o x I o, o the local vertical, n the orbit rate"
    reference: ClassVar[str] = "Hughes 1986, Spacecraft Attitude Dynamics, section 8.1"
    requires: ClassVar[tuple[str, ...]] = ("orbit_rate",)

    def torque(self, spin: Spin) -> Vector:
        """Scale times 3 n² o x I o [1/s²]."""
        return self.scale * 3.0 * spin.orbit_rate**2 * cross(spin.vertical, spin.moments * spin.vertical)


def _declare_bias(k: int) -> Any:
    return parameter("rad/s", 0.0, name=f"bias.{k}", typical=1e-3, starts=(3e-5,), text=f"of the {'xyz'[k]} rate",
                     limits=(-0.5, 0.5),
                     limits_reason="zero-rate offset of consumer gyroscopes, up to 20 degrees per second, 0.35 rad/s")


@final
class GyroBias(AbstractGyroEffect):
    """A constant bias of the measured rates, added last."""

    bias_0: Scalar = _declare_bias(0)
    bias_1: Scalar = _declare_bias(1)
    bias_2: Scalar = _declare_bias(2)
    id: ClassVar[str] = "gyro-bias"
    law: ClassVar[str] = "measured rates gain bias, last"
    reference: ClassVar[str] = "Farrenkopf 1978, J. Guidance and Control 1, 282"
    order: ClassVar[int] = 3

    def reading(self, angular_velocity: Array, time: Array) -> Array:
        """Omega + bias [rad/s]."""
        return angular_velocity + jnp.stack([self.bias_0, self.bias_1, self.bias_2])


@final
class GyroScale(AbstractGyroEffect):
    """A wrong scale factor: rates times 1 + g. Torque-free, it is the same as another inertia ratio."""

    g: Scalar = parameter("", 0.0, typical=0.01, starts=(0.003,), bounds=(-0.5, 0.5), text="error of the scale factor",
                          limits=(-0.2, 0.2), limits_reason="tolerance of consumer gyroscopes, up to 10 %")
    id: ClassVar[str] = "gyro-scale"
    law: ClassVar[str] = "measured rates times 1 + g, after misalignment, before bias"
    reference: ClassVar[str] = "IEEE Std 1431-2004, scale factor of a gyroscope"
    order: ClassVar[int] = 2

    def reading(self, angular_velocity: Array, time: Array) -> Array:
        """(1 + g) omega [rad/s]."""
        return (1.0 + self.g) * angular_velocity


TUMBLE: tuple[type[AbstractEffect], ...] = (
    EddyCurrent, QuadraticDrag, ConstantTorque, InertiaAsymmetry, AxisMisalignment, InternalDamper, GravityGradient,
    GyroBias, GyroScale,
)
