"""Public names of planning and where they live."""

from .ambiguity import assess_plan as assess_plan
from .draws import Laws as Laws
from .draws import draw_laws as draw_laws
from .prospect import assess_sequence as assess_sequence
from .strike_plan import StrikePlan as StrikePlan
from .strike_problem import Goal as Goal
from .strike_problem import Limits as Limits
from .strike_problem import make_problem as make_problem

__all__: list[str]
