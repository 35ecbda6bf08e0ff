"""What a paper says of a result: a paragraph on methods, and the references that it names."""

import dataclasses as dc
import re
from importlib import resources
from pathlib import Path
from typing import Any

from .._display import AbstractPrinted
from .._errors import InputError
from .._sentences import say
from ..families import find_family
from ..inference.archive import AbstractFitted, FittedModel, load, take_fitted
from ..inference.files import list_versions
from ..planning.plan import Plan
from ..posterior.result import Posterior
from ..posterior.stacking import ModelWeights


BIBLIOGRAPHY = "references.bib"  # in this folder, in the order in which they are printed
SAMPLERS = {"emcee": "emcee2013", "nuts": "hoffman2014"}


@dc.dataclass(frozen=True, repr=False)
class Citation(AbstractPrinted):
    """A paragraph on methods, and the references that it names."""

    methods: str  # plain sentences; a key in brackets is that of a reference
    bibtex: str  # entries of these keys

    def __str__(self) -> str:
        return f"{self.methods}\n\n{self.bibtex}"


def citation(result: AbstractFitted | FittedModel | Posterior | ModelWeights | Plan | str | Path) -> Citation:
    """Methods paragraph and BibTeX entries for a paper, made from a result.

    Args:
        result: what `fit`, `sample`, `discover`, `average` or `plan` returned, or a folder of `fit` or `discover`.

    Raises:
        InputError: It is none of these, or the posterior is of no campaign's parameters.
    """
    parts = _tell(result)
    used = set(re.findall(r"\[(\w+)\]", " ".join(parts)))
    text = (resources.files("ddetumble.reports") / BIBLIOGRAPHY).read_text(encoding="utf-8")
    entries = [one.strip() for one in re.split(r"\n(?=@)", text)]
    kept = [one for one in entries if one.split("{", 1)[1].split(",", 1)[0] in used]
    return Citation(" ".join(parts), "\n\n".join(kept) + "\n")


def _tell(result: Any) -> list[str]:
    if isinstance(result, Plan):
        kinds = {result.settings.plan_for, result.settings.errors.plan_for} - {"best"}
        return [say("citation.planned", impacts=len(result.impacts), robust=min(kinds, default=""),
                    versions=list_versions())]
    if isinstance(result, Posterior):
        fit = getattr(result.target, "fit", None)
        if fit is None:
            raise InputError("the posterior is of no campaign's parameters, which a methods paragraph is about")
        return [_tell_fit(fit.fitted_model()), say(
            "citation.sampled", sampler=result.sampler, key=SAMPLERS[result.sampler], draws=result.log_density.size,
            converged=result.converged)]
    if isinstance(result, ModelWeights):
        names = [one.name for one in result.rivals]
        return [_tell_fit(result.rivals[0].fit.fitted_model()), say("citation.averaged", names=names)]
    return [_tell_fit(load(result) if isinstance(result, (str, Path)) else take_fitted(result))]


def _tell_fit(saved: FittedModel) -> str:
    family, space = find_family(saved.family), saved.space
    built = family.models.get(saved.model)
    return say(
        "citation.fitted", discovered=saved.extra.get("made_by") == "discover", campaign=saved.campaign,
        records=saved.records, model=saved.model, law="" if built is None else built.text,
        paper=type(space.reference).__module__.startswith("ddetumble."), damped="restitution" in saved.space.index,
        contact=family.has_contact, effects=[one for one in space.effects if one.id in saved.effects],
        parameters=list(saved.free),
        noise=[f"{name}: {one.text}" for name, one in saved.noise.items()],
        versions=list_versions() | dict(saved.versions))
