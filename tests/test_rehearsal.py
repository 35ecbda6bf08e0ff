"""Rehearsals: a plan measured again and again is measured as it says, and hides what it says."""

import dataclasses as dc
import json

import numpy as np
import pytest
from scipy import stats

import ddetumble as dd
from ddetumble.cli import main
from ddetumble.exam.examination import examine
from ddetumble.exam.rehearsal import Prepared, Rehearsal, hide_effects, measure_plan, prepare_plan
from ddetumble.exam.scoring import is_right


PLAN = "normal_load [N],internal_pressure [MPa],slip_speed [m/s]\n5,1,0.05\n10,1,0.2\n20,1,0.05\n20,2,0.2\n10,2,0.1\n"


@pytest.fixture(scope="module")
def asked(tmp_path_factory):
    """A table of planned friction tests."""
    path = tmp_path_factory.mktemp("plan") / "plan.csv"
    path.write_text(PLAN)
    return Rehearsal(str(path), seed=4)


@pytest.fixture(scope="module")
def bench(asked) -> Prepared:
    return prepare_plan(asked)


def whiten(bench, campaign, u, z):
    """Whitened residual of a measured campaign about the model at given settings."""
    problem = bench.selection.problem
    values = np.array(problem.records.stack.values)
    for r, key in enumerate(problem.records.keys):
        for c, channel in enumerate(problem.records.channels):
            values[r, c, : problem.records.lengths[r]] = campaign.trace(key)[channel]
    measured = dc.replace(problem.records, stack=dc.replace(problem.records.stack, values=values))
    return type(problem)(problem.space, measured).solve([], u, z, moving=False).residual


def test_noise_and_settings_are_as_stated(bench):
    """About the true settings, drawn first, whitened readings are independent and of unit variance."""
    found = []
    for seed in range(40):
        campaign = measure_plan(bench, bench.solution.u, np.random.default_rng(seed))
        z = np.random.default_rng(seed).standard_normal(bench.solution.z.shape)
        used = np.asarray(bench.selection.problem.records.stack.weights)[: len(campaign.records), 0] > 0
        found.append(whiten(bench, campaign, bench.solution.u, z)[used])
    shocks = np.concatenate(found)
    # Bounds that 1 run in 10,000 passes.
    assert abs(shocks.mean()) < 3.9 / np.sqrt(shocks.size)
    low, high = stats.chi2.ppf([5e-5, 1 - 5e-5], shocks.size) / shocks.size
    assert low < np.mean(shocks**2) < high


@pytest.mark.parametrize("seed", range(4))
def test_strength_is_what_a_refit_leaves(bench, seed):
    """A refit of the reference model to noise-free records with the effect leaves the strength that is told."""
    hidden = hide_effects(bench, 1, np.random.default_rng(seed))
    (at, _, reached), = hidden.values()
    u = bench.solution.u.copy()
    for name, value in at.items():
        u[bench.selection.space.index[name]] = value
    problem = bench.selection.problem
    clean = problem.solve([], u, bench.solution.z, moving=False)
    values = np.array(problem.records.stack.values)
    values[: len(clean.channels)] = clean.channels
    stack = dc.replace(problem.records.stack, values=values)
    left = type(problem)(problem.space, dc.replace(problem.records, stack=stack)).solve(
        bench.selection.base, bench.solution.u, bench.solution.z)
    # Settings that are moved cost what they are known to.
    rise = np.sum(left.residual**2) + np.sum(left.z**2)
    assert np.sqrt(rise / bench.selection.samples) == pytest.approx(reached, rel=0.1)


def test_the_plan_is_shown(asked, bench):
    """Its tests, equal ones in one row, in units that people use; nothing where the table is not there any more."""
    _, header, rows = asked.list_tests()
    assert len(header) == 4 and all(len(row) == 4 for row in rows)
    assert sum(int(row[-1]) for row in rows) == bench.selection.records.count
    assert dc.replace(asked, plan="nowhere.csv").list_tests() is None


@pytest.mark.slow
def test_a_rehearsal_goes_on_and_repeats_itself(asked, tmp_path):
    rows = examine(asked, range(2), tmp_path / "a", workers=1)
    rows = examine(asked, range(4), tmp_path / "a", workers=1, keep=True)
    alone, = examine(asked, [3], tmp_path / "b", workers=1)
    assert [row["kind"] for row in rows] == ["nothing", "one", "nothing", "one"]
    assert {k: v for k, v in rows[3].items() if "seconds" not in k} == {
        k: v for k, v in alone.items() if "seconds" not in k}
    truth = json.loads((tmp_path / "a" / "kept" / "case-0003" / "truth.json").read_text())
    kept = dd.read_campaign(tmp_path / "a" / "kept" / "case-0003" / "campaign")
    assert truth["effects"] == rows[3]["effects"] and len(kept.records) == 5
    assert all(row["error"] is None for row in rows) and is_right(rows[0])


@pytest.mark.slow
def test_a_measured_campaign_is_rehearsed_by_command(tmp_path, capsys):
    assert main(["exam", "--plan", "slip-c", "--cases", "2", "--workers", "1", "-o",
                 str(tmp_path / "out")]) == 0
    card = json.loads((tmp_path / "out" / "scorecard.json").read_text())
    assert card["cases"] == 2 and card["exam"]["truths"] == ["nothing", "one", "two"]
    assert "--plan" in card["command"] and (tmp_path / "out" / "report.html").is_file()


@pytest.mark.parametrize("arguments", [
    [], ["--family", "slip", "--plan", "slip-c"], ["--plan", "nowhere"], ["--plan", "nowhere.csv"],
    ["--plan", "slip-c", "--truth", "outside"], ["--plan", "slip-c", "--bench", "hum"],
    ["--plan", "slip-c", "--channel", "tangential_force: 1 N"], ["--family", "slip", "--model", "paper-e"],
    ["--plan", "slip-c", "--seed", "-1"]])
def test_what_makes_no_sense_is_refused(arguments, tmp_path, capsys):
    assert main(["exam", *arguments, "--cases", "1", "-o", str(tmp_path / "out")]) == 2
    assert "Traceback" not in capsys.readouterr().err and not (tmp_path / "out").exists()
