"""Tables of others as the studies read them: columns that have to be there, and numbers in them."""

from collections.abc import Collection
from pathlib import Path

import numpy as np
import pandas as pd

from ddetumble import InputError


def read_columns(folder: Path, name: str, columns: Collection[str], *, words: Collection[str] = (),
                 gaps: Collection[str] = ()) -> pd.DataFrame:
    """A CSV file of a folder.

    Args:
        folder: that holds it.
        name: of the file.
        columns: that it has to have.
        words: those of them that hold text.
        gaps: those that may be empty.

    Raises:
        InputError: There is no such file or column, a number is none, or a cell is empty.
    """
    path = Path(folder) / name
    if not path.is_file():
        raise InputError(f"there is no such file; name the folder that holds {name}", file=path)
    try:
        table = pd.read_csv(path)
    except (OSError, ValueError) as error:
        raise InputError(f"the file cannot be read as a table: {error}", file=path) from None
    for column in columns:
        if column not in table:
            raise InputError(f"there is no such column; the file needs {', '.join(columns)}", file=path, column=column)
        values = table[column] if column in words else pd.to_numeric(table[column], errors="coerce")
        wrong = values.isna() & (table[column].notna() if column in gaps else True)
        if wrong.any():
            raise InputError("is empty" if column in words else "is no number", file=path, column=column,
                             row=int(np.argmax(wrong)) + 2)
        table[column] = values
    return table
