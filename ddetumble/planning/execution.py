"""What errors of the arm, and of the estimate of the motion, make of a planned impact.

The arm follows its plan in inertial space; the body is not quite where, and does not quite turn as, was thought. What
the ball then meets is the nearest place of the true body's surface.
"""

import dataclasses as dc
from collections.abc import Mapping

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._numerics import safe_sqrt
from .._rotation import from_rotation_vector, multiply, rotate, rotate_back
from ..dynamics.surfaces import OffsetSurface
from .draws import split_batch
from .problem import Design, StrikeProblem, drift, measure_share, strike_debris
from .scenario import ErrorTable
from .single import StrikePlan


PASSED = 0.05  # of force or depression, by which an erring impact may pass the limit before that is called so
NAMES = {
    "instant": "the instant", "place": "the place", "direction": "the direction", "speed": "the arm's speed",
    "rates": "the angular velocity", "attitude": "the attitude", "inertia": "the moments of inertia",
    "centre": "the centre of mass",
}  # fmt: skip


@dc.dataclass(frozen=True)
class Spread:
    """The momentum left under draws of one error, or of all."""

    error: str  # its name; `all` of all together
    size: float  # its standard deviation, SI or as a fraction; nan of all
    mean: float  # share of the angular momentum left, 1 where the ball misses [-]
    q95: float  # that 95 % of the draws stay below
    missed: float  # share of the draws in which the ball meets no surface, or an edge of it
    violated: float  # share of the draws in which force, depression or another limit of the contact is passed
    drift: tuple[float, float]  # speed that the blow gives the body, mean and standard deviation [m/s]


def try_errors(problem: StrikeProblem, plan: StrikePlan, errors: ErrorTable, seed: int = 0) -> tuple[Spread, ...]:
    """Momentum left by a planned impact under errors drawn of each kind alone, in the order of `NAMES` and left out
    where its size is zero, and last of all together.
    """
    random = np.random.default_rng(seed)
    sizes = {name: size for name, size in errors.sizes().items() if size > 0.0}
    groups = [*((name,) for name in sizes), tuple(sizes)]
    drawn = {name: np.zeros((len(groups), errors.draws, 3)) for name in NAMES if name in sizes or name != "centre"}
    for k, group in enumerate(groups):
        for name in group:
            drawn[name][k] = sizes[name] * random.normal(size=(errors.draws, 3))
    met = _err_all(problem, plan.design, {name: jnp.asarray(own.reshape(-1, 3)) for name, own in drawn.items()})
    # One by one, as the program of one impact is there already and that of many would have to be compiled.
    rows = [_strike_wrongly(*one) for one in split_batch(met)]
    columns = (np.reshape(one, (len(groups), -1)) for one in zip(*rows, strict=True))
    return tuple(Spread(name, sizes.get(name, np.nan), float(share.mean()), float(np.quantile(share, 0.95)),
                        float(missed.mean()), float(violated.mean()), (float(drifted.mean()), float(drifted.std())))
                 for name, share, missed, violated, drifted in zip((*sizes, "all"), *columns, strict=True))


@eqx.filter_jit
def _err_all(problem: StrikeProblem, design: Design, errors: Mapping[str, Array]
             ) -> tuple[StrikeProblem, Design, Array]:
    """True problem, design, and distance of first touch from an edge [m], all with a first axis of draws; errors are
    three numbers a draw by name, of which some need fewer, SI or as a fraction, shapes (draws, 3).
    """
    def one(error: Mapping[str, Array]) -> tuple[StrikeProblem, Design, Array]:
        true = err_problem(problem, error)
        instant = design.instant + error["instant"][0]
        attitude, rates = drift(true, instant)
        arrival = rotate_back(attitude, rotate(design.attitude, design.point) + error["place"])
        foot = true.debris.surface.find_foot(arrival)
        turn = jnp.cross(error["direction"], design.velocity) / safe_sqrt(jnp.sum(design.velocity**2))
        velocity = (1.0 + error["speed"][0]) * rotate(from_rotation_vector(turn), design.velocity)
        met = Design(design.face, arrival - foot.distance * foot.normal, velocity, design.pressure, instant, attitude,
                     rates, rotate(attitude, foot.normal))
        return true, met, foot.margin

    return eqx.filter_vmap(one)(errors)


def _strike_wrongly(true: StrikeProblem, met: Design, margin: Array) -> tuple[float, bool, bool, float]:
    """Share left, whether the ball misses, whether a limit is passed, and the drift [m/s]."""
    approach = (np.asarray(met.velocity) - np.asarray(rotate(met.attitude, jnp.cross(met.angular_velocity, met.point)))
                ) @ -np.asarray(met.normal)
    if margin <= 0.0 or approach <= 0.0:
        return 1.0, True, False, 0.0
    after, limits = strike_debris(true, met), true.limits
    if bool(after.failed) or not bool(after.separated):
        return 1.0, True, False, 0.0
    violated = (float(after.peak_force) > (1.0 + PASSED) * float(limits.force) or float(after.margin) < 0.0
                or float(after.peak_depression) > (1.0 + PASSED) * float(limits.depression))
    return measure_share(true, after.angular_velocity), False, violated, float(np.linalg.norm(after.velocity))


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
