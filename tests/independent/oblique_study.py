"""Cases of the blind study on oblique impacts (see `study`)."""

from pathlib import Path

import numpy as np

from .oblique_campaigns import make_oblique_campaign, write_oblique_folder


TYPICAL = {
    "tangential-compliance": {"compliance": 4e-5}, "off-centre-reaction": {"share": 0.15},
    "stribeck": {"A": 0.3, "u_s": 0.08}, "viscous-friction": {"c_t": 1.0}, "load-exponent": {"m": 0.08},
    "adhesive-offset": {"f_a": 0.3}, "wall-stiffness": {"k_w": 1000.0, "q": 1.0}, "viscous-dashpot": {"c_v": 6.0},
}  # fmt: skip
OUTSIDE = {"x-tack": {"A": 0.25, "t_0": 0.006}, "x-arm-push": {"force": 1.5}}


def draw_oblique_case(seed: int) -> dict:
    """Settings of one case, from its seed alone."""
    generator = np.random.default_rng([20261123, seed])
    kind = ["null", "single", "single", "outside", "null", "single", "pair", "single"][seed % 8]
    names = list(TYPICAL)
    effects: dict = {}
    if kind == "single":
        name = names[(seed // 8 * 4 + {1: 0, 2: 1, 5: 2, 7: 3}[seed % 8]) % len(names)]
        effects = {name: dict(TYPICAL[name])}
    elif kind == "pair":
        first = ["tangential-compliance", "off-centre-reaction"][seed // 8 % 2]
        effects = {n: dict(TYPICAL[n]) for n in (first, str(generator.choice(names[2:])))}
    elif kind == "outside":
        name = list(OUTSIDE)[seed // 8 % len(OUTSIDE)]
        effects = {name: dict(OUTSIDE[name])}
    pick = generator.uniform
    return {
        "kind": kind, "effects": effects, "seed": int(seed),
        "base": {"effective_mass": float(pick(1.0, 1.8)), "restitution": float(pick(0.62, 0.82)),
                 "adhesion_constant": float(pick(0.6, 1.1)), "loss_factor": float(pick(0.12, 0.2)),
                 "tangential_mass": float(pick(0.8, 1.6)), "rolling_mass": float(pick(0.3, 0.7))},
        "pressures": sorted(float(x) for x in pick(0.4e6, 2.5e6, int(generator.integers(2, 4)))),
        "speeds": sorted(float(x) for x in pick(0.15, 0.6, 2)),
        "slides": sorted(float(x) for x in np.exp(pick(np.log(0.06), np.log(0.7), 3))),
        "interval": float(generator.choice([2.5e-4, 4.0e-4])), "rho": float(generator.choice([0.0, 0.0, 0.6])),
        "setting_scatter": float(generator.choice([0.0, 0.01])),
    }  # fmt: skip


def make_oblique_case(case: dict, folder: Path) -> None:
    """Simulate one case into a folder."""
    campaign = make_oblique_campaign(
        f"case-{case['seed']:03d}", case["seed"] + 9000, case["effects"], case["base"], case["pressures"],
        case["speeds"], case["slides"], interval=case["interval"], rho=case["rho"],
        setting_scatter=case["setting_scatter"])
    write_oblique_folder(folder, campaign)
