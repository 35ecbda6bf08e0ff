"""Run the tests that the test command leaves out: `python -m docs.long_tests -o fits/long-tests --minutes 60`.

They take hours together, so that they run file by file: those that never ran or failed first, then those whose last run
lies furthest back, until the time is over. What has run is written after every file, each test with the commit at which
it ran. Writes `result.json` and `README.md`.
"""

import argparse
import collections
import json
import os
import subprocess
import sys
import tempfile
import time
import xml.etree.ElementTree as ElementTree
from pathlib import Path

from ddetumble.inference.files import list_versions, write_json, write_whole


ROOT = Path(__file__).resolve().parent.parent
OUTCOMES = {"failure": "failed", "error": "error", "skipped": "skipped"}


def find_commit() -> str:
    """The commit of this checkout, with a plus sign where files other than results of fits differ from it."""
    def ask(*words: str) -> str:
        return subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=True).stdout.strip()
    changed = ask("status", "--porcelain", "--untracked-files=no", "--", ".", ":!fits")
    return ask("rev-parse", "--short=10", "HEAD") + ("+" if changed else "")


def count_tests() -> dict[str, int]:
    """How many tests marked `study` each file holds."""
    listed = subprocess.run([sys.executable, "-m", "pytest", "--collect-only", "-q", "-m", "study"],
                            cwd=ROOT, capture_output=True, text=True)
    if listed.returncode != 0:
        sys.exit(listed.stdout + listed.stderr)
    return dict(collections.Counter(line.split("::")[0] for line in listed.stdout.splitlines() if "::" in line))


def run_file(name: str, workers: int, commit: str) -> list[dict]:
    """Outcome, seconds and commit of every test of a file that is marked `study`; what pytest printed of failures."""
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.xml"
        ended = subprocess.run(
            [sys.executable, "-m", "pytest", "-q", "-n", str(workers), "--dist", "load", "-m", "study",
             f"--junitxml={report}", name], cwd=ROOT, capture_output=True, text=True)
        if ended.returncode != 0:
            print(ended.stdout + ended.stderr, flush=True)
        if not report.is_file():
            return []
        return [{"test": f"{name}::{case.get('name')}",
                 "outcome": next((OUTCOMES[part.tag] for part in case if part.tag in OUTCOMES), "passed"),
                 "seconds": round(float(case.get("time", "nan")), 1),
                 "commit": commit, "run": time.strftime("%Y-%m-%d")}
                for case in ElementTree.parse(report).iter("testcase")]


def choose_order(files: dict[str, int], rows: list[dict]) -> list[str]:
    """Files by what is known of them: fewer rows than tests or a failure first, then by the day of the oldest row; of
    equals the one with fewer tests, so that an hour tells of many.
    """
    def rank(name: str) -> tuple[bool, str, int, str]:
        own = [row for row in rows if row["test"].split("::")[0] == name]
        known = len(own) == files[name] and all(row["outcome"] == "passed" for row in own)
        return known, min((row.get("run", "") for row in own), default=""), files[name], name
    return sorted(files, key=rank)


def tell(rows: list[dict], files: dict[str, int], python: str) -> str:
    """The page: how many passed, and a table."""
    passed, all_tests = sum(row["outcome"] == "passed" for row in rows), sum(files.values())
    commits = collections.Counter(row["commit"] for row in rows)
    missing = f"; the other {all_tests - len(rows)} have not run yet" if len(rows) < all_tests else ""
    lines = [f"# {passed} of {len(rows)} long tests passed when they last ran{missing}", "",
             "Tests that the test command leaves out, because they take hours together. Made on two cores by", "",
             "    python -m docs.long_tests -o fits/long-tests --minutes 60", "",
             f"which runs the oldest ones first until the time is over, with Python {python}; the other versions are "
             "in `result.json`. Each test ran at the commit beside it, "
             + ", ".join(f"{count} at {commit}" for commit, count in commits.most_common())
             + ". Seconds hold the compiling of what is not yet in the cache.", "",
             "| test | outcome | seconds | commit |", "| --- | --- | ---: | --- |"]
    return "\n".join([*lines, *(f"| `{r['test']}` | {r['outcome']} | {r['seconds']:.0f} | {r['commit']} |"
                                for r in rows), ""])


def main(arguments: list[str] | None = None) -> int:
    """Run them, write the page after every file, and end with 1 where one failed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder of results, gone on with")
    parser.add_argument("--minutes", type=float, default=600.0, help="after which no further file is begun")
    parser.add_argument("--workers", type=int, default=min(os.cpu_count() or 1, 4), help="processes")
    given = parser.parse_args(arguments)
    begun, kept = time.monotonic(), given.output / "result.json"
    files, commit = count_tests(), find_commit()
    rows = json.loads(kept.read_text(encoding="utf-8"))["tests"] if kept.is_file() else []
    rows = [row for row in rows if row["test"].split("::")[0] in files and "commit" in row]
    versions, wrong = list_versions(), 0
    for name in choose_order(files, rows):
        if time.monotonic() - begun > 60.0 * given.minutes:
            break
        print(f"{name}: {files[name]} tests", flush=True)
        found = run_file(name, given.workers, commit)
        wrong += sum(row["outcome"] != "passed" for row in found) + (len(found) != files[name])
        rows = sorted([*(row for row in rows if row["test"].split("::")[0] != name), *found],
                      key=lambda row: row["test"])
        write_json(kept, {"tests": rows, "versions": versions})
        text = tell(rows, files, versions["python"])
        write_whole(given.output / "README.md", lambda draft, text=text: draft.write_text(text, encoding="utf-8"))
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
