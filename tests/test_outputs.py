"""Where commands write: new or empty places alone unless --overwrite is given, and whole or not at all."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import typer

from ddetumble.cli import app, main
from ddetumble.cli.places import open_folder
from ddetumble.reports import write_report
from tests.helpers_report import make_discovery


ROOT = Path(__file__).resolve().parent.parent
COMMANDS = typer.main.get_command(app).commands  # pyright: ignore
WRITERS = sorted(name for name, command in COMMANDS.items() if any("-o" in p.opts for p in command.params))
# One call of each that would take long, or fail, if the folder were not looked at first.
CALLS = {
    "compare": ["impact-a"], "demo": [], "design": ["no-such-folder"], "discover": ["impact-a"],
    "exam": ["--family", "slip", "--cases", "1"], "fit": ["impact-a"], "import": ["no-such-file.csv"],
    "map": ["impact-a"], "missing": ["impact-a"], "paper": [], "plan": ["flat-spin.toml"], "sample": ["impact-a"],
    "average": ["slip-a", "-e", "none", "-e", "viscous-friction"],
}


def list_all(folder: Path) -> dict[str, bytes]:
    """Every file below a folder, hidden ones too, with its content."""
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def test_every_command_that_writes_is_tried_here():
    assert set(WRITERS) == {*CALLS, "effects", "export", "identify", "predict"}


@pytest.mark.parametrize("command", WRITERS)
def test_every_command_that_writes_has_the_option(command):
    assert any("--overwrite" in p.opts for p in COMMANDS[command].params)


@pytest.mark.parametrize("command", CALLS)
def test_a_folder_that_holds_anything_is_refused(command, tmp_path, capsys):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes.txt").write_text("kept", encoding="utf-8")
    assert main([command, *CALLS[command], "-o", str(tmp_path / "mine")]) == 2
    told = capsys.readouterr().err.splitlines()[-1]
    assert "--overwrite" in told and "notes.txt" in told and str(tmp_path / "mine") in told
    assert list_all(tmp_path) == {"mine/notes.txt": b"kept"}


@pytest.mark.parametrize("words", [
    ["missing", "paper/table-3"], ["fit", "slip-a", "-m", "matunaga"], ["discover", "slip-a", "-m", "matunaga"],
    ["compare", "slip-a", "-m", "no-such-model"], ["design", "no-such-folder"], ["import", "no-such-file.csv"],
    ["export", "impact-a"],
    ["plan", "no-such-file.toml"], ["map", "slip-a", "-m", "matunaga"], ["effects", "--new", "Not a name"],
], ids=" ".join)  # fmt: skip
def test_a_command_that_fails_leaves_nothing(words, tmp_path, capsys):
    assert main([*words, "-o", str(tmp_path / "deep" / "new")]) == 2
    assert "Traceback" not in capsys.readouterr().err and os.listdir(tmp_path) == []


# Where tests run in the background the signal is ignored, and a child inherits that.
LISTENING = "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler); "
# In place of the demo: a call of a compiled library that never comes back and that no signal interrupts.
STUCK = LISTENING + """
import ctypes, types

def run_demo(folder, tell):
    library, lock = ctypes.CDLL(None), ctypes.create_string_buffer(256)
    library.pthread_mutex_init(lock, None)
    library.pthread_mutex_lock(lock)
    (folder / "half.txt").write_text("half")
    library.pthread_mutex_lock(lock)

sys.modules["ddetumble.demo"] = types.SimpleNamespace(run_demo=run_demo)
from ddetumble.cli import main
sys.exit(main())
"""


def interrupt(program: str, words: list[str], ready, times: int = 1) -> tuple[int, str]:
    """Exit code and standard error of a program that is sent SIGINT once `ready()` is true."""
    with subprocess.Popen([sys.executable, "-c", program, *words], cwd=ROOT, text=True, stdout=subprocess.PIPE,
                          stderr=subprocess.PIPE) as process:
        while process.poll() is None and not ready():
            time.sleep(0.05)
        for _ in range(times):
            process.send_signal(signal.SIGINT)
            time.sleep(0.1)
        err = process.communicate()[1]
    return process.returncode, err


@pytest.mark.slow
def test_an_interrupted_command_leaves_nothing(tmp_path):
    # Imported first, as an extension of numpy prints a traceback of its own where it is interrupted.
    program = (LISTENING + "import matplotlib.pyplot, scipy.stats, ddetumble.dynamics.impact, ddetumble.paper.page\n"
               "from ddetumble.cli import main; sys.exit(main())")
    code, err = interrupt(program, ["paper", "-o", str(tmp_path / "deep" / "new")], lambda: os.listdir(tmp_path))
    assert code == 130 and err.count("stopped") == 1 and "Traceback" not in err
    assert os.listdir(tmp_path) == []


@pytest.mark.skipif(sys.platform == "win32", reason="the stand-in for a long compilation is a POSIX thread's")
@pytest.mark.parametrize("times", [1, 2])
def test_a_command_within_a_long_call_is_interrupted_too(tmp_path, times):
    code, err = interrupt(STUCK, ["demo", "-o", str(tmp_path / "deep" / "new")],
                          lambda: list(tmp_path.rglob("half.txt")), times)
    assert code == 130 and err.count("stopped") == 1 and "Traceback" not in err
    assert os.listdir(tmp_path) == []


@pytest.mark.skipif(os.name != "posix", reason="elsewhere nobody can ask whether a process lives")
def test_drafts_of_killed_processes_go_with_the_next_command(tmp_path):
    """Those of this place alone, and of processes that are no more alone."""
    def kill_one(name):
        program = ("import os, signal, sys; from pathlib import Path; from ddetumble.cli.places import open_folder\n"
                   "with open_folder(Path(sys.argv[1]), 'demo', False) as out:\n"
                   "    (out.draft / 'half.txt').write_text('half')\n"
                   "    os.kill(os.getpid(), signal.SIGKILL)\n")
        assert subprocess.run([sys.executable, "-c", program, str(tmp_path / name)], cwd=ROOT).returncode != 0

    left = {}
    for name in ("new", "other", "new-er"):
        before = set(os.listdir(tmp_path))
        kill_one(name)
        (left[name],) = set(os.listdir(tmp_path)) - before
    away = ".new-ddetumble-00000000-abcdefgh"  # of another machine, whose locks may not be seen here
    for name in (".new-notes", away):
        (tmp_path / name).mkdir()
    with open_folder(tmp_path / "new", "demo", False) as living:
        assert not (tmp_path / left["new"]).exists()
        with open_folder(tmp_path / "new", "paper", True):
            assert {left["other"], left["new-er"], ".new-notes", living.draft.name} < set(os.listdir(tmp_path))
    assert set(os.listdir(tmp_path)) == {left["other"], left["new-er"], ".new-notes", away, "new"}


@pytest.mark.slow
def test_overwriting_replaces_results_and_nothing_else(tmp_path, capsys):
    place = tmp_path / "found"
    assert main(["discover", "paper/table-4", "-o", str(place)]) == 0
    before = list_all(place)
    assert {"result.json", "report.html"} <= set(before) and any(name.endswith(".png") for name in before)
    # Another command may not write beside these, or over them.
    assert main(["compare", "paper/table-4", "-o", str(place)]) == 2 and list_all(place) == before
    (place / "notes.txt").write_text("kept", encoding="utf-8")
    assert main(["compare", "paper/table-4", "-o", str(place), "--overwrite"]) == 0
    after = list_all(place)
    assert "result.json" not in after and "report.html" not in after and after["notes.txt"] == b"kept"
    assert {"compare.json", "comparison.html"} <= set(after)
    # A command that fails does not touch what is there, --overwrite or not.
    assert main(["missing", "paper/table-4", "-o", str(place), "--overwrite"]) == 2 and list_all(place) == after
    capsys.readouterr()


@pytest.mark.study
def test_commands_take_values_of_which_a_test_gives_one(tmp_path, capsys):
    """Every command goes on from four peaks, but for those that need a curve: they say so, and leave nothing."""
    place, conditions = tmp_path / "found", tmp_path / "conditions.csv"
    conditions.write_text("record,initial_pressure,approach_speed\na,1e6,0.4\nb,2e6,0.4\n", encoding="utf-8")
    compared, predicted = tmp_path / "compared", tmp_path / "predicted.csv"
    for words in (["discover", "paper/figure-8", "-o", str(place)], ["design", str(place)],
                  ["predict", str(place), str(conditions), "-o", str(predicted)],
                  ["compare", "paper/figure-8", "-m", "matunaga", "-m", "paper", "-e", "adhesion", "-o", str(compared)],
                  ["fit", "paper/figure-8", "-o", str(tmp_path / "fit")]):
        assert main(words) == 0, words
    assert {"model.json", "result.json", "report.html"} <= set(list_all(place))
    header, *rows = predicted.read_text(encoding="utf-8").splitlines()
    assert header.startswith("record,peak_normal_force,") and [row[0] for row in rows] == ["a", "b"]
    assert {"figures/error-by-step.png", "figures/values-peak_normal_force.png"} == {
        name for name in list_all(compared) if name.endswith(".png")}
    capsys.readouterr()
    before = list_all(tmp_path)
    for words in (["average", str(place)], ["missing", "paper/figure-8", "-o", str(tmp_path / "new")],
                  ["identify", "paper/figure-8", "-o", str(tmp_path / "new.csv")]):
        assert main(words) == 2
        told = capsys.readouterr().err.splitlines()[-1]
        assert "peaks" in told or "no rival" in told, words
    assert list_all(tmp_path) == before


@pytest.mark.parametrize(("words", "kept"), [
    (["discover", "impact-b"], {"result.json"}),
    pytest.param(["fit", "paper/figure-8"], {"fit.json", "model.json"}, marks=pytest.mark.slow),
    pytest.param(["compare", "paper/figure-8"], {"compare.json"}, marks=pytest.mark.slow),
    pytest.param(["plan", "axial-spin-without-friction.toml"], {"plan.json"}, marks=pytest.mark.slow),
], ids=lambda one: one[0] if isinstance(one, list) else "")  # fmt: skip
def test_results_outlive_a_page_that_fails(words, kept, tmp_path, capsys, monkeypatch):
    """Half of a page is no page: its figures, which were written before it failed, go. What discover found is made up,
    as a search takes minutes.
    """
    from ddetumble.reports import page
    from ddetumble.selection import discover

    write = page.write_bytes

    def fail(path, content):
        if path.suffix == ".html":
            raise ValueError("no such glyph")
        write(path, content)

    monkeypatch.setattr(page, "write_bytes", fail)
    monkeypatch.setattr(discover, "discover", lambda *_, **__: make_discovery("explained"))
    assert main([*words, "-o", str(tmp_path / "out")]) == 1
    printed = capsys.readouterr()
    told = [line for line in printed.err.splitlines() if "no such glyph" in line]
    assert len(told) == 1 and str(tmp_path / "out") in told[0] and "-ddetumble-" not in told[0]
    assert str(tmp_path / "out") in printed.out and len(printed.out.splitlines()) > 1
    assert kept <= set(list_all(tmp_path / "out")) and not list(tmp_path.rglob("figures"))
    assert not list(tmp_path.rglob("*.html")) and os.listdir(tmp_path) == ["out"]


@pytest.mark.study
def test_a_map_outlives_its_figure(tmp_path, capsys, monkeypatch):
    from ddetumble import figures

    monkeypatch.setattr(figures, "draw_map", lambda found: 1 / 0)
    plan = tmp_path / "plan.csv"
    plan.write_text("initial_pressure [MPa],approach_speed [m/s]\n1,0.2\n2,0.4\n", encoding="utf-8")
    words = ["map", str(plan), "--channel", "normal_force: 0.25 N", "--value", "effective_mass=1.3 kg", "--value",
             "restitution=0.7", "--length", "20 ms", "--interval", "1 ms", "-o", str(tmp_path / "out")]
    assert main(words) == 1
    printed = capsys.readouterr()
    assert "division by zero" in printed.err and str(tmp_path / "out") in printed.out
    assert set(list_all(tmp_path / "out")) == {".ddetumble.json", "map.json"}


def test_pages_tell_what_they_draw(tmp_path):
    """Every figure is named as it is drawn, to whoever follows the command, and to nobody afterwards."""
    told: list[str] = []
    with open_folder(tmp_path / "out", "discover", False) as out:
        page = out.draw(lambda draft: write_report(make_discovery("explained"), draft),
                        lambda text, share: told.append(text))
    names = [file.stem for file in (tmp_path / "out" / "figures").iterdir()]
    assert page == tmp_path / "out" / "report.html" and names
    assert [name for name in names if not any(name in text.split() for text in told)] == []
    told.clear()
    write_report(make_discovery("explained"), tmp_path / "again")
    assert told == []


def test_a_fit_goes_beside_its_specification(tmp_path, capsys):
    specification = 'schema = "ddetumble.fit/1"\ncampaign = "impact-a"\nmodel = "none"\n'
    (tmp_path / "fit.toml").write_text(specification, encoding="utf-8")
    assert main(["fit", str(tmp_path / "fit.toml")]) == 2  # of the model; the folder itself is no reason
    assert "--overwrite" not in capsys.readouterr().err
    (tmp_path / "fit.json").write_text("{}", encoding="utf-8")
    assert main(["fit", str(tmp_path / "fit.toml")]) == 2
    assert "--overwrite" in capsys.readouterr().err


def test_an_effect_of_ones_own_is_not_written_over(tmp_path, capsys):
    words = ["effects", "--new", "rim-stop", "-o", str(tmp_path)]
    assert main(words) == 0
    source = tmp_path / "rim_stop.py"
    source.write_text("mine", encoding="utf-8")
    assert main(words) == 2 and source.read_text(encoding="utf-8") == "mine"
    assert "--overwrite" in capsys.readouterr().err
    assert main([*words, "--overwrite"]) == 0 and source.read_text(encoding="utf-8") != "mine"
