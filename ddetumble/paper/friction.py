"""A verdict on a campaign that holds friction forces only: laws side by side, each force predicted without itself."""

import dataclasses as dc
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..contact.effect import AbstractEffect
from ..contact.friction import DIVERGES_ABOVE
from ..contact.sliding import AbstractFriction, CoulombFriction, RubberFriction
from ..families import SLIP
from .bench import choose_effects, has_power
from .fits import fit_linear
from .rivals import estimate_noise, judge_rivals, make_row
from .rows import Noise, PairedDifference, PeakRow, compare_rows, decide_verdict, judge_gain, tabulate
from .sliding_peaks import ForceFit, FrictionProgram
from .words import join, say_share, sign, tidy


LEVEL = 0.05
SCALED, RELEASED = "Eq. 8 times one scale, K as the toolkit has it", "Eq. 8, weights of either sign"
UNSEEN = {"presliding": "no slip is given", "frictional-heating": "no slip is given, hence no friction work"}
SPEEDS = ("stribeck", "viscous-friction")


@dc.dataclass(frozen=True)
class FrictionJudgement:
    """What friction forces alone say; `to_dict()` gives the fields of `result.json` that make sense for them.

    Attributes:
        campaign, model: names; `family` is `slip`.
        verdict: `nothing-missing`, `explained`, `improved`, `unexplained` or `undecided`.
        effects: ids in the final model.
        sentence: plain words.
        loads, peaks: as judged, shape (records,) [N].
        pressures: of the gas, shape (records,) [Pa]; 0 where there is none.
        ratio: mean of friction over load and its standard deviation between records [-].
        noise: size of the error of single forces.
        rows: every model tried, side by side.
        steps: the reference model and, where one helps, the model with an effect.
        reference: row of the reference model; `constant`: of a constant coefficient; `polynomial`: of the low
            polynomial in load.
        pairs: paired held-out differences of every row against the constant coefficient.
        left_out: ids of effects that these forces cannot see, with the reason.
        separation: of Eq. 8's K and tan(delta) at the toolkit's values: the two singular values of the derivatives by
            their logarithms, and the correlation of their estimates; empty for another reference model.
        level: of the tests.
        notes: further sentences.
    """

    campaign: str
    model: str
    verdict: str
    effects: tuple[str, ...]
    sentence: str
    loads: np.ndarray
    peaks: np.ndarray
    pressures: np.ndarray
    ratio: tuple[float, float]
    noise: Noise
    rows: tuple[PeakRow, ...]
    steps: tuple[PeakRow, ...]
    reference: PeakRow
    constant: PeakRow
    polynomial: PeakRow
    pairs: tuple[PairedDifference, ...]
    left_out: Mapping[str, str]
    separation: tuple[float, ...]
    level: float
    notes: tuple[str, ...] = ()
    family: str = SLIP.name

    def table(self):
        """All rows side by side, a pandas data frame."""
        return tabulate(self.rows, self.constant, self.peaks, "behind a constant coefficient [%]")

    def to_dict(self) -> dict[str, Any]:
        """The fields of `result.json`."""
        final = self.steps[-1]
        return {
            "campaign": self.campaign, "family": self.family, "model": self.model, "verdict": self.verdict,
            "effects": list(self.effects),
            "steps": [{"added": " + ".join(row.effects) or None, "chi2_reduced": tidy(row.chi2_reduced),
                       "nrmse": row.nrmse, "heldout_nrmse": row.heldout} for row in self.steps],
            "noise_nrmse": tidy(float(np.sqrt(np.mean(self.noise.share**2)))),
            "parameters": {name: {k: tidy(v) for k, v in value.items()} for name, value in final.estimates.items()},
            "lack_of_fit": {"statistic": tidy(final.chi2_reduced), "p_value": tidy(final.p_value),
                            "level": self.level, "text": self.noise.text},
            "friction_over_load": {"mean": self.ratio[0], "deviation": self.ratio[1]},
            "rows": [{"model": r.label, "kind": r.kind, "free": r.free, "nrmse": tidy(r.nrmse),
                      "worst": tidy(float(np.max(np.abs(r.fitted / self.peaks - 1.0)))),
                      "heldout_nrmse": tidy(r.heldout), "heldout_worst": tidy(r.worst), "physical": r.physical,
                      "estimates": {n: {k: tidy(v) for k, v in e.items()} for n, e in r.estimates.items()},
                      "remark": r.remark} for r in self.rows],
            "paired_differences": [dc.asdict(p) for p in self.pairs],
            "separation": [tidy(v) for v in self.separation], "cannot_be_seen": dict(self.left_out),
            "notes": list(self.notes), "sentence": self.sentence,
        }  # fmt: skip


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
        campaign, model, decide_verdict(steps, able, level), steps[-1].effects, "", loads, peaks,
        conditions.get("internal_pressure", np.zeros_like(loads)),
        (float(np.mean(peaks / loads)), float(np.std(peaks / loads, ddof=1)) if len(peaks) > 1 else float("nan")),
        noise, every, steps, base, constant, rivals[-1],
        tuple(compare_rows(row, constant, peaks) for row in every if row is not constant), left_out, separation, level)
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
        estimates = {name: _interval(value, sd, self.program.units[name])
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
        left = np.sum((self.weights * (fitted - self.peaks)) ** 2) / max(len(self.peaks) - len(names), 1)
        scaled = columns * self.weights[:, None]
        sd = np.sqrt(left * np.diag(np.linalg.pinv(scaled.T @ scaled)))
        below = [_words(name) for name, value in zip(names, values, strict=True) if value < 0]
        return make_row(label, "reading", (), len(names), fitted, held, self.peaks, self.loads, self.noise,
                        {name: _interval(v, e, "") for name, v, e in zip(names, values, sd, strict=True)}, not below,
                        f"{' and '.join(below)} below 0" if below else "")

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


def _interval(value: float, sd: float, unit: str) -> dict[str, Any]:
    return {"estimate": float(value), "sd": float(sd), "q025": float(value - 1.96 * sd),
            "q975": float(value + 1.96 * sd), "unit": unit}


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
        notes.append(f"The {join(given)} of these rows are assumed, not printed; every statement here stands on them.")
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
    start = f"A constant coefficient misses left-out forces by {say_share(plain.heldout)} (rms)"
    if best is plain:
        text = f"{start}, and nothing misses them by less."
    else:
        gap = gaps[best.label]
        text = (f"{start}; the least is {say_share(best.heldout)} ({best.label}), a difference of "
                f"{-100 * gap.difference:.2f} ± {100 * gap.standard_error:.2f} points of mean error.")
    told = (f" Beyond two standard errors only {join(better)} {'does' if len(better) == 1 else 'do'} better." if better
            else " No model does better than the constant beyond two standard errors.")
    return text + told + (f" Worse beyond that: {join(worse)}." if worse else "")


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
             f"forces by {say_share(judged.reference.heldout)} (rms), a constant coefficient by "
             f"{say_share(judged.constant.heldout)}, a low polynomial in load by "
             f"{say_share(judged.polynomial.heldout)}")
    printed = [row for row in judged.rows if row.kind == "printed"]
    if printed:
        start += f", the printed column by {say_share(printed[0].heldout)}"
    mean, spread = judged.ratio
    tail = f" Friction over load is {mean:.3f} ± {spread:.3f}."
    if judged.verdict == "undecided":
        return f"{len(judged.peaks)} forces are too few to show or to rule out any effect. {start}.{tail}"
    if judged.verdict == "nothing-missing":
        return f"These forces show no lack of fit at the {100 * judged.level:g} % level. {start}.{tail}"
    if judged.verdict == "unexplained":
        return (f"No effect of the catalogue explains what is missing in these friction forces. {start}. What our "
                "model leaves is more than the scatter about that polynomial (p = "
                f"{judged.steps[0].p_value:.2g}), but no catalogued effect predicts left-out forces better beyond "
                f"chance.{tail}")
    effect = judged.effects[-1]
    head, rest = ("explains what is missing", "no lack of fit is left") if judged.verdict == "explained" else (
        "helps but is not all", "something is still missing")
    return (f"{effect.capitalize()} {head}. {start}; {effect} brings our model to "
            f"{say_share(judged.steps[-1].heldout)}, and {rest}.{tail}")
