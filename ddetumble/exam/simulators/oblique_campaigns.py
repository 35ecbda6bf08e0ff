"""Synthetic campaigns of oblique impacts: a plan of tests, what was really done, what was written down, the folder."""

import numpy as np

from . import impact_campaigns as straight
from .oblique import CREEP, ROLLING, simulate_strike


# one standard deviation: relative for the conditions, s for the time origin, N and m for the channels
UNCERTAINTIES = straight.UNCERTAINTIES | {"tangential_speed": 0.003}
NOISE = straight.NOISE | {"tangential_force": 0.08, "slip": 2e-5}
CONDITIONS = ("initial_pressure", "approach_speed", "tangential_speed")


def choose_oblique_heldout(pressures, speeds, slides):
    """Return three conditions at none of the campaign's own: means of neighbours, and 0.9 times the highest."""
    p, v, u = sorted(pressures), sorted(speeds), sorted(slides)
    low, high = (p[0] * p[1]) ** 0.5, (p[-2] * p[-1]) ** 0.5
    slow, fast = (v[0] * v[min(1, len(v) - 1)]) ** 0.5, 0.9 * v[-1]
    flat, steep = 0.9 * u[-1], (u[0] * u[min(1, len(u) - 1)]) ** 0.5
    triples = ((low, fast, flat), (high, slow, steep), (high, fast, steep))
    return [dict(zip(CONDITIONS, (float(f"{x:.6g}") for x in triple), strict=True)) for triple in triples]


def make_oblique_campaign(
    name, seed, effects, base, pressures, speeds, slides, repeats=1, *, channels=("normal_force", "tangential_force"),
    interval=2.5e-4, before=2e-3, length=1.45, noise=None, rho=0.0, white_share=0.0, setting_scatter=0.0, steps=400,
    title=straight.TITLE,
):  # fmt: skip
    """Return a campaign: every pressure (Pa) with every approach and tangential speed (m/s), in random order.

    As `impact_campaigns.make_campaign`, whose folder is written in the same way; steps: see `oblique.integrate_strike`.
    """
    deviations = NOISE | (noise or {})
    generator = np.random.Generator(np.random.PCG64(seed))
    plan = [(p, v, u) for p in pressures for v in speeds for u in slides] * repeats
    tests = [dict(zip(CONDITIONS, plan[k], strict=True)) for k in generator.permutation(len(plan))]
    known = {"outer_diameter": "60 mm", "effective_mass": None, "restitution": None, "tangential_mass": None,
             "rolling_mass": f"{base.get('rolling_mass', ROLLING):g} kg",
             "creep_speed": f"{base.get('creep_speed', CREEP):g} m/s", "adhesion_constant": None,
             "loss_factor": base["loss_factor"]}  # fmt: skip
    campaign = {
        "name": name, "title": title, "seed": seed, "effects": effects, "base": base, "channels": tuple(channels),
        "uncertainties": UNCERTAINTIES, "noise": {c: deviations[c] for c in channels}, "rho": rho,
        "white_share": white_share, "setting_scatter": setting_scatter, "interval": interval, "before": before,
        "length": length, "heldout": choose_oblique_heldout(pressures, speeds, slides), "known": known, "digits": 3,
    }  # fmt: skip
    return straight.add_records(campaign, generator, tests, lambda true, times: simulate_strike(
        base, effects, true, times, channels, steps))  # fmt: skip


def reveal_oblique_campaign(campaign):
    """Return what is hidden in a campaign, with noise-free channels at conditions that it does not hold."""
    heldout = straight.reveal_heldout(campaign, lambda conditions, times: simulate_strike(
        campaign["base"], campaign["effects"], conditions, times, campaign["channels"]))  # fmt: skip
    same = ("effects", "base", "seed", "rho", "setting_scatter")
    return {"family": "impact"} | {name: campaign[name] for name in same} | {"heldout": heldout}
