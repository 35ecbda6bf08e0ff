"""The application, and what several commands share: arguments, options, and what `fit` and `sample` read by them."""

import functools
import inspect
import re
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import typer
from typer.core import TyperCommand, TyperOption

from .._errors import InputError, error_place
from ..reference_models import list_names
from .places import Output, locate_campaign, open_folder
from .progress import quiet_now


app = typer.Typer(name="ddetumble", add_completion=False, rich_markup_mode=None, pretty_exceptions_enable=False,
                  context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})


def show_examples(*lines: str) -> str:
    """The end of a command's help."""
    return "\b\n" + "\n  ".join(["Example:" if len(lines) == 1 else "Examples:", *lines])


class _Command(TyperCommand):
    """A command that refuses an option given twice that takes one value; the first would be left out silently."""

    def parse_args(self, ctx: typer.Context, args: list[str]) -> list[str]:
        """What is left over, of options each of which is given once."""
        try:
            left = super().parse_args(ctx, [*args])
        except Exception as error:
            if getattr(error, "ctx", self) is None:  # an option that lacks its value, whose help is this command's
                vars(error)["ctx"] = ctx
            raise
        order = [one for one in self.make_parser(ctx).parse_args(args=[*args])[2] if isinstance(one, TyperOption)]
        for one in order:
            if not (one.multiple or one.is_flag) and order.count(one) > 1:
                raise InputError("it is given twice and takes one value; keep one", option=one.opts[-1])
        return left


def command(name: str, summary: str, *examples: str) -> Callable:
    """Make a function a command, with a summary for the list of all of them and examples without the program's name.

    It takes `--quiet` beside its own options.
    """
    register = app.command(name, cls=_Command, short_help=summary,
                           epilog=show_examples(*(f"ddetumble {one}" for one in examples)))

    def add(function: Callable) -> Callable:
        @functools.wraps(function)
        def run(*arguments, quiet: bool, **named):
            token = quiet_now.set(quiet)
            try:
                return function(*arguments, **named)
            finally:
                quiet_now.reset(token)

        own = inspect.signature(function)
        last = inspect.Parameter("quiet", inspect.Parameter.KEYWORD_ONLY, default=False, annotation=Quiet)
        vars(run)["__signature__"] = own.replace(parameters=[*own.parameters.values(), last])
        run.__annotations__ = function.__annotations__ | {"quiet": Quiet}
        register(run)
        return function

    return add


def option(metavar: str, text: str, *names: str, **more: Any) -> Any:
    """An option that takes a value, with its help."""
    return typer.Option(*names, metavar=metavar, help=text, **more)


def place(text: str, metavar: str = "DIR") -> Any:
    """The option `-o`, with its help."""
    return option(metavar, text, "-o", "--output")


_MODEL = option("MODEL", f"Reference model (one of `ddetumble models`: {list_names()}), a folder that fit or discover "
                "wrote, or FILE.py:NAME.", "-m", "--model")
Texts = list[str] | None
CampaignName = Annotated[str, typer.Argument(
    metavar="CAMPAIGN", help="Folder of a campaign, or the name of a shipped one.")]
Fittable = Annotated[str, typer.Argument(
    metavar="CAMPAIGN|fit.toml", help="Campaign (folder or name of a shipped one), or a complete specification of a "
                                      "fit.")]
Model = Annotated[str, _MODEL]
OptionalModel = Annotated[str | None, _MODEL]
Effects = Annotated[Texts, option(
    "ID", "Add this effect of the catalogue, or of --effects-from; may be repeated.", "-e", "--effect")]
OwnFile = Annotated[Path | None, option("FILE.py", "File with effects of your own, which their ids then name.",
                                        "--effects-from")]
Free = Annotated[Texts, option(
    "NAME[=VALUE]", "Fit this parameter too, starting at the value if given: 'wall-stiffness.q=1.5'; may be repeated.")]
Fix = Annotated[Texts, option("NAME=VALUE", "Hold this parameter fixed: 'effective_mass=1.3 kg'; may be repeated.")]
Prior = Annotated[Texts, option(
    "NAME=MEAN+-SD", "Gaussian prior of a fitted parameter: 'restitution=0.7+-0.05'; may be repeated.")]
Bound = Annotated[Texts, option(
    "NAME=LOW..HIGH", "Bounds of a fitted parameter: 'restitution=0.5..0.9' or 'effective_mass=1..1.5 kg'; may be "
                      "repeated.")]
Family = Annotated[str | None, option(
    "NAME", "Family of records: impact, slip, oblique or tumble, or FILE.py:NAME for one of your own; if not given, "
            "all.")]
KeepAll = Annotated[bool, typer.Option(
    "--keep-all", help="Keep every record and every sample: faults are only reported.")]
Quiet = Annotated[bool, typer.Option("-q", "--quiet", help="Print no progress.")]
Overwrite = Annotated[bool, typer.Option(
    "--overwrite", help="Replace what is at the place that -o names; without it, that place must be new or empty.")]


class Source(NamedTuple):
    """What a fit or a posterior is made of."""

    name: str  # of the campaign, or of the folder of the specification
    measured: Any  # the campaign, or the path of the specification
    chosen: dict[str, Any]  # arguments of `fit`; empty where the specification says them
    folder: Path  # for the results
    shared: bool  # whether it is the specification's own folder

    def open(self, command: str, overwrite: bool, own: Sequence[str], **more: Any) -> AbstractContextManager[Output]:
        """The folder for the results of a command, of which `own` are names; `more` as of `open_folder`."""
        return open_folder(self.folder, command, overwrite, beside=own if self.shared else (), **more)


def read_source(text: str, output: Path | None, ending: str, own: Path | None, **given) -> Source:
    """Read a campaign or find a specification, and say where the results go.

    Args:
        text: the argument of the command.
        output: of the option; the specification's own folder, or one named after the campaign and `ending`, if None.
        ending: of that name.
        own: file of effects.
        **given: the other options on the fit, as `_read_choice` takes them.

    Raises:
        InputError: There is nothing to read, or options are missing or of no use.
    """
    if text.endswith(".toml"):
        if own or any(given.values()):
            raise InputError("the specification is complete; leave out --model, --effect, --effects-from, --free, "
                             "--fix, --prior and --bound", file=text)
        path = Path(text)
        if not path.is_file():
            raise InputError("this file does not exist", file=path)
        return Source(path.resolve().parent.name, path, {}, output or path.parent, output is None)
    from ..families import name_family
    from ..inference.models import list_effects
    from ..measurement.package import read_campaign

    if own is not None and not given["effects"]:
        ids = ", ".join(one.id for one in list_effects(own))
        raise InputError(f"give with --effect which of the file's effects to add: {ids}", file=own)
    path = locate_campaign(text)
    name, measured = path.resolve().name, read_campaign(path)
    chosen = _read_choice(name_family(measured), own, **given)
    return Source(name, measured, chosen, output or Path(f"{name}-{ending}"), False)


def name_own(names: Sequence[str], path: Path | None) -> list[str]:
    """Names of effects, those of the user's file as `FILE.py:NAME`."""
    if path is None:
        return list(names)
    from ..inference.models import list_effects

    own = {one.id: f"{path}:{one.__name__}" for one in list_effects(path)}
    return [own.get(name, name) for name in names]


def resolve_own(names: Sequence[str] | None, path: Path | None) -> tuple[list, list]:
    """Effects of these names, of the catalogue or of the user's file, and all effects of that file."""
    from ..inference.models import list_effects, resolve_effect

    held = list_effects(path) if path is not None else []
    return [resolve_effect(name, held) for name in names or ()], list(held)


def _read_choice(family: str, own: Path | None, model: str | None, effects: Sequence[str] | None,
                 free: Sequence[str] | None, fixed: Sequence[str] | None, priors: Sequence[str] | None,
                 bounds: Sequence[str] | None = None) -> dict[str, Any]:
    """Arguments of `fit` for records of a family, by what the command line says; of the paper's model if silent."""
    names, model = tuple(name_own(effects or (), own)), model or "paper"
    chosen: dict[str, Any] = {"model": model, "effects": names}
    if not (free or fixed or priors or bounds):
        return chosen
    from ..contact.effect import parameters_of
    from ..families import find_family
    from ..inference.archive import resolve_model
    from ..inference.models import list_effects, resolve_effect
    from ..measurement.columns import read_pairs

    resolved = resolve_model(model, family)
    classes = [*(type(effect) for effect in resolved.effects), *map(resolve_effect, names)]
    units = {p.name: p.unit for p in parameters_of(resolved.reference)} | {
        f"{effect.id}.{p.name}": p.unit for effect in classes for p in parameters_of(effect)}
    lacking = [effect for effect in (*find_family(family).catalogue, *(list_effects(own) if own is not None else ()))
               if effect not in classes]
    find_unit = functools.partial(_find_unit, units=units, lacking=lacking)
    freed: dict[str, float | bool] = {}
    for entry in free or ():
        name, sign, value = entry.partition("=")
        name = name.strip()
        freed[name] = _read_value("free", name, value, find_unit("free", name)) if sign else True
        find_unit("free", name)
    held = {name: _read_value("fix", name, text, find_unit("fix", name))
            for name, text in read_pairs("fix", fixed).items()}
    known = {name: _read_prior(name, text, find_unit("prior", name))
             for name, text in read_pairs("prior", priors).items()}
    ends = {name: _read_bounds(name, text, find_unit("bound", name))
            for name, text in read_pairs("bound", bounds).items()}
    return chosen | {"free": freed, "fixed": held, "priors": known} | ({"bounds": ends} if ends else {})


def _find_unit(option: str, name: str, units: dict[str, str], lacking: Sequence) -> str:
    """Unit of a parameter of the model; where it is one of the effects that the model is `lacking`, these are named."""
    if name not in units:
        from ..inference.models import offer_parameter

        raise InputError(f"--{option}: there is no parameter {name!r} in this model; "
                         f"{offer_parameter(name, units, lacking, 'with --effect {}')}")
    return units[name]


def _read_value(option: str, name: str, text: str, unit: str) -> float:
    """A parameter's value in its own unit, read as `import --known` reads one: with a unit, unless it has none."""
    from ..measurement.checks import read_known

    with error_place(option=f"--{option} {name}"):
        return read_known(name, text, unit or "1")


def _read_bounds(name: str, text: str, unit: str) -> tuple[float, float]:
    """Lower and upper bound of a parameter in its own unit: `1..1.5 kg`."""
    from ..measurement.units import NUMBER, parse_quantity, refuse_bare

    match = re.fullmatch(rf"\s*({NUMBER})\s*\.\.\s*({NUMBER})(?:\s*([^\d\s.].*)|\s+(1/.*))?\s*", text)
    with error_place(option=f"--bound {name}"):
        if match is None:
            raise InputError(f"write it like NAME=LOW..HIGH{f', with the unit behind, such as {unit}' * bool(unit)}; "
                             f"{text!r} does not have this form")
        behind = (match[3] or match[4] or "").strip()
        if not behind:
            refuse_bare(text, name, unit)
        low, high = (parse_quantity(f"{end} {behind}".strip(), name, unit or "1") for end in (match[1], match[2]))
        if not low < high:
            raise InputError(f"the lower bound has to be below the upper one; {text.strip()!r} is not so")
    return low, high


def _read_prior(name: str, text: str, unit: str) -> tuple[float, float]:
    """Mean and standard deviation of a parameter in its own unit: `1.3+-0.1 kg`."""
    from ..measurement.checks import read_known
    from ..measurement.units import NUMBER, parse_deviation, refuse_bare

    match = re.fullmatch(rf"\s*({NUMBER})\s*(?:\+-|\+/-|±)\s*({NUMBER})(?:\s*([^\d\s.].*)|\s+(1/.*))?\s*", text)
    with error_place(option=f"--prior {name}"):
        if match is None:
            raise InputError(f"write it like NAME=MEAN+-SD{f', with the unit behind, such as {unit}' * bool(unit)}; "
                             f"{text!r} does not have this form")
        behind = (match[3] or match[4] or "").strip()
        if not behind:
            refuse_bare(text, name, unit)
        mean = read_known(name, f"{match[1]} {behind}", unit or "1")
        sd = parse_deviation(f"{match[2]} {behind}", name, unit or "1")
        if not sd > 0:
            raise InputError("the standard deviation must be positive")
    return mean, sd
