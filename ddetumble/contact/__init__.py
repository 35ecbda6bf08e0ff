"""Contact mechanics: depression in, force out."""

from .._lazy import attach as _attach
from .._settings import configure as _configure


_configure()
__getattr__, __dir__, __all__ = _attach(__name__, __file__)
