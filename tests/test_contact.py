"""Contact mechanics against theory: geometry, gas, damping, the printed forms of the paper."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad

from ddetumble._numerics import BLOCK, map_samples, positive_part, safe_power, safe_sqrt
from ddetumble.contact.damping import damping_number, delivered_restitution, printed_damping, restitution_balance
from ddetumble.contact.geometry import (
    contact_radius,
    membrane_area_radius,
    racetrack_volume,
    sphere_volume,
    truncated_sphere_radius,
)
from ddetumble.contact.law import Ball, ContactLaw, PowerLaw


DIAMETER = 0.060
GRID = np.concatenate([np.linspace(0.01, 0.999, 200), [1 - 1e-6, 1 - 1e-9]])


def press(reference, pressure, depression):
    """Elastic force [N] at rest."""
    law = ContactLaw(reference)
    conditions = {"initial_pressure": jnp.asarray(pressure), "approach_speed": jnp.asarray(0.4)}
    zero, none = jnp.zeros(()), jnp.zeros((0,))
    return float(law.contact(conditions, reference.diameter(), zero, jnp.asarray(depression), zero, none).elastic_force)


@pytest.mark.parametrize("depression", [0.0, 1e-4, 5e-3, 0.02])
@pytest.mark.parametrize("coefficient", [np.pi / 4, 0.25])
def test_volume_is_integral_of_eq2(depression, coefficient):
    """The closed form is the integral that Eq. 2 prints; the doubled core adds pi b^2 d."""
    b, r = float(contact_radius(depression, coefficient)), 0.5 * (DIAMETER - depression)
    integral = quad(lambda y: 2 * np.pi * (b + np.sqrt(r**2 - y**2)) ** 2, 0.0, r, epsabs=0, epsrel=1e-12)[0]
    np.testing.assert_allclose(racetrack_volume(b, r), integral, rtol=1e-10)
    np.testing.assert_allclose(racetrack_volume(b, r, True), integral + np.pi * b**2 * 2 * r, rtol=1e-10)
    if depression == 0.0:
        np.testing.assert_allclose(integral, sphere_volume(DIAMETER), rtol=1e-10)


def test_perimeter_and_area_are_kept():
    """pi D = pi d + 4 b, and 2 b^2 + pi b d + d^2 = D^2, to rounding for depressions down to 1 nm."""
    depression = np.geomspace(1e-9, 0.03, 40)
    d = DIAMETER - depression
    b = np.asarray(contact_radius(depression, np.pi / 4))
    np.testing.assert_allclose(np.pi * DIAMETER, np.pi * d + 4 * b, rtol=1e-14)
    b = np.asarray(membrane_area_radius(depression, DIAMETER))
    np.testing.assert_allclose(2 * b**2 + np.pi * b * d, depression * (DIAMETER + d), rtol=1e-12)


def test_volume_grows_as_perimeter_is_kept():
    """V'/V0 = 1 + 0.70 depression/D to first order; P'/P0 = 0.94 at a tenth, 1.21 with b = depression/4 throughout."""
    ratio = lambda x, c: racetrack_volume(c * x * DIAMETER, 0.5 * DIAMETER * (1 - x)) / sphere_volume(DIAMETER)
    slope = float(jax.grad(ratio)(0.0, np.pi / 4))
    np.testing.assert_allclose(slope, 1.5 * (np.pi / 4) * (np.pi / 2) * 2 - 3.0, rtol=1e-12)
    assert round(slope, 2) == 0.70
    assert round(1 / float(ratio(0.1, np.pi / 4)), 2) == 0.94
    assert round(1 / float(ratio(0.1, 0.25)), 2) == 1.21


@pytest.mark.parametrize(
    "force, choices",
    [
        (45.0, dict(doubled_core=True)),
        (46.0, {}),
        (4.6, dict(contact_radius_coefficient=0.25, volume_coefficient=np.pi / 4, doubled_core=True)),
        (5.7, dict(contact_radius_coefficient=0.25, doubled_core=True)),
    ],
)
def test_printed_forms_give_printed_forces(force, choices):
    """Row 1 of `ddetumble paper`, Eq. 7 against Eqs. 2 to 4, at 1 MPa and 5 mm."""
    assert round(press(Ball(**choices), 1e6, 5e-3), 1) == force


def test_truncated_sphere():
    """Eq. 1: b^2 + (R - depression)^2 = R^2 at constant pressure; nothing, and no bad slope, at first touch."""
    b = float(truncated_sphere_radius(5e-3, DIAMETER))
    np.testing.assert_allclose(b**2 + (0.030 - 5e-3) ** 2, 0.030**2, rtol=1e-14)
    np.testing.assert_allclose(press(Ball(truncated=True), 1e6, 5e-3), 1e6 * np.pi * b**2, rtol=1e-14)
    assert float(truncated_sphere_radius(0.0, DIAMETER)) == 0.0
    assert np.isfinite(jax.grad(truncated_sphere_radius)(0.0, DIAMETER))


def test_power_law_reads_its_condition():
    """F = k (depression/10 mm)^n (c/c0)^beta."""
    model = PowerLaw(stiffness_force=80.0, exponent=1.7, condition_exponent=0.4,
                     condition="initial_pressure", condition_reference=1e6)
    np.testing.assert_allclose(press(model, 2e6, 4e-3), 80 * 0.4**1.7 * 2**0.4, rtol=1e-13)
    assert press(model, 2e6, -1e-3) == 0.0
    np.testing.assert_allclose(press(PowerLaw(stiffness_force=80.0), 2e6, 4e-3), 80 * 0.4**1.5, rtol=1e-13)


def test_squeezed_flat_stays_finite():
    """A ball squeezed to nothing has a finite pressure, and none without gas."""
    assert np.isfinite(press(Ball(), 1e6, 0.09)) and press(Ball(), 0.0, 0.09) == 0.0


def test_damping_number_is_exact():
    """There and back to 1e-10, and the closed form itself vanishes."""
    kappa = damping_number(GRID)
    assert np.abs(delivered_restitution(kappa) - GRID).max() < 1e-10
    ordinary = GRID > 0.1  # below, 1 - kappa e is lost in rounding
    assert np.abs(restitution_balance(kappa, GRID))[ordinary].max() < 1e-12
    assert np.all(np.diff(kappa[:200]) < 0)


@pytest.mark.slow
def test_damping_number_derivative():
    """The implicit derivative agrees with central differences of the solution, in both modes."""
    e = np.linspace(0.05, 0.995, 40)
    h = 1e-5
    differences = (damping_number(e + h * (1 - e)) - damping_number(e - h * (1 - e))) / (2 * h * (1 - e))
    forward = jax.jvp(damping_number, (e,), (np.ones_like(e),))[1]
    reverse = jax.vmap(jax.grad(damping_number))(e)
    np.testing.assert_allclose(forward, differences, rtol=1e-6)
    np.testing.assert_array_equal(forward, reverse)


@pytest.mark.slow
def test_damping_number_limits():
    """Nothing at e = 1, with slope -3/2 there; kappa e -> 1 as e -> 0; beyond 1 read as 1; NaN stays NaN."""
    assert float(damping_number(1.0)) == 0.0 and float(damping_number(1.3)) == 0.0
    np.testing.assert_allclose(jax.grad(damping_number)(1.0), -1.5, rtol=1e-9)
    np.testing.assert_allclose(damping_number(1 - 1e-6), 1.5e-6, rtol=1e-5)
    np.testing.assert_allclose(damping_number(2e-3) * 2e-3, 1.0, atol=1e-12)
    assert np.isfinite(jax.grad(damping_number)(0.02)) and np.isnan(damping_number(np.nan))
    assert float(delivered_restitution(0.0)) == 1.0


def test_eq6_delivers_another_restitution():
    """Asked for 0.8, Eq. 6 delivers 0.847; asked for 0.5, 0.725; near 1 it is right."""
    delivered = delivered_restitution(printed_damping(np.array([0.8, 0.5, 0.999]), 1.0))
    assert [round(float(e), 3) for e in delivered[:2]] == [0.847, 0.725]
    np.testing.assert_allclose(delivered[2], 0.999, atol=1e-5)


@pytest.mark.parametrize("count", [1, BLOCK, BLOCK + 1, 5 * BLOCK - 3])
@pytest.mark.parametrize("padded", [0, 3 * BLOCK])
def test_samples_in_blocks_are_samples(count, padded):
    """Blocks, and blocks of samples that are all alike, give what the function gives of each, and its slopes."""
    x = jnp.linspace(0.0, 2.0, count)
    x = jnp.concatenate([x, jnp.full(padded, x[-1])])

    def compute(shift, how):
        return how(lambda a: (jnp.sin(3.0 * a[0]) * a[1], a[0] ** 2 + shift), (x - shift, jnp.exp(x) * shift))

    for derive in (lambda f: f, jax.jacfwd):
        found, exact = (derive(lambda s, how=how: compute(s, how))(0.3) for how in (
            map_samples, lambda f, a: jax.vmap(f)(a)))
        for a, b in zip(found, exact, strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-13, atol=1e-13)


def test_helpers_keep_nan_and_slopes():
    """max(x, 0) and its kin pass NaN on, and have finite slopes at zero."""
    for function in (positive_part, safe_sqrt, lambda x: safe_power(x, 0.5)):
        assert np.isnan(function(np.nan)) and float(function(-1.0)) == 0.0 and float(function(4.0)) > 1.9
        assert float(jax.grad(function)(0.0)) == 0.0 and float(jax.grad(function)(-1.0)) == 0.0
    np.testing.assert_allclose(jax.grad(safe_power, argnums=1)(2.0, 1.5), 2**1.5 * np.log(2), rtol=1e-13)
