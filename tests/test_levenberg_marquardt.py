"""The optimiser beside SciPy's, on a problem of the shape that records have."""

import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest
from scipy.optimize import least_squares

from ddetumble.inference.levenberg_marquardt import BorderedLevenbergMarquardt
from ddetumble.inference.problem import Solution


TIME = np.linspace(0.0, 1.0, 30)
RECORDS = 7


def predict(theta, z, xp):
    """Damped waves, shape (records, times), whose phase and amplitude belong to the record."""
    time = TIME[None, :] * (1.0 + 0.02 * z[:, :1])
    return (1.0 + 0.05 * z[:, 1:]) * xp.exp(-theta[0] * time) * xp.sin(theta[1] * time)


def test_minimum_is_that_of_scipy():
    rng = np.random.default_rng(5)
    measured = predict(np.array([1.3, 7.0]), rng.normal(size=(RECORDS, 2)), np)
    measured = measured + 0.01 * rng.normal(size=measured.shape)

    def fn(y, args):
        return ((predict(*y, jnp) - measured) / 0.01, y[1], 0.0 * y[0]), None

    def flat(x):
        theta, z = x[:2], x[2:].reshape(RECORDS, 2)
        return np.concatenate([np.ravel(predict(theta, z, np) - measured) / 0.01, np.ravel(z)])

    start = (jnp.asarray([0.8, 6.0]), jnp.zeros((RECORDS, 2)))
    solver = BorderedLevenbergMarquardt(jnp.asarray(1e-10), jnp.asarray(40))
    found = optx.least_squares(fn, solver, start, has_aux=True, throw=False)
    expected = least_squares(flat, np.concatenate([[0.8, 6.0], np.zeros(2 * RECORDS)]), xtol=1e-15, ftol=1e-15,
                             gtol=1e-12)  # fmt: skip
    assert found.result == optx.RESULTS.successful
    np.testing.assert_allclose(found.value[0], expected.x[:2], rtol=1e-6)
    np.testing.assert_allclose(np.ravel(found.value[1]), expected.x[2:], atol=1e-4)
    theta, z = found.value
    assert np.sum(flat(np.concatenate([theta, np.ravel(z)])) ** 2) <= 2.0 * expected.cost * (1 + 1e-9)


def test_a_parameter_without_effect_does_no_harm():
    def fn(y, args):
        return (y[1] - 2.0 + y[0][0], y[1], jnp.zeros(2) * y[0]), None

    start = (jnp.asarray([5.0, 3.0]), jnp.zeros((4, 1)))
    solver = BorderedLevenbergMarquardt(jnp.asarray(1e-12), jnp.asarray(60))
    found = optx.least_squares(fn, solver, start, has_aux=True, throw=False)
    assert np.all(np.isfinite(found.value[0])) and np.all(np.isfinite(found.value[1]))
    np.testing.assert_allclose(found.value[0][0], 2.0, atol=1e-5)


@pytest.mark.parametrize("asleep", [1e-5, 1e-8, 1e-12])
def test_a_parameter_that_is_asleep_holds_nobody_up(asleep):
    """Its column points where the residual is, and is so short that its own step would leave all bounds."""
    slope = np.linspace(1.0, 2.0, 20)

    def fn(y, args):
        dead = (asleep * y[0][1] + 0.1 * y[0][1] ** 2) * jnp.where(jnp.arange(20) == 0, 1.0, 0.0)
        first = jnp.where(jnp.arange(20) == 0, 40.0, 0.0)
        return ((slope * (y[0][0] - 3.0) * 10.0 + dead + first)[None], y[1], 0.0 * y[0]), None

    solver = BorderedLevenbergMarquardt(jnp.asarray(1e-6), jnp.asarray(30))
    found = optx.least_squares(fn, solver, (jnp.zeros(2), jnp.zeros((1, 1))), has_aux=True, throw=False)
    expected = 3.0 - 40.0 * slope[0] / (10.0 * np.sum(slope**2))
    np.testing.assert_allclose(found.value[0][0], expected, atol=2e-3)


@pytest.mark.parametrize("most", [1, 3])
def test_gives_up_after_the_stated_number_of_trials(most):
    """Rosenbrock's valley takes more than three trials; a fit cut off there does not count as converged."""

    def fn(y, args):
        x, r = y[0][0], y[0][1]
        return (jnp.stack([1.0 - x, 10.0 * (r - x * x)])[None], y[1], 0.0 * y[0]), None

    solver = BorderedLevenbergMarquardt(jnp.asarray(1e-12), jnp.asarray(most))
    start = (jnp.asarray([-1.2, 1.0]), jnp.zeros((1, 1)))
    found = optx.least_squares(fn, solver, start, has_aux=True, throw=False)
    assert found.stats["num_steps"] == most and not solver.has_converged(found.state)
    longer = BorderedLevenbergMarquardt(jnp.asarray(1e-12), jnp.asarray(100))
    found = optx.least_squares(fn, longer, start, has_aux=True, throw=False)
    assert longer.has_converged(found.state)
    np.testing.assert_allclose(found.value[0], 1.0, rtol=1e-5)


@pytest.mark.parametrize("place", [0.75, 0.85, 0.9])
def test_small_steps_in_front_of_a_jump_come_to_an_end(place):
    """The sum of squares rises by 2,000 of 1e8 before its minimum at 1: ever shorter steps still pass, and gain nothing
    of what is expected."""

    def fn(y, args):
        x = y[0][0]
        return (jnp.stack([1e4 + jnp.where(x > place, 0.1, 0.0), 10.0 * (x - 1.0)])[None], y[1], 0.0 * y[0]), None

    solver = BorderedLevenbergMarquardt(jnp.asarray(1e-7), jnp.asarray(60))
    found = optx.least_squares(fn, solver, (jnp.zeros(1), jnp.zeros((1, 1))), has_aux=True, throw=False)
    assert solver.has_converged(found.state)
    np.testing.assert_allclose(found.value[0], place, atol=0.03)


def test_a_promise_that_no_step_keeps_comes_to_an_end():
    """At the kink of 10 + |x| the undamped step promises all of the sum of squares, on either side: no step gives
    any, and the fit is not taken for one that converged."""

    def fn(y, args):
        return ((10.0 + jnp.abs(y[0]))[None], y[1], 0.0 * y[0]), None

    solver = BorderedLevenbergMarquardt(jnp.asarray(1e-7), jnp.asarray(1000))
    found = optx.least_squares(fn, solver, (jnp.ones(1), jnp.zeros((1, 1))), has_aux=True, throw=False, max_steps=2000)
    assert not solver.has_converged(found.state)
    assert found.stats["num_steps"] < 200
    np.testing.assert_allclose(found.value[0], 0.0, atol=1e-4)


def make_solution(shared):
    """A fit of which only the derivatives by its parameters matter; one nuisance, which nothing depends on."""
    records, rows, count = shared.shape
    nothing, none = np.zeros((records, rows)), np.zeros((records, 1))
    return Solution(tuple("abc"[:count]), np.zeros(count), none, np.full(count, 2.0), nothing, shared,
                    np.zeros((records, rows, 1)), nothing, nothing, nothing, none, np.zeros(count), np.zeros(count),
                    0.0, True, 1, ())


def test_what_nothing_fixes_has_no_small_variance():
    """Two parameters with the same derivative: their sum is known as least squares has it, neither of them is."""
    column = np.random.default_rng(0).normal(size=(3, 20, 1))
    known = make_solution(column).covariance()
    assert known[0, 0] == pytest.approx(4.0 / np.sum(column**2))
    twice = make_solution(np.concatenate([column, column], axis=2)).covariance()
    assert np.array([1.0, 1.0]) @ twice @ np.array([1.0, 1.0]) == pytest.approx(known[0, 0], rel=1e-2)
    assert np.all(np.diag(twice) > 1e8 * known[0, 0])
    silent = make_solution(np.concatenate([column, 0.0 * column], axis=2)).covariance()
    assert silent[0, 0] == pytest.approx(known[0, 0]) and silent[1, 1] > 1e8 * known[0, 0]
