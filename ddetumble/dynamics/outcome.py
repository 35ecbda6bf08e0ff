"""What one impact on debris in free fall leaves: both bodies after it, and where momentum and energy went."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ..contact.effect import Scalar


class Course(eqx.Module):
    """The contact at shares of its duration, shape (places,) each.

    Attributes:
        time: since first touch [s].
        depression, rate: of the ball [m], [m/s].
        pressure: of the gas, absolute [Pa].
        normal_force: on the debris [N].
        friction: on the debris, inertial components, shape (places, 3) [N].
        slip_speed: of the ball over the surface [m/s].
        margins: from the rim of the contact disc to each edge of the face, shape (places, edges) [m].
    """

    time: Float[Array, " places"]
    depression: Float[Array, " places"]
    rate: Float[Array, " places"]
    pressure: Float[Array, " places"]
    normal_force: Float[Array, " places"]
    friction: Float[Array, "places 3"]
    slip_speed: Float[Array, " places"]
    margins: Float[Array, "places edges"]


class Ledger(eqx.Module):
    """Where momentum and energy went, inertial components.

    Attributes:
        arm_impulse: of the arm's drive, shape (3,) [N s].
        arm_moment: of the arm about the origin: of its drive, of the mount that keeps the ball from turning (or of what
            turns the ball), and of the guidance that makes the apparent mass differ by direction, shape (3,) [N m s].
        arm_work: done by the drive [J].
        normal_loss, friction_loss, rolling_loss: taken by contact, patch and rolling [J].
        tip_before, tip_after: linear momentum of the apparent mass, shape (3,) [N s].
        tip_moment_before, tip_moment_after: its angular momentum about the origin, shape (3,) [N m s].
        debris_before, debris_after: angular momentum of the debris about the origin, shape (3,) [N m s].
        energy_before, energy_after: of both bodies and the ball's rolling [J].
    """

    arm_impulse: Array
    arm_moment: Array
    arm_work: Array
    normal_loss: Array
    friction_loss: Array
    rolling_loss: Array
    tip_before: Array
    tip_after: Array
    tip_moment_before: Array
    tip_moment_after: Array
    debris_before: Array
    debris_after: Array
    energy_before: Array
    energy_after: Array


class Collision(eqx.Module):
    """Both bodies after one impact, in the frame in which the debris' centre of mass rested at the origin.

    Attributes:
        attitude: of the debris at separation, unit quaternion, shape (4,) [-].
        angular_velocity: of the debris at separation, body components, shape (3,) [rad/s].
        angular_momentum: of the debris about its centre of mass, inertial, shape (3,) [N m s].
        velocity: of its centre of mass, shape (3,) [m/s].
        displacement: of its centre of mass, shape (3,) [m].
        impulse: of the contact force on the debris, shape (3,) [N s].
        arm_velocity: of the ball, shape (3,) [m/s].
        normal: outward at first touch, inertial, shape (3,) [-].
        approach_speed, tangential_speed: along the normal and across, at first touch [m/s].
        separation: time of separation [s].
        peak_force, peak_depression, peak_pressure: largest values [N], [m], [Pa].
        margins: least distance of the contact disc from each edge; below zero it reaches over one, shape (edges,) [m].
        course: the contact over its duration.
        ledger: momentum and energy.
        separated: whether they separated within the span.
        failed: whether the integration failed, the ball did not approach, or something is not finite.
        steps: integration steps taken.
    """

    attitude: Float[Array, " 4"]
    angular_velocity: Float[Array, " 3"]
    angular_momentum: Float[Array, " 3"]
    velocity: Float[Array, " 3"]
    displacement: Float[Array, " 3"]
    impulse: Float[Array, " 3"]
    arm_velocity: Float[Array, " 3"]
    normal: Float[Array, " 3"]
    approach_speed: Scalar
    tangential_speed: Scalar
    separation: Scalar
    peak_force: Scalar
    peak_depression: Scalar
    peak_pressure: Scalar
    margins: Float[Array, " edges"]
    course: Course
    ledger: Ledger
    separated: Bool[Array, ""]
    failed: Bool[Array, ""]
    steps: Array

    @property
    def margin(self) -> Array:
        """Least distance of the contact disc from the nearest edge [m]."""
        return jnp.min(self.margins, axis=-1)


def weigh_ledger(collision: Collision) -> dict[str, Array]:
    """What is left unaccounted for: linear and angular momentum of the pair, shape (3,), and energy; 0 but rounding.

    The arm's impulse and moment are counted in, energy against the arm's work less what was dissipated.
    """
    one = collision.ledger
    return {
        "linear": one.tip_after + collision.impulse - one.tip_before - one.arm_impulse,
        "angular": one.tip_moment_after + one.debris_after - one.tip_moment_before - one.debris_before
        - one.arm_moment,
        "energy": one.energy_after - one.energy_before - one.arm_work + one.normal_loss + one.friction_loss
        + one.rolling_loss,
    }
