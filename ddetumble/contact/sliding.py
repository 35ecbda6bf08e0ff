"""The friction law: a reference model of the friction force over slip, with effects applied to it (Eqs. 8 to 11)."""

import abc
from collections.abc import Mapping
from typing import Any, ClassVar, final

import equinox as eqx
import jax.numpy as jnp
from equinox import AbstractClassVar
from jaxtyping import Array

from .effect import AbstractEffect, AbstractLaw, AbstractModel, Scalar, parameter
from .friction import (
    ADVISED_UP_TO,
    POLYNOMIALS,
    SlipCoefficients,
    composite_modulus,
    rubber_coefficient,
    slip_coefficient,
    slip_coefficients,
)


# Load about which the polynomials of `SlipCurves` are written, and its unit: the middle of the paper's range of 5 to
# 28 N, so that their coefficients are nearly uncorrelated and of order one [N].
MIDDLE, STRIDE = 15.0, 10.0


@final
class Slide(eqx.Module):
    """The state of sliding that an effect sees; every entry is a scalar (the caller batches by `vmap`).

    Attributes:
        slip: distance slid since the stroke began, not negative [m].
        slip_speed: not negative [m/s].
        normal_load: F_n [N].
        internal_pressure: of the gas, absolute [Pa]; 0 where the campaign has none.
        work: W, integral of the friction force over the path since the record began [J].
        time: since the record began; of records without times, slip over slip speed [s].
        direction: of the stroke, +1 or -1.
        conditions: every condition of the record by name, SI.
    """

    slip: Scalar
    slip_speed: Scalar
    normal_load: Scalar
    internal_pressure: Scalar
    work: Scalar
    time: Scalar
    direction: Scalar
    conditions: Mapping[str, Array]


class AbstractRubberEffect(AbstractEffect):
    """Multiplies the Eq. 8 part of the friction coefficient."""

    stage: ClassVar[str] = "rubber"
    family: ClassVar[str] = "slip"

    @abc.abstractmethod
    def factor(self, slide: Slide) -> Scalar:
        """Factor on the Eq. 8 part [-]; 1 at the null."""


class AbstractLoadEffect(AbstractEffect):
    """Multiplies the whole coefficient times the load."""

    stage: ClassVar[str] = "load"
    family: ClassVar[str] = "slip"

    @abc.abstractmethod
    def factor(self, slide: Slide) -> Scalar:
        """Factor on the coefficient [-]; 1 at the null."""


class AbstractFrictionForce(AbstractEffect):
    """Adds to the friction force, against the motion."""

    stage: ClassVar[str] = "friction"
    family: ClassVar[str] = "slip"

    @abc.abstractmethod
    def force(self, slide: Slide) -> Scalar:
        """Increment of the friction force, against the motion [N]."""


class AbstractFriction(AbstractModel):
    """A reference model of friction; effects may require `rubber` of it, a part that is Eq. 8's."""

    family: ClassVar[str] = "slip"
    provides: AbstractClassVar[tuple[str, ...]]

    @abc.abstractmethod
    def rubber(self, slide: Slide) -> Scalar:
        """Coefficient of adhesion and hysteresis, Eq. 8 [-]."""

    def slipping(self, slide: Slide) -> Scalar:
        """Coefficient of the slip term, Eq. 9 [-]; 0 where the model has none."""
        return jnp.zeros_like(slide.slip)

    def extend(self, effects: tuple[AbstractEffect, ...]) -> "FrictionLaw":
        """This model with effects."""
        return FrictionLaw(self, effects)


class AbstractRubberFriction(AbstractFriction):
    """Friction whose adhesive and hysteretic part is Eq. 8, with $p_c = P'$."""

    adhesion_constant: Scalar = parameter(
        "", 0.8, kind="reference", typical=0.4, coordinate="log", bounds=(0.0, jnp.inf), text="K of Eq. 8",
        limits=(0.0, 20.0), limits_reason="20 would be a coefficient of friction of 1.2 at a loss factor of 0.15")
    loss_factor: Scalar = parameter("", 0.15, kind="reference", typical=0.1, coordinate="log", bounds=(0.0, jnp.inf),
                                    text="tan of the loss angle", limits=(0.0, 3.0),
                                    limits_reason="rubber has 0.05 to 0.3, and 3 at its glass transition")
    tensile_strength: Scalar = parameter("Pa", 10e6, kind="reference", typical=1e6, coordinate="log",
                                         bounds=(0.0, jnp.inf), free=False, text="sigma_0 of Eq. 8",
                                         limits=(1e4, 1e9), limits_reason="from a gel to a stiff plastic")
    real_contact_pressure: Scalar = parameter("Pa", 20e6, kind="reference", typical=2e6, coordinate="log",
                                              bounds=(0.0, jnp.inf), free=False, text="p_r of Eq. 8",
                                              limits=(1e4, 1e10), limits_reason="from a gel to the hardness of steel")
    elastic_modulus: Scalar = parameter("Pa", 7.8e6, kind="reference", typical=1e6, coordinate="log",
                                        bounds=(0.0, jnp.inf), free=False, text="Young's modulus E of the rubber",
                                        limits=(1e4, 1e10), limits_reason="from a gel to a stiff plastic")
    poisson_ratio: Scalar = parameter("", 0.47, kind="reference", typical=0.05, bounds=(-1.0, 0.5), free=False,
                                      text="Poisson's ratio of the rubber",
                                      limits=(-1.0, 0.5), limits_reason="an isotropic solid is stable within these")
    provides: ClassVar[tuple[str, ...]] = ("rubber",)

    def rubber(self, slide: Slide) -> Scalar:
        """Eq. 8 [-]."""
        modulus = composite_modulus(self.elastic_modulus, self.poisson_ratio)
        return rubber_coefficient(self.adhesion_constant, self.loss_factor,
                                  self.tensile_strength / self.real_contact_pressure, slide.internal_pressure, modulus)


@final
class RubberFriction(AbstractRubberFriction):
    r"""Eq. 11: $f = (\mu_{rubber} + s_c\,\mu_{slip}(s)) F_n$ against the motion.

    `printed` takes e from Eq. 10 as printed (friction at zero slip is negative then) instead of 1.
    """

    slip_scale: Scalar = parameter("", 1.0, kind="reference", typical=0.3, text="factor on the slip term",
                                   limits=(0.0, 10.0),
                                   limits_reason="Eq. 10 as printed has 1; friction does not drive the slip")
    printed: bool = eqx.field(static=True, default=False)
    valid: ClassVar[Mapping[str, tuple[float, float]]] = {"normal_load": (0.0, ADVISED_UP_TO)}

    def slipping(self, slide: Slide) -> Scalar:
        """Eqs. 9 and 10 at the record's load, scaled [-]."""
        return self.slip_scale * slip_coefficient(slide.slip, slip_coefficients(slide.normal_load, self.printed))


def _centre(name: str) -> tuple[float, float, float]:
    """A polynomial of Eq. 10 in x = (load - 15 N)/10 N, ascending; `name` is one coefficient, or `b+d` or `b-d`."""
    p, q, r = POLYNOMIALS[name[0]]
    if name[1:]:
        sign = -1.0 if name[1] == "-" else 1.0
        p, q, r = (one + sign * other for one, other in zip((p, q, r), POLYNOMIALS["d"], strict=True))
    return p + q * MIDDLE + r * MIDDLE**2, (q + 2.0 * r * MIDDLE) * STRIDE, r * STRIDE**2


def _slope(name: str, power: int, unit: str, typical: float, text: str, free: bool = True) -> Any:
    """A coefficient of a polynomial in x, from Eq. 10's own value on; of e, which is held, from 1 on."""
    there = f"at {MIDDLE:g} N" + ("" if "+" in name or "-" in name else f"; {name}0 of Eq. 10, at no load, is derived")
    x = f"x = (load - {MIDDLE:g} N)/({STRIDE:g} N)"
    part = f" {(there, f'per {x}', f'per x^2, {x}')[power]}"
    begin = float(power == 0) if name == "e" else _centre(name)[power]
    return parameter(unit, begin, kind="reference", typical=typical, text=text + part, free=free,
                     limits=(-50.0, 50.0), limits_reason="hundreds of times what Eq. 10 has")


@final
class SlipCurves(AbstractRubberFriction):
    r"""Eq. 11 with the coefficients of Eq. 10 free: polynomials of the load, in coordinates that records determine.

    $\mu_{slip}(s) = a\,[1 + \tfrac{c-e}{2} e^{(b+d)s} - \tfrac{c+e}{2} e^{(b-d)s}]$ is Eq. 9: two exponentials. Free
    are $a$ (linear) and $b + d$, $b - d$ and $c$ (quadratic) in $x = (F_n - 15\,N)/10\,N$, where loads of 5 to 28 N lie
    about zero. $e$ is held at 1: friction at zero slip is $a (1 - e)$ and Eq. 8, which strokes at one pressure do not
    tell apart. So `a_0` is $a$ at 15 N and not the $a_0$ of Eq. 10, its value at no load: `derive` gives a0, a1, b0 and
    all others of Eq. 10.
    """

    a_0: Scalar = _slope("a", 0, "", 0.05, "a of Eq. 9")
    a_1: Scalar = _slope("a", 1, "", 0.05, "a of Eq. 9")
    sum_0: Scalar = _slope("b+d", 0, "1/mm", 0.02, "b + d of Eq. 9")
    sum_1: Scalar = _slope("b+d", 1, "1/mm", 0.02, "b + d of Eq. 9")
    sum_2: Scalar = _slope("b+d", 2, "1/mm", 0.02, "b + d of Eq. 9")
    difference_0: Scalar = _slope("b-d", 0, "1/mm", 0.05, "b - d of Eq. 9")
    difference_1: Scalar = _slope("b-d", 1, "1/mm", 0.05, "b - d of Eq. 9")
    difference_2: Scalar = _slope("b-d", 2, "1/mm", 0.05, "b - d of Eq. 9")
    c_0: Scalar = _slope("c", 0, "", 0.02, "c of Eq. 9")
    c_1: Scalar = _slope("c", 1, "", 0.02, "c of Eq. 9")
    c_2: Scalar = _slope("c", 2, "", 0.02, "c of Eq. 9")
    e_0: Scalar = _slope("e", 0, "", 0.02, "e of Eq. 9", free=False)
    e_1: Scalar = _slope("e", 1, "", 0.02, "e of Eq. 9", free=False)
    e_2: Scalar = _slope("e", 2, "", 0.02, "e of Eq. 9", free=False)
    # With other coefficients the second exponential may grow elsewhere, but nothing tells where before they are known.
    valid: ClassVar[Mapping[str, tuple[float, float]]] = {"normal_load": (0.0, ADVISED_UP_TO)}

    def slipping(self, slide: Slide) -> Scalar:
        """Eq. 9 at the record's load [-]."""
        x = (slide.normal_load - MIDDLE) / STRIDE
        a = self.a_0 + self.a_1 * x
        total = self.sum_0 + x * (self.sum_1 + x * self.sum_2)
        rest = self.difference_0 + x * (self.difference_1 + x * self.difference_2)
        c, e = self.c_0 + x * (self.c_1 + x * self.c_2), self.e_0 + x * (self.e_1 + x * self.e_2)
        return slip_coefficient(slide.slip, SlipCoefficients(a, 0.5 * (total + rest), c, 0.5 * (total - rest), e))

    def derive(self) -> Mapping[str, tuple[Scalar, str]]:
        """a...e of Eq. 10 in ascending powers of the load, b and d per millimetre."""
        zero = jnp.zeros_like(self.a_0)
        total, rest = (self.sum_0, self.sum_1, self.sum_2), (self.difference_0, self.difference_1, self.difference_2)
        found = {}
        for name, inverse, (p, q, r) in (
                ("a", "", (self.a_0, self.a_1, zero)),
                ("b", "mm", tuple(0.5 * (s + t) for s, t in zip(total, rest, strict=True))),
                ("c", "", (self.c_0, self.c_1, self.c_2)),
                ("d", "mm", tuple(0.5 * (s - t) for s, t in zip(total, rest, strict=True))),
                ("e", "", (self.e_0, self.e_1, self.e_2))):
            q, r = q / STRIDE, r / STRIDE**2
            for power, value in enumerate((p - q * MIDDLE + r * MIDDLE**2, q - 2.0 * r * MIDDLE, r)):
                units = [one for one in (inverse, ("", "N", "N^2")[power]) if one]
                unit = f"1/({'*'.join(units)})" if len(units) > 1 else f"1/{units[0]}" if units else ""
                if name != "a" or power < 2:
                    found[f"{name}{power}"] = value, unit
        return found


@final
class AdhesionHysteresis(AbstractRubberFriction):
    """Eq. 8 alone: adhesion and hysteresis without the slip term, whose load polynomials end at 31 N."""


@final
class CoulombFriction(AbstractFriction):
    r"""A constant coefficient of friction, $f = \mu F_n$: the simplest model to compare a measurement with."""

    friction_coefficient: Scalar = parameter("", 0.3, kind="reference", typical=0.1, coordinate="log",
                                             bounds=(0.0, jnp.inf), text="friction over load", limits=(0.0, 10.0),
                                             limits_reason="0.01 if lubricated, dry rubber 1 to 4, the softest about "
                                                           "10")
    provides: ClassVar[tuple[str, ...]] = ("rubber",)

    def rubber(self, slide: Slide) -> Scalar:
        """The constant; effects on Eq. 8's part act on it."""
        return self.friction_coefficient


@final
class FrictionLaw(AbstractLaw):
    """A reference model and the effects that extend it; factors multiply, forces add.

    Attributes:
        reference: the reference model.
        effects: any number of effects, at their null or not.
    """

    reference: AbstractFriction
    effects: tuple[AbstractEffect, ...] = ()

    def force(self, slide: Slide) -> Scalar:
        """Friction force against the motion [N] (Eq. 11 with the effects)."""
        rubber = self.reference.rubber(slide)
        for effect in self.pick("rubber"):
            rubber = rubber * effect.factor(slide)
        force = (rubber + self.reference.slipping(slide)) * slide.normal_load
        for effect in self.pick("load"):
            force = force * effect.factor(slide)
        for effect in self.pick("friction"):
            force = force + effect.force(slide)
        return force
