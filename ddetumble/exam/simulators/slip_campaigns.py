"""Synthetic slip campaigns: a plan of tests, what was really done, what was written down, and the folder."""

from typing import Any

import numpy as np
from scipy.optimize import least_squares

from .noise import draw_noise
from .packages import SOURCE, describe_number, describe_package, format_cells, write_package
from .slip import follow_strokes, measure_rubber_parts, measure_slip_coefficient, simulate_slip


# one standard deviation: relative for the two conditions, N for the force
SLIP_UNCERTAINTIES = {"normal_load": 0.003, "internal_pressure": 0.005}
SLIP_NOISE = 0.04
TITLE = "Synthetic slip campaign with an undisclosed physical effect, or none"
KNOWN = {"tensile_strength": "10 MPa", "real_contact_pressure": "20 MPa", "elastic_modulus": "7.8 MPa"}
KNOWN |= {"poisson_ratio": 0.47, "adhesion_constant": None, "loss_factor": None, "slip_scale": None}


def choose_slip_heldout(loads, pressures, speeds):
    """Return three conditions at none of the campaign's own.

    Loads are geometric means of the two lowest and the two highest, pressures that of lowest and highest and the
    mean of it and the highest; speeds the geometric mean of the two lowest and 0.9 times the highest.
    """
    f, p, v = sorted(loads), sorted(pressures), sorted(speeds)
    light, heavy = (f[0] * f[min(1, len(f) - 1)]) ** 0.5, (f[max(-2, -len(f))] * f[-1]) ** 0.5
    middle = (p[0] * p[-1]) ** 0.5
    slow, fast = (v[0] * v[min(1, len(v) - 1)]) ** 0.5, 0.9 * v[-1]
    triples = ((light, middle, fast), (heavy, 0.5 * (middle + p[-1]), slow), (heavy, middle, fast))
    names = ("normal_load", "internal_pressure", "slip_speed")
    return [dict(zip(names, (float(f"{x:.6g}") for x in triple), strict=True)) for triple in triples]


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


def order_slip_tests(generator, loads, pressures, speeds, repeats=1):
    """Return the nominal conditions of every test in the random order in which they are done."""
    plan = [(f, p, v) for f in loads for p in pressures for v in speeds] * repeats
    names = ("normal_load", "internal_pressure", "slip_speed", "sequence")
    order = generator.permutation(len(plan))
    return [dict(zip(names, (*plan[k], j), strict=True)) for j, k in enumerate(order, start=1)]


def make_slip_campaign(
    name, seed, effects, base, loads, pressures, speeds, repeats=1, *, length=12e-3, interval=1e-4, noise=SLIP_NOISE,
    rho=0.0, white_share=0.0, setting_scatter=0.0, uncertainties=None, strokes=None, numbered=False, title=TITLE,
):  # fmt: skip
    """Return a campaign: every load (N) with every pressure (Pa) and slip speed (m/s), in random order.

    A test's true load and pressure are nominal x (1 + setting_scatter x N(0, 1)); what is written down is the true
    one x (1 + uncertainty x N(0, 1)); the speed is exact. Samples are `interval` (m) apart on one stroke of `length`
    (m), over slip, or with `strokes` (lengths in m, back and forth) over time, slip being a channel without noise;
    the force is left empty at a reversal, where it jumps. Force noise (N) is AR(1) with coefficient rho, of which
    `white_share` of the variance is white instead. `numbered` writes the place in the series, which x-wear needs.
    All draws come from one PCG64 generator seeded with `seed`, in a fixed order.
    """
    stated = SLIP_UNCERTAINTIES | (uncertainties or {})
    generator = np.random.Generator(np.random.PCG64(seed))
    tests = order_slip_tests(generator, loads, pressures, speeds, repeats)
    path, turns = place_path(length, interval, strokes)
    records = []
    for sequence, true in enumerate(tests, start=1):
        written, draw = dict(true), generator.standard_normal(4)
        for i, condition in enumerate(("normal_load", "internal_pressure")):
            true[condition] *= 1.0 + setting_scatter * draw[i]
            written[condition] = true[condition] * (1.0 + stated[condition] * draw[2 + i])
        force = simulate_slip(base, effects, true, path, strokes)[:, 0]
        force = np.where(turns, np.nan, force + draw_noise(generator, path.size, noise, rho, white_share))
        records.append({"record": f"r{sequence:02d}", "true": true, "written": written, "force": force})
    last = {"sequence": len(tests) + 1} if numbered else {}  # held-out tests come after the series
    return {
        "name": name, "title": title, "seed": seed, "effects": effects, "base": base, "uncertainties": stated,
        "noise": noise, "rho": rho, "white_share": white_share, "setting_scatter": setting_scatter,
        "records": records, "path": path, "turns": turns, "strokes": strokes, "numbered": numbered,
        "heldout": [c | last for c in choose_slip_heldout(loads, pressures, speeds)],
    }  # fmt: skip


def describe_slip_campaign(campaign, source=SOURCE):
    """Return the campaign's Data Package descriptor."""
    relative = {name: f"{100 * value:g} %" for name, value in campaign["uncertainties"].items()}
    records = [
        describe_number("normal_load", "N", relative["normal_load"]),
        describe_number("internal_pressure", "MPa", relative["internal_pressure"]),
        describe_number("slip_speed", "m/s"),
    ]
    if campaign["numbered"]:
        records.insert(0, {"name": "sequence", "type": "integer"})
    samples = [
        describe_number("slip", "mm"),
        describe_number("tangential_force", "N", f"{campaign['noise']:g} N"),
    ]
    if campaign["strokes"] is not None:
        samples.insert(0, describe_number("time", "s"))
    return describe_package(campaign["name"], campaign["title"], "slip", KNOWN, records, samples, source)


def write_slip_folder(folder, campaign, source=SOURCE):
    """Write the campaign's Data Package; values are rounded as the columns' format says."""
    _, slip, _, _ = follow_strokes(campaign["path"], campaign["strokes"])
    tests, samples = [], []
    for row in campaign["records"]:
        written = row["written"]
        number = [written["sequence"]] if campaign["numbered"] else []
        load, pressure, speed = written["normal_load"], written["internal_pressure"] / 1e6, written["slip_speed"]
        tests.append([row["record"], *number, f"{load:.4f}", f"{pressure:.5f}", f"{speed:.4f}"])
        readings = format_cells(row["force"], 3)
        for distance, at, reading in zip(campaign["path"], slip, readings, strict=True):
            clock = [] if campaign["strokes"] is None else [f"{distance / speed:.6g}"]
            samples.append([row["record"], *clock, f"{np.round(1e3 * at, 6) + 0.0:g}", reading])
    write_package(folder, describe_slip_campaign(campaign, source), tests, samples)


def measure_slip_misfit(base, effects, conditions, path, noise, uncertainties, strokes=None, turns=None):
    """Return the rms over noise that the reference model leaves on noise-free records after a refit.

    Least squares over K tan delta, tan delta and slip_scale (shared) and each record's relative load and pressure
    errors, which carry their stated uncertainty as a prior. path: m, of every record; noise: N; reversals (`turns`)
    do not count. Uncertainties of zero hold the conditions where they are.
    """
    kept = slice(None) if turns is None else ~np.asarray(turns)
    truth = np.array([simulate_slip(base, effects, c, path, strokes)[kept, 0] for c in conditions])
    _, _, since, direction = (values[kept] for values in follow_strokes(path, strokes))
    load, pressure = (np.array([c[name] for c in conditions]) for name in ("normal_load", "internal_pressure"))
    count = len(conditions)

    def leave(unknown):
        own = unknown[3:].reshape(2, count)
        here = load * (1.0 + uncertainties["normal_load"] * own[0])
        gas = pressure * (1.0 + uncertainties["internal_pressure"] * own[1])
        adhesive, hysteretic = measure_rubber_parts(base, gas)
        friction = (unknown[0] * adhesive + unknown[1] * hysteretic)[:, None]
        friction = friction + unknown[2] * measure_slip_coefficient(since, here[:, None])
        return (truth - direction * friction * here[:, None]) / noise

    def differ(unknown):
        """Finite differences: a record's own two unknowns move only its own samples."""
        now, step = leave(unknown), 1e-4
        slopes = np.zeros((*now.shape, unknown.size))
        for i in range(3):
            slopes[:, :, i] = (leave(unknown + step * (np.arange(unknown.size) == i)) - now) / step
        for i in range(2):
            mine = np.arange(3 + i * count, 3 + (i + 1) * count)
            change = (leave(unknown + step * np.isin(np.arange(unknown.size), mine)) - now) / step
            slopes[np.arange(count), :, mine] = change
        return np.vstack([slopes.reshape(-1, unknown.size), np.eye(unknown.size)[3:]])

    start = np.zeros(3 + 2 * count)
    start[:3] = base["loss_factor"] * base["adhesion_constant"], base["loss_factor"], base.get("slip_scale", 1.0)
    slopes: Any = differ
    found = least_squares(
        lambda u: np.concatenate([leave(u).ravel(), u[3:]]), start, slopes, x_scale="jac", xtol=1e-8, ftol=1e-10
    )  # fmt: skip
    return float(np.sqrt(np.mean(leave(found.x) ** 2)))


def reveal_slip_campaign(campaign):
    """Return what is hidden in a campaign, with noise-free force (N) at conditions that it does not hold.

    x is slip (m); with strokes time (s), beside which `slip` (m) stands, and y holds null at a reversal.
    """
    conditions = [row["true"] for row in campaign["records"]]
    path, turns, strokes = campaign["path"], campaign["turns"], campaign["strokes"]
    arguments = (conditions, path, campaign["noise"], campaign["uncertainties"], strokes, turns)
    strength = [
        round(measure_slip_misfit(campaign["base"], {name: values}, *arguments), 2)
        for name, values in campaign["effects"].items()
    ] or [0.0]
    heldout = []
    for chosen in campaign["heldout"]:
        force = simulate_slip(campaign["base"], campaign["effects"], chosen, path, strokes)[:, 0]
        y = [[None if turn else round(float(f), 6) + 0.0] for turn, f in zip(turns, force, strict=True)]
        x = {"x": [round(float(s), 9) for s in path]}
        if strokes is not None:
            slip = follow_strokes(path, strokes)[1]
            x = {"x": [round(float(s / chosen["slip_speed"]), 9) for s in path]}
            x["slip"] = [round(float(s), 9) + 0.0 for s in slip]
        heldout.append({"conditions": chosen} | x | {"y": y})
    same = ("effects", "base", "seed", "rho", "white_share", "setting_scatter")
    revealed = {"family": "slip"} | {name: campaign[name] for name in same}
    if strokes is not None:
        revealed["strokes"] = list(strokes)
    return revealed | {"strength": strength, "heldout": heldout}
