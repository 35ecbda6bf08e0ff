"""Records of a campaign stacked into arrays of a few standard sizes, so that compiled programs are shared."""

import dataclasses as dc
from collections.abc import Mapping

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._errors import InputError
from ..dynamics.impact import RTOL
from ..measurement.campaign import Campaign
from .noise import TAPS, Noise, whitening


CHANNELS = ("normal_force", "depression", "pressure")
THIN_RTOL = 1e-6  # of thinned records, on which candidates are only screened
RECORD_SIZES = (24, 48, 96, 192, 384, 768)
SAMPLE_SIZES = (768, 1536, 2048, 4096, 8192, 16384, 32768)


class Stack(eqx.Module):
    """Arrays of the records, padded; weight 0 marks what is not there.

    Attributes:
        time: shape (records, samples) [s].
        span: longest time to integrate, shape (records,) [s].
        values: measured, shape (records, channels, samples), SI.
        weights, taps: whitening filter, shapes (records, channels, samples) and (records, channels, samples, TAPS).
        conditions: by name, each shape (records,), SI, as measured.
        condition_sd: standard deviations of the nuisances, shape (records, nuisances): `nuisances` names them.
        present: 1 for records that are there, shape (records,).
        rtol: tolerance of the integrator, shape ().
    """

    time: Array
    span: Array
    values: Array
    weights: Array
    taps: Array
    conditions: dict[str, Array]
    condition_sd: Array
    present: Array
    rtol: Array = eqx.field(default_factory=lambda: jnp.asarray(RTOL))


@dc.dataclass(frozen=True)
class Records:
    """A stack with the names that belong to it.

    Attributes:
        keys: of the records.
        channels: that are measured.
        nuisances: conditions with a stated uncertainty, and `time`.
        lengths: samples of each record.
        complete: whether no sample is missing, shape (records, channels).
        stack: the arrays.
    """

    keys: tuple[str, ...]
    channels: tuple[str, ...]
    nuisances: tuple[str, ...]
    lengths: np.ndarray
    complete: np.ndarray
    stack: Stack

    @property
    def count(self) -> int:
        """Number of records."""
        return len(self.keys)


def _size(wanted: int, sizes: tuple[int, ...]) -> int:
    for size in sizes:
        if wanted <= size:
            return size
    return int(-(-wanted // sizes[-1]) * sizes[-1])


def list_nuisances(campaign: Campaign) -> tuple[str, ...]:
    """Conditions with a stated uncertainty, in a fixed order, and the time origin."""
    first = [c for c in ("initial_pressure", "approach_speed") if c in campaign.conditions]
    rest = [c for c, column in campaign.conditions.items()
            if c not in first and c != "sequence" and column.uncertainty is not None]
    return (*first, *rest, "time")


def condition_deviations(campaign: Campaign, records, nuisances: tuple[str, ...]) -> np.ndarray:
    """Standard deviation of every nuisance of every record, shape (records, nuisances), SI; 0 where none is stated."""
    columns = []
    for name in nuisances:
        if name == "time":
            uncertainty = campaign.independent.uncertainty if campaign.independent is not None else None
            columns.append(np.zeros(len(records)) if uncertainty is None else uncertainty.sd(np.ones(len(records))))
        else:
            uncertainty = campaign.conditions[name].uncertainty
            values = records[name].to_numpy(dtype=float)
            columns.append(np.zeros(len(values)) if uncertainty is None else uncertainty.sd(values))
    return np.stack(columns, axis=1)


def stack_records(campaign: Campaign, noise: Mapping[str, Noise] | None = None, most: int | None = None) -> Records:
    """Stack the samples of an impact campaign.

    Samples of the force within three deviations of the time origin are left out: it may jump at first touch, and
    whether such a sample lies before or after the jump is not known. Samples of the pressure after the last force
    above four deviations are left out too: what the gas does once the ball is free (supply line, check valve, warming)
    is no part of the contact.

    Args:
        campaign: of family `impact`, with samples.
        noise: by channel; white at the stated deviation where not given.
        most: thin every record evenly to at most so many samples.

    Raises:
        InputError: no samples, no channel that the model predicts, no approach speed.
    """
    if campaign.samples is None:
        raise InputError(f"campaign {campaign.name!r} holds peaks only; this needs sampled records")
    channels = tuple(c for c in CHANNELS if c in campaign.channels)
    if "normal_force" not in channels:
        raise InputError(f"campaign {campaign.name!r} has no channel 'normal_force'; it has: "
                         + ", ".join(campaign.channels))
    for need in ("approach_speed",):
        if need not in campaign.records:
            raise InputError(f"campaign {campaign.name!r} has no condition {need!r} in its records")
    keys = campaign.record_keys
    groups = {str(k): g for k, g in campaign.samples.groupby("record", sort=False)}
    if most is not None:
        groups = {k: g.iloc[:: -(-len(g) // most)] for k, g in groups.items()}
    lengths = np.array([len(groups[str(k)]) for k in keys])
    uncertainty = None if campaign.independent is None else campaign.independent.uncertainty
    blind = 3.0 * float(np.max(uncertainty.sd(np.ones(1)))) if uncertainty is not None else 0.0
    complete = np.ones((len(keys), len(channels)), dtype=bool)
    rows, size = _size(len(keys), RECORD_SIZES), _size(int(lengths.max()), SAMPLE_SIZES)
    time = np.zeros((rows, size))
    values = np.zeros((rows, len(channels), size))
    weights, taps = np.zeros_like(values), np.zeros((*values.shape, TAPS))
    cache: dict = {}
    for r, key in enumerate(keys):
        group, n = groups[str(key)], lengths[r]
        t = group["time"].to_numpy(dtype=float)
        time[r, :n] = t
        time[r, n:] = t[-1]
        last = _last_contact(t, group["normal_force"].to_numpy(dtype=float), default_noise(campaign, "normal_force", t))
        for c, channel in enumerate(channels):
            x = group[channel].to_numpy(dtype=float)
            valid = np.isfinite(x)
            complete[r, c] = valid.all()
            values[r, c, :n] = np.where(valid, x, 0.0)
            if blind > 0 and channel == "normal_force":
                valid = valid & (np.abs(t) > blind)
            level = (noise or {}).get(channel) or default_noise(campaign, channel, t)
            if channel == "pressure":
                valid = valid & (t < last)
            if level.correlation <= 0:
                weights[r, c, :n] = np.where(valid, 1.0 / level.sd, 0.0)
                continue
            code = (c, valid.tobytes(), np.round(np.diff(t), 8).tobytes())
            if code not in cache:
                cache[code] = whitening(level, t, valid)
            weights[r, c, :n], taps[r, c, :n] = cache[code]
    time[len(keys):] = time[0]
    nuisances = list_nuisances(campaign)
    deviations = np.zeros((rows, len(nuisances)))
    deviations[: len(keys)] = condition_deviations(campaign, campaign.records, nuisances)
    conditions = {}
    for name in campaign.records.columns:
        column = campaign.records[name].to_numpy(dtype=float)
        conditions[str(name)] = np.concatenate([column, np.full(rows - len(keys), column[0])])
    conditions.setdefault("initial_pressure", np.zeros(rows))
    conditions.setdefault("sequence", np.ones(rows))
    present = (np.arange(rows) < len(keys)).astype(float)
    span = time.max(axis=1) + 5e-3 * (time.max(axis=1) - np.maximum(time.min(axis=1), 0.0))
    stack = Stack(jnp.asarray(time), jnp.asarray(span), jnp.asarray(values), jnp.asarray(weights), jnp.asarray(taps),
                  {k: jnp.asarray(v) for k, v in conditions.items()}, jnp.asarray(deviations), jnp.asarray(present),
                  jnp.asarray(RTOL if most is None else THIN_RTOL))
    return Records(tuple(str(k) for k in keys), channels, nuisances, lengths, complete, stack)


def _last_contact(time: np.ndarray, force: np.ndarray, noise: Noise) -> float:
    """Time of the last force above four deviations, or the end where there is none."""
    above = np.flatnonzero(np.nan_to_num(force) > 4.0 * noise.sd)
    return float(time[above[-1]]) if len(above) else float(time[-1])


def default_noise(campaign: Campaign, channel: str, time: np.ndarray) -> Noise:
    """White noise of the stated size."""
    uncertainty = campaign.channels[channel].uncertainty
    if uncertainty is None:
        raise InputError(f"campaign {campaign.name!r}: channel {channel!r} states no uncertainty; add one standard "
                         f"deviation to its field, such as \"uncertainty\": \"0.25 N\"")
    assert campaign.samples is not None
    typical = np.abs(campaign.samples[channel].to_numpy(dtype=float))
    sd = float(np.atleast_1d(uncertainty.sd(np.nanmedian(typical[np.isfinite(typical)])))[0])
    interval = float(np.median(np.diff(time)))
    return Noise(sd, 0.0, 0.0, interval, sd, 0.0, "white, of the stated size")
