"""Posteriors: emcee and NUTS over any fit of the toolkit, checkpoints, results as ArviZ reads them, model weights."""

from .._lazy import attach as _attach


__getattr__, __dir__, __all__ = _attach(__name__, __file__)
