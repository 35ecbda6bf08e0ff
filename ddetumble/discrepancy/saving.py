"""A discovery on disk: `result.json` for programs, `model.json` to predict with."""

from pathlib import Path

from ..inference.archive import save_model
from ..inference.files import list_versions, write_json
from .records import Discovery


FILE = "result.json"


def save_discovery(found: Discovery, folder: Path | str) -> Path:
    """Write `result.json` and `model.json` into a folder (made if it is not there).

    Args:
        found: of `discover`.
        folder: where to.

    Returns:
        Path of `result.json`.

    Raises:
        InputError: the folder cannot be written.
    """
    folder = Path(folder)
    if found.model_state is not None:
        workbench, solution = found.model_state["workbench"], found.model_state["solution"]
        save_model(folder, campaign=workbench.campaign, model_name=found.model, space=workbench.space,
                   solution=solution, noise=workbench.noise, effects=found.effects,
                   extra={"verdict": found.verdict})
    content = found.to_dict()
    content["versions"] = list_versions()
    write_json(folder / FILE, content)
    return folder / FILE
