"""The printed tables and figures of the paper, read from the data packages that come with the toolkit."""

from pathlib import Path

import numpy as np

from .. import _settings
from .._errors import InputError


def find_data(name: str) -> Path:
    """Folder of a shipped data package, such as `paper/table-3`."""
    folder = _settings.find_data() / name
    if not folder.is_dir():
        raise InputError(f"there is no shipped data package {name!r}; the installation is incomplete", file=folder)
    return folder


def read_errors(name: str) -> np.ndarray:
    """Errors that the paper prints in `table-3` or `table-4`, shape (11,) [%]."""
    import pandas as pd

    return pd.read_csv(find_data(f"paper/{name}") / "errors.csv")["printed_error"].to_numpy(float)
