"""The command about Python files of the user's own that data name: `trust`."""

from pathlib import Path
from typing import Annotated

import typer


def register(app: typer.Typer) -> None:
    """Add this module's commands."""
    app.command(
        "trust",
        short_help="Allow a Python file that a campaign or a model names to be run.",
        epilog="\b\nExample:\n  ddetumble trust tests/own_kind.py",
    )(trust)


def trust(files: Annotated[list[Path], typer.Argument(metavar="FILE.py...", help="Python files that you have read.")]):
    """Allow Python files to be run that campaigns or saved models name: effects, models or kinds of tests of one's own.

    What you name on the command line or in Python yourself, or have saved, is allowed anyway, there and wherever it
    is copied as it is. What came from elsewhere is not run before you say so here. DDETUMBLE_TRUST names the file that
    keeps the list.
    """
    from .._user_files import find_trusted, trust_file

    for file in files:
        trust_file(file)
    typer.echo(f"May be run: {', '.join(map(str, files))} (listed in {find_trusted()}).")
