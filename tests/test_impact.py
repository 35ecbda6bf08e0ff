"""One impact against theory: restitution in closed form, gradients, convergence, and failures that say so."""

import itertools

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import integrate

from ddetumble import InputError
from ddetumble.contact.law import Ball, ContactLaw, PowerLaw
from ddetumble.contact.sliding import CoulombFriction
from ddetumble.dynamics.impact import simulate_impact
from ddetumble.effects import IMPACT, ArmServo, SensorGain, SensorLag, StressSoftening, ViscoelasticWall, WallStiffness
from ddetumble.inference.parameters import ParameterSpace


SPACE = ParameterSpace(Ball(), IMPACT)
TIMES = jnp.linspace(-0.002, 0.06, 125)
RESTITUTIONS = (0.2, 0.35, 0.5, 0.65, 0.8, 0.9, 0.98)
GRID = jnp.asarray(list(itertools.product(RESTITUTIONS, (0.3, 3.0), (2e5, 2.5e6), (0.1, 0.8))))
PRESSED = {"condition": "initial_pressure", "condition_reference": 1e6}
SPRINGS = {
    "ball": (Ball(), ()),
    "ball, wall and softening": (Ball(), (WallStiffness(3000.0, 1.6), StressSoftening(0.3, 2.0))),
    "matunaga": (Ball(truncated=True), ()),
    "doubled core": (Ball(doubled_core=True), ()),
    **{f"power {n:g}": (PowerLaw(exponent=n, condition_exponent=0.3, **PRESSED), ())
       for n in (0.8, 1.0, 1.5, 2.0, 3.5)},
}
# Every amplitude away from its null, small enough for an ordinary impact.
EVERYTHING = {
    "polytropic-gas.n": 1.2, "ambient-pressure.p_a": 5e4, "wall-stiffness.k_w": 500.0, "membrane-area.alpha": 0.1,
    "inflation-growth.beta": 0.2, "gas-leak.lambda": 2.0, "viscoelastic-wall.k_v": 500.0, "viscous-dashpot.c_v": 1.0,
    "adhesion.tau_a": 5e3, "arm-servo.k_s": 100.0, "speed-dependent-restitution.p": 0.05,
    "pressure-dependent-restitution.p": 0.05, "stress-softening.sigma_m": 0.05, "sensor-highpass.tau_s": 1.0,
    "sensor-lag.T": 5e-4, "sensor-gain.g": 1.03,
    "sensor-hysteresis.h": 0.05,
    "sensor-filter.f_c": 1.0 / 300.0, "sensor-resonance.f_0": 1.0 / 250.0,  # inverses
}  # fmt: skip


def collect(pressure, speed, sequence=3.0):
    """Conditions of one record."""
    given = {"initial_pressure": pressure, "approach_speed": speed, "sequence": sequence}
    return {name: jnp.asarray(value, dtype=float) for name, value in given.items()}


@eqx.filter_jit
def strike(law, conditions, times=TIMES, **options):
    """One impact, compiled."""
    return simulate_impact(law, conditions, times, **options)


@eqx.filter_jit
def rebound(reference, effects, rows):
    """Speed ratio, and whether all went well, for rows of restitution, mass, pressure and speed."""
    def one(row):
        e, mass, pressure, speed = row
        body = eqx.tree_at(lambda r: (r.restitution, r.effective_mass), reference, (e, mass))
        found = simulate_impact(ContactLaw(body, effects), collect(pressure, speed), jnp.array([0.0, 3.0]))
        return found.rebound_speed / speed, found.separated & ~found.failed

    return jax.vmap(one)(rows)


def is_finite(impact):
    """Whether every channel is finite."""
    return all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(impact))


@pytest.mark.slow
@pytest.mark.parametrize("spring", SPRINGS)
def test_restitution_is_realised(spring):
    """The closed form: rebound over approach is the restitution asked for, whatever spring, mass, pressure, speed."""
    ratio, fine = rebound(*SPRINGS[spring], GRID)
    assert fine.all()
    # A spring whose stiffness is infinite at first touch costs the integrator's first step some accuracy.
    np.testing.assert_allclose(ratio, GRID[:, 0], rtol=0, atol=3e-6 if spring == "power 0.8" else 1e-6)


@pytest.mark.slow
def test_elastic_impact_loses_nothing():
    """Restitution 1 comes back at the speed of approach."""
    ratio, fine = rebound(Ball(), (), GRID[:4].at[:, 0].set(1.0))
    assert fine.all()
    np.testing.assert_allclose(ratio, 1.0, atol=1e-6)


@pytest.mark.slow
def test_printed_forms_in_motion():
    """Eq. 6 delivers 0.847 for 0.8 and 0.725 for 0.5; Eq. 5 at face value gains energy."""
    for asked, delivered in ((0.8, 0.847), (0.5, 0.725)):
        law = ContactLaw(Ball(damping_form="printed", restitution=asked))
        assert round(float(strike(law, collect(1e6, 0.4)).rebound_speed) / 0.4, 3) == delivered
    assert strike(ContactLaw(Ball(damping_sign=-1.0)), collect(1e6, 0.4)).rebound_speed > 0.4


def test_impulse_is_change_of_momentum():
    """The integral of the force is m (v1 + rebound)."""
    found = strike(ContactLaw(Ball(effective_mass=1.3)), collect(1e6, 0.4), jnp.linspace(0.0, 0.05, 4001))
    impulse = np.trapezoid(found.normal_force, dx=0.05 / 4000)
    np.testing.assert_allclose(impulse, 1.3 * (0.4 + found.rebound_speed), rtol=1e-6)


@pytest.mark.slow
def test_tolerance_is_obeyed():
    """The error falls with the tolerance, four digits for five, and the separation converges with it."""
    rtol = 10.0 ** -np.arange(4.0, 11.0)
    law, conditions = ContactLaw(Ball(), (WallStiffness(1000.0),)), collect(1e6, 0.4)
    solve = jax.jit(jax.vmap(lambda r: simulate_impact(law, conditions, TIMES, rtol=r, atol=r / 100)))
    found = solve(jnp.asarray(rtol))
    error = np.abs(np.asarray(found.rebound_speed) / 0.4 - 0.7)
    assert error[5] < 1e-4 * error[0] and error[5] < 1e-8
    assert np.abs(found.separation - found.separation[-1])[3:].max() < 1e-8
    assert np.all(np.diff(found.steps) > 0)


@pytest.mark.parametrize("end", [1e-5, 1e-3, 0.02, 0.06, 1.0, 60.0])
def test_records_of_any_length(end):
    """A contact is neither skipped in a long record nor needed in a short one; the record's end changes nothing."""
    law, conditions = ContactLaw(Ball()), collect(2e6, 0.5)
    short = strike(law, conditions, jnp.linspace(0.0, end, 125))
    fine = strike(law, conditions, TIMES)
    assert bool(short.separated) == (end > float(fine.separation)) and not short.failed and is_finite(short)
    if short.separated:
        np.testing.assert_allclose(short.separation, fine.separation, rtol=1e-6)
        np.testing.assert_allclose(short.rebound_speed, fine.rebound_speed, rtol=1e-6)
    else:
        np.testing.assert_allclose(short.separation, end, rtol=1e-12)


@pytest.mark.slow
def test_before_and_after_contact():
    """Nothing at t <= 0 and after separation; the gas at P0 before, all of it back after."""
    found = strike(ContactLaw(Ball()), collect(1e6, 0.4))
    outside = (TIMES <= 0) | (TIMES >= found.separation)
    assert outside.any() and not found.normal_force[outside].any() and not found.depression[outside].any()
    np.testing.assert_allclose(found.pressure[outside], 1e6, rtol=1e-12)
    before = strike(ContactLaw(Ball()), collect(1e6, 0.4), TIMES - 1.0)
    assert is_finite(before) and not before.normal_force.any() and not before.failed


def test_strong_servo_keeps_the_ball_on_the_plate():
    """No separation within the record is an answer, not a failure."""
    found = strike(ContactLaw(Ball(), (ArmServo(4000.0),)), collect(1e6, 0.4))
    assert not found.separated and not found.failed and is_finite(found)
    assert float(found.separation) == float(TIMES[-1]) and found.normal_force[-1] > 0


def test_no_gas_gives_no_force():
    """P0 = 0 without a wall: the ball is never stopped, no force and no NaN, and `separated` says so."""
    for times in (TIMES, jnp.linspace(0.0, 1.0, 125)):  # in the second it would be squeezed flat
        found = strike(ContactLaw(Ball()), collect(0.0, 0.4), times)
        assert not found.separated and not found.failed and is_finite(found)
        assert not found.normal_force.any() and not found.pressure.any()
        np.testing.assert_allclose(found.rebound_speed, -0.4, rtol=1e-9)
    wall = strike(ContactLaw(Ball(), (WallStiffness(3000.0),)), collect(0.0, 0.4), jnp.linspace(0.0, 1.0, 125))
    assert wall.separated and is_finite(wall)
    np.testing.assert_allclose(wall.rebound_speed, 0.28, atol=1e-6)


@pytest.mark.parametrize("part", ["mass", "restitution", "pressure", "speed", "sensor"])
def test_nan_says_so(part):
    """NaN in any parameter or condition ends as `failed`."""
    value = {name: jnp.nan if name == part else good for name, good in
             (("mass", 1.2), ("restitution", 0.7), ("pressure", 1e6), ("speed", 0.4), ("sensor", 1.1))}
    law = ContactLaw(Ball(value["mass"], value["restitution"]), (SensorGain(value["sensor"]),))
    assert strike(law, collect(value["pressure"], value["speed"])).failed


def test_too_few_steps_says_so():
    """A solve that runs out of steps has failed."""
    found = strike(ContactLaw(Ball()), collect(1e6, 0.4), max_steps=8)
    assert found.failed and not found.separated


@pytest.mark.slow
def test_a_general_solver_finds_the_same():
    """diffrax with its own steps, event and method of order 8, on the same equation of motion with all effects on."""
    law, conditions = SPACE.build(jnp.asarray(SPACE.coordinates(EVERYTHING))), collect(1.3e6, 0.5)
    diameter, damping = law.start(conditions)

    def field(time, y, _):
        contact = law.contact(conditions, diameter, time, y[0], y[1], y[2:])
        forces = law.forces(contact, damping, y[2:])
        acceleration = (forces.drive - forces.normal) / law.reference.inertia()
        return jnp.concatenate([jnp.stack([y[1], acceleration]), law.rates(contact, y[2:])])

    found = simulate_impact(law, conditions, TIMES)
    inside = (TIMES > 0) & (TIMES < found.separation)
    solution = dfx.diffeqsolve(
        dfx.ODETerm(field), dfx.Dopri8(), 0.0, 0.06, 1e-5, jnp.concatenate([jnp.array([0.0, 0.5]), law.begin_states()]),
        stepsize_controller=dfx.PIDController(rtol=1e-10, atol=1e-13), max_steps=20_000,
        saveat=dfx.SaveAt(ts=TIMES[inside]),
        event=dfx.Event(lambda t, y, args, **_: y[0], optx.Newton(1e-13, 1e-13), direction=False))
    assert solution.ys.shape[0] == inside.sum()
    np.testing.assert_allclose(found.depression[inside], solution.ys[:, 0], atol=1e-6 * solution.ys[:, 0].max())
    np.testing.assert_allclose(found.depression_rate[inside], solution.ys[:, 1], atol=1e-5 * 0.5)


@pytest.mark.slow
def test_a_ball_that_barely_comes_off():
    """An arm that all but keeps the ball on the plate: SciPy's instants of separation, and their differences."""
    def build(stiffness):
        return ContactLaw(Ball(1.7764, 0.72886), (ArmServo(stiffness),))

    @jax.jit
    def field(time, y, stiffness, speed):
        law, conditions = build(stiffness), collect(0.513e6, speed)
        diameter, damping = law.start(conditions)
        contact = law.contact(conditions, diameter, time, y[0], y[1], y[2:])
        forces = law.forces(contact, damping, y[2:])
        return jnp.stack([y[1], (forces.drive - forces.normal) / law.reference.inertia()])

    def leave(time, y, *_):
        return y[0] if time > 1e-3 else 1.0

    leave.terminal = True

    def separate(stiffness, speed):
        return integrate.solve_ivp(lambda *given: np.asarray(field(*given)), (0.0, 0.14), [0.0, speed], "DOP853",
                                   events=leave, args=(stiffness, speed), rtol=1e-11, atol=1e-13).t_events[0][0]

    times = jnp.arange(565) * 2.5e-4
    along = jax.jit(lambda stiffness, speed: jax.jvp(lambda k: strike(
        build(k), collect(0.513e6, speed), times).separation, (stiffness,), (jnp.ones(()),)))
    for speed in np.linspace(0.18166, 0.18215, 8):
        end, slope = along(jnp.asarray(439.65), jnp.asarray(speed))
        np.testing.assert_allclose(end, separate(439.65, speed), atol=2e-7)
        differences = (separate(439.66, speed) - separate(439.64, speed)) / 0.02
        np.testing.assert_allclose(slope, differences, rtol=2e-3)


def describe(u, change, **options):
    """Smooth functionals of the samples through onset and separation, the rebound and the separation.

    `u`: coordinates of the whole catalogue; `change`: of the logarithms of pressure and speed, then of `u`.
    """
    conditions = collect(1.3e6 * jnp.exp(change[0]), 0.5 * jnp.exp(change[1]))
    found = simulate_impact(SPACE.build(u + change[2:]), conditions, TIMES, **options)
    weights = jnp.sin(1.0 + jnp.arange(TIMES.size) / 9.0)
    return jnp.stack([jnp.sum(weights * found.normal_force), found.rebound_speed, found.separation,
                      jnp.sum(weights * found.depression), jnp.sum(weights * found.pressure)])


@pytest.mark.slow
def test_forward_gradient_is_that_of_differences():
    """All parameters, pressure and speed, through onset and separation; with all effects on, and without the clamp."""
    tight = dict(rtol=1e-11, atol=1e-13, max_steps=512)
    directions = jnp.diag(jnp.asarray(np.concatenate([[1.0, 1.0], SPACE.scales()])))
    still = jnp.zeros(len(directions))

    @jax.jit
    def derive(u, h):
        along = lambda change: describe(u, change, **tight)
        jacobian = jax.vmap(lambda d: jax.jvp(along, (still,), (d,))[1])(directions)
        values = jax.vmap(along)(jnp.concatenate([k * h * directions for k in (-2, -1, 1, 2)]))
        far, near, next_, last = values.reshape(4, len(directions), -1)
        return jacobian, (far - 8 * near + 8 * next_ - last) / (12 * h)

    # At the null of these two the clamp at zero begins to bite: the readings have no second derivative there.
    clamped = ("viscoelastic-wall.k_v", "viscous-dashpot.c_v")
    smooth = {name: 0.0 if name in clamped else value for name, value in EVERYTHING.items()}
    # A clamp inside a step of the integrator costs its derivative two digits.
    for values, skipped, h, limit in ((smooth, clamped, 1e-3, 1e-7), (EVERYTHING, (), 1e-4, 3e-5)):
        jacobian, differences = derive(jnp.asarray(SPACE.coordinates(values)), h)
        largest = np.abs(differences).max(axis=0)
        for name, row, expected in zip(["pressure", "speed", *SPACE.index], jacobian, differences, strict=True):
            if name in skipped:
                continue
            error = np.abs(row - expected)
            assert (error <= 1e-5 * np.abs(expected) + limit * largest).all(), (name, error / largest)
            assert np.abs(row).max() > 0 or name == "viscoelastic-wall.tau", name


@pytest.mark.slow
def test_reverse_gradient_is_forward_gradient():
    """Reverse mode agrees with forward mode; a state and a sensor are included."""

    def functional(values):
        law = ContactLaw(Ball(values[0], values[1]), (ViscoelasticWall(values[2], values[3]), SensorLag(values[6])))
        found = simulate_impact(law, collect(values[4], values[5]), TIMES, rtol=1e-9, atol=1e-11)
        weights = jnp.sin(1.0 + jnp.arange(TIMES.size) / 9.0)
        return jnp.sum(weights * found.normal_force) + 30 * found.rebound_speed + 200 * found.separation

    start = jnp.array([1.2, 0.7, 800.0, 4e-3, 1e6, 0.4, 5e-4])
    found, expected = (jax.jit(mode(functional))(start) for mode in (jax.grad, jax.jacfwd))
    np.testing.assert_allclose(found, expected, rtol=1e-9)


@eqx.filter_jit
def push(u, conditions, direction):
    """One impact of the whole catalogue at coordinates u, and its derivative along a direction."""
    return jax.jvp(lambda v: (lambda f: (f.normal_force, f.separation, f.failed.astype(float)))(
        simulate_impact(SPACE.build(v), conditions, TIMES)), (u,), (direction,))


NAMES = ["effective_mass", "restitution", *EVERYTHING]


@pytest.mark.slow
@settings(max_examples=40)
@given(
    st.lists(st.floats(-1.0, 1.0), min_size=len(NAMES), max_size=len(NAMES)), st.floats(5.0, 6.6), st.floats(0.03, 1.5)
)
def test_any_valid_parameters_are_finite(shares, log_pressure, speed):
    """Values and derivatives are finite wherever parameters and conditions make sense."""
    u = SPACE.coordinates()
    for name, share in zip(NAMES, shares, strict=True):
        slot = SPACE.slots[SPACE.index[name]].parameter
        amount = abs(share) if slot.sign > 0 else share
        u[SPACE.index[name]] += amount * SPACE.scales()[SPACE.index[name]]
    conditions = collect(10**log_pressure, speed)
    (force, separation, failed), slopes = push(jnp.asarray(u), conditions, jnp.asarray(SPACE.scales()))
    assert not failed and np.isfinite(force).all() and separation > 0
    assert all(np.isfinite(slope).all() for slope in slopes)


@pytest.mark.slow
@pytest.mark.parametrize(("law", "limit"), [
    (ContactLaw(Ball()), 1e-5), (ContactLaw(Ball(), (ArmServo(200.0),)), 1e-5),
    (ContactLaw(Ball(), (SensorLag(5e-4),)), 1e-5), (SPACE.build(jnp.asarray(SPACE.coordinates(EVERYTHING))), 2e-4)])
def test_force_from_motion_is_that_of_the_law(law, limit):
    """F_n = F_drive - m dw/dt at the sample times; separation and motion are the same."""
    for pressure, speed in ((1e6, 0.4), (2.4e6, 0.66)):
        direct, read = (strike(law, collect(pressure, speed), from_motion=way) for way in (False, True))
        assert jnp.abs(direct.normal_force - read.normal_force).max() < limit * direct.normal_force.max()
        assert direct.separation == read.separation
        np.testing.assert_array_equal(direct.depression, read.depression)


GOOD = {"initial_pressure": 1.2e6, "approach_speed": 0.4}


@pytest.mark.parametrize(("change", "message"), [
    ({"approach_speed": None}, "simulate needs the condition 'approach_speed'"),
    ({"initial_pressure": None}, "simulate needs the condition 'initial_pressure'"),
    ({"approach_speed": 0.0}, "approach_speed must be positive; it is 0"),
    ({"approach_speed": "0.3 m/s"}, "approach_speed must be a number in SI units"),
    ({"initial_pressure": float("nan")}, "initial_pressure is nan"),
    ({"approach_speed": np.array([0.1, 0.2])}, "batch impacts by jax.vmap"),
])  # fmt: skip
def test_simulate_refuses_conditions(change, message):
    """What is missing or no use is named, before anything is compiled."""
    conditions = {k: v for k, v in (GOOD | change).items() if v is not None}
    with pytest.raises(InputError, match=message):
        simulate_impact(ContactLaw(Ball()), conditions, TIMES)


@pytest.mark.slow
def test_simulate_takes_plain_numbers_and_refuses_the_rest():
    """Floats, lists and a reference model alone do; times, laws and masses that do not are named."""
    times = list(TIMES[::20])
    found = simulate_impact(Ball(), GOOD, times)
    wrapped = strike(ContactLaw(Ball()), collect(1.2e6, 0.4), jnp.asarray(times))
    np.testing.assert_allclose(found.normal_force, wrapped.normal_force, rtol=1e-9, atol=1e-9)
    for wrong, message in ((0.01, "one-dimensional"), ([], "at least one time"), ([0.0, np.nan], "time number 2")):
        with pytest.raises(InputError, match=message):
            simulate_impact(Ball(), GOOD, wrong)
    with pytest.raises(InputError, match="needs a ContactLaw"):
        simulate_impact(CoulombFriction(), GOOD, times)
    with pytest.raises(InputError, match="effective_mass must be positive; it is -1"):
        simulate_impact(Ball(effective_mass=-1.0), GOOD, times)
    free = PowerLaw(exponent=1.5)  # without gas no pressure is needed
    assert "gas" not in free.provides
    assert is_finite(simulate_impact(free, {"approach_speed": 0.4}, times))
