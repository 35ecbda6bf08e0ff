"""Commands about results that are there: `rerun` makes them again and says what differs, `cite` says it in a paper."""

import contextlib
import csv
import io
import json
import math
import shlex
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple, TypeGuard

import typer

from .._errors import InputError
from .._settings import find_data
from .._user_files import require_trust, split_name
from .options import app, command, option
from .places import MADE, RECORD, hash_place, locate_fit, read_record


MAKERS = ("compare", "discover", "missing", "identify", "fit", "predict", "sample", "average", "design", "map", "plan",
          "exam", "import", "demo", "paper")  # commands that write results: a folder from elsewhere may name no other
DROPPED = ("-o", "--output", "--scheduler")  # options that say where, and nothing of what
PASSING = ("seconds", "processor_seconds", "versions")  # keys of what differs from run to run and is no result
MOST = 12  # differences of a file that are listed
SETTLED = 1e-6  # of a number, below which it is the same: what solvers leave open is less


class Difference(NamedTuple):
    """One place at which two results differ."""

    place: str  # `result.json: steps[1].nrmse`
    before: Any
    now: Any

    def __str__(self) -> str:
        return f"{self.place}: {_show(self.before)} before, {_show(self.now)} now"


def compare_values(before: Any, now: Any, place: str = "", tolerance: float = SETTLED) -> Iterator[Difference]:
    """Where two results as plain data differ: numbers by more than a share `tolerance`, everything else at all.

    A number within a list of numbers is held against the largest of them, so that rounding about zero is none.
    """
    if isinstance(before, Mapping) and isinstance(now, Mapping):
        for key in dict.fromkeys([*before, *now]):
            if key not in PASSING:
                yield from compare_values(before.get(key), now.get(key), f"{place}.{key}".lstrip("."), tolerance)
    elif isinstance(before, list) and isinstance(now, list) and len(before) == len(now):
        numbers = [abs(x) for x in (*before, *now) if _is_number(x)]
        least = tolerance * max(numbers, default=0.0)
        for k, (a, b) in enumerate(zip(before, now, strict=True)):
            if not (_is_number(a) and _is_number(b) and abs(a - b) <= least):
                yield from compare_values(a, b, f"{place}[{k}]", tolerance)
    elif _is_number(before) and _is_number(now):
        if not math.isclose(before, now, rel_tol=tolerance):
            yield Difference(place, before, now)
    elif before != now:
        yield Difference(place, before, now)


def compare_files(before: Path, now: Path, name: str, tolerance: float = SETTLED) -> list[Difference]:
    """Differences of two JSON files, or of two tables as CSV; pages, pictures and chains are made of these."""
    if not now.is_file():
        return [Difference(name, "there", "missing")]
    read = {".json": _read_json, ".jsonl": _read_lines, ".csv": _read_table}.get(before.suffix)
    return [] if read is None else [one._replace(place=f"{name}: {one.place}".rstrip(": "))
                                    for one in compare_values(read(before), read(now), "", tolerance)]


@command("rerun", "Make results again by the command that made them, and say what differs.", "rerun discovery")
def make_again(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder that a command wrote its results to.")],
    tolerance: Annotated[float, option("X", "Numbers that differ by a smaller fraction are the same.")] = SETTLED,
):
    """Run the command that made the results in DIR again, from where it was run, and compare: numbers and words, not
    pages and pictures. Exits with 1 where anything differs. Versions and inputs that have changed since are named.
    """
    from ..inference.files import list_versions

    made = read_making(folder)
    different = False
    for how in made.values():
        check_words(how["words"], folder)
        changed = []
        for place, known in how["inputs"].items():
            path = next((one for one in (Path(place), find_data() / place) if one.exists()), None)
            if path is None:
                raise InputError("the results were made of this, which is not there any more; run the command where it "
                                 "was run before", file=Path(place))
            changed += [place] if hash_place(path) != known else []
        versions = list_versions()
        news = [f"{one} {how['versions'].get(one, 'none')} then, {version} now" for one, version in versions.items()
                if how["versions"].get(one) != version]
        with tempfile.TemporaryDirectory(prefix="ddetumble-rerun-") as place:
            with contextlib.redirect_stdout(io.StringIO()):
                app(place_output(how["words"], Path(place) / "out"), prog_name="ddetumble", standalone_mode=False)
            found = [one for file in how["files"]
                     for one in compare_files(folder / file, Path(place) / "out" / file, file, tolerance)]
        different |= bool(found)
        told = f"{len(found)} values differ" if found else f"all values agree within {tolerance:g}"
        typer.echo(f"ddetumble {shlex.join(how['words'])}: {told}.")
        for line in (*(f"{one} has changed since" for one in changed), *news, *map(str, found[:MOST])):
            typer.echo(f"- {line}")
        if len(found) > MOST:
            typer.echo(f"- and {len(found) - MOST} more")
    return 1 if different else None


@command("cite", "A methods paragraph and BibTeX references for a paper, made from a result.", "cite discovery")
def cite_result(folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder that fit or discover wrote.")]):
    """Print what a paper would say of a fit or a discovery: a paragraph on methods, and the references it names."""
    from ..reports.citation import citation

    typer.echo(str(citation(locate_fit(folder))))


def read_making(folder: Path) -> dict[str, dict[str, Any]]:
    """Words, inputs, versions and files of every command that wrote to a folder.

    Raises:
        InputError: the folder keeps none.
    """
    files = read_record(folder)
    try:
        found = {name: {"words": [str(word) for word in how["words"]], "inputs": dict(how["inputs"]),
                        "versions": dict(how["versions"]), "files": files[name]}
                 for name, how in read_record(folder, MADE).items()}
    except (ValueError, KeyError, TypeError):
        found = {}
    if not found:
        raise InputError("this folder does not say by which command it was made; name one that a command wrote to",
                         file=folder)
    return found


def place_output(words: Sequence[str], folder: Path) -> list[str]:
    """The words of a command with another place for its results, on this machine."""
    kept, skip = [], False
    for word in words:
        if skip:
            skip = False
        elif word in DROPPED:
            skip = True
        elif word != "--overwrite" and not word.startswith(tuple(f"{one}=" for one in DROPPED)) and (
                not word.startswith("-o") or word.startswith("--")):
            kept.append(word)
    return [*kept, "-o", str(folder)]


def check_words(words: Sequence[str], folder: Path) -> None:
    """Refuse what a folder from elsewhere might name: other commands, and Python files that the user never named."""
    if not words or words[0] not in MAKERS:
        raise InputError("it names no command that makes results", file=folder / RECORD)
    for word in words:
        name = word.split("=", 1)[1] if word.startswith("--") and "=" in word else word
        file = (split_name(name) or (Path(name), ""))[0]
        if file.suffix == ".py":
            require_trust(file, folder / RECORD)


def _is_number(value: Any) -> TypeGuard[float]:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _show(value: Any) -> str:
    text = f"{value:.10g}" if isinstance(value, float) else json.dumps(value, ensure_ascii=False)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _read_json(path: Path) -> Any:
    return json.loads(path.read_text(encoding="utf-8"))


def _read_lines(path: Path) -> list[Any]:
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]


def _read_table(path: Path) -> list[list[Any]]:
    """Columns of a table; what reads as a number is one."""
    def read(cell: str) -> Any:
        try:
            return float(cell)
        except ValueError:
            return cell

    with path.open(newline="", encoding="utf-8") as stream:
        rows = list(csv.reader(stream))
    return [[read(cell) for cell in column] for column in zip(*rows, strict=False)]
