"""Tumbling records: the law, its effects against closed forms and the independent simulator, the contract."""

import textwrap
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ddetumble import check_effect
from ddetumble._rotation import rotate
from ddetumble.contact import torque
from ddetumble.dynamics import propagate_torque_free, simulate_tumbling
from ddetumble.effects import TUMBLE, AxisMisalignment, QuadraticDrag, catalogue
from ddetumble.effects.directions import TUMBLE_DIRECTIONS
from ddetumble.exam.simulators.tumbling import simulate_tumbling as simulate_second
from ddetumble.inference.archive import resolve_model
from ddetumble.inference.assembly import default_starts
from tests.helpers_tumble import RATES, make_law, move


TIMES = np.arange(0.0, 601.0, 2.0)
SMALL = {
    "eddy-current": {"k_e": 1e-6, "axial": 0.6}, "constant-torque": {"torque": [2e-7, -1e-7, 5e-8]},
    "quadratic-drag": {"k": 1e-5, "axial": 1.7}, "inertia-asymmetry": {"epsilon": 1e-3},
    "axis-misalignment": {"angle": 1e-3, "angle_x": -2e-3, "angle_z": 5e-4},
    "internal-damper": {"c": 8e-6, "I_d": 0.03}, "gravity-gradient": {"scale": 1.0},
    "gyro-bias": {"bias": [6e-5, -4e-5, 5e-5]},
}  # fmt: skip
LARGE = {
    "eddy-current": {"k_e": 3e-5, "axial": 0.6}, "constant-torque": {"torque": [6e-6, -3e-6, 1.5e-6]},
    "quadratic-drag": {"k": 3e-4, "axial": 1.7}, "inertia-asymmetry": {"epsilon": 0.03},
    "axis-misalignment": {"angle": 0.03, "angle_x": -0.06, "angle_z": 0.015},
    "internal-damper": {"c": 2.4e-4, "I_d": 0.03}, "gravity-gradient": {"scale": 30.0},
    "gyro-bias": {"bias": [1.8e-3, -1.2e-3, 1.5e-3]},
}  # fmt: skip


def test_catalogue():
    """The nine effects by name, their stages, and the two names of the reference model."""
    assert [e.id for e in catalogue("tumble")] == [
        "eddy-current", "quadratic-drag", "constant-torque", "inertia-asymmetry", "axis-misalignment",
        "internal-damper", "gravity-gradient", "gyro-bias", "gyro-scale",
    ]  # fmt: skip
    assert {e.stage for e in TUMBLE} == {"inertia", "torque", "gyroscope"}
    assert type(resolve_model("paper", "tumble").reference) is type(resolve_model("rigid-body", "tumble").reference)


@pytest.mark.slow
@pytest.mark.parametrize("effect", [*TUMBLE, *TUMBLE_DIRECTIONS], ids=lambda effect: effect.id)
def test_contract(effect):
    """Every effect and probe: absent at its null, alive, compiled = eager."""
    report = check_effect(effect)
    assert report.ok, str(report)


def test_torque_of_ones_own():
    """The example in the documentation keeps the contract, and moves the axial rate as its integral says."""
    text = torque.__doc__ or ""
    source = textwrap.dedent(text[text.index("    class Jet"): text.index("`check_effect(Jet)`")])
    assert len(source.strip().splitlines()) <= 10
    scope = {"__name__": "jet"}
    exec("from typing import ClassVar\nimport jax.numpy as jnp\nfrom ddetumble.contact.torque import *\n"
         "from ddetumble.contact.effect import Scalar, parameter\n" + source, scope)
    assert check_effect(scope["Jet"]).ok
    law = torque.RigidBody(inertia_ratio=jnp.asarray(0.5)).extend((scope["Jet"](push=1e-6, tau=100.0),))
    gained = 2.0 * 1e-6 * 100.0 * (1.0 - np.exp(-TIMES / 100.0))
    assert np.abs(move(law, TIMES).angular_velocity[:, 2] - RATES[2] - gained).max() < 1e-12


@pytest.mark.slow
@pytest.mark.parametrize("ratio", [0.3, 1.0, 1.7])
def test_nulls_leave_torque_free_motion(ratio):
    """With every effect at its null: the closed form, rates and attitude."""
    found = move(make_law(ratio, {}), TIMES)
    free = propagate_torque_free([1.0, 1.0, ratio], [1.0, 0.0, 0.0, 0.0], RATES, TIMES)
    assert np.abs(found.angular_velocity - free.angular_velocity).max() < 2e-8
    assert np.abs(found.attitude - free.attitude).max() < 1e-6 and not found.failed


def test_eddy_currents_on_a_sphere():
    """All rates decay as exp(-k t); on any body of revolution the axial rate as exp(-k t / r)."""
    decay = np.exp(-1e-3 * TIMES)[:, None]
    found = move(make_law(1.0, {"eddy-current": {"k_e": 1e-3}}), TIMES)
    assert np.abs(found.angular_velocity - decay * RATES).max() < 1e-10
    found = move(make_law(0.4, {"eddy-current": {"k_e": 1e-3}}), TIMES)
    assert np.abs(found.angular_velocity[:, 2] - decay[:, 0] ** 2.5 * RATES[2]).max() < 1e-9


def test_eddy_currents_by_axis():
    """The axial rate decays as exp(-axial k t / r), whatever the others do."""
    found = move(make_law(0.4, {"eddy-current": {"k_e": 1e-3, "axial": 0.5}}), TIMES)
    assert np.abs(found.angular_velocity[:, 2] - np.exp(-1e-3 * 0.5 / 0.4 * TIMES) * RATES[2]).max() < 1e-9


@pytest.mark.parametrize(("start", "axial", "inertia"), [
    ([0.1, 0.0, 0.0], 1.7, 1.0), ([0.0, 0.0, -0.1], 1.7, 0.6), ([0.06, -0.0, 0.08], 1.0, 1.0)],
    ids=["across", "axial", "sphere"])  # fmt: skip
def test_quadratic_drag_on_pure_spin(start, axial, inertia):
    """About an axis that does not turn, the rate falls as 1/(1 + k c w0 t / I), c the coefficient about that axis."""
    ratio = 0.6 if axial != 1.0 else 1.0
    coefficient, k = (axial if start[2] and not start[0] else 1.0), 0.02
    found = move(make_law(ratio, {"quadratic-drag": {"k": k, "axial": axial}}), TIMES, start)
    rate = np.linalg.norm(start)
    wanted = np.outer(1.0 / (1.0 + k * coefficient / inertia * rate * TIMES), start)
    assert np.abs(found.angular_velocity - wanted).max() < 1e-8
    assert np.linalg.norm(wanted[-1]) < 0.6 * rate


def test_quadratic_drag_takes_energy():
    """The energy falls by k |w| (w_x^2 + w_y^2 + axial w_z^2) a second, and the law scales: twice as fast is the same
    motion in half the time; a body at rest stays at rest, with finite slopes."""
    ratio, drag = 0.6, {"k": 5e-3, "axial": 0.4}
    found = move(make_law(ratio, {"quadratic-drag": drag}, 0.0), TIMES).angular_velocity
    energy = 0.5 * np.sum(found**2 * np.array([1.0, 1.0, ratio]), axis=1)
    power = drag["k"] * np.linalg.norm(found, axis=1) * np.sum(found**2 * np.array([1.0, 1.0, drag["axial"]]), axis=1)
    lost = np.concatenate([[0.0], np.cumsum(0.5 * (power[1:] + power[:-1]) * np.diff(TIMES))])
    assert np.all(np.diff(energy) < 0)
    assert np.abs(energy[0] - energy - lost).max() < 1e-3 * lost[-1]
    fast = move(make_law(ratio, {"quadratic-drag": drag}, 0.0), TIMES / 2.0, [2.0 * w for w in RATES])
    assert np.abs(fast.angular_velocity - 2.0 * found).max() < 1e-7

    def push(k):
        spin = torque.Spin(jnp.zeros(()), jnp.zeros(3), jnp.eye(4)[0], jnp.eye(3)[0], jnp.ones(3), jnp.zeros(()), {},
                           jnp.zeros(3))
        return QuadraticDrag(k=k, axial=jnp.asarray(0.5)).torque(spin)

    assert not push(1.0).any() and np.isfinite(jax.jacfwd(push)(1.0)).all()


def test_constant_torque_on_a_sphere():
    """All rates grow linearly."""
    push = np.array([2e-6, -3e-6, 1e-6])
    found = move(make_law(1.0, {"constant-torque": {"torque": push}}), TIMES)
    assert np.abs(found.angular_velocity - (RATES + TIMES[:, None] * push)).max() < 1e-12


def test_inertia_asymmetry_is_another_body():
    """Moments 1 + epsilon, 1 - epsilon, r: the closed form of three different moments."""
    found = move(make_law(0.6, {"inertia-asymmetry": {"epsilon": 0.05}}), TIMES)
    free = propagate_torque_free([1.05, 0.95, 0.6], [1.0, 0.0, 0.0, 0.0], RATES, TIMES)
    assert np.abs(found.angular_velocity - free.angular_velocity).max() < 2e-8


def test_gyroscopes():
    """Misalignment, then scale, then bias; the motion itself and the attitude stay."""
    angle, g, bias = 0.3, 0.02, np.array([1e-3, -2e-3, 3e-3])
    effects = {"axis-misalignment": {"angle": angle}, "gyro-scale": {"g": g}, "gyro-bias": {"bias": bias}}
    found, free = move(make_law(0.5, effects), TIMES), move(make_law(0.5, {}), TIMES)
    turned = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    assert np.abs(found.angular_velocity - ((1 + g) * free.body @ turned + bias)).max() < 1e-14
    assert np.array_equal(found.body, free.body) and np.array_equal(found.attitude, free.attitude)


def test_tilt_about_three_axes():
    """One turn about the rotation vector (angle_x, angle, angle_z), as SciPy has it."""
    tilt = {"angle_x": -0.2, "angle": 0.3, "angle_z": 0.1}
    found, free = move(make_law(0.5, {"axis-misalignment": tilt}), TIMES), move(make_law(0.5, {}), TIMES)
    turn = Rotation.from_rotvec([-0.2, 0.3, 0.1])
    assert np.abs(found.angular_velocity - turn.inv().apply(np.array(free.body))).max() < 1e-14
    assert np.array_equal(found.body, free.body)


def test_what_is_held_has_no_start():
    """Fits of a misalignment start from a tilt about y alone, those of a drag without a scan of its axes."""
    assert default_starts(AxisMisalignment) == [{"axis-misalignment.angle": 0.003}]
    assert default_starts(QuadraticDrag) == [{"quadratic-drag.k": 1e-5}]


def test_turn_about_the_axis_is_a_phase():
    """Without torque, a body of revolution turned about its axis is one that was let go at another phase."""
    turned = move(make_law(0.5, {"axis-misalignment": {"angle_z": 0.3}}), TIMES)
    start = Rotation.from_rotvec([0.0, 0.0, 0.3]).inv().apply(RATES)
    assert np.abs(turned.angular_velocity - move(make_law(0.5, {}), TIMES, start).angular_velocity).max() < 1e-9


def test_scale_is_another_ratio_without_torque():
    """Rates times 1 + g of a body with ratio r are those of one with 1 - (1 - r)/(1 + g)."""
    g, ratio = 0.03, 0.5
    scaled = move(make_law(ratio, {"gyro-scale": {"g": g}}), TIMES)
    other = move(make_law(1 - (1 - ratio) / (1 + g), {}), TIMES, [(1 + g) * w for w in RATES])
    assert np.abs(scaled.angular_velocity - other.angular_velocity).max() < 1e-8


def test_damper_keeps_the_momentum():
    """Body and sphere together keep their angular momentum in the inertial frame, while energy falls."""
    coupling, inner, ratio = 2e-3, 0.2, 0.6
    found = move(make_law(ratio, {"internal-damper": {"c": coupling, "I_d": inner}}), TIMES)
    total = found.body * jnp.array([1.0, 1.0, ratio]) + inner * found.inner[:, 0]
    inertial = rotate(found.attitude, total)
    assert np.abs(inertial - inertial[0]).max() < 1e-7
    energy = np.sum(found.body**2 * np.array([1.0, 1.0, ratio]), 1) + inner * np.sum(found.inner[:, 0] ** 2, 1)
    assert np.all(np.diff(energy) < 0) and energy[-1] < 0.995 * energy[0]
    assert np.array_equal(found.inner[0, 0], found.body[0])


def test_gravity_gradient_librates():
    """Pitch librates about the vertical at n sqrt(3 (I_y - I_x)/I_z)."""
    orbit, epsilon, ratio, kick = 0.01, -0.1, 0.5, 1e-6
    law = make_law(ratio, {"gravity-gradient": {"scale": 1.0}, "inertia-asymmetry": {"epsilon": epsilon}}, orbit)
    found = move(law, TIMES, [0.0, 0.0, orbit + kick])
    frequency = orbit * np.sqrt(3.0 * -2.0 * epsilon / ratio)
    assert np.abs(found.angular_velocity[:, 2] - orbit - kick * np.cos(frequency * TIMES)).max() < 1e-3 * kick


@pytest.mark.parametrize("name", [*SMALL, "gyro-scale", "all, thirtyfold"])
def test_independent_simulator(name):
    """Rates and attitude of every effect, and of all together, thirty times as large."""
    effects = {name: SMALL.get(name, {"g": 0.02})}
    if name.startswith("all"):
        effects = LARGE
    rates, attitude = simulate_second({"inertia_ratio": 0.46}, effects, RATES, TIMES)
    found = move(make_law(0.46, effects), TIMES)
    assert np.abs(found.angular_velocity - rates).max() < 3e-8
    side = np.sign(np.sum(np.asarray(found.attitude) * attitude, axis=1))[:, None]
    assert np.abs(found.attitude * side - attitude).max() < 1e-6


def test_adaptive_integration_agrees():
    """The general integrator with the same torque."""
    found = move(make_law(0.46, {"eddy-current": {"k_e": 1e-4}}), TIMES)
    other = simulate_tumbling([1, 1, 0.46], [1, 0, 0, 0], RATES, TIMES, lambda t, q, w: -1e-4 * w)
    assert np.abs(found.angular_velocity - other.angular_velocity).max() < 1e-8


@pytest.mark.slow
def test_gradients():
    """Forward, reverse and difference quotients of a reading, by every parameter that torques and inertia have."""
    times = TIMES[:101]

    def read(x, reverse=False):
        law = make_law(x[0], {"eddy-current": {"k_e": x[1]}, "internal-damper": {"c": x[2], "I_d": x[3]},
                              "gravity-gradient": {"scale": x[4]}, "inertia-asymmetry": {"epsilon": x[5]},
                              "axis-misalignment": {"angle": x[6], "angle_x": x[7], "angle_z": x[8]},
                              "quadratic-drag": {"k": x[9], "axial": x[10]}})
        return jnp.sum(jnp.sin(40.0 * move(law, times, reverse=reverse).angular_velocity[50]))

    x = jnp.array([0.5, 1e-4, 2e-4, 0.1, 3.0, 0.02, 0.1, -0.2, 0.05, 1e-3, 0.5])
    forward, reverse = jax.jacfwd(read)(x), jax.grad(partial(read, reverse=True))(x)
    assert np.allclose(forward, reverse, rtol=1e-9, atol=1e-12)
    h = 1e-5 * np.abs(x)
    differences = [(read(x + d) - read(x - d)) / (2 * np.abs(d).max()) for d in np.diag(h)]
    assert np.allclose(forward, np.array(differences), rtol=2e-6, atol=1e-9)
