"""One fit of several campaigns of one ball, and the spread of parameters over several balls."""

import dataclasses as dc
import json
import math

import numpy as np
import pandas as pd
import pytest
from scipy import stats

import ddetumble as dd
from ddetumble.cli import main
from ddetumble.exam.simulators.campaigns import write_package
from ddetumble.exam.simulators.impact_campaigns import make_campaign
from ddetumble.exam.simulators.oblique_campaigns import make_oblique_campaign
from ddetumble.exam.simulators.slip_campaigns import make_slip_campaign
from ddetumble.inference.joint import join_spaces, tell_misfits
from ddetumble.inference.parameters import ParameterSpace
from ddetumble.inference.problem import Problem
from ddetumble.inference.random_effects import FEWEST, estimate_random_effects, measure_heterogeneity
from tests.test_impact_values import MASS, RESTITUTION, draw_rebounds, tabulate
from tests.test_impact_values import make_campaign as make_values


BALL = {"effective_mass": 1.3, "restitution": 0.7}
RUBBER = {"adhesion_constant": 0.8, "loss_factor": 0.15, "slip_scale": 1.0}
ARM = {"tangential_mass": 1.1, "rolling_mass": 0.5}
PRESSURES, SPEEDS = [6e5, 1.6e6], [0.3, 0.55]


def write(place, made):
    write_package(place, made)
    return dd.read_campaign(place)


def make_normal(place, seed, base=BALL, effects=None, repeats=1, pressures=PRESSURES):
    return write(place, make_campaign(place.name, seed, effects or {}, base, pressures, SPEEDS, repeats, interval=8e-4))


def make_oblique(place, seed, base=BALL):
    return write(place, make_oblique_campaign(place.name, seed, {}, base | RUBBER | ARM, PRESSURES, SPEEDS, [0.1, 0.5],
                                              interval=8e-4, steps=100))


def make_friction(place, seed):
    return write(place, make_slip_campaign(place.name, seed, {}, RUBBER, [6.0, 25.0], [4e5, 2.4e6], [0.1],
                                           interval=2e-4))


@pytest.fixture(scope="module")
def normal(tmp_path_factory):
    """Eight impacts of one ball."""
    return make_normal(tmp_path_factory.mktemp("joint") / "normal", 1, repeats=2)


@pytest.fixture(scope="module")
def halves(normal):
    """The fits of its first and its last four, under the stated noise."""
    keys = normal.record_keys
    return [dd.fit(normal.select(keys[:4]), noise="stated"), dd.fit(normal.select(keys[4:]), noise="stated")]


@pytest.fixture(scope="module")
def three(tmp_path_factory):
    """Single fits of normal, oblique and friction records of one ball."""
    place = tmp_path_factory.mktemp("three")
    return [dd.fit(make_normal(place / "normal", 1)), dd.fit(make_oblique(place / "oblique", 4), free=["loss_factor"]),
            dd.fit(make_friction(place / "friction", 2))]


def assert_same(one, other, share):
    """Estimates alike within a share of their standard deviation, and these, too."""
    for name, p in one.parameters.items():
        assert abs(p.estimate - other.parameters[name].estimate) < share * p.sd
        assert other.parameters[name].sd == pytest.approx(p.sd, rel=0.05)


def test_parts_of_a_campaign_fit_as_the_whole(normal, halves):
    """In either order; the estimates are those of least squares on all rows, and the chi-squares add up."""
    whole, joint, turned = dd.fit(normal, noise="stated"), dd.fit_jointly(halves), dd.fit_jointly(halves[::-1])
    assert set(joint.shared) == set(BALL) and joint.bounded.solution.converged
    assert_same(whole, joint, 0.1)
    assert_same(joint, turned, 1e-3)
    assert joint.solution.chi2 == pytest.approx(whole.chi2, abs=0.01)
    assert joint.agreement.chi2 == pytest.approx(whole.chi2 - sum(one.chi2 for one in halves), abs=0.02)
    assert joint.agreement.degrees == 2 and joint.agreement.agree and joint.agreement.apart == ()
    assert joint.degrees == whole.degrees
    information = [np.linalg.inv(one.covariance) for one in halves]
    weighted = sum(a @ one.solution.u[[one.space.index[n] for n in BALL]]
                   for a, one in zip(information, halves, strict=True))
    pooled = np.linalg.solve(sum(information), weighted)
    np.testing.assert_allclose(joint.covariance, np.linalg.inv(sum(information)), rtol=0.05)
    assert np.abs(joint.solution.u - pooled).max() < 0.1 * np.sqrt(np.diag(joint.covariance)).max()


def test_own_parameters_and_labels(halves):
    """What is kept apart is one for each campaign, told by its name; the same name twice is told apart."""
    joint = dd.fit_jointly(halves, own=["restitution"])
    assert list(joint.shared) == ["effective_mass"]
    assert set(joint.parameters) == {"effective_mass", "restitution (normal)", "restitution (normal 2)"}
    assert joint.agreement.degrees == 1
    assert list(joint.estimates("restitution (normal)")) == ["normal"]
    assert set(joint.narrowing("effective_mass")) == {"normal", "normal 2"}


def test_a_prior_counts_once(normal, halves):
    prior = {"restitution": (0.69, 0.002)}
    held = [dd.fit(one.source, noise="stated", priors=prior) for one in halves]
    joint = dd.fit_jointly(held)
    assert_same(dd.fit(normal, noise="stated", priors=prior), joint, 0.1)
    assert joint.agreement.degrees == 2
    with pytest.raises(dd.InputError, match="priors of restitution differ"):
        dd.fit_jointly([held[0], dd.fit(held[1].source, priors={"restitution": (0.69, 0.003)})])


def test_bounds_hold(halves):
    """One that both campaigns want to leave is held there, with a one-sided interval."""
    found = [dd.fit(one.source, noise="stated", bounds={"restitution": (0.3, 0.69)}) for one in halves]
    p = dd.fit_jointly(found).parameters["restitution"]
    assert p.at_bound == "upper" and p.estimate == pytest.approx(0.69) and p.q025 < p.q975 <= 0.69
    apart = [dd.fit(one.source, noise="stated", bounds={"restitution": ends}) for one, ends in
             zip(halves, [(0.3, 0.69), (0.695, 0.9)], strict=True)]
    with pytest.raises(dd.InputError, match="nothing in common"):
        dd.fit_jointly(apart)


def test_nonsense_is_refused(halves):
    for entries, models, own, part in (
            (halves[:1], "paper", [], "two campaigns"), (halves, ["paper"], [], "1 models"),
            (halves, "paper", ["restitutoin"], "not fitted"), (halves, "paper", list(BALL), "share no fitted")):
        with pytest.raises(dd.InputError, match=part):
            dd.fit_jointly(entries, models, own=own)
    with pytest.raises(dd.InputError, match="two specimens"):
        dd.fit_population(halves[:1])


@pytest.mark.slow
def test_what_a_joint_fit_leaves(halves, tmp_path):
    """It prints, is saved, and each campaign's fit at the joint values predicts from its folder."""
    joint = dd.fit_jointly(halves)
    folder = joint.save(tmp_path / "joint")
    content = json.loads((folder / "joint.json").read_text())
    assert content["agreement"]["degrees"] == 2 and set(content["singles"]["restitution"]) == {"normal", "normal 2"}
    assert all(name in str(joint) for name in BALL) and "<strong>" in joint._repr_html_()
    one = joint.fits["normal"]
    assert one.parameters["restitution"].estimate == joint.parameters["restitution"].estimate
    assert one.interval("restitution") == pytest.approx(
        (joint.parameters["restitution"].q025, joint.parameters["restitution"].q975))
    wanted = pd.DataFrame({"record": ["a"], "initial_pressure": [1e6], "approach_speed": [0.4]})
    pd.testing.assert_frame_equal(dd.predict(one, wanted), dd.predict(folder / "normal", wanted))
    assert dd.predict(one, wanted)["normal_force_sd"].max() < dd.predict(halves[0], wanted)["normal_force_sd"].max()
    assert len(dd.figures.draw_forest(joint.intervals).axes) == 2
    assert "restitution" in dd.report(joint, tmp_path / "page").read_text()


@pytest.mark.slow
def test_one_ball_in_three_kinds_of_test(three):
    """Every shared parameter is narrower than in any single fit and covers the truth; the campaigns agree."""
    joint = dd.fit_jointly(three)
    assert joint.shared == {"effective_mass": ("normal", "oblique"), "restitution": ("normal", "oblique"),
                            "adhesion_constant": ("oblique", "friction"), "loss_factor": ("oblique", "friction")}
    assert joint.agreement.agree and joint.agreement.degrees == 4
    for name in joint.shared:
        p, truth = joint.parameters[name], (BALL | RUBBER)[name]
        assert all(wider > 1.15 for wider in joint.narrowing(name).values())
        assert p.q025 <= truth <= p.q975
    assert_same(joint, dd.fit_jointly(three[::-1]), 1e-2)


@pytest.mark.slow
def test_campaigns_that_disagree(three, tmp_path):
    """Another restitution in the oblique tests is told, and kept apart it is none of a problem."""
    other = dd.fit(make_oblique(tmp_path / "other", 3, BALL | {"restitution": 0.72}), free=["loss_factor"])
    joint = dd.fit_jointly([three[0], other, three[2]])
    assert not joint.agreement.agree and joint.agreement.apart[0] == "restitution"
    assert "effective_mass" not in joint.agreement.apart
    assert dd.fit_jointly([three[0], other, three[2]], own=["restitution"]).agreement.agree


@pytest.mark.slow
def test_held_in_one_campaign(three, tmp_path):
    """The note tells that a parameter is held elsewhere."""
    joint = dd.fit_jointly([dd.fit(three[1].source), three[2]])
    assert list(joint.shared) == ["adhesion_constant"] and any("loss_factor" in note for note in joint.notes)
    assert joint.narrowing("adhesion_constant")["friction"] > 5


@pytest.mark.slow
def test_power_laws_of_one_reference(halves):
    """A stiffness at another reference pressure is another; with one reference it is shared."""
    law = dd.PowerLaw(condition="initial_pressure", condition_reference=1e6)
    one = dd.fit(halves[0].source, law)
    assert one.space.reference.condition_reference == 1e6  # pyright: ignore
    space = ParameterSpace(dc.replace(one.space.reference, condition_reference=2e6), one.space.effects)
    other = dc.replace(one, problem=Problem(space, one.problem.records))
    for pair, shared in (((one, one), True), ((one, other), False)):
        _, found, notes = join_spaces(dict(zip("ab", pair, strict=True)))
        assert ("stiffness_force" in found) == shared and "restitution" in found
        assert any("stiffness_force" in note for note in notes) != shared
    space, found, _ = join_spaces({"a": one, "b": other, "c": other, "d": one})
    assert found["stiffness_force"] == ("a", "d") and "stiffness_force (b)" in space.index


@pytest.mark.slow
def test_what_was_assumed_gives_way():
    """Neither rebound speeds nor contact times alone determine the mass; together they do, and need no prior."""
    times = tabulate()["contact_time"] * (1.0 + 0.01 * np.random.default_rng(1).normal(size=12))
    fits = [dd.fit(make_values({"rebound_speed": draw_rebounds(0)}, 0.01)),
            dd.fit(make_values({"contact_time": times}, 0.01))]
    assert [one.settings["assumed"] for one in fits] == [["effective_mass"]] * 2
    joint = dd.fit_jointly(fits)
    assert not any(problem.priors for problem in joint.problem.problems) and joint.agreement.degrees < 2
    for name, truth in (("effective_mass", MASS), ("restitution", RESTITUTION)):
        assert joint.parameters[name].q025 <= truth <= joint.parameters[name].q975
    twice = dd.fit_jointly([fits[0], fits[0]])
    assert sum("effective_mass" in problem.priors for problem in twice.problem.problems) == 1
    assert list(dd.fit_population([fits[0], fits[0]]).parameters) == ["restitution"]


def test_cochran_of_two_estimates():
    """The squared difference over its variance."""
    found = measure_heterogeneity([1.0, 1.5], [0.3, 0.4])
    assert found.q == pytest.approx(0.25 / 0.25) and found.degrees == 1
    assert found.p_value == pytest.approx(2 * stats.norm.sf(1.0))


def test_spread_of_estimates_with_equal_errors():
    """Their variance less that of the errors, or none; by DerSimonian and Laird's moments it is the same."""
    theta, error = np.array([1.0, 1.4, 0.7, 1.9, 1.2]), 0.2
    found = estimate_random_effects(theta, [error] * 5)
    square = np.var(theta, ddof=1) - error**2
    assert found.spread**2 == pytest.approx(square, rel=1e-3) and found.mean == pytest.approx(theta.mean())
    assert found.spread**2 == pytest.approx((found.homogeneity.q - 4) * error**2 / 4, rel=1e-3)
    assert found.mean_sd == pytest.approx(theta.std(ddof=1) / math.sqrt(5), rel=1e-3)
    sure = estimate_random_effects(theta, [1e-4] * 5)
    np.testing.assert_allclose(sure.shrunken, theta, atol=1e-4)
    np.testing.assert_allclose(sure.shrunken_sd, 1e-4, rtol=0.01)
    assert np.ptp(found.shrunken) < np.ptp(theta) and np.all(np.argsort(found.shrunken) == np.argsort(theta))
    ends = [measure_heterogeneity(theta, [error] * 5, tau).q for tau in found.spread_interval]
    np.testing.assert_allclose(ends, stats.chi2.ppf([0.975, 0.025], 4), rtol=1e-3)
    none = estimate_random_effects(theta, [2.0] * 5)
    assert none.spread == 0.0 and none.p_value == 1.0 and none.spread_interval[0] == 0.0 < none.spread_interval[1]
    assert np.ptp(none.shrunken) < 0.3 * np.ptp(theta)


def test_few_specimens_have_no_interval_of_the_spread():
    for count in (2, FEWEST - 1, FEWEST):
        ends = estimate_random_effects(np.arange(count) + 1.0, np.full(count, 0.1)).spread_interval
        assert math.isinf(ends[1]) == (count < FEWEST)


@pytest.mark.parametrize("spread", [0.0, 1.0, 4.0])
def test_random_effects_hold_what_they_say(spread):
    """Intervals of mean and spread hold the truth of eight specimens as often as they say, and alarms are as rare."""
    generator, count = np.random.default_rng(7), 300
    errors = np.array([0.6, 0.8, 0.9, 1.0, 1.0, 1.1, 1.3, 1.6])
    mean = inside = alarms = each = 0
    for _ in range(count):
        truth = 5.0 + spread * generator.standard_normal(8)
        found = estimate_random_effects(truth + errors * generator.standard_normal(8), errors)
        mean += found.mean_interval[0] <= 5.0 <= found.mean_interval[1]
        inside += found.spread_interval[0] <= spread <= found.spread_interval[1]
        each += np.mean(np.abs(found.shrunken - truth) <= 1.96 * found.shrunken_sd)
        alarms += found.p_value < 0.05
    assert mean / count > 0.92 and inside / count > 0.92 and each / count > 0.92
    assert alarms / count < 0.08 if spread == 0 else alarms / count > (0.3 if spread == 1.0 else 0.99)


@pytest.mark.slow
@pytest.mark.parametrize("spread", [0.15, 0.0])
def test_eight_balls(tmp_path, spread):
    """The spread of their stiffness is found, that of what is equal is not."""
    stiffness = 1500.0 * np.exp(spread * np.random.default_rng(5).standard_normal(8))
    made = [make_normal(tmp_path / f"ball-{k}", 100 + k, effects={"wall-stiffness": {"k_w": float(one)}})
            for k, one in enumerate(stiffness)]
    found = dd.fit_population(made, dd.Ball() + dd.effects.WallStiffness())
    wall = found.parameters["wall-stiffness.k_w"]
    assert [name for name, p in found.parameters.items() if p.varies] == (["wall-stiffness.k_w"] if spread else [])
    assert wall.q025 <= 1500.0 <= wall.q975 and wall.spread_q025 <= spread * 1500.0 <= wall.spread_q975
    for name, truth in BALL.items():
        p = found.parameters[name]
        assert p.spread_q025 == 0.0 and p.q025 <= truth <= p.q975
    error = [np.mean([(x - y) ** 2 for x, y in zip(values, stiffness, strict=True)]) for values in (
        [one.alone.estimate for one in wall.specimens.values()], [one.estimate for one in wall.specimens.values()])]
    assert error[1] < (1.05 if spread else 0.7) * error[0]
    content = json.loads(found.save(tmp_path / "balls").read_text())
    assert content["parameters"]["wall-stiffness.k_w"]["varies"] == wall.varies
    assert "ball-7" in dd.report(found, tmp_path / "page").read_text()


@pytest.mark.slow
def test_specimens_of_several_campaigns(halves):
    """A joint fit is a specimen, too; few specimens are said to be few."""
    found = dd.fit_population([dd.fit_jointly(halves), dd.fit_jointly(halves[::-1])])
    assert set(found.parameters) == set(BALL) and not any(p.varies for p in found.parameters.values())
    assert all(math.isinf(p.spread_q975) for p in found.parameters.values()) and len(found.notes) == 2


@pytest.mark.slow
def test_the_command_line(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for k in (1, 2):
        make_normal(tmp_path / f"part-{k}", k)
    assert main(["fit", "part-1", "part-2", "--own", "restitution", "-o", "ball"]) == 0
    assert "effective_mass" in capsys.readouterr().out
    written = json.loads((tmp_path / "ball" / "joint.json").read_text())
    assert list(written["shared"]) == ["effective_mass"]
    assert (tmp_path / "ball" / "part-2" / "model.json").is_file() and (tmp_path / "ball" / "estimates.png").is_file()
    assert "effective_mass" in (tmp_path / "ball" / "report.html").read_text(encoding="utf-8")
    assert main(["fit", "part-1", "part-2", "--population"]) == 0
    assert (tmp_path / "part-1-population" / "population.json").is_file()
    capsys.readouterr()
    for wrong in (["--own", "restitution"], ["part-2", "--population", "--own", "restitution"],
                  ["part-2", "--fix", "restitution=0.7"], ["part-2", "-e", "stribeck"]):
        assert main(["fit", "part-1", *wrong]) == 2
        assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.study
def test_joint_intervals_cover(tmp_path):
    """Of thirty balls, each in three kinds of test, joint intervals hold the truth and campaigns are said to agree."""
    inside, apart = [], 0
    for k in range(30):
        fits = [dd.fit(make_normal(tmp_path / f"normal-{k}", 1000 + k)),
                dd.fit(make_oblique(tmp_path / f"oblique-{k}", 2000 + k), free=["loss_factor"]),
                dd.fit(make_friction(tmp_path / f"friction-{k}", 3000 + k))]
        joint = dd.fit_jointly(fits)
        apart += not joint.agreement.agree
        for name in joint.shared:
            p = joint.parameters[name]
            inside.append(p.q025 <= (BALL | RUBBER)[name] <= p.q975)
            assert all(wider > 1.0 for wider in joint.narrowing(name).values())
    assert len(inside) == 120 and np.mean(inside) > 0.89 and apart <= 2


@pytest.mark.study
@pytest.mark.parametrize(("spread", "least", "most"), [(0.0, 0, 1), (0.06, 7, 15), (0.15, 15, 15)])
def test_spreads_that_are_found(tmp_path, spread, least, most):
    """How often a spread of the stiffness is found in eight balls, each known to 3 %, and covered by its interval."""
    found = inside = 0
    for k in range(15):
        stiffness = 1500.0 * (1.0 + spread * np.random.default_rng(50 + k).standard_normal(8))
        fits = [make_normal(tmp_path / f"{k}-{i}", 10000 + 100 * k + i, effects={"wall-stiffness": {"k_w": float(x)}})
                for i, x in enumerate(stiffness)]
        result = dd.fit_population(fits, dd.Ball() + dd.effects.WallStiffness())
        wall = result.parameters["wall-stiffness.k_w"]
        found += wall.varies
        inside += wall.spread_q025 <= spread * 1500.0 <= wall.spread_q975
        assert not any(result.parameters[name].varies for name in BALL)
    assert least <= found <= most and inside >= 12


@pytest.mark.slow
def test_a_misfit_is_no_difference_of_balls():
    """Campaigns with different effects hidden: that the model fails in some is said beside what they differ in."""
    fits = [dd.fit(dd.find_data() / name) for name in ("slip-a", "slip-b")]
    wrong = tell_misfits({one.campaign: one for one in fits})
    assert "slip-a" in wrong and "slip-b" in wrong
    found = dd.fit_jointly(fits)
    assert not found.agreement.agree and wrong in found.sentence
