r"""Where searches of an impact start: thousands of designs by closed forms, bettered by differential evolution."""

from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from scipy.stats import qmc

from .closed_form import screen
from .constraints import CONSTRAINTS, Constraints
from .problem import SLIPS, SPEED, VARIABLES, StrikeProblem, list_faces, reach_speed, score


# Designs of a generation, on all faces together: more find narrow optima, at their price; a power of 2, as a Sobol
# sample is even there.
DRAWS = 2048
EACH = 128  # on one face at least: of more faces than that leaves room for, the most promising after a short look
GENERATIONS, LOOKS = 120, 20  # after which the best of one seed is that of another to a thousandth; those of that look
LEADERS = 0.1  # fraction of a face's designs, towards one of which each is moved: fewer converge too early, more slowly
STRETCH, CROSSED = (0.4, 0.9), 0.9  # of steps, and fraction of variables that they change (Zhang and Sanderson 2009)
APART = 0.3  # distance of two starts on one face, in variables (each of width 2): nearer ones climb the same hill
WRAPS = ("side", "sphere")  # faces whose first coordinate goes round
PENALTY = 3.0  # of a scaled violation, in units of the score: more than a violation could gain, so that limits win
# By which each constraint may be violated at no penalty, as closed forms err that much at the best designs of drawn
# problems: what they wrongly forbid is never seen, what they wrongly allow a descent repairs.
LOOSE = np.array(Constraints(*np.zeros(len(CONSTRAINTS)))._replace(force=0.03, depression=0.03, edge=0.02,
                                                                   next_edge=0.02, clear=0.3))
HELD = [VARIABLES.index("pressure"), VARIABLES.index("instant")]  # of which a scenario may give one value
FAST = 2.0  # of the speed that limits allow by the closed form, up to which it may be wrong

Place = tuple[int, np.ndarray]  # face and variables
# Of what `screen` finds, shape (designs, 1 + constraints): what is to be brought down, infinite where it cannot be
# computed, and of each design what counts towards the least, infinite where it does not; shapes (designs,).
Rank = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]


def find_bounds(problem: StrikeProblem, face: int) -> np.ndarray:
    """Lowest and highest value of the seven variables, shape (7, 2).

    An angle may go beyond half a turn. Half of the least approach speed is the slowest, so that every design strikes:
    a search that came to one which does not would find no slope there.
    """
    bounds = np.tile([-1.0, 1.0], (len(VARIABLES), 1))
    if problem.debris.surface.face_names()[face] in WRAPS:
        bounds[0] = [-2.0, 2.0]
    fastest = float(reach_speed(problem) / problem.unit)
    bounds[SPEED] = [min(0.5 * float(problem.limits.approach / problem.unit), fastest), fastest]
    bounds[SLIPS] = [-fastest, fastest]
    for k, (low, high) in zip(HELD, (problem.limits.pressure, problem.limits.window), strict=True):
        if float(low) == float(high):  # a value that is given, at neither end of anything
            bounds[k] = 0.0
    return bounds


def estimate_score(problem: StrikeProblem, face: int, x: np.ndarray) -> float:
    """Score of one design by closed forms [-]."""
    # As many of it as designs in a round, so that the same compiled program serves.
    return float(screen(problem, jnp.full(DRAWS, face, int), jnp.tile(jnp.asarray(x), (DRAWS, 1)))[1][0, 0])


class Generation(NamedTuple):
    """The last designs that closed forms judged: faces and variables, shapes (designs,) and (designs, 7), what was
    brought down, shape (designs,), and the smallest of what counts in all generations, infinite where none does.
    """

    faces: np.ndarray
    x: np.ndarray
    worth: np.ndarray
    least: float

    def pick(self, count: int) -> list[Place]:
        """The best designs that are on other faces or far enough from each other, the best first."""
        return pick_apart(((int(self.faces[k]), self.x[k]) for k in np.argsort(self.worth, kind="stable")), count)


def pick_apart(places: Iterable[Place], count: int) -> list[Place]:
    """So many at most of the designs that are on other faces or far enough from those before them."""
    chosen: list[Place] = []
    for face, x in places:
        if len(chosen) < count and all(face != other or np.linalg.norm(x - y) > APART for other, y in chosen):
            chosen.append((face, x))
    return chosen


def rank_scores(found: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Scores with violations as a penalty, where they are more than closed forms err; of designs without such a
    violation the score counts.
    """
    over = np.sum(np.maximum(-found[:, 1:] - LOOSE, 0.0), axis=1)
    worth = found[:, 0] + PENALTY * over
    worth = np.where(np.isfinite(worth), worth, np.inf)
    return worth, np.where(over == 0.0, worth, np.inf)


def find_starts(problem: StrikeProblem, starts: int, draws: int = DRAWS, seed: int = 0, near: Sequence[Place] = ()
                ) -> tuple[list[Place], float]:
    """So many of the most promising designs, apart from each other, the best first, and the least score of all that
    closed forms see allowed (that without an impact where none is); arguments as of `evolve_designs`.
    """
    last = evolve_designs(problem, draws, seed, near)
    return last.pick(starts), min(last.least, float(score(problem, problem.angular_velocity)))


def evolve_designs(problem: StrikeProblem, draws: int = DRAWS, seed: int = 0, near: Sequence[Place] = (),
                   rank: Rank = rank_scores) -> Generation:
    """Designs evolved towards what closed forms find best.

    A Sobol sample over all faces, then differential evolution on each of them, towards one of its best and along the
    difference of two; each generation is one call of `screen`, all designs under `vmap`. Without a gradient, so that
    nothing has to be compiled for it. Of many faces a short evolution on all of them chooses those of the long one.
    `draws` designs, a power of 2, make a generation; those `near`, such as the impact before, are of the first.
    """
    chosen, most = list_faces(problem), max(draws // EACH, 1)
    if len(chosen) > most:
        # Those near are always kept; of more faces than designs, each seed leaves out others.
        kept, order = [face for face, _ in near], np.random.default_rng(seed).permutation(chosen)
        chosen = np.array(list(dict.fromkeys([*kept, *order.tolist()]))[:draws])
        look = _evolve(problem, chosen, draws, seed, near, LOOKS, rank)
        best = [np.min(look.worth[look.faces == face]) for face in chosen]
        ordered = chosen[np.argsort(best, kind="stable")].tolist()
        chosen = np.array(list(dict.fromkeys([*kept, *ordered]))[: max(most, len(near))])
    return _evolve(problem, chosen, draws, seed, near, GENERATIONS, rank)


def _evolve(problem: StrikeProblem, chosen: np.ndarray, draws: int, seed: int, near: Sequence[Place], generations: int,
            rank: Rank) -> Generation:
    """On the chosen faces alike."""
    def judge(x: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        settled, found = (np.array(one) for one in screen(problem, jnp.asarray(faces), jnp.asarray(x)))
        worth, counts = rank(found)
        return settled, worth, float(np.min(counts, initial=np.inf))

    group = np.arange(draws) % len(chosen)
    faces, count = chosen[group], np.bincount(group)
    x = 2.0 * qmc.Sobol(len(VARIABLES), rng=np.random.default_rng(seed)).random(draws) - 1.0
    slowest, fastest = find_bounds(problem, 0)[SPEED]
    x[:, SPEED] = slowest + 0.5 * (1.0 + x[:, SPEED]) * (min(FAST, fastest) - slowest)
    # Half of the designs come along the moment that is wanted: others are rarely best. An eighth may rub as fast as the
    # arm can.
    x[::2, SLIPS] *= 0.1
    x[1::8, SLIPS] *= fastest
    x[:, HELD] = np.clip(x[:, HELD], *find_bounds(problem, 0)[HELD].T)
    for k, (face, place) in enumerate(near):
        x[np.flatnonzero(faces == face)[k]] = place
    x, worth, least = judge(x)
    low, high = np.moveaxis(np.stack([find_bounds(problem, face) for face in chosen]), -1, 0)
    first, draw = np.concatenate([[0], np.cumsum(count)[:-1]]), np.random.default_rng(seed)
    for _ in range(generations):
        ranked = np.lexsort((worth, group))
        leader = ranked[first[group] + (draw.random(draws) * np.maximum(LEADERS * count, 1.0)[group]).astype(int)]
        one, other = (group + len(chosen) * (draw.random(draws) * count[group]).astype(int) for _ in range(2))
        step = draw.uniform(*STRETCH, (draws, 1))
        moved = np.where(draw.random(x.shape) < CROSSED, x + step * (x[leader] - x + x[one] - x[other]), x)
        moved, found, seen = judge(np.clip(moved, low[group], high[group]))
        better = found < worth
        x, worth, least = np.where(better[:, None], moved, x), np.where(better, found, worth), min(least, seen)
    return Generation(faces, x, worth, least)
