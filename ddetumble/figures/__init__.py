"""Figures of a campaign and of what was found in it: records in, a matplotlib figure out.

`models` are the fitted series of one or two models by their names, the reference model first; `channel` is what is
drawn of them, the family's force where it is not given. `narrow` draws for a telephone.

Attributes:
    styled: decorator of a function that makes a figure, which it draws in the look of the house.
"""

from .._lazy import attach as _attach


__getattr__, __dir__, __all__ = _attach(__name__, __file__)
