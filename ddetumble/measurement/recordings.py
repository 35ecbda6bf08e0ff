"""A laboratory's files of any format as tables: one sheet or group, and channels put together by their clocks."""

import contextlib
import fnmatch
import importlib
import io
import json
import logging
import os
import subprocess
import sys
import warnings
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from .._errors import InputError, error_place
from .formats.channel import Channel
from .layout import RawFile, holds_numbers, holds_rows, lay_out, read_layout, split_heading
from .tables import find_file


TEXT = (".csv", ".txt", ".tsv", ".dat", ".asc")
_SHEETS = (".xlsx", ".xlsm", ".ods")
# Reader of a format, the library it needs, and whether its groups belong to one measurement, each with its own clock.
_READERS = {
    **dict.fromkeys((".xlsx", ".xlsm"), ("spreadsheet", "openpyxl", False)),
    ".ods": ("spreadsheet", "odfpy", False),
    **dict.fromkeys((".mat", ".h5", ".hdf5", ".hdf", ".nxs", ".nc"), ("hdf5", "h5py", False)),
    ".tdms": ("tdms", "npTDMS", False),
    ".parquet": ("parquet", "pyarrow", False),
    **dict.fromkeys((".mf4", ".mdf"), ("mdf", "asammdf", True)),
    **dict.fromkeys((".uff", ".unv"), ("uff", "pyuff", True)),
    **dict.fromkeys((".mcap", ".db3"), ("messages", "mcap and rosbags", True)),
}
# Formats whose libraries may crash at a damaged file, or never return.
_FRAGILE = (".mat", ".h5", ".hdf5", ".hdf", ".nxs", ".nc")
_READ_APART = "from ddetumble.measurement.recordings import read_apart; read_apart()"
PATIENCE, SLOWEST = 15.0, 5e6  # s, and bytes a second, for files that are read apart
BAG = "metadata.yaml"  # makes a folder a rosbag2
ENDINGS = (*TEXT, *_READERS)
# Share of a sampling interval within which times of two clocks are one: decimal steps are rounded in the last digits.
SAME = 1e-6
SHOWN = 12  # names of groups in a message


@dataclass(frozen=True)
class Recording(RawFile):
    """A table whose columns may differ in length or have clocks of their own, until some of them are joined."""

    clock: str = ""  # the column that stands for the clocks, which `join` fills; "" where there are none
    clocks: dict[str, np.ndarray] = field(default_factory=dict)  # time of each sample of a column [s]
    problems: dict[str, str] = field(default_factory=dict)  # why a column cannot be used

    def join(self, names: Iterable[str]) -> RawFile:
        """The table of these columns: of one length, or over the times of all clocks, NaN where a column has no sample.
        """
        names, notes = list(dict.fromkeys(names)), list(self.notes)
        for name in names:
            if name in self.problems:
                raise InputError(self.problems[name], file=self.file, column=name)
        series = [name for name in names if name != self.clock and len(self.columns[name]) != 1]
        clocks = {name: self.clocks[name] for name in series if name in self.clocks}
        own = len({clock.tobytes() for clock in clocks.values()}) > 1
        columns = {name: self.columns[name] for name in names}
        if self.clock in names:
            apart = next((name for name in series if name not in clocks), None)
            if apart is not None:
                raise InputError("the channel has no clock, as others have; choose a column for the time with --time",
                                 file=self.file, column=apart)
            columns |= self._spread(columns, clocks) if own else {self.clock: next(
                iter(clocks.values()), np.zeros(1))}  # one sample needs no clock
            if own:
                rates = ", ".join(f"{name} {len(clock)} samples" for name, clock in clocks.items())
                notes.append(f"{Path(self.file).name}: the channels have clocks of their own ({rates}); nothing was "
                             "resampled, and where a channel has no sample its cell is empty.")
        elif own:
            raise InputError(f"{' and '.join(clocks)} have clocks of their own, so no column can be the time of both; "
                             f"give --time {self.clock}", file=self.file)
        length = max(map(len, columns.values()), default=0)
        for name, cells in columns.items():
            if len(cells) not in (1, length):
                longest = next(other for other, there in columns.items() if len(there) == length)
                raise InputError(f"the column has {len(cells)} values and {longest} has {length}; export channels of "
                                 "one length, or each with a clock", file=self.file, column=name)
            columns[name] = cells if len(cells) == length else list(cells) * length if isinstance(cells, list) else (
                np.repeat(cells, length))
            missing = 0 if own or isinstance(cells, list) else int(np.isnan(cells).sum())
            if missing:
                notes.append(f"{Path(self.file).name}: {missing} samples of {name} are NaN and count as missing.")
        return RawFile(self.file, columns, np.arange(1, length + 1), self.units, self.decimal, tuple(notes), self.key,
                       self.sheet)

    def _spread(self, columns: dict, clocks: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Channels over the times of all their clocks: nothing is moved or made up between samples."""
        for name, clock in clocks.items():
            steps = np.diff(clock)
            if isinstance(columns[name], list) or not np.all(steps > 0):
                what = "holds text" if isinstance(columns[name], list) else (
                    f"has a clock that does not go forward at sample {int(np.argmin(steps > 0)) + 2}")
                raise InputError(f"the channel {what}, so it cannot be put beside channels with other clocks",
                                 file=self.file, column=name)
        near = SAME * min(float(np.diff(clock).min()) for clock in clocks.values() if len(clock) > 1)
        times = np.unique(np.concatenate(list(clocks.values())))
        times = times[np.diff(times, prepend=-np.inf) > near]
        found = {self.clock: times}
        for name, clock in clocks.items():
            found[name] = np.full(len(times), np.nan)
            found[name][np.searchsorted(times, clock + near, side="right") - 1] = columns[name]
        return found


def read_files(path, *, sheet: str | None = None, leave_out: str | None = None, delimiter: str | None = None,
               decimal: str | None = None, option: str = "--sheet", single: bool = False,
               alone: bool = False) -> list[RawFile]:
    """The tables of a file, one each test or several with a column that tells them apart.

    Args:
        path: Of a file of any format, or of the folder of a rosbag2.
        sheet: The sheet or group to read where there are several; of a pattern such as `*` each that fits.
        leave_out: A sheet or group that is not a test; a file that holds no other gives none.
        delimiter, decimal: Of a text file, as `read_layout` takes them.
        option: That names the sheet: `--conditions` takes it behind the file, and needs a single one.
        single: Whether a text file may have one column alone.
        alone: Whether no other file is read, so that one sheet of several gives its test its name.
    """
    path = Path(path)
    ending = path.suffix.lower()
    if not is_bag(path) and ending not in _READERS:
        if sheet is not None and path.exists():  # where it does not, reading says so
            raise InputError("a text file has no sheets; leave out --sheet", file=path)
        return [read_layout(path, delimiter=delimiter, decimal=decimal, single=single)]
    word, short = "sheet" if ending in _SHEETS else "group", path.name
    groups = {name: held for name, held in _read_groups(path).items() if held or name == sheet}
    if groups.pop(leave_out, None) is not None and not groups:
        return []
    if not groups:
        raise InputError(f"the file holds no {'sheets with numbers' if ending in _SHEETS else 'channels'}; choose "
                         "another file, or export the measurement again", file=path)
    chosen, found = _choose_groups(groups, sheet, word, path, option), []
    by_sheet = len(chosen) > 1 or alone and sheet is not None and len(groups) > 1
    for name in chosen:
        key, named = f"{path.stem}-{name}" if by_sheet else path.stem, f"{word} {name}" if name else None
        with error_place(file=str(path), sheet=named):
            held = groups[name]
            raw = _lay_out_sheet(held, path, option) if ending in _SHEETS else _make_recording(held, path)
        note = f"{short}: {', '.join([*([named] if named else []), *raw.notes])}."
        found.append(replace(raw, key=key, sheet=named, notes=(note,) if named or raw.notes else ()))
    return found


def add_clock(raw: RawFile, rate: float, name: str) -> RawFile:
    """A file without times as one whose samples are evenly spaced: the column `name` with times from zero on, of a
    recording one for each length of its channels; `rate` in samples a second.
    """
    assert name not in raw.columns, name
    columns, units = {name: np.arange(len(raw)) / rate, **raw.columns}, {name: "s", **raw.units}
    if not isinstance(raw, Recording):
        return replace(raw, columns=columns, units=units)
    clocks = {one: np.arange(len(cells)) / rate for one, cells in raw.columns.items() if len(cells) != 1}
    return replace(raw, columns=columns | {name: np.empty(0)}, units=units, clock=name, clocks=clocks)


def probe_files(paths: Iterable[Path | str]) -> None:
    """Refuse a file at which a library crashes or never returns, which ends the process or holds it up: files of such
    libraries are first read once in a process of their own.
    """
    files = [str(path) for path in paths if Path(path).suffix.lower() in _FRAGILE and Path(path).is_file()]
    if not files or getattr(sys, "frozen", False):  # a Python that is part of another program starts no other
        return
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    try:
        done = subprocess.run([sys.executable, "-c", _READ_APART], input=json.dumps(files).encode(), env=environment,
                              stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
                              timeout=PATIENCE + sum(map(os.path.getsize, files)) / SLOWEST)
        told, failed = done.stdout, done.returncode != 0
    except subprocess.TimeoutExpired as error:
        told, failed = error.stdout or b"", True
    except OSError:  # no process can be started
        return
    if failed and told:
        raise InputError("the file is damaged: the library that reads it breaks down; export or copy it again",
                         file=files[told.count(b"\n") - 1])


def read_apart() -> None:
    """Read the files that standard input lists, a line before each, and say nothing else."""
    for path in json.loads(sys.stdin.read()):
        print(flush=True)
        with contextlib.suppress(InputError):
            _read_groups(Path(path))


def list_channels(path) -> tuple[Channel, ...]:
    """Everything that a file of any format holds, by sheet or group: names, units, values and clocks.

    Raises:
        InputError: The file cannot be read, or its library is missing.
    """
    path = Path(path)
    probe_files([path])
    if path.suffix.lower() not in _SHEETS:
        if is_bag(path) or path.suffix.lower() in _READERS:
            return tuple(channel for channels in _read_groups(path).values() for channel in channels)
        raw = read_layout(path)
        return tuple(Channel(name, cells, raw.units[name]) for name, cells in raw.columns.items())
    found = []
    for name, rows in _read_groups(path).items():
        if not rows:
            continue
        try:
            raw = _lay_out_sheet(rows, path)
            found += [Channel(column, cells, raw.units[column], name) for column, cells in raw.columns.items()]
        except InputError as error:
            found.append(Channel("", [], None, name, problem=error.problem))
    return tuple(found)


def split_sheet(path) -> tuple[Path, str | None]:
    """File and sheet of `FILE.xlsx:SHEET`; a path that exists is one."""
    file, colon, sheet = str(path).rpartition(":")
    named = colon and not Path(path).exists() and Path(file).suffix.lower() in _READERS
    return (Path(file), sheet) if named else (Path(path), None)


def is_raw(path: Path) -> bool:
    """Not so what macOS (`._run1.csv`) and Excel (`~$run1.xlsx`) put beside files."""
    return not path.name.startswith((".", "~$"))


def list_folder(folder: Path) -> list[Path]:
    """Raw files in a folder, by name, or the folder itself where it is a rosbag2.

    Raises:
        InputError: There are none.
    """
    if is_bag(folder):
        return [folder]
    found = sorted(path for path in filter(is_raw, folder.iterdir())
                   if path.suffix.lower() in ENDINGS and path.is_file() or is_bag(path))
    if not found:
        raise InputError(f"the folder holds no raw files ({', '.join(ENDINGS)})", file=folder)
    return found


def is_notes(path: Path) -> bool:
    """Whether a file of a folder is a text without rows of numbers, such as notes, and no measurement."""
    return path.suffix.lower() in TEXT and not holds_rows(path)


def is_bag(path: Path) -> bool:
    """Whether a folder is a rosbag2."""
    return (path / BAG).is_file()


def _read_groups(path: Path) -> dict:
    """Rows of cells by sheet, or channels by group; whatever a library raises becomes one sentence."""
    ending = ".db3" if is_bag(path) else path.suffix.lower()
    module, library, together = _READERS[ending]
    if not is_bag(path) and not find_file(path).stat().st_size:
        raise InputError("the file is empty; export the measurement again, or copy it again", file=path)
    logged = logging.root.manager.disable
    logging.disable(logging.CRITICAL)
    try:
        # What libraries print when they fail is in the error.
        with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()), error_place(file=str(path)):
            warnings.simplefilter("ignore")
            found = getattr(importlib.import_module(f".formats.{module}", __package__), f"read_{module}")(path)
    except InputError:
        raise
    except ImportError as error:
        raise InputError(f"{ending} files are read by {library}, which is not installed ({error}); install it with "
                         'pip install "ddetumble[formats]"', file=path) from None
    except Exception as error:  # damaged files make libraries raise all sorts
        reason = f"{type(error).__name__}: {error}".rstrip(": ").rstrip(".")
        raise InputError(f"the file is damaged or is no {ending} file ({reason}); export or copy it again",
                         file=path) from None
    finally:
        logging.disable(logged)
    if ending in _SHEETS:
        return found
    groups: dict[str, list[Channel]] = {}
    for channel in found:
        groups.setdefault("" if together else channel.group, []).append(channel)
    return groups


def _choose_groups(groups: dict, sheet: str | None, word: str, path: Path, option: str) -> list[str]:
    there = list(groups)
    shown = ", ".join(there[:SHOWN]) + f" and {len(there) - SHOWN} more" * (len(there) > SHOWN)
    if sheet is not None:
        found = [sheet] if sheet in groups else [name for name in there if fnmatch.fnmatchcase(name, sheet)]
        if not found:
            raise InputError(f"there is no {word} {sheet!r}; the file holds {shown or 'none with a name'}", file=path,
                             option=option)
        return found
    # Settings that stand by themselves are no measurement.
    full = [name for name, held in groups.items() if word == "sheet" or any(len(one.values) > 1 for one in held)]
    full = full or there
    if len(full) > 1:
        remedy = ("choose one with --sheet NAME, or make each a test of its own with --sheet '*'" if option == "--sheet"
                  else f"name the one with the conditions behind the file, such as {option} '{path}:{full[0]}'")
        raise InputError(f"the file holds {len(there)} {word}s ({shown}); {remedy}", file=path)
    return full


def _lay_out_sheet(rows, path: Path, option: str = "--sheet") -> RawFile:
    remedy = ("name the sheet with the measurements with --sheet" if option == "--sheet" else
              f"name the sheet with the conditions behind the file, like {option} '{path}:SHEET'")
    if not holds_numbers(rows):  # it may well be the right sheet, named already and not filled in
        what = "no rows of numbers below its headings; write them there" if rows else "nothing; fill it in"
        raise InputError(f"the sheet holds {what}, or {remedy} if that is another")
    return lay_out(rows, str(path), ".", remedy=remedy)


def _make_recording(channels: list[Channel], path: Path) -> Recording:
    """Channels as columns: units from where the file keeps them or from headings, names made different."""
    names = Counter(channel.name for channel in channels)
    columns, units, clocks, problems = {}, {}, {}, {}
    for channel in channels:
        name, unit = channel.name.strip() or "channel", channel.unit
        if unit is None:
            name, unit = split_heading(name)
        if names[channel.name] > 1 and channel.group:
            name = f"{channel.group} {name}"
        same = sum(other == name or other.startswith(f"{name} (") for other in columns)
        name = f"{name} ({same + 1})" if name in columns else name
        columns[name], units[name] = channel.values, unit
        if channel.clock is not None:
            clocks[name] = channel.clock
        if channel.problem:
            problems[name] = channel.problem
    clock = next(name for name in ("time", "clock", "clock of the file") if name not in columns) if clocks else ""
    if clock:
        columns, units = {clock: np.empty(0)} | columns, {clock: "s"} | units
    return Recording(str(path), columns, np.arange(0), units, ".", (), path.stem, None, clock, clocks, problems)
