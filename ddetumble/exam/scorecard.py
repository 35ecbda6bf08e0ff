"""The scorecard: what an exam shows, as JSON, as a page, and as README.md beside its figure."""

import dataclasses as dc
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ..figures import draw_power
from ..figures.style import render_png
from ..inference.files import list_versions, write_json
from ..measurement.quantities import format_share
from ..reports.page import Section, Table, draw_picture, write_bytes, write_page
from .cases import Exam
from .rehearsal import Rehearsal
from .scoring import AIMS, SURE_STRENGTH, Row, Share, describe_failure, score


CARD, PAGE, TEXT, FIGURE = "scorecard.json", "report.html", "README.md", "power"
MOST = 400  # failures listed
LOOSE = 10.0  # times its value: an interval so wide says no more than that the records do not determine a parameter
SURE = f"strength {SURE_STRENGTH:g} and more"
SHARES = (  # mark, what it is, and its aim; marks of several names have a row each
    ("undecided", "all cases: undecided", ""),
    ("false_alarms", "false alarms (nothing hidden)", "≤ 5 %"),
    ("false_alarms_by_noise", "– noise {}", "≤ 5 %"),
    ("false_alarms_by_fault", "– fault {}", ""),
    ("nulls_undecided", "nothing hidden: undecided", ""),
    ("singles_first", "single effects: named first", ""),
    ("singles_in_set", "single effects: in the set named", ""),
    ("sure_first", f"{SURE}: named first", ""),
    ("sure_pinned", f"{SURE}: named, or in a set of at most two", "≥ 98 %"),
    ("pairs_named", "pairs: both named or in the sets", ""),
    ("sure_pairs_named", f"pairs, both of {SURE}", "≥ 90 %"),
    ("triples_named", "three effects: all named or in the sets", ""),
    ("outside_explained", "outside the catalogue: called explained", "≤ 5 %"),
    ("outside_unseen", "outside the catalogue: not seen", ""),
    ("coverage", "95 % intervals that hold the truth", "95 %"),
    ("right_by_fault", "right answers of all kinds, fault {}", ""),
    ("reports_by_fault", "a fault of the data reported, fault {}", ""),
)
SIZES = {"heldout_over_noise": "held-out error over noise (noise-free tests elsewhere)", "seconds": "seconds a case",
         "seconds_answering": "seconds of discover", "processor_seconds": "seconds a case of processor time"}
BENCH_HEADER = ("bench", "false alarms (nothing hidden)", "share", "one-sided 95 % limit", "undecided",
                "single effects right", "share", "intervals that hold the truth")
SUMMARY = {"false_alarms": "false alarms", "singles_first": "single effects named first",
           "sure_pinned": f"of {SURE} named or in a set of two", "pairs_named": "pairs named",
           "triples_named": "triples named", "outside_explained": "outside cases called explained"}


def write_scorecard(exam: Exam | Rehearsal, rows: Sequence[Row], folder: Path | str) -> dict[str, Any]:
    """Write `scorecard.json`, `report.html`, `README.md` and, of single effects, `power.png` into a folder.

    Args:
        exam: what was asked.
        rows: of `examine`.
        folder: of the exam.

    Returns:
        What `scorecard.json` holds.
    """
    folder, marks = Path(folder), score(rows)
    failures = [{"case": row["index"], "hidden": {n: row["strengths"][n] for n in row["effects"]}, "kind": row["kind"],
                 "noise": row["noise"], "fault": row["fault"], "bench": row.get("bench", ()),
                 "bench_details": row.get("bench_details", {}), "what": what}
                for row in rows if (what := describe_failure(row))]  # fmt: skip
    command = f"ddetumble exam {exam.options} --cases {max((r['index'] for r in rows), default=-1) + 1} -o DIR"
    sentence = "; ".join([count_cases(marks["undecided"]), *(
        f"{text} {marks[key].count} of {marks[key].total}" for key, text in SUMMARY.items() if marks[key].total)]) + "."
    sections = describe(exam, command, marks, failures)
    if marks["singles_in_set"].total:
        picture = draw_picture(FIGURE, "Single effects by their strength; bars are 95 % limits of Clopper and Pearson, "
                               "the dashed line is the level of the test (1 %), and numbers count the cases.",
                               draw_power, marks["power"])
        sections[0] = dc.replace(sections[0], figures=(picture,))
        write_bytes(folder / f"{FIGURE}.png", render_png(picture.figure, 110))
    write_page(exam.title, sentence, sections, folder, PAGE)
    write_bytes(folder / TEXT, format_markdown(exam.title, sentence, sections).encode())
    content = {"exam": exam.to_dict(), "command": command, "sentence": sentence, **marks, "aims": AIMS,
               "failures": failures, "versions": list_versions()}  # fmt: skip
    write_json(folder / CARD, content)
    return content


def count_cases(undecided: Share) -> str:
    """How many cases there are, and of how many the verdict is open: such a one is no false alarm, and no answer."""
    cases = f"{undecided.total} case{'s' * (undecided.total != 1)}"
    if undecided.count == undecided.total > 0:
        return f"Undecided in {'all ' * (undecided.total > 1)}{cases}"
    return cases + (f", of which {undecided.count} undecided" if undecided.count else "")


def describe(exam: Exam | Rehearsal, command: str, marks: Mapping[str, Any], failures: Sequence[Mapping[str, Any]]
             ) -> list[Section]:
    """Sections of the page: shares with their limits, sizes, every effect, intervals, failures."""
    shares = [(what.format(name), share.count, share.total, format_share(share.share, 1),
               f"{format_share(share.low, 1)} – {format_share(share.high, 1)}", format_share(share.upper, 1), aim)
              for key, what, aim in SHARES
              for name, share in (marks[key] if isinstance(marks[key], dict) else {"": marks[key]}).items()
              if share.total]  # fmt: skip
    sizes = [(what, one["median"], one["q90"], one["largest"]) for key, what in SIZES.items() if (one := marks[key])]
    if marks["set_size"] is not None:
        sizes.insert(0, ("size of the confusion set of single effects, mean", marks["set_size"], "", ""))
    effects = [(name, one["cases"], one["strength"], f"{one['seen'].count}/{one['cases']}",
                f"{one['right'].count}/{one['cases']}") for name, one in marks["by_effect"].items()]
    widths = [(name, one["cases"], one["width"] if one["width"] < LOOSE else "not determined",
               format_share(one["coverage"], 1))
              for name, one in marks["widths"].items()]
    benches = list_benches(marks)
    wrong = [(one["case"], ", ".join(f"{n} ({strength:.2g})" for n, strength in one["hidden"].items()) or "nothing",
              f"AR(1) {one['noise']['rho']:.2f}" if one["noise"]["rho"] else "white", one["fault"] or "none",
              " and ".join(one["bench"]) or "stated", one["what"]) for one in failures[:MOST]]  # fmt: skip
    failed = "None."
    if failures:
        more = f" The first {MOST} are listed." if len(failures) > MOST else ""
        failed = (f"{len(failures)} of {marks['cases']} cases.{more} `ddetumble exam {exam.options} --cases 1 "
                  f"--first {failures[0]['case']} --keep -o again` makes the first of them again, with its campaign, "
                  "the discovery and the truth.")
    plan = exam.list_tests() if isinstance(exam, Rehearsal) else None
    parts = [
        ("Shares", (f"`{command}`", exam.setting),
         ("what", "cases", "of", "share", "95 % interval", "one-sided 95 % limit", "aim"), shares),
        *([("Plan", plan[0], plan[1], plan[2])] if plan else []),
        ("Benches", ("Noise or settings are not as the campaign states. An effect that no test can tell from what the "
                     "bench did, such as a gain where the gauge reads too high, is no false alarm.",),
         BENCH_HEADER, benches if set(marks["by_bench"]) - {"stated"} else []),
        ("Size of the sets, and time", (), ("what", "median", "90 %", "largest"), sizes),
        ("Effects", ("Seen: said to be missing something; right: the verdict that an honest judge could give.",),
         ("hidden", "cases", "median strength", "seen", "right"), effects),
        ("Intervals", ("Of cases that were answered rightly. Width: of the 95 % interval, over the true value, median; "
                       f"a parameter whose width is {LOOSE:g} or more is not determined by such records, though its "
                       "effect may be named.",), ("parameter", "cases", "relative width", "hold the truth"), widths),
        ("Failures", (failed,), ("case", "hidden (strength)", "noise", "fault", "bench", "answer"), wrong),
    ]
    return [Section(title, paragraphs, tables=(Table(header, rows),) if rows else ())
            for title, paragraphs, header, rows in parts if rows or title == "Failures"]


def list_benches(marks: Mapping[str, Any]) -> list[tuple[Any, ...]]:
    """A row for every kind of bench, under `BENCH_HEADER`."""
    found = []
    for name, one in marks["by_bench"].items():
        alarms, undecided, singles, coverage = (
            one[key] for key in ("false_alarms", "undecided", "singles_right", "coverage"))
        share, upper, right, hold = (format_share(value, 1) if one.total else "" for one, value in (
            (alarms, alarms.share), (alarms, alarms.upper), (singles, singles.share), (coverage, coverage.share)))
        found.append((name, f"{alarms.count} of {alarms.total}", share, upper, undecided.count,
                      f"{singles.count} of {singles.total}", right, hold))
    return found


def format_markdown(title: str, sentence: str, sections: Sequence[Section]) -> str:
    """The page as Markdown; figures are PNG files beside it."""
    blocks = [f"# {title}", sentence]
    for section in sections:
        blocks += [f"## {section.title}", *map(str, section.paragraphs)]
        for table in section.tables:
            rows = [table.header, ["---"] * len(table.header), *table.rows]
            blocks.append("\n".join(f"| {' | '.join(map(show_cell, row))} |" for row in rows))
        blocks += [f"![{picture.caption}]({picture.name}.png)" for picture in section.figures]
    return "\n\n".join(blocks) + "\n"


def show_cell(cell: Any) -> str:
    """A cell as text that cannot break its table."""
    text = f"{cell:.4g}" if isinstance(cell, float) else " ".join(str(cell).split())
    return text.replace("\\", "\\\\").replace("|", "\\|").replace("<", "&lt;")
