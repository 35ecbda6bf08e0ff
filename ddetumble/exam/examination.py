"""The exam itself: one case from question to marks, and many in a folder that keeps them.

`exam.json` in the folder says what is asked, `cases.jsonl` holds a line a case.
"""

import json
import os
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from .._display import Progress
from .._errors import InputError
from ..inference.files import claim_folder, hold_folder, list_versions, make_plain, write_json, write_whole
from .cases import Exam
from .rehearsal import Rehearsal, prepare_plan
from .running import run_all
from .scoring import describe_failure


QUESTIONS, ANSWERS = "exam.json", "cases.jsonl"


def run_case(asked: Exam | Rehearsal, case: Any, keep: Path | None = None) -> dict[str, Any]:
    """One row of an exam: the case, what `discover` said of it, and how far it was from the truth.

    Args:
        asked: the exam, or the rehearsal.
        case: the case, or its number.
        keep: folder in which campaign, discovery and `truth.json` stay in one of the case's own; nothing stays if not
            given.

    Returns:
        Plain numbers, text and lists. What fails in a case is told in its `error`, and the exam goes on.
    """
    began, spent = time.perf_counter(), time.process_time()
    row, answer = asked.draw(case)
    drawn = time.perf_counter()
    with tempfile.TemporaryDirectory(prefix="ddetumble-exam-") as draft:
        folder = Path(draft) if keep is None else keep / f"case-{row['index']:04d}"
        try:
            for part in answer(folder):
                row |= part
            row["error"] = None
        except InputError as error:  # discover says that such data can tell nothing
            row |= {"verdict": "refused", "error": str(error)[:600]}
        except Exception as error:  # whatever it is, it is this case's failure and no reason to lose the others
            row |= {"verdict": "failed", "error": f"{type(error).__name__}: {error}"[:600]}
        row["seconds"] = {"drawing": round(drawn - began, 2), "answering": round(time.perf_counter() - drawn, 2)}
        row["processor_seconds"] = round(time.process_time() - spent, 2)
        if keep is not None:
            write_json(folder / "truth.json", row)
    return row


def examine(asked: Exam | Rehearsal, cases: Sequence[int], folder: Path | str, *, workers: int | None = None,
            scheduler: str | None = None, keep: bool = False, progress: Progress | None = None,
            work: Callable[[int], dict[str, Any]] | None = None) -> list[dict[str, Any]]:
    """Run an exam or a rehearsal: every case in `cases` that the folder does not hold yet.

    Cases are independent: each is drawn from the exam's seed and its own number. What is done is on disk, so the same
    call goes on where another was stopped. In a script, call it below `if __name__ == "__main__":`, as it starts
    processes.

    Args:
        asked: what is asked.
        cases: their numbers.
        folder: for `exam.json` and `cases.jsonl`.
        workers: processes; as many as there are cores if not given.
        scheduler: address of a Dask scheduler that does the cases instead.
        keep: leave campaign, discovery and truth of every case in `kept/` in the folder.
        progress: called with a sentence and the share done.
        work: what is done with a case; `run_case` if not given.

    Returns:
        The rows of all cases that the folder holds, in the order of their numbers.

    Raises:
        InputError: the folder holds another exam, is in use or cannot be written; no scheduler answers; plan or option
            of a rehearsal make no sense.
        ComputationError: workers keep dying, or the reference model of a rehearsal cannot be computed there.
    """
    folder = Path(folder)
    if any(case < 0 for case in cases):
        raise InputError("cases are numbered from 0 on", option="--first")
    if isinstance(asked, Rehearsal):
        prepare_plan(asked)  # whatever is wrong with the plan is said before anything is written
    work = work or partial(run_case, asked, keep=(folder / "kept").resolve() if keep else None)
    with hold_folder(folder, "another process is writing to this exam; wait for it, or name another folder"):
        claim_folder(folder / QUESTIONS, "an exam", "exam", asked.to_dict(), versions=list_versions())
        path = folder / ANSWERS
        rows = read_answers(path)
        left = [case for case in dict.fromkeys(cases) if case not in rows]
        began, wrong = time.perf_counter(), 0

        def report(done: int) -> None:
            text = f"{done} of {len(left)} cases, {wrong} not right"
            if 0 < done < len(left):
                minutes = (time.perf_counter() - began) / done * (len(left) - done) / 60
                text += f", about {max(round(minutes), 1)} min left"
            if progress is not None and left:
                progress(text, done / len(left))

        report(0)
        for done, (case, row) in enumerate(run_all(work, left, workers, scheduler), 1):
            rows[case] = make_plain(row)
            with path.open("a", encoding="utf-8") as stream:  # on disk before the next one
                stream.write(write_row(rows[case]))
                stream.flush()
                os.fsync(stream.fileno())
            wrong += bool(describe_failure(row))
            report(done)
        found = [row for _, row in sorted(rows.items())]
        write_whole(path, lambda draft: draft.write_text("".join(map(write_row, found)), encoding="utf-8"))
        return found


def write_row(row: Mapping[str, Any]) -> str:
    """A case as the line of a file."""
    return json.dumps(row, ensure_ascii=False, allow_nan=False) + "\n"


def read_answers(path: Path) -> dict[int, dict[str, Any]]:
    """Rows by case; what a killed process left of its last line is cut off the file.

    Raises:
        InputError: A line is no case.
    """
    if not path.is_file():
        return {}
    data = path.read_bytes()
    os.truncate(path, data.rfind(b"\n") + 1)
    rows = {}
    for number, line in enumerate(data.decode("utf-8", "replace").split("\n")[:-1], 1):
        try:
            row = json.loads(line)
            rows[int(row["index"])] = row
        except (ValueError, KeyError, TypeError):
            raise InputError("the line is no case of an exam; remove it, and the same command does that case again",
                             file=path, row=number) from None
    return rows
