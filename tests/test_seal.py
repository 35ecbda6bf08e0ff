"""The study of a real seal, on a stand-in for its files: conversion and loop find what was put in."""

import json

import numpy as np
import pandas as pd
import pytest

from ddetumble import InputError, check_effect, read_campaign
from docs import seal, seal_study


pytestmark = pytest.mark.study  # one study is in nearly all of them


TRUTH = {"area_factor": 1.004, "adhesive-offset.f_a": 4.0, "seal-load.mu": 0.01, "seal-lag.a": 8.0, "seal-lag.b": 0.02,
         "seal-lag.s_0": 0.8e-3, "thrust-offset.F_0": 1.3}  # fmt: skip
NOISE = 0.1  # N


def make_run(bar: float, random: np.random.Generator, level: float = 0.0) -> pd.DataFrame:
    """A run of six strokes of 40 mm at 100 Hz, with a pressure that follows the direction [units of the file]."""
    speeds = np.where(np.arange(6) % 2 == 0, 13.0 - bar, 14.0)
    t = np.arange(0.0, np.sum(40.0 / speeds), 0.01)
    ends = np.concatenate([[0.0], np.cumsum(40.0 / speeds)])
    stroke = np.clip(np.searchsorted(ends, t, side="right") - 1, 0, 5)
    way = np.where(stroke % 2 == 0, 1.0, -1.0)
    slip = (t - ends[stroke]) * speeds[stroke]
    pressure = bar + 0.04 * way
    load = pressure * 1e5 * seal_study.AREA
    friction = TRUTH["adhesive-offset.f_a"] + TRUTH["seal-load.mu"] * load
    lag = (TRUTH["seal-lag.a"] + TRUTH["seal-lag.b"] * load) * np.exp(-slip * 1e-3 / TRUTH["seal-lag.s_0"])
    force = TRUTH["area_factor"] * load + TRUTH["thrust-offset.F_0"] + level + way * (friction - lag)
    return pd.DataFrame({"time_s": t, "position_mm": np.where(way > 0, slip, 40.0 - slip), "pressure_bar": pressure,
                         "force_N": force + NOISE * random.standard_normal(len(t))})


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    where, random = tmp_path_factory.mktemp("rig"), np.random.default_rng(6)
    bars = (1, 3, 5, 7)
    pd.concat([make_run(bar, random).assign(seal="O-ring257", set_bar=bar) for bar in bars]).to_csv(
        where / "friction.csv", index=False)
    np.savez(where / "repeats.npz", **{f"rerun__1_O-ring257_{bar}bar": make_run(bar, random, level=2.0).to_numpy()
                                       for bar in bars})
    return where


@pytest.fixture(scope="module")
def study(folder):
    return seal_study.run_study(folder, campaign=folder / "campaign")


@pytest.mark.parametrize("effect", seal.EFFECTS, ids=lambda effect: effect.id)
def test_effects_keep_their_contract(effect):
    check_effect(effect, reference=seal.PressureThrust()).require()


def test_conversion(study, folder):
    campaign = read_campaign(folder / "campaign")
    assert (campaign.family, len(campaign.records)) == ("slip", 20)  # the first stroke's turn is not there
    assert np.unique(np.round(campaign.records["internal_pressure"] / 1e5, 3)).tolist() == [2.013, 4.013, 6.013, 8.013]
    trace, load = campaign.trace("5bar-03-in"), campaign.records["normal_load"]["5bar-03-in"]
    late = trace[trace["slip"] > 0.01]
    expected = (TRUTH["area_factor"] + TRUTH["seal-load.mu"]) * load + TRUTH["adhesive-offset.f_a"] + 1.3
    assert late["tangential_force"].mean() == pytest.approx(expected, abs=0.06)  # at the set pressure
    assert np.allclose(np.diff(trace["time"]), seal_study.INTERVAL)
    assert campaign.records["slip_speed"]["5bar-03-in"] == pytest.approx(8e-3, rel=0.02)


def test_loop_recovers_what_was_put_in(study):
    last, first = study.rungs[-1], study.rungs[0]
    assert set(last.effects) == {"adhesive-offset", "seal-load", "thrust-offset", "seal-lag"}
    for name, value in TRUTH.items():
        assert last.parameters[name][0] == pytest.approx(value, rel=0.06), name
    errors = [rung.held_out["all"] for rung in study.rungs]
    assert all(a > b for a, b in zip(errors[:-1], errors[1:], strict=True))
    assert first.held_out["all"] > 5.0 and last.held_out["all"] < 1.2 * NOISE
    # `discover` may stop before the weakest of the four, which is a hundredth of the others' misfit.
    assert {"adhesive-offset", "seal-lag"} <= set(study.found.effects) <= set(last.effects)
    assert study.found.verdict in ("explained", "improved")


def test_repeated_run_is_off_by_its_level(study):
    found = study.repeats["rerun 1"]
    assert found["model"] == pytest.approx(2.0, abs=0.1)
    assert found["thrust"] == pytest.approx(2.0, abs=0.1) and found["friction"] < 0.1


def test_files(study, tmp_path):
    seal_study.write_study(study, "O-ring257", tmp_path / "out")
    names = sorted(path.name for path in (tmp_path / "out").iterdir())
    assert names == ["README.md", "errors.png", "loops.png", "result.json"]
    text = (tmp_path / "out" / "result.json").read_text(encoding="utf-8")
    assert len(text) < 100_000 and seal_study.MODEL not in text
    result = json.loads(text)
    assert [len(rung["effects"]) for rung in result["ladder"]] == [0, 1, 2, 3, 4]
    page = (tmp_path / "out" / "README.md").read_text(encoding="utf-8")
    assert "What is left unexplained" in page and seal_study.MODEL not in page


def test_bad_folder_says_what_is_missing(folder, tmp_path, capsys):
    assert seal_study.main([str(tmp_path), "-o", str(tmp_path / "out")]) == 2
    assert "name the folder that holds friction.csv" in capsys.readouterr().err
    table = pd.read_csv(folder / "friction.csv", dtype=str)
    table.drop(columns="pressure_bar").to_csv(tmp_path / "friction.csv", index=False)
    with pytest.raises(InputError, match="column pressure_bar: there is no such column"):
        seal_study.read_runs(tmp_path, "O-ring257")
    table.loc[3, "force_N"] = "n/a"
    table.to_csv(tmp_path / "friction.csv", index=False)
    with pytest.raises(InputError, match="line 5, column force_N: is no number"):
        seal_study.read_runs(tmp_path, "O-ring257")
    with pytest.raises(InputError, match="there is no seal 'K'; the file has O-ring257"):
        seal_study.read_runs(folder, "K")
