"""Settings for all tests: 64-bit floats, one cache of compiled programs, figures without a screen, fixed examples."""

import gc
import os
from pathlib import Path

import pytest


ROOT = Path(__file__).resolve().parent.parent

# Read by JAX and matplotlib when they are imported, here and in the processes that tests start.
os.environ["JAX_ENABLE_X64"] = "1"
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(ROOT / ".cache" / "jax"))
os.environ.setdefault("DDETUMBLE_TRUST", str(ROOT / ".cache" / "trusted.txt"))
os.environ["MPLBACKEND"] = "Agg"
# Tests run side by side, on matrices too small to share among threads, which would wait for each other.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("MPLCONFIGDIR", str(ROOT / ".cache" / "matplotlib"))

# Hundreds of campaigns and programs stay alive in a process: to look through them often took an eighth of its time.
gc.set_threshold(50_000, 20, 100)

import hypothesis  # noqa: E402


hypothesis.settings.register_profile("fixed", derandomize=True, deadline=None, print_blob=True)
hypothesis.settings.load_profile("fixed")


def pytest_collection_modifyitems(items):
    """What is left out of every run is left out of the fast one, too; files with the most slow tests come first, so
    that no process is still at one when the others have ended (with `--no-loadscope-reorder`).
    """
    slow = {}
    for item in items:
        if item.get_closest_marker("study"):
            item.add_marker("slow")
        elif item.get_closest_marker("slow"):
            slow[item.path] = slow.get(item.path, 0) + 1
    items.sort(key=lambda item: -slow.get(item.path, 0))


@pytest.fixture(autouse=True, scope="module")
def forget_programs():
    """After a file of tests, forget compiled programs where there are too many; those still wanted are on the disk."""
    yield
    from ddetumble import _settings

    _settings.forget_programs()
