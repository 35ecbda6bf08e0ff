"""Arguments and options that several commands share, and what `fit` and `sample` read by them."""

import dataclasses as dc
import difflib
import re
from collections.abc import Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import typer

from .._errors import InputError
from ..reference_models import list_names
from .places import Output, locate_campaign, open_folder


CAMPAIGN = typer.Argument(metavar="CAMPAIGN", help="Folder of a campaign, or the name of a shipped one.")
SOURCE = typer.Argument(metavar="CAMPAIGN|fit.toml", help="A campaign, or a complete specification of a fit.")
MODEL = typer.Option(
    "-m",
    "--model",
    metavar="MODEL",
    help=f"Reference model (one of `ddetumble models`: {list_names()}), a folder that fit or discover wrote, or "
    "FILE.py:NAME.",
)
EFFECT = typer.Option(
    "-e", "--effect", metavar="ID",
    help="Add this effect of the catalogue, or of --effects-from; may be repeated.",
)
OVERWRITE = typer.Option(
    "--overwrite", help="Replace what is in the place that -o names; without it, only a new or empty one is taken."
)
FREE = typer.Option(
    "--free", metavar="NAME[=VALUE]",
    help="Fit this parameter too, or start it there: 'wall-stiffness.q=1.5'; may be repeated.",
)
FIX = typer.Option("--fix", metavar="NAME=VALUE", help="Hold this parameter: 'effective_mass=1.3 kg'; may be repeated.")
PRIOR = typer.Option(
    "--prior", metavar="NAME=MEAN+-SD",
    help="Gaussian prior of a fitted parameter: 'restitution=0.7+-0.05'; may be repeated.",
)
FAMILY = typer.Option(
    "--family", metavar="NAME",
    help="Family of records: impact, slip, oblique or tumble, or FILE.py:NAME for your own; all if not given.",
)
OWN = typer.Option("--effects-from", metavar="FILE.py", help="A file of yours with effects, known by their ids then.")


def folder_option(text: str) -> Any:
    """The option `-o DIR` with this help."""
    return typer.Option("-o", "--output", metavar="DIR", help=text)


def choose_families(name: str | None) -> tuple[Any, ...]:
    """The family of that name, or `FILE.py:NAME`; all where none is named.

    Raises:
        InputError: There is no such family.
    """
    from .._user_files import split_name
    from ..families import list_families
    from ..measurement.kinds import take_kind

    wanted = take_kind(name) if name is not None and split_name(name) is not None else name
    found = tuple(one for one in list_families() if wanted in (None, one.name))
    if not found:
        known = ", ".join(one.name for one in list_families())
        raise InputError(f"there is no family {name!r}; there are {known}", option="--family")
    return found


@dc.dataclass(frozen=True)
class Source:
    """What a fit or a posterior is made of.

    Attributes:
        name: of the campaign, or of the folder of the specification.
        measured: the campaign, or the path of the specification.
        chosen: `model` and `effects`; empty where the specification says them.
        folder: for the results.
        shared: whether it is the specification's own folder.
    """

    name: str
    measured: Any
    chosen: dict[str, Any]
    folder: Path
    shared: bool

    def open(self, command: str, overwrite: bool, own: Sequence[str], **more: Any) -> AbstractContextManager[Output]:
        """The folder for the results of a command, of which `own` are names; `more` as of `open_folder`."""
        return open_folder(self.folder, command, overwrite, beside=own if self.shared else (), **more)


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


@dc.dataclass(frozen=True)
class Choice:
    """What the options say of a fit, None where they say nothing: as given on the command line."""

    model: str | None
    effects: list[str] | None
    own: Path | None
    free: list[str] | None
    fixed: list[str] | None
    priors: list[str] | None

    def read(self, family: str) -> dict[str, Any]:
        """Arguments of `fit` for records of a family.

        Raises:
            InputError: There is no such parameter, or its value is none, or of another unit.
        """
        names, model = tuple(name_own(self.effects or (), self.own)), self.model or "paper"
        chosen: dict[str, Any] = {"model": model, "effects": names}
        if not (self.free or self.fixed or self.priors):
            return chosen
        from ..measurement.headings import read_pairs

        units = _list_units(model, family, names)
        free: dict[str, float | bool] = {}
        for entry in self.free or ():
            name, sign, value = entry.partition("=")
            free[name.strip()] = _read_numbers("free", name.strip(), value, units)[0] if sign else True
            _find_unit("free", name.strip(), units)
        fixed = {name: _read_numbers("fix", name, text, units)[0]
                 for name, text in read_pairs("fix", self.fixed).items()}
        priors = {name: _read_numbers("prior", name, text, units, 2)
                  for name, text in read_pairs("prior", self.priors).items()}
        return chosen | {"free": free, "fixed": fixed, "priors": priors}


def _list_units(model: str, family: str, effects: Sequence[str]) -> dict[str, str]:
    """Units of all parameters of a model with effects, by name."""
    from ..contact.effect import parameters_of
    from ..inference.archive import resolve_model
    from ..inference.models import resolve_effect

    resolved = resolve_model(model, family)
    classes = [*(type(e) for e in resolved.effects), *(resolve_effect(name) for name in effects)]
    return {p.name: p.unit for p in parameters_of(resolved.reference)} | {
        f"{e.id}.{p.name}": p.unit for e in classes for p in parameters_of(e)}


def _find_unit(option: str, name: str, units: dict[str, str]) -> str:
    if name not in units:
        near = difflib.get_close_matches(name, units, n=1)
        hint = f"; did you mean {near[0]}?" if near else f"; it has {', '.join(units)}"
        raise InputError(f"--{option}: there is no parameter {name!r} in this model{hint}")
    return units[name]


def _read_numbers(option: str, name: str, text: str, units: dict[str, str], count: int = 1) -> tuple[float, ...]:
    """One number, or a mean and its standard deviation, with or without a unit, in the parameter's own unit."""
    from ..measurement.units import NUMBER, parse_unit

    own = _find_unit(option, name, units)
    sign = r"\s*(?:\+-|\+/-|±)\s*"
    form = sign.join(rf"({NUMBER})" for _ in range(count)) + r"\s*([^\d.].*)?"
    match = re.fullmatch(rf"\s*{form}", text, re.ASCII if "±" not in text else 0)
    shape = "NAME=VALUE" if count == 1 else "NAME=MEAN+-SD"
    if match is None:
        raise InputError(f"--{option} is given as {shape}{f', in {own}' if own else ''}; {name}={text!r} is not")
    numbers = [float(match[k + 1]) for k in range(count)]
    if count == 2 and not numbers[1] > 0:
        raise InputError(f"--{option}: the standard deviation of {name} has to be positive")
    if match[count + 1]:
        unit, wanted = parse_unit(match[count + 1].strip()), parse_unit(own or "1")
        if unit.dimension != wanted.dimension or unit.offset:
            raise InputError(f"--{option}: {match[count + 1].strip()!r} is no unit of {name}, which is "
                             + (f"in {own}" if own else "a pure number"))
        numbers = [float(unit.convert(x)) for x in numbers]
    return tuple(numbers)


def read_source(text: str, choice: Choice, output: Path | None, ending: str) -> Source:
    """Read a campaign or find a specification, and say where the results go.

    Args:
        text: of the argument `SOURCE`.
        choice: the options on the fit; the paper's model where none is named.
        output: of the option; the folder of the specification, or one named after the campaign, where it is None.
        ending: of that name.

    Raises:
        InputError: there is nothing to read, anything on the fit is given beside a specification, or a file of effects
            without saying which of them to add.
    """
    own = choice.own
    if not text.endswith(".toml"):
        from ..measurement.package import read_campaign

        if own is not None and not choice.effects:
            from ..inference.models import list_effects

            ids = ", ".join(one.id for one in list_effects(own))
            raise InputError(f"say with --effect which of its effects to add: {ids}", file=own)
        path = locate_campaign(text)
        name, measured = path.resolve().name, read_campaign(path)
        from ..families import name_family

        return Source(name, measured, choice.read(name_family(measured)), output or Path(f"{name}-{ending}"), False)
    if any(getattr(choice, field.name) for field in dc.fields(choice)):
        raise InputError("the specification says all about the fit; leave out --model, --effect, --effects-from, "
                         "--free, --fix and --prior", file=text)
    path = Path(text)
    if not path.is_file():
        raise InputError("there is no such file", file=path)
    return Source(path.resolve().parent.name, path, {}, output or path.parent, output is None)
