"""One page over the folders of a sealed exam: shares added up by family, and every failure.

    python -m docs.exam_table fits/exam

FOLDER holds one folder an exam, as `ddetumble exam` leaves it (`cases.jsonl` and `scorecard.json`); what is added up
here is counted anew from the cases. A folder's `note.txt`, if it has one, stands on the page: what a reader has to know
of how it was made.
"""

import argparse
import json
import re
import statistics
import sys
import textwrap
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path

from ddetumble.cli.failures import run_guarded
from ddetumble.exam.scorecard import BENCH_HEADER, list_benches
from ddetumble.exam.scoring import (
    SURE_STRENGTH,
    Row,
    count_share,
    describe_failure,
    is_alarm,
    is_false_alarm,
    is_first,
    is_in_set,
    is_pinned,
    is_right,
    pick,
    score,
)
from ddetumble.reports.page import write_bytes


FAMILIES = ("impact", "slip", "oblique", "tumble")
INTRODUCTION = (
    "Every case is simulated by the second implementation (SciPy, not a line shared with the models) and judged from "
    "its files alone; which exams were looked at while the tool was mended is said below. Strength is what a refitted "
    "reference model leaves, over the noise, drawn between a half and eight; the refit is linearised about the truth, "
    "and of strong effects of friction a full one leaves down to a third of that. A quarter of the cases has a fault "
    "of the bench: a clipped gauge, a drop-out, or a record in a wrong range. In brackets: one-sided 95 % limit of "
    "Clopper and Pearson on the side that matters, or the share. Intervals are those of rightly answered cases. "
    "Effects that cannot reach half the noise within their limits (such as inflation-growth and gyro-scale) are not "
    "drawn.")
DRAWN = {  # effects outside the catalogue whose law has a size that the drawn one can be held against
    "x-end-stop": ("depth", "depth", r"\bd(?: 1)? = ([\d.e-]+)"),
    "x-stick-slip": ("wavelength", "wavelength", r"\bl(?: 1)? = ([\d.e-]+)"),
}
# How the sentence about the missing force begins, in answers of every age.
FREE = ("What is missing acts like", "A free force", "A non-parametric force term", "No force ")


def list_counts() -> list[tuple[str, str, Callable[[Sequence[Row]], Sequence[bool]]]]:
    """What is counted: its name, the aim, and the flags among the rows of a family."""
    def of_noise(name):
        return lambda rows: [is_false_alarm(r) for r in pick(rows, "nothing")
                             if bool(r["noise"]["rho"]) == (name == "ar1")]

    def intervals(rows, left_out=()):
        inside = [r for r in rows if r["kind"] != "outside" and is_right(r) and not {*left_out} & {*r.get("bench", ())}]
        return [low <= truth <= high for r in inside for truth, _, low, high in r["intervals"].values()]

    sure = f"strength {SURE_STRENGTH:g} and more"
    return [
        ("false alarms, white noise", "≤ 5 %", of_noise("white")),
        ("false alarms, AR(1) noise", "≤ 5 %", of_noise("ar1")),
        ("one effect: named first", "", lambda rows: [is_first(r) for r in pick(rows, "one")]),
        ("one effect: in the set named", "", lambda rows: [is_in_set(r) for r in pick(rows, "one")]),
        (f"one effect of {sure}: named, or in a set of at most two", "≥ 98 %",
         lambda rows: [is_pinned(r) for r in pick(rows, "one", SURE_STRENGTH)]),
        ("two effects: both named or in the sets", "", lambda rows: [is_right(r) for r in pick(rows, "two")]),
        (f"two effects of {sure}", "≥ 90 %", lambda rows: [is_right(r) for r in pick(rows, "two", SURE_STRENGTH)]),
        ("three effects: all named or in the sets", "", lambda rows: [is_right(r) for r in pick(rows, "three")]),
        ("outside the catalogue: called explained", "≤ 5 %",
         lambda rows: [r["verdict"] == "explained" and not is_right(r) for r in pick(rows, "outside")]),
        ("outside the catalogue: not seen", "", lambda rows: [not is_alarm(r) for r in pick(rows, "outside")]),
        ("95 % intervals that hold the truth", "95 %", intervals),
        ("– of these, where no gauge and no setting is off throughout", "95 %",
         lambda rows: intervals(rows, ("biased-gauge", "biased-setting"))),
    ]  # fmt: skip


def read_rows(folder: Path) -> list[Row]:
    """Cases of an exam in their order."""
    lines = (folder / "cases.jsonl").read_text(encoding="utf-8").splitlines()
    return sorted((json.loads(line) for line in lines if line.strip()), key=lambda row: row["index"])


def tell(folder: Path) -> str:
    """The page."""
    rows: dict[str, list[Row]] = {}
    lines, failures, commands, notes = [], [], [], []
    for place in sorted(p for p in folder.iterdir() if (p / "scorecard.json").is_file()):
        card = json.loads((place / "scorecard.json").read_text(encoding="utf-8"))
        family, own = card["exam"]["family"], read_rows(place)
        rows.setdefault(family, []).extend(own)
        commands.append(f"    {card['command'].replace('DIR', f'{folder.as_posix()}/{place.name}')}")
        note = place / "note.txt"
        notes += [f"- `{place.name}`: {' '.join(note.read_text(encoding='utf-8').split())}"] if note.is_file() else []
        failures += [(place.name, row, what) for row in own if (what := describe_failure(row))]
    families = [f for f in FAMILIES if f in rows]
    lines += ["# The sealed exam of `discover`", "", "Made by", "", *commands,
              f"    python -m docs.exam_table {folder.as_posix()}", "", *textwrap.wrap(INTRODUCTION, 118), "",
              f"| | {' | '.join(families)} | all | aim |", "| --- |" + " --- |" * (len(families) + 2)]
    every = [row for f in families for row in rows[f]]
    for name, aim, find in list_counts():
        cells = [_show(find(part), aim) for part in (*(rows[f] for f in families), every)]
        lines.append(f"| {name} | {' | '.join(cells)} | {aim} |")
    for name, find, digits in (("one effect: mean size of the set named", list_sizes, 2),
                               ("error at other conditions, noise-free, over noise: median", list_errors, 2),
                               ("mean of the largest twentieth of these", worst_errors, 1)):
        cells = [f"{statistics.median(found) if find is list_errors else statistics.mean(found):.{digits}f}"
                 if (found := find(part)) else "" for part in (*(rows[f] for f in families), every)]
        lines.append(f"| {name} | {' | '.join(cells)} | |")
    seconds = [sorted(sum(r["seconds"].values()) for r in rows[f]) for f in families]
    middle = " | ".join(f"{s[len(s) // 2]:.1f}" for s in seconds)
    lines += [f"| seconds a case, median (beside other work) | {middle} | | |", "",
              *(["## How it was made", "", *notes, ""] if notes else []), *show_benches(every),
              *show_power(folder), *show_drawn(folder),
              "## What was not answered rightly", "",
              "| exam | case | hidden (strength) | noise | fault | answer |", "| --- | --- | --- | --- | --- | --- |"]
    for place, row, what in failures:
        hidden = ", ".join(f"{n} ({row['strengths'][n]:.2g})" for n in row["effects"]) or "nothing"
        noise = f"AR(1) {row['noise']['rho']:.2f}" if row["noise"]["rho"] else "white"
        noise += f", {' and '.join(row['bench'])}" if row.get("bench") else ""
        answer = " ".join(what.split()).replace("|", "\\|")
        lines.append(f"| {place} | {row['index']} | {hidden} | {noise} | {row['fault'] or 'none'} | {answer} |")
    return "\n".join(lines) + "\n"


def list_sizes(rows: Sequence[Row]) -> list[int]:
    """Sizes of the sets that hold a single hidden effect."""
    return [len(s) for r in pick(rows, "one") for s in r["sets"] if set(s) & set(r["effects"])]


def list_errors(rows: Sequence[Row]) -> list[float]:
    """Errors of the grown models at other conditions, over the noise, where the verdict says that nothing is missing
    any more.
    """
    return sorted(r["heldout_over_noise"] for r in rows
                  if r["verdict"] == "explained" and r["heldout_over_noise"] is not None)


def worst_errors(rows: Sequence[Row]) -> list[float]:
    """The largest of them, one in twenty."""
    found = list_errors(rows)
    return found[-max(1, len(found) // 20):] if found else []


def show_benches(rows: Sequence[Row]) -> list[str]:
    """Every kind of bench over the families, where there is one whose noise or settings are not as stated."""
    marks = score(rows)
    if set(marks["by_bench"]) <= {"stated"}:
        return []
    lines = [" | ".join(map(str, cells)) for cells in (BENCH_HEADER, ["---"] * len(BENCH_HEADER), *list_benches(marks))]
    return ["## Benches", "", *(f"| {line} |" for line in lines), ""]


def show_power(folder: Path) -> list[str]:
    """Pictures of the power against strength."""
    places = sorted(p.name for p in folder.iterdir() if (p / "power.png").is_file())
    if not places:
        return []
    caption = "share named first or in the set, against the strength of the hidden effect"
    return ["## Power against strength", "", *(f"![{name}: {caption}]({name}/power.png)" for name in places), ""]


def show_drawn(folder: Path) -> list[str]:
    """What the flexible force made of every effect outside the catalogue, and how near its sizes are to the truth."""
    lines, apart, hidden = [], {name: [] for name in DRAWN}, Counter[str]()
    for place in sorted(p for p in folder.iterdir() if (p / "cases.jsonl").is_file()):
        for row in pick(read_rows(place), "outside"):
            name, values = next(iter(row["effects"].items()))
            hidden[name] += 1
            text = next((row["sentence"][at:] for start in FREE if (at := row["sentence"].find(start)) >= 0), "")
            text = text.partition(" Left out as faulty")[0]
            if name in DRAWN and (found := re.search(DRAWN[name][2], text)):
                apart[name].append(abs(float(found.group(1)) / values[DRAWN[name][1]] - 1.0))
            truth = ", ".join(f"{n} {v:.3g}" if isinstance(v, float) else n for n, v in values.items())
            lines.append(f"| {place.name} | {row['index']} | {name}: {truth} | {row['verdict']} | "
                         f"{text.replace('|', chr(92) + '|')} |")
    if not lines:
        return []
    told = [f"The {word} of `{name}` is drawn within {100 * max(apart[name]):.1f} % in {len(apart[name])} of "
            f"{hidden[name]} cases" + ("; in the rest no law was found." if len(apart[name]) < hidden[name] else ".")
            for name, (word, _, _) in DRAWN.items() if apart[name]]
    return ["## What was drawn of forces that no catalogue holds", "", " ".join(told), "",
            "| exam | case | hidden, SI | verdict | what `discover` says of the missing force |",
            "| --- | --- | --- | --- | --- |", *lines, ""]


def _show(flags: Sequence[bool], aim: str) -> str:
    share = count_share(flags)
    if not share.total:
        return ""
    text = f"{share.count} of {share.total}"
    if aim.startswith("≤"):
        return f"{text} (≤ {100 * share.upper:.1f} %)"
    if aim.startswith("≥"):
        return f"{text} (≥ {100 * (1.0 - count_share(not flag for flag in flags).upper):.1f} %)"
    return f"{text} ({100 * share.count / share.total:.0f} %)"


def main(arguments: list[str] | None = None) -> int:
    """Write FOLDER/README.md; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m docs.exam_table", description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="with one folder an exam")
    wanted = parser.parse_args(arguments)

    def act() -> None:
        write_bytes(wanted.folder / "README.md", tell(wanted.folder).encode("utf-8"))
        print(wanted.folder / "README.md")

    return run_guarded(act, arguments or sys.argv[1:])


if __name__ == "__main__":
    sys.exit(main())
