"""Campaigns of tumbling: bodies let go at random rates; their gyroscopes are read."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from .campaigns import Campaign, draw_records
from .generator import CaseGenerator, HeldOut, Hidden, leave_out
from .tumbling import ATTITUDES, RATES, simulate_tumbling


NOISE = 2e-5  # rad/s, one standard deviation of a rate
ATTITUDE_NOISE = 5e-4  # of a component of the quaternion
ORBIT_RATE = 0.00106  # rad/s
TOLERANCE = 1e-8  # of the integrator, 1e-3 of the noise at most: for strengths only
HELDOUT = ([0.05, 0.04, 0.11], [0.1, -0.02, 0.05])  # rad/s, at t = 0
CATALOGUE = {
    "eddy-current": Hidden({"k_e": 1.0e-6}, most=100.0),
    "constant-torque": Hidden(vectors={"torque": 2.3e-7}, most=100.0),
    "inertia-asymmetry": Hidden({"epsilon": 1.0e-3}, most=50.0),
    "axis-misalignment": Hidden({"angle": 1.0e-3}, most=50.0),
    "internal-damper": Hidden({"c": 8.0e-6}, shapes={"I_d": (0.015, 0.06)}, most=50.0),
    "gravity-gradient": Hidden({"scale": 1.0}, most=10.0),
    "gyro-bias": Hidden(vectors={"bias": 8.8e-5}, most=50.0),
    "gyro-scale": Hidden({"g": 0.002}, most=50.0),
}
OUTSIDE = {
    "x-quadratic-drag": Hidden({"k": 1.0e-5}, most=100.0),
    "x-sine-torque": Hidden(vectors={"torque": 3.7e-7}, shapes={"period": (25.0, 90.0)}, most=100.0),
    "x-growing-torque": Hidden(vectors={"slope": 5.0e-10}, most=100.0),
    "x-thruster": Hidden(vectors={"torque": 2.7e-7}, shapes={"period": (80.0, 200.0)}, most=100.0),
    "x-solar-torque": Hidden(vectors={"torque": 5.4e-8}, most=100.0),
    "x-bias-walk": Hidden(vectors={"slope": 3.0e-7}, most=100.0),
    "x-flexible-panel": Hidden({"ratio": 0.002}, shapes={"omega": (0.25, 0.5), "zeta": (0.005, 0.02)}, most=100.0),
}


def draw_setting(generator: np.random.Generator) -> dict[str, Any]:
    """A body, and three to six records of at most 320 samples; one campaign in four has the attitude too."""
    duration = float(generator.choice([400.0, 600.0]))
    return {
        "base": {"inertia_ratio": float(generator.uniform(0.35, 0.8))}, "records": int(generator.choice([3, 4, 6])),
        "duration": duration, "interval": duration / float(generator.choice([200, 300])),
        "attitude": bool(generator.random() < 0.25),
    }  # fmt: skip


def draw_rates(generator, count):
    """True rates at t = 0 of some records, shape (count, 3) [rad/s]: across 0.03 to 0.09, axial 0.03 to 0.1."""
    across, phase = generator.uniform(0.03, 0.09, count), generator.uniform(0.0, 2.0 * np.pi, count)
    axial = generator.uniform(0.03, 0.1, count) * generator.choice([-1.0, 1.0], count)
    return np.stack([across * np.cos(phase), across * np.sin(phase), axial], axis=1)


def make_tumble_campaign(name, seed, effects, base, records=4, *, duration=600.0, interval=2.0, noise=NOISE, rho=0.0,
                         white_share=0.0, attitude=False):
    """Return a campaign of `records` bodies let go at random rates and watched for `duration` s, every `interval`.

    Noise is that of `draw_noise`, each channel its own. With `attitude` the quaternion is measured too. All draws come
    from one PCG64 generator seeded with `seed`, in a fixed order.
    """
    generator = np.random.Generator(np.random.PCG64(seed))
    times = np.round(np.arange(round(duration / interval) + 1) * interval, 9)
    campaign = describe_tumbling(name, seed, effects, base, times, noise=noise, rho=rho, white_share=white_share,
                                 attitude=attitude)
    return draw_records(campaign, generator, [{"w0": start} for start in draw_rates(generator, records)])


def describe_tumbling(name, seed, effects, base, times, *, noise=NOISE, rho=0.0, white_share=0.0, attitude=False,
                      orbit_rate=ORBIT_RATE):
    """Return a campaign without records, of bodies that are read at the times (s); a test's condition is `w0`."""
    white: dict[str, float] = dict.fromkeys(ATTITUDES, ATTITUDE_NOISE) if attitude else {}
    known = {"inertia_ratio": None, "orbit_rate": f"{ORBIT_RATE:g} rad/s"}

    def read(true, places):
        rates, quaternions = simulate_tumbling(base, effects, true["w0"], places, orbit_rate)
        return np.hstack([rates, quaternions]) if attitude else rates

    return Campaign(name, "tumble", seed, effects, base, known, (), {}, dict.fromkeys(RATES, noise),
                    (*[7] * len(RATES), *[6] * len(white)), lambda _: (times, {"time": times}), read, rho, white_share,
                    white=white)  # fmt: skip


def roll_freely(ratio, start, times):
    """Rates of a body of revolution without torque, in closed form, shape (samples, 3) [rad/s]."""
    across = (start[0] + 1j * start[1]) * np.exp(-1j * (1.0 - ratio) * start[2] * times)
    return np.stack([across.real, across.imag, np.full(times.size, start[2])], axis=1)


def measure_tumble_misfit(base, effects, starts, times, noise=NOISE, tolerance=1e-11):
    """Return the rms over noise that the reference model leaves on noise-free rates after a refit.

    Least squares over inertia_ratio (shared) and each record's rates at t = 0. tolerance: of the integrator, relative.
    """
    truth = np.stack([simulate_tumbling(base, effects, start, times, ORBIT_RATE, tolerance)[0] for start in starts])

    def leave(unknown):
        model = [roll_freely(unknown[0], own, times) for own in unknown[1:].reshape(-1, 3)]
        return ((np.stack(model) - truth) / noise).ravel()

    first = np.concatenate([[base["inertia_ratio"]], np.ravel(starts)])
    found = least_squares(leave, first, x_scale="jac", xtol=1e-12, ftol=1e-10)
    return float(np.sqrt(np.mean(found.fun**2)))


def prepare(setting: Mapping, seed: int) -> Callable[[Mapping], float]:
    """The function effects -> misfit of the rates over noise."""
    starts = draw_rates(np.random.Generator(np.random.PCG64(seed)), setting["records"])
    times = np.linspace(0.0, setting["duration"], 101)
    return lambda effects: measure_tumble_misfit(setting["base"], effects, starts, times, tolerance=TOLERANCE)


def hold_out(effects: Mapping, setting: Mapping) -> list[HeldOut]:
    """Two records from other rates."""
    times = np.linspace(0.0, setting["duration"], 201)
    found = []
    for start in HELDOUT:
        rates, _ = simulate_tumbling(setting["base"], effects, start, times, ORBIT_RATE)
        conditions = {f"{rate}0": value for rate, value in zip(RATES, start, strict=True)}
        found.append(HeldOut(conditions, times, rates))
    return found


TUMBLE = CaseGenerator(
    "tumble", dict.fromkeys(RATES, NOISE), "time", CATALOGUE, OUTSIDE, draw_setting, make_tumble_campaign, prepare,
    hold_out,
    # Nothing is set, and rates that are all too high by a factor are those of another inertia ratio.
    leave_out("ringing", "loose-settings", "jitter", "biased-setting", "biased-gauge"),
)  # fmt: skip
