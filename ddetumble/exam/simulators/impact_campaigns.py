"""Campaigns of impacts: a ball strikes a plate at several pressures and speeds; its force is read."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from .campaigns import Campaign, draw_records, name_conditions, order_tests, place_between
from .generator import CaseGenerator, HeldOut, Hidden, leave_out, spread
from .impact import Impact, simulate
from .strength import hold_slopes, refer_tests


CONDITIONS = ("initial_pressure", "approach_speed")
# one standard deviation: relative for the two conditions, s for the time origin, SI for the channels
UNCERTAINTIES = {"initial_pressure": 0.005, "approach_speed": 0.003, "time": 5e-5}
NOISE = {"normal_force": 0.25, "depression": 2e-5, "pressure": 2e3}
KNOWN = {"outer_diameter": "60 mm", "effective_mass": None, "restitution": None}
MEASURED = 12  # tests on which strengths are measured: the first of the random order
COARSE = {"rtol": 1e-7, "parts": 6}  # of the integrator, good to 1e-3 of the noise: for strengths only
CATALOGUE = {
    "polytropic-gas": Hidden({"n": 0.5}, {"n": 1.0}, most=1.2),
    "ambient-pressure": Hidden({"p_a": 1.0e5}, most=1.1),
    "wall-stiffness": Hidden({"k_w": 1000.0}, shapes={"q": (1.0, 1.0)}),
    "membrane-area": Hidden({"alpha": 0.2}, most=5.0),
    "inflation-growth": Hidden({"beta": 1.0}, most=1.4),
    "gas-leak": Hidden({"lambda": 4.0}),
    "viscoelastic-wall": Hidden({"k_v": 2500.0}, shapes={"tau": (3e-3, 1.2e-2)}),
    "viscous-dashpot": Hidden({"c_v": 6.0}),
    "adhesion": Hidden({"tau_a": 4.0e4}, most=8.0),
    "arm-servo": Hidden({"k_s": 250.0}, most=4.0),
    "speed-dependent-restitution": Hidden({"p": 0.08}, most=2.3),
    "pressure-dependent-restitution": Hidden({"p": 0.08}, most=2.3),
    "stress-softening": Hidden({"sigma_m": 0.12}, shapes={"j_0": (2.0, 8.0)}, most=6.0),
    "sensor-highpass": Hidden(inverse={"tau_s": 0.8}),
    "sensor-lag": Hidden({"T": 1.0e-3}, most=4.0),
    "sensor-filter": Hidden(inverse={"f_c": 200.0}, most=3.0, since=4),
    "sensor-gain": Hidden({"g": 0.06}, {"g": 1.0}),
    "sensor-resonance": Hidden(inverse={"f_0": 200.0}, shapes={"zeta": (0.01, 0.3)}, most=2.5, since=3),
    "sensor-hysteresis": Hidden({"h": 0.05}, shapes={"w": (3.0, 60.0)}, most=10.0, since=5),  # in the next edition
}
OUTSIDE = {
    "x-end-stop": Hidden({"k": 1.0e5}, shapes={"depth": (4.5e-3, 6.0e-3)}, most=30.0),
    "x-ringing": Hidden({"A": 0.04}, shapes={"f": (60.0, 150.0), "decay": (5.0, 50.0)}),
    "x-arm-vibration": Hidden({"force": 3.0}, shapes={"f": (50.0, 120.0)}, most=5.0),
    "x-rate-hardening": Hidden({"h": 0.1}, shapes={"w_0": (0.08, 0.25)}, most=5.0),
    "x-pressure-power": Hidden({"s": 0.1}, most=5.0),
}
# A pressure written too high, and a mass as much too high, give the same motion under a force too high by that factor.
# So does a speed, by its square: a gain leaves 0.5 % of the noise of a speed 2.5 % too high.
RINGING: dict[str, tuple[str, ...]] = {"ringing": ("sensor-resonance",)}  # a bench and an effect that are the same
SAME: dict[str, tuple[str, ...]] = dict.fromkeys(("normal_force", *CONDITIONS), ("sensor-gain",)) | RINGING


def draw_setting(generator: np.random.Generator) -> dict[str, Any]:
    """A ball and arm, and a plan of 12 to 24 tests; records stay below 768 samples."""
    pick = generator.uniform
    pressures, speeds = [(3, 2), (4, 2), (3, 3), (4, 3)][generator.integers(4)]
    repeats = 2 if pressures * speeds <= 9 or generator.random() < 0.5 else 1
    return {
        "base": {"effective_mass": float(pick(1.0, 1.8)), "restitution": float(pick(0.6, 0.8))},
        "pressures": spread(generator, 0.4e6, 2.5e6, pressures), "speeds": spread(generator, 0.15, 0.75, speeds),
        "repeats": repeats, "interval": float(generator.choice([2.5e-4, 4.0e-4])),
        "setting_scatter": float(generator.choice([0.0, 0.01])),
    }  # fmt: skip


def place_times(base, conditions, interval=1e-3, before=0.0, factor=1.45):
    """Return sampling times (s): from `before` the touch to `factor` guessed contact times, every `interval`."""
    end = factor * Impact(base, {}, conditions).guess_contact_time()
    first = -round(before / interval)
    return np.arange(first, int(end / interval) + 1) * interval


def choose_heldout(pressures, speeds, sequence):
    """Return three conditions at none of the campaign's own, one impact after its last."""
    low, high, _ = place_between(pressures)
    slow, _, fast = place_between(speeds)
    return name_conditions(CONDITIONS, ((low, fast), (high, slow), (high, fast)), sequence=sequence)


def make_campaign(
    name, seed, effects, base, pressures, speeds, repeats=2, *, channels=("normal_force",), interval=2.5e-4,
    before=2e-3, length=1.45, uncertainties=None, setting_scatter=0.0, noise=None, rho=0.0, white_share=0.0,
):  # fmt: skip
    """Return a campaign: every pressure (Pa) with every speed (m/s), `repeats` times, in random order.

    Written times run from -before to `length` guessed contact times every `interval` (s). Noise of each channel is
    AR(1) with coefficient rho, of which `white_share` of the variance is white instead. All draws come from one
    PCG64 generator seeded with `seed`, in a fixed order: see `draw_records`.
    """
    generator = np.random.Generator(np.random.PCG64(seed))
    tests = order_tests(generator, CONDITIONS, (pressures, speeds), repeats)
    deviations = NOISE | (noise or {})

    def place(conditions):
        times = place_times(base, conditions, interval, before, length)
        return times, {"time": times}

    campaign = Campaign(
        name, "impact", seed, effects, base, KNOWN, ("sequence", *CONDITIONS), UNCERTAINTIES | (uncertainties or {}),
        {c: deviations[c] for c in channels}, [3 if tuple(channels) == ("normal_force",) else 5] * len(channels), place,
        lambda true, times: simulate(base, effects, true, times, channels), rho, white_share, setting_scatter,
    )  # fmt: skip
    return draw_records(campaign, generator, tests)


def refer_impacts(base, tests, deviations, uncertainties, channels=("normal_force",), **options):
    """Return the `Reference` of tests at these conditions, which shares effective_mass and restitution.

    deviations: noise of each channel; options: of `simulate`.
    """
    scale = np.asarray(deviations, dtype=float)
    start = np.array([np.log(base["effective_mass"]), base["restitution"]])
    return refer_tests(
        base, (start, lambda shared: dict(base, effective_mass=np.exp(shared[0]), restitution=shared[1])), tests,
        [place_times(base, c) for c in tests], {name: uncertainties[name] for name in (*CONDITIONS, "time")},
        lambda model, effects, moved, times: simulate(model, effects, moved, times, channels, **options) / scale,
    )  # fmt: skip


def prepare(setting: Mapping, seed: int) -> Callable[[Mapping], float]:
    """The function effects -> misfit over noise, with the reference model's derivatives found once."""
    generator = np.random.Generator(np.random.PCG64(seed))
    tests = order_tests(generator, CONDITIONS, (setting["pressures"], setting["speeds"]), setting["repeats"])[:MEASURED]
    return hold_slopes(refer_impacts(setting["base"], tests, [NOISE["normal_force"]], UNCERTAINTIES, **COARSE), 3)


def hold_out(effects: Mapping, setting: Mapping) -> list[HeldOut]:
    """Three tests at other pressures and speeds, after the campaign's last."""
    count = len(setting["pressures"]) * len(setting["speeds"]) * setting["repeats"]
    tests = choose_heldout(setting["pressures"], setting["speeds"], count + 1)
    times = [place_times(setting["base"], conditions, 5e-4) for conditions in tests]
    return [HeldOut(c, t, simulate(setting["base"], effects, c, t)) for c, t in zip(tests, times, strict=True)]


IMPACT = CaseGenerator(
    "impact", {"normal_force": NOISE["normal_force"]}, "time", CATALOGUE, OUTSIDE, draw_setting, make_campaign,
    prepare, hold_out, leave_out(), SAME,
    # 1 drew values beyond physics: gases of an exponent up to 3, an atmosphere of 3 bar; 2 knew no gauge that rings;
    # 3 no filter of second order
    edition=4,
)  # fmt: skip
