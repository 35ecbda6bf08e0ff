"""HDF5 and what is built on it: NeXus, netCDF, and MATLAB's .mat of version 7.3; that of version 5 by SciPy."""

from pathlib import Path

import numpy as np

from ..._settings import refuse_memory
from ..units import parse_unit
from .channel import Channel, make_channels


def read_hdf5(path: Path) -> list[Channel]:
    """Channels of the data sets of a file, each with its attribute `units`; links to other files are not followed.

    A group of the class NXlog is one channel with a clock of its own.
    """
    import h5py

    if path.suffix.lower() == ".mat" and not h5py.is_hdf5(path):
        return _read_matlab(path)
    with h5py.File(path, "r") as file:
        sets: dict[str, h5py.Dataset] = {}
        logs: set[str] = set()

        def visit(name: str, item) -> None:
            if name.startswith("#"):  # what MATLAB keeps for itself
                return
            if isinstance(item, h5py.Dataset):
                sets[name] = item
            elif _read_text(item, "NX_class") == "NXlog" and {"time", "value"} <= set(item):
                logs.add(name)

        file.visititems(visit)
        refuse_memory(16.0 * sum(item.size or 0 for item in sets.values()), f"reading {path}")
        found = []
        for name, item in sets.items():
            group, _, own = name.rpartition("/")
            if group not in logs:
                found += _read_set(file, item, own, group)
            elif own == "value":
                time = sets[f"{group}/time"]
                clock = parse_unit(_read_text(time, "units") or "s").convert(np.ravel(_read_numbers(time)))
                above, _, own = group.rpartition("/")
                found += make_channels(own, _read_numbers(item), _read_text(item, "units"), above, clock)
        return found


def _read_set(file, item, name: str, group: str) -> list[Channel]:
    unit = _read_text(item, "units") or _read_text(item, "unit")
    if not item.shape and item.dtype.kind not in "fiub" or not item.size or unit is None and _is_text(item):
        return []
    if item.external or item.is_virtual:
        problem = "its values are in another file; copy them into this one"
        return [Channel(name, np.empty(0), unit, group, problem=problem)]
    if item.dtype.names:
        table = item[()]
        return [channel for own in item.dtype.names
                for channel in make_channels(own, table[own], None, f"{group}/{name}".strip("/"))]
    if "MATLAB_class" not in item.attrs:
        return make_channels(name, _read_numbers(item), unit, group)
    sibling = next((other for other in (f"{group}/{name}_unit", f"{group}/{name}_units", f"{group}/units/{name}")
                    if _is_text(file.get(other))), None)
    if sibling is not None:
        unit = "".join(map(chr, np.ravel(file[sibling][()])))
    values = item[()].T if item.dtype.kind in "fiub" else item[()]  # MATLAB stores columns first
    return make_channels(name, values, unit, group)


def _is_text(item) -> bool:
    """Whether a data set is a text of MATLAB's."""
    return item is not None and _read_text(item, "MATLAB_class") == "char"


def _read_numbers(item) -> np.ndarray:
    """Values of a data set, unpacked and with missing ones as NaN where its attributes say so (netCDF's rule)."""
    import h5py

    if item.dtype.kind not in "fiub":
        return np.asarray(item[()] if h5py.check_string_dtype(item.dtype) is None else item.asstr()[()])
    values, attributes = item[()], item.attrs
    if not {"_FillValue", "scale_factor", "add_offset"} & set(attributes):
        return values
    missing = values == attributes["_FillValue"] if "_FillValue" in attributes else False
    values = values * np.ravel(attributes.get("scale_factor", 1.0))[0] + np.ravel(attributes.get("add_offset", 0.0))[0]
    return np.where(missing, np.nan, values)


def _read_text(item, name: str) -> str | None:
    """An attribute as text, or None where it is none."""
    value = item.attrs.get(name)
    value = value.flat[0] if isinstance(value, np.ndarray) and value.size == 1 else value
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else value if isinstance(value, str) else None


def _read_matlab(path: Path) -> list[Channel]:
    """Channels of the variables of a file; a structure is a group, and so is each element of an array of structures.

    The unit of `Fz` is the text in a variable `Fz_unit`, or in the field `Fz` of a structure `units`.
    """
    from scipy import io

    sizes = [np.prod(shape, dtype=float) for _, shape, _ in io.whosmat(str(path))]
    refuse_memory(16.0 * sum(sizes), f"reading {path}")
    return _walk_variables(io.loadmat(str(path), simplify_cells=True), "")


def _walk_variables(tree: dict, group: str) -> list[Channel]:
    units, found = tree.get("units"), []
    for name, value in tree.items():
        inner = f"{group}/{name}" if group else name
        if isinstance(value, dict):
            found += _walk_variables(value, inner) if value is not units else []
        elif isinstance(value, list) and value and all(isinstance(one, dict) for one in value):
            found += [channel for i, one in enumerate(value, 1) for channel in _walk_variables(one, f"{inner}({i})")]
        elif not name.startswith("__") and not name.endswith(("_unit", "_units")):
            unit = next((text for text in (tree.get(f"{name}_unit"), tree.get(f"{name}_units"),
                                           units.get(name) if isinstance(units, dict) else None)
                         if isinstance(text, str)), None)
            found += make_channels(name, value, unit, group)
    return found
