"""Settings that are wrong alike in all records: how large their error is, and what they do not explain."""

import dataclasses as dc
from types import SimpleNamespace

import numpy as np
import pytest
from helpers_statistics import PRESSURES, SPEEDS, fit_toy, make_selection

import ddetumble as dd
from ddetumble.effects.impact import SensorGain, WallStiffness
from ddetumble.effects.oblique import SensorCrosstalk
from ddetumble.exam.cases import Exam, sample_case, write_case
from ddetumble.inference.archive import resolve_model
from ddetumble.measurement.units import Uncertainty
from ddetumble.selection.bias import SettingBias, find_bias, fit_biases, matches_effects, stand_in
from ddetumble.selection.cross_validation import leave_out
from ddetumble.selection.problem import fit_reference, pose_selection
from ddetumble.selection.settings import DEFAULT


EXAM = Exam("slip", 94, ("one", "two", "outside"), bench="drawn")
OBLIQUE = Exam("oblique", 201, ("one",), bench="drawn")
CONDITIONS = [(v, p) for v in SPEEDS for p in PRESSURES] * 2


def scale(name, share):
    """What is written down is too large by a share."""
    def spoil(measured, stated):
        stated[name] = stated[name] / (1.0 - share)
    return spoil


def fit(seed, share=0.0, name="approach_speed", **options):
    """Biases by name, and the model without one: its stiffness and loss are known, so that a bias of speeds shows."""
    selection = make_selection(seed, conditions=CONDITIONS, spoil=scale(name, share), effects=(), **options)
    held = () if name == "initial_pressure" else ("gas",)
    selection, fitted = fit_toy(dc.replace(selection, base=held))
    return {one.name: one for one in fit_biases(selection, fitted, fitted)}, selection, fitted


def test_a_bias_is_found_within_its_deviation():
    """Errors of speeds drawn as the prior has them, 2 %, in 40 campaigns: the estimates stray from them as stated (mean
    square within four deviations of that of so many normal draws), and far less than the prior."""
    z, deviations = [], []
    for seed in range(40):
        share = 0.02 * np.random.default_rng([71, seed]).standard_normal()
        found = fit(seed, share)[0]["approach_speed"]
        z.append((found.bias - share) / found.sd)
        deviations.append(found.sd)
    assert np.mean(np.square(z)) == pytest.approx(1.0, abs=4.0 * np.sqrt(2.0 / 40))
    assert max(deviations) < 0.2 * 0.02


@pytest.mark.parametrize("name", ["approach_speed", "initial_pressure"])
@pytest.mark.parametrize("share", [0.02, -0.02])
def test_a_bias_of_one_setting_explains_the_records(name, share):
    """It is the best rival, has the sign and the size of the error, is not rejected, and its merit is better than that
    of the model without it, in at least 7 of 8 campaigns."""
    right = 0
    for seed in range(8):
        biases, _, fitted = fit(seed, share, name)
        best = biases[next(iter(biases))]
        close = best.name == name and abs(best.bias - share) < 3.0 * best.sd
        right += close and best.rejected is False and best.merit < fitted.merit and best.difference < 0.0
    assert right >= 7


def test_an_error_that_may_be_none_stands_for_nothing(monkeypatch):
    """Of two errors that leave no misfit the one within its deviations explains none of it."""
    def make(name, bias):
        return SettingBias(name, bias, 0.01, 0.0, False, 0.0, 1.0, ("ripple",))

    pair = [make("pressure", 1e-4), make("speed", -0.03)]
    monkeypatch.setattr("ddetumble.selection.bias.fit_biases", lambda *_: pair)
    assert stand_in(SimpleNamespace(settings=DEFAULT), ["first", "last"]) == (pair[1:], [])


@pytest.mark.study
def test_a_bias_is_that_of_a_fit_with_it(tmp_path):
    """An adhesive offset beside a speed that reads 2.5 % too high, from the second simulator: the error, its deviation
    and its merit are those of the model that has the error as a parameter, to a tenth of what is significant. One
    linearised step left 230 noise variances too much."""
    kept = write_case(OBLIQUE, sample_case(OBLIQUE, 6), tmp_path)["bench_details"]["biased-setting"]
    campaign = dd.read_campaign(tmp_path)
    plain, _ = fit_reference(pose_selection(campaign, resolve_model("paper", "oblique").reference))
    fitted = plain.fit(["adhesive-offset"], [{}], plain.guess, None, tolerance=1e-4)
    (one,) = [one for one in fit_biases(plain, fitted, fitted) if one.name == kept["of"] == "approach_speed"]
    column = dc.replace(campaign.conditions[one.name], common=Uncertainty(relative=plain.settings.bias))
    stating = dc.replace(campaign, conditions={**campaign.conditions, one.name: column})
    wider = pose_selection(stating, plain.space.reference)
    wider = dc.replace(wider.restack(plain.noise), noise=plain.noise)
    whole = wider.fit(["adhesive-offset"], [{}], wider.start, None, tolerance=1e-4)
    place = whole.solution.names.index("approach_speed_shift")
    assert one.bias == pytest.approx(-whole.solution.u[wider.space.index["approach_speed_shift"]], abs=0.1 * one.sd)
    assert one.sd == pytest.approx(np.sqrt(whole.solution.covariance()[place, place]), rel=0.01)
    assert one.merit == pytest.approx(whole.merit, abs=0.1 * plain.settings.significant)
    assert one.bias == pytest.approx(1.0 - 1.0 / kept["factor"], abs=3.0 * one.sd)


def test_a_bias_does_not_stand_for_another_force():
    """Where a ripple is missing every bias is rejected."""
    for seed in range(5):
        assert all(one.rejected is True for one in fit(seed, truth={"ripple.a": 0.2})[0].values())


def test_a_bias_that_is_none_is_small_and_rarely_rejected():
    """Without an error: zero within three deviations in all of 20 campaigns; of a complete model at most 4 are rejected
    (one in thirty by chance)."""
    found = [fit(seed)[0]["approach_speed"] for seed in range(20)]
    assert all(abs(one.bias) < 3.5 * one.sd for one in found) and sum(one.rejected for one in found) <= 4


def test_a_bias_that_nothing_shows_stays_at_its_prior():
    """Where the gas's own parameter is free, a pressure off by a few percent alike in all records is as good."""
    found = fit(1, 0.0)[0]["initial_pressure"]
    assert found.sd == pytest.approx(0.02, rel=0.01) and abs(found.bias) < 0.005


def test_a_rival_is_compared_with_its_model():
    """Against the very model it stands beside, differences of the loss are those of the losses."""
    biases, selection, fitted = fit(2, 0.02)
    rival = dc.replace(fitted, loss=fitted.loss + 3.0, effects=("ripple",))
    moved = {one.name: one for one in fit_biases(selection, fitted, rival)}
    np.testing.assert_array_equal(fitted.loss, leave_out(fitted.solution, selection.groups))
    for name, one in biases.items():
        assert moved[name].difference == pytest.approx(one.difference - 3.0 * len(CONDITIONS), rel=1e-9)
        assert moved[name].effects == ("ripple",) and moved[name].bias == one.bias


@pytest.mark.slow
def test_a_shared_error_is_told_from_a_missing_force():
    """Speeds 3 % too high in all records are found beside a model that lacks nothing else, in at least 7 of 8
    campaigns; beside one that lacks a ripple none is, and where settings are as stated in at most 2 of 20."""
    def look(seed, *args, **options):
        _, selection, fitted = fit(seed, *args, **options)
        return find_bias(selection, fitted)

    wrong = [look(seed, 0.03) for seed in range(8)]
    named = [one for one in wrong if one is not None and one.name == "approach_speed"]
    assert len(named) >= 7 and all(abs(one.bias - 0.03) < 3.5 * one.sd for one in named)
    assert all(look(seed, truth={"ripple.a": 0.2}) is None for seed in range(5))
    assert sum(look(seed) is not None for seed in range(20)) <= 2


def test_a_shared_error_beside_settings_that_scatter():
    """Speeds 4 % too high that scatter by four times what is stated beside: both are told in at least 6 of 8 campaigns,
    the error within three and a half of its deviations, the scatter about it within a factor of 1.5."""
    found = []
    for seed in range(8):
        def spoil(measured, stated, seed=seed):
            stray = 0.04 * np.random.default_rng([72, seed]).standard_normal(len(CONDITIONS))
            stated["approach_speed"] = stated["approach_speed"] * (1.0 + stray) / (1.0 - 0.04)
        selection = make_selection(seed, conditions=CONDITIONS, spoil=spoil, effects=())
        selection, fitted = fit_toy(dc.replace(selection, base=("gas",)))
        found.append(find_bias(selection, fitted))
    close = [one is not None and one.name == "approach_speed" and abs(one.bias - 0.04) < 3.5 * one.sd
             and 4.0 / 1.5 < one.scatter.get("approach_speed", 0.0) < 4.0 * 1.5 for one in found]
    assert sum(close) >= 6


def test_a_shared_error_that_the_campaign_states_is_no_rival():
    """What the model has as a parameter is not looked for again."""
    selection = fit(3, 0.03)[1]
    columns = {name: dc.replace(column, common=Uncertainty(relative=0.02))
               for name, column in selection.campaign.conditions.items()}
    known = dc.replace(selection, campaign=dc.replace(selection.campaign, conditions=columns))
    assert fit_biases(known, fit(3, 0.03)[2], fit(3, 0.03)[2]) == []


@pytest.mark.parametrize(("merits", "effects", "expected"), [
    ((), [WallStiffness], False), ((12.0,), [WallStiffness], True), ((8.0,), [WallStiffness], True),
    ((12.0,), [SensorGain], False), ((8.0, 12.0), [SensorGain], True), ((12.0,), [SensorGain, WallStiffness], True),
    ((12.0,), [SensorCrosstalk], False),
])  # fmt: skip
def test_no_physics_stands_beside_an_error_that_does_as_well(merits, effects, expected):
    """Effects of merit 10: a gauge's gain gives way only to a better error, physics to any that is not beaten."""
    assert matches_effects([SimpleNamespace(merit=one) for one in merits], 10.0, effects) is expected


def fit_both(seed, truth):
    """The toy's selection problem, and its fits with nothing, a ripple, and a ripple and a settling."""
    selection = make_selection(seed, truth, conditions=CONDITIONS, spoil=scale("approach_speed", 0.03))
    selection, fitted = fit_toy(dc.replace(selection, base=("gas",)))
    models = [fitted]
    for effect in ("ripple", "settling"):
        more = (*models[-1].effects, effect)
        models.append(selection.fit(more, [{}], models[-1].solution.u, None, tolerance=1e-6))
    return selection, models


def test_an_error_stands_for_the_last_effect_alone():
    """Speeds 3 % off beside a ripple: no error of a setting leaves the model without the ripple unrejected; the one of
    speeds stands for the settling in at least 7 of 8 campaigns, and for nothing where the settling is there too."""
    found = [stand_in(*fit_both(seed, {"ripple.a": 0.5})) for seed in range(8)]
    assert not any(whole for whole, _ in found)
    named = [[(one.name, one.effects) for one in part] for _, part in found]
    assert named.count([("approach_speed", ("settling",))]) >= 7
    for seed in range(4):
        assert stand_in(*fit_both(seed, {"ripple.a": 0.5, "settling.a": 0.3})) == ([], [])


@pytest.mark.study
def test_a_biased_load_is_no_second_effect(tmp_path):
    """Viscous friction beside loads that all read too low, from the second simulator: that alone is named, with the
    loads' error and what would predict worse in its place."""
    kept = write_case(EXAM, sample_case(EXAM, 0), tmp_path)
    found = dd.discover(tmp_path)
    bias = kept["bench_details"]["biased-setting"]
    assert (found.verdict, found.effects) == ("explained", ("viscous-friction",))
    one = found.shared_error
    assert (one.name, one.effects) == (bias["of"], ("frictional-heating",))
    assert one.bias == pytest.approx(1.0 - 1.0 / bias["factor"], abs=3.0 * one.sd)


@pytest.mark.study
@pytest.mark.parametrize(("case", "effect"), [(6, "adhesive-offset"), (11, "off-centre-reaction")])
def test_a_biased_setting_is_no_second_effect(tmp_path, case, effect):
    """Impacts at an angle with one effect, and a speed or pressure that reads too high, from the second simulator: the
    effect alone is named; others that would do as well as the error, and errors of other settings, are left open."""
    kept = write_case(OBLIQUE, sample_case(OBLIQUE, case), tmp_path)["bench_details"]["biased-setting"]
    found = dd.discover(tmp_path)
    assert (found.verdict, found.effects) == ("explained", (effect,))
    errors = {one.name: one for one in (found.shared_error, *found.shared_error.alike)}
    assert errors[kept["of"]].bias == pytest.approx(1.0 - 1.0 / kept["factor"], abs=3.0 * errors[kept["of"]].sd)
    assert found.dropped and {one.setting for one in found.explanations} - {None} == {*errors}
    assert all(one.effects[0] == effect for one in found.explanations)
