"""Contact onsets of independently simulated tests: unbiased, with honest errors of their own and in common."""

import numpy as np
import pytest
from helpers_measurement import pulse, raw_text, raw_trace
from scipy import signal

import ddetumble as dd
from ddetumble.exam.simulators.campaigns import write_package
from ddetumble.exam.simulators.impact import Impact, simulate
from ddetumble.exam.simulators.impact_campaigns import make_campaign
from ddetumble.measurement.alignment import find_offset
from ddetumble.measurement.onset import find_onsets


LEAD = 0.02  # s, the true onset
BASE = {"effective_mass": 1.2, "restitution": 0.8, "outer_diameter": 0.06}


def draw_tests(count, *, noise=0.25, interval=1e-4, effects=None, ringing=None, seed=1):
    """Times and forces of tests at random pressures and speeds, all touching at LEAD."""
    generator, times, forces = np.random.default_rng(seed), [], []
    for _ in range(count):
        pressure, speed = generator.uniform(0.8e6, 2.5e6), generator.uniform(0.2, 0.6)
        conditions = {"initial_pressure": pressure, "approach_speed": speed}
        length = Impact(BASE, effects or {}, conditions).guess_contact_time()
        t = np.arange(generator.uniform(0, interval), LEAD + 1.45 * length, interval)
        if ringing is None:
            f = simulate(BASE, effects or {}, conditions, t - LEAD)[:, 0]
        else:  # a second-order gauge, from the force on a finer grid
            frequency, damping = ringing
            fine, w = np.arange(0.0, t[-1] + 1e-3, 2e-5), 2 * np.pi * frequency
            force = simulate(BASE, effects or {}, conditions, fine - LEAD)[:, 0]
            f = np.interp(t, fine, signal.lsim(([w * w], [1, 2 * damping * w, w * w]), force, fine)[1])
        times.append(t)
        forces.append(f + noise * generator.standard_normal(t.size))
    return times, forces


def judge(found):
    """Errors [s] and their stated deviations, own and common."""
    return found.time - LEAD, found.sd, found.common_sd


@pytest.mark.parametrize(("noise", "interval", "seed"), [(0.25, 1e-4, 1), (0.25, 2.5e-4, 2), (1.0, 2.5e-4, 3)])
def test_clean_onsets(noise, interval, seed):
    errors, own, common = judge(find_onsets(*draw_tests(24, noise=noise, interval=interval, seed=seed)))
    assert abs(errors.mean()) < 0.3 * common
    assert abs(errors.mean()) < 4 * np.sqrt(np.mean(own**2) / len(own))  # no bias beyond chance
    assert 0.3 < np.mean((errors / own) ** 2) < 2.5


@pytest.mark.slow
def test_two_hundred_onsets():
    errors, own, common = judge(find_onsets(*draw_tests(200)))
    assert abs(errors.mean()) < 0.02e-3 < 0.1 * common
    assert np.median(own) < 0.06e-3 and 0.5 < np.mean((errors / own) ** 2) < 1.5


@pytest.mark.parametrize(("ringing", "count"), [((130, 0.06), 3), ((130, 0.06), 8), ((300, 0.05), 8), ((80, 0.1), 8)])
def test_a_gauge_that_rings(ringing, count):
    found = find_onsets(*draw_tests(count, ringing=ringing))
    errors, own, common = judge(found)
    assert found.ringing is not None and found.ringing[0] == pytest.approx(ringing[0], rel=0.15)
    assert np.max(np.abs(errors) / np.hypot(own, common)) < 2
    assert common < 0.3e-3


@pytest.mark.parametrize(("effects", "start"), [
    ({"wall-stiffness": {"k_w": 1500.0, "q": 1.0}}, "sloped"), ({"wall-stiffness": {"k_w": 2e4, "q": 1.5}}, "curved"),
    ({"viscoelastic-wall": {"k_v": 2000.0, "tau": 0.005}}, "sloped"), ({"viscous-dashpot": {"c_v": 3.0}}, "stepped"),
    ({"polytropic-gas": {"n": 1.5}}, "curved"), ({"membrane-area": {"alpha": 0.4}}, "curved")])  # fmt: skip
def test_other_beginnings(effects, start):
    found = find_onsets(*draw_tests(16, effects=effects))
    errors, own, common = judge(found)
    assert found.start == start and found.ringing is None
    assert abs(errors.mean()) < 2 * common and common < 0.4e-3
    assert np.mean(((errors - errors.mean()) / own) ** 2) < 3


@pytest.mark.parametrize("noise", [0.05, 0.25, 1.0])
def test_a_trace_alone(noise):
    """A pulse of another shape, each trace on its own: what cannot be told of the shape is in the common error."""
    scores = []
    for seed in range(12):
        onset = 0.0123 + 1e-5 * (seed % 10)
        found = find_onsets(*([x] for x in raw_trace(onset=onset, noise=noise, seed=seed)))
        scores.append((found.time[0] - onset) / np.hypot(found.sd[0], found.common_sd))
    assert abs(np.mean(scores)) < 1 and np.max(np.abs(scores)) < 3


def test_onset_of_a_rise_that_begins_with_a_slope():
    time = np.arange(600) / 10e3
    force = 50 * np.sin(np.pi * np.clip((time - 0.0123) / 0.016, 0, 1))
    found = find_onsets([time], [force + 0.05 * np.random.default_rng(0).standard_normal(600)])
    assert abs(found.time[0] - 0.0123) < 3 * np.hypot(found.sd[0], found.common_sd) < 2e-3


def test_onset_says_if_it_cannot():
    time = np.arange(600) / 10e3
    noise = np.random.default_rng(0).standard_normal(600)
    for force in (noise, pulse(time, -0.001, 50) + 0.1 * noise, pulse(time, 0.0123, 50, 1e-4), np.zeros(600)):
        with pytest.raises(dd.InputError, match="--onset"):
            find_onsets([time], [force])


def write_raw(folder, seed, **options):
    """A laboratory's files of a simulated campaign, whose clock starts LEAD before contact; the table of conditions."""
    folder.mkdir()
    campaign = make_campaign("x", seed, options.pop("effects", {}), BASE, (1e6, 1.6e6, 2.4e6), (0.3, 0.45),
                             interval=2.5e-4, before=LEAD, uncertainties={"time": 1e-12}, **options)
    rows = ["file,p0 [MPa],v [m/s],sequence"]
    for record in campaign.records:
        name, written = f"{record.label}.csv", record.written
        columns = [record.along["time"] + LEAD, record.values[:, 0] + 1.7]
        (folder / name).write_text(raw_text(columns, ["t [s]", "Fz [N]"]))
        rows.append(f"{name},{written['initial_pressure'] / 1e6:.6f},{written['approach_speed']:.6f},"
                    f"{written['sequence']}")
    (folder / "settings.csv").write_text("\n".join(rows) + "\n")
    return folder / "settings.csv"


def import_raw(folder, table):
    """The campaign of `write_raw`, by a glob that holds the table of conditions too."""
    found = dd.import_tests(sorted(folder.glob("*.csv")), conditions=table, known="outer_diameter=60 mm",
                            uncertainty=["p0=0.5 %", "speed=0.3 %"])
    return dd.write_campaign(folder / "campaign", found)


@pytest.mark.study
@pytest.mark.parametrize(("noise", "seed"), [(0.05, 1), (0.25, 2)])
def test_nothing_is_missing_in_an_imported_null(tmp_path, noise, seed):
    campaign = import_raw(tmp_path / "raw", write_raw(tmp_path / "raw", seed, noise={"normal_force": noise}))
    found = dd.discover(campaign)
    assert (found.verdict, found.effects) == ("nothing-missing", ())
    shift = found.steps[0].parameters["time_shift"]
    assert abs(shift.estimate) < campaign.column("time").common.absolute


@pytest.fixture(scope="module")
def late(tmp_path_factory):
    """A campaign whose time origins all are 0.15 ms late, and which states what they share."""
    folder = tmp_path_factory.mktemp("late")
    campaign = make_campaign("late", 5, {}, BASE, (1e6, 1.6e6, 2.4e6), (0.3, 0.45), uncertainties={"time": 2e-5})
    for record in campaign.records:
        record.along["time"] -= 0.15e-3
    write_package(folder, campaign)
    path = folder / "datapackage.json"
    stated = '"uncertainty": "0.02 ms"'
    path.write_text(path.read_text().replace(stated, f'{stated}, "common_uncertainty": "0.2 ms"'))
    return dd.read_campaign(folder)


def test_a_common_error_is_read_and_written(late, tmp_path):
    assert late.column("time").common.absolute == pytest.approx(2e-4)
    again = dd.write_campaign(tmp_path / "again", late)
    assert again.column("time").common == late.column("time").common
    assert again.column("normal_force").common is None


@pytest.mark.study
def test_a_common_shift_is_one_nuisance_of_the_campaign(late, tmp_path):
    fitted = dd.fit(late)
    shift = fitted.parameters["time_shift"]
    assert shift.unit == "s" and abs(shift.estimate + 0.15e-3) < 4 * shift.sd < 0.1e-3
    assert fitted.parameters["effective_mass"].estimate == pytest.approx(1.2, rel=5e-3)
    assert fitted.chi2_reduced < 1.2
    fitted.save(tmp_path / "fit")
    conditions = "record,time,initial_pressure,approach_speed,sequence\n" + "".join(
        f"a,{t},1.5e6,0.4,1\n" for t in (0.005, 0.01))
    (tmp_path / "conditions.csv").write_text(conditions)
    predicted = dd.predict(tmp_path / "fit", tmp_path / "conditions.csv")  # whose times count from contact itself
    true = simulate(BASE, {}, {"initial_pressure": 1.5e6, "approach_speed": 0.4}, np.array([0.005, 0.01]))[:, 0]
    np.testing.assert_allclose(predicted["normal_force"], true, atol=0.15)
    held = dd.fit(late, nuisances=False)
    assert "time_shift" not in held.parameters and held.chi2_reduced > fitted.chi2_reduced


@pytest.mark.slow
def test_a_sensor_lag_cannot_be_told_from_a_common_shift(late):
    lag = dd.fit(late, effects=["sensor-lag"]).parameters["sensor-lag.T"]
    assert lag.sd > 0.5e-4 and lag.q025 < 1e-4


@pytest.mark.parametrize("count", [5, 8, 40])
def test_noise_alone_is_no_offset(count):
    """However few readings there are before contact, noise passes for an offset as seldom as three deviations; a true
    one of ten is found.
    """
    noise = np.random.default_rng(6).standard_normal((20000, count))
    taken = sum(find_offset(quiet) != 0.0 for quiet in noise)
    expected = 20000 * 0.0027
    assert abs(taken - expected) < 4.0 * np.sqrt(expected)
    assert np.mean([find_offset(quiet + 10.0) for quiet in noise[:500]]) == pytest.approx(10.0, abs=0.1)
