"""Public names of the exam and where they live."""

from .cases import Exam as Exam
from .examination import examine as examine
from .rehearsal import Rehearsal as Rehearsal
from .scorecard import write_scorecard as write_scorecard

__all__: list[str]
