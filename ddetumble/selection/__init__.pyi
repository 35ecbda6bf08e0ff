"""Public names of selection and where they live."""

from ..inference.noise_estimation import NoiseSettings as NoiseSettings
from ..measurement.faults import Fault as Fault
from ..measurement.faults import ScreeningSettings as ScreeningSettings
from .result import Candidate as Candidate
from .result import Estimate as Estimate
from .result import LackOfFit as LackOfFit
from .result import MissingForce as MissingForce
from .result import Place as Place
from .result import SettingShift as SettingShift
from .result import Step as Step
from .settings import BaselineSettings as BaselineSettings
from .settings import OutlierSettings as OutlierSettings

__all__: list[str]
