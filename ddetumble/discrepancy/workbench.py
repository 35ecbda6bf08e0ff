"""One campaign with one compiled model of everything: reference, catalogue and probes."""

import dataclasses as dc
from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np

from .._errors import ComputationError, InputError
from ..contact.effect import AbstractEffect, AbstractModel, parameters_of
from ..inference.assembly import assemble_space, default_starts, guess_start
from ..inference.families import find_family, name_family
from ..inference.horizon import is_lost, solve_growing
from ..inference.noise import Noise
from ..inference.parameters import to_coordinate
from ..inference.problem import Problem, Solution
from ..inference.stack import Records, stack_records
from ..inference.whiteness import changed, differs_from_stated, measure_noise
from ..measurement.campaign import Campaign
from ..measurement.grouping import can_leave_out, count_conditions, group_conditions
from .adequacy import Score, bootstrap_p_value, family_p_value, judge_fit, score_directions, smooth_bases
from .holdout import forecast, leave_out, predict_left_out
from .records import LackOfFit
from .settings import DEFAULT, SelectionSettings
from .traces import measure_error


@dc.dataclass
class Fitted:
    """A model of the loop: which effects, its fit, its held-out losses by record.

    `forecast` is what the first quarter of a left-out record says of the rest of it, where records run on from where
    they start; elsewhere the loss itself.
    """

    effects: tuple[str, ...]
    solution: Solution
    loss: np.ndarray
    forecast: np.ndarray
    thinned: bool = False
    penalty: float = DEFAULT.significant

    @property
    def score(self) -> float:
        """Held-out loss over all records, in noise variances."""
        return float(self.loss.sum())

    @property
    def merit(self) -> float:
        """Held-out loss with a penalty for each parameter: of two effects that predict alike the simpler is named first.

        A viscoelastic wall that relaxes at once is a dashpot: left-out conditions alone would leave their order to chance.
        """
        return self.score + self.penalty * len(self.solution.names)


class Workbench:
    """Fits, scores and judgements on one campaign.

    Args:
        campaign: with samples.
        reference: template of the reference model.
        extra: effects of the user, beside the catalogue.
        given: effects that the model has from the start, with their values; they are fitted with the reference model,
            and are no candidates.
        zeros: by channel whose zero moves in every record how far (see `stack_records`).
        settings: thresholds.
    """

    def __init__(self, campaign: Campaign, reference: AbstractModel,
                 extra: Sequence[type[AbstractEffect]] = (), given: Sequence[AbstractEffect] = (),
                 zeros: Mapping[str, tuple[float, float]] | None = None, settings: SelectionSettings = DEFAULT):
        self.campaign, self.zeros, self.settings = campaign, zeros, settings
        known = (*find_family(name_family(campaign)).catalogue, *extra)
        extra = (*extra, *(type(e) for e in given if type(e) not in known))
        found = assemble_space(campaign, reference, extra)
        self.reference = found.space.reference
        self.space, self.start, self.base = found.space, found.start, list(found.base)
        self.catalogue, self.probes, self.left_out = found.catalogue, found.probes, found.left_out
        self.warnings = found.warnings
        self._take(given)
        self.by_id = {e.id: e for e in (*self.known, *self.probes)}
        self.family = self.space.family
        self.groups = group_conditions(campaign.records)
        self.conditions = count_conditions(campaign.records)
        self.holds_out = can_leave_out(campaign.records, self.family.free_running)
        self._stack({})
        self.noise: dict[str, Noise] = {}
        self.freed: tuple[str, ...] = ()
        self.lost = False

    def _take(self, given: Sequence[AbstractEffect]) -> None:
        """Start from a model that has effects already."""
        for effect in given:
            if type(effect) not in self.catalogue:
                raise InputError(f"the model's effect {effect.id!r} needs {', '.join(effect.requires)}, which campaign "
                                 f"{self.campaign.name!r} or the model does not have")
            for p in parameters_of(effect):
                value = to_coordinate(p.coordinate, float(getattr(effect, p.field)))
                self.start[self.space.index[f"{effect.id}.{p.name}"]] = value
        self.base += self.space.of([effect.id for effect in given])
        taken = {type(effect) for effect in given}
        self.known = self.catalogue
        self.catalogue = tuple(e for e in self.catalogue if e not in taken)

    def begin(self) -> Fitted:
        """Fit the reference model, measure the noise's correlation, and fit again under it."""
        solution = self._require(self._fit_reference())
        self.noise = measure_noise(self.campaign, self.records, solution)
        if differs_from_stated(self.noise):
            self._stack(self.noise)
            solution = self._require(self.problem.solve(self.base, solution.u, solution.z))
        self._span(solution)
        self.lost = is_lost(self.problem, solution)
        return self._file((), solution)

    def _span(self, solution: Solution) -> None:
        """The splines of every record, and, as they are asked for, what makes these orthonormal, by record."""
        self.bases = smooth_bases(self.problem, solution.end)
        self.turns: dict[int, np.ndarray] = {}

    def _stack(self, noise: dict[str, Noise]) -> None:
        """All samples, and thinned records on which many candidates are tried."""
        self.records: Records = stack_records(self.campaign, noise, zeros=self.zeros)
        self.problem = Problem(self.space, self.records)
        self.thin: Problem | None = None
        if self.records.lengths.max() > self.settings.screening_samples:
            self.thin = Problem(self.space, stack_records(self.campaign, noise, self.settings.screening_samples,
                                                           self.zeros))

    def _fit_reference(self) -> Solution:
        """From a start guessed from the contact times, else from the defaults."""
        self.guess = guess_start(self.campaign, self.space, self.start, self.base)
        return solve_growing(self.problem, self.base, self.guess)

    def list_origins(self, base: np.ndarray) -> list[np.ndarray]:
        """Where a fit with more effects starts: where the poorer model ended, and without what strayed there.

        A parameter may run away to make up for what is missing, to where nothing depends on it any more.
        """
        own = [self.space.index[name] for name in self.base]
        strayed = [k for k in own if abs(base[k] - self.guess[k]) > self.settings.strayed * self.problem.scales[k]]
        if not strayed:
            return [base]
        back = base.copy()
        back[strayed] = self.guess[strayed]
        return [base, back]

    def _require(self, solution: Solution) -> Solution:
        if solution.failed:
            raise ComputationError(
                f"the reference model could not be integrated for record {solution.failed[0]!r} "
                f"({len(solution.failed)} of {self.records.count} records): check its conditions and units"
                + "".join(f". {text}" for text in self.warnings))
        return solution

    def measure_again(self, fitted: Fitted) -> bool:
        """Measure the noise on a better model's residuals; True if it changed, and every fit has to be made again.

        What a poor model leaves may be too sharp for the splines that are taken out of its residuals first.
        """
        noise = measure_noise(self.campaign, self.records, fitted.solution)
        if not changed(self.noise, noise):
            return False
        self.noise = noise
        self._stack(noise)
        return True

    def repeat(self, fitted: Fitted) -> Fitted:
        """The same model fitted again from where it was (after the noise has changed)."""
        solution = self.problem.solve(fitted.solution.names, fitted.solution.u, fitted.solution.z, tolerance=1e-4)
        self._span(solution)
        return self._file(fitted.effects, solution)

    def finish(self, fitted: Fitted) -> Fitted:
        """The same fit, of all samples, to a tight tolerance."""
        solution = self.problem.solve(fitted.solution.names, fitted.solution.u, fitted.solution.z, tolerance=1e-5)
        if solution.failed or solution.chi2 > fitted.solution.chi2 + 1e-3:
            return fitted
        return self._file(fitted.effects, solution)

    def fit(self, effects: Sequence[str], starts: Sequence[dict[str, float]], base: np.ndarray, z: np.ndarray,
            tolerance: float = 1e-2, extra: Sequence[str] = (), screening: bool = False, thinned: bool = False
            ) -> Fitted | None:
        """Fit the reference model with `effects` from several starts and keep the best; None if none worked.

        `screening` takes few steps, to thinned records where there are such; `thinned` takes these alone.
        """
        problem = self.thin if (screening or thinned) and self.thin is not None else self.problem
        freed = [n for n in self.freed if n.split(".")[0] in effects]
        free = [*self.base, *(n for e in effects for n in self.space.of([e])), *freed, *extra]
        best = None
        jobs = [(problem.solve, o, s, z) for o in self.list_origins(base) for s in starts]
        if self.lost:
            jobs += [(partial(solve_growing, problem), self.guess, s, None) for s in starts]
        for solve, origin, start, own in jobs:
            u = origin.copy()
            for name, value in start.items():
                u[self.space.index[name]] = value
            try:
                solution = solve(free, u, own, tolerance=1.0 if screening else tolerance,
                                 max_steps=self.settings.screening_steps if screening else 30)
            except ComputationError:
                continue
            if not solution.failed and np.isfinite(solution.chi2) and (best is None or solution.chi2 < best.chi2):
                best = solution
        if best is None:
            return None
        return self._file(effects, best, problem)

    def _file(self, effects: Sequence[str], solution: Solution, problem: Problem | None = None) -> Fitted:
        """A fit with its held-out losses."""
        problem = problem or self.problem
        loss = leave_out(solution, self.groups)
        ahead = (forecast(problem.records, solution, self.groups, self.settings.early) if self.family.free_running
                 else loss)
        return Fitted(tuple(effects), solution, loss, ahead, problem is not self.problem, self.settings.significant)

    def measure_left_out(self, fitted: Fitted) -> float:
        """Error of `fitted` on what it was not fitted to, rms over rms signal: the same for steps and candidates.

        Every condition is predicted by the model fitted without it, its own settings adjusted within their stated
        uncertainty (`predict_left_out`). NaN where there are too few conditions, or a prediction could not be computed.
        """
        if not self.holds_out:
            return float("nan")
        problem = self.thin if fitted.thinned and self.thin is not None else self.problem
        channels, used = predict_left_out(problem, fitted.solution, self.groups, self.settings.early)
        return measure_error(problem.records, channels, used)

    def directions(self, exclude: Sequence[str], probes: bool = True, depth: float | None = None,
                   frequency: float | None = None) -> list[tuple[str, str, dict[str, float]]]:
        """Every direction outside a model: catalogue (shapes on their grids), and probes."""
        wanted = []
        for effect in self.catalogue:
            if effect.id in exclude:
                continue
            amplitudes = [f"{effect.id}.{p.name}" for p in parameters_of(effect) if p.kind != "shape"]
            singular = [f"{effect.id}.{p.name}" for p in parameters_of(effect) if p.singular]
            for start in default_starts(effect):
                # What has no slope at its null is scored where a fit would start.
                shapes = {n: v for n, v in start.items() if n not in amplitudes or n in singular}
                wanted += [(effect.id, a, shapes) for a in amplitudes]
        if probes:
            for effect in self.probes:
                if effect.id in exclude:
                    continue
                onset, line = (getattr(effect, name, None) for name in ("onset", "line"))
                places: list[dict[str, float]] = [{}]
                if onset is not None:
                    places = [{onset: float(np.log(d * depth))} for d in (0.3, 0.55, 0.8)] if depth else []
                elif line is not None:
                    places = [{line: float(np.log(frequency))}] if frequency else []
                wanted += [(effect.id, f"{effect.id}.{p.name}", place) for place in places
                           for p in parameters_of(effect) if p.kind != "shape"]
        return wanted

    def judge(self, fitted: Fitted) -> tuple[LackOfFit, list[Score]]:
        """Lack of fit of a model, and the scores of everything outside it."""
        depth = float(fitted.solution.state.max())
        scores = score_directions(self.problem, fitted.solution, self.directions(fitted.effects, depth=depth))
        return judge_fit(self.problem, fitted.solution, self.bases, self.noise, self.calibrate(scores), self.settings), scores

    def calibrate(self, scores: list[Score]) -> float:
        """Family-wise p-value of the largest score: by bootstrap where few long records leave few conditions."""
        if self.family.free_running:
            return bootstrap_p_value(scores, self.noise, self.settings.bootstrap)
        return family_p_value(scores, self.noise)

    def whole(self, effect_id: str) -> type[AbstractEffect]:
        """Class of an effect by its id."""
        if effect_id not in self.by_id:
            raise InputError(f"there is no effect {effect_id!r}; there are: {', '.join(e.id for e in self.catalogue)}")
        return self.by_id[effect_id]
