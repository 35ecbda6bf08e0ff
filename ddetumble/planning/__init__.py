"""What to do next: the test that tells rivals apart, what a planned campaign could see, where to strike.

Attributes:
    CONSTRAINTS: names of the constraints of a blow, in the order in which `evaluate` returns them.
"""

from .._lazy import attach as _attach


__getattr__, __dir__, __all__ = _attach(__name__, __file__)
