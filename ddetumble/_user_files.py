"""Python files of the user's own: effects, reference models and kinds of tests, each named `FILE.py:NAME`.

A file that the user names is run. One that a campaign or a saved model names is run only if the user named it before,
at the same place or with the same content: data that came from elsewhere run nothing.
"""

import hashlib
import os
import shlex
import sys
import types
from contextlib import suppress
from pathlib import Path

from ._errors import InputError


TRUST = "DDETUMBLE_TRUST"  # names the file that lists what may be run


def split_name(text: str) -> tuple[Path, str] | None:
    """File and name of `FILE.py:NAME`; None for a text of another form."""
    file, colon, name = str(text).rpartition(":")
    return (Path(file), name) if colon and file.endswith(".py") else None


def run_file(path: Path) -> types.ModuleType:
    """The module that a file makes; the same text is run once only, and a file that is imported already not again.

    Raises:
        InputError: The file cannot be read, or it fails.
    """
    source = _read(path)
    digest = hashlib.sha256(source + str(path.resolve()).encode()).hexdigest()[:12]
    name = f"ddetumble_user_{path.stem}_{digest}"
    trust_file(path)
    if name in sys.modules:
        return sys.modules[name]
    for module in list(sys.modules.values()):
        file = getattr(module, "__dict__", {}).get("__file__")
        if (isinstance(file, str) and os.path.basename(file) == path.name and Path(file).resolve() == path.resolve()
                and not module.__name__.startswith("ddetumble_user_")):
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


def find_trusted() -> Path:
    """The file that lists SHA-256 and path of what the user named: DDETUMBLE_TRUST, or in the user's data folder."""
    if os.environ.get(TRUST):
        return Path(os.environ[TRUST])
    import platformdirs

    return Path(platformdirs.user_data_dir("ddetumble", appauthor=False)) / "trusted.txt"


def trust_file(path: Path) -> None:
    """From now on campaigns and saved models that name this file may run it, and copies of what it is now.

    Raises:
        InputError: The file cannot be read.
    """
    line = f"{hashlib.sha256(_read(path)).hexdigest()} {path.resolve()}"
    if line in _list_lines():
        return
    _TRUSTED.add(line)
    store = find_trusted()
    with suppress(OSError):  # a read-only home: the file is trusted as long as this process runs
        store.parent.mkdir(parents=True, exist_ok=True)
        with store.open("a", encoding="utf-8") as lines:
            lines.write(f"{line}\n")


def require_trust(path: Path, named_by: Path | None = None) -> None:
    """Refuse to run a file that only data name.

    Args:
        path: of the Python file.
        named_by: the file or folder that names it; None where the caller says so.

    Raises:
        InputError: The user has never named the file.
    """
    if not path.is_file():
        return
    digest, place = hashlib.sha256(_read(path)).hexdigest(), str(path.resolve())
    if not any(line.startswith(digest) or line.partition(" ")[2] == place for line in _list_lines()):
        raise InputError(f"it names the Python file {path}, which would be run, but which you have never named "
                         f"yourself; read it and, if it may be run, enter: ddetumble trust {shlex.quote(str(path))}",
                         file=named_by)


_TRUSTED: set[str] = set()  # of this process, whether or not they could be written down


def _list_lines() -> set[str]:
    """What is trusted, a line each: SHA-256 and path."""
    try:
        return _TRUSTED | set(find_trusted().read_text(encoding="utf-8").splitlines())
    except (OSError, UnicodeDecodeError):
        return _TRUSTED


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"the file cannot be read ({error.strerror or error})", file=path) from None


def place_file(file: Path, folder: Path) -> str:
    """Path of a file as it is written down in a folder: from that folder on, with forward slashes."""
    try:
        return Path(os.path.relpath(file.resolve(), folder.resolve())).as_posix()
    except ValueError:  # another drive
        return file.resolve().as_posix()
