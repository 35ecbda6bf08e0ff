r"""The oblique contact: a normal model and a friction model together, and the patch between them that slips or grips.

The ball's centre moves along the plate with speed $v$ and the ball may roll; with $y = r\omega$ the plate sees

$m_t \dot v = -f$, $\quad m_r \dot y = f - \frac{x_r}{r} F_n\, y/\sqrt{y^2 + u_c^2}$, $\quad u = v - y$,

where $f$ is the friction force against the motion, $m_t$ the mass felt along the plate, $m_r = I/r^2$ the ball's moment
of inertia about its centre over the square of its height (`rolling_mass`; very large where the ball cannot turn), and
$x_r$ the distance by which the normal force acts ahead of the patch's centre, against rolling either way. The patch is
a spring of compliance $C$ in series with a slider:

$u = C \dot f + u_s$, $\quad f = F_{max}\, u_s/\sqrt{u_s^2 + u_c^2}$.

$F_{max}$ is what the friction law (Eqs. 8 to 11 with its effects) gives at the speed $u$ of the ball over the plate,
after the slider's path and work; $u_c$ is the creep speed, below which rubber creeps instead of sliding (Grosch 1963):
the transition from slip to grip is smooth, and so are the derivatives. (Were $F_{max}$ to fall with the speed of the
massless slider, its motion would not be determined: that is why it sees $u$.)
"""

import abc
from collections.abc import Mapping
from typing import ClassVar, final

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from .._numerics import positive_part, safe_divide
from .effect import AbstractEffect, AbstractLaw, AbstractModel, Scalar, family_of, parameter
from .law import AbstractReference, ContactLaw
from .sliding import AbstractFriction, FrictionLaw, Slide


NEWTON = 12  # steps towards the slider's speed; they converge from one side, quadratically at the end
TOUCH = 1e-6  # N, below which the load counts as this: powers of the load stay finite where contact ends


@final
class Patch(eqx.Module):
    """The contact patch as a tangential effect sees it; every entry is a scalar (the caller batches by `vmap`).

    Attributes:
        time: since first touch [s].
        depression: how far the ball is squeezed [m].
        contact_radius: of the flat contact disc, b [m].
        height: of the ball's centre above the plate, r [m].
        pressure: of the gas, absolute [Pa].
        normal_force: F_n [N].
        conditions: every condition of the record by name, SI.
    """

    time: Scalar
    depression: Scalar
    contact_radius: Scalar
    height: Scalar
    pressure: Scalar
    normal_force: Scalar
    conditions: Mapping[str, Array]


class AbstractComplianceEffect(AbstractEffect):
    """Lets the patch give way before it slides."""

    stage: ClassVar[str] = "compliance"
    family: ClassVar[str] = "oblique"

    @abc.abstractmethod
    def compliance_at(self, patch: Patch) -> Scalar:
        """Tangential compliance that is added [m/N], not negative."""


class AbstractReactionEffect(AbstractEffect):
    """Moves the line of action of the normal force."""

    stage: ClassVar[str] = "reaction"
    family: ClassVar[str] = "oblique"

    @abc.abstractmethod
    def offset_at(self, patch: Patch) -> Scalar:
        """How far the normal force acts ahead of the patch's centre, against rolling either way [m]."""


class AbstractAxesEffect(AbstractEffect):
    """Changes what a gauge of two axes reads, after everything that acts on one of its axes alone."""

    stage: ClassVar[str] = "axes"
    family: ClassVar[str] = "oblique"

    @abc.abstractmethod
    def read_axes(self, normal_force: Scalar, tangential_force: Scalar) -> tuple[Scalar, Scalar]:
        """What the two axes read, in this order [N]."""


@final
class Striker(AbstractModel):
    """A reference model of oblique impacts: a normal model, a friction model, and what moves along the plate.

    Attributes:
        ball: normal model (`Ball`, `PowerLaw` or one of your own).
        friction: friction model (`AdhesionHysteresis`, `CoulombFriction` or one of your own).
    """

    ball: AbstractReference
    friction: AbstractFriction
    tangential_mass: Scalar = parameter("kg", 1.2, kind="reference", typical=1.0, coordinate="log",
                                        bounds=(1e-2, 1e2), text="effective mass along the plate",
                                        limits=(1e-3, 1e5), limits_reason="from a drop test with one gram to a "
                                                                          "spacecraft")
    rolling_mass: Scalar = parameter("kg", 0.5, kind="reference", typical=0.2, coordinate="log", bounds=(0.0, jnp.inf),
                                     free=False, text="moment of inertia of the turning ball over its height squared",
                                     limits=(1e-3, 1e5), limits_reason="from a drop test with one gram to a spacecraft")
    creep_speed: Scalar = parameter("m/s", 0.01, kind="reference", typical=0.005, coordinate="log",
                                    bounds=(1e-5, 10.0), free=False, text="speed below which the patch creeps",
                                    limits=(1e-6, 1.0), limits_reason="it must be far below the speed of sliding")
    family: ClassVar[str] = "oblique"

    def __check_init__(self):
        if not isinstance(self.ball, AbstractReference) or not isinstance(self.friction, AbstractFriction):
            raise TypeError("`Striker(ball, friction)` takes a normal model and a friction model, in this order; it "
                            f"was given a {type(self.ball).__name__} and a {type(self.friction).__name__}.")

    @property
    def provides(self) -> tuple[str, ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        """What effects may require: what ball and friction provide, and a slip speed."""
        return (*self.ball.provides, *self.friction.provides, "slip_speed", "tangential")

    def extend(self, effects: tuple[AbstractEffect, ...]) -> "StrikeLaw":
        """This model with effects: those on impacts, on friction, and on the patch."""
        listed = effects if isinstance(effects, (tuple, list)) else None
        wrong = [effects] if listed is None else [e for e in listed if not isinstance(e, AbstractEffect)]
        if wrong:
            raise TypeError("`extend` takes a tuple of effects, such as `(TangentialCompliance(5e-5),)`; it was given "
                            f"{wrong[0]!r:.60}.")
        return StrikeLaw(self, effects)


@final
class StrikeLaw(AbstractLaw):
    """A reference model of oblique impacts and the effects that extend it.

    Attributes:
        reference: the reference model.
        effects: any number of effects, at their null or not.
    """

    reference: Striker
    effects: tuple[AbstractEffect, ...] = ()

    @property
    def normal(self) -> ContactLaw:
        """The law of the normal force."""
        ball = self.reference.ball
        return ContactLaw(ball, tuple(e for e in self.effects if family_of(e) == ball.family))

    @property
    def friction(self) -> FrictionLaw:
        """The law of friction while sliding."""
        friction = self.reference.friction
        return FrictionLaw(friction, tuple(e for e in self.effects if family_of(e) == friction.family))

    def compliance(self, patch: Patch) -> Scalar:
        """Tangential compliance of the patch [m/N]; 0 without effects."""
        return positive_part(sum((effect.compliance_at(patch) for effect in self.pick("compliance")),
                                 jnp.zeros_like(patch.normal_force)))

    def brake(self, patch: Patch) -> Scalar:
        """Force that brakes rolling at full speed, the moment of the offset normal force over the height [N]."""
        total = sum((effect.offset_at(patch) for effect in self.pick("reaction")), jnp.zeros_like(patch.normal_force))
        return safe_divide(total, patch.height) * patch.normal_force

    def read_axes(self, normal_force: Array, tangential_force: Array) -> tuple[Array, Array]:
        """What the gauge's axes read, from what they would read each by itself [N]."""
        for effect in self.pick("axes"):
            normal_force, tangential_force = effect.read_axes(normal_force, tangential_force)
        return normal_force, tangential_force

    def limit(self, patch: Patch, speed: Array, path: Array, work: Array) -> Scalar:
        """F_max: friction of the sliding patch [N], not negative.

        Speed u of the ball over the plate, with its sign [m/s]; path slid by the patch so far, whichever way [m]; work
        done against friction so far [J].
        """
        way = jnp.where(speed < 0, -1.0, 1.0)
        load = jnp.maximum(patch.normal_force, TOUCH)
        slide = Slide(path, jnp.abs(speed), load, patch.pressure, work, patch.time, way, patch.conditions)
        return positive_part(self.friction.force(slide))


def share_friction(speed: Array, creep_speed: Array) -> Array:
    r"""Share of the friction limit at a sliding speed, $u/\sqrt{u^2 + u_c^2}$ [-]: odd, and 1 well above $u_c$."""
    return speed / jnp.sqrt(speed**2 + creep_speed**2)


@jax.custom_jvp
def solve_slider(stiff: Array, step: Array, push: Array, creep_speed: Array) -> Scalar:
    r"""Speed $u_s$ of the slider in $A\,u_s/\sqrt{u_s^2 + u_c^2} + B u_s = R$, $A \ge 0$ [m], $B$ [s] and $u_c > 0$.

    That is one implicit step of patch and ball. The left side rises, so there is one solution. Newton's method starts
    below it and never passes it, as the left side is concave; the derivative is that of the equation.
    """
    size = jnp.abs(push)
    speed = jnp.maximum(size / (stiff / creep_speed + step), (size - stiff) / step)
    for _ in range(NEWTON):
        root = jnp.sqrt(speed**2 + creep_speed**2)
        left = size - stiff * speed / root - step * speed
        speed = speed + left / (stiff * creep_speed**2 / root**3 + step)
    # Without the barrier the compiler repeats the iteration wherever its result is used.
    return jax.lax.optimization_barrier(jnp.where(push < 0, -speed, speed))


@solve_slider.defjvp
def _solve_slider_jvp(primals, tangents):
    stiff, step, push, creep_speed = primals
    speed = solve_slider(stiff, step, push, creep_speed)
    root = jnp.sqrt(speed**2 + creep_speed**2)
    slope = stiff * creep_speed**2 / root**3 + step
    factors = (-speed / root / slope, -speed / slope, 1.0 / slope, stiff * speed * creep_speed / root**3 / slope)
    factors = jax.lax.optimization_barrier(factors)
    parts = [factor * tangent for factor, tangent in zip(factors, tangents, strict=True)]
    return speed, parts[0] + parts[1] + parts[2] + parts[3]


def find_height(diameter: Array, depression: Array) -> Scalar:
    """Height of the ball's centre above the plate, half its squeezed height [m]; 30 mm for a body without diameter."""
    half = jnp.maximum(0.5 * (diameter - depression), 1e-3 * diameter)
    return jnp.where(diameter > 0, half, 0.03)
