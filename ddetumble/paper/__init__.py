"""The source paper beside the toolkit: where its forces contradict themselves, and what its printed numbers allow."""

from .._settings import configure as _configure


_configure()

from .contradictions import Contradiction, list_contradictions  # noqa: E402
from .page import write_paper  # noqa: E402
from .rivals import Judged, judge_table  # noqa: E402


__all__ = ["Contradiction", "Judged", "judge_table", "list_contradictions", "write_paper"]
