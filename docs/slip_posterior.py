"""a...e of Eq. 9 at one load by emcee and by NUTS: `python -m docs.slip_posterior -o fits/slip-coefficients`.

The stroke is that of Eq. 10 at 28 N with noise, as in `docs/slip_curves.py`, with e free. Writes the fit, both
posteriors, a corner plot and `README.md`.
"""

import argparse
import dataclasses as dc
from pathlib import Path

import numpy as np

import ddetumble as dd
from ddetumble.figures import draw_corner, render_png
from ddetumble.inference.files import write_json
from docs.slip_curves import ALONE, make_campaign


LOAD, SEED = 28.0, 20


def compare(emcee, nuts) -> list[dict]:
    """Difference of means over its Monte Carlo error, and ratio of deviations with its error, of every coefficient."""
    rows = []
    for name, p in emcee.parameters.items():
        q = nuts.parameters[name]
        rows.append({"name": name, "difference": (p.mean - q.mean) / np.hypot(p.mcse, q.mcse), "ratio": p.sd / q.sd,
                     "ratio_error": float(np.sqrt(0.5 / p.effective + 0.5 / q.effective))})
    return rows


def describe(found: dd.Fit, profiles, emcee: dd.Posterior, nuts: dd.Posterior, rows) -> str:
    """README of the folder."""
    lines = [f"# a...e at {LOAD:g} N", "", "Made by `python -m docs.slip_posterior -o fits/slip-coefficients`: a "
             "stroke of Eq. 10 with noise, e free, in the coordinates of the model `eq10` (a, b + d, b - d, c, e).", "",
             "| | fit | its interval by profile | emcee: mean, sd | 95 % of its draws | NUTS: mean, sd |",
             "| --- | --- | --- | --- | --- | --- |"]
    for name, p in emcee.parameters.items():
        c, q, (low, high) = found.parameters[name], nuts.parameters[name], profiles[name]
        lines.append(f"| {name} | {c.estimate:.5g} ± {c.sd:.2g} | {low:.5g} to {high:.5g} | {p.mean:.5g}, "
                     f"{p.sd:.2g} | {p.q025:.5g} to {p.q975:.5g} | {q.mean:.5g}, {q.sd:.2g} |")
    worst = max(abs(row["difference"]) for row in rows)
    lines += ["", f"- emcee: {emcee.state}; R-hat {emcee.convergence.rhat:.4f}, {emcee.convergence.effective:.0f} "
              "independent draws of the worst coefficient.",
              f"- NUTS: {nuts.state}; {nuts.statistics['divergences']} divergences, R-hat "
              f"{nuts.convergence.rhat:.4f}, {nuts.convergence.effective:.0f} independent draws.",
              f"- Their means differ by at most {worst:.1f} Monte Carlo errors; deviations: "
              + ", ".join(f"{r['name']} {r['ratio']:.3f} ± {r['ratio_error']:.3f}" for r in rows) + ".",
              "- The posterior is a bent valley with a long tail of large c and small d.", "",
              "![corner](corner.png)", ""]
    return "\n".join(lines)


def main() -> None:
    """Run it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, required=True)
    given = parser.parse_args()
    campaign = make_campaign([LOAD], [1e6], np.random.default_rng(SEED), exact=True)
    found = dd.fit(campaign, "eq10", free=["e_0"], fixed=ALONE, noise="stated")
    profiles = {name: found.profile(name) for name in found.parameters}
    emcee = dd.sample(found, seed=SEED, effective=3000, most=20_000, block=500)
    nuts = dd.sample(found, seed=SEED, sampler="nuts", effective=3000, burn=1000, block=500, most=20_000)
    emcee.save(given.output)
    rows = compare(emcee, nuts)
    (given.output / "corner.png").write_bytes(render_png(draw_corner(emcee)))
    write_json(given.output / "result.json", {"fit": found.to_dict(), "profiles": profiles, "nuts": nuts.to_dict(),
                                              "compared": rows, "convergence": dc.asdict(emcee.convergence)})
    text = describe(found, profiles, emcee, nuts, rows)
    (given.output / "README.md").write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
