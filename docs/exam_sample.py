"""A fixed sample of the committed exam, sat again with the present code, beside the committed answers.

    python -m docs.exam_sample fits/exam -o fits/exam-sample --cases 150

Every folder of FOLDER gives cases in proportion (those with a truth four times as many as those with nothing hidden),
spread evenly over its own. A case that is in OUTPUT already is not sat again. Verdict, effects and parameters are
compared with the committed row: a parameter has moved where its estimate differs by more than a tenth of its standard
deviation.
"""

import argparse
import dataclasses as dc
import json
import sys
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ddetumble.cli.failures import run_guarded
from ddetumble.exam.cases import Case, Exam
from ddetumble.exam.examination import run_case
from ddetumble.exam.running import run_all
from ddetumble.inference.files import list_versions, write_json
from ddetumble.reports.page import write_bytes


MOVED = 0.1  # standard deviations
WIDTH = 1.959964  # of them in half a 95 % interval


def choose_cases(folder: Path, count: int) -> list[tuple[str, int]]:
    """Names of exams and numbers of cases, about `count` of them, the same ones every time."""
    sizes = {path.parent.name: len(read_rows(path)) for path in sorted(folder.glob("*/cases.jsonl"))}
    weights = {name: size * (1.0 if "nulls" in name else 4.0) for name, size in sizes.items()}
    whole = sum(weights.values())
    chosen = []
    for name, weight in weights.items():
        own = max(round(count * weight / whole), 1)
        chosen += [(name, int(k)) for k in np.unique(np.linspace(0, sizes[name] - 1, own).astype(int))]
    return chosen


def read_rows(path: Path) -> dict[int, dict[str, Any]]:
    """Rows of an exam by the number of the case."""
    rows = (json.loads(line) for line in path.read_text(encoding="utf-8").splitlines())
    return {row["index"]: row for row in rows}


def sit_one(exams: dict[str, Exam], questions: list[tuple[str, dict[str, Any]]], job: int) -> dict[str, Any]:
    """One case of the sample, as its committed row describes it."""
    name, row = questions[job]
    asked = {field.name: row[field.name] for field in dc.fields(Case) if field.name in row}  # others came later
    return run_case(exams[name], Case(**asked)) | {"exam": name}


def compare_rows(old: dict[str, Any], new: dict[str, Any]) -> dict[str, Any]:
    """What differs between two answers to the same case."""
    moved = {}
    for name, (_, estimate, low, high) in old.get("intervals", {}).items():
        if name not in new.get("intervals", {}):
            continue
        now = new["intervals"][name][1]
        sd = max((high - low) / (2.0 * WIDTH), 1e-300)
        if not abs(now - estimate) <= MOVED * sd:
            moved[name] = (now - estimate) / sd
    return {"exam": new["exam"], "index": new["index"], "kind": new["kind"], "truth": sorted(new["effects"]),
            "verdict": [old["verdict"], new["verdict"]], "found": [old.get("found", []), new.get("found", [])],
            "sets": [old.get("sets", []), new.get("sets", [])], "moved": moved, "error": new["error"]}


def write_page(found: list[dict[str, Any]]) -> str:
    """The comparison as Markdown."""
    verdicts = [one for one in found if one["verdict"][0] != one["verdict"][1]]
    effects = [one for one in found if sorted(one["found"][0]) != sorted(one["found"][1]) and one not in verdicts]
    moved = [one for one in found if one["moved"] and one not in verdicts and one not in effects]
    lines = ["# A sample of the exam, sat again", "",
             f"{len(found)} cases of [the committed exam](../exam/README.md) with the code as it is here: "
             f"{len(verdicts)} verdicts differ, {len(effects)} more name other effects, and in {len(moved)} more a "
             f"parameter has moved by more than {MOVED:g} standard deviations.", "",
             "`python -m docs.exam_sample fits/exam -o fits/exam-sample`", ""]
    if verdicts or effects or moved:
        lines += ["| exam | case | hidden | verdict | effects | moved by [sd] |",
                  "| --- | --- | --- | --- | --- | --- |"]
    for one in (*verdicts, *effects, *moved):
        same = one["verdict"][0] == one["verdict"][1]
        names = [", ".join(names) or "none" for names in one["found"]]
        worst = max(one["moved"].values(), key=abs, default=None)
        lines.append(
            f"| {one['exam']} | {one['index']} | {', '.join(one['truth']) or 'nothing'} | "
            f"{one['verdict'][0] if same else ' → '.join(one['verdict'])} | "
            f"{names[0] if names[0] == names[1] else ' → '.join(names)} | "
            f"{'–' if worst is None else f'{worst:+.2f}'} |")
    return "\n".join(lines) + "\n"


def main(arguments=None):
    """Sit the sample and write the page."""
    parser = argparse.ArgumentParser(prog="python -m docs.exam_sample", description=__doc__.splitlines()[0])
    parser.add_argument("folder", metavar="FOLDER", type=Path)
    parser.add_argument("-o", "--output", metavar="OUTPUT", type=Path, required=True)
    parser.add_argument("--cases", type=int, default=150)
    parser.add_argument("--workers", type=int, default=None)
    options = parser.parse_args(arguments)
    cases = choose_cases(options.folder, options.cases)
    exams = {}
    for name in {name for name, _ in cases}:
        asked = json.loads((options.folder / name / "exam.json").read_text(encoding="utf-8"))["exam"]
        exams[name] = Exam(**{**asked, "truths": tuple(asked["truths"])})
    options.output.mkdir(parents=True, exist_ok=True)
    path = options.output / "cases.jsonl"
    done = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()] if path.exists() else []
    have = {(row["exam"], row["index"]) for row in done}
    jobs = [k for k, case in enumerate(cases) if case not in have]
    before = {name: read_rows(options.folder / name / "cases.jsonl") for name in exams}
    questions = [(name, before[name][index]) for name, index in cases]
    for _, row in run_all(partial(sit_one, exams, questions), jobs, options.workers):
        done.append(row)
        with path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(row) + "\n")
        print(f"{len(done)} of {len(cases)}: {row['exam']} {row['index']} {row['verdict']}", file=sys.stderr,
              flush=True)
    order = {case: k for k, case in enumerate(cases)}
    done = sorted((row for row in done if (row["exam"], row["index"]) in order),
                  key=lambda row: order[row["exam"], row["index"]])
    found = [compare_rows(before[row["exam"]][row["index"]], row) for row in done]
    write_json(options.output / "result.json", {"versions": list_versions(), "cases": found})
    write_bytes(options.output / "README.md", write_page(found).encode())
    print(write_page(found))


if __name__ == "__main__":
    sys.exit(run_guarded(main))
