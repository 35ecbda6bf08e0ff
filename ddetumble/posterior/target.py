r"""What is sampled: a posterior density over a few coordinates, whatever fit of the toolkit it comes from.

The nuisances of a campaign's records are integrated out. For record g with whitened residual $r_g(x, z)$ and nuisances
$z \sim N(0, 1)$ in units of their deviations,

$$ p(y_g | x) \propto \int e^{-|r_g(x, z)|^2/2 - |z|^2/2} dz . $$

Where $r_g$ is linear in $z$ over the width of the integrand, with slope $Z$ at any point $z_0$,

$$ \ln p = -\tfrac12 (|r|^2 + |z_0|^2 - g^T A^{-1} g) - \tfrac12 \ln |A|, \quad A = 1 + Z^T Z, \quad g = Z^T r + z_0 $$

exactly. $z_0$ is where the linearised fit expects the best $z$, so that a model that is nearly linear is met close to
its optimum. Where it is not linear, the integral is the mean of importance weights over a fixed set of points drawn
from that Gaussian (common random numbers: a smooth function of $x$).
"""

import dataclasses as dc
import hashlib
import json
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.scipy.linalg as jsl
import numpy as np
from jaxtyping import Array
from scipy import optimize, stats

from .._errors import InputError
from .._numerics import map_threads
from ..contact.transform import TRANSFORMS
from ..inference.bounded import Bounded, solve_bounded
from ..inference.curve_fit import Curve, CurveFit
from ..inference.files import make_plain
from ..inference.findings import Fit
from ..inference.identifiability import Knowledge, analyse_fit
from ..inference.parameters import ParameterSpace
from ..inference.problem import FAILED, Problem, Solution, evaluate, simulate_records
from ..inference.stack import Records, Stack, trim_records
from ..measurement.grouping import group_conditions, name_conditions


POINTS = 16  # of the importance sampling of a record's nuisances
TRIALS = 24  # draws from the fit's Gaussian at which linearity is judged
CURVED = 0.05  # standard deviation, over these, of what the linear integral is off by: beyond it nuisances are sampled
FROZEN = ("base", "centre", "own", "slope", "nodes")


class Plan(eqx.Module):
    """What the likelihood needs beside the parameters: arrays only, so that it is an argument of compiled programs.

    Attributes:
        stack: the records.
        base: coordinates of all parameters of the space at the fit, shape (parameters,).
        directions: rows of the identity that belong to the free parameters, shape (free, parameters).
        low, high: limits of the model, shape (parameters,).
        centre: coordinates of the free parameters at the fit, shape (free,).
        own: best nuisances at the fit, shape (records, nuisances).
        slope: change of these by the free coordinates, shape (records, nuisances, free).
        nodes: standard normal points of the importance sampling, shape (points, nuisances); no points: linear.
        constant: normalisation of each record's Gaussian, shape (records,).
    """

    stack: Stack
    base: Array
    directions: Array
    low: Array
    high: Array
    centre: Array
    own: Array
    slope: Array
    nodes: Array
    constant: Array


class Integral(NamedTuple):
    """One record's (or many records') integral over the nuisances.

    Attributes:
        value: logarithm of the likelihood, -inf where the model failed.
        mean: of the nuisances given the parameters, shape (..., nuisances).
        factor: Cholesky factor of their precision $A$, shape (..., nuisances, nuisances).
    """

    value: Array
    mean: Array
    factor: Array


def draw_nodes(count: int, dimension: int, seed: int = 0) -> np.ndarray:
    """Standard normal points, evenly spread (scrambled Sobol, with their mirror images), shape (count, dimension)."""
    if not count:
        return np.zeros((0, dimension))
    half = stats.qmc.Sobol(dimension, rng=np.random.default_rng(seed)).random(count // 2)
    points = stats.norm.ppf(np.clip(half, 1e-9, 1 - 1e-9))
    return np.concatenate([points, -points])


def _integrate(space, names, channels, x: Array, plan: Plan) -> Integral:
    """All records at one point x, shape (free,)."""
    stack, rows = plan.stack, plan.stack.time.shape[0]
    count = plan.base.shape[0]
    shift = x - plan.centre
    base = jnp.broadcast_to(plan.base + shift @ plan.directions, (rows, count))
    start = plan.own + jnp.einsum("gkp,p->gk", plan.slope, shift)
    start = jnp.clip(jnp.where(jnp.isfinite(start), start, 0.0), -8.0, 8.0) * stack.present[:, None]
    at = evaluate(space, names, channels, jnp.zeros(0), start, stack, base, jnp.zeros((0, count)), plan.low, plan.high)
    size = start.shape[1]
    corner = jnp.eye(size) + jnp.einsum("grk,grl->gkl", at.own, at.own)
    gradient = jnp.einsum("grk,gr->gk", at.own, at.residual) + start
    factor = jnp.linalg.cholesky(corner)
    step = jax.vmap(lambda f, b: jsl.cho_solve((f, True), b))(factor, gradient)
    half = jnp.sum(jnp.log(jnp.diagonal(factor, axis1=-2, axis2=-1)), axis=-1)
    mean = start - step
    square = jnp.sum(at.residual**2, axis=1) + jnp.sum(start**2, axis=1) - jnp.sum(gradient * step, axis=1)
    value = -0.5 * square
    failed = at.failed
    if plan.nodes.shape[0]:
        def weigh(node):
            offset = jax.vmap(lambda f: jsl.solve_triangular(f, node, trans=1, lower=True))(factor)
            z = mean + offset
            residual, bad = simulate_records(space, names, channels, z, stack, base, plan.low, plan.high)[:2]
            here = -0.5 * (jnp.sum(residual**2, axis=1) + jnp.sum(z**2, axis=1)) + 0.5 * jnp.sum(node**2)
            return jnp.where(bad, -0.5 * FAILED**2, here)

        weights = jax.lax.map(weigh, plan.nodes)
        value = jax.scipy.special.logsumexp(weights, axis=0) - jnp.log(plan.nodes.shape[0])
    value = jnp.where(failed | ~jnp.isfinite(value), -jnp.inf, value - half + plan.constant)
    return Integral(jnp.where(stack.present > 0, value, 0.0), mean, factor)


@partial(jax.jit, static_argnums=(0, 1, 2))
def integrate_nuisances(space, names, channels, x: Array, plan: Plan) -> Integral:
    """Likelihood of every record at many points.

    Args:
        space: of the parameters.
        names: of the nuisances.
        channels: that are measured.
        x: coordinates of the free parameters, shape (points, free).
        plan: everything else.

    Returns:
        The integrals, shapes (points, records, ...).
    """
    return jax.lax.map(lambda one: _integrate(space, names, channels, one, plan), x)


def map_blocks(function: Callable[..., Any], size: int, *arrays: np.ndarray) -> Any:
    """A compiled function of many points in blocks of one size, so that one program serves them all.

    Args:
        function: of arrays to arrays, the first axis of all of them the points.
        size: of a block; fewer points go as they are.
        arrays: its arguments.
    """
    def run(block):
        return jax.tree.map(np.asarray, function(*map(jnp.asarray, block)))

    count = len(arrays[0])
    if count <= size:
        return run(arrays)
    padded = [np.concatenate([a, np.repeat(a[-1:], -count % size, axis=0)]) for a in arrays]
    parts = map_threads(run, zip(*(np.split(a, len(a) // size) for a in padded), strict=True))
    return jax.tree.map(lambda *part: np.concatenate(part)[:count], *parts)


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

    @property
    @abstractmethod
    def title(self) -> str:
        """What is sampled, in words."""

    @property
    def costly(self) -> bool:
        """Whether each point costs as much as those of a sampled integral."""
        return False

    def group_parts(self) -> tuple[np.ndarray, list[dict[str, float]]]:
        """Number of the condition of every part, shape (parts,), and mean settings of every condition, SI."""
        return np.arange(len(self.parts)), [{} for _ in self.parts]

    @abstractmethod
    def fit_without(self, out: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """Coordinates and their covariance by a fit without some parts, shapes (free,) and (free, free).

        Args:
            out: which parts are left out, shape (parts,).

        Returns:
            None where the fit fails, or the rest says nothing about a parameter.
        """

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
        return np.stack([TRANSFORMS[kind].from_unconstrained(np.asarray(x[..., k]))
                         for k, kind in enumerate(self.coordinates)], axis=-1)

    def slope(self) -> np.ndarray:
        """Derivative of the public values by the coordinates at the fit, shape (free, free)."""
        step = 1e-4 * np.diag(np.sqrt(np.diag(self.covariance)))
        return (self.publish(self.centre + step) - self.publish(self.centre - step)).T / (2 * np.diag(step))


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
        run = partial(integrate_nuisances, self.space, self.records.nuisances, self.records.channels, plan=self.plan)
        return map_blocks(run, TRIALS, np.asarray(x, dtype=float))

    def likelihoods(self, x: np.ndarray) -> np.ndarray:
        """As the base class has it; parts are records."""
        return np.asarray(self.integrate(x).value)

    @property
    def title(self) -> str:
        """As the base class has it."""
        return f"{self.fit.model_text}, sampled from {self.fit.campaign}"

    @property
    def costly(self) -> bool:
        """As the base class has it: nuisances are sampled."""
        return self.plan.nodes.shape[0] > 0

    def group_parts(self) -> tuple[np.ndarray, list[dict[str, float]]]:
        """As the base class has it."""
        groups = group_conditions(self.fit.source.records)
        return groups, name_conditions(self.fit.source.records, groups)

    def fit_without(self, out: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """As the base class has it."""
        problem, found = self.fit.problem, self.fit.bounded
        weights = np.array(problem.records.stack.weights)
        weights[: len(out)][out] = 0.0
        stack = eqx.tree_at(lambda s: s.weights, problem.records.stack, jnp.asarray(weights))
        less = Problem(problem.space, dc.replace(problem.records, stack=stack), problem.priors)
        again = solve_bounded(less, list(found.names), found.solution.u, found.solution.z, found.bounds, 1e-2)
        if again.solution.failed:
            return None
        _, known = know_fit(less, again)
        room = self.high - self.low
        if any(not np.isfinite(room[self.names.index(name)]) for name in known.undetermined):
            return None
        covariance = cap_covariance(known.covariance, room)
        if not np.all(np.isfinite(covariance)):
            return None
        places = [problem.space.index[name] for name in self.names]
        return again.solution.u[places], covariance


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
    places = [full.index[name] for name in names]
    low, high = np.array([found.room(problem, name) for name in names]).T
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
                "bounds": {k: list(v) for k, v in found.bounds.items() if np.any(np.isfinite(v))},
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
    at = problem.solve(found.names, found.solution.u, found.solution.z, moving=False)
    return at, analyse_fit(problem.space, at)


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


@final
@dc.dataclass(frozen=True, eq=False)
class CurveTarget(AbstractTarget):
    """Posterior of the coefficients of a curve with independent Gaussian errors.

    Attributes:
        rows: whitened residual of coordinates and data, in JAX; lives at the top of a module.
        data: whatever `rows` takes.
        weight: logarithm of a further factor of the prior, of coordinates and data; None for one.
        values: public values from coordinates and data; None where each coordinate gives its own.
        labels: number of the part to which every row belongs, shape (rows,); None where the curve is one part.
    """

    rows: Callable[[Array, Any], Array]
    data: Any
    weight: Callable[[Array, Any], Array] | None = None
    values: Callable[[Array, Any], Array] | None = None
    labels: np.ndarray | None = None

    def prior(self, x: np.ndarray) -> np.ndarray:
        """As the base class has it, times the further factor."""
        total = super().prior(x)
        return total if self.weight is None else total + np.asarray(_map(self.weight, jnp.asarray(x), self.data))

    def likelihoods(self, x: np.ndarray) -> np.ndarray:
        """As the base class has it, with densities of whitened readings; parts are those of `labels`."""
        if self.labels is None:
            return np.asarray(_square(self.rows, jnp.asarray(x), self.data, None, 1))
        constant = -0.5 * np.log(2 * np.pi) * np.bincount(self.labels, minlength=len(self.parts))
        return np.asarray(_square(self.rows, jnp.asarray(x), self.data, jnp.asarray(self.labels),
                                  len(self.parts))) + constant

    @property
    def title(self) -> str:
        """As the base class has it."""
        return str(self.identity.get("title", "a curve"))

    def fit_without(self, out: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """As the base class has it."""
        if self.labels is None:
            return None
        keep = ~out[self.labels]
        priors = [(self.names.index(name), mean, sd) for name, (mean, sd) in self.priors.items()]

        def rows(x: Any):
            more = jnp.array([(x[k] - mean) / sd for k, mean, sd in priors])
            return jnp.concatenate([self.rows(x, self.data)[keep], more])

        start = np.clip(self.centre, self.low, self.high)
        slope: Any = jax.jit(jax.jacfwd(rows))
        bend: Any = lambda x: np.asarray(slope(jnp.asarray(x)))
        found = optimize.least_squares(lambda x: np.asarray(rows(jnp.asarray(x))), start, x_scale=np.sqrt(np.diag(
            self.covariance)), jac=bend, bounds=(self.low, self.high))
        information = found.jac.T @ found.jac
        scale = 1.0 / np.sqrt(np.maximum(np.diag(information), 1e-300))
        if np.linalg.cond(information * np.outer(scale, scale)) > 1e12:
            return None
        return found.x, np.linalg.inv(information * np.outer(scale, scale)) * np.outer(scale, scale)

    def publish(self, x: np.ndarray) -> np.ndarray:
        """As the base class has it."""
        if self.values is None:
            return super().publish(x)
        flat = jnp.asarray(x).reshape(-1, np.shape(x)[-1])
        return np.asarray(_map(self.values, flat, self.data)).reshape(np.shape(x))


@eqx.filter_jit
def _square(rows, x: Array, data: Any, labels: Array | None, count: int) -> Array:
    value = jax.vmap(lambda one: -0.5 * rows(one, data) ** 2)(x)
    if labels is None:
        value = value.sum(axis=1, keepdims=True)
    else:
        value = jnp.zeros((x.shape[0], count)).at[:, labels].add(value)
    return jnp.where(jnp.isfinite(value), value, -jnp.inf)


@eqx.filter_jit
def _map(function, x: Array, data: Any) -> Array:
    return jax.vmap(lambda one: function(one, data))(x)


def digest(content: Any) -> str:
    """SHA-256 of plain data."""
    return hashlib.sha256(json.dumps(make_plain(content), sort_keys=True).encode()).hexdigest()


def pose_curve(rows: Callable[[Array, Any], Array], data: Any, names, centre, covariance, *, units=None,
               coordinates=None, bounds: Mapping[str, tuple[float, float]] | None = None,
               priors: Mapping[str, tuple[float, float]] | None = None, identity: Mapping[str, Any] | None = None,
               parts: Sequence[Any] | None = None) -> CurveTarget:
    """The posterior of a curve's coefficients.

    Args:
        rows: whitened residual, `rows(x, data)` with x of shape (free,), in JAX.
        data: an array or a tuple of them.
        names: of the coefficients.
        centre, covariance: of the coordinates by a fit.
        units, coordinates: of each coefficient; nothing and `linear` where not given.
        bounds: of coordinates by name.
        priors: Gaussian (mean, sd) of coordinates by name.
        identity: plain data that tells this target from others.
        parts: label of the part to which each row belongs, shape (rows,): what can be left out together.
    """
    names, count = tuple(names), len(names)
    low, high = np.full(count, -np.inf), np.full(count, np.inf)
    for name, (a, b) in (bounds or {}).items():
        low[names.index(name)], high[names.index(name)] = a, b
    centre, covariance = np.asarray(centre, dtype=float), np.asarray(covariance, dtype=float)
    if not np.all(np.isfinite(covariance)):
        raise InputError("the readings do not determine every coefficient, so that there is no posterior to draw from; "
                         "hold one of them, or give bounds and a finite covariance")
    known = ["curve"] if parts is None else list(dict.fromkeys(parts))
    labels = None if parts is None else np.array([known.index(one) for one in parts])
    return CurveTarget(names, tuple(units or ("",) * count), tuple(coordinates or ("linear",) * count), centre,
                       covariance, low, high, dict(priors or {}), tuple(map(str, known)), dict(identity or {}), (),
                       rows, data, labels=labels)


def pose_curve_fit(found: CurveFit) -> CurveTarget:
    """The posterior of a friction curve's coefficients; flat in these, in the logarithm of what is positive.

    It is sampled in the internal coordinates of the fit, in which valleys are straight, with the volume's change as a
    factor. The prior ends far outside the intervals of the profile likelihood, five of their widths away.

    Raises:
        InputError: The readings do not bound a coefficient, so that there is no posterior.
    """
    curve, data = found.curve, found.data
    loose = [p.name for p in found.profiles if not all(p.bounded)]
    if loose or not found.profiles:
        why = f"the readings do not bound {', '.join(loose)}" if loose else "the fit was made without profiles"
        raise InputError(f"there is no posterior to draw from: {why}; hold what is loose, or add readings")
    low, high = (curve.to_coordinates(np.array(ends)) for ends in zip(*((p.low, p.high) for p in found.profiles),
                                                                      strict=True))
    box = jnp.asarray([low - 5.0 * (high - low), high + 5.0 * (high - low)])
    centre = np.asarray(curve.fold(jnp.asarray(found.values), data))
    columns = np.asarray(jax.jacfwd(lambda x: _whiten(curve, x, data))(jnp.asarray(centre)))
    norms = np.linalg.norm(columns, axis=0)
    covariance = np.linalg.pinv((columns / norms).T @ (columns / norms), rcond=1e-12) / np.outer(norms, norms)
    values = np.concatenate([np.ravel(np.asarray(leaf)) for leaf in jax.tree.leaves(data)])
    made = pose_curve(partial(_whiten, curve), data, curve.names, centre, covariance, units=curve.units,
                      identity={"title": found.subject, "fixed": dict(found.fixed), "data": digest(values.tolist())})
    return dc.replace(made, weight=partial(_weigh_box, curve, box), values=curve.unfold, notes=(
        "the prior is flat in each coefficient, in the logarithm of what is positive",))


def _whiten(curve: Curve, x: Array, data: Any) -> Array:
    return curve.predict(curve.unfold(x, data), data)


def _weigh_box(curve: Curve, box: Array, x: Array, data: Any) -> Array:
    """Change of volume from internal coordinates to those in which the prior is flat; nothing outside its box."""
    flat = lambda x: curve.to_coordinates(curve.unfold(x, data), jnp)
    inside = jnp.all((flat(x) > box[0]) & (flat(x) < box[1]))
    return jnp.where(inside, jnp.linalg.slogdet(jax.jacfwd(flat)(x))[1], -jnp.inf)
