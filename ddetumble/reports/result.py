"""The report of a result of any kind."""

from pathlib import Path

from .._errors import InputError
from ..inference.files import check_folder
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


# Endings of files for which a folder is mistaken.
FILES = (".csv", ".htm", ".html", ".json", ".md", ".ods", ".pdf", ".png", ".svg", ".tex", ".toml", ".tsv", ".txt",
         ".xlsx", ".zip")
_WRITERS = {Discovery: write_report, Comparison: report_comparison, Comparisons: report_comparison,
            Posterior: write_posterior, Plan: write_plan, Fit: report_fit, JointFit: report_joint,
            PopulationFit: report_joint}


def report(result: Fit | JointFit | PopulationFit | Comparison | Comparisons | Discovery | Posterior | Plan, folder
           ) -> Path:
    """Write a result as one page that works offline, and its figures as PNG files in `figures/` beside it.

    Args:
        result: what `fit`, `fit_jointly`, `fit_population`, `compare`, `discover`, `sample` or `plan` returned.
        folder: where to write; made where it is not there. What `report` wrote there before is replaced.

    Returns:
        Path of the page.

    Raises:
        InputError: The folder cannot be written, or is the name of a file.
        TypeError: There is no page of such a result.
    """
    ending = Path(folder).suffix.lower()
    if ending in FILES:
        raise InputError(f"report writes a folder with a page and its figures, not a {ending} file; give a name "
                         "without an ending, or tabulate what save writes with `ddetumble export`", file=folder)
    check_folder(folder, "report")
    for kind, write in _WRITERS.items():
        if isinstance(result, kind):
            return write(result, folder)
    raise TypeError(f"there is no page of {type(result).__name__}: give what fit, fit_jointly, "
                    "fit_population, compare, discover, sample or plan returned")
