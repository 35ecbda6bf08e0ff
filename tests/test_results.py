"""Results made again: what counts as the same, what is named as changed, and a command that is run twice."""

import json
import shutil

import pytest

import ddetumble as dd
from ddetumble.cli import main
from ddetumble.cli.places import RECORD, hash_place
from ddetumble.cli.results import compare_files, compare_values, place_output


@pytest.mark.parametrize(("before", "now", "places"), [
    ({"a": 1.0, "b": [1, 2]}, {"b": [1, 2], "a": 1.0 + 1e-9}, []),
    ({"a": 1.0}, {"a": 1.0 + 1e-5}, ["a"]),
    ({"a": 1.0}, {"a": None}, ["a"]),
    ({"a": 0}, {"a": 0.0}, []),
    ({"a": {"b": ["x", "y"]}}, {"a": {"b": ["x", "z"]}}, ["a.b[1]"]),
    ({"a": [1.0, 1e-12]}, {"a": [1.0, -1e-12]}, []),  # rounding beside a number of size 1
    ({"a": 1e-12}, {"a": -1e-12}, ["a"]),
    ({"a": [1.0]}, {"a": [1.0, 2.0]}, ["a"]),
    ({"a": 1}, {"a": 1, "b": 2}, ["b"]),
    ({"versions": {"jax": "1"}, "seconds": 3.0}, {"versions": {"jax": "2"}, "seconds": 4.0}, []),
])  # fmt: skip
def test_what_is_the_same(before, now, places):
    assert [one.place for one in compare_values(before, now)] == places


def test_files_are_compared_by_what_they_hold(tmp_path):
    for name, text in (("a.csv", "x,y\n1.0,a\n2.0,b\n"), ("b.csv", "x,y\n1.00000000001,a\n2,b\n"),
                       ("c.csv", "x,y\n1.0,a\n2.5,b\n"), ("d.html", "<p>"), ("e.html", "<b>")):
        (tmp_path / name).write_text(text)
    assert compare_files(tmp_path / "a.csv", tmp_path / "b.csv", "a.csv") == []
    assert len(compare_files(tmp_path / "a.csv", tmp_path / "c.csv", "a.csv")) == 1
    assert compare_files(tmp_path / "d.html", tmp_path / "e.html", "d.html") == []
    assert len(compare_files(tmp_path / "d.html", tmp_path / "f.html", "d.html")) == 1


def test_a_hash_is_of_names_and_contents(tmp_path):
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "x").write_text("1")
    shutil.copytree(tmp_path / "a", tmp_path / "b")
    (tmp_path / "b" / ".hidden").write_text("2")
    assert hash_place(tmp_path / "a") == hash_place(tmp_path / "b")
    (tmp_path / "b" / "x").rename(tmp_path / "b" / "y")
    assert hash_place(tmp_path / "a") != hash_place(tmp_path / "b")


@pytest.mark.parametrize("words", [["fit", "a", "-o", "x", "--overwrite"], ["fit", "--output=x", "a"],
                                   ["fit", "a", "--output", "x"], ["fit", "a"],
                                   ["fit", "-ox", "a"], ["fit", "a", "--scheduler", "tcp://there", "-o", "x"]])
def test_only_the_place_of_results_changes(words, tmp_path):
    assert place_output(words, tmp_path) == ["fit", "a", "-o", str(tmp_path)]


@pytest.mark.study
def test_a_fit_is_made_again(tmp_path, monkeypatch, capsys):
    """The same numbers; a changed number, a changed campaign and another version are named; a lost campaign is told."""
    monkeypatch.chdir(tmp_path)
    shutil.copytree(dd.find_data() / "slip-c", "own")
    assert main(["fit", "own", "-e", "adhesive-offset", "-o", "out"]) == 0
    assert main(["rerun", "out"]) == 0
    result = json.loads((tmp_path / "out" / "fit.json").read_text())
    name = next(iter(result["parameters"]))
    result["parameters"][name]["estimate"] *= 1.001
    (tmp_path / "out" / "fit.json").write_text(json.dumps(result))
    record = json.loads((tmp_path / "out" / RECORD).read_text())
    record["made"]["fit"]["versions"]["jax"] = "0.0.1"
    (tmp_path / "out" / RECORD).write_text(json.dumps(record))
    (tmp_path / "own" / "note.txt").write_text("later")
    capsys.readouterr()
    assert main(["rerun", "out"]) == 1
    told = capsys.readouterr().out
    assert f"parameters.{name}.estimate" in told and "jax 0.0.1" in told and "own has changed" in told
    shutil.rmtree("own")
    assert main(["rerun", "out"]) == 2


def test_a_folder_of_nothing_is_refused(tmp_path, capsys):
    for content in (None, "{}", "[]", '{"made": {"fit": {}}}'):
        if content is not None:
            (tmp_path / RECORD).write_text(content)
        assert main(["rerun", str(tmp_path)]) == 2
    assert "Traceback" not in capsys.readouterr().err


@pytest.mark.parametrize("words", [["trust", "evil.py"], ["cache", "clear"], ["rerun", "there"], [],
                                   ["discover", "slip-c", "--effects-from", "evil.py"],
                                   ["discover", "slip-c", "--effect=evil.py:Effect"]])
def test_a_folder_from_elsewhere_runs_nothing(words, tmp_path, monkeypatch):
    """Neither other commands nor a Python file that the user never named."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("DDETUMBLE_TRUST", str(tmp_path / "trusted.txt"))
    (tmp_path / "evil.py").write_text("from pathlib import Path\nPath('ran').write_text('yes')\n")
    (tmp_path / "there").mkdir()
    (tmp_path / "there" / RECORD).write_text(json.dumps({
        "files": {"x": []}, "made": {"x": {"words": words, "inputs": {}, "versions": {}}}}))
    assert main(["rerun", "there"]) == 2
    assert not (tmp_path / "ran").exists() and not (tmp_path / "trusted.txt").exists()
