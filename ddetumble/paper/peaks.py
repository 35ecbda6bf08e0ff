"""Models of peaks: one compiled program of simulated impacts, batched fits, leave-one-out errors, effects in turn."""

import dataclasses as dc
import itertools
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._numerics import stop
from ..contact.effect import AbstractEffect, parameters_of
from ..contact.law import AbstractReference, ContactLaw
from ..dynamics.impact import Impact, simulate_impact
from ..inference.parameters import ParameterSpace
from ..selection.detectability import reach_limit
from .rows import Noise, PeakRow, compare_rows, judge_gain, make_row, measure_cost


WINDOW = 0.27  # s, the paper's impact time: where the arm pushes on, the peak is sought up to here
SAMPLES = 128
CHUNK = 64  # impacts a call of the compiled program
DIRECTIONS = 4  # parameters that one model may free


def refine_peak(times: Array, values: Array) -> Array:
    """Maximum of a sampled curve: vertex of the parabola through the largest sample and its two neighbours.

    Args:
        times: ascending, any spacing, shape (times,) [s].
        values: shape (times,).

    Returns:
        The maximum, scalar; the largest sample itself where that is not an inner maximum. Differentiable with the
        samples that are used held fixed.
    """
    k = jnp.clip(jnp.argmax(stop(values)), 1, values.shape[0] - 2)
    t0, t1, t2 = times[k - 1], times[k], times[k + 1]
    f0, f1, f2 = values[k - 1], values[k], values[k + 1]
    left, right = (f1 - f0) / (t1 - t0), (f2 - f1) / (t2 - t1)
    bend = (right - left) / (t2 - t0)
    slope = left + bend * (t1 - t0)
    inner = (bend < 0) & (f1 >= f0) & (f1 >= f2)
    # Next to a jump (separation, a dashpot's onset) the parabola would overshoot: its step stays within half a sample.
    step = jnp.clip(jnp.where(inner, -slope / (2.0 * jnp.where(inner, bend, -1.0)), 0.0),
                    0.5 * (t0 - t1), 0.5 * (t2 - t1))
    return jnp.where(inner, f1 + slope * step + bend * step**2, jnp.maximum(f1, jnp.maximum(f0, f2)))


def peak_force(law: ContactLaw, conditions: Mapping[str, Array], window: Array) -> tuple[Array, tuple[Array, ...]]:
    """Largest force that the gauge reads in one impact [N], nan where the integration failed; beside it the time of
    separation [s] (the window where the ball still touches then), the ratio of rebound to approach speed [-] and the
    largest depression [m].

    Args:
        law: contact law.
        conditions: of the record, scalars, SI.
        window: time after first touch in which the peak is sought [s].
    """
    times = window * (jnp.arange(1, SAMPLES + 1) / SAMPLES) ** 2
    impact = simulate_impact(law, conditions, times, adjoint=dfx.ForwardMode(), rtol=1e-6, atol=1e-8, max_steps=160)
    peak = jnp.where(impact.failed, jnp.nan, refine_peak(times, impact.normal_force))
    return peak, (impact.separation, impact.rebound_speed / conditions["approach_speed"], jnp.max(impact.depression))


@eqx.filter_jit
def simulate_impacts(law: ContactLaw, conditions: Mapping[str, Any], times: Any) -> Impact:
    """Impacts at conditions of shape (records,), SI, each at the same times [s]: an `Impact` with a leading axis."""
    conditions = {name: jnp.asarray(value, dtype=float) for name, value in conditions.items()}
    return jax.vmap(lambda one: simulate_impact(law, one, jnp.asarray(times, dtype=float)))(conditions)


class PeakProgram:
    """Peaks of impacts, and their derivatives, for any values of the parameters of a reference model and its effects.

    Programs with equal parameter spaces share one compilation, whatever the number of records and models.

    Args:
        reference: template of the reference model.
        effects: classes of the effects that may be switched on.
        window: time in which the peak is sought [s].
    """

    def __init__(self, reference: AbstractReference, effects: Sequence[type[AbstractEffect]], window: float = WINDOW):
        self.space = ParameterSpace(reference, effects)
        self.window = float(window)
        self.start = self.space.coordinates()
        self.scale = self.space.scales()
        self.low, self.high = self.space.bounds()
        for k, slot in enumerate(self.space.slots):
            if slot.parameter.sign > 0:
                self.low[k] = max(self.low[k], slot.parameter.default)
            if slot.parameter.sign < 0:
                self.high[k] = min(self.high[k], slot.parameter.default)

    def place(self, values: Mapping[str, float]) -> np.ndarray:
        """Coordinates of all parameters with some values put in by name, shape (parameters,)."""
        return self.space.coordinates(values)

    def evaluate(self, x: np.ndarray, free: np.ndarray, conditions: Mapping[str, np.ndarray]) \
            -> tuple[np.ndarray, np.ndarray]:
        """Peaks and their derivatives by the free coordinates, for a batch of models on the same records.

        Args:
            x: coordinates, shape (batch, parameters).
            free: numbers of the free coordinates, shape (batch, DIRECTIONS); -1 for none.
            conditions: of the records, arrays of shape (records,), SI.

        Returns:
            Peaks, shape (batch, records) [N], and derivatives, shape (batch, records, DIRECTIONS) [N].
        """
        batch, records = len(x), len(next(iter(conditions.values())))
        owner, record = np.divmod(np.arange(batch * records), records)
        peaks, slopes = np.empty(batch * records), np.empty((batch * records, DIRECTIONS))
        for first in range(0, batch * records, CHUNK):
            take = np.minimum(np.arange(first, first + CHUNK), batch * records - 1)
            row = {name: np.asarray(value, dtype=float)[record[take]] for name, value in conditions.items()}
            some, slope, _ = _evaluate(self.space, x[owner[take]], free[owner[take]], row, self.window)
            kept = slice(first, min(first + CHUNK, batch * records))
            peaks[kept] = np.asarray(some)[: kept.stop - first]
            slopes[kept] = np.asarray(slope)[: kept.stop - first]
        return peaks.reshape(batch, records), slopes.reshape(batch, records, DIRECTIONS)

    def evaluate_contact(self, x: np.ndarray, conditions: Mapping[str, np.ndarray]) \
            -> tuple[np.ndarray, ...]:
        """Peaks [N], contact times [s], ratios of rebound to approach speed and largest depressions [m] of one model.

        Args:
            x: coordinates, shape (parameters,).
            conditions: of the records, arrays of shape (records,), SI.

        Returns:
            Four arrays of shape (records,).
        """
        records, parts = len(next(iter(conditions.values()))), []
        for first in range(0, records, CHUNK):
            take = np.minimum(np.arange(first, first + CHUNK), records - 1)
            row = {name: np.asarray(value, dtype=float)[take] for name, value in conditions.items()}
            peaks, _, others = _evaluate(self.space, np.tile(x, (CHUNK, 1)),
                                         np.full((CHUNK, DIRECTIONS), -1), row, self.window)
            parts.append(np.array([peaks, *others])[:, : records - first])
        return tuple(np.concatenate(parts, axis=1))


@partial(jax.jit, static_argnums=0)
def _evaluate(space: ParameterSpace, x: Array, free: Array, conditions: Mapping[str, Array], window: Array):
    """Peaks, shape (impacts,), derivatives, shape (impacts, DIRECTIONS), and what `peak_force` gives beside."""
    basis = (free[:, :, None] == jnp.arange(x.shape[1])).astype(x.dtype)

    def one(x, directions, record):
        def peak(x):
            return peak_force(space.build(x), record, window)

        return jax.vmap(lambda d: jax.jvp(peak, (x,), (d,), has_aux=True), out_axes=(None, 0, None))(directions)

    return jax.vmap(one)(x, basis, conditions)


@dc.dataclass(frozen=True)
class PeakFit:
    """One model fitted to peaks.

    Attributes:
        names: of the free parameters.
        x: coordinates of all parameters, shape (parameters,).
        model: peaks of the fit, shape (records,) [N].
        slopes: derivatives by the free coordinates, shape (records, free) [N].
        cost: sum of squared weighted residuals.
        converged: whether the steps died out.
        held: prediction of each record by a fit without it, shape (records,) [N]; nan where none was made.
        fold_x, fold_cost: coordinates, shape (records, parameters), and costs, shape (records,), of those fits.
    """

    names: tuple[str, ...]
    x: np.ndarray
    model: np.ndarray
    slopes: np.ndarray
    cost: float
    converged: bool
    held: np.ndarray
    fold_x: np.ndarray | None = None
    fold_cost: np.ndarray | None = None


@dc.dataclass(frozen=True)
class PeakData:
    """Peaks with their conditions and weights.

    Attributes:
        conditions: arrays of shape (records,), SI.
        peaks: measured, shape (records,) [N].
        weights: one over the standard deviation (or scale) of each, shape (records,) [1/N].
    """

    conditions: Mapping[str, np.ndarray]
    peaks: np.ndarray
    weights: np.ndarray


def minimise_batch(program: PeakProgram, data: PeakData, weights: np.ndarray, x: np.ndarray, free: np.ndarray,
                   most: int = 40) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    r"""Levenberg-Marquardt on a batch: minimise $\sum_i W_i^2 (F_i(x) - y_i)^2$ within each coordinate's limits.

    Args:
        program: peaks and derivatives.
        data: measured peaks.
        weights: $W$, shape (batch, records) [1/N]; 0 leaves a record out.
        x: starts, shape (batch, parameters).
        free: numbers of the free coordinates, shape (batch, DIRECTIONS), -1 for none.
        most: steps at most.

    Returns:
        Coordinates, peaks, derivatives, costs and whether each converged.
    """
    x, used, where = np.array(x, dtype=float), free >= 0, np.where(free >= 0, free, 0)
    model, slopes = program.evaluate(x, free, data.conditions)
    cost = _costs(model, data.peaks, weights)
    damping, done = np.full(len(x), 1e-3), np.zeros(len(x), dtype=bool)
    for _ in range(most):
        live = np.flatnonzero(~done)
        if not live.size:
            break
        residual = np.where(weights[live] > 0, weights[live] * (np.nan_to_num(model[live]) - data.peaks), 0.0)
        jacobian = weights[live][:, :, None] * np.nan_to_num(slopes[live]) * program.scale[where[live]][:, None, :]
        here = np.take_along_axis(x[live], where[live], axis=1)
        gradient = np.einsum("bnk,bn->bk", jacobian, residual)
        # A coordinate at its limit that wants to go further stays there.
        stuck = ((here <= program.low[where[live]]) & (gradient > 0)) | (
            (here >= program.high[where[live]]) & (gradient < 0))
        jacobian = np.where((stuck | ~used[live])[:, None, :], 0.0, jacobian)
        gradient = np.einsum("bnk,bn->bk", jacobian, residual)
        normal = np.einsum("bnk,bnl->bkl", jacobian, jacobian)
        size = np.einsum("bkk->bk", normal)
        ridge = damping[live][:, None] * np.maximum(size, 1e-9) + np.where(size > 0, 0.0, 1.0)
        step = -np.linalg.solve(normal + ridge[:, :, None] * np.eye(DIRECTIONS), gradient[..., None])[..., 0]
        step = np.clip(step, -3.0, 3.0)
        trial = x[live].copy()
        for k in range(DIRECTIONS):
            row = np.flatnonzero(used[live][:, k])
            column = free[live][row, k]
            moved = trial[row, column] + program.scale[column] * step[row, k]
            trial[row, column] = np.clip(moved, program.low[column], program.high[column])
        new_model, new_slopes = program.evaluate(trial, free[live], data.conditions)
        new_cost = _costs(new_model, data.peaks, weights[live])
        better, old = new_cost < cost[live], cost[live]
        take = live[better]
        x[take], model[take], slopes[take], cost[take] = (
            trial[better], new_model[better], new_slopes[better], new_cost[better])
        with np.errstate(invalid="ignore"):
            small = better & (old - new_cost < 1e-5 * old)
        done[live] = small | (np.abs(step).max(axis=1) < 1e-6) | (damping[live] > 1e7)
        damping[live] = np.where(better, np.maximum(damping[live] * 0.2, 1e-9), damping[live] * 8.0)
    return x, model, slopes, cost, done & np.isfinite(cost)


def fit_models(program: PeakProgram, data: PeakData,
               models: Sequence[tuple[Sequence[str], Sequence[Mapping[str, float]]]]) -> list[PeakFit]:
    """Fit several models to all records, each from several starts.

    Args:
        program: peaks and derivatives.
        data: measured peaks.
        models: for each the names of its free parameters, and its starts as values by name (a value of a parameter
            that is not free fixes it there).

    Returns:
        The best of the starts of each model, nothing held out yet.
    """
    starts, free, owner = [], [], []
    for k, (names, places) in enumerate(models):
        if len(names) > DIRECTIONS:
            raise ValueError(f"`fit_models` frees at most {DIRECTIONS} parameters of one model; got {len(names)}.")
        for place in places:
            starts.append(program.place(place))
            free.append(_number(program, names))
            owner.append(k)
    if not starts:
        return []
    starts, free, owner = np.array(starts), np.array(free), np.array(owner)

    def solve(x, free, most):
        weights = np.broadcast_to(data.weights, (len(x), len(data.weights)))
        return minimise_batch(program, data, weights, x, free, most)

    # A few steps from every start, and then the best start of each model to the end.
    x, _, _, cost, _ = solve(starts, free, 10)
    best = [int(mine[np.argmin(cost[mine])]) for mine in (np.flatnonzero(owner == k) for k in range(len(models)))]
    x, model, slopes, cost, done = solve(x[best], free[best], 50)
    fits = [PeakFit(tuple(names), x[k], model[k], slopes[k][:, : len(names)], float(cost[k]), bool(done[k]),
                    np.full(len(data.peaks), np.nan)) for k, (names, _) in enumerate(models)]
    return fits


def hold_out(program: PeakProgram, data: PeakData, fits: Sequence[PeakFit]) -> list[PeakFit]:
    """Leave every record out in turn, refit each model from its full fit, and predict the record.

    Args:
        program: peaks and derivatives.
        data: measured peaks.
        fits: models fitted to all records.

    Returns:
        The same fits with `held` filled in.
    """
    records = len(data.peaks)
    if not fits:
        return []
    fold = np.tile(data.weights * (1.0 - np.eye(records)), (len(fits), 1))
    x = np.repeat([fit.x for fit in fits], records, axis=0)
    free = np.repeat([_number(program, fit.names) for fit in fits], records, axis=0)
    x, model, _, cost, _ = minimise_batch(program, data, fold, x, free, most=20)
    model = np.where(np.isfinite(cost)[:, None], model, np.nan).reshape(len(fits), records, records)
    x, cost = x.reshape(len(fits), records, -1), cost.reshape(len(fits), records)
    return [dc.replace(fit, held=np.diagonal(model[k]).copy(), fold_x=x[k], fold_cost=cost[k])
            for k, fit in enumerate(fits)]


def _number(program: PeakProgram, names: Sequence[str]) -> list[int]:
    return [program.space.index[name] for name in names] + [-1] * (DIRECTIONS - len(names))


def _costs(model: np.ndarray, peaks: np.ndarray, weights: np.ndarray) -> np.ndarray:
    with np.errstate(invalid="ignore"):
        total = np.sum(np.where(weights > 0, (weights * (model - peaks)) ** 2, 0.0), axis=1)
    return np.where(np.isfinite(total), total, np.inf)


ATMOSPHERE = 101325.0  # Pa
VISIBLE = 0.05  # share of a parameter's signature that must survive for it to be fitted
FINALISTS = 8  # pairs of effects whose held-out errors are computed


@dc.dataclass(frozen=True)
class Recipe:
    """One model to fit: label, kind and effects as in `PeakRow`, free parameters, starts (values by name)."""

    label: str
    kind: str
    effects: tuple[str, ...]
    free: tuple[str, ...]
    starts: tuple[Mapping[str, float], ...] = ({},)


class Bench:
    """Peaks, the compiled program and the noise; makes rows of recipes.

    Attributes:
        free: reference parameters that are fitted.
        fixed: those that are not although they could be, with their values: the others absorb them.
        fits: the fit behind each row, by label.
    """

    def __init__(self, program: PeakProgram, data: PeakData, noise: Noise):
        self.program, self.data, self.noise = program, data, noise
        self.free: tuple[str, ...] = ()
        self.fixed: dict[str, float] = {}
        self.fits: dict[str, PeakFit] = {}

    def choose_free(self) -> None:
        """Free the reference parameters that these peaks can tell apart, in the order of the model's own list."""
        names = self.program.space.of([None])
        columns = self.sensitivities(self.program.start, names)
        basis = np.zeros((len(self.data.peaks), 0))
        for k, name in enumerate(names):
            size = np.linalg.norm(columns[:, k])
            rest = columns[:, k] - basis @ (basis.T @ columns[:, k])
            enough = size > 0 and np.linalg.norm(rest) > VISIBLE * size
            if enough and len(self.free) < min(DIRECTIONS - 1, len(self.data.peaks) - 2):
                basis = np.column_stack([basis, rest / np.linalg.norm(rest)])
                self.free += (name,)
            else:
                parameter = self.program.space.slots[self.program.space.index[name]].parameter
                self.fixed[name] = parameter.default

    def sensitivities(self, x: np.ndarray, names: Sequence[str]) -> np.ndarray:
        """Derivatives of the weighted peaks by coordinates in typical sizes, shape (records, names)."""
        numbers = [self.program.space.index[name] for name in names]
        found = []
        for first in range(0, len(numbers), DIRECTIONS):
            some = numbers[first: first + DIRECTIONS]
            free = np.array([some + [-1] * (DIRECTIONS - len(some))])
            _, slopes = self.program.evaluate(x[None], free, self.data.conditions)
            found.append(np.nan_to_num(slopes[0])[:, : len(some)] * self.program.scale[some])
        return np.concatenate(found, axis=1) * self.data.weights[:, None]

    def solve(self, recipes: Sequence[Recipe], data: PeakData | None = None, most: int | None = None) -> list[PeakRow]:
        """Fit recipes, hold records out, and make rows; with `most`, only of that many that fit best."""
        data = data or self.data
        fits = fit_models(self.program, data, [(r.free, r.starts) for r in recipes])
        keep = sorted(range(len(fits)), key=lambda k: fits[k].cost)[:most] if most else range(len(fits))
        held = hold_out(self.program, data, [fits[k] for k in keep])
        rows = []
        for k, fit in zip(keep, held, strict=True):
            self.fits[recipes[k].label] = fit
            rows.append(self._row(recipes[k], fit, data))
        return rows

    def _row(self, recipe: Recipe, fit: PeakFit, data: PeakData) -> PeakRow:
        estimates = self._estimates(fit)
        outside = self._outside(fit.names, fit.x)
        remark = f"not physical: {outside}" if outside else "" if fit.converged else "the fit did not settle"
        squeeze = self.program.evaluate_contact(fit.x, data.conditions)[3].max()
        reference = self.program.space.reference
        assert isinstance(reference, AbstractReference)
        diameter = float(reference.diameter())
        if not remark and diameter > 0 and squeeze > 0.5 * diameter and fit.model.min() > 0:
            remark = f"the ball is squeezed by {1e3 * squeeze:.0f} of its {1e3 * diameter:.0f} mm"
        pressures = np.asarray(self.data.conditions["initial_pressure"])
        return make_row(recipe.label, recipe.kind, recipe.effects, len(fit.names), fit.model, fit.held,
                        self.data.peaks, pressures, self.noise, estimates, not outside, remark)

    def _estimates(self, fit: PeakFit) -> dict[str, dict]:
        """Estimates with standard errors: from the noise, or from the residuals where they are larger."""
        error = fit.model / self.data.peaks - 1.0
        left = max(len(error) - len(fit.names), 1)
        scale = np.nanmax([np.nanmean(self.noise.share), np.sqrt(np.sum(error**2) / left)])
        jacobian = np.nan_to_num(fit.slopes) / self.data.peaks[:, None]
        size = np.linalg.norm(jacobian, axis=0)
        unit = jacobian / np.where(size > 0, size, 1.0)
        covariance = scale**2 * np.linalg.pinv(unit.T @ unit, rcond=1e-12)
        found = {}
        for k, name in enumerate(fit.names):
            number = self.program.space.index[name]
            # Below a millionth of a percent a unit step does nothing: the number is not seen at all.
            seen = size[k] * self.program.scale[number] > 1e-8
            sd = float(np.sqrt(max(covariance[k, k], 0.0)) / size[k]) if seen else float("inf")
            with np.errstate(over="ignore"):  # of what the peaks do not fix, the interval is the whole range
                found[name] = self.program.space.public(name, fit.x, sd)
        return found

    def starts_of(self, effect: type[AbstractEffect]) -> list[dict[str, float]]:
        """Starts of an effect: its own, and amplitudes eight times as large and of the other sign."""
        lists = []
        for p in parameters_of(effect):
            if not p.free or not p.starts:
                continue
            values = list(p.starts)
            if p.kind == "amplitude" and p.coordinate == "linear":
                first = p.starts[0] - p.default
                values += [p.default + 8.0 * first] + ([p.default - first] if p.sign == 0 else [])
                values = [v for v in values if p.bounds[0] <= v <= p.bounds[1]]
            lists.append([(f"{effect.id}.{p.name}", v) for v in values])
        return [dict(chosen) for chosen in itertools.product(*lists)]

    def add_effects(self, reference: PeakRow, base: PeakRow | None = None) -> list[PeakRow]:
        """Rows of the reference model, or of a model that has effects already, with each further effect added."""
        recipes = []
        effects = base.effects if base else ()
        free = self.fits[base.label].names if base else self.free
        for effect in self.program.space.effects:
            names = tuple(self.program.space.of([effect.id]))
            size = len(free) + len(names)
            if effect.id in effects or size > DIRECTIONS or size > len(self.data.peaks) - 2:
                continue
            start = base or reference
            here = {n: self.program.space.parameter(n).transform.find_field(start.estimates[n]["estimate"])
                    for n in free}
            starts = self.starts_of(effect)
            # From the null too, so that a larger model never fits worse; never only from there.
            starts = [{}, *(starts[:2] if base else starts)]
            label = " + ".join((*effects, effect.id))
            recipes.append(Recipe(label if base else f"our model + {effect.id}", "pair" if base else "effect",
                                  (*effects, effect.id), (*free, *names), tuple({**here, **s} for s in starts)))
        return self.solve(recipes, most=FINALISTS if base else None)

    def grow(self, base: PeakRow, singles: Sequence[PeakRow], level: float) -> tuple[list[PeakRow], list[PeakRow]]:
        """Add the best effect while something is missing, and then one more; returns the steps and all pairs tried."""
        steps, pairs, peaks = [base], [], self.data.peaks
        if not base.p_value < level:
            return steps, pairs
        helping = sorted((row for row in self._pick_helping(base, singles, level) if row.physical),
                         key=lambda row: row.heldout)
        chosen = self.choose_anew("best single effect, chosen anew in every fold", singles)
        if not helping or not compare_rows(base, chosen, peaks).decided:
            return steps, [chosen]
        best = helping[0]
        steps.append(best)
        if best.p_value >= level:
            return steps, [chosen]
        rivals = [row for row in helping[1:] if not compare_rows(row, best, peaks).decided]
        for row in (best, *rivals[:1]):
            have = {frozenset(pair.effects) for pair in pairs}
            pairs += [pair for pair in self.add_effects(base, row) if frozenset(pair.effects) not in have]
        # A pair has to hold out better also when it is chosen, among all pairs, without the record that it predicts.
        anew = self.choose_anew("best pair of effects, chosen anew in every fold", pairs)
        larger = [row for row in pairs if set(best.effects) < set(row.effects)]
        better = sorted((row for row in self._pick_helping(best, larger, level)
                         if row.physical and np.isfinite(row.p_value)), key=lambda row: row.heldout)
        if better and compare_rows(best, anew, peaks).decided:
            steps.append(better[0])
        return steps, [chosen, anew, *pairs]

    def _pick_helping(self, before: PeakRow, after: Sequence[PeakRow], level: float) -> list[PeakRow]:
        """Models whose addition is seen, fits better beyond the noise (given how many were tried) and holds out better.

        That something is missing was found before; here it is decided what helps.
        """
        found = []
        for row in after:
            added = [value for name, value in row.estimates.items() if name not in before.estimates]
            seen = any(abs(value["estimate"]) > 2.0 * value["sd"] for value in added)
            fits = judge_gain(before, row, self.data.peaks, self.noise, len(after)) < level
            if seen and fits and compare_rows(before, row, self.data.peaks).decided:
                found.append(row)
        return found

    def choose_anew(self, label: str, rows: Sequence[PeakRow]) -> PeakRow:
        """A row that predicts every record by the model which, among physical ones, fits the other records best."""
        fits = [self.fits[row.label] for row in rows]
        cost = np.array([[np.inf if self._outside(fit.names, x) else c
                          for x, c in zip(_made(fit.fold_x), _made(fit.fold_cost), strict=True)] for fit in fits])
        pick = np.argmin(cost, axis=0)
        held = np.array([fits[k].held[i] for i, k in enumerate(pick)])
        names = sorted({" + ".join(rows[k].effects) for k in pick})
        best = min((row for row in rows if row.physical), key=lambda row: float(np.sum((row.fitted / self.data.peaks
                                                                                       - 1.0) ** 2)), default=rows[0])
        return make_row(label, "choice", (), best.free, best.fitted, held, self.data.peaks,
                        np.asarray(self.data.conditions["initial_pressure"]), self.noise,
                        remark="chosen: " + "; ".join(names))

    def _outside(self, names: Sequence[str], x: np.ndarray) -> str:
        """The first estimate of an effect outside its physical limits, in words; empty where there is none.

        Few numbers cannot overrule these: a model that needs more does not count.
        """
        for name in names:
            number = self.program.space.index[name]
            value = float(self.program.space.public(name, x, 0.0)["estimate"])
            slot = self.program.space.slots[number]
            if slot.owner is not None and slot.parameter.excludes(value, value):
                return f"{name} = {value:.3g} {self.program.space.unit(name, x)}".strip()
        return ""

    def _shift(self) -> PeakData:
        """The same peaks with the pressures read as gauge, in vacuum."""
        conditions = self.data.conditions
        return dc.replace(self.data, conditions={
            **conditions, "initial_pressure": conditions["initial_pressure"] + ATMOSPHERE})

    def read_as_gauge(self) -> list[PeakRow]:
        """The reference model with the pressures read as gauge: in vacuum, and with the atmosphere pushing back."""
        recipes = [Recipe("pressures read as gauge", "reading", (), self.free)]
        if "ambient-pressure" in {effect.id for effect in self.program.space.effects}:
            recipes.append(Recipe("pressures read as gauge, the atmosphere pushing back", "reading",
                                  ("ambient-pressure",), self.free, ({"ambient-pressure.p_a": ATMOSPHERE},)))
        return self.solve(recipes, self._shift())

    def read_best_as_gauge(self, row: PeakRow) -> PeakRow:
        """A row's model fitted again with the pressures read as gauge, in vacuum."""
        start = {name: self.program.space.parameter(name).transform.find_field(value["estimate"])
                 for name, value in row.estimates.items()}
        return self.solve([Recipe(f"{' + '.join(row.effects)}, pressures read as gauge", "reading", row.effects,
                                  tuple(row.estimates), (start,))], self._shift())[0]

    def contact(self, row: PeakRow) -> tuple[np.ndarray, np.ndarray]:
        """Contact times [s] and ratios of rebound to approach speed of a row's fit, each shape (records,)."""
        _, times, ratios, _ = self.program.evaluate_contact(self.fits[row.label].x, self.data.conditions)
        return times, ratios


def _made(folds: np.ndarray | None) -> np.ndarray:
    if folds is None:
        raise ValueError("`hold_out` has to come before a choice inside the folds.")
    return folds


def choose_effects(effects: Sequence[type[AbstractEffect]], reference: AbstractReference,
                   conditions: Mapping[str, np.ndarray]) -> tuple[tuple[type[AbstractEffect], ...], dict[str, str]]:
    """Effects that peaks at these conditions can see at all, and the others with the reason."""
    chosen, left_out = [], {}
    for effect in effects:
        lacking = [need for need in effect.requires if need not in reference.provides and need not in conditions]
        if lacking:
            left_out[effect.id] = f"there is no {lacking[0]} to read"
        elif effect.id == "speed-dependent-restitution" and len(np.unique(conditions["approach_speed"])) < 2:
            left_out[effect.id] = "all impacts have one speed"
        else:
            chosen.append(effect)
    return tuple(chosen), left_out


def rank_candidates(bench: Bench, base: PeakRow, singles: Sequence[PeakRow]) -> list[dict[str, Any]]:
    """Candidates as `result.json` lists them, best first."""
    peaks, noise, records = bench.data.peaks, bench.noise, len(bench.data.peaks)
    cost = measure_cost(base, peaks, noise)
    above = cost - (records - base.free)
    sigma = float(np.mean(noise.share))
    found = []
    for row in sorted(singles, key=lambda r: r.heldout if np.isfinite(r.heldout) else np.inf):
        effect = row.effects[-1]
        gain = max(cost - measure_cost(row, peaks, noise), 0.0)
        amplitude = next(n for n in bench.program.space.of([effect]) if n in row.estimates)
        visible, per_unit = _signature(bench, base, amplitude)
        detectable = _publish_size(bench, amplitude, 3.0 * sigma / per_unit if per_unit > 0 else np.inf)
        twins = [other.effects[-1] for other in singles if other is not row
                 and not compare_rows(row, other, peaks).decided and not compare_rows(other, row, peaks).decided]
        found.append({
            "effect": effect, "p_value": judge_gain(base, row, peaks, noise, len(singles)),
            "explains": float(np.clip(gain / above, 0.0, 1.0)) if above > 0 else 0.0, "visible": visible,
            "heldout_nrmse": row.heldout, "physical": row.physical,
            "smallest_detectable": {} if detectable is None else {amplitude: detectable},
            "indistinguishable_from": twins,
        })
    return found


def _publish_size(bench: Bench, name: str, size: float) -> float | None:
    """Public value of an amplitude at a distance from its null; None beyond what physics allows."""
    p = bench.program.space.slots[bench.program.space.index[name]].parameter
    return p.transform.from_unconstrained(p.default + (p.sign or 1) * size) if size <= reach_limit(p) else None


def _signature(bench: Bench, base: PeakRow, name: str) -> tuple[float, float]:
    """Share of an amplitude's signature that survives the reference parameters, and its size per public unit."""
    columns = bench.sensitivities(bench.fits[base.label].x, (*bench.free, name)) / (
        bench.data.weights * bench.data.peaks)[:, None]
    raw = columns[:, -1]
    if not np.linalg.norm(raw) > 0:
        return 0.0, 0.0
    basis, _ = np.linalg.qr(columns[:, :-1])
    rest = raw - basis @ (basis.T @ raw)
    scale = bench.program.scale[bench.program.space.index[name]]
    return float(np.linalg.norm(rest) / np.linalg.norm(raw)), float(np.linalg.norm(rest) / scale)


def could_show(bench: Bench, base: PeakRow, level: float) -> bool:
    """Whether any effect, with a signature of three times the noise, would have been noticed more often than not."""
    records = len(bench.data.peaks)
    return any(has_power(_signature(bench, base, bench.program.space.of([effect.id])[0])[0], records,
                         records - base.free, bench.noise, level) for effect in bench.program.space.effects)


def has_power(visible: float, records: int, left: int, noise: Noise, level: float) -> bool:
    """Whether an effect of three times the noise is noticed more often than not.

    Args:
        visible: share of its signature that survives the reference parameters [-].
        records: how many peaks; left: less the fitted numbers.
        noise: where the noise comes from.
        level: of the test.
    """
    from scipy.stats import chi2, f, ncf, ncx2

    if left < 1 or noise.degrees < 1:
        return False
    strength = 9.0 * records * visible**2
    if np.isinf(noise.degrees):
        return bool(ncx2.sf(chi2.isf(level, left), left, strength) >= 0.5)
    extra = max(left - noise.degrees, 1)
    return bool(ncf.sf(f.isf(level, extra, noise.degrees), extra, noise.degrees, strength) >= 0.5)


def locate_misfit(row: PeakRow, pressures: np.ndarray, peaks: np.ndarray) -> tuple[dict[str, Any], ...]:
    """Where a model's misfit sits: the run of neighbouring pressures with errors of one sign that holds most of it."""
    order = np.argsort(pressures)
    error = (row.fitted / peaks - 1.0)[order]
    total = float(np.sum(error**2))
    if not total > 0:
        return ()
    runs = np.split(np.arange(len(error)), np.flatnonzero(np.diff(np.sign(error))) + 1)
    # A record that dwarfs its neighbours is a place of its own.
    alone = int(np.argmax(error**2))
    best = max(runs, key=lambda run: float(np.sum(error[run] ** 2)))
    if error[alone] ** 2 > 0.5 * total:
        best = np.array([alone])
    span = [float(pressures[order][best[0]]), float(pressures[order][best[-1]])]
    return ({"channel": "peak_normal_force", "variable": "initial_pressure", "range": span, "phase": "peak",
             "share": float(np.sum(error[best] ** 2) / total)},)
