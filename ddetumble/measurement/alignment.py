"""Put the raw traces of impacts on one footing: contact at time nought, no offsets, force positive."""

import math
from dataclasses import dataclass

import numpy as np
from scipy import special

from .._errors import InputError
from .checks import FEWEST_SAMPLES
from .onset import FEWEST_BEFORE, Onsets, find_onsets
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
        Standard deviation before contact by channel [SI], where every test shows it; that of each record's time
        origin [s]; and by column the standard deviation of an error that all records share [SI].

    Raises:
        InputError: Time that does not increase, forces of both signs, or no onset to be found.
    """
    _turn_positive(tests, notes)
    for test in tests:
        check_increase(test)
    times = _given_onsets(tests, sources, onset, notes)
    if times is None:
        found = _find_onsets(tests, notes)
        contacts = [(float(time), f" ± {sd * 1e3:.3g} ms") for time, sd in zip(found.time, found.sd, strict=True)]
        clock = math.sqrt(float(np.mean(found.sd**2)))
        common = found.common_sd
    else:
        contacts = [(times[test.key], "") for test in tests]
        clock = float(np.median([np.median(np.diff(test.values["time"])) for test in tests])) / math.sqrt(12)
        common = None
        notes.append(f"The time origin was given; its uncertainty is that of the sampling, {clock * 1e3:.3g} ms.")
    squares, before, moving = {}, {}, []
    for test, (contact, error) in zip(tests, contacts, strict=True):
        test.values["time"] = t = test.values["time"] - contact
        calm, shown = t < 0, []
        for name, values in list(test.values.items()):
            there = calm & ~np.isnan(values)
            quiet = values[there] if name != "time" else np.empty(0)
            if quiet.size < FEWEST_BEFORE:
                continue
            squares.setdefault(name, []).append(float(np.var(quiet, ddof=1)))
            if name in ("normal_force", "tangential_force", "depression"):
                if name == "depression" and _find_slope(t[there], quiet):
                    moving.append(test)
                    continue
                offset = find_offset(quiet)
                if not offset:
                    continue
                test.values[name] = values - offset
                shown.append(f"{name} {offset:.4g} {si_unit(name)}")
            if name == "pressure":
                before[test.key] = float(quiet.mean())
        offset = f"offsets taken off: {', '.join(shown)}" if shown else "no offset to take off"
        notes.append(f"Record {test.key}: contact at {contact * 1e3:.6g} ms{error} of the raw time; {offset}.")
    if "initial_pressure" not in sources.values and len(before) == len(tests):
        sources.add("initial_pressure", before, "Pa", "the pressure channel")
        notes.append("initial_pressure is the mean of the pressure channel before contact.")
    shared = {} if common is None else {"time": common}
    if moving:
        squares["depression"], shared["depression"] = _zero_position(moving, tests, math.hypot(clock, common or 0.0))
        notes.append("The depression moves before contact, like the position of the arm: it is zero at the onset, and "
                     "what lies before contact and after separation was left out. Its zero shares the onsets' error, "
                     f"{shared['depression'] * 1e3:.3g} mm.")
    spreads = {name: math.sqrt(float(np.mean(v))) for name, v in squares.items() if len(v) == len(tests)}
    return spreads, clock, shared


def _find_onsets(tests, notes) -> Onsets:
    """Onsets of all tests, and in words what they share."""
    found = find_onsets([test.values["time"] for test in tests], [test.values["normal_force"] for test in tests],
                        [f"{test.file}: record {test.key!r}: " for test in tests])
    notes.append(f"All contact onsets share an uncertainty of {found.common_sd * 1e3:.3g} ms: how the force begins, "
                 "and the delay of the measuring chain, which the force itself does not show.")
    if found.start != "curved":
        how = "with a jump, as a dashpot's does" if found.start == "stepped" else "as a straight line, as a wall's does"
        notes.append(f"The force begins {how}, not as the square of time; the onsets were found accordingly.")
    if found.ringing is not None:
        frequency, damping = found.ringing
        notes.append(f"The force gauge rings at {frequency:.3g} Hz (damping ratio {damping:.2g}); the onsets allow for "
                     "it, but the samples still hold it, and it can look like missing physics.")
    return found


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
        problem += "; for strokes back and forth, export the time too" if name != "time" else ""
        raise InputError(problem, file=test.file, column=name, row=int(test.lines[back[0] + 1]))
    if len(test.lines) < FEWEST_SAMPLES:
        raise InputError(f"record {test.key!r} has fewer than {FEWEST_SAMPLES} samples", file=test.file)


def find_offset(quiet: np.ndarray) -> float:
    """Mean of readings at rest, shape (samples,); 0 where noise alone could do it, as to take it off would only add
    noise.
    """
    # Of few readings the deviation is itself uncertain: Student's t, at what three deviations of a Gaussian are.
    limit = special.stdtrit(quiet.size - 1, special.ndtr(3.0))
    offset = float(quiet.mean())
    return offset if abs(offset) > limit * quiet.std(ddof=1) / math.sqrt(quiet.size) else 0.0


def _find_slope(t, quiet) -> float:
    """Rate at which a channel moves before contact, 0 where noise alone could do it."""
    x = t - t.mean()
    slope = float(x @ quiet) / float(x @ x)
    residual = quiet - quiet.mean() - slope * x
    error = math.sqrt(float(residual @ residual) / max(len(x) - 2, 1) / float(x @ x))
    return slope if abs(slope) > 6 * error and abs(slope) * np.ptp(t) > 1e-9 else 0.0


def _zero_position(moving, tests, clock) -> tuple[list[float], float]:
    """Turn the arm's position into the depression, in place: zero at the onset, and only in contact.

    Returns:
        Variances about the straight approach [m²], and the standard deviation of the zero that all share [m].

    Raises:
        InputError: It moves in some records only, or does not turn back in contact: it is no depression.
    """
    if len(moving) < len(tests):
        other = next(test for test in tests if test not in moving)
        problem = f"the depression moves before contact in record {moving[0].key!r} and not in {other.key!r}"
        raise InputError(f"{problem}; export all alike", file=moving[0].file)
    zeros, slopes, variances = [], [], []
    for test in moving:
        t, x = test.values["time"], test.values["depression"]
        calm = (t < 0) & ~np.isnan(x)
        line = np.polynomial.Polynomial.fit(t[calm], x[calm], 1)
        slope, zero = float(line.deriv()(0.0)), float(line(0.0))
        sign = math.copysign(1.0, slope)
        pressed = np.where(t >= 0, sign * (x - zero), np.nan)
        if not np.isfinite(pressed).any() or np.nanargmax(pressed) >= np.flatnonzero(np.isfinite(pressed))[-1] - 2:
            problem = f"the depression of record {test.key!r} moves before contact and does not turn back: is it the "
            problem += "arm's position as commanded? Rename its heading to leave it out, or export the depression"
            raise InputError(problem, file=test.file)
        test.values["depression"] = sign * x
        zeros.append(sign * zero)
        slopes.append(abs(slope))
        variances.append(float(np.var(x[calm] - line(t[calm]), ddof=2)))
    error = clock * float(np.mean(slopes))
    if np.std(zeros) < 3.0 * error:  # one plate, where one sensor sees it
        zeros = [float(np.mean(zeros))] * len(zeros)
    for test, zero in zip(moving, zeros, strict=True):
        t, x = test.values["time"], test.values["depression"] - zero
        gone = np.flatnonzero((t > t[np.nanargmax(np.where(t > 0, x, np.nan))]) & (x < 0))
        inside = (t > 0) & (t < (t[gone[0]] if gone.size else np.inf))
        test.values["depression"] = np.where(inside, x, np.nan)
    return variances, error
