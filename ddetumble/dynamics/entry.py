"""What a simulation is given, checked where its values are known; plain numbers become arrays."""

from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._errors import InputError
from .._numerics import is_known
from ..contact.effect import AbstractLaw, AbstractModel
from ..effects.free import PLAN


Law = TypeVar("Law", bound=AbstractLaw)


def read_law(law: Any, kind: type[Law], example: str, verb: str) -> tuple[Law, tuple[str, ...]]:
    """The law, of a reference model the one without effects, and the condition that its gas needs.

    Raises:
        InputError: It is none of that kind; `example` says which is.
    """
    found = law.extend(()) if isinstance(law, AbstractModel) else law
    if not isinstance(found, kind):
        raise InputError(f"{verb} needs {example}; it was given a {type(law).__name__}")
    return found, (("initial_pressure",) if "gas" in found.reference.provides else ())


def read_conditions(conditions: Mapping[str, Any], needs: Sequence[str], verb: str, batched: bool = False
                    ) -> dict[str, Array]:
    """Conditions as scalar arrays, of any shape where `batched`; what a free term is laid out by comes along with them
    as longer ones.

    Raises:
        InputError: One that is needed is missing, or one is no number, not scalar, or not finite.
    """
    missing = [name for name in needs if name not in conditions]
    if missing:
        raise InputError(f"{verb} needs the condition {missing[0]!r}; it was given {', '.join(conditions) or 'none'}")
    found = {}
    for name, value in conditions.items():
        try:
            array = jnp.asarray(value, dtype=float)
        except (TypeError, ValueError):
            raise InputError(f"{verb}: {name} must be a number in SI units; got {value!r}") from None
        if array.ndim and not batched and not name.startswith(PLAN):
            raise InputError(f"{verb}: {name} has shape {array.shape}, but one impact has one value; batch impacts by "
                             "jax.vmap")
        if is_known(array) and not np.all(np.isfinite(array)):
            raise InputError(f"{verb}: {name} is {float(np.ravel(array)[np.argmin(np.isfinite(array))])}")
        if name.endswith("_pressure") and is_known(array) and np.any(np.asarray(array) < 0):
            raise InputError(f"{verb}: {name} is absolute, and cannot be negative; it is {float(np.min(array)):g} Pa")
        found[name] = array
    return found


def read_times(times: Any, verb: str) -> Array:
    """Wanted times, shape (times,); `InputError` where they are no numbers, of another shape, none, or not finite."""
    try:
        array = jnp.asarray(times, dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"{verb}: times must be numbers in seconds; got {type(times).__name__}") from None
    if array.ndim != 1 or array.shape[0] == 0:
        raise InputError(f"{verb}: times must be one-dimensional with at least one time; their shape is {array.shape}")
    if is_known(array) and not np.isfinite(array).all():
        raise InputError(f"{verb}: time number {int(np.argmin(np.isfinite(array))) + 1} is not a number")
    return array


def refuse_values(values: Mapping[str, Any], verb: str) -> None:
    """Raise `InputError` where a value is known that is not positive."""
    for name, value in values.items():
        if is_known(value) and np.ndim(value) == 0 and not float(value) > 0:
            raise InputError(f"{verb}: {name} must be positive; it is {float(value):g}")
