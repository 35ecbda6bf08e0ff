"""The paper's stage in free rotation: numbers of the page against SciPy, and theorems that its sentences rest on."""

import json
import re

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from ddetumble._rotation import measure_turn
from ddetumble.dynamics import measure_nutation, propagate_torque_free, simulate_tumbling
from ddetumble.paper.tumbling import (
    UNTURNED,
    follow_stage,
    limit_nutation,
    measure_angle,
    read_momentum,
    time_nutation,
    vary_moments,
)


BEFORE = np.array([24.764, -41.782, 54.270])  # Table 5, N m s
AFTER = np.array([9.137, -15.407, 19.954])
SIZE = np.linalg.norm(BEFORE)
TIMES = 0.2 * np.arange(10001)  # the paper's steps


@pytest.fixture(scope="module")
def page():
    from ddetumble.paper.tumbling import write_tumbling

    return write_tumbling()


def integrate(moments, momentum, times):
    """Body momentum and the path of A by SciPy: Poisson's equation for the base axes in body components."""
    def field(_, y):
        rate = y[:3] / moments
        return np.concatenate([np.cross(y[:3], rate), *(np.cross(axis, rate) for axis in y[3:].reshape(3, 3))])

    found = solve_ivp(field, (0.0, times[-1]), [*momentum, *np.eye(3).ravel()], "DOP853", times, rtol=1e-12, atol=1e-12)
    axes = found.y[3:].T.reshape(-1, 3, 3)  # of time, base axis, body component
    return found.y[:3].T, 1.5 * axes[:, :, 2]


def test_tables():
    """Printed totals, and one direction before and after."""
    for name, before, after, turn in (("table-5", 72.829, 26.815, 0.09), ("table-6", 72.829, 52.834, 0.05)):
        table = read_momentum(name)
        assert np.linalg.norm(table.before) == pytest.approx(before, abs=2e-3)
        assert np.linalg.norm(table.after) == pytest.approx(after, abs=2e-3)
        assert np.degrees(table.turn) < turn
    assert np.allclose(read_momentum("table-5").before, BEFORE) and np.allclose(read_momentum("table-5").after, AFTER)
    assert measure_angle(np.array([1.0, 0, 0]), np.array([1.0, 1e-9, 0])) == pytest.approx(1e-9, rel=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("asymmetry", [0.0, 0.1])
def test_course_by_scipy(asymmetry):
    """Nutation, precession and path of closed form and integrator are those of another formulation in SciPy."""
    moments = np.array([1000.0 * (1 + asymmetry), 1000.0 * (1 - asymmetry), 500.0])
    assert np.allclose(vary_moments(asymmetry), moments)
    course = follow_stage(BEFORE, moments, TIMES)
    momentum, path = integrate(moments, BEFORE, TIMES)
    assert np.allclose(course.path, path, atol=1e-8)
    assert np.allclose(course.angles[:, 1], np.arccos(momentum[:, 2] / SIZE), atol=1e-8)
    assert np.allclose(course.tilt, np.arccos(np.clip(path[:, 2] / 1.5, -1, 1)), atol=1e-4)
    slope = np.gradient(course.angles[:, 0], TIMES, edge_order=2)
    assert np.allclose(course.precession_rate, slope, rtol=1e-4)
    motion = simulate_tumbling(moments, UNTURNED, BEFORE / moments, TIMES)
    assert np.max(measure_turn(motion.attitude, course.motion.attitude)) < 1e-10


def test_euler_sequence():
    """Precession about Y_L, nutation about the line of nodes, spin about body z, composed by SciPy from the angles."""
    course = follow_stage(BEFORE, vary_moments(0.1), TIMES)
    y = BEFORE / SIZE
    x = np.cross(y, [0, 0, 1.0])
    x /= np.linalg.norm(x)
    frame = np.stack([np.cross(x, y), x, y], axis=-1)  # Z_L, X_L, Y_L, about the last of which precession turns
    for angles, attitude in zip(course.angles[::400], np.asarray(course.motion.attitude)[::400], strict=True):
        turned = frame @ Rotation.from_euler("ZXZ", angles).as_matrix()
        assert np.allclose(turned, Rotation.from_quat(attitude, scalar_first=True).as_matrix(), atol=1e-12)


@pytest.mark.parametrize("asymmetry", [0.02, 0.1, 0.2])
def test_range_and_period(asymmetry):
    """Closed forms of smallest and largest nutation and of its period against a motion that SciPy integrates."""
    moments = vary_moments(asymmetry)
    period = time_nutation(BEFORE, moments)
    momentum, _ = integrate(moments, BEFORE, np.linspace(0.0, 2.0 * period, 4001))
    angle = np.arccos(momentum[:, 2] / SIZE)
    assert np.allclose(angle[:2001], angle[2000:], atol=1e-9) and abs(angle[1000] - angle[0]) > 1e-3
    assert limit_nutation(BEFORE, moments) == pytest.approx((angle.min(), angle.max()), abs=1e-5)
    assert time_nutation(BEFORE, vary_moments(1e-9)) == pytest.approx(np.pi / (0.5 * BEFORE[2] / 500.0), rel=1e-6)


class Brake(eqx.Module):
    """Torque along the momentum, -L/T."""

    moments: Array
    time: Array

    def __call__(self, time, attitude, rate):
        return -self.moments * rate / self.time


@pytest.mark.parametrize("asymmetry", [0.0, 0.2])
def test_torque_along_the_momentum_keeps_the_attitudes(asymmetry):
    """L exp(-t/T) at a time t is the free motion at T (1 - exp(-t/T)): the same attitudes later, and nutations."""
    moments = vary_moments(asymmetry)
    brake, rate = Brake(jnp.asarray(moments), jnp.asarray(600.0)), BEFORE / moments
    braked = simulate_tumbling(moments, UNTURNED, rate, TIMES, brake)
    free = propagate_torque_free(moments, UNTURNED, rate, -600.0 * np.expm1(-TIMES / 600.0))
    assert np.max(measure_turn(braked.attitude, free.attitude)) < 1e-9
    first, second = (measure_nutation(brake.moments, motion.angular_velocity) for motion in (braked, free))
    assert np.allclose(first, second, rtol=0.0, atol=1e-9)


def test_numbers_of_the_page(page):
    """Against arithmetic by hand; closed form and integrator agree at every step of the paper's simulation."""
    _, found = page
    nutation = np.arccos(BEFORE[2] / SIZE)
    assert found["moments"] == pytest.approx([1000.0, 1000.0, 500.0])
    assert found["nutation"] == pytest.approx(np.degrees(nutation)) and found["nutation_change"] < 1e-10
    assert found["precession_rate"] == pytest.approx(SIZE / 1000.0)
    assert found["spin_rate"] == pytest.approx(0.5 * BEFORE[2] / 500.0)
    assert found["precessions"] == pytest.approx(SIZE / 1000.0 * 2000.0 / (2 * np.pi))
    assert found["circle"]["radius"] == pytest.approx(1.5 * np.sin(nutation))
    assert found["circle"]["height"] == pytest.approx(1.5 * np.cos(nutation))
    assert found["tilt"] == pytest.approx([0.0, 2 * np.degrees(nutation)], abs=1e-3)
    assert found["cases"]["after Table 5"]["share"] == pytest.approx(np.linalg.norm(AFTER) / SIZE)
    assert found["cases"]["after Table 5"]["precession_period"] == pytest.approx(2e3 * np.pi / np.linalg.norm(AFTER))
    assert 0 < found["integration"]["attitude"] < 1e-9 and 0 < found["integration"]["rate"] < 1e-9
    assert [row["period"] is None for row in found["asymmetry"]] == [True, False, False, False, False]
    json.dumps(found, allow_nan=False)


def test_page_says_what_is_open(page, tmp_path):
    from ddetumble.reports.page import write_page

    section, found = page
    text = re.sub(r"\s+", " ", write_page("t", found["sentence"], [section], tmp_path).read_text(encoding="utf-8"))
    for words in ("What agrees with the paper", "What does not follow", "What the paper leaves open",
                  "the order of the Euler angles", "What would decide"):
        assert words in text
    names = {picture.stem for picture in (tmp_path / "figures").glob("*.png")}
    assert names == {"figure-16", "figure-17", "figure-20-nutation"}
