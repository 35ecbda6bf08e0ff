"""Integration by even steps: order, what lies between the nodes, derivatives, batches in every layout, loops of one
kernel; and functions written out in scalars.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ddetumble.contact.torque import RigidBody
from ddetumble.dynamics.even_steps import integrate_evenly
from ddetumble.dynamics.scalars import write_out
from ddetumble.dynamics.spinning import START, spin
from ddetumble.effects import TUMBLE


def swing(given, t, y):
    """A damped and driven oscillator: stiffness, damping, drive."""
    stiffness, damping, drive = given["stiffness"], given["damping"], given["drive"]
    return jnp.stack([y[1], -stiffness * y[0] - damping * y[1] + drive * jnp.cos(t)])


GIVEN = {"stiffness": jnp.asarray(1.7), "damping": jnp.asarray(0.1), "drive": jnp.asarray(0.3)}
FIRST = jnp.array([0.4, -0.2])


def solve_exactly(t, stiffness=1.7, damping=0.1, drive=0.3, first=(0.4, -0.2)):
    """Place and speed of the oscillator in closed form, shape (times, 2)."""
    # Steady part of drive cos t, and what decays.
    c, s = np.linalg.solve([[stiffness - 1.0, damping], [-damping, stiffness - 1.0]], [drive, 0.0])
    w = np.sqrt(stiffness - damping**2 / 4.0)
    a = first[0] - c
    b = (first[1] - s + 0.5 * damping * a) / w
    fall, cosine, sine = np.exp(-0.5 * damping * t), np.cos(w * t), np.sin(w * t)
    place = fall * (a * cosine + b * sine) + c * np.cos(t) + s * np.sin(t)
    speed = fall * ((b * w - 0.5 * damping * a) * cosine - (a * w + 0.5 * damping * b) * sine)
    speed += s * np.cos(t) - c * np.sin(t)
    return np.stack([place, speed], axis=1)


@pytest.mark.parametrize("between", [False, True], ids=["at nodes", "between"])
def test_order(between):
    """The error falls by 2^8 as the step is halved, at the nodes and between them."""
    errors = []
    for steps in (48, 96):
        mesh = jnp.linspace(0.0, 24.0, steps + 1)
        time = np.linspace(0.31, 23.9, 200) if between else np.asarray(mesh)
        found = integrate_evenly(swing, GIVEN, FIRST, mesh, jnp.asarray(time))
        errors.append(np.abs(found - solve_exactly(time)).max())
    assert errors[0] < 1e-5
    assert 150.0 < errors[0] / errors[1] < 500.0


@pytest.mark.parametrize("steps", [1, 2, 3, 8, 13])
def test_few_steps(steps):
    """Meshes that are no whole number of groups, or shorter than an interpolating polynomial; the ends included."""
    mesh, time = jnp.linspace(0.0, 0.2, steps + 1), np.linspace(0.0, 0.2, 7)
    assert np.abs(integrate_evenly(swing, GIVEN, FIRST, mesh, jnp.asarray(time)) - solve_exactly(time)).max() < 1e-5


def test_derivatives():
    """Forward derivatives by everything against difference quotients of the closed form, and reverse mode."""
    time = np.linspace(0.3, 11.0, 9)
    mesh = jnp.linspace(0.0, 12.0, 49)

    def solve(x, reverse=False):
        given = dict(zip(GIVEN, x[:3], strict=True))
        return integrate_evenly(swing, given, x[3:5], mesh, jnp.asarray(time) + x[5], reverse)

    def exact(x):
        return solve_exactly(time + x[5], *x[:3], x[3:5])

    x = np.array([1.7, 0.1, 0.3, 0.4, -0.2, 0.0])
    found = jax.jit(jax.jacfwd(solve))(jnp.asarray(x))
    for k, way in enumerate(1e-5 * np.eye(6)):
        assert np.abs(found[..., k] - (exact(x + way) - exact(x - way)) / 2e-5).max() < 1e-7
    weights = np.random.default_rng(1).standard_normal(found.shape[:2])
    reverse = jax.grad(lambda x: jnp.sum(weights * solve(x, reverse=True)))(jnp.asarray(x))
    np.testing.assert_allclose(reverse, np.einsum("ts,tsk->k", weights, found), rtol=1e-9)
    second = jax.jit(jax.jacfwd(jax.jacfwd(solve)))(jnp.asarray(x))
    assert np.abs(second - np.swapaxes(second, -1, -2)).max() < 1e-9 * np.abs(second).max()


@pytest.mark.parametrize(("laned", "size"), [("start", 3), ("given", 3), ("mesh", 3), ("time", 3), ("all", 150)])
def test_batches(laned, size):
    """A batch by anything is what one after the other gives, with derivatives in either order of the transforms."""
    rng = np.random.default_rng(size)
    base = (jnp.array([1.7, 0.1, 0.3]), FIRST, jnp.linspace(0.0, 8.0, 27), jnp.linspace(0.1, 6.1, 5))
    names = ("given", "start", "mesh", "time")
    axes = [0 if laned in (name, "all") else None for name in names]
    many = [part * (1.0 + 0.2 * rng.random((size, *[1] * part.ndim))) if axis == 0 else part
            for part, axis in zip(base, axes, strict=True)]

    def solve(given, *rest):
        return integrate_evenly(swing, dict(zip(GIVEN, given, strict=True)), *rest)

    def slope(*x):
        return jax.jacfwd(solve, argnums=(0, 1, 3))(*x)

    def each(x, k):
        return [part[k] if axis == 0 else part for part, axis in zip(x, axes, strict=True)]

    found, slopes = jax.jit(jax.vmap(solve, axes))(*many), jax.jit(jax.vmap(slope, axes))(*many)
    ways = [jnp.asarray(rng.standard_normal(part.shape)) for part in many]
    ways[2] = jnp.zeros_like(ways[2])
    _, pushed = jax.jit(lambda x, ways: jax.jvp(jax.vmap(solve, axes), x, ways))(tuple(many), tuple(ways))
    alone, alone_slope = jax.jit(solve), jax.jit(slope)
    for k in (0, 1, size - 1):
        np.testing.assert_allclose(found[k], alone(*each(many, k)), rtol=1e-12, atol=1e-13)
        expected = alone_slope(*each(many, k))
        for a, b in zip(slopes, expected, strict=True):
            np.testing.assert_allclose(a[k], b, rtol=1e-11, atol=1e-12)
        own = each(ways, k)
        moved = sum(np.tensordot(b, own[i], 1) for i, b in zip((0, 1, 3), expected, strict=True))
        np.testing.assert_allclose(pushed[k], moved, rtol=1e-10, atol=1e-11)


def test_body_of_the_whole_catalogue():
    """Rates and attitude under all effects at once, and their derivatives, as by loops of JAX's own layout."""
    law = RigidBody(jnp.asarray(0.46), jnp.asarray(1e-3)).extend(tuple(effect() for effect in TUMBLE))
    law = jax.tree.map(lambda x: jnp.asarray(x, dtype=float) + 1e-3, law)
    conditions = dict(zip(START, jnp.array([0.05, 0.04, 0.11]), strict=True))
    mesh, time = jnp.linspace(0.0, 60.0, 33), jnp.linspace(0.0, 60.0, 7)
    leaves, tree = jax.tree.flatten(law)

    def read(x, reverse):
        found = spin(jax.tree.unflatten(tree, list(x)), conditions, time, mesh, reverse)
        return jnp.concatenate([found.angular_velocity, found.attitude], axis=1)

    x = jnp.stack(leaves)
    ours, plain = (jax.jit(jax.jacfwd(lambda x, r=reverse: (read(x, r),) * 2, has_aux=True))(x)
                   for reverse in (False, True))
    for a, b in zip(ours, plain, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-11)


@pytest.mark.parametrize("batched", [False, True], ids=["derivatives of one", "a batch"])
def test_one_kernel_a_loop(batched):
    """XLA makes one kernel of each loop in time, and of all but the outermost of a batch."""
    def solve(x):
        law = RigidBody(x[3]).extend(tuple(effect() for effect in TUMBLE))
        mesh = jnp.linspace(0.0, 60.0, 65)
        return spin(law, dict(zip(START, x[:3], strict=True)), mesh[::2], mesh).angular_velocity

    x = jnp.array([0.05, 0.04, 0.11, 0.55])
    run, given = (jax.vmap(solve), jnp.tile(x, (200, 1))) if batched else (jax.jacfwd(solve), x)
    text = jax.jit(run).lower(given).compile().as_text()
    assert text.count("xla_cpu_small_call") >= 3


def mix(a, b, c):
    """Vectors, matrices and shapes of many kinds."""
    turned = jnp.cross(a, b) + jnp.stack([a[1], b[0] ** 2, -c]) * jnp.where(a > b, a, jnp.sqrt(jnp.abs(b)))
    square = jnp.outer(a, b)[::-1].T @ turned
    joined = jnp.concatenate([square[:2], turned[1:], jnp.sum(jnp.exp(-(a**2)), keepdims=True)])
    return jnp.clip(joined, -2.0, jnp.maximum(c, 1.0)) + jnp.arctan2(joined, 1.0 + c**2)


def reach_out(a, b, c):
    """Operations that are not written out: sums on the way, sorting, branches, places that are computed."""
    found = jnp.cumsum(a) + jnp.sort(b) + jax.lax.cond(c > 0, lambda v: v * 2.0, lambda v: v - 1.0, a)
    return found + a[jnp.argmax(b)] + jnp.interp(c, jnp.arange(200.0), jnp.arange(200.0) ** 2) + jnp.linalg.norm(b)


@pytest.mark.parametrize("function", [mix, reach_out])
@pytest.mark.parametrize("seed", range(4))
def test_written_out(function, seed):
    """A function written out in scalars has the same values and derivatives, whatever it calls."""
    rng = np.random.default_rng(seed)
    given = tuple(jnp.asarray(rng.standard_normal(shape)) for shape in (3, 3, ()))

    def write(*x):
        return jnp.stack(write_out(function)(*x))

    np.testing.assert_allclose(write(*given), function(*given), rtol=1e-13, atol=1e-14)
    ways = tuple(jnp.ones_like(part) for part in given)
    np.testing.assert_allclose(jax.jvp(write, given, ways)[1], jax.jvp(function, given, ways)[1], rtol=1e-12)
    batch = tuple(jnp.stack([part, 2.0 * part]) for part in given)
    np.testing.assert_allclose(jax.jit(jax.vmap(write))(*batch), jax.vmap(function)(*batch), rtol=1e-12)


def test_numbers_of_other_kinds():
    """What a field reads may be whole numbers, texts and functions beside numbers with derivatives."""
    class Way(eqx.Module):
        power: jax.Array
        name: str
        act: object

    way = Way(jnp.asarray(2), "square", jnp.sin)

    def field(given, t, y):
        rate, way = given
        return -rate * y**way.power + (way.act(t) if way.name == "square" else 0.0)

    mesh = jnp.linspace(0.0, 1.0, 9)

    def solve(rate):
        return integrate_evenly(field, (rate, way), jnp.ones(1), mesh, mesh[-1:])

    found, slope = jax.jvp(solve, (jnp.asarray(0.5),), (jnp.asarray(1.0),))
    near = [solve(jnp.asarray(0.5 + h)) for h in (1e-5, -1e-5)]
    np.testing.assert_allclose(slope, (near[0] - near[1]) / 2e-5, rtol=1e-8)
    assert np.isfinite(found).all()
