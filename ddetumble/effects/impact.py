"""Effects on impacts: the gas, the rubber wall, the arm, the force gauge, and the touching surfaces."""

from typing import ClassVar, final

import jax.numpy as jnp

from .._numerics import safe_power
from ..contact.effect import (
    AbstractContactForce,
    AbstractDriveEffect,
    AbstractEffect,
    AbstractElasticEffect,
    AbstractGasEffect,
    AbstractGeometryEffect,
    AbstractRestitutionEffect,
    AbstractSensorEffect,
    AbstractSizeEffect,
    AbstractStatefulEffect,
    AbstractStiffnessEffect,
    AbstractSurfaceForce,
    Contact,
    Scalar,
    parameter,
)
from ..contact.geometry import membrane_area_radius
from ..contact.signal import Signal, follow_friction, lag, low_pass, resonate


WALL_MODULUS = 7.8e6  # Table 2, E of the rubber [Pa]
REFERENCE_SPEED = 0.4  # m/s, of the paper's tests, so that amplitudes are sizes at its conditions
REFERENCE_PRESSURE = 1e6  # Pa, within the paper's 0 to 2.5 MPa, so that amplitudes are sizes at its conditions
# M/s, width of the change from loading to unloading: about 1 % of the paper's approach speed, yet smooth to integrate.
UNLOADING_SPEED = 5e-3


@final
class PolytropicGas(AbstractGasEffect):
    r"""Gas that is not isothermal: $P' = P_0 (V_0/V')^n$."""

    n: Scalar = parameter("", 1.0, typical=0.3, sign=1, bounds=(-3.0, 6.0), starts=(1.4,), text="polytropic exponent",
                          limits=(0.9, 1.7),
                          limits_reason="isothermal 1, adiabatic air 1.4, adiabatic monatomic gas 5/3; below 1 it "
                                        "would be heated as it expands")
    id: ClassVar[str] = "polytropic-gas"
    law: ClassVar[str] = "P' = P0 (V0/V')^n"
    reference: ClassVar[str] = "ideal gas; Eq. 3 is n = 1, adiabatic air is n = 1.4"
    requires: ClassVar[tuple[str, ...]] = ("gas",)

    def pressure_factor(self, contact: Contact) -> Scalar:
        """(V0/V')^(n - 1)."""
        return jnp.exp((self.n - 1.0) * jnp.log(contact.volume_ratio))


@final
class AmbientPressure(AbstractElasticEffect):
    r"""The atmosphere pushes back on the contact disc: $F_k = (P' - p_a) \pi b^2$."""

    p_a: Scalar = parameter("Pa", 0.0, typical=1e5, sign=1, starts=(1.0e5,), text="ambient pressure",
                            limits=(0.0, 1.2e5),
                            limits_reason="from vacuum to the highest pressure at sea level, 1.085e5 Pa")
    id: ClassVar[str] = "ambient-pressure"
    law: ClassVar[str] = "F_k = (P' - p_a) pi b^2"
    reference: ClassVar[str] = "force balance on the contact disc; Eq. 4 is p_a = 0 (vacuum)"
    requires: ClassVar[tuple[str, ...]] = ("gas", "geometry")

    def force(self, contact: Contact) -> Scalar:
        """-p_a pi b^2 [N]."""
        return -self.p_a * contact.contact_area


@final
class GasLeak(AbstractGasEffect, AbstractStatefulEffect):
    r"""Gas lost during contact: $dm/dt = -\lambda m$, $P' = P_0\,m\,(V_0/V')^n$."""

    leak_rate: Scalar = parameter("1/s", 0.0, name="lambda", typical=3.0, sign=1, bounds=(-30.0, 500.0), starts=(4.0,),
                                  text="rate at which gas is lost in contact", limits=(0.0, 150.0),
                                  limits_reason="choked flow of air through a hole of 10 mm empties the paper's ball "
                                                "by 140 a second")
    id: ClassVar[str] = "gas-leak"
    law: ClassVar[str] = "dm/dt = -lambda m in contact, m(0) = 1, P' = P0 m (V0/V')^n"
    reference: ClassVar[str] = "outflow through a leak or a valve; the paper names leakage of its end-effector"
    requires: ClassVar[tuple[str, ...]] = ("gas",)

    def pressure_factor(self, contact: Contact) -> Scalar:
        """The gas fraction m that is left."""
        return contact.state

    def initial(self) -> Scalar:
        """m(0) = 1."""
        return jnp.ones(())

    def rate(self, contact: Contact) -> Scalar:
        """-lambda m [1/s]."""
        return -self.leak_rate * contact.state

    def size(self, contact: Contact) -> Scalar:
        """1."""
        return jnp.ones(())


@final
class WallStiffness(AbstractElasticEffect):
    r"""The wall carries load beside the gas: $F_k$ gains $k_w \delta^q$."""

    k_w: Scalar = parameter("N/m^q", 0.0, typical=1000.0, sign=1, starts=(1000.0,), text="stiffness of the wall",
                            limits=(0.0, float("inf")),
                            limits_reason="a wall resists; its stiffness has no upper bound, and the unit changes "
                                          "with q")
    q: Scalar = parameter("", 1.0, kind="shape", typical=0.5, bounds=(0.5, 4.0), coordinate="log", free=False,
                          text="power of the depression", limits=(0.5, 3.0),
                          limits_reason="a dimple of a thin shell 1/2, bending 1, Hertz 3/2, a stretched membrane 3")
    id: ClassVar[str] = "wall-stiffness"
    law: ClassVar[str] = "F_k gains k_w delta^q"
    reference: ClassVar[str] = "bending and membrane stiffness of an inflated shell in parallel with its gas"

    def force(self, contact: Contact) -> Scalar:
        """k_w delta^q [N]."""
        return self.k_w * safe_power(contact.depression, self.q)


@final
class MembraneArea(AbstractGeometryEffect):
    r"""A membrane that keeps its area, not its perimeter: $b = (1-\alpha) b_{perimeter} + \alpha b_{area}$."""

    alpha: Scalar = parameter("", 0.0, typical=0.3, sign=1, bounds=(-1.5, 2.5), starts=(0.3,),
                              text="0: constant perimeter, 1: constant area", limits=(0.0, 1.25),
                              limits_reason="0 keeps the perimeter, 1 the area; well beyond 1 the membrane would have "
                                            "to shrink")
    id: ClassVar[str] = "membrane-area"
    law: ClassVar[str] = "b = (1 - alpha) b_perimeter + alpha b_area, 2 b_area^2 + pi b_area d + d^2 = D^2"
    reference: ClassVar[str] = "inextensible membrane; what a rising pressure needs, row 3 of `ddetumble paper`"
    requires: ClassVar[tuple[str, ...]] = ("geometry",)

    def contact_radius(self, contact: Contact) -> Scalar:
        """alpha (b_area - b_perimeter) [m]."""
        area = membrane_area_radius(contact.depression, contact.outer_diameter)
        return self.alpha * (area - contact.contact_radius)


@final
class InflationGrowth(AbstractSizeEffect):
    r"""Inflation stretches the ball: $D \to D (1 + \beta P_0/E)$."""

    beta: Scalar = parameter("", 0.0, typical=0.3, sign=1, starts=(0.4,), bounds=(-2.0, 5.0),
                             text="growth per P0/E, E = 7.8 MPa", limits=(0.0, 1.6),
                             limits_reason="thin sphere, (1 - nu) r/(2 t): 0.8 for the wall of Table 2, 1.6 for one "
                                           "half as thick")
    id: ClassVar[str] = "inflation-growth"
    law: ClassVar[str] = "D -> D (1 + beta P0/E)"
    reference: ClassVar[str] = "thin-walled pressure vessel; E from Table 2"
    requires: ClassVar[tuple[str, ...]] = ("gas", "geometry")

    def growth(self, contact: Contact) -> Scalar:
        """beta P0/E [-]."""
        return self.beta * contact.initial_pressure / WALL_MODULUS


@final
class ViscoelasticWall(AbstractContactForce, AbstractStatefulEffect):
    r"""A Maxwell branch of the rubber: $F_n$ gains $q$, $dq/dt = k_v w - q/\tau$."""

    k_v: Scalar = parameter("N/m", 0.0, typical=2000.0, sign=1, starts=(1500.0,),
                            text="stiffness of the Maxwell branch", limits=(0.0, 1e6),
                            limits_reason="a passive branch resists; at 1e6 N/m one millimetre would take a kilonewton")
    tau: Scalar = parameter("s", 5e-3, kind="shape", typical=3e-3, bounds=(5e-4, 2.0), coordinate="log",
                            starts=(1.5e-3, 6e-3, 2.5e-2), text="relaxation time",
                            limits=(1e-6, 1e4), limits_reason="rubber relaxes over microseconds to hours")
    id: ClassVar[str] = "viscoelastic-wall"
    law: ClassVar[str] = "F_n gains q: dq/dt = k_v w - q/tau in contact"
    reference: ClassVar[str] = "Maxwell element (standard linear solid with the gas spring)"

    def force(self, contact: Contact) -> Scalar:
        """q [N]."""
        return contact.state

    def initial(self) -> Scalar:
        """q(0) = 0."""
        return jnp.zeros(())

    def rate(self, contact: Contact) -> Scalar:
        """k_v w - q/tau [N/s]."""
        return self.k_v * contact.depression_rate - contact.state / self.tau

    def size(self, contact: Contact) -> Scalar:
        """10 N."""
        return 10.0 * jnp.ones(())


@final
class ViscousDashpot(AbstractContactForce):
    r"""A linear dashpot beside the spring: $F_n$ gains $c_v w$."""

    c_v: Scalar = parameter(
        "N s/m", 0.0, typical=5.0, sign=1, starts=(5.0,), text="dashpot constant", limits=(0.0, 1e3),
        limits_reason="a dashpot resists; 1.2 kg on 1e4 N/m with more than 220 N s/m would not rebound")
    id: ClassVar[str] = "viscous-dashpot"
    law: ClassVar[str] = "F_n gains c_v w in contact"
    reference: ClassVar[str] = "Kelvin-Voigt contact; the force jumps at first touch"

    def force(self, contact: Contact) -> Scalar:
        """c_v w [N]."""
        return self.c_v * contact.depression_rate


@final
class StressSoftening(AbstractStiffnessEffect):
    r"""Rubber softens over a series (Mullins): $F_k$ times $1 - \sigma_m (1 - e^{-(j-1)/j_0})$ at the $j$-th impact."""

    sigma_m: Scalar = parameter("", 0.0, typical=0.1, sign=1, bounds=(-1.0, 0.95), starts=(0.1,),
                                text="share of the stiffness lost in a long series", limits=(0.0, 0.9),
                                limits_reason="filled rubber loses up to about nine tenths of its stiffness (Mullins)")
    j_0: Scalar = parameter("", 3.0, kind="shape", typical=2.0, bounds=(0.1, 300.0), coordinate="log",
                            starts=(1.5, 5.0, 15.0), text="number of impacts until it has softened by 63 %",
                            limits=(0.3, 100.0),
                            limits_reason="rubber softens in the first few impacts, within a few tens at the latest")
    id: ClassVar[str] = "stress-softening"
    law: ClassVar[str] = "F_k times 1 - sigma_m (1 - exp(-(j - 1)/j_0)) at the j-th impact of a series"
    reference: ClassVar[str] = "Mullins effect of filled rubber"
    requires: ClassVar[tuple[str, ...]] = ("sequence",)

    def factor(self, contact: Contact) -> Scalar:
        """1 - sigma_m (1 - exp(-(j - 1)/j_0)) [-]."""
        number = contact.conditions["sequence"] - 1.0
        return 1.0 + self.sigma_m * jnp.expm1(-number / self.j_0)


@final
class ArmServo(AbstractDriveEffect):
    r"""The arm keeps following its command: $m_{eff} dw/dt$ gains $k_s (v_1 t - \delta)$."""

    k_s: Scalar = parameter("N/m", 0.0, typical=200.0, sign=1, starts=(200.0,), text="stiffness of the arm's servo",
                            limits=(0.0, 1e6),
                            limits_reason="a servo follows its command; the stiffest arms reach about 1e6 N/m")
    id: ClassVar[str] = "arm-servo"
    law: ClassVar[str] = "m_eff dw/dt gains k_s (v1 t - delta)"
    reference: ClassVar[str] = "position-controlled arm; what so long an impact needs, row 9 of `ddetumble paper`"

    def force(self, contact: Contact) -> Scalar:
        """k_s (v1 t - delta) [N]."""
        return self.k_s * (contact.approach_speed * contact.time - contact.depression)


@final
class SpeedDependentRestitution(AbstractRestitutionEffect):
    r"""$e = e_0 (v_1 / 0.4\,\mathrm{m/s})^{-p}$."""

    p: Scalar = parameter(
        "", 0.0, typical=0.1, bounds=(-2.0, 2.0), starts=(0.1,), text="power of the approach speed", limits=(-0.5, 0.5),
        limits_reason="plastic impact has 1/4 (Johnson 1985); adhesion at low speed makes it negative")
    id: ClassVar[str] = "speed-dependent-restitution"
    law: ClassVar[str] = "e = e0 (v1 / 0.4 m/s)^(-p)"
    reference: ClassVar[str] = "restitution of rubber falls with speed (Goldsmith, Impact, 1960)"
    requires: ClassVar[tuple[str, ...]] = ("damping",)

    def factor(self, contact: Contact) -> Scalar:
        """(v1 / 0.4 m/s)^(-p)."""
        return jnp.exp(-self.p * jnp.log(contact.approach_speed / REFERENCE_SPEED))


@final
class PressureDependentRestitution(AbstractRestitutionEffect):
    r"""$e = e_0 (P_0 / 1\,\mathrm{MPa})^{-p}$."""

    p: Scalar = parameter("", 0.0, typical=0.1, bounds=(-2.0, 2.0), starts=(0.1,), text="power of the pressure",
                          limits=(-1.0, 1.0),
                          limits_reason="at 1 it falls as 1/pressure, by a factor of 2.5 from 1 to 2.5 MPa")
    id: ClassVar[str] = "pressure-dependent-restitution"
    law: ClassVar[str] = "e = e0 (P0 / 1 MPa)^(-p)"
    reference: ClassVar[str] = "the share of the wall in the losses changes with inflation"
    requires: ClassVar[tuple[str, ...]] = ("damping", "gas")

    def factor(self, contact: Contact) -> Scalar:
        """(P0 / 1 MPa)^(-p); 1 where there is no pressure."""
        some = contact.initial_pressure > 0
        return jnp.where(some, safe_power(contact.initial_pressure / REFERENCE_PRESSURE, -self.p), 1.0)


@final
class SensorHysteresis(AbstractSensorEffect):
    r"""Friction in the gauge: measured $= F - h w z$, $dz/dF = (1 - z)/w$ while F rises, $(1 + z)/w$ while it falls."""

    h: Scalar = parameter("", 0.0, typical=0.02, sign=1, bounds=(-1.0, 2.0), starts=(0.05,),
                          text="share of a change of the force that friction takes at first", limits=(0.0, 1.0),
                          limits_reason="beyond 1 the reading would fall while the force rises")
    w: Scalar = parameter("N", 20.0, kind="shape", typical=10.0, bounds=(0.3, 1e3), coordinate="log",
                          starts=(15.0,), text="change of the force over which friction turns",
                          limits=(0.01, 1e5), limits_reason="friction turns within the range of a gauge, from grams "
                                                            "to tonnes")
    id: ClassVar[str] = "sensor-hysteresis"
    law: ClassVar[str] = "measured = F - h w z, dz/dF = (1 - z)/w while F rises, (1 + z)/w while it falls, z(0) = 0"
    reference: ClassVar[str] = "Dahl 1968, A Solid Friction Model, TOR-0158(3107-18)-1: friction of a gauge's joints"
    order: ClassVar[int] = 0

    def reading(self, force: Signal) -> Signal:
        """F - h w z [N]."""
        return force.minus(follow_friction(force, self.w).map(lambda z: self.h * self.w * z))


@final
class SensorHighpass(AbstractSensorEffect):
    r"""Charge amplifier: measured $= F - y$, $dy/dt = (F - y)/\tau_s$."""

    decay_rate: Scalar = parameter("s", 0.0, name="tau_s", typical=1.0, sign=1, bounds=(-0.5, 500.0), starts=(1.0,),
                                   coordinate="inverse", text="discharge time constant", limits=(0.01, float("inf")),
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
                          limits_reason="a gauge slower than an impact, about 50 ms, does not show one")
    id: ClassVar[str] = "sensor-lag"
    law: ClassVar[str] = "T dF_m/dt = F - F_m"
    reference: ClassVar[str] = "first-order sensor or anti-aliasing filter"
    order: ClassVar[int] = 2

    def reading(self, force: Signal) -> Signal:
        """F_m [N]."""
        return lag(force, self.T)


@final
class SensorFilter(AbstractSensorEffect):
    r"""Second-order filter: $\ddot F_m/\omega_c^2 + \sqrt2\dot F_m/\omega_c + F_m = F$, $\omega_c = 2\pi f_c$."""

    period: Scalar = parameter("Hz", 0.0, name="f_c", typical=1e-3, sign=1, bounds=(-1e-5, 0.1),
                               starts=(1.0 / 150.0, 1.0 / 400.0), coordinate="inverse", singular=True,
                               text="corner frequency of the amplifier's low-pass filter", limits=(20.0, float("inf")),
                               limits_reason="a gauge slower than an impact, about 50 ms, does not show one")
    id: ClassVar[str] = "sensor-filter"
    law: ClassVar[str] = "F_m''/w_c^2 + sqrt(2) F_m'/w_c + F_m = F, w_c = 2 pi f_c"
    reference: ClassVar[str] = "Butterworth low-pass of an amplifier (Butterworth 1930); null is 1/f_c = 0"
    order: ClassVar[int] = 3
    costly: ClassVar[bool] = True

    def reading(self, force: Signal) -> Signal:
        """F_m [N]."""
        return resonate(force, self.period, jnp.sqrt(0.5))


@final
class SensorGain(AbstractSensorEffect):
    r"""Wrong calibration: measured $= g F$."""

    g: Scalar = parameter("", 1.0, typical=0.05, bounds=(0.05, 20.0), starts=(1.05,), text="gain",
                          limits=(0.5, 2.0), limits_reason="beyond these it is a wrong unit or range")
    id: ClassVar[str] = "sensor-gain"
    law: ClassVar[str] = "measured = g F"
    reference: ClassVar[str] = "calibration of the force gauge"
    order: ClassVar[int] = 4

    def reading(self, force: Signal) -> Signal:
        """g F [N]."""
        return force.map(lambda f: self.g * f)


@final
class SensorResonance(AbstractSensorEffect):
    r"""The gauge rings: $\ddot F_m/\omega_0^2 + 2\zeta\dot F_m/\omega_0 + F_m = F$, $\omega_0 = 2\pi f_0$."""

    period: Scalar = parameter("Hz", 0.0, name="f_0", typical=1e-3, sign=1, bounds=(-1e-5, 0.1),
                               starts=(1.0 / 130.0, 1.0 / 400.0), coordinate="inverse", singular=True,
                               text="natural frequency of the gauge on its mount", limits=(20.0, float("inf")),
                               limits_reason="a gauge slower than an impact, about 50 ms, does not show one")
    zeta: Scalar = parameter("", 0.05, kind="shape", typical=0.05, bounds=(1e-3, 0.35), coordinate="log",
                             starts=(0.05,), text="damping ratio", limits=(1e-3, 0.35),
                             limits_reason="steel and its joints have 0.001 to 0.05, a gauge on rubber up to 0.3; one "
                                           "beyond does not ring, it lags")
    id: ClassVar[str] = "sensor-resonance"
    law: ClassVar[str] = "F_m''/w_0^2 + 2 zeta F_m'/w_0 + F_m = F, w_0 = 2 pi f_0"
    reference: ClassVar[str] = "second-order instrument (Doebelin, Measurement Systems); null is 1/f_0 = 0"
    # Linear filters may change places; after the slow ones it sees a smooth force.
    order: ClassVar[int] = 5
    rings: ClassVar[bool] = True
    costly: ClassVar[bool] = True
    line: ClassVar[str | None] = "sensor-resonance.f_0"

    def reading(self, force: Signal) -> Signal:
        """F_m [N]."""
        return resonate(force, self.period, self.zeta)


@final
class Adhesion(AbstractSurfaceForce):
    r"""The disc sticks while it unloads: $F_n$ loses $\tau_a \pi b^2 \cdot \frac12 (1 - \tanh(w/5\,\mathrm{mm/s}))$."""

    tau_a: Scalar = parameter("Pa", 0.0, typical=2e4, sign=1, starts=(2e4,), text="adhesive stress",
                              limits=(0.0, 1e6), limits_reason="the tack of rubber is about 0.1 to 1 MPa")
    id: ClassVar[str] = "adhesion"
    law: ClassVar[str] = "F_n loses tau_a pi b^2 (1 - tanh(w / 5 mm/s))/2: tension is possible"
    reference: ClassVar[str] = "adhesion hysteresis of rubber: work is needed to separate, none is gained in touching"
    requires: ClassVar[tuple[str, ...]] = ("geometry",)

    def force(self, contact: Contact) -> Scalar:
        """-tau_a pi b^2 (1 - tanh(w / 5 mm/s))/2 [N]."""
        unloading = 0.5 * (1.0 - jnp.tanh(contact.depression_rate / UNLOADING_SPEED))
        return -self.tau_a * contact.contact_area * unloading


IMPACT: tuple[type[AbstractEffect], ...] = (
    PolytropicGas, AmbientPressure, WallStiffness, MembraneArea, InflationGrowth, GasLeak, ViscoelasticWall,
    ViscousDashpot, Adhesion, ArmServo, SpeedDependentRestitution, PressureDependentRestitution, StressSoftening,
    SensorHysteresis, SensorHighpass, SensorLag, SensorFilter, SensorGain, SensorResonance,
)
