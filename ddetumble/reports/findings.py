"""The report of what was found in a campaign, as one page."""

import dataclasses as dc
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from ..families import View, find_family
from ..figures.traces import find_span, find_stretch, is_peaks, standardise
from ..measurement.quantities import (
    clean,
    describe_quantity,
    format_error,
    format_number,
    format_p,
    format_share,
    format_value,
    join_words,
    name_step,
    name_steps,
    say_p,
)
from ..selection.discovery import Discovery
from ..selection.result import Place, SettingShift, Step, Trace
from ..selection.series import list_channels
from ..selection.settings import DEFAULT
from ..selection.text import choose_view, list_alternatives, say_place, say_verdict, share_at_step, show_estimate
from .missing import show_missing
from .page import Picture, Section, Table, draw_picture, flatten, write_page


def write_report(discovery: Discovery, folder, name: str = "report.html") -> Path:
    """Write what was found as one self-contained page, and its figures as PNG files in `figures/` beside it.

    Args:
        discovery: what `discover` returned.
        folder: where to write; made where it is not there.
        name: of the page's file.

    Returns:
        Path of the page.

    Raises:
        InputError: The folder cannot be written.
    """
    records = len({trace.record for step in discovery.steps[-1:] for trace in step.traces})
    level = discovery.settings.level
    status = [
        f"campaign {clean(discovery.campaign, 60)}",
        clean(discovery.title, 120) if discovery.title != discovery.campaign else "",
        f"{records} records" if records != 1 else "1 record",
        f"reference model {clean(discovery.model, 60)}",
        f"judged at the {format_share(float(level))} level" if isinstance(level, (int, float)) else "",
    ]
    return write_page(
        f"{say_verdict(discovery.verdict)}: {discovery.campaign}", discovery.sentence, build_sections(discovery),
        folder, name, verdict=discovery.verdict, badge=say_verdict(discovery.verdict), status=status,
        facts=list_facts(discovery),
    )  # fmt: skip


def say_model(discovery: Discovery) -> str:
    """The grown model in a few words: `with adhesion and gas-leak`."""
    effects = [clean(effect, 40) for effect in discovery.effects]
    return f"with {join_words(effects)}" if effects else ""


def list_facts(discovery: Discovery) -> list[tuple[str, str, str]]:
    """The numbers that a reader wants first: what, value, remark."""
    if not discovery.steps:
        return []
    first, last = discovery.steps[0], discovery.steps[-1]
    grown = len(discovery.steps) > 1

    def compare(one: float, other: float) -> str:
        return f"{format_error(one)} → {format_error(other)}" if grown else format_error(one)

    floor = f"noise floor {format_error(discovery.noise_nrmse)}"
    facts = [("error of the fit", compare(first.nrmse, last.nrmse), floor)]
    if math.isfinite(first.heldout_nrmse):
        held = compare(first.heldout_nrmse, last.heldout_nrmse)
        what = find_family(discovery.family).folds
        facts.append((f"error on held-out {what}", held, f"whole {what} left out"))
    chi2 = format_number(first.chi2_reduced) + (f" → {format_number(last.chi2_reduced)}" if grown else "")
    facts.append(("χ² per degree of freedom", chi2, "1 is noise alone"))
    fit = last.lack_of_fit
    facts.append(("misfit left", "yes" if fit.rejected else "none seen", say_p(fit.p_value)))
    return facts


def build_sections(discovery: Discovery) -> list[Section]:
    """The parts of the page, in the order in which a reader asks for them."""
    sections = []
    if discovery.steps:
        first, last = discovery.steps[0], discovery.steps[-1]
        models = {"reference model": first.traces}
        if len(discovery.steps) > 1:
            models[say_model(discovery)] = last.traces
        sections.append(_show_steps(discovery))
        if discovery.faults:
            sections.append(_show_faults(discovery))
        if any(models.values()):
            sections.append(show_fits(models))
            sections.append(show_failures(models, discovery.noise, discovery.where))
            shifts = {label: step.shifts for label, step in zip(models, (first, last), strict=False)}
            if all(shifts.values()):
                sections.append(show_shifts(shifts))
        elif discovery.where:
            view = choose_view(family=discovery.family)
            sections.append(Section("Where the model fails", points=[say_place(one, view) for one in discovery.where]))
    if discovery.missing is not None:
        sections += show_missing(discovery.missing)
    if discovery.candidates:
        sections.append(_show_ranking(discovery))
    if discovery.steps and discovery.steps[-1].parameters:
        sections.append(_show_parameters(discovery))
    sections.append(_show_judgement(discovery))
    rows = [("campaign", clean(discovery.campaign)), ("title", clean(discovery.title)), ("family", discovery.family),
            ("SHA-256 of the campaign", discovery.sha256), ("reference model", clean(discovery.model)),
            ("verdict", discovery.verdict),
            *flatten({**discovery.counts, "thresholds": dc.asdict(discovery.settings)})]  # fmt: skip
    sections.append(Section("Provenance", tables=[Table(("item", "value"), rows)]))
    return sections


def show_fits(models: Mapping[str, Sequence[Trace]]) -> Section:
    """Model against measurement, every channel."""
    from .. import figures

    first = next(iter(models.values()))
    if is_peaks(first):
        pictures = [
            draw_picture(f"peaks-{channel}", f"{_begin(channel)} of each record, measured and modelled; below, the "
                         "residual in units of the noise.", figures.draw_peaks, models, channel)
            for channel in list_channels(first)
        ]  # fmt: skip
        return Section("Model against measurement", figures=pictures)
    pictures, view = [], choose_view(first)
    for i, channel in enumerate(list_channels(first)):
        caption = (
            f"{_begin(channel)} of records spread over the conditions: measured (dots) and modelled (lines). Below "
            "each, measured minus model in units of the noise, single samples faint and their running mean as a line."
        )
        if any(find_stretch(trace) != find_span(trace) for trace in first if trace.channel == channel):
            caption += " Of records that turn too often to be seen, the end is drawn."
        names = " and ".join(models)
        alt = f"{_begin(channel)} over {view.along} for up to eight records with {names}, and their residuals."
        figure = figures.draw_fit(models, channel, count=8 if i == 0 else 4)
        narrow = figures.draw_fit(models, channel, count=2, narrow=True)
        pictures.append(Picture(f"fit-{channel}", caption, figure, alt, narrow))
    return Section("Model against measurement", figures=pictures)


def show_failures(
    models: Mapping[str, Sequence[Trace]], noise: Mapping | None = None, where: Sequence[Place] | None = None
) -> Section:
    """Where the residuals sit, and what they depend on; `where` is None where nobody looked for places."""
    from .. import figures

    first = next(iter(models.values()))
    view, channels = choose_view(first), list_channels(first)
    pictures = [
        draw_picture("record-errors", "Root mean square of the residual over the noise at each condition, repeats "
                     "pooled. 1 is as good as a model can be.", figures.draw_record_errors, models,
                     alt="Grid of the error over the noise by condition."),
    ]  # fmt: skip
    if not is_peaks(first):
        pictures.insert(0, draw_picture(
            "residual-map", "Mean residual over the noise, one row a record in the order of its conditions. Stripes "
            "that many rows share are physics; scattered colour is noise, or a setting that is off in one record.",
            figures.draw_residual_map, models, alt=f"Heat map of the residuals by record and {view.share}."))
        apart = f"{view.apart} apart, " if view.phases else ""
        for channel in channels:
            pictures.append(draw_picture(
                f"dependence-{channel}", f"{_begin(channel)}: mean residual against state and condition, {apart}with "
                "two standard errors from the scatter between records.",
                figures.draw_dependence, models, channel, (noise or {}).get(channel), where or (),
                alt=f"Mean residual of the {describe_quantity(channel).name} against state and conditions."))
        if view.force in channels:
            pictures.append(_show_missing(models, view))
    points = [] if where is None else [say_place(place, view) for place in where] or ["No place stands out."]
    return Section("Where the model fails" if where else "Where the residuals sit", points=points, figures=pictures)


def show_shifts(models: Mapping[str, Sequence[SettingShift]]) -> Section:
    """How far the settings of the records were moved, against what is stated."""
    from .. import figures

    rows = [
        (*((clean(label),) if len(models) > 1 else ()), describe_shift(shift.name),
         f"{format_number(shift.stated * describe_quantity(shift.name).scale)} {describe_quantity(shift.name).unit}",
         format_number(shift.rms, 2), f"{shift.largest:+.2g}", clean(shift.record), format_p(shift.p_value))
        for label, shifts in models.items() for shift in shifts
    ]  # fmt: skip
    header = (*(("model",) if len(models) > 1 else ()), "setting", "stated sd", "rms shift / sd", "largest shift / sd",
              "record", "p")  # fmt: skip
    caption = (
        "Every record's settings may move from what was written down, at a price that their stated uncertainty sets. "
        "Shifts far beyond two stated deviations are a finding: the model fails and the settings make up for it, or "
        "they scatter more than stated."
    )
    alt = "Shift of every setting in every record, in stated deviations."
    picture = draw_picture("settings", caption, figures.draw_shifts, models, alt=alt)
    return Section("How far the settings were moved", figures=[picture], tables=[Table(header, rows)])


def describe_shift(name: str) -> str:
    """Name of a setting in words."""
    return "time origin" if name == "time" else describe_quantity(name).name


def _measure_miss(traces: Sequence[Trace], channel: str) -> float:
    """Mean square of the residuals of a channel over its noise."""
    return float(np.mean(np.concatenate([np.nan_to_num(standardise(t)) ** 2 for t in traces if t.channel == channel])))


def _show_missing(models: Mapping[str, Sequence[Trace]], view: View) -> Picture:
    """The force that is missing, over what a misfit is located in."""
    from .. import figures

    first = next(iter(models.values()))
    forces = [c for c in ("normal_force", "tangential_force") if any(trace.channel == c for trace in first)]
    # Of two forces the one that the first model misses more.
    channel = max(forces, key=lambda c: _measure_miss(first, c)) if len(forces) > 1 else view.force
    state, force = describe_quantity(view.state).name, describe_quantity(channel).name
    word = "force" if forces == ["normal_force"] else force
    caption = (
        f"The {word} that the model leaves unexplained over the {state}: the shape of what is missing. Records whose "
        "lines fall together share a cause that does not depend on the condition."
    )
    if "backward" in view.phases:
        caption += " On a stroke backward the force is negative, so friction that is missing is too."
    return draw_picture("missing-force", caption, figures.draw_missing_force, models, channel,
                        alt=f"Measured minus modelled {word} against {state}.")


STEPS_CAPTION = (
    "Cross-validated: each condition by the model fitted without it, its own settings adjusted within their stated "
    "uncertainty. Prediction: the same from the settings as they are written down; coverage is the share of samples "
    "within the predicted 95 % interval.")


def _show_steps(discovery: Discovery) -> Section:
    from .. import figures

    rows = [
        (name_step(discovery.steps, number, discovery.model), format_number(step.chi2_reduced),
         format_error(step.nrmse), format_error(step.heldout_nrmse), format_error(step.prediction_nrmse),
         format_share(step.prediction_coverage), format_error(discovery.noise_nrmse),
         "yes" if step.lack_of_fit.rejected else "no", "yes" if step.converged else "no")
        for number, step in enumerate(discovery.steps)
    ]  # fmt: skip
    table = Table(("model", "χ² / dof", "error", "cross-validated", "prediction", "coverage", "noise floor",
                   "misfit left", "converged"), rows, STEPS_CAPTION)
    caption = (
        "Root mean square of the residual over that of the signal, for every model of the loop: of all records, and of "
        "conditions left out one after the other. No model can do better than the noise floor."
    )
    alt = f"Error of {len(discovery.steps)} models against the noise floor of {format_error(discovery.noise_nrmse)}."
    return Section("The error, step by step", figures=[
        draw_picture("error-by-step", caption, figures.draw_error_by_step, name_steps(discovery), discovery.steps,
                     discovery.noise_nrmse, alt=alt),
    ], tables=[table])


def _show_ranking(discovery: Discovery) -> Section:
    from .. import figures

    rows, marked, view = [], set(), choose_view(family=discovery.family)
    for i, one in enumerate(discovery.candidates):
        if one.effect in discovery.effects:
            marked.add(i)
        detectable = ", ".join(
            f"{clean(key.removeprefix(f'{one.effect}.'))} {format_number(value)} {clean(one.units.get(key, ''), 16)}"
            .rstrip()
            for key, value in one.smallest_detectable.items())  # fmt: skip
        error = one.standard_error
        difference = "–" if one.heldout_difference == 0 else (
            f"{format_value(one.heldout_difference, error)} ± {format_value(error, error)}")
        kin = ", ".join(map(clean, one.indistinguishable_from))
        later = share_at_step(discovery.steps, one.effect)
        gain = (format_share(one.explains, 1), format_p(one.p_value)) if later is None else (
            f"{format_share(later[1], 1)} (step {later[0]})", "–")  # fmt: skip
        rows.append((clean(one.effect), *gain, format_share(one.visible), format_error(one.heldout_nrmse),
                     format_error(one.prediction_nrmse), difference,
                     detectable or "–",
                     kin or "–"))  # fmt: skip
    header = ("effect", "explains", "p", "visible", "cross-validated", "prediction", "behind the best, cross-validated",
              "smallest detectable", "cannot be told from")  # fmt: skip
    tables = [Table(header, rows, "All effects of the catalogue as they stood at the first step.", frozenset(marked))]
    paragraphs = [
        "Explains: share of the misfit above noise that the effect alone removes after a refit; of an effect that came "
        "in at a later step, the share that this step removed. Visible: share of its "
        f"own signature that is left when {view.free} and the records' settings are free to imitate it; below "
        f"{100 * DEFAULT.invisible:g} % this campaign cannot see it."
    ]
    kin = [
        (clean(step.added), *row)
        for step in discovery.steps if step.added
        for row in list_alternatives(step.alternatives)
    ]  # fmt: skip
    if kin:
        header = ("added", "alternative", "paired held-out difference", "standard error", "ratio")
        tables.append(Table(header, kin, "Confusion sets: effects that this campaign cannot tell from the one that was "
                            "added at that step."))  # fmt: skip
    elif discovery.effects:
        paragraphs.append("No other effect of the catalogue can be mistaken for what was added.")
    caption = "Bars: share of the misfit that each effect removes. Diamonds: how much of it this campaign can see."
    best = discovery.candidates[0]
    alt = f"Bars of {len(rows)} effects; the first, {clean(best.effect)}, removes {format_share(best.explains)}."
    title = "Which effect is missing" if discovery.effects else "The catalogue, ranked"
    picture = draw_picture("ranking", caption, figures.draw_ranking, discovery.candidates, discovery.effects, alt=alt)
    return Section(title, paragraphs, [picture], tables)


def _show_parameters(discovery: Discovery) -> Section:
    from .. import figures

    steps: dict[str, Step] = {"reference model": discovery.steps[0]}
    if len(discovery.steps) > 1:
        steps[say_model(discovery)] = discovery.steps[-1]
    last = next(reversed(steps.values()))
    rows = []
    for key, one in last.parameters.items():
        value, sd, low, high = show_estimate(one)
        rows.append((clean(key), value, sd, low, high, "–" if one.unit in ("", "1") else clean(one.unit),
                     clean(one.text, 160)))  # fmt: skip
    header = ("parameter", "estimate", "sd", "2.5 %", "97.5 %", "unit", "")
    if not any(row[-1] for row in rows):
        header, rows = header[:-1], [row[:-1] for row in rows]
    strong = [item for item in last.correlations if abs(item[2]) > 0.95]
    points = [
        f"{clean(a)} and {clean(b)} are correlated by {value:+.3f}: the data fix a combination of them far better than "
        "either." for a, b, value in strong
    ]  # fmt: skip
    caption = "Estimates with their 95 % intervals, each on its own scale, and the strongest correlations."
    if len(steps) > 1:
        caption += " Where those of the two models lie apart, the missing physics had pulled the parameter away."
    picture = draw_picture("parameters", caption, figures.draw_parameters, steps,
                           alt=f"Intervals of {len(rows)} parameters.")
    return Section("Parameters", figures=[picture], tables=[Table(header, rows)], points=points)


def _show_faults(discovery: Discovery) -> Section:
    """What is wrong with the data themselves, and what was done about it."""
    rows = [
        (fault.kind,
         clean(", ".join(fault.records), 120) if len(fault.records) <= 6 else f"{len(fault.records)} records",
         clean(fault.channel.replace("_", " ")) or "–", clean(fault.seen, 600), clean(fault.done, 300),
         clean(fault.remedy, 200))
        for fault in discovery.faults
    ]  # fmt: skip
    header = ("fault", "records", "channel", "what is seen", "what was done", "what to do")
    text = ("A record is called faulty where all others disagree with it although there are tests on all sides of it, "
            "or a repeat; at an extreme of the conditions it may be physics, and stays. --keep-all leaves nothing out.")
    return Section("Faults of the data", [text], tables=[Table(header, rows)])


def _show_judgement(discovery: Discovery) -> Section:
    """How the verdict was reached: the test at each step, the noise, and what was assumed."""
    rows = [
        (name_step(discovery.steps, number, discovery.model), format_number(step.lack_of_fit.statistic),
         format_number(step.lack_of_fit.degrees), format_p(step.lack_of_fit.smooth_p_value),
         format_p(step.lack_of_fit.score_p_value), format_p(step.lack_of_fit.settings_p_value),
         format_p(step.lack_of_fit.p_value), f"{step.lack_of_fit.level:g}",
         "rejected" if step.lack_of_fit.rejected else "not rejected")
        for number, step in enumerate(discovery.steps)
    ]  # fmt: skip
    header = ("model", "χ² / dof, smooth part", "dof", "p of it", "p of the largest score", "p of the settings",
              "p that decides", "level", "verdict")  # fmt: skip
    tables = [Table(header, rows, "Lack of fit beyond noise and setting errors.")] if rows else []
    noise = []
    for channel, one in discovery.noise.items():
        shown = describe_quantity(channel)
        cells = [_scale(one.get(key), shown.scale) for key in ("stated_sd", "sd")]
        noise.append((shown.name, *cells, shown.unit, *(_scale(one.get(key), 1.0) for key in
                      ("correlation", "white_share")), clean(one.get("text", ""), 200)))  # fmt: skip
    if noise:
        header = ("channel", "stated sd", "sd used", "unit", "correlation", "white share", "how")
        tables.append(Table(header, noise, "Noise."))
    return Section("How the verdict was reached", _list_texts(discovery.steps), tables=tables,
                   points=list(discovery.notes))


def _list_texts(steps: Sequence[Step]) -> list[str]:
    """How lack of fit was judged, as sentences; those of steps that differ but in their numbers once, the first's."""
    texts: dict[str, str] = {}
    for step in steps:
        if step.lack_of_fit.text:
            texts.setdefault(re.sub(r"\d+", "", step.lack_of_fit.text), step.lack_of_fit.text)
    more = " (of the first model; the table has those of the others)" if len(steps) > 1 else ""
    return [re.sub(r"(degrees of freedom)", rf"\1{more}", text).rstrip(".") + "." for text in texts.values()]


def _scale(value, scale: float) -> str:
    return format_number(scale * float(value)) if isinstance(value, (int, float)) else "–"


def _begin(channel: str) -> str:
    """A channel's name at the start of a sentence."""
    name = describe_quantity(channel).name
    return name[:1].upper() + name[1:]
