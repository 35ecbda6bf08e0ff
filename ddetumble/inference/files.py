"""Results as files: JSON written whole or not at all, with the versions and hashes that say where numbers come from."""

import dataclasses as dc
import hashlib
import json
import math
import os
import platform
from collections.abc import Mapping
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from .._errors import InputError


PACKAGES = ("ddetumble", "jax", "diffrax", "equinox", "optimistix", "numpy", "scipy")


def write_json(path: Path, content: Any) -> None:
    """Write a JSON file, whole or not at all; numbers that are not finite become null.

    Raises:
        InputError: It cannot be written.
    """
    text = json.dumps(make_plain(content), indent=1, ensure_ascii=False, allow_nan=False) + "\n"
    draft = path.with_name(f".{path.name}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        draft.write_text(text, encoding="utf-8")
        os.replace(draft, path)
    except OSError as error:
        raise InputError(f"the file cannot be written ({error.strerror or error})", file=path) from None
    finally:
        if draft.is_file():
            draft.unlink()


def make_plain(value: Any) -> Any:
    """Turn records, arrays and numpy numbers into what JSON can hold; numbers that are not finite become None."""
    if dc.is_dataclass(value) and not isinstance(value, type):
        return {f.name: make_plain(getattr(value, f.name)) for f in dc.fields(value)}
    if isinstance(value, Mapping):
        return {str(k): make_plain(v) for k, v in value.items()}
    if isinstance(value, np.ndarray):
        return make_plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return [make_plain(v) for v in value]
    if isinstance(value, np.generic):
        return make_plain(value.item())
    return None if isinstance(value, float) and not math.isfinite(value) else value


def list_versions() -> dict[str, str]:
    """Versions of Python and of the packages on which numbers depend."""
    found = {"python": platform.python_version()}
    for name in PACKAGES:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return found


def hash_file(path: Path) -> str:
    """SHA-256 of a file's bytes, hexadecimal."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def refuse_peaks(folder: Path) -> None:
    """Refuse a folder in which `discover` judged a campaign of peaks only.

    Raises:
        InputError: It is one: no model was fitted to a curve.
    """
    try:
        kind = json.loads((folder / "result.json").read_text(encoding="utf-8")).get("kind")
    except (OSError, ValueError, AttributeError, RecursionError):
        return
    if kind == "peaks":
        raise InputError("discover judged a campaign of peaks here, which leaves no fitted model to go on from; this "
                         "needs one with sampled records", file=folder)
