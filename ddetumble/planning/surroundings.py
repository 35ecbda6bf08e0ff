"""The pressure around the ball: that of the tests belongs to them, and not to the ball that strikes in orbit."""

import dataclasses as dc
from collections.abc import Sequence
from typing import Any

import equinox as eqx

from .._numerics import scalar
from ..contact.effect import AbstractEffect
from ..effects.impact import AmbientPressure
from ..inference.archive import FittedModel


@dc.dataclass(frozen=True)
class Surroundings:
    """A fitted contact whose tests were made under another pressure than the plan's impacts."""

    campaign: str  # of the tests
    fitted: float  # ambient pressure that the fit found [Pa]
    planned: float  # ambient pressure of the impacts [Pa]


def find_ambient(effects: Sequence[AbstractEffect]) -> Any:
    """Pressure [Pa] that pushes back on the contact by these effects, may be traced; 0 where none says so."""
    return next((effect.p_a for effect in effects if isinstance(effect, AmbientPressure)), scalar(0.0))


def surround(effects: Sequence[AbstractEffect], pressure: float) -> tuple[AbstractEffect, ...]:
    """The same effects under another ambient pressure [Pa]; where they have none, one that is not nought is added."""
    found = tuple(eqx.tree_at(lambda one: one.p_a, effect, scalar(pressure)) if isinstance(effect, AmbientPressure)
                  else effect for effect in effects)
    lacks = pressure and not any(isinstance(effect, AmbientPressure) for effect in effects)
    return (*found, AmbientPressure(scalar(pressure))) if lacks else found


def list_surroundings(models: Sequence[FittedModel], effects: Sequence[AbstractEffect]) -> tuple[Surroundings, ...]:
    """Fits whose ambient pressure is not that of the law that is planned with, which has these effects."""
    planned, found = float(find_ambient(effects)), []
    for saved in models:
        fitted = float(find_ambient(saved.law().effects))
        if fitted not in (0.0, planned):
            found.append(Surroundings(saved.campaign, fitted, planned))
    return tuple(dict.fromkeys(found))
