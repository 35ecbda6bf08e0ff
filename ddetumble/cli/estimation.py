"""Commands about parameters: `fit` and `predict`."""

from pathlib import Path
from typing import Annotated

import typer

from .._errors import InputError
from .options import Effects, Fittable, Fix, Free, OptionalModel, Overwrite, OwnFile, Prior, command, place, read_source
from .places import check_file, write_bytes, write_table
from .progress import show_progress


@command("fit", "Fit parameters, with their uncertainty and identifiability.",
         "fit data/impact-b --effect adhesion -o fit",
         "fit data/impact-h -e arm-servo -e wall-stiffness --free wall-stiffness.q -o fit",
         'fit data/impact-b --fix "effective_mass=1.2 kg" --prior restitution=0.7+-0.05 -o fit',
         "fit fits/impact-b/fit.toml")
def fit_parameters(
    source: Fittable,
    model: OptionalModel = None,
    effect: Effects = None,
    effects_from: OwnFile = None,
    free: Free = None,
    fix: Fix = None,
    prior: Prior = None,
    output: Annotated[Path | None, place("Folder for result and model; for fit.toml, its own by default.")] = None,
    overwrite: Overwrite = False,
):
    """Fit parameters, with their uncertainty and a statement of which of them the data cannot distinguish. If no model
    is named, it is the paper's.
    """
    read = read_source(source, output, "fit", effects_from, model=model, effects=effect, free=free, fixed=fix,
                       priors=prior)
    from ..inference.archive import FILE as MODEL_FILE
    from ..inference.estimation import fit
    from ..inference.findings import FILE

    with read.open("fit", overwrite, (FILE, MODEL_FILE)) as out, show_progress(f"fitting {read.name}") as report:
        result = fit(read.measured, **read.chosen, progress=report)
        result.save(out.draft)
    typer.echo(str(result))
    typer.echo(f"Written to {read.folder}")


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
        table = predict(model, conditions)
        pulses = predict_pulses(model, conditions) if has_pulses(model) else None
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
