"""How often 95 % intervals hold the truth on benches whose noise is not as stated.

    python -m docs.bench_intervals -o fits/bench-intervals [--campaigns 20] [--families slip oblique] [--benches coarse]

Campaigns in which nothing is missing, by the exam's simulators, with white and with correlated noise in even shares,
fitted by `dd.fit`. Benches are those whose noise alone is not as stated: a gauge or a setting that is off, or settings
that scatter more, are judged by `ddetumble exam`, as only `discover` looks for them. A folder that holds some of the
campaigns already is gone on with.
"""

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

import ddetumble as dd
from ddetumble.exam import Exam
from ddetumble.exam.cases import sample_case, write_case
from ddetumble.inference.files import list_versions, write_json


FAMILIES = ("impact", "oblique", "slip", "tumble")
BENCHES = ("stated", "proportional", "bursts", "uneven-records", "tails", "coarse", "wander", "hum")
SEED = 860
EDITIONS = {"impact": 3}  # of the drawing, where it is not the present one: a later one draws other campaigns


def judge(family: str, bench: str, number: int) -> dict[str, Any]:
    """Truth, estimate, standard deviation and ends of the interval of every parameter of one campaign."""
    exam = Exam(family, SEED, ("nothing",), bench=bench, fault="none", edition=EDITIONS.get(family, 0))
    case = sample_case(exam, number)
    with tempfile.TemporaryDirectory() as draft:
        write_case(exam, case, Path(draft) / "campaign")
        fit = dd.fit(Path(draft) / "campaign")
    truth = case.setting["base"]
    return {"family": family, "bench": bench, "number": number, "noise": dict(case.noise),
            "chi2_reduced": fit.chi2_reduced, "converged": fit.converged, "widened": dict(fit.widened),
            "parameters": {n: [truth[n], p.estimate, p.sd, p.q025, p.q975] for n, p in fit.parameters.items()
                           if n in truth}}  # fmt: skip


def count_held(rows: list[dict], wider: bool = True) -> tuple[float, float, int]:
    """Share of intervals that hold the truth, its standard error over campaigns, and how many there are.

    Without `wider` they are as wide as the noise, taken as it was measured, makes them.
    """
    held = []
    for row in rows:
        found = [low <= true <= high if wider else abs(estimate - true) < 1.959964 * sd / row["widened"].get(name, 1.0)
                 for name, (true, estimate, sd, low, high) in row["parameters"].items()]
        held.append((sum(found), len(found)))
    hits, counts = np.array(held, dtype=float).T
    share = hits.sum() / counts.sum()
    # Parameters of one campaign miss together: the error is that of a ratio of sums over campaigns.
    error = np.sqrt(np.sum((hits - share * counts) ** 2) * len(rows) / max(len(rows) - 1, 1)) / counts.sum()
    return float(share), float(error), int(counts.sum())


def tell(rows: list[dict]) -> str:
    """The page."""
    def line(name, some):
        (share, error, count), (narrow, _, _) = count_held(some), count_held(some, wider=False)
        return (f"| {name} | {len(some)} | {count} | {100 * share:.1f} ± {100 * error:.1f} % | {100 * narrow:.1f} % | "
                f"{sum(bool(row['widened']) for row in some)} |")

    def share(family, bench):
        some = [row for row in rows if (row["family"], row["bench"]) == (family, bench)]
        return f"{100 * count_held(some)[0]:.0f} %" if some else "–"

    count = len({row["number"] for row in rows})
    families, benches = ([name for name in names if any(row[key] == name for row in rows)]
                         for key, names in (("family", FAMILIES), ("bench", BENCHES)))
    head = ["| | campaigns | intervals | hold the truth | of the noise as measured | campaigns widened |",
            "| --- | --- | --- | --- | --- | --- |"]
    return "\n".join([
        "# Intervals on benches whose noise is not as stated", "",
        f"    python -m docs.bench_intervals -o fits/bench-intervals --campaigns {count}", "",
        "- Campaigns in which nothing is missing, by the exam's simulators, with correlated noise at even odds, fitted "
        f"by `dd.fit`; seed {SEED}. ± is one standard error over campaigns.",
        "- Of the noise as measured: the same intervals, as wide as they would be were the noise known to be that.",
        "- Benches of one family disturb the same campaigns, so that rows are not independent of one another.",
        "- Campaigns of tumbling have three to eight records, whose scatter tells too little: where a gyroscope's zero "
        "wanders, `fit` takes its walk as part of the noise.", "",
        *head, line("all", rows), *(line(name, [r for r in rows if r["bench"] == name]) for name in benches), "",
        *head, *(line(f"{family}, {name} noise", [r for r in rows if r["family"] == family
                                                and bool(r["noise"]["rho"]) == (name == "correlated")])
                 for family in families for name in ("white", "correlated")), "",
        f"| hold the truth | {' | '.join(families)} |", f"| --- |{' --- |' * len(families)}",
        *(f"| {bench} | {' | '.join(share(family, bench) for family in families)} |" for bench in benches), ""])


def main(arguments: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--campaigns", type=int, default=20, help="of each family and bench")
    parser.add_argument("--families", nargs="+", choices=FAMILIES, default=FAMILIES)
    parser.add_argument("--benches", nargs="+", choices=BENCHES, default=BENCHES)
    given = parser.parse_args(arguments)
    given.output.mkdir(parents=True, exist_ok=True)
    path = given.output / "result.json"
    rows = json.loads(path.read_text(encoding="utf-8"))["rows"] if path.exists() else []
    done = {(row["family"], row["bench"], row["number"]) for row in rows}
    for number in range(given.campaigns):
        for bench in given.benches:
            for family in given.families:
                if (family, bench, number) in done:
                    continue
                began = time.perf_counter()
                rows.append(judge(family, bench, number))
                print(f"{family} {bench} {number}: {time.perf_counter() - began:.1f} s", flush=True)
                write_json(path, {"rows": rows, "versions": list_versions()})
    (given.output / "README.md").write_text(tell(rows), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
