"""Import of friction tests: columns, units and the sign come out right, and bad input is answered in one sentence."""

import json

import numpy as np
import pytest
from helpers_measurement import raw_text
from typer.testing import CliRunner

from ddetumble._errors import InputError
from ddetumble.cli import main
from ddetumble.measurement.laboratory import import_tests
from ddetumble.measurement.package import read_campaign, write_campaign


SLIP = np.linspace(0.0, 8.0, 41)  # mm
FRICTION = 4.0 + 0.2 * SLIP  # N
TABLE = "file;Load [N];p [bar];v [mm/s]\na;20;10;50\nb;12;10;50\n"
OPTIONS = {"family": "slip", "load": "20 N", "pressure": "10 bar", "speed": "50 mm/s", "uncertainty": "force=0.04 N"}


def write(path, text):
    path.write_text(text)
    return path


def stroke(path, columns=(SLIP, FRICTION), headings=("Slip [mm]", "Ft [N]")):
    """A raw file of one friction test."""
    return write(path, raw_text(list(columns), list(headings)))


def back_and_forth():
    """Time [s], slip [mm] and friction [N] of two strokes."""
    slip = np.concatenate([SLIP, SLIP[-2::-1]])
    way = np.sign(np.gradient(slip))
    return np.arange(slip.size) * 0.01, slip, way * (4.0 + 0.2 * slip)


def test_one_test_with_everything_from_options(tmp_path):
    path = stroke(tmp_path / "a.csv", (SLIP, FRICTION, FRICTION), ("Weg [mm]", "Ft [N]", "Fx2 [N]"))
    campaign = import_tests(path, slip="Weg [mm]", force="Ft [N]", gauge=False, **OPTIONS)
    again = write_campaign(tmp_path / "campaign", campaign)
    assert again.records.loc["a"].to_dict() == {"normal_load": 20.0, "internal_pressure": 1e6, "slip_speed": 0.05}
    np.testing.assert_allclose(again.trace("a")["slip"], SLIP * 1e-3)


def test_a_folder_with_its_table_of_conditions_and_short_notes(tmp_path):
    stroke(tmp_path / "a.csv")
    stroke(tmp_path / "b.csv")
    table = write(tmp_path / "settings.csv", TABLE)
    campaign = import_tests(tmp_path, conditions=table, family="slip", uncertainty="force=0.04 N")
    assert list(campaign.records["normal_load"]) == [20.0, 12.0]
    assert len(set(campaign.notes)) == len(campaign.notes)
    with pytest.raises(InputError, match="if it is the table of conditions, give --conditions"):
        import_tests(tmp_path, **OPTIONS)


def test_strokes_over_time_need_no_uncertainty_of_the_slip(tmp_path):
    path = stroke(tmp_path / "a.csv", back_and_forth(), ("t [s]", "Slip [mm]", "Ft [N]"))
    campaign = write_campaign(tmp_path / "campaign", import_tests(path, **OPTIONS))
    assert campaign.independent and campaign.independent.name == "time"
    assert list(campaign.channels) == ["tangential_force", "slip"]


@pytest.mark.parametrize("over_time", [False, True])
def test_friction_that_counts_negative_is_turned(tmp_path, over_time):
    time, slip, force = back_and_forth()
    columns, headings = ((time, slip, force), ["t [s]"]) if over_time else ((SLIP, FRICTION), [])
    headings += ["Slip [mm]", "Ft [N]"]
    turned = stroke(tmp_path / "a.csv", (*columns[:-1], -columns[-1]), headings)
    campaign = import_tests(turned, **OPTIONS)
    np.testing.assert_allclose(campaign.trace("a")["tangential_force"], columns[-1], atol=1e-6)
    other = stroke(tmp_path / "b.csv", columns, headings)
    with pytest.raises(InputError, match="record 'a' has the opposite sign to that of record 'b'"):
        import_tests([turned, other], **OPTIONS)


def test_a_campaign_with_negative_friction_is_refused(tmp_path):
    folder = tmp_path / "campaign"
    write_campaign(folder, import_tests(stroke(tmp_path / "a.csv"), **OPTIONS))
    lines = (folder / "samples.csv").read_text().splitlines()
    turned = [",".join([*line.split(",")[:-1], "-" + line.split(",")[-1]]) for line in lines[1:]]
    (folder / "samples.csv").write_text("\n".join([lines[0], *turned]) + "\n")
    with pytest.raises(InputError, match="column tangential_force: .*negative where the slip grows, .*reverse"):
        read_campaign(folder)


def test_a_load_measured_along_the_stroke_is_averaged(tmp_path):
    load = 20.0 + 0.1 * np.cos(np.arange(41.0))
    options = {name: value for name, value in OPTIONS.items() if name != "load"}
    path = stroke(tmp_path / "a.csv", (SLIP, FRICTION, load), ("Slip [mm]", "Ft [N]", "Fn [N]"))
    campaign = import_tests(path, **options)
    assert campaign.records.loc["a", "normal_load"] == pytest.approx(load.mean(), rel=1e-6)
    assert import_tests(path, **OPTIONS).records.loc["a", "normal_load"] == 20.0
    path = stroke(tmp_path / "a.csv", (SLIP, FRICTION, SLIP + 1), ("Slip [mm]", "Ft [N]", "Fn [N]"))
    with pytest.raises(InputError, match="column Fn: normal_load changes too much within record 'a'"):
        import_tests(path, **options)


@pytest.mark.parametrize(
    ("table", "words"),
    [
        (TABLE.replace("Load", "Gewicht"),
         "settings.csv: normal_load is not known: .*Gewicht.*normal_load=COLUMN.*--load '20 N'"),
        (TABLE.replace("a;20", "a;-20"), r"settings.csv, line 2, column Load: normal_load of record 'a': must be"),
        (TABLE.replace("a;20;10", "a;20;-1"), "settings.csv, line 2, column p: .*--gauge and --ambient"),
        (TABLE.replace("[bar]", "[barg]"), "settings.csv, column p: 'barg' .*--gauge and --ambient"),
        (TABLE.replace(" [N]", ""), r"column Load: the column has no unit: is it N, kN or kgf.*'Load \[N\]'"),
        (TABLE.replace("[N]", "[kg]"), "column Load: .*did you mean kgf"),
        (TABLE.replace("[bar]", "[N]"), "column p: .*N is a unit of force: correct it, or choose the column"),
    ],
)
def test_conditions_that_cannot_be(tmp_path, table, words):
    stroke(tmp_path / "a.csv")
    with pytest.raises(InputError, match=words) as caught:
        import_tests(tmp_path / "a.csv", conditions=write(tmp_path / "settings.csv", table), family="slip",
                     uncertainty="force=0.04 N")  # fmt: skip
    assert "records.csv" not in str(caught.value)


@pytest.mark.parametrize(
    ("headings", "options", "words"),
    [
        (("Slip [mm]", "Ft [N]"), {"family": "impact", "load": None}, "if it is a friction test, give --family slip"),
        (("Slip [mm]", "Ft [N]"), {"force": "Ft [kN]"}, r"no column 'Ft \[kN\]'; the file has Slip \[mm\], Ft \[N\]"),
        (("Slip [mm]", "Ft [N]"), {"load": "-20 N"}, "normal_load of record 'a': must be positive.*by --load"),
        (("Slip [mm]", "Ft [N]"), {"load": "20"}, "--load: normal_load needs a unit"),
        (("Slip [mm]", "Ft [N]"), {"load": None}, "normal_load is not known; give --load '20 N', --conditions"),
        (("Slip [mm]", "Ft [N]"), {"speed": None}, "slip_speed is not known; give --speed '20 mm/s'"),
        (("Slip [mm]", "Ft [N]"), {"known": "elastic_modulu=7 MPa"}, "--known: .*did you mean elastic_modulus"),
        (("Slip [mm]", "Ft [N]"), {"known": "elastic_modulus=-7 MPa"}, "--known elastic_modulus: .*positive"),
        (("A [mm]", "B [mm]"), {}, "which column is the slip: .*--slip COLUMN, or --time COLUMN"),
        (("t [s]", "Ft [N]"), {}, "there is a time but no slip: .*--slip COLUMN"),
        (("s [mm]", "Slip [mm]"), {}, "several columns may be the slip: s, Slip; choose one with --slip COLUMN"),
    ],
)  # fmt: skip
def test_what_cannot_be_told_of_a_friction_test(tmp_path, headings, options, words):
    path = stroke(tmp_path / "a.csv", headings=headings)
    with pytest.raises(InputError, match=words) as caught:
        import_tests(path, **(OPTIONS | options))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("option", ["load", "slip"])
def test_options_of_friction_tests_are_refused_elsewhere(tmp_path, option):
    path = stroke(tmp_path / "a.csv", headings=("t [s]", "Fz [N]"))
    with pytest.raises(InputError, match=f"--{option} does not apply to the family impact"):
        import_tests(path, pressure="1 MPa", speed="0.4 m/s", **{option: "20 N"})


def test_strokes_back_without_a_time_ask_for_it(tmp_path):
    _, slip, force = back_and_forth()
    with pytest.raises(InputError, match="line 43, .*record 'a' the slip goes back.*give the time"):
        import_tests(stroke(tmp_path / "a.csv", (slip, force)), **OPTIONS)


def test_nothing_is_left_behind_by_a_refused_import(tmp_path):
    path = stroke(tmp_path / "a.csv")
    words = ["import", str(path), "--family", "slip", "--load", "-20 N", "--pressure", "1 MPa", "--speed", "50 mm/s",
             "--uncertainty", "force=0.04 N", "-o", str(tmp_path / "campaign")]  # fmt: skip
    assert main(words) == 2
    assert sorted(one.name for one in tmp_path.iterdir()) == ["a.csv"]
    words[words.index("-20 N")] = "20 N"
    assert main(words) == 0
    tree = json.loads((tmp_path / "campaign" / "datapackage.json").read_text())
    assert tree["family"] == "slip"


def test_help_speaks_of_friction_tests():
    from ddetumble.cli import app

    shown = CliRunner().invoke(app, ["import", "--help"], env={"COLUMNS": "200", "TERM": "dumb"}).output
    for words in ("--load", "--slip", "sliding", "--family slip"):
        assert words in shown
