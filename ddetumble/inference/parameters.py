"""Parameters of a law as one vector: names, coordinates in which a fit moves, and the way back to a law."""

import abc
import copy
import dataclasses as dc
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, final

import equinox as eqx
import numpy as np
from jaxtyping import Array

from .._errors import InputError
from ..contact.effect import AbstractEffect, AbstractModel, Parameter, list_choices, parameters_of, parts_of, read_field
from ..families import Family, find_family
from .programs import is_ours


@dc.dataclass(frozen=True)
class Slot:
    """One parameter of the law: public name (`wall-stiffness.k_w`), id of the effect (None: reference), declaration."""

    name: str
    owner: str | None
    parameter: Parameter


@dc.dataclass(frozen=True)
class Common:
    """An error that all records of a campaign share: one nuisance of the campaign."""

    # What it shifts: a condition, a channel (its zero, or where relative its gain), or `time` for the independent
    # variable, whatever its name.
    column: str
    # sd, relative, unit: its standard deviation, SI or where relative a fraction of the value; SI unit of the column.
    sd: float
    relative: bool
    unit: str

    @property
    def slot(self) -> Slot:
        """Its parameter: zero at the null, with a Gaussian prior of its standard deviation."""
        what = "shift of the time origin" if self.column == "time" else f"error of {self.column}"
        text = f"{what} common to all records" + (", as a fraction" if self.relative else "")
        unit = "" if self.relative else self.unit
        return Slot(f"{self.column}_shift", None, Parameter(f"{self.column}_shift", "", unit, 0.0, "reference",
                                                            self.sd, text=text))


class AbstractSpace(abc.ABC):
    """Parameters by name, in one fixed order: what least squares and intervals need to know of them."""

    slots: tuple[Slot, ...]
    index: dict[str, int]  # places by name

    def __len__(self) -> int:
        return len(self.slots)

    def parameter(self, name: str) -> Parameter:
        """Declaration of a parameter."""
        return self.slots[self.index[name]].parameter

    def scales(self) -> np.ndarray:
        """Typical change of each coordinate, shape (parameters,)."""
        return np.array([min(1.0, p.typical / abs(p.default)) if p.coordinate == "log" and p.default else
                         p.transform.scale(p.typical) for p in (slot.parameter for slot in self.slots)])

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Hard limits of the coordinates, each shape (parameters,)."""
        ends = [slot.parameter.coordinate_bounds() for slot in self.slots]
        return np.array([a for a, _ in ends]), np.array([b for _, b in ends])

    def unit(self, name: str, u: np.ndarray) -> str:
        """Unit of a parameter at coordinates `u`, powers that are parameters put in: N/m^q is N/m^1.4 at q = 1.4."""
        slot = self.slots[self.index[name]]
        text = slot.parameter.unit
        for k, other in enumerate(self.slots):
            if other.owner == slot.owner and "^" in text:
                value = f"{other.parameter.transform.from_unconstrained(u[k]):.3g}"
                text = re.sub(rf"\^{re.escape(other.parameter.name)}\b", "" if value == "1" else f"^{value}", text)
        return text

    def public(self, name: str, u: np.ndarray, sd: float) -> dict[str, Any]:
        """Estimate, standard deviation and 95 % interval of a parameter in its public unit.

        `u` has the coordinates of all, shape (parameters,), and `sd` is the deviation of its own.
        """
        transform, at = self.parameter(name).transform, float(u[self.index[name]])
        value = transform.from_unconstrained(at)
        low, high = transform.interval(at - 1.959964 * sd, at + 1.959964 * sd)
        return {"estimate": value, "sd": transform.slope(value) * sd, "q025": low, "q975": high,
                "unit": self.unit(name, u)}


@final
class ParameterSpace(AbstractSpace):
    """All parameters of a reference model and a family's effects, in one fixed order.

    Args:
        reference: template of the reference model (its values are the defaults).
        effects: classes of the effects, all present, each at its null unless set.
        commons: errors that all records of the campaign share; the law does not depend on them.

    Attributes:
        absent: effects whose parameters keep their places, but which `build` leaves out of the law.
    """

    absent: tuple[type[AbstractEffect], ...] = ()

    def __init__(self, reference: AbstractModel, effects: Sequence[type[AbstractEffect]],
                 commons: Sequence[Common] = ()):
        self.reference, self.effects, self.commons = reference, tuple(effects), tuple(commons)
        self.slots = (
            *(Slot(p.name, None, dc.replace(p, default=float(read_field(reference, p.field))))
              for p in parameters_of(reference)),
            *(Slot(f"{effect.id}.{p.name}", effect.id, p) for effect in self.effects for p in parameters_of(effect)),
            *(common.slot for common in self.commons))
        self.index = {slot.name: k for k, slot in enumerate(self.slots)}
        if len(self.index) != len(self.slots):
            raise InputError("two parameters of the model have the same name; give every effect an id of its own")

    def __eq__(self, other) -> bool:
        return isinstance(other, ParameterSpace) and self.key == other.key

    def __hash__(self) -> int:
        return hash(self.key)

    @property
    def key(self) -> tuple:
        """What identifies the space: compiled programs are shared between equal ones."""
        kinds = tuple(type(part) for part in parts_of(self.reference))
        return (kinds, tuple(list_choices(self.reference).items()), self.effects,
                tuple((c.column, c.relative) for c in self.commons), self.absent)

    @property
    def text(self) -> str | None:
        """The same in words, for other processes; None where a class is not the package's own, by its name."""
        kinds, choices, effects, commons, absent = self.key
        plain = all(isinstance(x, str | int | float | None) for _, x in choices)
        listed = self.family.directions  # made by a function, and told apart by their names within a family
        if not plain or not all(one in listed or is_ours(one) for one in (*kinds, *effects)):
            return None
        named = [[f"{one.__module__}.{one.__qualname__}" for one in group] for group in (kinds, effects, absent)]
        return repr((named, choices, commons))

    def thin_out(self, free: Iterable[str], u: np.ndarray) -> "ParameterSpace":
        """The same space without the costly effects that a fit of the `free` parameters leaves at their null.

        `u` are coordinates, shape (..., parameters).
        """
        moved = {name.split(".")[0] for name in free}
        absent = tuple(effect for effect in self.effects if effect.costly and effect.id not in moved and all(
            np.all(u[..., k] == slot.parameter.transform.from_field(slot.parameter.default))
            for k, slot in enumerate(self.slots) if slot.owner == effect.id and slot.parameter.kind != "shape"))
        if absent == self.absent:
            return self
        thin = copy.copy(self)
        thin.absent = absent
        return thin

    def coordinates(self, values: Mapping[str, float] | None = None) -> np.ndarray:
        """Coordinates of all parameters, shape (parameters,): defaults, with `values` (fields) put in by name."""
        values = values or {}
        for name in values:
            if name not in self.index:
                raise InputError(f"there is no parameter {name!r} in this model; its parameters are: "
                                 f"{', '.join(self.index)}")
        found = []
        for slot in self.slots:
            value = values.get(slot.name, slot.parameter.default)
            try:
                found.append(slot.parameter.transform.from_field(value))
            except ValueError:
                raise InputError(f"{slot.name} has to {slot.parameter.transform.words}; it is {value:g}") from None
        return np.array(found)

    @property
    def family(self) -> Family:
        """Of the records that the model describes."""
        return find_family(type(self.reference).family)

    def build(self, u: Array) -> Any:
        """The law at coordinates `u`, shape (parameters,): a `ContactLaw`, `FrictionLaw` or `StrikeLaw`."""
        values = {(s.owner, s.parameter.field): s.parameter.transform.to_field(u[k]) for k, s in enumerate(self.slots)}
        own = [p.field for p in parameters_of(self.reference)]
        reference = eqx.tree_at(lambda r: [read_field(r, field) for field in own], self.reference,
                                [values[None, field] for field in own])
        return reference.extend(tuple(
            effect(**{p.field: values[effect.id, p.field] for p in parameters_of(effect)}) for effect in self.effects
            if effect not in self.absent))

    def of(self, owners: Iterable[str | None]) -> list[str]:
        """Names of the free parameters of the given owners (None: the reference model)."""
        owners = tuple(owners)
        return [s.name for s in self.slots if s.owner in owners and s.parameter.free]
