"""A campaign's data package, read and written: every number in SI, or one sentence on what is wrong and where."""

import hashlib
import json
import os
import re
import shutil
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from .._errors import InputError
from . import checks
from .campaign import Campaign, Column, arrange_samples
from .descriptor import FieldModel, ResourceModel, find_descriptor, locate_resource, read_descriptor
from .kinds import find_kind, take_kind, write_kind
from .tables import Table, convert_column, decode, parse_table, pick_column, read_bytes
from .units import Uncertainty, Unit, check_unit, parse_quantity, parse_uncertainty, parse_unit, role_of, si_unit


UNITLESS = ("sequence", "repeats")


@dataclass
class _Context:
    """What all tables of one package share while it is read."""

    descriptor: Path
    known: dict
    hash: "hashlib._Hash"
    notes: list

    def refuse(self, problem: str, column: str | None = None):
        raise InputError(problem, file=self.descriptor, column=column)


@dataclass
class _Numbers:
    """A table with its numbers in SI."""

    table: Table
    keys: list[str]
    columns: dict[str, Column]
    values: dict[str, np.ndarray]


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
    model, data = read_descriptor(descriptor)
    digest = hashlib.sha256(b"%d\n" % len(data) + data)
    context = _Context(descriptor, _read_known(model.known, descriptor), digest, [])
    resources = {}
    for resource in model.resources:
        if resource.name in resources:
            context.refuse(f"there are two resources named {resource.name!r}; keep one")
        resources[resource.name] = resource
        if resource.name not in ("records", "samples", "peaks"):
            context.notes.append(f"The resource {resource.name} is not part of a campaign and was left out.")
    if "records" not in resources:
        context.refuse("there is no resource named records; add the table with one row a test")
    if not {"samples", "peaks"} & set(resources):
        context.refuse("there is no resource named samples or peaks; add the table with the measurements")

    family = _take_family(model.family, descriptor)
    kind = find_kind(family)
    described = [field.name for field in resources["records"].table.fields]
    for name in kind.needs:
        if name not in described:
            context.refuse(f"records of the family {family} need this condition; add its column and field", name)
    records = _read_resource(resources["records"], context)
    _check_unique(records)
    samples = peaks = None
    if "samples" in resources:
        samples = _read_resource(resources["samples"], context)
        independent = checks.check_samples(samples, records.keys, kind, str(descriptor))
    if "peaks" in resources:
        peaks = _read_resource(resources["peaks"], context)
        checks.check_peaks(peaks, records.keys)
    checks.check_coverage(records, samples, peaks)
    for name, column in {} if peaks is None else peaks.columns.items():
        if column.common is not None:
            context.refuse("common_uncertainty of a peak is not read; state that of a condition", name)

    campaign = Campaign(
        name=model.name or descriptor.resolve().parent.name,
        title=model.title,
        family=family,
        path=descriptor.parent,
        known=context.known,
        records=_frame(records),
        conditions=records.columns,
        sha256=context.hash.hexdigest(),
        sources=tuple(model.sources),
        licences=tuple(model.licenses),
        notes=tuple(context.notes),
    )
    if samples is not None:
        channels = {name: column for name, column in samples.columns.items() if name != independent}
        order = {"record": samples.keys, independent: samples.values[independent]}
        frame = pd.DataFrame(order | {name: samples.values[name] for name in channels})
        campaign = replace(
            campaign,
            independent=samples.columns[independent],
            channels=channels,
            samples=arrange_samples(frame, records.keys),
        )
    if peaks is not None:
        campaign = replace(campaign, peaks=_frame(peaks), peak_columns=peaks.columns)
    return campaign


def _take_family(given: str, descriptor: Path) -> str:
    try:
        return take_kind(given, descriptor.parent)
    except InputError as error:
        if error.file is not None:
            raise
        raise InputError(error.problem, file=descriptor, key="family") from None


def _read_known(known: dict, descriptor: Path) -> dict[str, float | None]:
    values = {}
    for name, value in known.items():
        try:
            values[name] = None if value is None else parse_quantity(value, name)
            checks.check_known(name, values[name])
        except InputError as error:
            raise InputError(error.problem, file=descriptor, key=f"known.{name}") from None
    return values


def _read_resource(resource: ResourceModel, context: _Context) -> _Numbers:
    """Read one table and convert its numeric columns."""
    path = locate_resource(resource, context.descriptor)
    fields = _check_fields(resource, context)
    if resource.encoding.lower().replace("_", "-") not in ("utf-8", "utf8", "utf-8-sig", "ascii"):
        context.refuse(f"the encoding {resource.encoding!r} of {resource.name} is not read; save the table as UTF-8")
    data = read_bytes(path)
    name = resource.name.encode()
    context.hash.update(b"%d %d\n" % (len(name), len(data)) + name + data)
    delimiter = resource.dialect.delimiter
    if resource.format == "tsv" and "delimiter" not in resource.dialect.model_fields_set:
        delimiter = "\t"
    if delimiter == resource.dialect.quoteChar:
        context.refuse(f"resource {resource.name}: the delimiter and the quote character are the same; change one")
    text = decode(data, str(path))
    table = parse_table(text, str(path), delimiter=delimiter, quote=resource.dialect.quoteChar)
    for name in fields:
        pick_column(table, name)
    for name in table.columns:
        if name not in fields:
            problem = f"the column is not described in {context.descriptor.name}; add a field for it or remove it"
            raise InputError(problem, file=table.file, column=name)
    keys = [cell.strip() for cell in table.columns["record"]]
    checks.check_keys(keys, table)
    numbers = _Numbers(table, keys, {}, {})
    missing = frozenset(resource.table.missingValues)
    for name, field in fields.items():
        if name != "record" and field.numeric:
            _convert_field(field, numbers, missing, resource.name, context)
        elif name != "record":
            context.notes.append(f"The column {name} of {resource.name} is not numeric and was left out.")
    return numbers


def _check_fields(resource: ResourceModel, context: _Context) -> dict[str, FieldModel]:
    """Fields by name: none twice, a text key `record`, and numbers declared as numbers."""
    fields = {}
    for field in resource.table.fields:
        if field.name in fields:
            context.refuse(f"resource {resource.name} has two fields of that name; keep one", field.name)
        fields[field.name] = field
        if field.name != "record" and role_of(field.name) and not field.numeric:
            given = field.type or "no type"
            context.refuse(f'resource {resource.name}: declare the field as "type": "number" (now {given})', field.name)
    if "record" not in fields:
        context.refuse(f"resource {resource.name} has no field record; add the key that names the test", "record")
    key = resource.table.primaryKey
    if resource.name == "records" and key not in (None, "record", ["record"]):
        context.refuse('the primaryKey of records must be "record"')
    for link in resource.table.foreignKeys:
        if link.reference.resource != "records" or link.fields not in ("record", ["record"]):
            context.refuse(f'resource {resource.name}: a foreign key must lead from "record" to the resource records')
    return fields


def _convert_field(field: FieldModel, numbers: _Numbers, missing, resource: str, context: _Context) -> None:
    """Convert one numeric column to SI and note what is known about it."""
    name = field.name
    unit = _field_unit(field, resource, context)
    uncertainty, common = (_read_uncertainty(text, unit, name, context)
                           for text in (field.uncertainty, field.common_uncertainty))
    gauge = field.reference == "gauge"
    sparse = resource != "records" and name not in ("time", *UNITLESS)
    values = convert_column(
        numbers.table, name, decimal=field.decimalChar, missing=missing, allow_missing=sparse
    )
    with np.errstate(over="ignore"):
        values = unit.convert(values)
    checks.check_finite(values, numbers.table, name)
    if gauge:
        values = values + _ambient(name, unit, context)
        context.notes.append(f"The gauge pressures of {name} were made absolute with the stated ambient_pressure.")
        if any(one is not None and one.relative is not None for one in (uncertainty, common)):
            problem = 'the uncertainty of a gauge pressure must be absolute, like "2 kPa" (per cent of what?)'
            context.refuse(problem, name)
    if field.assumed:
        context.notes.append(f"The column {name} is marked as an assumption, not a measurement.")
    checks.check_values(name, values, numbers.table, resource, uncertainty)
    if name in ("initial_pressure", "internal_pressure") and not np.all(values):
        context.notes.append(f"The column {name} holds absolute pressures of zero: a ball without gas.")
    numbers.columns[name] = Column(name, unit.si, uncertainty, gauge, field.assumed, field.description, common)
    numbers.values[name] = values


def _read_uncertainty(text, unit: Unit, name: str, context: _Context) -> Uncertainty | None:
    try:
        return None if text is None else parse_uncertainty(text, unit, name)
    except InputError as error:
        context.refuse(error.problem, name)


def _field_unit(field: FieldModel, resource: str, context: _Context) -> Unit:
    if field.unit is None:
        if field.name in UNITLESS or role_of(field.name) == "pure number":
            return parse_unit("1")
        wanted = si_unit(field.name) if role_of(field.name) else "mm"
        problem = f'resource {resource}: the field has no unit; add "unit": "{wanted}" or what it is ("1" for a ratio)'
        context.refuse(problem, field.name)
    try:
        return check_unit(field.unit, field.name)
    except InputError as error:
        context.refuse(f"resource {resource}: {error.problem}", field.name)


def _ambient(name: str, unit: Unit, context: _Context) -> float:
    if unit.dimension != parse_unit("Pa").dimension:
        context.refuse('only a pressure can have "reference": "gauge"', name)
    ambient = context.known.get("ambient_pressure")
    if ambient is None:
        problem = 'gauge pressures need the ambient pressure: add "ambient_pressure": "101.3 kPa" or as measured'
        context.refuse(problem, name)
    return ambient


def _check_unique(records: _Numbers) -> None:
    seen = {}
    for key, line in zip(records.keys, records.table.lines, strict=True):
        if key in seen:
            problem = f"the record {key!r} is there already on line {seen[key]}; give every test its own key"
            raise InputError(problem, file=records.table.file, column="record", row=line)
        seen[key] = line


def _frame(numbers: _Numbers) -> pd.DataFrame:
    """Numbers of a table with one row a record, indexed by its key."""
    return pd.DataFrame(numbers.values, index=pd.Index(numbers.keys, name="record", dtype=object))


def write_campaign(folder, campaign: Campaign, *, overwrite: bool = False) -> Campaign:
    """Write a campaign's folder: `datapackage.json`, `records.csv` and `samples.csv` or `peaks.csv`.

    The package is written beside its place, read back with every check, and only then moved there.

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
    if folder.exists() and not folder.is_dir():
        raise InputError("is a file; name a folder for the campaign", file=folder)
    if folder.is_dir() and any(folder.iterdir()):
        if not (folder / "datapackage.json").is_file():
            raise InputError("the folder holds other files; name a new folder for the campaign", file=folder)
        if not overwrite:
            problem = "the folder holds a campaign already; name a new one, or replace it with --overwrite"
            raise InputError(problem, file=folder)
    texts = format_campaign(replace(campaign, name=campaign.name or folder.name), folder)
    parent = folder.parent
    try:
        parent.mkdir(parents=True, exist_ok=True)
        draft = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", dir=parent))
    except OSError as error:
        raise InputError(f"the folder cannot be made: {error.strerror}", file=folder) from None
    try:
        for name, text in texts.items():
            (draft / name).write_text(text, encoding="utf-8", newline="")
        try:
            read_campaign(draft)
        except InputError as error:
            name = Path(error.file).name if error.file else None
            raise InputError(error.problem, file=name, column=error.column, row=error.row, key=error.key) from None
        os.chmod(draft, 0o777 & ~_umask())
        if folder.is_dir() and any(folder.iterdir()):
            for name in texts:  # the descriptor is last
                os.replace(draft / name, folder / name)
        else:
            os.replace(draft, folder)
    except OSError as error:
        raise InputError(f"the campaign cannot be written: {error.strerror}", file=folder) from None
    finally:
        shutil.rmtree(draft, ignore_errors=True)
    written = read_campaign(folder)
    return replace(written, notes=campaign.notes)


def format_campaign(campaign: Campaign, folder: Path = Path()) -> dict[str, str]:
    """The files of a campaign that is written into `folder`, name to text, the descriptor last."""
    texts, resources = {}, []
    if campaign.samples is not None:
        assert campaign.independent is not None
        columns = {campaign.independent.name: campaign.independent} | campaign.channels
        parts = {"records": (campaign.records, campaign.conditions), "samples": (campaign.samples, columns)}
    else:
        parts = {"records": (campaign.records, campaign.conditions)}
    if campaign.peaks is not None:
        parts["peaks"] = (campaign.peaks, campaign.peak_columns)
    for name, (frame, columns) in parts.items():
        texts[f"{name}.csv"] = _format_table(frame, columns)
        schema: dict[str, Any] = {"fields": [{"name": "record", "type": "string"}, *map(_describe, columns.values())]}
        if name == "records":
            schema["primaryKey"] = "record"
        else:
            link = {"resource": "records", "fields": "record"}
            schema["foreignKeys"] = [{"fields": "record", "reference": link}]
        resources.append({"name": name, "path": f"{name}.csv", "format": "csv", "schema": schema})
    known = {name: None if value is None else _shown(value, si_unit(name)) for name, value in campaign.known.items()}
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
    field: dict[str, Any] = {"name": column.name, "type": "integer" if column.name in UNITLESS else "number"}
    if column.name not in UNITLESS:
        field["unit"] = column.unit
    if column.uncertainty is not None:
        field["uncertainty"] = _format_uncertainty(column.uncertainty, column.unit)
    if column.common is not None:
        field["common_uncertainty"] = _format_uncertainty(column.common, column.unit)
    if column.assumed:
        field["assumed"] = True
    description = column.description
    if column.gauge and "gauge" not in description:
        description = f"{description} Measured against the ambient pressure; absolute here.".strip()
    return field | ({"description": description} if description else {})


def _format_uncertainty(uncertainty: Uncertainty, unit: str) -> str:
    if uncertainty.relative is not None and uncertainty.absolute is None:
        return f"{float(f'{uncertainty.relative * 100:.15g}')!r} %"
    if uncertainty.relative is not None or uncertainty.absolute is None:
        raise InputError("an uncertainty is written either as absolute or as relative, not as both")
    return f"{float(uncertainty.absolute)!r} {unit}"


def _shown(value: float, unit: str) -> str | float:
    return float(value) if unit == "1" else f"{float(value)!r} {unit}"


def _format_table(frame: pd.DataFrame, columns: dict[str, Column]) -> str:
    """A table as CSV: text keys (quoted where needed), numbers with the fewest digits that give them back."""
    keys = frame["record"] if "record" in frame.columns else frame.index
    cells = [[_quoted(str(key)) for key in keys]]
    for name in columns:
        values = frame[name].to_numpy(dtype=float)
        whole = name in UNITLESS
        cells.append([_format_number(value, whole) for value in values.tolist()])
    rows = [",".join(["record", *map(_quoted, columns)])] + [",".join(row) for row in zip(*cells, strict=True)]
    return "\n".join(rows) + "\n"


def _format_number(value: float, whole: bool) -> str:
    if np.isnan(value):
        return ""
    text = repr(value)
    return text[:-2] if whole and text.endswith(".0") else text


def _quoted(text: str) -> str:
    return '"' + text.replace('"', '""') + '"' if re.search(r'[,"\r\n]', text) else text


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
