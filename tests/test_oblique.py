"""Oblique impacts: slip, grip and reversal against closed forms and an independent simulator; energy; derivatives."""

import dataclasses as dc
import json
import shutil

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest

from ddetumble import Ball, InputError, check_effect, discover, find_data, fit, import_tests, predict, read_campaign
from ddetumble.contact import Striker
from ddetumble.contact.effect import parameter, parameters_of
from ddetumble.contact.gripping import AbstractComplianceEffect, share_friction, solve_slider
from ddetumble.contact.law import ContactLaw, PowerLaw
from ddetumble.contact.sliding import AdhesionHysteresis, CoulombFriction, RubberFriction, Slide
from ddetumble.dynamics import simulate_impact
from ddetumble.dynamics import simulate_oblique_impact as run_strike
from ddetumble.dynamics.impact import follow, read_motion
from ddetumble.dynamics.strike import _COURSE, grip
from ddetumble.effects import OBLIQUE
from ddetumble.effects.directions import OBLIQUE_DIRECTIONS
from ddetumble.effects.impact import ArmServo, SensorLag, ViscoelasticWall, ViscousDashpot, WallStiffness
from ddetumble.effects.oblique import OffCentreReaction, SensorCrosstalk, TangentialCompliance
from ddetumble.effects.slip import (
    AdhesiveOffset,
    FrictionalHeating,
    LoadExponent,
    Presliding,
    Stribeck,
    ViscousFriction,
)
from ddetumble.exam.simulators.campaigns import write_package
from ddetumble.exam.simulators.oblique import CHANNELS, integrate_strike, simulate_strike
from ddetumble.exam.simulators.oblique_campaigns import make_oblique_campaign
from ddetumble.families import name_family
from ddetumble.inference.archive import resolve_model
from ddetumble.inference.assembly import adapt_reference, assemble_space


EFFECTS = (TangentialCompliance, OffCentreReaction, Stribeck, ViscousFriction, LoadExponent, Presliding,
           FrictionalHeating, AdhesiveOffset, ViscousDashpot, WallStiffness, ViscoelasticWall, ArmServo,
           SensorLag, SensorCrosstalk)
BASE = {"effective_mass": 1.3, "restitution": 0.7, "adhesion_constant": 0.85, "loss_factor": 0.15,
        "tangential_mass": 1.1, "rolling_mass": 0.45}
TRUTH = json.loads((find_data() / "truth.json").read_text(encoding="utf-8"))
TIMES = np.linspace(-2e-3, 0.055, 230)


def build(base=BASE, friction=AdhesionHysteresis, **values):
    """A law with all of `EFFECTS`, at their null unless told otherwise by `id=dict(...)` with underscores."""
    ball = Ball(effective_mass=base["effective_mass"], restitution=base["restitution"])
    own = {p.name: base[p.name] for p in parameters_of(friction) if p.name in base}
    effects = []
    for kind in EFFECTS:
        given = values.get(kind.id.replace("-", "_"), {})
        effects.append(kind(**{p.field: given[p.name] for p in parameters_of(kind) if p.name in given}))
    return Striker(ball, friction(**own), tangential_mass=base["tangential_mass"],
                   rolling_mass=base["rolling_mass"], creep_speed=base.get("creep_speed", 0.01)).extend(tuple(effects))


def set_conditions(pressure=1e6, speed=0.4, slide=0.3):
    """Conditions as arrays."""
    return {"initial_pressure": jnp.asarray(pressure), "approach_speed": jnp.asarray(speed),
            "tangential_speed": jnp.asarray(slide)}


@eqx.filter_jit
def run(law, conditions, times):
    return run_strike(law, conditions, times)


CASES = [
    {}, {"tangential-compliance": {"compliance": 5e-5}}, {"tangential-compliance": {"compliance": 3e-6}},
    {"off-centre-reaction": {"share": 0.12}}, {"stribeck": {"A": 0.3, "u_s": 0.07}, "viscous-friction": {"c_t": 1.5}},
    {"tangential-compliance": {"compliance": 3e-5}, "stribeck": {"A": 0.25, "u_s": 0.08}},
    {"frictional-heating": {"kappa": 8.0}, "presliding": {"s_0": 3e-4}, "load-exponent": {"m": 0.06}},
    {"sensor-crosstalk": {"c_tn": 0.03, "c_nt": -0.05}, "sensor-lag": {"T": 1e-3}},
    {"adhesive-offset": {"f_a": 0.3}, "off-centre-reaction": {"share": 0.1}, "wall-stiffness": {"k_w": 900.0}},
]  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("effects", CASES, ids=lambda e: "+".join(e) or "none")
@pytest.mark.parametrize("slide", [0.1, 0.5])
def test_agrees_with_independent_simulator(effects, slide):
    """Backward Euler in NumPy, extrapolated, with SciPy's DOP853 for the normal motion: all five channels."""
    conditions = {"initial_pressure": 1.2e6, "approach_speed": 0.4, "tangential_speed": slide}
    truth = simulate_strike(BASE, effects, conditions, TIMES)
    law = build(**{name.replace("-", "_"): values for name, values in effects.items()})
    found = run(law, {k: jnp.asarray(v) for k, v in conditions.items()}, jnp.asarray(TIMES))
    assert not bool(found.failed)
    for column, channel in zip(truth.T, CHANNELS, strict=True):
        assert np.abs(np.asarray(getattr(found, channel)) - column).max() < 2e-4 * np.abs(column).max(), channel


@pytest.mark.slow
def test_sliding_throughout_takes_the_friction_impulse():
    """Coulomb without grip: the tangential impulse is mu times the normal one, m_eff (1 + e) v_1."""
    base = BASE | {"friction_coefficient": 0.2, "creep_speed": 1e-5}
    law = build(base, CoulombFriction)
    found = run(law, set_conditions(slide=2.0), jnp.asarray(TIMES))
    impulse = 0.2 * 1.3 * (1 + 0.7) * 0.4
    np.testing.assert_allclose(found.tangential_speed, 2.0 - impulse / 1.1, rtol=1e-6)
    np.testing.assert_allclose(found.rolling_speed, impulse / 0.45, rtol=1e-5)


def test_gripping_patch_rolls_without_slip():
    """A rigid patch that grips ends with v = r omega = m_t u_0/(m_t + m_r), whatever the friction was."""
    base = BASE | {"friction_coefficient": 0.6, "creep_speed": 1e-4}
    found = run(build(base, CoulombFriction), set_conditions(slide=0.1), jnp.asarray(TIMES))
    both = 1.1 * 0.1 / (1.1 + 0.45)
    np.testing.assert_allclose([found.tangential_speed, found.rolling_speed], both, rtol=1e-4)
    assert abs(float(found.tangential_force[np.searchsorted(TIMES, 0.02)])) < 1e-3


def test_spring_reverses_friction_and_a_rigid_patch_does_not():
    """A half swing of the patch's spring during contact sends the ball back (Maw, Barber & Fawcett 1976)."""
    rigid = run(build(), set_conditions(slide=0.12), jnp.asarray(TIMES))
    soft = run(build(tangential_compliance={"compliance": 1e-4}), set_conditions(slide=0.12), jnp.asarray(TIMES))
    assert float(rigid.tangential_force.min()) > -1e-6
    assert float(soft.tangential_force.min()) < -0.5


@pytest.mark.slow
def test_gripped_patch_swings_with_its_own_frequency():
    """With friction that never lets go, f = (u_0/omega C) sin(omega t), omega**2 = (1/m_t + 1/m_r)/C."""
    base = BASE | {"friction_coefficient": 500.0, "creep_speed": 1e-3}
    compliance = 1e-4
    times = np.linspace(2e-3, 0.03, 120)
    found = run(build(base, CoulombFriction, tangential_compliance={"compliance": compliance}),
                set_conditions(slide=0.1), jnp.asarray(times))
    omega = np.sqrt((1 / 1.1 + 1 / 0.45) / compliance)
    swing = 0.1 / (omega * compliance)
    assert np.abs(np.asarray(found.tangential_force) - swing * np.sin(omega * times)).max() < 0.02 * swing


def test_offset_needs_a_ball_that_rolls():
    """Where the ball cannot turn, the offset of the normal force changes neither force: it cannot be seen."""
    clamped = BASE | {"rolling_mass": 1e9}
    plain = run(build(clamped), set_conditions(), jnp.asarray(TIMES))
    moved = run(build(clamped, off_centre_reaction={"share": 0.2}), set_conditions(), jnp.asarray(TIMES))
    np.testing.assert_allclose(moved.tangential_force, plain.tangential_force, atol=1e-6)


@pytest.mark.slow
def test_normal_force_is_that_of_a_straight_impact():
    """Friction on the plate does not change the normal motion."""
    conditions, times = set_conditions(), jnp.asarray(TIMES)
    law = build(wall_stiffness={"k_w": 900.0})
    straight = simulate_impact(ContactLaw(law.reference.ball, law.normal.effects), conditions, times)
    oblique = run(law, conditions, times)
    for channel in ("normal_force", "depression", "pressure", "separation", "rebound_speed"):
        np.testing.assert_allclose(getattr(oblique, channel), getattr(straight, channel), rtol=1e-9, atol=1e-9)


@pytest.mark.slow
def test_energy_balance_closes_over_random_parameters():
    """Change of energy = work of the arm - what contact, slider and rolling took; none of these gives energy back."""
    count, draw = 60, np.random.default_rng(5).uniform
    times = jnp.linspace(0.0, 0.3, 3)

    def ledger(x, c):
        names = ("effective_mass", "restitution", "adhesion_constant", "loss_factor", "tangential_mass",
                 "rolling_mass", "creep_speed")
        law = build(dict(zip(names, x[:7], strict=True)), tangential_compliance={"compliance": x[7]},
                    off_centre_reaction={"share": x[8]}, stribeck={"A": x[9], "u_s": x[10]},
                    viscous_friction={"c_t": x[11]}, load_exponent={"m": x[12]}, presliding={"s_0": x[13]},
                    frictional_heating={"kappa": x[14]}, adhesive_offset={"f_a": x[15]},
                    viscous_dashpot={"c_v": x[16]}, wall_stiffness={"k_w": x[17]},
                    viscoelastic_wall={"k_v": x[18], "tau": x[19]}, arm_servo={"k_s": x[20]})
        found = run_strike(law, c, times)
        m, mt, mr = x[0], x[4], x[5]
        before = 0.5 * m * c["approach_speed"] ** 2 + 0.5 * mt * c["tangential_speed"] ** 2
        after = (0.5 * m * found.rebound_speed**2 + 0.5 * mt * found.tangential_speed**2
                 + 0.5 * mr * found.rolling_speed**2 + found.stored)
        lost = jnp.stack([found.normal_loss, found.friction_loss, found.rolling_loss])
        return (before + found.arm_work - after - jnp.sum(lost)) / before, lost / before, found.failed, found.separated

    ranges = [(0.8, 2), (0.5, 0.95), (0.3, 1.5), (0.05, 0.3), (0.5, 2), (0.2, 2), (0.003, 0.03), (0, 1e-4), (0, 0.3),
              (0, 0.5), (0.03, 0.3), (0, 3), (-0.1, 0.2), (0, 1e-3), (0, 10), (0, 0.5), (0, 8), (0, 1500), (0, 3000),
              (2e-3, 2e-2), (0, 80)]  # fmt: skip
    x = jnp.asarray(np.stack([draw(*r, count) for r in ranges], axis=1))
    conditions = {"initial_pressure": jnp.asarray(draw(3e5, 2.5e6, count)),
                  "approach_speed": jnp.asarray(draw(0.1, 0.8, count)),
                  "tangential_speed": jnp.asarray(draw(0.02, 1.0, count))}
    open_end, lost, failed, separated = eqx.filter_jit(jax.vmap(ledger))(x, conditions)
    assert not bool(failed.any()) and bool(separated.all())
    assert float(jnp.abs(open_end).max()) < 2e-4
    assert float(jnp.median(jnp.abs(open_end))) < 5e-5
    assert float(lost.min()) > -1e-9


@pytest.mark.slow
def test_order_of_the_tangential_integrator():
    """Twice as many steps, an eighth of the error, through slip, grip and reversal."""
    law, conditions = build(tangential_compliance={"compliance": 4e-5}), set_conditions(slide=0.15)
    motion = follow(law.normal, conditions, jnp.asarray(0.1))
    _, course = read_motion(law.normal, conditions, jnp.asarray(TIMES), motion, False, _COURSE)
    found = {n: float(eqx.filter_jit(grip)(law, conditions, motion.diameter, course, n).speed)
             for n in (96, 192, 384, 3072)}
    errors = [abs(found[n] - found[3072]) for n in (96, 192, 384)]
    assert all(6.0 < a / b < 11.0 for a, b in zip(errors[:-1], errors[1:], strict=True)), errors


@pytest.mark.slow
def test_forward_reverse_and_differences_agree():
    """Derivatives of both forces through slip and grip, by parameters and conditions."""
    times = jnp.asarray(TIMES[20:200:3])

    def read(x):
        law = build(BASE | {"tangential_mass": x[0], "adhesion_constant": x[1], "effective_mass": x[4]},
                    tangential_compliance={"compliance": x[2] * 1e-5}, off_centre_reaction={"share": x[3]})
        found = run_strike(law, set_conditions(x[5] * 1e6, x[6], x[7]), times)
        return jnp.stack([jnp.sum(found.tangential_force), jnp.sum(found.normal_force), found.tangential_speed,
                          found.rolling_speed, found.friction_loss, found.slip[-1]])

    x = jnp.asarray([1.1, 0.85, 4.0, 0.1, 1.3, 1.2, 0.4, 0.15])
    forward, reverse = jax.jit(jax.jacfwd(read))(x), jax.jit(jax.jacrev(read))(x)
    largest = np.abs(forward).max(axis=1, keepdims=True)
    assert np.all(np.abs(forward - reverse) < 1e-7 * largest)
    go = jax.jit(read)
    h = 1e-4 * x
    differences = np.stack([(go(x + d) - go(x - d)) / (2 * float(d.sum())) for d in jnp.diag(h)], axis=1)
    assert np.all(np.abs(forward - differences) < 2e-4 * largest)


@pytest.mark.parametrize("push", [-3.0, 0.0, 1e-9, 0.7, 50.0])
@pytest.mark.parametrize("stiff", [0.0, 1e-6, 0.3, 40.0])
def test_slider_solves_its_equation(push, stiff):
    """The one root of A u/sqrt(u**2 + c**2) + B u = R, and its derivative by implicit differentiation."""
    b, c = 0.02, 0.01
    u = solve_slider(*(jnp.asarray(x) for x in (stiff, b, push, c)))
    assert abs(stiff * u / np.hypot(u, c) + b * u - push) < 1e-10 * (abs(push) + 1e-12) + 1e-15
    slope = jax.grad(lambda a: solve_slider(a, jnp.asarray(b), jnp.asarray(push), jnp.asarray(c)))(jnp.asarray(stiff))
    expected = -share_friction(u, c) / (stiff * c**2 / np.hypot(u, c) ** 3 + b)
    np.testing.assert_allclose(slope, expected, rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize("effect", OBLIQUE, ids=lambda e: e.id)
def test_effects_keep_their_contract(effect):
    """Absent at the null to the last bit, alive, compiled once."""
    check_effect(effect).require()


class ThinPatch(AbstractComplianceEffect):
    """A user's own: the patch gives way less the wider it is."""

    c: jax.Array = parameter("m^2/N", 0.0, typical=5e-7, sign=1, starts=(3e-7,), singular=True, text="C b")
    id = "thin-patch"
    law = "compliance c/b"
    reference = "a test"

    def compliance_at(self, patch):
        return self.c / (patch.contact_radius + 1e-4)


class BrokenPatch(ThinPatch):
    """Not absent at its null."""

    id = "broken-patch"

    def compliance_at(self, patch):
        return self.c + 1e-5


@pytest.mark.slow
def test_contract_of_ones_own_effect():
    """Ten lines of a user keep the contract; a law that stays at its null does not."""
    assert check_effect(ThinPatch).ok
    assert "absent at its null" in {c.name for c in check_effect(BrokenPatch).failures}


def test_models_of_oblique_campaigns():
    """An impact campaign with tangential speed and force is oblique; a model of another family is refused."""
    campaign = read_campaign(find_data() / "oblique-a")
    assert name_family(campaign) == "oblique"
    plain = dc.replace(campaign, channels={k: v for k, v in campaign.channels.items() if k != "tangential_force"})
    assert name_family(plain) == "impact"
    assert isinstance(resolve_model("power-law", "oblique").reference.ball, PowerLaw)
    names = [p.name for p in parameters_of(resolve_model("coulomb", "oblique").reference)]
    assert names[:2] == ["effective_mass", "restitution"] and "friction_coefficient" in names
    with pytest.raises(InputError, match="Eq. 10 breaks down"):
        adapt_reference(campaign, Striker(Ball(), RubberFriction()))


@pytest.mark.study
@pytest.mark.parametrize("name", ["oblique-a", "oblique-b", "oblique-c", "oblique-d"])
def test_discover_on_our_campaigns(name, tmp_path):
    """Every campaign's verdict and effects as hidden, its intervals, and its predictions at other conditions."""
    truth, campaign = TRUTH[name], read_campaign(find_data() / name)
    found = discover(campaign)
    assert found.verdict == ("explained" if truth["effects"] else "nothing-missing")
    assert set(found.effects) == set(truth["effects"])
    for effect, values in truth["effects"].items():
        for symbol, value in values.items():
            estimate = found.steps[-1].parameters[f"{effect}.{symbol}"]
            assert abs(estimate.estimate - value) < 3.5 * estimate.sd
    found.save(tmp_path / "model")
    noise = {"normal_force": 0.25, "tangential_force": 0.08, "slip": 2e-5}
    channels = [c for c in ("normal_force", "tangential_force", "slip") if c in campaign.channels]
    rows = pd.concat([pd.DataFrame({"record": f"h{k}", "time": r["x"], **r["conditions"]})
                      for k, r in enumerate(truth["heldout"])])
    mean = predict(tmp_path / "model", rows)
    values = np.concatenate([np.array(r["y"]) for r in truth["heldout"]])
    for k, channel in enumerate(channels):
        error = np.sqrt(np.mean((mean[channel].to_numpy() - values[:, k]) ** 2))
        assert error < 0.5 * noise[channel], (channel, error)


@pytest.mark.slow
def test_jump_of_friction_at_first_touch_does_not_bias_it(tmp_path):
    """A sample at first touch, where friction jumps to that of the sliding speed, may lie on either side."""
    effects = {"viscous-friction": {"c_t": 3.0}}
    made = make_oblique_campaign("jump", 3, effects, BASE, [6e5, 1.6e6], [0.4], [0.2, 0.5], interval=4e-4, steps=100)
    exact = [dc.replace(r, true=r.written, values=made.read(r.written, r.places)) for r in made.records]
    write_package(tmp_path / "jump", dc.replace(made, records=exact))
    found = fit(tmp_path / "jump", effects=["viscous-friction"], noise="stated")
    for name in ("adhesion_constant", "tangential_mass", "effective_mass", "restitution"):
        assert found.parameters[name].estimate == pytest.approx(BASE[name], rel=1e-4)
    assert found.parameters["viscous-friction.c_t"].estimate == pytest.approx(3.0, rel=1e-4)


def test_independent_simulator_closes_its_own_books():
    """The friction work of the second simulator is the force over the slip, by quadrature."""
    conditions = {"initial_pressure": 1.2e6, "approach_speed": 0.4, "tangential_speed": 0.4}
    times = np.linspace(0.0, 0.06, 4001)
    columns, end = integrate_strike(BASE, {"tangential-compliance": {"compliance": 3e-5}}, conditions, times)
    work = np.trapezoid(columns["tangential_force"] * np.gradient(columns["slip"], times), times)
    np.testing.assert_allclose(work, end["work"], rtol=1e-3)


def test_directions_of_friction_by_hand():
    """The factor of each test direction at a slide whose variables are known."""
    slide = Slide(*(jnp.asarray(x) for x in (5e-3, 0.1, 20.0, 1e6, 0.0, 8e-3, 1.0)), {"sequence": jnp.asarray(6.0)})
    shares = {"slip": 0.5, "load": 0.4, "speed": 0.5, "time": 0.4, "sequence": 0.5}
    directions = {one.id: one for one in OBLIQUE_DIRECTIONS}
    for name, share in shares.items():
        one = directions[f"probe-friction-{name}"]
        assert one(h=jnp.asarray(0.2)).factor(slide) == pytest.approx(1.0 + 0.2 * share, rel=1e-14)
        assert one().factor(slide) == 1.0 and (one.reference, one.channel) == ("probe", "tangential_force")


GOOD = {"initial_pressure": 1.2e6, "approach_speed": 0.4, "tangential_speed": 0.15}


@pytest.mark.parametrize(("change", "message"), [
    ({"tangential_speed": None}, "needs the condition 'tangential_speed'"),
    ({"initial_pressure": None}, "needs the condition 'initial_pressure'"),
    ({"approach_speed": -0.4}, "approach_speed must be positive; it is -0.4"),
    ({"approach_speed": "0.3 m/s"}, "approach_speed must be a number in SI units"),
    ({"tangential_speed": float("nan")}, "tangential_speed is nan"),
    ({"tangential_speed": np.array([0.1, 0.2])}, "batch impacts by jax.vmap"),
])  # fmt: skip
def test_strike_refuses_conditions(change, message):
    """What is missing or no use is named, before anything is compiled."""
    conditions = {k: v for k, v in (GOOD | change).items() if v is not None}
    with pytest.raises(InputError, match=message):
        run_strike(Striker(Ball(), AdhesionHysteresis()), conditions, TIMES)


@pytest.mark.slow
def test_strike_takes_plain_numbers_and_refuses_the_rest():
    """Floats and lists do; times, laws and masses that do not are named."""
    law = Striker(Ball(), AdhesionHysteresis())
    times = list(TIMES[::10])
    found = run_strike(law, GOOD, times)
    wrapped = run(law.extend(()), {k: jnp.asarray(v) for k, v in GOOD.items()}, jnp.asarray(times))
    np.testing.assert_allclose(found.tangential_force, wrapped.tangential_force, rtol=1e-9, atol=1e-12)
    for wrong, message in ((0.01, "one-dimensional"), ([], "at least one time"), ([0.0, np.nan], "time number 2")):
        with pytest.raises(InputError, match=message):
            run_strike(law, GOOD, wrong)
    with pytest.raises(InputError, match="needs a Striker"):
        run_strike(Ball(), GOOD, times)  # pyright: ignore[reportArgumentType]
    with pytest.raises(InputError, match="tangential_mass must be positive; it is -1"):
        run_strike(Striker(Ball(), AdhesionHysteresis(), tangential_mass=-1.0), GOOD, times)
    with pytest.raises(TypeError, match="in this order"):
        Striker(AdhesionHysteresis(), Ball())  # pyright: ignore[reportArgumentType]
    with pytest.raises(TypeError, match="tuple of effects"):
        law.extend(TangentialCompliance(1e-4))  # pyright: ignore[reportArgumentType]


def copy_campaign(folder, change):
    """A copy of `oblique-a` whose files a function has changed."""
    shutil.copytree(find_data() / "oblique-a", folder)
    change(folder)
    return folder


def edit_known(**values):
    """A change of what is known; None leaves a parameter out."""
    def change(folder):
        path = folder / "datapackage.json"
        tree = json.loads(path.read_text(encoding="utf-8"))
        tree["known"] = {k: v for k, v in (tree["known"] | values).items() if v is not None}
        path.write_text(json.dumps(tree), encoding="utf-8")

    return change


def edit_table(name, column, change):
    """A change of one column of a table."""
    def apply(folder):
        table = pd.read_csv(folder / name)
        table[column] = change(table[column])
        table.to_csv(folder / name, index=False)

    return apply


@pytest.mark.parametrize(("change", "message"), [
    (edit_known(rolling_mass="450 m"), "mass"),
    (edit_known(rolling_mass="0 kg"), "positive"),
    (edit_table("records.csv", "tangential_speed", lambda x: x.where(x.index != 3, -x)), "cannot be negative"),
    (edit_table("samples.csv", "tangential_force", lambda x: -x), "opposed to its tangential speed"),
])  # fmt: skip
def test_campaigns_that_cannot_be(tmp_path, change, message):
    """A unit of another kind, a mass of nothing, and signs that contradict each other are refused in words."""
    with pytest.raises(InputError, match=message):
        assemble_space(read_campaign(copy_campaign(tmp_path / "copy", change)),
                       resolve_model("paper", "oblique").reference)


def test_a_baseline_beside_the_contact_is_no_friction(tmp_path):
    """A gauge that strays where the ball is not pressed on has no wrong sign."""
    def stray(folder):
        table = pd.read_csv(folder / "samples.csv")
        table.loc[table["normal_force"] < 1.0, "tangential_force"] -= 10.0
        table.to_csv(folder / "samples.csv", index=False)

    campaign = read_campaign(copy_campaign(tmp_path / "copy", stray))
    assert min(campaign.trace(key)["tangential_force"].sum() for key in campaign.record_keys) < -50.0
    assemble_space(campaign, resolve_model("paper", "oblique").reference)


def test_what_axes_read_of_each_other_is_no_wrong_sign(tmp_path):
    """Where the ball grips the gauge reads less friction than it takes from the normal force: a share that is found."""
    hidden = {"sensor-crosstalk": {"c_tn": -0.04}}
    write_package(tmp_path, make_oblique_campaign("mixed", 5, hidden, BASE, [6e5, 1.6e6], [0.4], [0.03, 0.3],
                                                  interval=4e-4, steps=100))
    campaign = read_campaign(tmp_path)
    pushed = [trace["tangential_force"] @ trace["normal_force"] for trace in map(campaign.trace, campaign.record_keys)]
    assert min(pushed) < 0.0
    found = fit(campaign, effects=["sensor-crosstalk"]).parameters
    share = found["sensor-crosstalk.c_tn"]
    assert abs(share.estimate + 0.04) < 3.0 * share.sd < 0.02
    assert "sensor-crosstalk.c_nt" not in found


@pytest.mark.study
def test_crosstalk_of_the_gauge_is_found(tmp_path):
    """Named from what it does to impacts that grip as well as to those that slide, by the second simulator."""
    hidden = {"sensor-crosstalk": {"c_tn": 0.03}}
    write_package(tmp_path, make_oblique_campaign("mixed", 5, hidden, BASE, [6e5, 1.6e6], [0.2, 0.5], [0.08, 0.3, 0.6],
                                                  interval=4e-4, steps=100))
    found = discover(tmp_path)
    assert (found.verdict, found.effects) == ("explained", ("sensor-crosstalk",))
    estimate = found.steps[-1].parameters["sensor-crosstalk.c_tn"]
    assert estimate.q025 < 0.03 < estimate.q975


def test_unstated_rolling_mass_is_told(tmp_path):
    """What is assumed of the ball's inertia stands in the notes."""
    campaign = read_campaign(copy_campaign(tmp_path / "copy", edit_known(rolling_mass=None)))
    found = assemble_space(campaign, resolve_model("paper", "oblique").reference)
    assert any("rolling_mass is not under known, so 0.5 kg is assumed" in text for text in found.warnings)


@pytest.mark.slow
def test_import_of_three_axes(tmp_path):
    """`--keep` takes the tangential force; without it a note says that it stays unused."""
    law = build()
    rows = []
    for k, (pressure, speed, slide) in enumerate([(1e6, 0.3, 0.1), (1.5e6, 0.4, 0.3), (2e6, 0.35, 0.2)]):
        found = run(law, set_conditions(pressure, speed, slide), jnp.asarray(TIMES))
        frame = pd.DataFrame({"time [s]": TIMES, "Fz [N]": found.normal_force, "Fx [N]": found.tangential_force})
        frame.to_csv(tmp_path / f"t{k}.csv", index=False)
        rows.append({"test": f"t{k}", "pressure [bar]": pressure / 1e5, "speed [m/s]": speed,
                     "tangential speed [m/s]": slide})
    pd.DataFrame(rows).to_csv(tmp_path / "settings.csv", index=False)
    files = [str(tmp_path / f"t{k}.csv") for k in range(3)]
    options = {"conditions": str(tmp_path / "settings.csv"), "gauge": False, "uncertainty": {"force": "0.25 N"}}
    plain = import_tests(files, **options)
    assert any("--keep tangential_force=COLUMN" in note for note in plain.notes)
    options["uncertainty"] = {"force": "0.25 N", "tangential_force": "0.1 N"}
    campaign = import_tests(files, **options, keep={"tangential_force": "Fx [N]"})
    assert name_family(campaign) == "oblique"
    np.testing.assert_allclose(campaign.records["tangential_speed"], [0.1, 0.3, 0.2])
    assert any("rolling_mass is not stated" in note for note in campaign.notes)
