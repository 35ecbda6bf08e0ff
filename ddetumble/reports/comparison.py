"""The report of a comparison: models against the measurements, and of several what each one adds."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from .. import figures
from ..figures.traces import are_values
from ..measurement.quantities import clean, describe_quantity, format_error, format_number
from ..selection.compare import Comparison, Comparisons
from .findings import show_errors, show_failures, show_fits
from .page import Section, Table, draw_picture, write_page


def _count(value: float) -> str:
    return f"{value:g}" if np.isfinite(value) else "–"


# Columns of the errors in words, and how they are shown; residuals are in the channel's unit, named with it.
_COLUMNS: dict[str, tuple[str, Callable[[Any], str]]] = {
    "ratio": ("rms / noise", format_number), "nrmse": ("rms / signal", format_error), "samples": ("samples", _count),
    "records": ("records", _count), "record": ("record", clean), "sequence": ("position in the series", _count),
    "chi2_reduced": ("χ² per sample", format_number),
    "channel": ("channel", lambda name: describe_quantity(name).name),
}  # fmt: skip
_RESIDUALS = {"rms": "rms residual", "bias": "mean residual"}


def report_comparison(found: Comparison | Comparisons, folder) -> Path:
    """Write what `compare` returned as a page, `comparison.html`; returns its path.

    Of several models it shows the error by step, what each changes beside what the first leaves, and the one that
    cross-validates best.
    """
    if isinstance(found, Comparison):
        one, shown, sections = found, {found.model: found.traces}, []
        what, where = f"the model {found.model}", found.where
    else:
        best = len(found) - 1 if found.best is None else found.best
        values = are_values(found[0].traces)  # one figure has room for all models of them
        some = range(len(found)) if values else dict.fromkeys((0, best))
        one, shown = found[best], {found.names[k]: found[k].traces for k in some}
        labels = [(name, each.free) for name, each in zip(found.names, found, strict=True)]
        floors = [each.noise_nrmse for each in found]
        sections = [show_errors(labels, found.models, floors, found.names)]
        if not values and len(found) > 1:
            sections.append(_show_signatures(found))
        what, where = f"{len(found)} models", found[0].where
    sentence = found.sentence if isinstance(found, Comparison) else " ".join([found.sentence, *found.failures])
    models = {clean(label, 60): traces for label, traces in shown.items()}
    sections += [show_fits(models), show_failures(models, one.noise, where), tabulate_errors(one)]
    return write_page(f"{one.campaign} and {what}", sentence, sections, folder, "comparison.html",
                      status=[clean(one.campaign, 120), f"{len(one.records)} records"])


def _show_signatures(found: Comparisons) -> Section:
    """What each model changes of the first one's prediction, beside what that one leaves."""
    models = {clean(name, 60): one.traces for name, one in zip(found.names, found, strict=True)}
    channel = found[0].traces[0].channel
    first = clean(found.names[0])
    picture = draw_picture(
        "signatures", f"Dots: measured minus {first}, {describe_quantity(channel).name}, single samples faint. Lines: "
        "the change that each other model makes to its prediction after the fit. An effect that is missing follows the "
        "dots.",
        figures.draw_signatures, models, channel,
        alt=f"Residual of {first} and the change that {len(found) - 1} models make to it, where it is largest.")
    return Section("Why an effect fits", figures=[picture])


def tabulate_errors(result: Comparison) -> Section:
    """Errors by channel, condition and record as a part of a page, every column with its unit."""
    units = {str(row["channel"]): str(row["unit"]) for _, row in result.channels.iterrows()}
    tables = [_tabulate(result.channels.drop(columns="unit"), units, "By channel.")]
    if any(name not in _COLUMNS and not name.startswith("ratio") and name not in _RESIDUALS
           for name in result.conditions.columns):
        tables.append(_tabulate(result.conditions, units,
                                "By condition; each row is the mean over tests with equal settings."))
    tables.append(_tabulate(result.records, units, "By record."))
    text = "Rms / noise is the RMS residual over the standard deviation of the noise: 1 is as good as a model can be."
    followed = [] if result.sequential is None else [str(result.sequential)]
    return Section("Errors", [text, *followed], tables=tables)


def _tabulate(frame: pd.DataFrame, units: Mapping[str, str], caption: str) -> Table:
    """A table of errors with headings in words; `units` are those of the channels, SI."""
    shown = {channel: describe_quantity(channel, unit=unit) for channel, unit in units.items()}
    first, several = next(iter(shown.values())), len({one.unit for one in shown.values()}) > 1
    header, columns = [], []
    for name in map(str, frame.columns):
        values = list(frame[name])
        if name in _RESIDUALS:
            header.append(_RESIDUALS[name] + ("" if several else f" [{first.unit}]"))
            own = [shown[str(one)] for one in frame["channel"]] if "channel" in frame else [first] * len(values)
            columns.append([f"{format_number(one.scale * float(value))} {one.unit if several else ''}".rstrip()
                            for one, value in zip(own, values, strict=True)])
        elif name.startswith("ratio_"):
            header.append(f"rms / noise, {describe_quantity(name.removeprefix('ratio_')).name}")
            columns.append([format_number(float(value)) for value in values])
        elif name in _COLUMNS:
            heading, show = _COLUMNS[name]
            header.append(heading)
            columns.append(list(map(show, values)))
        else:
            setting = describe_quantity(name, np.asarray(values, float))
            header.append(setting.label)
            columns.append([setting.format(float(value)) for value in values])
    return Table(header, list(zip(*columns, strict=True)), caption)
