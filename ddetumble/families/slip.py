"""Slip records: rubber slides on a plate under a load, in one stroke or back and forth; its friction is measured."""

import dataclasses as dc
import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from scipy import optimize

from .._errors import InputError
from ..contact.friction import SLIP_UNIT
from ..contact.sliding import MIDDLE, STRIDE
from ..dynamics.slide import simulate_sliding
from ..effects import SLIP as EFFECTS
from ..effects.directions import SLIP_DIRECTIONS
from ..effects.free import SLIP_GROUND
from ..measurement import kinds
from ..measurement.campaign import Campaign
from ..reference_models import SLIP_MODELS
from .family import SPLINES, Family, Observation, Path, PlannedTests, Ratio, Span, View


VALUES = ("peak_friction_force",)  # of which a stroke gives one
RUNAWAY = 20.0  # |c| beyond which its product with d alone acts
ALIKE = 0.05  # of the load, within which all loads are one: set weights scatter less, and planned ones differ by more
MOST_GUESSED = 2000  # samples that starts are guessed from: more tell no more of two rates
GUESSES = 4  # pairs of rates that fits begin from, of a grid: the likeliest, as neighbours end in the same place


def observe_slip(law: Any, conditions: Mapping[str, Array], time: Array, row: Any, channels: tuple[str, ...]
                 ) -> Observation:
    """A slip record over its own slip; `time` is the slip itself where the record has no other path.

    Friction that is given as one value stands at a slip of zero, where rubber grips hardest.
    """
    path, way = row.inputs.get("slip", time), row.inputs.get("direction", jnp.ones_like(time))
    clock = time if "slip" in row.inputs else None
    found = simulate_sliding(law, conditions, path, way, clock)
    speed = conditions.get("slip_speed", jnp.ones(()))
    return Observation(jnp.stack([found.tangential_force for _ in channels]), path, way * speed, time[-1], found.failed)


def follow_slip(campaign: Campaign, key: str, samples: Any) -> Path:
    """Distance, direction and number of the strokes of one record; gaps in the slip are filled along a line.

    Raises:
        InputError: the slip is not measured, or only once.
    """
    if "slip" not in campaign.channels:
        raise InputError(f"campaign {campaign.name!r} is a time series without the channel 'slip'; the model needs "
                         "to know how far the rubber has slid")
    slip = samples["slip"].to_numpy(dtype=float)
    known = np.flatnonzero(np.isfinite(slip))
    if len(known) < 2:
        raise InputError(f"campaign {campaign.name!r}: record {key!r} has fewer than two values of 'slip'")
    slip = np.interp(np.arange(len(slip)), known, slip[known])
    noise = float(np.max(campaign.channels["slip"].sd(slip)))
    return Path(*split_strokes(slip, max(6.0 * noise, 0.01 * float(np.ptp(slip)))))


def split_strokes(slip: np.ndarray, threshold: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Distance slid since the stroke began [m], direction (+1 or -1) and number of the stroke, each shape (samples,).

    Of a measured position (samples,) [m]: a turn counts once the motion has come back from its farthest point by more
    than `threshold` [m]; noise does not. Within a stroke the distance never falls: what noise takes back counts as
    rest. The sample at a turning point belongs to the stroke that ends there.
    """
    slip = np.asarray(slip, dtype=float)
    turns = find_turns(slip, threshold)
    distance, direction = np.zeros(len(slip)), np.ones(len(slip))
    number = np.zeros(len(slip), dtype=int)
    for k, (first, last) in enumerate(zip(turns[:-1], turns[1:], strict=True)):
        here = slice(first + 1 if k else 0, last + 1)
        way = 1.0 if slip[last] >= slip[first] else -1.0
        distance[here] = np.maximum.accumulate(np.maximum(way * (slip[here] - slip[first]), 0.0))
        direction[here], number[here] = way, k
    return distance, direction, number


def find_turns(slip: np.ndarray, threshold: float) -> list[int]:
    """Indices of the first sample, of every turning point, and of the last sample."""
    turns, extreme, way = [0], 0, 0.0
    for k in range(1, len(slip)):
        if way == 0.0:
            if abs(slip[k] - slip[0]) > threshold:
                way, extreme = np.sign(slip[k] - slip[0]), k
        elif way * (slip[k] - slip[extreme]) >= 0:
            extreme = k
        elif way * (slip[extreme] - slip[k]) > threshold:
            turns.append(extreme)
            way, extreme = -way, k
    return [*turns, len(slip) - 1]


def lay_strokes(time: np.ndarray, values: np.ndarray, strokes: np.ndarray, end: float) -> list[Span]:
    """Each stroke."""
    ends = [*np.flatnonzero(np.diff(strokes) > 0), len(time) - 1]
    starts = [time[0] - 1e-9 * max(np.ptp(time), 1e-300), *time[ends[:-1]]]
    return [Span(float(a), float(time[b]), SPLINES) for a, b in zip(starts, ends, strict=True)]


def guess_starts(campaign: Campaign, space: Any, start: np.ndarray, free: Sequence[str]) -> list[np.ndarray]:
    """The given coordinates; of Eq. 9 at one load also the best pairs of rates, of a grid and between its points.

    Given the rates it is linear in a and a c, which are projected out. Over several loads the curves hold each other.
    """
    load, over = campaign.records["normal_load"].to_numpy(dtype=float), campaign.independent
    if ("difference_0" not in free or np.ptp(load) > ALIKE * load.max() or campaign.samples is None or over is None
            or over.name != "slip" or SLIP.main[0] not in campaign.channels):
        return [start.copy()]
    table = campaign.samples[["record", "slip", SLIP.main[0]]].dropna()
    table = table.iloc[:: 1 + len(table) // MOST_GUESSED]
    records, law = campaign.records.loc[table["record"]], space.build(jnp.asarray(start))
    given = {name: jnp.asarray(records[name].to_numpy(dtype=float)) for name in campaign.conditions}
    begun = jax.vmap(lambda one: simulate_sliding(law, one, jnp.zeros(1), jnp.ones(1)).tangential_force[0])(given)
    slip = table["slip"].to_numpy(dtype=float) / SLIP_UNIT  # and friction without that at the start, Eq. 8's
    friction = (table[SLIP.main[0]].to_numpy(dtype=float) - np.asarray(begun)) / load.mean()
    x = (load.mean() - MIDDLE) / STRIDE
    offset = [] if {"adhesion_constant", "loss_factor", "e_0"}.isdisjoint(free) else [np.ones_like(slip)]

    def project(rates):
        down, up = (np.exp(np.minimum(rate * slip, 300.0)) for rate in rates)
        columns = np.stack([1.0 - 0.5 * (up + down), 0.5 * (up - down), *offset], axis=1)
        size = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
        share = np.linalg.lstsq(columns / size, friction, rcond=1e-10)[0] / size
        return float(np.sum((columns @ share - friction) ** 2)), share

    grid = np.concatenate([-np.geomspace(80.0, 0.2, 16), np.geomspace(0.3, 40.0, 6)]) / max(float(slip.max()), 1e-6)
    starts = [start.copy()]
    for pair in sorted(itertools.combinations(grid, 2), key=lambda pair: project(pair)[0])[:GUESSES]:
        best = optimize.minimize(lambda rates: project(rates)[0], pair, method="Nelder-Mead",
                                 options={"xatol": 1e-4 * abs(grid).min(), "fatol": 0.0, "maxiter": 200}).x
        a, product = project(best)[1][:2]
        # The model's coefficients are polynomials in x; their higher powers stay as they are.
        if not abs(product) < RUNAWAY * abs(a):
            continue  # the rates agree, and c is lost
        found = {"a": a, "sum": best[1], "difference": best[0], "c": product / a}
        starts.append(start.copy())
        for name, value in found.items():
            higher = sum(start[space.index[f"{name}_{k}"]] * x**k for k in (1, 2) if f"{name}_{k}" in space.index)
            if f"{name}_0" in free:
                starts[-1][space.index[f"{name}_0"]] = value - higher
    return starts


VIEW = View(
    "tangential_force", "slip", "slip", "", (), ("slip",), "share of the record", ("start", "end"), (0.0, 1.0), 30, 3,
    True, "test of the series", "", "adhesion constant, loss factor, slip term",
)  # fmt: skip
VIEW_REVERSED = dc.replace(
    VIEW, along="time", rate="direction", phases=("forward", "backward"), variables=("slip", "direction", "time"),
    apart="strokes forward and backward",
)  # fmt: skip
PLAN = PlannedTests(
    chosen=("normal_load", "internal_pressure", "slip_speed"),
    added={},
    noise={"tangential_force": "0.04 N"},
    uncertainties={"normal_load": "0.3 %", "internal_pressure": "0.5 %"},
    interval="0.1 mm",
    length="12 mm",
)
SLIP = Family(
    name="slip",
    kind=kinds.SLIP,
    independent="slip",
    pace="slip_speed",
    channels=("tangential_force", *VALUES),
    needs=("normal_load",),
    sizes=(256, 1024, 4096, 8192, 16384, 32768),
    models=SLIP_MODELS,
    accepts=("slip",),
    catalogue=EFFECTS,
    directions=SLIP_DIRECTIONS,
    state="slip",
    rate="direction",
    phases=("forward", "backward"),
    observe=observe_slip,
    lay_spans=lay_strokes,
    view=VIEW,
    view_reversed=VIEW_REVERSED,
    plan=PLAN,
    ground=SLIP_GROUND,
    remedies="measure at other loads, pressures and slip speeds",
    follow=follow_slip,
    guess_starts=guess_starts,
    values=VALUES,
    ratio=Ratio("coefficient of friction", "tangential_force", "normal_load"),
)
