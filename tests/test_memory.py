"""Large campaigns: the memory that they take, what is said where that is too much, and that no number depends on it."""

import dataclasses as dc
import subprocess
import sys
from pathlib import Path

import jax
import numpy as np
import pandas as pd
import pytest

import ddetumble as dd
from ddetumble import _settings
from ddetumble.cli import main


ROOT = Path(__file__).resolve().parent.parent
STROKES, TURNS = 20, 350  # strokes of a record, and samples of each


def make_impact(samples: int, records: int = 1, ringing: float = 0.0) -> dd.Campaign:
    """Impacts of one ball, sampled so often, with white noise of the stated size, and a ringing force [N] if asked."""
    source = dd.read_campaign(dd.find_data() / "impact-b")
    campaign, noise = source.select(source.record_keys[:records]), np.random.default_rng(1)
    time = np.linspace(-0.002, 0.05, samples)
    ball, frames = dd.Ball(effective_mass=1.2, restitution=0.75), []
    for key, row in campaign.records.iterrows():
        force = dd.dynamics.simulate_impact(ball, row.to_dict(), time).normal_force
        force = force + ringing * (force > 0) * np.sin(2.0 * np.pi * 900.0 * time)
        frames.append(pd.DataFrame({"record": key, "time": time,
                                    "normal_force": force + 0.25 * noise.standard_normal(samples)}))
    return dc.replace(campaign, samples=pd.concat(frames, ignore_index=True))


def make_strokes() -> dd.Campaign:
    """Four records of rubber rubbed to and fro, on which a force acts that no catalogue holds."""
    source = dd.read_campaign(dd.find_data() / "slip-a")
    campaign, noise = source.select(source.record_keys[:4]), np.random.default_rng(2)
    count, stroke, frames = STROKES * TURNS, 0.03, []
    law = dd.RubberFriction().extend(())
    for key, row in campaign.records.iterrows():
        time = np.arange(count) * stroke / TURNS / row["slip_speed"]
        way = 1.0 - 2.0 * (np.arange(count) // TURNS % 2)
        far = np.tile((np.arange(TURNS) + 1) * stroke / TURNS, STROKES)
        force = dd.dynamics.simulate_sliding(law, row.to_dict(), far, way, time).tangential_force
        force = force + way * 0.3 * np.sin(2.0 * np.pi * far / 0.007) + 0.04 * noise.standard_normal(count)
        frames.append(pd.DataFrame({"record": key, "time": time, "tangential_force": force,
                                    "slip": np.where(way > 0, far, stroke - far)}))
    channels = campaign.channels | {"slip": dc.replace(campaign.independent, name="slip", uncertainty=None)}
    return dc.replace(campaign, samples=pd.concat(frames, ignore_index=True), channels=channels,
                      independent=dc.replace(campaign.independent, name="time", unit="s", uncertainty=None))


def measure_peak(work: str) -> float:
    """Largest memory that a process of its own takes for some work with the functions above [GB]."""
    code = (f"import ddetumble as dd, tests.test_memory as t\n{work}\n"
            "lines = open('/proc/self/status').read().splitlines()\n"
            "print(next(line.split()[1] for line in lines if line.startswith('VmHWM')))")
    ended = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert ended.returncode == 0, ended.stderr
    return float(ended.stdout.split()[-1]) / 1024**2


@pytest.mark.slow
def test_one_record_of_many_samples():
    """One record of 1e5 samples is not padded to many: memory grows with the samples that are there."""
    work = "dd.compare(t.make_impact(100_000))"
    assert measure_peak(work) < 2.5  # at first the compiler takes some 0.5 GB of it
    assert measure_peak(work) < 1.5


@pytest.mark.study
def test_a_million_samples():
    """`compare` and `fit` take a million samples within a few gigabytes, all of them."""
    assert measure_peak("assert dd.compare(t.make_impact(1_000_000)).channels['samples'][0] > 990_000") < 4.0
    assert measure_peak("assert dd.fit(t.make_impact(1_000_000)).samples > 990_000") < 4.0


@pytest.mark.study
def test_search_of_a_million_samples(monkeypatch):
    """`discover` takes every tenth of a million samples, says so, and finds the same as in a tenth of them."""
    campaign = make_impact(1_000_000)
    found = dd.discover(campaign)
    assert found.verdict in ("nothing-missing", "undecided")
    assert found.counts["samples"] == 100_000 and any("1,000,000" in note for note in found.notes)


@pytest.mark.study
def test_search_with_a_misfit_of_many_samples():
    """What looks for lines and for moving zeros in residuals takes no table of all samples by all samples."""
    assert measure_peak("found = dd.discover(t.make_impact(25_000, 4, 10.0)); "
                        "assert found.verdict != 'nothing-missing'") < 4.0


@pytest.mark.study
def test_free_force_of_long_strokes():
    """The missing force of four long records of strokes: 28,000 samples, 48 splines."""
    assert measure_peak("found = dd.draw_missing_force(t.make_strokes()); assert found.shapes") < 3.0


def test_shapes():
    """A large campaign is padded by less than its own size again, a small one to a shape that others share."""
    from ddetumble.families import FAMILIES
    from ddetumble.inference.stack import pad_shape

    family = FAMILIES["impact"]
    assert pad_shape(5, 300, family) == pad_shape(23, 700, family)
    for count, longest in ((1, 100_000), (1, 1_000_000), (3, 70_001), (13, 20_000), (200, 5_000)):
        rows, size = pad_shape(count, longest, family)
        assert rows >= count and size >= longest and rows * size < 1.7 * count * longest


def test_refused(monkeypatch, tmp_path, capsys):
    """More memory than is allowed is refused in a sentence that names the setting, before anything is computed."""
    campaign = make_impact(2_000)
    monkeypatch.setenv("DDETUMBLE_MEMORY", "1 MB")
    for verb in (dd.compare, dd.fit, dd.discover):
        with pytest.raises(dd.InputError, match="DDETUMBLE_MEMORY"):
            verb(campaign)
    assert main(["compare", "impact-b"]) == 2
    assert "DDETUMBLE_MEMORY" in capsys.readouterr().err
    monkeypatch.setenv("DDETUMBLE_MEMORY", "a lot")
    assert main(["compare", "impact-b"]) == 2
    assert "DDETUMBLE_MEMORY" in capsys.readouterr().err


def test_thinning():
    """Kept samples are readings as they were taken; short records keep all of theirs."""
    from ddetumble.measurement.campaign import thin_campaign

    campaign = make_impact(3_000, 3)
    short = campaign.samples.groupby("record").cumcount() < 100
    mixed = dc.replace(campaign, samples=campaign.samples[short | (campaign.samples["record"] != "r02")])
    thin, said = thin_campaign(mixed, 1_000)
    counts = thin.samples["record"].value_counts()
    assert counts["r02"] == 100 and 200 < counts["r01"] <= 333 and f"{len(mixed.samples):,}" in said
    assert not pd.merge(thin.samples, mixed.samples, how="left", indicator=True)["_merge"].ne("both").any()
    assert thin_campaign(mixed, 10_000) == (mixed, "")


def test_programs_are_forgotten_where_memory_is_short(monkeypatch):
    """Where a process holds more than its part, its compiled programs go; where it has room, they stay."""
    double = jax.jit(lambda x: 2.0 * x)
    double(1.0)
    monkeypatch.setattr(_settings, "find_memory", lambda: 1e15)
    _settings.forget_programs()
    assert double._cache_size() == 1
    monkeypatch.setattr(_settings, "find_memory", lambda: 1.0)
    _settings.forget_programs()
    assert double._cache_size() == 0 and double(1.0) == 2.0


@pytest.mark.skipif(sys.platform != "linux", reason="another system does not say what a process holds")
def test_resident_memory_is_what_an_array_takes():
    before = _settings.measure_resident()
    numbers = np.ones(40_000_000)
    assert _settings.measure_resident() - before == pytest.approx(numbers.nbytes, rel=0.2)
