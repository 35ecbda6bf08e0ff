"""What says nothing about the physics changes no verdict: order, units, clocks, threads, the noise as stated."""

import dataclasses as dc
import json
import os
import shutil
import subprocess
import sys

import numpy as np
import pandas as pd
import pytest
from helpers_measurement import raw_text, raw_trace
from hypothesis import given, settings
from hypothesis import strategies as st

import ddetumble as dd


SLIP, IMPACT, TUMBLE = "slip-c", "impact-i", "tumble-a"
# Of a parameter's standard deviation: sums in another order end a fit's steps elsewhere within its tolerance.
CLOSE = 0.02


@pytest.fixture(scope="module")
def found():
    """Discovery on a shipped campaign as it is, by name."""
    return {name: dd.discover(name) for name in (SLIP, IMPACT, TUMBLE)}


def assert_same(ours, theirs):
    """The same verdict and effects, and parameters the same but for where a fit's last step ends."""
    assert (ours.verdict, ours.effects) == (theirs.verdict, theirs.effects)
    for name, one in theirs.steps[-1].parameters.items():
        assert abs(ours.steps[-1].parameters[name].estimate - one.estimate) < CLOSE * one.sd, name


def copy_campaign(name, folder, change):
    """A shipped campaign with its tables changed: `change(records, samples, descriptor)` gives both tables."""
    shutil.copytree(dd.find_data() / name, folder)
    descriptor = json.loads((folder / "datapackage.json").read_text(encoding="utf-8"))
    tables = [pd.read_csv(folder / f"{table}.csv") for table in ("records", "samples")]
    for table, data in zip(("records", "samples"), change(*tables, descriptor), strict=True):
        data.to_csv(folder / f"{table}.csv", index=False)
    (folder / "datapackage.json").write_text(json.dumps(descriptor), encoding="utf-8")
    return folder


def set_units(descriptor, units):
    """Units of quantities in a descriptor, and their uncertainties with them: {quantity: (unit, uncertainty)}."""
    for resource in descriptor["resources"]:
        for field in resource["schema"]["fields"]:
            if field["name"] in units:
                field["unit"], uncertainty = units[field["name"]]
                if uncertainty is not None:
                    field["uncertainty"] = uncertainty


@pytest.mark.slow
@pytest.mark.parametrize("name", [SLIP, IMPACT])
@settings(max_examples=2, deadline=None)
@given(seed=st.integers(0, 2**16))
def test_order_of_records(found, tmp_path_factory, name, seed):
    """Records that stand in another order in both tables are the same campaign."""
    random = np.random.default_rng(seed)

    def shuffle(records, samples, descriptor):
        order = random.permutation(len(records))
        groups = [group for _, group in samples.groupby("record", sort=False)]
        return records.iloc[order], pd.concat([groups[k] for k in random.permutation(len(groups))])

    folder = copy_campaign(name, tmp_path_factory.mktemp("order") / name, shuffle)
    assert_same(dd.discover(folder), found[name])


@pytest.mark.slow
def test_names_of_records(found, tmp_path):
    """What records are called is nothing to go by."""
    def rename(records, samples, descriptor):
        names = {old: f"{chr(122 - k)}-test" for k, old in enumerate(records["record"])}
        return records.replace({"record": names}), samples.replace({"record": names})

    assert_same(dd.discover(copy_campaign(SLIP, tmp_path / "names", rename)), found[SLIP])


@pytest.mark.slow
def test_units_of_friction(found, tmp_path):
    """Forces in mN, slip in inches, pressure in psi, speed in mm/s."""
    def convert(records, samples, descriptor):
        set_units(descriptor, {"normal_load": ("mN", None), "internal_pressure": ("psi", None),
                               "slip_speed": ("mm/s", None), "slip": ("inch", None),
                               "tangential_force": ("mN", None)})
        scales = {"normal_load": 1e3, "internal_pressure": 1e6 / 6894.757293168361, "slip_speed": 1e3,
                  "slip": 1.0 / 25.4, "tangential_force": 1e3}
        return tuple(table.assign(**{key: table[key] * scale for key, scale in scales.items() if key in table})
                     for table in (records, samples))

    assert_same(dd.discover(copy_campaign(SLIP, tmp_path / "units", convert)), found[SLIP])


@pytest.mark.slow
def test_units_of_impacts(found, tmp_path):
    """Forces in kN, times in ms, pressures in bar, speeds in km/h."""
    def convert(records, samples, descriptor):
        set_units(descriptor, {"initial_pressure": ("bar", None), "approach_speed": ("km/h", None),
                               "time": ("ms", "0.05 ms"), "normal_force": ("kN", "0.25 N")})
        return (records.assign(initial_pressure=records["initial_pressure"] * 10.0,
                               approach_speed=records["approach_speed"] * 3.6),
                samples.assign(time=samples["time"] * 1e3, normal_force=samples["normal_force"] * 1e-3))

    assert_same(dd.discover(copy_campaign(IMPACT, tmp_path / "units", convert)), found[IMPACT])


@pytest.mark.slow
@pytest.mark.parametrize(("name", "factor"), [(SLIP, 0.3), (SLIP, 3.0), (IMPACT, 0.3), (TUMBLE, 0.3), (TUMBLE, 3.0)])
def test_stated_noise(found, name, factor):
    """A gauge whose noise is stated wrongly is measured: verdict, estimates and intervals follow its own noise."""
    campaign = dd.read_campaign(name)
    told = {}
    for channel, column in campaign.channels.items():
        parts = column.uncertainty.absolute, column.uncertainty.relative
        stated = type(column.uncertainty)(*(None if part is None else part * factor for part in parts))
        told[channel] = dc.replace(column, uncertainty=stated)
    ours = dd.discover(dc.replace(campaign, channels=told))
    assert (ours.verdict, ours.effects) == (found[name].verdict, found[name].effects)
    for key, one in found[name].steps[-1].parameters.items():
        mine = ours.steps[-1].parameters[key]
        assert abs(mine.estimate - one.estimate) < 0.3 * one.sd and mine.sd == pytest.approx(one.sd, rel=0.15), key


@settings(max_examples=5, deadline=None)
@given(shift=st.floats(-100.0, 1000.0))
def test_clock_of_the_bench(tmp_path_factory, shift):
    """Recordings whose clocks began at another time make the same campaign, but for the rounding of their times."""
    def record(offset):
        folder = tmp_path_factory.mktemp("clock")
        for k in range(3):
            time, force = raw_trace(seed=k, peak=80.0 + 10.0 * k)
            text = raw_text((time + offset, force), ("time [s]", "force [N]"), digits=9)
            (folder / f"{k}.csv").write_text(text, encoding="utf-8")
        return dd.import_tests([folder], pressure="1 MPa", speed="0.4 m/s",
                               known={"outer_diameter": "60 mm", "effective_mass": None, "restitution": None})

    here, there = record(0.0), record(shift)
    assert list(here.records.index) == list(there.records.index)
    np.testing.assert_allclose(there.samples["time"], here.samples["time"], atol=1e-6)
    np.testing.assert_allclose(there.samples["normal_force"], here.samples["normal_force"], atol=1e-9)


@pytest.mark.slow
def test_threads(found, tmp_path):
    """One thread or several: the same verdict, effects and estimates."""
    flags = {"OPENBLAS_NUM_THREADS": "3", "OMP_NUM_THREADS": "3", "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false"}
    subprocess.run([sys.executable, "-m", "ddetumble", "discover", SLIP, "-o", str(tmp_path / "found")], check=True,
                   env={**os.environ, **flags}, capture_output=True, timeout=600)
    told = json.loads((tmp_path / "found" / "result.json").read_text(encoding="utf-8"))
    assert told["verdict"] == found[SLIP].verdict
    for name, one in found[SLIP].steps[-1].parameters.items():
        assert abs(told["parameters"][name]["estimate"] - one.estimate) < CLOSE * one.sd
