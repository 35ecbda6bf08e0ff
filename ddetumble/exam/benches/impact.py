"""The bench of impacts: a ball strikes a plate at several pressures and speeds; its force is read."""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np

from ..simulators.impact import simulate
from ..simulators.impact_campaigns import (
    NOISE,
    UNCERTAINTIES,
    choose_heldout,
    make_campaign,
    order_tests,
    write_campaign_folder,
)
from ..simulators.strength import find_slopes, measure_misfit, place_times
from .bench import Bench, HeldOut, Hidden


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
    "sensor-gain": Hidden({"g": 0.06}, {"g": 1.0}),
}
OUTSIDE = {
    "x-end-stop": Hidden({"k": 1.0e5}, shapes={"depth": (4.5e-3, 6.0e-3)}, most=30.0),
    "x-ringing": Hidden({"A": 0.04}, shapes={"f": (60.0, 150.0), "decay": (5.0, 50.0)}),
    "x-arm-vibration": Hidden({"force": 3.0}, shapes={"f": (50.0, 120.0)}, most=5.0),
    "x-rate-hardening": Hidden({"h": 0.1}, shapes={"w_0": (0.08, 0.25)}, most=5.0),
    "x-pressure-power": Hidden({"s": 0.1}, most=5.0),
}


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


def spread(generator: np.random.Generator, low: float, high: float, count: int) -> list[float]:
    """So many settings between two limits, one in the middle half of each of as many even parts in the logarithm."""
    place = (np.arange(count) + generator.uniform(0.25, 0.75, count)) / count
    return [float(f"{x:.4g}") for x in low * (high / low) ** place]


def make(name: str, seed: int, effects: Mapping, setting: Mapping, noise: Mapping) -> dict[str, Any]:
    """A campaign with noise."""
    return make_campaign(name, seed, effects, setting["base"], setting["pressures"], setting["speeds"],
                         setting["repeats"], interval=setting["interval"], setting_scatter=setting["setting_scatter"],
                         **noise)


def prepare(setting: Mapping, seed: int) -> Callable[[Mapping], float]:
    """The function effects -> misfit over noise, with the reference model's derivatives found once."""
    tests = order_tests(np.random.Generator(np.random.PCG64(seed)), setting["pressures"], setting["speeds"],
                        setting["repeats"])[:MEASURED]
    fixed = (tests, [NOISE["normal_force"]], UNCERTAINTIES)
    slopes = find_slopes(setting["base"], *fixed, **COARSE)
    return partial(_measure, setting["base"], fixed=fixed, slopes=slopes)


def _measure(base: Mapping, effects: Mapping, fixed: tuple, slopes: list) -> float:
    return measure_misfit(base, effects, *fixed, steps=3, slopes=slopes, **COARSE)


def hold_out(effects: Mapping, setting: Mapping) -> list[HeldOut]:
    """Three tests at other pressures and speeds, after the campaign's last."""
    count = len(setting["pressures"]) * len(setting["speeds"]) * setting["repeats"]
    found = []
    for conditions in choose_heldout(setting["pressures"], setting["speeds"], count + 1):
        times = place_times(setting["base"], conditions, 5e-4)
        found.append(HeldOut({**conditions}, times, simulate(setting["base"], effects, conditions, times)))
    return found


IMPACT = Bench(
    "impact", {"normal_force": NOISE["normal_force"]}, "time", CATALOGUE, OUTSIDE, draw_setting, make,
    write_campaign_folder, lambda campaign: [trace["values"] for trace in campaign["samples"]], prepare, hold_out,
    edition=2,  # 1 drew values beyond physics: gases of an exponent up to 3, an atmosphere of 3 bar
)  # fmt: skip
