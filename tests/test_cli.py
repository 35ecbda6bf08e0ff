"""The command line: help, exit codes, one sentence for every failure, quiet where nobody watches."""

import dataclasses as dc
import errno
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
import typer

import ddetumble as dd
from ddetumble._display import nest_progress, tell_left
from ddetumble._errors import ComputationError, InputError
from ddetumble._settings import find_data, list_shipped
from ddetumble.cli import app, main
from ddetumble.cli.failures import run_guarded
from ddetumble.cli.places import locate_campaign, write_table
from ddetumble.cli.progress import show_progress
from ddetumble.families import find_family
from ddetumble.selection.verdict_facts import list_notes
from tests.helpers_report import make_slip_discovery


ROOT = Path(__file__).resolve().parent.parent
COMMANDS = sorted(typer.main.get_command(app).commands)  # pyright: ignore


def call(*arguments, **options):
    """Run the command in a process of its own; returns the finished process, its output as text."""
    command = [sys.executable, "-m", "ddetumble", *map(str, arguments)]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, **options)


def assert_sentence(text):
    """One line that starts with the program's name, and no traceback."""
    assert text.startswith("ddetumble: ") and text.count("\n") == 1 and "Traceback" not in text, text


def write_raw(path, lines=200):
    """Write a laboratory's file: half a sine after a quiet start, decimal commas, no word on the conditions."""
    rows = ["t (ms);Fz [N]"]
    for i in range(lines):
        force = 40 * max(0.0, 1 - ((i - 100) / 40) ** 2) + 0.1 * (i * 7919 % 11 - 5) / 5
        rows.append(f"{0.25 * i:.2f};{force:.4f}".replace(".", ","))
    path.write_text("\n".join(rows) + "\n", encoding="utf-8")


@pytest.mark.parametrize("command", COMMANDS)
def test_help(command, capsys):
    """Every command explains itself, with an example."""
    assert main([command, "--help"]) == 0
    text = capsys.readouterr().out
    assert f"Usage: ddetumble {command}" in text and "Example" in text and f"ddetumble {command} " in text


def test_help_states_the_effort_that_is_the_default(capsys):
    assert main(["discover", "--help"]) == 0
    words = " ".join(capsys.readouterr().out.split())
    assert f" {dd.SelectionSettings().effort}. " in words[words.index("--effort"): words.index("--keep-all")]


def test_help_lists_commands(capsys):
    """Without a command, the help; it lists all of them."""
    assert main([]) == 0
    text = capsys.readouterr().out
    assert all(f"\n  {command} " in text for command in COMMANDS)


@pytest.mark.parametrize(
    "arguments",
    [
        ["no-such-command"],
        ["compare"],
        ["compare", "a", "b"],
        ["compare", "--no-such-option"],
        ["compare", "no-such-campaign"],
        ["compare", "/no/such/campaign"],
        ["identify", "no-such-campaign"],
        ["discover", "no-such-campaign", "-o", "never"],
        ["discover", "impact-a", "--effort", "0"],
        ["discover", str(find_data() / "impact-a"), "--effect", "wall-stiffness"],
        ["discover", "impact-a", "-o", "never", "--output", "other"],
        ["import", "file", "--sheet", "a", "--sheet", "b"],
        ["fit", "no-such-campaign"],
        ["fit", "specification.toml", "--model", "paper"],
        ["fit", "specification.toml", "--effect", "wall-stiffness"],
        ["predict", "no-such-folder", "conditions.csv"],
        ["import", "no-such-file.csv", "-o", "never"],
        ["import", "no-such-file.csv"],
        ["effects", "no-such-effect"],
        ["effects", "--family", "no-such-family"],
        ["paper", "-o", "file"],
        ["demo", "-o", "file/inside"],
        ["cache", "no-such-action"],
    ],
    ids=" ".join,
)
def test_bad_input(arguments, capsys, monkeypatch, tmp_path):
    """Bad input: exit code 2 and one sentence; nothing is written."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").touch()
    assert main(arguments) == 2
    output = capsys.readouterr()
    assert_sentence(output.err)
    assert output.out == "" and os.listdir(tmp_path) == ["file"]


def test_a_misspelt_command_is_told_the_right_one(capsys):
    assert main(["cmpare", "impact-b"]) == 2
    told = capsys.readouterr().err
    assert_sentence(told)
    assert "compare'? `" in told


@pytest.mark.parametrize("words", [["-m"], ["--free"], ["--bogus", "1"], []])
def test_a_wrong_command_line_names_the_help_of_its_command(capsys, words):
    assert main(["fit", *(["impact-a"] if words else []), *words]) == 2
    text = capsys.readouterr().err
    assert_sentence(text)
    assert "ddetumble fit --help" in text


def test_a_folder_of_raw_files_is_to_be_imported(capsys, tmp_path):
    write_raw(tmp_path / "run.csv")
    assert main(["discover", str(tmp_path), "-o", str(tmp_path / "out")]) == 2
    assert "`ddetumble import`" in capsys.readouterr().err and not (tmp_path / "out").exists()


@pytest.mark.study
def test_the_demo_ends_with_a_plan(tmp_path, capsys):
    """The whole story as the README has it: discovery, and a strike with what was learnt."""
    assert main(["demo", "-o", str(tmp_path / "demo")]) == 0
    told = capsys.readouterr().out
    found = json.loads((tmp_path / "demo" / "discovery" / "result.json").read_text(encoding="utf-8"))
    for folder in ("discovery", "plan"):
        assert (tmp_path / "demo" / folder / "report.html").stat().st_size > 10_000, folder
    plan = json.loads((tmp_path / "demo" / "plan" / "plan.json").read_text(encoding="utf-8"))
    assert plan["possible"] and 0.0 < plan["share_left"] < 0.8 and plan["uncertainty"]
    assert found["verdict"] == "explained"
    assert str(tmp_path / "demo" / "discovery" / "report.html") in told.strip().splitlines()[-1]


def test_process():
    """The same in a process of its own: exit codes reach the shell."""
    done = call("compare", "/no/such/campaign")
    assert done.returncode == 2 and done.stdout == ""
    assert_sentence(done.stderr)
    assert "/no/such/campaign" in done.stderr
    assert call("--help").returncode == 0


def test_closed_pipe():
    """A reader that leaves early is no reason to complain."""
    command = [sys.executable, "-m", "ddetumble", "--help"]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout and process.stderr
        process.stdout.close()
        assert process.stderr.read() == b""
        assert process.wait() == 141


def raise_it(error):
    """A command that fails."""

    def action():
        raise error

    return action


@pytest.mark.parametrize(
    "error, code, says",
    [
        (InputError("not a number", file="a.csv", column="time", row=7), 2, "a.csv, line 7, column time: not a number"),
        (ComputationError("The fit did not\nconverge; free fewer parameters."), 1, "did not converge; free fewer"),
        (PermissionError(errno.EACCES, "Permission denied", "result.json"), 2, "result.json: permission denied"),
        (OSError(errno.ENOSPC, "No space left on device", "result.json"), 1, "no space left"),
        (MemoryError(), 1, "not enough memory"),
        (KeyboardInterrupt(), 130, "stopped"),
    ],
    ids=lambda value: type(value).__name__,
)
def test_failures(error, code, says, capsys):
    """Every way of failing has its exit code and one sentence."""
    assert run_guarded(raise_it(error)) == code
    text = capsys.readouterr().err
    assert_sentence(text)
    assert says in text


def test_unforeseen_failure(capsys, monkeypatch, tmp_path):
    """An error that nobody foresaw: exit code 1, one sentence, and the traceback in a file."""
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    assert run_guarded(raise_it(KeyError("inner\nname")), ["fit", "a b"]) == 1
    text = capsys.readouterr().err
    assert_sentence(text)
    (log,) = tmp_path.glob("ddetumble-*.log")
    assert str(log) in text and "this is a bug" in text
    report = log.read_text(encoding="utf-8")
    assert "Traceback" in report and "raise error" in report and "ddetumble fit 'a b'" in report


def test_warnings_become_notes(capsys):
    """A warning is told in one line, without the place in the code."""

    def action():
        import warnings

        warnings.warn("the first\nand the second line", UserWarning, stacklevel=1)

    import warnings

    with warnings.catch_warnings():
        warnings.simplefilter("always")
        assert run_guarded(action) == 0
    assert capsys.readouterr().err == "ddetumble: note: the first and the second line\n"


def test_progress_in_a_pipe(capsys):
    """A line a stage, which numbers and what follows a colon do not make another one; a dozen at most."""
    with show_progress("working") as report:
        for k in range(3):
            report(f"step {k}: {k} of 3", k / 3)
        report("drawing")
        said = capsys.readouterr()
        assert not said.out and "\r" not in said.err and len(said.err.splitlines()) == 2
        assert "step 0" in said.err and "drawing" in said.err
        for k in "abcdefghijklmnopqrst":
            report(k)
    assert len(capsys.readouterr().err.splitlines()) == 10


def test_long_work_is_never_silent(capsys, monkeypatch):
    """What it is at is told again, in hours of work less and less often."""
    now = [0.0]
    monkeypatch.setattr("ddetumble.cli.progress.time.monotonic", lambda: now[0])
    with show_progress("working") as report:
        for k in range(7200):
            now[0] = float(k)
            report(f"stage {k % 30}: {k}")
            if k == 600:
                told = capsys.readouterr().err.splitlines()
                assert 8 < len(told) < 20 and "10 min" in told[-1] and "so far" not in told[0]
    assert 5 < len(capsys.readouterr().err.splitlines()) < 20


@pytest.mark.parametrize(("elapsed", "done", "count", "told"), [
    (10.0, 1, 1, ""), (1.0, 1, 5, ""), (20.0, 10, 30, "40 s"), (60.0, 1, 11, "10 min"), (0.0, 0, 20, "")])
def test_the_time_left_is_told_by_the_pace(elapsed, done, count, told):
    found = tell_left(elapsed, done, count)
    assert told in found and bool(told) == bool(found)


def test_a_part_of_the_work_reports_within_its_share():
    seen = []
    report = nest_progress(lambda text, share: seen.append((text, share)), "outer", 0.5, 0.7)
    report("inner", 0.5)
    assert seen == [("outer: inner", pytest.approx(0.6))]


@pytest.mark.slow
@pytest.mark.parametrize("words", [[], ["--quiet"], ["-q"]])
def test_progress_of_a_command(capsys, tmp_path, words):
    """What long work is at goes to standard error, unless it is not wanted."""
    (tmp_path / "case.toml").write_text("""schema = "ddetumble.plan/1"
starts = 1
[debris]
angular_velocity = [0.06, 0.0, 0.0]
""")
    assert main(["plan", str(tmp_path / "case.toml"), "-o", str(tmp_path / "plan"), *words]) == 0
    said = capsys.readouterr()
    assert "Report: " in said.out and ("planning impact 1" in said.err) == (not words)
    assert len(said.err.splitlines()) <= 12 if not words else said.err == ""


def test_shipped_campaigns(capsys, monkeypatch, tmp_path):
    """A shipped campaign goes by its name, unless something of that name is here."""
    monkeypatch.chdir(tmp_path)
    assert "impact-a" in list_shipped() and "paper/figure-8" in list_shipped()
    assert locate_campaign("impact-a") == find_data() / "impact-a"
    assert "comes with the toolkit" in capsys.readouterr().err
    assert dd.read_campaign("impact-a").name == "impact-a"
    with pytest.raises(dd.InputError, match="paper/table-4"):
        dd.read_campaign("table-4")
    (tmp_path / "impact-a").mkdir()
    assert locate_campaign("impact-a") == Path("impact-a")
    (tmp_path / "strikes").mkdir()
    with pytest.raises(dd.InputError, match="did you mean strikes"):
        locate_campaign("strike")


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["compare", "table-4"], "did you mean paper/table-4"),
        (["compare", "slip-c", "-m", "matunaga"], "is for impact records"),
        (["compare", "impact-c", "-m", "coulomb"], "is for slip"),
        (["discover", "paper/table-4", "-m", "power-law"], "is for impact"),
    ],
)
def test_models_and_campaigns_of_another_family(words, says, capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    assert main(words) == 2
    text = capsys.readouterr().err
    assert says in text and "Traceback" not in text


def test_peaks_are_held_against_the_model_that_is_named(capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    assert main(["compare", "paper/table-4", "-m", "coulomb"]) == 0
    assert "friction_coefficient = " in capsys.readouterr().out


def test_output_places(tmp_path, capsys):
    """Outputs are refused before the work, and what is there stays."""
    file = tmp_path / "file"
    file.write_text("kept", encoding="utf-8")
    for words, says in ((["discover", "impact-a", "-o", str(file)], "is a file"),
                        (["discover", "impact-a", "-o", str(file / "inside")], "cannot be made"),
                        (["identify", "impact-i", "-o", str(tmp_path)], "is a folder"),
                        (["identify", "impact-i", "-o", str(file)], "--overwrite")):
        assert main(words) == 2
        assert says in capsys.readouterr().err
    assert os.listdir(tmp_path) == ["file"] and file.read_text(encoding="utf-8") == "kept"


def test_table_is_whole_or_absent(tmp_path, capsys):
    """A table is moved to its place when it is complete; without a file it goes to standard output."""
    import pandas as pd

    table = pd.DataFrame({"record": ["a"], "force": [0.1]})
    write_table(table, tmp_path / "out.csv")
    assert (tmp_path / "out.csv").read_text(encoding="utf-8") == "record,force\na,0.1\n"
    assert os.listdir(tmp_path) == ["out.csv"]
    write_table(table, None)
    assert capsys.readouterr().out == "record,force\na,0.1\n"


def test_import(tmp_path, capsys):
    """A laboratory's file becomes a campaign once the conditions are named; before, the option is asked for."""
    raw, folder = tmp_path / "run 1.csv", tmp_path / "campaign"
    write_raw(raw)
    assert main(["import", str(raw), "-o", str(folder)]) == 2
    text = capsys.readouterr().err
    assert_sentence(text)
    assert "--pressure" in text and not folder.exists()
    given = ["--pressure", "1 MPa", "--speed", "0.4 m/s", "--known", "outer_diameter=60 mm", "--absolute"]
    assert main(["import", str(raw), "-o", str(folder), *given]) == 0
    assert "campaign: 1 record" in capsys.readouterr().out
    assert main(["import", str(raw), "-o", str(folder), *given]) == 2
    assert_sentence(capsys.readouterr().err)
    assert main(["import", str(raw), "-o", str(folder), *given, "--overwrite"]) == 0


def test_effects(capsys):
    """The catalogue in short, and one effect in full."""
    assert main(["effects"]) == 0
    assert "wall-stiffness" in capsys.readouterr().out
    assert main(["effects", "wall-stiffness"]) == 0
    text = capsys.readouterr().out
    assert "k_w [N/m^q], null 0" in text and "law" in text and "reference" in text and "stage" in text
    assert "needs" not in text
    for effect, need in (("gravity-gradient", "--known 'orbit_rate=NUMBER rad/s'"), ("gas-leak", "gas")):
        assert main(["effects", effect]) == 0
        assert need in capsys.readouterr().out.partition("needs")[2]


def test_a_known_number_that_an_effect_lacks_is_told_with_its_option():
    found = dc.replace(make_slip_discovery(), noise={})
    notes = list_notes(found, find_family("tumble"), ["gravity-gradient"], "", "", (), ())
    assert any("gravity-gradient" in str(note) and "--known 'orbit_rate=" in str(note) for note in notes)


def test_cache(capsys, monkeypatch, tmp_path):
    """The cache is shown and cleared; files that are not JAX's stay."""
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(tmp_path))
    (tmp_path / "jit_f-0123-cache").write_bytes(bytes(2_000_000))
    (tmp_path / "jit_f-0123-atime").write_bytes(bytes(8))
    (tmp_path / "mine.txt").write_text("kept", encoding="utf-8")
    assert main(["cache"]) == 0
    assert "1 compiled programs, 2.0 MB" in capsys.readouterr().out
    assert main(["cache", "clear"]) == 0
    assert os.listdir(tmp_path) == ["mine.txt"]
    monkeypatch.setenv("DDETUMBLE_CACHE", "off")
    assert main(["cache", "show"]) == 0
    assert "is off" in capsys.readouterr().out


CONFIGURE = """
from ddetumble._settings import configure
configure()
configure()
import jax
assert jax.numpy.zeros(1).dtype == "float64"
print(jax.config.jax_compilation_cache_dir)
jax.jit(lambda x: x + 1.0)(2.0).block_until_ready()
"""


@pytest.mark.parametrize("case", ["chosen", "user's", "off", "unwritable"])
def test_configure(case, tmp_path):
    """Compiled programs land in the cache folder; one that cannot be made is no error, and the cache can be off."""
    environment = {key: value for key, value in os.environ.items() if not key.startswith("JAX_")}
    environment.update(XDG_CACHE_HOME=str(tmp_path / "xdg"), PYTHONWARNINGS="error::UserWarning")
    (tmp_path / "file").touch()
    folders = {"chosen": tmp_path / "mine", "unwritable": tmp_path / "file" / "inside"}
    if case in folders:
        environment["JAX_COMPILATION_CACHE_DIR"] = str(folders[case])
    if case == "off":
        environment["DDETUMBLE_CACHE"] = "off"
    done = subprocess.run(
        [sys.executable, "-c", CONFIGURE], cwd=ROOT, env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    if case in ("off", "unwritable"):
        assert done.stdout.strip() == "None"
        return
    folder = Path(done.stdout.strip())
    assert folder.is_relative_to(tmp_path) and list(folder.glob("*-cache"))
