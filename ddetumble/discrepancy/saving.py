"""A discovery on disk: `result.json` for programs, `model.json` to predict with."""

from pathlib import Path

from ..inference.archive import FILE as MODEL
from ..inference.archive import save_model
from ..inference.files import list_versions, write_json
from .records import Discovery


FILE = "result.json"
RIVALS = "rivals"


def save_discovery(found: Discovery, folder: Path | str) -> Path:
    """Write `result.json` and `model.json` into a folder (made if it is not there).

    Every model that the last step could not tell from the best one is written to `rivals/NUMBER/model.json`.

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

        def save(place, fitted, effects):
            save_model(place, campaign=workbench.campaign, model_name=found.model, space=workbench.space,
                       solution=fitted, noise=workbench.noise, effects=effects, extra={"verdict": found.verdict})

        save(folder, solution, found.effects)
        for old in (folder / RIVALS).glob(f"*/{MODEL}"):  # of an earlier discovery
            old.unlink()
        for number, rival in enumerate(found.model_state["rivals"], 1):
            save(folder / RIVALS / str(number), rival.solution, rival.effects)
    content = found.to_dict()
    content["versions"] = list_versions()
    write_json(folder / FILE, content)
    return folder / FILE
