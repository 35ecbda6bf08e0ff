"""Public names of reports and where they live."""

from .findings import report_comparison as report_comparison
from .findings import tabulate_errors as tabulate_errors
from .findings import write_missing as write_missing
from .findings import write_report as write_report
from .fit import report_fit as report_fit
from .joint import report_joint as report_joint
from .page import Picture as Picture
from .page import Section as Section
from .page import Table as Table
from .page import write_page as write_page
from .plan import write_plan as write_plan
from .posterior import write_posterior as write_posterior
from .result import report as report

__all__: list[str]
