"""Programs kept from one process to the next as what JAX traces: tracing takes longer than the rest of a start.

JAX keeps compiled programs, but to find one it traces the Python code anew. Here the traced program (StableHLO, some
200 kB) stands in the same folder, under a name made of everything that it depends on: the code of the package, the
versions of what it is built on, the kind of model, and the shapes of the arrays. Models that hold a class of the user's
are traced in every process.
"""

import hashlib
import importlib.metadata
import re
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from functools import cache, partial, wraps
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jax import export
from jax.core import Tracer
from jax.tree_util import default_registry

from .._errors import InputError
from .._settings import PROGRAM, find_platform
from .files import write_whole


BUILT_ON = ("jax", "jaxlib", "equinox", "optimistix", "lineax", "diffrax", "numpy")
OURS = {"ddetumble", "builtins", "collections", *BUILT_ON}  # packages whose classes a name says all about
LIFE = 60 * 86400.0  # s after which a program is traced anew: those of older code would pile up for ever
_known: dict[tuple, Callable[..., Any]] = {}
_one = threading.Lock()


def call_kept(function: Callable[..., Any], static: tuple, name: str | None, like: Any, *arrays: Any) -> Any:
    """Result of a jitted function, from a program that an earlier process has traced where there is one.

    Args:
        function: jitted; its first arguments are static.
        static: these arguments, hashable.
        name: text that says in every process what the static arguments are; None keeps the program in this process.
        like: a value with the structure of the result, whatever its leaves.
        arrays: the other arguments, pytrees of arrays.
    """
    leaves, tree = jax.tree.flatten(arrays)
    shapes = tuple((x.shape, str(x.dtype)) for x in leaves)
    platform = find_platform()
    key = (function, static, tree, shapes, platform)
    with _one:  # two threads that want the same program trace it once
        program = _known.get(key)
        if program is None:
            program = _known[key] = _prepare(function, static, name, like, arrays, f"{tree} {shapes}",
                                                         platform)
    return program(*arrays)


def keep_program(like: Any) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Decorate a function as `equinox.filter_jit` does, its traced program kept from one process to the next.

    Its arguments are pytrees, given by position: arrays among their leaves are traced, all else is part of the program.
    Inside another transformation it is an ordinary jitted function, and where an argument holds a class or a function
    that is not the package's own, nothing of it outlives the process.

    Args:
        like: a value with the structure of the result, whatever its leaves.
    """
    def decorate(function: Callable[..., Any]) -> Callable[..., Any]:
        @partial(jax.jit, static_argnums=(0, 1))
        @wraps(function)
        def run(rest, tree, arrays):
            return function(*eqx.combine(arrays, jax.tree.unflatten(tree, rest)))

        @wraps(function)
        def call(*arguments):
            arrays, rest = eqx.partition(arguments, _is_array)
            static = jax.tree.flatten(rest)
            if any(isinstance(x, Tracer) for x in jax.tree.leaves(arrays)):
                return run(tuple(static[0]), static[1], arrays)
            return call_kept(run, (tuple(static[0]), static[1]), name_structure(arguments), like, arrays)

        return call

    return decorate


def name_structure(value: Any) -> str | None:
    """What a pytree is but for the arrays among its leaves, in words for other processes; None where it holds a class
    or a function that is not the package's own, or one that only this process knows.
    """
    text = f"{jax.tree.structure(value)} {[x for x in jax.tree.leaves(value) if not _is_array(x)]}"
    named = {name.split(".")[0] for name in re.findall(r"<(?:class|enum) '([^']+)'", text)}
    return None if named - OURS or " at 0x" in text or not _is_ours(value) else text


def _is_array(value: Any) -> bool:
    """Whether a leaf is traced."""
    return isinstance(value, jax.Array | np.ndarray | np.generic)


def _is_ours(value: Any) -> bool:
    """Whether all nodes of a pytree are of classes that the digest of the code and the versions cover."""
    if type(value).__module__.split(".")[0] not in OURS:
        return False
    below = default_registry.flatten_one_level(value)
    return below is None or all(map(_is_ours, below[0]))


def _prepare(function, static, name, like, arrays, form: str, platform: str) -> Callable[..., Any]:
    """The function with its static arguments: as kept, or traced now and kept; by itself where it cannot be kept."""
    def plain(*arrays):
        return function(*static, *arrays)

    folder = jax.config.jax_compilation_cache_dir  # pyright: ignore[reportAttributeAccessIssue]
    if name is None or folder is None:
        return plain
    text = "\n".join([identify_code(), platform, function.__module__, function.__qualname__, name, form])
    path = Path(folder) / f"{hashlib.sha256(text.encode()).hexdigest()}{PROGRAM}"
    kept = _read(path)
    if kept is None:
        tree = jax.tree.structure(arrays)
        flat = jax.jit(lambda *leaves: jax.tree.leaves(plain(*jax.tree.unflatten(tree, leaves))))
        try:
            kept = export.export(flat, platforms=[platform])(*jax.tree.leaves(arrays))
            data = kept.serialize()
        except (ValueError, NotImplementedError):  # what JAX cannot export, such as host callbacks
            return plain
        with suppress(OSError, InputError):  # a folder that cannot be written keeps nothing, and is no error
            write_whole(path, lambda draft: draft.write_bytes(data))
            for old in path.parent.glob(f"*{PROGRAM}"):
                if old.stat().st_mtime < time.time() - LIFE:
                    old.unlink(missing_ok=True)
    run, out = jax.jit(kept.call), jax.tree.structure(like)
    return lambda *arrays: jax.tree.unflatten(out, run(*jax.tree.leaves(arrays)))


def _read(path: Path) -> export.Exported | None:
    """A program that was kept; None where there is none, or none that can be read."""
    try:
        return export.deserialize(bytearray(path.read_bytes()))
    except FileNotFoundError:
        return None
    except Exception:  # half a file, of whatever kind of damage: traced anew and written again
        with suppress(OSError):  # a folder that cannot be written, or, on Windows, a file that another process reads
            path.unlink()
        return None


@cache
def identify_code() -> str:
    """Digest of the package's code and of the versions that its programs depend on."""
    package = Path(__file__).resolve().parent.parent
    digest = hashlib.sha256()
    for path in sorted(package.rglob("*.py")):
        digest.update(path.relative_to(package).as_posix().encode() + b"\0" + path.read_bytes())
    digest.update(" ".join(f"{one} {importlib.metadata.version(one)}" for one in BUILT_ON).encode())
    return digest.hexdigest()
