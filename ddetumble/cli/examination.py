"""Commands that hold a model against a campaign: `compare`, `identify`, `discover` and `missing`."""

from pathlib import Path
from typing import Annotated

import typer

from .options import CAMPAIGN, MODEL, OWN, folder_option
from .places import locate_campaign, prepare_file, prepare_folder, write_table
from .progress import show_progress


KEEP = typer.Option("--keep-all", help="Leave out no record and no sample: faults are only reported.")


def register(app: typer.Typer) -> None:
    """Add this module's commands."""
    app.command(
        "compare",
        short_help="Hold a model against measurements: where it fails, against the noise.",
        epilog="\b\nExample:\n  ddetumble compare data/impact-c --model paper -o comparison",
    )(compare_model)
    app.command(
        "discover",
        short_help="Find the missing physics, and write the report.",
        epilog="\b\nExamples:\n  ddetumble discover data/impact-c -o discovery\n"
        "  ddetumble discover data/impact-h --effect my_effects.py:EndStop -o discovery",
    )(discover_effects)
    app.command(
        "missing",
        short_help="Draw the force that a model lacks, and the simple laws that would draw it.",
        epilog="\b\nExamples:\n  ddetumble missing data/impact-f -o force\n"
        "  ddetumble missing data/impact-f --effect wall-stiffness -o force",
    )(draw_force)
    app.command(
        "identify",
        short_help="Force from measured depression and pressure, with uncertainty.",
        epilog="\b\nExample:\n  ddetumble identify data/impact-i -o forces.csv",
    )(identify_force)


def compare_model(
    campaign: Annotated[str, CAMPAIGN],
    model: Annotated[str, MODEL] = "paper",
    output: Annotated[Path | None, folder_option("Also write compare.json and figures here.")] = None,
):
    """Hold a model against measurements: error by channel, record and condition, against the noise."""
    path = locate_campaign(campaign)
    from ..measurement.package import read_campaign

    measured = read_campaign(path)
    folder = None if output is None else prepare_folder(output)
    if measured.samples is None:
        _compare_peaks(measured, model, folder)
        return
    from ..discrepancy.comparison import compare

    with show_progress(f"comparing {measured.name} with {model}"):
        result = compare(measured, model=model)
    typer.echo(result.text())
    if folder is None:
        return
    from ..report import Section, write_comparison

    with show_progress("drawing"):
        result.save(folder)
        tables = (result.channels, result.conditions, result.records)
        page = write_comparison(
            result.sentence, {model: result.traces}, folder, title=f"{measured.name} and the model {model}",
            noise=result.noise, where=result.where, status=(measured.name, f"{len(measured.records)} records"),
            sections=[Section("Errors", ("By channel, by condition, by record; `ratio` is the error over the noise.",),
                              tables=tables)])
    typer.echo(f"Report: {page}")


def _compare_peaks(measured, model: str, folder: Path | None) -> None:
    """Where a campaign holds peaks only: every model of them side by side."""
    from ..paper import judge_campaign

    with show_progress(f"comparing the peaks of {measured.name}"):
        result = judge_campaign(measured, model=model)
    typer.echo("\n".join((result.sentence, *(f"- {note}" for note in result.notes))))
    typer.echo(f"\n{result.table().to_string(index=False)}")
    if folder is not None:
        from ..inference.files import write_json

        write_json(folder / "compare.json", result.to_dict())
        typer.echo(f"Written to {folder}")


def identify_force(
    campaign: Annotated[str, CAMPAIGN],
    model: Annotated[str, MODEL] = "paper",
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="OUT.csv", help="Table of the force; without it, printed.")
    ] = None,
):
    """The paper's own task: force with uncertainty from measured depression and pressure, against the gauge where there
    is one.
    """
    path = locate_campaign(campaign)
    from ..measurement.package import read_campaign

    measured = read_campaign(path)
    file = prepare_file(output)
    from ..discrepancy.identification import identify

    with show_progress(f"identifying the force of {measured.name}"):
        result = identify(measured, model=model)
    write_table(result.table, file)
    typer.echo(result.text(), err=file is None)
    if file is not None:
        typer.echo(f"Written to {file}")


def discover_effects(
    campaign: Annotated[str, CAMPAIGN],
    output: Annotated[
        Path | None, folder_option("Folder for result.json, report.html and the grown model.")
    ] = None,
    model: Annotated[str, MODEL] = "paper",
    effect: Annotated[
        list[str] | None,
        typer.Option("-e", "--effect", metavar="FILE.py:NAME",
                     help="Try this effect of your own beside the catalogue; may be repeated."),
    ] = None,
    effects_from: Annotated[
        Path | None, typer.Option("--effects-from", metavar="FILE.py", help="Try all effects of this file of yours.")
    ] = None,
    keep_all: Annotated[bool, KEEP] = False,
):
    """Find the missing physics: compare, say where the model fails, rank the effects, add one, refit, until nothing is
    missing or nothing helps.
    """
    path = locate_campaign(campaign)
    from ..measurement.package import read_campaign

    measured = read_campaign(path)
    folder = prepare_folder(output or Path(f"{measured.name}-discovery"))
    if measured.samples is None:
        _judge_peaks(measured, model, folder)
        return
    from ..discrepancy.discovery import discover
    from ..inference.models import list_effects, resolve_effect
    from ..report import describe, write_report

    held = list_effects(effects_from) if effects_from is not None else ()
    own = list(dict.fromkeys([*(resolve_effect(name, held) for name in effect or ()), *held]))
    with show_progress(f"looking at {measured.name}") as report:
        for one in own:
            _prove_contract(one, model, measured.family)
        result = discover(measured, model=model, effects=own, keep_all=keep_all, progress=report)
        report("writing the report", 0.95)
        result.save(folder)
        page = write_report(result, folder)
    typer.echo(describe(result))
    typer.echo(f"Report: {page}")
    if result.steps[-1].alternatives:
        typer.echo(f"The test that tells them apart: ddetumble design {folder}")


def draw_force(
    campaign: Annotated[str, CAMPAIGN],
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="DIR", help="Folder for missing.json and missing.html.")
    ] = None,
    model: Annotated[str, MODEL] = "paper",
    effect: Annotated[
        list[str] | None,
        typer.Option("-e", "--effect", metavar="EFFECT",
                     help="Fit this effect with the model: an id of the catalogue, or of --effects-from, or "
                     "FILE.py:NAME; may be repeated."),
    ] = None,
    effects_from: Annotated[Path | None, OWN] = None,
    keep_all: Annotated[bool, KEEP] = False,
):
    """Draw the missing force: how much of the misfit any force of depression, rate, slip, time or pressure could remove
    on left-out conditions, what it looks like, and which simple laws would draw it. `discover` does so itself where its
    verdict is improved or unexplained.
    """
    path = locate_campaign(campaign)
    from ..measurement.package import read_campaign

    measured = read_campaign(path)
    folder = prepare_folder(output or Path(f"{measured.name}-missing"))
    from ..discrepancy.missing import draw_missing_force
    from ..inference.files import list_versions, write_json
    from ..inference.models import list_effects, resolve_effect
    from ..report import write_missing

    held = list_effects(effects_from) if effects_from is not None else ()
    own = [resolve_effect(name, held) for name in effect or ()] or list(held)
    with show_progress(f"looking at {measured.name}") as report:
        for one in own:
            _prove_contract(one, model, measured.family)
        found = draw_missing_force(measured, model, effects=own, keep_all=keep_all, progress=report)
        report("writing the report", 0.97)
        write_json(folder / "missing.json", {"campaign": measured.name, "model": model, "sha256": measured.sha256,
                                             **found.to_dict(), "versions": list_versions()})
        page = write_missing(found, folder, title=f"{measured.name}: the missing force",
                             status=(measured.name, f"{len(measured.records)} records", f"reference model {model}"))
    typer.echo(found.text())
    typer.echo(f"Report: {page}")


def _prove_contract(effect, model: str, family: str) -> None:
    """Refuse an effect of the user's own that breaks the contract on which verdicts rely."""
    from ..contact.contract import check_effect
    from ..contact.effect import family_of
    from ..effects import CATALOGUES
    from ..inference.models import resolve_model

    if family_of(effect) == family and not any(effect in known for known in CATALOGUES.values()):
        check_effect(effect, resolve_model(model, family).reference).require()


def _judge_peaks(campaign, model: str, folder: Path) -> None:
    """A campaign of peaks only: no curve, hence fewer questions it can answer."""
    from ..inference.files import write_json
    from ..paper import judge_campaign

    with show_progress(f"looking at the peaks of {campaign.name}"):
        result = judge_campaign(campaign, model=model)
        write_json(folder / "result.json", result.to_dict())
    typer.echo("\n".join((result.sentence, *(f"- {note}" for note in result.notes))))
    typer.echo(f"\n{result.table().to_string(index=False)}")
    typer.echo(f"Result: {folder / 'result.json'}")
