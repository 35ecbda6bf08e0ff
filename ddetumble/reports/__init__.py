"""Reports: one page to look at that works offline, its figures as PNG, and the same in plain text for a terminal."""

from .._lazy import attach as _attach


__getattr__, __dir__, __all__ = _attach(__name__, __file__)
