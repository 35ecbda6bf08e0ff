"""`import.toml`: an import as a file that can be kept with the data, with the names of the options."""

import difflib
from collections.abc import Collection
from pathlib import Path
from typing import Any

from .._errors import InputError
from .._user_files import split_name
from .kinds import take_kind
from .recordings import split_sheet
from .tables import read_toml


RAW, GAUGE = "raw", "gauge"
SEVERAL = {"known", "keep", "units", "uncertainty", "common_uncertainty", "cut", "reverse", "zero", "describe"}


def read_import_file(path, names: Collection[str]) -> dict[str, Any]:
    """The arguments of an import, by name, as a file says them; paths in it count from its folder on.

    Args:
        path: Of the file: the key `raw` with a file or a list of them (`*` stands for any text), and the options.
        names: Of the arguments there are.

    Raises:
        InputError: The file cannot be read, or a key or value is none that an import takes.
    """
    path = Path(path)
    given = read_toml(path)
    for key, value in given.items():
        near = difflib.get_close_matches(key, [RAW, *names], n=1)
        if key != RAW and key not in names:
            raise InputError(f"there is no such key; {f'did you mean {near[0]}?' if near else 'it may be '}"
                             + ("" if near else ", ".join([RAW, *sorted(names)])), file=path, key=key)
        given[key] = _read_value(value, key, path)
    patterns = given.pop(RAW, None)
    if not patterns:
        raise InputError('the file names no raw files; add them, such as raw = ["run*.tdms"]', file=path, key=RAW)
    files: list[Path] = []
    for pattern in [patterns] if isinstance(patterns, str) else patterns:
        found = [Path(pattern)] if Path(pattern).is_absolute() else sorted(path.parent.glob(pattern))
        if not found:
            raise InputError(f"there is no file {pattern!r} beside this one", file=path, key=RAW)
        files += found
    if "conditions" in given:
        table, sheet = split_sheet(path.parent / given["conditions"])
        given["conditions"] = f"{table}:{sheet}" if sheet else table
    if split_name(given.get("family", "")) is not None:
        given["family"] = take_kind(given["family"], path.parent)
    return {"paths": files} | given


def _read_value(value: Any, key: str, path: Path) -> Any:
    """A value as the option takes it: a text, texts by name or in a row, or whether pressures are gauge pressures."""
    several = value if isinstance(value, list) else [*value.values()] if isinstance(value, dict) else None
    plain = all(isinstance(one, str | int | float) and not isinstance(one, bool) for one in several or [value])
    if key == GAUGE and isinstance(value, bool):
        return value
    if key == GAUGE or not plain or several is not None and not (
            key in SEVERAL or key == RAW and isinstance(value, list)):
        wanted = "true or false" if key == GAUGE else "a text" + ", or a list or table of texts" * (key in SEVERAL)
        raise InputError(f"the value must be {wanted}", file=path, key=key)
    if isinstance(value, dict):
        return {name: str(one) for name, one in value.items()}
    return [*map(str, value)] if isinstance(value, list) else str(value)
