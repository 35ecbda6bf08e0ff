r"""What effects would do to a fitted model, to first order: for sliders, which cannot integrate anything.

Lever $k$ moves a parameter by a step; the model's readings move by their change $C_k$ over that step (a secant, so that
it is exact at the step itself), every record's settings following within their uncertainty. With $r$ the whitened
residual and $R_k$ its change, both with the settings eliminated, chi-square of a record at positions $t$ is
$|r|^2 + 2 \sum t_k R_k r + \sum t_j t_k R_j R_k$.
"""

import dataclasses as dc
from collections.abc import Sequence

import numpy as np

from .._numerics import map_threads
from ..contact.effect import is_scored, parameters_of
from ..inference.assembly import default_starts
from ..inference.findings import Fit
from ..inference.levenberg_marquardt import eliminate_nuisances
from ..inference.problem import Problem, Solution
from ..inference.variance_components import list_settings
from .detectability import LEAST, detectable_length, find_size, reach_limit
from .result import Candidate


MOST = 24  # levers of effects: more would be a page that nobody reads
POINTS = 120  # samples of a record that are drawn
MARKS = 41  # places of a slider whose value is told
SHOWN = 1.0  # rms over the noise that an effect at the end of its slider leaves a refitted model: plain to see
BEYOND = 1.25  # of an estimate, that its slider reaches
PART = 0.3  # of its typical change, by which a parameter of the model itself moves to the end of its slider,
CURVED = 1.0  # unless the preview would be off by more than this there, rms over the noise half way


@dc.dataclass(frozen=True)
class Lever:
    """A slider: position 0 is the fit, 1 the end of a step."""

    name: str  # of the parameter
    effect: str  # that it is an amplitude of; '' for one of the model
    unit: str
    low: float  # lowest position: -1, or 0 where physics allows one side only
    values: tuple[float, ...]  # of the parameter in its public unit, at evenly spaced positions from `low` to 1
    error: float  # rms over the noise by which the preview is off the exact model at half the step


@dc.dataclass(frozen=True)
class Preview:
    """Records and levers, as a page needs them."""

    campaign: str
    model: str
    effects: tuple[str, ...]  # of the model already
    channel: str  # that is drawn
    unit: str
    abscissa: str
    levers: tuple[Lever, ...]
    keys: tuple[str, ...]  # of the records
    samples: np.ndarray  # of each record, shape (records,): what chi-square is counted over
    places: tuple[np.ndarray, ...]  # of the samples drawn, by record
    measured: tuple[np.ndarray, ...]
    fitted: tuple[np.ndarray, ...]
    changes: tuple[np.ndarray, ...]  # of the model by the levers, by record, shape (levers, samples)
    chi2: np.ndarray  # of the fit, with what its settings cost, shape (records,)
    slope: np.ndarray  # shape (records, levers)
    square: np.ndarray  # shape (records, levers, levers)
    has_settings: bool  # whether records have settings that state an uncertainty: then these follow
    has_starts: bool  # whether records start from rates that are free in each: then these follow

    def total(self, positions: Sequence[float]) -> float:
        """Chi-square of all records at positions of the levers."""
        t = np.asarray(positions, dtype=float)
        return float(np.sum(self.chi2 + 2.0 * self.slope @ t + np.einsum("gjk,j,k->g", self.square, t, t)))


def preview_effects(fit: Fit, candidates: Sequence[Candidate]) -> Preview | None:
    """Levers for the parameters of a fit and for the amplitudes of candidates, in their order, which reach beyond what
    was estimated of them. None where there is nothing to draw over time, nothing that moves the model, or no model of
    what the records' settings do to it.
    """
    problem, solution = fit.problem, fit.bounded.solution
    records = problem.records
    if records.are_values or solution.failed:
        return None
    moves = [move for name in solution.names if (move := _move_parameter(problem, solution, name)) is not None]
    added = [one for one in candidates if one.effect not in fit.effects]
    moves += [move for found in map_threads(lambda one: _move_effect(problem, solution, one), added)
              for move in found][:MOST]
    if not moves:
        return None
    levers, changes, columns = zip(*moves, strict=True)
    # Shapes (levers, records, samples) and (records, rows, levers).
    own, change, column = solution.own, np.stack(changes), np.stack(columns, axis=-1)
    # Settings follow: z = -(O'O + 1)^-1 O' R.
    inverse = np.linalg.inv(np.swapaxes(own, 1, 2) @ own + np.eye(own.shape[2]))
    follow = -inverse @ np.swapaxes(own, 1, 2) @ column  # (records, nuisances, levers)
    for j in range(own.shape[2]):
        # A step that the noise would hide: one deviation of what a record starts from, which is no prior, is too far.
        size = np.linalg.norm(own[:, :, j], axis=1)
        step = np.minimum(1.0, np.sqrt(records.lengths) / np.maximum(size, 1e-300))
        z = solution.z.copy()
        z[:, j] += step
        moved = problem.solve([], solution.u, z, moving=False)
        if moved.failed:
            return None
        by_setting = (moved.channels[:, 0] - solution.channels[:, 0]) / step[:, None]
        change = change + follow[:, j].T[:, :, None] * by_setting[None]
    prior = np.broadcast_to(np.eye(own.shape[2]), (records.count, own.shape[2], own.shape[2]))
    left, right = eliminate_nuisances(
        np.concatenate([column, np.zeros((records.count, own.shape[2], len(levers)))], axis=1),
        np.concatenate([own, prior], axis=1), np.concatenate([solution.residual, solution.z], axis=1))
    channel, stack = records.channels[0], records.stack
    keep = [np.unique(np.linspace(0, n - 1, min(n, POINTS)).astype(int)) for n in records.lengths]
    time, values = np.asarray(stack.time), np.asarray(stack.values)
    clock = fit.source.independent
    return Preview(
        fit.campaign, fit.model, tuple(fit.effects), channel, fit.source.channels[channel].unit,
        "time" if clock is None else clock.name, tuple(levers), records.keys,
        records.used.sum(axis=(1, 2)),
        tuple(time[r, k] for r, k in enumerate(keep)), tuple(values[r, 0, k] for r, k in enumerate(keep)),
        tuple(solution.channels[r, 0, k] for r, k in enumerate(keep)),
        tuple(change[:, r][:, k] for r, k in enumerate(keep)), np.sum(right**2, axis=1),
        np.einsum("grk,gr->gk", left, right), np.einsum("grj,grk->gjk", left, left), bool(list_settings(records)),
        bool(records.starts))


def _move(problem: Problem, solution: Solution, u: np.ndarray, name: str, effect: str, low: float
          ) -> tuple[Lever, np.ndarray, np.ndarray] | None:
    """A lever to the coordinates `u`, the change of the first channel there, (records, samples), and of the whitened
    residual, (records, rows).
    """
    space, way = problem.space, u - solution.u
    whole, half = (problem.solve([], solution.u + part * way, solution.z, moving=False) for part in (1.0, 0.5))
    if whole.failed or half.failed:
        return None
    column = whole.residual - solution.residual
    off = half.residual - solution.residual - 0.5 * column
    used = max(int(problem.records.used.sum()), 1)
    values = [space.public(name, solution.u + t * way, 0.0)["estimate"] for t in np.linspace(low, 1.0, MARKS)]
    lever = Lever(name, effect, space.unit(name, u), low, tuple(map(float, values)),
                  float(np.sqrt(np.sum(off**2) / used)))
    return lever, whole.channels[:, 0] - solution.channels[:, 0], column


def _move_parameter(problem: Problem, solution: Solution, name: str):
    k, u = problem.space.index[name], solution.u.copy()
    low, high = (float(one[k]) for one in problem.limits)
    step = min(PART * float(problem.scales[k]), 0.5 * (high - u[k]), 0.5 * (u[k] - low))
    found = None
    while step > LEAST * float(problem.scales[k]):
        u[k] = solution.u[k] + step
        found = _move(problem, solution, u, name, "", -1.0)
        if found is not None and found[0].error <= CURVED:
            break
        step *= 0.5
    return found


def _move_effect(problem: Problem, solution: Solution, candidate: Candidate):
    """Levers of the amplitudes of an effect, at the first of its starts."""
    space, found = problem.space, []
    kind = next((one for one in space.effects if one.id == candidate.effect), None)
    if kind is None:
        return found
    used = float((np.asarray(problem.records.stack.weights) > 0).sum())
    for p in filter(is_scored, parameters_of(kind)):
        name, origin = f"{candidate.effect}.{p.name}", solution.u.copy()
        for shape, value in default_starts(kind)[0].items():
            if space.parameter(shape).kind == "shape":
                origin[space.index[shape]] = value
        # From the smallest detectable size in proportion, which is nearly there.
        goal, least = SHOWN * np.sqrt(used), candidate.smallest_detectable.get(name)
        first = None if least is None else (
            abs(p.transform.to_unconstrained(least) - p.default) * goal / detectable_length(1))
        seen = find_size(problem, solution, origin, name, goal, first, jumps=True)
        if seen is None:
            continue
        reach = seen.size - p.default if np.isfinite(seen.size) else (p.sign or 1) * reach_limit(p)
        if name in candidate.estimates:
            told = abs(p.transform.to_unconstrained(candidate.estimates[name].estimate) - p.default)
            reach = float(np.copysign(min(max(abs(reach), BEYOND * told), reach_limit(p)), reach))
        u = origin.copy()
        u[space.index[name]] = p.default + reach
        # Shapes do nothing at the null, so that the whole way from it is along the amplitude.
        move = _move(problem, dc.replace(solution, u=origin), u, name, candidate.effect, 0.0 if p.sign else -1.0)
        if move is not None:
            found.append(move)
    return found
