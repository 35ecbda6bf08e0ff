"""Friction records on one footing: friction counts positive along the slip, and one load and pressure a record."""

import numpy as np

from .._errors import InputError
from .alignment import RawTest
from .checks import share_work
from .units import si_unit


DOUBT = 0.2  # share of the work above which a record's sign is beyond doubt
STEADY = 0.1  # relative standard deviation up to which a measured load counts as one load


def turn_friction(tests: list[RawTest], notes: list[str]) -> None:
    """Make friction count positive along the slip, in place.

    Raises:
        InputError: Records of both signs.
    """
    shares = [share_work(test.values["slip"], test.values["tangential_force"]) for test in tests]
    against = [test for test, share in zip(tests, shares, strict=True) if share < -DOUBT]
    along = [test for test, share in zip(tests, shares, strict=True) if share > DOUBT]
    if against and along:
        problem = f"the friction of record {against[0].key!r} counts negative along the slip and that of record "
        problem += f"{along[0].key!r} positive; export all alike"
        raise InputError(problem, file=against[0].file)
    if against:
        for test in tests:
            test.values["tangential_force"] = -test.values["tangential_force"]
        notes.append("The friction counts negative along the slip in the raw files; its sign was turned.")


def take_means(tests: list[RawTest], name: str, headings: dict[str, str]) -> dict[str, float]:
    """Mean over each record of what was measured along it [SI].

    Args:
        tests: The tests; they lose the quantity.
        name: `normal_load` or `pressure`.
        headings: Quantity to its heading.

    Raises:
        InputError: It is not steady within a record.
    """
    means = {}
    for test in tests:
        values = test.values.pop(name)
        values = values[np.isfinite(values)]
        means[test.key] = mean = float(values.mean()) if len(values) else float("nan")
        spread = float(values.std()) / abs(mean) if mean else float("inf")
        if not spread < STEADY:
            shown = f"{values.min():.4g} to {values.max():.4g} {si_unit(name)}" if len(values) else "no value at all"
            problem = f"{name} changes too much within record {test.key!r} ({shown}) to be one condition; cut the "
            problem += "record to where it is steady, or give the nominal value as a condition and rename this column"
            raise InputError(problem, file=test.file, column=headings.get(name))
    return means
