"""Conditions beyond those that a model was fitted to, and impacts that would squeeze the ball out of shape."""

import dataclasses as dc
from collections.abc import Mapping, Sequence

import jax.numpy as jnp
import numpy as np

from ..contact.friction import describe_range
from ..contact.law import ContactLaw
from ..contact.sliding import RubberFriction
from ..dynamics.impact import bound_depression
from ..inference.archive import FittedModel


SLACK = 0.02  # of a condition's value, by which it may lie outside
SQUEEZED = 0.5  # of the diameter: farther in, the plate would be past the centre of the undeformed ball
MOST = 6  # notes on conditions; the rest is counted


@dc.dataclass(frozen=True)
class Squeeze:
    """An impact that would press the ball together by more than the contact geometry is made for."""

    record: str
    depression: float  # that it does not exceed, by its kinetic energy [m]; infinite where none takes that up
    diameter: float  # of the ball [m]

    def __str__(self) -> str:
        size = f"its {1e3 * self.diameter:.3g} mm"
        return (f"the ball would be pressed together by more than {size}" if self.depression >= self.diameter else
                f"the ball would be pressed together by up to {1e3 * self.depression:.3g} of {size}")


def find_squeezes(saved: FittedModel, keys: Sequence[str], settings: Mapping[str, np.ndarray]) -> tuple[Squeeze, ...]:
    """Records whose impact would press the ball together by more than `SQUEEZED` of its diameter.

    Args:
        saved: a fitted model; of friction, tumbling bodies, and pads without a diameter there is nothing to find.
        keys: of the records.
        settings: their conditions, one value a record, SI.
    """
    law = saved.law()
    law = getattr(law, "normal", law)  # of an oblique impact
    if not isinstance(law, ContactLaw) or not float(law.reference.diameter()) > 0:
        return ()
    found = []
    for i, key in enumerate(keys):
        here = {"initial_pressure": 0.0, "sequence": 1.0} | {name: float(v[i]) for name, v in settings.items()}
        bounds = bound_depression(law, {name: jnp.asarray(value) for name, value in here.items()})
        depression, diameter = map(float, bounds)
        if depression > SQUEEZED * diameter:
            found.append(Squeeze(key, depression, diameter))
    return tuple(found)


def describe_extrapolation(saved: FittedModel, keys: list[str], settings: dict[str, np.ndarray]) -> list[str]:
    """Sentences on conditions beyond those of the campaign."""
    found: dict[str, list[str]] = {}
    some = []
    for i, key in enumerate(keys):
        phrases = saved.outside({name: float(v[i]) for name, v in settings.items()}, slack=SLACK)
        some += [i] if phrases else []
        for phrase in phrases:
            found.setdefault(phrase, []).append(key)
    notes = [f"Extrapolated: {phrase} (record {_list_some(records)})."
             for phrase, records in list(found.items())[:MOST]]
    if len(found) > MOST:
        notes.append(f"Extrapolated in {len(found) - MOST} further settings.")
    squeezes = find_squeezes(saved, [keys[i] for i in some], {name: v[some] for name, v in settings.items()})
    if squeezes:
        worst = max(squeezes, key=lambda one: one.depression / one.diameter)
        records = _list_some([worst.record, *(one.record for one in squeezes if one is not worst)])
        notes.append(f"Beyond the contact geometry, which holds up to {SQUEEZED:.0%} of the diameter: {worst} (record "
                     f"{records}). What is predicted there means nothing.")
    pressure, loads = settings.get("initial_pressure"), settings.get("normal_load")
    if loads is not None and isinstance(saved.space.reference, RubberFriction):
        notes += [f"Outside the range of Eq. 10: {phrase}." for phrase in dict.fromkeys(map(describe_range, loads))
                  if phrase]
    if pressure is not None and np.any(pressure == 0) and "gas" in saved.space.reference.provides:
        notes.append("Without gas (initial_pressure = 0) this model's ball has no gas force.")
    return notes


def describe_failure(saved: FittedModel, key: str, settings: Mapping[str, np.ndarray], place: int) -> str:
    """Why the model can hardly be integrated for a record, at a place among `settings`, and what to do."""
    here = {name: float(v[place]) for name, v in settings.items()}
    reasons = saved.outside(here, slack=SLACK)
    reasons += map(str, find_squeezes(saved, [key], {name: np.array([value]) for name, value in here.items()}))
    given = ", ".join(f"{name} = {value:g}" for name, value in here.items())
    failed = f"the model could not be integrated for record {key!r}"
    if not reasons:
        return f"{failed} ({given}); check its conditions and their units"
    return (f"{failed}: {'; '.join(reasons)}. Check the conditions ({given}) and their units, or choose some nearer to "
            "those of the campaign")


def _list_some(records: Sequence[str]) -> str:
    more = f" and {len(records) - 3} more" if len(records) > 3 else ""
    return f"{', '.join(records[:3])}{more}"
