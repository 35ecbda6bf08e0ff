"""Where refinements start: thousands of designs by closed forms at once, then closer about the best of them."""

import dataclasses as dc
from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from scipy.stats import qmc

from .strike_problem import SLIPS, SPEED, VARIABLES, Problem, reach_speed, score, screen


DRAWS = 2048  # designs that are looked at in every round, on all faces together
CENTRES = 16  # about which later rounds look
ROUNDS, WIDTH, SHRINK = 8, 0.3, 0.7  # of these; standard deviation about a centre, in variables
APART, LAST_APART = 0.6, 0.3  # distance of two centres on one face, and of two starts
WRAPS = ("side", "sphere")  # faces whose first coordinate goes round
PENALTY = 3.0
FAST = 2.0  # of the speed that limits allow by the closed form, up to which it may be wrong


def find_bounds(problem: Problem, face: int) -> np.ndarray:
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


def find_starts(problem: Problem, starts: int, draws: int = DRAWS, seed: int = 0,
                near: Sequence[tuple[int, np.ndarray]] = ()) -> Starts:
    """The most promising designs that are apart from each other.

    A Sobol sample over all faces, then rounds of normal steps about the best of it, ever shorter; each round is one
    call of `screen`, all designs under `vmap`. Without a gradient, so that nothing has to be compiled for it; the
    integrated impact is refined with one.

    Args:
        problem: what is given, allowed and wanted.
        starts: how many are wanted.
        draws: designs of a round.
        seed: of their places.
        near: designs about which it looks as well, such as the impact before.
    """
    names = problem.debris.surface.face_names()
    x = 2.0 * qmc.Sobol(len(VARIABLES), rng=np.random.default_rng(seed)).random(draws) - 1.0
    faces = np.arange(draws) % len(names)
    low, high = find_bounds(problem, 0)[SPEED]
    x[:, SPEED] = low + 0.5 * (1.0 + x[:, SPEED]) * (min(FAST, high) - low)
    # Half of the designs come along the moment that is wanted: others are rarely best. An eighth may rub as fast as the
    # arm can.
    x[::2, SLIPS] *= 0.1
    x[1::8, SLIPS] *= high
    for k, (face, place) in enumerate(near):
        faces[k], x[k] = face, place
    x, worth, least = _rank(problem, faces, x)
    kept = _part(faces, x, worth, max(starts, CENTRES), APART)
    kept += [k for k in range(len(near)) if k not in kept]
    faces, x, worth, later = _close_in(problem, faces[kept], x[kept], worth[kept], draws, seed)
    return Starts(tuple((int(faces[k]), x[k]) for k in _part(faces, x, worth, starts, LAST_APART)), min(least, later))


def _close_in(problem: Problem, faces: np.ndarray, x: np.ndarray, worth: np.ndarray, draws: int,
              seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Every centre moved to the best that was found about it; least score of all that were seen allowed."""
    each, rows, least = draws // len(faces), np.arange(len(faces)), np.inf
    low, high = np.moveaxis(np.stack([find_bounds(problem, face) for face in faces])[:, None], -1, 0)
    draw = np.random.default_rng(seed)
    for width in WIDTH * SHRINK ** np.arange(ROUNDS if each else 0):
        near = np.clip(x[:, None] + width * draw.normal(size=(len(faces), each, x.shape[1])), low, high)
        # Filled up to as many as before, so that the same compiled program serves.
        spread = np.resize(near.reshape(-1, x.shape[1]), (draws, x.shape[1]))
        on = np.resize(np.repeat(faces, each), draws)
        spread, found, score = _rank(problem, on, spread)
        least = min(least, score)
        count = near[..., 0].size
        near, found = spread[:count].reshape(near.shape), found[:count].reshape(len(faces), each)
        best = np.argmin(found, axis=1)
        better = found[rows, best] < worth
        x, worth = np.where(better[:, None], near[rows, best], x), np.where(better, found[rows, best], worth)
    return faces, x, worth, least


def _rank(problem: Problem, faces: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Designs as the arm can make them; their score by closed forms with violations as a penalty, shape (designs,),
    infinite where it cannot be computed; the least score of those without violation.
    """
    settled, found = (np.array(one) for one in screen(problem, jnp.asarray(faces), jnp.asarray(x)))
    over = np.sum(np.maximum(-found[:, 1:], 0.0), axis=1)
    worth = found[:, 0] + PENALTY * over
    worth = np.where(np.isfinite(worth), worth, np.inf)
    untouched = float(score(problem, problem.angular_velocity))
    return settled, worth, float(np.min(worth[over == 0.0], initial=untouched))


def _part(faces: np.ndarray, x: np.ndarray, worth: np.ndarray, count: int, apart: float) -> list[int]:
    """Numbers of the best that are on other faces or far enough from each other."""
    chosen: list[int] = []
    for k in np.argsort(worth, kind="stable"):
        if all(faces[k] != faces[j] or np.linalg.norm(x[k] - x[j]) > apart for j in chosen):
            chosen.append(int(k))
        if len(chosen) == count:
            break
    return chosen
