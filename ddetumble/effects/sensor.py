"""Effects of the force gauge and its amplifier."""

from typing import ClassVar, final

from ..contact.effect import AbstractSensorEffect, Scalar, parameter
from ..contact.signal import Signal, lag, low_pass


@final
class SensorHighpass(AbstractSensorEffect):
    r"""Charge amplifier: measured $= F - y$, $dy/dt = (F - y)/\tau_s$."""

    decay_rate: Scalar = parameter("s", 0.0, name="tau_s", typical=1.0, sign=1, bounds=(-0.5, 500.0),
                                   starts=(1.0,), coordinate="inverse", text="discharge time constant",
                                   limits=(0.01, float("inf")),
                                   limits_reason="a charge amplifier that discharges within 10 ms measures no impact")
    id: ClassVar[str] = "sensor-highpass"
    law: ClassVar[str] = "measured = F - y, dy/dt = (F - y)/tau_s"
    reference: ClassVar[str] = "drift of a piezoelectric gauge's charge amplifier; null is 1/tau_s = 0"
    order: ClassVar[int] = 1

    def reading(self, force: Signal) -> Signal:
        """F - y [N]."""
        return force.minus(low_pass(force, self.decay_rate))


@final
class SensorLag(AbstractSensorEffect):
    r"""First-order lag of the sensor: $T\,dF_m/dt = F - F_m$."""

    T: Scalar = parameter("s", 0.0, typical=5e-4, sign=1, bounds=(-1e-4, 0.5), starts=(8e-4,), text="time constant",
                          limits=(0.0, 0.05),
                          limits_reason="a gauge slower than an impact, some 50 ms, does not show one")
    id: ClassVar[str] = "sensor-lag"
    law: ClassVar[str] = "T dF_m/dt = F - F_m"
    reference: ClassVar[str] = "first-order sensor or anti-aliasing filter"
    order: ClassVar[int] = 2

    def reading(self, force: Signal) -> Signal:
        """F_m [N]."""
        return lag(force, self.T)


@final
class SensorGain(AbstractSensorEffect):
    r"""Wrong calibration: measured $= g F$."""

    g: Scalar = parameter("", 1.0, typical=0.05, bounds=(0.05, 20.0), starts=(1.05,), text="gain",
                          limits=(0.5, 2.0), limits_reason="further off it is a wrong unit or range, not a calibration")
    id: ClassVar[str] = "sensor-gain"
    law: ClassVar[str] = "measured = g F"
    reference: ClassVar[str] = "calibration of the force gauge"
    order: ClassVar[int] = 3

    def reading(self, force: Signal) -> Signal:
        """g F [N]."""
        return force.map(lambda f: self.g * f)
