"""What the data cannot tell apart: combinations of parameters that hardly change the records, and what would help."""

import copy
import dataclasses as dc
import math
from collections.abc import Mapping, Sequence

import jax.numpy as jnp
import numpy as np

from ..contact.effect import read_validity
from ..measurement.campaign import Campaign
from ..measurement.quantities import join_words
from ..measurement.units import si_unit
from .parameters import AbstractSpace, ParameterSpace
from .problem import Problem, Solution
from .stack import condition_deviations


CLOSE = 0.95  # a correlation beyond it is said in words: fixing the one then narrows the other at least threefold
# Singular value of unit columns below which a combination changes nothing at all: derivatives are no better.
SINGULAR = 1e-5
# Typical changes beyond which nothing is known of a coordinate that has a scale: a hundredfold is any value.
VAST = 100.0
ELSEWHERE = {
    "effective_mass": "weigh the moving parts", "sensor-gain.g": "calibrate the force gauge",
    "contact_radius_coefficient": "measure the contact disc", "outer_diameter": "measure the ball",
    "restitution": "measure the rebound speed", "loss_factor": "measure the loss factor on a rheometer",
    "slip_scale": "measure at other loads", "ambient-pressure.p_a": "read the barometer",
}  # fmt: skip
# Reach of a further test beyond the campaign's lowest and highest setting: gas can be let out at will and a ball bears
# little more than it did, a rig is driven somewhat faster or slower, and weights are halved and doubled.
REACH = {
    "approach_speed": (0.6, 1.5), "initial_pressure": (0.25, 1.25), "internal_pressure": (0.25, 1.25),
    "normal_load": (0.5, 2.0), "slip_speed": (0.3, 3.0),
}  # fmt: skip
LEAST_PRESSURE = 2e5  # Pa, absolute: with less than the atmosphere over that outside a ball is hardly inflated
ROUNDING = 1e-7  # of the largest singular value of columns of unit length, below which one is rounding
DISAGREES = 3.0  # deviations of a prior, beyond which values are said to disagree with it: by chance one in 370
DEPRESSION_SD = 2e-5  # m, of a displacement gauge; `design` assumes the same
# Typical changes that the prior of a parameter of series is wide, and which it has to have gone to have one: Eq. 10's
# slopes were at 25 to 43 1/mm instead of a tenth to a half.
WIDE = 20.0
FAR = 10.0  # standard deviations away, where the misfit of a parameter that is known has risen by a hundred
FLAT = 0.25  # of that rise: where it stays below on either side, the standard deviation is that of a dent in the noise
NUDGE = 0.02  # in scales of coordinates and deviations of nuisances, of the differences that give a depression's slopes


@dc.dataclass(frozen=True)
class Blend:
    """A combination of parameters that the data hardly fix."""

    names: tuple[str, ...]  # of its members, the largest part first
    # direction, step: change of every free coordinate along it, in units of unit-norm columns and for one standard
    # deviation, shape (free,).
    direction: np.ndarray
    step: np.ndarray
    singular: bool  # whether it changes the records not at all


@dc.dataclass(frozen=True)
class Remedy:
    """A measurement that tells the members `names` of a combination apart, as the linearised fit expects it."""

    names: tuple[str, ...]
    setting: str  # condition at which as many records again would be measured, or `depression`, the channel to add
    # Of the condition, SI: half of the records at each of two, or all at one; of the channel its deviation.
    values: tuple[float, ...]
    gain: float  # standard deviation along the combination, now over then


@dc.dataclass(frozen=True)
class Knowledge:
    """What a fit knows about its free parameters."""

    # covariance, correlations: of the free coordinates; large and finite along combinations that nothing fixes.
    covariance: np.ndarray
    correlations: np.ndarray
    # undetermined, silent: parameters about which nothing is known; those among them that change no record.
    undetermined: tuple[str, ...]
    silent: tuple[str, ...]
    blends: tuple[Blend, ...]  # combinations that the data hardly fix, worst first

    def widen(self, factors: Mapping[str, float], names: Sequence[str]) -> "Knowledge":
        """The same with the standard deviations of the parameters that are named in `factors` so many times as large;
        `names` of all, in the order of the covariance."""
        scale = np.array([factors.get(name, 1.0) for name in names])
        return dc.replace(self, covariance=self.covariance * np.outer(scale, scale))


def analyse_fit(space: AbstractSpace, solution: Solution) -> Knowledge:
    """Find what the Jacobian of a fit determines."""
    return analyse_jacobian(solution.names, solution.flattened()[0], solution.scales,
                            np.array([limit_knowledge(space, name) for name in solution.names]))


def analyse_jacobian(names: Sequence[str], columns: np.ndarray, scales: np.ndarray, vast: np.ndarray) -> Knowledge:
    """Find what a Jacobian determines: whitened derivatives by coordinate/scale, shape (rows, free), with nuisances
    eliminated and priors among the rows. `vast` are deviations of coordinates beyond which nothing is known.
    """
    count = len(names)
    norms = np.linalg.norm(columns, axis=0)
    silent = norms * vast < scales
    # What changes the records by less than their noise, however far it goes, is as uncertain as it can be and no more:
    # rounding in its column, alike to that of another parameter, would make that one uncertain, too.
    safe = np.where(silent, scales / vast, np.maximum(norms, 1e-6 * scales / vast))
    unit = columns / safe
    _, s, rows = np.linalg.svd(np.concatenate([unit, np.diag(silent.astype(float))]), full_matrices=False)
    spread = rows.T / np.maximum(s, 1e-6)
    covariance = spread @ spread.T * np.outer(scales / safe, scales / safe)
    sd = np.sqrt(np.diag(covariance))
    correlations = covariance / np.outer(sd, sd)
    blends, lost = [], silent | (sd > vast)
    for k in range(count - 1, -1, -1):
        v = rows[k]
        part = np.abs(v) > 0.25 * np.abs(v).max()
        if s[k] > math.sqrt(1 - CLOSE) or part.sum() < 2 or np.any(silent & part):
            continue
        singular = bool(s[k] < SINGULAR or np.all(np.abs(v / s[k] * scales / safe)[part] > vast[part]))
        lost = lost | (part & singular)
        order = [j for j in np.argsort(-np.abs(v)) if part[j]]
        members = tuple(str(names[int(j)]) for j in order)
        blends.append(Blend(members, v, v / max(s[k], 1e-6) * scales / safe, singular))
    return Knowledge(covariance, correlations, tuple(n for n, x in zip(names, lost, strict=True) if x),
                     tuple(n for n, x in zip(names, silent, strict=True) if x), tuple(blends))


def limit_knowledge(space: AbstractSpace, name: str) -> float:
    """Standard deviation of a coordinate beyond which nothing is known about the parameter."""
    p = space.parameter(name)
    return min(p.transform.unknown, VAST * p.transform.scale(p.typical))


def list_unproven(problem: Problem, solution: Solution) -> tuple[str, ...]:
    """Reference parameters that the records seem to fix, and refits `FAR` away say they do not.

    Records that run on for many turns have a frequency (that of a spinning body follows from its inertia ratio). Where
    nothing turns, the fit is caught in one of the many minima that noise has, and the curvature there tells nothing of
    how far the next one is.
    """
    space = problem.space
    if not space.family.free_running or not problem.is_whole(solution):
        return ()  # without turns, or of thinned records
    sd, found = np.sqrt(np.maximum(np.diag(solution.covariance()), 0.0)), []
    for name, width in zip(solution.names, sd, strict=True):
        k = space.index[name]
        if space.slots[k].owner is not None or not 0 < width < limit_knowledge(space, name):
            continue
        others, ends = [other for other in solution.names if other != name], []
        for side in (FAR, -FAR):
            u = solution.u.copy()
            u[k] = np.clip(u[k] + side * width, problem.limits[0][k], problem.limits[1][k])
            away = abs(u[k] - solution.u[k]) / width
            if away < 0.5 * FAR:  # a limit is near, and what lies before it tells too little
                continue
            refit = problem.solve(others, u, solution.z, tolerance=1e-2)
            ends.append(not refit.failed and refit.chi2 - solution.chi2 < FLAT * away**2)
            if not ends[-1]:
                break
        if ends and all(ends):
            found.append(name)
    return tuple(found)


def analyse_with_refits(problem: Problem, solution: Solution) -> Knowledge:
    """Find what the Jacobian of a fit determines, less what refits say it does not."""
    known = analyse_fit(problem.space, solution)
    unproven = [name for name in list_unproven(problem, solution) if name not in known.undetermined]
    return dc.replace(known, undetermined=(*known.undetermined, *unproven)) if unproven else known


def assume_typical(problem: Problem, solution: Solution, start: np.ndarray) -> dict[str, tuple[float, float]]:
    """Priors of the reference model's parameters that records do not determine, Gaussian in their coordinates.

    Peak forces hardly feel the restitution, nor rebound speeds the mass, nor friction at three loads how Eq. 10's
    coefficients bend over the load. Fitted without a prior such a parameter goes to where nothing depends on it, and
    those that depend on it are then as wrong as they look certain. The prior stands where the model has the parameter
    (`start`, coordinates of all), and is as wide as what is typical of it; where records are series, which show the
    course of a contact, it is far wider, and only for what went farther than that.

    Returns:
        Mean and standard deviation by name.
    """
    if not solution.names:
        return {}
    values = problem.records.are_values
    space, found = problem.space, {}
    vast = np.array([limit_knowledge(space, name) for name in solution.names])
    columns, own = solution.flattened()[0], [space.slots[space.index[name]].owner is None for name in solution.names]
    norms = np.linalg.norm(columns, axis=0)
    places = [space.index[name] for name in solution.names]
    width = (1.0 if values else WIDE) * problem.scales[places]
    astray = np.abs(solution.u[places] - start[places]) > width
    while True:  # one after the other, what the values feel least first: given one, they may determine the others
        unknown = analyse_jacobian(solution.names, columns, solution.scales, vast).undetermined
        open_ = [k for k, name in enumerate(solution.names) if name in unknown and own[k] and name not in found
                 and (values or astray[k])]
        if not open_:
            return found
        k = min(open_, key=lambda k: norms[k])
        found[solution.names[k]] = float(start[places[k]]), float(width[k])
        columns = np.concatenate([columns, np.eye(len(norms))[k: k + 1]])


def _span(columns: np.ndarray) -> np.ndarray:
    """Orthonormal columns that span these, shape (rows, rank)."""
    if not columns.shape[1]:
        return columns
    left, s, _ = np.linalg.svd(columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300), full_matrices=False)
    return left[:, s > ROUNDING * s.max()]


def weigh_priors(solution: Solution) -> np.ndarray:
    """How far the prior of each free parameter is from what the records and the other priors say of it, in standard
    deviations of the difference, shape (free,): its residual over the square root of one less its leverage; 0 where
    there is no prior, or nothing else says anything.
    """
    if not solution.prior_weight.any():
        return np.zeros(len(solution.names))
    columns = solution.flattened()[0]
    left = _span(columns)
    told = 1.0 - np.sum(left[len(columns) - columns.shape[1]:] ** 2, axis=1)
    return np.where(told > ROUNDING, solution.prior_residual / np.sqrt(np.maximum(told, ROUNDING)), 0.0)


def release_priors(problem: Problem, solution: Solution) -> tuple[np.ndarray, Solution]:
    """How far priors are from what all else says, as `weigh_priors`, and the fit without those that it disagrees with.

    Linear algebra only says which to ask about: a valley that bends, or ends, is not where its slope points. What
    stands is the root of what chi-square falls by in a refit without the prior (the same of a linear model).
    """
    away = weigh_priors(solution)
    for k in np.flatnonzero(np.abs(away) > DISAGREES):
        alone = _fit_without(problem, solution, (solution.names[k],))
        away[k] = math.copysign(math.sqrt(max(solution.chi2 - alone.chi2, 0.0)), away[k])
    gone = tuple(name for name, far in zip(solution.names, away, strict=True) if abs(far) > DISAGREES)
    return away, _fit_without(problem, solution, gone) if gone else solution


def _fit_without(problem: Problem, solution: Solution, gone: tuple[str, ...]) -> Solution:
    """The fit again without the priors of these parameters; as it was, where that leaves no less."""
    bare = copy.copy(problem)
    bare.priors = {name: prior for name, prior in problem.priors.items() if name not in gone}
    found = bare.solve(solution.names, solution.u, solution.z)
    return solution if found.failed or not found.chi2 < solution.chi2 else found


def measure_values(problem: Problem, solution: Solution) -> tuple[float, float]:
    """Chi-square of values and their settings, of which there are few, and its degrees of freedom.

    A parameter that its prior determines takes none of them: they are the values less the trace of the hat matrix. A
    prior that the values disagree with is let go, by a refit, as what it leaves is no misfit of the model.
    """
    alone = release_priors(problem, solution)[1]
    columns, right = alone.projected()
    left = _span(np.concatenate([columns.reshape(right.size, columns.shape[2]), np.diag(alone.prior_weight)]))
    return float(np.sum(right**2)), float(problem.records.used.sum()) - float(np.sum(left[: right.size] ** 2))


def list_disputed(problem: Problem, solution: Solution) -> tuple[str, ...]:
    """Parameters whose priors the records disagree with; errors that all records share are none."""
    common = {one.slot.name for one in problem.space.commons}
    return tuple(name for name, away in zip(solution.names, release_priors(problem, solution)[0], strict=True)
                 if name in problem.priors and name not in common and abs(away) > DISAGREES)


def describe_assumed(problem: Problem, priors: Mapping[str, tuple[float, float]], solution: Solution
                     ) -> tuple[str, ...]:
    """These priors in sentences, and which of them the values disagree with at a fit."""
    if not priors:
        return ()
    found, space = [], problem.space
    apart = dict(zip(solution.names, np.abs(release_priors(problem, solution)[0]), strict=True))
    for name, (mean, sd) in priors.items():
        transform = space.parameter(name).transform
        low, high = transform.interval(mean - sd, mean + sd)
        found.append(f"The records do not determine {name}: a prior around {transform.from_unconstrained(mean):.3g} "
                     f"({low:.2g} to {high:.2g} within one standard deviation) takes the place of a measurement.")
        if apart.get(name, 0.0) > DISAGREES:  # one that stopped at a bound is not among the free ones
            estimate = transform.from_unconstrained(float(solution.u[space.index[name]]))
            found.append(f"The records disagree with that prior: they pull {name} to {estimate:.3g}, and by themselves "
                         f"are {apart[name]:.2g} standard deviations away from it. Either the model does not hold "
                         "here, or this parameter is not what is typical; measure it by another test, and fix it at "
                         "the result.")
    return tuple(found)


def describe_knowledge(problem: Problem, solution: Solution, known: Knowledge, campaign: Campaign
                       ) -> tuple[tuple[str, ...], tuple[Remedy, ...]]:
    """What the records of a fit cannot tell apart, in sentences, and the tests that would resolve it."""
    remedies: list[Remedy] = []
    names, columns, told = solution.names, solution.flattened()[0], [set(blend.names) for blend in known.blends]
    found = [f"These records contain no information on {name}: it changes them by less than their noise."
             for name in known.silent]
    for k, blend in enumerate(known.blends):
        change, members = _format_change(problem.space, solution, blend), join_words(blend.names)
        if blend.singular:
            text = (f"{members} cannot be distinguished: {change} changes no record beyond its noise, so only "
                    "their combination is determined, not the single values")
        else:
            places = [names.index(name) for name in blend.names]
            worst = np.max(np.abs(known.correlations[np.ix_(places, places)] - np.eye(len(places))))
            text = (f"{members} are hard to distinguish (correlation up to {worst:.3f}): {change} changes the records "
                    "by only one standard deviation")
        remedy = _find_remedy(problem, solution, columns, blend, campaign) if k < 2 else None
        elsewhere = [ELSEWHERE[name] for name in blend.names if name in ELSEWHERE]
        if remedy is not None:
            remedies.append(remedy)
            advice = _format_remedy(remedy, blend)
        elif elsewhere:
            advice = f"{' or '.join(elsewhere)}, and fix the parameter at the result"
        else:
            advice = f"fix one of them ({' or '.join(blend.names)}) at a value known from elsewhere"
        found.append(f"{text}; {advice}.")
    for i, a in enumerate(names):
        for b, value in zip(names[:i], known.correlations[i], strict=False):
            if abs(value) > CLOSE and not any({a, b} <= t for t in told) and not {a, b} & {*known.silent}:
                found.append(f"{b} and {a} are hard to distinguish (correlation {value:+.3f}).")
    for name in known.undetermined:
        if name not in known.silent and not any(name in t for t in told):
            found.append(f"These records hardly determine {name}: its uncertainty exceeds any likely value.")
    return tuple(found), tuple(remedies)


def _format_change(space: ParameterSpace, solution: Solution, blend: Blend) -> str:
    """Such as: raising a by 1 % and lowering b by 0.02."""
    first = solution.names.index(blend.names[0])
    step = blend.step if blend.step[first] > 0 else -blend.step
    if blend.singular:  # any length will do
        p = space.parameter(blend.names[0])
        step = step / abs(step[first]) * (0.01 if p.coordinate == "log" else 0.05 * p.transform.scale(p.typical))
    parts = []
    for name in blend.names:
        transform, here = space.parameter(name).transform, solution.u[space.index[name]]
        before = transform.from_unconstrained(here)
        change = transform.from_unconstrained(here + step[solution.names.index(name)]) - before
        if transform.name == "log" and before:
            size = f"{abs(change / before) * 100:.2g} %"
        else:
            size = f"{abs(change):.2g} {space.unit(name, solution.u)}".rstrip()
        parts.append(f"{'raising' if change > 0 else 'lowering'} {name} by {size}")
    return join_words(parts)


def _format_remedy(remedy: Remedy, blend: Blend) -> str:
    if remedy.setting == "depression":
        what = f"the depression as a further channel (to {1e3 * remedy.values[0]:g} mm)"
    else:
        unit, factor = ("MPa", 1e-6) if remedy.setting.endswith("pressure") else (si_unit(remedy.setting), 1.0)
        values, name = [f"{factor * value:.2g}" for value in remedy.values], remedy.setting.replace("_", " ")
        article = "an" if name[0] in "aeiou" else "a"
        what = f"as many records again, {'half ' if len(values) > 1 else ''}at {article} {name} of {values[0]} {unit}"
        what += f" and half at {values[1]} {unit}," if len(values) > 1 else ","
    times = f"{remedy.gain:.1f}" if remedy.gain < 10 else "more than ten"
    return f"{what} would " + ("distinguish them" if blend.singular else
                               f"reduce the uncertainty of this combination by a factor of {times}")


def _find_remedy(problem: Problem, solution: Solution, columns: np.ndarray, blend: Blend, campaign: Campaign
                 ) -> Remedy | None:
    """The measurement that shortens a combination's uncertainty most; None where none does so by half."""
    tests = [(name, values) for name in REACH if name in campaign.records
             for values in _list_settings(problem, campaign, name)]
    tried = [Remedy(blend.names, *test, _try_conditions(problem, solution, columns, blend, campaign, *test))
             for test in tests]
    if problem.space.family.has_contact and "depression" not in problem.records.channels:
        tried.append(Remedy(blend.names, "depression", (DEPRESSION_SD,), _try_depression(problem, solution, blend)))
    best = max(tried, key=lambda remedy: remedy.gain, default=None)
    if best is None:
        return None
    size = max(abs(x) / p.transform.scale(p.typical)
               for p, x in zip(map(problem.space.parameter, solution.names), blend.step, strict=True))
    enough = size < 0.3 * best.gain if blend.singular else best.gain > 2.0
    return best if enough else None


def _list_settings(problem: Problem, campaign: Campaign, name: str) -> list[tuple[float, ...]]:
    """Settings of a condition, SI, to two digits, for further records: lowest and highest that are valid, and both."""
    stated = campaign.records[name].to_numpy(dtype=float)
    low, high = (factor * edge for factor, edge in zip(REACH[name], (stated.min(), stated.max()), strict=True))
    if not low > 0:
        return []
    if name.endswith("pressure"):
        low = max(low, min(LEAST_PRESSURE, stated.min()))
    first, last = read_validity(problem.space.reference).get(name, (0.0, math.inf))
    ends = []
    for value in (max(low, first), min(high, last)):
        unit = 10.0 ** (math.floor(math.log10(value)) - 1)
        near = round(value / unit) * unit
        near += unit * ((near < first) - (near > last))
        ends.append(float(f"{near:.2g}"))
    low, high = ends
    return [(low,), (high,), (low, high)] if low < high else []


def _try_conditions(problem: Problem, solution: Solution, columns: np.ndarray, blend: Blend, campaign: Campaign,
                    name: str, values: Sequence[float]) -> float:
    """Standard deviation along a combination, now over that with as many records again at other settings."""
    records = problem.records
    count, table = records.count, campaign.records.copy()
    table[name] = [values[k % len(values)] for k in range(count)]
    conditions, sd = dict(records.stack.conditions), np.array(records.stack.condition_sd)
    conditions[name] = conditions[name].at[:count].set(table[name].to_numpy(dtype=float))
    stated = tuple(n for n in records.nuisances if n in campaign.conditions or n == "time")
    places = [records.nuisances.index(n) for n in stated]
    there = condition_deviations(campaign, table, stated)
    sd[:count, places] = np.where(sd[:count, places] > 0, there, 0.0)  # none where the settings do not move
    stack = dc.replace(records.stack, conditions=conditions, condition_sd=jnp.asarray(sd))
    if problem.space.family.has_contact:
        before = np.asarray(records.stack.conditions[name])
        longer = np.ones(len(before))  # a record lasts as long as its contact, pressure^(-1/3) speed^(-1/3)
        longer[:count] = np.maximum(before[:count] / table[name].to_numpy(dtype=float), 1.0) ** (1.0 / 3.0)
        stack = dc.replace(stack, time=stack.time * longer[:, None], span=stack.span * longer)
    other = Problem(problem.space, dc.replace(records, stack=stack))
    found = other.solve(solution.names, solution.u, np.zeros_like(solution.z), moving=False)
    if found.failed:
        return 1.0
    more, _ = found.projected()
    both = np.concatenate([columns, more.reshape(-1, columns.shape[1])])
    return measure_spread(columns, columns, blend) / measure_spread(both, columns, blend)


def _try_depression(problem: Problem, solution: Solution, blend: Blend) -> float:
    """The same with the depression of the present records measured too, its slopes taken by differences."""
    names, still = solution.names, np.zeros_like(solution.z)
    steps = [(scale * np.eye(len(solution.u))[problem.space.index[name]], still)
             for name, scale in zip(names, solution.scales, strict=True)]
    steps += [(np.zeros_like(solution.u), still + row) for row in np.eye(still.shape[1])]
    slopes = []
    for u, z in steps:
        ends = [problem.solve(names, solution.u + s * u, solution.z + s * z, moving=False) for s in (NUDGE, -NUDGE)]
        if any(end.failed for end in ends):
            return 1.0
        slopes.append((ends[0].state - ends[1].state) / (2.0 * NUDGE * DEPRESSION_SD))
    rows = np.where(problem.records.used[:, 0, :, None], np.stack(slopes, axis=2), 0.0)
    wider = dc.replace(solution, shared=np.concatenate([solution.shared, rows[:, :, :len(names)]], axis=1),
                       own=np.concatenate([solution.own, rows[:, :, len(names):]], axis=1),
                       residual=np.concatenate([solution.residual, np.zeros(rows.shape[:2])], axis=1))
    columns, both = (one.flattened()[0] for one in (solution, wider))
    return measure_spread(columns, columns, blend) / measure_spread(both, columns, blend)


def measure_spread(rows: np.ndarray, columns: np.ndarray, blend: Blend) -> float:
    """Standard deviation along the combination that `rows` leave; lengths are those of unit-norm `columns`."""
    unit = rows / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    _, s, right = np.linalg.svd(unit, full_matrices=False)
    return float(np.linalg.norm((right @ blend.direction) / np.maximum(s, 1e-6)))
