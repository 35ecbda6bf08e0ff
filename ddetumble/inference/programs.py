"""Programs kept from one process to the next as what JAX traces: tracing takes longer than the rest of a start.

JAX keeps compiled programs, but to find one it traces the Python code anew. Here the traced program (StableHLO, some
200 kB) stands in the same folder, under a name made of everything that it depends on: the code of the package, the
versions of what it is built on, the kind of model, and the shapes of the arrays. Models that hold a class of the user's
are traced in every process.
"""

import dataclasses as dc
import hashlib
import importlib.metadata
import sys
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import cache, wraps
from pathlib import Path
from types import FunctionType, MappingProxyType
from typing import Any

import equinox as eqx
import jax
from jax import export

from .._errors import InputError
from .._numerics import is_known
from .._settings import PROGRAM, find_platform, trim_heap
from .files import write_whole


BUILT_ON = ("jax", "jaxlib", "equinox", "optimistix", "lineax", "diffrax", "numpy")
OURS = {"ddetumble", *BUILT_ON}  # packages of whose classes and functions a name says all
PLAIN = (type(None), bool, int, float, str)
LIFE = 60 * 86400.0  # s after which a program is traced anew: those of older code would pile up for ever
_known: dict[tuple, Callable[..., Any]] = {}
_one = threading.RLock()  # a kept function may call another


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
            program = _known[key] = _prepare(function, static, name, like, arrays, f"{tree} {shapes}", platform)
    return program(*arrays)


def keep_program(like: Any) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Decorate a function as `equinox.filter_jit` does, its traced program kept from one process to the next.

    Its arguments are pytrees, given by position: arrays among their leaves are traced, all else is part of the program.
    Inside another transformation it is an ordinary jitted function, and where an argument holds a class, a function or
    an object that is not the package's own, nothing of it outlives the process.

    Args:
        like: a value with the structure of the result, whatever its leaves.
    """
    def decorate(function: Callable[..., Any]) -> Callable[..., Any]:
        def run(rest, tree, arrays):
            return function(*eqx.combine(arrays, jax.tree.unflatten(tree, rest)))

        run.__name__, run.__qualname__, run.__module__ = function.__name__, function.__qualname__, function.__module__
        compiled = jax.jit(run, static_argnums=(0, 1))

        @wraps(function)
        def call(*arguments):
            arrays, rest = eqx.partition(arguments, eqx.is_array)
            leaves, tree = jax.tree.flatten(rest)
            if not is_known(arrays):
                return compiled(tuple(leaves), tree, arrays)
            return call_kept(compiled, (tuple(leaves), tree), name_structure(arguments), like, arrays)

        return call

    return decorate


def name_structure(value: Any) -> str | None:
    """What a pytree is but for the arrays among its leaves, in words for other processes; None where it holds a class,
    a function or an object of a class that is not the package's own, and whose name says nothing of its code.
    """
    if eqx.is_array(value):
        return "array"
    if value is None or isinstance(value, bool | int | float | str):
        return repr(value) if type(value) in PLAIN else None
    if isinstance(value, type) or type(value) is FunctionType:
        return f"{value.__module__}.{value.__qualname__}" if is_ours(value) else None
    if isinstance(value, Mapping) and type(value) in (dict, MappingProxyType):
        parts = [(repr(key), name_structure(one)) for key, one in value.items()]
    elif type(value) in (tuple, list) or (isinstance(value, tuple) and is_ours(type(value))):
        parts = [("", name_structure(one)) for one in value]
    elif dc.is_dataclass(value) and is_ours(type(value)):  # an equinox module is one
        parts = [(field.name, name_structure(getattr(value, field.name, None))) for field in dc.fields(value)]
    else:
        return None
    if any(part is None for _, part in parts):
        return None
    return f"{type(value).__module__}.{type(value).__qualname__}({', '.join(f'{key}={part}' for key, part in parts)})"


def is_ours(kind: Any) -> bool:
    """Whether a class or function is of the package, or of what it is built on, and found by its name there: the same
    in every process of which code and versions are these."""
    module = sys.modules.get(kind.__module__)
    return kind.__module__.split(".")[0] in OURS and getattr(module, kind.__qualname__, None) is kind


def _prepare(function, static, name, like, arrays, form: str, platform: str) -> Callable[..., Any]:
    """The function with its static arguments: as kept, or traced now and kept; by itself where it cannot be kept."""
    def plain(*arrays):
        return function(*static, *arrays)

    folder = jax.config.jax_compilation_cache_dir  # pyright: ignore[reportAttributeAccessIssue]
    if name is None or folder is None:
        return plain
    trim_heap()  # what compiling the program before this one has left
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
