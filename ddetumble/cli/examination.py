"""Commands that hold a model against a campaign: `compare`, `identify`, `discover` and `missing`."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .._errors import InputError
from ..reference_models import list_names
from .options import CAMPAIGN, MODEL, OVERWRITE, OWN, folder_option
from .places import Output, check_file, locate_campaign, open_folder, open_optional, write_table
from .progress import show_progress


if TYPE_CHECKING:
    from ..measurement.campaign import Campaign

MODELS = typer.Option(
    "-m", "--model", metavar="MODEL",
    help=f"Model to compare (one of `ddetumble models`: {list_names()}), a folder that fit or discover wrote, or "
    "FILE.py:NAME; may be repeated.",
)
STEPS = typer.Option(
    "-e", "--effect", metavar="ID", help="Then add this effect to the last model, fit it, and compare again; may be "
    "repeated, each on top of the ones before.",
)
KEEP = typer.Option("--keep-all", help="Leave out no record and no sample: faults are only reported.")


def register(app: typer.Typer) -> None:
    """Add this module's commands."""
    app.command(
        "compare",
        short_help="Hold a model against measurements: where it fails, against the noise.",
        epilog="\b\nExamples:\n  ddetumble compare impact-c -o comparison\n"
        "  ddetumble compare impact-h --effect wall-stiffness --effect arm-servo -o steps\n"
        "  ddetumble compare impact-h -m paper -m matunaga -m my-fit -o models",
    )(compare_models)
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


def compare_models(
    campaign: Annotated[str, CAMPAIGN],
    model: Annotated[list[str] | None, MODELS] = None,
    effect: Annotated[list[str] | None, STEPS] = None,
    effects_from: Annotated[Path | None, OWN] = None,
    output: Annotated[Path | None, folder_option("Also write compare.json and figures here.")] = None,
    overwrite: Annotated[bool, OVERWRITE] = False,
):
    """Hold models against measurements: error by channel, record and condition, against the noise. With several models,
    or effects added one after the other, their errors side by side, fitted and cross-validated.
    """
    path = locate_campaign(campaign)
    from ..measurement.package import read_campaign

    measured, page, models = read_campaign(path), None, list(model or ["paper"])
    with open_optional(output, "compare", overwrite) as out, show_progress(f"comparing {measured.name}") as report:
        if measured.samples is None:
            if len(models) > 1 or effect:
                raise InputError("the campaign holds peaks only: compare it with one model, without effects", file=path)
            text, page = _judge_peaks(measured, models[0], out, "compare.json", "comparison.html")
        else:
            from ..selection.compare import compare

            result = compare(measured, *models, *_extend(models[-1], effect or (), effects_from, measured),
                             progress=report)
            text = str(result)
            if out is not None:
                from ..reports import report_comparison

                report("drawing", 0.9)
                result.save(out.draft)
                page = out.place(report_comparison(result, out.draft))
    typer.echo(text)
    if page is not None:
        typer.echo(f"Report: {page}")


def _extend(model: str, effects: Sequence[str], path: Path | None, measured: "Campaign") -> list:
    """A model with one effect after the other, each a model of its own."""
    from ..families import name_family
    from ..inference.archive import resolve_model
    from ..inference.models import list_effects, resolve_effect

    resolved = resolve_model(model, name_family(measured))
    held = list_effects(path) if path is not None else ()
    found, law = [], resolved.reference.extend(resolved.effects)
    for one in [resolve_effect(name, held) for name in effects] or list(held):
        try:
            law = law + one
        except TypeError as error:
            raise InputError(f"--effect: {error}") from None
        found.append(law)
    return found


def identify_force(
    campaign: Annotated[str, CAMPAIGN],
    model: Annotated[str, MODEL] = "paper",
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="OUT.csv", help="Table of the force; without it, printed.")
    ] = None,
    overwrite: Annotated[bool, OVERWRITE] = False,
):
    """The paper's own task: force with uncertainty from measured depression and pressure, against the gauge where there
    is one.
    """
    path = locate_campaign(campaign)
    from ..measurement.package import read_campaign

    measured = read_campaign(path)
    file = check_file(output, overwrite)
    from ..reconstruct.force import identify

    with show_progress(f"identifying the force of {measured.name}"):
        result = identify(measured, model=model)
    write_table(result.table, file)
    typer.echo(str(result), err=file is None)
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
    overwrite: Annotated[bool, OVERWRITE] = False,
):
    """Find the missing physics: compare, say where the model fails, rank the effects, add one, refit, until nothing is
    missing or nothing helps.
    """
    path = locate_campaign(campaign)
    from ..measurement.package import read_campaign

    measured = read_campaign(path)
    target, alike = output or Path(f"{measured.name}-discovery"), False
    with open_folder(target, "discover", overwrite) as out, show_progress(f"looking at {measured.name}") as report:
        if measured.samples is None:
            text, page = _judge_peaks(measured, model, out, "result.json", "report.html")
        else:
            from ..inference.models import list_effects, resolve_effect
            from ..reports import write_report
            from ..selection.discover import discover

            held = list_effects(effects_from) if effects_from is not None else ()
            own = list(dict.fromkeys([*(resolve_effect(name, held) for name in effect or ()), *held]))
            for one in own:
                _prove_contract(one, model, measured.family)
            result = discover(measured, model=model, effects=own, keep_all=keep_all, progress=report)
            report("writing the report", 0.95)
            result.save(out.draft)
            page = out.place(write_report(result, out.draft))
            text, alike = str(result), bool(result.steps[-1].alternatives)
    typer.echo(text)
    typer.echo(f"Report: {page}")
    if alike:
        typer.echo(f"The test that tells them apart: ddetumble design {target}")


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
    overwrite: Annotated[bool, OVERWRITE] = False,
):
    """Draw the missing force: how much of the misfit any force of depression, rate, slip, time or pressure could remove
    on left-out conditions, what it looks like, and which simple laws would draw it. `discover` does so itself where its
    verdict is improved or unexplained.
    """
    path = locate_campaign(campaign)
    from ..measurement.package import read_campaign

    measured = read_campaign(path)
    from ..inference.files import list_versions, write_json
    from ..inference.models import list_effects, resolve_effect
    from ..reports import write_missing
    from ..selection.missing.missing_force import draw_missing_force

    held = list_effects(effects_from) if effects_from is not None else ()
    own = [resolve_effect(name, held) for name in effect or ()] or list(held)
    with (open_folder(output or Path(f"{measured.name}-missing"), "missing", overwrite) as out,
          show_progress(f"looking at {measured.name}") as report):
        for one in own:
            _prove_contract(one, model, measured.family)
        found = draw_missing_force(measured, model, effects=own, keep_all=keep_all, progress=report)
        report("writing the report", 0.97)
        write_json(out.draft / "missing.json", {"campaign": measured.name, "model": model, "sha256": measured.sha256,
                                             **found.to_dict(), "versions": list_versions()})
        page = out.place(write_missing(
            found, out.draft, title=f"{measured.name}: the missing force",
            status=(measured.name, f"{len(measured.records)} records", f"reference model {model}")))
    typer.echo(str(found))
    typer.echo(f"Report: {page}")


def _prove_contract(effect, model: str, family: str) -> None:
    """Refuse an effect of the user's own that breaks the contract on which verdicts rely."""
    from ..contact.contract import check_effect
    from ..contact.effect import family_of
    from ..families import FAMILIES
    from ..inference.archive import resolve_model

    own = FAMILIES.get(family)  # the trials of the contract are those of the toolkit's own families
    if own is not None and family_of(effect) == family and effect not in own.catalogue:
        check_effect(effect, resolve_model(model, family).reference).require()


def _judge_peaks(campaign, model: str, out: Output | None, file: str, page: str) -> tuple[str, Path | None]:
    """Judge a campaign of peaks only, and write that where there is a place: no curve, hence fewer answers.

    Returns:
        Text for the terminal, and the page's path.
    """
    from ..paper import judge_campaign, write_peaks

    result, written = judge_campaign(campaign, model=model), None
    if out is not None:
        from ..inference.files import list_versions, write_json

        write_json(out.draft / file, {**result.to_dict(), "kind": "peaks", "sha256": campaign.sha256,
                                      "versions": list_versions()})
        written = out.place(write_peaks(result, out.draft, page))
    lines = (result.sentence, *(f"- {note}" for note in result.notes), "", result.table().to_string(index=False))
    return "\n".join(lines), written
