"""The source paper beside the toolkit: where its forces contradict themselves, and what its printed numbers allow."""

from .._settings import configure as _configure


_configure()

from .contradictions import Contradiction, list_contradictions  # noqa: E402
from .friction import FrictionJudgement, judge_friction  # noqa: E402
from .judgement import PeakJudgement, judge_campaign, judge_peaks  # noqa: E402
from .page import write_paper  # noqa: E402
from .peak_page import write_peaks  # noqa: E402


__all__ = [
    "Contradiction", "FrictionJudgement", "PeakJudgement", "judge_campaign", "judge_friction",
    "judge_peaks", "list_contradictions", "write_paper", "write_peaks",
]
