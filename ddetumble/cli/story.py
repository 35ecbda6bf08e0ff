"""Commands that show what the toolkit does on shipped data: `demo` and `paper`."""

from pathlib import Path
from typing import Annotated

import typer

from .options import OVERWRITE, folder_option
from .places import open_folder
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
    overwrite: Annotated[bool, OVERWRITE] = False,
):
    """The whole story on shipped data: the paper's tables, a campaign with a hidden effect, and a strike planned with
    what was found; writes the reports.
    """
    with open_folder(output, "demo", overwrite) as out:
        from ..demo import run_demo

        run_demo(out.draft, lambda line: typer.echo(line.replace(str(out.draft), str(out.path))))


def examine_paper(
    output: Annotated[Path, folder_option("Folder for the figures and tables.")] = Path("ddetumble-paper"),
    overwrite: Annotated[bool, OVERWRITE] = False,
):
    """The paper beside the toolkit: each contradiction with its two numbers, each table and figure that the printed
    data allow, and what they do not allow.
    """
    lines: list[str] = []
    with open_folder(output, "paper", overwrite) as out, show_progress("comparing the paper with the toolkit"):
        from ..paper import write_paper

        page = out.place(write_paper(out.draft, lines.append))
    for line in lines:
        typer.echo(line)
    typer.echo(f"Report: {page}")
