"""Findings in words and in rows of tables, for a terminal; pages take the same words."""

import dataclasses as dc
import math
import textwrap
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from .._sentences import Sentence, say
from ..families import DEFAULT_FAMILY, View, find_family
from ..inference.findings import Fitted
from ..measurement import quantities as q
from ..measurement.units import format_time
from .result import Candidate, Estimate, Place, Step, Trace
from .settings import DEFAULT


WIDTH = 100  # columns of a terminal: tables are cut there
# Candidates that are always shown, and what others must explain to be shown too: less is noise to a reader.
FEWEST, NEAR = 5, 0.05
WHOLE = 0.995  # share from which a range is all there is, as it is printed to 1 %
MARGIN = 0.02  # of the longest record, by which a range may fall short of it and still be all of it: less than a bin
_PHASES = {"loading": " while loading", "unloading": " while unloading", "forward": " on strokes forward",
           "backward": " on strokes backward"}


def say_verdict(verdict: str) -> str:
    """A verdict in words."""
    return q.VERDICTS.get(verdict, q.clean(verdict))


def share_at_step(steps: Sequence[Step], effect: str) -> tuple[int, float] | None:
    """Step after the first at which an effect came in, and the share of the first misfit that this step removed."""
    for number, (before, step) in enumerate(zip(steps, steps[1:], strict=False), 1):
        if number > 1 and effect in step.effects and effect not in before.effects:
            first = steps[0].chi2_reduced - 1.0
            gain = before.chi2_reduced - step.chi2_reduced
            return number, max(gain / first, 0.0) if first > 0 else math.nan
    return None


def describe_place(place: Place, view: View) -> dict[str, Any]:
    """Facts of a place where a misfit sits, in the units of a view; a phase is named where there is another."""
    (low, high), timed, period = place.range, place.variable == "time", None
    shown = q.describe_quantity(place.variable, [low, high, *((view.longest,) if timed else ())])
    unit, counts = f" {shown.unit}" if shown.unit else "", place.variable == "sequence"
    number = (lambda value: f"{value:.0f}") if counts else q.format_number
    if place.period is not None and math.isfinite(place.period):
        period = format_time(place.period) if timed else f"{q.format_number(shown.scale * place.period)}{unit}"
    return {
        "channel": q.describe_quantity(place.channel).name,
        "variable": f"number of the {view.series}" if counts else shown.name,
        "low": number(shown.scale * low), "high": f"{number(shown.scale * high)}{unit}",
        "phase": _PHASES[place.phase] if place.phase in view.phases else "", "period": period,
        "share": place.share, "removes": place.removes, "direction": place.variable == "direction",
        "throughout": place.share >= WHOLE and timed and low <= MARGIN * view.longest
        and high >= (1.0 - MARGIN) * view.longest,
        "all": place.share >= WHOLE and place.removes is not None,
    }


def say_place(place: Place, view: View) -> Sentence:
    """Where a misfit sits, as a sentence of its own."""
    return say("words.place_alone", one=describe_place(place, view))


def show_estimate(estimate: Estimate | Fitted) -> tuple[str, str, str, str]:
    """Value, standard deviation and the ends of the 95 % interval, to the digits that count."""
    sd = estimate.sd
    if not estimate.determined:
        return q.format_number(estimate.estimate), "not determined", "–", "–"
    return (q.format_value(estimate.estimate, sd), q.format_value(sd, sd), q.format_value(estimate.q025, sd),
            q.format_value(estimate.q975, sd))


def list_alternatives(alternatives: Sequence[Mapping]) -> list[tuple[str, str, str, str]]:
    """Rows of a confusion set: effect, paired held-out difference, its standard error, and both as a ratio."""
    rows = []
    for item in alternatives:
        difference, error = (math.nan if item.get(key) is None else float(item[key])
                             for key in ("heldout_difference", "standard_error"))
        ratio = difference / error if math.isfinite(difference) and error > 0 else math.nan
        rows.append((q.clean(item.get("effect", "")), q.format_value(difference, error), q.format_value(error, error),
                     q.format_number(ratio, 2)))
    return rows


def choose_view(traces: Sequence[Trace] = (), family: str = DEFAULT_FAMILY) -> View:
    """The view of some traces; of the family alone where there are none."""
    found = find_family(traces[0].family if traces else family)
    view = dc.replace(found.view, along=traces[0].independent) if traces else found.view
    if found.view_reversed and any(np.any(np.asarray(trace.state_rate) < 0) for trace in traces):
        view = found.view_reversed
    ends = [float(np.nanmax(trace.time)) for trace in traces if np.size(trace.time)]
    return dc.replace(view, longest=max(ends)) if ends and view.along == "time" else view


def align(header: Sequence[str], rows: Sequence[Sequence[str]], sides: str) -> str:
    """A table as text: columns two spaces apart, `l`eft or `r`ight by `sides`, a rule below the header."""
    widths = [max(len(str(row[i])) for row in (header, *rows)) for i in range(len(header))]

    def line(cells) -> str:
        return "  ".join(str(cell).ljust(width) if side == "l" else str(cell).rjust(width)
                         for cell, width, side in zip(cells, widths, sides, strict=True)).rstrip()[:WIDTH]

    return "\n".join([line(header), "-" * min(sum(widths) + 2 * (len(widths) - 1), WIDTH), *map(line, rows)])


def format_steps(steps: Sequence[Step], model: str, noise: float) -> str:
    """One row a model of the loop: errors, noise floor, lack of fit; and of several under which noise they are."""
    rows = []
    for number, step in enumerate(steps):
        fit = step.lack_of_fit
        misfit = f"{'yes' if fit.rejected else 'no'} (p {q.format_p(fit.p_value)})"
        errors = map(q.format_error, (step.nrmse, step.heldout_nrmse, step.prediction_nrmse, noise))
        rows.append((q.name_step(steps, number, model), q.format_number(step.chi2_reduced), *errors, misfit,
                     "" if step.converged else "not converged"))
    header = ("model", "chi2/dof", "nrmse", "cross-val.", "predicted", "noise", "misfit left", "")
    shown = align(header, rows, "lrrrrrll") if rows else ""
    if len(rows) > 1:
        shown += "\nAll models are fitted, and their chi2/dof counted, under the noise measured beside the last one."
    return shown


def format_candidates(candidates: Sequence[Candidate], steps: Sequence[Step], effects: Sequence[str]) -> str:
    """The best candidates, and what could not be told from what was added."""
    shown = [one for i, one in enumerate(candidates) if i < FEWEST or one.explains >= NEAR or one.effect in effects]
    if len(candidates) - len(shown) == 1:  # a line about one more would be no shorter
        shown = list(candidates)
    rows = []
    for one in shown:
        later = share_at_step(steps, one.effect)  # what came in later has explained a share of its own step
        gain = ((q.format_share(one.explains, 1), q.format_p(one.p_value)) if later is None
                else (f"{q.format_share(later[1], 1)} at step {later[0]}", ""))
        rows.append((("* " if one.effect in effects else "  ") + q.clean(one.effect, 32), *gain,
                     q.format_small_share(one.visible), *map(q.format_error, (one.heldout_nrmse, one.prediction_nrmse)),
                     q.clean(", ".join(one.indistinguishable_from), 30)))
    lines = [align(("  candidate", "explains", "p", "visible", "cross-val.", "predicted", "similar to"), rows,
                   "lrrrrrl")]
    rest = [one for one in candidates if one not in shown]
    if rest:
        most = max(one.explains for one in rest)
        little = f"{q.format_share(most, 1)} or less" if most >= 5e-4 else "nothing"
        lines.append(f"  and {len(rest)} more that explain {little}: report.html and result.json list all")
    for step in steps:
        rows = list_alternatives(step.alternatives)
        for (effect, difference, error, _), item in zip(rows, step.alternatives, strict=True):
            beaten = DEFAULT.is_beaten(item["heldout_difference"], item["standard_error"])
            why = ("but it fits these records better, so neither is settled" if beaten else
                   "this campaign cannot distinguish them")
            lines.append(wrap(f"{effect} instead of {q.clean(step.added, 34)}: the cross-validated loss differs by "
                              f"{difference} +- {error}; {why}", "  "))
    return "\n".join(lines)


def wrap(text: str, indent: str = "") -> str:
    """A paragraph in lines of at most `WIDTH` columns."""
    return textwrap.fill(text, WIDTH, initial_indent=indent, subsequent_indent=indent, break_on_hyphens=False)
