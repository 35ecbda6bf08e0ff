"""Fit a model to a campaign: parameters with uncertainty, by Levenberg-Marquardt with every record's nuisances."""

import dataclasses as dc
import itertools
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from .._display import Progress, stay_silent
from .._errors import ComputationError, InputError
from ..contact.effect import AbstractEffect, is_absent, parameters_of, require_effect
from ..families import find_family, name_family, open_campaign
from ..measurement.campaign import Campaign
from ..measurement.faults import keep_samples, screen_samples
from ..measurement.plausibility import check_numbers
from ..measurement.quantities import format_number, join_words
from . import distributions as stats
from .archive import Model, resolve_model
from .assembly import Assembly, assemble_space, default_starts
from .bounded import Bounded, explain_share, list_limits, meets_data, solve_bounded
from .findings import Fit, summarise_fit
from .identifiability import assume_typical, describe_assumed
from .models import ResolvedModel, offer_parameter, resolve_effect
from .noise import Noise
from .noise_estimation import differs_from_stated, has_more_hum, measure_noise
from .parameters import ParameterSpace
from .problem import Problem, Solution, count_steps
from .progressive_horizon import MOST, is_lost, solve_progressively
from .smooth import measure_smooth, smooth_bases
from .specification import Prior, Specification, read_specification
from .stack import hold_conditions, stack_records
from .variance_components import WANDER, WanderSettings, find_slow_noise, list_settings


STARTS = 12  # tried at most
WORSE = 2.0  # chi-square by which a fit with effects is worse than without: more than its tolerance leaves
STRAYED = 5.0  # stated deviations by which a setting of the reference model is no longer where it may begin


def fit(campaign: Campaign | str | Path, model: Model = "paper", effects: Sequence[str | type[AbstractEffect]] = (), *,
        free: Sequence[str] | Mapping[str, float | bool] | None = None, fixed: Mapping[str, float] | None = None,
        priors: Mapping[str, tuple[float, float]] | None = None,
        bounds: Mapping[str, tuple[float, float]] | None = None, start: Mapping[str, float] | None = None,
        noise: str | Mapping[str, Noise] | None = None, nuisances: bool = True, progress: Progress | None = None
        ) -> Fit:
    """Fit a model to a campaign.

    Args:
        campaign: a campaign, its folder, or a specification `fit.toml` (which then says everything else).
        model: a reference model by name or in hand, extended or not (`Ball() + Adhesion()`); a fit, or a folder that
            `fit` or `discover` wrote, brings its effects and starts from its values.
        effects: ids of the catalogue, `FILE.py:NAME`, or classes, that extend the model.
        free: parameters to fit beside those of the effects and the unknown ones of the reference model; with their
            starts where it is a mapping.
        fixed: parameters held at a value.
        priors: Gaussian (mean, sd) of free parameters.
        bounds: (low, high) of free parameters.
        start: where to start from.
        noise: by channel; `stated` for white noise of the stated size, None to measure its correlation.
        nuisances: whether each record's conditions and time origin move within their stated uncertainty.
        progress: called with a sentence and the share done.

    All values are in the parameters' public units, those of `ddetumble effects`.

    Raises:
        InputError: The campaign cannot be fitted, or a name or value makes no sense.
        ComputationError: The model could not be integrated from any start.
    """
    report = progress or stay_silent
    if not isinstance(campaign, Campaign) and Path(campaign).suffix == ".toml":
        path = Path(campaign)
        wanted, digest = read_specification(path)
        settings = {"command": f"ddetumble fit {path.name}", "specification": path.name, "sha256": digest,
                    "title": wanted.title, "seed": wanted.seed}
        try:
            campaign = open_campaign(wanted.campaign)
            with count_steps() as taken:
                return _fit(campaign, wanted, resolve_model(wanted.model, name_family(campaign)), settings, {}, report,
                            taken)
        except InputError as error:
            if error.file is not None:
                raise
            raise InputError(error.problem, file=path, key=error.key) from None
    campaign = open_campaign(campaign)
    freed = dict(free) if isinstance(free, Mapping) else {name: True for name in free or ()}
    for effect in effects:
        if not isinstance(effect, str):
            require_effect(effect, instances=False)
    ids = [e if isinstance(e, str) else e.id for e in effects]
    find_family(name_family(campaign), "fit")
    resolved = resolve_model(model, name_family(campaign))
    wanted = Specification.model_construct(
        schema_="ddetumble.fit/1", campaign=campaign.name, model=resolved.name, effects=ids, free=freed,
        fixed=dict(fixed or {}), bounds=dict(bounds or {}),
        priors={k: Prior.model_construct(mean=m, sd=s) for k, (m, s) in (priors or {}).items()},
        nuisances=nuisances, noise="stated" if noise == "stated" else "measured")
    in_hand = not isinstance(model, (str, Path))
    shown = list(dict.fromkeys([*([e.id for e in resolved.effects] if in_hand else []), *ids]))
    command = [f"ddetumble fit {campaign.name} --model {resolved.name if in_hand else Path(model).name}",
               *(f"--effect {e}" for e in shown)]
    with count_steps() as taken:
        return _fit(campaign, wanted, resolved, {"command": " ".join(command)}, start or {}, report, taken,
                    [e for e in effects if not isinstance(e, str)], noise if isinstance(noise, Mapping) else None)


def _fit(campaign: Campaign, wanted: Specification, resolved: ResolvedModel, settings: Mapping,
         start: Mapping[str, float], report: Progress, taken: Sequence[int],
         classes: Sequence[type[AbstractEffect]] = (), noise: Mapping[str, Noise] | None = None) -> Fit:
    """Fit what a specification says; `taken` are the steps of all solutions so far."""
    family = find_family(name_family(campaign), "fit")
    # Classes of all effects of the model: its own first, then those asked for, each once.
    own = {e.id: e for e in classes}
    found: dict[str, type[AbstractEffect]] = {e.id: type(e) for e in resolved.effects}
    for name in wanted.effects:
        effect = own.get(name) or found.get(name) or resolve_effect(name)
        found.setdefault(effect.id, effect)
    chosen = tuple(found.values())
    assembly = assemble_space(campaign, resolved.reference, [e for e in chosen if e not in family.catalogue])
    for effect in chosen:
        if effect.id in assembly.left_out:
            raise InputError(f"effect {effect.id!r} needs {' and '.join(effect.requires)}, which the model "
                             f"{wanted.model!r} and the campaign {campaign.name!r} do not have")
    space = assembly.space
    held = {name: value for name, value in campaign.known.items() if value is not None and name in space.index}
    names = _choose_free(assembly, chosen, wanted, set(held))
    if "specification" not in settings:
        settings = {**settings, "command": " ".join([settings["command"], *_write_choices(space, wanted)])}
    given = {**start, **{k: v for k, v in wanted.free.items() if v is not True}}
    brought = {f"{effect.id}.{p.name}": float(p.transform.publish(float(getattr(effect, p.field))))
               for effect in resolved.effects for p in parameters_of(effect)}
    stated = {name: held[name] for effect in chosen for name in space.of([effect.id]) if name in held}
    base = _place_values(space, assembly.start, brought | stated)
    base = _place_values(space, base, dict(wanted.fixed) | given)
    priors, limits = _place_priors(space, wanted), _place_bounds(space, wanted)
    chosen_numbers = given | dict(wanted.fixed) | {name: prior.mean for name, prior in wanted.priors.items()}
    warnings = (*assembly.warnings, *map(str, check_numbers(chosen_numbers)))

    def pose(noise: Mapping[str, Noise] | None, most: int | None = None) -> Problem:
        records = stack_records(campaign, noise, most)
        return Problem(space, records if wanted.nuisances else hold_conditions(records), priors)

    report("fitting the reference model", 0.05)
    whole = problem = pose(noise)
    if space.family.free_running and whole.records.lengths.max() > MOST:  # starts are tried on a part of the samples
        problem = pose(noise, MOST)
    known = [n for n in names if n in assembly.base]
    told, saved = bool({*given} & {*known}), resolved.fitted
    origins = family.guess_starts(campaign, space, base, known)
    if saved:  # what the model or the user says comes first, with the rest guessed where nothing is known of it
        origins = [base, *origins]
    elif told:
        origins = [*family.guess_starts(campaign, space, base, [n for n in known if n not in given]), *origins]
    base, first = _fit_reference(problem, known, origins, not (told or saved), warnings)
    best: Bounded | None = None
    origin = base
    places: list[tuple[np.ndarray, np.ndarray | None]] = [(first.u, first.z)]
    if told:
        places.append((base, first.z))
    if chosen and np.abs(first.z[:, list_settings(problem.records)]).max(initial=0.0) > STRAYED:
        # Settings that made up for what the reference model lacks would hold the grown one where they went.
        places.append((base, None))
    starts = [(u, z, values) for values in _list_starts(chosen, names, given, resolved) for u, z in places]
    for k, (u, z, values) in enumerate(starts):
        report(f"start {k + 1} of {len(starts)}", 0.2 + 0.6 * k / len(starts))
        u = u.copy()
        u[[space.index[n] for n in values]] = list(values.values())
        began = np.where(np.isin(np.arange(len(u)), [space.index[n] for n in known]), base, u)
        try:
            tried = solve_bounded(problem, names, u, z, limits, 1e-2)
        except ComputationError:
            if best is None and k + 1 == len(starts):
                raise
            continue
        if is_lost(problem, tried.solution):
            near = solve_progressively(problem, names, u, tolerance=1e-2)
            if not near.failed and not near.chi2 > tried.solution.chi2:
                tried = solve_bounded(problem, names, near.u, near.z, limits, 1e-2)
        if not tried.solution.failed and (best is None or tried.solution.chi2 < best.solution.chi2):
            best, origin = tried, began
    if best is None:
        raise ComputationError("the model could not be integrated from any start; try other starting values or fix a "
                               "parameter")
    worse = _tell_worse(chosen, first, best.solution)
    if problem is not whole:
        problem = whole
        best = solve_bounded(problem, names, best.solution.u, best.solution.z, limits, 1e-2)
    # Of values as `compare` and `discover` ask: from the start alone, whatever others lead to.
    asked = solve_progressively(problem, names, origin) if problem.records.are_values else best.solution
    assumed = assume_typical(problem, best.solution if asked.failed else asked, assembly.start)
    if assumed:
        priors, settings = priors | assumed, {**settings, "assumed": list(assumed)}
        problem = pose(noise)
        near = solve_progressively(problem, names, origin)
        best = solve_bounded(problem, names, near.u, near.z, limits, 1e-2)
    report("measuring the noise", 0.82)
    measured = dict(noise or {}) or measure_noise(campaign, problem.records, best.solution)
    if not noise and wanted.noise != "stated" and has_more_hum({}, measured):
        problem = pose(measured)
        best = solve_bounded(problem, names, best.solution.u, best.solution.z, limits, 1e-2)
        measured = measure_noise(campaign, problem.records, best.solution, before=measured)
    if wanted.noise == "stated":
        measured = {c: dc.replace(n, sd=n.stated_sd or n.sd, correlation=0.0, white_share=0.0, hum=(),
                                  log_level_sd=n.log_level_sd if problem.records.are_values else 0.0,
                                  text="white, as stated") for c, n in measured.items()}
    elif not noise and differs_from_stated(measured):
        problem = pose(measured)
    report("refining the best start", 0.86)
    again = solve_bounded(problem, names, best.solution.u, best.solution.z, limits)
    best = best if again.solution.failed else again
    _refuse_stray(problem, best.solution)
    wandering: list[str] = []
    if not noise and wanted.noise != "stated":
        problem, best, measured, wandering = _allow_wander(pose, problem, best, measured, limits, report)
    report("writing it down", 0.96)
    doubts = map(str, keep_samples(screen_samples(campaign)[1]))
    return summarise_fit(campaign, resolved.name, tuple(e.id for e in chosen), problem, best, origin, measured,
                         settings, wanted.nuisances,
                         (*warnings, *worse, *wandering, *describe_assumed(problem, assumed, best.solution), *doubts),
                         steps=sum(taken), starts=len(starts))


def _fit_reference(problem: Problem, names: Sequence[str], origins: Sequence[np.ndarray], rank: bool,
                   warnings: Sequence[str]) -> tuple[np.ndarray, Solution]:
    """Fit the reference model from one origin after the other until a fit is sound.

    With `rank`, the origin that leaves least where it stands is first. Returns the origin of the first sound fit and
    the fit; where none is sound, those of the fit that leaves least.
    """
    if rank and len(origins) > 1:
        stand = [problem.solve(names, u, moving=False) for u in origins]
        left = [np.inf if s.failed or not np.isfinite(s.chi2) else s.chi2 for s in stand]
        origins = [origins[k] for k in np.argsort(left, kind="stable")]
    best: tuple[np.ndarray, Solution] | None = None
    error: ComputationError | None = None
    broken: Solution | None = None
    for u in origins:
        try:
            found = solve_progressively(problem, names, u)
        except ComputationError as caught:
            error = caught
            continue
        if found.failed or not np.isfinite(found.chi2):
            broken = found
            continue
        if best is None or found.chi2 < best[1].chi2:
            best = u, found
        if found.converged and not list_limits(problem, found) and meets_data(problem, found):
            break
    if best is not None:
        return best
    if broken is None and error is not None:
        raise error
    assert broken is not None
    if not broken.failed:
        return origins[0], broken
    raise ComputationError(
        f"the reference model could not be integrated for record {broken.failed[0]!r} ({len(broken.failed)} of "
        f"{problem.records.count} records): check its conditions and units" + "".join(f". {text}" for text in warnings))


def _tell_worse(effects: Sequence[type[AbstractEffect]], without: Solution, solution: Solution) -> list[str]:
    """A sentence where effects make a fit worse, although it holds the one without them: their null is out of reach of
    a descent, as where it is a jump.
    """
    if not effects or not solution.chi2 > without.chi2 + WORSE:
        return []
    return [f"With {join_words([effect.id for effect in effects])} the fit is worse than without (a chi-square of "
            f"{format_number(solution.chi2)} instead of {format_number(without.chi2)} under the stated noise): no "
            "value was found at which the records want this, and its estimate means nothing."]


def _allow_wander(pose: Callable[[Mapping[str, Noise]], Problem], problem: Problem, best: Bounded,
                  noise: Mapping[str, Noise], limits: Mapping[str, tuple[float, float]], report: Progress,
                  settings: WanderSettings = WANDER
                  ) -> tuple[Problem, Bounded, dict[str, Noise], list[str]]:
    """A fit of records that run on from where they start beside baselines that wander, where these explain what misfit
    is left and are rough, as random walks are and what a missing force leaves is not; with a sentence that says so.

    Where they do not, the fit as it is. Of other records the scatter from one to another says how far estimates stray.
    """
    as_it_is = problem, best, dict(noise), []
    if not problem.space.family.free_running or not _leaves_misfit(problem, best.solution, settings):
        return as_it_is
    for _ in range(settings.rounds):
        report("looking whether baselines wander", 0.92)
        slow = find_slow_noise(problem.records, best.solution, noise, settings)
        if slow.noise == dict(noise) or slow.roughness < -settings.smooth:
            return as_it_is
        problem = pose(slow.noise)
        best = solve_bounded(problem, best.names, best.solution.u, best.solution.z, limits)
        if best.solution.failed:
            return as_it_is
        if not _leaves_misfit(problem, best.solution, settings):
            channels = [channel for channel, one in slow.noise.items() if one.slow_sd]
            rough = slow.roughness > settings.worth
            return problem, best, slow.noise, [
                f"What the model leaves of {join_words(channels)} is slow, "
                + ("and rough as a random walk is: " if rough else "and whether it is rough cannot be told: ")
                + "it was taken for baselines that wander, and intervals allow for them. `ddetumble discover` tells "
                "whether a force may be missing instead."]
    return as_it_is


def _leaves_misfit(problem: Problem, solution: Solution, settings: WanderSettings) -> bool:
    """Whether residuals hold more that is slow than the noise makes."""
    total, degrees = measure_smooth(problem, solution, smooth_bases(problem, solution.end))
    return degrees >= 1 and stats.chi2.sf(total, degrees) < settings.level


def _refuse_stray(problem: Problem, solution: Solution) -> None:
    """Refuse a fit that removes hardly anything of the data: its parameters mean nothing."""
    if meets_data(problem, solution):
        return
    space = problem.space
    values = ", ".join(f"{n} = {space.parameter(n).transform.from_unconstrained(solution.u[space.index[n]]):.3g}"
                       for n in solution.names)
    raise ComputationError(
        f"the fit found no place where the model meets the measured {space.family.channels[0]}: where it ended after "
        f"{solution.steps} steps ({values}) it removes {100 * explain_share(problem, solution):.0f} % of the signal's "
        "sum of squares. Check the units of the records, free what is fixed, or start nearer")


def _write_choices(space: ParameterSpace, wanted: Specification) -> list[str]:
    """What is free, held, drawn to a prior and bounded as options of the command line, which ask for units."""
    def write(option: str, name: str, number: str) -> str:
        value = f"{name}={number} {space.parameter(name).unit}".rstrip()
        return f'--{option} "{value}"' if " " in value else f"--{option} {value}"

    return [*(f"--free {n}" if v is True else write("free", n, f"{v:g}") for n, v in wanted.free.items()),
            *(write("fix", n, f"{v:g}") for n, v in wanted.fixed.items()),
            *(write("prior", n, f"{p.mean:g}+-{p.sd:g}") for n, p in wanted.priors.items()),
            *(write("bound", n, f"{low:g}..{high:g}") for n, (low, high) in wanted.bounds.items())]


def _choose_free(assembly: Assembly, chosen: Sequence[type[AbstractEffect]], wanted: Specification, known: set[str]
                 ) -> list[str]:
    """Names of the parameters to fit, in the order of the space, without those of effects that the campaign states as
    `known`; refused where names make no sense."""
    space, ids = assembly.space, {e.id for e in chosen}
    usable = [s.name for s in space.slots if s.owner is None or s.owner in ids]
    for section in ("free", "fixed", "priors", "bounds"):
        for name in getattr(wanted, section):
            if name not in usable:
                lacking = [effect for effect in space.effects if effect.id not in ids]
                raise InputError(f"there is no parameter {name!r} in this model; "
                                 f"{offer_parameter(name, usable, lacking, 'with effects = [{!r}]')}", key=section)
            if section == "free" and name in wanted.fixed:
                raise InputError(f"{name} is both free and fixed; leave one out", key=section)
    still = () if wanted.nuisances else [common.slot.name for common in space.commons]
    names = {*assembly.base, *({*space.of(ids)} - known), *wanted.free} - {*wanted.fixed, *still}
    for section in ("priors", "bounds"):
        for name in getattr(wanted, section):
            if name not in names:
                raise InputError(f"{name} is not fitted, so that this has no meaning; free it or leave this out",
                                 key=section)
    if not names:
        raise InputError("nothing is left to fit: every parameter is known or fixed; free one", key="free")
    if len(names) > space.family.slots[-1]:
        raise InputError(f"{len(names)} free parameters are too many; at most {space.family.slots[-1]}", key="free")
    return [s.name for s in space.slots if s.name in names]


def _place_values(space: ParameterSpace, base: np.ndarray, values: Mapping[str, float]) -> np.ndarray:
    """Coordinates with public values put in by name; refused where they are impossible."""
    u, (low, high) = base.copy(), space.bounds()
    for name, value in values.items():
        if name not in space.index:
            raise InputError(f"there is no parameter {name!r} in this model")
        k = space.index[name]
        u[k] = _coordinate(space, name, float(value))
        if not low[k] <= u[k] <= high[k]:
            raise InputError(f"{value:g} is outside what {name} can be")
    return u


def _place_priors(space: ParameterSpace, wanted: Specification) -> dict[str, tuple[float, float]]:
    """Priors in coordinates: mean, and standard deviation to first order."""
    found = {}
    for name, prior in wanted.priors.items():
        if not prior.sd > 0:
            raise InputError(f"the standard deviation of {name} has to be positive", key="priors")
        place, (low, high) = _coordinate(space, name, float(prior.mean)), space.parameter(name).coordinate_bounds()
        if not low <= place <= high:
            raise InputError(f"{prior.mean:g} is outside what {name} can be", key="priors")
        slope = space.parameter(name).transform.slope(prior.mean) or 1.0
        found[name] = place, float(prior.sd * (1 / slope))
    return found


def _place_bounds(space: ParameterSpace, wanted: Specification) -> dict[str, tuple[float, float]]:
    """Bounds in coordinates, lower first; one beyond what the parameter can be is none."""
    found = {}
    for name, ends in wanted.bounds.items():
        low, high = map(float, ends)
        if not low < high:
            raise InputError(f"the lower bound of {name} has to be below the upper one", key="bounds")
        transform = space.parameter(name).transform
        ends = (low if low > transform.support[0] or transform.reciprocal else None,
                high if high < transform.support[1] or transform.reciprocal else None)
        if transform.name == "logit":  # the other side of either end is beyond it, too
            ends = tuple(end if end is not None and transform.allows(end) else None for end in ends)
        found[name] = tuple(sorted(none if end is None else _coordinate(space, name, end, False)
                                   for end, none in zip(ends, (-np.inf, np.inf), strict=True)))
    return found


def _list_starts(chosen: Sequence[type[AbstractEffect]], names: Sequence[str], given: Mapping[str, float],
                 resolved: ResolvedModel) -> list[dict[str, float]]:
    """Coordinates to start the effects from: inside their range, every shape that is to be scanned."""
    placed = {e.id for e in resolved.effects if not is_absent(e)}  # with values to start from
    options = [default_starts(e) for e in chosen if e.id not in placed]
    combined = list(itertools.islice(itertools.product(*options), 500))
    if len(combined) > STARTS:
        combined = [combined[k] for k in np.linspace(0, len(combined) - 1, STARTS).astype(int)]
    starts: list[dict[str, float]] = []
    for parts in combined:
        values = {n: v for part in parts for n, v in part.items() if n in names and n not in given}
        if values not in starts:
            starts.append(values)
    return starts


def _coordinate(space: ParameterSpace, name: str, value: float, finite: bool = True) -> float:
    p = space.parameter(name)
    if finite and not np.isfinite(value) and not p.transform.reciprocal:
        raise InputError(f"the value of {name} has to be a finite number")
    if not p.transform.allows(value):
        raise InputError(f"{name} has to {p.transform.words}; it is {value:g}{f' {p.unit}' if p.unit else ''}")
    return p.transform.to_unconstrained(value)
