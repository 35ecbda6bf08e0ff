"""Records of a campaign stacked into arrays of a few standard sizes, so that compiled programs are shared."""

import dataclasses as dc
from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._errors import InputError
from ..dynamics.impact import RTOL
from ..families import Family, find_family, name_family
from ..families.starts import straighten
from ..measurement.campaign import Campaign
from ..measurement.units import Uncertainty
from .noise import TAPS, Noise, scale_whitening, whitening, whitening_matrix, widen_by_student
from .parameters import Common


THIN_RTOL = 1e-6  # of thinned records, on which candidates are only screened
GRAIN = 64  # trimmed records keep a multiple of so many samples
SHARED = 60_000  # padded samples up to which records take a standard shape, so that small campaigns share programs
ROWS = (1, 2, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128)  # of larger ones: a record may be left out in the same program
STATED = 0.1  # standard error of the logarithm of a noise power that is stated: few state it to better than 5 %
ALIKE = 1e-6  # relative difference of deviations below which all are of one size
ZERO, DRIFT = "zero", "drift"  # nuisances `zero:CHANNEL` and `drift:CHANNEL`: offset at the first sample, and what more
SINE, COSINE = "sine", "cosine"  # nuisances `sine-0:CHANNEL` and `cosine-0:CHANNEL`: of the first hum of the campaign


class Stack(eqx.Module):
    """Arrays of the records, padded; weight 0 marks what is not there."""

    time: Array  # shape (records, samples) [s]
    span: Array  # longest time to integrate, shape (records,) [s]
    values: Array  # measured, shape (records, channels, samples), SI
    # weights, taps: whitening filter, shapes (records, channels, samples) and (records, channels, samples, TAPS).
    weights: Array
    taps: Array
    conditions: dict[str, Array]  # by name, each shape (records,), SI, as measured
    condition_sd: Array  # standard deviations of the nuisances, shape (records, nuisances)
    present: Array  # 1 for records that are there, shape (records,)
    # Further arrays that the model reads, by name: path and direction of slip records that are time series, shape
    # (records, samples); `mesh` of tumbling records, shape (records, steps + 1) [s]; `common`, by how much a column
    # moves per unit of an error that all records share, shape (records, commons); `hum`, angular frequencies over the
    # independent variable, shape (records, hums).
    inputs: dict[str, Array] = eqx.field(default_factory=dict)
    rtol: Array = eqx.field(default_factory=lambda: jnp.asarray(RTOL))  # tolerance of the integrator, shape ()


@dc.dataclass(frozen=True)
class Records:
    """A stack with the names that belong to it."""

    # keys, channels: of the records, and what is measured.
    keys: tuple[str, ...]
    channels: tuple[str, ...]
    # What tumbling records start from, conditions with a stated uncertainty, `time`, zeros that move, hum.
    nuisances: tuple[str, ...]
    lengths: np.ndarray  # samples of each record
    complete: np.ndarray  # whether no sample is missing, shape (records, channels)
    # stack, family: the arrays, and the kind of test.
    stack: Stack
    family: str
    strokes: tuple[np.ndarray, ...] = ()  # number of the stroke of every sample, by record; empty for impacts
    starts: tuple[str, ...] = ()  # nuisances without a prior: what tumbling records start from

    @property
    def count(self) -> int:
        """Number of records."""
        return len(self.keys)

    @property
    def are_values(self) -> bool:
        """Whether every record is a single sample: values, of which a test gives one each, and no series."""
        return int(self.lengths.max()) == 1

    @property
    def used(self) -> np.ndarray:
        """Which samples count, shape (records, channels, samples)."""
        return np.asarray(self.stack.weights)[: self.count] > 0

    def whiten(self, record: int, channel: int, columns: np.ndarray) -> np.ndarray:
        """Columns over the samples of one channel, shape (samples, columns), as rows of the record's whitened
        residual, shape (rows, columns)."""
        n = self.lengths[record]
        weights, taps = np.asarray(self.stack.weights)[record], np.asarray(self.stack.taps)[record]
        found = np.zeros((*weights.shape, columns.shape[1]))
        found[channel, :n] = whitening_matrix(weights[channel, :n], taps[channel, :n]) @ columns
        return found.reshape(-1, columns.shape[1])


def _pad_size(wanted: int, sizes: tuple[int, ...]) -> int:
    """Smallest of the sizes that holds `wanted`; beyond the last one a multiple of it."""
    return next((size for size in sizes if wanted <= size), int(-(-wanted // sizes[-1]) * sizes[-1]))


def pad_shape(count: int, longest: int, family: Family) -> tuple[int, int]:
    """Records and samples to which a campaign is padded: a standard shape while that is small.

    A large campaign is worth a program of its own: it has at most half as many rows more than records, and an eighth
    more samples than the longest of them.
    """
    rows, size = _pad_size(count, family.rows), _pad_size(longest, family.sizes)
    if rows * size <= SHARED:
        return rows, size
    step = max(GRAIN, 2 ** (longest.bit_length() - 4))
    return min(rows, _pad_size(count, ROWS)), min(size, _pad_size(longest, (step,)))


def list_nuisances(campaign: Campaign) -> tuple[str, ...]:
    """Conditions with a stated uncertainty, in a fixed order, and the time origin."""
    first = [c for c in ("initial_pressure", "approach_speed") if c in campaign.conditions]
    rest = [c for c, column in campaign.conditions.items()
            if c not in first and c != "sequence" and column.uncertainty is not None]
    return (*first, *rest, "time")


def is_added(nuisance: str) -> bool:
    """Whether a nuisance adds to the readings of a channel (a zero, a drift, a hum), and is no setting."""
    return ":" in nuisance


def list_paces(campaign: Campaign) -> np.ndarray:
    """Seconds per unit of the independent variable in every record, shape (records,)."""
    pace, clock = find_family(name_family(campaign)).pace, campaign.independent
    if clock is None or clock.name == "time" or pace not in campaign.records:
        return np.ones(len(campaign.records))
    return 1.0 / campaign.records[pace].to_numpy(dtype=float)


def list_commons(campaign: Campaign) -> tuple[Common, ...]:
    """Errors that all records share, as the campaign states them: of the time origin, conditions and channels."""
    family = find_family(name_family(campaign))
    columns = {"time": campaign.independent} | {
        name: column for name, column in campaign.conditions.items() if name != "sequence"} | {
        name: column for name, column in campaign.channels.items() if name in family.channels or name in family.values}
    return tuple(Common(name, float(spread.absolute or 0.0 if spread.relative is None else spread.relative),
                        spread.relative is not None, column.unit) for name, column in columns.items()
                 if column is not None and (spread := column.common) is not None)


def condition_deviations(campaign: Campaign, records, nuisances: tuple[str, ...]) -> np.ndarray:
    """Standard deviation of every nuisance of every record, shape (records, nuisances), SI; 0 where none is stated."""
    return np.stack([np.full(len(records), campaign.time_sd) if name == "time" else
                     campaign.conditions[name].sd(records[name]) for name in nuisances], axis=1)


def stack_records(campaign: Campaign, noise: Mapping[str, Noise] | None = None, most: int | None = None,
                  zeros: Mapping[str, tuple[float, float]] | None = None) -> Records:
    """Stack the samples of a campaign.

    Samples of the forces of a contact close to the time origin are left out (`Family.tell_sides`), as it is not known
    whether they lie before or after the jump that there may be at first touch. Samples of the pressure after the last
    force above four deviations are left out too: what the gas does once the ball is free (supply line, check valve,
    warming) is no part of the contact; and the samples where a slip record turns round, as the sign of the force is not
    known.

    Args:
        campaign: with samples.
        noise: by channel; white at the stated deviation where not given.
        most: thin every record evenly to at most so many samples.
        zeros: standard deviations of offset and drift of a channel's zero, SI: they are nuisances of every record.
    """
    assert campaign.samples is not None
    family = find_family(name_family(campaign))
    channels = tuple(c for c in family.channels if c in campaign.channels)
    clock = campaign.independent
    main, abscissa = family.channels[0], "time" if clock is None else clock.name
    for need in family.main:
        if need not in channels and not set(channels) & set(family.values):
            raise InputError(f"campaign {campaign.name!r} has no channel {need!r}; it has: "
                             + ", ".join(campaign.channels))
    for need in family.needs:
        if need not in campaign.records:
            raise InputError(f"campaign {campaign.name!r} has no condition {need!r} in its records")
    keys = tuple(map(str, campaign.record_keys))
    by_key = {str(k): g for k, g in campaign.samples.groupby("record", sort=False)}
    groups = [by_key[k] for k in keys]
    thin = [1 if most is None else -(-len(g) // most) for g in groups]
    groups = [g.iloc[::step] for g, step in zip(groups, thin, strict=True)]
    lengths = np.array([len(g) for g in groups])
    complete = np.ones((len(keys), len(channels)), dtype=bool)
    rows, size = pad_shape(len(keys), int(lengths.max()), family)
    time = np.zeros((rows, size))
    values = np.zeros((rows, len(channels), size))
    weights, taps = np.zeros_like(values), np.zeros((*values.shape, TAPS))
    moving = family.follow is not None and abscissa != family.independent
    path, direction, strokes = np.zeros_like(time), np.ones_like(time), []
    cache: dict = {}
    for r, (key, group, n) in enumerate(zip(keys, groups, lengths, strict=True)):
        t = group[abscissa].to_numpy(dtype=float)
        time[r, :n], time[r, n:] = t, t[-1]
        turning = np.zeros(n, dtype=bool)
        if family.follow is not None:
            number = np.zeros(n, dtype=int)
            if moving:
                path[r, :n], direction[r, :n], number = family.follow(campaign, key, group)
                path[r, n:], direction[r, n:] = path[r, n - 1], direction[r, n - 1]
                turning[1:] = np.diff(number) > 0
                turning[:-1] |= turning[1:]
            strokes.append(number)
        last = np.inf
        if family.has_contact and main in channels:  # the last force above four deviations, or the end if none is
            force = np.nan_to_num(group[main].to_numpy(dtype=float))
            above = np.flatnonzero(force > 4.0 * default_noise(campaign, main, t).sd)
            last = t[above[-1]] if len(above) else t[-1]
        attitude = [channel for channel in channels if channel.startswith("attitude_")]
        straight = straighten(group[attitude].to_numpy(dtype=float)) if attitude else None
        for c, channel in enumerate(channels):
            x = group[channel].to_numpy(dtype=float)
            if straight is not None and channel in attitude:
                x = straight[:, attitude.index(channel)]
            valid = np.isfinite(x)
            complete[r, c] = valid.all()
            values[r, c, :n] = np.where(valid, x, 0.0)
            valid = valid & ~turning & family.tell_sides(channel, t, campaign.time_sd)
            if channel == "pressure":
                valid = valid & (t < last)
            level = (noise or {}).get(channel) or default_noise(campaign, channel, t)
            code = (c, valid.tobytes(), np.round(np.diff(t), 8).tobytes())
            sizes = level.sizes[key][:: thin[r]] if key in level.sizes else np.ones(n)
            if level.is_white:
                weights[r, c, :n] = np.where(valid, 1.0 / level.sd, 0.0) / sizes
                continue
            if code not in cache:
                cache[code] = whitening(level, t, valid)
            known, filter_taps = cache[code]
            weights[r, c, :n], taps[r, c, :n] = scale_whitening(known, filter_taps, sizes)
    time[len(keys):] = time[0]

    def pad(x: np.ndarray) -> np.ndarray:
        """Rows that are not there are like the first one."""
        return np.concatenate([x, np.repeat(x[:1], rows - len(keys), axis=0)])

    begun = family.begin(campaign, groups) if family.begin is not None else None
    nuisances, starts = list_nuisances(campaign), () if begun is None else tuple(begun.guesses)
    moved = tuple(f"{kind}:{channel}" for channel in zeros or () for kind in (ZERO, DRIFT))
    hums = [(channel, *line) for channel, level in (noise or {}).items() if channel in channels for line in level.hum]
    humming = tuple(f"{kind}-{k}:{channel}" for k, (channel, *_) in enumerate(hums) for kind in (SINE, COSINE))
    deviations = np.zeros((rows, len(starts) + len(nuisances) + len(moved) + len(humming)))
    stated = slice(len(starts), len(starts) + len(nuisances))
    deviations[: len(keys), stated] = condition_deviations(campaign, campaign.records, nuisances)
    deviations[: len(keys), stated.stop:] = [*(sd for both in (zeros or {}).values() for sd in both),
                                             *(sd for *_, sd in hums for _ in (SINE, COSINE))]
    conditions = {str(name): pad(x.to_numpy(dtype=float)) for name, x in campaign.records.items()}
    for name, value in {"sequence": 1.0, **family.defaults}.items():
        conditions.setdefault(name, np.full(rows, value))
    inputs = {}
    if begun is not None:
        deviations[: len(keys), : len(starts)] = begun.deviations
        conditions |= {name: pad(x) for name, x in begun.guesses.items()}
        inputs = {name: pad(x) for name, x in begun.inputs.items()}
    if moving:
        inputs = {family.state: pad(path[: len(keys)]), family.rate: pad(direction[: len(keys)])}
    commons = list_commons(campaign)
    if commons:
        inputs["common"] = np.stack([conditions[c.column] if c.relative and c.column in conditions else np.ones(rows)
                                     for c in commons], axis=1)
    if hums:
        inputs["hum"] = pad(2.0 * np.pi * np.outer(list_paces(campaign), [frequency for _, frequency, _ in hums]))
    span = time.max(axis=1) + 5e-3 * (time.max(axis=1) - np.maximum(time.min(axis=1), 0.0))
    present = (np.arange(rows) < len(keys)).astype(float)
    arrays: Any = jax.tree.map(jnp.asarray, (time, span, values, weights, taps, conditions, deviations, present,
                                             inputs, RTOL if most is None else THIN_RTOL))
    return Records(keys, channels, (*starts, *nuisances, *moved, *humming), lengths, complete, Stack(*arrays),
                   family.name, tuple(strokes), starts)


def trim_records(records: Records) -> Records:
    """Without padding: as many rows as there are records, and samples to a multiple of a few."""
    old, rows, padded = records.stack, records.count, records.stack.time.shape[1]
    size = min(-(-int(records.lengths.max()) // GRAIN) * GRAIN, padded)
    # A mesh has steps, and common errors and hums have no samples.
    inputs = {k: v[:rows] if k in ("mesh", "common", "hum") else v[:rows, :size] for k, v in old.inputs.items()}
    stack = Stack(old.time[:rows, :size], old.span[:rows], old.values[:rows, :, :size], old.weights[:rows, :, :size],
                  old.taps[:rows, :, :size], {k: v[:rows] for k, v in old.conditions.items()},
                  old.condition_sd[:rows], old.present[:rows], inputs, old.rtol)
    return dc.replace(records, stack=stack)


def hold_conditions(records: Records) -> Records:
    """Records whose conditions, time origins and common errors are exact; what they start from stays free."""
    free = jnp.asarray([name in records.starts for name in records.nuisances])
    still = jnp.where(free, records.stack.condition_sd, 0.0)
    inputs = {name: x for name, x in records.stack.inputs.items() if name != "common"}
    return dc.replace(records, stack=dc.replace(records.stack, condition_sd=still, inputs=inputs))


def widen_settings(records: Records, ratios: Mapping[str, float]) -> Records:
    """Records whose settings are so many times as uncertain as stated, by name."""
    if not ratios:
        return records
    by_nuisance = jnp.asarray([ratios.get(name, 1.0) for name in records.nuisances])
    wider = records.stack.condition_sd * by_nuisance
    return dc.replace(records, stack=dc.replace(records.stack, condition_sd=wider))


def default_noise(campaign: Campaign, channel: str, time: np.ndarray) -> Noise:
    """White noise of the stated size; of records that are one value, of each value's own size."""
    uncertainty = campaign.channels[channel].uncertainty
    if uncertainty is None:
        raise InputError(f"campaign {campaign.name!r}: channel {channel!r} states no uncertainty; add one standard "
                         f"deviation to its field, such as \"uncertainty\": \"0.25 N\"")
    assert campaign.samples is not None
    if len(time) < 2:
        return _describe_values(campaign, channel, uncertainty)
    typical = np.abs(campaign.samples[channel].to_numpy(dtype=float))
    sd = float(np.atleast_1d(uncertainty.sd(np.nanmedian(typical[np.isfinite(typical)])))[0])
    interval = float(np.median(np.diff(time)))
    return Noise(sd, 0.0, 0.0, interval, sd, 0.0, "white, of the stated size")


def _describe_values(campaign: Campaign, channel: str, uncertainty: Uncertainty) -> Noise:
    """Noise of values of which a record has one.

    Where its size was estimated from few values, it is taken so much larger that the 95 % interval of a normal
    distribution is as wide as Student's.
    """
    assert campaign.samples is not None
    degrees = campaign.channels[channel].degrees
    stated = not np.isfinite(degrees)
    wider = 1.0 if stated else widen_by_student(degrees)
    values = campaign.samples.set_index("record")[channel]
    deviations = wider * np.asarray(uncertainty.sd(values.to_numpy(dtype=float)))
    there = np.isfinite(deviations)
    sd = float(np.sqrt(np.mean(deviations[there] ** 2)))
    relative = np.where(there, deviations, sd) / sd
    text = "of the stated size" if stated else (
        f"from the scatter of the values, {degrees:.0f} degrees of freedom, and {wider:.3g} times as large as that, as "
        "Student's distribution asks for")
    alike = bool(np.ptp(relative) < ALIKE)
    floor = None if alike else wider * (uncertainty.absolute or 0.0)
    share = 0.0 if alike else wider * (uncertainty.relative or 0.0)
    sizes = {} if alike else {str(key): x[None] for key, x in zip(values.index, relative, strict=True)}
    return Noise(sd, 0.0, 0.0, 1.0, sd if stated else None, STATED if stated else float(np.sqrt(2.0 / degrees)), text,
                 floor, share, sizes=sizes, degrees=0 if stated else int(degrees))
