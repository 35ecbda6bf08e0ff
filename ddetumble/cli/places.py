"""Where commands read from and write to: found, and made ready, before the work starts."""

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from .._errors import InputError
from .._settings import find_data


if TYPE_CHECKING:
    import pandas as pd


def locate_campaign(text: str) -> Path:
    """Path of a campaign: as given, or, where there is nothing, of the shipped campaign of that name."""
    path = Path(text)
    if path.exists() or path.is_absolute():
        return path
    shipped = find_data() / path
    if not (shipped / "datapackage.json").is_file():
        near = [name for name in list_shipped() if name.rpartition("/")[2] == text.strip("/")]
        if near:
            problem = f"there is no such folder; did you mean {near[0]}, which comes with the toolkit?"
            raise InputError(problem, file=text)
        names = ", ".join(list_shipped())
        raise InputError(f"there is no such folder, and no such campaign comes with the toolkit ({names})", file=text)
    print(f"ddetumble: note: {text} is the campaign that comes with the toolkit.", file=sys.stderr)
    return shipped


def list_shipped() -> list[str]:
    """Names of the campaigns that come with the toolkit."""
    data = find_data()
    return sorted(path.parent.relative_to(data).as_posix() for path in data.glob("**/records.csv"))


def prepare_folder(path: Path) -> Path:
    """Make an output folder before the work, so that a wrong name costs no time."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except FileExistsError:
        raise InputError("is a file; -o takes a folder", file=path) from None
    except OSError as error:
        raise InputError(f"the folder cannot be made ({_reason(error)})", file=path) from None
    if not os.access(path, os.W_OK | os.X_OK):
        raise InputError("nothing can be written to this folder", file=path)
    return path


def prepare_file(path: Path | None) -> Path | None:
    """Make sure that an output file can be written, without touching one that is there; None is standard output."""
    if path is None or str(path) == "-":
        return None
    if path.is_dir():
        raise InputError("is a folder; -o takes a file here", file=path)
    prepare_folder(path.parent)
    return path


def write_table(table: "pd.DataFrame", path: Path | None) -> None:
    """Write a table as CSV, whole or not at all; to standard output where no file is named."""
    if path is None:
        table.to_csv(sys.stdout, index=False, lineterminator="\n")
        return
    draft = path.with_name(f".{path.name}.part")
    try:
        table.to_csv(draft, index=False, lineterminator="\n")
        os.replace(draft, path)
    finally:
        draft.unlink(missing_ok=True)


def _reason(error: OSError) -> str:
    return (error.strerror or type(error).__name__).lower()
