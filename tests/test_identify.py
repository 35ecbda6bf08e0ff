"""Force from measured depression and pressure: within its own uncertainty of gauge and truth, and honest where not."""

import dataclasses as dc

import numpy as np
import pytest

from ddetumble._errors import InputError
from ddetumble.cli import main
from ddetumble.exam.simulators.campaigns import write_package
from ddetumble.exam.simulators.impact import simulate
from ddetumble.exam.simulators.impact_campaigns import make_campaign
from ddetumble.exam.simulators.noise import draw_noise
from ddetumble.inference.noise import Noise
from ddetumble.measurement.package import read_campaign
from ddetumble.reconstruct.force import identify
from ddetumble.reconstruct.smoothing import find_separation, smooth_samples


BASE = {"effective_mass": 1.3, "restitution": 0.72}
ALL = ("normal_force", "depression", "pressure")


def make(folder, seed, effects=None, base=BASE, **options):
    """Simulate a campaign of twelve records and write it; returns both."""
    made = make_campaign("made", seed, effects or {}, base, (4e5, 1e6, 2.3e6), (0.2, 0.5), 2, channels=ALL, **options)
    write_package(folder, made)
    return made, read_campaign(folder)


def measure_truth(made, found):
    """Error of the identified force over its stated deviation, where the ball touches."""
    errors = []
    for row in made.records:
        times = row.along["time"] - row.shift
        truth = simulate(made.base, made.effects, row.true, times, rtol=1e-9)[:, 0]
        own = found.table[found.table.record == row.label]
        inside = (own.normal_force_sd.to_numpy() > 0) & (truth > 0.5)
        errors.append(((own.normal_force - truth) / own.normal_force_sd).to_numpy()[inside])
    return np.concatenate(errors)


CASES = {
    "plain": {},
    "another restitution": {"base": {"effective_mass": 0.9, "restitution": 0.55}},
    "gas leak": {"effects": {"gas-leak": {"lambda": 6.0}}},
    "polytropic": {"effects": {"polytropic-gas": {"n": 1.3}}},
    "slow": {"interval": 1e-3},
    "coarse": {"noise": {"normal_force": 0.5, "depression": 1e-4, "pressure": 1e4}},
    "fine": {"noise": {"normal_force": 0.1, "depression": 4e-6, "pressure": 4e2}},
    "correlated": {"rho": 0.8},
}


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_within_uncertainty(case, tmp_path):
    """Where depression and pressure tell everything, the force agrees with gauge and truth as its deviation says."""
    made, campaign = make(tmp_path, 7, **({"interval": 5e-4} | CASES[case]))
    found = identify(campaign)
    assert 0.9 < found.rms_z < 1.12 and 0.93 < found.coverage < 0.975, str(found)
    z = measure_truth(made, found)
    assert 0.6 < np.sqrt(np.mean(z**2)) < 1.3 and np.mean(np.abs(z) < 1.96) > 0.9
    assert abs(found.restitution - made.base["restitution"]) < 3.5 * found.restitution_sd < 0.02
    assert found.notes == () and "agrees" in found.sentence and len(found.table) == len(campaign.samples)
    assert (found.table["normal_force_sd"] >= 0).all()


@pytest.mark.slow
def test_missing_force(tmp_path):
    """A wall that carries load beside the gas: the force is not in depression and pressure, and that is said."""
    _, campaign = make(tmp_path, 3, {"wall-stiffness": {"k_w": 1500.0, "q": 1.0}}, interval=5e-4)
    found = identify(campaign)
    assert found.rms_z > 3 and "differs from the gauge" in found.sentence and "is incomplete" in found.notes[0]


@pytest.mark.study
def test_gauge_unused(tmp_path, capsys):
    """The force does not depend on the gauge; without one or without pressure it is found all the same, in words."""
    _, campaign = make(tmp_path / "campaign", 5, interval=5e-4)
    whole = identify(campaign)
    channels = {k: v for k, v in campaign.channels.items() if k != "normal_force"}
    blind = dc.replace(campaign, channels=channels, samples=campaign.samples.drop(columns="normal_force"))
    found = identify(blind)
    np.testing.assert_array_equal(found.table["normal_force"], whole.table["normal_force"])
    assert list(found.table.columns) == ["record", "time", "normal_force", "normal_force_sd"]
    assert "no force gauge" in str(found)
    channels = {k: v for k, v in campaign.channels.items() if k != "pressure"}
    bare = identify(dc.replace(campaign, channels=channels, samples=campaign.samples.drop(columns="pressure")))
    assert 0.88 < bare.rms_z < 1.12 and "no channel `pressure`" in bare.notes[0]
    known = identify(dc.replace(campaign, known={**campaign.known, "restitution": 0.72}))
    assert known.restitution_sd == 0 and known.restitution == pytest.approx(0.72) and "known" in known.source
    assert 0.9 < known.rms_z < 1.12
    assert main(["identify", str(tmp_path / "campaign"), "-o", str(tmp_path / "out.csv")]) == 0
    assert "agrees with the gauge" in capsys.readouterr().out
    head = (tmp_path / "out.csv").read_text().splitlines()[0]
    assert head == "record,time,normal_force,normal_force_sd,gauge,difference,z"


def test_refused(tmp_path, capsys):
    """Without depression there is nothing to identify from."""
    made = make_campaign("made", 1, {}, BASE, (5e5, 1e6), (0.3,), 2, interval=1e-3)
    write_package(tmp_path, made)
    campaign = read_campaign(tmp_path)
    with pytest.raises(InputError, match="no channel 'depression'"):
        identify(campaign)
    with pytest.raises(InputError, match="no model"):
        identify(campaign, "no-such-model")
    assert main(["identify", str(tmp_path)]) == 2
    assert "depression" in capsys.readouterr().err
    _, campaign = make(tmp_path / "few", 2, interval=5e-3)
    with pytest.raises(InputError, match="needs at least 8"):
        identify(campaign)
    with pytest.raises(InputError, match="no gas"):
        identify(campaign, "power-law")


@pytest.mark.slow
@pytest.mark.parametrize("rho", [0.0, 0.85])
def test_smoothing(rho):
    """The curve, and its derivative, lie within their stated deviations of the truth; the size of the noise counts."""
    generator = np.random.Generator(np.random.PCG64(2))
    noise = Noise(0.02, rho, 0.0, 0.01, 0.02, 0.0, "")
    time = np.arange(1, 100) * 0.01
    values, slopes = [], []
    for _ in range(60):
        smooth = smooth_samples(time, np.sin(np.pi * time) + draw_noise(generator, 99, 0.02, rho), noise, 0.0, 1.0)
        for found, derivative, truth in ((values, 0, np.sin(np.pi * time)), (slopes, 1, np.pi * np.cos(np.pi * time))):
            rows = smooth.columns(time, derivative)
            sd = np.sqrt(np.sum((rows @ smooth.covariance) * rows, axis=1))
            found.append((rows @ smooth.coefficients - truth) / sd)
    assert 0.75 < np.sqrt(np.mean(np.square(values))) < 1.15 and 0.6 < np.sqrt(np.mean(np.square(slopes))) < 1.15


def test_separation():
    """The end of a contact, to a fraction of a sample; the last sample where the ball still touches."""
    generator = np.random.Generator(np.random.PCG64(3))
    time = np.arange(1, 120) * 5e-4
    depth = 4e-3 * np.maximum(np.sin(np.pi * np.minimum(time / 0.04321, 1.0)), 0.0)
    for _ in range(20):
        assert abs(find_separation(time, depth + 2e-5 * generator.standard_normal(119)) - 0.04321) < 5e-4
    assert find_separation(time[:60], depth[:60]) == time[59]
