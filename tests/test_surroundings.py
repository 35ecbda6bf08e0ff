"""The pressure around the ball is that of the place where it strikes, and not that of the tests of a fit."""

import json
from types import SimpleNamespace
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import ddetumble as dd
from ddetumble.contact.gripping import Striker
from ddetumble.contact.sliding import CoulombFriction
from ddetumble.planning.scenario import mount_law, pose_laws
from ddetumble.planning.scenario_file import read_scenario
from ddetumble.planning.surroundings import find_ambient, list_surroundings, surround
from ddetumble.selection.result import Estimate
from ddetumble.selection.verdict_facts import doubt_ambient


SCENARIO = """schema = "ddetumble.plan/1"
starts = 1
[debris]
angular_velocity = [0.05, 0.02, 0.03]
"""
BENCH = dd.Ball() + dd.effects.AmbientPressure(1.02e5)
STRIKER = Striker(dd.Ball(), CoulombFriction(0.3), tangential_mass=2.0, rolling_mass=0.3)


def write(folder, text=""):
    (folder / "case.toml").write_text(SCENARIO + text, encoding="utf-8")
    return read_scenario(folder / "case.toml")


def press(law):
    """Elastic force of a ball of 1 MPa that is pressed in by 6 mm [N], and the contact's area [m^2]."""
    conditions = {"initial_pressure": jnp.asarray(1e6), "approach_speed": jnp.asarray(0.3)}
    contact = law.press(conditions, law.reference.diameter(), jnp.asarray(6e-3))
    return float(contact.elastic_force), float(contact.contact_area)


@pytest.mark.parametrize("fitted", [BENCH, STRIKER.extend(BENCH.effects)], ids=["straight", "oblique"])
@pytest.mark.parametrize(("ball", "pressure"), [
    ("", 0.0), ('ambient_pressure = "0.9 bar"\n', 9e4), ("ambient_pressure = 0\n", 0.0)])
def test_a_fitted_ball_strikes_under_the_pressure_of_the_plan(tmp_path, fitted, ball, pressure):
    """The force is the internal pressure less that around it, times the area."""
    law = mount_law(write(tmp_path, f"[ball]\n{ball}"), fitted, None)
    vacuum, area = press(dd.Ball().extend(()))
    force, _ = press(law.normal)
    assert force == pytest.approx(vacuum - pressure * area, rel=1e-12)
    assert press(BENCH)[0] == pytest.approx(vacuum - 1.02e5 * area, rel=1e-12)  # on its bench


def test_the_papers_ball_strikes_on_the_ground(tmp_path):
    law = mount_law(write(tmp_path, '[ball]\nambient_pressure = "101.3 kPa"\n'), None, None)
    vacuum, area = press(dd.Ball().extend(()))
    assert press(law.normal)[0] == pytest.approx(vacuum - 101_300.0 * area, rel=1e-12)
    assert mount_law(write(tmp_path), None, None).effects == ()


@pytest.mark.parametrize("value", ["-1.0", '"1 m"', "true"])
def test_an_ambient_pressure_that_makes_no_sense_is_refused(tmp_path, value):
    with pytest.raises(dd.InputError) as refused:
        write(tmp_path, f"[ball]\nambient_pressure = {value}\n")
    assert refused.value.key == "ball.ambient_pressure"


def test_other_effects_are_left_as_they_are():
    effects = (dd.effects.Adhesion(30.0), dd.effects.AmbientPressure(1e5))
    kept, moved = surround(effects, 0.0)
    assert kept is effects[0] and float(moved.p_a) == 0.0
    assert surround(effects[:1], 0.0) == effects[:1] and float(find_ambient(surround((), 5.0))) == 5.0


@pytest.mark.slow
def test_a_plan_tells_what_the_tests_were_made_under(tmp_path):
    """A fit that is told of an ambient pressure: draws and best estimate strike without it; on the ground with it."""
    fitted = dd.fit(dd.find_data() / "impact-a", BENCH, fixed={"ambient-pressure.p_a": 1.02e5})
    fitted.save(tmp_path / "fit")
    for ball, pressure, told in (("", 0.0, 1), ('ambient_pressure = "102 kPa"\n', 1.02e5, 0)):
        scenario = write(tmp_path, f'[ball]\nmodel = "fit"\n{ball}[uncertainty]\nfit = "fit"\ndraws = 3\n')
        laws = pose_laws(scenario, tmp_path)
        assert float(find_ambient(laws.main.effects)) == pressure
        found = list_surroundings([dd.load(tmp_path / "fit")], laws.main.effects)
        assert [(one.campaign, one.planned) for one in found] == [("impact-a", pressure)] * told
        assert not told or found[0].fitted == pytest.approx(1.02e5)
        assert np.all(np.asarray(find_ambient(laws.draws.effects)) == pressure)


@pytest.mark.study
def test_a_plan_in_orbit_from_a_ball_of_the_bench(tmp_path):
    """Page and file name the pressure; the peak force is what the ball exerts without it."""
    fitted = dd.fit(dd.find_data() / "impact-a", BENCH, fixed={"ambient-pressure.p_a": 1.02e5})
    fitted.save(tmp_path / "fit")
    write(tmp_path, '[ball]\nmodel = "fit"\n')
    found = dd.plan(tmp_path / "case.toml")
    dd.report(found, tmp_path / "plan")
    result = json.loads((tmp_path / "plan" / "plan.json").read_text(encoding="utf-8"))
    assert result["ambient_pressure"] == 0.0 and len(found.surroundings) == 1
    assert result["contact"]["assumed"] == found.assumed
    assert found.assumed["ball.friction"] == 0.218
    assert found.assumed["arm.mass"] == pytest.approx(fitted.parameters["effective_mass"].estimate)


@pytest.mark.parametrize(("fitted", "added", "told"), [
    (93.3e3, True, ("5.3", "gauge")), (93.3e3, False, ("5.3",)), (101.0e3, True, ("gauge",)), (101.0e3, False, ())])
def test_a_fitted_ambient_pressure_is_held_against_the_stated_one(fitted, added, told):
    """By how many standard deviations it differs; where it was added to gauge pressures, that it may only be taken off
    again is told even where it agrees.
    """
    step = SimpleNamespace(parameters={"ambient-pressure.p_a": Estimate(fitted, 1.5e3, 0.0, 0.0, "Pa")})
    found: Any = SimpleNamespace(steps=[SimpleNamespace(parameters={}), step])
    sentence = doubt_ambient(found, 101.3e3, added, 2.0)
    assert (sentence is None) == (not told) and all(word in str(sentence) for word in told)
    assert (sentence is None or "gauge" not in str(sentence)) == (not added)
    assert doubt_ambient(found, None, added, 2.0) is None
    assert doubt_ambient(SimpleNamespace(steps=found.steps[:1]), 101.3e3, added, 2.0) is None
