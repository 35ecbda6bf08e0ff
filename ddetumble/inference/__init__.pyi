"""Public names of inference and where they live."""

from .archive import make_fitted as make_fitted
from .archive import resolve_model as resolve_model
from .noise import Noise as Noise

__all__: list[str]
