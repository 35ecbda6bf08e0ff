"""Templates of effects: every stage's keeps the contract, and what is written is whole and never in anyone's way."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from ddetumble import InputError, check_effect
from ddetumble.cli import main
from ddetumble.effects import stage_of
from ddetumble.effects.template import LAWS, write_template
from ddetumble.inference.archive import resolve_model
from ddetumble.inference.models import list_effects, resolve_effect


ROOT = Path(__file__).resolve().parents[1]


@pytest.mark.slow
@pytest.mark.parametrize("stage", LAWS)
def test_every_stage_keeps_the_contract(stage, tmp_path):
    """What the template says, unchanged, is an effect."""
    source, _ = write_template("own-law", stage, tmp_path)
    effect = resolve_effect(f"{source}:OwnLaw")
    check_effect(effect).require()
    assert effect.id == "own-law" and stage_of(effect) == stage


@pytest.mark.slow
def test_the_written_test_runs(tmp_path):
    """By pytest, beside the effect."""
    source, test = write_template("rim-stop", folder=tmp_path)
    run = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(test)]
    assert subprocess.run(run, cwd=tmp_path, capture_output=True, check=False).returncode == 0
    source.write_text(source.read_text(encoding="utf-8").replace("self.k * ", "1.0 + self.k * "), encoding="utf-8")
    assert subprocess.run(run, cwd=tmp_path, capture_output=True, check=False).returncode == 1


@pytest.mark.parametrize("name, stage, words", [
    ("Rim", "elastic", "lower-case"), ("../rim", "elastic", "lower-case"),
    ("wall-stiffness", "elastic", "catalogue already has"), ("rim", "elastics", "no stage"),
    ("class", "elastic", "word of Python"),
])  # fmt: skip
def test_bad_names(name, stage, words, tmp_path):
    """One sentence, and nothing written."""
    with pytest.raises(InputError, match=words):
        write_template(name, stage, tmp_path)
    assert not list(tmp_path.iterdir())


def test_nothing_is_overwritten(tmp_path):
    """Not even where only the test is there."""
    (tmp_path / "test_rim.py").write_text("mine", encoding="utf-8")
    with pytest.raises(InputError, match="exists already"):
        write_template("rim", folder=tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["test_rim.py"]


def test_effects_of_a_file(tmp_path):
    """All of them, by id; a name of two is refused."""
    source, _ = write_template("rim-stop", folder=tmp_path)
    other, _ = write_template("soft-pad", "contact", folder=tmp_path)
    both = tmp_path / "both.py"
    both.write_text(source.read_text(encoding="utf-8") + other.read_text(encoding="utf-8").partition("\n")[2],
                    encoding="utf-8")
    assert [effect.id for effect in list_effects(both)] == ["rim-stop", "soft-pad"]
    assert resolve_effect("soft-pad", list_effects(both)).law == "F gains k w"
    (tmp_path / "empty.py").write_text("k = 1.0\n", encoding="utf-8")
    with pytest.raises(InputError, match="no class derived"):
        list_effects(tmp_path / "empty.py")
    with pytest.raises(InputError, match="cannot be read"):
        list_effects(tmp_path / "missing.py")
    both.write_text(source.read_text(encoding="utf-8").replace('"rim-stop"', '"gas-leak"'), encoding="utf-8")
    with pytest.raises(InputError, match="in the catalogue"):
        list_effects(both)


def test_commands_know_own_effects(tmp_path, capsys):
    """--new writes it, --effects-from brings it in by its id, and says what is missing."""
    place = tmp_path / "mine"
    assert main(["effects", "--new", "rim-stop", "-o", str(place)]) == 0
    assert f"--effects-from {place / 'rim_stop.py'}" in capsys.readouterr().out
    assert main(["effects", "--effects-from", str(place / "rim_stop.py")]) == 0
    assert capsys.readouterr().out.startswith("rim_stop.py:\n  rim-stop")
    assert main(["effects", "rim-stop", "--effects-from", str(place / "rim_stop.py")]) == 0
    assert "stage      elastic" in capsys.readouterr().out
    assert main(["effects", "--new", "rim-stop", "-o", str(place)]) == 2
    assert "--overwrite" in capsys.readouterr().err
    assert main(["fit", "impact-f", "--effects-from", str(place / "rim_stop.py")]) == 2
    assert "give with --effect" in capsys.readouterr().err
    assert main(["discover", "impact-f", "--effects-from", str(place / "none.py")]) == 2
    assert "cannot be read" in capsys.readouterr().err


def test_the_tutorial_has_the_files_that_it_ran():
    """Both blocks of Python run when they are pasted, and are what the verdicts beside them were found with."""
    docs = ROOT / "docs"
    page = (docs / "own-effect" / "README.md").read_text(encoding="utf-8")
    blocks = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    for block, file in zip(blocks, (docs / "own-effect" / "rim_stop.py", docs / "end_stop.py"), strict=True):
        assert file.read_text(encoding="utf-8").endswith(f"\n\n{block}")
        exec(compile(block, str(file), "exec"), {"__name__": "pasted"})


@pytest.mark.study
def test_fit_with_an_own_effect(tmp_path, capsys):
    """By its id; the result can be read again."""
    source, _ = write_template("soft-pad", "contact", tmp_path)
    folder = tmp_path / "fit"
    words = ["fit", "data/impact-a", "--effects-from", str(source), "--effect", "soft-pad", "-o", str(folder)]
    assert main(words) == 0
    assert "soft-pad.k" in capsys.readouterr().out
    assert resolve_model(str(folder)).effects[0].id == "soft-pad"
