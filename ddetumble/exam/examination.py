"""The exam itself: cases that are not done yet, one after another or many at once, and the scorecard of all."""

import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from .._display import Progress
from .._errors import InputError
from .drawing import Exam
from .ledger import Ledger
from .running import run_all
from .scoring import describe_failure
from .sitting import sit


def examine(exam: Exam, cases: Sequence[int], folder: Path | str, *, workers: int | None = None,
            scheduler: str | None = None, keep: bool = False, progress: Progress | None = None,
            work: Callable[[int], dict[str, Any]] | None = None) -> list[dict[str, Any]]:
    """Sit an exam: every case in `cases` that the folder does not hold yet.

    Cases are independent: each is drawn from the exam's seed and its own number. What is done is on disk, so the same
    call goes on where another was stopped. In a script, call it below `if __name__ == "__main__":`, as it starts
    processes.

    Args:
        exam: what is asked.
        cases: their numbers.
        folder: for `exam.json` and `cases.jsonl`.
        workers: processes; as many as there are cores if not given.
        scheduler: address of a Dask scheduler that does the cases instead.
        keep: leave campaign, discovery and truth of every case in `kept/` in the folder.
        progress: called with a sentence and the share done.
        work: what is done with a case; `sit` if not given.

    Returns:
        The rows of all cases that the folder holds, in the order of their numbers.

    Raises:
        InputError: the folder holds another exam, is in use or cannot be written; no scheduler answers.
        ComputationError: workers keep dying.
    """
    folder = Path(folder)
    if any(case < 0 for case in cases):
        raise InputError("cases are numbered from 0 on", option="--first")
    ledger = Ledger(folder, exam)
    work = work or (partial(_sit_and_keep, exam, str((folder / "kept").resolve())) if keep else partial(sit, exam))
    with ledger.lock():
        done = ledger.read()
        left = [case for case in dict.fromkeys(cases) if case not in done]
        began, wrong = time.perf_counter(), 0
        _report(progress, 0, len(left), wrong, began)
        for count, (_, row) in enumerate(run_all(work, left, workers, scheduler), 1):
            ledger.add(row)
            wrong += bool(describe_failure(row))
            _report(progress, count, len(left), wrong, began)
        return ledger.sort()


def _sit_and_keep(exam: Exam, folder: str, index: int) -> dict[str, Any]:
    """One case whose campaign and discovery stay."""
    return sit(exam, index, Path(folder) / f"case-{index:04d}")


def _report(progress: Progress | None, count: int, total: int, wrong: int, began: float) -> None:
    """Say how far it is, and how long the rest will take."""
    if progress is None or not total:
        return
    text = f"{count} of {total} cases, {wrong} not right"
    if count:
        rest = (time.perf_counter() - began) / count * (total - count)
        text += f", about {max(round(rest / 60), 1)} min left" if count < total else ""
    progress(text, count / total)
