"""Draw from the posterior of a fit: by emcee, or by NUTS."""

import dataclasses as dc
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from .._errors import InputError
from ..contact.effect import AbstractEffect
from ..inference.curve_results import CurveFit
from ..inference.estimation import Progress, fit
from ..inference.findings import Fit
from ..inference.specification import read_specification
from ..measurement.campaign import Campaign
from .curves import pose_curve_fit
from .ensemble import Settings, run_ensembles
from .posterior import Posterior, summarise_posterior
from .target import AbstractTarget, pose_fit


CHAIN = "chain"  # folder of the blocks


def sample(source: Campaign | Fit | CurveFit | AbstractTarget | str | Path, model: str = "paper",
           effects: Sequence[str | type[AbstractEffect]] = (), *, sampler: str | None = None,
           folder: str | Path | None = None, progress: Progress | None = None,
           walkers: int | None = None, ensembles: int | None = None, burn: int | None = None,
           block: int | None = None, effective: int | None = None, most: int | None = None, seed: int | None = None,
           **fitting: Any) -> Posterior:
    """Draw from the posterior of a model's parameters, every record's nuisances integrated out.

    Args:
        source: a campaign or its folder, a specification `fit.toml`, a fit of a campaign or of a friction
            curve, or a target made by `pose_curve`.
        model, effects: as for `fit`.
        sampler: `emcee` (default), or `nuts`, which needs the extra `nuts`.
        folder: where a chain is kept, so that the same call goes on after whatever stopped it.
        progress: called with a sentence and the share done.
        walkers, ensembles, burn, block, effective, most, seed: as in `Settings`; chains instead of ensembles with NUTS.
        **fitting: further arguments of `fit`: `priors`, `bounds`, `fixed`, `noise`, ...

    Priors are those given, Gaussian; elsewhere flat in the coordinate in which the parameter is fitted (its logarithm
    for what is positive, its logit between 0 and 1, itself otherwise) between its bounds.

    Raises:
        InputError: The campaign cannot be fitted, or there is no posterior as nothing bounds a parameter.
        ComputationError: The model cannot be computed.
    """
    report = progress or (lambda text, share: None)
    given = {"walkers": walkers, "ensembles": ensembles, "burn": burn, "block": block, "effective": effective,
             "most": most, "seed": seed}
    stated: dict[str, Any] = {}
    target = source if isinstance(source, AbstractTarget) else None
    if isinstance(source, CurveFit):
        target = pose_curve_fit(source)
    if target is None:
        if isinstance(source, (str, Path)) and Path(source).suffix == ".toml":
            stated, named = _read_settings(Path(source))
            sampler = sampler or named
        found = source if isinstance(source, Fit) else None
        if found is None:
            assert not isinstance(source, (Fit, CurveFit, AbstractTarget))
            found = fit(source, model, effects, progress=lambda text, share: report(text, 0.1 * share), **fitting)
        elif fitting or effects:
            raise InputError("a fit has its model and effects already; fit it anew with others")
        report("looking whether nuisances can be integrated analytically", 0.1)
        target = pose_fit(found)
    settings = Settings(**{**stated, **{k: v for k, v in given.items() if v is not None}})
    sampler = sampler or "emcee"
    place = None if folder is None else Path(folder) / CHAIN
    if sampler == "nuts":
        from .hamiltonian import run_nuts

        return run_nuts(target, settings, place, lambda text, share: report(text, 0.15 + 0.85 * share))
    if sampler != "emcee":
        raise InputError(f"there is no sampler {sampler!r}; it is emcee or nuts", option="sampler")
    chains = run_ensembles(target, settings, place, lambda text, share: report(text, 0.15 + 0.85 * share))
    settings = settings.check(len(target.names))
    return summarise_posterior(
        target, "emcee", dc.asdict(settings), chains.kept, chains.log_density[:, chains.burn:], chains.convergence,
        {"accepted": chains.accepted, "evaluations": chains.evaluations, "failures": chains.failures,
         "resumed": chains.resumed})


def _read_settings(path: Path) -> tuple[dict[str, Any], str]:
    """Settings of the sampler in a specification, and its name."""
    found, _ = read_specification(path)
    s = found.sampler
    return {"walkers": s.walkers, "burn": s.burn, "most": s.steps, "effective": s.effective, "ensembles": s.ensembles,
            "seed": found.seed}, s.name
