"""The bench of friction: rubber slides under constant load, pressure and speed; the friction force is read."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from ..simulators.slip import simulate_slip
from ..simulators.slip_campaigns import (
    SLIP_NOISE,
    SLIP_UNCERTAINTIES,
    choose_slip_heldout,
    make_slip_campaign,
    order_slip_tests,
    place_path,
    write_slip_folder,
)
from ..simulators.strength import hold_slopes
from .bench import Bench, HeldOut, Hidden
from .impact import spread


NUISANCES = ("normal_load", "internal_pressure")
SHARED = ("adhesion_constant", "loss_factor", "slip_scale")
CATALOGUE = {
    "stribeck": Hidden({"A": 0.3}, shapes={"u_s": (0.04, 0.12)}),
    "viscous-friction": Hidden({"c_t": 0.7}),
    "load-exponent": Hidden({"m": 0.05}),
    "presliding": Hidden({"s_0": 2.0e-4}),
    "frictional-heating": Hidden({"kappa": 4.0}),
    "adhesive-offset": Hidden({"f_a": 0.25}),
}
OUTSIDE = {
    "x-stick-slip": Hidden({"ratio": 0.03}, shapes={"wavelength": (1.0e-3, 2.5e-3)}),
    "x-wear": Hidden({"w": 0.2}, shapes={"j_0": (4.0, 12.0)}, most=4.0),
    "x-creep": Hidden({"A": 0.06}, shapes={"t_0": (5e-3, 2e-2)}),
}


def draw_setting(generator: np.random.Generator) -> dict[str, Any]:
    """Rubber, and a plan of 12 to 24 tests of at most 256 samples; loads stay below 30 N, where Eq. 10 ends."""
    pick = generator.uniform
    loads, pressures, speeds = [(3, 2, 2), (4, 2, 2), (3, 2, 3), (4, 2, 3)][generator.integers(4)]
    return {
        "base": {"adhesion_constant": float(pick(0.6, 1.2)), "loss_factor": float(pick(0.1, 0.22)),
                 "slip_scale": float(pick(0.9, 1.1))},
        "loads": spread(generator, 5.0, 29.0, loads), "pressures": spread(generator, 0.5e6, 2.5e6, pressures),
        "speeds": spread(generator, 0.02, 0.45, speeds), "length": float(generator.choice([8e-3, 1e-2, 1.2e-2])),
        "interval": float(generator.choice([5e-5, 1e-4])), "setting_scatter": float(generator.choice([0.0, 0.01])),
    }  # fmt: skip


def make(name: str, seed: int, effects: Mapping, setting: Mapping, noise: Mapping) -> dict[str, Any]:
    """A campaign with noise; its tests are numbered, whatever is hidden."""
    return make_slip_campaign(name, seed, effects, setting["base"], setting["loads"], setting["pressures"],
                              setting["speeds"], length=setting["length"], interval=setting["interval"],
                              setting_scatter=setting["setting_scatter"], numbered=True, **noise)


def prepare(setting: Mapping, seed: int) -> Callable[[Mapping], float]:
    """The function effects -> misfit over noise; two nuisances a record: load and pressure."""
    tests = order_slip_tests(np.random.Generator(np.random.PCG64(seed)), setting["loads"], setting["pressures"],
                             setting["speeds"])
    path = place_path(setting["length"], setting["interval"])[0][::2]
    prior = np.array([SLIP_UNCERTAINTIES[name] for name in NUISANCES])

    def read(i, model, effects, own):
        moved = {c: tests[i][c] * (1.0 + x) for c, x in zip(NUISANCES, prior * own, strict=True)}
        return simulate_slip(model, effects, tests[i] | moved, path)[:, 0] / SLIP_NOISE

    return hold_slopes(setting["base"], SHARED, read, len(tests), 2, 3)


def hold_out(effects: Mapping, setting: Mapping) -> list[HeldOut]:
    """Three tests at other loads, pressures and speeds, after the campaign's last."""
    path = place_path(setting["length"], 2e-4)[0]
    count = len(setting["loads"]) * len(setting["pressures"]) * len(setting["speeds"])
    found = []
    for chosen in choose_slip_heldout(setting["loads"], setting["pressures"], setting["speeds"]):
        conditions = chosen | {"sequence": count + 1}
        found.append(HeldOut(conditions, path, simulate_slip(setting["base"], effects, conditions, path)))
    return found


SLIP = Bench(
    "slip", {"tangential_force": SLIP_NOISE}, "slip", CATALOGUE, OUTSIDE, draw_setting, make, write_slip_folder,
    lambda campaign: [row["force"][:, None] for row in campaign["records"]], prepare, hold_out,
)  # fmt: skip
