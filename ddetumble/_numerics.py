"""Small numerical helpers that keep values and gradients finite."""

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jax.core import Tracer
from jaxtyping import Array, Float


BLOCK = 128  # samples that are computed at once
# Two compiled programs side by side use both of two cores better than one does, whose steps are mostly in sequence.
# Under jax 0.10 they can wait for each other for ever (seen with two fits of slip campaigns), so there it is one.
WORKERS = 2 if jax.__version_info__ >= (0, 11) else 1
T = TypeVar("T")
R = TypeVar("R")
type_scalar = Float[Array, ""]


def map_threads(function: Callable[[T], R], items: Iterable[T]) -> list[R]:
    """Apply a function that runs compiled programs to items, on as many threads as such programs may take."""
    with ThreadPoolExecutor(WORKERS) as pool:
        return list(pool.map(function, items))


def scalar(x: Any) -> Array:
    """Convert anything number-like to a strongly typed 64-bit array, so that new values never recompile."""
    return jnp.asarray(x, dtype=float)


def positive_part(x: Array) -> Array:
    """max(x, 0), with derivative 0 on the negative side; what is not a number stays so."""
    return jnp.where(x <= 0, 0.0, x)


def safe_power(x: Array, exponent: Array) -> Array:
    """x**exponent for x > 0 and 0 for x <= 0, with finite derivatives in both arguments; NaN stays NaN."""
    zero = x <= 0
    return jnp.where(zero, 0.0, jnp.exp(exponent * jnp.log(jnp.where(zero, 1.0, x))))


def safe_sqrt(x: Array) -> Array:
    """Square root that is 0 with derivative 0 for x <= 0; NaN stays NaN."""
    zero = x <= 0
    return jnp.where(zero, 0.0, jnp.sqrt(jnp.where(zero, 1.0, x)))


def safe_divide(a: Array, b: Array) -> Array:
    """a / b, and 0 where b is 0."""
    ok = b != 0
    return jnp.where(ok, a / jnp.where(ok, b, 1.0), 0.0)


def stop(x: Array) -> Array:
    """Treat x as a constant: used for scales that must not carry derivatives."""
    return jax.lax.stop_gradient(x)


def map_samples(f: Callable[[Any], Any], x: Any) -> Any:
    """`jax.vmap(f)(x)`, block by block: what is only on the way does not grow with the number of samples.

    A block whose samples are all alike (padding, or what is read after separation) is computed once.
    """
    count = jax.tree.leaves(x)[0].shape[0]
    if count <= BLOCK:
        return jax.vmap(f)(x)
    blocks = -(-count // BLOCK)
    filled = jax.tree.map(lambda a: jnp.concatenate([a, jnp.repeat(a[-1:], blocks * BLOCK - count, axis=0)])
                          .reshape(blocks, BLOCK, *a.shape[1:]), x)

    def once(block):
        return jax.tree.map(lambda a: jnp.broadcast_to(a, (BLOCK, *a.shape)), f(jax.tree.map(lambda a: a[0], block)))

    def some(block):
        alike = jnp.all(jnp.stack([jnp.all(a == a[:1]) for a in jax.tree.leaves(block)]))
        return jax.lax.cond(alike, once, jax.vmap(f), block)

    return jax.tree.map(lambda a: a.reshape(-1, *a.shape[2:])[:count], jax.lax.map(some, filled))


def is_known(value: Any) -> bool:
    """Whether a value can be looked at now: it is no tracer of JAX."""
    return not any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(value))
