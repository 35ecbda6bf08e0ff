"""Reports: one page to look at that works offline, its figures as PNG, and the same in plain text for a terminal."""

from .comparison import report_comparison, tabulate_errors, write_comparison
from .findings import write_report
from .missing import write_missing
from .page import Picture, Section, Table, write_page
from .posterior import write_posterior
from .text import describe


__all__ = ["Picture", "Section", "Table", "describe", "report_comparison", "tabulate_errors", "write_comparison",
           "write_missing", "write_page", "write_posterior", "write_report"]
