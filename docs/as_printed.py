"""Run what README and the documentation print, in a fresh clone: `python -m docs.as_printed -o fits/as-printed`.

Commands stand in blocks of `sh`, and within sentences where they hold no placeholder; blocks of Python run page by
page. The files of a laboratory that they speak of are made from shipped campaigns. `run.py test` is left to the check
of every change. Writes `result.json` and `README.md`, after every command anew.
"""

import argparse
import json
import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pandas as pd

import ddetumble as dd
from ddetumble.inference.files import list_versions, write_json


ROOT = Path(__file__).resolve().parent.parent
GUIDE = (ROOT / "docs" / "guide.md").read_text(encoding="utf-8")  # lists its pages in the order in which they are read
PAGES = ("README.md", "docs/index.md", *(f"docs/{page}" for page in re.findall(r"\]\((guide/[\w-]+\.md)\)", GUIDE)),
         "docs/gallery.md")
# The check of every change runs it; asks, and has no file here; ends when it is told to.
LEFT_OUT = ("python3 run.py test", "ddetumble trust", "ddetumble workbench")
PLACEHOLDER = re.compile(r"\b(CAMPAIGN|MODEL|DIR|FILE|ID|NAME|OUT|CONDITIONS|ADDRESS|KIND)\b")
LIMIT = 1800.0  # s, of one command


def read_blocks(page: str) -> list[tuple[str, str, int]]:
    """Blocks of a page and commands within its sentences: language, text, and line, in their order."""
    text = (ROOT / page).read_text(encoding="utf-8")
    found = [(m.start(), m[1], m[2]) for m in re.finditer(r"^```(\w+)\n(.*?)^```", text, re.M | re.S)]
    plain = re.sub(r"^```.*?^```", lambda m: " " * len(m[0]), text, flags=re.M | re.S)
    for m in re.finditer(r"`(ddetumble [^`]+)`", plain):
        command = " ".join(m[1].split())
        if not PLACEHOLDER.search(command) and (" -" in command or command.count(" ") > 1):
            found.append((m.start(), "sh", command + "\n"))
    return [(language, block, text.count("\n", 0, at) + 1) for at, language, block in sorted(found)]


def list_commands(block: str) -> list[str]:
    """Commands of a block of `sh`, each with the lines that continue it."""
    return [line.strip() for line in re.sub(r"\\\n\s*", "", block).splitlines() if line.strip()]


def lay_out(clone: Path) -> None:
    """Files that the pages speak of: those of laboratories, from shipped campaigns, and tables from their blocks."""
    for folder, name, columns in (("lab", "impact-c", {"normal_force": "Fz [N]"}),
                                  ("oblique", "oblique-a", {"normal_force": "Fz [N]", "tangential_force": "Fx [N]"})):
        write_lab(clone / folder, dd.read_campaign(name), columns)
    write_strokes(clone, dd.read_campaign("slip-c"))
    sys.path.insert(0, str(ROOT / "tests"))
    from test_own_kind import WALL, write_raw

    write_raw(clone / "drops", WALL)
    write_recordings(clone, dd.read_campaign("impact-b"))
    for language, block, _ in (one for page in PAGES for one in read_blocks(page)):
        first = block.splitlines()[0]
        if language == "csv":
            (clone / ("plan.csv" if "repeats" in first else "conditions.csv")).write_text(block, encoding="utf-8")
        elif language == "toml":
            path = clone / ("lab/import.toml" if first == "# import.toml" else "my-fit/fit.toml")
            path.parent.mkdir(exist_ok=True)
            path.write_text(block, encoding="utf-8")


def write_lab(folder: Path, campaign: dd.Campaign, columns: dict[str, str]) -> None:
    """One text file a record, in the raw time of a gauge, and a table of the settings."""
    folder.mkdir()
    rows = []
    for key in campaign.record_keys:
        trace, row = campaign.trace(key), campaign.records.loc[key]
        raw = pd.DataFrame({"t [ms]": 1e3 * (trace["time"] - trace["time"].iloc[0])})
        for name, heading in columns.items():
            raw[heading] = trace[name].to_numpy()
        raw.to_csv(folder / f"{key}.csv", index=False)
        rows.append({"file": f"{key}.csv", "pressure [MPa]": row["initial_pressure"] / 1e6,
                     "speed [m/s]": row["approach_speed"]}
                    | ({"tangential speed [m/s]": row["tangential_speed"]} if "tangential_speed" in row else {}))
    pd.DataFrame(rows).to_csv(folder / "settings.csv", index=False)


def write_strokes(folder: Path, campaign: dd.Campaign) -> None:
    """Friction over slip, one text file a stroke, and a table of the settings."""
    rows = []
    for k, key in enumerate(campaign.record_keys):
        trace, row = campaign.trace(key), campaign.records.loc[key]
        pd.DataFrame({"slip [mm]": 1e3 * trace["slip"], "F [N]": trace["tangential_force"]}).to_csv(
            folder / f"stroke{k}.csv", index=False)
        rows.append({"file": f"stroke{k}.csv", "load [N]": row["normal_load"],
                     "pressure [MPa]": row["internal_pressure"] / 1e6, "speed [mm/s]": 1e3 * row["slip_speed"]})
    pd.DataFrame(rows).to_csv(folder / "settings.csv", index=False)


def write_recordings(clone: Path, campaign: dd.Campaign) -> None:
    """Recordings of one contact each: TDMS in two folders, a workbook, a bag of ROS, and tables of their settings."""
    from helpers_formats import write_bag, write_sheets, write_tdms

    random, table, sheets = np.random.default_rng(1), [["file", "pressure [MPa]", "speed [m/s]"]], {}
    shots = [["record", "pressure [MPa]", "speed [m/s]"]]
    for k, key in enumerate(campaign.record_keys[:4], 1):
        trace, row = campaign.trace(key), campaign.records.loc[key]
        step = float(np.median(np.diff(trace["time"])))
        force = trace["normal_force"].to_numpy()
        quiet = [0.25 * random.normal(size=int(length / step)) for length in (0.12, 0.3)]
        whole = np.concatenate([quiet[0], force, quiet[1]])
        settings = [float(row["initial_pressure"] / 1e6), float(row["approach_speed"])]
        write_tdms(clone / "lab" / f"run{k}.tdms", {"Bench": {"Fz": ("N", step, -whole)}})
        table.append([f"run{k}.tdms", *settings])
        shots.append([f"bench-shot {k}", *settings])
        sheets[f"shot {k}"] = [["t [s]", "Fz [N]"], *zip((np.arange(len(whole)) * step).tolist(), whole.tolist(),
                                                         strict=True)]
        if k == 1:
            write_tdms(clone / "run1.tdms", {"Bench": {"Fz": ("N", step, whole)}})
            write_bag(clone / "bag", {"Fz": ("N", step, whole)})
    write_sheets(clone / "lab" / "settings.xlsx", {"Table": table})
    write_sheets(clone / "settings.xlsx", {"Table": table[:2]})
    write_sheets(clone / "bench.xlsx", sheets | {"settings": shots})


def run(command: str, clone: Path, prepare: str) -> dict:
    """Run one command in the clone as a shell would: exit status, seconds, and the last lines."""
    begin = time.perf_counter()
    try:
        ended = subprocess.run(["bash", "-c", f"{prepare}\n{command}"], cwd=clone, capture_output=True, text=True,
                               timeout=LIMIT, stdin=subprocess.DEVNULL)
        status, printed = ended.returncode, (ended.stdout + ended.stderr).strip().splitlines()
    except subprocess.TimeoutExpired:
        status, printed = None, [f"not ended after {LIMIT:.0f} s"]
    return {"command": command, "status": status, "seconds": round(time.perf_counter() - begin, 1),
            "last": [] if status == 0 else printed[-6:]}


def tell(rows: list[dict], versions: dict[str, str]) -> str:
    """The page: how many ended well, and a table."""
    right = sum(row["status"] == 0 for row in rows)
    lines = [f"# {right} of {len(rows)} commands that README and the documentation print end well", "",
             "As printed, in a fresh clone with an environment of its own, one after the other, by", "",
             "    python -m docs.as_printed -o fits/as-printed", "",
             f"with Python {versions['python']}; the other versions are in `result.json`. Laboratory files are made "
             "from shipped campaigns. `run.py test` is left to the check of every change.", "",
             "| page | line | command | status | seconds |", "| --- | ---: | --- | --- | ---: |"]
    for row in rows:
        command = row["command"].replace("|", "\\|")
        lines.append(f"| {row['page']} | {row['line']} | `{command}` | {row['status']} | {row['seconds']:.0f} |")
    wrong = [f"- `{row['command']}`: {' / '.join(row['last'])}" for row in rows if row["status"] != 0]
    return "\n".join([*lines, *(["", "Not so:", "", *wrong] if wrong else []), ""])


def main(arguments: list[str] | None = None) -> int:
    """Run all, write the page, and end with 1 where one failed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder of the results")
    parser.add_argument("--keep", type=Path, help="clone here, and keep it; where it is there already, what ended well "
                        "in it before, by the results in the output's folder, is not run again")
    parser.add_argument("--page", choices=PAGES, action="append", help="run only this page, what the other's commands "
                        "made being there; may be repeated")
    parser.add_argument("--only", help="run only commands in which this text stands")
    given = parser.parse_args(arguments)
    clone = given.keep or Path(tempfile.mkdtemp()) / "ddetumble"
    if not clone.exists():
        subprocess.run(["git", "clone", "-q", str(ROOT), str(clone)], check=True)
        lay_out(clone)
    pages, versions, path = given.page or PAGES, list_versions(), given.output / "result.json"
    before = json.loads(path.read_text(encoding="utf-8"))["commands"] if given.keep and path.exists() else []
    done = {(row["page"], row["command"]): row for row in before if row["status"] == 0}
    rows = [row for row in before if row["page"] not in pages]
    given.output.mkdir(parents=True, exist_ok=True)
    activate = "source .venv-3.13/bin/activate" if PAGES[0] not in pages else ""
    for page in pages:
        program = []
        for language, block, line in read_blocks(page):
            if language == "python":
                program.append(block)
            for command in list_commands(block) if language == "sh" else ():
                if command.startswith("source "):
                    # The environment has what the tests need, as after `run.py test`.
                    subprocess.run(["python3", "run.py", "setup"], cwd=clone, check=True, capture_output=True)
                    activate = command
                    continue
                if (page, command) in done:
                    rows.append(done[page, command])
                elif not command.startswith(LEFT_OUT) and (not given.only or given.only in command):
                    rows.append({"page": page, "line": line} | run(command, clone, activate))
                    report(rows, versions, given.output)
        if not program:
            continue
        name = f"blocks_of_{Path(page).stem.lower()}.py"
        (clone / name).write_text("\n\n".join(program), encoding="utf-8")
        if (page, f"python {name}") in done:
            rows.append(done[page, f"python {name}"])
        elif not given.only or given.only in name:
            rows.append({"page": page, "line": 0} | run(f"python {name}", clone, activate))
            report(rows, versions, given.output)
    if given.keep is None:
        shutil.rmtree(clone.parent)
    return int(any(row["status"] != 0 for row in rows))


def report(rows: list[dict], versions: dict[str, str], folder: Path) -> None:
    """Write the results so far, and say how the last command ended."""
    write_json(folder / "result.json", {"commands": rows, "versions": versions})
    (folder / "README.md").write_text(tell(rows, versions), encoding="utf-8")
    last = rows[-1]
    print(f"{last['status']} {last['seconds']:6.1f} s  {last['command']}", flush=True)


if __name__ == "__main__":
    raise SystemExit(main())
