"""The page of a fit: parameters, model against measurement, where the residuals sit, how far settings were moved."""

import dataclasses as dc
from pathlib import Path

from ..inference.findings import Fit
from ..measurement.quantities import clean, format_number
from ..selection.lack_of_fit import measure_shifts
from ..selection.series import make_traces
from .findings import show_failures, show_fits, show_parameters, show_shifts
from .page import write_page


def report_fit(fit: Fit, folder) -> Path:
    """Write the page of a fit, and its figures; returns its path.

    Raises:
        InputError: The folder cannot be written.
    """
    traces = {clean(fit.model_text, 60): make_traces(fit.source, fit.problem.records, fit.solution, fit.noise)}
    shifts = measure_shifts(fit.problem.records, fit.solution, campaign=fit.source)
    sections = [
        show_parameters({"this fit": fit}, [
            clean(text, 400) for text in (*fit.cannot_tell_apart, *fit.notes, *fit.tell_intervals())]),
        show_fits(traces)]
    if not fit.problem.records.are_values:
        sections.append(show_failures(traces, {c: dc.asdict(one.without_sizes()) for c, one in fit.noise.items()}))
    if shifts:
        sections.append(show_shifts({fit.model_text: shifts}))
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
