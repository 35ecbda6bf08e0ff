"""How `discover` and `predict` do on campaigns whose answers are known.

    python -m benchmarks.practice CAMPAIGNS ANSWERS.json [-o result.json]

CAMPAIGNS is a folder of campaign folders; ANSWERS.json holds, by campaign name, `effects` and `base` (the truth) and
`heldout`: noise-free records at other conditions. Prints, for each: the verdict, the effects found, how many 95 %
intervals hold the truth, their median width over that of a fit which is told the effects, and the rms error of the
prediction at the other conditions over the noise, of the grown model and of the reference model alone.
"""

import argparse
import json
import sys
import tempfile
from pathlib import Path

import numpy as np
import pandas as pd

from benchmarks.records import describe_machine, print_table, write_result


RATES = ("angular_velocity_x", "angular_velocity_y", "angular_velocity_z")
FAMILIES = {"impact": (("normal_force",), "time"), "slip": (("tangential_force",), "slip"), "tumble": (RATES, "time")}


def main(arguments=None):
    """Run all and print a table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.practice", description=__doc__.splitlines()[0])
    parser.add_argument("campaigns", metavar="CAMPAIGNS", type=Path)
    parser.add_argument("answers", metavar="ANSWERS.json", type=Path)
    parser.add_argument("-o", "--output", metavar="FILE", type=Path)
    options = parser.parse_args(arguments)
    content = json.loads(options.answers.read_text(encoding="utf-8"))
    answers = {k: v for k, v in content.get("campaigns", content).items() if v.get("family") in FAMILIES}
    rows = []
    for name, truth in answers.items():
        rows.append(judge(options.campaigns / name, truth))
        print(json.dumps(rows[-1]), file=sys.stderr, flush=True)
    result = {"benchmark": "practice", "machine": describe_machine(), "campaigns": rows}
    headings = ("campaign", "truth", "verdict", "found", "confused with", "inside 95 %", "width", "predicts",
                "reference")  # fmt: skip
    print_table(headings, [
        (r["campaign"], " + ".join(r["truth"]) or "-", r["verdict"], " + ".join(r["found"]) or "-",
         ", ".join(r["confused_with"]) or "-", f"{sum(r['inside'].values())} of {len(r['inside'])}",
         "-" if r["width"] is None else f"{r['width']:.2f}", f"{r['prediction']:.2f}", f"{r['reference']:.2f}")
        for r in rows])
    write_result(result, options.output)
    return result


def judge(folder, truth):
    """One campaign."""
    from ddetumble import discover, fit, predict, read_campaign

    found = discover(folder)
    main, abscissa = FAMILIES[truth["family"]]
    noise = read_campaign(folder).channels[main[0]].uncertainty.sd(np.ones(1))[0]
    true = truth["base"] | name_parameters(truth["effects"])
    last = found.steps[-1].parameters
    settings = []
    for k, one in enumerate(truth["heldout"]):
        chosen = dict(one["conditions"])
        chosen |= {f"{rate}0": value for rate, value in zip(RATES, chosen.pop("w0", ()), strict=False)}
        settings.append(pd.DataFrame({"record": f"h{k}", **chosen, abscissa: one["x"]}))
    conditions = pd.concat(settings, ignore_index=True)
    wanted = np.concatenate([channels(one["y"], len(main)) for one in truth["heldout"]])
    with tempfile.TemporaryDirectory() as place:
        found.save(Path(place) / "grown")
        grown = predict(Path(place) / "grown", conditions)[list(main)].to_numpy()
        fit(folder).save(Path(place) / "reference")
        width = compare_widths(last, fit(folder, effects=list(truth["effects"]))) if inside_catalogue(truth) else None
        alone = predict(Path(place) / "reference", conditions)[list(main)].to_numpy()
    return {
        "campaign": folder.name, "truth": list(truth["effects"]), "verdict": found.verdict,
        "found": list(found.effects), "sentence": found.sentence,
        "confused_with": sorted({a["effect"] for s in found.steps for a in s.alternatives}),
        "inside": {n: bool(e.q025 <= true[n] <= e.q975) for n, e in last.items() if n in true},
        "width": width, "where": [[w.variable, *w.range] for w in found.where],
        "prediction": round(float(np.sqrt(np.mean((grown - wanted) ** 2)) / noise), 3),
        "reference": round(float(np.sqrt(np.mean((alone - wanted) ** 2)) / noise), 3),
        "seconds": found.counts["seconds"],
    }


def inside_catalogue(truth):
    """Whether every hidden effect is one that a fit can be told."""
    return not any(name.startswith("x-") for name in truth["effects"])


def compare_widths(found, told):
    """Median width of the 95 % intervals over those of a fit that is told the effects."""
    known = told.parameters
    ratios = [(e.q975 - e.q025) / (known[n].q975 - known[n].q025) for n, e in found.items() if n in known]
    return round(float(np.median(ratios)), 3) if ratios else None


def name_parameters(effects):
    """True values by the names of results: components of a vector each by its own."""
    found = {}
    for effect, parameters in effects.items():
        for name, value in parameters.items():
            parts = {f".{k}": v for k, v in enumerate(value)} if isinstance(value, list) else {"": value}
            found |= {f"{effect}.{name}{part}": v for part, v in parts.items()}
    return found


def channels(y, count):
    """The first channels of a record, shape (samples, count), whichever way the file has them."""
    y = np.asarray(y, dtype=float)
    y = y[:, None] if y.ndim == 1 else (y.T if y.shape[0] <= 3 else y)
    return y[:, :count]


if __name__ == "__main__":
    main()
