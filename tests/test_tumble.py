"""The loop on tumbling records: shipped campaigns judged blind, predictions, fits from afar, what cannot be read."""

import json

import numpy as np
import pandas as pd
import pytest

from ddetumble import InputError, compare, discover, find_data, fit, predict, read_campaign
from ddetumble.cli import main
from ddetumble.exam.simulators.campaigns import write_package
from ddetumble.exam.simulators.tumbling import RATES, simulate_tumbling
from ddetumble.exam.simulators.tumbling_campaigns import make_tumble_campaign
from ddetumble.families.starts import guess_body, straighten
from ddetumble.measurement.campaign import Campaign, Column, Uncertainty
from tests.helpers_tumble import NOISE, make_long


NAMES = ("tumble-a", "tumble-b", "tumble-c", "tumble-d")
TRUTH = json.loads((find_data() / "truth.json").read_text(encoding="utf-8"))


def name_truth(truth):
    """True values by the names of results."""
    values = dict(truth["base"])
    for effect, parameters in truth["effects"].items():
        for name, value in parameters.items():
            parts = {f".{k}": x for k, x in enumerate(value)} if isinstance(value, list) else {"": value}
            values |= {f"{effect}.{name}{part}": x for part, x in parts.items()}
    return values


def ask(truth):
    """Conditions of the records that nobody has fitted, and their rates without noise."""
    frames = []
    for k, record in enumerate(truth["heldout"]):
        start = {f"{rate}0": w for rate, w in zip(RATES, record["conditions"]["w0"], strict=True)}
        frames.append(pd.DataFrame({"record": f"h{k}", **start, "time": record["x"]}))
    return pd.concat(frames, ignore_index=True), np.concatenate([record["y"] for record in truth["heldout"]])


@pytest.fixture(scope="module", params=[NAMES[0], *(pytest.param(name, marks=pytest.mark.study) for name in NAMES[1:])])
def found(request):
    """A shipped campaign's name, and what discover says of it."""
    return request.param, discover(find_data() / request.param)


@pytest.mark.slow
def test_verdict(found):
    """What is hidden is named, or refused where no catalogue holds it; intervals hold the truth."""
    name, result = found
    effects = TRUTH[name]["effects"]
    if any(effect.startswith("x-") for effect in effects):
        assert result.verdict in ("unexplained", "improved")
        periods = [place.period for place in result.where if place.period]
        assert periods and periods[0] == pytest.approx(effects["x-sine-torque"]["period"], rel=0.03)
        return
    assert result.verdict == ("explained" if effects else "nothing-missing"), result.sentence
    assert set(result.effects) == set(effects)
    truth, last = name_truth(TRUTH[name]), result.steps[-1].parameters
    assert set(last) == set(truth)
    for key, estimate in last.items():
        assert abs(np.log(estimate.estimate / truth[key])) < 3.0 if key.endswith("I_d") else (
            abs(estimate.estimate - truth[key]) < 3.5 * estimate.sd), key


@pytest.mark.slow
def test_scale_cannot_be_seen(found):
    """Torque-free, the inertia ratio absorbs the scale factor exactly, and the result says so; an attitude shows it."""
    name, result = found
    scale = next(c for c in result.candidates if c.effect == "gyro-scale")
    if name == "tumble-c":
        assert scale.visible > 0.5
    else:
        assert scale.visible < 1e-6


@pytest.mark.slow
def test_prediction(found, tmp_path):
    """From other rates the grown model is well below the noise; the spread of a new measurement is the noise.

    A model that lacks a torque misses by more.
    """
    name, result = found
    result.save(tmp_path)
    conditions, wanted = ask(TRUTH[name])
    table = predict(tmp_path, conditions)
    error = table[list(RATES)].to_numpy() - wanted
    if result.verdict == "unexplained":
        assert np.sqrt(np.mean(error**2)) > NOISE
        return
    assert np.sqrt(np.mean(error**2)) < NOISE
    spread = np.maximum(table[[f"{rate}_sd" for rate in RATES]].to_numpy(), 1e-8)  # a start is exact
    assert np.sqrt(np.mean((error / spread) ** 2)) < 4.0
    assert (table[[f"{rate}_sd_new" for rate in RATES]].to_numpy() > 0.95 * NOISE).all()
    with pytest.raises(InputError, match="angular_velocity_y0.*rad/s"):
        predict(tmp_path, conditions.drop(columns="angular_velocity_y0"))
    with pytest.raises(InputError, match="cannot be negative"):
        predict(tmp_path, conditions.assign(time=conditions["time"] - 1.0))


@pytest.mark.study
def test_command_line(tmp_path, capsys):
    """discover writes result, model and report of a short campaign; compare says where the model stands."""
    made = make_tumble_campaign("short", 5, {"eddy-current": {"k_e": 4e-6}}, {"inertia_ratio": 0.5}, 3, duration=240.0)
    write_package(tmp_path / "short", made)
    assert main(["discover", str(tmp_path / "short"), "-o", str(tmp_path / "out")]) in (0, None)
    result = json.loads((tmp_path / "out" / "result.json").read_text(encoding="utf-8"))
    assert result["verdict"] == "explained" and result["effects"] == ["eddy-current"]
    assert result["steps"][0]["heldout_nrmse"] > 2.0 * result["steps"][1]["heldout_nrmse"]
    assert (tmp_path / "out" / "report.html").is_file()
    compared = compare(tmp_path / "short")
    assert compared.lack_of_fit.rejected
    capsys.readouterr()


AXES = {
    "drag": ({"quadratic-drag": {"k": 2e-4}}, 5, set()),
    "drag by axis": ({"quadratic-drag": {"k": 2e-4, "axial": 0.3}}, 6, {"quadratic-drag.axial"}),
    "currents by axis": ({"eddy-current": {"k_e": 1e-5, "axial": 0.4}}, 23, {"eddy-current.axial"}),
    "tilt about x": ({"axis-misalignment": {"angle": 0.0, "angle_x": 3e-3}}, 8, {"axis-misalignment.angle_x"}),
    "tilt about all": ({"axis-misalignment": {"angle": 2e-3, "angle_x": -3e-3, "angle_z": 2e-3}}, 9,
                       {"axis-misalignment.angle_x"}),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", AXES)
def test_axes_are_told_apart(name, tmp_path):
    """Drag is not taken for eddy currents; what is held is freed where the records tell it, and only there."""
    effects, seed, freed = AXES[name]
    write_package(tmp_path / "c", make_tumble_campaign("c", seed, effects, {"inertia_ratio": 0.5}, 3, duration=240.0))
    found = discover(tmp_path / "c")
    assert (found.verdict, found.effects) == ("explained", tuple(effects)), found.sentence
    last, (effect,) = found.steps[-1].parameters, effects
    assert {n for n in last if n.partition(".")[2] in ("axial", "angle_x", "angle_z")} == freed
    for key, true in name_truth({"base": {"inertia_ratio": 0.5}, "effects": effects}).items():
        if key in last:
            assert abs(last[key].estimate - true) < 3.5 * last[key].sd, key
    if name == "drag":
        assert last[f"{effect}.k"].q025 <= 2e-4 <= last[f"{effect}.k"].q975


@pytest.mark.study
@pytest.mark.parametrize(("more", "attitude"), [({}, True), ({"inertia-asymmetry": {"epsilon": 0.02}}, False)],
                         ids=["attitude", "asymmetry"])  # fmt: skip
def test_a_turn_about_the_axis_is_found_where_it_shows(more, attitude, tmp_path):
    """Beside a measured attitude, or with unlike transverse moments, the third angle is no phase."""
    tilt = {"angle": 2e-3, "angle_x": -3e-3, "angle_z": 0.02}
    effects = {"axis-misalignment": tilt, **more}
    made = make_tumble_campaign("c", 9, effects, {"inertia_ratio": 0.5}, 3, duration=240.0, attitude=attitude)
    write_package(tmp_path / "c", made)
    found = discover(tmp_path / "c")
    assert found.verdict == "explained" and set(found.effects) == set(effects), found.sentence
    for name, true in tilt.items():
        estimate = found.steps[-1].parameters[f"axis-misalignment.{name}"]
        assert abs(estimate.estimate - true) < 3.5 * estimate.sd < 1e-3, name


@pytest.mark.slow
@pytest.mark.parametrize(("k_e", "told"), [(1e-5, True), (6e-7, False)])
def test_eddy_currents_beside_drag(k_e, told, tmp_path):
    """Where the rates fall clearly, drag is no rival of eddy currents; where they hardly fall, both are named."""
    made = make_tumble_campaign("c", 13, {"eddy-current": {"k_e": k_e}}, {"inertia_ratio": 0.5}, 3, duration=240.0)
    write_package(tmp_path / "c", made)
    found = discover(tmp_path / "c")
    named = {*found.effects, *(a["effect"] for step in found.steps for a in step.alternatives)}
    assert found.verdict == "explained" and len(found.effects) == 1 and "eddy-current" in named, found.sentence
    assert ("quadratic-drag" in named) != told


@pytest.mark.study
@pytest.mark.parametrize("share", [0.8, 1.2])
def test_fit_from_afar(share):
    """2000 s at 10 Hz, begun with a ratio that is 20 % off: dozens of turns out of step, and yet found."""
    found = fit(make_long(2, 2000.0, 0.1), start={"inertia_ratio": 0.55 * share})
    ratio = found.parameters["inertia_ratio"]
    assert found.converged and abs(ratio.estimate - 0.55) < 4.0 * ratio.sd < 1e-5
    assert found.chi2_reduced == pytest.approx(1.0, abs=0.05)
    start = found.nuisances["r0"]["angular_velocity_x0"]
    assert 0 < start["sd"] < NOISE and "pull" not in start


def test_guesses():
    """Euler's equations over a radian give the ratio to a per cent, whatever the sampling; quaternions keep a sign."""
    for duration, interval, ratio in ((600.0, 2.0, 0.3), (300.0, 1.0, 1.0), (300.0, 5.0, 1.6)):
        assert guess_body(make_long(3, duration, interval, ratio)) == pytest.approx(ratio, abs=0.02)
    turning = np.stack([np.cos(t := np.linspace(0, 8, 50)), np.sin(t), 0 * t, 0 * t], axis=1)
    torn = turning * np.where(np.arange(50) % 3, 1.0, -1.0)[:, None]
    torn[7] = np.nan
    assert np.array_equal(straighten(torn)[8:], turning[8:]) and np.isnan(straighten(torn)[7]).all()


@pytest.fixture
def folder(tmp_path):
    """A small campaign on disk, to be spoilt."""
    made = make_tumble_campaign("small", 3, {}, {"inertia_ratio": 0.5}, 2, duration=40.0)
    write_package(tmp_path / "small", made)
    return tmp_path / "small"


def spoil(folder, change):
    """Change the samples of a campaign: a function from one table to another."""
    table = change(pd.read_csv(folder / "samples.csv", dtype=str))
    table.to_csv(folder / "samples.csv", index=False)
    descriptor = json.loads((folder / "datapackage.json").read_text(encoding="utf-8"))
    for resource in descriptor["resources"]:
        if resource["name"] == "samples":
            fields = resource["schema"]["fields"]
            resource["schema"]["fields"] = [field for field in fields if field["name"] in table]
    (folder / "datapackage.json").write_text(json.dumps(descriptor), encoding="utf-8")


def put(table, row, column, value):
    """The table with one cell replaced."""
    table.loc[row, column] = value
    return table


@pytest.mark.parametrize(("change", "words"), [
    (lambda t: t.drop(columns="angular_velocity_y"), ("angular_velocity_y",)),
    (lambda t: put(t, 4, "angular_velocity_x", "nan"), ("samples.csv", "angular_velocity_x", "6")),
    (lambda t: put(t, 4, "time", "2"), ("samples.csv", "time", "6")),
    (lambda t: t.assign(angular_velocity_z=t["angular_velocity_z"].where(t["record"] == "r01", "")),
     ("r02", "angular_velocity_z")),
    (lambda t: t.assign(time=(t["time"].astype(float) - 5.0).astype(str)), ("r01", "t = 0", "time")),
    (lambda t: t.assign(time=(t["time"].astype(float) + 5000.0).astype(str)), ("r01", "subtract 5000 s", "time")),
], ids=["no rate", "nan", "time goes back", "empty rate", "before zero", "clock time"])  # fmt: skip
def test_bad_input(folder, change, words):
    """One sentence that names file, column and row or record."""
    spoil(folder, change)
    with pytest.raises(InputError) as error:
        fit(folder)
    for word in words:
        assert word in str(error.value), str(error.value)


def test_what_an_effect_lacks(folder):
    """Gravity gradient without an orbit rate, half an attitude, an effect of another family."""
    descriptor = json.loads((folder / "datapackage.json").read_text(encoding="utf-8"))
    del descriptor["known"]["orbit_rate"]
    (folder / "datapackage.json").write_text(json.dumps(descriptor), encoding="utf-8")
    with pytest.raises(InputError, match="gravity-gradient.*orbit_rate"):
        fit(folder, effects=["gravity-gradient"])
    with pytest.raises(InputError, match="wall-stiffness"):
        fit(folder, effects=["wall-stiffness"])
    with pytest.raises(InputError, match="rigid-body"):
        fit(folder, model="matunaga")
    campaign = read_campaign(folder)
    half = campaign.samples.assign(attitude_w=1.0, attitude_x=0.0)
    columns = {name: Column(name, "1", Uncertainty(1e-3)) for name in ("attitude_w", "attitude_x")}
    spoilt = Campaign(**{**vars(campaign), "samples": half, "channels": campaign.channels | columns})
    with pytest.raises(InputError, match="attitude_y"):
        fit(spoilt)


@pytest.mark.study
def test_missing_samples_and_attitude(folder, tmp_path):
    """Gaps are left out; with an attitude of any sign that starts anywhere, the scale factor is found."""
    made = make_tumble_campaign("turned", 4, {"gyro-scale": {"g": 2e-3}}, {"inertia_ratio": 0.5}, 3, duration=200.0,
                                attitude=True)
    for row in made.records:
        row.values[10:13, :3] = np.nan
        row.values[20:, 3:] *= -1.0
    write_package(tmp_path / "turned", made)
    text = (tmp_path / "turned" / "samples.csv").read_text(encoding="utf-8").replace("nan", "")
    (tmp_path / "turned" / "samples.csv").write_text(text, encoding="utf-8")
    found = fit(tmp_path / "turned", effects=["gyro-scale"])
    g = found.parameters["gyro-scale.g"]
    assert abs(g.estimate - 2e-3) < 4.0 * g.sd < 1e-3
    assert found.chi2_reduced == pytest.approx(1.0, abs=0.1)
    expected, _ = simulate_tumbling({"inertia_ratio": 0.5}, {"gyro-scale": {"g": 2e-3}}, [0.05, 0.0, 0.08], [0.0, 50.0])
    found.save(tmp_path / "fit")
    start = {"angular_velocity_x0": 0.05, "angular_velocity_y0": 0.0, "angular_velocity_z0": 0.08}
    table = predict(tmp_path / "fit", pd.DataFrame({"record": "p", **start, "time": [0.0, 50.0]}))
    assert np.abs(table[list(RATES)].to_numpy() - expected).max() < 5e-5
    assert table["attitude_w"].iloc[0] == 1.0
