"""Probes: forces that no catalogue lists, each a hint at what a missing force depends on.

A probe is an effect whose only purpose is to show in which variable a misfit sits. It is never part of a verdict's
model; where a probe does better than every effect of the catalogue, the missing physics is not in the catalogue.
`variable` says where its misfit sits; `onset` and `line` name the shape parameters that are an onset in the family's
state, and the frequency of something periodic.
"""

from typing import ClassVar, final

import jax.numpy as jnp

from .._numerics import safe_power
from ..contact.effect import (
    AbstractContactForce,
    AbstractEffect,
    AbstractElasticEffect,
    AbstractStiffnessEffect,
    Contact,
    Scalar,
    parameter,
)


@final
class DepthProbe(AbstractElasticEffect):
    r"""A stiffening that sets in at a depression: $F_k$ gains $k\,((\delta - d)_+/1\,\mathrm{mm})^r$."""

    k: Scalar = parameter("N", 0.0, typical=5.0, starts=(5.0,))
    depth: Scalar = parameter("m", 4e-3, kind="shape", typical=1e-3, coordinate="log", bounds=(1e-5, 0.05))
    power: Scalar = parameter("", 1.5, kind="shape", typical=0.5, coordinate="log", bounds=(0.7, 4.0), free=False)
    id: ClassVar[str] = "probe-depth"
    law: ClassVar[str] = "F_k gains k ((delta - depth)_+ / 1 mm)^power"
    reference: ClassVar[str] = "probe"
    variable: ClassVar[str] = "depression"
    onset: ClassVar[str] = "probe-depth.depth"

    def force(self, contact: Contact) -> Scalar:
        """k ((delta - d)_+ / 1 mm)^r [N]."""
        return self.k * safe_power((contact.depression - self.depth) / 1e-3, self.power)


@final
class PhaseProbe(AbstractStiffnessEffect):
    """A spring that is stiffer while loading than while unloading, or the reverse."""

    h: Scalar = parameter("", 0.0, typical=0.05, starts=(0.05,))
    id: ClassVar[str] = "probe-phase"
    law: ClassVar[str] = "F_k times 1 + h tanh(w / 20 mm/s)"
    reference: ClassVar[str] = "probe"
    variable: ClassVar[str] = "depression_rate"

    def factor(self, contact: Contact) -> Scalar:
        """1 + h tanh(w / 20 mm/s)."""
        return 1.0 + self.h * jnp.tanh(contact.depression_rate / 0.02)


@final
class RateProbe(AbstractStiffnessEffect):
    """A spring that stiffens with the square of the rate."""

    h: Scalar = parameter("", 0.0, typical=0.05, starts=(0.05,))
    id: ClassVar[str] = "probe-rate"
    law: ClassVar[str] = "F_k times 1 + h (w / 0.4 m/s)^2"
    reference: ClassVar[str] = "probe"
    variable: ClassVar[str] = "depression_rate"

    def factor(self, contact: Contact) -> Scalar:
        """1 + h (w / 0.4 m/s)^2."""
        return 1.0 + self.h * (contact.depression_rate / 0.4) ** 2


@final
class PressureProbe(AbstractStiffnessEffect):
    """A spring whose stiffness is not proportional to the pressure."""

    s: Scalar = parameter("", 0.0, typical=0.05, starts=(0.05,))
    id: ClassVar[str] = "probe-pressure"
    law: ClassVar[str] = "F_k times (P0 / 1 MPa)^s"
    reference: ClassVar[str] = "probe"
    requires: ClassVar[tuple[str, ...]] = ("gas",)
    variable: ClassVar[str] = "initial_pressure"

    def factor(self, contact: Contact) -> Scalar:
        """(P0 / 1 MPa)^s; 1 without pressure."""
        some = contact.initial_pressure > 0
        return jnp.where(some, safe_power(contact.initial_pressure / 1e6, self.s), 1.0)


@final
class SpeedProbe(AbstractStiffnessEffect):
    """A spring whose stiffness depends on the approach speed."""

    s: Scalar = parameter("", 0.0, typical=0.05, starts=(0.05,))
    id: ClassVar[str] = "probe-speed"
    law: ClassVar[str] = "F_k times (v1 / 0.4 m/s)^s"
    reference: ClassVar[str] = "probe"
    variable: ClassVar[str] = "approach_speed"

    def factor(self, contact: Contact) -> Scalar:
        """(v1 / 0.4 m/s)^s."""
        return jnp.exp(self.s * jnp.log(contact.approach_speed / 0.4))


@final
class TimeProbe(AbstractStiffnessEffect):
    """A spring that changes with the time in contact."""

    s: Scalar = parameter("", 0.0, typical=0.05, starts=(0.05,))
    id: ClassVar[str] = "probe-time"
    law: ClassVar[str] = "F_k times 1 + s t / 20 ms"
    reference: ClassVar[str] = "probe"
    variable: ClassVar[str] = "time"

    def factor(self, contact: Contact) -> Scalar:
        """1 + s t / 20 ms."""
        return 1.0 + self.s * contact.time / 0.02


@final
class SequenceProbe(AbstractStiffnessEffect):
    """A spring that changes steadily over the series."""

    s: Scalar = parameter("", 0.0, typical=0.05, starts=(0.05,))
    id: ClassVar[str] = "probe-sequence"
    law: ClassVar[str] = "F_k times 1 + s (j - 1) / 10"
    reference: ClassVar[str] = "probe"
    requires: ClassVar[tuple[str, ...]] = ("sequence",)
    variable: ClassVar[str] = "sequence"

    def factor(self, contact: Contact) -> Scalar:
        """1 + s (j - 1) / 10."""
        return 1.0 + self.s * (contact.conditions["sequence"] - 1.0) / 10.0


@final
class RingingProbe(AbstractContactForce):
    """A force that oscillates from first touch on."""

    a: Scalar = parameter("N", 0.0, typical=1.0, starts=(0.5,))
    b: Scalar = parameter("N", 0.0, typical=1.0, starts=(0.5,))
    frequency: Scalar = parameter("Hz", 70.0, kind="shape", typical=7.0, coordinate="log", bounds=(5.0, 5e3))
    id: ClassVar[str] = "probe-ringing"
    law: ClassVar[str] = "F_n gains a sin(2 pi f t) + b cos(2 pi f t)"
    reference: ClassVar[str] = "probe"
    variable: ClassVar[str] = "time"
    line: ClassVar[str] = "probe-ringing.frequency"

    def force(self, contact: Contact) -> Scalar:
        """a sin(2 pi f t) + b (cos(2 pi f t) - 1) [N]."""
        phase = 2.0 * jnp.pi * self.frequency * contact.time
        return self.a * jnp.sin(phase) + self.b * (jnp.cos(phase) - 1.0)


PROBES: tuple[type[AbstractEffect], ...] = (
    DepthProbe, PhaseProbe, RateProbe, PressureProbe, SpeedProbe, TimeProbe, SequenceProbe, RingingProbe,
)
