"""Commands about parameters: `fit`, `predict` and `effects`."""

from pathlib import Path
from typing import Annotated

import typer

from .._errors import InputError
from .options import (
    EFFECT,
    FAMILY,
    FIX,
    FREE,
    MODEL,
    OVERWRITE,
    OWN,
    PRIOR,
    SOURCE,
    Choice,
    choose_families,
    folder_option,
    read_source,
)
from .places import check_file, write_bytes, write_table
from .progress import show_progress


def register(app: typer.Typer) -> None:
    """Add this module's commands."""
    app.command(
        "fit",
        short_help="Fit parameters, with uncertainty and what cannot be told apart.",
        epilog="\b\nExamples:\n  ddetumble fit data/impact-b --effect adhesion -o fit\n"
        "  ddetumble fit data/impact-h -e arm-servo -e wall-stiffness --free wall-stiffness.q -o fit\n"
        "  ddetumble fit data/impact-b --fix \"effective_mass=1.2 kg\" --prior restitution=0.7+-0.05 -o fit\n"
        "  ddetumble fit fits/impact-b/fit.toml",
    )(fit_parameters)
    app.command(
        "predict",
        short_help="A fitted model at new conditions, with uncertainty.",
        epilog="\b\nExample:\n  ddetumble predict fit conditions.csv -o predictions.csv",
    )(predict_records)
    app.command(
        "effects",
        short_help="The catalogue of effects that a model may be missing.",
        epilog="\b\nExamples:\n  ddetumble effects\n  ddetumble effects wall-stiffness\n"
        "  ddetumble effects --new rim-stop --stage elastic -o mine",
    )(show_effects)


def fit_parameters(
    source: Annotated[str, SOURCE],
    model: Annotated[str | None, MODEL] = None,
    effect: Annotated[list[str] | None, EFFECT] = None,
    effects_from: Annotated[Path | None, OWN] = None,
    free: Annotated[list[str] | None, FREE] = None,
    fix: Annotated[list[str] | None, FIX] = None,
    prior: Annotated[list[str] | None, PRIOR] = None,
    output: Annotated[Path | None, folder_option("Folder for result and model; a specification's own.")] = None,
    overwrite: Annotated[bool, OVERWRITE] = False,
):
    """Fit parameters: with uncertainty, and in words which of them the data cannot tell apart. The model is the paper's
    if none is named.
    """
    read = read_source(source, Choice(model, effect, effects_from, free, fix, prior), output, "fit")
    from ..inference.archive import FILE as MODEL_FILE
    from ..inference.estimation import fit
    from ..inference.findings import FILE

    with read.open("fit", overwrite, (FILE, MODEL_FILE)) as out, show_progress(f"fitting {read.name}") as report:
        result = fit(read.measured, **read.chosen, progress=report)
        result.save(out.draft)
    typer.echo(str(result))
    typer.echo(f"Written to {read.folder}")


def predict_records(
    model: Annotated[Path, typer.Argument(metavar="DIR", help="Folder that fit, discover or average wrote.")],
    conditions: Annotated[
        Path,
        typer.Argument(
            metavar="CONDITIONS.csv",
            help="Columns record, the conditions, and time (slip): one row a wanted sample, in SI or in the unit of "
            "the heading, 'initial_pressure [MPa]'. Without time (slip), one row a record.",
        ),
    ],
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="OUT.csv", help="Predictions, a figure OUT.png, and of impacts "
                     "OUT-pulses.csv; without it, the predictions are printed."),
    ] = None,
    overwrite: Annotated[bool, OVERWRITE] = False,
):
    """A fitted model at new conditions: mean, its uncertainty, and that of a new measurement, for each channel; of
    impacts also peak force, contact duration and impulse.
    """
    for path in (model, conditions):
        if not path.exists():
            raise InputError("there is no such file or folder", file=path)
    file = check_file(output, overwrite)
    picture, values = ((None, None) if file is None else
                       (file.with_suffix(".png"), file.with_name(f"{file.stem}-pulses.csv")))
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
        typer.echo(f"{format_pulses(pulses)}\n± of the mean; in brackets, of a new test", err=file is None)
    for note in (*table.attrs["notes"], *(() if pulses is None else pulses.attrs["notes"])):
        typer.echo(f"ddetumble: note: {note}", err=True)
    if file is not None:
        typer.echo(f"Written to {file}: {len(table)} samples; drawn in {picture}")


def show_effects(
    effect: Annotated[
        str | None, typer.Argument(metavar="[ID]", help="One effect, in full; all of them in short if not given.")
    ] = None,
    family: Annotated[str | None, FAMILY] = None,
    effects_from: Annotated[Path | None, OWN] = None,
    new: Annotated[
        str | None, typer.Option(metavar="NAME", help="Write an effect of your own to begin with, and its test.")
    ] = None,
    stage: Annotated[
        str, typer.Option(metavar="STAGE", help="Where a new one acts; a wrong name lists them all.")
    ] = "elastic",
    output: Annotated[Path, folder_option("Folder for a new one.")] = Path(),
    overwrite: Annotated[bool, OVERWRITE] = False,
):
    """The catalogue of effects that a model may be missing: law, parameters, units, null, reference. `--new` writes one
    of your own.
    """
    if new is not None:
        source, test = _write_template(new, stage, output, overwrite)
        typer.echo(f"Written: {source}, which works as it is, to be given your law, and {test}, its contract test.\n"
                   f"Next: ddetumble discover CAMPAIGN --effects-from {source}")
        return
    from ..contact.effect import parameters_of, stage_of
    from ..families import list_families
    from ..inference.models import list_effects

    families = {one.name: one.effects for one in choose_families(family)}
    if effects_from is not None:
        families = {effects_from.name: list_effects(effects_from), **families}
    effects = {entry.id: entry for found in families.values() for entry in found}
    if effect is None:
        width = max(map(len, effects))
        for name, found in families.items():
            typer.echo(f"{name}:" if name.endswith(".py") else f"{name} records:")
            for entry in found:
                typer.echo(f"  {entry.id:{width}}  {entry.law}")
            others = [other for one in list_families() if one.name == name for other in one.accepts if other != name]
            if others:
                typer.echo(f"  (the effects on {' and '.join(others)} records act on these too)")
        return
    if effect not in effects:
        raise InputError(f"there is no effect {effect!r}; there are {', '.join(effects)}")
    entry = effects[effect]
    typer.echo(f"{entry.id}\n  law        {entry.law}\n  stage      {stage_of(entry)}")
    for parameter in parameters_of(entry):
        typer.echo(f"  parameter  {_describe_parameter(parameter)}")
        if parameter.limits_reason:
            typer.echo(f"    limits   {describe_limits(parameter)}")
    typer.echo(f"  reference  {entry.reference}")


def _write_template(name: str, stage: str, folder: Path, overwrite: bool) -> tuple[Path, Path]:
    """Write an effect to begin with and its test, both or neither; returns their paths."""
    import tempfile

    from ..effects.template import write_template

    with tempfile.TemporaryDirectory() as draft:
        made = write_template(name, stage, Path(draft))
        source, test = (folder / file.name for file in made)
        for file in (source, test):
            check_file(file, overwrite)
        for file, target in zip(made, (source, test), strict=True):
            write_bytes(file.read_bytes(), target)
    return source, test


def _describe_parameter(parameter) -> str:
    """One line on a parameter: name, unit, where it is absent or starts, and what it is."""
    unit = f" [{parameter.unit}]" if parameter.unit else ""
    value = f"{'null' if parameter.kind == 'amplitude' else 'from'} {parameter.default:g}"
    return f"{parameter.name}{unit}, {value}: {parameter.text}"


def describe_limits(parameter) -> str:
    """What physics allows of a parameter, in words, and why."""
    low, high = parameter.limits
    unit = f" {parameter.unit}" if parameter.unit else ""
    span = f"{low:g} to {high:g}{unit}" if high < float("inf") else f"from {low:g}{unit}"
    return f"{span}: {parameter.limits_reason}"
