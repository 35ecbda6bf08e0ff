"""Oblique impacts: impacts with a speed along the plate, whose tangential force is measured too."""

import dataclasses as dc
from functools import partial

import numpy as np

from .._errors import InputError
from ..dynamics.strike import simulate_oblique_impact
from ..effects import OBLIQUE as OBLIQUE_EFFECTS
from ..effects import SLIP as SLIP_EFFECTS
from ..effects.directions import OBLIQUE_DIRECTIONS
from ..measurement.campaign import Campaign
from ..reference_models import OBLIQUE_MODELS
from .impact import IMPACT, SIZES, observe_contact


CROSSTALK = 0.05  # share of the normal force that gauges of several axes may read along the plate, either way


def check_directions(campaign: Campaign) -> None:
    """Refuse oblique records whose friction pushes the ball on: speed and force are given along axes that differ.

    Raises:
        InputError: A tangential speed is negative, or a tangential force while the ball is pressed on, beyond its noise
            and what a gauge's axes read of each other.
    """
    file = None if campaign.path is None else campaign.path / "records.csv"
    speeds = campaign.records["tangential_speed"].to_numpy(dtype=float)
    for key, speed in zip(campaign.record_keys, speeds, strict=True):
        if speed < 0:
            raise InputError(f"the tangential speed of record {key!r} is {speed:g} m/s, but it cannot be negative; "
                             "reverse the axis along the plate, and with it the sign of the tangential force",
                             file=file, column="tangential_speed")
        trace = campaign.trace(key)
        force = trace["tangential_force"].to_numpy(dtype=float)
        # Friction acts where the ball is pressed on: elsewhere a baseline that wanders may be all there is.
        pressed = (np.maximum(trace["normal_force"].to_numpy(dtype=float), 0.0) if "normal_force" in trace
                   else np.ones(len(force)))
        seen = np.isfinite(force) & np.isfinite(pressed)
        force, pressed = force[seen], pressed[seen]
        noise = float(campaign.channels["tangential_force"].sd(np.abs(force).max(initial=0.0)))
        least = 10.0 * noise * np.linalg.norm(pressed) + 0.02 * np.abs(force) @ pressed
        if "normal_force" in trace:
            least += CROSSTALK * pressed @ pressed
        if force @ pressed < -least:
            raise InputError(f"the tangential force of record {key!r} is mostly opposed to its tangential speed, but "
                             "friction on the plate acts in the direction of motion; reverse the sign of one of them",
                             file=None if campaign.path is None else campaign.path / "samples.csv",
                             column="tangential_force")


OBLIQUE = dc.replace(
    IMPACT,
    name="oblique",
    channels=("normal_force", "tangential_force", "slip", "depression", "pressure"),
    needs=("approach_speed", "tangential_speed"),
    sizes=(384, *SIZES),
    models=OBLIQUE_MODELS,
    accepts=("impact", "slip", "oblique"),
    catalogue=(*IMPACT.catalogue, *SLIP_EFFECTS, *OBLIQUE_EFFECTS),
    directions=(*IMPACT.directions, *OBLIQUE_DIRECTIONS),
    observe=partial(observe_contact, simulate_oblique_impact),
    plan=dc.replace(
        IMPACT.plan,
        chosen=(*IMPACT.plan.chosen, "tangential_speed"),
        added={"slip": "0.02 mm", **IMPACT.plan.added},
        noise={**IMPACT.plan.noise, "tangential_force": "0.25 N"},
    ),
    ground=None,
    remedies="measure at other pressures, speeds and angles",
    model_hint=": make one of it by `Striker(model, CoulombFriction())`",
    check=check_directions,
    values=(),
    jumping=("normal_force", "tangential_force"),
)
