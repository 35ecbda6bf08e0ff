"""Does the proposed test tell rivals apart? Confounded campaigns, one proposed test, one drawn at random.

    python docs/next_test.py -o fits/next-test [--cases 40] [--seed 0]

Campaigns with one hidden effect and settings so close together that rivals remain are drawn by the independent
simulator and judged by `discover`. Where at least two models are left with the truth among them, `design` proposes a
test and how often it has to be repeated; the simulator makes one record of it, and that many, and in its place as many
of a test drawn at random within the same limits. Each is added to the campaign, and `discover` judges again: the set is
split where the truth alone is left of it. Where `design` says that nothing within the limits separates the rivals, no
test is made.
Writes `result.json` and `README.md`.
"""

import argparse
import dataclasses as dc
import json
import os
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats


sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from ddetumble.exam.simulators.campaigns import Campaign as SimulatedCampaign  # noqa: E402
from ddetumble.exam.simulators.campaigns import write_package  # noqa: E402
from ddetumble.exam.simulators.impact_campaigns import make_campaign  # noqa: E402
from ddetumble.exam.simulators.slip_campaigns import make_slip_campaign  # noqa: E402
from ddetumble.planning.next_test import design  # noqa: E402
from ddetumble.planning.setting_ranges import Limit  # noqa: E402
from ddetumble.selection.discover import discover  # noqa: E402


HIDDEN = (
    ("impact", "gas-leak", {"lambda": 5.0}), ("impact", "ambient-pressure", {"p_a": 1.0e5}),
    ("impact", "polytropic-gas", {"n": 1.8}), ("impact", "membrane-area", {"alpha": 0.25}),
    ("slip", "adhesive-offset", {"f_a": 0.4}), ("slip", "load-exponent", {"m": 0.08}),
    ("slip", "viscous-friction", {"c_t": 2.0}), ("impact", "inflation-growth", {"beta": 2.0}),
)  # fmt: skip
BASE = {
    "impact": {"effective_mass": 1.4, "restitution": 0.75},
    "slip": {"adhesion_constant": 0.9, "loss_factor": 0.16, "tensile_strength": 10e6, "real_contact_pressure": 20e6,
             "slip_scale": 1.0},
}  # fmt: skip
MOST = 24  # records of a test at most; none was asked for more


def make_case(family: str, effects: dict, seed: int, name: str, settings: tuple | None = None, count: int = 2
              ) -> SimulatedCampaign:
    """A campaign with settings close together, or `count` records at one setting."""
    if family == "impact":
        pressures, speeds = ([1.0e6, 1.1e6], [0.38, 0.42]) if settings is None else ([settings[0]] * 2, [settings[1]])
        return make_campaign(name, seed, effects, BASE[family], pressures, speeds, count, interval=5e-4,
                             noise={"normal_force": 0.5}, length=1.45 if settings is None else 1.6)
    loads, pressures, speeds = ([18.0, 20.0], [1.0e6, 1.1e6], [0.1]) if settings is None else ([x] for x in settings)
    return make_slip_campaign(name, seed, effects, BASE[family], loads, pressures, speeds, count, noise=0.08)


def extend_case(case: SimulatedCampaign, more: SimulatedCampaign, count: int) -> SimulatedCampaign:
    """The campaign with the first `count` records of another one after its own."""
    records = list(case.records)
    for row in more.records[:count]:
        number = {"sequence": len(records) + 1}
        records.append(dc.replace(row, label=f"r{len(records) + 1:02d}", true=row.true | number,
                                  written=row.written | number))
    return dc.replace(case, records=records)


def draw_conditions(limits: tuple[Limit, ...], generator: np.random.Generator) -> dict[str, float]:
    """Conditions at random within the limits: even in the logarithm where they are positive."""
    found = {}
    for limit in limits:
        share = generator.uniform()
        found[limit.name] = (limit.low * (limit.high / limit.low) ** share if limit.logarithmic
                             else limit.low + share * (limit.high - limit.low))
    return found


def confuse(found) -> list[str]:
    """Single effects that a discovery leaves as explanations."""
    return sorted({*found.effects, *(a["effect"] for s in found.steps for a in s.alternatives)})


def judge_case(number: int, seed: int, folder: Path) -> dict:
    """One case; without tests where nothing is confounded or the truth is not among the rivals."""
    family, name, values = HIDDEN[number % len(HIDDEN)]
    effects = {name: values}
    case = make_case(family, effects, 100 * seed + number, f"case-{number:02d}")
    write_package(folder / "campaign", case)
    first = discover(folder / "campaign")
    rivals = confuse(first)
    row: dict[str, Any] = {"case": number, "family": family, "hidden": effects, "verdict": first.verdict,
                           "rivals": rivals}
    if len(first.effects) != 1 or len(rivals) < 2 or name not in rivals:
        return row
    first.save(folder / "discovery")
    found = design(folder / "discovery", channels=())
    best = found.proposals[0]
    row |= {"sentence": found.sentence, "distance": [p.distance for p in best.pairs], "repeats": best.repeats,
            "limits": {x.name: [x.low, x.high] for x in found.limits if x.free}}
    if best.repeats is None:
        return row
    count = min(best.repeats, MOST)
    generator = np.random.default_rng([seed, number])
    names = ("initial_pressure", "approach_speed") if family == "impact" else (
        "normal_load", "internal_pressure", "slip_speed")  # fmt: skip
    for kind, conditions in (("proposed", best.conditions), ("random", draw_conditions(found.limits, generator))):
        settings = tuple(float(conditions[n]) for n in names)
        more = make_case(family, effects, 100 * seed + number + (50 if kind == "random" else 70), "more", settings,
                         count if family == "slip" else (count + 1) // 2)
        row[kind] = {"conditions": dict(zip(names, settings, strict=True))}
        for often, records in {"once": 1, "repeated": count}.items():
            if often == "repeated" and records == 1:
                row[kind][often] = row[kind]["once"]
                continue
            write_package(folder / f"{kind}-{often}", extend_case(case, more, records))
            again = discover(folder / f"{kind}-{often}")
            left = sorted(set(confuse(again)) & set(rivals))
            row[kind][often] = {"records": records, "verdict": again.verdict, "effects": list(again.effects),
                                "left": left, "split": left == [name]}
    return row


def summarise(rows: list[dict], tried: int, seconds: float) -> str:
    """The README of the study."""
    def limit(number):
        low, high = stats.binomtest(number, max(len(done), 1)).proportion_ci(0.9)
        return f"{100 * low:.0f} to {100 * high:.0f} %"

    done = [r for r in rows if "proposed" in r]
    stuck = [r for r in rows if "sentence" in r and "proposed" not in r]
    count = {(kind, often): sum(r[kind][often]["split"] for r in done)
             for kind in ("proposed", "random") for often in ("once", "repeated")}

    def tell(kind, often):
        return f"{count[kind, often]} of {len(done)} ({limit(count[kind, often])})"

    lines = [
        "# The next test",
        "",
        f"`python docs/next_test.py -o fits/next-test --cases {tried}` drew {tried} campaigns with one hidden effect "
        f"and settings close together (chosen so that effects are confounded; the sealed exam's campaigns hardly ever "
        f"are); in {len(done) + len(stuck)} of them `discover` could not tell the truth from its rivals. In "
        f"{len(stuck)} of these `ddetumble design` said that no test within the limits separates them. In the others, "
        "the proposed test, repeated as often as it asked for, left the truth alone in "
        f"{tell('proposed', 'repeated')}, one drawn at random within the same limits, repeated as often, in "
        f"{tell('random', 'repeated')}. A single "
        f"record did so in {tell('proposed', 'once')} and {tell('random', 'once')}. In brackets: 90 % intervals of "
        "Clopper and Pearson.",
        "",
        "| hidden | rivals before | proposed | left by one record | by all | at random | left by one record | by all |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for r in done:
        cells = [next(iter(r["hidden"])), ", ".join(r["rivals"])]
        for kind in ("proposed", "random"):
            at = ", ".join(f"{n} {v:.3g}" for n, v in r[kind]["conditions"].items())
            number = r[kind]["repeated"]["records"]
            cells += [f"{at} ({number} record{'s' if number > 1 else ''})",
                      *(", ".join(r[kind][often]["left"]) or "none" for often in ("once", "repeated"))]
        lines.append("| " + " | ".join(cells) + " |")
    others = [r for r in rows if "sentence" not in r]
    lines += ["", *(f"- {next(iter(r['hidden']))} (rivals: {', '.join(r['rivals'])}): {r['sentence']}" for r in stuck),
              "", "Not counted, as nothing was confounded or the truth was not found: "
              + "; ".join(f"{next(iter(r['hidden']))} ({r['verdict']}: {', '.join(r['rivals']) or 'none'})"
                          for r in others) + "." if others else "", "",
              f"Conditions in SI units. {seconds:.0f} s.", ""]
    return "\n".join(lines)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--cases", type=int, default=40, help="campaigns to draw")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    rows, began = [], time.perf_counter()
    for number in range(options.cases):
        with tempfile.TemporaryDirectory() as folder:
            row = judge_case(number, options.seed, Path(folder))
        rows.append(row)
        left = {k: row[k]["repeated"]["left"] for k in ("proposed", "random") if k in row}
        print(number, row["hidden"], row["rivals"], left, f"{time.perf_counter() - began:.0f} s", flush=True)
        for file, text in (("result.json", json.dumps(rows, indent=1) + "\n"),
                           ("README.md", summarise(rows, number + 1, time.perf_counter() - began))):
            draft = options.output / f"{file}.part"
            draft.write_text(text, encoding="utf-8")
            os.replace(draft, options.output / file)


if __name__ == "__main__":
    main()
