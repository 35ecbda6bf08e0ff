"""Campaigns: reading, checking, selecting, writing."""

import json
import os
import subprocess
import sys

import frictionless
import numpy as np
import pandas as pd
import pytest
from helpers_measurement import RECORDS, SAMPLES, descriptor, write_small

from ddetumble._errors import InputError
from ddetumble.measurement.campaign import Campaign, Column
from ddetumble.measurement.package import read_campaign, write_campaign
from ddetumble.measurement.units import Uncertainty


def test_reads_in_si_units(tmp_path):
    campaign = read_campaign(write_small(tmp_path / "small"))
    assert (campaign.name, campaign.family, campaign.record_keys) == ("small", "impact", ("r01", "r02"))
    assert campaign.known == {"outer_diameter": 0.06, "effective_mass": None, "restitution": None}
    assert campaign.records.loc["r02"].to_dict() == {"sequence": 2, "initial_pressure": 1.5e6, "approach_speed": 0.41}
    trace = campaign.trace("r02")
    assert list(trace) == ["time", "normal_force"]
    np.testing.assert_array_equal(trace["time"], np.arange(-2, 5) * 0.00025)
    assert campaign.independent == Column("time", "s", Uncertainty(0.05e-3), stated="ms")
    assert campaign.uncertainty("approach_speed") == Uncertainty(0.003)
    assert campaign.uncertainty("initial_pressure") == Uncertainty(None, 0.005)
    assert campaign.uncertainty("sequence") is None
    assert len(campaign.sha256) == 64 and "2 records" in repr(campaign)
    with pytest.raises(InputError, match="no record 'r9'"):
        campaign.trace("r9")
    with pytest.raises(InputError, match="no column"):
        campaign.uncertainty("colour")


def test_the_descriptor_itself_can_be_named_and_the_hash_sees_every_byte(tmp_path):
    folder = write_small(tmp_path / "small")
    first = read_campaign(folder / "datapackage.json").sha256
    assert first == read_campaign(folder).sha256
    (folder / "samples.csv").write_text(SAMPLES.replace("0.125", "0.126"))
    assert read_campaign(folder).sha256 != first


def test_select(tmp_path):
    campaign = read_campaign(write_small(tmp_path / "small"))
    swapped = campaign.select(["r02", "r01"])
    assert swapped.record_keys == ("r02", "r01")
    assert list(dict.fromkeys(swapped.samples["record"])) == ["r02", "r01"]
    one = campaign.select(["r02"])
    pd.testing.assert_frame_equal(one.trace("r02"), campaign.trace("r02"))
    assert len(one.samples) == 7 and one.sha256 == campaign.sha256
    for keys in (["r01", "r01"], [], ["x"]):
        with pytest.raises(InputError):
            campaign.select(keys)


def test_interleaved_records_are_put_together(tmp_path):
    head, *rows = SAMPLES.splitlines()
    shuffled = [row for pair in zip(rows[7:], rows[:7], strict=True) for row in pair]
    campaign = read_campaign(write_small(tmp_path / "small", samples="\n".join([head, *shuffled])))
    plain = read_campaign(write_small(tmp_path / "plain"))
    pd.testing.assert_frame_equal(campaign.samples, plain.samples)


def test_missing_samples_are_nan_and_byte_order_mark_and_dialect_are_read(tmp_path):
    tree = descriptor()
    tree["resources"][1]["dialect"] = {"delimiter": ";"}
    tree["resources"][1]["schema"]["missingValues"] = ["", "NaN"]
    tree["resources"][1]["schema"]["fields"][2]["decimalChar"] = ","
    tree["resources"][1]["schema"]["fields"].append({"name": "depression", "type": "number", "unit": "mm"})
    rows = "record;time;normal_force;depression\r\n" + "".join(
        f"{r};{i};{i},5;{'' if i < 2 else 'NaN' if i == 2 else i}\r\n" for r in ("r01", "r02") for i in range(8)
    )
    campaign = read_campaign(write_small(tmp_path / "small", tree, samples="\ufeff" + rows))
    trace = campaign.trace("r01")
    assert trace["normal_force"][1] == 1.5
    assert trace["depression"].isna().sum() == 3 and trace["depression"][3] == 0.003


def test_gauge_pressures_become_absolute(tmp_path):
    tree = descriptor()
    tree["resources"][0]["schema"]["fields"][2] |= {"reference": "gauge", "uncertainty": "2 kPa", "assumed": True}
    with pytest.raises(InputError, match="ambient_pressure"):
        read_campaign(write_small(tmp_path / "a", tree))
    tree["known"]["ambient_pressure"] = "1 bar"
    campaign = read_campaign(write_small(tmp_path / "b", tree))
    assert list(campaign.records["initial_pressure"]) == [1.1e6, 1.6e6]
    column = campaign.conditions["initial_pressure"]
    assert column.gauge and column.assumed and column.uncertainty == Uncertainty(2000.0)
    assert len(campaign.notes) == 2
    again = write_campaign(tmp_path / "c", campaign)
    assert list(again.records["initial_pressure"]) == [1.1e6, 1.6e6]
    spoilt = RECORDS.replace("r01,1,1.0", "r01,1,-0.2")
    with pytest.raises(InputError, match="line 2, column initial_pressure.*negative"):
        read_campaign(write_small(tmp_path / "d", tree, records=spoilt))


@pytest.mark.parametrize("unit", ["parsec/", "dB", "MPA", "bar(g)"])
def test_a_stated_unit_that_cannot_be_read_is_refused_at_its_place(tmp_path, unit):
    tree = descriptor()
    tree["resources"][0]["schema"]["fields"][2]["stated_unit"] = unit
    with pytest.raises(InputError, match="stated_unit") as caught:
        read_campaign(write_small(tmp_path / "a", tree))
    assert caught.value.column == "initial_pressure" and caught.value.file.endswith("datapackage.json")


def test_zero_pressure_is_allowed_and_noted(tmp_path):
    campaign = read_campaign(write_small(tmp_path / "small", records=RECORDS.replace("1.0", "0")))
    assert campaign.records["initial_pressure"].iloc[0] == 0 and len(campaign.notes) == 1


def peaks_tree():
    tree = descriptor()
    tree["resources"][1] = {
        "name": "peaks",
        "path": "samples.csv",
        "schema": {
            "fields": [
                {"name": "record", "type": "string"},
                {"name": "peak_normal_force", "type": "number", "unit": "N"},
                {"name": "printed_normal_force", "type": "number", "unit": "N"},
                {"name": "repeats", "type": "integer"},
            ]
        },
    }
    return tree


def test_peaks(tmp_path):
    rows = "record,peak_normal_force,printed_normal_force,repeats\nr02,54.669,,16\nr01,48.519,50.1,16\n"
    campaign = read_campaign(write_small(tmp_path / "small", peaks_tree(), samples=rows))
    assert campaign.samples is None and campaign.independent is None and campaign.channels == {}
    assert campaign.peaks.loc["r01", "peak_normal_force"] == 48.519
    assert np.isnan(campaign.peaks.loc["r02", "printed_normal_force"])
    assert campaign.peak_columns["printed_normal_force"].unit == "N"
    again = write_campaign(tmp_path / "again", campaign)
    pd.testing.assert_frame_equal(again.peaks, campaign.peaks)
    assert list(campaign.select(["r01"]).peaks.index) == ["r01"]
    for spoilt, words in [
        (rows.replace("54.669", ""), "line 2.*no measured peak"),
        (rows.replace("r02", "r01", 1), "line 3.*already has a row.*repeats for a mean"),
        (rows.replace(",16", ",1.5", 1), "line 2, column repeats.*whole"),
        (rows.replace("48.519", "-48"), "line 3, column peak_normal_force.*positive"),
        ("record,peak_normal_force,printed_normal_force,repeats\nr02,54.669,,16\n", "r01.*no samples or peak"),
    ]:
        with pytest.raises(InputError, match=words):
            read_campaign(write_small(tmp_path / "spoilt", peaks_tree(), samples=spoilt))


def test_slip_families(tmp_path):
    tree = descriptor() | {"family": "slip", "known": {"poisson_ratio": 0.47, "tensile_strength": "10 MPa"}}
    tree["resources"][0]["schema"]["fields"] = [
        {"name": "record", "type": "string"},
        {"name": "normal_load", "type": "number", "unit": "N"},
        {"name": "internal_pressure", "type": "number", "unit": "bar"},
        {"name": "slip_speed", "type": "number", "unit": "mm/s"},
        {"name": "operator", "type": "string"},
    ]
    fields = tree["resources"][1]["schema"]["fields"]
    fields[1:] = [
        {"name": "slip", "type": "number", "unit": "mm"},
        {"name": "tangential_force", "type": "number", "unit": "N"},
    ]
    records = "record,normal_load,internal_pressure,slip_speed,operator\nr01,6,8,20,ann\nr02,6,8,100,ben\n"
    samples = SAMPLES.replace("time", "slip").replace("normal_force", "tangential_force")
    campaign = read_campaign(write_small(tmp_path / "a", tree, records, samples))
    assert campaign.independent.name == "slip" and list(campaign.channels) == ["tangential_force"]
    assert campaign.records.loc["r01"].to_dict() == {"normal_load": 6, "internal_pressure": 8e5, "slip_speed": 0.02}
    assert campaign.known == {"poisson_ratio": 0.47, "tensile_strength": 1e7}
    assert "operator" not in campaign.conditions and len(campaign.notes) == 1
    again = write_campaign(tmp_path / "again", campaign)
    assert again.known == campaign.known

    strokes = "record,time,slip,tangential_force\n" + "".join(
        f"{r},{i},{3 - abs(i - 3)},{1 if i < 3 else -1}\n" for r in ("r01", "r02") for i in range(7)
    )
    fields.insert(1, {"name": "time", "type": "number", "unit": "s"})
    campaign = read_campaign(write_small(tmp_path / "b", tree, records, strokes))
    assert campaign.independent.name == "time" and list(campaign.channels) == ["slip", "tangential_force"]


def test_written_packages_come_back_and_satisfy_frictionless(tmp_path):
    campaign = read_campaign(write_small(tmp_path / "small"))
    folder = tmp_path / "deep" / "copy"
    again = write_campaign(folder, campaign)
    pd.testing.assert_frame_equal(again.samples, campaign.samples)
    pd.testing.assert_frame_equal(again.records, campaign.records)
    assert (again.channels, again.conditions, again.known) == (campaign.channels, campaign.conditions, campaign.known)
    assert sorted(p.name for p in folder.parent.iterdir()) == ["copy"]
    assert "0.00025," in (folder / "samples.csv").read_text()
    assert "r01,1,1000000.0,0.4" in (folder / "records.csv").read_text()
    report = frictionless.validate(str(folder / "datapackage.json"))
    assert report.valid, report.flatten(["message"])


def test_writing_never_harms_what_is_there(tmp_path):
    campaign = read_campaign(write_small(tmp_path / "small"))
    with pytest.raises(InputError, match="already contains a campaign"):
        write_campaign(tmp_path / "small", campaign)
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "thesis.tex").write_text("")
    with pytest.raises(InputError, match="other files"):
        write_campaign(tmp_path / "other", campaign, overwrite=True)
    with pytest.raises(InputError, match="is a file"):
        write_campaign(tmp_path / "other" / "thesis.tex", campaign)
    before = {p.name: p.read_bytes() for p in (tmp_path / "small").iterdir()}
    bad = campaign.records.copy()
    bad["approach_speed"] = -1.0
    spoilt = Campaign(**{f: getattr(campaign, f) for f in campaign.__dataclass_fields__} | {"records": bad})
    with pytest.raises(InputError, match="approach_speed.*positive"):
        write_campaign(tmp_path / "small", spoilt, overwrite=True)
    assert {p.name: p.read_bytes() for p in (tmp_path / "small").iterdir()} == before
    write_campaign(tmp_path / "small", campaign.select(["r01"]), overwrite=True)
    assert read_campaign(tmp_path / "small").record_keys == ("r01",)
    assert sorted(os.listdir(tmp_path)) == ["other", "small"]


def test_awkward_keys_and_further_conditions_survive(tmp_path):
    tree = descriptor()
    tree["resources"][0]["schema"]["fields"] += [
        {"name": "pad_thickness", "type": "number", "unit": "mm"},
        {"name": "temperature", "type": "number", "unit": "degC", "uncertainty": "0.5 degC"},
        {"name": "preload", "type": "number", "unit": "N*m", "description": "of the clamp"},
    ]
    head, *rows = RECORDS.splitlines()
    records = "\n".join([head + ",pad_thickness,temperature,preload", *(row + ",4,21.5,0.3" for row in rows)])
    records, samples = (text.replace("r01", '"r ""1"", näh"') for text in (records, SAMPLES))
    campaign = read_campaign(write_small(tmp_path / "small", tree, records, samples))
    again = write_campaign(tmp_path / "again", campaign)
    assert again.record_keys == ('r "1", näh', "r02")
    pd.testing.assert_frame_equal(again.records, campaign.records)
    assert again.conditions == campaign.conditions
    assert campaign.records["temperature"].iloc[0] == pytest.approx(294.65)
    assert campaign.uncertainty("temperature") == Uncertainty(0.5)


def test_measurement_does_not_need_jax():
    code = "import sys, ddetumble.measurement; print(json) if 0 else sys.exit('jax' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_errors_survive_a_process_boundary():
    import pickle

    error = pickle.loads(pickle.dumps(InputError("is bad", file="a.csv", column="time", row=3)))
    assert str(error) == "a.csv, line 3, column time: is bad" and error.row == 3
    assert json.dumps(str(InputError("two\nlines \x00")))
    assert "\n" not in str(InputError("two\nlines"))
