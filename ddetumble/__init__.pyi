"""Public names and where they live; `__init__` reads this file, so that nothing heavy is imported before it is used."""

from . import contact as contact
from . import dynamics as dynamics
from . import effects as effects
from . import exam as exam
from . import families as families
from . import figures as figures
from . import inference as inference
from . import planning as planning
from . import posterior as posterior
from . import selection as selection
from ._errors import ComputationError as ComputationError
from ._errors import InputError as InputError
from ._settings import find_data as find_data
from .contact.contract import check_effect as check_effect
from .contact.function_effect import effect as effect
from .contact.law import Ball as Ball
from .contact.law import PowerLaw as PowerLaw
from .contact.sliding import CoulombFriction as CoulombFriction
from .contact.sliding import RubberFriction as RubberFriction
from .contact.torque import RigidBody as RigidBody
from .inference.archive import FittedModel as FittedModel
from .inference.archive import load as load
from .inference.estimation import fit as fit
from .inference.findings import Fit as Fit
from .inference.joint import JointFit as JointFit
from .inference.joint import fit_jointly as fit_jointly
from .inference.population import PopulationFit as PopulationFit
from .inference.population import fit_population as fit_population
from .measurement.campaign import Campaign as Campaign
from .measurement.laboratory import import_tests as import_tests
from .measurement.package import read_campaign as read_campaign
from .measurement.package import write_campaign as write_campaign
from .measurement.plausibility import check_plausibility as check_plausibility
from .measurement.recordings import list_channels as list_channels
from .planning.detectability import map_effects as map_effects
from .planning.next_test import design as design
from .planning.plan import Plan as Plan
from .planning.plan import plan as plan
from .planning.problem import StrikeProblem as StrikeProblem
from .posterior.result import Posterior as Posterior
from .posterior.sampling import sample as sample
from .posterior.stacking import average as average
from .reconstruct.force import identify as identify
from .reports import report as report
from .selection.compare import Comparison as Comparison
from .selection.compare import Comparisons as Comparisons
from .selection.compare import compare as compare
from .selection.discover import discover as discover
from .selection.discovery import Discovery as Discovery
from .selection.missing.missing_force import draw_missing_force as draw_missing_force
from .selection.predict import predict as predict
from .selection.predict import predict_pulses as predict_pulses
from .selection.settings import SelectionSettings as SelectionSettings

__version__: str
__all__: list[str]
