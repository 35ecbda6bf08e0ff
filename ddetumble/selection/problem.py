"""A campaign with one compiled model of everything: reference, catalogue and test directions."""

import dataclasses as dc
from collections.abc import Mapping, Sequence
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np
from scipy import sparse

from .._errors import ComputationError, InputError
from ..contact.effect import AbstractEffect, AbstractModel, is_scored, parameters_of
from ..families import Family, find_family, name_family
from ..inference.assembly import assemble_space, default_starts, guess_start
from ..inference.goodness import doubt_level
from ..inference.identifiability import assume_typical, describe_assumed, measure_values
from ..inference.noise import Noise
from ..inference.noise_estimation import differs_from_stated, has_more_hum, measure_noise
from ..inference.parameters import ParameterSpace
from ..inference.problem import STEPS, Problem, Solution
from ..inference.progressive_horizon import is_lost, solve_progressively
from ..inference.smooth import measure_smooth, smooth_bases
from ..inference.stack import Records, stack_records, widen_settings
from ..inference.variance_components import estimate_spread, follow_conditions
from ..measurement.campaign import Campaign, can_leave_out, group_conditions
from .cross_validation import forecast, leave_out, predict_left_out, refit_far_off
from .lack_of_fit import (
    Score,
    bootstrap_p_value,
    family_p_value,
    judge_fit,
    measure_repeats,
    score_directions,
)
from .result import LackOfFit
from .series import split_error
from .settings import DEFAULT, SelectionSettings


Zeros = Mapping[str, tuple[float, float]]


@dc.dataclass(frozen=True)
class Fitted:
    """A model and its fit."""

    effects: tuple[str, ...]  # ids of those added to the reference model
    solution: Solution
    loss: np.ndarray  # cross-validated loss of every record, in noise variances, shape (records,)
    # What the first quarter of a left-out record says of the rest of it, where records run on from where they start;
    # elsewhere the loss itself.
    forecast: np.ndarray
    thinned: bool = False  # whether fitted to thinned records
    penalty: float = DEFAULT.significant  # of a parameter in `merit`

    @property
    def score(self) -> float:
        """Cross-validated loss over all records, in noise variances."""
        return float(self.loss.sum())

    @property
    def merit(self) -> float:
        """The same with a penalty for each parameter: of two effects that predict alike (a viscoelastic wall that
        relaxes at once is a dashpot) the simpler is named first."""
        return self.score + self.penalty * len(self.solution.names)


class PredictionError(NamedTuple):
    """How well a model predicts conditions that it was not fitted to; NaN where there are too few, or it fails."""

    squares: np.ndarray  # of `nrmse` by record, shape (records,): their sum is its square
    coverage: float  # share of the samples (whitened) within the predicted 95 % interval of a new measurement
    # Of every record in noise variances, the priors of its settings included, shape (records,); empty where not known.
    loss: np.ndarray = np.zeros(0)

    @property
    def nrmse(self) -> float:
        """rms error over rms signal."""
        return float(np.sqrt(np.sum(self.squares)))


@dc.dataclass(frozen=True)
class SelectionProblem:
    """What models are chosen for: a campaign, its noise, and the effects that may be added. Nothing changes it."""

    campaign: Campaign  # with samples
    settings: SelectionSettings
    zeros: Zeros | None  # by channel whose baseline moves in every record how far (see `stack_records`)
    space: ParameterSpace  # of everything
    start: np.ndarray  # coordinates before any fit
    base: tuple[str, ...]  # parameters that every model has free
    known: tuple[type[AbstractEffect], ...]  # effects that these records can show
    catalogue: tuple[type[AbstractEffect], ...]  # those of them that are candidates
    directions: tuple[type[AbstractEffect], ...]  # test directions of the lack of fit
    left_out: tuple[str, ...]  # effects that lack what they need
    warnings: tuple[str, ...]  # sentences on the records
    records: Records  # all samples
    problem: Problem  # least squares with these, and with thinned records (None where they are short)
    thin: Problem | None
    guess: np.ndarray  # coordinates of the reference model guessed from the records
    freed: tuple[str, ...] = ()  # shapes (a wall's power) that are free in every fit that has their effect
    noise: Mapping[str, Noise] = dc.field(default_factory=dict)  # by channel, once the reference model was fitted
    bases: Sequence[sparse.csr_matrix] = ()  # whitened splines of every record, in which a misfit is looked for
    orthonormal: dict[int, np.ndarray] = dc.field(default_factory=dict, compare=False)  # what makes these so, by record
    lost: bool = False  # whether fits have to be led from the first part of the records to all of them
    priors: Mapping[str, tuple[float, float]] = dc.field(default_factory=dict)  # of what values do not determine
    spread: Mapping[str, float] = dc.field(default_factory=dict)  # ratio of a setting's scatter to what is stated

    @property
    def family(self) -> Family:
        """Kind of test."""
        return self.space.family

    @cached_property
    def samples(self) -> float:
        """How many samples of all channels count."""
        return float(self.records.used.sum())

    @cached_property
    def groups(self) -> np.ndarray:
        """Condition of every record, shape (records,)."""
        return group_conditions(self.campaign.records)

    @cached_property
    def conditions(self) -> np.ndarray:
        """What physics may depend on from record to record, the place in the series too; (records, conditions)."""
        return self.campaign.records.to_numpy(dtype=float)

    @cached_property
    def holds_out(self) -> bool:
        """Whether a condition can be left out and the others still say how anything depends on them."""
        return can_leave_out(self.campaign.records, self.family.free_running)

    def restack(self, noise: Mapping[str, Noise]) -> "SelectionProblem":
        """The same under another noise."""
        records, problem, thin = _stack(self.campaign, self.space, noise, self.zeros, self.settings, self.spread,
                                        self.priors)
        return dc.replace(self, records=records, problem=problem, thin=thin)

    def loosen(self, spread: Mapping[str, float]) -> "SelectionProblem":
        """The same with settings that scatter so many times as much as stated, by name."""
        return dc.replace(self, spread=dict(spread)).restack(self.noise)

    def estimate_spread(self, fitted: Fitted) -> dict[str, float]:
        """Ratio of the scatter of the settings to what is stated, under a model; those beyond doubt."""
        return estimate_spread(self.records, fitted.solution, self.spread, self.settings.spread)

    def is_scatter(self, fitted: Fitted) -> bool:
        """Whether the settings that scatter more than stated were moved at random, and not as the conditions go."""
        chances = [follow_conditions(fitted.solution.z[:, self.records.nuisances.index(name)], self.groups,
                                     self.conditions) for name in self.spread]
        return min(chances, default=1.0) * len(chances) > self.settings.spread.random

    def disperse(self, fitted: Fitted) -> float:
        """Chi-square of the smooth misfit of a model over its degrees of freedom, where it is beyond chance; else 1.

        What noise or settings leave that are not as stated makes differences between models so many times as large.
        """
        if fitted.thinned or not self.bases:
            return 1.0
        total, degrees = measure_smooth(self.problem, fitted.solution, self.bases)
        ratio, error = total / max(degrees, 1.0), np.sqrt(2.0 / max(degrees, 1.0) + doubt_level(self.noise) ** 2)
        return float(ratio) if ratio > np.exp(self.settings.standard_errors * error) else 1.0

    def span(self, solution: Solution) -> "SelectionProblem":
        """The same with the splines over the contacts of a fit."""
        return dc.replace(self, bases=smooth_bases(self.problem, solution.end), orthonormal={})

    def free(self, names: Sequence[str]) -> "SelectionProblem":
        """The same with these shapes, and those that are free already, free in every fit that has their effect."""
        return dc.replace(self, freed=tuple(dict.fromkeys((*self.freed, *names))))

    def hold(self, name: str) -> "SelectionProblem":
        """The same with a shape held again."""
        return dc.replace(self, freed=tuple(n for n in self.freed if n != name))

    def extend(self, fitted: Fitted, effects: Sequence[str], u: np.ndarray | None = None, **options) -> Fitted | None:
        """Fit `effects` from where a fit ended, or from the coordinates `u` with its nuisances; options as of `fit`."""
        solution = fitted.solution
        return self.fit(effects, [{}], solution.u if u is None else u, solution.z, **options)

    def list_held(self, effect: str) -> list[str]:
        """Names of an effect's parameters that are held at their default (the power of a wall's stiffness)."""
        names = [f"{effect}.{p.name}" for p in parameters_of(self.find_effect(effect)) if not p.free]
        return [name for name in names if name not in self.freed]

    def list_origins(self, base: np.ndarray) -> list[np.ndarray]:
        """Where a fit with more effects starts: where the poorer model ended, and without what strayed there.

        A parameter may run away to make up for what is missing, to where nothing depends on it any more.
        """
        strayed = [k for k in (self.space.index[name] for name in self.base)
                   if abs(base[k] - self.guess[k]) > self.settings.strayed * self.problem.scales[k]]
        back = base.copy()
        back[strayed] = self.guess[strayed]
        return [base, back] if strayed else [base]

    def repeat(self, fitted: Fitted, tolerance: float = 1e-4) -> Fitted:
        """The same model fitted to all samples from where it was (after the noise has changed)."""
        old = fitted.solution
        z = old.z[:, : len(self.records.nuisances)]  # the hum of another noise comes last, and may not be in this one
        return self.file(fitted.effects, self.problem.solve(old.names, old.u, z, tolerance=tolerance))

    def fit(self, effects: Sequence[str], starts: Sequence[dict[str, float]], base: np.ndarray, z: np.ndarray,
            tolerance: float = 1e-2, extra: Sequence[str] = (), screening: bool = False, thinned: bool = False
            ) -> Fitted | None:
        """Fit the reference model with `effects` from several starts and keep the best; None if none worked.

        `screening` takes few steps, to thinned records where there are such; `thinned` takes these alone. Nor do others
        follow a long valley to its end, as values have them: that is for `refine`, of what is left of many.
        """
        problem = self.thin if (screening or thinned) and self.thin is not None else self.problem
        freed = [n for n in self.freed if n.split(".")[0] in effects]
        free, best = [*self.base, *(n for e in effects for n in self.space.of([e])), *freed, *extra], None
        jobs = [(problem.solve, o, s, z) for o in self.list_origins(base) for s in starts]
        if self.lost:
            jobs += [(partial(solve_progressively, problem), self.guess, s, None) for s in starts]
        for solve, origin, start, own in jobs:
            u = origin.copy()
            for name, value in start.items():
                u[self.space.index[name]] = value
            try:
                solution = solve(free, u, own, tolerance=1.0 if screening else tolerance,
                                 max_steps=self.settings.screening_steps if screening else STEPS)
            except ComputationError:
                continue
            if not solution.failed and np.isfinite(solution.chi2) and (best is None or solution.chi2 < best.chi2):
                best = solution
        return None if best is None else self.file(effects, best, problem, screening)

    def file(self, effects: Sequence[str], solution: Solution, problem: Problem | None = None, screening: bool = False
             ) -> Fitted:
        """A fit with its cross-validated losses, which of a `screening` are those of the linearised model alone."""
        problem = problem or self.problem
        loss = ahead = leave_out(solution, self.groups)
        if self.family.free_running:
            ahead = forecast(problem.records, solution, self.groups, self.settings.early)
        found = Fitted(tuple(effects), solution, loss, ahead, problem is not self.problem, self.settings.significant)
        return found if screening else self.refit_far_off(found)

    def refit_far_off(self, fitted: Fitted) -> Fitted:
        """A fit with those losses exact that its linearised model puts far off (`refit_far_off`)."""
        if self.family.free_running:
            return fitted
        problem = self.thin if fitted.thinned and self.thin is not None else self.problem
        loss = refit_far_off(problem, fitted.solution, self.groups, fitted.loss, self.settings.far_off)
        return dc.replace(fitted, loss=loss, forecast=loss)

    def predict(self, fitted: Fitted, adjust: bool = False) -> PredictionError:
        """How well a model predicts every condition from the fit without it, its settings as they are written down or
        adjusted (`predict_left_out`)."""
        if not self.holds_out:
            return PredictionError(np.full(self.records.count, np.nan), float("nan"))
        problem = self.thin if fitted.thinned and self.thin is not None else self.problem
        found = predict_left_out(problem, fitted.solution, self.groups, self.settings.early, adjust, self.settings.bent)
        return PredictionError(split_error(problem.records, found.channels, found.used), found.coverage, found.loss)

    def reduce_chi2(self, solution: Solution) -> float:
        """Chi-square of a fit per degree of freedom, counted as by `fit`: a prior is one more value; of values, without
        what priors add and determine."""
        if self.records.are_values:
            total, degrees = measure_values(self.problem, solution)
            return total / max(degrees, 1.0)
        names = solution.names
        degrees = self.samples + sum(name in names for name in self.problem.priors) - len(names)
        return float(solution.chi2) / max(degrees, 1.0)

    def cross_validate(self, fitted: Fitted) -> float:
        """Cross-validated error of a model, rms over rms signal: the same for steps and candidates."""
        return self.predict(fitted, adjust=True).nrmse

    def list_amplitudes(self, effect: str) -> list[str]:
        """Names of an effect's amplitudes, but for those that are held at their null (a tilt about a further axis)."""
        return [f"{effect}.{p.name}" for p in parameters_of(self.find_effect(effect)) if is_scored(p)]

    def list_directions(self, exclude: Sequence[str], depth: float) -> list[tuple[str, str, dict[str, float]]]:
        """Every direction outside the effects of a model: catalogue (shapes on their grids), and test directions, whose
        onsets lie at parts of `depth`, the largest state that it reaches."""
        wanted = []
        for effect in self.catalogue:
            amplitudes = self.list_amplitudes(effect.id)
            # What has no slope at its null is scored where a fit would start.
            grid = {f"{effect.id}.{p.name}" for p in parameters_of(effect) if p.singular or p.kind == "shape"}
            wanted += [(effect.id, a, {n: v for n, v in start.items() if n in grid})
                       for start in default_starts(effect) for a in amplitudes]
        for effect in self.directions:
            onset = getattr(effect, "onset", None)
            places = [{}] if onset is None else [{onset: float(np.log(d * depth))} for d in (0.3, 0.55, 0.8) if depth]
            if getattr(effect, "line", None) is None:  # a frequency is looked for in the residuals
                wanted += [(effect.id, a, place) for place in places for a in self.list_amplitudes(effect.id)]
        return [direction for direction in wanted if direction[0] not in exclude]

    def test_lack_of_fit(self, fitted: Fitted) -> tuple[LackOfFit, list[Score]]:
        """Lack of fit of a model, and the scores of everything outside it."""
        solution = fitted.solution
        wanted = self.list_directions(fitted.effects, float(solution.state.max()))
        scores = score_directions(self.problem, solution, wanted)
        return judge_fit(self.problem, solution, self.bases, self.noise, self.calibrate(scores), self.settings,
                         self.measure_repeats(solution) if self.is_loose else None), scores

    @property
    def is_loose(self) -> bool:
        """Whether noise or settings are taken otherwise than stated: they may take what a force is missing for."""
        return bool(self.spread) or (not self.records.are_values and
                                     any(n.sizes or n.slow_sd or n.hum for n in self.noise.values()))

    def measure_repeats(self, solution: Solution) -> float | None:
        """p-value of nothing in the residuals repeating over the records; None where that cannot be judged."""
        clock = self.campaign.independent
        bias = 0.0 if clock is None or clock.common is None else clock.common.sd(0.0)
        return measure_repeats(self.records, solution, self.groups, self.conditions, float(bias))

    def calibrate(self, scores: list[Score]) -> float:
        """Family-wise p-value of the largest score: by a bootstrap where there are few long records."""
        if self.family.free_running:
            return bootstrap_p_value(scores, self.noise, self.settings.bootstrap)
        return family_p_value(scores, self.noise)

    def find_effects(self, effects: Sequence[str]) -> list[type[AbstractEffect]]:
        """Classes of effects by their ids."""
        return [self.find_effect(effect) for effect in effects]

    def find_effect(self, effect_id: str) -> type[AbstractEffect]:
        """Class of an effect by its id."""
        for effect in (*self.known, *self.directions):
            if effect.id == effect_id:
                return effect
        raise InputError(f"there is no effect {effect_id!r}; there are: {', '.join(e.id for e in self.catalogue)}")


def _stack(campaign: Campaign, space: ParameterSpace, noise: Mapping[str, Noise], zeros: Zeros | None,
           settings: SelectionSettings, spread: Mapping[str, float],
           priors: Mapping[str, tuple[float, float]] | None = None) -> tuple[Records, Problem, Problem | None]:
    """All samples, and thinned records on which many candidates are tried."""
    def stack(most: int | None) -> Problem:
        return Problem(space, widen_settings(stack_records(campaign, noise, most, zeros), spread), priors)

    whole, most = stack(None), settings.screening_samples
    return whole.records, whole, stack(most) if whole.records.lengths.max() > most else None


def pose_selection(campaign: Campaign, reference: AbstractModel, extra: Sequence[type[AbstractEffect]] = (),
                   given: Sequence[AbstractEffect] = (), zeros: Zeros | None = None,
                   settings: SelectionSettings = DEFAULT, fit_given: bool = True) -> SelectionProblem:
    """State the choice of a model for a campaign.

    Args:
        campaign, reference: with samples; template of the reference model.
        extra: effects of the user, beside the catalogue.
        given: effects that the model has from the start, with their values; they are no candidates.
        zeros: by channel whose baseline moves in every record how far (see `stack_records`).
        settings: thresholds.
        fit_given: whether the parameters of `given` are fitted with the reference model's, but for those that the
            campaign states as known.

    Raises:
        InputError: a given effect needs what the campaign or the model does not have.
    """
    listed = (*find_family(name_family(campaign)).catalogue, *extra)
    found = assemble_space(campaign, reference, (*extra, *(type(e) for e in given if type(e) not in listed)))
    space, start, base = found.space, found.start.copy(), tuple(found.base)
    for effect in given:
        if type(effect) not in found.catalogue:
            missing = [n for n in effect.requires if n not in (*reference.provides, *campaign.records.columns)]
            raise InputError(f"the model's effect {effect.id!r} needs {', '.join(missing)}, which campaign "
                             f"{campaign.name!r} or the model does not have")
        for p in parameters_of(effect):
            name, value = f"{effect.id}.{p.name}", float(p.transform.publish(float(getattr(effect, p.field))))
            stated = campaign.known.get(name)
            start[space.index[name]] = p.transform.to_unconstrained(value if stated is None else stated)
    taken = {type(effect) for effect in given}
    if fit_given:
        base += tuple(name for name in space.of([effect.id for effect in given]) if campaign.known.get(name) is None)
    catalogue = tuple(e for e in found.catalogue if e not in taken)
    records, problem, thin = _stack(campaign, space, {}, zeros, settings, {})
    return SelectionProblem(campaign, settings, zeros, space, start, base, tuple(found.catalogue), catalogue,
                            tuple(found.directions), tuple(found.left_out), tuple(found.warnings), records, problem,
                            thin, start)


def fit_reference(selection: SelectionProblem) -> tuple[SelectionProblem, Fitted]:
    """Fit the reference model, measure the noise's correlation, and fit again under it: the problem under that noise.

    Raises:
        ComputationError: the reference model could not be integrated.
    """
    # From a start guessed from the contact times, else from the defaults.
    guess = guess_start(selection.campaign, selection.space, selection.start, list(selection.base))
    solution = require_computed(selection, solve_progressively(selection.problem, selection.base, guess))
    priors = assume_typical(selection.problem, solution, selection.start)
    if priors:
        selection = dc.replace(selection, priors=priors).restack({})
        solution = require_computed(selection, solve_progressively(selection.problem, selection.base, guess))
    settings, noise = selection.settings.noise, {}
    for _ in range(settings.looks):
        before, noise = noise, measure_noise(selection.campaign, selection.records, solution, settings, noise)
        selection = dc.replace(selection, guess=guess, noise=noise)
        if differs_from_stated(noise, settings):
            selection = selection.restack(noise)
            solution = require_computed(selection, selection.problem.solve(selection.base, solution.u, solution.z))
        if not has_more_hum(before, noise):
            break
    told = (*selection.warnings, *describe_assumed(selection.problem, priors, solution))
    selection = dc.replace(selection.span(solution), lost=is_lost(selection.problem, solution), warnings=told)
    return selection, selection.file((), solution)


def require_computed(selection: SelectionProblem, solution: Solution) -> Solution:
    """The same fit, if every record could be computed."""
    if solution.failed:
        raise ComputationError(
            f"the reference model could not be integrated for record {solution.failed[0]!r} "
            f"({len(solution.failed)} of {selection.records.count} records): check its conditions and units"
            + "".join(f". {text}" for text in selection.warnings))
    return solution
