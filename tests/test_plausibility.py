"""Plausibility of whole campaigns: shipped ones pass, and a unit that is wrong throughout is named."""

import dataclasses as dc
import json
import math

import numpy as np
import pandas as pd
import pytest

import ddetumble as dd
from ddetumble.measurement.plausibility import check_numbers, find_copies
from ddetumble.measurement.units import Uncertainty
from ddetumble.planning.plausibility import check_scenario
from ddetumble.planning.scenario_file import read_scenario


SHIPPED = [p for p in sorted(dd.find_data().iterdir()) if (p / "datapackage.json").is_file()
           and "family" in json.loads((p / "datapackage.json").read_text())]  # fmt: skip


def scale(campaign, column, factor, stated=""):
    """The campaign with one column in another unit than stated, and what its file states for it, if it does."""
    columns = {name: {n: dc.replace(one, stated=stated) if n.startswith(column) else one
                      for n, one in getattr(campaign, name).items()} for name in ("conditions", "channels")}
    if campaign.independent is not None and campaign.independent.name == column:
        columns["independent"] = dc.replace(campaign.independent, stated=stated)
    campaign = dc.replace(campaign, **columns)
    if column in campaign.conditions:
        return dc.replace(campaign, records=campaign.records.assign(**{column: campaign.records[column] * factor}))
    names = [name for name in campaign.samples if name.startswith(column)]
    return dc.replace(campaign, samples=campaign.samples.assign(**{n: campaign.samples[n] * factor for n in names}))


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.name)
def test_shipped_campaigns_are_plausible(path):
    campaign = dd.read_campaign(path)
    assert not dd.check_plausibility(campaign) and not find_copies(campaign)


@pytest.mark.parametrize("name", ["impact-b", "slip-a", "tumble-a", "oblique-a"])
def test_a_record_under_two_names(name):
    """A copy is found by its readings, whatever its condition; one with a reading less is none."""
    campaign = dd.read_campaign(dd.find_data() / name)
    first, *_, last = campaign.record_keys
    kept = campaign.samples[campaign.samples["record"] != last]
    copy = campaign.trace(first).assign(record=last)
    assert find_copies(dc.replace(campaign, samples=pd.concat([kept, copy[kept.columns]]))) == {last: first}
    copy.loc[len(copy) // 2, list(campaign.channels)] = np.nan
    assert find_copies(dc.replace(campaign, samples=pd.concat([kept, copy[kept.columns]]))) == {}


def test_gauges_that_read_a_few_steps_only_may_repeat_themselves():
    campaign = dd.read_campaign(dd.find_data() / "impact-b")
    (channel,) = campaign.channels
    coarse = campaign.samples.assign(**{channel: (campaign.samples[channel] > 1.0).astype(float)})
    first, *_, last = campaign.record_keys
    copy = coarse[coarse["record"] == first].assign(record=last)
    assert find_copies(dc.replace(campaign, samples=pd.concat([coarse[coarse["record"] != last], copy]))) == {}


@pytest.mark.parametrize(("name", "column", "actual", "stated", "factor"), [
    ("impact-e", "initial_pressure", "bar", "MPa", 10), ("impact-b", "initial_pressure", "bar", "MPa", 10),
    ("impact-b", "initial_pressure", "MPa", "bar", 0.1), ("impact-b", "initial_pressure", "kPa", "MPa", 1e3),
    ("impact-b", "approach_speed", "mm/s", "m/s", 1e3), ("impact-b", "approach_speed", "km/h", "m/s", 3.6),
    ("impact-b", "time", "ms", "s", 1e3), ("impact-b", "normal_force", "N", "kN", 1e3),
    ("impact-b", "normal_force", "N", "kgf", 9.80665), ("impact-e", "depression", "mm", "m", 1e3),
    ("impact-e", "depression", "m", "mm", 1e-3), ("slip-d", "slip_speed", "mm/s", "m/s", 1e3),
    ("slip-a", "normal_load", "kN", "N", 1e-3), ("slip-a", "tangential_force", "N", "kN", 1e3),
    ("impact-b", "initial_pressure", "psi", "MPa", 145.03774),
    ("impact-e", "initial_pressure", "psi", "Pa", 1.4503774e-4),
    ("slip-a", "internal_pressure", "psi", "MPa", 145.03774), ("slip-a", "internal_pressure", "kPa", "MPa", 1e3),
    ("slip-a", "internal_pressure", "bar", "MPa", 10), ("tumble-a", "angular_velocity", "deg/s", "rad/s", 57.29578),
])  # fmt: skip
def test_a_unit_wrong_throughout_is_named(name, column, actual, stated, factor):
    campaign = dd.read_campaign(dd.find_data() / name)
    for told in ("", stated):
        doubts = dd.check_plausibility(scale(campaign, column, factor, told))
        assert len(doubts) == 1 and (column, actual, stated) in doubts[0].mistakes
        assert not doubts[0].low <= doubts[0].value <= doubts[0].high
        assert not told or {one[2] for one in doubts[0].mistakes if one[0] == column} == {stated}


@pytest.mark.parametrize("name", [f"impact-{letter}" for letter in "abcefgh"])
@pytest.mark.parametrize(("actual", "stated", "factor"), [("psi", "kPa", 0.14503774), ("MPa", "bar", 0.1)])
def test_every_unit_that_agrees_is_named(name, actual, stated, factor):
    """Factors of 6.9 and of 10 are too near each other to be told apart for sure: the right one is always named, and
    the nearest comes first."""
    (doubt,) = dd.check_plausibility(scale(dd.read_campaign(dd.find_data() / name), "initial_pressure", factor))
    factors = {("psi", "kPa"): 6.894757, ("MPa", "bar"): 10.0}
    named = [mistake[1:] for mistake in doubt.mistakes if mistake[0] == "initial_pressure"]
    assert (actual, stated) in named and set(named) <= set(factors)
    assert doubt.variable == "stiffness over that of the gas"
    misses = [abs(math.log(doubt.value / factors[one])) for one in named]
    assert misses == sorted(misses)


@pytest.mark.parametrize(("actual", "stated", "factor"), [("psi", "MPa", 145.03774), ("kPa", "MPa", 1e3)])
def test_a_known_modulus_in_another_unit_is_named(actual, stated, factor):
    campaign = dd.read_campaign(dd.find_data() / "slip-a")
    modulus = campaign.known["elastic_modulus"]
    assert modulus is not None
    (doubt,) = dd.check_plausibility(dc.replace(campaign, known=campaign.known | {"elastic_modulus": factor * modulus}))
    assert doubt.variable == "elastic_modulus" and doubt.value == factor * modulus > doubt.high
    assert ("elastic_modulus", actual, stated) in doubt.mistakes


@pytest.mark.parametrize(("name", "value", "mistake"), [
    ("outer_diameter", 61.0, ("mm", "m")), ("effective_mass", 1300.0, ("g", "kg")), ("ambient_pressure", 1.013e8, None),
    ("tensile_strength", 10.0, ("MPa", "Pa"))])
def test_a_known_number_that_no_bench_has_is_asked_about(name, value, mistake):
    campaign = dd.read_campaign(dd.find_data() / "impact-b")
    (doubt,) = dd.check_plausibility(dc.replace(campaign, known=campaign.known | {name: value}))
    assert doubt.variable == name and doubt.value == value
    assert mistake is None or (name, *mistake) in doubt.mistakes


def test_a_question_names_only_units_that_the_file_states():
    """Bar under a heading in kPa, and newtons under one in kN: the stated unit of each column, and the right one."""
    campaign = dd.read_campaign(dd.find_data() / "impact-b")
    columns = {"normal_force": "N", "time": "s"} | dict.fromkeys(("initial_pressure",), "MPa")
    stated = {name: dc.replace(one, stated=columns.get(name, "m/s")) for name, one in campaign.conditions.items()}
    campaign = dc.replace(campaign, conditions=stated, channels={
        name: dc.replace(one, stated=columns.get(name, "mm")) for name, one in campaign.channels.items()})
    for column, factor, wrong, right in (("initial_pressure", 0.01, "kPa", "bar"), ("normal_force", 1e3, "kN", "N"),
                                         ("initial_pressure", 0.1, "hPa", "kPa")):
        (doubt,) = dd.check_plausibility(scale(campaign, column, factor, wrong))
        assert (column, right, wrong) in doubt.mistakes
        told = {name: one.stated for name, one in {**campaign.conditions, **campaign.channels}.items()}
        told |= {column: wrong, "time": "s"}
        assert all(told[name] == unit for name, _, unit in doubt.mistakes)


def test_what_no_single_unit_explains_is_asked_about_all_the_same():
    campaign = dd.read_campaign(dd.find_data() / "impact-b")
    doubts = dd.check_plausibility(scale(scale(campaign, "approach_speed", 2000), "time", 3000))
    assert {"approach_speed", "duration of the impact"} <= {doubt.variable for doubt in doubts}
    assert not any(doubt.mistakes for doubt in doubts)


@pytest.mark.parametrize("name, column, factor", [
    ("impact-b", "approach_speed", 100.0), ("impact-b", "initial_pressure", 1e-3), ("slip-a", "normal_load", 1e30)])
def test_a_slip_in_one_record_is_asked_about(name, column, factor):
    """One setting of one record that is out of all proportion: that record and no other is asked about, and no unit."""
    campaign = dd.read_campaign(name)
    records = campaign.records.copy()
    key = records.index[2]
    records.loc[key, column] *= factor
    (found,) = dd.check_plausibility(dc.replace(campaign, records=records))
    assert repr(key)[1:-1] in str(found) and not found.mistakes
    assert not found.low <= found.value <= found.high


@pytest.mark.slow
def test_a_fit_tells_of_it():
    campaign = dd.read_campaign(dd.find_data() / "impact-b")
    wrong = scale(campaign.select(campaign.record_keys[:4]), "initial_pressure", 10)
    sentence = str(dd.check_plausibility(wrong)[0])
    assert sentence in dd.fit(wrong, noise="stated").notes
    (doubt,) = check_numbers({"outer_diameter": 61.0, "restitution": 0.7})
    assert str(doubt) in dd.fit(campaign.select(campaign.record_keys[:2]), noise="stated",
                                fixed={"outer_diameter": 61.0}).notes


@pytest.mark.parametrize(("size", "asked"), [(40.0, True), (4.0, False), (0.04, False)])
def test_noise_that_is_larger_than_all_readings_is_asked_about(size, asked):
    """Readings that all lie within one deviation of their noise are no noise's."""
    campaign = dd.read_campaign(dd.find_data() / "slip-a")
    column = dc.replace(campaign.channels["tangential_force"], uncertainty=Uncertainty(size))
    doubts = dd.check_plausibility(dc.replace(campaign, channels={"tangential_force": column}))
    assert [one.variable for one in doubts] == ["tangential_force"] * asked
    assert np.ptp(campaign.samples["tangential_force"]) < 40.0


def test_an_orbit_may_turn_either_way():
    assert not check_numbers({"orbit_rate": -1.1e-3})
    (doubt,) = check_numbers({"orbit_rate": -0.06})
    assert doubt.variable == "orbit_rate"


BODY = 'schema = "ddetumble.plan/1"\n[debris]\nangular_velocity = [0.05, 0.02, 0.03]\n'


@pytest.mark.parametrize(("text", "keys"), [
    ('shape = "box"\nlengths = [0.1, 0.1, 0.3]\nmass = 4.0\n', []),
    ('shape = "box"\nlengths = [100.0, 100.0, 300.0]\nmass = 4.0\n', ["debris.lengths"]),
    ("mass = 0.01\n", ["debris.mass"]), ("mass = 1e6\n", ["debris.mass"]),
    ("inertia = [[1100.0, 0.0, 0.0], [0.0, 900.0, 0.0], [0.0, 0.0, 700.0]]\n", []),
    ("inertia = [[1000.0, 0.0, 0.0], [0.0, 5.0, 0.0], [0.0, 0.0, 1000.0]]\n", ["debris.inertia"]),
    ("[limits]\npressure = [10.0, 25.0]\n[arm]\nspeed = 200.0\n", ["limits.pressure", "arm.speed"]),
    ("[errors]\nrates = 5.0\nattitude_degrees = 57.0\n", ["errors.rates", "errors.attitude_degrees"]),
    ("[errors]\nrates = 0.1\nattitude_degrees = 20.0\nplace = 0.1\n", []),
    ("[errors]\nplace = 20.0\nspeed = 2.0\n", ["errors.speed", "errors.place"]),
])
def test_sizes_that_no_scenario_has(tmp_path, text, keys):
    """Of body, ball and arm: asked about by key, never refused."""
    (tmp_path / "case.toml").write_text(BODY + text)
    assert [one.variable for one in check_scenario(read_scenario(tmp_path / "case.toml"), tmp_path)] == keys


@pytest.mark.parametrize("path", sorted((dd.find_data() / "scenarios").glob("*.toml")), ids=lambda path: path.stem)
def test_shipped_scenarios_are_plausible(path):
    assert check_scenario(read_scenario(path), path.parent) == ()
