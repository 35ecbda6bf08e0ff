"""Plans of one impact by gradient against differential evolution, on random tumbling states.

    python docs/plan_study.py [STATES] [FOLDER] [--plans-only]

The reference: SciPy's differential evolution over face and seven variables, violations as an exact penalty, then rounds
of a dense local sample (Sobol points in a box that is halved) until a round improves by less than 0.02 %. Costs are
counted in integrated impacts; a gradient counts as many as it was measured to take on this machine. The closed forms
that choose the starts are counted by their measured time too. As differential evolution may end in another optimum than
the plan, local rounds are also made from the plan itself: `near` is what they gain, over its score. States that are
already in the folder are kept; `--plans-only` plans them anew beside the references that are there.
"""

import json
import sys
import time
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from scipy.optimize import differential_evolution
from scipy.stats import qmc

from ddetumble import Ball, CoulombFriction
from ddetumble.contact import Striker
from ddetumble.dynamics import Cylinder
from ddetumble.dynamics.surfaces import make_debris
from ddetumble.planning.constraints import evaluate, evaluate_slopes
from ddetumble.planning.multistart import find_bounds, find_starts
from ddetumble.planning.problem import Goal, Limits, StrikeProblem
from ddetumble.planning.single import StrikePlan, plan_strike


PENALTY = 3.0
GENERATIONS, POPULATION, LOCAL, ROUNDS, CONVERGED = 150, 10, 256, 14, 2e-4
TIMES = 20  # of every measured cost, of which the least counts


def pose(number: int) -> StrikeProblem:
    """The stage in a random attitude and spin, 36 to 109 N m s, a chaser somewhere, within 60° of it."""
    draw = np.random.default_rng(1000 + number)
    debris = make_debris(Cylinder())
    momentum = draw.normal(size=3)
    momentum *= 72.8 * draw.uniform(0.5, 1.5) / np.linalg.norm(momentum)
    chaser = draw.normal(size=3)
    limits = Limits(chaser=chaser / np.linalg.norm(chaser), cone=np.radians(60.0), force=draw.uniform(200.0, 1500.0))
    law = Striker(Ball(effective_mass=draw.uniform(4.0, 15.0)), CoulombFriction(draw.uniform(0.05, 0.4)),
                  tangential_mass=8.0, rolling_mass=1e9).extend(())
    return StrikeProblem(law, debris, draw.normal(size=4), momentum / np.diag(np.asarray(debris.inertia)), limits,
                        Goal(), {})


class Worth:
    """Score of a design with its violations as an exact penalty, shape (8,): seven variables and the face; counted."""

    def __init__(self, problem: StrikeProblem):
        self.problem, self.count = problem, 0
        self.names = problem.debris.surface.face_names()

    def __call__(self, z: np.ndarray) -> float:
        """Score and penalty [-]."""
        self.count += 1
        values = np.asarray(evaluate(self.problem, jnp.asarray(self.face(z)), jnp.asarray(z[:7])))
        return float(values[0] + PENALTY * np.sum(np.maximum(-values[1:], 0.0))) if np.isfinite(values).all() else 1e3

    def face(self, z: np.ndarray) -> int:
        """Number of the face."""
        return min(int(z[7]), len(self.names) - 1)


def find_reference(problem: StrikeProblem) -> dict:
    """Best score by differential evolution and local rounds, with its count of impacts and its last improvement."""
    worth = Worth(problem)
    bounds = [(-1.0, 1.0), *find_bounds(problem, 0)[1:], (0.0, len(worth.names) - 1e-9)]
    found = differential_evolution(worth, bounds, maxiter=GENERATIONS, popsize=POPULATION, seed=1, polish=False, tol=0)
    best, gain = search_near(worth, found.x, found.fun)
    return {"score": best, "impacts": worth.count, "last_gain": gain}


def search_near(worth: Worth, centre: np.ndarray, best: float) -> tuple[float, float]:
    """Best score of a dense local sample in a box that shrinks round by round, and what the last round gained."""
    box, width, gain = find_bounds(worth.problem, worth.face(centre)), 0.15, 1.0
    for turn in range(ROUNDS):
        before = best
        for unit in qmc.Sobol(7, rng=np.random.default_rng(turn)).random(LOCAL):
            z = np.append(np.clip(centre[:7] + width * (2.0 * unit - 1.0), *box.T), centre[7])
            value = worth(z)
            if value < best:
                centre, best = z, value
        gain = (before - best) / before
        width *= 0.6
        if gain < CONVERGED and turn > 5:
            break
    return best, gain


def search_from_plan(problem: StrikeProblem, plan: StrikePlan) -> float:
    """By how much local rounds from the plan itself better it, over its score [-]."""
    worth = Worth(problem)
    centre = np.append(plan.x, worth.names.index(plan.face) + 0.5)
    start = worth(centre)
    return 1.0 - search_near(worth, centre, start)[0] / start


def measure_costs(problem: StrikeProblem) -> dict[str, float]:
    """Time of a gradient and of the closed forms over that of an impact [-], each the least of several."""
    face, x = (jnp.asarray(one) for one in find_starts(problem, 1)[0][0])
    actions = {"impact": lambda: np.asarray(evaluate(problem, face, x)),
               "gradient": lambda: np.asarray(evaluate_slopes(problem, face, x)[0]),
               "starts": lambda: find_starts(problem, 3)}
    spent: dict[str, list[float]] = {name: [] for name in actions}
    for _ in range(TIMES):  # in turn, so that what else the machine does hits all alike
        for name, action in actions.items():
            start = time.process_time()
            action()
            spent[name].append(time.process_time() - start)
    least = {name: min(values) for name, values in spent.items()}
    return {name: least[name] / least["impact"] for name in ("gradient", "starts")}


def main(states: int = 50, folder: str = "fits/plan-study", plans_only: bool = False):
    """Study so many states and write `states.json` and a summary."""
    place = Path(folder)
    place.mkdir(parents=True, exist_ok=True)
    file = place / "states.json"
    rows = json.loads(file.read_text(encoding="utf-8")) if file.is_file() else []
    known = [{"score": row["reference"], "impacts": row["reference_impacts"], "last_gain": row["last_gain"]}
             for row in rows]
    rows = [] if plans_only else rows
    for number in range(len(rows), states):
        problem = pose(number)
        costs = measure_costs(problem)
        plan = plan_strike(problem)
        reference = known[number] if number < len(known) else find_reference(problem)
        impacts = plan.tally.values + costs["gradient"] * plan.tally.slopes + costs["starts"]
        rows.append({"state": number, "plan": plan.score, "allowed": plan.allowed, "reference": reference["score"],
                     "behind": plan.score / reference["score"] - 1.0, "impacts": impacts,
                     "reference_impacts": reference["impacts"], "last_gain": reference["last_gain"],
                     "share_of_cost": impacts / reference["impacts"], "face": plan.face,
                     "values": plan.tally.values, "slopes": plan.tally.slopes, **costs,
                     "stationarity": plan.certificate.stationarity,
                     "gradient_error": plan.certificate.gradient_error,
                     "near": search_from_plan(problem, plan)})
        file.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
        print(json.dumps(rows[-1]), flush=True)
    behind, share = (np.array([row[name] for row in rows]) for name in ("behind", "share_of_cost"))
    summary = {
        "states": len(rows), "within_0.1_percent": int(np.sum(behind <= 1e-3)), "worst_behind": float(behind.max()),
        "better_than_reference_by_0.1_percent": int(np.sum(behind < -1e-3)),
        "reference_not_converged": int(sum(row["last_gain"] > CONVERGED for row in rows)),
        "share_of_cost": {"median": float(np.median(share)), "largest": float(share.max())},
        "most_gained_near_the_plan": max(row["near"] for row in rows),
        "failures": [row["state"] for row in rows if row["behind"] > 1e-3 or row["near"] > 1e-3 or not row["allowed"]],
        "dearer_than_a_twentieth": int(np.sum(share > 0.05)),
    }
    (place / "summary.json").write_text(json.dumps(summary, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(summary))


if __name__ == "__main__":
    words = [word for word in sys.argv[1:] if word != "--plans-only"]
    main(*(kind(value) for kind, value in zip((int, str), words, strict=False)), plans_only="--plans-only" in sys.argv)
