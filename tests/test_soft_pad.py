"""A soft body far from the ball: 5 N over a quarter of a second, made by SciPy, fitted by a power law."""

import csv
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import ddetumble as dd
from ddetumble.cli import main
from ddetumble.inference.problem import count_steps


ROOT = Path(__file__).resolve().parent.parent
MASS, RESTITUTION, FORCE, EXPONENT = 0.55, 0.8, 0.62, 1.2  # kg, -, N at 10 mm, -
NOISE, ORIGIN = 0.05, 0.012  # N, s
pytestmark = pytest.mark.slow


def press(speed: float, loss: float) -> tuple[np.ndarray, np.ndarray]:
    """Force [N] every 10 ms of a mass on a power-law spring whose force is multiplied by 1 + loss w."""
    def force(x, w):
        return FORCE * max(x / 0.01, 0.0) ** EXPONENT * (1.0 + loss * w)

    def leave(t, y):
        return y[0] + 1e-12

    leave.terminal, leave.direction = True, -1
    found = solve_ivp(lambda t, y: [y[1], -force(*y) / MASS], (0.0, 2.0), [0.0, speed], max_step=1e-3, rtol=1e-10,
                      atol=1e-12, events=leave, dense_output=True)
    time = np.arange(-0.05, 0.4, 0.01) + 0.0037
    touch = (time > 0) & (time < found.t[-1])
    assert found.y[1, -1] / -speed == pytest.approx(RESTITUTION, abs=1e-3)
    return time, np.array([force(*found.sol(t)) if there else 0.0 for t, there in zip(time, touch, strict=True)])


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A campaign of six impacts on the pad; pressures mean nothing here."""
    place, random = tmp_path_factory.mktemp("pad") / "pad", np.random.default_rng(4)
    place.mkdir()
    kappa = float(brentq(lambda k: k - np.log1p(k) + k * RESTITUTION + np.log1p(-k * RESTITUTION),
                         0.01, 1.2))  # pyright: ignore[reportArgumentType]
    settings, samples = [], []
    for k, speed in enumerate((0.7, 0.8, 0.85, 0.9, 0.95, 1.05)):
        time, force = press(speed, kappa / speed)  # the closed form for the restitution; at every speed its own loss
        shift = ORIGIN * 0.5 * random.standard_normal()
        settings.append((f"r{k}", 101325.0, round(speed + 0.01 * random.standard_normal(), 4)))
        samples += [(f"r{k}", round(t + shift, 6), round(f + NOISE * random.standard_normal(), 5))
                    for t, f in zip(time, force, strict=True)]
    for name, heads, rows in (("records", ("record", "initial_pressure", "approach_speed"), settings),
                              ("samples", ("record", "time", "normal_force"), samples)):
        with open(place / f"{name}.csv", "w", newline="", encoding="utf-8") as file:
            csv.writer(file).writerows([heads, *rows])

    def field(name, unit, uncertainty=None):
        return {"name": name, "type": "number", "unit": unit} | ({"uncertainty": uncertainty} if uncertainty else {})

    key = {"name": "record", "type": "string"}
    fields = {"records": [key, field("initial_pressure", "Pa"), field("approach_speed", "m/s", "0.01 m/s")],
              "samples": [key, field("time", "s", f"{ORIGIN} s"), field("normal_force", "N", f"{NOISE} N")]}
    resources = [{"name": name, "path": f"{name}.csv", "schema": {"fields": fields[name]}} for name in fields]
    (place / "datapackage.json").write_text(json.dumps({
        "name": "pad", "title": "A mass on a pad", "family": "impact", "known": {}, "licenses": [{"name": "CC0-1.0"}],
        "resources": resources}), encoding="utf-8")
    return place


@pytest.fixture(scope="module")
def fitted(folder):
    return dd.fit(folder, "power-law")


def test_a_soft_pad_is_fitted_without_a_start(fitted):
    assert fitted.converged and fitted.chi2_reduced < 1.3
    truth = {"effective_mass": MASS, "restitution": RESTITUTION, "stiffness_force": FORCE, "exponent": EXPONENT}
    for name, value in truth.items():
        p = fitted.parameters[name]
        assert p.determined and abs(p.estimate - value) < 4 * p.sd and p.sd < 0.3 * value, name


@pytest.mark.parametrize("start", [
    {"stiffness_force": 0.05}, {"stiffness_force": 1.0}, {"stiffness_force": 5.0}, {"stiffness_force": 20.0},
    {"stiffness_force": 1e4, "exponent": 3.0}, {"effective_mass": 50.0}, {"restitution": 0.05}], ids=str)
def test_every_start_ends_at_the_same_minimum(folder, fitted, start):
    found = dd.fit(folder, "power-law", start=start)
    assert found.converged and found.chi2 == pytest.approx(fitted.chi2, abs=0.1)


def test_a_start_from_which_the_integration_breaks_down_tells_nothing_of_it(folder, fitted, tmp_path):
    start = {"stiffness_force": 0.6184, "exponent": 3.459, "restitution": 0.0911, "effective_mass": 9.779}
    units = {"stiffness_force": "N", "effective_mass": "kg"}
    given = [word for name, value in start.items() for word in ("--free", f"{name}={value} {units.get(name, '')}")]
    done = subprocess.run([sys.executable, "-m", "ddetumble", "fit", str(folder), "-m", "power-law", *given, "-q", "-o",
                           str(tmp_path / "fit")], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0 and done.stderr == ""
    content = json.loads((tmp_path / "fit" / "fit.json").read_text(encoding="utf-8"))
    assert content["chi2"] == pytest.approx(fitted.chi2, abs=0.1)


def test_the_steps_of_all_starts_are_counted(fitted):
    problem = fitted.problem
    with count_steps() as taken:
        again = [problem.solve(fitted.solution.names, fitted.solution.u + shift) for shift in (0.0, 0.02)]
    assert taken == [one.steps for one in again] and taken[1] > 0
    assert fitted.steps > fitted.solution.steps and str(fitted.steps) in fitted.state


def test_a_fit_at_a_bound_has_not_converged(folder):
    found = dd.fit(folder, "power-law", bounds={"exponent": (2.0, 3.0)})
    assert found.parameters["exponent"].at_bound == "lower" and not found.converged
    assert "exponent" in found.state and found.parameters["restitution"].at_bound == ""


def test_a_model_that_never_meets_the_data_is_no_fit(folder, tmp_path, capsys):
    """Fixed at the ball's stiffness its pulse is over before the first sample that counts."""
    fixed = {"stiffness_force": 5e3, "effective_mass": 0.5, "exponent": 1.5}
    with pytest.raises(dd.ComputationError, match="normal_force"):
        dd.fit(folder, "power-law", fixed=fixed)


def test_the_command_fits_it(folder, tmp_path, capsys):
    assert main(["fit", str(folder), "-m", "power-law", "-o", str(tmp_path / "fit")]) == 0
    content = json.loads((tmp_path / "fit" / "fit.json").read_text(encoding="utf-8"))
    assert content["converged"] and abs(content["parameters"]["effective_mass"]["estimate"] - MASS) < 0.05


def test_comparing_and_discovering_begin_there_too(folder):
    found = dd.compare(folder, "power-law")
    assert found.chi2_reduced < 1.3 and found.nrmse < 0.1


@pytest.mark.study  # every reference model is compiled
def test_a_body_twenty_times_as_stiff_is_no_noise(tmp_path, capsys):
    """Pulses that no ball of that pressure makes, in five files with 0.4 N of noise: what the ball leaves is not taken
    for noise, and the reference model that comes nearer is found."""
    random, rows = np.random.default_rng(3), ["file,pressure [MPa],speed [m/s]"]
    for k, (pressure, speed) in enumerate(((0.8, 0.3), (0.8, 0.6), (1.6, 0.3), (1.6, 0.6), (0.8, 0.3))):
        duration = 1.15 * np.pi * np.sqrt(1.5 / (2.0 * np.pi * 0.03 * (pressure - 0.1) * 1e6))
        time = np.arange(-0.004, duration + 0.01, 1e-4)
        shape = np.sin(np.pi * np.clip(time / duration, 0.0, 1.0) ** 0.93) ** 1.1
        force = 1.5 * 1.7 * speed * shape / np.trapezoid(shape, time) + 0.4 * random.standard_normal(time.size)
        np.savetxt(tmp_path / f"r{k}.csv", np.stack([1e3 * time, force], axis=1), "%.4f", ",", header="t [ms],Fz [N]",
                   comments="")
        rows.append(f"r{k}.csv,{pressure},{speed}")
    (tmp_path / "settings.csv").write_text("\n".join(rows), encoding="utf-8")
    campaign = dd.import_tests([tmp_path / f"r{k}.csv" for k in range(5)], conditions=tmp_path / "settings.csv")
    found = dd.discover(campaign, settings=dd.SelectionSettings(rival_references=1, finalists=2, further_finalists=0))
    assert found.verdict in ("unexplained", "improved") and found.noise_nrmse < 0.02
    nearest = min(found.references, key=lambda one: one["nrmse"])
    assert nearest["model"] == "power-law" and nearest["nrmse"] < 0.2 * found.steps[0].nrmse
    assert "-m power-law" in found.sentence  # what to type
    dd.write_campaign(tmp_path / "stiff", campaign)
    assert main(["compare", str(tmp_path / "stiff")]) == 0
    assert f"ddetumble compare {tmp_path / 'stiff'} -m paper -m " in capsys.readouterr().out
