"""Campaigns of friction: rubber slides under constant load, pressure and speed; the friction force is read."""

import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np

from .campaigns import Campaign, draw_records, name_conditions, order_tests, place_between
from .generator import CaseGenerator, HeldOut, Hidden, leave_out, spread
from .slip import follow_strokes, simulate_slip
from .strength import hold_slopes, refer_tests, share_logarithms


CONDITIONS = ("normal_load", "internal_pressure", "slip_speed")
# one standard deviation: relative for the two conditions, N for the force
SLIP_UNCERTAINTIES = {"normal_load": 0.003, "internal_pressure": 0.005}
SLIP_NOISE = 0.04
KNOWN = {"tensile_strength": "10 MPa", "real_contact_pressure": "20 MPa", "elastic_modulus": "7.8 MPa"}
KNOWN |= {"poisson_ratio": 0.47, "adhesion_constant": None, "loss_factor": None, "slip_scale": None}
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


def choose_slip_heldout(loads, pressures, speeds, **more):
    """Return three conditions at none of the campaign's own; `more` are added to each."""
    light, heavy, _ = place_between(loads)
    slow, _, fast = place_between(speeds)
    p = sorted(pressures)
    middle = (p[0] * p[-1]) ** 0.5
    triples = ((light, middle, fast), (heavy, 0.5 * (middle + p[-1]), slow), (heavy, middle, fast))
    return name_conditions(CONDITIONS, triples, **more)


def place_path(length, interval, strokes=None):
    """Return the sampled distances (m) rubbed since the start, and which of them are reversals.

    `length` is that of a single stroke; `strokes` replaces it. Every stroke is a whole number of intervals long.
    """
    lengths = np.array([length] if strokes is None else strokes, dtype=float)
    counts = np.round(lengths / interval).astype(int)
    if counts.min() < 1 or np.abs(counts * interval - lengths).max() > 1e-9:
        raise ValueError(f"strokes {lengths} m are no whole number of intervals of {interval} m")
    turns = np.zeros(counts.sum() + 1, dtype=bool)
    turns[np.cumsum(counts)[:-1]] = True
    return np.round(np.arange(turns.size) * interval, 12), turns


def make_slip_campaign(
    name, seed, effects, base, loads, pressures, speeds, repeats=1, *, length=12e-3, interval=1e-4, noise=SLIP_NOISE,
    rho=0.0, white_share=0.0, setting_scatter=0.0, uncertainties=None, strokes=None, numbered=False,
):  # fmt: skip
    """Return a campaign: every load (N) with every pressure (Pa) and slip speed (m/s), in random order.

    The speed is exact. Samples are `interval` (m) apart on one stroke of `length` (m), over slip, or with `strokes`
    (lengths in m, back and forth) over time, slip being a channel without noise; the force is left empty at a
    reversal, where it jumps. Force noise (N) is AR(1) with coefficient rho, of which `white_share` of the variance is
    white instead. `numbered` writes the place in the series, which x-wear needs. All draws come from one PCG64
    generator seeded with `seed`, in a fixed order: see `draw_records`.
    """
    generator = np.random.Generator(np.random.PCG64(seed))
    tests = order_tests(generator, CONDITIONS, (loads, pressures, speeds), repeats)
    path, turns = place_path(length, interval, strokes)
    slip = follow_strokes(path, strokes)[1]

    def place(conditions):
        clock = {} if strokes is None else {"time": path / conditions["slip_speed"]}
        return path, {**clock, "slip": slip}

    def read(true, places):
        return np.where(turns[:, None], np.nan, simulate_slip(base, effects, true, places, strokes))

    campaign = Campaign(
        name, "slip", seed, effects, base, KNOWN, ("sequence", *CONDITIONS) if numbered else CONDITIONS,
        SLIP_UNCERTAINTIES | (uncertainties or {}), {"tangential_force": noise}, [3], place, read, rho, white_share,
        setting_scatter,
    )  # fmt: skip
    return draw_records(campaign, generator, tests)


def refer_slip(base, tests, path, noise, uncertainties, strokes=None, turns=None):
    """Return the `Reference` of tests at these conditions, which shares K, tan delta and slip_scale.

    path: m, of every record; noise: N; reversals (`turns`) do not count.
    """
    kept = slice(None) if turns is None else ~np.asarray(turns)
    return refer_tests(
        base, share_logarithms(base, SHARED), tests, [path] * len(tests), {c: uncertainties[c] for c in CONDITIONS[:2]},
        lambda model, effects, moved, places: simulate_slip(model, effects, moved, places, strokes)[kept, 0] / noise)


def prepare(setting: Mapping, seed: int) -> Callable[[Mapping], float]:
    """The function effects -> misfit over noise."""
    generator = np.random.Generator(np.random.PCG64(seed))
    tests = order_tests(generator, CONDITIONS, (setting["loads"], setting["pressures"], setting["speeds"]))
    path = place_path(setting["length"], setting["interval"])[0][::2]
    return hold_slopes(refer_slip(setting["base"], tests, path, SLIP_NOISE, SLIP_UNCERTAINTIES), 3)


def hold_out(effects: Mapping, setting: Mapping) -> list[HeldOut]:
    """Three tests at other loads, pressures and speeds, after the campaign's last."""
    path = place_path(setting["length"], 2e-4)[0]
    plan = (setting["loads"], setting["pressures"], setting["speeds"])
    return [HeldOut(conditions, path, simulate_slip(setting["base"], effects, conditions, path))
            for conditions in choose_slip_heldout(*plan, sequence=math.prod(map(len, plan)) + 1)]  # fmt: skip


SLIP = CaseGenerator(
    "slip", {"tangential_force": SLIP_NOISE}, "slip", CATALOGUE, OUTSIDE, draw_setting,
    partial(make_slip_campaign, numbered=True), prepare, hold_out,
    # Sliding is slow beside a gauge that rings or a clock that jitters, and slip has no trigger. The rubber's own
    # parameters take up a gauge of friction, or of pressure, that reads too high; nothing says the same of the load's.
    leave_out("ringing", "jitter", "time-stamps"),
)  # fmt: skip
