"""Write `tested.txt`: the versions that the tests passed with, for the oldest Python and for newer ones.

    python constraints/update.py .venv-3.11/bin/python .venv-3.13/bin/python

Only what `pyproject.toml` asks for and what that needs in turn is pinned; no file is named by its address.
"""

import subprocess
import sys
import tomllib
from pathlib import Path


HERE = Path(__file__).resolve().parent
SPLIT = "3.12"  # the first Python with the newer stack
HEADER = """\
# Versions that the tests passed with; used by run.py (pip install -c). Written by constraints/update.py.
# pyproject.toml has the ranges that the package allows.
"""
# Runs in the other interpreter: prints name==version of everything that the requirements in argv lead to.
WALK = """
import sys
from importlib.metadata import PackageNotFoundError, distribution
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

todo, seen, pins = [(Requirement(text), {""}) for text in sys.argv[1:]], set(), {}
while todo:
    requirement, extras = todo.pop()
    if requirement.marker and not any(requirement.marker.evaluate({"extra": extra}) for extra in extras):
        continue
    name, wanted = canonicalize_name(requirement.name), {"", *requirement.extras}
    if (name, frozenset(wanted)) in seen or name == "ddetumble":
        continue
    seen.add((name, frozenset(wanted)))
    try:
        found = distribution(name)
    except PackageNotFoundError:
        print(f"{name} is not installed in {sys.prefix}", file=sys.stderr)
        continue
    pins[name] = found.version
    todo += [(Requirement(text), wanted) for text in found.requires or ()]
print("\\n".join(f"{name}=={version}" for name, version in sorted(pins.items())))
"""


def list_requirements() -> list[str]:
    """Everything that the project itself asks for, extras included."""
    project = tomllib.loads((HERE.parent / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = project["optional-dependencies"].values()
    return [*project["dependencies"], *(text for extra in extras for text in extra)]


def read_versions(python: str) -> dict[str, str]:
    """Versions of what the requirements lead to in one environment, by name."""
    command = [python, "-c", WALK, *list_requirements()]
    lines = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout.split()
    return dict(line.split("==") for line in lines)


def merge_versions(old: dict[str, str], new: dict[str, str]) -> str:
    """Text of the constraints file: one line where both agree, else one for each Python."""
    lines = []
    for name in sorted({**old, **new}):
        if old.get(name) == new.get(name):
            lines.append(f"{name}=={old[name]}")
            continue
        for versions, sign in ((old, "<"), (new, ">=")):
            if name in versions:
                lines.append(f'{name}=={versions[name]} ; python_version {sign} "{SPLIT}"')
    return HEADER + "\n".join(lines) + "\n"


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit("Give two interpreters: of the environment with Python 3.11, and of the one with a newer Python.")
    (HERE / "tested.txt").write_text(merge_versions(*map(read_versions, sys.argv[1:])), encoding="utf-8")
