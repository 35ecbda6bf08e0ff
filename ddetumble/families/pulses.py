"""Where fits of impacts begin: mass, restitution and stiffness read off the pulses that were measured."""

import dataclasses as dc
import math
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import least_squares

from ..contact.effect import parameters_of
from ..contact.law import ContactLaw
from ..measurement.campaign import Campaign


MOST = 64  # records that are read: a start needs no more
EDGE = 0.05  # of the peak: a pulse begins and ends where the force passes it, above the noise and close to first touch
CLEAR = 0.2  # of the peak: forces below it are too noisy for a logarithm
POINTS = 16  # forces a record that the elastic law is matched to: a law has a few parameters
TYPICAL = 0.7  # restitution where the pulse does not tell: a rubber ball's
POSSIBLE = (0.2, 0.98)  # restitutions that a fit begins with: nearer to 0 or 1 it hardly moves away
OTHERS = (0.9, 0.5)  # restitutions tried beside the one that was read off: one on either side of a rubber ball's 0.7
SLIGHT = 0.05  # of the elastic force, that damping leaves at least where a reconstructed rate runs off


@dc.dataclass(frozen=True)
class Pulse:
    """One measured impact, from first touch to separation."""

    conditions: dict[str, float]  # of the record, SI
    time: np.ndarray  # since first touch, shape (samples,) [s]
    force: np.ndarray  # shape (samples,) [N]

    @property
    def speed(self) -> float:
        """Approach speed [m/s]."""
        return self.conditions["approach_speed"]

    @property
    def impulse(self) -> float:
        """J, the integral of the force [N s]."""
        return float(np.trapezoid(self.force, self.time))

    def weigh(self) -> float:
        r"""Mass [kg] that has the depression back at zero when the force ends, $m = \int (T - t) F dt / (v_1 T)$."""
        last = self.time[-1]
        return float(np.trapezoid((last - self.time) * self.force, self.time)) / (self.speed * last)


def read_pulses(campaign: Campaign) -> list[Pulse]:
    """Pulses of the first records, those left out that have no peak or do not end within the record."""
    found = []
    for key in list(campaign.record_keys)[:MOST]:
        time, force = _read_force(campaign, key)
        if len(force) < 5:
            continue
        top = int(np.argmax(force))
        quiet = np.flatnonzero(force < EDGE * force[top])
        before, after = quiet[quiet < top], quiet[quiet > top]
        if force[top] <= 0 or not len(after):
            continue
        first, last = (int(before[-1]) if len(before) else 0), int(after[0])
        row = campaign.records.loc[key]
        conditions = {str(name): float(row[name]) for name in campaign.records.columns}
        found.append(Pulse(conditions, time[first: last + 1] - time[first], np.maximum(force[first: last + 1], 0.0)))
    return found


def list_value_guesses(campaign: Campaign, space: Any, start: np.ndarray, free: Sequence[str]) -> list[np.ndarray]:
    r"""Coordinates from which fits of values begin, of which a test gives one each.

    The ratio of rebound to approach speed is the restitution, and the impulse gives the mass by $J = m v_1 (1 + e)$;
    what was not measured stays at the model's own default. The arguments are those of `list_guesses`.
    """
    assert campaign.samples is not None
    table = campaign.samples.set_index("record")
    speeds = campaign.records["approach_speed"].to_numpy(dtype=float)
    guess, restitution = start.copy(), TYPICAL
    if "rebound_speed" in table and "restitution" in free:
        restitution = float(np.clip(np.nanmedian(table["rebound_speed"].to_numpy(dtype=float) / speeds), *POSSIBLE))
        guess[space.index["restitution"]] = math.log(restitution / (1.0 - restitution))
    if "impulse" in table:
        _put_mass(space, guess, free, float(np.nanmedian(table["impulse"].to_numpy(dtype=float) / speeds))
                  / (1.0 + restitution))
    return [guess]


def list_guesses(campaign: Campaign, space: Any, start: np.ndarray, free: Sequence[str]) -> list[np.ndarray]:
    r"""Coordinates from which fits of impacts begin, the likeliest first.

    Impulse, duration and approach speed give the mass and, by $J = m v_1 (1 + e)$, the restitution; with both, the
    depression over time follows from the measured force, and the free parameters of the elastic law are those that
    give that force at that depression (least squares of logarithms, so that no start is too far). Further guesses
    have other restitutions, and the last is the model's own default. Where nothing but mass and restitution is free,
    the impulse gives the mass at the default restitution, and there is one guess.

    Args:
        campaign: with samples of the normal force.
        space: `ParameterSpace` of all parameters.
        start: coordinates, known and given parameters put in.
        free: parameters that are guessed.
    """
    if "normal_force" not in campaign.channels:
        return list_value_guesses(campaign, space, start, free)
    pulses = read_pulses(campaign)
    body = getattr(space.reference, "ball", space.reference)  # of an oblique impact, its normal model
    own = [p.name for p in parameters_of(body) if p.name not in ("effective_mass", "restitution")]
    elastic = [name for name in free if name in own]
    plain = start.copy()
    speeds = campaign.records["approach_speed"].to_numpy(dtype=float)
    masses = []
    for key, speed in list(zip(campaign.record_keys, speeds, strict=True))[:MOST]:
        time, force = _read_force(campaign, key)
        masses.append(float(np.trapezoid(force * (time > 0), time)) / ((1.0 + TYPICAL) * speed))
    _put_mass(space, plain, free, float(np.median(masses)))
    if not elastic or not pulses:
        return [plain]
    ratio = float(np.median([p.impulse / p.speed for p in pulses]))  # m (1 + e)
    known = "effective_mass" in space.index and "effective_mass" not in free
    held = float(np.exp(start[space.index["effective_mass"]])) if known else None
    mass = float(np.median([p.weigh() for p in pulses])) if held is None else held
    read = float(np.clip(ratio / mass - 1.0, *POSSIBLE))
    guesses = []
    for restitution in (read, *OTHERS):
        u = start.copy()
        if "restitution" in free:
            u[space.index["restitution"]] = math.log(restitution / (1.0 - restitution))
        elif "restitution" in space.index:
            restitution = float(1.0 / (1.0 + np.exp(-u[space.index["restitution"]])))
        mass = ratio / (1.0 + restitution) if held is None else held
        _put_mass(space, u, free, mass)
        u = _match_force(space, u, elastic, pulses, mass)
        if u is not None and not any(np.array_equal(u, other) for other in guesses):
            guesses.append(u)
    return [*guesses, plain]


def _read_force(campaign: Campaign, key: str) -> tuple[np.ndarray, np.ndarray]:
    """Times and forces of one record, without gaps, shapes (samples,) [s], [N]."""
    trace = campaign.trace(key)
    time, force = (trace[name].to_numpy(dtype=float) for name in ("time", "normal_force"))
    return time[np.isfinite(force)], force[np.isfinite(force)]


def _put_mass(space: Any, u: np.ndarray, free: Sequence[str], mass: float) -> None:
    """Mass felt along the normal, and as large a one along the plate, where they are free."""
    if np.isfinite(mass) and mass > 0 and "effective_mass" in free:
        for name in ("effective_mass", "tangential_mass"):
            if name in free:
                u[space.index[name]] = np.log(mass)


@eqx.filter_jit
def _log_forces(space, names, values, u, conditions, time, depression, rate):
    """Logarithm of the model's force along known motions, and its derivative by the named coordinates."""
    places = jnp.array([space.index[name] for name in names])

    def forces(x):
        law = space.build(u.at[places].set(x))
        law = law if isinstance(law, ContactLaw) else law.normal

        def one(own, t, d, w):
            diameter, damping = law.start(own)
            contact = law.contact(own, diameter, t, d, w, law.begin_states())
            return jnp.log(jnp.maximum(contact.elastic_force * jnp.maximum(1.0 + damping * w, SLIGHT), 1e-300))

        return jax.vmap(one)(conditions, time, depression, rate)

    return forces(values), jax.jacfwd(forces)(values)


def _match_force(space: Any, u: np.ndarray, names: Sequence[str], pulses: Sequence[Pulse], mass: float
                 ) -> np.ndarray | None:
    """Coordinates whose elastic law gives the measured forces at the depressions that these forces lead to.

    None where the law has no force there at all.
    """
    parts = []
    for k, pulse in enumerate(pulses):
        force, time = pulse.force, pulse.time
        step = np.diff(time)
        rate = pulse.speed - np.concatenate([[0.0], np.cumsum(0.5 * (force[1:] + force[:-1]) * step)]) / mass
        depression = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * step)])
        there = np.flatnonzero((force > CLEAR * force.max()) & (depression > 0))
        if not len(there):
            continue
        there = there[np.unique(np.linspace(0, len(there) - 1, min(POINTS, len(there))).astype(int))]
        parts.append((np.full(len(there), k), *(x[there] for x in (time, depression, rate, force))))
    if not parts:
        return None
    record, time, depression, rate, force = (np.concatenate(x) for x in zip(*parts, strict=True))
    conditions = {name: jnp.asarray(np.array([p.conditions[name] for p in pulses])[record])
                  for name in pulses[0].conditions}
    conditions.setdefault("sequence", jnp.ones(len(record)))
    conditions.setdefault("initial_pressure", jnp.zeros(len(record)))
    places = [space.index[name] for name in names]

    def evaluate(x):
        value, slope = _log_forces(space, tuple(names), jnp.asarray(x), jnp.asarray(u), conditions, jnp.asarray(time),
                                   jnp.asarray(depression), jnp.asarray(rate))
        return np.asarray(value) - np.log(force), np.asarray(slope)

    low, high = (bound[places] for bound in space.bounds())
    begin = np.clip(u[places], low + 1e-6, high - 1e-6)
    if not all(np.isfinite(x).all() for x in evaluate(begin)):
        return None
    found = least_squares(lambda x: evaluate(x)[0], begin, lambda x: evaluate(x)[1],  # pyright: ignore[reportArgumentType]
                          (low, high), loss="soft_l1", x_scale=space.scales()[places], max_nfev=50)
    moved = u.copy()
    moved[places] = found.x
    return moved if np.isfinite(found.x).all() else None
