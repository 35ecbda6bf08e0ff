"""Tables with one row a test: rebound speeds and other single values, from a laboratory's table to a fit."""

import numpy as np
import pytest

import ddetumble as dd
from ddetumble import InputError, import_tests, read_campaign, write_campaign
from ddetumble.cli import main


RESTITUTION = 0.72
SPEEDS, PRESSURES = np.tile([0.2, 0.3, 0.4, 0.5], 3), np.repeat([6.0, 10.0, 20.0], 4)  # m/s, bar


def write_table(path, headings="Test;p [bar];v [m/s];v2 [mm/s];Peak force [N];repeats;remark", change=None):
    """A table of rebound speeds that scatter by 1 %, and of forces."""
    generator = np.random.default_rng(3)
    rows = [[f"{k + 1}", f"{p:g}", f"{v:g}", f"{1e3 * RESTITUTION * v * (1 + 0.01 * generator.standard_normal()):.3f}",
             f"{100 * v:.1f}", "3", "calm"] for k, (p, v) in enumerate(zip(PRESSURES, SPEEDS, strict=True))]
    for (row, column), text in (change or {}).items():
        rows[row][column] = text
    path.write_text("\n".join([headings, *map(";".join, rows)]) + "\n", encoding="utf-8")
    return path


@pytest.mark.slow
def test_a_table_of_rebound_speeds_gives_the_restitution(tmp_path):
    """By command to a campaign, and on to a fit whose interval holds the truth and is as wide as 12 values make it."""
    table, folder = write_table(tmp_path / "bench.csv"), tmp_path / "campaign"
    assert main(["import", str(table), "--values", "--drop", "Peak force", "--uncertainty", "rebound_speed=1 %",
                 "--gauge", "--ambient", "1 bar", "--known", "outer_diameter=60 mm", "-o", str(folder)]) == 0
    campaign = read_campaign(folder)
    assert campaign.samples is None and campaign.peaks is not None
    assert list(campaign.peaks) == ["rebound_speed", "repeats"]
    np.testing.assert_allclose(campaign.records["initial_pressure"], 1e5 * (PRESSURES + 1.0))
    np.testing.assert_allclose(campaign.peaks["rebound_speed"], RESTITUTION * SPEEDS, rtol=0.05)
    assert (campaign.peaks["repeats"] == 3).all()
    assert campaign.peak_columns["rebound_speed"].uncertainty.relative == 0.01
    found = dd.fit(campaign).parameters["restitution"]
    assert found.q025 < RESTITUTION < found.q975
    assert found.sd == pytest.approx(0.01 * RESTITUTION / np.sqrt(12), rel=0.3)


def test_every_value_by_its_heading(tmp_path):
    """Words of laboratories and units: to SI, as a campaign that is written and read again has them."""
    heads = "Run;p0 [bar];v1 [m/s];rebound velocity [mm/s];Fmax [N];held [ms];note"
    campaign = import_tests(write_table(tmp_path / "a.csv", heads), values=True, keep=["contact_time=held"],
                            uncertainty={"force": "2 %", "approach_speed": "1 %"})
    assert campaign.peaks is not None
    assert list(campaign.peaks) == ["peak_normal_force", "rebound_speed", "contact_time"]
    np.testing.assert_allclose(campaign.peaks["peak_normal_force"], 100.0 * SPEEDS)
    np.testing.assert_allclose(campaign.peaks["contact_time"], 3e-3)
    assert campaign.peak_columns["peak_normal_force"].uncertainty.relative == 0.02
    again = write_campaign(tmp_path / "out", campaign)
    np.testing.assert_array_equal(again.peaks, campaign.peaks)


def test_a_file_says_that_it_is_a_table_of_values(tmp_path):
    """`values = true` in import.toml does what --values does; without it the message names the option."""
    table = write_table(tmp_path / "bench.csv")
    (tmp_path / "import.toml").write_text('raw = "bench.csv"\nvalues = true\n', encoding="utf-8")
    by_file, by_option = import_tests(tmp_path / "import.toml"), import_tests(table, values=True)
    assert by_file.peaks is not None and by_option.peaks is not None
    np.testing.assert_array_equal(by_file.peaks, by_option.peaks)
    with pytest.raises(InputError, match="--values"):
        import_tests(table)


def test_single_values_are_not_drawn(tmp_path, capsys):
    """There are no records to draw: refused before anything is written."""
    table = write_table(tmp_path / "bench.csv")
    assert main(["import", str(table), "--values", "--dry-run", "--figure", str(tmp_path / "a.png")]) == 2
    assert "--figure" in capsys.readouterr().err and not (tmp_path / "a.png").exists()


def test_friction_forces_of_strokes(tmp_path):
    """Of the family slip; what is the same in all tests is an option, as of curves."""
    (tmp_path / "a.csv").write_text("No.;load [N];F [N]\n1;5;4.1\n2;10;7.2\n3;20;13.0\n", encoding="utf-8")
    campaign = import_tests(tmp_path / "a.csv", values=True, family="slip", pressure="1 MPa", speed="20 mm/s",
                            uncertainty={"force": "1 %"})
    assert campaign.peaks is not None and campaign.peaks["peak_friction_force"].tolist() == [4.1, 7.2, 13.0]
    assert campaign.records["slip_speed"].tolist() == [0.02] * 3
    assert campaign.peak_columns["peak_friction_force"].uncertainty.relative == 0.01


@pytest.mark.parametrize(("given", "place"), [
    ({"force": "Peak force [N]"}, {"option": "--force"}),
    ({"name_pattern": "{approach_speed}"}, {"option": "--name-pattern"}),
    ({"family": "tumble"}, {"option": "--values"}),
    ({"drop": ["v2", "Peak force"]}, {"file": True}),
    ({"uncertainty": {"impulse": "1 %"}}, {}),
    ({"units": {"impulse": "N s"}}, {"option": "--unit"}),
    ({"change": {(4, 3): "-200"}}, {"column": "v2", "row": 6}),
    ({"change": {(4, 3): ""}}, {"column": "v2", "row": 6}),
    ({"change": {(4, 0): "3"}}, {"row": 6}),
    ({"change": {(0, 2): "0"}}, {"column": "v", "row": 2}),
    ({"headings": "Test;p [bar];v [m/s];v2;Peak force [N];repeats;remark"}, {"column": "v2"}),
    ({"headings": "Test;p [bar];v [m/s];v2 [N];Peak force [N];repeats;remark"}, {"column": "v2"}),
    ({"headings": "Test;p [bar];v [m/s];v2 [mm/s];vr [mm/s];repeats;remark"}, {"file": True}),
    ({"headings": "Test;p [bar];w [m/s];v2 [mm/s];Peak force [N];repeats;remark"}, {"file": True}),
])  # fmt: skip
def test_what_is_wrong_is_named(tmp_path, given, place):
    parts = {name: given.pop(name) for name in ("headings", "change") if name in given}
    table = write_table(tmp_path / "bench.csv", **parts)
    with pytest.raises(InputError) as error:
        import_tests(table, values=True, **given)
    for name, wanted in place.items():
        found = getattr(error.value, name)
        assert found is not None if wanted is True else found == wanted
