"""An effect as the exam hides it: what grows with its amplitude, what is drawn beside it, and how far it may go."""

import dataclasses as dc
from collections.abc import Mapping
from typing import Any

import numpy as np


@dc.dataclass(frozen=True)
class Hidden:
    """An effect of known size: amplitude 0 is its null, amplitude 1 a typical case.

    Attributes:
        departure: by symbol, what an amplitude of 1 adds to the null.
        null: by symbol, where it is not 0.
        vectors: by symbol, length of a vector of three at amplitude 1; its direction is drawn.
        inverse: by symbol, value at amplitude 1 of what falls as the amplitude grows (a time constant).
        shapes: by symbol, range from which it is drawn evenly in its logarithm, whatever the amplitude.
        most: largest amplitude for which the simulated test still makes sense.
    """

    departure: Mapping[str, float] = dc.field(default_factory=dict)
    null: Mapping[str, float] = dc.field(default_factory=dict)
    vectors: Mapping[str, float] = dc.field(default_factory=dict)
    inverse: Mapping[str, float] = dc.field(default_factory=dict)
    shapes: Mapping[str, tuple[float, float]] = dc.field(default_factory=dict)
    most: float = 10.0

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
