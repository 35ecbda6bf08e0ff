"""Raw records on one footing: first what a laboratory says is to be done to them (signs, zeros, cropping, cutting).

Impacts: contact at time nought, no offsets, force positive. Friction: positive along the slip, one load and pressure a
record. Tumbling: time from each record's start, body z along the axis of symmetry.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy import special, stats

from .._errors import InputError, error_place
from .checks import FEWEST_SAMPLES, share_work
from .columns import Plan, read_pairs
from .kinds import ORDERS, turn_name
from .onset import FEWEST_BEFORE, Onsets, find_onsets
from .quantities import format_estimate
from .units import parse_quantity, si_unit


# Share of the work above which the sign of a record's friction is beyond doubt: less may be an offset of the gauge.
DOUBT = 0.2
# Relative standard deviation up to which a measured load counts as one load: more changes the friction visibly.
STEADY = 0.1
# Deviations of the onset within which a sample of a moving channel may be one of the approach.
NEAR = 3.0
CUT = ("level", "before", "after")
FEW = 4  # records that are told one by one
NO_OFFSET = "no offset subtracted"


@dataclass
class RawTest:
    """One test on its way into a campaign."""

    key: str
    file: str
    lines: np.ndarray  # line number of each sample, shape (samples,)
    values: dict[str, np.ndarray]  # samples by quantity [SI], each of shape (samples,)


def reverse_signs(tests: list[RawTest], names, plan: Plan) -> None:
    """Reverse the sign of channels, in place."""
    for name in [names] if isinstance(names, str) else names or ():
        channel = plan.find_quantity(name)
        for test in tests:
            _find_channel(test, channel, "--reverse")
            test.values[channel] = -test.values[channel]
        plan.notes.append(f"The sign of {channel} was reversed, as --reverse says.")


def subtract_zeros(tests: list[RawTest], windows, plan: Plan) -> None:
    """Take from each record of a channel its mean over a window of the raw time, in place: NAME=START to END."""
    for name, text in read_pairs("zero", windows).items():
        channel = plan.find_quantity(name)
        start, end = _read_window(text, f"--zero {name}")
        for test in tests:
            values = _find_channel(test, channel, "--zero")
            quiet = values[(test.values["time"] >= start) & (test.values["time"] <= end) & np.isfinite(values)]
            if len(quiet) < FEWEST_SAMPLES:
                problem = f"record {test.key!r} has {len(quiet)} samples of {channel} from {text}; name a longer window"
                raise InputError(problem, file=test.file, option="--zero")
            test.values[channel] = values - quiet.mean()
            plan.notes.append(f"Record {test.key}: the mean from {text}, {quiet.mean():.4g} {si_unit(channel)}, was "
                              f"subtracted from {channel}.")


def crop_records(tests: list[RawTest], window: str | None, plan: Plan) -> None:
    """Keep the samples of a window of the raw time only, in place."""
    if window is None:
        return
    start, end = _read_window(window, "--crop")
    for test in tests:
        time = _find_channel(test, "time", "--crop")
        _keep(test, (time >= start) & (time <= end), "--crop", window)
    plan.notes.append(f"Samples outside {window} of the raw time were left out, as --crop says.")


def cut_records(tests: list[RawTest], given, plan: Plan) -> list[RawTest]:
    """Cut recordings of many contacts into one record each, as `given` says: `level` of the main channel above its
    median that begins a contact, and the time to keep `before` and `after` that.
    """
    if not given:
        return tests
    pairs = read_pairs("cut", given)
    if set(pairs) != set(CUT) or not plan.kind.main:
        raise InputError(f"it takes {', '.join(f'{name}=QUANTITY' for name in CUT)}, of kinds of tests with a force",
                         option="--cut")
    with error_place(option="--cut"):
        level, before, after = (parse_quantity(pairs[name], quantity) for name, quantity in
                                zip(CUT, (plan.kind.main, "time", "time"), strict=True))
        if min(level, before, after) <= 0:
            raise InputError(f"{', '.join(CUT)} must be positive")
    found = []
    for test in tests:
        time, force = _find_channel(test, "time", "--cut"), test.values[plan.kind.main]
        above = np.flatnonzero(np.abs(force - np.nanmedian(force)) >= level)
        starts = [float(time[i]) for i in above[:1]]
        for t in time[above]:
            if t > starts[-1] + after:
                starts.append(float(t))
        if not starts:
            problem = f"{plan.kind.main} never leaves its median by {pairs['level']}; lower the level"
            raise InputError(problem, file=test.file, option="--cut")
        for first, second in zip(starts[:-1], starts[1:], strict=True):
            if second - first < before + after:
                problem = f"the contacts at {first:.6g} s and {second:.6g} s are closer than before and after together"
                raise InputError(f"{problem}; shorten them", file=test.file, option="--cut")
        whole = [t for t in starts if t - before >= time[0] and t + after <= time[-1]]
        for i, t in enumerate(whole, 1):
            part = RawTest(f"{test.key}-{i}", test.file, test.lines, dict(test.values))
            _keep(part, (time >= t - before) & (time <= t + after), "--cut", f"{t - before:g} s to {t + after:g} s")
            found.append(part)
        left = f"; {len(starts) - len(whole)} at its ends are not whole and were left out" * (len(whole) < len(starts))
        plan.notes.append(f"{Path(test.file).name}: {len(whole)} contacts were cut out, at "
                          f"{', '.join(f'{t:.6g}' for t in whole)} s of the raw time{left}.")
    return found


def _keep(test: RawTest, rows: np.ndarray, option: str, window: str) -> None:
    if rows.sum() < FEWEST_SAMPLES:
        raise InputError(f"record {test.key!r} has only {rows.sum()} samples from {window}; at least {FEWEST_SAMPLES} "
                         "are needed", file=test.file, option=option)
    test.lines, test.values = test.lines[rows], {name: values[rows] for name, values in test.values.items()}


def _find_channel(test: RawTest, name: str, option: str) -> np.ndarray:
    missing = next((one for one in (name, "time") if one not in test.values), None)
    if missing is not None:
        raise InputError(f"there is no {missing}; the records have {', '.join(test.values)}", file=test.file,
                         option=option)
    return test.values[name]


def _read_window(text: str, option: str) -> tuple[float, float]:
    start, word, end = str(text).partition(" to ")
    with error_place(option=option):
        if not word:
            raise InputError(f"{text!r} is no window; write it like '0 ms to 20 ms'")
        first, last = parse_quantity(start.strip(), "time"), parse_quantity(end.strip(), "time")
        if not first < last:
            raise InputError(f"the window {text!r} ends before it begins")
    return first, last


def align_tests(tests: list[RawTest], plan: Plan, onset) -> tuple[dict[str, float], dict[str, float]]:
    """Turn the force of impacts positive, move contact to time nought, and take the offsets off, in place.

    The plan gains `initial_pressure` where only the pressure channel tells it; `onset` is the value of --onset.

    Returns:
        By column [SI]: the standard deviation before contact, where every test shows it, and that of each record's time
        origin; and the standard deviation of an error that all records share.
    """
    notes = plan.notes
    signs = []
    for test in tests:
        f = test.values["normal_force"]
        f = f[~np.isnan(f)]
        middle = np.median(f[: max(5, len(f) // 20)]) if f.size else 0.0
        signs.append(-1.0 if f.size and middle - f.min() > 1.5 * (f.max() - middle) else 1.0)
    _turn_sign(tests, "normal_force", signs, "while pressing", notes)
    times, common = _given_onsets(tests, plan, onset), 0.0
    if times is None:
        found = _find_onsets(tests, notes)
        contacts = list(zip(map(float, found.time), map(float, found.sd), strict=True))
        clock, common = math.sqrt(float(np.mean(found.sd**2))), found.common_sd
    else:
        contacts = [(times[test.key], 0.0) for test in tests]
        clock = float(np.median([np.median(np.diff(
            test.values["time"][np.isfinite(test.values["normal_force"])])) for test in tests])) / math.sqrt(12)
        notes.append("The time origin was given.")
    squares, before, moving = {}, {}, []
    offsets: dict[str, dict[str, float]] = {test.key: {} for test in tests}
    for test, (start, _) in zip(tests, contacts, strict=True):
        test.values["time"] = t = test.values["time"] - start
        for name, values in list(test.values.items()):
            calm = (t < 0) & ~np.isnan(values)
            quiet = values[calm]
            if name == "time" or quiet.size < FEWEST_BEFORE:
                continue
            squares.setdefault(name, []).append(float(np.var(quiet, ddof=1)))
            if name == "pressure":
                before[test.key] = float(quiet.mean())
            elif name == "depression" and _is_moving(t[calm], quiet):
                moving.append(test)
            elif name in ("normal_force", "tangential_force", "depression"):
                offset = find_offset(quiet)
                if offset:
                    test.values[name] = values - offset
                    offsets[test.key][name] = offset
    notes += _tell_contacts({test.key: one for test, one in zip(tests, contacts, strict=True)}, offsets)
    if "initial_pressure" not in plan.conditions and len(before) == len(tests):
        plan.add("initial_pressure", before, "Pa", "the pressure channel")
        notes.append("initial_pressure is the mean of the pressure channel before contact.")
    shared = {} if times is not None else {"time": common}
    if moving:
        squares["depression"], shared["depression"] = _zero_position(moving, tests, math.hypot(clock, common))
        notes.append("The depression moves before contact, as the position of the arm does: it was set to zero at the "
                     "onset, and samples before contact, within three deviations of the onset and after separation "
                     "were left out. The error of its zero is that of the onsets, "
                     f"{shared['depression'] * 1e3:.3g} mm.")
    spreads = {name: math.sqrt(float(np.mean(v))) for name, v in squares.items() if len(v) == len(tests)}
    return spreads | {"time": clock}, shared


def _tell_contacts(contacts: Mapping[str, tuple[float, float]], offsets: Mapping[str, Mapping[str, float]]
                   ) -> list[str]:
    """When contact begins, with its standard deviation [s], and what was subtracted, by record; of many in sum."""
    def tell(key: str) -> str:
        time, sd = contacts[key]
        when = format_estimate(1e3 * time, 1e3 * sd, "ms") if sd else f"{time * 1e3:.6g} ms"
        shown = ", ".join(f"{name} {offset:.4g} {si_unit(name)}" for name, offset in offsets[key].items())
        return f"contact begins at {when} of the raw time; {f'offsets subtracted: {shown}' if shown else NO_OFFSET}."

    told = {key: tell(key) for key in contacts}
    if len(told) > 1 and len(set(told.values())) == 1:
        return [f"In every record {next(iter(told.values()))}"]
    if len(told) <= FEW:
        return [f"Record {key}: {text}" for key, text in told.items()]
    first, last = (pick(contacts, key=lambda key: contacts[key][0]) for pick in (min, max))
    surest, least = (1e3 * pick(sd for _, sd in contacts.values()) for pick in (min, max))
    known = f", known to {surest:.2g} to {least:.2g} ms" if least else ""
    notes = [f"Contact begins between {1e3 * contacts[first][0]:.5g} ms (record {first}) and "
             f"{1e3 * contacts[last][0]:.5g} ms (record {last}) of the raw time{known}."]
    for name in dict.fromkeys(name for own in offsets.values() for name in own):
        own = {key: one[name] for key, one in offsets.items() if name in one}
        low, high = (pick(own, key=lambda key: own[key]) for pick in (min, max))
        notes.append(f"Offsets of {name} were subtracted in {len(own)} of {len(told)} records: {own[low]:.4g} "
                     f"(record {low}) to {own[high]:.4g} {si_unit(name)} (record {high}).")
    return notes if len(notes) > 1 else [f"{notes[0].removesuffix('.')}; {NO_OFFSET}."]


def _find_onsets(tests: list[RawTest], notes: list[str]) -> Onsets:
    """Onsets of all tests, and in words what they share."""
    files = {f"record {test.key!r}: ": test.file for test in tests}
    try:
        found = find_onsets([test.values["time"] for test in tests], [test.values["normal_force"] for test in tests],
                            list(files))
    except InputError as error:
        file = next((file for label, file in files.items() if error.problem.startswith(label)), None)
        raise InputError(error.problem, file=file) from None
    notes.append("The onsets of contact may all be off by the same time: the force itself shows neither how it begins "
                 "to rise nor the delay of the measuring chain. One standard deviation of this common error is "
                 f"{found.common_sd * 1e3:.3g} ms.")
    if found.start != "curved":
        how = "with a jump, as of a dashpot" if found.start == "stepped" else "linearly in time, as of a wall"
        notes.append(f"The force begins {how}, not as the square of time; the onsets were found on this basis.")
    if found.ringing is not None:
        frequency, damping = found.ringing
        notes.append(f"The force gauge rings at {frequency:.3g} Hz (damping ratio {damping:.2g}); the onsets allow for "
                     "it, but it is still in the samples and can look like missing physics.")
    return found


def _turn_sign(tests: list[RawTest], name: str, signs: list[float], usual: str, notes: list[str]) -> None:
    """Turn a channel whose signs are negative in all records; where some are positive, neither can be told wrong."""
    if min(signs) < 0:
        against = tests[signs.index(min(signs))]
        if max(signs) > 0:
            raise InputError(f"the {name} of record {against.key!r} has the opposite sign to that of record "
                             f"{tests[signs.index(max(signs))].key!r}; export all with one sign", file=against.file)
        for test in tests:
            test.values[name] = -test.values[name]
        notes.append(f"The {name} is negative {usual} in the raw files; its sign was reversed.")


def _given_onsets(tests: list[RawTest], plan: Plan, onset) -> dict[str, float] | None:
    """Onset by record from --onset or the table of conditions, or None."""
    table = plan.conditions.pop("onset", None)
    if onset is None:
        if table:
            plan.notes.append("The contact onset was read from the column onset of the table of conditions.")
        return table
    if str(onset) == "onset" and table:
        return table
    with error_place(option="--onset"):
        if str(onset) in plan.conditions:
            if plan.si[onset] != "s":
                raise InputError(f"the column {onset!r} is not a time")
            return plan.conditions.pop(onset)
        if not isinstance(onset, int | float) and str(onset).strip() not in ("0", "0.0"):
            with error_place("is a time like '12.5 ms', or a column of the table of conditions: "):
                onset = parse_quantity(onset, "time")
    return dict.fromkeys((test.key for test in tests), float(onset))


def find_offset(quiet: np.ndarray) -> float:
    """Mean of readings at rest, shape (samples,); 0 where noise alone could do it, as to take it off would only add
    noise.
    """
    # Of few readings the deviation is itself uncertain: Student's t, at what three deviations of a Gaussian are.
    limit = special.stdtrit(quiet.size - 1, special.ndtr(3.0))
    offset = float(quiet.mean())
    return offset if abs(offset) > limit * quiet.std(ddof=1) / math.sqrt(quiet.size) else 0.0


def _is_moving(t: np.ndarray, quiet: np.ndarray) -> bool:
    """Whether a channel moves before contact: six standard errors, so that noise alone does not, and a nanometre."""
    slope, *_, error = np.asarray(stats.linregress(t, quiet), dtype=float).tolist()
    return abs(slope) > max(6 * error, 1e-9 / np.ptp(t))


def _zero_position(moving: list[RawTest], tests: list[RawTest], clock: float) -> tuple[list[float], float]:
    """Turn the arm's position into the depression, in place: zero at the onset, and only in contact.

    Samples nearer to the onset than `NEAR` deviations of it, `clock` [s], may be of the approach, where the ball is not
    depressed: the same ones in all records, where the onsets are found too early. They are left out too.

    Returns:
        Variances about the straight approach [m²], and the standard deviation of the zero that all share [m].
    """
    if len(moving) < len(tests):
        other = next(test for test in tests if test not in moving)
        problem = f"the depression moves before contact in record {moving[0].key!r} but not in {other.key!r}"
        raise InputError(f"{problem}; export all in the same way", file=moving[0].file)
    zeros, slopes, variances = [], [], []
    for test in moving:
        t, x = test.values["time"], test.values["depression"]
        calm = (t < 0) & ~np.isnan(x)
        line = np.polynomial.Polynomial.fit(t[calm], x[calm], 1)
        slope, zero = float(line.deriv()(0.0)), float(line(0.0))
        sign = math.copysign(1.0, slope)
        pressed = np.where(t >= 0, sign * (x - zero), np.nan)
        if not np.isfinite(pressed).any() or np.nanargmax(pressed) >= np.flatnonzero(np.isfinite(pressed))[-1] - 2:
            problem = f"the depression of record {test.key!r} moves before contact and does not reverse: is it the "
            problem += "commanded position of the arm? Rename its heading to leave it out, or export the depression"
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
        inside = (t > NEAR * clock) & (t < (t[gone[0]] if gone.size else np.inf))
        test.values["depression"] = np.where(inside, x, np.nan)
    return variances, error


def turn_friction(tests: list[RawTest], notes: list[str]) -> None:
    """Make friction count positive along the slip, in place."""
    shares = [share_work(test.values["slip"], test.values["tangential_force"]) for test in tests]
    signs = [share if abs(share) > DOUBT else 0.0 for share in shares]
    _turn_sign(tests, "tangential_force", signs, "along the slip", notes)


def take_means(tests: list[RawTest], name: str, headings: dict[str, str]) -> dict[str, float]:
    """Mean over each record of what was measured along it and has to be steady [SI]; the tests lose the quantity."""
    means = {}
    for test in tests:
        values = test.values.pop(name)
        values = values[np.isfinite(values)]
        means[test.key] = mean = float(values.mean()) if len(values) else float("nan")
        spread = float(values.std()) / abs(mean) if mean else float("inf")
        if not spread < STEADY:
            shown = f"{values.min():.4g} to {values.max():.4g} {si_unit(name)}" if len(values) else "no values"
            problem = f"{name} changes too much within record {test.key!r} ({shown}) to be one condition; cut the "
            problem += "record to where it is steady, or give the nominal value as a condition and rename this column"
            raise InputError(problem, file=test.file, column=headings.get(name))
    return means


def start_clocks(tests: list[RawTest], notes: list[str]) -> None:
    """Count the time of each record from its first sample, in place; the rates there are what a fit starts from."""
    moved = {test.key: float(test.values["time"][0]) for test in tests if test.values["time"][0] != 0.0}
    for test in tests:
        test.values["time"] = test.values["time"] - moved.get(test.key, 0.0)
    if moved:
        first = next(iter(moved))
        more = f" (and likewise in {len(moved) - 1} more)" if len(moved) > 1 else ""
        notes.append(f"Time counts from the first sample of each record: {moved[first]:g} s was subtracted in record "
                     f"{first}{more}.")


def turn_axes(tests: list[RawTest], axis: str | None, notes: list[str]) -> None:
    """Make the axis of symmetry body z by a cyclic exchange of the axes, which keeps them right-handed, in place."""
    if axis is None:
        notes.append("The body's axis of symmetry is taken as z; give --symmetry-axis x or y if it is not.")
        return
    axis = str(axis).strip().lower()
    if axis not in ORDERS:
        raise InputError(f"--symmetry-axis must be x, y or z, not {axis!r}")
    order = ORDERS[axis]
    for test in tests:
        old = dict(test.values)
        for name in old:
            wanted = turn_name(name, axis)
            if wanted not in old:
                raise InputError(f"--symmetry-axis {axis} needs all three axes, and there is no {wanted}",
                                 file=test.file)
            test.values[name] = old[wanted]
    if axis != "z":
        notes.append(f"The body's axis of symmetry, {axis} in the raw files, is z in the campaign: its x, y, z are "
                     f"{', '.join(order)} of the files.")
