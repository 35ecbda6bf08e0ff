"""A case generator: how cases of one family are drawn, simulated and measured, and how large hidden effects are."""

import dataclasses as dc
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from .benches import BENCHES
from .campaigns import Campaign


@dc.dataclass(frozen=True)
class Hidden:
    """An effect of known size by its parameters' symbols: amplitude 0 is its null, amplitude 1 a typical case."""

    departure: Mapping[str, float] = dc.field(default_factory=dict)  # what an amplitude of 1 adds to the null
    null: Mapping[str, float] = dc.field(default_factory=dict)  # where it is not 0
    vectors: Mapping[str, float] = dc.field(default_factory=dict)  # length of three components whose direction is drawn
    inverse: Mapping[str, float] = dc.field(default_factory=dict)  # value at 1 of what falls as the amplitude grows
    # Range from which it is drawn evenly in its logarithm, whatever the amplitude.
    shapes: Mapping[str, tuple[float, float]] = dc.field(default_factory=dict)
    most: float = 10.0  # largest amplitude for which the simulated test still makes sense
    since: int = 1  # edition of the drawing from which on it is drawn: earlier ones ask what they asked

    def draw(self, generator: np.random.Generator) -> dict[str, Any]:
        """Shapes, and the vectors at amplitude 1."""
        drawn: dict[str, Any] = {}
        for name, (low, high) in self.shapes.items():
            drawn[name] = float(np.exp(generator.uniform(np.log(low), np.log(high))))
        for name, length in self.vectors.items():
            direction = generator.standard_normal(3)
            drawn[name] = [float(x) for x in length * direction / np.linalg.norm(direction)]
        return drawn

    def build(self, amplitude: float, drawn: Mapping[str, Any]) -> dict[str, Any]:
        """Parameters by symbol, as the simulators want them."""
        found: dict[str, Any] = {s: self.null.get(s, 0.0) + float(amplitude) * x for s, x in self.departure.items()}
        found |= {s: x / float(amplitude) for s, x in self.inverse.items()}
        for name, value in drawn.items():
            found[name] = [float(amplitude) * x for x in value] if name in self.vectors else value
        return found


class HeldOut(NamedTuple):
    """A noise-free test at conditions that the campaign does not hold: these, time or slip, and readings; SI."""

    conditions: Mapping[str, float]
    along: np.ndarray
    readings: np.ndarray


@dc.dataclass(frozen=True)
class CaseGenerator:
    """One family's cases; settings are a plain dictionary, `base` in it the parameters of the reference model."""

    name: str  # of the family
    channels: Mapping[str, float]  # that are measured and predicted, with the noise of each, SI
    along: str  # `time` or `slip`
    catalogue: Mapping[str, Hidden]  # effects that the package lists, as the exam hides them
    outside: Mapping[str, Hidden]  # effects that it lacks, or lacked when the cases were first drawn
    draw_setting: Callable[[np.random.Generator], dict[str, Any]]  # base parameters and conditions
    make: Callable[..., Campaign]  # from name, seed and effects; by name the settings, `rho` and `white_share`
    # For settings and a seed, the function effects -> rms over noise that a refitted reference leaves.
    prepare: Callable[[Mapping[str, Any], int], Callable[[Mapping[str, Any]], float]]
    # Noise-free tests elsewhere, from effects and settings.
    hold_out: Callable[[Mapping[str, Any], Mapping[str, Any]], list[HeldOut]]
    benches: tuple[str, ...]  # kinds of `benches.BENCHES` that such records can show
    # By a channel or condition that is biased throughout, or the kind of a bench: effects of the catalogue that no test
    # can tell from it.
    same: Mapping[str, tuple[str, ...]] = dc.field(default_factory=dict)
    edition: int = 1  # of the way in which cases are drawn: another one asks other questions under the same seed


def leave_out(*kinds: str) -> tuple[str, ...]:
    """Kinds of benches but for some."""
    return tuple(kind for kind in BENCHES if kind not in kinds)


def spread(generator: np.random.Generator, low: float, high: float, count: int) -> list[float]:
    """So many settings between two limits, one in the middle half of each of as many even parts in the logarithm."""
    place = (np.arange(count) + generator.uniform(0.25, 0.75, count)) / count
    return [float(f"{x:.4g}") for x in low * (high / low) ** place]
