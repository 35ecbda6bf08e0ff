"""A verdict on a campaign that holds peaks only: what the model leaves, which effects help, what cannot be told."""

import dataclasses as dc
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..contact.effect import AbstractEffect
from ..contact.law import AbstractReference, Ball
from .bench import Bench, Recipe, choose_effects, could_show, locate_misfit, rank_candidates
from .fits import PeakData
from .friction import FrictionJudgement, judge_friction
from .peaks import WINDOW, PeakProgram
from .rivals import estimate_noise, judge_rivals
from .rows import Noise, PairedDifference, PeakRow, compare_rows, decide_verdict, tabulate
from .words import tidy


LEVEL = 0.05


@dc.dataclass(frozen=True)
class PeakJudgement:
    """What peaks alone say; `to_dict()` gives the fields of `result.json` that make sense for them.

    Attributes:
        campaign, family, model: names.
        verdict: `nothing-missing`, `explained`, `improved`, `unexplained` or `undecided`.
        effects: ids in the final model.
        sentence: plain words.
        pressures, peaks: as judged, shape (records,) [Pa, N].
        noise: size of the error of single peaks.
        rows: every model tried, side by side.
        steps: rows of the loop, reference model first.
        reference: row of the reference model; `polynomial`: of the low polynomial.
        pairs: paired held-out differences between the polynomial, the best effects and the printed column.
        candidates: dicts, one an effect, best first.
        where: dicts: where the reference model's misfit sits.
        left_out: ids of effects that peaks at these conditions cannot see, with the reason.
        exponent: of the growth of the peak with pressure, and its standard error; nan where there is none.
        fixed: reference parameters that were not fitted because the others absorb them, with their values.
        contact: of the final model: contact times [s] and ratios of rebound to approach speed, each shape (records,).
        level: of the tests.
        notes: further sentences.
    """

    campaign: str
    family: str
    model: str
    verdict: str
    effects: tuple[str, ...]
    sentence: str
    pressures: np.ndarray
    peaks: np.ndarray
    noise: Noise
    rows: tuple[PeakRow, ...]
    steps: tuple[PeakRow, ...]
    reference: PeakRow
    polynomial: PeakRow
    pairs: tuple[PairedDifference, ...]
    candidates: tuple[Mapping[str, Any], ...]
    where: tuple[Mapping[str, Any], ...]
    left_out: Mapping[str, str]
    exponent: tuple[float, float]
    fixed: Mapping[str, float]
    contact: tuple[np.ndarray, np.ndarray]
    level: float
    notes: tuple[str, ...]

    def table(self):
        """All rows side by side, a pandas data frame."""
        return tabulate(self.rows, self.polynomial, self.peaks)

    def to_dict(self) -> dict[str, Any]:
        """The fields of `result.json`."""
        final = self.steps[-1]
        steps = []
        for before, row in zip((None, *self.steps[:-1]), self.steps, strict=True):
            added = [effect for effect in row.effects if before is None or effect not in before.effects]
            steps.append({"added": " + ".join(added) or None, "chi2_reduced": tidy(row.chi2_reduced),
                          "nrmse": row.nrmse, "heldout_nrmse": row.heldout,
                          "alternatives": [] if before is None else [
                              {"effect": c["effect"]} for c in self.candidates
                              if c["effect"] in self._kin(added)]})
        return {
            "campaign": self.campaign, "family": self.family, "model": self.model, "verdict": self.verdict,
            "effects": list(self.effects), "steps": steps,
            "noise_nrmse": float(np.sqrt(np.mean(self.noise.share**2))),
            "candidates": [dict(c) for c in self.candidates], "where": [dict(w) for w in self.where],
            "parameters": {name: {k: tidy(v) for k, v in value.items()} for name, value in final.estimates.items()},
            "lack_of_fit": {"statistic": tidy(final.chi2_reduced), "p_value": tidy(final.p_value),
                            "level": self.level, "text": self.noise.text},
            "rows": [{"model": r.label, "kind": r.kind, "free": r.free, "nrmse": tidy(r.nrmse),
                      "heldout_nrmse": tidy(r.heldout), "heldout_worst": tidy(r.worst),
                      "heldout_nrmse_with_gas": tidy(r.heldout_gas), "physical": r.physical, "remark": r.remark}
                     for r in self.rows],
            "paired_differences": [dc.asdict(p) for p in self.pairs],
            "fixed": dict(self.fixed), "cannot_be_seen": dict(self.left_out), "notes": list(self.notes),
            "sentence": self.sentence,
        }

    def _kin(self, added: Sequence[str]) -> set[str]:
        return {other for c in self.candidates if c["effect"] in added for other in c["indistinguishable_from"]}


def judge_campaign(campaign, **options) -> PeakJudgement | FrictionJudgement:
    """Judge a campaign read by `read_campaign` that holds peaks only: `peak_normal_force` or `peak_friction_force`.

    Args:
        campaign: of the family `impact` or `slip`.
        **options: go to `judge_peaks` or `judge_friction`; `model` names the reference model, see
            `ddetumble.inference.models`, unless `reference` is one.

    Returns:
        A `PeakJudgement`, or for friction forces a `FrictionJudgement`; both have `verdict`, `sentence`, `rows`,
        `table()` and `to_dict()`.
    """
    from ..families import find_family
    from ..inference.archive import resolve_model

    extra = ()
    if options.get("reference") is None:
        resolved = resolve_model(options.get("model", "paper"), campaign.family)
        options["reference"], extra = resolved.reference, resolved.effects
    find_family(campaign.family).require_model(options["reference"], campaign.name)
    judged = _judge(campaign, options)
    if not extra:
        return judged
    left = f"The model's own effects ({', '.join(e.id for e in extra)}) are left out: peaks are held against its "
    return dc.replace(judged, notes=(f"{left}reference model, fitted anew.", *judged.notes))


def _judge(campaign, options: dict[str, Any]):
    """Dispatch by what was measured."""
    from .._errors import InputError

    friction = "peak_friction_force"
    if campaign.peaks is not None and friction in campaign.peaks and "normal_load" in campaign.conditions:
        return _judge_slip(campaign, friction, options)
    if campaign.peaks is None or "peak_normal_force" not in campaign.peaks:
        raise InputError(f"campaign {campaign.name} holds no column peak_normal_force, nor peak_friction_force with "
                         "normal_load, to judge")
    return _judge_impact(campaign, options)


def _judge_slip(campaign, name: str, options: dict[str, Any]) -> FrictionJudgement:
    frame = campaign.records.join(campaign.peaks, how="inner").dropna(subset=[name])
    peaks, stated = frame[name].to_numpy(), campaign.uncertainty(name)
    options.setdefault("assumed", tuple(n for n, column in campaign.conditions.items() if column.assumed))
    given = {key: frame[column].to_numpy() for key, column in
             (("pressures", "internal_pressure"), ("speeds", "slip_speed"), ("printed", f"printed_{name}"))
             if column in frame}
    return judge_friction(frame["normal_load"].to_numpy(), peaks, sd=None if stated is None else stated.sd(peaks),
                          campaign=campaign.name, **given, **options)


def _judge_impact(campaign, options: dict[str, Any]) -> PeakJudgement:
    frame = campaign.records.join(campaign.peaks, how="inner").dropna(subset=["peak_normal_force"])
    peaks = frame["peak_normal_force"].to_numpy()
    stated = campaign.uncertainty("peak_normal_force")
    extra = {name: frame[name].to_numpy() for name in campaign.conditions
             if name not in ("initial_pressure", "approach_speed")}
    printed = "printed_peak_normal_force"
    options.setdefault("assumed", tuple(n for n, column in campaign.conditions.items() if column.assumed))
    return judge_peaks(
        frame["initial_pressure"].to_numpy(), frame["approach_speed"].to_numpy(), peaks,
        printed=frame[printed].to_numpy() if printed in frame else None,
        repeats=frame["repeats"].to_numpy() if "repeats" in frame else None,
        sd=None if stated is None else stated.sd(peaks), conditions=extra, campaign=campaign.name, **options)


def judge_peaks(
    pressures: np.ndarray, speeds: np.ndarray, peaks: np.ndarray, *, printed: np.ndarray | None = None,
    repeats: np.ndarray | None = None, sd: np.ndarray | None = None,
    conditions: Mapping[str, np.ndarray] | None = None, campaign: str = "", model: str = "paper",
    reference: AbstractReference | None = None, effects: Sequence[type[AbstractEffect]] | None = None,
    window: float = WINDOW, assumed: Sequence[str] = (), level: float = LEVEL,
) -> PeakJudgement:
    """Compare, rank and judge on peaks alone: models side by side with each record left out in turn.

    Args:
        pressures: absolute, shape (records,) [Pa].
        speeds: of approach, shape (records,) [m/s].
        peaks: measured peak normal force, shape (records,) [N].
        printed: what the source's own model predicted [N], if anything.
        repeats: how many impacts each value is the mean of, if stated.
        sd: standard deviation of each value [N], if stated; else the scatter about a low polynomial is taken.
        conditions: further conditions by name, SI.
        campaign: its name.
        model: name of the reference model.
        reference: the reference model (default: the paper's ball).
        effects: classes of candidate effects (default: the catalogue).
        window: time after first touch in which the peak is sought [s]; it matters only where the arm pushes on.
        assumed: names of conditions that are assumptions.
        level: of the tests.

    Returns:
        A `PeakJudgement`.
    """
    from ..effects import IMPACT
    from .sentences import describe_verdict

    peaks = np.asarray(peaks, dtype=float)
    table = {"initial_pressure": np.asarray(pressures, float), "approach_speed": np.asarray(speeds, float),
             **{name: np.asarray(value, float) for name, value in (conditions or {}).items()}}
    reference = Ball() if reference is None else reference
    chosen, left_out = choose_effects(IMPACT if effects is None else effects, reference, table)
    noise = estimate_noise(table, peaks, sd)
    rivals = judge_rivals(table["initial_pressure"], peaks, printed, noise)
    data = PeakData(table, peaks, 1.0 / (noise.share * peaks) if sd is not None else 1.0 / peaks)
    bench = Bench(PeakProgram(reference, chosen, window), data, noise)
    bench.choose_free()
    base = bench.solve([Recipe("our model, from pressure alone", "reference", (), bench.free)])[0]
    gauge = "initial_pressure" in assumed or bool(np.any(table["initial_pressure"] == 0))
    readings = bench.read_as_gauge() if gauge else []
    singles = bench.add_effects(base)
    steps, pairs = bench.grow(base, singles, level)
    if gauge and len(steps) > 1:
        readings.append(bench.read_best_as_gauge(steps[-1]))
    best = rivals[-1]
    candidates = rank_candidates(bench, base, singles)
    rows = (*rivals, base, *readings, *sorted(singles, key=_order), *sorted(pairs, key=_order))
    able = could_show(bench, base, level)
    finalists = sorted((row for row in singles if row.physical and row.heldout < 0.15), key=_order)[:4]
    differences = [compare_rows(row, best, peaks)
                   for row in {r.label: r for r in (*steps, *finalists, *sorted(pairs, key=_order)[:4])}.values()]
    differences += [compare_rows(b, a, peaks) for k, a in enumerate(finalists) for b in finalists[k + 1:]]
    judged = PeakJudgement(
        campaign=campaign, family="impact", model=model, verdict=decide_verdict(steps, able, level),
        effects=steps[-1].effects, sentence="", pressures=table["initial_pressure"], peaks=peaks, noise=noise,
        rows=rows, steps=tuple(steps), reference=base, polynomial=best, pairs=tuple(differences),
        candidates=tuple(candidates),
        where=locate_misfit(base, table["initial_pressure"], peaks), left_out=left_out,
        exponent=fit_exponent(table["initial_pressure"], peaks), fixed=bench.fixed,
        contact=bench.contact(steps[-1]), level=level, notes=())
    sentence, notes = describe_verdict(judged, assumed=assumed, repeats=repeats)
    return dc.replace(judged, sentence=sentence, notes=notes)


def fit_exponent(pressures: np.ndarray, peaks: np.ndarray) -> tuple[float, float]:
    r"""Exponent $p$ of $F \propto P_0^p$ over the records with gas, and its standard error."""
    some = pressures > 0
    if len(np.unique(pressures[some])) < 3:
        return float("nan"), float("nan")
    x, y = np.log(pressures[some]), np.log(peaks[some])
    x = x - x.mean()
    slope = float(x @ y / (x @ x))
    left = y - y.mean() - slope * x
    return slope, float(np.sqrt(left @ left / (len(x) - 2) / (x @ x)))


def _order(row: PeakRow) -> float:
    return row.heldout if np.isfinite(row.heldout) else np.inf
