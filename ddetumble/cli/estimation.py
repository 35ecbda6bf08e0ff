"""Commands about parameters: `fit`, `predict` and `effects`."""

from pathlib import Path
from typing import Annotated

import typer

from .._errors import InputError
from .options import EFFECT, MODEL, OWN, SOURCE, folder_option, read_source
from .places import prepare_file, prepare_folder, write_table
from .progress import show_progress


def register(app: typer.Typer) -> None:
    """Add this module's commands."""
    app.command(
        "fit",
        short_help="Fit parameters, with uncertainty and what cannot be told apart.",
        epilog="\b\nExamples:\n  ddetumble fit data/impact-c --effect wall-stiffness -o fit\n"
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
    output: Annotated[Path | None, folder_option("Folder for result and model; a specification's own.")] = None,
):
    """Fit parameters: with uncertainty, and in words which of them the data cannot tell apart. The model is the paper's
    if none is named.
    """
    read = read_source(source, model, effect, output, "fit", effects_from)
    from ..inference.estimation import fit

    with show_progress(f"fitting {read.name}") as report:
        result = fit(read.measured, **read.chosen, progress=report)
        result.save(read.folder)
    typer.echo(result.text())
    typer.echo(f"Written to {read.folder}")


def predict_records(
    model: Annotated[Path, typer.Argument(metavar="DIR", help="Folder that fit, discover or weigh wrote.")],
    conditions: Annotated[
        Path,
        typer.Argument(
            metavar="CONDITIONS.csv",
            help="Columns record, the conditions, and time (slip): one row a wanted sample, in SI.",
        ),
    ],
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="OUT.csv", help="Predictions; without it, printed.")
    ] = None,
):
    """A fitted model at new conditions: mean, its uncertainty, and that of a new measurement, for each channel."""
    for path in (model, conditions):
        if not path.exists():
            raise InputError("there is no such file or folder", file=path)
    file = prepare_file(output)
    from ..discrepancy.prediction import predict

    with show_progress(f"predicting {conditions.name}"):
        table = predict(model, conditions)
    write_table(table, file)
    for note in table.attrs["notes"]:
        typer.echo(f"ddetumble: note: {note}", err=True)
    if file is not None:
        typer.echo(f"Written to {file}: {len(table)} samples")


def show_effects(
    effect: Annotated[
        str | None, typer.Argument(metavar="[ID]", help="One effect, in full; all of them in short if not given.")
    ] = None,
    family: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="Family of records: impact, slip, oblique or tumble; all if not given."),
    ] = None,
    effects_from: Annotated[Path | None, OWN] = None,
    new: Annotated[
        str | None, typer.Option(metavar="NAME", help="Write an effect of your own to begin with, and its test.")
    ] = None,
    stage: Annotated[
        str, typer.Option(metavar="STAGE", help="Where a new one acts; a wrong name lists them all.")
    ] = "elastic",
    output: Annotated[Path, folder_option("Folder for a new one.")] = Path(),
):
    """The catalogue of effects that a model may be missing: law, parameters, units, null, reference. `--new` writes one
    of your own.
    """
    if new is not None:
        from ..effects.template import write_template

        source, test = write_template(new, stage, prepare_folder(output))
        typer.echo(f"Written: {source}, which works as it is, to be given your law, and {test}, its contract test.\n"
                   f"Next: ddetumble discover CAMPAIGN --effects-from {source}")
        return
    from ..effects import CATALOGUES, catalogue, parameters_of, stage_of
    from ..inference.models import list_effects

    try:
        families = {name: catalogue(name) for name in ([family] if family else CATALOGUES)}
    except ValueError as error:
        raise InputError(str(error)) from None
    if effects_from is not None:
        families = {effects_from.name: list_effects(effects_from), **families}
    effects = {entry.id: entry for found in families.values() for entry in found}
    if effect is None:
        width = max(map(len, effects))
        for name, found in families.items():
            typer.echo(f"{name}:" if name.endswith(".py") else f"{name} records:")
            for entry in found:
                typer.echo(f"  {entry.id:{width}}  {entry.law}")
            if name == "oblique":
                typer.echo("  (the effects on impact and slip records act on oblique impacts too)")
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
