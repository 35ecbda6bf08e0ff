"""The contract of effects: kept by the whole catalogue and by a user's effect, broken ones are caught."""

from typing import ClassVar, final

import equinox as eqx
import jax.numpy as jnp
import pytest

from ddetumble._errors import InputError
from ddetumble._numerics import positive_part, scalar
from ddetumble.contact.contract import check_effect
from ddetumble.contact.effect import (
    AbstractContactForce,
    AbstractElasticEffect,
    AbstractGasEffect,
    AbstractStatefulEffect,
    Contact,
    Scalar,
    list_stages,
    parameter,
)
from ddetumble.contact.law import PowerLaw
from ddetumble.effects import IMPACT
from ddetumble.effects.impact import WallStiffness


@final
class EndStop(AbstractElasticEffect):
    """The ball bottoms out: $F_k$ gains $k (\\delta - \\delta_s)_+$."""

    k: Scalar = parameter("N/m", typical=2000.0, sign=1, starts=(5000.0,))
    depth: Scalar = parameter("m", 4e-3, kind="shape", typical=2e-3, starts=(2e-3, 4e-3, 6e-3))
    id: ClassVar[str] = "end-stop"
    law: ClassVar[str] = "F_k gains k max(depression - depth, 0)"
    reference: ClassVar[str] = "the valve inside the ball"

    def force(self, contact: Contact) -> Scalar:
        return self.k * positive_part(contact.depression - self.depth)


class Restated(AbstractElasticEffect):
    """States the stage that its class has already."""

    stage: ClassVar[str] = "elastic"


def test_stage_stated_again():
    assert list_stages(Restated) == ["elastic"]


class Broken(AbstractElasticEffect):
    """What the broken effects share."""

    k: Scalar = parameter("N/m", typical=1000.0, starts=(1000.0,))
    id: ClassVar[str] = "broken"
    law: ClassVar[str] = "F_k gains k depression"
    reference: ClassVar[str] = "this test"

    def force(self, contact: Contact) -> Scalar:
        return self.k * contact.depression


class Present(Broken):
    def force(self, contact: Contact) -> Scalar:
        return (self.k + 1e-9) * contact.depression


class Dead(Broken):
    def force(self, contact: Contact) -> Scalar:
        return self.k**2 * contact.depression


class Steep(Broken):
    def force(self, contact: Contact) -> Scalar:
        return jnp.sqrt(self.k) * contact.depression


class NotANumber(Broken):
    def force(self, contact: Contact) -> Scalar:
        return self.k * contact.depression * jnp.log(1.0 - self.k)


class Branching(Broken):
    def force(self, contact: Contact) -> Scalar:
        return self.k * contact.depression if contact.depression > 1e-3 else jnp.zeros(())


class Unheard(Broken):
    def force(self, contact: Contact) -> Scalar:
        return self.k * contact.depression * contact.conditions["humidity"]


class Numpy(Broken):
    def force(self, contact: Contact) -> Scalar:
        return jnp.asarray(float(self.k)) * contact.depression


class BadUnit(Broken):
    k: Scalar = parameter("newtonish/m", typical=1000.0, starts=(1000.0,))


class NoUnit(Broken):
    extra: Scalar = eqx.field(converter=scalar, default=0.0)


class Unnamed(Broken):
    reference: ClassVar[str] = ""


class Useless(Broken):
    shape: Scalar = parameter("", 1.0, kind="shape", starts=(1.0, 2.0))


class TwoStages(AbstractElasticEffect, AbstractContactForce):
    id: ClassVar[str] = "two"
    law: ClassVar[str] = "F gains k depression"
    reference: ClassVar[str] = "this test"
    k: Scalar = parameter("N/m", typical=1000.0)

    def force(self, contact: Contact) -> Scalar:
        return self.k * contact.depression


class Drifting(AbstractGasEffect, AbstractStatefulEffect):
    """Its state moves at the null."""

    k: Scalar = parameter("1/s", typical=1.0, starts=(1.0,))
    id: ClassVar[str] = "drifting"
    law: ClassVar[str] = "dm/dt = -(k + 0.1)"
    reference: ClassVar[str] = "this test"

    def pressure_factor(self, contact: Contact) -> Scalar:
        return contact.state

    def initial(self) -> Scalar:
        return jnp.ones(())

    def rate(self, contact: Contact) -> Scalar:
        return -(self.k + 0.1) * contact.state

    def size(self, contact: Contact) -> Scalar:
        return jnp.ones(())


class Unfinished(AbstractElasticEffect):
    id: ClassVar[str] = "unfinished"
    law: ClassVar[str] = "none"
    reference: ClassVar[str] = "none"


@pytest.mark.slow
@pytest.mark.parametrize("effect", [*IMPACT, EndStop], ids=lambda effect: effect.id)
def test_contract_is_kept(effect):
    report = check_effect(effect)
    assert report.require() is report, report
    assert len(report.checks) >= 9 and "keeps its contract" in str(report)


@pytest.mark.slow
@pytest.mark.parametrize("effect, clause", [
    (Present, "absent at its null"),
    (Drifting, "absent at its null"),
    (Dead, "k alive"),
    (Steep, "k alive"),
    (NotANumber, "finite at its starts"),
    (Branching, "compiled = eager"),
    (Unheard, "compiled = eager"),
    (Numpy, "k alive"),
    (BadUnit, "units"),
    (NoUnit, "units"),
    (Unnamed, "complete"),
    (Useless, "shape alive"),
    (TwoStages, "complete"),
    (Unfinished, "complete"),
    (int, "complete"),
], ids=lambda value: getattr(value, "__name__", None))
def test_broken_effects_are_caught(effect, clause):
    report = check_effect(effect)
    assert not report.ok
    assert clause in {check.name for check in report.failures}, report
    with pytest.raises(InputError, match="breaks its contract"):
        report.require()


@pytest.mark.slow
def test_other_models_and_records():
    """Another reference model and other conditions can be given; what does not fit is said."""
    conditions = {"initial_pressure": [1e6, 2e6], "approach_speed": [0.3, 0.6]}
    report = check_effect(WallStiffness, PowerLaw(exponent=2.0), conditions)
    assert report.ok, report
    (gas,) = [effect for effect in IMPACT if effect.id == "membrane-area"]
    report = check_effect(gas, PowerLaw(), conditions)
    assert "requires 'geometry', which PowerLaw" in report.failures[0].sentence
