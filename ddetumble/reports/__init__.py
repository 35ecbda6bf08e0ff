"""Reports: one page to look at that works offline, its figures as PNG, and the same in plain text for a terminal."""

from pathlib import Path

from ..inference.findings import Fit
from ..posterior.result import Posterior
from ..selection.compare import Comparison, Comparisons
from ..selection.discovery import Discovery
from .comparison import report_comparison, tabulate_errors, write_comparison
from .findings import write_report
from .fit import report_fit
from .missing import write_missing
from .page import Picture, Section, Table, write_page
from .posterior import write_posterior


def report(result: Fit | Comparison | Comparisons | Discovery | Posterior, folder) -> Path:
    """Write a result as one page that works offline, and its figures as PNG files in `figures/` beside it.

    Args:
        result: what `fit`, `compare`, `discover` or `sample` returned.
        folder: where to write; made where it is not there.

    Returns:
        Path of the page.

    Raises:
        InputError: The folder cannot be written.
        TypeError: There is no page of such a result.
    """
    if isinstance(result, Discovery):
        return write_report(result, folder)
    if isinstance(result, (Comparison, Comparisons)):
        return report_comparison(result, folder)
    if isinstance(result, Posterior):
        return write_posterior(result, folder)
    if isinstance(result, Fit):
        return report_fit(result, folder)
    raise TypeError(f"there is no page of {type(result).__name__}: give what fit, compare, discover or sample returned")


__all__ = ["Picture", "Section", "Table", "report", "report_comparison", "report_fit", "tabulate_errors",
           "write_comparison", "write_missing", "write_page", "write_posterior", "write_report"]
