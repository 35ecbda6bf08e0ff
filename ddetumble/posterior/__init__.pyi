"""Public names of posteriors and where they live."""

from .stacking import ModelWeights as ModelWeights
from .target import pose_curve as pose_curve
from .target import pose_fit as pose_fit

__all__: list[str]
