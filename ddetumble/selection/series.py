"""Model beside measurement, record by record and channel by channel, and how large the error is against the signal."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from ..inference.noise import Noise
from ..inference.problem import Solution, shift_clocks
from ..inference.stack import Records
from ..measurement.campaign import Campaign
from .result import Trace


# Times the cross-validated error that predictions from settings as written down err, from which on moved settings have
# done the work of physics: differences below are seen in no picture.
RELIES = 1.1


def relies_on_settings(steps: Sequence[Any]) -> bool:
    """Whether a model among steps, or comparisons, owes its cross-validated error to settings that it moves:
    predictions from settings as they are written down err by far more."""
    return any(np.isfinite(one.prediction_nrmse) and one.prediction_nrmse > RELIES * one.heldout_nrmse for one in steps)


def have_predictions(models: Iterable[Any]) -> bool:
    """Whether predictions of steps, comparisons or candidates from settings as written down are another thing than
    their cross-validation: of records without settings that could move they are the same, as of those that have none.
    """
    return any(np.isfinite(one.prediction_nrmse) and not np.isclose(one.prediction_nrmse, one.heldout_nrmse, rtol=1e-6)
               for one in models)


def make_traces(campaign: Campaign, records: Records, solution: Solution, noise: Mapping[str, Noise] | None = None
                ) -> tuple[Trace, ...]:
    """Every record and channel, measured and as a fit has it, with the noise of its channel, or else of the fit's
    weights.

    Samples that the fit leaves out (missing, or so close to first touch that a jump of the force may lie on either side
    of them) are nan in `measured`.
    """
    stack = records.stack
    time, values, weights = (np.asarray(x) for x in (stack.time, stack.values, stack.weights))
    moved = shift_clocks(records, solution)
    independent = "time" if campaign.independent is None else campaign.independent.name
    traces = []
    for r, key in enumerate(records.keys):
        n = records.lengths[r]
        conditions = {str(name): float(value) for name, value in campaign.records.loc[key].items()}
        for c, channel in enumerate(records.channels):
            used, sizes = weights[r, c, :n] > 0, None
            if noise and channel in noise:
                sd, sizes = noise[channel].sd, noise[channel].sizes.get(key)
                # Of a thinned record every n-th sample is there.
                sizes = None if sizes is None else np.asarray(sizes)[:: -(-len(sizes) // n)]
            else:
                # The first weight of a record is 1/sd of the sample itself: nothing before it predicts it.
                sd = 1.0 / weights[r, c, np.argmax(used)] if used.any() else float("nan")
            traces.append(Trace(
                key, channel, campaign.channels[channel].unit, conditions, time[r, :n] - moved[r],
                np.where(used, values[r, c, :n], np.nan), solution.channels[r, c, :n].copy(), float(sd),
                solution.state[r, :n].copy(), solution.state_rate[r, :n].copy(), campaign.family, independent, sizes))
    return tuple(traces)


def split_error(records: Records, channels: np.ndarray, used: np.ndarray | None = None) -> np.ndarray:
    """Square of the rms error over the rms signal, split by record, shape (records,); nan where there is no signal.

    Their sum is the square of `nrmse`. `channels` are the model's, shape (records, channels, samples), SI; `used` the
    samples that count beside those that the fit leaves out, shape (records, samples).
    """
    values = np.asarray(records.stack.values)[: records.count]
    there = records.used if used is None else records.used & used[:, None, :]
    below = np.sum(np.where(there, values, 0.0) ** 2, axis=(0, 2))
    above = np.sum(np.where(there, values - channels, 0.0) ** 2, axis=2)
    with np.errstate(invalid="ignore"):
        return np.sum(above[:, below > 0] / below[below > 0], axis=1) / np.sum(below > 0)


def list_channels(traces: Sequence[Trace]) -> tuple[str, ...]:
    """Channels of traces, in their order."""
    return tuple(dict.fromkeys(trace.channel for trace in traces))


def nrmse_by_channel(traces: Sequence[Trace], noise: bool = False) -> dict[str, float]:
    """Root mean square of the residuals (or of the noise) over that of the signal, by channel; nan without a signal."""
    found = {}
    for channel in list_channels(traces):
        own = [(t, np.isfinite(t.measured)) for t in traces if t.channel == channel]
        own = [(t, there) for t, there in own if there.any()]  # what was not measured may have no noise either
        above = sum(float(there.sum()) * t.sd**2 if noise else float(np.sum((t.measured - t.model)[there] ** 2))
                    for t, there in own)
        below = sum(float(np.sum(t.measured[there] ** 2)) for t, there in own)
        found[channel] = float(np.sqrt(above / below)) if below > 0 else float("nan")
    return found


def measure_ratio(traces: Sequence[Trace]) -> float:
    """Root mean square of the residuals over the noise, every channel with the same weight: the error that sentences
    give as `x × noise`. Its square is chi-square per sample of white noise.
    """
    ratios = []
    for channel in list_channels(traces):
        own = np.concatenate([(t.measured - t.model) / t.sd for t in traces if t.channel == channel])
        if np.isfinite(own).any():
            ratios.append(float(np.nanmean(own**2)))
    return float(np.sqrt(np.mean(ratios))) if ratios else float("nan")


def nrmse(traces: Sequence[Trace], noise: bool = False) -> float:
    """The same of all channels: the root mean square over those with a signal."""
    values = np.array([x for x in nrmse_by_channel(traces, noise).values() if np.isfinite(x)])
    return float(np.sqrt(np.mean(values**2))) if len(values) else float("nan")
