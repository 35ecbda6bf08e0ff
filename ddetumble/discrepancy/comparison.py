"""One model beside the measurements: how large the error is against the noise, and what it depends on."""

import dataclasses as dc
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from .._errors import InputError
from ..contact.effect import parameters_of
from ..inference.archive import resolve_model
from ..inference.families import Family, find_family, name_family
from ..inference.files import make_plain, write_json
from ..inference.models import is_fitted
from ..inference.parameters import to_coordinate
from ..measurement.campaign import Campaign
from ..measurement.package import read_campaign
from ..measurement.thinning import thin_campaign
from .places import residual_places
from .records import Estimate, LackOfFit, Place, SettingShift, Trace, list_shifts
from .shifts import hold_settings, is_moved, measure_shifts
from .steps import describe_noise, public_estimates
from .traces import list_channels, make_traces, measure_error, noise_nrmse, nrmse, nrmse_by_channel
from .wording import describe_moves, describe_place, find_longest
from .workbench import Workbench


BINS = 12
MANY = 1_000_000  # samples that are looked at: a minute or two


@dc.dataclass(frozen=True)
class Comparison:
    """A model held against a campaign.

    Attributes:
        campaign, title, sha256, model: names; `fitted` the parameters that were refitted.
        sentence: the outcome in words.
        lack_of_fit: whether something is missing.
        chi2_reduced: of the whitened residuals and setting errors.
        nrmse, noise_nrmse: rms residual over rms signal, and what noise alone leaves of it.
        channels, records, conditions: errors, one row each: `rms` [SI], `ratio` (to the noise), `bias` [SI], `nrmse`,
            `samples`; records with their conditions and `chi2_reduced`; conditions are groups of equal settings.
        residuals: binned residuals over their noise: `channel`, `variable` (`time` as a share of the contact,
            `depression`, `depression_rate`, every condition), `phase`, `low`, `high`, `mean`, `standard_error`,
            `records`, `samples`.
        parameters: estimates of what was refitted.
        where: places that hold most of the misfit.
        noise: by channel.
        traces: model beside measurement, every record and channel.
        shifts: how far the settings of the records were moved.
        held_nrmse: `nrmse` with every condition as it is written down; None where no setting was moved beyond chance.
        notes: sentences on records outside the model's range, and on samples that were not taken.
    """

    campaign: str
    title: str
    sha256: str
    model: str
    fitted: tuple[str, ...]
    sentence: str
    lack_of_fit: LackOfFit
    chi2_reduced: float
    nrmse: float
    noise_nrmse: float
    channels: pd.DataFrame
    records: pd.DataFrame
    conditions: pd.DataFrame
    residuals: pd.DataFrame
    parameters: Mapping[str, Estimate]
    where: tuple[Place, ...]
    noise: Mapping[str, Mapping[str, Any]]
    traces: tuple[Trace, ...]
    shifts: tuple[SettingShift, ...] = ()
    held_nrmse: float | None = None
    notes: tuple[str, ...] = ()

    def text(self) -> str:
        """The outcome for a terminal."""
        parts = ["\n".join((self.sentence, *(f"- {note}" for note in self.notes)))]
        for title, table in (("By channel", self.channels), ("By condition", self.conditions),
                             ("By record", self.records)):
            parts.append(f"{title}:\n" + table.to_string(index=False, float_format="{:.4g}".format))
        rows = [(f"  {name} = {e.estimate:.6g} +- {e.sd:.2g} {e.unit}" if e.sd > 0 else
                 f"  {name} = {e.estimate:.6g} {e.unit} (at a limit, or not determined)").rstrip()
                for name, e in self.parameters.items()]
        if rows:
            parts.append("\n".join(["Refitted:", *rows]))
        if self.shifts:
            parts.append("\n".join(["Settings moved by the fit, in stated deviations:", *(
                f"  {s.name}: {s.rms:.2g} rms, {s.largest:+.2g} at most (record {s.record})" for s in self.shifts)]))
        parts.append("\n".join(["Noise:", *(f"  {c}: {n['sd']:.3g}, {n['text']}" for c, n in self.noise.items())]))
        return "\n\n".join(parts)

    def to_dict(self) -> dict[str, Any]:
        """Everything but the traces, as JSON can hold it."""
        plain = {}
        for field in dc.fields(self):
            value = getattr(self, field.name)
            if field.name not in ("traces", "shifts"):
                plain[field.name] = value.to_dict("records") if isinstance(value, pd.DataFrame) else value
        return make_plain({**plain, "nuisances": list_shifts(self.shifts)})

    def save(self, folder) -> Path:
        """Write `compare.json` into a folder; returns its path."""
        path = Path(folder) / "compare.json"
        write_json(path, self.to_dict())
        return path


def compare(campaign: Campaign | str | Path, model: str = "paper", *, refit: bool = True) -> Comparison:
    """Hold a model against a campaign.

    Mass, restitution and whatever else a reference model leaves free are fitted to the campaign first; a fitted model
    (a folder) is taken with its own values. Each record's conditions and time origin may move within their stated
    uncertainty.

    Args:
        campaign: with samples, or its folder.
        model: see `ddetumble.inference.models`.
        refit: False takes a reference model's own values too.

    Raises:
        InputError: the campaign cannot be used, for one because it holds peaks only (`ddetumble.paper.judge_campaign`
            reads those).
        ComputationError: the model could not be integrated.
    """
    if not isinstance(campaign, Campaign):
        campaign = read_campaign(campaign)
    catalogue = find_family(name_family(campaign), "compare").catalogue
    resolved = resolve_model(model, name_family(campaign))
    extra = [type(e) for e in resolved.effects if type(e) not in catalogue]
    campaign, thinned = thin_campaign(campaign, MANY)
    bench = Workbench(campaign, resolved.reference, extra)
    for effect in resolved.effects:
        if type(effect) not in bench.catalogue:
            missing = [n for n in effect.requires if n not in (*resolved.reference.provides, *campaign.records.columns)]
            raise InputError(f"the model's effect {effect.id!r} needs {', '.join(missing)}, which campaign "
                             f"{campaign.name!r} does not have")
        for p in parameters_of(effect):
            value = to_coordinate(p.coordinate, float(getattr(effect, p.field)))
            bench.start[bench.space.index[f"{effect.id}.{p.name}"]] = value
    if not refit or is_fitted(model):
        # What was fitted elsewhere holds against what this campaign says is known.
        own = {n: v for n, v in zip(bench.space.index, bench.space.coordinates(), strict=True)
               if bench.space.slots[bench.space.index[n]].owner is None}
        if is_fitted(model):
            for name, value in own.items():
                bench.start[bench.space.index[name]] = value
        bench.base = [common.slot.name for common in bench.space.commons]
    fitted = bench.begin()
    fitted = dc.replace(fitted, effects=tuple(e.id for e in resolved.effects))
    lack, _ = bench.judge(fitted)
    solution = fitted.solution
    # What a model that fails leaves is no measure of the noise: there the stated size counts.
    level = {c: dc.replace(n, sd=n.stated_sd or n.sd) for c, n in bench.noise.items()} if lack.rejected else bench.noise
    traces = make_traces(campaign, bench.records, solution, level)
    used = (np.asarray(bench.records.stack.weights)[: bench.records.count] > 0)
    records = _by_record(campaign, traces)
    chi2 = np.sum(solution.residual.reshape(bench.records.count, -1) ** 2, axis=1) + np.sum(solution.z**2, axis=1)
    records["chi2_reduced"] = chi2 / np.maximum(used.sum(axis=(1, 2)), 1)
    channels = _by_channel(traces)
    end = dict(zip(bench.records.keys, solution.end, strict=True))
    residuals = bin_residuals(traces, end, campaign, bench.family)
    where = tuple(residual_places(bench, fitted))
    degrees = max(float(used.sum()) - len(solution.names), 1.0)
    name = resolved.name if not is_fitted(model) else str(Path(model).name)
    shifts, floor = measure_shifts(bench.records, solution), noise_nrmse(traces)
    held = None
    if is_moved(shifts):
        held = measure_error(bench.records, hold_settings(bench.problem, solution).channels)
    return Comparison(
        campaign.name, campaign.title, campaign.sha256, model, tuple(solution.names),
        _say(name, campaign, traces, channels, records, where, lack, shifts, held, floor), lack,
        float(solution.chi2) / degrees, nrmse(traces), floor, channels, records,
        _by_condition(campaign, traces, bench.groups), residuals,
        public_estimates(bench, solution) if solution.names else {}, where, describe_noise(bench), traces,
        shifts, held, (*bench.warnings, *filter(None, [thinned])))


def _by_channel(traces: Sequence[Trace]) -> pd.DataFrame:
    rows = []
    for channel in list_channels(traces):
        own = [t for t in traces if t.channel == channel]
        rows.append({"channel": channel, "unit": own[0].unit, **_errors(own)})
    return pd.DataFrame(rows)


def _errors(traces: Sequence[Trace]) -> dict[str, float]:
    """Errors over traces of one channel."""
    left = np.concatenate([t.measured - t.model for t in traces])
    left = left[np.isfinite(left)]
    if not len(left):
        return {"rms": np.nan, "ratio": np.nan, "bias": np.nan, "nrmse": np.nan, "samples": 0}
    rms = float(np.sqrt(np.mean(left**2)))
    return {"rms": rms, "ratio": rms / traces[0].sd, "bias": float(left.mean()),
            "nrmse": next(iter(nrmse_by_channel(traces).values())), "samples": len(left)}


def _join_channels(traces: Sequence[Trace]) -> dict[str, float]:
    """Error over noise of all channels together, and of each where there are several."""
    ratios = {c: _errors([t for t in traces if t.channel == c]) for c in list_channels(traces)}
    if len(ratios) == 1:
        return next(iter(ratios.values()))
    found = {"ratio": float(np.sqrt(np.nanmean([e["ratio"] ** 2 for e in ratios.values()]))), "nrmse": nrmse(traces)}
    return found | {f"ratio_{c}": e["ratio"] for c, e in ratios.items()}


def _by_record(campaign: Campaign, traces: Sequence[Trace]) -> pd.DataFrame:
    rows = []
    for key in campaign.record_keys:
        own = [t for t in traces if t.record == str(key)]
        rows.append({"record": str(key), **own[0].conditions, **_join_channels(own)})
    return pd.DataFrame(rows)


def _by_condition(campaign: Campaign, traces: Sequence[Trace], groups: np.ndarray) -> pd.DataFrame:
    """Errors by group of equal settings; each condition is the mean over the group."""
    rows = []
    for group in np.unique(groups):
        keys = [str(k) for k, g in zip(campaign.record_keys, groups, strict=True) if g == group]
        own = [t for t in traces if t.record in keys]
        means = campaign.records.iloc[np.flatnonzero(groups == group)].mean()
        means = {str(n): float(v) for n, v in means.items() if n != "sequence"}
        rows.append({**means, "records": len(keys), **_join_channels(own)})
    # Settings scatter about nominal values: they are put in order by two digits.
    named = [c for c in rows[0] if c in campaign.conditions]
    return pd.DataFrame(sorted(rows, key=lambda row: [float(f"{row[c]:.2g}") for c in named]))


def bin_residuals(traces: Sequence[Trace], end: Mapping[str, float], campaign: Campaign, family: Family
                  ) -> pd.DataFrame:
    """Mean residual over noise in bins of every variable; standard errors from the scatter between records.

    Args:
        traces: model beside measurement.
        end: of the contact or record, in its independent variable.
        campaign: gives the conditions.
        family: names the variables.
    """
    rows = []
    for channel in list_channels(traces):
        own = [t for t in traces if t.channel == channel]
        z = [(t.measured - t.model) / t.sd for t in own]
        # (variable, phase) to the value of it and where it counts, one pair a record.
        views: dict[tuple[str, str], list[tuple[np.ndarray, np.ndarray]]] = {
            (own[0].independent, "both"): [(t.time / end[t.record], t.time > 0) for t in own],
            (family.rate, "both"): [(t.state_rate, t.state > 0) for t in own]}
        for phase, sign in zip(family.phases, (1.0, -1.0), strict=True):
            views[family.state, phase] = [(t.state, (t.state > 0) & (sign * t.state_rate > 0))
                                          for t in own]
        for name in campaign.conditions:
            views[name, "both"] = [(np.full(len(t.time), t.conditions[name]), t.state > 0) for t in own]
        for (variable, phase), pairs in views.items():
            rows += [{"channel": channel, "variable": variable, "phase": phase, **row} for row in _bin(z, pairs)]
    return pd.DataFrame(rows)


def _bin(z: list[np.ndarray], pairs: list[tuple[np.ndarray, np.ndarray]]) -> list[dict[str, float]]:
    """Bins of one variable that hold samples."""
    keep = [inside & np.isfinite(r) for r, (_, inside) in zip(z, pairs, strict=True)]
    values = [x[k] for (x, _), k in zip(pairs, keep, strict=True)]
    everything = np.concatenate(values)
    if not len(everything) or np.ptp(everything) == 0:
        return []
    edges = np.linspace(everything.min(), everything.max(), BINS + 1)
    count, total = np.zeros((len(z), BINS)), np.zeros((len(z), BINS))
    for i, (r, k, x) in enumerate(zip(z, keep, values, strict=True)):
        bin_ = np.clip(np.digitize(x, edges) - 1, 0, BINS - 1)
        count[i], total[i] = np.bincount(bin_, minlength=BINS), np.bincount(bin_, r[k], minlength=BINS)
    rows = []
    for b in np.flatnonzero(count.sum(axis=0) > 0):
        there = count[:, b] > 0
        n = float(count[:, b].sum())
        mean = float(total[:, b].sum() / n)
        error = 1.0 / np.sqrt(n)
        if there.sum() > 1:
            # Records are the independent units: their means scatter about the common one.
            scatter = total[there, b] - mean * count[there, b]
            error = float(np.sqrt(there.sum() / (there.sum() - 1) * np.sum(scatter**2)) / n)
        rows.append({"low": float(edges[b]), "high": float(edges[b + 1]), "mean": mean, "standard_error": error,
                     "records": int(there.sum()), "samples": int(n)})
    return rows


def _say(model: str, campaign: Campaign, traces: Sequence[Trace], channels: pd.DataFrame, records: pd.DataFrame,
         where: Sequence[Place], lack: LackOfFit, shifts: Sequence[SettingShift], held: float | None, floor: float
         ) -> str:
    """The outcome in words."""
    ratio = float(np.sqrt(np.mean(channels["ratio"] ** 2)))
    worst = records.loc[records["ratio"].idxmax()]
    setting = []
    for name, unit, scale in (("initial_pressure", "MPa", 1e-6), ("approach_speed", "m/s", 1.0),
                              ("tangential_speed", "m/s along", 1.0), ("normal_load", "N", 1.0),
                              ("internal_pressure", "MPa", 1e-6), ("slip_speed", "m/s", 1.0)):
        if name in campaign.conditions:
            setting.append(f"{worst[name] * scale:.3g} {unit}, ")
    if not lack.rejected:
        return (f"Nothing is missing as far as this campaign shows. The model {model!r} leaves {ratio:.2f} times the "
                f"noise (p = {lack.p_value:.2g}).")
    moved, apart = describe_moves(shifts), ""
    if moved:
        start = "" if held is None or not np.isfinite(held) else (
            f"it leaves {held / max(floor, 1e-300):.2f} times with the settings as they are written down, as ")
        apart = f" {start[:1].upper()}{start[1:]}{moved}." if start else f" {moved[:1].upper()}{moved[1:]}."
    place = ""
    if where:
        sizes = dict(zip(channels["channel"], channels["ratio"], strict=True))
        spot = max(where, key=lambda w: (sizes.get(w.channel, 0.0), w.share))
        place = f" The misfit sits in the {describe_place(spot, find_longest(traces))}."
    return (f"Something is missing: the model {model!r} leaves {ratio:.2f} times the noise.{apart} Worst is record "
            f"{worst['record']} ({''.join(setting)}{worst['ratio']:.3g} times the noise).{place}")
