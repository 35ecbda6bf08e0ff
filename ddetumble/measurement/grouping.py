"""Which records of a campaign share a condition: settings scatter about nominal values."""

import numpy as np
import pandas as pd


GAP = 0.03  # neighbouring settings further apart than this share of their value are different conditions


def group_conditions(records: pd.DataFrame) -> np.ndarray:
    """Number of the condition to which each record belongs, shape (records,).

    Settings scatter about nominal values: along each condition, sorted values are cut where neighbours differ by more
    than 3 %. The order in a series is no condition.
    """
    labels = []
    for name in records.columns:
        if name == "sequence":
            continue
        values = records[name].to_numpy(dtype=float)
        order = np.argsort(values)
        ordered = values[order]
        size = np.maximum(np.abs(ordered[1:]), 1e-300)
        label = np.zeros(len(values), dtype=int)
        label[order[1:]] = np.cumsum(np.diff(ordered) / size > GAP)
        labels.append(label)
    if not labels:
        return np.arange(len(records))
    _, groups = np.unique(np.stack(labels, axis=1), axis=0, return_inverse=True)
    groups = np.ravel(groups)
    return groups if groups.max() >= 2 else np.arange(len(records))


def name_conditions(records: pd.DataFrame, groups: np.ndarray) -> list[dict[str, float]]:
    """Mean settings of every condition, SI, in the order of their numbers; the order in a series is none."""
    names = [str(name) for name in records.columns if name != "sequence"]
    table = records[names].to_numpy(dtype=float)
    return [dict(zip(names, map(float, table[groups == g].mean(axis=0)), strict=True)) for g in np.unique(groups)]
