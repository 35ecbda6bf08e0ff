"""Friction of an O-ring in a pneumatic cylinder: a real campaign through the loop.

    python -m docs.seal_study FOLDER -o fits/oring-seal

FOLDER holds `friction.csv` of github.com/EvaZillen/3D-printed-pneumatic-actuator (CC0): columns seal, set_bar, time_s,
position_mm, pressure_bar (gauge), force_N. The model starts from force = pressure x area; what it lacks is added by
its error on pressures that were left out. With `repeats.npz` beside it, the fitted model also meets the repeated runs.
"""

import argparse
import dataclasses as dc
import json
import sys
import tempfile
import textwrap
from collections.abc import Callable, Mapping
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd

from ddetumble import Campaign, InputError, discover, fit, write_campaign
from ddetumble.cli.failures import run_guarded
from ddetumble.cli.progress import show_progress
from ddetumble.dynamics import simulate_sliding
from ddetumble.effects import parameters_of
from ddetumble.effects.slip import AdhesiveOffset, ViscousFriction
from ddetumble.families.slip import find_turns
from ddetumble.figures.palette import AFTER, BEFORE, FLOOR, INK
from ddetumble.figures.style import dress, head_figure, new_figure, render_png, styled
from ddetumble.inference.files import make_plain, write_json
from ddetumble.inference.stack import stack_records
from ddetumble.measurement.campaign import Column, Uncertainty
from ddetumble.selection.discovery import Discovery

from . import seal
from .reading import read_columns


MODEL = f"{Path(seal.__file__).resolve()}:PressureThrust"
NAME = "docs/seal.py:PressureThrust"
LADDER = (AdhesiveOffset, ViscousFriction, *seal.EFFECTS)
WORDS = {"": "pressure × area", "adhesive-offset": "constant friction", "viscous-friction": "viscous friction",
         "seal-load": "friction that grows with pressure", "seal-lag": "presliding", "thrust-offset": "constant force"}
COLUMNS = ("seal", "set_bar", "time_s", "position_mm", "pressure_bar", "force_N")
BORE = 25.7e-3  # m
AREA = np.pi / 4 * BORE**2  # m^2
BAR, AMBIENT = 1e5, 101325.0  # Pa
DISCARDED = 15  # samples at the beginning of a run, as upstream does
INTERVAL = 0.04  # s, of the samples that are kept
TURN = 1e-3  # m; a turn counts once the rod has come back so far
FORCE_NOISE, SLIP_NOISE = 0.15, 4e-5  # N, m; of one sample
SURE = 0.02  # of the held-out error; an effect that gains less is not added


def read_runs(folder: Path, ring: str) -> dict[str, pd.DataFrame]:
    """Runs of one ring by set pressure [bar, as text]: columns of `friction.csv`, first samples discarded.

    Raises:
        InputError: There is no such file, column or ring, or a number is missing.
    """
    table = read_columns(folder, "friction.csv", COLUMNS, words=("seal",))
    here = table[table["seal"] == ring]
    if not len(here):
        raise InputError(f"there is no seal {ring!r}; the file has {', '.join(sorted(set(table['seal'])))}",
                         file=Path(folder) / "friction.csv")
    return {f"{bar:g}": run.iloc[DISCARDED:].reset_index(drop=True) for bar, run in here.groupby("set_bar")}


def read_repeats(folder: Path, ring: str) -> dict[str, dict[str, pd.DataFrame]]:
    """Runs of `repeats.npz` by name, then set pressure; none where there is no such file."""
    path, found = Path(folder) / "repeats.npz", {}
    if not path.is_file():
        return found
    with np.load(path) as arrays:
        for key in arrays.files:
            name, _, bar = key.removesuffix("bar").rpartition(f"_{ring}_")
            if name:
                run = pd.DataFrame(arrays[key][DISCARDED:], columns=list(COLUMNS[2:]))
                found.setdefault(name.replace("__", " "), {})[f"{float(bar):g}"] = run.assign(set_bar=float(bar))
    return found


def convert_runs(runs: Mapping[str, pd.DataFrame], title: str) -> Campaign:
    """A slip campaign, one record a stroke.

    Of each stroke a sample every `INTERVAL` is kept, the first at the turn, by linear interpolation: about one in four,
    and not averaged, which would move the turn and blur presliding. The regulator lets the pressure rise
    by up to 0.04 bar while the rod goes in and fall by up to 0.13 bar while it comes out: every sample's force is
    referred to the set pressure by the gauge and the nominal area, F - (p - p_set) A. The rod's position is `slip`. The
    first stroke of a run is left out: its turn is not among the samples.
    """
    records, samples, scatter = [], [], []
    for bar, run in runs.items():
        time, position, pressure, force = (run[c].to_numpy(dtype=float) for c in COLUMNS[2:])
        nominal = float(bar) * BAR
        position, referred = position * 1e-3, force - (pressure * BAR - nominal) * AREA
        scatter.append(np.std(np.diff(pressure)) / np.sqrt(2) * BAR)
        turns = find_turns(position, TURN)
        for number, (first, last) in enumerate(zip(turns[1:-1], turns[2:], strict=True), start=2):
            key = f"{bar}bar-{number:02d}-{'in' if position[last] > position[first] else 'out'}"
            grid = np.arange(time[first], time[last], INTERVAL)
            slip, tangential = (np.interp(grid, time, values) for values in (position, referred))
            speed = abs(position[last] - position[first]) / (time[last] - time[first])
            records.append({"record": key, "normal_load": nominal * AREA, "internal_pressure": nominal + AMBIENT,
                            "slip_speed": speed, "sequence": number})
            samples.append(pd.DataFrame({"record": key, "time": np.arange(len(grid)) * INTERVAL,
                                         "tangential_force": tangential, "slip": slip}))
    sd = float(np.hypot(FORCE_NOISE, np.median(scatter) * AREA))
    conditions = {
        "normal_load": Column("normal_load", "N", description="gauge pressure as set x area of the "
                              f"{BORE * 1e3:g} mm bore; exact, as every force is referred to it"),
        "internal_pressure": Column("internal_pressure", "Pa", description="as set, absolute"),
        "slip_speed": Column("slip_speed", "m/s", description="mean of the stroke"),
        "sequence": Column("sequence", "1", description="number of the stroke in its run"),
    }
    channels = {
        "tangential_force": Column("tangential_force", "N", Uncertainty(absolute=sd),
                                   description="on the rod, referred to the pressure as set"),
        "slip": Column("slip", "m", Uncertainty(absolute=SLIP_NOISE), description="position of the rod"),
    }
    return Campaign(
        name="oring-seal", title=title, family="slip", path=None, known={},
        records=pd.DataFrame(records).set_index("record"), conditions=conditions, independent=Column("time", "s"),
        channels=channels, samples=pd.concat(samples, ignore_index=True),
        sources=({"title": "3D-printed pneumatic actuator (Zillen, Vallery, Smit; TU Delft)",
                  "path": "https://github.com/EvaZillen/3D-printed-pneumatic-actuator"},),
        licences=({"name": "CC0-1.0", "title": "CC0 1.0 Universal"},))


@dc.dataclass(frozen=True)
class Rung:
    """One model of the ladder.

    Attributes:
        effects: ids, in the order in which they were added.
        parameters: estimate, smallest and largest of the fits that left a pressure out, unit; by name.
        fitted, held_out: rms error by set pressure [bar] and over all (`all`) [N].
        rivals: held-out error over all of every other addition at this step [N], by id; `unphysical` names those whose
            amplitude came out on the side of its null that physics does not allow, and which did not count.
        residual: measured less fitted force, shape (records, samples) [N]; nan where there is no sample.
    """

    effects: tuple[str, ...]
    parameters: Mapping[str, tuple[float, float, float, str]]
    fitted: Mapping[str, float]
    held_out: Mapping[str, float]
    residual: np.ndarray
    rivals: Mapping[str, float] = dc.field(default_factory=dict)
    unphysical: Mapping[str, float] = dc.field(default_factory=dict)


class Bench:
    """One campaign, the models of the ladder fitted to it, and its pressures left out in turn.

    All effects are in every model, those that are not wanted held at their null: one program serves all of them. Every
    sample counts the same, and the errors are plain root mean squares: conditions do not move to meet the left-out
    records half way.
    """

    def __init__(self, campaign: Campaign):
        self.campaign, self.stack = campaign, stack_records(campaign).stack
        self.bars = np.round((campaign.records["internal_pressure"].to_numpy() - AMBIENT) / BAR, 6)
        count, values = len(self.bars), np.asarray(self.stack.values)[:, 0]
        self.measured = np.where(np.asarray(self.stack.weights)[:, 0] > 0, values, np.nan)[:count]

    def fit(self, effects: tuple[str, ...], left_out: float | None = None):
        """Fit a model to all pressures, or all but one."""
        keys = [k for k, bar in zip(self.campaign.record_keys, self.bars, strict=True) if bar != left_out]
        held = {f"{e.id}.{p.name}": p.default for e in LADDER if e.id not in effects for p in parameters_of(e)}
        return fit(self.campaign.select(keys), MODEL, LADDER, fixed=held, noise="stated")

    def residual(self, found) -> np.ndarray:
        """Measured less modelled force of all records, left out or not, shape (records, samples) [N]."""
        law = found.space.build(jnp.asarray(found.solution.u))
        return self.measured - np.asarray(run_strokes(law, self.stack))[: len(self.bars)]

    def climb(self, effects: tuple[str, ...]) -> Rung:
        """A model with its errors on fitted and left-out pressures."""
        whole = self.fit(effects)
        parts = {bar: self.fit(effects, bar) for bar in np.unique(self.bars)}
        outside = np.full_like(self.measured, np.nan)
        for bar, part in parts.items():
            outside[self.bars == bar] = self.residual(part)[self.bars == bar]
        names = [n for n, p in whole.parameters.items() if n not in whole.fixed]
        spread = {n: [part.parameters[n].estimate for part in parts.values()] for n in names}
        parameters = {n: (whole.parameters[n].estimate, min(spread[n]), max(spread[n]), whole.parameters[n].unit)
                      for n in names}
        inside = self.residual(whole)
        return Rung(effects, parameters, self.errors(inside), self.errors(outside), inside)

    def errors(self, residual: np.ndarray) -> dict[str, float]:
        """Root mean square by set pressure and over all [N]."""
        found = {f"{bar:g}": rms(residual[self.bars == bar]) for bar in np.unique(self.bars)}
        return found | {"all": rms(residual)}


@eqx.filter_jit
def run_strokes(law, stack):
    """Force of all records of a stack, shape (records, samples) [N]."""
    def one(conditions, slip, direction, time):
        return simulate_sliding(law, conditions, slip, direction, time).tangential_force

    return jax.vmap(one)(stack.conditions, stack.inputs["slip"], stack.inputs["direction"], stack.time)


def rms(values) -> float:
    """Root mean square of what is not missing."""
    return float(np.sqrt(np.nanmean(np.square(values))))


def find_unphysical(rung: Rung) -> dict[str, float]:
    """Amplitudes on the side of their null that physics does not allow, by name."""
    signs = {f"{e.id}.{p.name}": (p.sign, p.default) for e in LADDER for p in parameters_of(e) if p.sign}
    return {name: value for name, (value, *_) in rung.parameters.items()
            if name in signs and signs[name][0] * (value - signs[name][1]) < 0}


def grow_model(bench: Bench, report: Callable[..., None]) -> tuple[list[Rung], dict[str, dict[str, float]]]:
    """Add the effect that predicts left-out pressures best, until none gains more than 2 % of that error.

    Returns:
        The rungs, and what was refused after the last: `errors` held out [N], and `unphysical` amplitudes.
    """
    rungs = [bench.climb(())]
    while True:
        rest = [e.id for e in LADDER if e.id not in rungs[-1].effects]
        tried, unphysical = {}, {}
        for name in rest:
            report(f"step {len(rungs)}: with {name}", 0.3 + 0.6 * len(rungs) / (len(LADDER) + 1))
            rung = bench.climb((*rungs[-1].effects, name))
            unphysical |= find_unphysical(rung)
            if not find_unphysical(rung):
                tried[name] = rung
        errors = {name: rung.held_out["all"] for name, rung in tried.items()}
        best = min(errors, key=lambda name: errors[name], default=None)
        if best is None or errors[best] > (1 - SURE) * rungs[-1].held_out["all"]:
            return rungs, {"errors": errors, "unphysical": unphysical}
        rivals = {name: error for name, error in errors.items() if name != best}
        rungs.append(dc.replace(tried[best], rivals=rivals, unphysical=unphysical))


def split_residual(bench: Bench, rung: Rung) -> tuple[pd.DataFrame, dict[str, float]]:
    """What a model leaves, sample by sample, and how its mean square divides.

    Returns:
        A table with bar, way, stroke, position [mm], force, residual and the same against the motion, `friction` [N].
        Shares of the mean square: `place` repeats at the same position, pressure and direction (bins of 1 mm), `stroke`
        is a stroke's own mean beyond that, `rest` neither.
    """
    tables = []
    for r, key in enumerate(bench.campaign.record_keys):
        trace = bench.campaign.trace(key)
        way = 1.0 if key.endswith("in") else -1.0
        residual = rung.residual[r, : len(trace)]
        tables.append(pd.DataFrame({
            "bar": bench.bars[r], "way": way, "stroke": int(bench.campaign.records["sequence"].iloc[r]),
            "position": 1e3 * trace["slip"].to_numpy(), "force": bench.measured[r, : len(trace)], "residual": residual,
            "friction": way * residual}))
    table = pd.concat(tables, ignore_index=True).dropna()
    bins = [table["bar"], table["way"], np.floor(table["position"])]
    place = table.groupby(bins)["residual"].transform("mean")
    beyond = table["residual"] - place
    stroke = beyond.groupby([table["bar"], table["stroke"]]).transform("mean")
    whole = float((table["residual"] ** 2).mean())
    shares = {"place": float((place**2).mean()) / whole, "stroke": float((stroke**2).mean()) / whole}
    return table, shares | {"rest": 1.0 - shares["place"] - shares["stroke"]}


def meet_repeats(folder: Path, ring: str, bench: Bench, last: Rung) -> dict[str, dict[str, float]]:
    """Errors of the last model, as fitted, on runs that it never saw, and how far these lie from the first run.

    Returns:
        By run, rms over all pressures [N]: `model`; `first`, difference of the mean force at the same pressure,
        direction and position (bins of 1 mm) from that of the first run; `thrust` and `friction`, half sum and half
        difference of the two directions of `first`; `nearest`, as `first`, from the nearest other run.
    """
    runs = {name: Bench(convert_runs(run, name)) for name, run in read_repeats(folder, ring).items()}
    if not runs:
        return {}
    law, start, found = bench.fit(last.effects), _mean_curves(bench), {}
    curves = {name: _mean_curves(run) for name, run in runs.items()}
    for name, run in runs.items():
        ways = (curves[name] - start).unstack("way").dropna()
        others = [rms((curves[name] - curve).dropna()) for other, curve in curves.items() if other != name]
        found[name] = {"model": rms(run.residual(law)), "first": rms(ways), "thrust": rms(ways.mean(axis=1)),
                       "friction": rms(0.5 * (ways[1.0] - ways[-1.0])), "nearest": min(others, default=float("nan"))}
    return found


def _mean_curves(bench: Bench) -> pd.Series:
    """Mean force by pressure, direction and position in bins of 1 mm [N]."""
    measured = Rung((), {}, {}, {}, bench.measured)
    table, _ = split_residual(bench, measured)
    return table.groupby([table["bar"], table["way"], np.floor(table["position"])])["residual"].mean()


@dc.dataclass(frozen=True)
class Study:
    """What came out: the campaign, what `discover` says, the ladder, what is left, and the repeated runs."""

    bench: Bench
    found: Discovery
    rungs: list[Rung]
    refused: Mapping[str, Mapping[str, float]]
    left: pd.DataFrame
    shares: Mapping[str, float]
    repeats: Mapping[str, Mapping[str, float]]


def run_study(folder: Path, ring: str = "O-ring257", campaign: Path | None = None,
              report: Callable[..., None] = lambda *_: None) -> Study:
    """Convert, discover, grow the model, and look at what is left.

    Args:
        folder: with `friction.csv`.
        ring: which of its seals.
        campaign: where to write the slip campaign; a temporary folder where it is None.
        report: called with a sentence and the share done.
    """
    report("reading the runs", 0.0)
    made = convert_runs(read_runs(folder, ring), f"{ring} in a {BORE * 1e3:g} mm bore, referred to set pressures")
    with tempfile.TemporaryDirectory() as place:
        written = write_campaign(campaign or Path(place) / "campaign", made, overwrite=campaign is not None)
    # The speed goes with pressure and direction: left out, a pressure has to take both of its directions with it.
    plain = dc.replace(written, records=written.records.drop(columns="slip_speed"),
                       conditions={k: v for k, v in written.conditions.items() if k != "slip_speed"})
    found = discover(plain, MODEL, effects=seal.EFFECTS, progress=lambda text, share: report(text, 0.3 * share))
    bench = Bench(written)
    rungs, refused = grow_model(bench, report)
    left, shares = split_residual(bench, rungs[-1])
    report("meeting the repeated runs", 0.95)
    return Study(bench, found, rungs, refused, left, shares, meet_repeats(folder, ring, bench, rungs[-1]))


def describe_noise(study: Study) -> float:
    """Stated noise of a sample [N]."""
    return float(study.bench.campaign.channels["tangential_force"].uncertainty.absolute)


@styled
def draw_errors(study: Study):
    """Error by step, on fitted and on left-out pressures."""
    figure = new_figure(3.6)
    axes = dress(figure.subplots())
    steps = np.arange(len(study.rungs))
    for label, colour, shift in (("fitted", AFTER, -0.06), ("left out", BEFORE, 0.06)):
        errors = [rung.fitted if label == "fitted" else rung.held_out for rung in study.rungs]
        axes.plot(steps + shift, [e["all"] for e in errors], "-o", color=colour, lw=1.8, ms=6,
                  label=f"pressure {label}")
        for bar in errors[0]:
            if bar != "all":
                values = [e[bar] for e in errors]
                axes.plot(steps + shift, values, "o", color=colour, ms=3, alpha=0.55)
    axes.axhline(describe_noise(study), color=FLOOR, lw=1, ls=":", label="noise of a sample")
    if study.repeats:
        axes.axhline(np.mean([r["first"] for r in study.repeats.values()]), color=FLOOR, lw=1, ls="--",
                     label="the same test repeated")
    axes.set_yscale("log")
    axes.set_ylabel("rms error [N]")
    ticks = [t for t in (0.1, 0.2, 0.5, 1, 2, 5, 10)]
    axes.set_yticks(ticks, [f"{t:g}" for t in ticks])
    axes.minorticks_off()
    names = ["" if not rung.effects else rung.effects[-1] for rung in study.rungs]
    axes.set_xticks(steps, [("+ " if n else "") + WORDS[n].replace(" that", "\nthat") for n in names])
    axes.set_title("Small dots: single pressures")
    handles, labels = axes.get_legend_handles_labels()
    head_figure(figure, handles, labels)
    return figure


@styled
def draw_loops(study: Study):
    """Force less nominal thrust over position, measured and modelled, and below what the model leaves."""
    bars = list(np.unique(study.bench.bars))
    figure = new_figure(5.2)
    grid = figure.subplots(2, len(bars), sharex=True, sharey="row", height_ratios=(3, 2), squeeze=False)
    for column, bar in enumerate(bars):
        part = study.left[study.left["bar"] == bar]
        top, below = dress(grid[0, column]), dress(grid[1, column])
        for number, stroke in part.groupby("stroke"):
            measured = stroke["force"] - bar * BAR * AREA
            top.plot(stroke["position"], measured, color=FLOOR, lw=0.5, label="measured" if number == 3 else None)
            colour = AFTER if stroke["way"].iloc[0] > 0 else BEFORE
            below.plot(stroke["position"], stroke["residual"], lw=0.5, color=colour)
        for number in (3, 4):
            stroke = part[part["stroke"] == number]
            top.plot(stroke["position"], stroke["force"] - stroke["residual"] - bar * BAR * AREA, color=INK, lw=1.3,
                     label="model" if number == 3 else None)
        top.set_title(f"{bar:g} bar")
        below.axhline(0, color=INK, lw=0.6)
        below.set_xlabel("position of the rod [mm]")
    grid[0, 0].set_ylabel("force less p A as set [N]")
    grid[1, 0].set_ylabel("measured less model [N]")
    handles, labels = grid[0, 0].get_legend_handles_labels()
    for colour, label in ((AFTER, "left, going in"), (BEFORE, "left, coming out")):
        handles.append(grid[1, 0].plot([], [], color=colour, lw=1.2)[0])
        labels.append(label)
    head_figure(figure, handles, labels)
    return figure


def collect_result(study: Study, ring: str) -> dict:
    """Everything that the page says, as plain numbers."""
    found = json.loads(json.dumps(make_plain(study.found.to_dict())).replace(MODEL, NAME))
    kept = ("verdict", "effects", "sentence", "steps", "candidates", "where", "parameters", "noise", "notes")
    return {
        "command": "python -m docs.seal_study FOLDER -o fits/oring-seal", "seal": ring,
        "records": len(study.bench.bars), "samples": int(np.isfinite(study.bench.measured).sum()),
        "campaign_sha256": study.bench.campaign.sha256, "noise_of_a_sample": describe_noise(study),
        "ladder": [{"effects": list(r.effects), "rms_fitted": r.fitted, "rms_held_out": r.held_out,
                    "other_additions": r.rivals, "unphysical": r.unphysical,
                    "parameters": {k: dict(zip(("estimate", "lowest", "highest", "unit"), v, strict=True))
                                   for k, v in r.parameters.items()}} for r in study.rungs],
        "refused_at_the_end": study.refused, "shares_of_what_is_left": study.shares, "repeated_runs": study.repeats,
        "left_by_position": tabulate_left(study.left).round(3).reset_index().to_dict("list"),
        "discover": {key: found[key] for key in kept},
    }


def tabulate_left(left: pd.DataFrame, width: float = 5.0) -> pd.DataFrame:
    """Mean friction that the model lacks [N] by position [mm] (rows) and pressure (columns), both ways averaged."""
    start = (width * np.floor(left["position"] / width)).astype(int)
    by_way = left.groupby([start, "bar", "way"])["friction"].agg(["mean", "size"])
    both = by_way[by_way["size"] >= 20]["mean"].unstack("way").dropna().mean(axis=1)
    table = both.unstack("bar").dropna()
    return table.rename(columns=lambda bar: f"{bar:g}")


def tell_story(study: Study, ring: str) -> str:
    """The page, in Markdown."""
    first, last = study.rungs[0], study.rungs[-1]
    bars = [f"{b:g}" for b in np.unique(study.bench.bars)]
    names = [rung.effects[-1] if rung.effects else "" for rung in study.rungs]
    steps = [[("+ " if name else "") + WORDS[name], f"`{name or 'PressureThrust'}`", f"{r.fitted['all']:.2f}",
              f"**{r.held_out['all']:.2f}**", *(f"{r.held_out[b]:.2f}" for b in bars)]
             for name, r in zip(names, study.rungs, strict=True)]
    values = [[f"`{name}`", f"{v:.4g} {unit}", f"{low:.4g} … {high:.4g}"]
              for name, (v, low, high, unit) in last.parameters.items()]
    left = tabulate_left(study.left)
    places = [[f"{start:g} … {start + 5:g}", *(f"{v:+.2f}" for v in row)]
              for start, row in zip(left.index, left.to_numpy(), strict=True)]
    noise, level = study.found.noise["tangential_force"], describe_noise(study)
    pressures = [f"{b} bar" for b in bars]
    return wrap_page(PAGE.format(
        ring=ring, bars=", ".join(bars[:-1]) + f" and {bars[-1]}", before=first.held_out["all"],
        after=last.held_out["all"], removed=1 - (last.held_out["all"] / first.held_out["all"]) ** 2,
        steps=format_table(["step", "effect", "all fitted", "left out, all", *pressures], steps),
        values=format_table(["parameter", "fitted", "range when a pressure is left out"], values),
        unphysical=list_unphysical(study), sd=noise["sd"], correlation=noise["correlation"],
        verdict=study.found.verdict, sentence=study.found.sentence.replace(MODEL, NAME), rest=last.fitted["all"],
        times=last.fitted["all"] / level, place=study.shares["place"], stroke=study.shares["stroke"],
        neither=study.shares["rest"], lags=compare_lags(study), repeats=tell_repeats(study),
        places=format_table(["position [mm]", *pressures], places)))


def format_table(head: list[str], rows: list[list[str]]) -> str:
    """A table in Markdown."""
    return "\n".join("| " + " | ".join(row) + " |" for row in [head, ["---"] * len(head), *rows])


def list_unphysical(study: Study) -> str:
    """Which additions were refused for their sign, in words."""
    found = [v for rung in study.rungs for name, v in rung.unphysical.items() if name.startswith("viscous")]
    if not found:
        return "none of the additions had one that mattered."
    return (f"viscous friction wanted {min(found):.0f} N s/m and was refused. It only imitates the load, as speed "
            "falls where pressure rises.")


def compare_lags(study: Study) -> str:
    """Presliding by two ways of weighing the samples, in words."""
    names = ("seal-lag.s_0", "seal-lag.a", "adhesive-offset.f_a", "seal-lag.b", "seal-load.mu")
    last, other = study.rungs[-1].parameters, study.found.steps[-1].parameters
    if any(n not in last or n not in other for n in names):
        return "It was not found by both ways of weighing the samples."
    s, t = [last[n][0] for n in names], [other[n].estimate for n in names]
    return (f"Its length is {s[0] * 1e3:.2f} mm where every sample counts the same, and {t[0] * 1e3:.2f} mm where "
            "`discover` allows for correlated noise. What is missing at the turn, a and b, is "
            f"{s[1] / s[2]:.2f} and {s[3] / s[4]:.2f} times the two parts of the friction (`discover`: "
            f"{t[1] / t[2]:.2f} and {t[3] / t[4]:.2f}): 1 is friction that builds up from nothing, 2 one that starts "
            "from the other direction's.")


def tell_repeats(study: Study) -> str:
    """What the repeated runs say, in words; empty without them."""
    if not study.repeats:
        return ""
    kinds = ("model", "first", "thrust", "friction", "nearest")
    rows = [[name, *(f"{found[kind]:.2f}" for kind in kinds)] for name, found in study.repeats.items()]
    low, high = (end(found["model"] for found in study.repeats.values()) for end in (min, max))
    first, thrust, friction = (rms([found[kind] for found in study.repeats.values()]) for kind in kinds[1:4])
    table = format_table(["run", "model, nothing refitted [N]", "first run [N]", "of it thrust", "of it friction",
                          "nearest other run [N]"], rows)
    return REPEATS.format(low=low, high=high, first=first, thrust=thrust, friction=friction, table=table)


def wrap_page(text: str) -> str:
    """Wrap paragraphs and list entries at 116 characters; tables, code, headings and pictures stay as they are."""
    blocks = []
    for block in text.strip().split("\n\n"):
        if block.startswith(("|", "    ", "#", "!")):
            blocks.append(block)
            continue
        mark = next((m for m in ("- ", "> ") if block.startswith(m)), "")
        entries = block.removeprefix(mark).split("\n" + mark) if mark else [block]
        hang = mark if mark == "> " else " " * len(mark)
        blocks.append("\n".join(textwrap.fill(" ".join(e.split()), 116, initial_indent=mark, subsequent_indent=hang,
                                              break_long_words=False, break_on_hyphens=False) for e in entries))
    return "\n\n".join(blocks) + "\n"


PAGE = """# Real rubber: friction of a seal in a pneumatic cylinder

    python -m docs.seal_study FOLDER -o fits/oring-seal

FOLDER is `oring_seal_friction`: friction files of
[3D-printed-pneumatic-actuator](https://github.com/EvaZillen/3D-printed-pneumatic-actuator) (Zillen, Vallery, Smit;
TU Delft; CC0), which are not copied here. A rod with the seal {ring} is pushed into a 25.7 mm bore and drawn out
again, ten times at each of {bars} bar. The model starts as force = pressure × area. `docs/seal.py` holds it, and the
effects that the catalogue lacks. The command writes this page, `result.json` and the pictures.

## What the loop added

Error: root mean square of measured less modelled force, in newton. Left out: the model is fitted to the other
pressures and predicts this one, with nothing adjusted. Each step adds the effect that predicts left-out pressures
best.

{steps}

On pressures that the fit had not seen the error falls from {before:.2f} N to {after:.2f} N: {removed:.1%} of its mean
square is gone.

![Error by step](errors.png)

{values}

The range is the honest uncertainty here; a formal one would take the model for true. `adhesive-offset.f_a` is Coulomb
friction of the ring as it was squeezed in, `seal-load.mu` what the gas adds to it, as a share of the thrust.
Amplitudes of the wrong sign do not count: {unphysical}

`discover` on the same campaign, by itself (catalogue and `docs/seal.py`, at most three effects; noise measured along
the trace: {sd:.2f} N, correlated by {correlation:.2f} from sample to sample), says **{verdict}**:

> {sentence}

## What is left unexplained

The last model leaves {rest:.2f} N on pressures that it was fitted to, {times:.0f} times the noise of a sample. It is
not complete, and no test of lack of fit would let it pass. Of the mean square that is left,

- {place:.0%} repeats from stroke to stroke at the same position, direction and pressure;
- {stroke:.0%} is the level of single strokes (running in, drift);
- {neither:.0%} is neither: short waves, stick and slip, noise.

**The part that repeats** is friction that changes along the bore, the more so the higher the pressure. Friction that
the model lacks, in newton, mean of both directions:

{places}

![Force over position, measured and modelled](loops.png)

No effect here explains it: the model knows how far the seal has slid since it turned, and not where in the bore it is.
A bore that is wider towards one end, with a groove near it, would look like this. Its diameter along its length would
tell.

What else these records do not settle:

- **Presliding is only roughly an exponential.** {lags}
- **Speed.** There are two speeds a pressure, one for each direction, and the one going in falls as the pressure rises:
viscous friction cannot be told from friction that grows with pressure, and a Stribeck curve cannot be seen at all.
- **The constant force** makes the two directions agree and is no finding: weight, zero of the force gauge, and a zero
error of the pressure gauge all look like this, and the fitted area moves with it.
{repeats}

## How the records were made

`convert_runs` in `docs/seal_study.py`. The first 15 samples of every run are dropped, as upstream does, and so is the
stroke that they begin, as its turn is not seen. Runs are cut where the rod turns: one record a stroke, with the rod's
position as `slip`. Of 93 to 100 Hz one sample every 0.04 s is kept, the first at the turn, interpolated between its
neighbours; averages would move the turn by a quarter of a millimetre, and blur presliding.

The pressure is not constant: the regulator lets it rise by 0.04 bar while the rod goes in and fall by up to 0.13 bar
while it comes out. Each sample's force is therefore referred to the set pressure by its own gauge reading and the
nominal area, F - (p - p_set) A; the fitted area differs by less than 2 %, so this is good to 0.1 N. `normal_load` is
p_set A.

The stated noise is that of a raw sample: 0.15 N of the force gauge, and the scatter of the pressure gauge (0.002 bar)
times A, 0.11 N. Conditions count as exact: an error of the pressure gauge is common to all strokes, and as a setting
error of each it would swallow friction. `discover` does not see `slip_speed`, or the two directions of a pressure
would be left out one at a time.
"""
REPEATS = """- **The next run.** The same test repeated is not the same. The model of the first run is off by
{low:.1f} to {high:.1f} N on the repeated ones, and so is the first run itself: {first:.1f} N, of which {thrust:.1f} N
are the same in both directions (thrust: a gauge or the alignment) and {friction:.1f} N turn with the motion (friction).
Both are larger than what the model leaves within its run, and leaving pressures out of one run does not show it.

{table}"""


def main(arguments: list[str] | None = None) -> int:
    """Run the study from the command line; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m docs.seal_study", description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="with friction.csv, and repeats.npz")
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder for page, result.json and pictures")
    parser.add_argument("--seal", default="O-ring257", help="which seal of the file (default: %(default)s)")
    parser.add_argument("--campaign", type=Path, help="keep the converted slip campaign in this folder")
    wanted = parser.parse_args(arguments)

    def act() -> None:
        with show_progress("reading the runs") as report:
            study = run_study(wanted.folder, wanted.seal, wanted.campaign, report)
            report("drawing", 0.98)
            write_study(study, wanted.seal, wanted.output)
        steps = " → ".join(f"{r.held_out['all']:.2f}" for r in study.rungs)
        print(f"{study.found.verdict}; error on left-out pressures {steps} N; {wanted.output / 'README.md'}")

    return run_guarded(act, arguments or sys.argv[1:])


def write_study(study: Study, ring: str, folder: Path) -> None:
    """Write `README.md`, `result.json` and two pictures."""
    folder.mkdir(parents=True, exist_ok=True)
    write_json(folder / "result.json", collect_result(study, ring))
    (folder / "README.md").write_text(tell_story(study, ring), encoding="utf-8")
    (folder / "errors.png").write_bytes(render_png(draw_errors(study), 110))
    (folder / "loops.png").write_bytes(render_png(draw_loops(study), 110))


if __name__ == "__main__":
    sys.exit(main())
