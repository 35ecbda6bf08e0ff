"""Models of peaks: one compiled program of simulated impacts, batched fits, leave-one-out errors, effects in turn."""

import dataclasses as dc
import itertools
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import diffrax as dfx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._numerics import stop
from ..contact.effect import AbstractEffect, AbstractModel, parameters_of
from ..contact.law import AbstractReference, ContactLaw
from ..dynamics.impact import simulate_impact
from ..inference.parameters import ParameterSpace
from ..selection.detectability import reach_limit
from .forces import Forces, PeakRow, compare_rows, has_power, judge_gain, measure_visible, pick_helping


WINDOW = 0.27  # s, the paper's impact time: where the arm pushes on, the peak is sought up to here
SAMPLES = 128  # in a window, denser at its start, in which the peak is sought
CHUNK = 64  # impacts a call of the compiled program: more fill the memory, fewer idle the processor
DIRECTIONS = 4  # parameters that one model may free: eleven peaks determine no more
NONE = np.full((1, DIRECTIONS), -1)  # free coordinates of a model that is only evaluated


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


def peak_force(law: ContactLaw, conditions: Mapping[str, Array], window: Array) -> tuple[Array, Array]:
    """Largest force that the gauge reads in one impact [N], nan where the integration failed; beside it the time of
    separation [s] (the window where the ball still touches then), the ratio of rebound to approach speed [-] and the
    largest depression [m], shape (3,).

    Args:
        law: contact law.
        conditions: of the record, scalars, SI.
        window: time after first touch in which the peak is sought [s].
    """
    times = window * (jnp.arange(1, SAMPLES + 1) / SAMPLES) ** 2
    impact = simulate_impact(law, conditions, times, adjoint=dfx.ForwardMode(), rtol=1e-6, atol=1e-8, max_steps=160)
    peak = jnp.where(impact.failed, jnp.nan, refine_peak(times, impact.normal_force))
    return peak, jnp.stack([impact.separation, impact.rebound_speed / conditions["approach_speed"],
                            jnp.max(impact.depression)])


@partial(jax.jit, static_argnums=0)
def _evaluate(space: ParameterSpace, x: Array, free: Array, conditions: Mapping[str, Array], window: Array):
    """Peaks, shape (impacts,), derivatives, shape (impacts, DIRECTIONS), and what `peak_force` gives beside."""
    basis = (free[:, :, None] == jnp.arange(x.shape[1])).astype(x.dtype)

    def one(x, directions, record):
        def peak(x):
            return peak_force(space.build(x), record, window)

        return jax.vmap(lambda d: jax.jvp(peak, (x,), (d,), has_aux=True), out_axes=(None, 0, None))(directions)

    return jax.vmap(one)(x, basis, conditions)


def _costs(model: np.ndarray, peaks: np.ndarray, weights: np.ndarray) -> np.ndarray:
    with np.errstate(invalid="ignore"):
        total = np.sum(np.where(weights > 0, (weights * (model - peaks)) ** 2, 0.0), axis=1)
    return np.where(np.isfinite(total), total, np.inf)


ATMOSPHERE = 101325.0  # Pa, the standard atmosphere
# Share of a parameter's signature that must survive for it to be fitted: below it a fit only trades it for others.
VISIBLE = 0.05
FINALISTS = 8  # pairs of effects whose held-out errors are computed, best in sample first: each takes eleven fits


@dc.dataclass(frozen=True)
class Recipe:
    """One model to fit: label, kind and effects as in `PeakRow`, free parameters, starts (values by name).

    A start's value of a parameter that is not free fixes it there.
    """

    label: str
    kind: str
    effects: tuple[str, ...]
    free: tuple[str, ...]
    starts: tuple[Mapping[str, float], ...] = ({},)


@dc.dataclass(frozen=True)
class PeakFit:
    """One model fitted to peaks.

    Attributes:
        names: of the free parameters.
        x: coordinates of all parameters, shape (parameters,).
        fold_x, fold_cost: coordinates, shape (records, parameters), and costs, shape (records,), of the fits without
            each record.
        contact: contact times [s], ratios of rebound to approach speed [-], largest depressions [m]; (records, 3).
    """

    names: tuple[str, ...]
    x: np.ndarray
    fold_x: np.ndarray
    fold_cost: np.ndarray
    contact: np.ndarray


class Bench:
    """Peaks of impacts for any values of the parameters of a reference model and its effects; makes rows of recipes.

    Benches with equal parameter spaces share one compiled program, whatever the number of records and models.

    Args:
        reference: template of the reference model.
        effects: classes of the effects that may be switched on.
        forces: measured peaks.
        window: time after first touch in which a peak is sought [s].

    Attributes:
        free: reference parameters that are fitted.
        fixed: those that are not although they could be, with their values: the others absorb them.
        fits: the fit behind each row, by label.
    """

    def __init__(self, reference: AbstractReference, effects: Sequence[type[AbstractEffect]], forces: Forces,
                 window: float = WINDOW):
        self.forces, self.space, self.window = forces, ParameterSpace(reference, effects), float(window)
        self.free: tuple[str, ...] = ()
        self.fixed: dict[str, float] = {}
        self.fits: dict[str, PeakFit] = {}
        self.scale = self.space.scales()
        self.low, self.high = self.space.bounds()
        for k, slot in enumerate(self.space.slots):
            if slot.parameter.sign > 0:
                self.low[k] = max(self.low[k], slot.parameter.default)
            if slot.parameter.sign < 0:
                self.high[k] = min(self.high[k], slot.parameter.default)

    def number(self, names: Sequence[str]) -> list[int]:
        """Numbers of free coordinates by name, filled up with -1."""
        return [self.space.index[name] for name in names] + [-1] * (DIRECTIONS - len(names))

    def evaluate(self, x: np.ndarray, free: np.ndarray, conditions: Mapping[str, np.ndarray]) \
            -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Peaks and their derivatives by the free coordinates, for a batch of models on the same records.

        Args:
            x: coordinates, shape (batch, parameters).
            free: numbers of the free coordinates, shape (batch, DIRECTIONS); -1 for none.
            conditions: of the records, arrays of shape (records,), SI.

        Returns:
            Peaks, shape (batch, records) [N]; derivatives, shape (batch, records, DIRECTIONS) [N]; contact times [s],
            ratios of rebound to approach speed [-] and largest depressions [m], shape (batch, records, 3).
        """
        batch, records = len(x), len(next(iter(conditions.values())))
        owner, record = np.divmod(np.arange(batch * records), records)
        parts = []
        for first in range(0, batch * records, CHUNK):
            # All calls are of one size: the last impact fills up the last of them.
            take = np.minimum(np.arange(first, first + CHUNK), batch * records - 1)
            row = {name: np.asarray(value, dtype=float)[record[take]] for name, value in conditions.items()}
            parts.append(_evaluate(self.space, x[owner[take]], free[owner[take]], row, self.window))
        peaks, slopes, contact = (np.concatenate(some)[: batch * records] for some in zip(*parts, strict=True))
        return (peaks.reshape(batch, records), slopes.reshape(batch, records, DIRECTIONS),
                contact.reshape(batch, records, 3))

    def minimise(self, forces: Forces, weights: np.ndarray, x: np.ndarray, free: np.ndarray, most: int
                 ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        r"""Levenberg-Marquardt on a batch: minimise $\sum_i W_i^2 (F_i(x) - y_i)^2$ within each coordinate's limits.

        Args:
            forces: measured peaks, whose conditions may be read in another way than the bench's.
            weights: $W$, shape (batch, records) [1/N]; 0 leaves a record out.
            x: starts, shape (batch, parameters).
            free: numbers of the free coordinates, shape (batch, DIRECTIONS), -1 for none.
            most: steps at most.

        Returns:
            Coordinates, peaks, derivatives, costs and whether each converged.
        """
        # A last column that nothing reads stands for the coordinates numbered -1.
        x = np.column_stack([x, np.zeros(len(x))])
        scale, low, high = (np.append(ends, last)[free] for ends, last in (
            (self.scale, 1.0), (self.low, -np.inf), (self.high, np.inf)))
        model, slopes, _ = self.evaluate(x[:, :-1], free, forces.conditions)
        cost = _costs(model, forces.peaks, weights)
        damping, done = np.full(len(x), 1e-3), np.zeros(len(x), dtype=bool)
        for _ in range(most):
            live = np.flatnonzero(~done)
            if not live.size:
                break
            residual = np.where(weights[live] > 0, weights[live] * (np.nan_to_num(model[live]) - forces.peaks), 0.0)
            jacobian = weights[live][:, :, None] * np.nan_to_num(slopes[live]) * scale[live][:, None, :]
            here = np.take_along_axis(x[live], free[live], axis=1)
            gradient = np.einsum("bnk,bn->bk", jacobian, residual)
            # A coordinate at its limit that wants to go further stays there.
            stuck = ((here <= low[live]) & (gradient > 0)) | ((here >= high[live]) & (gradient < 0))
            jacobian = np.where(stuck[:, None, :], 0.0, jacobian)
            gradient = np.einsum("bnk,bn->bk", jacobian, residual)
            normal = np.einsum("bnk,bnl->bkl", jacobian, jacobian)
            size = np.einsum("bkk->bk", normal)
            ridge = damping[live][:, None] * np.maximum(size, 1e-9) + np.where(size > 0, 0.0, 1.0)
            step = -np.linalg.solve(normal + ridge[:, :, None] * np.eye(DIRECTIONS), gradient[..., None])[..., 0]
            step, trial = np.clip(step, -3.0, 3.0), x[live]
            np.put_along_axis(trial, free[live], np.clip(here + scale[live] * step, low[live], high[live]), axis=1)
            new_model, new_slopes, _ = self.evaluate(trial[:, :-1], free[live], forces.conditions)
            new_cost = _costs(new_model, forces.peaks, weights[live])
            better, old = new_cost < cost[live], cost[live]
            take = live[better]
            x[take], model[take], slopes[take], cost[take] = (
                trial[better], new_model[better], new_slopes[better], new_cost[better])
            with np.errstate(invalid="ignore"):
                small = better & (old - new_cost < 1e-5 * old)
            done[live] = small | (np.abs(step).max(axis=1) < 1e-6) | (damping[live] > 1e7)
            damping[live] = np.where(better, np.maximum(damping[live] * 0.2, 1e-9), damping[live] * 8.0)
        return x[:, :-1], model, slopes, cost, done & np.isfinite(cost)

    def choose_free(self) -> None:
        """Free the reference parameters that these peaks can tell apart, in the order of the model's own list."""
        names = self.space.of([None])
        columns = self.sensitivities(self.space.coordinates(), names)
        basis = np.zeros((len(self.forces), 0))
        for k, name in enumerate(names):
            size = np.linalg.norm(columns[:, k])
            rest = columns[:, k] - basis @ (basis.T @ columns[:, k])
            enough = size > 0 and np.linalg.norm(rest) > VISIBLE * size
            if enough and len(self.free) < min(DIRECTIONS - 1, len(self.forces) - 2):
                basis = np.column_stack([basis, rest / np.linalg.norm(rest)])
                self.free += (name,)
            else:
                self.fixed[name] = self.space.parameter(name).default

    def sensitivities(self, x: np.ndarray, names: Sequence[str]) -> np.ndarray:
        """Derivatives of the weighted peaks by coordinates in typical sizes, shape (records, names)."""
        found = []
        for first in range(0, len(names), DIRECTIONS):
            some = names[first: first + DIRECTIONS]
            free = self.number(some)
            _, slopes, _ = self.evaluate(x[None], np.array([free]), self.forces.conditions)
            found.append(np.nan_to_num(slopes[0])[:, : len(some)] * self.scale[free[: len(some)]])
        return np.concatenate(found, axis=1) * self.forces.weights[:, None]

    def solve(self, recipes: Sequence[Recipe], gauge: bool = False, most: int | None = None) -> list[PeakRow]:
        """Fit recipes from all their starts, hold every record out in turn, and make rows.

        Args:
            recipes: the models.
            gauge: read the pressures as gauge, in vacuum.
            most: make rows of no more than so many that fit best.
        """
        if not recipes:
            return []
        forces, records = self.forces, len(self.forces)
        if gauge:
            forces = dc.replace(forces, conditions={**forces.conditions, "initial_pressure": forces.x + ATMOSPHERE})
        starts = np.array([self.space.coordinates(start) for recipe in recipes for start in recipe.starts])
        free = np.array([self.number(recipe.free) for recipe in recipes for _ in recipe.starts])
        owner = np.repeat(np.arange(len(recipes)), [len(recipe.starts) for recipe in recipes])
        # A few steps from every start, and then the best start of each model to the end.
        x, _, _, cost, _ = self.minimise(forces, np.tile(forces.weights, (len(starts), 1)), starts, free, 10)
        best = [min(np.flatnonzero(owner == k), key=cost.__getitem__) for k in range(len(recipes))]
        x, model, slopes, cost, done = self.minimise(
            forces, np.tile(forces.weights, (len(best), 1)), x[best], free[best], 50)
        free, keep = free[best], np.arange(len(recipes))
        if most is not None:
            keep = np.argsort(cost, kind="stable")[:most]
        _, _, contact = self.evaluate(x[keep], free[keep], forces.conditions)
        # Each record is left out and predicted by a fit to the others, from the full fit.
        fold_x, held, _, fold_cost, _ = self.minimise(
            forces, np.tile(forces.weights * (1.0 - np.eye(records)), (len(keep), 1)),
            np.repeat(x[keep], records, axis=0), np.repeat(free[keep], records, axis=0), 20)
        held = np.where(np.isfinite(fold_cost)[:, None], held, np.nan).reshape(len(keep), records, records)
        fold_x, fold_cost = fold_x.reshape(len(keep), records, -1), fold_cost.reshape(len(keep), records)
        reference: Any = self.space.reference
        diameter, rows = float(reference.diameter()), []
        for n, k in enumerate(keep.tolist()):
            recipe, squeeze = recipes[k], contact[n, :, 2].max()
            self.fits[recipe.label] = PeakFit(recipe.free, x[k], fold_x[n], fold_cost[n], contact[n])
            outside = self._outside(recipe.free, x[k])
            remark = f"not physical: {outside}" if outside else "" if done[k] else "the fit did not converge"
            if not remark and diameter > 0 and squeeze > 0.5 * diameter and model[k].min() > 0:
                remark = f"the ball is compressed by {1e3 * squeeze:.0f} of its {1e3 * diameter:.0f} mm"
            rows.append(PeakRow(self.forces, recipe.label, recipe.kind, recipe.effects, len(recipe.free), model[k],
                                np.diagonal(held[n]), self._estimate(recipe.free, x[k], model[k], slopes[k]),
                                not outside, remark))
        return rows

    def _estimate(self, names: tuple[str, ...], x: np.ndarray, model: np.ndarray, slopes: np.ndarray
                  ) -> dict[str, dict]:
        """Estimates with standard errors: from the noise, or from the residuals where they are larger."""
        peaks, numbers = self.forces.peaks, [self.space.index[name] for name in names]
        left = max(len(peaks) - len(names), 1)
        scale = np.nanmax([np.nanmean(self.forces.share), np.sqrt(np.sum((model / peaks - 1.0) ** 2) / left)])
        jacobian = np.nan_to_num(slopes[:, : len(names)]) / peaks[:, None]
        size = np.linalg.norm(jacobian, axis=0)
        unit = jacobian / np.where(size > 0, size, 1.0)
        variance = scale**2 * np.diag(np.linalg.pinv(unit.T @ unit, rcond=1e-12))
        # Below a millionth of a percent a unit step does nothing: the number is not seen at all.
        seen = size * self.scale[numbers] > 1e-8
        sd = np.where(seen, np.sqrt(np.maximum(variance, 0.0)) / np.where(seen, size, 1.0), np.inf)
        with np.errstate(over="ignore"):  # of what the peaks do not fix, the interval is the whole range
            return {name: self.space.public(name, x, float(error))
                    for name, error in zip(names, sd, strict=True)}

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
        effects, recipes = base.effects if base else (), []
        free = self.fits[base.label].names if base else self.free
        here = self._begin(base or reference, free)
        for effect in self.space.effects:
            names = tuple(self.space.of([effect.id]))
            size = len(free) + len(names)
            if effect.id in effects or size > DIRECTIONS or size > len(self.forces) - 2:
                continue
            starts = self.starts_of(effect)
            # From the null too, so that a larger model never fits worse; never only from there.
            starts = [{}, *(starts[:2] if base else starts)]
            label = " + ".join((*effects, effect.id))
            recipes.append(Recipe(label if base else f"our model + {effect.id}", "pair" if base else "effect",
                                  (*effects, effect.id), (*free, *names), tuple({**here, **s} for s in starts)))
        return self.solve(recipes, most=FINALISTS if base else None)

    def grow(self, base: PeakRow, singles: Sequence[PeakRow], level: float) -> tuple[list[PeakRow], list[PeakRow]]:
        """Add the best effect while something is missing, and then one more; returns the steps and all pairs tried."""
        steps, pairs = [base], []
        if not base.p_value < level:
            return steps, pairs
        helping = pick_helping(base, singles, level)
        chosen = self.choose_anew("best single effect, chosen anew in every fold", singles)
        if not helping or not compare_rows(base, chosen).decided:
            return steps, [chosen]
        best = helping[0]
        steps.append(best)
        if best.p_value >= level:
            return steps, [chosen]
        rivals = [row for row in helping[1:] if not compare_rows(row, best).decided]
        for row in (best, *rivals[:1]):
            have = {frozenset(pair.effects) for pair in pairs}
            pairs += [pair for pair in self.add_effects(base, row) if frozenset(pair.effects) not in have]
        # A pair has to hold out better also when it is chosen, among all pairs, without the record that it predicts.
        anew = self.choose_anew("best pair of effects, chosen anew in every fold", pairs)
        larger = [row for row in pairs if set(best.effects) < set(row.effects)]
        better = [row for row in pick_helping(best, larger, level) if np.isfinite(row.p_value)]
        if better and compare_rows(best, anew).decided:
            steps.append(better[0])
        return steps, [chosen, anew, *pairs]

    def choose_anew(self, label: str, rows: Sequence[PeakRow]) -> PeakRow:
        """A row that predicts every record by the model which, among physical ones, fits the other records best."""
        fits = [self.fits[row.label] for row in rows]
        cost = np.array([[np.inf if self._outside(fit.names, x) else c
                          for x, c in zip(fit.fold_x, fit.fold_cost, strict=True)] for fit in fits])
        pick = np.argmin(cost, axis=0)
        held = np.array([rows[k].held[i] for i, k in enumerate(pick)])
        names = sorted({" + ".join(rows[k].effects) for k in pick})
        best = min((row for row in rows if row.physical), key=lambda row: row.nrmse, default=rows[0])
        return PeakRow(self.forces, label, "choice", (), best.free, best.fitted, held,
                       remark="chosen: " + "; ".join(names))

    def _outside(self, names: Sequence[str], x: np.ndarray) -> str:
        """The first estimate of an effect outside its physical limits, in words; empty where there is none.

        Few numbers cannot overrule these: a model that needs more does not count.
        """
        for name in names:
            value = float(self.space.public(name, x, 0.0)["estimate"])
            slot = self.space.slots[self.space.index[name]]
            if slot.owner is not None and slot.parameter.excludes(value, value):
                return f"{name} = {value:.3g} {self.space.unit(name, x)}".strip()
        return ""

    def _begin(self, row: PeakRow, names: Sequence[str]) -> dict[str, float]:
        """Fields of a row's estimates, to start from."""
        return {name: self.space.parameter(name).transform.find_field(row.estimates[name]["estimate"])
                for name in names}

    def read_as_gauge(self, best: PeakRow) -> list[PeakRow]:
        """The reference model with the pressures read as gauge, in vacuum and with the atmosphere pushing back, and the
        model of the best row in vacuum."""
        recipes = [Recipe("pressures read as gauge", "reading", (), self.free)]
        if "ambient-pressure" in {effect.id for effect in self.space.effects}:
            recipes.append(Recipe("pressures read as gauge, the atmosphere pushing back", "reading",
                                  ("ambient-pressure",), self.free, ({"ambient-pressure.p_a": ATMOSPHERE},)))
        if best.effects:
            names = tuple(best.estimates)
            recipes.append(Recipe(f"{' + '.join(best.effects)}, pressures read as gauge", "reading", best.effects,
                                  names, (self._begin(best, names),)))
        return self.solve(recipes, gauge=True)

    def contact(self, row: PeakRow) -> tuple[np.ndarray, np.ndarray]:
        """Contact times [s] and ratios of rebound to approach speed of a row's fit, each shape (records,)."""
        return self.fits[row.label].contact[:, 0], self.fits[row.label].contact[:, 1]


# What effects need to vary between records to be seen, and what is said where it does not.
NEEDS = {
    "speed-dependent-restitution": ("approach_speed", "all impacts have one speed"),
    "stribeck": ("slip_speed", "all strokes have one speed"),
    "viscous-friction": ("slip_speed", "all strokes have one speed"),
    "presliding": ("slip", "no slip is given"),
    "frictional-heating": ("slip", "no slip is given, hence no friction work"),
}  # fmt: skip


def choose_effects(effects: Sequence[type[AbstractEffect]], reference: AbstractModel,
                   conditions: Mapping[str, np.ndarray]) -> tuple[tuple[type[AbstractEffect], ...], dict[str, str]]:
    """Effects that single forces at these conditions can see at all, and the others with the reason."""
    left_out = {}
    for effect in effects:
        lacking = [need for need in effect.requires if need not in reference.provides and need not in conditions]
        condition, reason = NEEDS.get(effect.id, ("", ""))
        if lacking:
            left_out[effect.id] = f"there is no {lacking[0]} to read"
        elif condition and len(np.unique(conditions.get(condition, ()))) < 2:
            left_out[effect.id] = reason
    return tuple(effect for effect in effects if effect.id not in left_out), left_out


def rank_candidates(bench: Bench, base: PeakRow, singles: Sequence[PeakRow]) -> list[dict[str, Any]]:
    """Candidates as `result.json` lists them, best first."""
    above = base.cost - (len(base.forces) - base.free)
    sigma = float(np.mean(base.forces.share))
    found = []
    for row in sorted(singles, key=lambda r: r.heldout if np.isfinite(r.heldout) else np.inf):
        gain = max(base.cost - row.cost, 0.0)
        amplitude = next(n for n in bench.space.of([row.effects[-1]]) if n in row.estimates)
        visible, per_unit = _signature(bench, base, amplitude)
        # What leaves three times the noise, unless it is beyond what physics allows.
        p, size = bench.space.parameter(amplitude), 3.0 * sigma / per_unit if per_unit > 0 else np.inf
        detectable = {}
        if size <= reach_limit(p):
            detectable[amplitude] = p.transform.from_unconstrained(p.default + (p.sign or 1) * size)
        twins = [other.effects[-1] for other in singles if other is not row
                 and not compare_rows(row, other).decided and not compare_rows(other, row).decided]
        found.append({
            "effect": row.effects[-1], "p_value": judge_gain(base, row, len(singles)),
            "explains": float(np.clip(gain / above, 0.0, 1.0)) if above > 0 else 0.0, "visible": visible,
            "heldout_nrmse": row.heldout, "physical": row.physical, "smallest_detectable": detectable,
            "indistinguishable_from": twins,
        })  # fmt: skip
    return found


def _signature(bench: Bench, base: PeakRow, name: str) -> tuple[float, float]:
    """Share of an amplitude's signature that survives the reference parameters, and its size per public unit."""
    columns = bench.sensitivities(bench.fits[base.label].x, (*bench.free, name)) / (
        bench.forces.weights * bench.forces.peaks)[:, None]
    scale = bench.scale[bench.space.index[name]]
    visible, length = measure_visible(columns[:, :-1], columns[:, -1])
    return visible, length / scale


def could_show(bench: Bench, base: PeakRow, level: float) -> bool:
    """Whether any effect, with a signature of three times the noise, would have been noticed more often than not."""
    return any(has_power(_signature(bench, base, bench.space.of([effect.id])[0])[0], base, level)
               for effect in bench.space.effects)


def locate_misfit(row: PeakRow) -> tuple[dict[str, Any], ...]:
    """Where a model's misfit sits: the run of neighbouring pressures with errors of one sign that holds most of it."""
    order = np.argsort(row.forces.x)
    pressures, error = row.forces.x[order], row.error[order]
    total = float(np.sum(error**2))
    if not total > 0:
        return ()
    runs = np.split(np.arange(len(error)), np.flatnonzero(np.diff(np.sign(error))) + 1)
    # A record that dwarfs its neighbours is a place of its own.
    alone = int(np.argmax(error**2))
    best = max(runs, key=lambda run: float(np.sum(error[run] ** 2)))
    if error[alone] ** 2 > 0.5 * total:
        best = np.array([alone])
    return ({"channel": "peak_normal_force", "variable": "initial_pressure", "phase": "peak",
             "range": [float(pressures[best[0]]), float(pressures[best[-1]])],
             "share": float(np.sum(error[best] ** 2) / total)},)
