"""Universal files: functions at nodes (data set 58), as modal analysis writes them."""

from pathlib import Path
from typing import cast

import numpy as np

from ..._errors import InputError
from ..units import parse_unit
from .channel import Channel, make_channels


TIME_RESPONSE = (0, 1)  # function types of the standard: general, and time response
TIME = 17  # type of an abscissa of the standard


def read_uff(path: Path) -> list[Channel]:
    """A channel for every function over time, named by its first line of description."""
    import pyuff

    if not path.read_bytes().rstrip().endswith(b"-1"):
        raise InputError("the file is cut off or is no universal file: its last data set does not end with -1")
    file = pyuff.UFF(str(path))
    found = []
    for i, kind in enumerate(file.get_set_types()):
        if int(kind) != 58:
            continue
        one = cast(dict, file.read_sets(i))
        name = _read_text(one, "id1") or _read_text(one, "ordinate_axis_lab") or f"function {i + 1}"
        unit, x, values = _read_text(one, "ordinate_axis_units_lab"), np.asarray(one["x"]), np.asarray(one["data"])
        problem = ""
        if one["func_type"] not in TIME_RESPONSE or one["abscissa_spec_data_type"] not in (0, TIME):
            problem = "it is no function of time; export the time response"
        elif not len(x) == len(values) == one["num_pts"]:
            problem = f"it holds {len(values)} values and should hold {one['num_pts']}; export the file again"
        clock = parse_unit(_read_text(one, "abscissa_axis_units_lab") or "s").convert(x)
        found += [Channel(name, np.empty(0), unit, "", x, problem)] if problem else make_channels(
            name, values, unit, "", clock)
    return found


def _read_text(one: dict, key: str) -> str | None:
    text = str(one.get(key) or "").strip()
    return None if text.upper() in ("", "NONE") else text
