"""Probes for oblique impacts: what a missing friction depends on (see `probes`)."""

from typing import ClassVar, final

import jax.numpy as jnp

from .._numerics import safe_power
from ..contact.effect import AbstractEffect, Scalar, parameter
from ..contact.gripping import AbstractReactionEffect, Patch
from ..contact.sliding import AbstractFrictionForce, AbstractLoadEffect, Slide


@final
class PathProbe(AbstractLoadEffect):
    """Friction that changes steadily with the distance slid."""

    h: Scalar = parameter("", 0.0, typical=0.05, starts=(0.05,))
    id: ClassVar[str] = "probe-friction-slip"
    law: ClassVar[str] = "mu F_n times 1 + h s / 10 mm"
    reference: ClassVar[str] = "probe"
    variable: ClassVar[str] = "slip"
    channel: ClassVar[str] = "tangential_force"

    def factor(self, slide: Slide) -> Scalar:
        """1 + h s / 10 mm."""
        return 1.0 + self.h * slide.slip / 0.01


@final
class LoadProbe(AbstractLoadEffect):
    """Friction that is not proportional to the load."""

    h: Scalar = parameter("", 0.0, typical=0.05, starts=(0.05,))
    id: ClassVar[str] = "probe-friction-load"
    law: ClassVar[str] = "mu F_n times 1 + h F_n / 50 N"
    reference: ClassVar[str] = "probe"
    variable: ClassVar[str] = "normal_force"
    channel: ClassVar[str] = "tangential_force"

    def factor(self, slide: Slide) -> Scalar:
        """1 + h F_n / 50 N."""
        return 1.0 + self.h * slide.normal_load / 50.0


@final
class PressureProbe(AbstractLoadEffect):
    """Friction with another dependence on the pressure."""

    s: Scalar = parameter("", 0.0, typical=0.05, starts=(0.05,))
    id: ClassVar[str] = "probe-friction-pressure"
    law: ClassVar[str] = "mu F_n times (p / 1 MPa)^s"
    reference: ClassVar[str] = "probe"
    requires: ClassVar[tuple[str, ...]] = ("gas",)
    variable: ClassVar[str] = "initial_pressure"
    channel: ClassVar[str] = "tangential_force"

    def factor(self, slide: Slide) -> Scalar:
        """(p / 1 MPa)^s; 1 without pressure."""
        some = slide.internal_pressure > 0
        return jnp.where(some, safe_power(slide.internal_pressure / 1e6, self.s), 1.0)


@final
class SpeedProbe(AbstractLoadEffect):
    """Friction that depends on the slip speed."""

    h: Scalar = parameter("", 0.0, typical=0.05, starts=(0.05,))
    id: ClassVar[str] = "probe-friction-speed"
    law: ClassVar[str] = "mu F_n times 1 + h u / 0.2 m/s"
    reference: ClassVar[str] = "probe"
    variable: ClassVar[str] = "slip_speed"
    channel: ClassVar[str] = "tangential_force"

    def factor(self, slide: Slide) -> Scalar:
        """1 + h u / 0.2 m/s."""
        return 1.0 + self.h * slide.slip_speed / 0.2


@final
class TimeProbe(AbstractLoadEffect):
    """Friction that changes with the time in contact."""

    h: Scalar = parameter("", 0.0, typical=0.05, starts=(0.05,))
    id: ClassVar[str] = "probe-friction-time"
    law: ClassVar[str] = "mu F_n times 1 + h t / 20 ms"
    reference: ClassVar[str] = "probe"
    variable: ClassVar[str] = "time"
    channel: ClassVar[str] = "tangential_force"

    def factor(self, slide: Slide) -> Scalar:
        """1 + h t / 20 ms."""
        return 1.0 + self.h * slide.time / 0.02


@final
class SequenceProbe(AbstractLoadEffect):
    """Friction that changes steadily over the series."""

    s: Scalar = parameter("", 0.0, typical=0.05, starts=(0.05,))
    id: ClassVar[str] = "probe-friction-sequence"
    law: ClassVar[str] = "mu F_n times 1 + s (j - 1) / 10"
    reference: ClassVar[str] = "probe"
    requires: ClassVar[tuple[str, ...]] = ("sequence",)
    variable: ClassVar[str] = "sequence"
    channel: ClassVar[str] = "tangential_force"

    def factor(self, slide: Slide) -> Scalar:
        """1 + s (j - 1) / 10."""
        return 1.0 + self.s * (slide.conditions["sequence"] - 1.0) / 10.0


@final
class ConstantProbe(AbstractFrictionForce):
    """Friction without load."""

    f: Scalar = parameter("N", 0.0, typical=0.3, starts=(0.2,))
    id: ClassVar[str] = "probe-friction-constant"
    law: ClassVar[str] = "f gains a constant"
    reference: ClassVar[str] = "probe"
    variable: ClassVar[str] = "normal_force"
    channel: ClassVar[str] = "tangential_force"

    def force(self, slide: Slide) -> Scalar:
        """A constant [N]."""
        return self.f * jnp.ones_like(slide.normal_load)


@final
class BrakeProbe(AbstractReactionEffect):
    """A moment against rolling that the offset of the normal force by its contact radius does not make."""

    share: Scalar = parameter("", 0.0, typical=0.1, starts=(0.1,))
    id: ClassVar[str] = "probe-rolling"
    law: ClassVar[str] = "a moment proportional to the normal force against rolling"
    reference: ClassVar[str] = "probe"
    variable: ClassVar[str] = "time"
    channel: ClassVar[str] = "tangential_force"

    def offset_at(self, patch: Patch) -> Scalar:
        """A share of 5 mm."""
        return self.share * 0.005 * jnp.ones_like(patch.normal_force)


OBLIQUE_PROBES: tuple[type[AbstractEffect], ...] = (
    PathProbe, LoadProbe, PressureProbe, SpeedProbe, TimeProbe, SequenceProbe, ConstantProbe, BrakeProbe,
)
