"""The sealed exam: hidden truths simulated by a second implementation, judged blind by `discover`, and marked."""

from .._lazy import attach as _attach


__getattr__, __dir__, __all__ = _attach(__name__, __file__)
