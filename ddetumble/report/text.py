"""What was found, as text for a terminal."""

import textwrap
from collections.abc import Sequence

from ..figures.labels import clean, format_error, format_number, format_p, format_share, name_step
from ..figures.views import choose_view
from ..selection.result import Candidate, Discovery
from ..selection.settings import DEFAULT
from .words import (
    count_records,
    list_alternatives,
    say_place,
    say_verdict,
    share_at_step,
    show_estimate,
)


WIDTH = 100
FEWEST, NEAR = 5, 0.05  # candidates that are always shown, and what others must explain to be shown too


def describe(discovery: Discovery) -> str:
    """The findings in at most 100 columns: the sentence, the steps, the best candidates, parameters, and where.

    Args:
        discovery: what `discover` returned.

    Returns:
        Text of several lines, without control characters and without a line break at its end.
    """
    head = f"[{say_verdict(discovery.verdict)}] {clean(discovery.campaign, 40)}, {count_records(discovery)} records, "
    parts = [_wrap(clean(discovery.sentence, 4000)), _wrap(head + f"reference model {clean(discovery.model, 30)}")]
    parts.append(_show_steps(discovery))
    if discovery.candidates:
        parts.append(_show_candidates(discovery))
    if discovery.steps and discovery.steps[-1].parameters:
        rows = []
        for name, one in discovery.steps[-1].parameters.items():
            value, sd, low, high = show_estimate(one)
            rows.append((clean(name, 40), f"{value} +- {sd}", f"[{low}, {high}]", clean(one.unit, 16)))
        parts.append(align(("parameter", "estimate", "95 % interval", ""), rows, "l" * 4))
    if discovery.where:
        view = choose_view([trace for step in discovery.steps[:1] for trace in step.traces], discovery.family)
        places = (_wrap(say_place(one, view), "  ") for one in discovery.where)
        parts.append("\n".join(["Where the misfit sits:", *places]))
    if discovery.missing is not None:
        parts.append("\n".join(["The missing force:", _wrap(clean(discovery.missing.sentence, 4000), "  "),
                               *(_wrap(clean(note, 2000), "  ") for note in discovery.missing.notes)]))
    if discovery.notes:
        parts.append("\n".join(["Notes:", *(_wrap(clean(note, 2000), "  ") for note in discovery.notes)]))
    return "\n\n".join(part for part in parts if part)


def align(header: Sequence[str], rows: Sequence[Sequence[str]], sides: str) -> str:
    """A table as text: columns two spaces apart, `l`eft or `r`ight by `sides`, a rule below the header.

    Args:
        header: names of the columns.
        rows: cells as text.
        sides: one letter a column.
    """
    widths = [max(len(str(row[i])) for row in (header, *rows)) for i in range(len(header))]

    def line(cells) -> str:
        return "  ".join(
            str(cell).ljust(width) if side == "l" else str(cell).rjust(width)
            for cell, width, side in zip(cells, widths, sides, strict=True)
        ).rstrip()[:WIDTH]

    return "\n".join([line(header), "-" * min(sum(widths) + 2 * (len(widths) - 1), WIDTH), *map(line, rows)])


def _show_steps(discovery: Discovery) -> str:
    rows = []
    for number, step in enumerate(discovery.steps):
        fit = step.lack_of_fit
        misfit = f"{'yes' if fit.rejected else 'no'} (p {format_p(fit.p_value)})"
        rows.append((name_step(discovery.steps, number, discovery.model), format_number(step.chi2_reduced),
                     format_error(step.nrmse),
                     format_error(step.heldout_nrmse), format_error(step.prediction_nrmse),
                     format_error(discovery.noise_nrmse), misfit,
                     "" if step.converged else "not converged"))  # fmt: skip
    header = ("model", "chi2/dof", "nrmse", "cross-val.", "predicted", "noise", "misfit left", "")
    return align(header, rows, "lrrrrrll") if rows else ""


def _show_candidates(discovery: Discovery) -> str:
    shown = [one for i, one in enumerate(discovery.candidates)
             if i < FEWEST or one.explains >= NEAR or one.effect in discovery.effects]  # fmt: skip
    if len(discovery.candidates) - len(shown) == 1:  # a line about one more would be no shorter
        shown = list(discovery.candidates)
    rows = [
        (("* " if one.effect in discovery.effects else "  ") + clean(one.effect, 32), *_show_gain(discovery, one),
         format_share(one.visible), format_error(one.heldout_nrmse), format_error(one.prediction_nrmse),
         clean(", ".join(one.indistinguishable_from), 30))
        for one in shown
    ]  # fmt: skip
    lines = [align(("  candidate", "explains", "p", "visible", "cross-val.", "predicted", "not to be told from"), rows,
                   "lrrrrrl")]
    rest = [one for one in discovery.candidates if one not in shown]
    if rest:
        most = max(one.explains for one in rest)
        little = f"{format_share(most, 1)} or less" if most >= 5e-4 else "nothing"
        lines.append(f"  and {len(rest)} more that explain {little}: report.html and result.json list all")
    for step in discovery.steps:
        rows = list_alternatives(step.alternatives)
        for (effect, difference, error, _), item in zip(rows, step.alternatives, strict=True):
            beaten = DEFAULT.is_beaten(item["heldout_difference"], item["standard_error"])
            why = "but it fits these records better: neither is settled" if beaten else (
                "this campaign cannot tell them apart")  # fmt: skip
            lines.append(_wrap(f"{effect} instead of {clean(step.added, 34)}: held-out error differs by {difference} "
                               f"+- {error}; {why}", "  "))  # fmt: skip
    return "\n".join(lines)


def _show_gain(discovery: Discovery, candidate: Candidate) -> tuple[str, str]:
    """What a candidate explains alone, with its p-value; what came in later, the share of its own step."""
    later = share_at_step(discovery, candidate.effect)
    if later is None:
        return format_share(candidate.explains, 1), format_p(candidate.p_value)
    return f"{format_share(later[1], 1)} at step {later[0]}", ""


def _wrap(text: str, indent: str = "") -> str:
    return textwrap.fill(text, WIDTH, initial_indent=indent, subsequent_indent=indent, break_on_hyphens=False)
