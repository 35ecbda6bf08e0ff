"""The page of a fit: parameters, model against measurement, where the residuals sit, how far settings were moved."""

import dataclasses as dc
from pathlib import Path

from ..figures import draw_parameters
from ..inference.findings import Fit, Fitted
from ..measurement.quantities import clean, format_number, format_value
from ..selection.lack_of_fit import measure_shifts
from ..selection.series import make_traces
from .findings import show_failures, show_fits, show_shifts
from .page import Section, Table, draw_picture, write_page


@dc.dataclass(frozen=True)
class _Drawn:
    """What the figure of parameters reads of a model."""

    parameters: dict[str, Fitted]
    correlations: tuple[tuple[str, str, float], ...]


def report_fit(fit: Fit, folder, name: str = "report.html") -> Path:
    """Write the page of a fit, and its figures as PNG files in `figures/` beside it; returns its path.

    Raises:
        InputError: The folder cannot be written.
    """
    traces = {clean(fit.model_text, 60): make_traces(fit.source, fit.problem.records, fit.solution, fit.noise)}
    shifts = measure_shifts(fit.problem.records, fit.solution)
    sections = [_show_parameters(fit), show_fits(traces), show_failures(traces, {
        channel: dc.asdict(one) for channel, one in fit.noise.items()})]
    if shifts:
        sections.append(show_shifts({fit.model_text: shifts}))
    status = [clean(fit.campaign, 60), f"{fit.records} records", f"{fit.samples} samples"]
    facts = [("χ² / dof", format_number(fit.chi2_reduced), "1 where only noise is left"),
             ("parameters", str(len(fit.parameters)), "fitted")]
    return write_page(f"{fit.campaign} and the model {fit.model_text}", _say(fit), sections, folder, name,
                      badge="" if fit.converged else "not converged", status=status, facts=facts)


def _say(fit: Fit) -> str:
    """The outcome: does the model hold, and the parameters that its effects add."""
    told = str(fit.goodness) or ("The model describes the data within their noise and the stated uncertainty of the "
                                 "settings.")
    if not fit.converged:
        told = f"The fit has not converged: {fit.state}. {told}"
    return told


def _show_parameters(fit: Fit) -> Section:
    rows = []
    for key, one in fit.parameters.items():
        rows.append((clean(key), *(format_value(x, one.sd) for x in (one.estimate, one.sd, one.q025, one.q975)),
                     "–" if one.unit in ("", "1") else clean(one.unit), clean(one.text, 160)))
    names = list(fit.parameters)
    pairs = sorted(((a, b, float(fit.correlations[i, j])) for i, a in enumerate(names) for j, b in enumerate(names)
                    if i < j), key=lambda one: -abs(one[2]))
    shown = {"this fit": _Drawn(dict(fit.parameters), tuple(pairs))}
    caption = "Estimates with their 95 % intervals, each on its own scale, and the strongest correlations."
    picture = draw_picture("parameters", caption, draw_parameters, shown, alt=f"Intervals of {len(rows)} parameters.")
    points = [clean(text, 400) for text in (*fit.cannot_tell_apart, *fit.notes)]
    table = Table(("parameter", "estimate", "sd", "2.5 %", "97.5 %", "unit", ""), rows)
    return Section("Parameters", points=points, figures=[picture] if rows else [], tables=[table])
