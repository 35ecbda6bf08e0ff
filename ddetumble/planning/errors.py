"""Errors of the arm and of what is known of the body: from the planned impact to the one that happens.

The arm follows its plan in inertial space; the body is not quite where, and does not quite turn as, was thought. What
the ball then meets is the nearest place of the true body's surface.
"""

from collections.abc import Mapping

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array

from .._numerics import safe_sqrt
from .._rotation import from_rotation_vector, multiply, rotate, rotate_back
from ..dynamics.surfaces import OffsetSurface
from .problem import Design, StrikeProblem, drift


NAMES = {
    "instant": "the instant", "place": "the place", "direction": "the direction", "speed": "the arm's speed",
    "rates": "the angular velocity", "attitude": "the attitude", "inertia": "the moments of inertia",
    "centre": "the centre of mass",
}  # fmt: skip


def err(problem: StrikeProblem, design: Design, error: Mapping[str, Array]) -> tuple[StrikeProblem, Design, Array]:
    """True problem, the impact that happens in place of the design, and the distance of first touch from an edge [m].

    `error` holds three numbers by name, of which some need fewer: of `err_problem`, and `instant` [s], `place` and
    `direction` (inertial; [m], [rad]), `speed` as a fraction.
    """
    true, instant = err_problem(problem, error), design.instant + error["instant"][0]
    attitude, rates = drift(true, instant)
    arrival = rotate_back(attitude, rotate(design.attitude, design.point) + error["place"])
    foot = true.debris.surface.find_foot(arrival)
    turn = jnp.cross(error["direction"], design.velocity) / safe_sqrt(jnp.sum(design.velocity**2))
    velocity = (1.0 + error["speed"][0]) * rotate(from_rotation_vector(turn), design.velocity)
    met = Design(design.face, arrival - foot.distance * foot.normal, velocity, design.pressure, instant, attitude,
                 rates, rotate(attitude, foot.normal))
    return true, met, foot.margin


def err_problem(problem: StrikeProblem, error: Mapping[str, Array]) -> StrikeProblem:
    """The problem with another state at time 0 and another body, of errors by name, shapes (3,).

    `rates`: change of the angular velocity over its size. `attitude`: rotation vector, body components [rad].
    `inertia`: change of each principal moment as a fraction; of a body of revolution of its own two. `centre`: shift of
    the centre of mass, body components [m]; none where there is no such name.
    """
    debris, part = problem.debris, error["inertia"]
    if problem.symmetric:
        tensor = debris.inertia * jnp.diag(1.0 + part[jnp.array([0, 0, 2])])
    else:
        moments, axes = jnp.linalg.eigh(debris.inertia)
        tensor = (axes * (moments * (1.0 + part))) @ axes.T
    debris = eqx.tree_at(lambda d: d.inertia, debris, tensor)
    if "centre" in error:
        debris = eqx.tree_at(lambda d: d.surface, debris, OffsetSurface(debris.surface, error["centre"]))
    size = jnp.linalg.norm(problem.angular_velocity)
    rates = problem.angular_velocity + size * error["rates"]
    attitude = multiply(problem.attitude, from_rotation_vector(error["attitude"]))
    return eqx.tree_at(lambda p: (p.debris, p.angular_velocity, p.attitude), problem, (debris, rates, attitude))
