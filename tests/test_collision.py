"""A ball on an arm against tumbling debris: the bench as its limit, closed forms, balances, a second simulator."""

import dataclasses as dc

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.signal import find_peaks
from scipy.spatial.transform import Rotation

from ddetumble import Ball, CoulombFriction, InputError
from ddetumble.contact import Striker
from ddetumble.dynamics import Box, Cylinder, Mesh, Sphere, simulate_oblique_impact
from ddetumble.dynamics.bodies import HollowCylinder
from ddetumble.dynamics.collision import _find_separation, reduce_mass, simulate_collision
from ddetumble.dynamics.surfaces import CylinderSurface, Debris, make_debris
from ddetumble.effects.impact import ArmServo, ViscoelasticWall, WallStiffness
from ddetumble.effects.oblique import OffCentreReaction, TangentialCompliance
from ddetumble.effects.slip import FrictionalHeating, Stribeck
from tests.independent.two_bodies import REST, integrate_pair


CYLINDER = make_debris(Cylinder())
HEAVY = Debris(1e30, 1e30 * np.eye(3), CylinderSurface(1.0, 3.0))
LEVEL = np.array([1.0, 0.0, 0.0, 0.0])


def build(mass=8.0, across=8.0, rolling=1e9, friction=0.2, restitution=0.7, **effects):
    """A law with a few effects of every kind, at their null unless told otherwise."""
    given = {"k_s": 0.0, "k_w": 0.0, "k_v": 0.0, "share": 0.0, "A": 0.0, "kappa": 0.0} | effects
    law = Striker(Ball(effective_mass=mass, restitution=restitution), CoulombFriction(friction), tangential_mass=across,
                  rolling_mass=rolling)
    return law.extend((ArmServo(given["k_s"]), WallStiffness(given["k_w"]), ViscoelasticWall(given["k_v"], 5e-3),
                       OffCentreReaction(given["share"]), Stribeck(given["A"], 0.1),
                       FrictionalHeating(given["kappa"])))


def run(law, debris, omega, point, velocity, pressure=1.5e6, attitude=LEVEL, **options):
    """One collision; numbers in, arrays out."""
    state = (np.asarray(x, float) for x in (attitude, omega, point, velocity))
    return simulate_collision(law, debris, *state, {"initial_pressure": pressure}, **options)


def test_nothing_calls_the_host():
    """Neither a collision nor its derivatives: a program with such a call cannot be kept for the next process."""
    def separate(point):
        rates, velocity = np.array([0.1, 0.0, 0.2]), np.array([-0.4, 0.0, 0.3])
        return simulate_collision(build(), CYLINDER, LEVEL, rates, point, velocity, {"initial_pressure": 1.5e6},
                                  adjoint=dfx.ForwardMode()).separation

    for function in (separate, jax.jacfwd(separate)):
        program = str(jax.make_jaxpr(function)(jnp.array([1.0, 0.0, 1.2])))
        assert "while" in program and "callback" not in program


def test_separation_and_its_derivatives_are_those_of_a_throw():
    """A body thrown up at v comes back at 2 v/g, with the first and second derivatives of that; before the end of the
    last step, and not where that is later than wanted."""
    def fly(g, most=10.0):
        path = dfx.diffeqsolve(
            dfx.ODETerm(lambda t, y, g: jnp.stack([y[1], -g])), dfx.Tsit5(), 0.0, 1.0, 0.1, jnp.array([0.0, 3.0]),
            args=g, saveat=dfx.SaveAt(dense=True), adjoint=dfx.ForwardMode(),
            event=dfx.Event(lambda t, y, args, **_: jnp.where(t > 0, y[0], 0.0), direction=False)).interpolation
        return _find_separation(lambda t, path, _: path.evaluate(t)[0], path, (), jnp.asarray(most))

    g = jnp.asarray(9.0)
    time, parted = fly(g)
    assert parted and float(time) == pytest.approx(6.0 / 9.0, rel=1e-12)
    first = jax.jacfwd(lambda g: fly(g)[0])
    assert float(first(g)) == pytest.approx(-6.0 / 81.0, rel=1e-9)
    assert float(jax.jacfwd(first)(g)) == pytest.approx(12.0 / 729.0, rel=1e-6)
    assert not fly(g, 0.66)[1] and float(fly(g, 0.66)[0]) == 0.66


def test_what_never_separates_has_not_failed():
    """A surface that turns away under a ball at 1 mm/s, and a contact of which the span ends within the first step:
    both are followed to the end of the span, and no further."""
    grazing = run(build(), CYLINDER, [0.0, 6.0, 0.0], [1.0, 0.0, 1.2], [6.0 * 1.2 - 1e-3, 0.0, -6.0])
    short = run(build(), HEAVY, REST, [1.0, 0.0, 1.2], [-0.4, 0.0, 0.3], span=1e-4)
    for found, span in ((grazing, 1.0), (short, 1e-4)):
        assert not found.separated and not found.failed and int(found.steps) < 1000
        assert float(found.separation) == pytest.approx(span)
    assert float(grazing.peak_force) < 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("effects", [{}, {"k_w": 900.0, "k_v": 800.0, "share": 0.1, "A": 0.4, "kappa": 3.0},
                                     {"k_s": 400.0}])  # an arm that drives: the bench's is checked by SciPy
def test_a_plate_of_infinite_mass_is_the_bench(effects):
    """All channels and what is left of the speeds, as `strike` has them."""
    law = build(1.3, 1.1, 0.45, 0.25, **effects)
    found = run(law, HEAVY, REST, [1.0, 0.0, 1.2], [-0.4, 0.0, 0.3])
    conditions = {"initial_pressure": 1.5e6, "approach_speed": 0.4, "tangential_speed": 0.3}
    bench = simulate_oblique_impact(law, conditions, found.course.time, span=0.1)
    assert bool(found.separated) and not bool(found.failed)
    np.testing.assert_allclose(found.separation, bench.separation, rtol=1e-6)
    np.testing.assert_allclose(found.arm_velocity[0], bench.rebound_speed, rtol=1e-5)
    np.testing.assert_allclose(found.arm_velocity[2], bench.tangential_speed, rtol=1e-5)
    # Without separation itself: one of the two is a rounding before it, where an effect breaks off.
    for channel in ("normal_force", "depression", "pressure"):
        gap = np.abs(getattr(found.course, channel) - getattr(bench, channel))[:-1]
        assert gap.max() < 2e-5 * np.abs(getattr(bench, channel)).max(), channel
    # The bench's even steps and cubic interpolation round off the corner where slip turns to grip.
    gap = np.abs(found.course.friction[:, 2] - bench.tangential_force)[:-1] / np.abs(bench.tangential_force).max()
    assert gap.max() < 1e-2 and np.median(gap) < 1e-5


@pytest.mark.slow
def test_compliant_patch_tends_to_that_of_the_bench():
    """The damper beside the patch's spring is an approximation that vanishes with its relaxation time."""
    law = build(1.3, 1.1, 0.45, 0.25)
    law = law.reference.extend((*law.effects, TangentialCompliance(5e-5)))
    gaps = []
    for relaxation in (8e-5, 2e-5):
        found = run(law, HEAVY, REST, [1.0, 0.0, 1.2], [-0.4, 0.0, 0.15], relaxation=relaxation)
        conditions = {"initial_pressure": 1.5e6, "approach_speed": 0.4, "tangential_speed": 0.15}
        bench = simulate_oblique_impact(law, conditions, found.course.time, span=0.1)
        gaps.append(np.abs(found.course.friction[:, 2] - bench.tangential_force)[1:-1].max())
    assert float(jnp.min(found.course.friction[:, 2])) < -0.5  # it reverses
    assert gaps[1] < 0.35 * gaps[0] and gaps[1] < 1e-2 * np.abs(bench.tangential_force).max()


@pytest.mark.parametrize("restitution", [0.4, 0.8])
def test_central_impact_is_that_of_the_reduced_mass(restitution):
    """Through the centre of a body at rest: the two-body closed form, whatever the force law."""
    found = run(build(8.0, friction=0.0, restitution=restitution), CYLINDER, REST, [1.0, 0.0, 0.0], [-0.6, 0.0, 0.0])
    reduced = 1.0 / (1.0 / 8.0 + 1.0 / 1000.0)
    impulse = reduced * (1.0 + restitution) * 0.6
    np.testing.assert_allclose(found.impulse, [-impulse, 0.0, 0.0], rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(found.velocity[0] - found.arm_velocity[0], -restitution * 0.6, rtol=1e-7)
    np.testing.assert_allclose(found.angular_momentum, 0.0, atol=1e-12)


def test_off_centre_impact_tends_to_the_instant():
    """A ball of higher pressure touches more briefly: J = m_red (1 + e) v_1 with (r x n) I^-1 (r x n) is reached."""
    point, omega, normal = np.array([1.0, 0.0, 1.2]), np.array([0.0, 0.07, 0.02]), np.array([1.0, 0.0, 0.0])
    mass = reduce_mass(CYLINDER, point, normal, 8.0)
    np.testing.assert_allclose(mass, 1.0 / (1.0 / 8.0 + 1.0 / 1000.0 + 1.2**2 / 1000.0), rtol=1e-12)
    gaps = []
    for pressure in (1e6, 64e6):
        found = run(build(8.0, friction=0.0), CYLINDER, omega, point, [-0.6, 0.0, 0.0], pressure)
        instant = CYLINDER.inertia @ omega - mass * 1.7 * found.approach_speed * np.cross(point, normal)
        gaps.append(np.abs(found.angular_momentum - instant).max())
    assert gaps[1] < 0.3 * gaps[0] < 0.02 * np.abs(found.angular_momentum).max()


@pytest.mark.parametrize("point, velocity", [([1.0, 0.0, 1.1], [-0.7, 0.3, 0.2]), ([0.3, 0.4, 1.5], [0.1, 0.2, -0.7])])
def test_normal_force_leaves_axial_spin(point, velocity):
    """On a body of revolution without friction the momentum along the axis stays, to rounding."""
    omega = np.array([0.03, -0.05, 0.4])
    plain = run(build(friction=0.0), CYLINDER, omega, point, velocity)
    np.testing.assert_allclose(plain.angular_velocity[2], 0.4, rtol=1e-12)
    rubbed = run(build(friction=0.3), CYLINDER, omega, point, velocity)
    assert abs(float(rubbed.angular_velocity[2]) - 0.4) > 1e-4


def test_momentum_and_energy_balance():
    """Twelve random impacts with drive, friction, rolling and memory: what is unaccounted for is rounding."""
    draw = np.random.default_rng(4)
    for _ in range(12):
        law = build(*draw.uniform([2, 2, 0.5], [20, 20, 3]), draw.uniform(0, 0.4), draw.uniform(0.3, 0.9),
                    k_s=draw.uniform(0, 300), k_w=draw.uniform(0, 900), k_v=draw.uniform(0, 900),
                    share=draw.uniform(0, 0.1), A=draw.uniform(0, 0.5), kappa=draw.uniform(0, 5))
        attitude = draw.normal(size=4)
        frame = Rotation.from_quat(np.roll(attitude, -1)).as_matrix()
        point = np.array([np.cos(a := draw.uniform(0, 6)), np.sin(a), draw.uniform(-1.3, 1.3)])
        velocity = frame @ (-draw.uniform(0.4, 1.0) * point * [1, 1, 0] + draw.normal(size=3) * 0.15)
        found = run(law, CYLINDER, draw.normal(size=3) * 0.08, point, velocity, draw.uniform(0.5e6, 2.5e6), attitude,
                    span=0.3)
        assert not bool(found.failed)
        one = found.ledger
        linear = one.tip_after + found.impulse - one.tip_before - one.arm_impulse
        angular = one.tip_moment_after + one.debris_after - one.tip_moment_before - one.debris_before - one.arm_moment
        energy = one.energy_after - one.energy_before - one.arm_work + (one.normal_loss + one.friction_loss
                                                                        + one.rolling_loss)
        assert np.abs(linear).max() < 1e-9 * np.abs(one.tip_before).max()
        assert np.abs(angular).max() < 1e-9 * np.abs(one.tip_moment_before).max()
        assert abs(float(energy)) < 1e-8 * float(one.energy_before)
        assert min(float(one.normal_loss), float(one.friction_loss), float(one.rolling_loss)) >= -1e-12


@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_agrees_with_a_second_simulator(friction):
    """An asymmetric body struck off centre while it tumbles, by SciPy in other variables."""
    inertia = np.array([[900.0, 30, 10], [30, 1100, -20], [10, -20, 600]])
    debris = Debris(800.0, inertia, CylinderSurface(1.0, 3.0))
    omega, velocity = np.array([0.05, -0.08, 0.11]), np.array([-0.5, -0.5, 0.25])
    point = np.array([np.cos(0.7), np.sin(0.7), 0.9])
    theirs = integrate_pair(12.0, friction, omega, point, velocity, inertia, 800.0, 1.3e6)
    found = run(build(12.0, 12.0, friction=friction), debris, omega, point, velocity, 1.3e6)
    np.testing.assert_allclose(found.separation, theirs.duration, rtol=1e-6)
    for mine, other in ((found.angular_velocity, theirs.rates), (found.velocity, theirs.body),
                        (found.arm_velocity, theirs.tip), (found.angular_momentum, theirs.momentum),
                        (found.last_point, theirs.place)):
        np.testing.assert_allclose(mine, other, rtol=1e-6, atol=1e-7 * np.abs(other).max())
    assert float(found.second_depression) == 0.0


@pytest.mark.parametrize("rate, blows, span", [(0.5, 2, 0.3), (0.3, 1, 1.0)])
def test_a_surface_that_turns_under_a_ball_is_struck_again(rate, blows, span):
    """A ball slides along a cylinder that tumbles towards it: it goes in again before it has left. How far, by the
    extremes of the same contact in SciPy.
    """
    inertia, omega, point = np.diag([900.0, 900.0, 600.0]), np.array([0.0, rate, 0.0]), np.array([1.0, 0.0, -1.0])
    velocity = np.array([-0.3, 0.0, 2.0]) + np.cross(omega, point)
    theirs = integrate_pair(12.0, 0.1, omega, point, velocity, inertia, 800.0, 1e6, 0.4, span)
    found = run(build(12.0, 12.0, friction=0.1, restitution=0.4), Debris(800.0, inertia, CylinderSurface(1.0, 3.0)),
                omega, point, velocity, 1e6, span=span)
    np.testing.assert_allclose(found.angular_velocity, theirs.rates, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(found.last_point, theirs.place, rtol=1e-6, atol=1e-6)
    peaks, dips = (theirs.depths[find_peaks(sign * theirs.depths)[0]] for sign in (1.0, -1.0))
    assert len(peaks) == blows and bool(found.separated) == (blows == 1)
    np.testing.assert_allclose(found.second_depression, peaks.sum() - dips.sum() - peaks.max(), rtol=0.03, atol=1e-9)


@pytest.mark.study
def test_derivatives_agree():
    """Forward mode, reverse mode and differences, by place, velocity and pressure together."""
    law = build(friction=0.2)

    def left(x):
        point = jnp.stack([jnp.cos(x[0]), jnp.sin(x[0]), x[1]])
        found = simulate_collision(law, CYLINDER, jnp.asarray(LEVEL), jnp.array([0.02, 0.07, 0.03]), point, x[2:5],
                        {"initial_pressure": 1e6 * x[5]}, rtol=1e-11, atol=1e-13, max_steps=512)
        return jnp.sum(found.angular_momentum**2) + found.peak_force

    def forward(x):
        return jax.vmap(lambda v: jax.jvp(left, (x,), (v,))[1])(jnp.eye(6))

    x = jnp.array([0.3, 1.1, -0.8, -0.2, 0.1, 1.4])
    slopes = eqx.filter_jit(forward)(x)
    np.testing.assert_allclose(eqx.filter_jit(jax.grad(left))(x), slopes, rtol=2e-5)
    value = eqx.filter_jit(left)
    for k, step in enumerate(1e-5 * np.eye(6)):
        difference = float(value(x + step) - value(x - step)) / 2e-5
        np.testing.assert_allclose(slopes[k], difference, rtol=2e-4, atol=1e-3)


@pytest.mark.study
def test_batches_are_loops():
    """`vmap` over speeds gives what one after the other gives."""
    law = build()

    def one(speed):
        found = run_traced(law, speed)
        return found.angular_momentum, found.peak_force

    def run_traced(law, speed):
        velocity = jnp.stack([-speed, 0.1 * speed, 0.0 * speed])
        return simulate_collision(law, CYLINDER, jnp.asarray(LEVEL), jnp.array([0.0, 0.07, 0.0]),
                                  jnp.array([1.0, 0.0, 1.0]), velocity, {"initial_pressure": 1.5e6})

    speeds = jnp.array([0.3, 0.6, 1.2])
    momentum, peak = eqx.filter_jit(jax.vmap(one))(speeds)
    single = eqx.filter_jit(one)
    for k, speed in enumerate(speeds):
        np.testing.assert_allclose(momentum[k], single(speed)[0], rtol=1e-10)
        np.testing.assert_allclose(peak[k], single(speed)[1], rtol=1e-10)


@pytest.mark.slow
def test_ball_that_rolls_and_grips_by_another_solver():
    """A light ball that grips is stiff and takes more steps; a method of order 8 finds the same."""
    law = build(8.0, 8.0, 0.4, 0.5)
    plain, other = (run(law, CYLINDER, REST, [1.0, 0.0, 0.5], [-0.4, 0.0, 0.05], solver=solver, rtol=1e-8)
                    for solver in (dfx.Tsit5(), dfx.Dopri8()))
    np.testing.assert_allclose(plain.angular_momentum, other.angular_momentum, rtol=1e-5, atol=1e-6)


@pytest.mark.slow
def test_feet_of_a_box_are_those_of_a_search():
    """Distance and normal against the nearest of many points of the surface; a mesh of the box is the box."""
    lengths = np.array([2.0, 1.0, 3.0])
    box = make_debris(Box(500.0, lengths)).surface
    corners = 0.5 * lengths * np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
    faces = np.array([[0, 1, 3], [0, 3, 2], [4, 7, 5], [4, 6, 7], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6],
                      [0, 6, 4], [0, 2, 6], [1, 5, 7], [1, 7, 3]])
    if np.sum(np.linalg.det(corners[faces])) < 0:
        faces = faces[:, ::-1]
    mesh = make_debris(Mesh(500.0, corners + [0.2, -0.1, 0.3], faces)).surface
    grid = np.linspace(-1, 1, 201)
    a, b = np.meshgrid(grid, grid)
    sides = [np.stack([*(np.roll([np.ones_like(a), a, b], axis, axis=0) * sign)], -1).reshape(-1, 3) * lengths / 2
             for axis in range(3) for sign in (-1, 1)]
    surface = np.concatenate(sides)
    for point in ([1.02, 0.2, 0.4], [0.3, -0.53, 1.1], [-0.2, 0.1, 1.55], [-1.01, -0.3, -1.2]):
        found, meshed = box.find_foot(jnp.array(point)), mesh.find_foot(jnp.array(point))
        nearest = np.linalg.norm(surface - point, axis=1).min()
        assert abs(float(found.distance) - nearest) < 1e-3
        foot = np.array(point) - float(found.distance) * np.asarray(found.normal)
        inside = np.sort(0.5 * lengths - np.abs(foot))
        np.testing.assert_allclose(found.margin, inside[1], atol=1e-9)
        np.testing.assert_allclose(meshed.distance, found.distance, atol=1e-9)
        np.testing.assert_allclose(meshed.normal, found.normal, atol=1e-9)
        # The mesh has its faces in another order.
        np.testing.assert_allclose(np.sort(meshed.margins), np.sort(found.margins), atol=1e-9)


def test_places_lie_on_their_faces():
    """Coordinates over -1 to 1 stay on the face that they name, and end at its edge."""
    for body in (Cylinder(), Box(500.0, np.array([2.0, 1.0, 3.0])), Sphere(100.0, 0.7)):
        surface = make_debris(body).surface
        for face in range(len(surface.face_names())):
            for coordinates in ([0.3, -0.4], [-0.9, 0.9], [0.0, 0.0]):
                foot = surface.find_foot(surface.place(jnp.array(face), jnp.array(coordinates)))
                assert abs(float(foot.distance)) < 1e-12 and float(foot.margin) > 0
        assert float(surface.reach()) > 0
    rim = CYLINDER.surface.find_foot(CYLINDER.surface.place(jnp.array(0), jnp.array([0.2, 1.0])))
    np.testing.assert_allclose(rim.margin, 0.0, atol=1e-12)


def test_edge_is_told():
    """A contact disc that reaches over the rim has a margin below zero."""
    found = run(build(), CYLINDER, REST, [1.0, 0.0, 1.495], [-0.6, 0.0, 0.0])
    assert float(found.margin) < 0
    assert float(run(build(), CYLINDER, REST, [1.0, 0.0, 1.4], [-0.6, 0.0, 0.0]).margin) > 0


@pytest.mark.parametrize("change, says", [
    ({"velocity": [0.4, 0.0, 0.0]}, "does not approach"), ({"omega": [0.0, 0.1]}, "must have the shape"),
    ({"pressure": np.nan}, "initial_pressure is nan"),
])  # fmt: skip
def test_bad_input_is_refused(change, says):
    """One sentence each."""
    given = {"omega": REST, "point": [1.0, 0.0, 0.3], "velocity": [-0.4, 0.0, 0.0], "pressure": 1e6} | change
    with pytest.raises(InputError, match=says):
        run(build(), CYLINDER, **given)


def test_debris_is_refused():
    """A surface that is not known, a mesh that is not convex, a mass that is none."""
    with pytest.raises(InputError, match="surface is not defined"):
        make_debris(HollowCylinder(100.0, 0.9, 1.0, 3.0))
    with pytest.raises(InputError, match="mass of the debris must be positive"):
        Debris(0.0, np.eye(3), CylinderSurface(1.0, 3.0))
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0.2, 0.2, 0.1]])
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 4], [2, 3, 4], [3, 1, 4]])
    with pytest.raises(InputError, match="must be convex"):
        make_debris(Mesh(100.0, corners, faces))
    with pytest.raises(InputError, match="needs a Striker"):
        simulate_collision(dc.replace(Ball()), CYLINDER, LEVEL, REST, [1.0, 0, 0], [-1.0, 0, 0], {})  # pyright: ignore
