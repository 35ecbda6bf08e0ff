"""Models beside the measurements: how large the error is against the noise, what it depends on, which does best."""

import dataclasses as dc
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, overload

import numpy as np
import pandas as pd

from .._display import Progress, stay_silent
from .._errors import ComputationError, InputError
from .._sentences import Sentence, say
from .._user_files import split_name
from ..contact.effect import is_absent
from ..families import Family, find_family, name_family, open_campaign
from ..inference.archive import FittedModel, Model, resolve_model, take_fitted
from ..inference.estimation import fit
from ..inference.files import AbstractWritten, list_fields, make_plain
from ..inference.identifiability import list_disputed
from ..inference.noise_estimation import NOISE, differs_from_stated
from ..measurement.campaign import Campaign, label_conditions, thin_campaign
from ..measurement.faults import Fault, keep_samples, screen_samples
from ..measurement.quantities import describe_quantity, format_quantity, join_words
from .cross_validation import compare_losses
from .describe import describe_noise, measure_held, public_estimates
from .lack_of_fit import is_moved, measure_shifts
from .localise import residual_places
from .problem import Fitted, PredictionError, SelectionProblem, fit_reference, pose_selection
from .result import Estimate, LackOfFit, Place, SettingShift, Trace, list_shifts
from .saturation import find_saturation, tell_saturation
from .sequential import Sequential, follow_records
from .series import have_predictions, list_channels, make_traces, measure_ratio, nrmse, split_error
from .settings import DEFAULT
from .text import describe_place, tells_nothing
from .verdict_facts import describe_level, find_longest


APART = 4.0  # times the chi-square of any other, per sample, from which on a record is the first to look at
BINS = 12  # of a variable: fewer hide where a misfit begins, more are their own noise
# Of chi-square and p-value of one model, which need not be those that `discover` gives of it.
UNDER = ("under the noise measured from its own residuals, with all records; `discover` takes one noise for all its "
         "models, from what the best of them leaves, and leaves faulty records out, so its p-values can differ")
MANY = 1_000_000  # samples that are looked at: a minute or two, and 2.5 GB of memory


@dc.dataclass(frozen=True)
class Comparison(AbstractWritten):
    """A model compared with a campaign; errors are RMS residuals over the RMS of the signal.

    Attributes:
        campaign, title, sha256, model: names; `fitted` the parameters that were refitted.
        sentence: the outcome in words.
        lack_of_fit: whether something is missing.
        chi2_reduced: of the whitened residuals and setting errors, as by `fit`: under the noise measured from the
            residuals of this model, where `discover` takes one noise for all its models.
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
        held_nrmse, held_ratio: `nrmse` and the error over the noise with every condition as it is written down; None
            where no setting was moved beyond chance.
        notes: sentences on records outside the model's range, on samples that were not taken, and on `faults`.
        faults: what is wrong with the samples themselves, which are taken as they are.
        effects: ids of the effects in the model.
        heldout_nrmse: the cross-validated error; of a model that was fitted to another campaign `nrmse` itself, as none
            of these records chose it. NaN where there are too few conditions, or nothing was fitted.
        prediction_nrmse, prediction_coverage: the prediction error from settings as they are written down, and the
            share of samples within the predicted 95 % interval; NaN for a model of another campaign.
        heldout_squares: of the cross-validated error, by record: their sum is its square, shape (records,).
        heldout_losses: cross-validated deviance of every record, in noise variances, shape (records,).
        groups: condition of every record, shape (records,).
        converged: state of the optimiser.
        free: number of parameters that these records chose, here or before.
        sequential: evidence against the model after every record, which may be looked at at any time.
    """

    file: ClassVar[str] = "compare.json"
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
    held_ratio: float | None = None
    notes: tuple[str, ...] = ()
    faults: tuple[Fault, ...] = ()
    effects: tuple[str, ...] = ()
    heldout_nrmse: float = float("nan")
    prediction_nrmse: float = float("nan")
    prediction_coverage: float = float("nan")
    heldout_squares: np.ndarray = dc.field(default_factory=lambda: np.zeros(0), repr=False, compare=False)
    heldout_losses: np.ndarray = dc.field(default_factory=lambda: np.zeros(0), repr=False, compare=False)
    groups: np.ndarray = dc.field(default_factory=lambda: np.zeros(0, dtype=int), repr=False, compare=False)
    converged: bool = True
    free: int = 0
    sequential: Sequential | None = None

    @property
    def names_conditions(self) -> bool:
        """Whether rows of `conditions` say which condition they are of: tests that start freely have none."""
        return list(self.conditions.columns).index("records") > 0  # which stands behind the conditions

    def _name_units(self, table: pd.DataFrame) -> pd.DataFrame:
        """A table with its settings, and errors of channels that share a unit, in units that its headings name."""
        units, settings = set(self.channels["unit"]), list(self.conditions.columns)
        headings = {name: f"{name} [{one}]" for one in units - {"1"} if len(units) == 1 and "channel" not in table
                    for name in ("rms", "bias")}
        shown = table.copy()
        for name in settings[: settings.index("records")]:
            if name in shown:
                own = describe_quantity(name, shown[name].to_numpy(dtype=float))
                shown[name], headings[name] = own.scale * shown[name], own.label
        return shown.rename(columns=headings)

    def __str__(self) -> str:
        """The outcome for a terminal."""
        parts = ["\n".join((self.sentence, *(f"- {note}" for note in self.notes)))]
        for title, table in (("By channel", self.channels), ("By condition", self.conditions),
                             ("By record", self.records)):
            if title != "By condition" or self.names_conditions:  # rows without a name say less than those by record
                shown = self._name_units(table)
                parts.append(f"{title}:\n" + shown.to_string(index=False, float_format="{:.4g}".format))
        rows = [(f"  {name} = {e.estimate:.6g} +- {e.sd:.2g} {e.unit}" if e.sd > 0 else
                 f"  {name} = {e.estimate:.6g} {e.unit} (at a limit, or not determined)").rstrip()
                for name, e in self.parameters.items()]
        if rows:
            parts.append("\n".join(["Refitted:", *rows]))
        if self.shifts:
            parts.append("\n".join(["Settings shifted by the fit, in stated standard deviations:", *(
                f"  {s.name}: {s.rms:.2g} RMS, {s.largest:+.2g} largest (record {s.record})" for s in self.shifts)]))
        if np.isfinite(self.heldout_nrmse):
            predicted = f"; prediction with settings as written down: {100 * self.prediction_nrmse:.2f} %"
            predicted = predicted if have_predictions([self]) else ""
            if np.isfinite(self.prediction_coverage):
                predicted += f", {100 * self.prediction_coverage:.0f} % of samples within the 95 % interval"
            parts.append(f"Error: {100 * self.nrmse:.2f} % fitted, {100 * self.heldout_nrmse:.2f} % cross-validated, "
                         f"{100 * self.noise_nrmse:.2f} % noise{predicted}.")
        if self.sequential is not None:
            parts.append(str(self.sequential))
        units = dict(zip(self.channels["channel"], self.channels["unit"].replace("1", ""), strict=True))
        parts.append("\n".join(["Noise:", *(f"  {c}: {n['sd']:.3g} {units.get(c, '')}".rstrip() + f", {n['text']}"
                                              for c, n in self.noise.items()),
                                f"The model is judged {UNDER}."]))
        return "\n\n".join(parts)

    def to_dict(self) -> dict[str, Any]:
        """Everything but the traces, as JSON can hold it."""
        plain = list_fields(self, "traces", "shifts", "heldout_squares", "heldout_losses", "groups")
        rows = {name: table.to_dict("records") for name, table in plain.items() if isinstance(table, pd.DataFrame)}
        return make_plain({**plain, **rows, "nuisances": list_shifts(self.shifts)})


@dc.dataclass(frozen=True)
class Beaten:
    """A model that fits worse than another beyond chance, with cross-validated errors within two standard errors.

    It shows significant lack of fit, and its cross-validated deviance is larger by more than chance, as `discover`
    judges it.
    """

    model: int  # number of the worse one
    other: int  # and of the better one
    refuted: bool  # whether the better one shows no lack of fit: then the data reject the worse one alone
    difference: float  # of their cross-validated deviances, in noise variances
    records: tuple[str, ...]  # the fewest that hold most of the difference of the errors, the largest first


@dc.dataclass(frozen=True)
class Comparisons(Sequence[Comparison], AbstractWritten):
    """Several models compared with one campaign, in the order in which they were given: the loop by hand.

    Attributes:
        models: the comparison of each.
        names: of the models.
        best: number of the one with the smallest cross-validated error; None where that is not known.
        alike: numbers of those whose cross-validated error is not larger than its by two standard errors of the paired
            difference over conditions.
        beaten: those of these and the best that fit worse than another beyond chance, with errors so near.
        failed: why a model could not be compared, by its name; these are not among `models`.
        sentence: the outcome in words.
    """

    file: ClassVar[str] = "compare.json"
    models: tuple[Comparison, ...]
    names: tuple[str, ...]
    best: int | None
    alike: tuple[int, ...]
    sentence: str
    beaten: tuple[Beaten, ...] = ()
    failed: Mapping[str, str] = dc.field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.models)

    def __getitem__(self, k):
        return self.models[k]

    @property
    def traces(self) -> dict[str, list[Trace]]:
        """Records beside each model, by its name, as figures take them."""
        return {name: list(one.traces) for name, one in zip(self.names, self.models, strict=True)}

    @property
    def failures(self) -> list[str]:
        """Which models could not be compared, and why, a sentence each."""
        return [f"{name} could not be compared: {why.rstrip('.')}." for name, why in self.failed.items()]

    @property
    def notes(self) -> list[str]:
        """What the comparisons note, with the models before it where it does not hold for all of them."""
        told = {note: [name for name, one in zip(self.names, self.models, strict=True) if note in one.notes]
                for one in self.models for note in one.notes}
        return [*self.failures, *(note if len(names) == len(self.models) else f"{join_words(names)}: {note}"
                                  for note, names in told.items())]

    @property
    def table(self) -> pd.DataFrame:
        """One row a model: errors (rms over rms signal), noise, and whether significant lack of fit is left."""
        return pd.DataFrame([{
            "model": name, "free": one.free, "chi2_reduced": one.chi2_reduced, "nrmse": one.nrmse,
            "heldout_nrmse": one.heldout_nrmse, "prediction_nrmse": one.prediction_nrmse,
            "prediction_coverage": one.prediction_coverage, "noise_nrmse": one.noise_nrmse,
            "p_value": one.lack_of_fit.p_value, "rejected": one.lack_of_fit.rejected, "converged": one.converged}
            for name, one in zip(self.names, self.models, strict=True)])

    def __str__(self) -> str:
        """The outcome for a terminal."""
        shown = self.table
        for name in ("nrmse", "heldout_nrmse", "prediction_nrmse", "prediction_coverage", "noise_nrmse"):
            shown[name] = [f"{100 * x:.2f} %" if np.isfinite(x) else "–" for x in shown[name]]
        shown["misfit left"] = [f"{'yes' if x else 'no'} (p {'< 1e-6' if p < 1e-6 else f'{p:.2g}'})"
                                for x, p in zip(shown["rejected"], shown["p_value"], strict=True)]
        same = [] if have_predictions(self.models) else ["prediction_nrmse"]
        shown = shown.drop(columns=["rejected", "p_value", "converged", *same]).rename(columns={
            "chi2_reduced": "chi2/dof", "heldout_nrmse": "cross-validated", "prediction_nrmse": "predicted",
            "prediction_coverage": "coverage", "noise_nrmse": "noise"})
        return "\n\n".join(["\n".join((self.sentence, *(f"- {note}" for note in self.notes))),
                            shown.to_string(index=False, float_format="{:.4g}".format),
                            f"Each model is fitted and judged {UNDER}."])

    def to_dict(self) -> dict[str, Any]:
        """Everything but the fitted series, as JSON can hold it."""
        return make_plain({"sentence": self.sentence, "names": self.names, "best": self.best, "alike": self.alike,
                           "beaten": self.beaten, "failed": self.failed,
                           "models": [one.to_dict() for one in self.models]})


@overload
def compare(campaign: Campaign | str | Path, model: Model = "paper", /, *, refit: bool = True,
            progress: Progress | None = None) -> Comparison: ...


@overload
def compare(campaign: Campaign | str | Path, model: Model, second: Model, /, *others: Model, refit: bool = True,
            progress: Progress | None = None) -> Comparisons: ...


def compare(campaign, *models, refit=True, progress=None):
    """Compare models with a campaign: residuals, lack of fit, and cross-validated errors.

    A reference model has mass, restitution and whatever else it leaves free fitted to the campaign first; so has one
    with effects that stand at their null, such as `Ball() + Adhesion()`, effects and all, as by `fit`. A fitted model
    (a fit, a discovery, a folder) is taken with its own values. Each record's conditions and time origin may move
    within their stated uncertainty.

    Args:
        campaign: measured, or its folder.
        *models: by name, in hand, or fitted, as for `fit`; the paper's where none is given. For each one more step of
            the loop: `compare(data, model, model + Adhesion())`.
        refit: False takes a reference model's own values too.
        progress: called with a sentence and the share done.

    Returns:
        A `Comparison` of one model; of several `Comparisons`, with a table of their errors and one sentence. One of
        several that cannot be computed is left out, and `failed` says why.

    Raises:
        InputError: the campaign cannot be used.
        ComputationError: a model could not be integrated.
    """
    report = progress or stay_silent
    campaign = open_campaign(campaign)
    find_family(name_family(campaign), "compare")
    names = [name_model(model, name_family(campaign)) for model in models or ("paper",)]
    names = [f"{name} ({k + 1})" if name in names[:k] else name for k, name in enumerate(names)]
    found: dict[str, Comparison] = {}
    failed: dict[str, Exception] = {}
    for k, (name, model) in enumerate(zip(names, models or ("paper",), strict=True)):
        report(f"comparing {name}", k / len(names))
        try:
            found[name] = _compare_one(campaign, model, name, refit)
        except (InputError, ComputationError) as error:  # the others are compared all the same
            failed[name] = error
    if not found:
        raise next(iter(failed.values()))
    if len(names) == 1:
        return found[names[0]]
    return dc.replace(conclude(tuple(found.values()), tuple(found)),
                      failed={name: str(error) for name, error in failed.items()})


def name_model(model: Model, family: str) -> str:
    """A model in few words: name of its reference model or folder, and its effects."""
    resolved = resolve_model(model, family)
    if isinstance(model, (str, Path)) and resolved.fitted:
        return Path(model).name
    own = split_name(resolved.name)  # one of the user's own, which is `FILE.py:NAME`
    name = resolved.name if own is None else own[1]
    return name if isinstance(model, (str, Path)) else " + ".join([name, *(e.id for e in resolved.effects)])


def _compare_one(campaign: Campaign, model: Model, name: str, refit: bool) -> Comparison:
    """One model beside the measurements."""
    resolved = resolve_model(model, name_family(campaign))
    faults = keep_samples(screen_samples(campaign)[1])
    campaign, thinned = thin_campaign(campaign, MANY)
    given = resolved.fitted
    saved: FittedModel | None = None
    told: tuple[str, ...] = ()
    if given:
        saved = take_fitted(model)  # type: ignore[arg-type]
    elif refit and any(is_absent(e) for e in resolved.effects):
        grown = fit(campaign, model)
        told, saved = grown.notes, grown.fitted_model()
        resolved = resolve_model(saved, name_family(campaign))
    own = saved.free if saved is not None and saved.sha256 == campaign.sha256 else None  # chosen by these records
    bench = pose_selection(campaign, resolved.reference, (), resolved.effects, fit_given=False)
    if not refit or resolved.fitted:
        # What was fitted elsewhere holds against what this campaign says is known.
        start = bench.start.copy()
        if resolved.fitted:
            for slot, value in zip(bench.space.slots, bench.space.coordinates(), strict=True):
                if slot.owner is None:
                    start[bench.space.index[slot.name]] = value
        bench = dc.replace(bench, start=start, base=tuple(common.slot.name for common in bench.space.commons))
    bench, fitted = fit_reference(bench)
    if own is not None and saved is not None:
        bench, fitted = _take_noise(bench, fitted, saved)
    fitted = dc.replace(fitted, effects=tuple(e.id for e in resolved.effects))
    lack, _ = bench.test_lack_of_fit(fitted)
    lack = dc.replace(lack, text=f"{lack.text}; {UNDER}")
    solution, keys = fitted.solution, bench.records.keys
    if lack.rejected:
        limit = find_saturation(bench, fitted, {fault.channel for fault in faults if fault.kind == "clipped"})
        faults = (*faults, *keep_samples([tell_saturation(bench, limit, keep=True)] if limit else []))
    chosen = fitted
    if own is not None:  # cross-validated over what these records chose, where the model stands
        names = tuple(n for n in bench.space.index if n in own or n in solution.names)
        if saved is not None and bench.records.are_values:  # what they do not determine was fitted under priors
            bench = dc.replace(bench, priors=saved.priors).restack(bench.noise)
        chosen = bench.file(fitted.effects, bench.problem.solve(names, solution.u, solution.z, moving=False))
    # What a model that fails leaves is no measure of the noise: there the stated size counts.
    level = {c: dc.replace(n, sd=n.stated_sd, sizes={}) if n.stated_sd else n for c, n in bench.noise.items()
             } if lack.rejected else bench.noise
    counted = [(describe_quantity(c).name, format_quantity(c, n.stated_sd), format_quantity(c, float(f"{n.sd:.2g}")))
               for c, n in bench.noise.items()
               if lack.rejected and n.stated_sd and abs(n.sd / n.stated_sd - 1) > NOISE.differs]
    stated = [str(say("verdict.stated_noise", channels=counted))] if counted else []
    traces = make_traces(campaign, bench.records, solution, level)
    used = bench.records.used.sum(axis=(1, 2))
    chi2 = np.sum(solution.residual ** 2, axis=1) + np.sum(solution.z**2, axis=1)
    own_traces = {key: [t for t in traces if t.record == key] for key in map(str, campaign.record_keys)}
    records = pd.DataFrame([{"record": key, **some[0].conditions, **_join_channels(some)}
                            for key, some in own_traces.items()]).assign(chi2_reduced=chi2 / np.maximum(used, 1))
    channels = pd.DataFrame([{"channel": channel, "unit": series[0].unit, **_errors(series)}
                             for channel, series in _split(traces).items()])
    shifts = measure_shifts(bench.records, solution, campaign=bench.campaign)
    held = measure_held(bench, solution, level) if is_moved(shifts) else None
    adjusted = predicted = PredictionError(np.full(len(keys), np.nan), float("nan"))
    if resolved.fitted and own is None:
        adjusted = PredictionError(split_error(bench.records, solution.channels), float("nan"))
    elif refit and bench.holds_out:
        adjusted, predicted = bench.predict(chosen, adjust=True), bench.predict(chosen)
    # What was fitted here, not before; all that these records chose counts as free.
    names = tuple((chosen if own is not None and not given else fitted).solution.names)
    found = Comparison(
        campaign=campaign.name, title=campaign.title, sha256=campaign.sha256, model=name, fitted=names, sentence="",
        lack_of_fit=lack, chi2_reduced=bench.reduce_chi2(chosen.solution),
        nrmse=nrmse(traces), noise_nrmse=nrmse(traces, noise=True), channels=channels, records=records,
        conditions=_tabulate_conditions(campaign, traces),
        residuals=bin_residuals(traces, dict(zip(keys, solution.end, strict=True)), campaign, bench.family),
        parameters=public_estimates(bench, chosen.solution) if names else {},
        where=tuple(residual_places(bench, fitted)), noise=describe_noise(bench), traces=traces, shifts=shifts,
        held_nrmse=held and held.nrmse, held_ratio=held and held.ratio,
        notes=tuple(dict.fromkeys((
            *bench.warnings, *told, *map(str, faults), *filter(None, [thinned]), *stated))), faults=faults,
        effects=fitted.effects, heldout_nrmse=adjusted.nrmse,
        prediction_nrmse=predicted.nrmse, prediction_coverage=predicted.coverage, heldout_squares=adjusted.squares,
        heldout_losses=chosen.loss, groups=bench.groups,
        sequential=follow_records(bench.problem, solution, bench.bases, bench.noise),
        converged=chosen.solution.converged or own is not None, free=len(chosen.solution.names))
    return dc.replace(found, sentence=_tell(found, campaign, bench.family, list_disputed(bench.problem, solution)))


def _take_noise(bench: SelectionProblem, fitted: Fitted, saved: FittedModel) -> tuple[SelectionProblem, Fitted]:
    """The same under the noise of a fit of these records, so that its chi-square is the one that `fit` gave.

    A file does not keep the size of the noise of every sample: where that varies, what was measured here counts.
    """
    if any(bool(saved.noise[channel].sizes) != bool(n.sizes) for channel, n in bench.noise.items()):
        return bench, fitted
    bench = dc.replace(bench, noise=saved.noise).restack(saved.noise if differs_from_stated(saved.noise) else {})
    again = bench.repeat(fitted)
    return bench.span(again.solution), again


def conclude(models: tuple[Comparison, ...], names: tuple[str, ...]) -> Comparisons:
    """Which model cross-validates best, which are not told from it, and both in words."""
    known = [k for k, one in enumerate(models) if np.isfinite(one.heldout_nrmse)]
    best = min(known, key=lambda k: models[k].heldout_nrmse, default=None)
    good = [name for name, one in zip(names, models, strict=True) if not one.lack_of_fit.rejected]
    if best is None:
        return Comparisons(models, names, None, (), say("verdict.no_comparison", good=good, count=len(models)))
    others, top = [k for k in known if k != best], models[best]
    differences = {k: compare_losses(models[k].heldout_squares, top.heldout_squares, top.groups) for k in others}
    alike = tuple(k for k, (difference, error) in differences.items() if difference < 2 * error)
    pairs = [pair for k in alike for pair in ((k, best), (best, k)) if is_beaten(*(models[n] for n in pair))]
    beaten = tuple(Beaten(
        k, other, not models[other].lack_of_fit.rejected,
        compare_losses(models[k].heldout_losses, models[other].heldout_losses, top.groups)[0],
        find_carriers(models[k], models[other])) for k, other in pairs)
    unclear = [k for k in alike if not any(k in pair for pair in pairs)]
    return Comparisons(models, names, best, alike, say(
        "verdict.best_model", name=names[best], error=top.heldout_nrmse, noise=top.noise_nrmse,
        others=[(names[k], models[k].heldout_nrmse) for k in others], alike=[names[k] for k in unclear],
        beaten=[{"name": names[one.model], "other": names[one.other], "refuted": one.refuted,
                 "records": list(one.records)} for one in beaten], good=good, count=len(models)), beaten)


def is_beaten(model: Comparison, other: Comparison) -> bool:
    """Whether a model with significant lack of fit fits worse than another beyond chance."""
    return model.lack_of_fit.rejected and DEFAULT.is_beaten(
        *compare_losses(model.heldout_losses, other.heldout_losses, model.groups))


def find_carriers(model: Comparison, other: Comparison) -> tuple[str, ...]:
    """The fewest records that hold more than half of what a model's cross-validated error exceeds another's by."""
    gain = np.abs(model.heldout_squares - other.heldout_squares)
    order = np.argsort(-gain, kind="stable")
    count = int(np.searchsorted(np.cumsum(gain[order]), 0.5 * gain.sum(), side="right")) + 1
    return tuple(str(model.records["record"].iloc[k]) for k in order[:count])


def _split(traces: Sequence[Trace]) -> dict[str, list[Trace]]:
    """Traces by channel."""
    return {channel: [t for t in traces if t.channel == channel] for channel in list_channels(traces)}


def _errors(traces: Sequence[Trace]) -> dict[str, float]:
    """Errors over traces of one channel."""
    left = np.concatenate([t.measured - t.model for t in traces])
    left = left[np.isfinite(left)]
    if not len(left):
        return {"rms": np.nan, "ratio": np.nan, "bias": np.nan, "nrmse": np.nan, "samples": 0}
    rms = float(np.sqrt(np.mean(left**2)))
    return {"rms": rms, "ratio": rms / traces[0].sd, "bias": float(left.mean()), "nrmse": nrmse(traces),
            "samples": len(left)}


def _join_channels(traces: Sequence[Trace]) -> dict[str, float]:
    """Error over noise of all channels together, and of each where there are several."""
    ratios = {channel: _errors(own) for channel, own in _split(traces).items()}
    if len(ratios) == 1:
        return next(iter(ratios.values()))
    found = {"ratio": float(np.sqrt(np.nanmean([e["ratio"] ** 2 for e in ratios.values()]))), "nrmse": nrmse(traces)}
    return found | {f"ratio_{c}": e["ratio"] for c, e in ratios.items()}


def _tabulate_conditions(campaign: Campaign, traces: Sequence[Trace]) -> pd.DataFrame:
    """Errors by group of equal settings, however few groups there are; each condition is the mean over the group."""
    rows, groups = [], label_conditions(campaign.records)
    for group in np.unique(groups):
        table = campaign.records[groups == group]
        keys = set(map(str, table.index))
        own = [t for t in traces if t.record in keys]
        means = {str(n): float(v) for n, v in table.mean().items() if n != "sequence"}
        rows.append({**means, "records": len(table), **_join_channels(own)})
    # Settings scatter about nominal values: they are put in order by two digits.
    named = [c for c in rows[0] if c in campaign.conditions]
    return pd.DataFrame(sorted(rows, key=lambda row: [float(f"{row[c]:.2g}") for c in named]))


def bin_residuals(traces: Sequence[Trace], end: Mapping[str, float], campaign: Campaign, family: Family
                  ) -> pd.DataFrame:
    """Mean residual over noise in bins of every variable; standard errors from the scatter between records.

    `end` is that of the contact or record, in its independent variable.
    """
    rows: list[dict[str, Any]] = []
    for channel, own in _split(traces).items():
        z = [(t.measured - t.model) / t.sd for t in own]
        # (variable, phase) to the value of it and where it counts, one pair a record; values lie over conditions alone.
        values = all(t.is_value for t in own)
        views: dict[tuple[str, str], list[tuple[np.ndarray, np.ndarray]]] = {} if values else {
            (own[0].independent, "both"): [(t.time / end[t.record], t.time > 0) for t in own],
            (family.rate, "both"): [(t.state_rate, t.state > 0) for t in own]}
        for phase, sign in zip(() if values else family.phases, (1.0, -1.0), strict=False):
            views[family.state, phase] = [(t.state, (t.state > 0) & (sign * t.state_rate > 0)) for t in own]
        for name in campaign.conditions:
            views[name, "both"] = [(np.full(len(t.time), t.conditions[name]), values | (t.state > 0)) for t in own]
        for (variable, phase), pairs in views.items():
            rows += [{"channel": channel, "variable": variable, "phase": phase, **row} for row in _bin(z, pairs)]
    return pd.DataFrame(rows, columns=["channel", "variable", "phase", "low", "high", "mean", "standard_error",
                                       "records", "samples"])


def _bin(z: list[np.ndarray], pairs: list[tuple[np.ndarray, np.ndarray]]) -> list[dict[str, float]]:
    """Bins of one variable that hold samples."""
    keep = [inside & np.isfinite(r) for r, (_, inside) in zip(z, pairs, strict=True)]
    values = [x[k] for (x, _), k in zip(pairs, keep, strict=True)]
    everything = np.concatenate(values)
    if not len(everything) or np.ptp(everything) == 0:
        return []
    edges = np.linspace(everything.min(), everything.max(), BINS + 1)
    count = np.array([np.histogram(x, edges)[0] for x in values], dtype=float)
    total = np.array([np.histogram(x, edges, weights=r[k])[0] for r, k, x in zip(z, keep, values, strict=True)])
    there, n = np.sum(count > 0, axis=0), count.sum(axis=0)
    mean = total.sum(axis=0) / np.maximum(n, 1.0)
    # Records are the independent units: their means scatter about the common one.
    scatter = np.sqrt(there / np.maximum(there - 1, 1) * np.sum((total - mean * count) ** 2, axis=0))
    error = np.where(there > 1, scatter / np.maximum(n, 1.0), 1.0 / np.sqrt(np.maximum(n, 1.0)))
    return [{"low": float(edges[b]), "high": float(edges[b + 1]), "mean": float(mean[b]),
             "standard_error": float(error[b]), "records": int(there[b]), "samples": int(n[b])}
            for b in np.flatnonzero(n)]


def _tell(found: Comparison, campaign: Campaign, family: Family, disputed: Sequence[str]) -> Sentence:
    """The outcome in words; the priors of the `disputed` parameters are none that the records agree with."""
    ratio, lack = measure_ratio(found.traces), found.lack_of_fit
    if not lack.rejected and not lack.tested:
        return say("verdict.untested", model=repr(found.model), ratio=ratio, records=len(found.records))
    if not lack.rejected:
        return say("verdict.agrees", model=repr(found.model), ratio=ratio, p=lack.p_value, disputed=disputed)
    worst, place = found.records.loc[found.records["ratio"].idxmax()], None
    *_, next_to, most = (0.0, *sorted(found.records["chi2_reduced"]))
    alone = len(found.records) > 2 and most > APART * next_to
    if alone:  # where its settings were moved to make it fit, its residual is none of the largest
        worst = found.records.loc[found.records["chi2_reduced"].idxmax()]
    settings = [f"{describe_quantity(name).name} {format_quantity(name, worst[name])}"
                for name in family.kind.conditions if name in campaign.conditions and name != "sequence"]
    sizes = dict(zip(found.channels["channel"], found.channels["ratio"], strict=True))
    if found.where:
        spot = max(found.where, key=lambda w: (sizes.get(w.channel, 0.0), w.share))
        place = describe_place(spot, dc.replace(family.view, longest=find_longest(found.traces)))
        place = None if tells_nothing(place) else place
    level = describe_level(ratio, found.shifts, found.held_ratio)
    return say("verdict.fails", model=repr(found.model), level=level, worst=worst["record"], settings=settings,
               ratio=float(worst["ratio"]), place=place, alone=alone and [most, next_to])
