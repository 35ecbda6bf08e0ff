"""Are the uncertainties true? Coverage of the fit's intervals and simulation-based calibration of emcee.

    python -m docs.calibration -o fits/calibration [--campaigns 4000] [--runs 500] [--workers 2]
    python -m docs.calibration -o fits/calibration --only slip    emcee's part in one case anew

Campaigns come from the simulators in `ddetumble/exam/simulators`, each with settings that scatter and noise of its
own. Writes `result.json`, two figures and `README.md`.
"""

import argparse
import dataclasses as dc
import json
import multiprocessing
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy import stats

from ddetumble.effects import parameters_of
from ddetumble.exam.simulators.campaigns import Campaign as SimulatedCampaign
from ddetumble.exam.simulators.impact_campaigns import make_campaign
from ddetumble.exam.simulators.slip_campaigns import make_slip_campaign
from ddetumble.figures.palette import AFTER, BEFORE, GREY
from ddetumble.figures.style import dress, new_figure, render_png, styled
from ddetumble.inference.archive import resolve_model
from ddetumble.inference.assembly import assemble_space, default_starts
from ddetumble.inference.bounded import solve_bounded
from ddetumble.inference.files import list_versions, write_json
from ddetumble.inference.findings import Fit, summarise_fit
from ddetumble.inference.models import resolve_effect
from ddetumble.inference.parameters import ParameterSpace
from ddetumble.inference.problem import Problem
from ddetumble.inference.stack import default_noise, stack_records, trim_records
from ddetumble.measurement.campaign import Campaign, Column, Uncertainty
from ddetumble.posterior.chain import Settings, run_chains
from ddetumble.posterior.ensemble import Ensembles
from ddetumble.posterior.target import pose_fit


LEVELS = (0.5, 0.9, 0.95)
DRAWS = 99  # of a run, ranked with the truth among them
CHUNK = 20


@dc.dataclass(frozen=True)
class Case:
    """One kind of campaign.

    Attributes:
        text: what it is, for people.
        family: of the campaign.
        effects: in the model.
        truth: by name, public values: a number, or (mean, sd) of a Gaussian in the coordinate that it is drawn from,
            which is the prior of the fit then.
        known: held by the fit at their true value.
        plan: of the campaign.
        bounds: of coordinates.
    """

    text: str
    family: str
    effects: tuple[str, ...]
    truth: Mapping[str, float | tuple[float, float]]
    known: Mapping[str, float]
    plan: Mapping[str, Any]
    bounds: Mapping[str, tuple[float, float]] = dc.field(default_factory=dict)


IMPACTS: dict[str, Any] = {"pressures": [6e5, 1.6e6], "speeds": [0.3, 0.55], "repeats": 1, "interval": 1e-3}
STROKES: dict[str, Any] = {"loads": [8.0, 14.0, 20.0], "speeds": [0.02], "length": 6e-3, "interval": 2e-4}
WALL = "wall-stiffness.k_w"
OFFSET = "adhesive-offset.f_a"
COVERAGE = {
    "impact": Case("four impacts; mass, restitution and a wall stiffness well away from zero", "impact",
                   ("wall-stiffness",), {"effective_mass": 1.3, "restitution": 0.7, WALL: 1500.0}, {}, IMPACTS),
    "impact-at-zero": Case("the same, and there is no wall stiffness: the one-sided effect sits at its limit", "impact",
                           ("wall-stiffness",), {"effective_mass": 1.3, "restitution": 0.7, WALL: 0.0}, {}, IMPACTS,
                           {WALL: (0.0, np.inf)}),
    "pair": Case("three strokes at one pressure: K and tan delta_L cannot be told apart, both have a prior", "slip", (),
                 {"adhesion_constant": (np.log(0.9), 0.3), "loss_factor": (np.log(0.16), 0.3)}, {"slip_scale": 1.0},
                 {**STROKES, "pressures": [1e6], "noise": 0.1}),
}
SAMPLED = {
    "impact": Case("four noisy impacts; everything has a prior, the wall stiffness a limit at zero", "impact",
                   ("wall-stiffness",), {"effective_mass": (np.log(1.3), 0.2), "restitution": (0.85, 0.4),
                                         WALL: (600.0, 600.0)}, {},
                   {**IMPACTS, "interval": 2e-3, "noise": {"normal_force": 4.0}}, {WALL: (0.0, np.inf)}),
    "slip": Case("three noisy strokes at one pressure; K and tan delta_L cannot be told apart, and an offset at zero",
                 "slip", ("adhesive-offset",),
                 {"adhesion_constant": (np.log(0.9), 0.4), "loss_factor": (np.log(0.16), 0.4), OFFSET: (0.0, 0.3)},
                 {"slip_scale": 1.0}, {**STROKES, "pressures": [1e6], "noise": 0.5}, {OFFSET: (0.0, np.inf)}),
}


def draw_truth(case: Case, space: ParameterSpace, generator) -> dict[str, float]:
    """True public values of one campaign."""
    found = {}
    for name, given in case.truth.items():
        if isinstance(given, tuple):
            low, high = case.bounds.get(name, (-np.inf, np.inf))
            a, b = ((end - given[0]) / given[1] for end in (low, high))
            u = stats.truncnorm.rvs(a, b, loc=given[0], scale=given[1], random_state=generator)
            found[name] = space.parameter(name).transform.from_unconstrained(float(u))
        else:
            found[name] = given
    return found


def make_raw(case: Case, truth: Mapping[str, float], seed: int) -> SimulatedCampaign:
    """A campaign by the independent simulator."""
    base = {**{k: v for k, v in truth.items() if "." not in k}, **case.known}
    effects: dict[str, dict[str, float]] = {}
    for name, value in truth.items():
        if "." in name:
            effect, _, own = name.partition(".")
            effects.setdefault(effect, {})[own] = value
    maker: Callable[..., SimulatedCampaign] = make_campaign if case.family == "impact" else make_slip_campaign
    return maker("calibration", seed, effects, base, **case.plan)


def read_raw(case: Case, raw: SimulatedCampaign) -> Campaign:
    """The campaign that reading its folder would give, without the folder."""
    stated = raw.uncertainties
    records = pd.DataFrame([r.written for r in raw.records], index=[r.label for r in raw.records])
    records.index.name = "record"
    units = {"initial_pressure": "Pa", "approach_speed": "m/s", "normal_load": "N", "internal_pressure": "Pa",
             "slip_speed": "m/s", "sequence": "1"}
    conditions = {c: Column(c, units[c], Uncertainty(relative=stated[c]) if c in stated else None)
                  for c in records.columns}
    if case.family == "impact":
        axis, channel = Column("time", "s", Uncertainty(stated["time"])), "normal_force"
        known: dict[str, float | None] = {"outer_diameter": 0.060, "effective_mass": None, "restitution": None}
    else:
        axis, channel = Column("slip", "m"), "tangential_force"
        known = {"tensile_strength": 10e6, "real_contact_pressure": 20e6, "elastic_modulus": 7.8e6,
                 "poisson_ratio": 0.47, "adhesion_constant": None, "loss_factor": None, "slip_scale": None}
        known |= dict(case.known)
    parts = [pd.DataFrame({"record": r.label, axis.name: r.along[axis.name], channel: r.values[:, 0]})
             for r in raw.records]  # fmt: skip
    return Campaign("calibration", "calibration", case.family, None, known, records, conditions, axis,
                    {channel: Column(channel, "N", Uncertainty(raw.noise[channel]))},
                    pd.concat(parts, ignore_index=True))


@cache
def pose(kind: str, name: str) -> tuple[Case, ParameterSpace, tuple[str, ...], np.ndarray]:
    """Case, space of its model alone, free parameters, and where fits start."""
    case = {"coverage": COVERAGE, "sampled": SAMPLED}[kind][name]
    raw = make_raw(case, {n: v if isinstance(v, float) else 1.0 for n, v in case.truth.items()}, 0)
    assembly = assemble_space(read_raw(case, raw), resolve_model("paper", case.family).reference)
    space = ParameterSpace(assembly.space.reference, [resolve_effect(e) for e in case.effects])
    values = dict(zip(assembly.space.index, assembly.start, strict=True))
    start = np.array([values[n] for n in space.index])
    for effect in space.effects:
        for n, u in default_starts(effect)[0].items():
            start[space.index[n]] = u
        shapes = [f"{effect.id}.{p.name}" for p in parameters_of(effect) if p.kind == "shape"]
        start[[space.index[n] for n in shapes]] = [values[n] for n in shapes]
    return case, space, tuple(n for n in space.index if n in case.truth), start


def run_one(kind: str, name: str, seed: int) -> tuple[Fit, dict[str, float]]:
    """Truth and fit of one campaign."""
    case, space, names, start = pose(kind, name)
    generator = np.random.default_rng([seed, 20261121])
    truth = draw_truth(case, space, generator)
    campaign = read_raw(case, make_raw(case, truth, int(generator.integers(2**31))))
    priors = {n: v for n, v in case.truth.items() if isinstance(v, tuple)}
    problem = Problem(space, trim_records(stack_records(campaign)), priors)
    found = solve_bounded(problem, names, start, None, case.bounds)
    channel = next(iter(campaign.channels))
    assert campaign.samples is not None
    noise = {channel: default_noise(campaign, channel, np.arange(3.0))}
    return summarise_fit(campaign, "paper", case.effects, problem, found, start, noise, {}, True), truth


def cover(job: tuple[str, int, int]) -> dict[str, Any]:
    """Which intervals hold the truth, over a chunk of campaigns."""
    name, first, last = job
    inside, wide, lost = [], [], 0
    for seed in range(first, last):
        fit, truth = run_one("coverage", name, seed)
        lost += not fit.converged
        row, width = [], []
        for parameter in truth:
            ends = [fit.interval(parameter, level) for level in LEVELS]
            row.append([low <= truth[parameter] <= high for low, high in ends])
            width.append(ends[-1][1] - ends[-1][0])
        inside.append(row)
        wide.append(width)
    return {"inside": np.sum(inside, axis=0).tolist(), "width": np.sum(wide, axis=0).tolist(), "lost": int(lost),
            "count": last - first}


def rank(job: tuple[str, int, int]) -> list[dict[str, Any]]:
    """Rank of the truth among draws, and whether central intervals hold it, over a chunk of runs."""
    name, first, last = job
    rows = []
    for seed in range(first, last):
        fit, truth = run_one("sampled", name, 10**6 + seed)
        target = pose_fit(fit)
        settings = Settings(walkers=16, ensembles=1, burn=60, block=80, effective=10**6, most=240, seed=seed)
        chains = run_chains(Ensembles, target, settings)
        draws = target.publish(chains.x.reshape(-1, len(target.names)))
        few = draws[np.linspace(0, len(draws) - 1, DRAWS).astype(int)]
        true = np.array([truth[n] for n in target.names])
        central = [[bool(a <= t <= b) for t, a, b in zip(true, *np.quantile(draws, [0.5 - p / 2, 0.5 + p / 2], axis=0),
                                                         strict=True)] for p in LEVELS]
        rows.append({"ranks": np.sum(few < true, axis=0).tolist(), "inside": np.transpose(central).tolist(),
                     "time": chains.convergence.times.max(), "failed": not np.isfinite(chains.convergence.rhat),
                     "sampled": bool(target.plan.nodes.shape[0])})
    return rows


def hold(job: tuple[str, int, int]) -> list[list[list[bool]]]:
    """Whether intervals of `fit` hold the truth in the very campaigns that `rank` draws from, over a chunk of runs."""
    name, first, last = job
    rows = []
    for seed in range(first, last):
        fit, truth = run_one("sampled", name, 10**6 + seed)
        ends = {n: [fit.interval(n, level) for level in LEVELS] for n in pose("sampled", name)[2]}
        rows.append([[low <= truth[n] <= high for low, high in own] for n, own in ends.items()])
    return rows


def find_band(count: int, bins: int, level: float = 0.95, trials: int = 4000) -> float:
    """Pointwise level at which the ECDF of `count` uniform ranks stays inside everywhere with probability `level`.

    Säilynoja, Bürkner and Vehtari (2022), by simulation.
    """
    places = np.arange(1, bins) / bins
    ranks = np.random.default_rng(0).integers(0, bins, size=(trials, count))
    below = np.stack([np.bincount(r, minlength=bins).cumsum()[:-1] for r in ranks])
    tails = np.minimum(stats.binom.cdf(below, count, places), stats.binom.sf(below - 1, count, places))
    return float(2 * np.quantile(tails.min(axis=1), 1 - level))


def judge_ranks(ranks: np.ndarray, bins: int) -> dict[str, Any]:
    """Whether ranks, shape (runs,), are uniform: the ECDF within its band, and by how much."""
    level = find_band(len(ranks), bins)
    places = np.arange(1, bins) / bins
    below = np.bincount(ranks, minlength=bins).cumsum()[:-1]
    low, high = stats.binom.ppf(level / 2, len(ranks), places), stats.binom.ppf(1 - level / 2, len(ranks), places)
    return {"inside": bool(np.all((below >= low) & (below <= high))), "low": low / len(ranks) - places,
            "high": high / len(ranks) - places, "ecdf": below / len(ranks) - places}


def spread_jobs(work: Callable, name: str, count: int, workers: int) -> list[Any]:
    """Run chunks in processes of their own."""
    jobs = [(name, k, min(k + CHUNK, count)) for k in range(0, count, CHUNK)]
    if workers == 1:
        return [work(job) for job in jobs]
    with multiprocessing.get_context("spawn").Pool(workers) as pool:
        results = []
        for done, result in enumerate(pool.imap(work, jobs), 1):
            results.append(result)
            print(f"\r{work.__name__} {name}: {done * CHUNK} of {count}", end="", flush=True)
        print()
        return results


def study_coverage(name: str, count: int, workers: int) -> dict[str, Any]:
    """Coverage of the fit's intervals in one case."""
    parts = spread_jobs(cover, name, count, workers)
    case = COVERAGE[name]
    share = np.sum([p["inside"] for p in parts], axis=0) / count
    width = np.sum([p["width"] for p in parts], axis=0) / count
    return {"text": case.text, "campaigns": count, "not_converged": int(sum(p["lost"] for p in parts)),
            "coverage": {n: dict(zip(map(str, LEVELS), share[k], strict=True)) for k, n in enumerate(case.truth)},
            "width": dict(zip(case.truth, width, strict=True))}


def study_ranks(name: str, count: int, workers: int) -> dict[str, Any]:
    """Simulation-based calibration in one case."""
    rows = [row for part in spread_jobs(rank, name, count, workers) for row in part]
    names = pose("sampled", name)[2]
    ranks = np.array([row["ranks"] for row in rows])
    inside = np.mean([row["inside"] for row in rows], axis=0)
    return {"text": SAMPLED[name].text, "runs": count, "same": study_same(name, count, workers),
            "ranks": {n: ranks[:, k].tolist() for k, n in enumerate(names)},
            "uniform": {n: judge_ranks(ranks[:, k], DRAWS + 1)["inside"] for k, n in enumerate(names)},
            "coverage": {n: dict(zip(map(str, LEVELS), inside[k], strict=True)) for k, n in enumerate(names)},
            "longest_time": float(max(row["time"] for row in rows)),
            "nuisances_sampled": int(sum(row["sampled"] for row in rows))}


def study_same(name: str, count: int, workers: int) -> dict[str, Any]:
    """Coverage of the fit's intervals in the campaigns of `study_ranks`: what chance made of these."""
    names = pose("sampled", name)[2]
    inside = np.mean([row for part in spread_jobs(hold, name, count, workers) for row in part], axis=0)
    return {n: dict(zip(map(str, LEVELS), inside[k], strict=True)) for k, n in enumerate(names)}


@styled
def draw_ranks(studies: Mapping[str, Any]):
    """ECDF of the ranks less the diagonal, with the simultaneous 95 % band, one panel a parameter."""
    panels = [(case, n, np.array(r)) for case, found in studies.items() for n, r in found["ranks"].items()]
    rows = -(-len(panels) // 3)
    figure = new_figure(2.3 * rows)
    axes = figure.subplots(rows, 3, squeeze=False, sharey=True)
    for axis, (case, name, ranks) in zip(axes.flat, panels, strict=False):
        found = judge_ranks(ranks, DRAWS + 1)
        x = np.arange(1, DRAWS + 1) / (DRAWS + 1)
        dress(axis).fill_between(x, found["low"], found["high"], color=GREY, alpha=0.3, lw=0)
        axis.plot(x, found["ecdf"], color=AFTER if found["inside"] else BEFORE)
        axis.set_title(f"{case}: {name}")
        axis.set_xlabel("rank of the truth / 100")
    for axis in axes[:, 0]:
        axis.set_ylabel("ECDF less uniform")
    for axis in axes.flat[len(panels):]:
        axis.set_visible(False)
    return figure


@styled
def draw_coverage(coverage: Mapping[str, Any], sampled: Mapping[str, Any]):
    """Share of intervals that hold the truth, with two standard errors of what it should be."""
    rows = [(f"fit, {case}: {n}", found["campaigns"], c) for case, found in coverage.items()
            for n, c in found["coverage"].items()]
    rows += [(f"emcee, {case}: {n}", found["runs"], c) for case, found in sampled.items()
             for n, c in found["coverage"].items()]
    figure = new_figure(0.25 * len(rows) + 0.9)
    axes = figure.subplots(1, len(LEVELS), sharey=True)
    for axis, level in zip(axes, LEVELS, strict=True):
        for k, (_, count, found) in enumerate(rows):
            wide = 200 * np.sqrt(level * (1 - level) / count)
            axis.errorbar(100 * found[str(level)], -k, xerr=wide, fmt="o", ms=4, color=AFTER)
        dress(axis, "x").axvline(100 * level, color=GREY, lw=1)
        axis.set_title(f"{100 * level:g} % intervals")
        axis.set_xlabel("hold the truth [%]")
    axes[0].set_yticks([-k for k in range(len(rows))], [r[0] for r in rows])
    return figure


def describe(result: Mapping[str, Any], command: str) -> str:
    """README of the folder."""
    lines = ["# Are the uncertainties true?", "", f"Made by `{command}`; numbers in `result.json`.", "",
             "## Intervals of `fit`", "", "Share of intervals that hold the truth, over simulated campaigns "
             "(independent simulator, settings and noise scatter).", "",
             "| case | parameter | campaigns | 50 % | 90 % | 95 % |", "| --- | --- | --- | --- | --- | --- |"]
    for case, found in result["coverage"].items():
        for n, c in found["coverage"].items():
            lines.append(f"| {case} | {n} | {found['campaigns']} | "
                         + " | ".join(f"{100 * c[str(level)]:.1f} %" for level in LEVELS) + " |")
    lines += ["", *(f"- *{case}*: {found['text']}." for case, found in result["coverage"].items()), "",
              "With 4,000 campaigns the standard error is 0.8, 0.5 and 0.3 points. At its limit an interval of highest "
              "density is wider than it needs to be (50 %) or begins at the limit, where the truth is.", "",
              "![coverage](coverage.png)", "", "## Draws of emcee", "",
              "Simulation-based calibration: truth from the prior, a campaign from the truth, 99 draws from the "
              "posterior; the rank of the truth among them is uniform if everything between prior and draws is right, "
              "nuisances included. The band holds 95 % of uniform ECDFs everywhere at once. In brackets what the "
              "intervals of `fit` hold in the same campaigns: 500 have a standard error of 2.2, 1.3 and 1.0 points, "
              "and what both share is chance in drawing them.", "",
              "| case | parameter | runs | in the band | 50 % | 90 % | 95 % |",
              "| --- | --- | --- | --- | --- | --- | --- |"]
    for case, found in result["ranks"].items():
        for n, c in found["coverage"].items():
            same = found["same"][n]
            lines.append(f"| {case} | {n} | {found['runs']} | {'yes' if found['uniform'][n] else 'NO'} | "
                         + " | ".join(f"{100 * c[str(level)]:.1f} % ({100 * same[str(level)]:.1f} %)"
                                      for level in LEVELS) + " |")
    lines += ["", *(f"- *{case}*: {found['text']}; nuisances sampled rather than integrated analytically in "
                    f"{found['nuisances_sampled']} runs{found.get('remark', '')}."
                    for case, found in result["ranks"].items()), "",
              "![ranks](ranks.png)", ""]
    return "\n".join(lines)


def main() -> None:
    """Run the study."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--campaigns", type=int, default=4000)
    parser.add_argument("--runs", type=int, default=500)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--same", action="store_true", help="only the intervals of fit in the campaigns of emcee anew")
    parser.add_argument("--only", choices=sorted(SAMPLED), help="emcee in this case alone, put among what is there")
    given = parser.parse_args()
    given.output.mkdir(parents=True, exist_ok=True)
    file = given.output / "result.json"
    if given.same:
        result = json.loads(file.read_text(encoding="utf-8"))
        for name, found in result["ranks"].items():
            found["same"] = study_same(name, found["runs"], given.workers)
    elif given.only:
        found = study_ranks(given.only, given.runs, given.workers)
        result = json.loads(file.read_text(encoding="utf-8"))
        result["ranks"][given.only] = found
    else:
        result = {"schema": "ddetumble.calibration/1", "versions": list_versions()}
        result["coverage"] = {n: study_coverage(n, given.campaigns, given.workers) for n in COVERAGE}
        result["ranks"] = {n: study_ranks(n, given.runs, given.workers) for n in SAMPLED}
    (given.output / "ranks.png").write_bytes(render_png(draw_ranks(result["ranks"])))
    (given.output / "coverage.png").write_bytes(render_png(draw_coverage(result["coverage"], result["ranks"])))
    write_json(file, result)
    text = describe(result, "python -m docs.calibration -o fits/calibration")
    (given.output / "README.md").write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
