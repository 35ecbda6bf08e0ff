"""Python files of the user's own: effects, reference models and kinds of tests, each named `FILE.py:NAME`."""

import hashlib
import os
import sys
import types
from pathlib import Path

from ._errors import InputError


def split_name(text: str) -> tuple[Path, str] | None:
    """File and name of `FILE.py:NAME`; None for a text of another form."""
    file, colon, name = str(text).rpartition(":")
    return (Path(file), name) if colon and file.endswith(".py") else None


def run_file(path: Path) -> types.ModuleType:
    """The module that a file makes; the same text is run once only, and a file that is imported already not again.

    Raises:
        InputError: The file cannot be read, or it fails.
    """
    try:
        source = path.read_bytes()
    except OSError as error:
        raise InputError(f"the file cannot be read ({error.strerror or error})", file=path) from None
    digest = hashlib.sha256(source + str(path.resolve()).encode()).hexdigest()[:12]
    name = f"ddetumble_user_{path.stem}_{digest}"
    if name in sys.modules:
        return sys.modules[name]
    for module in list(sys.modules.values()):
        file = getattr(module, "__dict__", {}).get("__file__")
        if isinstance(file, str) and os.path.basename(file) == path.name and Path(file).resolve() == path.resolve() \
                and not module.__name__.startswith("ddetumble_user_"):
            return module  # its classes would not be those of a second run
    module = types.ModuleType(name)
    module.__file__ = str(path.resolve())
    sys.modules[name] = module  # dataclasses look their module up there
    try:
        exec(compile(source, str(path), "exec"), module.__dict__)
    except Exception as error:
        del sys.modules[name]
        line = getattr(error, "lineno", None)
        raise InputError(f"the file cannot be run: {type(error).__name__}: {error}", file=path, row=line) from error
    return module


def place_file(file: Path, folder: Path) -> str:
    """Path of a file as it is written down in a folder: from that folder on, with forward slashes."""
    try:
        return Path(os.path.relpath(file.resolve(), folder.resolve())).as_posix()
    except ValueError:  # another drive
        return file.resolve().as_posix()
