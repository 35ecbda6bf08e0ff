"""What must not happen in an impact, each a number that is at least zero where the plan is allowed.

`evaluate` gives all numbers of a design at once: what is wanted small, and its constraints.
"""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._rotation import from_rotation_vector, multiply, rotate, rotate_back
from ..contact.gripping import find_height
from ..dynamics.collision import Collision
from ..inference.programs import keep_program
from .errors import err
from .problem import Design, StrikeProblem, read_design, score, strike_debris


# Fraction of the least approach speed, below which a ball strikes nothing: positive, so that closed forms stay finite.
MISSED = 1e-3
# Fractions of the clearance time at which the ball's path is looked at: a path is nearly straight in so short a time.
PATH = np.linspace(0.1, 1.0, 6)
# Of the peak depression, by which a ball may go in again before it has left: a surface that turns under a ball which
# slides fast meets it again, and whether it has left by then is a matter of tenths of a millimetre. More than rounding
# of the course, far less than such a second blow, of which the contact was never measured.
AGAIN = 0.1


class Constraints(NamedTuple):
    """All that has to hold, each scaled and at least zero where the plan is allowed: numbers, or an array of each."""

    speed: Any  # of the arm, squared
    approach: Any  # of the impact
    force: Any
    depression: Any
    edge: Any  # distance of the contact disc from the nearest edge, over 0.1 m
    # The next edge holds nothing that the nearest does not: in a corner, where the lever arm is largest and the nearest
    # edge changes, it tells a search of the other one, so that both hold it there.
    next_edge: Any
    side: Any  # the chaser's
    clear: Any  # distance of the ball from the body before and after the impact, over 0.01 m
    fastest: Any  # largest speed along the normal
    slide: Any  # and across it, squared
    target: Any  # distance from the middle of the area that may be struck, squared
    blow: Any  # part of the peak depression by which the ball goes in again on its way out


CONSTRAINTS = Constraints("arm's speed", "approach", "peak force", "depression", "edge", "next edge", "reachable side",
                          "nothing else hit", "fastest approach", "tangential speed", "target area", "one blow")


class Parting(eqx.Module):
    """Body and ball at separation, and peaks of the contact; names as of `Collision`."""

    attitude: Array
    angular_velocity: Array
    displacement: Array
    velocity: Array
    arm_velocity: Array
    last_point: Array
    margins: Array
    approach_speed: Array
    peak_force: Array
    peak_depression: Array
    second_depression: Array


def keep_clear(problem: StrikeProblem, design: Design, after: Parting | Collision, radius: Array) -> Array:
    """Least distance between ball and body before and after the contact, less what it is at first touch [m].

    The ball keeps its velocity on either side, the body its rates; over less than a second that is enough.
    """
    surface, limits = problem.debris.surface, problem.limits
    start = radius * design.normal + rotate(design.attitude, design.point)

    def distance(time, attitude, rates, place, velocity, centre, drifting):
        turned = multiply(attitude, from_rotation_vector(time * rates))
        return surface.find_foot(rotate_back(turned, place + time * velocity - centre - time * drifting)).distance

    times = limits.clearance * PATH
    earlier = jax.vmap(lambda t: distance(-t, design.attitude, design.angular_velocity, start, design.velocity,
                                          jnp.zeros(3), jnp.zeros(3)))(times)
    # At separation the ball touches where it has slid to.
    last = after.last_point + radius * surface.find_foot(after.last_point).normal
    away = after.displacement + rotate(after.attitude, last)
    later = jax.vmap(lambda t: distance(t, after.attitude, after.angular_velocity, away, after.arm_velocity,
                                        after.displacement, after.velocity))(times)
    return jnp.minimum(jnp.min(earlier), jnp.min(later)) - radius


def judge(problem: StrikeProblem, design: Design, after: Parting | Collision) -> Constraints:
    """The constraints of an impact, integrated or estimated."""
    limits = problem.limits
    nearest = jnp.argmin(after.margins)
    others = jnp.where(jnp.arange(after.margins.size) == nearest, jnp.inf, after.margins)
    # No more than from a metre off: where there is no other edge, there is nothing to be told.
    edges = jnp.minimum(jnp.stack([after.margins[nearest], jnp.min(others)]) - limits.edge, 1.0) / 0.1
    radius = find_height(problem.law.reference.ball.diameter(), jnp.zeros(()))
    met = design.velocity - rotate(design.attitude, jnp.cross(design.angular_velocity, design.point))
    across = jnp.sum(met**2) - jnp.dot(met, design.normal) ** 2
    return Constraints(
        1.0 - jnp.sum(design.velocity**2) / limits.speed**2, after.approach_speed / limits.approach - 1.0,
        1.0 - after.peak_force / limits.force, 1.0 - after.peak_depression / limits.depression, edges[0], edges[1],
        jnp.dot(design.normal, limits.chaser) - jnp.cos(limits.cone), keep_clear(problem, design, after, radius) / 0.01,
        1.0 - after.approach_speed / limits.fastest, 1.0 - across / limits.slide**2,
        1.0 - jnp.sum((design.point - limits.target) ** 2) / limits.radius**2,
        AGAIN - after.second_depression / jnp.maximum(after.peak_depression, 1e-12))


def evaluate_slopes(problem: StrikeProblem, face: Array, x: Array, error: Mapping[str, Array] | None = None
                    ) -> tuple[Array, Array]:
    """As `evaluate`, with derivatives by the seven variables, shapes (1 + constraints,), (1 + constraints, 7)."""
    return _evaluate_slopes(problem, face, x, error)


@keep_program((0.0, 0.0))
def _evaluate_slopes(problem, face, x, error) -> tuple[Array, Array]:
    return with_slopes(lambda x: _evaluate(problem, face, x, dfx.ForwardMode(), error), x)


def with_slopes(function: Callable[[Array], Array], x: Array) -> tuple[Array, Array]:
    """A function's value and its derivatives in forward mode, in one sweep."""
    slopes, value = jax.jacfwd(lambda x: (function(x),) * 2, has_aux=True)(x)
    return value, slopes


def evaluate(problem: StrikeProblem, face: Array, x: Array, adjoint: dfx.AbstractAdjoint | None = None,
             error: Mapping[str, Array] | None = None) -> Array:
    """What is wanted small and all constraints of one design, shape (1 + constraints,); with an `error` (see
    `ddetumble.planning.errors.err`), of the impact that happens in its place.
    """
    return _evaluate(problem, face, x, adjoint, error)


@keep_program(0.0)
def _evaluate(problem, face, x, adjoint, error) -> Array:
    design = read_design(problem, face, x)
    if error is not None:
        problem, design, _ = err(problem, design, error)
    collision = strike_debris(problem, design, adjoint)
    kept = judge(problem, design, collision)
    values = jnp.stack([score(problem, collision.angular_velocity), *kept])
    # A ball that does not approach strikes nothing: only its approach is told.
    missed = collision.approach_speed <= MISSED * problem.limits.approach
    nothing = Constraints(*jnp.zeros(len(kept)))._replace(approach=kept.approach)
    blank = jnp.stack([score(problem, problem.angular_velocity), *nothing])
    bad = (collision.failed | ~collision.separated) & ~missed
    return jnp.where(missed, blank, jnp.where(bad, jnp.nan, values))
