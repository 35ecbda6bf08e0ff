"""What the campaign of a contact model says of a plan: impacts outside of what was measured, and a model that does not
fit it.
"""

import dataclasses as dc
from collections.abc import Mapping, Sequence
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .._errors import InputError
from ..contact.gripping import StrikeLaw
from ..dynamics.impact import follow
from ..families.impact import read_values
from ..inference.archive import FittedModel
from ..measurement.quantities import describe_quantity, join_words
from .draws import find_models
from .next_test import say_value
from .problem import StrikeProblem
from .scenario_file import Scenario
from .single import StrikePlan


SLACK = 0.02  # of a limit, by which a planned value may lie beyond it; as in predictions
STILL = 1e-3  # m/s, of the tangential speed, below which nobody would say that a ball slides
SPAN = 1.0  # s, after which no impact of a campaign lasts: long against any contact, so that nothing is cut
# What conditions of slip records are of an impact.
OF_SLIP = {"normal_load": "peak_normal_force", "internal_pressure": "initial_pressure",
           "slip_speed": "tangential_speed"}
# Fields of `Limits` that what was measured bounds from above.
LIMITED = {"approach_speed": "fastest", "tangential_speed": "slide", "peak_normal_force": "force",
           "peak_depression": "depression"}


@dc.dataclass(frozen=True)
class MeasuredRange:
    """Values of one quantity over the campaign of a fit."""

    quantity: str  # `approach_speed`, `peak_depression`, `peak_normal_force`, ..., or a condition that a scenario gives
    low: float  # lowest, SI
    high: float  # highest
    unit: str  # SI
    fit: str  # the folder, as the scenario names it


@dc.dataclass(frozen=True)
class Extrapolation:
    """A planned value outside of what was measured: number of the impact, from 1 on, and the value, SI."""

    impact: int
    value: float
    measured: MeasuredRange


@dc.dataclass(frozen=True)
class Misfit:
    """A contact model that does not fit its own campaign."""

    fit: str  # the folder, as the scenario names it
    campaign: str
    ratio: float  # RMS residual over noise


def find_contacts(scenario: Scenario, here: Path) -> dict[str, FittedModel]:
    """The fitted models that a scenario's contact is made from, by folder as the scenario names it; of several rivals
    the first with the largest weight; none for the paper's own ball.
    """
    return {name: max(models, key=lambda one: one[2])[1] for name, models in _find_fits(scenario, here).items()}


def find_rivals(scenario: Scenario, here: Path) -> tuple[FittedModel, ...]:
    """All fitted models that a scenario's contact may be, rivals too."""
    return tuple(model for models in _find_fits(scenario, here).values() for _, model, _ in models)


def find_assumed(scenario: Scenario, models: Sequence[FittedModel], problem: StrikeProblem) -> dict[str, float]:
    """What nothing says and is taken all the same, by key: the coefficient of friction where neither the scenario nor a
    fit to oblique impacts among its contact's models says any, and the arm's apparent mass where the scenario does not
    state it, which is that of the bench of a fit [kg].
    """
    ball, found = scenario.ball, {}
    said = ball.friction_model or "friction" in ball.model_fields_set
    if not (said or any(isinstance(one.law(), StrikeLaw) for one in models)):
        found["ball.friction"] = float(ball.friction)
    if scenario.arm.mass is None:
        found["arm.mass"] = float(problem.law.normal.reference.inertia())
    return found


def _find_fits(scenario: Scenario, here: Path) -> dict[str, list[tuple[str, FittedModel, float]]]:
    """Name, model and weight of every rival, by folder as the scenario names it."""
    fits = () if scenario.uncertainty is None else scenario.uncertainty.fit
    return {name: find_models(here / name)[0]
            for name in filter(None, (scenario.ball.model, scenario.ball.friction_model,
                                  *(fit.removesuffix("/result.json") for fit in fits)))}


def list_misfits(contacts: Mapping[str, FittedModel]) -> tuple[Misfit, ...]:
    """Those of the fitted models that leave more than noise of their own campaign, each campaign and model once."""
    return tuple(dict.fromkeys(Misfit(name, saved.campaign, saved.misfit) for name, saved in contacts.items()
                               if saved.misfit is not None))


def find_measured_ranges(contacts: Mapping[str, FittedModel]) -> tuple[MeasuredRange, ...]:
    """What the campaigns covered that contact models were fitted to, which are given by what the plan calls them.

    Of an impact the depression and force that the fitted model reaches at the campaign's fastest approach count where
    the campaign has no such channel. Of slip records the largest load, pressure and slip speed bound those of an
    impact, which itself passes through all smaller loads and speeds. Where no fit is of anything that slides, the
    tangential speed was measured at zero alone.
    """
    found: dict[tuple[str, str], MeasuredRange] = {}
    for name, saved in contacts.items():
        for one in list_ranges(saved, name):
            found.setdefault((one.quantity, saved.sha256), one)
    slid = any(quantity == "tangential_speed" for quantity, _ in found)
    return (*found.values(), *(MeasuredRange("tangential_speed", 0.0, 0.0, "m/s", name)
                               for name in list(contacts)[: not slid]))


def has_slid(ranges: Sequence[MeasuredRange]) -> bool:
    """Whether anything that slides was measured, or nothing at all was."""
    return not any(one.quantity == "tangential_speed" and one.high == 0.0 for one in ranges)


def list_ranges(saved: FittedModel, name: str) -> list[MeasuredRange]:
    """What the campaign of one fitted model covered; `name` is what the plan calls it."""
    impacts = saved.space.family.has_contact
    found = []
    for condition, (low, high) in saved.ranges.items():
        quantity = condition if impacts else OF_SLIP.get(condition, condition)
        if condition != "sequence":
            # An impact passes through all smaller loads and slip speeds than its largest.
            from_zero = quantity in ("tangential_speed", "peak_normal_force")
            found.append(MeasuredRange(quantity, 0.0 if from_zero else low, high, saved.units[condition], name))
    if impacts:
        largest = {} if saved.sampling is None else saved.sampling.largest
        for channel, value, unit in zip(("depression", "normal_force"), _reach(saved), ("m", "N"), strict=True):
            high = largest.get(channel, value)
            if np.isfinite(high):
                found.append(MeasuredRange(f"peak_{channel}", 0.0, high, unit, name))
    return found


def _reach(saved: FittedModel) -> tuple[float, float]:
    """Largest depression [m] and normal force [N] of the fitted model at the fastest approach of its campaign."""
    law = saved.law()
    law = law.normal if isinstance(law, StrikeLaw) else law
    given = {n: jnp.asarray(0.5 * (low + high)) for n, (low, high) in saved.ranges.items()}
    given["approach_speed"] = jnp.asarray(saved.ranges["approach_speed"][1])

    @eqx.filter_jit
    def press(law, pressures):
        def one(pressure):
            conditions = given | {"initial_pressure": pressure}
            values, _ = read_values(law, conditions, follow(law, conditions, jnp.asarray(SPAN)))
            return jnp.stack([values["peak_depression"], values["peak_normal_force"]])

        return jnp.max(jax.vmap(one)(pressures), axis=0)

    depression, force = np.asarray(press(law, jnp.asarray(saved.ranges.get("initial_pressure", (0.0, 0.0)))))
    return float(depression), float(force)


def list_extrapolations(ranges: Sequence[MeasuredRange], impacts: Sequence[StrikePlan], conditions=None
                        ) -> tuple[Extrapolation, ...]:
    """Every planned value outside of what was measured, by impact; `conditions` are what else the contact law is given.
    """
    found = []
    for number, plan in enumerate(impacts, 1):
        collision = plan.collision
        values = {name: float(value) for name, value in (conditions or {}).items()} | {
            "approach_speed": float(collision.approach_speed), "tangential_speed": float(collision.tangential_speed),
            "initial_pressure": float(plan.design.pressure), "peak_depression": float(collision.peak_depression),
            "peak_normal_force": float(collision.peak_force)}
        for one in ranges:
            value = values.get(one.quantity)
            slack = STILL if one.quantity == "tangential_speed" else 0.0
            if value is not None and not (
                    one.low - SLACK * abs(one.low) <= value <= max(one.high + SLACK * abs(one.high), slack)):
                found.append(Extrapolation(number, value, one))
    return tuple(found)


def confine(problem: StrikeProblem, ranges: Sequence[MeasuredRange]) -> StrikeProblem:
    """The problem with limits no wider than what was measured. Where nothing that slides was measured the tangential
    speed is not limited, as nearly every blow on a body that turns slides.

    Raises:
        InputError: Nothing was measured, or none of it lies within the limits.
    """
    if not ranges:
        raise InputError("no plan can stay within what was measured, as the contact is not that of a fit; name the "
                         "folder of one as ball.model, or leave this out", key="limits.within")
    limits = problem.limits
    low, high = (float(end) for end in limits.pressure)
    kept = {field: float(getattr(limits, field)) for field in ("approach", *LIMITED.values())}
    for one in ranges:
        if one.quantity == "initial_pressure":
            low, high = max(low, one.low), min(high, one.high)
        if one.quantity == "approach_speed":
            kept["approach"] = max(kept["approach"], one.low)
        if one.quantity in LIMITED and one.high > 0.0:
            kept[LIMITED[one.quantity]] = min(kept[LIMITED[one.quantity]], one.high)
    for name, least, most, unit in (("initial_pressure", low, high, "Pa"),
                                    ("approach_speed", kept["approach"], kept["fastest"], "m/s")):
        if least > most:
            raise InputError(f"the limits of the {describe_quantity(name).name} leave nothing of what was measured: "
                             f"{say_value(name, least, unit)} would have to be below {say_value(name, most, unit)}",
                             key="limits.within")
    return dc.replace(problem, limits=dc.replace(limits, pressure=np.array([low, high]), **kept), unit=None)


def format_extrapolation(found: Extrapolation) -> str:
    """`approach speed 2 m/s (measured 0.14 to 0.62 m/s)`."""
    one = found.measured
    quantity = one.quantity.removeprefix("peak_")
    high = say_value(quantity, one.high, one.unit)
    low = "up to" if one.low == 0 else f"{say_value(quantity, one.low, one.unit).split()[0]} to"
    told = f"measured {low} {high}" if one.high else "never measured"
    return f"{describe_quantity(quantity).name} {say_value(quantity, found.value, one.unit)} ({told})"


def warn_of_extrapolation(ranges: Sequence[MeasuredRange], impacts: Sequence[StrikePlan], conditions=None) -> str:
    """One sentence with the farthest value of every quantity; '' where all was measured; as `list_extrapolations`."""
    worst: dict[MeasuredRange, Extrapolation] = {}
    found = list_extrapolations(ranges, impacts, conditions)
    for one in sorted(found, key=lambda one: max(one.value - one.measured.high, one.measured.low - one.value)):
        worst[one.measured] = one
    if not worst:
        return ""
    fits = join_words(list(dict.fromkeys(Path(one.fit).name for one in worst)))
    told = join_words([format_extrapolation(one) for one in worst.values()])
    limited = any(one.high for one in worst)
    where = "there" if limited else "oblique impacts or slip records, to which friction can be fitted"
    return (f"The plan extrapolates beyond what {fits} was fitted to: {told}. Measure {where}"
            f"{', or narrow the limits' if limited else ''}.")
