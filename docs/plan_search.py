"""Whether planned sequences depend on the seed, and whether a tighter limit ever gives a better plan.

    python -m docs.plan_search -o fits/plan-search [--seeds 20] [--scenarios 40] [--minutes 600]

Seeds: `paper-case-1` with 76 N and 40 impacts, where one impact takes 8 % and the arm is ten times too fast for it; the
same plan is asked of every seed. Limits: scenarios drawn at random (shapes with equal moments among them), each planned
as it stands and with one limit tightened at a time. The best plan under a tighter limit is allowed under the wider one
as well, so where it is better the search under the wider one has failed. A plan is better that reaches its share in
fewer impacts, or, where neither reaches it, leaves less of the momentum.

What is planned is written at once, every row with the commit of its code. A folder of results is gone on with, until
the time is over: first what is missing, then what was planned at another commit, the oldest first.
"""

import argparse
import collections
import copy
import json
import sys
import time
from pathlib import Path

import numpy as np

from ddetumble import find_data
from ddetumble.inference.files import list_versions, write_json
from ddetumble.planning.scenario import pose_problem
from ddetumble.planning.scenario_file import SCHEMA, Scenario, read_scenario
from ddetumble.planning.sequence import Sequence, plan_together

from .long_tests import find_commit


WORSE = 1e-3  # share of the momentum at the start, by which a plan has to be better to count
SHAPES = ("cylinder", "square box", "box", "cube")  # in turn
TIGHTER = {  # table, key, and the factor of the limit or the part of its range that is kept
    "arm's speed": ("arm", "speed", 0.5), "force": ("limits", "force", 0.7),
    "depression": ("limits", "depression", 0.7), "cone": ("arm", "cone_degrees", 0.7),
    "window": ("limits", "window", (0.0, 0.5)), "pressure": ("limits", "pressure", (0.0, 0.6)),
    "edge": ("limits", "edge", 2.0)}  # fmt: skip


def draw_scenario(number: int) -> dict:
    """A random body, spin and arm, and limits of which each may hold the plan: one impact takes a twelfth to a half.

    Sizes follow from one another: an approach speed, the peak force and depression that it makes on a ball of 1 MPa
    (46 N at 5 mm, growing with the square), and a momentum that so many of such impacts take.
    """
    draw = np.random.default_rng(5000 + number)
    shape = SHAPES[number % len(SHAPES)]
    size = float(np.exp(draw.uniform(np.log(0.3), np.log(2.0))))
    sides = {"square box": [size, size, 2.5 * size], "box": [size, 1.5 * size, 2.5 * size], "cube": [size] * 3}
    body = ({"shape": "cylinder", "radius": 0.5 * size, "length": 2.5 * size} if shape == "cylinder" else
            {"shape": "box", "lengths": sides[shape]})
    weight, mass = 100.0 * size**3 * draw.uniform(0.5, 2.0), draw.uniform(1.0, 10.0)
    inertia = weight * np.array([0.5, 0.5, 0.15] if shape != "cube" else [0.17] * 3) * size**2  # roughly
    speed, restitution = draw.uniform(0.1, 0.6), draw.uniform(0.5, 0.85)
    felt = 1.0 / (1.0 / mass + 1.0 / weight + size**2 / inertia[0])
    stiff = 46.0 / 5e-3**2
    depth = np.cbrt(1.5 * felt * speed**2 / stiff)
    momentum = felt * (1.0 + restitution) * speed * size / draw.uniform(1.0 / 12.0, 0.5)
    spin = draw.normal(size=3)
    rates = spin * momentum / np.linalg.norm(inertia * spin)
    return {
        "schema": SCHEMA, "seed": number,
        "debris": {**body, "mass": float(weight), "attitude": draw.normal(size=4).tolist(),
                   "angular_velocity": rates.tolist()},
        "ball": {"restitution": float(restitution), "friction": float(draw.uniform(0.05, 0.4))},
        "arm": {"mass": float(mass), "speed": float(speed * np.exp(draw.uniform(np.log(0.7), np.log(15.0)))),
                "chaser": draw.normal(size=3).tolist(), "cone_degrees": float(draw.uniform(60.0, 180.0))},
        "limits": {"force": float(stiff * depth**2), "depression": float(depth * draw.uniform(0.8, 2.0)),
                   "edge": 0.02 * size, "approach": 0.01, "window": [0.0, 60.0]},
        "goal": {"impacts": int(draw.integers(1, 5)), "share": 0.05},
    }  # fmt: skip


def tighten(content: dict, name: str) -> dict:
    """The same with one limit tightened."""
    table, key, how = TIGHTER[name]
    found = copy.deepcopy(content)
    value = found[table].get(key, [1.0e6, 2.5e6])
    if isinstance(how, tuple):
        low, high = value
        found[table][key] = [low + how[0] * (high - low), low + how[1] * (high - low)]
    else:
        found[table][key] = value * how
    return found


def plan(scenario: Scenario, here: Path, seed: int) -> dict:
    """What came of it."""
    began = time.perf_counter()
    found: Sequence = plan_together(pose_problem(scenario, here), scenario.goal.share, scenario.goal.impacts,
                                    starts=scenario.starts, seed=seed)
    best = found.refused
    return {"seed": seed, "reached": found.reached, "impacts": len(found.impacts), "bound": found.bound,
            "left": found.shares[-1] if found.impacts else 1.0,
            "refused": None if best is None else {
                "allowed": best.allowed, "score": best.score, "untouched": best.untouched, "estimate": best.estimate},
            "seconds": round(time.perf_counter() - began, 1)}  # fmt: skip


def beats(one: dict, other: dict) -> bool:
    """Whether a plan is better than another."""
    if one["reached"] != other["reached"]:
        return one["reached"]
    if one["reached"]:
        return one["impacts"] < other["impacts"]
    return one["left"] < other["left"] - WORSE


def study_seed(seed: int) -> dict:
    """The 76 N case from one seed."""
    path = find_data() / "scenarios" / "paper-case-1.toml"
    read = read_scenario(path)
    scenario = read.model_copy(update={"limits": read.limits.model_copy(update={"force": 76.0}),
                                       "goal": read.goal.model_copy(update={"impacts": 40})})
    return plan(scenario, path.parent, seed)


def study_limits(number: int) -> dict:
    """A random scenario as drawn, and with every limit tightened in turn."""
    content = draw_scenario(number)
    wide = plan(Scenario.model_validate(content), Path(), number)
    tighter = {name: plan(Scenario.model_validate(tighten(content, name)), Path(), number) for name in TIGHTER}
    return {"scenario": number, "shape": SHAPES[number % len(SHAPES)], "wide": wide, "tighter": tighter,
            "better": [name for name, row in tighter.items() if beats(row, wide)],
            # By how much the best of the tighter ones leaves less, of the momentum at the start.
            "ahead": max(0.0, wide["left"] - min(row["left"] for row in tighter.values()))}  # fmt: skip


def choose_next(rows: dict[int, dict], count: int, commit: str) -> list[int]:
    """Numbers below `count` that have no row of this commit: those without any first, then the oldest."""
    return sorted((number for number in range(count) if number not in rows or rows[number].get("commit") != commit),
                  key=lambda number: (number in rows, rows.get(number, {}).get("run", ""), number))


def tell_commits(rows: list[dict]) -> str:
    """How many rows are of which commit."""
    counted = collections.Counter(row.get("commit", "code before commits were kept") for row in rows)
    return ", ".join(f"{count} at {commit}" for commit, count in counted.most_common())


def tell(seeds: list[dict], limits: list[dict]) -> str:
    """The page."""
    fewest = min(row["impacts"] for row in seeds) if seeds else 0
    close = sum(row["reached"] and row["impacts"] <= fewest + 1 for row in seeds)
    pairs = sum(len(row["tighter"]) for row in limits)
    better = sum(len(row["better"]) for row in limits)
    lines = [
        "# Planned sequences from many seeds, and under tighter limits", "",
        f"    python -m docs.plan_search -o fits/plan-search --seeds {len(seeds)} --scenarios {len(limits)}", "",
        f"- `paper-case-1` with 76 N and up to 40 impacts: {close} of {len(seeds)} seeds reach its share, within one "
        f"impact of the fewest ({fewest}; no plan does with fewer than {seeds[0]['bound'] if seeds else 0}). Planned: "
        f"{tell_commits(seeds)}.",
        f"- {len(limits)} scenarios drawn at random, each with {len(TIGHTER)} limits tightened in turn: in {better} of "
        f"{pairs} pairs the tighter limit gives the better plan (fewer impacts, or, where neither reaches its share, "
        f"{100 * WORSE:g} % of the momentum at the start less). Planned: {tell_commits(limits)}.",
        "- The lead is how much less of the momentum at the start the best plan under a tightened limit leaves, "
        "whether or not both reach the share.",
        "- This is a sample: where it shows no failure of the search, it does not prove that there is none.", "",
        "| scenario | shape | reached | impacts | left | lead | tighter limits that give a better plan |",
        "| --- | --- | --- | --- | --- | --- | --- |"]
    for row in limits:
        told = ", ".join(f"{name} ({row['tighter'][name]['impacts']} impacts, {100 * row['tighter'][name]['left']:.2f} "
                         "%)" for name in row["better"]) or "none"
        wide = row["wide"]
        lines.append(f"| {row['scenario']} | {row['shape']} | {'yes' if wide['reached'] else 'no'} | {wide['impacts']} "
                     f"| {100 * wide['left']:.2f} % | {100 * row['ahead']:.4f} % | {told} |")
    return "\n".join([*lines, ""])


def main(arguments: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--scenarios", type=int, default=40)
    parser.add_argument("--minutes", type=float, default=600.0, help="after which nothing further is begun")
    given = parser.parse_args(arguments)
    begun, kept, commit = time.monotonic(), given.output / "result.json", find_commit()
    given.output.mkdir(parents=True, exist_ok=True)
    before = json.loads(kept.read_text(encoding="utf-8")) if kept.is_file() else {"seeds": [], "limits": []}
    seeds = {row["seed"]: row for row in before["seeds"]}
    limits = {row["scenario"]: row for row in before["limits"]}
    tasks = [(seeds, study_seed, number) for number in choose_next(seeds, given.seeds, commit)]
    tasks += [(limits, study_limits, number) for number in choose_next(limits, given.scenarios, commit)]
    for rows, study, number in tasks:
        if time.monotonic() - begun > 60.0 * given.minutes:
            break
        rows[number] = study(number) | {"commit": commit, "run": time.strftime("%Y-%m-%d %H:%M")}
        print(json.dumps(rows[number]), flush=True)
        ordered = [[table[key] for key in sorted(table)] for table in (seeds, limits)]
        write_json(kept, {"seeds": ordered[0], "limits": ordered[1], "versions": list_versions()})
        (given.output / "README.md").write_text(tell(*ordered), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
