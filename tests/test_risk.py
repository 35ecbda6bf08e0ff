"""Plans under uncertainty: tail means against closed forms, draws, robust plans, rival models, `[uncertainty]`."""

import dataclasses as dc
import json
import shutil
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import linprog
from scipy.stats import norm

import ddetumble as dd
from ddetumble import Ball, CoulombFriction, find_data
from ddetumble._sentences import say
from ddetumble.cli import main
from ddetumble.cli.places import locate_fit
from ddetumble.contact import Striker
from ddetumble.dynamics import Cylinder
from ddetumble.dynamics.surfaces import make_debris
from ddetumble.inference.archive import load
from ddetumble.planning.constraints import CONSTRAINTS, evaluate, judge
from ddetumble.planning.draws import (
    draw_coordinates,
    draw_laws,
    draw_normals,
    draw_posterior,
    pair_laws,
    split_batch,
    vary_law,
)
from ddetumble.planning.measured import find_rivals
from ddetumble.planning.problem import Goal, Limits, StrikeProblem, read_design, strike_debris
from ddetumble.planning.robust import KEPT, RobustProblem, plan_robust_strike, smooth_tail
from ddetumble.planning.scenario import pose_laws, pose_problem
from ddetumble.planning.scenario_file import read_scenario
from ddetumble.planning.sequence import Sequence
from ddetumble.planning.single import ALLOWED, plan_strike
from ddetumble.planning.surroundings import list_surroundings
from ddetumble.planning.uncertainty import (
    Spread,
    assess_plan,
    assess_sequence,
    evaluate_draws,
    find_tail,
    pose_draws,
    summarise_draws,
)


pytestmark = pytest.mark.slow  # one program, compiled first, is in all of them


ROOT = Path(__file__).resolve().parent.parent
SCENARIOS = find_data() / "scenarios"
STAGE = make_debris(Cylinder())
LAW = Striker(Ball(effective_mass=8.0), CoulombFriction(0.2), tangential_mass=8.0, rolling_mass=1e9).extend(())
STATED = {"restitution": (None, 0.03), "friction_coefficient": (None, 0.02)}


def join(*sets):
    """Models side by side, each with the same weight."""
    draws, best = (jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *(getattr(one, name) for one in sets))
                   for name in ("draws", "best"))
    names = tuple(f"model-{k}" for k in range(len(sets)))
    return dc.replace(sets[0], draws=draws, best=best, names=names, weights=(1.0 / len(sets),) * len(sets))


@pytest.fixture(scope="module")
def planned():
    """A problem whose force limit binds, and its plan for the best estimate."""
    problem = StrikeProblem(LAW, STAGE, np.array([1.0, 0.0, 0.0, 0.0]), np.array([0.03, 0.06, 0.02]),
                           Limits(force=300.0), Goal(), {})
    return problem, plan_strike(problem, starts=1)


def test_a_sequence_under_every_law(planned):
    """Three impacts followed one after the other by hand under every draw, from what the same law left before."""
    problem, plan = planned
    names = STAGE.surface.face_names()
    rows = [plan.x, plan.x * 0.7, plan.x * np.array([1.0, 1.0, 1.0, 0.5, 0.5, 1.0, -1.0])]
    impacts = tuple(dc.replace(plan, x=x) for x in rows)
    laws = vary_law(LAW, STATED, draws=5, seed=2)
    found = assess_sequence(problem, Sequence(impacts, (), (), 0.0, True, 1, 0.0), laws, 0.2, tail=0.4)
    start, left, kept = np.linalg.norm(STAGE.inertia @ problem.angular_velocity), [], []
    for law in split_batch(laws.draws):
        now, own, worst = eqx.tree_at(lambda p: p.law, problem, law), [], []
        for x in rows:
            design = read_design(now, jnp.asarray(names.index(plan.face)), jnp.asarray(x))
            end = strike_debris(now, design)
            worst.append(np.asarray(judge(now, design, end)))
            now = now.begin_after(end.attitude, end.angular_velocity)
            own.append(float(np.linalg.norm(STAGE.inertia @ end.angular_velocity) / start))
        left.append(own)
        kept.append(worst)
    left, kept = np.array(left), np.array(kept)
    np.testing.assert_allclose([one.mean for one in found.share_left], left.mean(axis=0), rtol=1e-6)
    np.testing.assert_allclose([one.sd for one in found.share_left], left.std(axis=0), rtol=1e-4)
    assert found.share_left[-1].tail == pytest.approx(np.sort(left[:, -1])[-2:].mean(), rel=1e-6)
    assert found.reached == pytest.approx(np.mean(left[:, -1] <= 0.2), abs=1e-9) and found.lost == 0.0
    force = CONSTRAINTS.index("peak force")
    for k in range(3):
        assert found.violated.get(f"{k + 1}: peak force", 0.0) == pytest.approx(np.mean(kept[:, k, force] < -ALLOWED))
    assert f"{100 * left[:, -1].mean():.2f} ±" in found.sentence
    # A ball that recedes strikes nothing: under no draw is that sequence struck to its end.
    ways = [np.array([0.1, 0.5, speed, 0.0, 0.0, 0.0, 0.0]) for speed in (-0.1, 0.1)]
    ends = [assess_sequence(problem, Sequence((impacts[0], dc.replace(impacts[1], x=x)), (), (), 0.0, True, 1, 0.0),
                            laws, 0.2) for x in ways]
    assert sum(end is None for end in ends) == 1


@pytest.mark.parametrize("tail", [0.05, 0.1, 0.3])
def test_tail_of_a_gaussian(tail):
    """A linear function of Gaussian parameters: mean + sd * density(quantile) / share."""
    slope = np.array([0.3, -0.8, 0.5])
    values = 2.0 + draw_normals(4096, 3, 0) @ slope
    weights = np.full(len(values), 1.0 / len(values))
    expected = 2.0 + np.linalg.norm(slope) * norm.pdf(norm.ppf(tail)) / tail
    assert find_tail(values, weights, tail) == pytest.approx(expected, rel=0.01)
    told = summarise_draws(values, weights, tail)
    assert told.mean == pytest.approx(2.0, abs=0.01) and told.sd == pytest.approx(np.linalg.norm(slope), rel=0.01)
    assert told.q95 == pytest.approx(2.0 + 1.645 * np.linalg.norm(slope), rel=0.02)


def test_tail_is_the_worst_reweighting():
    """The sorted mean is the linear programme that defines the conditional value at risk, for uneven weights too."""
    draw = np.random.default_rng(3)
    for tail in (0.1, 0.27, 1.0):
        values, weights = draw.normal(size=12), draw.dirichlet(np.ones(12))
        best = linprog(-values, A_eq=np.ones((1, 12)), b_eq=[1.0], bounds=[(0.0, w / tail) for w in weights])
        assert find_tail(values, weights, tail) == pytest.approx(-best.fun, rel=1e-9)


def test_smooth_tail_keeps_its_bounds():
    """Between mean and tail mean, within its penalty of the latter; its weights are its derivative; equal draws lose
    nothing.
    """
    draw = np.random.default_rng(4)
    values, weights, tail, width = draw.normal(size=(16, 3)), draw.dirichlet(np.ones(16)), 0.2, 0.4
    value, shares = smooth_tail(values, weights, tail, width)
    exact = np.array([find_tail(column, weights, tail) for column in values.T])
    assert np.all(value >= weights @ values) and np.all(value <= exact + 1e-12)
    assert np.all(value >= exact - 0.5 * width * (1.0 / tail - 1.0))
    np.testing.assert_allclose(shares.sum(axis=0), 1.0)
    for k in range(16):
        step = 1e-6 * np.eye(16)[:, [k]]
        ahead, behind = (smooth_tail(values + sign * step, weights, tail, width)[0] for sign in (1, -1))
        np.testing.assert_allclose((ahead - behind) / 2e-6, shares[k], atol=1e-6)
    np.testing.assert_allclose(smooth_tail(np.full((16, 1), 0.7), weights, tail)[0], 0.7, rtol=1e-12)
    np.testing.assert_allclose(smooth_tail(values, weights, 1.0)[0], weights @ values, rtol=1e-9)


def test_draws_have_the_fits_covariance():
    """A committed fit: mean and covariance of the draws within their Monte Carlo error, the posterior's too."""
    saved = load(ROOT / "fits" / "impact-b")
    columns = [saved.space.index[name] for name in saved.free]
    sds = np.sqrt(np.diag(saved.covariance))
    for found in (draw_coordinates(saved.space, saved.u, saved.spread(), 2048, 1), draw_posterior(saved, 2048, 1)):
        own = (found[:, columns] - saved.u[columns]) / sds
        np.testing.assert_allclose(own.mean(axis=0), 0.0, atol=0.15)
        np.testing.assert_allclose(np.cov(own.T), saved.covariance / np.outer(sds, sds), atol=0.12)
        others = np.setdiff1d(np.arange(len(saved.u)), columns)
        np.testing.assert_array_equal(found[:, others], np.tile(saved.u[others], (2048, 1)))


def test_stated_parameters_stay_possible():
    """Means, deviations and a correlation come back; what is positive or a share stays so, however uncertain."""
    laws = vary_law(LAW, STATED, [("restitution", "friction_coefficient", -0.6)], draws=4096)
    restitution, friction = (np.asarray(x) for x in (laws.draws.reference.ball.rebound(),
                                                     laws.draws.reference.friction.friction_coefficient))
    assert restitution.mean() == pytest.approx(0.7, abs=2e-3) and restitution.std() == pytest.approx(0.03, rel=0.03)
    assert friction.mean() == pytest.approx(0.2, abs=2e-3) and friction.std() == pytest.approx(0.02, rel=0.03)
    assert np.corrcoef(restitution, friction)[0, 1] == pytest.approx(-0.6, abs=0.03)
    wide = vary_law(LAW, {"restitution": (0.9, 0.5), "friction_coefficient": (None, 1.0)}, draws=256).draws.reference
    assert np.all((np.asarray(wide.ball.rebound()) > 0) & (np.asarray(wide.ball.rebound()) <= 1))
    assert np.all(np.asarray(wide.friction.friction_coefficient) > 0)


def test_rivals_of_a_discovery_are_one_batch():
    """Three models of the shipped discovery: every effect is there, at its null in the models without it."""
    file = SCENARIOS / "uncertain-ball.toml"
    laws = pose_laws(read_scenario(file), file.parent)
    assert laws is not None and laws.names == ("gas-leak", "ambient-pressure", "sensor-gain")
    assert laws.weights == pytest.approx([1 / 3] * 3) and laws.shares().sum() == pytest.approx(1.0)
    leak, air, gain = (np.asarray(jax.tree.leaves(effect)[0]) for effect in laws.draws.effects)
    owner = laws.owners()
    # In orbit there is no air, whichever of them is true.
    assert np.all(leak[owner != 0] == 0) and np.all(air == 0) and np.all(gain[owner != 2] == 1)
    assert leak[owner == 0].std() > 0 and gain[owner == 2].std() > 0
    assert [one.planned for one in list_surroundings(find_rivals(read_scenario(file), file.parent),
                                                     laws.main.effects)] == [0.0]
    # The arm's mass is known: no draw has another.
    np.testing.assert_array_equal(laws.draws.reference.ball.inertia(), 10.0)
    assert "counts the same" in laws.note and len(split_batch(laws.draws)) == 96


def test_weights_of_weigh_are_taken(tmp_path):
    """A folder with weights.json: its rivals with a weight, in proportion."""
    first = (SCENARIOS / "close-settings" / "model.json").read_text(encoding="utf-8")
    other = (SCENARIOS / "close-settings" / "rivals" / "1" / "model.json").read_text(encoding="utf-8")
    for name, text in (("a", first), ("b", other)):
        (tmp_path / name).mkdir()
        (tmp_path / name / "model.json").write_text(text, encoding="utf-8")
    rivals = [{"name": name, "folder": name, "weight": weight, "outcome": "indistinguishable"}
              for name, weight in (("a", 0.75), ("b", 0.25))]
    (tmp_path / "weights.json").write_text(json.dumps({
        "schema": "ddetumble.weights/2", "campaign": "x", "sentence": "", "rivals": rivals}), encoding="utf-8")
    laws = draw_laws(tmp_path, lambda law: Striker(law.reference, CoulombFriction(0.2)).extend(law.effects), draws=4)
    assert laws.weights == (0.75, 0.25)
    np.testing.assert_allclose(laws.shares(), [0.1875] * 4 + [0.0625] * 4)


@pytest.mark.study
def test_results_in_hand_are_drawn_as_their_folders(tmp_path):
    """A posterior and an average give the laws that they give once they are written."""
    campaign = dd.read_campaign(find_data() / "impact-c")
    fits = [dd.fit(campaign), dd.fit(campaign, effects=["polytropic-gas"])]
    posterior, average = dd.sample(fits[1], walkers=16, ensembles=2, burn=20, block=20, most=40), dd.average(fits)
    posterior.save(tmp_path / "posterior")
    average.save(tmp_path / "average")

    def mount(law):
        return Striker(law.reference, CoulombFriction(0.2)).extend(law.effects)

    for result, folder in ((posterior, tmp_path / "posterior"), (average, tmp_path / "average")):
        here, there = (draw_laws(source, mount, draws=400, seed=3) for source in (result, folder))
        assert here.names == there.names and here.note == there.note
        np.testing.assert_allclose(here.weights, there.weights, rtol=1e-6)
        for a, b in zip(jax.tree.leaves(here.best), jax.tree.leaves(there.best), strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-9)
        for a, b in zip(jax.tree.leaves(here.draws), jax.tree.leaves(there.draws), strict=True):
            # Two samples of the same draws: six standard errors of their difference.
            allowed = 6.0 * np.sqrt(2.0 / 400) * max(np.std(a), np.std(b)) + 1e-12
            np.testing.assert_allclose(np.mean(a), np.mean(b), atol=allowed)
    with pytest.raises(dd.InputError):
        dd.plan(dd.Ball())


def test_without_uncertainty_the_plan_stays(planned):
    """Draws that are all the best estimate: the plain plan's score, for the mean and for the tail."""
    problem, plan = planned
    laws = vary_law(LAW, {"restitution": (None, 0.0)}, draws=3)
    told: list[str] = []
    for aim in ("mean", "tail"):
        told.clear()
        robust = plan_robust_strike(problem, plan, laws, aim=aim, progress=lambda text, share: told.append(text))
        assert robust.allowed and robust.score == pytest.approx(plan.score, rel=1e-4)
        assert len(told) * len(laws.shares()) >= robust.tally.values + robust.tally.slopes  # at every design


def test_slopes_of_the_tail_are_those_of_differences(planned):
    """What is planned for and the tail means of all constraints, through every draw."""
    problem, plan = planned
    search = RobustProblem(problem, 0, vary_law(LAW, STATED, draws=5), (), "tail", 0.4)
    x = plan.x + np.array([0.02, -0.03, 0.05, 0.04, -0.02, 0.1, 0.01])
    slopes = search.slopes(x)
    for k, step in enumerate(1e-4 * np.eye(7)):
        ahead, behind = (search.values(x + sign * step) for sign in (1, -1))
        np.testing.assert_allclose(slopes[:, k], (ahead - behind) / 2e-4, atol=3e-3 * np.abs(slopes).max())


def test_order_of_best_mean_and_tail(planned):
    """Tail >= mean >= best of the draws for any plan; the robust plan keeps the limit that the plain one does not, and
    no plan for all draws does better on average than knowing each.
    """
    problem, plan = planned
    laws = vary_law(LAW, STATED, draws=8)
    face = STAGE.surface.face_names().index(plan.face)
    weights = laws.shares()
    plain = evaluate_draws(pose_draws(problem, laws.draws), face, plan.x)
    robust = {aim: plan_robust_strike(problem, plan, laws, aim=aim, tail=0.25) for aim in ("mean", "tail")}
    for values in (plain, *(evaluate_draws(pose_draws(problem, laws.draws), face, one.x) for one in robust.values())):
        assert find_tail(values[:, 0], weights, 0.25) >= weights @ values[:, 0] >= values[:, 0].min()
    assert plain[:, 3].min() < -KEPT
    for one in robust.values():
        values = evaluate_draws(pose_draws(problem, laws.draws), face, one.x)
        assert one.allowed and -find_tail(-values[:, 3], weights, 0.25) >= -KEPT
        assert one.certificate.stationarity < 0.02 and one.certificate.gradient_error < 1e-2
        assert weights @ values[:, 0] > plan.score  # safety costs
    assert robust["tail"].score >= robust["mean"].score - 1e-6


def test_equal_models_do_not_matter_and_unlike_ones_do(planned):
    """The same model twice: no difference, no regret. Restitution 0.5 against 0.9: both."""
    problem, plan = planned
    one = vary_law(LAW, STATED, draws=8)
    same = assess_plan(problem, plan, join(one, one))
    assert not same.matters and same.difference == 0 and same.whole.regret.loss < 1e-4
    assert "does not matter" in same.sentences[1] and same.within > 0
    assert same.whole.share_left.tail >= same.whole.share_left.mean
    low, high = (vary_law(LAW, STATED | {"restitution": (mean, 0.02)}, draws=8) for mean in (0.5, 0.9))
    unlike = assess_plan(problem, plan, join(low, high))
    assert unlike.matters and unlike.difference > 3 * unlike.within and "it matters" in unlike.sentences[1]
    # The share that each leaves is that of the plan on its own best law.
    face = STAGE.surface.face_names().index(plan.face)
    for law, told in zip((low.main, high.main), unlike.models.values(), strict=True):
        own = evaluate(eqx.tree_at(lambda p: p.law, problem, law), jnp.asarray(face), jnp.asarray(plan.x))
        assert told.best_estimate == pytest.approx(float(own[0]), rel=1e-9)
        assert told.share_left.mean == pytest.approx(told.best_estimate, abs=3 * told.share_left.sd)
    assert unlike.models["model-0"].share_left.mean > unlike.models["model-1"].share_left.mean


def test_command_tells_how_sure_a_plan_is(tmp_path, capsys):
    """Stated parameters: sentences, numbers in plan.json, a figure and a section of the page."""
    text = (SCENARIOS / "paper-case-2.toml").read_text(encoding="utf-8")
    file = tmp_path / "case.toml"
    file.write_text(f"starts = 1\n{text}\n[uncertainty]\ndraws = 6\nplan_for = 'mean'\n[uncertainty.parameters]\n"
                    "restitution = { mean = 0.7, sd = 0.05 }\nfriction_coefficient = { sd = 0.02 }\n", encoding="utf-8")
    assert main(["plan", str(file), "-o", str(tmp_path / "out")]) == 0
    told = capsys.readouterr().out
    result = json.loads((tmp_path / "out" / "plan.json").read_text(encoding="utf-8"))["uncertainty"]
    assert result["sentences"][0] in told and result["plan_for"] == "mean" and not result["matters"]
    (one,) = result["models"].values()
    assert len(one["draws"]) == 6 and one["share_left"]["mean"] == pytest.approx(np.mean(one["draws"]))
    assert one["share_left"]["q05"] < one["share_left"]["q95"] <= one["share_left"]["tail"] * (1 + 1e-9)
    assert (tmp_path / "out" / "figures" / "outlook.png").is_file()
    assert "Uncertainty of the outcome" in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")


@pytest.mark.parametrize("table, says", [
    ("plan_for = 'luck'", "uncertainty.plan_for"), ("tail = 0.7", "uncertainty.tail"),
    ("draws = 1", "uncertainty.draws"),
    ("", "the uncertainty of the contact is not given"), ("fit = 'nowhere'", "not a folder that fit, sample, discover"),
    ("fit = 'x'\nparameters = { restitution = { sd = 0.1 } }", "either fit or parameters"),
    ("parameters = { restitution = { mean = 0.7 } }", "uncertainty.parameters.restitution.sd"),
    ("parameters = { restitution = { mean = 1.7, sd = 0.1 } }", "restitution cannot be 1.7"),
    ("parameters = { bounce = { sd = 0.1 } }", "there is no parameter 'bounce'"),
    ("parameters = { friction = { sd = 0.1 } }", "did you mean friction_coefficient"),
    ("parameters = { effective_mass = { sd = 0.1 } }", "arm.mass gives this as known"),
    ("parameters = { restitution = { sd = 0.1 } }\ncorrelation = [['restitution', 'friction_coefficient', 0.1]]",
     "must be under parameters"),
])  # fmt: skip
def test_faulty_tables_are_refused(tmp_path, capsys, table, says):
    """One sentence that names the key, exit code 2, nothing written."""
    text = (SCENARIOS / "paper-case-2.toml").read_text(encoding="utf-8")
    file = tmp_path / "case.toml"
    file.write_text(f"{text}\n[uncertainty]\n{table}\n", encoding="utf-8")
    assert main(["plan", str(file), "-o", str(tmp_path / "out")]) == 2
    told = capsys.readouterr().err
    assert says in told and len(told.strip().splitlines()) == 1
    assert not (tmp_path / "out" / "plan.json").exists()


@pytest.mark.parametrize("here", [".", "scenarios", "elsewhere"])
def test_folder_of_the_fit_is_named_as_a_command_takes_it(here, tmp_path, monkeypatch):
    """From the working folder on where the fit lies below it, from the shipped data on elsewhere; never absolute."""
    shutil.copytree(SCENARIOS, tmp_path / "data" / "scenarios")
    (tmp_path / "elsewhere").mkdir()
    places = {".": "data/scenarios/close-settings", "scenarios": "close-settings"}
    monkeypatch.chdir(tmp_path / {"scenarios": "data/scenarios"}.get(here, here))
    scenarios = SCENARIOS.resolve() if here == "elsewhere" else tmp_path / "data" / "scenarios"
    laws = pose_laws(read_scenario(scenarios / "uncertain-ball.toml"), scenarios)
    assert laws is not None and laws.folder == places.get(here, "scenarios/close-settings")
    assert (locate_fit(Path(laws.folder)) / "model.json").is_file()


def pose_fits(tmp_path, uncertainty, ball=""):
    """Laws of the shipped case with a force that Eq. 10 allows; "@" is the folder of the repository's fits."""
    text = (SCENARIOS / "paper-case-2.toml").read_text(encoding="utf-8").replace("force = 1000.0", "force = 25.0")
    text = f"{text.replace('restitution = 0.7', ball)}\n[uncertainty]\ndraws = 64\n{uncertainty}\n"
    file = tmp_path / "case.toml"
    file.write_text(text.replace("@", f"{(ROOT / 'fits').as_posix()}/"), encoding="utf-8")
    return pose_laws(read_scenario(file), tmp_path)


def read_spreads(laws):
    """Draws of the restitution and of the loss factor."""
    return (np.asarray(laws.draws.reference.ball.rebound()), np.asarray(laws.draws.reference.friction.loss_factor))


def test_fits_of_ball_and_friction_are_drawn_together(tmp_path):
    """Each as when it is drawn alone, but for the order; what is drawn and what is held is named; in the scenario's
    ball, both where nothing else is said.
    """
    both = pose_fits(tmp_path, 'fit = ["@friction-constants", "@impact-b"]')
    ball = pose_fits(tmp_path, 'fit = "@impact-b"', 'friction_model = "@friction-constants"')
    friction = pose_fits(tmp_path, 'fit = "@friction-constants"', 'model = "@impact-b"')
    unsaid = pose_fits(tmp_path, "", 'model = "@impact-b"\nfriction_model = "@friction-constants"')
    (a, b), (a_ball, b_ball), (a_friction, b_friction) = map(read_spreads, (both, ball, friction))
    np.testing.assert_allclose(a, a_ball)
    np.testing.assert_allclose(np.sort(b), np.sort(b_friction))
    assert a.std() > 0 and b.std() > 0 and abs(np.corrcoef(a, b)[0, 1]) < 0.35  # of 64 draws, 1 in 200 by chance
    assert np.ptp(b_ball) == 0 and np.ptp(a_friction) == 0 and b_ball[0] == pytest.approx(float(
        both.main.reference.friction.loss_factor))
    for one, drawn, held in ((both, ("impact-b", "friction-constants"), ()),
                             (unsaid, ("impact-b", "friction-constants"), ()),
                             (ball, ("impact-b",), ("friction-constants",)),
                             (friction, ("friction-constants",), ("impact-b",))):
        assert [name.rpartition("(")[2] for name in one.drawn] == [f"{name})" for name in drawn]
        assert [name.rpartition("(")[2] for name in one.held] == [f"{name})" for name in held]
        assert all(name in one.note for name in drawn) and not any(name in one.note for name in held)
    np.testing.assert_array_equal(read_spreads(unsaid)[1], b)


@pytest.mark.parametrize("fit, ball, named", [
    ('["@impact-b", "@impact-b"]', "", ("impact-b",)),
    ('"@friction-constants"', 'friction_model = "@slip-coverage"\nmodel = "@impact-b"',
     ("friction-constants", "slip-coverage", "friction_model")),
])  # fmt: skip
def test_two_fits_of_the_same_are_refused(tmp_path, fit, ball, named):
    """With the names of both, of which none is of the other part of the contact."""
    with pytest.raises(dd.InputError) as refused:
        pose_fits(tmp_path, f"fit = {fit}", ball)
    assert refused.value.key == "uncertainty.fit" and all(name in refused.value.problem for name in named)
    assert ("impact-b" in refused.value.problem) == ("impact-b" in named)


def test_rivals_of_a_ball_are_each_taken_with_the_friction():
    """Three balls and two frictions make six models, whose weights are products; the names are those of both."""
    rng = np.random.default_rng(1)

    def draw(name, names, weights):
        law = vary_law(LAW, {name: (None, 0.02)}, draws=16, seed=int(rng.integers(99)))
        several = join(*[law] * len(names))
        return dc.replace(several, names=names, weights=weights, folder=name)

    ball = draw("restitution", ("nothing-but", "gas-leak", "ambient-pressure"), (0.5, 0.3, 0.2))
    friction = draw("friction_coefficient", ("stribeck", "presliding"), (0.6, 0.4))

    def make(one, other):
        return eqx.tree_at(lambda law: law.reference.friction, one, other.reference.friction)

    laws = pair_laws(ball, friction, make)
    assert laws.names[:3] == ("nothing-but+stribeck", "nothing-but+presliding", "gas-leak+stribeck")
    np.testing.assert_allclose(laws.weights, np.outer(ball.weights, friction.weights).ravel())
    assert len(split_batch(laws.draws)) == 96 and len(split_batch(laws.best)) == 6 and laws.folder == "restitution"
    drawn = np.asarray(laws.draws.reference.friction.friction_coefficient)
    assert drawn.std() > 0 and laws.shares().sum() == pytest.approx(1.0)
    single = dc.replace(join(vary_law(LAW, {"friction_coefficient": (None, 0.02)}, draws=16)), names=("stribeck",))
    assert pair_laws(ball, single, make).names == ball.names


def test_a_parameter_by_the_letter_of_its_words_is_pointed_to_its_name():
    """K of Eq. 8, as pages have it, is the adhesion constant."""
    law = Striker(Ball(), dd.contact.AdhesionHysteresis(), tangential_mass=8.0, rolling_mass=1e9).extend(())
    with pytest.raises(dd.InputError) as refused:
        vary_law(law, {"K": (None, 0.1)})
    assert "adhesion_constant" in refused.value.problem.split("; ")[1] and refused.value.problem.count("; ") == 1


def test_what_hardly_varies_is_given_as_a_limit():
    """No spread, or nothing left, is no number of noughts."""
    def say_spread(mean, sd):
        spread = Spread(mean, sd, mean, mean, mean, mean)
        outlook = dc.make_dataclass("Outlook", ["share_left", "violated"])(spread, {})
        return str(say("plan.spread", whole=outlook, tail=0.1, aim="best", drawn=("the ball (a)",),
                       held=("the friction (b)",)))

    assert "0.00" not in say_spread(1e-6, 1e-7) and "0.01 %" in say_spread(1e-6, 1e-7)
    assert "4.20" in say_spread(0.042, 1e-7) and "0.01 %" in say_spread(0.042, 1e-7)
    assert "4.20 ± 0.10 %" in say_spread(0.042, 0.001) and "0.01 %" not in say_spread(0.042, 0.001)
    assert "(a)" in say_spread(0.042, 0.001) and "(b)" in say_spread(0.042, 0.001)


def test_effects_ask_for_their_conditions(tmp_path, capsys):
    """An effect that reads the number of the impact: told how to give it, then read."""
    scenario = read_scenario(SCENARIOS / "uncertain-ball.toml")
    assert dict(pose_problem(scenario, SCENARIOS).conditions) == {}
    text = (SCENARIOS / "close-settings" / "model.json").read_text(encoding="utf-8")
    changed = json.loads(text)
    changed["effects"] = [{"id": "stress-softening"}]
    changed["coordinates"] = {name: value for name, value in changed["coordinates"].items() if "." not in name} | {
        "stress-softening.sigma_m": 0.2, "stress-softening.j_0": 1.0}
    changed["free"], changed["covariance"] = changed["free"][:2], [row[:2] for row in changed["covariance"][:2]]
    (tmp_path / "fit").mkdir()
    (tmp_path / "fit" / "model.json").write_text(json.dumps(changed), encoding="utf-8")
    file = tmp_path / "case.toml"
    given = (SCENARIOS / "uncertain-ball.toml").read_text(encoding="utf-8").replace("close-settings", "fit")
    file.write_text(given, encoding="utf-8")
    assert main(["plan", str(file), "-o", str(tmp_path / "out")]) == 2
    assert "ball.conditions" in capsys.readouterr().err
    file.write_text(given.replace("friction = 0.218", "friction = 0.218\nconditions = { sequence = 9 }"),
                    encoding="utf-8")
    scenario = read_scenario(file)
    laws = pose_laws(scenario, tmp_path)
    assert laws is not None
    assert float(pose_problem(scenario, tmp_path, laws).conditions["sequence"]) == 9.0
