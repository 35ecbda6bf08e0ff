"""Attitude motion: rotations, mass properties, the closed form of free motion, the integrator, the paper's angles."""

import sys

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation
from scipy.special import ellipj, ellipkinc

from ddetumble import ComputationError, InputError
from ddetumble._rotation import (
    conjugate,
    from_matrix,
    from_rotation_vector,
    measure_turn,
    multiply,
    rotate,
    rotate_back,
    to_rotation_vector,
    turn,
)
from ddetumble.dynamics import (
    Box,
    Cylinder,
    HollowCylinder,
    Mesh,
    Sphere,
    from_euler_angles,
    measure_energy,
    measure_momentum,
    measure_nutation,
    measure_precession,
    measure_spin,
    propagate_torque_free,
    read_mesh,
    simulate_tumbling,
    to_euler_angles,
    trace_point,
)
from ddetumble.dynamics.bodies import integrate_mesh
from ddetumble.dynamics.elliptic import first_kind, jacobi
from ddetumble.dynamics.free_motion import coast_symmetric


START = np.array([0.5, -0.1, 0.7, 0.3]) / np.linalg.norm([0.5, -0.1, 0.7, 0.3])
AXES = Rotation.from_rotvec([0.4, -1.1, 0.7]).as_matrix()
CYLINDER, THREE = np.diag([1000.0, 1000.0, 500.0]), np.diag([400.0, 700.0, 1000.0])
TURNED = AXES @ THREE @ AXES.T
MOTIONS = {
    "cylinder": (CYLINDER, [0.1, 0.2, 0.3]),
    "below": (THREE, [0.1, 0.2, 0.3]),  # 2 E I_2 < L^2: the momentum circles the axis of the largest moment
    "above": (THREE, [-0.3, 0.2, 0.1]),
    "turned": (TURNED, [0.3, -0.2, 0.1]),
}


def integrate(inertia, rate, times, attitude=START):
    """The same motion by SciPy: DOP853 on Euler's equations and the quaternion, no code shared."""
    inverse = np.linalg.inv(inertia)

    def field(_, y):
        q, w = y[:4], y[4:]
        dq = 0.5 * np.array([-q[1:] @ w, *(q[0] * w + np.cross(q[1:], w))])
        return np.concatenate([dq, inverse @ np.cross(inertia @ w, w)])

    found = solve_ivp(field, (0.0, times[-1]), [*attitude, *rate], "DOP853", times, rtol=1e-13, atol=1e-15)
    return found.y[:4].T, found.y[4:].T


def assert_same_motion(motion, attitude, rate, within):
    """Attitudes up to the sign of the quaternion [rad], rates [rad/s]."""
    assert not bool(motion.failed)
    assert np.max(measure_turn(motion.attitude, jnp.asarray(attitude))) < within
    assert np.max(np.abs(motion.angular_velocity - rate)) < within


# Rotations

numbers = st.floats(-1.0, 1.0).map(lambda x: round(x, 6))
vectors = st.tuples(numbers, numbers, numbers).map(np.array)
quaternions = st.tuples(numbers, numbers, numbers, numbers).map(np.array).filter(lambda q: np.linalg.norm(q) > 0.1)
quaternions = quaternions.map(lambda q: q / np.linalg.norm(q))


@pytest.mark.slow
@given(quaternions, quaternions, vectors)
@settings(max_examples=60)
def test_rotations(p, q, v):
    """SciPy's rotations, round trips and the laws of a group."""
    ours = Rotation.from_quat(q, scalar_first=True)
    assert np.allclose(rotate(q, v), ours.apply(v), atol=1e-14)
    assert np.allclose(rotate_back(q, rotate(q, v)), v, atol=1e-14)
    assert np.allclose(rotate(multiply(p, q), v), rotate(p, rotate(q, v)), atol=1e-14)
    assert np.allclose(multiply(q, conjugate(q)), [1, 0, 0, 0], atol=1e-14)
    assert measure_turn(from_matrix(jnp.asarray(ours.as_matrix())), q) < 1e-14
    assert measure_turn(from_rotation_vector(to_rotation_vector(q)), q) < 1e-14
    assert np.allclose(to_rotation_vector(from_rotation_vector(v)), v, atol=1e-14)  # |v| < pi


@pytest.mark.slow
def test_rotation_derivatives():
    """No turn at all: the exponential and the logarithm have the derivatives of their first term."""
    assert np.allclose(jax.jacfwd(from_rotation_vector)(jnp.zeros(3)), 0.5 * np.eye(4)[:, 1:], atol=1e-15)
    one = jnp.array([1.0, 0.0, 0.0, 0.0])
    assert np.allclose(jax.jacrev(to_rotation_vector)(one)[:, 1:], 2.0 * np.eye(3), atol=1e-15)
    rate = jnp.array([0.3, -0.2, 0.5])
    slope = jax.jacfwd(lambda t: multiply(START, from_rotation_vector(t * rate)))(jnp.zeros(()))
    assert np.allclose(slope, turn(START, rate), atol=1e-15)


# Mass properties


def make_mesh(columns, radius=1.0, length=3.0):
    """Closed mesh inscribed in a cylinder."""
    angle = 2 * np.pi * np.arange(columns) / columns
    ring = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    lift = np.full((columns, 1), 0.5 * length)
    centres = [[0.0, 0.0, -0.5 * length], [0.0, 0.0, 0.5 * length]]
    vertices = np.concatenate([np.hstack([ring, -lift]), np.hstack([ring, lift]), centres])
    here, after = np.arange(columns), np.roll(np.arange(columns), -1)
    low, high = np.full(columns, 2 * columns), np.full(columns, 2 * columns + 1)
    faces = [np.stack(corners, axis=1) for corners in (
        (here, after, after + columns), (here, after + columns, here + columns), (low, after, here),
        (high, here + columns, after + columns))]
    return vertices, np.concatenate(faces)


def test_textbook_bodies():
    """The paper's cylinder, and limits of the others."""
    cylinder = Cylinder()
    assert np.allclose(cylinder.inertia(), CYLINDER)
    assert np.allclose(cylinder.end_face(), [0, 0, 1.5]) and np.isclose(cylinder.volume(), 3 * np.pi)
    assert np.allclose(Box(12.0, [1.0, 2.0, 3.0]).inertia(), np.diag([13.0, 10.0, 5.0]))
    assert np.allclose(Sphere(10.0, 0.5).inertia(), np.eye(3))
    solid, hole, tube = Cylinder(4.0, 1.0, 3.0), Cylinder(1.0, 0.5, 3.0), HollowCylinder(3.0, 0.5, 1.0, 3.0)
    assert np.allclose(tube.inertia(), solid.inertia() - hole.inertia())
    assert np.isclose(tube.volume(), solid.volume() - hole.volume())
    assert np.allclose(tube.end_face(), solid.end_face())


@pytest.mark.slow
def test_mesh():
    """A box is exact wherever it stands; a cylinder's mesh converges in order 2; derivatives are right."""
    vertices, faces = make_mesh(4, radius=np.sqrt(0.5))
    place = np.array([5.0, -3.0, 2.0])
    box = Mesh(12.0, (vertices @ Rotation.from_euler("z", 45, degrees=True).as_matrix()) @ AXES.T + place, faces)
    assert np.isclose(box.volume(), 3.0) and np.allclose(box.centre(), place)
    assert np.allclose(AXES.T @ box.inertia() @ AXES, np.diag([10.0, 10.0, 2.0]), atol=1e-12)
    errors = [np.max(np.abs(Mesh(1000.0, *make_mesh(count)).inertia() - CYLINDER)) for count in (16, 32, 64)]
    assert np.all(np.abs(np.log2(np.divide(errors[:-1], errors[1:])) - 2.0) < 0.05)
    vertices, faces = make_mesh(5)
    way = np.random.default_rng(0).normal(size=vertices.shape)

    def weigh(x):
        return Mesh(1000.0, x, faces).inertia()[0, 2] + 100.0 * integrate_mesh(x, faces)[1][1]

    slope = jax.jvp(weigh, (jnp.asarray(vertices),), (jnp.asarray(way),))[1]
    difference = (weigh(vertices + 1e-5 * way) - weigh(vertices - 1e-5 * way)) / 2e-5
    assert np.isclose(slope, np.sum(jax.grad(weigh)(jnp.asarray(vertices)) * way), rtol=1e-12)
    assert np.isclose(slope, difference, rtol=1e-8)


def test_read_mesh(tmp_path, monkeypatch):
    """An STL file, in millimetres; and one sentence where trimesh is missing, or the file is."""
    pytest.importorskip("trimesh")
    vertices, faces = make_mesh(12)
    lines = ["solid debris"]
    for corners in 1000.0 * vertices[faces]:
        lines += ["facet normal 0 0 0", "outer loop"]
        lines += [f"vertex {x!r} {y!r} {z!r}" for x, y, z in corners.tolist()] + ["endloop", "endfacet"]
    file, bad = tmp_path / "debris.stl", tmp_path / "bad.stl"
    file.write_text("\n".join([*lines, "endsolid debris\n"]))
    found = read_mesh(file, 1000.0, scale=0.001)
    assert len(found.vertices) == len(vertices)
    assert np.allclose(found.inertia(), Mesh(1000.0, vertices, faces).inertia(), rtol=1e-6)  # trimesh may keep 32 bits
    bad.write_text("\n".join([*lines[:1], *lines[8:], "endsolid debris\n"]))
    with pytest.raises(InputError, match=r"bad\.stl: a mesh must be closed"):
        read_mesh(bad, 1000.0)
    with pytest.raises(InputError, match="does not exist"):
        read_mesh(tmp_path / "none.stl", 1000.0)


def test_no_trimesh(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "trimesh", None)
    with pytest.raises(InputError, match="needs trimesh; install it"):
        read_mesh(tmp_path / "debris.stl", 1000.0)


# Closed form


@pytest.mark.slow
@pytest.mark.parametrize("name", MOTIONS)
def test_closed_form_is_integral(name):
    """To 1e-9 over the paper's 2000 s, here and by SciPy (whose own error is of that size)."""
    inertia, rate = MOTIONS[name]
    times = np.linspace(0.0, 2000.0, 201)
    closed = propagate_torque_free(inertia, START, rate, times)
    integrated = simulate_tumbling(inertia, START, rate, times)
    assert_same_motion(integrated, closed.attitude, closed.angular_velocity, 1e-9)
    short = propagate_torque_free(inertia, START, rate, times[:51])
    assert_same_motion(short, *integrate(inertia, rate, times[:51]), 1e-9)
    momentum = measure_momentum(inertia, closed.attitude, closed.angular_velocity)
    assert np.max(np.abs(momentum / np.linalg.norm(momentum[0]) - momentum[0] / np.linalg.norm(momentum[0]))) < 1e-12
    energy = measure_energy(inertia, closed.angular_velocity)
    assert np.max(np.abs(energy / energy[0] - 1.0)) < 1e-13


@pytest.mark.parametrize("name", ["cylinder", "below", "above"])
def test_drift(name):
    """Energy and momentum, all its components, over 10,000 s: below 1e-10 relative."""
    inertia, rate = MOTIONS[name]
    motion = simulate_tumbling(inertia, START, rate, np.linspace(0.0, 10000.0, 101))
    energy = measure_energy(inertia, motion.angular_velocity)
    momentum = measure_momentum(inertia, motion.attitude, motion.angular_velocity)
    assert np.max(np.abs(energy / energy[0] - 1.0)) < 1e-10
    assert np.max(np.abs(momentum - momentum[0])) < 1e-10 * np.linalg.norm(momentum[0])


@pytest.mark.slow
def test_symmetric_form():
    """The trigonometric form is the elliptic one for equal moments; both after a year, whose phase has 9 digits."""
    times = np.array([0.0, 1.0, 2000.0, 3.15e7])
    closed = propagate_torque_free(CYLINDER, START, [0.1, -0.2, 0.3], times)
    plain = coast_symmetric(*map(jnp.asarray, (1000.0, 500.0, START, [0.1, -0.2, 0.3], times)))
    assert_same_motion(closed, *plain, 1e-7)
    assert measure_turn(closed.attitude[2], plain[0][2]) < 1e-12


@pytest.mark.slow
def test_rates_are_jacobi():
    """Angular velocity where the middle rate starts at 0: SciPy's ellipj in textbook form (Landau, section 37)."""
    times, (a, b, c) = np.linspace(0.0, 50.0, 101), np.diag(THREE)
    x, z = 0.05, 0.3  # 2 E I_2 < L^2
    p = z * np.sqrt((c - a) * (c - b) / (a * b))
    m = (b - a) * a * x**2 / (c * (c - b) * z**2)
    s, cn, dn, _ = ellipj(p * times, m)
    expected = np.stack([x * cn, x * np.sqrt(a * (c - a) / (b * (c - b))) * s, z * dn], axis=1)
    assert np.allclose(propagate_torque_free(THREE, START, [x, 0.0, z], times).angular_velocity, expected, atol=1e-14)


@pytest.mark.parametrize("m", [0.0, 0.3, 0.99, 1.0 - 1e-9])
def test_elliptic_functions(m):
    """Against SciPy."""
    u = np.linspace(-30.0, 30.0, 201)
    for ours, theirs in zip(jacobi(jnp.asarray(u), jnp.asarray(1.0 - m)), ellipj(u, m), strict=False):
        assert np.allclose(ours, theirs, atol=1e-8 if m > 0.999 else 1e-12)  # SciPy's own error near 1
    for angle in (-3.0, -1.0, 0.0, 0.5, 1.5, 2.5):
        ours = first_kind(jnp.sin(angle), jnp.cos(angle), jnp.asarray(1.0 - m))
        assert np.isclose(ours, ellipkinc(angle, m), rtol=1e-7 if m > 0.999 else 1e-12, atol=1e-14)


LIMITS = {
    "sphere": (400.0 * np.eye(3), [0.1, 0.2, 0.3]), "flat spin": (CYLINDER, [0.3, 0.1, 0.0]),
    "axis of symmetry": (CYLINDER, [0.0, 0.0, -0.3]), "largest": (THREE, [0.0, 0.0, 0.3]),
    "smallest": (THREE, [-0.3, 0.0, 0.0]), "middle": (THREE, [0.0, 0.3, 0.0]), "rest": (THREE, [0.0, 0.0, 0.0]),
}


@pytest.mark.parametrize("name", LIMITS)
def test_spin_about_principal_axis(name):
    """Constant rate, attitude a turn by it, however long; also about the middle axis, whose motion is unstable."""
    inertia, rate = LIMITS[name]
    times = np.array([0.0, 3.0, 50.0, 2000.0])
    expected = multiply(START, from_rotation_vector(times[:, None] * np.array(rate)))
    assert_same_motion(propagate_torque_free(inertia, START, rate, times), expected, np.tile(rate, (4, 1)), 3e-12)


@pytest.mark.slow
@pytest.mark.parametrize("moments, rate, within", [
    ([400.0, 1000.0 - 1e-9, 1000.0], [0.1, 0.2, 1e-6], 1e-10),  # nearly equal
    ([400.0, 1000.0 - 1e-3, 1000.0], [1e-4, 0.2, 0.1], 1e-10),
    ([700.0, 1000.0, 400.0], [0.0101, 0.001, 0.3], 1e-10),
    ([400.0, 700.0, 1000.0], [0.0101, 0.3, 0.001], 1e-10),  # the pulses' series
    ([400.0, 700.0, 1000.0], [-0.001, 0.3, 0.0101], 1e-10),
    ([400.0, 700.0, 1000.0], [1e-4, 0.3, 1e-5], 1e-8),  # here the integrator loses digits
    ([400.0, 700.0, 1000.0], [1e-7, 0.3, -1e-6], 1e-7),
])
def test_near_limits(moments, rate, within):
    """Near equal moments and near the separatrix."""
    inertia, times = np.diag(moments), np.linspace(0.0, 150.0, 31)
    motion = simulate_tumbling(inertia, START, rate, times)
    closed = propagate_torque_free(inertia, START, rate, times)
    assert_same_motion(closed, motion.attitude, motion.angular_velocity, within)


def test_reverse():
    """Backwards in time to where it came from; quaternions stay of one length."""
    there = propagate_torque_free(TURNED, START, [0.3, -0.2, 0.1], [0.0, 20.0, 30.0, 40.0])
    back = propagate_torque_free(TURNED, there.attitude[-1], there.angular_velocity[-1], [-40.0, -20.0, -10.0, 0.0])
    assert_same_motion(back, there.attitude, there.angular_velocity, 1e-13)
    assert np.allclose(np.linalg.norm(there.attitude, axis=1), 1.0, atol=1e-15)


def unpack(x):
    """Inertia tensor, attitude and rate out of thirteen numbers."""
    return jnp.array([[x[0], x[3], x[4]], [x[3], x[1], x[5]], [x[4], x[5], x[2]]]), x[6:10], x[10:13]


@jax.jit
def coast_packed(x):
    motion = propagate_torque_free(*unpack(x), jnp.linspace(0.0, 60.0, 7) * x[13])
    return jnp.concatenate([motion.attitude.ravel(), motion.angular_velocity.ravel()])


WAY = np.random.default_rng(3).normal(size=49)
DERIVATIVES = (jax.jit(jax.jacfwd(coast_packed)), jax.jit(jax.grad(lambda x: coast_packed(x) @ WAY)))
DIFFERENTIATED = {
    **MOTIONS, **LIMITS, "turned cylinder": (AXES @ CYLINDER @ AXES.T, [0.1, 0.2, 0.3]),
    "nearly equal": (np.diag([1000.0, 1000.0 + 1e-6, 500.0]), [0.1, 0.2, 0.3]),
    "separatrix": (THREE, [0.01, 0.3, 0.001]), "middle": (THREE, [0.0, 0.05, 0.0]),
}


@pytest.mark.slow  # to compile
@pytest.mark.parametrize("name", DIFFERENTIATED)
def test_derivatives(name):
    """Forward = reverse = differences, by all elements of the tensor, attitude, rate and time: also where moments are
    equal, about principal axes and at rest."""
    inertia, rate = DIFFERENTIATED[name]
    x = np.array([*np.diag(inertia), inertia[0, 1], inertia[0, 2], inertia[1, 2], *START, *rate, 1.0])
    steps = np.array([0.02] * 6 + [1e-4] * 4 + [2e-5] * 3 + [1e-4])
    columns = []
    for k, step in enumerate(steps):
        e = step * np.eye(14)[k]
        near, far = (coast_packed(x + n * e) - coast_packed(x - n * e) for n in (1, 2))
        columns.append((8.0 * near - far) / (12.0 * step))
    expected, forward = np.array(columns).T, np.asarray(DERIVATIVES[0](x))
    scale = np.max(np.abs(expected), axis=0) + 1e-4
    assert np.max(np.abs(forward - expected) / scale) < 3e-7
    assert np.allclose(DERIVATIVES[1](x), WAY @ forward, atol=1e-8 * np.max(scale), rtol=1e-8)


# Integrator


class Drag(eqx.Module):
    """Eddy currents: a torque against the rate."""

    strength: jax.Array

    def __call__(self, time, attitude, rate):
        return -self.strength * rate


@pytest.mark.slow
def test_torque():
    """A sphere under drag, exactly; a torque that is constant in space adds to the momentum."""
    times = np.linspace(0.0, 100.0, 11)
    ball, rate = 400.0 * np.eye(3), np.array([0.1, 0.2, 0.3])
    motion = simulate_tumbling(ball, START, rate, times, Drag(jnp.asarray(4.0)))
    assert np.allclose(motion.angular_velocity, rate * np.exp(-0.01 * times)[:, None], atol=1e-13)
    path = (1.0 - np.exp(-0.01 * times))[:, None] / 0.01 * rate
    assert np.max(measure_turn(motion.attitude, multiply(START, from_rotation_vector(path)))) < 1e-12
    push = jnp.array([3.0, -1.0, 2.0])
    pushed = simulate_tumbling(THREE, START, rate, times, lambda t, q, w: rotate_back(q, push))
    momentum = measure_momentum(THREE, pushed.attitude, pushed.angular_velocity)
    assert np.allclose(momentum - momentum[0], times[:, None] * push, atol=1e-9)


@pytest.mark.slow
def test_torque_derivatives():
    """Forward = reverse = differences through the integrator."""
    times = jnp.array([20.0, 40.0])

    def end(x, adjoint=None):
        motion = simulate_tumbling(THREE, START, x[:3], times, Drag(x[3]), adjoint=adjoint)
        return motion.attitude[-1] @ jnp.array([1.0, 2.0, 3.0, 4.0]) + motion.angular_velocity[-1, 0]

    x = jnp.array([0.1, 0.2, 0.3, 1.0])
    forward = jax.jacfwd(lambda x: end(x, dfx.ForwardMode()))(x)
    step = 1e-4 * np.eye(4)
    differences = [(8.0 * (end(x + h) - end(x - h)) - end(x + 2 * h) + end(x - 2 * h)) / 12e-4 for h in step]
    assert np.allclose(jax.grad(end)(x), forward, rtol=1e-9)
    assert np.allclose(forward, differences, rtol=1e-7)


@pytest.mark.slow
def test_batch():
    """Under vmap as one by one, by both."""
    rates = jnp.array([[0.1, 0.2, 0.3], [0.0, 0.0, 0.3], [-0.3, 0.2, 0.1]])
    times = jnp.array([0.0, 30.0])
    for move, within in ((propagate_torque_free, 1e-13), (simulate_tumbling, 1e-10)):
        together = jax.vmap(lambda rate, move=move: move(THREE, START, rate, times))(rates)
        for k, rate in enumerate(rates):
            one = move(THREE, START, rate, times)
            assert np.allclose(together.angular_velocity[k], one.angular_velocity, atol=within)
            assert np.allclose(together.attitude[k], one.attitude, atol=within)


@pytest.mark.slow
def test_failure_is_told():
    """Too few steps, or a torque that is no number: an error, and `failed` where errors cannot be raised."""
    with pytest.raises(ComputationError, match="10 steps of 10"):
        simulate_tumbling(THREE, START, [0.1, 0.2, 0.3], [1000.0], max_steps=10)
    with pytest.raises(ComputationError, match="must stay finite"):
        simulate_tumbling(THREE, START, [0.1, 0.2, 0.3], [10.0], lambda t, q, w: w * jnp.nan, max_steps=100)
    traced = jax.jit(lambda w: simulate_tumbling(THREE, START, w, jnp.array([1000.0]), max_steps=10).failed)
    assert bool(traced(jnp.array([0.1, 0.2, 0.3])))


# Angles of the paper


def test_cylinder_precesses():
    """Nutation stays, precession is L/I_t, spin is what is left; the angles run at these rates; point A circles L."""
    body, rate, times = Cylinder(), np.array([0.1, 0.2, 0.3]), np.linspace(0.0, 10.0, 101)
    inertia = body.inertia()
    motion = propagate_torque_free(inertia, START, rate, times)
    momentum = measure_momentum(inertia, START, rate)
    size = np.linalg.norm(momentum)
    nutation = measure_nutation(inertia, motion.angular_velocity)
    precession, spin = (f(inertia, motion.angular_velocity) for f in (measure_precession, measure_spin))
    assert np.allclose(nutation, np.arccos(150.0 / size)) and np.allclose(precession, size / 1000.0)
    assert np.allclose(spin, 0.3 * (1.0 - 500.0 / 1000.0))
    angles = np.unwrap(to_euler_angles(motion.attitude, momentum), axis=0)
    assert np.allclose(angles[:, 1], nutation, atol=1e-13)
    assert np.allclose(angles[:, 0] - angles[0, 0], times * precession[0], atol=1e-12)
    assert np.allclose(angles[:, 2] - angles[0, 2], times * spin[0], atol=1e-12)
    path = trace_point(motion.attitude, body.end_face())
    assert np.allclose(path @ momentum / size, 1.5 * np.cos(nutation), atol=1e-13)
    assert np.allclose(np.linalg.norm(path, axis=1), 1.5)


def test_three_moments_precess():
    """For three moments the rates vary: they are the derivatives of the angles."""
    rate = jnp.array([0.1, 0.2, 0.3])
    momentum = measure_momentum(THREE, START, rate)
    motion = propagate_torque_free(THREE, START, rate, [7.0, 7.0, 7.0, 7.0])
    beside = to_euler_angles(propagate_torque_free(THREE, START, rate, [6.98, 6.99, 7.01, 7.02]).attitude, momentum)
    slope = (8.0 * (beside[2] - beside[1]) - beside[3] + beside[0]) / 0.12
    assert np.isclose(slope[0], measure_precession(THREE, motion.angular_velocity[0]), rtol=1e-8)
    assert np.isclose(slope[2], measure_spin(THREE, motion.angular_velocity[0]), rtol=1e-8)
    nutation = to_euler_angles(motion.attitude, momentum)[0, 1]
    assert np.isclose(nutation, measure_nutation(THREE, motion.angular_velocity[0]), rtol=1e-13)


@given(st.tuples(st.floats(-3.0, 3.0), st.floats(0.01, 3.1), st.floats(-3.0, 3.0)).map(np.array),
       vectors.filter(lambda v: np.linalg.norm(v) > 0.1))
@settings(max_examples=40)
def test_euler_angles_return(angles, momentum):
    """Round trip, the momentum frame's Y_L along the momentum."""
    attitude = from_euler_angles(angles, momentum)
    assert np.allclose(to_euler_angles(attitude, momentum), angles, atol=1e-11)
    axis = rotate(attitude, np.array([0.0, 0.0, 1.0]))
    assert np.isclose(axis @ momentum / np.linalg.norm(momentum), np.cos(angles[1]), atol=1e-13)


def test_angles_at_their_limits():
    """Spin about the axis, upside down, at rest: finite, and the attitude comes back."""
    momentum = np.array([0.0, 0.0, 2.0])
    for nutation in (0.0, np.pi):
        attitude = from_euler_angles(np.array([0.3, nutation, 0.4]), momentum)
        angles = to_euler_angles(attitude, momentum)
        assert angles[2] == 0.0 and measure_turn(from_euler_angles(angles, momentum), attitude) < 1e-14
    assert measure_nutation(CYLINDER, np.zeros(3)) == 0.0
    assert np.isclose(measure_nutation(CYLINDER, np.array([0.0, 0.0, -0.3])), np.pi)
    assert np.isclose(measure_precession(CYLINDER, np.array([0.0, 0.0, 0.3])), 0.15)


# Bad input

GOOD = (THREE, START, [0.1, 0.2, 0.3], [0.0, 1.0])
VERTICES, FACES = make_mesh(6)


@pytest.mark.parametrize("place, value, says", [
    (0, np.diag([1.0, 2.0, -1.0]), "inertia must be positive definite; its principal moments are -1, 1, 2"),
    (0, np.diag([1.0, 2.0, 4.0]), "triangle inequality"),
    (0, [1.0, 2.0, 4.0], "triangle inequality"),
    (0, [[1.0, 0.5, 0], [0, 1, 0], [0, 0, 1]], "inertia must be symmetric"),
    (0, np.ones((2, 2)), r"inertia must have the shape \(3,\) or \(3, 3\); got \(2, 2\)"),
    (0, np.full((3, 3), np.nan), "inertia must be finite"),
    (1, np.zeros(4), "attitude must be a non-zero quaternion"),
    (1, np.ones(3), r"attitude must have the shape \(4,\)"),
    (2, [0.1, np.inf, 0.0], "angular_velocity must be finite"),
    (3, [1.0, 0.0], "times must be finite and ascending"),
    (3, [], "at least one time"),
])
@pytest.mark.parametrize("move", [propagate_torque_free, simulate_tumbling])
def test_bad_start(move, place, value, says):
    given = list(GOOD)
    given[place] = value
    with pytest.raises(InputError, match=says):
        move(*given)


@pytest.mark.parametrize("make, says", [
    (lambda: Cylinder(radius=-1.0), "radius of a Cylinder must be positive"),
    (lambda: Sphere(np.nan, 1.0), "mass of a Sphere must be positive"),
    (lambda: HollowCylinder(1.0, 2.0, 1.0, 1.0), "inner_radius must be below outer_radius"),
    (lambda: Box(1.0, [1.0, 2.0]), "a Box must have three lengths"),
    (lambda: Mesh(1.0, VERTICES, FACES[1:]), "a mesh must be closed"),
    (lambda: Mesh(1.0, VERTICES, FACES[:, ::-1]), "must enclose a positive volume"),
    (lambda: Mesh(1.0, VERTICES, np.concatenate([FACES[:1, ::-1], FACES[1:]])), "a mesh must be closed"),
    (lambda: Mesh(1.0, VERTICES[:5], FACES), "whole numbers from 0 to 4"),
    (lambda: Mesh(0.0, VERTICES, FACES), "mass of a Mesh must be positive"),
])
def test_bad_body(make, says):
    with pytest.raises(InputError, match=says):
        make()


def test_start_after_first_time():
    with pytest.raises(InputError, match="start"):
        simulate_tumbling(*GOOD[:3], [0.0, 1.0], start=0.5)
