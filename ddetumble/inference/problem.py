"""The compiled model: residuals, Jacobian and Levenberg-Marquardt of many records in one program.

All parameters of a space are present; a fit moves a few of them. Each record's nuisances (conditions, time origin) are
unknowns with their stated uncertainty as prior, eliminated by the bordered structure of the normal equations.
"""

import abc
import contextlib
import dataclasses as dc
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextvars import ContextVar
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array

from .._errors import ComputationError
from .._numerics import map_threads
from .._settings import reserve_memory
from .levenberg_marquardt import BorderedLevenbergMarquardt, eliminate_nuisances
from .parameters import AbstractSpace, ParameterSpace
from .programs import call_kept
from .stack import COSINE, SINE, ZERO, Records, Stack, is_added


FAILED = 1e4
FAINT = 1e-6  # of derivatives by coordinates in their scales: below it, rounding and the integrator's tolerance
STEPS, MORE_STEPS = 30, 300  # of a fit at most; values cost little a step, and the valleys of a few of them are long
BLOCK = 3_000_000  # numbers of a Jacobian up to which two are computed side by side
MIDWAY, COPIES = 8, 4  # times the memory of one record's that is taken on the way; and times that of the whole Jacobian


_taken: ContextVar[list[int] | None] = ContextVar("taken", default=None)


@contextlib.contextmanager
def count_steps() -> Iterator[list[int]]:
    """Collect the number of steps of every solution that is computed inside, starts and refinements alike."""
    counted: list[int] = []
    token = _taken.set(counted)
    try:
        yield counted
    finally:
        _taken.reset(token)


class Evaluation(eqx.Module):
    """Model and Jacobian at one point, of all rows and slots of a stack; as in `Solution`, with `failed` (records,)."""

    residual: Array
    shared: Array
    own: Array
    channels: Array
    state: Array
    state_rate: Array
    end: Array
    failed: Array


FOUND = (0, 0, Evaluation(*[jnp.zeros(())] * 8), 0, 0)  # what `_solve` returns, to know its structure


def observe_record(space, names, channels, theta, z, row, base, directions, low, high):
    """Channels of one record, shape (channels, samples), and what else the simulation says.

    A parameter that leaves its limits stays at them, and the fit goes on with the others. Where a trial is not finite,
    the record counts as failed, and what is simulated is where the fit began.
    """
    u = base + theta @ directions
    outside = ~(jnp.all(jnp.isfinite(u)) & jnp.all(jnp.isfinite(z)))
    u = jnp.where(outside, base, jnp.clip(u, low, high))
    z = jnp.where(outside, 0.0, z)
    law, conditions, time, zeros, shifts = space.build(u), dict(row.conditions), row.time, [], {}
    for common, per_unit in zip(space.commons, row.inputs.get("common", ()), strict=False):
        shift = shifts[common.column] = u[space.index[common.slot.name]] * per_unit
        if common.column == "time":
            time = time - shift
        elif common.column in conditions:
            conditions[common.column] = conditions[common.column] + shift
    for name, shift in zip(names, z * row.condition_sd, strict=True):
        if name == "time":
            time = time - shift
        elif is_added(name):
            zeros.append((*name.split(":"), shift))
        else:
            conditions[name] = conditions[name] + shift
    found = space.family.observe(law, conditions, time, row, channels)
    model = found.channels
    for common in space.commons:
        if common.column in channels and common.column in shifts:
            k = channels.index(common.column)
            model = model.at[k].add(shifts[common.column] * (model[k] if common.relative else 1.0))
    late = row.time - row.time[0]
    for kind, channel, size in zeros:
        shape = jnp.ones_like(late) if kind == ZERO else late / late[-1]
        if kind.startswith((SINE, COSINE)):
            turns = row.inputs["hum"][int(kind.split("-")[1])] * row.time
            shape = jnp.sin(turns) if kind.startswith(SINE) else jnp.cos(turns)
        model = model.at[channels.index(channel)].add(size * shape)
    return model, (found.state, found.state_rate, found.end, found.failed | outside)


@partial(jax.jit, static_argnums=(0, 1, 2))
def evaluate(space, names, channels, theta, z, stack: Stack, base, directions, low, high) -> Evaluation:
    """Residual, Jacobian and channels of all records.

    Compiled on its own so that the optimiser, which asks for it in several places, traces it once. One record after
    the other: so each of the loops in time is one kernel, and what is only on the way takes no more than one record.
    """
    count, own = theta.shape[0], z.shape[1]

    def one(x):
        own_row, row, start = x

        def f(a, b):
            return observe_record(space, names, channels, a, b, dc.replace(row, rtol=stack.rtol), start, directions,
                                  low, high)

        model, jacobian, (state, rate, end, failed) = jax.vmap(
            lambda e: jax.jvp(f, (theta, own_row), (e[:count], e[count:]), has_aux=True),
            out_axes=(None, -1, None))(jnp.eye(count + own))
        failed = failed | ~jnp.all(jnp.isfinite(model))
        columns = whiten_columns(row, failed, jnp.concatenate([(model - row.values)[..., None], jacobian], axis=-1))
        residual = jnp.where(failed, FAILED, columns[:, 0])
        return Evaluation(residual, columns[:, 1: count + 1], columns[:, count + 1:], model, state, rate, end, failed)

    return _map_present(one, z, stack, base)


def simulate_records(space, names, channels, z, stack: Stack, base, low, high) -> tuple[Array, Array, Array]:
    """The model without derivatives: whitened residual, shape (records, rows); which records failed; channels."""
    none, still = jnp.zeros(0), jnp.zeros((0, base.shape[1]))

    def one(x):
        own_row, row, start = x
        model, (*_, failed) = observe_record(space, names, channels, none, own_row, dc.replace(row, rtol=stack.rtol),
                                             start, still, low, high)
        failed = failed | ~jnp.all(jnp.isfinite(model))
        return whiten_columns(row, failed, (model - row.values)[..., None])[:, 0], failed, model

    return _map_present(one, z, stack, base)


def _map_present(one, z, stack: Stack, base):
    """`one` of every record; zeros where there is none."""
    one, everything = jax.jit(one), (z, dc.replace(stack, rtol=None), base)  # jitted, so that it is traced once
    absent = jax.eval_shape(one, jax.tree.map(lambda a: a[0], everything))

    def skip(_):
        return jax.tree.map(lambda a: jnp.zeros(a.shape, a.dtype), absent)

    return jax.lax.map(lambda x: jax.lax.cond(x[1].present > 0, one, skip, x), everything)


def whiten_columns(row: Stack, failed: Array, columns: Array) -> Array:
    """Columns over samples of one record whitened, shape (rows, columns); 0 where it failed."""
    # Without the barrier the compiler computes the whole model again for every tap of the filter.
    columns = jax.lax.optimization_barrier(columns)
    columns = jnp.where(~failed & jnp.isfinite(columns), columns, 0.0)
    count, size = row.taps.shape[-1], columns.shape[1]
    # Padded once, and for good: slices of it cost half of what a padding a tap would.
    late = jax.lax.optimization_barrier(jnp.pad(columns, ((0, 0), (count, 0), (0, 0))))
    for k in range(count):
        columns = columns - row.taps[..., k, None] * late[:, count - k - 1: count - k - 1 + size]
    return (columns * row.weights[..., None]).reshape(-1, columns.shape[-1])


@partial(jax.jit, static_argnums=(0, 1, 2))
def _solve(space, names, channels, stack, base, directions, low, high, prior_mean, prior_weight, z0, moving,
           tolerance, max_steps):
    """Levenberg-Marquardt by optimistix; `moving` 0 evaluates at the start only."""
    count = directions.shape[0]

    def compute(theta, z):
        at = evaluate(space, names, channels, moving * theta, z0 + moving * z, stack, base, directions, low, high)
        # All that the normal equations need of a record's rows, in as few as it has columns: the optimiser keeps
        # several copies of what it is given.
        factor = jnp.linalg.qr(jnp.concatenate([at.own, at.shared, at.residual[..., None]], axis=-1), mode="r")
        own_prior = (z0 + moving * z) * stack.present[:, None]
        shared_prior = (moving * theta - prior_mean) * prior_weight
        return (factor[..., -1], own_prior, shared_prior), at, factor[..., :-1]

    @jax.custom_jvp
    def model(theta, z):
        return compute(theta, z)[:2]

    @model.defjvp
    def _(primals, tangents):
        theta_dot, z_dot = tangents
        value, at, factor = compute(*primals)
        theta_dot, z_dot = moving * theta_dot, moving * z_dot
        both = jnp.concatenate([z_dot, jnp.broadcast_to(theta_dot, (z_dot.shape[0], count))], axis=1)
        change = (jnp.einsum("grk,gk->gr", factor, both), z_dot * stack.present[:, None], theta_dot * prior_weight)
        still = jax.tree.map(lambda x: jnp.zeros_like(x) if jnp.issubdtype(x.dtype, jnp.floating) else
                             np.zeros(x.shape, dtype=jax.dtypes.float0), at)
        return (value, at), (change, still)

    solver = BorderedLevenbergMarquardt(tolerance, max_steps)
    start = (jnp.zeros((count,)), jnp.zeros_like(z0))
    found = optx.least_squares(lambda y, _: model(*y), solver, start, has_aux=True, max_steps=None, throw=False)
    theta, z = found.value
    converged = (found.result == optx.RESULTS.successful) & solver.has_converged(found.state)
    return moving * theta, z0 + moving * z, found.aux, converged, found.stats["num_steps"]


class Added(NamedTuple):
    """Further columns of every record fitted along with everything else, to first order; see `Solution.fit_more`."""

    gain: float  # of the sum of squares
    found: np.ndarray  # coefficients, shape (records, columns)
    error: np.ndarray  # their standard errors, shape (records, columns)


@dc.dataclass(frozen=True)
class Solution:
    """A fit of some parameters of the space, with everything linear algebra needs afterwards (numpy arrays)."""

    names: tuple[str, ...]  # free parameters, in the order of the columns
    u: np.ndarray  # coordinates of all parameters, shape (parameters,)
    z: np.ndarray  # nuisances in units of their deviations, shape (records, nuisances)
    scales: np.ndarray  # of the free coordinates: columns of `shared` are derivatives by coordinate/scale
    residual: np.ndarray  # whitened, shape (records, rows)
    shared: np.ndarray  # its derivative by the free parameters in units of their scales, shape (records, rows, free)
    own: np.ndarray  # by the nuisances in units of their deviations, shape (records, rows, nuisances)
    channels: np.ndarray  # model, shape (records, channels, samples), SI
    # state, state_rate: what a misfit is located in, shape (records, samples): depression and its rate [m, m/s] of
    # impacts, slip since the stroke began and its signed speed of slip records.
    state: np.ndarray
    state_rate: np.ndarray
    end: np.ndarray  # of the contact, or of the record, in the independent variable, shape (records,)
    # prior_residual, prior_weight: prior rows of the free parameters.
    prior_residual: np.ndarray
    prior_weight: np.ndarray
    chi2: float  # sum of squares of all rows
    # converged, steps, failed: state of the optimiser; keys of failed records.
    converged: bool
    steps: int
    failed: tuple[str, ...]

    def projected(self, shared: np.ndarray | None = None, right: np.ndarray | None = None,
                  more: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Columns and right-hand side with each record's nuisances eliminated; rows are data, then nuisance priors.

        `shared`, shape (records, data rows, columns), and `right`, shape (records, rows), are those of the fit where
        not given; `more`, shape (records, rows, columns), is eliminated too.
        """
        records, _, own = self.own.shape
        shared = self.shared if shared is None else shared
        rows = np.concatenate([self.own, np.broadcast_to(np.eye(own), (records, own, own))], axis=1)
        return eliminate_nuisances(np.concatenate([shared, np.zeros((records, own, shared.shape[2]))], axis=1),
                           rows if more is None else np.concatenate([rows, more], axis=2),
                           np.concatenate([self.residual, self.z], axis=1) if right is None else right)

    def adjust_own(self, record: int, rows, step: np.ndarray) -> np.ndarray:
        """Change of a record's nuisances that suits its `rows` best, under their priors, after a step of the free
        parameters, in units of their scales."""
        own = self.own[record]
        moved = self.residual[record] + self.shared[record] @ step
        columns = np.concatenate([own[rows], np.eye(own.shape[1])])
        right = np.concatenate([moved[rows], self.z[record]])
        scale = np.linalg.norm(columns, axis=0)
        return np.linalg.lstsq(columns / scale, -right, rcond=1e-12)[0] / scale

    def fit_more(self, more: np.ndarray) -> Added:
        """Fit further columns of the residual with coefficients of every record's own, along with everything else.

        `more` has shape (records, data rows, columns); there is no prior on its coefficients.
        """
        records, _, own = self.own.shape
        free, wide = self.shared.shape[2], more.shape[2]
        extra = np.concatenate([more, np.zeros((records, own, wide))], axis=1)
        columns, side = self.projected(more=extra)
        step = np.zeros(free)
        if free:
            step = np.linalg.lstsq(columns.reshape(-1, free), -side.ravel(), rcond=1e-10)[0]
            side = side + columns @ step
        right = np.concatenate([self.residual, self.z], axis=1)
        gain = float(np.sum(right**2) - np.sum(side**2))
        right[:, : more.shape[1]] += self.shared @ step
        prior = np.broadcast_to(np.eye(own), (records, own, own))
        both = np.concatenate([np.concatenate([self.own, prior], axis=1), extra], axis=2)
        size = np.maximum(np.linalg.norm(both, axis=1, keepdims=True), 1e-300)
        scaled = both / size
        inverse = np.linalg.pinv(np.swapaxes(scaled, 1, 2) @ scaled, rcond=1e-12)
        last = slice(both.shape[2] - wide, None)
        found = -np.einsum("gij,gkj,gk->gi", inverse, scaled, right)[:, last] / size[:, 0, last]
        variance = np.maximum(np.diagonal(inverse, axis1=1, axis2=2)[:, last], 0.0)
        return Added(gain, found, np.sqrt(variance) / size[:, 0, last])

    def widen(self, name: str, column: np.ndarray, weight: float = 0.0) -> "Solution":
        """The same with one further free parameter at 0: the derivative of the residual by it, shape (records, data
        rows), and one over its prior standard deviation."""
        return dc.replace(
            self, names=(*self.names, name), u=np.append(self.u, 0.0), scales=np.append(self.scales, 1.0),
            shared=np.concatenate([self.shared, column[:, :, None]], axis=2),
            prior_residual=np.append(self.prior_residual, 0.0), prior_weight=np.append(self.prior_weight, weight))

    def step(self) -> tuple[np.ndarray, np.ndarray]:
        """Gauss-Newton step of the free parameters, and their standard deviations, each in units of their scales, shape
        (free,)."""
        flat, right = self.flattened()
        norms = np.maximum(np.linalg.norm(flat, axis=0), FAINT)
        flat = flat / norms
        step = np.linalg.lstsq(flat, -right, rcond=1e-12)[0] / norms
        return step, np.sqrt(np.maximum(np.diag(np.linalg.pinv(flat.T @ flat, rcond=1e-12)), 0.0)) / norms

    def flattened(self) -> tuple[np.ndarray, np.ndarray]:
        """`projected` rows of all records with the priors below: columns, shape (rows, free), and right-hand side."""
        columns, right = self.projected()
        return (np.concatenate([columns.reshape(-1, columns.shape[2]), np.diag(self.prior_weight)]),
                np.concatenate([right.reshape(-1), self.prior_residual]))

    def common_shift(self) -> float:
        """Shift of the time origin that all records share [s]; 0 where none is fitted."""
        if "time_shift" not in self.names:
            return 0.0
        k = self.names.index("time_shift")  # its prior is centred on 0
        return float(self.prior_residual[k] * self.scales[k] / self.prior_weight[k])

    def covariance(self) -> np.ndarray:
        """Covariance of the free coordinates, shape (free, free); vast and finite along what nothing fixes."""
        flat, _ = self.flattened()
        norms = np.maximum(np.linalg.norm(flat, axis=0), FAINT)
        # A pseudo-inverse would give no variance at all to what the records do not determine.
        _, s, rows = np.linalg.svd(flat / norms, full_matrices=False)
        spread = rows.T / np.maximum(s, FAINT) * (self.scales / norms)[:, None]
        return spread @ spread.T


class AbstractProblem(abc.ABC):
    """Least squares over some parameters, with the nuisances of records beside them."""

    space: AbstractSpace
    scales: np.ndarray  # typical change of each coordinate, shape (parameters,)
    limits: tuple[np.ndarray, np.ndarray]  # of the coordinates, each shape (parameters,)

    @abc.abstractmethod
    def solve(self, free: Sequence[str], start: np.ndarray, z: np.ndarray | None = None, *, moving: bool = True,
              tolerance: float = 1e-7, max_steps: int | None = None) -> Solution:
        """Fit the `free` parameters, and all nuisances, from the coordinates `start`, as `Problem.solve` does."""

    @abc.abstractmethod
    def is_whole(self, solution: Solution) -> bool:
        """Whether a solution is of all samples, not of a part of them."""

    def keep_inside(self, u: np.ndarray, columns: Sequence[int]) -> np.ndarray:
        """Coordinates, those of `columns` a little inside their limits: who starts at a limit would never leave it."""
        u, (low, high) = np.array(u, dtype=float), self.limits
        inside = np.minimum(1e-3 * self.scales, 0.25 * (high - low))[columns]
        u[..., columns] = np.clip(u[..., columns], low[columns] + inside, high[columns] - inside)
        return u


class Problem(AbstractProblem):
    """Records and a space of parameters, ready to be fitted.

    `priors` are Gaussian, by parameter name, as (mean, sd) of the coordinate, beside those of the errors that all
    records share.
    """

    space: ParameterSpace

    def __init__(self, space: ParameterSpace, records: Records,
                 priors: Mapping[str, tuple[float, float]] | None = None):
        commons = space.commons if "common" in records.stack.inputs else ()
        self.space, self.records = space, records
        self.priors = {c.slot.name: (0.0, c.sd) for c in commons} | dict(priors or {})
        self.scales = space.scales()
        self.limits = space.bounds()

    def is_whole(self, solution: Solution) -> bool:
        """Whether a solution is of all samples, not of thinned records."""
        return solution.residual.shape[1] == np.prod(self.records.stack.weights.shape[1:])

    def columns(self, wanted: Sequence[tuple[Sequence[str], np.ndarray]], z: np.ndarray, spare: int = 0) -> np.ndarray:
        """Whitened derivatives by coordinates, in units of their scales, without moving.

        `wanted` are names and the point (coordinates of all parameters) for each; `z` the nuisances. Returns one array
        a name, in their order: shape (names of all together, records, rows + spare), the spare rows zero.
        """
        few, rows = self.space.family.slots[0], self.records.stack.values[0].size
        jobs = [(names[first:first + few], u) for names, u in wanted for first in range(0, len(names), few)]
        firsts = np.cumsum([0, *(len(names) for names, _ in jobs)])
        found = np.zeros((firsts[-1], self.records.count, rows + spare))

        def fill(k):
            names, u = jobs[k]
            shared = self.solve(names, u, z, moving=False).shared
            found[firsts[k]: firsts[k + 1], :, :rows] = np.moveaxis(shared, 2, 0)

        # Two side by side take twice the memory on the way.
        apply = map if self.records.stack.values.size * few > BLOCK else map_threads
        list(apply(fill, range(len(jobs))))
        return found

    def solve(self, free: Sequence[str], start: np.ndarray, z: np.ndarray | None = None, *, moving: bool = True,
              tolerance: float = 1e-7, max_steps: int | None = None) -> Solution:
        """Fit the `free` parameters (names) and all nuisances from the coordinates `start`.

        Args:
            free: names of the parameters that move.
            start: coordinates, shape (parameters,), or one row a record, shape (records, parameters).
            z: start of the nuisances, shape (records, nuisances); those that are new begin at 0.
            moving: False evaluates residual and Jacobian at the start only.
            tolerance: ends where chi-square is expected to fall by less.
            max_steps: after which the fit counts as not converged; where not given, `STEPS`, of values `MORE_STEPS`.
        """
        stack, count = self.records.stack, self.records.count
        most = max_steps if max_steps is not None else MORE_STEPS if self.records.are_values else STEPS
        slots = next(s for s in self.space.family.slots if len(free) <= s)
        numbers = stack.values.size * (slots + len(self.records.nuisances) + 1)
        need = 8.0 * (COPIES * numbers + MIDWAY * numbers // len(stack.present))
        columns = [self.space.index[name] for name in free]
        directions, scales = np.zeros((slots, len(self.space))), self.scales[columns]
        directions[np.arange(len(free)), columns] = scales
        start = self.keep_inside(start, columns)
        more = len(stack.present) - count
        base = np.broadcast_to(start, (count, len(self.space)))
        base = np.concatenate([base, np.broadcast_to(base[:1], (more, len(self.space)))])
        space = self.space.thin_out(free, base)
        z0 = np.zeros((count + more, len(self.records.nuisances)))
        if z is not None:
            z0[:count, : z.shape[1]] = z
        mean, weight = np.zeros(slots), np.where(np.arange(slots) < len(free), 0.0, 1.0)
        for k, name in enumerate(free):
            if name in self.priors:
                centre, sd = self.priors[name]
                mean[k], weight[k] = (centre - np.ravel(base)[columns[k]]) / scales[k], scales[k] / sd
        static = (space, self.records.nuisances, self.records.channels)
        name = None if space.text is None else repr((space.text, *static[1:]))
        what = f"a fit of {slots} columns to {int(self.records.lengths.sum()):,} samples"
        try:
            with reserve_memory(need, what):
                theta, z_new, at, converged, steps = jax.block_until_ready(call_kept(
                    _solve, static, name, FOUND, stack, base, directions, *self.limits, mean, weight, z0,
                    np.asarray(float(moving)), np.asarray(tolerance), np.asarray(most)))
        except (RuntimeError, ValueError) as error:
            if "RESOURCE_EXHAUSTED" in str(error) or "Out of memory" in str(error):
                raise MemoryError(f"{what} needs more than the machine has") from error
            # diffrax differentiates its event through a linear solve that refuses overflow, from inside the program.
            if "callback" not in str(error).lower():
                raise
            raise ComputationError(f"the fit of {', '.join(free) or 'nothing'} broke down: the model could not be "
                                   "integrated on the way; start nearer, or bound the parameters") from error
        taken = _taken.get()
        if taken is not None:
            taken.append(int(steps))
        theta, z_new = np.asarray(theta)[: len(free)], np.asarray(z_new)[:count]
        found = jax.tree.map(lambda x: np.asarray(x)[:count], at)
        u = np.array(base[0])
        u[columns] = np.clip(u[columns] + scales * theta, self.limits[0][columns], self.limits[1][columns])
        prior = (theta - mean[: len(free)]) * weight[: len(free)]
        failed = tuple(k for k, bad in zip(self.records.keys, found.failed, strict=True) if bad)
        with np.errstate(over="ignore"):  # of a fit that went astray it may be infinite
            chi2 = float(np.sum(found.residual**2) + np.sum(z_new**2) + np.sum(prior**2))
        return Solution(
            tuple(free), u, z_new, scales, found.residual, found.shared[:, :, : len(free)], found.own, found.channels,
            found.state, found.state_rate, found.end, prior, weight[: len(free)], chi2, bool(converged) and not failed,
            int(steps), failed)


def shift_clocks(records: Records, solution: Solution) -> np.ndarray:
    """By how much a fit took first touch to be later than each record's clock says, shape (records,), s."""
    shift = np.full(records.count, solution.common_shift())
    if "time" in records.nuisances:
        k = records.nuisances.index("time")
        shift += solution.z[:, k] * np.asarray(records.stack.condition_sd)[: records.count, k]
    return shift


def replace_arrays(problem: Problem, **arrays) -> Problem:
    """The same problem with other arrays in its stack: programs are shared."""
    new = {name: x if name == "conditions" else jnp.asarray(x) for name, x in arrays.items()}
    records = dc.replace(problem.records, stack=dc.replace(problem.records.stack, **new))
    return type(problem)(problem.space, records, problem.priors)


def settle(problem: Problem, names: tuple[str, ...], u: np.ndarray, z: np.ndarray) -> Solution:
    """Nuisances fitted with all parameters held, and the derivatives there."""
    still = problem.solve((), u, z, tolerance=1e-2)
    return problem.solve(names, u, still.z, moving=False)


def mask_records(problem: Problem, gone: Collection[int]) -> Problem:
    """The same records, some without weight."""
    weights = np.asarray(problem.records.stack.weights).copy()
    weights[list(gone)] = 0.0
    return replace_arrays(problem, weights=weights)
