"""What a fit found: parameters with uncertainty, in a form that people and programs read."""

import abc
import dataclasses as dc
import itertools
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy import optimize

from .._display import AbstractPrinted
from .._errors import InputError
from ..measurement.campaign import Campaign
from ..measurement.quantities import format_number
from . import distributions as stats
from .archive import AbstractFitted, FittedModel, make_fitted, save_model
from .bounded import NEAR, Bounded, solve_bounded, truncate_normal
from .files import check_folder, list_versions, make_plain, write_json
from .goodness import GoodnessOfFit, judge_goodness, judge_values
from .identifiability import (
    Knowledge,
    Remedy,
    analyse_fit,
    analyse_with_refits,
    describe_knowledge,
    limit_knowledge,
    list_disputed,
    measure_values,
)
from .interval_width import widen_intervals
from .noise import Noise
from .parameters import ParameterSpace
from .problem import AbstractProblem, Problem, Solution
from .record_scatter import SCATTER, ScatterSettings
from .systematics import Systematic, measure_systematics, tell_systematics


FILE = "fit.json"
SCHEMA = "ddetumble.fit-result/1"
LEAST = 0.1  # correlations below are not printed: they change no reading of the table (lmfit's own limit)
NEXT, LIKELY = 0.03, 4.0  # of the distance to a null; and how much worse in chi-square (two sd) what lies there may fit
HIGH = 1e6  # of chi-square, for what could not be refitted: far above any end
# Times the rise that a straight line expects at the end of a 95 % interval from which on that is not to be trusted: of
# a hundred campaigns of Eq. 10 (fits/slip-coverage) intervals of parameters above it held the truth in 83 to 91.
BENT = 2.0
NEGLIGIBLE = 100.0  # times an estimate, from which its deviation is no share of it
INSIDE = ("source", "problem", "bounded", "gaussians")  # what of a fit is not written down


@dc.dataclass(frozen=True)
class Fitted:
    """One fitted parameter, in its public unit."""

    # estimate, sd: value and one standard deviation; infinite where the data determine nothing.
    estimate: float
    sd: float
    # q025, q975: 95 % interval, from the coordinate in which the fit moves.
    q025: float
    q975: float
    unit: str
    initial: float  # where the fit started
    at_bound: str = ""  # "" or which bound stopped it, `lower` or `upper`
    determined: bool = True  # False where the records say nothing about it
    text: str = ""  # what else there is to say


@dc.dataclass(frozen=True)
class Derived:
    """What follows from the fitted parameters, with one standard deviation to first order."""

    estimate: float
    sd: float
    unit: str


@dc.dataclass(frozen=True, eq=False, repr=False)
class Fit(AbstractFitted, AbstractPrinted):
    """A fit: parameters with their covariance and 95 % intervals, goodness of fit, residuals, notes.

    Attributes:
        campaign, title, sha256, records, samples: of the campaign, and how many it has.
        model, effects: name of the reference model, and ids of its effects.
        parameters, fixed: fitted ones, by name, and held ones, in their public unit.
        derived: what the model tells beside them, by name.
        covariance, correlations: of the coordinates of `parameters`, in their order, shape (free, free).
        chi2, degrees: sum of squares of whitened residuals, nuisances and priors, and its degrees of freedom.
        chi2_reduced: one by the other; of values, of which there are few, without what priors add and determine, as
            `goodness` judges it.
        goodness: whether that is more than noise leaves, and whether settings had to move further than stated.
        noise: by channel.
        converged, steps, state: of the optimiser, its steps from all starts together; `state` is a sentence.
        nuisances: by record and condition: `shift` (SI), `sd` (as stated), `pull` (their ratio); `estimate` and its
            `sd` of what tumbling records start from.
        cannot_tell_apart, remedies: sentences, and measurements that would, with what they are expected to gain.
        notes: further sentences.
        bends: of each parameter how many times as much as its interval says chi-square has risen at an end of that, the
            others moved along as a straight line has it; 1 where the interval is what it says.
        profiles: parameters whose 95 % intervals are by profile likelihood; see `profiled`.
        widened: how many times as large as the noise as taken makes them standard deviations are, by parameter, for
            what is not known of the noise (see `ddetumble.inference.interval_width`); empty where it does not matter.
        systematics: what an error that all records share, and nobody stated, would do to the estimates.
        settings: command, specification, seed.
        source, problem, bounded, space, solution: for those who go on computing.
        gaussians: of the coordinates, by name: mean, standard deviation, and the limits at which they are cut off.
    """

    campaign: str
    title: str
    sha256: str
    model: str
    effects: tuple[str, ...]
    parameters: Mapping[str, Fitted]
    fixed: Mapping[str, float]
    derived: Mapping[str, Derived]
    covariance: np.ndarray
    correlations: np.ndarray
    chi2: float
    degrees: int
    chi2_reduced: float
    goodness: GoodnessOfFit
    records: int
    samples: int
    noise: Mapping[str, Noise]
    converged: bool
    steps: int
    state: str
    nuisances: Mapping[str, Mapping[str, Mapping[str, float]]]
    cannot_tell_apart: tuple[str, ...]
    remedies: tuple[Remedy, ...]
    notes: tuple[str, ...]
    settings: Mapping[str, Any]
    source: Campaign
    problem: Problem
    bounded: Bounded
    gaussians: Mapping[str, tuple[float, float, float, float]]
    bends: Mapping[str, float] = dc.field(default_factory=dict)
    profiles: tuple[str, ...] = ()
    systematics: tuple[Systematic, ...] = ()
    widened: Mapping[str, float] = dc.field(default_factory=dict)

    def __repr__(self) -> str:
        return f"<Fit of {self.model_text} to {self.campaign}: chi2/degrees {self.chi2_reduced:.3g}>"

    @property
    def space(self) -> ParameterSpace:
        """All parameters that the model may have."""
        return self.problem.space

    @property
    def solution(self) -> Solution:
        """The solution of the least squares."""
        return self.bounded.solution

    @property
    def model_text(self) -> str:
        """Model and effects in words."""
        return self.model + (f" with {', '.join(self.effects)}" if self.effects else "")

    def fitted_model(self) -> FittedModel:
        """The fitted model by itself: what predictions and designs go on from."""
        commons = {common.slot.name for common in self.space.commons}
        priors = {n: p for n, p in self.problem.priors.items() if n in self.parameters and n not in commons}
        return make_fitted(
            campaign=self.source, model_name=self.model, space=self.space, solution=self.solution, noise=self.noise,
            effects=self.effects, covariance=self.covariance, names=tuple(self.parameters),
            priors=priors, widened=self.widened, extra={
                "made_by": self.settings.get("made_by", "fit"), "chi2_reduced": self.chi2_reduced,
                "misfit": math.sqrt(self.chi2_reduced) if self.goodness.misfit else None})

    def interval(self, name: str, level: float = 0.95) -> tuple[float, float]:
        """Interval of a parameter in its public unit: Gaussian in its coordinate, cut off at its limits.

        Raises:
            InputError: It is no fitted parameter, or the level is not between 0 and 1.
        """
        if name not in self.parameters:
            raise InputError(f"{name!r} is not fitted; the fitted parameters are: "
                             f"{', '.join(self.parameters)}", option="name")
        if not 0 < level < 1:
            raise InputError(f"the level must be between 0 and 1; it is {level:g}", option="level")
        return self.space.parameter(name).transform.interval(*truncate_normal(*self.gaussians[name], level)[1:])

    def profile(self, name: str, level: float = 0.95) -> tuple[float, float]:
        r"""Interval of a parameter by profile likelihood, in its public unit.

        It ends where $\chi^2$, all other parameters and the nuisances refitted, has risen by the quantile of
        $\chi^2_1$: 3.84 at 95 %, times the square of `widened`. Where it does not, as far as values are of interest,
        the interval ends at the limits of the parameter.

        Raises:
            InputError: It is no fitted parameter, or the level is not between 0 and 1.
        """
        self.interval(name, level)  # refuses what is no use
        problem, others = self.problem, [other for other in self.parameters if other != name]
        k, rise = self.space.index[name], math.sqrt(stats.chi2.ppf(level, 1)) * self.widened.get(name, 1.0)
        vast, ends = limit_knowledge(self.space, name), []
        sd = min(self.gaussians[name][1], vast) / self.widened.get(name, 1.0)

        def refit(u: float, near: Solution) -> tuple[float, Solution]:
            start = near.u.copy()
            start[k] = u
            with np.errstate(over="ignore"):
                found = solve_bounded(problem, others, start, near.z, self.bounded.bounds, 1e-3).solution
            more = HIGH if found.failed else min(max(found.chi2 - self.solution.chi2, 0.0), HIGH)
            return math.sqrt(more) - rise, found

        for side, limit in zip((-1.0, 1.0), self.bounded.room(problem, name), strict=True):
            near, end = self.solution, limit
            for step in (sd * rise * 2.0**doubling for doubling in itertools.count()):
                place = side * min(side * near.u[k] + step, side * limit)
                lack, there = refit(place, near)
                if lack >= 0.0:
                    found: Any = optimize.brentq(lambda u, near=near: refit(u, near)[0], near.u[k], place,
                                                 xtol=1e-3 * sd)
                    end = float(found)
                    break
                if place == limit or abs(place - self.solution.u[k]) > vast:
                    break
                near = there
            ends.append(end)
        return self.space.parameter(name).transform.interval(*ends)

    def profiled(self, names: Sequence[str] | str | None = None) -> "Fit":
        """The same fit with 95 % intervals by `profile`: of these parameters, or of those whose `bends` reach two.

        Their `sd`, the covariance and what follows from it stay those of the straight line.
        """
        names = [name for name, bend in self.bends.items() if bend >= BENT] if names is None else (
            [names] if isinstance(names, str) else names)
        ends = {name: self.profile(name) for name in names}
        return dc.replace(self, profiles=tuple(dict.fromkeys((*self.profiles, *ends))), parameters={
            name: dc.replace(p, q025=ends[name][0], q975=ends[name][1]) if name in ends else p
            for name, p in self.parameters.items()})

    def tell_intervals(self) -> tuple[str, ...]:
        """What is to be said of the 95 % intervals, in sentences: where they were refitted, or ought to be, and
        which errors that all records share they do not allow for."""
        told = []
        if self.profiles:
            ends = [f"{name} {format_number(p.q025, 5)} to {format_number(p.q975, 5)} {p.unit}".rstrip()
                    for name, p in self.parameters.items() if name in self.profiles]
            told.append(f"95 % intervals by refitting (profile likelihood): {'; '.join(ends)}.")
        if bent := [name for name, bend in self.bends.items() if bend >= BENT and name not in self.profiles]:
            most = format_number(max(self.bends[name] for name in bent), 2)
            told.append(f"The 95 % intervals of {', '.join(bent)} take a curved valley for a straight one: at an end "
                        f"chi-square has risen up to {most} times as much as it should. `ddetumble fit --profile` "
                        "(`Fit.profiled`) finds the ends by refitting; a posterior (`sample`) needs no straight line.")
        if not self.goodness.misfit and (hidden := tell_systematics(self.systematics)):
            told.append(hidden)
        return tuple(told)

    def __str__(self) -> str:
        """The report, as lmfit's users expect it."""
        campaign = self.campaign or "a campaign without a name"
        lines = [f"[[Model]]\n    {self.model_text}, fitted to {campaign}", "[[Fit Statistics]]"]
        counts = {"fitting method": "Levenberg-Marquardt", "function evals": self.steps, "records": self.records,
                  "data points": self.samples, "variables": len(self.parameters)}
        lines += [f"    # {name:<18} = {value}" for name, value in counts.items()]
        alone = ", of the values without what priors add" if self.problem.records.are_values else ""
        lines += [f"    {'chi-square':<20} = {self.chi2:.8g}",
                  f"    {'reduced chi-square':<20} = {self.chi2_reduced:.6g}{alone}"]
        lines += [f"    noise of {name}: {n.sd:.4g} {self.source.column(name).unit}, {n.text}"
                  for name, n in self.noise.items()]
        lines += [f"    {told}" for told in (self.state, str(self.goodness)) if told]
        lines.append("[[Variables]]")
        width = max(map(len, (*self.parameters, *self.fixed))) + 1
        for name, p in self.parameters.items():
            share = f" ({100 * p.sd / abs(p.estimate):.2f}%)" if p.sd < NEGLIGIBLE * abs(p.estimate) else ""
            spread = f"+/- {p.sd:.4g}{share}" if math.isfinite(p.sd) else "+/- not determined"
            spread += f" {p.unit}" if p.unit else ""
            bound = f", at its {p.at_bound} bound" if p.at_bound else ""
            lines.append(f"    {name + ':':<{width}} {p.estimate:.7g} {spread} (init = {p.initial:.5g}){bound}")
        for name, value in self.fixed.items():
            unit = self.space.unit(name, self.solution.u)
            lines.append(f"    {name + ':':<{width}} {value:.7g}{f' {unit}' if unit else ''} (fixed)")
        if self.derived:
            lines.append("[[Derived]]")
            for name, d in self.derived.items():
                spread = f"{d.sd:.4g}" if math.isfinite(d.sd) else "not determined"
                lines.append(f"    {name + ':':<{width}} {d.estimate:.7g} +/- {spread} {d.unit}".rstrip())
        names = list(self.parameters)
        pairs = [(self.correlations[i, j], f"{names[i]}, {names[j]}")
                 for i, j in itertools.combinations(range(len(names)), 2) if abs(self.correlations[i, j]) >= LEAST]
        if pairs:
            lines.append(f"[[Correlations]] (unreported correlations are < {LEAST:.3f})")
            wide = max(len(pair) for _, pair in pairs)
            pairs.sort(key=lambda p: -abs(p[0]))
            lines += [f"    C({pair:<{wide}}) = {value:+.4f}" for value, pair in pairs]
        pulls = sorted(((v["pull"], f"{n} of {r}") for r, own in self.nuisances.items() for n, v in own.items()
                        if "pull" in v), key=lambda p: -abs(p[0]))[:3]
        if pulls:
            lines.append("[[Settings]] (largest shifts, in their stated standard deviations)")
            lines += [f"    {place}: {pull:+.2f}" for pull, place in pulls]
        for title, sentences in (("Not distinguishable", self.cannot_tell_apart),
                                 ("Notes", (*self.notes, *self.tell_intervals()))):
            if sentences:
                lines += [f"[[{title}]]", *(f"    {s}" for s in sentences)]
        return "\n".join(lines)

    def to_dict(self) -> dict[str, Any]:
        """Everything that JSON can hold."""
        own = {f.name: getattr(self, f.name) for f in dc.fields(self) if f.name not in INSIDE}
        goodness = {**dc.asdict(self.goodness), "misfit": self.goodness.misfit, "moved": self.goodness.moved}
        return make_plain({"schema": SCHEMA, **own, "names": list(self.parameters), "goodness": goodness,
                           "versions": list_versions()})

    def save(self, folder) -> Path:
        """Write `fit.json`, for reading, and `model.json`, from which predictions go on; returns the folder."""
        folder = check_folder(folder, "fit")
        save_model(folder, self.fitted_model())
        write_json(folder / FILE, self.to_dict())
        return folder


class AbstractRivals(abc.ABC):
    """A result with a best fitted model, and rivals that it could not tell from it."""

    @property
    @abc.abstractmethod
    def best(self) -> Fit:
        """The best one."""

    @property
    @abc.abstractmethod
    def rivals(self) -> Sequence[Fit]:
        """Those that were not told from it."""


def summarise_fit(campaign: Campaign, model: str, effects: tuple[str, ...], problem: Problem, found: Bounded,
                  start: np.ndarray, noise: Mapping[str, Noise], settings: Mapping[str, Any], nuisances: bool,
                  warnings: tuple[str, ...] = (), *, steps: int | None = None, starts: int = 1,
                  scattered: bool = False, scatter: ScatterSettings = SCATTER) -> Fit:
    """Turn a solution `found` of a problem into what people read.

    `start` are the coordinates that the fit started from; `nuisances` says whether the conditions moved, `warnings`
    what is to be told beside, `steps` how many were taken from all `starts` and since (if not given, those of the
    solution alone), `scattered` whether the scatter of settings was estimated from the same records, `scatter`
    when intervals are those of the scatter of records. The other arguments are fields of `Fit`.
    """
    space, solution = problem.space, found.solution
    known = analyse_with_refits(problem, solution)
    wider = widen_intervals(problem, solution, noise, scattered, scatter)
    widened = wider.factors
    known = known.widen(widened, solution.names)
    told, remedies = describe_knowledge(problem, solution, known, campaign)
    parameters, covariance, correlations, gaussians = estimate_parameters(problem, found, known, start)
    counted = int(problem.records.used.sum())
    degrees = counted + sum(name in found.names for name in problem.priors) - len(solution.names)
    notes = [*warnings, *(f"{n} was stopped at its {p.at_bound} bound: its own uncertainty is one-sided, and those of "
                          "the others assume it held there." for n, p in parameters.items() if p.at_bound),
             *(f"{n} is {p.text}." for n, p in parameters.items() if p.text and not p.at_bound)]
    if widened:
        notes.append(wider.tell())
    if not nuisances:
        notes.append("The conditions and time origins were taken as exact.")
    stopped, fixed, scales = [], {}, space.scales()
    for k, slot in enumerate(space.slots):
        name, p, u = slot.name, slot.parameter, solution.u[k]
        # At its null an effect is absent: a minimum like any other. Elsewhere a bound stopped the fit short of one.
        absent = p.kind == "amplitude" and abs(u - p.default) <= NEAR * scales[k]
        if name in parameters and parameters[name].at_bound and not absent:
            stopped.append(name)
        away = p.kind != "shape" and u != p.default
        if name not in parameters and (slot.owner is None or slot.owner in effects or away):
            fixed[name] = p.transform.from_unconstrained(u)
    steps = solution.steps if steps is None else steps
    after = f"after {steps} step{'s' * (steps != 1)}" + f" in all, from the best of {starts} starts" * (starts > 1)
    converged = solution.converged and not stopped
    state = (f"converged {after}" if converged else
             f"stopped {after} at a bound of {' and '.join(stopped)}: no minimum was found inside" if stopped else
             f"not converged {after}: the values may change further")
    if known.undetermined:
        state += "; not all parameters are determined by these records"
    shifts = list_nuisances(problem, solution)
    goodness = judge_solution(problem, solution, degrees, noise, shifts)
    return Fit(
        campaign.name, campaign.title, campaign.sha256, model, effects, parameters, fixed,
        derive_quantities(space, solution.u, gaussians, covariance), covariance, correlations, solution.chi2, degrees,
        goodness.chi2_reduced, goodness, problem.records.count, counted, dict(noise), converged, steps, state, shifts,
        told, remedies, tuple(notes), dict(settings), campaign, problem, found, gaussians,
        measure_bends(problem, found, known.covariance, gaussians, widened),
        systematics=measure_systematics(problem, solution, known.covariance, campaign), widened=widened)


def judge_solution(problem: Problem, solution: Solution, degrees: float, noise: Mapping[str, Noise],
                   shifts: Mapping[str, Mapping[str, Mapping[str, float]]]) -> GoodnessOfFit:
    """The goodness of a fit, whose chi-square has so many degrees of freedom, and whose settings have moved by `shifts`
    (of `list_nuisances`); of values, of which there are few, without what the priors add, under noise of which the same
    values tell little.
    """
    chance = None
    pulls = {name: {record: own[name]["pull"] for record, own in shifts.items() if "pull" in own.get(name, {})}
             for name in problem.records.nuisances}
    if problem.records.are_values:
        chi2, degrees = measure_values(problem, solution)
        chance = judge_values(chi2, degrees, noise)
    else:
        chi2 = solution.chi2
    return dc.replace(judge_goodness(chi2, degrees, pulls, chance), disputed=list_disputed(problem, solution))


def measure_bends(problem: Problem, found: Bounded, covariance: np.ndarray,
                  gaussians: Mapping[str, tuple[float, float, float, float]],
                  widened: Mapping[str, float] = MappingProxyType({})) -> dict[str, float]:
    """Rise of chi-square at either end of every parameter's 95 % interval over what a straight line expects, the larger
    of both; 1 of a linear model.

    The other parameters and the nuisances move along by the fit's linear algebra, without a refit: it costs two
    evaluations a parameter, and tells a curved valley, whose bottom leaves that line. Left out are parameters without a
    minimum inside their limits, and ends at which the model cannot be computed.

    Args:
        covariance: of the solution's parameters, shape (free, free).
        gaussians: of their coordinates, as in `Fit`.
        widened: by how much their standard deviations are larger than those of the noise, by name.
    """
    solution, reach, bends = found.solution, math.sqrt(stats.chi2.ppf(0.95, 1)), {}
    places = [problem.space.index[name] for name in solution.names]
    for k, name in enumerate(solution.names):
        sd = math.sqrt(max(covariance[k, k], 0.0))
        if name not in gaussians or not sd or not math.isclose(gaussians[name][1], sd, rel_tol=1e-6):
            continue  # undetermined, or as uncertain as the way to its null is long
        rises = []
        for side in (-1.0, 1.0):
            step = side * reach / sd * covariance[:, k]
            u, z = solution.u.copy(), solution.z.copy()
            u[places] += step
            if not gaussians[name][2] <= u[problem.space.index[name]] <= gaussians[name][3]:
                continue
            for record in range(len(z)):
                z[record] += solution.adjust_own(record, slice(None), step / solution.scales)
            with np.errstate(over="ignore"):
                there = problem.solve(solution.names, u, z, moving=False)
            if not there.failed and math.isfinite(there.chi2):
                rises.append((there.chi2 - solution.chi2) / (reach * widened.get(name, 1.0)) ** 2)
        if rises:
            bends[name] = max(rises)
    return bends


def derive_quantities(space: ParameterSpace, u: np.ndarray, gaussians: Mapping[str, tuple[float, ...]],
                      covariance: np.ndarray) -> dict[str, Derived]:
    """What follows from fitted parameters of the reference model, by name; their deviation is infinite where unknown.

    `u` are coordinates of all parameters, `gaussians` mean and standard deviation of those of the fitted ones.
    """
    units = {name: unit for name, (_, unit) in space.build(jnp.asarray(u)).reference.derive().items()}
    if not units:
        return {}

    def read(at):
        return jnp.stack([value for value, _ in space.build(at).reference.derive().values()])

    slopes = np.asarray(jax.jacfwd(read)(jnp.asarray(u)))[:, [space.index[name] for name in gaussians]]
    sd = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", slopes, covariance, slopes), 0.0))
    open_ended = np.array([not math.isfinite(gaussian[1]) for gaussian in gaussians.values()])
    sd[(slopes[:, open_ended] != 0.0).any(axis=1)] = math.inf
    return {name: Derived(float(value), float(error), unit) for (name, unit), value, error, own in zip(
        units.items(), read(jnp.asarray(u)), sd, slopes, strict=True) if own.any()}


def estimate_parameters(problem: AbstractProblem, found: Bounded, known: Knowledge, start: np.ndarray
                        ) -> tuple[dict[str, Fitted], np.ndarray, np.ndarray,
                                   dict[str, tuple[float, float, float, float]]]:
    """Parameters in the order of `found.names`, their covariance, correlations, and Gaussians of their coordinates.

    The one rule for intervals, of `fit` and `discover`: Gaussian in the coordinate in which the fit moves, cut off at
    the limits. An amplitude whose slope vanishes at its null is as uncertain as half the way there where values near
    the null fit as well. Held parameters are uncorrelated.
    """
    space, solution, names = problem.space, found.solution, found.names
    place = [names.index(n) for n in solution.names]
    covariance, correlations = np.zeros((len(names),) * 2), np.eye(len(names))
    covariance[np.ix_(place, place)] = known.covariance
    correlations[np.ix_(place, place)] = known.correlations
    cut = {}  # mean and standard deviation of held parameters' Gaussians, before they are cut off at the bounds
    if found.held:
        full = problem.solve([*solution.names, *found.held], solution.u, solution.z, moving=False)
        flat, rest = full.flattened()
        whole = analyse_fit(space, full).covariance
        step = -whole @ ((flat / full.scales).T @ rest)
        cut = {name: (float(solution.u[space.index[name]] + step[k]), math.sqrt(whole[k, k]))
               for k, name in enumerate(full.names) if name in found.held}
    parameters, gaussians = {}, {}
    for k, name in enumerate(names):
        p, u = space.parameter(name), float(solution.u[space.index[name]])
        mean, sd = cut.get(name, (u, float(np.sqrt(covariance[k, k]))))
        low, high = found.room(problem, name)
        if p.singular and name not in cut:
            sd = max(sd, _reach_null(problem, solution, name))
        if name in known.undetermined:
            sd, (low, high) = math.inf, p.coordinate_bounds()
        gaussians[name] = mean, sd, low, high
        inside, first, last = truncate_normal(*gaussians[name])
        ends, value, side, text = p.transform.interval(first, last), p.transform.from_unconstrained(u), "", ""
        if name in cut:
            sd, text = inside, "stopped at its bound"
            covariance[k, k] = sd**2
            side = "upper" if (found.held[name] > 0) != p.transform.reciprocal else "lower"
        elif name in known.undetermined:
            text = "not determined by these records"
        elif p.sign and p.sign * (u - p.default) < 0:
            text = "on the side of its null that physics does not allow" + (
                ", but no further than noise explains" if abs(u - p.default) < 2 * sd else "")
        elif p.excludes(*ends):
            text = f"beyond its physical limits, {p.limits[0]:g} to {p.limits[1]:g} ({p.limits_reason})"
        parameters[name] = Fitted(
            value, p.transform.slope(value) * sd if math.isfinite(sd) else math.inf, *ends,
            space.unit(name, solution.u), p.transform.from_unconstrained(start[space.index[name]]), side,
            name not in known.undetermined, text)
    return parameters, covariance, correlations, gaussians


def _reach_null(problem: AbstractProblem, solution: Solution, name: str) -> float:
    """Half the way to a null at which an amplitude has no slope, where values next to it fit as well; else 0."""
    k = problem.space.index[name]
    parameter, u = problem.space.slots[k].parameter, solution.u.copy()
    null = parameter.transform.from_field(parameter.default)
    distance = float(u[k]) - null
    if distance == 0.0 or not problem.is_whole(solution):
        return 0.0
    u[k] = null + NEXT * distance
    near = problem.solve([other for other in solution.names if other != name], u, solution.z, tolerance=1e-2)
    return 0.5 * abs(distance) if near.chi2 - solution.chi2 < LIKELY else 0.0


def list_nuisances(problem: Problem, solution: Solution) -> dict[str, dict[str, dict[str, float]]]:
    """Shift of every record's conditions, and what the records start from."""
    records, found = problem.records, {}
    deviations = np.asarray(records.stack.condition_sd)
    for r, key in enumerate(records.keys):
        found[key] = {name: {"shift": float(z * sd), "sd": float(sd), "pull": float(z)}
                      for name, z, sd in zip(records.nuisances, solution.z[r], deviations[r], strict=True)
                      if sd > 0 and name not in records.starts}
        if records.starts:  # as uncertain as the record alone leaves them, and what the shared parameters add
            own, shared = solution.own[r], solution.shared[r]
            alone = np.linalg.inv(own.T @ own + np.eye(own.shape[1]))
            carried = alone @ own.T @ shared / solution.scales
            spread = np.sqrt(np.diag(alone + carried @ solution.covariance() @ carried.T))
            found[key] |= {name: {"estimate": float(records.stack.conditions[name][r]) + float(z * sd),
                                  "sd": float(one * sd)}
                           for name, z, sd, one in zip(records.starts, solution.z[r], deviations[r], spread,
                                                       strict=False)}
    return found
