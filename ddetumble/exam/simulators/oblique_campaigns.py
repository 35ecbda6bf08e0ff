"""Synthetic campaigns of oblique impacts: a plan of tests, what was really done, what was written down, the folder."""

import numpy as np

from .impact_campaigns import TITLE
from .noise import draw_noise
from .oblique import CREEP, ROLLING, simulate_strike
from .packages import SOURCE, describe_number, describe_package, format_cells, write_package
from .strength import place_times


# one standard deviation: relative for the conditions, s for the time origin, N and m for the channels
UNCERTAINTIES = {"initial_pressure": 0.005, "approach_speed": 0.003, "tangential_speed": 0.003, "time": 5e-5}
NOISE = {"normal_force": 0.25, "tangential_force": 0.08, "slip": 2e-5}
UNITS = {"normal_force": ("N", 1.0), "tangential_force": ("N", 1.0), "slip": ("mm", 1e-3)}
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
    title=TITLE,
):  # fmt: skip
    """Return a campaign: every pressure (Pa) with every approach and tangential speed (m/s), in random order.

    As `impact_campaigns.make_campaign`: a test's true condition is nominal x (1 + setting_scatter x N(0, 1)), what is
    written down is the true one x (1 + uncertainty x N(0, 1)), written times lag the true ones by a shift, noise is
    AR(1) with coefficient rho, of which `white_share` of the variance is white instead; steps: see
    `oblique.integrate_strike`. All draws come from one PCG64 generator seeded with `seed`, in a fixed order.
    """
    deviations = NOISE | (noise or {})
    generator = np.random.Generator(np.random.PCG64(seed))
    plan = [(p, v, u) for p in pressures for v in speeds for u in slides] * repeats
    records = []
    for number, k in enumerate(generator.permutation(len(plan)), start=1):
        nominal = dict(zip(CONDITIONS, plan[k], strict=True))
        draw = generator.standard_normal(7)
        true = {c: x * (1.0 + setting_scatter * draw[i]) for i, (c, x) in enumerate(nominal.items())}
        written = {c: x * (1.0 + UNCERTAINTIES[c] * draw[3 + i]) for i, (c, x) in enumerate(true.items())}
        shift = UNCERTAINTIES["time"] * draw[6]
        times = place_times(base, nominal, interval, before, length)
        values = simulate_strike(base, effects, true, times - shift, channels, steps)
        for j, channel in enumerate(channels):
            values[:, j] += draw_noise(generator, times.size, deviations[channel], rho, white_share)
        records.append({"record": f"r{number:02d}", "true": true, "written": written, "times": times,
                        "values": values})  # fmt: skip
    return {
        "name": name, "title": title, "seed": seed, "effects": effects, "base": base, "channels": tuple(channels),
        "noise": {c: deviations[c] for c in channels}, "rho": rho, "setting_scatter": setting_scatter,
        "records": records, "interval": interval, "before": before, "length": length,
        "heldout": choose_oblique_heldout(pressures, speeds, slides),
    }  # fmt: skip


def describe_oblique_campaign(campaign, source=SOURCE):
    """Return the campaign's Data Package descriptor."""
    base, channels = campaign["base"], []
    for channel in campaign["channels"]:
        unit, size = UNITS[channel]
        channels.append(describe_number(channel, unit, f"{campaign['noise'][channel] / size:g} {unit}"))
    records = [describe_number(name, unit, f"{100 * UNCERTAINTIES[name]:g} %")
               for name, unit in zip(CONDITIONS, ("MPa", "m/s", "m/s"), strict=True)]  # fmt: skip
    time = describe_number("time", "s", f"{UNCERTAINTIES['time'] * 1e3:g} ms")
    known = {"outer_diameter": "60 mm", "effective_mass": None, "restitution": None, "tangential_mass": None,
             "rolling_mass": f"{base.get('rolling_mass', ROLLING):g} kg",
             "creep_speed": f"{base.get('creep_speed', CREEP):g} m/s", "adhesion_constant": None,
             "loss_factor": base["loss_factor"]}  # fmt: skip
    return describe_package(campaign["name"], campaign["title"], "impact", known, records, [time, *channels], source)


def write_oblique_folder(folder, campaign, source=SOURCE):
    """Write the campaign's Data Package; values are rounded as the columns' format says."""
    tests, samples = [], []
    sizes = np.array([UNITS[channel][1] for channel in campaign["channels"]])
    for row in campaign["records"]:
        pressure, speed, slide = (row["written"][name] for name in CONDITIONS)
        tests.append([row["record"], f"{pressure / 1e6:.5f}", f"{speed:.5f}", f"{slide:.5f}"])
        for time, values in zip(row["times"], row["values"] / sizes, strict=True):
            samples.append([row["record"], f"{time + 0.0:g}", *format_cells(values, 3)])
    write_package(folder, describe_oblique_campaign(campaign, source), tests, samples)


def reveal_oblique_campaign(campaign):
    """Return what is hidden in a campaign, with noise-free channels at conditions that it does not hold."""
    heldout = []
    for conditions in campaign["heldout"]:
        times = place_times(campaign["base"], conditions, campaign["interval"], campaign["before"], campaign["length"])
        values = simulate_strike(campaign["base"], campaign["effects"], conditions, times, campaign["channels"])
        heldout.append({"conditions": conditions, "x": [round(float(t), 9) + 0.0 for t in times],
                        "y": [[round(float(x), 6) + 0.0 for x in row] for row in values]})  # fmt: skip
    same = ("effects", "base", "seed", "rho", "setting_scatter")
    return {"family": "impact"} | {name: campaign[name] for name in same} | {"heldout": heldout}
