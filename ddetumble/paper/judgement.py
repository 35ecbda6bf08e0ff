"""A verdict on a campaign that holds peaks only: what the model leaves, which effects help, what cannot be told."""

import dataclasses as dc
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, final

import numpy as np

from .._sentences import say, tell
from ..contact.effect import AbstractEffect
from ..contact.law import AbstractReference, Ball
from ..inference.files import make_plain
from ..measurement.kinds import IMPACT
from .forces import (
    LEVEL,
    AbstractJudgement,
    Forces,
    PeakRow,
    compare_rows,
    decide_verdict,
    gather_forces,
    judge_rivals,
    tabulate,
)
from .friction import judge_friction
from .peaks import WINDOW, Bench, Recipe, choose_effects, could_show, locate_misfit, rank_candidates


@final
@dc.dataclass(frozen=True, kw_only=True)
class PeakJudgement(AbstractJudgement):
    """What peaks of impacts alone say; `pairs` are between the polynomial, the best effects and the printed column.

    Attributes:
        candidates: dicts, one an effect, best first.
        where: dicts: where the reference model's misfit sits.
        fixed: reference parameters that were not fitted because the others absorb them, with their values.
        contact: of the final model: contact times [s] and ratios of rebound to approach speed, each shape (records,).
    """

    family: ClassVar[str] = IMPACT.name
    candidates: tuple[Mapping[str, Any], ...]
    where: tuple[Mapping[str, Any], ...]
    fixed: Mapping[str, float]
    contact: tuple[np.ndarray, np.ndarray]

    def table(self):
        """All rows side by side, a pandas data frame."""
        return tabulate(self.rows, self.polynomial, "behind the polynomial [%]")

    def to_dict(self) -> dict[str, Any]:
        """The fields of `result.json`."""
        found = super().to_dict()
        for step in found["steps"]:
            added = (step["added"] or "").split(" + ")
            kin = {other for c in self.candidates if c["effect"] in added for other in c["indistinguishable_from"]}
            step["alternatives"] = [{"effect": c["effect"]} for c in self.candidates if c["effect"] in kin]
        for line, row in zip(found["rows"], self.rows, strict=True):
            line["heldout_nrmse_with_gas"] = make_plain(row.heldout_gas)
        return {**found, **make_plain({"candidates": self.candidates, "where": self.where, "fixed": self.fixed})}


def judge_campaign(campaign, model: str = "paper", *, reference: Any = None, **options) -> AbstractJudgement:
    """Judge a campaign read by `read_campaign` that holds peaks only: `peak_normal_force` or `peak_friction_force`.

    Args:
        campaign: of the family `impact` or `slip`.
        model: names the reference model, see `ddetumble.inference.models`, unless `reference` is one.
        reference: the reference model itself.
        **options: go to `judge_peaks` or `judge_friction`: `effects`, `window`, `assumed`, `level`.

    Returns:
        A `PeakJudgement`, or for friction forces a `FrictionJudgement`; both have `verdict`, `sentence`, `rows`,
        `table()` and `to_dict()`.

    Raises:
        InputError: There is no such model, it is of another family, or the campaign holds neither column.
    """
    from .._errors import InputError
    from ..families import find_family
    from ..inference.archive import resolve_model

    extra = ()
    if reference is None:
        resolved = resolve_model(model, campaign.family)
        reference, extra = resolved.reference, resolved.effects
    find_family(campaign.family).require_model(reference, campaign.name)
    measured = () if campaign.peaks is None else campaign.peaks.columns
    slip = "peak_friction_force" in measured and "normal_load" in campaign.conditions
    name = "peak_friction_force" if slip else "peak_normal_force"
    if name not in measured:
        raise InputError(f"campaign {campaign.name} has nothing to judge: it has no column peak_normal_force, and no "
                         "peak_friction_force with normal_load")
    frame = campaign.records.join(campaign.peaks, how="inner").dropna(subset=[name])
    peaks, stated = frame[name].to_numpy(), campaign.uncertainty(name)
    options.setdefault("assumed", tuple(n for n, column in campaign.conditions.items() if column.assumed))
    options |= dict(sd=None if stated is None else stated.sd(peaks), campaign=campaign.name, model=model,
                    reference=reference, printed=frame.get(f"printed_{name}"))
    if slip:
        # What else is known of a stroke does not reach a single force; repeats are strokes equal in these.
        known = [one for one in ("normal_load", "internal_pressure", "slip_speed") if one in frame]
        judged = judge_friction({one: frame[one].to_numpy() for one in known}, peaks, **options)
    else:
        conditions = {one: frame[one].to_numpy() for one in campaign.conditions}
        judged = judge_peaks(conditions, peaks, repeats=frame.get("repeats"), **options)
    if not extra:
        return judged
    left = (f"The model's own effects ({', '.join(e.id for e in extra)}) are left out: the peaks are compared "
            "with its reference model, fitted anew.")
    return dc.replace(judged, notes=(left, *judged.notes))


def judge_peaks(
    conditions: Mapping[str, np.ndarray], peaks: np.ndarray, *, printed: np.ndarray | None = None,
    repeats: np.ndarray | None = None, sd: np.ndarray | None = None, campaign: str = "", model: str = "paper",
    reference: AbstractReference | None = None, effects: Sequence[type[AbstractEffect]] | None = None,
    window: float = WINDOW, assumed: Sequence[str] = (), level: float = LEVEL,
) -> PeakJudgement:
    """Compare, rank and judge on peaks alone: models side by side with each record left out in turn.

    Args:
        conditions: arrays of shape (records,), SI: `initial_pressure`, absolute, `approach_speed`, and any further.
        peaks: measured peak normal force, shape (records,) [N].
        printed: what the source's own model predicted [N], if anything.
        repeats: how many impacts each value is the mean of, if stated.
        sd: standard deviation of each value [N], if stated; else the scatter about a low polynomial is taken.
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

    reference = Ball() if reference is None else reference
    forces = gather_forces(conditions, "initial_pressure", peaks, sd)
    chosen, left_out = choose_effects(IMPACT if effects is None else effects, reference, forces.conditions)
    rivals = judge_rivals(forces, printed)
    bench = Bench(reference, chosen, forces, window)
    bench.choose_free()
    base = bench.solve([Recipe("our model, from pressure alone", "reference", (), bench.free)])[0]
    gauge = "initial_pressure" in assumed or bool(np.any(forces.x == 0))
    singles = bench.add_effects(base)
    steps, pairs = bench.grow(base, singles, level)
    readings = bench.read_as_gauge(steps[-1]) if gauge else []
    candidates = rank_candidates(bench, base, singles)
    singles, pairs, low = sorted(singles, key=_order), sorted(pairs, key=_order), rivals[-1]
    finalists = [row for row in singles if row.physical and row.heldout < 0.15][:4]
    differences = [compare_rows(row, low)
                   for row in {r.label: r for r in (*steps, *finalists, *pairs[:4])}.values()]
    differences += [compare_rows(b, a) for k, a in enumerate(finalists) for b in finalists[k + 1:]]
    judged = PeakJudgement(
        campaign=campaign, model=model, verdict=decide_verdict(steps, could_show(bench, base, level), level),
        forces=forces, rows=(*rivals, base, *readings, *singles, *pairs), steps=tuple(steps), reference=base,
        polynomial=low, pairs=tuple(differences), candidates=tuple(candidates),
        where=locate_misfit(base), left_out=left_out, fixed=bench.fixed, contact=bench.contact(steps[-1]), level=level)
    return dc.replace(judged, sentence=_describe(judged),
                      notes=_list_notes(judged, "initial_pressure" in assumed, repeats))


def fit_exponent(forces: Forces) -> tuple[float, float]:
    r"""Exponent $p$ of $F \propto P_0^p$ over the records with gas, and its standard error; nan of two pressures."""
    some = forces.x > 0
    if len(np.unique(forces.x[some])) < 3:
        return float("nan"), float("nan")
    (slope, _), covariance = np.polyfit(np.log(forces.x[some]), np.log(forces.peaks[some]), 1, cov=True)
    return float(slope), float(np.sqrt(covariance[0, 0]))


def _order(row: PeakRow) -> float:
    return row.heldout if np.isfinite(row.heldout) else np.inf


def _describe(judged: PeakJudgement) -> str:
    first = judged.effects[:1]
    seen = {effect for row in judged.rows if row.physical for effect in row.effects}
    twins = [twin for c in judged.candidates if (c["effect"],) == first for twin in c["indistinguishable_from"]]
    return say("peaks.peaks", j=judged, twins=[twin for twin in twins if twin in seen],
               gap=compare_rows(judged.steps[-1], judged.polynomial))


def _list_notes(judged: PeakJudgement, assumed: bool, repeats: np.ndarray | None) -> tuple[str, ...]:
    pressures, low = judged.forces.x, judged.polynomial
    zero = judged.peaks[pressures == 0]
    gauge = next((row for row in judged.rows if row.kind == "reading" and not row.effects), None)
    times, ratios = judged.contact
    some = (pressures > 0) & (ratios > 0)
    level = []  # pairs of effects that hold out as well as the polynomial
    for row in judged.rows:
        gap = compare_rows(row, low)
        if row.kind == "pair" and row.heldout < 2 * low.heldout and gap.difference < gap.standard_error:
            level.append(row)
    return tuple(tell(
        "peaks.peaks_notes", j=judged, assumed=assumed, zero=zero.max() if zero.size else None, gauge=gauge,
        gauge_row=None if gauge is None else gauge.fitted[np.argmin(pressures)],
        repeats=int(np.min(repeats)) if repeats is not None and np.all(repeats > 1) else None,
        times=times[some] if len(judged.steps) > 1 and some.any() else None, ratios=ratios[some], level=level))
