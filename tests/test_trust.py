"""Python files that only data name: nothing of them runs before the user says so."""

import json

import pytest

import ddetumble as dd
from ddetumble.cli import main


@pytest.fixture
def foreign(tmp_path, monkeypatch):
    """A list of what is trusted that is still empty, and a Python file that leaves a mark where it runs."""
    monkeypatch.setenv("DDETUMBLE_TRUST", str(tmp_path / "home" / "trusted.txt"))
    monkeypatch.setattr("ddetumble._user_files._TRUSTED", set())
    mark, file = tmp_path / "it-ran", tmp_path / "own.py"
    file.write_text(f"from pathlib import Path\nPath({str(mark)!r}).write_text('yes')\nTHING = 1\n", encoding="utf-8")
    return file, mark


def write_campaign(folder, family):
    """A data package that names a kind of tests."""
    folder.mkdir()
    table = {"profile": "tabular-data-resource", "schema": {"fields": [{"name": "record", "type": "string"}]}}
    (folder / "datapackage.json").write_text(json.dumps({
        "name": "foreign", "family": family, "resources": [
            {"name": one, "path": f"{one}.csv", **table} for one in ("records", "samples")]}), encoding="utf-8")
    for one in ("records", "samples"):
        (folder / f"{one}.csv").write_text("record\nr1\n", encoding="utf-8")
    return folder


def test_a_campaign_runs_nothing(foreign, tmp_path, capsys):
    """It is refused, exit 2, until the user has allowed the file; so is another file of that name elsewhere."""
    file, mark = foreign
    folder = write_campaign(tmp_path / "tests", "../own.py:THING")
    with pytest.raises(dd.InputError, match="ddetumble trust"):
        dd.read_campaign(folder)
    assert main(["compare", str(folder)]) == 2 and not mark.exists()
    assert main(["trust", str(file)]) == 0 and not mark.exists()  # allowed, not run
    with pytest.raises(dd.InputError, match="THING"):  # it ran, and holds no kind of tests
        dd.read_campaign(folder)
    assert mark.exists()
    mark.unlink()
    (tmp_path / "elsewhere").mkdir()
    changed = tmp_path / "elsewhere" / "own.py"
    changed.write_text(file.read_text(encoding="utf-8") + "MORE = 2\n", encoding="utf-8")
    with pytest.raises(dd.InputError, match="ddetumble trust"):
        dd.read_campaign(write_campaign(tmp_path / "elsewhere" / "tests", "../own.py:THING"))
    assert not mark.exists()
    assert main(["trust", str(tmp_path / "nothing.py")]) == 2
    capsys.readouterr()


def test_what_the_user_names_is_run(foreign, tmp_path):
    """And may be run by data from then on."""
    file, mark = foreign
    with pytest.raises(dd.InputError, match="THING"):
        dd.compare("impact-a", f"{file}:THING")
    assert mark.exists()
    with pytest.raises(dd.InputError, match="not a kind of tests"):
        dd.read_campaign(write_campaign(tmp_path / "tests", "../own.py:THING"))


@pytest.mark.slow
@pytest.mark.parametrize("where", ["model", "effect"])
def test_a_saved_model_runs_nothing(foreign, tmp_path, where):
    """Neither its reference model's file nor that of an effect, where these came from elsewhere."""
    file, mark = foreign
    dd.fit("impact-a", dd.Ball()).save(tmp_path / "fit")
    path = tmp_path / "fit" / "model.json"
    saved = json.loads(path.read_text(encoding="utf-8"))
    if where == "model":
        saved |= {"model": "../own.py:THING", "model_sha256": "0" * 64}
    else:
        saved["effects"] = [{"id": "mine", "source": "../own.py:THING", "source_sha256": "0" * 64}]
    path.write_text(json.dumps(saved), encoding="utf-8")
    with pytest.raises(dd.InputError, match="ddetumble trust"):
        dd.load(tmp_path / "fit")
    assert not mark.exists()
