"""Arguments and options that several commands share, and what `fit` and `sample` read by them."""

import dataclasses as dc
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import typer

from .._errors import InputError
from ..inference.builtin import list_names
from .places import locate_campaign, prepare_folder


CAMPAIGN = typer.Argument(metavar="CAMPAIGN", help="Folder of a campaign, or the name of a shipped one.")
SOURCE = typer.Argument(metavar="CAMPAIGN|fit.toml", help="A campaign, or a complete specification of a fit.")
MODEL = typer.Option(
    "-m",
    "--model",
    metavar="MODEL",
    help=f"Reference model ({list_names()}), a folder that fit or discover wrote, or FILE.py:NAME.",
)
EFFECT = typer.Option(
    "-e", "--effect", metavar="ID",
    help="Add this effect of the catalogue, or of --effects-from; may be repeated.",
)
OWN = typer.Option("--effects-from", metavar="FILE.py", help="A file of yours with effects, known by their ids then.")


def folder_option(text: str) -> Any:
    """The option `-o DIR` with this help."""
    return typer.Option("-o", "--output", metavar="DIR", help=text)


@dc.dataclass(frozen=True)
class Source:
    """What a fit or a posterior is made of.

    Attributes:
        name: of the campaign, or of the folder of the specification.
        measured: the campaign, or the path of the specification.
        chosen: `model` and `effects`; empty where the specification says them.
        folder: for the results, made ready.
    """

    name: str
    measured: Any
    chosen: dict[str, Any]
    folder: Path


def name_own(names: Sequence[str], path: Path | None) -> list[str]:
    """Names of effects, those of the user's file as `FILE.py:NAME`.

    Raises:
        InputError: The file cannot be read or run, or holds no effect.
    """
    if path is None:
        return list(names)
    from ..inference.models import list_effects

    own = {one.id: f"{path}:{one.__name__}" for one in list_effects(path)}
    return [own.get(name, name) for name in names]


def read_source(text: str, model: str | None, effect: list[str] | None, output: Path | None, ending: str,
                own: Path | None = None) -> Source:
    """Read a campaign or find a specification, and make the folder for the results.

    Args:
        text: of the argument `SOURCE`.
        model, effect, output: the options, None where they are not given; the paper's model then, and the folder of
            the specification, or one named after the campaign.
        ending: of that name.
        own: the user's file of effects.

    Raises:
        InputError: there is nothing to read, a model or effects are given beside a specification, or a file of effects
            without saying which of them to add.
    """
    if not text.endswith(".toml"):
        from ..measurement.package import read_campaign

        if own is not None and not effect:
            from ..inference.models import list_effects

            ids = ", ".join(one.id for one in list_effects(own))
            raise InputError(f"say with --effect which of its effects to add: {ids}", file=own)
        path = locate_campaign(text)
        name, measured = path.resolve().name, read_campaign(path)
        chosen = {"model": model or "paper", "effects": tuple(name_own(effect or (), own))}
        return Source(name, measured, chosen, prepare_folder(output or Path(f"{name}-{ending}")))
    if model or effect or own:
        raise InputError("the specification says which model and effects; leave out --model, --effect and "
                         "--effects-from", file=text)
    path = Path(text)
    if not path.is_file():
        raise InputError("there is no such file", file=path)
    return Source(path.resolve().parent.name, path, {}, prepare_folder(output or path.parent))
