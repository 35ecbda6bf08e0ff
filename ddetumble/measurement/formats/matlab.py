"""MATLAB's .mat files: version 5 by SciPy, 7.3 as the HDF5 file that it is."""

from pathlib import Path

import numpy as np

from ..._settings import refuse_memory
from .channel import Channel, make_channels
from .hdf5 import read_hdf5


def read_matlab(path: Path) -> list[Channel]:
    """Channels of the variables of a file; a structure is a group, and so is each element of an array of structures.

    The unit of `Fz` is the text in a variable `Fz_unit`, or in the field `Fz` of a structure `units`.
    """
    import h5py
    from scipy import io

    if h5py.is_hdf5(path):
        return read_hdf5(path)
    sizes = [np.prod(shape, dtype=float) for _, shape, _ in io.whosmat(str(path))]
    refuse_memory(16.0 * sum(sizes), f"reading {path}")
    return _walk(io.loadmat(str(path), simplify_cells=True), "")


def _walk(tree: dict, group: str) -> list[Channel]:
    units, found = tree.get("units"), []
    for name, value in tree.items():
        inner = f"{group}/{name}" if group else name
        if isinstance(value, dict):
            found += _walk(value, inner) if value is not units else []
        elif isinstance(value, list) and value and all(isinstance(one, dict) for one in value):
            found += [channel for i, one in enumerate(value, 1) for channel in _walk(one, f"{inner}({i})")]
        elif not name.startswith("__") and not name.endswith(("_unit", "_units")):
            unit = next((text for text in (tree.get(f"{name}_unit"), tree.get(f"{name}_units"),
                                           units.get(name) if isinstance(units, dict) else None)
                         if isinstance(text, str)), None)
            found += make_channels(name, value, unit, group)
    return found
