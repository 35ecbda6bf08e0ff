"""A campaign's folder: its Data Package descriptor and the CSV tables beside it."""

import csv
import json
from pathlib import Path

import numpy as np


SOURCE = "Simulated by ddetumble.exam.simulators"


def describe_number(name, unit=None, uncertainty=None):
    """Return the descriptor of a column of numbers; `uncertainty` is one standard deviation with its unit."""
    stated = {"unit": unit, "uncertainty": uncertainty}
    return {"name": name, "type": "number"} | {key: value for key, value in stated.items() if value is not None}


def describe_package(name, title, family, known, records, samples, source=SOURCE):
    """Return a campaign's Data Package descriptor.

    known: parameters of the reference model, None where a fit has to find them; records, samples: descriptors of the
    columns after `record`; source: who made it.
    """
    key = {"fields": "record", "reference": {"resource": "records", "fields": "record"}}
    label = {"name": "record", "type": "string"}
    schemas = {
        "records": {"fields": [label, *records], "primaryKey": "record"},
        "samples": {"fields": [label, *samples], "foreignKeys": [key]},
    }
    return {
        "name": name,
        "title": title,
        "licenses": [{"name": "CC0-1.0"}],
        "sources": [{"title": source}],
        "family": family,
        "known": known,
        "resources": [
            {"name": table, "path": f"{table}.csv", "format": "csv", "schema": schema}
            for table, schema in schemas.items()
        ],
    }


def write_package(folder, descriptor, records, samples):
    """Write datapackage.json, records.csv and samples.csv; rows of text in the order of the descriptor's fields."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    write_json(folder / "datapackage.json", descriptor)
    for table, rows in zip(descriptor["resources"], (records, samples), strict=True):
        header = [field["name"] for field in table["schema"]["fields"]]
        write_table(folder / table["path"], header, rows)


def format_cells(values, digits):
    """Return numbers as text with so many digits after the point; nothing for nan, no minus zero."""
    return ["" if np.isnan(x) else f"{np.round(x, digits) + 0.0:.{digits}f}" for x in values]


def write_table(path, header, rows):
    """Write one CSV file with Unix line ends."""
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(header)
        writer.writerows(rows)


def write_json(path, content, indent: int | None = 2):
    """Write one JSON file with a final line end."""
    text = json.dumps(content, indent=indent, ensure_ascii=False)
    path.write_text(text + "\n", encoding="utf-8")
