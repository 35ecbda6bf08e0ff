"""From the shell's point of view: first and second `fit`, `compare`, `discover`, `sample` and `plan`, and `--help`.

    python -m benchmarks.startup [CAMPAIGN] [--repeats 3] [-o result.json]

Every run is a process of its own. The first one finds an empty folder for compiled programs, the second one what the
first one of that command left there. Each writes its folder with page and figures; `plan` plans the one impact of the
paper's first case.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.discover import describe_size, locate
from benchmarks.records import ROOT, describe_machine, print_table, summarise, write_result
from ddetumble import read_campaign


SCENARIO = ROOT / "data" / "scenarios" / "paper-case-1.toml"
COMMANDS = ("fit", "compare", "discover", "sample", "plan")


def main(arguments=None):
    """Run all and print a table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.startup", description=__doc__.splitlines()[0])
    parser.add_argument("campaign", metavar="CAMPAIGN", nargs="?", default="impact-a",
                        help="folder, or name of a shipped campaign (default impact-a, 24 records)")
    parser.add_argument("--repeats", metavar="N", type=int, default=3, help="pairs of runs (default 3)")
    parser.add_argument("-o", "--output", metavar="FILE", type=Path, help="also write the result as JSON")
    options = parser.parse_args(arguments)
    if options.repeats < 1:
        parser.error("repeats are 1 or more")
    campaign, machine = locate(options.campaign), describe_machine()
    run(["--help"])  # the operating system has the files at hand from here on
    shown = [run(["--help"]) for _ in range(max(options.repeats, 5))]
    times = {name: {"first": [], "second": []} for name in COMMANDS}
    for k in range(options.repeats):
        for name in COMMANDS:
            print(f"first and second {name}, {k + 1} of {options.repeats} ...", file=sys.stderr, flush=True)
            with tempfile.TemporaryDirectory() as folder:
                what = SCENARIO if name == "plan" else campaign
                command = [name, str(what), "-o", str(Path(folder) / "found"), "--overwrite"]
                for start in times[name]:
                    times[name][start].append(run(command, str(Path(folder) / "cache")))
    result = {"benchmark": "startup", "campaign": describe_size(read_campaign(campaign)), "machine": machine,
              "help": summarise(shown),
              "commands": {name: {start: summarise(one) for start, one in own.items()} for name, own in times.items()}}
    print(f"{result['campaign']}, {machine['cores']} cores")
    print_table(("", "first [s]", "second [s]"), [
        ("--help", "", f"{result['help']['median_s']:.2f}"),
        *((name, *(f"{own[start]['median_s']:.2f}" for start in ("first", "second")))
          for name, own in result["commands"].items())])
    write_result(result, options.output)
    return result


def run(command, cache=None):
    """Wall time of one `ddetumble` process [s]; what it says goes to the screen only where it fails."""
    environment = {name: value for name, value in os.environ.items() if name != "DDETUMBLE_CACHE"}
    environment["PYTHONPATH"] = os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])
    environment["MPLBACKEND"] = "Agg"
    if cache is not None:
        environment["JAX_COMPILATION_CACHE_DIR"] = cache
    began = time.perf_counter()
    done = subprocess.run([sys.executable, "-m", "ddetumble", *command], env=environment, capture_output=True,
                          text=True)  # fmt: skip
    seconds = time.perf_counter() - began
    if done.returncode:
        sys.exit(f"ddetumble {command[0]} failed:\n{done.stderr}")
    return seconds


if __name__ == "__main__":
    main()
