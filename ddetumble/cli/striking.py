"""The command about striking debris: `plan`."""

from pathlib import Path
from typing import Annotated

import typer

from .._settings import find_data
from .options import OVERWRITE
from .places import open_folder
from .progress import show_progress


def register(app: typer.Typer) -> None:
    """Add this module's command."""
    app.command(
        "plan",
        short_help="Where, how fast and when to strike tumbling debris.",
        epilog="\b\nExamples:\n  ddetumble plan data/scenarios/flat-spin.toml -o plan\n"
        "  ddetumble plan flat-spin.toml",
    )(plan_impacts)


def plan_impacts(
    scenario: Annotated[
        Path, typer.Argument(metavar="SCENARIO.toml", help="What is struck, by what, and what is wanted.")
    ],
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="DIR", help="Folder for plan.json and report.html.")
    ] = None,
    overwrite: Annotated[bool, OVERWRITE] = False,
):
    """Where, how fast, how hard and when to strike tumbling debris so that its angular momentum goes."""
    shipped = find_data() / "scenarios" / scenario.name
    path = scenario if scenario.exists() or scenario.parent.name or not shipped.is_file() else shipped
    from ..planning.plan import plan
    from ..reports.plan import write_plan

    with (open_folder(output or Path(f"{path.stem}-plan"), "plan", overwrite) as out,
          show_progress(f"planning {path.stem}") as report):
        found = plan(path, progress=report)
        write_plan(found, out.draft)
    typer.echo(str(found))
    typer.echo(f"Written to {out.path}")
