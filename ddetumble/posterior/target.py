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
from scipy import optimize

from .._errors import ComputationError, InputError
from .._numerics import map_threads
from ..contact.transform import TRANSFORMS
from ..inference import distributions as stats
from ..inference.bounded import Bounded, solve_bounded
from ..inference.findings import Fit
from ..inference.identifiability import analyse_fit
from ..inference.parameters import ParameterSpace
from ..inference.problem import FAILED, Problem, Solution, evaluate, simulate_records
from ..inference.stack import Records, Stack, trim_records
from ..measurement.campaign import group_conditions, name_conditions
from ..measurement.quantities import format_number


POINTS = 16  # of the importance sampling of a record's nuisances: the proposal is close, and cost grows with them
TRIALS = 24  # draws from the fit's Gaussian at which linearity is judged: a standard deviation to about 15 %
# Standard deviation, over these, of what the linear integral is off by in the log-likelihood: beyond it nuisances are
# sampled; below, 5 % in density.
CURVED = 0.05
# Share of a posterior's draws that lie further below its best density than those at which linearity is judged: of draws
# from the fit's Gaussian, which may leave a bent valley for where nobody will be, and of a posterior's own.
BEYOND, BEYOND_OWN = 0.5, 1e-4
FEWEST = 4  # draws within reach, from which on their standard deviation says anything
WIDTHS = (1.0, 0.5, 0.25, 0.1, 0.01)  # of the fit's Gaussian, in turn, until so many are
TOO_UNCERTAIN = ("the model cannot be computed at draws from the fit's Gaussian: the fit is too uncertain to sample "
                 "from; add priors or bounds, or fix a parameter")


class Plan(eqx.Module):
    """What the likelihood needs beside the parameters: arrays only, so that it is an argument of compiled programs."""

    stack: Stack  # the records
    base: Array  # coordinates of all parameters of the space at the fit, shape (parameters,)
    directions: Array  # rows of the identity that belong to the free parameters, shape (free, parameters)
    low: Array  # limits of the model, shape (parameters,)
    high: Array
    centre: Array  # coordinates of the free parameters at the fit, shape (free,)
    own: Array  # best nuisances at the fit, shape (records, nuisances)
    slope: Array  # change of these by the free coordinates, shape (records, nuisances, free)
    nodes: Array  # standard normal points of the importance sampling, shape (points, nuisances); no points: linear
    constant: Array  # normalisation of each record's Gaussian, shape (records,)


class Integral(NamedTuple):
    """Integrals over the nuisances of records."""

    value: Array  # logarithm of the likelihood, -inf where the model failed, shape (points, records)
    mean: Array  # of the nuisances given the parameters, shape (points, records, nuisances)
    factor: Array  # Cholesky factor of their precision A, shape (points, records, nuisances, nuisances)


@partial(jax.jit, static_argnums=(0, 1, 2))
def _integrate(space, names, channels, x: Array, plan: Plan) -> Integral:
    """Likelihood of every record at many points of the free coordinates, shape (points, free)."""
    stack, count = plan.stack, plan.base.shape[0]
    rows, size = plan.own.shape
    nothing = jnp.zeros(0), jnp.zeros((0, count))

    def integrate(point):
        shift = point - plan.centre
        base = jnp.broadcast_to(plan.base + shift @ plan.directions, (rows, count))
        start = plan.own + jnp.einsum("gkp,p->gk", plan.slope, shift)
        start = jnp.clip(jnp.where(jnp.isfinite(start), start, 0.0), -8.0, 8.0) * stack.present[:, None]
        at = evaluate(space, names, channels, nothing[0], start, stack, base, nothing[1], plan.low, plan.high)
        factor = jnp.linalg.cholesky(jnp.eye(size) + jnp.einsum("grk,grl->gkl", at.own, at.own))
        gradient = jnp.einsum("grk,gr->gk", at.own, at.residual) + start
        step = jax.vmap(lambda f, b: jsl.cho_solve((f, True), b))(factor, gradient)
        half = jnp.sum(jnp.log(jnp.diagonal(factor, axis1=-2, axis2=-1)), axis=-1)
        mean = start - step
        value = -0.5 * (jnp.sum(at.residual**2, axis=1) + jnp.sum(start**2, axis=1) - jnp.sum(gradient * step, axis=1))
        if plan.nodes.shape[0]:
            def weigh(node):
                z = mean + jax.vmap(lambda f: jsl.solve_triangular(f, node, trans=1, lower=True))(factor)
                residual, bad = simulate_records(space, names, channels, z, stack, base, plan.low, plan.high)[:2]
                here = -0.5 * (jnp.sum(residual**2, axis=1) + jnp.sum(z**2, axis=1)) + 0.5 * jnp.sum(node**2)
                return jnp.where(bad, -0.5 * FAILED**2, here)

            weights = jax.lax.map(weigh, plan.nodes)
            value = jax.scipy.special.logsumexp(weights, axis=0) - jnp.log(plan.nodes.shape[0])
        value = jnp.where(at.failed | ~jnp.isfinite(value), -jnp.inf, value - half + plan.constant)
        return Integral(jnp.where(stack.present > 0, value, 0.0), mean, factor)

    return jax.lax.map(integrate, x)


def map_blocks(function: Callable[..., Any], size: int, *arrays: np.ndarray) -> Any:
    """A compiled function of many points, the first axis of its arrays, in blocks of one size: one program for all."""
    def run(block):
        return jax.tree.map(np.asarray, function(*map(jnp.asarray, block)))

    count = len(arrays[0])
    if count <= size:
        return run(arrays)
    padded = [np.concatenate([a, np.repeat(a[-1:], -count % size, axis=0)]) for a in arrays]
    parts = map_threads(run, zip(*(np.split(a, len(a) // size) for a in padded), strict=True))
    return jax.tree.map(lambda *part: np.concatenate(part)[:count], *parts)


@dc.dataclass(frozen=True, eq=False, kw_only=True)
class AbstractTarget(ABC):
    """A posterior density."""

    title: str  # what is sampled, in words
    names: tuple[str, ...]  # of the parameters
    units: tuple[str, ...]
    coordinates: tuple[str, ...]  # `linear`, `log`, `logit` or `inverse`; priors are flat in these where none is given
    centre: np.ndarray  # coordinates of the fit, shape (free,)
    covariance: np.ndarray  # of the coordinates by the fit, shape (free, free)
    low: np.ndarray  # limits of the coordinates, shape (free,)
    high: np.ndarray
    priors: Mapping[str, tuple[float, float]]  # Gaussian (mean, sd) of coordinates by name
    parts: tuple[str, ...]  # what the likelihood is a product over: keys of the records
    groups: np.ndarray  # number of the condition of every part, shape (parts,)
    conditions: Sequence[Mapping[str, float]]  # mean settings of every condition, SI
    identity: Mapping[str, Any]  # what makes this target, for those who go on with a chain: plain data
    notes: tuple[str, ...] = ()  # sentences on how it is computed
    caveats: tuple[str, ...] = ()  # and on what it leaves out, however it is
    costly: bool = False  # whether each point costs as much as those of a sampled integral

    @abstractmethod
    def likelihoods(self, x: np.ndarray) -> np.ndarray:
        """Logarithm of the likelihood of every part, shape (points, free) to (points, parts); -inf where it failed."""

    @abstractmethod
    def fit_without(self, out: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """Coordinates and their covariance by a fit without some parts, shapes (free,) and (free, free), `out` of shape
        (parts,); None where the fit fails, or the rest says nothing about a parameter.
        """

    def derive(self, x: np.ndarray) -> dict[str, tuple[np.ndarray, str]]:
        """What follows from the parameters at points of shape (points, free), by name: values of shape (points,), and
        their unit."""
        return {}

    def refine(self, draws: np.ndarray) -> "AbstractTarget":
        """The target itself, or a better one where it is off at draws of its own posterior, shape (draws, free)."""
        return self

    def prior(self, x: np.ndarray) -> np.ndarray:
        """Logarithm of the prior, shape (points, free) to (points,); -inf outside the limits."""
        total = np.zeros(len(x))
        for name, (mean, sd) in self.priors.items():
            total -= 0.5 * ((x[:, self.names.index(name)] - mean) / sd) ** 2 + np.log(sd * np.sqrt(2 * np.pi))
        return np.where(self.holds(x), total, -np.inf)

    def holds(self, x: np.ndarray) -> np.ndarray:
        """Whether points lie within the limits, shape (points, free) to (points,)."""
        return np.all((x >= self.low) & (x <= self.high), axis=1)

    def log_density(self, x: np.ndarray) -> np.ndarray:
        """Logarithm of prior times likelihood, shape (points, free) to (points,); never nan."""
        x = np.asarray(x, dtype=float)
        prior = self.prior(x)
        safe = np.where(np.isfinite(prior)[:, None], x, self.centre)
        total = prior + np.sum(self.likelihoods(safe), axis=1)
        return np.where(np.isnan(total), -np.inf, total)

    def publish(self, x: np.ndarray) -> np.ndarray:
        """Coordinates to values in the parameters' public units, any shape (..., free)."""
        x = np.asarray(x, dtype=float)
        return np.stack([TRANSFORMS[kind].from_unconstrained(np.asarray(x[..., k]))
                         for k, kind in enumerate(self.coordinates)], axis=-1)

    def draw_inside(self, rng: np.random.Generator, count: int, width: float = 1.0) -> np.ndarray:
        """Draws from the fit's Gaussian, made `width` times as wide, within the limits; shape (count, free).

        Raises:
            InputError: Hardly any of it lies within them.
        """
        factor = np.linalg.cholesky(self.covariance + 1e-14 * np.diag(np.diag(self.covariance)))
        found = np.zeros((0, len(self.names)))
        for _ in range(200):
            x = self.centre + width * rng.standard_normal((4 * count, len(self.names))) @ factor.T
            found = np.concatenate([found, x[np.all((x > self.low) & (x < self.high), axis=1)]])
            if len(found) >= count:
                return found[:count]
            width *= 0.9
        raise InputError("hardly any of the Gaussian of the fit lies within the bounds; widen them, or start the fit "
                         "elsewhere")


@final
@dc.dataclass(frozen=True, eq=False, kw_only=True)
class CampaignTarget(AbstractTarget):
    """Posterior of a model fitted to a campaign, each record's nuisances integrated out; parts are records."""

    fit: Fit  # it comes from
    space: ParameterSpace  # the reference model with the effects of the fit alone
    records: Records  # stacked, without padding beyond a few samples
    plan: Plan  # arrays of the likelihood
    curved: float = 0.0  # by how much the linear integral is off from point to point, in logarithms of the likelihood

    def integrate(self, x: np.ndarray) -> Integral:
        """The integrals over every record's nuisances at points of shape (points, free); many go in blocks."""
        run = partial(_integrate, self.space, self.records.nuisances, self.records.channels, plan=self.plan)
        return map_blocks(run, TRIALS, np.asarray(x, dtype=float))

    def likelihoods(self, x: np.ndarray) -> np.ndarray:
        """As the base class has it."""
        return np.asarray(self.integrate(x).value)

    def derive(self, x: np.ndarray) -> dict[str, tuple[np.ndarray, str]]:
        """As the base class has it: what the reference model tells beside its parameters, as far as it moves."""
        def build(point):
            return self.space.build(self.plan.base + (point - self.plan.centre) @ self.plan.directions).reference

        units = {name: unit for name, (_, unit) in build(self.plan.centre).derive().items()}
        if not units:
            return {}
        values = np.asarray(jax.vmap(lambda point: jnp.stack([value for value, _ in build(point).derive().values()]))(
            jnp.asarray(x)))
        return {name: (own, unit) for (name, unit), own in zip(units.items(), values.T, strict=True) if np.ptp(own) > 0}

    def refine(self, draws: np.ndarray) -> AbstractTarget:
        """As the base class has it: nuisances are sampled where the linear integral turns out to be off."""
        if self.plan.nodes.shape[0] or not np.any(np.asarray(self.records.stack.condition_sd) > 0):
            return self
        return self.compare_integrals(draws[np.linspace(0, len(draws) - 1, TRIALS).astype(int)], BEYOND_OWN) or self

    def compare_integrals(self, x: np.ndarray, beyond: float = BEYOND) -> "CampaignTarget | None":
        """The target with linear or with sampled nuisances, whichever is right at those of the points, shape (points,
        free), that are no further below its best density than all but a share of a posterior's; None for too few.
        """
        # Evenly spread points (scrambled Sobol) with their mirror images.
        sobol = stats.qmc.Sobol(self.plan.own.shape[1], rng=np.random.default_rng(0)).random(POINTS // 2)
        half = stats.norm.ppf(np.clip(sobol, 1e-9, 1 - 1e-9))
        nodes = jnp.asarray(np.concatenate([half, -half]))
        sampled = dc.replace(self, plan=eqx.tree_at(lambda p: p.nodes, self.plan, nodes), costly=True)
        points = np.concatenate([x, self.centre[None]])
        linear, better = self.log_density(points), sampled.log_density(points)
        # Where either has any density: one that is wrongly high would draw the chains there.
        within = np.maximum(linear - linear.max(), better - better.max()) > -0.5 * stats.chi2.isf(beyond, x.shape[1])
        within &= np.isfinite(linear) & np.isfinite(better)
        if np.sum(within) < FEWEST:
            return None
        curved = float(np.std((better - linear)[within]))
        if curved > CURVED:
            return dc.replace(sampled, curved=curved, notes=(
                f"each record's nuisances were integrated out by importance sampling with {POINTS} points, because a "
                f"linear treatment has an error of {curved:.2g} (standard deviation) in the log-likelihood",))
        return dc.replace(self, curved=curved, notes=(
            "each record's nuisances were integrated out analytically, as the model is nearly linear in them (the "
            f"error of the log-likelihood has a standard deviation of {curved:.1g})",))

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
        _, covariance, loose = _know_fit(less, again, self.high - self.low)
        if loose or not np.all(np.isfinite(covariance)):
            return None
        return again.solution.u[[problem.space.index[name] for name in self.names]], covariance


def _know_fit(problem: Problem, found: Bounded, room: np.ndarray) -> tuple[Solution, np.ndarray, list[str]]:
    """Derivatives by all free parameters at a fit, their covariance, and names of those that nothing bounds.

    No deviation exceeds a quarter of the room between finite limits.
    """
    at = problem.solve(found.names, found.solution.u, found.solution.z, moving=False)
    known = analyse_fit(problem.space, at)
    shrink = np.minimum(1.0, np.where(np.isfinite(room), 0.25 * room, np.inf) / np.sqrt(np.diag(known.covariance)))
    loose = [name for name, own in zip(found.names, room, strict=True)
             if name in known.undetermined and not np.isfinite(own)]
    return at, known.covariance * np.outer(shrink, shrink), loose


def pose_fit(fit: Fit) -> CampaignTarget:
    """Build the log-posterior of a fit to a campaign.

    Whether a record's nuisances can be integrated as if the model were linear in them is tried at draws from the fit's
    Gaussian; where not, they are sampled.

    Raises:
        InputError: The records determine nothing about a parameter that has no prior: there is no posterior.
        ComputationError: The model cannot be computed near the fit.
    """
    problem, found, solution = fit.problem, fit.bounded, fit.bounded.solution
    full, names, u = problem.space, found.names, solution.u
    low, high = np.array([found.room(problem, name) for name in names]).T
    at, covariance, loose = _know_fit(problem, found, high - low)
    if loose:  # an effect's parameter first: it may be what the reference model's cannot be told from
        raise InputError(f"the records contain no information on {min(loose, key=lambda n: '.' not in n)}, so there "
                         "is no posterior to sample; give it a prior or bounds (in fit.toml: [priors], [bounds]), or "
                         "fix it ([fixed])")
    # The same reference model with those effects only that are in the model or not at their null.
    moved = {s.owner for k, s in enumerate(full.slots) if s.parameter.kind != "shape" and u[k] != s.parameter.default}
    space = ParameterSpace(full.reference, [e for e in full.effects if e.id in fit.effects or e.id in moved],
                           full.commons)
    records = trim_records(problem.records)
    places, columns = [full.index[n] for n in space.index], [space.index[n] for n in names]
    corner = np.eye(at.own.shape[2]) + np.einsum("grk,grl->gkl", at.own, at.own)
    slope = -np.linalg.solve(corner, np.einsum("grk,grj->gkj", at.own, at.shared)) / at.scales
    weights = np.asarray(records.stack.weights)
    logs = np.where(weights > 0, np.log(np.where(weights > 0, weights, 1.0)) - 0.5 * np.log(2 * np.pi), 0.0)
    plan = Plan(records.stack, *map(jnp.asarray, (
        u[places], np.eye(len(places))[columns].reshape(len(columns), len(places)),
        *(limit[places] for limit in problem.limits), u[places][columns], solution.z, slope,
        np.zeros((0, solution.z.shape[1])), logs.sum(axis=(1, 2)))))
    identity = {"campaign": fit.campaign, "sha256": fit.sha256, "model": fit.model, "effects": list(fit.effects),
                "names": list(names), "fixed": dict(fit.fixed), "priors": {k: list(v) for k, v in
                                                                            problem.priors.items()},
                "bounds": {k: list(v) for k, v in found.bounds.items() if np.any(np.isfinite(v))},
                "noise": {k: dc.asdict(v.without_sizes()) for k, v in fit.noise.items()},
                "specification": fit.settings.get("sha256")}
    groups = group_conditions(fit.source.records)
    most = format_number(max(fit.widened.values(), default=1.0), 2)
    caveats = () if not fit.widened else (
        "the noise along the records is taken as it was measured: intervals of the fit, which allow for what is not "
        f"known of it, are up to {most} times as wide as such noise makes them",)
    target = CampaignTarget(
        title=f"{fit.model_text}, sampled from {fit.campaign}", names=names,
        units=tuple(full.unit(n, u) for n in names),
        coordinates=tuple(full.slots[full.index[n]].parameter.coordinate for n in names),
        centre=u[[full.index[n] for n in names]], covariance=covariance, low=low, high=high, priors=problem.priors,
        parts=records.keys, groups=groups, conditions=name_conditions(fit.source.records, groups), identity=identity,
        caveats=caveats, fit=fit, space=space, records=records, plan=plan)  # fmt: skip
    return judge_linearity(target)


def judge_linearity(target: CampaignTarget) -> CampaignTarget:
    """Compare the linear integral with a sampled one at draws from the fit's Gaussian, and take what is right.

    Raises:
        ComputationError: The model cannot be computed near the fit.
    """
    if not np.any(np.asarray(target.records.stack.condition_sd) > 0):
        return dc.replace(target, notes=("conditions and time origins were taken as exact",))
    # Of a Gaussian that is far wider than a bent posterior, the inner part.
    for width in WIDTHS:
        found = target.compare_integrals(target.draw_inside(np.random.default_rng(0), TRIALS, width))
        if found is not None:
            return found
    raise ComputationError(TOO_UNCERTAIN)


@final
@dc.dataclass(frozen=True, eq=False, kw_only=True)
class CurveTarget(AbstractTarget):
    """Posterior of the coefficients of a curve with independent Gaussian errors."""

    rows: Callable[[Array, Any], Array]  # whitened residual of coordinates and data, in JAX; at the top of a module
    data: Any  # whatever `rows` takes
    labels: np.ndarray | None = None  # number of every row's part, shape (rows,); None where the curve is one part

    def likelihoods(self, x: np.ndarray) -> np.ndarray:
        """As the base class has it; where there are several parts, with the densities of whitened readings."""
        found = np.asarray(_square(self.rows, jnp.asarray(x), self.data, self.labels, len(self.parts)))
        if self.labels is None:
            return found
        return found - 0.5 * np.log(2 * np.pi) * np.bincount(self.labels, minlength=len(self.parts))

    def fit_without(self, out: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """As the base class has it."""
        if self.labels is None:
            return None
        keep = ~out[self.labels]
        priors = [(self.names.index(name), mean, sd) for name, (mean, sd) in self.priors.items()]

        def rows(x: Any):
            more = jnp.array([(x[k] - mean) / sd for k, mean, sd in priors])
            return jnp.concatenate([self.rows(x, self.data)[keep], more])

        value, slope = jax.jit(rows), jax.jit(jax.jacfwd(rows))
        jacobian: Any = lambda x: np.asarray(slope(x))
        found = optimize.least_squares(
            lambda x: np.asarray(value(x)), np.clip(self.centre, self.low, self.high), jacobian,
            (self.low, self.high), x_scale=np.sqrt(np.diag(self.covariance)))
        information = found.jac.T @ found.jac
        scale = 1.0 / np.sqrt(np.maximum(np.diag(information), 1e-300))
        if np.linalg.cond(information * np.outer(scale, scale)) > 1e12:
            return None
        return found.x, np.linalg.inv(information * np.outer(scale, scale)) * np.outer(scale, scale)


@eqx.filter_jit
def _square(rows, x: Array, data: Any, labels: np.ndarray | None, count: int) -> Array:
    value = jax.vmap(lambda one: -0.5 * rows(one, data) ** 2)(x)
    if labels is None:
        value = value.sum(axis=1, keepdims=True)
    else:
        value = jnp.zeros((x.shape[0], count)).at[:, labels].add(value)
    return jnp.where(jnp.isfinite(value), value, -jnp.inf)


def pose_curve(rows: Callable[[Array, Any], Array], data: Any, names, centre, covariance, *, units=None,
               coordinates=None, bounds: Mapping[str, tuple[float, float]] | None = None,
               priors: Mapping[str, tuple[float, float]] | None = None, identity: Mapping[str, Any] | None = None,
               parts: Sequence[Any] | None = None) -> CurveTarget:
    """Build the log-posterior of the coefficients of a curve.

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
    names, count, identity = tuple(names), len(names), dict(identity or {})
    limits = np.tile([-np.inf, np.inf], (count, 1))
    for name, ends in (bounds or {}).items():
        limits[names.index(name)] = ends
    covariance = np.asarray(covariance, dtype=float)
    if not np.all(np.isfinite(covariance)):
        raise InputError("the readings do not determine every coefficient, so there is no posterior to sample; "
                         "hold one of them, or give bounds and a finite covariance")
    known = ["curve"] if parts is None else list(dict.fromkeys(parts))
    return CurveTarget(
        title=str(identity.get("title", "a curve")), names=names, units=tuple(units or ("",) * count),
        coordinates=tuple(coordinates or ("linear",) * count), centre=np.asarray(centre, dtype=float),
        covariance=covariance, low=limits[:, 0], high=limits[:, 1], priors=dict(priors or {}),
        parts=tuple(map(str, known)), groups=np.arange(len(known)), conditions=[{}] * len(known), identity=identity,
        rows=rows, data=data, labels=None if parts is None else np.array([known.index(one) for one in parts]),
    )  # fmt: skip
