"""A sensor's filters, of first and second order, and its friction, against analytic responses and an integrator's."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from ddetumble.contact.signal import (
    Signal,
    follow_friction,
    lag,
    lag_deficits,
    low_pass,
    resonance_weights,
    resonate,
    response_weights,
)


NODES = np.concatenate([[0.0, 1e-6], np.linspace(0.001, 0.05, 40), np.linspace(0.06, 0.3, 9)])
MIDDLES = 0.5 * (NODES[1:] + NODES[:-1])
CONSTANTS = np.array([1e-7, 1e-5, 1e-3, 1e-2, 0.1, 1.0, 1e3])


def sample(function):
    """A signal through the values of a function at the nodes and half-way."""
    values, middles = function(NODES), function(MIDDLES)
    return Signal(*map(jnp.asarray, (np.diff(NODES), values[:-1], middles, values[1:])))


def respond_polynomial(t, constant):
    """Response of T y' = x - y, y(0) = 0 to x = 2 - 30 t + 400 t^2, at times t; shape of t."""
    a, b, c = 2.0, -30.0, 400.0
    x, slope, curve = a + b * t + c * t**2, b + 2 * c * t, 2 * c
    return x - constant * slope + constant**2 * curve - (a - constant * b + constant**2 * curve) * np.exp(-t / constant)


@pytest.mark.slow
@pytest.mark.parametrize("constant", CONSTANTS)
@pytest.mark.parametrize("name", ["lag", "low_pass"])
def test_polynomial_is_exact(name, constant):
    """A parabola comes out exactly, whatever the interval over the time constant."""
    signal = sample(lambda t: 2.0 - 30.0 * t + 400.0 * t**2)
    out = lag(signal, constant) if name == "lag" else low_pass(signal, 1.0 / constant)
    if constant > 1:  # the analytic form cancels
        np.testing.assert_allclose(out.end, (2 * NODES - 15 * NODES**2 + 400 / 3 * NODES**3)[1:] / constant, rtol=1e-3)
        return
    atol = 1e-10 * max(1.0, constant**2)
    np.testing.assert_allclose(out.end, respond_polynomial(NODES[1:], constant), atol=atol * 100)
    np.testing.assert_allclose(out.middle, respond_polynomial(MIDDLES, constant), atol=atol * 100)


@pytest.mark.parametrize("constant", [1e-3, 1e-2, 0.3])
def test_exponential(constant):
    """exp(-t/s) comes out to the accuracy of its parabolas, (h/s)^4."""
    s = 0.13
    expected = s / (s - constant) * (np.exp(-NODES[1:] / s) - np.exp(-NODES[1:] / constant))
    signal = sample(lambda t: np.exp(-t / s))
    for out in (lag(signal, constant), low_pass(signal, 1 / constant)):
        np.testing.assert_allclose(out.end, expected, atol=2e-4)


def test_absent_exactly_at_null():
    """No lag and no leak change not one bit; an empty interval keeps what was."""
    signal = sample(lambda t: np.sin(40 * t))
    for part in ("start", "middle", "end"):
        np.testing.assert_array_equal(getattr(lag(signal, 0.0), part), getattr(signal, part))
        assert not np.any(getattr(low_pass(signal, 0.0), part))
    empty = Signal(*(jnp.asarray(x) for x in ([0.1, 0.0, 0.1], [1.0, 1.0, 1.0], [1.0, 1.0, 1.0], [1.0, 1.0, 1.0])))
    out = lag(empty, 0.1)
    assert float(out.end[1]) == float(out.end[0]) == float(out.start[2]) and np.isfinite(out.end).all()


def test_small_constants():
    """To first order lag(x) = x - T x' and low_pass(x) = r * integral of x."""
    signal = sample(lambda t: np.sin(30 * t))
    slope = jax.jvp(lambda T: lag(signal, T).end, (0.0,), (1.0,))[1]
    np.testing.assert_allclose(slope[1:], -30 * np.cos(30 * NODES[2:]), atol=2.5)  # slopes of the end of a parabola
    slope = jax.jvp(lambda r: low_pass(signal, r).end, (0.0,), (1.0,))[1]
    np.testing.assert_allclose(slope, (1 - np.cos(30 * NODES[1:])) / 30, atol=1e-5)


@pytest.mark.parametrize("function, points", [
    (response_weights, [0.0, 1e-9, 1e-3, 0.3, 0.699, 0.701, 2.0, 30.0, 800.0]),
    (lag_deficits, [0.0, 1e-4, 1e-2, 0.3, 1.0, 1.39, 1.41, 5.0, 1e4]),
])
def test_weights_derive_smoothly(function, points):
    """Slopes agree with differences on both sides of every change of formula, and are finite at zero."""
    for x in points:
        h = 1e-5 * max(x, 1e-4)
        base = max(x, h)
        exact = jax.jvp(function, (base,), (1.0,))[1]
        at_zero = jax.jvp(function, (x,), (1.0,))[1]
        for one, two, three, four in zip(exact, function(base + h), function(base - h), at_zero, strict=True):
            assert np.isfinite(four)
            np.testing.assert_allclose(one, (two - three) / (2 * h), rtol=1e-5, atol=2e-6)


def follow(function, frequency, damping, times):
    """Reading of a mass on a damped spring from rest, by SciPy."""
    turn = 2.0 * np.pi * frequency
    solution = solve_ivp(lambda t, y: [turn * y[1], turn * (function(t) - y[0] - 2.0 * damping * y[1])],
                         (0.0, NODES[-1]), [0.0, 0.0], method="DOP853", rtol=1e-11, atol=1e-11, t_eval=times)
    return solution.y[0]


@pytest.mark.slow
@pytest.mark.parametrize("damping", [0.003, 0.06, 0.7, 0.9999, 1.0, 1.5, 10.0])
@pytest.mark.parametrize("frequency", [0.01, 2.0, 13.0, 130.0])
def test_resonance_of_polynomials_is_exact(frequency, damping):
    """Step, ramp and parabola come out exactly, whether the gauge rings or creeps, in intervals short or long."""
    for function in (lambda t: 2.0 + 0.0 * t, lambda t: -30.0 * t, lambda t: 2.0 - 30.0 * t + 400.0 * t**2):
        out = resonate(sample(function), 1.0 / frequency, damping)
        np.testing.assert_allclose(out.end, follow(function, frequency, damping, NODES[1:]), rtol=0, atol=1e-8)
        np.testing.assert_allclose(out.middle, follow(function, frequency, damping, MIDDLES), rtol=0, atol=1e-8)


def test_no_resonance_at_null():
    """At 1/f_0 = 0 not one bit changes; an empty interval keeps what was."""
    signal = sample(lambda t: np.sin(40 * t))
    for inverse in (0.0, -1e-6):
        for part in ("start", "middle", "end"):
            np.testing.assert_array_equal(getattr(resonate(signal, inverse, 0.05), part), getattr(signal, part))
    empty = Signal(*(jnp.asarray(x) for x in ([0.1, 0.0, 0.1], [1.0, 1.0, 1.0], [1.0, 1.0, 1.0], [1.0, 1.0, 1.0])))
    out = resonate(empty, 0.1, 0.05)
    assert float(out.end[1]) == float(out.end[0]) == float(out.start[2]) and np.isfinite(out.end).all()


def test_resonance_approaches_its_null():
    """x - 2 zeta x'/w_0 to first order of 1/w_0, once the start has rung out; the slope at 1/f_0 = 0 is the same."""
    signal, slope, damping = sample(lambda t: 3.0 - 30.0 * t + 400.0 * t**2), -30.0 + 800.0 * NODES[3:], 0.3
    found = jax.jvp(lambda inverse: resonate(signal, inverse, damping).end, (0.0,), (1.0,))[1]
    np.testing.assert_allclose(found[2:], -damping / np.pi * slope, rtol=1e-9, atol=1e-9)
    left = []
    for inverse in (1e-4, 5e-5):
        deviation = resonate(signal, inverse, damping).end[2:] - signal.end[2:]
        left.append(np.abs(deviation + damping / np.pi * inverse * slope).max())
    assert left[0] / left[1] == pytest.approx(4.0, rel=0.01)  # second order


@pytest.mark.parametrize("inverse", [0.0, 1e-300, 1e-12, 1e-7, 1e-3, 1.0, 1e9])
@pytest.mark.parametrize("damping", [1e-3, 0.05, 1.0, 4.0])
def test_resonance_is_finite(inverse, damping):
    signal = sample(lambda t: np.sin(30 * t))
    for direction in ((1.0, 0.0), (0.0, 1.0)):
        value, slope = jax.jvp(lambda p, z: resonate(signal, p, z).end, (inverse, damping), direction)
        assert np.isfinite(value).all() and np.isfinite(slope).all()


@pytest.mark.parametrize("damping", [0.003, 0.05, 0.5, 0.999, 1.001, 3.0])
@pytest.mark.parametrize("ratio", [1e-3, 0.03, 0.3, 1.9, 1.999, 2.001, 2.1, 5.0, 6.1, 1e4])
def test_resonance_weights_derive_smoothly(ratio, damping):
    """Slopes agree with differences, on both sides of every change of formula too."""
    place = (jnp.asarray(ratio), jnp.asarray(damping))
    for k in range(2):
        step = [0.0, 0.0]
        step[k] = 1e-6 * float(place[k])
        found = jax.jvp(resonance_weights, place, tuple(jnp.asarray(float(i == k)) for i in range(2)))[1]
        above, below = (resonance_weights(place[0] + way * step[0], place[1] + way * step[1]) for way in (1.0, -1.0))
        for one, two, three in zip(found, above, below, strict=True):
            np.testing.assert_allclose(one, (two - three) / (2 * step[k]), rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("width", [0.3, 4.0, 50.0])
@pytest.mark.parametrize("pace", [1.0, 1e3])
def test_friction_depends_on_the_way_and_not_on_the_pace(width, pace):
    """A jump to 4 N, up to 10 N and back within one interval: Dahl's law, branch by branch."""
    share = np.array([0.0, 0.2, 0.4, 0.63, 0.8, 1.0])  # the turn, at a half, is neither a node nor a middle
    course = lambda u: 10.0 - 24.0 * (u - 0.5) ** 2
    middle = 0.5 * (share[1:] + share[:-1])
    force = Signal(*map(jnp.asarray, (np.diff(share) / pace, course(share[:-1]), course(middle), course(share[1:]))))
    found = follow_friction(force, width)
    highest = -np.expm1(-10.0 / width)

    def expect(u):
        rising, falling = -np.expm1(-course(u) / width), (1.0 + highest) * np.exp((course(u) - 10.0) / width) - 1.0
        return np.where(u < 0.5, rising, falling)

    for part, places in ((found.start, share[:-1]), (found.middle, middle), (found.end, share[1:])):
        np.testing.assert_allclose(part, expect(places), atol=1e-12)
