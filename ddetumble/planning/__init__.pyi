"""Public names of planning and where they live."""

from .draws import Laws as Laws
from .draws import draw_laws as draw_laws
from .plan import PlanSettings as PlanSettings
from .scenario import read_scenario as read_scenario
from .strike_plan import StrikePlan as StrikePlan
from .strike_problem import Goal as Goal
from .strike_problem import Limits as Limits

__all__: list[str]
