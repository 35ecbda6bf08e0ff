"""Where commands read from and write to.

One rule for everything that is written: a command writes to a folder (or file) that is not there yet, or empty, and
`--overwrite` alone replaces what is there. Results appear whole, when the command has succeeded, or not at all.
"""

import glob
import hashlib
import json
import os
import platform
import secrets
import shutil
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from contextvars import ContextVar
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from .. import _settings
from .._errors import InputError
from .._settings import find_data
from .failures import FAILED, explain, tell
from .interrupts import undone_by, was_interrupted
from .progress import Report


if TYPE_CHECKING:
    import pandas as pd

# In every folder that commands wrote to: the files of each command, so that --overwrite removes these and no others.
RECORD, SCHEMA = ".ddetumble.json", "ddetumble.output/1"
MADE = "made"  # in the record: words, inputs and versions of each command, by which `ddetumble rerun` makes it again
AGAIN = "the same command with --overwrite computes them again and draws it"
words_now: ContextVar[tuple[str, ...]] = ContextVar("words_now", default=())  # of the command that runs
# In the names of drafts, between that of their place and random letters: eight digits for the machine, as on a shared
# disk a lock may hold among the processes of one machine alone.
DRAFT = f"-ddetumble-{hashlib.sha256(platform.node().encode()).hexdigest()[:8]}-"


def locate_campaign(text: str) -> Path:
    """Path of a campaign: as given, or, said so, of the shipped campaign of that name."""
    path = _settings.locate_campaign(text)
    if path != Path(text):
        print(f"ddetumble: note: {text} is the campaign of that name that comes with the toolkit.", file=sys.stderr)
    return path


def locate_plan(text: str, **said: object) -> Path:
    """Path of a table of planned tests, or of a campaign, which says itself what the options of a table would.

    Raises:
        InputError: There is no such table, or one of these options is given for a campaign.
    """
    table = text.lower().endswith(".csv")
    path = Path(text) if table else locate_campaign(text)
    if table and not path.is_file():
        raise InputError("this file does not exist", file=path)
    if not table and any(said.values()):
        *first, last = (f"--{name}" for name in said)
        raise InputError(f"a campaign already says what it measures; {', '.join(first)} and {last} apply to a table of "
                         "planned tests only", file=path)
    return path


def locate_fit(path: Path) -> Path:
    """Folder of a fit: as given, or, where there is nothing, of the shipped fit of that name."""
    shipped = find_data() / path
    return shipped if not path.exists() and (shipped / "model.json").is_file() else path


class Output(NamedTuple):
    """The folder of a command's results while the command runs."""

    path: Path  # where they will be, as the user named it
    draft: Path  # where they are written until the command has succeeded

    def place(self, written: Path) -> Path:
        """Where something written into the draft will be."""
        return self.path / written.relative_to(self.draft)

    def draw(self, write: Callable[[Path], Path], report: Report, again: str = AGAIN, what: str = "page"
             ) -> Path | None:
        """Where the page, or `what` else, will be that `write` makes beside results in the draft; None where it fails.
        What it draws is reported.

        The results may be worth minutes: they are kept, without what the page left, and one sentence on standard error
        says so, and with `again` what draws them. The command's exit code is then that of a failure.
        """
        from ..reports.page import follower

        before, token = set(self.draft.rglob("*")), follower.set(report)
        try:
            return self.place(write(self.draft))
        except Exception as error:
            if was_interrupted():
                raise
            rest = sorted(set(self.draft.rglob("*")) - before, reverse=True)  # what is in a folder before the folder
            _remove(self.draft, (str(one.relative_to(self.draft)) for one in rest))
            why = explain(error, words_now.get())[0].rstrip(".").replace(str(self.draft), str(self.path))
            tell(f"the {what} could not be drawn: {why}; the results are kept in {self.path}, and {again}.", FAILED)
            return None
        finally:
            follower.reset(token)


def tell_page(page: Path | None, folder: Path) -> int | None:
    """Print where the page is, or, where it could not be drawn, the results; returns the exit code then."""
    print(f"Written to {folder}" if page is None else f"Report: {page}")
    return FAILED if page is None else None


@contextmanager
def open_folder(path: Path, command: str, overwrite: bool, *, beside: Sequence[str] = (), resumes: Sequence[str] = (),
                progress: str = "") -> Iterator[Output]:
    """Give a command a folder to write to, and publish what it wrote there if it succeeds.

    Args:
        path: of the folder; it has to be new or empty.
        command: its name, for the record of what it wrote.
        overwrite: replace what commands wrote there before; other files stay, those of the same names apart.
        beside: names of the command's own results where it shares the folder with other files: only these count.
        resumes: names of what the command itself keeps in the folder as it goes, and goes on from. With `overwrite`
            they are removed, and it begins anew.
        progress: of the file among these without which there is nothing to go on from, so that they need not stay.

    Raises:
        InputError: The folder holds something, is a file, or cannot be made or written.
    """
    given, path = path, Path(os.path.realpath(path))
    _refuse_taken(given, overwrite, beside, resumes)
    # Drafts of this place whose process, on this machine, was killed before it could remove them.
    for stale in path.parent.glob(f".{glob.escape(path.name)}{DRAFT}*"):
        handle = _lock(stale) if stale.is_dir() and not stale.is_symlink() else None
        if handle is not None:
            shutil.rmtree(stale, ignore_errors=True)
            os.close(handle)
    made = [folder for folder in (path, *path.parents) if not folder.exists()]
    draft = handle = None
    done = False

    def clear_up() -> None:
        if not done and resumes and not (path / progress).exists():
            _remove(path, resumes)
        if draft is not None:
            shutil.rmtree(draft, ignore_errors=True)
        _remove_empty(made)

    with undone_by(clear_up):
        try:
            try:
                path.parent.mkdir(parents=True, exist_ok=True)
                # Not by `tempfile`, which makes folders, on Windows for good, that nobody else may read.
                draft = path.parent / f".{path.name}{DRAFT}{secrets.token_hex(4)}"
                draft.mkdir()
                handle = _lock(draft)
            except OSError as error:
                raise InputError(f"the folder cannot be made ({_reason(error)})", file=given) from None
            if overwrite:
                _remove(path, resumes)
            yield Output(given, draft)
            _publish(draft, path, command, bool(beside))
            done = True
        finally:
            clear_up()
            if handle is not None:
                os.close(handle)


def _lock(draft: Path) -> int | None:
    """Hold a folder as long as this process lives; None where another one does, or nobody can (not on POSIX)."""
    if sys.platform == "win32":
        return None
    import fcntl

    handle = None
    try:
        handle = os.open(draft, os.O_RDONLY)
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        return handle
    except OSError:
        if handle is not None:
            os.close(handle)
        return None


def open_optional(path: Path | None, command: str, overwrite: bool) -> AbstractContextManager[Output | None]:
    """As `open_folder`, or None where no folder is named."""
    return nullcontext() if path is None else open_folder(path, command, overwrite)


def _refuse_taken(path: Path, overwrite: bool, beside: Sequence[str], resumes: Sequence[str]) -> None:
    """Refuse a folder that may not be written to."""
    whole = Path(os.path.abspath(path))
    nearest = next((folder for folder in (whole, *whole.parents) if os.path.lexists(folder)), None)
    if nearest is None:
        raise InputError(f"the folder cannot be made (there is no drive {whole.anchor})", file=path)
    if not nearest.is_dir():
        raise InputError("this is a file; -o takes a folder" if nearest == whole else
                         f"the folder cannot be made ({nearest.name} is a file)", file=path)
    if not os.access(nearest, os.W_OK | os.X_OK):
        raise InputError("this folder is not writable", file=path if nearest == whole else nearest)
    if overwrite or nearest != whole or any((path / name).exists() for name in resumes):
        return
    found = sorted(one.name for one in path.iterdir() if one.name != RECORD)
    taken = [name for name in beside if name in found] if beside else found
    if taken:
        raise InputError(f"the folder already holds {taken[0]}{' and more' if len(taken) > 1 else ''}; name a new "
                         "folder with -o, or replace what is there with --overwrite", file=path)


def _publish(draft: Path, path: Path, command: str, shared: bool) -> None:
    """Move a finished draft to its place, and remove what earlier commands wrote there and this one did not."""
    new = sorted(file.relative_to(draft).as_posix() for file in draft.rglob("*") if not file.is_dir())
    before, made = read_record(path), read_record(path, MADE)
    kept = {name: files for name, files in before.items() if shared and name != command}
    content: dict[str, Any] = {"schema": SCHEMA, "files": kept | {command: new}}
    if words_now.get():
        from ..inference.files import list_versions

        now = {"words": words_now.get(), "inputs": list_inputs(words_now.get(), path), "versions": list_versions()}
        content[MADE] = {name: how for name, how in made.items() if name in kept} | {command: now}
    (draft / RECORD).write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    try:
        if not path.exists():
            os.replace(draft, path)
            return
        for name in (*new, RECORD):
            (path / name).parent.mkdir(parents=True, exist_ok=True)
            os.replace(draft / name, path / name)
        old = {file for files in before.values() for file in files}
        old -= {*new, *(file for files in kept.values() for file in files)}
        _remove(path, old)
        for name in old:
            _remove_empty(list((path / name).parents)[: name.count("/")])
    except OSError as error:
        raise InputError(f"the results cannot be put into the folder ({_reason(error)})", file=path) from None


def read_record(path: Path, key: str = "files") -> dict[str, Any]:
    """Files that commands wrote into a folder, by command, without names that lead out of it; or how they were made."""
    try:
        found = json.loads((path / RECORD).read_text(encoding="utf-8")).get(key, {})
        if key == MADE:
            return {str(name): dict(how) for name, how in found.items()}
        return {str(name): [str(one) for one in own if not Path(one).anchor and ".." not in Path(one).parts]
                for name, own in found.items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return {}


def list_inputs(words: Sequence[str], output: Path) -> dict[str, str]:
    """SHA-256 of every file and folder that words of a command name, by that word; shipped campaigns among them."""
    found = {}
    for word in words:
        name = word.split("=", 1)[1] if word.startswith("--") and "=" in word else word
        path = next((one for one in (Path(name), find_data() / name) if name and one.exists()), None)
        if path is not None and path.resolve() not in (output.resolve(), Path().resolve()):
            found[name] = hash_place(path)
    return found


def hash_place(path: Path) -> str:
    """SHA-256 of a file, or of a folder's visible files with their names."""
    digest = hashlib.sha256()
    # Ordered by their parts as texts: paths themselves have another order on Windows.
    for file in sorted((one for one in (path, *path.rglob("*")) if one.is_file()), key=lambda one: one.parts):
        parts = file.relative_to(path).parts
        if not any(part.startswith(".") for part in parts):
            digest.update("/".join(parts).encode() + b"\0" + file.read_bytes())
    return digest.hexdigest()


def _remove(folder: Path, names: Iterable[str]) -> None:
    for path in (folder / name for name in names):
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)


def _remove_empty(folders: Iterable[Path]) -> None:
    """Remove those of some folders that hold nothing, the innermost first."""
    for folder in folders:
        with suppress(OSError):
            if not any(folder.iterdir()):
                folder.rmdir()


def check_file(path: Path | None, overwrite: bool) -> Path | None:
    """Refuse an output file that cannot be written, or is there already; None is standard output.

    Raises:
        InputError: It is a folder, its folder cannot be written, or it is there and `overwrite` is not given.
    """
    if path is None or str(path) == "-":
        return None
    if path.is_dir():
        raise InputError("this is a folder; -o takes a file here", file=path)
    _refuse_taken(path.parent, True, (), ())
    if path.exists() and not overwrite:
        raise InputError("this file exists already; name another with -o, or replace it with --overwrite", file=path)
    return path


def write_bytes(content: bytes, path: Path) -> None:
    """Write a file, whole or not at all; where that fails, `failures` tells a full disk from a wrong place."""
    path.parent.mkdir(parents=True, exist_ok=True)
    draft = path.with_name(f".{path.name}.part")
    try:
        draft.write_bytes(content)
        os.replace(draft, path)
    finally:
        draft.unlink(missing_ok=True)


def write_table(table: "pd.DataFrame", path: Path | None) -> None:
    """Write a table as CSV, whole or not at all; to standard output where no file is named."""
    if path is None:
        table.to_csv(sys.stdout, index=False, lineterminator="\n")
    else:
        write_bytes(table.to_csv(index=False, lineterminator="\n").encode("utf-8"), path)


def _reason(error: OSError) -> str:
    return (error.strerror or type(error).__name__).lower()
