"""Functions of small arrays written out in scalars, as they would be by hand.

In a compiled loop over lanes each stacked vector is a branch for every number, and what branches is not vectorised;
sums and products of scalars are.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend import core
from jaxtyping import Array


LARGEST = 64  # numbers of an array that is written out; larger ones stay whole
_EACH = frozenset("""
    abs add and atan2 convert_element_type cos div eq erf exp expm1 floor ge gt integer_pow is_finite le log log1p
    logistic lt max min mul ne neg not or pow rsqrt select_n sign sin sqrt square sub tan tanh xor
""".split())
_INLINE = ("pjit", "jit", "closed_call", "core_call")


def write_out(function: Callable[..., Array]) -> Callable[..., list[Array]]:
    """The elements, scalars in a list, of what a function returns: one small array of arrays in any pytrees.

    The operations are those of the function, element by element, so that values and derivatives are the same to
    rounding. What is not known here how to write out is done on whole arrays.
    """
    def scalars(*arguments):
        leaves = [jnp.asarray(leaf) for leaf in jax.tree.leaves(arguments)]
        closed = jax.make_jaxpr(function)(*arguments)
        (found,) = _run(closed.jaxpr, closed.consts, leaves)
        return list(_split(found).ravel())

    return scalars


def _run(jaxpr: Any, constants: Any, arguments: Any) -> list[Any]:
    """Results of a traced function, each an array of JAX or a NumPy array of scalars."""
    known = dict(zip([*jaxpr.constvars, *jaxpr.invars], [*constants, *arguments], strict=True))

    def read(variable):
        return variable.val if isinstance(variable, core.Literal) else known[variable]

    for equation in jaxpr.eqns:
        found = _apply(equation, [read(variable) for variable in equation.invars])
        known.update(zip(equation.outvars, found, strict=True))
    return [read(variable) for variable in jaxpr.outvars]


def _apply(equation: Any, values: list[Any]) -> list[Any]:
    """Results of one operation."""
    name, out, given = equation.primitive.name, equation.outvars[0].aval, equation.params
    if name in _INLINE:
        inner = given["jaxpr"] if "jaxpr" in given else given["call_jaxpr"]
        return _run(inner.jaxpr, inner.consts, values)
    if max([out.size, *(np.size(value) for value in values)]) <= LARGEST:
        if name in _EACH:
            found = np.empty(out.shape, dtype=object)
            parts = [np.broadcast_to(_split(value), out.shape) for value in values]
            for place in np.ndindex(out.shape):
                found[place] = equation.primitive.bind(*(part[place] for part in parts), **given)
            return [found]
        moved = _move(name, values, out, given)
        if moved is not None:
            return [moved]
    found = equation.primitive.bind(*map(_join, values), **equation.primitive.get_bind_params(given))
    return list(found) if equation.primitive.multiple_results else [found]


def _move(name: str, values: list[Any], out: Any, given: dict[str, Any]) -> np.ndarray | None:
    """The result of an operation that only moves, adds or multiplies elements; None where it is not known."""
    if name == "concatenate":
        return np.concatenate([_split(value) for value in values], axis=given["dimension"])
    if name == "stack":
        return np.stack([_split(value) for value in values], axis=given["axis"])
    if name == "broadcast_in_dim" and len(values) == 1:
        shape = np.ones(len(out.shape), dtype=int)
        shape[list(given["broadcast_dimensions"])] = np.shape(values[0])
        return np.broadcast_to(_split(values[0]).reshape(shape), out.shape)
    if name in ("reshape", "squeeze", "expand_dims") and len(values) == 1:
        return _split(values[0]).reshape(out.shape)
    if name == "transpose":
        return _split(values[0]).transpose(given["permutation"])
    if name == "slice":
        strides = given["strides"] or (1,) * len(out.shape)
        return _split(values[0])[tuple(map(slice, given["start_indices"], given["limit_indices"], strides))]
    if name == "rev":
        return np.flip(_split(values[0]), given["dimensions"])
    if name == "reduce_sum":
        return _hold(np.sum(_split(values[0]), axis=given["axes"]))
    if name == "dot_general" and given["dimension_numbers"][1] == ((), ()):
        return _hold(np.tensordot(*map(_split, values), axes=given["dimension_numbers"][0]))
    return None


def _split(value: Any) -> np.ndarray:
    """A NumPy array of scalars."""
    if isinstance(value, np.ndarray) and value.dtype == object:
        return value
    found = np.empty(np.shape(value), dtype=object)
    for place in np.ndindex(found.shape):
        found[place] = value[place] if found.shape else value
    return found


def _hold(value: Any) -> np.ndarray:
    """A NumPy array of one scalar, where it is not one of several already."""
    if isinstance(value, np.ndarray):
        return value
    found = np.empty((), dtype=object)
    found[()] = value
    return found


def _join(value: Any) -> Any:
    """An array of JAX."""
    if not (isinstance(value, np.ndarray) and value.dtype == object):
        return value
    return jnp.stack(list(value.ravel())).reshape(value.shape) if value.shape else value[()]
