"""A campaign's data package, read and written: every number in SI, or one sentence on what is wrong and where."""

import hashlib
import json
import os
import re
import shutil
import uuid
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from .._errors import InputError, error_place
from . import checks
from .campaign import Campaign, Column, arrange_samples
from .descriptor import FieldModel, ResourceModel, find_descriptor, locate_resource, parse_descriptor
from .kinds import find_kind, take_kind, write_kind
from .tables import convert_column, decode, parse_table, pick_column, read_bytes
from .units import Unit, check_unit, parse_uncertainty, parse_unit, role_of, si_unit


@dataclass
class _Numbers:
    """A table with its numbers in SI."""

    file: str
    lines: np.ndarray
    keys: list[str]
    columns: dict[str, Column]
    values: dict[str, np.ndarray]

    def frame(self) -> pd.DataFrame:
        """The numbers of a table with one row a record, indexed by its key."""
        return pd.DataFrame(self.values, index=pd.Index(self.keys, name="record", dtype=object))


def read_campaign(path) -> Campaign:
    """Read a campaign and check it.

    Args:
        path: Its folder, the `datapackage.json` in it, or the name of a campaign that comes with the toolkit
            ("impact-b"), where there is no folder of that name.

    Returns:
        The campaign, all numbers in SI, gauge pressures made absolute.

    Raises:
        InputError: Anything missing, malformed or impossible; file, column and line are named where there is one.
    """
    descriptor = find_descriptor(path)
    with error_place(file=descriptor):
        return _read_package(descriptor)


def _read_package(descriptor: Path) -> Campaign:
    data = read_bytes(descriptor)
    model = parse_descriptor(data, str(descriptor))
    digest, notes, known = hashlib.sha256(b"%d\n" % len(data) + data), [], {}
    family = take_kind(model.family, descriptor.parent)
    kind = find_kind(family)
    for name, value in model.known.items():
        with error_place(key=f"known.{name}"):
            known[name] = None if value is None else checks.read_known(name, value, kind.parameters.get(name, ""))
    resources: dict[str, ResourceModel] = {}
    for resource in model.resources:
        if resource.name in resources:
            raise InputError(f"there are two resources named {resource.name!r}; keep one")
        resources[resource.name] = resource
        if resource.name not in ("records", "samples", "peaks"):
            notes.append(f"The resource {resource.name} is not part of a campaign and was left out.")
    if "records" not in resources:
        raise InputError("there is no resource named records; add the table with one row per test")
    if not {"samples", "peaks"} & set(resources):
        raise InputError("there is no resource named samples or peaks; add the table with the measurements")
    for name in kind.needs:
        if name not in [field.name for field in resources["records"].table.fields]:
            problem = f"records of the family {family} need this condition; add its column and field"
            raise InputError(problem, column=name)
    tables = {name: _read_resource(resources[name], descriptor, known, digest, notes)
              for name in ("records", "samples", "peaks") if name in resources}
    records, samples, peaks = tables["records"], tables.get("samples"), tables.get("peaks")
    checks.check_unique(records, "give every test a key of its own")
    parts: dict[str, Any] = {}
    if samples is not None:
        independent = checks.check_samples(samples, records.keys, kind)
        channels = {name: column for name, column in samples.columns.items() if name != independent}
        frame = pd.DataFrame({"record": samples.keys} | samples.values)
        parts |= {"independent": samples.columns[independent], "channels": channels,
                  "samples": arrange_samples(frame.reindex(columns=["record", independent, *channels]), records.keys)}
    if peaks is not None:
        checks.check_peaks(peaks, records.keys)
        for name, column in peaks.columns.items():
            if column.common is not None and samples is not None:
                problem = "the common_uncertainty of a peak is not used beside samples; state that of a channel"
                raise InputError(problem, column=name)
        parts |= {"peaks": peaks.frame(), "peak_columns": peaks.columns}
    measured = {key for table in (samples, peaks) if table is not None for key in table.keys}
    checks.refuse_rows([key not in measured for key in records.keys], records, "record", lambda i: (
        f"record {records.keys[i]!r} has no samples or peak; add them or remove the record"))
    return Campaign(
        name=model.name or descriptor.resolve().parent.name, title=model.title, family=family, path=descriptor.parent,
        known=known, records=records.frame(), conditions=records.columns, sha256=digest.hexdigest(),
        sources=tuple(model.sources), licences=tuple(model.licenses), notes=tuple(notes), **parts)


def _read_resource(resource: ResourceModel, descriptor: Path, known: dict, digest, notes: list[str]) -> _Numbers:
    """Read one table and convert its numeric columns; its bytes go into the digest, remarks into the notes."""
    path, name = str(locate_resource(resource, descriptor)), resource.name
    with error_place(f"resource {name}: "):
        fields: dict[str, FieldModel] = {}
        for field in resource.table.fields:
            with error_place(column=field.name):
                if field.name in fields:
                    raise InputError("there are two fields with this name; keep one")
                if field.name != "record" and role_of(field.name) and not field.numeric:
                    raise InputError(f'declare the field as "type": "number" (now {field.type or "no type"})')
            fields[field.name] = field
        if "record" not in fields:
            raise InputError("there is no field record; add the key that names the test", column="record")
        if name == "records" and resource.table.primaryKey not in (None, "record", ["record"]):
            raise InputError('the primaryKey must be "record"')
        for link in resource.table.foreignKeys:
            far = link.get("reference")
            if link.get("fields") not in ("record", ["record"]) or not isinstance(far, dict) \
                    or far.get("resource") != "records":
                raise InputError('a foreign key must lead from "record" to the resource records')
        if resource.encoding.lower().replace("_", "-") not in ("utf-8", "utf8", "utf-8-sig", "ascii"):
            raise InputError(f"the encoding {resource.encoding!r} is not supported; save the table as UTF-8")
        delimiter, quote = resource.dialect.delimiter, resource.dialect.quoteChar
        if resource.format == "tsv" and "delimiter" not in resource.dialect.model_fields_set:
            delimiter = "\t"
        if delimiter == quote:
            raise InputError("the delimiter and the quote character are the same; change one")
    data = read_bytes(path)
    digest.update(b"%d %d\n" % (len(name.encode()), len(data)) + name.encode() + data)
    table = parse_table(decode(data, path), path, delimiter, quote)
    for column in fields:
        pick_column(table, column)
    for column in table.columns:
        if column not in fields:
            problem = f"the column is not described in {descriptor.name}; add a field for it or remove it"
            raise InputError(problem, file=path, column=column)
    keys = [cell.strip() for cell in table.columns["record"]]
    checks.check_keys(keys, table)
    numbers = _Numbers(path, table.lines, keys, {}, {})
    del fields["record"]
    for column, field in fields.items():
        if not field.numeric:
            notes.append(f"The column {column} of {name} is not numeric and was left out.")
            continue
        with error_place(column=column):
            about, offset = _describe_field(field, name, known, notes)
        sparse = name != "records" and column not in ("time", *checks.COUNTS)
        values = convert_column(table, column, decimal=field.decimalChar, allow_missing=sparse,
                                missing=frozenset(resource.table.missingValues))
        with np.errstate(over="ignore"):
            values = check_unit(field.unit or "1", column).convert(values) + offset
        checks.check_values(column, values, table, name, about.uncertainty)
        if column in ("initial_pressure", "internal_pressure") and not np.all(values):
            notes.append(f"The column {column} contains absolute pressures of zero, that is, a ball without gas.")
        numbers.columns[column], numbers.values[column] = about, values
    return numbers


def _describe_field(field: FieldModel, resource: str, known: dict, notes: list[str]) -> tuple[Column, float]:
    """What is known about a numeric column, and what has to be added to its numbers to make pressures absolute [Pa]."""
    name, offset = field.name, 0.0
    with error_place(f"resource {resource}: "):
        if field.unit is None and name not in checks.COUNTS and role_of(name) != "pure number":
            wanted = si_unit(name) if role_of(name) else "mm"
            raise InputError(f'the field has no unit; add it, such as "unit": "{wanted}" ("1" for a ratio)')
        unit = _read_unit(field)
        with error_place("stated_unit: "):
            parse_unit(field.stated_unit)  # of an acceleration that became a force, say
    uncertainty, common = (None if text is None else parse_uncertainty(text, unit, name)
                           for text in (field.uncertainty, field.common_uncertainty))
    if field.reference == "gauge":
        if unit.dimension != parse_unit("Pa").dimension:
            raise InputError('only a pressure can have "reference": "gauge"')
        offset = known.get("ambient_pressure")
        if offset is None:
            raise InputError('gauge pressures need the ambient pressure: add "ambient_pressure", such as "101.3 kPa", '
                             "as measured")
        if any(one is not None and one.relative is not None for one in (uncertainty, common)):
            raise InputError('the uncertainty of a gauge pressure must be absolute, like "2 kPa" (per cent of what?)')
        notes.append(f"The gauge pressures of {name} were made absolute with the stated ambient_pressure.")
    if field.assumed:
        notes.append(f"The column {name} is marked as an assumption, not a measurement.")
    gauge = "gauge" in (field.reference, field.stated_reference)
    stated = field.stated_unit or (unit.text if unit.scale != 1.0 else "")
    return Column(name, unit.si, uncertainty, gauge, field.assumed, field.description, common, stated=stated), offset


def _read_unit(field: FieldModel) -> Unit:
    """The unit of a field; of a gauge pressure it is told what the descriptor has for these."""
    try:
        return check_unit(field.unit or "1", field.name)
    except InputError as error:
        if "gauge" not in error.problem:
            raise
        raise InputError(f'unit {field.unit!r} is a gauge pressure: write the plain unit (bar, psi), mark the field '
                         '"reference": "gauge" and state ambient_pressure') from None


def write_campaign(folder, campaign: Campaign, *, overwrite: bool = False) -> Campaign:
    """Write a campaign's folder: `datapackage.json`, `records.csv` and `samples.csv` or `peaks.csv`.

    The package is written beside its place, read back with every check, and only then moved there: a new folder whole
    or not at all; into a folder that is there the tables first, the descriptor last.

    Args:
        folder: Where to write; created if it is not there.
        campaign: What to write; values and units are SI, numbers with the fewest digits that give them back.
        overwrite: Replace the campaign in a folder that holds one already; other files there stay.

    Returns:
        The campaign as read back, with its hash, and with the notes of the one given.

    Raises:
        InputError: The folder is taken, cannot be written, or the campaign does not pass the checks.
    """
    folder = Path(os.path.abspath(folder))
    with error_place(file=folder):
        if folder.exists() and not folder.is_dir():
            raise InputError("this is a file; name a folder for the campaign")
        if folder.is_dir() and any(folder.iterdir()):
            if not (folder / "datapackage.json").is_file():
                raise InputError("the folder contains other files; name a new folder for the campaign")
            if not overwrite:
                raise InputError("the folder already contains a campaign; name a new one, or replace it with "
                                 "--overwrite")
    texts = format_campaign(replace(campaign, name=campaign.name or folder.name), folder)
    draft = folder.parent / f".{folder.name}-{uuid.uuid4().hex[:8]}"
    try:
        draft.mkdir(parents=True)
        for name, text in texts.items():
            (draft / name).write_text(text, encoding="utf-8", newline="")
        try:
            written = read_campaign(draft)
        except InputError as error:
            name = Path(error.file).name if error.file else None
            raise InputError(error.problem, file=name, column=error.column, row=error.row, key=error.key) from None
        if folder.exists():  # it stays the same folder, as whoever made it may hold a lock on it
            for name in texts:
                os.replace(draft / name, folder / name)
        else:
            os.replace(draft, folder)
    except OSError as error:
        raise InputError(f"the campaign cannot be written: {error.strerror}", file=folder) from None
    finally:
        shutil.rmtree(draft, ignore_errors=True)
    return replace(written, path=folder, notes=campaign.notes)


def format_campaign(campaign: Campaign, folder: Path = Path()) -> dict[str, str]:
    """The files of a campaign that is written into `folder`, name to text, the descriptor last."""
    parts = {"records": (campaign.records, campaign.conditions)}
    if campaign.samples is not None and campaign.independent is not None:
        columns = {campaign.independent.name: campaign.independent} | campaign.channels
        parts["samples"] = campaign.samples.set_index("record"), columns
    if campaign.peaks is not None:
        parts["peaks"] = campaign.peaks, campaign.peak_columns
    texts, resources = {}, []
    for name, (frame, columns) in parts.items():
        cells = {column: frame[column].to_numpy(dtype=float) for column in columns}
        for column in set(checks.COUNTS) & set(columns):
            cells[column] = np.array([int(x) if x.is_integer() else x for x in cells[column].tolist()], dtype=object)
        table = pd.DataFrame(cells, index=frame.index.map(str))
        texts[f"{name}.csv"] = table.to_csv(index_label="record", lineterminator="\n")
        schema: dict[str, Any] = {"fields": [{"name": "record", "type": "string"}, *map(_describe, columns.values())]}
        if name == "records":
            schema["primaryKey"] = "record"
        else:
            link = {"resource": "records", "fields": "record"}
            schema["foreignKeys"] = [{"fields": "record", "reference": link}]
        resources.append({"name": name, "path": f"{name}.csv", "format": "csv", "schema": schema})
    units = {name: checks.unit_of_known(name, find_kind(campaign.family)) for name in campaign.known}
    known = {name: value if value is None else float(value) if units[name] == "1" else f"{float(value)!r} {units[name]}"
             for name, value in campaign.known.items()}
    descriptor = {
        "name": re.sub(r"[^a-z0-9._-]+", "-", campaign.name.lower()).strip("-.") or "campaign",
        "title": campaign.title,
        "licenses": list(campaign.licences),
        "sources": list(campaign.sources),
        "family": write_kind(campaign.family, folder),
        "known": known,
        "resources": resources,
    }
    descriptor = {key: value for key, value in descriptor.items() if value or key == "known"}
    texts["datapackage.json"] = json.dumps(descriptor, indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    return texts


def _describe(column: Column) -> dict:
    """A column's field in the descriptor."""
    field: dict[str, Any] = {"name": column.name, "type": "integer" if column.name in checks.COUNTS else "number"}
    if column.name not in checks.COUNTS:
        field["unit"] = column.unit
        if column.stated:
            field["stated_unit"] = column.stated
        if column.gauge:
            field["stated_reference"] = "gauge"
    for key, uncertainty in (("uncertainty", column.uncertainty), ("common_uncertainty", column.common)):
        if uncertainty is None:
            continue
        if uncertainty.relative is None and uncertainty.absolute is not None:
            field[key] = f"{float(uncertainty.absolute)!r} {column.unit}"
        elif uncertainty.relative is not None and uncertainty.absolute is None:
            field[key] = f"{float(f'{uncertainty.relative * 100:.15g}')!r} %"
        else:
            raise InputError("an uncertainty must be either absolute or relative, not both")
    if column.assumed:
        field["assumed"] = True
    sentence = "Measured relative to the ambient pressure; absolute here."
    told = not column.gauge or sentence in column.description or "gauge" in column.description
    description = column.description if told else f"{column.description} {sentence}".strip()
    return field | ({"description": description} if description else {})
