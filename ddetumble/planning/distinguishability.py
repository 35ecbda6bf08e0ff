r"""How far apart rival models stay at one test at any conditions, when either may be refitted.

Model B, fitted to what was measured so far, has coordinates $\hat u + L\,x$ with $x \sim N(0, I)$; a record's own
nuisances are $z \sim N(0, I)$. For whitened readings $r_A$ and $r_B$ of one test, what B, refitted to it with the old
records as its prior, leaves where A is true is

$$d^2 = \min_{x,z} \|r_A - r_B(x, z)\|^2 + \|x\|^2 + \|z\|^2 .$$

It is the expected rise of chi-square of B over A. By Levenberg-Marquardt at many tests at once; at the minimum the
envelope theorem gives the exact gradient by the conditions $c$ from first derivatives alone,
$\partial d^2/\partial c = 2 (r_A - r_B)^T (\partial r_A/\partial c - \partial r_B/\partial c)$. Linear in $x$ and $z$,
with $\Delta = r_A - r_B$ and derivatives $J$ of $r_B$ by $x$ and $Z$ by $z$, $n$ repeats leave

$$d^2(n) = n\left[\Delta^T P \Delta - g^T (I/n + M)^{-1} g\right],\qquad g = J^T P \Delta,\; M = J^T P J,\;
P = I - Z (I + Z^T Z)^{-1} Z^T.$$
"""

import dataclasses as dc
import math
from collections.abc import Sequence
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
from ..inference.problem import observe_record, whiten_columns
from ..inference.stack import Stack
from .setting_ranges import Extra, Limit


# Rivals at conditions that one call of the compiled program looks at: more fill the memory, fewer idle the processor.
ITEMS = 16
SAMPLES = 224  # of a record; more are thinned, their weights raised to the same information on slow curves
SETTLED = 1e-8  # relative fall of the squared distance below which a refit has ended; its gradient errs by the root
SLOWEST = ("initial_pressure", "approach_speed")  # a contact lasts as these to the power -1/3


class Preview(eqx.Module):
    """One test at any conditions as rival models have it."""

    space: ParameterSpace = eqx.field(static=True)  # reference model and the effects of all rivals
    channels: tuple[str, ...] = eqx.field(static=True)  # measured ones, then those that could be added
    names: tuple[str, ...] = eqx.field(static=True)  # conditions, in the order of `low`
    nuisances: tuple[str, ...] = eqx.field(static=True)  # of a record
    free: tuple[int, ...] = eqx.field(static=True)  # places of the conditions that are chosen
    time: Array  # samples, shape (samples,)
    weights: Array  # of the whitening filter, shape (channels, samples)
    taps: Array  # of it, shape (channels, samples, TAPS)
    low: Array  # limits of the conditions, shape (names,)
    high: Array
    logarithmic: Array  # whether they are searched by ratios
    absolute: Array  # standard deviations of the nuisances, shape (nuisances,)
    relative: Array
    base: Array  # coordinates of every rival, shape (rivals, parameters)
    directions: Array  # and its principal directions, shape (rivals, slots, parameters)
    bounds: tuple[Array, Array]  # of the parameters, shapes (parameters,)
    span: Array  # longest time to integrate at `slowest`, shape ()
    slowest: Array  # pressure and speed
    inputs: dict[str, Array]  # further arrays that the family's model reads, by name

    def place(self, x: Array) -> Array:
        """Conditions at fractions `x` of their free limits, shape (free,): shape (names,)."""
        fraction = jnp.zeros(self.low.shape).at[jnp.array(self.free, dtype=int)].set(x)
        low, high = (jnp.where(self.logarithmic, jnp.log(jnp.where(self.logarithmic, b, 1.0)), b)
                     for b in (self.low, self.high))
        value = low + fraction * (high - low)
        return jnp.where(self.logarithmic, jnp.exp(jnp.where(self.logarithmic, value, 0.0)), value)

    def fill_stack(self, x: Array) -> Stack:
        """One record of the stack at fractions `x` of the free limits."""
        values, family = self.place(x), self.space.family
        conditions = {name: values[k] for k, name in enumerate(self.names)}
        conditions.setdefault("sequence", jnp.ones(()))
        conditions |= {name: jnp.zeros(()) for name in family.further_starts}
        for name, value in family.defaults.items():
            conditions.setdefault(name, jnp.asarray(value, dtype=float))
        at = jnp.stack([conditions.get(name, jnp.zeros(())) for name in self.nuisances])
        deviation = jnp.sqrt(self.absolute**2 + (self.relative * at) ** 2 + 1e-300)
        span = self.span
        if family.has_contact:  # where the span is far longer than the contact, steps get coarse
            now = jnp.stack([conditions[name] for name in SLOWEST])
            ratio = jnp.where((self.slowest > 0) & (now > 0), self.slowest / jnp.where(now > 0, now, 1.0), 1.0)
            span = span * jax.lax.stop_gradient(jnp.prod(jnp.clip(ratio, 1e-6, 1.0) ** (1.0 / 3.0)))
        inputs = dict(self.inputs)
        if self.space.commons:  # the next test shares them
            inputs["common"] = jnp.stack([conditions[c.column] if c.relative and c.column in conditions
                                          else jnp.ones(()) for c in self.space.commons])
        return Stack(self.time, span, jnp.zeros((len(self.channels), self.time.shape[0])), self.weights, self.taps,
                     conditions, deviation, jnp.ones(()), inputs, jnp.asarray(RTOL))


class Columns(NamedTuple):
    """What rivals say of tests."""

    reading: Any  # whitened, shape (items, rows)
    shared: Any  # its derivatives by `theta` of `compute_columns`, shape (items, rows, slots)
    own: Any  # by `z` in units of their deviations, shape (items, rows, nuisances)
    chosen: Any  # by `x`, shape (items, rows, free)
    channels: Any  # shape (items, channels, samples), SI
    end: Any  # of the contact, shape (items,)
    failed: Any  # shape (items,)


@eqx.filter_jit
def _compute(preview: Preview, which: Array, x: Array, theta: Array, z: Array) -> Columns:
    def one(k, chosen, moved, own):
        def f(a, b, c):
            model, (_, _, end, failed) = observe_record(
                preview.space, preview.nuisances, preview.channels, a, b, preview.fill_stack(c), preview.base[k],
                preview.directions[k], *preview.bounds)
            return model, (end, failed | ~jnp.all(jnp.isfinite(model)))

        first, second = moved.size, moved.size + own.size
        unit = jnp.eye(second + chosen.size)
        model, slopes, (end, failed) = jax.vmap(
            lambda e: jax.jvp(f, (moved, own, chosen), (e[:first], e[first:second], e[second:]), has_aux=True),
            out_axes=(None, -1, None))(unit)
        white = whiten_columns(preview.fill_stack(chosen), failed, jnp.concatenate([model[..., None], slopes], axis=-1))
        shared, rest, places = jnp.split(white[:, 1:], (first, second), axis=1)
        return Columns(white[:, 0], shared, rest, places, model, end, failed)

    return jax.vmap(one)(which, x, theta, z)


def compute_columns(preview: Preview, which: np.ndarray, x: np.ndarray, theta: np.ndarray | None = None,
                    z: np.ndarray | None = None) -> Columns:
    """Readings of rivals number `which`, shape (items,), at fractions `x` of the free limits, shape (items, free), and
    their derivatives in forward mode; the rival moved by `theta` along its principal directions, shape (items, slots),
    the record's nuisances at `z`, shape (items, nuisances).
    """
    count = len(which)
    theta = np.zeros((count, preview.directions.shape[1])) if theta is None else theta
    z = np.zeros((count, len(preview.nuisances))) if z is None else z
    parts = []
    for first in range(0, count, ITEMS):
        here = np.minimum(np.arange(first, first + ITEMS), count - 1)  # one compiled program for any number of them
        parts.append(jax.tree.map(np.asarray, _compute(preview, *(jnp.asarray(v[here]) for v in (which, x, theta, z)))))
    return Columns(*(np.concatenate(fields)[:count] for fields in zip(*parts, strict=True)))


def count_rows(preview: Preview, end: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """1 for rows that count, shape (items, rows): channels of the mask; of the pressure what lies before the end of the
    contact, shape (items,).
    """
    contact = np.asarray(preview.time) < end[:, None]
    return np.concatenate([(contact if channel == "pressure" else np.ones_like(contact)) * mask[c]
                           for c, channel in enumerate(preview.channels)], axis=1)


def preview_test(models: Sequence[FittedModel], limits: Sequence[Limit], extras: Sequence[Extra], *,
                 length: float | None = None) -> Preview:
    """The next test of rivals that extend one reference model and were fitted to one campaign; its record as long as
    `length` in its independent variable, SI, or as the campaign's.

    Raises:
        InputError: the models were written by an earlier version.
    """
    first = models[0]
    if first.sampling is None:
        raise InputError("the model was written by an earlier version and does not say how its campaign was sampled; "
                         "run fit or discover again", file=first.folder)
    space = ParameterSpace(first.space.reference, tuple(dict.fromkeys(e for m in models for e in m.space.effects)),
                           tuple({c.slot.name: c for m in models for c in m.space.commons}.values()))
    spreads, family = [m.spread() for m in models], space.family
    base = np.tile(space.coordinates(), (len(models), 1))
    directions = np.zeros((len(models), max(map(len, spreads)), len(space)))
    for k, (m, spread) in enumerate(zip(models, spreads, strict=True)):
        places = [space.index[s.name] for s in m.space.slots]
        base[k, places] = m.u
        directions[k][np.ix_(range(len(spread)), places)] = spread

    uncertain = {x.name: first.uncertainties[x.name] for x in limits
                 if x.name in first.uncertainties and x.name != "sequence"}
    fastest = max((first.sampling.largest.get(f"angular_velocity_{a}", 0.0) for a in "xyz"), default=0.0)
    starts = {**dict.fromkeys(family.starts, FREE * fastest), **dict.fromkeys(family.further_starts, FREE)}
    absolute = np.array([*starts.values(), *(s.absolute or 0.0 for s in uncertain.values()), first.time_sd])
    relative = np.array([*[0.0] * len(starts), *(s.relative or 0.0 for s in uncertain.values()), 0.0])

    time, thin, slowest = _lay_samples(first, limits, length)
    channels = (*(c for c in family.channels if c in first.channels), *(c for e in extras for c in e.channels))
    noise = {c: Noise(e.sd, 0.0, 0.0, 1.0, e.sd, 0.0, "white, as assumed") for e in extras for c in e.channels}
    weights, taps = np.zeros((len(channels), time.size)), np.zeros((len(channels), time.size, TAPS))
    for c, channel in enumerate(channels):
        valid = family.tell_sides(channel, time, first.time_sd)
        level = noise.get(channel) or first.noise[channel]
        weights[c], taps[c] = whitening(level, time, valid)
        weights[c] *= np.sqrt(thin if level.correlation <= 0 else thinning_factor(level, thin))
    farthest = {x.name: np.array([max(abs(x.low), abs(x.high))]) for x in limits}
    arrays = dict(
        time=time, weights=weights, taps=taps, low=np.array([x.low for x in limits], dtype=float),
        high=np.array([x.high for x in limits], dtype=float),
        logarithmic=np.array([x.logarithmic for x in limits], dtype=bool), absolute=absolute, relative=relative,
        base=base, directions=directions, bounds=space.bounds(), span=1.005 * max(time[-1], 1e-12), slowest=slowest,
        inputs={name: x[0] for name, x in family.lay_inputs([time], farthest).items()})
    return Preview(space, channels, tuple(x.name for x in limits), (*starts, *uncertain, "time"),
                   tuple(k for k, x in enumerate(limits) if x.free), **jax.tree.map(jnp.asarray, arrays))


def thinning_factor(noise: Noise, thin: float) -> float:
    """Information of all samples on a slow curve over that of every `thin`-th one: ratio of the spectra at zero."""
    def level(rho, interval):
        return interval * (noise.white_share + (1.0 - noise.white_share) * (1.0 + rho) / (1.0 - rho))

    return level(noise.correlation**thin, thin) / level(noise.correlation, 1.0)


def _lay_samples(saved: FittedModel, limits: Sequence[Limit], length: float | None
                 ) -> tuple[np.ndarray, float, np.ndarray]:
    """Sample times, how many samples of the campaign's one stands for, and lowest pressure and speed of an impact."""
    sampling, family = saved.sampling, saved.space.family
    assert sampling is not None
    first, last = sampling.first, sampling.last
    interval = (last - first) / max(sampling.samples - 1, 1)
    slowest = np.zeros(2)
    if saved.are_values:
        return np.array([last]), 1.0, slowest
    if family.has_contact:
        lows = {x.name: x.low for x in limits}
        slowest = np.array([lows.get(name, 0.0) for name in SLOWEST])
        for name, low in zip(SLOWEST, slowest, strict=True):
            if low > 0 and saved.ranges.get(name, (0.0, 0.0))[0] > 0:
                last *= max(saved.ranges[name][0] / low, 1.0) ** (1.0 / 3.0)
    elif family.independent in sampling.largest:  # a time series: the next test is a single stroke
        first, last = 0.0, sampling.largest[family.independent]
        interval = last / max(sampling.samples - 1, 1)
    last = last if length is None else first + length
    count = int(round((last - first) / interval)) + 1
    kept = min(count, SAMPLES)
    return np.linspace(first, last, kept), (count - 1) / max(kept - 1, 1), slowest


class Contrast(NamedTuple):
    r"""What one test says about two models: $\Delta^T P \Delta$, $g$, shape (directions,), and $M$."""

    size: Array
    pull: Array
    stiffness: Array


def profile_nuisances(columns: Array, own: Array) -> Array:
    """Whitened columns, shape (rows, columns), less what the record's own nuisances with unit priors, derivatives of
    shape (rows, nuisances), can take up; rows of the priors are added.
    """
    count = own.shape[1]
    basis, _ = jnp.linalg.qr(jnp.concatenate([own, jnp.eye(count)]))
    padded = jnp.concatenate([columns, jnp.zeros((count, columns.shape[1]))])
    return padded - basis @ (basis.T @ padded)


def contrast(difference: Array, shared: Array, own: Array) -> Contrast:
    """One test of two models, linear in what a refit may change: difference of the whitened readings, shape (rows,),
    derivatives of the refitted model by its moves, shape (rows, directions), and by its nuisances.
    """
    both = profile_nuisances(jnp.concatenate([difference[:, None], shared], axis=1), own)
    left, moved = both[:, 0], both[:, 1:]
    return Contrast(left @ left, moved.T @ left, moved.T @ moved)


def separate(found: Contrast, repeats: Array | float = 1.0) -> Array:
    """Squared distance that so many repeats leave after the refit, in noise variances, shape ()."""
    among = jnp.eye(found.pull.shape[0]) / repeats + found.stiffness
    return repeats * (found.size - found.pull @ jnp.linalg.solve(among, found.pull))


def count_repeats(found: Contrast, target: float, most: int) -> int | None:
    """Fewest repeats that leave at least `target` noise variances; None where `most` are too few."""
    if not math.isfinite(float(found.size)) or float(separate(found, float(most))) < target:
        return None
    low, high = 0, most  # the distance grows with every repeat
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if float(separate(found, float(middle))) >= target else (middle, high)
    return high


def gain_information(shared: Array, own: Array) -> Array:
    r"""Expected gain of information on the parameters, $\frac12 \ln\det(I + M)$ [nat], shape ()."""
    moved = profile_nuisances(shared, own)
    return 0.5 * jnp.linalg.slogdet(jnp.eye(shared.shape[1]) + moved.T @ moved)[1]


def value_information(preview: Preview, x: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Information on the parameters of one model gained by tests [nat], shape (tests,)."""
    at = compute_columns(preview, np.zeros(len(x), dtype=int), x)
    rows = count_rows(preview, at.end, mask)[..., None]
    gains = [float(gain_information(s, o)) for s, o in zip(at.shared * rows, at.own * rows, strict=True)]
    return np.where(at.failed, 0.0, np.nan_to_num(gains))


@dc.dataclass(frozen=True)
class Distances:
    """Squared distances of all ordered pairs of rivals at some tests."""

    pairs: tuple[tuple[int, int], ...]  # (true, refitted) by number
    squares: np.ndarray  # in noise variances, shape (pairs, tests)
    slopes: np.ndarray  # of these by the fractions of the free limits, shape (pairs, tests, free)
    at: Columns  # the rivals as they stand, `models` by `tests` items
    rows: np.ndarray  # which rows count, shape (tests, rows)
    failed: np.ndarray  # tests at which a rival could not be computed, shape (tests,)


def part_rivals(preview: Preview, x: np.ndarray, mask: np.ndarray, steps: int = 4) -> Distances:
    """Squared distance of every ordered pair of rivals, the second refitted to the first in `steps` at most, at
    fractions `x` of the free limits, shape (tests, free); `mask` is 1 for channels that count.
    """
    count, rivals = len(x), preview.base.shape[0]
    at = compute_columns(preview, np.repeat(np.arange(rivals), count), np.tile(x, (rivals, 1)))
    failed = at.failed.reshape(rivals, count).any(axis=0)
    rows = count_rows(preview, at.end.reshape(rivals, count).min(axis=0), mask)
    pairs = tuple((i, j) for i in range(rivals) for j in range(rivals) if i != j)
    if not pairs:
        return Distances((), np.zeros((0, count)), np.zeros((0, *x.shape)), at, rows, failed)
    truth = np.concatenate([np.arange(count) + i * count for i, _ in pairs])
    own = np.concatenate([np.arange(count) + j * count for _, j in pairs])
    which = np.repeat([j for _, j in pairs], count)
    place, keep = np.tile(x, (len(pairs), 1)), np.tile(rows, (len(pairs), 1))
    goal = at.reading[truth] * keep
    final, moves = _refit(preview, which, place, keep, goal, Columns(*(field[own] for field in at)), steps)
    left = goal - final.reading * keep
    squares = np.sum(left**2, axis=1) + np.sum(moves**2, axis=1)
    slopes = 2.0 * np.einsum("ir,irc->ic", left, (at.chosen[truth] - final.chosen) * keep[..., None])
    shape = (len(pairs), count)
    return Distances(pairs, squares.reshape(shape), slopes.reshape(*shape, -1), at, rows, failed)


def _refit(preview: Preview, which: np.ndarray, place: np.ndarray, keep: np.ndarray, goal: np.ndarray, first: Columns,
           steps: int) -> tuple[Columns, np.ndarray]:
    """Levenberg-Marquardt of all items at once; columns and moves where each has the least distance."""
    slots = first.shared.shape[2]
    moves = np.zeros((len(which), slots + first.own.shape[2]))
    best, damping = first, np.full(len(which), 1e-6)
    cost = np.sum((goal - first.reading * keep) ** 2, axis=1)
    going = np.ones(len(which), dtype=bool)
    for _ in range(steps):
        columns = np.concatenate([best.shared, best.own], axis=2) * keep[..., None]
        pull = np.einsum("irk,ir->ik", columns, goal - best.reading * keep) - moves
        normal = np.einsum("irk,irl->ikl", columns, columns) + np.eye(moves.shape[1])
        scale = np.sqrt(np.einsum("ikk->ik", normal))
        scaled = normal / (scale[:, :, None] * scale[:, None, :]) + damping[:, None, None] * np.eye(moves.shape[1])
        trial = moves + np.linalg.solve(scaled, (pull / scale)[..., None])[..., 0] / scale
        at = compute_columns(preview, which, place, trial[:, :slots], trial[:, slots:])
        new = np.sum((goal - at.reading * keep) ** 2, axis=1) + np.sum(trial**2, axis=1)
        better = going & ~at.failed & np.isfinite(new) & (new <= cost)
        settled = better & (cost - new < SETTLED * new + 1e-9)
        best = Columns(*(np.where(better.reshape(-1, *[1] * (a.ndim - 1)), b, a)
                         for a, b in zip(best, at, strict=True)))
        moves, cost = np.where(better[:, None], trial, moves), np.where(better, new, cost)
        damping = np.where(better, 0.1 * damping, np.maximum(30.0 * damping, 1e-3))
        going &= ~settled
        if not going.any():
            break
    return best, moves


def value_separation(found: Distances) -> tuple[np.ndarray, np.ndarray]:
    r"""Mean over unordered pairs of $\ln(1 + \bar d^2)$ and its gradient, shapes (tests,) and (tests, free).

    $\bar d^2 = 2ab/(a + b)$ of both ways counts whichever model is true, and is smooth where they change places. A test
    at which a rival could not be computed is worth nothing.
    """
    worth, slope = np.zeros(found.squares.shape[1]), np.zeros(found.slopes.shape[1:])
    half = [pair for pair in found.pairs if pair[0] < pair[1]]
    for i, j in half:
        there, back = found.pairs.index((i, j)), found.pairs.index((j, i))
        a, b = found.squares[there], found.squares[back]
        total = a + b + 1e-12
        mean = 2.0 * a * b / total
        change = (2.0 * (b / total) ** 2)[:, None] * found.slopes[there]
        change = change + (2.0 * (a / total) ** 2)[:, None] * found.slopes[back]
        worth += np.log1p(mean) / len(half)
        slope += change / (1.0 + mean)[:, None] / len(half)
    return np.where(found.failed, 0.0, worth), np.where(found.failed[:, None], 0.0, slope)
