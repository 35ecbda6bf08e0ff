"""Write the tables of README.md in this folder from the files in `results/`.

    python -m benchmarks.tabulate            writes them
    python -m benchmarks.tabulate --check    says whether they are what the files give
"""

import json
import statistics
import sys
from pathlib import Path

from benchmarks.records import RESULTS


PAGE = Path(__file__).resolve().parent / "README.md"
BEGIN, END = "<!-- results: begin -->", "<!-- results: end -->"


def main(arguments=None):
    """Write or check; the exit status of the command."""
    text = PAGE.read_text(encoding="utf-8")
    head, _, rest = text.partition(BEGIN)
    _, _, tail = rest.partition(END)
    wanted = f"{head}{BEGIN}\n\n{write_tables(read_results())}\n\n{END}{tail}"
    if "--check" in (sys.argv[1:] if arguments is None else arguments):
        print("README.md is what the results give." if text == wanted else "README.md is not what the results give.")
        return int(text != wanted)
    PAGE.write_text(wanted, encoding="utf-8")
    print(wanted.partition(BEGIN)[2].partition(END)[0].strip())
    return 0


def read_results():
    """All results by file name."""
    return [json.loads(path.read_text(encoding="utf-8")) for path in sorted(RESULTS.glob("*.json"))]


def write_tables(results):
    """All tables as Markdown, with the machines they were measured on."""
    parts = []
    compared = [one for one in results if one["benchmark"] == "discover"]
    if compared:
        rows = [compare_row(one) for one in compared]
        header = ("campaign", "records", "samples", "warmed on", "ours [s]", "first run [s]", "peer", "peer [s]",
                  "ratio", "load", "ours found", "peer's first")  # fmt: skip
        parts.append(write_table(header, rows))
    started = [one for one in results if one["benchmark"] == "startup"]
    if started:
        rows = [(one["campaign"], f"`{name}`", *(f"{own[start]['median_s']:.1f}" for start in ("first", "second")))
                for one in started for name, own in one["commands"].items()]
        rows += [(one["campaign"], "`--help`", "", f"{one['help']['median_s']:.2f}") for one in started]
        parts.append(write_table(("campaign", "command", "first start ever [s]", "second [s]"), rows))
    sampled = [one for one in results if one["benchmark"] == "sample"]
    if sampled:
        rows = [(one["campaign"], one["effect"], one["records"], one["free"], f"{one['ours_per_second']:.0f}",
                 f"`{one['peer_file']}`", f"{one['peer']['per_second']:.2f}", f"{one['peer']['ratio']:.0f}",
                 f"{1e3 * time_density(one['ours']):.1f}", f"{1e3 * time_density([one['peer']]):.1f}",
                 f"{one['disagreement']:.1g}", f"{one['machine']['load_at_start']:.1f}") for one in sampled]
        header = ("campaign", "effect", "records", "parameters", "ours: independent draws a second", "peer", "its",
                  "ratio", "ours: ms a density", "its", "densities differ by", "load")
        parts.append(write_table(header, rows))
    tumbled = [one for one in results if one["benchmark"] == "tumble"]
    if tumbled:
        names = {"many": f"{tumbled[0]['count']} trajectories of 600 s", "one": "one trajectory",
                 "gradient": "a gradient"}
        rows = []
        for one in tumbled:
            for task, text in names.items():
                seconds = [one[which][task]["median_s"] for which in ("ours", "heyoka", "scipy")]
                rows.append((text, *(f"{x:.3g}" for x in seconds), *(f"{x / seconds[0]:.3g}" for x in seconds[1:])))
            errors = (f"{one[which]['error']:.1g}" for which in ("ours", "heyoka", "scipy"))
            rows.append(("error of the worst of 64", *errors, "", ""))
        parts.append(write_table(("", "ours [s]", "heyoka [s]", "SciPy DOP853 [s]", "heyoka over ours",
                                  "SciPy over ours"), rows))
    for one in (one for one in results if one["benchmark"] == "accelerator"):
        rows = [(task, f"{run['default']['median_s']:.2g}", f"{run['processor']['median_s']:.2g}",
                 f"{run['processor']['median_s'] / run['default']['median_s']:.3g}", f"{run['difference']:.0e}")
                for task, run in one["tasks"].items()]
        parts.append(write_table(("", f"{one['device']} [s]", "processor [s]", "ratio", "results differ by"), rows))
    machines = list(dict.fromkeys(say_machine(one["machine"]) for one in results))
    parts += [f"Measured on: {machine}." for machine in machines]
    return "\n\n".join(parts) or "No results yet."


def compare_row(one):
    """One line of the comparison."""
    ours, peer = one["ours"], one.get("peer")
    found = f"{ours['verdict']}{': ' + ', '.join(ours['effects']) if ours['effects'] else ''}"
    return (one["campaign"], one["records"], one["samples"], ", ".join(one["warmed_on"]), f"{ours['median_s']:.2f}",
            f"{ours['runs_s'][0]:.2f}", f"`{peer['name']}`" if peer else "–",
            (f"{peer['median_s']:.1f}" if peer['median_s'] >= 10 else f"{peer['median_s']:.2f}") if peer else "–",
            f"{one['ratio']:.1f}" if peer else "–", f"{one['machine']['load_at_start'] or 0:.1f}", found,
            peer["ranking"][0] if peer else "–")  # fmt: skip


def time_density(runs):
    """Seconds that one density takes, the middle of several runs."""
    return statistics.median(one["seconds"] / one["evaluations"] for one in runs)


def say_machine(machine):
    """A machine in one line."""
    libraries = ", ".join(f"{name} {number}" for name, number in machine["libraries"].items() if number)
    return f"{machine['cores']} cores, {machine['processor']}, Python {machine['python']}, {libraries}"


def write_table(header, rows):
    """A table in Markdown."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(str(cell).replace("|", "\\|") for cell in line) + " |" for line in lines)


if __name__ == "__main__":
    sys.exit(main())
