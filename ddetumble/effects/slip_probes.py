"""Probes for slip records: what a missing friction depends on (see `probes`)."""

from typing import ClassVar, final

import jax.numpy as jnp

from .._numerics import safe_power
from ..contact.effect import AbstractEffect, Scalar, parameter
from ..contact.sliding import AbstractLoadEffect, AbstractRubberEffect, Slide


@final
class OnsetProbe(AbstractLoadEffect):
    r"""Friction that changes beyond a slip: the coefficient times $1 + k\,((s - d)_+/1\,\mathrm{mm})^r$."""

    k: Scalar = parameter("", 0.0, typical=0.02, starts=(0.02,))
    depth: Scalar = parameter("m", 4e-3, kind="shape", typical=1e-3, coordinate="log", bounds=(1e-5, 1.0))
    power: Scalar = parameter("", 1.0, kind="shape", typical=0.5, coordinate="log", bounds=(0.5, 4.0), free=False)
    id: ClassVar[str] = "probe-onset"
    law: ClassVar[str] = "mu F_n times 1 + k ((s - depth)_+ / 1 mm)^power"
    reference: ClassVar[str] = "probe"
    variable: ClassVar[str] = "slip"
    onset: ClassVar[str] = "probe-onset.depth"

    def factor(self, slide: Slide) -> Scalar:
        """1 + k ((s - d)_+ / 1 mm)^r."""
        return 1.0 + self.k * safe_power((slide.slip - self.depth) / 1e-3, self.power)


@final
class TrendProbe(AbstractRubberEffect):
    """An Eq. 8 part that changes steadily with slip."""

    h: Scalar = parameter("", 0.0, typical=0.05, starts=(0.05,))
    id: ClassVar[str] = "probe-trend"
    law: ClassVar[str] = "the Eq. 8 part times 1 + h s / 10 mm"
    reference: ClassVar[str] = "probe"
    variable: ClassVar[str] = "slip"
    requires: ClassVar[tuple[str, ...]] = ("rubber",)

    def factor(self, slide: Slide) -> Scalar:
        """1 + h s / 10 mm."""
        return 1.0 + self.h * slide.slip / 0.01


@final
class PressureProbe(AbstractRubberEffect):
    """An Eq. 8 part with another dependence on the pressure."""

    s: Scalar = parameter("", 0.0, typical=0.05, starts=(0.05,))
    id: ClassVar[str] = "probe-pressure"
    law: ClassVar[str] = "the Eq. 8 part times (p / 1 MPa)^s"
    reference: ClassVar[str] = "probe"
    requires: ClassVar[tuple[str, ...]] = ("rubber", "internal_pressure")
    variable: ClassVar[str] = "internal_pressure"

    def factor(self, slide: Slide) -> Scalar:
        """(p / 1 MPa)^s; 1 without pressure."""
        some = slide.internal_pressure > 0
        return jnp.where(some, safe_power(slide.internal_pressure / 1e6, self.s), 1.0)


@final
class SpeedProbe(AbstractLoadEffect):
    """Friction that depends on the speed by a power."""

    s: Scalar = parameter("", 0.0, typical=0.05, starts=(0.05,))
    id: ClassVar[str] = "probe-speed"
    law: ClassVar[str] = "mu F_n times (u / 0.1 m/s)^s"
    reference: ClassVar[str] = "probe"
    requires: ClassVar[tuple[str, ...]] = ("slip_speed",)
    variable: ClassVar[str] = "slip_speed"

    def factor(self, slide: Slide) -> Scalar:
        """(u / 0.1 m/s)^s; 1 at rest."""
        return jnp.where(slide.slip_speed > 0, safe_power(slide.slip_speed / 0.1, self.s), 1.0)


@final
class DirectionProbe(AbstractLoadEffect):
    """Friction that is larger one way than the other."""

    h: Scalar = parameter("", 0.0, typical=0.05, starts=(0.05,))
    id: ClassVar[str] = "probe-direction"
    law: ClassVar[str] = "mu F_n times 1 - h while the stroke is reversed"
    reference: ClassVar[str] = "probe"
    variable: ClassVar[str] = "direction"

    def factor(self, slide: Slide) -> Scalar:
        """1 - h while the stroke is reversed, 1 otherwise."""
        return 1.0 + self.h * 0.5 * (slide.direction - jnp.abs(slide.direction))


@final
class SequenceProbe(AbstractLoadEffect):
    """Friction that changes steadily over the series."""

    s: Scalar = parameter("", 0.0, typical=0.05, starts=(0.05,))
    id: ClassVar[str] = "probe-sequence"
    law: ClassVar[str] = "mu F_n times 1 + s (j - 1) / 10"
    reference: ClassVar[str] = "probe"
    requires: ClassVar[tuple[str, ...]] = ("sequence",)
    variable: ClassVar[str] = "sequence"

    def factor(self, slide: Slide) -> Scalar:
        """1 + s (j - 1) / 10."""
        return 1.0 + self.s * (slide.conditions["sequence"] - 1.0) / 10.0


@final
class WaveProbe(AbstractLoadEffect):
    """Friction that repeats along the slip."""

    a: Scalar = parameter("", 0.0, typical=0.02, starts=(0.01,))
    b: Scalar = parameter("", 0.0, typical=0.02, starts=(0.01,))
    frequency: Scalar = parameter("1/m", 500.0, kind="shape", typical=50.0, coordinate="log", bounds=(1.0, 1e6))
    id: ClassVar[str] = "probe-wave"
    law: ClassVar[str] = "mu F_n times 1 + a sin(2 pi k s) + b (cos(2 pi k s) - 1)"
    reference: ClassVar[str] = "probe"
    variable: ClassVar[str] = "slip"
    line: ClassVar[str] = "probe-wave.frequency"

    def factor(self, slide: Slide) -> Scalar:
        """1 + a sin(2 pi k s) + b (cos(2 pi k s) - 1)."""
        phase = 2.0 * jnp.pi * self.frequency * slide.slip
        return 1.0 + self.a * jnp.sin(phase) + self.b * (jnp.cos(phase) - 1.0)


SLIP_PROBES: tuple[type[AbstractEffect], ...] = (
    OnsetProbe, TrendProbe, PressureProbe, SpeedProbe, DirectionProbe, SequenceProbe, WaveProbe,
)
