"""The loop on slip records: campaigns of the independent simulator, judged blind, and what comes out of them."""

import dataclasses as dc
import json

import numpy as np
import pandas as pd
import pytest

from ddetumble import InputError, compare, discover, find_data, fit, predict, read_campaign, write_campaign
from ddetumble.cli import main
from ddetumble.contact.sliding import RubberFriction
from ddetumble.effects import AdhesiveOffset
from ddetumble.exam.simulators.campaigns import write_package
from ddetumble.exam.simulators.slip_campaigns import make_slip_campaign
from ddetumble.selection.forward_selection import list_starts
from ddetumble.selection.problem import fit_reference, pose_selection


BASE = {"adhesion_constant": 0.92, "loss_factor": 0.17, "tensile_strength": 10e6, "real_contact_pressure": 20e6,
        "slip_scale": 1.0}  # fmt: skip
PLAN = ([6.0, 13.0, 26.0], [0.8e6, 2.1e6], [0.03, 0.12, 0.4], 1)
TRUTH = json.loads((find_data() / "truth.json").read_text(encoding="utf-8"))
CASES = {
    "nothing": ({}, {}),
    "nothing, correlated noise, scatter": ({}, {"rho": 0.7, "setting_scatter": 0.01}),
    "stribeck": ({"stribeck": {"A": 0.35, "u_s": 0.06}}, {}),
    "viscous-friction": ({"viscous-friction": {"c_t": 0.8}}, {"rho": 0.6}),
    "load-exponent": ({"load-exponent": {"m": 0.06}}, {"setting_scatter": 0.01}),
    "presliding": ({"presliding": {"s_0": 2.4e-4}}, {}),
    "frictional-heating": ({"frictional-heating": {"kappa": 4.5}}, {}),
    "adhesive-offset": ({"adhesive-offset": {"f_a": 0.3}}, {"length": 9e-3}),
    "a pair": ({"stribeck": {"A": 0.3, "u_s": 0.09}, "presliding": {"s_0": 2e-4}}, {}),
}


@pytest.fixture(scope="module", params=CASES, ids=str)
def case(request, tmp_path_factory):
    """Effects of a case, the campaign with its truth, and what discover says."""
    effects, options = CASES[request.param]
    folder = tmp_path_factory.mktemp("slip") / "campaign"
    made = make_slip_campaign("campaign", 40 + list(CASES).index(request.param), effects, BASE, *PLAN, **options)
    write_package(folder, made)
    return effects, folder, discover(folder)


@pytest.mark.slow
def test_verdict(case):
    """Nulls, singles and the pair; nothing else is named, and the intervals hold the truth."""
    effects, _, found = case
    assert found.verdict == ("explained" if effects else "nothing-missing"), found.sentence
    alike = {a["effect"] for step in found.steps for a in step.alternatives}
    assert set(found.effects) == set(effects) or set(effects) <= set(found.effects) | alike
    truth = {**BASE, **{f"{e}.{n}": v for e, p in effects.items() for n, v in p.items()}}
    estimates = found.steps[-1].parameters
    assert {"adhesion_constant", "loss_factor", "slip_scale"} <= set(estimates)
    for name, estimate in estimates.items():
        assert abs(estimate.estimate - truth[name]) < 4.0 * estimate.sd, name


@pytest.mark.slow
def test_presliding_far_below_the_spacing(tmp_path):
    """Only the first sample of every stroke feels it: named, with its size left open below the spacing."""
    made = make_slip_campaign("campaign", 51, {"presliding": {"s_0": 4e-8}}, BASE, *PLAN)
    write_package(tmp_path / "campaign", made)
    found = discover(tmp_path / "campaign")
    assert (found.verdict, found.effects) == ("explained", ("presliding",)), found.sentence
    estimate = found.steps[-1].parameters["presliding.s_0"]
    assert abs(estimate.estimate - 4e-8) < 2.0 * estimate.sd and estimate.estimate < 5e-5


@pytest.mark.slow
def test_an_effect_whose_first_fit_stops_short_is_found(tmp_path):
    """Settings close together and six repeats of one test: the quick fit of the true effect ends half way, where its
    linearised loss on left-out conditions is a thousand times too large; it is fitted to the end all the same.
    """
    from ddetumble.exam.simulators.campaigns import write_package
    from docs.next_test import extend_case, make_case

    hidden = {"load-exponent": {"m": 0.08}}
    more = make_case("slip", hidden, 75, "more", (27.0, 602e3, 0.2), 6)
    case = extend_case(make_case("slip", hidden, 5, "case"), more, 6)
    write_package(tmp_path / "campaign", case)
    found = discover(tmp_path / "campaign")
    assert found.verdict == "explained" and found.effects == ("load-exponent",), found.sentence
    size = found.steps[-1].parameters["load-exponent.m"]
    assert size.q025 < 0.08 < size.q975


@pytest.fixture(scope="module")
def valley(tmp_path_factory):
    """Stribeck's effect and a viscous one, which nearly cancel: beside the first alone, its fit runs along a valley."""
    base = {"adhesion_constant": 0.60747, "loss_factor": 0.139881, "slip_scale": 1.087253}
    hidden = {"stribeck": {"A": 0.9916, "u_s": 0.05998}, "viscous-friction": {"c_t": 1.1}}
    folder = tmp_path_factory.mktemp("valley") / "campaign"
    write_package(folder, make_slip_campaign(
        "campaign", 485075603, hidden, base, [5.791, 12.7, 19.81], [666000.0, 1461000.0], [0.02967, 0.07555, 0.252],
        length=8e-3, interval=1e-4, setting_scatter=0.01, rho=0.86309))
    return hidden, folder


@pytest.mark.study
def test_two_effects_of_a_valley_are_no_baselines(valley):
    """Both are found, each within three of its deviations. The first was passed over for a leave-one-out step that led
    astray, and baselines that wander stood for the two: "no significant lack of fit"."""
    hidden, folder = valley
    found = discover(folder)
    assert (found.verdict, set(found.effects)) == ("explained", set(hidden)), found.sentence
    for effect, values in hidden.items():
        for name, value in values.items():
            one = found.steps[-1].parameters[f"{effect}.{name}"]
            assert abs(one.estimate - value) < 3.0 * one.sd


@pytest.mark.slow
@pytest.mark.parametrize("adjust", [False, True])
def test_conditions_left_out_in_a_valley_are_predicted_by_a_fit(valley, adjust):
    """As by the campaign without the record, fitted anew: its settings as written, or adjusted."""
    campaign = read_campaign(valley[1])
    selection, reference = fit_reference(pose_selection(campaign, RubberFriction()))
    starts = list_starts(selection, "stribeck", selection.test_lack_of_fit(reference)[1])
    fitted = selection.fit(["stribeck"], starts, reference.solution.u, None, tolerance=1e-4)
    seen = selection.predict(fitted, adjust).squares
    signal = np.sum([np.sum(campaign.trace(key)["tangential_force"] ** 2) for key in campaign.record_keys])
    for r in (0, 7, 16):
        key = campaign.record_keys[r]
        others = pose_selection(campaign.select([k for k in campaign.record_keys if k != key]), RubberFriction())
        others = dc.replace(others.restack(selection.noise), noise=selection.noise)
        u = others.fit(["stribeck"], [{}], fitted.solution.u, None, tolerance=1e-3).solution.u
        at = selection.problem.solve((), u, np.zeros_like(fitted.solution.z), moving=adjust, tolerance=1e-4)
        trace = campaign.trace(key)["tangential_force"].to_numpy()
        assert seen[r] == pytest.approx(np.sum((at.channels[r, 0, :len(trace)] - trace) ** 2) / signal, rel=0.1)


@pytest.mark.study
def test_a_fit_that_stops_short_gains_no_effect(tmp_path):
    """Two speeds leave a valley in which the fit of a strong Stribeck effect may stop: nothing else is named for it."""
    base = {"adhesion_constant": 0.9346840387478539, "loss_factor": 0.1624918320527941,
            "slip_scale": 0.9053571529804284}
    strong = {"stribeck": {"A": 2.6007038135223097, "u_s": 0.04690796180666758}}
    made = make_slip_campaign("campaign", 1306007763, strong, base, [6.621, 8.697, 13.86, 23.7], [911100.0, 1455000.0],
                              [0.05214, 0.2503], length=8e-3, interval=5e-5, numbered=True, rho=0.7255737936307904)
    write_package(tmp_path / "campaign", made)
    found = discover(tmp_path / "campaign")
    assert (found.verdict, found.effects) == ("explained", ("stribeck",)), found.sentence


@pytest.mark.slow
def test_prediction_at_other_conditions(case, tmp_path):
    """The grown model predicts noise-free records at conditions that no record had, to half of the noise."""
    from ddetumble.exam.simulators.slip import simulate_slip

    effects, _, found = case
    found.save(tmp_path)
    slip = np.linspace(0.0, 9e-3, 31)
    settings = {"normal_load": 18.0, "internal_pressure": 1.4e6, "slip_speed": 0.07}
    table = predict(tmp_path, pd.DataFrame({"record": "x", **settings, "slip": slip}))
    expected = np.ravel(simulate_slip(BASE, effects, settings, slip))
    assert np.sqrt(np.mean((table["tangential_force"] - expected) ** 2)) < 0.5 * 0.04
    one = predict(tmp_path, pd.DataFrame({"record": "x", **settings, "slip": [6e-3]}))  # a single sample: same path
    assert float(one["tangential_force"].iloc[0]) == pytest.approx(float(table["tangential_force"].iloc[20]), abs=2e-6)
    assert (table["tangential_force_sd_new"] > 0.039).all() and (table["tangential_force_sd"] < 0.05).all()


@pytest.mark.study
def test_outside_the_catalogue(tmp_path):
    """A saw tooth along the slip is not explained, and its wavelength is found."""
    made = make_slip_campaign("c", 77, {"x-stick-slip": {"ratio": 0.03, "wavelength": 2.3e-3}}, BASE, *PLAN)
    write_package(tmp_path / "c", made)
    found = discover(tmp_path / "c")
    assert found.verdict in ("unexplained", "improved")
    periods = [place.period for place in found.where if place.variable == "slip" and place.period]
    assert periods and periods[0] == pytest.approx(2.3e-3, rel=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["slip-a", "slip-b", "slip-c", "slip-d", "slip-e"])
def test_shipped_campaigns(name):
    """One effect, correlated noise, nothing, reversed strokes over time: each as truth.json has it."""
    found = discover(find_data() / name)
    truth = TRUTH[name]["effects"]
    assert set(found.effects) == set(truth) and found.verdict == ("explained" if truth else "nothing-missing")
    assert any("-m eq10" in note for note in found.notes)  # what the intervals take for exact
    for effect, values in truth.items():
        for symbol, value in values.items():
            estimate = found.steps[-1].parameters[f"{effect}.{symbol}"]
            assert abs(estimate.estimate - value) < 4 * estimate.sd


@pytest.mark.slow
def test_compare_and_fit():
    """Errors by condition, a constant coefficient beside Eqs. 8 to 11, and an effect that is told."""
    campaign = read_campaign(find_data() / "slip-b")
    plain, coulomb = compare(campaign), compare(campaign, "coulomb")
    assert plain.lack_of_fit.rejected and coulomb.nrmse > plain.nrmse
    assert {"slip", "normal_load", "internal_pressure", "slip_speed"} <= set(plain.residuals["variable"])
    told = fit(campaign, effects=["viscous-friction"])
    assert told.chi2_reduced == pytest.approx(1.0, abs=0.1) and told.converged
    estimate = told.parameters["viscous-friction.c_t"]
    assert abs(estimate.estimate - TRUTH["slip-b"]["effects"]["viscous-friction"]["c_t"]) < 4 * estimate.sd


@pytest.mark.slow
def test_noise_of_strokes_is_measured_between_the_turns():
    """Samples missing where the motion turns round, and two sampling intervals, hinder nothing."""
    noise = compare(find_data() / "slip-d").noise["tangential_force"]
    assert noise["text"] == "white" and noise["sd"] == pytest.approx(0.04, rel=0.05)


def test_known_names_are_checked():
    campaign = read_campaign(find_data() / "slip-c")
    known = dict(campaign.known)
    with pytest.raises(InputError, match="datapackage.json, key known.elastic_modulu: .*did you mean elastic_modulus"):
        compare(dc.replace(campaign, known={"elastic_modulu": known.pop("elastic_modulus"), **known}))
    notes = compare(dc.replace(campaign, known={**campaign.known, "operator_age": 40.0})).notes
    assert any("operator_age" in note for note in notes)


@pytest.mark.slow
def test_one_pressure_cannot_tell_k_from_the_loss_angle():
    """Eq. 8 at one pressure fixes one number: said in words, with the test that would tell them apart."""
    campaign = read_campaign(find_data() / "slip-c")
    pressures = campaign.records["internal_pressure"]
    low = campaign.select(pressures.index[pressures < pressures.min() * 1.05])
    found = fit(low)
    text = " ".join(found.cannot_tell_apart)
    assert "adhesion_constant" in text and "loss_factor" in text and "pressure" in text
    both = fit(campaign)
    assert not any("adhesion_constant" in t and "cannot be distinguished" in t for t in both.cannot_tell_apart)


def test_loads_beyond_the_polynomials_are_flagged(tmp_path):
    """Every result says where Eq. 10 does not hold."""
    made = make_slip_campaign("far", 5, {}, BASE, [10.0, 35.0, 46.0], [1e6, 2e6], [0.1], 2, length=3e-3)
    write_package(tmp_path / "far", made)
    campaign = read_campaign(tmp_path / "far")
    for notes in (discover(campaign).notes, compare(campaign).notes, fit(campaign).notes):
        text = " ".join(notes)
        assert "30.7 N" in text and "44.4 N" in text
    discover(campaign).save(tmp_path / "grown")
    table = predict(tmp_path / "grown", pd.DataFrame(
        {"record": "x", "normal_load": 50.0, "internal_pressure": 1e6, "slip_speed": 0.1, "slip": [1e-3, 2e-3]}))
    assert any("Eq. 10" in note for note in table.attrs["notes"])


@pytest.mark.slow
def test_commands(tmp_path, capsys):
    """The same from a terminal: effects, compare, discover with its page, predict."""
    assert main(["effects"]) == 0 and "frictional-heating" in capsys.readouterr().out
    assert main(["effects", "presliding"]) == 0 and "s_0 [m]" in capsys.readouterr().out
    folder = str(find_data() / "slip-a")
    assert main(["compare", folder, "-o", str(tmp_path / "compared")]) == 0
    assert main(["discover", folder, "-o", str(tmp_path / "found")]) == 0
    out = capsys.readouterr().out
    assert "adhesive-offset" in out and (tmp_path / "found" / "report.html").stat().st_size > 1e5
    result = json.loads((tmp_path / "found" / "result.json").read_text(encoding="utf-8"))
    assert result["family"] == "slip" and len(result["candidates"]) == 6
    pd.DataFrame({"record": "a", "normal_load": 12.0, "internal_pressure": 1e6, "slip_speed": 0.1,
                  "slip": np.linspace(0, 5e-3, 6)}).to_csv(tmp_path / "wanted.csv", index=False)
    assert main(["predict", str(tmp_path / "found"), str(tmp_path / "wanted.csv"), "-o", str(tmp_path / "p.csv")]) == 0
    assert list(pd.read_csv(tmp_path / "p.csv").columns)[:3] == ["record", "slip", "tangential_force"]


@pytest.mark.slow
def test_a_grown_model_is_grown_further(tmp_path):
    """What `fit` wrote is where `discover` goes on from: nothing more is missing, and its effect is no candidate."""
    campaign = read_campaign(find_data() / "slip-b")
    folder = fit(campaign, effects=["viscous-friction"]).save(tmp_path / "grown")
    found = discover(campaign, str(folder))
    assert found.verdict == "nothing-missing" and "viscous-friction.c_t" in found.steps[0].parameters
    assert "viscous-friction" not in {candidate.effect for candidate in found.candidates}
    assert str(tmp_path) not in found.sentence and found.sentence.name == "verdict.nothing_missing"
    found.save(tmp_path / "again")
    row = {"record": "a", "normal_load": 12.0, "internal_pressure": 1e6, "slip_speed": 0.3, "slip": [1e-3]}
    one, two = (predict(tmp_path / name, pd.DataFrame(row))["tangential_force"].iloc[0] for name in ("grown", "again"))
    assert one == pytest.approx(two, rel=2e-3)


def test_bad_input(tmp_path):
    """One sentence each: wrong model, missing condition, missing channel, a model that is not there."""
    campaign = read_campaign(find_data() / "slip-a")
    with pytest.raises(InputError, match="coulomb"):
        discover(campaign, "matunaga")
    with pytest.raises(InputError, match="'wall-stiffness' acts on impact records"):
        fit(campaign, effects=["wall-stiffness"])
    with pytest.raises(InputError, match="of the family 'slip'"):
        compare(read_campaign(find_data() / "impact-i"), str(fit(campaign).save(tmp_path / "fitted")))
    wanted = {"record": "x", "normal_load": 9.0, "internal_pressure": 1e6, "slip_speed": 0.1}
    for change, message in (({"slip": [2e-3, 1e-3]}, "slip falls within record 'x'"), ({"slip": [-1e-3]}, "negative"),
                            ({"slip": [1e-3], "normal_load": -9.0}, "normal_load"),
                            ({"slip": [1e-3], "slip_speed": 0.0}, "slip_speed")):
        with pytest.raises(InputError, match=message):
            predict(tmp_path / "fitted", pd.DataFrame(wanted | change))
    with pytest.raises(InputError, match="known.adhesion_constant: -0.5 is outside"):
        fit(dc.replace(campaign, known=campaign.known | {"adhesion_constant": -0.5}))
    write_campaign(tmp_path / "copy", campaign)
    rows = (tmp_path / "copy" / "records.csv").read_text(encoding="utf-8").splitlines()
    assert "internal_pressure" in rows[0]
    descriptor = json.loads((tmp_path / "copy" / "datapackage.json").read_text(encoding="utf-8"))
    for resource in descriptor["resources"]:
        if resource["name"] == "records":
            resource["schema"]["fields"] = [f for f in resource["schema"]["fields"] if f["name"] != "internal_pressure"]
    place = rows[0].split(",").index("internal_pressure")
    text = "\n".join(",".join(c for k, c in enumerate(row.split(",")) if k != place) for row in rows)
    (tmp_path / "copy" / "records.csv").write_text(text + "\n", encoding="utf-8")
    (tmp_path / "copy" / "datapackage.json").write_text(json.dumps(descriptor), encoding="utf-8")
    with pytest.raises(InputError, match="column internal_pressure"):
        discover(tmp_path / "copy")


def test_an_effect_is_named_with_the_error_that_looks_like_it(tmp_path):
    """A zero of the gauge that is off alike in all strokes one way is an adhesive offset to any test."""
    folder = tmp_path / "zero"
    write_package(folder, make_slip_campaign("zero", 31, {"adhesive-offset": {"f_a": 0.3}}, BASE, *PLAN))
    found = discover(folder)
    assert found.effects == ("adhesive-offset",) and AdhesiveOffset.lookalike in found.sentence
