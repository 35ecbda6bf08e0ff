"""A chain on disk: blocks of steps, each a file that is there whole or not at all, written by one process at a time."""

import hashlib
import io
import json
import os
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import filelock
import numpy as np

from .._errors import InputError
from ..inference.files import make_plain, write_json


SCHEMA = "ddetumble.chain/2"
PLAN, START = "chain.json", "start.npz"


class ChainFolder:
    """The folder of one chain; a context manager that holds the lock.

    Attributes:
        path: of the folder.
        blocks: how many there are.
    """

    def __init__(self, path: Path, identity: Mapping[str, Any]):
        self.path, self.identity = Path(path), make_plain(identity)
        self.blocks = 0
        self._lock = filelock.FileLock(self.path / ".lock", timeout=0)

    def __enter__(self) -> "ChainFolder":
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            self._lock.acquire()
        except filelock.Timeout:
            raise InputError("another process is sampling into this folder; wait for it, or name another folder",
                             file=self.path) from None
        except OSError as error:
            raise InputError(f"the folder cannot be written ({error.strerror or error})", file=self.path) from None
        try:
            self._open()
        except BaseException:
            self._lock.release()
            raise
        return self

    def __exit__(self, *_) -> None:
        self._lock.release()

    def _open(self) -> None:
        for part in self.path.glob(".*.part"):  # a write that was cut off
            part.unlink(missing_ok=True)
        plan = self.path / PLAN
        if not plan.is_file():
            for old in self.path.glob("block-*.npz"):  # without its plan nobody knows what it is of
                raise InputError("the folder holds blocks of a chain without its plan; remove them, or name another "
                                 "folder", file=old)
            write_json(plan, {"schema": SCHEMA, "identity": self.identity, "digest": digest(self.identity)})
            return
        try:
            found = json.loads(plan.read_text(encoding="utf-8"))
            there, schema = found["identity"], found["schema"]
        except (OSError, ValueError, KeyError, TypeError):
            raise InputError("this is no plan of a chain; remove the folder, or name another", file=plan) from None
        if schema != SCHEMA:
            raise InputError(f"the chain is of another version ({schema}); name another folder", file=plan)
        different = _compare(there, self.identity)
        if different:
            raise InputError(f"the folder holds a chain of something else: {'; '.join(different)}. Name another "
                             "folder, or remove this one to begin again", file=plan)
        while self._place(self.blocks).is_file():
            self.blocks += 1

    def _place(self, number: int) -> Path:
        return self.path / f"block-{number:06d}.npz"

    def append(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Write the next block."""
        write_arrays(self._place(self.blocks), arrays)
        self.blocks += 1

    def read(self, number: int) -> dict[str, np.ndarray]:
        """One block."""
        return read_arrays(self._place(number))

    def keep(self, arrays: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """What the chain started from: written the first time, read back ever after."""
        path = self.path / START
        if not path.is_file():
            write_arrays(path, arrays)
        return read_arrays(path)


def digest(content: Any) -> str:
    """SHA-256 of plain data."""
    return hashlib.sha256(json.dumps(make_plain(content), sort_keys=True).encode()).hexdigest()


def write_arrays(path: Path, arrays: Mapping[str, np.ndarray]) -> None:
    """Write arrays into a file, whole or not at all, and on the disk before it returns.

    Raises:
        InputError: It cannot be written.
    """
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)  # pyright: ignore[reportArgumentType]
    draft = path.with_name(f".{path.name}.part")
    try:
        with open(draft, "wb") as file:
            file.write(buffer.getbuffer())
            file.flush()
            os.fsync(file.fileno())
        os.replace(draft, path)
        _sync(path.parent)
    except OSError as error:
        draft.unlink(missing_ok=True)
        raise InputError(f"the file cannot be written ({error.strerror or error})", file=path) from None


def _sync(folder: Path) -> None:
    """Bring a renaming to the disk, where the system can."""
    if not hasattr(os, "O_DIRECTORY"):
        return
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def read_arrays(path: Path) -> dict[str, np.ndarray]:
    """Arrays of a file; nothing in it is run.

    Raises:
        InputError: It is damaged.
    """
    try:
        with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as found:
            return {name: found[name] for name in found.files}
    except (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile):
        raise InputError("the block is damaged; remove it and those after it, and the chain goes on from there",
                         file=path) from None


def _compare(there: Any, here: Any) -> list[str]:
    """What differs between two plans, a phrase each."""
    if not isinstance(there, dict):
        return ["its plan cannot be read"]
    told = []
    for name in sorted({*there, *here}):
        a, b = there.get(name), here.get(name)
        if a != b:
            short = all(len(str(x)) < 40 for x in (a, b))
            told.append(f"{name} is {a!r} there and {b!r} now" if short else f"{name} differs")
    return told
