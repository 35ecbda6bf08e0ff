"""Every effect of the catalogue against the independent simulator, alone and together, in all channels."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ddetumble.contact.effect import parameters_of
from ddetumble.contact.law import Ball, ContactLaw
from ddetumble.dynamics.impact import simulate_impact
from ddetumble.effects import IMPACT, catalogue
from ddetumble.exam.simulators import impact as independent
from ddetumble.inference.parameters import ParameterSpace


SPACE = ParameterSpace(Ball(), IMPACT)
CHANNELS = independent.CHANNELS
BASE = {"effective_mass": 1.4, "restitution": 0.72}
CASES = {
    "none": {},
    "polytropic-gas": {"polytropic-gas": {"n": 1.4}},
    "ambient-pressure": {"ambient-pressure": {"p_a": 1.0e5}},
    "wall-stiffness": {"wall-stiffness": {"k_w": 1500.0, "q": 1.0}},
    "wall-stiffness, steep": {"wall-stiffness": {"k_w": 4e4, "q": 1.7}},
    "membrane-area": {"membrane-area": {"alpha": 0.4}},
    "inflation-growth": {"inflation-growth": {"beta": 0.6}},
    "gas-leak": {"gas-leak": {"lambda": 8.0}},
    "viscoelastic-wall": {"viscoelastic-wall": {"k_v": 2500.0, "tau": 4e-3}},
    "viscoelastic-wall, fast": {"viscoelastic-wall": {"k_v": 2500.0, "tau": 3e-4}},
    "viscous-dashpot": {"viscous-dashpot": {"c_v": 12.0}},
    "adhesion": {"adhesion": {"tau_a": 4e4}},
    "arm-servo": {"arm-servo": {"k_s": 300.0}},
    "arm-servo, no separation": {"arm-servo": {"k_s": 2500.0}},
    "speed-dependent-restitution": {"speed-dependent-restitution": {"p": 0.2}},
    "pressure-dependent-restitution": {"pressure-dependent-restitution": {"p": 0.15}},
    "stress-softening": {"stress-softening": {"sigma_m": 0.25, "j_0": 2.0}},
    "sensor-hysteresis": {"sensor-hysteresis": {"h": 0.1, "w": 20.0}},
    "sensor-hysteresis, narrow": {"sensor-hysteresis": {"h": 0.2, "w": 2.0}},
    "sensor-highpass": {"sensor-highpass": {"tau_s": 0.08}},
    "sensor-lag": {"sensor-lag": {"T": 1.5e-3}},
    "sensor-filter": {"sensor-filter": {"f_c": 200.0}},
    "sensor-gain": {"sensor-gain": {"g": 1.08}},
    "sensor-resonance": {"sensor-resonance": {"f_0": 130.0, "zeta": 0.06}},
    "sensor-resonance, high": {"sensor-resonance": {"f_0": 1500.0, "zeta": 0.01}},
    "sensor-resonance, chain": {"sensor-resonance": {"f_0": 130.0, "zeta": 0.2}, "sensor-highpass": {"tau_s": 0.08},
                                "sensor-lag": {"T": 1.5e-3}, "sensor-gain": {"g": 1.08},
                                "sensor-filter": {"f_c": 300.0}, "sensor-hysteresis": {"h": 0.1, "w": 10.0}},
    "everything": {
        "polytropic-gas": {"n": 1.2}, "ambient-pressure": {"p_a": 5e4}, "wall-stiffness": {"k_w": 500.0, "q": 1.0},
        "membrane-area": {"alpha": 0.1}, "inflation-growth": {"beta": 0.2}, "gas-leak": {"lambda": 2.0},
        "viscoelastic-wall": {"k_v": 500.0, "tau": 5e-3}, "viscous-dashpot": {"c_v": 1.0}, "adhesion": {"tau_a": 5e3},
        "arm-servo": {"k_s": 100.0}, "speed-dependent-restitution": {"p": 0.05},
        "pressure-dependent-restitution": {"p": 0.05}, "stress-softening": {"sigma_m": 0.05, "j_0": 3.0},
        "sensor-highpass": {"tau_s": 0.5}, "sensor-lag": {"T": 5e-4}, "sensor-gain": {"g": 1.03},
        "sensor-filter": {"f_c": 300.0}, "sensor-resonance": {"f_0": 250.0, "zeta": 0.1},
        "sensor-hysteresis": {"h": 0.05, "w": 10.0},
    },
}  # fmt: skip
# The sensor's deviation from the force is kept at 64 instants of contact: enough for the smooth deviation that a lag
# leaves, coarse for the 0.1 ms in which adhesion sets in at full depth.
TOLERANCES = {"sensor-hysteresis": 3e-5, "sensor-hysteresis, narrow": 2e-4, "sensor-lag": 3e-5, "sensor-filter": 3e-5,
              "sensor-resonance": 4e-5, "sensor-resonance, high": 3e-4, "sensor-resonance, chain": 4e-5,
              "everything": 2e-3}
CONDITIONS = [(1.0e6, 0.4, 1.0), (0.5e6, 0.15, 3.0), (2.4e6, 0.7, 12.0)]
TIMES = {
    "dense": np.linspace(-0.003, 0.08, 84),
    "coarse": np.concatenate([[-0.01, 0.0], np.linspace(2e-4, 0.03, 12), np.geomspace(0.033, 0.25, 70)]),
}


def set_coordinates(effects):
    """Coordinates of the whole catalogue for `effects` as the independent simulator names them."""
    values = dict(BASE)
    for owner, parameters in effects.items():
        for name, value in parameters.items():
            declared = SPACE.slots[SPACE.index[f"{owner}.{name}"]].parameter
            values[f"{owner}.{name}"] = declared.transform.find_field(value)
    return SPACE.coordinates(values)


@jax.jit
def run_batch(u, conditions, times):
    """Many records of the whole catalogue in one program."""
    names = ("initial_pressure", "approach_speed", "sequence")
    one = lambda u, c, t: simulate_impact(SPACE.build(u), dict(zip(names, c, strict=True)), t)
    return jax.vmap(one)(u, conditions, times)


@pytest.fixture(scope="module")
def records():
    """Channels of every case, condition and sampling, (cases, conditions, samplings) to (times, channels)."""
    keys = [(case, k, sampling) for case in CASES for k in range(len(CONDITIONS)) for sampling in TIMES]
    u = np.array([set_coordinates(CASES[case]) for case, _, _ in keys])
    found = run_batch(jnp.asarray(u), jnp.asarray([CONDITIONS[k] for _, k, _ in keys]),
                      jnp.asarray(np.array([TIMES[s] for _, _, s in keys])))
    assert not found.failed.any()
    table = np.stack([np.asarray(getattr(found, name)) for name in CHANNELS], axis=-1)
    separated = dict(zip(keys, np.asarray(found.separated), strict=True))
    return dict(zip(keys, table, strict=True)), separated


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_agrees_with_independent_simulator(records, case):
    """Within 1e-5 (see TOLERANCES) of every channel's peak, before, in and after contact, finely or coarsely."""
    for k, (pressure, speed, sequence) in enumerate(CONDITIONS):
        conditions = {"initial_pressure": pressure, "approach_speed": speed, "sequence": sequence}
        for sampling, times in TIMES.items():
            expected = independent.simulate(BASE, CASES[case], conditions, times, CHANNELS)
            error = np.abs(records[0][case, k, sampling] - expected).max(axis=0) / np.abs(expected).max(axis=0)
            limit = [TOLERANCES.get(case, 1e-5), 1e-5, 1e-5]
            assert (error < limit).all(), (sampling, conditions, dict(zip(CHANNELS, error, strict=True)))


def test_servo_holds_the_ball(records):
    """The strong servo is the case without a separation; all others separate in the long record."""
    held = {case for (case, _, sampling), separated in records[1].items() if sampling == "coarse" and not separated}
    assert "arm-servo, no separation" in held and held <= {"arm-servo, no separation", "arm-servo", "everything"}


@pytest.mark.slow
def test_null_of_every_effect_changes_nothing():
    """The whole catalogue at its nulls is the reference model, within rounding, steps of the integrator included."""
    given = {"initial_pressure": 1e6, "approach_speed": 0.4, "sequence": 4.0}
    conditions = {name: jnp.asarray(value) for name, value in given.items()}
    times = jnp.asarray(TIMES["dense"])
    bare = jax.jit(lambda t: simulate_impact(ContactLaw(Ball()), conditions, t))(times)
    start = jnp.asarray(SPACE.coordinates())
    whole = jax.jit(lambda u, t: simulate_impact(SPACE.build(u), conditions, t))(start, times)
    assert int(bare.steps) == int(whole.steps)
    for name in (*CHANNELS, "separation", "rebound_speed"):
        largest = np.abs(getattr(bare, name)).max()
        np.testing.assert_allclose(getattr(whole, name), getattr(bare, name), rtol=0, atol=1e-13 * largest)


def test_catalogue_is_complete():
    """The nineteen effects of the second simulator under their public names, with the parameters that it has."""
    declared = {effect.id: {p.name for p in parameters_of(effect)} for effect in catalogue()}
    expected = {name: set(null) for name, null in independent.NULLS.items() if not name.startswith("x-")}
    assert declared == expected and len(declared) == 19
    with pytest.raises(ValueError, match="there is no family 'moon'"):
        catalogue("moon")


def test_nulls_are_those_of_the_catalogue():
    """A parameter's default is its null; the high-pass holds 1/tau_s and the resonance 1/f_0, whose null is 0."""
    for effect in IMPACT:
        for one in parameters_of(effect):
            if one.kind == "amplitude":
                null = independent.NULLS[effect.id][one.name]
                assert one.default == one.transform.find_field(null)
                assert one.transform.from_field(one.default) == one.default
