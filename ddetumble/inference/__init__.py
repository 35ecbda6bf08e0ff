"""Inverse problems: parameters with uncertainty from measured records."""

from .._lazy import attach as _attach


__getattr__, __dir__, __all__ = _attach(__name__, __file__)
