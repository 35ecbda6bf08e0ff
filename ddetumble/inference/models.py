"""Reference models by name: the printed forms of the paper, a plain power law, and models of the user's own."""

import dataclasses as dc
import difflib
import sys
from collections.abc import Callable, Collection, Iterable, Sequence
from pathlib import Path
from typing import Any, TypeGuard, cast

from .._errors import InputError, offer_names
from .._user_files import run_file, split_name
from ..contact.effect import AbstractEffect, AbstractLaw, AbstractModel, identify_model, parameters_of, read_field
from ..contact.gripping import Striker
from ..contact.law import Ball, PowerLaw
from ..contact.sliding import AdhesionHysteresis, CoulombFriction, RubberFriction
from ..contact.torque import RigidBody
from ..effects import CATALOGUE
from ..families import DEFAULT_FAMILY, find_family, list_families
from ..measurement.quantities import join_words


USUAL = "paper"  # the model where none is named: of a family without one of this name, its first
SHOWN = 3  # effects that are named for a parameter that a model does not have
# Reference models by the name of their class; one that is made of two is `Striker(Ball, CoulombFriction)`.
PARTS: dict[str, Callable[[], AbstractModel]] = {
    one.__name__: one for one in (Ball, PowerLaw, RubberFriction, AdhesionHysteresis, CoulombFriction, RigidBody)}


@dc.dataclass(frozen=True)
class ResolvedModel:
    """What a MODEL argument stands for."""

    name: str  # as given
    reference: AbstractModel  # template of the reference model; its values are the defaults
    text: str  # which equations it is, one sentence
    # Instances that extend it from the start, of a fitted model or for a law of the user's own.
    effects: tuple[AbstractEffect, ...] = ()
    fitted: bool = False  # whether its values are those of a fit


def is_fitted(name: str) -> bool:
    """Whether a model's name is the folder of a fitted one; a built-in name never is, whatever lies about."""
    return not any(str(name) in one.models for one in list_families()) and Path(name).is_dir()


def is_model(value: Any) -> TypeGuard[AbstractModel | type[AbstractModel] | AbstractLaw]:
    """Whether it is a reference model, extended or not, or a class of such."""
    if isinstance(value, type):
        return issubclass(value, AbstractModel) and not list_abstract(value)
    return isinstance(value, (AbstractModel, AbstractLaw))


def list_abstract(kind: type) -> list[str]:
    """Names of methods and attributes that a class of models still has to define."""
    return sorted({name for kept in ("__abstractmethods__", "__abstractvars__", "__abstractclassvars__")
                   for name in getattr(kind, kept, ())})


def require_complete(value: Any) -> None:
    """Refuse a class of models that does not define all that one needs."""
    if isinstance(value, type) and issubclass(value, AbstractModel) and list_abstract(value):
        raise InputError(f"the class {value.__name__} lacks {join_words(list_abstract(value))}: define what is "
                         "missing, or derive it from a class that has it (of impacts dd.contact.AbstractDamped, which "
                         "needs `elastic` alone)", key="model")


def find_model(name: str, family: str = DEFAULT_FAMILY) -> ResolvedModel:
    """The reference model that a name stands for, where it is no fitted one; as for `archive.resolve_model`."""
    models = find_family(family).models
    if name == USUAL and models:
        name = USUAL if USUAL in models else next(iter(models))
    if name in models:
        return ResolvedModel(name, models[name].make(), models[name].text)
    own = split_name(name)
    if own is not None:
        return _import_model(name, *own)
    outer, _, rest = name.removesuffix(")").partition("(")
    parts = [part.strip() for part in rest.split(",")]
    made = None
    if name in PARTS:
        made = PARTS[name]()
    elif outer == "Striker" and name.endswith(")") and len(parts) == 2 and {*parts} <= {*PARTS}:
        made = Striker(*(cast(Any, PARTS[part]()) for part in parts))
    if made is not None:
        return ResolvedModel(name, made, _describe_class(type(made)))
    if name.endswith(".py"):
        raise InputError(f"name the model in the file too: {name}:NAME", file=name)
    other = [one.name for one in list_families() if name in one.models]
    if other:
        raise InputError(f"the model {name!r} is for {' and '.join(other)} records, but these are of the family "
                         f"{family!r}, whose models are {', '.join(models)}, a folder that fit or discover wrote, or "
                         "FILE.py:NAME")
    if not models:
        raise InputError(f"there is no model {name!r} of {family} records; give a folder that fit or discover wrote, "
                         "or FILE.py:NAME")
    raise InputError(f"there is no model {name!r}{_suggest(name, models)}; give one of {', '.join(models)}, a folder "
                     "that fit or discover wrote, or FILE.py:NAME")


def wrap_model(model: AbstractModel | type[AbstractModel] | AbstractLaw) -> ResolvedModel:
    """A model in hand, such as `Ball(truncated=True) + Adhesion()`, under a name by which a saved fit finds it again.

    The name is that of the built-in model with the same parts, choices and constants; else that of the class, with its
    file where it is one of the user's own.
    """
    if isinstance(model, type):
        try:
            model = cast(Callable[[], AbstractModel], model)()
        except TypeError as error:
            raise InputError(f"{model.__name__}() cannot be made without arguments ({error}); give an instance"
                             ) from None
    effects = tuple(model.effects) if isinstance(model, AbstractLaw) else ()
    reference = model.reference if isinstance(model, AbstractLaw) else model
    kind = type(reference)
    own = next((one for one in list_families() if one.name == kind.family), None)
    for name, built in own.models.items() if own else ():
        if _identify(built.make()) == _identify(reference):
            return ResolvedModel(name, reference, built.text, effects)
    file, name = getattr(sys.modules.get(kind.__module__), "__file__", None), kind.__name__
    if isinstance(reference, Striker):
        name = f"Striker({type(reference.ball).__name__}, {type(reference.friction).__name__})"
    elif PARTS.get(name) is not kind and file is not None:
        name = f"{file}:{kind.__qualname__}"
    return ResolvedModel(name, reference, _describe_class(kind), effects)


def _identify(reference: AbstractModel) -> tuple:
    """What makes two reference models one: parts, choices, and what no fit moves unless it is asked to."""
    held = tuple(float(read_field(reference, p.field)) for p in parameters_of(reference) if not p.free)
    return *identify_model(reference), held


def _describe_class(kind: type) -> str:
    """First paragraph of a class's docstring."""
    return " ".join((kind.__doc__ or kind.__name__).strip().split("\n\n")[0].split())


def _suggest(name: str, known: Iterable[str]) -> str:
    near = difflib.get_close_matches(name, known, n=1)
    return f" (did you mean {near[0]}?)" if near else ""


def list_effects(path: Path | str) -> tuple[type[AbstractEffect], ...]:
    """All effects that a user's file holds, in its order."""
    module = run_file(Path(path))
    found = [one for one in module.__dict__.values() if isinstance(one, type) and issubclass(one, AbstractEffect)
             and one.__module__ == module.__name__ and not one.__name__.startswith(("_", "Abstract"))]
    if not found:
        raise InputError("the file defines no class derived from one of ddetumble's effect classes", file=path)
    taken = {effect.id for effect in list_known() if effect not in found}
    for one in found:
        if one.id in taken:
            raise InputError(f"the class {one.__name__} has the id {one.id!r}, which is in the catalogue or belongs to "
                             "another class of the file; give it one of its own", file=path)
        taken.add(one.id)
    return tuple(found)


def list_known() -> tuple[type[AbstractEffect], ...]:
    """Effects known by their id: the catalogue, and those of the user's own kinds of tests."""
    return tuple(dict.fromkeys((*CATALOGUE, *(effect for one in list_families() for effect in one.catalogue))))


def resolve_effect(name: str, own: Sequence[type[AbstractEffect]] = ()) -> type[AbstractEffect]:
    """The effect that an id of the catalogue or of `own`, or `FILE.py:NAME` of the user's own, stands for."""
    known = {effect.id: effect for effect in (*list_known(), *own)}
    if name in known:
        return known[name]
    own_file = split_name(name)
    if own_file is None:
        raise InputError(f"there is no effect {name!r}{_suggest(str(name), known)}; `ddetumble effects` lists them, "
                         "and FILE.py:NAME names one of your own")
    path, attribute = own_file
    found = run_file(path).__dict__.get(attribute)
    if not isinstance(found, type) or not issubclass(found, AbstractEffect):
        raise InputError(f"there is no effect {attribute!r} in the file: it must be a class derived from one of "
                         "ddetumble's effect classes", file=path)
    return found


def offer_parameter(name: str, usable: Collection[str], lacking: Iterable[type[AbstractEffect]], add: str) -> str:
    """What to do about a parameter that a model does not have: add the effect that has it, where it is one of those
    that the model is `lacking` (`add` says how, with `{}` for the effect's id); else what there is, as `offer_names`.
    """
    owner = name.partition(".")[0]
    having = [effect for effect in lacking
              if effect.id == owner or any(one.name == name for one in parameters_of(effect))]
    if not having or any(one.endswith(f".{name}") for one in usable):
        return offer_names(name, usable, "its parameters are")
    told = [f"{effect.id} (with {', '.join(f'{effect.id}.{one.name}' for one in parameters_of(effect))})"
            for effect in having[:SHOWN]]
    single = len(having) == 1
    more = f" and {len(having) - SHOWN} more" * (len(having) > SHOWN)
    return (f"it lacks the effect{'s' * (not single)} {', '.join(told)}{more}; add "
            f"{'it' if single else 'the one that is meant'} {add.format(having[0].id if single else 'ID')}")


def _import_model(name: str, path: Path, attribute: str) -> ResolvedModel:
    """Take one model from the user's file."""
    module = run_file(path)
    if attribute not in module.__dict__:
        here = [key for key, value in module.__dict__.items() if is_model(value) and not key.startswith("_")
                and getattr(value, "__module__", module.__name__) == module.__name__]
        offer = f"; it defines {', '.join(here)}" if here else ""
        raise InputError(f"there is no {attribute!r} in the file{offer}", file=path)
    found = module.__dict__[attribute]
    require_complete(found)
    if not is_model(found):
        raise InputError(f"{attribute} is not a reference model: it must be a subclass of ddetumble's "
                         "AbstractReference, an instance of one, or a ContactLaw", file=path)
    try:
        made = cast(Callable[[], Any], found)() if isinstance(found, type) else found
    except Exception as error:
        raise InputError(f"{attribute}() cannot be made without arguments ({error}); give its parameters default "
                         "values", file=path) from error
    own = f"{attribute} of {path.name}"
    if isinstance(made, AbstractLaw):
        return ResolvedModel(name, made.reference, own, tuple(made.effects))
    return ResolvedModel(name, made, _describe_class(type(made)) if type(made).__doc__ else own)
