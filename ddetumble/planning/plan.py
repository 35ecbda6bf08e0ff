"""Impacts planned for debris: what `plan` returns, in numbers and in words."""

import dataclasses as dc
import math
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np

from .._display import AbstractPrinted, Progress, stay_silent
from .._errors import ComputationError, InputError, error_place
from .._sentences import say
from ..contact.gripping import StrikeLaw
from ..inference.archive import FittedModel
from ..measurement.plausibility import Implausibility
from ..measurement.units import format_time
from .draws import Laws, Source, draw_laws, find_models
from .errors import NAMES
from .execution import RAISED, Spread, draw_errors, follow_errors, try_errors
from .measured import (
    MeasuredRange,
    Misfit,
    confine,
    find_assumed,
    find_contacts,
    find_measured_ranges,
    find_rivals,
    has_slid,
    list_misfits,
    warn_of_extrapolation,
)
from .plausibility import check_scenario
from .prices import Price, find_relaxations, list_reached, name_narrowed, price_sequence
from .problem import StrikeProblem, measure_goal, score
from .robust import plan_robust_strike
from .rules import Blow, compare_rules
from .scenario import pose_laws, pose_problem
from .scenario_file import ErrorTable, Scenario, find_scenario, read_scenario, validate_scenario
from .sequence import Sequence, plan_together
from .single import LEAST_GAIN, ROUGH, STARTS, StrikePlan
from .surroundings import Surroundings, find_ambient, list_surroundings, surround
from .uncertainty import Assessment, Prospect, assess_plan, assess_sequence


# Share of the momentum that no normal force can take, from which it is told: below it nobody would miss it.
AXIAL = 1e-3
HOW_DRAWN = {"draws", "plan_for"}  # what of the errors is not their size
MISHAP = 0.01  # share of the draws from which misses, or limits that are passed, are told: with 512 draws, six of them
LEAST_PRICE = 5e-4  # of the momentum, below which two plans leave the same: what the search itself leaves open
USUAL_ERRORS = ErrorTable().model_dump(exclude=HOW_DRAWN)
# Share of score or momentum before, below which nothing is left to gain, and no direction: a tenth of the least gain of
# an impact.
ENDED = 1e-3
AFTERWARDS = 30.0  # s, of free motion drawn at either end, so that the motion before and after is seen

Optimality = Literal["optimum", "not an optimum", "nothing left", "no limit holds"]


@dc.dataclass(frozen=True)
class Mishap:
    """How often errors make impacts miss, or pass a limit."""

    share: float  # of the draws in which any impact does
    impact: int  # number of the one that does most often, from 1
    most: float  # share of the draws in which that one does


@dc.dataclass(frozen=True)
class PlanSettings:
    """Settings of the search for impacts; a scenario states them in `[goal]` and `[uncertainty]`.

    Attributes:
        impacts: at most so many, one after the other.
        share: of the angular momentum at which a sequence ends.
        least: what of a sequence is to be small: the number of impacts, the sum of all impulses, or the time it takes;
            for that, all impacts are changed together.
        plan_for: the best estimate of the contact, the mean over its draws, or that over their worst share.
        tail: share of the draws that counts as the bad tail.
        draws: of each contact model that may be true.
        starts: promising designs that are refined on the integrated impact; more find a better optimum now and then.
        seed: of the places where the search starts, and of the draws.
        within: `measured` where the plan has to stay within what the contact was fitted to; what that costs is told.
        errors: standard deviations of what arm and estimate of the motion get wrong, with which the first impact is
            tried, and for which it is planned where they say so.
        chaser_mass: mass of the chaser, whose recoil is then told [kg].
    """

    impacts: int = 1
    share: float = 0.01
    least: Literal["impacts", "impulse", "time"] = "impacts"
    plan_for: Literal["best", "mean", "tail"] = "best"
    tail: float = 0.1
    draws: int = 32
    starts: int = STARTS
    seed: int = 0
    within: Literal["", "measured"] = ""
    errors: ErrorTable = ErrorTable()
    chaser_mass: float | None = None


@dc.dataclass(frozen=True, eq=False, repr=False)
class Plan(AbstractPrinted):
    """A plan: where, how fast, how hard and when to strike.

    Attributes:
        problem: what was given, allowed and wanted.
        settings: how it was looked for.
        sequence: the impacts, and why there are no more.
        laws: draws of the contact; None where nothing was said of its uncertainty.
        assessment: how sure the first impact is; None without draws, or without an impact.
        prospect: how sure all impacts together are; None with one impact.
        fits: campaign of each fitted model that the contact is made from, by its folder; empty for the paper's ball.
        ranges: over which the contact was measured.
        misfits: fitted models of the contact that leave more than noise of their own campaigns.
        beyond: the impacts planned without having to stay within these; None where they need not.
        prices: of every impact, what it would gain if the limits that hold it were looser, in shares of the goal at the
            start; empty where all impacts were optimised together, whose prices stand in `sequence.joint`.
        rules: what simple rules make of the place of the first impact.
        spreads: what errors of the arm and of the estimate make of the first impact, by kind, then of all together.
        after: what all errors together leave after every impact; empty with one impact.
        doubts: sizes in the scenario that should be asked about.
        title, source: of the scenario; '' without one.
        surroundings: fitted models of the contact whose tests were made under another ambient pressure.
        assumed: what nothing said and was taken all the same, SI, by the scenario's key: the coefficient of friction
            where neither the scenario nor a fit says any, the arm's apparent mass where that of the bench was taken.
    """

    problem: StrikeProblem
    settings: PlanSettings
    sequence: Sequence
    laws: Laws | None = None
    assessment: Assessment | None = None
    prospect: Prospect | None = None
    ranges: tuple[MeasuredRange, ...] = ()
    misfits: tuple[Misfit, ...] = ()
    beyond: Sequence | None = None
    prices: tuple[tuple[Price, ...], ...] = ()
    rules: tuple[Blow, ...] = ()
    spreads: tuple[Spread, ...] = ()
    after: tuple[Spread, ...] = ()
    doubts: tuple[Implausibility, ...] = ()
    title: str = ""
    source: str = ""
    fits: Mapping[str, str] = dc.field(default_factory=dict)
    surroundings: tuple[Surroundings, ...] = ()
    assumed: Mapping[str, float] = dc.field(default_factory=dict)

    def __repr__(self) -> str:
        return f"<Plan of {len(self.impacts)} impacts>"

    @property
    def impacts(self) -> tuple[StrikePlan, ...]:
        """The impacts, in order."""
        return self.sequence.impacts

    @property
    def reached(self) -> tuple[tuple[str, ...], ...]:
        """Names of the limits that each impact reaches, whether they cost anything or not."""
        return tuple(list_reached(one) for one in self.impacts)

    @property
    def optimality(self) -> tuple[Optimality, ...]:
        """What the certificate of each impact says. Of what leaves nothing, and of what no limit holds, it says
        nothing: the gradient vanishes there, and the share of it that is left is one of rounding.
        """
        joint = self.sequence.joint if self.sequence.joint is not None and self.sequence.joint.taken else None
        ended = [one.score <= ENDED * one.untouched for one in self.impacts]
        held = [any(size > 0.0 for size in one.certificate.binding.values()) for one in self.impacts]
        if joint is not None:  # one gradient of all impacts, of what was made small
            ended = [ended[-1] and joint.aim in ("impacts", "share")] * len(ended)
            held = [any(held)] * len(held)
        return tuple(
            "nothing left" if done else "no limit holds" if not bound else
            "optimum" if one.certificate.stationarity <= ROUGH else "not an optimum"
            for one, done, bound in zip(self.impacts, ended, held, strict=True))

    @property
    def goal(self) -> tuple[float, float]:
        """What is wanted small, before the first impact and after the last."""
        rates = self.impacts[-1].collision.angular_velocity if self.impacts else self.problem.angular_velocity
        return (float(score(self.problem, self.problem.angular_velocity)), float(score(self.problem, rates)))

    @property
    def goals_left(self) -> tuple[float, ...]:
        """Share left of what is wanted small after each impact [-]."""
        return tuple(measure_goal(self.problem, one.collision.angular_velocity) for one in self.impacts)

    @property
    def goal_beyond(self) -> float | None:
        """Share left of what is wanted small by the plan that may go beyond what was measured [-]; None without one."""
        if self.beyond is None:
            return None
        last = self.beyond.impacts[-1].collision if self.beyond.impacts else self.problem
        return measure_goal(self.problem, last.angular_velocity)

    @property
    def asked(self) -> bool:
        """Whether a share of the momentum was asked for: by the goal, or by a share other than the usual one."""
        return self.problem.goal.is_momentum() or self.settings.share != PlanSettings().share

    @property
    def drift(self) -> float:
        """Speed that all impacts together give the body's centre of mass [m/s]."""
        return float(np.linalg.norm(sum((np.asarray(one.collision.velocity) for one in self.impacts), np.zeros(3))))

    @property
    def sentence(self) -> str:
        """What was found, in a few sentences."""
        found, axial = self.sequence, self.sequence.floor > AXIAL
        share, worth = self.settings.share, f"{100 * LEAST_GAIN:.0f} %"
        erring, stated = self.erring, self.settings.errors.model_dump(exclude=HOW_DRAWN) != USUAL_ERRORS
        # One error is named where it alone adds more than half of what all add to the only impact.
        least = math.inf if self.after or erring is None else 0.5 * (erring.mean - found.left)
        most = [one.error for one in self.spreads[:-1] if one.mean - found.left > least > 0.0]
        sizes = self.settings.errors.sizes()
        goal, left = self.problem.goal, self.goals_left[-1] if self.impacts else 1.0
        momentum, own = goal.is_momentum(), goal.own is not None
        told = [
            say("plan.headline", goal=goal.name(), left=left, momentum=momentum, asked=self.asked,
                values=self.goal if own else None, found=found, share=share, worth=worth, erring=erring, stated=stated,
                more=len(found.impacts) < self.settings.impacts, ended=ENDED,
                plain=self.aim == "best" and self.settings.least == "impacts"),
            say("plan.misfits", misfits=self.misfits) if self.misfits else "", *self.doubts,
            say("plan.outcome", goal=goal.name(), momentum=momentum, asked=self.asked, wide=self.goal_beyond,
                found=found, slid=has_slid(self.ranges), share=share, worth=worth, erring=erring, raised=RAISED,
                mishaps=self.mishaps, most=NAMES[most[0]] if len(most) == 1 else "", beyond=self.beyond,
                confined=self.confined, aim=self.aim,
                plain=self.settings.errors.plan_for == "best",
                turned=math.degrees(self.turned) if most == ["rates"] and self.turned > sizes["attitude"] else 0.0,
                last=format_time(found.instants[-1], find_end(found)) if found.instants else "",
                relaxed=[(one, round_loosely(one.needed, one.needed > one.given)) for one in found.relaxations],
                axial=axial, sphere=axial and len(self.problem.debris.surface.find_pivots()) == 3, cheap=LEAST_PRICE),
            say("plan.surroundings", found=self.surroundings) if self.surroundings else "",
            say("plan.assumed", friction=self.assumed.get("ball.friction"), mass=self.assumed.get("arm.mass"),
                bench=bool(self.fits), errors=self.usual_errors
                ) if (self.assumed or self.usual_errors) and self.impacts else "",
            warn_of_extrapolation(self.ranges, self.impacts, self.problem.conditions)]
        return " ".join(str(one) for one in told if one)

    @property
    def aim(self) -> str:
        """What the impacts are planned for: `best`, the `mean` over the draws, or their worst, the `tail`."""
        return self.settings.errors.plan_for if self.laws is None or self.settings.plan_for == "best" else (
            self.settings.plan_for)

    @property
    def usual_errors(self) -> list[str]:
        """Of which errors the usual size was drawn, in words, where the sizes of others are stated."""
        errors = self.settings.errors
        if self.erring is None or not errors.model_fields_set - HOW_DRAWN:
            return []
        return [NAMES[key.removesuffix("_degrees")] for key, size in USUAL_ERRORS.items()
                if size > 0.0 and key not in errors.model_fields_set]

    @property
    def confined(self) -> tuple[float, float] | None:
        """What is left of the goal by the plan, and by the one that may go beyond what was measured: in the end, or of
        what the first impact is planned for (its mean over the draws, or over the worst) where that is not the best
        estimate; None where there is no second plan, or no impact.
        """
        wide = self.goal_beyond
        if self.beyond is None or wide is None or not (self.impacts and self.beyond.impacts):
            return None
        if self.aim == "best":
            return self.goals_left[-1], wide
        inside, outside = (one.impacts[0].score / one.impacts[0].untouched for one in (self.sequence, self.beyond))
        return inside, outside

    @property
    def turned(self) -> float:
        """Angle by which the error of the angular velocity turns the body until the first impact [rad], its standard
        deviation; nothing without an impact.
        """
        speed = float(np.linalg.norm(self.problem.angular_velocity))
        return self.settings.errors.sizes()["rates"] * speed * self.sequence.instants[0] if self.impacts else 0.0

    @property
    def erring(self) -> Spread | None:
        """What all errors of arm and estimate together leave in the end; None where none were drawn."""
        drawn = any(self.settings.errors.sizes().values())
        return (self.after or self.spreads)[-1] if drawn and self.spreads else None

    @property
    def mishaps(self) -> dict[str, Mishap | None]:
        """What goes wrong under the errors at any impact, by `missed` and `violated`; None where that is less often
        than in `MISHAP` of the draws.
        """
        spreads = (self.after or self.spreads[-1:]) if self.erring is not None else ()

        def sum_up(name: str) -> Mishap | None:
            shares = [getattr(one, name) for one in spreads]
            ever = getattr(spreads[-1], f"ever_{name}") if spreads else 0.0
            return Mishap(ever, shares.index(max(shares)) + 1, max(shares)) if ever >= MISHAP else None

        return {name: sum_up(name) for name in ("missed", "violated")}

    def __str__(self) -> str:
        """What was found, and how sure that is."""
        lines = [self.sentence, *(self.assessment.sentences if self.assessment is not None else ())]
        if self.prospect is not None:
            lines.append(self.prospect.sentence)
        elif self.assessment is not None and len(self.impacts) > 1:
            lines.append("The sequence could not be completed under any draw of the contact.")
        return "\n".join(lines)


def plan(problem: StrikeProblem | Scenario | str | Path, model: Source | None = None, *,
         settings: PlanSettings | None = None, progress: Progress | None = None) -> Plan:
    """Plan where, how fast, how hard and when to strike tumbling debris to reduce its angular momentum $|L|$.

    Args:
        problem: what is struck, allowed and wanted; or a scenario, which says everything else too: in hand (it names
            others from the present folder on), its file, or the name of a shipped one.
        model: a fitted contact, as `fit`, `sample`, `discover` or `average` returned it or in their folder, in place of
            the problem's own normal force; its uncertainty is drawn.
        settings: how impacts are looked for: one or several, one after the other or all together, for the best
            estimate or for the draws.
        progress: called with a sentence and the share done, nan where that is not known.

    Returns:
        A `Plan`; `report` writes its page and `plan.json`.

    Raises:
        InputError: The scenario makes no sense, or the model is none of impacts.
        ComputationError: No impact could be integrated.
    """
    if not isinstance(problem, StrikeProblem):
        if model is not None or settings is not None:
            raise InputError("a scenario states its contact and its settings itself; leave out model and settings")
        if isinstance(problem, Scenario):
            return plan_scenario(validate_scenario(problem), Path(), progress=progress)
        if not isinstance(problem, (str, Path)):
            raise InputError("plan takes a StrikeProblem, or a scenario, its file or name, not a "
                             f"{type(problem).__name__}")
        path = find_scenario(problem)
        return plan_scenario(read_scenario(path), path.parent, path, progress=progress)
    settings, laws, contacts, surroundings = settings or PlanSettings(), None, {}, ()
    if model is not None:
        models = find_models(model)[0]
        saved, base = max(models, key=lambda one: one[2])[1], problem.law
        if not saved.space.family.has_contact:
            raise InputError(f"the model is of {saved.family} records; a strike needs one of impacts")

        def mount(fitted):
            """In place of the problem's own normal force; a law of oblique impacts replaces it all, but for what is
            around the ball."""
            own = surround(fitted.effects, float(find_ambient(base.effects)))
            if isinstance(fitted, StrikeLaw):
                return fitted.reference.extend(own)
            striker = dc.replace(base.reference, ball=fitted.reference)
            return striker.extend((*base.friction.effects, *own))

        laws = draw_laws(model, mount, draws=settings.draws, seed=settings.seed)
        problem = dc.replace(problem, law=laws.main)
        contacts, surroundings = {saved.campaign: saved}, list_surroundings([one for _, one, _ in models],
                                                                            problem.law.effects)
    return dc.replace(_plan(problem, settings, laws, contacts, progress=progress), surroundings=surroundings)


def plan_scenario(scenario: Scenario, here: Path, path: Path | None = None, *, progress: Progress | None = None,
                  **changes: Any) -> Plan:
    """As `plan`, of a scenario that is read already and names others from the folder `here` on; its file is for
    messages, and further arguments are settings in place of its own.
    """
    with error_place(file=path):
        laws = pose_laws(scenario, here)
        problem = pose_problem(scenario, here, laws)
        contacts, doubts = find_contacts(scenario, here), check_scenario(scenario, here)
        rivals = find_rivals(scenario, here)
        surroundings, assumed = list_surroundings(rivals, problem.law.effects), find_assumed(scenario, rivals, problem)
    if progress is not None:  # before minutes are spent on a wrong unit
        for doubt in doubts:
            progress(str(doubt), math.nan)
    goal, table = scenario.goal, scenario.uncertainty
    settings = PlanSettings(goal.impacts, goal.share, goal.least, starts=scenario.starts, seed=scenario.seed,
                            within=scenario.limits.within, chaser_mass=scenario.arm.chaser_mass,
                            errors=scenario.errors)
    if table is not None:
        settings = dc.replace(settings, plan_for=table.plan_for, tail=table.tail, draws=table.draws)
    try:
        with error_place(file=path):
            found = dc.replace(_plan(problem, dc.replace(settings, **changes), laws, contacts, progress=progress),
                               surroundings=surroundings, assumed=assumed)
    except ComputationError as error:
        if not doubts:
            raise
        raise ComputationError(f"{error}. {' '.join(map(str, doubts))}") from None
    return dc.replace(found, doubts=doubts, title=scenario.title or (path.stem if path else ""),
                      source=path.name if path else "")


def _plan(problem: StrikeProblem, settings: PlanSettings, laws: Laws | None, contacts: Mapping[str, FittedModel], *,
          progress: Progress | None) -> Plan:
    tell, how = progress or stay_silent, settings
    late, wait = float(problem.limits.window[1]), problem.limits.shortest_wait()
    if how.impacts > 1 and late < wait:
        raise InputError(f"the latest wait, {late:g} s, is before the shortest between two impacts, {wait:g} s (the "
                         "ball keeps clear for arm.clearance_time after one and before the next); state a later one, "
                         "or goal.impacts = 1", key="limits.window")
    ranges, misfits = find_measured_ranges(contacts), list_misfits(contacts)
    revise, own = None, None if how.plan_for == "best" else laws
    aim = how.errors.plan_for if own is None else how.plan_for
    if aim != "best":
        count = how.errors.draws if own is None else len(own.shares())
        errors = draw_errors(how.errors.sizes(), count, how.seed) if how.errors.plan_for != "best" else []
        revise = partial(plan_robust_strike, laws=own, errors=errors, aim=aim, tail=how.tail,
                         seed=how.seed)
    search = partial(plan_together, share=how.share, most=how.impacts, aim=how.least, starts=how.starts, seed=how.seed,
                     revise=revise, progress=progress)
    wide, problem = (problem, confine(problem, ranges)) if how.within else (None, problem)
    found = search(problem)
    beyond = None if wide is None else search(wide)
    if wide is not None and found.joint is not None:
        renamed = name_narrowed(found.joint.prices, wide.limits, problem.limits)
        found = dc.replace(found, joint=dc.replace(found.joint, prices=renamed))
    found = relax_further(problem, found, how.seed, tell) if revise is None else found
    assessment, prospect = None, None
    if laws is not None and found.impacts:
        tell("trying the first impact on all draws", math.nan)
        assessment = assess_plan(problem, found.impacts[0], laws, tail=how.tail, aim=how.plan_for)
        if len(found.impacts) > 1:
            tell("trying all impacts on all draws", math.nan)
            prospect = assess_sequence(problem, found, laws, how.share, tail=how.tail)
    prices, rules, spreads, after = (), (), (), ()
    if found.impacts:
        first = found.impacts[0]
        tell("pricing the limits, and trying simple rules", math.nan)
        if found.joint is None or not found.joint.taken:
            prices = price_sequence(problem, found.impacts)
            if wide is not None:
                prices = tuple(name_narrowed(one, wide.limits, problem.limits) for one in prices)
        rules = compare_rules(problem, first)
        spreads = try_errors(problem, first, how.errors, how.seed, tell)
        if len(found.impacts) > 1:
            after = follow_errors(problem, found.impacts, how.errors, how.seed, tell)
    return Plan(problem, how, found, laws, assessment, prospect, ranges, misfits, beyond, prices, rules, spreads, after,
                fits={name: saved.campaign for name, saved in contacts.items()})


def relax_further(problem: StrikeProblem, found: Sequence, seed: int, progress: Progress) -> Sequence:
    """The sequence with what a further impact would need, where one that was looked for after its last was refused."""
    refused, changed = found.refused, found.joint is not None and found.joint.taken
    if not found.impacts or found.reached or refused is None or refused.missed or changed:
        return found
    last = found.impacts[-1].collision
    now = problem.begin_after(last.attitude, last.angular_velocity)
    progress("looking for the limit that stands in the way of a further impact", math.nan)
    return dc.replace(found, relaxations=find_relaxations(now, refused, seed=seed, progress=progress))


def find_end(sequence: Sequence) -> float:
    """Up to when the motion is followed [s], which decides on the unit of all times of a plan."""
    return (sequence.instants[-1] if sequence.instants else 0.0) + AFTERWARDS


def round_loosely(value: float, up: bool) -> float:
    """Two digits, rounded so that what is allowed at `value` is allowed there too."""
    if value == 0.0:
        return 0.0
    step = 10.0 ** (math.floor(math.log10(abs(value))) - 1)
    return float(f"{(math.ceil if up else math.floor)(value / step) * step:.3g}")
