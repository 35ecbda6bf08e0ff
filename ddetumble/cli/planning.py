"""Commands about tests to come: `design` and `map`."""

from pathlib import Path
from typing import Annotated

import typer

from .._errors import InputError
from .options import MODEL, OVERWRITE
from .places import locate_campaign, locate_fit, open_optional
from .progress import show_progress


def register(app: typer.Typer) -> None:
    """Add this module's commands."""
    app.command(
        "design",
        short_help="The next test that best separates what is still confounded.",
        epilog="\b\nExamples:\n  ddetumble design discovery\n"
        '  ddetumble design discovery --limit "approach_speed=0.2..2 m/s" --channel "pressure: 200 Pa" -o next',
    )(design_test)
    app.command(
        "map",
        short_help="What a planned campaign could see, and what it could not tell apart.",
        epilog="\b\nExamples:\n  ddetumble map plan.csv -o map\n  ddetumble map data/impact-c\n"
        '  ddetumble map plan.csv --value "effective_mass=1.4 kg" --channel "normal_force: 0.1 N"',
    )(map_campaign)


def design_test(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder that discover or fit wrote.")],
    limit: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=LOW..HIGH UNIT", help="Range of a condition, or one value; may be repeated. The "
                     "campaign's own range, extended, where not given."),
    ] = None,
    channel: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME: NOISE UNIT", help="A channel that could be added; may be repeated."),
    ] = None,
    length: Annotated[
        float | None, typer.Option(metavar="X", help="Of the test's record, in s (of slip in m); as in the campaign.")
    ] = None,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="DIR", help="Also write design.json and a figure here.")
    ] = None,
    overwrite: Annotated[bool, OVERWRITE] = False,
):
    """Find the conditions, or the channel to add, that best tell apart what a discovery could not, and how many tests
    that takes. Where nothing is confounded: the test that narrows the parameters most.
    """
    with open_optional(output, "design", overwrite) as out:
        from ..planning.next_test import design

        with show_progress(f"designing the next test for {folder}") as report:
            found = design(locate_fit(folder), limits=limit, channels=channel, length=length, progress=report)
        if out is not None:
            from ..figures import draw_next_test, render_png

            found.save(out.draft)
            (out.draft / "design.png").write_bytes(render_png(draw_next_test(found)))
    typer.echo(str(found))
    if output is not None:
        typer.echo(f"Written to {output}")


def map_campaign(
    plan: Annotated[
        str,
        typer.Argument(metavar="CAMPAIGN|PLAN.csv", help="A campaign, or a table of planned tests: one row a test, "
                       "conditions with units in the headings, optionally `repeats`."),
    ],
    model: Annotated[str, MODEL] = "paper",
    channel: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME: NOISE UNIT", help="What a planned test measures; may be repeated."),
    ] = None,
    uncertainty: Annotated[
        list[str] | None, typer.Option(metavar="NAME=VALUE", help="Of a condition, or of the time origin.")
    ] = None,
    value: Annotated[
        list[str] | None, typer.Option(metavar="NAME=VALUE UNIT", help="Of a parameter of the reference model.")
    ] = None,
    effects_from: Annotated[
        Path | None,
        typer.Option(metavar="FILE.py", help="A file of yours with effects, which are mapped beside the catalogue."),
    ] = None,
    length: Annotated[str | None, typer.Option(metavar="'30 ms'", help="Of a record.")] = None,
    interval: Annotated[str | None, typer.Option(metavar="'0.1 ms'", help="Between samples.")] = None,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="DIR", help="Also write map.json and a figure here.")
    ] = None,
    overwrite: Annotated[bool, OVERWRITE] = False,
):
    """Say before any test which effects a campaign would show, at which size, and which pairs it could not tell
    apart.
    """
    table = plan.lower().endswith(".csv")
    path = Path(plan) if table else locate_campaign(plan)
    if table and not path.is_file():
        raise InputError("there is no such file", file=path)
    if not table and any((channel, uncertainty, value, length, interval)):
        raise InputError("a campaign says itself what it measures; --channel, --uncertainty, --value, --length and "
                         "--interval go with a table of planned tests", file=path)
    with open_optional(output, "map", overwrite) as out:
        from ..inference.models import list_effects
        from ..planning.detectability import map_effects

        own = list_effects(effects_from) if effects_from is not None else ()
        with show_progress(f"mapping {path.stem}") as report:
            found = map_effects(path, model, effects=own, channels=channel, uncertainties=uncertainty, values=value,
                                length=length, interval=interval, progress=report)
        if out is not None:
            from ..figures import draw_map, render_png

            found.save(out.draft)
            (out.draft / "map.png").write_bytes(render_png(draw_map(found)))
    typer.echo(str(found))
    if output is not None:
        typer.echo(f"Written to {output}")
