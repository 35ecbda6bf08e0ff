"""One test at any conditions as rival models have it: whitened readings and their derivatives, in one program."""

import dataclasses as dc
from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._errors import InputError
from ..dynamics.impact import RTOL
from ..families.starts import FREE
from ..inference.archive import FittedModel
from ..inference.noise import TAPS, Noise, whitening
from ..inference.parameters import ParameterSpace
from ..inference.problem import observe_record
from ..inference.stack import Stack
from .limits import Extra, Limit


ITEMS = 16  # rivals at conditions that one call of the compiled program looks at
SAMPLES = 224  # of a record; more are thinned, their weights raised to the same information on slow curves
BLIND = 3.0  # deviations of the time origin within which the force counts for nothing


@dc.dataclass(frozen=True)
class Layout:
    """What the compiled program is made for.

    Attributes:
        space: reference model and the effects of all rivals.
        channels: measured ones, then those that could be added.
        names: conditions, in the order of `Test.low`; `free` of them are chosen.
        nuisances: of a record.
        free: places in `names`.
    """

    space: ParameterSpace
    channels: tuple[str, ...]
    names: tuple[str, ...]
    nuisances: tuple[str, ...]
    free: tuple[int, ...]


class Test(eqx.Module):
    """Numbers of the program.

    Attributes:
        time: samples, shape (samples,).
        weights, taps: whitening filter, shapes (channels, samples) and (channels, samples, TAPS).
        low, high, logarithmic: limits of the conditions, shape (names,).
        absolute, relative: standard deviations of the nuisances, shape (nuisances,).
        base, directions: coordinates of every rival and its principal directions, shapes (rivals, parameters) and
            (rivals, slots, parameters).
        bounds: of the coordinates.
        span: longest time to integrate at `slowest` (pressure and speed), shape ().
        slowest: shape (2,).
        inputs: further arrays that the family's model reads, by name.
    """

    __test__ = False  # no test case of pytest's

    time: Array
    weights: Array
    taps: Array
    low: Array
    high: Array
    logarithmic: Array
    absolute: Array
    relative: Array
    base: Array
    directions: Array
    bounds: tuple[Array, Array]
    span: Array
    slowest: Array
    inputs: dict[str, Array]


class Columns(NamedTuple):
    """What rivals say of tests.

    Attributes:
        reading: whitened, shape (items, rows).
        shared, own, chosen: its derivatives by the moves along the principal directions, by the nuisances in units of
            their deviations, and by the shares of the free limits, each shape (items, rows, ...).
        channels: shape (items, channels, samples), SI.
        end: of the contact, shape (items,).
        failed: shape (items,).
    """

    reading: Any
    shared: Any
    own: Any
    chosen: Any
    channels: Any
    end: Any
    failed: Any


def place_conditions(test: Test, x: Array, free: tuple[int, ...]) -> Array:
    """Conditions at shares `x` of their free limits, shape (free,): shape (names,)."""
    share = jnp.zeros(test.low.shape).at[jnp.array(free, dtype=int)].set(x)
    low, high = (jnp.where(test.logarithmic, jnp.log(jnp.where(test.logarithmic, b, 1.0)), b)
                 for b in (test.low, test.high))
    value = low + share * (high - low)
    return jnp.where(test.logarithmic, jnp.exp(jnp.where(test.logarithmic, value, 0.0)), value)


def _fill_stack(layout: Layout, test: Test, x: Array) -> Stack:
    """One record of the stack at conditions `x`, shape (free,)."""
    values = place_conditions(test, x, layout.free)
    conditions = {name: values[k] for k, name in enumerate(layout.names)}
    conditions.setdefault("sequence", jnp.ones(()))
    family = layout.space.family
    conditions |= {name: jnp.zeros(()) for name in family.further_starts}
    for name, value in family.defaults.items():
        conditions.setdefault(name, jnp.asarray(value, dtype=float))
    at = jnp.stack([conditions.get(name, jnp.zeros(())) for name in layout.nuisances])
    deviation = jnp.sqrt(test.absolute**2 + (test.relative * at) ** 2 + 1e-300)
    span = test.span
    if family.has_contact:
        # A contact lasts as pressure^(-1/3) speed^(-1/3); where the span is far longer, steps get coarse.
        now = jnp.stack([conditions["initial_pressure"], conditions["approach_speed"]])
        ratio = jnp.where((test.slowest > 0) & (now > 0), test.slowest / jnp.where(now > 0, now, 1.0), 1.0)
        span = span * jax.lax.stop_gradient(jnp.prod(jnp.clip(ratio, 1e-6, 1.0) ** (1.0 / 3.0)))
    shape = (len(layout.channels), test.time.shape[0])
    inputs = dict(test.inputs)
    if layout.space.commons:  # the next test shares them
        inputs["common"] = jnp.stack([conditions[c.column] if c.relative and c.column in conditions else jnp.ones(())
                                      for c in layout.space.commons])
    return Stack(test.time, span, jnp.zeros(shape), test.weights, test.taps, conditions, deviation, jnp.ones(()),
                 inputs, jnp.asarray(RTOL))


def _whiten(test: Test, x: Array) -> Array:
    """Whitened readings, shape (channels * samples,)."""
    size, late = x.shape[1], jnp.pad(x, ((0, 0), (TAPS, 0)))
    y = x
    for k in range(TAPS):
        y = y - test.taps[..., k] * late[:, TAPS - k - 1: TAPS - k - 1 + size]
    return (y * test.weights).reshape(-1)


@partial(jax.jit, static_argnums=0)
def _compute(layout: Layout, test: Test, which: Array, x: Array, theta: Array, z: Array) -> Columns:
    """See `compute_columns`; always `ITEMS` at once."""

    def one(k, chosen, moved, own):
        def f(a, b, c):
            row = _fill_stack(layout, test, c)
            model, (_, _, end, failed) = observe_record(layout.space, layout.nuisances, layout.channels, a, b, row,
                                                        test.base[k], test.directions[k], *test.bounds)
            return _whiten(test, model), (model, end, failed | ~jnp.all(jnp.isfinite(model)))

        first, second = moved.size, moved.size + own.size
        unit = jnp.eye(second + chosen.size)
        reading, columns, (model, end, failed) = jax.vmap(
            lambda e: jax.jvp(f, (moved, own, chosen), (e[:first], e[first:second], e[second:]), has_aux=True),
            out_axes=(None, -1, None))(unit)
        reading, columns = (jnp.where(failed | ~jnp.isfinite(v), 0.0, v) for v in (reading, columns))
        return Columns(reading, columns[:, :first], columns[:, first:second], columns[:, second:], model, end, failed)

    return jax.vmap(one)(which, x, theta, z)


def compute_columns(layout: Layout, test: Test, which: np.ndarray, x: np.ndarray, theta: np.ndarray | None = None,
                    z: np.ndarray | None = None) -> Columns:
    """Readings of rivals at tests, and their derivatives in forward mode.

    Args:
        layout, test: of `prepare`.
        which: number of the rival, shape (items,).
        x: shares of the free limits, shape (items, free).
        theta: moves of the rival along its principal directions, shape (items, slots); none where not given.
        z: nuisances of the record, shape (items, nuisances); none where not given.
    """
    count, slots, own = len(which), test.directions.shape[1], len(layout.nuisances)
    theta = np.zeros((count, slots)) if theta is None else theta
    z = np.zeros((count, own)) if z is None else z
    parts = []
    for first in range(0, count, ITEMS):
        here = np.minimum(np.arange(first, first + ITEMS), count - 1)  # one compiled program for any number of them
        parts.append(jax.tree.map(np.asarray, _compute(layout, test, *(jnp.asarray(v[here])
                                                                      for v in (which, x, theta, z)))))
    return Columns(*(np.concatenate(fields)[:count] for fields in zip(*parts, strict=True)))


def count_rows(layout: Layout, test: Test, end: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """1 for rows that count: channels of the mask; of the pressure what lies in contact.

    Args:
        layout, test: of `prepare`.
        end: of the contact, shape (items,).
        mask: 1 for channels that count, shape (channels,).

    Returns:
        Shape (items, rows).
    """
    contact = np.asarray(test.time) < end[:, None]
    return np.concatenate([(contact if channel == "pressure" else np.ones_like(contact)) * mask[c]
                           for c, channel in enumerate(layout.channels)], axis=1)


def prepare(models: Sequence[FittedModel], limits: Sequence[Limit], extras: Sequence[Extra], *,
            length: float | None = None) -> tuple[Layout, Test]:
    """Everything that the program needs.

    Args:
        models: rivals, of the same reference model and campaign.
        limits: of every condition.
        extras: channels that could be added.
        length: of the record in its independent variable, SI; as the campaign's where not given.

    Raises:
        InputError: the models were written by an earlier version.
    """
    first = models[0]
    if first.sampling is None:
        raise InputError("the model does not say how its campaign was sampled, as an earlier version wrote it; run fit "
                         "or discover again", file=first.folder)
    classes = tuple(dict.fromkeys(e for m in models for e in m.space.effects))
    space = ParameterSpace(first.space.reference, classes, first.space.commons)
    spreads = [m.spread() for m in models]
    slots = max(len(s) for s in spreads)
    base, directions = np.zeros((len(models), len(space))), np.zeros((len(models), slots, len(space)))
    for k, (m, spread) in enumerate(zip(models, spreads, strict=True)):
        base[k] = space.coordinates()
        places = [space.index[s.name] for s in m.space.slots]
        base[k, places] = m.u
        directions[k][np.ix_(range(len(spread)), places)] = spread
    family = space.family
    names = tuple(limit.name for limit in limits)
    uncertain = tuple(n for n in names if n in first.uncertainties and n != "sequence")
    starts = (*family.starts, *family.further_starts)
    nuisances = (*starts, *uncertain, "time")
    spreads_of = [first.uncertainties[n] for n in uncertain]
    fastest = max((first.sampling.largest.get(f"angular_velocity_{a}", 0.0) for a in "xyz"), default=0.0)
    wide = [FREE * fastest] * len(family.starts) + [FREE] * (len(starts) - len(family.starts))
    absolute = np.array([*wide, *(s.absolute or 0.0 for s in spreads_of), first.time_sd])
    relative = np.array([*[0.0] * len(starts), *(s.relative or 0.0 for s in spreads_of), 0.0])
    time, thin, span, slowest = _lay_samples(first, limits, length)
    channels = (*(c for c in family.channels if c in first.channels), *(c for e in extras for c in e.channels))
    noise = {c: Noise(e.sd, 0.0, 0.0, 1.0, e.sd, 0.0, "white, as assumed") for e in extras for c in e.channels}
    weights, taps = np.zeros((len(channels), time.size)), np.zeros((len(channels), time.size, TAPS))
    for c, channel in enumerate(channels):
        valid = np.ones(time.size, dtype=bool)
        if channel == "normal_force" and first.time_sd > 0:
            valid = np.abs(time) > BLIND * first.time_sd
        level = noise.get(channel) or first.noise[channel]
        weights[c], taps[c] = whitening(level, time, valid)
        weights[c] *= np.sqrt(thin if level.correlation <= 0 else thinning_factor(level, thin))
    farthest = {x.name: np.array([max(abs(x.low), abs(x.high))]) for x in limits}
    inputs = {name: jnp.asarray(x[0]) for name, x in family.lay_inputs([time], farthest).items()}
    layout = Layout(space, channels, names, nuisances, tuple(k for k, x in enumerate(limits) if x.free))
    logarithmic = np.array([x.logarithmic for x in limits], dtype=bool)
    low, high = space.bounds()
    begin, end = (np.array(values, dtype=float) for values in ([x.low for x in limits], [x.high for x in limits]))
    arrays = (time, weights, taps, begin, end, logarithmic, absolute, relative, base, directions, span, slowest)
    (time, weights, taps, begin, end, logarithmic, absolute, relative, base, directions, span,
     slowest) = (jnp.asarray(a) for a in arrays)
    bounds = jnp.asarray(low), jnp.asarray(high)
    return layout, Test(time, weights, taps, begin, end, logarithmic, absolute, relative, base, directions, bounds,
                        span, slowest, inputs)


def thinning_factor(noise: Noise, thin: float) -> float:
    """Information of all samples on a slow curve over that of every `thin`-th one: ratio of the spectra at zero."""

    def level(rho, interval):
        return interval * (noise.white_share + (1.0 - noise.white_share) * (1.0 + rho) / (1.0 - rho))

    return level(noise.correlation**thin, thin) / level(noise.correlation, 1.0)


def _lay_samples(saved: FittedModel, limits: Sequence[Limit], length: float | None
                 ) -> tuple[np.ndarray, float, float, np.ndarray]:
    """Sample times, how many samples of the campaign's one stands for, the span, and what it belongs to."""
    sampling = saved.sampling
    assert sampling is not None
    first, last = sampling.first, sampling.last
    interval = (last - first) / max(sampling.samples - 1, 1)
    slowest = np.zeros(2)
    family = saved.space.family
    if family.has_contact:
        lows = {x.name: x.low for x in limits}
        slowest = np.array([lows.get("initial_pressure", 0.0), lows.get("approach_speed", 0.0)])
        for name, low in zip(("initial_pressure", "approach_speed"), slowest, strict=True):
            if low > 0 and saved.ranges.get(name, (0.0, 0.0))[0] > 0:
                last *= max(saved.ranges[name][0] / low, 1.0) ** (1.0 / 3.0)
    elif family.independent in sampling.largest:  # a time series: the next test is a single stroke
        first, last = 0.0, sampling.largest[family.independent]
        interval = last / max(sampling.samples - 1, 1)
    last = last if length is None else first + length
    count = int(round((last - first) / interval)) + 1
    kept = min(count, SAMPLES)
    time = np.linspace(first, last, kept)
    return time, (count - 1) / max(kept - 1, 1), 1.005 * max(last, 1e-12), slowest
