"""Restitution from measured depression and pressure alone: the equation of motion with the measured pressure in it."""

import dataclasses as dc
from collections.abc import Sequence
from functools import partial
from typing import ClassVar, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._numerics import positive_part, safe_divide
from ..contact.effect import AbstractGasEffect, AbstractSensorEffect, Contact, Scalar
from ..contact.law import ContactLaw
from ..inference.parameters import ParameterSpace


MEASURED = "measured_pressure"  # condition under which a law finds the measured pressure
STEPS = 256
REACH = 1.12  # how far beyond the measured separation the motion is followed


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
    if not measured:
        return ContactLaw(law.reference, tuple(e for e in law.effects if not isinstance(e, AbstractSensorEffect)))
    kept = tuple(e for e in law.effects if not isinstance(e, (AbstractSensorEffect, AbstractGasEffect)))
    return ContactLaw(law.reference, (*kept, MeasuredPressure()))


def follow_states(law: ContactLaw, conditions: dict, time: Array, depression: Array, rate: Array, pressure: Array
                  ) -> Array:
    """States of a law's effects along a known motion, shape (times, states), by Heun's method.

    Args:
        law: the law.
        conditions: of the record.
        time, depression, rate, pressure: of the motion, shape (times,).
    """
    diameter, _ = law.start(conditions)
    begin = jnp.stack([e.initial() for e in law.stateful()]) if law.stateful() else jnp.zeros((0,))

    def slope(k, states):
        known = {**conditions, MEASURED: pressure[k]}
        return law.rates(law.contact(known, diameter, time[k], depression[k], rate[k], states), states)

    def advance(states, k):
        h = time[k + 1] - time[k]
        first = slope(k, states)
        after = states + 0.5 * h * (first + slope(k + 1, states + h * first))
        return after, after

    if not law.stateful():
        return jnp.zeros((len(time), 0))
    return jnp.concatenate([begin[None], jax.lax.scan(advance, begin, jnp.arange(len(time) - 1))[1]])


@dc.dataclass(frozen=True)
class Motion:
    """What was measured of one contact.

    Attributes:
        conditions: SI.
        time, depression: samples, shape (samples,).
        pressure: measured, at the half steps of the motion, shape (2 STEPS + 1,); zeros where none is.
        end: how long to follow the motion [s].
        speed_sd, time_sd: standard deviations of approach speed and time origin.
    """

    conditions: dict[str, float]
    time: np.ndarray
    depression: np.ndarray
    pressure: np.ndarray
    end: float
    speed_sd: float
    time_sd: float


@dc.dataclass(frozen=True)
class Rebound:
    """Parameters that the measured depression gives.

    Attributes:
        u: coordinates of all parameters.
        names: of those that were found; `covariance` of their coordinates.
        chi2_reduced: of the depression; `slack` is how far above 1 it may lie by chance.
        converged: whether the fit did.
    """

    u: np.ndarray
    names: tuple[str, ...]
    covariance: np.ndarray
    chi2_reduced: float
    converged: bool
    slack: float = 0.0


def _follow(law: ContactLaw, conditions: dict, pressure: Array, end: Array) -> tuple[Array, Array]:
    """Depression and rate at STEPS + 1 even times from 0 to `end`, by the classical Runge-Kutta method."""
    diameter, damping = law.start(conditions)
    mass = law.reference.inertia()
    h = end / STEPS
    begin = [e.initial() for e in law.stateful()]

    def slope(time, y, gas):
        contact = law.contact({**conditions, MEASURED: gas}, diameter, time, y[0], y[1], y[2:])
        forces = law.forces(contact, damping, y[2:])
        touch = jnp.where(y[0] >= 0.0, 1.0, 0.0)
        return jnp.concatenate([jnp.stack([y[1], touch * (forces.drive - forces.normal) / mass]),
                                law.rates(contact, y[2:])])

    def advance(y, k):
        t = k * h
        a = slope(t, y, pressure[2 * k])
        b = slope(t + 0.5 * h, y + 0.5 * h * a, pressure[2 * k + 1])
        c = slope(t + 0.5 * h, y + 0.5 * h * b, pressure[2 * k + 1])
        d = slope(t + h, y + h * c, pressure[2 * k + 2])
        after = y + h / 6.0 * (a + 2.0 * b + 2.0 * c + d)
        return after, after[:2]

    start = jnp.stack([jnp.zeros(()), conditions["approach_speed"], *begin])
    path = jnp.concatenate([start[None, :2], jax.lax.scan(advance, start, jnp.arange(STEPS))[1]])
    return path[:, 0], path[:, 1]


@partial(jax.jit, static_argnums=(0, 1, 2))
def _linearise(space, names, measured, u, own, conditions, pressure, end, time, scales):
    """Depression of every record at its samples and its derivatives by `names`, speed and time origin."""
    index = jnp.array([space.index[name] for name in names])

    def one(theta, z, conditions, pressure, end, time, scale):
        law = build_law(space, u.at[index].set(theta), measured)
        known = {**conditions, "approach_speed": conditions["approach_speed"] + z[0] * scale[0]}
        depth, rate = _follow(law, known, pressure, end)
        t = jnp.clip(time - z[1] * scale[1], 0.0, end)
        h = end / STEPS
        k = jnp.clip(jnp.floor(t / h).astype(int), 0, STEPS - 1)
        s = t / h - k
        value = ((1 + 2 * s) * (1 - s) ** 2 * depth[k] + s * (1 - s) ** 2 * h * rate[k]
                 + s * s * (3 - 2 * s) * depth[k + 1] - s * s * (1 - s) * h * rate[k + 1])
        return positive_part(value)

    def both(*arguments):
        theta, z = u[index], arguments[0]
        value = one(theta, *arguments)
        shared = jax.jacfwd(lambda a: one(a, *arguments))(theta)
        return value, shared, jax.jacfwd(lambda b: one(theta, b, *arguments[1:]))(z)

    return jax.vmap(both)(own, conditions, pressure, end, time, scales)


def find_rebound(space: ParameterSpace, u: np.ndarray, names: Sequence[str], motions: Sequence[Motion], sd: float,
                 inflation: float, measured: bool) -> Rebound:
    """Fit parameters to the measured depression, each record's speed and time origin under their stated uncertainty.

    Args:
        space: parameters of the law.
        u: start, shape (parameters,).
        names: parameters that are wanted, common to all records.
        motions: the records, all with the same number of samples (pad by repeating the last; nan in `depression`).
        sd: standard deviation of the depression [m]; `inflation` of the variance of means by correlated noise.
        measured: whether the pressure was measured.
    """
    index = [space.index[name] for name in names]
    scale = space.scales()[index]
    conditions = {k: jnp.array([m.conditions[k] for m in motions]) for k in motions[0].conditions}
    stacked = [jnp.array(np.stack([getattr(m, f) for m in motions])) for f in ("pressure", "end", "time")]
    scales = np.array([[m.speed_sd, m.time_sd] for m in motions])
    values = np.stack([m.depression for m in motions])
    there = np.isfinite(values)
    low, high = (bound[index] for bound in space.bounds())
    u, own, damping, best, left = u.copy(), np.zeros((len(motions), 2)), 1e-3, None, np.inf
    state = None
    for _ in range(40):
        trial = (u, own) if state is None else propose(state, damping)
        at = _linearise(space, tuple(names), measured, jnp.asarray(trial[0]), jnp.asarray(trial[1]), conditions,
                        *stacked, jnp.asarray(scales))
        model, shared, private = (np.asarray(x) for x in at)
        residual = np.where(there, (model - np.nan_to_num(values)) / sd, 0.0)
        chi2 = float(np.sum(residual**2) + np.sum(trial[1] ** 2))
        inside = np.all((trial[0][index] >= low) & (trial[0][index] <= high))
        if not np.isfinite(chi2) or not inside or (best is not None and chi2 > best):
            damping *= 6.0
            if damping > 1e8:
                break
            continue
        best = chi2
        damping = max(damping / 6.0, 1e-9)
        a = np.where(there[..., None], shared * scale / sd, 0.0)
        b = np.where(there[..., None], private / sd, 0.0)
        state = (trial[0], trial[1], residual, a, b, index, scale)
        gradient, information = eliminate(trial[1], residual, a, b)
        left = float(gradient @ np.linalg.lstsq(information, gradient, rcond=1e-12)[0])
        if left < 1e-4:
            break
    if state is None or best is None:
        return Rebound(u, tuple(names), np.full((len(names), len(names)), np.inf), float("inf"), False)
    u, own = state[:2]
    _, information = eliminate(*state[1:5])
    covariance = inflation * np.linalg.pinv(information, rcond=1e-12) * np.outer(scale, scale)
    degrees = max(float(there.sum()) - len(names), 1.0)
    return Rebound(u, tuple(names), covariance, float(best) / degrees, left < 1e-2,
                   5.0 * float(np.sqrt(2.0 * inflation / degrees)))


def eliminate(own, residual, a, b, damping: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Gradient and information of the shared parameters once each record's own have been profiled out."""
    inner = np.einsum("gri,grj->gij", b, b) + np.eye(b.shape[2]) * (1.0 + damping)
    cross = np.einsum("gri,grj->gij", b, a)
    pull = np.einsum("gri,gr->gi", b, residual) + own
    solved = np.linalg.solve(inner, np.concatenate([cross, pull[..., None]], axis=2))
    gradient = np.einsum("gri,gr->i", a, residual) - np.einsum("gji,gj->i", cross, solved[..., -1])
    information = np.einsum("gri,grj->ij", a, a) - np.einsum("gki,gkj->ij", cross, solved[..., :-1])
    return gradient, information


def propose(state, damping: float) -> tuple[np.ndarray, np.ndarray]:
    """One step of Levenberg and Marquardt."""
    u, own, residual, a, b, index, scale = state
    gradient, information = eliminate(own, residual, a, b)
    step = -np.linalg.lstsq(information + damping * np.diag(np.diag(information)), gradient, rcond=1e-12)[0]
    inner = np.einsum("gri,grj->gij", b, b) + np.eye(b.shape[2])
    pull = np.einsum("gri,gr->gi", b, residual + a @ step) + own
    moved = u.copy()
    moved[index] += scale * step
    return moved, own - np.linalg.solve(inner, pull[..., None])[..., 0]
