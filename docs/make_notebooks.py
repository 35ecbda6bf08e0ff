"""Run the notebooks and store what their cells show: `python -m docs.make_notebooks [NUMBER ...]`.

Each runs from a clean kernel in an empty folder, as a reader would run it. Outputs that name the machine are refused.
"""

import json
import os
import re
import sys
import tempfile
from pathlib import Path

import nbclient
import nbformat


ROOT = Path(__file__).resolve().parent.parent
FOLDER = ROOT / "notebooks"
LONGEST = 1200  # seconds for a cell: the first one compiles


def add_kernel(folder: Path) -> dict[str, str]:
    """A kernel `clean` in a folder, this interpreter without settings of the user's: the environment that finds it."""
    place = folder / "jupyter" / "kernels" / "clean"
    place.mkdir(parents=True)
    command = [sys.executable, "-m", "ipykernel_launcher", "-f", "{connection_file}"]
    (place / "kernel.json").write_text(json.dumps({"argv": command, "display_name": "clean", "language": "python"}))
    search = os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])
    return {"JUPYTER_PLATFORM_DIRS": "1", "JUPYTER_PATH": str(folder / "jupyter"),
            "IPYTHONDIR": str(folder / "ipython"), "PYTHONPATH": search}


def run_notebook(notebook: nbformat.NotebookNode, folder: Path, kernel: str = "clean") -> nbformat.NotebookNode:
    """The notebook with what its cells show, run in a folder; it fails where a cell does."""
    nbclient.NotebookClient(notebook, timeout=LONGEST, kernel_name=kernel, record_timing=False,
                            resources={"metadata": {"path": str(folder)}}).execute()
    plain = {"display_name": "Python 3 (ipykernel)", "language": "python", "name": "python3"}
    notebook.metadata = {"kernelspec": plain, "language_info": {"name": "python"}}
    return notebook


def find_places(notebook: nbformat.NotebookNode) -> list[str]:
    """Texts shown that name a place of this machine."""
    shown = [output.get("text", "") + str(output.get("data", {}).get("text/plain", ""))
             for cell in notebook.cells for output in cell.get("outputs", ())]
    return [text for text in shown if re.search(rf"{re.escape(str(ROOT))}|/(home|Users|root|tmp)/", text)]


def main(wanted: list[str]) -> None:
    """Run those whose numbers are given, or all."""
    for path in sorted(FOLDER.glob("*.ipynb")):
        if wanted and path.name[:2].lstrip("0") not in {one.lstrip("0") for one in wanted}:
            continue
        with tempfile.TemporaryDirectory() as folder:
            os.environ |= add_kernel(Path(folder))
            work = Path(folder) / "work"
            work.mkdir()
            notebook = run_notebook(nbformat.read(path, as_version=4), work)
        if places := find_places(notebook):
            raise SystemExit(f"{path.name} shows a place of this machine: {places[0]}")
        nbformat.write(notebook, path)
        sys.stdout.write(f"{path.name}: {path.stat().st_size // 1024} kB\n")


if __name__ == "__main__":
    main(sys.argv[1:])
