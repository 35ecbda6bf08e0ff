"""A plain function as an effect: `effect` makes the class that fits, comparisons and `discover` take.

    @effect("elastic", k=parameter("N/m", typical=2e3, starts=(5e3,)), depth=parameter("m", 4e-3, kind="shape"))
    def end_stop(contact, k, depth):
        '''F_k gains k (delta - depth)_+.'''
        return k * jnp.maximum(contact.depression - depth, 0.0)

    fit(campaign, effects=[end_stop]).parameters["end-stop.k"]

An effect with a state of its own (`AbstractStatefulEffect`, `AbstractInnerTorque`) needs a class.
"""

import copy
import dataclasses as dc
import inspect
from collections.abc import Callable, Mapping
from typing import Any

from .effect import IMPACT_STAGES, AbstractEffect, Scalar
from .gripping import AbstractAxesEffect, AbstractComplianceEffect, AbstractReactionEffect
from .sliding import AbstractFrictionForce, AbstractLoadEffect, AbstractRubberEffect
from .torque import AbstractGyroEffect, AbstractInertiaEffect, AbstractTorque


STAGES: dict[str, type[AbstractEffect]] = {base.stage: base for base in (
    *IMPACT_STAGES, AbstractRubberEffect, AbstractLoadEffect, AbstractFrictionForce,
    AbstractComplianceEffect, AbstractReactionEffect, AbstractAxesEffect, AbstractInertiaEffect, AbstractTorque,
    AbstractGyroEffect)}
LAST = 9  # `order` among effects on sensors: after those of the catalogue, which have 0 to 5


def effect(stage: str, *, id: str = "", law: str = "", reference: str = "", requires: tuple[str, ...] = (),
           order: int = LAST, **parameters: Any) -> Callable[[Callable[..., Any]], type[Any]]:
    """Make a function the law of an effect; a decorator.

    The function takes the state that its stage sees (the arguments of the stage's method: `contact`, `slide`, `patch`,
    `spin`, ...) and then the parameters by name. It returns what the method returns, in SI units, and exactly the null
    (0, of a factor 1) at the parameters' nulls.

    Args:
        stage: where it acts, a key of `STAGES`.
        id: public name; by default that of the function, with hyphens.
        law: in one line; by default the first line of the function's docstring.
        reference: where the law comes from; by default function and module.
        requires: what records or the reference model must have; see `AbstractEffect`.
        order: among effects on the sensor or the gyroscopes, which act in ascending order.
        parameters: of the law by name, each as `parameter(...)` declares it.

    Returns:
        A decorator that turns the function into a class derived from the stage's, of the function's name and module,
        so that a saved model finds it again.

    Raises:
        ValueError: There is no such stage.
        TypeError: The arguments of the function are not state and parameters.
    """
    if stage not in STAGES:
        raise ValueError(f"there is no stage {stage!r}; the stages are {', '.join(STAGES)}. An effect at a stage of "
                         "your own is a class derived from the stage's.")

    def decorate(function: Callable[..., Any]) -> type[Any]:
        name, text = function.__name__, inspect.getdoc(function) or ""
        ordered = "order" in STAGES[stage].__annotations__
        return declare_function(
            function, stage, parameters, function.__qualname__, function.__module__, text,
            id=id or name.replace("_", "-"), law=law or text.partition("\n")[0].rstrip("."), requires=requires,
            reference=reference or f"function {name} of {function.__module__}", **({"order": order} if ordered else {}))

    return decorate


def declare_function(function: Callable[..., Any], stage: str, parameters: Mapping[str, Any], name: str, module: str,
                     text: str, **attributes: Any) -> type[Any]:
    """The class of an effect whose law is a function of state and parameters; arguments as of `declare_effect`."""
    base = STAGES[stage]
    (method,) = base.__abstractmethods__
    state = list(inspect.signature(getattr(base, method)).parameters)[1:]
    given = list(inspect.signature(function).parameters)
    strange = [key for key, one in parameters.items()
               if not (isinstance(one, dc.Field) and "parameter" in one.metadata)]
    if strange:
        raise TypeError(f"`{strange[0]}` of `{name}` must be declared by `parameter(unit, ...)`.")
    if not parameters or len(given) != len(state) + len(parameters) or set(given[len(state):]) != set(parameters):
        wanted = ", ".join([*state, *(parameters or ["at least one parameter"])])
        further = [key for key in given[len(state):] if key not in parameters]
        raise TypeError(f"`{name}` must take ({wanted}) to act at the stage {stage!r}; it takes ({', '.join(given)})."
                        + (f" Declare each parameter in the decorator, such as `{further[0]}=dd.effects.parameter("
                           "unit, ...)`; a default in the function declares none, and a constant belongs outside of it."
                           if further else ""))

    def act(self, *values):
        return function(*values, **{key: getattr(self, key) for key in parameters})

    act.__doc__ = text
    return declare_effect((base,), parameters, {method: act}, name, module, text, **attributes)


def declare_effect(bases: tuple[type[AbstractEffect], ...], parameters: Mapping[str, Any], methods: Mapping[str, Any],
                   name: str, module: str, text: str, **attributes: Any) -> type[Any]:
    """A class of effects from bases (one or more stages), parameters by name and methods, the laws, by name.

    Parameters, each as `parameter(...)` gives it, may be shared by several classes; name (qualified), module and text
    are those of the class, attributes its `id`, `law`, `reference`, ...
    """
    own = {key: copy.copy(field) for key, field in parameters.items()}  # a class writes name and type into its fields
    space = {"__annotations__": dict.fromkeys(own, Scalar), **own, **methods, **attributes, "__module__": module,
             "__doc__": text, "__qualname__": name}
    metaclass: Any = type(bases[0])
    return metaclass(name.rpartition(".")[2], bases, space)
