"""A kind of test of the user's own, given as `FILE.py:NAME`: every verb, on drops simulated by SciPy alone."""

import json
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp

import ddetumble as dd
from ddetumble.cli import main


FILE = Path(__file__).resolve().parent.parent / "docs" / "own_kind.py"
FAMILY = f"{FILE}:DROP"
MASS, DIAMETER, COEFFICIENT, DAMPING, WALL = 0.43, 0.22, 0.9, 0.08, 9e3
NOISE = 5.0  # m/s^2, of readings up to some 1,500
CONDITIONS = [(h, p) for h in (0.25, 0.6, 1.1) for p in (1.4, 1.7, 2.1)]  # m, bar
KNOWN = ("mass=0.43 kg", "diameter=0.22 m")


def simulate(height, pressure, time, wall=WALL):
    """Reading of the accelerometer [m/s^2]: gas, damping in proportion to it, and a wall that is a spring."""
    gauge = 1e5 * pressure - 101325.0

    def force(d, w):
        squeezed = gauge * COEFFICIENT * np.pi * DIAMETER * d * (1.0 + DAMPING * w) + wall * d
        return np.where(d > 0, np.maximum(squeezed, 0.0), 0.0)

    found = solve_ivp(lambda t, y: [y[1], 9.81 - force(y[0], y[1]) / MASS], (0.0, time[-1]),
                      [0.0, np.sqrt(2 * 9.81 * height)], method="DOP853", rtol=1e-10, atol=1e-12, max_step=1e-4,
                      t_eval=time)
    return force(*found.y) / MASS


def write_raw(folder, wall):
    """Raw files of a laboratory, each with its own errors of height, pressure and trigger, and their settings."""
    random, rows = np.random.default_rng(7), []
    folder.mkdir()
    for k, (height, pressure) in enumerate(CONDITIONS):
        time = np.arange(1e-4, 0.018, 2.5e-4)  # first touch falls between two samples
        true = height + 2e-3 * random.normal(), pressure * (1 + 3e-3 * random.normal())
        since = np.maximum(time + 0.02e-3 * random.normal(), 0.0)
        reading = simulate(*true, since, wall) + NOISE * random.normal(size=time.size)
        pd.DataFrame({"t [ms]": 1e3 * time, "acc [m/s^2]": reading}).to_csv(folder / f"d{k}.csv", index=False)
        rows.append({"file": f"d{k}.csv", "h [mm]": 1e3 * height, "P0 [bar]": pressure})
    pd.DataFrame(rows).to_csv(folder / "settings.csv", index=False)
    return folder


def read_raw(folder, family=FAMILY):
    """These files as a campaign, through Python."""
    return dd.import_tests(
        folder, conditions=folder / "settings.csv", family=family, known=KNOWN, gauge=False,
        uncertainty=("acceleration=5 m/s^2", "drop_height=2 mm", "initial_pressure=0.3 %", "time=0.02 ms"))


@pytest.fixture(scope="module")
def raw(tmp_path_factory):
    """Raw files of drops with a stiff wall."""
    return write_raw(tmp_path_factory.mktemp("lab") / "drops", WALL)


@pytest.fixture(scope="module")
def folder(raw):
    """A campaign of them, imported by the command."""
    target = raw.parent / "tests"
    stated = ("acceleration=5 m/s^2", "drop_height=2 mm", "initial_pressure=0.3 %", "time=0.02 ms")
    words = [part for text in stated for part in ("--uncertainty", text)]
    words += [part for text in KNOWN for part in ("--known", text)]
    assert main(["import", str(raw), "--conditions", str(raw / "settings.csv"), "--family", FAMILY, "--absolute",
                 *words, "-o", str(target)]) == 0
    return target


@pytest.fixture(scope="module")
def found(folder):
    """What `discover` makes of them."""
    return dd.discover(dd.read_campaign(folder))


def test_import(raw, folder):
    """The command and Python agree; the descriptor names the kind's file from the campaign's folder on."""
    written, made = dd.read_campaign(folder), read_raw(raw)
    assert written.family == made.family == "drop" and written.samples is not None and made.samples is not None
    pd.testing.assert_frame_equal(written.records, made.records)
    np.testing.assert_allclose(written.samples["acceleration"], made.samples["acceleration"])
    named = json.loads((folder / "datapackage.json").read_text())["family"]
    file, _, name = named.rpartition(":")
    assert name == "DROP" and (folder / file).resolve() == FILE and not Path(file).is_absolute()
    assert dd.check_plausibility(written) == ()


def test_compare(folder, capsys):
    result = dd.compare(folder)
    assert str(result) and result.lack_of_fit.rejected
    assert main(["compare", str(folder), "--effect", "wall-spring", "--effect", "wall-dashpot"]) == 0
    assert "wall-dashpot" in capsys.readouterr().out


def test_fit_recovers_what_was_simulated(folder):
    result = dd.fit(dd.read_campaign(folder), effects=["wall-spring"])
    for name, true in {"area_coefficient": COEFFICIENT, "damping": DAMPING, "wall-spring.k": WALL}.items():
        one = result.parameters[name]
        assert abs(one.estimate - true) < 4 * one.sd and one.sd < 0.1 * true, name


def test_discover_finds_the_wall(found):
    assert found.verdict == "explained" and found.effects == ("wall-spring",)
    one = found.steps[-1].parameters["wall-spring.k"]
    assert abs(one.estimate - WALL) < 4 * one.sd


def test_nothing_is_found_where_nothing_is_hidden(tmp_path):
    result = dd.discover(read_raw(write_raw(tmp_path / "drops", 0.0)))
    assert result.verdict == "nothing-missing" and result.effects == ()


@pytest.mark.slow
def test_missing_force(folder, tmp_path):
    """What is missing is drawn over the depression, and rises like the spring that was hidden."""
    assert main(["missing", str(folder), "-o", str(tmp_path / "missing")]) == 0
    shapes = json.loads((tmp_path / "missing" / "missing.json").read_text())["shapes"]
    assert (tmp_path / "missing" / "missing.html").is_file()
    over = next(one for one in shapes if one["variable"] == "depression")
    x, values = np.array(over["x"]), np.array(over["values"][0])
    deep = (x > 0.3 * x.max()) & (x < 0.9 * x.max())
    assert np.all(np.diff(values[deep]) > 0)


@pytest.mark.slow
def test_commands(folder, tmp_path, capsys):
    """Discovery with its report, fit, prediction, next test and posterior, one from the folder of the other."""
    discovery, fitted = tmp_path / "discovery", tmp_path / "fit"
    assert main(["discover", str(folder), "-o", str(discovery)]) == 0
    assert "wall-spring" in capsys.readouterr().out and (discovery / "report.html").stat().st_size > 1e4
    assert json.loads((discovery / "result.json").read_text())["effects"] == ["wall-spring"]
    assert main(["fit", str(folder), "-e", "wall-spring", "-o", str(fitted)]) == 0
    time = np.arange(0.0, 0.018, 2.5e-4)
    table = pd.DataFrame({"record": "n1", "drop_height": 0.8, "initial_pressure": 1.9e5, "time": time})
    table.to_csv(tmp_path / "conditions.csv", index=False)
    for one in (discovery, fitted):
        out = one.with_suffix(".csv")
        assert main(["predict", str(one), str(tmp_path / "conditions.csv"), "-o", str(out)]) == 0
        predicted, true = pd.read_csv(out), simulate(0.8, 1.9, time)
        assert np.sqrt(np.mean((predicted["acceleration"] - true) ** 2)) < 0.02 * true.max()
    assert main(["design", str(discovery)]) == 0
    assert "height" in capsys.readouterr().out
    posterior = tmp_path / "posterior"
    assert main(["sample", str(folder), "-e", "wall-spring", "--effective", "100", "--steps", "600", "--ensembles", "2",
                 "-o", str(posterior)]) == 0
    assert (posterior / "report.html").is_file()


def test_the_same_in_python(found, folder):
    """What discover returned goes into the other verbs."""
    table = dd.predict(found.best, pd.DataFrame({"record": ["a"], "drop_height": [0.8], "initial_pressure": [1.9e5]}))
    assert len(table) and np.isfinite(table.select_dtypes("number").to_numpy()).all()
    assert dd.design(found.best)


def test_the_object_itself(raw, tmp_path):
    """In Python the family is given as it is; the campaign names its file all the same."""
    from docs.own_kind import DROP

    written = dd.write_campaign(tmp_path / "tests", read_raw(raw, DROP))
    assert written.family == DROP.name == dd.read_campaign(tmp_path / "tests").family
    assert json.loads((tmp_path / "tests" / "datapackage.json").read_text())["family"].endswith("own_kind.py:DROP")


def test_a_campaign_away_from_its_file_is_refused(folder, tmp_path):
    """The path counts from the campaign's folder."""
    away = tmp_path / "somewhere" / "else" / "tests"
    shutil.copytree(folder, away)
    with pytest.raises(dd.InputError, match="own_kind.py"):
        dd.read_campaign(away)


def test_lists(capsys):
    """Its models and effects are listed like those of the toolkit."""
    assert main(["models", "--family", FAMILY]) == 0 and "membrane" in capsys.readouterr().out
    assert main(["effects", "--family", FAMILY]) == 0 and "wall-dashpot" in capsys.readouterr().out


def test_its_effects_have_no_trial_records():
    """`check_effect` says so, and calls nothing in them broken."""
    from docs.own_kind import WallSpring

    (only,) = dd.check_effect(WallSpring).checks
    assert only.name == "complete" and "none of drop" in only.sentence


@pytest.mark.parametrize("family", [f"{FILE}:NOTHING", f"{FILE}:KIND", "nowhere.py:DROP", "moon"])
def test_what_is_no_kind_is_refused(raw, family):
    with pytest.raises(dd.InputError):
        read_raw(raw, family)
