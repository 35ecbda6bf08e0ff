"""Tables 5 and 6: what they ask of an impact, by hand, and the motion before and after against closed forms."""

import jax.numpy as jnp
import numpy as np
import pytest

from ddetumble._rotation import rotate
from ddetumble.dynamics import Cylinder, propagate_torque_free
from ddetumble.dynamics.rigid import measure_momentum
from ddetumble.paper.detumbling import find_demand, find_mass, follow_impact, place_stage, sample_steps, strike_stage
from ddetumble.paper.tumbling import read_momentum


PRINTED = np.array([39.8, 69.183, 75.9])


def test_demand_by_hand():
    """Momentum over time and lever arm, from the tables' totals."""
    five = find_demand(read_momentum("table-5"), PRINTED, 0.2)
    assert five["share"] == pytest.approx(1 - 26.815 / 72.829, abs=2e-5)
    assert five["moment"] == pytest.approx((72.829 - 26.815) / 0.4, rel=1e-4)
    assert five["forces"]["side wall, at the rim"] == pytest.approx(115.04 / 1.5, rel=1e-4)
    assert five["forces_with_friction"]["side wall, at the rim"] == pytest.approx(115.04 / 1.7, rel=1e-4)
    assert five["forces_with_friction"]["end face, at the rim"] == pytest.approx(115.04 / 1.3, rel=1e-4)
    assert five["smallest_arm"] > 1.5  # no printed force is enough at the lever arm that there is
    six = find_demand(read_momentum("table-6"), PRINTED, 0.2)
    assert six["forces"]["end face, at the rim"] == pytest.approx(50.0, abs=0.02)
    # The same impulse in the 0.27 s of the tests.
    assert five["forces_in_test"]["side wall, at the rim"] == pytest.approx((72.829 - 26.815) / 0.27 / 1.5, rel=1e-4)
    assert six["forces_in_test"]["end face, at the rim"] == pytest.approx((72.829 - 52.834) / 0.27, abs=0.05)
    # Whatever stays along the axis turns the direction by the difference of two angles.
    a = 72.829 * np.sin(np.radians(five["tilt"]))
    turn = np.degrees(np.arcsin(a / 26.8146) - np.arcsin(a / 72.829))
    assert turn == pytest.approx(five["turn"], rel=1e-3)


@pytest.mark.slow
def test_stage_before_and_after():
    """The axis stands across the momentum; the step leaves what the table prints, in its direction."""
    table = read_momentum("table-5")
    passage = follow_impact(table, 40.0, 60.0)
    inertia = np.diag(np.asarray(Cylinder().inertia()))
    momentum = measure_momentum(inertia, passage.attitude[-1], passage.angular_velocity[-1])
    np.testing.assert_allclose(momentum, table.before * np.linalg.norm(table.after)
                               / np.linalg.norm(table.before), atol=1e-8)
    rates = np.linalg.norm(passage.angular_velocity, axis=1)
    np.testing.assert_allclose(rates[passage.time < 0], np.linalg.norm(table.before) / inertia[0], rtol=1e-12)
    np.testing.assert_allclose(rates[passage.time > 0.4], np.linalg.norm(table.after) / inertia[0], rtol=1e-9)
    last = np.argmax(passage.time)
    start = np.flatnonzero(passage.time == 0.4)[0]
    again = propagate_torque_free(inertia, passage.attitude[start], passage.angular_velocity[start],
                                  np.array([passage.time[last] - 0.4]))
    np.testing.assert_allclose(again.angular_velocity[0], passage.angular_velocity[last], atol=1e-12)
    axis = np.asarray(rotate(jnp.asarray(place_stage(table.before)), jnp.array([0.0, 0.0, 1.0])))
    assert abs(axis @ table.before) < 1e-10 and abs(axis[2]) < 1e-12


def test_two_steps_of_a_half_sine():
    """0 and 1 at two steps of 0.2 s, against 2/pi of 0.4 s; many steps see all of it."""
    assert sample_steps() == pytest.approx(0.2 / (0.4 * 2 / np.pi))
    assert sample_steps(1e-4) == pytest.approx(1.0, abs=1e-6)


@pytest.mark.slow
def test_own_impacts_take_momentum():
    """A heavier arm and a faster one take more, near the instant's m_red (1 + e) v times the arm."""
    rows = strike_stage(read_momentum("table-5").before)
    light = rows[0]
    reduced = 1.0 / (1.0 / 1.2 + 1e-3 + 1.4**2 / 1000.0)
    assert light["share"] * 72.829 == pytest.approx(reduced * 1.7 * (0.4 + 1.4 * 0.072829) * 1.4, rel=2e-2)
    shares = [row["share"] for row in rows[4:]]
    assert shares == sorted(shares)
    mass, peak = find_mass(rows, shares[1])
    assert mass == pytest.approx(rows[5]["mass"]) and peak == pytest.approx(rows[5]["peak_force"])
