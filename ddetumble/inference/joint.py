"""One fit of several campaigns, which share the parameters of one ball; and whether the campaigns agree on them."""

import collections
import dataclasses as dc
import math
from collections.abc import Iterable, Mapping, Sequence, Set
from pathlib import Path
from typing import Any, NamedTuple, final

import jax.numpy as jnp
import numpy as np

from .._display import AbstractPrinted, Progress, align_table
from .._errors import ComputationError, InputError
from ..contact.effect import parts_of
from ..contact.law import PowerLaw
from ..measurement.campaign import Campaign
from ..measurement.quantities import format_number, format_value, join_words, say_p
from . import distributions as stats
from .archive import Model
from .bounded import Bounded, solve_bounded
from .estimation import fit
from .files import check_folder, list_versions, make_plain, write_json
from .findings import Fit, Fitted, derive_quantities, estimate_parameters, judge_solution, list_nuisances
from .goodness import LEVEL
from .identifiability import analyse_fit, limit_knowledge
from .levenberg_marquardt import FIRST_DAMPING, STALLED, NormalEquations
from .parameters import AbstractSpace, Slot
from .problem import STEPS, AbstractProblem, Problem, Solution
from .random_effects import Homogeneity, measure_heterogeneity


FILE, SCHEMA = "joint.json", "ddetumble.joint-fit/1"
Measured = Fit | Campaign | str | Path
Models = Model | list[Model] | tuple[Model, ...]


@final
class JointSpace(AbstractSpace):
    """Parameters of several campaigns' models: those that they share once, the others by campaign.

    Attributes:
        places: for each campaign the joint name of each of its fitted parameters, by their name in its own model.
    """

    def __init__(self, slots: Sequence[Slot], places: Sequence[Mapping[str, str]]):
        self.slots, self.places = tuple(slots), tuple(places)
        self.index = {slot.name: k for k, slot in enumerate(self.slots)}


@final
class JointProblem(AbstractProblem):
    r"""The least squares of several campaigns at once, $\sum_c \chi^2_c(\theta)$, nuisances eliminated in each.

    Args:
        space: the joint parameters.
        problems: one a campaign, in the order of `space.places`; a prior of a shared parameter stands in one of them.
        near: a solution of each problem, for what is not fitted and where nuisances start.
    """

    space: JointSpace

    def __init__(self, space: JointSpace, problems: Sequence[Problem], near: Sequence[Solution]):
        self.space, self.problems, self.near = space, tuple(problems), tuple(near)
        self.scales = space.scales()
        low, high = space.bounds()
        for problem, places in zip(problems, space.places, strict=True):
            for own, joint in places.items():
                k, at = space.index[joint], problem.space.index[own]
                low[k], high[k] = max(low[k], problem.limits[0][at]), min(high[k], problem.limits[1][at])
        self.limits = low, high

    def is_whole(self, solution: Solution) -> bool:
        """All samples of all campaigns are fitted."""
        return True

    def evaluate(self, free: Sequence[str], u: np.ndarray, near: Sequence[Solution] | None = None) -> list[Solution]:
        """Residuals and Jacobian of every campaign at joint coordinates `u`, its nuisances fitted there."""
        found = []
        for problem, places, last in zip(self.problems, self.space.places, near or self.near, strict=True):
            at = last.u.copy()
            at[[problem.space.index[own] for own in places]] = u[[self.space.index[n] for n in places.values()]]
            z = problem.solve([], at, last.z).z
            found.append(problem.solve([own for own, n in places.items() if n in free], at, z, moving=False))
        return found

    def solve(self, free: Sequence[str], start: np.ndarray, z: np.ndarray | None = None, *, moving: bool = True,
              tolerance: float = 1e-7, max_steps: int | None = None) -> Solution:
        """Fit the `free` joint parameters by Levenberg-Marquardt, as `Problem.solve`; all nuisances are fitted anew.

        The solution's rows are those of the campaigns' Jacobians after elimination, as few as there are columns.
        """
        columns = [self.space.index[name] for name in free]
        parts = self.evaluate(free, self.keep_inside(start, columns))
        at = self._join(free, self.keep_inside(start, columns), parts)
        damping, refused, steps, converged = FIRST_DAMPING, 0, 0, not moving
        while not converged and steps < (STEPS if max_steps is None else max_steps) and not at.failed:
            rows, right = at.flattened()
            equations = NormalEquations(jnp.zeros((1, 0, 0)), jnp.zeros((1, 0, len(free))), jnp.asarray(rows.T @ rows),
                                        jnp.zeros((1, 0)), jnp.asarray(rows.T @ right))
            fall = float(-equations.shared @ equations.solve(jnp.zeros(()))[0])
            if fall < tolerance or (refused > 2 and fall < STALLED * at.chi2):
                converged = True
                break
            u = at.u.copy()
            u[columns] += self.scales[columns] * np.asarray(equations.solve(jnp.asarray(damping))[0])
            u = self.keep_inside(u, columns)
            tried = self.evaluate(free, u, parts)
            new, steps = self._join(free, u, tried), steps + 1
            if not new.failed and new.chi2 < at.chi2 + 0.1 * tolerance:
                at, parts, damping, refused = new, tried, max(0.1 * damping, 1e-12), 0
            else:
                damping, refused = 10.0 * damping, refused + 1
        return dc.replace(at, steps=steps, converged=converged and not at.failed)

    def _join(self, free: Sequence[str], u: np.ndarray, parts: Sequence[Solution]) -> Solution:
        """Solutions of the campaigns as one in joint coordinates: a record without nuisances."""
        blocks = []
        for places, part in zip(self.space.places, parts, strict=True):
            columns, right = part.flattened()
            own = [free.index(places[name]) for name in part.names]
            wide = np.zeros((len(right), len(free) + 1))
            wide[:, own] = columns / part.scales * self.scales[[self.space.index[free[k]] for k in own]]
            wide[:, -1] = right
            blocks.append(np.linalg.qr(wide, mode="r"))
        rows, none = np.concatenate(blocks), np.zeros(len(free))
        failed = tuple(key for part in parts for key in part.failed)
        return Solution(tuple(free), u, np.zeros((1, 0)), self.scales[[self.space.index[n] for n in free]],
                        rows[None, :, -1], rows[None, :, :-1], np.zeros((1, len(rows), 0)), np.zeros((1, 0, 0)),
                        np.zeros((1, 0)), np.zeros((1, 0)), np.zeros(1), none, none, sum(part.chi2 for part in parts),
                        False, 0, failed)


class Agreement(NamedTuple):
    r"""Whether campaigns agree on what they share: a likelihood-ratio test, and Cochran's of each parameter.

    `chi2` is by how much $\chi^2$ is larger with shared parameters than with each campaign's own, and `degrees` how
    many combinations of parameters are determined more often than once.
    """

    chi2: float
    degrees: int
    p_value: float  # 1 where nothing is determined twice
    parameters: Mapping[str, Homogeneity]  # of the single fits' estimates, where two or more determine one

    @property
    def agree(self) -> bool:
        """Whether the difference is no more than noise explains."""
        return self.p_value >= LEVEL

    @property
    def apart(self) -> tuple[str, ...]:
        """Parameters on which campaigns that disagree do so, the worst first."""
        chances = {name: one.p_value for name, one in self.parameters.items() if not self.agree}
        return tuple(sorted((n for n, p in chances.items() if p * len(chances) < LEVEL), key=lambda n: chances[n]))


@final
@dc.dataclass(frozen=True, eq=False, repr=False)
class JointFit(AbstractPrinted):
    """One fit of several campaigns that share parameters.

    Attributes:
        parameters: fitted ones in their public unit. One that is not shared and that several campaigns have bears the
            campaign's name behind its own: `restitution (normal)`.
        shared: campaigns that share a parameter, by its name.
        covariance, correlations: of the coordinates of `parameters`, in their order.
        gaussians: of the coordinates, as in `Fit`.
        degrees: degrees of freedom.
        agreement: whether the campaigns agree on what they share.
        singles: the fit of each campaign by itself.
        fits: each campaign's model at the joint values and with their covariance, for `predict`, `design` and `report`;
            what fits it anew, as `profile` and `sample` do, has that campaign's records only.
        notes: sentences.
        problem, bounded: for those who go on computing.
    """

    parameters: Mapping[str, Fitted]
    shared: Mapping[str, tuple[str, ...]]
    covariance: np.ndarray
    correlations: np.ndarray
    gaussians: Mapping[str, tuple[float, float, float, float]]
    degrees: int
    agreement: Agreement
    singles: Mapping[str, Fit]
    fits: Mapping[str, Fit]
    notes: tuple[str, ...]
    problem: JointProblem
    bounded: Bounded

    def __repr__(self) -> str:
        return f"<JointFit of {self.campaign}: {len(self.shared)} shared parameters>"

    @property
    def campaign(self) -> str:
        """The names of all campaigns."""
        return " + ".join(self.singles)

    @property
    def space(self) -> JointSpace:
        """All joint parameters."""
        return self.problem.space

    @property
    def solution(self) -> Solution:
        """The solution of the least squares."""
        return self.bounded.solution

    def estimates(self, name: str) -> dict[str, Fitted]:
        """Estimates of a joint parameter by the single fits, by campaign."""
        return {label: single.parameters[own] for (label, single), places in zip(
            self.singles.items(), self.space.places, strict=True) for own, joint in places.items() if joint == name}

    def narrowing(self, name: str) -> dict[str, float]:
        """How many times wider a parameter's 95 % interval is in the single fits, by campaign."""
        own = self.parameters[name]
        return {label: (one.q975 - one.q025) / (own.q975 - own.q025) if one.determined else math.inf
                for label, one in self.estimates(name).items()}

    @property
    def intervals(self) -> dict[str, dict[str, tuple[float, float, float]]]:
        """Estimate and ends of the 95 % interval of every shared parameter by campaign, `joint` last.

        Ends are infinite where it is not determined. `dd.figures.draw_forest` draws them.
        """
        return {label_parameter(name, self.parameters[name].unit): {
            label: (p.estimate, *((p.q025, p.q975) if p.determined else (-math.inf, math.inf)))
            for label, p in (self.estimates(name) | {"joint": self.parameters[name]}).items()} for name in self.shared}

    @property
    def sentence(self) -> str:
        """Whether the campaigns agree."""
        test, names = self.agreement, join_words(self.singles)
        if not test.degrees:
            return f"{names} share {join_words(self.shared)}, and measure none of them twice."
        rise = (f"sharing them raises chi-square by {test.chi2:.1f} over {test.degrees} degrees of freedom "
                f"({say_p(test.p_value)})")
        if test.agree:
            return f"{names} agree on {join_words(self.shared)}: {rise}."
        apart = join_words(test.apart) or f"a combination of {join_words(self.shared)}"
        told = f"{names} disagree on {apart}: {rise}. The joint intervals do not allow for that."
        return f"{told} {tell_misfits(self.singles)}".rstrip()

    @property
    def tables(self) -> list[list[tuple[str, ...]]]:
        """Rows of cells: every parameter and, below it, the estimates of the single fits."""
        rows = [("parameter", "estimate", "95 % interval", "times narrower")]
        for name, p in self.parameters.items():
            times, alone = self.narrowing(name), self.estimates(name)
            rows += [(label_parameter(name, p.unit), *_show(p), ""),
                     *((f"  {label}", *_show(one), format_number(times[label], 2)) for label, one in alone.items())]
        return [rows]

    def __str__(self) -> str:
        """Whether the campaigns agree, and every parameter beside the estimates of the single fits."""
        return "\n\n".join([self.sentence, *("\n".join(align_table(rows)) for rows in self.tables),
                            "\n".join(self.notes)])

    def to_dict(self) -> dict[str, Any]:
        """Everything that JSON can hold."""
        test, own = self.agreement, ("parameters", "shared", "covariance", "correlations", "degrees", "notes")
        return make_plain({
            "schema": SCHEMA, "campaigns": {label: {"sha256": one.sha256, "model": one.model_text}
                                            for label, one in self.singles.items()},
            "names": list(self.parameters), **{name: getattr(self, name) for name in own},
            "singles": {name: self.estimates(name) for name in self.parameters},
            "agreement": test._asdict() | {"agree": test.agree, "apart": test.apart, "parameters": {
                name: one._asdict() for name, one in test.parameters.items()}},
            "chi2": self.solution.chi2, "converged": self.solution.converged, "versions": list_versions()})

    def save(self, folder: str | Path) -> Path:
        """Write `joint.json`, and for each campaign a folder as `Fit.save` does, from which predictions go on."""
        folder = check_folder(folder, "fit")
        for label, one in self.fits.items():
            one.save(folder / label.replace("/", "-"))
        write_json(folder / FILE, self.to_dict())
        return folder


def fit_jointly(campaigns: Sequence[Measured], models: Models = "paper", *, own: Iterable[str] = (),
                progress: Progress | None = None) -> JointFit:
    """Fit several campaigns together: normal, oblique and friction records of one ball share its parameters.

    Fitted parameters with the same name, unit and transform in two or more campaigns are shared, except those in `own`
    and errors that only the records of one campaign share; conditions and noise stay those of each campaign. A prior
    that several campaigns have of a shared parameter counts once.

    Args:
        campaigns: two or more fits (`dd.fit(...)`, which may free, fix and bound as they like), or campaigns, folders
            or specifications, which are then fitted by themselves first.
        models: of those that are no fits: one for all, or one each.
        own: names of parameters that every campaign keeps for itself.
        progress: called with a sentence and the share done.

    Raises:
        InputError: Nothing is shared, priors of a shared parameter differ, or a single fit is refused.
        ComputationError: A model could not be integrated.
    """
    found = fit_each(campaigns, models, progress)
    singles = {label: one for label, one in found.items() if isinstance(one, Fit)}
    if len(singles) < 2 or len(singles) < len(found):
        raise InputError("a joint fit takes two campaigns or more, or their single fits")
    if progress:
        progress("fitting all campaigns together", 0.85)
    space, shared, notes = join_spaces(singles, tuple(own))
    start, bounds, names = np.zeros(len(space)), {}, list(space.index)
    for k, name in enumerate(names):
        known = [(one.gaussians[o], one.bounded.room(one.problem, o)) for one, places in
                 zip(singles.values(), space.places, strict=True) for o, n in places.items() if n == name]
        bounds[name] = max(low for _, (low, _) in known), min(high for _, (_, high) in known)
        if not bounds[name][0] < bounds[name][1]:
            raise InputError(f"the bounds of {name} in the campaigns have nothing in common")
        weights = np.array([1.0 / min(sd, 1e3) ** 2 for (_, sd, *_), _ in known])
        start[k] = np.clip(weights @ [mean for (mean, *_), _ in known] / weights.sum(), *bounds[name])
    assumed = {name for one in singles.values() for name in one.settings.get("assumed", ()) if name in shared}
    for kept in (set(), assumed):  # what one campaign does not determine, another may
        joint = JointProblem(space, _share_priors(singles, shared, assumed - kept),
                             [one.solution for one in singles.values()])
        found = solve_bounded(joint, names, start, None, bounds)
        if not found.solution.failed and not assumed & {*analyse_fit(space, found.solution).undetermined}:
            break
    if found.solution.failed:
        raise ComputationError(f"the joint fit could not be integrated for record {found.solution.failed[0]!r}; keep "
                               "parameters apart with `own`, or start from other single fits")
    return _summarise(singles, joint, found, start, shared, notes)


def fit_each(campaigns: Sequence[Measured | JointFit], models: Models, progress: Progress | None
             ) -> dict[str, Fit | JointFit]:
    """Single fits of campaigns by names that are unique; fits are taken as they are."""
    listed = list(models) if isinstance(models, (list, tuple)) else [models] * len(campaigns)
    if len(listed) != len(campaigns):
        raise InputError(f"there are {len(campaigns)} campaigns and {len(listed)} models; give one, or one each")
    found: dict[str, Fit | JointFit] = {}
    for k, (one, model) in enumerate(zip(campaigns, listed, strict=True)):
        def report(text, share, k=k):
            if progress:
                progress(f"campaign {k + 1} of {len(campaigns)}: {text}", 0.85 * (k + share) / len(campaigns))

        single = one if isinstance(one, (Fit, JointFit)) else fit(one, model, progress=report)
        count = 1 + sum(other.campaign == single.campaign for other in found.values())
        found[f"{single.campaign or 'campaign'}{f' {count}' if count > 1 else ''}"] = single
    return found


def join_spaces(fits: Mapping[str, Fit], own: Sequence[str] = ()
                ) -> tuple[JointSpace, dict[str, tuple[str, ...]], tuple[str, ...]]:
    """The joint space of fits, the campaigns that share each shared parameter, and what there is to say about it.

    Raises:
        InputError: Nothing is shared, or a name in `own` is fitted nowhere.
    """
    kinds: dict[tuple, list[str]] = collections.defaultdict(list)
    for label, one in fits.items():
        for name in one.parameters:
            kinds[identify(one, name)].append(label)
    together: dict[str, tuple] = {}  # of each name the first meaning that two campaigns have in common
    for kind, labels in kinds.items():
        if len(labels) > 1:
            together.setdefault(kind[0], kind)
    fitted = collections.Counter(name for one in fits.values() for name in one.parameters)
    for name in own:
        if name not in fitted:
            raise InputError(f"{name!r} is not fitted, so that it cannot be kept apart; the fitted parameters are: "
                             f"{', '.join(sorted(fitted))}", option="own")
    slots: dict[str, Slot] = {}
    shared: dict[str, tuple[str, ...]] = {}
    places, notes = [], []
    for label, one in fits.items():
        names, apart = {}, {*own, *(common.slot.name for common in one.space.commons)}
        for name in one.parameters:
            slot, kind = one.space.slots[one.space.index[name]], identify(one, name)
            if together.get(name) == kind and name not in apart:
                shared[name] = tuple(kinds[kind])
                names[name], owner = name, slot.owner
            else:
                names[name] = name if fitted[name] == 1 else f"{name} ({label})"
                owner = f"{slot.owner or ''} ({label})"
            slots.setdefault(names[name], Slot(names[name], owner, slot.parameter))
        places.append(names)
    if not shared:
        raise InputError(f"{join_words(fits)} share no fitted parameter; they have: " + "; ".join(
            f"{label}: {', '.join(one.parameters)}" for label, one in fits.items()))
    for name in fitted:
        held = {label: f"{one.fixed[name]:.4g}" for label, one in fits.items() if name in one.fixed}
        free = [one for one in fits.values() if name in one.parameters]
        if held:
            notes.append(f"{name} is fitted to {join_words(one.campaign for one in free)}, but held at "
                         f"{join_words(dict.fromkeys(held.values()))} in {join_words(held)}; free it there, too, "
                         "to share it.")
        if len({identify(one, name) for one in free}) > 1:
            notes.append(f"{name} means something else in each of {join_words(one.campaign for one in free)}, and was "
                         "not shared. A power law is the same with one `condition` and `condition_reference` in all.")
    return JointSpace(list(slots.values()), places), shared, tuple(notes)


def identify(one: Fit | JointFit, name: str) -> tuple:
    """What a fitted parameter has in common with the same one of another fit: name, unit, coordinate, and where it is
    of a power law, the condition that this is of.
    """
    if isinstance(one, JointFit):
        label, own = next((label, own) for label, places in zip(one.singles, one.space.places, strict=True)
                          for own, joint in places.items() if joint == name)
        return name, *identify(one.singles[label], own)[1:]
    p, laws = one.space.parameter(name), parts_of(one.space.reference)
    return name, p.unit, p.coordinate, *((law.condition, law.condition_reference) for law in laws if isinstance(
        law, PowerLaw) and name in ("stiffness_force", "condition_exponent"))


def _share_priors(fits: Mapping[str, Fit], shared: Iterable[str], dropped: Set[str]) -> list[Problem]:
    """The problems of fits, with each prior of a shared parameter in one of them alone.

    `dropped` are names of those that were only assumed, where the values of a campaign did not determine a parameter.
    """
    seen: dict[str, tuple[float, float]] = {}
    found = []
    for one in fits.values():
        kept = {name: prior for name, prior in one.problem.priors.items()
                if name not in dropped or name not in one.settings.get("assumed", ())}
        for name in set(kept) & set(shared):
            if seen.setdefault(name, kept[name]) != kept[name]:
                raise InputError(f"the priors of {name} differ between the campaigns; give all the same, which then "
                                 "counts once, or give it to one")
            if any(name in problem.priors for problem in found):
                del kept[name]
        same = kept == dict(one.problem.priors)
        found.append(one.problem if same else Problem(one.space, one.problem.records, kept))
    return found


def count_directions(space: AbstractSpace, solution: Solution) -> int:
    """How many combinations of the free parameters of a solution the data determine, nuisances apart."""
    vast = np.array([limit_knowledge(space, name) for name in solution.names])
    columns = solution.flattened()[0] * (vast / solution.scales)
    return int(np.sum(np.linalg.svd(columns, compute_uv=False) > 1.0)) if columns.size else 0


def _test_agreement(singles: Mapping[str, Fit], joint: JointProblem, found: Bounded, shared: Iterable[str]
                    ) -> Agreement:
    """Compare the joint fit with the single fits under the same priors and noise."""
    chi2, degrees = found.solution.chi2, -count_directions(joint.space, found.solution)
    for one, problem in zip(singles.values(), joint.problems, strict=True):
        own = one.solution
        if problem is not one.problem:
            again = solve_bounded(problem, one.bounded.names, own.u, own.z, one.bounded.bounds).solution
            own = own if again.failed else again
        chi2, degrees = chi2 - own.chi2, degrees + count_directions(problem.space, own)
    tests = {}
    for name in shared:
        known = [one.gaussians[name] for one in singles.values()
                 if name in one.parameters and math.isfinite(one.gaussians[name][1])
                 and name not in one.settings.get("assumed", ())]
        if len(known) > 1:
            tests[name] = measure_heterogeneity([mean for mean, *_ in known], [sd for _, sd, *_ in known])
    degrees = max(degrees, 0)
    return Agreement(max(chi2, 0.0), degrees, float(stats.chi2.sf(max(chi2, 0.0), degrees)) if degrees else 1.0, tests)


def _summarise(singles: Mapping[str, Fit], joint: JointProblem, found: Bounded, start: np.ndarray,
               shared: Mapping[str, tuple[str, ...]], notes: Sequence[str]) -> JointFit:
    """Turn a joint solution into what people read."""
    space, solution = joint.space, found.solution
    known = analyse_fit(space, solution)
    parameters, covariance, correlations, gaussians = estimate_parameters(joint, found, known, start)
    index = {name: k for k, name in enumerate(parameters)}
    state = f"{'' if solution.converged else 'not '}converged after {solution.steps} steps"
    fits = {}
    for (label, one), places, problem, at in zip(singles.items(), space.places, joint.problems,
                                                 joint.evaluate(solution.names, solution.u), strict=True):
        rows = np.ix_([index[n] for n in places.values()], [index[n] for n in places.values()])
        own = {o: gaussians[n] for o, n in places.items()}
        shifts = list_nuisances(problem, at)
        goodness = judge_solution(problem, at, one.degrees, one.noise, shifts)
        fits[label] = dc.replace(
            one, parameters={o: dc.replace(parameters[n], initial=one.parameters[o].estimate) for o, n in
                             places.items()}, covariance=covariance[rows], correlations=correlations[rows],
            derived=derive_quantities(one.space, at.u, own, covariance[rows]), gaussians=own, chi2=at.chi2,
            chi2_reduced=goodness.chi2_reduced, goodness=goodness,
            nuisances=shifts, cannot_tell_apart=(), remedies=(), problem=problem, converged=solution.converged,
            steps=solution.steps, state=state, bends={}, profiles=(), systematics=(),
            notes=(*one.notes, f"Fitted together with {join_words(x for x in singles if x != label)}."),
            bounded=Bounded(at, tuple(places), {o: found.held[n] for o, n in places.items() if n in found.held},
                            {o: found.bounds[n] for o, n in places.items()}))
    priors = sum(name in problem.priors for problem, places in zip(joint.problems, space.places, strict=True)
                 for name in places)
    degrees = sum(one.samples for one in singles.values()) + priors - len(solution.names)
    told = [f"The joint fit has {state}: chi-square {solution.chi2:.6g}, {degrees} degrees of freedom.",
            *(f"{name} is {p.text}." for name, p in parameters.items() if p.text),
            *(f"{label}: {one.goodness}" for label, one in fits.items() if str(one.goodness))]
    return JointFit(parameters, dict(shared), covariance, correlations, gaussians, degrees,
                    _test_agreement(singles, joint, found, shared), singles, fits, (*told, *notes), joint, found)


def _show(p: Fitted) -> tuple[str, str]:
    """Estimate and interval as text."""
    if not p.determined:
        return format_number(p.estimate, 4), "not determined"
    low, high = (format_value(end, p.sd) for end in (p.q025, p.q975))
    return format_value(p.estimate, p.sd), f"{low} to {high}"


def label_parameter(name: str, unit: str) -> str:
    """`mass [kg]`, or the name alone of a pure number."""
    return f"{name} [{unit}]" if unit else name


def tell_misfits(fits: Mapping[str, Any]) -> str:
    """That fits which leave a misfit may differ by it, and not by their parameters; '' where none leaves any."""
    wrong = [label for label, one in fits.items()
             if isinstance(one, Fit) and (one.goodness.misfit or one.goodness.moved)]
    return "" if not wrong else (
        f"But the model does not describe {join_words(wrong)}: what it lacks there can make such a difference; look "
        "for that first.")
