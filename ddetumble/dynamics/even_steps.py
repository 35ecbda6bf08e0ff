r"""Integration by even steps, laid out in memory so that every loop in time is one kernel.

XLA compiles a loop to a single kernel while what one turn touches fits some 64 kB; beyond that each operation of each
turn is a kernel of its own, at 50 ns and more. And it vectorises along the last axis. So what is done many times over
(the bodies of a batch, the directions of a derivative) stands side by side on the last axis, in *lanes*, as many at a
time as fit; steps are taken in groups, since a loop touches all the results that it keeps; and what need not be known
on the way, the values between the nodes, is computed once at the end. The law of motion sees none of this.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_batching import custom_vmap
from jaxtyping import Array

from .._settings import find_platform
from .scalars import write_out


GROUP = 8  # steps whose results one loop keeps: more take room from the lanes, fewer cost more rounds of kernels
ROOM = 70_000  # bytes of states, stages and what the law reads in one loop: beyond some 75,000 it is several kernels
WIDTH = 8  # lanes are a multiple of it: so many numbers of 64 bits are in the widest vectors
ALONG = 4  # nodes that an interpolating polynomial goes through, with their slopes: of degree 7
# Dormand and Prince's method of order 8; its fourteenth stage only begins the next step.
_STAGES = 13
_TABLEAU = dfx.Dopri8.tableau
_WEIGHTS = np.asarray(_TABLEAU.b_sol)[:_STAGES]
_SHARES = np.asarray(_TABLEAU.c)[: _STAGES - 1]
_ROWS = np.zeros((_STAGES - 1, _STAGES))  # of stages two to thirteen, by all stages
for _k, _row in enumerate(_TABLEAU.a_lower[: _STAGES - 1]):
    _ROWS[_k, :_row.size] = _row


def integrate_evenly(field: Callable[[Any, Array, Array], Array], given: Any, start: Array, mesh: Array, time: Array,
                     reverse: bool = False) -> Array:
    r"""Solution of $\dot y = f(g, t, y)$, $y(t_0) = y_0$, at the wanted times, shape (times, states).

    Prince and Dormand's method of order 8 (J. Comput. Appl. Math. 7 (1981) 67) on the mesh, Hermite polynomials of
    degree 7 through its nodes between them.
    Batch with `jax.vmap`; differentiate in forward mode (`jax.jvp`, `jax.jacfwd`) by `given`, `start` and `time`.

    Args:
        field: of (given, t, y) to the shape of y; pure, and without tracers of its own.
        given: whatever it reads, a pytree.
        start: at the first node, shape (states,).
        mesh: even times, shape (steps + 1,); they count as constants.
        time: wanted, shape (times,); beyond the mesh the last polynomial is followed.
        reverse: whether derivatives in reverse mode are wanted too: in JAX's own layout, several times slower.
    """
    leaves, tree = jax.tree.flatten(given)
    kinds = [0 if eqx.is_inexact_array(leaf) else 1 if eqx.is_array(leaf) else 2 for leaf in leaves]
    numbers, others, rest = ([leaf for leaf, kind in zip(leaves, kinds, strict=True) if kind == k] for k in range(3))

    def slope(numbers, others, t, y):
        parts = [iter(numbers), iter(others), iter(rest)]
        return field(jax.tree.unflatten(tree, [next(parts[kind]) for kind in kinds]), t, y)

    mesh = jax.lax.stop_gradient(mesh)
    if reverse:
        return _interpolate(*_march(functools.partial(slope, numbers, others), start, mesh), mesh, time)
    return _lay_out(write_out(slope))(_Motion(numbers, others, start, mesh, time))


class _Motion(NamedTuple):
    """What a motion follows from; tangents and axes of lanes have the same parts."""

    numbers: Any  # arrays that the field reads and derivatives are taken by
    others: Any  # other arrays that it reads
    start: Any
    mesh: Any
    time: Any


def _march(slope: Callable[[Array, Any], Any], start: Any, mesh: Array) -> tuple[Any, Any]:
    """States and slopes at the nodes, shapes (steps + 1, ...), of a state in one array or in several."""
    steps = mesh.shape[0] - 1
    step = (mesh[-1] - mesh[0]) / steps
    groups = -(-steps // GROUP)
    # The last group may be longer than the mesh: its further steps have no length.
    times = jnp.concatenate([mesh[:-1], jnp.repeat(mesh[-1:], groups * GROUP - steps, axis=0)])
    taken = np.arange(groups * GROUP) < steps

    def combine(row, stages):
        return jax.tree.map(lambda a: jnp.sum(row.reshape(-1, *[1] * (a.ndim - 1)) * a, axis=0), stages)

    def advance(y, turn):
        t, h = turn[0], turn[1] * step

        def move(shares):
            return jax.tree.map(lambda a, b: a + h * b, y, shares)

        def add(stages, stage):
            share, row, here = stage
            found = slope(t + share * h, move(combine(row, stages)))
            return jax.tree.map(lambda all, one: all.at[here].set(one), stages, found), None

        first = slope(t, y)
        stages = jax.tree.map(lambda a: jnp.zeros((_STAGES, *a.shape)).at[0].set(a), first)
        # One stage after the other in a loop: written out, thirteen copies of the law took a minute to compile.
        stages, _ = jax.lax.scan(add, stages, (_SHARES, _ROWS, np.arange(1, _STAGES)))
        return move(combine(_WEIGHTS, stages)), (y, first)

    turns = (times.reshape(groups, GROUP, *times.shape[1:]), taken.reshape(groups, GROUP).astype(float))
    last, found = jax.lax.scan(lambda y, group: jax.lax.scan(advance, y, group), start, turns)
    return jax.tree.map(lambda a, end: jnp.concatenate([a.reshape(-1, *a.shape[2:])[:steps], end[None]]), found,
                        (last, slope(mesh[-1], last)))


def _interpolate(values: Array, slopes: Array, mesh: Array, time: Array) -> Array:
    """Values at the times by Hermite's polynomials through the nodes about them, shape (times, ...)."""
    steps = mesh.shape[0] - 1
    step, along = (mesh[-1] - mesh[0]) / steps, min(ALONG, steps + 1)
    passed = ((time[:, None] if mesh.ndim > time.ndim else time) - mesh[0]) / step
    begin = jnp.clip(jnp.floor(passed).astype(int) - (along // 2 - 1), 0, steps + 1 - along)
    place = passed - begin
    alike = passed.ndim == 1  # the same times in all lanes

    def pick(a, k):
        return a[begin + k] if alike else jnp.take_along_axis(a, (begin + k)[:, None], axis=0)

    def weigh(a):
        return a.reshape(-1, *[1] * (values.ndim - 1)) if alike else a[:, None]

    weights = []
    for k in range(along):
        others = [j for j in range(along) if j != k]
        square = np.prod([1.0 / (k - j) for j in others]) ** 2
        for j in others:
            square = square * (place - j) ** 2
        bend = 2.0 * sum(1.0 / (k - j) for j in others)
        weights.append((square * (1.0 - bend * (place - k)), square * (place - k) * step))
    # Without the barrier the weights of a sample are computed anew for every number that is read there.
    weights = jax.lax.optimization_barrier(weights)
    parts = [weigh(a) * pick(values, k) + weigh(b) * pick(slopes, k) for k, (a, b) in enumerate(weights)]
    return functools.reduce(jnp.add, parts)


def _lay_out(slopes: Callable[..., list[Array]]) -> Callable[[_Motion], Array]:
    """Values at the times of a motion, with rules for batches and for tangents; `slopes` of (numbers, others, t, y)."""
    def follow(motion: _Motion, axes: _Motion | None = None) -> Array:
        wide = slopes if axes is None else jax.vmap(slopes, (axes.numbers, axes.others, axes.mesh, -1), -1)
        nodes = _march(lambda t, y: jnp.stack(wide(motion.numbers, motion.others, t, y)), motion.start, motion.mesh)
        return _interpolate(*nodes, motion.mesh, motion.time)

    def change(motion: _Motion, tangent: _Motion, axes: _Motion, others: _Motion) -> tuple[Array, Array]:
        """Values, and their changes by a tangent or by many side by side."""
        def one(numbers, fixed, t, y, dot, way):
            return jax.jvp(lambda n, y: slopes(n, fixed, t, y), (numbers, y), (dot, way))

        wide = jax.vmap(one, (axes.numbers, axes.others, axes.mesh, axes.start, others.numbers, -1), (axes.start, -1))

        def pair(t, both):
            return tuple(map(jnp.stack, wide(motion.numbers, motion.others, t, both[0], tangent.numbers, both[1])))

        (values, changes), (rates, bends) = _march(pair, (motion.start, tangent.start), motion.mesh)
        found, rate = jax.jvp(lambda t: _interpolate(values, rates, motion.mesh, t), (motion.time,),
                              (jnp.ones_like(motion.time),))
        late = tangent.time[:, None] if others.time else tangent.time[:, None, None]
        return found, (_interpolate(changes, bends, motion.mesh, motion.time)
                       + (rate if axes.start else rate[..., None]) * late)

    @custom_vmap
    def value(motion):
        return follow(motion)

    @value.def_vmap
    def _(size, batched, motion):
        motion, laned = _widen(motion, batched[0], size)
        return _run_lanes(lambda axes, x: (None, follow(x[0], axes[0])), size, (laned,), (motion,))[1], True

    @custom_vmap
    def push(motion, tangent):
        def at(numbers, start, time):
            return follow(motion._replace(numbers=numbers, start=start, time=time))

        return jax.jvp(at, (motion.numbers, motion.start, motion.time), (tangent.numbers, tangent.start, tangent.time))

    @push.def_vmap
    def _(size, batched, motion, tangent):
        ours, theirs = batched
        together = any(jax.tree.leaves(ours))  # as many motions as tangents; else many tangents of one motion
        if together:
            motion, ours = _widen(motion, ours, size)
        tangent, theirs = _widen(tangent, theirs, size)

        def some(axes, x):
            found = change(x[0], x[1], *axes)
            return (None, found) if together else found

        found = _run_lanes(some, size, (ours, theirs), (motion, tangent))
        return found[1] if together else found, (together, True)

    whole = jax.custom_jvp(lambda motion: value(motion))

    @whole.defjvp
    def _(primals, tangents):
        # Those of whole numbers and of the mesh are none; arrays of no length stand in for them.
        none = jnp.zeros(0)
        return push(primals[0], tangents[0]._replace(others=[none] * len(primals[0].others), mesh=none))

    return whole


def _widen(motion: _Motion, batched: _Motion, size: int) -> tuple[_Motion, _Motion]:
    """A motion whose start has an axis of lanes in front, and what has one."""
    start = motion.start if batched.start else jnp.broadcast_to(motion.start, (size, *motion.start.shape))
    return motion._replace(start=start), batched._replace(start=True)


def _run_lanes(function: Callable[..., tuple[Any, Any]], size: int, batched: tuple[_Motion, ...],
               given: tuple[_Motion, ...]) -> tuple[Any, Any]:
    """What a function returns of arrays whose lanes come first, in blocks whose lanes come last.

    The function takes the axes of the lanes (-1, or None where there are none) and the arrays, and returns what has no
    lanes and what has.
    """
    leaves, tree = jax.tree.flatten(given)
    flags = jax.tree.leaves(batched)
    axes = jax.tree.unflatten(tree, [-1 if flag else None for flag in flags])
    laned = [leaf for leaf, flag in zip(leaves, flags, strict=True) if flag]

    def some(laned):
        parts = iter(laned)
        last = [jnp.moveaxis(next(parts), 0, -1) if flag else leaf for leaf, flag in zip(leaves, flags, strict=True)]
        plain, wide = function(axes, jax.tree.unflatten(tree, last))
        return plain, jax.tree.map(lambda a: jnp.moveaxis(a, -1, 0), wide)

    room = _count_lanes(size, batched, given)
    if size <= room:
        return some(laned)
    blocks = -(-size // room)
    filled = [jnp.concatenate([a, jnp.repeat(a[-1:], blocks * room - size, axis=0)]).reshape(blocks, room, *a.shape[1:])
              for a in laned]
    plain, wide = jax.lax.map(some, filled)
    return (jax.tree.map(lambda a: a[0], plain), jax.tree.map(lambda a: a.reshape(-1, *a.shape[2:])[:size], wide))


def _count_lanes(size: int, batched: tuple[_Motion, ...], given: tuple[_Motion, ...]) -> int:
    """Lanes of a block of the loop over steps: `size` are shared evenly among as few blocks as have room for them.

    All at once where no processor runs them: a GPU is slow with few lanes.
    """
    if find_platform() != "cpu":
        return size
    taken = [0, 0]  # bytes that stand once, and those of each lane
    for flags, arrays in zip(batched, given, strict=True):
        for part in ("numbers", "others", "start"):
            copies = _STAGES + 2 + 2 * GROUP if part == "start" else 1  # stages, the state, what a group keeps
            pairs = zip(jax.tree.leaves(getattr(flags, part)), jax.tree.leaves(getattr(arrays, part)), strict=True)
            for flag, array in pairs:
                taken[flag] += copies * array.nbytes // (size if flag else 1)
    room = max(ROOM - taken[0], 0) // max(taken[1], 1)
    if size <= room:
        return size
    blocks = -(-size // (max(room // WIDTH, 1) * WIDTH))
    return -(-size // (WIDTH * blocks)) * WIDTH
