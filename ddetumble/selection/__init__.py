"""Where a model fails, and which physics it lacks: thresholds that decide, and the records that results are made of."""

from .._lazy import attach as _attach


__getattr__, __dir__, __all__ = _attach(__name__, __file__)
