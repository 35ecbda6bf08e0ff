"""The report of a result of any kind."""

from pathlib import Path

from ..inference.findings import Fit
from ..inference.joint import JointFit
from ..inference.population import PopulationFit
from ..planning.plan import Plan
from ..posterior.result import Posterior
from ..selection.compare import Comparison, Comparisons
from ..selection.discovery import Discovery
from .findings import report_comparison, write_report
from .fit import report_fit
from .joint import report_joint
from .plan import write_plan
from .posterior import write_posterior


_WRITERS = {Discovery: write_report, Comparison: report_comparison, Comparisons: report_comparison,
            Posterior: write_posterior, Plan: write_plan, Fit: report_fit, JointFit: report_joint,
            PopulationFit: report_joint}


def report(result: Fit | JointFit | PopulationFit | Comparison | Comparisons | Discovery | Posterior | Plan, folder
           ) -> Path:
    """Write a result as one page that works offline, and its figures as PNG files in `figures/` beside it.

    Args:
        result: what `fit`, `fit_jointly`, `fit_population`, `compare`, `discover`, `sample` or `plan` returned.
        folder: where to write; made where it is not there.

    Returns:
        Path of the page.

    Raises:
        InputError: The folder cannot be written.
        TypeError: There is no page of such a result.
    """
    for kind, write in _WRITERS.items():
        if isinstance(result, kind):
            return write(result, folder)
    raise TypeError(f"there is no page of {type(result).__name__}: give what fit, fit_jointly, "
                    "fit_population, compare, discover, sample or plan returned")
