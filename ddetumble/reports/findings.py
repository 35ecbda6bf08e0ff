"""The reports of a discovery, of a comparison and of a missing force, one page each, of sections that they share."""

import dataclasses as dc
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from .. import figures
from .._sentences import tell
from ..families import DEFAULT_FAMILY, View, find_family
from ..figures.traces import are_values, find_span, find_stretch, list_varying, standardise
from ..measurement import quantities as q
from ..selection.compare import Comparison, Comparisons
from ..selection.discovery import Discovery
from ..selection.preview import Preview, preview_effects
from ..selection.result import MissingForce, Place, SettingShift, Step, Trace
from ..selection.series import have_predictions, list_channels, relies_on_settings
from ..selection.text import (
    choose_view,
    format_behind,
    format_explained,
    list_alternatives,
    say_places,
    say_verdict,
    show_estimate,
)
from .page import Picture, Section, Table, draw_picture, flatten, follower, pause_collection, write_page
from .sliders import show_sliders


@pause_collection()
def write_report(discovery: Discovery, folder) -> Path:
    """Write what `discover` returned as one self-contained page, and its figures, into a folder, refused where it
    cannot be written; returns its path.
    """
    records = len({trace.record for step in discovery.steps[-1:] for trace in step.traces})
    level, name = discovery.settings.level, q.clean(discovery.campaign, 60)
    status = [
        name if name.lower().startswith("campaign") else f"campaign {name}",
        q.clean(discovery.title, 120) if discovery.title != discovery.campaign else "",
        f"{records} records" if records != 1 else "1 record",
        f"reference model {q.clean(discovery.model, 60)}",
        f"judged at the {q.format_share(float(level))} level" if isinstance(level, (int, float)) else "",
    ]
    verdict = say_verdict(discovery.verdict)
    return write_page(f"{verdict}: {discovery.campaign}", discovery.sentence, _build_sections(discovery), folder,
                      verdict=discovery.verdict, badge=verdict, status=status, facts=_list_facts(discovery))


def _list_facts(discovery: Discovery) -> list[tuple[str, str, str]]:
    """The numbers that a reader wants first: what, value, remark."""
    if not discovery.steps:
        return []
    first, last = discovery.steps[0], discovery.steps[-1]

    def compare(name: str, show=q.format_error) -> str:
        ends = (first, last) if len(discovery.steps) > 1 else (first,)
        return " → ".join(show(getattr(step, name)) for step in ends)

    floor, moved = f"noise floor {q.format_error(discovery.noise_nrmse)}", relies_on_settings(discovery.steps)
    # Where settings were moved to do the work of physics, it is the predictions from those as written that get better.
    facts = [("prediction, settings as written", compare("prediction_nrmse"), floor) if moved else
             ("error of the fit", compare("nrmse"), floor)]
    if math.isfinite(first.heldout_nrmse):
        what = find_family(discovery.family).folds
        facts.append(("cross-validated error", compare("heldout_nrmse"), f"on left-out {what}"))
    facts.append(("χ² per degree of freedom", compare("chi2_reduced", q.format_number),
                  "1 if only noise is left; shifts of settings count" if moved else "1 if only noise is left"))
    fit = last.lack_of_fit
    # Of a verdict that calls the model complete, what is left was found to be no force of any variable.
    left = "noise or settings" if discovery.verdict == "explained" else "yes"
    facts.append(("misfit left", left if fit.rejected else "none detected", q.say_p(fit.p_value)))
    return facts


def _build_sections(discovery: Discovery) -> list[Section]:
    """The parts of the page, in the order in which a reader asks for them."""
    if not (discovery.candidates and discovery.made[0]):  # one that was put together by hand has no fits
        return _arrange_sections(discovery)
    with ThreadPoolExecutor(1) as pool:  # what the sliders need is computed while figures are made
        return _arrange_sections(discovery, pool.submit(
            lambda: preview_effects(discovery.fits[0], discovery.candidates)))


def _arrange_sections(discovery: Discovery, preview: Future[Preview | None] | None = None) -> list[Section]:
    sections, models = [], {}
    if discovery.steps:
        models = {"reference model": discovery.steps[0]}
        if len(discovery.steps) > 1:  # the grown model in a few words: `with adhesion and gas-leak`
            effects = [q.clean(effect, 40) for effect in discovery.effects]
            models[f"with {q.join_words(effects)}" if effects else ""] = discovery.steps[-1]
        traces = {label: step.traces for label, step in models.items()}
        names = [q.name_step(discovery.steps, number, discovery.model) for number in range(len(discovery.steps))]
        sections.append(show_errors(
            [(name,) for name in names], discovery.steps, [discovery.noise_nrmse] * len(names), q.name_steps(discovery),
            ["yes" if step.converged else "no" for step in discovery.steps]))
        if discovery.faults:
            sections.append(_show_faults(discovery))
        if any(traces.values()):
            sections += [show_fits(traces), show_failures(traces, discovery.noise, discovery.where)]
            if all(step.shifts for step in models.values()):
                sections.append(show_shifts({label: step.shifts for label, step in models.items()}))
        elif discovery.where:
            view = choose_view(family=discovery.family)
            sections.append(Section("Where the model fails", points=say_places(discovery.where, view)))
    if discovery.missing is not None:
        sections += show_missing(discovery.missing)
    if discovery.made[0] and (laws := _list_laws(discovery)):
        sections.append(Section("Laws of the effects named", tables=[Table(("effect", "law", "source"), laws)]))
    if discovery.candidates:
        sections.append(_show_ranking(discovery))
    place = len(sections)  # of the sliders
    if discovery.steps and discovery.steps[-1].parameters:
        strong = [item for item in discovery.steps[-1].correlations if abs(item[2]) > 0.95]
        sections.append(show_parameters(models, [
            f"{q.clean(a)} and {q.clean(b)} have a correlation of {value:+.3f}: the data determine a combination of "
            "them far better than either." for a, b, value in strong]))
    sections += [_show_judgement(discovery), _show_next(discovery)]
    rows = [("campaign", q.clean(discovery.campaign)), ("title", q.clean(discovery.title)),
            ("family", discovery.family), ("SHA-256 of the campaign", discovery.sha256),
            ("reference model", q.clean(discovery.model)),
            ("verdict", discovery.verdict),
            *flatten({**discovery.counts, "thresholds": dc.asdict(discovery.settings)})]
    sections.append(Section("Provenance", tables=[Table(("item", "value"), rows)]))
    if preview is not None:
        follower.get()("drawing the page: sliders", math.nan)
    moved = None if preview is None else preview.result()
    if moved is not None:
        sections.insert(place, show_sliders(moved))
    return sections


def _list_laws(discovery: Discovery) -> list[tuple[str, str, str]]:
    """Id, law and source of every effect of the model, of those that could not be told from them, and of those between
    which the verdict leaves open."""
    named = [*discovery.effects, *(row[0] for step in discovery.steps for row in list_alternatives(step.alternatives)),
             *(effect for one in discovery.explanations for effect in one.effects)]
    laws = {effect.id: (effect.law, effect.reference) for effect in discovery.best.problem.space.effects}
    return [(q.clean(name), q.clean(laws[name][0], 300), q.clean(laws[name][1], 300))
            for name in dict.fromkeys(named) if name in laws]


def show_errors(labels: Sequence[tuple], steps: Sequence[Step | Comparison], floors: Sequence[float],
                names: Sequence[str], converged: Sequence[str] = ()) -> Section:
    """Error by model, drawn and as a table: labels are the first cells of every row (the model's name, and of a
    comparison its free parameters), floors of the noise one a model, names of the models in the figure, and `converged`
    the last cells; none for a comparison.
    """
    settled = have_predictions(steps)
    rows = [(*label, q.format_number(step.chi2_reduced), q.format_error(step.nrmse), q.format_error(step.heldout_nrmse),
             *[q.format_error(step.prediction_nrmse)] * settled, q.format_share(step.prediction_coverage),
             q.format_error(floor),
             "yes" if step.lack_of_fit.rejected else "no", *converged[k : k + 1])
            for k, (label, step, floor) in enumerate(zip(labels, steps, floors, strict=True))]
    header = ("model", *(("free",) if len(labels[0]) > 1 else ()), "χ² / dof", "error", "cross-validated",
              *["prediction"] * settled, "coverage", "noise floor", "misfit left",
              *(("converged",) if converged else ()))
    family = find_family(steps[0].traces[0].family if steps[0].traces else DEFAULT_FAMILY)
    adjusted = (", with its own settings adjusted within their stated uncertainty. Prediction: the same with the "
                "settings as they are written down; c" if settled else ". C")
    table = Table(header, rows, (
        f"Cross-validated: each {family.folds.removesuffix('s')} is predicted by the model fitted without it{adjusted}"
        "overage is the share of samples within the predicted 95 % interval."))
    loop = ", for every model of the loop" if converged else ""
    diamonds = (" Diamonds: predictions from the settings as they are written down, where moved settings did the work "
                "of physics in a fit.") if relies_on_settings(steps) else ""
    picture = draw_picture(
        "error-by-step", f"Root mean square of the residual over that of the signal{loop}: for all records, and for "
        f"{family.folds} left out one after the other. The noise floor is the error of a perfect model." + diamonds,
        figures.draw_error_by_step, steps, names, min(floors),
        alt=f"Error of {len(steps)} models against the noise floor of {q.format_error(min(floors))}.")
    return Section("The error, step by step", figures=[picture], tables=[table])


def show_fits(models: Mapping[str, Sequence[Trace]]) -> Section:
    """Model against measurement, every channel."""
    first = next(iter(models.values()))
    view, pictures = choose_view(first), []
    for i, channel in enumerate(list_channels(first)):
        if are_values(first):
            caption = (f"{_begin(channel)} of each record, measured and modelled; below, the residual in units of the "
                       "noise.")
            pictures.append(draw_picture(f"values-{channel}", caption, figures.draw_values, models, channel))
            continue
        spread = " spread over the conditions" if list_varying(first) else ""
        caption = (f"{_begin(channel)} of records{spread}: measured (dots) and modelled (lines). Below each, measured "
                   "minus model in units of the noise, single samples faint and their running mean as a line.")
        if any(find_stretch(trace) != find_span(trace) for trace in first if trace.channel == channel):
            caption += " For records with too many turns to be resolved, only the end is drawn."
        alt = (f"{_begin(channel)} over {view.along} for up to eight records with {' and '.join(models)}, and their "
               "residuals.")
        pictures.append(Picture(f"fit-{channel}", caption, figures.draw_fit(models, channel, count=4 if i else 8), alt,
                                figures.draw_fit(models, channel, count=2, narrow=True)))
    return Section("Model against measurement", figures=pictures)


def show_failures(models: Mapping[str, Sequence[Trace]], noise: Mapping | None = None,
                  where: Sequence[Place] | None = None) -> Section:
    """Where the residuals sit, and what they depend on; `where` is None where nobody looked for places."""
    first = next(iter(models.values()))
    view, channels, pictures = choose_view(first), list_channels(first), []
    order = " in the order of its conditions" if list_varying(first) else ""
    settings = ", or a wrong setting in one record" if list_varying(first) else ""
    conditions = " and condition" if list_varying(first) else ""
    cell = "at each condition, repeats pooled" if list_varying(first) else "of each record"
    if not are_values(first):  # residuals of values are all seen beside the measurements
        pictures.append(draw_picture(
            "residual-map", f"Mean residual over the noise, one row per record{order}. Stripes that many rows share "
            f"suggest physics; scattered colour is noise{settings}.",
            figures.draw_residual_map, models, alt=f"Heat map of the residuals by record and {view.share}."))
        pictures.append(draw_picture(
            "record-errors", f"Root mean square of the residual over the noise {cell}. 1 is as good as a model can be.",
            figures.draw_record_errors, models,
            alt="Grid of the error over the noise by condition or record."))
        apart = f"{view.apart} apart, " if view.phases else ""
        for channel in channels:
            pictures.append(draw_picture(
                f"dependence-{channel}", f"{_begin(channel)}: mean residual against state{conditions}, {apart}with "
                "two standard errors from the scatter between records.",
                figures.draw_dependence, models, channel, (noise or {}).get(channel), where or (),
                alt=f"Mean residual of the {q.describe_quantity(channel).name} against state and conditions."))
        if view.force in channels:
            pictures.append(_show_missing(models, view))
    points = [] if where is None else say_places(where, view) or ["The misfit is concentrated nowhere in particular."]
    return Section("Where the model fails" if where else "Where the residuals sit", points=points, figures=pictures)


def _show_missing(models: Mapping[str, Sequence[Trace]], view: View) -> Picture:
    """The force that is missing, over what a misfit is located in; of two forces the one that is missed more."""
    first = next(iter(models.values()))

    def miss(channel: str) -> float:
        own = [np.nan_to_num(standardise(trace)) ** 2 for trace in first if trace.channel == channel]
        return float(np.mean(np.concatenate(own)))

    forces = [c for c in ("normal_force", "tangential_force") if any(trace.channel == c for trace in first)]
    channel = max(forces, key=miss) if len(forces) > 1 else view.force
    state = q.describe_quantity(view.state).name
    word = "force" if forces == ["normal_force"] else q.describe_quantity(channel).name
    caption = (f"The {word} that the model leaves unexplained over the {state}: the shape of what is missing. Records "
               "whose lines fall together share a cause that does not depend on the condition.")
    if "backward" in view.phases:
        caption += " On a backward stroke the friction is negative, and so is friction that is missing."
    return draw_picture("missing-force", caption, figures.draw_missing_force, models, channel,
                        alt=f"Measured minus modelled {word} against {state}.")


def show_shifts(models: Mapping[str, Sequence[SettingShift]]) -> Section:
    """How far the settings of the records were moved, against what is stated."""
    rows = []
    for label, shifts in models.items():
        for shift in shifts:
            shown = q.describe_quantity(shift.name)
            rows.append((q.clean(label), "time origin" if shift.name == "time" else shown.name,
                         f"{q.format_number(shift.stated * shown.scale)} {shown.unit}", q.format_number(shift.rms, 2),
                         f"{shift.largest:+.2g}", q.clean(shift.record), q.format_p(shift.p_value)))
    header = ("model", "setting", "stated sd", "rms shift / sd", "largest shift / sd", "record", "p")
    if len(models) == 1:
        header, rows = header[1:], [row[1:] for row in rows]
    picture = draw_picture(
        "settings", "The settings of every record may shift from what was written down, with a penalty set by their "
        "stated uncertainty. Shifts far beyond two standard deviations mean that the model fails and the settings "
        "compensate for it, or that the settings scatter more than stated.", figures.draw_shifts, models,
        alt="Shift of every setting in every record, in stated deviations.")
    return Section("Shifts of the settings", figures=[picture], tables=[Table(header, rows)])


def show_parameters(models: Mapping[str, Any], points: Iterable[str]) -> Section:
    """Parameters of the last of some fits or steps with their intervals, and the strongest correlations."""
    rows = [
        (q.clean(key), *show_estimate(one),
         "–" if one.unit in ("", "1") else q.clean(one.unit), q.clean(one.text, 160))
        for key, one in list(models.values())[-1].parameters.items()]
    header = ("parameter", "estimate", "sd", "2.5 %", "97.5 %", "unit", "")
    if not any(row[-1] for row in rows):
        header, rows = header[:-1], [row[:-1] for row in rows]
    caption = "Estimates with their 95 % intervals, each on its own scale, and the strongest correlations."
    if len(models) > 1:
        caption += " Where the intervals of the two models differ, the missing physics had biased the parameter."
    pictures = [draw_picture("parameters", caption, figures.draw_parameters, models,
                             alt=f"Intervals of {len(rows)} parameters.")] if rows else []
    return Section("Parameters", figures=pictures, tables=[Table(header, rows)], points=list(points))


def _format_size(value: float) -> str:
    """A smallest detectable amplitude; with more digits where it is next to 1, the null of gains and exponents."""
    away = abs(value - 1.0)
    return q.format_number(value, 3 if away == 0.0 or away > 0.05 else 2 - math.floor(math.log10(away)))


def _show_ranking(discovery: Discovery) -> Section:
    rows, settled = [], have_predictions(discovery.candidates)
    for one in discovery.candidates:
        sizes = [f"{q.clean(key.removeprefix(f'{one.effect}.'))} {_format_size(value)} "
                 f"{q.clean(one.units.get(key, ''), 16)}".rstrip() for key, value in one.smallest_detectable.items()]
        rows.append((q.clean(one.effect), format_explained(one, discovery.steps), q.format_p(one.p_value),
                     q.format_small_share(one.visible), q.format_error(one.heldout_nrmse),
                     *[q.format_error(one.prediction_nrmse)] * settled, format_behind(one), ", ".join(sizes) or "–",
                     ", ".join(map(q.clean, one.indistinguishable_from)) or "–"))
    header = ("effect", "explains", "p", "visible", "cross-validated", *["prediction"] * settled,
              "behind the best, cross-validated [noise variances]", "smallest detectable", "imitated by")
    free = "initial rates" if find_family(discovery.family).free_running else "settings"
    marked = frozenset(i for i, one in enumerate(discovery.candidates) if one.effect in discovery.effects)
    tables = [Table(header, rows, "All effects of the catalogue, each alone beside the reference model, as they stood "
                    "at the first step; the bars show the same. Imitated by: effects whose signatures are alike there.",
                    marked)]
    paragraphs = [
        "Explains: the share of the misfit above noise that the effect alone explains after a refit; of an effect that "
        "came in at a later step also the share that this step explained. Visible: the share of its own signature that "
        f"is left when {choose_view(family=discovery.family).free} and the records' {free} are free to imitate it; "
        f"below {100 * discovery.settings.invisible:g} % this campaign cannot detect it. A strong effect is seen by "
        "a small share, too: from its smallest detectable size on."]
    for number, (before, step) in enumerate(zip(discovery.steps, discovery.steps[1:], strict=False), 1):
        gone, came = ([q.clean(name) for name in one.effects if name not in other.effects]
                      for one, other in ((before, step), (step, before)))
        if gone:
            paragraphs.append(f"Step {number} took {q.join_words(gone)} back and brought {q.join_words(came)} in: this "
                              "predicts left-out records better. The first effect of several is chosen while the "
                              "others are still missing, and may be one that imitates them together."
                              if came else f"Step {number} took {q.join_words(gone)} back as needless.")
    kin = [(q.clean(step.added), *row) for step in discovery.steps if step.added
           for row in list_alternatives(step.alternatives)]
    if kin:
        header = ("added", "alternative", "paired held-out difference", "standard error", "ratio")
        tables.append(Table(header, kin, "Confusion sets: effects that this campaign cannot distinguish from the one "
                            "added at that step."))
    if discovery.explanations:
        rows_open = [(", ".join(map(q.clean, one.effects)) or "none", "–" if one.setting is None else
                      f"{q.describe_quantity(one.setting).name} reads {100 * abs(one.bias):.2g} % ± {100 * one.sd:.1g} "
                      f"% too {'high' if one.bias > 0 else 'low'}") for one in discovery.explanations]
        tables.append(Table(("effects", "error that all records share"), rows_open,
                            "Models between which these tests cannot decide."))
    elif not kin and discovery.effects:
        paragraphs.append("Nothing is confounded in the end: no other effect that was tried, put in the place of one "
                          "that was added, predicts left-out records as well.")
    best = discovery.candidates[0]
    picture = draw_picture(
        "ranking", "Bars: share of the misfit that each effect explains. Diamonds: visible share of each effect's "
        "signature.", figures.draw_ranking, discovery.candidates, discovery.effects, None,
        discovery.settings.invisible,
        alt=f"Bars of {len(rows)} effects; the first, {q.clean(best.effect)}, explains "
            f"{q.format_share(best.explains)}.")
    title = "Which effect is missing" if discovery.effects else "The catalogue, ranked"
    return Section(title, paragraphs, [picture], tables)


def _show_faults(discovery: Discovery) -> Section:
    """What is wrong with the data themselves, and what was done about it."""
    rows = [
        (fault.kind,
         q.clean(", ".join(fault.records), 120) if len(fault.records) <= 6 else f"{len(fault.records)} records",
         q.clean(fault.channel.replace("_", " ")) or "–", q.clean(fault.seen, 600), q.clean(fault.done, 300),
         q.clean(fault.remedy, 200))
        for fault in discovery.faults
    ]
    header = ("fault", "records", "channel", "what is seen", "what was done", "what to do")
    text = ("A record is called faulty if all others disagree with it although there are tests on all sides of it, or "
            "a repeat; at an extreme of the conditions the cause may be physics, and the record is kept, unless a "
            "known ratio of units explains it. --keep-all leaves nothing out.")
    return Section("Faults of the data", [text], tables=[Table(header, rows)])


def _show_judgement(discovery: Discovery) -> Section:
    """How the verdict was reached: the test at each step, the noise, and what was assumed."""
    rows, settled = [], any(step.shifts for step in discovery.steps)
    for number, step in enumerate(discovery.steps):
        fit = step.lack_of_fit
        rows.append((q.name_step(discovery.steps, number, discovery.model), q.format_number(fit.statistic),
                     q.format_number(fit.degrees), q.format_p(fit.smooth_p_value), q.format_p(fit.score_p_value),
                     *[q.format_p(fit.settings_p_value)] * settled, q.format_p(fit.p_value), f"{fit.level:g}",
                     "rejected" if fit.rejected else "not rejected"))
    header = ("model", "χ² / dof, smooth part", "dof", "its p-value", "p of the largest score",
              *["p of the settings"] * settled, "decisive p", "level", "verdict")
    tables = [Table(header, rows, "Tests for lack of fit beyond noise and setting errors.")] if rows else []
    noise = []
    for channel, one in discovery.noise.items():
        shown = q.describe_quantity(channel)
        stated, sd, *rest = (
            q.format_number(scale * float(one[key])) if isinstance(one.get(key), (int, float)) else "–"
            for key, scale in (("stated_sd", shown.scale), ("sd", shown.scale), ("correlation", 1), ("white_share", 1)))
        noise.append((shown.name, stated, sd, shown.unit, *rest, q.clean(one.get("text", ""), 200)))
    if noise:
        header = ("channel", "stated sd", "sd used", "unit", "correlation", "white share", "how")
        tables.append(Table(header, noise, "Noise."))
    # Sentences of steps that differ but in their numbers once, the first's.
    texts: dict[str, str] = {}
    for step in discovery.steps:
        if step.lack_of_fit.text:
            texts.setdefault(re.sub(r"\d+", "", step.lack_of_fit.text), step.lack_of_fit.text)
    paragraphs = [text.rstrip(".") + "." for text in texts.values()]
    if len(discovery.steps) > 1:
        paragraphs.append("The numbers in this text are those of the first model that it holds for; the table has "
                          "those of every model.")
    pictures = []
    if discovery.steps and any(one.get("varies") for one in discovery.noise.values()):
        pictures.append(draw_picture(
            "noise-size", "Size of the noise against the reading. Correlated noise lies below the line that the fit "
            "takes, as it moves little from sample to sample.", figures.draw_noise_sizes,
            discovery.steps[-1].traces, discovery.noise, alt="Size of the noise against the reading, by channel."))
    return Section("How the verdict was reached", paragraphs, pictures, tables, list(discovery.notes))


def _show_next(discovery: Discovery) -> Section:
    """Commands that go on from the verdict."""
    rivals = max(len(discovery.explanations), 1 + len(discovery.rivals))
    return Section("What next", points=tell(
        "verdict.next", verdict=discovery.verdict, rivals=rivals if rivals > 1 else 0,
        effects=list(map(q.clean, discovery.effects)), plans=find_family(discovery.family).has_contact,
        more=discovery.more_effort, model=q.clean(discovery.model)))


def _begin(channel: str) -> str:
    """A channel's name at the start of a sentence."""
    name = q.describe_quantity(channel).name
    return name[:1].upper() + name[1:]


def _count(value: float) -> str:
    return f"{value:g}" if np.isfinite(value) else "–"


# Columns of the errors in words, and how they are shown; residuals are in the channel's unit, named with it.
_COLUMNS: dict[str, tuple[str, Callable[[Any], str]]] = {
    "ratio": ("rms / noise", q.format_number), "nrmse": ("rms / signal", q.format_error),
    "samples": ("samples", _count), "records": ("records", _count), "record": ("record", q.clean),
    "sequence": ("position in the series", _count), "chi2_reduced": ("χ² per sample", q.format_number),
    "channel": ("channel", lambda name: q.describe_quantity(name).name),
}  # fmt: skip
_RESIDUALS = {"rms": "rms residual", "bias": "mean residual"}


@pause_collection()
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
    models = {q.clean(label, 60): traces for label, traces in shown.items()}
    sections += [show_fits(models), show_failures(models, one.noise, where)]
    sections += [tabulate_refitted(one)] if one.parameters else []
    sections += [show_shifts({one.model: one.shifts})] if one.shifts else []
    sections.append(tabulate_errors(one))
    notes = dict.fromkeys(note for each in ([found] if isinstance(found, Comparison) else found) for note in each.notes)
    if notes:
        sections.append(Section("Notes", points=[q.clean(note, 400) for note in notes]))
    return write_page(f"{one.campaign} and {what}", sentence, sections, folder, "comparison.html",
                      status=[q.clean(one.campaign, 120), f"{len(one.records)} records"])


def _show_signatures(found: Comparisons) -> Section:
    """What each model changes of the first one's prediction, beside what that one leaves."""
    models = {q.clean(name, 60): one.traces for name, one in zip(found.names, found, strict=True)}
    channel = found[0].traces[0].channel
    first = q.clean(found.names[0])
    picture = draw_picture(
        "signatures",
        f"Dots: measured minus {first}, {q.describe_quantity(channel).name}, single samples faint. Lines: "
        "the change that each other model makes to its prediction after the fit. An effect that is missing follows "
        "the dots.",
        figures.draw_signatures, models, channel,
        alt=f"Residual of {first} and the change that {len(found) - 1} models make to it, where it is largest.")
    return Section("Why an effect fits", figures=[picture])


def tabulate_errors(result: Comparison) -> Section:
    """Errors by channel, condition and record as a part of a page, every column with its unit."""
    units = {str(row["channel"]): str(row["unit"]) for _, row in result.channels.iterrows()}
    tables = [_tabulate(result.channels.drop(columns="unit"), units, "By channel.")]
    if result.names_conditions:
        tables.append(_tabulate(result.conditions, units,
                                "By condition; each row is the mean over tests with equal settings."))
    tables.append(_tabulate(result.records, units, "By record."))
    text = "Rms / noise is the RMS residual over the standard deviation of the noise: 1 is as good as a model can be."
    followed = [] if result.sequential is None else [str(result.sequential)]
    return Section("Errors", [text, *followed], tables=tables)


def tabulate_refitted(result: Comparison) -> Section:
    """Parameters that a comparison refitted, with their 95 % intervals, as a part of a page."""
    rows = [(q.clean(name), *show_estimate(one), "–" if one.unit in ("", "1") else q.clean(one.unit))
            for name, one in result.parameters.items()]
    header = ("parameter", "estimate", "sd", "2.5 %", "97.5 %", "unit")
    return Section("Parameters", tables=[Table(header, rows)])


def _tabulate(frame: pd.DataFrame, units: Mapping[str, str], caption: str) -> Table:
    """A table of errors with headings in words; `units` are those of the channels, SI."""
    shown = {channel: q.describe_quantity(channel, unit=unit) for channel, unit in units.items()}
    first, several = next(iter(shown.values())), len({one.unit for one in shown.values()}) > 1
    header, columns = [], []
    for name in map(str, frame.columns):
        values = list(frame[name])
        if name in _RESIDUALS:
            header.append(_RESIDUALS[name] + ("" if several else f" [{first.unit}]"))
            own = [shown[str(one)] for one in frame["channel"]] if "channel" in frame else [first] * len(values)
            columns.append([f"{q.format_number(one.scale * float(value))} {one.unit if several else ''}".rstrip()
                            for one, value in zip(own, values, strict=True)])
        elif name.startswith("ratio_"):
            header.append(f"rms / noise, {q.describe_quantity(name.removeprefix('ratio_')).name}")
            columns.append([q.format_number(float(value)) for value in values])
        elif name in _COLUMNS:
            heading, show = _COLUMNS[name]
            header.append(heading)
            columns.append(list(map(show, values)))
        else:
            setting = q.describe_quantity(name, np.asarray(values, float))
            header.append(setting.label)
            columns.append([setting.format(float(value)) for value in values])
    return Table(header, list(zip(*columns, strict=True)), caption)


def write_missing(missing: MissingForce, folder, *, title: str, status: Sequence[str] = ()) -> Path:
    """Write what `draw_missing_force` returned as one self-contained page into a folder, refused where it cannot be
    written; `title` and `status` as of `write_page`.
    """
    return write_page(title, missing.sentence, show_missing(missing, sentence=False), folder, "missing.html",
                      status=status)


def show_missing(missing: MissingForce, sentence: bool = True) -> list[Section]:
    """The sections of a missing force; `sentence` repeats its sentence where the page has another."""
    paragraphs = [missing.sentence] if sentence else []
    if not missing.shapes:
        return [Section("The missing force", paragraphs, points=missing.notes)]
    best = missing.shapes[0]
    spectrum = (", and the spectrum of the force (grey: two standard deviations of the noise)"
                if best.spectrum.shape[1] > 2 else "")
    pictures = [draw_picture(
        "missing-shape", "The missing force, fitted inside the equation of motion, with ± two posterior standard "
        "deviations, a simple law that describes it (dashed, where it holds for the same values of the model's "
        "parameters), and below, in grey, the density of the samples. Beside it: the share of the misfit of left-out "
        f"conditions that each explains{spectrum}.", figures.draw_missing_shape, missing,
        alt=f"Missing {q.clean(best.way)} over {q.clean(best.variable)}.")]
    if len(missing.shapes) > 1:
        pictures.append(draw_picture(
            "missing-rivals", "The same over the other variables that came close, each fitted alone, with the "
            "difference from the best in noise variances of left-out conditions.", figures.draw_missing_rivals,
            missing))
    rows = []
    for shape in missing.shapes:
        shown, error = q.describe_quantity(shape.variable, shape.x), shape.standard_error
        parts = f", {' and '.join(shape.parts)}" if shape.parts[0] else ""
        rows.append((
            q.clean(f"{shape.way} over {shape.variable}{parts}"), shape.intervals,
            q.format_share(missing.share(shape.loss)), "–" if shape.difference == 0 else
            f"{q.format_value(shape.difference, error)} ± {q.format_value(error, error)}",
            q.format_small_share(shape.visible),
            "–" if shape.begins is None else f"{q.format_number(shown.scale * shape.begins)} {shown.unit}".rstrip()))
    tables = [Table(
        ("force", "knots", "misfit explained", "difference from the best", "visible", "differs from zero from"), rows,
        "Non-parametric forces of one variable; differences are in noise variances of left-out conditions. Visible: "
        "the share of the force's own signature that the model's parameters and the settings cannot imitate.")]
    rows = []
    for k, law in enumerate(missing.laws):
        values = "; ".join(f"{n} = {q.format_value(e.estimate, e.sd)} ± {q.format_value(e.sd, e.sd)} {e.unit}".rstrip()
                           for n, e in law.parameters.items())
        behind = (f"{q.format_number(law.difference)} ± {q.format_number(law.standard_error)}",
                  q.format_number(law.chi2 - missing.laws[0].chi2)) if k else ("–", "–")
        rows.append((q.clean(law.text), q.clean(values, 300), "–" if missing.lone else
                     q.format_share(missing.share(law.loss)), *behind, "yes" if law.converged else "no"))
    if rows:
        tables.append(Table(
            ("simple law", "parameters (SI)", "misfit explained", "difference from the first", "fits worse by",
             "converged"),
            rows, "Laws that would describe it, fitted inside the equation of motion; differences are in noise "
            "variances. Of the laws that left-out conditions do not distinguish, the one that fits best comes first; "
            f"each parameter costs {missing.settings.significant:g}."))
    return [Section("The missing force", paragraphs, pictures, tables, missing.notes)]
