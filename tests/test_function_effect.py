"""A plain function as an effect: the class that it becomes, where it can act, and fits with it."""

from typing import ClassVar, final

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ddetumble import Ball, check_effect, compare, discover, effect, find_data, fit, read_campaign
from ddetumble._numerics import positive_part
from ddetumble.contact.effect import AbstractElasticEffect, Contact, Scalar, family_of, parameters_of, stage_of
from ddetumble.contact.function_effect import STAGES
from ddetumble.dynamics import simulate_impact
from ddetumble.effects import CATALOGUE, parameter
from ddetumble.inference.archive import resolve_model
from ddetumble.inference.models import list_effects, resolve_effect


SOURCE = '''
from ddetumble import effect
from ddetumble.effects import parameter
from ddetumble._numerics import positive_part


@effect("elastic", reference="a test", k=parameter("N/m", typical=2000.0, sign=1, starts=(5000.0,)),
        depth=parameter("m", 4e-3, kind="shape", typical=2e-3, free=False))
def end_stop(contact, k, depth):
    """F_k gains k (delta - depth)_+."""
    return k * positive_part(contact.depression - depth)
'''


@effect("elastic", reference="a test", k=parameter("N/m", typical=2000.0, sign=1, starts=(5000.0,)),
        depth=parameter("m", 4e-3, kind="shape", typical=2e-3, free=False))
def end_stop(contact, k, depth):
    """F_k gains k (delta - depth)_+."""
    return k * positive_part(contact.depression - depth)


@final
class EndStop(AbstractElasticEffect):
    """The same by hand."""

    k: Scalar = parameter("N/m", typical=2000.0, sign=1, starts=(5000.0,))
    depth: Scalar = parameter("m", 4e-3, kind="shape", typical=2e-3, free=False)
    id: ClassVar[str] = "end-stop"
    law: ClassVar[str] = "F_k gains k (delta - depth)_+"
    reference: ClassVar[str] = "a test"

    def force(self, contact: Contact) -> Scalar:
        """k (delta - depth)_+ [N]."""
        return self.k * positive_part(contact.depression - self.depth)


def test_a_function_is_the_class_that_one_would_write():
    """Names, parameters, and the impact that it makes."""
    for name in ("id", "law", "reference", "requires"):
        assert getattr(end_stop, name) == getattr(EndStop, name)
    assert parameters_of(end_stop) == parameters_of(EndStop) and stage_of(end_stop) == "elastic"
    conditions = {"initial_pressure": 1.2e6, "approach_speed": 0.5}
    times = jnp.linspace(0.0, 0.04, 50)
    force = [simulate_impact(Ball().extend((kind(k=8e3, depth=3e-3),)), conditions, times).normal_force
             for kind in (end_stop, EndStop)]
    np.testing.assert_array_equal(*force)


@pytest.mark.slow
def test_it_keeps_the_contract():
    """As any effect."""
    check_effect(end_stop).require()


def test_every_stage_of_the_catalogue():
    """There is a stage for every catalogued effect, derived from the same class."""
    for one in CATALOGUE:
        assert issubclass(one, STAGES[stage_of(one)]) and family_of(STAGES[stage_of(one)]) == one.family


@pytest.mark.parametrize("stage", STAGES)
def test_a_function_at_every_stage(stage):
    """It acts in the method of its stage, with all that this is given."""
    (method,) = STAGES[stage].__abstractmethods__
    state = {"inertia": (), "gyroscope": (1.0, 2.0), "axes": (1.0, 2.0)}.get(stage, (1.0,))
    laws = {0: lambda k: k, 1: lambda x, k: k * x, 2: lambda x, t, k: k * x * t}
    kind = effect(stage, id="five", law="five times", k=parameter("m", 5.0))(laws[len(state)])
    assert float(getattr(kind(), method)(*state)) == 5.0 * float(np.prod(state))
    assert float(getattr(kind(k=7.0), method)(*state)) == 7.0 * float(np.prod(state))


@pytest.mark.parametrize(("law", "parameters"), [
    (lambda contact: 1.0, {}), (lambda contact, k: k, {}), (lambda contact, k: k, {"k": 1.0}),
    (lambda contact, slide, k: k, {"k": parameter("N")}), (lambda k: k, {"k": parameter("N")}),
    (lambda contact, q: q, {"k": parameter("N")}),
])  # fmt: skip
def test_other_functions_are_refused(law, parameters):
    """No parameter, a plain number for one, another state, another name."""
    with pytest.raises(TypeError):
        effect("elastic", **parameters)(law)


def test_what_is_no_effect_is_refused():
    """A bare function by the model, fit and discover, which say what makes it one; or an instance."""
    def bare(contact, k=1.0):
        return k

    with pytest.raises(TypeError, match="@dd.effect"):
        Ball() + bare
    for verb in (fit, discover):
        for one in (bare, end_stop()):
            with pytest.raises(TypeError, match="@dd.effect|takes classes"):
                verb("impact-f", effects=[one])
    with pytest.raises(TypeError, match="`k=dd.effects.parameter"):
        effect("elastic", stiffness=parameter("N"))(bare)


def test_models_print_their_values():
    """As they are made and added; choices only where they are unusual."""
    assert repr(Ball(restitution=0.7, truncated=True) + end_stop(k=8e3)) == (
        "Ball(effective_mass=1.2, restitution=0.7, outer_diameter=0.06, contact_radius_coefficient=0.7853982, "
        "truncated=True) + end_stop(k=8000, depth=0.004)")
    shown = []
    jax.jit(lambda law: shown.append(repr(law)) or law.k)(end_stop())
    assert shown[0].startswith("end_stop(k=")


def test_an_unknown_stage_is_refused():
    """Before there is a function."""
    with pytest.raises(ValueError, match="elastics"):
        effect("elastics")


@pytest.mark.slow
def test_fit_save_and_compare(tmp_path):
    """A fit finds what it finds with the class; the saved model knows the file, and is compared like any other."""
    path = tmp_path / "own.py"
    path.write_text(SOURCE, encoding="utf-8")
    assert [one.id for one in list_effects(path)] == ["end-stop"]
    campaign = read_campaign(find_data() / "impact-f")
    found, expected = (fit(campaign, effects=[kind], noise="stated")
                       for kind in (resolve_effect(f"{path}:end_stop"), EndStop))
    for name, one in expected.parameters.items():
        assert found.parameters[name].estimate == pytest.approx(one.estimate, rel=1e-9)
    found.save(tmp_path / "fit")
    (loaded,) = resolve_model(str(tmp_path / "fit")).effects
    assert float(loaded.k) == pytest.approx(found.parameters["end-stop.k"].estimate, rel=1e-9)
    compared = compare(campaign, str(tmp_path / "fit"))
    assert compared.chi2_reduced < compare(campaign).chi2_reduced
