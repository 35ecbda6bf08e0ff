"""The contact law: reference models with effects applied to them (Eqs. 1 to 7)."""

import abc
from collections.abc import Callable, Iterator, Mapping
from typing import Any, ClassVar, final

import equinox as eqx
import jax.numpy as jnp
from equinox import AbstractClassVar
from jaxtyping import Array

from .._numerics import positive_part, safe_power
from .damping import exact_damping, printed_damping
from .effect import AbstractEffect, AbstractLaw, AbstractModel, AbstractStatefulEffect, Contact, Scalar, parameter
from .geometry import contact_radius, racetrack_volume, sphere_volume, truncated_sphere_radius
from .signal import Signal


# Below, the damping that gives it is no longer resolved (`damping_number`); above, damping changes the force by less
# than one part in 10,000, which no gauge shows.
RESTITUTIONS = (1e-3, 0.9999)


@final
class Forces(eqx.Module):
    """What acts at one instant."""

    normal: Scalar  # F_n, on the plate [N]
    drive: Scalar  # of the arm, towards the plate [N]


class AbstractReference(AbstractModel):
    """A reference model: elastic force from depression and conditions; effects extend it.

    They may require of it what it `provides`: `gas`, `geometry`, `damping`. One without gas needs no diameter and no
    shape of its own; `AbstractDamped` has mass, restitution and damping, and needs `elastic` alone.

    Attributes:
        provides: what effects may require: `gas`, `geometry`, `damping`.
    """

    family: ClassVar[str] = "impact"
    provides: AbstractClassVar[tuple[str, ...]]

    def extend(self, effects: tuple[AbstractEffect, ...]) -> "ContactLaw":
        """This model with effects."""
        return ContactLaw(self, effects)

    def diameter(self) -> Scalar:
        """Undeformed outer diameter [m]; 0 where there is none."""
        return jnp.zeros(())

    def shape(self, depression: Array, diameter: Array, increment) -> tuple[Array, Array]:
        """Contact radius b [m] and volume ratio V0/V' [-] at a depression.

        `increment(b)` is what geometry effects add to the radius: 0 without any. A model that `provides` geometry adds
        it before it computes the volume.
        """
        return jnp.zeros_like(depression), jnp.ones_like(depression)

    @abc.abstractmethod
    def elastic(self, contact: Contact) -> Scalar:
        """Elastic force without effects [N]."""

    @abc.abstractmethod
    def inertia(self) -> Scalar:
        """Effective mass [kg]."""

    @abc.abstractmethod
    def rebound(self) -> Scalar:
        """Coefficient of restitution [-]."""

    @abc.abstractmethod
    def damping(self, restitution: Array, approach_speed: Array) -> Scalar:
        """c_n [s/m]."""


class AbstractDamped(AbstractReference):
    """A reference model with a mass and a coefficient of restitution, which Hunt-Crossley damping realises exactly."""

    provides: ClassVar[tuple[str, ...]] = ("damping",)
    effective_mass: Scalar = parameter("kg", 1.2, kind="reference", typical=1.0, coordinate="log",
                                       bounds=(0.0, jnp.inf), text="effective mass along the normal",
                                       limits=(1e-3, 1e5), limits_reason="from a drop test with one gram to a "
                                                                         "spacecraft")
    restitution: Scalar = parameter("", 0.7, kind="reference", typical=0.3, coordinate="logit",
                                    bounds=RESTITUTIONS, text="coefficient of restitution",
                                    limits=(0.0, 1.0), limits_reason="a passive contact returns no more than it takes")

    def inertia(self) -> Scalar:
        """Effective mass [kg]."""
        return self.effective_mass

    def rebound(self) -> Scalar:
        """Coefficient of restitution [-]."""
        return self.restitution

    def damping(self, restitution: Array, approach_speed: Array) -> Scalar:
        """Exact c_n."""
        return exact_damping(restitution, approach_speed)


class AbstractBall(AbstractDamped):
    """A damped ball of an outer diameter, with gas inside."""

    outer_diameter: Scalar = parameter(
        "m", 0.060, kind="reference", typical=0.01, coordinate="log", bounds=(0.0, jnp.inf), free=False,
        text="diameter of the ball before deformation", limits=(1e-3, 10.0),
        limits_reason="from a ball of a millimetre to one of ten metres")
    provides: ClassVar[tuple[str, ...]] = ("gas", "geometry", "damping")

    def diameter(self) -> Scalar:
        """Outer diameter [m]."""
        return self.outer_diameter


@final
class Ball(AbstractBall):
    """The paper's inflated ball: racetrack section, gas, Hunt-Crossley damping.

    Static choices select what the paper prints where it contradicts itself (rows 1 to 4 and 12 of `ddetumble paper`):
    `volume_coefficient` (None: as the area's), `doubled_core` (Eq. 2 as printed), `truncated` (Eq. 1: constant
    pressure, truncated sphere), `damping_form` (`exact`, `printed` for Eq. 6), `damping_sign` (-1 for Eq. 5 taken at
    face value).
    """

    contact_radius_coefficient: Scalar = parameter(
        "", jnp.pi / 4, kind="reference", typical=0.3, coordinate="log", bounds=(0.0, jnp.inf), free=False,
        text="contact radius b over depression", limits=(0.1, 3.0),
        limits_reason="1/4 as printed, pi/4 for a constant perimeter; a patch is no wider than the ball")
    volume_coefficient: float | None = eqx.field(static=True, default=None)
    doubled_core: bool = eqx.field(static=True, default=False)
    truncated: bool = eqx.field(static=True, default=False)
    damping_form: str = eqx.field(static=True, default="exact")
    damping_sign: float = eqx.field(static=True, default=1.0)

    def shape(self, depression: Array, diameter: Array, increment) -> tuple[Array, Array]:
        """Contact radius and volume ratio (Eqs. 1 and 2)."""
        if self.truncated:
            radius = truncated_sphere_radius(depression, diameter)
            return radius + increment(radius), jnp.ones_like(radius)
        radius = contact_radius(depression, self.contact_radius_coefficient)
        radius = radius + increment(radius)
        inner = radius if self.volume_coefficient is None else contact_radius(
            depression, jnp.asarray(self.volume_coefficient))
        # A ball without gas can be squeezed flat and further: its height stays positive, so that nothing is NaN.
        half_height = jnp.maximum(0.5 * (diameter - depression), 1e-6 * diameter)
        volume = racetrack_volume(inner, half_height, self.doubled_core)
        return radius, sphere_volume(diameter) / volume

    def elastic(self, contact: Contact) -> Scalar:
        """F_k = P' pi b**2 (Eq. 4)."""
        return contact.pressure * contact.contact_area

    def damping(self, restitution: Array, approach_speed: Array) -> Scalar:
        """c_n: exact, or Eq. 6."""
        form = {"exact": exact_damping, "printed": printed_damping}[self.damping_form]
        return self.damping_sign * form(restitution, approach_speed)


@final
class PowerLaw(AbstractDamped):
    r"""A soft body without gas: $F_k = F_{10}\,(\delta/10\,\mathrm{mm})^n (c/c_0)^\beta$ (Hertz: n = 1.5).

    `condition` names the condition $c$ that the stiffness depends on (a campaign's pressure, or a pad's thickness), ''
    for none; `condition_reference` is $c_0$.
    """

    stiffness_force: Scalar = parameter("N", 100.0, kind="reference", typical=50.0, coordinate="log",
                                        bounds=(0.0, jnp.inf), text="elastic force at 10 mm", limits=(1e-6, 1e6),
                                        limits_reason="a passive body resists; 10 mm of foam to 10 mm of a vehicle "
                                                      "buffer")
    exponent: Scalar = parameter("", 1.5, kind="reference", typical=0.5, coordinate="log", bounds=(0.5, 6.0),
                                 text="power of the depression", limits=(0.5, 5.0),
                                 limits_reason="a dimple of a thin shell 1/2, Hertz 3/2, a cone 2, a membrane 3, foam "
                                               "that locks more")
    condition_exponent: Scalar = parameter(
        "", 0.0, kind="reference", typical=0.5, text="power of the further condition", limits=(-3.0, 3.0),
        limits_reason="thickness of a pad or plate to the power -3 in bending, +3 at most")
    condition: str = eqx.field(static=True, default="")
    condition_reference: float = eqx.field(static=True, default=1.0)

    def elastic(self, contact: Contact) -> Scalar:
        """F_k of the power law [N]."""
        force = self.stiffness_force * safe_power(contact.depression / 0.01, self.exponent)
        if not self.condition:
            return force
        ratio = contact.conditions[self.condition] / self.condition_reference
        return force * safe_power(ratio, self.condition_exponent)


@final
class ContactLaw(AbstractLaw):
    """A reference model and any number of effects; contributions of one stage are summed or multiplied.

    Attributes:
        reference: the reference model.
        effects: any number of effects, at their null or not.
    """

    reference: AbstractReference
    effects: tuple[AbstractEffect, ...] = ()

    def stateful(self) -> list:
        """The effects with a state of their own, in the order of the state vector."""
        return [effect for effect in self.effects if isinstance(effect, AbstractStatefulEffect)]

    def begin_states(self) -> Array:
        """States of the effects at first touch, shape (states,)."""
        return jnp.stack([jnp.asarray(e.initial()) for e in self.stateful()]) if self.stateful() else jnp.zeros((0,))

    def start(self, conditions: Mapping[str, Array]) -> tuple[Array, Array]:
        """Outer diameter [m] and damping c_n [s/m] of a record, which do not change during contact."""
        zero = jnp.zeros(())
        speed = conditions["approach_speed"]
        first = Contact(zero, zero, speed, zero, zero + 1.0, self.reference.diameter(), zero, zero,
                        conditions.get("initial_pressure", zero), speed, conditions, zero)
        growth = sum((effect.growth(first) for effect in self.pick("size")), zero)
        restitution = self.reference.rebound()
        for effect in self.pick("restitution"):
            restitution = restitution * effect.factor(first)
        return self.reference.diameter() * (1.0 + growth), self.reference.damping(restitution, speed)

    def contact(self, conditions: Mapping[str, Array], diameter: Array, time: Array, depression: Array,
                rate: Array, states: Array) -> Contact:
        """Geometry, gas and elastic force at one instant."""
        zero = jnp.zeros_like(depression)
        pressure = conditions.get("initial_pressure", zero)
        bare = Contact(time, positive_part(depression), rate, zero, zero + 1.0, diameter, zero, zero, pressure,
                       conditions["approach_speed"], conditions, zero)

        def increment(radius):
            at = eqx.tree_at(lambda c: c.contact_radius, bare, radius)
            return sum((effect.contact_radius(seen) for effect, seen in self._see("geometry", at, states)), zero)

        radius, ratio = self.reference.shape(bare.depression, diameter, increment)
        shaped = eqx.tree_at(lambda c: (c.contact_radius, c.volume_ratio), bare, (radius, ratio))
        gas = pressure * ratio  # Eq. 3, isothermal
        for effect, seen in self._see("gas", shaped, states):
            gas = gas * effect.pressure_factor(seen)
        filled = eqx.tree_at(lambda c: c.pressure, shaped, gas)
        elastic = self.reference.elastic(filled)
        for effect, seen in self._see("elastic", filled, states):
            elastic = elastic + effect.force(seen)
        for effect, seen in self._see("stiffness", filled, states):
            elastic = elastic * effect.factor(seen)
        return eqx.tree_at(lambda c: c.elastic_force, filled, elastic)

    def press(self, conditions: Mapping[str, Array], diameter: Array, depression: Array) -> Contact:
        """Geometry, gas and elastic force of a ball that is pressed without haste, the states of effects being zero."""
        zero = jnp.zeros(())
        return self.contact(conditions, diameter, zero, depression, zero, jnp.zeros((len(self.stateful()),)))

    def forces(self, contact: Contact, damping: Array, states: Array) -> Forces:
        """Normal force and drive at one instant (Eqs. 4 to 7 with the effects)."""
        normal = contact.elastic_force * (1.0 + damping * contact.depression_rate)
        for effect, seen in self._see("contact", contact, states):
            normal = normal + effect.force(seen)
        normal = positive_part(normal)
        for effect, seen in self._see("surface", contact, states):
            normal = normal + effect.force(seen)
        return Forces(normal, self.drive(contact, states))

    def drive(self, contact: Contact, states: Array) -> Scalar:
        """Force of the arm towards the plate at one instant [N]."""
        return sum((effect.force(seen) for effect, seen in self._see("drive", contact, states)),
                   jnp.zeros_like(contact.depression))

    def rates(self, contact: Contact, states: Array) -> Array:
        """Time derivatives of the effects' own states."""
        found = [effect.rate(self._give(contact, effect, states)) for effect in self.stateful()]
        return jnp.stack(found) if found else jnp.zeros((0,))

    def _see(self, stage: str, contact: Contact, states: Array) -> Iterator[tuple[Any, Contact]]:
        """Effects of a stage, each with the contact as it sees it: with its own state."""
        return ((effect, self._give(contact, effect, states)) for effect in self.pick(stage))

    def _give(self, contact: Contact, effect: AbstractEffect, states: Array) -> Contact:
        own = [k for k, other in enumerate(self.stateful()) if other is effect]
        return eqx.tree_at(lambda c: c.state, contact, states[own[0]]) if own else contact

    def has_sensor(self) -> bool:
        """Whether any effect acts on the sensor."""
        return bool(self.pick("sensor"))

    def rings(self) -> bool:
        """Whether any effect on the sensor oscillates faster than the force."""
        return any(type(effect).rings for effect in self._list_sensors())

    def reading(self, force: Signal, divide: Callable[[Signal], Signal] = lambda signal: signal) -> Signal:
        """What the force gauge reads; `divide` refines the signal before the first effect that rings."""
        whole = True
        for effect in self._list_sensors():
            if whole and type(effect).rings:
                force, whole = divide(force), False
            force = effect.reading(force)
        return force

    def _list_sensors(self) -> list[Any]:
        """Effects on the sensor in the order in which they act."""
        return sorted(self.pick("sensor"), key=lambda e: type(e).order)
