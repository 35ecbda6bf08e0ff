"""What Windows and macOS lack, or do otherwise, feigned on the system that runs the tests."""

import ctypes
import errno
import io
import json
import os
import sys
import types
import unicodedata
from pathlib import PureWindowsPath

import pytest
from helpers_formats import channels, write_csv, write_sheets

import ddetumble as dd
from ddetumble import _settings
from ddetumble.cli import failures, main, places
from ddetumble.effects.template import write_template
from ddetumble.exam import running
from ddetumble.inference import programs
from ddetumble.posterior import chain


@pytest.fixture
def windows(monkeypatch):
    """A system that calls itself Windows, without the modules and calls of POSIX."""
    monkeypatch.setattr(sys, "platform", "win32")
    for module in ("fcntl", "resource"):
        monkeypatch.setitem(sys.modules, module, None)
    for name in ("sysconf", "sched_getaffinity", "O_DIRECTORY"):
        monkeypatch.delattr(os, name, raising=False)


def test_folders_without_locks(tmp_path, windows):
    """Results are published as anywhere; a draft of others, which might be at work, stays."""
    other = tmp_path / f".out{places.DRAFT}abc"
    other.mkdir()
    for number in (1, 2):
        with places.open_folder(tmp_path / "out", "fit", overwrite=number > 1) as out:
            (out.draft / f"{number}.txt").write_text("whole")
    assert {one.name for one in tmp_path.iterdir()} == {"out", other.name}
    assert [one.name for one in (tmp_path / "out").glob("*.txt")] == ["2.txt"]


def test_a_folder_of_results_can_be_read_as_others_can(tmp_path):
    (tmp_path / "plain").mkdir()
    with places.open_folder(tmp_path / "out", "fit", overwrite=False):
        pass
    assert (tmp_path / "out").stat().st_mode == (tmp_path / "plain").stat().st_mode


def test_a_drive_that_is_not_there(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(os.path, "lexists", lambda path: False)
    assert main(["paper", "-o", str(tmp_path / "out")]) == 2
    assert "Traceback" not in capsys.readouterr().err


@pytest.mark.parametrize("name", ["/etc/passwd", "C:\\notes.txt", "\\notes.txt", "C:notes.txt", "..\\notes.txt"])
def test_a_record_that_names_files_elsewhere(tmp_path, monkeypatch, name):
    """A folder from a stranger has nothing removed outside of itself."""
    (tmp_path / places.RECORD).write_text(json.dumps({"files": {"fit": [name, "a.txt"]}}))
    monkeypatch.setattr(places, "Path", PureWindowsPath)
    assert places.read_record(tmp_path) == {"fit": ["a.txt"]}


def test_memory_of_the_machine(windows, monkeypatch):
    def measure(where):
        where._obj.value = 16 * 1024**2  # kibibytes
        return 1

    system = types.SimpleNamespace(kernel32=types.SimpleNamespace(GetPhysicallyInstalledSystemMemory=measure))
    monkeypatch.setattr(ctypes, "windll", system, raising=False)
    monkeypatch.setattr(_settings, "Path", lambda place: types.SimpleNamespace(read_text=lambda: "max"))
    monkeypatch.delenv("DDETUMBLE_MEMORY", raising=False)
    assert _settings.find_memory() == 0.5 * 16 * 1024**3
    system.kernel32.GetPhysicallyInstalledSystemMemory = lambda where: 0
    assert 1e9 < _settings.find_memory() < 1e10


def test_cores_and_workers(windows, monkeypatch):
    """Windows waits for 61 processes at once, whatever the number of cores."""
    assert running._count_cores() >= 1
    asked = []

    def refuse(workers, *_):
        asked.append(workers)
        raise dd.ComputationError("enough")

    monkeypatch.setattr(running, "ProcessPoolExecutor", refuse)
    with pytest.raises(dd.ComputationError):
        list(running.run_all(abs, range(200), workers=128))
    assert asked == [61]


def test_a_block_of_a_chain(tmp_path, windows):
    chain.write_arrays(tmp_path / "block.npz", {"x": chain.np.arange(3)})
    assert list(chain.read_arrays(tmp_path / "block.npz")["x"]) == [0, 1, 2]


def test_a_program_that_another_process_reads(tmp_path, monkeypatch):
    """One that is damaged is made again, also where it cannot be removed."""
    (tmp_path / "a-program").write_bytes(b"half a file")

    def refuse(path):
        raise PermissionError(errno.EACCES, "in use", str(path))

    monkeypatch.setattr(type(tmp_path), "unlink", refuse)
    assert programs._read(tmp_path / "a-program") is None and programs._read(tmp_path / "none-program") is None


def test_a_pipe_that_nobody_reads(windows, monkeypatch, capsys):
    """Windows calls a broken pipe an invalid argument; a file with an invalid name is something else."""
    left = []
    monkeypatch.setattr(failures, "_leave_pipe", lambda: left.append(1) or failures.PIPE_CLOSED)

    def write(*more):
        raise OSError(errno.EINVAL, "Invalid argument", *more)

    assert failures.run_guarded(write) == failures.PIPE_CLOSED and left == [1]
    assert failures.run_guarded(lambda: write("a?.csv")) == 2 and "a?.csv" in capsys.readouterr().err


@pytest.mark.parametrize("words", [["--help"], ["effects"], ["effects", "wall-stiffness"], ["discover", "--help"],
                                   ["fit", "nowhere-χ²"]])
def test_a_terminal_of_few_letters(monkeypatch, words):
    """Western Windows' code page lacks Greek: such letters are replaced, and nothing fails."""
    streams = [io.TextIOWrapper(io.BytesIO(), encoding="cp1252") for _ in range(2)]
    monkeypatch.setattr(sys, "stdout", streams[0])
    monkeypatch.setattr(sys, "stderr", streams[1])
    code = main(words)
    for stream in streams:
        stream.flush()
    written = [stream.buffer.getvalue().decode("cp1252") for stream in streams]
    assert code == (2 if "fit" in words else 0), written
    assert written[code == 2] and "this is a bug" not in written[1]


def test_patterns_that_the_shell_leaves_to_programs(tmp_path, capsys):
    for number in (1, 2):
        write_csv(tmp_path / f"run{number}.csv", channels())
    words = ["import", str(tmp_path / "run*.csv"), "--pressure", "1 MPa", "--speed", "0.4 m/s"]
    assert main([*words, "-o", str(tmp_path / "out")]) == 0
    assert dd.read_campaign(tmp_path / "out").record_keys == ("run1", "run2")
    assert main(["import", str(tmp_path / "run*.csv"), "--list"]) == 0 and "run2.csv" in capsys.readouterr().out
    assert main(["import", str(tmp_path / "no*.csv"), "--list"]) == 2


def test_files_that_systems_put_beside_others(tmp_path):
    """`._…` of macOS and `~$…` of Excel are no measurements, in a folder and for a pattern."""
    write_csv(tmp_path / "run1.csv", channels())
    (tmp_path / "._run1.csv").write_bytes(b"\0\5\26\7")
    (tmp_path / "~$run2.xlsx").write_bytes(b"\5USER")
    given = {"pressure": "1 MPa", "speed": "0.4 m/s"}
    assert dd.import_tests(tmp_path, **given).record_keys == ("run1",)
    (tmp_path / "import.toml").write_text('raw = ["*run*"]\npressure = "1 MPa"\nspeed = "0.4 m/s"\n')
    assert dd.import_tests(tmp_path / "import.toml").record_keys == ("run1",)


def test_names_as_other_systems_write_them(tmp_path):
    """A letter and its accent in one or two parts, slashes turned round."""
    (tmp_path / "lab").mkdir()
    write_csv(tmp_path / "lab" / unicodedata.normalize("NFD", "stoß_ü.csv"), channels())
    for name in ("stoß_ü.csv", unicodedata.normalize("NFC", f"{tmp_path}/lab/stoß_ü.csv").replace("/", "\\")):
        table = write_sheets(tmp_path / "settings.xlsx", {"Table": [["file", "p [bar]", "v [m/s]"], [name, 10.0, 0.4]]})
        campaign = dd.import_tests(tmp_path / "lab", conditions=table)
        assert list(campaign.records["initial_pressure"]) == [1e6]


def test_names_that_windows_keeps_for_itself(tmp_path):
    for name in ("con", "aux", "com1"):
        with pytest.raises(dd.InputError):
            write_template(name, folder=tmp_path)


def test_inputs_have_one_hash_on_all_systems(tmp_path, monkeypatch):
    """Windows sorts paths without regard to case, which must not change what is hashed first."""
    for name in ("b.csv", "C.csv", "a/B.csv", "A.csv"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(name)
    known = places.hash_place(tmp_path)
    monkeypatch.setattr(type(tmp_path), "__lt__", lambda one, other: str(one).lower() < str(other).lower())
    assert places.hash_place(tmp_path) == known
