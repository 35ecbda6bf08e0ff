"""The bench of oblique impacts: the ball strikes while it moves along the plate; both forces are read."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from ..simulators.impact_campaigns import write_campaign_folder
from ..simulators.oblique import simulate_strike
from ..simulators.oblique_campaigns import (
    CONDITIONS,
    NOISE,
    UNCERTAINTIES,
    choose_oblique_heldout,
    make_oblique_campaign,
)
from ..simulators.strength import hold_slopes, place_times
from .bench import Bench, HeldOut, Hidden
from .impact import CATALOGUE as NORMAL
from .impact import spread
from .slip import CATALOGUE as FRICTION


CHANNELS = ("normal_force", "tangential_force")
STEPS, COARSE = 100, 25  # of the simulator along the plate: 1e-5 N off, and 3e-4 N for strengths
SHARED = ("effective_mass", "restitution", "tangential_mass", "adhesion_constant")
CATALOGUE = {
    "tangential-compliance": Hidden({"compliance": 4e-5}, most=5.0),
    "off-centre-reaction": Hidden({"share": 0.15}, most=5.0),
    **{name: FRICTION[name] for name in ("stribeck", "viscous-friction", "load-exponent", "adhesive-offset")},
    **{name: NORMAL[name] for name in ("wall-stiffness", "viscous-dashpot", "adhesion", "sensor-highpass")},
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


def make(name: str, seed: int, effects: Mapping, setting: Mapping, noise: Mapping) -> dict[str, Any]:
    """A campaign with noise."""
    return make_oblique_campaign(name, seed, effects, setting["base"], setting["pressures"], setting["speeds"],
                                 setting["slides"], interval=setting["interval"],
                                 setting_scatter=setting["setting_scatter"], steps=STEPS, **noise)


def prepare(setting: Mapping, seed: int) -> Callable[[Mapping], float]:
    """The function effects -> misfit over noise; four nuisances a record: pressure, two speeds, time origin."""
    base = setting["base"]
    tests = [dict(zip(CONDITIONS, (p, v, u), strict=True)) for p in setting["pressures"] for v in setting["speeds"]
             for u in setting["slides"]][seed % 2 :: 2]  # fmt: skip
    times = [place_times(base, c, 1.5e-3) for c in tests]
    scale = np.array([NOISE[channel] for channel in CHANNELS])
    prior = np.array([UNCERTAINTIES[name] for name in (*CONDITIONS, "time")])

    def read(i, model, effects, own):
        moved = {c: x * (1.0 + s) for (c, x), s in zip(tests[i].items(), prior * own, strict=False)}
        found = simulate_strike(model, effects, moved, times[i] + prior[3] * own[3], CHANNELS, COARSE)
        return (found / scale).ravel()

    return hold_slopes(base, SHARED, read, len(tests), 4, 2)


def hold_out(effects: Mapping, setting: Mapping) -> list[HeldOut]:
    """Three tests at other pressures and speeds."""
    found = []
    for conditions in choose_oblique_heldout(setting["pressures"], setting["speeds"], setting["slides"]):
        times = place_times(setting["base"], conditions, 5e-4)
        readings = simulate_strike(setting["base"], effects, conditions, times, CHANNELS, STEPS)
        found.append(HeldOut({**conditions}, times, readings))
    return found


OBLIQUE = Bench(
    "oblique", {channel: NOISE[channel] for channel in CHANNELS}, "time", CATALOGUE, OUTSIDE, draw_setting, make,
    write_campaign_folder, lambda campaign: [trace["values"] for trace in campaign["samples"]], prepare, hold_out,
)  # fmt: skip
