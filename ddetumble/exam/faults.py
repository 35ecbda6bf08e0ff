"""What goes wrong at a bench and is no physics: a gauge at its limit, a drop-out, one record that is wrong."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np


def clip(traces: Sequence[np.ndarray], generator: np.random.Generator) -> dict[str, Any]:
    """The gauge's range ends below the largest reading of the campaign, at 75 to 95 % of it."""
    share = float(generator.uniform(0.75, 0.95))
    limits = share * np.max([np.nanmax(np.abs(trace), axis=0) for trace in traces], axis=0)
    clipped = 0
    for k, trace in enumerate(traces):
        clipped += bool((np.abs(trace) > limits).any())
        traces[k][...] = np.clip(trace, -limits, limits)
    return {"share": share, "limits": limits.tolist(), "records": clipped}


def drop_out(traces: Sequence[np.ndarray], generator: np.random.Generator) -> dict[str, Any]:
    """A run of 5 to 15 % of one record's samples is missing, or reads zero."""
    record = int(generator.integers(len(traces)))
    count = len(traces[record])
    length = max(int(generator.uniform(0.05, 0.15) * count), 1)
    first = int(generator.integers(int(0.1 * count), max(int(0.7 * count) - length, int(0.1 * count) + 1)))
    missing = bool(generator.random() < 0.5)
    traces[record][first : first + length] = np.nan if missing else 0.0
    return {"record": record, "first": first, "samples": length, "missing": missing}


def spoil(traces: Sequence[np.ndarray], generator: np.random.Generator) -> dict[str, Any]:
    """The amplifier stood in another range for one record: its readings are 0.5 to 0.8 or 1.25 to 2 times as large."""
    record = int(generator.integers(len(traces)))
    factor = float(np.exp(generator.uniform(np.log(1.25), np.log(2.0))))
    factor = 1.0 / factor if generator.random() < 0.5 else factor
    traces[record][...] = factor * traces[record]
    return {"record": record, "factor": factor}


FAULTS: dict[str, Callable[[Sequence[np.ndarray], np.random.Generator], dict[str, Any]]] = {
    "clipping": clip, "drop-out": drop_out, "wrong-record": spoil,
}  # fmt: skip
