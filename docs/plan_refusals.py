"""Whether a plan that says that nothing can be done is right, and whether the limit that it would have loosened helps.

    python -m docs.plan_refusals -o fits/plan-refusals [--scenarios 24] [--first 0]

Scenarios of `docs.plan_search`, in each of which one limit is tightened until no impact that is worth its while is
found. Asked of each: does another seed, or does one with four times the starts, find an impact after all? Is the limit
that was tightened among those which the page would have looser, and is an impact found at the value that it names, from
every seed? Then the hardest place: with the limit a little tighter than that value the plan has to refuse again, or to
find an impact, in which case the page named more than was needed (it rounds to two digits, towards what is allowed,
which is left out here).
"""

import argparse
import json
import time
from pathlib import Path
from typing import Any

from ddetumble.inference.files import list_versions, write_json
from ddetumble.planning.plan import round_loosely
from ddetumble.planning.scenario import pose_problem
from ddetumble.planning.scenario_file import Scenario
from ddetumble.planning.sequence import Sequence, plan_together

from .plan_search import draw_scenario


# Table, key, what the limit is multiplied by until nothing is found, and whether it is tightest where it is large.
# The arm's speed is not among them: a body that turns strikes an arm at rest as well.
LIMITS = (("limits", "force", 0.3, False), ("limits", "depression", 0.5, False), ("limits", "approach", 3.0, True),
          ("limits", "edge", 2.0, True), ("arm", "cone_degrees", 0.5, False))
SEEDS = (101, 202, 303)  # asked where the scenario's own seed found nothing, and of the value that the page names
MORE = 4  # times the starts, of one more seed
CLOSE = 0.03  # by which the limit is tighter than the page would have it
TURNS = 10  # in which a limit is tightened, before the scenario is given up


def plan(content: dict, seed: int, more: int = 1) -> Sequence:
    """One impact at most."""
    scenario = Scenario.model_validate(content)
    return plan_together(pose_problem(scenario, Path()), 0.0, 1, starts=more * scenario.starts, seed=seed)


def tell_refusal(found: Sequence) -> dict[str, Any] | None:
    """What stands in the way; None where an impact was found."""
    best = found.refused
    return None if best is None else {"missed": best.missed, "allowed": best.allowed, "broken": list(best.broken),
                                      "gain": 1.0 - best.score / best.untouched}


def ask_others(content: dict, number: int) -> list[bool]:
    """Whether an impact is found from each of the other seeds, and from one with more starts."""
    return [bool(plan(content, number + seed).impacts) for seed in SEEDS] + [
        bool(plan(content, number + SEEDS[0], MORE).impacts)]


def study(number: int) -> dict[str, Any]:
    """One scenario: refused, asked again, loosened to what the page names, and tightened a little from there."""
    began = time.perf_counter()
    table, key, factor, above = LIMITS[(number + number // len(LIMITS)) % len(LIMITS)]
    content = draw_scenario(number)
    row: dict[str, Any] = {"scenario": number, "limit": f"{table}.{key}", "given": content[table][key], "refused": None}
    for _ in range(TURNS):
        content[table][key] *= factor
        found = plan(content, number)
        if found.refused is not None:
            break
    else:
        return row
    named = {one.key: round_loosely(one.needed, one.needed > one.given) for one in found.relaxations}
    [needed] = [one.needed for one in found.relaxations if one.key == row["limit"]] or [None]
    row |= {"tightened": content[table][key], "refused": tell_refusal(found), "named": named,
            "needed": needed, "others": ask_others(content, number)}
    if needed is not None:
        content[table][key] = named[row["limit"]]
        row["at named"] = [bool(plan(content, number + seed).impacts) for seed in (0, *SEEDS)]
        content[table][key] = needed * (1.0 + CLOSE if above else 1.0 - CLOSE)
        near = plan(content, number)
        row["tighter"] = {"refused": tell_refusal(near), "others": [] if near.impacts else ask_others(content, number)}
    return row | {"seconds": round(time.perf_counter() - began, 1)}


def list_runs(numbers: list[int]) -> list[tuple[int, int]]:
    """First and count of every run of consecutive numbers."""
    starts = [number for number in numbers if number - 1 not in numbers]
    return [(start, next(k for k in range(1, len(numbers) + 1) if start + k not in numbers)) for start in starts]


def tell(rows: list[dict]) -> str:
    """The page."""
    asked = [row for row in rows if row["refused"]]
    flat = [row for row in asked if not row["refused"]["missed"]]
    wrong = [row["scenario"] for row in flat if any(row["others"])]
    named = [row for row in flat if row["limit"] in row["named"]]
    without = [row["scenario"] for row in flat if row["limit"] not in row["named"]]
    held = sum(sum(row["at named"]) for row in named)
    near = [row for row in named if row["tighter"]["refused"]]
    loose = [row["scenario"] for row in named if not row["tighter"]["refused"]]
    surprised = [row["scenario"] for row in near if not row["tighter"]["refused"]["missed"]
                 and any(row["tighter"]["others"])]
    return "\n".join([
        "# Plans that say that nothing can be done\n", __doc__.split("\n\n", 2)[2],
        "Made by\n", *(f"    python -m docs.plan_refusals -o fits/plan-refusals --first {first} --scenarios {count}\n"
                       for first, count in list_runs([row["scenario"] for row in rows])),
        f"- Refused: {len(asked)} of {len(rows)} scenarios; in {len(asked) - len(flat)} of them the page says that the "
        "search, and not physics, found nothing.",
        f"- Of the other {len(flat)}, scenarios in which another seed or more starts found an impact: "
        f"{len(wrong)} {wrong or ''}".rstrip() + ".",
        f"- The limit that was tightened is named with a value in {len(named)} of {len(flat)}"
        f"{f'; not in {without}' if without else ''}.",
        f"- At the value named an impact was found in {held} of {sum(len(row['at named']) for row in named)} plans, "
        f"from {1 + len(SEEDS)} seeds each.",
        f"- With the limit {100 * CLOSE:.0f} % tighter than needed by the page, {len(near)} of {len(named)} plans "
        f"refused again; an impact was found, so that more was named than needed, in {loose}. Of those that refused "
        "without calling it a failure of the search, another seed or more starts found an impact in "
        f"{len(surprised)} {surprised or ''}".rstrip() + ".\n",
    ])


def main() -> None:
    """Study the refusals and write the page; a folder that holds some of the scenarios already is gone on with."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--scenarios", type=int, default=24)
    parser.add_argument("--first", type=int, default=0)
    asked = parser.parse_args()
    asked.output.mkdir(parents=True, exist_ok=True)
    path = asked.output / "result.json"
    rows = {row["scenario"]: row for row in (json.loads(path.read_text())["scenarios"] if path.exists() else [])}
    for number in range(asked.first, asked.first + asked.scenarios):
        if number in rows:
            continue
        rows[number] = study(number)
        print(json.dumps(rows[number]), flush=True)
        kept = [rows[k] for k in sorted(rows)]
        write_json(path, {"scenarios": kept, "versions": list_versions()})
        (asked.output / "README.md").write_text(tell(kept))


if __name__ == "__main__":
    main()
