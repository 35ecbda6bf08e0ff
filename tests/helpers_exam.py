"""Stand-ins for a case of the exam, which other processes can import, and rows with known marks."""

import os
import signal
import time
from pathlib import Path


def make_row(index, kind="nothing", verdict="nothing-missing", effects=(), found=(), others=(), strength=3.0, **more):
    """A row as `run_case` writes it; `others` are in the confusion set of the first effect found."""
    sets = [[name, *(others if k == 0 else ())] for k, name in enumerate(found)]
    return {
        "index": index, "kind": kind, "verdict": verdict, "effects": {name: {"k": 2.0} for name in effects},
        "asked": dict.fromkeys(effects, strength), "strengths": dict.fromkeys(effects, strength),
        "found": list(found), "sets": sets, "noise": {"rho": 0.0, "white_share": 0.0}, "fault": None,
        "intervals": {"mass": [1.0, 1.1, 0.9, 1.3]}, "heldout_over_noise": 0.25, "error": None,
        "seconds": {"drawing": 1.0, "answering": 2.0}, "processor_seconds": 4.0, "setting": {}, "seed": 1,
    } | more  # fmt: skip


def finish(index):
    """A case that is done at once."""
    return make_row(index)


def dawdle(index):
    """A case that takes a while."""
    time.sleep(0.2)
    return make_row(index)


def die_once(folder, index):
    """A case whose worker is killed the first time."""
    mark = Path(folder) / f"died-{index}"
    if index == 3 and not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return make_row(index)


def die_always(index):
    """A case that no worker survives."""
    os.kill(os.getpid(), signal.SIGKILL)
