"""The notebook: cells without stored outputs, run from a clean kernel as a reader would."""

import json
import os
import re
import sys
from pathlib import Path

import nbclient
import nbformat
import pytest


ROOT = Path(__file__).resolve().parent.parent
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))


@pytest.fixture
def kernel(tmp_path, monkeypatch):
    """Name of a kernel that is this very interpreter with no settings of the user's."""
    folder = tmp_path / "jupyter" / "kernels" / "clean"
    folder.mkdir(parents=True)
    command = [sys.executable, "-m", "ipykernel_launcher", "-f", "{connection_file}"]
    (folder / "kernel.json").write_text(json.dumps({"argv": command, "display_name": "clean", "language": "python"}))
    monkeypatch.setenv("JUPYTER_PLATFORM_DIRS", "1")
    monkeypatch.setenv("JUPYTER_PATH", str(tmp_path / "jupyter"))
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path / "ipython"))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])]))
    return "clean"


def collect(notebook):
    """All that the cells printed, and the pictures they showed."""
    text, pictures = [], []
    for output in (output for cell in notebook.cells for output in cell.get("outputs", ())):
        assert output.output_type != "error", output
        assert not (output.output_type == "stream" and output.name == "stderr"), output.text
        text.append(output.get("text", ""))
        data = output.get("data", {})
        text.append(data.get("text/plain", ""))
        pictures += [data["image/png"]] if "image/png" in data else []
    return "\n".join(text), pictures


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_is_stripped(path):
    """Words and code in turn; outputs are not under version control."""
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    assert [cell.cell_type for cell in notebook.cells] == ["markdown", "code"] * 6
    assert not any(cell.outputs or cell.execution_count for cell in notebook.cells if cell.cell_type == "code")


@pytest.mark.study
def test_story_runs(tmp_path, kernel):
    """From a clean kernel in an empty folder: the hidden effect is found, it predicts, and one of the user's works."""
    (path,) = NOTEBOOKS
    notebook = nbformat.read(path, as_version=4)
    work = tmp_path / "work"
    work.mkdir()
    nbclient.NotebookClient(
        notebook, timeout=900, kernel_name=kernel, resources={"metadata": {"path": str(work)}}
    ).execute()
    text, pictures = collect(notebook)
    assert len(pictures) == 5
    assert "Campaign impact-b (impact): 18 records" in text
    assert "the model is incomplete" in text
    assert "found: {'adhesion.tau_a'" in text
    errors = {name: [float(x) for x in re.findall(rf"{name} +is off by +([\d.]+)", text)]
              for name in ("paper's model", "grown model")}  # fmt: skip
    assert len(errors["grown model"]) == len(errors["paper's model"]) == 3
    assert max(errors["grown model"]) < 0.5 < min(errors["paper's model"])
    assert "end-stop keeps its contract" in text
    assert float(re.search(r"end-stop\.depth = ([\d.]+)", text).group(1)) == pytest.approx(0.0061, rel=0.02)
    assert list(work.iterdir()) == []
