"""Commands about posteriors: `sample`."""

from pathlib import Path
from typing import Annotated

import typer

from .._errors import InputError
from .examination import MODEL
from .places import locate_campaign, prepare_folder
from .progress import show_progress


def register(app: typer.Typer) -> None:
    """Add this module's commands."""
    app.command(
        "sample",
        short_help="Draw from the posterior of the parameters; resumable.",
        epilog="\b\nExamples:\n  ddetumble sample data/impact-b --effect adhesion -o posterior\n"
        "  ddetumble sample fits/impact-b/fit.toml\n"
        "  ddetumble sample data/slip-a --effect adhesive-offset --nuts -o nuts",
    )(sample_posterior)


def sample_posterior(
    source: Annotated[
        str, typer.Argument(metavar="CAMPAIGN|fit.toml", help="A campaign, or a complete specification of a fit.")
    ],
    model: Annotated[str | None, MODEL] = None,
    effect: Annotated[
        list[str] | None,
        typer.Option("-e", "--effect", metavar="ID", help="Add this effect of the catalogue; may be repeated."),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="DIR", help="Folder for draws and report; a specification's own."),
    ] = None,
    nuts: Annotated[bool, typer.Option("--nuts", help="NUTS in place of emcee; needs the extra `nuts`.")] = False,
    effective: Annotated[
        int | None, typer.Option(metavar="N", help="Independent draws wanted of every parameter [2000].")
    ] = None,
    steps: Annotated[
        int | None, typer.Option(metavar="N", help="Stop after so many steps whatever was reached [5000].")
    ] = None,
    walkers: Annotated[int | None, typer.Option(metavar="N", help="Walkers of an ensemble, even.")] = None,
    ensembles: Annotated[
        int | None, typer.Option(metavar="N", help="Independent ensembles, or chains of NUTS [4].")
    ] = None,
    burn: Annotated[int | None, typer.Option(metavar="N", help="First steps, to be left out [100].")] = None,
    checkpoint: Annotated[
        int | None, typer.Option(metavar="N", help="Steps between two writings of the chain [50].")
    ] = None,
    seed: Annotated[int | None, typer.Option(metavar="N", help="Of the random numbers [0].")] = None,
):
    """Draw from the posterior: parameters with their uncertainty where it is no Gaussian. What stopped it, the same
    command goes on.
    """
    specified = source.endswith(".toml")
    if specified and (model or effect):
        raise InputError("the specification says which model and effects; leave out --model and --effect", file=source)
    path = Path(source) if specified else locate_campaign(source)
    if specified and not path.is_file():
        raise InputError("there is no such file", file=path)
    name = path.resolve().parent.name if specified else path.resolve().name
    from ..measurement.package import read_campaign

    measured = path if specified else read_campaign(path)
    folder = prepare_folder(output or (path.parent if specified else Path(f"{name}-posterior")))
    from ..sampling.sampling import sample

    with show_progress(f"sampling {name}") as report:
        more = {} if specified else {"model": model or "paper", "effects": tuple(effect or ())}
        found = sample(measured, **more, sampler="nuts" if nuts else None, folder=folder, progress=report,
                       walkers=walkers, ensembles=ensembles, burn=burn, block=checkpoint, effective=effective,
                       most=steps, seed=seed)
        found.save(folder)
    typer.echo(found.text())
    typer.echo(f"Written to {folder}")
