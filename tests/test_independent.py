"""The independent simulator against closed forms."""

import math

import numpy as np
import pytest
from scipy import signal
from scipy.special import beta

from ddetumble.exam.simulators.campaigns import write_package
from ddetumble.exam.simulators.impact import (
    Impact,
    integrate_contact,
    measure_disc,
    measure_volume,
    simulate,
    solve_damping,
)
from ddetumble.exam.simulators.impact_campaigns import make_campaign, refer_impacts
from ddetumble.exam.simulators.noise import draw_noise
from ddetumble.exam.simulators.slip import (
    Rub,
    accumulate_work,
    find_coefficients,
    follow_strokes,
    measure_slip_coefficient,
    simulate_slip,
)
from ddetumble.exam.simulators.slip_campaigns import SLIP_UNCERTAINTIES, make_slip_campaign, refer_slip
from ddetumble.exam.simulators.strength import measure_misfit, reach_strength


BASE = {"effective_mass": 1.4, "restitution": 0.72}
CONDITIONS = {"initial_pressure": 1.2e6, "approach_speed": 0.4, "sequence": 5}
TIMES = np.arange(-8, 400) * 2.5e-4
SLIP_BASE = {"adhesion_constant": 0.9, "loss_factor": 0.16, "slip_scale": 1.0}
SLIP_CONDITIONS = {"normal_load": 14.0, "internal_pressure": 1.3e6, "slip_speed": 0.1, "sequence": 5}
PATH = np.arange(121) * 1e-4


def touch(base, effects, conditions=CONDITIONS):
    """Return (impact, dense solution, separation time)."""
    impact = Impact(base, effects, conditions)
    return impact, *integrate_contact(impact, 10.0 * impact.guess_contact_time())


@pytest.mark.parametrize("restitution", [0.05, 0.3, 0.5, 0.8, 0.95, 0.999])
def test_damping_satisfies_closed_form(restitution):
    """kappa - ln(1 + kappa) = -kappa e - ln(1 - kappa e)."""
    kappa = solve_damping(restitution, 0.4) * 0.4
    left = kappa - math.log1p(kappa)
    assert left == pytest.approx(-kappa * restitution - math.log1p(-kappa * restitution), rel=1e-9)


@pytest.mark.parametrize("restitution", [0.3, 0.72, 0.95])
@pytest.mark.parametrize(
    "effects",
    [
        {},
        {"polytropic-gas": {"n": 1.4}, "wall-stiffness": {"k_w": 2e3, "q": 1.5}},
        {"membrane-area": {"alpha": 0.3}, "stress-softening": {"sigma_m": 0.3, "j_0": 2.0}},
        {"x-end-stop": {"k": 1e5, "depth": 0.004}, "inflation-growth": {"beta": 0.5}},
    ],
)
def test_restitution_is_realised_for_any_spring(restitution, effects):
    """The speed at separation is e v1 whatever multiplies 1 + c_n w, stop and wall included."""
    impact, solution, separation = touch(BASE | {"restitution": restitution}, effects)
    assert -solution(separation)[1] == pytest.approx(restitution * impact.speed, rel=1e-8)


def test_restitution_laws_change_restitution():
    """e = e0 (v1/0.4)^-p and e = e0 (P0/1 MPa)^-p."""
    conditions = {"initial_pressure": 2e6, "approach_speed": 0.2}
    for effect, factor in (("speed-dependent-restitution", 0.5), ("pressure-dependent-restitution", 2.0)):
        _, solution, separation = touch(BASE, {effect: {"p": 0.2}}, conditions)
        assert -solution(separation)[1] == pytest.approx(0.2 * 0.72 * factor**-0.2, rel=1e-8)


def test_energy_is_kept_without_damping():
    """With e = 1, m w^2/2 + int F_k d delta = m v1^2/2 throughout the contact."""
    impact, solution, separation = touch(BASE | {"restitution": 1.0}, {"wall-stiffness": {"k_w": 800.0, "q": 1.0}})
    nodes, weights = np.polynomial.legendre.leggauss(24)
    for share in (0.1, 0.35, 0.5, 0.8, 1.0):
        depression, rate = solution(share * separation)[:2]
        at = 0.5 * depression * (nodes + 1.0)
        spring = [impact.find_spring_force(0.0, x, 0.0) for x in at]
        work = 0.5 * depression * (weights @ spring)
        total = 0.5 * impact.mass * rate**2 + work
        assert total == pytest.approx(0.5 * impact.mass * impact.speed**2, rel=1e-9)


def test_gentle_impact_lasts_as_on_a_square_law():
    """On F = k delta^2, k = P0 pi^3/16: T = 2 (3m/(2k))^(1/3) v^(-1/3) B(1/3, 1/2)/3, as v -> 0."""
    impact, _, separation = touch(
        BASE | {"restitution": 1.0}, {}, {"initial_pressure": 2e6, "approach_speed": 1e-4}
    )  # fmt: skip
    deepest = (1.5 * impact.mass * 1e-8 / (2e6 * math.pi**3 / 16.0)) ** (1.0 / 3.0)
    assert separation == pytest.approx(2.0 * deepest / 1e-4 * beta(1.0 / 3.0, 0.5) / 3.0, rel=1e-3)


def test_viscoelastic_branch_without_relaxation_is_a_spring():
    """tau -> infinity makes q = k_v delta, which the clamp adds outside 1 + c_n w; with e = 1 it is a linear wall."""
    base = BASE | {"restitution": 1.0}
    branch = simulate(base, {"viscoelastic-wall": {"k_v": 900.0, "tau": 1e9}}, CONDITIONS, TIMES)
    wall = simulate(base, {"wall-stiffness": {"k_w": 900.0, "q": 1.0}}, CONDITIONS, TIMES)
    assert np.abs(branch - wall).max() < 1e-6


def test_momentum_balances_with_every_contact_effect():
    """int F dt = m (v1 + v2) + int k_s (v1 t - delta) dt, by Simpson's rule on the dense solution."""
    effects = {
        "viscous-dashpot": {"c_v": 9.0}, "viscoelastic-wall": {"k_v": 2e3, "tau": 0.01}, "adhesion": {"tau_a": 5e4},
        "arm-servo": {"k_s": 200.0}, "gas-leak": {"lambda": 3.0}, "ambient-pressure": {"p_a": 1e5},
    }  # fmt: skip
    impact, solution, separation = touch(BASE, effects)
    times = np.linspace(0.0, separation, 8001)
    states = solution(times)
    force = np.array([impact.find_contact_force(t, *s[:3]) for t, s in zip(times, states.T, strict=True)])
    net = 200.0 * (impact.speed * times - states[0]) - force
    weights = np.where(np.arange(times.size) % 2, 4.0, 2.0)
    weights[[0, -1]] = 1.0
    impulse = weights @ net * times[1] / 3.0
    assert impulse == pytest.approx(impact.mass * (states[1, -1] - impact.speed), rel=1e-6)
    assert force.min() < 0.0  # adhesion pulls, after the clamp


def test_every_null_leaves_reference():
    """Each effect at its null, or with a limit parameter there, gives the reference record."""
    nulls = {
        "polytropic-gas": {"n": 1.0}, "ambient-pressure": {"p_a": 0.0}, "wall-stiffness": {"k_w": 0.0, "q": 2.0},
        "membrane-area": {"alpha": 0.0}, "inflation-growth": {"beta": 0.0}, "gas-leak": {"lambda": 0.0},
        "viscoelastic-wall": {"k_v": 0.0, "tau": 0.01}, "viscous-dashpot": {"c_v": 0.0}, "adhesion": {"tau_a": 0.0},
        "arm-servo": {"k_s": 0.0}, "speed-dependent-restitution": {"p": 0.0},
        "pressure-dependent-restitution": {"p": 0.0}, "stress-softening": {"sigma_m": 0.0, "j_0": 3.0},
        "sensor-highpass": {"tau_s": 1e15}, "sensor-lag": {"T": 0.0}, "sensor-gain": {"g": 1.0},
        "sensor-filter": {"f_c": math.inf}, "sensor-resonance": {"f_0": math.inf, "zeta": 0.05},
        "sensor-hysteresis": {"h": 0.0, "w": 20.0},
    }  # fmt: skip
    assert len(nulls) == 19
    plain = simulate(BASE, {}, CONDITIONS, TIMES)
    assert np.abs(simulate(BASE, nulls, CONDITIONS, TIMES) - plain).max() < 1e-8
    strong = {name: {symbol: value or 0.1 for symbol, value in null.items()} for name, null in nulls.items()}
    assert np.abs(simulate(BASE, strong, CONDITIONS, TIMES) - plain).max() > 1.0


def test_geometry_keeps_perimeter_area_and_volume():
    """pi D = pi d + 4b; 2 b^2 + pi b d + d^2 = D^2; volume by quadrature of Eq. 2's integral."""
    diameter, depression = 0.06, 0.007
    height = diameter - depression
    b = measure_disc(depression, diameter)
    assert math.pi * height + 4.0 * b == pytest.approx(math.pi * diameter, rel=1e-14)
    area = measure_disc(depression, diameter, alpha=1.0)
    assert 2.0 * area**2 + math.pi * area * height + height**2 == pytest.approx(diameter**2, rel=1e-13)
    y = 0.5 * height * np.sin(0.25 * np.pi * (np.polynomial.legendre.leggauss(40)[0] + 1.0))
    weights = np.polynomial.legendre.leggauss(40)[1] * 0.25 * np.pi * np.sqrt((0.5 * height) ** 2 - y**2)
    section = (b + np.sqrt((0.5 * height) ** 2 - y**2)) ** 2
    assert measure_volume(b, height) == pytest.approx(2.0 * np.pi * weights @ section, rel=1e-12)


def test_highpass_decays_exponentially_after_separation():
    """After separation the force is zero and the reading -y decays as exp(-t/tau_s)."""
    reading = simulate(BASE, {"sensor-highpass": {"tau_s": 0.05}}, CONDITIONS, TIMES)[:, 0]
    force = simulate(BASE, {}, CONDITIONS, TIMES)[:, 0]
    after = np.flatnonzero((TIMES > 0.0) & (force == 0.0))
    assert after.size > 50 and reading[after[0]] < -1.0
    decay = reading[after[0]] * np.exp(-(TIMES[after] - TIMES[after[0]]) / 0.05)
    assert np.abs(reading[after] - decay).max() < 1e-9


def test_a_gauge_rings_down_after_separation():
    """At its damped frequency, by exp(-zeta w_0 t), from what the contact left; in contact it follows a slow force."""
    frequency, zeta = 130.0, 0.06
    reading = simulate(BASE, {"sensor-resonance": {"f_0": frequency, "zeta": zeta}}, CONDITIONS, TIMES)[:, 0]
    force = simulate(BASE, {}, CONDITIONS, TIMES)[:, 0]
    after = np.flatnonzero((TIMES > 0.0) & (force == 0.0))
    turn, t = 2.0 * math.pi * frequency, TIMES[after] - TIMES[after[0]]
    phase = turn * math.sqrt(1.0 - zeta**2) * t
    columns = np.exp(-zeta * turn * t)[:, None] * np.stack([np.cos(phase), np.sin(phase)], axis=1)
    parts = np.linalg.lstsq(columns, reading[after], rcond=None)[0]
    assert np.abs(reading[after] - columns @ parts).max() < 1e-8 and np.hypot(*parts) > 0.1
    stiff = simulate(BASE, {"sensor-resonance": {"f_0": 4e3, "zeta": 0.3}}, CONDITIONS, TIMES)[:, 0]
    inside = np.flatnonzero(force > 0.2 * force.max())[2:-2]
    late = 2.0 * 0.3 / (2.0 * math.pi * 4e3) * np.gradient(force, TIMES)
    assert np.abs(stiff - force + late)[inside].max() < 0.1 * np.abs(late).max()


def test_a_filter_of_second_order_is_that_of_signal_processing():
    """The reading is SciPy's Butterworth filter of the force, by its state space driven exactly by a polygon."""
    corner, times = 200.0, np.linspace(0.0, 0.08, 8001)
    force = simulate(BASE, {}, CONDITIONS, times)[:, 0]
    expected = signal.lsim(signal.butter(2, 2.0 * math.pi * corner, analog=True), force, times)[1]
    reading = simulate(BASE, {"sensor-filter": {"f_c": corner}}, CONDITIONS, times)[:, 0]
    assert np.abs(reading - expected).max() < 1e-5 * force.max() < 1e-3 * np.abs(reading - force).max()


def test_gauge_stages_come_in_order():
    """High-pass, lag and gain together solve the linear chain, tested after separation by its two exponentials."""
    tau, lag, gain = 0.05, 0.003, 1.1
    chain = {"sensor-highpass": {"tau_s": tau}, "sensor-lag": {"T": lag}, "sensor-gain": {"g": gain}}
    reading = simulate(BASE, chain, CONDITIONS, TIMES)[:, 0]
    passed = simulate(BASE, {"sensor-highpass": {"tau_s": tau}}, CONDITIONS, TIMES)[:, 0]
    force = simulate(BASE, {}, CONDITIONS, TIMES)[:, 0]
    after = np.flatnonzero((TIMES > 0.0) & (force == 0.0))
    t = TIMES[after] - TIMES[after[0]]
    forced = passed[after[0]] / (1.0 - lag / tau)  # particular part: forced exp(-t/tau)
    expected = forced * np.exp(-t / tau) + (reading[after[0]] / gain - forced) * np.exp(-t / lag)
    assert np.abs(reading[after] - gain * expected).max() < 1e-8
    assert np.abs(simulate(BASE, {"sensor-gain": {"g": gain}}, CONDITIONS, TIMES)[:, 0] - gain * force).max() < 1e-9


def test_channels_before_and_after_contact():
    """Zero force and depression, P0 before contact and P0 times the remaining gas after it."""
    y = simulate(BASE, {"gas-leak": {"lambda": 5.0}}, CONDITIONS, TIMES, ("normal_force", "depression", "pressure"))
    _, _, separation = touch(BASE, {"gas-leak": {"lambda": 5.0}})
    assert np.all(y[TIMES <= 0.0] == [0.0, 0.0, 1.2e6])
    after = y[TIMES > separation]
    assert after.shape[0] > 50 and not after[:, :2].any()
    assert np.abs(after[:, 2] / (1.2e6 * math.exp(-5.0 * separation)) - 1.0).max() < 1e-7


def test_ringing_multiplies_the_reading_alone():
    """x-ringing: reading F (1 + A exp(-decay t) sin(2 pi f t)), motion as before."""
    ringing = {"x-ringing": {"A": 0.1, "f": 150.0, "decay": 20.0}}
    rung = simulate(BASE, ringing, CONDITIONS, TIMES, ("normal_force", "depression"))
    plain = simulate(BASE, {}, CONDITIONS, TIMES, ("normal_force", "depression"))
    factor = 1.0 + 0.1 * np.exp(-20.0 * TIMES) * np.sin(2.0 * np.pi * 150.0 * TIMES)
    assert np.abs(rung[:, 0] - factor * plain[:, 0]).max() < 1e-8
    assert np.abs(rung[:, 1] - plain[:, 1]).max() < 1e-12


def test_arm_vibration_drives_the_motion():
    """x-arm-vibration adds int F_a sin(2 pi f t) dt = F_a (1 - cos(2 pi f t))/(2 pi f) to the momentum."""
    impact, solution, separation = touch(BASE, {"x-arm-vibration": {"force": 5.0, "f": 70.0}})
    nodes, weights = np.polynomial.legendre.leggauss(200)
    times = 0.5 * separation * (nodes + 1.0)
    force = [impact.find_contact_force(t, *solution(t)[:3]) for t in times]
    given = 5.0 * (1.0 - math.cos(2.0 * math.pi * 70.0 * separation)) / (2.0 * math.pi * 70.0)
    gained = impact.mass * (solution(separation)[1] - impact.speed)
    assert given - 0.5 * separation * (weights @ force) == pytest.approx(gained, rel=1e-9)


def test_unknown_names_are_refused():
    """A misspelt effect or parameter raises ValueError."""
    for effects in ({"wall": {}}, {"wall-stiffness": {"k": 1.0}}):
        with pytest.raises(ValueError, match="wall"):
            simulate(BASE, effects, CONDITIONS, TIMES)


@pytest.mark.parametrize(("rho", "white"), [(0.0, 0.0), (0.8, 0.0), (0.9, 0.4)])
def test_noise_has_stated_deviation_and_correlation(rho, white):
    """Marginal sd s; correlation (1 - white) rho^k; the first sample is as wide as the others."""
    noise = draw_noise(np.random.default_rng(3), 400_000, 0.25, rho, white)
    assert noise.std() == pytest.approx(0.25, rel=0.02)
    for lag in (1, 3):
        assert np.mean(noise[lag:] * noise[:-lag]) / 0.0625 == pytest.approx((1.0 - white) * rho**lag, abs=0.02)
    generator = np.random.default_rng(4)
    starts = [draw_noise(generator, 2, 0.25, rho, white)[0] for _ in range(20_000)]
    assert np.std(starts) == pytest.approx(0.25, rel=0.02)


@pytest.mark.slow
def test_campaign_scatters_as_stated_and_repeats_bit_for_bit(tmp_path):
    """Written over true condition and time shift have the stated widths; the same seed writes the same bytes."""
    options = {"pressures": [1e6] * 6, "speeds": [0.6] * 5, "repeats": 4, "interval": 4e-3}
    first = make_campaign("trial", 5, {}, BASE, **options)
    for name, width in (("initial_pressure", 0.005), ("approach_speed", 0.003)):
        error = [row.written[name] / row.true[name] - 1.0 for row in first.records]
        assert np.std(error) == pytest.approx(width, rel=0.2)
    assert np.std([row.shift for row in first.records]) == pytest.approx(5e-5, rel=0.2)
    for label in ("one", "two"):
        write_package(tmp_path / label, make_campaign("trial", 5, {}, BASE, **options))
    for path in (tmp_path / "one").iterdir():
        assert path.read_bytes() == (tmp_path / "two" / path.name).read_bytes()


@pytest.mark.slow
def test_misfit_after_refit():
    """What the reference parameters can take leaves nothing; a scaled amplitude leaves what was wanted."""
    conditions = [CONDITIONS | {"initial_pressure": p} for p in (5e5, 2e6)]
    stated = {"initial_pressure": 5e-3, "approach_speed": 3e-3, "time": 5e-5}
    reference = refer_impacts(BASE, conditions, [0.25], stated, rtol=1e-9)
    # a pressure law this weak is a factor on each record's pressure, small against its prior: the nuisances take it
    assert measure_misfit(reference, {"x-pressure-power": {"s": 1e-4}}) < 1e-2
    amplitude, _ = reach_strength(
        lambda a: measure_misfit(reference, {"adhesion": {"tau_a": a * 4e4}}, steps=3), 2.0, 5.0)  # fmt: skip
    assert measure_misfit(reference, {"adhesion": {"tau_a": amplitude * 4e4}}) == pytest.approx(2.0, rel=0.05)


@pytest.mark.parametrize("load", [6.0, 14.0, 27.0])
def test_slip_term_rises_from_zero_to_its_plateau(load):
    """mu_slip(0) = 0 with slope a (c d - b) per mm, and mu_slip -> a where b + |d| < 0."""
    a, b, c, d = find_coefficients(load)
    assert measure_slip_coefficient(0.0, load) == 0.0
    assert measure_slip_coefficient(1e-9, load) / 1e-6 == pytest.approx(a * (c * d - b), rel=1e-4)
    assert 0.0755 < a * (c * d - b) < 0.0895
    assert b + abs(d) < 0.0
    assert measure_slip_coefficient(40e-3 / -(b + abs(d)), load) == pytest.approx(a, rel=1e-9)


def test_friction_at_rest_is_the_rubber_part():
    """f(0) = tan delta [(pi/4) K sigma_0/p_r + (pi/10) (3 p_c/E*)^(2/3)] F_n; slip_scale adds in proportion."""
    modulus = 7.8e6 / (1.0 - 0.47**2)
    rubber = 0.16 * (math.pi / 4.0 * 0.9 * 0.5 + math.pi / 10.0 * (3.9e6 / modulus) ** (2.0 / 3.0))
    force = simulate_slip(SLIP_BASE, {}, SLIP_CONDITIONS, PATH)[:, 0]
    assert force[0] == pytest.approx(14.0 * rubber, rel=1e-14)
    double = simulate_slip(SLIP_BASE | {"slip_scale": 2.0}, {}, SLIP_CONDITIONS, PATH)[:, 0]
    assert np.abs(double - force - (force - force[0])).max() < 1e-13


def test_every_slip_null_leaves_reference():
    """Each effect at its null gives the reference record, and each away from it another one."""
    plain = simulate_slip(SLIP_BASE, {}, SLIP_CONDITIONS, PATH)
    effects = {
        "stribeck": {"A": 0.3, "u_s": 0.1}, "viscous-friction": {"c_t": 2.0}, "load-exponent": {"m": 0.1},
        "presliding": {"s_0": 2e-4}, "frictional-heating": {"kappa": 5.0}, "adhesive-offset": {"f_a": 0.2},
        "x-stick-slip": {"ratio": 0.05, "wavelength": 2e-3}, "x-wear": {"w": 0.2, "j_0": 4.0},
        "x-creep": {"A": 0.05, "t_0": 0.01},
    }  # fmt: skip
    for name, values in effects.items():
        first = next(iter(values))
        null = simulate_slip(SLIP_BASE, {name: values | {first: 0.0}}, SLIP_CONDITIONS, PATH)
        assert np.array_equal(null, plain), name
        assert np.abs(simulate_slip(SLIP_BASE, {name: values}, SLIP_CONDITIONS, PATH) - plain).max() > 0.05, name
    with pytest.raises(ValueError, match="wall"):
        simulate_slip(SLIP_BASE, {"wall-stiffness": {}}, SLIP_CONDITIONS, PATH)


@pytest.mark.parametrize(
    ("effect", "change"),
    [
        ({"stribeck": {"A": 0.4, "u_s": 0.1}}, lambda r, f: f + 0.4 * math.exp(-1.0) * r),
        ({"viscous-friction": {"c_t": 3.0}}, lambda r, f: f + 0.3),
        ({"load-exponent": {"m": 0.2}}, lambda r, f: f * 1.4**-0.2),
        ({"presliding": {"s_0": 3e-4}}, lambda r, f: f - np.exp(-PATH / 3e-4) * r),
        ({"adhesive-offset": {"f_a": 0.4}}, lambda r, f: f + 0.4),
        ({"x-stick-slip": {"ratio": 0.1, "wavelength": 0.1}}, lambda r, f: f * (0.9 + 2.0 * PATH)),
        ({"x-wear": {"w": 0.3, "j_0": 2.0}}, lambda r, f: f - 0.3 * (1.0 - math.exp(-2.0)) * r),
        ({"x-creep": {"A": 0.1, "t_0": 0.01}}, lambda r, f: f + 0.1 * np.log1p(1e3 * PATH) * r),
    ],
)
def test_slip_effects_follow_their_laws(effect, change):
    """Each law by hand, r being the Eq. 8 part of the force and f the whole."""
    plain = simulate_slip(SLIP_BASE, {}, SLIP_CONDITIONS, PATH)[:, 0]
    force = simulate_slip(SLIP_BASE, effect, SLIP_CONDITIONS, PATH)[:, 0]
    assert np.abs(force - change(plain[0], plain)).max() < 1e-12


def test_heating_of_a_constant_coefficient_has_closed_form():
    """dW/ds = mu F exp(-kappa W), slip term off: W = ln(1 + kappa mu F s)/kappa, f = mu F/(1 + kappa mu F s)."""
    base, effects = SLIP_BASE | {"slip_scale": 0.0}, {"frictional-heating": {"kappa": 30.0}}
    start = simulate_slip(base, {}, SLIP_CONDITIONS, [0.0])[0, 0]
    for strokes in (None, [4e-3, 5e-3, 3e-3]):  # heat does not care for direction
        work = accumulate_work(Rub(base, effects, SLIP_CONDITIONS), PATH, strokes)
        assert np.abs(work - np.log1p(30.0 * start * PATH) / 30.0).max() < 1e-12
        force = simulate_slip(base, effects, SLIP_CONDITIONS, PATH, strokes)[:, 0]
        assert np.abs(np.abs(force) - start / (1.0 + 30.0 * start * PATH)).max() < 1e-10


def test_heating_vanishes_to_first_order():
    """kappa -> 0: f -> f_0 - kappa r int f_0 ds, with the work of the unheated force by quadrature."""
    plain = simulate_slip(SLIP_BASE, {}, SLIP_CONDITIONS, PATH)[:, 0]
    kappa = 1e-5
    force = simulate_slip(SLIP_BASE, {"frictional-heating": {"kappa": kappa}}, SLIP_CONDITIONS, PATH)[:, 0]
    nodes, weights = np.polynomial.legendre.leggauss(20)
    at = 0.5 * PATH[-1] * (nodes + 1.0)
    work = 0.5 * PATH[-1] * weights @ simulate_slip(SLIP_BASE, {}, SLIP_CONDITIONS, at)[:, 0]
    assert (plain[-1] - force[-1]) / kappa == pytest.approx(plain[0] * work, rel=1e-4)


def test_strokes_are_symmetric():
    """Without memory of the path each stroke repeats the first, with the sign of its direction."""
    effects = {"presliding": {"s_0": 2e-4}, "adhesive-offset": {"f_a": 0.1}, "viscous-friction": {"c_t": 1.0}}
    one = simulate_slip(SLIP_BASE, effects, SLIP_CONDITIONS, PATH[:81])[:, 0]
    path = np.arange(321) * 1e-4
    force = simulate_slip(SLIP_BASE, effects, SLIP_CONDITIONS, path, [8e-3] * 4)[:, 0]
    for k in range(4):
        assert np.abs(force[80 * k + 1 : 80 * k + 81] - (-1) ** k * one[1:]).max() < 1e-11
    _, slip, since, direction = follow_strokes(path, [8e-3] * 4)
    assert np.abs(slip - np.abs((path + 8e-3) % 16e-3 - 8e-3)).max() < 1e-15
    assert since.max() < 8.001e-3 and set(direction) == {-1.0, 1.0}
    assert np.abs(np.diff(slip)[np.diff(direction) == 0] - 1e-4 * direction[1:][np.diff(direction) == 0]).max() < 1e-15
    with pytest.raises(ValueError, match="leaves"):
        follow_strokes([0.033], [8e-3] * 4)


def test_heat_lasts_through_reversals():
    """Every stroke starts at exp(-kappa W) of the rubber part, W being the work of all strokes before."""
    effects = {"frictional-heating": {"kappa": 8.0}}
    rub = Rub(SLIP_BASE, effects, SLIP_CONDITIONS)
    strokes, turn = [8e-3, 8e-3], 8e-3 * (1.0 + np.array([0.0, 1e-6]))
    work = accumulate_work(rub, [0.0, 4e-3, *turn], strokes)
    force = simulate_slip(SLIP_BASE, effects, SLIP_CONDITIONS, [0.0, 4e-3, *turn], strokes)[:, 0]
    assert work[3] > work[2] > work[1] > work[0] == 0.0
    assert -force[3] / force[0] == pytest.approx(math.exp(-8.0 * work[2]), rel=1e-5)


def test_slip_campaign_scatters_as_stated_and_repeats_bit_for_bit(tmp_path):
    """Written over true conditions have the stated widths, reversals no force, and the same seed the same bytes."""
    plan = {"loads": [8.0, 20.0], "pressures": [1e6] * 6, "speeds": [0.05] * 5, "repeats": 4, "interval": 2e-3}
    first = make_slip_campaign("trial", 5, {}, SLIP_BASE, **plan, strokes=[6e-3, 4e-3], numbered=True)
    for name, width in SLIP_UNCERTAINTIES.items():
        error = [row.written[name] / row.true[name] - 1.0 for row in first.records]
        assert np.std(error) == pytest.approx(width, rel=0.2)
    assert all(np.isnan(row.values[:, 0]).nonzero()[0].tolist() == [3] for row in first.records)
    for label in ("one", "two"):
        again = make_slip_campaign("trial", 5, {}, SLIP_BASE, **plan, strokes=[6e-3, 4e-3], numbered=True)
        write_package(tmp_path / label, again)
    for path in (tmp_path / "one").iterdir():
        assert path.read_bytes() == (tmp_path / "two" / path.name).read_bytes()
    lines = (tmp_path / "one" / "samples.csv").read_text(encoding="utf-8").splitlines()
    assert lines[0] == "record,time,slip,tangential_force" and lines[4] == "r01,0.12,6,"
    with pytest.raises(ValueError, match="whole number"):
        make_slip_campaign("trial", 5, {}, SLIP_BASE, **plan, strokes=[5e-3])


def test_slip_misfit_after_refit():
    """What K, tan delta and slip_scale can take leaves nothing; a fine sawtooth leaves all of itself."""
    conditions = [SLIP_CONDITIONS | {"normal_load": f, "internal_pressure": p} for f in (6.0, 24.0) for p in (8e5, 2e6)]
    reference = refer_slip(SLIP_BASE, conditions, PATH, 0.04, SLIP_UNCERTAINTIES)
    # a speed law at one speed is a factor on K and tan delta together
    assert measure_misfit(reference, {"stribeck": {"A": 0.3, "u_s": 0.1}}) < 1e-6
    wave = {"x-stick-slip": {"ratio": 0.03, "wavelength": 1e-3}}
    force = np.array([simulate_slip(SLIP_BASE, {}, c, PATH) for c in conditions])
    saw = 0.03 * np.sqrt(np.mean(force**2) / 3.0) / 0.04  # rms of a sawtooth of unit height is 1/sqrt 3
    assert measure_misfit(reference, wave) == pytest.approx(saw, rel=0.05)
