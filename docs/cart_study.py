"""A cart that strikes soft pads: real force records through the loop, with a plain spring as the model to begin with.

    python -m docs.cart_study FOLDER -o fits/cart-pads

FOLDER holds `force_time.csv` of github.com/cytronicoder/spongebobs-corpse (MIT): columns thickness_mm, run, time_s,
force_raw_N (compression negative, not tared), velocity_m_s. Pads of 28 mm and more are judged with whole thicknesses
left out; the thinnest, which alone is struck through, by itself.
"""

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

from ddetumble import Campaign, InputError, discover
from ddetumble.cli.failures import run_guarded
from ddetumble.cli.progress import show_progress
from ddetumble.figures.fit import draw_fit
from ddetumble.figures.style import render_png
from ddetumble.inference.files import list_versions, write_json
from ddetumble.measurement.campaign import Column, Uncertainty
from ddetumble.selection.discovery import Discovery

from . import pads
from .reading import read_columns


MODEL = f"{Path(pads.__file__).resolve()}:PadSpring"
COLUMNS = ("thickness_mm", "run", "time_s", "force_raw_N", "velocity_m_s")
THIN = 0.01  # m; pads below it are struck through
LEVEL, PEAK = 0.5, 5.0  # N, at which the rise is caught, and what a pulse without a stop reaches
PULSE = 0.25  # s, length of a contact
EARLY = np.arcsin(LEVEL / PEAK) / np.pi * PULSE  # s from touch to that level, on half a sine
ORIGIN = 0.012  # s, how well the touch is known so; of runs at 20 Hz
BEFORE, AFTER = 0.05, 0.40  # s of a record around the touch
APPROACH = (0.4, 0.02)  # s before the touch between which the speed is read
STRAY = 0.1  # m/s off the median, beyond which a reading of the speed is none
GAUGE, SPEED = 0.03, 0.02  # N, m/s: resolution of the gauge, error of the approach speed


def read_runs(folder: Path) -> dict[str, tuple[float, pd.DataFrame]]:
    """Thickness [m] and columns of every run, by the name that its record gets.

    Raises:
        InputError: There is no such file or column, or a number is missing.
    """
    table = read_columns(folder, "force_time.csv", COLUMNS, words=("run",), gaps=("velocity_m_s",))
    return {f"{h:g}mm-{str(run).split()[-1].lower()}": (h * 1e-3, own)
            for (h, run), own in table.groupby(["thickness_mm", "run"], sort=False)}


def convert_runs(runs: dict[str, tuple[float, pd.DataFrame]]) -> Campaign:
    """An impact campaign, one record a run.

    The force is positive in compression, less its median before the touch. The touch is where a line between the
    readings on either side of half a newton crosses that, less the time that half a sine takes to get there. The
    approach speed is that of a line through the speeds before. The uncertainty of the force is the gauge's, and a share
    of the force by which repeats differ: the median over thicknesses.
    """
    records, samples = [], []
    for key, (thickness, run) in runs.items():
        time, force = run["time_s"].to_numpy(), -run["force_raw_N"].to_numpy()
        peak = int(np.argmax(force))
        rest = (time < time[peak] - PULSE) & (time > time[peak] - 4 * PULSE)
        if rest.sum() < 5:
            raise InputError(f"run {key} has fewer than five readings of the force before the touch")
        force = force - np.median(force[rest])
        first = peak - int(np.argmax(force[peak::-1] <= LEVEL))
        share = (LEVEL - force[first]) / (force[first + 1] - force[first])
        touch = time[first] + share * (time[first + 1] - time[first]) - EARLY
        speeds = run[["time_s", "velocity_m_s"]].dropna().to_numpy() - [touch, 0.0]
        speeds = speeds[(speeds[:, 0] > -APPROACH[0]) & (speeds[:, 0] < -APPROACH[1])]
        speeds = speeds[np.abs(speeds[:, 1] - np.median(speeds[:, 1])) < STRAY]
        if len(speeds) < 3:
            raise InputError(f"run {key} has fewer than three readings of the speed before the touch")
        records.append({"record": key, "approach_speed": np.polyfit(*speeds.T, 1)[1], "pad_thickness": thickness})
        kept = (time > touch - BEFORE) & (time < touch + AFTER)
        samples.append(pd.DataFrame({"record": key, "time": time[kept] - touch, "normal_force": force[kept]}))
    table, traces = pd.DataFrame(records).set_index("record"), pd.concat(samples, ignore_index=True)
    differ = float(np.median(list(measure_scatter(table, traces).values())))
    return Campaign(
        name="cart-pads", title="A cart on soft pads", family="impact", path=None, known={},
        records=table,
        conditions={"approach_speed": Column("approach_speed", "m/s", Uncertainty(absolute=SPEED)),
                    "pad_thickness": Column("pad_thickness", "m")},
        independent=Column("time", "s", Uncertainty(absolute=ORIGIN)),
        channels={"normal_force": Column("normal_force", "N", Uncertainty(absolute=GAUGE, relative=differ))},
        samples=traces)


def measure_scatter(records: pd.DataFrame, samples: pd.DataFrame) -> dict[str, float]:
    """By thickness: deviation between repeats over rms force, where this is more than half of its peak."""
    grid, found = np.arange(0.0, PULSE, 5e-3), {}
    for thickness, own in records.groupby("pad_thickness"):
        runs = np.array([np.interp(grid, *samples.loc[samples["record"] == key, ["time", "normal_force"]].to_numpy().T)
                         for key in own.index])
        mean, sd = runs.mean(axis=0), runs.std(axis=0, ddof=1)
        high = mean > 0.5 * mean.max()
        found[f"{1e3 * float(thickness):g} mm"] = float(np.sqrt(np.mean(sd[high] ** 2) / np.mean(mean[high] ** 2)))
    return found


class Part(NamedTuple):
    """One part of the study: its name, what was left out, what `discover` said, how far repeats differ, conditions."""

    name: str
    left_out: str
    found: Discovery
    scatter: dict[str, float]
    conditions: list[dict[str, float]]


def run_study(folder: Path, report: Callable[[str, float], None]) -> list[Part]:
    """The loop on the thick pads and on the thin one."""
    campaign = convert_runs(read_runs(folder))
    thin = campaign.records["pad_thickness"] < THIN
    parts = []
    for name, left_out, own in (("thick pads", "thicknesses", ~thin), ("thin pad", "runs", thin)):
        if not own.any():
            raise InputError(f"there is no run on a {name[:-1] if name.endswith('s') else name}; pads below "
                             f"{THIN * 1e3:g} mm are thin", file=Path(folder) / "force_time.csv")
        begun = 0.5 * len(parts)
        some = campaign.select(list(campaign.records.index[own]))
        found = discover(some, MODEL, effects=pads.EFFECTS,
                         progress=lambda text, share, a=begun, n=name: report(f"{n}: {text}", a + 0.5 * share))
        parts.append(Part(name, left_out, found, measure_scatter(some.records, some.samples),
                          some.records.to_dict("records")))
    return parts


def tell_story(parts: list[Part]) -> str:
    """README of the folder."""
    lines = ["# A cart on soft pads", "", "Made by `python -m docs.cart_study FOLDER -o fits/cart-pads` from "
             "`force_time.csv` of github.com/cytronicoder/spongebobs-corpse (Zeyu Yao, MIT; upstream calls it a "
             "project for education, not for public use). Reference model: a power-law spring without any loss "
             "(`docs/pads.py:PadSpring`); tried beside the catalogue: damping of the foam and a bottom behind the pad "
             "(`docs/pads.py`).", ""]
    for part in parts:
        found, noise = part.found, part.found.noise_nrmse
        runs = found.counts["records"]
        lines += [f"## The {part.name}: {runs} runs, "
                  + (f"{part.left_out} left out" if np.isfinite(found.steps[0].heldout_nrmse) else
                     f"too few conditions to leave {part.left_out} out"), "", f"> {found.sentence}", "",
                  f"| model | error, fitted | error on left-out {part.left_out} | over noise |",
                  "| --- | --- | --- | --- |"]
        for step in found.steps:
            rivals = ", ".join(str(a["effect"]) for a in step.alternatives)
            name = "spring alone" if step.added is None else f"+ {step.added}" + (
                f" (not to be told from {rivals})" if rivals else "")
            lines.append(f"| {name} | {100 * step.nrmse:.1f} % | {show(100 * step.heldout_nrmse, 1, ' %')} | "
                         f"{show(step.heldout_nrmse / noise, 1)} |")
        alone = sorted((c for c in found.candidates if c.explains > 0.01), key=lambda c: -c.explains)[:4]
        lines += ["", "Alone, beside the spring: " + "; ".join(
            f"{c.effect} removes {100 * c.explains:.0f} % of the misfit of the fit, left-out error "
            f"{show(100 * c.heldout_nrmse, 2, ' %')}" for c in alone) + "."]
        lines += ["", *(f"- {name}: {e.estimate:.4g} \u00b1 {e.sd:.2g} {e.unit}".rstrip() for name, e in
                        found.steps[-1].parameters.items()), *tell_onset(part), "",
                  *(["What `discover` notes:", "", *(f"- {note}" for note in found.notes), ""] if found.notes else []),
                  f"![measured and modelled]({part.name.replace(' ', '-')}.png)", ""]
    scatter = ", ".join(f"{100 * x:.0f} % ({name})" for part in parts for name, x in part.scatter.items())
    thick = parts[0].found.steps
    lines += ["## What this does not show", "",
              (f"- With {' and '.join(str(step.added) for step in thick[1:])} the error of the fit falls from "
               f"{100 * thick[0].nrmse:.1f} to {100 * thick[-1].nrmse:.1f} %, on thicknesses left out from "
               f"{100 * thick[0].heldout_nrmse:.2f} to {100 * thick[-1].heldout_nrmse:.2f} %: three thicknesses differ "
               "by more than a law does, and do not settle which one it is.")
              if len(thick) > 1 else "- Nothing was added on the thick pads.",
              "- Only the thinnest pad is struck through: what it meets behind the pad cannot be foretold from the "
              "others, its runs are at too few speeds to leave one out, and one thickness says nothing about how the "
              "onset depends on it.",
              f"- Repeats differ by {scatter} of the force; the median is stated as its uncertainty. No model without "
              "what makes repeats differ comes down to the noise of single readings, over which errors are counted "
              "here.",
              "- The mass is not stated upstream; it is fitted.", ""]
    return "\n".join(lines)


def show(value: float, digits: int, unit: str = "") -> str:
    """A number, or a dash where there is none."""
    return f"{value:.{digits}f}{unit}" if np.isfinite(value) else "–"


def tell_onset(part: Part) -> list[str]:
    """Where a bottom is met on a pad of one thickness; what it is made up of, one thickness does not tell."""
    found = {name.split(".")[-1]: e.estimate for name, e in part.found.steps[-1].parameters.items()
             if name.startswith("pad-bottom.")}
    heights = np.unique([s["pad_thickness"] for s in part.conditions])
    if not found or len(heights) > 1:
        return []
    return [f"- onset of pad-bottom, depth + share h: {1e3 * (found['depth'] + found['share'] * heights[0]):.1f} mm "
            "(of the fitted spring's depression; only this sum is determined)"]


def main(arguments: list[str] | None = None) -> int:
    """Run the study from the command line; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m docs.cart_study", description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="with force_time.csv")
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder for page, result.json and pictures")
    wanted = parser.parse_args(arguments)

    def act() -> None:
        with show_progress("reading the runs") as report:
            parts = run_study(wanted.folder, report)
        wanted.output.mkdir(parents=True, exist_ok=True)
        content = {part.name: {**part.found.to_dict(), "model": "docs/pads.py:PadSpring", "scatter": part.scatter}
                   for part in parts}
        write_json(wanted.output / "result.json", {"parts": content, "versions": list_versions()})
        for part in parts:
            models = {"spring alone": part.found.steps[0].traces, "grown model": part.found.steps[-1].traces}
            (wanted.output / f"{part.name.replace(' ', '-')}.png").write_bytes(
                render_png(draw_fit(models, "normal_force", count=4), 110))
        (wanted.output / "README.md").write_text(tell_story(parts), encoding="utf-8")
        print("; ".join(f"{part.name}: {part.found.verdict}, {' + '.join(part.found.effects) or 'nothing added'}"
                        for part in parts), wanted.output / "README.md", sep="\n")

    return run_guarded(act, arguments or sys.argv[1:])


if __name__ == "__main__":
    sys.exit(main())
