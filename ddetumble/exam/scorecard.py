"""The scorecard: what an exam shows, as JSON, as a page, and as README.md beside its figure."""

import dataclasses as dc
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ..figures import draw_power
from ..figures.style import render_png
from ..inference.files import list_versions, write_json
from ..reports.page import Picture, Section, Table, write_bytes, write_page
from .cases import Exam
from .scoring import AIMS, SURE_STRENGTH, Row, Share, describe_failure, score


CARD, PAGE, TEXT, FIGURE = "scorecard.json", "report.html", "README.md", "power"
MOST = 400  # failures listed


def write_scorecard(exam: Exam, rows: Sequence[Row], folder: Path | str) -> dict[str, Any]:
    """Write `scorecard.json`, `report.html`, `README.md` and, of single effects, `power.png` into a folder.

    Args:
        exam: what was asked.
        rows: of `examine`.
        folder: of the exam.

    Returns:
        What `scorecard.json` holds.
    """
    folder = Path(folder)
    marks = score(rows)
    sentence, sections = tell(marks), describe(exam, rows, marks)
    content = {"exam": exam, "command": show_command(exam, rows), "sentence": sentence, **expand(marks),
               "aims": AIMS, "failures": list_failures(rows), "versions": list_versions()}  # fmt: skip
    if marks["singles_in_set"].total:
        picture = Picture(FIGURE, "Single effects by their strength; bars are 95 % limits of Clopper and Pearson, the "
                          "dashed line is the level of the test (1 %), and numbers count the cases.",
                          draw_power(marks["power"]), "", draw_power(marks["power"], narrow=True))
        sections[0] = dc.replace(sections[0], figures=(picture,))
        write_bytes(folder / f"{FIGURE}.png", render_png(picture.figure, 110))
    write_page(f"Exam: {exam.family}", sentence, sections, folder, PAGE)
    write_bytes(folder / TEXT, format_markdown(f"Exam of the family {exam.family}", sentence, sections).encode())
    write_json(folder / CARD, content)
    return content


def tell(marks: Mapping[str, Any]) -> str:
    """The scorecard in a sentence or two."""
    parts = [f"{marks['cases']} cases"]
    for text, key in (("false alarms", "false_alarms"), ("single effects named first", "singles_first"),
                      (f"of strength {SURE_STRENGTH:g} and more named or in a set of two", "sure_pinned"),
                      ("pairs named", "pairs_named"), ("outside cases called explained", "outside_explained")):
        share = marks[key]
        if share.total:
            parts.append(f"{text} {share.count} of {share.total}")
    return "; ".join(parts) + "."


def describe(exam: Exam, rows: Sequence[Row], marks: Mapping[str, Any]) -> list[Section]:
    """Sections of the page: shares with their limits, sizes, every effect, failures."""
    shares = [
        ("false alarms (nothing hidden)", marks["false_alarms"], "≤ 5 %"),
        *((f"– noise {name}", share, "≤ 5 %") for name, share in marks["false_alarms_by_noise"].items()),
        *((f"– fault {name}", share, "") for name, share in marks["false_alarms_by_fault"].items()),
        ("single effects: named first", marks["singles_first"], ""),
        ("single effects: in the set named", marks["singles_in_set"], ""),
        (f"strength {SURE_STRENGTH:g} and more: named first", marks["sure_first"], ""),
        (f"strength {SURE_STRENGTH:g} and more: named, or in a set of at most two", marks["sure_pinned"], "≥ 98 %"),
        ("pairs: both named or in the sets", marks["pairs_named"], ""),
        (f"pairs, both of strength {SURE_STRENGTH:g} and more", marks["sure_pairs_named"], "≥ 90 %"),
        ("outside the catalogue: called explained", marks["outside_explained"], "≤ 5 %"),
        ("outside the catalogue: not seen", marks["outside_unseen"], ""),
        ("95 % intervals that hold the truth", marks["coverage"], "95 %"),
        *((f"right answers of all kinds, fault {name}", share, "") for name, share in marks["right_by_fault"].items()),
        *((f"a fault of the data reported, fault {name}", share, "")
          for name, share in marks["reports_by_fault"].items()),
    ]
    header = ("what", "cases", "of", "share", "95 % limits", "95 % upper limit", "aim")
    table = Table(header, [(what, s.count, s.total, *show_share(s), aim) for what, s, aim in shares if s.total])
    parts = [
        Section("Shares", (f"`{show_command(exam, rows)}`", say_setting(exam)), tables=(table,)),
        Section("Sizes", tables=(list_sizes(marks),)),
        Section("Effects", ("Seen: said to be missing something; right: the verdict that an honest judge could give.",),
                tables=(list_effects(marks),)),
        Section("Intervals", ("Of cases that were answered rightly. Width: of the 95 % interval, over the true value, "
                              "median.",), tables=(list_widths(marks),)),
        Section("Failures", say_failures(rows, exam), tables=(list_wrong(rows),)),
    ]  # fmt: skip
    parts = [dc.replace(part, tables=tuple(t for t in part.tables if t.rows)) for part in parts]
    return [part for part in parts if part.tables or part.title == "Failures"]


def say_setting(exam: Exam) -> str:
    """What was drawn, in words."""
    return (f"Drawn from seed {exam.seed}: hidden {', '.join(exam.truths)}; noise {exam.noise}; faults {exam.fault}. "
            "Strength is the rms over noise that a refitted reference model leaves, measured by the simulator that "
            "made the records, which shares no code with the package.")


def list_sizes(marks: Mapping[str, Any]) -> Table:
    """Numbers that are no shares."""
    rows = []
    if marks["set_size"] is not None:
        rows.append(("size of the confusion set of single effects, mean", marks["set_size"], "", ""))
    for text, key in (("held-out error over noise (noise-free tests elsewhere)", "heldout_over_noise"),
                      ("seconds a case", "seconds"), ("seconds of discover", "seconds_answering"),
                      ("seconds a case of processor time", "processor_seconds")):
        one = marks[key]
        if one is not None:
            rows.append((text, one["median"], one["q90"], one["largest"]))
    return Table(("what", "median", "90 %", "largest"), rows)


def list_effects(marks: Mapping[str, Any]) -> Table:
    """Single and outside effects one by one."""
    rows = [(name, one["cases"], one["strength"], f"{one['seen'].count}/{one['cases']}",
             f"{one['right'].count}/{one['cases']}") for name, one in marks["by_effect"].items()]
    return Table(("hidden", "cases", "median strength", "seen", "right"), rows)


def list_widths(marks: Mapping[str, Any]) -> Table:
    """Intervals by parameter."""
    rows = [(name, one["cases"], one["width"], show_percent(one["coverage"]))
            for name, one in marks["widths"].items()]
    return Table(("parameter", "cases", "relative width", "hold the truth"), rows)


def list_failures(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Cases that were not answered rightly."""
    return [{"case": row["index"], "hidden": {n: row["strengths"][n] for n in row["effects"]}, "kind": row["kind"],
             "noise": row["noise"], "fault": row["fault"], "what": what}
            for row in rows if (what := describe_failure(row))]  # fmt: skip


def list_wrong(rows: Sequence[Row]) -> Table:
    """The same as a table."""
    cells = []
    for one in list_failures(rows)[:MOST]:
        hidden = ", ".join(f"{name} ({strength:.2g})" for name, strength in one["hidden"].items()) or "nothing"
        noise = f"AR(1) {one['noise']['rho']:.2f}" if one["noise"]["rho"] else "white"
        cells.append((one["case"], hidden, noise, one["fault"] or "none", one["what"]))
    return Table(("case", "hidden (strength)", "noise", "fault", "answer"), cells)


def say_failures(rows: Sequence[Row], exam: Exam) -> tuple[str, ...]:
    """How many there are, and how one is made again."""
    wrong = list_failures(rows)
    if not wrong:
        return ("None.",)
    more = f" The first {MOST} are listed." if len(wrong) > MOST else ""
    again = show_options(exam) + f" --cases 1 --first {wrong[0]['case']} --keep -o again"
    return (f"{len(wrong)} of {len(rows)} cases.{more} `ddetumble exam {again}` makes the first of them again, with "
            "its campaign, the discovery and the truth.",)


def show_options(exam: Exam) -> str:
    """The command line's options that mean this exam."""
    text = f"--family {exam.family} --seed {exam.seed}"
    if exam.truths != Exam(exam.family).truths:
        text += "".join(f" --truth {kind}" for kind in exam.truths)
    for option, value in (("noise", exam.noise), ("fault", exam.fault)):
        text += f" --{option} {value}" if value != "drawn" else ""
    return text


def show_command(exam: Exam, rows: Sequence[Row]) -> str:
    """The command that makes the whole exam."""
    last = max((row["index"] for row in rows), default=-1)
    return f"ddetumble exam {show_options(exam)} --cases {last + 1} -o DIR"


def show_share(share: Share) -> tuple[str, str, str]:
    """A share, its two limits and its upper limit, in per cent."""
    return (show_percent(share.value), f"{show_percent(share.low)} – {show_percent(share.high)}",
            show_percent(share.upper))


def show_percent(value: float) -> str:
    """A share in per cent."""
    return f"{100 * value:.1f} %"


def expand(value: Any) -> Any:
    """Plain records for JSON, every share with its value."""
    if isinstance(value, Share):
        return dc.asdict(value) | {"share": value.value}
    if isinstance(value, dict):
        return {key: expand(one) for key, one in value.items()}
    return [expand(one) for one in value] if isinstance(value, list) else value


def format_markdown(title: str, sentence: str, sections: Sequence[Section]) -> str:
    """The page as Markdown; figures are PNG files beside it."""
    lines = [f"# {title}", "", sentence, ""]
    for section in sections:
        lines += [f"## {section.title}", ""]
        for paragraph in section.paragraphs:
            lines += [str(paragraph), ""]
        for table in section.tables:
            lines += [*format_table(table), ""]
        for picture in section.figures:
            lines += [f"![{picture.caption}]({picture.name}.png)", ""]
    return "\n".join(lines)


def format_table(table: Table) -> list[str]:
    """A table's lines in Markdown."""
    cells = [[show_cell(cell) for cell in row] for row in [table.header, *table.rows]]
    rule = ["---"] * len(table.header)
    return ["| " + " | ".join(row) + " |" for row in (cells[0], rule, *cells[1:])]


def show_cell(cell: Any) -> str:
    """A cell as text that cannot break its table."""
    text = f"{cell:.4g}" if isinstance(cell, float) else " ".join(str(cell).split())
    return text.replace("\\", "\\\\").replace("|", "\\|").replace("<", "&lt;")
