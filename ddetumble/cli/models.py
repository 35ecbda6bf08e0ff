"""The command that lists reference models: `models`."""

from typing import Annotated, Any

import typer

from .._errors import InputError
from .options import FAMILY, choose_families


def register(app: typer.Typer) -> None:
    """Add this module's commands."""
    app.command(
        "models",
        short_help="The reference models to begin with: law, parameters, source.",
        epilog="\b\nExamples:\n  ddetumble models\n  ddetumble models power-law\n  ddetumble models --family slip",
    )(show_models)


def show_models(
    name: Annotated[
        str | None, typer.Argument(metavar="[NAME]", help="One model, in full; all of them in short if not given.")
    ] = None,
    family: Annotated[str | None, FAMILY] = None,
):
    """The reference models that come with the toolkit, by family of records: what `--model NAME` stands for. With a
    name its law, its parameters with what physics allows of them, and its source.
    """
    families = {one.name: one.models for one in choose_families(family)}
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
        raise InputError(f"there is no model {name!r}; there are {', '.join(known)}", option="NAME")
    typer.echo("\n".join(line for key, model in found.items() for line in _describe(name, key, model)))


def _describe(name: str, family: str, model: Any) -> list[str]:
    """One model of one family, a line a fact."""
    from ..contact.effect import list_choices, parameters_of, read_field, read_validity
    from .estimation import describe_limits

    made = model.make()
    lines = [f"{name} ({family} records)", f"  {model.text}", f"  law        {model.law}"]
    for one in parameters_of(made):
        unit = f" [{one.unit}]" if one.unit else ""
        fitted = "fitted" if one.free else "held"
        lines.append(f"  parameter  {one.name}{unit}, {float(read_field(made, one.field)):g}, {fitted}: {one.text}")
        lines.append(f"    limits   {describe_limits(one)}")
    lines += [f"  choice     {path} = {'none' if choice in ('', None) else choice}"
              for path, choice in list_choices(made).items()]
    lines += [f"  holds for  {condition} from {low:g} to {high:.4g} (SI)"
              for condition, (low, high) in read_validity(made).items()]
    return [*lines, f"  source     {model.source}"]
