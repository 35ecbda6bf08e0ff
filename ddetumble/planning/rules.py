"""What simple rules make of the place of a planned impact: a straight blow, and one against the point's motion."""

import dataclasses as dc
import math
from typing import Any

import jax.numpy as jnp
import numpy as np
from scipy.optimize import minimize_scalar

from .._rotation import rotate, rotate_back
from .constraints import CONSTRAINTS, MISSED
from .problem import SLIPS, SPEED, StrikeProblem, measure_share, read_design, span_plane, strike_debris
from .single import ALLOWED, StrikePlan, compute_impact


SPEEDS = 24  # of the arm at which a rule is tried before the best is refined: the score is smooth in it
BROKEN_BY = 1e-3  # scaled, by which a limit counts as violated: what the search along a line leaves
BROKEN = 10.0  # of a violated limit, in units of the score: far above any gain, so that limits win


@dc.dataclass(frozen=True)
class Blow:
    """What a rule makes of the place, instant and pressure of a plan."""

    rule: str  # its words
    # Of the angular momentum before that it leaves with the plan's arm speed, whatever limits it violates [-]; nan
    # where the ball does not strike.
    share: float
    violated: tuple[str, ...]  # names of these limits
    speed: float  # of the arm, the best that the limits allow [m/s]; nan where none is allowed
    allowed_share: float  # of the angular momentum that this leaves [-]


def compare_rules(problem: StrikeProblem, plan: StrikePlan) -> tuple[Blow, ...]:
    """What two rules leave at the place, instant and pressure of a plan: a straight blow along the normal, and the
    paper's rule (its introduction), against the velocity of the point that is struck.
    """
    design = plan.design
    moving = np.asarray(rotate(design.attitude, jnp.cross(design.angular_velocity, design.point)))
    ways = (("straight along the normal", -np.asarray(design.normal)),
            ("against the velocity of the struck point", -moving / max(float(np.linalg.norm(moving)), 1e-300)))
    return tuple(_strike_along(problem, plan, rule, way) for rule, way in ways)


def _strike_along(problem: StrikeProblem, plan: StrikePlan, rule: str, way: np.ndarray) -> Blow:
    """Blows along a direction `way`, inertial, unit, shape (3,): with the plan's speed, and with the best allowed."""
    face, design, most = plan.place[0], plan.design, float(problem.limits.speed)
    outward = rotate_back(design.attitude, design.normal)
    normal, first, second = (np.asarray(one) for one in (outward, *span_plane(outward)))
    surface = np.cross(design.angular_velocity, design.point)
    local = np.asarray(rotate_back(design.attitude, jnp.asarray(way)))

    def place(speed: float) -> np.ndarray:
        relative = (speed * local - surface) / float(problem.unit)
        x = plan.x.copy()
        x[SPEED], x[SLIPS] = -normal @ relative, (first @ relative, second @ relative)
        return x

    def judge(speed: float) -> float:
        found = compute_impact(problem, face, place(speed))
        return float(found[0] + BROKEN * np.sum(np.maximum(-found[1:] - ALLOWED, 0.0)))

    speeds = most * np.arange(1, SPEEDS + 1) / SPEEDS
    k = int(np.argmin([judge(speed) for speed in speeds]))
    low, high = speeds[k] - most / SPEEDS, min(speeds[k] + most / SPEEDS, most)
    found: Any = minimize_scalar(judge, bounds=(low, high), method="bounded", options={"xatol": 1e-6 * most})
    best = min((float(found.x), float(speeds[k])), key=judge)

    def leave(speed: float) -> tuple[float, tuple[str, ...]]:
        x = place(speed)
        kept = zip(CONSTRAINTS, compute_impact(problem, face, x)[1:], strict=True)
        violated = tuple(name for name, value in kept if value < -BROKEN_BY)
        if x[SPEED] <= MISSED * float(problem.limits.approach / problem.unit):  # along the surface: no blow at all
            return measure_share(problem, problem.angular_velocity), violated
        after = strike_debris(problem, read_design(problem, jnp.asarray(face), jnp.asarray(x)))
        if bool(after.failed) or not bool(after.separated):
            return math.nan, ()
        return measure_share(problem, after.angular_velocity), violated

    share, violated = leave(float(np.linalg.norm(design.velocity)))
    kept, over = leave(best)
    return Blow(rule, share, violated, *((math.nan, math.nan) if over or math.isnan(kept) else (best, kept)))
