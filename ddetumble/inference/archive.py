"""A fitted model, in hand and on disk (`model.json`): all that a prediction, a design or another fit goes on from."""

import abc
import dataclasses as dc
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import jax.numpy as jnp
import numpy as np
import pydantic

from .._errors import InputError
from .._user_files import place_file, require_trust, split_name, trust_file
from ..contact.effect import AbstractEffect, AbstractLaw, AbstractModel, list_choices
from ..effects import CATALOGUE
from ..families import DEFAULT_FAMILY, find_family, name_family
from ..measurement.campaign import Campaign, Uncertainty
from ..measurement.kinds import take_kind, write_kind
from .files import hash_file, list_versions, make_plain, read_json, refuse_peaks, write_json
from .models import ResolvedModel, find_model, is_fitted, list_known, resolve_effect, wrap_model
from .noise import Noise
from .parameters import Common, ParameterSpace
from .problem import Solution


FILE = "model.json"
SCHEMA = "ddetumble.model/1"


class _Strict(pydantic.BaseModel):
    model_config = pydantic.ConfigDict(extra="forbid", allow_inf_nan=False, frozen=True)


class ChannelEntry(_Strict):
    """One measured channel: SI unit and noise."""

    unit: str
    noise: Noise


class ConditionEntry(_Strict):
    """One condition of the campaign: SI unit, range of the campaign, one standard deviation."""

    unit: str
    low: float
    high: float
    absolute: float | None = None
    relative: float | None = None


class SamplingEntry(_Strict):
    """A typical record: samples, first and last of the independent variable, largest size of every channel, SI."""

    samples: int = pydantic.Field(gt=0)
    first: float
    last: float
    largest: dict[str, float]


class EffectEntry(_Strict):
    """One effect of the model; `source` is `FILE.py:NAME` from the folder on, null for one of the catalogue."""

    id: str
    source: str | None = None
    source_sha256: str | None = None


class ModelFile(_Strict):
    """Content of `model.json`; coordinates are those in which the fit moves (logarithm, logit, ...), SI."""

    schema_: Literal["ddetumble.model/1"] = pydantic.Field(alias="schema")
    campaign: str
    sha256: str
    family: str
    family_sha256: str | None = None
    model: str
    model_sha256: str | None = None
    choices: dict[str, Any] = {}
    effects: list[EffectEntry]
    coordinates: dict[str, float]
    free: list[str]
    covariance: list[list[float]]
    channels: dict[str, ChannelEntry]
    conditions: dict[str, ConditionEntry]
    time_sd: float = pydantic.Field(ge=0)
    commons: list[Common] = []
    sampling: SamplingEntry | None = None
    records: int
    chi2: float
    versions: dict[str, str]
    extra: dict[str, Any] = {}

    @pydantic.model_validator(mode="after")
    def _agree(self):
        count = len(self.free)
        if len(set(self.free)) < count or not set(self.free) <= set(self.coordinates):
            raise ValueError("free: every name has to be one of coordinates, and there once")
        if len(self.covariance) != count or any(len(row) != count for row in self.covariance):
            raise ValueError(f"covariance: has to have {count} rows of {count} numbers, one for each free parameter")
        return self


@dc.dataclass(frozen=True, eq=False)
class FittedModel:
    """A fitted model: what `predict`, `design`, `draw_laws`, another fit or a comparison goes on from.

    Attributes:
        folder: it was read from; None for one that is not on disk.
        campaign, sha256, family: of the campaign it was fitted to.
        model: name of the reference model.
        effects: ids of the effects in the model.
        space: the reference model with these effects alone.
        u: coordinates of all parameters of `space`, shape (parameters,).
        free: names of the fitted parameters.
        covariance: of the coordinates of `free`, shape (free, free).
        noise: by channel, in the order of the campaign's channels.
        units: SI unit of every channel and condition.
        uncertainties: of the conditions, by name, where one is stated.
        time_sd: standard deviation of the time origin [s]; 0 where none is stated.
        ranges: lowest and highest value of every condition in the campaign, SI.
        records: how many the campaign has.
        chi2: of the fit.
        versions: of the packages it was fitted with.
        extra: what else the writer put there.
        notes: sentences on what has changed since it was written.
        sampling: of a typical record; None in files of earlier versions.
    """

    folder: Path | None
    campaign: str
    sha256: str
    family: str
    model: str
    effects: tuple[str, ...]
    space: ParameterSpace
    u: np.ndarray
    free: tuple[str, ...]
    covariance: np.ndarray
    noise: Mapping[str, Noise]
    units: Mapping[str, str]
    uncertainties: Mapping[str, Uncertainty]
    time_sd: float
    ranges: Mapping[str, tuple[float, float]]
    records: int
    chi2: float
    versions: Mapping[str, str]
    extra: Mapping[str, Any]
    notes: tuple[str, ...] = ()
    sampling: SamplingEntry | None = None

    @property
    def channels(self) -> tuple[str, ...]:
        """Channels of the campaign."""
        return tuple(self.noise)

    @property
    def directions(self) -> np.ndarray:
        """Rows of the identity that belong to `free`: `u + x @ directions` moves them, shape (free, parameters)."""
        columns = [self.space.index[name] for name in self.free]
        return np.eye(len(self.space))[columns].reshape(len(columns), len(self.space))

    def spread(self) -> np.ndarray:
        """Principal directions of the covariance, one standard deviation long, shape (free or fewer, parameters)."""
        sds = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        whole = sds > 0
        correlation = self.covariance[np.ix_(whole, whole)] / np.outer(sds[whole], sds[whole])
        values, vectors = np.linalg.eigh(correlation)
        root = (vectors * np.sqrt(np.maximum(values, 0.0))).T * sds[whole]
        return root @ self.directions[whole]

    def law(self) -> Any:
        """The fitted law."""
        return self.space.build(jnp.asarray(self.u))

    def outside(self, conditions: Mapping[str, float], slack: float = 0.05) -> list[str]:
        """Conditions that lie outside the campaign's range by more than `slack` of their value, each as a phrase."""
        found = []
        for name, (low, high) in self.ranges.items():
            value = conditions.get(name)
            if value is not None and name != "sequence" and not low - slack * abs(low) <= value <= high * (1 + slack):
                unit = "" if self.units[name] == "1" else f" {self.units[name]}"
                found.append(f"{name} = {value:g}{unit} lies outside the {low:g} to {high:g}{unit} of the campaign")
        return found


class AbstractFitted(abc.ABC):
    """A result that holds a fitted model: a fit, a discovery."""

    @abc.abstractmethod
    def fitted_model(self) -> FittedModel:
        """The fitted model by itself."""


Model = str | Path | AbstractModel | type[AbstractModel] | AbstractLaw | FittedModel | AbstractFitted


def make_fitted(*, campaign: Campaign, model_name: str, space: ParameterSpace, solution: Solution,
                noise: Mapping[str, Noise], effects: Sequence[str], covariance: np.ndarray | None = None,
                names: Sequence[str] | None = None, extra: Mapping[str, Any] | None = None) -> FittedModel:
    """A fitted model from a solution.

    Args:
        campaign: that was fitted.
        model_name: of the reference model, as `resolve_model` takes it.
        space: of the fit; parameters of effects that are not in the model are left out.
        solution: the fit.
        noise: by channel.
        effects: ids of the effects in the model; effects that are not at their null belong to it too.
        covariance: of the coordinates of `names`; that of the solution where not given.
        names: of the fitted parameters; those of the solution where not given.
        extra: anything more that JSON can hold, for whoever reads the file.
    """
    inside = [e for e in space.effects if e.id in effects or not _at_null(space, solution.u, e)]
    own = ParameterSpace(space.reference, inside, space.commons)
    spread = campaign.independent.uncertainty if campaign.independent is not None else None
    ranges = {n: (float(np.nanmin(x)), float(np.nanmax(x))) for n in campaign.conditions
              for x in [campaign.records[n].to_numpy(dtype=float)]}
    sampling = _describe_sampling(campaign)
    stated = {n: column.uncertainty for n, column in campaign.conditions.items() if column.uncertainty is not None}
    return FittedModel(
        None, campaign.name, campaign.sha256, name_family(campaign), model_name, tuple(e.id for e in inside), own,
        np.array([solution.u[space.index[name]] for name in own.index]),
        tuple(solution.names if names is None else names),
        solution.covariance() if covariance is None else np.asarray(covariance), dict(noise),
        {name: campaign.column(name).unit for name in (*campaign.conditions, *noise)}, stated,
        0.0 if spread is None else float(spread.sd(np.ones(1))[0]), ranges, len(campaign.records),
        float(solution.chi2), list_versions(), dict(extra or {}),
        sampling=None if sampling is None else SamplingEntry(**sampling))


def save_model(folder, fitted: FittedModel) -> Path:
    """Write a fitted model into a folder, as `model.json`.

    Args:
        folder: where to; made where it is not there.
        fitted: the model.

    Returns:
        Path of the file.

    Raises:
        InputError: The folder cannot be written.
    """
    folder = Path(folder)
    model, digest = _place_model(fitted.model, folder)
    family, own = write_kind(fitted.family, folder), split_name(write_kind(fitted.family, folder))
    covariance = np.asarray(fitted.covariance)
    content = ModelFile.model_validate({
        "schema": SCHEMA,
        "campaign": fitted.campaign, "sha256": fitted.sha256, "family": family,
        "family_sha256": None if own is None else hash_file((folder / own[0]).resolve()),
        "model": model, "model_sha256": digest, "choices": make_plain(list_choices(fitted.space.reference)),
        "effects": [_describe_effect(e, folder) for e in fitted.space.effects],
        "coordinates": dict(zip(fitted.space.index, map(float, fitted.u), strict=True)),
        "free": list(fitted.free), "covariance": [[float(x) for x in row] for row in covariance],
        "channels": {name: {"unit": fitted.units[name], "noise": make_plain(level)}
                     for name, level in fitted.noise.items()},
        "conditions": {name: _describe_condition(fitted, name) for name in fitted.ranges},
        "time_sd": fitted.time_sd, "records": fitted.records, "chi2": fitted.chi2,
        "sampling": None if fitted.sampling is None else fitted.sampling.model_dump(),
        "commons": [dc.asdict(one) for one in fitted.space.commons], "versions": dict(fitted.versions),
        "extra": dict(fitted.extra),
    })  # fmt: skip
    path = folder / FILE
    write_json(path, content.model_dump(mode="json", by_alias=True))
    return path


def load(folder, extra: Sequence[type[AbstractEffect]] = ()) -> FittedModel:
    """Read a fitted model.

    Args:
        folder: that `fit` or `discover` wrote, or the `model.json` in it.
        extra: effects of the user that are defined in no file.

    Raises:
        InputError: There is none, it is damaged, of another version, or needs a file that is not there.
    """
    path = Path(folder)
    path = path if path.suffix == ".json" else path / FILE
    content = _read(path)
    notes = []
    own = split_name(content.family)
    family = find_family(content.family).name if own is None else take_kind(content.family, path.parent)
    if own is not None and content.family_sha256 is not None:
        notes += _compare_source(path.parent / own[0], content.family_sha256)
    model = content.model
    if content.model_sha256 is not None:
        file, _, name = model.rpartition(":")
        require_trust(path.parent / file, path)
        model = f"{path.parent / file}:{name}"
        notes += _compare_source(path.parent / file, content.model_sha256)
    reference = _choose(resolve_model(model, family).reference, content.choices, path)
    classes = []
    for entry in content.effects:
        classes.append(_find_effect(entry, path, extra))
        if entry.source is not None and entry.source_sha256 is not None:
            notes += _compare_source(path.parent / entry.source.rpartition(":")[0], entry.source_sha256)
    space = ParameterSpace(reference, classes, content.commons)
    wrong = set(space.index) ^ set(content.coordinates)
    if wrong:
        raise InputError(f"the parameters are not those of the model ({', '.join(sorted(wrong))}); fit it again",
                         file=path, key="coordinates")
    return FittedModel(
        path.parent, content.campaign, content.sha256, family, model, tuple(e.id for e in classes), space,
        np.array([content.coordinates[name] for name in space.index]), tuple(content.free),
        np.array(content.covariance).reshape(len(content.free), len(content.free)),
        {name: entry.noise for name, entry in content.channels.items()},
        {name: entry.unit for name, entry in (content.conditions | content.channels).items()},
        {name: Uncertainty(entry.absolute, entry.relative) for name, entry in content.conditions.items()
         if entry.absolute is not None or entry.relative is not None},
        content.time_sd, {name: (entry.low, entry.high) for name, entry in content.conditions.items()},
        content.records, content.chi2, content.versions, content.extra, tuple(dict.fromkeys(notes)), content.sampling)


def take_fitted(model: str | Path | FittedModel | AbstractFitted) -> FittedModel:
    """The fitted model that a result holds, or that a folder has.

    Raises:
        InputError: The folder holds none, or a damaged one; or it is a model that was not fitted.
    """
    if isinstance(model, AbstractFitted):
        return model.fitted_model()
    if isinstance(model, FittedModel):
        return model
    if not isinstance(model, (str, Path)):
        raise InputError(f"{type(model).__name__} is no fitted model: give what fit or discover returned, or a folder "
                         "that they wrote")
    return load(model)


def resolve_model(model: Model, family: str = DEFAULT_FAMILY) -> ResolvedModel:
    """The model that an argument stands for.

    Args:
        model: a model in hand (`Ball()`, `Ball() + Adhesion()`), a fit or a discovery, or a name: of a built-in model;
            of a folder that `fit` or `discover` wrote, for the fitted model as it stands there; or `FILE.py:NAME` for
            one of the user's own: a subclass of `AbstractReference` or `AbstractFriction`, an instance of one or of
            `Striker`, or a law that extends one by effects.
        family: of the records, as built-in names stand for different models in different families.

    Raises:
        InputError: There is no such model, file or name, or it is none of these things.
    """
    if isinstance(model, (AbstractModel, AbstractLaw)) or (
            isinstance(model, type) and issubclass(model, AbstractModel)):
        return wrap_model(model)
    if not isinstance(model, (str, Path, FittedModel, AbstractFitted)):
        raise InputError(f"{model!r} is no model: give a name, a folder, a model such as Ball(), or a fit", key="model")
    if isinstance(model, (str, Path)) and not is_fitted(str(model)):
        return find_model(str(model), family)
    saved = take_fitted(model)
    law = saved.law()
    added = f" with {', '.join(saved.effects)}" if saved.effects else ""
    return ResolvedModel(saved.model, law.reference, f"{saved.model}{added}, as fitted to {saved.campaign}.",
                         tuple(law.effects), True)


def _at_null(space: ParameterSpace, u: np.ndarray, effect: type[AbstractEffect]) -> bool:
    amplitudes = [(k, s.parameter) for k, s in enumerate(space.slots)
                  if s.owner == effect.id and s.parameter.kind != "shape"]
    return all(u[k] == p.default for k, p in amplitudes)


def _choose(reference: AbstractModel, choices: Mapping[str, Any], path: Path) -> AbstractModel:
    own = list_choices(reference)
    if set(own) != set(choices):
        raise InputError("the choices are not those of the model; fit it again", file=path, key="choices")
    tuples = {k: _freeze(v) for k, v in choices.items()}
    try:
        return reference if own == tuples else _replace(reference, tuples)
    except Exception as error:
        raise InputError(f"the model cannot be made ({error}); fit it again", file=path, key="choices") from None


def _replace(model: AbstractModel, choices: Mapping[str, Any]) -> AbstractModel:
    """A model with other choices; those of its parts have the part's name before a dot."""
    parts = {path.partition(".")[0] for path in choices if "." in path}
    inner = {part: _replace(getattr(model, part), {path.partition(".")[2]: value for path, value in choices.items()
                                                   if path.startswith(f"{part}.")}) for part in parts}
    return dc.replace(model, **{path: value for path, value in choices.items() if "." not in path}, **inner)


def _freeze(value: Any) -> Any:
    return tuple(_freeze(v) for v in value) if isinstance(value, list) else value


def _describe_condition(fitted: FittedModel, name: str) -> dict[str, Any]:
    (low, high), spread = fitted.ranges[name], fitted.uncertainties.get(name, Uncertainty())
    return {"unit": fitted.units[name], "low": low, "high": high, "absolute": spread.absolute,
            "relative": spread.relative}


def _describe_sampling(campaign: Campaign) -> dict[str, Any] | None:
    if campaign.samples is None or campaign.independent is None:
        return None
    groups = campaign.samples.groupby("record", sort=False)[campaign.independent.name]
    count, first, last = np.median(np.array([(len(x), x.min(), x.max()) for _, x in groups], dtype=float), axis=0)
    return {"samples": int(count), "first": float(first), "last": float(last),
            "largest": {name: float(np.nanmax(np.abs(campaign.samples[name]))) for name in campaign.channels}}


def _describe_effect(effect: type[AbstractEffect], folder: Path) -> dict[str, Any]:
    if effect in CATALOGUE:
        return {"id": effect.id}
    file = getattr(sys.modules.get(effect.__module__), "__file__", None)
    if file is None or not Path(file).is_file():
        return {"id": effect.id, "source": None}
    trust_file(Path(file))
    return {"id": effect.id, "source": f"{place_file(Path(file), folder)}:{effect.__qualname__}",
            "source_sha256": hash_file(Path(file))}


def _place_model(name: str, folder: Path) -> tuple[str, str | None]:
    """A model's name as seen from the folder, and the hash of its file where it has one."""
    file, colon, attribute = name.rpartition(":")
    if colon and file.endswith(".py") and Path(file).is_file():
        trust_file(Path(file))
        return f"{place_file(Path(file), folder)}:{attribute}", hash_file(Path(file))
    return name, None


def _compare_source(file: Path, digest: str) -> list[str]:
    if file.is_file() and hash_file(file) != digest:
        return [f"{file.name} has changed since the model was fitted; the parameters may not belong to it any more."]
    return []


def _find_effect(entry: EffectEntry, path: Path, extra: Sequence[type[AbstractEffect]]) -> type[AbstractEffect]:
    known = {e.id: e for e in (*list_known(), *extra)}
    if entry.id in known:
        return known[entry.id]
    if entry.source is None:
        raise InputError(f"the effect {entry.id!r} is in no file and not in the catalogue; "
                         "give its class to load(extra=...)", file=path, key="effects")
    file, _, name = entry.source.rpartition(":")
    require_trust(path.parent / file, path)
    return resolve_effect(f"{path.parent / file}:{name}")


def _read(path: Path) -> ModelFile:
    if not path.exists():
        refuse_peaks(path.parent)
        raise InputError(f"there is no {FILE} here; name a folder of fit or discover", file=path.parent)
    return read_json(path, SCHEMA, ModelFile, "fit the model again")
