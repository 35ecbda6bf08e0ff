"""One parameter space for a campaign: reference model, catalogue and directions, the same for every fit of it.

A fit of two parameters and the search through the whole catalogue share one compiled program this way.
"""

import dataclasses as dc
import difflib
from collections.abc import Sequence

import numpy as np

from .._errors import InputError
from ..contact.effect import AbstractEffect, AbstractModel, family_of, parameters_of, parts_of
from ..contact.friction import describe_range
from ..contact.gripping import Striker
from ..contact.law import PowerLaw
from ..contact.sliding import AbstractRubberFriction, RubberFriction
from ..families import find_family, name_family
from ..measurement.campaign import Campaign
from ..measurement.plausibility import check_plausibility, say_copies
from ..measurement.units import ROLES
from .parameters import ParameterSpace
from .stack import list_commons


@dc.dataclass(frozen=True)
class Assembly:
    """Everything that a model of a campaign may hold."""

    space: ParameterSpace  # of all parameters
    # catalogue, directions: effects and test directions that the campaign's model may have.
    catalogue: tuple[type[AbstractEffect], ...]
    directions: tuple[type[AbstractEffect], ...]
    left_out: tuple[str, ...]  # ids of effects that need what model or campaign lack
    start: np.ndarray  # coordinates, known parameters put in, effects at their null, shape (parameters,)
    base: tuple[str, ...]  # free parameters of the reference model
    # Sentences on what is assumed, and on records outside the range in which the reference model holds.
    warnings: tuple[str, ...] = ()


def assemble_space(campaign: Campaign, reference: AbstractModel,
                   extra: Sequence[type[AbstractEffect]] = ()) -> Assembly:
    """Gather everything that a model of the campaign may hold: the reference model, the catalogue and `extra` effects.
    """
    family = find_family(name_family(campaign))
    family.require_model(reference, campaign.name)
    for effect in extra:
        if family_of(effect) not in family.accepts:
            raise InputError(f"effect {effect.id!r} acts on {family_of(effect)} records, but campaign "
                             f"{campaign.name!r} is of the family {family.name!r}, whose effects are: "
                             + ", ".join(e.id for e in family.catalogue))
    reference = adapt_reference(campaign, reference)
    family.check(campaign)
    present = {*reference.provides, *campaign.records.columns, *(n for n, v in campaign.known.items() if v is not None)}
    offered = (*family.catalogue, *extra)
    catalogue = tuple(e for e in offered if present.issuperset(e.requires))
    directions = tuple(e for e in family.directions if present.issuperset(e.requires))
    space = ParameterSpace(reference, (*catalogue, *directions), list_commons(campaign))
    own = {s.name for s in space.slots if s.owner is None}
    known = {k: v for k, v in campaign.known.items() if v is not None and k in own}
    file = campaign.path and campaign.path / "datapackage.json"
    for name, value in known.items():
        low, high = space.parameter(name).bounds
        if not low <= value <= high or not space.parameter(name).transform.allows(value):
            edge = "above 0" if low == 0 and high == np.inf else f"{low:g} to {high:g}"
            raise InputError(f"{value:g} is outside the range of {name} ({edge})", file=file, key=f"known.{name}")
    start = space.coordinates(known)
    fixed = {"condition_exponent"} if any(isinstance(m, PowerLaw) and not m.condition
                                          for m in parts_of(reference)) else set()
    base = tuple(s.name for s in space.slots if s.owner is None and s.parameter.free
                 and campaign.known.get(s.name) is None and s.name not in fixed)
    return Assembly(space, catalogue, directions, tuple(e.id for e in offered if e not in catalogue), start, base,
                    tuple(_list_warnings(campaign, space, reference)))


def require_samples(campaign: Campaign) -> None:
    """Refuse a campaign of values only, of which a test gives one each: there is no curve to draw a force along."""
    if set(campaign.channels) <= set(find_family(name_family(campaign)).values):
        raise InputError(f"campaign {campaign.name!r} contains only peaks or other single values, and no "
                         "sampled records along which a missing force could be drawn; `ddetumble compare` shows what "
                         "the model leaves of each value by record and condition, and `ddetumble discover` which "
                         "effect would explain it")


def _list_warnings(campaign: Campaign, space: ParameterSpace, reference: AbstractModel) -> list[str]:
    """Sentences on what is known and of no use, on what is assumed, and on records outside the range of the model."""
    found = [*map(str, check_plausibility(campaign)), *say_copies(campaign)]
    models = (built.make() for built in find_family(campaign.family).models.values())
    names = {*ROLES, *space.index, *(p.name for model in models for p in parameters_of(model))}
    unknown = [name for name in campaign.known if name not in names]
    for name in unknown:
        near = difflib.get_close_matches(name, sorted(names - set(campaign.known)), n=1, cutoff=0.85)
        if near:
            raise InputError(f"there is no parameter {name!r}; did you mean {near[0]}? Correct it or remove it",
                             file=campaign.path and campaign.path / "datapackage.json", key=f"known.{name}")
    if unknown:
        is_are = "is not a parameter" if len(unknown) == 1 else "are not parameters"
        found.append(f"Under known, {', '.join(map(repr, unknown))} {is_are} of the model and had no effect.")
    if isinstance(reference, Striker) and campaign.known.get("rolling_mass") is None:
        found.append(f"The rolling_mass is not under known, so {float(reference.rolling_mass):g} kg is assumed; the "
                     "motion of the ball once it grips depends on it. It is two thirds of the mass of a thin hollow "
                     "ball, two fifths of that of a solid one, and 1e6 kg where the ball cannot turn.")
    if isinstance(reference, RubberFriction):
        outside: dict[str, list[str]] = {}
        for key, load in zip(campaign.record_keys, campaign.records["normal_load"].to_numpy(dtype=float), strict=True):
            outside.setdefault(describe_range(float(load)), []).append(str(key))
        found += [f"Some loads are outside the range of Eq. 10 ({len(keys)} records, {keys[0]} among them): {phrase}."
                  for phrase, keys in outside.items() if phrase]
    return found


def adapt_reference(campaign: Campaign, reference: AbstractModel) -> AbstractModel:
    """A reference model that reads the campaign's conditions; refused in words where they are missing.

    A power law that names no condition of the campaign takes the pressure, or else the first further condition that
    varies, about its median.
    """
    records = campaign.records

    def require(pressure: str, why: str, other: str) -> None:
        if pressure not in records:
            raise InputError(f"campaign {campaign.name!r} has no condition {pressure!r}, but {why}; give the pressure, "
                             f"or use --model {other}")

    if isinstance(reference, Striker):
        if isinstance(reference.friction, RubberFriction):
            raise InputError("the loads of an oblique impact include those at which Eq. 10 breaks down; use "
                             "AdhesionHysteresis (Eq. 8 alone) or CoulombFriction as its friction")
        if isinstance(reference.friction, AbstractRubberFriction):
            require("initial_pressure", "Eq. 8 needs it", "power-law")
        return dc.replace(reference, ball=adapt_reference(campaign, reference.ball))
    if isinstance(reference, AbstractRubberFriction):
        require("internal_pressure", "Eq. 8 needs it", "coulomb")
    if isinstance(reference, PowerLaw) and reference.condition not in records:
        further = [c for c in records.columns if c not in ("approach_speed", "tangential_speed", "sequence",
                                                         "initial_pressure")]
        values = {c: records[c].to_numpy(dtype=float) for c in ("initial_pressure", *further) if c in records}
        found = next((c for c, x in values.items() if (x > 0).all() and len(np.unique(x)) > 1), "")
        middle = float(np.median(values[found])) if found else 1.0
        return dc.replace(reference, condition=found, condition_reference=middle)
    if "gas" in reference.provides:
        require("initial_pressure", "this model is of an inflated ball", "power-law")
        empty = records.index[records["initial_pressure"].to_numpy(dtype=float) <= 0]
        # A value that the model does not bring about is a misfit as any other; of a series it would be all of it.
        if len(empty) and not set(campaign.channels) <= set(find_family(name_family(campaign)).values):
            raise InputError(f"campaign {campaign.name!r}: record {empty[0]!r} has no absolute pressure "
                             f"({records.loc[empty[0], 'initial_pressure']:g} Pa), and without gas this model gives no "
                             "force at all; mark gauge pressures with \"reference\": \"gauge\", leave the record out, "
                             "or use --model power-law")
    return reference


def default_starts(effect: type[AbstractEffect]) -> list[dict[str, float]]:
    """Interior starting points of an effect's parameters by public name (coordinates).

    One for every combination of the starts of shapes, and of amplitudes that have no slope at their null. What is held
    has none: it stays at its default.
    """
    amplitudes, shapes = {}, [{}]
    for p in parameters_of(effect):
        name = f"{effect.id}.{p.name}"
        values = [p.transform.from_field(v) for v in (p.starts or (p.default + 0.3 * p.typical,))]
        if p.kind == "shape" or p.singular:
            if p.free or p.singular:
                shapes = [{**s, name: v} for s in shapes for v in values]
        elif p.free:
            amplitudes[name] = values[0]
    return [{**amplitudes, **s} for s in shapes]


def guess_start(campaign: Campaign, space: ParameterSpace, start: np.ndarray, free: Sequence[str]) -> np.ndarray:
    """The likeliest coordinates to start from, guessed from the records as their family has it."""
    if campaign.samples is None:
        return start.copy()
    return find_family(name_family(campaign)).guess_starts(campaign, space, start, free)[0]
