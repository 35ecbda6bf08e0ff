"""The command line: thin commands that call the package's verbs and print what these return, under one name.

Nothing heavy is imported here; each command imports what it needs when it runs.
"""

import gc
import importlib
import os
import sys
from collections.abc import Sequence
from typing import Annotated

import typer

from .failures import run_guarded, tell_stopped
from .interrupts import watch_interrupts
from .options import app, show_examples
from .places import words_now


# In the order in which the help lists their commands.
for _module in ("story", "workbench", "measurement", "selection", "estimation", "catalogue", "sampling", "planning",
                "results", "upkeep"):
    importlib.import_module(f".{_module}", __name__)


@app.callback(invoke_without_command=True, epilog=show_examples(
    "ddetumble demo", "ddetumble discover data/impact-c -o discovery", "ddetumble fit --help"))
def _show_help(
    context: typer.Context,
    version: Annotated[bool, typer.Option("--version", help="Show the version and exit.")] = False,
):
    """Find out which physics a contact model leaves out: compare it with measured impacts or friction, see where it
    fails, rank the effects that could be missing, add one, and watch the error fall.

    CAMPAIGN is a folder with measured tests (or the name of one that comes with the toolkit, such as impact-a);
    `ddetumble import` makes one from a laboratory's CSV files. MODEL is one of those that `ddetumble models` lists, a
    folder that `fit` or `discover` wrote, or FILE.py:NAME.

    Results go to a new or empty folder, whole or not at all; what a place holds is replaced with --overwrite alone.
    """
    if version:
        from importlib.metadata import version as read_version

        typer.echo(f"ddetumble {read_version('ddetumble')}")
    elif context.invoked_subcommand is None:
        typer.echo(context.get_help())


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; returns its exit code: 0, 2 for bad input, 1 for a failure of the computation or of a page.

    It runs on the processor unless JAX_PLATFORMS says otherwise.

    Args:
        arguments: What stands behind `ddetumble` on the command line; the process's own arguments if not given, and
            then Ctrl-C ends the process itself wherever it is.
    """
    if "JAX_PLATFORM_NAME" not in os.environ:  # a command's work is too small for a GPU to be worth its start
        os.environ.setdefault("JAX_PLATFORMS", "cpu")
    # NumPy's matrices are small here, and threads that wait for each other at every step, up to ten times slower where
    # another process has a core.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    if arguments is None:
        gc.set_threshold(50_000)  # what imports and compiled programs leave stays: to look through it often is in vain
        watch_interrupts(tell_stopped)
    words = list(sys.argv[1:] if arguments is None else arguments)
    token = words_now.set(tuple(words))
    try:
        return run_guarded(lambda: app(words, prog_name="ddetumble", standalone_mode=False), words)
    finally:
        words_now.reset(token)


__all__ = ["app", "main"]
