"""Models, effects and results as values: what goes into a verb comes out of another."""

import dataclasses as dc

import numpy as np
import pandas as pd
import pytest

import ddetumble as dd
from ddetumble._display import AbstractPrinted
from ddetumble.contact.effect import is_absent, list_choices, parameters_of, read_field
from ddetumble.families import FAMILIES
from ddetumble.inference.archive import Uncertainty
from ddetumble.inference.models import wrap_model
from tests.test_compare import WALL, make


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    """Twelve impacts with a stiff wall."""
    return make(tmp_path_factory.mktemp("campaign"), 2, WALL)


def test_models_are_extended_by_addition():
    """Classes and instances, in their order; the model itself is not changed."""
    model = dd.Ball()
    law = model + dd.effects.Adhesion + dd.effects.WallStiffness(k_w=900.0)
    assert [one.id for one in law.effects] == ["adhesion", "wall-stiffness"] and law.reference is model
    assert [is_absent(one) for one in law.effects] == [True, False]
    assert [one.id for one in (dd.RigidBody() + dd.effects.EddyCurrent()).effects] == ["eddy-current"]
    with pytest.raises(TypeError, match="adhesion"):
        law + dd.effects.Adhesion()
    with pytest.raises(TypeError, match="extended by effects"):
        model + 1.0  # pyright: ignore[reportOperatorIssue]


@pytest.mark.parametrize(("family", "name"), [(one.name, name) for one in FAMILIES.values() for name in one.models])
def test_a_model_in_hand_has_a_name_that_finds_it_again(family, name):
    """The built-in model, or one that is the same under another name."""
    model = FAMILIES[family].models[name].make()
    found = dd.inference.resolve_model(wrap_model(model).name, family).reference
    assert type(found) is type(model) and list_choices(found) == list_choices(model)
    for p in parameters_of(model):
        assert float(read_field(found, p.field)) == float(read_field(model, p.field))


@pytest.mark.parametrize("model", [
    dd.Ball(truncated=True, doubled_core=True), dd.PowerLaw(condition="initial_pressure", condition_reference=1e6),
    dd.contact.Striker(dd.PowerLaw(), dd.RubberFriction()), dd.Ball(outer_diameter=0.1)])
def test_other_choices_go_by_the_class(model):
    """No built-in name stands for a model that is another."""
    wrapped = wrap_model(model)
    assert wrapped.name not in FAMILIES[type(model).family].models
    assert type(dd.inference.resolve_model(wrapped.name, type(model).family).reference) is type(model)


def test_what_is_no_model_is_refused(campaign):
    for wrong in (3, ["paper"], dd.effects.Adhesion, None):
        with pytest.raises(dd.InputError, match="not a model"):
            dd.fit(campaign, wrong)  # pyright: ignore[reportArgumentType]
    with pytest.raises(dd.InputError, match="fitted model"):
        dd.predict(dd.Ball(), pd.DataFrame())  # pyright: ignore[reportArgumentType]
    with pytest.raises(dd.InputError, match="family"):
        dd.fit(campaign, dd.CoulombFriction())
    with pytest.raises(dd.InputError, match="stribeck"):
        dd.fit(campaign, dd.Ball() + dd.effects.Stribeck())


@pytest.mark.slow
def test_a_fit_goes_on_by_itself(campaign, tmp_path):
    """A fit in hand and the folder that it was saved to give the same predictions, designs, fits and draws."""
    model = dd.Ball() + dd.effects.WallStiffness()
    found = dd.fit(campaign, model)
    assert found.parameters == dd.fit(campaign, "paper", ["wall-stiffness"]).parameters
    found.save(tmp_path / "fit")
    held, read = found.fitted_model(), dd.load(tmp_path / "fit")
    for field in dc.fields(held):
        a, b = getattr(held, field.name), getattr(read, field.name)
        if field.name == "covariance" or field.name == "u":
            assert np.array_equal(a, b)
        elif field.name not in ("folder", "space", "extra"):
            assert a == b, field.name
    assert all(isinstance(one, Uncertainty) for one in held.uncertainties.values())
    wanted = pd.DataFrame({"record": ["a"], "initial_pressure": [1e6], "approach_speed": [0.4]})
    pd.testing.assert_frame_equal(dd.predict(found, wanted), dd.predict(tmp_path / "fit", wanted))
    pd.testing.assert_frame_equal(dd.predict_pulses(found, wanted), dd.predict_pulses(tmp_path / "fit", wanted))
    assert dd.design(found).sentence == dd.design(tmp_path / "fit").sentence
    again = dd.fit(campaign, found)
    for name, one in found.parameters.items():
        assert abs(again.parameters[name].estimate - one.estimate) < 1e-3 * one.sd


@pytest.mark.slow
def test_loop_by_hand_and_by_discover(campaign):
    """The steps of `discover` are fits; by hand the same models have the same errors, and the effect that is missing
    has the smallest cross-validated one."""
    found = dd.discover(campaign)
    assert found.effects == ("wall-stiffness",) and len(found.fits) == 2 and found.best is found.fits[-1]
    for step, one in zip(found.steps, found.fits, strict=True):
        assert one.effects == step.effects and list(one.parameters) == list(step.parameters)
        for name, estimate in step.parameters.items():
            own = one.parameters[name]
            assert (own.estimate, own.sd, own.q025, own.q975) == (
                estimate.estimate, estimate.sd, estimate.q025, estimate.q975)
    model = dd.Ball()
    by_hand = dd.compare(campaign, model, model + dd.effects.SensorGain(), model + dd.effects.WallStiffness())
    assert by_hand.best == 2 and 0 not in by_hand.alike
    assert [one.lack_of_fit.rejected for one in by_hand] == [True, True, False]
    for step, one in zip(found.steps, (by_hand[0], by_hand[2]), strict=True):
        assert one.nrmse == pytest.approx(step.nrmse, rel=5e-3)
        assert one.heldout_nrmse == pytest.approx(step.heldout_nrmse, rel=5e-3)
        assert one.prediction_nrmse == pytest.approx(step.prediction_nrmse, rel=2e-2)
        assert one.heldout_nrmse == pytest.approx(np.sqrt(one.heldout_squares.sum()), rel=1e-12)
    idle = next(one for one in found.candidates if not one.estimates)  # what does nothing has the reference's numbers
    assert (idle.heldout_nrmse, idle.prediction_nrmse, idle.prediction_coverage) == (
        found.steps[0].heldout_nrmse, found.steps[0].prediction_nrmse, found.steps[0].prediction_coverage)
    assert found.steps[1].prediction_coverage > 0.9 > found.steps[0].prediction_coverage
    alone = dd.compare(campaign, found)
    assert alone.effects == found.effects
    assert alone.heldout_nrmse == pytest.approx(found.steps[1].heldout_nrmse, rel=5e-3)


@pytest.mark.slow
def test_a_model_of_another_campaign_is_held_out_as_a_whole(campaign, tmp_path):
    """None of the records chose it: its error is the cross-validated one."""
    other = make(tmp_path, 5, WALL)
    one = dd.compare(other, dd.fit(campaign, dd.Ball() + dd.effects.WallStiffness))
    assert one.heldout_nrmse == pytest.approx(one.nrmse, rel=1e-12) and not np.isfinite(one.prediction_nrmse)


def test_what_a_verb_returns_prints_in_words():
    """A command prints `str` of a result: every annotated result of a public verb has a text of its own."""
    verbs = (dd.fit, dd.discover, dd.identify, dd.sample, dd.average, dd.design, dd.map_effects, dd.plan,
             dd.draw_missing_force)
    kinds = {verb.__name__: verb.__annotations__["return"] for verb in verbs} | {
        "compare": dd.Comparison, "compare several": dd.Comparisons}
    silent = [name for name, kind in kinds.items() if not issubclass(kind, AbstractPrinted) or "__str__" not in {
        part for cls in kind.__mro__[:-1] if cls is not AbstractPrinted for part in vars(cls)}]
    assert not silent
    html = dd.compare(dd.find_data() / "slip-a")._repr_html_()
    assert html.startswith("<div>") and "<strong>" in html


def test_a_text_of_a_file_is_escaped_in_a_notebook():
    """What stands in a result may come from somebody's file."""
    class Told(AbstractPrinted):
        def __str__(self):
            return "<script>alert(1)</script>\n\n<b>x</b>"

    assert "<script>" not in Told()._repr_html_()


@pytest.mark.parametrize(("text", "expected"), [
    ("Found.\n- one\n- two\n\n  a  1", ["<strong>Found.</strong>", "<li>one</li>", "<li>two</li>", ">  a  1</pre>"]),
    ("[[Model]]\n    a\n    b", ["[[Model]]\n    a\n    b</pre>"]),
    ("Found in\ntwo lines.\n\nx", ["<strong>Found in two lines.</strong>", ">x</pre>"])])
def test_lines_of_a_result_stay_lines_in_a_notebook(text, expected):
    class Told(AbstractPrinted):
        def __str__(self):
            return text

    shown = Told()._repr_html_()
    assert all(part in shown for part in expected) and shown.count("<strong>") == ("[[" not in text)
