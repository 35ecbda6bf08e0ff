"""Public names of planning and where they live."""

from .constraints import CONSTRAINTS as CONSTRAINTS
from .constraints import evaluate as evaluate
from .constraints import evaluate_slopes as evaluate_slopes
from .draws import Laws as Laws
from .draws import draw_laws as draw_laws
from .plan import PlanSettings as PlanSettings
from .problem import Goal as Goal
from .problem import Limits as Limits
from .scenario_file import read_scenario as read_scenario
from .single import StrikePlan as StrikePlan

__all__: list[str]
