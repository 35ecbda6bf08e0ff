"""How often every kind of verdict was right in committed exams: counts that `discover` ships, and their calibration.

    python -m docs.track_record fits/exam fits/exam-benches -o fits/track-record

FOLDERs hold one folder an exam, as `ddetumble exam` leaves it. Writes the counts into the package, and a page with
the reliability of the probabilities that are made of them: every exam is predicted from the others.
"""

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

import ddetumble.selection
from ddetumble.cli.failures import run_guarded
from ddetumble.exam.scorecard import format_markdown
from ddetumble.exam.scoring import Row, count_share, is_right
from ddetumble.inference.files import write_json
from ddetumble.reports.page import Section, Table, write_bytes
from ddetumble.selection.confidence import RECORD, find_confidence


BINS = (0.0, 0.5, 0.8, 0.9, 0.95, 0.98, 1.0)
TITLE = "How often verdicts are right"
HEAD = ("family", "verdict", "noise and settings", "right", "of", "share")


def read_exams(folders: Sequence[Path]) -> dict[str, list[Row]]:
    """Answers by the exam they belong to, each with its family."""
    found: dict[str, list[Row]] = {}
    for path in sorted(path for folder in folders for path in folder.glob("**/cases.jsonl")):
        family = json.loads((path.parent / "scorecard.json").read_text(encoding="utf-8"))["exam"]["family"]
        rows = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
        found[path.parent.as_posix()] = [{**row, "family": family} for row in rows
                                         if row["verdict"] not in ("failed", "refused")]
    return found


def count_verdicts(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Counts by family, verdict, and whether noise or settings were taken otherwise than stated."""
    found: dict[tuple[Any, ...], list[bool]] = {}
    for row in rows:
        found.setdefault((row["family"], row["verdict"], bool(row.get("allowed"))), []).append(is_right(row))
    return [{"family": family, "verdict": verdict, "allowed": allowed, "right": sum(marks), "judged": len(marks)}
            for (family, verdict, allowed), marks in sorted(found.items())]


def predict_exams(exams: dict[str, list[Row]]) -> tuple[np.ndarray, np.ndarray]:
    """Probability of every answer, from the other exams alone, and whether it was right."""
    stated, right = [], []
    for name, rows in exams.items():
        table = count_verdicts([row for other, more in exams.items() if other != name for row in more])
        for row in rows:
            one = find_confidence(row["family"], row["verdict"], bool(row.get("allowed")), table)
            if one is not None:
                stated.append(one.probability)
                right.append(is_right(row))
    return np.array(stated), np.array(right, dtype=bool)


def main(arguments: Sequence[str] | None = None) -> None:
    """Count, write, and say how well the probabilities hold."""
    parser = argparse.ArgumentParser(prog="python -m docs.track_record", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folders", metavar="FOLDER", type=Path, nargs="+")
    parser.add_argument("-o", "--output", metavar="DIR", type=Path, required=True)
    options = parser.parse_args(arguments)
    exams = read_exams(options.folders)
    table = count_verdicts([row for rows in exams.values() for row in rows])
    (package,) = ddetumble.selection.__path__
    write_json(Path(package) / RECORD, {"made_by": "python -m docs.track_record", "verdicts": table})
    stated, right = predict_exams(exams)
    brier, base = float(np.mean((stated - right) ** 2)), float(np.mean((right.mean() - right) ** 2))
    bins = []
    for low, high in zip(BINS, BINS[1:], strict=False):
        own = (stated > low) & (stated <= high)
        if own.any():
            share = count_share(right[own])
            bins.append((f"{low:.2f} to {high:.2f}", int(own.sum()), f"{stated[own].mean():.3f}",
                         f"{share.share:.3f} [{share.low:.3f}, {share.high:.3f}]"))
    rows = [(one["family"], one["verdict"], "not as stated" if one["allowed"] else "as stated", one["right"],
             one["judged"], f"{one['right'] / one['judged']:.3f}") for one in table]
    sentence = (f"Of {len(stated)} verdicts with a stated probability, each from the other exams alone, "
                f"{int(right.sum())} were right; the Brier score is {brier:.4f}, that of their mean rate {base:.4f}.")
    options.output.mkdir(parents=True, exist_ok=True)
    text = format_markdown(TITLE, sentence, [
        Section("Reliability", tables=(Table(("stated", "verdicts", "mean stated", "right, 95 % limits"), bins),)),
        Section("Counts", tables=(Table(HEAD, rows),))])
    write_bytes(options.output / "README.md", text.encode())
    write_json(options.output / "result.json", {
        "exams": {name: len(rows) for name, rows in exams.items()}, "verdicts": table, "brier": brier,
        "brier_of_mean": base, "reliability": [dict(zip(("bin", "verdicts", "stated", "right"), one, strict=True))
                                               for one in bins]})
    print(sentence)


if __name__ == "__main__":
    sys.exit(run_guarded(main))
