"""The paper's own task: force from measured depression and pressure (Eqs. 3 to 5), with uncertainty."""

import dataclasses as dc
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, NamedTuple, final

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pandas as pd
from jaxtyping import Array

from .._display import AbstractPrinted
from .._errors import ComputationError, InputError
from .._numerics import positive_part, safe_divide
from ..contact.effect import AbstractGasEffect, AbstractSensorEffect, Contact, Scalar, parameters_of
from ..contact.law import ContactLaw
from ..families import FAMILIES, find_family, name_family
from ..inference.archive import FittedModel, Model, resolve_model, take_fitted
from ..inference.files import list_fields, make_plain
from ..inference.levenberg_marquardt import BorderedLevenbergMarquardt, eliminate_nuisances
from ..inference.models import ResolvedModel
from ..inference.noise import Noise
from ..inference.noise_estimation import estimate_noise
from ..inference.parameters import ParameterSpace
from ..inference.stack import default_noise
from ..measurement.campaign import Campaign
from ..measurement.package import read_campaign
from .smoothing import Smooth, find_separation, inflate, smooth_samples


FEWEST = 8  # samples in contact: below it a spline of degree 5 is not determined
MOST = 128  # samples of a record from which the restitution is found: it is one number, and more only cost time
BAND = 1.959964  # two-sided 95 % quantile of the normal distribution
MEASURED = "measured_pressure"  # condition under which a law finds the measured pressure
STEPS = 256  # of the motion: finer only costs time
REACH = 1.12  # how far beyond the measured separation the motion is followed, as the model's may come later
TOLERANCE = 1e-4  # fall of chi-square at which the fit ends: a hundredth of a standard error
ENDED = 1e-2  # fall of chi-square that may still be expected where the fit counts as converged
TRIALS = 40  # of the fit, at most: it has one or two parameters and takes a few
FAILED = 1e4  # deviations that stand for a sample that could not be computed: worse than any that can, and finite


@dc.dataclass(frozen=True)
class Identification(AbstractPrinted):
    """The force that depression and pressure say."""

    campaign: str
    model: str
    # Columns `record`, `time`, `normal_force`, `normal_force_sd` and, with a gauge, `gauge`, `difference`, `z`
    # (difference over the standard deviation of both); SI, the campaign's samples in order.
    table: pd.DataFrame
    # One row a record: `record`, `peak_force`, `peak_force_sd`, and with a gauge `peak_gauge`, `bias` (mean difference
    # in contact), `rms_z`, `coverage` (share of the samples in contact inside the 95 % band).
    records: pd.DataFrame
    rms_z: float  # over all samples in contact; nan without a gauge
    coverage: float
    restitution: float  # the value that was used, and its standard deviation
    restitution_sd: float
    source: str  # where it comes from, one sentence
    notes: tuple[str, ...] = ()

    @property
    def sentence(self) -> str:
        """The outcome in one sentence."""
        if not np.isfinite(self.rms_z):
            peak = self.records["peak_force_sd"].median()
            return (f"The force of {len(self.records)} records follows from depression and pressure to ± {peak:.2g} N "
                    "at its peak (one standard deviation); there is no force gauge to compare it with.")
        sure = 0.85 <= self.rms_z <= 1.2
        verdict = "agrees with the gauge within its uncertainty" if sure else (
            "differs from the gauge by more than its uncertainty" if self.rms_z > 1 else
            "is closer to the gauge than its uncertainty implies")
        return (f"The force from depression and pressure {verdict}: the RMS difference is {self.rms_z:.2f} standard "
                f"deviations, and {100 * self.coverage:.1f} % of the samples in contact are inside the 95 % band.")

    def __str__(self) -> str:
        """The outcome for a terminal."""
        rows = self.records.copy()
        if "coverage" in rows:
            rows["coverage"] = [f"{100 * x:.1f} %" for x in rows["coverage"]]
        return "\n\n".join([self.sentence, self.source, rows.to_string(index=False, float_format="{:.3g}".format),
                            *self.notes])

    def to_dict(self) -> dict[str, Any]:
        """Everything but the table of samples, as JSON can hold it."""
        plain = list_fields(self, "table", "records")
        return make_plain({**plain, "sentence": self.sentence, "records": self.records.to_dict("records")})


@dc.dataclass
class _Contact:
    """One record on its way."""

    key: str
    conditions: dict[str, float]
    deviations: tuple[float, float]  # of approach speed and initial pressure
    table: pd.DataFrame
    time: np.ndarray  # of its samples
    touch: np.ndarray  # which of these lie in the contact
    end: float
    smooth: dict[str, Smooth]  # curves by channel


def identify(campaign: Campaign | str | Path, model: Model = "paper") -> Identification:
    """Reconstruct the normal force $F_n$ from measured depression and pressure, and compare it with the force gauge.

    Depression and pressure become smooth curves over each contact; Eqs. 4 and 5 (or the law of a fitted model) then
    give the force. Its uncertainty holds the noise of both, the record's own speed and pressure, and the restitution.
    The gauge is never used for the force.

    Args:
        campaign: with the channel `depression`, best with `pressure` too; or its folder.
        model: reference model, by name or in hand, or a fitted one.

    Raises:
        InputError: no depression, no stated noise, too few samples in a contact, or a model without gas.
    """
    if not isinstance(campaign, Campaign):
        campaign = read_campaign(campaign)
    resolved = resolve_model(model)
    _check(campaign, resolved)
    measured = "pressure" in campaign.channels
    notes = [] if measured else ["There is no channel `pressure`: the gas pressure is that of Eqs. 2 and 3 for the "
                                 "initial pressure, so a leak or another gas law goes undetected."]
    contacts = [_prepare(campaign, key) for key in campaign.record_keys]
    noise = {channel: _smooth_channel(campaign, contacts, channel)
             for channel in (("depression", "pressure") if measured else ("depression",))}
    space = ParameterSpace(resolved.reference, tuple(type(e) for e in resolved.effects))
    # The model's values, and the campaign's where it knows better.
    u = space.coordinates({k: v for k, v in campaign.known.items() if v is not None and k in space.index})
    for effect in resolved.effects:
        for p in parameters_of(effect):
            u[space.index[f"{effect.id}.{p.name}"]] = p.transform.from_field(float(getattr(effect, p.field)))
    saved = take_fitted(model) if resolved.fitted else None  # type: ignore[arg-type]
    names, covariance, u, source, more = _find_parameters(campaign, saved, space, u, contacts, noise["depression"],
                                                          measured)
    notes += more
    left = [e.id for e in resolved.effects if isinstance(e, AbstractSensorEffect)]
    if left:
        notes.append(f"{', '.join(left)} acts on the gauge, not on the force, and is left out here.")
    table = pd.concat(_evaluate(space, u, names, covariance, contacts, measured), ignore_index=True)
    records, rms_z, coverage = _summarise(campaign, table, contacts)
    restitution, sd = float("nan"), 0.0
    if "restitution" in space.index:
        place = names.index("restitution") if "restitution" in names else None
        width = 0.0 if place is None else float(np.sqrt(max(covariance[place, place], 0.0)))
        value = space.public("restitution", u, width)
        restitution, sd = float(value["estimate"]), float(value["sd"])
    return Identification(campaign.name, resolved.name, table.drop(columns="inside"), records, rms_z, coverage,
                          restitution, sd, source, tuple(notes))


def _check(campaign: Campaign, resolved: ResolvedModel):
    if not find_family(name_family(campaign)).has_contact:
        kinds = " and ".join(dict.fromkeys(repr(f.kind.name) for f in FAMILIES.values() if f.has_contact))
        raise InputError(f"campaign {campaign.name!r} is of family {campaign.family!r}; identify reads {kinds}")
    if campaign.samples is None:
        raise InputError(f"campaign {campaign.name!r} contains only peaks; identify needs the depression over time")
    if "depression" not in campaign.channels:
        raise InputError(f"campaign {campaign.name!r} has no channel 'depression', from which the force would follow; "
                         f"its channels are: {', '.join(campaign.channels)}")
    if "gas" not in resolved.reference.provides:
        raise InputError(f"the model {resolved.name!r} has no gas; identify computes the force from the pressure of "
                         "the gas and the contact area")


def _refuse_few(campaign: Campaign, key: str, used: np.ndarray, what: str, remedy: str = "") -> None:
    if used.sum() < FEWEST:
        raise InputError(f"record {key!r} of campaign {campaign.name!r} has {int(used.sum())} samples of {what}; "
                         f"identify needs at least {FEWEST}{remedy}")


def _prepare(campaign: Campaign, key: str) -> _Contact:
    """Find the contact of one record."""
    table = campaign.trace(key)
    conditions = {str(name): float(value) for name, value in campaign.records.loc[key].items()}
    speed, pressure = (float(campaign.conditions[name].sd(conditions[name]))
                       for name in ("approach_speed", "initial_pressure"))
    time, depression = table["time"].to_numpy(dtype=float), table["depression"].to_numpy(dtype=float)
    good = np.isfinite(depression) & (time > 0)
    _refuse_few(campaign, key, good, "depression after first touch")
    end = find_separation(time[good], depression[good])
    touch = (time > 0) & (time < end)
    _refuse_few(campaign, key, touch & good, "depression in contact", ": sample faster")
    return _Contact(str(key), conditions, (speed, pressure), table, time, touch, end, {})


def _smooth_channel(campaign: Campaign, contacts: Sequence[_Contact], channel: str) -> Noise:
    """Smooth a channel of every record; its noise is first taken as stated, then as measured."""
    blind = 2.0 * campaign.time_sd
    noise = default_noise(campaign, channel, contacts[0].time)
    for again in (False, True):
        residuals, steps = [], []
        for contact in contacts:
            values = contact.table[channel].to_numpy(dtype=float)
            # Whether a sample so close to first touch lies before or after the kink is not known.
            use = contact.touch & np.isfinite(values) & (contact.time > min(blind, 0.1 * contact.end))
            _refuse_few(campaign, contact.key, use, f"{channel} in contact")
            contact.smooth[channel] = smooth = smooth_samples(contact.time[use], values[use], noise, 0.0, contact.end)
            step = np.diff(contact.time[use])
            if np.allclose(step, step[0], rtol=2e-3):
                residuals.append(smooth.residual / np.sqrt(max(1.0 - smooth.spent / use.sum(), 0.25)))
                steps.append(step[0])
        if again or not residuals:
            break
        interval = float(np.median(steps))
        lowest = 10.0 / float(np.median([c.end for c in contacts]))
        even = [x for x, s in zip(residuals, steps, strict=True) if abs(s / interval - 1) < 2e-3]
        noise = estimate_noise(even, interval, lowest, noise.stated_sd)
    return noise


def _find_parameters(campaign: Campaign, saved: FittedModel | None, space: ParameterSpace, u: np.ndarray,
                     contacts: Sequence[_Contact], noise: Noise, measured: bool):
    """Restitution and whatever else is unknown: names, covariance, coordinates, source, notes."""
    if saved is not None:
        u = u.copy()
        for name in saved.space.index:
            u[space.index[name]] = saved.u[saved.space.index[name]]
        return (saved.free, saved.covariance, u,
                f"The restitution and all other parameters are those of the model fitted to {saved.campaign}.", [])
    wanted = [s.name for s in space.slots
              if s.owner is None and s.parameter.free and campaign.known.get(s.name) is None]
    if not [name for name in wanted if name != "effective_mass"]:
        return (), np.zeros((0, 0)), u, "The restitution is the one that the campaign states as known.", []
    rows, masses = [], []
    for contact in contacts:
        time, depth = contact.time, contact.table["depression"].to_numpy(dtype=float)
        reach = min(REACH * contact.end, max(float(time[-1]), contact.end))
        inside = np.flatnonzero((time > 0) & (time <= reach))
        inside = inside[:: -(-len(inside) // MOST)]
        pad = MOST - len(inside)
        half = np.linspace(0.0, reach, 2 * STEPS + 1)
        gas = contact.smooth["pressure"].at(np.minimum(half, contact.end)) if measured else np.zeros(2 * STEPS + 1)
        rows.append((np.pad(time[inside], (0, pad), mode="edge"),
                     np.pad(depth[inside], (0, pad), constant_values=np.nan), gas, reach,
                     (contact.deviations[0], campaign.time_sd)))
        # The work of the gas up to the largest depression, and a third of it for the damping, is m v^2 / 2.
        rise = contact.smooth["depression"].at(half[half <= contact.end]).max()
        pressure = float(np.mean(gas)) if measured else contact.conditions.get("initial_pressure", 0.0)
        work = pressure * (np.pi / 4) ** 2 * np.pi * rise**3 / 3.0
        masses.append(2.6 * work / contact.conditions["approach_speed"] ** 2)
    mass = float(np.median(masses))
    if "effective_mass" in wanted and mass > 0:
        u = u.copy()
        u[space.index["effective_mass"]] = np.log(mass)
    thin = max(1.0, float(np.median([c.touch.sum() for c in contacts])) / MOST)
    motion = Motion(_stack_conditions(contacts), *(np.array(column) for column in zip(*rows, strict=True)))
    u, covariance, notes = find_rebound(space, u, wanted, motion, noise.sd, max(inflate(noise) / thin, 1.0), measured)
    gas = "pressure" if measured else "initial pressure"
    source = (f"The restitution was found from the measured depression and {gas} of all records by the equation of "
              "motion, without the gauge.")
    return wanted, covariance, u, source, notes


def _stack_conditions(contacts: Sequence[_Contact]) -> dict[str, np.ndarray]:
    return {k: np.array([c.conditions[k] for c in contacts]) for k in contacts[0].conditions}


@partial(jax.jit, static_argnums=(0, 1, 2))
def _forces(space, names, measured, u, conditions, time, depression, rate, pressure):
    """Force at every instant and its derivatives by depression, rate, pressure; parameters; speed, initial pressure."""
    index = jnp.array([space.index[name] for name in names], dtype=int)

    def one(conditions, time, depression, rate, pressure):
        theta = u[index]
        law = build_law(space, u, measured)
        states = jax.lax.stop_gradient(follow_states(law, conditions, time, depression, rate, pressure))

        def force(seen, theta, common, t, state):
            law = build_law(space, u.at[index].set(theta), measured)
            known = {**conditions, "approach_speed": common[0], "initial_pressure": common[1], MEASURED: seen[2]}
            diameter, damping = law.start(known)
            contact = law.contact(known, diameter, t, seen[0], seen[1], state)
            return law.forces(contact, damping, state).normal

        common = jnp.stack([conditions["approach_speed"], conditions["initial_pressure"]])

        def at(t, d, w, p, state):
            seen = jnp.stack([d, w, p])
            slopes = jax.jacfwd(force, argnums=(0, 1, 2))(seen, theta, common, t, state)
            return force(seen, theta, common, t, state), slopes

        return jax.vmap(at)(time, depression, rate, pressure, states)

    return jax.vmap(one)(conditions, time, depression, rate, pressure)


def _evaluate(space: ParameterSpace, u: np.ndarray, names: Sequence[str], covariance: np.ndarray,
              contacts: Sequence[_Contact], measured: bool) -> list[pd.DataFrame]:
    """The force of every record with its standard deviation, at all its samples."""
    longest = max(int(c.touch.sum()) for c in contacts) + 1
    size = 1 << int(np.ceil(np.log2(longest)))
    inputs = []
    for contact in contacts:
        # First touch itself leads the samples: the effects' states start there.
        inside = np.concatenate([[0.0], contact.time[contact.touch]])
        time = np.pad(inside, (0, size - len(inside)), mode="edge")
        depth = np.maximum(contact.smooth["depression"].at(time), 0.0)
        pressure = contact.smooth["pressure"].at(time) if measured else np.zeros(size)
        inputs.append((time, depth, contact.smooth["depression"].at(time, 1), pressure))
    stacked = [jnp.asarray(np.stack(column)) for column in zip(*inputs, strict=True)]
    conditions = {name: jnp.asarray(x) for name, x in _stack_conditions(contacts).items()}
    force, slopes = _forces(space, tuple(names), measured, jnp.asarray(u), conditions, *stacked)
    tables = []
    for r, contact in enumerate(contacts):
        here = slice(1, int(contact.touch.sum()) + 1)
        time, smooth = inputs[r][0][here], contact.smooth["depression"]
        by_seen, by_theta, by_common = (np.asarray(x)[r, here] for x in slopes)
        rows = by_seen[:, 0, None] * smooth.columns(time) + by_seen[:, 1, None] * smooth.columns(time, 1)
        variance = np.sum((rows @ smooth.covariance) * rows, axis=1)
        if measured:
            gas = contact.smooth["pressure"]
            rows = by_seen[:, 2, None] * gas.columns(time)
            variance += np.sum((rows @ gas.covariance) * rows, axis=1)
        variance += np.sum((by_theta @ covariance) * by_theta, axis=1)
        variance += by_common**2 @ (np.array(contact.deviations) ** 2)
        if not np.all(np.isfinite(variance)):
            raise ComputationError(f"the force of record {contact.key!r} is not finite; check its pressure and "
                                   "depression")
        values, deviation = np.zeros(len(contact.time)), np.zeros(len(contact.time))
        values[contact.touch] = np.asarray(force)[r, here]
        deviation[contact.touch] = np.sqrt(np.maximum(variance, 0.0))
        tables.append(pd.DataFrame({"record": contact.key, "time": contact.time, "normal_force": values,
                                    "normal_force_sd": deviation, "inside": contact.touch}))
    return tables


def _summarise(campaign: Campaign, table: pd.DataFrame, contacts: Sequence[_Contact]
               ) -> tuple[pd.DataFrame, float, float]:
    """Fill in what the gauge says: one row a record, and rms and coverage of all; nan without a gauge."""
    gauge = "normal_force" in campaign.channels
    if gauge:
        assert campaign.samples is not None
        sd = default_noise(campaign, "normal_force", contacts[0].time).sd
        table["gauge"] = campaign.samples["normal_force"].to_numpy(dtype=float)
        table["difference"] = table["normal_force"] - table["gauge"]
        table["z"] = table["difference"] / np.hypot(table["normal_force_sd"], sd)

    def judge(rows: pd.DataFrame) -> dict[str, float]:
        z = rows.loc[rows["inside"] & np.isfinite(rows["z"]), "z"].to_numpy() if gauge else np.zeros(0)
        return {"rms_z": float(np.sqrt(np.mean(z**2))) if len(z) else float("nan"),
                "coverage": float(np.mean(np.abs(z) < BAND)) if len(z) else float("nan")}

    found = []
    for key, own in table.groupby("record", sort=False):
        top = own.loc[own["normal_force"].idxmax()]
        found.append({"record": key, "peak_force": top["normal_force"], "peak_force_sd": top["normal_force_sd"]})
        if gauge:
            found[-1] |= {"peak_gauge": own["gauge"].max(), "bias": own.loc[own["inside"], "difference"].mean(),
                          **judge(own)}
    whole = judge(table)
    return pd.DataFrame(found), whole["rms_z"], whole["coverage"]


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

    begin = law.begin_states()
    return jnp.concatenate([begin[None], jax.lax.scan(advance, begin, jnp.arange(len(time) - 1))[1]])


class Motion(NamedTuple):
    """What was measured of contacts; a first axis of all arrays counts the records."""

    conditions: dict[str, Any]  # SI
    time: np.ndarray  # of the samples, shape (samples,), padded by repeating the last
    depression: np.ndarray  # shape (samples,), nan where there is none
    pressure: np.ndarray  # measured, at the half steps of the motion, shape (2 STEPS + 1,); zeros where none is
    end: np.ndarray  # how long to follow the motion [s]
    deviations: np.ndarray  # of approach speed and time origin, shape (2,)


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

    start = jnp.concatenate([jnp.stack([jnp.zeros(()), conditions["approach_speed"]]), law.begin_states()])
    path = jnp.concatenate([start[None, :2], jax.lax.scan(advance, start, jnp.arange(STEPS))[1]])
    depth, rate = path[:, 0], path[:, 1]
    t = jnp.clip(motion.time - shifts[1], 0.0, motion.end)
    k = jnp.clip(jnp.floor(t / h).astype(int), 0, STEPS - 1)
    s = t / h - k
    return positive_part((1 + 2 * s) * (1 - s) ** 2 * depth[k] + s * (1 - s) ** 2 * h * rate[k]
                         + s * s * (3 - 2 * s) * depth[k + 1] - s * s * (1 - s) * h * rate[k + 1])


@partial(jax.jit, static_argnums=(0, 1, 2))
def _fit(space, names, measured, u, motion, sd):
    """Coordinates of `names`, the records' own shifts, residuals, and their derivatives by both."""
    index = np.array([space.index[name] for name in names])
    scale, low, high = space.scales()[index], *(bound[index] for bound in space.bounds())
    there = jnp.isfinite(motion.depression)

    def place(theta):
        return jnp.clip(u[index] + theta * scale, low, high)

    def compare(values, z):
        law = build_law(space, u.at[index].set(values), measured)
        model = jax.vmap(lambda own, row: _observe(law, row, own))(z, motion)
        left = jnp.where(there, (model - jnp.nan_to_num(motion.depression)) / sd, 0.0)
        return jnp.where(jnp.isfinite(left), left, FAILED)

    def residual(y, args):
        theta, z = y
        return compare(place(theta), z), z, jnp.zeros_like(theta)

    solver = BorderedLevenbergMarquardt(jnp.asarray(TOLERANCE), jnp.asarray(TRIALS))
    start = (jnp.zeros(len(names)), jnp.zeros_like(motion.deviations))
    found = optx.least_squares(residual, solver, start, max_steps=None, throw=False)
    theta, z = found.value
    values = place(theta)
    # By the values themselves: at a limit, too, they are as uncertain as the samples leave them.
    shared = jax.jacfwd(lambda step: compare(values + scale * step, z))(jnp.zeros_like(theta))
    own = jax.jacfwd(lambda step: compare(values, z + step))(jnp.zeros(2))
    return values, z, compare(values, z), shared, own


def find_rebound(space: ParameterSpace, u: np.ndarray, names: Sequence[str], motion: Motion, sd: float,
                 inflation: float, measured: bool) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Fit the parameters `names` to the measured depression, each record's speed and time origin under their stated
    uncertainty.

    Coordinates `u` of all parameters, shape (parameters,), are where they start; `sd` is the standard deviation of the
    depression [m], and `inflation` how much correlated noise adds to the variance of means, a factor. Returns the
    coordinates, the covariance of those of `names`, and sentences on what is wrong with them.
    """
    index = [space.index[name] for name in names]
    values, z, left, shared, own = (np.asarray(x) for x in _fit(
        space, tuple(names), measured, jnp.asarray(u), Motion(*(jax.tree.map(jnp.asarray, x) for x in motion)), sd))
    u = u.copy()
    u[index] = values
    degrees = max(float(np.isfinite(motion.depression).sum()) - len(names), 1.0)
    slack = 5.0 * float(np.sqrt(2.0 * inflation / degrees))
    if np.any(left == FAILED) or not np.all(np.isfinite(shared)):
        raise ComputationError("the motion of the ball could not be integrated with the measured pressure: check the "
                               "conditions and the units of depression and pressure")
    records, _, count = own.shape
    columns, right = eliminate_nuisances(
        np.concatenate([shared, np.zeros((records, count, len(names)))], axis=1),
        np.concatenate([own, np.broadcast_to(np.eye(count), (records, count, count))], axis=1),
        np.concatenate([left, z], axis=1))
    scale = space.scales()[index]
    information = np.einsum("gri,grj->ij", columns, columns)
    gradient = np.einsum("gri,gr->i", columns, right)
    expected = float(gradient @ np.linalg.lstsq(information, gradient, rcond=1e-12)[0])
    covariance = inflation * np.linalg.pinv(information, rcond=1e-12) * np.outer(scale, scale)
    chi2, notes = float(np.sum(left**2) + np.sum(z**2)) / degrees, []
    if not expected < ENDED:
        notes.append("The fit of the restitution did not converge.")
    if "restitution" in names and abs(u[space.index["restitution"]]) > 5.0:
        notes.append("The restitution ran to its limit, so the force is unreliable; give its value under `known`.")
    if chi2 > 1.0 + slack:
        notes.append(f"The equation of motion leaves {np.sqrt(chi2):.2g} times the noise in the depression: the model "
                     "is incomplete, and the errors of restitution and force may exceed those stated.")
    return u, covariance, notes
