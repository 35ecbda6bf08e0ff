"""Where refinements start: thousands of designs by closed forms at once, then closer about the best of them."""

import jax.numpy as jnp
import numpy as np
from scipy.stats import qmc

from .strike_problem import VARIABLES, Problem, screen


DRAWS = 2048  # designs that are looked at in every round, on all faces together
CENTRES = 16  # about which later rounds look
ROUNDS, WIDTH, SHRINK = 8, 0.3, 0.7  # of these; standard deviation about a centre, in variables over -1 to 1
APART, LAST_APART = 0.6, 0.3  # distance of two centres on one face, and of two starts
WRAPS = ("side", "sphere")  # faces whose first coordinate goes round
PENALTY = 3.0


def find_bounds(names: tuple[str, ...], face: int) -> np.ndarray:
    """Lowest and highest value of the seven variables, shape (7, 2); an angle may go beyond half a turn."""
    bounds = np.tile([-1.0, 1.0], (len(VARIABLES), 1))
    if names[face] in WRAPS:
        bounds[0] = [-2.0, 2.0]
    return bounds


def find_starts(problem: Problem, starts: int, draws: int = DRAWS, seed: int = 0) -> list[tuple[int, np.ndarray]]:
    """Faces and variables of the most promising designs that are apart from each other, the best first.

    A Sobol sample over all faces, then rounds of normal steps about the best of it, ever shorter; each round is one
    call of `screen`, all designs under `vmap`. Without a gradient, so that nothing has to be compiled for it; the
    integrated impact is refined with one.

    Args:
        problem: what is given, allowed and wanted.
        starts: how many are wanted.
        draws: designs of a round.
        seed: of their places.
    """
    names = problem.debris.surface.face_names()
    x = 2.0 * qmc.Sobol(len(VARIABLES), rng=np.random.default_rng(seed)).random(draws) - 1.0
    # Half of the designs come without tangential speed and along the moment that is wanted: others are rarely best.
    x[::2, 3:5] *= 0.1
    faces = np.arange(draws) % len(names)
    worth = _rank(problem, faces, x)
    kept = _part(faces, x, worth, max(starts, CENTRES), APART)
    faces, x, worth = _close_in(problem, faces[kept], x[kept], worth[kept], draws, seed)
    return [(int(faces[k]), x[k]) for k in _part(faces, x, worth, starts, LAST_APART)]


def _close_in(problem: Problem, faces: np.ndarray, x: np.ndarray, worth: np.ndarray, draws: int,
              seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Every centre moved to the best that was found about it."""
    names, each, rows = problem.debris.surface.face_names(), draws // len(faces), np.arange(len(faces))
    low, high = np.moveaxis(np.stack([find_bounds(names, face) for face in faces])[:, None], -1, 0)
    draw = np.random.default_rng(seed)
    for width in WIDTH * SHRINK ** np.arange(ROUNDS if each else 0):
        near = np.clip(x[:, None] + width * draw.normal(size=(len(faces), each, x.shape[1])), low, high)
        # Filled up to as many as before, so that the same compiled program serves.
        spread = np.resize(near.reshape(-1, x.shape[1]), (draws, x.shape[1]))
        found = _rank(problem, np.resize(np.repeat(faces, each), draws), spread)[: near[..., 0].size]
        found = found.reshape(len(faces), each)
        best = np.argmin(found, axis=1)
        better = found[rows, best] < worth
        x, worth = np.where(better[:, None], near[rows, best], x), np.where(better, found[rows, best], worth)
    return faces, x, worth


def _rank(problem: Problem, faces: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Score by closed forms with violations as a penalty, shape (designs,); infinite where it cannot be computed."""
    found = np.asarray(screen(problem, jnp.asarray(faces), jnp.asarray(x)))
    worth = found[:, 0] + PENALTY * np.sum(np.maximum(-found[:, 1:], 0.0), axis=1)
    return np.where(np.isfinite(worth), worth, np.inf)


def _part(faces: np.ndarray, x: np.ndarray, worth: np.ndarray, count: int, apart: float) -> list[int]:
    """Numbers of the best that are on other faces or far enough from each other."""
    chosen: list[int] = []
    for k in np.argsort(worth, kind="stable"):
        if all(faces[k] != faces[j] or np.linalg.norm(x[k] - x[j]) > apart for j in chosen):
            chosen.append(int(k))
        if len(chosen) == count:
            break
    return chosen
