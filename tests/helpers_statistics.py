"""A toy of the statistics: pulses of a force in closed form, fitted by NumPy alone, in a few milliseconds a fit.

Everything else is the package's own: the campaign, its stack, parameters, the selection problem.
"""

import dataclasses as dc
from typing import ClassVar

import jax.numpy as jnp
import numpy as np
import pandas as pd
from jaxtyping import Array

from ddetumble.contact.effect import AbstractEffect, AbstractModel, parameter
from ddetumble.exam.simulators.noise import draw_noise
from ddetumble.inference.levenberg_marquardt import eliminate_nuisances
from ddetumble.inference.noise import TAPS, Noise, scale_whitening, whitening, whitening_matrix
from ddetumble.inference.parameters import ParameterSpace
from ddetumble.inference.problem import Problem, Solution
from ddetumble.inference.stack import COSINE, SINE, Records, Stack, is_added, widen_settings
from ddetumble.measurement.campaign import Campaign, Column
from ddetumble.measurement.units import Uncertainty
from ddetumble.selection.problem import SelectionProblem
from ddetumble.selection.settings import SelectionSettings


TIME = np.linspace(-0.24, 1.26, 76)
SPEEDS, PRESSURES = (1.0, 1.4, 1.8, 2.2), (1e5, 1.6e5)
SD = {"normal_force": 0.05, "depression": 2e-4}
CLOCK = 1e-3  # s, standard deviation of first touch
NUISANCES = ("approach_speed", "initial_pressure", "time")


class Pulse(AbstractModel):
    """F = k v sin(pi t) + g p/p0 sin²(pi t) + l v sin(2 pi t) while 0 < t < 1."""

    family: ClassVar[str] = "impact"
    stiffness: Array = parameter("N s/m", 10.0, kind="reference", coordinate="log", bounds=(0.1, 1e4))
    gas: Array = parameter("N", 3.0, kind="reference")
    loss: Array = parameter("N s/m", 1.0, kind="reference")

    def extend(self, effects):
        """The same: what effects do stands in `compute_force`."""
        return self


class Ripple(AbstractEffect):
    """a v² sin(3 pi t)."""

    id = "ripple"
    law = reference = ""
    a: Array = parameter("N", typical=0.5, sign=1, limits=(0.0, 2.0), limits_reason="so much is known")


class Echo(AbstractEffect):
    """a v² sin(3 pi t + 0.1): hardly another ripple."""

    id = "echo"
    law = reference = ""
    a: Array = parameter("N", typical=0.5)


class Bump(AbstractEffect):
    """a (v/1.5)^q exp(-(t - 0.7)²/0.02): its power q is held at 1 until it is freed."""

    id = "bump"
    law = reference = ""
    a: Array = parameter("N", typical=0.5)
    q: Array = parameter("", 1.0, kind="shape", typical=1.0, free=False)


class Settling(AbstractEffect):
    """a p/p0 sin(4 pi t)."""

    id = "settling"
    law = reference = ""
    a: Array = parameter("N", typical=0.5)


EFFECTS = (Ripple, Echo, Bump, Settling)


def compute_force(p: dict, v: np.ndarray, pressure: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Force of every record, shape (records, samples), at speeds and pressures, each shape (records, 1)."""
    x, ratio = np.pi * t, pressure / 1e5
    force = p["stiffness"] * v * np.sin(x) + p["gas"] * ratio * np.sin(x) ** 2 + p["loss"] * v * np.sin(2 * x)
    if np.any(p.get("ripple.a", 0.0)):
        force = force + p["ripple.a"] * v**2 * np.sin(3 * x)
    if np.any(p.get("echo.a", 0.0)):
        force = force + p["echo.a"] * v**2 * np.sin(3 * x + 0.1)
    if np.any(p.get("bump.a", 0.0)):
        force = force + p["bump.a"] * (np.abs(v) / 1.5) ** p.get("bump.q", 1.0) * np.exp(-((t - 0.7) ** 2) / 0.02)
    if np.any(p.get("settling.a", 0.0)):
        force = force + p["settling.a"] * ratio * np.sin(4 * x)
    return force * ((t > 0) & (t < 1))


def compute_channels(channels, p, conditions, t):
    """Channels of every record, shape (records, channels, samples)."""
    v, pressure = conditions["approach_speed"][:, None], conditions["initial_pressure"][:, None]
    one = {"normal_force": lambda: compute_force(p, v, pressure, t),
           "depression": lambda: 0.02 * v * np.sin(np.pi * t) * ((t > 0) & (t < 1))}
    return np.stack([one[c]() for c in channels], axis=1)


class ToyProblem(Problem):
    """The least-squares problem of pulses, solved by Gauss-Newton steps on differences."""

    def __init__(self, space, records, priors=None):
        super().__init__(space, records, priors)
        stack = records.stack
        self.time, self.values, self.weights, self.taps, self.sd = (np.asarray(x) for x in (
            stack.time, stack.values, stack.weights, stack.taps, stack.condition_sd))
        self.conditions = {name: np.asarray(x) for name, x in stack.conditions.items()}

    def model(self, u, z):
        """Channels at coordinates and nuisances."""
        p = {s.name: s.parameter.transform.to_field(u[..., k, None]) for k, s in enumerate(self.space.slots)}
        moved, time, added = dict(self.conditions), self.time, np.zeros(self.values.shape)
        for k, name in enumerate(self.records.nuisances):
            if is_added(name):
                kind, channel = name.split(":")
                turns = np.asarray(self.records.stack.inputs["hum"])[:, int(kind.split("-")[1]), None] * self.time
                shape = np.sin(turns) if kind.startswith(SINE) else np.cos(turns)
                added[:, self.records.channels.index(channel)] += (z[:, k] * self.sd[:, k])[:, None] * shape
            elif name == "time":
                time = time - (z[:, k] * self.sd[:, k])[:, None]
            else:
                moved[name] = moved[name] + z[:, k] * self.sd[:, k]
        return compute_channels(self.records.channels, p, moved, time) + added

    def whitened(self, x):
        """Rows of the residual, shape (records, rows)."""
        if not self.taps.any():
            return (x * self.weights).reshape(len(x), -1)
        return np.stack([np.concatenate([whitening_matrix(self.weights[r, c], self.taps[r, c]) @ x[r, c]
                                         for c in range(x.shape[1])]) for r in range(len(x))])

    def solve(self, free, start, z=None, *, moving=True, tolerance=1e-7, max_steps=None):
        """As `Problem.solve`."""
        free, count = tuple(free), self.records.count
        places = [self.space.index[name] for name in free]
        scales, (low, high) = self.scales[places], self.limits
        u = np.array(start, dtype=float)
        inside = np.minimum(1e-3 * self.scales, 0.25 * (high - low))
        u[..., places] = np.clip(u, low + inside, high - inside)[..., places]
        z = np.zeros((count, 0)) if z is None else np.array(z, dtype=float)
        z = np.pad(z, ((0, 0), (0, len(self.records.nuisances) - z.shape[1])))
        mean, weight = np.zeros(len(self.space)), np.zeros(len(self.space))
        for name, (centre, sd) in self.priors.items():
            k = self.space.index[name]
            mean[k], weight[k] = centre, self.scales[k] / sd

        def look(u, z):
            channels = self.model(u, z)
            residual = self.whitened(channels - self.values)
            prior = ((np.atleast_2d(u)[0] - mean) / self.scales * weight)[places]
            return channels, residual, prior, float(np.sum(residual**2) + np.sum(z**2) + np.sum(prior**2))

        channels, residual, prior, chi2 = look(u, z)
        converged, steps = False, 0
        while steps < ((30 if max_steps is None else max_steps) if moving else 1):
            steps += 1
            shared = np.zeros((*residual.shape, len(free)))
            own = np.zeros((*residual.shape, z.shape[1]))
            for j, k in enumerate(places):
                h = np.zeros(len(self.space))
                h[k] = 1e-4 * self.scales[k]
                shared[..., j] = self.whitened(self.model(u + h, z) - self.model(u - h, z)) / 2e-4
            for j in range(z.shape[1]):
                h = np.zeros_like(z)
                h[:, j] = 1e-3
                own[..., j] = self.whitened(self.model(u, z + h) - self.model(u, z - h)) / 2e-3
            if not moving:
                break
            eye = np.broadcast_to(np.eye(z.shape[1]), (count, z.shape[1], z.shape[1]))
            rows, right = np.concatenate([own, eye], axis=1), np.concatenate([residual, z], axis=1)
            wide = np.concatenate([shared, np.zeros((*z.shape, len(free)))], axis=1)
            columns, side = eliminate_nuisances(wide, rows, right)
            flat = np.concatenate([columns.reshape(side.size, len(free)), np.diag(weight[places])])
            size = np.maximum(np.linalg.norm(flat, axis=0), 1e-9)
            step = -np.linalg.lstsq(flat / size, np.append(side.ravel(), prior), rcond=1e-10)[0] / size
            moved = right + wide @ step
            change = np.stack([-np.linalg.lstsq(a, b, rcond=None)[0] for a, b in zip(rows, moved, strict=True)])
            for _ in range(8):
                new = u.copy()
                new[places] = np.clip(new[places] + scales * step, low[places], high[places])
                tried = look(new, z + change)
                if tried[3] <= chi2 + 1e-9:
                    break
                step, change = 0.3 * step, 0.3 * change
            else:
                converged = True
                break
            fall, (channels, residual, prior, chi2) = chi2 - tried[3], tried
            u, z = new, z + change
            converged = fall < max(tolerance, 1e-9)
            if converged:
                break
        v, t = self.conditions["approach_speed"][:, None], self.time
        touching = (t > 0) & (t < 1)
        failed = tuple(k for k, bad in zip(self.records.keys, ~np.isfinite(residual).all(axis=1), strict=True) if bad)
        return Solution(free, np.atleast_2d(u)[0], z, scales, residual, shared, own, channels,
                        v * np.sin(np.pi * t) * touching, v * np.cos(np.pi * t) * touching, np.ones(count), prior,
                        weight[places], chi2,
                        converged and not failed, steps, failed)


@dc.dataclass(frozen=True)
class ToySelection(SelectionProblem):
    """The choice of a model for pulses."""

    def restack(self, noise):
        """The same under another noise, with settings that scatter as far as they are allowed to."""
        whole, given = whiten_records(self.records, noise), self.campaign
        deviations = np.asarray(whole.stack.condition_sd).copy()
        for k, name in enumerate(whole.nuisances):
            if name in given.conditions:
                deviations[:, k] = given.conditions[name].uncertainty.sd(given.records[name])
        stack = dc.replace(whole.stack, condition_sd=jnp.asarray(deviations))
        problem = ToyProblem(self.space, widen_settings(dc.replace(whole, stack=stack), self.spread))
        return dc.replace(self, records=problem.records, problem=problem)


def whiten_records(records: Records, noise) -> Records:
    """The same records under another noise."""
    time = np.asarray(records.stack.time)
    missing = np.asarray(records.stack.weights) == 0
    weights, taps = np.zeros(missing.shape), np.zeros((*missing.shape, TAPS))
    for r in range(records.count):
        for c, channel in enumerate(records.channels):
            plain = whitening(noise[channel], time[r], ~missing[r, c])
            sizes = noise[channel].sizes.get(records.keys[r], np.ones(time.shape[1]))
            weights[r, c], taps[r, c] = scale_whitening(*plain, sizes)
    hums = [(channel, *line) for channel in records.channels for line in noise[channel].hum]
    plain = [k for k, name in enumerate(records.nuisances) if not is_added(name)]
    deviations = np.concatenate([np.asarray(records.stack.condition_sd)[:, plain], np.tile(
        [sd for *_, sd in hums for _ in (SINE, COSINE)], (records.count, 1)).reshape(records.count, -1)], axis=1)
    turning = {"hum": jnp.asarray(np.tile([2.0 * np.pi * f for _, f, _ in hums], (records.count, 1)))} if hums else {}
    names = (*(records.nuisances[k] for k in plain),
             *(f"{kind}-{k}:{channel}" for k, (channel, *_) in enumerate(hums) for kind in (SINE, COSINE)))
    stack = dc.replace(records.stack, weights=jnp.asarray(weights), taps=jnp.asarray(taps),
                       condition_sd=jnp.asarray(deviations), inputs=turning)
    return dc.replace(records, stack=stack, nuisances=names)


def white(sd: float = 1.0, level: float = 0.0, interval: float = 0.02) -> Noise:
    """White noise, whose level is known so well."""
    return Noise(sd, 0.0, 0.0, interval, sd, level, "white")


def make_selection(seed=0, truth=(), spoil=None, channels=("normal_force",), conditions=None, effects=EFFECTS,
                   settings=None, rho=0.0, noise=1.0, sequence=False) -> ToySelection:
    """A choice of effects for pulses.

    Args:
        seed: of noise and settings.
        truth: values of parameters that differ from their defaults, pairs or a mapping.
        spoil: called with values, shape (records, channels, samples), and conditions by name, to change both.
        channels: that are measured.
        conditions: nominal (speed, pressure) of every record; all pairs of `SPEEDS` and `PRESSURES` if not given.
        effects: candidates; settings: thresholds.
        rho: correlation of the noise from sample to sample; noise: its size over the stated one.
        sequence: whether the records are numbered.
    """
    generator = np.random.default_rng([20, seed])
    nominal = np.array(conditions or [(v, p) for v in SPEEDS for p in PRESSURES])
    count = len(nominal)
    values = {"stiffness": 10.0, "gas": 3.0, "loss": 1.0} | dict(truth)
    sd = {"approach_speed": 0.01 * nominal[:, 0], "initial_pressure": 0.01 * nominal[:, 1]}
    true = {name: nominal[:, k] + s * generator.standard_normal(count) for k, (name, s) in enumerate(sd.items())}
    first = CLOCK * generator.standard_normal(count)
    measured = compute_channels(channels, values, true, TIME - first[:, None])
    for r in range(count):
        for c, channel in enumerate(channels):
            measured[r, c] += draw_noise(generator, len(TIME), noise * SD[channel], rho)
    stated = {"approach_speed": nominal[:, 0].copy(), "initial_pressure": nominal[:, 1].copy()}
    if spoil is not None:
        spoil(measured, stated)
    keys = tuple(f"r{k}" for k in range(count))
    table = pd.DataFrame(stated, index=pd.Index(keys, name="record"))
    units = {"approach_speed": "m/s", "initial_pressure": "Pa"}
    columns = {n: Column(n, units[n], Uncertainty(relative=0.01)) for n in stated}
    if sequence:
        table["sequence"] = np.arange(1.0, count + 1.0)
        columns["sequence"] = Column("sequence", "1")
    samples = pd.DataFrame({"record": np.repeat(keys, len(TIME)), "time": np.tile(TIME, count)}
                           | {c: measured[:, k].ravel() for k, c in enumerate(channels)})
    campaign = Campaign("toy", "Toy", "impact", None, {}, table, columns, Column("time", "s", Uncertainty(CLOCK)),
                        {c: Column(c, {"normal_force": "N", "depression": "m"}[c], Uncertainty(SD[c]))
                         for c in channels}, samples)
    shape = (count, len(channels), len(TIME))
    stack = Stack(
        jnp.asarray(np.tile(TIME, (count, 1))), jnp.ones(count), jnp.asarray(measured), jnp.ones(shape),
        jnp.zeros((*shape, TAPS)), {n: jnp.asarray(x) for n, x in stated.items()},
        jnp.asarray(np.stack([sd["approach_speed"], sd["initial_pressure"], np.full(count, CLOCK)], axis=1)),
        jnp.ones(count))
    records = Records(keys, tuple(channels), NUISANCES, np.full(count, len(TIME)), np.ones(shape[:2], bool), stack,
                      "impact")
    known = {c: white(SD[c]) for c in channels}
    space = ParameterSpace(Pulse(), effects)
    problem = ToyProblem(space, whiten_records(records, known))
    start = space.coordinates()
    return ToySelection(campaign, settings or SelectionSettings(), None, space, start, ("stiffness", "gas", "loss"),
                        tuple(effects), tuple(effects), (), (), (), problem.records, problem, None, start, noise=known)


def fit_toy(selection):
    """The problem with splines over the contacts, and the fit of the reference model."""
    fitted = selection.fit((), [{}], selection.start, None, tolerance=1e-6)
    assert fitted is not None
    return selection.span(fitted.solution), fitted


def assert_rate(count: int, draws: int, rate: float):
    """As many of the draws as chance has it, within four standard deviations."""
    assert abs(count - draws * rate) < 4.0 * np.sqrt(draws * rate * (1.0 - rate)) + 1.0, (count, draws, rate)
