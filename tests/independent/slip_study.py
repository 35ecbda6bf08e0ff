"""Cases of the blind study on slip records (see `study`)."""

from pathlib import Path

import numpy as np

from .slip_campaigns import make_slip_campaign, write_slip_folder


TYPICAL = {
    "stribeck": {"A": 0.3, "u_s": 0.07}, "viscous-friction": {"c_t": 0.7}, "load-exponent": {"m": 0.05},
    "presliding": {"s_0": 2.0e-4}, "frictional-heating": {"kappa": 4.0}, "adhesive-offset": {"f_a": 0.25},
}  # fmt: skip
OUTSIDE = {
    "x-stick-slip": {"ratio": 0.03, "wavelength": 1.7e-3}, "x-wear": {"w": 0.25, "j_0": 8.0},
    "x-creep": {"A": 0.08, "t_0": 0.01},
}  # fmt: skip


def draw_slip_case(seed: int) -> dict:
    """Settings of one case, from its seed alone."""
    generator = np.random.default_rng([20261122, seed])
    kind = ["null", "single", "null", "single", "outside", "null", "single", "pair"][seed % 8]
    names = list(TYPICAL)
    effects: dict = {}
    if kind == "single":
        name = names[(seed // 8 * 3 + {1: 0, 3: 1, 6: 2}[seed % 8]) % len(names)]
        effects = {name: dict(TYPICAL[name])}
    elif kind == "pair":
        effects = {str(n): dict(TYPICAL[str(n)]) for n in generator.choice(names, 2, replace=False)}
    elif kind == "outside":
        name = list(OUTSIDE)[seed // 8 % len(OUTSIDE)]
        effects = {name: dict(OUTSIDE[name])}
    pick = generator.uniform
    return {
        "kind": kind, "effects": effects, "seed": int(seed),
        "base": {"adhesion_constant": float(pick(0.6, 1.2)), "loss_factor": float(pick(0.1, 0.22)),
                 "tensile_strength": 10e6, "real_contact_pressure": 20e6, "slip_scale": float(pick(0.9, 1.1))},
        "loads": sorted(float(x) for x in pick(5.0, 29.0, int(generator.integers(2, 5)))),
        "pressures": sorted(float(x) for x in pick(0.5e6, 2.5e6, int(generator.integers(2, 4)))),
        "speeds": sorted(float(x) for x in np.exp(pick(np.log(0.02), np.log(0.45), int(generator.integers(2, 5))))),
        "repeats": int(generator.integers(1, 3)), "length": float(generator.choice([8e-3, 1e-2, 1.4e-2])),
        "interval": float(generator.choice([5e-5, 1e-4, 2e-4])), "rho": float(generator.choice([0.0, 0.0, 0.5, 0.8])),
        "white_share": float(generator.choice([0.0, 0.0, 0.4])),
        "setting_scatter": float(generator.choice([0.0, 0.01])),
    }  # fmt: skip


def make_slip_case(case: dict, folder: Path) -> None:
    """Simulate one case into a folder; a series is numbered where the hidden effect needs it."""
    campaign = make_slip_campaign(
        f"case-{case['seed']:03d}", case["seed"] + 7000, case["effects"], case["base"], case["loads"],
        case["pressures"], case["speeds"], case["repeats"], length=case["length"], interval=case["interval"],
        rho=case["rho"], white_share=case["white_share"], setting_scatter=case["setting_scatter"],
        numbered="x-wear" in case["effects"])
    write_slip_folder(folder, campaign)
