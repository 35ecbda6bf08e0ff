"""The independent simulator against closed forms."""

import math

import numpy as np
import pytest
from scipy.special import beta

from tests.independent.campaigns import make_campaign, write_campaign_folder
from tests.independent.impact import (
    Impact,
    integrate_contact,
    measure_disc,
    measure_volume,
    simulate,
    solve_damping,
)
from tests.independent.noise import draw_noise
from tests.independent.strength import measure_misfit, scale_amplitude


BASE = {"effective_mass": 1.4, "restitution": 0.72}
CONDITIONS = {"initial_pressure": 1.2e6, "approach_speed": 0.4, "sequence": 5}
TIMES = np.arange(-8, 400) * 2.5e-4


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
    }  # fmt: skip
    assert len(nulls) == 16
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


def test_campaign_scatters_as_stated_and_repeats_bit_for_bit(tmp_path):
    """Written over true condition and time shift have the stated widths; the same seed writes the same bytes."""
    options = {"pressures": [1e6] * 6, "speeds": [0.6] * 5, "repeats": 4, "interval": 4e-3}
    first = make_campaign("trial", 5, {}, BASE, **options)
    for name, width in (("initial_pressure", 0.005), ("approach_speed", 0.003)):
        error = [row["written"][name] / row["true"][name] - 1.0 for row in first["records"]]
        assert np.std(error) == pytest.approx(width, rel=0.2)
    assert np.std([row["time_shift"] for row in first["records"]]) == pytest.approx(5e-5, rel=0.2)
    for label in ("one", "two"):
        write_campaign_folder(tmp_path / label, make_campaign("trial", 5, {}, BASE, **options))
    for path in (tmp_path / "one").iterdir():
        assert path.read_bytes() == (tmp_path / "two" / path.name).read_bytes()


def test_misfit_after_refit():
    """What the reference parameters can take leaves nothing; a scaled amplitude leaves what was wanted."""
    conditions = [CONDITIONS | {"initial_pressure": p} for p in (5e5, 2e6)]
    stated = {"initial_pressure": 5e-3, "approach_speed": 3e-3, "time": 5e-5}
    arguments = (BASE, conditions, [0.25], stated)
    # a pressure law this weak is a factor on each record's pressure, small against its prior: the nuisances take it
    assert measure_misfit(BASE, {"x-pressure-power": {"s": 1e-4}}, *arguments[1:]) < 1e-2

    def build(tau_a):
        return {"adhesion": {"tau_a": tau_a}}

    amplitude = scale_amplitude(build, 2.0, (1e4, 2e5), *arguments, steps=3)
    assert measure_misfit(BASE, build(amplitude), *arguments[1:]) == pytest.approx(2.0, rel=0.05)
