"""Progress of long work: a bar on a terminal, nothing in a pipe."""

import math
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from .interrupts import undone_by


Report = Callable[..., None]


@contextmanager
def show_progress(title: str) -> Iterator[Report]:
    """Show what long work is at, on standard error, as long as that is a terminal.

    Args:
        title: What is being done, until the work reports something.

    Yields:
        A function of a message and, if known, of the fraction done (0 to 1), for the work to call.
    """
    if not sys.stderr.isatty() or os.environ.get("TERM") == "dumb":
        yield lambda message, fraction=None: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = (SpinnerColumn(), TextColumn("{task.description}", markup=False), BarColumn(), TimeElapsedColumn())
    with (Progress(*columns, console=Console(stderr=True), transient=True, refresh_per_second=5) as progress,
          undone_by(progress.stop)):  # which gives the terminal its cursor back
        task = progress.add_task(title, total=None)

        def report(message: str, fraction: float | None = None) -> None:
            known = fraction is not None and math.isfinite(fraction)
            progress.update(task, description=message, total=1.0 if known else None,
                            completed=fraction if known else None)

        yield report
