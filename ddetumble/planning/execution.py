"""What errors of the arm, and of the estimate of the motion, make of a planned impact."""

import dataclasses as dc
import math
from collections.abc import Mapping, Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._display import Progress, stay_silent
from .._rotation import rotate
from ..dynamics.collision import Collision
from .draws import draw_normals, split_batch
from .errors import NAMES, err
from .problem import Design, StrikeProblem, measure_goal, measure_share, read_design, strike_debris
from .scenario_file import ErrorTable
from .single import StrikePlan


OF_THE_ARM = ("instant", "place", "direction", "speed")  # drawn anew for every impact; all else is of the body
# Share of the momentum before, by which more of it has to be there afterwards to count: what rounding never makes, and
# what nobody would measure.
RAISED = 5e-4
PASSED = 0.05  # of force or depression, by which an erring impact may pass the limit before that is called so


@dc.dataclass(frozen=True)
class Spread:
    """The momentum left under draws of one error, or of all."""

    error: str  # its name; `all` of all together
    size: float  # its standard deviation, SI or as a fraction; nan of all
    mean: float  # share of the angular momentum left, 1 where the ball misses [-]
    q95: float  # that 95 % of the draws stay below
    missed: float  # share of the draws in which the ball meets no surface, or an edge of it
    violated: float  # share of the draws in which force, depression or another limit of the contact is passed
    drift: tuple[float, float]  # speed that the blow gives the body, mean and standard deviation [m/s]
    raised: float  # share of the draws in which there is more momentum than before the first impact
    untaken: float  # share of the draws in which no momentum is taken, these among them
    goal: float  # mean of what is wanted small, over that before the first impact [-]; the momentum where that is it
    goal_q95: float  # that 95 % of the draws stay below
    ever_missed: float  # share of the draws in which the ball misses here or at an impact before
    ever_violated: float  # share of the draws in which a limit is passed here or at an impact before


def draw_errors(sizes: Mapping[str, float], count: int, seed: int) -> list[dict[str, Array]]:
    """Draws of all errors, three numbers each by name, from their standard deviations; a centre of mass that is known
    has none, so that the surface stays as it is.
    """
    names = [name for name in NAMES if sizes.get(name, 0.0) > 0.0 or name != "centre"]
    drawn = draw_normals(count, 3 * len(names), seed).reshape(count, len(names), 3)
    return [{name: jnp.asarray(sizes.get(name, 0.0) * row[k]) for k, name in enumerate(names)} for row in drawn]


def try_errors(problem: StrikeProblem, plan: StrikePlan, errors: ErrorTable, seed: int = 0,
               progress: Progress = stay_silent) -> tuple[Spread, ...]:
    """Momentum left by a planned impact under errors drawn of each kind alone, in the order of `NAMES` and left out
    where its size is zero, and last of all together.
    """
    random = np.random.default_rng(seed)
    sizes = {name: size for name, size in errors.sizes().items() if size > 0.0}
    groups = [*((name,) for name in sizes), tuple(sizes)]
    drawn = {name: np.zeros((len(groups), errors.draws, 3)) for name in NAMES if name in sizes or name != "centre"}
    for k, group in enumerate(groups):
        for name in group:
            drawn[name][k] = sizes[name] * random.normal(size=(errors.draws, 3))
    met = _err_all(problem, plan.design, {name: jnp.asarray(own.reshape(-1, 3)) for name, own in drawn.items()})
    # One by one, as the program of one impact is there already and that of many would have to be compiled.
    rows, posed = [], split_batch(met)
    for k, one in enumerate(posed):
        progress(f"trying errors of the arm and of the motion: {k} of {len(posed)} draws", math.nan)
        *told, after = _strike_once(*one)
        rows.append((*told, np.linalg.norm(_read_drift(after)), 1.0 if after is None else measure_goal(
            one[0], after.angular_velocity)))
    columns = np.moveaxis(np.reshape(rows, (len(groups), -1, 5)), 2, 1)
    return tuple(_summarise(name, sizes.get(name, np.nan), own[None])[0]
                 for name, own in zip((*sizes, "all"), columns, strict=True))


def follow_errors(problem: StrikeProblem, impacts: Sequence[StrikePlan], errors: ErrorTable, seed: int = 0,
                  progress: Progress = stay_silent) -> tuple[Spread, ...]:
    """Momentum left after each impact of a sequence under draws of all errors together, and what happens at each.

    The first impact is struck by the estimate of the motion. Before each further one the arm has looked again: it
    strikes at the planned place of the body as that moves by then, with errors of its own drawn anew, and nothing is
    planned again. A ball that misses leaves the motion as it was. The drift adds up.
    """
    sizes, count = errors.sizes(), errors.draws
    arm = {name: size if name in OF_THE_ARM else 0.0 for name, size in sizes.items()} | {"centre": 0.0}
    drawn = [draw_errors(sizes if k == 0 else arm, count, seed + k) for k in range(len(impacts))]
    rows = np.zeros((len(impacts), 5, count))
    for i in range(count):
        progress(f"trying errors at all impacts: {i} of {count} draws", math.nan)
        now, share, drift, begun = problem, 1.0, np.zeros(3), problem
        for k, plan in enumerate(impacts):
            true, met, margin = _meet(now, plan.design.face, jnp.asarray(plan.x), drawn[k][i])
            begun = begun if k else true
            left, missed, violated, after = _strike_once(true, met, margin)
            share, drift = share * left, drift + _read_drift(after)
            moved = met if after is None else after
            now = true.begin_after(moved.attitude, moved.angular_velocity)
            rows[k, :, i] = share, missed, violated, np.linalg.norm(drift), measure_goal(begun, moved.angular_velocity)
    return _summarise("all", np.nan, rows)


def _summarise(error: str, size: float, rows: np.ndarray) -> tuple[Spread, ...]:
    """What all draws of an error come to after each impact, from their share of the momentum, whether the ball misses
    and whether a limit is passed, drift and goal, shape (impacts, 5, draws).
    """
    so_far = np.maximum.accumulate(rows[:, 1:3], axis=0).mean(axis=2)
    return tuple(
        Spread(error, size, mean=float(share.mean()), q95=float(np.quantile(share, 0.95)), missed=float(missed.mean()),
               violated=float(violated.mean()), drift=(float(drift.mean()), float(drift.std())),
               raised=float(np.mean(share > 1.0 + RAISED)), untaken=float(np.mean(share > 1.0 - RAISED)),
               goal=float(goal.mean()), goal_q95=float(np.quantile(goal, 0.95)), ever_missed=float(ever[0]),
               ever_violated=float(ever[1]))
        for (share, missed, violated, drift, goal), ever in zip(rows, so_far, strict=True))


@eqx.filter_jit
def _meet(problem: StrikeProblem, face: Array, x: Array, error: Mapping[str, Array]
          ) -> tuple[StrikeProblem, Design, Array]:
    """`err` of the impact of seven variables."""
    return err(problem, read_design(problem, face, x), error)


_err_all = eqx.filter_jit(eqx.filter_vmap(err, in_axes=(None, None, 0)))


def _read_drift(after: Collision | None) -> np.ndarray:
    """Velocity that a collision gives the body, shape (3,) [m/s]; none where there is none."""
    return np.zeros(3) if after is None else np.asarray(after.velocity)


def _strike_once(true: StrikeProblem, met: Design, margin: Array) -> tuple[float, bool, bool, Collision | None]:
    """Share left of the momentum before, whether the ball misses, whether a limit is passed, and the collision; none
    where the ball misses.
    """
    approach = (np.asarray(met.velocity) - np.asarray(rotate(met.attitude, jnp.cross(met.angular_velocity, met.point)))
                ) @ -np.asarray(met.normal)
    if margin <= 0.0 or approach <= 0.0:
        return 1.0, True, False, None
    after, limits = strike_debris(true, met), true.limits
    if bool(after.failed) or not bool(after.separated):
        return 1.0, True, False, None
    violated = (float(after.peak_force) > (1.0 + PASSED) * float(limits.force) or float(after.margin) < 0.0
                or float(after.peak_depression) > (1.0 + PASSED) * float(limits.depression))
    return measure_share(true, after.angular_velocity), False, violated, after
