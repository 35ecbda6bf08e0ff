"""Read a campaign from its data package: every number in SI, or one sentence on what is wrong and where."""

import hashlib
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd

from .._errors import InputError
from . import checks
from .campaign import Campaign, Column, Uncertainty, arrange_samples
from .descriptor import FieldModel, ResourceModel, find_descriptor, locate_resource, read_descriptor
from .storage import write_campaign as write_campaign  # noqa: PLC0414  (reading and writing are one interface)
from .tables import Table, convert_column, decode, parse_table, pick_column, read_bytes
from .units import Unit, check_unit, parse_quantity, parse_uncertainty, parse_unit, role_of, si_unit


REQUIRED = {
    "impact": ("initial_pressure", "approach_speed"),
    "slip": ("normal_load", "internal_pressure", "slip_speed"),
    "tumble": (),
}
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
        path: Its folder, or the `datapackage.json` in it.

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

    described = [field.name for field in resources["records"].table.fields]
    for name in REQUIRED[model.family]:
        if name not in described:
            context.refuse(f"records of the family {model.family} need this condition; add its column and field", name)
    records = _read_resource(resources["records"], context)
    _check_unique(records)
    samples = peaks = None
    if "samples" in resources:
        samples = _read_resource(resources["samples"], context)
        independent = checks.check_samples(samples, records.keys, model.family, str(descriptor))
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
        family=model.family,
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


def _read_known(known: dict, descriptor: Path) -> dict[str, float | None]:
    values = {}
    for name, value in known.items():
        try:
            values[name] = None if value is None else parse_quantity(value, name)
        except InputError as error:
            raise InputError(f"known: {error.problem}", file=descriptor, column=name) from None
        checks.check_known(name, values[name], str(descriptor))
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
