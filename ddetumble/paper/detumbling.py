r"""Tables 5 and 6: which force, lever arm and attitude take 63.2 % and 27.5 % of the momentum, and what is left open.

The paper prints momenta, the time of impact (0.4 s) and the stage's sizes; no force, no lever arm, no attitude. Its
simulation applies the force as a step (Section 4 says so of the test's loading). A step of normal force $F$ at a lever
arm $\ell$ takes $F \ell t$ of momentum along one transverse axis of the stage.
"""

import dataclasses as dc
from typing import final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._numerics import scalar
from .._rotation import from_matrix
from ..contact.gripping import Striker
from ..contact.law import Ball
from ..contact.sliding import CoulombFriction
from ..dynamics.bodies import Cylinder
from ..dynamics.collision import simulate_collision
from ..dynamics.free_motion import propagate_torque_free
from ..dynamics.rigid import measure_momentum
from ..dynamics.surfaces import make_debris
from ..dynamics.tumbling import simulate_tumbling
from .free_tumbling import STEP, UNTURNED, Momentum


IMPACT_TIME = 0.4  # s, section 5
SPEED, FASTEST = 0.4, 2.0  # m/s: of the tests, and what Table 1 gives the arm
LEVERS = {"side wall, at the rim": 1.5, "end face, at the rim": 1.0}  # m, of a normal force on the stage
MASSES = (1.2, 4.0, 10.0, 20.0)  # kg
TOUCH = 1.4  # m, height of the toolkit's own impacts on the side wall


@dc.dataclass(frozen=True)
class Demand:
    """What one of the tables asks of an impact.

    Attributes:
        taken: size of the momentum that it takes [N m s].
        share: of the momentum before [-].
        turn: of the momentum's direction [rad].
        moment: mean, over 0.4 s [N m].
        forces: mean normal force by place [N].
        rubbed: the same where friction of the coefficient below helps along the same moment [N].
        arms: lever arm that each printed force would need, shape (forces,) [m].
        tilt: largest angle by which the momentum can have been off the plane across the axis [rad].
        least: smallest nutation angle from which a normal force can leave as little [rad].
    """

    taken: float
    share: float
    turn: float
    moment: float
    forces: dict[str, float]
    rubbed: dict[str, float]
    arms: np.ndarray
    tilt: float
    least: float


def find_demand(table: Momentum, printed: np.ndarray, friction: float) -> Demand:
    """What a table asks of an impact.

    Args:
        table: momentum before and after.
        printed: normal forces that the paper prints, shape (forces,) [N].
        friction: coefficient that friction has where it helps [-].
    """
    before, after = (float(np.linalg.norm(x)) for x in (table.before, table.after))
    taken = float(np.linalg.norm(table.before - table.after))
    moment = taken / IMPACT_TIME
    radius, half = float(Cylinder().radius), 0.5 * float(Cylinder().length)
    others = {"side wall, at the rim": radius, "end face, at the rim": half}  # lever arm of friction, the other way
    forces = {place: moment / arm for place, arm in LEVERS.items()}
    rubbed = {place: moment / (arm + friction * others[place]) for place, arm in LEVERS.items()}
    # The part a along the axis stays: the direction turns by asin(a/after) - asin(a/before).
    a = np.linspace(0.0, after, 200_001)
    turns = np.arcsin(a / after) - np.arcsin(a / before)
    tilt = float(np.arcsin(np.interp(table.turn, turns, a) / before))
    return Demand(taken, 1.0 - after / before, table.turn, moment, forces, rubbed, moment / np.asarray(printed), tilt,
                  float(np.arccos(min(after / before, 1.0))))


@final
class _Step(eqx.Module):
    """A moment fixed in the stage, shape (3,) [N m]."""

    moment: Array

    def __call__(self, time: Array, attitude: Array, rates: Array) -> Array:
        return self.moment


@dc.dataclass(frozen=True)
class Passage:
    """Motion of the stage through one impact, a step of moment along the momentum from t = 0 on.

    Attributes:
        time: shape (times,) [s].
        attitude: shape (times, 4) [-].
        rates: body components, shape (times, 3) [rad/s].
        momentum: base frame, at the end, shape (3,) [N m s].
    """

    time: np.ndarray
    attitude: np.ndarray
    rates: np.ndarray
    momentum: np.ndarray


def place_stage(momentum: np.ndarray) -> np.ndarray:
    """An attitude whose body x lies along the momentum, and body z, the axis, across it and across Z."""
    x = momentum / np.linalg.norm(momentum)
    z = np.cross(x, [0.0, 0.0, 1.0])
    z = z / np.linalg.norm(z)
    return np.asarray(from_matrix(jnp.asarray(np.stack([x, np.cross(z, x), z], axis=-1))))


def follow_impact(table: Momentum, before: float, after: float) -> Passage:
    """Free motion, the step of moment at a place of the stage, free motion again.

    Args:
        table: momentum before and after.
        before, after: how long is shown on either side [s].
    """
    inertia = Cylinder().inertia()
    attitude = place_stage(table.before)
    size, left = (float(np.linalg.norm(x)) for x in (table.before, table.after))
    spin = jnp.array([size / float(inertia[0, 0]), 0.0, 0.0])
    earlier = propagate_torque_free(inertia, attitude, spin, np.arange(-before, 0.0, STEP))
    moment = jnp.array([-(size - left) / IMPACT_TIME, 0.0, 0.0])
    during = simulate_tumbling(inertia, attitude, spin, np.linspace(0.0, IMPACT_TIME, 9), _Step(moment))
    start = during.attitude[-1], during.angular_velocity[-1]
    later = propagate_torque_free(inertia, *start, np.arange(STEP, after, STEP))
    parts = (earlier, during, later)
    time = np.concatenate([earlier.time, during.time, np.asarray(later.time) + IMPACT_TIME])
    attitudes = np.concatenate([np.asarray(part.attitude) for part in parts])
    rates = np.concatenate([np.asarray(part.angular_velocity) for part in parts])
    return Passage(time, attitudes, rates, np.asarray(measure_momentum(inertia, *start)))


def sample_steps(step: float = STEP) -> float:
    """Impulse of a half sine over 0.4 s, summed at the paper's steps, over what it has [-]."""
    times = np.arange(0.0, IMPACT_TIME - 1e-9, step)
    return float(np.sum(np.sin(np.pi * times / IMPACT_TIME)) * step / (2.0 * IMPACT_TIME / np.pi))


def strike_stage(momentum: np.ndarray, pressure: float = 2.5e6) -> list[dict[str, float]]:
    """The toolkit's own impacts on the flat-spinning stage: one row for each apparent mass of the arm and speed.

    Returns:
        `mass` [kg], `speed` of the arm [m/s], `share` of the momentum taken [-], `peak_force` [N], `depression` [m],
        `time` of contact [s].
    """
    debris = make_debris(Cylinder())
    size = float(np.linalg.norm(momentum))
    rates = jnp.array([size / float(debris.inertia[0, 0]), 0.0, 0.0])
    point = jnp.array([0.0, 1.0, -TOUCH])  # moves along +y while omega is along x: the ball comes against it

    @jax.jit
    @jax.vmap
    def run(mass, speed):
        law = Striker(Ball(effective_mass=mass), CoulombFriction(scalar(0.0)), tangential_mass=mass,
                      rolling_mass=scalar(1e9))
        found = simulate_collision(law, debris, UNTURNED, rates, point, jnp.stack([0.0 * speed, -speed, 0.0 * speed]),
                        {"initial_pressure": pressure}, max_steps=512)
        return jnp.stack([1.0 - jnp.linalg.norm(found.angular_momentum) / size, found.peak_force,
                          found.peak_depression, found.separation])

    pairs = np.array([(mass, speed) for speed in (SPEED, FASTEST) for mass in MASSES])
    values = np.asarray(run(*jnp.asarray(pairs.T)))
    names = ("mass", "speed", "share", "peak_force", "depression", "time")
    return [dict(zip(names, map(float, (*pair, *row)), strict=True)) for pair, row in zip(pairs, values, strict=True)]


def find_mass(rows: list[dict[str, float]], share: float) -> tuple[float, float]:
    """Apparent mass [kg] that takes a share of the momentum at the arm's full speed, and its peak force [N].

    Between the rows of `strike_stage` by straight lines.
    """
    fast = [row for row in rows if row["speed"] == FASTEST]
    shares, masses, peaks = ([row[name] for row in fast] for name in ("share", "mass", "peak_force"))
    return float(np.interp(share, shares, masses)), float(np.interp(share, shares, peaks))


def list_forces(*columns: np.ndarray) -> np.ndarray:
    """All normal forces that the paper prints, in order [N]."""
    return np.sort(np.concatenate(columns))
