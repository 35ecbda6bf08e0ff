"""Make everything under ``data/``: ``python -m tests.independent.make_data [FOLDER]`` from the repository's root.

Every campaign has a fixed seed, so the same versions of NumPy and SciPy give the same bytes. What is hidden in which
campaign stands in PLANS, SLIP_PLANS, OBLIQUE_PLANS, TUMBLE_PLANS and ``truth.json``: do not look before having tried.
"""

import sys
from pathlib import Path

import numpy as np

from ddetumble.exam.simulators.campaigns import write_json, write_package
from ddetumble.exam.simulators.impact import CHANNELS
from ddetumble.exam.simulators.impact_campaigns import choose_heldout, make_campaign, refer_impacts
from ddetumble.exam.simulators.oblique_campaigns import choose_oblique_heldout, make_oblique_campaign
from ddetumble.exam.simulators.slip_campaigns import (
    choose_slip_heldout,
    make_slip_campaign,
    place_path,
    refer_slip,
)
from ddetumble.exam.simulators.strength import measure_misfit
from ddetumble.exam.simulators.tumbling_campaigns import HELDOUT, make_tumble_campaign, measure_tumble_misfit

from .paper_tables import write_paper


SOURCE = "The project's own simulator, python -m tests.independent.make_data"
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

# pressures 1 MPa apart tell K from tan delta; loads stay below 30 N, where Eq. 10 still converges with slip
SLIP_PLANS = {
    "slip-a": {
        "seed": 20260201,
        "effects": {"adhesive-offset": {"f_a": 0.28}},
        "base": {"adhesion_constant": 0.874, "loss_factor": 0.163, "slip_scale": 1.0},
        "loads": [6.0, 12.0, 20.0, 27.0],
        "pressures": [0.8e6, 1.9e6],
        "speeds": [0.02, 0.1, 0.4],
    },
    "slip-b": {
        "seed": 20260202,
        "effects": {"viscous-friction": {"c_t": 0.93}},
        "base": {"adhesion_constant": 1.092, "loss_factor": 0.137, "slip_scale": 1.0},
        "loads": [5.0, 11.0, 18.0, 26.0],
        "pressures": [0.7e6, 2.1e6],
        "speeds": [0.03, 0.12, 0.36],
        "rho": 0.7,
    },
    "slip-c": {
        "seed": 20260203,
        "effects": {},
        "base": {"adhesion_constant": 0.731, "loss_factor": 0.208, "slip_scale": 1.0},
        "loads": [7.0, 14.0, 25.0],
        "pressures": [0.8e6, 2.0e6],
        "speeds": [0.04, 0.3],
        "repeats": 2,
        "setting_scatter": 0.01,
    },
    "slip-d": {
        "seed": 20260204,
        "effects": {"presliding": {"s_0": 1.6e-4}},
        "base": {"adhesion_constant": 0.958, "loss_factor": 0.181, "slip_scale": 1.0},
        "loads": [7.0, 15.0, 26.0],
        "pressures": [0.8e6, 1.9e6],
        "speeds": [0.02, 0.2],
        "strokes": [8e-3, 8e-3, 8e-3, 8e-3],
    },
    # Long strokes at many loads by a finer gauge: they determine the coefficients of Eq. 10 themselves.
    "slip-e": {
        "seed": 20260205,
        "effects": {},
        "base": {"adhesion_constant": 0.842, "loss_factor": 0.149, "slip_scale": 1.0},
        "loads": [5.0, 7.1, 9.2, 11.3, 13.4, 15.5, 17.5, 19.6, 21.7, 23.8, 25.9, 28.0],
        "pressures": [0.5e6, 2.5e6],
        "speeds": [0.02],
        "length": 40e-3,
        "interval": 1e-3,
        "noise": 0.003,
    },
}

# angles of incidence from flat to steep: some records slide throughout, some grip early
OBLIQUE_PLANS = {
    "oblique-a": {
        "seed": 20260301,
        "effects": {"tangential-compliance": {"compliance": 4.6e-5}},
        "base": {"effective_mass": 1.284, "restitution": 0.712, "adhesion_constant": 0.846, "loss_factor": 0.152,
                 "tangential_mass": 1.173, "rolling_mass": 0.45},
        "pressures": [0.6e6, 1.2e6, 2.1e6],
        "speeds": [0.2, 0.45],
        "slides": [0.1, 0.28, 0.6],
    },
    "oblique-b": {
        "seed": 20260302,
        "effects": {"off-centre-reaction": {"share": 0.14}},
        "base": {"effective_mass": 1.461, "restitution": 0.684, "adhesion_constant": 0.913, "loss_factor": 0.141,
                 "tangential_mass": 1.322, "rolling_mass": 0.52},
        "pressures": [0.5e6, 1.1e6, 2.3e6],
        "speeds": [0.18, 0.4],
        "slides": [0.09, 0.24, 0.5],
    },
    "oblique-c": {
        "seed": 20260303,
        "effects": {},
        "base": {"effective_mass": 1.137, "restitution": 0.741, "adhesion_constant": 0.782, "loss_factor": 0.163,
                 "tangential_mass": 1.046, "rolling_mass": 0.41},
        "pressures": [0.7e6, 1.4e6, 2.4e6],
        "speeds": [0.22, 0.5],
        "slides": [0.12, 0.55],
        "rho": 0.7,
        "setting_scatter": 0.01,
    },
    "oblique-d": {
        "seed": 20260304,
        "effects": {"tangential-compliance": {"compliance": 3.1e-5}, "stribeck": {"A": 0.24, "u_s": 0.09}},
        "base": {"effective_mass": 1.369, "restitution": 0.697, "adhesion_constant": 0.871, "loss_factor": 0.147,
                 "tangential_mass": 1.254, "rolling_mass": 0.48},
        "pressures": [0.6e6, 1.3e6, 2.2e6],
        "speeds": [0.2, 0.42],
        "slides": [0.11, 0.27, 0.58],
        "channels": ("normal_force", "tangential_force", "slip"),
    },
}

TUMBLE_PLANS = {
    "tumble-a": {
        "seed": 20260401,
        "effects": {"constant-torque": {"torque": [4.0e-7, -6.0e-7, 9.0e-8]}},
        "base": {"inertia_ratio": 0.538},
    },
    "tumble-b": {
        "seed": 20260402,
        "effects": {"internal-damper": {"c": 6.2e-6, "I_d": 0.041}, "gyro-bias": {"bias": [4.1e-5, -5.3e-5, 3.7e-5]}},
        "base": {"inertia_ratio": 0.612},
        "records": 5,
        "duration": 800.0,
        "interval": 2.5,
        "rho": 0.7,
    },
    "tumble-c": {
        "seed": 20260403,
        "effects": {},
        "base": {"inertia_ratio": 0.447},
        "duration": 500.0,
        "attitude": True,
        "rho": 0.5,
    },
    "tumble-d": {
        "seed": 20260404,
        "effects": {"x-sine-torque": {"torque": [4.3e-6, 8.7e-6, -5.8e-6], "period": 53.0}},
        "base": {"inertia_ratio": 0.571},
    },
}


def measure_impact(campaign, plan):
    """Return the function effects -> rms over noise that a refitted reference model leaves."""
    reference = refer_impacts(campaign.base, [row.true for row in campaign.records], list(campaign.noise.values()),
                              campaign.uncertainties, tuple(campaign.noise), rtol=1e-9)
    return lambda effects: measure_misfit(reference, effects, 4)


def measure_slip(campaign, plan):
    """The same of friction."""
    strokes = plan.get("strokes")
    path, turns = place_path(plan.get("length", 12e-3), plan.get("interval", 1e-4), strokes)
    reference = refer_slip(campaign.base, [row.true for row in campaign.records], path,
                           campaign.noise["tangential_force"], campaign.uncertainties, strokes, turns)
    return lambda effects: measure_misfit(reference, effects)


def measure_tumble(campaign, plan):
    """The same of tumbling."""
    starts = [row.true["w0"] for row in campaign.records]
    times, noise = campaign.place({})[0], next(iter(campaign.noise.values()))
    return lambda effects: measure_tumble_misfit(campaign.base, effects, starts, times, noise)


# plans, what makes a campaign, conditions held out, what measures strengths, digits of readings, what is told
FAMILIES = (
    (PLANS, make_campaign, lambda plan, count: choose_heldout(plan["pressures"], plan["speeds"], count + 1),
     measure_impact, 6, ("rho", "white_share", "setting_scatter")),
    (SLIP_PLANS, make_slip_campaign,
     lambda plan, _: choose_slip_heldout(plan["loads"], plan["pressures"], plan["speeds"]), measure_slip, 6,
     ("rho", "white_share", "setting_scatter")),
    (OBLIQUE_PLANS, make_oblique_campaign,
     lambda plan, _: choose_oblique_heldout(plan["pressures"], plan["speeds"], plan["slides"]), None, 6,
     ("rho", "setting_scatter")),
    (TUMBLE_PLANS, make_tumble_campaign, lambda *_: [{"w0": start} for start in HELDOUT], measure_tumble, 9,
     ("rho", "white_share")),
)  # fmt: skip


def reveal(campaign, plan, heldout, measure, digits, same):
    """Return what is hidden in a campaign, with noise-free readings at conditions that it does not hold.

    x is time (s) or slip (m); beside time in strokes `slip` (m) stands, and y holds null at a reversal. Of impacts y
    is the normal force alone, of tumbling the rates.
    """
    told = {"family": campaign.family} | {name: getattr(campaign, name) for name in ("effects", "base", "seed", *same)}
    if "strokes" in plan:
        told["strokes"] = list(plan["strokes"])
    if measure is not None:
        misfit = measure(campaign, plan)
        told["strength"] = [round(misfit({name: one}), 2) for name, one in campaign.effects.items()] or [0.0]
    count = {"impact": 1, "tumble": 3}.get(campaign.family, 1) if measure is not None else len(campaign.noise)
    told["heldout"] = []
    for conditions in heldout:
        places, along = campaign.place(conditions)
        columns = [[round(float(x), 9) + 0.0 for x in column] for column in along.values()]
        readings = campaign.read(conditions, places)[:, :count]
        y = [[None if np.isnan(x) else round(float(x), digits) + 0.0 for x in row] for row in readings]
        told["heldout"].append({"conditions": conditions, **dict(zip(("x", "slip"), columns, strict=False)), "y": y})
    return told


def make_data(folder):
    """Write all packages and truth.json under the folder."""
    folder = Path(folder)
    write_paper(folder / "paper")
    truth = {}
    for plans, make, choose, measure, digits, same in FAMILIES:
        for name, plan in plans.items():
            campaign = make(name, **plan)
            write_package(folder / name, campaign, SOURCE)
            heldout = choose(plan, len(campaign.records))
            truth[name] = reveal(campaign, plan, heldout, measure, digits, same)
            print(f"{name}: {len(campaign.records)} records", file=sys.stderr)
    write_json(folder / "truth.json", truth, indent=None)


if __name__ == "__main__":
    make_data(sys.argv[1] if len(sys.argv) > 1 else "data")
