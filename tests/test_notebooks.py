"""The notebook: cells without stored outputs, run from a clean kernel as a reader would."""

import base64
import io
import json
import os
import sys
from pathlib import Path

import matplotlib.image
import nbclient
import nbformat
import numpy as np
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


# Facts of the variables that the cells left in the kernel, as JSON behind a character that nothing else prints.
ASK = """
def measure(readings, one):
    return float(np.sqrt(np.mean((np.asarray(readings) - np.array(one["y"])[:, 0]) ** 2)) / noise)

strikes = [dd.dynamics.simulate_impact(dd.Ball(**alone), {k: jnp.asarray(float(v)) for k, v in
           one["conditions"].items()}, jnp.asarray(one["x"])).normal_force for one in truth["heldout"]]
grown = [predicted.loc[predicted["record"] == f"new {i}", "normal_force"] for i in range(len(strikes))]
print(chr(30) + json.dumps({
    "campaign": campaign.name, "records": len(campaign.records), "rejected": bool(comparison.lack_of_fit.rejected),
    "verdict": found.verdict, "effects": list(found.effects), "hidden": truth["effects"],
    "size": found.steps[-1].parameters["adhesion.tau_a"].estimate,
    "rejected_by_hand": [bool(one.lack_of_fit.rejected) for one in by_hand],
    "errors_of_paper": [measure(*pair) for pair in zip(strikes, truth["heldout"], strict=True)],
    "errors_of_grown": [measure(*pair) for pair in zip(grown, truth["heldout"], strict=True)],
    "contract": dd.check_effect(EndStop).ok, "depth": fitted.parameters["end-stop.depth"].estimate}))
"""


@pytest.mark.study
def test_story_runs(tmp_path, kernel):
    """From a clean kernel in an empty folder: the hidden effect is found, it predicts, and one of the user's works."""
    (path,) = NOTEBOOKS
    notebook = nbformat.read(path, as_version=4)
    drawn = sum(line.startswith("show(") for cell in notebook.cells for line in cell.source.splitlines())
    notebook.cells.append(nbformat.v4.new_code_cell(ASK))
    work = tmp_path / "work"
    work.mkdir()
    nbclient.NotebookClient(
        notebook, timeout=900, kernel_name=kernel, resources={"metadata": {"path": str(work)}}
    ).execute()
    text, pictures = collect(notebook)
    assert len(pictures) == drawn > 0
    for picture in pictures:
        pixels = matplotlib.image.imread(io.BytesIO(base64.b64decode(picture)))
        assert min(pixels.shape[:2]) > 200 and np.ptp(pixels[..., :3]) > 0.5  # something is drawn
    told = json.loads(text.split(chr(30))[1])
    assert told["campaign"] == "impact-b" and told["records"] == 18 and told["rejected"]
    assert told["verdict"] == "explained" and told["effects"] == list(told["hidden"]) == ["adhesion"]
    assert told["size"] == pytest.approx(told["hidden"]["adhesion"]["tau_a"], rel=0.2)
    assert told["rejected_by_hand"] == [True, True, False]  # the paper's model, the gauge's gain, what was found
    assert len(told["errors_of_grown"]) == len(told["errors_of_paper"]) == 3
    assert max(told["errors_of_grown"]) < 0.5 < min(told["errors_of_paper"])
    assert told["contract"] and told["depth"] == pytest.approx(0.0061, rel=0.02)
    assert list(work.iterdir()) == []
