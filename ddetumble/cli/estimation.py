"""Commands about parameters: `fit` and `predict`."""

from pathlib import Path
from typing import Annotated

import typer

from .._errors import InputError
from .options import (
    Bound,
    Effects,
    Fix,
    Free,
    OptionalModel,
    Overwrite,
    OwnFile,
    Prior,
    Texts,
    command,
    name_own,
    option,
    place,
    read_source,
)
from .places import check_file, open_folder, tell_page, write_bytes, write_table
from .progress import show_progress


@command("fit", "Fit parameters, with their uncertainty and identifiability.",
         "fit data/impact-b --effect adhesion -o fit",
         "fit data/impact-h -e arm-servo -e wall-stiffness --free wall-stiffness.q -o fit",
         'fit data/impact-b --fix "effective_mass=1.2 kg" --prior restitution=0.7+-0.05 -o fit',
         'fit data/impact-b --bound restitution=0.5..0.9 --bound "effective_mass=1..1.5 kg" -o fit',
         "fit fits/impact-b/fit.toml", "fit normal oblique friction --own restitution -o ball",
         "fit ball-1 ball-2 ball-3 ball-4 --population -o balls")
def fit_parameters(
    sources: Annotated[list[str], typer.Argument(
        metavar="CAMPAIGN|fit.toml", help="Campaign (folder or name of a shipped one), or a complete specification "
        "of a fit. Several are fitted together: parameters of the same name are shared.")],
    model: OptionalModel = None,
    effect: Effects = None,
    effects_from: OwnFile = None,
    free: Free = None,
    fix: Fix = None,
    prior: Prior = None,
    bound: Bound = None,
    output: Annotated[Path | None, place("Folder for result and model; for one fit.toml, its own by default.")] = None,
    own: Annotated[Texts, option("NAME", "Of several campaigns: each keeps this parameter for itself; may be "
                                         "repeated.")] = None,
    population: Annotated[bool, typer.Option(
        "--population", help="The campaigns are of as many specimens (balls): estimate how far they differ.")] = False,
    profile: Annotated[bool, typer.Option("--profile", help=(
        "Find 95 % intervals by refitting where the records see a parameter as a curve."))] = False,
    overwrite: Overwrite = False,
):
    """Fit parameters, with their uncertainty and a statement of which of them the data cannot distinguish. If no model
    is named, it is the paper's. Several campaigns of one ball share its parameters, and the answer says whether they
    agree; with --population each is of another ball. A folder that -o names gets a page with figures, too.
    """
    if profile and len(sources) > 1:
        raise InputError("--profile is of one campaign")
    if len(sources) > 1:
        return _fit_several(sources, output, effects_from, model, effect, own or [], population, overwrite,
                            bool(free or fix or prior or bound))
    if own or population:
        raise InputError("--own and --population take several campaigns")
    read = read_source(sources[0], output, "fit", effects_from, model=model, effects=effect, free=free, fixed=fix,
                       priors=prior, bounds=bound)
    from ..inference.archive import FILE as MODEL_FILE
    from ..inference.estimation import fit
    from ..inference.findings import FILE

    page = None
    with read.open("fit", overwrite, (FILE, MODEL_FILE)) as out, show_progress(f"fitting {read.name}") as report:
        result = fit(read.measured, **read.chosen, progress=report)
        if profile:
            report("refitting for the ends of intervals", 0.97)
            result = result.profiled()
        result.save(out.draft)
        if output is not None:
            from ..reports.fit import report_fit

            report("drawing the page", 0.99)
            page = out.draw(lambda draft: report_fit(result, draft), report)
    typer.echo(str(result))
    code = tell_page(page, read.folder)
    return None if output is None else code


def _fit_several(sources: list[str], output: Path | None, effects_from: Path | None, model: str | None,
                 effects: Texts, own: list[str], population: bool, overwrite: bool, others: bool):
    """Fit several campaigns together, or as specimens; an effect goes to those of a kind on which it acts."""
    if others:
        raise InputError("--free, --fix, --prior and --bound are of one campaign; give each of several a fit.toml, "
                         "and name these files")
    if population and own:
        raise InputError("--own is for campaigns that share parameters; with --population they share none")
    from ..contact.effect import family_of
    from ..families import find_family, name_family
    from ..figures import draw_forest, render_png
    from ..inference.estimation import fit
    from ..inference.joint import fit_jointly
    from ..inference.models import resolve_effect
    from ..inference.population import fit_population

    named, found = name_own(effects or (), effects_from), []
    for text in sources:
        read = read_source(text, None, "", None, model=None, effects=None, free=None, fixed=None, priors=None)
        if read.chosen:  # a specification says everything itself
            accepted = find_family(name_family(read.measured)).accepts
            read.chosen.update(model=model or "paper", effects=[
                name for name in named if family_of(resolve_effect(name)) in accepted])
        found.append(read)
    for name in named:
        if not any(name in read.chosen.get("effects", ()) for read in found):
            raise InputError(f"effect {name!r} acts on the records of none of these campaigns")
    ending = "population" if population else "joint"
    with open_folder(output or Path(f"{found[0].name}-{ending}"), "fit", overwrite) as out, \
            show_progress(f"fitting {found[0].name}") as report:
        fits = [fit(read.measured, **read.chosen, progress=report) for read in found]
        result = fit_population(fits) if population else fit_jointly(fits, own=own)
        result.save(out.draft)

        def draw(draft: Path) -> Path:
            write_bytes(render_png(draw_forest(result.intervals)), draft / "estimates.png")
            if output is None:
                return draft
            from ..reports.joint import report_joint

            report("drawing the page", 0.99)
            return report_joint(result, draft)

        page = out.draw(draw, report)
    typer.echo(str(result))
    code = tell_page(None if output is None else page, out.path)
    return None if page is not None else code


@command("predict", "Predict with a fitted model at new conditions, with uncertainty.",
         "predict fit conditions.csv -o predictions.csv")
def predict_records(
    model: Annotated[Path, typer.Argument(metavar="DIR", help="Folder that fit, discover or average wrote.")],
    conditions: Annotated[Path, typer.Argument(
        metavar="CONDITIONS.csv", help="Table with the columns record, the conditions and time (or slip): one row per "
        "sample, in SI or in the unit of the heading, 'initial_pressure [MPa]'. Without time (slip), one row per "
        "record.")],
    output: Annotated[Path | None, place(
        "File for the predictions, with a figure OUT.png and, for impacts, OUT-pulses.csv; if not given, they are "
        "printed.",
        "OUT.csv")] = None,
    gauge: Annotated[bool | None, typer.Option("--gauge/--absolute", help="Whether the pressures of the table are "
                                               "gauge pressures, or absolute; without either they are taken as "
                                               "absolute.")] = None,
    ambient: Annotated[str | None, option(
        "QUANTITY", "Ambient pressure that is added to gauge pressures: '101.3 kPa'; that of the campaign, if it "
                    "states one.")] = None,
    overwrite: Overwrite = False,
):
    """Predict with a fitted model at new conditions: for each channel the mean, its uncertainty and that of a new
    measurement; for impacts also the peak force, the contact duration and the impulse.
    """
    for path in (model, conditions):
        if not path.exists():
            raise InputError("there is no such file or folder", file=path)
    file = check_file(output, overwrite)
    picture = values = None
    if file is not None:
        picture, values = file.with_suffix(".png"), file.with_name(f"{file.stem}-pulses.csv")
        for other in (picture, values):
            check_file(other, overwrite)
    from ..selection.predict import format_pulses, has_pulses, predict, predict_pulses

    with show_progress(f"predicting {conditions.name}") as report:
        table = predict(model, conditions, gauge=gauge, ambient=ambient)
        pulses = predict_pulses(model, conditions, gauge=gauge, ambient=ambient) if has_pulses(model) else None
        image = b""
        if picture is not None:
            from ..figures import draw_prediction, render_png

            report("drawing", 0.8)
            image = render_png(draw_prediction(table, table.attrs["settings"]))
    if picture is not None:
        write_bytes(image, picture)
    if pulses is not None and values is not None:
        write_table(pulses, values)
    write_table(table, file)
    if pulses is not None:
        typer.echo(f"{format_pulses(pulses)}\n± sd of the mean; in brackets, sd of a new test", err=file is None)
    for note in (*table.attrs["notes"], *(() if pulses is None else pulses.attrs["notes"])):
        typer.echo(f"ddetumble: note: {note}", err=True)
    if file is not None:
        typer.echo(f"Written to {file} ({len(table)} samples) and drawn in {picture}")
