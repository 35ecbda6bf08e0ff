"""Which records of a campaign share a condition: settings scatter about nominal values."""

import numpy as np
import pandas as pd


GAP = 0.03  # neighbouring settings further apart than this share of their value are different conditions
FEWEST = 3  # conditions with which one can be left out and the others still say how anything depends on them


def group_conditions(records: pd.DataFrame) -> np.ndarray:
    """Number of the unit that is left out together with each record, shape (records,).

    The unit is the condition; where there are too few of them, every record is one of its own.
    """
    groups = _label_conditions(records)
    return groups if groups.max() + 1 >= FEWEST else np.arange(len(records))


def can_leave_out(records: pd.DataFrame, free_running: bool = False) -> bool:
    """Whether whole conditions can be left out of a fit: there are at least three.

    Where every record runs on from a start of its own (`free_running`), it is a condition by itself, and two do.
    """
    return len(records) >= 2 if free_running else count_conditions(records) >= FEWEST


def count_conditions(records: pd.DataFrame) -> int:
    """How many conditions records were measured at."""
    return int(_label_conditions(records).max()) + 1


def _label_conditions(records: pd.DataFrame) -> np.ndarray:
    """Number of the condition to which each record belongs, shape (records,).

    Settings scatter about nominal values: along each condition, sorted values are cut where neighbours differ by more
    than 3 %. The order in a series is no condition. Without any condition all records belong to the same.
    """
    labels = np.zeros((len(records), records.shape[1]), dtype=int)
    for label, name in zip(labels.T, records.columns, strict=True):
        if name != "sequence":
            order = np.argsort(records[name].to_numpy(dtype=float))
            ordered = records[name].to_numpy(dtype=float)[order]
            label[order[1:]] = np.cumsum(np.diff(ordered) / np.maximum(np.abs(ordered[1:]), 1e-300) > GAP)
    return np.ravel(np.unique(labels, axis=0, return_inverse=True)[1])


def name_conditions(records: pd.DataFrame, groups: np.ndarray) -> list[dict[str, float]]:
    """Mean settings of every condition, SI, in the order of their numbers; the order in a series is none."""
    names = [str(name) for name in records.columns if name != "sequence"]
    table = records[names].to_numpy(dtype=float)
    return [dict(zip(names, map(float, table[groups == g].mean(axis=0)), strict=True)) for g in np.unique(groups)]
