"""Which limit, loosened alone, would let an impact be worth its while, and to what value.

Closed forms say from where on; a design there is refined on the integrated impact, which proves that the value does.
"""

import dataclasses as dc
import math
from collections.abc import Callable, Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from scipy.optimize import minimize

from .guesses import DRAWS, evolve_designs, find_bounds, pick_apart
from .strike_plan import ALLOWED, LOST, DesignSearch, Tally
from .strike_problem import CONSTRAINTS, StrikeProblem, allow_speed, score


STARTS, STEPS = 2, 80  # designs that are refined on the integrated impact, and steps of that at most
LOOSER = 1.5  # ratio of the limit under which they are refined to the one that closed forms see
VIOLATED = 1e3  # added to the worth of designs that violate something, so that all others come first
ROUND = 1e-9  # of a scaled constraint, by which it may be missed


@dc.dataclass(frozen=True)
class Relaxation:
    """A limit that stands in the way of every worthwhile impact, and what would do.

    Attributes:
        constraint: its name among `CONSTRAINTS`.
        key: of the scenario.
        unit: of both values.
        given: the limit as it is.
        needed: one at which an allowed impact that is worth its while was integrated, the tightest that was found.
    """

    constraint: str
    key: str
    unit: str
    given: float
    needed: float


@dc.dataclass(frozen=True)
class _Limit:
    """How one limit is loosened.

    Attributes:
        key, unit: as of `Relaxation`.
        field: of `Limits`.
        columns: of the constraints that it sets.
        loosen: a value that hardly limits anything, from the problem.
        read: the limit that a design just keeps, from the loosened limit and the least of its scaled constraints.
        upper: whether the quantity has to stay below the limit.
        scale: of the scenario's unit, in that of the field.
    """

    key: str
    unit: str
    field: str
    columns: tuple[str, ...]
    loosen: Callable[[StrikeProblem], float]
    read: Callable[[float, np.ndarray], np.ndarray]
    upper: bool = True
    scale: float = 1.0

    def is_looser(self, value: float, than: float) -> bool:
        """Whether one value of the limit allows more than another."""
        return value > than if self.upper else value < than


def _halve_ball(problem: StrikeProblem) -> float:
    """Half of the ball's diameter, up to where the contact geometry holds; of a pad, ten times its limit [m]."""
    diameter, given = float(problem.law.reference.ball.diameter()), float(problem.limits.depression)
    return max(0.5 * diameter, given) if diameter else 10.0 * given


LIMITS = (
    _Limit("limits.force", "N", "force", ("peak force",), lambda problem: 1e6, lambda limit, c: limit * (1.0 - c)),
    _Limit("limits.depression", "m", "depression", ("depression",), _halve_ball, lambda limit, c: limit * (1.0 - c)),
    _Limit("arm.speed", "m/s", "speed", ("arm's speed",), lambda problem: 100.0,
           lambda limit, c: limit * np.sqrt(np.maximum(1.0 - c, 0.0))),
    _Limit("limits.approach", "m/s", "approach", ("approach",),
           lambda problem: 1e-3 * float(problem.limits.approach), lambda limit, c: limit * (1.0 + c), upper=False),
    _Limit("limits.edge", "m", "edge", ("edge", "next edge"), lambda problem: 0.0,
           lambda limit, c: limit + 0.1 * c, upper=False),
    _Limit("arm.cone_degrees", "°", "cone", ("reachable side",), lambda problem: math.pi,
           lambda limit, c: np.arccos(np.clip(c + math.cos(limit), -1.0, 1.0)), scale=math.radians(1.0)),
)


def find_relaxations(problem: StrikeProblem, constraints: Sequence[str], gain: float, *, draws: int = DRAWS,
                     seed: int = 0) -> tuple[Relaxation, ...]:
    """Limits each of which would have to be looser, alone, for an impact that is worth its while.

    Args:
        problem: in which no impact is allowed, or none is worth its while.
        constraints: names of those that may stand in the way.
        gain: share of what is wanted small that an impact has to bring it down by [-].
        draws: designs of a generation; a power of 2.
        seed: of their places.

    Returns:
        In the order of `LIMITS`; none where no single limit among those named is enough.
    """
    found = []
    for limit in LIMITS:
        if not set(limit.columns) & set(constraints):
            continue
        given, loosest = float(getattr(problem.limits, limit.field)), limit.loosen(problem)
        if not limit.is_looser(loosest, given):
            continue
        needed = _find_tightest(problem, limit, loosest, gain, draws, seed)
        if needed is not None and limit.is_looser(needed, given):
            found.append(Relaxation(next(name for name in limit.columns if name in constraints), limit.key, limit.unit,
                                    given / limit.scale, needed / limit.scale))
    return tuple(found)


def _loosen(problem: StrikeProblem, limit: _Limit, value: float) -> StrikeProblem:
    """The problem with another value of one limit, its velocities in the unit that belongs to that."""
    loose = eqx.tree_at(lambda p: getattr(p.limits, limit.field), problem, jnp.asarray(value))
    return eqx.tree_at(lambda p: p.unit, loose, allow_speed(loose))


def _find_tightest(problem: StrikeProblem, limit: _Limit, loosest: float, gain: float, draws: int, seed: int
                   ) -> float | None:
    """The tightest value of a limit at which everything else is kept; None where there is none."""
    untouched = float(score(problem, problem.angular_velocity))
    own = np.array([name in limit.columns for name in CONSTRAINTS])
    sign = 1.0 if limit.upper else -1.0

    def rank(loosened: float):
        def judge(found: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            scores, values = found[:, 0], found[:, 1:]
            over = np.sum(np.maximum(-values[:, ~own], 0.0), axis=1)
            over = over + np.maximum(gain - (untouched - scores) / untouched, 0.0) / gain
            over = over + np.maximum(-np.min(values[:, own], axis=1), 0.0)
            needed = sign * limit.read(loosened, np.min(values[:, own], axis=1))
            worth = np.where(over > ROUND, VIOLATED * (1.0 + over), needed / max(abs(loosened), 1.0))
            return np.where(np.isfinite(worth), worth, np.inf), np.where(over > ROUND, np.inf, needed)

        return judge

    first = sign * evolve_designs(_loosen(problem, limit, loosest), draws, seed, rank=rank(loosest)).least
    if not math.isfinite(first):
        return None
    # Again under a limit of its own size, in which scaled constraints and velocities are of order one.
    near = LOOSER * first if limit.upper else first / LOOSER
    near = near if limit.is_looser(loosest, near) else loosest
    loose = _loosen(problem, limit, near)
    last = evolve_designs(loose, draws, seed, rank=rank(near))
    places = pick_apart(last.faces, last.x, last.worth, STARTS)
    proved = [_refine(loose, limit, near, gain, untouched, int(last.faces[k]), last.x[k]) for k in places]
    found = [value for value in proved if value is not None]
    return sign * min(sign * value for value in found) if found else None


def _refine(loose: StrikeProblem, limit: _Limit, loosened: float, gain: float, untouched: float, face: int,
            x: np.ndarray) -> float | None:
    """The tightest limit that a design keeps and is allowed under, on a descent (SLSQP) of the integrated impact; None
    where no design on the way is allowed.
    """
    search, bounds = DesignSearch(loose, face, Tally()), find_bounds(loose, face)
    # The next edge is farther off than the nearest: the first of the columns alone is what the limit holds.
    own = 1 + CONSTRAINTS.index(limit.columns[0])
    least = untouched * (1.0 - gain)

    def keep(values: np.ndarray) -> np.ndarray:
        return np.concatenate([[(least - values[0]) / (untouched * gain)], values[1:]])

    def keep_slopes(slopes: np.ndarray) -> np.ndarray:
        return np.concatenate([-slopes[:1] / (untouched * gain), slopes[1:]])

    passed = []

    def look(z: np.ndarray) -> np.ndarray:
        values = search.values(z)
        if values[0] < LOST and keep(values).min() >= -ALLOWED:
            passed.append(float(values[own]))
        return values

    minimize(
        lambda z: -look(z)[own], np.clip(x, *bounds.T), jac=lambda z: -search.slopes(z)[own], method="SLSQP",
        bounds=bounds, options={"maxiter": STEPS, "ftol": 1e-6},
        constraints={"type": "ineq", "fun": lambda z: keep(look(z)), "jac": lambda z: keep_slopes(search.slopes(z))})
    return float(limit.read(loosened, np.asarray(max(passed)))) if passed else None
