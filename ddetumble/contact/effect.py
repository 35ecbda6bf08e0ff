"""What an effect is: one missing piece of physics at one named stage of the contact (the file that users read).

An effect is an `equinox` module with a few parameters. It sees the state of the contact (`Contact`) and returns its own
contribution; at its null value the contribution is exactly absent. The stages are the classes below, of which it
derives from one.

An effect that needs a state of its own (gas lost, a relaxing force) is also an `AbstractStatefulEffect`. Effects on
slip records are in `contact.sliding`, those on tumbling records (torques) in `contact.torque`.
"""

import abc
import dataclasses as dc
import functools
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, Self, cast, final

import equinox as eqx
import jax.numpy as jnp
from equinox import AbstractClassVar, AbstractVar
from jaxtyping import Array

from .._numerics import is_known, scalar, type_scalar
from .signal import Signal
from .transform import TRANSFORMS, Transform


Scalar = type_scalar
ROUNDING = 1e-9  # of a physical limit, by which a fit that is bounded there may lie beyond it in public units


@final
class Contact(eqx.Module):
    """The state of the contact that an effect sees; every entry is a scalar (the caller batches by `vmap`).

    Attributes:
        time: since first touch [s].
        depression: how far the ball is squeezed [m].
        depression_rate: its rate, > 0 while loading [m/s].
        contact_radius: radius of the flat disc [m].
        volume_ratio: undeformed over present volume, V0/V' [-].
        outer_diameter: of the undeformed ball [m].
        pressure: of the gas, absolute [Pa]; 0 before it is known (geometry, gas).
        elastic_force: F_k [N]; 0 before it is known.
        initial_pressure: absolute [Pa].
        approach_speed: at first touch [m/s].
        conditions: every condition of the record by name, SI.
        state: the effect's own state, 0 for effects without one.
    """

    time: Scalar
    depression: Scalar
    depression_rate: Scalar
    contact_radius: Scalar
    volume_ratio: Scalar
    outer_diameter: Scalar
    pressure: Scalar
    elastic_force: Scalar
    initial_pressure: Scalar
    approach_speed: Scalar
    conditions: Mapping[str, Array]
    state: Scalar

    @property
    def contact_area(self) -> Array:
        """Area of the flat disc, pi b**2 [m²]."""
        return jnp.pi * self.contact_radius**2


@final
@dc.dataclass(frozen=True)
class Parameter:
    """What is known about one parameter before any measurement.

    Attributes:
        name: public name (`k_w`); the result calls it `effect-id.k_w`.
        field: attribute of the module that holds it.
        unit: SI unit as text.
        default: value when nothing else is said (for an amplitude: its null).
        kind: `amplitude` (its null switches the effect off) or `shape` (means nothing while the amplitude is null).
        typical: size of a change that matters; scales the fit.
        sign: +1 where physics allows only values above the null, -1 below, 0 both.
        bounds: hard limits (low, high) of the field, within which a fit moves.
        limits: range (low, high) that physics allows, in the public unit; a value beyond it is no explanation.
        limits_reason: why, in one phrase.
        starts: values to start a fit from (amplitudes) or to scan (shapes).
        coordinate: name of its transform: `linear`, `log`, `logit` (of a value in 0..1) or `inverse` (the field holds
            1/parameter).
        free: whether a fit of the effect frees it from the start; else it is held at its default (an amplitude at its
            null) until freeing it predicts better.
        singular: whether the derivative vanishes at the null, so that the effect is scored at its starts instead.
        text: one phrase that says what it is.
    """

    name: str
    field: str
    unit: str
    default: float
    kind: str = "amplitude"
    typical: float = 1.0
    sign: int = 0
    bounds: tuple[float, float] = (-float("inf"), float("inf"))
    limits: tuple[float, float] = (-float("inf"), float("inf"))
    limits_reason: str = ""
    starts: tuple[float, ...] = ()
    coordinate: str = "linear"
    free: bool = True
    singular: bool = False
    text: str = ""

    @property
    def transform(self) -> Transform:
        """Between its value and the coordinate in which a fit moves."""
        return TRANSFORMS[self.coordinate]

    def coordinate_bounds(self) -> tuple[float, float]:
        """Coordinates between which a fit moves it."""
        return self.transform.place_fields(*self.bounds)

    def excludes(self, low: float, high: float) -> bool:
        """Whether an interval, in the public unit, lies wholly beyond what physics allows, but for rounding."""
        least, most = self.limits
        return high < least - ROUNDING * abs(least) or low > most + ROUNDING * abs(most)


def parameter(
    unit: str, default: float = 0.0, *, name: str | None = None, kind: str = "amplitude", typical: float = 1.0,
    sign: int = 0, bounds: tuple[float, float] | None = None, limits: tuple[float, float] | None = None,
    limits_reason: str = "", starts: tuple[float, ...] = (), coordinate: str = "linear", free: bool = True,
    singular: bool = False, text: str = "",
) -> Any:
    """Declare a scalar parameter of an effect or of a reference model; `dd.effects.Parameter` explains the arguments.

    A fit of the effect moves it, an amplitude as well as a shape, unless it is declared `free=False`.
    """
    if kind not in ("amplitude", "shape", "reference"):
        raise ValueError(f"`parameter(kind=...)` must be 'amplitude', 'shape' or 'reference'; got {kind!r}.")
    if coordinate not in TRANSFORMS:
        raise ValueError(f"`parameter(coordinate=...)` must be linear, log, logit or inverse; got {coordinate!r}.")
    free_range = (-float("inf"), float("inf"))
    declared = Parameter(name or "", "", unit, float(default), kind, float(typical), sign, bounds or free_range,
                         limits or free_range, limits_reason, tuple(float(x) for x in starts), coordinate, free,
                         singular, text)
    return eqx.field(converter=scalar, default=float(default), metadata={"parameter": declared})


def parameters_of(module: Any) -> tuple[Parameter, ...]:
    """The declared parameters of an effect or model (class or instance), in the order of its fields.

    Of an instance, parts that are models themselves are gone through too; `field` is then a path such as
    `ball.effective_mass`.
    """
    found = []
    for field in dc.fields(module):
        declared = field.metadata.get("parameter")
        part = None if isinstance(module, type) else getattr(module, field.name)
        if declared is not None:
            found.append(dc.replace(declared, name=declared.name or field.name, field=field.name))
        elif isinstance(part, AbstractModel):
            found += [dc.replace(p, field=f"{field.name}.{p.field}") for p in parameters_of(part)]
    return tuple(found)


def read_field(module: Any, path: str) -> Any:
    """Value of a field, or of a part's field (`ball.effective_mass`)."""
    return functools.reduce(getattr, path.split("."), module)


def list_choices(model: Any) -> dict[str, Any]:
    """What is chosen once for a model and is no parameter (`doubled_core`), by the path of its field."""
    found = {}
    for field in dc.fields(model):
        value = getattr(model, field.name)
        if isinstance(value, AbstractModel):
            found |= {f"{field.name}.{path}": choice for path, choice in list_choices(value).items()}
        elif "parameter" not in field.metadata:
            found[field.name] = value
    return found


def parts_of(model: Any) -> tuple[Any, ...]:
    """A model and the models that it is made of."""
    parts = [getattr(model, field.name) for field in dc.fields(model)]
    return (model, *(p for part in parts if isinstance(part, AbstractModel) for p in parts_of(part)))


def identify_model(model: Any) -> tuple[Any, ...]:
    """What two reference models have in common that are the same but for their names: their parts and choices."""
    return tuple(type(part) for part in parts_of(model)), tuple(list_choices(model).items())


class Shown(eqx.Module):
    """A module that prints its values: `Adhesion(tau_a=8.6e+04)`."""

    def __repr__(self) -> str:
        shown = []
        for field in dc.fields(self):
            value = getattr(self, field.name)
            if "parameter" in field.metadata:
                one = is_known(value) and jnp.ndim(value) == 0
                shown.append(f"{field.name}={f'{float(value):.7g}' if one else eqx.tree_pformat(value)}")
            elif isinstance(value, Shown) or value != field.default:  # choices that are the usual ones are left out
                shown.append(f"{field.name}={value!r}")
        return f"{type(self).__name__}({', '.join(shown)})"


class AbstractEffect(Shown):
    """Base of all effects.

    Attributes:
        id: public name, as `ddetumble effects` lists it.
        law: the law in one line.
        reference: where the law comes from.
        requires: what the reference model must have for the effect to mean anything: any of `gas`, `geometry`,
            `damping`, or the name of a condition such as `sequence`.
        stage: where it acts; stated by the class that it derives from.
        family: of the records on which it acts: `impact`, `slip`, `tumble` or `oblique` (effects of the first two act
            on oblique impacts too).
        line: public name (`effect-id.f_0`) of the parameter that is the frequency of something periodic, if any: fits
            start from the strongest line in the residuals too, as a frequency is found from nearby only.
        costly: whether it slows every evaluation down by being there, even at its null: programs of fits that do not
            move it leave it out.
        lookalike: an error of the bench, in words, that records of its family may not tell from it, if any; a verdict
            that names the effect names that too.
    """

    id: AbstractClassVar[str]
    law: AbstractClassVar[str]
    reference: AbstractClassVar[str]
    requires: ClassVar[tuple[str, ...]] = ()
    stage: ClassVar[str] = ""
    family: ClassVar[str] = "impact"
    line: ClassVar[str | None] = None
    costly: ClassVar[bool] = False
    lookalike: ClassVar[str] = ""


class AbstractModel(Shown):
    """Base of all reference models.

    Attributes:
        family: of the records that it describes: `impact`, `slip`, `oblique` or `tumble`.
        provides: what effects may require.
        valid: ranges (low, high) of conditions, SI, beyond which its equations do not hold; no test is advised there.
    """

    family: AbstractClassVar[str]
    provides: ClassVar[tuple[str, ...]] = ()
    valid: ClassVar[Mapping[str, tuple[float, float]]] = {}

    @abc.abstractmethod
    def extend(self, effects: tuple[AbstractEffect, ...]) -> Any:
        """This model with effects: its law."""

    def derive(self) -> Mapping[str, tuple[Scalar, str]]:
        """What follows from its parameters and is told beside them, by name, each with its unit; smooth in them."""
        return {}

    def __add__(self, effect: AbstractEffect | type[AbstractEffect]) -> "AbstractLaw":
        """This model extended by one effect: `Ball() + Adhesion()`."""
        return self.extend(()) + effect


class AbstractLaw(Shown):
    """Base of all laws: a reference model and the effects that extend it.

    Attributes:
        reference: the reference model.
        effects: any number of effects, at their null or not.
    """

    reference: AbstractVar[AbstractModel]
    effects: AbstractVar[tuple[AbstractEffect, ...]]

    def __repr__(self) -> str:
        return " + ".join(map(repr, (self.reference, *self.effects)))

    def pick(self, stage: str) -> list[Any]:
        """Effects that act at a stage, in their order."""
        return [effect for effect in self.effects if stage in list_stages(type(effect))]

    def __add__(self, effect: AbstractEffect | type[AbstractEffect]) -> Self:
        """This law extended by one more effect, an instance or a class (which then stands at its defaults).

        Raises:
            TypeError: It is no effect, or the law has one of this id already.
        """
        require_effect(effect)
        if isinstance(effect, type):
            effect = cast(Callable[[], AbstractEffect], effect)()
        if effect.id in [own.id for own in self.effects]:
            raise TypeError(f"the model already has the effect {effect.id!r}")
        return dc.replace(self, effects=(*self.effects, effect))


def require_effect(value: Any, instances: bool = True) -> None:
    """Refuse what is no effect: neither a class of such nor, with `instances`, one of its instances.

    Raises:
        TypeError: It is none.
    """
    if isinstance(value, type) and issubclass(value, AbstractEffect):
        return
    if isinstance(value, AbstractEffect):
        if not instances:
            raise TypeError(f"`effects` takes classes: give {type(value).__name__}, or extend the model by the "
                            f"instance, model + {value!r}")
        return
    name = getattr(value, "__name__", None)
    if callable(value) and name:
        raise TypeError(f"{name} is not an effect: make a function one by `@dd.effect(stage, ...)` above it, and "
                        "derive a class from one of those in dd.effects")
    raise TypeError(f"a model is extended by effects, such as dd.effects.Adhesion(); a {type(value).__name__} is none")


def is_scored(parameter: Parameter) -> bool:
    """Whether it is an amplitude with which an effect is scored, and from which its fits start (none that is held)."""
    return parameter.kind != "shape" and (parameter.free or parameter.singular)


def is_absent(effect: AbstractEffect) -> bool:
    """Whether every amplitude of an effect stands at its null, so that it contributes exactly nothing."""
    return all(float(read_field(effect, p.field)) == p.default for p in parameters_of(effect) if p.kind != "shape")


def read_validity(model: AbstractModel) -> dict[str, tuple[float, float]]:
    """Ranges of conditions, SI, within which the equations of a model and of all its parts hold."""
    found: dict[str, tuple[float, float]] = {}
    for part in parts_of(model):
        for name, (low, high) in type(part).valid.items():
            first, last = found.get(name, (low, high))
            found[name] = max(first, low), min(last, high)
    return found


class AbstractSizeEffect(AbstractEffect):
    """Changes the size of the undeformed ball."""

    stage: ClassVar[str] = "size"

    @abc.abstractmethod
    def growth(self, contact: Contact) -> Scalar:
        """Relative growth of the outer diameter [-], from the conditions alone."""


class AbstractGeometryEffect(AbstractEffect):
    """Changes the radius of the contact disc."""

    stage: ClassVar[str] = "geometry"

    @abc.abstractmethod
    def contact_radius(self, contact: Contact) -> Scalar:
        """Increment of the contact radius [m]."""


class AbstractGasEffect(AbstractEffect):
    """Changes the pressure of the enclosed gas."""

    stage: ClassVar[str] = "gas"

    @abc.abstractmethod
    def pressure_factor(self, contact: Contact) -> Scalar:
        """Factor on the gas pressure [-]; 1 at the null."""


class AbstractElasticEffect(AbstractEffect):
    """Adds to the elastic force, so that the damping multiplies it too."""

    stage: ClassVar[str] = "elastic"

    @abc.abstractmethod
    def force(self, contact: Contact) -> Scalar:
        """Increment of the elastic force [N]."""


class AbstractStiffnessEffect(AbstractEffect):
    """Multiplies the whole elastic force."""

    stage: ClassVar[str] = "stiffness"

    @abc.abstractmethod
    def factor(self, contact: Contact) -> Scalar:
        """Factor on the elastic force [-]; 1 at the null."""


class AbstractContactForce(AbstractEffect):
    """Adds to the contact force before it is clamped at zero."""

    stage: ClassVar[str] = "contact"

    @abc.abstractmethod
    def force(self, contact: Contact) -> Scalar:
        """Increment of the contact force [N]."""


class AbstractSurfaceForce(AbstractEffect):
    """Adds to the contact force after the clamp: a pulling force is possible."""

    stage: ClassVar[str] = "surface"

    @abc.abstractmethod
    def force(self, contact: Contact) -> Scalar:
        """Increment of the contact force [N]."""


class AbstractDriveEffect(AbstractEffect):
    """A force of the arm on the ball."""

    stage: ClassVar[str] = "drive"

    @abc.abstractmethod
    def force(self, contact: Contact) -> Scalar:
        """Force towards the plate [N]."""


class AbstractRestitutionEffect(AbstractEffect):
    """Changes the coefficient of restitution with the conditions."""

    stage: ClassVar[str] = "restitution"

    @abc.abstractmethod
    def factor(self, contact: Contact) -> Scalar:
        """Factor on the coefficient of restitution [-]; 1 at the null."""


class AbstractSensorEffect(AbstractEffect):
    """Changes what the force gauge reads; effects act in ascending `order`.

    Attributes:
        rings: whether its reading oscillates faster than the force, so that it is followed at every sample.
    """

    stage: ClassVar[str] = "sensor"
    rings: ClassVar[bool] = False
    order: AbstractClassVar[int]

    @abc.abstractmethod
    def reading(self, force: Signal) -> Signal:
        """The reading for a force given over time [N]."""


class AbstractStatefulEffect(AbstractEffect):
    """An effect with one state of its own, integrated during contact."""

    @abc.abstractmethod
    def initial(self) -> Scalar:
        """State at first touch."""

    @abc.abstractmethod
    def rate(self, contact: Contact) -> Scalar:
        """Time derivative of `contact.state`."""

    @abc.abstractmethod
    def size(self, contact: Contact) -> Scalar:
        """Typical size of the state, which scales the integrator's tolerance."""


def family_of(effect: Any) -> str:
    """Family of records on which an effect (class or instance) acts: `impact`, `slip`, `oblique` or `tumble`."""
    return getattr(effect, "family", AbstractEffect.family)


IMPACT_STAGES: tuple[type[AbstractEffect], ...] = (
    AbstractSizeEffect, AbstractGeometryEffect, AbstractGasEffect, AbstractElasticEffect, AbstractStiffnessEffect,
    AbstractContactForce, AbstractSurfaceForce, AbstractDriveEffect, AbstractRestitutionEffect, AbstractSensorEffect)


MEASURING = ("sensor", "axes", "gyroscope")  # stages of what happens to readings, not to the ball or the body


def list_stages(kind: type) -> list[str]:
    """Stages from which a class of effects derives, each once."""
    return list(dict.fromkeys(base.__dict__["stage"] for base in kind.__mro__ if base.__dict__.get("stage")))


def stage_of(effect: Any) -> str:
    """Name of the stage at which an effect (class or instance) acts."""
    if not getattr(effect, "stage", ""):
        raise TypeError(f"`{getattr(effect, '__name__', type(effect).__name__)}` has no stage: derive it from one of "
                        + ", ".join(base.__name__ for base in IMPACT_STAGES) + ".")
    return effect.stage
