r"""Transforms of parameters: from the value that people read to the coordinate in which a fit moves, and back.

A module holds a *field*, people read a public *value*, and a fit moves an unconstrained *coordinate* u:

=========  =====================  =====================  ==============================
transform  field                  value                  $|\partial \text{value}/\partial u|$
=========  =====================  =====================  ==============================
linear     u                      u                      1
log        $e^u$                  $e^u$                  value
logit      $1/(1 + e^{-u})$       $1/(1 + e^{-u})$       value (1 - value)
inverse    u                      1/u                    value²
=========  =====================  =====================  ==============================
"""

import dataclasses as dc
import math
from collections.abc import Callable
from typing import Any, final

import jax.numpy as jnp
import numpy as np


@final
@dc.dataclass(frozen=True)
class Transform:
    """A transform; see the table above."""

    name: str  # `linear`, `log`, `logit` or `inverse`
    support: tuple[float, float]  # open interval within which the field lies
    words: str  # the same in words
    from_field: Callable[[float], float]  # field to coordinate, of a float
    to_field: Callable[[Any], Any]  # coordinate to field, of floats, numpy and jax arrays alike
    slope: Callable[[float], float]  # size of the derivative of the value by the coordinate, of the value
    reciprocal: bool = False  # whether the value is 1/field
    # standard deviation of the coordinate beyond which nothing is known; infinite where it has a scale
    unknown: float = math.inf

    def allows(self, value: float) -> bool:
        """Whether a value has a coordinate."""
        return self.reciprocal or self.support[0] < value < self.support[1]

    def publish(self, field: Any) -> Any:
        """Value of a field."""
        if not self.reciprocal:
            return field
        with np.errstate(divide="ignore"):
            return 1.0 / np.asarray(field, dtype=float)

    def find_field(self, value: float) -> float:
        """Field of a value."""
        return (1.0 / value if value else math.inf) if self.reciprocal else value

    def to_unconstrained(self, value: float) -> float:
        """Coordinate of a value."""
        return self.find_field(value) if self.reciprocal else self.from_field(value)

    def from_unconstrained(self, u: Any) -> Any:
        """Value at a coordinate: a float of a float, an array of a numpy array."""
        value = self.publish(self.to_field(u))
        return value if isinstance(u, np.ndarray) else float(value)

    def interval(self, low: float, high: float) -> tuple[float, float]:
        """Lowest and highest value between two coordinates; without an upper end where an inverse reaches zero."""
        if self.reciprocal:
            return (1.0 / high if high > 0 else math.inf), (1.0 / low if low > 0 else math.inf)
        return self.from_unconstrained(low), self.from_unconstrained(high)

    def place_fields(self, low: float, high: float) -> tuple[float, float]:
        """Coordinates of the ends of a range of the field; an end beyond the support is none."""
        return (self.from_field(low) if low > self.support[0] else -math.inf,
                self.from_field(high) if high < self.support[1] else math.inf)

    def scale(self, size: float) -> float:
        """Change of the coordinate that matters, where that of the field is `size`; 1 where it has no unit."""
        return size if math.isinf(self.unknown) else 1.0


def _exponential(u: Any) -> Any:
    with np.errstate(over="ignore"):  # infinite is what an interval that reaches so far is
        return (np if isinstance(u, (np.ndarray, float, np.floating)) else jnp).exp(u)


TRANSFORMS = {one.name: one for one in (
    Transform("linear", (-math.inf, math.inf), "be finite", float, lambda u: u, lambda value: 1.0),
    Transform("log", (0.0, math.inf), "be positive", math.log, _exponential, lambda value: value, unknown=1.0),
    Transform("logit", (0.0, 1.0), "lie between 0 and 1", lambda value: math.log(value / (1.0 - value)),
              lambda u: 1.0 / (1.0 + _exponential(-u)), lambda value: value * (1.0 - value), unknown=4.0),
    Transform("inverse", (-math.inf, math.inf), "be a number", float, lambda u: u, lambda value: value**2,
              reciprocal=True),
)}
