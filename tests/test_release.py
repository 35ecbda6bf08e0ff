"""The release checklist on made-up trees and archives: what is sound passes, and each fault is found."""

import io
import subprocess
import tarfile
import zipfile

import pytest

from docs import release


SOUND = {
    "pyproject.toml": '[project]\nname = "ddetumble"\nversion = "1.2.0"\n',
    "ddetumble/__init__.py": '__version__ = "1.2.0"\n', "CITATION.cff": "title: x\nversion: 1.2.0\n",
    "CHANGELOG.md": "# Changelog\n\n## Unreleased\n\n## 1.2.0\n\n- News.\n",
}
TRACKED = ["ddetumble/__init__.py", "ddetumble/py.typed", "data/a/records.csv", "tests/test_a.py", ".ci/run"]
ABOUT = [f"ddetumble-1.2.0.dist-info/{name}" for name in ("METADATA", "WHEEL", "RECORD", "entry_points.txt",
                                                          "licenses/LICENSE")]
HELD = dict.fromkeys(["ddetumble/__init__.py", "ddetumble/py.typed", "ddetumble/_data/a/records.csv", *ABOUT], "x = 1")
SOURCES = dict.fromkeys(["PKG-INFO", *TRACKED[:-1]], "x = 1")


def lay_out(folder, texts):
    for name, text in texts.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text, encoding="utf-8")
    return folder


def write_wheel(folder, texts):
    path = folder / "ddetumble-1.2.0-py3-none-any.whl"
    with zipfile.ZipFile(path, "w") as archive:
        for name, text in texts.items():
            archive.writestr(name, text)
    return path


def write_sdist(folder, texts):
    path = folder / "ddetumble-1.2.0.tar.gz"
    with tarfile.open(path, "w:gz") as archive:
        for name, text in texts.items():
            about = tarfile.TarInfo(f"ddetumble-1.2.0/{name}")
            about.size = len(text)
            archive.addfile(about, io.BytesIO(text.encode()))
    return path


def test_a_tree_with_something_left(tmp_path):
    subprocess.run(["git", "init", "-q", str(tmp_path)], check=True)
    assert not release.check_tree(tmp_path)
    lay_out(tmp_path, {"left.txt": ""})
    assert len(release.check_tree(tmp_path)) == 1


def test_one_version(tmp_path):
    assert not release.check_versions(lay_out(tmp_path, SOUND))
    for name, old, new in (("ddetumble/__init__.py", "1.2.0", "1.2.01"), ("CITATION.cff", "1.2.0", "1.1.0"),
                           ("CHANGELOG.md", "## 1.2.0", "## 1.1.0"),
                           ("CHANGELOG.md", "Unreleased\n", "Unreleased\n- x"),
                           ("CHANGELOG.md", "## Unreleased\n\n## 1.2.0", "## 1.2.01")):
        lay_out(tmp_path, SOUND | {name: SOUND[name].replace(old, new)})
        (problem,) = release.check_versions(tmp_path)
        assert name in problem
    lay_out(tmp_path, SOUND | {"pyproject.toml": '[project]\nversion = "1.3.0"\n'})
    assert len(release.check_versions(tmp_path)) == 3


@pytest.mark.parametrize("name, text, found", [
    ("ddetumble/py.typed", None, "py.typed"), ("ddetumble/_data/a/records.csv", None, "records.csv"),
    (ABOUT[-1], None, "LICENSE"), ("tests/test_a.py", "", "test_a.py"), ("ddetumble/__pycache__/a.pyc", "", "a.pyc"),
    ("ddetumble/__init__.py", "at = '/" + "home/me/x'", "__init__.py:1"),
    (ABOUT[0], "see https://" + "example.org/simple/ there", "METADATA:1"),
])
def test_what_a_wheel_holds(tmp_path, name, text, found):
    assert not release.check_wheel(write_wheel(tmp_path, HELD), TRACKED)
    texts = {key: value for key, value in (HELD | {name: text}).items() if value is not None}
    (problem,) = release.check_wheel(write_wheel(tmp_path, texts), TRACKED)
    assert found in problem


def test_what_an_sdist_holds(tmp_path):
    assert not release.check_sdist(write_sdist(tmp_path, SOURCES), TRACKED)
    for texts in (SOURCES | {".venv/a": ""}, SOURCES | {"PKG-INFO": "C = '/" + "Users/me/x'"},
                  {name: text for name, text in SOURCES.items() if name != "PKG-INFO"}):
        assert len(release.check_sdist(write_sdist(tmp_path, texts), TRACKED)) == 1


def test_a_command_that_fails(tmp_path):
    (tmp_path / "a.py").write_text("print('why')\nraise SystemExit(3)\n")
    assert release.call(release.sys.executable, "-c", "", place=tmp_path) == []
    assert "why" in release.call(release.sys.executable, "a.py", place=tmp_path)


def test_the_end_tells_whether_all_passed(monkeypatch, capsys):
    for problems, code in (([], 0), (["a file is missing"], 1)):
        monkeypatch.setattr(release, "examine", lambda root, place, found=problems: iter([("x", []), ("y", found)]))
        assert release.main([]) == code
        assert [line.split()[0] for line in capsys.readouterr().out.splitlines() if line.endswith(("x", "y"))] == [
            "passed", "failed" if code else "passed"]
