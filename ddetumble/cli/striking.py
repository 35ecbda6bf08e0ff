"""The command about striking debris: `plan`."""

from pathlib import Path
from typing import Annotated

import typer

from .._errors import InputError
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
    from ..planning.measured import find_measured_ranges
    from ..planning.scenario import pose_laws, pose_problem, read_scenario

    wanted = read_scenario(path)
    try:
        laws = pose_laws(wanted, path.parent)
        problem = pose_problem(wanted, path.parent, laws)
        ranges = find_measured_ranges(wanted, path.parent)
    except InputError as error:
        if error.file is not None or error.key is None:
            raise
        raise InputError(error.problem, file=path, key=error.key) from None
    from ..planning.ambiguity import assess_plan
    from ..planning.chain import plan_together
    from ..planning.prospect import assess_sequence
    from ..planning.risk import plan_robust_strike
    from ..planning.sequence import plan_sequence
    from ..reports.plan import describe_plan, write_plan

    table, revise, assessment, prospect = wanted.uncertainty, None, None, None
    aim = "best" if table is None else table.plan_for
    if laws is not None and table is not None and aim != "best":
        drawn, wary, share = laws, aim, table.tail

        def plan_warily(now, plan):
            return plan_robust_strike(now, drawn, plan, aim=wary, tail=share)

        revise = plan_warily

    with (open_folder(output or Path(f"{path.stem}-plan"), "plan", overwrite) as out,
          show_progress(f"planning {path.stem}") as report):
        goal = wanted.goal
        if revise is None:
            found = plan_together(problem, goal.share, goal.impacts, aim=goal.least, starts=wanted.starts,
                                  seed=wanted.seed, progress=report)
        else:
            found = plan_sequence(problem, goal.share, goal.impacts, starts=wanted.starts, seed=wanted.seed,
                                  revise=revise, progress=report)
        if laws is not None and table is not None and found.impacts:
            report("trying the first impact on all draws")
            assessment = assess_plan(problem, found.impacts[0], laws, tail=table.tail)
            if len(found.impacts) > 1:
                report("trying all impacts on all draws")
                prospect = assess_sequence(problem, found, laws, goal.share, tail=table.tail)
        write_plan(problem, found, out.draft, title=wanted.title or path.stem, share=wanted.goal.share,
                   source=path.name, assessment=assessment, plan_for=aim, prospect=prospect, ranges=ranges)
    typer.echo(describe_plan(problem, found, wanted.goal.share, ranges))
    for sentence in assessment.sentences if assessment is not None else ():
        typer.echo(sentence)
    if prospect is not None:
        typer.echo(prospect.sentence)
    elif assessment is not None and len(found.impacts) > 1:
        typer.echo("Under no draw of the contact could all impacts be struck one after the other.")
    typer.echo(f"Written to {out.path}")
