"""What goes wrong at a bench and is no physics: a gauge at its limit, a drop-out, one record that is wrong."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np


def clip(readings: Sequence[np.ndarray], generator: np.random.Generator) -> dict[str, Any]:
    """The gauge's range ends below the largest reading of the campaign, at 75 to 95 % of it."""
    share = float(generator.uniform(0.75, 0.95))
    limits = share * np.max([np.nanmax(np.abs(one), axis=0) for one in readings], axis=0)
    clipped = 0
    for k, one in enumerate(readings):
        clipped += bool((np.abs(one) > limits).any())
        readings[k][...] = np.clip(one, -limits, limits)
    return {"share": share, "limits": limits.tolist(), "records": clipped}


def drop_out(readings: Sequence[np.ndarray], generator: np.random.Generator) -> dict[str, Any]:
    """A run of 5 to 15 % of one record's samples is missing, or reads zero."""
    record = int(generator.integers(len(readings)))
    count = len(readings[record])
    length = max(int(generator.uniform(0.05, 0.15) * count), 1)
    first = int(generator.integers(int(0.1 * count), max(int(0.7 * count) - length, int(0.1 * count) + 1)))
    missing = bool(generator.random() < 0.5)
    readings[record][first : first + length] = np.nan if missing else 0.0
    return {"record": record, "first": first, "samples": length, "missing": missing}


def spoil(readings: Sequence[np.ndarray], generator: np.random.Generator) -> dict[str, Any]:
    """The amplifier stood in another range for one record: its readings are 0.5 to 0.8 or 1.25 to 2 times as large."""
    record = int(generator.integers(len(readings)))
    factor = float(np.exp(generator.uniform(np.log(1.25), np.log(2.0))))
    factor = 1.0 / factor if generator.random() < 0.5 else factor
    readings[record][...] = factor * readings[record]
    return {"record": record, "factor": factor}


FAULTS: dict[str, Callable[[Sequence[np.ndarray], np.random.Generator], dict[str, Any]]] = {
    "clipping": clip, "drop-out": drop_out, "wrong-record": spoil,
}  # fmt: skip
