"""The laws as plain functions, against the second implementation and closed forms."""

import jax
import numpy as np
import pytest

import ddetumble as dd
from ddetumble.effects.impact import ViscoelasticWall, ViscousDashpot, WallStiffness
from ddetumble.effects.slip import Stribeck
from ddetumble.exam.simulators.impact import Impact
from ddetumble.exam.simulators.slip import simulate_slip


DEPTH = np.array([0.0, 1e-3, 4e-3, 9e-3])
RATE = np.array([[-0.3], [0.0], [0.5]])


def test_normal_force_is_that_of_the_second_implementation():
    """Gas, geometry, damping, a wall and a dashpot, loading and unloading, at every pair of depression and rate."""
    law = (dd.Ball(effective_mass=1.2, restitution=0.7)
           + WallStiffness(k_w=900.0, q=1.2) + ViscousDashpot(c_v=3.0))
    found = dd.dynamics.normal_force(law, DEPTH, RATE, approach_speed=0.5, initial_pressure=1e6)
    other = Impact({"effective_mass": 1.2, "restitution": 0.7}, {
        "wall-stiffness": {"k_w": 900.0, "q": 1.2}, "viscous-dashpot": {"c_v": 3.0}},
        {"initial_pressure": 1e6, "approach_speed": 0.5})
    expected = [[other.find_contact_force(0.0, x, w, 0.0) for x in DEPTH] for w in RATE[:, 0]]
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)


def test_normal_force_of_a_power_law():
    """F_10 (delta/10 mm)^n, and n F/delta as its derivative; nothing pulls."""
    model = dd.PowerLaw(stiffness_force=50.0, exponent=1.5)
    np.testing.assert_allclose(dd.dynamics.normal_force(model, DEPTH), 50.0 * (DEPTH / 0.01) ** 1.5, rtol=1e-12)
    slope = jax.grad(lambda x: dd.dynamics.normal_force(model, x))(4e-3)
    assert float(slope) == pytest.approx(1.5 * 50.0 * 0.4**1.5 / 4e-3)
    assert float(dd.dynamics.normal_force(model, 4e-3, -100.0)) == 0.0


@pytest.mark.parametrize("load", [5.0, 14.0, 28.0])
def test_friction_coefficient_is_that_of_the_second_implementation(load):
    """Eqs. 8 to 10 with a Stribeck term, over slip."""
    law, slip = dd.RubberFriction() + Stribeck(A=0.3, u_s=0.05), np.linspace(0.0, 0.012, 25)
    conditions = {"normal_load": load, "internal_pressure": 1e6, "slip_speed": 0.1}
    found = dd.dynamics.friction_coefficient(law, slip, **conditions)
    other = simulate_slip({"adhesion_constant": 0.8, "loss_factor": 0.15, "slip_scale": 1.0},
                          {"stribeck": {"A": 0.3, "u_s": 0.05}}, conditions, slip)
    np.testing.assert_allclose(found, other[:, 0] / load, rtol=1e-9)


def test_conditions_broadcast_too():
    """Loads, pressures and speeds of any shape: each is as by itself."""
    slip, loads = np.linspace(1e-3, 8e-3, 5), np.array([[5.0], [12.0], [28.0]])
    found = dd.dynamics.friction_coefficient(dd.RubberFriction(), slip, normal_load=loads, internal_pressure=1e6)
    alone = [dd.dynamics.friction_coefficient(dd.RubberFriction(), slip, normal_load=load, internal_pressure=1e6)
             for load in loads.ravel()]
    np.testing.assert_allclose(found, np.stack(alone), rtol=1e-13)
    pressures = np.array([0.5e6, 2e6])
    found = dd.dynamics.normal_force(dd.Ball(), 3e-3, 0.1, approach_speed=0.4, initial_pressure=pressures)
    alone = [dd.dynamics.normal_force(dd.Ball(), 3e-3, 0.1, approach_speed=0.4, initial_pressure=p) for p in pressures]
    np.testing.assert_allclose(found, np.stack(alone), rtol=1e-13)


@pytest.mark.parametrize(("call", "says"), [
    (lambda: dd.dynamics.normal_force(dd.Ball() + ViscoelasticWall(k_v=10.0, tau=0.1), 1e-3, initial_pressure=1e6),
     "viscoelastic-wall"),
    (lambda: dd.dynamics.normal_force(dd.Ball(), 1e-3), "initial_pressure"),
    (lambda: dd.dynamics.normal_force(dd.RubberFriction(), 1e-3), "ContactLaw"),
    (lambda: dd.dynamics.friction_coefficient(dd.Ball(), 1e-3, normal_load=5.0), "FrictionLaw"),
    (lambda: dd.dynamics.friction_coefficient(dd.RubberFriction(), 1e-3, normal_load="much"), "normal_load"),
    (lambda: dd.dynamics.friction_coefficient(dd.RubberFriction(), 1e-3, normal_load=[5.0, 0.0]), "normal_load"),
])  # fmt: skip
def test_what_is_no_such_function_is_refused(call, says):
    with pytest.raises(dd.InputError, match=says):
        call()
