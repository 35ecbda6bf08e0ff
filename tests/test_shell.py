"""The ball's wall: thin and thick limits of its inflation, its stiffness, and the reference model of shell and gas."""

import numpy as np
import pytest
from scipy.integrate import quad

import ddetumble as dd
from ddetumble.contact.shell import inflation_pressure, limit_pressure, shell_stiffness
from ddetumble.reference_models import MODELS


@pytest.mark.parametrize("stretch", [1.05, 1.4, 2.5])
@pytest.mark.parametrize("ratio", [0.1, 2 / 3, 0.95])
def test_inflation_is_the_integral_of_the_energy(stretch, ratio):
    """P = int dW/dl / (l^3 - 1) dl from the outer to the inner stretch, W = mu (2 l^2 + l^-4 - 3)/2, by quadrature."""
    outer = (1.0 + ratio**3 * (stretch**3 - 1.0)) ** (1 / 3)
    expected = quad(lambda s: 2.0 * (s - s**-5) / (s**3 - 1.0), outer, stretch, epsabs=1e-13)[0]
    assert float(inflation_pressure(stretch, ratio, 3.0)) == pytest.approx(3.0 * expected, rel=1e-9)


def test_a_thin_wall():
    """2 mu (t/R)(1/l - 1/l^7), of first order in t/R, with its largest pressure at l = 7^(1/6)."""
    for thin in (1e-2, 1e-3):
        found = float(inflation_pressure(1.5, 1.0 - thin, 1.0))
        assert found == pytest.approx(2.0 * thin * (1.5**-1 - 1.5**-7), rel=3.0 * thin)
        pressure, stretch = limit_pressure(1.0 - thin, 1.0)
        assert stretch == pytest.approx(7 ** (1 / 6), rel=thin)
        assert pressure == pytest.approx(2.0 * thin * (stretch**-1 - stretch**-7), rel=2.0 * thin)


def test_a_thick_wall():
    """Small strains: 4 mu e (1 - rho^3) of incompressible elasticity; a small cavity: up to 2.5 mu at any stretch."""
    strain = 1e-6
    assert float(inflation_pressure(1.0 + strain, 0.6, 2.0)) == pytest.approx(8.0 * strain * (1 - 0.6**3), rel=1e-5)
    assert limit_pressure(1e-3, 1.0)[0] == pytest.approx(2.5, abs=0.02)
    assert float(inflation_pressure(1e3, 1e-6, 1.0)) == pytest.approx(2.5 - 2.0 / 1e3, abs=1e-6)


def test_the_largest_pressure_is_one():
    """None of many stretches holds more, and twice the modulus holds twice as much."""
    pressure, stretch = limit_pressure(2 / 3, 2.6e6)
    many = np.asarray(inflation_pressure(np.geomspace(1.0, 30.0, 5000), 2 / 3, 2.6e6))
    assert many.max() <= pressure * (1 + 1e-9) and many.max() == pytest.approx(pressure, rel=1e-5)
    assert limit_pressure(2 / 3, 5.2e6) == pytest.approx((2.0 * pressure, stretch), rel=1e-6)


def test_stiffness_of_a_shell():
    """With the square of the thickness over the radius; nu = 1/2 gives 4 E t^2/(1.5 R)."""
    assert float(shell_stiffness(0.01, 0.025, 7.8e6, 0.5)) == pytest.approx(4 * 7.8e6 * 1e-4 / (1.5 * 0.025))
    ratio = shell_stiffness(0.02, 0.05, 1e6, 0.3) / shell_stiffness(0.01, 0.025, 1e6, 0.3)
    assert float(ratio) == pytest.approx(2.0)


def strike(pressure, **parameters):
    """Peak force [N] and contact time [s] of an impact at 0.4 m/s."""
    model = dd.contact.InflatedShell(**parameters)
    conditions = {"initial_pressure": pressure, "approach_speed": 0.4}
    found = dd.dynamics.simulate_impact(dd.contact.ContactLaw(model), conditions, np.linspace(0.0, 0.05, 1001))
    return float(np.max(found.normal_force)), float(found.separation)


def test_the_wall_alone_is_a_spring():
    """Without gas and damping: half a swing, with the peak v sqrt(k m) and the duration pi sqrt(m/k)."""
    k, m = float(shell_stiffness(0.01, 0.025, 7.8e6, 0.47)), 1.2
    peak, lasting = strike(0.0, effective_mass=m, restitution=0.9999)
    assert peak == pytest.approx(0.4 * np.sqrt(k * m), rel=1e-3)
    assert lasting == pytest.approx(np.pi * np.sqrt(m / k), rel=1e-3)


def test_gas_stands_beside_the_wall():
    """It makes the impact harder and shorter, and with no modulus left it is the gas ball of the cavity's diameter."""
    peaks, times = zip(*(strike(p) for p in (0.0, 1e6, 2.5e6)), strict=True)
    assert np.all(np.diff(peaks) > 0) and np.all(np.diff(times) < 0)
    gas = dd.contact.ContactLaw(dd.Ball(outer_diameter=0.040))
    found = dd.dynamics.simulate_impact(gas, {"initial_pressure": 1e6, "approach_speed": 0.1},
                                        np.linspace(0.0, 0.1, 501))
    soft = dd.contact.ContactLaw(dd.contact.InflatedShell(elastic_modulus=1e-3))
    alike = dd.dynamics.simulate_impact(soft, {"initial_pressure": 1e6, "approach_speed": 0.1},
                                        np.linspace(0.0, 0.1, 501))
    np.testing.assert_allclose(alike.normal_force, found.normal_force, rtol=1e-6, atol=1e-6)


def test_the_shell_rivals_other_models_where_its_ball_is_known():
    """Its own diameters and modulus are those of Table 2: another campaign may be of another ball."""
    shell, ball = MODELS["shell"], {"inner_diameter": 0.04, "outer_diameter": 0.06, "elastic_modulus": 7.8e6}
    assert shell.is_rival(ball | {"poisson_ratio": 0.47})
    for known in ({}, ball, ball | {"poisson_ratio": None}):
        assert not shell.is_rival(known)
    assert MODELS["matunaga"].is_rival({}) and not MODELS["paper-eq6"].is_rival(ball)
