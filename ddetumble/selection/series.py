"""Model beside measurement, record by record and channel by channel, and how large the error is against the signal."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from ..inference.noise import Noise
from ..inference.problem import Solution
from ..inference.stack import Records
from ..measurement.campaign import Campaign
from .result import Trace


def make_traces(campaign: Campaign, records: Records, solution: Solution, noise: Mapping[str, Noise] | None = None
                ) -> tuple[Trace, ...]:
    """Every record and channel, measured and as a fit has it.

    Samples that the fit leaves out (missing, or so close to first touch that a jump of the force may lie on either side
    of them) are nan in `measured`.

    Args:
        campaign: that was stacked; its columns give units.
        records: the stack that was fitted.
        solution: of the fit.
        noise: by channel; where a channel is absent, the deviation of the whitening weights.
    """
    stack = records.stack
    time, values, weights = (np.asarray(x) for x in (stack.time, stack.values, stack.weights))
    deviations = np.asarray(stack.condition_sd)
    origin = records.nuisances.index("time")
    traces = []
    for r, key in enumerate(records.keys):
        n = records.lengths[r]
        conditions = {str(name): float(value) for name, value in campaign.records.loc[key].items()}
        since = time[r, :n] - solution.z[r, origin] * deviations[r, origin] - solution.common_shift()
        for c, channel in enumerate(records.channels):
            used = weights[r, c, :n] > 0
            if noise and channel in noise:
                sd = noise[channel].sd
            else:
                # The first weight of a record is 1/sd of the sample itself: nothing before it predicts it.
                sd = 1.0 / weights[r, c, np.argmax(used)] if used.any() else float("nan")
            traces.append(Trace(
                key, channel, campaign.channels[channel].unit, conditions, since,
                np.where(used, values[r, c, :n], np.nan), solution.channels[r, c, :n].copy(), float(sd),
                solution.state[r, :n].copy(), solution.state_rate[r, :n].copy(),
                campaign.family, "time" if campaign.independent is None else campaign.independent.name))
    return tuple(traces)


def measure_error(records: Records, channels: np.ndarray, used: np.ndarray | None = None) -> float:
    """rms of measured minus modelled over that of the measured signal; of several channels, their root mean square.

    Args:
        records: the stack that was fitted.
        channels: model, shape (records, channels, samples), SI.
        used: samples that count beside those that the fit leaves out, shape (records, samples); all where not given.
    """
    return float(np.sqrt(np.sum(split_error(records, channels, used))))


def split_error(records: Records, channels: np.ndarray, used: np.ndarray | None = None) -> np.ndarray:
    """Square of `measure_error` by record, shape (records,): their sum is its square; nan where there is no signal."""
    values = np.asarray(records.stack.values)[: records.count]
    there = np.asarray(records.stack.weights)[: records.count] > 0
    if used is not None:
        there = there & used[:, None, :]
    below = np.sum(np.where(there, values, 0.0) ** 2, axis=(0, 2))
    above = np.sum(np.where(there, values - channels, 0.0) ** 2, axis=2)
    with np.errstate(invalid="ignore"):
        return np.sum(above[:, below > 0] / below[below > 0], axis=1) / np.sum(below > 0)


def list_channels(traces: Sequence[Trace]) -> tuple[str, ...]:
    """Channels of traces, in their order."""
    return tuple(dict.fromkeys(trace.channel for trace in traces))


def nrmse_by_channel(traces: Sequence[Trace]) -> dict[str, float]:
    """Root mean square of the residuals over that of the signal, by channel."""
    return _relative(traces, lambda trace: (trace.measured - trace.model) ** 2)


def nrmse(traces: Sequence[Trace]) -> float:
    """Root mean square of the residuals over that of the signal; of several channels, their root mean square."""
    return _combine(nrmse_by_channel(traces))


def noise_nrmse(traces: Sequence[Trace]) -> float:
    """What noise alone would leave of `nrmse`."""
    return _combine(_relative(traces, lambda trace: np.full(trace.time.shape, trace.sd**2)))


def _relative(traces: Sequence[Trace], square: Callable[[Trace], np.ndarray]) -> dict[str, float]:
    """Root of the sum of `square` over that of the squared signal, where there is a signal."""
    found = {}
    for channel in list_channels(traces):
        above = below = 0.0
        for trace in traces:
            if trace.channel == channel:
                there = np.isfinite(trace.measured)
                above += float(np.sum(square(trace)[there]))
                below += float(np.sum(trace.measured[there] ** 2))
        found[channel] = float(np.sqrt(above / below)) if below > 0 else float("nan")
    return found


def _combine(shares: Mapping[str, float]) -> float:
    values = np.array([value for value in shares.values() if np.isfinite(value)])
    return float(np.sqrt(np.mean(values**2))) if len(values) else float("nan")
