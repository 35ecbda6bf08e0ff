"""Effects on slip records: what Eqs. 8 to 11 leave out."""

from typing import ClassVar, final

import jax.numpy as jnp

from ..contact.effect import AbstractEffect, Scalar, parameter
from ..contact.sliding import AbstractFrictionForce, AbstractLoadEffect, AbstractRubberEffect, Slide


REFERENCE_LOAD = 10.0  # N, so that the exponent turns the law about a usual load and leaves the coefficient there


@final
class Stribeck(AbstractRubberEffect):
    r"""More friction at low speed: the Eq. 8 part times $1 + A e^{-(u/u_s)^2}$."""

    A: Scalar = parameter(
        "", 0.0, typical=0.2, starts=(0.2,), bounds=(-1.0, jnp.inf), text="excess at low speed", limits=(-1.0, 5.0),
        limits_reason="at -1 friction vanishes; friction at rest is at most a few times that of fast sliding")
    u_s: Scalar = parameter("m/s", 0.1, kind="shape", typical=0.05, coordinate="log", bounds=(1e-6, 1e3),
                            starts=(0.03, 0.1, 0.3), text="Stribeck speed",
                            limits=(1e-5, 10.0), limits_reason="speeds at which a film forms or rubber stiffens")
    id: ClassVar[str] = "stribeck"
    law: ClassVar[str] = "the Eq. 8 part of mu times 1 + A exp(-(u/u_s)^2)"
    reference: ClassVar[str] = "Stribeck 1902; Armstrong-Helouvry et al. 1994, Automatica 30, 1083"
    requires: ClassVar[tuple[str, ...]] = ("rubber", "slip_speed")

    def factor(self, slide: Slide) -> Scalar:
        """1 + A exp(-(u/u_s)^2)."""
        return 1.0 + self.A * jnp.exp(-((slide.slip_speed / self.u_s) ** 2))


@final
class ViscousFriction(AbstractFrictionForce):
    """Friction that grows with the speed: f gains c_t u."""

    c_t: Scalar = parameter("N*s/m", 0.0, typical=1.0, sign=1, starts=(0.5,), text="viscous coefficient",
                            limits=(0.0, 100.0),
                            limits_reason="friction resists; at 0.1 m/s 100 N s/m gives 10 N, as much as dry friction")
    id: ClassVar[str] = "viscous-friction"
    law: ClassVar[str] = "f gains c_t u"
    reference: ClassVar[str] = "Armstrong-Helouvry et al. 1994, Automatica 30, 1083"
    requires: ClassVar[tuple[str, ...]] = ("slip_speed",)

    def force(self, slide: Slide) -> Scalar:
        """c_t u [N]."""
        return self.c_t * slide.slip_speed


@final
class LoadExponent(AbstractLoadEffect):
    r"""Friction not proportional to the load: the coefficient times $(F_n/10\,\mathrm{N})^{-m}$ (Hertz: m = 1/3)."""

    m: Scalar = parameter("", 0.0, typical=0.05, starts=(0.05,), text="exponent of the load", limits=(-1.0, 1.0),
                          limits_reason="0 proportional to the load, 1/3 Hertz, 1 independent of the load")
    id: ClassVar[str] = "load-exponent"
    law: ClassVar[str] = "(Eq. 8 part + mu_slip) F_n times (F_n/10 N)^(-m)"
    reference: ClassVar[str] = "Schallamach 1952, Proc. Phys. Soc. B 65, 657"

    def factor(self, slide: Slide) -> Scalar:
        """(F_n/10 N)^(-m)."""
        return jnp.exp(-self.m * jnp.log(slide.normal_load / REFERENCE_LOAD))


@final
class Presliding(AbstractRubberEffect):
    r"""Adhesion takes some slip to build up: the Eq. 8 part times $1 - e^{-s/s_0}$, s since the stroke began."""

    s_0: Scalar = parameter("m", 0.0, typical=1e-4, sign=1, starts=(2e-4, 5e-6), bounds=(0.0, 0.1), singular=True,
                            text="slip over which friction builds up",
                            limits=(0.0, 0.02), limits_reason="friction builds up within the size of the contact patch")
    id: ClassVar[str] = "presliding"
    law: ClassVar[str] = "the Eq. 8 part of mu times 1 - exp(-s/s_0)"
    reference: ClassVar[str] = "Dahl 1968; Armstrong-Helouvry et al. 1994, Automatica 30, 1083"
    requires: ClassVar[tuple[str, ...]] = ("rubber",)

    def factor(self, slide: Slide) -> Scalar:
        """1 - exp(-s/s_0); 1 for s_0 = 0."""
        some = self.s_0 > 0
        return 1.0 - jnp.where(some, jnp.exp(-slide.slip / jnp.where(some, self.s_0, 1.0)), 0.0)


@final
class FrictionalHeating(AbstractRubberEffect):
    r"""Rubber that warms loses friction: the Eq. 8 part times $e^{-\kappa W}$, $W = \int f\,ds$ of the total f."""

    kappa: Scalar = parameter(
        "1/J", 0.0, typical=2.0, sign=1, starts=(2.0,), text="loss per unit of friction work", limits=(0.0, 200.0),
        limits_reason="rubber loses 1 % per kelvin, and 0.03 mg is heated: 10 micrometres under 3 square millimetres")
    id: ClassVar[str] = "frictional-heating"
    law: ClassVar[str] = "the Eq. 8 part of mu times exp(-kappa W), W = integral of f ds"
    reference: ClassVar[str] = "Persson 2006, J. Phys.: Condens. Matter 18, 7789"
    requires: ClassVar[tuple[str, ...]] = ("rubber",)

    def factor(self, slide: Slide) -> Scalar:
        """exp(-kappa W)."""
        return jnp.exp(-self.kappa * slide.work)


@final
class AdhesiveOffset(AbstractFrictionForce):
    """Friction without load: f gains f_a."""

    f_a: Scalar = parameter(
        "N", 0.0, typical=0.3, sign=1, starts=(0.2,), text="friction without load", limits=(0.0, 50.0),
        limits_reason="shear strength of a rubber contact, about 0.3 MPa, over 1.5 square centimetres")
    id: ClassVar[str] = "adhesive-offset"
    law: ClassVar[str] = "f gains f_a, independent of load"
    reference: ClassVar[str] = "Derjaguin 1934; Roberts & Thomas 1975, Wear 33, 45"
    lookalike: ClassVar[str] = (
        "a zero of the friction force's gauge that is off alike in all records, unless the ball slides both ways or "
        "the gauge was read unloaded")

    def force(self, slide: Slide) -> Scalar:
        """f_a [N]."""
        return self.f_a * jnp.ones_like(slide.normal_load)


SLIP: tuple[type[AbstractEffect], ...] = (
    Stribeck, ViscousFriction, LoadExponent, Presliding, FrictionalHeating, AdhesiveOffset,
)
