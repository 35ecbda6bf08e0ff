"""The whole of `discover` beside a program by hand that refits every effect, in one process, in turn.

    python -m benchmarks.discover CAMPAIGN --peer FILE.py [--warm OTHER] [--repeats 3] [-o result.json]

The peer is a file with `main()`, which reads its campaign and its arguments from `sys.argv`, prints `wall ... s` for
its candidate loop, and returns rows (score, effect, chi2/N, ...), best first. That of impacts (Numba and SciPy) ranks,
and neither holds out nor judges; that of friction is `slip_peer.py` in this folder (NumPy and SciPy), which holds out
and goes on to pairs.
"""

import argparse
import contextlib
import importlib.util
import io
import os
import re
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.records import describe_machine, print_table, summarise, write_result


COMPILED = "/jax/core/compile/backend_compile_duration"


def main(arguments=None):
    """Run the comparison and print it."""
    options = read_options(arguments)
    campaign = locate(options.campaign)
    # The peer's compiled code goes to a folder of our own, not beside its file.
    with tempfile.TemporaryDirectory() as folder:
        os.environ.setdefault("NUMBA_CACHE_DIR", folder)
        result = compare(campaign, [find_warm(one) for one in options.warm], options)
    show(result)
    write_result(result, options.output)
    return result


def read_options(arguments):
    """What the command line says."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.discover", description=__doc__.splitlines()[0])
    parser.add_argument("campaign", metavar="CAMPAIGN", help="folder, or name of a shipped campaign")
    parser.add_argument("--peer", metavar="FILE", type=Path, help="the peer; without it, only ours is timed")
    parser.add_argument("--peer-argument", metavar="TEXT", action="append",
                        help="stands behind the campaign on its command line (default --nuisance); may be repeated")
    parser.add_argument("--warm", metavar="OTHER[:RECORDS]", action="append",
                        help="campaign, or its first records, on which ours compiles first (default impact-i, for "
                             "friction slip-c:16); may be repeated")
    parser.add_argument("--repeats", metavar="N", type=int, default=3, help="timed runs of ours (default 3)")
    parser.add_argument("--peer-repeats", metavar="N", type=int, default=1, help="timed runs of the peer (default 1)")
    parser.add_argument("-o", "--output", metavar="FILE", type=Path, help="also write the result as JSON")
    options = parser.parse_args(arguments)
    options.warm = options.warm or ["slip-c:16" if Path(options.campaign).name.startswith("slip") else "impact-i"]
    options.peer_argument = options.peer_argument or ["--nuisance"]
    if options.repeats < 1 or options.peer_repeats < 1:
        parser.error("repeats are 1 or more")
    if options.peer is not None and not options.peer.is_file():
        parser.error(f"there is no file {options.peer}")
    return options


def locate(text):
    """Folder of a campaign: as given, or of the shipped one of that name."""
    from ddetumble import find_data

    for path in (Path(text), find_data() / text):
        if (path / "datapackage.json").is_file():
            return path.resolve()
    sys.exit(f"{text}: there is no such campaign")


def find_warm(text):
    """A campaign to warm on: its folder, or with `:N` behind it its first N records."""
    from ddetumble import read_campaign

    name, _, count = text.partition(":")
    campaign = read_campaign(locate(name))
    return campaign.select(campaign.record_keys[: int(count)]) if count else campaign


def compare(campaign, warm, options):
    """Warm both, then time them in turn.

    Ours warms on other campaigns. The peer has nothing that depends on sizes: its `main` compiles with a first fit
    that its own clock leaves out.
    """
    machine = describe_machine()
    began = time.perf_counter()
    compiled = sum(run_ours(other)["compilations"] for other in warm)
    warming = time.perf_counter() - began
    peer = None if options.peer is None else load_peer(options.peer)
    ours, theirs = [], []
    for who in interleave(options.repeats, options.peer_repeats if peer else 0):
        print(f"running {who} on {campaign.name} ...", file=sys.stderr, flush=True)
        if who == "ours":
            ours.append(run_ours(campaign))
        else:
            theirs.append(run_peer(peer, campaign, options.peer_argument))
    found = ours[-1]
    result = {
        "benchmark": "discover", "campaign": campaign.name, "records": found["records"], "samples": found["samples"],
        "warmed_on": [describe_size(other) for other in warm], "warming_s": round(warming, 3),
        "warming_compilations": compiled, "machine": machine,
        "ours": {
            **summarise([one["seconds"] for one in ours]),
            "compilations": [one["compilations"] for one in ours], "compiling_s": [one["compiling"] for one in ours],
            "verdict": found["verdict"], "effects": found["effects"], "ranking": found["ranking"],
        },
    }  # fmt: skip
    if peer:
        times = [one["seconds"] for one in theirs]
        name = " ".join([options.peer.name, *options.peer_argument])
        result["peer"] = {"name": name, **summarise(times), "ranking": theirs[-1]["ranking"]}
        median = result["peer"]["median_s"]
        result["ratio"] = round(median / result["ours"]["median_s"], 1)
        result["ratio_of_first_run"] = round(median / ours[0]["seconds"], 1)
    return result


def interleave(ours, peer):
    """Who runs when: both spread evenly over the whole time."""
    turns = [((k + 0.5) / ours, "ours") for k in range(ours)] + [((k + 0.5) / peer, "peer") for k in range(peer)]
    return [who for _, who in sorted(turns)]


def run_ours(campaign):
    """The whole of `discover`, reading included; how much of it went into compiling."""
    import jax

    from ddetumble import discover

    spent = []

    def listen(event, duration, **more):
        if event == COMPILED:
            spent.append(duration)

    jax.monitoring.register_event_duration_secs_listener(listen)
    began = time.perf_counter()
    found = discover(campaign)
    seconds = time.perf_counter() - began
    with contextlib.suppress(AttributeError):  # an older JAX keeps its listeners
        jax.monitoring.unregister_event_duration_listener(listen)
    return {
        "seconds": seconds, "compilations": len(spent), "compiling": round(sum(spent), 3), "verdict": found.verdict,
        "effects": list(found.effects), "ranking": [one.effect for one in found.candidates[:3]],
        "records": found.counts["records"], "samples": found.counts["samples"],
    }  # fmt: skip


def describe_size(campaign):
    """Name of a campaign, with its records and the samples of its longest record."""
    longest = int(campaign.samples.groupby("record").size().max())
    return f"{campaign.name} ({len(campaign.records)} records of up to {longest} samples)"


def load_peer(path):
    """The peer as a module."""
    specification = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(specification)
    sys.modules[path.stem] = module
    kept, sys.dont_write_bytecode = sys.dont_write_bytecode, True
    try:
        specification.loader.exec_module(module)
    finally:
        sys.dont_write_bytecode = kept
    return module


def run_peer(module, folder, more):
    """The peer's candidate loop by its own clock, which leaves out reading and compiling."""
    arguments, printed = sys.argv, io.StringIO()
    sys.argv = [module.__file__, str(folder), *more]
    try:
        with contextlib.redirect_stdout(printed):
            began = time.perf_counter()
            rows = module.main()
            whole = time.perf_counter() - began
    finally:
        sys.argv = arguments
    told = re.search(r"wall ([\d.]+) s", printed.getvalue())
    return {"seconds": float(told.group(1)) if told else whole, "ranking": [row[1] for row in rows[:3]]}


def show(result):
    """Print times, ratio, and what each found."""
    print(f"{result['campaign']}: {result['records']} records, {result['samples']} samples; "
          f"ours warmed on {', '.join(result['warmed_on'])} in {result['warming_s']:.1f} s "
          f"({result['warming_compilations']} compilations)")
    rows = []
    for name in ("ours", "peer"):
        if name in result:
            one = result[name]
            runs = " ".join(f"{seconds:.2f}" for seconds in one["runs_s"])
            rows.append((name, f"{one['median_s']:.2f} s", runs, ", ".join(one["ranking"])))
    print_table(("", "median", "runs [s]", "first three"), rows)
    ours = result["ours"]
    print(f"ours: {ours['verdict']}{' by ' + ', '.join(ours['effects']) if ours['effects'] else ''}; compilations in "
          f"the timed runs: {ours['compilations']}, {ours['compiling_s']} s")
    if "ratio" in result:
        print(f"ratio {result['ratio']:.1f} (of the first timed run alone: {result['ratio_of_first_run']:.1f})")


if __name__ == "__main__":
    main()
