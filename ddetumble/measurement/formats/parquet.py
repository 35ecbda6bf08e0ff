"""Parquet: one table, with units in the metadata of its fields."""

from pathlib import Path

import numpy as np

from ..._settings import refuse_memory
from .channel import Channel, make_channels


def read_parquet(path: Path) -> list[Channel]:
    """Channels of the columns; nulls are missing samples."""
    import pyarrow as pa
    from pyarrow import parquet

    with parquet.ParquetFile(path) as file:
        refuse_memory(16.0 * file.metadata.num_rows * file.metadata.num_columns, f"reading {path}")
        table = file.read()
    found = []
    for field, column in zip(table.schema, table.columns, strict=True):
        about = field.metadata or {}
        unit = about.get(b"units", about.get(b"unit", b"")).decode("utf-8", "replace")
        if pa.types.is_dictionary(field.type):
            column = column.cast(field.type.value_type)
        if pa.types.is_decimal(column.type):
            column = column.cast(pa.float64())
        if pa.types.is_string(column.type) or pa.types.is_large_string(column.type):
            values = np.array([cell or "" for cell in column.to_pylist()], dtype=object)
        else:
            values = column.to_numpy()
            if pa.types.is_boolean(column.type) and column.null_count:
                values = values.astype(float)
        found += make_channels(field.name, values, unit)
    return found
