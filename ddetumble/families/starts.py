"""What a tumbling record starts from: rates (and attitude) at t = 0, guessed from its samples, and its mesh.

They are free in every record, without a prior: the guess is only where a fit begins.
"""

from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

from .._errors import InputError
from .._rotation import from_rotation_vector, multiply, to_rotation_vector
from ..dynamics.spinning import ATTITUDES, RATES, START, START_ATTITUDE, count_steps
from ..measurement.campaign import Campaign
from .family import Starts


# Rad, over which Euler's equations are integrated to guess the ratio of the moments: longer, they run out of step;
# shorter, noise decides.
WINDOW = 1.0
FREE = 1e3  # standard deviation of a start over the largest rate: far more than any fit moves it
# Steps of a mesh: few sizes, so that few programs are compiled, and close enough that little is padded.
MESHES = (64, 96, 128, 160, 192, 256, 320, 384, 512, 768, 1024, 1280, 1536, 2048, 3072, 4096, 8192, 16384)


def stack_starts(campaign: Campaign, groups: Sequence[Any]) -> Starts:
    """Starts of all records, and meshes of even times from 0 to the last sample, shape (records, steps + 1) [s].

    Args:
        campaign: of tumbling records.
        groups: samples of each record, tables with `time` and the channels.

    Raises:
        InputError: a rate that is missing throughout, times before 0 or far behind it, attitudes that are none.
    """
    attitudes = _list_attitudes(campaign)
    table = None if campaign.path is None else campaign.path / "samples.csv"
    times, rates = read_rates(campaign, groups)
    ratio = campaign.known.get("inertia_ratio") or guess_ratio(times, rates)
    begun = np.array([w[0] for w in rates])
    # Torque-free, the transverse rates turn back to t = 0 at (1 - r) omega_z.
    across = (begun[:, 0] + 1j * begun[:, 1]) * np.exp(1j * (1.0 - ratio) * begun[:, 2] * [t[0] for t in times])
    begun[:, 0], begun[:, 1] = across.real, across.imag
    found = {name: begun[:, k] for k, name in enumerate(START)}
    if attitudes:
        vectors = []
        for key, group, start in zip(campaign.record_keys, groups, begun, strict=True):
            vectors.append(_guess_attitude(group, attitudes, start, str(key), table))
        found |= {name: np.array(vectors)[:, k] for k, name in enumerate(START_ATTITUDE)}
    fastest = [float(np.sqrt(np.sum(w**2, axis=1)).max()) for w in rates]
    widths = [FREE * max(fastest), FREE]
    wide = np.stack([np.full(len(times), widths[k >= len(START)]) for k in range(len(found))], axis=1)
    return Starts(found, wide, {"mesh": lay_mesh(times, fastest)})


def lay_mesh(times: Sequence[np.ndarray], speeds: Sequence[float] | np.ndarray) -> np.ndarray:
    """Even times to integrate on, from 0 to the last wanted one, as many for all records, (records, steps + 1) [s].

    Of the ascending times of the samples of each record [s] and its largest angular speed [rad/s].
    """
    steps = 1
    for t, speed in zip(times, speeds, strict=True):
        gaps = np.diff(np.concatenate([[0.0], t]))
        interval = float(np.median(gaps[gaps > 0])) if np.any(gaps > 0) else 1.0
        steps = max(steps, count_steps(float(t[-1]), float(speed), interval))
    steps = next((size for size in MESHES if steps <= size), -(-steps // MESHES[-1]) * MESHES[-1])
    return np.stack([np.linspace(0.0, max(float(t[-1]), 1e-3), steps + 1) for t in times])


def read_rates(campaign: Campaign, groups: Sequence[Any]) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Times (samples,) [s] and rates (samples, 3) [rad/s] of all records, gaps filled.

    Raises:
        InputError: a rate that is missing throughout, times before 0 or far behind it.
    """
    missing = [rate for rate in RATES if rate not in campaign.channels]
    if missing:
        raise InputError(f"campaign {campaign.name!r} has no channel {missing[0]!r}; its channels are: "
                         + ", ".join(campaign.channels))
    table = None if campaign.path is None else campaign.path / "samples.csv"
    times, rates = [], []
    for key, group in zip(campaign.record_keys, groups, strict=True):
        time = group["time"].to_numpy(dtype=float)
        if time[0] < 0:
            raise InputError(f"record {key!r} begins at {time[0]:g} s; times of a tumbling record count from its start "
                             "at t = 0, where the rates are free: shift them", file=table, column="time")
        if time[0] > 0.5 * time[-1]:
            raise InputError(f"record {key!r} lasts from {time[0]:g} to {time[-1]:g} s; times of a tumbling record "
                             f"count from its start: subtract {time[0]:g} s", file=table, column="time")
        values = group[list(RATES)].to_numpy(dtype=float)
        empty = ~np.isfinite(values).any(axis=0)
        if empty.any():
            raise InputError(f"record {key!r} has no value of this rate, but the model needs all three", file=table,
                             column=RATES[int(np.argmax(empty))])
        times.append(time)
        rates.append(fill_gaps(time, values))
    return times, rates


def straighten(values: np.ndarray) -> np.ndarray:
    """Quaternions without jumps of their sign, beginning with a scalar part that is not negative, shape (samples, 4).

    A missing number leaves its whole sample as it is.
    """
    values, last = values.copy(), np.eye(values.shape[1])[0]
    for k, one in enumerate(values):
        if np.isfinite(one).all():
            values[k] = last = -one if one @ last < 0 else one
    return values


def guess_ratio(times: Sequence[np.ndarray], rates: Sequence[np.ndarray]) -> float:
    r"""Axial over transverse moment by regression of Euler's equations, integrated over about a radian.

    $\Delta\omega_x = (1 - r) \int \omega_y \omega_z dt$ and $\Delta\omega_y = -(1 - r) \int \omega_x \omega_z dt$, by
    the trapezoidal rule; torques and noise matter little over so short a time. Times (samples,) [s] and rates (samples,
    3) [rad/s], without gaps, by record. Within what a body can have; 0.5 where no record nutates.
    """
    above = below = 0.0
    for t, w in zip(times, rates, strict=True):
        change, cause = integrate_couple(t, w)
        above, below = above + float(np.sum(change * cause)), below + float(np.sum(cause**2))
    ratio = 1.0 - above / below if below > 0 else 0.5
    return float(np.clip(ratio, 0.02, 1.98)) if np.isfinite(ratio) else 0.5


def integrate_couple(t: np.ndarray, w: np.ndarray, window: float = WINDOW) -> tuple[np.ndarray, np.ndarray]:
    r"""Changes of the transverse rates over a window, and what 1 - r is to be multiplied with to give them [rad/s].

    Both (samples - lag, 2), of times (samples,) [s] and rates (samples, 3) [rad/s] without gaps; in the window the body
    turns at its fastest by `window` [rad].
    """
    step = float(np.median(np.diff(t)))
    lag = int(np.clip(window / max(float(np.sqrt(np.sum(w**2, axis=1)).max()) * step, 1e-300), 1, len(t) // 2))
    push = np.stack([w[:, 1] * w[:, 2], -w[:, 0] * w[:, 2]], axis=1)
    area = np.concatenate([np.zeros((1, 2)), np.cumsum(0.5 * (push[1:] + push[:-1]) * np.diff(t)[:, None], axis=0)])
    return w[lag:, :2] - w[:-lag, :2], area[lag:] - area[:-lag]


def guess_body(campaign: Campaign) -> float:
    """Ratio of the moments, guessed from all records of a campaign."""
    assert campaign.samples is not None
    return guess_ratio(*read_rates(campaign, [group for _, group in campaign.samples.groupby("record", sort=False)]))


def fill_gaps(time: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Gaps filled along a line."""
    there = np.isfinite(values)
    return np.stack([np.interp(time, time[t], v[t]) for v, t in zip(values.T, there.T, strict=True)], axis=1)


def _list_attitudes(campaign: Campaign) -> tuple[str, ...]:
    """The four channels of the attitude; none where it is not measured.

    Raises:
        InputError: some of the four are missing.
    """
    for names in (ATTITUDES[:4], ATTITUDES[4:]):
        there = [name for name in names if name in campaign.channels]
        if len(there) == 4:
            return names
        if there:
            missing = next(name for name in names if name not in there)
            raise InputError(f"campaign {campaign.name!r} has the channel {there[0]!r} but not {missing!r}; an "
                             "attitude is a unit quaternion of four numbers, scalar first", column=missing,
                             file=None if campaign.path is None else campaign.path / "datapackage.json")
    return ()


def _guess_attitude(group: Any, names: tuple[str, ...], rate: np.ndarray, key: str, table: Any) -> np.ndarray:
    """Rotation vector of the attitude at t = 0 [rad]."""
    values = group[list(names)].to_numpy(dtype=float)
    there = np.isfinite(values).all(axis=1)
    if not there.any():
        raise InputError(f"record {key!r} has no attitude; leave it or the channels out", file=table, column=names[0])
    size = np.sqrt(np.sum(values[there] ** 2, axis=1))
    if np.abs(size - 1.0).max() > 0.1:
        bad = size[np.argmax(np.abs(size - 1.0))]
        raise InputError(f"record {key!r} has an attitude of length {bad:.3g}; unit quaternions, scalar first, are "
                         "needed", file=table, column=names[0])
    k = int(np.argmax(there))
    back = from_rotation_vector(jnp.asarray(-rate * float(group["time"].to_numpy(dtype=float)[k])))
    return np.asarray(to_rotation_vector(multiply(jnp.asarray(values[k] / size[0]), back)))
