"""A verdict on a campaign that holds friction forces only: laws side by side, each force predicted without itself."""

import dataclasses as dc
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..contact.effect import AbstractEffect
from ..contact.sliding import AbstractFriction, CoulombFriction, RubberFriction
from .bench import choose_effects, has_power
from .fits import fit_linear
from .rivals import estimate_noise, judge_rivals, make_row
from .rows import Noise, PairedDifference, PeakRow, compare_rows, decide_verdict, judge_gain, tabulate
from .sliding_peaks import ForceFit, FrictionProgram
from .words import tidy


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
    family: str = "slip"

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
    from .friction_sentences import describe_friction

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
