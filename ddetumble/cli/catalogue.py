"""Commands that list what a model can be made of: `effects` and `models`."""

import shlex
import tempfile
from pathlib import Path
from typing import Annotated, Any

import typer

from .._errors import InputError, offer_names
from .._user_files import split_name
from .options import Family, Overwrite, OwnFile, command, option, place
from .places import check_file, write_bytes


@command("effects", "The catalogue of effects that a model may be missing.", "effects", "effects wall-stiffness",
         "effects --new rim-stop --stage elastic -o mine")
def show_effects(
    effect: Annotated[
        str | None, typer.Argument(metavar="[ID]", help="An effect to show in full; if none is given, all are listed.")
    ] = None,
    family: Family = None,
    effects_from: OwnFile = None,
    new: Annotated[str | None, option("NAME", "Write a file for an effect of your own, and its test.")] = None,
    stage: Annotated[str, option("STAGE", "Stage at which it acts; a wrong name lists all stages.")] = "elastic",
    output: Annotated[Path, place("Folder for the new effect.")] = Path(),
    overwrite: Overwrite = False,
):
    """The catalogue of effects that a model may be missing: law, parameters, units, null, reference. `--new` writes a
    file for one of your own.
    """
    if new is not None:
        from ..effects.template import write_template

        with tempfile.TemporaryDirectory() as draft:
            made = write_template(new, stage, Path(draft))
            source, test = written = [output / file.name for file in made]
            for file in written:
                check_file(file, overwrite)
            for file, target in zip(made, written, strict=True):
                write_bytes(file.read_bytes(), target)
        typer.echo(f"Written to {source}, which runs as it is and awaits your law, and {test}, its contract test.\n"
                   f"Next: ddetumble discover CAMPAIGN --effects-from {shlex.quote(str(source))}")
        return
    from ..contact.effect import parameters_of, stage_of
    from ..inference.models import list_effects

    chosen = _choose_families(family)
    families = {one.name: one.effects for one in chosen}
    if effects_from is not None:
        families = {effects_from.name: list_effects(effects_from), **families}
    effects = {entry.id: entry for found in families.values() for entry in found}
    if effect is None:
        width = max(map(len, effects))
        for name, found in families.items():
            typer.echo(f"{name}:" if name.endswith(".py") else f"{name} records:")
            for entry in found:
                typer.echo(f"  {entry.id:{width}}  {entry.law}")
            others = [other for one in chosen if one.name == name for other in one.accepts if other != name]
            if others:
                typer.echo(f"  (the effects for {' and '.join(others)} records also apply to these)")
        return
    if effect not in effects:
        raise InputError(f"there is no effect {effect!r}; {offer_names(effect, effects, 'there are')}", option="ID")
    entry = effects[effect]
    typer.echo(f"{entry.id}\n  law        {entry.law}\n  stage      {stage_of(entry)}")
    for one in parameters_of(entry):
        start = f"{'null' if one.kind == 'amplitude' else 'from'} {one.default:g}{'' if one.free else ', held'}"
        typer.echo(_describe_parameter(one, start, bool(one.limits_reason)))
    if entry.requires:
        from ..measurement.kinds import name_need

        needs = [name_need(need, [one.kind for one in chosen]) for need in entry.requires]
        typer.echo(f"  needs      {'; '.join(needs)}")
    typer.echo(f"  reference  {entry.reference}")


@command("models", "The reference models to start from: law, parameters, source.", "models", "models power-law",
         "models --family slip")
def show_models(
    name: Annotated[
        str | None, typer.Argument(metavar="[NAME]", help="A model to show in full; if none is given, all are listed.")
    ] = None,
    family: Family = None,
):
    """The reference models that come with the toolkit, by family of records: what `--model NAME` stands for. With a
    name: its law, its parameters with their physical limits, and its source.
    """
    families = {one.name: one.models for one in _choose_families(family)}
    if name is None:
        width = max(len(one) for models in families.values() for one in models)
        for key, models in families.items():
            typer.echo(f"{key} records:")
            for one, model in models.items():
                typer.echo(f"  {one:{width}}  {model.text}")
        return
    found = {key: models[name] for key, models in families.items() if name in models}
    if not found:
        known = dict.fromkeys(one for models in families.values() for one in models)
        raise InputError(f"there is no model {name!r}; {offer_names(name, known, 'there are')}", option="NAME")
    from ..contact.effect import list_choices, parameters_of, read_field, read_validity

    for key, model in found.items():
        made = model.make()
        typer.echo(f"{name} ({key} records)\n  {model.text}\n  law        {model.law}")
        for one in parameters_of(made):
            start = f"{float(read_field(made, one.field)):g}, {'fitted' if one.free else 'held'}"
            typer.echo(_describe_parameter(one, start, True))
        for path, choice in list_choices(made).items():
            typer.echo(f"  choice     {path} = {'none' if choice in ('', None) else choice}")
        for condition, (low, high) in read_validity(made).items():
            typer.echo(f"  holds for  {condition} from {low:g} to {high:.4g} (SI)")
        typer.echo(f"  source     {model.source}")


def _choose_families(name: str | None) -> tuple[Any, ...]:
    """The family of that name, or `FILE.py:NAME`; all where none is named."""
    from ..families import list_families
    from ..measurement.kinds import take_kind

    wanted = take_kind(name) if name is not None and split_name(name) is not None else name
    found = tuple(one for one in list_families() if wanted in (None, one.name))
    if not found:
        known = ", ".join(one.name for one in list_families())
        raise InputError(f"there is no family {name!r}; there are {known}", option="--family")
    return found


def _describe_parameter(parameter, start: str, limited: bool) -> str:
    """Name, unit, where it starts, and what it is; with limits, what physics allows of it, and why."""
    unit = f" [{parameter.unit}]" if parameter.unit else ""
    text = f"  parameter  {parameter.name}{unit}, {start}: {parameter.text}"
    if not limited:
        return text
    (low, high), unit = parameter.limits, f" {parameter.unit}" if parameter.unit else ""
    span = f"{low:g} to {high:g}{unit}" if high < float("inf") else f"at least {low:g}{unit}"
    return f"{text}\n    limits   {span}: {parameter.limits_reason}"
