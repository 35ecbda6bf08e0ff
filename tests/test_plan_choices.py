"""What a scenario may say of the body, the places to strike and the goal; what limits cost, and what errors do."""

import dataclasses as dc
import json
import re
from pathlib import Path
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import ddetumble as dd
from ddetumble._user_files import trust_file
from ddetumble.cli import main
from ddetumble.contact.gripping import Striker
from ddetumble.contact.law import Ball
from ddetumble.contact.sliding import CoulombFriction
from ddetumble.dynamics.bodies import Box, Cylinder, Sphere
from ddetumble.dynamics.collision import simulate_collision
from ddetumble.dynamics.surfaces import Debris, make_debris, make_polytope
from ddetumble.planning.errors import err_problem
from ddetumble.planning.execution import draw_errors, follow_errors, try_errors
from ddetumble.planning.measured import find_assumed
from ddetumble.planning.plan import Mishap, Plan, PlanSettings
from ddetumble.planning.plausibility import check_scenario
from ddetumble.planning.prices import REACHED, Price, list_reached, name_narrowed, price_limits, price_sequence
from ddetumble.planning.problem import Goal, Limits, StrikeProblem, drift, measure_share, score
from ddetumble.planning.rules import compare_rules
from ddetumble.planning.scenario import pose_laws, pose_problem
from ddetumble.planning.scenario_file import ErrorTable, read_scenario, validate_scenario
from ddetumble.planning.sequence import Joint, add_up
from ddetumble.planning.single import compute_impact, compute_slopes, plan_strike
from ddetumble.planning.uncertainty import find_tail
from ddetumble.reports.plan import find_unloaded, list_inertia, write_plan


pytestmark = pytest.mark.slow  # one program, compiled first, is in all of them


STAGE = make_debris(Cylinder())
SCENARIO = """schema = "ddetumble.plan/1"
[debris]
angular_velocity = [0.05, 0.02, 0.03]
"""


def pose(rates, friction=0.0, mass=8.0, debris=STAGE, **limits):
    """The paper's stage."""
    law = Striker(Ball(effective_mass=mass), CoulombFriction(friction), tangential_mass=mass, rolling_mass=1e9)
    return StrikeProblem(law.extend(()), debris, np.array([1.0, 0.0, 0.0, 0.0]), np.asarray(rates, float),
                         Limits(**{"force": 1000.0} | limits), Goal(), {})


def read(tmp_path, text):
    """The problem of a scenario's text."""
    path = tmp_path / "case.toml"
    path.write_text(text)
    return pose_problem(read_scenario(path), tmp_path)


@pytest.fixture(scope="module")
def held():
    """A plan that the arm's speed holds, and its problem."""
    problem = pose([0.05, 0.02, 0.03], 0.2, speed=0.3)
    return problem, plan_strike(problem, starts=2)


@pytest.mark.parametrize(("text", "law", "keys"), [
    ("", Ball(), {"ball.friction", "arm.mass"}), ("[ball]\nfriction = 0.218\n", Ball(), {"arm.mass"}),
    ("[ball]\nfriction = 0.0\n[arm]\nmass = 8.0\n", Ball(), set()), ("[arm]\nmass = 8.0\n", Ball(), {"ball.friction"}),
    ("", Striker(Ball(), CoulombFriction(0.3), tangential_mass=2.0, rolling_mass=0.3).extend(()), {"arm.mass"})])
def test_what_nothing_says_is_told(tmp_path, text, law, keys):
    """Friction that neither the scenario nor a fit of straight impacts says; the mass that the scenario does not."""
    (tmp_path / "case.toml").write_text(f"{SCENARIO}{text}", encoding="utf-8")
    scenario, models = read_scenario(tmp_path / "case.toml"), [SimpleNamespace(law=lambda: law)]
    problem = pose([0.1] * 3)
    found = find_assumed(scenario, models, problem)
    assert set(found) == keys == set(find_assumed(validate_scenario(scenario), models, problem))
    assert found.get("ball.friction", 0.218) == 0.218 and found.get("arm.mass", 8.0) == 8.0


def test_an_offset_centre_is_a_shifted_surface():
    """A box with its centre of mass aside is struck as the same corners written from that centre are."""
    lengths, centre, inertia = np.array([1.0, 1.4, 2.0]), np.array([0.1, -0.2, 0.3]), np.diag([90.0, 80.0, 60.0])
    signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
    normals = np.concatenate([np.eye(3), -np.eye(3)])
    shifted = Debris(200.0, inertia, make_polytope(0.5 * signs * lengths - centre, normals))
    offset = make_debris(Box(200.0, lengths), inertia, centre)
    law = Striker(Ball(effective_mass=5.0), CoulombFriction(0.2), tangential_mass=5.0, rolling_mass=1e9).extend(())
    found = [simulate_collision(law, body, np.array([1.0, 0, 0, 0]), np.array([0.1, -0.2, 0.05]),
                                np.array([0.5, 0.3, 0.4]) - centre, np.array([-0.6, 0.1, 0.0]),
                                {"initial_pressure": 1.5e6}) for body in (offset, shifted)]
    for name in ("angular_velocity", "velocity", "impulse", "peak_force", "margin"):
        np.testing.assert_allclose(getattr(found[0], name), getattr(found[1], name), rtol=1e-8, atol=1e-12)
    moment = np.cross(np.array([0.5, 0.3, 0.4]) - centre, np.asarray(found[0].impulse))
    change = inertia @ np.asarray(found[0].angular_velocity) - inertia @ np.array([0.1, -0.2, 0.05])
    np.testing.assert_allclose(change, moment, rtol=0.05, atol=0.02)  # the point of contact moves a little


def test_of_an_offset_sphere_the_offset_is_the_pivot():
    """All normals of a sphere meet its centre: about the line to the centre of mass no normal force has a moment."""
    debris = make_debris(Sphere(100.0, 1.0), np.diag([40.0, 40.0, 30.0]), np.array([0.0, 0.0, 0.2]))
    (pivot,) = np.asarray(debris.surface.find_pivots())
    random = np.random.default_rng(0)
    for place in random.uniform(-1, 1, (20, 2)):
        point = debris.surface.place(jnp.asarray(0), jnp.asarray(place))
        normal = debris.surface.find_foot(point).normal
        assert abs(float(jnp.cross(point, normal) @ pivot)) < 1e-12


@pytest.mark.parametrize("added, key", [
    ("centre = [0.1, 0.0, 0.0]\n", "debris"),
    ("inertia = [[1000, 0, 0], [0, 1000, 0], [0, 0, 5000]]\n", "debris.inertia"),
    ("inertia = [[900, 0, 0], [0, 900, 0], [0, 0, 500]]\ncentre = [0.0, 0.0, 2.0]\n", "debris.centre"),
    ('mass = "3 m"\n', "debris.mass"),
])  # fmt: skip
def test_impossible_bodies_are_refused(tmp_path, added, key):
    with pytest.raises(dd.InputError) as refused:
        read(tmp_path, SCENARIO + added)
    assert refused.value.key is not None and refused.value.key.startswith(key)


def test_units_in_texts(tmp_path):
    """Texts with units pose the same problem as SI numbers."""
    plain = read(tmp_path, SCENARIO.replace("0.03]", "0.0174532925199433]") 
                 + "radius = 0.8\n[limits]\nforce = 76.0\ndepression = 0.007\npressure = [1e6, 2e6]\n"
                 "[arm]\nspeed = 0.4\n")
    units = read(tmp_path, SCENARIO.replace("[0.05, 0.02, 0.03]", '["0.05 rad/s", "0.02 rad/s", "1 deg/s"]')
                 + 'radius = "80 cm"\n[limits]\nforce = "76 N"\ndepression = "7 mm"\npressure = ["10 bar", "2 MPa"]\n'
                 '[arm]\nspeed = "40 cm/s"\n')
    np.testing.assert_allclose(units.angular_velocity, plain.angular_velocity, rtol=1e-12)
    np.testing.assert_allclose(units.debris.inertia, plain.debris.inertia, rtol=1e-12)
    for name in ("force", "depression", "pressure", "speed"):
        np.testing.assert_allclose(getattr(units.limits, name), getattr(plain.limits, name), rtol=1e-12)


@pytest.mark.parametrize("text, key", [
    ('[6, "3 deg/s", "11 deg/s"]', "debris.angular_velocity"), ('["1 MPa", 2]', "limits.pressure")])
def test_a_number_without_a_unit_beside_others_with_one_is_asked_about(tmp_path, text, key):
    """As it might be meant in their unit; zero is the same in all."""
    turn, limits = (text, "[1e6, 2e6]") if key.startswith("debris") else ("[0.05, 0.0, 0.02]", text)
    with pytest.raises(dd.InputError) as refused:
        read(tmp_path, SCENARIO.replace("[0.05, 0.02, 0.03]", turn) + f"[limits]\npressure = {limits}\n")
    assert refused.value.key == key
    rates = read(tmp_path, SCENARIO.replace("[0.05, 0.02, 0.03]", '[0, "3 deg/s", 0.0]')).angular_velocity
    np.testing.assert_allclose(rates, np.radians([0.0, 3.0, 0.0]))


@pytest.mark.study
def test_a_pressure_and_an_instant_that_are_given(tmp_path):
    """Twice the same: the impact has them, reaches no limit by them, and they have no price."""
    text = SCENARIO.replace("[debris]", "starts = 1\n[debris]")
    (tmp_path / "case.toml").write_text(f'{text}[limits]\nwindow = [20, 20]\npressure = ["1.5 MPa", "1.5 MPa"]\n',
                                        encoding="utf-8")
    found = dd.plan(tmp_path / "case.toml")
    (one,) = found.impacts
    assert float(one.design.pressure) == pytest.approx(1.5e6) and found.sequence.instants[0] == pytest.approx(20.0)
    told = {name for names in found.reached for name in names} | {price.key for row in found.prices for price in row}
    assert not {"lowest pressure", "highest pressure", "limits.pressure", "limits.window"} & told
    assert not any("instant" in name for name in told)
    page = dd.report(found, tmp_path / "out").read_text(encoding="utf-8")
    assert "1.5 to 1.5" not in page
    angle = np.degrees(np.arctan2(float(one.collision.tangential_speed), float(one.collision.approach_speed)))
    assert f"{angle:.1f}" in page.partition("to the normal [°]")[2].partition("</table>")[0]
    with pytest.raises(dd.InputError) as refused:
        read(tmp_path, SCENARIO + '[limits]\npressure = ["2 MPa", "1 MPa"]\n')
    assert refused.value.key == "limits"


def test_friction_without_load_is_found():
    """Of the instants at which the ball hardly presses, whatever it is under load."""
    course = dc.make_dataclass("Course", ["normal_force", "friction"])
    load = np.array([0.0, 10.0, 30.0, 10.0, 0.0])
    friction = np.outer(0.2 * load, [0.6, 0.8, 0.0])
    assert find_unloaded(course(load, friction)) == 0.0
    assert find_unloaded(course(load, friction + [[0.0, 0.0, 1.1]])) == pytest.approx(1.1)


def test_a_plan_that_fails_says_what_was_doubted(tmp_path, monkeypatch):
    """A pressure in MPa that was meant in Pa stands beside what could not be computed."""
    def fail(*args, **kwargs):
        raise dd.ComputationError("nothing could be integrated")

    monkeypatch.setattr("ddetumble.planning.plan._plan", fail)
    path = tmp_path / "case.toml"
    path.write_text(SCENARIO + "[limits]\npressure = [1, 2]\n")
    with pytest.raises(dd.ComputationError) as failed:
        dd.plan(path)
    assert "limits.pressure" in str(failed.value) and "integrated" in str(failed.value)


def test_a_ball_of_another_size(tmp_path):
    """Its diameter is the scenario's; a radius is pointed there, and a fit states its own."""
    small = '[limits]\ndepression = "10 mm"\n[ball]\nouter_diameter = "30 mm"\n'
    ball = read(tmp_path, SCENARIO + small).law.reference.ball
    assert float(ball.diameter()) == pytest.approx(0.03)
    assert float(read(tmp_path, SCENARIO).law.reference.ball.diameter()) == pytest.approx(0.06)
    fit = (Path(__file__).resolve().parent.parent / "fits" / "impact-b").as_posix()
    for table, key, way in (('radius = "30 mm"', "ball", "outer_diameter"),
                            ('outer_diameter = "30 mm"', None, "depression"),
                            (f'outer_diameter = 0.03\nmodel = "{fit}"', "ball", "--known"),
                            (f'outer_diameter = 0.06\n[uncertainty]\nfit = "{fit}"', "ball.outer_diameter", "--known")):
        with pytest.raises(dd.InputError, match=way) as refused:
            path = tmp_path / "other.toml"
            path.write_text(SCENARIO + f"[ball]\n{table}\n")
            pose_laws(read_scenario(path), tmp_path)
        assert refused.value.key == key


@pytest.mark.study
def test_a_face_and_an_area_to_strike(tmp_path):
    """The plan keeps to them, and a smaller area makes it no better."""
    limits = '[limits]\nforce = 1000.0\nfaces = ["upper end"]\n'
    face = plan_strike(read(tmp_path, SCENARIO + limits), starts=2)
    assert face.allowed and face.face == "upper end"
    area = limits + "target = [0.3, 0.0, 1.5]\ntarget_radius = 0.2\n"
    small = plan_strike(read(tmp_path, SCENARIO + area), starts=2)
    assert small.allowed and small.face == "upper end"
    assert np.linalg.norm(np.asarray(small.design.point) - [0.3, 0.0, 1.5]) <= 0.2 * (1 + 1e-4)
    assert small.score >= face.score - 1e-3
    far = SCENARIO + "[limits]\ntarget = [5.0, 0.0, 0.0]\ntarget_radius = "  # four metres off the side
    with pytest.raises(dd.InputError) as refused:
        read(tmp_path, far + "3.9\n")
    assert refused.value.key == "limits.target"
    for text, doubted in ((far + "4.1\n", ["limits.target"]), (SCENARIO + area, [])):
        read(tmp_path, text)
        scenario = read_scenario(tmp_path / "case.toml")
        assert [one.variable for one in check_scenario(scenario, tmp_path)] == doubted
    with pytest.raises(dd.InputError, match="upper end") as refused:
        read(tmp_path, SCENARIO + '[limits]\nfaces = ["top"]\n')
    assert refused.value.key == "limits.faces"


@pytest.mark.parametrize("limits, field", [({"speed": 0.3}, "speed"), ({"force": 100.0}, "force")])
def test_a_price_is_what_the_limit_costs(limits, field):
    """Planned again with the limit 1 % looser, the goal falls by the price, to first order."""
    problem = pose([0.05, 0.02, 0.03], 0.2, **limits)
    plan = plan_strike(problem, starts=2)
    (price,) = [one for one in price_limits(problem.limits, [plan]) if field in one.key]
    wider = dc.replace(problem, limits=dc.replace(problem.limits, **{field: 1.01 * limits[field]}), unit=None)
    gain = plan.score - plan_strike(wider, starts=2, near=[plan.place]).score
    assert price.gain == pytest.approx(gain, rel=0.15)


def test_prices_of_a_sequence_have_one_base(held):
    """What a second impact gains by a faster arm is told in shares of the momentum at the start, as that of the first.
    """
    problem, first = held
    wider = dc.replace(problem, limits=dc.replace(problem.limits, speed=1.01 * problem.limits.speed), unit=None)
    begun = first.collision.attitude, first.collision.angular_velocity
    second = plan_strike(problem.begin_after(*begun), starts=2)
    faster = plan_strike(wider.begin_after(*begun), starts=2, near=[second.place])
    found = price_sequence(problem, [first, second])
    gains = [next(one.gain for one in prices if one.key == "arm.speed") for prices in found]
    before = measure_share(problem, first.collision.angular_velocity)
    assert before < 0.9
    left = [measure_share(problem, one.collision.angular_velocity) for one in (second, faster)]
    assert gains[1] == pytest.approx(left[0] - left[1], rel=0.15)
    other = dc.replace(problem, goal=Goal(2.0))  # the weight of a goal is no share of it
    doubled = [dc.replace(one, untouched=2.0, certificate=dc.replace(one.certificate, binding={
        name: 2.0 * value for name, value in one.certificate.binding.items()})) for one in (first, second)]
    assert [one.gain for prices in price_sequence(other, doubled) for one in prices] == pytest.approx(
        [one.gain for prices in found for one in prices], rel=1e-6)


def test_limits_that_are_reached_are_told_whether_they_cost_or_not(held, tmp_path):
    """Of an impact that a limit holds, that limit is reached and the certificate judges it; where nothing is left, no
    gradient says anything, of one impact or of all of a joint plan, and what is reached is listed all the same.
    """
    problem, plan = held
    found = Plan(problem, PlanSettings(), add_up(problem, [plan], 0.01))
    assert found.optimality == ("optimum",) and "arm's speed" in found.reached[0]
    assert all(plan.values[name] < REACHED for name in found.reached[0] if name in plan.values)
    free = dc.replace(plan, certificate=dc.replace(plan.certificate, binding={}, stationarity=1.0))
    assert Plan(problem, PlanSettings(), add_up(problem, [free], 0.01)).optimality == ("no limit holds",)
    assert list_reached(free) == found.reached[0]
    # Two impacts that together leave nothing, at the limit of the speed: no multiplier, no certificate, no price.
    last = dc.replace(free, score=1e-5)
    joint = Joint("share", True, 2, 1e-5, 1.0, 9.0, (2, 0.1, 1.0, 9.0))
    for aim, optimality in (("share", "nothing left"), ("impulse", "no limit holds")):
        both = dc.replace(add_up(problem, [free, last], 0.01), joint=dc.replace(joint, aim=aim))
        found = Plan(problem, PlanSettings(), both, rules=compare_rules(problem, plan))
        assert found.optimality == (optimality,) * 2
    write_plan(found, tmp_path)
    result = json.loads((tmp_path / "plan.json").read_text(encoding="utf-8"))
    assert all("arm's speed" in one["limits_reached"] for one in result["impacts"]) and result["prices"] == []
    assert {one["certificate"]["finding"] for one in result["impacts"]} == {"no limit holds"}
    assert "1.0e+00" not in (tmp_path / "report.html").read_text(encoding="utf-8")


def test_without_friction_a_straight_blow_is_as_good():
    """A normal force alone takes nothing from sliding: the best straight blow leaves what the plan leaves, but for the
    little that the place of contact wanders under it."""
    problem = pose([0.02, 0.0, 0.0], 0.0)
    plan = plan_strike(problem, starts=2)
    straight, paper = compare_rules(problem, plan)
    assert straight.allowed_share == pytest.approx(plan.score, abs=0.02)
    assert straight.speed <= 2.0 * (1 + 1e-9)
    assert np.isnan(paper.allowed_share) or paper.allowed_share >= plan.score - 1e-4


def test_a_late_blow_is_one_on_a_turned_body():
    """About a principal axis, an error of the instant is the same as one of the attitude about that axis."""
    problem = pose([0.06, 0.0, 0.0], 0.2)
    late = drift(problem, jnp.asarray(10.0 + 0.4))
    ahead = {"rates": jnp.zeros(3), "inertia": jnp.zeros(3), "attitude": jnp.array([0.06 * 0.4, 0.0, 0.0])}
    turned = drift(err_problem(problem, ahead), jnp.asarray(10.0))
    np.testing.assert_allclose(late[0], turned[0], atol=1e-12)
    np.testing.assert_allclose(late[1], turned[1], atol=1e-12)
    other = err_problem(problem, {"rates": jnp.array([0.1, 0.0, 0.0]), "inertia": jnp.array([0.2, 0.0, 0.1]),
                                    "attitude": jnp.zeros(3)})
    np.testing.assert_allclose(other.angular_velocity, [0.066, 0.0, 0.0])
    np.testing.assert_allclose(np.diagonal(other.debris.inertia),
                               np.diagonal(STAGE.inertia) * np.array([1.2, 1.2, 1.1]))


def test_errors_that_vanish_change_nothing(held):
    """In the limit of no error every draw leaves what was planned; larger errors leave more on average."""
    problem, plan = held
    tiny, usual = (try_errors(problem, plan, ErrorTable(draws=16, **{
        name: factor * size for name, size in ErrorTable().model_dump(exclude={"draws", "plan_for"}).items()}))
        for factor in (1e-6, 1.0))
    for one in tiny:
        np.testing.assert_allclose([one.mean, one.q95], plan.score, atol=1e-5)
        assert one.missed == 0.0 and one.violated == 0.0
    assert usual[-1].error == "all" and usual[-1].mean > plan.score


def test_errors_of_a_sequence(held):
    """Vanishing errors leave what is planned after every impact; a ball that misses leaves the motion to the next one;
    the first impact errs as alone; rates that are off by a factor do so throughout.
    """
    problem, first = held
    second = plan_strike(problem.begin_after(first.collision.attitude, first.collision.angular_velocity), starts=1)
    planned = np.array([first.score, first.score * second.score])
    assert 0.05 < second.score < 0.95

    def follow(impacts=(first, second), draws=16, **sizes):
        none = dict.fromkeys(ErrorTable().model_dump(exclude={"draws", "plan_for"}), 0.0)
        return follow_errors(problem, impacts, ErrorTable(draws=draws, **(none | sizes)))

    for one, share in zip(follow(speed=1e-7, draws=8), planned, strict=True):
        np.testing.assert_allclose([one.mean, one.q95], share, atol=1e-5)
        assert (one.missed, one.violated) == (0.0, 0.0)
    astray = follow(place=1e4, draws=8)
    assert [(one.missed, one.untaken, one.mean) for one in astray] == [(1.0, 1.0, 1.0)] * 2
    often = follow(place=0.02)
    assert 0.0 < often[0].missed == often[0].ever_missed
    assert max(one.missed for one in often) <= often[1].ever_missed <= min(sum(one.missed for one in often), 1.0)
    assert follow(speed=0.3)[0].mean > planned[0] and follow(inertia=0.2, rates=0.1)[1].mean > planned[1]


def test_a_blow_at_any_phase_may_speed_the_body_up():
    """A strike whose instant is wrong by turns of the body adds momentum in about as many draws as it takes some: that
    share, and what one of twenty leaves, are in the spread and in the sentence; vanishing errors add none.
    """
    problem = pose([0.02, 0.0, 0.0])
    plan = plan_strike(problem, starts=2, seed=5)  # of another place half of the phases miss the body
    none = dict.fromkeys(ErrorTable().model_dump(exclude={"draws", "plan_for"}), 0.0)
    exact, astray = (ErrorTable(draws=32, **(none | {"instant": sd})) for sd in (1e-7, 1e4))
    assert try_errors(problem, plan, exact)[-1].raised == 0.0
    spreads = try_errors(problem, plan, astray)
    one = spreads[-1]
    assert 0.2 < one.raised < 0.8 and one.q95 > 1.05
    sequence = add_up(problem, [plan], 0.01)
    told = Plan(problem, PlanSettings(errors=astray), sequence, spreads=spreads).sentence
    assert f"{100 * one.q95:.1f} %" in told and f"{100 * one.raised:.0f} %" in told


def test_misses_and_limits_that_errors_pass_are_told(held):
    """The share of the draws at any impact, with the one at which it is largest; less than one in a hundred is not
    told.
    """
    problem, plan = held
    one = try_errors(problem, plan, ErrorTable(draws=8))[-1]

    def tell(*shares, ever=None):
        spreads = tuple(dc.replace(one, missed=missed, violated=violated, ever_missed=missed, ever_violated=violated)
                        for missed, violated in shares)
        if ever:
            spreads = (*spreads[:-1], dc.replace(spreads[-1], ever_missed=ever[0], ever_violated=ever[1]))
        sequence = add_up(problem, [plan] * len(shares), 0.01)
        return Plan(problem, PlanSettings(len(shares), errors=ErrorTable(draws=8)), sequence, spreads=spreads[:1],
                    after=spreads if len(spreads) > 1 else ())

    assert tell((0.009, 0.0)).mishaps == {"missed": None, "violated": None}
    assert tell((0.37, 0.0)).mishaps == {"missed": Mishap(0.37, 1, 0.37), "violated": None}
    many = tell((0.1, 0.29), (0.37, 0.23), (0.37, 0.0), ever=(0.45, 0.33))
    assert many.mishaps == {"missed": Mishap(0.45, 2, 0.37), "violated": Mishap(0.33, 1, 0.29)}
    rare = tell((0.008, 0.0), (0.008, 0.0), ever=(0.016, 0.0))  # neither alone would be told
    assert rare.mishaps == {"missed": Mishap(0.016, 1, 0.008), "violated": None}
    quiet, missed, several = (told.sentence for told in (
        tell((0.0, 0.0)), tell((0.37, 0.0)), tell((0.0, 0.29), (0.37, 0.0), ever=(0.37, 0.31))))
    assert "edge" not in quiet and "limit" not in quiet
    assert "37 %" in missed and "edge" in missed and "31 %" in several and "29 %" in several
    none = dict.fromkeys(ErrorTable().model_dump(exclude={"draws", "plan_for"}), 0.0)
    told = dc.replace(tell((0.37, 0.2)), settings=PlanSettings(errors=ErrorTable(**none)))
    assert told.mishaps == {"missed": None, "violated": None}


def test_what_waiting_costs_is_told_with_its_key(held):
    """The rates' error turns a body that waits: where that is what errors cost and exceeds the attitude's own, the
    window is named; a sequence that ends by what is planned, and might go on, names the share, unless nothing is left.
    """
    problem, plan = held
    none = dict.fromkeys(ErrorTable().model_dump(exclude={"draws", "plan_for"}), 0.0)
    late = dc.replace(plan, score=0.0)
    sequence = dc.replace(add_up(problem, [late], 0.01), shares=(0.005,), reached=True, instants=(50.0,))
    told = {}
    for name, sizes in (("rates", none | {"rates": 0.02}), ("place", none | {"place": 0.02})):
        one = try_errors(problem, plan, ErrorTable(draws=8, **sizes))[-1]
        spreads = (dc.replace(one, error=name, mean=0.2), dc.replace(one, mean=0.2))
        for most in (1, 4):
            found = Plan(problem, PlanSettings(most, errors=ErrorTable(draws=8, **sizes)), sequence, spreads=spreads)
            told[name, most] = found.sentence
        speed = float(np.linalg.norm(problem.angular_velocity))
        assert found.turned == pytest.approx(sizes["rates"] * speed * 50.0)
    assert {key: "limits.window" in text for key, text in told.items()} == {key: key[0] == "rates" for key in told}
    assert {key: "goal.share" in text for key, text in told.items()} == {key: key[1] == 4 for key in told}
    assert "goal.share" not in dc.replace(found, sequence=dc.replace(sequence, shares=(1e-5,))).sentence


def test_no_share_of_the_momentum_is_wanted_where_none_was_asked_for(held):
    """A sequence for the energy ends at a share of the momentum, which is called wanted only where it was stated."""
    problem, plan = held
    sequence = dc.replace(add_up(problem, [plan], 0.01), joint=Joint("impacts", False, 1, 0.2, 1.0, 1.0, (1, 0.2, 1.0,
                                                                                                         1.0)))
    for goal, share, wanted in ((Goal(0.0, 1.0), 0.01, False), (Goal(0.0, 1.0), 0.02, True), (Goal(), 0.01, True)):
        found = Plan(dc.replace(problem, goal=goal), PlanSettings(2, share), sequence)
        assert found.asked == wanted and ("wanted" in found.sentence) == wanted


def test_in_how_many_cases_nothing_is_taken_is_told(held):
    """Where that is more than one case in twenty, its share is what the answer says."""
    problem, plan = held
    one = dc.replace(try_errors(problem, plan, ErrorTable(draws=8))[-1], mean=0.5, q95=1.0, raised=0.0, untaken=0.23,
                     missed=0.0, violated=0.0, ever_missed=0.0, ever_violated=0.0)
    found = Plan(problem, PlanSettings(), add_up(problem, [plan], 0.01), spreads=(one,))
    assert "23 %" in found.sentence
    for missed in (0.2, 0.23):  # told once where it is the misses that take nothing
        astray = dc.replace(one, missed=missed, ever_missed=missed)
        assert dc.replace(found, spreads=(astray,)).sentence.count("23 %") == 1
    assert "23 %" not in dc.replace(found, spreads=(dc.replace(one, q95=0.9, goal_q95=0.9, goal=0.5),)).sentence


def test_errors_that_nothing_states_are_told_beside_stated_ones(held):
    """Of a table that states some, those of the usual size are assumptions; of none, and of all, nothing is told."""
    problem, plan = held
    spreads = try_errors(problem, plan, ErrorTable(draws=8))

    def list_usual(**stated):
        return Plan(problem, PlanSettings(errors=ErrorTable(draws=8, **stated)), add_up(problem, [plan], 0.01),
                    spreads=spreads).usual_errors

    some = list_usual(place=0.005, attitude_degrees=0.0)
    assert "the instant" in some and not {"the place", "the attitude", "the centre of mass"} & {*some}
    assert list_usual() == [] == list_usual(**ErrorTable().model_dump(exclude={"draws", "plan_for"}))


@pytest.mark.study
def test_an_erring_impact_has_slopes(held):
    """No error is the planned impact itself; with one, derivatives by the design agree with central differences."""
    problem, plan = held
    face, x = plan.place
    (none,), (error,) = (draw_errors({name: factor * size for name, size in ErrorTable().sizes().items()}, 1, 2)
                         for factor in (0.0, 1.0))
    plain = compute_impact(problem, face, x)
    np.testing.assert_allclose(compute_impact(problem, face, x, none), plain, rtol=1e-6, atol=1e-8)
    values, slopes = compute_slopes(problem, face, 0.9 * x, error)
    assert np.abs(values - compute_impact(problem, face, 0.9 * x)).max() > 1e-3
    for k in range(len(x)):
        step = 1e-4 * np.eye(len(x))[k]
        ahead, behind = (compute_impact(problem, face, 0.9 * x + sign * step, error) for sign in (1, -1))
        np.testing.assert_allclose(slopes[:, k], (ahead - behind) / 2e-4, rtol=2e-3, atol=2e-3 * np.abs(slopes).max())


@pytest.mark.study
def test_a_plan_for_errors_keeps_its_limits_under_others(tmp_path):
    """Limits hold in the mean of their worst tenth of errors that the plan has not seen, where the plain plan, at its
    limits, passes some in about half of them; the price is some momentum if all goes well."""
    text = SCENARIO + "[arm]\nspeed = 0.3\n[limits]\nforce = 400.0\n[errors]\ndraws = 64\n"
    found = {}
    for kind in ("best", "tail"):
        (tmp_path / f"{kind}.toml").write_text(text + f"plan_for = '{kind}'\n")
        found[kind] = dd.plan(tmp_path / f"{kind}.toml")
    problem = found["best"].problem
    others = draw_errors(ErrorTable().sizes(), 128, 77)
    values = {kind: np.stack([compute_impact(problem, *one.impacts[0].place, error) for error in others])
              for kind, one in found.items()}
    weights = np.full(128, 1.0 / 128)
    worst = {kind: max(find_tail(-column, weights, 0.1) for column in own[:, 1:].T) for kind, own in values.items()}
    assert worst["best"] > 0.02 and worst["tail"] < 0.3 * worst["best"]
    tails = {kind: find_tail(own[:, 0], weights, 0.1) for kind, own in values.items()}
    planned = {kind: compute_impact(problem, *one.impacts[0].place)[0] for kind, one in found.items()}
    assert planned["tail"] > planned["best"] and tails["tail"] >= planned["tail"]
    assert found["tail"].impacts[0].allowed


@pytest.mark.parametrize("text", ["plan_for = 'luck'", "plan_for = 'mean'\n[uncertainty]\nplan_for = 'tail'",
                                  "plan_for = 'tail'\n[goal]\nleast = 'impulse'"])
def test_what_contradicts_itself_is_refused(tmp_path, text):
    with pytest.raises(dd.InputError):
        read(tmp_path, SCENARIO + "[errors]\n" + text + "\n")


def test_a_goal_of_ones_own(tmp_path):
    """A function of the motion takes the place of the weights: here the energy, by its definition."""
    (tmp_path / "goals.py").write_text("def energy(rates, inertia):\n    return 0.5 * rates @ inertia @ rates\n")
    trust_file(tmp_path / "goals.py")
    problem = read(tmp_path, SCENARIO + '[goal]\nfunction = "goals.py:energy"\n')
    rates = np.array([0.01, -0.02, 0.04])
    energy = 0.5 * rates @ np.asarray(problem.debris.inertia) @ rates
    assert float(score(problem, jnp.asarray(rates))) == pytest.approx(energy, rel=1e-12)
    (tmp_path / "others.py").write_text("def energy(rates, inertia):\n    return rates @ inertia @ rates\n")
    with pytest.raises(dd.InputError, match="ddetumble trust") as refused:
        (tmp_path / "others.toml").write_text(SCENARIO + '[goal]\nfunction = "others.py:energy"\n')
        dd.plan(tmp_path / "others.toml")
    assert (refused.value.file, refused.value.key) == (str(tmp_path / "others.toml"), "goal.function")
    for name, key in (("goals.py:nothing", "goal.function"), ("energy", "goal.function")):
        with pytest.raises(dd.InputError) as refused:
            read(tmp_path, SCENARIO + f'[goal]\nfunction = "{name}"\n')
        assert refused.value.key == key


@pytest.mark.study
def test_what_is_left_is_told_of_the_goal_that_was_asked_for(tmp_path):
    """With a goal of one's own, sentence, result and page say what is left of that, before and after, and no share of
    the momentum that nobody asked for.
    """
    (tmp_path / "goals.py").write_text("def spin(rates, inertia):\n    return rates[0] ** 2 + rates[2] ** 2 + 1e-6\n")
    trust_file(tmp_path / "goals.py")
    (tmp_path / "case.toml").write_text(SCENARIO + '[goal]\nfunction = "goals.py:spin"\n[errors]\ndraws = 8\n')
    found = dd.plan(tmp_path / "case.toml")
    dd.report(found, tmp_path / "out")
    result = json.loads((tmp_path / "out" / "plan.json").read_text(encoding="utf-8"))
    (impact,), told = result["impacts"], result["goal"]
    before, after = (float(w[0] ** 2 + w[2] ** 2 + 1e-6) for w in (
        found.problem.angular_velocity, impact["angular_velocity"]))
    assert (told["before"], told["after"]) == pytest.approx((before, after), rel=1e-9)
    assert told["share_left"] == impact["goal_left"] == pytest.approx(after / before, rel=1e-9)
    assert abs(told["share_left"] - result["share_left"]) > 1e-3
    assert (result["wanted_share"], result["reached"]) == (None, None)
    erring = result["errors"][-1]
    assert erring["goal"] != pytest.approx(erring["mean"], rel=1e-3)
    headline, _, rest = found.sentence.partition(". ")
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    for text in (headline, page):
        assert "spin" in text and f"{100 * erring['goal']:.2f}" in text and f"{100 * told['share_left']:.2f}" in text
    assert f"{after:.3g}" in headline and f"{before:.3g}" in headline and "wanted 1" not in found.sentence


@pytest.mark.parametrize("aim", ["best", "mean"])
def test_what_staying_within_what_was_measured_costs_is_told_of_the_goal(held, aim):
    """Of a plan for the energy, the one that need not stay there is told by the energy that it leaves."""
    problem = dc.replace(held[0], goal=Goal(0.0, 1.0))
    inside, outside = held[1], plan_strike(dc.replace(problem, limits=dc.replace(problem.limits, speed=1.0)), starts=1)
    inertia = np.asarray(problem.debris.inertia)
    energies = [w @ inertia @ w for w in (np.asarray(one.angular_velocity) for one in (
        problem, inside.collision, outside.collision))]
    narrow, wide = np.array(energies[1:]) / energies[0]
    planned = [dc.replace(one, score=left, untouched=1.0) for one, left in ((inside, narrow), (outside, wide))]
    found = Plan(problem, PlanSettings(within="measured", errors=ErrorTable(plan_for=aim)),
                 add_up(problem, planned[:1], 0.01), beyond=add_up(problem, planned[1:], 0.01))
    assert found.confined == pytest.approx((narrow, wide), rel=1e-6)
    assert found.goal_beyond == pytest.approx(wide, rel=1e-6) and found.goals_left == pytest.approx((narrow,), rel=1e-6)
    told = found.sentence.split("within what was measured")[1]
    assert f"{100 * wide:.2f} % of {problem.goal.name()}" in told and "energy" in problem.goal.name()


def test_result_and_page_hold_them(tmp_path):
    """Prices, rules, errors and the chaser's recoil are in the result; momentum of chaser and body sums to zero."""
    path = tmp_path / "case.toml"
    path.write_text(SCENARIO + '[arm]\nspeed = 0.3\nchaser_mass = "500 kg"\n[limits]\nforce = 1000.0\n'
                    "[errors]\nplace = 0.02\ndraws = 16\n")
    assert main(["plan", str(path), "-o", str(tmp_path / "out")]) == 0
    result = json.loads((tmp_path / "out" / "plan.json").read_text(encoding="utf-8"))
    (impact,) = result["impacts"]
    both = 500.0 * np.array(impact["chaser_velocity"]) + 1000.0 * np.array(impact["debris_velocity"])
    np.testing.assert_allclose(both, 0.0, atol=1e-9)
    assert any(one["key"] == "arm.speed" and one["gain"] > 0 for one in result["prices"])
    assert len(result["rules"]) == 2 and result["errors"][-1]["error"] == "all"
    assert next(one["size"] for one in result["errors"] if one["error"] == "place") == 0.02
    assert result["doubts"] == []
    # What strikes: the paper's ball, 60 mm, on the arm's mass, with the scenario's friction.
    assert result["contact"]["fits"] == {} and result["contact"]["ball"] == "Ball"
    told = {(one["of"], one["unit"]): one["value"] for one in result["contact"]["parameters"] if one["unit"]}
    assert told["ball", "m"] == pytest.approx(0.06) and told["arm", "kg"] > 0.0
    assert 0.218 in [pytest.approx(one["value"]) for one in result["contact"]["parameters"] if one["of"] == "friction"]
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8").replace("\u00a0", " ")
    assert ">60 mm<" in page


def test_a_body_far_too_light_for_its_size_is_asked_about(tmp_path):
    """The plan is made, and says what it doubts."""
    path = tmp_path / "case.toml"
    path.write_text(SCENARIO + "mass = 0.5\n[errors]\ndraws = 8\n")
    found = dd.plan(path)
    assert [one.variable for one in found.doubts] == ["debris.mass"] and str(found.doubts[0]) in str(found)


@pytest.mark.study
def test_one_blow_is_judged_in_public(held):
    """What a plan says of its blow comes again from its variables; a map of places and its gradient are one `vmap`."""
    problem, best = held
    face, x = best.place
    values, slopes = map(np.asarray, dd.planning.evaluate_slopes(problem, face, jnp.asarray(x)))
    assert float(values[0]) == pytest.approx(best.score, rel=1e-6)
    kept = dict(zip(dd.planning.CONSTRAINTS, map(float, values[1:]), strict=True))
    assert kept == pytest.approx(best.values, abs=1e-6)
    places = x + np.array([[0.0], [1e-4], [-1e-4]]) * (np.arange(7) == 0)
    scores = np.asarray(jax.vmap(lambda one: dd.planning.evaluate(problem, face, one))(jnp.asarray(places)))[:, 0]
    assert float(scores[0]) == pytest.approx(best.score, rel=1e-6)
    assert float(scores[1] - scores[2]) / 2e-4 == pytest.approx(float(slopes[0, 0]), rel=1e-2, abs=1e-4)


@pytest.mark.parametrize(("body", "words"), [
    ("w @ w, w @ w", "fails"), ("'a'", "fails"), ("w", "fails"), ("1 / 0", "ZeroDivisionError"), ("-(w @ w)", "is -"),
    ("w[0] * jnp.nan", "is nan"), ("jnp.sqrt(jnp.sum((w - w) ** 2)) + 1.0", "gradient")])
def test_a_goal_that_fails_is_no_bug_of_the_toolkit(tmp_path, body, words):
    """Tried at the motion before the first impact, and refused in a sentence that names it."""
    (tmp_path / "goals.py").write_text(f"import jax.numpy as jnp\n\n\ndef own(w, inertia):\n    return {body}\n")
    trust_file(tmp_path / "goals.py")
    with pytest.raises(dd.InputError, match="goals.py:own") as error:
        read(tmp_path, SCENARIO + '[goal]\nfunction = "goals.py:own"\n')
    assert error.value.key == "goal.function" and words in error.value.problem


def test_angles_and_fractions_take_texts_with_units(tmp_path):
    """As every other key does: docs/scenario.md says so."""
    text = ('schema = "ddetumble.plan/1"\n[debris]\nangular_velocity = [0.1, 0.0, 0.0]\n'
            '[arm]\ncone_degrees = "0.5 rad"\n[errors]\ndirection_degrees = "2 deg"\nattitude_degrees = "0.1 rad"\n'
            'rates = "3 %"\nspeed = "2 %"\ninertia = "5 %"\n')
    (tmp_path / "scenario.toml").write_text(text)
    scenario = read_scenario(tmp_path / "scenario.toml")
    assert scenario.arm.cone_degrees == pytest.approx(np.degrees(0.5))
    sizes = scenario.errors.sizes()
    assert [sizes[name] for name in ("direction", "attitude", "rates", "speed", "inertia")] == pytest.approx(
        [np.radians(2.0), 0.1, 0.03, 0.02, 0.05])


def test_the_shortest_wait_has_a_price_of_its_own(held):
    """An impact after another that comes as soon as it may is held by the clearance, unless the window holds it."""
    problem, plan = held
    early = dc.replace(plan, certificate=dc.replace(plan.certificate, binding={"lowest instant": 0.3}, stationarity=0))
    for begin, keys in ((0.0, [[], ["arm.clearance_time"]]), (1.5, [["limits.window"], []]),
                        (30.0, [["limits.window"], ["limits.window"]])):
        limits = dc.replace(problem.limits, window=np.array([begin, 60.0]))
        assert [[one.key for one in price_limits(limits, [early], first=k)] for k in (1, 2)] == keys
    limits = dc.replace(problem.limits, window=np.array([0.0, 61.0]))
    (price,) = price_limits(limits, [early, early])
    assert price.gain == pytest.approx(0.3 * 2.0 * 0.2 / 60.0)  # 0.1 s less on either side, in a window of 60 s


def test_prices_name_the_limit_that_holds():
    """Where a plan stays within what was measured, a looser limit of the scenario would gain nothing."""
    given = Limits(pressure=np.array([1e6, 2.5e6]), force=500.0, approach=0.05)
    narrowed = dc.replace(given, pressure=np.array([1e6, 2.43e6]), force=80.0)
    prices = tuple(Price(key, change, 0.1, "goal") for key, change in (
        ("limits.pressure", "the highest 1 % more"), ("limits.force", "1 % more"),
        ("limits.pressure", "the lowest 1 % less"), ("limits.approach", "1 % less")))
    assert [one.key for one in name_narrowed(prices, given, narrowed)] == [
        "limits.within", "limits.within", "limits.pressure", "limits.approach"]
    assert name_narrowed(prices, given, given) == prices


def read_numbers(text):
    """Numbers of a text, in their order."""
    return [float(one) for one in re.findall(r"-?\d+\.?\d*", text.replace("−", "-"))]


def test_a_full_tensor_is_shown_with_its_axes():
    """A body of moments 1, 2 and 4 turned by 30° about its z axis; and one with two equal moments."""
    c, s = np.cos(np.pi / 6), np.sin(np.pi / 6)
    turned = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    tensor = turned @ np.diag([1.0, 2.0, 4.0]) @ turned.T
    whole, *axes = [read_numbers(text) for _, text in list_inertia(tensor)]
    assert whole == pytest.approx(list(tensor.ravel()), abs=1e-3)
    assert [one[0] for one in axes] == [1.0, 2.0, 4.0] and [one[4] for one in axes] == [30.0, 30.0, 0.0]
    assert [one[1:4] for one in axes] == [pytest.approx(list(axis), abs=1e-3) for axis in turned.T]
    ring = list_inertia(2.0 * np.eye(3) + np.ones((3, 3)))
    assert [read_numbers(text)[0] for _, text in ring[1:]] == [2.0, 5.0]
    assert np.abs(read_numbers(ring[1][1])[1:]) == pytest.approx(3 * [0.577])
    assert [read_numbers(text) for _, text in list_inertia(np.diag([1.0, 2.0, 3.0]))] == [[1.0, 2.0, 3.0]]
