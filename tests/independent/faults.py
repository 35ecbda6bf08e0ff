"""Faults of the data, put into a campaign's folder at a stated size: what a gauge, a logger or a typist does.

They change the CSV files only, by text and NumPy, and know nothing of the package.
"""

import csv
import shutil
from pathlib import Path

import numpy as np


def read_rows(path):
    """Header and rows of a CSV file, as text."""
    with Path(path).open(newline="", encoding="utf-8") as stream:
        rows = list(csv.reader(stream))
    return rows[0], rows[1:]


def write_rows(path, header, rows):
    """Write a CSV file."""
    with Path(path).open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(header)
        writer.writerows(rows)


class Spoiler:
    """A copy of a campaign's folder, to be spoilt; `save` writes it.

    Columns are arrays of floats, NaN where a cell is empty; the records keep their order.
    """

    def __init__(self, source, folder):
        self.folder = Path(folder)
        shutil.copytree(source, folder, dirs_exist_ok=True)
        self.header, rows = read_rows(self.folder / "samples.csv")
        self.keys = np.array([row[0] for row in rows])
        self.values = np.array([[float(x) if x else np.nan for x in row[1:]] for row in rows])
        self.head, self.records = read_rows(self.folder / "records.csv")
        self.order = list(dict.fromkeys(self.keys))

    def column(self, name):
        """Place of a column among the numbers."""
        return self.header.index(name) - 1

    def of(self, record):
        """Rows of a record."""
        return np.flatnonzero(self.keys == record)

    def save(self):
        """Write the tables; returns the folder."""
        rows = [[key, *("" if np.isnan(x) else f"{x:.9g}" for x in row)]
                for key, row in zip(self.keys, self.values, strict=True)]
        write_rows(self.folder / "samples.csv", self.header, rows)
        write_rows(self.folder / "records.csv", self.head, self.records)
        return self.folder


def add_spikes(spoiler, channel, size, share=0.01, seed=0):
    """Single samples off by `size` (in the file's unit), of either sign, at random in all records."""
    generator, c = np.random.default_rng(seed), spoiler.column(channel)
    hit = generator.random(len(spoiler.keys)) < share
    spoiler.values[hit, c] += size * generator.choice([-1.0, 1.0], hit.sum())


def clip(spoiler, channel, ceiling):
    """No value beyond a ceiling (and none below its opposite)."""
    c = spoiler.column(channel)
    spoiler.values[:, c] = np.clip(spoiler.values[:, c], -ceiling, ceiling)


def drift(spoiler, channel, record, offset, slope):
    """A zero that moves: `offset` at the first sample, and `slope` over the whole record, in the file's unit."""
    c, rows = spoiler.column(channel), spoiler.of(record)
    spoiler.values[rows, c] += offset + slope * np.linspace(0.0, 1.0, rows.size)


def drift_all(spoiler, channel, size, seed=0):
    """A zero that moves in every record on its own, by N(0, size²) at the start and again until the end."""
    generator = np.random.default_rng(seed)
    for record in spoiler.order:
        drift(spoiler, channel, record, *(size * generator.standard_normal(2)))


def lose_samples(spoiler, channel, share, seed=0):
    """Empty cells at random, and a stretch of a tenth of the second record."""
    generator, c = np.random.default_rng(seed), spoiler.column(channel)
    spoiler.values[generator.random(len(spoiler.keys)) < share, c] = np.nan
    rows = spoiler.of(spoiler.order[1])
    first = int(0.3 * rows.size)
    spoiler.values[rows[first:first + rows.size // 10], c] = np.nan


def thin(spoiler, share, seed=0):
    """Rows left out at random: the sampling is uneven."""
    kept = np.random.default_rng(seed).random(len(spoiler.keys)) >= share
    spoiler.keys, spoiler.values = spoiler.keys[kept], spoiler.values[kept]


def scale(spoiler, channels, record, factor):
    """One record's channels in another unit, or of a gauge with another gain."""
    for channel in channels:
        spoiler.values[spoiler.of(record), spoiler.column(channel)] *= factor


def scale_condition(spoiler, condition, record, factor):
    """One record's condition in another unit."""
    c = spoiler.head.index(condition)
    for row in spoiler.records:
        if row[0] == record:
            row[c] = f"{float(row[c]) * factor:.6g}"


def shift(spoiler, channels, record, samples):
    """One record's channels that many samples late; what is missing at the start is its beginning, turned round."""
    rows = spoiler.of(record)
    for channel in channels:
        c = spoiler.column(channel)
        x = spoiler.values[rows, c]
        spoiler.values[rows, c] = np.concatenate([x[1:samples + 1][::-1], x[:-samples]])


def copy_record(spoiler, record, source):
    """One record's samples are another's: a file that was exported twice."""
    to, of = spoiler.of(record), spoiler.of(source)
    n = min(to.size, of.size)
    spoiler.values[to[:n], 1:] = spoiler.values[of[:n], 1:]


def hold(spoiler, channel, record, first, last):
    """A gauge that stands still over a part of a record (shares of its length)."""
    c, rows = spoiler.column(channel), spoiler.of(record)
    here = rows[int(first * rows.size):int(last * rows.size)]
    spoiler.values[here, c] = spoiler.values[here[0], c]
