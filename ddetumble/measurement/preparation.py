"""What a laboratory says is to be done to its records before they are aligned: signs, zeros, cropping, cutting."""

from pathlib import Path

import numpy as np

from .._errors import InputError, error_place
from .alignment import RawTest
from .checks import FEWEST_SAMPLES
from .columns import expand_role, read_pairs
from .kinds import RecordKind
from .units import parse_quantity, si_unit


CUT = ("level", "before", "after")


def reverse_signs(tests: list[RawTest], names, kind: RecordKind, notes: list[str]) -> None:
    """Reverse the sign of channels, in place."""
    for name in [names] if isinstance(names, str) else names or ():
        channel = expand_role(name, kind)
        for test in tests:
            _find_channel(test, channel, "--reverse")
            test.values[channel] = -test.values[channel]
        notes.append(f"The sign of {channel} was reversed, as --reverse says.")


def subtract_zeros(tests: list[RawTest], windows, kind: RecordKind, notes: list[str]) -> None:
    """Take from each record of a channel its mean over a window of the raw time, in place: NAME=START to END."""
    for name, text in read_pairs("zero", windows).items():
        channel = expand_role(name, kind)
        start, end = _read_window(text, f"--zero {name}")
        for test in tests:
            values = _find_channel(test, channel, "--zero")
            quiet = values[(test.values["time"] >= start) & (test.values["time"] <= end) & np.isfinite(values)]
            if len(quiet) < FEWEST_SAMPLES:
                problem = f"record {test.key!r} has {len(quiet)} samples of {channel} from {text}; name a longer window"
                raise InputError(problem, file=test.file, option="--zero")
            test.values[channel] = values - quiet.mean()
            notes.append(f"Record {test.key}: the mean from {text}, {quiet.mean():.4g} {si_unit(channel)}, was "
                         f"subtracted from {channel}.")


def crop_records(tests: list[RawTest], window: str | None, notes: list[str]) -> None:
    """Keep the samples of a window of the raw time only, in place."""
    if window is None:
        return
    start, end = _read_window(window, "--crop")
    for test in tests:
        time = _find_channel(test, "time", "--crop")
        _keep(test, (time >= start) & (time <= end), "--crop", window)
    notes.append(f"Samples outside {window} of the raw time were left out, as --crop says.")


def cut_records(tests: list[RawTest], given, kind: RecordKind, notes: list[str]) -> list[RawTest]:
    """Cut recordings of many contacts into one record each, as `given` says: `level` of the main channel above its
    median that begins a contact, and the time to keep `before` and `after` that.

    Raises:
        InputError: A quantity is missing, no contact is found, or two are closer than the time to keep.
    """
    if not given:
        return tests
    pairs = read_pairs("cut", given)
    if set(pairs) != set(CUT) or not kind.main:
        raise InputError(f"it takes {', '.join(f'{name}=QUANTITY' for name in CUT)}, of kinds of tests with a force",
                         option="--cut")
    with error_place(option="--cut"):
        level, before, after = (parse_quantity(pairs[name], quantity) for name, quantity in
                                zip(CUT, (kind.main, "time", "time"), strict=True))
        if min(level, before, after) <= 0:
            raise InputError(f"{', '.join(CUT)} must be positive")
    found = []
    for test in tests:
        time, force = _find_channel(test, "time", "--cut"), test.values[kind.main]
        above = np.flatnonzero(np.abs(force - np.nanmedian(force)) >= level)
        starts = [float(time[i]) for i in above[:1]]
        for t in time[above]:
            if t > starts[-1] + after:
                starts.append(float(t))
        if not starts:
            problem = f"{kind.main} never leaves its median by {pairs['level']}; lower the level"
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
        notes.append(f"{Path(test.file).name}: {len(whole)} contacts were cut out, at "
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
