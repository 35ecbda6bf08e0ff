"""The project as a whole: lint, types, layers, sizes, what is imported when, and what README promises."""

import ast
import graphlib
import importlib.util
import os
import re
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest
import typer

from ddetumble.cli import app
from docs.release import MACHINE


ROOT = Path(__file__).resolve().parent.parent
PAGES = ("README.md", "CONTRIBUTING.md", *(f"docs/{path.relative_to(ROOT / 'docs').as_posix()}"
                                           for path in sorted((ROOT / "docs").rglob("*.md"))))
PACKAGE = ROOT / "ddetumble"
MODULES = sorted(PACKAGE.rglob("*.py"))
LAYERS = (
    {"_display", "_errors", "_lazy", "_numerics", "_rotation", "_settings", "_user_files"},
    {"contact"},
    {"reference_models"},
    {"effects"},
    {"dynamics"},
    {"measurement", "_sentences"},
    {"families"},
    {"inference"},
    {"posterior"},
    {"selection", "reconstruct"},
    {"planning"},
    {"reports", "figures", "paper", "demo"},
    {"exam"},
    {"workbench"},
    {"cli"},
)
# Comparisons with the name of a family of tests; what is compared with "slip" may be the channel of that name.
NAMED_FAMILY = re.compile(
    r"""family(\.name)? (==|!=|in |not in [(\[{])|(==|!=) "(impact|oblique|tumble)"|== "slip\""""
)
FAMILY_NAMES = {"impact", "slip", "oblique", "tumble"}
HEAVY = {"jax", "jaxlib", "equinox", "diffrax", "numpy", "scipy", "pandas", "pint", "pydantic", "matplotlib", "rich"}


def run(*arguments, **options):
    """Run this Python with arguments; returns the finished process, its output as text."""
    return subprocess.run([sys.executable, *arguments], cwd=ROOT, capture_output=True, text=True, **options)


def list_files():
    """Files that are, or would be, committed."""
    command = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    names = subprocess.run(command, cwd=ROOT, capture_output=True, text=True).stdout.split("\0")
    return [path for name in sorted(set(names) - {""}) if (path := ROOT / name).is_file()]


def read_texts():
    """Texts of the files under version control by path; binary files are left out."""
    texts = {}
    for path in list_files():
        try:
            texts[path] = path.read_text(encoding="utf-8")
        except UnicodeDecodeError:
            continue
    return texts


def list_imports(path, modules=()):
    """Dotted names of all modules that a file imports, at its top or inside functions.

    Of `modules`, a name that is one is meant itself, not the package that it is imported from.
    """
    inside = path.relative_to(ROOT).with_suffix("").parts
    here = inside if path.name == "__init__.py" else inside[:-1]
    here = here[:-1] if path.name == "__init__.py" else here
    found = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = here[: len(here) - node.level + 1] if node.level else ()
            module = [*base, *(node.module.split(".") if node.module else [])]
            whole = [".".join([*module, alias.name]) for alias in node.names]
            inside_it = [name for name in whole if name in modules]
            found += inside_it or ([".".join(module)] if node.module else whole)
    return found


def name_layer(module):
    """The part of the package that a module belongs to: "ddetumble.contact.gas" to "contact"."""
    parts = module.split(".")
    return parts[1] if parts[0] == "ddetumble" and len(parts) > 1 else None


def read_blocks(path, language):
    """Code blocks of a Markdown file in one language."""
    return re.findall(rf"^```{language}\n(.*?)^```", path.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)


def test_lint():
    """Ruff: errors, imports, outdated syntax, likely bugs, a docstring for everything public."""
    done = run("-m", "ruff", "check", "--no-cache", "--output-format=concise", ".")
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.slow
def test_types():
    """Pyright finds nothing in the package."""
    done = run("-m", "pyright", "--pythonpath", sys.executable)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize("path", MODULES, ids=lambda path: path.relative_to(PACKAGE).as_posix())
def test_layers(path):
    """A module imports from its own layer and those below it only."""
    order = {name: level for level, names in enumerate(LAYERS) for name in names}
    own = path.relative_to(PACKAGE).parts[0].removesuffix(".py")
    if own in ("__init__", "__main__"):
        return
    assert own in order, f"{own} stands in no layer; add it to LAYERS"
    for module in list_imports(path):
        other = name_layer(module)
        if other not in (None, own):
            assert other in order, f"{module} stands in no layer"
            assert order[other] <= order[own], f"{own} must not import {module}"


def test_no_module_imports_itself():
    """No circle of imports, those inside functions included, from module to module."""
    names = {}
    for path in MODULES:
        parts = path.relative_to(ROOT).with_suffix("").parts
        names[".".join(parts[:-1] if path.name == "__init__.py" else parts)] = path
    graph = {}
    for name, path in names.items():
        if name == "ddetumble":
            continue  # its names are imported when they are used
        own = set(list_imports(path, names))
        graph[name] = {module for module in own & set(names) if module not in ("ddetumble", name)}
    graphlib.TopologicalSorter(graph).prepare()


def test_families_are_not_asked_for_by_name():
    """What differs between kinds of tests is asked of the family, which alone knows its name."""
    own = {PACKAGE / "measurement" / "kinds.py", *(PACKAGE / "families").glob("*.py")}
    naming = {path.relative_to(PACKAGE).as_posix(): match[0] for path in MODULES if path not in own
              if (match := NAMED_FAMILY.search(path.read_text(encoding="utf-8")))}
    assert not naming, f"give `Family` or `RecordKind` what is asked here: {naming}"


def find_tables(tree):
    """Lines of tables of families: literals that hold two of their names, and defaults of what is called a family."""
    for node in ast.walk(tree):
        if isinstance(node, (ast.Dict, ast.Tuple, ast.List, ast.Set)):
            held = node.keys if isinstance(node, ast.Dict) else node.elts
            if len(FAMILY_NAMES & {one.value for one in held if isinstance(one, ast.Constant)}) > 1:
                yield node.lineno
        elif isinstance(node, ast.arguments):
            given = [*zip([*node.posonlyargs, *node.args][::-1], node.defaults[::-1], strict=False),
                     *zip(node.kwonlyargs, node.kw_defaults, strict=True)]
            yield from (one.lineno for one, value in given
                        if one.arg == "family" and isinstance(value, ast.Constant) and value.value in FAMILY_NAMES)
        elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name) and node.target.id == "family":
            named = isinstance(node.value, ast.Constant) and node.value.value in FAMILY_NAMES
            if named and "ClassVar" not in ast.dump(node.annotation):  # a model or an effect says what it is of
                yield node.lineno


def test_no_table_of_families():
    """Nothing is looked up by a family's name but in the families themselves."""
    own = {PACKAGE / "measurement" / "kinds.py", *(PACKAGE / "families").glob("*.py")}
    found = {path.relative_to(PACKAGE).as_posix(): lines for path in MODULES if path not in own
             if (lines := list(find_tables(ast.parse(path.read_text(encoding="utf-8")))))}
    assert not found, f"let `Family` or `RecordKind` hold what is looked up here: {found}"


def test_measurement_stands_alone():
    """Campaigns are read without JAX and without any model."""
    wrong = {"jax", "equinox", "diffrax"}, {"contact", "effects", "dynamics", "_numerics", "_rotation"}
    for path in (PACKAGE / "measurement").rglob("*.py"):
        for module in list_imports(path):
            assert module.split(".")[0] not in wrong[0] and name_layer(module) not in wrong[1], f"{path.name}: {module}"


def test_second_simulator_stands_alone():
    """The exam's simulators share nothing with the package: each imports its neighbours, NumPy, SciPy and Python."""
    folder = PACKAGE / "exam" / "simulators"
    allowed = {"numpy", "scipy", *sys.stdlib_module_names}
    for path in folder.glob("*.py"):
        for module in list_imports(path):
            beside = module.startswith("ddetumble.exam.simulators.")
            assert beside or module.split(".")[0] in allowed, f"{path.name}: {module}"


@pytest.mark.parametrize("path", MODULES, ids=lambda path: path.relative_to(PACKAGE).as_posix())
def test_module(path):
    """Annotations are not turned into text, which breaks abstract attributes."""
    text = path.read_text(encoding="utf-8")
    assert not re.search(r"^from __future__ import .*annotations", text, re.MULTILINE)


def test_no_machine_in_files():
    """No path of a machine, no address of a registry, no lock file."""
    here = str(ROOT.parent) + os.sep
    wrong = []
    for path, text in read_texts().items():
        for number, line in enumerate(text.splitlines(), 1):
            if MACHINE.search(line) or (len(ROOT.parts) > 2 and here in line):
                wrong.append(f"{path.relative_to(ROOT)}:{number}: {line.strip()[:100]}")
    assert not wrong, "\n".join(wrong)
    assert not [path for path in list_files() if path.name in ("uv.lock", "poetry.lock", "package-lock.json")]


def test_constraints_cover_dependencies():
    """Every requirement is pinned for every Python, without an address."""
    pins = (ROOT / "constraints" / "tested.txt").read_text(encoding="utf-8").splitlines()
    pinned = {re.split(r"[=;]", line)[0].strip() for line in pins if not line.startswith("#")}
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    wanted = [*project["dependencies"], *sum(project["optional-dependencies"].values(), [])]
    names = {re.split(r"[\[<>=]", text)[0].lower() for text in wanted} - {"ddetumble"}
    assert names <= pinned, sorted(names - pinned)
    assert not any("://" in line or " @ " in line for line in pins if not line.startswith("#"))


def test_imports_are_lazy():
    """Importing the package or its command line imports nothing heavy."""
    done = run("-c", "import sys, ddetumble, ddetumble.cli; print(*{name.split('.')[0] for name in sys.modules})")
    assert done.returncode == 0, done.stderr
    assert not HEAVY & set(done.stdout.split()), HEAVY & set(done.stdout.split())


def test_discover_imports_what_it_needs():
    """A discovery and its report start without what only other commands, or unusual units, need."""
    done = run("-c", "import sys, ddetumble.selection.discover, ddetumble.selection.compare\n"
                     "from ddetumble import read_campaign\n"
                     "from ddetumble.reports import report_comparison, write_report\n"
                     "read_campaign('data/impact-a')\n"
                     "print(*sys.modules)")
    assert done.returncode == 0, done.stderr
    unneeded = {"pint", "scipy.stats", "emcee", "ddetumble.posterior.result", "ddetumble.planning.plan"}
    assert not unneeded & set(done.stdout.split()), unneeded & set(done.stdout.split())


@pytest.mark.parametrize("name", PAGES)
def test_documented_commands_exist(name):
    """Every command in a code block of the documentation is one that exists."""
    known = set(typer.main.get_command(app).commands)  # pyright: ignore
    blocks = "".join(read_blocks(ROOT / name, "(?:sh|console|bash)?"))
    used = set(re.findall(r"^\s*(?:\$ )?ddetumble ([a-z]+)", blocks, re.MULTILINE))
    used |= set(re.findall(r"run\.py (?:--python \S+ )?([a-z]+)", blocks))
    known |= {"test", "setup", "pythons", "notebook", "site", "release"}  # of run.py itself
    assert used <= known, used - known


def test_readme_has_both_commands():
    """README's two commands are those of run.py, and CI calls the second."""
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert "python3 run.py demo" in readme and "python3 run.py test" in readme
    assert "python3 run.py test" in (ROOT / ".ci" / "run").read_text(encoding="utf-8")


def test_pages_of_keys_are_current(tmp_path):
    """They list the keys that are read, each with its meaning, and what they show can be read."""
    from ddetumble.inference.specification import read_specification
    from ddetumble.planning.scenario import pose_problem
    from ddetumble.planning.scenario_file import read_scenario
    from docs.file_pages import FIT, FOLDER, SCENARIO, write_pages

    examples = {}
    for name, text in write_pages().items():
        assert (FOLDER / name).read_text(encoding="utf-8") == text
        examples[name] = tmp_path / name.replace(".md", ".toml")
        examples[name].write_text(re.findall(r"```toml\n(.*?)```", text, re.DOTALL)[0], encoding="utf-8")
    assert float(pose_problem(read_scenario(examples["scenario.md"]), tmp_path).angular_velocity[0]) == 0.05
    assert read_specification(examples["fit.md"])[0].priors["restitution"].sd == 0.05
    tables = dict((*FIT, *SCENARIO))
    assert all(field.description or key in tables for one in tables.values() for key, field in one.model_fields.items())


def list_printed():
    """Pages with Python in them; README's runs in every test, what the others print is a study."""
    paths = ROOT / "README.md", ROOT / "docs" / "index.md", *sorted((ROOT / "docs" / "guide").glob("*.md"))
    return [pytest.param(path, id=path.stem, marks=pytest.mark.slow if path == paths[0] else pytest.mark.study)
            for path in paths if read_blocks(path, "python")]


@pytest.mark.parametrize("path", list_printed())
def test_printed_python_runs(path, tmp_path, monkeypatch):
    """The Python of a page of README, front page and guide runs as it stands."""
    blocks = read_blocks(path, "python")
    if path.name == "README.md":
        assert blocks.pop() in (ROOT / "docs" / "end_stop.py").read_text(encoding="utf-8")  # run by test_discover.py
    (tmp_path / "data").symlink_to(ROOT / "data", target_is_directory=True)
    monkeypatch.chdir(tmp_path)
    exec(compile("\n".join(blocks), str(path), "exec"), {"__name__": "page"})


@pytest.mark.slow
def test_wheel_holds_data(tmp_path):
    """An installed wheel finds the data packages that a checkout has under `data/`."""
    done = run("-m", "pip", "wheel", "--no-deps", "--quiet", "--wheel-dir", str(tmp_path), ".", timeout=600)
    assert done.returncode == 0, done.stderr
    (wheel,) = tmp_path.glob("*.whl")
    zipfile.ZipFile(wheel).extractall(tmp_path / "site")
    code = "from ddetumble._settings import find_data as f; print(f())"
    found = subprocess.run(
        [sys.executable, "-P", "-c", code], cwd=tmp_path, env={**os.environ, "PYTHONPATH": str(tmp_path / "site")},
        capture_output=True, text=True,
    )  # fmt: skip
    data = Path(found.stdout.strip())
    assert data == tmp_path / "site" / "ddetumble" / "_data"
    names = {path.relative_to(data) for path in data.rglob("datapackage.json")}
    assert names == {path.relative_to(ROOT / "data") for path in (ROOT / "data").rglob("datapackage.json")}
    assert (tmp_path / "site" / "ddetumble" / "py.typed").is_file()


def test_launcher_lists_interpreters():
    """run.py finds at least the Python that runs this test, and each line is a version and a path."""
    done = run("run.py", "pythons")
    assert done.returncode == 0, done.stderr
    assert all(re.match(r"3\.\d+\.\d+ +\S", line) for line in done.stdout.splitlines())


@pytest.mark.parametrize(
    "arguments, says",
    [
        (["--python", "no-such-python", "demo"], "no-such-python is no Python that runs"),
        (["--python", "3.99", "demo"], "No Python 3.99 was found"),
        (["--python"], "needs a version or a path"),
    ],
)
def test_launcher_refuses(arguments, says):
    """run.py explains what it cannot do and sets nothing up."""
    done = run("run.py", *arguments)
    assert done.returncode == 2 and says in done.stderr and "Traceback" not in done.stderr


def test_launcher_opens_notebooks(monkeypatch, tmp_path):
    """`run.py notebook` sets JupyterLab up and starts it among the notebooks; where it lacks, it names the extra."""
    spec = importlib.util.spec_from_file_location("launcher", ROOT / "run.py")
    launcher = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(launcher)
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert any(text.startswith("jupyterlab") for text in project["optional-dependencies"][launcher.EXTRAS["notebook"]])
    wanted, calls = [], []
    monkeypatch.setattr(launcher, "choose_interpreter", lambda wanted: None)
    monkeypatch.setattr(launcher, "set_up", lambda _, extra: wanted.append(extra) or str(tmp_path / "env"))

    def call(command, **options):
        calls.append((command[1:], options.get("cwd")))
        return missing

    monkeypatch.setattr(launcher.subprocess, "call", call)
    missing = 0
    assert launcher.main(["notebook", "--no-browser"]) == 0 and wanted == ["lab"]
    assert calls[-1] == (["-m", "jupyterlab", "--no-browser"], str(ROOT / "notebooks"))
    missing = 1
    with pytest.raises(launcher.SetupError, match="the extra `lab`"):
        launcher.main(["notebook"])
    assert len(calls) == 3  # nothing was started


def test_launcher_builds_the_site(monkeypatch, tmp_path, capsys):
    """`run.py site` sets the generator up and builds strictly; the path is told only of a site that was built."""
    spec = importlib.util.spec_from_file_location("launcher", ROOT / "run.py")
    launcher = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(launcher)
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert any(text.startswith("sphinx") for text in project["optional-dependencies"][launcher.EXTRAS["site"]])
    monkeypatch.setattr(launcher, "choose_interpreter", lambda wanted: None)
    monkeypatch.setattr(launcher, "set_up", lambda _, extra: str(tmp_path))
    calls, code = [], [0]
    monkeypatch.setattr(launcher.subprocess, "call", lambda command, **_: calls.append(command) or code[0])
    for failed in (0, 2):
        code[0] = failed
        assert launcher.main(["site", "-E"]) == failed
        assert calls[-1][1:3] == ["-m", "sphinx"] and {"-W", "-E"} <= set(calls[-1])
        assert capsys.readouterr().out.strip() == ("" if failed else str(ROOT / "build" / "site" / "index.html"))


def test_launcher_speaks_old_python():
    """run.py is understood by Python 3.6: no newer syntax."""
    ast.parse((ROOT / "run.py").read_text(encoding="utf-8"), feature_version=(3, 6))
