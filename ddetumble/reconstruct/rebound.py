"""Restitution from measured depression and pressure alone: the equation of motion with the measured pressure in it."""

from collections.abc import Sequence
from functools import partial
from typing import ClassVar, NamedTuple, final

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array

from .._numerics import positive_part, safe_divide
from ..contact.effect import AbstractGasEffect, AbstractSensorEffect, Contact, Scalar
from ..contact.law import ContactLaw
from ..inference.levenberg_marquardt import BorderedLevenbergMarquardt, eliminate_nuisances
from ..inference.parameters import ParameterSpace


MEASURED = "measured_pressure"  # condition under which a law finds the measured pressure
STEPS = 256  # of the motion
REACH = 1.12  # how far beyond the measured separation the motion is followed
TOLERANCE, MOST = 1e-4, 40  # fall of chi-square at which the fit ends, a hundredth of a standard error; and its trials
FAILED = 1e4  # deviations that stand for a sample that could not be computed


@final
class MeasuredPressure(AbstractGasEffect):
    """The gas pressure is what was measured, whatever the gas does."""

    id: ClassVar[str] = "measured-pressure"
    law: ClassVar[str] = "P' as measured"
    reference: ClassVar[str] = "a pressure gauge in the ball"

    def pressure_factor(self, contact: Contact) -> Scalar:
        """Measured pressure over that of Eq. 3 [-]."""
        return safe_divide(contact.conditions[MEASURED], contact.initial_pressure * contact.volume_ratio)


def build_law(space: ParameterSpace, u: Array, measured: bool) -> ContactLaw:
    """The law on the ball's side of the gauge; with `measured`, the pressure is taken from the conditions."""
    law = space.build(u)
    replaced = (AbstractSensorEffect, AbstractGasEffect) if measured else AbstractSensorEffect
    kept = tuple(e for e in law.effects if not isinstance(e, replaced))
    return ContactLaw(law.reference, (*kept, MeasuredPressure()) if measured else kept)


def follow_states(law: ContactLaw, conditions: dict, time: Array, depression: Array, rate: Array, pressure: Array
                  ) -> Array:
    """States of a law's effects along a known motion, each shape (times,), by Heun's method: shape (times, states)."""
    diameter, _ = law.start(conditions)
    if not law.stateful():
        return jnp.zeros((len(time), 0))

    def slope(k, states):
        known = {**conditions, MEASURED: pressure[k]}
        return law.rates(law.contact(known, diameter, time[k], depression[k], rate[k], states), states)

    def advance(states, k):
        h = time[k + 1] - time[k]
        first = slope(k, states)
        after = states + 0.5 * h * (first + slope(k + 1, states + h * first))
        return after, after

    begin = jnp.stack([e.initial() for e in law.stateful()])
    return jnp.concatenate([begin[None], jax.lax.scan(advance, begin, jnp.arange(len(time) - 1))[1]])


class Motion(NamedTuple):
    """What was measured of contacts; a first axis of all arrays counts the records."""

    conditions: dict[str, np.ndarray]  # SI
    time: np.ndarray  # of the samples, shape (samples,), padded by repeating the last
    depression: np.ndarray  # shape (samples,), nan where there is none
    pressure: np.ndarray  # measured, at the half steps of the motion, shape (2 STEPS + 1,); zeros where none is
    end: np.ndarray  # how long to follow the motion [s]
    deviations: np.ndarray  # of approach speed and time origin, shape (2,)


class Rebound(NamedTuple):
    """Parameters that the measured depression gives."""

    u: np.ndarray  # coordinates of all parameters
    names: tuple[str, ...]  # of those that were found
    covariance: np.ndarray  # of their coordinates
    chi2_reduced: float  # of the depression
    converged: bool
    slack: float  # how far above 1 it may lie by chance


def _observe(law: ContactLaw, motion: Motion, z: Array) -> Array:
    """Depression of one record at its samples, by the classical Runge-Kutta method and cubic interpolation.

    `z` moves approach speed and time origin, in their deviations.
    """
    shifts = z * motion.deviations
    conditions = {**motion.conditions, "approach_speed": motion.conditions["approach_speed"] + shifts[0]}
    diameter, damping = law.start(conditions)
    mass, h = law.reference.inertia(), motion.end / STEPS

    def slope(time, y, gas):
        contact = law.contact({**conditions, MEASURED: gas}, diameter, time, y[0], y[1], y[2:])
        forces = law.forces(contact, damping, y[2:])
        touch = jnp.where(y[0] >= 0.0, 1.0, 0.0)
        return jnp.concatenate([jnp.stack([y[1], touch * (forces.drive - forces.normal) / mass]),
                                law.rates(contact, y[2:])])

    def advance(y, k):
        t, gas = k * h, motion.pressure
        a = slope(t, y, gas[2 * k])
        b = slope(t + 0.5 * h, y + 0.5 * h * a, gas[2 * k + 1])
        c = slope(t + 0.5 * h, y + 0.5 * h * b, gas[2 * k + 1])
        d = slope(t + h, y + h * c, gas[2 * k + 2])
        after = y + h / 6.0 * (a + 2.0 * b + 2.0 * c + d)
        return after, after[:2]

    start = jnp.stack([jnp.zeros(()), conditions["approach_speed"], *(e.initial() for e in law.stateful())])
    path = jnp.concatenate([start[None, :2], jax.lax.scan(advance, start, jnp.arange(STEPS))[1]])
    depth, rate = path[:, 0], path[:, 1]
    t = jnp.clip(motion.time - shifts[1], 0.0, motion.end)
    k = jnp.clip(jnp.floor(t / h).astype(int), 0, STEPS - 1)
    s = t / h - k
    return positive_part((1 + 2 * s) * (1 - s) ** 2 * depth[k] + s * (1 - s) ** 2 * h * rate[k]
                         + s * s * (3 - 2 * s) * depth[k + 1] - s * s * (1 - s) * h * rate[k + 1])


@partial(jax.jit, static_argnums=(0, 1, 2))
def _fit(space, names, measured, u, motion, sd):
    """Coordinates of `names`, the records' own shifts, residuals, their derivatives by both, and whether it ended."""
    index = np.array([space.index[name] for name in names])
    scale, low, high = space.scales()[index], *(bound[index] for bound in space.bounds())
    there = jnp.isfinite(motion.depression)

    def place(theta):
        return jnp.clip(u[index] + theta * scale, low, high)

    def residual(y, args):
        theta, z = y
        law = build_law(space, u.at[index].set(place(theta)), measured)
        model = jax.vmap(lambda own, row: _observe(law, row, own))(z, motion)
        left = jnp.where(there, (model - jnp.nan_to_num(motion.depression)) / sd, 0.0)
        return jnp.where(jnp.isfinite(left), left, FAILED), z, jnp.zeros_like(theta)

    solver = BorderedLevenbergMarquardt(jnp.asarray(TOLERANCE), jnp.asarray(MOST))
    start = (jnp.zeros(len(names)), jnp.zeros_like(motion.deviations))
    found = optx.least_squares(residual, solver, start, max_steps=None, throw=False)
    theta, z = found.value
    shared = jax.jacfwd(lambda t: residual((t, z), None)[0])(theta)
    own = jax.jacfwd(lambda step: residual((theta, z + step), None)[0])(jnp.zeros(2))
    converged = (found.result == optx.RESULTS.successful) & solver.has_converged(found.state)
    return place(theta), z, residual((theta, z), None)[0], shared, own, converged


def find_rebound(space: ParameterSpace, u: np.ndarray, names: Sequence[str], motion: Motion, sd: float,
                 inflation: float, measured: bool) -> Rebound:
    """Fit parameters to the measured depression, each record's speed and time origin under their stated uncertainty.

    Args:
        space: parameters of the law.
        u: start, shape (parameters,).
        names: parameters that are wanted, common to all records.
        motion: of the records.
        sd: standard deviation of the depression [m]; `inflation` of the variance of means by correlated noise.
        measured: whether the pressure was measured.
    """
    index = [space.index[name] for name in names]
    values, z, left, shared, own, converged = (np.asarray(x) for x in _fit(
        space, tuple(names), measured, jnp.asarray(u), Motion(*(jax.tree.map(jnp.asarray, x) for x in motion)), sd))
    u = u.copy()
    u[index] = values
    degrees = max(float(np.isfinite(motion.depression).sum()) - len(names), 1.0)
    slack = 5.0 * float(np.sqrt(2.0 * inflation / degrees))
    if np.any(left == FAILED) or not np.all(np.isfinite(shared)):
        return Rebound(u, tuple(names), np.full((len(names), len(names)), np.inf), float("inf"), False, slack)
    records, _, count = own.shape
    columns, _ = eliminate_nuisances(
        np.concatenate([shared, np.zeros((records, count, len(names)))], axis=1),
        np.concatenate([own, np.broadcast_to(np.eye(count), (records, count, count))], axis=1),
        np.concatenate([left, z], axis=1))
    scale = space.scales()[index]
    information = np.einsum("gri,grj->ij", columns, columns)
    covariance = inflation * np.linalg.pinv(information, rcond=1e-12) * np.outer(scale, scale)
    return Rebound(u, tuple(names), covariance, float(np.sum(left**2) + np.sum(z**2)) / degrees, bool(converged), slack)
