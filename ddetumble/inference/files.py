"""Results as files: JSON written whole or not at all, with the versions and hashes that say where numbers come from."""

import abc
import contextlib
import dataclasses as dc
import hashlib
import json
import math
import os
import platform
from collections.abc import Callable, Iterator, Mapping
from importlib import metadata
from pathlib import Path
from typing import Any, ClassVar, TypeVar, get_args

import filelock
import numpy as np
import pydantic

from .._display import AbstractPrinted
from .._errors import InputError, offer_names
from ..measurement.tables import read_toml


PACKAGES = ("ddetumble", "jax", "diffrax", "equinox", "optimistix", "numpy", "scipy")
Content = TypeVar("Content", bound=pydantic.BaseModel)


class Strict(pydantic.BaseModel):
    """A part of a file, which holds its fields and nothing else, and numbers that are finite."""

    model_config = pydantic.ConfigDict(extra="forbid", allow_inf_nan=False, frozen=True)


def write_whole(path: Path, write: Callable[[Path], object]) -> None:
    """Write a file whole or not at all: `write` makes a draft, which then takes its place."""
    draft = path.with_name(f".{path.name}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write(draft)
        os.replace(draft, path)
    except OSError as error:
        raise InputError(f"the file cannot be written ({error.strerror or error})", file=path) from None
    finally:
        if draft.is_file():
            draft.unlink()


def write_json(path: Path, content: Any) -> None:
    """Write a JSON file, whole or not at all; numbers that are not finite become null."""
    text = json.dumps(make_plain(content), indent=1, ensure_ascii=False, allow_nan=False) + "\n"
    write_whole(path, lambda draft: draft.write_text(text, encoding="utf-8"))


@contextlib.contextmanager
def hold_folder(folder: Path, busy: str) -> Iterator[None]:
    """Make a folder where there is none, and keep other processes out of it; where another one holds it, `busy` says
    so.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        held = filelock.FileLock(folder / ".lock", timeout=0).acquire()
    except filelock.Timeout:
        raise InputError(busy, file=folder) from None
    except OSError as error:
        raise InputError(f"the folder cannot be written ({error.strerror or error})", file=folder) from None
    try:
        yield
    finally:
        with contextlib.suppress(OSError):  # while it is held, or the file might be another's already; Windows keeps it
            (folder / ".lock").unlink()
        held.lock.release()


def claim_folder(path: Path, what: str, key: str, asked: Any, **more: Any) -> None:
    """Write into a file what a folder holds (`what`, such as `a chain`), or see that it holds the same already: what is
    `asked`, a record or a mapping that stands there as `key`, and a `schema` among the `more` that stands beside it.

    Raises:
        InputError: The folder holds something else, or the file is damaged.
    """
    content = make_plain({**more, key: asked})
    if not path.is_file():
        write_json(path, content)
        return
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        there, now = ({"schema": one.get("schema"), **one[key]} for one in (found, content))
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        raise InputError(f"this is not a description of {what}, or it is damaged; name another folder", file=path
                         ) from None
    different = []
    for name in sorted({*there, *now}):
        a, b = there.get(name), now.get(name)
        if a != b:
            short = all(len(str(x)) < 40 for x in (a, b))
            different.append(f"{name} is {a!r} there and {b!r} now" if short else f"{name} differs")
    if different:
        raise InputError(f"the folder contains {what} of something else: {'; '.join(different)}. Use the same "
                         "settings to continue, name another folder, or remove this one to start again", file=path)


def read_json(path: Path, schema: str, kind: type[Content], again: str) -> Content:
    """Content of a JSON file that the toolkit wrote, refused where it is damaged; `again` says what to do then."""
    try:
        content = json.loads(path.read_bytes().decode("utf-8"))
    except OSError as error:
        raise InputError(f"the file cannot be read ({error.strerror or error})", file=path) from None
    except (ValueError, RecursionError) as error:
        raise InputError(f"this is not a JSON file, or only part of one; {again}", file=path,
                         row=getattr(error, "lineno", None)) from None
    found = content.get("schema") if isinstance(content, dict) else None
    if found != schema:
        raise InputError(f"the schema is {found!r}; this version reads {schema!r}: {again}", file=path, key="schema")
    try:
        return kind.model_validate(content)
    except pydantic.ValidationError as error:
        first = error.errors()[0]
        reason = first["msg"].removeprefix("Value error, ")
        raise InputError(f"the file is damaged: {reason[:1].lower()}{reason[1:]}; {again}", file=path,
                         key=".".join(str(part) for part in first["loc"]) or None) from None


def read_settings(path: Path, kind: type[Content], arrange: Callable[[dict], dict] = dict,
                  sections: Mapping[str, str] | None = None) -> Content:
    """Content of a TOML file of settings, of a `kind` whose field `schema_` states the schema; `arrange` puts what was
    read into its form. `sections` are tables whose keys are names that a user chooses, with what has to stand there. A
    file that says something that is not understood is refused for all its faults, each with its key.
    """
    content = read_toml(path)
    (schema,) = get_args(kind.model_fields["schema_"].annotation)
    if "schema" not in content:
        raise InputError(f'is missing; begin the file with schema = "{schema}"', file=path, key="schema")
    if content["schema"] != schema:
        raise InputError(f"the schema must be {schema!r}; it is {content['schema']!r}", file=path, key="schema")
    return check_settings(kind, arrange(content), path, sections)


def check_settings(kind: type[Content], content: dict, path: Path | None = None,
                   sections: Mapping[str, str] | None = None) -> Content:
    """Settings of a `kind` from what a file of them would hold; refused for all faults, each with its key."""
    sections = sections or {}
    try:
        return kind.model_validate(content)
    except pydantic.ValidationError as error:
        faults: dict[str, str] = {}
        for fault in sorted(error.errors(), key=lambda one: one["type"] != "extra_forbidden"):  # why others are missing
            place, message = fault["loc"], fault["msg"].removeprefix("Value error, ")
            strange = fault["type"] == "extra_forbidden"
            section = bool(place) and place[0] in sections and not strange
            if strange:
                keys = _list_keys(kind, place[:-1])
                message = f"this is not a key here; {offer_names(str(place[-1]), keys, 'the keys are')}"
            elif fault["type"] == "missing" and place and isinstance(place[-1], int):
                place, message = place[:-1], f"value {place[-1] + 1} is missing"
            elif fault["type"] == "missing":
                message = "is missing"
            elif fault["type"] in ("tuple_type", "list_type"):
                message = "takes several values, in square brackets"
            elif fault["type"] == "too_long":
                sizes = fault.get("ctx", {})
                message = f"takes {sizes.get('max_length')} values, not {sizes.get('actual_length')}"
            elif section:
                message = sections[str(place[0])]
            key = ".".join(str(part) for part in place[:2 if section else None] if part not in ("float", "int"))
            faults.setdefault(key, f"{message[:1].lower()}{message[1:200]}")
        (key, problem), *others = faults.items()
        raise InputError("; ".join((problem, *map(": ".join, others))), file=path, key=key or None) from None


def _list_keys(table: type[pydantic.BaseModel], place: tuple) -> list[str]:
    """Keys that the table at a place in this one may have."""
    for part in place:
        if part in table.model_fields:  # else the name of one of many alike
            kinds = (table.model_fields[part].annotation, *get_args(table.model_fields[part].annotation))
            table = next((kind for kind in kinds if isinstance(kind, type) and issubclass(kind, pydantic.BaseModel)),
                         table)
    return [field.alias or name for name, field in table.model_fields.items()]


class AbstractWritten(AbstractPrinted):
    """A result that is printed, and written as one JSON file."""

    file: ClassVar[str]  # its name

    @abc.abstractmethod
    def to_dict(self) -> dict[str, Any]:
        """What the file holds, as plain data."""

    def save(self, folder: str | Path) -> Path:
        """Write the file into a folder (made if it is not there); returns its path."""
        path = Path(folder) / self.file
        write_json(path, self.to_dict())
        return path


def check_folder(folder: str | Path, what: str) -> Path:
    """The folder that a result is to be written into; refused where it is a file."""
    folder = Path(folder)
    if folder.exists() and not folder.is_dir():
        raise InputError(f"this is a file; name a folder for the {what}", file=folder)
    return folder


def list_fields(record: Any, *left_out: str) -> dict[str, Any]:
    """Fields of a record by name, but for some."""
    return {f.name: getattr(record, f.name) for f in dc.fields(record) if f.name not in left_out}


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
        with contextlib.suppress(metadata.PackageNotFoundError):  # the toolkit itself may run from a folder
            found[name] = metadata.version(name)
    return found


def hash_file(path: Path) -> str:
    """SHA-256 of a file's bytes, hexadecimal."""
    return hashlib.sha256(path.read_bytes()).hexdigest()
