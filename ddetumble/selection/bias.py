"""Settings that are wrong alike in all records (a gauge that reads high throughout), as rivals of physics."""

import dataclasses as dc
from collections.abc import Mapping, Sequence

import numpy as np

from .._errors import ComputationError
from ..contact.effect import MEASURING, AbstractEffect
from ..inference.goodness import combine_p_values, weigh_shifts
from ..inference.problem import Solution
from ..inference.variance_components import list_settings
from .cross_validation import compare_losses, leave_out
from .problem import Fitted, SelectionProblem
from .settings import SelectionSettings


ROUNDS = 2  # estimates of the scatter: without the bias, and about it
STEPS = 3  # Gauss-Newton steps to a bias: over 2 % of a speed an impact bends by hundreds of noise variances
CLOSE = 0.3  # deviations of a bias from its end, within which chi-square is right to a tenth


@dc.dataclass(frozen=True)
class SettingBias:
    """An error of one setting that all records share, fitted beside a model."""

    name: str  # of the setting
    bias: float  # share by which what is written down is too large
    sd: float
    merit: float  # cross-validated loss with the penalty of its parameters, as of any other model
    rejected: bool  # whether a misfit is left, be it one that repeats over the records where settings may scatter
    difference: float  # of the cross-validated loss from that of the model it is a rival of, and its standard error
    standard_error: float
    effects: tuple[str, ...]  # of that model, which it may stand for
    scatter: Mapping[str, float] = dc.field(default_factory=dict)  # of settings about it over what is stated, by name
    alike: tuple["SettingBias", ...] = ()  # errors of other settings that do as well, where this one is allowed for

    def is_beyond(self, standard_errors: float) -> bool:
        """Whether the error is more than so many of its standard errors: one that may be none explains nothing."""
        return abs(self.bias) > standard_errors * self.sd


def fit_biases(selection: SelectionProblem, fitted: Fitted, rival: Fitted) -> list[SettingBias]:
    """Every setting that states an uncertainty, biased by itself beside the model `fitted`; the best rival first.

    A bias moves every record as its own nuisance does, all by the same share: the columns of the fit are known, and it
    takes a few Gauss-Newton steps.
    """
    records, found = selection.records, []
    deviations = np.asarray(records.stack.condition_sd)[: records.count]
    for k, name in enumerate(records.nuisances):
        if (name not in selection.campaign.records or name in records.starts or not (deviations[:, k] > 0).all()
                or selection.campaign.conditions[name].common is not None):  # the model has it
            continue
        values = np.abs(selection.campaign.records[name].to_numpy(dtype=float))
        # The true setting is the one written down x (1 - bias): by so many of its deviations.
        size = -selection.settings.bias * values / deviations[:, k]
        at, spread = _add_bias(selection, fitted.solution, k, size)
        loss = leave_out(at, selection.groups)
        biased = dc.replace(fitted, solution=at, loss=loss, penalty=selection.settings.significant)
        chances = [combine_p_values([weigh_shifts(at.z[:, j]) for j in list_settings(records)])]
        if selection.is_loose and (repeats := selection.measure_repeats(at)) is not None:
            chances.append(repeats)
        rejected = selection.disperse(biased) > 1.0 or min(chances) < selection.settings.level_each
        found.append(SettingBias(
            name, selection.settings.bias * float(at.u[-1]), selection.settings.bias * spread, biased.merit, rejected,
            *compare_losses(loss, rival.loss, selection.groups),
            tuple(effect for effect in rival.effects if effect not in fitted.effects),
            {other: float(np.sqrt(np.mean(np.square(at.z[:, j])))) * selection.spread[other]
             for j, other in enumerate(records.nuisances) if other in selection.spread}))
    return sorted(found, key=lambda one: one.merit)


def join_alike(best: SettingBias, biases: Sequence[SettingBias], settings: SelectionSettings) -> SettingBias:
    """The best of several errors beside one model, with those of other settings that do as well as it."""
    return dc.replace(best, alike=tuple(one for one in biases if one.name != best.name and one.effects == best.effects
                                        and one.merit < best.merit + settings.significant))


def matches_effects(biases: Sequence[SettingBias], merit: float, effects: Sequence[type[AbstractEffect]]) -> bool:
    """Whether errors of a setting that predict as well as effects, the best first, leave these unproven.

    No physics is named where such an error does as well. A gauge's own gain is an error of calibration too: it gives
    way only to one that does better than its `merit`, and else is named with those that look the same.
    """
    physics = any(effect.stage not in MEASURING for effect in effects)
    return bool(biases) and (physics or biases[0].merit < merit)


def stand_in(selection: SelectionProblem, models: Sequence[Fitted]) -> tuple[list[SettingBias], list[SettingBias]]:
    """Errors of one setting beside each of the models before the last one that leave no misfit, and that the last one
    does not beat: those beside the first model, and those that stand for some effects only.

    Args:
        selection: what the models were fitted to.
        models: of a forward selection, each with the effects of the one before and more.
    """
    last, found = models[-1], []
    for fitted in models[:-1]:
        found.append([one for one in fit_biases(selection, fitted, last)
                      if not one.rejected and one.is_beyond(selection.settings.standard_errors)
                      and not selection.settings.is_beaten(one.difference, one.standard_error)])
    return found[0], [one for later in found[1:] for one in later]


def find_bias(selection: SelectionProblem, fitted: Fitted) -> SettingBias | None:
    """The error of one setting, shared by all records, that leaves a model without misfit; None where there is none.

    Settings may scatter more than stated beside it. A scatter that is estimated without the error includes it, and may
    leave a misfit that the error does not: first they scatter as stated, then as estimated, and then about the error.
    """
    begins = (dict(selection.spread), selection.estimate_spread(fitted))
    best = next(filter(None, (_settle_bias(selection, fitted, spread) for spread in begins)), None)
    return best if best is not None and best.is_beyond(selection.settings.standard_errors) else None


def _settle_bias(selection: SelectionProblem, fitted: Fitted, spread: Mapping[str, float]) -> SettingBias | None:
    """The best error of one setting that leaves no misfit where settings scatter so many times as stated, and then as
    they do about it; None where there is none."""
    best = None
    for _ in range(ROUNDS):
        wider = selection.loosen(spread)
        again = wider.repeat(fitted, 1e-2)
        found = [one for one in fit_biases(wider.span(again.solution), again, again)
                 if not one.rejected and one.difference < 0.0]
        if not found:
            return None
        best = join_alike(found[0], found, selection.settings)
        spread = {name: ratio for name, ratio in best.scatter.items() if ratio > selection.settings.spread.least}
    return best


def _add_bias(selection: SelectionProblem, solution: Solution, k: int, size: np.ndarray) -> tuple[Solution, float]:
    """A fit with a bias as its last parameter, by Gauss-Newton steps, and the standard deviation of that; the first
    step alone where the next ones do not lead on.

    Args:
        selection, solution: what was fitted, and the fit without the bias.
        k: number of the nuisance that it moves, and
        size: how far one unit of it does so in every record, in units of the nuisance's deviations, shape (records,).
    """
    places, bias = [selection.space.index[name] for name in solution.names], 0.0

    def step(at: Solution) -> tuple[Solution, float]:
        wider = at.widen("bias", at.own[:, :, k] * size[:, None], 1.0)
        u, prior = wider.u.copy(), wider.prior_residual.copy()
        u[-1] = prior[-1] = bias
        return _step(dc.replace(wider, u=u, prior_residual=prior), [*places, len(u) - 1])

    found = first = step(solution)
    for _ in range(STEPS - 1):
        moved, spread = found
        if abs(moved.u[-1] - bias) < CLOSE * spread:
            break
        bias = float(moved.u[-1])
        # What belongs to the bias moves the nuisance, too, and has no part in its prior.
        z = moved.z.copy()
        z[:, k] += size * bias
        try:
            at = selection.problem.solve(solution.names, moved.u[:-1], z, moving=False)
        except ComputationError:
            return first
        at = dc.replace(at, z=moved.z)
        chi2 = sum(float(np.sum(np.square(x))) for x in (at.residual, at.z, at.prior_residual)) + bias**2
        if at.failed or not chi2 < solution.chi2:
            return first
        found = step(at)
    return found


def _step(solution: Solution, places: Sequence[int]) -> tuple[Solution, float]:
    """A Gauss-Newton step of a linearised fit, whose free parameters stand at `places` of all: where it ends, and the
    standard deviation of the last parameter."""
    step, spread = solution.step()
    # With the parameters moved, every record's nuisances follow under their priors.
    change = np.stack([solution.adjust_own(r, slice(None), step) for r in range(len(solution.own))])
    moved = solution.residual + solution.shared @ step + np.einsum("grk,gk->gr", solution.own, change)
    u = solution.u.copy()
    u[places] += step * solution.scales
    return dc.replace(solution, residual=moved, z=solution.z + change, u=u,
                      prior_residual=solution.prior_residual + solution.prior_weight * step), float(spread[-1])
