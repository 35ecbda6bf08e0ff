"""The friction law (Eqs. 8 to 11), its range, strokes, and slip records against a second simulator."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ddetumble import CoulombFriction, RubberFriction, check_effect
from ddetumble.contact import FrictionLaw
from ddetumble.contact.effect import parameters_of, stage_of
from ddetumble.contact.friction import (
    CHANGES_SIGN_AT,
    DIVERGES_ABOVE,
    describe_range,
    rubber_coefficient,
    slip_coefficient,
    slip_coefficients,
)
from ddetumble.dynamics import simulate_sliding
from ddetumble.effects import catalogue
from ddetumble.effects.directions import SLIP_DIRECTIONS
from ddetumble.effects.slip import FrictionalHeating, Presliding
from ddetumble.exam.simulators.slip import simulate_slip
from ddetumble.families.slip import split_strokes


SLIP = catalogue("slip")
BY_ID = {effect.id: effect for effect in SLIP}
BASE = {"adhesion_constant": 0.83, "loss_factor": 0.16, "tensile_strength": 10e6, "real_contact_pressure": 20e6,
        "slip_scale": 0.97}  # fmt: skip
CONDITIONS = {"normal_load": 14.0, "internal_pressure": 1.3e6, "slip_speed": 0.07}
VALUES = {
    "stribeck": {"A": 0.3, "u_s": 0.08}, "viscous-friction": {"c_t": 0.9}, "load-exponent": {"m": 0.06},
    "presliding": {"s_0": 2.2e-4}, "frictional-heating": {"kappa": 4.0}, "adhesive-offset": {"f_a": 0.25},
}  # fmt: skip


def build(effects):
    """Law of the reference model with effects by id."""
    return FrictionLaw(RubberFriction(**BASE), tuple(BY_ID[name](**values) for name, values in effects.items()))


def run(law, slip, conditions=CONDITIONS, direction=None):
    """Friction along a path."""
    conditions = {name: jnp.asarray(value) for name, value in conditions.items()}
    return simulate_sliding(law, conditions, jnp.asarray(slip), direction)


def test_eq8_by_hand():
    found = rubber_coefficient(*(jnp.asarray(x) for x in (0.9, 0.2, 0.5, 1.2e6, 1.0e7)))
    assert float(found) == pytest.approx(0.2 * (np.pi / 4 * 0.9 * 0.5 + np.pi / 10 * 0.36 ** (2 / 3)), rel=1e-14)
    no_pressure = jax.grad(lambda p: rubber_coefficient(0.9, 0.2, 0.5, p, 1e7))(0.0)
    assert np.isfinite(no_pressure)


def test_eq10_at_10_newtons_by_hand():
    a, b, c, d, e = (float(x) for x in slip_coefficients(jnp.asarray(10.0), printed=True))
    assert (a, b) == (pytest.approx(0.57929), pytest.approx(-0.2497886))
    assert (c, d, e) == (pytest.approx(-1.0248138), pytest.approx(0.116019), pytest.approx(2.1122112))
    s = 3.0
    expected = a + a * np.exp(b * s) * (c * np.sinh(d * s) - e * np.cosh(d * s))
    assert float(slip_coefficient(jnp.asarray(3e-3), slip_coefficients(jnp.asarray(10.0), True))) == pytest.approx(
        expected, rel=1e-12)


@pytest.mark.parametrize("load", [5.0, 12.0, 20.0, 28.0])
def test_the_corrected_curve_rises_from_nothing_and_the_printed_one_does_not(load):
    """Contradiction 5: with e = 1 the curve starts at 0 with slope 0.076 to 0.089 per mm; as printed it is negative."""
    mine = slip_coefficients(jnp.asarray(load))
    assert float(slip_coefficient(jnp.asarray(0.0), mine)) == pytest.approx(0.0, abs=1e-15)
    slope = float(jax.grad(lambda s: slip_coefficient(s, mine))(0.0)) * 1e-3
    assert 0.07 < slope < 0.1
    assert float(slip_coefficient(jnp.asarray(0.0), slip_coefficients(jnp.asarray(load), True))) < 0


def test_range_of_the_polynomials():
    """a changes sign at 44.4 N; from 30.65 N on the curve grows without limit."""
    assert pytest.approx(44.3996, abs=1e-3) == CHANGES_SIGN_AT and pytest.approx(30.652, abs=1e-3) == DIVERGES_ABOVE
    far = jnp.asarray([0.2, 0.4])
    below, above = (slip_coefficient(far, slip_coefficients(jnp.asarray(x))) for x in (30.0, 31.5))
    assert abs(float(below[1] - below[0])) < 0.3 and abs(float(above[1])) > 10 * abs(float(above[0]))
    assert float(slip_coefficients(jnp.asarray(44.3))[0]) > 0 > float(slip_coefficients(jnp.asarray(44.5))[0])
    assert describe_range(25.0) == "" and "diverges" in describe_range(35.0) and "negative" in describe_range(50.0)


@pytest.mark.parametrize("names", [[], *([name] for name in VALUES), ["stribeck", "frictional-heating"], list(VALUES)],
                         ids="+".join)  # fmt: skip
def test_against_the_independent_simulator(names):
    effects = {name: VALUES[name] for name in names}
    slip = np.linspace(0.0, 0.012, 121)
    expected = np.ravel(simulate_slip(BASE, effects, CONDITIONS, slip))
    found = run(build(effects), slip)
    assert not found.failed
    np.testing.assert_allclose(found.tangential_force, expected, atol=2e-8)


@pytest.mark.slow
def test_work_converges_with_the_fourth_power_of_the_spacing():
    law = build({"presliding": {"s_0": 1e-3}, "frictional-heating": {"kappa": 60.0}})
    ends = [float(run(law, np.linspace(0.0, 0.012, n)).work[-1]) for n in (13, 25, 49, 1537)]
    errors = np.abs(np.array(ends[:-1]) - ends[-1])
    orders = np.log2(errors[:-1] / errors[1:])
    assert np.all((3.3 < orders) & (orders < 4.7)), orders


def test_heating_of_a_constant_coefficient_in_closed_form():
    """dW/ds = mu F exp(-kappa W) has W = ln(1 + kappa mu F s)/kappa."""
    kappa, mu, load = 30.0, 0.4, 12.0
    law = FrictionLaw(CoulombFriction(friction_coefficient=mu), (FrictionalHeating(kappa=kappa),))
    slip = np.linspace(0.0, 0.02, 201)
    found = run(law, slip, {"normal_load": load})
    np.testing.assert_allclose(found.work, np.log1p(kappa * mu * load * slip) / kappa, rtol=1e-9, atol=1e-12)


def test_presliding_has_its_limits():
    """Nothing at the start of a stroke, all of it after many times s_0; exactly absent at s_0 = 0."""
    law = FrictionLaw(CoulombFriction(friction_coefficient=0.4), (Presliding(s_0=2e-4),))
    found = run(law, [0.0, 2e-4, 0.02], {"normal_load": 10.0}).tangential_force
    np.testing.assert_allclose(found, [0.0, 4.0 * (1 - np.exp(-1)), 4.0], atol=1e-12)


@pytest.mark.parametrize("effect", [*SLIP, *SLIP_DIRECTIONS], ids=lambda effect: effect.id)
def test_contract(effect):
    assert check_effect(effect).require().ok
    assert stage_of(effect) in ("rubber", "load", "friction")


def test_contract_is_broken_by_a_wrong_effect():
    """A null that is not absent, and an amplitude that nothing reads."""
    from typing import ClassVar

    from ddetumble.contact.effect import parameter
    from ddetumble.contact.sliding import AbstractLoadEffect

    class Wrong(AbstractLoadEffect):
        k: jax.Array = parameter("N", 0.0)
        id: ClassVar[str] = "wrong"
        law: ClassVar[str] = "mu times 1.001"
        reference: ClassVar[str] = "none"

        def factor(self, simulate_sliding):
            return 1.001 + 0.0 * self.k

    broken = {check.name for check in check_effect(Wrong).failures}
    assert broken == {"absent at its null", "k alive"}


def test_contract_says_what_a_model_lacks():
    """Eq. 8's part is the model's to provide: no record's condition stands in for it."""
    from ddetumble.contact.sliding import AbstractFriction

    class Bare(AbstractFriction):
        provides = ()

        def rubber(self, simulate_sliding):
            return jnp.asarray(0.3)

        def slipping(self, simulate_sliding):
            return jnp.zeros(())

    (effect,) = [effect for effect in SLIP if effect.id == "presliding"]
    gap = check_effect(effect, Bare()).failures[0]
    assert gap.name == "complete"


@pytest.mark.slow
def test_gradients_agree():
    """Forward = reverse = differences, in all parameters at once, heating among them."""
    slip = np.linspace(0.0, 0.012, 41)
    fields = [(name, p.field) for name, effect in BY_ID.items() for p in parameters_of(effect)]
    values = jnp.asarray([VALUES[name][field] for name, field in fields])
    weights = jnp.cos(jnp.arange(41.0))

    def total(x):
        effects = {name: {f: x[k] for k, (n, f) in enumerate(fields) if n == name} for name in BY_ID}
        return jnp.sum(weights * run(build(effects), slip).tangential_force)

    forward, reverse = jax.jacfwd(total)(values), jax.grad(total)(values)
    np.testing.assert_allclose(forward, reverse, rtol=1e-10)
    for k, value in enumerate(values):
        step = 1e-5 * value * jnp.eye(len(values))[k]
        difference = (total(values + step) - total(values - step)) / (2e-5 * value)
        np.testing.assert_allclose(forward[k], difference, rtol=1e-6)


@settings(max_examples=40, deadline=None)
@given(st.lists(st.floats(0.002, 0.02), min_size=1, max_size=6), st.floats(0.0, 2e-5), st.integers(0, 2**31))
def test_strokes_of_a_noisy_zigzag(lengths, noise, seed):
    """Turning points, distances and directions come back whatever the lengths; noise adds no stroke."""
    path, ends, way = [0.0], [], 1.0
    for length in lengths:
        path += list(path[-1] + way * np.linspace(0.0, length, 60)[1:])
        ends.append(len(path) - 1)
        way = -way
    path = np.array(path)
    slip = path + noise * np.random.default_rng(seed).standard_normal(len(path))
    distance, direction, number = split_strokes(slip, max(10 * noise, 2e-4))
    assert number[-1] == len(lengths) - 1
    begin = 0
    for k, end in enumerate(ends):
        inside = slice(begin + 8, end - 8)
        np.testing.assert_array_equal(direction[inside], 1.0 if k % 2 == 0 else -1.0)
        np.testing.assert_allclose(distance[inside], np.abs(path[inside] - path[begin]), atol=12 * noise + 1e-12)
        begin = end


def test_reversed_strokes_against_the_independent_simulator():
    """Work goes on over a reversal, slip begins anew, the force turns round."""
    effects = {"presliding": {"s_0": 3e-4}, "frictional-heating": {"kappa": 3.0}}
    path, strokes = np.linspace(0.0, 0.024, 385), [0.008, 0.008, 0.008]
    position = np.where(path <= 0.008, path, np.where(path <= 0.016, 0.016 - path, path - 0.016))
    distance, direction, _ = split_strokes(position, 1e-5)
    found = run(build(effects), distance, direction=jnp.asarray(direction)).tangential_force
    expected = np.ravel(simulate_slip(BASE, effects, CONDITIONS, path, strokes=strokes))
    np.testing.assert_allclose(found, expected, atol=1e-6)
