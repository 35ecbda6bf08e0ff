"""Findings in words and in rows of tables, for a terminal; pages take the same words."""

import dataclasses as dc
import itertools
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
from .series import have_predictions
from .settings import DEFAULT


WIDTH, NARROWEST = 100, 16  # columns of a terminal, and of a column of words that makes room in it
# Candidates that are always shown, and what others must explain to be shown too: less is noise to a reader.
FEWEST, NEAR = 5, 0.05
WHOLE = 0.995  # share from which a range is all there is, as it is printed to 1 %
MARGIN = 0.1  # of the longest record, by which a range may fall short of it and still be all of it: about a bin
_PHASES = {"loading": " while loading", "unloading": " while unloading", "forward": " on strokes forward",
           "backward": " on strokes backward"}


def say_verdict(verdict: str) -> str:
    """A verdict in words."""
    return q.VERDICTS.get(verdict, q.clean(verdict))


def _share_at_step(steps: Sequence[Step], effect: str) -> tuple[int, float] | None:
    """Step after the first at which an effect came in, and the share of the first misfit that this step removed."""
    for number, (before, step) in enumerate(zip(steps, steps[1:], strict=False), 1):
        if number > 1 and effect in step.effects and effect not in before.effects:
            first = steps[0].chi2_reduced - 1.0
            gain = before.chi2_reduced - step.chi2_reduced
            return number, max(gain / first, 0.0) if first > 0 else math.nan
    return None


def format_explained(candidate: Candidate, steps: Sequence[Step]) -> str:
    """Share of the misfit that an effect explains at the first step, and at a later one where it came in there."""
    later = _share_at_step(steps, candidate.effect)
    alone = q.format_share(candidate.explains, 1)
    return alone if later is None else f"{alone}; step {later[0]}: {q.format_share(later[1], 1)}"


def describe_place(place: Place, view: View) -> dict[str, Any]:
    """Facts of a place where a misfit sits, in the units of a view; a phase is named where there is another."""
    (low, high), timed, period = place.range, place.variable == "time", None
    shown = q.describe_quantity(place.variable, [low, high, *((view.longest,) if timed else ())])
    unit, counts = f" {shown.unit}" if shown.unit else "", place.variable == "sequence"
    number = (lambda value: f"{value:.0f}") if counts else q.format_number
    first, last = number(shown.scale * low), number(shown.scale * high)
    if place.period is not None and math.isfinite(place.period):
        period = format_time(place.period) if timed else f"{q.format_number(shown.scale * place.period)}{unit}"
    return {
        "channel": q.describe_quantity(place.channel).name,
        "variable": f"number of the {view.series}" if counts else shown.name,
        "span": f"{first} to {last}{unit}" if first != last else f"{last}{unit}",
        "phase": _PHASES[place.phase] if place.phase in view.phases else "", "period": period,
        "share": place.share, "removes": place.removes, "direction": place.variable == "direction",
        "throughout": place.share >= WHOLE and timed and low <= MARGIN * view.longest
        and high >= (1.0 - MARGIN) * view.longest,
        "all": place.share >= WHOLE and place.removes is not None,
    }


def tells_nothing(one: Mapping[str, Any]) -> bool:
    """Whether a place, as `describe_place` has it, is the whole record, which is no finding."""
    return one["throughout"] and one["period"] is None and one["removes"] is None


def say_places(places: Sequence[Place], view: View) -> list[Sentence]:
    """Where a misfit sits, a sentence a place that says anything."""
    found = [describe_place(place, view) for place in places]
    return [say("words.place_alone", one=one) for one in found if not tells_nothing(one)]


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
    """A table as text: columns two spaces apart, `l`eft or `r`ight by `sides`, a rule below the header.

    Where it is wider than `WIDTH`, the widest of the columns to the left go on in further lines, so that none is cut.
    """
    cells = [[str(cell) for cell in row] for row in (header, *rows)]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    left = [i for i, side in enumerate(sides) if side == "l"]
    while sum(widths) + 2 * (len(widths) - 1) > WIDTH:
        widest = max(left, key=lambda i: widths[i], default=-1)
        if widest < 0 or widths[widest] <= NARROWEST:
            break
        widths[widest] -= 1

    def lay(row: Sequence[str]) -> list[str]:
        parts = [textwrap.wrap(cell, width, subsequent_indent="  " * (i == 0)) if len(cell) > width else [cell]
                 for i, (cell, width) in enumerate(zip(row, widths, strict=True))]
        return ["  ".join(part.ljust(width) if side == "l" else part.rjust(width)
                          for part, width, side in zip(line, widths, sides, strict=True)).rstrip()
                for line in itertools.zip_longest(*parts, fillvalue="")]

    head, *body = map(lay, cells)
    return "\n".join([*head, "-" * (sum(widths) + 2 * (len(widths) - 1)), *itertools.chain(*body)])


def format_steps(steps: Sequence[Step], model: str, noise: float) -> str:
    """One row a model of the loop: errors, noise floor, lack of fit; and of several under which noise they are."""
    rows, settled = [], have_predictions(steps)
    for number, step in enumerate(steps):
        fit = step.lack_of_fit
        misfit = f"{'yes' if fit.rejected else 'no'} (p {q.format_p(fit.p_value)})"
        errors = map(q.format_error, (step.nrmse, step.heldout_nrmse, *[step.prediction_nrmse] * settled, noise))
        rows.append((q.name_step(steps, number, model), q.format_number(step.chi2_reduced), *errors, misfit,
                     "" if step.converged else "not converged"))
    header = ("model", "chi2/dof", "nrmse", "cross-val.", *["predicted"] * settled, "noise", "misfit left", "")
    shown = align(header, rows, "l" + "r" * (len(header) - 3) + "ll") if rows else ""
    if len(rows) > 1:
        shown += "\nAll models are fitted, and their chi2/dof counted, under the noise measured beside the last one."
    return shown


def format_candidates(candidates: Sequence[Candidate], steps: Sequence[Step], effects: Sequence[str]) -> str:
    """The best candidates, and what could not be told from what was added."""
    shown = [one for i, one in enumerate(candidates) if i < FEWEST or one.explains >= NEAR or one.effect in effects]
    if len(candidates) - len(shown) == 1:  # a line about one more would be no shorter
        shown = list(candidates)
    rows, settled = [], have_predictions(candidates)
    for one in shown:
        rows.append((("* " if one.effect in effects else "  ") + q.clean(one.effect, 32),
                     format_explained(one, steps), q.format_small_share(one.visible),
                     q.format_error(one.heldout_nrmse), *[q.format_error(one.prediction_nrmse)] * settled,
                     format_behind(one), q.clean(", ".join(one.indistinguishable_from), 120)))
    header = ("  candidate", "explains", "visible", "cross-val.", *["predicted"] * settled, "behind", "imitated by")
    lines = [align(header, rows, "l" + "r" * (4 + settled) + "l")]
    rest = [one for one in candidates if one not in shown]
    if rest:
        most = max(one.explains for one in rest)
        little = f"{q.format_share(most, 1)} or less" if most >= 5e-4 else "nothing"
        lines.append(f"  and {len(rest)} more that explain {little}: report.html and result.json list all")
    lines.append("  Behind: excess of the cross-validated loss over the best one, with its error [noise variances].")
    for step in steps:
        rows = list_alternatives(step.alternatives)
        for (effect, difference, error, _), item in zip(rows, step.alternatives, strict=True):
            beaten = DEFAULT.is_beaten(item["heldout_difference"], item["standard_error"])
            why = ("but it fits these records better, so neither is settled" if beaten else
                   "this campaign cannot distinguish them")
            lines.append(wrap(f"{effect} instead of {q.clean(step.added, 34)}: the cross-validated loss differs by "
                              f"{difference} +- {error}; {why}", "  "))
    return "\n".join(lines)


def format_behind(one: Candidate) -> str:
    """By how much a candidate's cross-validated loss exceeds the best one's [noise variances], with its error."""
    error = one.standard_error
    return "–" if one.heldout_difference == 0 else (
        f"{q.format_value(one.heldout_difference, error)} ± {q.format_value(error, error)}")


def wrap(text: str, indent: str = "") -> str:
    """A paragraph in lines of at most `WIDTH` columns."""
    return textwrap.fill(text, WIDTH, initial_indent=indent, subsequent_indent=indent, break_on_hyphens=False)
