"""Every package under ``data/``: checked by frictionless, against the simulator, and against the source's own sums."""

import csv
import json
from pathlib import Path

import frictionless
import numpy as np
import pint
import pytest

from ddetumble.exam.simulators.campaigns import write_package
from ddetumble.exam.simulators.impact import simulate
from ddetumble.exam.simulators.slip import follow_strokes, simulate_slip
from ddetumble.exam.simulators.tumbling import simulate_tumbling
from ddetumble.exam.simulators.tumbling_campaigns import ORBIT_RATE
from tests.independent.make_data import FAMILIES, OBLIQUE_PLANS, PLANS, SLIP_PLANS, SOURCE, TUMBLE_PLANS
from tests.independent.paper_tables import write_paper


DATA = Path(__file__).resolve().parent.parent / "data"
PACKAGES = sorted(path.parent.relative_to(DATA).as_posix() for path in DATA.rglob("datapackage.json"))
DIMENSIONS = {
    "initial_pressure": "Pa", "internal_pressure": "Pa", "pressure": "Pa", "approach_speed": "m/s", "slip_speed": "m/s",
    "normal_load": "N", "normal_force": "N", "peak_normal_force": "N", "peak_friction_force": "N",
    "printed_peak_normal_force": "N", "printed_peak_friction_force": "N", "time": "s", "depression": "m",
    "slip": "m", "tangential_force": "N",
}  # fmt: skip


def read_rows(package, table):
    """Return the rows of one CSV file as dictionaries of strings."""
    with (DATA / package / f"{table}.csv").open(encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


def read_column(package, table, name):
    """Return one column as numbers."""
    return np.array([float(row[name]) for row in read_rows(package, table)])


def read_truth():
    """Return what is hidden in the synthetic campaigns."""
    return json.loads((DATA / "truth.json").read_text(encoding="utf-8"))


def test_all_packages_are_there():
    """Six tables, one figure, the problems of NIST, and campaigns, each with its truth."""
    assert [name for name in PACKAGES if name.startswith("paper/")] == [
        "paper/figure-8", *(f"paper/table-{i}" for i in range(1, 7))
    ]  # fmt: skip
    campaigns = [name for name in PACKAGES if not name.startswith("paper/") and name != "nist-strd"]
    assert campaigns == sorted(PLANS | SLIP_PLANS | OBLIQUE_PLANS | TUMBLE_PLANS) == sorted(read_truth())


@pytest.mark.parametrize("package", PACKAGES)
def test_package_is_valid(package):
    """Descriptor, headers, types, primary and foreign keys."""
    report = frictionless.validate(DATA / package / "datapackage.json")
    assert report.valid, report.flatten(["type", "note"])
    descriptor = json.loads((DATA / package / "datapackage.json").read_text(encoding="utf-8"))
    assert len(report.tasks) == len(descriptor["resources"])
    assert all(task.stats["rows"] > 0 for task in report.tasks)
    assert descriptor["name"] == Path(package).name and descriptor["sources"] and descriptor["title"]


@pytest.mark.parametrize("package", PACKAGES)
def test_units_have_their_columns_dimension(package):
    """Every number has a unit that pint reads, of the right dimension, and so has every uncertainty."""
    units = pint.UnitRegistry()
    descriptor = json.loads((DATA / package / "datapackage.json").read_text(encoding="utf-8"))
    for resource in descriptor["resources"]:
        for field in resource["schema"]["fields"]:
            if field["type"] != "number":
                continue
            unit = units.Unit(field["unit"])
            if field["name"] in DIMENSIONS:
                assert unit.dimensionality == units.Unit(DIMENSIONS[field["name"]]).dimensionality
            if "uncertainty" in field:
                quantity = units.Quantity(field["uncertainty"])
                assert quantity.magnitude > 0.0
                assert quantity.dimensionless or quantity.dimensionality == unit.dimensionality


@pytest.mark.parametrize("name", sorted(PLANS))
def test_heldout_records_match_simulator(name):
    """The stored noise-free records are the simulator's, to their last digit (1e-6 N)."""
    truth = read_truth()[name]
    assert len({json.dumps(record["conditions"]) for record in truth["heldout"]}) == 3
    for record in truth["heldout"]:
        force = simulate(truth["base"], truth["effects"], record["conditions"], record["x"])
        assert np.abs(force - np.array(record["y"])).max() < 2e-6
        assert force[-1] == 0.0 or "sensor-highpass" in truth["effects"]


@pytest.mark.parametrize("name", sorted(SLIP_PLANS))
def test_slip_heldout_records_match_simulator(name):
    """The stored noise-free records are the simulator's (1e-6 N), and empty exactly where the motion turns."""
    truth = read_truth()[name]
    strokes = truth.get("strokes")
    assert len({json.dumps(record["conditions"]) for record in truth["heldout"]}) == 3
    for record in truth["heldout"]:
        path = np.array(record["x"]) * (record["conditions"]["slip_speed"] if strokes else 1.0)
        force = simulate_slip(truth["base"], truth["effects"], record["conditions"], path, strokes)
        kept = np.array(record["y"], dtype=float)  # null becomes nan
        turning = np.isin(np.round(path, 9), np.round(np.cumsum(strokes or [])[:-1], 9))[:, None]
        assert np.array_equal(np.isnan(kept), turning) and turning.sum() == len(strokes or [0]) - 1
        assert np.nanmax(np.abs(force - kept)) < 2e-6
        if strokes:
            assert np.abs(follow_strokes(path, strokes)[1] - record["slip"]).max() < 1e-8


@pytest.mark.parametrize("name", sorted(TUMBLE_PLANS))
def test_tumble_heldout_records_match_simulator(name):
    """Noise-free rates from two starts, to the digits that are written."""
    truth = read_truth()[name]
    assert len(truth["heldout"]) == 2
    for record in truth["heldout"]:
        start = record["conditions"]["w0"]
        rates, _ = simulate_tumbling(truth["base"], truth["effects"], start, record["x"], ORBIT_RATE)
        assert np.abs(rates - record["y"]).max() < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("name", [
    pytest.param(name, marks=[pytest.mark.study] if name in OBLIQUE_PLANS and name != "oblique-c" else [])
    for name in sorted(PLANS | SLIP_PLANS | OBLIQUE_PLANS | TUMBLE_PLANS)])
def test_campaign_is_made_again(name, tmp_path):
    """The command makes the shipped campaign: the same text, but for a last digit on another platform."""
    plans, make, *_ = next(family for family in FAMILIES if name in family[0])
    write_package(tmp_path / name, make(name, **plans[name]), SOURCE)
    for path in sorted((tmp_path / name).iterdir()):
        made, kept = path.read_text(encoding="utf-8"), (DATA / name / path.name).read_text(encoding="utf-8")
        if made == kept:
            continue
        assert path.suffix == ".csv"
        rows = [list(csv.reader(text.splitlines())) for text in (made, kept)]
        assert [row[:2] for row in rows[0]] == [row[:2] for row in rows[1]] and rows[0][0] == rows[1][0]
        values = [np.array([[cell or "nan" for cell in row[2:]] for row in part[1:]], dtype=float) for part in rows]
        digits = len(rows[1][1][-1].split(".")[1])
        assert np.array_equal(*map(np.isnan, values))
        assert np.nanmax(np.abs(values[0] - values[1])) < 1.5 * 10.0**-digits


def test_paper_packages_are_made_again(tmp_path):
    """The shipped transcription is what the generator writes."""
    write_paper(tmp_path)
    made = sorted(path.relative_to(tmp_path) for path in tmp_path.rglob("*.*"))
    assert made == sorted(path.relative_to(DATA / "paper") for path in (DATA / "paper").rglob("*.*"))
    for path in made:
        assert (tmp_path / path).read_bytes() == (DATA / "paper" / path).read_bytes()


def test_table_3_errors_are_its_own():
    """The printed errors are relative to the theoretical value, but for the eighth (4.9 for 4.6)."""
    measured = read_column("paper/table-3", "peaks", "peak_normal_force")
    printed = read_column("paper/table-3", "peaks", "printed_peak_normal_force")
    gap = np.abs(100.0 * (printed - measured) / printed - read_column("paper/table-3", "errors", "printed_error"))
    assert np.flatnonzero(gap > 0.1).tolist() == [7]
    assert 100.0 * (printed / measured - 1.0).max() == pytest.approx(7.2, abs=0.05)
    assert 100.0 * (printed / measured - 1.0).mean() == pytest.approx(5.4, abs=0.2)


def test_table_4_errors_are_its_own():
    """Relative to the measured value, but for the fourth and eleventh; friction over load is 0.218 +- 0.006."""
    measured = read_column("paper/table-4", "peaks", "peak_friction_force")
    printed = read_column("paper/table-4", "peaks", "printed_peak_friction_force")
    gap = np.abs(100.0 * np.abs(printed / measured - 1.0) - read_column("paper/table-4", "errors", "printed_error"))
    assert np.flatnonzero(gap > 0.2).tolist() == [3, 10]
    ratio = measured / read_column("paper/table-4", "records", "normal_load")
    assert ratio.mean() == pytest.approx(0.218, abs=1e-3) and ratio.std(ddof=1) == pytest.approx(0.006, abs=2e-3)


@pytest.mark.parametrize(("table", "share"), [("table-5", 0.6318), ("table-6", 0.2745)])
def test_momenta_add_up(table, share):
    """The total is the norm of the three components, and the reductions are their own."""
    before = read_column(f"paper/{table}", "angular-momentum", "angular_momentum_before")
    after = read_column(f"paper/{table}", "angular-momentum", "angular_momentum_after")
    for momentum in (before, after):
        assert np.linalg.norm(momentum[:3]) == pytest.approx(momentum[3], rel=1e-4)
    assert 1.0 - after[3] / before[3] == pytest.approx(share, abs=1e-4)
    printed = read_column(f"paper/{table}", "angular-momentum", "reduction")
    assert np.abs(100.0 * (1.0 - after / before) - printed).max() < 0.02


def test_data_stays_small():
    """All of data/ below 6 MB."""
    assert sum(path.stat().st_size for path in DATA.rglob("*") if path.is_file()) < 6e6
