"""Every model of a judgement on one set of peaks: what is fitted, which effects are tried, in what order."""

import dataclasses as dc
import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..contact.effect import AbstractEffect, parameters_of
from ..contact.law import AbstractReference
from ..inference.parameters import to_public
from ..selection.detectability import reach_limit
from .fits import PeakData, PeakFit, fit_models, hold_out
from .peaks import DIRECTIONS, PeakProgram
from .rivals import make_row
from .rows import Noise, PeakRow, compare_rows, judge_gain, measure_cost


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
            here = {n: _field(start.estimates[n]["estimate"], self.program, n) for n in free}
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

    def read_as_gauge(self) -> list[PeakRow]:
        """The reference model with the pressures read as gauge: in vacuum, and with the atmosphere pushing back."""
        shifted = {**self.data.conditions, "initial_pressure": self.data.conditions["initial_pressure"] + ATMOSPHERE}
        data = dc.replace(self.data, conditions=shifted)
        rows = self.solve([Recipe("pressures read as gauge", "reading", (), self.free)], data)
        if "ambient-pressure" in {effect.id for effect in self.program.space.effects}:
            inside = {"ambient-pressure.p_a": ATMOSPHERE}
            rows += self.solve([Recipe("pressures read as gauge, the atmosphere pushing back", "reading",
                                       ("ambient-pressure",), self.free, (inside,))], data)
        return rows

    def read_best_as_gauge(self, row: PeakRow) -> PeakRow:
        """A row's model fitted again with the pressures read as gauge, in vacuum."""
        start = {name: _field(value["estimate"], self.program, name) for name, value in row.estimates.items()}
        shifted = {**self.data.conditions, "initial_pressure": self.data.conditions["initial_pressure"] + ATMOSPHERE}
        recipe = Recipe(f"{' + '.join(row.effects)}, pressures read as gauge", "reading", row.effects,
                        tuple(row.estimates), (start,))
        return self.solve([recipe], dc.replace(self.data, conditions=shifted))[0]

    def contact(self, row: PeakRow) -> tuple[np.ndarray, np.ndarray]:
        """Contact times [s] and ratios of rebound to approach speed of a row's fit, each shape (records,)."""
        _, times, ratios, _ = self.program.evaluate_contact(self.fits[row.label].x, self.data.conditions)
        return times, ratios


def _made(folds: np.ndarray | None) -> np.ndarray:
    if folds is None:
        raise ValueError("`hold_out` has to come before a choice inside the folds.")
    return folds


def _field(value: float, program: PeakProgram, name: str) -> float:
    """Field value of a public estimate."""
    inverse = program.space.slots[program.space.index[name]].parameter.coordinate == "inverse"
    return (1.0 / value if value else np.inf) if inverse else value


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
    return to_public(p.coordinate, p.default + (p.sign or 1) * size) if size <= reach_limit(p) else None


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
