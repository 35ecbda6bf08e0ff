"""Progress of long work on standard error: a bar on a terminal, a few plain lines elsewhere, nothing if not wanted."""

import math
import os
import re
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar

from .._display import tell_passed
from .interrupts import undone_by


Report = Callable[..., None]
quiet_now: ContextVar[bool] = ContextVar("quiet", default=False)  # whether a command is to print no progress
MOST = 12  # lines of a command, so that a log stays readable
# After so many seconds a stage that has been told is told once more, as a reader then wonders whether it goes on; in
# long work after this share of the time since it began, so that a log of hours stays readable, too.
AGAIN, SHARE = 30.0, 0.2


@contextmanager
def show_progress(title: str) -> Iterator[Report]:
    """Show what long work is at, on standard error: on a terminal in a bar, elsewhere in a line at every stage.

    A stage is what a message says before its first colon, whatever its numbers: `impact 2: 40 % left` is of the stage
    of `impact 1: 70 % left`.

    Args:
        title: What is being done, until the work reports something.

    Yields:
        A function of a message and, if known, of the fraction done (0 to 1), for the work to call.
    """
    if quiet_now.get():
        yield lambda message, fraction=None: None
        return
    if not sys.stderr.isatty() or os.environ.get("TERM") == "dumb":
        yield _make_lines()
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


def _make_lines() -> Report:
    """A report that prints a line where a stage begins, up to the most of them, and after a while what it is at."""
    lock, told, began = threading.Lock(), set(), time.monotonic()
    left, last = MOST, 0.0

    def report(message: str, fraction: float | None = None) -> None:
        nonlocal left, last
        stage = re.sub(r"\d+(\.\d+)?", "", message.partition(":")[0])
        with lock:  # effects are tried in several threads
            now = time.monotonic()
            new = left > 0 and stage not in told
            if not new and now - last < max(AGAIN, SHARE * (now - began)):
                return
            left, last = left - new, now
            told.add(stage)
            with suppress(OSError):  # nobody is listening
                print(f"ddetumble: {message} …{tell_passed(now - began)}", file=sys.stderr, flush=True)

    return report
