"""Tumbling records on one footing: time from each record's start, and body z along the axis of symmetry."""

import re

from .._errors import InputError
from .alignment import RawTest


def start_clocks(tests: list[RawTest], notes: list[str]) -> None:
    """Count the time of each record from its first sample, in place; the rates there are what a fit starts from."""
    begun = {test.key: float(test.values["time"][0]) for test in tests if len(test.values["time"])}
    moved = {key: time for key, time in begun.items() if time != 0.0}
    for test in tests:
        if test.key in moved:
            test.values["time"] = test.values["time"] - moved[test.key]
    if moved:
        first = next(iter(moved))
        more = f" (and likewise in {len(moved) - 1} more)" if len(moved) > 1 else ""
        notes.append(f"Time counts from the first sample of each record: {moved[first]:g} s was taken off in record "
                     f"{first}{more}.")


def turn_axes(tests: list[RawTest], axis: str | None, notes: list[str]) -> None:
    """Make the axis of symmetry body z by a cyclic exchange of the axes, which keeps them right-handed, in place.

    Args:
        tests: The tests, with rates `angular_velocity_x|y|z` and perhaps the attitude.
        axis: Name of the axis in the laboratory's columns; None for z.
        notes: Gains what was decided.

    Raises:
        InputError: There is no such axis.
    """
    if axis is None:
        notes.append("The body's axis of symmetry is taken as z; --symmetry-axis x or y says otherwise.")
        return
    axis = str(axis).strip().lower()
    if axis not in ("x", "y", "z"):
        raise InputError(f"--symmetry-axis is x, y or z, not {axis!r}")
    if axis == "z":
        return
    order = {"x": "yzx", "y": "zxy"}[axis]  # old axes in the places of x, y and z
    for test in tests:
        old = dict(test.values)
        for name in old:
            stem, place = name[:-1], name[-1]
            if stem == "attitude_" and place in "123" and "attitude_0" in old:
                test.values[name] = old[stem + "123"["xyz".index(order["123".index(place)])]]
            elif re.fullmatch("(angular_velocity|attitude)_[xyz]", name):
                wanted = stem + order["xyz".index(place)]
                if wanted not in old:
                    raise InputError(f"--symmetry-axis {axis} needs all three axes, and there is no {wanted}",
                                     file=test.file)
                test.values[name] = old[wanted]
    notes.append(f"The body's axis of symmetry, {axis} in the raw files, was made z: x, y, z here are "
                 f"{', '.join(order)} there.")
