"""The command about striking debris: `plan`."""

from pathlib import Path
from typing import Annotated

import typer

from .._settings import find_data
from .places import prepare_folder
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
):
    """Where, how fast, how hard and when to strike tumbling debris so that its angular momentum goes."""
    shipped = find_data() / "scenarios" / scenario.name
    path = scenario if scenario.exists() or scenario.parent.name or not shipped.is_file() else shipped
    from ..planning.scenario import pose_problem, read_scenario

    wanted = read_scenario(path)
    folder = prepare_folder(output or Path(f"{path.stem}-plan"))
    problem = pose_problem(wanted, path.parent)
    from ..planning.sequence import plan_sequence
    from ..report.plan import describe_plan, write_plan

    with show_progress(f"planning {path.stem}") as report:
        found = plan_sequence(problem, wanted.goal.share, wanted.goal.impacts, starts=wanted.starts, seed=wanted.seed,
                              progress=report)
    write_plan(problem, found, folder, title=wanted.title or path.stem, share=wanted.goal.share, source=path.name)
    typer.echo(describe_plan(problem, found, wanted.goal.share))
    typer.echo(f"Written to {folder}")
