"""The exam itself: its folder (`exam.json` says what is asked, `cases.jsonl` holds a line a case), and doing it."""

import json
import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from .._display import Progress
from .._errors import InputError
from ..inference.files import list_versions, make_plain, write_json
from .drawing import Exam
from .running import run_all
from .scoring import describe_failure
from .sitting import sit


QUESTIONS, ANSWERS = "exam.json", "cases.jsonl"


class Ledger:
    """Rows of the cases that are done, on disk; only one process writes them at a time.

    A line is written whole or is no line: what a killed process left of its last one is cut off.

    Args:
        folder: of the exam; made where it is not there.
        exam: what is asked. A folder that holds another exam is refused.
    """

    def __init__(self, folder: Path, exam: Exam):
        self.folder, self.exam = folder, exam
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / QUESTIONS
        asked = make_plain(exam)
        if path.is_file():
            try:
                before = json.loads(path.read_text(encoding="utf-8"))["exam"]
            except (OSError, ValueError, KeyError, TypeError):
                raise InputError("is no description of an exam, or a damaged one; name another folder", file=path
                                 ) from None
            if before != asked:
                other = ", ".join(f"{k} {before.get(k)}" for k in asked if before.get(k) != asked[k])
                raise InputError(f"the folder holds another exam ({other or 'of other settings'}); name another "
                                 "folder, or the same settings to go on", file=path)
        else:
            write_json(path, {"exam": asked, "versions": list_versions()})
        self.path = folder / ANSWERS

    @contextmanager
    def lock(self) -> Iterator[None]:
        """Keep other processes out of the folder while this one writes."""
        from filelock import FileLock, Timeout

        lock = FileLock(self.folder / ".lock")
        try:
            lock.acquire(timeout=0)
        except Timeout:
            raise InputError("another process is writing to this exam; wait for it, or name another folder",
                             file=self.folder) from None
        try:
            yield
        finally:
            lock.release()
            (self.folder / ".lock").unlink(missing_ok=True)

    def read(self) -> dict[int, dict[str, Any]]:
        """Rows by case; a torn last line is cut off the file."""
        if not self.path.is_file():
            return {}
        data = self.path.read_bytes()
        whole = data.rfind(b"\n") + 1
        if whole < len(data):
            with self.path.open("r+b") as stream:
                stream.truncate(whole)
        rows = {}
        for number, line in enumerate(data[:whole].decode("utf-8", "replace").splitlines(), 1):
            try:
                row = json.loads(line)
                rows[int(row["index"])] = row
            except (ValueError, KeyError, TypeError):
                raise InputError("the line is no case of an exam; remove it, and the same command does that case again",
                                 file=self.path, row=number) from None
        return rows

    def add(self, row: Mapping[str, Any]) -> None:
        """Append one case; it is on disk when this returns."""
        line = json.dumps(make_plain(row), ensure_ascii=False, allow_nan=False) + "\n"
        with self.path.open("ab") as stream:
            stream.write(line.encode("utf-8"))
            stream.flush()
            os.fsync(stream.fileno())

    def sort(self) -> list[dict[str, Any]]:
        """Put the lines in the order of their cases; returns the rows."""
        rows = [row for _, row in sorted(self.read().items())]
        draft = self.path.with_name(f".{ANSWERS}.part")
        draft.write_text("".join(json.dumps(row, ensure_ascii=False) + "\n" for row in rows), encoding="utf-8")
        os.replace(draft, self.path)
        return rows


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
