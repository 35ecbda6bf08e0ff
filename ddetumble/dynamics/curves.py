"""The laws as plain functions: normal force over depression and its rate, friction coefficient over slip."""

from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._errors import InputError
from .._numerics import is_known
from ..contact.law import ContactLaw
from ..contact.sliding import FrictionLaw, Slide
from .entry import read_conditions, read_law


def normal_force(law: Any, depression: Any, depression_rate: Any = 0.0, *, approach_speed: Any = 1.0, time: Any = 0.0,
                 **conditions: Any) -> Array:
    r"""Normal force of a contact law, $F_n(\delta, w) = [F_k(\delta) (1 + c_n w) + \ldots]_+$ [N] (Eqs. 3 to 7).

    Differentiable in both modes, and batched by broadcasting.

    Args:
        law: a reference model such as `Ball()`, with effects or without, or a contact law.
        depression, depression_rate: $\delta$ [m], and $w$ [m/s], positive while loading; these and all others have
            any shapes that broadcast.
        approach_speed: $v_1$ [m/s], on which the damping $c_n$ depends; where nothing moves it does not matter.
        time: since first touch [s].
        **conditions: whatever else the law reads, SI: `initial_pressure` [Pa, absolute] of a ball.

    Returns:
        The force, in the shape of all together.

    Raises:
        InputError: The law is none of impacts, a condition is missing, or an effect has a memory, so that the force is
            no function of depression and rate: `simulate_impact` follows it.
    """
    found, gas = read_law(law, ContactLaw, "a ContactLaw(ball, effects), or a reference model such as Ball()",
                          "normal_force")
    if found.stateful():
        raise InputError(f"normal_force: {found.stateful()[0].id} has a state of its own, so that the force depends on "
                         "what was before; simulate_impact follows it")
    read = read_conditions({"approach_speed": approach_speed, **conditions}, ("approach_speed", *gas), "normal_force",
                           batched=True)

    def at(given, depth, rate, instant):
        diameter, damping = found.start(given)
        contact = found.contact(given, diameter, instant, depth, rate, jnp.zeros(0))
        return found.forces(contact, damping, jnp.zeros(0)).normal

    return _broadcast(at, read, depression, depression_rate, time)


def friction_coefficient(law: Any, slip: Any, *, normal_load: Any, slip_speed: Any = 0.0, work: Any = 0.0,
                         **conditions: Any) -> Array:
    r"""Friction coefficient of a friction law, $\mu(s) = f(s)/F_n$ [-] (Eqs. 8 to 11).

    Differentiable in both modes, and batched by broadcasting.

    Args:
        law: a reference model such as `RubberFriction()`, with effects or without, or a friction law.
        slip: distance slid since the stroke began [m]; this and all others have any shapes that broadcast.
        normal_load: $F_n$ [N], positive.
        slip_speed: [m/s].
        work: of friction since the record began [J]; 0 where nothing is warm.
        **conditions: whatever else the law reads, SI: `internal_pressure` [Pa, absolute] of Eq. 8.

    Returns:
        The coefficient, in the shape of all together.

    Raises:
        InputError: The law is none of friction, or a condition is no use.
    """
    found, _ = read_law(law, FrictionLaw, "a FrictionLaw(friction, effects), or a reference model such as "
                        "RubberFriction()", "friction_coefficient")
    read = read_conditions({"normal_load": normal_load, "slip_speed": slip_speed, **conditions}, ("normal_load",),
                           "friction_coefficient", batched=True)
    if is_known(read["normal_load"]) and not np.all(read["normal_load"] > 0):
        raise InputError("friction_coefficient: normal_load must be positive: without a load there is no ratio to it")
    zero = jnp.zeros(())

    def at(given, distance, done):
        load, speed = given["normal_load"], given["slip_speed"]
        instant = jnp.where(speed > 0, distance / jnp.where(speed > 0, speed, 1.0), 0.0)
        slide = Slide(distance, speed, load, given.get("internal_pressure", zero), done, instant, zero + 1.0, given)
        return found.force(slide) / load

    return _broadcast(at, read, slip, work)


def _broadcast(function: Any, conditions: Mapping[str, Array], *values: Any) -> Array:
    """A function of conditions and scalars at arrays of these that broadcast."""
    leaves, tree = jax.tree.flatten((dict(conditions), [jnp.asarray(value, dtype=float) for value in values]))
    whole = jnp.broadcast_arrays(*leaves)
    given, arrays = jax.tree.unflatten(tree, [array.ravel() for array in whole])
    return jax.vmap(function)(given, *arrays).reshape(whole[0].shape)
