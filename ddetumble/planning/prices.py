"""What limits cost: which of them a plan reaches, and the multiplier of each that holds it, in words of the scenario;
and, of no plan, which of them, loosened alone, would let an impact be worth its while.

For the second, closed forms say from which value on; a design there is refined on the integrated impact, which proves
that this value does.
"""

import dataclasses as dc
import math
from collections.abc import Callable, Iterable

import equinox as eqx
import numpy as np

from .._display import Progress, stay_silent
from .._numerics import scalar
from .constraints import CONSTRAINTS
from .multistart import Place, evolve_designs, find_bounds
from .problem import VARIABLES, Limits, StrikeProblem, allow_speed, measure_goal, score
from .single import ALLOWED, LEAST_GAIN, LOST, ROUGH, StrikePlan, Tally, ask_scipy, descend, plan_strike


# By how much a limit is loosened to state its price: small against the limit, and a number that people can picture.
PART, MILLIMETRE, DEGREE, SECOND, MOMENT = 0.01, 1e-3, math.radians(1.0), 1.0, 0.1
# Of a scaled constraint or of a variable's range, within which a limit counts as reached: 1 % of most limits, and 1 mm
# of the distance from an edge, which nobody would call room. That a reached limit costs anything is another question.
REACHED = 0.01
STARTS, STEPS = 2, 80  # of designs that are refined for advice, and steps at most: cheaper than the plan's own search
# Ratio of the limit under which they are refined to the one that closed forms see, which may err by that much.
LOOSER = 1.5
LOOKS = 3  # under limits looser by this factor each, where no design could be refined
# Added to the worth of designs that violate something, far above any worth, so that all others come first.
VIOLATED = 1e3
ROUND = 1e-9  # of a scaled constraint, by which it may be missed: rounding, and no more


@dc.dataclass(frozen=True)
class Price:
    """What an impact, or a sequence of them, would gain if one limit were a little looser, all else optimised again."""

    key: str  # of the scenario
    change: str  # of the limit, in words
    gain: float  # decrease of what is wanted small, to first order
    # What that is: the `goal`, over what it was at the start [-]; of impacts together `share` [-], `impulse` [N s] or
    # `time` [s].
    of: str = "goal"


def _widen(limits: Limits, end: int) -> float:
    """Change of the scaled pressure that a bound moved by a part of itself allows; 0 where the pressure is given."""
    ends = [float(one) for one in limits.pressure]
    return 2.0 * PART * ends[end] / (ends[1] - ends[0]) if ends[1] > ends[0] else 0.0


def _wait(limits: Limits) -> float:
    early, late = (float(one) for one in limits.window)
    return 2.0 * SECOND / (late - early) if late > early else 0.0


def _hurry(limits: Limits) -> float:
    """As `_wait`, and 0 where the window would begin before the motion does."""
    return _wait(limits) if float(limits.window[0]) >= SECOND else 0.0


def _hurry_again(limits: Limits) -> float:
    """As `_hurry`, of an impact after another, and 0 where the window would begin before the shortest wait."""
    return _wait(limits) if float(limits.window[0]) >= SECOND + limits.shortest_wait() else 0.0


# Key, change, and how much the scaled constraint or variable then allows.
PRICES: dict[str, tuple[str, str, Callable[[Limits], float]]] = {
    CONSTRAINTS.speed: ("arm.speed", "1 % more", lambda limits: 2.0 * PART),
    CONSTRAINTS.force: ("limits.force", "1 % more", lambda limits: PART),
    CONSTRAINTS.depression: ("limits.depression", "1 % more", lambda limits: PART),
    CONSTRAINTS.approach: ("limits.approach", "1 % less", lambda limits: PART),
    CONSTRAINTS.edge: ("limits.edge", "1 mm less", lambda limits: MILLIMETRE / 0.1),
    CONSTRAINTS.next_edge: ("limits.edge", "1 mm less", lambda limits: MILLIMETRE / 0.1),
    CONSTRAINTS.side: ("arm.cone_degrees", "1° more", lambda limits: math.sin(float(limits.cone)) * DEGREE),
    CONSTRAINTS.fastest: ("limits.within", "measured 1 % faster", lambda limits: PART),
    CONSTRAINTS.slide: ("limits.within", "measured sliding 1 % faster", lambda limits: 2.0 * PART),
    CONSTRAINTS.target: ("limits.target_radius", "1 % more", lambda limits: 2.0 * PART),
    "highest pressure": ("limits.pressure", "the highest 1 % more", lambda limits: _widen(limits, 1)),
    "lowest pressure": ("limits.pressure", "the lowest 1 % less", lambda limits: _widen(limits, 0)),
    "highest instant": ("limits.window", "1 s later", _wait),
    "lowest instant": ("limits.window", "1 s earlier", _hurry),
}
# Of the impacts after the first; the second where the shortest wait holds them, which is twice the clearance time.
AGAIN = PRICES | {"lowest instant": ("limits.window", "1 s earlier", _hurry_again)}
CLEARING = PRICES | {"lowest instant": ("arm.clearance_time", "0.1 s less",
                                        lambda limits: 2.0 * MOMENT / SECOND * _wait(limits))}


def price_limits(limits: Limits, plans: Iterable[StrikePlan], of: str = "goal", unit: float = 1.0, first: int = 1
                 ) -> tuple[Price, ...]:
    r"""Prices of the limits that hold a planned impact, or several that were optimised together, the dearest first.

    With the multiplier $\lambda$ of a constraint $c(x, l) \ge 0$, the optimum falls by
    $\lambda\,\partial c/\partial l\,\Delta l$ where the limit $l$ is changed by $\Delta l$ (envelope theorem); that
    of impacts together by the sum over them, as a limit holds for all. `unit` is what a multiplier counts, of `of`;
    `first` is the number in its sequence, from 1 on, of the first of the impacts, as those after number 1 have to wait.
    There are none where a plan is no optimum, as its multipliers mean nothing.
    """
    found: dict[tuple[str, str], float] = {}
    certificates = [plan.certificate for plan in plans]
    if any(one.stationarity > ROUGH for one in certificates):
        return ()
    later = limits.wait_again()
    again = CLEARING if float(later.window[0]) > float(limits.window[0]) else AGAIN
    for number, one in enumerate(certificates, first):
        words, own = (PRICES, limits) if number == 1 else (again, later)
        for name, multiplier in one.binding.items():
            key, change, allow = words.get(name, ("", "", lambda limits: 0.0))
            gain = multiplier * allow(own) * unit
            if gain > 0.0:
                found[key, change] = found.get((key, change), 0.0) + gain
    return tuple(sorted((Price(key, change, gain, of) for (key, change), gain in found.items()),
                        key=lambda price: -price.gain))


def price_sequence(problem: StrikeProblem, impacts: Iterable[StrikePlan]) -> tuple[tuple[Price, ...], ...]:
    """Prices of every impact of a sequence that were planned one after the other, all in shares of the goal at the
    start, although each was planned for what the one before left; of a goal that weighs several quantities they are in
    proportion to what was left of the whole.
    """
    found, left = [], 1.0
    for number, one in enumerate(impacts, 1):
        unit = left / one.untouched if one.untouched > 0.0 else 0.0
        found.append(price_limits(problem.limits, [one], unit=unit, first=number))
        left = measure_goal(problem, one.collision.angular_velocity)
    return tuple(found)


# Of the limits that `within` may narrow: key and change as above, what it is called then, and its field and end.
NARROWED = (
    ("limits.force", "1 % more", "measured force 1 % more", "force", None),
    ("limits.depression", "1 % more", "measured depression 1 % more", "depression", None),
    ("limits.approach", "1 % less", "measured 1 % slower", "approach", None),
    ("limits.pressure", "the highest 1 % more", "highest measured pressure 1 % more", "pressure", 1),
    ("limits.pressure", "the lowest 1 % less", "lowest measured pressure 1 % less", "pressure", 0),
)


def name_narrowed(prices: Iterable[Price], given: Limits, narrowed: Limits) -> tuple[Price, ...]:
    """Prices under limits that were narrowed to what was measured: of those that hold there, not of the wider ones in
    the scenario, of which a looser value would gain nothing.
    """
    words = {(key, change): shown for key, change, shown, field, end in NARROWED
             if _read_end(narrowed, field, end) != _read_end(given, field, end)}
    return tuple(dc.replace(one, key="limits.within", change=words[one.key, one.change])
                 if (one.key, one.change) in words else one for one in prices)


def _read_end(limits: Limits, field: str, end: int | None) -> float:
    value = getattr(limits, field)
    return float(value if end is None else value[end])


def list_reached(plan: StrikePlan) -> tuple[str, ...]:
    """Names of the limits that an impact reaches, to within `REACHED`: constraints, and ends of the pressure and of the
    window, from their values and not from the gradient, which vanishes where nothing is left to gain.
    """
    near = [name for name, value in plan.values.items() if value < REACHED]
    for name in ("pressure", "instant"):
        own = float(plan.x[VARIABLES.index(name)])
        near += [f"{end} {name}" for end, sign in (("lowest", -1.0), ("highest", 1.0))
                 if 1.0 - sign * own < 2 * REACHED]
    return tuple(near)


@dc.dataclass(frozen=True)
class Relaxation:
    """A limit that stands in the way of every worthwhile impact, and what would do."""

    constraint: str  # its name among `CONSTRAINTS`
    key: str  # of the scenario
    unit: str  # of both values
    given: float  # the limit as it is
    needed: float  # one at which an allowed impact that is worth its while was integrated, the tightest that was found


@dc.dataclass(frozen=True)
class _Limit:
    """How one limit is loosened: its key and unit in the scenario, which is `scale` in that of the `field` of `Limits`;
    the constraints that it sets, the one that holds a design first; a value that hardly limits anything; the limit that
    a design just keeps, from the loosened limit and the least of its scaled constraints; `sign` -1 where the quantity
    has to stay above.
    """

    key: str
    unit: str
    field: str
    constraints: tuple[str, ...]
    loosen: Callable[[StrikeProblem], float]
    read: Callable[[float, np.ndarray], np.ndarray]
    sign: float = 1.0
    scale: float = 1.0


def _halve_ball(problem: StrikeProblem) -> float:
    """Half of the ball's diameter, up to where the contact geometry holds; of a pad, ten times its limit [m]."""
    diameter, given = float(problem.law.reference.ball.diameter()), float(problem.limits.depression)
    return max(0.5 * diameter, given) if diameter else 10.0 * given


def _bear_load(problem: StrikeProblem) -> float:
    """Load up to which the friction model holds, a million newtons where it holds at any [N]."""
    return problem.law.reference.friction.valid.get("normal_load", (0.0, 1e6))[1]


LIMITS = (
    _Limit("limits.force", "N", "force", (CONSTRAINTS.force,), _bear_load,
           lambda limit, c: limit * (1.0 - c)),
    _Limit("limits.depression", "m", "depression", (CONSTRAINTS.depression,), _halve_ball,
           lambda limit, c: limit * (1.0 - c)),
    _Limit("arm.speed", "m/s", "speed", (CONSTRAINTS.speed,), lambda problem: 100.0,
           lambda limit, c: limit * np.sqrt(np.maximum(1.0 - c, 0.0))),
    _Limit("limits.approach", "m/s", "approach", (CONSTRAINTS.approach,),
           lambda problem: 1e-3 * float(problem.limits.approach), lambda limit, c: limit * (1.0 + c), sign=-1.0),
    _Limit("limits.edge", "m", "edge", (CONSTRAINTS.edge, CONSTRAINTS.next_edge), lambda problem: 0.0,
           lambda limit, c: limit + 0.1 * c, sign=-1.0),
    _Limit("arm.cone_degrees", "°", "cone", (CONSTRAINTS.side,), lambda problem: math.pi,
           lambda limit, c: np.arccos(np.clip(c + math.cos(limit), -1.0, 1.0)), scale=math.radians(1.0)),
)


def find_relaxations(problem: StrikeProblem, refused: StrikePlan, *, seed: int = 0,
                     progress: Progress = stay_silent) -> tuple[Relaxation, ...]:
    """Limits each of which would have to be looser, alone, for an impact that is worth its while, in the order of
    `LIMITS`: those that hold the refused impact, or that it misses or just keeps. None where no single one of these is
    enough.
    """
    binding = refused.certificate.binding
    obstacles = [name for name in CONSTRAINTS if name in binding and (binding[name] > 0.0 or not refused.allowed)]
    found = []
    for limit in LIMITS:
        own = [name for name in limit.constraints if name in obstacles]
        given, loosest = float(getattr(problem.limits, limit.field)), limit.loosen(problem)
        if own and limit.sign * loosest > limit.sign * given:
            progress(f"looking for the limit that stands in the way: {limit.key}", math.nan)
            needed = _find_tightest(problem, limit, loosest, seed)
            if needed is not None and limit.sign * needed > limit.sign * given:
                found.append(Relaxation(own[0], limit.key, limit.unit, given / limit.scale, needed / limit.scale))
    return tuple(found)


def _find_tightest(problem: StrikeProblem, limit: _Limit, loosest: float, seed: int) -> float | None:
    """The tightest value of a limit at which everything else is kept; None where there is none."""
    untouched = float(score(problem, problem.angular_velocity))
    own = np.array([name in limit.constraints for name in CONSTRAINTS])

    def loosen(value: float) -> StrikeProblem:
        """The problem with another value of the limit, its velocities in the unit that belongs to that."""
        loose = eqx.tree_at(lambda p: getattr(p.limits, limit.field), problem, scalar(value))
        return eqx.tree_at(lambda p: p.unit, loose, allow_speed(loose))

    def rank(loosened: float):
        def judge(found: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            scores, values = found[:, 0], found[:, 1:]
            over = np.sum(np.maximum(-values[:, ~own], 0.0), axis=1)
            over = over + np.maximum(LEAST_GAIN - (untouched - scores) / untouched, 0.0) / LEAST_GAIN
            over = over + np.maximum(-np.min(values[:, own], axis=1), 0.0)
            needed = limit.sign * limit.read(loosened, np.min(values[:, own], axis=1))
            over = np.where(np.isfinite(over + needed), over, np.inf)  # nothing can be told of what cannot be computed
            worth = np.where(over > ROUND, VIOLATED * (1.0 + over), needed / max(abs(loosened), 1.0))
            return worth, np.where(over > ROUND, np.inf, needed)

        return judge

    first = limit.sign * evolve_designs(loosen(loosest), seed=seed, rank=rank(loosest)).least
    if not math.isfinite(first):
        return None
    # Again under a limit of its own size, in which scaled constraints and velocities are of order one.
    near = limit.sign * min(limit.sign * loosest, limit.sign * first * LOOSER**limit.sign)
    loose = loosen(near)
    places = evolve_designs(loose, seed=seed, rank=rank(near)).pick(STARTS)
    found = [value for place in places if (value := _refine(loose, limit, near, untouched, place)) is not None]
    if found:
        return limit.sign * min(limit.sign * value for value in found)
    # Closed forms erred, or a descent of two designs was too little: a whole search under limits that get looser.
    for step in range(LOOKS):
        value = limit.sign * min(limit.sign * loosest, limit.sign * near * LOOSER ** (limit.sign * step))
        if plan_strike(loosen(value), seed=seed).worth:
            return value
    return None


def _refine(loose: StrikeProblem, limit: _Limit, loosened: float, untouched: float, place: Place) -> float | None:
    """The tightest limit that a design keeps and is allowed under, on a descent of the integrated impact, or None."""
    values, slopes = ask_scipy(loose, place[0], Tally())
    bounds = find_bounds(loose, place[0])
    # The next edge is farther off than the nearest: the first of the constraints alone is what the limit holds.
    own = 1 + CONSTRAINTS.index(limit.constraints[0])
    passed = []

    def pose(found: np.ndarray, least: float) -> np.ndarray:
        """What is to be small is the limit that is needed; that the impact is worth its while is a constraint."""
        gain = (least - found[:1]) / (untouched * LEAST_GAIN)
        return np.concatenate([-found[own: own + 1], gain, found[1:]])

    def look(z: np.ndarray) -> np.ndarray:
        posed = pose(values(z), untouched * (1.0 - LEAST_GAIN))
        if values(z)[0] < LOST and posed[1:].min() >= -ALLOWED:
            passed.append(-float(posed[0]))
        return posed

    descend(look, lambda z: pose(slopes(z), 0.0), np.clip(place[1], *bounds.T), bounds, STEPS, 1e-6)
    return float(limit.read(loosened, np.asarray(max(passed)))) if passed else None
