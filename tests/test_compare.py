"""One model beside the measurements: errors against the noise, where they sit, and what is said about them."""

import dataclasses as dc
import json
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from ddetumble._errors import ComputationError, InputError
from ddetumble._settings import find_data
from ddetumble.cli import main
from ddetumble.cli.selection import _list_further
from ddetumble.contact.effect import identify_model
from ddetumble.contact.law import AbstractDamped, AbstractReference, Ball
from ddetumble.effects.impact import ArmServo, WallStiffness
from ddetumble.exam.simulators.campaigns import write_package
from ddetumble.exam.simulators.impact_campaigns import make_campaign
from ddetumble.families import FAMILIES
from ddetumble.inference.archive import make_fitted, resolve_model, save_model
from ddetumble.inference.estimation import fit
from ddetumble.inference.models import is_fitted
from ddetumble.inference.parameters import ParameterSpace
from ddetumble.inference.problem import Problem
from ddetumble.inference.stack import default_noise, stack_records
from ddetumble.measurement.package import read_campaign
from ddetumble.selection import localise
from ddetumble.selection.compare import Beaten, bin_residuals, compare, conclude
from ddetumble.selection.result import Place, Trace
from ddetumble.selection.series import measure_ratio, nrmse, nrmse_by_channel
from ddetumble.selection.settings import DEFAULT
from ddetumble.selection.verdict_facts import _level
from tests.helpers_report import make_slip_discovery


BASE = {"effective_mass": 1.3, "restitution": 0.72}
WALL = {"wall-stiffness": {"k_w": 900.0, "q": 1.0}}


def make(folder, seed, effects=None):
    """Simulate and write a campaign of twelve records."""
    made = make_campaign("made", seed, effects or {}, BASE, (5e5, 1e6, 2e6), (0.2, 0.45), 2, interval=1e-3)
    write_package(folder, made)
    return read_campaign(folder)


@pytest.mark.slow
def test_adequate(tmp_path):
    """Where nothing is missing, noise is all that is left, and the mass is the true one."""
    found = compare(make(tmp_path, 1))
    assert not found.lack_of_fit.rejected
    assert 0.9 < found.chi2_reduced < 1.1 and found.nrmse == pytest.approx(found.noise_nrmse, rel=0.1)
    mass = found.parameters["effective_mass"]
    assert abs(mass.estimate - 1.3) < 4 * mass.sd and found.fitted == ("effective_mass", "restitution")
    assert len(found.records) == 12 and len(found.conditions) == 6 and (found.conditions["records"] == 2).all()
    assert found.records["ratio"].between(0.7, 1.3).all()
    score = found.residuals["mean"] / found.residuals["standard_error"]
    assert np.mean(np.abs(score) < 3) > 0.9
    # Printed in units that the headings name.
    printed = str(found).split("By condition:\n")[1].split("\n\n")[0].splitlines()
    assert printed[0].split("]")[:2] == [" initial pressure [MPa", "  approach speed [m/s"] and "rms [N]" in printed[0]
    pressures = [float(row.split()[0]) for row in printed[1:]]
    np.testing.assert_allclose(pressures, 1e-6 * found.conditions["initial_pressure"], rtol=1e-3)


@pytest.mark.slow
def test_tumbling_records_have_no_conditions():
    """Their error over the noise is that of chi-square, and of `discover`; no table of nameless conditions is printed,
    and no model is offered that is the same by another name."""
    campaign = read_campaign(find_data() / "tumble-a")
    found = compare(campaign)
    assert measure_ratio(found.traces) == pytest.approx(np.sqrt(found.chi2_reduced), rel=0.02)
    assert not found.names_conditions and "By condition" not in str(found) and "By record" in str(found)
    assert "settings" not in str(found).split("Error:")[1].splitlines()[0]
    assert found.chi2_reduced > DEFAULT.far and len(_list_further(found, "tumble-a", "paper", campaign)) == 1
    assert identify_model(resolve_model("rigid-body", "tumble").reference) == identify_model(
        resolve_model("paper", "tumble").reference) != identify_model(resolve_model("paper").reference)


def test_error_over_the_noise_is_one_number():
    """Every channel counts alike, whatever its signal is; the verdict and files say the same."""
    time, left = np.arange(4.0), np.array([1.0, -1.0, 1.0, np.nan])
    traces = [Trace("r", f"angular_velocity_{axis}", "rad/s", {}, time, size * (1.0 + sd * ratio * left),
                    np.full(4, size), size * sd, time, np.ones(4), "tumble")
              for axis, size, sd, ratio in (("x", 1.0, 0.1, 3.0), ("y", 9.0, 1e-3, 1.0))]
    assert measure_ratio(traces) == pytest.approx(np.sqrt(5.0))
    assert nrmse(traces) / nrmse(traces, noise=True) > 2.9  # which goes by the channel whose signal is smaller
    found = make_slip_discovery()
    step = dc.replace(found.steps[0], traces=tuple(traces))
    assert _level(step, found)["ratio"] == pytest.approx(np.sqrt(5.0))


@pytest.mark.slow
def test_missing(tmp_path, capsys):
    """A stiff wall: the reference model fails and says where; the fitted model that has it does not, unrefitted."""
    campaign = make(tmp_path / "campaign", 2, WALL)
    found = compare(campaign)
    assert found.lack_of_fit.rejected and found.where
    assert found.channels["ratio"][0] > 1.1 and found.nrmse > 1.1 * found.noise_nrmse
    assert set(found.residuals["variable"]) == {"time", "depression", "depression_rate", "initial_pressure",
                                               "approach_speed", "sequence"}
    space = ParameterSpace(Ball(), (WallStiffness,))
    problem = Problem(space, stack_records(campaign))
    solution = problem.solve(space.of([None, "wall-stiffness"]), space.coordinates(), tolerance=1e-4)
    save_model(tmp_path / "fit", make_fitted(
        campaign=campaign, model_name="paper", space=space, solution=solution,
        noise={"normal_force": default_noise(campaign, "normal_force", np.arange(9) * 1e-3)},
        effects=["wall-stiffness"]))
    grown = compare(campaign, str(tmp_path / "fit"))
    assert not grown.lack_of_fit.rejected and grown.fitted == () and grown.parameters == {}
    assert grown.nrmse == pytest.approx(grown.noise_nrmse, rel=0.1)
    fixed = compare(campaign, refit=False)
    assert fixed.fitted == () and fixed.channels["ratio"][0] > found.channels["ratio"][0]
    assert main(["compare", str(tmp_path / "campaign"), "-o", str(tmp_path / "out")]) == 0
    told = capsys.readouterr().out  # and what to type next
    assert f"ddetumble discover {tmp_path / 'campaign'}" in told and "ddetumble compare" not in told
    content = json.loads((tmp_path / "out" / "compare.json").read_text())
    assert content["sentence"] == found.sentence and len(content["records"]) == 12
    assert (tmp_path / "out" / "comparison.html").stat().st_size > 10000


@pytest.mark.slow
def test_chi_square_is_that_of_the_fit(tmp_path):
    """Of a fit in hand and of its folder, where what a poor model leaves passes for correlated noise."""
    campaign = read_campaign(find_data() / "impact-b")
    found = fit(campaign, Ball() + ArmServo())
    found.save(tmp_path / "fit")
    assert found.noise["normal_force"].correlation > 0.3
    for model in (found, tmp_path / "fit"):
        assert compare(campaign, model).chi2_reduced == pytest.approx(found.chi2_reduced, rel=1e-6)


def compared(squares, losses, rejected):
    """What `compare` found of one model, as far as models are chosen by it; errors and deviances are by record."""
    return SimpleNamespace(
        heldout_nrmse=float(np.sqrt(np.sum(squares))), noise_nrmse=0.01, heldout_squares=np.array(squares),
        heldout_losses=np.array(losses), groups=np.arange(len(squares)), lack_of_fit=SimpleNamespace(rejected=rejected),
        records=pd.DataFrame({"record": [f"r{k}" for k in range(len(squares))]}))


SAME = 1e-5 * np.ones(6)
FEW = SAME + [0.0, 4e-4, 0.0, 4.5e-4, 1e-4, 0.0]  # two conditions make the error three times as large


@pytest.mark.parametrize(("lacking", "deviance", "beaten", "alike"), [
    ((True, False), 2000.0, (Beaten(0, 1, True, 2000.0, ("r3", "r1")),), []),  # a misfit that a few records hold
    ((True, True), 2000.0, (Beaten(0, 1, False, 2000.0, ("r3", "r1")),), []),  # where the other one fails too
    ((True, False), 5.0, (), ["a"]),  # no more than chance
    ((False, False), 2000.0, (), ["a"]),  # and no lack of fit
])  # fmt: skip
def test_which_model_the_data_reject(lacking, deviance, beaten, alike):
    """Errors within two standard errors leave two models open, unless one has a misfit that the other has not."""
    wrong = compared(FEW, 100.0 + np.array([0.0, 0.4, 0.0, 0.6, 0.0, 0.0]) * deviance, lacking[0])
    right = compared(SAME, 100.0 * np.ones(6), lacking[1])
    found = conclude((wrong, right), ("a", "b"))
    assert (found.best, found.alike, found.beaten) == (1, (0,), beaten)
    assert found.sentence.facts["alike"] == alike
    told = [(one["refuted"], one["records"]) for one in found.sentence.facts["beaten"]]
    assert told == [(one.refuted, list(one.records)) for one in beaten]


def test_a_model_may_cross_validate_best_and_be_rejected():
    """Where the error is the smaller one by chance; and one that lies further away is no matter of few records."""
    wrong, right = compared(SAME, 900.0 * np.ones(6), True), compared(FEW, 100.0 * np.ones(6), False)
    far = compared(SAME + 1e-3, 900.0 * np.ones(6), True)
    found = conclude((right, wrong, far), ("right", "wrong", "far"))
    assert (found.best, found.alike) == (1, (0,))
    assert [(one.model, one.other, one.refuted) for one in found.beaten] == [(1, 0, True)]


@pytest.mark.slow
def test_noise_that_counts_is_told_where_it_is_not_what_residuals_show():
    """Of two models that fail, one leaves a misfit that passes for noise of twice the size."""
    for name, differs in (("impact-b", True), ("impact-c", False)):
        found = compare(find_data() / name)
        noise, ratio = found.noise["normal_force"], found.channels["ratio"].iloc[0]
        assert found.lack_of_fit.rejected and (noise["sd"] > 1.1 * noise["stated_sd"]) == differs
        assert found.channels["rms"].iloc[0] == pytest.approx(ratio * noise["stated_sd"])
        sizes = (f"{noise['stated_sd']:.2g} N", f"{noise['sd']:.2g} N")
        assert any(all(one in note for one in sizes) for note in found.notes) == differs


def test_notes_name_the_models_that_they_are_of():
    """Those that hold for all of them stand by themselves."""
    models = [compared(SAME, 100.0 * np.ones(6), False) for _ in range(3)]
    for one, notes in zip(models, (("x", "y"), ("y",), ("y", "x")), strict=True):
        one.notes = notes
    assert conclude(tuple(models), ("a", "b", "c")).notes == ["a and c: x", "y"]


def test_a_model_that_fails_stops_no_other(monkeypatch):
    """Of several; alone it is an error, and so are several that all fail."""
    def work(campaign, model, name, refit):
        if model == "matunaga":
            raise ComputationError("it went to infinity")
        return compared(SAME, np.ones(6), False)

    monkeypatch.setattr("ddetumble.selection.compare._compare_one", work)
    campaign = read_campaign(find_data() / "impact-b")
    found = compare(campaign, "paper", "matunaga", Ball() + WallStiffness())
    assert found.names == ("paper", "paper + wall-stiffness") and [*found.failed] == ["matunaga"]
    for models in (("matunaga",), ("matunaga", "matunaga")):
        with pytest.raises(ComputationError, match="infinity"):
            compare(campaign, *models)


class Halfway(AbstractReference):
    """A model of which only the force is there."""

    def elastic(self, contact):
        return contact.depression


class Spring(AbstractDamped):
    """All that a model of one's own needs."""

    def elastic(self, contact):
        return 1e4 * contact.depression


def test_models_of_ones_own():
    """A class with a force alone is a model if it derives from a damped one; else the error names what is missing."""
    assert resolve_model(Spring).reference.provides == ("damping",)
    with pytest.raises(InputError, match="lacks damping, inertia, provides and rebound"):
        resolve_model(Halfway)
    with pytest.raises(InputError, match="a SimpleNamespace is not a model.*of the model paper") as told:
        resolve_model(SimpleNamespace(model="paper", traces=list(range(1000))))
    assert len(str(told.value)) < 200


def test_refused(tmp_path):
    campaign = read_campaign(find_data() / "paper" / "figure-8")
    with pytest.raises(InputError, match="no model"):
        compare(campaign, "no-such-model")


def test_places(monkeypatch):
    """Beside the place of a direction those in its range stand, too, but for one that holds nearly all the misfit."""
    found = [Place("normal_force", "depression", (0.02, 0.03), "loading", share) for share in (0.6, 0.95)]
    fit = SimpleNamespace(loss=np.full(3, 1e3), solution=SimpleNamespace(chi2=900.0, shared=np.zeros((3, 1, 2))))
    best = SimpleNamespace(loss=np.zeros(3), solution=SimpleNamespace(chi2=300.0))
    problem = SimpleNamespace(settings=DEFAULT, groups=np.arange(3), samples=302.0,
                              family=SimpleNamespace(state="depression"), records=SimpleNamespace(are_values=False))
    monkeypatch.setattr(localise, "residual_places", lambda *_: found)
    monkeypatch.setattr(localise, "_place", lambda *_: Place("normal_force", "depression", (0.01, 0.04), "both", 1.0))
    monkeypatch.setattr(localise, "share_of_range", lambda *_: 0.65)
    first, second = localise.locate(problem, fit, {"direction": best})
    assert (first.share, first.removes) == (0.65, 1.0) and second == found[0]


def test_a_place_is_a_range_of_what_has_one():
    """Whatever a test direction depends on: an attitude has no range, and the misfit lies over time."""
    family, times = FAMILIES["tumble"], np.linspace(0.0, 400.0, 9)
    rates = np.stack([np.full((2, 9), x) for x in (-0.1, 0.0, 0.1)], axis=1)
    fit = SimpleNamespace(solution=SimpleNamespace(state=np.stack([times] * 2), state_rate=np.full((2, 9), 0.2),
                                                   channels=rates, end=np.full(2, 400.0), u=np.zeros(99)))
    for direction in family.directions:
        problem = SimpleNamespace(
            family=family, find_effect=lambda _, found=direction: found,
            campaign=SimpleNamespace(records=pd.DataFrame()),
            records=SimpleNamespace(channels=family.channels[:3]), space=SimpleNamespace(index={}))
        if getattr(direction, "line", None) is None:
            place = localise._place(problem, direction.id, fit)
            assert (place.range == (0.0, 400.0)) == (place.variable == "time")
            assert place.variable == ("time" if direction.variable == "attitude" else direction.variable)


def test_errors_of_traces():
    """Errors of hand-made traces; missing samples count for nothing."""
    time = np.linspace(-0.1, 1.1, 13)
    wave = np.where((time > 0) & (time < 1), 2.0, 0.0)
    measured = wave + 0.5
    measured[3] = np.nan
    traces = [Trace(f"r{k}", channel, "N", {"initial_pressure": 1e6 * (k + 1)}, time, size * measured, size * wave,
                    size * 0.25, np.where(wave > 0, 1e-3, 0.0), np.where(time < 0.5, 1.0, -1.0) * (wave > 0))
              for k in range(2) for channel, size in (("normal_force", 1.0), ("pressure", 1e4))]
    level = np.sqrt(np.nanmean(measured**2))
    assert nrmse_by_channel(traces) == pytest.approx({"normal_force": 0.5 / level, "pressure": 0.5 / level})
    assert nrmse(traces) == pytest.approx(0.5 / level) and nrmse(traces, noise=True) == pytest.approx(0.25 / level)
    blind = dc.replace(traces[0], record="r2", measured=np.full(13, np.nan), sd=float("nan"))
    assert nrmse((*traces, blind), noise=True) == pytest.approx(0.25 / level)

    class Plan:
        conditions = ("initial_pressure",)

    table = bin_residuals(traces, {"r0": 1.0, "r1": 1.0}, Plan, FAMILIES["impact"])
    several = table[table["records"] > 1]
    assert np.allclose(table["mean"], 2.0) and np.allclose(several["standard_error"], 0.0, atol=1e-12)
    assert (table[table["variable"] == "depression"]["samples"] > 0).all()


def test_a_folder_of_a_models_name_changes_nothing(tmp_path, monkeypatch):
    """`ddetumble paper -o paper` leaves such a folder; the built-in model goes by its name all the same."""
    (tmp_path / "paper").mkdir()
    monkeypatch.chdir(tmp_path)
    assert not is_fitted("paper") and isinstance(resolve_model("paper").reference, Ball)
    assert is_fitted(str(tmp_path / "paper"))


@pytest.mark.slow
def test_repeats_are_one_condition_however_few_there_are(tmp_path):
    """Two pressures, two repeats each: too few conditions to leave one out, and yet two rows."""
    write_package(tmp_path, make_campaign("few", 1, {}, BASE, (5e5, 1e6), (0.4,), 2, interval=1e-3))
    found = compare(read_campaign(tmp_path))
    assert np.isnan(found.heldout_nrmse) and found.conditions["records"].tolist() == [2, 2]
