"""Zeros that move in every record: an offset and a slope of each record's own, which no physics explains.

What is the same in all records, or follows their conditions, may be physics (a bias of the gyroscopes, an adhesive
force) and is left to the catalogue. A zero that is off by another amount in every record is a fault of the gauge.
"""

import dataclasses as dc

import numpy as np
from scipy import stats

from ..inference.problem import Solution
from ..inference.stack import DRIFT
from ..measurement.faults import Fault
from .leave_record_out import whiten_columns
from .problem import SelectionProblem


PAIRS = 2_000_000  # of samples whose covariances are computed at once


@dc.dataclass(frozen=True)
class MovingZero:
    """A channel whose zero moves.

    Attributes:
        channel: which one.
        offset, drift: largest over its records, SI.
        spread: standard deviations of offset and drift over the records, SI: their prior in a fit, so that a trend over
            the conditions is left to physics.
        share: of the misfit that they remove.
    """

    channel: str
    offset: float
    drift: float
    spread: tuple[float, float]
    share: float


def find_moving_zeros(selection: SelectionProblem, solution: Solution, final: bool) -> MovingZero | None:
    """The channel whose zeros, free in every record, remove most of a model's misfit; None where none does.

    Args:
        selection: of the campaign.
        solution: of the model.
        final: whether the catalogue has been tried. Before that only zeros are looked for that show before first touch:
            an effect may look like another zero at every condition.
    """
    records, best = selection.records, None
    if records.count < selection.settings.baseline.fewest or (not selection.family.has_contact and not final):
        return None
    for c, channel in enumerate(records.channels):
        if f"{DRIFT}:{channel}" in records.nuisances or channel.startswith("attitude_"):
            continue
        if selection.family.has_contact and not _moves_before_touch(selection, c):
            continue
        found = _free_zeros(selection, solution, c, channel)
        if found is not None and (best is None or found.share > best.share):
            best = found
    return best


def tell_zero(selection: SelectionProblem, zero: MovingZero, keep: bool) -> Fault:
    """A moving zero in words."""
    unit = selection.campaign.channels[zero.channel].unit
    seen = (f"The zero of {zero.channel} is another in every record: off by up to {zero.offset:.2g} {unit} at the "
            f"start, and drifting by up to {zero.drift:.2g} {unit} more until the end.")
    done = "Nothing is done about it, as asked." if keep else "Zero and drift of each record are fitted with it."
    return Fault("zero", selection.records.keys, zero.channel, seen, done,
                 "Let the gauge warm up, and take its zero before each test.")


def _free_zeros(selection: SelectionProblem, solution: Solution, c: int, channel: str) -> MovingZero | None:
    """Fit zero and drift of every record along with everything else, to first order."""
    records, count, limits = selection.records, selection.records.count, selection.settings.baseline
    own = solution.own.shape[2]
    extra = np.zeros((count, solution.residual.shape[1] + own, 2))
    for r, n in enumerate(records.lengths):
        t = np.asarray(records.stack.time)[r, :n]
        ramp = (t - t[0]) / (t[-1] - t[0])
        extra[r, :-own or None] = whiten_columns(selection.problem, r, c, np.stack([np.ones(n), ramp], axis=1))
    prior = np.broadcast_to(np.eye(own), (count, own, own))
    rows = np.concatenate([solution.own, prior], axis=1)
    shared = np.concatenate([solution.shared, np.zeros((count, own, solution.shared.shape[2]))], axis=1)
    right = np.concatenate([solution.residual, solution.z], axis=1)
    both = np.concatenate([rows, extra], axis=2)
    size = np.maximum(np.linalg.norm(both, axis=1, keepdims=True), 1e-300)
    columns, side = solution.projected(more=extra)
    step = np.zeros(0)
    if shared.shape[2]:
        step = np.linalg.lstsq(columns.reshape(-1, columns.shape[2]), -side.ravel(), rcond=1e-10)[0]
        side = side + columns @ step
    used = float((np.asarray(records.stack.weights) > 0).sum()) - solution.shared.shape[2]
    before = float(np.sum(right**2))
    gain, excess = before - float(np.sum(side**2)), before - used
    seen = selection.family.has_contact
    if excess <= 0 or stats.chi2.sf(gain, 2 * count) > limits.p_value or gain < (
            limits.removed if seen else limits.removed_unseen) * excess:
        return None
    moved = right + (shared @ step if shared.shape[2] else 0.0)
    found, error = np.zeros((count, 2)), np.zeros((count, 2))
    for r in range(count):
        a = both[r] / size[r]
        inverse = np.linalg.pinv(a.T @ a, rcond=1e-12)
        found[r] = (inverse @ (a.T @ -moved[r]))[-2:] / size[r, 0, -2:]
        error[r] = np.sqrt(np.maximum(np.diag(inverse)[-2:], 0.0)) / size[r, 0, -2:]
    if np.mean(np.any(np.abs(found) > limits.significant * error, axis=1)) < 0.5:
        return None  # a few records: they are looked at one by one
    for k in range(2):
        x = found[:, k]
        scatter = float(np.std(x, ddof=1))
        if abs(x.mean()) > limits.common * max(scatter, float(np.median(error[:, k]))) / np.sqrt(count):
            return None
        scattered = scatter > limits.significant * np.median(error[:, k])
        if not seen and scattered and _explained(selection, solution, x) > limits.explained:
            return None
    offset, drift = np.abs(found).max(axis=0)
    across, along = np.sqrt(np.mean(found**2, axis=0))
    return MovingZero(channel, float(offset), float(drift), (float(across), float(along)), min(gain / excess, 1.0))


def _explained(selection: SelectionProblem, solution: Solution, x: np.ndarray) -> float:
    """Share of the scatter that conditions explain, adjusted for its freedom; 1 where there are too few records to say.

    A quadratic of the logarithms of the conditions, place in the series included, or else a plane; of tumbling records
    a plane over speed and axial rate.
    """
    records = selection.campaign.records
    table = [records[c].to_numpy(dtype=float) for c in records.columns]
    if selection.family.free_running:
        table += [solution.state_rate.max(axis=1), solution.channels[:, 2].mean(axis=1)]
    varied = [np.log(v) if v.min() > 0 else v for v in table if np.ptp(v) > 0]
    varied = [(v - v.mean()) / v.std() for v in varied]
    plane = np.stack([np.ones(len(x)), *varied], axis=1)
    bent = np.concatenate([plane, *(np.stack([a * b], axis=1) for i, a in enumerate(varied) for b in varied[: i + 1])],
                          axis=1) if varied else plane
    columns = bent if len(x) >= bent.shape[1] + 4 else plane
    if len(x) < columns.shape[1] + 2:
        return 1.0
    left = x - columns @ np.linalg.lstsq(columns, x, rcond=None)[0]
    return 1.0 - np.sum(left**2) / (len(x) - columns.shape[1]) / np.var(x, ddof=1)


def _moves_before_touch(selection: SelectionProblem, c: int) -> bool:
    """Whether a channel of impacts is off before first touch, where nothing acts yet, beyond chance in all records."""
    records, channel, limits = selection.records, selection.records.channels[c], selection.settings.baseline
    if channel == "pressure":
        return False
    noise = selection.noise[channel]
    time, values = np.asarray(records.stack.time), np.asarray(records.stack.values)
    weights, total, count = np.asarray(records.stack.weights), 0.0, 0
    origin = np.asarray(records.stack.condition_sd)[:, records.nuisances.index("time")]
    clock = selection.campaign.independent
    if clock is not None and clock.common is not None:
        origin = np.hypot(origin, clock.common.absolute or 0.0)
    for r, n in enumerate(records.lengths):
        calm = (time[r, :n] < -3.0 * origin[r]) & (weights[r, c, :n] > 0)
        if calm.sum() < limits.samples:
            continue
        t, x = time[r, :n][calm], values[r, c, :n][calm]
        parts = np.array_split(t, -(-len(t) ** 2 // PAIRS))
        variance = sum(float(np.sum(noise.covariance(part[:, None] - t))) for part in parts)
        total += float(np.sum(x)) ** 2 / variance
        count += 1
    return count >= limits.fewest and bool(stats.chi2.sf(total, count) < limits.p_value)
