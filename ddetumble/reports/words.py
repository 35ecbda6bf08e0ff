"""Findings in words and in rows of tables, for the page and for the terminal."""

from collections.abc import Mapping

from ..measurement.quantities import clean
from ..selection.discovery import Discovery


def say_model(discovery: Discovery) -> str:
    """The grown model in a few words: `with adhesion and gas-leak`."""
    effects = [clean(effect, 40) for effect in discovery.effects]
    return "with " + (", ".join(effects[:-1]) + " and " if len(effects) > 1 else "") + effects[-1] if effects else ""


def count_records(discovery: Discovery) -> int:
    """How many records were fitted."""
    return len({trace.record for step in discovery.steps[-1:] for trace in step.traces})


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
