"""The bench of tumbling: bodies let go at random rates; their gyroscopes are read."""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np

from ..simulators.tumbling import RATES, simulate_tumbling
from ..simulators.tumbling_campaigns import (
    HELDOUT,
    NOISE,
    ORBIT_RATE,
    draw_rates,
    make_tumble_campaign,
    measure_tumble_misfit,
    write_tumble_folder,
)
from .bench import Bench, HeldOut, Hidden


TOLERANCE = 1e-8  # of the integrator, 1e-3 of the noise at most: for strengths only
CATALOGUE = {
    "eddy-current": Hidden({"k_e": 1.0e-6}, most=100.0),
    "constant-torque": Hidden(vectors={"torque": 2.3e-7}, most=100.0),
    "inertia-asymmetry": Hidden({"epsilon": 1.0e-3}, most=50.0),
    "axis-misalignment": Hidden({"angle": 1.0e-3}, most=50.0),
    "internal-damper": Hidden({"c": 8.0e-6}, shapes={"I_d": (0.015, 0.06)}, most=50.0),
    "gravity-gradient": Hidden({"scale": 1.0}, most=10.0),
    "gyro-bias": Hidden(vectors={"bias": 8.8e-5}, most=50.0),
    "gyro-scale": Hidden({"g": 0.002}, most=50.0),
}
OUTSIDE = {
    "x-quadratic-drag": Hidden({"k": 1.0e-5}, most=100.0),
    "x-sine-torque": Hidden(vectors={"torque": 3.7e-7}, shapes={"period": (25.0, 90.0)}, most=100.0),
    "x-growing-torque": Hidden(vectors={"slope": 5.0e-10}, most=100.0),
    "x-thruster": Hidden(vectors={"torque": 2.7e-7}, shapes={"period": (80.0, 200.0)}, most=100.0),
    "x-solar-torque": Hidden(vectors={"torque": 5.4e-8}, most=100.0),
    "x-bias-walk": Hidden(vectors={"slope": 3.0e-7}, most=100.0),
    "x-flexible-panel": Hidden({"ratio": 0.002}, shapes={"omega": (0.25, 0.5), "zeta": (0.005, 0.02)}, most=100.0),
}


def draw_setting(generator: np.random.Generator) -> dict[str, Any]:
    """A body, and three to six records of at most 320 samples; one campaign in four has the attitude too."""
    duration = float(generator.choice([400.0, 600.0]))
    return {
        "base": {"inertia_ratio": float(generator.uniform(0.35, 0.8))}, "records": int(generator.choice([3, 4, 6])),
        "duration": duration, "interval": duration / float(generator.choice([200, 300])),
        "attitude": bool(generator.random() < 0.25),
    }  # fmt: skip


def make(name: str, seed: int, effects: Mapping, setting: Mapping, noise: Mapping) -> dict[str, Any]:
    """A campaign with noise."""
    return make_tumble_campaign(name, seed, effects, setting["base"], setting["records"],
                                duration=setting["duration"], interval=setting["interval"],
                                attitude=setting["attitude"], **noise)


def prepare(setting: Mapping, seed: int) -> Callable[[Mapping], float]:
    """The function effects -> misfit of the rates over noise."""
    starts = draw_rates(np.random.Generator(np.random.PCG64(seed)), setting["records"])
    times = np.linspace(0.0, setting["duration"], 101)
    return partial(_measure, setting["base"], fixed=(starts, times))


def _measure(base: Mapping, effects: Mapping, fixed: tuple) -> float:
    return measure_tumble_misfit(base, effects, *fixed, tolerance=TOLERANCE)


def hold_out(effects: Mapping, setting: Mapping) -> list[HeldOut]:
    """Two records from other rates."""
    times = np.linspace(0.0, setting["duration"], 201)
    found = []
    for start in HELDOUT:
        rates, _ = simulate_tumbling(setting["base"], effects, start, times, ORBIT_RATE)
        conditions = {f"{rate}0": value for rate, value in zip(RATES, start, strict=True)}
        found.append(HeldOut(conditions, times, rates))
    return found


TUMBLE = Bench(
    "tumble", dict.fromkeys(RATES, NOISE), "time", CATALOGUE, OUTSIDE, draw_setting, make, write_tumble_folder,
    lambda campaign: [row["rates"] for row in campaign["records"]], prepare, hold_out,
)  # fmt: skip
