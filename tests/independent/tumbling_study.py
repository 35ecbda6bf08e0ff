"""Cases of the blind study on tumbling records (see `study`)."""

from pathlib import Path

import numpy as np

from .tumbling_campaigns import draw_rates, make_tumble_campaign, measure_tumble_misfit, write_tumble_folder


TYPICAL = {
    "eddy-current": {"k_e": 1.0e-6}, "constant-torque": {"torque": [2.0e-7, -1.0e-7, 5.0e-8]},
    "inertia-asymmetry": {"epsilon": 1.0e-3}, "axis-misalignment": {"angle": 1.0e-3},
    "internal-damper": {"c": 8.0e-6, "I_d": 0.03}, "gravity-gradient": {"scale": 1.0},
    "gyro-bias": {"bias": [6.0e-5, -4.0e-5, 5.0e-5]},
}  # fmt: skip
OUTSIDE = {
    "x-quadratic-drag": {"k": 1.0e-5}, "x-sine-torque": {"torque": [2.0e-7, 3.0e-7, 1.0e-7], "period": 47.0},
    "x-growing-torque": {"slope": [4.0e-10, 2.0e-10, 2.0e-10]},
    "x-thruster": {"torque": [1.0e-7, -2.0e-7, 1.5e-7], "period": 130.0},
    "x-solar-torque": {"torque": [2.0e-8, 3.0e-8, -4.0e-8]}, "x-bias-walk": {"slope": [2e-7, 1e-7, 2e-7]},
    "x-flexible-panel": {"omega": 0.35, "zeta": 0.01, "ratio": 0.002},
}  # fmt: skip


def scale_effect(parameters: dict, factor: float) -> dict:
    """An effect whose amplitude is so many times as large; shapes and periods stay."""
    kept = ("I_d", "period", "omega", "zeta")
    return {name: value if name in kept else [factor * x for x in value] if isinstance(value, list) else factor * value
            for name, value in parameters.items()}


def draw_tumble_case(seed: int) -> dict:
    """Settings of one case, from its seed alone; effects leave two to five times the noise."""
    generator = np.random.default_rng([20261123, seed])
    kind = ["null", "single", "null", "single", "outside", "null", "single", "pair"][seed % 8]
    names, effects = list(TYPICAL), {}
    if kind == "single":
        effects = {names[(seed // 8 * 3 + {1: 0, 3: 1, 6: 2}[seed % 8]) % len(names)]: None}
    elif kind == "pair":
        # Effects of about the same signature are left to singles.
        effects = {str(n): None for n in generator.choice(["eddy-current", "inertia-asymmetry", "axis-misalignment",
                                                           "gyro-bias"], 2, replace=False)}
    elif kind == "outside":
        effects = {list(OUTSIDE)[seed // 8 % len(OUTSIDE)]: None}
    case = {
        "kind": kind, "effects": effects, "seed": int(seed),
        "base": {"inertia_ratio": float(generator.uniform(0.35, 0.8))}, "records": int(generator.integers(3, 7)),
        "duration": float(generator.choice([400.0, 600.0, 1000.0])),
        "interval": float(generator.choice([1.0, 2.0, 2.5])), "rho": float(generator.choice([0.0, 0.0, 0.5, 0.8])),
        "white_share": float(generator.choice([0.0, 0.0, 0.4])), "attitude": bool(generator.random() < 0.25),
        "strength": float(generator.uniform(2.0, 5.0)),
    }  # fmt: skip
    starts = draw_rates(np.random.Generator(np.random.PCG64(case["seed"] + 9000)), case["records"])
    times = np.arange(round(case["duration"] / case["interval"]) + 1) * case["interval"]
    for name in effects:
        typical = (TYPICAL | OUTSIDE)[name]
        left = measure_tumble_misfit(case["base"], {name: typical}, starts, times[::2])
        effects[name] = scale_effect(typical, case["strength"] / left)
    return case


def make_tumble_case(case: dict, folder: Path) -> None:
    """Simulate one case into a folder."""
    options = ("duration", "interval", "rho", "white_share", "attitude")
    campaign = make_tumble_campaign(f"case-{case['seed']:03d}", case["seed"] + 9000, case["effects"], case["base"],
                                    case["records"], **{name: case[name] for name in options})
    write_tumble_folder(folder, campaign)
