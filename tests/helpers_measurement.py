"""Small campaigns and raw files to spoil in the tests of `ddetumble.measurement`."""

import copy
import json

import numpy as np


DESCRIPTOR = {
    "name": "small",
    "title": "A small campaign",
    "licenses": [{"name": "CC0-1.0"}],
    "family": "impact",
    "known": {"outer_diameter": "60 mm", "effective_mass": None, "restitution": None},
    "resources": [
        {
            "name": "records",
            "path": "records.csv",
            "schema": {
                "fields": [
                    {"name": "record", "type": "string"},
                    {"name": "sequence", "type": "integer"},
                    {"name": "initial_pressure", "type": "number", "unit": "MPa", "uncertainty": "0.5 %"},
                    {"name": "approach_speed", "type": "number", "unit": "m/s", "uncertainty": "3 mm/s"},
                ],
                "primaryKey": "record",
            },
        },
        {
            "name": "samples",
            "path": "samples.csv",
            "schema": {
                "fields": [
                    {"name": "record", "type": "string"},
                    {"name": "time", "type": "number", "unit": "ms", "uncertainty": "0.05 ms"},
                    {"name": "normal_force", "type": "number", "unit": "N", "uncertainty": "0.25 N"},
                ],
                "foreignKeys": [{"fields": "record", "reference": {"resource": "records", "fields": "record"}}],
            },
        },
    ],
}
RECORDS = "record,sequence,initial_pressure,approach_speed\nr01,1,1.0,0.4\nr02,2,1.5,0.41\n"
SAMPLES = "record,time,normal_force\n" + "".join(
    f"r{r:02d},{0.25 * i - 0.5},{r * i * 0.125}\n" for r in (1, 2) for i in range(7)
)


def descriptor():
    """A fresh copy of the small campaign's descriptor."""
    return copy.deepcopy(DESCRIPTOR)


def write_small(folder, tree=None, records=RECORDS, samples=SAMPLES):
    """Write the small campaign, or a spoilt one; returns the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "datapackage.json").write_text(json.dumps(tree or descriptor(), indent=1))
    (folder / "records.csv").write_text(records, newline="")
    (folder / "samples.csv").write_text(samples, newline="")
    return folder


def pulse(time, onset, peak, duration=0.016):
    """A force that starts as a parabola [N], shape of `time`."""
    return peak * np.sin(np.pi * np.clip((time - onset) / duration, 0, 1)) ** 2


def raw_trace(onset=0.0123, peak=50.0, offset=1.7, noise=0.2, rate=10e3, length=0.06, seed=0):
    """A raw trace: time [s] and force [N] with noise and offset, triggered before contact."""
    time = np.arange(round(length * rate)) / rate
    return time, pulse(time, onset, peak) + offset + noise * np.random.default_rng(seed).standard_normal(time.size)


def raw_text(columns, headings, *, delimiter=",", decimal=".", preamble="", units=None, digits=6):
    """A raw file's text from columns of numbers or words."""
    lines = [delimiter.join(headings)] + ([delimiter.join(units)] if units else [])
    for row in zip(*columns, strict=True):
        cells = [cell if isinstance(cell, str) else f"{cell:.{digits}f}".replace(".", decimal) for cell in row]
        lines.append(delimiter.join(cells))
    return preamble + "\n".join(lines) + "\n"
