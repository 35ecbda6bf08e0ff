"""What readers of laboratory files make of damaged ones: `python -m docs.fuzz_readers -o DIR [FORMAT ...]`.

Files are written by their format's own library, damaged, and imported, for so many seconds a format. Of each attempt
has to come a campaign or one sentence that names the file; any other error, a warning, a process that dies, more than
20 s or more than 2 GB are findings, which end the command with 1. A campaign that differs from the true one is counted
by how much.
"""

import argparse
import itertools
import json
import multiprocessing
import os
import shutil
import sys
import tempfile
import time
import traceback
import warnings
import zipfile
import zlib
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

import ddetumble as dd
from ddetumble.inference.files import list_versions, write_json


ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "tests"))

from helpers_formats import CONDITIONS, FORMATS, STEP, TIME, UNITLESS, trace  # noqa: E402


PATIENCE, MEMORY = 20.0, 2e9  # s and bytes for one attempt
TOKENS = (b"", b"0", b"-1", b"1e999", b"nan", b"1,5", b"99999999999", b"x", b"&", b"\x00", b"\xff\xfe")
OUTCOMES = {  # in the order of the table
    "refused": "refused", "same": "true, or the library does not write it",
    "touched": "true but for eight numbers at most", "restated": "otherwise of the same size",
    "resized": "of another size", "written": "as the library wrote it, which was not the truth", "finding": "findings"}
Damage = Callable[[np.random.Generator, bytes], bytes]


class Attempt(NamedTuple):
    """One damaged file: what was done to it, and what came of it."""

    done: str
    outcome: str  # a key of OUTCOMES
    told: str  # the sentence, or what differs


def _cut_out(random, data: bytes) -> tuple[int, int]:
    begin = int(random.integers(len(data) + 1))
    return begin, begin + int(min(len(data) - begin, 2 ** random.uniform(0, 12)))


def flip(random, data: bytes) -> bytes:
    """One to eight bytes changed; half of the times near an end, where heads and indices are."""
    changed = bytearray(data)
    for _ in range(int(random.integers(1, 9)) if data else 0):
        near = int(random.integers(min(len(data), 600))) * int(random.choice([1, -1]))
        changed[near if random.random() < 0.5 else int(random.integers(len(data)))] ^= int(random.integers(1, 256))
    return bytes(changed)


def drop(random, data: bytes) -> bytes:
    """A stretch left out."""
    begin, end = _cut_out(random, data)
    return data[:begin] + data[end:]


def repeat(random, data: bytes) -> bytes:
    """A stretch written twice."""
    begin, end = _cut_out(random, data)
    return data[:end] + data[begin:end] + data[end:]


def blank(random, data: bytes) -> bytes:
    """A stretch of noughts or ones, as of a failing disk."""
    begin, end = _cut_out(random, data)
    return data[:begin] + (b"\0", b"\xff")[int(random.integers(2))] * (end - begin) + data[end:]


def cut(random, data: bytes) -> bytes:
    """The end left out."""
    return data[: int(random.integers(len(data) + 1))]


def restate(random, data: bytes) -> bytes:
    """A number or a word of a text replaced."""
    import re

    words = list(re.finditer(rb"[A-Za-z0-9.+-]+", data))
    if not words:
        return data + b"?"
    word = words[int(random.integers(len(words)))]
    other = TOKENS[int(random.integers(len(TOKENS)))] if random.random() < 0.7 else (
        words[int(random.integers(len(words)))][0])
    return data[: word.start()] + other + data[word.end() :]


DAMAGES: tuple[Damage, ...] = (flip, flip, drop, repeat, blank, cut, restate)


def damage_file(random, path: Path) -> str:
    """Damage a file, or the parts that it is made of; returns what was done."""
    damage = DAMAGES[int(random.integers(len(DAMAGES)))]
    if path.is_dir():
        path = sorted(path.iterdir())[int(random.integers(len(list(path.iterdir()))))]
    if not zipfile.is_zipfile(path) or random.random() < 0.2:
        path.write_bytes(damage(random, path.read_bytes()))
        return f"{damage.__name__} {path.name}"
    with zipfile.ZipFile(path) as archive:  # what a checksum would hide
        parts = {name: archive.read(name) for name in archive.namelist()}
    heaviest = max(parts, key=lambda name: len(parts[name]))
    chosen = heaviest if random.random() < 0.5 else sorted(parts)[int(random.integers(len(parts)))]
    if random.random() < 0.1:
        del parts[chosen]
    else:
        parts[chosen] = damage(random, parts[chosen])
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in parts.items():
            archive.writestr(name, content)
    return f"{damage.__name__ if chosen in parts else 'leave out'} {chosen}"


def choose_wrong(random, held: dict) -> tuple[str, dict]:
    """Channels of a kind, a size or a name that a laboratory's program might write, for the format's own library."""
    name = sorted(held)[int(random.integers(len(held)))]
    unit, *step, values = held[name]
    place = int(random.integers(len(values)))
    worse = np.array(values, dtype=float)
    worse[place] = random.choice([np.nan, np.inf, -np.inf, 1e308, -1e-320])
    others = {
        "f4": np.float32(values), "i8": np.round(values).astype("i8"), "u1": np.round(values).astype("u1"),
        "complex": values + 0j, "bool": values > 1, "empty": values[:0], "one": values[:1], "short": values[:place],
        "worse": worse, "texts": [repr(x) for x in values.tolist()], "reversed": values[::-1], "still": 0 * values,
        "twice": np.repeat(values, 2), "matrix": np.stack([values] * 3, axis=1), "2-D": values[:, None],
        "big": values.astype(">f8"), "dates": np.datetime64("2024-01-01", "ns") + (values * 1e9).astype("m8[ns]")}
    kinds = sorted(others)
    kind = str(random.choice([*kinds, "unit", "name", "step", "more"]))
    if kind in others:
        return f"{kind} {name}", held | {name: (unit, *step, others[kind])}
    if kind == "unit":
        unit = str(random.choice(["kN", "m", "", "N·s", "?", "%", "N" * 300, "newton", "µs", "\u0000", "s\nN"]))
        return f"unit {unit[:9]!r} of {name}", held | {name: (unit, *step, values)}
    if kind == "step" and step:
        wrong = float(random.choice([0.0, -STEP, 1e-300, np.nan, np.inf, 1e300]))
        return f"step {wrong}", held | {name: (unit, wrong, values)}
    new = str(random.choice(["", " ", "t", "Fz", "Fz ", "force", "a/b", "a" * 300, "µ-ε", "\x1b[31m", "x\ny", "=1+1"]))
    rest = held if kind == "more" else {key: one for key, one in held.items() if key != name}
    return f"{kind} {new[:9]!r}", {**rest, new: held[name]}


def compare_samples(found, truth) -> tuple[str, int, str]:
    """How far samples are from the true ones: the outcome where nothing is known of the damage, cells that differ."""
    if len(found) != len(truth) or set(truth) - set(found):
        return "resized", 0, f"{len(found)} samples of {', '.join(set(found) - {'record'})}"
    apart = {name: int(np.sum(found[name].to_numpy() != truth[name].to_numpy())) for name in truth if name != "record"}
    return ("restated" if sum(apart.values()) else "same"), sum(apart.values()), str(apart)


def try_one(name: str, seed: int, folder: Path, valid: Path, truth) -> Attempt:
    """Damage a copy of a valid file in a folder, and import it."""
    random = np.random.default_rng([zlib.crc32(name.encode()), seed])
    path = folder / name
    shutil.rmtree(path, ignore_errors=True)
    path.unlink(missing_ok=True)
    if random.random() < 0.2:
        write, held = FORMATS[name][0], FORMATS[name][1]()
        done, held = choose_wrong(random, held)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                path = write(path, held)
        except Exception:  # the library does not write such a thing
            return Attempt(done, "same", "not written")
        damaged = 0
    else:
        shutil.copytree(valid, path) if valid.is_dir() else shutil.copy(valid, path)
        done, damaged = damage_file(random, path), 8
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            found = dd.import_tests(path, **CONDITIONS, **UNITLESS.get(name, {})).samples
    except dd.InputError as error:
        sentence = str(error)
        good = str(path) in sentence and sentence.isprintable() and len(sentence) < 1000
        return Attempt(done, "refused" if good else "finding", sentence)
    except BaseException as error:
        return Attempt(done, "finding", "".join(traceback.format_exception(error)[-2:]))
    outcome, count, told = compare_samples(found, truth)
    if outcome != "same" and not damaged:
        outcome = "written"
    return Attempt(done, "touched" if outcome == "restated" and count <= damaged else outcome, told)


def prepare(name: str, folder: Path) -> tuple[Path, object]:
    """A valid file of a format, and the samples that it holds."""
    (folder / "valid").mkdir(parents=True, exist_ok=True)
    valid = FORMATS[name][0](folder / "valid" / name, FORMATS[name][1]())
    truth = dd.import_tests(valid, **CONDITIONS, **UNITLESS.get(name, {})).samples
    assert len(truth) == len(TIME) and truth["normal_force"].max() > 0.5 * trace().max()
    return valid, truth


def work(link, name: str, folder: Path, seed: int, careful: bool) -> None:
    """Try seed after seed in a process that may die, with little memory; the first of them as users do, with files of
    fragile libraries read apart first, where this is the second try.
    """
    import resource

    from ddetumble.measurement import laboratory

    valid, truth = prepare(name, folder)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with open("/proc/self/statm") as pages:
        held = int(pages.read().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    resource.setrlimit(resource.RLIMIT_AS, (int(held + 2 * MEMORY), resource.RLIM_INFINITY))
    probe = laboratory.probe_files
    for number in itertools.count(seed):
        # Without it more files can be tried.
        laboratory.probe_files = probe if careful and number == seed else lambda paths: None
        link.send("begins")
        attempt = try_one(name, number, folder, valid, truth)
        if (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) * 1024 > MEMORY:
            attempt = attempt._replace(outcome="finding", told=f"took more than {MEMORY / 1e9:g} GB: {attempt.told}")
            before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        link.send((number, attempt))


def fuzz(name: str, seconds: float, seed: int, folder: Path) -> list[tuple[int, Attempt]]:
    """Attempts on a format for so many seconds."""
    found, end, again = [], time.monotonic() + seconds, None
    os.environ["DDETUMBLE_MEMORY"] = f"{MEMORY / 1e9:g} GB"
    while time.monotonic() < end:
        mine, other = multiprocessing.Pipe()
        given = (other, name, folder, seed, seed == again)
        process = multiprocessing.get_context("spawn").Process(target=work, args=given)
        process.start()
        other.close()
        died = ""
        patience = 120.0  # s, for the libraries to be imported
        while not died and time.monotonic() < end:
            try:
                said = mine.recv() if mine.poll(patience) else None
            except EOFError:
                process.join()
                died = f"the process died ({process.exitcode})"
                continue
            if said is None:
                died = f"more than {PATIENCE:g} s"
            elif said == "begins":
                patience = PATIENCE
            else:
                found.append(said)
                seed = said[0] + 1
        process.kill()
        process.join()
        if died and patience > PATIENCE:
            raise RuntimeError(f"{name}: not even the valid file can be read")
        if died and again != seed:
            again = seed
        elif died:
            found.append((seed, Attempt("?", "finding", died)))
            seed += 1
    return found


def tell(rows: dict[str, dict], versions: dict[str, str]) -> str:
    """The page: a table of what came of the attempts, and the findings."""
    findings = sum(row["outcomes"].get("finding", 0) for row in rows.values())
    count = sum(sum(row["outcomes"].values()) for row in rows.values())
    lines = [f"# {count} damaged files: {findings or 'no'} finding{'' if findings == 1 else 's'}", "",
             "    python -m docs.fuzz_readers --seconds 180 -o fits/reader-fuzz", "",
             "Files written by each format's own library are damaged and imported: bytes flipped, stretches left out,",
             "written twice, blanked, the end cut off, numbers and words replaced (in .xlsx and .ods also inside of",
             "their parts, with right checksums), and channels of wrong kinds, sizes, units and names that the library",
             "itself writes. A finding is anything but a campaign or one printable sentence that names the file, in",
             "20 s and 2 GB, or a warning. A number, unit or scale that damage turns into another cannot be told from",
             "a measured one where a format has no checksum: the campaign is then another one of the same size.", "",
             f"Python {versions['python']}; other versions are in `result.json`, with examples of each outcome.", "",
             "| file | seconds | " + " | ".join(OUTCOMES.values()) + " |",
             "| --- | ---: |" + " ---: |" * len(OUTCOMES)]
    for name, row in rows.items():
        counts = [str(row["outcomes"].get(one, 0)) for one in OUTCOMES]
        lines.append(f"| {name} | {row['seconds']:.0f} | {' | '.join(counts)} |")
    return "\n".join([*lines, ""])


def main(arguments: list[str] | None = None) -> int:
    """Fuzz the formats one after the other, and write the results after each; 1 where there is a finding."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("formats", nargs="*", default=list(FORMATS), help=f"of {', '.join(FORMATS)}; all if none")
    parser.add_argument("--seconds", type=float, default=180.0, help="for each format")
    parser.add_argument("--seed", type=int, default=0, help="number of the first attempt")
    parser.add_argument("-o", "--output", type=Path, help="folder of the results")
    given = parser.parse_args(arguments)
    path = given.output / "result.json" if given.output else None
    rows = json.loads(path.read_text(encoding="utf-8"))["formats"] if path and path.exists() else {}
    failed = 0
    for name in given.formats:
        with tempfile.TemporaryDirectory() as folder:
            found = fuzz(name, given.seconds, given.seed, Path(folder))
        outcomes = Counter(attempt.outcome for _, attempt in found)
        failed += outcomes["finding"]
        examples = {}
        for number, attempt in found:
            told = attempt.told.replace(folder, "")
            examples.setdefault(attempt.outcome, []).append(f"{number}: {attempt.done}: {told}")
        shown = {one: held[: None if one == "finding" else 5] for one, held in examples.items()}
        rows[name] = {"seconds": given.seconds, "outcomes": outcomes, "examples": shown}
        print(f"{name}: " + ", ".join(f"{outcomes[one]} {one}" for one in OUTCOMES), flush=True)
        for line in examples.get("finding", [])[:20]:
            print("   ", line[-1500:], flush=True)
        if path:
            write_json(path, {"formats": rows, "versions": list_versions()})
            (given.output / "README.md").write_text(tell(rows, list_versions()), encoding="utf-8")
    return int(failed > 0)


if __name__ == "__main__":
    raise SystemExit(main())
