"""How often intervals of Eq. 10 hold the truth: `python -m docs.slip_coverage -o fits/slip-coverage`.

Campaigns of 24 strokes at 12 loads from 5 to 28 N and two pressures, by the second simulator, with noise of 0.01 N and
settings as uncertain as stated; K and tan delta_L are drawn anew for each. All eleven coefficients of Eq. 10 with K and
tan delta_L are fitted by `dd.fit`, from Eq. 10. Of the first campaigns intervals that take a curve for a straight line
are found by refitting, too (`Fit.profiled`), and posteriors are sampled. A folder that holds some of the campaigns
already is gone on with.
"""

import argparse
import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

import ddetumble as dd
from ddetumble.exam.simulators.campaigns import write_package
from ddetumble.exam.simulators.slip_campaigns import make_slip_campaign


LOADS = [float(x) for x in np.round(np.linspace(5.0, 28.0, 12), 1)]  # where Eq. 10 makes sense [N]
PRESSURES = [0.5e6, 2.5e6]  # [Pa]
NOISE = 0.01  # [N]
STEPS, MOST, BLOCK = 1500, 12_000, 500  # of a chain; more of them, as long as it has not converged
LIMIT = 1.01  # of R-hat, from which a chain has not
NORMAL_95 = 1.959964


def simulate(seed: int, folder: Path) -> tuple[dd.Campaign, dict[str, float]]:
    """A campaign, and K and tan delta_L of its rubber."""
    pick = np.random.default_rng([22, seed]).uniform
    rubber = {"adhesion_constant": float(pick(0.6, 1.2)), "loss_factor": float(pick(0.1, 0.22))}
    campaign = make_slip_campaign("curves", seed, {}, {**rubber, "slip_scale": 1.0}, LOADS, PRESSURES, [0.02],
                                  length=40e-3, interval=1e-3, noise=NOISE)
    write_package(folder, campaign)
    return dd.read_campaign(folder), rubber


def judge(seed: int, profiled: bool, sampled: bool) -> dict[str, Any]:
    """Truth, estimate and 95 % interval of every parameter of one campaign, by the fit, of those whose valley is curved
    by refitting, and by the posterior."""
    printed = dd.contact.SlipCurves()
    with tempfile.TemporaryDirectory() as draft:
        campaign, rubber = simulate(seed, Path(draft) / "campaign")
        fit = dd.fit(campaign, "eq10", noise="stated")
        truth = {name: rubber.get(name, float(getattr(printed, name))) for name in fit.parameters}
        row: dict[str, Any] = {
            "seed": seed, "reduced": fit.chi2_reduced, "converged": fit.converged,
            "fit": {n: [truth[n], p.estimate, p.sd, p.q025, p.q975] for n, p in fit.parameters.items()}}
        if profiled:
            mended = fit.profiled()
            row["profile"] = {n: [*row["fit"][n][:3], mended.parameters[n].q025, mended.parameters[n].q975]
                              for n in mended.profiles}
            row["same"] = {n: row["fit"][n] for n in mended.profiles}
            row["mended"] = row["fit"] | row["profile"]
        if sampled:
            for steps in range(STEPS, MOST + STEPS, STEPS):  # each goes on from the one before
                found = dd.sample(fit, seed=seed, most=steps, block=BLOCK, effective=10**6, folder=Path(draft, "chain"))
                if found.convergence.rhat < LIMIT:
                    break
            row |= {"rhat": float(found.convergence.rhat), "effective": float(found.convergence.effective),
                    "steps": found.convergence.steps,
                    "posterior": {n: [truth[n], p.mean, p.sd, p.q025, p.q975] for n, p in found.parameters.items()}}
    return row


def show_share(rows: list[dict], key: str) -> str:
    """So many of so many intervals that hold the truth, and the limits of the share over campaigns."""
    own = [row for row in rows if key in row]
    shares = np.array([np.mean([low <= truth <= high for truth, *_, low, high in row[key].values()]) for row in own])
    count = sum(len(row[key]) for row in own)
    reach = NORMAL_95 * float(stats.sem(shares)) if len(shares) > 1 else float("nan")
    low, high = 100 * (shares.mean() - reach), 100 * min(shares.mean() + reach, 1.0)
    return (f"{100 * shares.mean():.1f} % of {count} intervals in {len(own)} campaigns (95 % limits of the share, from "
            f"the scatter over campaigns: {low:.1f} to {high:.1f} %)")


def describe(rows: list[dict]) -> str:
    """README of the folder."""
    sampled = [row for row in rows if "posterior" in row]
    names = list(rows[0]["fit"])
    pulls = {n: np.array([(row["fit"][n][1] - row["fit"][n][0]) / row["fit"][n][2] for row in rows]) for n in names}
    lines = ["# Intervals of Eq. 10", "", *str(__doc__).strip().splitlines()[2:], "", "Made by", "",
             f"    python -m docs.slip_coverage -o fits/slip-coverage --campaigns {len(rows)} --profiled "
             f"{sum('profile' in row for row in rows)} --sampled {len(sampled)}",
             "", f"- Fits: {show_share(rows, 'fit')} hold the truth; reduced chi-square "
             f"{np.mean([row['reduced'] for row in rows]):.3f} on average, {sum(row['converged'] for row in rows)} of "
             f"{len(rows)} converged."]
    if any("profile" in row for row in rows):
        lines += [f"- Intervals that take a curve for a straight line, found by refitting: "
                  f"{show_share(rows, 'profile')} hold the truth; before, {show_share(rows, 'same')}. With these in "
                  f"their place, {show_share(rows, 'mended')} of all."]
    if sampled:
        worst = max(row["rhat"] for row in sampled)
        least = min(row["effective"] for row in sampled)
        most = sum(row["steps"] > STEPS for row in sampled)
        lines += [f"- Posteriors (emcee): {show_share(rows, 'posterior')} hold the truth; R-hat is {worst:.4f} at "
                  f"most, and there are {least:.0f} independent draws at least. Chains have {STEPS} steps; {most} had "
                  f"R-hat above {LIMIT:g} then and went on, to {max(row['steps'] for row in sampled)} at most."]
    lines += ["", "| parameter | fits that hold the truth | mean of (estimate - truth)/sd | its standard deviation |",
              "| --- | --- | --- | --- |"]
    for n in names:
        held = sum(row["fit"][n][3] <= row["fit"][n][0] <= row["fit"][n][4] for row in rows)
        lines.append(f"| {n} | {held} of {len(rows)} | {pulls[n].mean():+.2f} | {pulls[n].std(ddof=1):.2f} |")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Run it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--campaigns", type=int, default=100)
    parser.add_argument("--profiled", type=int, default=100, help="of these, the first with refitted intervals, too")
    parser.add_argument("--sampled", type=int, default=100, help="and the first that are sampled, too")
    given = parser.parse_args()
    given.output.mkdir(parents=True, exist_ok=True)
    path = given.output / "campaigns.jsonl"
    rows = {row["seed"]: row for row in map(json.loads, path.read_text("utf-8").splitlines())} if path.exists() else {}
    for seed in range(1, given.campaigns + 1):
        wanted = {"profile": seed <= given.profiled, "posterior": seed <= given.sampled}
        if seed not in rows or any(asked and key not in rows[seed] for key, asked in wanted.items()):
            old = rows.get(seed, {})
            rows[seed] = old | judge(seed, *(asked and key not in old for key, asked in wanted.items()))
            print(f"{seed} of {given.campaigns}", flush=True)
            path.write_text("".join(json.dumps(rows[key]) + "\n" for key in sorted(rows)), encoding="utf-8")
    text = describe([rows[key] for key in sorted(rows)][: given.campaigns])
    (given.output / "README.md").write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
