"""Impacts: a ball held by an arm touches a plate at a speed, and its normal force is measured until it separates."""

from collections.abc import Callable, Collection, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._numerics import stop
from ..contact.law import ContactLaw
from ..dynamics.impact import Motion, follow, read_motion, simulate_impact
from ..effects import IMPACT as EFFECTS
from ..effects.directions import IMPACT_DIRECTIONS
from ..effects.free import IMPACT_GROUND
from ..measurement import kinds
from ..reference_models import MODELS
from .family import SPLINES, Family, Observation, PlannedTests, Span, View
from .pulses import list_guesses


# Samples that records are padded to: few sizes, so that few programs are compiled; values are one sample.
SIZES = (768, 1536, 2048, 4096, 8192, 16384, 32768)
VALUES = ("peak_normal_force", "rebound_speed", "contact_time", "impulse", "peak_depression")
WINDOW = 0.27  # s, the paper's impact time: where the arm pushes on, a peak is looked for up to here
LONGER = 3.0  # times the longest contact that was measured: what a wrong model makes longer still ends within
# Shares of the contact at which its curves are read: close at its ends, where a dashpot jumps and the gauge lags, and
# somewhat beyond, where a gauge still rings. Where hardly anything rebounds the force peaks in the first thousandth of
# a contact that ends ever more slowly: shares that grow by a fifth lead there.
_ANGLES, _TAIL = np.pi * np.arange(1, 97) / 96, 1.0 + 0.5 * (np.arange(1, 17) / 16) ** 2
_EVEN = np.concatenate([0.5 - 0.5 * np.cos(_ANGLES), _TAIL])
_EARLY = np.geomspace(1e-4, 3e-2, 32)
# A peak is read again in so many steps between the neighbours of the largest sample, so many times: the first time is
# right within 1e-5, where another sample becomes the largest the value jumps by as much, and a fit stops at the jump.
CLOSER, LOOKS = 8, 3
PEAKS = {"peak_normal_force": "normal_force", "peak_depression": "depression"}  # and what they are peaks of
# Weights of a quadrature over them: in the angle the trapezoidal rule converges fast, as its integrand ends at zero.
_ORDER = np.argsort(np.concatenate([_EARLY, _EVEN]))
SHARES = np.concatenate([_EARLY, _EVEN])[_ORDER]
WEIGHTS = np.concatenate([np.zeros(len(_EARLY)), 0.5 * np.sin(_ANGLES) * np.pi / 96, np.gradient(_TAIL)])[_ORDER]


def observe_contact(run: Callable[..., Any], law: Any, conditions: Mapping[str, Array], time: Array, row: Any,
                    channels: tuple[str, ...]) -> Observation:
    """An impact, straight or oblique, by the function `run` of it; the force is read off the motion."""
    found = run(law, conditions, time, span=row.span, rtol=row.rtol, atol=0.01 * row.rtol, from_motion=True)
    model = jnp.stack([getattr(found, channel) for channel in channels])
    return Observation(model, found.depression, found.depression_rate, found.separation, found.failed)


def observe_impact(law: Any, conditions: Mapping[str, Array], time: Array, row: Any, channels: tuple[str, ...]
                   ) -> Observation:
    """A straight impact: series, values, or both; a value is the same at every sample.

    The misfit of values alone is located in the largest depression of their impact, and in the speed of its rebound.
    """
    if not set(channels) & set(VALUES):
        return observe_contact(simulate_impact, law, conditions, time, row, channels)
    last = jnp.where(row.span > 0, row.span, 1.0)
    motion = follow(law, conditions, last, row.rtol, 0.01 * row.rtol)
    values, failed = read_values(law, conditions, motion, channels)
    if set(channels) <= set(VALUES):
        model = jnp.stack([jnp.broadcast_to(values[channel], time.shape) for channel in channels])
        return Observation(model, jnp.broadcast_to(values["peak_depression"], time.shape),
                           jnp.broadcast_to(values["rebound_speed"], time.shape), motion.end, failed)
    found, _ = read_motion(law, conditions, time, motion, True)
    model = jnp.stack([jnp.broadcast_to(values[channel], time.shape) if channel in VALUES else getattr(found, channel)
                       for channel in channels])
    return Observation(model, found.depression, found.depression_rate, found.separation, found.failed | failed)


def read_values(law: ContactLaw, conditions: Mapping[str, Array], motion: Motion, wanted: Collection[str] = PEAKS
                ) -> tuple[dict[str, Array], Array]:
    r"""Values of one impact by name, each of shape (), and whether it failed.

    Peaks are those of the sampled gauge reading and depression, refined by a parabola; those `wanted` are read again
    about the largest sample first, and of the others only that of the depression is there. The impulse is
    $\int F\,dt$ of that reading by a quadrature. An impact that has not ended within its span has that for its
    contact time.
    """
    times = stop(motion.end) * SHARES
    found, _ = read_motion(law, conditions, times, motion)

    def read_peak(number):
        def look(window, _):
            # The last time tells the gauge how long it goes on ringing.
            close = jnp.append(jnp.linspace(window[0], window[1], CLOSER + 1), times[-1])
            values = choose(read_motion(law, conditions, close, motion)[0])[:-1]
            return bracket(close[:-1], values), (close[:-1], values)

        def choose(impact):
            return jnp.stack([getattr(impact, PEAKS[name]) for name in names])[number]

        _, (close, values) = jax.lax.scan(look, bracket(times, choose(found)), length=LOOKS)
        return refine_peak(close[-1], values[-1])

    def bracket(times, values):
        """Times of the neighbours of the largest."""
        k = jnp.clip(jnp.argmax(stop(values)), 1, len(values) - 2)
        return stop(times[k - 1]), stop(times[k + 1])

    names = [name for name in PEAKS if name in wanted]
    peaks = jax.lax.map(read_peak, jnp.arange(len(names))) if names else ()
    return {"peak_depression": refine_peak(times, found.depression)} | dict(zip(names, peaks, strict=True)) | {
        "rebound_speed": found.rebound_speed, "contact_time": found.separation,
        "impulse": stop(motion.end) * jnp.sum(WEIGHTS * found.normal_force),
    }, found.failed  # fmt: skip


def refine_peak(times: Array, values: Array) -> Array:
    """Maximum of a sampled curve: vertex of the parabola through the largest sample and its two neighbours.

    Args:
        times: ascending, any spacing, shape (times,) [s].
        values: shape (times,).

    Returns:
        The maximum, scalar; the largest sample itself where that is not an inner maximum. Differentiable with the
        samples that are used held fixed.
    """
    k = jnp.clip(jnp.argmax(stop(values)), 1, values.shape[0] - 2)
    t0, t1, t2 = times[k - 1], times[k], times[k + 1]
    f0, f1, f2 = values[k - 1], values[k], values[k + 1]
    left, right = (f1 - f0) / (t1 - t0), (f2 - f1) / (t2 - t1)
    bend = (right - left) / (t2 - t0)
    slope = left + bend * (t1 - t0)
    inner = (bend < 0) & (f1 >= f0) & (f1 >= f2)
    # Next to a jump (separation, a dashpot's onset) the parabola would overshoot: its step stays within half a sample.
    step = jnp.clip(jnp.where(inner, -slope / (2.0 * jnp.where(inner, bend, -1.0)), 0.0),
                    0.5 * (t0 - t1), 0.5 * (t2 - t1))
    return jnp.where(inner, f1 + slope * step + bend * step**2, jnp.maximum(f1, jnp.maximum(f0, f2)))


def place_values(table: Any) -> float:
    """Time after first touch up to which values are looked for [s]: three times the longest contact time that was
    measured, or the paper's impact time."""
    if "contact_time" in table and table["contact_time"].notna().any():
        return LONGER * float(table["contact_time"].max())
    return WINDOW


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
    channels=("normal_force", "depression", "pressure", *VALUES),
    needs=("approach_speed",),
    defaults={"initial_pressure": 0.0},
    sizes=(1, *SIZES),
    models=MODELS,
    accepts=("impact",),
    catalogue=EFFECTS,
    directions=IMPACT_DIRECTIONS,
    state="depression",
    rate="depression_rate",
    phases=("loading", "unloading"),
    observe=observe_impact,
    lay_spans=lay_contact,
    view=VIEW,
    plan=PLAN,
    ground=IMPACT_GROUND,
    remedies="measure at other pressures and speeds",
    guess_starts=list_guesses,
    values=VALUES,
    jumping=("normal_force",),
    place_values=place_values,
)
