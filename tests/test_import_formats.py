"""Import of the files that laboratories have: every format to the same campaign, and every fault in one sentence."""

import sys
import zipfile

import h5py
import numpy as np
import pandas as pd
import pytest
from helpers_formats import (
    CONDITIONS,
    FORMATS,
    STEP,
    TIME,
    UNITLESS,
    as_rows,
    channels,
    clocked,
    trace,
    write_bag,
    write_csv,
    write_hdf5,
    write_matlab,
    write_mcap,
    write_mdf,
    write_nexus,
    write_parquet,
    write_sheet,
    write_sheets,
    write_tdms,
    write_universal,
)

import ddetumble as dd
from ddetumble.cli import main
from ddetumble.measurement import recordings
from docs.fuzz_readers import prepare, try_one


FILES = [name for name in FORMATS if "." in name]
GAS = ("bar", 4 * STEP, np.round(10 + np.linspace(0, 1, 128), 4))  # a slower channel with a clock of its own


def make(folder, name, held=None):
    """A file of a format, by its name in `FORMATS`."""
    write, default = FORMATS[name]
    folder.mkdir(exist_ok=True)
    return write(folder / name, default() if held is None else held)


def refuse(path, *parts, **options):
    """Import fails with one sentence that has the name of the file and these parts."""
    with pytest.raises(dd.InputError) as caught:
        dd.import_tests(path, **(CONDITIONS | options))
    sentence = str(caught.value)
    missing = [part for part in (str(path), *parts) if part not in sentence]
    assert not missing and "\n" not in sentence, (missing, sentence)
    return sentence


def take_samples(campaign):
    return campaign.samples.drop(columns="record")


@pytest.mark.parametrize("name", FORMATS)
def test_every_format_gives_the_same_campaign(tmp_path, name):
    wanted = dd.import_tests(write_csv(tmp_path / "run.csv", channels()), **CONDITIONS)
    campaign = dd.import_tests(make(tmp_path, name), **CONDITIONS, **UNITLESS.get(name, {}))
    assert campaign.record_keys == (name.partition(".")[0],)
    pd.testing.assert_frame_equal(take_samples(campaign), take_samples(wanted), check_exact=True)
    assert campaign.uncertainty("normal_force") == wanted.uncertainty("normal_force")
    assert dd.write_campaign(tmp_path / "campaign", campaign).record_keys == campaign.record_keys


def test_ros_in_mcap_and_in_a_folder_of_raw_files(tmp_path):
    write_bag(tmp_path / "lab" / "a", clocked(), "MCAP")
    write_bag(tmp_path / "lab" / "b", clocked())
    told = {"units": "force=N", "force": "wrench.force.z"}
    campaign = dd.import_tests(tmp_path / "lab", **CONDITIONS, **told)
    assert campaign.record_keys == ("a", "b")
    alone = dd.import_tests(next((tmp_path / "lab" / "a").glob("*.mcap")), **CONDITIONS, **told)
    wanted = campaign.trace("a")["normal_force"].to_numpy()
    np.testing.assert_array_equal(alone.samples["normal_force"].to_numpy(), wanted)


@pytest.mark.parametrize("name, write", [("a.tdms", write_tdms), ("a.mf4", write_mdf), ("a.nxs", write_nexus),
                                         ("a.uff", write_universal)])
def test_each_channel_keeps_its_own_clock(tmp_path, name, write):
    path = write(tmp_path / name, clocked(p=GAS))
    campaign = dd.import_tests(path, speed="0.4 m/s")
    samples, alone = campaign.samples, dd.import_tests(path, **CONDITIONS).samples
    assert list(samples["normal_force"]) == list(alone["normal_force"]) and len(samples) == 512
    there = samples["pressure"].notna().to_numpy()
    assert there.sum() == 128 and there[::4].all()
    np.testing.assert_array_equal(samples["pressure"].to_numpy()[::4], GAS[2] * 1e5)
    assert any("clocks of their own" in note for note in campaign.notes)
    written = dd.write_campaign(tmp_path / "campaign", campaign)
    assert written.samples["pressure"].notna().sum() == 128


def test_clocks_that_do_not_meet(tmp_path):
    """Samples between those of the force are rows of their own, and rounded times are one time."""
    gas = ("bar", 0.6 * STEP, np.linspace(10, 11, 800))
    campaign = dd.import_tests(write_tdms(tmp_path / "a.tdms", clocked(p=gas)), speed="0.4 m/s")
    samples = campaign.samples
    assert samples["normal_force"].notna().sum() == 512 and samples["pressure"].notna().sum() == 800
    assert np.diff(samples["time"]).min() > 0.1 * STEP and len(samples) < 512 + 800
    assert campaign.uncertainty("time").absolute < STEP


def test_units_of_every_format_are_converted(tmp_path):
    wanted = dd.import_tests(write_csv(tmp_path / "run.csv", channels()), **CONDITIONS)
    held = {"Zeit": ("ms", TIME * 1e3), "Kraft": ("kN", trace() / 1000)}
    for write, name in ((write_matlab, "a.mat"), (write_hdf5, "a.h5"), (write_parquet, "a.parquet"),
                        (write_tdms, "a.tdms"), (write_sheet, "a.xlsx")):
        samples = take_samples(dd.import_tests(write(tmp_path / name, held), **CONDITIONS))
        np.testing.assert_allclose(samples, take_samples(wanted), rtol=1e-9, atol=1e-9)


def test_headings_hold_units_where_a_format_has_none(tmp_path):
    held = {"Time_s": (None, TIME), "Force_N": (None, trace())}
    for name in ("run.mat", "run73.mat", "run.h5", "run.parquet"):
        assert len(dd.import_tests(make(tmp_path, name, held), **CONDITIONS).samples) == TIME.size
    held = {"t": (None, TIME), "Fz": (None, trace())}
    refuse(make(tmp_path, "run.mat", held), "column t", "--unit")


def test_settings_beside_the_channels_are_conditions(tmp_path):
    held = channels(p0=("bar", [10.0]), v0=("m/s", [0.4]))
    for name in ("run.mat", "run.h5"):
        campaign = dd.import_tests(make(tmp_path, name, held))
        assert campaign.records.iloc[0].to_dict() == {"initial_pressure": 1e6, "approach_speed": 0.4}


def test_a_structure_of_each_test(tmp_path):
    from scipy.io import savemat

    shots = [{"t": TIME, "Fz": trace(peak), "units": {"t": "s", "Fz": "N"}} for peak in (40.0, 50.0)]
    savemat(tmp_path / "a.mat", {"shot": np.array(shots, dtype=object), "author": "Ann"})
    refuse(tmp_path / "a.mat", "shot(1)", "shot(2)", "--sheet")
    campaign = dd.import_tests(tmp_path / "a.mat", sheet="shot*", **CONDITIONS)
    assert campaign.record_keys == ("a-shot(1)", "a-shot(2)")
    one = dd.import_tests(tmp_path / "a.mat", sheet="shot(2)", **CONDITIONS)
    assert one.record_keys == ("a-shot(2)",) and one.samples["normal_force"].max() > 49


@pytest.mark.parametrize("ending", ["xlsx", "ods"])
def test_a_workbook_with_settings_and_tests(tmp_path, ending):
    settings = [["Bench 3", None, None], ["record", "p [bar]", "v [m/s]"], ["book-shot 1", 10, 0.4],
                ["book-shot 2", 12, 0.5]]
    sheets = {"settings": settings} | {
        f"shot {i}": [["Operator", "Ann"], *as_rows({"t": ("s", TIME), "Fz": ("N", trace(peak))})]
        for i, peak in ((1, 40.0), (2, 50.0))}
    path = write_sheets(tmp_path / f"book.{ending}", sheets)
    refuse(path, "settings", "shot 1", "shot 2", "--sheet")
    for sheet in ("shot*", "*"):
        campaign = dd.import_tests(path, sheet=sheet, conditions=f"{path}:settings")
        assert list(campaign.records["initial_pressure"]) == [1e6, 1.2e6]
    refuse(path, "'trial'", "shot 1", "--sheet", sheet="trial")
    refuse(path, "book", "settings", conditions=f"{path}:shots", sheet="shot*")
    (tmp_path / "a.csv").write_text("t,F\n1,2\n2,3\n")
    refuse(tmp_path / "a.csv", "--sheet", sheet="Data")


@pytest.mark.parametrize("ending", ["xlsx", "ods"])
def test_conditions_in_a_spreadsheet_of_their_own(tmp_path, ending):
    write_tdms(tmp_path / "a.tdms", clocked())
    write_hdf5(tmp_path / "b.h5", channels())
    table = write_sheets(tmp_path / f"settings.{ending}", {
        "Table": [["file", "p [bar]", "v [m/s]"], ["a.tdms", 10.0, 0.4], ["b.h5", 12.5, 0.5]]})
    for given in (table, f"{table}:Table"):
        campaign = dd.import_tests(tmp_path, conditions=given)
        assert list(campaign.records["initial_pressure"]) == [1e6, 1.25e6]
        assert list(campaign.records["approach_speed"]) == [0.4, 0.5]
    write_sheets(table, {"Table": [["file", "p [bar]", "v [m/s]"], ["a.tdms", "ten", 0.4], ["b.h5", 12.5, 0.5]]})
    with pytest.raises(dd.InputError) as caught:
        dd.import_tests(tmp_path, conditions=table)
    assert {str(table), "sheet Table", "column p", "line 2"} <= set(str(caught.value).partition(": ")[0].split(", "))


@pytest.mark.parametrize("name", [pytest.param(name, marks=pytest.mark.study if name == "run.mf4" else ())
                                  for name in FILES])
def test_files_cut_off_or_of_another_kind(tmp_path, name):
    """Cut anywhere, a file is refused; so is text under its ending."""
    path = make(tmp_path, name)
    data = path.read_bytes()
    for end in (0, 10, 200, len(data) // 2, len(data) - 9):
        path.write_bytes(data[:end])
        refuse(path, **UNITLESS.get(name, {}))
    path.write_text("t [s],Fz [N]\n" + "0.1,2\n" * 600)
    refuse(path)
    path.write_bytes(b"")
    refuse(path, "empty")
    damaged = bytearray(data)
    damaged[len(data) // 3 : len(data) // 3 + 64] = bytes(range(190, 254))
    path.write_bytes(damaged)
    try:  # numbers may be damaged without a trace, but nothing else than a sentence comes of it
        dd.import_tests(path, **CONDITIONS, **UNITLESS.get(name, {}))
    except dd.InputError as error:
        assert str(path) in str(error)


def test_properties_of_tdms_groups_are_conditions(tmp_path):
    """Numbers that a program wrote beside the channels of a test, once their units are known; no words, no flags."""
    groups = {name: clocked() for name in ("shot 1", "shot 2")}
    about = {name: {"pressure": pressure, "v [m/s]": np.float32(0.5), "operator": "JB", "good": True}
             for name, pressure in (("shot 1", 10.0), ("shot 2", 12))}
    path = write_tdms(tmp_path / "a.tdms", groups, about)
    found = dd.import_tests(path, sheet="*", units=["pressure=bar"])
    assert list(found.records["initial_pressure"]) == pytest.approx([1e6, 1.2e6])
    assert list(found.records["approach_speed"]) == [0.5, 0.5] and set(found.records) == set(found.conditions)
    with pytest.raises(dd.InputError) as caught:
        dd.import_tests(path, sheet="*")
    assert caught.value.column == "pressure"
    with pytest.raises(dd.InputError):
        dd.import_tests(path, sheet="*", units=["pressure=bar"], pressure="1 MPa")
    assert list(dd.import_tests(path, sheet="*", drop=["pressure"], pressure="1 MPa").records["initial_pressure"]) == [
        1e6, 1e6]


def test_properties_of_a_tdms_file_hold_for_its_groups(tmp_path):
    """A group's own property goes before the file's of that name; a file of one group takes them all the same."""
    about = {"": {"p [bar]": 10.0, "v [m/s]": 0.5, "operator": "JB"}, "shot 2": {"p [bar]": 12.0}}
    path = write_tdms(tmp_path / "a.tdms", {name: clocked() for name in ("shot 1", "shot 2")}, about)
    found = dd.import_tests(path, sheet="*").records
    assert list(found["initial_pressure"]) == pytest.approx([1e6, 1.2e6])
    assert list(found["approach_speed"]) == [0.5, 0.5]
    alone = dd.import_tests(write_tdms(tmp_path / "b.tdms", {"shot": clocked()}, {"": about[""]})).records
    assert list(alone["initial_pressure"]) == pytest.approx([1e6])


@pytest.mark.parametrize("name", ["time", "force", "gain", "sample rate", "nothing [N]"])
def test_a_property_is_no_channel(tmp_path, name):
    """A number that a program wrote beside the channels under a channel's name, or any other, is left alone."""
    settings = {"pressure [bar]": 10.0, "v [m/s]": 0.5}
    plain, more, wide = (dd.import_tests(write_tdms(tmp_path / "a.tdms", {"shot": clocked()}, about)) for about in (
        {"shot": settings}, {"shot": settings | {name: 3.5}}, {"shot": settings, "": {name: 3.5}}))
    assert more.samples.equals(plain.samples) and more.records.equals(plain.records)
    assert wide.samples.equals(plain.samples) and wide.records.equals(plain.records)


def test_tdms_that_is_cut_off_or_none(tmp_path):
    """A first segment that ends early, wherever, and text are told in words of ours, not in the library's."""
    path = make(tmp_path, "run.tdms")
    data = path.read_bytes()
    for end in (3, 10, 28, 40, 100, 300):
        path.write_bytes(data[:end])
        refuse(path, "cut off", "copy it again")
    path.write_text("t [s],Fz [N]\n" + "0.1,2\n" * 600)
    refuse(path, "no TDMS file")


@pytest.mark.parametrize("name", FORMATS)
def test_a_channel_that_is_not_there(tmp_path, name):
    path = make(tmp_path, name)
    refuse(path, "'Kraft'", "Fz" if name != "bag" else "wrench.force.z", force="Kraft")
    held = FORMATS[name][1]()
    renamed = {{"Fz": "channel7"}.get(key, key): ("V", *about[1:]) for key, about in held.items()}
    refuse(make(tmp_path, name, renamed) if name != "bag" else path, "--force")


@pytest.mark.parametrize("name", FORMATS)
def test_a_library_that_is_missing(tmp_path, name, monkeypatch):
    path = make(tmp_path, name)
    for library in ("openpyxl", "odf", "h5py", "pyarrow", "nptdms", "asammdf", "pyuff", "mcap", "mcap.reader",
                    "rosbags", "rosbags.highlevel"):
        monkeypatch.setitem(sys.modules, library, None)
    refuse(path, "ddetumble[formats]")


@pytest.mark.parametrize("name", [name for name in FORMATS if name != "run.uff"])  # whose writer makes nought of NaN
def test_numbers_that_are_none(tmp_path, name):
    """Infinity is refused by its channel, NaN in the time too; NaN in a channel is a missing sample, which is noted."""
    if name in ("run.xlsx", "run.ods"):
        held = channels()
        held["Fz"] = ("N", [*trace()[:9].tolist(), "nan", *trace()[10:].tolist()])
        rows = as_rows({"t": held["t"], "Fz": ("N", np.array(held["Fz"][1], dtype=object))})
        refuse(write_sheets(tmp_path / name, {"Data": rows}), "sheet Data", "column Fz", "line 11")
        return
    for bad in (np.inf, np.nan):
        held = FORMATS[name][1]()
        values = trace()
        values[9] = bad
        held["Fz"] = (*held["Fz"][:-1], values)
        folder = tmp_path / str(bad)
        folder.mkdir()
        path = make(folder, name, held)
        if bad == np.inf:
            refuse(path, "column", "line 10", **UNITLESS.get(name, {}))
        else:
            campaign = dd.import_tests(path, **CONDITIONS, **UNITLESS.get(name, {}))
            assert campaign.samples["normal_force"].isna().sum() == 1
            assert any("1 sample" in note and "NaN" in note for note in campaign.notes)
        if "t" in held:
            held |= {"Fz": ("N", trace())}
            held["t"] = ("s", np.where(np.arange(512) == 20, np.nan, TIME))
            refuse(make(folder, name, held), "column t", "line 21")


@pytest.mark.parametrize("name", ["run.xlsx", "run.ods", "run.mat", "run73.mat", "run.h5"])
def test_channels_of_unequal_length(tmp_path, name):
    held = channels()
    held["t"] = ("s", TIME[:500])
    refuse(make(tmp_path, name, held), "column t")
    held = channels(Fx=("N", trace()[:300]), p=("bar", np.linspace(10, 11, 512)))
    assert len(dd.import_tests(make(tmp_path, name, held), **CONDITIONS).samples) == 512  # Fx is not asked for
    if name not in ("run.xlsx", "run.ods"):  # where cells are empty
        refuse(make(tmp_path, name, held), "column Fx", "300", keep="tangential_force=Fx")
    tdms = write_tdms(tmp_path / "a.tdms", {"t": ("s", TIME[:500]), "Fz": ("N", trace())})
    refuse(tdms, "group Bench", "column", "500")
    half = write_tdms(tmp_path / "b.tdms", {"Fz": ("N", STEP, trace()), "p": ("bar", trace()[:9])})
    refuse(half, "column p", "--time", pressure=None)


@pytest.mark.parametrize("name, write", [("a.h5", write_hdf5), ("a.tdms", write_tdms)])
def test_several_groups(tmp_path, name, write):
    path = write(tmp_path / name, {"fast": channels(), "slow": {"T": ("K", TIME[:9]), "n": (None, TIME[:9])}})
    refuse(path, "fast", "slow", "--sheet")
    assert len(dd.import_tests(path, sheet="fast", **CONDITIONS).samples) == 512
    refuse(path, "group slow", "--force", sheet="slow", time="n", units="time=s")
    refuse(path, "'medium'", "fast", sheet="medium")


def test_cells_that_are_no_numbers(tmp_path):
    for i, (cell, part) in enumerate({"12.5 N": "unit", "1,5": "comma", "#DIV/0!": "not a number",
                                      "=A2*2": "formula", "OVR": "OVR"}.items()):
        rows = as_rows(channels())
        rows[7][1] = cell
        path = write_sheets(tmp_path / f"{i}.xlsx", {"Data": rows, "notes": []})
        refuse(path, "sheet Data", "column Fz", "line 8", part)
    rows[7][1] = 2.5
    import openpyxl

    path = write_sheets(tmp_path / "per cent.xlsx", {"Data": rows})
    book = openpyxl.load_workbook(path)
    book["Data"]["B8"].number_format = "0.0%"
    book.save(path)
    refuse(path, "sheet Data", "column Fz", "line 8", "250 %")
    refuse(write_sheets(tmp_path / "b.xlsx", {"Data": [["notes"], ["only text"]]}), "sheet Data", "--sheet")
    refuse(write_sheets(tmp_path / "c.xlsx", {"Data": []}), "no sheets")
    rows = as_rows(channels())
    rows[0][1] = "t [s]"
    refuse(write_sheets(tmp_path / "d.xlsx", {"Data": rows}), "sheet Data", "line 1", "t [s]")


def test_columns_of_a_matrix_are_the_axes(tmp_path):
    """All have the unit of the matrix, and any name does with that of an angular velocity; of two, one is chosen."""
    rates = np.arange(36.0).reshape(12, 3) ** 1.5
    options = {"family": "tumble", "uncertainty": "angular_velocity=0.01 deg/s"}
    stated = {"units": "angular_velocity=deg/s"}
    for name, unit, said in (("omega_dps", "", {}), ("data_dps", "", {}), ("omega", "", stated), ("gyro", "deg/s", {})):
        write_matlab(path := tmp_path / "a.mat", {"t_s": ("", np.arange(12.0)), name: (unit, rates)})
        campaign = dd.import_tests(path, **options, **said)
        assert campaign.trace("a")["time"].iloc[-1] == 11.0
        for axis, column in zip("xyz", rates.T, strict=True):
            np.testing.assert_allclose(campaign.trace("a")[f"angular_velocity_{axis}"], np.radians(column))
        assert any(all(f"{name.removesuffix('_dps')} {j}" in note for j in (1, 2, 3)) for note in campaign.notes)
    write_matlab(path, {"t_s": ("", np.arange(12.0)), "omega": ("", rates)})
    refuse(path, "--unit angular_velocity=", pressure=None, speed=None, **options)
    write_matlab(path, {"t_s": ("", np.arange(12.0)), "omega_dps": ("", rates), "data_dps": ("", rates)})
    refuse(path, "--keep angular_velocity_x", pressure=None, speed=None, **options)
    chosen = [f"angular_velocity_{axis}=data_dps {j}" for axis, j in zip("xyz", (3, 1, 2), strict=True)]
    found = dd.import_tests(path, keep=chosen, **options).trace("a")
    np.testing.assert_allclose(found["angular_velocity_x"], np.radians(rates[:, 2]))


def test_arrays_that_are_no_channels(tmp_path):
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        file["t"], file["Fz"] = TIME, trace().astype(complex)
        file["t"].attrs["units"] = file["Fz"].attrs["units"] = "s"
    refuse(path, "column Fz", "complex")
    with h5py.File(path, "w") as file:
        file["t"], file["Fz"] = TIME, np.ones((512, 600))
    refuse(path, "column Fz", "512 by 600")
    with h5py.File(path, "w") as file:
        file["t"], file["link"] = TIME, h5py.ExternalLink("other.h5", "Fz")
    refuse(path, "--force")
    with h5py.File(path, "w") as file:
        file["t"], file["Fz"] = TIME, ["1.5 N"] * 512
        file["t"].attrs["units"], file["Fz"].attrs["units"] = "s", "N"
    refuse(path, "column Fz", "'1.5 N'")
    with h5py.File(path, "w") as file:
        file.create_dataset("t", (10**12,), "f8")
    refuse(path, "memory")
    write_matlab(path := tmp_path / "a.mat", {"t": ("s", TIME), "Fz": ("N", np.array([{}, 1.0, "x"], dtype=object))})
    refuse(path, "column Fz")
    held = channels() | {"Fz": ("N", ["1.5"] * 511 + ["OVR"])}
    refuse(write_parquet(tmp_path / "a.parquet", held), "column Fz", "line 512", "OVR")
    refuse(write_mdf(tmp_path / "a.mf4", clocked(Fz=("N", STEP, np.array([b"x"] * 512)))), "column Fz")


def test_a_single_sample_that_is_far_too_large(tmp_path):
    """As a damaged file holds it: nothing can be computed with its square."""
    for i in (100, 230, 400):
        force = trace()
        force[i] = 1e200
        refuse(write_tdms(tmp_path / f"{i}.tdms", clocked(Fz=("N", STEP, force))), "column Fz", f"line {i + 1}")


def test_functions_that_are_not_of_time(tmp_path):
    path = write_universal(tmp_path / "a.uff", clocked())
    path.write_bytes(path.read_bytes().replace(b"\n    1         0    0", b"\n    4         0    0"))
    refuse(path, "column Fz", "function of time")
    path = write_universal(tmp_path / "b.uff", clocked())
    path.write_bytes(path.read_bytes().replace(b"       512         0", b"       700         0"))
    refuse(path, "column Fz", "512", "700")


def test_packed_numbers_and_times_of_day(tmp_path):
    """What a format says about its numbers is done to them: netCDF's packing, and time stamps as seconds."""
    with h5py.File(tmp_path / "a.nc", "w") as file:
        file["time"], file["Fz"] = TIME, np.round(trace() * 1024).astype("i4")
        file["time"].attrs["units"], file["Fz"].attrs["units"] = "s", "N"
        file["Fz"].attrs["scale_factor"] = 1 / 1024
    packed = dd.import_tests(tmp_path / "a.nc", **CONDITIONS)
    stamps = np.datetime64("2024-05-01T10:00:00", "ns") + (TIME * 1e9).astype("m8[ns]")
    stamped = dd.import_tests(write_parquet(tmp_path / "b.parquet", channels(t=(None, stamps))), **CONDITIONS)
    wanted = dd.import_tests(write_csv(tmp_path / "run.csv", channels()), **CONDITIONS)
    for campaign in (packed, stamped):
        pd.testing.assert_frame_equal(take_samples(campaign), take_samples(wanted), check_exact=True)


def test_a_recording_that_has_lost_messages(tmp_path):
    for storage in ("SQLITE3", "MCAP"):
        path = write_bag(tmp_path / storage, clocked(), storage)
        index = path / "metadata.yaml"
        index.write_text(index.read_text().replace("message_count: 512", "message_count: 513"))
        refuse(path, "512", "513", **UNITLESS["bag"])


def test_a_file_without_times_takes_a_sampling_rate(tmp_path):
    """Of channels without a clock, and of a text file: the times are those that a clock would give."""
    held = {name: (unit, values) for name, (unit, *_, values) in channels().items() if unit != "s"}
    path = write_tdms(tmp_path / "a.tdms", held)
    refuse(path, "wf_increment", "--rate", "--time")
    clock = dd.import_tests(write_tdms(tmp_path / "b.tdms", clocked()), **CONDITIONS)
    for source in (path, write_csv(tmp_path / "a.csv", held | {"x": ("mm", TIME)})):
        campaign = dd.import_tests(source, rate=f"{1 / STEP:.12g} Hz", **CONDITIONS)
        assert np.ptp(np.diff(campaign.samples["time"])) < 1e-9 and len(campaign.samples) == len(TIME)
        np.testing.assert_allclose(np.diff(campaign.samples["time"]), STEP)
    assert campaign.samples["normal_force"].max() == clock.samples["normal_force"].max()
    for rate, words in (("1000", "Hz"), ("-1 kHz", "positive")):
        with pytest.raises(dd.InputError, match=words) as caught:
            dd.import_tests(path, rate=rate, **CONDITIONS)
        assert caught.value.option == "--rate"
    refuse(tmp_path / "b.tdms", "--rate", "time", rate="1 kHz")
    for more in ({"time": ""}, {"time": "t"}, {"units": "time=ms"}):
        with pytest.raises(dd.InputError, match="--time|--unit") as caught:
            dd.import_tests(path, rate="1 kHz", **CONDITIONS, **more)
        assert caught.value.option == "--rate"


@pytest.mark.parametrize("heading", ["time", "t", "Time [s]", "elapsed time [s]"])
def test_a_clock_takes_the_place_of_times_that_are_left_out(tmp_path, heading):
    """Times by the rate are those of the campaign, whatever name the column has that is dropped."""
    rows = [f"{0.5 * i},{value!r}" for i, value in enumerate(trace().tolist())]
    (tmp_path / "a.csv").write_text("\n".join((f"{heading},Fz [N]", *rows)) + "\n")
    refuse(tmp_path / "a.csv", "--rate", rate=f"{1 / STEP:.12g} Hz")
    campaign = dd.import_tests(tmp_path / "a.csv", rate=f"{1 / STEP:.12g} Hz", drop=heading, **CONDITIONS)
    np.testing.assert_allclose(np.diff(campaign.samples["time"]), STEP)
    assert len(campaign.samples) == len(rows)


@pytest.mark.parametrize(("lines", "options"), [
    (["Fz [N]"], {}), (["Kraft", "[N]"], {"force": "Kraft"}), (["bench 3, run 7", "Fz [N]"], {}),
    ([], {"force": "1", "units": "force=N"}), (["Fz [N]"], {"decimal": ","})], ids=str)
def test_a_text_file_of_the_force_alone_takes_a_sampling_rate(tmp_path, lines, options):
    values = trace()
    cells = [f"{value:.6f}".replace(".", options.get("decimal", ".")) for value in values]
    path = tmp_path / "a.txt"
    path.write_text("\n".join((*lines, *cells)) + "\n")
    campaign = dd.import_tests(path, rate=f"{1 / STEP:.12g} Hz", **CONDITIONS, **options)
    np.testing.assert_allclose(np.diff(campaign.samples["time"]), STEP)
    assert len(campaign.samples) == len(values)
    with pytest.raises(dd.InputError, match="--rate"):
        dd.import_tests(path, **CONDITIONS, **options)
    path.write_text("\n".join((*lines, *cells[:9], "error", *cells[9:])) + "\n")
    with pytest.raises(dd.InputError, match="error|remove"):
        dd.import_tests(path, rate="1 kHz", **CONDITIONS, **options)


def test_a_table_of_conditions_among_several_sheets_is_named_behind_the_file(tmp_path):
    write_csv(tmp_path / "a.csv", channels())
    rows = [["file", "p [bar]", "v [m/s]"], ["a.csv", 10.0, 0.4]]
    table = write_sheets(tmp_path / "settings.xlsx", {"Table": rows, "old": rows})
    for named in (table, f"{table}:new"):
        with pytest.raises(dd.InputError) as caught:
            dd.import_tests(tmp_path / "a.csv", conditions=named)
        assert "--conditions" in str(caught.value) and "--sheet" not in str(caught.value)
        assert "Table" in str(caught.value) and "old" in str(caught.value)
    assert len(dd.import_tests(tmp_path / "a.csv", conditions=f"{table}:Table").records) == 1


def test_one_sheet_of_several_has_its_own_row_of_conditions(tmp_path):
    rows = as_rows(channels())
    table = [["test", "p [bar]", "v [m/s]"], ["shot1", 10.0, 0.4], ["shot2", 20.0, 0.3]]
    book = write_sheets(tmp_path / "bench.xlsx", {"settings": table, "shot1": rows, "shot2": rows})
    every = dd.import_tests(book, sheet="shot*", conditions=f"{book}:settings").records
    for sheet in ("shot2", "*2"):
        one = dd.import_tests(book, sheet=sheet, conditions=f"{book}:settings").records
        pd.testing.assert_frame_equal(one, every.iloc[1:])


@pytest.mark.parametrize("filled", [1, 0], ids=["headings", "empty"])
def test_a_sheet_that_is_named_and_not_filled_in(tmp_path, filled):
    """That it holds no rows is what is wrong, of measurements and of conditions; which sheet is known."""
    rows = as_rows(channels())
    book = write_sheets(tmp_path / "a.xlsx", {"Data": rows[:filled], "old": rows})
    write_csv(tmp_path / "b.csv", channels())
    table = write_sheets(tmp_path / "settings.xlsx", {"Table": [["file", "p [bar]", "v [m/s]"]][:filled], "old": rows})
    for path, named in ((book, {"sheet": "Data", **CONDITIONS}),
                        (tmp_path / "b.csv", {"conditions": f"{table}:Table"})):
        with pytest.raises(dd.InputError) as caught:
            dd.import_tests(path, **named)
        assert caught.value.sheet in ("sheet Data", "sheet Table") and "holds no" in caught.value.problem
        assert ("--sheet" in caught.value.problem) == (path == book)


def test_a_table_of_conditions_that_is_not_there(tmp_path):
    """Its absence is told before what a pattern takes for a test."""
    write_csv(tmp_path / "a.csv", channels())
    (tmp_path / "settings.csv").write_text("file,p [bar],v [m/s]\na.csv,10,0.4\n", encoding="utf-8")
    for name, near in (("setings.csv", "settings.csv"), ("q.xlsx", "check the path")):
        with pytest.raises(dd.InputError) as caught:
            dd.import_tests(sorted(tmp_path.glob("*.csv")), conditions=tmp_path / name)
        assert caught.value.file == str(tmp_path / name) and caught.value.option == "--conditions"
        assert near in caught.value.problem


def test_two_headings_of_one_condition_are_both_named(tmp_path):
    write_csv(tmp_path / "a.csv", channels())
    for headings in (("Pressure (bar)", "Pressure [bar]"), ("p0 [bar]", "Fill pressure [MPa]")):
        table = write_sheets(tmp_path / "b.xlsx", {"Table": [["file", *headings, "v [m/s]"], ["a.csv", 10, 1, 0.4]]})
        with pytest.raises(dd.InputError) as caught:
            dd.import_tests(tmp_path / "a.csv", conditions=table)
        told = str(caught.value)
        assert all(one.split(" [")[0] in told for one in headings) and "initial_pressure" in told


def test_messages_of_another_kind(tmp_path):
    (tmp_path / "empty").mkdir()
    (tmp_path / "empty" / "metadata.yaml").write_text("rosbag2_bagfile_information: 3\n")
    refuse(tmp_path / "empty")
    path = write_mcap(tmp_path / "a.mcap", clocked(Fx=("N", STEP, trace()[:99])))
    refuse(path, "column Fz", "--unit")
    twice = write_mcap(tmp_path / "b.mcap", clocked(p=("bar", 0.0, [10.0, 11.0])))
    refuse(twice, "column p", "clock", units=["force=N", "pressure=bar"], pressure=None)


def test_command_line(tmp_path, capsys):
    path = write_tdms(tmp_path / "a.tdms", clocked(p=GAS))
    assert main(["import", str(path), "--list"]) == 0
    shown = capsys.readouterr().out
    assert all(part in shown for part in ("Bench", "Fz [N]: 512 values", "p [bar]: 128 values", f"{STEP:.6g} s"))
    for name in FORMATS:
        assert main(["import", str(make(tmp_path, name)), "--list"]) == 0
    assert "wrench.force.z" in capsys.readouterr().out
    bad = write_hdf5(tmp_path / "bad.h5", {"\x1b[2Jshot": channels(**{"p\x1b[31m": ("b\x07", TIME)})})
    assert main(["import", str(bad), "--list"]) == 0 and capsys.readouterr().out.replace("\n", "").isprintable()
    assert main(["import", str(path), "--speed", "0.4 m/s"]) == 2 and "-o" in capsys.readouterr().err
    out = tmp_path / "campaign"
    assert main(["import", str(path), "--speed", "0.4 m/s", "-o", str(out)]) == 0
    assert dd.read_campaign(out).record_keys == ("a",)
    path.write_bytes(path.read_bytes()[:-5])
    assert main(["import", str(path), "--speed", "0.4 m/s", "-o", str(tmp_path / "b")]) == 2
    told = capsys.readouterr().err
    assert str(path) in told and "Traceback" not in told and not (tmp_path / "b").exists()


def test_contents_of_sheets_and_of_text(tmp_path):
    book = write_sheets(tmp_path / "a.xlsx", {"Data": as_rows(channels()), "notes": [["no table"]]})
    held = dd.list_channels(book)
    told = [(one.group, one.name, one.unit) for one in held if not one.problem]
    assert told == [("Data", "t", "s"), ("Data", "Fz", "N")]
    assert [one.group for one in held if one.problem] == ["notes"]
    text = dd.list_channels(write_csv(tmp_path / "a.csv", channels()))
    assert [(one.name, one.unit, len(one.values)) for one in text] == [("t", "s", 512), ("Fz", "N", 512)]


def test_tests_in_one_long_table_are_told_apart_by_their_numbers(tmp_path):
    """A column of whole numbers names the tests alike in every format."""
    held = {"Test": (None, np.repeat([1.0, 2.0], 512)), "t": ("s", np.tile(TIME, 2)),
            "Fz": ("N", np.concatenate([trace(), trace(40.0, 1)]))}
    for name in ("run.parquet", "run.mat", "run.h5"):
        assert dd.import_tests(make(tmp_path, name, held), **CONDITIONS).record_keys == ("1", "2")
    book = write_sheets(tmp_path / "a.xlsx", {"Data": [
        [int(cell) if i and not j else cell for j, cell in enumerate(row)] for i, row in enumerate(as_rows(held))]})
    assert dd.import_tests(book, **CONDITIONS).record_keys == ("1", "2")


@pytest.mark.slow
@pytest.mark.parametrize("name", FORMATS)
def test_damaged_files(tmp_path, name, monkeypatch):
    """A campaign or a sentence comes of each; many more are in fits/reader-fuzz."""
    monkeypatch.setattr(recordings, "PATIENCE", 5.0)
    valid, truth = prepare(name, tmp_path)
    for seed in range(12):
        attempt = try_one(name, seed, tmp_path, valid, truth)
        assert attempt.outcome != "finding", (seed, attempt)


@pytest.mark.parametrize("name", ["run.tdms", "bag"])
def test_a_channel_of_one_sample_or_none(tmp_path, name):
    for count in (1,) if name == "bag" else (1, 0):
        path = make(tmp_path / str(count), name, clocked(Fz=("N", STEP, trace()[:count])))
        refuse(path, **UNITLESS.get(name, {}))


def test_a_library_that_breaks_down(tmp_path, monkeypatch):
    """What would end the process, or hold it up, ends another one; where none can be started, files are just read."""
    path = make(tmp_path, "run.h5")
    monkeypatch.setattr(recordings, "PATIENCE", 3.0)
    for code in ("os.kill(os.getpid(), 9)", "time.sleep(60)"):
        monkeypatch.setattr(recordings, "_READ_APART", f"import os, time; print(flush=True); {code}")
        refuse(path)
    for code in ("raise SystemExit(1)", ""):
        monkeypatch.setattr(recordings, "_READ_APART", code)
        assert len(dd.import_tests(path, **CONDITIONS).samples) == 512
    monkeypatch.setattr(sys, "executable", str(tmp_path / "none"))
    assert len(dd.import_tests(path, **CONDITIONS).samples) == 512


def test_a_part_of_a_spreadsheet_that_breaks_off(tmp_path, capsys):
    """Nothing is made of the rows before, and nothing is printed."""
    path = make(tmp_path, "run.ods")
    with zipfile.ZipFile(path) as archive:
        parts = {name: archive.read(name) for name in archive.namelist()}
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in parts.items():
            archive.writestr(name, content[: len(content) // 2] if name == "content.xml" else content)
    refuse(path)
    assert capsys.readouterr() == ("", "")


SPECIFICATION = """
raw = ["run*.csv"]
conditions = "settings.xlsx:Table"
uncertainty = { force = "0.3 N" }
reverse = ["force"]
describe = { force = "low-pass filter of the amplifier, 2 kHz; gauge 12 mm above the plate" }
crop = "0.05 s to 0.95 s"
"""


def write_specified(folder, text=SPECIFICATION):
    """A folder with a raw file whose force is negative, a workbook of settings and `import.toml`."""
    folder.mkdir(exist_ok=True)
    write_csv(folder / "run1.csv", {"t": ("s", TIME), "Fz": ("N", -trace())})
    write_sheets(folder / "settings.xlsx", {"Table": [["file", "p [bar]", "v [m/s]"], ["run1.csv", 10.0, 0.4]]})
    (folder / "import.toml").write_text(text)
    return folder / "import.toml"


def test_an_import_as_a_file(tmp_path):
    path = write_specified(tmp_path / "lab")
    campaign = dd.import_tests(path)
    by_hand = dd.import_tests(tmp_path / "lab" / "run1.csv", conditions=tmp_path / "lab" / "settings.xlsx",
                              uncertainty="force=0.3 N", reverse="force", crop="0.05 s to 0.95 s")
    pd.testing.assert_frame_equal(campaign.samples, by_hand.samples, check_exact=True)
    assert len(campaign.samples) == np.sum((TIME >= 0.05) & (TIME <= 0.95))
    assert campaign.samples["normal_force"].max() > 40
    written = dd.write_campaign(tmp_path / "campaign", campaign)
    assert "2 kHz" in written.column("normal_force").description
    for text, *parts in (
        ("raw = 3", "'3'"), ("raw = { a = 'b' }", "raw"),
        ("", "raw"), ("raw = ['none*.csv']", "none*.csv"), ("raw = ['run*.csv'", "TOML"),
        (SPECIFICATION + "decimals = ','", "decimals", "decimal?"), (SPECIFICATION + "onset = 2024-01-01", "onset"),
        (SPECIFICATION.replace("0.05 s to", "0.05 s -"), "--crop"), (SPECIFICATION.replace("0.05", "0.96"), "--crop"),
        (SPECIFICATION.replace("0.95", "0.052"), "--crop"),
        (SPECIFICATION + "sheet = ['a']", "sheet"), (SPECIFICATION + "gauge = 'yes'", "gauge", "true"),
        (SPECIFICATION.replace('["force"]', '["slip"]'), "--reverse"),
        (SPECIFICATION.replace("{ force = \"low", "{ slip = \"low"), "--describe"),
    ):
        with pytest.raises(dd.InputError) as caught:
            dd.import_tests(write_specified(tmp_path / "lab", text))
        assert all(part in str(caught.value) for part in parts), (parts, str(caught.value))
    with pytest.raises(dd.InputError, match="leave out pressure"):
        dd.import_tests(path, pressure="1 MPa")


def test_zero_of_a_channel(tmp_path):
    path = write_csv(tmp_path / "a.csv", channels())
    campaign = dd.import_tests(path, zero={"force": "0 s to 0.2 s"}, onset="0.25 s", **CONDITIONS)
    plain = dd.import_tests(path, onset="0.25 s", **CONDITIONS)
    assert any("subtracted from normal_force" in note for note in campaign.notes)
    difference = campaign.samples["normal_force"] - plain.samples["normal_force"]
    assert np.ptp(difference) < 1e-9 and abs(difference.iloc[0]) < 0.1
    refuse(path, "--zero", "normal_force", zero="force=0 s to 1 ms")
    refuse(path, "--zero", "slip", zero="slip=0 s to 1 s")


def test_one_long_recording_is_cut_into_records(tmp_path):
    """Each record is a stretch of the recording, sample for sample; what is not whole is left out and told."""
    force = np.concatenate([trace(peak, seed)[:400] for seed, peak in enumerate((40.0, 50.0, 60.0))] + [trace()[:200]])
    path = write_tdms(tmp_path / "long.tdms", {"Fz": ("N", STEP, force)})
    cut = {"level": "8 N", "before": "0.2 s", "after": "0.4 s"}
    campaign = dd.import_tests(path, cut=cut, **CONDITIONS)
    assert campaign.record_keys == ("long-1", "long-2", "long-3")
    assert any("3 contacts" in note and "1 at its ends" in note for note in campaign.notes)
    assert [round(campaign.trace(key)["normal_force"].max(), -1) for key in campaign.record_keys] == [40, 50, 60]
    for key in campaign.record_keys:
        values = campaign.trace(key)["normal_force"].to_numpy()
        steps = np.diff(values)
        first = next(i for i in range(len(force)) if np.allclose(np.diff(force[i : i + len(values)]), steps, atol=1e-9))
        assert len(values) == pytest.approx(0.6 / STEP, abs=2) and first >= 0
    with pytest.raises(dd.InputError, match="--cut.*before"):
        dd.import_tests(path, cut={"level": "8 N"}, **CONDITIONS)
    refuse(path, "--cut", "lower the level", cut=cut | {"level": "800 N"})
    refuse(path, "--cut", "closer", cut=cut | {"before": "0.5 s"})
    with pytest.raises(dd.InputError, match="--cut"):
        dd.import_tests(path, cut=cut | {"level": "8 mm"}, **CONDITIONS)
    with pytest.raises(dd.InputError, match="--cut"):
        dd.import_tests(path, cut=cut | {"after": "-1 s"}, **CONDITIONS)


def test_dry_run(tmp_path, capsys):
    """A dry run says what would be made, draws it if asked, and writes nothing else."""
    path = write_specified(tmp_path / "lab")
    before = sorted(path.parent.iterdir())
    assert main(["import", str(path), "--dry-run", "--figure", str(tmp_path / "check.png")]) == 0
    assert (tmp_path / "check.png").read_bytes().startswith(b"\x89PNG") and sorted(path.parent.iterdir()) == before
    dry = capsys.readouterr().out
    assert main(["import", str(path), "-o", str(tmp_path / "campaign")]) == 0
    wet = capsys.readouterr().out
    *notes, drawn, count = dry.splitlines()
    assert notes == wet.splitlines()[:-1] and "1 record" in count and str(tmp_path / "check.png") in drawn
    assert main(["import", str(path), "--dry-run", "--figure", str(tmp_path / "check.png")]) == 2
    assert main(["import", str(path), "--dry-run", "--pressure", "1 MPa"]) == 2
    told = capsys.readouterr().err
    assert "check.png" in told and "pressure" in told and "Traceback" not in told


def test_a_campaign_as_a_workbook_and_back(tmp_path, capsys):
    """An exported campaign can be imported again, but for the last digit that .xlsx keeps; names stay texts."""
    raw = write_csv(tmp_path / "=1+1.csv", channels(p=("bar", np.where(np.arange(512) % 4, np.nan, 10.0 + TIME))))
    raw.write_text(raw.read_text().replace("nan", ""))
    campaign = dd.write_campaign(tmp_path / "campaign", dd.import_tests(raw, **CONDITIONS))
    book = tmp_path / "book.xlsx"
    assert main(["export", str(tmp_path / "campaign"), "-o", str(book)]) == 0
    assert {"about", "records", "samples"} <= {one.group for one in dd.list_channels(book)}
    again = dd.import_tests(book, sheet="samples", conditions=f"{book}:records", onset=0)
    assert again.record_keys == ("=1+1",) and again.records.equals(campaign.records)
    np.testing.assert_allclose(take_samples(again)["time"], take_samples(campaign)["time"], rtol=1e-14, atol=1e-15)
    assert main(["export", str(tmp_path / "campaign"), "-o", str(book)]) == 2
    assert main(["export", str(tmp_path / "campaign"), "-o", str(tmp_path / "a.csv")]) == 2
    assert main(["export", str(tmp_path / "campaign"), "-o", str(tmp_path / "a.ods")]) == 2
    assert main(["export", str(tmp_path), "-o", str(tmp_path / "b.xlsx")]) == 2
    assert "Traceback" not in capsys.readouterr().err


def test_results_as_tables(tmp_path):
    folder = dd.find_data() / "scenarios" / "close-settings"
    assert main(["export", str(folder), "-o", str(tmp_path / "a.csv")]) == 0
    table = pd.read_csv(tmp_path / "a.csv").set_index("name")
    assert table.loc["effective_mass", "estimate"] > 0 and table.loc["effective_mass", "unit"] == "kg"
    assert main(["export", str(folder), "-o", str(tmp_path / "a.xlsx")]) == 0
    held = {(one.group, one.name) for one in dd.list_channels(tmp_path / "a.xlsx")}
    assert {("parameters", "estimate"), ("candidates", "p_value"), ("steps", "nrmse")} <= held
    (tmp_path / "result.json").write_text("[1")
    assert main(["export", str(tmp_path), "-o", str(tmp_path / "b.xlsx")]) == 2
