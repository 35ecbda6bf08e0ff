"""The report of a comparison: one model against the measurements, nothing added."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from ..measurement.quantities import clean, describe_quantity, format_error, format_number, format_share
from ..selection.compare import Comparison, Comparisons
from ..selection.result import Place, Trace
from .findings import STEPS_CAPTION, show_failures, show_fits
from .page import Section, Table, draw_picture, write_page


# Columns of the errors in words; those of residuals in the channel's unit are named with it.
_WORDS = {"ratio": "rms / noise", "nrmse": "rms / signal", "samples": "samples", "records": "records",
          "record": "record", "sequence": "place in the series", "chi2_reduced": "χ² per sample", "channel": "channel"}
_RESIDUALS = {"rms": "rms residual", "bias": "mean residual"}


def write_comparison(
    sentence: str,
    models: Mapping[str, Sequence[Trace]],
    folder,
    *,
    title: str = "Model against measurement",
    noise: Mapping | None = None,
    where: Sequence[Place] | None = None,
    status: Sequence[str] = (),
    facts: Sequence[tuple[str, str, str]] = (),
    first: Sequence[Section] = (),
    sections: Sequence[Section] = (),
    name: str = "comparison.html",
) -> Path:
    """Write a comparison of one or two models with a campaign as a page; figures as PNG in `figures/` beside it.

    Args:
        sentence: the first thing on the page.
        models: traces by the model's name; of two, the simpler first.
        folder: where to write.
        title: of the page, shown by the browser.
        noise: by channel, as in `Discovery.noise`.
        where: places of the misfit; None where nobody looked for them.
        status: short facts for the line below the sentence, such as the campaign's name.
        facts: boxes of (what, value, remark).
        first, sections: further parts, before and after the figures.
        name: of the page's file.

    Returns:
        Path of the page.

    Raises:
        InputError: The folder cannot be written.
    """
    models = {clean(label, 60): traces for label, traces in models.items()}
    parts = [*first, show_fits(models), show_failures(models, noise, where), *sections]
    return write_page(title, sentence, parts, folder, name, status=[clean(one, 120) for one in status], facts=facts)


def report_comparison(found: Comparison | Comparisons, folder) -> Path:
    """Write what `compare` returned as a page, `comparison.html`; returns its path.

    Of several models it shows the error by step, what each changes beside what the first leaves, and the one that
    cross-validates best.
    """
    if isinstance(found, Comparison):
        return write_comparison(
            found.sentence, {found.model: found.traces}, folder, title=f"{found.campaign} and the model {found.model}",
            noise=found.noise, where=found.where, status=(found.campaign, f"{len(found.records)} records"),
            sections=[tabulate_errors(found)])
    best = len(found) - 1 if found.best is None else found.best
    shown = {found.names[k]: found[k].traces for k in dict.fromkeys((0, best))}
    one = found[best]
    return write_comparison(
        found.sentence, shown, folder, title=f"{one.campaign} and {len(found)} models", noise=one.noise,
        where=found[0].where, status=(one.campaign, f"{len(one.records)} records"),
        first=[_show_models(found), _show_signatures(found)], sections=[tabulate_errors(one)])


def _show_models(found: Comparisons) -> Section:
    """Error by model, drawn and as a table."""
    from .. import figures

    floor = min(one.noise_nrmse for one in found)
    rows = [(name, one.free, format_number(one.chi2_reduced), format_error(one.nrmse),
             format_error(one.heldout_nrmse), format_error(one.prediction_nrmse), format_share(one.prediction_coverage),
             format_error(one.noise_nrmse), "yes" if one.lack_of_fit.rejected else "no")
            for name, one in zip(found.names, found, strict=True)]
    table = Table(("model", "free", "χ² / dof", "error", "cross-validated", "prediction", "coverage", "noise floor",
                   "misfit left"), rows, STEPS_CAPTION)
    alt = f"Error of {len(found)} models against the noise floor of {format_error(floor)}."
    caption = ("Root mean square of the residual over that of the signal: of all records, and of conditions left out "
               "one after the other. No model can do better than the noise floor.")
    return Section("The error, step by step", figures=[draw_picture(
        "error-by-step", caption, figures.draw_error_by_step, found.names, found.models, floor, alt=alt)],
        tables=[table])


def _show_signatures(found: Comparisons) -> Section:
    """What each model changes of the first one's prediction, beside what that one leaves."""
    from .. import figures

    models = {clean(name, 60): one.traces for name, one in zip(found.names, found, strict=True)}
    channel = found[0].traces[0].channel
    word, first = describe_quantity(channel).name, clean(found.names[0])
    caption = (f"Dots: measured minus {first}, {word}, single samples faint. Lines: what each other model changes of "
               "its prediction after the fit. What is missing runs along the dots.")
    alt = f"Residual of {first} and the change that {len(found) - 1} models make to it, where it is largest."
    picture = draw_picture("signatures", caption, figures.draw_signatures, models, channel, alt=alt)
    return Section("Why an effect fits", figures=[picture])


def tabulate_errors(result: Comparison) -> Section:
    """Errors by channel, condition and record as a part of a page, every column with its unit."""
    units = {str(row["channel"]): str(row["unit"]) for _, row in result.channels.iterrows()}
    tables = [_tabulate(result.channels.drop(columns="unit"), units, "By channel.")]
    if any(name not in _WORDS and not name.startswith("ratio") and name not in _RESIDUALS
           for name in result.conditions.columns):
        tables.append(_tabulate(result.conditions, units,
                                "By condition; each is the mean over tests with equal settings."))
    tables.append(_tabulate(result.records, units, "By record."))
    text = "Rms / noise is the error over the standard deviation of the noise: 1 is as good as a model can be."
    return Section("Errors", [text], tables=tables)


def _tabulate(frame: pd.DataFrame, units: Mapping[str, str], caption: str) -> Table:
    """A table of errors with headings in words; `units` are those of the channels, SI."""
    header, columns = [], []
    shown = {channel: describe_quantity(channel, unit=unit) for channel, unit in units.items()}
    several = len({one.unit for one in shown.values()}) > 1
    for name in map(str, frame.columns):
        values = list(frame[name])
        if name in _RESIDUALS:
            unit = next(iter(shown.values())).unit
            header.append(_RESIDUALS[name] + ("" if several else f" [{unit}]"))
            own = ([shown[str(channel)] for channel in frame["channel"]] if "channel" in frame else
                   [next(iter(shown.values()))] * len(values))
            columns.append([f"{format_number(one.scale * float(value))} {one.unit if several else ''}".rstrip()
                            for one, value in zip(own, values, strict=True)])
        elif name.startswith("ratio_"):
            header.append(f"rms / noise, {describe_quantity(name.removeprefix('ratio_')).name}")
            columns.append([format_number(float(value)) for value in values])
        elif name in _WORDS:
            header.append(_WORDS[name])
            columns.append([_show(name, value) for value in values])
        else:
            setting = describe_quantity(name, np.asarray(values, float))
            header.append(setting.label)
            columns.append([setting.format(float(value)) for value in values])
    return Table(header, list(zip(*columns, strict=True)), caption)


def _show(name: str, value) -> str:
    """A cell of a column that has a word of its own."""
    if name == "nrmse":
        return format_error(float(value))
    if name == "channel":
        return describe_quantity(str(value)).name
    if name in ("samples", "records", "sequence") and np.isfinite(value):
        return f"{float(value):g}"
    return clean(value) if isinstance(value, str) else format_number(float(value))
