"""A fitted model, in hand and on disk (`model.json`): all that a prediction, a design or another fit goes on from."""

import abc
import dataclasses as dc
import shlex
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import jax.numpy as jnp
import numpy as np
import pydantic

from .._errors import InputError
from .._settings import find_data
from .._user_files import place_file, require_trust, split_name, trust_file
from ..contact.effect import AbstractEffect, AbstractLaw, AbstractModel, list_choices
from ..effects import CATALOGUE
from ..families import DEFAULT_FAMILY, find_family, name_family
from ..measurement.campaign import Campaign, Uncertainty
from ..measurement.kinds import take_kind, write_kind
from .files import Strict, hash_file, list_versions, make_plain, read_json, write_json
from .models import (
    ResolvedModel,
    find_model,
    is_fitted,
    is_model,
    list_known,
    require_complete,
    resolve_effect,
    wrap_model,
)
from .noise import Noise
from .parameters import Common, ParameterSpace
from .problem import Solution


FILE = "model.json"
SCHEMA = "ddetumble.model/1"


class _Channel(Strict):
    unit: str
    noise: Noise


class _Condition(Strict):
    unit: str
    low: float
    high: float
    absolute: float | None = None
    relative: float | None = None


class Sampling(Strict):
    """A typical record: samples, first and last of the independent variable, largest size of every channel, SI."""

    samples: int = pydantic.Field(gt=0)
    first: float
    last: float
    largest: dict[str, float]


class _Effect(Strict):
    """One effect of the model; `source` is `FILE.py:NAME` from the folder on, null for one of the catalogue."""

    id: str
    source: str | None = None
    source_sha256: str | None = None


class _ModelFile(Strict):
    """Content of `model.json`; coordinates are those in which the fit moves (logarithm, logit, ...), SI."""

    schema_: Literal["ddetumble.model/1"] = pydantic.Field(alias="schema")
    campaign: str
    sha256: str
    family: str
    family_sha256: str | None = None
    model: str
    model_sha256: str | None = None
    choices: dict[str, Any] = {}
    effects: list[_Effect]
    coordinates: dict[str, float]
    free: list[str]
    covariance: list[list[float]]
    channels: dict[str, _Channel]
    conditions: dict[str, _Condition]
    time_sd: float = pydantic.Field(ge=0)
    commons: list[Common] = []
    sampling: Sampling | None = None
    priors: dict[str, tuple[float, float]] = {}
    widened: dict[str, pydantic.PositiveFloat] = {}
    records: int
    chi2: float
    versions: dict[str, str]
    extra: dict[str, Any] = {}

    @pydantic.model_validator(mode="after")
    def _agree(self):
        count = len(self.free)
        if len(set(self.free)) < count or not set(self.free) <= set(self.coordinates):
            raise ValueError("free: every name must be one of coordinates, and occur once")
        if len(self.covariance) != count or any(len(row) != count for row in self.covariance):
            raise ValueError(f"covariance: must have {count} rows of {count} numbers, one for each free parameter")
        return self


@dc.dataclass(frozen=True, eq=False)
class FittedModel:
    """A fitted model, from which `predict`, `design`, `draw_laws`, another fit or a comparison continues.

    Attributes:
        folder: it was read from; None for one that is not on disk.
        campaign, sha256, family, records: of the campaign it was fitted to: name, hash, kind, how many records.
        model, effects: name of the reference model, and ids of its effects.
        space: the reference model with these effects alone.
        u: coordinates of all parameters of `space`, shape (parameters,).
        free, covariance: names of the fitted parameters; of their coordinates, shape (free, free).
        noise: by channel, in the order of the campaign's channels.
        units: SI unit of every channel and condition.
        uncertainties, time_sd: of the conditions, by name, and the time origin [s]; none or 0 where none is stated.
        ranges: lowest and highest value of every condition in the campaign, SI.
        chi2, versions: of the fit, and of the packages that made it.
        extra: what else the writer put there, and the `ambient_pressure` [Pa] that the campaign states.
        notes: sentences on what has changed since it was written.
        sampling: of a typical record; None of a campaign without samples.
        priors: Gaussian (mean, sd) of the coordinates of parameters that were fitted under one, by name.
        widened: how many times as large as by the noise alone standard deviations are, by parameter, as `Fit` has it.
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
    sampling: Sampling | None = None
    priors: Mapping[str, tuple[float, float]] = dc.field(default_factory=dict)
    widened: Mapping[str, float] = dc.field(default_factory=dict)

    @property
    def channels(self) -> tuple[str, ...]:
        """Channels of the campaign."""
        return tuple(self.noise)

    @property
    def directions(self) -> np.ndarray:
        """Rows of the identity that belong to `free`: `u + x @ directions` moves them, shape (free, parameters)."""
        columns = [self.space.index[name] for name in self.free]
        return np.eye(len(self.space))[columns].reshape(len(columns), len(self.space))

    @property
    def misfit(self) -> float | None:
        """RMS residual of the campaign over its noise where that is significantly more than noise leaves, by whoever
        fitted the model; None where it is not."""
        found = self.extra.get("misfit")
        return None if found is None else float(found)

    def without_scatter(self) -> "FittedModel":
        """The same with the covariance that the noise alone gives."""
        scale = np.array([self.widened.get(name, 1.0) for name in self.free])
        return dc.replace(self, covariance=self.covariance / np.outer(scale, scale), widened={})

    @property
    def ambient_pressure(self) -> float | None:
        """Pressure [Pa] around the tests as the campaign states it, from which gauge pressures count; None if it does
        not."""
        found = self.extra.get("ambient_pressure")
        return None if found is None else float(found)

    @property
    def are_values(self) -> bool:
        """Whether its campaign holds values alone, of which a test gives one each."""
        return set(self.channels) <= set(self.space.family.values)

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
        stated = dict(self.units) | {start: self.units[channel] for start, channel in self._list_starts().items()}
        units = {name: "" if unit == "1" else f" {unit}" for name, unit in stated.items()}
        return [f"{name} = {conditions[name]:g}{units[name]} lies outside the range of the campaign, {low:g} to "
                f"{high:g}{units[name]}" for name, (low, high) in self.exceeded(conditions, slack).items()]

    def exceeded(self, conditions: Mapping[str, float], slack: float = 0.05) -> dict[str, tuple[float, float]]:
        """Range of the campaign [SI] of every condition that lies outside it by more than `slack` of its value.

        Of what a free-running record starts from: as far to either side as its channel was ever read.
        """
        largest = self.sampling.largest if self.sampling else {}
        ranges = dict(self.ranges) | {start: (-largest[channel], largest[channel])
                                for start, channel in self._list_starts().items() if channel in largest}
        return {name: (low, high) for name, (low, high) in ranges.items()
                if name in conditions and name != "sequence"
                and not low - slack * abs(low) <= conditions[name] <= high + slack * abs(high)}

    def _list_starts(self) -> dict[str, str]:
        """Channel of every quantity that a free-running record starts from."""
        family = self.space.family
        return {start: channel for start, channel in zip(family.starts, family.main, strict=False)
                if channel in self.units}


class AbstractFitted(abc.ABC):
    """A result that holds a fitted model: a fit, a discovery."""

    @abc.abstractmethod
    def fitted_model(self) -> FittedModel:
        """The fitted model by itself."""


Model = str | Path | AbstractModel | type[AbstractModel] | AbstractLaw | FittedModel | AbstractFitted


def make_fitted(*, campaign: Campaign, model_name: str, space: ParameterSpace, solution: Solution,
                noise: Mapping[str, Noise], effects: Sequence[str], covariance: np.ndarray | None = None,
                names: Sequence[str] | None = None, extra: Mapping[str, Any] | None = None,
                priors: Mapping[str, tuple[float, float]] | None = None,
                widened: Mapping[str, float] | None = None) -> FittedModel:
    """Make a fitted model from a solution of a campaign, whose reference model `resolve_model` finds by `model_name`.

    Parameters of effects that are neither among `effects` (ids) nor away from their null are left out. `covariance` is
    that of the coordinates of `names`; both are those of the solution where not given. `extra` is anything more that
    JSON can hold, for whoever reads the file.
    """
    away = {s.owner for k, s in enumerate(space.slots)
            if s.parameter.kind != "shape" and solution.u[k] != s.parameter.default}
    inside = [e for e in space.effects if e.id in effects or e.id in away]
    own = ParameterSpace(space.reference, inside, space.commons)
    clock, sampling = campaign.independent, None
    ambient = campaign.known.get("ambient_pressure")
    more = ({} if ambient is None else {"ambient_pressure": float(ambient)}) | dict(extra or {})
    if campaign.samples is not None and clock is not None:
        groups = campaign.samples.groupby("record", sort=False)[clock.name]
        count, first, last = np.median(np.array([(len(x), x.min(), x.max()) for _, x in groups], dtype=float), axis=0)
        sampling = Sampling(samples=int(count), first=float(first), last=float(last), largest={
            name: float(np.nanmax(np.abs(campaign.samples[name]))) for name in campaign.channels})
    return FittedModel(
        None, campaign.name, campaign.sha256, name_family(campaign), model_name, tuple(e.id for e in inside), own,
        np.array([solution.u[space.index[name]] for name in own.index]),
        tuple(solution.names if names is None else names),
        solution.covariance() if covariance is None else np.asarray(covariance), dict(noise),
        {name: campaign.column(name).unit for name in (*campaign.conditions, *noise)},
        {name: column.uncertainty for name, column in campaign.conditions.items() if column.uncertainty is not None},
        campaign.time_sd,
        {name: (float(np.nanmin(x)), float(np.nanmax(x))) for name in campaign.conditions
         for x in [campaign.records[name].to_numpy(dtype=float)]},
        len(campaign.records), float(solution.chi2), list_versions(), more, sampling=sampling,
        priors=dict(priors or {}), widened=dict(widened or {}))


def save_model(folder, fitted: FittedModel) -> Path:
    """Write a fitted model into a folder (made where it is not there), as `model.json`; returns the file's path."""
    folder = Path(folder)
    model, digest = _place(fitted.model, folder)
    family = write_kind(fitted.family, folder)
    own = split_name(family)
    conditions = {}
    for name, (low, high) in fitted.ranges.items():
        spread = fitted.uncertainties.get(name, Uncertainty())
        conditions[name] = {"unit": fitted.units[name], "low": low, "high": high, "absolute": spread.absolute,
                            "relative": spread.relative}
    effects = []
    for effect in fitted.space.effects:
        file = getattr(sys.modules.get(effect.__module__), "__file__", None)
        if effect in CATALOGUE or file is None:
            effects.append({"id": effect.id})
        else:
            source, hashed = _place(f"{file}:{effect.__qualname__}", folder)
            effects.append({"id": effect.id, "source": None if hashed is None else source, "source_sha256": hashed})
    content = _ModelFile.model_validate({
        "schema": SCHEMA, "campaign": fitted.campaign, "sha256": fitted.sha256, "family": family,
        "family_sha256": None if own is None else hash_file((folder / own[0]).resolve()),
        "model": model, "model_sha256": digest, "choices": make_plain(list_choices(fitted.space.reference)),
        "effects": effects, "coordinates": dict(zip(fitted.space.index, map(float, fitted.u), strict=True)),
        "free": list(fitted.free), "covariance": np.asarray(fitted.covariance, dtype=float).tolist(),
        "channels": {name: {"unit": fitted.units[name], "noise": make_plain(level.without_sizes())}
                     for name, level in fitted.noise.items()},
        "conditions": conditions, "time_sd": fitted.time_sd, "records": fitted.records, "chi2": fitted.chi2,
        "sampling": None if fitted.sampling is None else fitted.sampling.model_dump(), "priors": dict(fitted.priors),
        "widened": dict(fitted.widened),
        "commons": [dc.asdict(one) for one in fitted.space.commons], "versions": dict(fitted.versions),
        "extra": dict(fitted.extra),
    })  # fmt: skip
    write_json(folder / FILE, content.model_dump(mode="json", by_alias=True))
    return folder / FILE


def load(folder, extra: Sequence[type[AbstractEffect]] = ()) -> FittedModel:
    """Read a fitted model that `fit` or `discover` wrote: its folder, or a JSON file in it.

    `extra` are effects of the user that are defined in no file.

    Raises:
        InputError: There is none, it is damaged, of another version, or needs a file that is not there.
    """
    path = Path(folder)
    path = path if path.suffix == ".json" else path / FILE
    if path.name != FILE and (path.parent / FILE).is_file():
        path = path.parent / FILE  # another file of the same result is meant as its folder
    if not path.exists():
        if any((place / path.parent / "datapackage.json").is_file() for place in (Path(), find_data())):
            raise InputError("this is a campaign, and a fitted model is needed here: name the folder that `ddetumble "
                             f"discover {shlex.quote(str(path.parent))}` writes, or fit", file=path.parent)
        raise InputError(f"there is no {FILE} here; name a folder of fit or discover", file=path.parent)
    content = read_json(path, SCHEMA, _ModelFile, "fit the model again")
    notes: dict[str, None] = {}

    def see(source: str, digest: str | None) -> str:
        """`FILE.py:NAME` as seen from here; a file that has changed since is noted."""
        file, _, name = source.rpartition(":")
        if digest is not None and (path.parent / file).is_file() and hash_file(path.parent / file) != digest:
            notes[f"{Path(file).name} has changed since the model was fitted; the parameters may no longer belong to "
                  "it."] = None
        return f"{path.parent / file}:{name}"

    own = split_name(content.family)
    family = find_family(content.family).name if own is None else take_kind(content.family, path.parent)
    if own is not None:
        see(content.family, content.family_sha256)
    model = content.model
    if content.model_sha256 is not None:
        require_trust(path.parent / model.rpartition(":")[0], path)
        model = see(model, content.model_sha256)
    reference = _choose(resolve_model(model, family).reference, content.choices, path)
    known, classes = {e.id: e for e in (*list_known(), *extra)}, []
    for entry in content.effects:
        if entry.id not in known:
            if entry.source is None:
                raise InputError(f"the effect {entry.id!r} is in no file and not in the catalogue; give its class to "
                                 "load(extra=...)", file=path, key="effects")
            require_trust(path.parent / entry.source.rpartition(":")[0], path)
        source = None if entry.source is None else see(entry.source, entry.source_sha256)
        classes.append(known.get(entry.id) or resolve_effect(str(source)))
    space = ParameterSpace(reference, classes, content.commons)
    # Parameters of an effect that a later version added, held at their default, stood there without being named.
    later = {s.name: float(u) for s, u in zip(space.slots, space.coordinates(), strict=True)
             if s.owner is not None and not s.parameter.free}
    coordinates = later | content.coordinates
    wrong = set(space.index) ^ set(coordinates)
    if wrong:
        raise InputError(f"the parameters are not those of the model ({', '.join(sorted(wrong))}); fit it again",
                         file=path, key="coordinates")
    return FittedModel(
        path.parent, content.campaign, content.sha256, family, model, tuple(e.id for e in classes), space,
        np.array([coordinates[name] for name in space.index]), tuple(content.free),
        np.array(content.covariance).reshape(len(content.free), len(content.free)),
        {name: entry.noise for name, entry in content.channels.items()},
        {name: entry.unit for name, entry in (content.conditions | content.channels).items()},
        {name: Uncertainty(entry.absolute, entry.relative) for name, entry in content.conditions.items()
         if entry.absolute is not None or entry.relative is not None},
        content.time_sd, {name: (entry.low, entry.high) for name, entry in content.conditions.items()},
        content.records, content.chi2, content.versions, content.extra, tuple(notes), content.sampling,
        content.priors, content.widened)


def take_fitted(model: str | Path | FittedModel | AbstractFitted) -> FittedModel:
    """The fitted model that a result holds, or that a folder has; refused where there is none."""
    if isinstance(model, AbstractFitted):
        return model.fitted_model()
    if isinstance(model, FittedModel):
        return model
    if not isinstance(model, (str, Path)):
        raise InputError(f"{type(model).__name__} is not a fitted model: give what fit or discover returned, or a "
                         "folder that they wrote")
    return load(model)


def resolve_model(model: Model, family: str = DEFAULT_FAMILY) -> ResolvedModel:
    """Resolve an argument to the model that it stands for.

    Args:
        model: a model in hand (`Ball()`, `Ball() + Adhesion()`), a fit or a discovery, or a name: of a built-in model;
            of a folder that `fit` or `discover` wrote, for the fitted model as it stands there; or `FILE.py:NAME` for
            one of the user's own: a subclass of `AbstractReference` or `AbstractFriction`, an instance of one or of
            `Striker`, or a law that extends one by effects.
        family: of the records, as built-in names stand for different models in different families.

    Raises:
        InputError: There is no such model, file or name, or it is none of these things.
    """
    if is_model(model):
        return wrap_model(model)
    require_complete(model)
    if not isinstance(model, (str, Path, FittedModel, AbstractFitted)):
        what = f"the class {model.__name__}" if isinstance(model, type) else f"a {type(model).__name__}"
        of = getattr(model, "model", None)  # of a comparison, say
        raise InputError(f"{what} is not a model: give a name, a folder, a model like Ball(), or what fit or discover "
                         "returned" + (f"; it is of the model {of}, which can be fitted" if isinstance(of, str) else
                                       ""), key="model")
    if isinstance(model, (str, Path)) and not is_fitted(str(model)):
        return find_model(str(model), family)
    saved = take_fitted(model)
    law = saved.law()
    added = f" with {', '.join(saved.effects)}" if saved.effects else ""
    return ResolvedModel(saved.model, law.reference, f"{saved.model}{added}, as fitted to {saved.campaign}.",
                         tuple(law.effects), True)


def _choose(reference: AbstractModel, choices: Mapping[str, Any], path: Path) -> AbstractModel:
    """A model with the choices that a file states; those of its parts have the part's name before a dot."""
    freeze = lambda value: tuple(map(freeze, value)) if isinstance(value, list) else value

    def put(model: Any, values: Mapping[str, Any]) -> Any:
        """All at once, as the model may check one against another."""
        whole = {name: value for name, value in values.items() if "." not in name}
        for part in {name.partition(".")[0] for name in values} - {*whole}:
            inner = {name.removeprefix(f"{part}."): value for name, value in values.items()
                     if name.startswith(f"{part}.")}
            whole[part] = put(getattr(model, part), inner)
        return dc.replace(model, **whole)

    own, wanted = list_choices(reference), {name: freeze(value) for name, value in choices.items()}
    if set(own) != set(wanted):
        raise InputError("the choices are not those of the model; fit it again", file=path, key="choices")
    try:
        return reference if own == wanted else put(reference, wanted)
    except Exception as error:
        raise InputError(f"the model cannot be made ({error}); fit it again", file=path, key="choices") from None


def _place(name: str, folder: Path) -> tuple[str, str | None]:
    """`FILE.py:NAME` as seen from the folder, and the hash of the file; other names as they are, without one."""
    own = split_name(name)
    if own is None or not own[0].is_file():
        return name, None
    trust_file(own[0])
    return f"{place_file(own[0], folder)}:{own[1]}", hash_file(own[0])
