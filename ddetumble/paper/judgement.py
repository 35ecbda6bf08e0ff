"""A verdict on a campaign that holds peaks only: what the model leaves, which effects help, what cannot be told."""

import dataclasses as dc
from collections.abc import Mapping, Sequence
from typing import Any, final

import numpy as np

from ..contact.effect import AbstractEffect
from ..contact.law import AbstractReference, Ball
from ..measurement.kinds import IMPACT
from ..measurement.quantities import format_share
from .friction import FrictionJudgement, judge_friction
from .peaks import (
    WINDOW,
    Bench,
    PeakData,
    PeakProgram,
    Recipe,
    choose_effects,
    could_show,
    locate_misfit,
    rank_candidates,
)
from .rows import (
    AbstractJudgement,
    PeakRow,
    compare_rows,
    decide_verdict,
    estimate_noise,
    judge_rivals,
    tabulate,
    tidy,
)


LEVEL = 0.05


@final
@dc.dataclass(frozen=True, kw_only=True)
class PeakJudgement(AbstractJudgement):
    """What peaks of impacts alone say; `pairs` are between the polynomial, the best effects and the printed column.

    Attributes:
        candidates: dicts, one an effect, best first.
        where: dicts: where the reference model's misfit sits.
        exponent: of the growth of the peak with pressure, and its standard error; nan where there is none.
        fixed: reference parameters that were not fitted because the others absorb them, with their values.
        contact: of the final model: contact times [s] and ratios of rebound to approach speed, each shape (records,).
    """

    family: str = IMPACT.name
    candidates: tuple[Mapping[str, Any], ...]
    where: tuple[Mapping[str, Any], ...]
    exponent: tuple[float, float]
    fixed: Mapping[str, float]
    contact: tuple[np.ndarray, np.ndarray]

    def table(self):
        """All rows side by side, a pandas data frame."""
        return tabulate(self.rows, self.polynomial, self.peaks)

    def to_dict(self) -> dict[str, Any]:
        """The fields of `result.json`."""
        found = self.list_common()
        for step in found["steps"]:
            added = (step["added"] or "").split(" + ")
            kin = {other for c in self.candidates if c["effect"] in added for other in c["indistinguishable_from"]}
            step["alternatives"] = [{"effect": c["effect"]} for c in self.candidates if c["effect"] in kin]
        for line, row in zip(found["rows"], self.rows, strict=True):
            line["heldout_nrmse_with_gas"] = tidy(row.heldout_gas)
        return {**found, "candidates": [dict(c) for c in self.candidates], "where": [dict(w) for w in self.where],
                "fixed": dict(self.fixed)}


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

    held = () if campaign.peaks is None else campaign.peaks.columns
    slip = "peak_friction_force" in held and "normal_load" in campaign.conditions
    name = "peak_friction_force" if slip else "peak_normal_force"
    if name not in held:
        raise InputError(f"campaign {campaign.name} holds no column peak_normal_force, nor peak_friction_force with "
                         "normal_load, to judge")
    frame = campaign.records.join(campaign.peaks, how="inner").dropna(subset=[name])
    peaks, stated = frame[name].to_numpy(), campaign.uncertainty(name)
    options.setdefault("assumed", tuple(n for n, column in campaign.conditions.items() if column.assumed))
    wanted = {"printed": f"printed_{name}"}
    wanted |= {"pressures": "internal_pressure", "speeds": "slip_speed"} if slip else {"repeats": "repeats"}
    options |= {key: frame[column].to_numpy() for key, column in wanted.items() if column in frame}
    options |= {"sd": None if stated is None else stated.sd(peaks), "campaign": campaign.name}
    if slip:
        return judge_friction(frame["normal_load"].to_numpy(), peaks, **options)
    own = ("initial_pressure", "approach_speed")
    extra = {one: frame[one].to_numpy() for one in campaign.conditions if one not in own}
    pressures, speeds = (frame[one].to_numpy() for one in own)
    return judge_peaks(pressures, speeds, peaks, conditions=extra, **options)


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
        campaign=campaign, model=model, verdict=decide_verdict(steps, able, level),
        effects=steps[-1].effects, pressures=table["initial_pressure"], peaks=peaks, noise=noise,
        rows=rows, steps=tuple(steps), reference=base, polynomial=best, pairs=tuple(differences),
        candidates=tuple(candidates),
        where=locate_misfit(base, table["initial_pressure"], peaks), left_out=left_out,
        exponent=fit_exponent(table["initial_pressure"], peaks), fixed=bench.fixed,
        contact=bench.contact(steps[-1]), level=level)
    sentence, notes = describe_verdict(judged, assumed=assumed, repeats=repeats)
    return dc.replace(judged, sentence=sentence, notes=notes)


def fit_exponent(pressures: np.ndarray, peaks: np.ndarray) -> tuple[float, float]:
    r"""Exponent $p$ of $F \propto P_0^p$ over the records with gas, and its standard error."""
    some = pressures > 0
    if len(np.unique(pressures[some])) < 3:
        return float("nan"), float("nan")
    (slope, _), covariance = np.polyfit(np.log(pressures[some]), np.log(peaks[some]), 1, cov=True)
    return float(slope), float(np.sqrt(covariance[0, 0]))


def _order(row: PeakRow) -> float:
    return row.heldout if np.isfinite(row.heldout) else np.inf


def describe_verdict(judged, assumed: Sequence[str], repeats: np.ndarray | None) -> tuple[str, tuple[str, ...]]:
    """The sentence and the notes of a `PeakJudgement`.

    Args:
        judged: the judgement, without them.
        assumed: names of conditions that are assumptions.
        repeats: how many impacts each value is the mean of, or None.
    """
    notes = [judged.noise.text]
    zero = judged.pressures == 0
    if zero.any():
        value = judged.peaks[zero].max()
        notes.append(
            f"At P0 = 0 the gas model gives no force at all, and {value:.1f} N was measured: that row alone says that "
            "something but gas carries load, or that the pressures are not what they are taken to be"
            + (" (they are an assumption)." if "initial_pressure" in assumed else "."))
        read = [row for row in judged.rows if row.kind == "reading" and not row.effects]
        if read:
            first = read[0].fitted[np.argmin(judged.pressures)]
            notes.append(f"Read as gauge pressures (the atmosphere added), that row gets {first:.1f} N in vacuum and "
                         f"the left-out error of our model is {format_share(read[0].heldout, 1)}: not enough either.")
    if "initial_pressure" in assumed:
        notes.append("The pressures of these rows are assumed, not printed; every statement here stands on them.")
    if repeats is not None and np.all(repeats > 1):
        notes.append(f"Each value is the mean of {int(np.min(repeats))} impacts whose scatter is not given.")
    for name, value in judged.fixed.items():
        notes.append(f"{name.capitalize()} cannot be told from what is fitted by peaks alone; it was kept at "
                     f"{value:g}.")
    notes += [f"{effect.capitalize()} cannot be seen: {reason}." for effect, reason in judged.left_out.items()]
    notes += _describe_final(judged) + _describe_pairs(judged)
    return _write_sentence(judged), tuple(notes)


def _write_sentence(judged) -> str:
    base, last, low = judged.reference, judged.steps[-1], judged.polynomial
    start = (f"With each record left out in turn, the {judged.model} model misses the peaks by "
             f"{format_share(base.heldout, 1)} (rms), a low polynomial in pressure by {format_share(low.heldout, 1)}")
    printed = next((row for row in judged.rows if row.kind == "printed"), None)
    if printed is not None:
        start += f", the printed theory times one factor by {format_share(printed.heldout, 1)}"
    if judged.verdict == "undecided":
        return (f"{len(judged.peaks)} peaks are too few to show or to rule out any effect of the catalogue. {start}. "
                "Whole force records would do.")
    if judged.verdict == "nothing-missing":
        return f"These peaks show no lack of fit at the {100 * judged.level:g} % level. {start}."
    if judged.verdict == "unexplained":
        return (f"No effect of the catalogue explains what is missing in these peaks. {start}; no catalogued effect in "
                "its physical range helps on peaks that were left out.")
    effects = " and ".join(last.effects)
    twins = next((c["indistinguishable_from"] for c in judged.candidates if c["effect"] == last.effects[0]), [])
    twins = [twin for twin in twins if twin in {e for row in judged.rows if row.physical for e in row.effects}]
    told = f" (these peaks cannot tell it from {', '.join(twins)})" if twins else ""
    many = len(last.effects) > 1
    if judged.verdict == "explained":
        return (f"{effects.capitalize()} {'explain' if many else 'explains'} what is missing. {start}; {effects}{told} "
                f"brings our model to {format_share(last.heldout, 1)}, and no lack of fit is left.")
    gap = compare_rows(last, low, judged.peaks)
    head = "help but are not all" if many else "helps but is not all"
    return (f"{effects.capitalize()} {head}. {start}. {effects.capitalize()}{told} brings our model to "
            f"{format_share(last.heldout, 1)}, still {100 * gap.difference:.1f} ± {100 * gap.standard_error:.1f} "
            "points behind the polynomial: no single effect of the catalogue, in its physical range, does what a curve "
            "without physics does. Force over time, at two speeds or more, is what to measure next.")


def _describe_final(judged) -> list[str]:
    """What the final model would mean for a force record, which is how to test it."""
    times, ratios = judged.contact
    some = (judged.pressures > 0) & (ratios > 0)
    if len(judged.steps) < 2 or not some.any():
        return []
    return [f"The model with {' and '.join(judged.effects)} says that the ball comes back at {ratios[some].min():.2f} "
            f"to {ratios[some].max():.2f} of its speed after {1e3 * times[some].min():.0f} to "
            f"{1e3 * times[some].max():.0f} ms of contact (rows with gas): one force record over time would confirm or "
            "refute that."]


def _describe_pairs(judged) -> list[str]:
    """What pairs of effects reach, and at what price."""
    pairs = [row for row in judged.rows if row.kind == "pair"]
    if not pairs:
        return []
    level = [row for row in pairs if _level_with(row, judged)]
    told = [f"{' with '.join(row.effects)} ({format_share(row.heldout, 1)}{'; ' + row.remark if row.remark else ''})"
            for row in level[:4]]
    if not told:
        return [f"Of the {len(pairs)} pairs of effects that fit best, none holds out as well as the polynomial."]
    count = max(row.free for row in level)
    return [f"Of the {len(pairs)} pairs of effects that fit best, these hold out as well as the polynomial: "
            f"{'; '.join(told)}. They take {count} fitted numbers of {len(judged.peaks)}, the polynomial "
            f"{judged.polynomial.free}: a model with as many numbers as a plain curve is not shown to be more than "
            f"one."]


def _level_with(row: PeakRow, judged) -> bool:
    gap = compare_rows(row, judged.polynomial, judged.peaks)
    return np.isfinite(row.heldout) and row.heldout < 2 * judged.polynomial.heldout and (
        gap.difference < gap.standard_error)
