"""What a design says, in plain words."""

from collections.abc import Sequence

from ..families import find_family, list_families
from ..inference.archive import FittedModel
from ..measurement.quantities import describe_quantity, format_plain, join_words
from .limits import Extra, Limit
from .proposals import Design, Narrowing, Proposal


TOLD = "more than 50 noise variances behind, from where discover drops it"
MOST_TEXT = "30 repeats"


def explain_design(found: Design, saved: FittedModel) -> tuple[str, tuple[str, ...]]:
    """The sentence of a design, and notes."""
    if len(found.rivals) == 1:
        return _explain_narrowing(found), _notes(found, saved)
    rivals = join_words(found.rivals)
    best = found.proposals[0]
    if not best.split:
        sentence = (f"Nothing within these limits tells {rivals} apart: at the best test they stay "
                    f"{_worst(best):.2g} standard deviations apart once either is refitted, and {MOST_TEXT} are not "
                    "enough. ")
        more = find_family(found.family).plan.added
        sentence += "Widen the limits, or name another channel." if more else "Widen the limits."
        return sentence, _notes(found, saved)
    again = "one such test" if best.repeats == 1 else f"{best.repeats} such tests"
    sentence = (f"To tell {rivals} apart, measure {describe_test(best, found.limits)}: {again} "
                f"{'is' if best.repeats == 1 else 'are'} expected to put the wrong one {TOLD}.")
    together = [pair for pair in best.pairs if pair.repeats is None]
    if together:
        sentence += (" It does not tell " + join_words([f"{pair.first} from {pair.second}" for pair in together])
                     + ".")
    return sentence, _notes(found, saved)


def _explain_narrowing(found: Design) -> str:
    """Where there is one model only."""
    best = found.proposals[0]
    said = "Nothing is confounded here, so there is nothing to separate."
    if found.verdict in ("improved", "unexplained"):
        said += " But a misfit remains: first find what is missing; what follows holds for the model as it stands."
    if not best.narrowings:
        return said + " The model has no free parameter that a test could narrow."
    return (f"{said} The test that narrows the parameters most is {describe_test(best, found.limits)}: "
            + join_words([_say_narrowing(n) for n in best.narrowings[:3]]) + ".")


def _say_narrowing(n: Narrowing) -> str:
    return f"{n.name} from ± {n.before:.2g} to ± {n.after:.2g} {n.unit}".rstrip()


def _notes(found: Design, saved: FittedModel) -> tuple[str, ...]:
    """What was assumed, what else there is."""
    notes = []
    for pair in found.proposals[0].pairs if found.proposals[0].split else ():
        after = (f"told apart after {pair.repeats} test{'s' if pair.repeats != 1 else ''}" if pair.repeats
                 else f"not told apart by {MOST_TEXT}")
        notes.append(f"{pair.first} and {pair.second}: one such test leaves {pair.distance:.3g} standard deviations "
                     f"between them; {after}.")
    for other in found.proposals[1:]:
        notes.append(_say_other(other, found))
    varied = ", ".join(describe_limit(limit) for limit in found.limits if limit.free)
    if varied:
        notes.append(f"Searched within: {varied}.")
    held = ", ".join(describe_limit(limit) for limit in found.limits if not limit.free)
    if held:
        notes.append(f"Held: {held}.")
    if found.proposals[0].at_limit:
        edge = join_words(found.proposals[0].at_limit)
        notes.append(f"It stands at the limit of {edge}: wider limits may tell more.")
    outside = saved.outside(found.proposals[0].conditions, slack=0.02)
    if outside:
        notes.append("The proposal extrapolates: " + "; ".join(outside) + ".")
    assumed = [p.extra for p in found.proposals if p.extra is not None and p.extra.assumed]
    if assumed:
        notes.append("Assumed noise of channels that could be added: "
                     + ", ".join(f"{e.name} {e.sd:g} {e.unit}".removesuffix(" 1") for e in assumed)
                     + "; --channel states yours.")
    return tuple(notes)


def _say_other(other: Proposal, found: Design) -> str:
    """A proposal that was not the best."""
    where = describe_test(other, found.limits)
    if len(found.rivals) == 1:
        return f"Or {where}: " + join_words([_say_narrowing(n) for n in other.narrowings[:2]]) + "."
    if not other.split:
        return f"Not enough: {where} ({_worst(other):.2g} standard deviations)."
    told = "all pairs" if other.split == len(other.pairs) else f"{other.split} of {len(other.pairs)} pairs"
    return f"Or {where}: {told} told apart after {other.repeats} test{'s' if other.repeats != 1 else ''}."


def _worst(proposal: Proposal) -> float:
    return min(pair.distance for pair in proposal.pairs)


def describe_test(proposal: Proposal, limits: Sequence[Limit]) -> str:
    """`at pressure 0.6 MPa and approach speed 0.9 m/s, with the channel pressure added`."""
    named = {limit.name: limit for limit in limits}
    chosen = {name for one in list_families() for name in one.plan.chosen}
    shown = [n for n in proposal.conditions if n != "sequence" and (named[n].free or n in chosen)]
    at = join_words([f"{describe_quantity(n).name} {say_value(n, proposal.conditions[n], named[n].unit)}"
                     for n in shown])
    text = f"at {at}" if shown else "once more"
    return text + (f", with the channel {_say_extra(proposal.extra)} added" if proposal.extra is not None else "")


def _say_extra(extra: Extra) -> str:
    return f"{extra.name} (noise {format_plain(extra.sd)} {extra.unit})".replace(" 1)", ")")


def say_value(name: str, value: float, unit: str) -> str:
    """A condition with its unit, in the unit that people use."""
    shown = describe_quantity(name, unit=unit)
    return f"{format_plain(value * shown.scale)} {shown.unit}".rstrip()


def describe_limit(limit: Limit) -> str:
    """`approach speed 0.2 to 2 m/s`."""
    name = describe_quantity(limit.name).name
    high = say_value(limit.name, limit.high, limit.unit)
    return f"{name} {high}" if not limit.free else (
        f"{name} {say_value(limit.name, limit.low, limit.unit).split()[0]} to {high}")
