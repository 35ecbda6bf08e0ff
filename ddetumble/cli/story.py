"""Commands that show what the toolkit does on shipped data: `demo` and `paper`."""

from pathlib import Path
from typing import Annotated

import typer

from .options import Overwrite, command, place
from .places import open_folder
from .progress import show_progress


@command("demo", "Show the whole analysis on shipped data, with its report.", "demo -o demo")
def tell_story(
    output: Annotated[Path, place("Folder for the report and its figures.")] = Path("ddetumble-demo"),
    overwrite: Overwrite = False,
):
    """Show the whole analysis on shipped data: a table of the paper, a campaign with a hidden effect, and a strike
    planned with the model that was found. Writes the reports.
    """
    with open_folder(output, "demo", overwrite) as out:
        from ..demo import run_demo

        run_demo(out.draft, lambda line: typer.echo(line.replace(str(out.draft), str(out.path))))


@command("paper", "Compare the paper with the toolkit, contradiction by contradiction.", "paper -o paper")
def examine_paper(
    output: Annotated[Path, place("Folder for the figures and tables.")] = Path("ddetumble-paper"),
    overwrite: Overwrite = False,
):
    """Compare the paper with the toolkit: each contradiction with its two numbers, each table and figure that the
    printed data allow, and what they do not allow.
    """
    lines: list[str] = []
    with open_folder(output, "paper", overwrite) as out, show_progress("comparing the paper with the toolkit"):
        from ..paper import write_paper

        page = out.place(write_paper(out.draft, lines.append))
    typer.echo("\n".join([*lines, f"Report: {page}"]))
