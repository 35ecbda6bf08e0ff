"""What the numbers of a campaign must satisfy, whatever file they came from."""

import numpy as np

from .._errors import InputError
from .kinds import RecordKind
from .tables import Table
from .units import role_of, si_unit


PEAKS = ("peak_normal_force", "peak_friction_force")
FEWEST_SAMPLES = 5
# What ends the message on a negative pressure, of a campaign and of a laboratory's file.
PACKAGE_REMEDY = ('; mark the field "reference": "gauge" and state ambient_pressure in known if the gauge counts from '
                  "the ambient")
IMPORT_REMEDY = "; give --gauge and --ambient if it counts from the ambient"
OPPOSED = -0.5  # share of the work of a friction below which it counts against the slip
_POSITIVE = {
    "approach_speed", "slip_speed", "normal_load", "peak_normal_force", "peak_friction_force", "outer_diameter",
    "inner_diameter", "wall_thickness", "effective_mass", "tangential_mass", "rolling_mass",
    "creep_speed", "inertia_ratio", "ambient_pressure", "tensile_strength",
    "real_contact_pressure", "elastic_modulus", "composite_modulus", "pad_thickness",
}  # fmt: skip
_NOT_NEGATIVE = {"initial_pressure", "internal_pressure", "restitution", "temperature"}
_COUNTS = {"sequence", "repeats"}


def check_known(name: str, value: float | None) -> None:
    """Refuse a known parameter that no ball or body can have.

    Raises:
        InputError: Not positive where it must be, or a restitution above one.
    """
    if value is None:
        return
    if name in _POSITIVE and value <= 0:
        raise InputError(f"the value must be positive; it is {value:g} {si_unit(name)}")
    if name == "restitution" and not 0 < value <= 1:
        raise InputError(f"restitution lies above 0 and at most at 1; it is {value:g}")


def check_keys(keys: list[str], table: Table) -> None:
    """Refuse a record key that is empty or cannot be printed."""
    for key, line in zip(keys, table.lines, strict=True):
        if not key or not key.isprintable():
            problem = "the record key holds control characters" if key else "the record key is empty"
            raise InputError(f"{problem}; name the test", file=table.file, column="record", row=line)


def check_finite(values: np.ndarray, table: Table, column: str) -> None:
    """Refuse numbers that overflow in SI units; missing values (NaN) pass."""
    _refuse(np.isinf(values), table, column, lambda i: "the number is too large in SI units; check number and unit")


def check_values(name: str, values: np.ndarray, table: Table, resource: str, uncertainty,
                 remedy: str = PACKAGE_REMEDY) -> None:
    """Refuse values that the quantity of that name cannot have; `values` in SI, shape (rows,).

    The message on a negative pressure ends with `remedy`.

    Raises:
        InputError: Zero or negative speeds, loads and peaks, pressures below vacuum (sampled ones by more than six
            standard deviations), counts that are no whole numbers from 1 on.
    """
    shown = si_unit(name)
    if name in _COUNTS:
        bad = (values < 1) | (values != np.round(values))
        _refuse(bad, table, name, lambda i: f"must be a whole number from 1 on; it is {values[i]:g}")
    elif resource != "samples" and name in _POSITIVE:
        _refuse(values <= 0, table, name, lambda i: f"must be positive; it is {values[i]:g} {shown} in SI units")
    elif resource != "samples" and name in _NOT_NEGATIVE or name == "pressure":
        slack = 6 * uncertainty.sd(values) if name == "pressure" and uncertainty else 0.0
        hint = remedy if role_of(name) == "pressure" else ""
        kind = "an absolute pressure cannot be" if role_of(name) == "pressure" else "cannot be"
        _refuse(values < -slack, table, name, lambda i: f"{kind} negative; it is {values[i]:g} {shown} in SI{hint}")


def check_samples(samples, keys: list[str], kind: RecordKind, descriptor: str) -> str:
    """Check the samples of all records and return the name of the independent variable.

    Args:
        samples: The table as numbers: `table`, `keys`, `columns`, `values`.
        keys: Keys of the records.
        kind: Of the campaign's records.
        descriptor: File to name where a column is absent.

    Raises:
        InputError: No independent variable or channel, an unknown record, unsorted or repeated abscissae, a channel
            or record without values, fewer than five samples a record, or friction that counts against the slip in all.
    """
    independent = _pick_independent(samples, kind, descriptor)
    channels = [name for name in samples.columns if name != independent]
    if not set(kind.channels) & set(channels):
        problem = f"resource samples of the family {kind.name} needs at least one of {', '.join(kind.channels)}"
        raise InputError(problem, file=descriptor)
    codes = _link(samples, keys)
    x = samples.values[independent]
    present = np.zeros(len(x), dtype=bool)
    for name in channels:
        filled = ~np.isnan(samples.values[name])
        present |= filled
        if not filled.any():
            raise InputError("the channel has no value at all; remove it", file=samples.table.file, column=name)
    order = np.argsort(codes, kind="stable")
    lines = samples.table.lines[order]
    backward = np.flatnonzero((np.diff(codes[order]) == 0) & ~(np.diff(x[order]) > 0))
    if backward.size:
        i = backward[0]
        key, before, now = samples.keys[order[i + 1]], x[order[i]], x[order[i + 1]]
        what = "is there twice" if before == now else f"goes back from {before:g} to {now:g} {si_unit(independent)}"
        remedy = "sort the samples of each record and keep each abscissa once"
        if independent != "time":
            remedy = f"for reversed strokes give a time column, with {independent} as a channel"
        problem = f"within record {key!r} the {independent} {what}; {remedy}"
        raise InputError(problem, file=samples.table.file, column=independent, row=lines[i + 1])
    if kind.path in samples.columns and kind.main in channels:
        _check_sign(samples, keys, codes, kind)
    counts = np.bincount(codes[present], minlength=len(keys))
    used = np.bincount(codes, minlength=len(keys)) > 0
    for i in np.flatnonzero(used & (counts < FEWEST_SAMPLES)):
        problem = f"record {keys[i]!r} has only {counts[i]} samples with a value; at least {FEWEST_SAMPLES} are needed"
        line = samples.table.lines[codes == i][-1]
        raise InputError(problem, file=samples.table.file, column="record", row=line)
    return independent


def share_work(slip: np.ndarray, force: np.ndarray) -> float:
    """Work of the friction over that of its amount: 1 where it counts positive along the slip, -1 where negative.

    Args:
        slip: Position, shape (samples,) [m]; NaN is left out.
        force: Friction, shape (samples,) [N]; NaN is left out.
    """
    there = np.isfinite(slip) & np.isfinite(force)
    step, mean = np.diff(slip[there]), 0.5 * (force[there][1:] + force[there][:-1])
    amount = float(np.sum(np.abs(mean * step)))
    return float(np.sum(mean * step)) / amount if amount > 0 else 0.0


def check_peaks(peaks, keys: list[str]) -> None:
    """Check the table of peaks: one row a record, with a measured peak in each.

    Raises:
        InputError: No peak column, a row without a peak, an unknown record or one that is there twice.
    """
    names = [name for name in PEAKS if name in peaks.columns]
    if not names:
        raise InputError(f"there is no column {' or '.join(PEAKS)}; add what was measured", file=peaks.table.file)
    codes = _link(peaks, keys)
    first = dict(zip(codes[::-1], range(len(codes) - 1, -1, -1), strict=True))
    for i, code in enumerate(codes):
        if first[code] != i:
            problem = f"record {peaks.keys[i]!r} has a row already; give one row a record, with repeats for a mean"
            raise InputError(problem, file=peaks.table.file, column="record", row=peaks.table.lines[i])
    empty = np.all([np.isnan(peaks.values[name]) for name in names], axis=0)
    _refuse(empty, peaks.table, names[0], lambda i: "the row holds no measured peak; fill it in or remove the row")


def check_coverage(records, samples, peaks) -> None:
    """Refuse a record for which nothing was measured."""
    measured = {key for table in (samples, peaks) if table is not None for key in table.keys}
    for key, line in zip(records.keys, records.table.lines, strict=True):
        if key not in measured:
            problem = f"record {key!r} has no samples or peak; add them or remove the record"
            raise InputError(problem, file=records.table.file, column="record", row=line)


def _check_sign(samples, keys: list[str], codes: np.ndarray, kind: RecordKind) -> None:
    """Refuse friction that counts negative along the slip in all records: any model would have it drive the motion.

    Where only some do, the force may hold more than friction, such as a pressure on the rod of a seal.
    """
    slip, force = samples.values[kind.path], samples.values[kind.main]
    if all(share_work(slip[codes == i], force[codes == i]) < OPPOSED for i in range(len(keys))):
        problem = "the friction is negative where the slip grows; it counts positive along the slip: turn the sign of "
        raise InputError(f"{problem}the column", file=samples.table.file, column=kind.main)


def _pick_independent(samples, kind: RecordKind, descriptor: str) -> str:
    name = next((name for name in kind.independents if name in samples.columns), None)
    if name is None:
        wanted = " or ".join(kind.independents)
        raise InputError(f"resource samples needs the column {wanted}; add it with its unit", file=descriptor)
    missing = np.isnan(samples.values[name])
    _refuse(missing, samples.table, name, lambda i: "the cell is empty; every sample needs its abscissa")
    return name


def _link(table, keys: list[str]) -> np.ndarray:
    """Position of each row's record among `keys`; an unknown one is refused."""
    position = {key: i for i, key in enumerate(keys)}
    codes = np.array([position.get(key, -1) for key in table.keys])
    _refuse(
        codes < 0,
        table.table,
        "record",
        lambda i: f"the record {table.keys[i]!r} is not in the records table; add it there or correct the key",
    )
    return codes


def _refuse(bad: np.ndarray, table: Table, column: str, explain) -> None:
    """Raise for the first bad row, if there is one."""
    if np.any(bad):
        i = int(np.flatnonzero(bad)[0])
        raise InputError(explain(i), file=table.file, column=column, row=table.lines[i])
