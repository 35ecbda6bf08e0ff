"""Commands about what is to come: `design` and `map` of tests, `plan` of strikes at debris."""

from pathlib import Path
from typing import Annotated

import typer

from .failures import FAILED
from .options import Model, Overwrite, Texts, command, option, place
from .places import locate_fit, locate_plan, open_folder, open_optional, tell_page, write_bytes
from .progress import show_progress


@command("design", "Design the next test, which best separates what is still confounded.", "design discovery",
         "design fit-adhesion fit-wall-stiffness",
         'design discovery --limit "approach_speed=0.2..2 m/s" --channel "pressure: 200 Pa" -o next')
def design_test(
    folders: Annotated[list[Path], typer.Argument(
        metavar="DIR...", help="Folder that discover or fit wrote. Several, fits of one campaign, are the models to "
        "tell apart.")],
    limit: Annotated[Texts, option(
        "NAME=LOW..HIGH UNIT", "Range of a condition, or one value; may be repeated. If not given, the campaign's "
        "own range, extended.")] = None,
    channel: Annotated[Texts, option("NAME: NOISE UNIT", "A channel that could be added; may be repeated.")] = None,
    length: Annotated[str | None, option(
        "'30 ms'", "Length of the test's record; if not given, as in the campaign.")] = None,
    output: Annotated[Path | None, place("Also write design.json and a figure here.")] = None,
    overwrite: Overwrite = False,
):
    """Find the conditions, or the channel to add, that best distinguish what a discovery could not, or models that are
    named, and how many tests that takes. Where a setting may be wrong alike in all records: the calibration that
    decides, too. Where nothing is confounded: the test that reduces the uncertainty of the parameters most.
    """
    with open_optional(output, "design", overwrite) as out:
        from ..planning.next_test import design

        places, drawn = [locate_fit(folder) for folder in folders], None
        with show_progress(f"designing the next test for {' and '.join(map(str, folders))}") as report:
            found = design(places if len(places) > 1 else places[0], limits=limit, channels=channel, length=length,
                           progress=report)
            if out is not None:
                from ..figures import draw_next_test, render_png

                found.save(out.draft)
                drawn = out.draw(lambda draft: _write_figure(draft / "design.png", render_png(draw_next_test(found))),
                                 report, what="figure")
    typer.echo(str(found))
    if output is not None:
        typer.echo(f"Written to {output}")
        return FAILED if drawn is None else None


@command("map", "Map the effects that a planned campaign could detect and distinguish.", "map plan.csv -o map",
         "map data/impact-c", 'map plan.csv --value "effective_mass=1.4 kg" --channel "normal_force: 0.1 N"')
def map_campaign(
    plan: Annotated[str, typer.Argument(
        metavar="CAMPAIGN|PLAN.csv", help="A campaign, or a table of planned tests: one row per test, conditions with "
        "units in the headings, and optionally `repeats`.")],
    model: Model = "paper",
    channel: Annotated[Texts, option("NAME: NOISE UNIT", "Channel that a planned test measures, with its noise; may "
                                                         "be repeated.")] = None,
    uncertainty: Annotated[Texts, option(
        "NAME=VALUE", "Standard deviation of a condition, or of the time origin; may be repeated.")] = None,
    value: Annotated[Texts, option(
        "NAME=VALUE UNIT", "Value of a parameter of the reference model; may be repeated.")] = None,
    effects_from: Annotated[Path | None, option(
        "FILE.py", "File with effects of your own, which are mapped as well as the catalogue.")] = None,
    size: Annotated[Texts, option(
        "EFFECT.NAME=VALUE UNIT", "Tell how many records would detect an effect of this size; may be "
        "repeated.")] = None,
    length: Annotated[str | None, option("'30 ms'", "Length of a record.")] = None,
    interval: Annotated[str | None, option("'0.1 ms'", "Interval between samples.")] = None,
    output: Annotated[Path | None, place("Also write map.json and a figure here.")] = None,
    overwrite: Overwrite = False,
):
    """Find, before any test is made, which effects a campaign would detect, at which size, and which pairs it could not
    distinguish.
    """
    path = locate_plan(plan, channel=channel, uncertainty=uncertainty, value=value, length=length, interval=interval)
    with open_optional(output, "map", overwrite) as out:
        from ..inference.models import list_effects
        from ..planning.detectability import map_effects

        own, drawn = list_effects(effects_from) if effects_from is not None else (), None
        with show_progress(f"mapping {path.stem}") as report:
            found = map_effects(path, model, effects=own, channels=channel, uncertainties=uncertainty, values=value,
                                sizes=size, length=length, interval=interval, progress=report)
            if out is not None:
                from ..figures import draw_map, render_png

                found.save(out.draft)
                drawn = out.draw(lambda draft: _write_figure(draft / "map.png", render_png(draw_map(found))), report,
                                 what="figure")
    typer.echo(str(found))
    if output is not None:
        typer.echo(f"Written to {output}")
        return FAILED if drawn is None else None


@command("plan", "Plan where, how fast and when to strike tumbling debris.",
         "plan data/scenarios/flat-spin.toml -o plan",
         "plan flat-spin.toml")
def plan_impacts(
    scenario: Annotated[Path, typer.Argument(
        metavar="SCENARIO.toml", help="Scenario: the debris, the ball and its arm, and the goal.")],
    output: Annotated[Path | None, place("Folder for plan.json and report.html.")] = None,
    overwrite: Overwrite = False,
):
    """Plan where, how fast, how hard and when to strike tumbling debris to reduce its angular momentum."""
    from ..planning.scenario_file import find_scenario, read_scenario

    file = find_scenario(scenario)
    asked = read_scenario(file)  # before JAX is imported, which takes seconds
    with (open_folder(output or Path(f"{scenario.stem}-plan"), "plan", overwrite) as out,
          show_progress(f"planning {scenario.stem}") as report):
        from ..planning.plan import plan_scenario
        from ..reports.plan import save_plan, write_plan

        found = plan_scenario(asked, file.parent, file, progress=report)
        report("writing the report")
        save_plan(found, out.draft)
        page = out.draw(lambda draft: write_plan(found, draft), report)
    typer.echo(str(found))
    return tell_page(page, out.path)


def _write_figure(path: Path, image: bytes) -> Path:
    """Write an image; returns its path."""
    write_bytes(image, path)
    return path
