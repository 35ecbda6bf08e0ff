"""Run the tests that take half a minute or more each: `python -m docs.long_tests -o fits/long-tests`.

The test command leaves them out, so that it ends in about half an hour. Writes `result.json` and `README.md`.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ElementTree
from pathlib import Path

from ddetumble.inference.files import list_versions, write_json


ROOT = Path(__file__).resolve().parent.parent
OUTCOMES = {"failure": "failed", "error": "error", "skipped": "skipped"}


def run_tests(workers: int) -> tuple[list[dict], str]:
    """Outcome and seconds of every test marked `study`, and what pytest printed."""
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.xml"
        ended = subprocess.run(
            [sys.executable, "-m", "pytest", "-n", str(workers), "--dist", "load", "-m", "study",
             f"--junitxml={report}"], cwd=ROOT, capture_output=True, text=True)
        if not report.is_file():
            sys.exit(ended.stdout + ended.stderr)
        rows = [{"test": f"{case.get('classname', '').replace('.', '/')}.py::{case.get('name')}",
                 "outcome": next((OUTCOMES[part.tag] for part in case if part.tag in OUTCOMES), "passed"),
                 "seconds": round(float(case.get("time", "nan")), 1)}
                for case in ElementTree.parse(report).iter("testcase")]
    return sorted(rows, key=lambda row: row["test"]), ended.stdout


def tell(rows: list[dict], python: str) -> str:
    """The page: how many passed, and a table."""
    passed = sum(row["outcome"] == "passed" for row in rows)
    lines = [f"# {passed} of {len(rows)} long tests pass", "",
             "Tests of half a minute or more, which the test command leaves out. Made on two cores by", "",
             "    python -m docs.long_tests -o fits/long-tests", "",
             f"with Python {python}; the other versions are in `result.json`. Seconds hold the compiling of what "
             "is not yet in the cache.", "",
             "| test | outcome | seconds |", "| --- | --- | ---: |"]
    return "\n".join([*lines, *(f"| `{r['test']}` | {r['outcome']} | {r['seconds']:.0f} |" for r in rows), ""])


def main(arguments: list[str] | None = None) -> int:
    """Run them, write the page, and end with 1 where one failed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder of the results")
    parser.add_argument("--workers", type=int, default=min(os.cpu_count() or 1, 4), help="processes")
    given = parser.parse_args(arguments)
    rows, printed = run_tests(given.workers)
    versions = list_versions()
    given.output.mkdir(parents=True, exist_ok=True)
    write_json(given.output / "result.json", {"tests": rows, "versions": versions})
    (given.output / "README.md").write_text(tell(rows, versions["python"]), encoding="utf-8")
    wrong = [row for row in rows if row["outcome"] != "passed"]
    print(printed if wrong else f"{len(rows)} tests passed; {given.output / 'README.md'}")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
