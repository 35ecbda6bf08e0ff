"""Synthetic impact campaigns: a plan of tests, what was really done, what was written down, and the folder."""

import numpy as np

from .impact import simulate
from .noise import draw_noise
from .packages import SOURCE, describe_number, describe_package, format_cells, write_package
from .strength import measure_misfit, place_times


# one standard deviation: relative for the two conditions, s for the time origin, SI for the channels
UNCERTAINTIES = {"initial_pressure": 0.005, "approach_speed": 0.003, "time": 5e-5}
NOISE = {"normal_force": 0.25, "depression": 2e-5, "pressure": 2e3}
# channel or condition -> unit in files, SI value of that unit
UNITS = {"normal_force": ("N", 1.0), "tangential_force": ("N", 1.0), "depression": ("mm", 1e-3), "slip": ("mm", 1e-3),
         "pressure": ("MPa", 1e6), "initial_pressure": ("MPa", 1e6), "approach_speed": ("m/s", 1.0),
         "tangential_speed": ("m/s", 1.0)}  # fmt: skip
TITLE = "Synthetic impact campaign with an undisclosed physical effect, or none"


def choose_heldout(pressures, speeds, sequence):
    """Return three conditions at none of the campaign's own, one impact after its last.

    Pressures are geometric means of the two lowest and the two highest; speeds the geometric mean of the two
    lowest and 0.9 times the highest.
    """
    p, v = sorted(pressures), sorted(speeds)
    low, high = (p[0] * p[min(1, len(p) - 1)]) ** 0.5, (p[-min(2, len(p))] * p[-1]) ** 0.5
    slow, fast = (v[0] * v[min(1, len(v) - 1)]) ** 0.5, 0.9 * v[-1]
    pairs = ((low, fast), (high, slow), (high, fast))
    names = ("initial_pressure", "approach_speed", "sequence")
    return [dict(zip(names, (float(f"{a:.6g}"), float(f"{b:.6g}"), sequence), strict=True)) for a, b in pairs]


def order_tests(generator, pressures, speeds, repeats):
    """Return the nominal conditions of every test in the random order in which they are done."""
    plan = [(p, v) for p in pressures for v in speeds] * repeats
    names = ("initial_pressure", "approach_speed", "sequence")
    order = generator.permutation(len(plan))
    return [dict(zip(names, (*plan[k], j), strict=True)) for j, k in enumerate(order, start=1)]


def make_campaign(
    name, seed, effects, base, pressures, speeds, repeats=2, *, channels=("normal_force",), interval=2.5e-4,
    before=2e-3, length=1.45, uncertainties=None, setting_scatter=0.0, noise=None, rho=0.0, white_share=0.0,
    title=TITLE,
):  # fmt: skip
    """Return a campaign: every pressure (Pa) with every speed (m/s), `repeats` times, in random order.

    A test's true condition is nominal x (1 + setting_scatter x N(0, 1)); what is written down is the true one
    x (1 + uncertainty x N(0, 1)). Written times run from -before to `length` guessed contact times every
    `interval` (s) and lag the true ones by a shift drawn with the uncertainty of `time`. Noise of each channel is
    AR(1) with coefficient rho, of which `white_share` of the variance is white instead. All draws come from one
    PCG64 generator seeded with `seed`, in a fixed order.
    """
    deviations = NOISE | (noise or {})
    generator = np.random.Generator(np.random.PCG64(seed))
    tests = order_tests(generator, pressures, speeds, repeats)
    campaign = {
        "name": name, "title": title, "seed": seed, "effects": effects, "base": base, "channels": tuple(channels),
        "uncertainties": UNCERTAINTIES | (uncertainties or {}), "noise": {c: deviations[c] for c in channels},
        "rho": rho, "white_share": white_share, "setting_scatter": setting_scatter, "interval": interval,
        "before": before, "length": length, "heldout": choose_heldout(pressures, speeds, len(tests) + 1),
        "known": {"outer_diameter": "60 mm", "effective_mass": None, "restitution": None},
        "digits": 3 if tuple(channels) == ("normal_force",) else 5,
    }  # fmt: skip
    return add_records(campaign, generator, tests, lambda true, times: simulate(base, effects, true, times, channels))


def add_records(campaign, generator, tests, read):
    """Return the campaign with what was really done in the tests, what was written down and what was measured.

    tests: nominal conditions; those with a stated uncertainty are set and written down inexactly. read: channels,
    shape (samples, channels), from true conditions and times (s).
    """
    stated, records, samples = campaign["uncertainties"], [], []
    for number, nominal in enumerate(tests, start=1):
        names = [condition for condition in nominal if condition in stated]
        draw = generator.standard_normal(2 * len(names) + 1)
        true, written = dict(nominal), dict(nominal)
        for i, condition in enumerate(names):
            true[condition] = nominal[condition] * (1.0 + campaign["setting_scatter"] * draw[i])
            written[condition] = true[condition] * (1.0 + stated[condition] * draw[len(names) + i])
        shift = stated["time"] * draw[-1]
        times = place_times(campaign["base"], nominal, campaign["interval"], campaign["before"], campaign["length"])
        values = read(true, times - shift)
        for j, deviation in enumerate(campaign["noise"].values()):
            values[:, j] += draw_noise(generator, times.size, deviation, campaign["rho"], campaign["white_share"])
        label = f"r{number:02d}"
        records.append({"record": label, "true": true, "written": written, "time_shift": shift})
        samples.append({"record": label, "times": times, "values": values})
    return campaign | {"records": records, "samples": samples}


def describe_campaign(campaign, source=SOURCE):
    """Return the descriptor of the Data Package of a campaign of straight or oblique impacts."""
    stated, channels = campaign["uncertainties"], []
    for channel in campaign["channels"]:
        unit, size = UNITS[channel]
        channels.append(describe_number(channel, unit, f"{campaign['noise'][channel] / size:g} {unit}"))
    records = [describe_number(name, UNITS[name][0], f"{100 * stated[name]:g} %") if name in stated
               else {"name": name, "type": "integer"} for name in list_columns(campaign)]  # fmt: skip
    time = describe_number("time", "s", f"{stated['time'] * 1e3:g} ms")
    return describe_package(campaign["name"], campaign["title"], "impact", campaign["known"], records,
                            [time, *channels], source)  # fmt: skip


def list_columns(campaign):
    """Return the conditions in the order of the table's columns, the place in the series first."""
    return sorted(campaign["records"][0]["written"], key=lambda name: name != "sequence")


def write_campaign_folder(folder, campaign, source=SOURCE):
    """Write the campaign's Data Package; values are rounded as the columns' format says."""
    records, samples = [], []
    sizes = np.array([UNITS[channel][1] for channel in campaign["channels"]])
    for row in campaign["records"]:
        written = row["written"]
        cells = [f"{written[name] / UNITS[name][1]:.5f}" if name in UNITS else written[name]
                 for name in list_columns(campaign)]  # fmt: skip
        records.append([row["record"], *cells])
    for trace in campaign["samples"]:
        for time, values in zip(trace["times"], trace["values"] / sizes, strict=True):
            samples.append([trace["record"], f"{time + 0.0:g}", *format_cells(values, campaign["digits"])])
    write_package(folder, describe_campaign(campaign, source), records, samples)


def measure_strength(campaign):
    """Return for each effect, on its own, the rms over noise that a refitted reference model leaves."""
    conditions = [row["true"] for row in campaign["records"]]
    deviations = list(campaign["noise"].values())
    arguments = (conditions, deviations, campaign["uncertainties"], campaign["channels"], 4)
    return [
        round(measure_misfit(campaign["base"], {name: values}, *arguments), 2)
        for name, values in campaign["effects"].items()
    ] or [0.0]


def reveal_heldout(campaign, read):
    """Return noise-free readings at the conditions held out; read: as of `add_records`."""
    heldout = []
    for conditions in campaign["heldout"]:
        times = place_times(campaign["base"], conditions, campaign["interval"], campaign["before"], campaign["length"])
        heldout.append({"conditions": conditions, "x": [round(float(t), 9) + 0.0 for t in times],
                        "y": [[round(float(x), 6) + 0.0 for x in row] for row in read(conditions, times)]})
    return heldout


def reveal_campaign(campaign):
    """Return what is hidden in a campaign, with noise-free force (N) at conditions that it does not hold."""
    base, effects = campaign["base"], campaign["effects"]
    same = ("effects", "base", "seed", "rho", "white_share", "setting_scatter")
    return {"family": "impact"} | {name: campaign[name] for name in same} | {
        "strength": measure_strength(campaign),
        "heldout": reveal_heldout(campaign, lambda conditions, times: simulate(base, effects, conditions, times)),
    }  # fmt: skip
