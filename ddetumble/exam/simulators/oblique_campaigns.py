"""Campaigns of oblique impacts: the ball strikes while it moves along the plate; both forces are read."""

import itertools
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np

from . import impact_campaigns as straight
from . import slip_campaigns as friction
from .campaigns import Campaign, draw_records, name_conditions, order_tests, place_between
from .generator import CaseGenerator, HeldOut, Hidden, leave_out, spread
from .oblique import CREEP, ROLLING, simulate_strike
from .strength import hold_slopes, refer_tests, share_logarithms


# one standard deviation: relative for the conditions, s for the time origin, N and m for the channels
UNCERTAINTIES = straight.UNCERTAINTIES | {"tangential_speed": 0.003}
NOISE = straight.NOISE | {"tangential_force": 0.08, "slip": 2e-5}
CONDITIONS = (*straight.CONDITIONS, "tangential_speed")
FORCES = ("normal_force", "tangential_force")
STEPS, COARSE = 100, 25  # of the simulator along the plate: 1e-5 N off, and 3e-4 N for strengths
SHARED = ("effective_mass", "restitution", "tangential_mass", "adhesion_constant")
CATALOGUE = {
    "tangential-compliance": Hidden({"compliance": 4e-5}, most=5.0),
    "off-centre-reaction": Hidden({"share": 0.15}, most=5.0),
    "sensor-crosstalk": Hidden({"c_tn": 0.02}, most=2.5, since=2),  # in the next edition
    **{name: friction.CATALOGUE[name] for name in ("stribeck", "viscous-friction", "load-exponent", "adhesive-offset")},
    **{name: straight.CATALOGUE[name] for name in ("wall-stiffness", "viscous-dashpot", "adhesion", "sensor-highpass")},
}
OUTSIDE = {
    "x-tack": Hidden({"A": 0.2}, shapes={"t_0": (4e-3, 1e-2)}),
    "x-arm-push": Hidden({"force": 1.0}, most=5.0),
}


def draw_setting(generator: np.random.Generator) -> dict[str, Any]:
    """A ball and arm, and a plan of 12 or 18 tests of at most 384 samples, from flat to steep."""
    pick = generator.uniform
    return {
        "base": {"effective_mass": float(pick(1.0, 1.8)), "restitution": float(pick(0.62, 0.8)),
                 "adhesion_constant": float(pick(0.6, 1.1)), "loss_factor": float(pick(0.12, 0.2)),
                 "tangential_mass": float(pick(0.8, 1.6)), "rolling_mass": float(pick(0.3, 0.7))},
        "pressures": spread(generator, 0.4e6, 2.5e6, int(generator.choice([2, 3]))),
        "speeds": spread(generator, 0.15, 0.6, 2), "slides": spread(generator, 0.06, 0.7, 3), "interval": 4.0e-4,
        "setting_scatter": float(generator.choice([0.0, 0.01])),
    }  # fmt: skip


def choose_oblique_heldout(pressures, speeds, slides):
    """Return three conditions at none of the campaign's own."""
    low, high, _ = place_between(pressures)
    slow, _, fast = place_between(speeds)
    steep, _, flat = place_between(slides)
    return name_conditions(CONDITIONS, ((low, fast, flat), (high, slow, steep), (high, fast, steep)))


def make_oblique_campaign(
    name, seed, effects, base, pressures, speeds, slides, repeats=1, *, channels=FORCES, interval=2.5e-4, before=2e-3,
    length=1.45, noise=None, rho=0.0, white_share=0.0, setting_scatter=0.0, steps=400,
):  # fmt: skip
    """Return a campaign: every pressure (Pa) with every approach and tangential speed (m/s), in random order.

    As `impact_campaigns.make_campaign`; steps: see `oblique.integrate_strike`.
    """
    generator = np.random.Generator(np.random.PCG64(seed))
    tests = order_tests(generator, CONDITIONS, (pressures, speeds, slides), repeats)
    deviations = NOISE | (noise or {})
    known = straight.KNOWN | {"tangential_mass": None, "rolling_mass": f"{base.get('rolling_mass', ROLLING):g} kg",
                              "creep_speed": f"{base.get('creep_speed', CREEP):g} m/s", "adhesion_constant": None,
                              "loss_factor": base["loss_factor"]}  # fmt: skip

    def place(conditions):
        times = straight.place_times(base, conditions, interval, before, length)
        return times, {"time": times}

    campaign = Campaign(
        name, "impact", seed, effects, base, known, CONDITIONS, UNCERTAINTIES, {c: deviations[c] for c in channels},
        [3] * len(channels), place, lambda true, times: simulate_strike(base, effects, true, times, channels, steps),
        rho, white_share, setting_scatter,
    )  # fmt: skip
    return draw_records(campaign, generator, tests)


def prepare(setting: Mapping, seed: int) -> Callable[[Mapping], float]:
    """The function effects -> misfit over noise; four nuisances a record: pressure, two speeds, time origin."""
    base, scale = setting["base"], np.array([NOISE[channel] for channel in FORCES])
    plan = itertools.product(setting["pressures"], setting["speeds"], setting["slides"])
    tests = [dict(zip(CONDITIONS, one, strict=True)) for one in plan][seed % 2 :: 2]
    return hold_slopes(refer_tests(
        base, share_logarithms(base, SHARED), tests, [straight.place_times(base, c, 1.5e-3) for c in tests],
        {name: UNCERTAINTIES[name] for name in (*CONDITIONS, "time")},
        lambda model, effects, moved, times: simulate_strike(model, effects, moved, times, FORCES, COARSE) / scale), 2)


def hold_out(effects: Mapping, setting: Mapping) -> list[HeldOut]:
    """Three tests at other pressures and speeds."""
    base, tests = setting["base"], choose_oblique_heldout(setting["pressures"], setting["speeds"], setting["slides"])
    times = [straight.place_times(base, conditions, 5e-4) for conditions in tests]
    return [HeldOut(c, t, simulate_strike(base, effects, c, t, FORCES, STEPS))
            for c, t in zip(tests, times, strict=True)]


OBLIQUE = CaseGenerator(
    "oblique", {channel: NOISE[channel] for channel in FORCES}, "time", CATALOGUE, OUTSIDE, draw_setting,
    partial(make_oblique_campaign, steps=STEPS), prepare, hold_out, leave_out(),
    {"normal_force": ("sensor-gain",)} | straight.RINGING,
)  # fmt: skip
