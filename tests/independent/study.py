"""Blind study of the verdict: campaigns drawn by the independent simulator, judged by `discover`.

    python -m tests.independent.study -o fits/verdict-study [--family impact] [--cases 40] [--first 0]

Three eighths of the cases hold nothing, the others one effect, a pair, or one outside the catalogue; record counts,
sampling, lengths, settings scatter and noise (white, AR(1), AR(1) plus white) are drawn too. Writes `cases.json` and
prints a scorecard.
"""

import argparse
import json
import os
import time
from pathlib import Path

import numpy as np

from .campaigns import make_campaign, write_campaign_folder
from .oblique_study import draw_oblique_case, make_oblique_case
from .slip_study import draw_slip_case, make_slip_case
from .tumbling_study import draw_tumble_case, make_tumble_case


TYPICAL = {
    "polytropic-gas": {"n": 1.8}, "ambient-pressure": {"p_a": 1.0e5}, "wall-stiffness": {"k_w": 1000.0, "q": 1.0},
    "membrane-area": {"alpha": 0.25}, "inflation-growth": {"beta": 1.5}, "gas-leak": {"lambda": 5.0},
    "viscoelastic-wall": {"k_v": 2500.0, "tau": 0.006}, "viscous-dashpot": {"c_v": 6.0},
    "adhesion": {"tau_a": 4.0e4}, "arm-servo": {"k_s": 250.0}, "speed-dependent-restitution": {"p": 0.1},
    "pressure-dependent-restitution": {"p": 0.1}, "stress-softening": {"sigma_m": 0.15, "j_0": 4.0},
    "sensor-highpass": {"tau_s": 0.8}, "sensor-lag": {"T": 1.2e-3}, "sensor-gain": {"g": 1.08},
}
OUTSIDE = {
    "x-end-stop": {"k": 1.0e5, "depth": 5.5e-3}, "x-arm-vibration": {"force": 3.0, "f": 90.0},
    "x-rate-hardening": {"h": 0.1, "w_0": 0.15},
}


def draw_case(seed: int) -> dict:
    """Settings of one case, from its seed alone."""
    generator = np.random.default_rng([20261121, seed])
    kind = ["null", "single", "null", "single", "outside", "null", "single", "pair"][seed % 8]
    names = list(TYPICAL)
    effects: dict = {}
    if kind == "single":
        name = names[(seed // 8 * 3 + {1: 0, 3: 1, 6: 2}[seed % 8]) % len(names)]
        effects = {name: dict(TYPICAL[name])}
    elif kind == "pair":
        chosen = generator.choice(["wall-stiffness", "viscous-dashpot", "sensor-highpass", "arm-servo", "adhesion",
                                   "speed-dependent-restitution", "viscoelastic-wall"], 2, replace=False)
        effects = {str(n): dict(TYPICAL[str(n)]) for n in chosen}
    elif kind == "outside":
        name = list(OUTSIDE)[seed // 8 % len(OUTSIDE)]
        effects = {name: dict(OUTSIDE[name])}
    return {
        "kind": kind, "effects": effects, "seed": int(seed),
        "base": {"effective_mass": float(generator.uniform(1.0, 1.9)),
                 "restitution": float(generator.uniform(0.6, 0.85))},
        "pressures": sorted(float(p) for p in generator.uniform(0.35e6, 2.6e6, int(generator.integers(3, 6)))),
        "speeds": sorted(float(v) for v in generator.uniform(0.12, 0.75, int(generator.integers(2, 4)))),
        "repeats": int(generator.integers(1, 4)), "interval": float(generator.choice([2.0e-4, 2.5e-4, 4.0e-4])),
        "rho": float(generator.choice([0.0, 0.0, 0.5, 0.8])), "white_share": float(generator.choice([0.0, 0.0, 0.4])),
    }


def judge_case(case: dict, folder: Path) -> dict:
    """Simulate one case into `folder`, let `discover` judge it blind, and say what came out."""
    from ddetumble.discrepancy.discovery import discover

    if "duration" in case:
        make_tumble_case(case, folder)
    elif "loads" in case:
        make_slip_case(case, folder)
    elif "slides" in case:
        make_oblique_case(case, folder)
    else:
        campaign = make_campaign(
            f"case-{case['seed']:03d}", case["seed"] + 5000, case["effects"], case["base"], case["pressures"],
            case["speeds"], case["repeats"], interval=case["interval"], rho=case["rho"],
            white_share=case["white_share"])
        write_campaign_folder(folder, campaign)
    began = time.perf_counter()
    found = discover(folder)
    truth = {**case["base"], **{f"{e}.{n}": v for e, p in case["effects"].items() for n, v in p.items()}}
    truth |= {f"{n}.{k}": x for n, v in truth.items() if isinstance(v, list) for k, x in enumerate(v)}
    inside = {name: bool(e.q025 <= truth[name] <= e.q975) for name, e in found.steps[-1].parameters.items()
              if name in truth}
    last = found.steps[-1].lack_of_fit
    alike = sorted({a["effect"] for s in found.steps for a in s.alternatives})
    return {
        **case, "records": found.settings["records"], "verdict": found.verdict, "found": list(found.effects),
        "confused_with": alike,
        "p_first": [found.steps[0].lack_of_fit.p_value, found.steps[0].lack_of_fit.score_p_value],
        "p_last": [last.p_value, last.score_p_value], "inside": inside,
        "misfit": found.steps[0].nrmse / max(found.noise_nrmse, 1e-300),
        "visible": {c.effect: c.visible for c in found.candidates if c.effect in case["effects"]},
        "where": [[w.channel, w.variable, list(w.range), w.phase, w.share, w.period] for w in found.where],
        "noise": {c: [n["sd"], n["correlation"], n["white_share"]] for c, n in found.noise.items()},
        "seconds": round(time.perf_counter() - began, 2),
    }


def is_right(row: dict) -> bool:
    """Whether a verdict is what an honest judge could say."""
    if row["kind"] == "null":
        return row["verdict"] == "nothing-missing"
    if row["kind"] == "outside":
        return row["verdict"] in ("improved", "unexplained")
    return row["verdict"] == "explained" and (
        set(row["found"]) == set(row["effects"])
        or (len(row["found"]) == len(row["effects"])
            and set(row["effects"]) <= set(row["found"]) | set(row["confused_with"])))


def main() -> None:
    """Command line."""
    import tempfile

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--cases", type=int, default=40)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--family", choices=("impact", "slip", "oblique", "tumble"), default="impact")
    options = parser.parse_args()
    draw = {"impact": draw_case, "slip": draw_slip_case, "oblique": draw_oblique_case,
            "tumble": draw_tumble_case}[options.family]
    options.output.mkdir(parents=True, exist_ok=True)
    rows = []
    for seed in range(options.first, options.first + options.cases):
        case = draw(seed)
        with tempfile.TemporaryDirectory() as folder:
            row = judge_case(case, Path(folder) / f"case-{seed:03d}")
        rows.append(row)
        print(seed, row["kind"], list(row["effects"]), "->", row["verdict"], row["found"], row["confused_with"],
              "right" if is_right(row) else "WRONG", f"{row['seconds']} s", flush=True)
        draft = options.output / "cases.json.part"
        draft.write_text(json.dumps(rows, indent=1) + "\n")
        os.replace(draft, options.output / "cases.json")
    for kind in ("null", "single", "pair", "outside"):
        some = [r for r in rows if r["kind"] == kind]
        print(f"{kind}: {sum(map(is_right, some))} of {len(some)} right")
    every = [ok for r in rows if r["verdict"] in ("explained", "nothing-missing") and is_right(r)
             for ok in r["inside"].values()]
    print(f"95 % intervals hold the truth in {np.mean(every):.1%} of {len(every)}")


if __name__ == "__main__":
    main()
