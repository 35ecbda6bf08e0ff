"""Commands that hold a model against a campaign: `compare`, `discover`, `missing` and `identify`."""

import dataclasses as dc
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .._errors import InputError
from ..reference_models import list_names
from .options import CampaignName, KeepAll, Model, Overwrite, OwnFile, Texts, command, option, place, resolve_own
from .places import check_file, locate_campaign, open_folder, open_optional, tell_page, write_table
from .progress import show_progress


if TYPE_CHECKING:
    from ..measurement.campaign import Campaign
    from ..selection.compare import Comparison, Comparisons


@command("compare", "Hold a model against measurements: where it fails, against the noise.",
         "compare impact-c -o comparison", "compare impact-h --effect wall-stiffness --effect arm-servo -o steps",
         "compare impact-h -m paper -m matunaga -m my-fit -o models")
def compare_models(
    campaign: CampaignName,
    model: Annotated[Texts, option(
        "MODEL", f"Model to compare (one of `ddetumble models`: {list_names()}), a folder that fit or discover wrote, "
        "or FILE.py:NAME; may be repeated.", "-m", "--model")] = None,
    effect: Annotated[Texts, option(
        "ID", "Then add this effect to the last model, fit it, and compare again; may be repeated, each on top of the "
        "ones before.", "-e", "--effect")] = None,
    effects_from: OwnFile = None,
    output: Annotated[Path | None, place("Also write compare.json and figures here.")] = None,
    overwrite: Overwrite = False,
):
    """Hold models against measurements: error by channel, record and condition, against the noise. With several models,
    or effects added one after the other, their errors side by side, fitted and cross-validated.
    """
    measured, page, models = _read(campaign), None, list(model or ["paper"])
    with open_optional(output, "compare", overwrite) as out, show_progress(f"comparing {measured.name}") as report:
        from ..selection.compare import compare

        result = compare(measured, *models, *_extend(models[-1], effect, effects_from, measured), progress=report)
        if out is not None:
            from ..reports import report_comparison

            report("drawing", 0.9)
            result.save(out.draft)
            page = out.draw(lambda draft: report_comparison(result, draft), report)
    typer.echo(str(result))
    code = None if out is None else tell_page(page, out.path)
    for line in _list_further(result, campaign, models[0], measured):
        typer.echo(line)
    return code


def _list_further(result: "Comparison | Comparisons", campaign: str, model: str, measured: "Campaign") -> list[str]:
    """Commands that go on from one model that fails: what is missing, and, where it fails by far, other models."""
    from ..contact.effect import identify_model
    from ..families import find_family, name_family
    from ..inference.archive import resolve_model
    from ..selection.compare import Comparison
    from ..selection.settings import DEFAULT

    family = find_family(name_family(measured))
    if not isinstance(result, Comparison) or not result.lack_of_fit.rejected:
        return []
    chosen = ["-m", model] if model != "paper" else []
    found = [f"What is missing: ddetumble discover {shlex.join([campaign, *chosen])}"]
    own = identify_model(resolve_model(model, name_family(measured)).reference)
    others = [name for name, built in family.models.items()
              if built.is_rival(measured.known) and identify_model(built.make()) != own]
    if others and result.chi2_reduced > DEFAULT.far:
        beside = shlex.join([campaign, *(word for name in (model, *others) for word in ("-m", name))])
        found.append(f"Other reference models beside it: ddetumble compare {beside}")
    return found


def _extend(model: str, effects: Texts, path: Path | None, measured: "Campaign") -> list:
    """A model with one effect after the other, each a model of its own."""
    from ..families import name_family
    from ..inference.archive import resolve_model

    resolved = resolve_model(model, name_family(measured))
    named, held = resolve_own(effects, path)
    found, law = [], resolved.reference.extend(resolved.effects)
    for one in named or held:
        try:
            law = law + one
        except TypeError as error:
            raise InputError(f"--effect: {error}") from None
        found.append(law)
    return found


@command("discover", "Find the missing physics, and write the report.", "discover data/impact-c -o discovery",
         "discover data/impact-h --effect my_effects.py:EndStop -o discovery")
def discover_effects(
    campaign: CampaignName,
    output: Annotated[Path | None, place("Folder for result.json, report.html and the grown model.")] = None,
    model: Model = "paper",
    effect: Annotated[Texts, option(
        "FILE.py:NAME", "Try this effect of your own beside the catalogue; may be repeated.", "-e", "--effect")] = None,
    effects_from: Annotated[Path | None, option("FILE.py", "Try all effects of this file of yours.")] = None,
    effort: Annotated[int | None, option(
        "ROUNDS", "Search at most so many rounds, in each of which every effect is tried beside a model; the verdict "
                  "says what was left out for want of more. If not given, 40.",
        min=1)] = None,
    keep_all: KeepAll = False,
    overwrite: Overwrite = False,
):
    """Find the missing physics: compare, say where the model fails, rank the effects, add one, refit, until nothing is
    missing or nothing helps.
    """
    measured = _read(campaign)
    target = output or Path(f"{measured.name}-discovery")
    with open_folder(target, "discover", overwrite) as out, show_progress(f"looking at {measured.name}") as report:
        from ..reports import write_report
        from ..selection.discover import discover
        from ..selection.settings import DEFAULT
        from ..selection.verdict_facts import find_nearer

        named, held = resolve_own(effect, effects_from)
        own = list(dict.fromkeys([*named, *held]))
        _prove_contracts(own, model, measured.family)
        _refuse_catalogue(named, campaign, measured.family)
        result = discover(measured, model=model, effects=own, keep_all=keep_all, progress=report,
                          settings=DEFAULT if effort is None else dc.replace(DEFAULT, effort=effort))
        report("writing the results", 0.98)
        result.save(out.draft)
        shown = shlex.join(["compare", campaign, "-m", str(target), "-o", f"{target}-page"])
        page = out.draw(lambda draft: write_report(result, draft), report,
                        f"`ddetumble {shown}` draws the model that was found beside the records")
    typer.echo(str(result))
    code = tell_page(page, out.path)
    near = find_nearer(result)
    if near is not None:
        typer.echo(f"To begin with the nearer reference model: ddetumble discover {shlex.quote(campaign)} "
                   f"-m {near['model']}")
    if result.more_effort is not None:
        again = [campaign, *(["-m", model] if model != "paper" else []), "--effort", str(result.more_effort)]
        typer.echo(f"To search on: ddetumble discover {shlex.join([*again, '-o', f'{target}-{result.more_effort}'])}")
    where = shlex.quote(str(target))
    if len(result.explanations) > 1 or result.rivals:
        typer.echo(f"The test that tells them apart: ddetumble design {where}")
    elif result.verdict in ("explained", "nothing-missing"):
        typer.echo(f"Other conditions: ddetumble predict {where} CONDITIONS.csv -o predictions.csv")
        typer.echo(f"The next test, which narrows its parameters most: ddetumble design {where}")
    return code


@command("missing", "Draw the force that a model lacks, and the simple laws that would draw it.",
         "missing data/impact-f -o force", "missing data/impact-f --effect wall-stiffness -o force")
def draw_force(
    campaign: CampaignName,
    output: Annotated[Path | None, place("Folder for missing.json and missing.html.")] = None,
    model: Model = "paper",
    effect: Annotated[Texts, option(
        "EFFECT", "Fit this effect with the model: an id of the catalogue, or of --effects-from, or FILE.py:NAME; may "
        "be repeated.", "-e", "--effect")] = None,
    effects_from: OwnFile = None,
    keep_all: KeepAll = False,
    overwrite: Overwrite = False,
):
    """Draw the missing force: how much of the misfit any force of depression, rate, slip, time or pressure could remove
    on left-out conditions, what it looks like, and which simple laws would draw it. `discover` does so itself where its
    verdict is improved or unexplained.
    """
    measured = _read(campaign)
    from ..inference.files import list_versions, write_json
    from ..reports import write_missing
    from ..selection.missing.missing_force import draw_missing_force

    named, held = resolve_own(effect, effects_from)
    own = named or held
    with (open_folder(output or Path(f"{measured.name}-missing"), "missing", overwrite) as out,
          show_progress(f"looking at {measured.name}") as report):
        _prove_contracts(own, model, measured.family)
        found = draw_missing_force(measured, model, effects=own, keep_all=keep_all, progress=report)
        report("writing the report", 0.97)
        write_json(out.draft / "missing.json", {"campaign": measured.name, "model": model, "sha256": measured.sha256,
                                             **found.to_dict(), "versions": list_versions()})
        page = out.draw(lambda draft: write_missing(
            found, draft, title=f"{measured.name}: the missing force",
            status=(measured.name, f"{len(measured.records)} records", f"reference model {model}")), report)
    typer.echo(str(found))
    return tell_page(page, out.path)


@command("identify", "Force from measured depression and pressure, with uncertainty.",
         "identify data/impact-i -o forces.csv")
def identify_force(
    campaign: CampaignName,
    model: Model = "paper",
    output: Annotated[Path | None, place("Table of the force; without it, printed.", "OUT.csv")] = None,
    overwrite: Overwrite = False,
):
    """The paper's own task: force with uncertainty from measured depression and pressure, against the gauge where there
    is one.
    """
    measured = _read(campaign)
    file = check_file(output, overwrite)
    from ..reconstruct.force import identify

    with show_progress(f"identifying the force of {measured.name}"):
        result = identify(measured, model=model)
    write_table(result.table, file)
    typer.echo(str(result), err=file is None)
    if file is not None:
        typer.echo(f"Written to {file}")


def _read(campaign: str) -> "Campaign":
    from ..measurement.package import read_campaign

    return read_campaign(locate_campaign(campaign))


def _refuse_catalogue(effects: Sequence, campaign: str, family: str) -> None:
    """Refuse effects of the catalogue where those of the user's own are asked for: each is tried anyway."""
    from ..families import FAMILIES
    from ..measurement.quantities import join_words

    own = FAMILIES.get(family)
    known = [effect.id for effect in effects if own is not None and effect in own.catalogue]
    if known:
        start = shlex.join(["fit", campaign, *(word for one in known for word in ("-e", one)), "-o", "fit"])
        raise InputError(f"{join_words(known, 'and')} of the catalogue {'is' if len(known) == 1 else 'are'} tried "
                         "anyway; leave the option out, or begin the search with the effect in the model: "
                         f"`ddetumble {start}`, then `ddetumble discover {shlex.quote(campaign)} -m fit`",
                         option="--effect")


def _prove_contracts(effects: Sequence, model: str, family: str) -> None:
    """Refuse effects of the user's own that break the contract on which verdicts rely."""
    from ..contact.contract import check_effect
    from ..contact.effect import family_of
    from ..families import FAMILIES
    from ..inference.archive import resolve_model

    own = FAMILIES.get(family)  # the trials of the contract are those of the toolkit's own families
    for effect in effects:
        if own is not None and family_of(effect) == family and effect not in own.catalogue:
            check_effect(effect, resolve_model(model, family).reference).require()

