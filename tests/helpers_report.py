"""A fabricated discovery for the tests of figures and reports: real records, models by the independent simulator.

Nothing is fitted here: the reference model's parameters are those that a fit gave once, and p-values, shares and
intervals are made up. What matters is that the shapes are those of real findings.
"""

import csv
import dataclasses as dc
import functools
import itertools
import json
import math
from pathlib import Path

import numpy as np

from ddetumble.exam.simulators.impact import simulate
from ddetumble.exam.simulators.slip import follow_strokes, simulate_slip
from ddetumble.selection.discovery import Discovery
from ddetumble.selection.result import Candidate, Estimate, LackOfFit, Place, Step, Trace
from ddetumble.selection.settings import SelectionSettings


DATA = Path(__file__).resolve().parent.parent / "data"
CATALOGUE = (
    "polytropic-gas", "ambient-pressure", "wall-stiffness", "membrane-area", "inflation-growth", "gas-leak",
    "viscoelastic-wall", "viscous-dashpot", "adhesion", "arm-servo", "speed-dependent-restitution",
    "pressure-dependent-restitution", "stress-softening", "sensor-hysteresis", "sensor-highpass", "sensor-lag",
    "sensor-filter", "sensor-gain", "sensor-resonance",
)  # fmt: skip
CAMPAIGNS = {
    "nothing-missing": "impact-i", "explained": "impact-b", "improved": "impact-h", "unexplained": "impact-f",
    "undecided": "impact-g",
}  # fmt: skip
# What a fit of mass and restitution alone found, with effects left out one after the other.
FITTED = {
    "impact-b": [(1.105, 0.657)], "impact-e": [(1.228, 0.732)], "impact-f": [(1.353, 0.661)],
    "impact-g": [(1.234, 0.725)], "impact-h": [(1.650, 0.689), (1.601, 0.744)], "impact-i": [(1.0888, 0.6504)],
}  # fmt: skip
SD = {"normal_force": 0.25, "depression": 2e-5, "pressure": 2e3}
SLIP_TRUTH = {"adhesion_constant": 0.96, "loss_factor": 0.18, "slip_scale": 1.0}
SLIP_EFFECTS = {"stribeck": {"A": 0.3, "u_s": 0.06}, "frictional-heating": {"kappa": 0.9}}
STROKES = (6e-3, 6e-3, 4e-3, 4e-3)
UNITS = {"normal_force": "N", "depression": "m", "pressure": "Pa"}
SENTENCES = {
    "nothing-missing": "Nothing is missing: the reference model leaves no misfit beyond noise and setting errors at "
    "the 5 % level, and this campaign would have shown any of nine effects of the size of three times the noise.",
    "explained": "What is missing is adhesion: with tau_a = 86.0 ± 0.9 kPa no misfit is left (p = 0.41), and the "
    "held-out error falls from 4.1 % to 1.4 %, the noise floor. Viscous dashpot is ruled out by 6.2 standard errors.",
    "improved": "Wall stiffness and an arm that follows its command take away most of the misfit, but not all of it; "
    "what is left sits late in the contact.",
    "unexplained": "Something is missing that the catalogue does not hold: 78 % of the misfit sits beyond 6.1 mm of "
    "depression while loading, at every pressure. Look for something that stiffens there, such as an end stop.",
    "undecided": "These data cannot decide: four records at one speed could not have shown any effect of the catalogue "
    "at three times the noise. Strike at a second speed and record the pressure.",
}


def read_records(name):
    """Conditions (SI) and samples of a shipped campaign, by record."""
    with open(DATA / name / "records.csv", newline="") as file:
        conditions = {row.pop("record"): {key: float(value) for key, value in row.items()}
                      for row in csv.DictReader(file)}
    for one in conditions.values():
        one["initial_pressure"] *= 1e6
    samples = {record: {"time": [], "normal_force": [], "depression": [], "pressure": []} for record in conditions}
    scale = {"depression": 1e-3, "pressure": 1e6}
    with open(DATA / name / "samples.csv", newline="") as file:
        for row in csv.DictReader(file):
            for key, values in samples[row["record"]].items():
                if key in row:
                    values.append(float(row[key] or "nan") * scale.get(key, 1.0))
    return conditions, {key: {k: np.array(v) for k, v in one.items() if v} for key, one in samples.items()}


@functools.cache
def make_traces(name, base, effects):
    """Model beside measurement for a shipped campaign; effects as a JSON text, so that the result can be kept."""
    conditions, samples = read_records(name)
    base = dict(zip(("effective_mass", "restitution"), base, strict=True))
    traces = []
    for record, own in samples.items():
        channels = [key for key in own if key != "time"]
        wanted = [*channels, "depression"]
        columns = simulate(base, json.loads(effects), conditions[record], own["time"], wanted, rtol=1e-6)
        depression = np.maximum(columns[:, -1], 0.0)
        rate = np.where(depression > 0, np.gradient(depression, own["time"]), 0.0)
        for i, channel in enumerate(channels):
            traces.append(Trace(record, channel, UNITS[channel], conditions[record], own["time"], own[channel],
                                columns[:, i], SD[channel], depression, rate))
    return tuple(traces)


def estimate(value, relative=0.004, unit=""):
    """A parameter with a normal 95 % interval."""
    sd = abs(value) * relative
    return Estimate(value, sd, value - 1.96 * sd, value + 1.96 * sd, unit)


def measure(traces):
    """chi-square per sample and relative error of the force traces."""
    force = [trace for trace in traces if trace.channel == "normal_force"]
    left = np.concatenate([trace.measured - trace.model for trace in force])
    signal = np.concatenate([trace.measured for trace in force])
    size, misfit, sd = math.sqrt(np.mean(signal**2)), math.sqrt(np.mean(left**2)), SD["normal_force"]
    return (misfit / sd) ** 2, misfit / size, sd / size


def make_step(name, base, effects, added, rejected):
    """One model of the loop."""
    traces = make_traces(name, base, json.dumps(effects))
    chi2, error, _ = measure(traces)
    parameters = {"effective_mass": estimate(base[0], 0.003, "kg"), "restitution": estimate(base[1], 0.002)}
    units = {"tau_a": "Pa", "k_w": "N/m", "k_s": "N/m", "q": "", "n": ""}
    parameters |= {f"{effect}.{key}": estimate(value, 0.012, units.get(key, ""))
                   for effect, own in effects.items() for key, value in own.items()}
    fit = LackOfFit(9.3 if rejected else 1.03, 212.0, 1e-9 if rejected else 0.41, 0.05, rejected,
                    1e-9 if rejected else 0.41, 2e-5 if rejected else 0.63, 0.7,
                    "Chi-square of the residuals smoothed over a tenth of the contact.")
    names = list(parameters)
    correlations = tuple((names[i], names[j], 0.96 * (-0.83) ** (i + j)) for j in range(len(names)) for i in range(j))
    alternatives = () if added is None else (
        {"effect": "viscous-dashpot", "heldout_difference": 0.0004, "standard_error": 0.0003},)
    return Step(added, tuple(effects), chi2, error, 1.04 * error, alternatives, fit, parameters, correlations, traces,
                True)


def make_candidates(first=()):
    """All effects of the catalogue, best first."""
    order = list(dict.fromkeys((*first, *(("viscous-dashpot",) if first else ()), *CATALOGUE)))
    candidates = []
    for i, effect in enumerate(order):
        visible = 0.001 if effect in ("sensor-lag", "sensor-gain") else 0.62 / (1 + 0.25 * (i * 7 % 5))
        explains = 0.985 * 0.55**i if first else 0.02 / (1 + i)
        kin = ("viscous-dashpot",) if first and i == 0 else ()
        p_value = (3e-7 if i == 0 else min(0.9, 0.004 * 2.0**i)) if first else 0.2 + 0.04 * i
        candidates.append(Candidate(
            effect, p_value, explains, visible, 0.014 + 0.002 * i, {f"{effect}.k": 12.5 * (i + 1)}, kin,
            {f"{effect}.k": estimate(40.0 + i, 0.1, "N/m")},
            0.0004 * i, 0.0003, {"viscous-dashpot": 0.93} if kin else {}, ""))  # fmt: skip
    return tuple(candidates)


def make_discovery(verdict="explained", campaign=None, **changes):
    """A discovery with that verdict; further fields replace what is made up here."""
    name = campaign or CAMPAIGNS[verdict]
    truth = json.loads((DATA / "truth.json").read_text())[name]
    hidden = {key: value for key, value in truth["effects"].items() if not key.startswith("x-")}
    base = (truth["base"]["effective_mass"], truth["base"]["restitution"])
    found = hidden if verdict in ("explained", "improved") else {}
    order = sorted(found, key=lambda effect: effect != "wall-stiffness")
    models = [{key: found[key] for key in order[:i]} for i in range(len(order) + 1)]
    bases = [*FITTED.get(name, [base]), base][: len(models)]
    missing = verdict in ("improved", "unexplained")
    steps = tuple(
        make_step(name, bases[i], model, order[i - 1] if i else None,
                  missing if i == len(models) - 1 else True)
        for i, model in enumerate(models)
    )  # fmt: skip
    place = Place("normal_force", "depression", (0.0061, 0.0075), "loading", 0.78)
    fields = dict(
        campaign=name, title="Synthetic impact campaign", family="impact", sha256="3f" * 32, model="paper",
        verdict=verdict, effects=tuple(order), steps=steps, candidates=make_candidates(order),
        where=(place,) if verdict not in ("nothing-missing", "undecided") else (),
        noise_nrmse=measure(steps[-1].traces)[2],
        noise={channel: {"stated_sd": SD[channel], "sd": 1.01 * SD[channel], "correlation": truth["rho"],
                         "white_share": truth["white_share"], "text": "From the samples before contact."}
               for channel in dict.fromkeys(trace.channel for trace in steps[-1].traces)},
        sentence=SENTENCES[verdict],
        notes=("Pressures are taken as absolute.", "The conditions of every record are nuisances under their priors."),
        settings=SelectionSettings(level=0.05), counts={"records": 2, "samples": 400, "conditions": 2, "seconds": 1.2},
    )  # fmt: skip
    return Discovery(**(fields | changes))


def make_peaks(verdict="undecided"):
    """A discovery on the four peaks of Figure 8."""
    with open(DATA / "paper/figure-8/peaks.csv", newline="") as file:
        peaks = [(row["record"], float(row["peak_normal_force"])) for row in csv.DictReader(file)]
    traces = tuple(
        Trace(record, "peak_normal_force", "N", {"initial_pressure": p * 1e6, "approach_speed": 0.4}, np.zeros(1),
              np.array([value]), np.array([51.2 * p ** (1 / 3) - 1.0]), 1.0, np.zeros(1), np.zeros(1))
        for (record, value), p in zip(peaks, (1.0, 1.5, 2.0, 2.5), strict=True)
    )  # fmt: skip
    nan = math.nan
    fit = LackOfFit(2.1, 2.0, 0.12, 0.05, False, 0.12, nan, nan, "Too few records for a test of the shape.")
    step = Step(None, (), 2.1, 0.021, nan, (), fit, {"effective_mass": estimate(1.3, 0.05, "kg")}, (), traces, True)
    return Discovery("figure-8", "Peak forces of Figure 8", "impact", "ab" * 32, "paper", verdict, (), (step,),
                     make_candidates(), (), 0.017, {"peak_normal_force": {"stated_sd": nan, "sd": 1.0}},
                     SENTENCES[verdict])


def make_slip_traces(base, effects, strokes=None):
    """Friction of twelve tests with a Stribeck effect and warming rubber, beside a model of them by the simulator.

    Over slip on one stroke of 12 mm, or over time on strokes of these lengths [m], back and forth; at a reversal
    the sample is missing. Loads and pressures differ a little from what is wanted, as in a laboratory.
    """
    generator, traces = np.random.default_rng(7), []
    path = np.round(np.arange(round(sum(strokes or (12e-3,)) / 1e-4) + 1) * 1e-4, 12)
    _, _, since, direction = follow_strokes(path, strokes)
    for i, (load, pressure, speed) in enumerate(itertools.product((6.0, 12.0, 24.0), (0.8e6, 2.0e6), (0.02, 0.1))):
        conditions = {"normal_load": load * generator.normal(1, 0.01), "slip_speed": speed,
                      "internal_pressure": pressure * generator.normal(1, 0.003)}  # fmt: skip
        force = simulate_slip(SLIP_TRUTH, SLIP_EFFECTS, conditions, path, strokes)[:, 0]
        force = force + 0.04 * generator.normal(size=path.size)
        if strokes:
            force[np.isin(path, np.cumsum(strokes)[:-1].round(12))] = np.nan
        model = simulate_slip(base, effects, conditions, path, strokes, rtol=1e-6)[:, 0]
        traces.append(Trace(
            f"r{i + 1:02d}", "tangential_force", "N", conditions, path / speed if strokes else path, force, model, 0.04,
            since, direction * speed, "slip", "time" if strokes else "slip"))  # fmt: skip
    return tuple(traces)


def make_slip_discovery(strokes=None, **changes):
    """A discovery on slip records, over slip or with strokes over time; further fields replace what is made up."""
    fit = LackOfFit(6.2, 180.0, 1e-9, 0.05, True, 1e-9, 1e-6, 0.3, "Chi-square of the smooth part of the residuals.")
    well = LackOfFit(1.01, 178.0, 0.44, 0.05, False, 0.44, 0.51, 0.6)
    found = {"adhesion_constant": estimate(0.96, 0.02), "loss_factor": estimate(0.181, 0.02),
             "slip_scale": estimate(1.002, 0.002)}  # fmt: skip
    grown = found | {"stribeck.A": estimate(0.3, 0.03), "stribeck.u_s": estimate(0.06, 0.05, "m/s"),
                     "frictional-heating.kappa": estimate(0.9, 0.04, "1/J")}  # fmt: skip
    before = make_slip_traces(SLIP_TRUTH | {"adhesion_constant": 1.08}, {}, strokes)
    after = make_slip_traces(SLIP_TRUTH, SLIP_EFFECTS, strokes)
    alike = ({"effect": "viscous-friction", "heldout_difference": 0.0003, "standard_error": 0.0004},)
    steps = (
        Step(None, (), 7.9, 0.031, 0.034, (), fit, found, (("adhesion_constant", "loss_factor", -0.98),), before, True),
        Step("stribeck", tuple(SLIP_EFFECTS), 1.01, 0.0104, 0.0107, alike, well, grown,
             (("adhesion_constant", "loss_factor", -0.99), ("stribeck.A", "stribeck.u_s", -0.4)), after, True),
    )  # fmt: skip
    names = ("stribeck", "frictional-heating", "viscous-friction", "load-exponent", "presliding", "adhesive-offset")
    candidates = tuple(
        Candidate(name, 0.001 * 3**i, 0.7 / (1 + i), 0.4 / (1 + i), 0.012 + 0.003 * i, {f"{name}.k": 0.02}, (), {},
                  0.003 * i, 0.001, {}) for i, name in enumerate(names)
    )  # fmt: skip
    places = (
        Place("tangential_force", "slip", (0.002, 0.006), "backward" if strokes else "forward", 0.63, 0.0018),
        Place("tangential_force", "slip_speed", (0.018, 0.022), "both", 0.21),
    )  # fmt: skip
    fields = dict(
        campaign="slip-strokes" if strokes else "slip-a", title="Synthetic slip campaign", family="slip",
        sha256="5a" * 32, model="paper", verdict="explained", effects=tuple(SLIP_EFFECTS), steps=steps,
        candidates=candidates, where=places, noise_nrmse=0.0103,
        noise={"tangential_force": {"stated_sd": 0.04, "sd": 0.0403, "correlation": 0.1, "white_share": 0.2}},
        sentence="Missing were stribeck and frictional-heating (A = 0.300 ± 0.009; kappa = 0.90 ± 0.04 1/J).",
        settings=SelectionSettings(level=0.05),
    )  # fmt: skip
    return Discovery(**(fields | changes))


def make_friction_peaks():
    """A discovery on one peak of friction a record, pressures and loads varied at once."""
    traces = tuple(
        Trace(f"p{i}", "peak_friction_force", "N", {"normal_load": load, "internal_pressure": p, "slip_speed": 0.4},
              np.zeros(1), np.array([0.218 * load + 0.1 * (-1) ** i]), np.array([0.218 * load]), 0.1, np.zeros(1),
              np.zeros(1), "slip", "slip")
        for i, (load, p) in enumerate(itertools.product((40.0, 50.0, 60.0), (0.5e6, 1e6, 1.5e6)))
    )  # fmt: skip
    found = make_slip_discovery()
    step = dc.replace(found.steps[0], traces=traces)
    return dc.replace(found, steps=(step, dc.replace(step, added="stribeck", traces=traces)), where=())
