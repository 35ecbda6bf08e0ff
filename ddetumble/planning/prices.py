"""What each limit of a plan costs: its multiplier, in words of the scenario."""

import dataclasses as dc
import math
from collections.abc import Callable

from .constraints import CONSTRAINTS
from .problem import Limits
from .single import StrikePlan


# By how much a limit is loosened to state its price: small against the limit, and a number that people can picture.
PART, MILLIMETRE, DEGREE, SECOND = 0.01, 1e-3, math.radians(1.0), 1.0


@dc.dataclass(frozen=True)
class Price:
    """What an impact would gain if one limit were a little looser, all else optimised again."""

    key: str  # of the scenario
    change: str  # of the limit, in words
    gain: float  # decrease of what is wanted small [-], to first order


def _widen(limits: Limits, end: float) -> float:
    """Change of the scaled pressure that a bound moved by a part of itself allows."""
    low, high = (float(one) for one in limits.pressure)
    return 2.0 * PART * end / (high - low)


def _wait(limits: Limits) -> float:
    early, late = (float(one) for one in limits.window)
    return 2.0 * SECOND / (late - early)


# Key, change, and how much the scaled constraint or variable then allows.
LIMITS: dict[str, tuple[str, str, Callable[[Limits], float]]] = {
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
    "highest pressure": ("limits.pressure", "the highest 1 % more", lambda limits: _widen(
        limits, float(limits.pressure[1]))),
    "lowest pressure": ("limits.pressure", "the lowest 1 % less", lambda limits: _widen(
        limits, float(limits.pressure[0]))),
    "highest instant": ("limits.window", "1 s later", _wait),
    "lowest instant": ("limits.window", "1 s earlier", _wait),
}


def price_limits(limits: Limits, plan: StrikePlan) -> tuple[Price, ...]:
    r"""Prices of the limits that hold a planned impact, the dearest first.

    With the multiplier $\lambda$ of a constraint $c(x, l) \ge 0$, the optimum falls by
    $\lambda\,\partial c/\partial l\,\Delta l$ where the limit $l$ is changed by $\Delta l$ (envelope theorem).
    """
    found: dict[tuple[str, str], float] = {}
    for name, multiplier in plan.certificate.binding.items():
        if name in LIMITS and multiplier > 0.0:
            key, change, allow = LIMITS[name]
            found[key, change] = found.get((key, change), 0.0) + multiplier * allow(limits)
    return tuple(sorted((Price(key, change, gain) for (key, change), gain in found.items()),
                        key=lambda price: -price.gain))
