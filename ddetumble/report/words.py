"""Findings in words and in rows of tables, for the page and for the terminal."""

import math
from collections.abc import Mapping, Sequence

from ..families import View
from ..figures.labels import VERDICTS, clean, describe_quantity, format_number, format_share, format_value
from ..measurement.units import format_time
from ..selection.result import Discovery, Estimate, Place


WHOLE = 0.995  # share from which a range is all there is
MARGIN = 0.02  # of the longest record, by which a range may fall short of it and still be all of it
_PHASES = {
    "loading": " while loading", "unloading": " while unloading", "forward": " on strokes forward",
    "backward": " on strokes backward",
}  # fmt: skip


def say_verdict(verdict: str) -> str:
    """A verdict in words."""
    return VERDICTS.get(verdict, clean(verdict))


def say_model(discovery: Discovery) -> str:
    """The grown model in a few words: `with adhesion and gas-leak`."""
    effects = [clean(effect, 40) for effect in discovery.effects]
    return "with " + (", ".join(effects[:-1]) + " and " if len(effects) > 1 else "") + effects[-1] if effects else ""


def share_at_step(discovery: Discovery, effect: str) -> tuple[int, float] | None:
    """Step after the first at which an effect came in, and the share of the first misfit that this step removed."""
    for number, (before, step) in enumerate(zip(discovery.steps, discovery.steps[1:], strict=False), 1):
        if number > 1 and effect in step.effects and effect not in before.effects:
            first = discovery.steps[0].chi2_reduced - 1.0
            gain = before.chi2_reduced - step.chi2_reduced
            return number, max(gain / first, 0.0) if first > 0 else math.nan
    return None


def say_place(place: Place, view: View) -> str:
    """Where a misfit sits, as a sentence in the words of a view; a phase is named where there is another."""
    low, high = place.range
    shown = describe_quantity(place.variable, [low, high, *((view.longest,) if place.variable == "time" else ())])
    name = view.series if place.variable == "sequence" else shown.name
    unit = f" {shown.unit}" if shown.unit else ""
    span = f"{format_number(shown.scale * low)} to {format_number(shown.scale * high)}{unit}"
    whole = place.variable == "time" and low <= MARGIN * view.longest and high >= (1.0 - MARGIN) * view.longest
    phase = _PHASES[place.phase] if place.phase in view.phases else ""
    period = ""
    if place.period is not None and math.isfinite(place.period):
        every = format_time(place.period) if place.variable == "time" else (
            f"{format_number(shown.scale * place.period)}{unit}")
        period = f"; it repeats every {every}"
    channel = describe_quantity(place.channel).name
    share = f"{format_share(place.share)} of the misfit of the {channel}"
    removes = "" if place.removes is None else f"; a simple force of it removes {format_share(place.removes)}"
    if place.variable == "direction":
        return f"{share} depends on the {name}{period}{removes}."
    if whole and place.share >= WHOLE:
        return f"The misfit of the {channel} runs through whole records{period}{removes}."
    if place.removes is not None and place.share >= WHOLE:
        return f"The misfit of the {channel} depends on the {name}, {span}{period}{removes}."
    return f"{share} sits where the {name} is {span}{phase}{period}{removes}."


def count_records(discovery: Discovery) -> int:
    """How many records were fitted."""
    return len({trace.record for step in discovery.steps[-1:] for trace in step.traces})


def show_estimate(estimate: Estimate) -> tuple[str, str, str, str]:
    """Value, standard deviation and the ends of the 95 % interval, to the digits that count."""
    sd = estimate.sd
    return (format_value(estimate.estimate, sd), format_value(sd, sd), format_value(estimate.q025, sd),
            format_value(estimate.q975, sd))  # fmt: skip


def list_alternatives(alternatives: Sequence[Mapping]) -> list[tuple[str, str, str, str]]:
    """Rows of a confusion set: effect, paired held-out difference, its standard error, and both as a ratio."""
    rows = []
    for item in alternatives:
        difference, error = (_read(item, key) for key in ("heldout_difference", "standard_error"))
        ratio = difference / error if math.isfinite(difference) and error > 0 else math.nan
        rows.append((clean(item.get("effect", "")), format_value(difference, error), format_value(error, error),
                     format_number(ratio, 2)))  # fmt: skip
    return rows


def _read(item: Mapping, key: str) -> float:
    value = item.get(key)
    return math.nan if value is None else float(value)


def flatten(settings: Mapping, prefix: str = "") -> list[tuple[str, str]]:
    """Nested settings as rows of name and value."""
    rows = []
    for key, value in settings.items():
        name = f"{prefix}{clean(str(key).replace('_', ' '), 60)}"
        if isinstance(value, Mapping):
            rows += flatten(value, f"{name}, ")
        elif isinstance(value, (list, tuple)):
            rows.append((name, ", ".join(clean(item, 80) for item in value) or "none"))
        else:
            rows.append((name, f"{value:.4g}" if isinstance(value, float) else clean(value, 200)))
    return rows
