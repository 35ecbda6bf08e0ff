"""Is this commit ready to publish? A checklist, which builds and tries everything and publishes nothing.

    python3 run.py release

A clean clone of the commit is built, the archives are looked into, and wheel and sdist are installed into empty
environments outside of the checkout, where they have to work by themselves. Each item is printed as passed or failed;
the command ends with 1 where one failed.
"""

import argparse
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tempfile
import tomllib
import zipfile
from collections.abc import Iterator
from pathlib import Path

import run


ROOT = Path(__file__).resolve().parent.parent
LIMIT = 3600  # s for a step: the demonstration compiles its programs, and an installation may be slow
NOTEBOOKS = ("01-from-records-to-a-verdict", "02-the-loop-by-hand")
LEFT_OUT = (".ci/",)  # of the sdist: what concerns the repository alone
MACHINE = re.compile(  # places of a machine's user, and addresses of single archives or of an index
    r"(?<![\w.])/(?:home|Users)/(?!runner\b)\w+/|(?<![\w.])/(?:root|work)/\w"
    r"|https?://[^\s\"'<>)]+(?:\.whl|\.tar\.gz|\.tgz|/simple/?)(?=[\s\"'<>)]|$)")
USE = """
import sys
from pathlib import Path
import ddetumble as dd
place = Path(dd.__file__).resolve()
assert place.is_relative_to(Path(sys.prefix).resolve()), place
assert not [one for one in sys.path if Path(one, "pyproject.toml").is_file()], sys.path
assert (place.parent / "py.typed").is_file() and dd.find_data().is_relative_to(place.parent)
"""
COMPARE = "print(dd.compare(dd.read_campaign('impact-b'), dd.Ball()))"


def check_tree(root: Path) -> list[str]:
    """Files of a checkout that are not committed."""
    return read_git(root, "status", "--porcelain").splitlines()


def check_versions(root: Path) -> list[str]:
    """Files that state another version than pyproject.toml does, and a change log that does not tell of it."""
    version = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
    stated = {"ddetumble/__init__.py": rf'^__version__ = "{re.escape(version)}"$',
              "CITATION.cff": rf"^version: {re.escape(version)}$",
              "CHANGELOG.md": rf"^## \[?{re.escape(version)}\b"}
    problems = [f"{name} does not state version {version}" for name, pattern in stated.items()
                if not re.search(pattern, (root / name).read_text(encoding="utf-8"), re.MULTILINE)]
    log = (root / "CHANGELOG.md").read_text(encoding="utf-8")
    waiting = re.search(r"^## \[?Unreleased\b[^\n]*\n(.*?)(?=^## |\Z)", log, re.MULTILINE | re.DOTALL)
    if waiting and waiting[1].strip():
        problems.append(f"CHANGELOG.md has lines under Unreleased; put them under {version}")
    return problems


def compare_names(held: set[str], wanted: set[str]) -> list[str]:
    """Names that an archive lacks, and those that it holds beside them."""
    return [f"{name} is missing" for name in sorted(wanted - held)] + [
        f"{name} does not belong there" for name in sorted(held - wanted)]


def check_wheel(wheel: Path, tracked: list[str]) -> list[str]:
    """What a wheel lacks of the package and its data, and what else it holds."""
    wanted = {name for name in tracked if name.startswith("ddetumble/")}
    wanted |= {f"ddetumble/_data/{name.removeprefix('data/')}" for name in tracked if name.startswith("data/")}
    about = f"{'-'.join(wheel.name.split('-')[:2])}.dist-info/"
    wanted |= {about + name for name in ("METADATA", "WHEEL", "RECORD", "entry_points.txt", "licenses/LICENSE")}
    texts = read_wheel(wheel)
    return compare_names(set(texts), wanted) + find_machines(texts)


def check_sdist(sdist: Path, tracked: list[str]) -> list[str]:
    """What a source archive lacks of the commit, and what else it holds."""
    texts = read_sdist(sdist)
    wanted = {name for name in tracked if not name.startswith(LEFT_OUT)} | {"PKG-INFO"}
    return compare_names(set(texts), wanted) + find_machines(texts)


def read_wheel(path: Path) -> dict[str, bytes]:
    """Content of the files in a wheel, by name."""
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist() if not name.endswith("/")}


def read_sdist(path: Path) -> dict[str, bytes]:
    """Content of the files in a source archive, by name below its one folder."""
    with tarfile.open(path) as archive:
        return {one.name.partition("/")[2]: file.read() for one in archive if (file := archive.extractfile(one))}


def find_machines(texts: dict[str, bytes]) -> list[str]:
    """Lines of text files that name a place of a machine, or an address of a package index."""
    found = []
    for name, content in texts.items():
        if b"\0" not in content:
            for number, line in enumerate(content.decode("utf-8", "replace").splitlines(), 1):
                if MACHINE.search(line):
                    found.append(f"{name}:{number}: {line.strip()[:100]}")
    return found


def read_git(root: Path, *words: str) -> str:
    """What git prints."""
    return subprocess.run(["git", *words], cwd=root, check=True, capture_output=True, text=True, encoding="utf-8"
                          ).stdout


def call(*command: str | Path, place: Path) -> list[str]:
    """Run a command outside of the checkout; the end of what it printed where it failed."""
    try:
        done = subprocess.run(list(map(str, command)), cwd=place, env=run.environment(), stdin=subprocess.DEVNULL,
                              capture_output=True, encoding="utf-8", errors="replace", timeout=LIMIT)
    except subprocess.TimeoutExpired:
        return [f"{command[0]} has not ended after {LIMIT} s"]
    return [] if done.returncode == 0 else [f"{Path(command[0]).name} ended with {done.returncode}",
                                            *(done.stdout + done.stderr).strip().splitlines()[-8:]]


def make_environment(folder: Path, *wanted: str) -> list[str]:
    """Make an empty environment and install something into it; what went wrong."""
    return call(sys.executable, "-m", "venv", folder, place=folder.parent) or call(
        run.locate_python(str(folder)), "-m", "pip", "install", "-q", *wanted, place=folder.parent)


def examine(root: Path, place: Path) -> Iterator[tuple[str, list[str]]]:
    """Every item with what is wrong; ends early where what follows would make no sense."""
    yield "everything is committed", check_tree(root)
    yield "one version everywhere", check_versions(root)
    clone, tracked = place / "clone", read_git(root, "ls-files").splitlines()
    read_git(root, "clone", "-q", "--no-checkout", str(root), str(clone))
    read_git(clone, "checkout", "-q", read_git(root, "rev-parse", "HEAD").strip())
    problems = make_environment(place / "tools", "build", "twine") or call(
        run.locate_python(str(place / "tools")), "-m", "build", "-o", place / "dist", clone, place=place)
    yield "wheel and sdist are built from a clean clone", problems
    if problems:
        return
    (wheel,), (sdist,) = (place / "dist").glob("*.whl"), (place / "dist").glob("*.tar.gz")
    shutil.rmtree(clone)  # nothing below may lean on it
    yield f"the wheel holds the package and its data ({wheel.stat().st_size / 1e6:.1f} MB)", check_wheel(wheel, tracked)
    yield f"the sdist holds the commit ({sdist.stat().st_size / 1e6:.1f} MB)", check_sdist(sdist, tracked)
    yield "the metadata are sound", call(
        run.locate_python(str(place / "tools")), "-m", "twine", "check", "--strict", wheel, sdist, place=place)
    for kind, archive, code in (("sdist", sdist, USE), ("wheel", wheel, USE + COMPARE)):
        python = Path(run.locate_python(str(place / kind)))
        problems = make_environment(place / kind, str(archive))
        yield f"the {kind} is installed into an empty environment", problems
        if problems:
            continue
        yield f"the {kind}'s requirements are met", call(python, "-m", "pip", "check", place=place)
        yield f"the {kind} is imported outside of the checkout", call(python, "-I", "-c", code, place=place)
    if problems:
        return
    command = shutil.which("ddetumble", path=python.parent) or "ddetumble"
    for words in (["--help"], ["--version"], ["demo", "-o", str(place / "demo")]):
        yield f"ddetumble {words[0]} runs from the wheel", call(command, *words, place=place)
    problems = call(python, "-m", "pip", "install", "-q", f"{wheel}[notebooks]", place=place)
    yield "the wheel's extra `notebooks` is installed", problems
    for name in () if problems else NOTEBOOKS:
        (place / "notebooks").mkdir(exist_ok=True)
        shutil.copy(root / "notebooks" / f"{name}.ipynb", place / "notebooks")
        yield f"notebook {name} runs from the wheel", call(
            python.with_name("jupyter-execute"), f"{name}.ipynb", place=place / "notebooks")


def main(arguments: list[str] | None = None) -> int:
    """Go through the checklist; 1 where an item failed."""
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
                            ).parse_args(arguments)
    failed = 0
    with tempfile.TemporaryDirectory(prefix="ddetumble-release-", ignore_cleanup_errors=True) as place:
        for name, problems in examine(ROOT, Path(os.path.realpath(place))):
            failed += bool(problems)
            print("\n        ".join((f"{'failed' if problems else 'passed'}  {name}", *problems)), flush=True)
    print(f"Not ready: {failed} failed." if failed else "Ready to publish; nothing was uploaded.")
    return int(failed > 0)


if __name__ == "__main__":
    raise SystemExit(main())
