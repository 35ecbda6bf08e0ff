"""Plan every shipped scenario: `python -m docs.plan_scenarios -o fits/plans`.

Runs `ddetumble plan` on each file of `data/scenarios` and keeps its `plan.json` and a table of what came of them.
"""

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path

from ddetumble import find_data
from ddetumble.cli import main as run_command
from ddetumble.inference.files import list_versions, write_json


ROOT = Path(__file__).resolve().parent.parent


def plan_all(folder: Path) -> list[dict]:
    """Plan each and keep its result; returns a row each."""
    rows = []
    for path in sorted((find_data() / "scenarios").glob("*.toml")):
        with tempfile.TemporaryDirectory() as place:
            began = time.perf_counter()
            if run_command(["plan", str(path), "-o", place]) != 0:
                raise SystemExit(f"{path.name} could not be planned")
            seconds = time.perf_counter() - began
            # Whatever names a file of this checkout names it from its root on.
            text = (Path(place) / "plan.json").read_text(encoding="utf-8").replace(f"{ROOT.as_posix()}/", "")
        plan = json.loads(text)
        (folder / f"{path.stem}.json").write_text(text, encoding="utf-8")
        rows.append({
            "scenario": path.stem, "sentence": plan["sentence"], "reached": plan["reached"],
            "impacts": len(plan["impacts"]), "bound": plan["fewest_impacts"], "left": plan["share_left"],
            "wanted": plan["wanted_share"], "duration": plan["duration"], "impulse": plan["impulse"],
            **{name: max((one["certificate"][name] for one in plan["impacts"]
                          if one["certificate"]["finding"] in ("optimum", "not an optimum")), default=None)
               for name in ("stationarity", "gradient_error")},
            "seconds": round(seconds, 1)})
    return rows


def tell(rows: list[dict]) -> str:
    """The page."""
    lines = ["# The shipped scenarios, planned", "",
             "Made by `python -m docs.plan_scenarios -o fits/plans`; each `NAME.json` is what `ddetumble plan "
             "data/scenarios/NAME.toml` wrote. Stationarity is the largest share of the gradient that the binding "
             "constraints leave, over all impacts but those that leave next to nothing (where |L| is nought it has no "
             "gradient) and those that no limit holds (where the gradient vanishes); the error is that of the gradient "
             "against differences.", "",
             "| scenario | impacts (at least) | left | wanted | time [s] | impulse [N s] | stationarity | error | "
             "seconds |", "| --- | --- | --- | --- | --- | --- | --- | --- | --- |"]
    for r in rows:
        proof = ("", "") if r["stationarity"] is None else (f"{r['stationarity']:.0e}", f"{r['gradient_error']:.0e}")
        count = f"{r['impacts']}" + ("" if r["bound"] is None else f" ({r['bound']})")
        lines.append(f"| `{r['scenario']}` | {count} | {100 * r['left']:.2f} % | {100 * r['wanted']:g} % | "
                     f"{r['duration']:.1f} | {r['impulse']:.1f} | {proof[0]} | {proof[1]} | {r['seconds']:.0f} |")
    return "\n".join([*lines, "", *(f"- `{r['scenario']}`: {r['sentence']}" for r in rows), ""])


def main(arguments: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, required=True)
    given = parser.parse_args(arguments)
    given.output.mkdir(parents=True, exist_ok=True)
    rows = plan_all(given.output)
    write_json(given.output / "result.json", {"scenarios": rows, "versions": list_versions()})
    (given.output / "README.md").write_text(tell(rows), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
