"""A verdict on a campaign that holds friction forces only: laws side by side, each force predicted without itself."""

import dataclasses as dc
from collections.abc import Mapping, Sequence
from typing import Any, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..contact.effect import AbstractEffect, parameters_of, read_field
from ..contact.friction import DIVERGES_ABOVE
from ..contact.sliding import AbstractFriction, CoulombFriction, FrictionLaw, RubberFriction, Slide
from ..families import SLIP
from ..inference.parameters import ParameterSpace
from ..measurement.quantities import format_share, join_words
from .peaks import choose_effects, has_power
from .rows import (
    AbstractJudgement,
    Noise,
    PeakRow,
    compare_rows,
    decide_verdict,
    estimate_noise,
    fit_linear,
    judge_gain,
    judge_rivals,
    make_interval,
    make_row,
    measure_errors,
    sign,
    tabulate,
    tidy,
    tidy_all,
)


LEAST = 1e-6  # the smallest tan(delta) that is tried: K is a quotient by it


@dc.dataclass(frozen=True)
class ForceFit:
    """A friction law fitted to forces.

    Attributes:
        names: of what was fitted; of the paper's law `adhesion` is the product K tan(delta).
        values: fitted values, shape (names,).
        sd: standard errors from the residuals, shape (names,); nan where a value sits at its limit.
        fitted: shape (records,) [N].
        held: each record by a fit without it, shape (records,) [N].
        bound: names of what sits at its limit.
    """

    names: tuple[str, ...]
    values: np.ndarray
    sd: np.ndarray
    fitted: np.ndarray
    held: np.ndarray
    bound: tuple[str, ...]


class FrictionProgram:
    r"""Friction forces of a reference model with effects, and their derivatives.

    The slip term of Eqs. 9 and 10 is off: these forces have no slip. Of the paper's law the products
    $K \tan\delta_L$ (`adhesion`) and $\tan\delta_L$ (`loss_factor`) are the coordinates, in which it is linear.

    Args:
        reference: template of the reference model.
        effects: classes of effects that may be switched on.
        conditions: arrays of shape (records,), SI: `normal_load`, and `internal_pressure` and `slip_speed` where known.
    """

    def __init__(self, reference: AbstractFriction, effects: Sequence[type[AbstractEffect]],
                 conditions: Mapping[str, np.ndarray]):
        if isinstance(reference, RubberFriction):
            reference = eqx.tree_at(lambda r: r.slip_scale, reference, jnp.zeros(()))
        self.reference, self.effects = reference, tuple(effects)
        loads = jnp.asarray(conditions["normal_load"], float)
        zero = jnp.zeros_like(loads)
        self.slides = Slide(
            slip=zero, slip_speed=jnp.asarray(conditions.get("slip_speed", zero), float), normal_load=loads,
            internal_pressure=jnp.asarray(conditions.get("internal_pressure", zero), float), work=zero, time=zero,
            direction=jnp.ones_like(loads), conditions={n: jnp.asarray(v, float) for n, v in conditions.items()})
        self.space = ParameterSpace(reference, self.effects)
        self.parameters = tuple(slot.parameter for slot in self.space.slots)
        self.names = tuple("adhesion" if s.name == "adhesion_constant" else s.name for s in self.space.slots)
        self.units = {name: p.unit for p, name in zip(self.parameters, self.names, strict=True)}
        self.start = np.array([p.default if slot.owner else float(read_field(reference, p.field))
                               for p, slot in zip(self.parameters, self.space.slots, strict=True)])
        self.low = np.array([max(p.bounds[0], p.default) if p.sign > 0 else p.bounds[0] for p in self.parameters])
        self.high = np.array([min(p.bounds[1], p.default) if p.sign < 0 else p.bounds[1] for p in self.parameters])
        self.rubber = isinstance(reference, RubberFriction)
        if self.rubber:
            self.low[self.names.index("loss_factor")] = LEAST
            self.start[self.names.index("adhesion")] *= self.start[self.names.index("loss_factor")]
        self._predict = jax.jit(self._force)
        self._slopes = jax.jit(jax.jacfwd(self._force))

    def free_reference(self) -> tuple[str, ...]:
        """Names of the reference model's own free parameters, without the slip term's factor."""
        return tuple(name for slot, name in zip(self.space.slots, self.names, strict=True)
                     if slot.owner is None and slot.parameter.free and name != "slip_scale")

    def build(self, x: Array) -> FrictionLaw:
        """The law at values `x`, shape (parameters,)."""
        values = list(x)
        if self.rubber:
            k = self.names.index("adhesion")
            values[k] = x[k] / x[self.names.index("loss_factor")]
        law: FrictionLaw = self.space.build(jnp.asarray(self.space.coordinates()))
        # `tree_at` hides an empty tuple of effects, so that it is not asked for.
        return eqx.tree_at(lambda law: [read_field(part, p.field)
                                        for part in (law.reference, *(law.effects if self.effects else ()))
                                        for p in parameters_of(part)], law, values)

    def predict(self, x: np.ndarray) -> np.ndarray:
        """Forces at values `x`, shape (records,) [N]."""
        return np.asarray(self._predict(x))

    def slopes(self, x: np.ndarray) -> np.ndarray:
        """Derivatives of the forces by the values, shape (records, parameters)."""
        return np.asarray(self._slopes(x))

    def _force(self, x: Array) -> Array:
        law = self.build(x)
        return jax.vmap(law.force)(self.slides)

    def fit(self, free: Sequence[str], peaks: np.ndarray, weights: np.ndarray,
            start: Mapping[str, float] | None = None) -> ForceFit:
        """Weighted least squares within every parameter's limits, on all records and without each in turn.

        Args:
            free: names of what is fitted; all else keeps its default, or the value that `start` gives it.
            peaks: measured forces, shape (records,) [N].
            weights: shape (records,) [1/N].
            start: values by name.
        """
        x = self.start.copy()
        for name, value in (start or {}).items():
            x[self.names.index(name)] = value
        where = [self.names.index(name) for name in free]
        every = self._solve(x, where, peaks, weights)
        fitted = self.predict(every)
        held = np.empty(len(peaks))
        for k in range(len(peaks)):
            rest = np.where(np.arange(len(peaks)) == k, 0.0, weights)
            held[k] = self.predict(self._solve(every, where, peaks, rest))[k]
        values = every[where]
        reach = 1e-4 * np.maximum(np.abs(values), 1.0)
        stuck = (values - self.low[where] < reach) & np.isfinite(self.low[where]) & (self.low[where] >= 0.0)
        sd = np.full(len(where), np.nan)
        free_now = [k for k, s in zip(where, stuck, strict=True) if not s]
        sd[~stuck] = measure_errors(weights[:, None] * self.slopes(every)[:, free_now], weights * (fitted - peaks))
        bound = tuple(name for name, s in zip(free, stuck, strict=True) if s)
        return ForceFit(tuple(free), values, sd, fitted, held, bound)

    def _solve(self, x: np.ndarray, where: list[int], peaks: np.ndarray, weights: np.ndarray) -> np.ndarray:
        from scipy.optimize import least_squares

        low, high = self.low[where], self.high[where]

        def put(values):
            full = x.copy()
            full[where] = values
            return full

        first = np.clip(x[where], low + 1e-3 * np.maximum(1.0, np.abs(np.nan_to_num(low, neginf=0.0))), high)
        found = least_squares(
            lambda v: weights * (self.predict(put(v)) - peaks), first, bounds=(low, high), xtol=1e-13,
            ftol=1e-13, gtol=1e-13,
            jac=lambda v: weights[:, None] * self.slopes(put(v))[:, where])  # pyright: ignore[reportArgumentType]
        return put(found.x)

    def separate(self, first: str, second: str, weights: np.ndarray) -> tuple[np.ndarray, float]:
        """Singular values and correlation of two parameters of the reference model as they are declared, at defaults.

        Args:
            first, second: field names of the reference model.
            weights: shape (records,) [1/N].

        Returns:
            Singular values, shape (2,), of the derivatives of the weighted forces by the logarithms of the two, and the
            correlation of their estimates [-].
        """
        def force(logs):
            law = FrictionLaw(eqx.tree_at(lambda r: [getattr(r, first), getattr(r, second)], self.reference,
                                          [jnp.exp(logs[0]), jnp.exp(logs[1])]))
            return jax.vmap(law.force)(self.slides)

        start = jnp.log(jnp.stack([getattr(self.reference, first), getattr(self.reference, second)]))
        columns = weights[:, None] * np.asarray(jax.jacfwd(force)(start))
        # cov = (J'J)^-1, so that the correlation is minus the cosine between the columns.
        cosine = columns[:, 0] @ columns[:, 1] / np.prod(np.linalg.norm(columns, axis=0))
        return np.linalg.svd(columns, compute_uv=False), -float(cosine)


LEVEL = 0.05
SCALED, RELEASED = "Eq. 8 times one scale, K as the toolkit has it", "Eq. 8, weights of either sign"
UNSEEN = {"presliding": "no slip is given", "frictional-heating": "no slip is given, hence no friction work"}
SPEEDS = ("stribeck", "viscous-friction")


@final
@dc.dataclass(frozen=True, kw_only=True)
class FrictionJudgement(AbstractJudgement):
    """What friction forces alone say; `pairs` hold every row against the constant coefficient.

    Attributes:
        loads: shape (records,) [N].
        ratio: mean of friction over load and its standard deviation between records [-].
        constant: row of a constant coefficient.
        separation: of Eq. 8's K and tan(delta) at the toolkit's values: the two singular values of the derivatives by
            their logarithms, and the correlation of their estimates; empty for another reference model.
    """

    family: str = SLIP.name
    loads: np.ndarray
    ratio: tuple[float, float]
    constant: PeakRow
    separation: tuple[float, ...]

    def table(self):
        """All rows side by side, a pandas data frame."""
        return tabulate(self.rows, self.constant, self.peaks, "behind a constant coefficient [%]")

    def to_dict(self) -> dict[str, Any]:
        """The fields of `result.json`."""
        found = self.list_common()
        for line, row in zip(found["rows"], self.rows, strict=True):
            line["worst"] = tidy(float(np.max(np.abs(row.fitted / self.peaks - 1.0))))
            line["estimates"] = tidy_all(row.estimates)
        return {**found, "friction_over_load": {"mean": self.ratio[0], "deviation": self.ratio[1]},
                "separation": [tidy(v) for v in self.separation]}


def judge_friction(
    loads: np.ndarray, peaks: np.ndarray, *, pressures: np.ndarray | None = None, speeds: np.ndarray | None = None,
    printed: np.ndarray | None = None, sd: np.ndarray | None = None, campaign: str = "", model: str = "paper",
    reference: AbstractFriction | None = None, effects: Sequence[type[AbstractEffect]] | None = None,
    assumed: Sequence[str] = (), level: float = LEVEL,
) -> FrictionJudgement:
    """Compare and judge on friction forces alone, with each record left out in turn.

    Args:
        loads: normal load, shape (records,) [N].
        peaks: measured friction force, shape (records,) [N].
        pressures: of the gas, absolute, shape (records,) [Pa], if known.
        speeds: of slip, shape (records,) [m/s], if known.
        printed: what the source's own model predicted [N], if anything.
        sd: standard deviation of each force [N], if stated; else the scatter about a low polynomial is taken.
        campaign: its name.
        model: name of the reference model.
        reference: the reference model (default: Eq. 8; the slip term needs a slip, which forces alone do not have).
        effects: classes of candidate effects (default: the catalogue for slip).
        assumed: names of conditions that are assumptions.
        level: of the tests.

    Returns:
        A `FrictionJudgement`.
    """
    from ..effects.slip import SLIP

    loads, peaks = np.asarray(loads, float), np.asarray(peaks, float)
    conditions = {"normal_load": loads}
    conditions.update({name: np.asarray(value, float) for name, value in
                       (("internal_pressure", pressures), ("slip_speed", speeds)) if value is not None})
    reference = RubberFriction() if reference is None else reference
    chosen, left_out = _choose_effects(SLIP if effects is None else effects, reference, conditions)
    noise = estimate_noise(conditions, peaks, sd, "normal_load", "load")
    weights = 1.0 / (noise.share * peaks) if sd is not None else 1.0 / peaks
    rivals = judge_rivals(loads, peaks, printed, noise, "load")
    if printed is not None:
        rivals[0] = dc.replace(rivals[0], label="printed column × one factor")
        rivals.insert(0, make_row("printed column as it stands", "printed", (), 0, np.asarray(printed, float),
                                  np.asarray(printed, float), peaks, loads, noise))
    program = FrictionProgram(reference, chosen, conditions)
    bench = _Bench(program, peaks, weights, loads, noise)
    plain = _Bench(FrictionProgram(CoulombFriction(), (), conditions), peaks, weights, loads, noise)
    constant = plain.row("constant coefficient", "constant", ("friction_coefficient",))
    base = bench.row(_name(reference), "reference", program.free_reference())
    rows, separation = [*rivals, constant, base], ()
    if isinstance(reference, RubberFriction):
        values, correlation = program.separate("adhesion_constant", "loss_factor", 1.0 / peaks)
        separation = (*map(float, values), correlation)
        rows[-1:-1] = [bench.scale(SCALED), bench.release(RELEASED)]
    singles = [bench.row(f"{_name(reference)} + {effect.id}", "effect",
                         (*program.free_reference(), *_amplitudes(effect)), (effect.id,)) for effect in chosen]
    helping = [row for row in singles if row.physical and _helps(base, row, peaks, noise, len(singles), level)]
    best = sorted(helping, key=lambda row: row.heldout)[:1]
    steps = (base, *(best if base.p_value < level else ()))
    able = any(has_power(bench.visible(base, effect), len(peaks), len(peaks) - base.free, noise, level)
               for effect in chosen)
    every = (*rows, *singles)
    judged = FrictionJudgement(
        campaign=campaign, model=model, verdict=decide_verdict(steps, able, level), effects=steps[-1].effects,
        loads=loads, peaks=peaks, pressures=conditions.get("internal_pressure", np.zeros_like(loads)),
        ratio=(float(np.mean(peaks / loads)), float(np.std(peaks / loads, ddof=1)) if len(peaks) > 1 else float("nan")),
        noise=noise, rows=every, steps=steps, reference=base, constant=constant, polynomial=rivals[-1],
        pairs=tuple(compare_rows(row, constant, peaks) for row in every if row is not constant), left_out=left_out,
        separation=separation, level=level)
    sentence, notes = describe_friction(judged, assumed)
    return dc.replace(judged, sentence=sentence, notes=notes)


class _Bench:
    """Forces, program and noise; makes rows."""

    def __init__(self, program: FrictionProgram, peaks, weights, loads, noise: Noise):
        self.program, self.peaks, self.weights, self.loads, self.noise = program, peaks, weights, loads, noise
        self.fits: dict[str, ForceFit] = {}

    def row(self, label: str, kind: str, free: tuple[str, ...], effects: tuple[str, ...] = ()) -> PeakRow:
        """Fit within the limits of the parameters and make the row; what sits at a limit does not count as fitted."""
        fit = self.fits[label] = self.program.fit(free, self.peaks, self.weights)
        estimates = {name: make_interval(value, sd, self.program.units[name])
                     for name, value, sd in zip(fit.names, fit.values, fit.sd, strict=True) if name not in fit.bound}
        remark = "; ".join(f"{_words(name)} at its limit, 0" for name in fit.bound)
        return make_row(label, kind, effects, len(estimates), fit.fitted, fit.held, self.peaks, self.loads, self.noise,
                        estimates, True, remark)

    def scale(self, label: str) -> PeakRow:
        """The paper's law with everything but tan(delta), which scales it, at the toolkit's values."""
        column = self.program.predict(self.program.start)[:, None]
        start = self.program.start[self.program.names.index("loss_factor")]
        return self._linear(label, column / start, ("loss_factor",))

    def release(self, label: str) -> PeakRow:
        """The paper's law with its two weights free to be negative."""
        names = ("adhesion", "loss_factor")
        columns = self.program.slopes(self.program.start)[:, [self.program.names.index(name) for name in names]]
        return self._linear(label, columns, names)

    def _linear(self, label: str, columns: np.ndarray, names: tuple[str, ...]) -> PeakRow:
        fitted, held = fit_linear(columns, self.peaks, self.weights)
        values = np.linalg.lstsq(columns * self.weights[:, None], self.peaks * self.weights, rcond=None)[0]
        sd = measure_errors(columns * self.weights[:, None], self.weights * (fitted - self.peaks))
        below = [_words(name) for name, value in zip(names, values, strict=True) if value < 0]
        return make_row(label, "reading", (), len(names), fitted, held, self.peaks, self.loads, self.noise,
                        {name: make_interval(v, e) for name, v, e in zip(names, values, sd, strict=True)},
                        not below, f"{' and '.join(below)} below 0" if below else "")

    def visible(self, base: PeakRow, effect: type[AbstractEffect]) -> float:
        """Share of an effect's signature at its null that survives what the reference model can do."""
        fit, program = self.fits[base.label], self.program
        x = program.start.copy()
        x[[program.names.index(name) for name in fit.names]] = fit.values
        slopes = program.slopes(x) / self.peaks[:, None]
        basis, _ = np.linalg.qr(slopes[:, [program.names.index(n) for n in fit.names if n not in fit.bound]])
        raw = slopes[:, program.names.index(_amplitudes(effect)[0])]
        size = float(np.linalg.norm(raw))
        return float(np.linalg.norm(raw - basis @ (basis.T @ raw))) / size if size > 0 else 0.0


def _words(name: str) -> str:
    return {"loss_factor": "tan δ", "adhesion": "K tan δ"}.get(name, name.rsplit(".", 1)[-1])


def _name(reference: AbstractFriction) -> str:
    return "Eq. 8, K and tan δ fitted" if isinstance(reference, RubberFriction) else "our model"


def _amplitudes(effect: type[AbstractEffect]) -> tuple[str, ...]:
    from ..contact.effect import parameters_of

    return tuple(f"{effect.id}.{p.name}" for p in parameters_of(effect) if p.kind == "amplitude")


def _choose_effects(effects, reference, conditions):
    """Effects that forces at these conditions can see, and the others with the reason."""
    chosen, left_out = choose_effects(effects, reference, conditions)
    kept = []
    for effect in chosen:
        if effect.id in UNSEEN:
            left_out[effect.id] = UNSEEN[effect.id]
        elif effect.id in SPEEDS and len(np.unique(conditions["slip_speed"])) < 2:
            left_out[effect.id] = "all strokes have one speed"
        else:
            kept.append(effect)
    return tuple(kept), left_out


def _helps(before: PeakRow, after: PeakRow, peaks: np.ndarray, noise: Noise, tried: int, level: float) -> bool:
    """Whether what is added is seen, fits better beyond the noise and holds out better."""
    added = [value for name, value in after.estimates.items() if name not in before.estimates]
    seen = any(abs(value["estimate"]) > 2.0 * value["sd"] for value in added)
    return (seen and judge_gain(before, after, peaks, noise, tried) < level
            and compare_rows(before, after, peaks).decided)


def describe_friction(judged, assumed: Sequence[str]) -> tuple[str, tuple[str, ...]]:
    """The sentence and the notes of a `FrictionJudgement`.

    Args:
        judged: the judgement, without them.
        assumed: names of conditions that are assumptions.
    """
    notes = [judged.noise.text]
    given = [{"normal_load": "loads", "internal_pressure": "pressures", "slip_speed": "slip speeds"}.get(name, name)
             for name in assumed]
    if given:
        notes.append(f"The {join_words(given)} of these rows are assumed, not printed; every statement here stands on "
                     "them.")
    if judged.separation:
        notes.append("No slip belongs to these forces, so the slip term of Eqs. 9 and 10 is left out of our model: "
                     "Eq. 8 alone is judged" + _describe_loads(judged.loads) + ".")
    else:
        notes.append(f"No slip belongs to these forces: the model {judged.model!r} is taken at zero slip.")
    notes += _describe_weights(judged)
    notes += [f"{effect.capitalize()} cannot be seen: {reason}." for effect, reason in judged.left_out.items()]
    notes.append(describe_best(judged))
    return _write_sentence(judged), tuple(notes)


def describe_best(judged) -> str:
    """Which model is best on left-out forces, and whether that is more than chance."""
    rows = [row for row in judged.rows if row.physical and np.isfinite(row.heldout)]
    best, plain = min(rows, key=lambda row: row.heldout), judged.constant
    gaps = {pair.first: pair for pair in judged.pairs}
    better = [name for name, gap in gaps.items() if gap.difference < -2 * gap.standard_error]
    worse = [name for name, gap in gaps.items() if gap.difference > 2 * gap.standard_error]
    start = f"A constant coefficient misses left-out forces by {format_share(plain.heldout, 1)} (rms)"
    if best is plain:
        text = f"{start}, and nothing misses them by less."
    else:
        gap = gaps[best.label]
        text = (f"{start}; the least is {format_share(best.heldout, 1)} ({best.label}), a difference of "
                f"{-100 * gap.difference:.2f} ± {100 * gap.standard_error:.2f} points of mean error.")
    does = "does" if len(better) == 1 else "do"
    told = (f" Beyond two standard errors only {join_words(better)} {does} better." if better else
            " No model does better than the constant beyond two standard errors.")
    return text + told + (f" Worse beyond that: {join_words(worse)}." if worse else "")


def _describe_loads(loads: np.ndarray) -> str:
    outside = int(np.sum(loads > DIVERGES_ABOVE))
    if not outside:
        return ""
    return (f"; {outside} of the {len(loads)} loads lie above {DIVERGES_ABOVE:.1f} N, where its curve diverges, so "
            f"that it could not be used anyway")


def _describe_weights(judged) -> list[str]:
    """Whether K and tan(delta) can be told apart, and what happens to them."""
    if not judged.separation:
        return []
    large, small, correlation = judged.separation
    if small < 1e-6 * large:
        return ["Without a spread of pressures K and tan δ cannot be told apart: only their product is seen."]
    found = [f"At the toolkit's values of K and tan δ the derivatives of the forces by their logarithms have singular "
             f"values {large:.2f} and {small:.3f}: estimates of the two are correlated by "
             f"{sign(correlation, 2)}, and only the spread of pressures tells them apart at all."]
    free = next((row for row in judged.rows if row.label == RELEASED), None)
    if "loss_factor" not in judged.reference.estimates and free is not None:
        value = free.estimates["loss_factor"]
        found.append(
            f"Left free in sign, tan δ comes out as {sign(value['estimate'], 3)} ± {value['sd']:.3f}: friction "
            f"over load does not grow with pressure as the hysteresis of Eq. 8 must. Within its limits tan δ goes to 0 "
            f"and K without limit; what remains of Eq. 8 is their product, which is a constant coefficient.")
    return found


def _write_sentence(judged) -> str:
    start = (f"With each record left out in turn, {'Eq. 8' if judged.separation else 'our model'} misses the friction "
             f"forces by {format_share(judged.reference.heldout, 1)} (rms), a constant coefficient by "
             f"{format_share(judged.constant.heldout, 1)}, a low polynomial in load by "
             f"{format_share(judged.polynomial.heldout, 1)}")
    printed = [row for row in judged.rows if row.kind == "printed"]
    if printed:
        start += f", the printed column by {format_share(printed[0].heldout, 1)}"
    mean, spread = judged.ratio
    tail = f" Friction over load is {mean:.3f} ± {spread:.3f}."
    if judged.verdict == "undecided":
        return f"{len(judged.peaks)} forces are too few to show or to rule out any effect. {start}.{tail}"
    if judged.verdict == "nothing-missing":
        return f"These forces show no lack of fit at the {100 * judged.level:g} % level. {start}.{tail}"
    if judged.verdict == "unexplained":
        return (f"No effect of the catalogue explains what is missing in these friction forces. {start}. What our "
                f"model leaves is more than the scatter about that polynomial (p = {judged.steps[0].p_value:.2g}), but "
                f"no catalogued effect predicts left-out forces better beyond chance.{tail}")
    effect = judged.effects[-1]
    head, rest = ("explains what is missing", "no lack of fit is left") if judged.verdict == "explained" else (
        "helps but is not all", "something is still missing")
    return (f"{effect.capitalize()} {head}. {start}; {effect} brings our model to "
            f"{format_share(judged.steps[-1].heldout, 1)}, and {rest}.{tail}")
