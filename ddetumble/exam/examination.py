"""The exam itself: one case from question to marks, and many in a folder that keeps them.

`exam.json` in the folder says what is asked, `cases.jsonl` holds a line a case.
"""

import dataclasses as dc
import json
import os
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from .._display import Progress
from .._errors import InputError
from ..inference.files import list_versions, make_plain, write_json
from .cases import Case, Exam, sample_case, write_case
from .running import run_all
from .scoring import describe_failure


QUESTIONS, ANSWERS = "exam.json", "cases.jsonl"


def run_case(exam: Exam, index: int, keep: Path | None = None) -> dict[str, Any]:
    """One row of an exam: the case, what `discover` said of it, and how far it was from the truth.

    Args:
        exam: what is drawn from.
        index: the case's number.
        keep: folder in which the campaign, the discovery and `truth.json` stay; nothing stays if not given.

    Returns:
        Plain numbers, text and lists. What fails in a case is told in its `error`, and the exam goes on.
    """
    return judge_case(exam, sample_case(exam, index), keep)


def judge_case(exam: Exam, case: Case, keep: Path | None = None) -> dict[str, Any]:
    """The same for a case that is sampled already; arguments and result as those of `run_case`."""
    began, spent = time.perf_counter(), time.process_time()
    row = dc.asdict(case)
    with tempfile.TemporaryDirectory(prefix="ddetumble-exam-") as draft:
        folder = keep or Path(draft)
        row["seconds"] = {"drawing": round(time.perf_counter() - began, 2)}
        began = time.perf_counter()
        try:
            row["fault_details"] = write_case(exam, case, folder / "campaign")
            row |= discover_case(exam, case, folder)
            row["error"] = None
        except InputError as error:  # discover says that such data can tell nothing
            row |= {"verdict": "refused", "error": str(error)[:600]}
        except Exception as error:  # whatever it is, it is this case's failure and no reason to lose the others
            row |= {"verdict": "failed", "error": f"{type(error).__name__}: {error}"[:600]}
        row["seconds"]["answering"] = round(time.perf_counter() - began, 2)
        row["processor_seconds"] = round(time.process_time() - spent, 2)
    if keep is not None:
        write_json(keep / "truth.json", row)
    return row


def discover_case(exam: Exam, case: Case, folder: Path) -> dict[str, Any]:
    """What `discover` says of the campaign in `folder`, which is all that it sees, beside the truth."""
    from ..selection.discover import discover

    found = discover(folder / "campaign")
    first, last = found.steps[0].lack_of_fit, found.steps[-1]
    estimates = {name: [e.estimate, e.q025, e.q975] for name, e in last.parameters.items()}
    found.save(folder / "discovery")
    return {
        "verdict": found.verdict, "found": list(found.effects),
        "sets": [[str(s.added), *(str(a["effect"]) for a in s.alternatives)] for s in found.steps[1:]],
        "p_values": [first.smooth_p_value, first.score_p_value, last.lack_of_fit.smooth_p_value,
                     last.lack_of_fit.score_p_value],
        "intervals": join_truth(estimates, name_truth(case.setting["base"], case.effects)),
        "heldout_over_noise": predict_heldout(exam, case, folder / "discovery"),
        "claimed_over_noise": last.heldout_nrmse / max(found.noise_nrmse, 1e-300), "sentence": found.sentence,
        "records": int(found.counts["records"]),
        "reported": [{"kind": f.kind, "records": list(f.records), "left_out": f.left_out} for f in found.faults],
    }  # fmt: skip


def name_truth(base: Mapping[str, float], effects: Mapping[str, Mapping[str, Any]]) -> dict[str, float]:
    """True parameters by the names that results use: `wall-stiffness.k_w`, `gyro-bias.bias.0`."""
    truth = dict(base)
    for effect, values in effects.items():
        for symbol, value in values.items():
            if isinstance(value, (list, tuple)):
                truth |= {f"{effect}.{symbol}.{k}": float(x) for k, x in enumerate(value)}
            else:
                truth[f"{effect}.{symbol}"] = float(value)
    return truth


def join_truth(estimates: Mapping[str, list[float]], truth: Mapping[str, float]) -> dict[str, list[float]]:
    """By parameter: truth, and the estimate with its interval, of those that have a truth."""
    return {name: [truth[name], *values] for name, values in estimates.items() if name in truth}


def predict_heldout(exam: Exam, case: Case, model: Path) -> float:
    """rms over noise of the grown model's predictions against noise-free tests at conditions that it has not seen."""
    import pandas as pd

    from ..selection.predict import predict

    family, tests = exam.generator, exam.generator.hold_out(case.effects, case.setting)
    frames = [pd.DataFrame({"record": f"h{k}", **test.conditions, family.along: test.along})
              for k, test in enumerate(tests)]  # fmt: skip
    table = predict(model, pd.concat(frames, ignore_index=True))
    gaps = []
    for c, (channel, noise) in enumerate(family.channels.items()):
        truth = np.concatenate([test.readings[:, c] for test in tests])
        gaps.append((table[channel].to_numpy() - truth) / noise)
    return float(np.sqrt(np.nanmean(np.square(gaps))))


class CaseTable:
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
    """Run an exam: every case in `cases` that the folder does not hold yet.

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
        work: what is done with a case; `run_case` if not given.

    Returns:
        The rows of all cases that the folder holds, in the order of their numbers.

    Raises:
        InputError: the folder holds another exam, is in use or cannot be written; no scheduler answers.
        ComputationError: workers keep dying.
    """
    folder = Path(folder)
    if any(case < 0 for case in cases):
        raise InputError("cases are numbered from 0 on", option="--first")
    table = CaseTable(folder, exam)
    work = work or (partial(_run_and_keep, exam, str((folder / "kept").resolve())) if keep else partial(run_case, exam))
    with table.lock():
        done = table.read()
        left = [case for case in dict.fromkeys(cases) if case not in done]
        began, wrong = time.perf_counter(), 0
        _report(progress, 0, len(left), wrong, began)
        for count, (_, row) in enumerate(run_all(work, left, workers, scheduler), 1):
            table.add(row)
            wrong += bool(describe_failure(row))
            _report(progress, count, len(left), wrong, began)
        return table.sort()


def _run_and_keep(exam: Exam, folder: str, index: int) -> dict[str, Any]:
    """One case whose campaign and discovery stay."""
    return run_case(exam, index, Path(folder) / f"case-{index:04d}")


def _report(progress: Progress | None, count: int, total: int, wrong: int, began: float) -> None:
    """Say how far it is, and how long the rest will take."""
    if progress is None or not total:
        return
    text = f"{count} of {total} cases, {wrong} not right"
    if count:
        rest = (time.perf_counter() - began) / count * (total - count)
        text += f", about {max(round(rest / 60), 1)} min left" if count < total else ""
    progress(text, count / total)
