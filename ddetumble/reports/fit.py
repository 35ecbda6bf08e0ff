"""The page of a fit: parameters, model against measurement, where the residuals sit, how far settings were moved."""

import dataclasses as dc
import math
from pathlib import Path

from ..inference.findings import Fit
from ..measurement.quantities import clean, describe_quantity, format_number, format_value
from ..selection.lack_of_fit import measure_shifts
from ..selection.series import make_traces
from .coefficient import show_coefficients
from .findings import show_failures, show_fits, show_parameters, show_shifts
from .page import Section, Table, write_page


MOST, FAINT = 3, 0.1  # parameters that a shared error is said to move, and standard deviations below which it is not


def report_fit(fit: Fit, folder) -> Path:
    """Write the page of a fit, and its figures; returns its path.

    Raises:
        InputError: The folder cannot be written.
    """
    traces = {clean(fit.model_text, 60): make_traces(fit.source, fit.problem.records, fit.solution, fit.noise)}
    shifts = measure_shifts(fit.problem.records, fit.solution, campaign=fit.source)
    coefficients = show_coefficients(fit)
    sections = [
        show_parameters({"this fit": fit}, [
            clean(text, 800) for text in (*fit.cannot_tell_apart, *fit.notes, *fit.tell_intervals())]),
        *([_show_derived(fit)] if fit.derived else []), *([coefficients] if coefficients else []),
        show_fits(traces)]
    if not fit.problem.records.are_values:
        sections.append(show_failures(traces, {c: dc.asdict(one.without_sizes()) for c, one in fit.noise.items()}))
    if shifts:
        sections.append(show_shifts({fit.model_text: shifts}))
    if fit.systematics:
        sections.append(_show_systematics(fit))
    told = str(fit.goodness) or (f"There is no sign of gross lack of fit (χ² / dof = "
                                 f"{format_number(fit.chi2_reduced)}); `ddetumble compare` tests for small misfits.")
    if not fit.converged:
        told = f"The fit has not converged: {fit.state}. {told}"
    status = [clean(fit.campaign, 60), f"{fit.records} records", f"{fit.samples} samples"]
    values = "; without what priors add" if fit.problem.records.are_values else ""
    facts = [("χ² / dof", format_number(fit.chi2_reduced), f"1 if only noise is left{values}"),
             ("parameters", str(len(fit.parameters)), "fitted")]
    return write_page(f"{fit.campaign} and the model {fit.model_text}", told, sections, folder,
                      badge="" if fit.converged else "not converged", status=status, facts=facts)


def _show_derived(fit: Fit) -> Section:
    """What the model tells beside its parameters (the polynomials of Eq. 10, say), as a part of the page."""
    rows = [(clean(name), *((format_value(one.estimate, one.sd), format_number(one.sd, 2)) if math.isfinite(one.sd) else
                            (format_number(one.estimate), "not determined")), clean(one.unit) or "–")
            for name, one in fit.derived.items()]
    return Section("What follows from them", tables=[Table(("quantity", "estimate", "sd", "unit"), rows)])


def _show_systematics(fit: Fit) -> Section:
    """What a gauge that is off in all records would do to the estimates, as a part of the page."""
    rows = []
    for one in fit.systematics:
        names = sorted(one.moves, key=lambda name: -abs(one.deviations[name]))[:MOST]
        moved = [f"{clean(name)} {one.deviations[name]:+.2g} sd ({one.moves[name]:+.2g}"
                 f"{f' {unit}' if (unit := clean(fit.parameters[name].unit)) not in ('', '1') else ''})"
                 for name in names if abs(one.deviations[name]) >= FAINT]
        rows.append((f"{describe_quantity(one.name).name} {100 * one.share:.2g} % too high", "; ".join(moved) or "–",
                     f"{one.seen:.2f} sd"))
    text = ("No repetition shows that a gauge reads high throughout. What an error of one per cent would do to the "
            "estimates, to first order, and by how much the records themselves would show it: below three standard "
            "deviations they do not. Intervals allow for what the campaign states as `common_uncertainty`.")
    return Section("What a gauge that is off would do", [text],
                   tables=[Table(("error in all records", "moves", "shown by the records"), rows)])
