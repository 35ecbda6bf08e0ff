"""What the numbers of a campaign must satisfy, whatever file they came from.

`rows` is whatever says where numbers stand: it has the `file` and the `lines` of its rows.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd

from .._errors import InputError
from .kinds import RecordKind
from .units import NUMBER, parse_quantity, parse_unit, role_of, si_unit


PEAKS = ("peak_normal_force", "rebound_speed", "contact_time", "impulse", "peak_depression", "peak_friction_force")
LARGEST = 1e50  # in any unit: fourth powers of much larger numbers overflow
FEWEST_SAMPLES = 5  # of a record: below it no curve can be told from noise
GAUGE = ('; if these are gauge pressures, mark the field "reference": "gauge" and state ambient_pressure in known '
         "(for an import, give --gauge and --ambient)")
# Share of the work of a friction below which it counts against the slip: half of it backwards is no noise about zero.
OPPOSED = -0.5
PUSH = "normal_force"  # of a contact: it is positive where the ball is pressed on
_POSITIVE = {
    "approach_speed", "slip_speed", "normal_load", *PEAKS, "outer_diameter", "inner_diameter",
    "wall_thickness", "effective_mass", "tangential_mass", "rolling_mass",
    "creep_speed", "inertia_ratio", "ambient_pressure", "tensile_strength",
    "real_contact_pressure", "elastic_modulus", "composite_modulus", "pad_thickness",
}  # fmt: skip
_NOT_NEGATIVE = {"initial_pressure", "internal_pressure", "restitution", "temperature"}
COUNTS = ("sequence", "repeats")  # whole numbers, without a unit


class Rows(NamedTuple):
    """Rows of a file."""

    file: str
    lines: np.ndarray


def read_known(name: str, text: str | float, unit: str = "") -> float:
    """Read a known parameter with its unit; refused is one that no body can have: not positive where it must be, a
    restitution above one. `unit` is that of a parameter whose name does not say it. A bare zero is one in any unit,
    but for temperatures, whose scales differ in their zero.
    """
    bare = re.fullmatch(NUMBER, str(text).strip(), re.ASCII)
    if bare is not None and float(bare[0]) == 0 and not _is_temperature(name, unit):
        value = 0.0
    else:
        value = parse_quantity(text, name, unit)
    if name in _POSITIVE and value <= 0:
        raise InputError(f"the value must be positive; it is {value:g} {si_unit(name)}")
    if name == "restitution" and not 0 < value <= 1:
        raise InputError(f"the restitution must be above 0 and at most 1; it is {value:g}")
    return value


def unit_of_known(name: str, kind: RecordKind) -> str:
    """Unit in which a campaign keeps a known parameter: that of the reference models, or SI; "1" where none is told."""
    return si_unit(name) if role_of(name) else kind.parameters.get(name, "1")


def _is_temperature(name: str, unit: str) -> bool:
    """Whether a parameter of that name, or of that unit where the name does not say it, is a temperature."""
    if role_of(name) is not None:
        return role_of(name) == "temperature"
    try:
        return parse_unit(unit).dimension == parse_unit("K").dimension
    except InputError:  # such as N/m^q
        return False


def refuse_rows(bad, rows, column: str, explain: str | Callable[[int], str]) -> None:
    """Refuse the first row that is bad, if there is one, by its line; `explain` says what is wrong with it."""
    if np.any(bad):
        i = int(np.flatnonzero(bad)[0])
        raise InputError(explain if isinstance(explain, str) else explain(i), file=rows.file, column=column,
                         row=rows.lines[i])


def check_keys(keys: Sequence[str], rows, column: str = "record") -> None:
    """Refuse a record key that is empty or cannot be printed."""
    refuse_rows([not key for key in keys], rows, column, "the record key is empty; name the test")
    refuse_rows([not key.isprintable() for key in keys], rows, column,
                "the record key contains control characters; rename the test")


def refuse_large(values: np.ndarray, rows, column: str) -> None:
    """Refuse numbers with which nothing can be computed, as a damaged file may hold them; NaN passes."""
    refuse_rows(np.abs(values) > LARGEST, rows, column,
                "the number is too large in SI units; check the number and its unit")


def check_values(name: str, values: np.ndarray, rows, resource: str, uncertainty, column: str = "",
                 gauge: str = GAUGE) -> None:
    """Refuse values that the quantity of that name cannot have: numbers that overflow, zero or negative speeds, loads
    and peaks, pressures below vacuum (sampled ones by more than six standard deviations), counts that are no whole
    numbers from 1 on.

    `values` are SI, shape (rows,), NaN passes; `resource` is `records`, `samples` or `peaks`; `column` is the heading,
    where it is another than the name, `gauge` what the message on a negative pressure ends with.
    """
    column, hint = column or name, ""

    def refuse(bad, what):
        refuse_rows(bad, rows, column, lambda i: f"{what}; it is {values[i]:g} {si_unit(name)} in SI units{hint}")

    refuse_large(values, rows, column)
    if name in COUNTS:
        refuse((values < 1) | (values != np.round(values)), "must be a whole number from 1 upwards")
    elif resource != "samples" and name in _POSITIVE:
        refuse(values <= 0, "must be positive")
    elif resource != "samples" and name in _NOT_NEGATIVE or name == "pressure":
        pressed = role_of(name) == "pressure"
        hint = gauge if pressed else ""
        slack = 6 * uncertainty.sd(values) if name == "pressure" and uncertainty else 0.0
        refuse(values < -slack, "an absolute pressure cannot be negative" if pressed else "cannot be negative")


def check_record(key: str, values: Mapping[str, np.ndarray], independent: str, rows, remedy: str = "") -> None:
    """Refuse the samples of one record, by name, if they are too few or their abscissae do not increase.

    `rows` says where they stand, `remedy` what else may help where they do not increase.
    """
    x = values[independent]
    strokes = "" if independent == "time" else "; for strokes back and forth, give the time as well"

    def explain(i):
        before, now = x[i - 1], x[i]
        what = "occurs twice" if before == now else f"goes back from {before:g} to {now:g} {si_unit(independent)}"
        return (f"within record {key!r} the {independent} {what}; sort the rows of each record and keep each value "
                f"once{remedy}{strokes}")

    refuse_rows(np.diff(x, prepend=-np.inf) <= 0, rows, independent, explain)
    channels = [y for name, y in values.items() if name != independent]
    count = int(np.any(np.isfinite(channels), axis=0).sum()) if channels else 0
    if count < FEWEST_SAMPLES:
        problem = f"record {key!r} has only {count} samples with a value; at least {FEWEST_SAMPLES} are needed"
        raise InputError(problem, file=rows.file, column="record", row=rows.lines[-1] if len(rows.lines) else None)


def check_samples(samples, keys: Sequence[str], kind: RecordKind) -> str:
    """Check the samples of all records, a table with `keys` and `values` by name, and return the name of the abscissa.

    Raises:
        InputError: No independent variable or channel, an unknown record, unsorted or repeated abscissae, a channel
            or record without values, fewer than five samples a record, friction that counts against the slip in all,
            or contacts that pull in all.
    """
    independent = next((name for name in kind.independents if name in samples.values), None)
    if independent is None:
        raise InputError(f"resource samples needs the column {' or '.join(kind.independents)}; add it with its unit")
    if not set(kind.channels) & set(samples.values) - {independent}:
        raise InputError(f"resource samples of the family {kind.name} needs at least one of {', '.join(kind.channels)}")
    refuse_rows(np.isnan(samples.values[independent]), samples, independent,
                "the cell is empty; every sample needs its abscissa")
    for name, values in samples.values.items():
        refuse_rows([bool(np.isnan(values).all())], samples, name, "the channel has no value at all; remove it")
    shares = []
    for key, rows in _link(samples, keys).items():
        values = {name: x[rows] for name, x in samples.values.items()}
        check_record(key, values, independent, Rows(samples.file, samples.lines[rows]))
        if kind.path in values and kind.main in values:
            shares.append(share_work(values[kind.path], values[kind.main]))
        elif kind.main == PUSH and PUSH in values:
            after = values[independent] >= 0.0
            shares.append(share_work(values[independent][after], values[kind.main][after]))
    # Any model would have such friction drive the motion, and such a contact pull. Where only some records are so, the
    # force may hold more than friction, such as a pressure on the rod of a seal.
    if len(shares) == len(keys) and max(shares) < OPPOSED:
        wrong = ("the force of the contact is negative, but must be positive where the ball is pressed on"
                 if kind.main == PUSH else
                 "the friction is negative where the slip grows, but must be positive along the slip")
        raise InputError(f"{wrong}: reverse the sign of the column", file=samples.file, column=kind.main)
    return independent


def share_work(slip: np.ndarray, force: np.ndarray) -> float:
    """Work of the friction over that of its amount: 1 where it counts positive along the slip, -1 where negative.

    Position [m] and friction [N] have shape (samples,); NaN is left out.
    """
    there = np.isfinite(slip) & np.isfinite(force)
    step, mean = np.diff(slip[there]), 0.5 * (force[there][1:] + force[there][:-1])
    amount = float(np.sum(np.abs(mean * step)))
    return float(np.sum(mean * step)) / amount if amount > 0 else 0.0


def check_peaks(peaks, keys: Sequence[str]) -> None:
    """Refuse a table of peaks without a peak column, or with a row without a peak or of an unknown or repeated record.
    """
    names = [name for name in PEAKS if name in peaks.values]
    if not names:
        raise InputError(f"there is no column {' or '.join(PEAKS)}; add what was measured", file=peaks.file)
    check_unique(peaks, "give one row per record, with repeats for a mean")
    _link(peaks, keys)
    refuse_rows(np.all([np.isnan(peaks.values[name]) for name in names], axis=0), peaks, names[0],
                "the row has no measured peak; fill it in or remove the row")


def check_unique(rows, remedy: str) -> None:
    """Refuse a second row of one record."""
    refuse_rows(pd.Index(rows.keys).duplicated(), rows, "record", lambda i: (
        f"the record {rows.keys[i]!r} already has a row on line {rows.lines[rows.keys.index(rows.keys[i])]}; {remedy}"))


def _link(table, keys: Sequence[str]) -> dict[str, np.ndarray]:
    """Positions of the rows of each record; an unknown one is refused."""
    refuse_rows(~np.isin(table.keys, list(keys)), table, "record", lambda i: (
        f"the record {table.keys[i]!r} is not in the records table; add it there or correct the key"))
    return {str(key): rows for key, rows in pd.Series(table.keys).groupby(table.keys, sort=False).indices.items()}
