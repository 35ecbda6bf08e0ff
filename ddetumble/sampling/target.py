"""What is sampled: a posterior density over a few coordinates, whatever fit of the toolkit it comes from."""

import dataclasses as dc
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .._errors import InputError
from .._numerics import map_threads
from ..inference.bounded import Bounded, linearise_all
from ..inference.findings import Fit
from ..inference.identifiability import Knowledge, analyse_columns
from ..inference.parameters import ParameterSpace, to_public
from ..inference.problem import Problem, Solution
from ..inference.stack import Records, trim_records
from .marginal import Integral, Plan, draw_nodes, integrate_nuisances


POINTS = 16  # of the importance sampling of a record's nuisances
TRIALS = 24  # draws from the fit's Gaussian at which linearity is judged
CURVED = 0.05  # standard deviation, over these, of what the linear integral is off by: beyond it nuisances are sampled
FROZEN = ("base", "centre", "own", "slope", "nodes")


@dc.dataclass(frozen=True, eq=False)
class AbstractTarget(ABC):
    """A posterior density.

    Attributes:
        names, units: of the parameters.
        coordinates: kind of each: `linear`, `log`, `logit` or `inverse`; priors are flat in these where none is given.
        centre: coordinates of the fit, shape (free,).
        covariance: of the coordinates by the fit, shape (free, free).
        low, high: limits of the coordinates, shape (free,).
        priors: Gaussian (mean, sd) of coordinates by name.
        parts: what the likelihood is a product over: keys of the records.
        identity: what makes this target, for those who go on with a chain: plain data.
        notes: sentences.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    coordinates: tuple[str, ...]
    centre: np.ndarray
    covariance: np.ndarray
    low: np.ndarray
    high: np.ndarray
    priors: Mapping[str, tuple[float, float]]
    parts: tuple[str, ...]
    identity: Mapping[str, Any]
    notes: tuple[str, ...]

    @abstractmethod
    def likelihoods(self, x: np.ndarray) -> np.ndarray:
        """Logarithm of the likelihood of every part, shape (points, free) to (points, parts); -inf where it failed."""

    def prior(self, x: np.ndarray) -> np.ndarray:
        """Logarithm of the prior, shape (points, free) to (points,); -inf outside the limits."""
        total = np.zeros(len(x))
        for name, (mean, sd) in self.priors.items():
            total -= 0.5 * ((x[:, self.names.index(name)] - mean) / sd) ** 2 + np.log(sd * np.sqrt(2 * np.pi))
        inside = np.all((x >= self.low) & (x <= self.high), axis=1)
        return np.where(inside, total, -np.inf)

    def log_density(self, x: np.ndarray) -> np.ndarray:
        """Logarithm of prior times likelihood, shape (points, free) to (points,); never nan."""
        x = np.asarray(x, dtype=float)
        prior = self.prior(x)
        safe = np.where(np.isfinite(prior)[:, None], x, self.centre)
        total = prior + np.sum(self.likelihoods(safe), axis=1)
        return np.where(np.isnan(total), -np.inf, total)

    def freeze(self) -> dict[str, np.ndarray]:
        """The numbers that a chain depends on beside the data, which another fit might give in other last digits."""
        return {"centre": self.centre, "covariance": self.covariance}

    def thaw(self, arrays: Mapping[str, np.ndarray]) -> "AbstractTarget":
        """The target with those numbers."""
        return dc.replace(self, centre=arrays["centre"], covariance=arrays["covariance"])

    def publish(self, x: np.ndarray) -> np.ndarray:
        """Coordinates to values in the parameters' public units, any shape (..., free)."""
        x = np.asarray(x, dtype=float)
        columns = [np.vectorize(lambda u, k=kind: to_public(k, u), otypes=[float])(x[..., k])
                   if kind in ("inverse",) else _publish(kind, x[..., k]) for k, kind in enumerate(self.coordinates)]
        return np.stack(columns, axis=-1)

    def slope(self) -> np.ndarray:
        """Derivative of the public values by the coordinates at the fit, shape (free, free)."""
        step = 1e-4 * np.diag(np.sqrt(np.diag(self.covariance)))
        return (self.publish(self.centre + step) - self.publish(self.centre - step)).T / (2 * np.diag(step))


def _publish(kind: str, u: np.ndarray) -> np.ndarray:
    if kind == "log":
        return np.exp(u)
    return 1.0 / (1.0 + np.exp(-u)) if kind == "logit" else u


@final
@dc.dataclass(frozen=True, eq=False)
class CampaignTarget(AbstractTarget):
    """Posterior of a model fitted to a campaign, each record's nuisances integrated out.

    Attributes:
        fit: it comes from.
        space: the reference model with the effects of the fit alone.
        records: stacked, without padding beyond a few samples.
        plan: arrays of the likelihood.
        curved: by how much the linear integral is off from point to point, in logarithms of the likelihood.
    """

    fit: Fit
    space: ParameterSpace
    records: Records
    plan: Plan
    curved: float

    def freeze(self) -> dict[str, np.ndarray]:
        """As the base class has it, with the plan's."""
        return {**super().freeze(), **{name: np.asarray(getattr(self.plan, name)) for name in FROZEN}}

    def thaw(self, arrays: Mapping[str, np.ndarray]) -> "CampaignTarget":
        """As the base class has it, with the plan's."""
        plan = dc.replace(self.plan, **{name: jnp.asarray(arrays[name]) for name in FROZEN})
        return dc.replace(self, centre=arrays["centre"], covariance=arrays["covariance"], plan=plan)

    def integrate(self, x: np.ndarray) -> Integral:
        """The integrals over every record's nuisances, shapes (points, records, ...); many points go in blocks."""
        names, channels = self.records.nuisances, self.records.channels
        x, size = np.asarray(x, dtype=float), len(x)
        if size > TRIALS:  # one size of block, one compiled program
            x = np.concatenate([x, np.repeat(x[-1:], -size % TRIALS, axis=0)])

        def run(block):
            found = integrate_nuisances(self.space, names, channels, jnp.asarray(block), self.plan)
            return jax.tree.map(np.asarray, found)

        blocks = np.split(x, max(1, len(x) // TRIALS) if len(x) > TRIALS else 1)
        if len(blocks) == 1:
            return run(x)
        parts = map_threads(run, blocks)
        return jax.tree.map(lambda *part: np.concatenate(part)[:size], *parts)

    def likelihoods(self, x: np.ndarray) -> np.ndarray:
        """As the base class has it; parts are records."""
        return np.asarray(self.integrate(x).value)


def pose_fit(fit: Fit) -> CampaignTarget:
    """The posterior of a campaign's fit.

    Whether a record's nuisances can be integrated as if the model were linear in them is tried at draws from the fit's
    Gaussian; where not, they are sampled.

    Raises:
        InputError: The records determine nothing about a parameter that has no prior: there is no posterior.
    """
    problem, found = fit.problem, fit.bounded
    full, names = problem.space, found.names
    at, known = know_fit(problem, found)
    limits = {name: found.bounds.get(name, (-np.inf, np.inf)) for name in names}
    ends = np.array([limits[name] for name in names])
    places = [full.index[name] for name in names]
    low = np.maximum(ends[:, 0], problem.limits[0][places])
    high = np.minimum(ends[:, 1], problem.limits[1][places])
    # An effect's parameter first: it may be what the reference model's cannot be told from.
    for k, name in sorted(enumerate(names), key=lambda one: "." not in one[1]):
        if name in known.undetermined and not np.isfinite(high[k] - low[k]):
            raise InputError(f"the records say nothing about {name}, so that there is no posterior to draw from; give "
                             "it a prior or bounds (in fit.toml: [priors], [bounds]), or fix it ([fixed])")
    slots = [full.slots[k].parameter for k in places]
    space = _slim(full, found.solution.u, fit.effects)
    records = trim_records(problem.records)
    plan = _plan(space, records, fit, at, names)
    identity = {"campaign": fit.campaign, "sha256": fit.sha256, "model": fit.model, "effects": list(fit.effects),
                "names": list(names), "fixed": dict(fit.fixed), "priors": {k: list(v) for k, v in
                                                                            problem.priors.items()},
                "bounds": {k: list(v) for k, v in limits.items() if np.any(np.isfinite(v))},
                "noise": {k: dc.asdict(v) for k, v in fit.noise.items()},
                "specification": fit.settings.get("sha256")}
    covariance = cap_covariance(known.covariance, high - low)
    target = CampaignTarget(names, tuple(full.unit(n, found.solution.u) for n in names),
                            tuple(p.coordinate for p in slots),
                            found.solution.u[places], covariance, low, high, problem.priors, records.keys, identity,
                            (), fit, space, records, plan, 0.0)
    return _judge(target)


def know_fit(problem: Problem, found: Bounded) -> tuple[Solution, Knowledge]:
    """Derivatives by all free parameters at a fit, held ones too, and what the records say of them."""
    at = linearise_all(problem, found.solution, found.names, found.solution.u)
    columns, _ = at.projected()
    flat = np.concatenate([columns.reshape(-1, len(found.names)), np.diag(at.prior_weight)])
    return at, analyse_columns(problem.space, found.names, flat, at.scales)


def cap_covariance(covariance: np.ndarray, room: np.ndarray) -> np.ndarray:
    """A covariance whose deviations do not exceed a quarter of the room between finite limits."""
    sd = np.sqrt(np.diag(covariance))
    shrink = np.minimum(1.0, np.where(np.isfinite(room), 0.25 * room, np.inf) / sd)
    return covariance * np.outer(shrink, shrink)


def _slim(space: ParameterSpace, u: np.ndarray, effects: tuple[str, ...]) -> ParameterSpace:
    """The same reference model with those effects only that are in the model or not at their null."""
    moved = {s.owner for k, s in enumerate(space.slots) if s.parameter.kind != "shape" and u[k] != s.parameter.default}
    return ParameterSpace(space.reference, [e for e in space.effects if e.id in effects or e.id in moved],
                          space.commons)


def _plan(space: ParameterSpace, records: Records, fit: Fit, at, names) -> Plan:
    full, solution = fit.problem.space, fit.bounded.solution
    u = np.array([solution.u[full.index[name]] for name in space.index])
    low, high = (np.array([b[full.index[name]] for name in space.index]) for b in fit.problem.limits)
    corner = np.eye(at.own.shape[2]) + np.einsum("grk,grl->gkl", at.own, at.own)
    side = np.einsum("grk,grj->gkj", at.own, at.shared)
    slope = -np.linalg.solve(corner, side) / at.scales
    weights = np.asarray(records.stack.weights)
    logs = np.where(weights > 0, np.log(np.where(weights > 0, weights, 1.0)) - 0.5 * np.log(2 * np.pi), 0.0)
    columns = [space.index[name] for name in names]
    arrays = (u, np.eye(len(u))[columns].reshape(len(columns), len(u)), low, high, u[columns], solution.z, slope,
              draw_nodes(0, solution.z.shape[1]), logs.sum(axis=(1, 2)))
    return Plan(records.stack, *(jnp.asarray(a) for a in arrays))


def _judge(target: CampaignTarget) -> CampaignTarget:
    """Compare the linear integral with a sampled one at draws from the fit's Gaussian."""
    still = not np.any(np.asarray(target.records.stack.condition_sd) > 0)
    if still:
        return dc.replace(target, notes=("conditions and time origins were taken as exact",))
    rng = np.random.default_rng(0)
    x = draw_inside(target, rng, TRIALS)
    nodes = jnp.asarray(draw_nodes(POINTS, target.plan.own.shape[1]))
    sampled = dc.replace(target, plan=eqx.tree_at(lambda p: p.nodes, target.plan, nodes))
    off = np.sum(sampled.likelihoods(x) - target.likelihoods(x), axis=1)
    off = off[np.isfinite(off)]
    curved = float(np.std(off)) if len(off) > 1 else np.inf
    if curved > CURVED:
        return dc.replace(sampled, curved=curved, identity={**target.identity, "nuisances": "sampled"}, notes=(
            f"each record's nuisances were integrated out by importance sampling with {POINTS} points: taken as "
            f"linear, the logarithm of the likelihood is off by {curved:.2g} from point to point",))
    return dc.replace(target, curved=curved, identity={**target.identity, "nuisances": "linear"}, notes=(
        "each record's nuisances were integrated out analytically, as the model is linear in them over their width "
        f"(the logarithm of the likelihood is off by {curved:.1g} from point to point)",))


def draw_inside(target: AbstractTarget, rng: np.random.Generator, count: int, width: float = 1.0) -> np.ndarray:
    """Draws from the fit's Gaussian, made `width` times as wide, within the limits; shape (count, free)."""
    factor = np.linalg.cholesky(target.covariance + 1e-14 * np.diag(np.diag(target.covariance)))
    found = np.zeros((0, len(target.names)))
    for _ in range(200):
        x = target.centre + width * rng.standard_normal((4 * count, len(target.names))) @ factor.T
        found = np.concatenate([found, x[np.all((x > target.low) & (x < target.high), axis=1)]])
        if len(found) >= count:
            return found[:count]
        width *= 0.9
    raise InputError("hardly any of the fit's Gaussian lies within the bounds; widen them, or start the fit elsewhere")
