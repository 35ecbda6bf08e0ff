"""Commands that show what the toolkit does on shipped data: `demo` and `paper`."""

from pathlib import Path
from typing import Annotated

import typer

from .options import folder_option
from .places import prepare_folder
from .progress import show_progress


def register(app: typer.Typer) -> None:
    """Add this module's commands."""
    app.command(
        "demo",
        short_help="The whole story on shipped data, with the report.",
        epilog="\b\nExample:\n  ddetumble demo -o demo",
    )(tell_story)
    app.command(
        "paper",
        short_help="The paper beside the toolkit, contradiction by contradiction.",
        epilog="\b\nExample:\n  ddetumble paper -o paper",
    )(examine_paper)


def tell_story(
    output: Annotated[Path, folder_option("Folder for the report and its figures.")] = Path("ddetumble-demo"),
):
    """The whole story on shipped data: the paper's tables, a campaign with a hidden effect, and a strike planned with
    what was found; writes the reports.
    """
    folder = prepare_folder(output)
    from ..demo import run_demo

    run_demo(folder, typer.echo)


def examine_paper(
    output: Annotated[Path, folder_option("Folder for the figures and tables.")] = Path("ddetumble-paper"),
):
    """The paper beside the toolkit: each contradiction with its two numbers, each table and figure that the printed
    data allow, and what they do not allow.
    """
    folder = prepare_folder(output)
    from ..paper import write_paper

    lines: list[str] = []
    with show_progress("comparing the paper with the toolkit"):
        page = write_paper(folder, lines.append)
    for line in lines:
        typer.echo(line)
    typer.echo(f"Report: {page}")
