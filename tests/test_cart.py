"""The study of a cart on soft pads, on a stand-in for its file that a second integrator makes."""

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp

from ddetumble import InputError, check_effect, discover
from docs import cart_study, pads


MASS, SPRING, LOSS, DEPTH, STOP = 0.5, 72.0, 0.15, 0.05, 300.0  # kg, N/m, s/m, m, N/m


def strike(thickness: float, speed: float) -> tuple[np.ndarray, np.ndarray]:
    """Force [N] every 10 ms from half a second before the touch: a spring with Hunt and Crossley's loss, and a stop."""
    def force(x, v):
        return np.maximum(SPRING * x * (1.0 + LOSS * v) + STOP * max(x - DEPTH - thickness, 0.0), 0.0) if x > 0 else 0.0

    found = solve_ivp(lambda t, y: [y[1], -force(*y) / MASS], (0.0, 0.8), [0.0, speed], max_step=1e-3, rtol=1e-8,
                      dense_output=True)
    time = np.arange(0.0, 0.6, 0.01) + 0.0037
    return time, np.array([force(*found.sol(t)) for t in time])


def make_table(step: float) -> pd.DataFrame:
    """Raw file of three runs with each of four pads, whose speeds differ by `step` [m/s] and by chance."""
    random, rows = np.random.default_rng(3), []
    for thickness in (0.004, 0.028, 0.04, 0.052):
        for run in range(1, 4):
            speed = 0.87 + step * (run - 2) + 0.02 * random.standard_normal()
            time, force = strike(thickness, speed)
            time, force = np.concatenate([np.arange(-1.2, 0.0, 0.01) + 0.0037, time]), np.pad(force, (120, 0))
            velocity = np.where(np.arange(len(time)) % 4 == 0, speed, np.nan)
            rows.append(pd.DataFrame({
                "thickness_mm": 1e3 * thickness, "run": f"Run {run}", "time_s": time + 3.0,
                "force_raw_N": -(force + 0.02 * random.standard_normal(len(time))) - 0.7, "velocity_m_s": velocity}))
    return pd.concat(rows, ignore_index=True)


@pytest.fixture(scope="module")
def table():
    return make_table(0.0)


@pytest.mark.parametrize("effect", pads.EFFECTS, ids=lambda effect: effect.id)
def test_effects_keep_their_contract(effect):
    conditions = {"approach_speed": (0.8, 0.9, 1.0), "pad_thickness": (0.004, 0.004, 0.02)}
    check_effect(effect, reference=pads.PadSpring(), conditions=conditions).require()


def test_conversion_finds_touch_zero_and_speed(table, tmp_path):
    table.to_csv(tmp_path / "force_time.csv", index=False)
    campaign = cart_study.convert_runs(cart_study.read_runs(tmp_path))
    assert len(campaign.records) == 12 and "4mm-1" in campaign.records.index
    for key, (_, run) in cart_study.read_runs(tmp_path).items():
        own = campaign.samples[campaign.samples["record"] == key]
        assert campaign.records["approach_speed"][key] == pytest.approx(run["velocity_m_s"].dropna().iloc[0], abs=1e-9)
        assert abs(own["normal_force"][own["time"] < -0.01]).max() < 0.1
        # It touches at time 0 of `strike`, whose first sample is at 3.7 ms.
        assert min(abs((own["time"] - 0.0037) % 0.01).min(), abs((0.0037 - own["time"]) % 0.01).min()) < 0.004


@pytest.mark.study
def test_the_loop_finds_the_stop(tmp_path):
    """With three speeds, one of which can be left out; with one it is undecided, and nothing is named."""
    make_table(0.12).to_csv(tmp_path / "force_time.csv", index=False)
    campaign = cart_study.convert_runs(cart_study.read_runs(tmp_path))
    thin = campaign.records["pad_thickness"] < cart_study.THIN
    found = discover(campaign.select(list(campaign.records.index[thin])), cart_study.MODEL, effects=pads.EFFECTS)
    assert found.effects[0] == "pad-bottom" and found.verdict in ("explained", "improved")
    assert abs(found.steps[-1].parameters["pad-bottom.k"].estimate / STOP - 1) < 0.1


def test_scatter_of_repeats(table, tmp_path):
    table.to_csv(tmp_path / "force_time.csv", index=False)
    campaign = cart_study.convert_runs(cart_study.read_runs(tmp_path))
    scatter = cart_study.measure_scatter(campaign.records, campaign.samples)
    assert list(scatter) == ["4 mm", "28 mm", "40 mm", "52 mm"] and all(0.005 < x < 0.1 for x in scatter.values())


@pytest.mark.parametrize(("change", "word"), [
    (lambda t: t.drop(columns="velocity_m_s"), "velocity_m_s"),
    (lambda t: t.assign(force_raw_N=t["force_raw_N"].where(t.index != 5)), "line 7"),
    (lambda t: t[t["thickness_mm"] > 10], "thin pad"),
])
def test_bad_files_are_one_sentence(table, tmp_path, capsys, change, word, monkeypatch):
    monkeypatch.setattr(cart_study, "discover", lambda *a, **k: None)
    change(table).to_csv(tmp_path / "force_time.csv", index=False)
    assert cart_study.main([str(tmp_path), "-o", str(tmp_path / "out")]) == 2
    told = capsys.readouterr().err
    assert word in told and "Traceback" not in told


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(InputError, match="force_time.csv"):
        cart_study.read_runs(tmp_path)
