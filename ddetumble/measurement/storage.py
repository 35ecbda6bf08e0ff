"""Write a campaign as a data package: whole or not at all."""

import json
import os
import re
import shutil
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from .._errors import InputError
from .campaign import Campaign, Column, Uncertainty
from .units import si_unit


_COUNTS = ("sequence", "repeats")


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
    from .package import read_campaign

    folder = Path(os.path.abspath(folder))
    if folder.exists() and not folder.is_dir():
        raise InputError("is a file; name a folder for the campaign", file=folder)
    if folder.is_dir() and any(folder.iterdir()):
        if not (folder / "datapackage.json").is_file():
            raise InputError("the folder holds other files; name a new folder for the campaign", file=folder)
        if not overwrite:
            problem = "the folder holds a campaign already; name a new one, or replace it with --overwrite"
            raise InputError(problem, file=folder)
    texts = format_campaign(replace(campaign, name=campaign.name or folder.name))
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
            raise InputError(error.problem, file=name, column=error.column, row=error.row) from None
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


def format_campaign(campaign: Campaign) -> dict[str, str]:
    """The files of a campaign, name to text, the descriptor last."""
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
        "family": campaign.family,
        "known": known,
        "resources": resources,
    }
    descriptor = {key: value for key, value in descriptor.items() if value or key == "known"}
    texts["datapackage.json"] = json.dumps(descriptor, indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    return texts


def _describe(column: Column) -> dict:
    field: dict[str, Any] = {"name": column.name, "type": "integer" if column.name in _COUNTS else "number"}
    if column.name not in _COUNTS:
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
        whole = name in _COUNTS
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
