"""Tumbling records: a body turns freely or under small torques, and gyroscopes read its rates."""

from collections.abc import Mapping, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..dynamics.spinning import ATTITUDES, RATES, START, START_ATTITUDE, spin
from ..effects import TUMBLE as EFFECTS
from ..effects.directions import TUMBLE_DIRECTIONS
from ..effects.free import TUMBLE_GROUND
from ..measurement import kinds
from ..measurement.campaign import Campaign
from ..reference_models import TUMBLE_MODELS
from .family import SPLINES, Family, Observation, PlannedTests, Span, View
from .starts import guess_body, lay_mesh, stack_starts


TURN = 5.0  # splines a revolution: what a torque leaves repeats with the nutation


def observe_tumble(law: Any, conditions: Mapping[str, Array], time: Array, row: Any, channels: tuple[str, ...]
                   ) -> Observation:
    """A tumbling record on its own mesh: rates as the gyroscopes read them, attitude."""
    found = spin(law, conditions, time, row.inputs["mesh"])
    named = {f"angular_velocity_{a}": found.angular_velocity[:, k] for k, a in enumerate("xyz")}
    named |= {name: found.attitude[:, k % 4] for k, name in enumerate(ATTITUDES)}
    speed = jnp.sqrt(jnp.sum(found.body**2, axis=-1) + 1e-300)
    return Observation(jnp.stack([named[channel] for channel in channels]), time, speed, time[-1], found.failed)


def lay_record(time: np.ndarray, values: np.ndarray, strokes: np.ndarray, end: float) -> list[Span]:
    """All of the record; the faster the body turns, the more splines."""
    fastest = float(np.sqrt(np.sum(values[:3] ** 2, axis=0)).max())
    number = max(SPLINES, int(np.ceil(TURN * fastest * float(np.ptp(time)) / (2.0 * np.pi))))
    return [Span(float(time[0]) - 1e-9 * float(np.ptp(time)), float(time[-1]), number)]


def guess_ratio(campaign: Campaign, space: Any, start: np.ndarray, free: Sequence[str]) -> list[np.ndarray]:
    """The ratio of the moments of inertia, guessed from the rates where it is free."""
    start = start.copy()
    if "inertia_ratio" in free:
        start[space.index["inertia_ratio"]] = np.log(guess_body(campaign))
    return [start]


def lay_meshes(times: Sequence[np.ndarray], conditions: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Meshes of records that begin with the rates among their conditions."""
    rates = np.stack([conditions[name] for name in START], axis=1)
    return {"mesh": lay_mesh(times, np.sqrt(np.sum(rates**2, axis=1)))}


VIEW = View(rate="angular_speed", variables=("time", "angular_speed"), free="inertia ratio")
PLAN = PlannedTests(
    chosen=START,
    added={"attitude": "0.001"},
    noise=dict.fromkeys(RATES, "2e-5 rad/s"),
    uncertainties={},
    interval="2 s",
    length="600 s",
)
TUMBLE = Family(
    name="tumble",
    kind=kinds.TUMBLE,
    independent="time",
    channels=(*RATES, *ATTITUDES),
    needs=(),
    sizes=(320, 640, 1024, 1536, 2560, 5120, 10240, 20480),
    models=TUMBLE_MODELS,
    accepts=("tumble",),
    catalogue=EFFECTS,
    directions=TUMBLE_DIRECTIONS,
    state="time",
    rate="angular_speed",
    phases=("both", "both"),
    observe=observe_tumble,
    lay_spans=lay_record,
    view=VIEW,
    plan=PLAN,
    ground=TUMBLE_GROUND,
    remedies="measure longer, from other initial rates",
    guess_starts=guess_ratio,
    begin=stack_starts,
    lay_inputs=lay_meshes,
    rows=(4, 8, 16, 24, 48, 96, 192, 384),
    starts=START,
    further_starts=START_ATTITUDE,
    slots=(4, 8, 16, 32, 48, 64, 96),
)
