"""What physics allows of every parameter: stated with a reason, shown, checked, and kept by what the exam hides."""

from typing import ClassVar, final

import numpy as np
import pytest

import ddetumble as dd
from ddetumble.cli import main
from ddetumble.contact.effect import AbstractElasticEffect, Contact, Parameter, Scalar, parameter, parameters_of
from ddetumble.effects import CATALOGUE
from ddetumble.exam.cases import GENERATORS
from ddetumble.families import FAMILIES


EFFECTS = {effect.id: effect for effect in CATALOGUE}
MODELS = {f"{family} {name}": model for family, one in FAMILIES.items() for name, model in one.models.items()}
ROOM = 1.02  # of a limit beyond what is drawn, in distance from the null


@pytest.mark.parametrize("name", [*EFFECTS, *MODELS])
def test_every_parameter_states_what_physics_allows(name):
    found = parameters_of(EFFECTS[name] if name in EFFECTS else MODELS[name].make())
    for one in found:
        low, high = one.limits
        assert low < high and (np.isfinite(low) or np.isfinite(high)) and one.limits_reason
        assert all(low <= one.transform.publish(value) <= high for value in (one.default, *one.starts))
        assert not one.excludes(low, high) and one.excludes(low - 2.0, low - 1.0)


@pytest.mark.parametrize("family", GENERATORS)
def test_what_the_exam_hides_is_physical(family):
    """The largest amplitude that may be drawn, every shape, and the models lie within the limits, with room."""
    cases = GENERATORS[family]
    for effect, hidden in cases.catalogue.items():
        declared = {one.name: one for one in parameters_of(EFFECTS[effect])}
        for name, step in {**hidden.departure, **hidden.vectors}.items():
            one = declared[name if name in declared else f"{name}.0"]
            far = one.default + ROOM * hidden.most * step
            assert one.limits[0] <= far <= one.limits[1], (effect, name, far)
        for name, value in hidden.inverse.items():
            assert not declared[name].excludes(0.0, value / hidden.most / ROOM), (effect, name)
            assert value / hidden.most / ROOM >= declared[name].limits[0]
        for name, (low, high) in hidden.shapes.items():
            assert declared[name].limits[0] <= low / ROOM < high * ROOM <= declared[name].limits[1], (effect, name)
    own = {one.name: one for one in parameters_of(FAMILIES[family].models["paper"].make())}
    generator = np.random.default_rng(1)
    for _ in range(50):
        for name, value in cases.draw_setting(generator)["base"].items():
            assert own[name].limits[0] <= value <= own[name].limits[1]


def test_known_absurdities_are_beyond():
    """A gas of exponent 2.8, and a ball that grows by three quarters (2.71 P0/E at 2.2 MPa)."""
    declared = {f"{e.id}.{one.name}": one for e in dd.effects.catalogue("impact") for one in parameters_of(e)}
    assert declared["polytropic-gas.n"].excludes(2.7, 2.9) and not declared["polytropic-gas.n"].excludes(1.3, 2.9)
    assert declared["inflation-growth.beta"].excludes(2.6, 2.8)
    assert not Parameter("k", "k", "", 0.0).excludes(-1e300, 1e300)


@pytest.mark.parametrize("effect", EFFECTS)
def test_effects_shows_them(effect, capsys):
    assert main(["effects", effect]) == 0
    shown = capsys.readouterr().out
    for one in parameters_of(EFFECTS[effect]):
        assert one.limits_reason in shown


@final
class Spring(AbstractElasticEffect):
    """A spring whose limits each test states anew."""

    k: Scalar = parameter("N/m", typical=1000.0, sign=1, starts=(1000.0,))
    id: ClassVar[str] = "spring"
    law: ClassVar[str] = "F_k gains k delta"
    reference: ClassVar[str] = "this test"

    def force(self, contact: Contact) -> Scalar:
        return self.k * contact.depression


@pytest.mark.slow
@pytest.mark.parametrize(("limits", "reason", "holds"), [
    ((0.0, 5e3), "a wall resists", True), (None, "", True), ((0.0, 5e3), "", False), ((5e3, 0.0), "upside down", False),
    ((1.0, 5e3), "without its null", False), ((0.0, 500.0), "without its start", False),
])  # fmt: skip
def test_contract_checks_them(limits, reason, holds):
    """They are a range with a reason, around the null and the starts."""
    space = {"k": parameter("N/m", typical=1000.0, sign=1, starts=(1000.0,), limits=limits, limits_reason=reason),
             "__annotations__": {"k": Scalar}, "__module__": __name__, "__qualname__": "Limited"}
    report = dd.check_effect(type(AbstractElasticEffect)("Limited", (AbstractElasticEffect,), {
        **space, "id": "limited", "law": Spring.law, "reference": Spring.reference, "force": Spring.force}))
    found = {check.name: check.ok for check in report.checks}
    assert found["limits"] == holds and report.ok == holds


@pytest.mark.slow
def test_fit_says_what_is_beyond_and_in_which_unit():
    """Growth of the ball would have to stand in for what impact-c has; a stiffness has the unit of its power."""
    campaign = dd.read_campaign(dd.find_data() / "impact-c")
    grown = dd.fit(campaign, effects=["inflation-growth"], noise="stated").parameters["inflation-growth.beta"]
    assert grown.q025 > 1.6 and "1.6" in grown.text
    wall = dd.fit(campaign, effects=["wall-stiffness"], free=["wall-stiffness.q"], noise="stated").parameters
    assert wall["wall-stiffness.k_w"].unit == f"N/m^{wall['wall-stiffness.q'].estimate:.3g}"
    plain = dd.fit(campaign, effects=["wall-stiffness"], noise="stated").parameters
    assert plain["wall-stiffness.k_w"].unit == "N/m" and plain["effective_mass"].text == ""
