"""Make everything under ``data/``: ``python -m tests.independent.make_data [FOLDER]`` from the repository's root.

Every campaign has a fixed seed, so the same versions of NumPy and SciPy give the same bytes. What is hidden in which
campaign stands in PLANS below and in ``truth.json``: do not look before having tried.
"""

import sys
from pathlib import Path

from .campaigns import make_campaign, reveal_campaign, write_campaign_folder, write_json
from .impact import CHANNELS
from .paper_tables import write_paper


PAPER_PRESSURES = [1.0e6, 1.5e6, 2.0e6, 2.5e6]  # Pa, Figure 8

PLANS = {
    "impact-a": {
        "seed": 20260101,
        "effects": {"stress-softening": {"sigma_m": 0.24, "j_0": 6.0}},
        "base": {"effective_mass": 1.372, "restitution": 0.734},
        "pressures": [0.4e6, 0.9e6, 1.5e6, 2.2e6],
        "speeds": [0.15, 0.35, 0.70],
    },
    "impact-b": {
        "seed": 20260102,
        "effects": {"adhesion": {"tau_a": 8.6e4}},
        "base": {"effective_mass": 1.118, "restitution": 0.681},
        "pressures": [0.5e6, 1.1e6, 2.0e6],
        "speeds": [0.14, 0.30, 0.62],
    },
    "impact-c": {
        "seed": 20260103,
        "effects": {"pressure-dependent-restitution": {"p": 0.13}},
        "base": {"effective_mass": 1.655, "restitution": 0.702},
        "pressures": [0.4e6, 0.8e6, 1.4e6, 2.1e6],
        "speeds": [0.16, 0.36, 0.72],
        "setting_scatter": 0.01,
    },
    "impact-d": {
        "seed": 20260104,
        "effects": {},
        "base": {"effective_mass": 1.486, "restitution": 0.763},
        "pressures": [0.6e6, 1.2e6, 2.0e6],
        "speeds": [0.20, 0.55],
        "repeats": 3,
        "rho": 0.7,
    },
    "impact-e": {
        "seed": 20260105,
        "effects": {"polytropic-gas": {"n": 1.4}},
        "base": {"effective_mass": 1.241, "restitution": 0.718},
        "pressures": [0.5e6, 1.2e6, 2.3e6],
        "speeds": [0.30, 0.65],
        "channels": CHANNELS,
    },
    "impact-f": {
        "seed": 20260106,
        "effects": {"x-end-stop": {"k": 1.6e5, "depth": 0.0061, "exponent": 1.5}},
        "base": {"effective_mass": 1.304, "restitution": 0.697},
        "pressures": [0.4e6, 0.9e6, 1.7e6],
        "speeds": [0.15, 0.35, 0.68],
    },
    "impact-g": {
        "seed": 20260107,
        "effects": {"polytropic-gas": {"n": 1.4}},
        "base": {"effective_mass": 1.241, "restitution": 0.718},
        "pressures": PAPER_PRESSURES,
        "speeds": [0.4],
        "repeats": 4,
    },
    "impact-h": {
        "seed": 20260108,
        "effects": {"arm-servo": {"k_s": 240.0}, "wall-stiffness": {"k_w": 1300.0, "q": 1.0}},
        "base": {"effective_mass": 1.590, "restitution": 0.742},
        "pressures": [0.6e6, 1.2e6, 2.2e6],
        "speeds": [0.18, 0.40, 0.75],
        "rho": 0.8,
        "white_share": 0.5,
    },
    "impact-i": {
        "seed": 20260109,
        "effects": {},
        "base": {"effective_mass": 1.087, "restitution": 0.655},
        "pressures": [0.5e6, 1.0e6, 1.9e6],
        "speeds": [0.22, 0.58],
    },
}


def make_data(folder):
    """Write all packages and truth.json under the folder."""
    folder = Path(folder)
    write_paper(folder / "paper")
    truth = {}
    for name, plan in PLANS.items():
        campaign = make_campaign(name, **plan)
        write_campaign_folder(folder / name, campaign)
        truth[name] = reveal_campaign(campaign)
        print(f"{name}: {len(campaign['records'])} records", file=sys.stderr)
    write_json(folder / "truth.json", truth, indent=None)


if __name__ == "__main__":
    make_data(sys.argv[1] if len(sys.argv) > 1 else "data")
