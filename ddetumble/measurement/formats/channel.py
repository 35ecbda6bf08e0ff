"""A channel of a measurement file: its numbers, its unit and, where the file keeps one, its clock."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class Channel:
    """A channel as a file holds it."""

    name: str  # in its group
    values: np.ndarray | list[str]  # numbers, shape (samples,), or texts
    unit: str | None = None  # as the file states it, or None
    group: str = ""  # the sheet, group, structure or topic that holds it; "" where the file has none
    # Time of each sample [s], shape (samples,), or None where the file holds time as a channel.
    clock: np.ndarray | None = None
    problem: str = ""  # why the channel cannot be used; "" where it can


def make_channels(name: str, values, unit: str | None = None, group: str = "", clock=None) -> list[Channel]:
    """The channel that an array makes, one a column where it is a matrix; of times the seconds since the first."""
    values = np.asarray(values)
    kind, problem = values.dtype.kind, ""
    unit = (unit or "").strip() or None
    if values.ndim > 1 and values.size == max(values.shape):
        values = values.ravel()
    if values.ndim == 2 and len(values) > values.shape[-1] and kind in "fiub":
        return [channel for j, column in enumerate(values.T)
                for channel in make_channels(f"{name} {j + 1}", column, unit, group, clock)]
    if values.ndim > 1:
        size = " by ".join(map(str, values.shape))
        problem = f"it holds {size} values; store one channel a variable, or one a column with a sample in each row"
    elif kind in "SUT" or kind == "O" and all(isinstance(cell, str | bytes) for cell in values.flat):
        texts = [cell.decode("utf-8", "replace") if isinstance(cell, bytes) else str(cell) for cell in values.flat]
        return [Channel(name, texts, unit, group, clock)]
    elif kind == "M":
        values, unit = (values - np.atleast_1d(values)[:1]) / np.timedelta64(1, "ns") / 1e9, "s"
    elif kind == "m":
        values, unit = values / np.timedelta64(1, "ns") / 1e9, "s"
    elif kind == "c":
        problem = "its numbers are complex; export a time series of real numbers"
    elif kind not in "fiub":
        problem = "it holds no plain numbers; export them as an array of numbers"
    if problem:
        return [Channel(name, np.empty(0), unit, group, clock, problem)]
    return [Channel(name, np.atleast_1d(values).astype(float), unit, group, clock)]
