"""Impacts: a ball held by an arm touches a plate at a speed, and its normal force is measured until it separates."""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import diffrax as dfx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..dynamics.impact import simulate_impact
from ..effects import IMPACT as EFFECTS
from ..effects.directions import IMPACT_DIRECTIONS
from ..effects.free import IMPACT_GROUND
from ..measurement import kinds
from ..reference_models import MODELS
from .family import SPLINES, Family, Observation, PlannedTests, Span, View
from .pulses import list_guesses


# Samples that records are padded to: few sizes, so that few programs are compiled.
SIZES = (768, 1536, 2048, 4096, 8192, 16384, 32768)


def observe_contact(run: Callable[..., Any], law: Any, conditions: Mapping[str, Array], time: Array, row: Any,
                    channels: tuple[str, ...]) -> Observation:
    """An impact, straight (`simulate`) or oblique (`strike`), in forward mode; the force is read off the motion."""
    found = run(law, conditions, time, span=row.span, adjoint=dfx.ForwardMode(), rtol=row.rtol, atol=0.01 * row.rtol,
                from_motion=True)
    model = jnp.stack([getattr(found, channel) for channel in channels])
    return Observation(model, found.depression, found.depression_rate, found.separation, found.failed)


def lay_contact(time: np.ndarray, values: np.ndarray, strokes: np.ndarray, end: float) -> list[Span]:
    """The contact, and what follows it."""
    return [Span(0.0, end, SPLINES), Span(end, float(time[-1]), max(SPLINES // 4, 4))]


VIEW = View(
    "normal_force", "time", "depression", "depression_rate", ("loading", "unloading"),
    ("depression", "depression_rate", "time"), "share of the contact time", ("touch", "separation"), (-0.06, 1.12), 15,
    2, False, "impact of the series", "loading and unloading", "mass, restitution",
)  # fmt: skip
PLAN = PlannedTests(
    chosen=("initial_pressure", "approach_speed"),
    added={"depression": "0.02 mm", "pressure": "2 kPa"},
    noise={"normal_force": "0.25 N"},
    uncertainties={"initial_pressure": "0.5 %", "approach_speed": "0.3 %", "time": "0.05 ms"},
    interval="0.25 ms",
    length=None,
)
IMPACT = Family(
    name="impact",
    kind=kinds.IMPACT,
    independent="time",
    channels=("normal_force", "depression", "pressure"),
    needs=("approach_speed",),
    defaults={"initial_pressure": 0.0},
    sizes=SIZES,
    models=MODELS,
    accepts=("impact",),
    catalogue=EFFECTS,
    directions=IMPACT_DIRECTIONS,
    state="depression",
    rate="depression_rate",
    phases=("loading", "unloading"),
    observe=partial(observe_contact, simulate_impact),
    lay_spans=lay_contact,
    view=VIEW,
    plan=PLAN,
    ground=IMPACT_GROUND,
    remedies="measure at other pressures and speeds, or add the depression and pressure channels",
    guess_starts=list_guesses,
)
