"""Settings for all tests: 64-bit floats, one cache of compiled programs, figures without a screen, fixed examples."""

import os
from pathlib import Path

import hypothesis


ROOT = Path(__file__).resolve().parent.parent

# Read by JAX and matplotlib when they are imported, here and in the processes that tests start.
os.environ["JAX_ENABLE_X64"] = "1"
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(ROOT / ".cache" / "jax"))
os.environ["MPLBACKEND"] = "Agg"
os.environ.setdefault("MPLCONFIGDIR", str(ROOT / ".cache" / "matplotlib"))

hypothesis.settings.register_profile("fixed", derandomize=True, deadline=None, print_blob=True)
hypothesis.settings.load_profile("fixed")
