"""One case from question to marks: simulate it, let `discover` judge the folder blind, hold its answer to the truth."""

import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from .._errors import InputError
from .drawing import Case, Exam, draw_case, write_case


def sit(exam: Exam, index: int, keep: Path | None = None) -> dict[str, Any]:
    """One row of an exam: the case, what `discover` said of it, and how far it was from the truth.

    Args:
        exam: what is drawn from.
        index: the case's number.
        keep: folder in which the campaign, the discovery and `truth.json` stay; nothing stays if not given.

    Returns:
        Plain numbers, text and lists. What fails in a case is told in its `error`, and the exam goes on.
    """
    return sit_case(exam, draw_case(exam, index), keep)


def sit_case(exam: Exam, case: Case, keep: Path | None = None) -> dict[str, Any]:
    """The same for a case that is drawn already; arguments and result as those of `sit`."""
    began, spent = time.perf_counter(), time.process_time()
    row = describe_case(case)
    with tempfile.TemporaryDirectory(prefix="ddetumble-exam-") as draft:
        folder = keep or Path(draft)
        row["seconds"] = {"drawing": round(time.perf_counter() - began, 2)}
        began = time.perf_counter()
        try:
            row["fault_details"] = write_case(exam, case, folder / "campaign")
            row |= answer(exam, case, folder)
            row["error"] = None
        except InputError as error:  # discover says that such data can tell nothing
            row |= {"verdict": "refused", "error": str(error)[:600]}
        except Exception as error:  # whatever it is, it is this case's failure and no reason to lose the others
            row |= {"verdict": "failed", "error": f"{type(error).__name__}: {error}"[:600]}
        row["seconds"]["answering"] = round(time.perf_counter() - began, 2)
        row["processor_seconds"] = round(time.process_time() - spent, 2)
    if keep is not None:
        from ..inference.files import write_json

        write_json(keep / "truth.json", row)
    return row


def describe_case(case: Case) -> dict[str, Any]:
    """The question with its truth."""
    return {"index": case.index, "kind": case.kind, "effects": dict(case.effects), "asked": dict(case.asked),
            "strengths": dict(case.strengths), "noise": dict(case.noise), "fault": case.fault,
            "setting": dict(case.setting), "seed": case.seed}


def answer(exam: Exam, case: Case, folder: Path) -> dict[str, Any]:
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
        "intervals": hold_to_truth(estimates, name_truth(case.setting["base"], case.effects)),
        "heldout_over_noise": predict_elsewhere(exam, case, folder / "discovery"),
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


def hold_to_truth(estimates: Mapping[str, list[float]], truth: Mapping[str, float]) -> dict[str, list[float]]:
    """By parameter: truth, and the estimate with its interval, of those that have a truth."""
    return {name: [truth[name], *values] for name, values in estimates.items() if name in truth}


def predict_elsewhere(exam: Exam, case: Case, model: Path) -> float:
    """rms over noise of the grown model's predictions against noise-free tests at conditions that it has not seen."""
    import pandas as pd

    from ..selection.predict import predict

    bench, tests = exam.bench, exam.bench.hold_out(case.effects, case.setting)
    frames = [pd.DataFrame({"record": f"h{k}", **test.conditions, bench.along: test.along})
              for k, test in enumerate(tests)]  # fmt: skip
    table = predict(model, pd.concat(frames, ignore_index=True))
    gaps = []
    for c, (channel, noise) in enumerate(bench.channels.items()):
        truth = np.concatenate([test.readings[:, c] for test in tests])
        gaps.append((table[channel].to_numpy() - truth) / noise)
    return float(np.sqrt(np.nanmean(np.square(gaps))))
