"""Where the data packages that come with the toolkit are."""

from pathlib import Path

from .. import _settings
from .._errors import InputError


def find_data(name: str) -> Path:
    """Folder of a shipped data package.

    Args:
        name: path below the data folder, such as `paper/table-3`.

    Raises:
        InputError: There is no such package.
    """
    folder = _settings.find_data() / name
    if not folder.is_dir():
        raise InputError(f"there is no shipped data package {name!r}; the installation is incomplete", file=folder)
    return folder
