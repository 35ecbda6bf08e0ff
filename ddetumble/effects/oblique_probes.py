"""Probes for oblique impacts: what a missing friction depends on (see `probes`)."""

from abc import abstractmethod
from typing import ClassVar, final

import jax.numpy as jnp

from .._numerics import safe_power
from ..contact.effect import AbstractEffect, Scalar, parameter
from ..contact.gripping import AbstractReactionEffect, Patch
from ..contact.sliding import AbstractFrictionForce, AbstractLoadEffect, Slide


class AbstractFrictionProbe(AbstractLoadEffect):
    r"""Friction times $1 + h\,x$, with $x$ a variable of the slide in units of what is usual for it."""

    h: Scalar = parameter("", 0.0, typical=0.05, starts=(0.05,))
    reference: ClassVar[str] = "probe"
    channel: ClassVar[str] = "tangential_force"

    @abstractmethod
    def measure(self, slide: Slide) -> Scalar:
        """The variable x [-]."""

    def factor(self, slide: Slide) -> Scalar:
        """1 + h x."""
        return 1.0 + self.h * self.measure(slide)


@final
class PathProbe(AbstractFrictionProbe):
    """Friction that changes steadily with the distance slid."""

    id: ClassVar[str] = "probe-friction-slip"
    law: ClassVar[str] = "mu F_n times 1 + h s / 10 mm"
    variable: ClassVar[str] = "slip"

    def measure(self, slide: Slide) -> Scalar:
        """s / 10 mm."""
        return slide.slip / 0.01


@final
class LoadProbe(AbstractFrictionProbe):
    """Friction that is not proportional to the load."""

    id: ClassVar[str] = "probe-friction-load"
    law: ClassVar[str] = "mu F_n times 1 + h F_n / 50 N"
    variable: ClassVar[str] = "normal_force"

    def measure(self, slide: Slide) -> Scalar:
        """F_n / 50 N."""
        return slide.normal_load / 50.0


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
class SpeedProbe(AbstractFrictionProbe):
    """Friction that depends on the slip speed."""

    id: ClassVar[str] = "probe-friction-speed"
    law: ClassVar[str] = "mu F_n times 1 + h u / 0.2 m/s"
    variable: ClassVar[str] = "slip_speed"

    def measure(self, slide: Slide) -> Scalar:
        """u / 0.2 m/s."""
        return slide.slip_speed / 0.2


@final
class TimeProbe(AbstractFrictionProbe):
    """Friction that changes with the time in contact."""

    id: ClassVar[str] = "probe-friction-time"
    law: ClassVar[str] = "mu F_n times 1 + h t / 20 ms"
    variable: ClassVar[str] = "time"

    def measure(self, slide: Slide) -> Scalar:
        """t / 20 ms."""
        return slide.time / 0.02


@final
class SequenceProbe(AbstractFrictionProbe):
    """Friction that changes steadily over the series."""

    id: ClassVar[str] = "probe-friction-sequence"
    law: ClassVar[str] = "mu F_n times 1 + h (j - 1) / 10"
    requires: ClassVar[tuple[str, ...]] = ("sequence",)
    variable: ClassVar[str] = "sequence"

    def measure(self, slide: Slide) -> Scalar:
        """(j - 1) / 10."""
        return (slide.conditions["sequence"] - 1.0) / 10.0


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
