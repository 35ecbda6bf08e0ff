"""A campaign: the tests of one series, in SI units, with what is known about each number."""

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pandas as pd

from .._errors import InputError
from .kinds import take_kind
from .units import Uncertainty


GAP = 0.03  # neighbouring settings further apart than this share of their value are different conditions
FEWEST = 3  # conditions with which one can be left out and the others still say how anything depends on them


@dataclass(frozen=True)
class Column:
    """What is known about one column of numbers.

    Args:
        name: The column's name, the same as in the data frames.
        unit: SI unit of the values in memory, as text ("1" if there is none).
        uncertainty: One standard deviation of each record's own error, or None if the campaign does not say.
        gauge: The file gave gauge pressures; the values here are absolute all the same.
        assumed: The campaign marks the numbers as an assumption, not a measurement.
        description: Free text.
        common: One standard deviation of the error that all records share (an onset detector's bias, a pressure gauge
            that reads low), or None.
        degrees: Degrees of freedom from which the uncertainty was estimated; infinite where it is stated.
        stated: Unit in which the file states the numbers, as it is written there; "" where nothing tells.
    """

    name: str
    unit: str
    uncertainty: Uncertainty | None = None
    gauge: bool = False
    assumed: bool = False
    description: str = ""
    common: Uncertainty | None = None
    degrees: float = float("inf")
    stated: str = ""

    def sd(self, values) -> np.ndarray:
        """Standard deviation of each record's own error at `values` (any shape, SI); 0 where none is stated."""
        return (self.uncertainty or Uncertainty()).sd(values)


@dataclass(frozen=True, eq=False, repr=False)
class Campaign:
    """A campaign: measured tests of one family, all in SI units.

    Args:
        name: Short name of the campaign.
        title: One line for people.
        family: Name of the kind of tests; `FILE.py:NAME` or a `Family`, for one of your own, becomes its name.
        path: Folder it was read from, or None for one that has not been written yet.
        known: Parameters of the reference model [SI]; None where the fit has to find them.
        records: One row a test (index `record`, text), one column a condition [SI].
        conditions: The columns of `records`.
        independent: The column `time` [s] or `slip` [m]; None if there are only peaks.
        channels: The measured columns of `samples`.
        samples: Columns `record`, the independent variable, the channels [SI]; NaN is a missing sample; the
            records stand in the order of `records`. None if there are only peaks.
        peaks: One row a test (index `record`) [SI], or None.
        peak_columns: The columns of `peaks`.
        sha256: Hash of the descriptor and the tables as read; empty for one not read from a folder.
        sources: Where the data come from, as in the descriptor.
        licences: Under which terms, as in the descriptor.
        notes: Plain sentences on what a reader should know: assumptions, conversions, columns left out.
    """

    name: str
    title: str
    family: str
    path: Path | None
    known: dict[str, float | None]
    records: pd.DataFrame
    conditions: dict[str, Column]
    independent: Column | None = None
    channels: dict[str, Column] = field(default_factory=dict)
    samples: pd.DataFrame | None = None
    peaks: pd.DataFrame | None = None
    peak_columns: dict[str, Column] = field(default_factory=dict)
    sha256: str = ""
    sources: tuple[dict, ...] = ()
    licences: tuple[dict, ...] = ()
    notes: tuple[str, ...] = ()

    def __post_init__(self):
        object.__setattr__(self, "channels", dict(self.channels))
        object.__setattr__(self, "peak_columns", dict(self.peak_columns))
        object.__setattr__(self, "family", take_kind(self.family))

    def __repr__(self) -> str:
        parts = [f"{len(self.records)} records"]
        if self.conditions:
            parts.append("conditions " + ", ".join(self.conditions))
        if self.samples is not None and self.independent is not None:
            parts.append(f"{len(self.samples)} samples of {', '.join(self.channels)} over {self.independent.name}")
        if self.peaks is not None:
            parts.append(f"{len(self.peaks)} peaks: {', '.join(self.peak_columns)}")
        return f"<Campaign {self.name} ({self.family}): {'; '.join(parts)}>"

    @property
    def record_keys(self) -> tuple[str, ...]:
        """Keys of the records, in the campaign's order."""
        return tuple(self.records.index)

    @property
    def time_sd(self) -> float:
        """Standard deviation of each record's own time origin, SI; 0 where none is stated."""
        return 0.0 if self.independent is None else float(self.independent.sd(1.0))

    def trace(self, key: str) -> pd.DataFrame:
        """Samples of one record: the independent variable and the channels, shape (samples, 1 + channels) [SI].

        Raises:
            InputError: There is no such record, or the campaign holds peaks only.
        """
        if self.samples is None:
            raise InputError(f"campaign {self.name} contains only peaks, no samples")
        self._check_keys([key])
        return self.samples.loc[self.samples["record"] == key].drop(columns="record").reset_index(drop=True)

    def column(self, name: str) -> Column:
        """What is known about a column, wherever it stands (a channel before a condition of the same name).

        Raises:
            InputError: The campaign has no such column.
        """
        columns = {**self.conditions, **self.peak_columns, **self.channels}
        if self.independent is not None:
            columns[self.independent.name] = self.independent
        if name not in columns:
            raise InputError(f"campaign {self.name} has no column {name!r}")
        return columns[name]

    def uncertainty(self, name: str) -> Uncertainty | None:
        """Uncertainty of a column, None where none is stated; see `column`."""
        return self.column(name).uncertainty

    def select(self, keys) -> "Campaign":
        """The same campaign with some of its records only, in the order of `keys`; the hash stays that of the source.

        Raises:
            InputError: A key is unknown, twice there, or there are none.
        """
        keys = [str(key) for key in ([keys] if isinstance(keys, str) else keys)]
        self._check_keys(keys)
        if not keys or len(set(keys)) < len(keys):
            raise InputError(f"select at least one record of campaign {self.name}, and each only once")
        samples = self.samples
        if samples is not None:
            samples = arrange_samples(samples.loc[samples["record"].isin(keys)], keys)
        peaks = None if self.peaks is None else self.peaks.loc[[key for key in keys if key in self.peaks.index]]
        return replace(self, records=self.records.loc[keys], samples=samples, peaks=peaks)

    def _check_keys(self, keys):
        unknown = [key for key in keys if key not in self.records.index]
        if unknown:
            there = ", ".join(self.record_keys[:8]) + (", …" if len(self.records) > 8 else "")
            raise InputError(f"campaign {self.name} has no record {unknown[0]!r}; it has {there}")


def arrange_samples(samples: pd.DataFrame, keys) -> pd.DataFrame:
    """Put the samples of each record together, in the order of `keys`, keeping their order within a record."""
    position = pd.Index(list(keys)).get_indexer(pd.Index(samples["record"]))
    if (position[1:] < position[:-1]).any():
        samples = samples.iloc[np.argsort(position, kind="stable")]
    return samples.reset_index(drop=True)


def thin_campaign(campaign: Campaign, most: int) -> tuple[Campaign, str]:
    """Every so many-th sample of the longer records, so that all together have at most `most`.

    What is kept are readings as they were taken: their noise is as stated, and no feature is smoothed away. Estimates
    are less exact than all samples would make them, by up to the root of the share kept. A sentence says so; it is
    empty where nothing is left out.
    """
    if campaign.samples is None or len(campaign.samples) <= most:
        return campaign, ""
    groups = campaign.samples.groupby("record", sort=False)
    step = -(-groups["record"].transform("size").to_numpy() // max(most // groups.ngroups, 1))
    kept = campaign.samples.loc[groups.cumcount().to_numpy() % step == 0].reset_index(drop=True)
    return replace(campaign, samples=kept), (
        f"Of {len(campaign.samples):,} samples {len(kept):,} were taken, one in {int(np.max(step))} of the longest "
        f"record, as more than {most:,} would take too long here. `fit` uses all of them.")


def group_conditions(records: pd.DataFrame) -> np.ndarray:
    """Number of the unit that is left out together with each record, shape (records,).

    The unit is the condition; where there are too few of them, every record is one of its own.
    """
    groups = label_conditions(records)
    return groups if groups.max() + 1 >= FEWEST else np.arange(len(records))


def can_leave_out(records: pd.DataFrame, free_running: bool = False) -> bool:
    """Whether whole conditions can be left out of a fit: there are at least three.

    Where every record runs on from a start of its own (`free_running`), it is a condition by itself, and two do.
    """
    return len(records) >= 2 if free_running else count_conditions(records) >= FEWEST


def count_conditions(records: pd.DataFrame) -> int:
    """How many conditions records were measured at."""
    return int(label_conditions(records).max()) + 1


def label_conditions(records: pd.DataFrame) -> np.ndarray:
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
