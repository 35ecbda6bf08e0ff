"""Where refinements start: thousands of designs by closed forms at once, bettered by differential evolution."""

import dataclasses as dc
from collections.abc import Callable, Sequence

import jax.numpy as jnp
import numpy as np
from scipy.stats import qmc

from .screening import screen
from .strike_problem import SLIPS, SPEED, VARIABLES, StrikeProblem, reach_speed, score


DRAWS = 2048  # designs of a generation, on all faces together; a power of 2, as a Sobol sample is even there
EACH = 128  # on one face at least: of more faces than that leaves room for, the most promising after a short look
GENERATIONS = 120  # after which the best of one seed is that of another to a thousandth
LOOKS = 20  # generations of that look
LEADERS = 0.1  # share of a face's designs, towards one of which each is moved
STRETCH, CROSSED = (0.4, 0.9), 0.9  # of steps, and share of variables that they change (Zhang and Sanderson 2009)
APART = 0.3  # distance of two starts on one face, in variables
WRAPS = ("side", "sphere")  # faces whose first coordinate goes round
PENALTY = 3.0  # of a scaled violation, in units of the score
FAST = 2.0  # of the speed that limits allow by the closed form, up to which it may be wrong


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
    return bounds


@dc.dataclass(frozen=True)
class Starts:
    """Where refinements start.

    Attributes:
        places: face and variables of the most promising designs, the best first.
        score: least by closed forms of all designs that these see allowed; that without an impact where they see none.
    """

    places: tuple[tuple[int, np.ndarray], ...]
    score: float


@dc.dataclass(frozen=True)
class Evolved:
    """The last generation of designs that closed forms judge.

    Attributes:
        faces: shape (designs,).
        x: variables, shape (designs, 7).
        worth: what was brought down, shape (designs,).
        least: smallest of what counts of all designs of all generations; infinite where none counts.
    """

    faces: np.ndarray
    x: np.ndarray
    worth: np.ndarray
    least: float


# Of the columns that `screen` finds, shape (designs, 1 + constraints): what is to be brought down, infinite where it
# cannot be computed, and of each design what counts towards the least, infinite where it does not; shapes (designs,).
Rank = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]


def rank_scores(found: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Scores with violations as a penalty; of designs without a violation the score counts."""
    over = np.sum(np.maximum(-found[:, 1:], 0.0), axis=1)
    worth = found[:, 0] + PENALTY * over
    worth = np.where(np.isfinite(worth), worth, np.inf)
    return worth, np.where(over == 0.0, worth, np.inf)


def find_starts(problem: StrikeProblem, starts: int, draws: int = DRAWS, seed: int = 0,
                near: Sequence[tuple[int, np.ndarray]] = ()) -> Starts:
    """The most promising designs that are apart from each other.

    Args:
        problem: what is given, allowed and wanted.
        starts: how many are wanted.
        draws: designs of a generation; a power of 2.
        seed: of their places.
        near: further designs of the first, such as the impact before.
    """
    last = evolve_designs(problem, draws, seed, near)
    return Starts(tuple((int(last.faces[k]), last.x[k]) for k in pick_apart(last.faces, last.x, last.worth, starts)),
                  min(last.least, float(score(problem, problem.angular_velocity))))


def evolve_designs(problem: StrikeProblem, draws: int = DRAWS, seed: int = 0,
                   near: Sequence[tuple[int, np.ndarray]] = (), rank: Rank = rank_scores) -> Evolved:
    """Designs evolved towards what closed forms find best.

    A Sobol sample over all faces, then differential evolution on each of them, towards one of its best and along the
    difference of two; each generation is one call of `screen`, all designs under `vmap`. Without a gradient, so that
    nothing has to be compiled for it; the integrated impact is refined with one. Of many faces a short evolution on all
    of them chooses those of the long one.

    Args:
        problem: what is given, allowed and wanted.
        draws: designs of a generation; a power of 2.
        seed: of their places.
        near: further designs of the first, such as the impact before.
        rank: what is best.
    """
    count, most = len(problem.debris.surface.face_names()), max(draws // EACH, 1)
    chosen = np.arange(count)
    if count > most:
        # Those near are always kept; of more faces than designs, each seed leaves out others.
        kept, order = [face for face, _ in near], np.random.default_rng(seed).permutation(count)
        chosen = _put_first(kept, order)[:draws]
        look = _evolve(problem, chosen, draws, seed, near, LOOKS, rank)
        best = [np.min(look.worth[look.faces == face]) for face in chosen]
        chosen = _put_first(kept, chosen[np.argsort(best, kind="stable")])[: max(most, len(near))]
    return _evolve(problem, chosen, draws, seed, near, GENERATIONS, rank)


def _put_first(some: Sequence[int], every: np.ndarray) -> np.ndarray:
    return np.array(list(dict.fromkeys([*some, *every.tolist()])))


def _evolve(problem: StrikeProblem, chosen: np.ndarray, draws: int, seed: int, near: Sequence[tuple[int, np.ndarray]],
            generations: int, rank: Rank) -> Evolved:
    """On the chosen faces alike."""
    group = np.arange(draws) % len(chosen)
    faces, count, x = chosen[group], np.bincount(group), _spread(problem, draws, seed)
    for k, (face, place) in enumerate(near):
        x[np.flatnonzero(faces == face)[k]] = place
    x, worth, least = _judge(problem, faces, x, rank)
    low, high = np.moveaxis(np.stack([find_bounds(problem, face) for face in chosen]), -1, 0)
    first, draw = np.concatenate([[0], np.cumsum(count)[:-1]]), np.random.default_rng(seed)
    for _ in range(generations):
        ranked = np.lexsort((worth, group))
        leader = ranked[first[group] + (draw.random(draws) * np.maximum(LEADERS * count, 1.0)[group]).astype(int)]
        one, other = (group + len(chosen) * (draw.random(draws) * count[group]).astype(int) for _ in range(2))
        step = draw.uniform(*STRETCH, (draws, 1))
        moved = np.where(draw.random(x.shape) < CROSSED, x + step * (x[leader] - x + x[one] - x[other]), x)
        moved, found, seen = _judge(problem, faces, np.clip(moved, low[group], high[group]), rank)
        better = found < worth
        x, worth, least = np.where(better[:, None], moved, x), np.where(better, found, worth), min(least, seen)
    return Evolved(faces, x, worth, least)


def _spread(problem: StrikeProblem, draws: int, seed: int) -> np.ndarray:
    """Variables of a Sobol sample, at speeds that may be allowed, shape (draws, 7)."""
    x = 2.0 * qmc.Sobol(len(VARIABLES), rng=np.random.default_rng(seed)).random(draws) - 1.0
    low, high = find_bounds(problem, 0)[SPEED]
    x[:, SPEED] = low + 0.5 * (1.0 + x[:, SPEED]) * (min(FAST, high) - low)
    # Half of the designs come along the moment that is wanted: others are rarely best. An eighth may rub as fast as the
    # arm can.
    x[::2, SLIPS] *= 0.1
    x[1::8, SLIPS] *= high
    return x


def estimate_score(problem: StrikeProblem, face: int, x: np.ndarray, draws: int = DRAWS) -> float:
    """Score of one design by closed forms [-]."""
    # As many of it as designs in a round, so that the same compiled program serves.
    return float(screen(problem, jnp.full(draws, face), jnp.tile(jnp.asarray(x), (draws, 1)))[1][0, 0])


def _judge(problem: StrikeProblem, faces: np.ndarray, x: np.ndarray, rank: Rank
           ) -> tuple[np.ndarray, np.ndarray, float]:
    """Designs as the arm can make them; their worth, shape (designs,); the least of what counts."""
    settled, found = (np.array(one) for one in screen(problem, jnp.asarray(faces), jnp.asarray(x)))
    worth, counts = rank(found)
    return settled, worth, float(np.min(counts, initial=np.inf))


def pick_apart(faces: np.ndarray, x: np.ndarray, worth: np.ndarray, count: int) -> list[int]:
    """Places of the best designs that are on other faces or far enough from each other, the best first."""
    chosen: list[int] = []
    for k in np.argsort(worth, kind="stable"):
        if all(faces[k] != faces[j] or np.linalg.norm(x[k] - x[j]) > APART for j in chosen):
            chosen.append(int(k))
        if len(chosen) == count:
            break
    return chosen
