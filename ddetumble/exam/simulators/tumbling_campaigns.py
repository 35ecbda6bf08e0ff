"""Synthetic tumbling campaigns: bodies let go at some rates, what their gyroscopes wrote down, and the folder."""

import numpy as np
from scipy.optimize import least_squares

from .noise import draw_noise
from .packages import SOURCE, describe_number, describe_package, format_cells, write_package
from .tumbling import ATTITUDES, RATES, simulate_tumbling


NOISE = 2e-5  # rad/s, one standard deviation of a rate
ATTITUDE_NOISE = 5e-4  # of a component of the quaternion
ORBIT_RATE = 0.00106  # rad/s
TITLE = "Synthetic tumble campaign with an undisclosed physical effect, or none"
HELDOUT = ([0.05, 0.04, 0.11], [0.1, -0.02, 0.05])  # rad/s, at t = 0


def draw_rates(generator, count):
    """True rates at t = 0 of some records, shape (count, 3) [rad/s]: across 0.03 to 0.09, axial 0.03 to 0.1."""
    across, phase = generator.uniform(0.03, 0.09, count), generator.uniform(0.0, 2.0 * np.pi, count)
    axial = generator.uniform(0.03, 0.1, count) * generator.choice([-1.0, 1.0], count)
    return np.stack([across * np.cos(phase), across * np.sin(phase), axial], axis=1)


def make_tumble_campaign(name, seed, effects, base, records=4, *, duration=600.0, interval=2.0, noise=NOISE, rho=0.0,
                         white_share=0.0, attitude=False, title=TITLE):
    """Return a campaign of `records` bodies let go at random rates and watched for `duration` s, every `interval`.

    Noise is that of `draw_noise`, each channel its own. With `attitude` the quaternion is measured too. All draws come
    from one PCG64 generator seeded with `seed`, in a fixed order.
    """
    generator = np.random.Generator(np.random.PCG64(seed))
    starts = draw_rates(generator, records)
    times = np.round(np.arange(round(duration / interval) + 1) * interval, 9)
    tests = []
    for k, start in enumerate(starts, start=1):
        rates, quaternions = simulate_tumbling(base, effects, start, times, ORBIT_RATE)
        read = rates + np.stack([draw_noise(generator, times.size, noise, rho, white_share) for _ in RATES], axis=1)
        turned = quaternions + ATTITUDE_NOISE * generator.standard_normal(quaternions.shape) if attitude else None
        tests.append({"record": f"r{k:02d}", "start": start, "rates": read, "attitude": turned})
    return {"name": name, "title": title, "seed": seed, "effects": effects, "base": base, "noise": noise, "rho": rho,
            "white_share": white_share, "records": tests, "times": times, "attitude": attitude}


def describe_tumble_campaign(campaign, source=SOURCE):
    """Return the campaign's Data Package descriptor."""
    samples = [describe_number("time", "s")]
    samples += [describe_number(rate, "rad/s", f"{campaign['noise']:g} rad/s") for rate in RATES]
    if campaign["attitude"]:
        samples += [describe_number(one, "1", f"{ATTITUDE_NOISE:g}") for one in ATTITUDES]
    known = {"inertia_ratio": None, "orbit_rate": f"{ORBIT_RATE:g} rad/s"}
    return describe_package(campaign["name"], campaign["title"], "tumble", known, [], samples, source)


def write_tumble_folder(folder, campaign, source=SOURCE):
    """Write the campaign's Data Package; rates to 1e-7 rad/s, attitudes to 1e-6."""
    samples = []
    for row in campaign["records"]:
        for k, time in enumerate(campaign["times"]):
            cells = format_cells(row["rates"][k], 7)
            if campaign["attitude"]:
                cells += format_cells(row["attitude"][k], 6)
            samples.append([row["record"], f"{time:.6g}", *cells])
    records = [[row["record"]] for row in campaign["records"]]
    write_package(folder, describe_tumble_campaign(campaign, source), records, samples)


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


def reveal_tumble_campaign(campaign):
    """Return what is hidden in a campaign, with noise-free rates (rad/s) from initial rates that it does not hold."""
    base, effects, times = campaign["base"], campaign["effects"], campaign["times"]
    starts = np.stack([row["start"] for row in campaign["records"]])
    strength = [round(measure_tumble_misfit(base, {name: values}, starts, times, campaign["noise"]), 2)
                for name, values in effects.items()] or [0.0]  # fmt: skip
    coarse = times[:: max(1, times.size // 300)]
    heldout = []
    for start in HELDOUT:
        rates, _ = simulate_tumbling(base, effects, start, coarse, ORBIT_RATE)
        heldout.append({"conditions": {"w0": list(start)}, "x": [round(float(t), 9) for t in coarse],
                        "y": [[round(float(w), 9) + 0.0 for w in row] for row in rates]})
    same = ("effects", "base", "seed", "rho", "white_share")
    return {"family": "tumble"} | {name: campaign[name] for name in same} | {"strength": strength, "heldout": heldout}
