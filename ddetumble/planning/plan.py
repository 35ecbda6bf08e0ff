"""Impacts planned for debris: what `plan` returns, in numbers and in words."""

import dataclasses as dc
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

from .._display import AbstractPrinted, Progress
from .._errors import InputError
from ..contact.gripping import StrikeLaw
from ..inference.archive import AbstractFitted, FittedModel, take_fitted
from ..measurement.units import format_time
from .draws import Laws, draw_laws
from .measured import MeasuredRange, find_measured_ranges, list_extrapolations, list_ranges, warn_of_extrapolation
from .problem import StrikeProblem
from .robust import plan_robust_strike
from .scenario import Scenario, pose_laws, pose_problem, read_scenario
from .sequence import Joint, Sequence, plan_sequence, plan_together
from .single import LEAST_GAIN, STARTS, StrikePlan
from .uncertainty import Assessment, Prospect, assess_plan, assess_sequence


NUMBERS = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "eleven", "twelve")
AFTERWARDS = 30.0  # s, of free motion drawn at either end


@dc.dataclass(frozen=True)
class PlanSettings:
    """How impacts are looked for; a scenario's `[goal]` and `[uncertainty]` say the same.

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
    """

    impacts: int = 1
    share: float = 0.01
    least: Literal["impacts", "impulse", "time"] = "impacts"
    plan_for: Literal["best", "mean", "tail"] = "best"
    tail: float = 0.1
    draws: int = 32
    starts: int = STARTS
    seed: int = 0


@dc.dataclass(frozen=True, eq=False, repr=False)
class Plan(AbstractPrinted):
    """Where, how fast, how hard and when to strike.

    Attributes:
        problem: what was given, allowed and wanted.
        settings: how it was looked for.
        sequence: the impacts, and why there are no more.
        laws: draws of the contact; None where nothing was said of its uncertainty.
        assessment: how sure the first impact is; None without draws, or without an impact.
        prospect: how sure all impacts together are; None with one impact.
        ranges: over which the contact was measured.
        title, source: of the scenario; '' without one.
    """

    problem: StrikeProblem
    settings: PlanSettings
    sequence: Sequence
    laws: Laws | None = None
    assessment: Assessment | None = None
    prospect: Prospect | None = None
    ranges: tuple[MeasuredRange, ...] = ()
    title: str = ""
    source: str = ""

    def __repr__(self) -> str:
        return f"<Plan of {len(self.impacts)} impacts>"

    @property
    def impacts(self) -> tuple[StrikePlan, ...]:
        """The impacts, in order."""
        return self.sequence.impacts

    @property
    def sentence(self) -> str:
        """What was found, in a few sentences."""
        return describe_plan(self.problem, self.sequence, self.settings.share, self.ranges)

    def __str__(self) -> str:
        """What was found, and how sure that is."""
        lines = [self.sentence, *(self.assessment.sentences if self.assessment is not None else ())]
        if self.prospect is not None:
            lines.append(self.prospect.sentence)
        elif self.assessment is not None and len(self.impacts) > 1:
            lines.append("Under no draw of the contact could all impacts be struck one after the other.")
        return "\n".join(lines)


def plan(problem: StrikeProblem | str | Path, model: AbstractFitted | FittedModel | str | Path | None = None, *,
         settings: PlanSettings | None = None, progress: Progress | None = None) -> Plan:
    """Where, how fast, how hard and when to strike tumbling debris so that its angular momentum goes.

    Args:
        problem: what is struck, allowed and wanted; or a scenario file, which says everything else too.
        model: a fitted contact, as `fit` or `discover` returned it or in their folder, in place of the problem's own
            normal force; its uncertainty is drawn.
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
            raise InputError("a scenario says its contact and its settings itself; leave model and settings out")
        path = Path(problem)
        return plan_scenario(read_scenario(path), path.parent, path, progress=progress)
    settings, laws, ranges = settings or PlanSettings(), None, ()
    if model is not None:
        saved = take_fitted(model)
        if not saved.space.family.has_contact:
            raise InputError(f"the model is one of {saved.family} records; a strike needs one of impacts")
        source = [(saved.model, saved, 1.0)] if isinstance(model, FittedModel) else model
        laws = draw_laws(source, _mount_on(problem.law), draws=settings.draws, seed=settings.seed)
        problem = dc.replace(problem, law=laws.main)
        ranges = tuple(list_ranges(saved, saved.campaign))
    return _plan(problem, settings, laws, ranges, progress=progress)


def plan_scenario(scenario: Scenario, here: Path, path: Path | None = None, *, progress: Progress | None = None,
                  **changes: Any) -> Plan:
    """As `plan`, of a scenario that is read already.

    Args:
        scenario: what was read.
        here: folder from which it names others.
        path: its file, for messages; None where there is none.
        progress: as of `plan`.
        **changes: settings in place of the scenario's own.
    """
    try:
        laws = pose_laws(scenario, here)
        problem = pose_problem(scenario, here, laws)
        ranges = find_measured_ranges(scenario, here)
    except InputError as error:
        if path is None or error.file is not None or error.key is None:
            raise
        raise InputError(error.problem, file=path, key=error.key) from None
    goal, table = scenario.goal, scenario.uncertainty
    settings = PlanSettings(goal.impacts, goal.share, goal.least, starts=scenario.starts, seed=scenario.seed)
    if table is not None:
        settings = dc.replace(settings, plan_for=table.plan_for, tail=table.tail, draws=table.draws)
    found = _plan(problem, dc.replace(settings, **changes), laws, ranges, progress=progress)
    return dc.replace(found, title=scenario.title or (path.stem if path else ""), source=path.name if path else "")


def _plan(problem: StrikeProblem, settings: PlanSettings, laws: Laws | None, ranges: tuple[MeasuredRange, ...], *,
          progress: Progress | None) -> Plan:
    tell = progress or (lambda text, share: None)
    if laws is not None and settings.plan_for != "best":
        aim = settings.plan_for

        def revise(now: StrikeProblem, one: StrikePlan) -> StrikePlan:
            return plan_robust_strike(now, laws, one, aim=aim, tail=settings.tail)

        found = plan_sequence(problem, settings.share, settings.impacts, starts=settings.starts, seed=settings.seed,
                              revise=revise, progress=progress)
    else:
        found = plan_together(problem, settings.share, settings.impacts, aim=settings.least, starts=settings.starts,
                              seed=settings.seed, progress=progress)
    assessment, prospect = None, None
    if laws is not None and found.impacts:
        tell("trying the first impact on all draws", math.nan)
        assessment = assess_plan(problem, found.impacts[0], laws, tail=settings.tail)
        if len(found.impacts) > 1:
            tell("trying all impacts on all draws", math.nan)
            prospect = assess_sequence(problem, found, laws, settings.share, tail=settings.tail)
    return Plan(problem, settings, found, laws, assessment, prospect, ranges)


def _mount_on(law: StrikeLaw) -> Callable[[Any], StrikeLaw]:
    """Puts a fitted law in the place of a problem's own normal force; one of oblique impacts replaces it all."""
    def mount(fitted):
        if isinstance(fitted, StrikeLaw):
            return fitted
        striker = dc.replace(law.reference, ball=fitted.reference)
        return striker.extend((*law.friction.effects, *fitted.effects))

    return mount


def describe_plan(problem: StrikeProblem, sequence: Sequence, share: float,
                  ranges: tuple[MeasuredRange, ...] = ()) -> str:
    """What was found, in a few sentences; `ranges` are those of `find_measured_ranges`."""
    floor, count = sequence.floor, len(sequence.impacts)
    frictionless = ""
    if floor > 1e-3:
        frictionless = (
            " A normal force has no moment about a sphere's centre: all of this momentum goes by friction alone."
            if len(problem.debris.surface.find_pivots()) == 3 else
            " A normal force has no moment about the axis of a body of revolution: "
            f"{100 * floor:.1f} % of this momentum lies along it and goes by friction alone.")
    if not count:
        missed = sequence.refused is not None and sequence.refused.missed
        cannot = "No impact was found" if missed else "This cannot be done"
        return f"{cannot}: {_say_why(sequence)}.{_format_relaxations(sequence)}{frictionless}"
    left = 100 * sequence.shares[-1]
    shown = f"{left:.2f} %" if left >= 0.005 else "less than 0.01 %"
    start = f"{'One impact leaves' if count == 1 else f'{count} impacts leave'} {shown} of the angular momentum"
    start += "" if sequence.reached else f", not the wanted {100 * share:g} %"
    last = format_time(sequence.instants[-1], find_end(sequence))
    aim = (f" {'It comes' if count == 1 else 'The last of them comes'} at {last}, and the contact force has an impulse "
           f"of {sequence.impulse:.1f} N s{'' if count == 1 else ' in all'}.")
    bound = f" No plan does with fewer than {sequence.bound}." if sequence.bound > 1 else ""
    ended = ""
    if not sequence.reached and sequence.refused is not None:
        why = _say_why(sequence)
        ended = f" {why[:1].upper()}{why[1:]}."
    together = "" if sequence.joint is None else f" {_format_joint(sequence.joint, share)}"
    beyond = warn_of_extrapolation(list_extrapolations(ranges, sequence.impacts, problem.conditions))
    return f"{start}.{aim}{ended}{together}{bound}{frictionless} {beyond}".rstrip()


def find_end(sequence: Sequence) -> float:
    """Up to when the motion is followed [s], which decides on the unit of all times of a plan."""
    return (sequence.instants[-1] if sequence.instants else 0.0) + AFTERWARDS


def _format_joint(joint: Joint, share: float) -> str:
    """What optimising jointly made of the plan, or would leave with one impact less."""
    count, (before, left, impulse, duration) = _format_count(joint.impacts), joint.alone
    if not joint.taken:
        missed = f"more than the wanted {100 * share:g} %" if joint.share > share else "but not within the limits"
        leave = "leaves" if joint.impacts == 1 else "leave"
        return f"Optimised jointly, {count} {leave} {100 * joint.share:.2f} % of the angular momentum, {missed}."
    if joint.aim == "impacts":
        do = "does" if joint.impacts == 1 else "do"
        return f"Optimised jointly, {count} {do} what takes {_format_count(before)} when planned one after the other."
    what = {"share": f"momentum left: {100 * joint.share:.2f} % of it remain, against {100 * left:.2f} %",
            "impulse": f"impulse: {joint.impulse:.1f} N s, against {impulse:.1f} N s",
            "time": f"time: {joint.duration:.1f} s, against {duration:.1f} s"}[joint.aim]
    return f"The impacts were optimised jointly for the least {what} when planned one after the other."


def _format_count(impacts: int) -> str:
    number = NUMBERS[impacts] if impacts < len(NUMBERS) else f"{impacts}"
    return f"{number} impact{'s' * (impacts != 1)}"


def _format_relaxations(sequence: Sequence) -> str:
    """Which limit would have to be looser, and how much."""
    if not sequence.relaxations:
        return ""
    parts = [f"{one.key} = {_round_loosely(one.needed, one.needed > one.given):g} {one.unit} in place of {one.given:g} "
             f"{one.unit}" for one in sequence.relaxations]
    return (f" An impact worth {100 * LEAST_GAIN:.0f} % of what is wanted would be allowed with {', or '.join(parts)}, "
            "the other limits as they are.")


def _round_loosely(value: float, up: bool) -> float:
    """Two digits, rounded so that what is allowed at `value` is allowed there too."""
    if value == 0.0:
        return 0.0
    step = 10.0 ** (math.floor(math.log10(abs(value))) - 1)
    return float(f"{(math.ceil if up else math.floor)(value / step) * step:.3g}")


def _say_why(sequence: Sequence) -> str:
    """Why no further impact was planned."""
    best = sequence.refused
    further = "a further" if sequence.impacts else "the best single"
    if best is None:
        return "no impact is allowed"
    if best.missed:
        return (f"the search found no {'further ' * bool(sequence.impacts)}impact that keeps the limits and is worth "
                f"{100 * LEAST_GAIN:.0f} % of what is wanted, though closed forms see one worth "
                f"{100 * (1.0 - best.estimate / best.untouched):.1f} %; another seed or more starts may find it")
    if best.allowed:
        gain = max(0.0, 1.0 - best.score / best.untouched)
        return (f"{further} impact changes what is wanted by {100 * gain:.2f} %, "
                f"less than {100 * LEAST_GAIN:.0f} %")
    name = min(best.values, key=lambda one: best.values[one])
    return f"the nearest design{' of a further impact' if sequence.impacts else ''} still violates: {name}"
