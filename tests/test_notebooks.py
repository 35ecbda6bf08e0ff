"""The notebooks: what they store, and what they do in a clean kernel, as a reader would run them."""

import base64
import io
import json
from pathlib import Path

import matplotlib.image
import nbclient
import nbformat
import numpy as np
import pytest

from docs.make_notebooks import add_kernel, find_places, run_notebook


ROOT = Path(__file__).resolve().parent.parent
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))


@pytest.fixture
def kernel(tmp_path, monkeypatch):
    """Name of a kernel that is this very interpreter with no settings of the user's."""
    for name, value in add_kernel(tmp_path).items():
        monkeypatch.setenv(name, value)
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
def test_notebook_is_whole(path):
    """Words and code in turn, run from the top in one go; what is stored shows no warning and no place of a machine."""
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    assert [cell.cell_type for cell in notebook.cells] == ["markdown", "code"] * (len(notebook.cells) // 2)
    code = notebook.cells[1::2]
    assert [cell.execution_count for cell in code] == list(range(1, len(code) + 1))
    assert collect(notebook)[1] and not find_places(notebook) and path.stat().st_size < 1_000_000
    assert path.name in (ROOT / "README.md").read_text(encoding="utf-8")


@pytest.mark.study
@pytest.mark.parametrize("path", NOTEBOOKS[1:], ids=lambda path: path.stem)
def test_notebook_runs(path, tmp_path, kernel):
    """From a clean kernel in an empty folder, to as many pictures as are stored, leaving nothing behind."""
    work = tmp_path / "work"
    work.mkdir()
    stored = collect(nbformat.read(path, as_version=4))[1]
    _, pictures = collect(run_notebook(nbformat.read(path, as_version=4), work, kernel))
    assert len(pictures) == len(stored) and list(work.iterdir()) == []
    assert all(min(matplotlib.image.imread(io.BytesIO(base64.b64decode(one))).shape[:2]) > 150 for one in pictures)


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
    path = NOTEBOOKS[0]
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
