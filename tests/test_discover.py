"""Verdicts on the independent simulator's campaigns: nothing missing, one effect, outside the catalogue, hard noise."""

import json

import pytest

from ddetumble._settings import find_data
from ddetumble.cli import main
from ddetumble.exam.simulators.campaigns import write_package
from ddetumble.exam.simulators.impact_campaigns import make_campaign
from ddetumble.measurement.package import read_campaign
from ddetumble.selection.discover import discover
from ddetumble.selection.settings import SelectionSettings
from tests.helpers_ranking import check_ranking


BASE = {"effective_mass": 1.37, "restitution": 0.73}
PRESSURES, SPEEDS = [0.5e6, 1.1e6, 1.9e6, 2.4e6], [0.16, 0.38, 0.66]


def judge(tmp_path, name, effects, seed, **options):
    """Simulate a campaign, write it, and let `discover` judge the folder; its ranking holds together."""
    options = {"repeats": 1, "interval": 4e-4, **options}
    campaign = make_campaign(name, seed, effects, BASE, PRESSURES, SPEEDS, **options)
    write_package(tmp_path / name, campaign)
    found = discover(tmp_path / name)
    check_ranking(found)
    return found


def holds(found, name, truth):
    """Whether four deviations about the estimate hold the truth (a 95 % interval would fail once in twenty tests)."""
    e = found.steps[-1].parameters[name]
    return abs(e.estimate - truth) < 4.0 * e.sd


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "noise"), [(11, {}), (12, {"rho": 0.7}), (13, {"rho": 0.85, "white_share": 0.4}),
                                             (14, {"setting_scatter": 0.01})])
def test_nothing_missing(tmp_path, seed, noise):
    found = judge(tmp_path, "null", {}, seed, **noise)
    assert found.verdict == "nothing-missing", found.sentence
    assert found.effects == ()
    assert holds(found, "effective_mass", BASE["effective_mass"])
    assert holds(found, "restitution", BASE["restitution"])
    assert len(found.candidates) == 19
    assert found.steps[0].lack_of_fit.p_value > 0.005


@pytest.mark.slow
@pytest.mark.parametrize(("effect", "values", "noise"), [
    ("wall-stiffness", {"k_w": 1100.0, "q": 1.0}, {}),
    ("viscous-dashpot", {"c_v": 6.0}, {"rho": 0.6}),
    ("sensor-highpass", {"tau_s": 0.7}, {}),
    pytest.param("speed-dependent-restitution", {"p": 0.09}, {}, marks=pytest.mark.study),
    ("adhesion", {"tau_a": 5e4}, {}),
    # A gauge that rings, and what it may be taken for.
    ("sensor-resonance", {"f_0": 130.0, "zeta": 0.06}, {}),
    ("sensor-resonance", {"f_0": 300.0, "zeta": 0.02}, {"rho": 0.5}),
    ("sensor-filter", {"f_c": 200.0}, {}),
    # Friction in the gauge, over the whole force and over little of it, beside the lags and losses that resemble it.
    ("sensor-hysteresis", {"h": 0.08, "w": 40.0}, {"rho": 0.5}),
    ("sensor-hysteresis", {"h": 0.2, "w": 5.0}, {}),
    ("sensor-lag", {"T": 4e-4}, {}),
    ("sensor-gain", {"g": 1.06}, {}),
])
def test_single_effect_is_found(tmp_path, effect, values, noise):
    found = judge(tmp_path, "single", {effect: values}, 21, **noise)
    assert found.verdict == "explained", found.sentence
    assert found.effects == (effect,)
    assert found.candidates[0].effect == effect
    if effect.startswith("sensor-"):
        assert not found.steps[-1].alternatives
    for name, value in values.items():
        if f"{effect}.{name}" in found.steps[-1].parameters:
            assert holds(found, f"{effect}.{name}", value)
    assert found.steps[-1].heldout_nrmse < found.steps[0].heldout_nrmse
    assert found.steps[-1].nrmse == pytest.approx(found.noise_nrmse, rel=0.1)


@pytest.mark.study
def test_pair_is_found(tmp_path):
    found = judge(tmp_path, "pair", {"wall-stiffness": {"k_w": 1300.0, "q": 1.0}, "sensor-highpass": {"tau_s": 0.6}},
                  31, repeats=2)
    assert found.verdict == "explained", found.sentence
    assert set(found.effects) == {"wall-stiffness", "sensor-highpass"}


@pytest.mark.study
def test_a_search_that_is_cut_short_names_nothing(tmp_path, capsys):
    """Two effects are hidden: after one round the verdict is undecided, with what was found by then and what was left
    out; with two effects hidden no single one leaves no misfit."""
    truth = json.loads((find_data() / "truth.json").read_text())["tumble-b"]["effects"]
    assert main(["discover", "tumble-b", "--effort", "1", "-o", str(tmp_path / "out"), "-q"]) == 0
    result = json.loads((tmp_path / "out" / "result.json").read_text())
    assert (result["verdict"], result["reason"], result["effects"]) == ("undecided", "effort", [])
    assert result["settings"]["rounds"] == 1 and result["settings"]["thresholds"]["effort"] == 1
    assert result["unsearched"] and result["confidence"] is None
    (one,) = result["dropped"]
    assert {one["effect"], *one["alternatives"]} & set(truth)
    told = capsys.readouterr().out
    assert "--effort" in told and one["effect"] in told


@pytest.mark.slow
@pytest.mark.parametrize("name", ["slip-d", pytest.param("impact-e", marks=pytest.mark.study)])
def test_one_round_is_enough_for_one_effect(name):
    """What needs no further search leaves none out."""
    found = discover(find_data() / name, settings=SelectionSettings(effort=1))
    truth = json.loads((find_data() / "truth.json").read_text())[name]["effects"]
    assert (found.verdict, set(found.effects), found.unsearched) == ("explained", set(truth), ())
    assert found.counts["rounds"] == 1


@pytest.mark.study
def test_end_stop_is_outside_the_catalogue(tmp_path):
    found = judge(tmp_path, "stop", {"x-end-stop": {"k": 1.5e5, "depth": 5.5e-3}}, 41, repeats=2)
    assert found.verdict in ("improved", "unexplained"), found.sentence
    place = found.where[0]
    assert place.variable == "depression"
    assert place.range[0] == pytest.approx(5.5e-3, rel=0.1)


@pytest.mark.slow
def test_result_has_every_field_and_predicts(tmp_path):
    import pandas as pd

    from ddetumble.selection.predict import predict

    found = discover(find_data() / "impact-e")
    found.save(tmp_path)
    result = json.loads((tmp_path / "result.json").read_text())
    truth = json.loads((find_data() / "truth.json").read_text())["impact-e"]
    assert result["verdict"] == "explained"
    assert result["effects"] == list(truth["effects"])
    for key in ("campaign", "family", "steps", "noise_nrmse", "candidates", "where", "parameters", "sentence"):
        assert key in result
    for key in ("p_value", "explains", "visible", "heldout_nrmse", "smallest_detectable", "indistinguishable_from"):
        assert all(key in c for c in result["candidates"])
    heldout = truth["heldout"][0]
    table = pd.DataFrame({"record": "a", **heldout["conditions"], "time": heldout["x"]})
    table.to_csv(tmp_path / "conditions.csv", index=False)
    predicted = predict(tmp_path, tmp_path / "conditions.csv")
    error = predicted["normal_force"].to_numpy() - [y[0] for y in heldout["y"]]
    noise = read_campaign(find_data() / "impact-e").uncertainty("normal_force").absolute
    assert (error**2).mean() ** 0.5 < 0.5 * noise


@pytest.mark.study
def test_an_effect_of_ones_own_explains_what_the_catalogue_lacks(tmp_path, capsys):
    """The story of README.md: the ten lines of docs/end_stop.py remove the misfit."""
    effect = f"{find_data().parent / 'docs' / 'end_stop.py'}:EndStop"
    truth = json.loads((find_data() / "truth.json").read_text())["impact-f"]["effects"]["x-end-stop"]
    assert main(["discover", str(find_data() / "impact-f"), "--effect", effect, "-o", str(tmp_path / "d")]) == 0
    found = json.loads((tmp_path / "d" / "result.json").read_text())
    assert found["verdict"] == "explained" and found["effects"] == ["end-stop"]
    for name in ("k", "depth"):
        e = found["parameters"][f"end-stop.{name}"]
        assert abs(e["estimate"] - truth[name]) < 4.0 * e["sd"]
    assert "end-stop" in capsys.readouterr().out.lower()
