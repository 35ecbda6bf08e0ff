"""`fits/NAME/fit.toml`: one file that specifies a fit completely."""

from pathlib import Path
from typing import Literal

from pydantic import Field, StrictBool, StrictFloat, StrictInt, StrictStr

from .._errors import InputError
from .._settings import find_data
from .._user_files import split_name
from .files import Strict, hash_file, read_settings


SECTIONS = {  # whose keys are parameters, and what stands there
    "free": "must be a number (its start) or true", "fixed": "must be a number",
    "priors": "must be { mean = number, sd = positive number }", "bounds": "must be [low, high]",
}  # fmt: skip
Number = StrictFloat | StrictInt
# Independent draws, of which the ends of a 95 % interval err by a twelfth of a standard deviation; 400 are enough for
# means and for R-hat (Vehtari et al., Bayesian Analysis 16 (2021) 667).
EFFECTIVE = 1000


class Prior(Strict):
    """A Gaussian prior of one parameter."""

    mean: Number = Field(description="in the parameter's unit")
    sd: Number = Field(gt=0, description="standard deviation, in the same unit")


class Sampler(Strict):
    """How `ddetumble sample` draws from the posterior; a fit checks it and leaves it alone."""

    name: Literal["emcee", "nuts"] = Field(default="emcee", description='`"emcee"`, or `"nuts"` with the extra `nuts`')
    walkers: StrictInt = Field(default=0, ge=0, description="of each ensemble, even; 0: as many as it takes")
    ensembles: StrictInt = Field(default=4, ge=1, description="independent ones; chains of NUTS")
    steps: StrictInt = Field(default=5000, ge=1, description="after the burn-in, at most")
    burn: StrictInt = Field(default=100, ge=0, description="first steps, which are left out")
    effective: StrictInt = Field(default=EFFECTIVE, ge=1,
                                 description="independent draws that are wanted of every parameter")


class Specification(Strict):
    """Content of `fit.toml`; all numbers are in the units that `ddetumble effects` shows (SI)."""

    schema_: Literal["ddetumble.fit/1"] = Field(alias="schema", description='`"ddetumble.fit/1"`')
    campaign: StrictStr = Field(
        min_length=1, description="its folder from the file's own folder on, or the name of a shipped one")
    title: StrictStr = Field("", description="for people")
    model: StrictStr = Field("paper", min_length=1, description=(
        "reference model (`ddetumble models`), a folder that `fit` or `discover` wrote, or `FILE.py:NAME` from the "
        "file's own folder on"))
    effects: list[StrictStr] = Field([], description="ids of the catalogue, or `FILE.py:NAME`")
    free: dict[str, Number | Literal[True]] = Field({}, description=(
        "further parameters to fit, by name: a start, or `true` for the default"))
    fixed: dict[str, Number] = Field({}, description="parameters that are held at a value, by name")
    priors: dict[str, Prior] = Field({}, description="Gaussian priors of fitted parameters, by name")
    bounds: dict[str, tuple[Number, Number]] = Field({}, description="`[low, high]` of fitted parameters, by name")
    nuisances: StrictBool = Field(True, description=(
        "whether each record's conditions and time origin move within their stated uncertainty"))
    noise: Literal["measured", "stated"] = Field("measured", description=(
        '`"measured"`: its correlation, from the residuals; or `"stated"`: white, of the stated size'))
    sampler: Sampler = Field(default=Sampler(), description="for `sample` alone")
    seed: StrictInt = Field(0, ge=0, description="of the sampler")


def read_specification(path) -> tuple[Specification, str]:
    """Read a specification, the file `fit.toml` or its folder; paths in it become those seen from here. Returns the
    SHA-256 of the file, too.
    """
    path = Path(path)
    path = path / "fit.toml" if path.is_dir() else path
    found = read_settings(path, Specification, lambda content: content | {
        section: _join_names(content[section], section == "priors") for section in SECTIONS
        if isinstance(content.get(section), dict)}, SECTIONS)

    def see(name: str) -> str:
        """A name of a model or effect as seen from the working folder."""
        own = split_name(name)
        if own is not None:
            return f"{path.parent / own[0]}:{own[1]}"
        return str(path.parent / name) if (path.parent / name / "model.json").is_file() else name

    places = [place for place in (path.parent / found.campaign, find_data() / found.campaign) if place.exists()]
    if not places:
        raise InputError(f"there is no campaign {found.campaign!r}, neither relative to this file's folder nor among "
                         "those that come with the toolkit", file=path, key="campaign")
    update = {"campaign": str(places[0]), "model": see(found.model), "effects": [see(name) for name in found.effects]}
    return found.model_copy(update=update), hash_file(path)


def _join_names(table: dict, priors: bool) -> dict:
    """Tables within a table as names with dots, however deep: TOML reads `wall-stiffness.q = 1.5` as one."""
    flat = {}
    for name, value in table.items():
        if isinstance(value, dict) and not (priors and set(value) & {"mean", "sd"}):
            flat |= {f"{name}.{key}": inner for key, inner in _join_names(value, priors).items()}
        else:
            flat[name] = value
    return flat
