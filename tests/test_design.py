"""The next test and the map: closed forms, gradients, what cannot be separated, sizes that are found, bad input."""

import dataclasses as dc
import json
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import ddetumble as dd
from ddetumble import InputError
from ddetumble._sentences import say
from ddetumble.cli import main
from ddetumble.contact.sliding import RubberFriction
from ddetumble.effects.slip import AdhesiveOffset, ViscousFriction
from ddetumble.exam.simulators.campaigns import write_package
from ddetumble.exam.simulators.impact_campaigns import make_campaign
from ddetumble.exam.simulators.slip_campaigns import make_slip_campaign
from ddetumble.figures import draw_map, draw_next_test
from ddetumble.inference.archive import load, make_fitted, save_model
from ddetumble.inference.parameters import ParameterSpace
from ddetumble.inference.problem import Problem, observe_record
from ddetumble.inference.stack import default_noise, stack_records
from ddetumble.measurement.package import read_campaign
from ddetumble.planning.detectability import map_effects
from ddetumble.planning.distinguishability import (
    compute_columns,
    contrast,
    count_repeats,
    gain_information,
    part_rivals,
    preview_test,
    separate,
    thinning_factor,
    value_separation,
)
from ddetumble.planning.next_test import Narrowing, Pair, design, group_pairs
from ddetumble.planning.setting_ranges import list_extras, set_limits
from ddetumble.selection.explanations import fit_bias
from ddetumble.selection.predict import SQUEEZED, find_squeezes
from ddetumble.selection.problem import fit_reference, pose_selection
from ddetumble.selection.settings import DEFAULT


BASE = {"adhesion_constant": 0.9, "loss_factor": 0.16, "tensile_strength": 10e6, "real_contact_pressure": 20e6,
        "slip_scale": 1.0}  # fmt: skip
LOADS, PRESSURES, SPEED = [10.0, 20.0], [1.0e6, 2.0e6], 0.1


def test_separation_closed_form():
    """The formula is the least squares that it stands for: stacked repeats, moves with a prior, own nuisances."""
    generator = np.random.default_rng(1)
    difference, shared, own = generator.normal(size=30), generator.normal(size=(30, 3)), generator.normal(size=(30, 2))
    for repeats in (1, 4):
        rows = [np.kron(np.ones((repeats, 1)), shared)]
        rows.append(np.kron(np.eye(repeats), own))
        whole = np.concatenate([np.concatenate(rows, axis=1), np.eye(3 + 2 * repeats)])
        right = np.concatenate([np.tile(difference, repeats), np.zeros(3 + 2 * repeats)])
        left = right - whole @ np.linalg.lstsq(whole, right, rcond=None)[0]
        found = separate(contrast(jnp.asarray(difference), jnp.asarray(shared), jnp.asarray(own)), repeats)
        np.testing.assert_allclose(found, left @ left, rtol=1e-10)


def test_repeats_from_a_known_separation():
    """Nothing to refit: n tests leave n times one; what the refit can follow ends at what the prior costs."""
    none = jnp.zeros((4, 1)), jnp.zeros((4, 1))
    difference = jnp.array([1.0, 2.0, 2.0, 0.0])  # 9 noise variances
    assert count_repeats(contrast(difference, *none), 50.0, 30) == 6
    assert count_repeats(contrast(difference, *none), 9.0, 30) == 1
    assert count_repeats(contrast(difference, *none), 271.0, 30) is None
    followed = contrast(difference, 10.0 * difference[:, None], none[1])
    np.testing.assert_allclose(separate(followed, 1e9), 0.1**2, rtol=1e-4)
    assert count_repeats(followed, 1.0, 10**6) is None


def test_lines_are_parted_at_the_end_of_the_range():
    """A line through the origin against one with an offset, both known near x = 1: farthest apart at the far end."""
    before = 1.0 / 0.1  # both slopes known to 0.1
    x = np.linspace(0.2, 5.0, 49)
    values = [float(separate(contrast(jnp.array([1.0 - t]), jnp.array([[t / before]]), jnp.zeros((1, 1))))) for t in x]
    np.testing.assert_allclose(values, (1.0 - x) ** 2 / (1.0 + (0.1 * x) ** 2), rtol=1e-10)
    assert int(np.argmax(values)) == len(x) - 1


def test_information_closed_form():
    """Half the logarithm of 1 + a² for one parameter; a nuisance of unit prior takes its share."""
    np.testing.assert_allclose(gain_information(jnp.array([[3.0]]), jnp.zeros((1, 1))), 0.5 * np.log(10.0))
    np.testing.assert_allclose(gain_information(jnp.array([[3.0]]), jnp.array([[1.0]])), 0.5 * np.log(5.5))


def test_thinning_keeps_the_spectrum():
    """White noise: every k-th sample holds a k-th of the information; slow noise: thinning loses nothing."""
    from ddetumble.inference.noise import Noise

    assert thinning_factor(Noise(1.0, 0.5, 1.0, 1.0, None, 0.0, ""), 4.0) == pytest.approx(4.0)
    assert thinning_factor(Noise(1.0, 0.999, 0.0, 1.0, None, 0.0, ""), 4.0) == pytest.approx(1.0, abs=1e-4)


@pytest.fixture(scope="module")
def rivals(tmp_path_factory):
    """A folder as `discover` leaves it: tests at one speed, where viscous friction is an offset and vice versa."""
    folder = tmp_path_factory.mktemp("design")
    made = make_slip_campaign("one-speed", 5, {"viscous-friction": {"c_t": 4.0}}, BASE, LOADS, PRESSURES, [SPEED], 1,
                              interval=2e-4)
    write_package(folder / "campaign", made)
    campaign = read_campaign(folder / "campaign")
    noise = {"tangential_force": default_noise(campaign, "tangential_force", np.arange(9) * 2e-4)}
    space = ParameterSpace(RubberFriction(), (ViscousFriction, AdhesiveOffset))
    problem = Problem(space, stack_records(campaign))
    for effect, place in ((ViscousFriction, folder), (AdhesiveOffset, folder / "rivals" / "1")):
        solution = problem.solve(space.of([None, effect.id]), space.coordinates(
            {k: BASE[k] for k in ("adhesion_constant", "loss_factor")}), tolerance=1e-6)
        assert not solution.failed
        save_model(place, make_fitted(
            campaign=campaign, model_name="paper", space=space, solution=solution, noise=noise, effects=[effect.id]))
    (folder / "result.json").write_text(json.dumps({
        "verdict": "explained", "steps": [{"alternatives": []}, {"alternatives": ["adhesive-offset"]}]}))
    return folder


@pytest.fixture(scope="module")
def posed(rivals):
    models = [load(rivals), load(rivals / "rivals" / "1")]
    limits = set_limits(models[0])
    return preview_test(models, limits, list_extras(models[0]))


def test_limits_in_numbers(rivals):
    """By condition a value, or the lower and the upper one, in SI; as in the text with its unit."""
    saved = load(rivals)
    texts = set_limits(saved, ["load=5..20 N", "slip_speed=100 mm/s"])
    assert set_limits(saved, {"normal_load": (5, 20.0), "slip_speed": 0.1}) == texts
    assert set_limits(saved, {"normal_load": ("5 N", "0.02 kN"), "slip_speed": 0.1}) == texts
    with pytest.raises(InputError, match="lower value first"):
        set_limits(saved, {"normal_load": (20.0, 5.0)})
    for wrong in ((5.0,), (5.0, 20.0, 30.0), (None, 5.0), {"low": 5.0}, ("5 m", "20 m"), ("5", "20")):
        with pytest.raises(InputError):
            set_limits(saved, {"normal_load": wrong})
    with pytest.raises(InputError, match="twice"):
        design([rivals, rivals])
    with pytest.raises(InputError, match="decimal point"):
        set_limits(saved, ["load=0,5..20 N"])
    with pytest.raises(InputError, match="is not a fitted model"):
        design(dd.read_campaign("slip-a"))
    for right in ("0.1..0.3 m/s", "0.1 .. 0.3m/s", "1e-1..300e-3 m/s"):
        (found,) = [one for one in set_limits(saved, {"slip_speed": right}) if one.name == "slip_speed"]
        assert (found.low, found.high) == (0.1, 0.3)
    for right in ("2e-1 m/s", "2E-1m/s", "0.2 m*s-1", "2000e-4 m.s-1"):  # the sign of a power parts no range
        (found,) = [one for one in set_limits(saved, {"slip_speed": right}) if one.name == "slip_speed"]
        assert found.low == found.high == pytest.approx(0.2)


@pytest.mark.slow
def test_gradient(posed):
    """The gradient of the separation by the envelope theorem is that of differences of refitted distances."""
    test = posed
    mask, x = np.ones(1), np.array([[0.4, 0.3, 0.7], [0.8, 0.6, 0.2]])
    value, slope = value_separation(part_rivals(test, x, mask, 30))
    assert value.min() > 0
    for k in range(3):
        step = 1e-4 * np.eye(3)[k]
        ahead, behind = (value_separation(part_rivals(test, x + s * step, mask, 30))[0] for s in (1, -1))
        np.testing.assert_allclose(slope[:, k], (ahead - behind) / 2e-4, rtol=2e-3, atol=2e-4)


def test_derivatives_forward_and_reverse(posed):
    """Derivatives of the readings by the conditions: forward as in the program, reverse, and differences agree."""
    test = posed
    x = np.array([0.4, 0.3, 0.7])
    forward = compute_columns(test, np.array([0]), x[None]).chosen[0]
    moves, own = jnp.zeros(test.directions.shape[1]), jnp.zeros(len(test.nuisances))

    def total(c):
        model, _ = observe_record(test.space, test.nuisances, test.channels, moves, own,
                                  test.fill_stack(c), test.base[0], test.directions[0], *test.bounds)
        return jnp.sum(model * test.weights)

    reverse = jax.jit(jax.grad(total))(jnp.asarray(x))
    np.testing.assert_allclose(np.sum(forward, axis=0), reverse, rtol=1e-8, atol=1e-6)
    compiled = jax.jit(total)
    differences = [(float(compiled(jnp.asarray(x + s))) - float(compiled(jnp.asarray(x - s)))) / 2e-5
                   for s in 1e-5 * np.eye(3)]
    np.testing.assert_allclose(reverse, differences, rtol=1e-5, atol=1e-3)


def test_another_speed_is_proposed(rivals, tmp_path, capsys):
    """What depends on speed is parted from what does not by a test at another speed, at the end of the range."""
    assert main(["design", str(rivals), "-o", str(tmp_path / "next")]) == 0
    assert "To distinguish viscous-friction and adhesive-offset" in capsys.readouterr().out
    written = json.loads((tmp_path / "next" / "design.json").read_text())
    best = written["proposals"][0]
    assert best["conditions"]["slip_speed"] == pytest.approx(2 * SPEED, rel=1e-2) and best["repeats"] == 1
    # What lies outside what was measured is told beside the test, in the first sentence.
    assert best["measured"]["slip_speed"] == [SPEED, SPEED] and set(best["measured"]) <= set(best["conditions"])
    assert "outside the measured" in written["sentence"].split(": ")[0]
    assert written["rivals"] == ["viscous-friction", "adhesive-offset"]
    assert (tmp_path / "next" / "design.png").stat().st_size > 10_000
    # The two are the same force at the old speed: at twice that they differ by the whole offset, 0.4 N over 0.04 N a
    # sample, less what slip_scale and the others may take over.
    assert 7.0 < best["pairs"][0]["distance"] < 10.0 * np.sqrt(61)


def test_pairs_are_grouped_by_the_rival_that_is_in_most():
    """Each pair once, under the rival that is in most of them; the group that needs the fewest tests comes first."""
    def pair(first, second, repeats):
        return Pair(first, second, 1.0, repeats)

    separate = [pair("a", "b", 30), pair("c", "d", 3), pair("a", "d", 2), pair("d", "b", 1)]
    assert group_pairs(separate) == [("d", ("c", "a", "b"), 3), ("a", ("b",), 30)]
    assert group_pairs([pair("a", "b", None), pair("c", "b", None)]) == [("b", ("a", "c"), 0)]
    assert group_pairs([]) == []
    proposal = SimpleNamespace(pairs=separate, split=4, repeats=30)
    told = say("plan.next_test", rivals=["a", "b", "c", "d"], verdict="explained", best=proposal, test="at X",
               more={}, most=30, decisive=50.0, little=0.1, reason="", records=[], lacking=False, sensors=[],
               calibrations=[], distinguished=group_pairs(separate), left=group_pairs([pair("a", "c", None)]))
    assert "4 of the 4" in told and "d from all others" in told and "3 such tests" in told and "a from c" in told


@pytest.mark.slow
def test_a_rival_that_does_not_fit_its_own_campaign_is_told(rivals):
    """The campaign parts them already: one leaves more than noise of it, by whoever fitted it."""
    one, other = load(rivals), load(rivals / "rivals" / "1")
    for misfit, told in ((None, 0), (1.63, 1)):
        poor = dc.replace(other, extra={**other.extra, "misfit": misfit})
        notes = design([one, poor], limits={"speed": "0.1 m/s"}).notes
        assert sum(note.startswith("adhesive-offset") and "1.63" in note for note in notes) == told


@pytest.mark.slow
def test_nothing_separates_is_said(rivals):
    """At the old speed no load or pressure parts them, and the design says so."""
    found = design(rivals, limits={"speed": "0.1 m/s"})
    assert found.sentence.startswith("No test within these limits distinguishes viscous-friction and adhesive-offset")
    assert found.proposals[0].repeats is None and found.proposals[0].pairs[0].distance < np.sqrt(DEFAULT.decisive)
    assert draw_next_test(found).axes


@pytest.mark.slow
def test_without_rivals_the_parameters_are_narrowed(rivals):
    """One model: nothing to separate; every parameter is known no worse after the test."""
    found = design(rivals / "rivals" / "1")
    assert found.rivals == ("adhesive-offset",)
    assert all(n.after <= n.before * (1 + 1e-9) for n in found.proposals[0].narrowings)
    assert found.proposals[0].narrowings[0].after < 0.8 * found.proposals[0].narrowings[0].before
    # What scatters from record to record does so in the next one, too, which narrows it by no larger share.
    saved = dd.load(rivals / "rivals" / "1")
    wide = dc.replace(saved, covariance=25.0 * saved.covariance,
                      widened={name: 5.0 * saved.widened.get(name, 1.0) for name in saved.free})
    again = design(wide).proposals[0].narrowings
    assert again == tuple(dc.replace(one, before=pytest.approx(5.0 * one.before), after=pytest.approx(5.0 * one.after))
                          for one in found.proposals[0].narrowings)


@pytest.mark.slow
def test_effects_that_too_few_conditions_leave_open(tmp_path):
    """Two impacts, of which no condition can be left out: every effect that would explain most of the misfit by itself
    is a rival, and the design tells these apart."""
    made = make_campaign("two", 7, {"membrane-area": {"alpha": 0.4}}, {"effective_mass": 1.2, "restitution": 0.74},
                         [1.0e6, 2.0e6], [0.25], 1, interval=2.5e-4, noise={"normal_force": 0.1})
    write_package(tmp_path / "campaign", made)
    found = dd.discover(tmp_path / "campaign")
    assert (found.verdict, found.reason) == ("undecided", "conditions")
    most = found.settings.largest_part
    sufficient = {one.effect for one in found.candidates if one.explains > most and not one.beyond}
    assert "membrane-area" in sufficient and {one.effects for one in found.explanations} == {(e,) for e in sufficient}
    planned = design(found, channels=())
    assert set(planned.rivals) == sufficient and planned.calibrations == ()
    assert len(planned.proposals[0].pairs) == len(sufficient) * (len(sufficient) - 1) // 2


def fit_rival_settings(campaign, settings):
    """Rubber friction with an error of each of these settings that all records share, as `discover` fits them."""
    selection, fitted = fit_reference(pose_selection(campaign, RubberFriction()))
    return [fit_bias(selection, fitted, name, "paper", "undecided") for name in settings]


@pytest.mark.slow
def test_an_effect_and_an_error_of_a_setting_are_rivals(rivals, tmp_path):
    """Where a verdict leaves open whether an effect is missing or a setting reads wrong alike in all records, these are
    told apart, and the calibration is told that decides: a seventh of the error, 50 noise variances from none."""
    campaign = read_campaign(rivals / "campaign")
    wrong, = fit_rival_settings(campaign, ["normal_load"])
    for place, model in (("", load(rivals)), ("explanations/1", load(rivals)),
                         ("explanations/2", wrong.fitted_model())):
        save_model(tmp_path / place, model)
    content = {"verdict": "undecided", "reason": "setting", "steps": [{"alternatives": []}],
               "explanations": [{"setting": None}, {"setting": "normal_load"}]}
    (tmp_path / "result.json").write_text(json.dumps(content))
    found = design(tmp_path, channels=())
    assert found.rivals[0] == "viscous-friction" and len(found.rivals) == 2 and found.reason == ""
    one, = found.calibrations
    assert one.setting == "normal_load" and one.bias == pytest.approx(-wrong.parameters["normal_load_shift"].estimate)
    assert one.needed == pytest.approx(abs(one.bias) / np.sqrt(DEFAULT.decisive), rel=1e-9)
    assert len(found.proposals[0].pairs) == 1 and found.proposals[0].pairs[0].distance > 0
    # A setting that reads too high pulls at the next test, too: what it predicts there is not what the reference does.
    curves = found.proposals[0].curves
    assert set(curves) == set(found.rivals) and not np.allclose(*curves.values(), rtol=1e-3)
    (tmp_path / "explanations" / "2" / "model.json").unlink()
    with pytest.raises(InputError, match="run discover again"):
        design(tmp_path)


@pytest.mark.parametrize("content, reason", [
    ({"verdict": "undecided", "reason": "rounding"}, "rounding"), ({"verdict": "undecided", "reason": "unit"}, "unit"),
    ({"verdict": "explained"}, "")])
def test_what_is_to_be_settled_first(rivals, tmp_path, content, reason):
    """An undecided verdict between no two models hands its reason on to the design of the next test."""
    save_model(tmp_path, load(rivals))
    (tmp_path / "result.json").write_text(json.dumps({"steps": [{"alternatives": []}], **content}))
    found = design(tmp_path, channels=(), limits={"speed": "0.1 m/s", "load": "10 N", "internal_pressure": "1 MPa"})
    assert found.reason == reason and found.rivals == ("viscous-friction",) and found.calibrations == ()
    assert ("stated wrongly" in found.sentence) == (reason == "unit")


@pytest.mark.study
def test_a_verdict_between_a_gauge_and_an_effect(tmp_path):
    """Four impacts of a ball whose membrane keeps part of its area: the verdict names what it cannot tell apart, every
    setting and every effect, writes a model of each, and the design tells them apart, as does a calibration."""
    made = make_campaign("four", 7, {"membrane-area": {"alpha": 0.4}}, {"effective_mass": 1.2, "restitution": 0.74},
                         [1.0e6, 2.0e6], [0.25, 0.35], 1, interval=2.5e-4)
    write_package(tmp_path / "campaign", made)
    found = dd.discover(tmp_path / "campaign")
    assert (found.verdict, found.reason, found.effects) == ("undecided", "setting", ())
    (first, others), = found.dropped
    effects = [one.effects for one in found.explanations if one.setting is None]
    settings = [one.setting for one in found.explanations if one.setting is not None]
    assert effects == [(one,) for one in (first, *(e for (e,) in effects[1:]))]
    assert {e for (e,) in effects[1:]} == set(others) and settings == [one.name for one in found.biases]
    assert any("membrane-area" in one for one in effects)
    moved = [one for one in found.steps[0].shifts if one.is_alike]  # what a gauge that reads too high does
    assert moved and all(one.mean_share < -0.01 for one in moved)
    alike = {one.effect: set(one.indistinguishable_from) for one in found.candidates}
    assert alike[first] == set(others) and all(first in alike[other] for other in others)
    found.save(tmp_path / "discovery")
    planned = design(tmp_path / "discovery", channels=())
    assert len(planned.rivals) == len(found.explanations) and planned.rivals == design(found, channels=()).rivals
    assert [one.setting for one in planned.calibrations] == settings
    for one, told in zip(planned.calibrations, found.biases, strict=True):
        assert one.bias == pytest.approx(told.bias, rel=0.15)


@pytest.mark.slow
def test_models_to_tell_apart_are_named(rivals, tmp_path, capsys):
    """Two folders, of fits, are the rivals, as are the fits in hand; a limit that is wrong in Python is no option."""
    folders = [rivals, rivals / "rivals" / "1"]
    for k, folder in enumerate(folders):
        save_model(tmp_path / str(k), load(folder))
    assert main(["design", str(tmp_path / "0"), str(tmp_path / "1"), "-o", str(tmp_path / "next")]) == 0
    capsys.readouterr()
    written = json.loads((tmp_path / "next" / "design.json").read_text())
    found = design([load(folder) for folder in folders])
    assert written["rivals"] == list(found.rivals) == ["viscous-friction", "adhesive-offset"]
    assert written["proposals"][0]["conditions"] == pytest.approx(found.proposals[0].conditions)
    assert len(repr(found.proposals[0])) < 2000  # no samples
    with pytest.raises(InputError) as refused:
        design(folders, limits={"normal_load": (20.0, 5.0)})
    assert "--" not in str(refused.value)


@pytest.mark.parametrize("option, says", [
    (["--limit", "slip_speed=2..1 m/s"], "must have the lower value first"),
    (["--limit", "slip_speed=0.1..1"], "needs a unit"),
    (["--limit", "slip_speed=0.1..1 N"], "does not measure"),
    (["--limit", "slip_speed=fast"], "LOW..HIGH UNIT"),
    (["--limit", "slip_speed=0.1-0.3 m/s"], "0.1..0.3 m/s"),
    (["--limit", "slip_speed=0.1 m/s to 0.3 m/s"], "0.1..0.3 m/s"),
    (["--limit", "slip_speed=0.1--0.3 m/s"], "'0.1..0.3 m/s'"),
    (["--limit", "slip_speed=1e-1-3e-1 m/s"], "'1e-1..3e-1 m/s'"),
    (["--limit", "slip_speed=-0.3--0.1 m/s"], "two points"),
    (["--limit", "slip_speed=2e-1 m/ss"], "m/ss"),
    (["--limit", "slip_speed=-1..1 m/s"], "must be positive"),
    (["--limit", "humidity=1..2"], "there is no condition 'humidity'"),
    (["--channel", "pressure: 200 Pa"], "not a channel that could be added"),
    (["--length", "-1 m"], "must be positive"),
    (["--length", "1"], "needs a unit"),
    (["--length", "20 ms"], "slip"),
])
def test_bad_options(rivals, capsys, option, says):
    """One sentence, exit code 2."""
    assert main(["design", str(rivals), *option]) == 2
    said = capsys.readouterr().err
    assert says in said and said.count("\n") == 1


def test_bad_folders(rivals, tmp_path, capsys):
    """No model, a damaged result, rivals that are not there."""
    assert main(["design", str(tmp_path)]) == 2
    assert "no model.json" in capsys.readouterr().err
    (tmp_path / "model.json").write_bytes((rivals / "model.json").read_bytes())
    (tmp_path / "result.json").write_text("{")
    assert main(["design", str(tmp_path)]) == 2
    assert "run discover again" in capsys.readouterr().err
    (tmp_path / "result.json").write_bytes((rivals / "result.json").read_bytes())
    assert main(["design", str(tmp_path)]) == 2
    assert "are not in this folder" in capsys.readouterr().err


PLAN = "normal_load [N],internal_pressure [MPa],slip_speed [m/s],repeats\n10,1,0.1,2\n20,2,0.3,2\n15,1,0.2,1\n"


@pytest.mark.parametrize("text, options, says", [
    (PLAN.replace("[N]", ""), [], "has no unit"),
    (PLAN.replace("normal_load [N]", "force [N]"), [], "fit no kind of test"),
    (PLAN.replace("20,2", "20,x"), [], "'x' is not a number"),
    (PLAN.replace("20,2", "-20,2"), [], "must be positive"),
    (PLAN, ["--channel", "normal_force: 1 N"], "not a channel of these tests"),
    (PLAN, ["--value", "mass=1"], "no parameter 'mass'"),
    (PLAN, ["--model", "eq10", "--value", "sum_0=0.25"], "needs a unit"),
    (PLAN, ["--model", "eq10", "--value", "sum_0=0.25 mm"], "1/mm"),
    (PLAN, ["--uncertainty", "humidity=1 %"], "no condition 'humidity'"),
    (PLAN, ["--interval", "0 mm"], "must be positive"),
])
def test_bad_plans(tmp_path, capsys, text, options, says):
    """A table of planned tests is read strictly."""
    (tmp_path / "plan.csv").write_text(text)
    assert main(["map", str(tmp_path / "plan.csv"), *options]) == 2
    said = capsys.readouterr().err
    assert says in said and said.count("\n") == 1


@pytest.mark.slow
def test_map_sizes_are_found(tmp_path, capsys):
    """An effect of the stated size is found in most simulated campaigns, one of a third of it in few; one speed hides.

    The power asked for is 95 %; of eight campaigns at least six are wanted, which misses with a chance below 1 %.
    """
    (tmp_path / "plan.csv").write_text("normal_load [N],internal_pressure [MPa],slip_speed [m/s]\n" + "".join(
        f"{load},{pressure},{speed}\n" for load in (10, 20) for pressure in (1, 2) for speed in (0.1, 0.4)))
    values = ["adhesion_constant=0.9", "loss_factor=0.16", "slip_scale=1", "tensile_strength=10 MPa",
              "real_contact_pressure=20 MPa"]  # fmt: skip
    found = map_effects(tmp_path / "plan.csv", values=values)
    size = next(e for e in found.effects if e.effect == "viscous-friction").size
    assert size is not None and draw_map(found).axes
    count = {}
    for share in (1.0, 0.3):
        count[share] = 0
        for seed in range(8):
            made = make_slip_campaign("one", 300 + seed, {"viscous-friction": {"c_t": share * size}}, BASE, LOADS,
                                      PRESSURES, [0.1, 0.4])
            write_package(tmp_path / f"{share}-{seed}", made)
            bench = pose_selection(read_campaign(tmp_path / f"{share}-{seed}"), RubberFriction())
            bench, fitted = fit_reference(bench)
            lack, _ = bench.test_lack_of_fit(fitted)
            count[share] += lack.rejected
    assert count[1.0] >= 6 and count[0.3] <= 3
    (tmp_path / "plan.csv").write_text("normal_load [N],internal_pressure [MPa],slip_speed [m/s]\n" + "".join(
        f"{load},{pressure},0.1\n" for load in (10, 20) for pressure in (1, 2)))
    options = [f"--value={v}" for v in values]
    assert main(["map", str(tmp_path / "plan.csv"), *options, "-o", str(tmp_path / "map")]) == 0
    alike = {frozenset(pair) for pair in json.loads((tmp_path / "map" / "map.json").read_text())["alike"]}
    assert frozenset(("viscous-friction", "adhesive-offset")) in alike
    assert "could not distinguish" in capsys.readouterr().out


@pytest.mark.slow
def test_records_that_a_size_takes(tmp_path, capsys):
    """Of an effect that is linear in its amplitude: once the plan at the size that is found, four times at half of it,
    and no number at a size that nothing shows; units as they come, and what was taken for the records is told."""
    (tmp_path / "plan.csv").write_text(PLAN)
    size = next(e for e in map_effects(tmp_path / "plan.csv").effects if e.effect == "adhesive-offset").size
    asked = {"adhesive-offset.f_a": f"{500.0 * size} mN", "presliding.s_0": "1 nm"}
    found = map_effects(tmp_path / "plan.csv", sizes=asked)
    half, none = found.needed
    assert half.value == pytest.approx(0.5 * size) and half.length == pytest.approx(0.5 * found.length, rel=0.02)
    assert (half.repeats, half.records) in ((4, 20), (5, 25))
    assert (none.repeats, none.records) == (None, None) and none.length < 1e-3
    whole, = map_effects(tmp_path / "plan.csv", sizes=[f"adhesive-offset.f_a={1.05 * size} N"]).needed
    assert (whole.repeats, whole.records) == (1, found.records)
    for text, says in (("adhesive-offset.f_a=1 m", "no quantity in N"), ("adhesive-offset.f=1 N", "offset.f_a")):
        assert main(["map", str(tmp_path / "plan.csv"), "--size", text]) == 2
        assert says in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize("interval", [0.2, 0.05])
def test_no_effect_is_seen_by_a_sample_at_no_slip_alone(tmp_path, interval):
    """Friction that builds up over a slip is seen from where it changes samples beside the first, at no slip: the
    smallest s_0 is a share of the interval at which exp(-h/s_0) of the friction is beyond noise."""
    (tmp_path / "plan.csv").write_text(PLAN)
    found = {e.effect: e for e in map_effects(tmp_path / "plan.csv", interval=f"{interval} mm").effects}
    seen = found["presliding"].size
    assert seen is not None and 0.2 < seen / (1e-3 * interval) < 1.0


@pytest.mark.study
def test_a_channel_is_proposed(tmp_path):
    """Gain of the gauge against a larger contact, conditions held: the depression parts them, the force does not."""
    from ddetumble.contact.law import Ball
    from ddetumble.effects.impact import MembraneArea, SensorGain

    made = make_campaign("held", 3, {"sensor-gain": {"g": 1.08}}, {"effective_mass": 1.4, "restitution": 0.75},
                         [1.0e6, 1.1e6], [0.4], 2, interval=1e-3)
    write_package(tmp_path / "campaign", made)
    campaign = read_campaign(tmp_path / "campaign")
    space = ParameterSpace(Ball(), (SensorGain, MembraneArea))
    problem = Problem(space, stack_records(campaign))
    noise = {"normal_force": default_noise(campaign, "normal_force", np.arange(9) * 1e-3)}
    for effect, place in ((SensorGain, tmp_path), (MembraneArea, tmp_path / "rivals" / "1")):
        solution = problem.solve(space.of([None, effect.id]), space.coordinates(), tolerance=1e-4)
        save_model(place, make_fitted(
            campaign=campaign, model_name="paper", space=space, solution=solution, noise=noise, effects=[effect.id]))
    (tmp_path / "result.json").write_text(json.dumps({
        "verdict": "explained", "steps": [{"alternatives": ["membrane-area"]}]}))
    found = design(tmp_path, limits={"p0": "1 MPa", "speed": "0.4 m/s"})
    extra = found.proposals[0].extra
    own = next(p for p in found.proposals if p.extra is None)
    assert extra is not None and extra.assumed and found.proposals[0].repeats is not None
    assert own.repeats is None or own.repeats > found.proposals[0].repeats


def make_spins(folder, monkeypatch, effects, starts):
    """A campaign of bodies let go at given rates."""
    from ddetumble.exam.simulators import tumbling_campaigns

    monkeypatch.setattr(tumbling_campaigns, "draw_rates", lambda generator, count: np.asarray(starts, dtype=float))
    made = tumbling_campaigns.make_tumble_campaign("spins", 6, effects, {"inertia_ratio": 0.5}, len(starts),
                                                   interval=4.0)
    write_package(folder, made)
    return read_campaign(folder)


@pytest.mark.study
def test_another_spin_is_proposed(tmp_path, monkeypatch):
    """Drag against a constant torque, both about the axis of one spin: others part them, as SciPy has it."""
    from ddetumble.contact.torque import RigidBody
    from ddetumble.effects.tumble import ConstantTorque, EddyCurrent
    from ddetumble.exam.simulators.tumbling import simulate_tumbling

    rate, drag = 0.09, 2e-5
    campaign = make_spins(tmp_path / "campaign", monkeypatch, {"eddy-current": {"k_e": drag}}, [[2e-4, 0.0, rate]] * 2)
    space = ParameterSpace(RigidBody(), (EddyCurrent, ConstantTorque))
    problem = Problem(space, stack_records(campaign))
    channels = [c for c in campaign.channels if c.startswith("angular")]
    noise = {c: default_noise(campaign, c, np.arange(9) * 4.0) for c in channels}
    names = {EddyCurrent.id: ("eddy-current.k_e",), ConstantTorque.id: ("constant-torque.torque.2",)}
    for effect, place in ((EddyCurrent, tmp_path), (ConstantTorque, tmp_path / "rivals" / "1")):
        solution = problem.solve(names[effect.id], space.coordinates({"inertia_ratio": 0.5}), tolerance=1e-6)
        save_model(place, make_fitted(
            campaign=campaign, model_name="paper", space=space, solution=solution, noise=noise, effects=[effect.id]))
    (tmp_path / "result.json").write_text(json.dumps({
        "verdict": "explained", "steps": [{"alternatives": []}, {"alternatives": ["constant-torque"]}]}))
    best = design(tmp_path).proposals[0]
    assert best.repeats == 1
    start = [best.conditions[f"angular_velocity_{axis}0"] for axis in "xyz"]
    torque = float(load(tmp_path / "rivals" / "1").law().effects[0].torque_2)
    assert torque == pytest.approx(-drag * rate, rel=0.02)
    times = np.arange(0.0, 601.0, 4.0)
    dragged, pushed = (simulate_tumbling({"inertia_ratio": 0.5}, effects, start, times, 0.00106)[0] for effects in (
        {"eddy-current": {"k_e": drag}}, {"constant-torque": {"torque": [0.0, 0.0, torque]}}))
    # Both take the same from the old spin; on the new one SciPy sees at least what is promised after all refits.
    assert np.linalg.norm(dragged - pushed) / 2e-5 > best.pairs[0].distance > 10.0


@pytest.mark.study
def test_maps_of_tumbling_and_oblique_plans(tmp_path, monkeypatch, capsys):
    """Sizes that a map of free spins states are found by discover's test; a gain of all gyros hides in the ratio."""
    starts = [[0.05, 0.0, 0.06], [0.03, 0.02, 0.09], [0.0, 0.04, -0.05]]
    (tmp_path / "spins.csv").write_text(
        "angular_velocity_x0 [rad/s],angular_velocity_y0 [rad/s],angular_velocity_z0 [rad/s]\n"
        + "".join(",".join(map(str, start)) + "\n" for start in starts))
    assert main(["map", str(tmp_path / "spins.csv"), "--interval", "4 s", "--value", "inertia_ratio=0.5",
                 "-o", str(tmp_path / "map")]) == 0
    found = {e["effect"]: e for e in json.loads((tmp_path / "map" / "map.json").read_text())["effects"]}
    assert "cannot detect gyro-scale" in capsys.readouterr().out and found["gyro-scale"]["size"] is None
    from ddetumble.contact.torque import RigidBody

    size, count = found["eddy-current"]["size"], {}
    for share in (1.0, 0.3):
        count[share] = 0
        for seed in range(6):
            from ddetumble.exam.simulators import tumbling_campaigns

            monkeypatch.setattr(tumbling_campaigns, "draw_rates", lambda generator, n: np.asarray(starts))
            made = tumbling_campaigns.make_tumble_campaign("spins", 60 + seed, {"eddy-current": {"k_e": share * size}},
                                                           {"inertia_ratio": 0.5}, 3, interval=4.0)
            write_package(tmp_path / f"{share}-{seed}", made)
            bench = pose_selection(read_campaign(tmp_path / f"{share}-{seed}"), RigidBody())
            bench, fitted = fit_reference(bench)
            lack, _ = bench.test_lack_of_fit(fitted)
            count[share] += lack.rejected
    assert count[1.0] >= 5 and count[0.3] <= 2
    (tmp_path / "oblique.csv").write_text("initial_pressure [MPa],approach_speed [m/s],tangential_speed [m/s]\n"
                                          "0.5,0.3,0.1\n1.1,0.6,0.3\n2,0.6,0.6\n")
    assert main(["map", str(tmp_path / "oblique.csv"), "-o", str(tmp_path / "slanted")]) == 0
    slanted = json.loads((tmp_path / "slanted" / "map.json").read_text())
    seen = {e["effect"] for e in slanted["effects"] if e["size"] is not None}
    assert {"wall-stiffness", "stribeck", "tangential-compliance"} <= seen  # of the ball, of friction, of both


def test_deviations_before_and_after_a_test_are_plain_numbers():
    """Of a hundred newtons a metre as of a millisecond."""
    assert "± 110 to ± 79 N/m" in str(Narrowing("viscoelastic-wall.k_v", "N/m", 112.3, 79.1))
    assert "± 0.00077 to ± 0.00055 s" in str(Narrowing("viscoelastic-wall.tau", "s", 7.7e-4, 5.5e-4))


@pytest.mark.slow
def test_a_test_in_which_the_ball_is_pressed_flat_is_told():
    """Beyond half of its diameter the contact geometry says nothing: a soft ball at 1 m/s, and not a hard one."""
    fitted = dd.fit(dd.find_data() / "impact-a")
    told = [design(fitted, limits={"initial_pressure": pressure, "approach_speed": "1 m/s"}).notes
            for pressure in ("20 kPa", "1 MPa")]
    assert [any(f"{SQUEEZED:.0%}" in note for note in notes) for notes in told] == [True, False]


@pytest.mark.slow
def test_the_search_keeps_where_the_contact_geometry_holds():
    """Within limits of which a part presses the ball flat, of one model by its scan, of two rivals by their climb."""
    campaign = dd.find_data() / "impact-a"
    rivals = [dd.fit(campaign), dd.fit(campaign, effects=["wall-stiffness"])]
    for models in (rivals[0], rivals):
        found = design(models, limits={"initial_pressure": "20..200 kPa", "approach_speed": "0.3..3 m/s"})
        for proposal in found.proposals:
            conditions = {name: np.array([value]) for name, value in proposal.conditions.items()}
            assert not find_squeezes(rivals[0].fitted_model(), ["next"], conditions)
