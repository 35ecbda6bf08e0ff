"""Import of raw files: the numbers come out right, and what cannot be told is asked for by the option's name."""

import os
import re

import numpy as np
import pandas as pd
import pytest
from helpers_formats import write_tdms
from helpers_measurement import pulse, raw_text, raw_trace

import ddetumble as dd
from ddetumble import InputError, check_plausibility, import_tests, read_campaign, write_campaign
from ddetumble.cli import main
from ddetumble.contact.effect import parameters_of
from ddetumble.exam.simulators.impact import simulate
from ddetumble.families import list_families
from ddetumble.measurement.checks import read_known
from ddetumble.measurement.faults import find_truncated
from ddetumble.measurement.kinds import KINDS
from ddetumble.measurement.layout import read_layout, split_heading
from ddetumble.reports.export import tabulate_campaign


CONDITIONS = {"pressure": "1.0 MPa", "speed": "0.4 m/s"}


def write(path, text, encoding="utf-8"):
    path.write_bytes(text.encode(encoding))
    return path


def check(campaign, folder, onset=0.0123, peak=50.0, noise=0.2):
    """The campaign passes when read back, and its first record is the pulse that went in."""
    again = write_campaign(folder, campaign)
    assert again.notes == campaign.notes
    assert read_campaign(folder).record_keys == campaign.record_keys
    trace = again.trace(again.record_keys[0])
    clock = again.uncertainty("time").absolute
    assert 1e-6 < clock < 3e-4
    shift = float(trace["time"].iloc[0]) + onset
    assert abs(shift) < 4 * clock
    wanted = pulse(trace["time"].to_numpy(), shift, peak)
    assert np.abs(trace["normal_force"] - wanted).max() < 5 * noise
    assert again.uncertainty("normal_force").absolute == pytest.approx(noise, rel=0.25)
    assert abs(trace["normal_force"][trace["time"] < -0.001].mean()) < 0.1 * noise
    return again


LAYOUTS = {
    "comma": {"headings": ["t (s)", "Fz [N]"]},
    "underscores": {"headings": ["time_s", "Force_N"]},
    "slashes": {"headings": ["Time/s", "Force/N"], "delimiter": "\t"},
    "german": {"headings": ["Zeit [s]", "Kraft [N]"], "delimiter": ";", "decimal": ","},
    "unit row": {"headings": ["t", "F"], "units": ["s", "N"], "delimiter": ";"},
    "bracketed unit row": {"headings": ["Time", "Force"], "units": ["[s]", "[N]"], "delimiter": "\t", "decimal": ","},
    "preamble": {
        "headings": ["Time (s)", "Fz (N)"],
        "preamble": "Bench 3, charge amplifier\nRate,10000\nOperator,Ann,room 5\n\n",
    },
    "preamble with as many cells": {
        "headings": ["Zeit", "Kraft"],
        "units": ["s", "N"],
        "delimiter": ";",
        "preamble": "Prüfer;Jones\nRate;10000\n",
    },
    "spaces": {"headings": ["t", "[s]", " Fz", "[N]"], "delimiter": " "},
}


@pytest.mark.parametrize("name", LAYOUTS)
def test_layouts(tmp_path, name):
    time, force = raw_trace()
    path = write(tmp_path / "shot1.csv", raw_text([time, force], **LAYOUTS[name]))
    campaign = import_tests([path], **CONDITIONS)
    assert campaign.record_keys == ("shot1",)
    assert campaign.records.loc["shot1"].to_dict() == {"initial_pressure": 1e6, "approach_speed": 0.4}
    check(campaign, tmp_path / "campaign")


def test_a_record_cut_in_mid_contact_is_noted(tmp_path):
    time, force = raw_trace()
    whole = import_tests(write(tmp_path / "a.csv", raw_text([time, force], ["t [s]", "F [N]"])), **CONDITIONS)
    short = time < time[np.argmax(force)] + 1e-3
    text = raw_text([time[short], force[short]], ["t [s]", "F [N]"])
    cut = import_tests(write(tmp_path / "b.csv", text), **CONDITIONS)
    assert not find_truncated(whole)
    (fault,) = find_truncated(cut)
    assert fault.records == ("b",) and str(fault) in cut.notes


def test_units_are_converted(tmp_path):
    time, force = raw_trace()
    text = raw_text([time * 1e3, force / 1e3], ["t (ms)", "Fz [kN]"], digits=9)
    check(import_tests(write(tmp_path / "a.txt", text), **CONDITIONS), tmp_path / "campaign")


def test_units_from_the_option_and_encodings(tmp_path):
    time, force = raw_trace()
    text = raw_text([time * 1e3, force], ["Zeit µ", "Kraft"], delimiter="\t")
    for encoding in ("cp1252", "utf-16"):
        path = write(tmp_path / f"{encoding}.txt", text, encoding)
        with pytest.raises(InputError, match="--time COLUMN"):
            import_tests(path, **CONDITIONS)
        with pytest.raises(InputError, match="Kraft.*--unit force=N"):
            import_tests(path, time="Zeit µ", units={"time": "ms"}, **CONDITIONS)
        campaign = import_tests(path, time="Zeit µ", units=["time=ms", "force=N"], **CONDITIONS)
        check(campaign, tmp_path / encoding / "campaign")


def test_no_headings_at_all(tmp_path):
    time, force = raw_trace()
    path = write(tmp_path / "a.csv", raw_text([time, force], ["0.0", "1.7"]))
    with pytest.raises(InputError, match="--time COLUMN"):
        import_tests(path, **CONDITIONS)
    path = write(tmp_path / "a.csv", raw_text([time[1:], force[1:]], ["0.0", "1.7"]))
    campaign = import_tests(path, time="1", force="column 2", units={"time": "s", "force": "N"}, **CONDITIONS)
    check(campaign, tmp_path / "campaign")


def test_compression_counted_negative(tmp_path):
    time, force = raw_trace()
    path = write(tmp_path / "a.csv", raw_text([time, -force], ["t [s]", "Fz [N]"]))
    campaign = import_tests(path, **CONDITIONS)
    check(campaign, tmp_path / "campaign")
    other = write(tmp_path / "b.csv", raw_text([time, force], ["t [s]", "Fz [N]"]))
    with pytest.raises(InputError, match="the opposite sign"):
        import_tests([path, other], **CONDITIONS)


def test_one_long_file_with_tests_and_constant_columns(tmp_path):
    columns = [[], [], [], [], [], []]
    for i in range(3):
        time, force = raw_trace(onset=0.0123 + 0.003 * i, peak=40 + 10 * i, seed=i)
        new = ([f"T{i}"] * len(time), time, force, time * 0 + 10 + i, time * 0 + 0.3, time * 0 + i + 1)
        for column, values in zip(columns, new, strict=True):
            column += list(values)
    headings = ["Test", "t [s]", "Fz [N]", "p0 [bar]", "v (m/s)", "sequence"]
    path = write(tmp_path / "all.csv", raw_text(columns, headings))
    campaign = import_tests([path], gauge=True, ambient="1 bar")
    assert campaign.record_keys == ("T0", "T1", "T2")
    assert list(campaign.records["initial_pressure"]) == [1.1e6, 1.2e6, 1.3e6]
    assert list(campaign.records["sequence"]) == [1, 2, 3]
    assert campaign.known["ambient_pressure"] == 1e5
    check(campaign, tmp_path / "campaign", peak=40)
    with pytest.raises(InputError, match="--ambient"):
        import_tests([path], gauge=True)
    with pytest.raises(InputError, match="given twice, by the raw column initial_pressure and by --pressure"):
        import_tests([path], pressure="1 MPa")


def test_three_channels_and_pressure_before_contact(tmp_path):
    time, force = raw_trace()
    rng = np.random.default_rng(1)
    depth = pulse(time, 0.0123, 4) ** 0.5 + 0.3 + 0.01 * rng.standard_normal(time.size)
    gas = 12 - pulse(time, 0.0123, 0.5) + 0.01 * rng.standard_normal(time.size)
    headings = ["t [s]", "Fz [N]", "depth (mm)", "p [bar]", "Fx [N]"]
    path = write(tmp_path / "a.csv", raw_text([time, force, depth, gas, force], headings))
    campaign = import_tests(path, speed="0.4 m/s", uncertainty={"initial_pressure": "0.5 %", "force": "0.3 N"})
    assert list(campaign.channels) == ["normal_force", "depression", "pressure"]
    assert campaign.records["initial_pressure"].iloc[0] == pytest.approx(12e5, rel=1e-3)
    assert campaign.uncertainty("initial_pressure").relative == 0.005
    assert campaign.uncertainty("normal_force").absolute == 0.3
    assert campaign.uncertainty("pressure").absolute == pytest.approx(1000, rel=0.3)
    trace = campaign.trace("a")
    assert abs(trace["depression"][trace["time"] < -1e-3].mean()) < 1e-5
    write_campaign(tmp_path / "campaign", campaign)
    moving = write(tmp_path / "b.csv", raw_text([time, force, time * 400, gas, force], headings))
    with pytest.raises(InputError, match="position of the arm"):
        import_tests(moving, speed="0.4 m/s")


def test_a_speed_that_changes_within_a_test_is_no_condition(tmp_path):
    time, force = raw_trace()
    path = write(tmp_path / "a.csv", raw_text([time, force, 0.4 - time], ["t [s]", "Fz [N]", "v [m/s]"]))
    with pytest.raises(InputError, match="approach_speed is not known"):
        import_tests(path, pressure="1 MPa")
    campaign = import_tests(path, **CONDITIONS)
    assert campaign.records.loc["a", "approach_speed"] == 0.4
    assert campaign.uncertainty("initial_pressure") is None and campaign.uncertainty("approach_speed") is None
    with pytest.raises(InputError, match="choose another column"):
        import_tests(path, keep=["speed=v"], **CONDITIONS)


def test_a_channel_under_another_name_is_taken_in_by_the_option_that_the_notes_name(tmp_path):
    """A laser that nothing says is the depression: the note has its heading, and what it can be taken in as."""
    time, force = raw_trace()
    path = write(tmp_path / "a.csv", raw_text([time, force, 1e-2 * force], ["t [s]", "Fz [N]", "laser [mm]"]))
    (note,) = [note for note in import_tests(path, **CONDITIONS).notes if "laser" in note]
    assert "--keep" in note and "depression" in note
    assert "depression" in import_tests(path, keep={"depression": "laser"}, **CONDITIONS).channels


def test_a_column_is_left_out(tmp_path):
    """One whose heading is understood, or one of two that may be the force; not one that is not there, or is named as
    another quantity's."""
    time, force = raw_trace()
    headings = ["t [s]", "Fz [N]", "depression [mm]", "F2 [N]"]
    path = write(tmp_path / "a.csv", raw_text([time, force, 1e3 * force, 2.0 * force], headings))
    whole, less = (import_tests(path, force="Fz [N]", drop=drop, **CONDITIONS) for drop in (None, ["depression [mm]"]))
    assert set(whole.channels) - set(less.channels) == {"depression"} and set(less.channels) == {"normal_force"}
    twin = write(tmp_path / "b.csv", raw_text([time, force, 2.0 * force], ["t [s]", "A [N]", "B [N]"]))
    pd.testing.assert_series_equal(import_tests(twin, drop="B", **CONDITIONS).samples["normal_force"],
                                   less.samples["normal_force"])
    for options, says in (({"drop": "depth"}, "no column 'depth'"), ({"drop": "F2", "force": "F2"}, "keep one")):
        with pytest.raises(InputError, match=says):
            import_tests(path, **options, **CONDITIONS)


def test_an_offset_within_the_noise_stays(tmp_path):
    time, force = raw_trace(offset=0.0)
    campaign = import_tests(write(tmp_path / "a.csv", raw_text([time, force], ["t [s]", "Fz [N]"])), **CONDITIONS)
    np.testing.assert_allclose(campaign.samples["normal_force"], force, atol=1e-6)


def make_shots(folder, names):
    """Files of one pulse each."""
    for i, name in enumerate(names):
        time, force = raw_trace(seed=i)
        write(folder / name, raw_text([time, force], ["t [s]", "Fz [N]"]))
    return [folder / name for name in names]


def test_the_table_that_a_laboratory_keeps(tmp_path):
    """Numbers of runs for names of files, dates, remarks, and pressures that the heading calls gauge ones."""
    files = make_shots(tmp_path, ["Strike_02.csv", "Strike_10.csv", "Strike_09.csv"])
    rows = ["10;2026-10-03;4.5;250;", "9;2026-10-03;3.25;500;new cable", "2;2026-10-04;2;750;", "11;2026-10-04;9;100;"]
    path = write(tmp_path / "table.csv",
                 "\n".join(["Run;Date;Ball pressure (bar, gauge);Approach speed (mm/s);Remark", *rows]) + "\n")
    campaign = import_tests(files, conditions=path, gauge=True, ambient="100 kPa")
    assert list(campaign.conditions) == ["initial_pressure", "approach_speed"]
    for key, pressure, speed in (("Strike_02", 3e5, 0.75), ("Strike_10", 5.5e5, 0.25), ("Strike_09", 4.25e5, 0.5)):
        assert campaign.records.loc[key].to_dict() == pytest.approx(
            {"initial_pressure": pressure, "approach_speed": speed})
    with pytest.raises(InputError, match="--gauge"):
        import_tests(files, conditions=path)
    # A number with its unit in the cell is no remark: it is asked about, and not left out.
    write(path, path.read_text().replace("Remark", "Pad").replace("new cable", "4 mm"))
    with pytest.raises(InputError, match="Pad"):
        import_tests(files, conditions=path, gauge=True, ambient="100 kPa")


@pytest.mark.parametrize("names, numbers", [
    (["Strike_02.csv", "Strike_2.csv"], [2, 3]),  # two files of one number
    (["Strike_02.csv", "Shot_03.csv"], [2, 3]),  # of two kinds
    (["Strike_02.csv", "Strike_04.csv"], [2, 3]),  # one that is not there
    (["Strike_02.csv", "Strike_03.csv"], [2, 3, 3]),  # one that is there twice
    (["Strike_02.csv", "Strike_03.csv"], [2, 3, "Strike_02"]),  # names and numbers
    (["strike.csv", "Strike_03.csv"], [2, 3]),
])
def test_numbers_that_do_not_tell_the_file(tmp_path, names, numbers):
    files = make_shots(tmp_path, names)
    path = write(tmp_path / "table.csv", "Run;p [MPa];v [m/s]\n" + "".join(f"{one};1;0.4\n" for one in numbers))
    with pytest.raises(InputError, match="table.csv"):
        import_tests(files, conditions=path)


def test_a_number_that_the_table_lacks_is_named(tmp_path):
    """The record without a row is the one that is named, and a number that stands there twice with both lines."""
    files = make_shots(tmp_path, [f"drop_{one:02d}.csv" for one in range(1, 6)])

    def give(numbers):
        return write(tmp_path / "table.csv", "Run;p [MPa];v [m/s]\n" + "".join(f"{one};1;0.4\n" for one in numbers))

    with pytest.raises(InputError, match=r"drop_04.*Run.*1 to 3, 5, 6\b"):
        import_tests(files, conditions=give([1, 2, 3, 5, 6]))
    with pytest.raises(InputError, match="line 5.*drop_03.*line 4"):
        import_tests(files, conditions=give([1, 2, 3, 3, 4, 5]))
    assert import_tests(files, conditions=give([1, 2, 3, 4, 5, 9, 9])).record_keys[3] == "drop_04"  # 9 is no record's


@pytest.mark.parametrize("heading", ["pressure (kPa, gauge)", "gauge pressure [kPa]"])
def test_a_heading_that_says_gauge(tmp_path, heading):
    """It is the ball's pressure, to which the ambient one is added; without --gauge no other unit is proposed."""
    files = make_shots(tmp_path, ["a.csv"])
    path = write(tmp_path / "table.csv", f'record;{heading};v [m/s]\na;300;0.4\n')
    campaign = import_tests(files, conditions=path, gauge=True, ambient="100 kPa")
    assert campaign.records.loc["a", "initial_pressure"] == pytest.approx(4e5)
    with pytest.raises(InputError, match="gauge.* --gauge and --ambient") as caught:
        import_tests(files, conditions=path)
    assert "bar" not in str(caught.value).replace(str(path), "")


def test_a_channel_in_a_unit_that_says_gauge(tmp_path):
    time, force = raw_trace()
    path = write(tmp_path / "a.csv", raw_text([time, force, 0 * time + 3], ["t [s]", "Fz [N]", "p [barg]"]))
    campaign = import_tests(path, speed="0.4 m/s", gauge=True, ambient="1 bar")
    assert campaign.records.loc["a", "initial_pressure"] == pytest.approx(4e5)


@pytest.mark.parametrize("heading", ["No.", "Nr", "Test No.", "#"])
def test_headings_of_the_number_of_a_test(tmp_path, heading):
    files = make_shots(tmp_path, ["drop_1.csv", "drop_2.csv"])
    path = write(tmp_path / "table.csv", f"{heading};p [MPa];v [m/s]\n2;1.5;0.4\n1;1;0.4\n")
    assert [*import_tests(files, conditions=path).records["initial_pressure"]] == [1e6, 1.5e6]


def test_options_name_columns_of_the_table_of_conditions(tmp_path):
    """--record-column, --keep, --drop and --unit reach it; the raw files' own columns come first."""
    files = make_shots(tmp_path, ["drop_1.csv", "drop_2.csv"])
    path = write(tmp_path / "table.csv", "Item;Fill;v;rep [1];Fz\n1;1;0.4;7;2\n2;1.5;0.5;8;3\n")
    said = {"conditions": path, "record_column": "Item", "keep": ["pressure=Fill", "rep"], "drop": "Fz",
            "units": ["pressure=MPa", "speed=m/s"]}
    with pytest.raises(InputError, match="--drop|Fz"):  # the raw files have it as well, and need it
        import_tests(files, **said)
    path.write_text(path.read_text().replace("Fz", "Note"))
    campaign = import_tests(files, **said | {"drop": "Note"})
    assert campaign.records.to_dict("list") == {
        "initial_pressure": [1e6, 1.5e6], "approach_speed": [0.4, 0.5], "rep": [7, 8]}
    for option, name in (("record_column", "Strike"), ("keep", "temperature=Strike"), ("keep", "slip=Fill")):
        with pytest.raises(InputError, match=name.rpartition("=")[2]) as caught:
            import_tests(files, **said | {option: name, "drop": "Note"})
        assert "Item, Fill" in str(caught.value) and "Fz [N]" in str(caught.value)
    with pytest.raises(InputError, match=r"Item, Fill.*--record-column"):
        import_tests(files, conditions=path)
    with pytest.raises(InputError, match=r"initial_pressure.*Item, Fill.*--keep .initial_pressure=COLUMN"):
        import_tests(files, conditions=path, record_column="Item", units=["Fill=MPa", "speed=m/s"], drop="Note")


@pytest.mark.parametrize("name", ["presure", "slip", "angular_velocity", "Weg"])
def test_a_unit_of_no_column_is_refused(tmp_path, name):
    time, force = raw_trace()
    path = write(tmp_path / "a.csv", raw_text([time, force, time], ["t [s]", "Fz [N]", "Weg [mm]"]))
    with pytest.raises(InputError, match=f"--unit.*{name}.*time, normal_force"):
        import_tests(path, units={name: "mm"}, **CONDITIONS)


def test_conditions_table(tmp_path):
    for i in range(2):
        time, force = raw_trace(seed=i)
        write(tmp_path / f"shot{i}.csv", raw_text([time, force], ["t [s]", "Fz [N]"]))
    table = "file;Druck [MPa];v (m/s);Pad thickness [mm];Temp [°C]\n"
    table += "shot0.csv;1,25;0,4;4;20\nshot1;1,5;0,45;5,5;21\nx;1;1;1;1\n"
    path = write(tmp_path / "table.txt", table)
    files = [tmp_path / "shot0.csv", tmp_path / "shot1.csv"]
    campaign = import_tests(files, conditions=path)
    assert campaign.records.loc["shot1"].to_dict() == pytest.approx(
        {"initial_pressure": 1.5e6, "approach_speed": 0.45, "temperature": 294.15, "pad_thickness": 0.0055}
    )
    assert campaign.conditions["pad_thickness"].unit == "m"
    check(campaign, tmp_path / "campaign")
    write(path, table.replace("shot1;", "shot7;"))
    with pytest.raises(InputError, match="record 'shot1' has no row"):
        import_tests(files, conditions=path)
    write(path, table.replace("x;", "shot0;"))
    with pytest.raises(InputError, match="line 4.*already has a row on line 2"):
        import_tests(files, conditions=path)
    write(path, table.replace(" [MPa]", ""))
    with pytest.raises(InputError, match="Druck.*no unit: is it MPa, kPa, bar or psi.*--unit initial_pressure=MPa"):
        import_tests(files, conditions=path)
    for heading, first, asks in (("shot", 1, ".*name it sequence"), ("hardness", 2, " write it .*pure number")):
        write(path, f"record,initial_pressure [MPa],v [m/s],{heading}\nshot0,1,0.4,{first}\nshot1,1,0.4,2\n")
        with pytest.raises(InputError, match=f"column {heading}: the column has no unit:{asks}"):
            import_tests(files, conditions=path)
    write(path, "record,initial_pressure [MPa],v [m/s],onset [ms]\nshot0,1,0.4,12.3\nshot1,1,0.4,12.3\n")
    campaign = import_tests(files, conditions=path)
    assert campaign.trace("shot0")["time"].iloc[0] == pytest.approx(-0.0123)
    assert "onset" not in campaign.conditions


def test_names(tmp_path):
    time, force = raw_trace()
    for name in ("1.0MPa_0.4ms", "1,5MPa_0.45ms"):
        write(tmp_path / f"{name}.csv", raw_text([time, force], ["t [s]", "Fz [N]"]))
    campaign = import_tests(tmp_path, name_pattern="{initial_pressure}MPa_{approach_speed}ms")
    assert list(campaign.records["initial_pressure"]) == [1.5e6, 1e6]
    assert list(campaign.records["approach_speed"]) == [0.45, 0.4]
    write_campaign(tmp_path / "campaign", campaign)
    again = import_tests([tmp_path / "1.0MPa_0.4ms.csv"], name_pattern="{initial_pressure:MPa}MPa_{}", speed="0.4 m/s")
    assert again.records["initial_pressure"].iloc[0] == 1e6
    with pytest.raises(InputError, match="does not match"):
        import_tests(tmp_path, name_pattern="p{initial_pressure}MPa")
    with pytest.raises(InputError, match="unit of pad"):
        import_tests(tmp_path, name_pattern="{pad}_{initial_pressure}MPa")


def test_a_trigger_says_nothing_of_a_contact_that_was_looked_for(tmp_path):
    """The time is no surer than the contact was found, whatever the trigger is; a larger stated error counts."""
    path = write(tmp_path / "a.csv", raw_text(raw_trace(), ["t [s]", "Fz [N]"]))
    found = import_tests(path, **CONDITIONS).uncertainty("time").absolute
    small, large = (import_tests(path, uncertainty=f"time={text}", **CONDITIONS) for text in ("0.1 us", "2 ms"))
    assert small.uncertainty("time").absolute == pytest.approx(found) and large.uncertainty("time").absolute == 2e-3
    assert sum("--onset" in note for note in small.notes) == 1 and not any("--onset" in note for note in large.notes)


def test_given_onset(tmp_path):
    time, force = raw_trace()
    path = write(tmp_path / "a.csv", raw_text([time, force], ["t [s]", "Fz [N]"]))
    campaign = import_tests(path, onset="12.3 ms", **CONDITIONS)
    assert campaign.trace("a")["time"].iloc[0] == pytest.approx(-0.0123)
    assert campaign.uncertainty("time").absolute == pytest.approx(1e-4 / 12**0.5, rel=1e-3)
    assert any("0.0289 ms" in note for note in campaign.notes)
    stated = import_tests(path, onset="12.3 ms", uncertainty="time=0.05 ms", **CONDITIONS)
    assert stated.uncertainty("time").absolute == 5e-5 and not any("0.0289 ms" in note for note in stated.notes)
    with pytest.raises(InputError, match="--onset"):
        import_tests(path, onset="soon", **CONDITIONS)


def test_slip_tests_need_a_stated_uncertainty(tmp_path):
    slip = np.linspace(0, 10, 50)
    text = raw_text([slip, 3 + 0.1 * slip], ["Slip [mm]", "Friction force [N]"])
    path = write(tmp_path / "a.csv", text)
    table = write(tmp_path / "c.txt", "record,normal load [N],p [bar],v [mm/s]\na,20,10,50\n")
    with pytest.raises(InputError, match="--uncertainty tangential_force="):
        import_tests(path, family="slip", conditions=table)
    campaign = import_tests(path, family="slip", conditions=table, uncertainty="force=0.04 N")
    again = write_campaign(tmp_path / "campaign", campaign)
    assert again.records.loc["a"].to_dict() == {"normal_load": 20, "internal_pressure": 1e6, "slip_speed": 0.05}
    assert again.independent.name == "slip" and again.trace("a")["slip"].iloc[-1] == 0.01


def test_tumbling_and_kept_columns(tmp_path):
    time = np.arange(40.0)
    columns = [time, *(np.cos(time / 5 + i) for i in range(3)), time * 0 + 7]
    headings = ["t [s]", "wx [deg/s]", "wy [deg/s]", "rate [deg/s]", "fill (%)"]
    path = write(tmp_path / "a.csv", raw_text(columns, headings))
    options = {"family": "tumble", "keep": ["angular_velocity_z=rate", "fill"], "known": ["orbit_rate=0.001 rad/s"]}
    noise = {f"angular_velocity_{axis}": "0.01 deg/s" for axis in "xyz"}
    campaign = write_campaign(tmp_path / "campaign", import_tests(path, uncertainty=noise, **options))
    assert list(campaign.channels) == ["angular_velocity_x", "angular_velocity_y", "angular_velocity_z"]
    assert campaign.trace("a")["angular_velocity_x"].iloc[0] == pytest.approx(np.pi / 180)
    assert campaign.records.loc["a", "fill"] == pytest.approx(0.07)
    assert campaign.known == {"inertia_ratio": None, "orbit_rate": 0.001}


TIME, FORCE = raw_trace()


def spoilt(line, cells, headings=("t [s]", "Fz [N]")):
    """A raw text with the cells of one line (header: line 1) replaced."""
    lines = raw_text([TIME, FORCE], headings).splitlines()
    lines[line - 1] = cells
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize(
    ("text", "options", "words"),
    [
        (raw_text([TIME, FORCE, FORCE], ["t [s]", "A [N]", "B [N]"]), {}, "A, B; give --force COLUMN"),
        (raw_text([TIME, FORCE, FORCE], ["t [s]", "Fz [N]", "Force [N]"]), {}, "Fz, Force; .* --force"),
        (raw_text([TIME, TIME, FORCE], ["t [s]", "Time [s]", "F [N]"]), {}, "--time COLUMN"),
        (raw_text([TIME, FORCE], ["t [s]", "Fz"]), {}, "column Fz.*--unit force=N"),
        (raw_text([TIME, FORCE], ["t", "Fz [N]"]), {}, "column t.*--unit time=s"),
        (raw_text([TIME, FORCE], ["t [s]", "Fz [V]"]), {}, "column Fz.*'V' does not measure normal_force"),
        (raw_text([TIME, FORCE], ["t [s]", "Fz [N]"]), {"pressure": None}, "initial_pressure is not .* --pressure"),
        (raw_text([TIME, FORCE], ["t [s]", "Fz [N]"]), {"speed": None}, "approach_speed is not known; give --speed"),
        (raw_text([TIME, FORCE], ["t [s]", "Fz [N]"]), {"speed": "0.4"}, "--speed.*needs a unit"),
        (raw_text([TIME, FORCE], ["t [s]", "Fz [N]"]), {"speed": "0.4 m"}, "--speed.*does not measure"),
        (raw_text([TIME, FORCE], ["t [s]", "Fz [N]"]), {"force": "Kraft"}, "no column 'Kraft'"),
        (raw_text([TIME, FORCE], ["t [s]", "Fz [N]"]), {"uncertainty": {"x": "1 N"}}, "--uncertainty names x"),
        (raw_text([TIME, FORCE], ["t [s]", "Fz [N]"]), {"uncertainty": "1 N"}, "--uncertainty takes NAME=VALUE"),
        (raw_text([TIME, FORCE], ["t [s]", "Fz [N]"]), {"decimal": "x"}, "--decimal"),
        (raw_text([TIME, FORCE], ["t [s]", "Fz [N]"]), {"delimiter": "x"}, "--delimiter"),
        (raw_text([TIME, FORCE], ["t [s]", "Fz [N]"]), {"family": "fall"}, "--family"),
        (raw_text([TIME, FORCE, FORCE], ["t [s]", "Fz [N]", "p [barg]"]), {}, "column p: .* --gauge and --ambient"),
        (raw_text([TIME, FORCE], ["t [s]", "Fz [N]"], decimal=","), {}, "line 1.*4 columns of data below 2 headings"),
        (raw_text([TIME, FORCE], ["t", "F"]), {}, "column t: .*, nor is that of F .force in N, kN or kgf.*s, ms "
                                                  r"or us.*--unit time=s .*import.toml: units = \{ time = .s. \}"),
        ("t [ms];Fz [N]\n" + "".join(f"{i},125;{i},250\n" for i in range(1, 99)), {}, "--decimal"),
        ("t [ms];Fz [N]\n" + "".join(f"{i}.125;{i},25\n" for i in range(1, 99)), {}, "points and some commas"),
        ("t [ms];Fz [N]\n" + "".join(f"{i};1.00{i % 9},25\n" for i in range(1, 99)), {}, "thousands"),
        (spoilt(50, "0.004800,OVR"), {}, "line 50, column Fz: 'OVR'"),
        (spoilt(50, "0.004800,NaN"), {}, "line 50, column Fz: 'NaN' is not a number"),
        (spoilt(50, "0.004800"), {}, "line 50: the row has 1 cells where others have 2"),
        (spoilt(50, "pause"), {}, "line 50"),
        (spoilt(5, "pause"), {}, "line 5: text interrupts the numbers"),
        (spoilt(50, "0.001000,1.5"), {}, "line 50, column time: .*goes back .*--record-column"),
        (spoilt(50, ",1.5"), {}, "line 50, column t: the cell is empty"),
        (spoilt(601, "End of data"), {}, "line 601"),
        (spoilt(1, "t [s],t [s]"), {}, "line 1: the heading 't \\[s\\]' occurs twice"),
        (raw_text([TIME, 0.2 * np.sin(9e3 * TIME)], ["t [s]", "Fz [N]"]), {}, "record 'a'.*--onset"),
        (raw_text([TIME[:200] + 0.0123, FORCE[123:323]], ["t [s]", "Fz [N]"]), {}, "--onset"),
        (raw_text([TIME[:4], FORCE[:4]], ["t [s]", "Fz [N]"]), {}, "only 4 samples .*at least 5"),
        (raw_text([TIME, pulse(TIME, 0.0123, 50)], ["t [s]", "Fz [N]"]), {}, "--uncertainty normal_force='0.25 N'"),
        ("", {}, "no rows"),
        ("t [s],Fz [N]\n", {}, "no rows"),
        ("just words\n", {}, "no rows"),
    ],
)  # fmt: skip
def test_what_cannot_be_told_is_asked_for(tmp_path, text, options, words):
    path = write(tmp_path / "a.csv", text)
    with pytest.raises(InputError, match=words) as caught:
        import_tests([path], **(CONDITIONS | options))
    assert "\n" not in str(caught.value)


def test_paths(tmp_path):
    with pytest.raises(InputError, match="does not exist"):
        import_tests([tmp_path / "none.csv"], **CONDITIONS)
    with pytest.raises(InputError, match="no raw files"):
        import_tests(tmp_path, **CONDITIONS)
    with pytest.raises(InputError, match="at least one"):
        import_tests([], **CONDITIONS)
    text = raw_text([TIME, FORCE], ["t [s]", "Fz [N]"])
    (tmp_path / "b").mkdir()
    files = [write(tmp_path / "a.csv", text), write(tmp_path / "b" / "a.csv", text)]
    with pytest.raises(InputError, match="'a' occurs twice"):
        import_tests(files, **CONDITIONS)


@pytest.mark.parametrize(
    ("heading", "name", "unit"),
    [("Fz [N]", "Fz", "N"), ("t (ms)", "t", "ms"), ("v / (mm/s)", "v", "mm/s"), ("p / bar(ü)", "p", "bar(ü)"),
     ("Force_N", "Force", "N"), ("Time/s", "Time", "s"),
     ("Kraft in kN", "Kraft", "kN"), ("velocity_m_s", "velocity", "m/s"), ("Fz (filtered)", "Fz (filtered)", None),
     ("F_N", "F_N", None), ("normal_force", "normal_force", None), ("e [-]", "e", "-"), ("test_no", "test_no", None),
     ("angular_velocity_y", "angular_velocity_y", None), ("p [bar(g)]", "p", "bar(g)"), ("t", "t", None),
     ("Force_1", "Force_1", None), ("t_s", "t", "s"), ("t_ms", "t", "ms"), ("t_N", "t_N", None),
     ("omega_dps 1", "omega 1", "dps"), ("omega_dps 2", "omega 2", "dps"), ("Fz [N] 2", "Fz 2", "N"),
     ("omega 1", "omega 1", None), ("column 1", "column 1", None), ("Sensor in 2", "Sensor in 2", None)],
)  # fmt: skip
def test_headings(heading, name, unit):
    assert split_heading(heading) == (name, unit)


def test_columns_without_values_are_dropped_and_trailing_delimiters_borne(tmp_path):
    text = "t [s];Fz [N];\n" + "".join(f"{i};{i};\n" for i in range(9))
    raw = read_layout(write(tmp_path / "a.csv", text))
    assert list(raw.columns) == ["t", "Fz"]


def test_the_table_of_conditions_may_lie_among_the_records(tmp_path):
    for i in range(2):
        time, force = raw_trace(seed=i)
        write(tmp_path / f"shot{i}.csv", raw_text([time, force], ["t [s]", "Fz [N]"]))
    table = write(tmp_path / "settings.csv", "file,p0 [MPa],v [m/s],repeat\nshot0.csv,1,0.4,1\nshot1.csv,1,0.4,2\n")
    campaign = import_tests(sorted(tmp_path.glob("*.csv")), conditions=table)
    assert campaign.record_keys == ("shot0", "shot1")
    assert list(campaign.records.columns) == ["initial_pressure", "approach_speed"]  # repeats are one condition


def test_a_unit_given_against_the_heading_is_told(tmp_path):
    time, force = raw_trace()
    path = write(tmp_path / "a.csv", raw_text([time, force], ["t [s]", "Fz [N]"]))
    campaign = import_tests(path, units="Fz=kN", **CONDITIONS)
    assert any(("normal_force", "N", "kN") in doubt.mistakes for doubt in check_plausibility(campaign))
    assert not check_plausibility(import_tests(path, units="Fz=N", **CONDITIONS))


def test_the_unit_that_a_file_states_is_kept_and_asked_about(tmp_path):
    """Bar under a heading in kPa: the question names that unit and the right one, also of the campaign read back."""
    for i in range(3):
        time, force = raw_trace(seed=i)
        write(tmp_path / f"shot{i}.csv", raw_text([time, force], ["t [s]", "Fz [N]"]))
    table = write(tmp_path / "settings.csv", "file,p0 [kPa],v [m/s]\nshot0,10,0.4\nshot1,11,0.4\nshot2,12,0.4\n")
    campaign = import_tests(sorted(tmp_path.glob("shot*.csv")), conditions=table)
    again = read_campaign(write_campaign(tmp_path / "out", campaign).path)
    for one in (campaign, again):
        assert one.column("initial_pressure").stated == "kPa" and one.column("normal_force").stated == "N"
        (doubt,) = check_plausibility(one)
        assert ("initial_pressure", "bar", "kPa") in doubt.mistakes
        assert {unit for name, _, unit in doubt.mistakes if name == "initial_pressure"} == {"kPa"}


def test_the_unit_of_an_option_is_kept(tmp_path):
    time, force = raw_trace()
    path = write(tmp_path / "a.csv", raw_text([time, force], ["t [s]", "Fz [N]"]))
    campaign = write_campaign(tmp_path / "out", import_tests(path, pressure="10 bar", speed="40 cm/s"))
    assert (campaign.column("initial_pressure").stated, campaign.column("approach_speed").stated) == ("bar", "cm/s")
    wrong = import_tests(path, pressure="10 kPa", speed="0.4 m/s")  # bar
    (doubt,) = check_plausibility(wrong)
    assert {stated for name, _, stated in doubt.mistakes if name == "initial_pressure"} == {"kPa"}


def test_the_unit_of_gauge_pressures_is_asked_about(tmp_path):
    """The ambient pressure that was added to them is no part of the mistake."""
    for i in range(3):
        time, force = raw_trace(seed=i)
        write(tmp_path / f"shot{i}.csv", raw_text([time, force], ["t [s]", "Fz [N]"]))
    rows = "shot0,42,0.4\nshot1,43,0.4\nshot2,44,0.4\n"
    for stated in ("kPa", "MPa", "psi"):
        table = write(tmp_path / "settings.csv", f"file,p0 [{stated}],v [m/s]\n{rows}")
        campaign = import_tests(sorted(tmp_path.glob("shot*.csv")), conditions=table, gauge=True, ambient="1 bar")
        again = read_campaign(write_campaign(tmp_path / "out", campaign, overwrite=True).path)
        for one in (campaign, again):
            assert one.column("initial_pressure").gauge and not one.column("normal_force").gauge
            (doubt,) = check_plausibility(one)
            assert ("initial_pressure", "bar", stated) in doubt.mistakes
        twice = write_campaign(tmp_path / "out", again, overwrite=True)
        assert twice.column("initial_pressure") == again.column("initial_pressure")


@pytest.mark.parametrize(("name", "near"), [
    ("diameter", "outer_diameter"), ("outer diameter", "outer_diameter"), ("mass", "effective_mass"),
    ("restitutoin", "restitution"), ("approach_speed", "condition")])
def test_a_known_number_that_no_model_has_is_refused(tmp_path, name, near):
    time, force = raw_trace()
    path = write(tmp_path / "a.csv", raw_text([time, force], ["t [s]", "Fz [N]"]))
    with pytest.raises(InputError) as caught:
        import_tests(path, known={name: "60 mm"}, **CONDITIONS)
    assert caught.value.option == "--known" and name in str(caught.value) and near in str(caught.value)


def test_every_parameter_of_a_reference_model_may_be_known_and_no_other_is_listed():
    """In the unit that the models have it in; the pressure of the day belongs to the tests, not to a model."""
    of_models: dict[str, set[str]] = {}
    for family in [one for one in list_families() if one.kind.name in KINDS]:
        units = {p.name: p.unit or "1" for built in family.models.values() for p in parameters_of(built.make())}
        listed = family.kind.parameters
        assert set(units) <= {*family.kind.unknown, *listed}, family.name
        assert {name: listed[name] for name in units if name in listed} == {
            name: unit for name, unit in units.items() if name in listed}, family.name
        of_models.setdefault(family.kind.name, set()).update(units)
    for name, there in of_models.items():
        assert {*KINDS[name].parameters} - there <= {"ambient_pressure"}, name


def test_a_known_number_is_kept_in_the_unit_of_its_parameter(tmp_path):
    """Also where its name does not say what it measures; a bare zero is one in any unit."""
    time = np.arange(0.0, 1.0, 0.01)
    path = write(tmp_path / "a.csv", raw_text([time, 0.1 * time, 5.0 + 0.0 * time + 0.01 * np.sin(time)],
                                              ["t [s]", "slip [m]", "Ft [N]"]))

    def take(known):
        return import_tests(path, family="slip", known=known, pressure="0.1 MPa", speed="0.1 m/s", load="20 N",
                            uncertainty="force=0.1 N")

    known = {"sum_0": 0.25, "difference_0": 2e-3, "sum_1": 0.0, "a_0": 0.3}
    campaign = take(["sum_0=0.25 1/mm", "difference_0=2 1/m", "sum_1=0", "a_0=30 %"])
    written = write_campaign(tmp_path / "out", campaign)
    for one in (campaign, written):
        assert {name: one.known[name] for name in known} == pytest.approx(known)
    about = tabulate_campaign(campaign)["about"].set_index("item")
    assert about.loc["known sum_0", "unit"] == "1/mm"
    for wrong in ("sum_0=0.25", "sum_0=0.25 mm", "a_0=3 mm", "tensile_strength=0"):
        with pytest.raises(InputError, match=wrong.split("=")[0]):
            take([wrong])
    with pytest.raises(InputError, match="needs a unit"):
        read_known("temperature", "0")


def test_a_known_number_of_a_model_of_ones_own_is_kept_and_told(tmp_path):
    time, force = raw_trace()
    path = write(tmp_path / "a.csv", raw_text([time, force], ["t [s]", "Fz [N]"]))
    campaign = import_tests(path, known={"spring_rate": "20 kN/m", "stiffness_force": "2 kN"}, **CONDITIONS)
    again = write_campaign(tmp_path / "out", campaign)
    assert campaign.known["spring_rate"] == again.known["spring_rate"] == 20e3 and again.known["stiffness_force"] == 2e3
    (note,) = [note for note in campaign.notes if "spring_rate" in note]
    assert "your own" in note and not any("stiffness_force" in note for note in campaign.notes)


@pytest.mark.parametrize(("cell", "words"), [
    ("0", "initial_pressure"), ("-0.2", "negative"), ("", "every test"), ("nan", "every test"), ("n/a", "every test")])
def test_a_setting_that_no_test_has_is_refused_with_its_row(tmp_path, cell, words):
    for i in range(3):
        time, force = raw_trace(seed=i)
        write(tmp_path / f"shot{i}.csv", raw_text([time, force], ["t [s]", "Fz [N]"]))
    table = write(tmp_path / "set.csv", f"file,p0 [MPa],v [m/s]\nshot0,1.0,0.4\nshot1,{cell},0.4\nshot2,1.2,0.4\n")
    with pytest.raises(InputError) as caught:
        import_tests(sorted(tmp_path.glob("shot*.csv")), conditions=table)
    error = caught.value
    assert (error.file, error.column, error.row) == (str(table), "p0", 3) and words in error.problem


def test_tests_without_gas_are_imported(tmp_path):
    time, force = raw_trace()
    path = write(tmp_path / "a.csv", raw_text([time, force], ["t [s]", "Fz [N]"]))
    campaign = import_tests(path, pressure="0 bar", speed="0.4 m/s")
    assert campaign.records["initial_pressure"].tolist() == [0.0]


def test_an_acceleration_becomes_a_force(tmp_path):
    """phyphox, a phone's own gauges: time, accelerations and rates with their headings."""
    time, force = raw_trace(onset=0.1, noise=0.02, rate=2e3, length=0.2)
    headings = ["Time (s)", "Linear Acceleration x (m/s^2)", "Linear Acceleration z (m/s^2)"]
    path = write(tmp_path / "a.csv", raw_text([time, 0 * force, -force / 1.5], headings))
    options = {"force": "Linear Acceleration z"} | CONDITIONS
    with pytest.raises(InputError, match="--known .*effective_mass"):
        import_tests(path, **options)
    campaign = import_tests(path, known="effective_mass=1.5 kg", **options)
    assert campaign.trace("a")["normal_force"].max() == pytest.approx(50, abs=0.2)
    assert campaign.known["effective_mass"] == 1.5


def write_rates(path, start=0.0, axes="xyz", gyroscope="Gyroscope {} (rad/s)"):
    """A free body of revolution about the last of the axes, inertia ratio 0.5, as a phone would write it."""
    time = start + np.arange(120) * 0.2
    turning = {axes[0]: 0.2 * np.cos(0.25 * time), axes[1]: -0.2 * np.sin(0.25 * time), axes[2]: 0 * time + 0.5}
    columns = [turning[axis] for axis in "xyz"]
    return write(path, raw_text([time, *columns, time * 0 + 9.8],
                                ["Time (s)", *map(gyroscope.format, "xyz"), "Acceleration z (m/s^2)"]))


@pytest.mark.slow
def test_tumbling_records_begin_at_zero(tmp_path):
    noise = {f"angular_velocity_{axis}": "0.001 rad/s" for axis in "xyz"}
    path = write_rates(tmp_path / "a.csv", start=10.5)
    campaign = write_campaign(tmp_path / "campaign", import_tests(path, family="tumble", uncertainty=noise))
    assert list(campaign.channels) == ["angular_velocity_x", "angular_velocity_y", "angular_velocity_z"]
    assert campaign.trace("a")["time"].iloc[0] == 0.0
    fitted = dd.fit(campaign, noise="stated")
    assert fitted.parameters["inertia_ratio"].estimate == pytest.approx(0.5, abs=0.01)


@pytest.mark.parametrize(("axis", "axes"), [("x", "yzx"), ("y", "zxy"), ("z", "xyz")])
def test_any_axis_may_be_that_of_symmetry(tmp_path, axis, axes):
    noise = {f"angular_velocity_{axis}": "0.001 rad/s" for axis in "xyz"}
    wanted = import_tests(write_rates(tmp_path / "a.csv"), family="tumble", uncertainty=noise)
    (tmp_path / "turned").mkdir()
    path = write_rates(tmp_path / "turned" / "a.csv", axes=axes)
    campaign = import_tests(path, family="tumble", uncertainty=noise, symmetry_axis=axis)
    pd.testing.assert_frame_equal(campaign.trace("a"), wanted.trace("a"))
    with pytest.raises(InputError, match="--symmetry-axis"):
        import_tests(path, family="tumble", uncertainty=noise, symmetry_axis="w")


def test_a_displacement_that_moves_before_contact_is_zeroed_at_the_onset(tmp_path):
    """A sensor of the arm's position, with a zero of its own and counting backwards."""
    base, lead = {"effective_mass": 1.2, "restitution": 0.8}, 0.02
    for k, speed in enumerate((0.3, 0.4, 0.5)):
        time = np.arange(0.0, 0.09, 1e-4)
        conditions = {"initial_pressure": 1.2e6, "approach_speed": speed}
        force, depth = simulate(base, {}, conditions, time - lead, ("normal_force", "depression")).T
        end = time[np.flatnonzero(depth > 0)[-1]]
        position = np.where(time > end, -0.8 * speed * (time - end), depth)
        position = np.where(time < lead, speed * (time - lead), position)
        rng = np.random.default_rng(k)
        columns = [time, force + 0.2 * rng.standard_normal(time.size),
                   132.4 - 1e3 * position + 0.01 * rng.standard_normal(time.size), 0 * time + speed]
        headings = ["t [s]", "Fz [N]", "depth (mm)", "v [m/s]"]
        write(tmp_path / f"{k}.csv", raw_text(columns, headings))
    found = import_tests(tmp_path, pressure="1.2 MPa", known="outer_diameter=60 mm")
    campaign = write_campaign(tmp_path / "campaign", found)
    trace = campaign.trace("1")
    inside = trace["depression"].notna()
    assert trace["time"][inside].min() > 0 and 0.02 < trace["time"][inside].max() < 0.05
    model = simulate(base, {}, {"initial_pressure": 1.2e6, "approach_speed": 0.4}, trace["time"], ("depression",))[:, 0]
    zero = campaign.column("depression").common
    assert zero is not None and zero.absolute is not None and zero.absolute < 4e-4
    assert np.abs(trace["depression"] - model)[inside].max() < 2 * zero.absolute
    assert campaign.uncertainty("depression").absolute == pytest.approx(1e-5, rel=0.3)


def test_no_sample_of_the_approach_counts_as_depression(tmp_path):
    """Soft starts, which are found some samples early: there the arm still comes nearer, and the ball is round."""
    base, lead, time = {"effective_mass": 1.2, "restitution": 0.8}, 0.02, np.arange(0.0, 0.12, 1e-4)
    speeds = (0.15, 0.2, 0.3, 0.15, 0.2, 0.3)
    for k, speed in enumerate(speeds):
        conditions = {"initial_pressure": 1.2e6, "approach_speed": speed}
        force, depth = simulate(base, {}, conditions, time - lead, ("normal_force", "depression")).T
        end = time[np.flatnonzero(depth > 0)[-1]]
        position = np.where(time > end, -0.8 * speed * (time - end), depth)
        position = np.where(time < lead, speed * (time - lead), position)
        rng = np.random.default_rng(k)
        force = force + 0.01 * force * rng.standard_normal(time.size) + 0.05 * rng.standard_normal(time.size)
        columns = [time, force, 1e3 * position + 0.01 * rng.standard_normal(time.size), 0 * time + speed]
        write(tmp_path / f"{k}.csv", raw_text(columns, ["t [s]", "Fz [N]", "depth (mm)", "v [m/s]"]))
    campaign = import_tests(tmp_path, pressure="1.2 MPa", known="outer_diameter=60 mm")
    for k in range(len(speeds)):
        inside = campaign.trace(str(k))["depression"].notna().to_numpy()
        assert inside.sum() > 200 and time[inside].min() > lead


@pytest.mark.parametrize(("options", "words"), [
    ({"known": "outer_diameter=60"}, "--known outer_diameter"),
    ({"known": "outer_diameter=-1 mm"}, "--known outer_diameter"),
    ({"ambient": "1 m"}, "--ambient"),
    ({"uncertainty": "force=1 m"}, "--uncertainty"),
    ({"common_uncertainty": "force=1 m"}, "--common-uncertainty"),
    ({"common_uncertainty": "x=1 N"}, "--common-uncertainty"),
    ({"symmetry_axis": "x"}, "--symmetry-axis"),
    ({"pressure": "10 bar(g)"}, "--pressure.* --gauge"),
])  # fmt: skip
def test_messages_name_the_option(tmp_path, options, words):
    path = write(tmp_path / "a.csv", raw_text([TIME, FORCE], ["t [s]", "Fz [N]"]))
    with pytest.raises(InputError, match=words):
        import_tests(path, **(CONDITIONS | options))


def test_a_new_folder_appears_whole_or_not_at_all(tmp_path, monkeypatch):
    campaign = import_tests(write(tmp_path / "a.csv", raw_text([TIME, FORCE], ["t [s]", "Fz [N]"])), **CONDITIONS)
    moved, replace = [], os.replace
    monkeypatch.setattr(os, "replace", lambda source, target: (moved.append(target), replace(source, target)))
    folder = tmp_path / "campaign"
    write_campaign(folder, campaign)
    (tmp_path / "other").mkdir()
    assert moved == [folder] and folder.stat().st_mode == (tmp_path / "other").stat().st_mode

    def fail(source, target):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", fail)
    before = sorted(tmp_path.iterdir())
    with pytest.raises(InputError, match="No space left"):
        write_campaign(tmp_path / "new", campaign)
    assert sorted(tmp_path.iterdir()) == before


def test_a_folder_that_is_taken_names_the_option(tmp_path):
    path = write(tmp_path / "a.csv", raw_text([TIME, FORCE], ["t [s]", "Fz [N]"]))
    campaign = import_tests(path, **CONDITIONS)
    write_campaign(tmp_path / "campaign", campaign)
    with pytest.raises(InputError, match="--overwrite"):
        write_campaign(tmp_path / "campaign", campaign)


@pytest.mark.parametrize(("options", "place", "named"), [
    ({"uncertainty": {"force": "0.2 N", "normal_force": "0.4 N"}}, "--uncertainty", "normal_force"),
    ({"force": "Fzz"}, None, "'Fz'"), ({"drop": ["tt"]}, None, "'t'"),
])
def test_slips_of_the_pen_are_told_with_what_may_be_meant(tmp_path, options, place, named):
    """One quantity under two names, and a heading that is nearly one of the file."""
    path = write(tmp_path / "a.csv", raw_text(raw_trace(), ["t [s]", "Fz [N]"]))
    with pytest.raises(InputError, match=re.escape(named)) as refused:
        import_tests(path, **{**CONDITIONS, **options})
    assert refused.value.option == place


def test_a_workbook_as_its_own_table_of_conditions_needs_a_sheet(tmp_path):
    path = write(tmp_path / "a.csv", raw_text(raw_trace(), ["t [s]", "Fz [N]"]))
    with pytest.raises(InputError, match="SHEET") as refused:
        import_tests(path, conditions=path)
    assert refused.value.option == "--conditions"


def test_notes_beside_the_measurements_are_left_out_and_told(tmp_path, capsys):
    """A text without rows of numbers is no test; a file that is named, or holds some, is read or refused as before."""
    folder = tmp_path / "runs"
    folder.mkdir()
    write(folder / "a.csv", raw_text(raw_trace(), ["t [s]", "Fz [N]"]))
    notes = write(folder / "notes.txt", "12 May, cold. Gauge set to zero after shot 1.\n\nBall 2.\n")
    campaign = import_tests(folder, **CONDITIONS)
    assert campaign.record_keys == ("a",) and any("notes.txt" in note for note in campaign.notes)
    assert main(["import", str(folder), "--list"]) == 0
    told = capsys.readouterr().out
    assert "Fz [N]" in told and "notes.txt" in told
    with pytest.raises(InputError):
        import_tests([folder, notes], **CONDITIONS)
    for rows in ("t [s],Fz [N]\n0.0,0.1\n0.001\n", "t [s];Fz [N];state;by;gauge\n0;0,1;ok;RS;HBM\n"):
        write(folder / "b.csv", rows)
        with pytest.raises(InputError, match="b.csv"):
            import_tests(folder, **CONDITIONS)
    (folder / "a.csv").unlink()
    (folder / "b.csv").unlink()
    with pytest.raises(InputError, match="runs"):
        import_tests(folder, **CONDITIONS)


def test_a_german_heading_names_the_records(tmp_path):
    """`Lauf` is a run, as `Versuch` is."""
    write(tmp_path / "3.csv", raw_text(raw_trace(), ["t [s]", "Fz [N]"]))
    write(tmp_path / "set.csv", "Lauf;Druck [bar];Geschwindigkeit [mm/s]\n3;10,5;400\n")
    campaign = import_tests(tmp_path / "3.csv", conditions=tmp_path / "set.csv")
    assert float(campaign.records["initial_pressure"].iloc[0]) == pytest.approx(1.05e6)


def write_shot(path, number, onset):
    """One test of several: a trace, pulled where it is pressed, with settings of names of its own."""
    time, force = raw_trace(onset=onset, offset=0.2 * number, seed=number)
    return write_tdms(path, {"DAQ": {"Fz": ("N", time[1] - time[0], -force)}},
                      {"DAQ": {"p_Ball [bar]": 10.0 + number, "v_Impact [m/s]": 0.3}})


def test_settings_of_other_names_are_found_by_their_units(tmp_path):
    """A condition that nothing gives is asked about by the single value of the files that has its unit, in words that
    can be typed; a channel goes by its heading, too; a quantity of two columns is refused.
    """
    path = write_shot(tmp_path / "a.tdms", 0, 0.02)
    with pytest.raises(InputError) as caught:
        import_tests(path)
    assert "--keep 'initial_pressure=p_Ball'" in str(caught.value)
    keep = ["initial_pressure=p_Ball", "approach_speed=v_Impact"]
    campaign = import_tests(path, keep=keep, reverse="Fz")
    assert campaign.records["initial_pressure"].iloc[0] == pytest.approx(1e6)
    pd.testing.assert_frame_equal(campaign.samples, import_tests(path, keep=keep, reverse="force").samples)
    with pytest.raises(InputError, match="two columns"):
        import_tests(path, keep=[*keep, "p0=v_Impact"])


def test_onsets_of_many_records_are_told_in_sum(tmp_path):
    """The first and the last, by their records; of few records each."""
    paths = [write_shot(tmp_path / f"shot{k}.tdms", k, 0.02 + 0.001 * ((3 * k) % 7)) for k in range(7)]
    keep = ["initial_pressure=p_Ball", "approach_speed=v_Impact"]
    many = [one for one in import_tests(paths, keep=keep).notes if "raw time" in one or "Offsets" in one]
    assert len(many) == 2 and "shot0" in many[0] and "shot2" in many[0]
    assert "shot6" in many[1] and "shot0" not in many[1]
    few = [one for one in import_tests(paths[:3], keep=keep).notes if "raw time" in one]
    assert len(few) == 3 and all(any(f"shot{k}" in one for one in few) for k in range(3))


def test_a_gyroscope_taken_for_a_force_is_asked_about(tmp_path):
    """Axes that are called as gyroscopes call theirs name the family; with it they are the rates."""
    headings = ["t [s]", *(f"g{axis} [deg/s]" for axis in "xyz")]
    path = write(tmp_path / "spin.csv", raw_text([np.arange(9.0)] * 4, headings))
    with pytest.raises(InputError, match="--family tumble"):
        import_tests(path)
    campaign = import_tests(path, family="tumble", uncertainty="angular_velocity=0.01 deg/s")
    np.testing.assert_allclose(campaign.samples["angular_velocity_y"], np.radians(np.arange(9.0)))
