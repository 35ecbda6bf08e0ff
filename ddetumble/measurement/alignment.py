"""Put the raw traces of impacts on one footing: contact at time nought, no offsets, force positive."""

import math
from dataclasses import dataclass

import numpy as np

from .._errors import InputError
from .checks import FEWEST_SAMPLES
from .onset import FEWEST_BEFORE, Onset, find_onset
from .units import parse_quantity, si_unit


@dataclass
class RawTest:
    """One test on its way into a campaign.

    Args:
        key: Its record key.
        file: The raw file it came from.
        lines: Line number of each sample, shape (samples,).
        values: Samples by quantity [SI], each of shape (samples,).
    """

    key: str
    file: str
    lines: np.ndarray
    values: dict[str, np.ndarray]


def align_tests(tests, sources, onset, notes):
    """Turn the force positive, move contact to time nought, and take the offsets off, in place.

    Args:
        tests: The tests, with `time` [s] and `normal_force` [N].
        sources: Conditions found so far; gains `initial_pressure` where only the pressure channel tells it.
        onset: Value of --onset, or None to find each test's own.
        notes: Gains what was decided.

    Returns:
        Standard deviation before contact by channel [SI], where every test shows it, and that of the time origin [s].

    Raises:
        InputError: Time that does not increase, forces of both signs, or no onset to be found.
    """
    _turn_positive(tests, notes)
    times = _given_onsets(tests, sources, onset, notes)
    found, squares, before = [], {}, {}
    for test in tests:
        t, f = test.values["time"], test.values["normal_force"]
        check_increase(test)
        if times is None:
            try:
                contact = find_onset(t, f)
            except InputError as error:
                raise InputError(f"record {test.key!r}: {error.problem}", file=test.file) from None
        else:
            contact = Onset(times[test.key], math.nan, math.nan, 0.0, math.nan, int(np.sum(t < times[test.key])))
        found.append(contact)
        test.values["time"] = t - contact.time
        calm = test.values["time"] < 0
        shown = []
        for name, values in list(test.values.items()):
            quiet = values[calm][~np.isnan(values[calm])] if name != "time" else np.empty(0)
            if quiet.size < FEWEST_BEFORE:
                continue
            squares.setdefault(name, []).append(float(np.var(quiet, ddof=1)))
            if name in ("normal_force", "tangential_force", "depression"):
                if name == "depression":
                    _check_flat(test, t[calm & ~np.isnan(values)], quiet)
                if abs(quiet.mean()) > 3 * quiet.std(ddof=1) / math.sqrt(quiet.size):  # else it would only add noise
                    test.values[name] = values - quiet.mean()
                    shown.append(f"{name} {quiet.mean():.4g} {si_unit(name)}")
            if name == "pressure":
                before[test.key] = float(quiet.mean())
        error = "" if math.isnan(contact.sd) else f" ± {contact.sd * 1e3:.3g} ms"
        offset = f"offsets taken off: {', '.join(shown)}" if shown else "no offset to take off"
        shown = f"{contact.time * 1e3:.6g} ms{error}"
        notes.append(f"Record {test.key}: contact at {shown} of the raw time; {offset}.")
    if "initial_pressure" not in sources.values and len(before) == len(tests):
        sources.add("initial_pressure", before, "Pa", "the pressure channel")
        notes.append("initial_pressure is the mean of the pressure channel before contact.")
    spreads = {name: math.sqrt(float(np.mean(v))) for name, v in squares.items() if len(v) == len(tests)}
    if times is None:
        clock = math.sqrt(float(np.mean([contact.sd**2 for contact in found])))
    else:
        clock = float(np.median([np.median(np.diff(test.values["time"])) for test in tests])) / math.sqrt(12)
        notes.append(f"The time origin was given; its uncertainty is that of the sampling, {clock * 1e3:.3g} ms.")
    return spreads, clock


def _turn_positive(tests, notes) -> None:
    signs = []
    for test in tests:
        f = test.values["normal_force"]
        f = f[~np.isnan(f)]
        middle = np.median(f[: max(5, len(f) // 20)]) if f.size else 0.0
        signs.append(bool(f.size) and middle - f.min() > 1.5 * (f.max() - middle))
    if any(signs) and not all(signs):
        test = tests[signs.index(not signs[0])]
        raise InputError("the force has another sign than in the records before; export all alike", file=test.file)
    if all(signs):
        for test in tests:
            test.values["normal_force"] = -test.values["normal_force"]
        notes.append("The force counts compression as negative in the raw files; its sign was turned.")


def _given_onsets(tests, sources, onset, notes) -> dict[str, float] | None:
    """Onset by record from --onset or the table of conditions, or None."""
    table = sources.values.pop("onset", None)
    if onset is None:
        if table:
            notes.append("The contact onset was read from the column onset of the table of conditions.")
        return table
    if isinstance(onset, int | float) or str(onset).strip() in ("0", "0.0"):
        return dict.fromkeys((test.key for test in tests), float(onset))
    if str(onset) == "onset" and table:
        return table
    if str(onset) in sources.values:
        if sources.units[onset] != "s":
            raise InputError(f"--onset: the column {onset!r} is not a time")
        return sources.values.pop(onset)
    try:
        return dict.fromkeys((test.key for test in tests), parse_quantity(onset, "time"))
    except InputError as error:
        problem = f"--onset is a time like '12.5 ms', or a column of the table of conditions: {error.problem}"
        raise InputError(problem) from None


def check_increase(test: "RawTest", name: str = "time") -> None:
    """Refuse a test whose abscissa does not increase throughout, or with too few samples."""
    back = np.flatnonzero(~(np.diff(test.values[name]) > 0))
    if back.size:
        problem = f"the {name} of record {test.key!r} does not increase here; sort the rows, keep each once, "
        problem += "or tell the tests in the file apart with --record-column"
        problem += "; for strokes back and forth, export the time too" if name == "slip" else ""
        raise InputError(problem, file=test.file, column=name, row=int(test.lines[back[0] + 1]))
    if len(test.lines) < FEWEST_SAMPLES:
        raise InputError(f"record {test.key!r} has fewer than {FEWEST_SAMPLES} samples", file=test.file)


def _check_flat(test: RawTest, t, quiet) -> None:
    """Refuse a depression that moves before contact: it is the arm's position."""
    x = t - t.mean()
    slope = float(x @ quiet) / float(x @ x)
    residual = quiet - quiet.mean() - slope * x
    error = math.sqrt(float(residual @ residual) / max(len(x) - 2, 1) / float(x @ x))
    if abs(slope) > 6 * error and abs(slope) * np.ptp(t) > 1e-9:
        problem = f"the depression of record {test.key!r} moves before contact, like the arm's position; rename its "
        raise InputError(problem + "heading so that it is left out, or export the depression", file=test.file)
